"""What a sequence's sightings are solved with: how much a surface tells of the heights of all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight import solver as solver_module
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.solver import SequenceSolver, tracks_of
from sightline.photogrammetry.flight.table_check import table_fits
from sightline.photogrammetry.sightings import Images, Tracks, appended

SHAPE, FOCAL, HEIGHT, COUNT, SIGMA = (160, 200), 250.0, 80.0, 20, 1.5
MIDDLE = 0.5 * (np.array(SHAPE) - 1.0)


@pytest.fixture(scope="module")
def solver() -> SequenceSolver:
    """Level flight north, 2 m a frame; 15 points begin in each frame."""
    rng = np.random.default_rng(0)
    position = np.column_stack([np.zeros(COUNT), 2.0 * np.arange(COUNT), np.full(COUNT, HEIGHT)])
    # world_from_body of level flight north: x forward = north, y right = east, z down
    level = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    images = Images(
        np.zeros(COUNT), np.arange(COUNT), np.arange(COUNT) / 25.0, position,
        Rotation.concatenate([level] * COUNT),
    )  # fmt: skip
    known = RoughPoses(np.ones((COUNT, 3)), np.full((COUNT, 3), 0.01))
    problem = SequenceProblem(
        tuple(map(str, range(COUNT))), images.t, (ArrayImage(np.zeros(SHAPE)),) * COUNT,
        AreaDetector("frame", SHAPE, FOCAL, (MIDDLE[0], MIDDLE[1])), NADIR_MOUNT, images, known, Plane(0.0),
        SIGMA, 0.0, 0.8, ("",) * COUNT,
    )  # fmt: skip
    image = np.repeat(np.arange(COUNT), 15)
    nothing = np.full(COUNT, np.nan)
    followed = Followed(
        image, np.arange(len(image)), pixels(rng, len(image)), np.full(len(image), 0.1),
        np.arange(COUNT) - 1, np.full((COUNT, 4), np.nan), np.full(COUNT, 15), nothing, nothing,
        ("",) * COUNT,
    )  # fmt: skip
    return SequenceSolver(problem, followed)


def pixels(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(0.0, np.array(SHAPE) - 1.0, (count, 2))


def mean_height_sigma(tracks: Tracks) -> float:
    """m: of the mean height of points, where errors go together over the area of a frame."""
    first = np.unique(tracks.point, return_index=True)[1]
    x = (tracks.pixels[first] - MIDDLE) * HEIGHT / FOCAL
    place = np.column_stack([-x[:, 1], x[:, 0] + 2.0 * tracks.image[first]])
    area = SHAPE[0] * SHAPE[1] * (HEIGHT / FOCAL) ** 2
    apart = ((place[:, None] - place) ** 2).sum(axis=-1)
    return SIGMA * float(np.sqrt(np.exp(-np.pi * apart / area).mean()))


def height_sigma_of(solver: SequenceSolver, tracks: Tracks) -> float:
    """m: sigma of the mean height by rows of equal weight, one for each point."""
    prior = solver.heights(tracks)
    assert prior is not None
    return prior.sigma / np.sqrt(len(np.unique(tracks.point)))


def test_the_surface_tells_the_mean_height_once_however_points_came_about(solver):
    rng = np.random.default_rng(1)
    own = tracks_of(solver.followed)
    # as many points again, seen from both ends of the flight: what stretches have in common
    image = np.tile([2, COUNT - 3], 300)
    shared = Tracks(image, np.repeat(np.arange(300), 2), pixels(rng, 600), np.array(0.1))
    both = appended(own, shared)
    # exact; among no more than 600 points all distances are looked at
    assert height_sigma_of(solver, own) == pytest.approx(mean_height_sigma(own), rel=1e-6)
    assert height_sigma_of(solver, both) == pytest.approx(mean_height_sigma(both), rel=1e-6)
    # counted as those followed are, points in common would have made it smaller by the root of two
    assert height_sigma_of(solver, both) > 0.9 * height_sigma_of(solver, own)


def photographs(seed: int) -> tuple[SequenceProblem, Followed, np.ndarray, Rotation]:
    """Six photographs of a line, 60 % of overlap; GPS to 3 m, gimbal to 2 degrees. And the truth."""
    rng = np.random.default_rng(seed)
    shape, focal, frames, sigma, turn = (2250, 4000), 2311.0, 6, 3.0, np.radians(2.0)
    middle = 0.5 * (np.array(shape) - 1.0)
    position = np.column_stack([15.6 * np.arange(frames), np.zeros(frames), np.full(frames, 40.0)])
    position += rng.normal(0.0, 0.5, (frames, 3))
    level = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))  # x forward, y right, z down
    attitude = level * Rotation.from_rotvec(np.radians(rng.normal(0.0, 3.0, (frames, 3))))
    ground = np.column_stack(
        [rng.uniform(-30.0, 110.0, 800), rng.uniform(-40.0, 40.0, 800), rng.normal(0.0, 1.0, 800)]
    )
    image, point, pixels = [], [], []
    for k in range(frames):
        forward, right, down = attitude[k].inv().apply(ground - position[k]).T
        at = middle + focal * np.column_stack([forward, -right]) / down[:, None]
        inside = np.flatnonzero(((at > 5.0) & (at < np.array(shape) - 6.0)).all(axis=1))
        image += [k] * len(inside)
        point += inside.tolist()
        pixels.append(at[inside] + rng.normal(0.0, 0.5, (len(inside), 2)))
    order = np.lexsort((image, point))
    images, points = np.array(image)[order], np.array(point)[order]
    twice = np.bincount(points)[points] >= 2
    images, points = images[twice], np.unique(points[twice], return_inverse=True)[1]
    t, ones, wrong = 7.0 * np.arange(frames), np.ones(frames), rng.normal(0.0, turn, (frames, 3))
    given = Images(
        np.zeros(frames), np.arange(frames), t, position + rng.normal(0.0, sigma, (frames, 3)),
        attitude * Rotation.from_rotvec(wrong),
    )  # fmt: skip
    known = RoughPoses(np.full((frames, 3), sigma), np.full((frames, 3), turn), sigma, turn)
    problem = SequenceProblem(
        tuple(map(str, range(frames))), t, (ArrayImage(np.ones((4, 4))),) * frames,
        AreaDetector("camera", shape, focal, (middle[0], middle[1])), NADIR_MOUNT, given, known, Plane(0.0),
        1.0, 0.0, 0.8, ("",) * frames,
    )  # fmt: skip
    followed = Followed(
        images, points, np.concatenate(pixels)[order][twice], np.full(len(images), 0.5),
        np.arange(frames) - 1, np.zeros((frames, 4)), np.bincount(images), ones, ones, ("",) * frames, True,
    )  # fmt: skip
    return problem, followed, position, attitude


def test_a_line_of_few_photographs_is_as_long_as_it_was_flown():
    # A path held to the smoothness of its tables shrank to .75-.95 of its length, off by up to 7 sigma.
    squares = []
    for seed in (0, 1, 9):
        problem, followed, position, attitude = photographs(seed)
        found = SequenceSolver(problem, followed).approached()
        poses = found.poses
        assert not found.words
        turn = (attitude.inv() * poses.world_from_body).as_rotvec()
        error = np.concatenate([poses.position - position, turn], axis=1)
        squares.append(
            np.einsum("ki,ki->k", error, np.linalg.solve(poses.covariance, error[..., None])[..., 0])
        )
        assert all(fit.chi_squared < chi2.isf(1e-3, fit.numbers) for fit in table_fits(problem, poses))
    # all frames of a line share one draw of the constant errors, which are not drawn here: no lower bound
    assert np.mean(squares) < 6.0 * chi2.isf(1e-3, 18) / 18.0


def test_of_two_starts_the_one_of_least_cost_holds(monkeypatch):
    problem, followed, *_ = photographs(0)
    solver = SequenceSolver(problem, followed)
    tracks = tracks_of(followed)
    good = replace(solver.solve(tracks, None), cost=10.0)
    rough = replace(tracks, sigma_px=np.full(len(tracks), 50.0))
    bad = replace(solver.solve(rough, None), cost=20.0)
    for first, other in ((good, bad), (bad, good)):
        monkeypatch.setattr(solver_module, "approached", lambda *_, first=first: (tracks, first, []))
        monkeypatch.setattr(solver, "solve", lambda *_, other=other, **__: other)
        np.testing.assert_array_equal(solver._best_start(tracks)[1].position, good.position)
