"""A tone through time, and two tones that stand closer than one over the length of the strip.

Not here: finding tones (``tones.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtrc

from sightline.geometry.trajectory import Motion
from sightline.motion.tones import AXES, DetectedTone, evenly_detrended, hann

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pieces that a strip is cut into at most, overlapping by half.
PIECES = 24
#: Periods that a piece holds at least, and how many widths of its own resolution the next tone is away.
PERIODS, APART = 6.0, 3.0
#: Frequencies about a tone (in 1/T) among which a second one is sought.
BASEBAND = 24
#: Probability that a lone tone is taken for two.
FALSE_ALARM = 1e-3
#: Steps of the search for two frequencies, in 1/T.
SEARCH_STEP = 0.125


@dataclass(frozen=True, eq=False)
class ToneHistory:
    """Amplitude of one tone against time.

    Attributes
    ----------
    tone : DetectedTone
    t : (S,)
        s; middles of the pieces.
    amplitude : (S,)
        rad; of the sine in each piece.
    sigma : float
        rad; of each.
    phase : (S,)
        rad; against a steady sine of the tone's frequency, unwrapped.
    variation : float
        rad; rms of the complex amplitude about its mean beyond what the noise explains; 0 for a steady tone.
    steady_chance : float
        Probability that a steady tone scatters as much.
    """

    tone: DetectedTone
    t: Array
    amplitude: Array
    sigma: float
    phase: Array
    variation: float
    steady_chance: float


@dataclass(frozen=True)
class TonePair:
    """Two tones within the resolution 1/T of the strip, separated by fitting both.

    Attributes
    ----------
    axis : str
    frequencies, sigma_frequencies : (float, float)
        Hz.
    amplitudes, sigma_amplitudes : (float, float)
        rad; of the sines.
    misfit : float
        Mean squared residual over what the noise explains; near 1 where two steady tones are the whole story.
    """

    axis: str
    frequencies: tuple[float, float]
    sigma_frequencies: tuple[float, float]
    amplitudes: tuple[float, float]
    sigma_amplitudes: tuple[float, float]
    misfit: float


def tone_histories(motion: Motion, tones: Sequence[DetectedTone]) -> tuple[ToneHistory, ...]:
    """Short-time amplitude of every tone, in pieces as short as its period and its neighbours allow.

    Notes
    -----
    All tones of an axis together are fitted to pieces that overlap by half, Hann-weighted: alone, a weak tone
    would hold what leaks from a strong one, more in one piece than in the next, and seem to vary. A tone
    whose sigma over the whole strip T is s has ``s sqrt(T / L)`` in a piece of length L.
    """
    step, x = evenly_detrended(motion)
    duration = step * len(x)
    out = []
    for tone in tones:
        others = [o.frequency for o in tones if o.axis == tone.axis and o is not tone]
        near = [abs(f - tone.frequency) for f in others]
        length = max(PERIODS / tone.frequency, APART / min(near, default=math.inf), 2.0 * duration / PIECES)
        if 2.0 * length > duration:
            continue
        size = round(length / step)
        starts = np.arange(0, len(x) - size + 1, size // 2)
        series, window = x[:, AXES.index(tone.axis)], hann(size)
        tau = step * np.arange(len(x))
        phase = 2.0 * np.pi * np.outer(tau, [tone.frequency, *others])
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        value = np.array([_amplitude(series[s : s + size], waves[s : s + size], window) for s in starts])
        sigma = tone.sigma_amplitude * math.sqrt(duration / (size * step))
        middles = np.asarray(motion.span[0] + tau[starts] + 0.5 * size * step, dtype=np.float64)
        out.append(_history(tone, middles, value, sigma))
    return tuple(out)


def _amplitude(x: Array, waves: Array, window: Array) -> complex:
    """Complex amplitude of the first of M sinusoids, whose cosines and sines are `waves` (n, 2 M), in `x`."""
    root = np.sqrt(window)
    found = np.linalg.lstsq(waves * root[:, None], x * root, rcond=1e-3)[0]
    return complex(found[0], -found[waves.shape[1] // 2])


def _history(tone: DetectedTone, t: Array, value: Complex, sigma: float) -> ToneHistory:
    """Amplitude and phase of complex values, and whether they scatter more than their noise."""
    phase = np.unwrap(np.angle(value))
    # a frequency that is a little off turns the phase evenly: that is no variation
    slope = np.polyfit(t - t.mean(), phase, 1, w=np.abs(value)) if len(t) > 2 else np.zeros(2)
    steadied = value * np.exp(-1j * slope[0] * (t - t.mean()))
    # pieces that overlap by half share a sixth of their noise's variance: every second one stands alone
    alone = steadied[::2]
    squares = float(np.sum(np.abs(alone - alone.mean()) ** 2)) / sigma**2
    freedom = max(2 * (len(alone) - 1) - 1, 1)
    spread = float(np.mean(np.abs(steadied - steadied.mean()) ** 2))
    excess = max(spread - 2.0 * sigma**2 * (1.0 - 1.0 / max(len(alone), 2)), 0.0)
    chance = float(chdtrc(freedom, squares))
    return ToneHistory(
        tone, t, np.abs(value), sigma, phase - slope[0] * (t - t.mean()), math.sqrt(excess), chance
    )


def close_pairs(motion: Motion, tones: Sequence[DetectedTone]) -> tuple[TonePair, ...]:
    """Tones that are two: fitted together where the data are good enough.

    Notes
    -----
    The frequencies about a tone (+- 12/T, other tones removed) hold K complex samples of known noise. Two
    steady sinusoids are taken where they leave less than one by more than chance (`FALSE_ALARM` among the
    frequency pairs tried), and no more than noise: a tone that swells or wanders is no pair.
    """
    step, x = evenly_detrended(motion)
    found = []
    for tone in tones:
        others = [o for o in tones if o.axis == tone.axis and o is not tone]
        series = _without(x[:, AXES.index(tone.axis)], step, others)
        pair = _split(series, step, tone)
        if pair is not None:
            found.append(pair)
    return tuple(found)


def _without(x: Array, step: float, tones: Sequence[DetectedTone]) -> Array:
    """The series less the best sinusoids at the tones' frequencies."""
    if not tones:
        return x
    t = step * np.arange(len(x))
    phase = 2.0 * np.pi * np.outer(t, [tone.frequency for tone in tones])
    waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
    return np.asarray(x - waves @ np.linalg.lstsq(waves, x, rcond=None)[0])


