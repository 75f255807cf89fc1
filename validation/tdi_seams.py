"""Seams between column groups of different TDI settings on a flat field, after recalibration.

A flat field passes the noise law (shot, gain, read, dark and output noise of every stage) with the free
choice of 24 column groups; each sample is divided by its integration time, dark current taken off. Prints,
for each signal, the steps at the 23 borders of groups: mean over the lines of the mean of the columns of the
right group less that of the left one ("raw step": the largest before recalibration, of the mean). They are to
lie within their standard errors, far below the noise of one pixel. Then the same with integration ratios that
are wrong by 0.1 % (each its own way), as they look when nothing is known of it, beside the step that is
stated for it; and the NEES of the relative uncertainty stated.

    python validation/tdi_seams.py [--seeds 0 1 2 3 4] [--lines 4000]
"""

from __future__ import annotations

import argparse

import gates
import numpy as np
from numpy.typing import NDArray

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.hysteresis import nearest_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.tagging import TdiTags, recalibrate, seam_sigma, tag_lines

Array = NDArray[np.float64]
GROUPS, WIDTH = 24, 20
SIGNALS = (10.0, 50.0, 400.0, 2000.0)  # electrons of one head line
DETECTOR = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0, dark=10.0, output=20.0))
GRID = TdiGrid(np.arange(3, 129), np.arange(1, 21) / 20.0)
#: Relative error of the integration ratios and of the columns' gains in the second part.
RATIO_ERROR, GAIN_ERROR = 1e-3, 5e-4


def _tags(signal: float, lines: int) -> TdiTags:
    """Tags of a flat field, set by the free choice."""
    x = np.linspace(-1.0, 1.0, GROUPS)
    columns = ScanColumns(
        np.arange(GROUPS) * WIDTH, 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((GROUPS, 2), 0.3)
    )
    rules = ChoiceRules()
    model = DriftMtf(columns, GRID, DETECTOR.exposure, rules)
    choice = choose_settings(model, np.array([0.5 * signal, signal]), GRID, DETECTOR, rules)
    signals = np.full((lines, GROUPS), signal)
    return tag_lines(
        model, nearest_settings(choice, signals), signals, GRID, DETECTOR,
        first_column=np.arange(GROUPS) * WIDTH, columns=GROUPS * WIDTH,
    )  # fmt: skip


def _true_time(tags: TdiTags, ratio_error: Array, head_error: float) -> tuple[Array, Array, Array]:
    """Head lines, and the true integration ratios of head and body, of every column."""
    group = tags.group_of_columns()
    stages, index = tags.stages[0, group], tags.ratio_index[0, group]
    head = np.full(tags.columns, DETECTOR.exposure.head_ratio * (1.0 + head_error))
    return stages.astype(np.float64), head, (tags.ratios * (1.0 + ratio_error))[index]


def _samples(
    tags: TdiTags, signal: float, rng: np.random.Generator, ratio_error: Array, head_error: float, gain: Array
) -> Array:
    """Electrons (L, C) of the sum of all stages of a flat field."""
    law = DETECTOR.noise
    stages, head, body = _true_time(tags, ratio_error, head_error)
    per_ratio = gain * signal / DETECTOR.signal_ratio
    in_head, in_body = 2.0, stages - 2.0
    time = in_head * head + in_body * body
    shape = (len(tags), tags.columns)
    electrons = rng.poisson((per_ratio + law.dark) * time, shape).astype(np.float64)
    own = in_head * (law.gain * (per_ratio * head) ** 2 + law.read**2)
    own = own + in_body * (law.gain * (per_ratio * body) ** 2 + law.read**2) + law.output**2
    return np.asarray(electrons + np.sqrt(own) * rng.standard_normal(shape))


def _steps(image: Array) -> tuple[Array, Array, float]:
    """Steps at the borders, their standard errors, and the noise of one pixel."""
    groups = image.reshape(len(image), GROUPS, WIDTH).mean(axis=2)
    per_line = np.diff(groups, axis=1)
    pixel = float(image.std(axis=0).mean())
    return per_line.mean(axis=0), per_line.std(axis=0) / np.sqrt(len(image)), pixel


