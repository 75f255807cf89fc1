"""Velocity, slip and levers of columns against exact rays and small-angle formulas."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount, ScanMirror
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.simulate.instruments import instrument_case
from sightline.tdi.scan_columns import column_geometry, image_levers

FOCAL, PERIOD, COLUMNS, MIDDLE = 1e6, 1e-4, [0, 2000, 4000], 499.5


def camera(rates=(0.0, 0.0, 0.0), standing=(0.0, 0.0, 0.0), pointing=None, **detector) -> PushbroomCamera:
    """The prototype of the frozen conventions: 700 km, 7 km/s, 0.7 m, 100 us; strip centred on t = 0."""
    t = np.linspace(-1.0, 1.0, 9)
    motion = Motion(t, np.outer(t, rates) + np.asarray(standing))
    flight = Trajectory.level_flight(700e3, 7e3, -1.0, 1.0).with_motion(motion)
    row = LineDetector.from_ifov("PAN", 4001, 1.0 / FOCAL, PERIOD, **detector)
    return PushbroomCamera(row, flight, pointing or FixedMount(), -MIDDLE * PERIOD, 1000)


def test_frozen_signs_of_pitch_rate_and_yaw():
    """4.1: +100 urad/s of pitch: V 1.0100; +1 degree of yaw: slip -1.000 degree.

    The velocity is that along the column, cos(1 degree) of the speed.
    """
    assert_allclose(column_geometry(camera(), Plane(), COLUMNS).velocity, 1.0, atol=1e-9)
    assert_allclose(column_geometry(camera((0, 1e-4, 0)), Plane(), COLUMNS).velocity, 1.01, atol=1e-6)
    turned = column_geometry(camera(standing=(0, 0, np.radians(1.0))), Plane(), COLUMNS)
    assert_allclose(np.degrees(turned.slip), -1.0, atol=1e-4)
    assert_allclose(turned.velocity, np.cos(np.radians(1.0)), atol=1e-7)


def test_columns_stand_where_the_detector_puts_them():
    found = column_geometry(camera(look_ahead=-2e-3, offset_px=(0.0, 7.0)), Plane(), COLUMNS)
    assert found.focal_length_px == pytest.approx(FOCAL)
    assert_allclose(found.position_px[:, 0], [-1993.0, 7.0, 2007.0], atol=1e-6)
    # looking back is towards smaller lines of the nominal mount; tan(2e-3) F
    assert_allclose(found.position_px[:, 1], -FOCAL * np.tan(2e-3), rtol=1e-9)


MOUNTS = {
    "nominal": {},
    "oblique": {"pointing": FixedMount(NADIR_MOUNT * Rotation.from_euler("xyz", [0.2, -0.3, 0.4]))},
    "turned row": {"rotation": 0.3, "look_ahead": 0.1},
    "mirror": {
        "pointing": ScanMirror(
            Rotation.from_euler("xyz", [0.1, -1.4, 0.2]),
            [0.1, 1.0, 0.0],
            [1.0, 0.0, 1.0],
            [-1.0, 1.0],
            [0.0, 0.0],
        )
    },
}


@pytest.mark.parametrize("mount", MOUNTS)
def test_levers_are_those_of_exact_rays(mount):
    """A point that stands still, seen before and after a turn of 1e-6 rad: second order is 1e-6 of it."""
    one = camera(**MOUNTS[mount])
    levers, twist = image_levers(one, np.array(COLUMNS, dtype=float), one.times([MIDDLE]))
    points = one.rays(np.column_stack([[MIDDLE] * 3, COLUMNS]))
    far = points.origins + 9e5 * points.directions
    (ex, ey), step = one.detector.axis, one.detector.pixel_step
    for axis in range(3):
        small = np.zeros(3)
        small[axis] = 1e-6
        sides = []
        for sign in (1.0, -1.0):
            moved = one.with_trajectory(one.trajectory.with_motion(Motion.zero(-1, 1).shifted(sign * small)))
            sides.append(moved.camera_tangents(far, np.full(3, MIDDLE)))
        move = (sides[0] - sides[1]) / (2e-6 * step)
        across, along = ex * move[:, 0] + ey * move[:, 1], ey * move[:, 0] - ex * move[:, 1]
        assert_allclose(levers[:, 0, axis], across, atol=1e-5 * FOCAL)
        assert_allclose(levers[:, 1, axis], along, atol=1e-5 * FOCAL)
        # the twist turns what lies between the first column and the last; perspective adds x y F = 200 px/rad
        # at each end of a field of 0.002 that looks 0.1 ahead
        (ax, ay), (bx, by) = move[0], move[2]
        assert ey * (bx - ax) - ex * (by - ay) == pytest.approx(4000.0 * twist[axis], abs=450.0)


@pytest.mark.parametrize("axis", range(3))
def test_rates_through_the_levers_are_what_exact_rays_give(axis):
    """Levers: dV and d tan g are the line period times levers times rate.

    A rate of 1e-4 rad/s is 1 % of a px per line; second order is 1e-4 of it, and yaw averages to nothing over
    the strip but for a slip of its mean.
    """
    rates = np.zeros(3)
    rates[axis] = 1e-4
    still = column_geometry(camera(look_ahead=0.01), Plane(), COLUMNS)
    moved = column_geometry(camera(rates, look_ahead=0.01), Plane(), COLUMNS)
    expected = PERIOD * still.levers @ rates
    assert_allclose(moved.velocity - still.velocity, expected[:, 1], atol=2e-6)
    assert_allclose(np.tan(moved.slip) - np.tan(still.slip), expected[:, 0], atol=2e-6)


def test_what_is_not_known_of_attitude_and_rates_becomes_covariance():
    """By differences of exact rays: the covariance is their outer product, to second order of the step."""
    still = column_geometry(camera(rotation=0.02), Plane(), COLUMNS)
    sigma_yaw, sigma_rates = 1e-3, np.array([2e-5, 3e-5, 1e-3])
    expected = np.zeros((3, 2, 2))

    def add(**changed):
        moved = column_geometry(camera(rotation=0.02, **changed), Plane(), COLUMNS)
        d = np.stack([moved.velocity - still.velocity, moved.slip - still.slip], axis=1)
        expected.__iadd__(np.einsum("ci,cj->cij", d, d))

    add(standing=(0.0, 0.0, sigma_yaw))
    for axis in range(3):
        add(rates=tuple(np.eye(3)[axis] * sigma_rates))
    found = still.attitude_covariance([0, 0, sigma_yaw], sigma_rates)
    assert_allclose(found, expected, rtol=2e-2, atol=1e-3 * expected.max())
    for wrong in ([0, 0, -1.0], [0, 0], [0, 0, np.inf]):
        with pytest.raises(InputError, match="0 or more"):
            still.attitude_covariance(wrong, [0, 0, 0])


def test_scatter_over_the_strip_is_stated():
    """Pitch rate that grows by 2e-4 rad/s over the strip: V runs over 0.02, its scatter is 0.02/sqrt(12)."""
    t = np.linspace(-1.0, 1.0, 2001)
    motion = Motion(t, np.outer(0.5 * 2e-3 * t**2, [0, 1, 0]))
    one = camera()
    one = one.with_trajectory(one.trajectory.with_motion(motion))
    found = column_geometry(one, Plane(), [2000], lines=101)
    spread = 2e-3 * 1000 * PERIOD * FOCAL * PERIOD
    assert found.velocity_scatter[0] == pytest.approx(spread / np.sqrt(12.0), rel=0.02)
    assert found.velocity[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("case", ["pushbroom", "spin-leo", "mirror-leo", "staggered"])
def test_every_pushbroom_acquisition_has_columns(case):
    """Orbit over the turning Earth, spinning body, scan mirror: finite, and alike at neighbouring columns."""
    strip = instrument_case(case, 0, lines=200, columns=64)
    one, surface = strip.nominal_cameras[0], Ellipsoid()
    middle = one.columns // 2
    found = column_geometry(one, surface, [middle - 1, middle, middle + 1])
    assert np.isfinite(found.velocity).all() and np.isfinite(found.levers).all()
    assert_allclose(found.velocity, found.velocity[1], rtol=1e-3)


def test_a_column_that_is_not_there_and_ground_that_is_missed_are_refused():
    with pytest.raises(InputError, match="columns of this detector are 0 to 4000"):
        column_geometry(camera(), Plane(), [4001])
    with pytest.raises(GeometryError, match="column 0 does not meet the surface"):
        column_geometry(camera(), Plane(800e3), COLUMNS)
