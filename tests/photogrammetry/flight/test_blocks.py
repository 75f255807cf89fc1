"""Long flights in blocks are the whole; runs that were stopped go on to the same result, bit for bit."""

from __future__ import annotations

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.sequence_flights import problem_of

from sightline.applications import sequence_poses
from sightline.applications.sequence_poses import FOLLOWED, SOLVED_ALL, SequencePoses, georeference_sequence
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.imaging.source import ArrayImage
from sightline.matching import follow
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.flight import blocks as sequence_blocks
from sightline.photogrammetry.flight import solver as sequence_solver
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Tracks
from sightline.simulate.sequence import sequence_case
from sightline.stages import Stages

FRAMES, BLOCK, KEPT = 80, 27, 30


@pytest.fixture(scope="module")
def problem() -> SequenceProblem:
    # 4 % a frame: windows are followed for 10 frames
    scenario = sequence_case("small", 4, frames=FRAMES, overlap=0.96, jitter=0.002)
    given = problem_of(scenario)
    _, position, attitude = scenario.poses
    # a point on the ground under frame 50, seen in ten frames of two blocks
    place = np.array([position[50, 0], position[50, 1], 0.0])
    seen = np.arange(48, 58)
    true = replace(given.images, position=position, world_from_body=attitude)
    cameras = frame_cameras(true, [scenario.detector], [NADIR_MOUNT])
    pixels = np.concatenate([cameras[k].project(place[None]) for k in seen])
    return replace(
        given,
        control=ControlPoints(np.array([0]), place[None], np.array([1.0])),
        control_tracks=Tracks(seen, np.zeros(10, dtype=int), pixels, np.full(10, 0.5)),
    )


@pytest.fixture(scope="module")
def short_blocks() -> pytest.MonkeyPatch:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence_poses, "BLOCK_FRAMES", BLOCK)
        # blocks of 27 frames are too short to measure the drift of windows, which those of 500 can
        patch.setattr(sequence_solver, "_NOISE_ROUNDS", 0)
        patch.setattr(sequence_blocks, "_LEAST_SIGHTINGS", 100)
        patch.setattr(follow, "_KEPT", KEPT)
        yield patch


@pytest.fixture(scope="module")
def uninterrupted(problem, short_blocks) -> SequencePoses:
    return georeference_sequence(problem)


def identical(a: SequencePoses, b: SequencePoses) -> bool:
    pairs = [
        (a.poses.position, b.poses.position),
        (a.poses.world_from_body.as_quat(), b.poses.world_from_body.as_quat()),
        (a.poses.covariance, b.poses.covariance),
        (a.poses.points, b.poses.points),
        (a.poses.residual_px, b.poses.residual_px),
        (a.tracks.pixels, b.tracks.pixels),
        (a.tracks.sigma_px, b.tracks.sigma_px),
        (a.followed.motion, b.followed.motion),
    ]
    same = all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)
    return same and (a.source, a.reason, a.subset.reason) == (b.source, b.reason, b.subset.reason)


def test_blocks_joined_are_the_flight_solved_at_once(problem, uninterrupted):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence_poses, "BLOCK_FRAMES", FRAMES)
        whole = georeference_sequence(problem)
    blocks = uninterrupted
    assert len(blocks.tracks) == len(whole.tracks) and len(blocks.poses.points) == len(whole.poses.points)
    sigma = np.sqrt(np.einsum("kii->ki", whole.poses.covariance))
    turn = (whole.poses.world_from_body.inv() * blocks.poses.world_from_body).as_rotvec()
    apart = np.concatenate([blocks.poses.position - whole.poses.position, turn], axis=1) / sigma
    # roughness is measured in each block: of a third of the frames, so to some 10 %
    assert np.sqrt((apart**2).mean()) < 0.1
    ratio = np.sqrt(np.einsum("kii->ki", blocks.poses.covariance)) / sigma
    assert np.abs(np.median(ratio, axis=0) - 1.0).max() < 0.1
    np.testing.assert_allclose(blocks.poses.bow, whole.poses.bow, rtol=0.1)
    np.testing.assert_allclose(blocks.poses.scale_sigma, whole.poses.scale_sigma, rtol=0.1)
    unit = sigma[1:, :, None] * sigma[:-1, None, :]
    apart = (blocks.poses.next_covariance - whole.poses.next_covariance) / unit
    # as of the sigmas: some 10 % of each, 20 % of its square
    assert np.sqrt((apart**2).mean()) < 0.2


class Stopped(Exception):
    pass


def stop_at(stage: str, least: int):
    def progress(name: str, done: int, total: int) -> None:
        assert 0 <= done <= total
        if name == stage and done >= least:
            raise Stopped

    return progress


def test_a_run_goes_on_from_where_it_was_stopped(problem, uninterrupted, tmp_path):
    folder = tmp_path / "kept"
    expected = [
        (stop_at(FOLLOWED, 65), ["follow-0", "follow-1"], []),
        (stop_at(SOLVED_ALL, 2), ["follow", "subset", "block-0", "block-1"], ["follow-0", "follow-1"]),
    ]
    for progress, computed, found in expected:
        stages = Stages(folder)
        with pytest.raises(Stopped):
            georeference_sequence(problem, progress=progress, stages=stages)
        assert (stages.computed, stages.found) == (computed, found)
    said: list[str] = []
    stages = Stages(folder, said.append)
    resumed = georeference_sequence(problem, stages=stages)
    assert stages.found == ["follow", "subset", "block-0", "block-1"] and not said
    assert stages.computed == ["block-2", "poses"]
    assert identical(resumed, uninterrupted)
    # what finished stages hold is not kept twice
    assert sorted(path.name for path in folder.iterdir()) == [
        f"{name}.stage.npz" for name in ("follow", "poses", "subset")
    ]


def test_a_killed_process_leaves_what_another_goes_on_from(problem, uninterrupted, tmp_path):
    def killed(folder: Path) -> None:
        def progress(name: str, done: int, total: int) -> None:
            if name == FOLLOWED and done == 50:
                os.kill(os.getpid(), signal.SIGKILL)

        georeference_sequence(problem, progress=progress, stages=Stages(folder))

    child = multiprocessing.get_context("fork").Process(target=killed, args=(tmp_path,))
    child.start()
    child.join(120)
    assert child.exitcode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == ["follow-0.stage.npz"]
    stages = Stages(tmp_path)
    with pytest.raises(Stopped):
        georeference_sequence(problem, progress=stop_at(SOLVED_ALL, 0), stages=stages)
    assert "follow-0" in stages.found and "follow-1" in stages.computed


def test_frames_written_anew_are_followed_anew(problem, uninterrupted, tmp_path):
    with pytest.raises(Stopped):
        georeference_sequence(problem, progress=stop_at(SOLVED_ALL, 1), stages=Stages(tmp_path))
    said: list[str] = []
    stages = Stages(tmp_path, said.append)
    noisy = ArrayImage(np.roll(problem.sources[7].array, 1, axis=0))
    with pytest.raises(Stopped):
        georeference_sequence(
            replace(problem, sources=(*problem.sources[:7], noisy, *problem.sources[8:])),
            stages=stages, progress=stop_at(FOLLOWED, 1),
        )  # fmt: skip
    assert not stages.found and said and "other images" in said[0]
