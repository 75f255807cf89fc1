"""Restoring a motion in the frequency domain: what S1's inverse and Wiener filters share.

Differences are put on an even grid, a polynomial takes the low frequencies, a filter per pair
restores the rest, and the error is what S1 says it is: ``E = (F - 1) Theta + H B``, bias and noise.

Not here: the choice of the filter (``estimators/inverse.py``, ``estimators/wiener.py``, ``combine.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import EstimationError
from sightline.geometry.checks import as_times
from sightline.geometry.interpolation import interpolate
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.polynomial import PolynomialFit, checked_differences, fit_polynomial
from sightline.motion.observability import transfer

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The restored series is made this many times finer than the differences before it is interpolated in time.
OVERSAMPLING = 8

#: Rounds of the motion's spectrum estimated from its own restoration.
SPECTRUM_ROUNDS = 12

#: Steps over which the contradiction between differences and restored motion is averaged.
CONTRADICTION_EPOCHS = 21

#: Constant k of the flat filter that gives the first guess of the motion's spectrum.
FIRST_K = 0.1


@dataclass(frozen=True, eq=False)
class EvenPair:
    """Differences of one pair on an even grid, gaps bridged by straight lines.

    Attributes
    ----------
    start, step, lag : float
        s.
    angles : (n, 3)
        rad.
    variance : (3,)
        rad^2; mean over the epochs: a bridged one is in error by as much as the differences vary.
    measured : (n,) bool
        False where bridged.
    """

    start: float
    step: float
    lag: float
    angles: Array
    variance: Array
    measured: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Bins:
    """What a filter is chosen from, at each frequency of the transform.

    Attributes
    ----------
    frequency : (F,)
        Hz, from 0 to Nyquist.
    gain : (M, F) complex
        G of each pair.
    noise_psd : (3, M)
        One-sided, rad^2/Hz, of each axis and pair: white.
    motion_psd : (3, F)
        One-sided, rad^2/Hz, of the motion that the polynomial left.
    """

    frequency: Array
    gain: Complex
    noise_psd: Array
    motion_psd: Array


Filter = Callable[[Bins], Complex]
"""From bins to the filters H of every axis and pair, (3, M, F)."""


def even_pair(differences: AngleDifferences, step: float) -> EvenPair:
    """One pair on an even grid of `step` seconds.

    Differences that fall into one step are averaged with their weights. A difference of another lag than
    the pair's median is scaled to it: S1's synchronisation, first case, which is right for slow motion only.
    """
    t, lag = differences.t, float(np.median(differences.lag))
    values = differences.angles * (lag / differences.lag)[:, None]
    variance = np.einsum("nii->ni", differences.covariance)
    start = float(t[0])
    cell = np.rint((t - start) / step).astype(np.intp)
    count = int(cell[-1]) + 1
    weight = np.stack([np.bincount(cell, 1.0 / v, count) for v in variance.T], axis=1)
    total = np.stack(
        [np.bincount(cell, x / v, count) for x, v in zip(values.T, variance.T, strict=True)], axis=1
    )
    members = np.bincount(cell, minlength=count)
    measured = members > 0
    when = np.bincount(cell, t, count)[measured] / members[measured]
    mean = total[measured] / weight[measured]
    grid = start + step * np.arange(count)
    angles = np.stack([np.interp(grid, when, x) for x in mean.T], axis=1)
    bridged = 1.0 - measured.mean()
    own = (1.0 / weight[measured]).mean(axis=0)
    return EvenPair(start, step, lag, angles, (1.0 - bridged) * own + bridged * mean.var(axis=0), measured)


def common_step(differences: Sequence[AngleDifferences]) -> float:
    """Usual time (s) between the epochs of the differences."""
    gaps = np.concatenate([np.diff(np.unique(d.t)) for d in differences])
    gaps = gaps[gaps > 1e-9]
    if gaps.size == 0:
        raise EstimationError("all differences are of one instant; a motion needs at least two epochs")
    return float(np.median(gaps))


def restore(
    differences: Sequence[AngleDifferences],
    t: ArrayLike,
    choose: Filter,
    *,
    degree: int = 5,
    motion_psd: Callable[[Array], Array] | None = None,
) -> Motion:
    """Motion from differences by a polynomial and a filter on what it leaves.

    Parameters
    ----------
    differences : sequence of AngleDifferences
    t : (N,)
        s; where the motion is wanted.
    choose : callable
        Gives the filter of every axis and pair.
    degree : int
        Of the polynomial; 0 for none.
    motion_psd : callable, optional
        Frequency (F,) Hz to one-sided PSD (3, F), rad^2/Hz. Estimated from the data if not given.

    Returns
    -------
    Motion
        Of mean zero over `t`. Its covariance is diagonal: noise through the filter, motion that the filter
        loses, noise of the polynomial, what the differences themselves contradict (record ends, motion
        folded from above the Nyquist frequency), and, where no pair measured, the size of the motion itself.
        A slow error that every pair agrees with is not in it.
    """
    times = as_times(t, "t", increasing=True)
    pairs = checked_differences(differences)
    fit = fit_polynomial(pairs, degree=degree) if degree else None
    step = common_step(pairs)
    even = [even_pair(_without(d, fit), step) for d in pairs]
    origin = min(pair.start for pair in even)
    length = _length(even, step)
    spectra = np.stack([_spectrum(pair, origin, length) for pair in even])
    frequency = np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64)
    gain = np.stack([transfer(frequency, pair.lag) for pair in even])
    noise = 2.0 * step * np.stack([pair.variance for pair in even], axis=1)
    duration = step * max(len(pair.angles) for pair in even)
    psd = motion_psd(frequency) if motion_psd else estimate_psd(spectra, gain, noise, duration, frequency)
    bins = Bins(frequency, gain, noise, psd)
    filters = choose(bins)
    restored = np.einsum("xmf,mfx->fx", filters, spectra, optimize=True)
    angles = _evaluate(restored, length, step, times - origin)
    variance = _variance(bins, filters) + _unmeasured(even, times)[:, None] * _power(bins)
    variance += _contradiction(even, restored, length, times, origin)
    covariance = variance[:, :, None] * np.eye(3)
    if fit is not None:
        angles = angles + fit.angles(times)
        covariance = covariance + fit.relative_covariance(times)
    return Motion(times, angles - angles.mean(axis=0), covariance)


def estimate_psd(
    spectra: Complex, gain: Complex, noise_psd: Array, duration: float, frequency: Array
) -> Array:
    """One-sided PSD (3, F) of the motion, from the differences alone.

    Notes
    -----
    S1, III, leaves "a recursive algorithm" open. Expectation and maximisation: the Wiener filter with the
    last spectrum gives the motion and its posterior variance; their sum, smoothed over neighbouring
    frequencies, is the next spectrum. Where no pair sees, the neighbours decide.
    """
    information = np.einsum("mf,xm->xf", np.abs(gain) ** 2, 1.0 / noise_psd)
    weighted = np.einsum("mf,mfx,xm->xf", np.conj(gain), spectra, 1.0 / noise_psd, optimize=True)
    bins = max(1, round(4.0 / (duration * (frequency[1] - frequency[0]))))
    kernel = np.ones(2 * bins + 1) / (2 * bins + 1)
    plain = np.einsum("mf,mfx->xf", np.conj(gain), spectra) / (np.sum(np.abs(gain) ** 2, axis=0) + FIRST_K)
    level = (np.abs(plain) ** 2).mean(axis=1, keepdims=True) * 2.0 / duration
    psd = np.repeat(np.maximum(level, noise_psd.min(axis=1, keepdims=True)), len(frequency), axis=1)
    for _ in range(SPECTRUM_ROUNDS):
        posterior = 1.0 / (information + 1.0 / psd)
        power = np.abs(weighted * posterior) ** 2 * 2.0 / duration + posterior
        padded = np.pad(power, ((0, 0), (bins, bins)), mode="reflect")
        psd = np.stack([np.convolve(row, kernel, mode="valid") for row in padded])
    return psd


def _without(differences: AngleDifferences, fit: PolynomialFit | None) -> AngleDifferences:
    """The differences less what a polynomial motion explains."""
    if fit is None:
        return differences
    rest = differences.angles - fit.differences(differences.t, differences.lag)
    return replace(differences, angles=rest)


def _length(even: Sequence[EvenPair], step: float) -> int:
    """Length of the transform: twice the record, so that the filters' tails do not wrap onto it."""
    from scipy.fft import next_fast_len

    last = max(pair.start + step * len(pair.angles) + max(pair.lag, 0.0) for pair in even)
    first = min(pair.start + min(pair.lag, 0.0) for pair in even)
    return int(next_fast_len(2 * round((last - first) / step) + 2, real=True))


