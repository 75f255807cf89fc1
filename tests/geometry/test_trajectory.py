"""Poses against time: interpolation errors from closed forms, spans, motions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, SpanError
from sightline.geometry.rotations import orbital_axes
from sightline.geometry.trajectory import Motion, Pose, Trajectory

RADIUS, RATE = 7.0e6, 1.08e-3


def circle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity on a circular orbit."""
    t = np.asarray(t)
    position = RADIUS * np.stack([np.cos(RATE * t), np.sin(RATE * t), 0 * t], axis=1)
    velocity = RADIUS * RATE * np.stack([-np.sin(RATE * t), np.cos(RATE * t), 0 * t], axis=1)
    return position, velocity


def orbit(step: float, with_velocity: bool) -> Trajectory:
    t = np.arange(0.0, 20 * step, step)
    position, velocity = circle(t)
    attitude = orbital_axes(position, velocity)
    return Trajectory(t, position, t, attitude, velocity=velocity if with_velocity else None)


@pytest.mark.parametrize(
    ("step", "with_velocity", "factor"), [(1.0, False, 4), (10.0, False, 4), (60.0, True, 8)]
)
def test_positions_of_an_orbit_are_off_by_the_first_term_left_out(step, with_velocity, factor):
    """Cubic, middle of four: (w h)^4 (9/16) / 4! of the radius; ends (w h)^4 / 4!. With velocities degree 7:
    (w h)^8 / 8!. Plus 1e-8 m of rounding. That is 0.4 um at 1 s, 4 mm at 10 s and 2 um at 60 s."""
    t = np.linspace(0.0, 19 * step, 1001)
    bound = RADIUS * (RATE * step) ** factor / (24 if factor == 4 else 40320) + 1e-8
    position, velocity = circle(t)
    pose = orbit(step, with_velocity).at(t)
    assert np.abs(pose.position - position).max() < bound
    turned = (pose.world_from_body.inv() * orbital_axes(position, velocity)).magnitude()
    assert turned.max() < 1e-13, "an even turn is followed exactly"


def test_attitude_of_an_uneven_turn_is_off_by_the_first_term_left_out():
    """Swing of 0.1 rad at 0.5 rad/s about a fixed axis, nodes at 0.25 s: (w h)^4 / 4! of the amplitude."""
    t = np.arange(0.0, 10.0, 0.25)
    axis = np.array([0.6, 0.0, 0.8])
    swing = Rotation.from_rotvec(0.1 * np.sin(0.5 * t)[:, None] * axis)
    trajectory = Trajectory(t, np.zeros((len(t), 3)), t, swing)
    places = np.linspace(0, 9.75, 500)
    truth = Rotation.from_rotvec(0.1 * np.sin(0.5 * places)[:, None] * axis)
    error = (trajectory.at(places).world_from_body.inv() * truth).magnitude()
    assert error.max() < 0.1 * 0.125**4 / 24


def test_two_attitudes_are_joined_along_the_great_circle():
    ends = Rotation.from_euler("ZYX", [[0.1, 0.2, 0.3], [1.0, -0.4, 0.8]])
    t = np.array([0.0, 1.0])
    middle = Trajectory(t, np.zeros((2, 3)), t, ends).at(0.5).world_from_body
    assert_allclose((ends[0].inv() * middle).as_rotvec()[0] * 2, (ends[0].inv() * ends[1]).as_rotvec())


def test_quaternions_of_either_sign_are_the_same_attitude():
    t = np.arange(6.0)
    quat = Rotation.from_rotvec(t[:, None] * [0.0, 0.01, 0.02]).as_quat()
    flipped = quat * np.array([1, -1, 1, -1, -1, 1.0])[:, None]
    one, other = (Trajectory(t, np.zeros((6, 3)), t, Rotation.from_quat(q)).at(2.3) for q in (quat, flipped))
    assert (one.world_from_body.inv() * other.world_from_body).magnitude()[0] < 1e-15


def test_one_instant_is_a_trajectory():
    single = Trajectory([5.0], [[1.0, 2.0, 3.0]], [5.0], Rotation.identity())
    assert single.span == (5.0, 5.0)
    assert_allclose(single.at([5.0, 5.0]).position, [[1, 2, 3], [1, 2, 3]])


def test_each_clock_is_its_own_and_the_span_is_what_they_share():
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0).with_motion(Motion.zero(1.0, 12.0))
    assert flight.span == (1.0, 10.0)


def test_heading_turns_the_flight_clockwise_from_north():
    """East: x_body = east, y_body = south."""
    pose = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0, heading=np.pi / 2).at(1.0)
    assert_allclose(pose.position[0], [50.0, 0.0, 1e3], atol=1e-12)
    assert_allclose(pose.world_from_body.apply([0, 1, 0])[0], [0, -1, 0], atol=1e-15)


def test_a_time_outside_names_the_time_and_the_span():
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 12.0)
    message = (
        r"t = 12\.310000 s: its span is \[0\.000000, 12\.000000\] s and it is never extrapolated; "
        r"supply it up to 12\.310000 s"
    )
    with pytest.raises(SpanError, match=message):
        flight.at([1.0, 12.31])
    with pytest.raises(SpanError, match=r"supply it from -0\.500000 s"):
        flight.at([-0.5, 1.0])
    with pytest.raises(SpanError, match="the motion is not known"):
        Motion.zero(0.0, 1.0).at(2.0)


