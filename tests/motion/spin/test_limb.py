"""Attitude from a limb, against outlines worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.motion.spin.limb import attitude_from_limb

RADII = (71_492e3, 66_854e3)


def outline(position: np.ndarray, count: int, height: float = 0.0) -> np.ndarray:
    """Unit vectors from `position` that touch the ellipsoid.

    In axes shrunk by its radii the body is a unit sphere, which a cone of half-angle asin(1 / distance)
    touches.
    """
    axes = np.array([RADII[0], RADII[0], RADII[1]]) + height
    p = position / axes
    distance = np.linalg.norm(p)
    down = -p / distance
    side = np.cross(down, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side)
    other = np.cross(down, side)
    phi = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[:, None]
    sine = 1.0 / distance
    ray = np.sqrt(1.0 - sine**2) * down + sine * (np.cos(phi) * side + np.sin(phi) * other)
    ray = ray * axes
    return ray / np.linalg.norm(ray, axis=1, keepdims=True)


POSITION = np.array([1.1e8, -4e7, 1.2e8])


def test_the_attitude_that_made_an_outline_is_found():
    truth = Rotation.from_rotvec([0.7, -1.1, 0.4])
    rays = outline(POSITION, 600, height=3e5)
    rng = np.random.default_rng(0)
    seen = truth.inv().apply(rays) + 2e-4 * rng.normal(size=(600, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    hint = np.array([0.0, 0.0, 1.0]), truth.apply([0.0, 0.0, 1.0]) + np.array([0.1, -0.1, 0.05])
    fit = attitude_from_limb(seen, np.tile(POSITION, (600, 1)), RADII, hint)
    error = (truth.inv() * fit.world_from_body).as_rotvec()
    down = truth.inv().apply(-POSITION / np.linalg.norm(POSITION))
    # 2e-4 rad over 600 points: 1.2e-5 across; about the line to the centre the flattening (a few hundredths
    # of a radius of 0.4 rad) tells a hundredth of that
    assert np.linalg.norm(error - (error @ down) * down) < 5e-5
    assert abs(error @ down) < 5e-3
    assert fit.height == pytest.approx(3e5, abs=3e4)
    assert fit.rms == pytest.approx(2e-4, rel=0.15)


def test_points_that_are_no_limb_are_left_out():
    truth = Rotation.from_rotvec([0.2, 0.3, -0.5])
    seen = truth.inv().apply(outline(POSITION, 300))
    seen[::10] += 0.01 * np.random.default_rng(1).normal(size=(30, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    hint = np.array([1.0, 0.0, 0.0]), truth.apply([1.0, 0.0, 0.0])
    fit = attitude_from_limb(seen, np.tile(POSITION, (300, 1)), RADII, hint)
    assert fit.kept <= 285 and fit.rms < 1e-4
    assert (truth.inv() * fit.world_from_body).magnitude() < 5e-3


def test_too_few_points_are_an_error():
    with pytest.raises(EstimationError, match="10 limb points; 50 or more are needed"):
        axis = np.array([0.0, 0.0, 1.0])
        attitude_from_limb(outline(POSITION, 10), np.tile(POSITION, (10, 1)), RADII, (axis, axis))
