"""Microvibration of a recovered motion: tones through time, what lies above the band, smear of each line.

Not here: finding tones (``motion/tones.py``), their history (``motion/tone_history.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.evaluation.error_spectrum import error_psd
from sightline.geometry.camera import PushbroomCamera
from sightline.motion.results import LineOfSight
from sightline.motion.tone_history import ToneHistory, TonePair, close_pairs, tone_histories
from sightline.motion.tones import AXES, DetectedTone

Array = NDArray[np.float64]

#: A tone scatters more than a steady one would with a smaller probability than this: it is said to vary.
STEADY = 1e-3
#: Frequencies over which errors are summed.
FREQUENCIES = 2048


@dataclass(frozen=True, eq=False)
class Smear:
    """How far the image moves while one line is exposed, beside the nominal scan.

    Attributes
    ----------
    px : (N, 3)
        px per line period, of roll (across), pitch (along) and yaw (along, at the field's edge).
    sigma_px : (3,)
        px; of each.
    """

    px: Array
    sigma_px: Array

    @property
    def mtf_at_nyquist(self) -> Array:
        """(3,) mean over the lines of the MTF factor at half a cycle per px: ``sinc(smear / 2)``."""
        return np.asarray(np.sinc(0.5 * self.px).mean(axis=0))


@dataclass(frozen=True)
class Microvibration:
    """What trembles, and what it does to the image.

    Attributes
    ----------
    histories : tuple of ToneHistory
        Of the tones that last long enough to be cut into pieces.
    pairs : tuple of TonePair
        Tones closer than the resolution of the strip.
    above : dict
        Axis -> (Hz, rad): from the highest frequency at which motion is seen, and the rms that the spectrum
        fitted to the images holds above it: believed, not measured.
    smear : Smear
    """

    histories: tuple[ToneHistory, ...]
    pairs: tuple[TonePair, ...]
    above: dict[str, tuple[float, float]]
    smear: Smear


def microvibration(
    result: LineOfSight, tones: tuple[DetectedTone, ...], passbands: dict[str, list[tuple[float, float]]]
) -> Microvibration:
    """Tones through time, unresolved pairs, what is above the passbands, smear per line.

    Parameters
    ----------
    result : LineOfSight
        Of a strip: its motion is given line by line.
    tones : tuple of DetectedTone
        As ``motion.tones.detect_tones`` finds them.
    passbands : dict
        Axis -> (low, high) Hz of every band in which motion is seen.
    """
    return Microvibration(
        tone_histories(result.motion, tones),
        close_pairs(result.motion, tones),
        {axis: _above(result, k, passbands[axis]) for k, axis in enumerate(AXES)},
        line_smear(result),
    )


def _above(result: LineOfSight, axis: int, bands: list[tuple[float, float]]) -> tuple[float, float]:
    """The upper end of the last passband (Hz), and the rms (rad) of the fitted spectrum beyond it."""
    edge = bands[-1][1] if bands else 0.0
    if result.spectra is None:
        return edge, math.nan
    spectrum = result.spectra[axis]
    # spectra fall as f^-4 or faster: a hundred times the edge holds all but a millionth
    f = np.geomspace(max(edge, 1e-3), 1e2 * max(edge, 1.0), FREQUENCIES)
    inside = np.array([tone.sigma**2 for tone in spectrum.tones if tone.frequency > edge])
    broad = spectrum.without_tones
    density = broad.psd(f) if broad is not None else np.zeros(len(f))
    return edge, math.sqrt(float(np.trapezoid(density, f)) + float(inside.sum()))


def line_smear(result: LineOfSight) -> Smear:
    """Motion during the exposure of each line, taken as one line period, and its sigma.

    Notes
    -----
    Half the change between the lines before and after. Its error is that of the motion through the filter
    ``sin(2 pi f Te)`` of this difference, summed over the error's spectrum. With TDI (the most stages of the
    first band) it is the length of the even motion that blurs as much: sqrt(12) times the rms departure from
    the mean over the stages; the error goes through ``12 (1 - sinc(f N Te)^2)``.
    """
    period = float(np.median(np.diff(result.motion.t)))
    f = np.linspace(0.0, 0.5 / period, FREQUENCIES)[1:]
    count = most_stages(result)
    if count > 1:
        share = 12.0 * (1.0 - np.sinc(f * count * period) ** 2)
    else:
        share = np.sin(2.0 * np.pi * f * period) ** 2
    error = error_psd(result, f) * share[:, None]
    sigma = np.sqrt(np.trapezoid(error, f, axis=0)) / result.scale
    return Smear(smear_px(result), sigma)


def most_stages(result: LineOfSight) -> int:
    """Most TDI stages of the first band."""
    camera = result.cameras[0]
    counts = camera.stages if isinstance(camera, PushbroomCamera) else None
    return 1 if counts is None else int(np.max(counts))


def _within_stages(angles: Array, count: int) -> Array:
    """(N, 3) sqrt(12) times the rms of `angles` (N, 3) over `count` lines about each, less their mean."""
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), angles - angles.mean(axis=0)]), axis=0)
    square = np.cumsum(np.concatenate([np.zeros((1, 3)), (angles - angles.mean(axis=0)) ** 2]), axis=0)
    at = np.arange(len(angles))
    low, high = np.clip(at - count // 2, 0, None), np.clip(at - count // 2 + count, None, len(angles))
    number = (high - low)[:, None]
    mean = (total[high] - total[low]) / number
    return np.asarray(np.sqrt(12.0 * np.maximum((square[high] - square[low]) / number - mean**2, 0.0)))


def smear_px(result: LineOfSight) -> Array:
    """(N, 3) px that the image moves during each line: half the change between its neighbours.

    With TDI the length of the even motion that blurs as much as that within the stages does.
    """
    count = most_stages(result)
    if count > 1:
        return _within_stages(result.motion.angles / result.scale, count)
    return np.asarray(np.gradient(result.motion.angles / result.scale, axis=0))
