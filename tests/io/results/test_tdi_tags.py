"""The file of tags: written and read back bit by bit, damage refused."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.imaging.tdi_transfer import Exposure
from sightline.io.results.tdi_tags import read_tdi_tags, tags_as_bytes, write_tags
from sightline.tdi.tagging import FIELDS, TdiTags


def some_tags(lines=50, groups=12):
    rng = np.random.default_rng(0)
    shape = (lines, groups)
    slow = np.repeat(rng.random((lines // 10, groups)), 10, axis=0)
    return TdiTags(
        first_column=np.arange(groups) * 7, columns=groups * 7 + 3, ratios=np.arange(1, 11) / 10.0,
        exposure=Exposure(2, 0.25, "start"), signal_ratio=0.5,
        stages=rng.integers(3, 129, shape), ratio_index=(slow * 10).astype(int), saturated=slow > 0.9,
        table=np.full(shape, 2**32 - 1), velocity=1.0 + 1e-3 * slow, slip=slow,
        signal=rng.lognormal(5.0, 1.0, shape), mtf_across=slow, mtf_along=slow**2, snr=20.0 * slow,
    )  # fmt: skip


def test_what_is_written_is_read_bit_by_bit(tmp_path):
    tags, path = some_tags(), tmp_path / "tags.bin"
    size = write_tags(path, [tags], len(tags))
    assert path.stat().st_size == size and [p.name for p in tmp_path.iterdir()] == ["tags.bin"]
    back = read_tdi_tags(path)
    for name, form in FIELDS.items():
        assert getattr(back, name).dtype == np.dtype(form)
        assert getattr(back, name).tobytes() == getattr(tags, name).tobytes()
    assert np.array_equal(back.first_column, tags.first_column) and back.columns == tags.columns
    assert np.array_equal(back.ratios, tags.ratios) and back.exposure == tags.exposure
    assert back.signal_ratio == tags.signal_ratio
    assert tags_as_bytes(back) == path.read_bytes()
    assert np.array_equal(back.integration_time, tags.integration_time)


def test_no_lines_are_a_file_too(tmp_path):
    write_tags(tmp_path / "t", [some_tags(lines=0)], 0)
    assert len(read_tdi_tags(tmp_path / "t")) == 0


def test_a_file_that_is_there_stays_whole_when_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "tags.bin"
    write_tags(path, [some_tags()], 50)
    before = path.read_bytes()
    monkeypatch.setattr("sightline.writing.os.replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_tags(path, [some_tags(20)], 20)
    assert path.read_bytes() == before


@pytest.mark.parametrize("where", [8, 12, 30, 100, 1000, -1])
def test_one_flipped_bit_is_found(tmp_path, where):
    path = tmp_path / "tags.bin"
    content = bytearray(tags_as_bytes(some_tags()))
    content[where] ^= 4
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"tags\.bin.*(check sum|version)"):
        read_tdi_tags(path)


@pytest.mark.parametrize(
    ("keep", "says"), [(0, "not a file of TDI tags"), (20, "cut off"), (400, "check sum"), (-1, "check sum")]
)
def test_a_cut_file_is_refused(tmp_path, keep, says):
    path = tmp_path / "tags.bin"
    path.write_bytes(tags_as_bytes(some_tags())[:keep])
    with pytest.raises(FormatError, match=says):
        read_tdi_tags(path)


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "motion.csv"
    path.write_text("t,roll,pitch,yaw\n" * 20)
    with pytest.raises(FormatError, match="not a file of TDI tags"):
        read_tdi_tags(path)
    with pytest.raises(FormatError, match="no such file"):
        read_tdi_tags(tmp_path / "none")


@pytest.mark.parametrize(
    ("at", "form", "value"),
    [
        (10, "<H", 3),  # an alignment that is none
        (12, "<I", 51),  # a line too many
        (16, "<I", 4),  # groups too few
        (20, "<I", 5),  # columns too few
        (26, "<H", 2),  # ratios too few
        (28, "<d", 2.0),  # a head longer than the line period
        (36, "<d", 0.0),  # no signal ratio
    ],
)
def test_a_header_that_does_not_fit_is_refused_though_its_sum_is_right(tmp_path, at, form, value):
    content = bytearray(tags_as_bytes(some_tags())[:-4])
    struct.pack_into(form, content, at, value)
    path = tmp_path / "tags.bin"
    path.write_bytes(bytes(content) + struct.pack("<I", zlib.crc32(content)))
    with pytest.raises(FormatError, match="does not fit its header"):
        read_tdi_tags(path)
