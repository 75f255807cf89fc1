"""Settings that change seldom: time and memory for a whole detector line, changes saved and merit given up.

The reference example with 30,000 columns x 64 signals x 2,520 settings. Prints the time of the free choice
and of the hysteresis (processor seconds of one core), and of settings held from line to line.

    python benchmarks/tdi_hysteresis.py [--columns 30000] [--signals 64]
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import TdiChoice, choose_settings
from sightline.tdi.hysteresis import LineHold, MeritFactors, merit_factors, steady_choice
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid


def _case(columns: int, signals: int) -> tuple[DriftMtf, TdiChoice]:
    x = np.linspace(-1.0, 1.0, columns)
    scan = ScanColumns(
        np.arange(columns), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((columns, 2), 0.3)
    )
    detector, rules = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0)), ChoiceRules()
    grid = TdiGrid(np.arange(3, 129), np.arange(1, 21) / 20.0)
    model = DriftMtf(scan, grid, detector.exposure, rules)
    return model, choose_settings(model, np.geomspace(1.0, 8000.0, signals), grid, detector, rules)


def _groups(groups: int, signals: int) -> tuple[TdiChoice, MeritFactors]:
    model, choice = _case(groups, signals)
    return choice, merit_factors(model, choice)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--columns", type=int, default=30_000)
    parser.add_argument("--signals", type=int, default=64)
    given = parser.parse_args()
    steady_choice(*_case(10, 2))  # compiles
    begin = time.process_time()
    model, choice = _case(given.columns, given.signals)
    print(f"{given.columns} columns x {given.signals} signals x {len(choice.grid)} settings")
    print(f"free choice: {time.process_time() - begin:.1f} s")
    begin = time.process_time()
    factors = merit_factors(model, choice)
    print(f"factors of the merit: {time.process_time() - begin:.1f} s")
    print(f"{'along':>8} {'may lose %':>11} {'step':>5} {'s':>6} {'changes':>17} {'largest step':>13} "
          f"{'mean loss %':>12} {'worst %':>8} {'too far':>8}")  # fmt: skip
    for along, share, step in (
        ("columns", 0.001, None), ("columns", 0.005, None), ("columns", 0.01, None), ("columns", 0.01, 4),
        ("columns", 0.01, 1), ("columns", 0.02, None), ("signals", 0.01, None),
    ):  # fmt: skip
        begin = time.process_time()
        steady = steady_choice(model, choice, share, largest_step=step, along=along, factors=factors)
        took = time.process_time() - begin
        print(
            f"{along:>8} {1e2 * share:11g} {step or 'any':>5} {took:6.1f} "
            f"{steady.changes_before:8d}>{steady.changes_after:<8d} "
            f"{steady.largest_step_before:6d}>{steady.largest_step_after:<6d} "
            f"{1e2 * steady.mean_loss:12.3f} {1e2 * steady.worst_loss:8.3f} {int(steady.too_far.sum()):8d}"
        )
    groups = LineHold(*_groups(64, given.signals), 0.01)
    signals = 400.0 * np.exp(0.3 * np.random.default_rng(0).standard_normal((20_000, 64)))
    groups(signals[:2])
    begin = time.process_time()
    groups(signals)
    rate = signals.size / (time.process_time() - begin) / 1e6
    print(f"held from line to line, 64 groups: {rate:.1f} million samples per second and core")
    print(f"memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
