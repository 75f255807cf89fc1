"""TDI: MTF and SNR measured on a strip imaged by brute force, beside those that the choice predicts.

    python validation/tdi_strip.py
    python validation/tdi_strip.py --draws 40

240 columns (velocity 0.999 to 1.003, slip -1.1 to 1.3 degrees), each by its own setting and by that of the
centre column. A target is imaged as five of the columns do, with noise drawn `--draws` times; MTF at half a
cycle per pixel by slanted edges, SNR by a flat patch. Printed: predicted, measured without noise (MTF) and in
the mean of the draws, (mean - predicted) over the standard error of the mean, and the rms of (measured -
predicted) over the 1-sigma that each measurement claims for itself.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np

from sightline.evaluation.tdi_pictures import (
    column_group,
    exposed_target,
    measured_quality,
    predicted_quality,
)
from sightline.imaging.mtf import aperture_mtf, diffusion_mtf
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.simulate.tdi_strip import read_strip
from sightline.simulate.tdi_target import tdi_target
from sightline.tdi.choose import TdiChoice, choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid

APERTURE = (0.9, 0.9)
PLACES = (0, 60, 120, 180, 239)


def example(signal: float) -> TdiChoice:
    """Choice over the example's columns at one signal."""
    x = np.linspace(-1.0, 1.0, 240)
    static = 0.35 * float(aperture_mtf(0.5, 0.9) * diffusion_mtf(0.5, 0.2))
    columns = ScanColumns(
        np.arange(240.0), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((240, 2), static)
    )
    grid, rules = TdiGrid(np.arange(3, 129), np.arange(1, 21) * 0.05), ChoiceRules()
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(gain=9e-6, read=12.0, column_fixed=1e-6))
    drift = DriftMtf(columns, grid, detector.exposure, rules)
    return choose_settings(drift, np.array([signal]), grid, detector, rules)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--signal", type=float, default=100.0)
    given = parser.parse_args()
    choice = example(given.signal)
    target = tdi_target(given.seed)
    heads = (
        ("MTF across", "MTF along", "SNR"),
        ("predicted noiseless mean err/se",) * 2 + ("predicted mean err/se",),
    )
    for head in heads:
        print(f"{'':32}" + "".join(f"{name:>34}" for name in head))
    claimed: list[np.ndarray] = []
    for own in (True, False):
        print("each column by its own setting" if own else "all columns by the setting of the centre column")
        for place in PLACES:
            group = column_group(choice, place, place if own else PLACES[2], 0, APERTURE)
            exposed, settings = exposed_target(target, group, choice.detector)
            predicted = predicted_quality(group, choice.detector, given.signal, choice.rules.frequencies)
            expected = np.array([*predicted.mtf, predicted.snr])
            found, sigma = [], []
            for draw in range(given.draws):
                rng = np.random.default_rng([given.seed, place, own, draw])
                strip = read_strip(exposed, settings, choice.detector, given.signal, rng)
                quality = measured_quality(strip.radiance, choice.rules.frequencies)
                found.append([*quality.mtf, quality.snr])
                sigma.append([*quality.mtf_sigma, quality.snr_sigma])
            error = np.array(found) - expected
            claimed.append(error / np.array(sigma))
            mean = np.mean(found, axis=0)
            off = error.mean(axis=0) / (error.std(axis=0, ddof=1) / np.sqrt(given.draws))
            noiseless = read_strip(exposed, settings, choice.detector, given.signal).radiance
            still = measured_quality(noiseless, choice.rules.frequencies).mtf
            off_still = float(np.abs(np.array(still) - expected[:2]).max())
            gates.check(
                f"column {place}, {'own' if own else 'of the centre'}: MTF without noise, off",
                off_still,
                0.0,
                1e-3,
            )
            label = f"  column {place:3d}: N {group.stages:3d}, Kt {group.ratio:.2f}"
            cells = (
                f"{expected[k]:.4f}  {still[k]:.4f}  {mean[k]:.4f}  {off[k]:+4.1f}" if k < 2
                else f"{expected[k]:.1f}  {mean[k]:.1f}  {off[k]:+4.1f}" for k in range(3)
            )  # fmt: skip
            print(f"{label:32}" + "".join(f"{cell:>34}" for cell in cells), flush=True)
    rms = np.sqrt((np.concatenate(claimed) ** 2).mean(axis=0))
    bounds = gates.nees_bounds(2 * len(PLACES) * given.draws)
    for name, value in zip(("MTF across", "MTF along", "SNR"), rms, strict=True):
        gates.check(f"{name}: NEES of what is measured", float(value) ** 2, *bounds)
    print(f"{'rms of error / claimed 1-sigma':32}" + "".join(f"{value:34.2f}" for value in rms))


if __name__ == "__main__":
    gates.run(main, __file__)
