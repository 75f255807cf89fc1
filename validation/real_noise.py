"""Noise of a detector from one strip: simulated strips whose law is known, then a real HiRISE channel.

    python validation/real_noise.py                      # seeds 0 to 4
    python validation/real_noise.py --seeds 100 101 102 103 104

Scenes differ in how their power falls with frequency, in how rough places are among themselves, and in
direction; laws in gain noise. Printed per scene: mean error, sigma claimed, and rms of error over sigma of
each estimate, and how often a bound of 2 sigma held.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import gates
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from imaging.raw_strip import RawStripOptions, simulate_raw_strip
from sightline.errors import EstimationError
from sightline.imaging.noise_estimation import Estimate, column_pattern
from sightline.imaging.strip_noise import (
    EDGES,
    StripPixels,
    conversion_bound,
    estimate_strip_noise,
    gain_bound,
    noise_figures,
)
from sightline.io.formats.hirise_edr import read_hirise_edr

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
IMAGE = DATA / "hirise_edr_bg12/PSP_001446_1790_BG12_0.IMG"
SCENES = {
    "middling": {"fall": 2.7, "patchy": 0.3},
    "evenly rough": {"fall": 2.7, "patchy": 0.15},
    "drawn out diagonally": {"fall": 2.7, "patchy": 0.3, "shear": 0.8},
    "rougher": {"fall": 2.2, "patchy": 0.3},
    "smoother": {"fall": 3.2, "patchy": 0.3},
    "with gain noise 4e-6": {"fall": 2.7, "patchy": 0.3, "gain": 4e-6},
}


def estimates(
    seed: int, options: RawStripOptions
) -> tuple[dict[str, tuple[Estimate, float]], dict[str, bool]]:
    """Estimates with the truth of each, and whether the bounds held."""
    strip = simulate_raw_strip(seed, options)
    beside = (strip.reverse, strip.reverse_buffer, strip.reverse_dark, strip.ramp)
    noise = estimate_strip_noise(StripPixels(strip.table, strip.image, strip.buffer, strip.dark, *beside))
    s, o = noise.white.signal, options
    variance = o.gain * s * s + o.shot * s + o.read**2
    pattern = column_pattern(np.tile(strip.response, (100, 1)), edges=EDGES).variance.value
    return {
        "C": (noise.buffer.pooled, o.read),
        "image noise": (noise.white.variance, variance),
        "slope": (noise.white.slope, o.shot + 2.0 * o.gain * s),
        "B ramp": (noise.ramp.shot, o.shot),
        "B masked": (noise.dark_shot, o.shot),
        "B": (noise.law.estimate(1), o.shot),
        "A": (noise.law.estimate(0), o.gain),
        "A_col": (noise.columns.variance, pattern),
    }, {
        "image noise <=": noise.white.bound.upper() >= variance,
        "A <=": gain_bound(noise, 1.0 / o.shot) >= o.gain,
        "gain >=": conversion_bound(noise) <= 1.0 / o.shot,
    }


def simulated(seeds: list[int]) -> None:
    """The table of all scenes."""
    squares: dict[str, list[float]] = {}
    kept: list[bool] = []
    for place, (label, change) in enumerate(SCENES.items()):
        found, held = [], []
        for seed in seeds:
            try:
                one, bounds = estimates(1000 * place + seed, RawStripOptions(lines=5000, **change))
            except EstimationError as error:
                print(f"  seed {seed}: refused: {error}")
                continue
            found.append(one)
            held.append(bounds)
        print(f"{label}, {len(found)} strips")
        for name in found[0]:
            error = np.array([one[name][0].value - one[name][1] for one in found])
            sigma = np.array([one[name][0].sigma for one in found])
            squares.setdefault(name, []).extend((error / sigma) ** 2)
            print(
                f"  {name:14} true {found[0][name][1]:10.4g}  mean error {error.mean():10.3g}"
                f"  sigma {sigma.mean():9.3g}  rms error/sigma {np.sqrt((error**2 / sigma**2).mean()):5.2f}"
            )
        kept += [held_ for bounds in held for held_ in bounds.values()]
        print("  bounds held:", ", ".join(f"{k} {sum(b[k] for b in held)}/{len(held)}" for k in held[0]))
    gate(squares, kept)


def gate(squares: dict[str, list[float]], kept: list[bool]) -> None:
    """No sigma is too small by more than the chance of so many strips, none is twice too large."""
    for name, values in squares.items():
        gates.check(f"{name}: NEES", float(np.mean(values)), 0.25, gates.nees_bounds(len(values))[1])
    gates.check("all: NEES", float(np.mean(np.concatenate(list(squares.values())))), 0.4, 1.2)
    gates.check("bounds of 2 sigma that held, %", 100.0 * float(np.mean(kept)), 95.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    simulated(parser.parse_args().seeds)
    if not IMAGE.is_file():
        gates.note(
            f"{IMAGE.name} (set SIGHTLINE_DATA to the folder of real data)", "not found", "found", False
        )
        return
    edr = read_hirise_edr(IMAGE)
    print(f"{edr.product}, {edr.stages} stages, binning {edr.binning}")
    # 19.30 e-/DN: see examples/tdi_noise.py
    for figure in noise_figures(estimate_strip_noise(edr.pixels()), edr.stages, 19.30):
        print(f"  {figure}")


if __name__ == "__main__":
    gates.run(main, __file__)
