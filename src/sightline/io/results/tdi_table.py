"""The files of a TDI table: memory image, C header and look-up, Intel HEX, uplink segments; written and read.

All carry the bytes of ``TdiTable.to_bytes``. Not here: those bytes (``tdi/table.py``).
"""

from __future__ import annotations

import binascii
import re
from pathlib import Path

from sightline.access import read_bytes
from sightline.errors import FormatError, InputError
from sightline.tdi.setting import MOST_RATIOS, RATIO_BITS, STAGE_BITS
from sightline.tdi.table import (
    BEYOND_BIT,
    HEADER,
    IMAGE_FILE,
    INFEASIBLE_BIT,
    VERSION,
    TdiTable,
)
from sightline.writing import whole

HEADER_FILE, SOURCE_FILE = "table.h", "table.c"
HEX_FILE, SEGMENTS_FILE = "table.hex", "table_segments.bin"
#: Bytes of the image in a record of Intel HEX, and in an uplink segment.
HEX_BYTES, SEGMENT_BYTES = 16, 240
#: Application process identifier of the segments, 11 bits.
APPLICATION = 0x54D
#: Head of a space packet, place of its part in the image, CRC.
PACKET_HEAD, OFFSET, CRC = 6, 4, 2

#: C look-up and check.
LOOKUP = """static uint32_t whole(const uint8_t *p, uint32_t bytes)
{
    uint32_t value = 0;
    while (bytes--)
        value = value << 8 | p[bytes];
    return value;
}

/* Last of `count` rising numbers that is not above `key`; the first where all are. */
static uint32_t last_not_above(const uint8_t *list, uint32_t bytes, uint32_t count, uint32_t key)
{
    uint32_t low = 0, high = count;
    while (high - low > 1) {
        uint32_t middle = low + (high - low) / 2;
        if (whole(list + middle * bytes, bytes) <= key) low = middle; else high = middle;
    }
    return low;
}

/* Whether `count` numbers rise from 0 to the last. */
static int rises(const uint8_t *list, uint32_t bytes, uint32_t count, uint32_t last)
{
    uint32_t k;
    if (whole(list, bytes) != 0 || whole(list + (count - 1) * bytes, bytes) != last)
        return 0;
    for (k = 1; k < count; k++)
        if (whole(list + k * bytes, bytes) <= whole(list + (k - 1) * bytes, bytes))
            return 0;
    return 1;
}

/* CRC-32 as zlib has it. */
static uint32_t crc32_of(const uint8_t *p, uint32_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    while (size--) {
        int bit;
        crc ^= *p++;
        for (bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1u ? 0xEDB88320u : 0u);
    }
    return crc ^ 0xFFFFFFFFu;
}

/* Where the parts of an image lie. */
struct parts {
    uint32_t groups, cells, bytes;
    const uint8_t *edges, *starts, *thresholds, *words;
};

static struct parts parts_of(const uint8_t *image)
{
    struct parts t;
    t.groups = whole(image + 20, 4);
    t.cells = whole(image + 24, 4);
    t.bytes = whole(image + 30, 2);
    t.edges = image + whole(image + 6, 2) + 8 * whole(image + 28, 2);
    t.starts = t.edges + t.bytes * (t.groups + 1);
    t.thresholds = t.starts + t.bytes * (t.groups + 1);
    t.words = t.thresholds + 2 * t.cells;
    return t;
}

/* Whether thresholds rise from 0 within every group, and words name settings that there are. */
static int cells_hold(const struct parts *t, uint32_t ratios)
{
    uint32_t group, cell;
    for (group = 0; group < t->groups; group++) {
        uint32_t begin = whole(t->starts + group * t->bytes, t->bytes);
        uint32_t end = whole(t->starts + (group + 1) * t->bytes, t->bytes);
        if (!rises(t->thresholds + 2 * begin, 2, end - begin, whole(t->thresholds + 2 * (end - 1), 2)))
            return 0;
    }
    for (cell = 0; cell < t->cells; cell++) {
        uint32_t word = whole(t->words + 2 * cell, 2);
        if (SIGHTLINE_TDI_STAGES(word) == 0 || SIGHTLINE_TDI_RATIO(word) >= ratios
            || (word & SIGHTLINE_TDI_BEYOND))
            return 0;
    }
    return 1;
}

int sightline_tdi_check(const uint8_t *image, uint32_t size)
{
    uint32_t bytes, total, ratios, columns;
    uint64_t needed;
    struct parts t;
    if (size < HEAD_BYTES + 4 || image[0] != 'S' || image[1] != 'L' || image[2] != 'T' || image[3] != 'D')
        return 0;
    if (whole(image + 4, 2) != VERSION_READ || whole(image + 6, 2) != HEAD_BYTES)
        return 0;
    total = whole(image + 8, 4);
    columns = whole(image + 16, 4);
    ratios = whole(image + 28, 2);
    bytes = whole(image + 30, 2);
    if (total > size || ratios < 1 || ratios > MOST_RATIOS || (bytes != 2 && bytes != 4))
        return 0;
    if (whole(image + 32, 2) > 16 || columns == 0 || columns - 1 > UINT32_MAX - whole(image + 12, 4))
        return 0;
    /* counted in 64 bits, so that no count can be too large to be seen */
    needed = HEAD_BYTES + 8 * (uint64_t)ratios + 2 * bytes * ((uint64_t)whole(image + 20, 4) + 1)
           + 4 * (uint64_t)whole(image + 24, 4) + 4;
    if (needed != total || crc32_of(image, total - 4) != whole(image + total - 4, 4))
        return 0;
    t = parts_of(image);
    if (t.groups == 0 || t.cells < t.groups)
        return 0;
    return rises(t.edges, bytes, t.groups + 1, columns) && rises(t.starts, bytes, t.groups + 1, t.cells)
        && cells_hold(&t, ratios);
}

uint16_t sightline_tdi_lookup_in(const uint8_t *image, uint32_t column, uint32_t signal)
{
    uint32_t first = whole(image + 12, 4), columns = whole(image + 16, 4);
    uint32_t code = signal >> whole(image + 32, 2), top = whole(image + 36, 4);
    struct parts t = parts_of(image);
    uint32_t group, begin, end, cell;
    if (column < first || column - first >= columns)
        return 0;
    group = last_not_above(t.edges, t.bytes, t.groups, column - first);
    begin = whole(t.starts + group * t.bytes, t.bytes);
    end = whole(t.starts + (group + 1) * t.bytes, t.bytes);
    cell = begin + last_not_above(t.thresholds + 2 * begin, 2, end - begin, code);
    return (uint16_t)(whole(t.words + 2 * cell, 2) | (code > top ? SIGHTLINE_TDI_BEYOND : 0u));
}

uint16_t sightline_tdi_lookup(uint32_t column, uint32_t signal)
{
    return sightline_tdi_lookup_in(sightline_tdi_image, column, signal);
}"""


