"""Layouts of the focal plane: the optimum by brute force, and the sigma by simulation.

Prints one row per target. The brute force, the information it maximises and the simulated truth are written
out here and share no code with the package. Unit: px. Four detectors within 172.2 ms, as S1's example has
them, for 40-150 Hz.

    python validation/layout.py [--trials 30]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sightline.applications.focal_plane import (
    BALANCED,
    BEST,
    FULL_SPAN,
    FocalPlane,
    JudgedLayout,
    LayoutChoice,
    choose_layout,
)
from sightline.estimation.evidence import posterior
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.series import Grid, series_equations
from sightline.estimation.split import split
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.smoother import axis_series, smooth
from sightline.motion.layout.information import RowNoise
from sightline.motion.layout.search import Candidates, search_layouts
from sightline.motion.layout.sigma import harmonic_sigma, smoother_sigma

Array = NDArray[np.float64]

LOW, HIGH = 40.0, 150.0  # Hz
SPAN, STEP = 0.1722, 0.2e-3  # s; of the focal plane, and the grid of the brute force
S1 = np.array([0.0, 0.1500, 0.1574, 0.1722])
PERIOD, SIGMA, DURATION = 1e-3, 0.03, 2.0  # s, px of a match per row, s
GRID = 0.5 * PERIOD  # of the smoother: 13 nodes in a period of 150 Hz
TONES = ((0.30, 47.0), (0.15, 83.0), (0.08, 121.0))
BANDWIDTH, CORNER = 0.8, 30.0  # Hz
PRIOR = Spectrum(
    (
        Matern(2.0, 1.0, "5/2"),
        Matern(0.1, np.sqrt(3.0) / (2.0 * np.pi * CORNER), "3/2"),
        *(Tone(s, f, BANDWIDTH) for s, f in TONES),
    )
)
PLANE = FocalPlane(
    1e6, PERIOD, 1.0 / PERIOD, (SIGMA / np.sqrt(2.0),) * 4, span_px=SPAN / PERIOD,
    min_spacing_px=STEP / PERIOD, prior=PRIOR, duration=DURATION,
)  # fmt: skip


def row(item: str, what: str, value: str, required: str, good: bool) -> None:
    """Note one figure of an item of the specification."""
    gates.note(f"{item}: {what}", value, required, good)


# ---------------------------------------------------------------------------- the optimum, by brute force


def worth(positions: Array, frequency: Array) -> Array:
    """Images' worth of information: n - 1 less 2/n times the sum of the cosines of all lags."""
    n = len(positions)
    total = sum(np.cos(2.0 * np.pi * frequency * (b - a)) for a, b in combinations(positions, 2))
    return n - 1.0 - 2.0 / n * total


def worst(positions: Array) -> float:
    """Least worth in the band, every 0.01 Hz."""
    return float(worth(positions, np.arange(LOW, HIGH + 0.005, 0.01)).min())


def brute_force(fixed_span: bool) -> tuple[float, Array]:
    """Best of all layouts of four on the grid, each compared at all frequencies until it falls behind."""
    count = round(SPAN / STEP) + 1
    frequency = np.random.default_rng(0).permutation(np.arange(LOW, HIGH, 0.25))
    cosines = np.cos(2.0 * np.pi * STEP * frequency[:, None] * np.arange(count))  # (F, lags on the grid)
    best, found = -np.inf, np.zeros(4, dtype=int)
    second, third = (x.ravel() for x in np.meshgrid(np.arange(1, count), np.arange(1, count), indexing="ij"))
    for last in [count - 1] if fixed_span else range(3, count):
        inside = (second < third) & (third < last)
        i, j = second[inside], third[inside]
        if not fixed_span:  # the mirrored layout is the same
            inside = i <= last - j
            i, j = i[inside], j[inside]
        least = np.full(len(i), np.inf)
        for c in cosines:
            total = c[i] + c[j] + c[j - i] + c[last - i] + c[last - j] + c[last]
            np.minimum(least, 3.0 - 0.5 * total, out=least)
            kept = least > best
            i, j, least = i[kept], j[kept], least[kept]
            if not len(i):
                break
        if len(i):
            k = int(np.argmax(least))
            best, found = float(least[k]), np.array([0, i[k], j[k], last])
    return best, found * STEP


