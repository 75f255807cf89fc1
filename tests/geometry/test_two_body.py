"""Two-body arcs against circles, Kepler's third law and the integrals of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import GeometryError
from sightline.geometry.two_body import propagate, velocity_between

MU = 3.986004418e14


def test_a_circle_is_gone_round_in_its_period():
    radius = 7e6
    speed = np.sqrt(MU / radius)
    period = 2.0 * np.pi * np.sqrt(radius**3 / MU)
    t = period * np.array([0.0, 0.25, 0.5, 1.0])
    place, velocity = propagate([radius, 0.0, 0.0], [0.0, speed, 0.0], t, MU)
    np.testing.assert_allclose(place[:, :2] / radius, [[1, 0], [0, 1], [-1, 0], [1, 0]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), speed, rtol=1e-9)


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.3, np.sqrt(2.0), 1.8], ids=str)
def test_energy_and_angular_momentum_stay(factor):
    """Ellipses, the parabola (escape speed), a hyperbola."""
    start = np.array([7e6, 1e6, -2e6])
    direction = np.cross([0.2, -0.3, 1.0], start)
    speed = factor * np.sqrt(MU / np.linalg.norm(start))
    first = speed * direction / np.linalg.norm(direction)
    place, velocity = propagate(start, first, np.linspace(-3000.0, 9000.0, 13), MU)
    energy = 0.5 * (velocity**2).sum(axis=1) - MU / np.linalg.norm(place, axis=1)
    np.testing.assert_allclose(energy, 0.5 * first @ first - MU / np.linalg.norm(start), rtol=1e-9, atol=1e-3)
    turning = np.cross(place, velocity)
    np.testing.assert_allclose(turning, np.tile(np.cross(start, first), (13, 1)), rtol=1e-9)


@pytest.mark.parametrize("factor", [0.8, 1.2, 1.7])
def test_the_arc_between_two_places_is_that_which_joins_them(factor):
    start = np.array([7e6, 0.0, 1e6])
    velocity = factor * np.sqrt(MU / 7e6) * np.array([0.1, 0.9, 0.3])
    there, _ = propagate(start, velocity, [1200.0], MU)
    np.testing.assert_allclose(velocity_between(start, there[0], 1200.0, MU), velocity, rtol=1e-8)


def test_places_that_no_arc_joins_are_refused():
    with pytest.raises(GeometryError, match="no two-body arc"):
        velocity_between([7e6, 0.0, 0.0], [-7e6, 0.0, 0.0], 5.0, 1e30)