def test_motion_between_nodes_follows_the_cubic():
    """A 100 Hz tone on a 2 kHz grid: (w h)^4 (9/16) / 4! = 2.3e-4 of its amplitude."""
    t = np.arange(0.0, 0.1, 5e-4)
    tone = Motion(t, 1e-5 * np.sin(2 * np.pi * 100 * t)[:, None] * [1.0, 0.5, 0.0])
    places = np.linspace(1e-3, 0.098, 777)
    error = tone.at(places)[:, 0] - 1e-5 * np.sin(2 * np.pi * 100 * places)
    assert np.abs(error).max() < 1.05e-5 * (2 * np.pi * 100 * 5e-4) ** 4 * (9 / 16) / 24


def test_difference_of_motions_is_taken_at_the_times_of_the_first():
    t = np.linspace(0.0, 1.0, 11)
    estimate = Motion(t, np.outer(t, [1e-6, 0, 0]), np.tile(np.eye(3) * 1e-14, (11, 1, 1)))
    truth = Motion(np.linspace(-1, 2, 7), np.outer(np.linspace(-1, 2, 7), [2e-6, 0, 0]))
    error = estimate - truth
    assert_allclose(error.angles, np.outer(t, [-1e-6, 0, 0]), atol=1e-20)
    assert_allclose(error.covariance, estimate.covariance)
    assert (truth - truth).covariance is None
    assert_allclose((estimate - estimate).covariance, 2 * estimate.covariance)


def test_shifted_adds_a_constant_and_leaves_the_original():
    motion = Motion.zero(0.0, 1.0)
    assert_allclose(motion.shifted([1e-6, 2e-6, 3e-6]).at(0.3), [[1e-6, 2e-6, 3e-6]])
    assert (motion.angles == 0).all()


def test_covariance_between_nodes_is_linear():
    motion = Motion([0.0, 1.0], np.zeros((2, 3)), np.stack([np.eye(3), 3 * np.eye(3)]))
    assert_allclose(motion.covariance_at(0.5), [2 * np.eye(3)])


def test_arrays_cannot_be_changed_from_outside():
    t, angles = np.array([0.0, 1.0]), np.zeros((2, 3))
    motion = Motion(t, angles)
    angles[0, 0] = 1.0
    assert motion.angles[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        motion.angles[0, 0] = 1.0


def test_a_trajectory_survives_a_trip_to_another_process():
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0).with_motion(Motion.zero(0.0, 10.0))
    again = pickle.loads(pickle.dumps(flight))
    assert_allclose(again.at(3.0).position, flight.at(3.0).position)
    assert not again.position.flags.writeable and not again.motion.angles.flags.writeable


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t_position": [0.0, 0.0]}, "comes twice"),
        ({"position": [[0.0, 0, 0], [np.nan, 0, 0]]}, "`position` must be finite: row 1"),
        ({"position": [[0.0, 0, 0]]}, "as many rows, got 2 and 1"),
        ({"world_from_body": Rotation.identity(3)}, "as many rows, got 2 and 3"),
        ({"t_attitude": [5.0, 6.0]}, "have no time in common; give them on one epoch"),
        ({"t_position": [], "position": np.zeros((0, 3))}, "`t_position` is empty"),
    ],
)
def test_what_does_not_fit_together_is_refused(change, message):
    parts = {
        "t_position": [0.0, 1.0],
        "position": np.zeros((2, 3)),
        "t_attitude": [0.0, 1.0],
        "world_from_body": Rotation.identity(2),
    }
    with pytest.raises(InputError, match=message):
        Trajectory(**(parts | change))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (([0.0, 1.0], np.zeros((3, 3))), "as many rows, got 2 and 3"),
        (([0.0], [[np.nan, 0, 0]]), "`angles` of a Motion must be finite: row 0"),
        (([], np.zeros((0, 3))), "is empty"),
        (([0.0], np.zeros((1, 3)), np.eye(3)), r"`covariance` must have shape \(1, 3, 3\)"),
    ],
)
def test_a_motion_that_makes_no_sense_is_refused(parts, message):
    with pytest.raises(InputError, match=message):
        Motion(*parts)


def test_poses_kept_for_speed_do_not_outlive_a_change_and_cannot_be_spoilt():
    """The reference is evaluated once per table of times; motion and what callers do come after."""
    t = np.linspace(0.0, 9.0, 500)
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0)
    first = flight.at(t)
    first.position[:] = 0.0
    assert_allclose(flight.at(t).position[:, 1], 50.0 * t, atol=1e-12)
    turned = flight.with_motion(Motion.zero(0.0, 10.0).shifted([0.1, 0.0, 0.0])).at(t)
    assert_allclose((first.world_from_body.inv() * turned.world_from_body).as_rotvec(), [[0.1, 0, 0]] * 500)
    assert_allclose(flight.at(t + 0.5).position[:, 1], 50.0 * (t + 0.5), atol=1e-12)


def test_the_tables_of_many_bands_are_evaluated_once_each(monkeypatch):
    asked, work = [], Trajectory._reference_pose
    monkeypatch.setattr(Trajectory, "_reference_pose", lambda self, t: asked.append(t[0]) or work(self, t))
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0)
    for _ in range(2):
        for band in range(30):
            flight.mean_at(np.linspace(1.0, 8.0, 300) + 0.01 * band, [-0.1, 0.1])
    assert len(asked) == 30


def test_poses_that_another_thread_drops_at_once_are_still_returned():
    class Dropping(dict[bytes, Pose]):
        def __setitem__(self, key, pose):
            super().__setitem__(key, pose)
            self.clear()

    t = np.linspace(1.0, 8.0, 300)
    flight = Trajectory.level_flight(1e3, 50.0, 0.0, 10.0)
    flight.__dict__["_known"] = Dropping()
    assert_allclose(flight.mean_at(t, [-0.1, 0.1]).position[:, 1], 50.0 * t, atol=1e-12)
