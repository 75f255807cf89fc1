"""Tables against images: a level flight in closed form whose motion through the frames is known.

f = 100 px at 50 m: a pixel is 0.5 m on the ground; 2 m/s forward let the ground move back by 4 lines a
second.
"""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.flight.outlook import ground_motion
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.table_check import misfits, motion_warnings, refuse_contradicted
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
        t=t,
        images=images,
        known=known,
        detector=detector,
        mount=NADIR_MOUNT,
        surface=Plane(0.0),
        height_sigma=1.0,
        radii=None,
        frames=tuple(f"f{k}" for k in range(COUNT)),
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


def test_images_that_move_as_the_tables_say_cause_no_warning_and_others_do(problem):
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


def solution(problem, scale=1.0, **more):
    """Poses and points whose path is the given one and whose heights are `scale` times the given ones."""
    rng = np.random.default_rng(2)
    truth = np.column_stack([np.zeros(COUNT), 2.0 * problem.t, np.full(COUNT, 50.0)])
    points = np.column_stack([rng.uniform(-20.0, 140.0, (30, 2)), np.full(30, 50.0 * (1.0 - scale))])
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.01, (COUNT, 3)))
    given = {"position": truth, "points": points, "bias": np.zeros(6), "detector": lambda detector: detector}
    more = {"world_from_body": NORTH * turned} | more
    return SimpleNamespace(**given | more)


def said(problem, found):
    return [misfit.words for misfit in misfits(problem, found)]


def test_what_goes_together_says_nothing(problem):
    assert not said(problem, solution(problem))


@pytest.mark.parametrize(
    ("scale", "sigma", "hopeless"), [(1.5, 1.0, True), (0.5, 1.0, True), (1.5, 5.0, False)]
)
def test_a_lens_that_contradicts_heights_is_reported_with_what_fits(problem, scale, sigma, hopeless):
    problem.height_sigma = sigma
    (found,) = misfits(problem, solution(problem, scale))
    assert found.hopeless == hopeless
    assert "focal_length_px, [surface] height and the positions contradict one another" in found.words
    # 100 px let heights of 50 m be `scale` times as many: to the noise of a path of 120 m
    assert float(re.search(r"focal_length_px = ([0-9.]+)", found.words)[1]) == pytest.approx(
        100 / scale, rel=0.02
    )
    height = float(re.search(r"height = (-?[0-9.]+) m \(now 0\)", found.words)[1])
    assert height == pytest.approx(50.0 * (1.0 - scale), abs=1.0)
    # of 50 * |scale - 1| m, the height of the ground known to sigma; places hardly count
    sigmas = float(re.search(r"by ([0-9.]+) sigmas", found.words)[1])
    assert sigmas == pytest.approx(25.0 / sigma, rel=0.1)
    if hopeless:
        with pytest.raises(EstimationError, match=r"contradicts itself.*focal_length_px"):
            refuse_contradicted(problem, solution(problem, scale))
    # a ground of which nothing is known contradicts nothing
    problem.height_sigma = 0.0
    assert not said(problem, solution(problem, scale))


def test_three_frames_are_enough_to_contradict(problem):
    few = np.arange(3)
    problem.images, problem.known = problem.images[few], problem.known[few]
    truth = np.array([[0.0, 0.0, 50.0], [0.0, 10.0, 50.0], [0.0, 20.0, 50.0]])
    problem.images = replace(problem.images, position=truth)
    given = {"position": truth, "world_from_body": problem.images.world_from_body}
    assert not said(problem, solution(problem, 1.0, **given))
    assert "contradict one another" in said(problem, solution(problem, 1.5, **given))[0]


@pytest.mark.parametrize(("size", "status"), [(1.0, "nothing"), (12.0, "warned"), (25.0, "refused")])
def test_constant_errors_beyond_their_sigma_name_their_key(problem, size, status):
    problem.known = replace(problem.known, position_bias=2.0, attitude_bias=0.01)
    problem.images = replace(problem.images, position=problem.images.position + np.array([size, 0.0, 0.0]))
    found = solution(problem, bias=np.array([size, 0.0, 0.0, 0.0, 0.0, 0.0]))
    words = said(problem, found)
    if status == "nothing":
        assert not words
        return
    # chi squared of three numbers is beyond 21 once in 10,000
    assert f"is {size / 2.0:.3g} times position_bias_sigma = 2 m" in words[0]
    assert misfits(problem, found)[0].hopeless == (status == "refused")
    found.bias = np.array([0.0, 0.0, 0.0, 0.06, 0.0, 0.0])
    problem.images = replace(problem.images, position=found.position)
    assert any("6 times attitude_bias_sigma" in text for text in said(problem, found))


def test_a_single_gross_row_is_named(problem):
    place = problem.images.position.copy()
    place[17, 0] += 20.0
    problem.images = replace(problem.images, position=place)
    (words,) = said(problem, solution(problem))
    missed = re.search(r"positions of frames f17 miss the poses found by up to ([0-9.]+) m", words)
    assert float(missed[1]) == pytest.approx(20.0, abs=4.0 * NOISE)


def test_rows_that_miss_the_poses_found_are_reported(problem):
    rng = np.random.default_rng(2)
    found = solution(
        problem,
        position=problem.images.position - [5.0, 0.0, 0.0] - rng.normal(0.0, NOISE, (COUNT, 3)),
        world_from_body=problem.images.world_from_body
        * Rotation.from_rotvec(rng.normal(0.0, 0.01, (COUNT, 3))),
        bias=np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    # a bias found is none of the rows' own errors
    assert not said(problem, found)
    found.bias = np.zeros(6)
    (words,) = said(problem, found)
    assert "positions of the tables miss the poses found by 5" in words
    found.bias[0] = 5.0
    problem.known = RoughPoses(problem.known.position, np.full((COUNT, 3), 0.001))
    (words,) = said(problem, found)
    # ten times too small a sigma; the median of 60 squares is good to 15 per cent
    assert "attitudes of the tables miss" in words
    assert float(words.split("degrees, ")[1].split(" times")[0]) == pytest.approx(10.0, rel=0.2)
