"""Spectrum of a motion, and the tones in it: frequency, amplitude, their sigmas, false-alarm level.

A tone is a peak that stands out of its neighbourhood, whatever the colour of the motion around it.

Not here: tones as part of the prior that recovers the motion (``estimation/likelihood.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.trajectory import Motion

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")

#: Frequencies on each side that give the level around a peak, and those next to it that do not (its own).
NEIGHBOURS = 20
OWN = 2

#: The lowest frequencies belong to the removed parabola and to the Hann window.
FIRST_BIN = 3

#: Fewest frequencies below a peak that give its level. Those above it cannot alone: drift rises towards zero.
FEWEST_BELOW = 3

#: Epochs below which tones are not sought.
SHORTEST = 2 * (2 * (NEIGHBOURS + OWN) + FIRST_BIN)

#: Peaks closer than this many 1/T are one tone whose phase wanders.
MERGE_BINS = 4.0


@dataclass(frozen=True, eq=False)
class MotionSpectrum:
    """One-sided power spectral density of a motion.

    Attributes
    ----------
    frequency : (F,)
        Hz, from 0 to the Nyquist frequency.
    psd : (F, 3)
        rad^2/Hz; roll, pitch, yaw.
    noise_psd : (F, 3) or None
        rad^2/Hz; of the motion's own error, spread evenly over frequency; None where the motion is exact.
    """

    frequency: Array
    psd: Array
    noise_psd: Array | None


@dataclass(frozen=True)
class DetectedTone:
    """A line in the spectrum of one axis.

    Attributes
    ----------
    axis : str
    name : str
        Its frequency, and what it is a multiple of where a lower tone of the same axis fits.
    frequency, sigma_frequency : float
        Hz.
    amplitude, sigma_amplitude : float
        rad; of the sine: sqrt 2 times its rms.
    width : float
        Hz; spread of the peaks that were counted as this tone; 0 for a steady one.
    false_alarm : float
        Probability that the axis shows so strong a peak, anywhere, without any tone; beside the error of the
        motion there, where that is known.
    error_frequency, error_amplitude : float
        Hz, rad; the part of the sigmas that the error of an estimated motion makes: against a sine fitted to
        the true motion of the same strip. 0 for an exact motion.
    """

    axis: str
    name: str
    frequency: float
    sigma_frequency: float
    amplitude: float
    sigma_amplitude: float
    width: float
    false_alarm: float
    error_frequency: float = 0.0
    error_amplitude: float = 0.0


def spectrum(motion: Motion) -> MotionSpectrum:
    """Spectrum of a motion by one Hann-windowed periodogram, a parabola removed first.

    The integral over frequency is the variance; a resolution of 1/T, a scatter of 100 % per frequency.
    """
    step, x = _even(motion)
    window = hann(len(x))
    transform = np.fft.rfft(_detrended(x) * window[:, None], axis=0)
    psd = 2.0 * step * np.abs(transform) ** 2 / np.sum(window**2)
    frequency = np.asarray(np.fft.rfftfreq(len(x), step), dtype=np.float64)
    noise = None
    if motion.covariance is not None:
        level = 2.0 * step * np.einsum("nii->ni", motion.covariance).mean(axis=0)
        noise = np.broadcast_to(level, psd.shape).copy()
    return MotionSpectrum(frequency, psd, noise)


def lowest_sought(motion: Motion) -> float:
    """Hz; from where `detect_tones` looks: eight cycles over the motion; infinite where it is too short."""
    n = len(motion.t)
    if n < SHORTEST:
        return math.inf
    return (FIRST_BIN + FEWEST_BELOW + OWN) * (n - 1) / (n * (motion.span[1] - motion.span[0]))


def detect_tones(
    motion: Motion,
    *,
    false_alarm: float = 1e-3,
    lowest: float | None = None,
    highest: float | None = None,
    limit: int = 12,
    error_psd: Array | None = None,
) -> tuple[DetectedTone, ...]:
    """Tones of every axis, by axis and rising frequency.

    Parameters
    ----------
    motion : Motion
        Exact or estimated; its covariance is not used: sigmas are of the scatter around each peak alone, and
        ``evaluation.tone_errors`` adds the error of an estimated motion.
    false_alarm : float
        Probability, per axis, that a motion without any tone yields one.
    lowest, highest : float, optional
        Hz; where to look. By default from `lowest_sought`, 8/T, to Nyquist; never lower.
    limit : int
        Most peaks taken per axis.
    error_psd : (F, 3), optional
        rad^2/Hz, one-sided; of the motion's error at the frequencies of `spectrum`. It has peaks where the
        motion is hardly seen, which no neighbours tell: the `false_alarm` of a tone is that of its peak
        beside the level around it and this error. What is looked for is what stands out of the level.

    Returns
    -------
    tuple of DetectedTone

    Notes
    -----
    The level around a frequency is the larger of the medians of the 20 frequencies below and above it: that
    of a steep spectrum, or of its corner, is not underestimated. Without a tone the ratio r of a peak to its
    level then exceeds x with probability at most ``N (1 + x/20)^-20`` among N frequencies (the law of an
    exponential over the mean of 20 others; checked by simulation for white and for steep motions). Where
    only m < 20 lower frequencies are left, down to 3, their median may be alone in giving the level, and
    the law is ``N (1 + x/q)^-q``, q = 1 + m/3: by simulation a bound for the median of m neighbours of a
    Hann-windowed periodogram, two of which know hardly more than one. A tone must be the stronger there the
    lower it is: for 1e-3 and a hundred frequencies x > 630 at 8/T, 38 at 19/T, 16 from 25/T on. The
    strongest of the peaks is fitted, removed, and the rest looked at again.
    """
    if not 0.0 < false_alarm < 1.0:
        raise InputError(f"`false_alarm` must be between 0 and 1, got {false_alarm}")
    step, x = _even(motion)
    if len(x) < SHORTEST:
        return ()
    x = _detrended(x)
    bounds = (lowest or 0.0, highest or 0.5 / step)
    found: list[DetectedTone] = []
    for axis, name in enumerate(AXES):
        if x[:, axis].any():
            error = None if error_psd is None else error_psd[:, axis]
            peaks = _peaks(x[:, axis], step, false_alarm, bounds, limit, error)
            found += named([replace(tone, axis=name) for tone in _merged(peaks, 1.0 / (step * len(x)))])
    return tuple(found)


def _peaks(
    x: Array,
    step: float,
    false_alarm: float,
    bounds: tuple[float, float],
    limit: int,
    error: Array | None,
) -> list[DetectedTone]:
    """Peaks of one axis from the strongest on, each removed before the next is sought."""
    rest, tones = x.copy(), []
    for _ in range(limit):
        ratio, level, freedom, frequency = _ratios(rest, step)
        inside = (frequency >= bounds[0]) & (frequency <= bounds[1])
        count = int(np.count_nonzero(inside))
        significant = inside & (_chance(ratio, freedom, count) <= false_alarm)
        if not significant.any():
            break
        best = int(np.argmax(np.where(significant, ratio, 0.0)))
        beside = ratio
        if error is not None:
            # of the frequencies of the whole spectrum those that were looked at; infinite: nothing is seen
            beside = ratio * level / (level + error[-1 - len(level) : -1])
        chance = float(_chance(beside, freedom, count)[best])
        tone, rest = _fitted(rest, step, float(frequency[best]), float(level[best]), chance)
        tones.append(tone)
    return tones


def _chance(ratio: Array, freedom: Array, count: int) -> Array:
    """Probability that one of `count` frequencies has such a ratio to its level (see `detect_tones`)."""
    return np.asarray(np.minimum(1.0, count * (1.0 + ratio / freedom) ** -freedom))


def _ratios(x: Array, step: float) -> tuple[Array, Array, Array, Array]:
    """Ratio of peaks to the level around them, and what is needed to judge it.

    Returns
    -------
    ratio : (F,)
        Periodogram over the level; 0 where a neighbour is higher, so that the flank of a tone outside what
        is looked at is no tone.
    level : (F,)
        Unit^2/Hz, one-sided.
    freedom : (F,)
        The exponent q of the ratio's law: how many independent frequencies the level is worth.
    frequency : (F,)
        Hz.
    """
    window = hann(len(x))
    power = np.abs(np.fft.rfft(x * window)) ** 2 * (2.0 * step / np.sum(window**2))
    frequency = np.asarray(np.fft.rfftfreq(len(x), step), dtype=np.float64)
    power, frequency = power[FIRST_BIN:-1], frequency[FIRST_BIN:-1]
    medians = np.median(sliding_window_view(power, NEIGHBOURS), axis=1)
    at = np.arange(FEWEST_BELOW + OWN, len(power))
    count = np.minimum(at - OWN, NEIGHBOURS)
    few = [float(np.median(power[:m])) for m in range(FEWEST_BELOW, NEIGHBOURS)]
    below = np.concatenate([few, medians[: len(at) - len(few)]])
    above = medians[np.minimum(at + OWN + 1, len(medians) - 1)]
    level = np.maximum(np.maximum(below, above) / math.log(2.0), 1e-300)
    crest = power[at] >= np.maximum(power[at - 1], np.append(power[at[1:]], 0.0))
    freedom = np.where(count < NEIGHBOURS, 1.0 + count / 3.0, NEIGHBOURS)
    return np.where(crest, power[at] / level, 0.0), level, freedom, frequency[at]


def _fitted(x: Array, step: float, near: float, level: float, chance: float) -> tuple[DetectedTone, Array]:
    """The sinusoid near a frequency and what it leaves; `level` is the one-sided PSD around it.

    Notes
    -----
    Maximum of the Hann-weighted transform. With noise of variance s^2 = level / (2 step) per sample its
    errors are ``var A = 2 s^2 sum w^2 / (sum w)^2`` and
    ``var omega = 2 s^2 sum (w tau)^2 / (A sum w tau^2)^2``, tau the time from the middle.
    """
    n = len(x)
    tau, window = step * (np.arange(n) - 0.5 * (n - 1)), hann(n)

    def transform(frequency: float) -> complex:
        return complex(np.sum(window * x * np.exp(-2j * np.pi * frequency * tau)))

    width = 1.0 / (n * step)
    frequency = _maximum(lambda f: abs(transform(f)), near - width, near + width)
    value = transform(frequency) * 2.0 / window.sum()
    variance = level / (2.0 * step)
    amplitude = abs(value)
    sigma_amplitude = math.sqrt(2.0 * variance * np.sum(window**2)) / window.sum()
    spread = math.sqrt(2.0 * variance * np.sum((window * tau) ** 2)) / (amplitude * np.sum(window * tau**2))
    rest = x - np.real(value * np.exp(2j * np.pi * frequency * tau))
    tone = DetectedTone("", "", frequency, spread / (2.0 * math.pi), amplitude, sigma_amplitude, 0.0, chance)
    return tone, rest


def _maximum(function: Callable[[float], float], low: float, high: float) -> float:
    """Place of the maximum of a function with one crest between two places, by golden section."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    a, b = high - golden * (high - low), low + golden * (high - low)
    fa, fb = function(a), function(b)
    for _ in range(48):
        if fa < fb:
            low, a, fa = a, b, fb
            b = low + golden * (high - low)
            fb = function(b)
        else:
            high, b, fb = b, a, fa
            a = high - golden * (high - low)
            fa = function(a)
    return 0.5 * (low + high)


