"""S1's own estimators beside the banded smoother, on the same simulated series.

    python benchmarks/s1_methods.py [--trials 12] [--sigma 0.03] [--gap 0.2]

Drift 2 px, broadband 0.10 px, lines at 47, 83 and 121 Hz of 0.30, 0.15 and 0.08 px; 2 s; pairs 172, 22, 7 and
15 ms apart, one measurement in 5 ms (so the 121 Hz line lies above the Nyquist frequency); a polynomial of
degree 5 before every filter. Each trial is three series, one per axis. Unit: px. Columns: rms error less its
mean, rms of the stated sigma, NEES, and time per series. Filters marked "best k" take the best of four for
each pair over all trials, which nobody could know beforehand.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.linalg import toeplitz

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from motion.estimators.s1_combinations import in_turn, max_band
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.inverse import inverse
from sightline.motion.estimators.kalman import kalman
from sightline.motion.estimators.polynomial import polynomial
from sightline.motion.estimators.smoother import smooth
from sightline.motion.estimators.wiener import wiener

STEP, COUNT, EVERY = 1e-3, 2001, 5
LAGS = (172, 22, 7, 15)
LINES = ((0.30, 47.0), (0.15, 83.0), (0.08, 121.0))
JITTER = (Matern(0.10, 1.0 / (2.0 * np.pi * 30.0), "3/2"), *(Tone(s, f, 0.8) for s, f in LINES))
PRIOR = Spectrum((Matern(2.0, 1.0, "5/2"), *JITTER))
EPOCHS = STEP * np.arange(COUNT)
BEST = (1e-3, 1e-2, 0.1, 0.5)

Estimator = Callable[[Sequence[AngleDifferences]], Motion]


def measure(x: np.ndarray, sigma: float, gap: float, rng: np.random.Generator) -> list[AngleDifferences]:
    """Four pairs with independent errors; nothing that touches `gap` seconds about the middle."""
    pairs = []
    for number, lag in enumerate(LAGS):
        i = np.arange(0, COUNT - lag, EVERY)
        hidden = [np.abs(EPOCHS[k] - EPOCHS[-1] / 2) < gap / 2 for k in (i, i + lag)]
        i = i[~(hidden[0] | hidden[1])]
        values = x[i + lag] - x[i] + sigma * rng.standard_normal((len(i), 3))
        covariance = np.tile(sigma**2 * np.eye(3), (len(i), 1, 1))
        pairs.append(AngleDifferences(EPOCHS[i], lag * STEP, values, covariance, (0, number + 1)))
    return pairs


def estimators() -> dict[str, Estimator]:
    """Every row of the table."""
    rows: dict[str, Estimator] = {"polynomial, degree 5": lambda d: polynomial(d, EPOCHS)}
    for m, lag in enumerate(LAGS):
        rows[f"inverse, {lag} ms"] = partial(_one, m, partial(inverse, k=0.0))
        for k in BEST:
            rows[f"flat k {k:g}, {lag} ms"] = partial(_one, m, partial(inverse, k=k))
        rows[f"Wiener, spectrum found, {lag} ms"] = partial(_one, m, wiener)
    rows["in turn, four pairs"] = lambda d: in_turn(d, EPOCHS)
    rows["max-band, k 0.1"] = lambda d: max_band(d, EPOCHS)
    rows["joint flat k 0.1"] = lambda d: inverse(d, EPOCHS)
    rows["joint Wiener, spectrum found"] = lambda d: wiener(d, EPOCHS)
    rows["joint Wiener, spectrum known"] = lambda d: wiener(d, EPOCHS, prior=Spectrum(JITTER))
    rows["Kalman, spectrum known"] = lambda d: kalman(d, EPOCHS, prior=PRIOR, grid_step=STEP)
    rows["banded smoother, spectrum known"] = lambda d: smooth(d, EPOCHS, prior=PRIOR, grid_step=STEP)
    return rows


def _one(m: int, estimator: Callable[..., Motion], pairs: Sequence[AngleDifferences]) -> Motion:
    return estimator([pairs[m]], EPOCHS)


def main() -> None:
    parser = argparse.ArgumentParser(description="S1's estimators beside the banded smoother")
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--sigma", type=float, default=0.03)
    parser.add_argument("--gap", type=float, default=0.0)
    options = parser.parse_args()
    root = np.linalg.cholesky(toeplitz(PRIOR.autocovariance(EPOCHS)) + 1e-10 * np.eye(COUNT))
    rng = np.random.default_rng(17)
    scores: dict[str, list[tuple[float, float, float, float]]] = {}
    for _ in range(options.trials):
        x = root @ rng.standard_normal((COUNT, 3))
        x -= x.mean(axis=0)
        pairs = measure(x, options.sigma, options.gap, rng)
        for name, estimate in estimators().items():
            started = time.perf_counter()
            motion = estimate(pairs)
            seconds = (time.perf_counter() - started) / 3.0
            error = motion.angles - motion.angles.mean(axis=0) - x
            variance = np.einsum("nii->ni", motion.covariance)
            row = (
                float((error**2).mean()),
                float(variance.mean()),
                float((error**2 / variance).mean()),
                seconds,
            )
            scores.setdefault(name, []).append(row)
    means = {name: np.mean(rows, axis=0) for name, rows in scores.items()}
    for lag in LAGS:
        best = min((means.pop(f"flat k {k:g}, {lag} ms") for k in BEST if k != 0.1), key=lambda row: row[0])
        means[f"best k, {lag} ms"] = min(best, means[f"flat k 0.1, {lag} ms"], key=lambda row: row[0])
    print(f"sigma {options.sigma} px, gap {options.gap} s, {3 * options.trials} series")
    print("| estimator | rms px | stated sigma px | NEES | ms |\n|---|---|---|---|---|")
    for name, (error, variance, nees, seconds) in sorted(means.items(), key=lambda item: -item[1][0]):
        print(f"| {name} | {error**0.5:.4f} | {variance**0.5:.4f} | {nees:.2f} | {1e3 * seconds:.1f} |")


if __name__ == "__main__":
    main()
