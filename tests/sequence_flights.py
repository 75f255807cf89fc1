"""What a user would know of a simulated flight, for tests: frames, rough tables, level ground."""

from __future__ import annotations

import numpy as np

from sightline.applications.frame_sequence import SequenceProblem
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.frame_poses import RoughPoses
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
        np.zeros(count), np.arange(count), t[frames], scenario.told_positions[frames],
        scenario.told_attitudes[frames],
    )  # fmt: skip
    return SequenceProblem(
        tuple(f"{k:05d}" for k in frames), t[frames], sources, scenario.detector, NADIR_MOUNT, images, known,
        Plane(0.0), float(scenario.ground.relief.heights.std()), options.readout_time, 0.8, ("",) * count,
        mosaic_nm=scenario.filter.told_nm[0] if options.filter == "mosaic" else None,
    )  # fmt: skip