def optimum(choice: LayoutChoice) -> None:
    """The layouts found against the brute force, and against S1's."""
    own = worst(S1)
    for name, fixed in ((BEST, False), (FULL_SPAN, True)):
        begin = time.process_time()
        _, positions = brute_force(fixed)
        seconds, value = time.process_time() - begin, worst(positions)
        layout = named(choice, name)
        found = worst(layout.positions)
        span = "ends at 0 and 172.2 ms" if fixed else "any span up to 172.2 ms"
        row("6", f"worst case, {span}: found {ms(layout.positions)}", f"{found:.4f}",
            f">= 0.95 x {value:.4f}, exhaustive on 0.2 ms: {ms(positions)} ({seconds:.0f} s)",
            found >= 0.95 * value)  # fmt: skip
        row("6", f"the same over that of S1's example, {own:.4f}", f"{found / own:.0f} x", "tens of times",
            found / own >= 10.0)  # fmt: skip
    on_grid = choose_layout(replace(PLANE, step_px=STEP / PERIOD), (LOW, HIGH), count=1).best
    value = worst(brute_force(False)[1])
    found = worst(on_grid.positions)
    row("6", f"held on the 0.2 ms grid: found {ms(on_grid.positions)}", f"{found:.4f}", f"{value:.4f}",
        abs(found - value) < 1e-6)  # fmt: skip


def not_exhaustive() -> None:
    """The search of many starts where all can still be gone through."""
    cases = {
        "4 of 862 places, 0.2 ms": (Candidates.even_grid(SPAN, STEP, STEP), (1.0,) * 4),
        "5 of 173 places, 1 ms": (Candidates.even_grid(SPAN, 1e-3, 1e-3), (1.0,) * 5),
        "6 of 70 places, 2.5 ms": (Candidates.even_grid(SPAN, 2.5e-3, 2.5e-3), (1.0,) * 6),
        "4 unlike images of 431 places": (Candidates.even_grid(SPAN, 4e-4, 4e-4), (1.0, 1.0, 1.5, 2.0)),
        "5 of 60 lines of one detector": (uneven(60), (1.0,) * 5),
    }
    for name, (candidates, sigma) in cases.items():
        noise = RowNoise(sigma, PERIOD)
        runs = [
            search_layouts(candidates, noise, (LOW, HIGH), exhaustive=every).worst[0]
            for every in (True, False)
        ]
        row("6", f"search of many starts over exhaustive, {name}", f"{runs[1] / runs[0]:.4f}", ">= 0.95",
            runs[1] >= 0.95 * runs[0])  # fmt: skip


def uneven(count: int) -> Candidates:
    """Lines 0.5 ms apart of which every seventh is dead."""
    t = 5e-4 * np.arange(float(count))
    return Candidates(t[np.arange(count) % 7 != 3], 5e-4, False)


# ---------------------------------------------------------------------------- sigma


def named(choice: LayoutChoice, name: str) -> JudgedLayout:
    """A ranked layout by its name."""
    return next(layout for layout in choice.ranked if layout.name == name)


def ms(positions: Array) -> str:
    """Places in ms."""
    return " / ".join(f"{1e3 * t:.1f}" for t in positions)


def two_ways(layouts: dict[str, Array]) -> None:
    """Harmonic sigma against that of the smoother over a strip so long that its ends matter little."""
    noise, duration = RowNoise.alike(4, SIGMA, PERIOD), 8.0
    for name, positions in layouts.items():
        sigma = smoother_sigma(positions, noise, PRIOR, duration, step=GRID)[1]
        ratio = rms(sigma) / harmonic_sigma(positions, noise, PRIOR, duration)
        row("6", f"sigma of the smoother over 8 s, over the harmonic one: {name}", f"{ratio:.3f}",
            "0.95-1.10", 0.95 <= ratio <= 1.10)  # fmt: skip


