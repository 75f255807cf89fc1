"""Detectors: directions of pixels, adjustments, lens distortion against OpenCV."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError
from sightline.geometry.instrument import AreaDetector, Instrument, LineDetector

LENS = (-0.21, 0.06, 1.1e-3, -6e-4, 0.012)


def row(**options) -> LineDetector:
    return LineDetector.from_ifov("PAN", 1001, 5e-6, 5e-4, **options)


def test_a_straight_row_has_the_tangents_of_its_definition():
    detector = row(look_ahead=0.2, offset_px=(1.5, -2.5), rotation=0.01)
    step = np.arange(1001) - 500.0
    x, y = detector.tangents.T
    assert_allclose(x, 5e-6 * (step * np.cos(0.01) - 2.5), atol=1e-16)
    assert_allclose(y, np.tan(0.2) + 5e-6 * (step * np.sin(0.01) + 1.5), atol=1e-16)
    assert detector.pixel_step == pytest.approx(5e-6, rel=1e-12)
    assert detector.is_straight


@pytest.mark.parametrize("columns", [2, 3, 1000, 1001])
def test_adjusting_equals_building_with_the_offset_and_rotation(columns):
    built = LineDetector.from_ifov("B", columns, 5e-6, 5e-4, 0.3, (0.8, -0.6), 2e-3)
    adjusted = LineDetector.from_ifov("B", columns, 5e-6, 5e-4, 0.3).adjusted(0.8, -0.6, 2e-3)
    assert_allclose(adjusted.directions, built.directions, atol=1e-15)


def test_directions_between_and_beyond_columns_continue_the_row():
    detector = row(rotation=0.05)
    tangent = detector.directions_at([-50.0, 0.25, 999.9, 1050.0])
    step = np.array([-50.0, 0.25, 999.9, 1050.0]) - 500.0
    assert_allclose(tangent[:, 0] / tangent[:, 2], 5e-6 * step * np.cos(0.05), atol=1e-15)
    assert np.isnan(detector.directions_at([np.nan])).all()


def test_a_bent_row_is_interpolated_by_cubics():
    x = np.linspace(-1, 1, 101)
    bent = np.stack([1e-3 * x, 1e-5 * x**3, np.ones_like(x)], axis=1)
    detector = LineDetector("bent", bent / np.sqrt((bent**2).sum(axis=1, keepdims=True)), 1e-3)
    place = 33.4
    direction = detector.directions_at([place])[0]
    assert direction[1] / direction[2] == pytest.approx(1e-5 * (-1 + place / 50) ** 3, abs=1e-17)
    assert not detector.is_straight
    assert detector.rough_columns.size == 0


@pytest.mark.parametrize("step", [[0.3, 0.0], [0.0, 0.3]], ids=["along", "across"])
def test_columns_are_rough_where_two_ccds_meet(step):
    tangents = 5e-6 * np.stack([np.arange(101.0) - 50.0, 0.02 * np.arange(101.0)], axis=1)
    tangents[40:] += 5e-6 * np.array(step)
    looks = np.column_stack([tangents, np.ones(101)])
    detector = LineDetector("two", looks / np.linalg.norm(looks, axis=1, keepdims=True), 1e-3)
    # columns 39 and 40 depart from the run of those beside them
    assert detector.rough_columns.tolist() == [39.0, 40.0]


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        ([[0, 0, 1.0]], "two or more unit vectors"),
        ([[0, 0, -1.0], [0.1, 0, -0.99]], "z > 0"),
        ([[0, 0, 2.0], [0.1, 0, 2.0]], "unit vectors"),
        ([[0, 0, 1.0], [2e-3, 0, 1.0], [1e-3, 0, 1.0]], "turn back after column 1"),
    ],
)
def test_directions_that_are_no_row_are_refused(directions, message):
    with pytest.raises(InputError, match=message):
        LineDetector("odd", directions, 1e-3)


def test_degrees_given_for_radians_are_noticed_where_they_can_be():
    with pytest.raises(InputError, match="within 90 degrees"):
        row(look_ahead=20.0)
    with pytest.raises(InputError, match="`columns` must be a whole number of 2 or more"):
        LineDetector.from_ifov("B", 1, 5e-6, 1e-3)
    with pytest.raises(InputError, match="`line_period` must be positive"):
        LineDetector.from_ifov("B", 10, 5e-6, 0.0)


def test_distortion_agrees_with_opencv():
    cv2 = pytest.importorskip("cv2", reason="opencv is not installed")
    detector = AreaDetector("frame", (1200, 1600), 1500.0, (610.0, 790.0), LENS)
    directions = np.random.default_rng(0).uniform([-0.4, -0.3, 1], [0.4, 0.3, 1], (200, 3))
    matrix = np.array([[1500.0, 0, 790.0], [0, 1500.0, 610.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), matrix, np.array(LENS))
    assert_allclose(detector.pixels(directions)[:, ::-1], expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("distortion", [(), (-0.1,), LENS[:4], LENS])
def test_undistorting_undoes_distorting_to_a_ten_thousand_millionth_of_a_pixel(distortion):
    detector = AreaDetector("frame", (1200, 1600), 1500.0, (610.0, 790.0), distortion)
    pixels = np.random.default_rng(1).uniform([0, 0], [1199, 1599], (500, 2))
    assert_allclose(detector.pixels(detector.directions(pixels)), pixels, rtol=0, atol=1e-10)


def test_a_point_far_outside_does_not_fold_back_into_the_frame():
    """With k1 = -0.4 the distorted radius turns back at r = sqrt(1 / 1.2) = 0.913; beyond nothing is seen."""
    detector = AreaDetector("frame", (600, 600), 1000.0, (300.0, 300.0), (-0.4,))
    seen = detector.pixels([[0.9, 0.0, 1.0], [1.6, 0.0, 1.0]])
    assert np.isfinite(seen[0]).all() and np.isnan(seen[1]).all()


def test_a_point_behind_the_camera_has_no_pixel():
    detector = AreaDetector("frame", (100, 100), 100.0, (50.0, 50.0))
    assert np.isnan(detector.pixels([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": (0, 10)}, "both positive"),
        ({"focal_length_px": -1.0}, "`focal_length_px` must be positive"),
        ({"distortion": (1, 2, 3, 4, 5, 6)}, "at most 5 numbers"),
        ({"wavelength_nm": [500.0]}, r"one value per line, shape \(100,\): got \(1,\)"),
        ({"principal_point_px": (np.nan, 0.0)}, "`principal_point_px` must be 2 finite numbers"),
    ],
)
def test_impossible_area_detectors_are_refused(change, message):
    parts = {"name": "f", "shape": (100, 100), "focal_length_px": 1e3, "principal_point_px": (50.0, 50.0)}
    with pytest.raises(InputError, match=message):
        AreaDetector(**(parts | change))


def test_an_instrument_gives_its_detectors_by_name():
    instrument = Instrument("camera", (row(),))
    assert instrument["PAN"].columns == 1001
    with pytest.raises(InputError, match="has no detector 'RED'; it has: PAN"):
        instrument["RED"]
    with pytest.raises(InputError, match=r"need different names: \['PAN'\] repeat"):
        Instrument("camera", (row(), row()))
