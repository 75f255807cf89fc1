"""Every line of ``docs/conventions.md`` as a number: one test per line of its table.

The set-up of the numbers: 700 km altitude, 7 km/s over a flat Earth, flying north, 0.7 m pixels (1 urad),
line period 100 us, a row of 1801 columns (a field of 1.26 km).
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.estimation.prior import Matern, Spectrum
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import from_geodetic, local_axes
from sightline.geometry.instrument import AreaDetector, LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import (
    NADIR_MOUNT,
    from_quat_xyzw,
    from_roll_pitch_yaw,
    to_quat_xyzw,
    to_roll_pitch_yaw,
)
from sightline.geometry.scan import scan_velocity
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.matching.matches import Matches
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.measure.predict import residuals

ALTITUDE, SPEED, IFOV, PERIOD, COLUMNS = 700e3, 7e3, 1e-6, 1e-4, 1801
MIDDLE = (COLUMNS - 1) / 2
TURN = 1e-5  # 10 urad
ROLL, PITCH, YAW = np.eye(3)


def camera(angles=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), look_ahead=0.0) -> PushbroomCamera:
    """The camera of the set-up, with constant departures (rad) and rates (rad/s) of the body."""
    flight = Trajectory.level_flight(ALTITUDE, SPEED, -1.0, 1.0)
    t = np.linspace(-1.0, 1.0, 5)
    motion = Motion(t, np.asarray(angles) + t[:, np.newaxis] * np.asarray(rates))
    detector = LineDetector.from_ifov("PAN", COLUMNS, IFOV, PERIOD, look_ahead=look_ahead)
    return PushbroomCamera(detector, flight.with_motion(motion), FixedMount(), 0.0, 1000)


def footprint(**turns) -> np.ndarray:
    """Ground point under the boresight at t = 0."""
    return camera(**turns).locate([[0.0, MIDDLE]], Plane())[0]


def image_of_fixed_point(column: float, **turns) -> np.ndarray:
    """How far (line, column) the image of a fixed ground point moves when the body turns."""
    start = [[500.0, column]]
    point = camera().locate(start, Plane())
    return (camera(**turns).project(point) - start)[0]


def test_a_time_within_a_day_is_resolved_to_a_hundredth_of_a_nanosecond():
    """float64 steps at one day, one year, twenty years."""
    day, year = 86400.0, 365.25 * 86400.0
    assert np.spacing(day) == pytest.approx(1.5e-11, rel=0.05)
    assert np.spacing(year) == pytest.approx(3.7e-9, rel=0.05)
    assert np.spacing(20 * year) == pytest.approx(1.2e-7, rel=0.05)


def test_a_line_is_exposed_at_first_line_time_plus_line_periods():
    """Line 0 at 0 s; half a line is half a period later, because the time is that of the line's centre."""
    assert_allclose(camera().times([0.0, 10.0, 0.5]), [0.0, 1e-3, 5e-5], atol=1e-18)


def test_the_lag_is_the_time_in_b_minus_the_time_in_a():
    """Band a looks 1 mrad ahead of band b and sees a point 1e-3 H / V earlier."""
    point = np.array([[0.0, 350.0, 0.0]])
    b = camera()
    a = PushbroomCamera(camera(look_ahead=1e-3).detector, b.trajectory, b.pointing, -0.1, 1000)
    lag = b.times(b.project(point)[:, 0]) - a.times(a.project(point)[:, 0])
    assert lag[0] == pytest.approx(0.1000, abs=1e-7)

    differences = AngleDifferences(
        t=np.array([0.0]), lag=lag, angles=np.array([[1e-6, 0.0, 0.0]]), covariance=np.eye(3)[np.newaxis]
    )
    roll_rate = Motion([-1.0, 1.0], [[-1e-5, 0.0, 0.0], [1e-5, 0.0, 0.0]])
    assert_allclose(
        roll_rate.at(differences.t + differences.lag) - roll_rate.at(differences.t),
        differences.angles,
        atol=1e-12,
    )


def test_a_pixel_is_line_then_column_and_an_integer_is_its_centre():
    """The middle of 1801 columns is column 900; half a pixel is 0.35 m."""
    points = camera().locate([[0.0, 900.0], [0.0, 900.5], [0.5, 900.0]], Plane())
    assert_allclose(points, [[0, 0, 0], [-0.35, 0, 0], [0, 0.35, 0]], atol=1e-6)


def test_points_have_their_components_along_the_last_axis():
    points = camera().locate(np.zeros((7, 2)), Plane())
    assert points.shape == (7, 3)
    assert camera().project(points).shape == (7, 2)


