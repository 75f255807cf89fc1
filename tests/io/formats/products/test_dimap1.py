"""DIMAP 1 of SPOT 5, level 1A: the model against the tie points that the file itself gives."""

from __future__ import annotations

import numpy as np
import pytest

import maker_files as maker
from sightline.errors import FormatError
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.dimap1 import doris_orbit
from sightline.io.formats.products.recognise import read_product
from sightline.io.formats.products.tree import read_xml


def left(product, line=0.0):
    """m between tie points and where the model sees them, `line` lines later."""
    marks = product.marks
    pixels = np.array([[mark.line + line, mark.column] for mark in marks])
    seen = maker.geodetic(product.model.camera.locate(pixels, Ellipsoid(height=0.0)))
    apart = np.radians([[mark.longitude, mark.latitude] for mark in marks]) - np.radians(seen[:, :2])
    return np.hypot(apart[:, 0] * np.cos(np.radians(seen[:, 1])), apart[:, 1]) * 6.39e6


@pytest.fixture(scope="module")
def spot_5(real_data):
    """The file of SPOT 5, and what is read of it."""
    path = real_data("vendor_models") / "spot_example1.xml"
    return path, read_product(path)


def test_the_model_of_spot_5_meets_its_tie_points(spot_5):
    product = spot_5[1]
    assert left(product).max() < 0.1  # they round to 1e-6 degrees, 0.11 m
    assert left(product, 0.5).min() > 1.5  # half a line is 2.5 m along the track
    assert {mark.column for mark in product.marks} == {0.0}  # those of column 12000 are not of this image


def test_what_was_cut_is_said(spot_5):
    doubts = " ".join(spot_5[1].model.doubts)
    assert "NCOLS is 300, but SCENE_CENTER_COL is 6001 and TIE_POINT_DATA_X is 12000" in doubts
    assert "attitude begins 0.0162 s after the first line" in doubts
    assert "ends 0.1763 s before the last line (1.4 steps)" in doubts


def test_points_of_doris_are_labelled_in_tai(spot_5):
    path, product = spot_5
    data = read_xml(path, "metadata")
    doris = doris_orbit(data, product.epoch)
    at = product.model.camera.trajectory.at(doris.t[(doris.t > 0) & (doris.t < 72)]).position
    apart = np.linalg.norm(at - doris.position[(doris.t > 0) & (doris.t < 72)], axis=1)
    assert apart.max() < 0.05  # 33 s would be 230 km


def test_a_written_product_meets_its_tie_points(tmp_path):
    product = read_product(maker.dimap1(tmp_path))
    # rows of positions every 30 s leave 1 mm, labels of attitudes a microsecond
    assert left(product).max() < 0.02
    assert left(product, 0.5).min() > 10.0  # half a line of 7.5 ms is 25 m
    assert product.bands[0].name == "PAN"
    assert product.bands[0].image == "IMAGERY.TIF"  # without the folders of the machine that wrote it
    assert product.model.one_grid is None
    assert not product.model.lacks


def test_attitudes_are_continued_evenly_and_not_held(tmp_path):
    product = read_product(maker.dimap1(tmp_path, rows=140))
    assert any("ends 0.17" in line or "ends 0.1" in line for line in product.model.doubts)
    assert (
        left(product).max() < 0.02
    )  # held at the last record they would be 3e-5 rad/s 0.15 s 7e5 m = 3 m off


REFUSED = {
    "looks that end before the columns": (
        [("<NCOLS>60", "<NCOLS>90")],
        "detectors 1 to 60, but NCOLS is 90: 30 columns from column 61 on have no look",
    ),
    "degrees": ([("<YAW>0.00", "<YAW>2.00")], "holds an angle of 2.0.*; radians are read"),
    "another level": ([(">1A<", ">2A<")], "level 2A; of level 1A"),
    "no number": ([("<TAI_TUC>33", "<TAI_TUC>x")], "TAI_TUC is 'x', no number"),
    "no looks": ([("Instrument_Look_Angles>", "Other>")], "SPOT 1 to 4 describe looks otherwise"),
    "fewer records": ([("<OUT_OF_RANGE>N", "<OUT_OF_RANGE>Y")], "has 0 records within range"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_named(tmp_path, case):
    changes, words = REFUSED[case]
    with pytest.raises(FormatError, match=words):
        read_product(maker.dimap1(tmp_path, changes=changes))


def test_doris_of_another_pass_is_said(tmp_path):
    product = read_product(maker.dimap1(tmp_path, changes=[("<TAI_TUC>33", "<TAI_TUC>32")]))
    assert any("points of DORIS" in line and "off the ephemeris" in line for line in product.model.doubts)


def test_bands_with_looks_of_their_own_have_cameras_of_their_own(tmp_path):
    path = maker.dimap1(tmp_path, ahead=(0.0, 2e-3, -1e-3))
    cameras = [read_product(path, None, band).model.camera for band in (1, 2, 3)]
    ahead = [camera.detector.tangents[:, 1].mean() for camera in cameras]
    # tangents of .020 and .022 and .019 rad, in the axes that look down the middle of all
    np.testing.assert_allclose(np.abs(np.diff(ahead)), [2e-3, 3e-3], rtol=2e-3)
    ground = Ellipsoid(height=0.0)
    first, later = (camera.locate([[40.0, 30.0]], ground)[0] for camera in cameras[:2])
    # 692 km above the ellipsoid, and a little more at .1 rad
    assert np.linalg.norm(first - later) == pytest.approx(2e-3 * 692e3, rel=0.03)
    assert read_product(path).model.one_grid is None
    with pytest.raises(FormatError, match="has no table of band 4, but of 1, 2, 3"):
        read_product(path, None, 4)


def test_bands_that_share_looks_and_times_cannot_tell_motion(tmp_path):
    grid = read_product(maker.dimap1(tmp_path, ahead=(0.0, 0.0))).model.one_grid
    assert "one table of looks and one time for each line" in grid.reason
