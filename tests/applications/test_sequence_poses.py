"""Poses of all frames of small rendered flights: accuracy, honesty, marks, what goes wrong in flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.sequence_flights import assert_covered, errors_of, problem_of
from threadpoolctl import threadpool_info, threadpool_limits

from consistency import assert_possible
from sightline.applications import sequence_poses
from sightline.applications.sequence_between import interpolate_between
from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.errors import EstimationError, InputError
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.block.descent import DivergedError
from sightline.photogrammetry.flight.interpolation import between_anchors, by_displacement
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.simulate.sequence import SequenceScenario, sequence_case


def ground_error_px(scenario: SequenceScenario, position: np.ndarray, attitude: Rotation) -> np.ndarray:
    """(M, places, 2): where rays meet the mean ground, less where they do by the true poses."""
    lines, columns = scenario.options.shape
    places = np.stack(
        np.meshgrid(np.linspace(20, lines - 21, 4), np.linspace(20, columns - 21, 4), indexing="ij"), axis=-1
    )
    rays = NADIR_MOUNT.apply(scenario.detector.directions(places.reshape(-1, 2)))
    frames = list(scenario.frames)
    _, true_position, true_attitude = scenario.poses

    def met(place: np.ndarray, turn: Rotation) -> np.ndarray:
        ray = turn.apply(rays)
        return (place - ray * (place[2] / ray[:, 2])[:, None])[:, :2]

    errors = [
        met(position[n], attitude[n]) - met(true_position[k], true_attitude[k]) for n, k in enumerate(frames)
    ]
    return np.array(errors) / scenario.options.gsd


def height_of(scenario: SequenceScenario, points: np.ndarray) -> np.ndarray:
    """m, of the relief under points, to the nearest post."""
    relief = scenario.ground.relief
    columns = np.rint((points[:, 0] - relief.west) / relief.posting[0]).astype(int)
    rows = np.rint((relief.north - points[:, 1]) / relief.posting[1]).astype(int)
    last = np.array(relief.heights.shape) - 1
    return relief.heights[np.clip(rows, 0, last[0]), np.clip(columns, 0, last[1])]


def between(errors: np.ndarray, stride: int) -> float:
    """px rms of what is left between every `stride`-th frame."""
    left = []
    for a in range(0, len(errors) - stride, stride):
        w = np.arange(stride)[:, None, None] / stride
        left.append(errors[a : a + stride] - (1.0 - w) * errors[a] - w * errors[a + stride])
    return float(np.sqrt((np.concatenate(left) ** 2).sum(axis=-1).mean()))


@pytest.fixture(scope="module")
def flight() -> SequenceScenario:
    return sequence_case("small", 3)


@pytest.fixture(scope="module")
def solved(flight: SequenceScenario) -> SequencePoses:
    return georeference_sequence(problem_of(flight))


def test_linear_algebra_runs_on_one_thread(flight):
    # threads of a small band wait for each other: five times the processor time where the machine is busy
    threads = set()

    def look(*_: object) -> None:
        threads.update(
            library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
        )

    problem = problem_of(flight)
    first = np.arange(8)
    few = replace(
        problem, frames=problem.frames[:8], t=problem.t[:8], sources=problem.sources[:8],
        images=problem.images[first], known=problem.known[first], excluded=problem.excluded[:8],
    )  # fmt: skip
    with threadpool_limits(limits=2, user_api="blas"):
        georeference_sequence(few, progress=look)
    assert threads == {1}


def test_every_frame_is_known_far_better_than_a_pixel_from_its_neighbours(flight, solved):
    assert set(solved.source) == {"solved", "estimated"}
    assert [solved.source[k] for k in solved.subset.frames] == ["solved"] * len(solved.subset)
    error = ground_error_px(flight, solved.poses.position, solved.poses.world_from_body)
    # some 50 windows a frame that err by 0.1 px with their drift: 0.1 sqrt(6 / 50) px, thrice that at most
    assert between(error, 10) < 0.1


def test_slerp_and_displacement_between_true_anchors_are_worse_in_that_order(flight, solved):
    t, position, attitude = flight.poses
    anchors = np.arange(0, 60, 10)
    slerp = between_anchors(t, anchors, position[anchors], attitude[anchors])
    carried = by_displacement(
        t, anchors, position[anchors], attitude[anchors], solved.followed, flight.detector, NADIR_MOUNT,
        flight.options.altitude,
    )  # fmt: skip
    by_slerp, by_motion = (between(ground_error_px(flight, *way), 10) for way in (slerp, carried))
    ours = between(ground_error_px(flight, solved.poses.position, solved.poses.world_from_body), 10)
    # 4.7 px of jitter over 20 frames of 99 % overlap, here over 10 frames: a fourth of it
    assert by_slerp > 0.5
    assert by_motion < 0.3 * by_slerp
    assert ours < by_motion


def test_covariances_hold_over_flights():
    nees = []
    for seed in range(40, 44):
        scenario = sequence_case("small", seed, frames=20)
        found = georeference_sequence(problem_of(scenario))
        error = errors_of(scenario, found)[10]
        nees.append(error @ np.linalg.solve(found.poses.covariance[10], error))
    # four flights reject no factor of sigma: validation/sequence_covariance.py pools 500
    assert_possible(np.sum(nees), 4 * 6, chance=1e-3)


def test_subset_follows_the_wanted_overlap_and_says_why(solved):
    inner = solved.subset.overlap[1:-1]
    assert np.abs(inner - 0.8).max() < 0.05
    assert all("overlap" in reason for reason in solved.subset.reason[1:])


def test_frames_without_evidence_are_interpolated_and_the_rest_is_delivered():
    scenario = sequence_case("small", 5, blurred=(20,), missing=(33, 34))
    problem = problem_of(scenario)
    excluded = list(problem.excluded)
    excluded[40] = "unreadable"
    found = georeference_sequence(replace(problem, excluded=tuple(excluded)))
    assert found.source[20] == found.source[40] == "interpolated"
    assert found.reason[40] == "unreadable" and "looks like none" in found.reason[20]
    assert found.source.count("interpolated") == 2
    error = ground_error_px(scenario, found.poses.position, found.poses.world_from_body)
    bridged = error[20] - 0.5 * (error[19] + error[21])
    # the path's bend at one step: jitter of 3 Hz at 25 Hz, 0.1 deg of 250 px focal length, bends by 0.25 px
    assert np.sqrt((bridged**2).sum(axis=-1).mean()) < 1.0
    sigma = np.diagonal(found.poses.covariance, axis1=1, axis2=2)[:, 3:]
    assert (sigma[20] > 0.5 * (sigma[19] + sigma[21])).all()


def test_rolling_shutter_is_seen_through():
    scenario = sequence_case("small", 6, frames=40, readout_time=0.02)
    problem = problem_of(scenario)
    # a frame moves by 3.2 px in 40 ms: lines of one frame are up to 1.6 px off
    wrong = georeference_sequence(replace(problem, readout_time=0.0))
    right = georeference_sequence(problem)
    assert between(ground_error_px(scenario, right.poses.position, right.poses.world_from_body), 10) < 0.1
    assert right.poses.scale * np.median(right.tracks.sigma_px) < wrong.poses.scale * np.median(
        wrong.tracks.sigma_px
    )


def test_a_rolling_shutter_tells_nothing_of_where_a_flight_lies():
    # a camera that shakes, its points seen in many frames: what lines of a frame show of its motion is what
    # the frames after it show. Attitudes given to 1 degree stay as uncertain as without a shutter; 3 % is
    # what other windows change
    sigma = []
    for readout_time in (0.0, 0.03):
        scenario = sequence_case("small", 1, filter="pan", frames=40, readout_time=readout_time)
        found = georeference_sequence(problem_of(scenario))
        assert_covered(scenario, found)
        sigma.append(np.sqrt(np.einsum("kii->ki", found.poses.covariance)).mean(axis=0))
    np.testing.assert_allclose(sigma[1], sigma[0], rtol=0.03)


def test_a_model_whose_poses_do_not_come_together_is_solved_as_of_cameras_that_look_down(monkeypatch):
    pytest.importorskip("pycolmap", reason="models of frames are made by pycolmap, extra sfm")
    problem = problem_of(sequence_case("small", 3, filter="pan", frames=10, overlap=0.85))
    nothing = replace(problem.known, attitude=np.full((10, 3), np.inf), attitude_bias=0.0)
    problem = replace(problem, known=nothing, height_sigma=5.0)
    solve, tried = sequence_poses._all_poses, []

    def once_diverging(*given):
        tried.append(given[0].known.attitude.max())
        if len(tried) == 1:
            raise DivergedError("diverged")
        return solve(*given)

    monkeypatch.setattr(sequence_poses, "_all_poses", once_diverging)
    found = georeference_sequence(problem)
    assert np.isinf(tried[0]) and 0.0 < tried[1] < 1.0
    assert found.problem.known.attitude.max() == tried[1]


def test_curves_through_the_subset_start_from_attitudes_as_they_were_mended():
    # attitudes written in axes turned by a quarter: found while frames are followed, for every way
    flight = sequence_case("small", 3, frames=30)
    problem = problem_of(flight)
    quarter = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi])
    images = replace(problem.images, world_from_body=problem.images.world_from_body * quarter)
    solved = georeference_sequence(replace(problem, images=images))
    for way in ("displacement", "slerp"):
        found = interpolate_between(solved, way)
        assert any("turned by" in words for words in found.warnings)
        error = errors_of(flight, found)[list(found.subset.frames)]
        # the given bias is 0.5 deg
        assert np.degrees(np.abs(error[:, 3:])).max() < 4.0 * 0.5


@pytest.fixture(scope="module")
def two_lines() -> tuple[SequenceScenario, SequenceProblem]:
    """Two lines side by side, and what would be known of them."""
    scenario = sequence_case("two-lines", 1, frames=30, overlap=0.95, filter="pan", readout_time=0.0)
    return scenario, problem_of(scenario)


def test_two_lines_are_tied_where_they_overlap(two_lines):
    scenario, problem = two_lines
    found = georeference_sequence(problem)
    assert set(found.stretch) == {0, 1}
    # the datum is the tables': ground that is found too low is seen further out from both sides
    points = found.poses.points[np.isfinite(found.poses.points[:, 0])]
    sunk = float((points[:, 2] - height_of(scenario, points)).mean())
    error = ground_error_px(scenario, found.poses.position - [0.0, 0.0, sunk], found.poses.world_from_body)
    # both lines see the ground between them on their right, in low columns
    shared = error.reshape(len(error), 4, 4, 2)[:, :, :2]
    apart = shared[:30].mean(axis=(0, 1, 2)) - shared[30:].mean(axis=(0, 1, 2))
    # tables alone leave the lines apart by noise of 1 m and 0.5 deg over sqrt(30) frames: 1 px and more
    assert np.abs(apart).max() < 0.5


def test_lines_that_are_too_much_for_the_memory_are_solved_one_by_one(two_lines, monkeypatch):
    monkeypatch.setattr(sequence_poses, "machine_memory", lambda: 1e6)
    found = georeference_sequence(two_lines[1])
    assert any("not solved together" in words for words in found.warnings)
    assert found.tracks.point.max() + 1 == len(found.poses.points)
    assert np.isfinite(found.poses.covariance).all()


def test_a_mosaic_filter_is_averaged_over_its_pattern():
    scenario = sequence_case("mosaic", 2, shape=(320, 400), focal_length_px=500.0, frames=12, pattern=2)
    found = georeference_sequence(problem_of(scenario))
    error = ground_error_px(scenario, found.poses.position, found.poses.world_from_body)
    assert between(error, 5) < 0.2


def test_frames_that_are_nothing_alike_are_refused(flight):
    problem = problem_of(sequence_case("small", 7, frames=4))
    rng = np.random.default_rng(0)
    noise = tuple(ArrayImage(rng.normal(100.0, 10.0, (160, 200))) for _ in range(4))
    with pytest.raises(EstimationError, match="no two frames in a row look alike"):
        georeference_sequence(replace(problem, sources=noise))
    with pytest.raises(InputError, match="no frame of the sequence can be used"):
        georeference_sequence(replace(problem, excluded=("too dark",) * 4))
