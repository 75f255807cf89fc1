"""Transfer of every TDI setting rebuilt from one sampled motion: compiled beside plain numpy, in one run.

    python benchmarks/tdi_rebuild.py

64 column groups x 10 integration ratios x 128 stages x 2 frequencies, from angles at every line period: what
a table that follows the attitude computes anew. One core. Both integrate the same points, 8 per exposure, and
interpolate the motion inside the clock; numpy takes one pass per group, cumulative over stages.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))

from sightline.geometry.trajectory import Motion  # noqa: E402
from sightline.imaging.tdi_transfer import Exposure, motion_transfer  # noqa: E402
from sightline.tdi.motion_knowledge import MotionKnowledge  # noqa: E402
from sightline.tdi.motion_mtf import MotionMtf  # noqa: E402
from sightline.tdi.scan_columns import ColumnGeometry  # noqa: E402
from sightline.tdi.setting import ChoiceRules, TdiGrid  # noqa: E402

GROUPS, STAGES, RATIOS, PERIOD, FOCAL = 64, 128, 10, 1e-4, 2e5


def scene() -> MotionMtf:
    """Drift and jitter of some tenths of a px, 64 groups of 30,000 columns."""
    rng = np.random.default_rng(0)
    t = PERIOD * np.arange(-20.0, STAGES + 40.0)
    angles = np.cumsum(rng.normal(scale=0.01 / FOCAL, size=(len(t), 3)), axis=0)
    x = np.linspace(-15000.0, 15000.0, GROUPS)
    levers = np.zeros((GROUPS, 2, 3))
    levers[:, 0, 0], levers[:, 1, 1], levers[:, 1, 2] = -FOCAL, FOCAL, x
    place = np.arange(GROUPS) * 476.0
    velocity, slip = 0.999 + 0.004 * (x / 15e3) ** 2, np.radians(0.1 + 1.2 * x / 15e3)
    none = np.zeros(GROUPS)
    geometry = ColumnGeometry(
        place, velocity, slip, none, none, np.stack([x, none], axis=1), FOCAL, levers,
        np.array([0.0, 0.0, 1.0]), PERIOD,
    )  # fmt: skip
    grid = TdiGrid(np.arange(1, STAGES + 1), np.arange(1, RATIOS + 1) / RATIOS)
    knowledge = MotionKnowledge(Motion(t, angles))
    return MotionMtf(geometry.columns(1.0), geometry, knowledge, grid, Exposure(2, 0.25), ChoiceRules())


def compiled(model: MotionMtf) -> np.ndarray:
    """(G, P, 2) by the package."""
    out = np.empty((GROUPS, len(model.grid), 2))
    model.line_mtf(0.0, model.columns.velocity, model.columns.slip, None, None, out)
    return out


def plain(model: MotionMtf) -> np.ndarray:
    """(G, P, 2) by numpy, one group after another."""
    node, weight = np.polynomial.legendre.leggauss(8)
    k = np.arange(STAGES)
    lengths = np.where(k[:, None] < 2, 0.25, model.grid.ratios)
    offset = lengths[..., None] * 0.5 * node
    since = k[:, None, None] + offset
    angles = model.knowledge.motion.at((PERIOD * since).ravel()).reshape(*since.shape, 3)
    path, out = -angles[..., 2] * since, np.empty((GROUPS, len(model.grid), 2))
    total = np.cumsum(lengths, axis=0)
    for g in range(GROUPS):
        v = model.columns.velocity[g]
        a = v * np.tan(model.columns.slip[g])
        moved = angles @ model.geometry.levers[g].T
        x = a * since + moved[..., 0] + v * path
        y = (v - 1.0) * k[:, None, None] + v * offset + moved[..., 1] - a * path
        for axis, d in enumerate((x, y)):
            stage = lengths * (np.exp(-1j * np.pi * d) @ (0.5 * weight))
            out[g, :, axis] = (abs(np.cumsum(stage, axis=0)) / total).ravel()
    return out


def clocked(
    what: Callable[[MotionMtf], np.ndarray], model: MotionMtf, repeats: int
) -> tuple[float, np.ndarray]:
    """Median CPU milliseconds, and the result."""
    seconds = []
    for _ in range(repeats):
        begun = time.process_time()
        result = what(model)
        seconds.append(time.process_time() - begun)
    return 1e3 * float(np.median(seconds)), result


def main() -> None:
    """Time both, compare them and one column with its own formula."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    model = scene()
    compiled(model)  # compiles, or reads what was compiled
    ours, found = clocked(compiled, model, repeats)
    theirs, expected = clocked(plain, model, max(repeats // 3, 1))
    g, motion = 5, model.knowledge.motion
    since = np.arange(-20.0, STAGES + 40.0)
    moved = motion.angles @ model.geometry.levers[g].T
    v, a = model.columns.velocity[g], np.tan(model.columns.slip[g]) * model.columns.velocity[g]
    moved[:, 0] -= v * motion.angles[:, 2] * since
    moved[:, 1] += a * motion.angles[:, 2] * since
    h = motion_transfer(
        STAGES, model.grid.ratios, v, model.columns.slip[g], 0.5, 0.0, moved, 20.0, model.exposure
    )
    print(f"{GROUPS} groups x {RATIOS} ratios x {STAGES} stages x 2 frequencies, one line, one core")
    print(f"compiled  {ours:7.1f} ms (target 100)")
    print(f"numpy     {theirs:7.1f} ms, {theirs / ours:.1f} times as long")
    print(f"largest difference: {abs(found - expected).max():.1e}")
    print(
        "to the formula of one column, whose motion is straight between line periods: "
        f"{abs(found[g, :, 0] - abs(h).T.ravel()).max():.1e}"
    )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