def _split(x: Array, step: float, tone: DetectedTone) -> TonePair | None:
    """Two tones in place of one, if they explain what one does not and leave only noise."""
    duration = step * len(x)
    y, t, origin = _baseband(x, step, tone.frequency)
    # Hann's weighting costs a half: sigma_amplitude^2 = 1.5 S / T; complex samples hold 2 S K / T
    density = tone.sigma_amplitude**2 * duration / 1.5
    # in units of the noise of each real number
    unit = math.sqrt(density * len(y) / duration)
    y = y / unit
    spread = np.arange(-2.0, 2.0 + SEARCH_STEP / 2, SEARCH_STEP) / duration + (tone.frequency - origin)
    one = min(_left(y, t, np.array([f]))[0] for f in spread)
    pairs = [(f, g) for k, f in enumerate(spread) for g in spread[k + 2 :]]
    lefts = [_left(y, t, np.array(pair))[0] for pair in pairs]
    best = pairs[int(np.argmin(lefts))]
    fit = least_squares(_residuals, np.array(best), x_scale=1.0 / duration, args=(y, t))
    two, amplitude = _left(y, t, fit.x)
    threshold = 2.0 * math.log(len(pairs) / FALSE_ALARM)
    misfit = two / (2.0 * len(y) - 6.0)
    # the mean of 2 K squares of unit noise scatters by sqrt(1 / K)
    if one - two < threshold or misfit > 1.0 + 3.0 / math.sqrt(len(y)):
        return None
    sigma = np.sqrt(np.diag(_covariance(y, t, fit.x, amplitude)))
    order = np.argsort(fit.x)
    f, a = fit.x[order] + origin, unit * np.abs(amplitude[order])
    sf, sa = sigma[:2][order], unit * sigma[2:][order]
    return TonePair(
        tone.axis,
        (float(f[0]), float(f[1])),
        (float(sf[0]), float(sf[1])),
        (float(a[0]), float(a[1])),
        (float(sa[0]), float(sa[1])),
        float(misfit),
    )


def _baseband(x: Array, step: float, near: float) -> tuple[Complex, Array, float]:
    """Complex samples (K,) of the band about a frequency, their times (s) and the frequency at its middle."""
    n = len(x)
    whole = np.fft.fft(x) * 2.0 / n
    centre = round(near * n * step)
    half = BASEBAND // 2
    bins = np.arange(max(centre - half, 1), min(centre + half, n // 2 - 1))
    # the samples are those of the tones times their amplitude: the transform of a sine sums to it
    t = n * step * np.arange(len(bins)) / len(bins)
    origin = bins[0] / (n * step)
    y = np.fft.ifft(whole[bins]) * len(bins)
    return y, t, origin


def _waves(t: Array, f: Array) -> Complex:
    """Sinusoids (K, M) of baseband frequencies `f` as the band's sharp edges show them."""
    k, duration = len(t), t[1] * len(t)
    bins = np.arange(k)
    # a sinusoid between two bins spreads over all of them: Dirichlet's kernel, cut to the band
    place = np.asarray(f)[None, :] * duration - bins[:, None]
    kernel = np.sinc(place) * np.exp(1j * np.pi * place)
    return np.asarray(np.fft.ifft(kernel, axis=0) * k, dtype=np.complex128)


def _left(y: Complex, t: Array, f: Array) -> tuple[float, Complex]:
    """Sum of squares that sinusoids of these frequencies leave, and their complex amplitudes."""
    waves = _waves(t, f)
    amplitude = np.asarray(np.linalg.lstsq(waves, y, rcond=None)[0], dtype=np.complex128)
    return float(np.sum(np.abs(y - waves @ amplitude) ** 2)), amplitude


def _residuals(f: Array, y: Complex, t: Array) -> Array:
    """What sinusoids of these frequencies leave, as real numbers."""
    waves = _waves(t, f)
    left = y - waves @ np.linalg.lstsq(waves, y, rcond=None)[0]
    return np.concatenate([left.real, left.imag])


def _covariance(y: Complex, t: Array, f: Array, amplitude: Complex) -> Array:
    """Covariance (4, 4) of both frequencies and both sizes for unit noise per real sample."""
    waves, h = _waves(t, f), 1e-4 / (t[1] * len(t))
    turned = (_waves(t, f + h) - _waves(t, f - h)) / (2.0 * h) * amplitude
    unit = waves * np.exp(1j * np.angle(amplitude))
    columns = np.concatenate([turned, unit, 1j * unit], axis=1)
    real = np.concatenate([columns.real, columns.imag])
    return np.asarray(np.linalg.inv(real.T @ real)[:4, :4])
