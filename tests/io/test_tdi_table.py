"""The files of a table come back bit for bit, damage is refused, and the C look-up gives the same words."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.tdi_table import (
    intel_hex,
    read_c_header,
    read_intel_hex,
    read_segments,
    segments,
    write_table,
)
from sightline.tdi.table import TdiTable
from tdi.test_lookup import table

READERS = {
    "table.bin": TdiTable.read,
    "table.h": read_c_header,
    "table.hex": read_intel_hex,
    "table_segments.bin": read_segments,
}

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
    assert sorted(p.name for p in written) == sorted([*READERS, "table.c"])
    for name, read in READERS.items():
        assert read(tmp_path / name).to_bytes() == given.to_bytes(), name
    assert TdiTable.read(tmp_path).to_bytes() == given.to_bytes()


def test_the_c_look_up_gives_the_same_words(tmp_path, given):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler found to build the look-up with")
    write_table(tmp_path, given)
    (tmp_path / "main.c").write_text(MAIN)
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(
        [compiler, *flags, "-Wno-unused-const-variable", "main.c", "table.c", "-o", "main"],
        cwd=tmp_path,
        check=True,
    )
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
    run = subprocess.run([tmp_path / "main"], input=asked.tobytes(), capture_output=True, check=True)
    words = np.frombuffer(run.stdout, "<u2").reshape(len(signals), len(columns))
    np.testing.assert_array_equal(
        words[:, 1:-1], given.lookup(np.repeat(signals[:, None], given.columns, axis=1))
    )
    assert not words[:, [0, -1]].any()


@pytest.mark.parametrize("name", READERS)
def test_damage_is_one_format_error(tmp_path, name):
    given = table(6)
    write_table(tmp_path, given)
    path, read = tmp_path / name, READERS[name]
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    begin = whole.find(b"{") if name == "table.h" else 0
    for _ in range(60):
        at = int(rng.integers(begin, len(whole)))
        broken = bytearray(whole)
        broken[at] ^= 1 << int(rng.integers(0, 7))
        path.write_bytes(broken)
        try:
            # blanks and the case of letters carry nothing
            assert read(path).to_bytes() == given.to_bytes() and name in ("table.h", "table.hex")
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
    with pytest.raises(FormatError, match="cannot be read"):
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
