"""Tables against images: a level flight in closed form whose motion through the frames is known.

f = 100 px at 50 m: a pixel is 0.5 m on the ground; 2 m/s forward let the ground move back by 4 lines a
second.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.flight.outlook import ground_motion
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.table_check import motion_warnings, table_warnings
from sightline.photogrammetry.sightings import Images

COUNT, NOISE = 60, 0.5
NORTH = Rotation.from_quat([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])


@pytest.fixture
def problem():
    t = np.arange(float(COUNT))
    position = np.column_stack([np.zeros(COUNT), 2.0 * t, np.full(COUNT, 50.0)])
    position += np.random.default_rng(0).normal(0.0, NOISE, position.shape)
    order = np.arange(COUNT)
    detector = AreaDetector("camera", (60, 80), 100.0, (29.5, 39.5))
    images = Images(np.zeros(COUNT, dtype=int), order, t, position, Rotation.concatenate([NORTH] * COUNT))
    known = RoughPoses(np.full((COUNT, 3), NOISE), np.full((COUNT, 3), 0.01))
    return SimpleNamespace(
        t=t, images=images, known=known, detector=detector, mount=NADIR_MOUNT, surface=Plane(0.0)
    )


def followed(rate, problem):
    """Frames linked to those before, lines moving by `rate` px/s under a jitter of attitude of 3 px."""
    motion = np.zeros((COUNT, 4))
    motion[:, :2] = [rate, 0.0]
    motion[:, :2] += np.random.default_rng(1).normal(0.0, 3.0, (COUNT, 2))
    return SimpleNamespace(before=np.arange(COUNT) - 1, motion=motion)


def test_the_ground_moves_by_speed_over_distance(problem):
    moved, speed = ground_motion(problem)
    # places 4 m apart, 0.5 m of noise each: sqrt(2) / 8 of the speed; the median of 60 is better
    assert speed == pytest.approx(2.0, rel=0.14)
    assert abs(np.median(moved[:, 0])) == pytest.approx(4.0, rel=0.14)
    assert np.abs(np.median(moved[:, 1])) < 0.5


def test_images_that_move_as_told_say_nothing_and_others_do(problem):
    back = float(np.sign(np.median(ground_motion(problem)[0][:, 0])))
    assert not motion_warnings(problem, followed(4.0 * back, problem))
    (words,) = motion_warnings(problem, followed(16.0 * back, problem))
    assert "times as fast as the rough poses say" in words
    # a factor of four, to the noise of the speed and of the jitter (3 px of 4 in each of 60 frames)
    assert float(words.split("frames ")[1].split(" times")[0]) == pytest.approx(4.0, rel=0.25)
    (words,) = motion_warnings(problem, followed(-4.0 * back, problem))
    assert "otherwise than the rough poses say" in words


def test_a_flight_that_hardly_moves_says_nothing(problem):
    problem.images = replace(problem.images, position=np.tile([0.0, 0.0, 50.0], (COUNT, 1)))
    assert not motion_warnings(problem, followed(0.1, problem))


def test_rows_that_miss_the_poses_found_are_told(problem):
    rng = np.random.default_rng(2)
    found = SimpleNamespace(
        position=problem.images.position - [5.0, 0.0, 0.0] - rng.normal(0.0, NOISE, (COUNT, 3)),
        world_from_body=problem.images.world_from_body
        * Rotation.from_rotvec(rng.normal(0.0, 0.01, (COUNT, 3))),
        bias=np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    # a bias found is none of the rows' own errors
    assert not table_warnings(problem, found)
    found.bias = np.zeros(6)
    (words,) = table_warnings(problem, found)
    assert "positions of the tables miss the poses found by 5" in words
    found.bias[0] = 5.0
    problem.known = RoughPoses(problem.known.position, np.full((COUNT, 3), 0.001))
    (words,) = table_warnings(problem, found)
    # ten times too small a sigma; the median of 60 squares is good to 15 per cent
    assert "attitudes of the tables miss" in words
    assert float(words.split("degrees, ")[1].split(" times")[0]) == pytest.approx(10.0, rel=0.2)