def _flat(seeds: list[int], lines: int, errors: bool) -> None:
    names = ("signal", "settings", "raw step", "rms step", "sigma", "rms z", "worst z", "noise", "step/noise")
    print(" ".join(f"{name:>10}" for name in (*names, "stated")[: 10 if errors else 9]))
    for signal in SIGNALS:
        tags = _tags(signal, lines)
        z, steps, sigmas, pixels, raw = [], [], [], [], 0.0
        for seed in seeds:
            rng = np.random.default_rng(seed)
            ratio_error = RATIO_ERROR * rng.standard_normal(len(tags.ratios)) * errors
            head_error = RATIO_ERROR * float(rng.standard_normal()) * errors
            samples = _samples(tags, signal, rng, ratio_error, head_error, np.ones(tags.columns))
            raw = max(raw, float(np.abs(_steps(samples)[0]).max() / samples.mean()))
            step, sigma, pixel = _steps(recalibrate(samples, tags, dark=DETECTOR.noise.dark).signal)
            z.append(step / sigma)
            steps.append(step)
            sigmas.append(sigma)
            pixels.append(pixel)
        rms = float(np.sqrt(np.mean(np.square(steps))))
        pixel = float(np.mean(pixels))
        number = len(np.unique(tags.stages[0].astype(int) * 100 + tags.ratio_index[0]))
        row = [
            f"{signal:10g}", f"{number:10d}", f"{1e2 * raw:9.1f}%",
            f"{rms:10.4f}", f"{np.mean(sigmas):10.4f}",
            f"{np.sqrt(np.mean(np.square(z))):10.2f}", f"{np.max(np.abs(z)):10.2f}", f"{pixel:10.3f}",
            f"{rms / pixel:10.5f}",
        ]  # fmt: skip
        if not errors:
            # steps at the borders share a group each: about half of them are independent
            bounds = gates.nees_bounds(0.5 * len(seeds) * (GROUPS - 1))
            gates.check(
                f"signal {signal:g}: squared step over its variance", float(np.mean(np.square(z))), *bounds
            )
            gates.check(f"signal {signal:g}: rms step over the noise of a pixel", rms / pixel, 0.0, 0.02)
        if errors:
            sigma_ratio, sigma_head = RATIO_ERROR * tags.ratios, RATIO_ERROR * DETECTOR.exposure.head_ratio
            seam = (
                signal
                * seam_sigma(tags, dark=DETECTOR.noise.dark, ratio_sigma=sigma_ratio, head_sigma=sigma_head)[
                    0
                ]
            )
            row.append(f"{np.sqrt(np.mean(seam**2 + np.mean(np.square(sigmas), axis=0))):10.4f}")
        print(" ".join(row))


def _nees(seeds: list[int], lines: int) -> None:
    """Error of the recalibrated mean of a column over its stated uncertainty; errors drawn anew 40 times."""
    print(f"\nNEES of the stated relative uncertainty: ratios and head {RATIO_ERROR:.1%}, "
          f"column gains {GAIN_ERROR:.2%}, {len(seeds)} seeds x 40 draws")  # fmt: skip
    print(f"{'signal':>7} {'stated %':>9} {'found %':>9} {'NEES':>6} {'+-':>5}")
    for signal in SIGNALS:
        tags = _tags(signal, lines)
        sigma_ratio, sigma_head = RATIO_ERROR * tags.ratios, RATIO_ERROR * DETECTOR.exposure.head_ratio
        squares, found, stated = [], [], 0.0
        for seed in seeds:
            for draw in range(40):
                rng = np.random.default_rng([seed, draw])
                gain = 1.0 + GAIN_ERROR * rng.standard_normal(tags.columns)
                ratio_error = RATIO_ERROR * rng.standard_normal(len(tags.ratios))
                head_error = RATIO_ERROR * float(rng.standard_normal())
                samples = _samples(tags, signal, rng, ratio_error, head_error, gain)
                image = recalibrate(
                    samples, tags, dark=DETECTOR.noise.dark, ratio_sigma=sigma_ratio, head_sigma=sigma_head,
                    column_gain_sigma=GAIN_ERROR,
                )  # fmt: skip
                error = image.signal.mean(axis=0) / signal - 1.0
                systematic = image.sigma.mean(axis=0) / signal
                noise = 1.0 / (tags.snr[0, tags.group_of_columns()] * np.sqrt(lines))
                squares.append(float(np.mean(error**2 / (systematic**2 + noise**2))))
                found.append(float(np.mean(error**2 - noise**2)))
                stated = float(np.sqrt(np.mean(systematic**2)))
        of_mean = np.std(squares) / np.sqrt(len(squares))
        gates.check(f"signal {signal:g}: NEES of the stated uncertainty", float(np.mean(squares)), 0.8, 1.25)
        # over the mean square, noise taken off; below 0 where noise is all
        rms = 1e2 * np.sqrt(max(np.mean(found), 0.0))
        print(f"{signal:7g} {1e2 * stated:9.4f} {rms:9.4f} {np.mean(squares):6.3f} {of_mean:5.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--lines", type=int, default=4000)
    given = parser.parse_args()
    print(f"flat field, {given.lines} lines, {len(given.seeds)} seeds; electrons of one head line")
    _flat(given.seeds, given.lines, errors=False)
    print(
        f"\nthe same with integration ratios wrong by {RATIO_ERROR:.1%} each (1-sigma), nothing known of it"
    )
    _flat(given.seeds, given.lines, errors=True)
    _nees(given.seeds, max(given.lines // 8, 10))


if __name__ == "__main__":
    gates.run(main, __file__)
