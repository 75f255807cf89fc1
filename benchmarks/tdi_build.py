"""The whole build of a flight table: choice, table and certificate, beside plain numpy in one run.

    python benchmarks/tdi_build.py
    python benchmarks/tdi_build.py --columns 3000

30,000 columns x 64 signals x 2,520 settings, drifting like those of `validation/tdi_table.py`, on one core:
processor and wall seconds, peak memory of the process. Plain numpy judges a few columns the same way (same
formulas, whole arrays); its seconds for all columns are scaled up.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure, drift_transfer
from sightline.tdi.choose import choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table_build import build_table

GRID = TdiGrid(np.arange(3, 129), np.arange(1, 21) / 20)
DETECTOR = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0))
SIGNALS = np.geomspace(1.0, 8000.0, 64)
MAX_LOSS = 0.005
#: Columns that numpy judges.
BY_NUMPY = 24


def columns_of(count: int) -> ScanColumns:
    """A detector with a drift like that of yaw and distortion."""
    x = np.linspace(-1.0, 1.0, count)
    static = 0.35 * np.sinc(0.45) * np.exp(-2.0 * (np.pi * 0.2 * 0.5) ** 2)
    slip = np.radians(0.1 + 1.2 * x)
    return ScanColumns(np.arange(count), 0.999 + 0.004 * x**2, slip, np.full((count, 2), static))


def by_numpy(columns: ScanColumns) -> np.ndarray:
    """(c, S) number of the best setting, whole arrays at once."""
    stages, ratio = GRID.settings
    noise = snr(SIGNALS[:, None], stages, ratio, DETECTOR.noise, DETECTOR.exposure)
    out = np.empty((len(columns), len(SIGNALS)), dtype=np.intp)
    for c, (velocity, slip) in enumerate(zip(columns.velocity, columns.slip, strict=True)):
        args = (stages, ratio, velocity, slip)
        x = np.abs(drift_transfer(*args, 0.5, 0.0, DETECTOR.exposure))
        y = np.abs(drift_transfer(*args, 0.0, 0.5, DETECTOR.exposure))
        drift = 0.5 * max(abs(velocity * np.tan(slip)), abs(velocity - 1.0))
        out[c] = (np.where(stages * drift <= 1.0, x * y, 0.0) * noise).argmax(axis=1)
    return out


def main() -> None:
    """Build, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--columns", type=int, default=30_000)
    count = parser.parse_args().columns
    rules = ChoiceRules()
    small = columns_of(BY_NUMPY)
    # compiled before the clock runs
    model = DriftMtf(small, GRID, DETECTOR.exposure, rules)
    build_table(model, choose_settings(model, SIGNALS, GRID, DETECTOR, rules), MAX_LOSS)

    columns = columns_of(count)
    model = DriftMtf(columns, GRID, DETECTOR.exposure, rules)
    print(f"{count} columns x {len(SIGNALS)} signals x {len(GRID)} settings, one core")
    total_cpu, total_wall = time.process_time(), time.perf_counter()
    choice = choose_settings(model, SIGNALS, GRID, DETECTOR, rules)
    middle_cpu, middle_wall = time.process_time(), time.perf_counter()
    _, certificate = build_table(model, choice, MAX_LOSS)
    end_cpu, end_wall = time.process_time(), time.perf_counter()
    print(f"choice                {middle_cpu - total_cpu:7.1f} s CPU {middle_wall - total_wall:7.1f} s wall")
    print(f"table and certificate {end_cpu - middle_cpu:7.1f} s CPU {end_wall - middle_wall:7.1f} s wall")
    print(f"together              {end_cpu - total_cpu:7.1f} s CPU {end_wall - total_wall:7.1f} s wall")
    print(f"table of {certificate.bytes} bytes, certified loss {100.0 * certificate.loss:.3f} %")
    begun = time.process_time()
    plain = by_numpy(small)
    seconds = (time.process_time() - begun) * count / BY_NUMPY
    same = choose_settings(
        DriftMtf(small, GRID, DETECTOR.exposure, rules), SIGNALS, GRID, DETECTOR, rules
    ).setting
    print(
        f"numpy, {BY_NUMPY} columns    {seconds:7.1f} s CPU for all; the choice is "
        f"{seconds / (middle_cpu - total_cpu):.1f} times as fast, settings differ in "
        f"{np.mean(plain != same):.1%} of the cells"
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory {peak:.2f} GiB")


if __name__ == "__main__":
    main()
