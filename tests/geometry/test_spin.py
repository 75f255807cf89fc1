"""Spinning bodies against elementary rotations written out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.spin import Spin

RATE, EARTH = 6.0, 7.292115e-5


def about_y(angle):
    """Elementary right-handed turn about y: +z goes to +x."""
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


def about_z(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])


def test_a_spin_about_the_pitch_axis_sweeps_the_boresight_forward():
    spin = Spin(Rotation.identity(), [0, 2.0, 0], RATE)
    assert_allclose(spin.at(0.1).apply([0, 0, 1.0])[0], [np.sin(0.6), 0, np.cos(0.6)], atol=1e-15)


def test_axes_of_a_turning_world_are_left_behind_eastwards():
    """A body that stands still among the stars turns westwards over the ground: about z by minus the rate."""
    start = about_z(0.3) @ about_y(0.2)
    spin = Spin(Rotation.from_matrix(start), [0, 1.0, 0], RATE, world_rate=EARTH)
    t = 40.0
    expected = about_z(-EARTH * t) @ start @ about_y(RATE * t)
    assert_allclose(spin.at(t).as_matrix()[0], expected, atol=1e-12)


def test_the_table_of_a_spin_follows_it_between_its_rows():
    """Rows 0.02 rad apart: the cubic loses world_rate / rate * 4e-9 = 5e-14 rad, and rounding."""
    spin = Spin(Rotation.from_euler("ZYX", [0.4, 0.3, -0.2]), [0.6, 0.8, 0.0], RATE, world_rate=EARTH)
    trajectory = spin.trajectory([-1.0, 5.0], np.zeros((2, 3)), (-1.0, 5.0))
    t = np.linspace(-1.0, 5.0, 777)
    error = (trajectory.at(t).world_from_body.inv() * spin.at(t)).as_rotvec()
    assert np.abs(error).max() < 1e-12
    assert trajectory.span == (-1.0, 5.0)


@pytest.mark.parametrize("unknown", [0, 1, 2])
def test_departures_are_what_another_rate_and_another_axis_do(unknown):
    """Central differences of the closed form: their own error is step^2 = 1e-10."""
    axis, step, t = np.array([0.6, 0.0, 0.8]), 1e-5, np.linspace(-0.3, 0.4, 9)

    def turned(size):
        rate, other = RATE, axis
        if unknown == 0:
            rate += size
        else:
            first = np.cross(axis, [0.0, 1.0, 0.0])
            across = [first, np.cross(axis, first)][unknown - 1]
            other = axis + size * across
        phi = rate * t[:, np.newaxis]
        return Rotation.from_rotvec(phi * other / np.linalg.norm(other))

    measured = (turned(0.0).inv() * turned(step)).as_rotvec() - (
        turned(0.0).inv() * turned(-step)
    ).as_rotvec()
    claimed = Spin(Rotation.identity(), axis, RATE).departures(t)[:, :, unknown]
    assert_allclose(claimed, measured / (2 * step), atol=1e-8)


def test_impossible_spins_are_refused():
    with pytest.raises(InputError, match="`axis` of a spin has no length"):
        Spin(Rotation.identity(), [0, 0, 0.0], RATE)
    with pytest.raises(InputError, match="`rate_sigma` of a spin must be 0 or more, got -1"):
        Spin(Rotation.identity(), [0, 0, 1.0], RATE, rate_sigma=-1)
    with pytest.raises(InputError, match=r"the spin turns .* times .* check `rate`"):
        Spin(Rotation.identity(), [0, 0, 1.0], 1e6).trajectory([0.0, 9.0], np.zeros((2, 3)), (0.0, 9.0))


def test_an_adjusted_spin_differs_by_what_its_departures_and_the_turn_of_its_body_say():
    axis, t = np.array([0.48, -0.6, 0.64]), np.linspace(-0.3, 0.4, 9)
    spin = Spin(Rotation.from_euler("ZYX", [0.4, 0.3, -0.2]), axis, RATE, world_rate=EARTH)
    change = 1e-6 * np.array([2.0, -3.0, 1.5, 0.7, -1.1, 2.3])
    found = (spin.at(t).inv() * spin.adjusted(change).at(t)).as_rotvec()
    # the body is turned first, then it spins: in its axes of a later time the turn is R(-axis phi) times it
    back = Rotation.from_rotvec(-RATE * t[:, None] * axis)
    assert_allclose(found, spin.departures(t) @ change[:3] + back.apply(change[3:]), atol=1e-10)