def test_a_local_world_is_east_north_up():
    """And the world of a spacecraft is WGS 84 Earth-centred, as another package converts it."""
    pose = camera().trajectory.at([0.0, 1.0])
    assert_allclose(pose.position, [[0, 0, ALTITUDE], [0, SPEED, ALTITUDE]])
    axes = local_axes(0.0, 0.0).as_matrix()
    assert_allclose(axes.T, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-15)
    to_ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    ours = from_geodetic([[np.deg2rad(5.0), np.deg2rad(44.0), 100.0]])[0]
    assert_allclose(ours, to_ecef.transform(5.0, 44.0, 100.0), atol=1e-8)


def test_positive_roll_looks_left_and_positive_pitch_looks_forward():
    """10 urad x 700 km = 7.0 m: right wing down looks west, nose up looks north."""
    north, east, down = [0, 1, 0], [1, 0, 0], [0, 0, -1]
    assert_allclose(
        camera().trajectory.at(0.0).world_from_body.apply(np.eye(3)), [north, east, down], atol=1e-15
    )
    assert_allclose(footprint(angles=TURN * ROLL), [-7.0, 0, 0], atol=1e-3)
    assert_allclose(footprint(angles=TURN * PITCH), [0, 7.0, 0], atol=1e-3)
    assert_allclose(footprint(angles=TURN * YAW), [0, 0, 0], atol=1e-6)


def test_camera_axes_follow_columns_lines_and_the_scene():
    detector = AreaDetector("frame", (100, 200), 1000.0, (50.0, 100.0))
    centre, next_column, next_line = detector.directions([[50.0, 100.0], [50.0, 101.0], [51.0, 100.0]])
    assert_allclose(centre, [0, 0, 1])
    assert_allclose(next_column / next_column[2], [1e-3, 0, 1])
    assert_allclose(next_line / next_line[2], [0, 1e-3, 1])
    row = LineDetector.from_ifov("B", 11, IFOV, PERIOD, offset_px=(3.0, 2.0), rotation=0.1)
    assert_allclose(row.tangents[5], [2e-6, 3e-6], atol=1e-18)
    assert row.tangents[10, 1] > row.tangents[0, 1], "a rotated row looks further forward at larger columns"


