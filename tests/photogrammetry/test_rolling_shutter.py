"""Lines of a frame exposed one after the other: poses of lines against a motion in closed form."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.photogrammetry.rolling_shutter import line_poses, sight_lines
from sightline.photogrammetry.sightings import Images, Tracks, sight_frames

RATE, READOUT, SHAPE, FOCAL = 25.0, 0.02, (240, 320), 300.0


def position_at(t: np.ndarray) -> np.ndarray:
    sway = np.stack([np.sin(2.0 * t), 0.5 * np.cos(3.0 * t), 0.3 * np.sin(t)], axis=-1)
    return 0.2 * sway + np.stack([0.0 * t, 12.0 * t, 80.0 + 0.0 * t], axis=-1)


def matrix_at(t: float) -> np.ndarray:
    """world_from_body: level and north (x forward, y right, z down), then turned about its own axes."""
    level = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    out = level
    for axis, angle in enumerate((0.02 * np.sin(3.0 * t), 0.03 * np.sin(2.0 * t + 1.0), 0.05 * np.sin(t))):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
        out = out @ turn
    return out


def images(count: int = 40, turned: float = 0.0) -> Images:
    t = np.arange(count) / RATE
    attitude = Rotation.from_matrix(np.stack([matrix_at(x) for x in t])) * Rotation.from_rotvec(
        [turned, 0, 0]
    )
    return Images(np.zeros(count), np.arange(count), t, position_at(t) + 3.0 * turned, attitude)


def test_poses_of_lines_follow_the_motion_between_frames():
    flight = images()
    image, delay = np.repeat([10, 20, 30], 4), np.tile(np.linspace(0.0, READOUT, 4), 3)
    moved, turned = line_poses(flight, image, delay)
    t = flight.t[image] + delay
    # a cubic spline through steps of h errs by h^4 / 384 of the fourth derivative: 0.04^4 / 384 * 0.2 * 3^4
    assert np.abs(moved - (position_at(t) - position_at(flight.t[image]))).max() < 1e-6
    true = np.stack([matrix_at(a).T @ matrix_at(b) for a, b in zip(flight.t[image], t, strict=True)])
    assert Rotation.from_matrix(np.swapaxes(true, 1, 2) @ turned.as_matrix()).magnitude().max() < 1e-6
    assert np.abs(moved[delay == 0.0]).max() == 0.0


def test_a_short_turn_between_two_lines_is_no_part_of_either():
    # there and back, the camera off for five steps: no pause, but two curves
    there, back = images(), images()
    t = np.concatenate([there.t, there.t[-1] + 5.0 / RATE + back.t])
    about = Rotation.from_rotvec([0.0, 0.0, np.pi])
    attitude = Rotation.concatenate([there.world_from_body, about * back.world_from_body])
    place = np.concatenate([there.position, about.apply(np.array(back.position)) + 50.0])
    both = Images(np.zeros(80), np.arange(80), t, place, attitude)
    image, delay = np.arange(80), np.full(80, READOUT)
    moved, turned = line_poses(both, image, delay)
    for rows, line, turn in ((slice(0, 40), there, Rotation.identity()), (slice(40, 80), back, about)):
        alone, turned_alone = line_poses(line, np.arange(40), delay[:40])
        assert np.abs(moved[rows] - turn.apply(np.array(alone))).max() < 1e-9
        assert (turned_alone.inv() * turned[rows]).magnitude().max() < 1e-9
    # a drone that flies back without turning: only its images say where a line ends
    strafe = Images(np.zeros(80), np.arange(80), t, place, Rotation.identity(80))
    linked = np.repeat([0, 1], 40)
    linked[[20, 60]] = -1  # a frame without evidence stays on its line
    moved, _ = line_poses(strafe, image, delay, linked)
    alone, _ = line_poses(images(), np.arange(40), delay[:40])
    assert np.abs(moved[:40] - alone).max() < 1e-9


def test_a_lone_frame_does_not_move():
    flight = images(1)
    moved, turned = line_poses(flight, np.zeros(3, dtype=int), np.array([0.0, 0.01, 0.02]))
    assert (moved == 0.0).all() and turned.magnitude().max() == 0.0


def test_points_seen_by_single_lines_are_met_exactly_from_wrong_plans():
    true, plan = images(), images(turned=0.02)
    rng = np.random.default_rng(0)
    point = np.column_stack([rng.uniform(-30, 30, 60), rng.uniform(0, 20, 60), rng.uniform(-2, 2, 60)])
    middle = 0.5 * (np.array(SHAPE) - 1.0)
    image, pixels = np.repeat([12, 25], 30), np.empty((60, 2))
    for n in range(60):
        line = middle[0]
        for _ in range(20):  # the line that sees the point at its own time
            t = true.t[image[n]] + READOUT * line / (SHAPE[0] - 1.0)
            forward, right, down = matrix_at(t).T @ (point[n] - position_at(np.array(t)))
            line = middle[0] + FOCAL * forward / down
        pixels[n] = line, middle[1] - FOCAL * right / down
    detector = AreaDetector("frame", SHAPE, FOCAL, (middle[0], middle[1]))
    tracks = Tracks(image, np.arange(60), pixels, np.array(0.1))
    delay = READOUT * pixels[:, 0] / (SHAPE[0] - 1.0)
    sightings = sight_lines(sight_frames(plan, [detector], [NADIR_MOUNT], tracks), plan, true, delay)
    # each pose departs from its line's as its frame's does from the plan: body axes, then the world's
    turn = Rotation.from_rotvec([-0.02, 0.0, 0.0]).as_matrix()
    q = np.einsum("nij,ni->nj", sightings.world_from_body @ turn, point - (sightings.position - 0.06))
    q = q @ NADIR_MOUNT.as_matrix()
    miss = np.einsum("nij,nj->ni", sightings.px_per_tangent, sightings.tangents - q[:, :2] / q[:, 2:])
    # the spline's error as above, at 80 m and 300 px: 1e-6 (1 / 80 + 1) 300 px
    assert np.abs(miss).max() < 1e-3
