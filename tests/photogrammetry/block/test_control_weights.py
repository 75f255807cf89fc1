"""Control points that do not go with the others, where what others say of each is a Gaussian of its own."""

from __future__ import annotations

import numpy as np
import pytest

from photogrammetry.stereo_scene import QUIET, Plan, ground, shoot
from sightline.errors import EstimationError
from sightline.photogrammetry.block.control_weights import (
    AdjustedPlaces,
    _beside_rays,
    squared_misses,
    weighed_control,
)
from sightline.photogrammetry.block.point_priors import ControlPoints

SHAPES = np.array([np.diag([1.0, 4.0, 30.0]), np.diag([2.0, 2.0, 9.0])])


class Rays:
    """Places by the rays alone, (n, 3) with covariance: adjusted with control points by hand."""

    def __init__(self, seed: int, count: int = 9) -> None:
        rng = np.random.default_rng(seed)
        turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
        self.covariance = turns @ SHAPES[np.arange(count) % 2] @ turns.transpose(0, 2, 1)
        self.truth = rng.normal(0.0, 500.0, (count, 3))
        noise = np.einsum("nij,nj->ni", np.linalg.cholesky(self.covariance), rng.normal(size=(count, 3)))
        self.places = self.truth + noise

    def adjusted(self, control: ControlPoints, held: bool = True) -> AdjustedPlaces:
        places, covariance = self.places.copy(), self.covariance.copy()
        for point, where, sigma in zip(control.point, control.position, control.sigma, strict=True):
            by_rays = np.linalg.inv(self.covariance[point])
            both = np.linalg.inv(by_rays + np.eye(3) / sigma**2)
            places[point] = both @ (by_rays @ self.places[point] + where / sigma**2)
            if held:
                covariance[point] = both
        return AdjustedPlaces(places, covariance, held)


@pytest.mark.parametrize("held", [True, False])
def test_a_miss_is_that_of_the_rays_from_the_control_point_over_both_their_variances(held):
    rays, rng = Rays(1), np.random.default_rng(2)
    point, sigma = np.array([4, 0, 7, 2]), np.array([0.5, 2.0, 1.0, 5.0])
    control = ControlPoints(point, rays.truth[point] + rng.normal(0.0, 6.0, (4, 3)), sigma)
    weight = np.array([1.0, 0.4, 0.05, 0.8])
    used = ControlPoints(point, control.position, sigma / np.sqrt(weight))
    found = squared_misses(control, weight, rays.adjusted(used, held))
    for k, p in enumerate(point):
        off = rays.places[p] - control.position[k]
        both = rays.covariance[p] + sigma[k] ** 2 * np.eye(3)
        assert found[k] == pytest.approx(off @ np.linalg.solve(both, off) / 3.0, rel=1e-6)


def test_points_of_one_ray_and_of_none_are_judged_by_what_is_there():
    places = np.array([[13.0, -16.0, 5.0], [np.nan] * 3])
    control = ControlPoints(np.array([0, 1]), np.array([[10.0, -20.0, 5.0]] * 2), np.array([2.0, 1.0]))
    found = squared_misses(control, np.ones(2), AdjustedPlaces(places, np.full((2, 3, 3), np.nan), True))
    # two directions pull a place off a ray: 25 m^2 over 2 (2 m)^2; gross where it was left out
    assert found.tolist() == [pytest.approx(25.0 / 8.0), 1e6]


def test_control_points_lie_beside_the_rays_that_saw_them_by_their_distance_from_the_lines():
    rng = np.random.default_rng(3)
    points = ground(rng, 12, 11e3, 400.0, "smooth")
    sightings = shoot(Plan(shots=4), QUIET, points, rng, np.zeros((2, 3))).sightings(0.1)
    point = np.array([5, 2, 9])
    where = points[point] + rng.normal(0.0, 40.0, (3, 3))
    expected = []
    for n in range(len(sightings.point)):
        if sightings.point[n] in point:
            image = sightings.image[n]
            turn = sightings.world_from_body[image] @ sightings.body_from_camera[sightings.camera[image]]
            ray = turn @ np.append(sightings.tangents[n], 1.0)
            to = where[np.flatnonzero(point == sightings.point[n])[0]] - sightings.position[image]
            expected.append(np.linalg.norm(np.cross(ray, to)) / np.linalg.norm(ray))
    control = ControlPoints(point, where, np.full(3, 0.5))
    assert _beside_rays(sightings, control) == pytest.approx(np.median(expected), rel=1e-9)
    # never below the least sigma
    assert _beside_rays(sightings, ControlPoints(point, points[point], np.full(3, 0.5))) == 0.5


def test_a_wrong_control_point_weighs_less_and_is_named():
    rays, rng = Rays(4), np.random.default_rng(5)
    point = np.arange(9)[::-1]
    position = rays.truth[point] + rng.normal(0.0, 0.5, (9, 3))
    scene = shoot(Plan(shots=2), QUIET, rays.truth, rng).sightings(0.1)
    control = ControlPoints(point, position, np.full(9, 0.5))
    names = 100.0 + np.arange(9)

    def weighed(given):
        return weighed_control(scene, given, names, rays.adjusted(given), rays.adjusted)

    same, words = weighed(control)
    assert same is control and words == ()
    position[2] += 150.0
    wrong = ControlPoints(point, position, control.sigma)
    found, words = weighed(wrong)
    off = rays.places[6] - position[2]
    squared = off @ np.linalg.solve(rays.covariance[6] + 0.25 * np.eye(3), off) / 3.0
    # beyond four sigmas the fourth power of four over the miss
    assert found.sigma[2] == pytest.approx(0.5 * squared / 16.0, rel=1e-6)
    np.testing.assert_allclose(np.delete(found.sigma, 2), 0.5)
    assert len(words) == 1 and words[0].startswith("control point 106 at (")
    assert f"{np.sqrt(squared):.3g} of its sigmas" in words[0]
    position[:6] += 150.0
    with pytest.raises(EstimationError, match="6 of 9 control points do not go with the others"):
        weighed(ControlPoints(point, position, control.sigma))
