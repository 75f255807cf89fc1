from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from tests.io.conftest import noise

from sightline.errors import GeometryError
from sightline.io.acquisition.describe import describe_acquisition
from sightline.io.acquisition.ground import shared_ground
from sightline.io.acquisition.load import load_acquisition


def test_lags_blind_frequencies_and_overlap_are_those_of_the_geometry(folder):
    said = describe_acquisition(load_acquisition(folder.write()))
    (pair,) = said["pairs"]
    # XS looks 140 m further: it sees the ground 140 / 7000 s = 20 ms before PAN, blind at multiples of 50 Hz
    assert pair["lag"] == pytest.approx(-0.02, abs=1e-6)
    assert pair["blind_frequencies"][:2] == pytest.approx([50.0, 100.0], rel=1e-4)
    assert said["shared_blind_frequencies"][:2] == pytest.approx([50.0, 100.0], rel=1e-4)
    assert any(line.startswith("together blind at 50, 100") for line in said["observable"])
    # 40 of 200 lines of PAN are not seen by XS; the grid has 65 lines
    assert pair["overlap"] == pytest.approx(0.8, abs=1 / 65)
    # parallax: 1 m of height between views 2e-4 apart: 2e-4 m = 2e-4 / 3.5 px
    assert pair["parallax"] == pytest.approx(2e-4 / 3.5, rel=0.01)
    assert any("lag -20 ms, 80 % common ground, blind at 50, 100" in line for line in said["observable"])


@pytest.mark.parametrize("columns", [3, 8])
def test_images_of_few_columns_share_what_they_share(folder, columns):
    acquisition = load_acquisition(folder.write())
    some = [
        camera.with_detector(replace(camera.detector, directions=camera.detector.directions[:columns]))
        for camera in acquisition.cameras
    ]
    # the edges of pixels count, not their middles: 80 % of the lines, all columns
    assert shared_ground(*some, acquisition.surface) == pytest.approx(0.8, abs=1 / 65)


def test_frequencies_below_one_period_of_the_strip_are_not_promised(folder):
    acquisition = load_acquisition(folder.write())
    t = acquisition.cameras[0].times([0.0, acquisition.cameras[0].lines - 1.0])
    said = describe_acquisition(acquisition)
    assert said["passbands"][0][0] == pytest.approx(1.0 / (t[1] - t[0]))


@pytest.mark.parametrize("coarse", [[1], [0], [0, 1]])
def test_frequencies_are_promised_up_to_a_quarter_of_the_coarser_line_rate(folder, coarse):
    acquisition = load_acquisition(folder.write())
    period = acquisition.cameras[0].detector.line_period
    cameras = tuple(
        camera.with_detector(replace(camera.detector, line_period=4.0 * period)) if k in coarse else camera
        for k, camera in enumerate(acquisition.cameras)
    )
    bands = tuple(
        replace(band, camera=camera) for band, camera in zip(acquisition.bands, cameras, strict=True)
    )
    said = describe_acquisition(replace(acquisition, bands=bands))
    assert said["highest_frequency"] == pytest.approx(0.25 / (4.0 * period))


def test_yaw_is_said_to_be_seen_worse_by_the_field(folder):
    said = describe_acquisition(load_acquisition(folder.write()))
    # edge of the field at 59.5 px: 1 px = 16807 urad; roll 5 urad: 3361 times
    assert any(
        "yaw: 16807 urad move the edge" in line and "3.36e+03 times" in line for line in said["observable"]
    )


def test_what_is_missing_is_named(folder):
    folder.replace('epoch = "2026-01-01T00:00:00Z"\n', "").add("[surface]\nheight_sigma = 20.0\n")
    missing = "\n".join(describe_acquisition(load_acquisition(folder.write()))["missing"])
    assert "epoch: without it no CCSDS file" in missing
    # 199 steps of 3.5 m from line to line
    assert (
        "a DEM: the height's sigma" in missing and "longer than some third of the strip, 0.696 km" in missing
    )
    assert "exact focal-plane offsets of XS" in missing
    assert "sigma_absolute is infinite" in missing


def test_what_is_assumed_is_said_to_be(folder):
    said = describe_acquisition(load_acquisition(folder.write()))
    assumed = "height = 0 and height_sigma = 0"
    assert f"ground: a plane, height known to 0 m (assumed: {assumed})" in said["understood"]
    assert any(line.startswith(f"[surface] {assumed}: not given but assumed") for line in said["missing"])
    folder.replace('00:00:00Z"', '00:00:00"').add("[surface]\nheight = 0.0\nheight_sigma = 0.0\n")
    said = describe_acquisition(load_acquisition(folder.write()))
    assert "t = 0 at 2026-01-01T00:00:00 (assumed: UTC, as it has no Z)" in said["understood"][0]
    assert not any("assumed" in line for line in said["understood"][1:] + said["missing"])


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_which_band_of_a_file_is_taken_is_said(folder):
    with rasterio.open(folder.path / "PAN.tif") as source:
        profile = source.profile | {"count": 3}
    with rasterio.open(folder.path / "XS.tif", "w", **profile) as target:
        target.write(np.stack([noise(k) for k in range(3)]))
    said = describe_acquisition(load_acquisition(folder.write()))["understood"]
    assert any(line.startswith("XS: ") and line.endswith("(XS.tif: band 1 of 3, uint16)") for line in said)
    assert not any("PAN.tif" in line for line in said)


def test_an_angle_in_degrees_shows_in_the_refusal(folder):
    folder.replace("look_ahead = 2e-4", "look_ahead = 0.2")
    # tan 0.2 of 700 km
    with pytest.raises(GeometryError, match=r"rad ahead.* 142 km from that of the nearest other.*in rad\?"):
        load_acquisition(folder.write())


def test_lags_are_between_the_middles_of_tdi_stages(folder):
    acquisition = load_acquisition(folder.write())
    period = acquisition.cameras[0].detector.line_period
    bands = tuple(
        replace(band, camera=replace(band.camera, stages=stages, time_reference="first-stage"))
        for band, stages in zip(acquisition.bands, (5, 21), strict=True)
    )
    (plain,) = describe_acquisition(acquisition)["pairs"]
    (pair,) = describe_acquisition(replace(acquisition, bands=bands))["pairs"]
    # the middles are exposed 2 and 10 lines after the first stages, and see the same ground as these
    assert pair["lag"] == pytest.approx(plain["lag"] + 8.0 * period, abs=1e-3 * period)
