"""Sentinel-2 L1B granules: files of the tests, as none was at hand."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
import rasterio
from tests.sentinel2_files import write_granule

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.io.formats.products.recognise import read_product
from sightline.io.formats.products.sentinel2 import read_granule_times

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture
def granule(tmp_path):
    """Both metadata, and images of three bands where products have them."""
    paths = write_granule(tmp_path)
    (tmp_path / "IMG_DATA").mkdir()
    pixels = np.random.default_rng(5).integers(300, 900, (400, 240)).astype(np.uint16)
    profile = {"driver": "GTiff", "count": 1, "height": 400, "width": 240, "dtype": "uint16"}
    for band in ("B02", "B03", "B04"):
        with rasterio.open(tmp_path / "IMG_DATA" / f"S2A_X_D05_{band}.tif", "w", **profile) as target:
            target.write(pixels, 1)
    return paths


def test_lines_are_dated_by_the_stamps_of_the_granules_own_detector(tmp_path):
    times = read_granule_times(*write_granule(tmp_path))
    assert (times.detector, times.position) == ("05", 2305)
    # instants of one day are told to 1e-11 s
    expected = {"B02": 0.0, "B03": -0.527, "B04": -1.005, "B08": -0.264}
    assert times.lags == pytest.approx(expected, abs=1e-10)
    # 4.25 s, 2304 lines and a half of 1.5 ms; GPS is 18 s ahead of UTC
    assert times.epoch.startswith("2026-01-01T09:59:49.70675")
    assert times.line_period == pytest.approx(1.5e-3)
    assert times.height == pytest.approx(786e3, abs=1e-3)


def test_a_granule_and_its_datastrip_become_an_acquisition(granule, tmp_path, capsys):
    out = tmp_path / "acq"
    assert run(["init", *map(str, granule), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "where columns look: in calibration files (GIPP)" in said and "epoch: when" not in said
    toml = tomllib.loads((out / "acquisition.toml").read_text())
    assert toml["acquisition"]["epoch"].startswith("2026-01-01T09:59:49.70675")
    assert [band["name"] for band in toml["band"]] == ["B02", "B03", "B04"]
    assert [band["first_line_time"] for band in toml["band"]] == pytest.approx([0, -0.527, -1.005], abs=1e-7)
    assert toml["band"][1]["look_ahead"] > 0.0  # exposed before: it looks ahead
    assert run(["check", str(out / "acquisition.toml")]) in (0, 1)
    assert "B04" in capsys.readouterr().out


def test_a_granule_finds_its_datastrip_where_products_have_it(granule, tmp_path, capsys):
    """GRANULE/.../, DATASTRIP/.../ of unit C, whose detectors are numbered 5 and not 05."""
    tile = tmp_path / "P.SAFE" / "GRANULE" / "S2C_GR"
    strip = tmp_path / "P.SAFE" / "DATASTRIP" / "S2C_DS"
    tile.mkdir(parents=True)
    strip.mkdir(parents=True)
    for path, folder in zip(granule, (tile, strip), strict=True):
        text = path.read_text().replace("S2A_OPER", "S2C_OPER").replace('detectorId="05"', 'detectorId="5"')
        (folder / path.name.replace("S2A", "S2C")).write_text(text)
    (tmp_path / "IMG_DATA").rename(tile / "IMG_DATA")
    assert run(["init", str(tile), "--out", str(tmp_path / "acq")]) == 0
    toml = tomllib.loads((tmp_path / "acq" / "acquisition.toml").read_text())
    assert [band["first_line_time"] for band in toml["band"]] == pytest.approx([0, -0.527, -1.005], abs=1e-7)
    assert run(["init", str(tmp_path / "P.SAFE"), "--out", str(tmp_path / "acq2")]) == 2
    assert "it holds DATASTRIP/S2C_DS/S2C_" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ({"granule": ("S20260101T095900_N", "S20260102T000000_N")}, "is not the datastrip of"),
        ({"granule": ("<DETECTOR_ID>05", "<DETECTOR_ID>07")}, "has 0 Detector 07; one is needed"),
        ({"granule": ("2305", "0")}, "a whole number from 1"),
        ({"datastrip": ('unit="ms"', 'unit="us"')}, "units that are read: ms, s"),
        ({"datastrip": ('bandId="7"', 'bandId="9"')}, "bandId='7'] is missing"),
        ({"datastrip": ("00:03.245", "10:03.245")}, "puts B04 599 s"),
        ({"datastrip": (">1</REF", ">2305</REF")}, "is not the first line"),
        ({"datastrip": ('unit="mm"', 'unit="m"')}, "m above the ellipsoid"),
        ({"datastrip": ("<?xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><?xml")}, "declares entities"),
    ],
)
def test_what_is_wrong_is_named(texts, said, tmp_path):
    with pytest.raises(FormatError, match=said.replace("[", r"\[")):
        read_granule_times(*write_granule(tmp_path, **texts))


def test_no_model_is_made_and_both_metadata_are_asked_for(granule, tmp_path, capsys):
    with pytest.raises(FormatError, match="not where columns look"):
        read_product(granule[1])
    (tmp_path / "elsewhere").mkdir()
    for path in [path.rename(tmp_path / "elsewhere" / f"{path.stem[-6:]}.xml") for path in granule]:
        assert run(["init", str(path), "--out", str(tmp_path / "acq")]) == 2
        assert "give the metadata of one granule" in capsys.readouterr().err