def write_table(folder: str | Path, table: TdiTable) -> list[Path]:
    """Write all files of a table into a folder, which exists.

    Parameters
    ----------
    folder : path
    table : TdiTable

    Returns
    -------
    list of Path
        `table.bin`, `table.h`, `table.c`, `table.hex`, `table_segments.bin`.
    """
    folder, image = Path(folder), table.to_bytes()
    content = {
        IMAGE_FILE: image,
        HEADER_FILE: c_header(table).encode(),
        SOURCE_FILE: c_source(table).encode(),
        HEX_FILE: intel_hex(image).encode(),
        SEGMENTS_FILE: segments(image),
    }
    for name, data in content.items():
        with whole(folder / name) as draft:
            draft.write_bytes(data)
    return [folder / name for name in content]


def c_header(table: TdiTable) -> str:
    """C header of a table: declarations, bits of a word, addresses in the image."""
    size = len(table.to_bytes())
    index = (size - HEADER.size - 8 * len(table.ratios) - 4 * len(table.words) - 4) // (2 * len(table.edges))
    places, at = [], HEADER.size
    for name, count in (
        ("RATIOS", 8 * len(table.ratios)), ("EDGES", index * len(table.edges)),
        ("STARTS", index * len(table.starts)), ("THRESHOLDS", 2 * len(table.words)),
        ("WORDS", 2 * len(table.words)), ("CRC32", 4),
    ):  # fmt: skip
        places.append(f"#define SIGHTLINE_TDI_AT_{name:<10} 0x{at:06X}u /* {count} bytes */")
        at += count
    ratio_bits = f"{STAGE_BITS}-{STAGE_BITS + RATIO_BITS - 1}"
    return f"""/* TDI table {table.identity:08x}, written by Sightline. Its image is in {SOURCE_FILE}.
 * Columns {table.edges[0]} to {table.edges[-1] - 1}.
{_signals_meant(table)}
 * Word: bits 0-{STAGE_BITS - 1} stages; bits {ratio_bits} number of the integration ratio;
 * bit {INFEASIBLE_BIT}: no setting keeps all limits somewhere in the cell;
 * bit {BEYOND_BIT}: the signal is above the table's range.
 * Integration ratios: {", ".join(map(_shortest, table.ratios))}
 */
#ifndef SIGHTLINE_TDI_TABLE_H
#define SIGHTLINE_TDI_TABLE_H
#include <stdint.h>

#define SIGHTLINE_TDI_STAGES(word) ((word) & 0x{(1 << STAGE_BITS) - 1:X}u)
#define SIGHTLINE_TDI_RATIO(word) ((word) >> {STAGE_BITS} & 0x{(1 << RATIO_BITS) - 1:X}u)
#define SIGHTLINE_TDI_INFEASIBLE 0x{1 << INFEASIBLE_BIT:X}u
#define SIGHTLINE_TDI_BEYOND 0x{1 << BEYOND_BIT:X}u

/* Addresses in the image; it is little-endian, edges and starts are of {index} bytes. */
{chr(10).join(places)}
#define SIGHTLINE_TDI_SIZE          0x{size:06X}u

#ifdef __cplusplus
extern "C" {{
#endif

extern const uint8_t sightline_tdi_image[SIGHTLINE_TDI_SIZE];

/* Word of a column and a signal in whole electrons; 0 where the table does not have the column. */
uint16_t sightline_tdi_lookup(uint32_t column, uint32_t signal);
/* The same in another image, for example one sent up, which `sightline_tdi_check` has found good. */
uint16_t sightline_tdi_lookup_in(const uint8_t *image, uint32_t column, uint32_t signal);
/* 1 where the `size` bytes at `image` begin with a whole and consistent image of this version, else 0. */
int sightline_tdi_check(const uint8_t *image, uint32_t size);

#ifdef __cplusplus
}}
#endif
#endif
"""


