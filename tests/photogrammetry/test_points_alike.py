"""What surfaces say of points: how many share one error, against drawn surfaces; how far above they are."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.earth import from_geodetic
from sightline.geometry.surface import level_surface
from sightline.photogrammetry.block.point_priors import HeightPrior
from sightline.photogrammetry.pair.relief import points_alike


@pytest.mark.parametrize("length", [30.0, 300.0])
def test_the_mean_of_a_drawn_surface_varies_by_that_many(length):
    rng = np.random.default_rng(0)
    area, count, draws = 900.0, 200, 1500
    place = np.column_stack([rng.uniform(0.0, length, count), rng.uniform(0.0, 30.0, count)])
    # heights as sums of waves: exp(-d^2 / (2 l^2)) has waves of normal numbers over l, 2 pi l^2 = area
    wave = rng.standard_normal((draws, 30, 2)) * np.sqrt(2.0 * np.pi / area)
    phase = rng.uniform(0.0, 2.0 * np.pi, (draws, 30, 1))
    height = np.sqrt(2.0 / 30) * np.cos(wave @ place.T + phase).sum(axis=1)
    # a variance from 1500 draws, to 3.7 per cent
    assert points_alike(place, area) == pytest.approx(count * (height.mean(axis=1) ** 2).mean(), rel=0.13)


def test_points_far_apart_stand_alone():
    assert points_alike(np.array([[0.0, 0.0], [1e6, 0.0], [0.0, 1e6]]), 900.0) == pytest.approx(1.0)
    assert points_alike(np.zeros((1, 2)), 900.0) == 1.0
    assert points_alike(np.zeros((5000, 2)), 900.0) == pytest.approx(5000.0)


def test_points_far_under_an_ellipsoid_are_under_it_by_as_much():
    # a camera in orbit may begin with points tens of kilometres under the ground
    radii = (6378137.0, 6356752.314245)
    heights = np.array([100.0, -5e3, -40e3, -300e3])
    points = from_geodetic(np.column_stack([np.full(4, 0.3), np.full(4, 0.5), heights]))
    above, slope = HeightPrior(level_surface(radii, 500.0), 1.0, radii).above(points)
    np.testing.assert_allclose(above, heights - 500.0, atol=1.0)  # of one ellipsoid's normal and the other's
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 1.0, atol=1e-3)
