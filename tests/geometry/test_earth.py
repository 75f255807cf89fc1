"""Ellipsoids against pyproj, which shares no code with them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyproj import CRS, Transformer

from sightline.errors import InputError
from sightline.geometry.earth import (
    WGS84,
    fixed_from_inertial,
    from_geodetic,
    local_axes,
    to_geodetic,
)

MARS = (3396190.0, 3376200.0)


def pyproj_transformer(radii):
    geographic = CRS.from_dict({"proj": "longlat", "a": radii[0], "b": radii[1]}).to_3d()
    return Transformer.from_crs(geographic, CRS.from_dict({"proj": "geocent", "a": radii[0], "b": radii[1]}))


@pytest.mark.parametrize("radii", [WGS84, MARS, (1737400.0, 1737400.0)])
def test_geodetic_conversion_agrees_with_pyproj_from_mines_to_geostationary_orbit(radii):
    """1e-8 m at the surface; at 36,000 km rounding alone is 7e-9 m."""
    rng = np.random.default_rng(0)
    lon, lat = rng.uniform(-180, 180, 2000), np.degrees(np.arcsin(rng.uniform(-1, 1, 2000)))
    height = np.concatenate([rng.uniform(-1e4, 1e4, 1000), rng.uniform(1e4, 3.6e7, 1000)])
    expected = np.stack(pyproj_transformer(radii).transform(lon, lat, height), axis=1)
    geodetic = np.stack([np.deg2rad(lon), np.deg2rad(lat), height], axis=1)
    assert_allclose(from_geodetic(geodetic, radii), expected, rtol=0, atol=3e-8)
    back = to_geodetic(expected, radii)
    assert_allclose(back[:, :2], geodetic[:, :2], rtol=0, atol=3e-15)
    assert_allclose(back[:, 2], height, rtol=0, atol=3e-8)


def test_poles_and_the_date_line_are_ordinary_places():
    points = [[0, 0, WGS84[1] + 7.0], [0, 0, -WGS84[1]], [-WGS84[0], 0.0, 0.0], [WGS84[0] - 5.0, 0, 0]]
    geodetic = to_geodetic(points)
    assert_allclose(geodetic[:, 1], [np.pi / 2, -np.pi / 2, 0, 0], atol=1e-15)
    assert_allclose(geodetic[:, 2], [7.0, 0, 0, -5.0], atol=1e-8)
    assert geodetic[2, 0] == pytest.approx(np.pi)


def test_the_centre_lies_one_equatorial_radius_below_the_equator():
    assert_allclose(to_geodetic([[0.0, 0.0, 0.0]], WGS84), [[0.0, 0.0, -WGS84[0]]], atol=1e-9)


def test_a_missing_point_stays_missing():
    assert np.isnan(to_geodetic([[np.nan, 0, 0]])).any()


def test_local_up_is_the_normal_and_east_runs_along_the_parallel():
    place = np.array([[0.3, 0.8, 0.0]])
    axes = local_axes(0.3, 0.8)
    step = 1e-3
    up = (from_geodetic(place + np.array([0, 0, step])) - from_geodetic(place)) / step
    assert_allclose(axes.apply([0, 0, 1]), up[0], atol=1e-5)
    assert_allclose(axes.apply([1, 0, 0]), [-np.sin(0.3), np.cos(0.3), 0], atol=1e-15)
    assert local_axes([0.1, 0.2], [0.3, 0.4]).as_matrix().shape == (2, 3, 3)


def test_velocity_over_the_turning_earth_is_the_derivative_of_its_position():
    """By central differences over 2 s: the error of the third derivative is r w^3 / 6 = 1.5e-3 m/s."""
    t = np.array([-1.0, 0.0, 1.0])
    rate = 1.08e-3
    position = 7e6 * np.stack([np.cos(rate * t), np.zeros(3), np.sin(rate * t)], axis=1)
    velocity = 7e6 * rate * np.stack([-np.sin(rate * t), np.zeros(3), np.cos(rate * t)], axis=1)
    fixed, fixed_velocity = fixed_from_inertial(t, position, velocity, angle=0.7)
    assert_allclose((fixed[2] - fixed[0]) / 2.0, fixed_velocity[1], atol=2e-3)


def test_radii_in_kilometres_of_another_shape_are_refused():
    with pytest.raises(InputError, match="`radii` must be"):
        to_geodetic([[1.0, 0, 0]], radii=(6378137.0, 6356.7))
