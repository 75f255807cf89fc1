"""Files that are whole or not there, with errors that name them, and the date that stands in them."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import tempfile
import textwrap
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import rasterio

from sightline.errors import InputError
from sightline.io.formats.ccsds import write_aem
from sightline.writing import (
    creation_date,
    is_complete,
    let_go,
    must_fit,
    scratch_array,
    scratch_folder,
    scratch_in,
    whole,
    whole_raster,
)


def test_a_file_takes_its_name_when_it_is_whole(tmp_path):
    path = tmp_path / "motion.csv"
    path.write_text("earlier")
    with whole(path) as draft:
        assert draft.suffix == ".csv"
        draft.write_text("new")
        assert path.read_text() == "earlier"
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]
    with pytest.raises(RuntimeError), whole(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_a_draft_is_written_through_no_link(tmp_path):
    path, other = tmp_path / "motion.csv", tmp_path / "other"
    other.write_text("precious")
    with whole(path) as draft:
        draft.write_text("earlier")
    draft.symlink_to(other)
    with whole(path) as draft:
        draft.write_text("new")
    assert other.read_text() == "precious" and path.read_text() == "new"


@pytest.mark.parametrize(
    ("error", "number", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), errno.ENOSPC, "No space left on device"),
        (OSError("20 requested and 3 written"), errno.EIO, "20 requested and 3 written"),
    ],
)
def test_what_the_system_refuses_carries_the_name_of_the_file(tmp_path, error, number, words):
    with pytest.raises(OSError) as raised, whole(tmp_path / "motion.csv"):
        raise error
    assert raised.value.filename == str(tmp_path / "motion.csv")
    assert (raised.value.errno, raised.value.strerror) == (number, words)


#: Writes rasters of 180 kB as the package does where no file may be larger than so many bytes, as on a full
#: disk; says which file each error names.
LIMITED = textwrap.dedent("""
    import resource, sys, warnings
    from pathlib import Path
    import numpy as np, rasterio
    from sightline.io.results.registered import optimise
    from sightline.writing import whole_raster

    warnings.simplefilter("ignore")
    folder = Path(sys.argv[1])
    pixels = np.random.default_rng(1).integers(0, 60000, (1, 300, 300)).astype("uint16")
    profile = {"driver": "GTiff", "height": 300, "width": 300, "count": 1, "dtype": "uint16"}
    forms = {
        "plain": {}, "tiled": {"tiled": True, "blockxsize": 256, "blockysize": 256},
        "packed": {"compress": "deflate"}, "cog": {"driver": "COG"}, "optimised": None,
    }
    with rasterio.open(folder / "draft", "w", **profile) as target:
        target.write(pixels)
    for name, form in forms.items():
        for limit in (20_000, 150_000, 179_000):
            path = folder / f"{name}-{limit}.tif"
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
            try:
                if form is None:
                    optimise(folder / "draft", path, np.dtype("uint16"))
                else:
                    with whole_raster(path) as draft:
                        with rasterio.open(draft, "w", **profile | form) as target:
                            target.write(pixels)
            except OSError as error:
                print(error.filename, flush=True)
