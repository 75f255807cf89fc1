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
    with pytest.raises(EstimationError, match="10 limb points; 50 or more on the lit limb are needed"):
        axis = np.array([0.0, 0.0, 1.0])
        attitude_from_limb(outline(POSITION, 10), np.tile(POSITION, (10, 1)), RADII, (axis, axis))


def test_stated_sigmas_are_those_of_many_fits_and_a_pole_tells_no_turn():
    """Errors that neighbours share: eleven values of noise, even between, along half an outline."""
    rng = np.random.default_rng(5)
    truth = Rotation.from_rotvec([0.4, -0.8, 0.3])
    for place, least, most in ((POSITION, 0.0, 0.05), (np.array([3e6, 0.0, 1.6e8]), 0.1, 2.0)):
        rays = outline(place, 720)[:360]
        down = -place / np.linalg.norm(place)
        errors, sigmas = [], []
        for _ in range(12):
            knots = 1e-4 * rng.normal(size=11)
            shared = np.interp(np.linspace(0, 10, 360), np.arange(11), knots)[:, None]
            seen = (
                rays
                + shared * (rays - (rays @ down)[:, None] * down) / 0.4
                + 2e-5 * rng.normal(size=(360, 3))
            )
            seen = truth.inv().apply(seen / np.linalg.norm(seen, axis=1, keepdims=True))
            hint = np.array([0.0, 0.0, 1.0]), truth.apply([0.0, 0.0, 1.0])
            fit = attitude_from_limb(seen, np.tile(place, (360, 1)), RADII, hint)
            error = (fit.world_from_body * truth.inv()).as_rotvec()
            errors.append([*(error - (error @ down) * down), error @ down])
            sigmas.append([fit.sigma, fit.sigma_turn])
        across, about = np.square(errors)[:, :3].sum(axis=1) / 2.0, np.square(errors)[:, 3]
        assert least < np.median(sigmas, axis=0)[1] < most
        # 12 fits: chi-square of 24 and of 12, and sigmas of 12 sectors that are known to a third. Above the
        # pole what the turn is not known by, half a radian and more, leans on the place of the centre too
        assert (0.2 if most < 1.0 else 0.0) < np.mean(across / np.square(sigmas)[:, 0]) < 3.0
        if most < 1.0:
            assert 0.15 < np.mean(about / np.square(sigmas)[:, 1]) < 3.0
        else:
            assert np.median(np.sqrt(about) / np.array(sigmas)[:, 1]) < 2.0


def test_a_terminator_is_no_limb():
    """Points where the day ends, seen from the side: an ellipse that another attitude lays on an outline."""
    truth = Rotation.from_rotvec([0.2, 0.3, -0.5])
    rays = outline(POSITION, 720)
    down = -POSITION / np.linalg.norm(POSITION)
    sun = np.cross(down, [0.0, 0.0, 1.0])
    sun = sun / np.linalg.norm(sun) - 0.3 * down
    sun /= np.linalg.norm(sun)
    dark = rays @ (sun - (sun @ down) * down) < 0.0
    hint = np.array([1.0, 0.0, 0.0]), truth.apply([1.0, 0.0, 0.0])
    seen = truth.inv().apply(rays)
    for lit, refused in ((~dark, False), (dark, True)):
        given = seen[lit], np.tile(POSITION, (int(lit.sum()), 1)), RADII, hint, sun
        if refused:
            with pytest.raises(EstimationError, match="face away from the Sun: they lie on the terminator"):
                attitude_from_limb(*given)
        else:
            assert (truth.inv() * attitude_from_limb(*given).world_from_body).magnitude() < 1e-3


def test_an_outline_far_above_the_body_is_blooming():
    truth = Rotation.from_rotvec([0.2, 0.3, -0.5])
    seen = truth.inv().apply(outline(POSITION, 300, height=4e6))
    hint = np.array([1.0, 0.0, 0.0]), truth.apply([1.0, 0.0, 0.0])
    with pytest.raises(EstimationError, match=r"5.6 % of the radius above the body"):
        attitude_from_limb(seen, np.tile(POSITION, (300, 1)), RADII, hint)