def _spectrum(pair: EvenPair, origin: float, length: int) -> Complex:
    """(F, 3) spectrum of one pair as a function of time from `origin`, rad s."""
    spectrum = np.fft.rfft(pair.angles, length, axis=0) * pair.step
    frequency = np.fft.rfftfreq(length, pair.step)
    return np.asarray(spectrum * np.exp(-2j * np.pi * frequency * (pair.start - origin))[:, None])


def _evaluate(spectrum: Complex, length: int, step: float, t: Array) -> Array:
    """(N, 3) inverse transform at times `t` (s from the origin), periodic beyond the record."""
    fine = (
        np.fft.irfft(_halved_nyquist(spectrum, length), OVERSAMPLING * length, axis=0) * OVERSAMPLING / step
    )
    fine_step = step / OVERSAMPLING
    margin = 4
    low = int(np.floor(t.min() / fine_step)) - margin
    high = int(np.ceil(t.max() / fine_step)) + margin
    index = np.arange(low, high + 1)
    return np.asarray(
        interpolate(np.asarray(index * fine_step, dtype=np.float64), fine[index % len(fine)], t)
    )


def _halved_nyquist(spectrum: Complex, length: int) -> Complex:
    """A spectrum ready for a longer inverse transform: the Nyquist bin stands for two."""
    if length % 2:
        return spectrum
    out = spectrum.copy()
    out[-1] *= 0.5
    return out


