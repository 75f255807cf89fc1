"""Errors of the tones of a recovered motion: what the motion's own error adds to the scatter around a peak.

Not here: finding tones (``motion/tones.py``), the error at any frequency (``error_spectrum.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.banded import band_times
from sightline.estimation.search import chance_of_gain
from sightline.motion.results import LineOfSight
from sightline.motion.tones import AXES, DetectedTone, evenly_detrended, hann, named

Array = NDArray[np.float64]

#: A tone is found where its amplitude is so many of its sigmas, and chance beside the motion's error makes
#: one no more often than so; else it is hardly seen.
FOUND_SIGMAS, FOUND_CHANCE = 3.0, 1e-3
#: Width about a blind frequency, in units of one over the length of a strip.
BLIND_WIDTH = 2.0


@dataclass(frozen=True)
class JudgedTones:
    """Tones of a recovered motion, by axis and rising frequency, with the motion's error in their sigmas.

    Attributes
    ----------
    found : tuple of DetectedTone
        Amplitude of 3 sigma or more, and a `false_alarm` of 1e-3 or less.
    hardly_seen : tuple of DetectedTone
        The others: the estimate shrinks what it does not see; there may be no tone, or a larger one.
    """

    found: tuple[DetectedTone, ...]
    hardly_seen: tuple[DetectedTone, ...]


def judged_tones(result: LineOfSight, tones: Sequence[DetectedTone]) -> JudgedTones:
    """Tones with the error of the motion in their sigmas, and which of them are found.

    Parameters
    ----------
    result : LineOfSight
    tones : sequence of DetectedTone
        As ``motion.tones.detect_tones`` finds them in its motion, with the scatter around each peak, their
        probabilities beside the error of it (``error_spectrum.error_psd``).

    Notes
    -----
    Amplitude and frequency of a Hann-weighted fit are, to first order, weighted sums of the motion: with tau
    the time from the middle, w the window and phi the phase of the fitted sine about tau,

    ``dA = 2 sum w cos(omega tau + phi) e / sum w``,
    ``domega = -2 sum w tau sin(omega tau + phi) e / (A sum w tau^2)``,

    e the error of the motion. Their variance under the covariance of the motion (`error_*`) is that against a
    sine fitted to the true motion. That of the scatter around the peak is added: other motion at the tone's
    frequency, by which even the true motion's sine differs from that of its source. Nor is a tone less likely
    to be chance than a sine of that variance in each of its phases makes one of its amplitude.
    """
    wider = _with_error_of_motion(result, tones) if tones else []
    again = [tone for axis in AXES for tone in named([tone for tone in wider if tone.axis == axis])]
    seen = [
        tone.amplitude >= FOUND_SIGMAS * tone.sigma_amplitude and tone.false_alarm <= FOUND_CHANCE
        for tone in again
    ]
    return JudgedTones(
        tuple(tone for tone, found in zip(again, seen, strict=True) if found),
        tuple(tone for tone, found in zip(again, seen, strict=True) if not found),
    )


def _with_error_of_motion(result: LineOfSight, tones: Sequence[DetectedTone]) -> list[DetectedTone]:
    step, angles = evenly_detrended(result.motion)
    # tone by tone: of a long strip weights of all at once are most of what is in memory
    of_each = (_functional_covariance(result, _weights(result, tone, step, angles)) for tone in tones)
    error = np.sqrt([np.diag(covariance) for covariance in of_each]) / [1.0, 2.0 * math.pi]
    return [
        replace(
            tone,
            sigma_amplitude=math.hypot(tone.sigma_amplitude, amplitude),
            sigma_frequency=math.hypot(tone.sigma_frequency, frequency),
            false_alarm=max(tone.false_alarm, _chance(tone.amplitude, tone.sigma_amplitude, amplitude)),
            error_amplitude=amplitude,
            error_frequency=frequency,
        )
        for tone, (amplitude, frequency) in zip(tones, error.tolist(), strict=True)
    ]


def _chance(amplitude: float, *sigmas: float) -> float:
    """Probability that errors of these sigmas of an amplitude make one so large where there is no tone.

    The density of the motion's error is that of an endless strip, less than a strip has within one over its
    length of a frequency where it is blind: of crests there so many are so high (`search.chance_of_gain`).
    """
    gain = 0.5 * amplitude**2 / max(sum(sigma**2 for sigma in sigmas), 1e-300)
    return chance_of_gain(gain, BLIND_WIDTH)


def _weights(result: LineOfSight, tone: DetectedTone, step: float, x: Array) -> Array:
    """(N, 3, 2) weights of the motion, sampled as `x`, in the tone's amplitude and angular frequency."""
    axis = AXES.index(tone.axis)
    n = len(x)
    even = step * (np.arange(n) - 0.5 * (n - 1))
    phase = np.angle(np.sum(hann(n) * x[:, axis] * np.exp(-2j * np.pi * tone.frequency * even)))
    # the motion's own instants, which of frames need not be even
    tau = result.motion.t - np.mean(result.motion.span)
    window = np.sin(np.pi * (tau / (n * step) + 0.5)) ** 2
    turning = np.exp(1j * (2.0 * np.pi * tone.frequency * tau + phase))
    out = np.zeros((n, 3, 2))
    out[:, axis, 0] = 2.0 * window * turning.real / window.sum()
    out[:, axis, 1] = -2.0 * window * tau * turning.imag / (tone.amplitude * np.sum(window * tau**2))
    return out


def _functional_covariance(result: LineOfSight, weights: Array) -> Array:
    """Covariance (K, K) of sums of the motion at its instants with `weights` (N, 3, K)."""
    if result.functional_covariance is not None:
        return result.functional_covariance(weights)
    flat = weights.reshape(-1, weights.shape[2])
    assert result.band is not None  # of frames the band is the whole covariance
    return np.asarray(flat.T @ band_times(result.band.band, flat))
