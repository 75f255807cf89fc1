"""The files of a table come back bit for bit, damage is refused, and the C look-up gives the same words."""

from __future__ import annotations

import shutil
import subprocess
import zlib
from dataclasses import replace

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.results.tdi_table import (
    c_header,
    intel_hex,
    read_c_source,
    read_intel_hex,
    read_segments,
    segments,
    write_table,
)
from sightline.tdi.table import TdiTable
from tdi.test_lookup import table

READERS = {
    "table.bin": TdiTable.read,
    "table.c": read_c_source,
    "table.hex": read_intel_hex,
    "table_segments.bin": read_segments,
}

CHECK = """
#include <stdio.h>
#include <stdlib.h>
#include "table.h"
/* Images on the input, each after its size; the answer and, of good ones, a word. */
int main(void)
{
    uint32_t size;
    while (fread(&size, 4, 1, stdin) == 1) {
        /* no byte more than the image, so that a read beyond it is found */
        uint8_t *image = (uint8_t *)malloc(size ? size : 1);
        if (fread(image, 1, size, stdin) != size) return 2;
        if (sightline_tdi_check(image, size))
            printf("%u\\n", (unsigned)sightline_tdi_lookup_in(image, 10, 100));
        else
            printf("bad\\n");
        free(image);
    }
    return sightline_tdi_check(sightline_tdi_image, SIGHTLINE_TDI_SIZE) ? 0 : 3;
}
"""

MAIN = """
#include <stdio.h>
#include "table.h"
int main(void)
{
    uint32_t asked[2];
    while (fread(asked, 4, 2, stdin) == 2) {
        uint16_t word = sightline_tdi_lookup(asked[0], asked[1]);
        fwrite(&word, 2, 1, stdout);
    }
    return 0;
}
"""


@pytest.fixture(params=["small", "many cells", "quantised", "many groups"])
def given(request):
    return {
        "small": lambda: table(),
        "many cells": lambda: table(60, groups=30),
        "quantised": lambda: table(5, shift=6),
        # more cells than 16 bits count, more than 64 KiB
        "many groups": lambda: table(6, groups=25_000),
    }[request.param]()


def test_every_file_reads_back_the_same(tmp_path, given):
    written = write_table(tmp_path, given)
    assert sorted(p.name for p in written) == sorted([*READERS, "table.h"])
    for name, read in READERS.items():
        assert read(tmp_path / name).to_bytes() == given.to_bytes(), name
    assert TdiTable.read(tmp_path).to_bytes() == given.to_bytes()