def _signals_meant(table: TdiTable) -> str:
    """Which electrons signals are, as a comment."""
    low, high = map(_shortest, table.signals)
    line = f"head line (the head has {table.head_stages})" if table.head_stages else "line"
    return (
        f" * Signals {low} to {high}: signals are electrons of one {line}\n"
        f" * at an integration ratio of {_shortest(table.signal_ratio)}."
    )


def _shortest(value: float) -> str:
    """The fewest digits that distinguish a number from every other; none behind a whole one."""
    return repr(float(value)).removesuffix(".0")


def c_source(table: TdiTable) -> str:
    """C source of a table: look-up, check of an image, and at the end, so that a cut is seen, the image."""
    image = table.to_bytes()
    data = "\n".join(
        "    " + " ".join(f"0x{byte:02x}," for byte in image[k : k + HEX_BYTES])
        for k in range(0, len(image), HEX_BYTES)
    )
    return f"""/* TDI table {table.identity:08x}, written by Sightline; no floating point needed. */
#include "{HEADER_FILE}"

enum {{ HEAD_BYTES = {HEADER.size}, VERSION_READ = {VERSION}, MOST_RATIOS = {MOST_RATIOS} }};

{LOOKUP}
const uint8_t sightline_tdi_image[SIGHTLINE_TDI_SIZE] = {{
{data}
}};
"""


def read_c_source(path: str | Path) -> TdiTable:
    """Table of a C source that `write_table` wrote."""
    text = _read(path).decode("ascii", "replace")
    found = re.search(r"sightline_tdi_image\[SIGHTLINE_TDI_SIZE\] = \{([^}]*)\}", text)
    if found is None:
        raise FormatError(f"{path}: has no sightline_tdi_image[]; give a table.c that `sightline tdi` wrote")
    parts = [part.strip() for part in found[1].split(",") if part.strip()]
    if not all(re.fullmatch(r"0x[0-9a-f]{2}", part) for part in parts):
        raise FormatError(f"{path}: the bytes of its image are not all numbers; write it anew")
    return TdiTable.from_bytes(bytes(int(part, 16) for part in parts), str(path))


def intel_hex(image: bytes) -> str:
    """Intel HEX of a memory image from address 0: data, extended linear addresses, end."""
    lines = []
    for at in range(0, len(image), HEX_BYTES):
        if at and at % 0x10000 == 0:
            lines.append(_record(0, 4, (at >> 16).to_bytes(2, "big")))
        lines.append(_record(at & 0xFFFF, 0, image[at : at + HEX_BYTES]))
    return "\n".join([*lines, _record(0, 1, b""), ""])


