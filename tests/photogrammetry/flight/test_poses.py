"""Poses of all frames of a flight, on pinholes in closed form: accuracy, honesty, gaps, biases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from consistency import assert_consistent
from sightline.errors import InputError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors
from sightline.photogrammetry.flight.path import bends, path_precision, path_roughness
from sightline.photogrammetry.flight.poses import (
    FramePoses,
    RoughPoses,
    adjust_frames,
    frame_unknowns,
)
from sightline.photogrammetry.sightings import Images, Tracks, sight_frames

HEIGHT, FOCAL, SHAPE, RATE = 100.0, 400.0, (256, 320), 25.0
SIGMA_PX, SIGMA_POSITION, SIGMA_ATTITUDE = 0.1, 0.3, 0.003
#: world_from_body of level flight north: x forward = north, y right = east, z down.
LEVEL = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRAMES = 30


class Flight:
    """A path with jitter, points on the ground, sightings, and rough tables with biases."""

    def __init__(
        self, seed: int, *, count: int = FRAMES, step: float = 0.04, hidden=(), bias=(1.0, 0.01),
        sigma_px=SIGMA_PX, life=10**6,
    ):  # fmt: skip
        rng = np.random.default_rng(seed)
        self.t = np.arange(count) / RATE
        footprint = SHAPE[0] / FOCAL * HEIGHT
        speed = footprint * step * RATE
        phase = rng.uniform(0.0, 2.0 * np.pi, (4, 3))
        sway = 0.05 * np.sin(2.0 * np.pi * 0.3 * self.t[:, None] + phase[0])
        self.position = np.stack([0.0 * self.t, speed * self.t, np.full(count, HEIGHT)], axis=1) + sway
        slow, fast = 2.0 * np.pi * 0.5 * self.t[:, None], 2.0 * np.pi * 3.0 * self.t[:, None]
        self.angles = np.radians(np.sin(slow + phase[1]) + 0.1 * np.sin(fast + phase[2]))
        self.attitude = LEVEL * Rotation.from_rotvec(self.angles)
        points = np.column_stack([
            rng.uniform(-0.4, 0.4, 250) * SHAPE[1] / FOCAL * HEIGHT,
            rng.uniform(-0.6 * footprint, speed * self.t[-1] + 0.6 * footprint, 250),
            rng.uniform(-3.0, 3.0, 250),
        ])  # fmt: skip
        image, point, pixels = [], [], []
        middle = (np.array(SHAPE) - 1.0) / 2.0
        for k in range(count):
            forward, right, down = self.attitude[k].inv().apply(points - self.position[k]).T
            # lines run forward, columns to the left
            seen = middle + FOCAL * np.column_stack([forward / down, -right / down])
            rows = np.flatnonzero(((seen > 0) & (seen < np.array(SHAPE) - 1)).all(axis=1))
            if k in hidden:
                continue
            image.append(np.full(len(rows), k))
            point.append(rows + 250 * (k // life))  # each is lost after so many frames, and found anew
            pixels.append(seen[rows] + sigma_px * rng.standard_normal((len(rows), 2)))
        self.tracks = Tracks(
            np.concatenate(image), np.concatenate(point), np.concatenate(pixels), np.array(sigma_px)
        )
        self.bias = np.concatenate([bias[0] * rng.standard_normal(3), bias[1] * rng.standard_normal(3)])
        noise = SIGMA_ATTITUDE * rng.standard_normal((count, 3))
        self.images = Images(
            np.zeros(count), np.arange(count), self.t,
            self.position + self.bias[:3] + SIGMA_POSITION * rng.standard_normal((count, 3)),
            self.attitude * Rotation.from_rotvec(self.bias[3:] + noise),
        )  # fmt: skip
        self.known = RoughPoses(
            np.full((count, 3), SIGMA_POSITION), np.full((count, 3), SIGMA_ATTITUDE), *bias
        )

    def solve(self, **given) -> FramePoses:
        detector = AreaDetector("frame", SHAPE, FOCAL, ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0))
        sightings = sight_frames(self.images, [detector], [NADIR_MOUNT], self.tracks)
        # heights are drawn over +-3 m: 1.7 m rms
        heights = PointPriors(HeightPrior(Plane(0.0), 1.75, None))
        return adjust_frames(self.images, sightings, self.known, priors=heights, **given)

    def errors(self, found: FramePoses) -> np.ndarray:
        """(M, 6): of positions, then of angles about body axes."""
        turn = (self.attitude.inv() * found.world_from_body).as_rotvec()
        return np.concatenate([found.position - self.position, turn], axis=1)


def test_frames_are_found_relative_to_each_other_far_better_than_the_tables_say():
    flight = Flight(0)
    found = flight.solve()
    error = flight.errors(found)
    # a tilt and a shift of 100 m times it look alike but for perspective; where both point is known better:
    # some 70 points of 0.1 px each show the ground, to 0.1 / sqrt(70) px and what perspective leaves
    pitch, roll = error[:, 4], error[:, 3]
    forward = (error[:, 1] + HEIGHT * pitch) * FOCAL / HEIGHT
    right = (error[:, 0] - HEIGHT * roll) * FOCAL / HEIGHT
    assert np.diff(forward).std() < 0.05 and np.diff(right).std() < 0.05
    assert np.diff(error[:, 5]).std() < 2e-4  # yaw stands alone
    assert error[:, :3].std(axis=0).max() < 0.5 * SIGMA_POSITION
    assert error[:, 3:].std(axis=0).max() < 0.5 * SIGMA_ATTITUDE


def test_sigmas_of_every_frame_hold_over_many_flights():
    # the datum is one draw a flight, of which the middle frame tells all
    nees, others = [], []
    for seed in range(30):
        flight = Flight(seed)
        found = flight.solve()
        every = flight.errors(found)
        nees.append(every[15] @ np.linalg.solve(found.covariance[15], every[15]))
        # over five frames (from one to the next the path, as rough as over longer steps, says too little: a
        # quarter on the safe side), and the size of the whole
        both = found.pair_covariance[20, :, 15]
        covariance = found.covariance[15] + found.covariance[20] - both - both.T
        step = every[20] - every[15]
        about = found.position - found.position.mean(axis=0)
        scale = (about * every[:, :3]).sum() / (about**2).sum() / found.scale_sigma
        others.append(step @ np.linalg.solve(covariance, step) + scale**2)
        np.testing.assert_allclose(found.pair_covariance[15, :, 15], found.covariance[15], rtol=1e-6)
        np.testing.assert_array_equal(found.pair_covariance[16, :, 15], found.next_covariance[15])
    assert_consistent(nees, 6)
    assert_consistent(others, 7)


def test_biases_of_the_tables_are_found_where_the_ground_tells_them():
    flight = Flight(1)
    found = flight.solve()
    error = found.bias - flight.bias
    assert error @ np.linalg.solve(found.bias_covariance, error) < 22.5  # chi-square of 6 at 1e-3
    sigma = np.sqrt(np.diag(found.bias_covariance))
    assert sigma[2] < 0.5  # level ground tells the height
    assert sigma[0] > 0.9  # nothing tells where the flight is


def test_what_nothing_tells_stays_as_it_was_however_sharp_the_images():
    # points seen in three frames 1 % apart: depth is known 100 times worse than direction, and the sightings
    # a million times better than the place of the flight; rounding must not tell it
    found = Flight(2, step=0.01, sigma_px=1e-3, life=3).solve()
    assert np.sqrt(np.diag(found.bias_covariance)[:2]) == pytest.approx(1.0, rel=1e-3)
    assert np.isfinite(found.covariance).all()


def test_sigmas_along_other_axes_say_the_same_in_a_turned_world():
    flight = Flight(4, count=12)
    known = RoughPoses(np.tile([0.05, 0.05, 5.0], (12, 1)), flight.known.attitude, 0.0, 0.01)
    turn = Rotation.from_rotvec([0.4, -0.8, 0.3])
    detector = AreaDetector("frame", SHAPE, FOCAL, ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0))

    def solved(images, known):
        sightings = sight_frames(images, [detector], [NADIR_MOUNT], flight.tracks)
        return adjust_frames(images, sightings, known, roughness=np.full(6, 1.0))

    plain = solved(flight.images, known)
    turned = solved(
        replace(
            flight.images, position=turn.apply(np.array(flight.images.position)),
            world_from_body=turn * flight.images.world_from_body,
        ),
        replace(known, axes=np.tile(turn.as_matrix(), (12, 1, 1))),
    )  # fmt: skip
    back = turn.inv().apply(np.array(turned.position)) - plain.position
    sigma = np.sqrt(np.einsum("kii->ki", plain.covariance))
    # steps end a thousandth of a sigma from each other
    assert (np.abs(back) < 0.01 * sigma[:, :3]).all()
    whole = np.eye(6)
    whole[:3, :3] = turn.inv().as_matrix()
    again = np.sqrt(np.einsum("ij,kjl,il->ki", whole, turned.covariance, whole))
    np.testing.assert_allclose(again, sigma, rtol=1e-3)
    # level sigmas of a hundredth of the upright one are kept
    assert sigma[:, :2].max() < 0.06 and sigma[:, 2].min() > 0.5
    np.testing.assert_allclose(
        replace(known, axes=np.tile(turn.as_matrix(), (12, 1, 1))).along_world()[0],
        np.sqrt(np.diag(turn.as_matrix() @ np.diag([0.05**2, 0.05**2, 25.0]) @ turn.as_matrix().T)),
    )


def test_frames_that_nobody_sees_are_bridged_with_honest_sigmas():
    gap = (13, 14, 15, 16)
    ratio = []
    for seed in range(12):
        flight = Flight(seed, hidden=gap)
        found = flight.solve()
        assert (found.sightings[list(gap)] == 0).all()
        sigma = np.sqrt(np.einsum("kii->ki", found.covariance))
        # the middle of the gap is known worse than its ends, in angles by far
        assert (sigma[14, 3:] >= sigma[12, 3:]).all()
        step = flight.errors(found)
        relative = step[14] - 0.5 * (step[12] + step[17])  # the datum cancels
        ratio.append(relative[3:] / sigma[14, 3:])
    # absolute sigmas own the datum too, so the ratio is below 1; it must not be far above
    assert np.sqrt(np.mean(np.square(ratio))) < 1.3


def test_gross_mismatches_are_left_out():
    flight = Flight(2)
    rng = np.random.default_rng(20)
    bad = rng.random(len(flight.tracks)) < 0.03
    pixels = np.array(flight.tracks.pixels)
    pixels[bad] += rng.uniform(2.0, 20.0, (bad.sum(), 2))
    clean = flight.solve()
    flight.tracks = Tracks(flight.tracks.image, flight.tracks.point, pixels, flight.tracks.sigma_px)
    found = flight.solve()
    assert found.rejected[bad].mean() > 0.97
    # 3 % fewer sightings move nothing by more than a good part of its sigma
    sigma = np.sqrt(np.einsum("kii->ki", clean.covariance))
    assert (np.abs(flight.errors(found) - flight.errors(clean)) < 0.5 * sigma).all()


def test_even_motion_costs_nothing_and_bends_cost_by_their_rate():
    t = np.array([0.0, 0.1, 0.3, 0.4, 0.8])
    smooth = bends(t, np.full(6, 2.0), np.zeros(5, dtype=int))
    precision = path_precision(*smooth, np.arange(5))
    whole = np.zeros((30, 30))
    for k in range(5):
        for d in range(min(k, 2) + 1):
            whole[6 * k : 6 * k + 6, 6 * (k - d) : 6 * (k - d) + 6] = precision[k, d]
            whole[6 * (k - d) : 6 * (k - d) + 6, 6 * k : 6 * k + 6] = precision[k, d].T
    straight = (3.0 + 2.0 * t)[:, None] * np.arange(1.0, 7.0)
    assert np.abs(whole @ straight.ravel()).max() < 1e-9
    bent = np.where(t > 0.3, t - 0.3, 0.0)[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    # one bend of 1 per s at t = 0.3: variance 2 (0.2 + 0.1) / 3
    assert bent.ravel() @ whole @ bent.ravel() == pytest.approx(1.0 / 0.2)


def test_where_a_flight_turns_its_path_is_not_smooth():
    # to and fro, half a turn between: on a path taken to be that smooth it would cost hundreds of sigmas
    count, t = 8, np.arange(8.0)
    place = np.column_stack([np.minimum(t, 7.0 - t) * 30.0, 20.0 * (t > 3.5), np.full(count, 80.0)])
    turned = Rotation.from_rotvec(np.pi * np.outer(t > 3.5, [0.0, 0.0, 1.0]))
    images = Images(np.zeros(count), np.arange(count), t, place, turned)
    known = RoughPoses(np.full((count, 3), 3.0), np.full((count, 3), 0.03))
    rough = np.array([1e-5, 1e-5, 1e-5, 0.5, 0.5, 0.5])
    unknowns = frame_unknowns(images, known, rough)
    tied = np.abs(unknowns.precision[:, 1:]).sum(axis=(2, 3)) > 0.0
    assert tied[3].all() and tied[6].any()
    # the two bends across the turn are those of frames 2, 3, 4 and 3, 4, 5
    assert not tied[4, 0] and not tied[5, 1] and not tied[4, 1]
    # tables that say nothing of attitudes show no turn
    unknowns = frame_unknowns(images, replace(known, attitude=np.full((count, 3), np.inf)), rough)
    assert (np.abs(unknowns.precision[2:, 1:]).sum(axis=(2, 3)) > 0.0).all()


def test_sigmas_of_tables_must_be_positive():
    with pytest.raises(InputError, match="`attitude` must be positive sigmas of shape"):
        RoughPoses(np.ones((3, 3)), np.zeros((3, 3)))


def test_tables_without_biases_hold_the_flight_alone():
    flight = Flight(3, bias=(1e-9, 1e-9))
    known = RoughPoses(flight.known.position, flight.known.attitude)
    flight.known = known
    found = flight.solve()
    assert (found.bias == 0.0).all()
    error = flight.errors(found)[15]
    assert error @ np.linalg.solve(found.covariance[15], error) < 22.5  # chi-square of 6 at 1e-3


def test_roughness_of_white_acceleration_is_its_density():
    rng = np.random.default_rng(6)
    h, count, density = 0.04, 2000, 2.0
    root = np.linalg.cholesky(density * np.array([[h, h**2 / 2.0], [h**2 / 2.0, h**3 / 3.0]]))
    pushed = rng.standard_normal((count, 6, 2)) @ root.T
    speed = np.cumsum(pushed[..., 0], axis=0)
    path = np.cumsum(pushed[..., 1], axis=0) + h * np.concatenate(
        [np.zeros((1, 6)), np.cumsum(speed, 0)[:-1]]
    )
    found = path_roughness(h * np.arange(count), path, np.full(count, 10.0))
    # bends over the longest steps are few, some 8 end to end: the largest of all is too large by chance
    assert (found > 0.9 * density).all() and np.median(found) < 2.5 * density


def test_a_path_that_sways_for_seconds_is_rougher_than_its_neighbours_bend():
    t = np.arange(400) * 0.04
    path = np.repeat((0.2 * np.sin(2.0 * np.pi * 0.2 * t))[:, None], 6, axis=1)
    found = path_roughness(t, path, np.full(400, 10.0))
    bend = np.diff(path[:, 0], 2) / 0.04
    by_neighbours = (bend**2).mean() * 3.0 / 0.08
    # the acceleration goes together for a quarter of the period, 31 frames
    assert (found > 10.0 * by_neighbours).all()


def test_a_flight_that_little_keeps_from_turning_about_its_line_is_solved_and_says_so():
    # no attitudes, no heights: the swaying of the positions alone tells the turn about the line, along a
    # curved valley that ends in steps of a thousandth of a sigma if its equations are not made anew
    statistic = []
    for seed in range(2):
        flight = Flight(seed, count=100, sigma_px=0.02, life=20)
        rng = np.random.default_rng(100 + seed)
        images = replace(
            flight.images,
            position=flight.position + 3.0 * rng.standard_normal(3) + rng.standard_normal((100, 3)),
            world_from_body=flight.attitude * Rotation.from_rotvec([0.1, 0.02, 0.0]),
        )
        known = RoughPoses(np.full((100, 3), 1.0), np.full((100, 3), 0.2), 3.0, 0.2)
        detector = AreaDetector("frame", SHAPE, FOCAL, ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0))
        found = adjust_frames(images, sight_frames(images, [detector], [NADIR_MOUNT], flight.tracks), known)
        roll = flight.errors(found)[:, 3].mean()
        sigma = float(np.sqrt(found.covariance[:, 3, 3].mean()))
        assert 0.03 < sigma < 0.1  # positions sway by .05 m of 100: hardly better than what is known before
        statistic.append((roll / sigma) ** 2)
    assert sum(statistic) < 9.2  # 99 % of chi-squares of two draws


def test_a_flight_without_attitudes_settles_along_a_curved_valley():
    # frames without given attitudes turn and move alike at hardly any cost: whole steps raise it, and
    # holding the biases does not help; halved steps alone did not end on this flight
    flight = Flight(12, count=24, step=0.01, life=12, bias=(2.0, 0.0))
    rng = np.random.default_rng(12 + 10**6)
    rough = flight.position + flight.bias[:3] + rng.standard_normal((24, 3))
    turned = 0.017 * rng.standard_normal(3) + 0.002 * rng.standard_normal((24, 3))
    attitude = flight.attitude * Rotation.from_rotvec(turned)
    flight.images = replace(flight.images, position=rough, world_from_body=attitude)
    flight.known = RoughPoses(np.full((24, 3), 1.0), np.full((24, 3), np.inf), 2.0, 0.0)
    found = flight.solve(start=replace(flight.images, position=flight.position + flight.bias[:3]))
    error = flight.errors(found)[12]
    # chi-square of 6: above 27.9 in one of ten thousand
    assert error @ np.linalg.solve(found.covariance[12], error) < 27.9
