"""How poor blind interpolation is on a simulated flight: slerp and lines between true anchors.

    python validation/sequence_jitter.py
    python validation/sequence_jitter.py --seeds 20 21 22

The flights of `sightline simulate frames` (640 frames at a 1 % step, no images are needed) are interpolated
between true poses one in 20, 10 and 5: attitudes by slerp, positions linearly. Printed per stride: rms error
of the attitude about each axis, rms over axes, and rms on the ground, in pixels, of a grid of 9 x 9 pixels
cut with the mean ground. The jitter is made so that one in 20 leaves .34 degrees and 7.1 px, as was measured
on the simulation that the method is compared on; there one in 10 left .15 degrees and 3.2 px, one in 5 .10
and 1.8. A miss of those of one in 20 by more than a tenth ends with exit status 1.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.geometry.rotations import NADIR_MOUNT
from sightline.simulate.sequence_motion import draw_flight
from sightline.simulate.sequence_options import SequenceOptions

STRIDES = (20, 10, 5)
WANTED_DEG, WANTED_PX = 0.34, 7.1
GRID = 9

Array = NDArray[np.float64]


def ground(position: Array, attitude: Rotation, options: SequenceOptions) -> Array:
    """Places (N, GRID**2, 2) m that a grid of pixels of each frame sees on the mean ground."""
    line, column = (np.linspace(0.0, n - 1.0, GRID) - 0.5 * (n - 1) for n in options.shape)
    a, b = np.meshgrid(column / options.focal_length_px, line / options.focal_length_px)
    rays = np.column_stack([a.ravel(), b.ravel(), np.ones(a.size)])
    seen = np.einsum("nij,kj->nki", (attitude * NADIR_MOUNT).as_matrix(), rays)
    run = position[:, None, 2:] / -seen[..., 2:]
    return position[:, None, :2] + run * seen[..., :2]


def errors(options: SequenceOptions, seed: int, stride: int) -> tuple[Array, float]:
    """Rms (3,) degrees about body axes and rms px on the ground of the frames between the anchors."""
    t, position, attitude = draw_flight(options, np.random.SeedSequence(seed, spawn_key=(0,))).poses()
    anchors = np.arange(0, len(t), stride)
    between = np.array([k for k in range(anchors[-1]) if k % stride])
    guess = Slerp(t[anchors], attitude[anchors])(t[between])
    place = np.column_stack([np.interp(t[between], t[anchors], position[anchors, k]) for k in range(3)])
    turn = np.degrees((attitude[between].inv() * guess).as_rotvec())
    miss = ground(place, guess, options) - ground(position[between], attitude[between], options)
    return np.sqrt((turn**2).mean(axis=0)), float(np.sqrt((miss**2).sum(axis=2).mean()) / options.gsd)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101, 102, 103, 104, 105, 106, 107])
    seeds = parser.parse_args().seeds
    options = SequenceOptions()
    print("| anchors | roll deg | pitch deg | yaw deg | rms deg | ground px | from to px |")
    print("|---|---|---|---|---|---|---|")
    for stride in STRIDES:
        every = [errors(options, seed, stride) for seed in seeds]
        turn = np.sqrt(np.mean([angle**2 for angle, _ in every], axis=0))
        px = np.array([value for _, value in every])
        rms_deg, rms_px = float(np.sqrt((turn**2).mean())), float(np.sqrt((px**2).mean()))
        axes = " | ".join(f"{value:.3f}" for value in turn)
        print(
            f"| one in {stride} | {axes} | {rms_deg:.3f} | {rms_px:.2f} | {px.min():.1f} to {px.max():.1f} |"
        )
        if stride == STRIDES[0]:
            gates.check("one in 20: rms over that wanted, attitude", rms_deg / WANTED_DEG, 0.9, 1.1)
            gates.check("one in 20: rms over that wanted, ground", rms_px / WANTED_PX, 0.9, 1.1)


if __name__ == "__main__":
    gates.run(main, __file__)
