"""Strips of TDI, imaged stage by stage: what comes back is the motion itself, and sigma owns what is hidden.

    python validation/tdi_strips.py                        five settings, ten seeds each
    python validation/tdi_strips.py --stages 16 --seeds 7

The nominal motion (tones of 47, 83 and 121 Hz) at SNR 120, strips of 1200 x 320 pixels; 8, 16 or 32 stages
everywhere, or 16/32/16 across the field, timed by the first stage; 500 lines through 16 stages. Rms error per
axis in px (yaw: at the field's edge) after the hidden directions are fitted away, NEES, windows kept. 16 and
32 stages leave .03 of 121 Hz, of .08 px rms: NEES says whether what is not found of it is owned. That of one
strip of .6 s scatters by .35: over five strips the mean would be told to .16, over ten to .11.

Last, the amplitudes of 47 Hz: cosine and sine of the motion's error under a Hann window, in units of the
covariance of the result, over all axes and seeds.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.motion.results import LineOfSight
from sightline.simulate.scenarios import StripScenario, line_of_sight_case

Array = NDArray[np.float64]
COLUMNS = 320
#: Stages across the field, and lines.
CASES = {
    "8": ((8,), 1200),
    "16": ((16,), 1200),
    "32": ((32,), 1200),
    "16/32/16": ((16, 32, 16), 1200),
    "16-short": ((16,), 500),
}
TONE = 47.0
#: Strips at a time.
AT_ONCE = 2


def strip(stages: tuple[int, ...], lines: int, seed: int) -> StripScenario:
    """The nominal strip through TDI."""
    uneven = {"time_reference": "first-stage"} if len(set(stages)) > 1 else {}
    return line_of_sight_case("nominal", seed, lines=lines, columns=COLUMNS, stages=stages, **uneven)


def tone_square(result: LineOfSight, truth: Array) -> float:
    """Squared error of cosine and sine of a tone, all axes, in units of their covariance: chi-square of 6.

    A constant turn is hidden, and turns what each axis has into the others: it is taken off first.
    """
    t = result.motion.t
    inside = (t >= truth[0, 0]) & (t <= truth[-1, 0])
    window = np.where(inside, np.sin(np.pi * (t - truth[0, 0]) / np.ptp(truth[:, 0])) ** 2, 0.0)
    known = Motion(truth[:, 0], truth[:, 1:]).at(np.clip(t, truth[0, 0], truth[-1, 0]))
    found, known = Rotation.from_rotvec(np.array(result.motion.angles)), Rotation.from_rotvec(np.array(known))
    constant = Rotation.from_rotvec(window @ (found * known.inv()).as_rotvec() / window.sum())
    error = ((constant * known).inv() * found).as_rotvec()
    waves = window[:, None] * np.stack([f(2.0 * np.pi * TONE * t) for f in (np.cos, np.sin)], axis=1)
    weights = np.zeros((len(t), 3, 6))
    for axis in range(3):
        weights[:, axis, 2 * axis : 2 * axis + 2] = waves / window.sum()
    off = np.einsum("nak,na->k", weights, error)
    assert result.functional_covariance is not None
    return float(off @ np.linalg.solve(result.functional_covariance(weights), off))


def recovered(name: str, seed: int) -> tuple[str, list[float], float]:
    """The row of a strip, its NEES per axis, and its `tone_square`."""
    scene = strip(*CASES[name], seed)
    result = recover_line_of_sight(scene.as_given(), Plane(0.0))
    score = score_result(result, scene.truth[:, 0], scene.truth[:, 1:])
    square = tone_square(result, scene.truth)
    axes = " | ".join(f"{axis.rms:.4f} ({axis.nees:.2f})" for axis in score.axes.values())
    kept = sum(p.kept for p in result.pairs)
    row = f"| {name} | {seed} | {axes} | {kept} | {square:.1f} |"
    return row, [axis.nees for axis in score.axes.values()], square


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--stages", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[*range(10)])
    given = parser.parse_args()
    print("| stages | seed | roll rms (NEES) | pitch | yaw | windows | chi-square of 47 Hz (6) |")
    print("|---|---|---|---|---|---|---|")
    squares: list[float] = []
    with ProcessPoolExecutor(AT_ONCE) as workers:
        jobs = [
            (name, workers.submit(recovered, name, seed)) for name in given.stages for seed in given.seeds
        ]
        for name in given.stages:
            found = []
            for _, job in (one for one in jobs if one[0] == name):
                row, nees, square = job.result()
                print(row, flush=True)
                found.append(nees)
                squares.append(square)
            for axis, mean in zip(("roll", "pitch", "yaw"), np.mean(found, axis=0).tolist(), strict=True):
                gates.check(f"{name} stages, {axis}: NEES over the seeds", mean, 0.8, 1.25)
    samples = 6 * len(squares)
    low, high = chi2.ppf([0.025, 0.975], samples)
    gates.check(f"47 Hz: chi-square of {samples}", sum(squares), low, high)


if __name__ == "__main__":
    gates.run(main, __file__)
