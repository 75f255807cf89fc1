"""A flight solved in overlapping blocks beside the same solved at once: poses in sigma, ratio of sigmas.

``python validation/sequence_blocks.py [frames] [block] [seed]``; 400 frames in blocks of 130: half a minute.
The ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.
"""

from __future__ import annotations

import sys
import time

import gates
import numpy as np
from sequence_poses import problem_of

from sightline.applications import sequence_poses
from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.simulate.sequence import sequence_case

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")


def solved(problem: SequenceProblem, block: int) -> tuple[SequencePoses, float]:
    """Poses from blocks of so many frames, and CPU s of their solution."""
    sequence_poses.BLOCK_FRAMES = block
    began = time.process_time()
    found = georeference_sequence(problem)
    return found, time.process_time() - began


def main(frames: int, block: int, seed: int) -> None:
    """Print the table."""
    problem = problem_of(sequence_case("long", seed, spectra="rededge", frames=frames))
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
        # the rest of a solution is some tenths of a sigma in the weakest direction
        gates.check(f"{name}: apart, sigma rms", float(np.sqrt((apart[:, k] ** 2).mean())), 0.0, 0.3)
        gates.check(f"{name}: ratio of sigmas, mean", float(ratio[:, k].mean()), 0.98, 1.02)
        print(
            f"{name:>6s} {np.sqrt((apart[:, k] ** 2).mean()):16.3f} {np.abs(apart[:, k]).max():9.3f} "
            f"{ratio[:, k].mean():18.4f} {ratio[:, k].min():13.4f} {ratio[:, k].max():9.4f}"
        )


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    gates.run(lambda: main(*(numbers + [400, 130, 0][len(numbers) :])), __file__)
