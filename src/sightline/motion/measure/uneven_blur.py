"""How far jitter within the stages of TDI displaces a match beyond the mean motion.

A pixel of N stages shows the scene through the mean of N displacements. To first order that is the scene at
the mean displacement, but for thousandths to hundredths of a pixel:

- where a motion within the stages is lopsided (it lingers on one side) fine detail is displaced otherwise
  than coarse detail, and a match of all detail is in between;
- where the blur changes from line to line, a filter that compares a line with its neighbours takes what one
  is sharper than the other for a displacement. With W the filter, H the mean of phase factors and a dash the
  slope over w (rad per line), it shows W H - i W' dH/dline - W'' d2H/dline2 / 2 (the product of two
  operators to the second order).

Both are known where the motion is, weighed over the frequencies as the match weighs them.

Not here: the mean itself (``geometry/trajectory.py``), matching (``stars.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.estimation.search import LEFT_BY_TDI
from sightline.execution import in_threads
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.trajectory import Motion
from sightline.matching.whitening import Whitening
from sightline.motion.measure.predict import MovingCamera

Array = NDArray[np.float64]

#: Every so many-th frequency of the coherence's grid is taken, up to so many cycles per pixel.
_EVERY, _HIGHEST = 4, 0.45
#: A frequency weighs at most as one of this coherence.
_MOST = 0.999
#: Motion of which the stages leave this share is taken whole, less of what they leave less of (LEFT_BY_TDI:
#: nothing); shorter ones as they are.
_WHOLE, _FEWEST = 0.25, 16
#: Steps to the shift that fits: beside a motion of half a pixel the first is a fifth too short.
ROUNDS = 3
#: Windows that one thread takes at a time.
_AT_ONCE = 2048


def displacement(
    cameras: Sequence[MovingCamera],
    pair: tuple[int, int],
    pixels: tuple[Array, Array],
    t: tuple[Array, Array],
    by: tuple[NDArray[np.float32], NDArray[np.float32]],
    affine: Array,
    whitening: Whitening | None,
) -> Array:
    """(G, 2) px of the hub by which matches of a partner lie beyond where the mean motion has them.

    Parameters
    ----------
    cameras : sequence of cameras
        Of all images, with the best motion known.
    pair : (int, int)
        Hub and partner.
    pixels, t : two of (G, 2) px and (G,) s
        Centres of the windows in each, and the middle of their exposures; NaN where not seen.
    by : two of (G, 2, 3)
        px/rad; change of the predicted partner with the attitude of each.
    affine : (G, 2, 2)
        px/px; change of the predicted partner with the pixel of the hub, where frequencies are of the hub's.
    whitening : Whitening or None
        Says how much each frequency counts; nothing is known without its coherence.
    """
    out = np.zeros((len(t[0]), 2))
    coherence = None if whitening is None else whitening.coherence
    tdi = [isinstance(c, PushbroomCamera) and c.stages is not None for c in (cameras[k] for k in pair)]
    if whitening is None or coherence is None or not any(tdi) or cameras[pair[0]].trajectory.motion is None:
        return out
    weights = _weights(coherence, whitening)
    motions = [_known(cameras[image]) for image in pair]
    seen = np.flatnonzero(np.isfinite(t[0]) & np.isfinite(t[1]) & np.isfinite(pixels[1]).all(axis=1))

    def values(first: int) -> Array:
        which = seen[first : first + _AT_ONCE]
        return _of_windows(cameras, pair, pixels, t, by, affine, motions, which, weights)

    begins = range(0, len(seen), _AT_ONCE)
    for first, part in zip(begins, in_threads(values, begins), strict=True):
        out[seen[first : first + _AT_ONCE]] = part
    return out


def _known(camera: MovingCamera) -> Motion:
    """The motion of a camera less what its stages average away: that is hardly known."""
    motion = camera.trajectory.motion
    assert motion is not None
    assert isinstance(camera, PushbroomCamera)
    if camera.stages is None or len(motion.t) < _FEWEST:
        return motion
    step = float(np.median(np.diff(motion.t)))
    t = np.arange(motion.t[0], motion.t[-1], step)
    angles = motion.at(t)
    # what is left between the ends of a line through both has no jump where it is continued
    line = angles[0] + (angles[-1] - angles[0]) * np.linspace(0.0, 1.0, len(t))[:, None]
    rest = np.concatenate([angles - line, -(angles - line)[::-1]])
    frequency = np.fft.rfftfreq(len(rest), step)
    left = np.abs(np.sinc(frequency * float(np.min(camera.stages)) * camera.detector.line_period))
    share = np.clip((left - LEFT_BY_TDI) / (_WHOLE - LEFT_BY_TDI), 0.0, 1.0)
    kept = np.fft.irfft(np.fft.rfft(rest, axis=0) * share[:, None], len(rest), axis=0)
    return Motion(t, line + kept[: len(t)])


@dataclass(frozen=True, eq=False)
class _Weights:
    """Frequencies (Q, 2), rad/px; how much they count for a shift; W'/W, px, and W''/W, px^2, (2, Q, 2)."""

    frequency: Array
    weight: Array
    slopes: Array


