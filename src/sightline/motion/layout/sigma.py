"""Posterior sigma of a motion before any image is taken: what a layout, its noise and the prior allow.

Two ways that check each other. The harmonic one takes each frequency by itself,
``1 / (1 / P + J)``, as if the strip had no ends; it costs next to nothing. The smoother solves the strip of a
given length with its ends, where some images have not begun and others have stopped.

Not here: the information J (``information.py``).
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.estimation.evidence import posterior
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.series import DifferenceSeries, Grid, series_equations
from sightline.estimation.series_kernels import TAPS
from sightline.estimation.split import split
from sightline.motion.estimators.smoother import ORDER, reduced
from sightline.motion.layout.information import RowNoise, information
from sightline.motion.layout.search import Candidates
from sightline.motion.observability import window_gain

Array = NDArray[np.float64]

#: Samples per narrowest feature (a tone's width, 1 / span, 1 / duration) of the spectra integrated here.
_PER_FEATURE = 6.0
#: Most frequencies of one integral.
_MOST = 40_000
#: Places among which one detector is first moved for a lesser sigma.
SIGMA_PLACES = 120


def posterior_psd(frequency: ArrayLike, positions: ArrayLike, noise: RowNoise, prior: Spectrum) -> Array:
    """One-sided power spectral density (px^2/Hz) of what remains unknown of a motion, (F,).

    Notes
    -----
    ``1 / (1 / P + J / (2 period))`` for the one-sided prior P: J / period is the inverse of a two-sided
    density. Holds below half the rate of rows, and away from the ends of a strip.
    """
    f = np.asarray(frequency, dtype=np.float64)
    return np.asarray(1.0 / (1.0 / prior.psd(f) + information(f, positions, noise) / (2.0 * noise.period)))


def harmonic_sigma(
    positions: ArrayLike,
    noise: RowNoise,
    prior: Spectrum,
    duration: float,
    *,
    passband: tuple[float, float] | None = None,
) -> float:
    """Posterior sigma (px) of a motion less its mean over `duration` (s), ends left out of account.

    With `passband` (Hz), only the part of the motion within it.

    Notes
    -----
    ``integral of S (1 - sinc^2 f T) df`` is the variance about the mean over T of an error of spectrum S.
    Motion above half the rate of rows counts as unknown.
    """
    f = quadrature_frequencies(np.asarray(positions), prior, duration, 0.5 / noise.period)
    left = posterior_psd(f, positions, noise, prior)
    if passband is None:
        unseen = max(0.0, prior.sigma**2 - float(np.trapezoid(prior.psd(f), f)))
        kept = left * (1.0 - np.sinc(f * duration) ** 2)
        return math.sqrt(float(np.trapezoid(kept, f)) + unseen)
    inside = np.clip(f, *passband)  # samples outside collapse on the ends and weigh nothing
    return math.sqrt(float(np.trapezoid(posterior_psd(inside, positions, noise, prior), inside)))


def quadrature_frequencies(positions: Array, prior: Spectrum, duration: float, highest: float) -> Array:
    """Frequencies (Hz) from 0 to `highest` fine enough for every feature of prior, layout and duration."""
    features = [1.0 / duration, 1.0 / max(float(np.ptp(positions)), 1e-9)]
    features += [c.bandwidth for c in prior.components if isinstance(c, Tone)]
    count = min(_MOST, math.ceil(_PER_FEATURE * highest / min(features)))
    even = np.linspace(0.0, highest, max(count, 64) + 1)
    fine = [even]
    for tone in prior.tones:  # a line narrower than the even step keeps its variance
        reach = np.sinh(np.linspace(-8.0, 8.0, 161)) * tone.bandwidth * 0.05
        fine.append(tone.frequency + reach)
    drift = [c.corner for c in prior.components if isinstance(c, Matern)]
    if drift:
        fine.append(np.geomspace(1e-3 * min(drift), highest, 400))
    every = np.unique(np.concatenate(fine))
    return every[(every >= 0.0) & (every <= highest)]


def least_sigma(
    start: ArrayLike,
    candidates: Candidates,
    noise: RowNoise,
    prior: Spectrum,
    duration: float,
) -> Array:
    """A layout moved, one detector at a time, to the least harmonic posterior sigma; (n,) s, from 0.

    The first detector stays; of the others each goes in turn to the best of some `SIGMA_PLACES` places, then
    to the best near it, until none gains.
    """
    at = np.array(start, dtype=np.float64)
    f = quadrature_frequencies(candidates.t, prior, duration, 0.5 / noise.period)
    share = np.gradient(f) * (1.0 - np.sinc(f * duration) ** 2)
    wanting = 1.0 / prior.psd(f)
    w, whole = noise.weights[:, None] * noise.seen(f), noise.weights.sum()
    power = noise.weights @ noise.seen(f) ** 2
    seen = window_gain(f, noise.window) ** 2 / (2.0 * noise.period)

    def variances(rest: Array, weight: Array, places: Array) -> Array:
        total = rest + weight * np.exp(2j * np.pi * f * places[:, None])
        return np.asarray((share / (wanting + seen * (power - np.abs(total) ** 2 / whole))).sum(axis=1))

    best, moved = np.inf, True
    while moved:
        moved = False
        for k in range(1, len(at)):
            others = np.delete(at, k)
            rest = (np.delete(w, k, axis=0) * np.exp(2j * np.pi * others[:, None] * f)).sum(axis=0)
            places = _open_places(candidates, others)
            stride = max(1, len(places) // SIGMA_PLACES)
            coarse = places[::stride]
            near = int(np.argmin(variances(rest, w[k], coarse))) * stride
            close = places[max(0, near - stride) : near + stride + 1]
            values = variances(rest, w[k], close)
            if values.min() < best * (1.0 - 1e-6):
                best, moved = float(values.min()), True
                at[k] = close[int(np.argmin(values))]
    return at


def _open_places(candidates: Candidates, others: Array) -> Array:
    """Candidate times that keep their distance from all others and stand behind the first."""
    apart = np.abs(candidates.t[:, None] - others).min(axis=1) >= candidates.min_spacing * (1.0 - 1e-9)
    return np.asarray(candidates.t[apart & (candidates.t > others[0])])


def smoother_sigma(
    positions: ArrayLike, noise: RowNoise, prior: Spectrum, duration: float, *, step: float | None = None
) -> tuple[Array, Array]:
    """Posterior sigma along a strip, by the banded smoother of one axis.

    Parameters
    ----------
    positions : (n,)
        s; of the detectors.
    noise : RowNoise
    prior : Spectrum
        px.
    duration : float
        s; every detector exposes from 0 to here.
    step : float, optional
        s; of the smoother's grid, by default the period of rows. Motion that the grid cannot hold counts as
        an error of each match.

    Returns
    -------
    t, sigma : (N,)
        s and px, at the rows (or at the nodes, where they are further apart), of the motion less its mean.
    """
    series = pair_rows(positions, noise, duration)
    step = noise.period if step is None else step
    margin = 0.5 * TAPS * step
    grid = Grid.covering(-margin, duration + margin, step)
    equations = series_equations(series, grid, spectrum=prior)
    apart = split(prior, grid.step, ORDER, grid.count, width=len(equations.band) - 1)
    believed = prior.autoregressive(grid.step, ORDER, grid.count) if apart is None else apart
    every = max(step, noise.period)
    t = np.arange(0.0, duration + 0.5 * every, every)
    _, variance = reduced(posterior(equations, believed), t)
    return t, np.sqrt(variance)


def pair_rows(positions: ArrayLike, noise: RowNoise, duration: float) -> list[DifferenceSeries]:
    """Every pair's rows of matches in a strip of `duration` (s), all differences zero.

    A row of ground that passes all n detectors is a patch in every pair: the smoother then shares the errors
    of the images. Near the ends only those detectors take part that are exposing.
    """
    p = np.asarray(positions, dtype=np.float64)
    order = np.argsort(p)
    first = math.ceil((0.0 - p[order[-1]]) / noise.period)
    rows = np.arange(first, math.floor((duration - p[order[0]]) / noise.period) + 1)
    tdi = noise.tdi or (0.0,) * len(p)
    half = 0.5 * (noise.window + max(tdi))
    out = []
    for a, b in combinations(order.tolist(), 2):
        t_a, t_b = rows * noise.period + p[a], rows * noise.period + p[b]
        seen = (t_a >= half) & (t_b <= duration - half)
        t, count = t_a[seen], int(seen.sum())
        variance = np.full(count, noise.sigma_px[a] ** 2 + noise.sigma_px[b] ** 2)
        lag = np.full(count, p[b] - p[a])
        patch = (rows[seen] - first).astype(np.int64)
        both = (tdi[a], tdi[b])
        out.append(DifferenceSeries(t, lag, np.zeros(count), variance, (a, b), noise.window, patch, both))
    return [series for series in out if len(series.t)]
