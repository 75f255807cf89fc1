"""Lines of a frame exposed one after the other: what they see, against a motion in closed form."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.applications.sequence_poses import poses_of_windows
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rolling_shutter import as_of_first_lines, first_line_pixels, line_poses
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, sight_frames

RATE, READOUT, SHAPE, FOCAL = 25.0, 0.02, (240, 320), 300.0
MIDDLE = 0.5 * (np.array(SHAPE) - 1.0)


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


def images(count: int = 40) -> Images:
    t = np.arange(count) / RATE
    attitude = Rotation.from_matrix(np.stack([matrix_at(x) for x in t]))
    return Images(np.zeros(count), np.arange(count), t, position_at(t), attitude)


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


def test_pixels_go_back_by_how_frames_shift_turn_and_grow_while_lines_are_exposed():
    """Rates are means of the motions from the frame before and to the next; lines turn towards columns."""
    rng, count, step = np.random.default_rng(6), 5, 0.125
    motion = rng.uniform(-1.0, 1.0, (count, 4)) * [9.0, 6.0, 0.05, 0.04]
    motion[0] = np.nan
    followed = SimpleNamespace(before=np.arange(count) - 1, motion=motion)
    image, pixels = np.repeat(np.arange(count), 3), rng.uniform(0.0, [239.0, 319.0], (15, 2))
    found = first_line_pixels(image, pixels, followed, step * np.arange(count), READOUT, SHAPE)
    for k, (line, column), back in zip(image, pixels, found, strict=True):
        rate = np.mean([motion[n] / step for n in (k, k + 1) if 0 < n < count], axis=0)
        shift, turn, growth = rate[:2], *rate[2:]
        per_second = shift + np.array([[growth, -turn], [turn, growth]]) @ ([line, column] - MIDDLE)
        np.testing.assert_allclose(
            back, [line, column] - READOUT * line / 239.0 * per_second, rtol=0.0, atol=1e-9
        )


def test_a_lone_frame_does_not_move():
    flight = images(1)
    moved, turned = line_poses(flight, np.zeros(3, dtype=int), np.array([0.0, 0.01, 0.02]))
    assert (moved == 0.0).all() and turned.magnitude().max() == 0.0


def seen(true: Images, image: np.ndarray, point: np.ndarray, readout: float) -> np.ndarray:
    """Pixels (n, 2) by plain geometry: each point in its frame, by the line that sees it at its own time."""
    out = np.empty((len(point), 2))
    for n, (frame, place) in enumerate(zip(image, point, strict=True)):
        line = MIDDLE[0]
        for _ in range(20):
            t = true.t[frame] + readout * line / (SHAPE[0] - 1.0)
            forward, right, down = matrix_at(t).T @ (place - position_at(np.array(t)))
            line = MIDDLE[0] + FOCAL * forward / down
        out[n] = line, MIDDLE[1] - FOCAL * right / down
    return out


def sighted(true: Images) -> tuple[Sightings, np.ndarray, np.ndarray]:
    """Sightings of 60 points in two frames, the points, and s from the first line to that of each."""
    rng = np.random.default_rng(0)
    point = np.column_stack([rng.uniform(-30, 30, 60), rng.uniform(0, 20, 60), rng.uniform(-2, 2, 60)])
    image = np.repeat([12, 25], 30)
    pixels = seen(true, image, point, READOUT)
    detector = AreaDetector("frame", SHAPE, FOCAL, (MIDDLE[0], MIDDLE[1]))
    sightings = sight_frames(
        true, [detector], [NADIR_MOUNT], Tracks(image, np.arange(60), pixels, np.array(0.1))
    )
    return sightings, point, READOUT * pixels[:, 0] / (SHAPE[0] - 1.0)


def test_sightings_are_what_the_first_line_would_see():
    true = images()
    sightings, point, delay = sighted(true)
    still = seen(true, sightings.image, point, 0.0)
    found = as_of_first_lines(sightings, true, point, delay)
    x = (still - MIDDLE) / FOCAL
    # the mount's camera has x along columns, y along lines; columns run to the left
    expected = NADIR_MOUNT.inv().apply(np.column_stack([x[:, 0], -x[:, 1], np.ones(len(x))]))
    # the spline's error as above, at 80 m and 300 px: 1e-6 (1 / 80 + 1) rad
    assert np.abs(found.tangents - expected[:, :2] / expected[:, 2:]).max() < 2e-6
    assert np.abs(found.tangents - sightings.tangents).max() > 1e-3
    np.testing.assert_array_equal(found.position, sightings.position)
    # a point that is not known is as far as the others: heights of 2 m in 80 m change what 20 ms do by 3 %
    some = point.copy()
    some[::7] = np.nan
    rough = as_of_first_lines(sightings, true, some, delay)
    displaced = np.linalg.norm(found.tangents - sightings.tangents, axis=1)
    assert (np.linalg.norm(rough.tangents - found.tangents, axis=1) < 0.06 * displaced.max()).all()
    np.testing.assert_allclose(
        np.delete(rough.tangents, np.s_[::7], 0), np.delete(found.tangents, np.s_[::7], 0)
    )


def test_where_the_flight_lies_changes_nothing():
    # turned, moved and enlarged as a whole, points with it: what frames show within themselves is the same
    true = images()
    sightings, point, delay = sighted(true)
    turn, move, size = Rotation.from_rotvec([0.03, -0.05, 0.4]), np.array([20.0, -7.0, 3.0]), 1.07
    elsewhere = replace(
        true,
        position=size * turn.apply(np.array(true.position)) + move,
        world_from_body=turn * true.world_from_body,
    )
    here = as_of_first_lines(sightings, true, point, delay)
    there = as_of_first_lines(sightings, elsewhere, size * turn.apply(point) + move, delay)
    np.testing.assert_allclose(here.tangents, there.tangents, atol=1e-9)


def flown() -> tuple[SequenceProblem, Followed]:
    """Frames, points of level ground sighted to 0.05 px, tables to 0.5 m and half a degree."""
    count, rng = 25, np.random.default_rng(0)
    true = images(count)
    ground = np.column_stack([rng.uniform(-40, 40, 90), rng.uniform(-25, 37, 90), rng.uniform(-2, 2, 90)])
    image, point = (each.ravel() for each in np.meshgrid(np.arange(count), np.arange(90), indexing="ij"))
    # a line is found step by step: only of points that may be seen
    near = np.abs(ground[point, 1] - true.position[image, 1]) < 35.0
    image, point = image[near], point[near]
    pixels = seen(true, image, ground[point], READOUT)
    inside = ((pixels > 0.0) & (pixels < np.array(SHAPE) - 1.0)).all(axis=1)
    image, point = image[inside], point[inside]
    measured = pixels[inside] + 0.05 * rng.standard_normal((len(image), 2))
    wrong = Rotation.from_rotvec(np.radians(0.5) * rng.standard_normal((count, 3)))
    given = replace(
        true,
        position=true.position + 0.5 * rng.standard_normal((count, 3)),
        world_from_body=true.world_from_body * wrong,
    )
    detector = AreaDetector("frame", SHAPE, FOCAL, (MIDDLE[0], MIDDLE[1]))
    known = RoughPoses(np.full((count, 3), 0.5), np.full((count, 3), np.radians(0.5)))
    problem = SequenceProblem(
        tuple(map(str, range(count))), true.t, (ArrayImage(np.ones((4, 4))),) * count, detector, NADIR_MOUNT,
        given, known, Plane(0.0), 1.2, 0.0, 0.8, ("",) * count, readout_sigma=0.03,
    )  # fmt: skip
    ones = np.ones(count)
    followed = Followed(
        image, point, measured, np.full(len(image), 0.05), np.arange(count) - 1, np.zeros((count, 4)),
        np.bincount(image, minlength=count), ones, ones, ("",) * count,
    )  # fmt: skip
    return problem, followed


def test_a_readout_time_that_is_not_given_is_found():
    problem, followed = flown()
    found, _ = poses_of_windows(problem, followed)
    assert found.readout is not None and found.readout.sigma < 0.2 * READOUT
    # four sigma: one in 16,000
    assert abs(found.readout.seconds - READOUT) < 4.0 * found.readout.sigma
    assert found.readout_time(0.0) == found.readout.seconds
    kept, _ = poses_of_windows(replace(problem, readout_time=READOUT, readout_sigma=0.0), followed)
    assert kept.readout is None and kept.readout_time(READOUT) == READOUT
    # what is not known of it is in the sigmas
    more, less = (np.einsum("kii->k", poses.covariance) for poses in (found, kept))
    assert (more > 0.99 * less).all() and more.sum() > less.sum()