def test_the_nominal_mount_moves_a_fixed_point_as_stated():
    """Lines forward, columns left; the image of a fixed ground point against the turn of the body.

    900 px from the centre 10 urad of yaw are 0.009 px; larger columns then look further forward.
    """
    matrix = NADIR_MOUNT.as_matrix()
    assert_allclose(matrix.T, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    corner = camera().locate([[0, MIDDLE], [1, MIDDLE], [0, MIDDLE + 1]], Plane())
    assert_allclose(corner[1] - corner[0], [0, 0.7, 0], atol=1e-6)
    assert_allclose(corner[2] - corner[0], [-0.7, 0, 0], atol=1e-6)
    assert_allclose(image_of_fixed_point(MIDDLE, angles=TURN * ROLL), [0, -10.0], atol=1e-3)
    assert_allclose(image_of_fixed_point(MIDDLE, angles=TURN * PITCH), [-10.0, 0], atol=1e-3)
    assert_allclose(image_of_fixed_point(COLUMNS - 1, angles=TURN * YAW), [-0.009, 0], atol=1e-6)
    assert_allclose(image_of_fixed_point(MIDDLE, angles=TURN * YAW), [0, 0], atol=1e-8)
    assert_allclose(image_of_fixed_point(0, angles=TURN * YAW), [0.009, 0], atol=1e-6)


def test_a_rotation_takes_source_vectors_to_target_vectors():
    """NADIR_MOUNT is body_from_camera: camera +y is body +x, and products cancel from the inside."""
    assert_allclose(NADIR_MOUNT.apply([0, 1, 0]), [1, 0, 0], atol=1e-15)
    world_from_body = camera().trajectory.at(0.0).world_from_body[0]
    world_from_camera = world_from_body * NADIR_MOUNT
    assert_allclose(world_from_camera.apply([0, 1, 0]), [0, 1, 0], atol=1e-15)


def test_quaternions_are_scalar_last():
    quarter_turn_about_z = [[0, 0, np.sqrt(0.5), np.sqrt(0.5)]]
    assert_allclose(from_quat_xyzw(quarter_turn_about_z).apply([1, 0, 0]), [[0, 1, 0]], atol=1e-15)
    assert_allclose(to_quat_xyzw(Rotation.identity(1)), [[0, 0, 0, 1]])


def test_small_angles_are_a_rotation_vector_on_the_body_side():
    """On the right: about axes the reference has turned already. Euler angles differ by half the square."""
    t, turned = np.array([0.0, 1.0]), Rotation.from_euler("ZYX", [[1.0, 0.5, -0.2]] * 2)
    angles = np.array([0.1, -0.2, 0.3])
    reference = Trajectory(t, np.zeros((2, 3)), t, turned)
    actual = reference.with_motion(Motion.zero(0.0, 1.0).shifted(angles)).at(0.5).world_from_body
    expected = turned[0].as_matrix() @ Rotation.from_rotvec(angles).as_matrix()
    assert_allclose(actual.as_matrix()[0], expected, atol=1e-14)
    for size, difference in ((1e-6, 5e-13), (1e-4, 5e-9), (1e-3, 5e-7)):
        euler = to_roll_pitch_yaw(Rotation.from_rotvec([size, size, size]))
        assert np.abs(euler - size).max() == pytest.approx(difference, rel=0.05)


def test_large_angles_are_yaw_pitch_roll():
    """Equal to A_z A_y A_x of elementary right-handed matrices, written out here.

    S2's Q of this form takes nominal camera axes to actual ones, so our angles are minus its omega, up to
    its square.
    """
    roll, pitch, yaw = 0.3, -0.4, 1.1
    a_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    a_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    a_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    assert_allclose(from_roll_pitch_yaw(roll, pitch, yaw).as_matrix(), a_z @ a_y @ a_x, atol=4e-16)
    assert_allclose(to_roll_pitch_yaw(from_roll_pitch_yaw(roll, pitch, yaw)), [roll, pitch, yaw])

    omega = 2e-3
    ours = from_roll_pitch_yaw(omega, omega, omega).inv().as_rotvec()
    assert 1e-6 < np.abs(ours + omega).max() < omega**2


def test_a_residual_is_measured_minus_predicted():
    """A partner found one line further than predicted has a residual of +1 line."""
    predicted = np.array([[100.0, 50.0]])
    matches = Matches(
        a=np.array([[90.0, 50.0]]),
        b=predicted + np.array([1.0, -0.5]),
        covariance_px=1e-4 * np.eye(2)[np.newaxis],
        score=np.ones(1),
        status=np.zeros(1, np.uint8),
    )
    assert_allclose(residuals(matches, predicted), [[1.0, -0.5]])


def test_scan_velocity_and_slip_have_the_stated_signs():
    """Nominal 1.000 px per line; 100 urad/s of pitch adds 70 m/s to 7 km/s; yaw slips the other way."""
    middle = [[500.0, MIDDLE]]
    nominal = scan_velocity(camera(), middle, Plane())
    assert nominal.velocity[0] == pytest.approx(1.0, abs=1e-6)
    assert nominal.slip[0] == pytest.approx(0.0, abs=1e-9)
    pitching = scan_velocity(camera(rates=1e-4 * PITCH), middle, Plane())
    assert pitching.velocity[0] == pytest.approx(1.0100, abs=1e-5)
    yawed = scan_velocity(camera(angles=np.deg2rad(1.0) * YAW), middle, Plane())
    assert np.rad2deg(yawed.slip[0]) == pytest.approx(-1.000, abs=1e-4)


def test_a_psd_is_one_sided():
    """Its integral over positive frequencies alone is the variance."""
    sigma = 2.0
    prior = Spectrum((Matern(sigma=sigma, timescale=0.1, order="3/2"),))
    frequency = np.linspace(0.0, 400.0, 400_001)  # beyond 400 Hz lies less than 1e-6 of the power
    assert np.trapezoid(prior.psd(frequency), frequency) == pytest.approx(sigma**2, rel=1e-3)


def test_a_ray_that_misses_gives_a_row_of_nan():
    """And leaves the others alone: here the third point is never seen. A whole call that fails raises."""
    pixels = camera().project([[0.0, 35.0, 0.0], [np.nan, 0.0, 0.0], [0.0, 99e3, 0.0]])
    assert np.isnan(pixels).tolist() == [[False, False], [True, True], [True, True]]
    assert_allclose(camera().project(camera().locate(pixels[:1], Plane())), pixels[:1], atol=1e-9)
    with pytest.raises(InputError, match=r"shape \(N, 3\) as \(x, y, z\), got \(2, 5\)"):
        camera().project(np.zeros((2, 5)))
