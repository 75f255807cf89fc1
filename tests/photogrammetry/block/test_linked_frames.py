"""Lines that share points: solved line by line, or as one band, the numbers are the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.block.descent import BlockSums, first_state, seen_twice
from sightline.photogrammetry.block.linked_frames import LinkedFrames, runs_of_points
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors
from sightline.photogrammetry.block.reduced import Curvature, PointsFirst
from sightline.photogrammetry.flight import poses as frame_poses
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses, adjust_frames, frame_unknowns
from sightline.photogrammetry.flight.solving_order import _far_pairs, one_band, solving_order
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, sight_frames

HEIGHT, FOCAL, SHAPE = 100.0, 400.0, (256, 320)
DETECTOR = AreaDetector("frame", SHAPE, FOCAL, ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0))
#: Frames of each line, m between two of them, frames for which a point is followed.
FRAMES, STEP, LIFE = 60, 4.0, 8
#: Where each line begins (m) and its heading (degrees from north): beside, and across all.
BESIDE = ((0.0, 0.0, 0.0), (45.0, 0.0, 0.0), (90.0, 236.0, 180.0))
CROSSING = (*BESIDE, (-75.0, 120.0, 90.0))


def level(heading: float) -> Rotation:
    """world_from_body of level flight: x forward, y right, z down."""
    north = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return north * Rotation.from_euler("z", heading, degrees=True)


class Flight:
    """Lines with jitter over hills; points followed in each, and points that pairs of lines show."""

    def __init__(
        self, seed: int, lines: tuple[tuple[float, float, float], ...], frames: int = FRAMES
    ) -> None:
        rng = np.random.default_rng(seed)
        self.rng, count = rng, frames * len(lines)
        position, attitude, t = [], [], []
        for number, (east, north, heading) in enumerate(lines):
            way = STEP * np.arange(frames)[:, None] * level(heading).apply([1.0, 0.0, 0.0])
            position.append(np.array([east, north, HEIGHT]) + way)
            attitude.append(level(heading).as_quat() * np.ones((frames, 1)))
            t.append(0.1 * np.arange(frames) + 60.0 * number)
        self.t = np.concatenate(t)
        sway = 0.05 * np.sin(2.0 * self.t[:, None] + rng.uniform(0.0, 6.0, 3))
        self.position = np.concatenate(position) + sway
        turn = 0.02 * np.sin(3.0 * self.t[:, None] + rng.uniform(0.0, 6.0, 3))
        self.attitude = Rotation.from_quat(np.concatenate(attitude)) * Rotation.from_rotvec(turn)
        ground = rng.uniform([-90.0, -50.0, -3.0], [180.0, 290.0, 3.0], (2500, 3))
        image, point, pixels, seen = [], [], [], []
        for k in range(count):
            at = self.project(k, ground)
            rows = np.flatnonzero(((at > 0) & (at < np.array(SHAPE) - 1)).all(axis=1))
            seen.append(dict(zip(rows.tolist(), at[rows], strict=True)))
            image.append(np.full(len(rows), k))
            point.append(rows + len(ground) * (k // LIFE + 1000 * (k // frames)))
            pixels.append(at[rows])
        names = np.unique(np.concatenate(point), return_inverse=True)[1]
        images, places = [np.concatenate(image)], [np.concatenate(pixels)]
        last = int(names.max()) + 1
        # every fifth frame of a line with every fifth of later ones
        for i in range(2, count, 5):
            for j in range(i + frames - i % frames, count, 5):
                for name in sorted(set(seen[i]) & set(seen[j]))[:12]:
                    images.append(np.array([i, j]))
                    names = np.append(names, [last, last])
                    places.append(np.array([seen[i][name], seen[j][name]]))
                    last += 1
        where = np.concatenate(places)
        where = where + 0.1 * rng.standard_normal(where.shape)
        self.tracks = Tracks(np.concatenate(images), names, where, np.array(0.1))
        bias, bent = rng.standard_normal(3), 0.01 * rng.standard_normal(3)
        self.images = Images(
            np.zeros(count), np.arange(count), self.t,
            self.position + bias + 0.3 * rng.standard_normal((count, 3)),
            self.attitude * Rotation.from_rotvec(bent + 0.003 * rng.standard_normal((count, 3))),
        )  # fmt: skip
        self.known = RoughPoses(np.full((count, 3), 0.3), np.full((count, 3), 0.003), 1.0, 0.01)
        self.priors = PointPriors(HeightPrior(Plane(0.0), 1.75, None))

    def project(self, k: int, points: np.ndarray) -> np.ndarray:
        forward, right, down = self.attitude[k].inv().apply(points - self.position[k]).T
        middle = (np.array(SHAPE) - 1.0) / 2.0
        return middle + FOCAL * np.column_stack([forward / down, -right / down])

    def sightings(self) -> Sightings:
        return sight_frames(self.images, [DETECTOR], [NADIR_MOUNT], self.tracks)

    def solve(self, **given) -> FramePoses:
        return adjust_frames(self.images, self.sightings(), self.known, priors=self.priors, **given)


def together(images, sightings):
    return one_band(len(images), sightings)


def reductions(flight: Flight) -> tuple[PointsFirst, LinkedFrames, Curvature]:
    """The same equations by both orders, the frames in order of time."""
    sightings = flight.sightings()
    order = solving_order(flight.images, sightings)
    assert order.last is not None
    unknowns = frame_unknowns(flight.images, flight.known, np.full(6, 1e-2))
    block = BlockSums(sightings, unknowns, flight.priors)
    state, usable = first_state(block, seen_twice(sightings, flight.priors), None)
    weight = usable.astype(float)
    weight[::97] = 0.0  # gross errors
    curvature, _ = block.curvature(state, weight)
    return (
        PointsFirst(curvature, unknowns),
        LinkedFrames(curvature, replace(unknowns, last=order.last)),
        curvature,
    )  # fmt: skip


@pytest.mark.parametrize(("lines", "focal"), [(BESIDE[:2], 0.0), (CROSSING, 0.01)])
def test_lines_by_themselves_give_the_numbers_of_one_band(lines, focal):
    flight = Flight(len(lines), lines)
    flight.known = replace(flight.known, focal_length=focal)
    plain, linked, curvature = reductions(flight)
    rng = np.random.default_rng(0)
    # rounding of a matrix whose condition is some 1e6
    unit = np.sqrt(np.outer(np.diag(plain.information), np.diag(plain.information)))
    np.testing.assert_allclose(linked.information / unit, plain.information / unit, atol=1e-8)
    common = np.linalg.inv(plain.information)
    expected = plain.departure_covariance(common)
    size = np.sqrt(np.einsum("kii->ki", expected))
    error = (linked.departure_covariance(common) - expected) / (size[:, :, None] * size[:, None, :])
    assert np.abs(error).max() < 1e-8
    # sums of one number of one frame each: their covariance with all is a column of the whole covariance
    frame, number = np.array([0, 5, 11]), np.array([0, 4, 2])
    forms = np.zeros((*size.shape, 3))
    forms[frame, number, np.arange(3)] = 1.0
    of_forms = plain.form_covariance(common, forms)
    unit = size[:, :, None] * size[frame, number]
    error = of_forms[frame, :, np.arange(3)] - expected[frame, :, number]
    assert np.abs(error / unit[frame, :, np.arange(3)]).max() < 1e-8
    assert np.abs((linked.form_covariance(common, forms) - of_forms) / unit).max() < 1e-8
    own = rng.standard_normal((len(flight.images), 6))
    points = rng.standard_normal((len(curvature.of_points), 3))
    right = rng.standard_normal(len(common))
    left = plain.condense(own, points, right)
    np.testing.assert_allclose(linked.condense(own, points, right), left, atol=1e-8 * np.abs(left).max())
    step = common @ left
    for found, wanted in zip(
        linked.solve(own, points, right, step), plain.solve(own, points, right, step), strict=True
    ):
        assert np.abs(found - wanted).max() < 1e-8 * np.abs(wanted).max()


def test_a_flight_is_solved_alike_in_either_order(monkeypatch):
    flight = Flight(7, CROSSING, 40)
    bad = flight.rng.random(len(flight.tracks)) < 0.01
    pixels = flight.tracks.pixels + bad[:, None] * flight.rng.uniform(5.0, 20.0, (len(bad), 2))
    flight.tracks = replace(flight.tracks, pixels=pixels)
    linked = flight.solve()
    assert solving_order(flight.images, flight.tracks).last is not None
    monkeypatch.setattr(frame_poses, "solving_order", together)
    plain = flight.solve()
    np.testing.assert_array_equal(linked.rejected, plain.rejected)
    sigma = np.sqrt(np.einsum("kii->ki", plain.covariance))
    turn = (plain.world_from_body.inv() * linked.world_from_body).as_rotvec()
    moved = np.concatenate([linked.position - plain.position, turn], axis=1) / sigma
    # steps end a hundredth of a sigma from the least cost; both take the same ones
    assert np.abs(moved).max() < 1e-5
    apart = (linked.covariance - plain.covariance) / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(apart).max() < 1e-6
    np.testing.assert_allclose(linked.bow, plain.bow, rtol=1e-6)
    apart = (linked.next_covariance - plain.next_covariance) / (sigma[1:, :, None] * sigma[:-1, None, :])
    assert np.abs(apart).max() < 1e-6
    assert linked.scale_sigma == pytest.approx(plain.scale_sigma, rel=1e-6)
    known = np.sqrt(np.diag(plain.bias_covariance))
    assert (np.abs(linked.bias - plain.bias) < 1e-5 * known).all()
    apart = (linked.bias_covariance - plain.bias_covariance) / np.outer(known, known)
    assert np.abs(apart).max() < 1e-6


def test_every_point_that_lines_share_has_all_but_one_of_its_lines_frames_solved_last():
    flight = Flight(3, CROSSING)
    order = solving_order(flight.images, flight.tracks)
    assert order.last is not None
    by_point, run, shared = runs_of_points(flight.tracks.image, flight.tracks.point)
    image, point = flight.tracks.image[by_point], flight.tracks.point[by_point]
    assert shared.sum() > 500
    free = ~order.last[image] & shared[point]
    for name in np.unique(point[free]):
        assert len(np.unique(run[free & (point == name)])) == 1
    # a frame of each pair is enough
    assert order.last.sum() < 0.6 * len(np.unique(image[shared[point]]))
    assert order.multiplications < together(flight.images, flight.tracks).multiplications


def test_a_single_line_stays_one_band_in_order_of_time():
    flight = Flight(1, BESIDE[:1])
    order = solving_order(flight.images, flight.tracks)
    assert order.last is None
    np.testing.assert_array_equal(order.rank, np.arange(FRAMES))


def test_frames_far_apart_are_those_that_a_point_is_in_but_not_followed_between():
    rng = np.random.default_rng(3)
    point = np.sort(rng.integers(0, 9, 60))
    frame, run = rng.integers(0, 12, 60), np.cumsum(rng.random(60) < 0.5)
    wanted = {
        (int(frame[i]), int(frame[j]))
        for j in range(60) for i in range(j) if point[i] == point[j] and run[i] != run[j]
    }  # fmt: skip
    assert _far_pairs(frame, point, run).tolist() == sorted(map(list, wanted))