def _record(address: int, kind: int, data: bytes) -> str:
    body = bytes([len(data), address >> 8, address & 0xFF, kind]) + data
    return f":{body.hex()}{-sum(body) & 0xFF:02x}".upper()


def read_intel_hex(path: str | Path) -> TdiTable:
    """Table of an Intel HEX file that `write_table` wrote."""
    image, base, ended = bytearray(), 0, False
    for number, line in enumerate(_read(path).decode("ascii", "replace").split(), 1):
        where = f"{path}: line {number}"
        if ended or not re.fullmatch(r":(?:[0-9A-Fa-f]{2}){5,}", line):
            raise FormatError(f"{where}: {line[:20]!r} is not a record of Intel HEX")
        record = bytes.fromhex(line[1:])
        if sum(record) & 0xFF or len(record) != record[0] + 5:
            raise FormatError(f"{where}: its checksum or length does not fit; write it anew")
        address, kind, data = int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == 1:
            ended = True
        elif kind == 4 and len(data) == 2:
            base = int.from_bytes(data, "big") << 16
        elif kind == 0 and base + address == len(image):
            image += data
        else:
            raise FormatError(f"{where}: record of type {kind} at {base + address:#x} does not follow on")
    if not ended:
        raise FormatError(f"{path}: has no end record; it is cut short")
    return TdiTable.from_bytes(bytes(image), str(path))


def segments(image: bytes) -> bytes:
    """Uplink segments of a memory image: space packets (CCSDS 133.0-B) end to end.

    Each is a telecommand without secondary head: sequence flags and count, then where its part belongs in the
    image (4 bytes, big-endian), the part, and CRC-16/CCITT-FALSE over all before it.
    """
    parts = [image[k : k + SEGMENT_BYTES] for k in range(0, len(image), SEGMENT_BYTES)]
    if len(parts) > 1 << 14:
        raise InputError(
            f"the table of {len(image)} bytes needs {len(parts)} uplink segments; {1 << 14} can be counted: "
            "allow a larger `max_loss`"
        )
    packets = []
    for count, part in enumerate(parts):
        first, last = count == 0, count == len(parts) - 1
        flags = 0b01 * first | 0b10 * last
        head = (1 << 12 | APPLICATION).to_bytes(2, "big") + (flags << 14 | count).to_bytes(2, "big")
        body = (count * SEGMENT_BYTES).to_bytes(OFFSET, "big") + part
        packet = head + (len(body) + CRC - 1).to_bytes(2, "big") + body
        packets.append(packet + binascii.crc_hqx(packet, 0xFFFF).to_bytes(CRC, "big"))
    return b"".join(packets)


def read_segments(path: str | Path) -> TdiTable:
    """Table of the uplink segments that `write_table` wrote, in whatever order they came."""
    data, at = _read(path), 0
    parts: dict[int, bytes] = {}
    last = -1
    while at < len(data):
        where = f"{path}: segment at byte {at}"
        size = PACKET_HEAD + int.from_bytes(data[at + 4 : at + 6], "big") + 1
        packet = data[at : at + size]
        if len(packet) < PACKET_HEAD + OFFSET + CRC or len(packet) != size:
            raise FormatError(f"{where}: is cut short")
        if binascii.crc_hqx(packet, 0xFFFF):
            raise FormatError(f"{where}: is corrupted (its CRC-16 does not fit)")
        control = int.from_bytes(packet[2:4], "big")
        if int.from_bytes(packet[:2], "big") != 1 << 12 | APPLICATION or control & 0x3FFF in parts:
            raise FormatError(f"{where}: is of another application, or came twice")
        place = int.from_bytes(packet[PACKET_HEAD : PACKET_HEAD + OFFSET], "big")
        if place != (control & 0x3FFF) * SEGMENT_BYTES:
            raise FormatError(f"{where}: its place in the image and its sequence count disagree")
        parts[control & 0x3FFF] = packet[PACKET_HEAD + OFFSET : -CRC]
        if control >> 15:
            last = control & 0x3FFF
        at += size
    missing = sorted(set(range(last + 1)) - set(parts))
    if last < 0 or missing or len(parts) != last + 1:
        raise FormatError(f"{path}: segments are missing ({missing[:8] or 'the last'}); send them again")
    return TdiTable.from_bytes(b"".join(parts[k] for k in sorted(parts)), str(path))


def _read(path: str | Path) -> bytes:
    return read_bytes(Path(path), "a table of TDI settings", advice="give a file `sightline tdi` wrote")