def compiled(folder, main: str, *more: str, name: str = "cc", language: str = ".c"):
    """Program of a main and the table's C source; skips where there is no such compiler."""
    compiler = shutil.which(name) or shutil.which("gcc")
    if compiler is None or (language == ".cpp" and shutil.which(name) is None):
        pytest.skip(f"no compiler {name} found to build the look-up with")
    (folder / f"main{language}").write_text(main)
    flags = ["-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    c_compiler = shutil.which("cc") or shutil.which("gcc")
    subprocess.run([c_compiler, "-std=c99", *flags, *more, "-c", "table.c"], cwd=folder, check=True)
    # a second file that includes the header must not be a second copy, nor clash
    (folder / f"other{language}").write_text('#include "table.h"\n')
    program = [compiler, *flags, *more, f"main{language}", f"other{language}", "table.o", "-o", "main"]
    subprocess.run(program, cwd=folder, check=True)
    return folder / "main"


def test_the_c_look_up_gives_the_same_words(tmp_path, given):
    write_table(tmp_path, given)
    program = compiled(tmp_path, MAIN)
    rng = np.random.default_rng(0)
    most = 7000 << given.shift
    drawn = rng.integers(0, most, 400)
    ends = np.unique(given.thresholds)[:3000].astype(np.int64) << given.shift
    signals = np.unique(
        np.concatenate([np.arange(50), drawn, ends, np.maximum(ends - 1, 0), [most, 2**32 - 1]])
    )
    if given.columns * len(signals) > 2_000_000:
        signals = signals[:: given.columns * len(signals) // 2_000_000 + 1]
    # all columns, and one beyond each end
    columns = np.arange(given.edges[0] - 1, given.edges[-1] + 1)
    asked = np.stack(np.meshgrid(columns, signals), axis=-1).astype("<u4")
    run = subprocess.run([program], input=asked.tobytes(), capture_output=True, check=True)
    words = np.frombuffer(run.stdout, "<u2").reshape(len(signals), len(columns))
    np.testing.assert_array_equal(
        words[:, 1:-1], given.lookup(np.repeat(signals[:, None], given.columns, axis=1))
    )
    assert not words[:, [0, -1]].any()


def test_a_cpp_caller_links(tmp_path):
    given = table(3)
    write_table(tmp_path, given)
    program = compiled(tmp_path, MAIN, name="g++", language=".cpp")
    asked = np.array([given.edges[0], 50], dtype="<u4").tobytes()
    run = subprocess.run([program], input=asked, capture_output=True, check=True)
    assert int.from_bytes(run.stdout, "little") == given.lookup(np.full(given.columns, 50))[0]


def resealed(image: bytes, at: int, value: bytes) -> bytes:
    """Image with some bytes replaced and a CRC that fits them."""
    body = image[:at] + value + image[at + len(value) : -4]
    return body + zlib.crc32(body).to_bytes(4, "little")


def damaged(given: TdiTable) -> list[bytes]:
    """Images that are none: cut short, a bit flipped anywhere, erased memory, sealed but inconsistent."""
    whole = given.to_bytes()
    cut = [whole[:k] for k in (0, 3, 4, 40, 71, 75, 76, len(whole) // 2, len(whole) - 1)]
    flipped = []
    for bit in np.random.default_rng(5).integers(0, 8 * len(whole), 200):
        broken = bytearray(whole)
        broken[bit >> 3] ^= 1 << (bit & 7)
        flipped.append(bytes(broken))
    erased = [byte * size for byte in (b"\xff", b"\0") for size in (76, len(whole), 4096)]
    index = int.from_bytes(whole[30:32], "little")
    edges = 72 + 8 * len(given.ratios)
    starts = edges + index * len(given.edges)
    thresholds = starts + index * len(given.starts)
    words = thresholds + 2 * len(given.words)
    most = b"\xff" * 4
    sealed = [
        resealed(whole, at, value)
        for at, value in (
            (4, b"\x01"), (6, b"\x40"), (8, most), (12, most), (16, most), (16, bytes(4)), (20, most),
            (20, bytes(4)), (24, most), (24, bytes(4)), (28, b"\xff\xff"), (28, b"\0\0"), (30, b"\x03"),
            (32, b"\x11"), (edges, b"\x01"), (edges + index, b"\0\0"), (edges + index, b"\xff\xff"),
            (starts, b"\x01"), (starts + index, b"\xff\xff"), (thresholds - index, b"\xff\xff"),
            (thresholds, b"\x01"), (thresholds + 4, b"\0\0"), (words, b"\0\0"), (words, b"\xff\x3f"),
            (words, b"\x01\x80"),
        )
    ]  # fmt: skip
    return cut + flipped + erased + sealed


@pytest.mark.parametrize("groups", [7, 25_000])
def test_the_c_check_passes_good_images_and_no_others(tmp_path, groups):
    given = table(6, groups=groups)
    write_table(tmp_path, given)
    try:
        program = compiled(tmp_path, CHECK, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    except subprocess.CalledProcessError:
        # a compiler without the sanitizer's library
        program = compiled(tmp_path, CHECK)
    others = table(40, shift=3), table(1, seed=3)
    good = [given.to_bytes(), *(other.to_bytes() for other in others)]
    bad = damaged(given)[:: 1 if groups < 100 else 10]
    sent = b"".join(len(image).to_bytes(4, "little") + image for image in good + bad)
    run = subprocess.run([program], input=sent, capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
    said = run.stdout.decode().split()
    words = [t.lookup(np.full(t.columns, 100))[0] for t in (given, *others)]
    assert said == [*map(str, words), *["bad"] * len(bad)]
    # what C refuses is refused here, too
    for image in bad[:: 1 if groups < 100 else 20]:
        with pytest.raises(FormatError):
            TdiTable.from_bytes(image)


def test_the_header_says_which_electrons_signals_are():
    given = replace(table(), ratios=np.array([0.05, 0.1, 0.4, 0.8, 1.0]))
    assert "electrons of one line\n * at an integration ratio of 1." in c_header(given)
    header = c_header(replace(given, signal_ratio=0.25, head_stages=2))
    assert "Signals 2 to 6000: signals are electrons of one head line (the head has 2)" in header
    assert "at an integration ratio of 0.25." in header
    assert "Integration ratios: 0.05, 0.1, 0.4, 0.8, 1\n" in header
    assert "{" not in header.replace('extern "C" {', "")


@pytest.mark.parametrize("name", READERS)
def test_damage_is_one_format_error(tmp_path, name):
    given = table(6)
    write_table(tmp_path, given)
    path, read = tmp_path / name, READERS[name]
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    begin = whole.rfind(b"{") if name == "table.c" else 0
    for _ in range(60):
        at = int(rng.integers(begin, len(whole)))
        broken = bytearray(whole)
        broken[at] ^= 1 << int(rng.integers(0, 7))
        path.write_bytes(broken)
        try:
            # blanks and the case of letters carry nothing
            assert read(path).to_bytes() == given.to_bytes() and name in ("table.c", "table.hex")
        except FormatError as problem:
            assert str(path) in str(problem)
    for cut in (0, 3, 40, len(whole) // 2, len(whole) - 20):
        path.write_bytes(whole[:cut])
        with pytest.raises(FormatError):
            read(path)
    for foreign in (b"\x89PNG\r\n\x1a\n" * 40, b"column,signal\n1,2\n"):
        path.write_bytes(foreign)
        with pytest.raises(FormatError):
            read(path)
    path.unlink()
    with pytest.raises(FormatError, match="no such file"):
        read(path)


def test_a_folder_without_a_table_says_what_is_needed(tmp_path):
    with pytest.raises(FormatError, match="sightline tdi"):
        TdiTable.read(tmp_path)


def test_segments_may_come_in_any_order_but_all_must_come(tmp_path):
    given = table(60, groups=30)
    sent = segments(given.to_bytes())
    packets, at = [], 0
    while at < len(sent):
        size = int.from_bytes(sent[at + 4 : at + 6], "big") + 7
        packets.append(sent[at : at + size])
        at += size
    counts = [int.from_bytes(p[2:4], "big") & 0x3FFF for p in packets]
    flags = [p[2] >> 6 for p in packets]
    assert counts == list(range(len(packets))) and flags == [1, *[0] * (len(packets) - 2), 2]
    path = tmp_path / "table_segments.bin"
    path.write_bytes(b"".join(reversed(packets)))
    assert read_segments(path).to_bytes() == given.to_bytes()
    for missing in (0, 1, len(packets) - 1):
        path.write_bytes(b"".join(p for k, p in enumerate(packets) if k != missing))
        with pytest.raises(FormatError, match="missing"):
            read_segments(path)
    path.write_bytes(sent + packets[0])
    with pytest.raises(FormatError, match="twice"):
        read_segments(path)


def test_the_formats_are_the_published_ones():
    # Intel's own example of a data record, and the check value of CRC-16/CCITT-FALSE
    assert intel_hex(bytes.fromhex("214601360121470136007EFE09D21901")).splitlines() == [
        ":10000000214601360121470136007EFE09D2190141",
        ":00000001FF",
    ]
    packet = segments(b"123456789")
    assert packet[2] >> 6 == 0b11 and packet[0] >> 4 == 0b0001
    crc = 0xFFFF
    for byte in packet[:-2]:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    assert int.from_bytes(packet[-2:], "big") == crc


def test_a_table_too_large_to_send_is_refused():
    with pytest.raises(InputError, match="larger `max_loss`"):
        segments(bytes(240 * 16385))
