"""Relief known, half known, and unknown: what its parallax does to the motion, and what owning it saves.

    python validation/parallax.py --seeds 100 101

Strips over relief (`relief`, rms 300 m; `hard`, noise and clouds besides; `real`, the heights of an SRTM
tile under real bands), each recovered five times:

    DEM               the true surface
    DEM + 20 m        a DEM with errors of 20 m rms over some hundred metres, given as `height_sigma`
    the same, no sigma that DEM taken for exact
    joint             a plane at the mean height, the heights' deviation given: they become unknowns of the
                      estimate beside the motion, and several lags part the two
    off               that plane taken for exact

One line per strip, way and axis: rms error in px (yaw: px at the field's edge) after the hidden directions
are fitted away, stated sigma, NEES. The errors of the DEM are drawn by this script from a filter of its own.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import AxisScore, score_result
from sightline.geometry.surface import Dem, Plane, Surface
from sightline.simulate.scenarios import line_of_sight_case
from sightline.simulate.scene import Relief

Array = NDArray[np.float64]
#: m; of the DEM's errors, and of what they are correlated over (standard deviation of the filter).
DEM_SIGMA, DEM_LENGTH = 20.0, 150.0


def dem_error(relief: Relief, seed: int) -> Array:
    """Errors of a DEM: white noise smoothed over some hundred metres, `DEM_SIGMA` rms."""
    rng = np.random.default_rng([seed, 13])
    reach = [DEM_LENGTH / abs(step) for step in reversed(relief.posting)]
    noise = gaussian_filter(rng.standard_normal(relief.heights.shape), reach, mode="wrap")
    return np.asarray(DEM_SIGMA * noise / noise.std())


def ways(relief: Relief, seed: int) -> dict[str, tuple[Surface, float]]:
    """Surface and what is said not to be known of its height, by name."""
    exact = Dem(relief.heights, relief.transform)
    wrong = Dem(relief.heights + dem_error(relief, seed), relief.transform)
    plane = Plane(float(relief.heights.mean()))
    return {
        "DEM": (exact, 0.0),
        "DEM + 20 m": (wrong, DEM_SIGMA),
        "the same, no sigma": (wrong, 0.0),
        "joint": (plane, float(relief.heights.std())),
        "off": (plane, 0.0),
    }


def gate(strip: str, worth: dict[str, dict[str, AxisScore]]) -> None:
    """Sigma holds where the ground is known; relief owned is better than relief left out.

    Pitch of "joint" rests on a few slow numbers a strip: of it no sigma is asked.
    """
    for name, ways_ in (("DEM", ("roll", "pitch", "yaw")), ("DEM + 20 m", ("roll", "pitch", "yaw")),
                        ("joint", ("roll", "yaw"))):  # fmt: skip
        mean = float(np.mean([worth[name][axis].nees for axis in ways_]))
        gates.check(f"{strip}: NEES with {name}, mean of {', '.join(ways_)}", mean, 0.6, 1.5)
    for axis, joint in worth["joint"].items():
        gates.check(f"{strip}: {axis}, rms joint over off", joint.rms / worth["off"][axis].rms, 0.0, 1.0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", default=["relief", "hard", "real"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    parser.add_argument("--lines", type=int, default=2400)
    parser.add_argument("--columns", type=int, default=640)
    given = parser.parse_args()
    np.seterr(all="ignore")
    print("| strip | seed | surface | rms roll / pitch / yaw | sigma | NEES |")
    print("|---|---|---|---|---|---|")
    for case in given.cases:
        for seed in given.seeds:
            scenario = line_of_sight_case(case, seed, lines=given.lines, columns=given.columns)
            relief = scenario.scene.relief
            assert relief is not None
            bands, truth = scenario.as_given(), scenario.truth
            worth: dict[str, dict[str, AxisScore]] = {}
            for name, (surface, height_sigma) in ways(relief, seed).items():
                result = recover_line_of_sight(bands, surface, height_sigma=height_sigma)
                worth[name] = score_result(result, truth[:, 0], truth[:, 1:]).axes
                axes = worth[name].values()
                rms, sigma = (" / ".join(f"{getattr(a, key):.4f}" for a in axes) for key in ("rms", "sigma"))
                nees = " / ".join(f"{axis.nees:.2f}" for axis in axes)
                print(f"| {case} | {seed} | {name} | {rms} | {sigma} | {nees} |", flush=True)
            gate(f"{case}, {seed}", worth)


if __name__ == "__main__":
    gates.run(main, __file__)
