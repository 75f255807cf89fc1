"""Accuracy and honesty of the smoother on simulated series.

Prints one row per target. The truth is drawn from a dense covariance written out here; it shares no
code with the smoother. Unit: pixels (one pixel = one unit of angle, the estimators are linear).

    python validation/series.py [--trials 40] [--blind 12] [--toneless 10000] [--strips 30]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from motion.estimators.s1_combinations import max_band
from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.estimation.evidence import Posterior, posterior
from sightline.estimation.likelihood import fit_spectrum, spread_of
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.search import HIGHEST, NoiseModel, Search
from sightline.estimation.series import DifferenceSeries, Grid, series_equations
from sightline.estimation.split import split
from sightline.geometry.surface import Plane
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.inverse import inverse
from sightline.motion.estimators.smoother import axis_series, fit_spectra, smooth
from sightline.simulate.jitter import JitterProfile, ToneJitter, nominal_profile
from sightline.simulate.scenarios import line_of_sight_case

Array = NDArray[np.float64]

STEP, COUNT, EVERY = 1e-3, 2000, 5  # 2 s on a 1 ms grid, one measurement per 10 lines of 0.5 ms
TONES = ((0.30, 47.0), (0.15, 83.0), (0.08, 121.0))
BANDWIDTH = 0.8  # Hz; gives the posterior sigmas of the prototype to 2 %
CORNER = 1.0 / (2.0 * np.pi * 30.0)  # s; timescale of the broadband part
LAGS = (172, 22, 7, 15)  # ms
PRIOR = Spectrum(
    (Matern(2.0, 1.0, "5/2"), Matern(0.1, CORNER, "3/2"), *(Tone(s, f, BANDWIDTH) for s, f in TONES))
)
GRID = Grid(0.0, STEP, COUNT)
EPOCHS = np.arange(COUNT) * STEP


def row(item: str, what: str, value: str, required: str, good: bool) -> None:
    """Note one figure of an item of the specification."""
    gates.note(f"{item}: {what}", value, required, good)


# ---------------------------------------------------------------------------- truth, by hand


def dense_covariance() -> Array:
    """Covariance (n, n) of the truth, from its formulas."""
    lag = np.arange(COUNT) * STEP
    a, b = np.sqrt(5.0) * lag, np.sqrt(3.0) * lag / CORNER
    drift = 4.0 * (1.0 + a + a * a / 3.0) * np.exp(-a)
    broadband = 0.01 * (1.0 + b) * np.exp(-b)
    return toeplitz(drift + broadband + sum(s * s * oscillation(lag, f) for s, f in TONES))


def oscillation(lag: Array, f: float) -> Array:
    """Correlation of a damped oscillator with itself, `lag` (s) later."""
    turn = 2.0 * np.pi * f * lag
    return np.exp(-np.pi * BANDWIDTH * lag) * (np.cos(turn) + BANDWIDTH / (2.0 * f) * np.sin(turn))


def draw(rng: np.random.Generator, root: Array) -> Array:
    """Three motions (n, 3): one trial per axis."""
    return root @ rng.normal(size=(COUNT, 3))


def measure(rng: np.random.Generator, x: Array, sigma: float, gap: float = 0.0) -> list[AngleDifferences]:
    """Four pairs with independent errors; nothing that touches `gap` seconds about the middle."""
    low, high = 0.5 * COUNT - 0.5 * gap / STEP, 0.5 * COUNT + 0.5 * gap / STEP
    out = []
    for lag in LAGS:
        k = np.arange(0, COUNT - lag, EVERY)
        k = k[((k < low) | (k >= high)) & ((k + lag < low) | (k + lag >= high))]
        values = x[k + lag] - x[k] + sigma * rng.normal(size=(len(k), 3))
        out.append(pair(k * STEP, lag * STEP, values, sigma))
    return out


def pair(
    t: Array,
    lag: float,
    values: Array,
    sigma: float,
    images: tuple[int, int] = (0, 1),
    patch: Array | None = None,
) -> AngleDifferences:
    """One image pair with equal errors on all axes."""
    covariance = np.tile(sigma**2 * np.eye(3), (len(t), 1, 1))
    return AngleDifferences(t, np.full(len(t), lag), values, covariance, images=images, patch=patch)


# ---------------------------------------------------------------------------- scores


def centred(x: Array) -> Array:
    """Less its mean: the constant is hidden."""
    return x - x.mean(axis=0)


def rms(x: Array) -> float:
    """Root mean square of everything."""
    return float(np.sqrt(np.mean(x**2)))


def axis_posterior(
    differences: Sequence[AngleDifferences], axis: int, prior: Spectrum, noise: float = 1.0
) -> Posterior:
    """Posterior of one axis on the 1 ms grid."""
    equations = series_equations(axis_series(differences, axis), GRID)
    parts = split(prior, STEP, 60, COUNT, width=len(equations.band) - 1)
    return posterior(equations, parts or prior.autoregressive(STEP, 60, COUNT), noise_scale=noise)


def nees(now: Posterior, error: Array, every: int) -> float:
    """Squared error per degree of freedom at every few epochs, full covariance, constant removed."""
    chosen = np.arange(0, COUNT, every)
    unit = np.zeros((COUNT, len(chosen)))
    unit[chosen, np.arange(len(chosen))] = 1.0
    covariance = now.covariance_times(unit)[chosen]
    centring = np.eye(len(chosen)) - 1.0 / len(chosen)
    basis = np.linalg.svd(centring)[0][:, :-1]
    e = basis.T @ error[chosen]
    return float(e @ np.linalg.solve(basis.T @ covariance @ basis, e)) / len(e)


# ---------------------------------------------------------------------------- the targets


def known_prior(root: Array, trials: int) -> None:
    """Item 2, prior known; item 3 beside S1's own methods."""
    for sigma in (0.01, 0.03, 0.1):
        rng = np.random.default_rng(200)
        errors, sigmas, scores = [], [], []
        rivals: dict[str, list[Array]] = {"max-band": [], "single": []}
        for trial in range(-(-trials // 3)):
            x = draw(rng, root)
            data = measure(rng, x, sigma)
            motion = smooth(data, EPOCHS, prior=PRIOR, grid_step=STEP)
            error = motion.angles - centred(x)
            errors.append(error)
            sigmas.append(np.einsum("nii->ni", motion.covariance))
            scores += [nees(axis_posterior(data, a, PRIOR), error[:, a], EVERY) for a in range(3)]
            if sigma == 0.03 and trial < 5:
                best = {k: max_band(data, EPOCHS, k=k).angles - centred(x) for k in (1e-3, 1e-2, 0.1)}
                rivals["max-band"].append(min(best.values(), key=rms))
                single = [
                    inverse([d], EPOCHS, k=k).angles - centred(x)
                    for d in data
                    for k in (1e-3, 1e-2, 0.1, 0.5)
                ]
                rivals["single"].append(min(single, key=rms))
        error, claimed = rms(np.concatenate(errors)), float(np.sqrt(np.mean(sigmas)))
        ratio = error / claimed
        row("2", f"rms / posterior sigma, sigma {sigma}", f"{error:.4f} / {claimed:.4f} = {ratio:.3f}",
            "0.9-1.10", 0.9 <= ratio <= 1.10)  # fmt: skip
        mean = float(np.mean(scores))
        row(
            "2",
            f"NEES/dof, {len(scores)} trials x 400, sigma {sigma}",
            f"{mean:.3f}",
            "0.95-1.05",
            0.95 <= mean <= 1.05,
        )
        if sigma == 0.03:
            for name, least, said in (("max-band", 3.5, 0.109), ("single", 5.0, 0.157)):
                rival = rms(np.concatenate(rivals[name]))
                gain = min(rival, said) / error
                label = "max-band combination" if name == "max-band" else "best single-pair filter"
                row("3", f"{label} (best k), sigma .03: {rival:.3f} (prototype {said})",
                    f"{gain:.1f} x lower",
                    f">= {least} x", gain >= least)  # fmt: skip


def blind_prior(root: Array, trials: int) -> None:
    """Item 2, hyper-parameters and frequencies from the data."""
    for sigma, share in ((0.01, 0.5), (0.03, 1.0), (0.1, 0.5)):
        rng = np.random.default_rng(7300)
        blind, known, started, series = [], [], time.process_time(), 0
        for _ in range(max(1, round(trials * share / 3))):
            x = draw(rng, root)
            data = measure(rng, x, sigma)
            found = fit_spectra(data)
            series += 3
            blind.append(smooth(data, EPOCHS, prior=found, grid_step=STEP).angles - centred(x))
            known.append(smooth(data, EPOCHS, prior=PRIOR, grid_step=STEP).angles - centred(x))
        seconds = (time.process_time() - started) / series
        ratio = rms(np.concatenate(blind)) / rms(np.concatenate(known))
        detail = f"{series} series, sigma {sigma} ({seconds:.1f} s each)"
        row("2", f"rms blind / rms with the true prior, {detail}",
            f"{ratio:.3f}", "<= 1.03", ratio <= 1.03)  # fmt: skip


def closure(root: Array, trials: int) -> None:
    """Item 4: pairs that close triangles add nothing and claim nothing."""
    at = (0, 150, 157, 172)  # ms: PAN, B1, B0, B2
    sets = {
        3: ((0, 3), (1, 2), (2, 3)),
        4: ((0, 3), (1, 3), (1, 2), (2, 3)),
        6: ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)),
    }
    k = np.arange(0, COUNT - at[-1], EVERY)
    claimed: dict[int, float] = {}
    for number, pairs in sets.items():
        rng = np.random.default_rng(400)
        scores, variances = [], []
        for _ in range(-(-trials // 3)):
            x = draw(rng, root)
            noise = 0.03 / np.sqrt(2.0) * rng.normal(size=(4, len(k), 3))
            data = []
            for a, b in pairs:
                values = x[k + at[b]] - x[k + at[a]] + noise[b] - noise[a]
                data.append(
                    pair((k + at[a]) * STEP, (at[b] - at[a]) * STEP, values, 0.03, (a, b), np.arange(len(k)))
                )
            motion = smooth(data, EPOCHS, prior=PRIOR, grid_step=STEP)
            variances.append(float(np.mean(np.einsum("nii->ni", motion.covariance))))
            error = motion.angles - centred(x)
            scores += [nees(axis_posterior(data, a, PRIOR), error[:, a], EVERY) for a in range(3)]
        claimed[number] = float(np.sqrt(np.mean(variances)))
        mean = float(np.mean(scores))
        detail = f"(claimed sigma {claimed[number]:.4f})"
        row("4", f"NEES/dof with {number} pairs of 4 images {detail}", f"{mean:.3f}",
            "0.95-1.05", 0.95 <= mean <= 1.05)  # fmt: skip
    change = max(abs(claimed[n] / claimed[3] - 1.0) for n in (4, 6))
    row(
        "4",
        "change of the claimed sigma from 3 to 4 and 6 pairs",
        f"{100 * change:.3f} %",
        "< 2 %",
        change < 0.02,
    )


def gaps(root: Array, trials: int) -> None:
    """Item 5: bridged with grown sigma."""
    for gap, limit in ((0.05, 0.041), (0.2, 0.130)):
        rng = np.random.default_rng(500)
        errors, variances = [], []
        for _ in range(-(-trials // 3)):
            x = draw(rng, root)
            motion = smooth(measure(rng, x, 0.03, gap), EPOCHS, prior=PRIOR, grid_step=STEP)
            errors.append(motion.angles - centred(x))
            variances.append(np.einsum("nii->ni", motion.covariance))
        error = np.concatenate(errors)
        sigma = np.sqrt(np.mean(variances, axis=(0, 2)))
        inside = np.abs(EPOCHS - 0.5 * COUNT * STEP) < 0.4 * gap
        grown = float(sigma[inside].mean() / sigma[~inside].min())
        good = rms(error) <= limit and bool(np.isfinite(error).all())
        row(
            "5",
            f"gap {1e3 * gap:.0f} ms: rms (posterior {rms(sigma):.4f})",
            f"{rms(error):.4f}",
            f"<= {limit}",
            good,
        )
        row(
            "5",
            f"gap {1e3 * gap:.0f} ms: sigma in the gap over the best elsewhere",
            f"{grown:.1f} x",
            "> 1.5 x",
            grown > 1.5,
        )


def speed() -> None:
    """Item 7: linear growth, sigma(t) included."""
    rng = np.random.default_rng(0)
    seconds = {}
    for count in (2000, 8000, 16000, 32000):
        data = []
        for lag in LAGS:
            k = np.arange(count - lag)
            data.append(pair(k * STEP, lag * STEP, rng.normal(size=(len(k), 3)), 1.0))
        best = np.inf
        for _ in range(3):
            start = time.process_time()
            smooth(data, np.arange(count) * STEP, prior=PRIOR, grid_step=STEP)
            best = min(best, (time.process_time() - start) / 3.0)
        seconds[count] = best
    good = seconds[32000] < 0.5
    row(
        "7",
        "32000 epochs, 4 pairs, one axis, sigma(t) included, one core",
        f"{seconds[32000]:.2f} s",
        "< 0.5 s",
        good,
    )
    growth = seconds[32000] / seconds[8000]
    listed = ", ".join(f"{n}: {1e3 * s:.0f} ms" for n, s in seconds.items())
    row("7", f"time for 4 x the epochs ({listed})", f"{growth:.1f} x", "~ 4 x (< 5)", growth < 5.0)


def real_jitter() -> None:
    """Item 10: the HiRISE curve under two layouts, and single sinusoids."""
    path = Path(os.path.expandvars("$SIGHTLINE_DATA")) / "hirise_jitter_psp008469" / "mroJitter.txt"
    if not path.exists():
        row("10", f"{path.name} of the data set (set SIGHTLINE_DATA)", "not found", "found", False)
        return
    table = np.loadtxt(path)
    t = table[:, 2] - table[0, 2]
    curve = np.column_stack([table[:, 0], table[:, 1], np.zeros(len(t))])
    zy3 = np.array([0.0, 0.1216, 0.2240, 0.3264])  # 152, 128 and 128 lines of 0.8 ms between the bands
    found = incommensurate(t[1] - t[0], float(np.ptp(zy3)))
    shown = " / ".join(f"{1e3 * position:.1f}" for position in found)
    layouts = {
        "ZY-3, six pairs": (six_pairs(zy3), 0.020),
        f"`sightline layout`, six pairs of {shown} ms": (six_pairs(found), 0.025 / 1.2),
        "S1 lags 172.2, 22.2, 7.4, 14.8 ms": (
            [(0.0, 0.1722), (0.15, 0.1722), (0.15, 0.1574), (0.1574, 0.1722)],
            0.035,
        ),
    }
    for name, (pairs, bound) in layouts.items():
        errors, variances = [], []
        for seed in range(3):
            data = sampled(np.random.default_rng(seed), t, curve, pairs)
            motion = smooth(data, t)
            errors.append((motion.angles - centred(curve))[:, :2])
            variances.append(np.einsum("nii->ni", motion.covariance)[:, :2])
        error, sigma = np.concatenate(errors), np.sqrt(np.concatenate(variances))
        worst = float(np.max(np.abs(error) / sigma))
        own = rms(sigma)
        detail = f"the layout's bound {bound:.3f} (own posterior {own:.4f}), px"
        row("10", f"{name}: rms against {detail}", f"{rms(error):.4f}",
            f"<= {1.2 * bound:.3f}", rms(error) <= 1.2 * bound)  # fmt: skip
        row(
            "10",
            f"{name}: largest error {np.abs(error).max():.3f} px, in sigma(t)",
            f"{worst:.1f}",
            "<= 5",
            worst <= 5.0,
        )
    sinusoids(t, six_pairs(zy3))


def incommensurate(step: float, span: float) -> Array:
    """Four places (s) with the most information from 5 to 100 Hz over just this span, found by `layout`."""
    from sightline.applications.focal_plane import FULL_SPAN, FocalPlane, choose_layout

    plane = FocalPlane(1e6, step, 1.0 / step, (0.05,) * 4, span_px=span / step)
    choice = choose_layout(plane, (5.0, 100.0), count=1)
    return next(layout.positions for layout in choice.ranked if layout.name == FULL_SPAN)


def six_pairs(positions: Array) -> list[tuple[float, float]]:
    """All pairs of four places."""
    return [(positions[a], positions[b]) for a in range(4) for b in range(a + 1, 4)]


def sampled(
    rng: np.random.Generator, t: Array, curve: Array, pairs: Sequence[tuple[float, float]]
) -> list[AngleDifferences]:
    """Differences of a sampled curve with 0.1 px of noise per sample and pair."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(t, curve)
    data = []
    for a, b in pairs:
        epochs = t[(t + a >= t[0]) & (t + b <= t[-1])]
        values = spline(epochs + b) - spline(epochs + a) + 0.1 * rng.normal(size=(len(epochs), 3))
        data.append(pair(epochs + a, b - a, values, 0.1))
    return data


def sinusoids(t: Array, pairs: Sequence[tuple[float, float]]) -> None:
    """A single sinusoid of 1 px: amplitude and frequency read off the recovered motion."""
    from scipy.optimize import least_squares

    frequencies = (0.67, 3.0, 6.0)
    curve = np.column_stack([np.sin(2.0 * np.pi * f * t + 0.4) for f in frequencies])
    motion = smooth(sampled(np.random.default_rng(7), t, curve, pairs), t)
    for axis, f in enumerate(frequencies):
        x = motion.angles[:, axis]

        def misfit(p: Array, x: Array = x) -> Array:
            phase = 2.0 * np.pi * p[0] * t
            return p[1] * np.sin(phase) + p[2] * np.cos(phase) + p[3] - x

        spectrum = np.abs(np.fft.rfft(x, 16 * len(x)))
        guess = np.fft.rfftfreq(16 * len(x), t[1] - t[0])[np.argmax(spectrum)]
        p = least_squares(misfit, [guess, 0.5, 0.5, 0.0]).x
        amplitude, frequency = abs(np.hypot(p[1], p[2]) - 1.0), abs(p[0] / f - 1.0)
        row(
            "10",
            f"sinusoid of 1 px at {f} Hz: amplitude error",
            f"{100 * amplitude:.2f} %",
            "<= 1 %",
            amplitude <= 0.01,
        )
        row(
            "10",
            f"sinusoid of 1 px at {f} Hz: frequency error",
            f"{100 * frequency:.4f} %",
            "<= 0.1 %",
            frequency <= 1e-3,
        )


def toneless(count: int) -> None:
    """Motions without any tone: how often one is found at a stated probability, the spectrum known or found.

    Series of 0.5 s, 150 periods of the highest frequency that is looked at. A share must lie where a binomial
    law of the stated probability has it in 99 of 100 runs; where the spectrum is found in the same data, it
    takes some of what a tone would, so that a share may be smaller.
    """
    from scipy.stats import binom

    short = 500
    spectrum = Spectrum(PRIOR.components[:2])
    root = np.linalg.cholesky(
        toeplitz(spectrum.autocovariance(STEP * np.arange(short))) + 1e-10 * np.eye(short)
    )
    rng, sigma = np.random.default_rng(1100), 0.03

    def drawn() -> list[DifferenceSeries]:
        x = root @ rng.normal(size=short)
        out = []
        for lag in (90, 22, 7, 15):
            k = np.arange(0, short - lag, EVERY)
            values = x[k + lag] - x[k] + sigma * rng.normal(size=len(k))
            out.append(
                DifferenceSeries(k * STEP, np.full(len(k), lag * STEP), values, np.full(len(k), sigma**2))
            )
        return out

    scaled_spectrum = spectrum.scaled(1.0 / sigma)

    def search_of(series: list[DifferenceSeries]) -> Search:
        scaled = [replace(s, values=s.values / sigma, variance=s.variance / sigma**2) for s in series]
        equations = series_equations(scaled, Grid(0.0, STEP, short), spectrum=scaled_spectrum)
        return Search(equations, 1.0, False, STEP * short, spread=spread_of(scaled, HIGHEST / STEP))

    def strongest(series: list[DifferenceSeries]) -> float:
        found = search_of(series).unexplained_tones(NoiseModel.of(scaled_spectrum), 0.999)
        return found[0][1] if found else 0.0

    known = np.array([strongest(drawn()) for _ in range(count)])
    fitted = max(count // 50, 1)
    found = np.array(
        [max(fit_spectrum(drawn(), false_alarm=0.1).significance, default=0.0) for _ in range(fitted)]
    )
    search = search_of(drawn())
    for chance in (0.1, 0.01, 0.001):
        least = search.gain_of_chance(chance)
        for what, gains in (("known", known), ("found in the data", found)):
            number = int((gains > least).sum())
            low, high = (int(x) for x in binom.interval(0.99, len(gains), chance))
            low = low if what == "known" else 0
            row("tones", f"series without tones, spectrum {what}: a tone at a stated probability of {chance}",
                f"{number} of {len(gains)}", f"{low} to {high}", low <= number <= high)  # fmt: skip


def toneless_strips(count: int) -> None:
    """Rendered strips of the nominal motion without its tones: how many are said to have one at p < .01."""
    parts = tuple(part for part in nominal_profile().roll if not isinstance(part, ToneJitter))
    profile, taken = JitterProfile(parts, parts, parts), 0
    for seed in range(500, 500 + count):
        strip = line_of_sight_case("nominal", seed, profile=profile, lines=1000, columns=300)
        said = recover_line_of_sight(strip.as_given(), Plane(0.0)).to_dict()
        by_axis = [*said["tones"].values(), *said["tones_hardly_seen"].values()]
        taken += any(tone["false_alarm"] < 0.01 for tones in by_axis for tone in tones)
    row("tones", "strips without tones: with one at a stated probability below 0.01", f"{taken} of {count}",
        "<= 1 of 30", 30 * taken <= count)  # fmt: skip


def main() -> None:
    """Run all targets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--trials", type=int, default=40, help="series per target with the prior known")
    parser.add_argument("--blind", type=int, default=12, help="series with everything found in the data")
    parser.add_argument("--toneless", type=int, default=10000, help="series without any tone")
    parser.add_argument("--strips", type=int, default=30, help="rendered strips without any tone")
    options = parser.parse_args()
    toneless(options.toneless)
    toneless_strips(options.strips)
    root = np.linalg.cholesky(dense_covariance() + 1e-12 * np.eye(COUNT))
    known_prior(root, options.trials)
    blind_prior(root, options.blind)
    closure(root, options.trials)
    gaps(root, options.trials)
    speed()
    real_jitter()


if __name__ == "__main__":
    gates.run(main, __file__)
