"""Look-up of TDI settings at line rate, beside numpy and a plain copy, on one core in one run.

    python benchmarks/tdi_lookup.py [--lines 1000] [--passes 9]

30,000 columns, tables certified to 0.5 %: once as the reference example has it, once with a full well that
makes many cells. Each figure is the best of several passes that take turns, compilation excluded. numpy: the
group of each column, the range of each signal by a list, and fancy indexing, lists prepared beforehand.
Targets: 1.2 Gsample/s, 5 times numpy, twice 20,000 lines per second.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table import TdiTable
from sightline.tdi.table_build import build_table

COLUMNS, LINE_RATE = 30_000, 20_000.0


def table_of(full_well: float, signals: int) -> TdiTable:
    """Table of the reference example, built on 300 columns and spread over all."""
    few = 300
    x = np.linspace(-1.0, 1.0, few)
    columns = ScanColumns(
        np.arange(few, dtype=float), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((few, 2), 0.2)
    )
    grid = TdiGrid(np.arange(3, 129), 0.05 * np.arange(1, 21))
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0), full_well_sum=full_well)
    rules = ChoiceRules()
    model = DriftMtf(columns, grid, detector.exposure, rules)
    choice = choose_settings(model, np.geomspace(1.0, 8000.0, signals), grid, detector, rules)
    table, _ = build_table(model, choice, 0.005 if np.isinf(full_well) else 0.02)
    return replace(table, edges=table.edges * (COLUMNS // few))


def scene(lines: int, kind: str) -> np.ndarray:
    """Signals (lines, COLUMNS): a random walk along each line, or drawn anew for each sample; log-uniform."""
    rng = np.random.default_rng(0)
    if kind == "random":
        return np.exp(np.log(8000.0) * rng.random((lines, COLUMNS), dtype=np.float32))
    step = rng.standard_normal((lines, COLUMNS), dtype=np.float32).cumsum(axis=1, dtype=np.float32)
    turn = np.abs(np.mod(0.05 * step, 2.0) - 1.0)
    return np.exp(np.log(8000.0) * turn)


def numpy_lookup(table: TdiTable) -> Callable[[np.ndarray], np.ndarray]:
    """The same words by fancy indexing into words by group and range of signal."""
    limits = np.unique(table.thresholds)
    spread = np.zeros(1 << 16, dtype=np.uint8 if len(limits) <= 256 else np.uint16)
    spread[:] = np.searchsorted(limits, np.arange(1 << 16), side="right") - 1
    rows = replace(table, edges=np.arange(len(table.edges)))
    groups = len(table.edges) - 1
    words = rows.lookup(np.repeat(limits[:, None], groups, axis=1)).T.copy()
    group = np.repeat(np.arange(groups), np.diff(table.edges))
    return lambda signals: words[group, spread[signals]]


def best(works: dict[str, Callable[[], object]], passes: int) -> dict[str, float]:
    """Seconds of each, the least of several passes in turn."""
    found = dict.fromkeys(works, np.inf)
    for work in works.values():
        work()
    for _ in range(passes):
        for name, work in works.items():
            begin = time.perf_counter()
            work()
            found[name] = min(found[name], time.perf_counter() - begin)
    return found


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=int, default=1000)
    parser.add_argument("--passes", type=int, default=9)
    given = parser.parse_args()
    tables = {"open wells": table_of(np.inf, 64), "full well 60,000 e-": table_of(6e4, 64)}
    print(f"{COLUMNS} columns x {given.lines} lines, one core, best of {given.passes}")
    print("| table | bytes | most cells | signals | Gsample/s | numpy | ratio | of copy | lines/s | margin |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, table in tables.items():
        by_numpy = numpy_lookup(table)
        for kind in ("smooth", "random"):
            whole = np.minimum(scene(given.lines, kind), 7999.0).astype(np.uint16)
            for signals in (whole, whole.astype(np.float32)):
                out = np.empty(whole.shape, dtype=np.uint16)
                works = {
                    "table": lambda t=table, s=signals, o=out: t.lookup(s, o),
                    "copy": lambda s=whole, o=out: np.copyto(o, s),
                }
                if signals is whole:
                    if not np.array_equal(by_numpy(whole), table.lookup(whole)):
                        raise SystemExit("numpy and the table disagree")
                    works["numpy"] = lambda f=by_numpy, s=whole: f(s)
                seconds = best(works, given.passes)
                rate = whole.size / seconds["table"]
                rival = whole.size / seconds["numpy"] if "numpy" in seconds else np.nan
                cells = np.diff(table.starts).max()
                print(
                    f"| {name} | {len(table.to_bytes())} | {cells} | {kind} {signals.dtype} | "
                    f"{rate / 1e9:.2f} | {rival / 1e9:.2f} | {rate / rival:.1f} | "
                    f"{100 * seconds['copy'] / seconds['table']:.0f} % | {rate / COLUMNS:.0f} | "
                    f"{rate / COLUMNS / LINE_RATE:.1f} |",
                    flush=True,
                )
                alone = [{"line": lambda t=table, s=signals[k], o=out[k]: t.lookup(s, o)} for k in range(200)]
                times = [best(work, 1)["line"] for work in alone]
                print(
                    f"  one line alone: {1e6 * np.median(times):.1f} us, best {1e6 * min(times):.1f}",
                    flush=True,
                )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
