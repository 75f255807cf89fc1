"""Where to match."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.source import ArrayImage
from sightline.matching.select import grid_points, select_points, spread_subset, texture_strength


def test_grid_windows_tile_the_image_and_stay_inside():
    points = grid_points((43, 210), window=(10, 100))
    assert len(points) == 4 * 2
    corners = points - [4.5, 49.5]
    assert (corners == np.rint(corners)).all()
    assert corners.min(axis=0).tolist() == [1, 5] and (corners + np.array([10, 100])).max(
        axis=0
    ).tolist() == [41, 205]
    assert len(grid_points((43, 210), window=(10, 100), step=(1, 100))) == 34 * 2


def test_an_image_smaller_than_the_window_has_no_points():
    assert grid_points((5, 300), window=(10, 100)).shape == (0, 2)
    with pytest.raises(InputError, match="whole numbers from 1"):
        grid_points((50, 300), step=(0, 10))


def test_a_slope_in_one_direction_is_no_texture_and_two_directions_are():
    y, x = np.mgrid[0:60, 0:80].astype(float)
    points = np.array([[30.0, 40.0]])
    assert texture_strength(ArrayImage(3 * y + 2 * x), points, (10, 20))[0] == pytest.approx(0, abs=1e-3)
    # a bowl y^2/2 + x^2/2: the weaker mean square gradient is that of lines, the variance of 10 integers
    centre = np.array([[29.5, 39.5]])
    bowl = ArrayImage(0.5 * (y - 29.5) ** 2 + 0.5 * (x - 39.5) ** 2)
    assert texture_strength(bowl, centre, (10, 20))[0] == pytest.approx(99 / 12, rel=1e-3)


def test_windows_with_unusable_pixels_or_outside_have_no_strength():
    rng = np.random.default_rng(0)
    array = rng.normal(size=(60, 80))
    array[30, 40] = np.nan
    points = np.array([[30.0, 40.0], [3.0, 40.0], [15.0, 60.0]])
    strength = texture_strength(ArrayImage(array), points, (10, 20))
    assert np.isnan(strength).tolist() == [True, True, False]


def test_the_subset_takes_from_every_cell_before_it_takes_second_bests():
    points = np.array([[0.0, 0], [0, 1], [0, 9], [9, 0], [9, 9], [9, 8]])
    strength = np.array([5.0, 6, 1, 2, np.nan, 3])
    assert spread_subset(points, strength, 4, (2, 2)).tolist() == [1, 2, 3, 5]
    assert spread_subset(points, strength, 5, (2, 2)).tolist() == [0, 1, 2, 3, 5]
    assert spread_subset(points, np.full(6, np.nan), 3, (2, 2)).tolist() == []


def test_selection_leaves_out_what_has_no_texture():
    rng = np.random.default_rng(0)
    array = rng.normal(size=(100, 300))
    array[40:70] = 1.0
    points = select_points(ArrayImage(array))
    assert len(points) and not ((points[:, 0] > 46) & (points[:, 0] < 63)).any()
    assert len(select_points(ArrayImage(array), count=4)) == 4