def from_prior(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A motion of the prior, from its written autocovariance on a fine circle of 52 s."""
    step, count = 5e-5, 1 << 20
    lag = step * np.minimum(np.arange(count), count - np.arange(count))
    a, b = np.sqrt(5.0) * lag, 2.0 * np.pi * CORNER * lag
    covariance = 4.0 * (1.0 + a + a * a / 3.0) * np.exp(-a) + 0.01 * (1.0 + b) * np.exp(-b)
    for s, f in TONES:
        turn = 2.0 * np.pi * f * lag
        shape = np.cos(turn) + BANDWIDTH / (2.0 * f) * np.sin(turn)
        covariance += s * s * np.exp(-np.pi * BANDWIDTH * lag) * shape
    power = np.maximum(np.fft.rfft(covariance).real, 0.0)
    wave = rng.normal(size=len(power)) + 1j * rng.normal(size=len(power))
    values = np.fft.irfft(wave * np.sqrt(0.5 * power * count), count)
    used = round((DURATION + 0.2) / step)
    return CubicSpline(step * np.arange(used) - 0.1, values[:used])


def of_another_family(rng: np.random.Generator) -> Callable[[Array], Array]:
    """Pure sines of fixed amplitude, a parabola, and modes that are struck and ring out."""
    f = np.array([0.4, 1.3, 3.1, 46.0 + rng.uniform(-2, 2), 88.0 + rng.uniform(-9, 9), 134.0])
    size = np.array([1.0, 0.4, 0.15, 0.3, 0.12, 0.08])
    phase = rng.uniform(0.0, 2.0 * np.pi, len(f))
    struck = rng.uniform(0.1, 0.9, 3) * DURATION
    modes = np.array([62.0, 105.0, 20.0]) * rng.uniform(0.95, 1.05, 3)

    def motion(t: Array) -> Array:
        out = 0.7 * (t / DURATION) ** 2 + np.sin(2.0 * np.pi * f * t[:, None] + phase) @ size
        for at, mode in zip(struck, modes, strict=True):
            since = np.maximum(t - at, 0.0)
            out += 0.1 * np.exp(-since / 0.25) * np.sin(2.0 * np.pi * mode * since)
        return out

    return motion


def measured(
    motions: list[Callable[[Array], Array]], positions: Array, rng: np.random.Generator
) -> list[AngleDifferences]:
    """Six pairs of four images, each image with one error per row of ground, of three motions."""
    first = -int(np.ceil(positions.max() / PERIOD))
    ground = PERIOD * np.arange(first, round(DURATION / PERIOD) + 1)
    seen = ground[:, None] + positions  # (rows, images) s
    inside = (seen >= 0.0) & (seen <= DURATION)
    places = np.stack([[m(np.clip(t, 0.0, DURATION)) for t in seen.T] for m in motions], axis=-1)
    places = places + SIGMA / np.sqrt(2.0) * rng.normal(size=places.shape)  # (images, rows, 3)
    data = []
    for a, b in combinations(range(len(positions)), 2):
        both = np.flatnonzero(inside[:, a] & inside[:, b])
        covariance = np.tile(SIGMA**2 * np.eye(3), (len(both), 1, 1))
        lag = np.full(len(both), positions[b] - positions[a])
        values = (places[b] - places[a])[both]
        data.append(AngleDifferences(seen[both, a], lag, values, covariance, images=(a, b), patch=both))
    return data


def rms(x: Array) -> float:
    """Root mean square of everything."""
    return float(np.sqrt(np.mean(x**2)))


def band_rms(error: Array) -> float:
    """Rms of the part of the errors (trials, N) between LOW and HIGH, by a tapered periodogram."""
    taper = np.hanning(error.shape[1])
    power = np.mean(np.abs(np.fft.rfft(error * taper, axis=1)) ** 2, axis=0)
    f = np.fft.rfftfreq(error.shape[1], PERIOD)
    inside = (f >= LOW) & (f <= HIGH)
    return float(np.sqrt(2.0 * power[inside].sum() / (error.shape[1] * np.sum(taper**2))))


def nees(data: list[AngleDifferences], axis: int, error: Array) -> float:
    """Squared error per degree of freedom every 5 ms, full covariance, constant removed."""
    grid = Grid.covering(-3.0 * GRID, DURATION + 3.0 * GRID, GRID)
    equations = series_equations(axis_series(data, axis), grid, spectrum=PRIOR)
    prior = split(PRIOR, GRID, 60, grid.count, width=len(equations.band) - 1)
    now = posterior(equations, prior or PRIOR.autoregressive(GRID, 60, grid.count))
    chosen = np.arange(0, len(error), 5)
    node = 3 + chosen * round(PERIOD / GRID)
    unit = np.zeros((grid.count, len(chosen)))
    unit[node, np.arange(len(chosen))] = 1.0
    covariance = now.covariance_times(unit)[node]
    basis = np.linalg.svd(np.eye(len(chosen)) - 1.0 / len(chosen))[0][:, :-1]
    e = basis.T @ error[chosen]
    return float(e @ np.linalg.solve(basis.T @ covariance @ basis, e)) / len(e)


def simulated(layouts: dict[str, Array], trials: int) -> None:
    """Motions of the prior, recovered: rms against the sigma that the layout promised, and NEES.

    The rms of a short layout is that of one or two slow errors per motion: of 30 motions it scatters by 10 %.
    """
    t = PERIOD * np.arange(round(DURATION / PERIOD) + 1)
    noise = RowNoise.alike(4, SIGMA, PERIOD)
    for name, positions in layouts.items():
        rng = np.random.default_rng(6)
        errors, scores = [], []
        for _ in range(-(-trials // 3)):
            motions = [from_prior(rng) for _ in range(3)]
            data = measured(motions, positions, rng)
            truth = np.stack([m(t) for m in motions], axis=1)
            error = smooth(data, t, prior=PRIOR, grid_step=GRID).angles - (truth - truth.mean(axis=0))
            errors.append(error.T)
            scores += [nees(data, axis, error[:, axis]) for axis in range(3)]
        error = np.concatenate(errors)
        promised = rms(smoother_sigma(positions, noise, PRIOR, DURATION, step=GRID)[1])
        band = harmonic_sigma(positions, noise, PRIOR, DURATION, passband=(LOW, HIGH))
        found, inside, score = rms(error), band_rms(error), float(np.mean(scores))
        row("6", f"{name}: rms of {len(error)} motions of the prior over the sigma promised",
            f"{found:.4f} / {promised:.4f} = {found / promised:.3f}", "0.8-1.2",
            0.8 <= found / promised <= 1.2)  # fmt: skip
        row("6", f"{name}: the same within 40-150 Hz", f"{inside:.5f} / {band:.5f} = {inside / band:.3f}",
            "0.9-1.1", 0.9 <= inside / band <= 1.1)  # fmt: skip
        row("6", f"{name}: NEES/dof", f"{score:.3f}", "0.95-1.05", 0.95 <= score <= 1.05)


def simulated_blind(layouts: dict[str, Array]) -> None:
    """Motions of another family, nothing known of them: rms against the sigma that the estimate states.

    A layout of 16 ms sees so little of the slow part that its prior cannot be found in the data: its figures
    are printed, and only those within the band are required.
    """
    t = PERIOD * np.arange(round(DURATION / PERIOD) + 1)
    within: dict[str, float] = {}
    for name, positions in layouts.items():
        rng = np.random.default_rng(7)
        motions = [of_another_family(rng) for _ in range(3)]
        motion = smooth(measured(motions, positions, rng), t, grid_step=GRID)
        truth = np.stack([m(t) for m in motions], axis=1)
        error = motion.angles - (truth - truth.mean(axis=0))
        sigma = np.sqrt(np.einsum("nii->ni", motion.covariance))
        score, within[name] = float(np.mean((error / sigma) ** 2)), band_rms(error.T)
        scored = f"{rms(error):.4f} / {rms(sigma):.4f} px, NEES {score:.2f}"
        wide = np.ptp(positions) > 0.1
        row("6", f"{name}: another family, prior found in the data: rms / stated sigma", scored,
            "NEES 0.7-1.5" if wide else "none", not wide or 0.7 <= score <= 1.5)  # fmt: skip
        row("6", f"{name}: the same, rms within 40-150 Hz", f"{within[name]:.4f} px",
            "<= S1's" if len(within) > 1 else "-", within[name] <= within["S1's example"])  # fmt: skip


def main() -> None:
    """Run all targets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--trials", type=int, default=30, help="motions per layout with the prior known")
    options = parser.parse_args()
    begin = time.process_time()
    choice = choose_layout(PLANE, (LOW, HIGH))
    seconds = time.process_time() - begin
    row("6", f"{choice.tried:,.0f} layouts gone through, the best judged", f"{seconds:.1f} s",
        "seconds to a minute", seconds < 60.0)  # fmt: skip
    optimum(choice)
    not_exhaustive()
    layouts = {"S1's example": S1}
    layouts |= {name: named(choice, name).positions for name in (BEST, BALANCED, FULL_SPAN)}
    two_ways(layouts)
    simulated(layouts, options.trials)
    simulated_blind(layouts)


if __name__ == "__main__":
    gates.run(main, __file__)
