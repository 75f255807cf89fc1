"""The ground that is found beside the one given: level points under a camera at a known height."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.geometry.earth import WGS84, from_geodetic
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.photogrammetry.flight.found_ground import found_heights, ground_warnings, level_ground

CAMERA, GROUND = 400.0, 300.0


def found(to_world, sigma_z):
    """Thirty points at 300 m under frames at 400 m; what a solution is asked for here."""
    rng = np.random.default_rng(1)
    spread = rng.uniform(-40.0, 40.0, (30, 2))
    points = to_world(np.column_stack([spread, np.full(30, GROUND) + rng.normal(0.0, 1.0, 30)]))
    position = to_world(np.column_stack([np.zeros(5), 10.0 * np.arange(5.0), np.full(5, CAMERA)]))
    covariance = np.tile(np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6]), (5, 1, 1)) * sigma_z**2
    return SimpleNamespace(points=points, position=position, covariance=covariance)


def flat(places):
    return places


def round_earth(places):
    """East, north (m, near the equator), height."""
    lonlat = places[:, :2] / WGS84[0]
    return from_geodetic(np.column_stack([lonlat, places[:, 2]]), WGS84)


@pytest.mark.parametrize(
    ("radii", "to_world", "given"), [(None, flat, Plane(0.0)), (WGS84, round_earth, Ellipsoid(*WGS84, 0.0))]
)
def test_wrong_ground_is_reported_with_the_height_that_was_found(radii, to_world, given):
    problem = SimpleNamespace(surface=given, radii=radii, height_sigma=0.0)
    poses = found(to_world, 2.0)
    # noise of 1 m over 30 points
    assert np.median(found_heights(problem, poses)) == pytest.approx(GROUND, abs=1.0)
    (words,) = ground_warnings(problem, poses)
    off = float(words.split("lies ")[1].split(" m above")[0])
    assert off == pytest.approx(GROUND, abs=1.0)
    assert level_ground(problem, poses).height == pytest.approx(GROUND, abs=1.0)
    # sigmas that allow it, of the poses or of the ground, and ground that is right
    assert not ground_warnings(problem, found(to_world, 200.0))
    assert not ground_warnings(SimpleNamespace(surface=given, radii=radii, height_sigma=150.0), poses)
    right = Plane(GROUND) if radii is None else Ellipsoid(*radii, GROUND)
    assert not ground_warnings(SimpleNamespace(surface=right, radii=radii, height_sigma=0.0), poses)


def test_few_points_say_nothing():
    problem = SimpleNamespace(surface=Plane(0.0), radii=None, height_sigma=0.0)
    poses = found(flat, 2.0)
    poses.points = poses.points[:5]
    assert not ground_warnings(problem, poses) and level_ground(problem, poses).height == 0.0