def _power(bins: Bins) -> Array:
    """(3,) rad^2: variance of the motion that the polynomial left."""
    return np.asarray(bins.motion_psd.sum(axis=1) * (bins.frequency[1] - bins.frequency[0]))


def _variance(bins: Bins, filters: Complex) -> Array:
    """(3,) rad^2: S1's error, ``|F - 1|^2 P_theta + |H|^2 P_B`` summed over frequency."""
    lost = np.abs(np.einsum("xmf,mf->xf", filters, bins.gain) - 1.0) ** 2 * bins.motion_psd
    noise = np.einsum("xmf,xm->xf", np.abs(filters) ** 2, bins.noise_psd)
    # At zero frequency the whole constant is lost, which is not part of the relative motion.
    return np.asarray((lost + noise)[:, 1:].sum(axis=1) * (bins.frequency[1] - bins.frequency[0]))


def _contradiction(
    even: Sequence[EvenPair], spectrum: Complex, length: int, t: Array, origin: float
) -> Array:
    """(N, 3) rad^2: half of what the differences miss of those of the restored motion, beyond errors.

    Averaged over all pairs and over `CONTRADICTION_EPOCHS` steps around each instant.
    """
    step = even[0].step
    kernel = np.ones(CONTRADICTION_EPOCHS)
    total, count = np.zeros((length, 3)), np.zeros(length)
    for pair in even:
        start = pair.start - origin + pair.step * np.arange(len(pair.angles))
        ends = _evaluate(spectrum, length, step, np.concatenate([start, start + pair.lag]))
        residual = pair.angles - (ends[len(start) :] - ends[: len(start)])
        excess = 0.5 * (residual**2 - pair.variance) * pair.measured[:, None]
        for shift in (0.0, pair.lag):
            cell = np.rint((start + shift) / step).astype(np.intp) % length
            np.add.at(total, cell, excess)
            np.add.at(count, cell, pair.measured)
    around = np.stack([np.convolve(column, kernel, mode="same") for column in (*total.T, count)], axis=1)
    mean = np.maximum(around[:, :3], 0.0) / np.maximum(around[:, 3:], 1.0)
    return mean[np.rint((t - origin) / step).astype(np.intp) % length]


def _unmeasured(even: Sequence[EvenPair], t: Array) -> Array:
    """(N,) 1 where no pair measured at `t`, neither as its first nor as its second instant; else 0."""
    touched = np.zeros(len(t), dtype=bool)
    for pair in even:
        for shift in (0.0, pair.lag):
            index = np.rint((t - pair.start - shift) / pair.step).astype(np.intp)
            inside = (index >= 0) & (index < len(pair.measured))
            touched[inside] |= pair.measured[index[inside]]
    return np.asarray(~touched, dtype=np.float64)


def strength(bins: Bins) -> Array:
    """(3, F) Hz/rad^2: information of all pairs about the motion, sum of |G|^2 / P_B."""
    return np.asarray(np.einsum("mf,xm->xf", np.abs(bins.gain) ** 2, 1.0 / bins.noise_psd))
