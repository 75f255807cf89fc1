"""Image velocity and slip against small-angle formulas. Signs: ``tests/test_conventions.py``."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.scan import scan_velocity
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory

IFOV, PERIOD = 1e-6, 1e-4


def camera(rates=(0.0, 0.0, 0.0), **detector) -> PushbroomCamera:
    t = np.linspace(-1.0, 1.0, 9)
    flight = Trajectory.level_flight(700e3, 7e3, -1.0, 1.0)
    row = LineDetector.from_ifov("PAN", 4001, IFOV, PERIOD, **detector)
    return PushbroomCamera(row, flight.with_motion(Motion(t, np.outer(t, rates))), FixedMount(), -0.05, 1000)


def test_yaw_rate_changes_the_velocity_at_the_edges_in_opposite_senses():
    """V - 1 = T_e X yaw' with X the columns from the centre: 2000 px x 1e-2 rad/s x 1e-4 s = 0.002.

    Body yaw turns the larger columns (left) forward, so there the row overtakes the scene: faster.
    """
    seen = scan_velocity(
        camera(rates=(0, 0, 1e-2)), [[500.0, 0.0], [500.0, 2000.0], [500.0, 4000.0]], Plane()
    )
    assert_allclose(seen.velocity - 1.0, [-0.002, 0.0, 0.002], atol=1e-5)


def test_roll_rate_makes_the_scene_slip_towards_smaller_columns():
    """tan g = -T_e F roll' / V: 1e-4 s x 1e6 px x 1e-4 rad/s = 0.01."""
    seen = scan_velocity(camera(rates=(1e-4, 0, 0)), [[500.0, 2000.0]], Plane())
    assert np.tan(seen.slip[0]) == pytest.approx(-0.01, abs=1e-5)


def test_a_rotated_row_sees_the_scene_slip_by_its_rotation():
    """The row's own axes count: turned by +1 degree, the movement leans towards smaller columns."""
    seen = scan_velocity(camera(rotation=np.deg2rad(1.0)), [[500.0, 2000.0]], Plane())
    assert np.rad2deg(seen.slip[0]) == pytest.approx(-1.0, abs=1e-4)
    assert seen.velocity[0] == pytest.approx(1.0, abs=1e-5)


def test_ground_that_is_missed_has_no_velocity():
    assert np.isnan(scan_velocity(camera(), [[500.0, 2000.0]], Plane(800e3)).velocity).all()
