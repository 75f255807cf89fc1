"""Frames turned against their angles: found by a flight whose positions tell its direction, not by chance."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.turned_frames import quarter_turns
from sightline.photogrammetry.sightings import Images

COUNT, STEP, HEIGHT, FOCAL, SHAPE = 6, 2.0, 80.0, 250.0, (160, 200)
#: world_from_body (x forward, y right, z down) of level flight north.
NORTH = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def quarters(sigma: float, turned: int, seed: int) -> np.ndarray:
    """What is found of a flight north: positions given to `sigma` m, pixels turned by so many quarters."""
    rng = np.random.default_rng(seed)
    place = np.array([[0.0, STEP * k, HEIGHT] for k in range(COUNT)]) + sigma * rng.standard_normal(
        (COUNT, 3)
    )
    attitude = Rotation.from_matrix(np.stack([NORTH] * COUNT))
    images = Images(np.zeros(COUNT), np.arange(COUNT), 0.1 * np.arange(COUNT), place, attitude)
    # lines run forward: ground moves towards smaller lines; pixels turned from line towards column turn it
    moved = complex(-STEP * FOCAL / HEIGHT, 0.0) * 1j**turned
    motion = np.tile([moved.real, moved.imag, 0.0, 0.0], (COUNT, 1))
    nothing, ones = np.zeros(0, dtype=np.intp), np.ones(COUNT)
    followed = Followed(
        nothing, nothing, np.zeros((0, 2)), np.zeros(0), np.arange(COUNT) - 1, motion, ones.astype(np.intp),
        ones, ones, ("",) * COUNT,
    )  # fmt: skip
    known = RoughPoses(np.full((COUNT, 3), max(sigma, 1e-3)), np.full((COUNT, 3), 0.01))
    detector = AreaDetector("frame", SHAPE, FOCAL, (79.5, 99.5))
    return np.asarray(quarter_turns(images, known, detector, NADIR_MOUNT, Plane(0.0), followed))


def test_a_flight_with_good_positions_tells_how_its_pixels_are_turned():
    for turned in range(4):
        for seed in range(20):
            assert (quarters(0.1, turned, seed) == turned).all()


def test_positions_that_tell_no_direction_tell_no_turn():
    # 10 m from the first to the last, given to 4 m each: a turn must be exp(9) times as likely as none
    for seed in range(300):
        assert (quarters(4.0, 0, seed) == 0).all()