def _weights(coherence: NDArray[np.float64], whitening: Whitening) -> _Weights:
    """Of a pair."""
    lines, half = coherence.shape
    along, across = np.fft.fftfreq(lines), np.fft.rfftfreq(2 * (half - 1))
    keep = (np.abs(along) < _HIGHEST)[:, None] & (across < _HIGHEST)[None, :]
    keep &= (np.arange(lines) % _EVERY == 0)[:, None] & (np.arange(half) % _EVERY == 0)[None, :]
    squared = np.clip(coherence[keep], 0.0, _MOST)
    y, x = np.broadcast_arrays(along[:, None], across[None, :])
    frequency = 2.0 * math.pi * np.stack([y[keep], x[keep]], axis=1)
    both = np.where(frequency[:, 1] > 0.0, 2.0, 1.0)  # half of the plane stands for the whole
    slopes = np.stack([_slopes(whitening, image)[keep] for image in ("a", "b")])
    return _Weights(frequency, both * squared / (1.0 - squared), slopes)


def _slopes(whitening: Whitening, image: str) -> Array:
    """(64, 33, 2) px, px^2; first and second slope of a filter's response along lines, over it."""
    response = whitening.response(image)
    size = len(response)
    taps = np.fft.ifft(response, axis=0)
    lag = np.fft.fftfreq(size, 1.0 / size)[:, None]
    floor = 1e-3 * np.abs(response).max(initial=1e-30)
    over = np.where(np.abs(response) > floor, response, np.inf)
    slopes = [np.fft.fft((-1j * lag) ** order * taps, axis=0).real / over for order in (1, 2)]
    return np.stack(slopes, axis=-1)


def _of_windows(
    cameras: Sequence[MovingCamera],
    pair: tuple[int, int],
    pixels: tuple[Array, Array],
    t: tuple[Array, Array],
    by: tuple[NDArray[np.float32], NDArray[np.float32]],
    affine: Array,
    motions: Sequence[Motion],
    which: NDArray[np.intp],
    weights: _Weights,
) -> Array:
    """The same (N, 2) of some windows."""
    sides = []
    hub = cameras[pair[0]].detector
    assert isinstance(hub, LineDetector)
    for side, image in enumerate(pair):
        camera, motion = cameras[image], motions[side]
        assert isinstance(camera, PushbroomCamera)
        counts = camera.stages_of(pixels[side][which]).astype(np.int64)
        most = int(counts.max())
        stage = np.arange(most)[None, :]
        late = (
            np.minimum(stage, counts[:, None] - 1) - 0.5 * (counts[:, None] - 1)
        ) * camera.detector.line_period
        instants = t[side][which][:, None] + late
        # the hub shows what lies the other way
        turn = (-1.0 if side == 0 else 1.0) * np.linalg.solve(
            affine[which], by[side][which].astype(np.float64)
        )
        used = (stage < counts[:, None])[:, :, None]
        places = []
        for beside in (0.0, -hub.line_period, hub.line_period):
            angles = motion.at(np.clip(instants + beside, *motion.span).ravel()).reshape(*instants.shape, 3)
            moved = np.einsum("nca,nka->nkc", turn, angles)
            places.append(moved - (moved * used).sum(axis=1, keepdims=True) / counts[:, None, None])
        at, before, after = places
        sides.append((np.stack([at, 0.5 * (after - before), after + before - 2.0 * at], axis=2), counts))
    out = np.zeros((len(which), 2))
    _shifts(*sides[0], *sides[1], weights.frequency, weights.weight, weights.slopes, out)
    return out


@njit(cache=True, nogil=True)
def _shown(moved, count, y, x, slopes):  # type: ignore[no-untyped-def]
    """What a filter shows of a mean of phase factors at a frequency, over the filter: (real, imaginary).

    `moved` (S, 3, 2): place of each stage, its change and that one's change from line to line.
    """
    re, im, re_1, im_1, re_2, im_2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for s in range(count):
        phase = y * moved[s, 0, 0] + x * moved[s, 0, 1]
        rate = y * moved[s, 1, 0] + x * moved[s, 1, 1]
        bend = y * moved[s, 2, 0] + x * moved[s, 2, 1]
        c, d = math.cos(phase), math.sin(phase)
        re += c
        im += d
        re_1 -= rate * d
        im_1 += rate * c
        re_2 -= bend * d + rate * rate * c
        im_2 += bend * c - rate * rate * d
    shown_re = re - slopes[0] * im_1 - 0.5 * slopes[1] * re_2
    shown_im = im + slopes[0] * re_1 - 0.5 * slopes[1] * im_2
    return shown_re / count, shown_im / count


@njit(cache=True, nogil=True)
def _shifts(hub, hub_counts, partner, partner_counts, frequency, weight, slopes, out):  # type: ignore[no-untyped-def]
    """Shift that fits the phases of two means of phase factors best, into `out` (N, 2)."""
    re, im = np.empty(len(weight)), np.empty(len(weight))
    for n in range(len(out)):
        for k in range(len(weight)):
            y, x = frequency[k, 0], frequency[k, 1]
            re_h, im_h = _shown(hub[n], hub_counts[n], y, x, slopes[0, k])
            re_p, im_p = _shown(partner[n], partner_counts[n], y, x, slopes[1, k])
            re[k], im[k] = re_p * re_h + im_p * im_h, im_p * re_h - re_p * im_h
        for _ in range(ROUNDS):
            a11, a12, a22, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(len(weight)):
                y, x = frequency[k, 0], frequency[k, 1]
                phase = y * out[n, 0] + x * out[n, 1]
                left = weight[k] * (im[k] * math.cos(phase) - re[k] * math.sin(phase))
                w = weight[k] * math.hypot(re[k], im[k])
                a11 += w * y * y
                a12 += w * y * x
                a22 += w * x * x
                b1 += left * y
                b2 += left * x
            det = a11 * a22 - a12 * a12
            if det > 0.0:
                out[n, 0] += (a22 * b1 - a12 * b2) / det
                out[n, 1] += (a11 * b2 - a12 * b1) / det