def _merged(tones: Sequence[DetectedTone], resolution: float) -> list[DetectedTone]:
    """Peaks of one wandering tone taken together: powers add, the frequency is their weighted mean."""
    groups: list[list[DetectedTone]] = []
    for tone in sorted(tones, key=lambda tone: tone.frequency):
        if groups and tone.frequency - groups[-1][-1].frequency < MERGE_BINS * resolution:
            groups[-1].append(tone)
        else:
            groups.append([tone])
    return [_together(group) for group in groups]


def _together(group: Sequence[DetectedTone]) -> DetectedTone:
    if len(group) == 1:
        return group[0]
    power = np.array([tone.amplitude**2 for tone in group])
    frequency = np.array([tone.frequency for tone in group])
    mean = float(np.average(frequency, weights=power))
    width = float(np.sqrt(np.average((frequency - mean) ** 2, weights=power)))
    strongest = group[int(np.argmax(power))]
    return replace(
        strongest,
        frequency=mean,
        sigma_frequency=math.hypot(strongest.sigma_frequency, width / math.sqrt(len(group))),
        amplitude=float(np.sqrt(power.sum())),
        width=width,
        false_alarm=min(tone.false_alarm for tone in group),
    )


def named(tones: Sequence[DetectedTone]) -> list[DetectedTone]:
    """Tones of one axis with names: the frequency, and of what lower one it is a multiple within 3 sigma.

    Parameters
    ----------
    tones : sequence of DetectedTone
        By rising frequency.
    """
    out: list[DetectedTone] = []
    for tone in tones:
        name = f"{tone.frequency:.1f} Hz"
        for base in out:
            multiple = round(tone.frequency / base.frequency)
            tolerance = 3.0 * math.hypot(tone.sigma_frequency, multiple * base.sigma_frequency)
            if 2 <= multiple <= 5 and abs(tone.frequency - multiple * base.frequency) < max(tolerance, 1e-9):
                name += f" ({multiple} × {base.frequency:.1f} Hz)"
                break
        out.append(replace(tone, name=name))
    return out


def _even(motion: Motion) -> tuple[float, Array]:
    """Step (s) and angles (n, 3) of a motion on an even grid of as many epochs."""
    n = len(motion.t)
    if n < 2:
        raise InputError("a spectrum needs a motion of two epochs or more, got one")
    step = (motion.span[1] - motion.span[0]) / (n - 1)
    if np.abs(np.diff(motion.t) - step).max() <= 1e-6 * step:
        return step, motion.angles
    grid = np.linspace(motion.span[0], motion.span[1], n)
    return step, motion.at(grid)


def _detrended(x: Array) -> Array:
    """Angles less a parabola."""
    terms = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(x)), min(2, len(x) - 1))
    return np.asarray(x - terms @ np.linalg.lstsq(terms, x, rcond=None)[0])


def evenly_detrended(motion: Motion) -> tuple[float, Array]:
    """Step (s) and angles (n, 3) of a motion on an even grid of as many epochs, less a parabola."""
    step, x = _even(motion)
    return step, _detrended(x)


def hann(n: int) -> Array:
    """Hann window of n samples, periodic about the middle; no weight is zero."""
    return np.asarray(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2)
