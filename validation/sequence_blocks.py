"""A flight solved in overlapping blocks beside the same solved at once: poses in sigma, ratio of sigmas.

``python validation/sequence_blocks.py [frames] [block] [seed]``; 400 frames in blocks of 130: half a minute.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from sightline.applications import sequence_poses
from sightline.applications.frame_sequence import SequenceProblem
from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.frame_poses import RoughPoses
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import SequenceScenario, sequence_case

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")


def problem_of(scenario: SequenceScenario) -> SequenceProblem:
    """What a user would know of a flight."""
    options, (t, _, _) = scenario.options, scenario.poses
    count = len(t)
    known = RoughPoses(
        np.full((count, 3), options.position_sigma), np.full((count, 3), options.attitude_sigma),
        options.position_bias_sigma, options.attitude_bias_sigma,
    )  # fmt: skip
    images = Images(np.zeros(count), np.arange(count), t, scenario.told_positions, scenario.told_attitudes)
    sources = tuple(ArrayImage(scenario.image(k)[0]) for k in range(count))
    return SequenceProblem(
        tuple(map(str, range(count))), t, sources, scenario.detector, NADIR_MOUNT, images, known, Plane(0.0),
        float(scenario.ground.relief.heights.std()), options.readout_time, 0.8, ("",) * count,
    )  # fmt: skip


def solved(problem: SequenceProblem, block: int) -> tuple[SequencePoses, float]:
    """Poses from blocks of so many frames, and CPU s of their solution."""
    sequence_poses.BLOCK_FRAMES = block
    began = time.process_time()
    found = georeference_sequence(problem)
    return found, time.process_time() - began


def main(frames: int, block: int, seed: int) -> None:
    """Print the table."""
    problem = problem_of(sequence_case("long", seed, frames=frames))
    whole, at_once = solved(problem, frames)
    parts, in_blocks = solved(problem, block)
    sigma = np.sqrt(np.einsum("kii->ki", whole.poses.covariance))
    turn = (whole.poses.world_from_body.inv() * parts.poses.world_from_body).as_rotvec()
    apart = np.concatenate([parts.poses.position - whole.poses.position, turn], axis=1) / sigma
    ratio = np.sqrt(np.einsum("kii->ki", parts.poses.covariance)) / sigma
    print(
        f"{frames} frames, seed {seed}: at once {at_once:.1f} CPU s, blocks of {block} {in_blocks:.1f} CPU s"
    )
    print("        apart, sigma rms   largest   ratio of sigmas, mean   least   largest")
    for k, name in enumerate(NAMES):
        print(
            f"{name:>6s} {np.sqrt((apart[:, k] ** 2).mean()):16.3f} {np.abs(apart[:, k]).max():9.3f} "
            f"{ratio[:, k].mean():18.4f} {ratio[:, k].min():13.4f} {ratio[:, k].max():9.4f}"
        )


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    main(*(numbers + [400, 130, 0][len(numbers) :]))
