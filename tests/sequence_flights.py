"""What a user would know of a simulated flight, for tests: frames, rough tables, level ground; and errors."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from sightline.applications.sequence_poses import SequencePoses
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import SequenceScenario


def problem_of(scenario: SequenceScenario) -> SequenceProblem:
    """The frames that were delivered, with the tables they came with."""
    options, (t, _, _) = scenario.options, scenario.poses
    frames = np.array(scenario.frames)
    count = len(frames)
    sources = tuple(ArrayImage(scenario.image(k).mean(axis=0)) for k in scenario.frames)
    known = RoughPoses(
        np.full((count, 3), options.position_sigma), np.full((count, 3), options.attitude_sigma),
        options.position_bias_sigma, options.attitude_bias_sigma,
    )  # fmt: skip
    images = Images(
        np.zeros(count), np.arange(count), t[frames], scenario.given_positions[frames],
        scenario.given_attitudes[frames],
    )  # fmt: skip
    return SequenceProblem(
        tuple(f"{k:05d}" for k in frames), t[frames], sources, scenario.detector, NADIR_MOUNT, images, known,
        Plane(0.0), float(scenario.ground.relief.heights.std()), options.readout_time, 0.8, ("",) * count,
        mosaic_nm=scenario.filter.given_nm[0] if options.filter == "mosaic" else None,
    )  # fmt: skip


def errors_of(scenario: SequenceScenario, found: SequencePoses, rows: slice = slice(None)) -> np.ndarray:
    """(M, 6): position (m), angles (rad)."""
    frames = list(scenario.frames)
    _, position, attitude = scenario.poses
    turn = (attitude[frames].inv() * found.poses.world_from_body[rows]).as_rotvec()
    return np.concatenate([found.poses.position[rows] - position[frames], turn], axis=1)


def assert_covered(scenario: SequenceScenario, found: SequencePoses, rows: slice = slice(None)) -> None:
    """Every frame's error is within its covariance at one in a thousand; a flight's err alike: one draw."""
    error, covariance = errors_of(scenario, found, rows), found.poses.covariance[rows]
    squares = np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    assert squares.max() < chi2.ppf(0.999, 6)
    assert squares.mean() > chi2.ppf(1e-3, 6)
