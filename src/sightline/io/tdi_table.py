"""The files of a TDI table: memory image, C header and look-up, Intel HEX, uplink segments; written and read.

All carry the bytes of ``TdiTable.to_bytes``. Not here: those bytes (``tdi/table.py``).
"""

from __future__ import annotations

import binascii
import re
from pathlib import Path

from sightline.errors import FormatError, InputError
from sightline.tdi.table import (
    BEYOND_BIT,
    HEADER,
    IMAGE_FILE,
    INFEASIBLE_BIT,
    RATIO_BITS,
    STAGE_BITS,
    TdiTable,
)

HEADER_FILE, SOURCE_FILE = "table.h", "table.c"
HEX_FILE, SEGMENTS_FILE = "table.hex", "table_segments.bin"
#: Bytes of the image in a record of Intel HEX, and in an uplink segment.
HEX_BYTES, SEGMENT_BYTES = 16, 240
#: Application process identifier of the segments, 11 bits.
APPLICATION = 0x54D
#: Head of a space packet, place of its part in the image, CRC.
PACKET_HEAD, OFFSET, CRC = 6, 4, 2

LOOKUP = """/* Look-up of a Sightline TDI table in its memory image; no floating point needed. */
#include "table.h"

static uint32_t whole(const uint8_t *p, uint32_t bytes)
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

uint16_t sightline_tdi_lookup_in(const uint8_t *image, uint32_t column, uint32_t signal)
{
    uint32_t first = whole(image + 12, 4), columns = whole(image + 16, 4);
    uint32_t groups = whole(image + 20, 4), cells = whole(image + 24, 4);
    uint32_t bytes = whole(image + 30, 2), shift = whole(image + 32, 2), top = whole(image + 36, 4);
    const uint8_t *edges = image + whole(image + 6, 2) + 8 * whole(image + 28, 2);
    const uint8_t *starts = edges + bytes * (groups + 1);
    const uint8_t *thresholds = starts + bytes * (groups + 1), *words = thresholds + 2 * cells;
    uint32_t group, begin, end, cell;
    if (column < first || column - first >= columns)
        return 0;
    group = last_not_above(edges, bytes, groups, column - first);
    begin = whole(starts + group * bytes, bytes);
    end = whole(starts + (group + 1) * bytes, bytes);
    cell = begin + last_not_above(thresholds + 2 * begin, 2, end - begin, signal >> shift);
    return (uint16_t)(whole(words + 2 * cell, 2) | (signal >> shift > top ? SIGHTLINE_TDI_BEYOND : 0u));
}

uint16_t sightline_tdi_lookup(uint32_t column, uint32_t signal)
{
    return sightline_tdi_lookup_in(sightline_tdi_image, column, signal);
}
"""


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
        SOURCE_FILE: LOOKUP.encode(),
        HEX_FILE: intel_hex(image).encode(),
        SEGMENTS_FILE: segments(image),
    }
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in content]


def c_header(table: TdiTable) -> str:
    """C header of a table: memory image with its address map, bits of a word, declaration of the look-up."""
    image = table.to_bytes()
    ratios = ", ".join(f"{ratio:.17g}" for ratio in table.ratios)
    places, at = [], HEADER.size
    index = int.from_bytes(image[30:32], "little")
    for name, size in (
        ("RATIOS", 8 * len(table.ratios)), ("EDGES", index * len(table.edges)),
        ("STARTS", index * len(table.starts)), ("THRESHOLDS", 2 * len(table.words)),
        ("WORDS", 2 * len(table.words)), ("CRC32", 4),
    ):  # fmt: skip
        places.append(f"#define SIGHTLINE_TDI_AT_{name:<10} 0x{at:06X}u /* {size} bytes */")
        at += size
    data = "\n".join(
        "    " + " ".join(f"0x{byte:02x}," for byte in image[k : k + HEX_BYTES])
        for k in range(0, at, HEX_BYTES)
    )
    columns = f"{table.edges[0]} to {table.edges[-1] - 1}"
    signals = f"{table.signals[0]:g} to {table.signals[1]:g} electrons of one line"
    ratio_bits = f"{STAGE_BITS}-{STAGE_BITS + RATIO_BITS - 1}"
    return f"""/* TDI table {table.identity:08x}, written by Sightline. Include it in one file only.
 * Columns {columns}; signals {signals}.
 * Word: bits 0-{STAGE_BITS - 1} stages; bits {ratio_bits} number of the integration ratio;
 * bit {INFEASIBLE_BIT}: no setting keeps all limits somewhere in the cell;
 * bit {BEYOND_BIT}: the signal is above the table's range.
 * Integration ratios: {ratios}
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

/* Word of a column and a signal in whole electrons; 0 where the table does not have the column. */
uint16_t sightline_tdi_lookup(uint32_t column, uint32_t signal);
/* The same in another image, for example one sent up. */
uint16_t sightline_tdi_lookup_in(const uint8_t *image, uint32_t column, uint32_t signal);

static const uint8_t sightline_tdi_image[{len(image)}] = {{
{data}
}};
#endif
"""


def read_c_header(path: str | Path) -> TdiTable:
    """Table of a C header that `write_table` wrote."""
    text = _read(path).decode("ascii", "replace")
    found = re.search(r"sightline_tdi_image\[(\d+)\] = \{([^}]*)\}", text)
    if found is None:
        raise FormatError(f"{path}: has no sightline_tdi_image[]; give a table.h that `sightline tdi` wrote")
    parts = [part.strip() for part in found[2].split(",") if part.strip()]
    if not all(re.fullmatch(r"0x[0-9a-f]{2}", part) for part in parts) or len(parts) != int(found[1]):
        raise FormatError(f"{path}: the bytes of its image are not {found[1]} numbers; write it anew")
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
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror}); give a file `sightline tdi` wrote"
        ) from None
