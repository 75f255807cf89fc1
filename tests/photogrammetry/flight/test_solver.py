"""What a sequence's sightings are solved with: how much a surface tells of the heights of all points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.solver import SequenceSolver, tracks_of
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
