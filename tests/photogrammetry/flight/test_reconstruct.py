"""Photogrammetry on a subset: pairs, the way to the world, and a small rendered flight by pycolmap."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.photogrammetry.steady_flight import steady
from tests.sequence_flights import problem_of as given_problem

from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.errors import EstimationError, InputError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.flight import reconstruct as reconstruct_module
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.reconstruct import (
    filter_pairs,
    held,
    looking_down,
    reconstruct,
    similarity,
)
from sightline.photogrammetry.flight.warnings import bow_warnings
from sightline.simulate.sequence import SequenceScenario, sequence_case

LEVEL = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
PLAIN = AreaDetector("frame", (200, 300), 400.0, (99.5, 149.5))
#: 3 nm a line.
FILTER = AreaDetector("frame", (200, 300), 400.0, (99.5, 149.5), (), np.linspace(400.0, 997.0, 200))
EACH_TENTH = np.arange(0, 60, 10)


# ---------------------------------------------------------------------------------------------------- pairs


def test_pairs_overlap_and_show_the_ground_in_like_wavelengths():
    flight = steady(60, 4.0)
    plain = filter_pairs(EACH_TENTH, flight, PLAIN)
    # 40 lines from one to the next: up to 120 of 200 lines is three of them
    assert plain == [(i, j) for i in EACH_TENTH for j in EACH_TENTH if 0 < j - i <= 30]
    # 200 nm are 66 lines: one of them
    assert filter_pairs(EACH_TENTH, flight, FILTER) == [(i, i + 10) for i in EACH_TENTH[:-1]]
    # neighbours are compared whatever they are
    assert filter_pairs(EACH_TENTH[::3], flight, FILTER) == [(0, 30)]


def test_stretches_are_paired_where_they_may_meet():
    flight = steady(60, 4.0, breaks=(30,))
    every = filter_pairs(EACH_TENTH, flight, FILTER)
    across = [(i, j) for i in (0, 10, 20) for j in (30, 40, 50)]
    assert [pair for pair in every if pair[0] < 30 <= pair[1]] == across
    # the second line is flown back beside the first, 50 m off
    along = 2.0 * np.concatenate([np.arange(30), np.arange(29, -1, -1)])
    place = np.column_stack([np.repeat([0.0, 50.0], 30), along, np.full(60, 100.0)])
    near = filter_pairs(EACH_TENTH, flight, FILTER, place, np.full(60, 27.0))
    # frames 0, 10, 20 are 0, 20, 40 m along, frames 30, 40, 50 58, 38, 18 m: within 54 m of each other
    assert [pair for pair in near if pair[0] < 30 <= pair[1]] == [
        (0, 50),
        (10, 40),
        (10, 50),
        (20, 30),
        (20, 40),
    ]
    assert [pair for pair in near if pair[1] < 30] == [pair for pair in every if pair[1] < 30]
    unknown = np.where(np.arange(60) == 50, np.inf, 27.0)
    assert (20, 50) in filter_pairs(EACH_TENTH, flight, FILTER, place, unknown)


# ---------------------------------------------------------------------------------------------------- world


@pytest.mark.parametrize("single_line", [False, True])
def test_a_model_is_brought_to_the_world(single_line):
    rng = np.random.default_rng(0)
    wanted = np.column_stack([rng.uniform(-30.0, 30.0, 12), np.linspace(0.0, 200.0, 12), np.full(12, 80.0)])
    if single_line:
        wanted[:, 0] = 0.0
    camera = LEVEL * NADIR_MOUNT * Rotation.identity(12)
    if camera.apply([0.0, 0.0, 1.0])[0, 2] > 0.0:
        raise AssertionError("cameras look down")
    turn, scale, moved = Rotation.from_rotvec([0.4, -1.0, 2.0]), 7.0, np.array([5.0, -3.0, 2.0])
    model = turn.inv().apply((wanted - moved) / scale)
    found = similarity(model, wanted, turn.inv() * camera, np.array([0.0, 0.0, -1.0]), 0.1)
    assert found[0] == pytest.approx(scale)
    # a line leaves the turn about it to what cameras see, which here is down exactly
    assert (found[1].inv() * turn).magnitude() < 1e-9
    np.testing.assert_allclose(found[2], moved, atol=1e-7)


# ---------------------------------------------------------------------------------------------- what is known


def test_attitudes_that_are_not_given_are_held_at_first_and_free_afterwards():
    known = RoughPoses(np.ones((4, 3)), np.full((4, 3), np.inf), 2.0, 0.0)
    first = held(known)
    assert np.isfinite(first.attitude).all() and first.attitude_bias > 0.0
    assert (first.position == known.position).all() and first.position_bias == 2.0
    assert np.isinf(known.attitude).all()
    assert looking_down(known).attitude_bias >= 0.1  # rad; no more is claimed than "down"
    given = RoughPoses(np.ones((4, 3)), np.full((4, 3), 0.01))
    assert held(given) is given and looking_down(given) is given


def test_a_strip_that_may_be_bent_is_named():
    problem = SimpleNamespace(detector=PLAIN, t=np.array([0.0, 1.0, 2.0, 60.0, 61.0]))
    # ends of an even trend are at the root of 3: 400 px x 0.002 rad x 1.73 = 1.4 px
    bent = np.array([[1e-4, 2e-3, 1e-4], [1e-4, 1e-4, 1e-4]])
    (words,) = bow_warnings(problem, SimpleNamespace(bow=bent, detector=lambda given: given))
    assert "stretch 1 (3 frames)" in words and "pitch" in words and "0.11 deg" in words and "1.4 px" in words
    straight = SimpleNamespace(bow=np.full((2, 3), 1e-3), detector=lambda given: given)
    assert bow_warnings(problem, straight) == []


# -------------------------------------------------------------------------------------------------- pycolmap


def problem_of(scenario: SequenceScenario, *, blind: bool) -> SequenceProblem:
    """The flight; `blind`: no given attitude."""
    problem = given_problem(scenario)
    if not blind:
        return problem
    known, images = problem.known, problem.images
    return replace(
        problem,
        known=replace(known, attitude=np.full_like(known.attitude, np.inf), attitude_bias=0.0),
        images=replace(images, world_from_body=LEVEL * Rotation.identity(len(images))),
    )


def between_px(scenario: SequenceScenario, found: SequencePoses) -> float:
    """px rms of the place where the middle of the frame meets the ground, between every tenth frame."""
    _, position, attitude = scenario.poses
    down = NADIR_MOUNT.apply([0.0, 0.0, 1.0])

    def met(place: np.ndarray, turn: Rotation) -> np.ndarray:
        ray = turn.apply(down)
        return (place - ray * (place[:, 2] / ray[:, 2])[:, None])[:, :2]

    poses = found.poses
    error = met(poses.position, poses.world_from_body) - met(position, attitude)
    left = []
    for a in range(0, len(error) - 10, 10):
        w = np.arange(10)[:, None] / 10.0
        left.append(error[a : a + 10] - (1.0 - w) * error[a] - w * error[a + 10])
    return float(np.sqrt((np.concatenate(left) ** 2).sum(axis=1).mean()) / scenario.options.gsd)


@pytest.fixture(scope="module")
def flight() -> SequenceScenario:
    return sequence_case("small", 3, frames=31)


@pytest.mark.parametrize("blind", [True, False])
def test_a_flight_begins_with_a_model_of_its_subset(flight, blind):
    pytest.importorskip("pycolmap")
    problem = problem_of(flight, blind=blind)
    found = georeference_sequence(problem, photogrammetry=None if blind else True)
    assert found.model is not None
    assert set(found.model.frames) <= set(found.subset.frames) and len(found.model.frames) >= 3
    # as from given attitudes: some 50 windows a frame, 0.1 px with their drift, thrice that at most
    assert between_px(flight, found) < 0.1
    attitude = flight.poses[2]
    for poses, rows in ((found.poses, np.arange(31)), (found.model.poses, found.model.frames)):
        error = (attitude[rows].inv() * poses.world_from_body).as_rotvec()
        sigma = np.sqrt(np.diagonal(poses.covariance, axis1=1, axis2=2))[:, 3:]
        # five sigmas of the worst of a few dozen numbers that mostly go together
        assert (np.abs(error) < 5.0 * sigma).all()
        far = (rows - rows.mean()) / rows.std()
        # the bow that there is, beside what is said of it; one draw
        assert (np.abs((error * far[:, None]).mean(axis=0)) < 4.0 * poses.bow[0]).all()


def test_a_model_of_a_rolling_shutter_is_as_high_as_its_sigma_says():
    pytest.importorskip("pycolmap", reason="models of frames are made by pycolmap, extra sfm")
    still = sequence_case("small", 2, filter="pan", frames=16, overlap=0.8)
    # read out over half of the time to the next frame: ground is 10 % shorter in a frame than it is
    step = float(np.median(np.diff(still.poses[0])))
    flight = sequence_case("small", 2, filter="pan", frames=16, overlap=0.8, readout_time=0.5 * step)
    model = georeference_sequence(problem_of(flight, blind=True)).model
    assert model is not None
    error = model.poses.position - flight.poses[1][model.frames]
    sigma = np.sqrt(np.diagonal(model.poses.covariance, axis1=1, axis2=2))[:, :3]
    # errors of the tables' places are one draw per axis; heights are 11 sigmas off if all lines are taken
    # to be exposed at once
    assert (np.abs(error.mean(axis=0)) < 3.0 * sigma.mean(axis=0)).all()


def test_without_pycolmap_one_clear_error_and_flights_with_attitudes_run(monkeypatch):
    flight = sequence_case("small", 4, frames=6)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match="run `pip install pycolmap`"):
        georeference_sequence(problem_of(flight, blind=True))
    assert georeference_sequence(problem_of(flight, blind=False)).model is None


def test_frames_that_no_points_place_make_no_model(monkeypatch, flight):
    # as mapping leaves frames of a field so narrow that it takes all its points back
    pytest.importorskip("pycolmap")
    bare = [SimpleNamespace(name=f"{k:06d}.png", has_pose=True, num_points3D=k % 2) for k in range(4)]
    model = SimpleNamespace(images=dict(enumerate(bare)), points3D={0: None})
    monkeypatch.setattr(reconstruct_module, "_mapped", lambda *_: model)
    problem = problem_of(flight, blind=True)
    with pytest.raises(EstimationError, match=r"gave no model: 0 of them .* degrees\); .* give attitudes"):
        reconstruct(
            problem.sources, np.arange(4), [(0, 1)], flight.detector, NADIR_MOUNT, problem.images.position,
            problem.known.position,
        )  # fmt: skip


def test_a_model_that_sees_the_ground_from_below_is_refused(monkeypatch, flight):
    # rays of a narrow field are nearly parallel: ground and its mirror image look alike
    pytest.importorskip("pycolmap", reason="models of frames are made by pycolmap, extra sfm")
    problem = problem_of(flight, blind=True)
    up = SimpleNamespace(rotation=SimpleNamespace(matrix=lambda: np.eye(3)))
    seen = [
        SimpleNamespace(
            name=f"{k:06d}.png", has_pose=True, num_points3D=9, cam_from_world=lambda: up,
            projection_center=lambda k=k: np.array([k % 3, k, 0.0]), get_observation_points2D=tuple,
        )
        for k in range(8)
    ]  # fmt: skip
    model = SimpleNamespace(images=dict(enumerate(seen)), points3D={})
    monkeypatch.setattr(reconstruct_module, "_mapped", lambda *_: model)
    place = np.array([[k % 3, k, 0.0] for k in range(8)]) * 20.0 + [0.0, 0.0, 100.0]
    with pytest.raises(EstimationError, match=r"sees the ground from below: .* give attitudes"):
        reconstruct(
            problem.sources, np.arange(8), [(0, 1)], flight.detector, NADIR_MOUNT, place, np.ones((8, 3))
        )


def test_a_model_needs_three_positions_and_frames_that_are_alike(flight):
    pytest.importorskip("pycolmap")
    problem = problem_of(flight, blind=True)
    frames = np.array([0, 10, 20, 30])
    given = (PLAIN, NADIR_MOUNT, problem.images.position)
    with pytest.raises(InputError, match="three positions"):
        reconstruct(problem.sources, frames, [(0, 10)], *given, np.full((31, 3), np.inf))
    rng = np.random.default_rng(0)
    noise = [ArrayImage(rng.normal(100.0, 10.0, flight.options.shape)) for _ in range(31)]
    with pytest.raises(EstimationError, match="gave no model"):
        reconstruct(
            noise, frames, [(0, 10), (10, 20)], flight.detector, NADIR_MOUNT, problem.images.position,
            problem.known.position,
        )  # fmt: skip