""")


def test_a_raster_that_gdal_could_not_finish_is_no_file_and_an_error(tmp_path):
    """GDAL itself raises nothing where closing a file fails."""
    done = subprocess.run([sys.executable, "-c", LIMITED, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    forms, limits = ("plain", "tiled", "packed", "cog", "optimised"), (20_000, 150_000, 179_000)
    expected = [str(tmp_path / f"{form}-{limit}.tif") for form in forms for limit in limits]
    assert done.stdout.splitlines() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["draft"]


FORMS = {
    "plain": {},
    "tiled": {"tiled": True, "blockxsize": 256, "blockysize": 256},
    "big": {"bigtiff": "YES", "compress": "deflate"},
    "cog": {"driver": "COG", "blocksize": 128},
    "other end": {"endianness": "BIG"},
    "small": {"width": 3, "height": 2},
    "one block": {"blockysize": 300},
}


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("form", FORMS)
def test_a_raster_that_could_be_written_is_one_and_cut_by_a_byte_it_is_none(tmp_path, form):
    profile = {"driver": "GTiff", "height": 300, "width": 310, "count": 2, "dtype": "uint16"} | FORMS[form]
    shape = (2, profile["height"], profile["width"])
    pixels = np.random.default_rng(1).integers(0, 60000, shape).astype("uint16")
    path = tmp_path / "a.tif"
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        whole_raster(path) as draft,
        rasterio.open(draft, "w", **profile) as target,
    ):
        target.write(pixels)
        target.write_mask(pixels[0] > 100)
    with rasterio.open(path) as source:
        assert np.array_equal(source.read(), pixels)
    content = path.read_bytes()
    for length in {len(content) - 1, len(content) // 2, 20}:
        path.write_bytes(content[:length])
        assert not is_complete(path)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_picture_that_is_cut_is_none(tmp_path):
    path = tmp_path / "a.png"
    with (
        whole_raster(path) as draft,
        rasterio.open(draft, "w", driver="PNG", width=4, height=3, count=1, dtype="uint8") as target,
    ):
        target.write(np.arange(12, dtype=np.uint8).reshape(1, 3, 4))
    assert is_complete(path)
    path.write_bytes(path.read_bytes()[:-1])
    assert not is_complete(path)


def test_what_cannot_fit_is_refused_with_the_sizes(tmp_path):
    with pytest.raises(InputError, match=rf"{tmp_path}: the cube needs [0-9,]+ TB, .*B are free; take"):
        must_fit(tmp_path, 2**70, "the cube", "take less")
    must_fit(tmp_path, 1, "the cube", "take less")
    staged = tmp_path / ".partial-abcd1234" / "new" / "bands"
    staged.mkdir(parents=True)
    with pytest.raises(InputError, match=f"^{re.escape(str(tmp_path / 'bands'))}: the cube needs"):
        must_fit(staged, 2**70, "the cube", "take less")


def test_scratch_files_go_beside_the_result_unless_the_user_says_where(tmp_path, monkeypatch):
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.delenv(name, raising=False)
    with scratch_in(tmp_path), scratch_folder() as folder:
        assert folder.parent == tmp_path
    assert not folder.exists()
    (tmp_path / "chosen").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "chosen"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with scratch_in(tmp_path), scratch_folder() as folder:
        assert folder.parent == tmp_path / "chosen"
        full = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError) as raised, scratch_folder():
        raise full
    assert Path(raised.value.filename).parent == tmp_path / "chosen"


def resident(kind):
    """MiB of this process in memory of a kind, as Linux tells."""
    found = re.search(rf"{kind}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux alone tells of pages")
def test_pages_of_scratch_arrays_leave_the_memory_and_keep_what_they_hold(tmp_path):
    with scratch_in(tmp_path):
        array = scratch_array((40, 1 << 17))
        before = resident("RssAnon"), resident("RssFile")
        array[:] = np.arange(40.0)[:, None]
        # 40 MiB were written, to a file without name
        assert resident("RssAnon") - before[0] < 4 and resident("RssFile") - before[1] > 36
        let_go()
        assert resident("RssFile") - before[1] < 4
        np.testing.assert_array_equal(array[:, [0, -1]], np.tile(np.arange(40.0)[:, None], 2))
    assert not list(tmp_path.iterdir())


def test_a_scratch_array_is_of_zeros_and_one_that_has_no_room_is_a_clear_error(tmp_path, monkeypatch):
    for shape in ((0, 3), (5,), (300, 300)):
        assert not scratch_array(shape, np.float32).any()
    monkeypatch.delenv("TMPDIR", raising=False)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with scratch_in(tmp_path), pytest.raises(OSError, match="No space left") as caught:
        scratch_array((1 << 20,))
    assert caught.value.filename == str(tmp_path)


@pytest.mark.parametrize(
    ("given", "date"),
    [
        ("0", "1970-01-01T00:00:00"),
        ("1700000000", "2023-11-14T22:13:20"),
        ("253402300799", "9999-12-31T23:59:59"),
    ],
)
def test_the_date_of_a_file_is_that_of_the_environment(tmp_path, monkeypatch, given, date):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", given)
    assert f"{creation_date():%Y-%m-%dT%H:%M:%S}" == date
    write_aem(tmp_path / "a.aem", np.zeros(1), np.array([[0.0, 0.0, 0.0, 1.0]]), "2026-01-01T00:00:00Z")
    assert f"CREATION_DATE = {date}\n" in (tmp_path / "a.aem").read_text()


@pytest.mark.parametrize(
    "given", ["", " ", "-1", "1.5", "1e9", "now", "253402300800", "9" * 5000, "٣", "0x10"]
)
def test_a_date_that_is_none_is_one_clear_error(monkeypatch, given):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", given)
    with pytest.raises(InputError, match=r"SOURCE_DATE_EPOCH is .* whole seconds since 1970") as raised:
        creation_date()
    assert len(str(raised.value)) < 300


def test_without_it_the_date_is_that_of_today(monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert abs((creation_date() - datetime.now(UTC)).total_seconds()) < 60.0
    assert os.environ.get("SOURCE_DATE_EPOCH") is None
