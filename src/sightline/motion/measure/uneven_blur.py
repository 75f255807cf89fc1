"""How far jitter within the stages of TDI displaces a match beyond the mean motion.

A pixel of N stages shows the scene through the mean of N displacements. To first order that is the scene at
the mean displacement, but for thousandths to hundredths of a pixel:

- where a motion within the stages is lopsided (it lingers on one side) fine detail is displaced otherwise
  than coarse detail, and a match of all detail is in between;
- where the blur changes from line to line, a filter that compares a line with its neighbours takes what one
  is sharper than the other for a displacement. With W the filter, H the mean of phase factors and a dash the
  slope over w (rad per line), it shows W H - i W' dH/dline - W'' d2H/dline2 / 2 (the product of two
  operators to the second order).

Both are known where the motion is, weighed over the frequencies as the match weighs them, and over the lines
of its window. A turn about the line of sight moves stages across the columns too, by as much as they lie
beside the middle one: a constant one skews what they show of a tone, and its blur with it.

Not here: the mean itself (``geometry/trajectory.py``), matching (``stars.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.execution import in_threads
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import pointing_matrices
from sightline.geometry.trajectory import Motion
from sightline.matching.whitening import Whitening
from sightline.motion.measure.predict import MovingCamera

Array = NDArray[np.float64]

#: Every so many-th frequency of the coherence's grid is taken, up to so many cycles per pixel.
_EVERY, _HIGHEST = 4, 0.45
#: A frequency weighs at most as one of this coherence.
_MOST = 0.999
#: Motion of which stages leave the second share is taken whole, of what they leave less of less, down to
#: nothing at the first: blur shows as much of such motion as its mean does, and what a pass found too large
#: the next would find as much too small. Shorter motions are taken as they are.
_NONE, _WHOLE, _FEWEST = 0.2, 0.3, 16
#: Steps to the shift that fits: beside a motion of half a pixel the first is a fifth too short.
ROUNDS = 3
#: Windows that one thread takes at a time.
_AT_ONCE = 1024
#: Lines of a window that stand for all of it, in halves of its height from its middle, and their shares.
_PLACES, _SHARES = leggauss(3)
#: Windows of a pair that show how much their blur leaves of each frequency.
_SAMPLE = 256
#: Stages at most that stand for all: as many instants of 32 spread within .2 % as those do.
_STAGES = 16
#: Least that blur is taken to leave: of frequencies that it leaves less of, coherence says no more.
_LEAST = 0.05


def displacement(
    cameras: Sequence[MovingCamera],
    pair: tuple[int, int],
    pixels: tuple[Array, Array],
    t: tuple[Array, Array],
    by: tuple[NDArray[np.float32], NDArray[np.float32]],
    affine: Array,
    whitening: Whitening | None,
    lines: float = 1.0,
    *,
    whole: bool = False,
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
    lines : float
        Of the hub, that a window is high.
    whole : bool
        Whether the motion counts as it is, what the stages average away included.

    Notes
    -----
    What frequencies count for, coherence over one less coherence, was learned of images that are blurred: a
    sharp one would show as much more of each as the blur leaves less of it. Filters are alike on either side
    of an axis, so that of two frequencies that mirror each other the geometric mean counts.
    """
    out = np.zeros((len(t[0]), 2))
    coherence = None if whitening is None else whitening.coherence
    tdi = [isinstance(c, PushbroomCamera) and c.stages is not None for c in (cameras[k] for k in pair)]
    if whitening is None or coherence is None or not any(tdi) or cameras[pair[0]].trajectory.motion is None:
        return out
    weights = _weights(coherence, whitening)
    motions = [_motion(cameras[image], whole) for image in pair]
    seen = np.flatnonzero(np.isfinite(t[0]) & np.isfinite(t[1]) & np.isfinite(pixels[1]).all(axis=1))
    if not len(seen):
        return out
    windows = _Windows(cameras, pair, pixels, t, by, affine, motions, lines, weights)
    sample = seen[np.unique(np.linspace(0, len(seen) - 1, _SAMPLE).astype(int))]
    left = np.maximum(np.hypot(*windows.shown(sample)).mean(axis=0), _LEAST)
    weight, frequency = weights.weight / np.sqrt(left * weights.mirrored(left)), weights.frequency

    def values(first: int) -> Array:
        which = seen[first : first + _AT_ONCE]
        shift = np.zeros((len(which), 2))
        _shifts(*windows.shown(which), frequency, weight, shift)
        return shift

    begins = range(0, len(seen), _AT_ONCE)
    for first, part in zip(begins, in_threads(values, begins), strict=True):
        out[seen[first : first + _AT_ONCE]] = part
    return out


def _motion(camera: MovingCamera, whole: bool) -> Motion:
    """The motion of a camera, unless `whole` less what its stages average away: that is hardly known."""
    motion = camera.trajectory.motion
    assert motion is not None
    assert isinstance(camera, PushbroomCamera)
    if whole or camera.stages is None or len(motion.t) < _FEWEST:
        return motion
    step = float(np.median(np.diff(motion.t)))
    t = np.arange(motion.t[0], motion.t[-1], step)
    angles = motion.at(t)
    # what is left between the ends of a line through both has no jump where it is continued
    line = angles[0] + (angles[-1] - angles[0]) * np.linspace(0.0, 1.0, len(t))[:, None]
    rest = np.concatenate([angles - line, -(angles - line)[::-1]])
    frequency = np.fft.rfftfreq(len(rest), step)
    left = np.abs(np.sinc(frequency * float(np.min(camera.stages)) * camera.detector.line_period))
    share = np.clip((left - _NONE) / (_WHOLE - _NONE), 0.0, 1.0)
    kept = np.fft.irfft(np.fft.rfft(rest, axis=0) * share[:, None], len(rest), axis=0)
    return Motion(t, line + kept[: len(t)])


@dataclass(frozen=True, eq=False)
class _Weights:
    """How much frequencies count for a shift, and how filters slope there.

    Attributes
    ----------
    y, x : (Y,) and (X,)
        rad/px; frequencies along the lines, in the order of `numpy.fft.fftfreq`, and across.
    weight : (Y X,)
        Of each of all pairs of these.
    slopes : (2, Y X, 2)
        W'/W, px, and W''/W, px^2, of the filters of hub and partner.
    """

    y: Array
    x: Array
    weight: Array
    slopes: Array

    @property
    def frequency(self) -> Array:
        """(Y X, 2) rad/px."""
        return np.stack(np.meshgrid(self.y, self.x, indexing="ij"), axis=-1).reshape(-1, 2)

    def mirrored(self, values: Array) -> Array:
        """Values (Y X,) of the frequencies that lie as far on the other side of an axis."""
        table = values.reshape(len(self.y), len(self.x))
        return np.asarray(np.roll(table[::-1], 1, axis=0).ravel())


def _weights(coherence: NDArray[np.float64], whitening: Whitening) -> _Weights:
    """Of a pair."""
    lines, half = coherence.shape
    along, across = np.fft.fftfreq(lines), np.fft.rfftfreq(2 * (half - 1))
    keep_y = (np.abs(along) < _HIGHEST) & (np.arange(lines) % _EVERY == 0)
    keep_x = (across < _HIGHEST) & (np.arange(half) % _EVERY == 0)
    keep = np.ix_(keep_y, keep_x)
    squared = np.clip(coherence[keep], 0.0, _MOST)
    both = np.where(across[keep_x] > 0.0, 2.0, 1.0)  # half of the plane stands for the whole
    weight = both * squared / (1.0 - squared)
    slopes = [_slopes(whitening, image)[keep].reshape(-1, 2) for image in ("a", "b")]
    return _Weights(
        2.0 * math.pi * along[keep_y], 2.0 * math.pi * across[keep_x], weight.ravel(), np.stack(slopes)
    )


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


@dataclass(frozen=True, eq=False)
class _Windows:
    """Windows of a pair, as `displacement` takes them, under known motions of both images."""

    cameras: Sequence[MovingCamera]
    pair: tuple[int, int]
    pixels: tuple[Array, Array]
    t: tuple[Array, Array]
    by: tuple[NDArray[np.float32], NDArray[np.float32]]
    affine: Array
    motions: Sequence[Motion]
    lines: float
    weights: _Weights

    def shown(self, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """What windows show of each frequency in the product of both images: (N, Q) real and imaginary."""
        re, im = np.empty((2, len(which), len(self.weights.weight)))
        sides = [value for side in range(2) for value in self._stages(side, which)]
        _phase_factors(*sides, self.weights.y, self.weights.x, self.weights.slopes, 0.5 * _SHARES, re, im)
        return re, im

    def _stages(self, side: int, which: NDArray[np.intp]) -> tuple[Array, NDArray[np.int64]]:
        """Where stages lie beside their mean, (N lines, S, 3, 2) px of the hub, and how many (N lines,).

        In lines that stand for the windows; with the change of that from line to line, and its change.
        """
        hub, camera = self.cameras[self.pair[0]].detector, self.cameras[self.pair[side]]
        assert isinstance(hub, LineDetector)
        assert isinstance(camera, PushbroomCamera)
        whole = camera.stages_of(self.pixels[side][which]).astype(np.int64)
        counts = np.minimum(whole, _STAGES)
        stage = np.arange(int(counts.max()))
        late = ((np.minimum(stage, counts[:, None] - 1) + 0.5) / counts[:, None] - 0.5) * whole[:, None]
        instants = self.t[side][which][:, None] + late * camera.detector.line_period
        instants = instants[:, None] + (0.5 * self.lines * hub.line_period * _PLACES)[:, None]
        into_hub = np.linalg.inv(self.affine[which])
        # the hub shows what lies the other way
        turn = (-1.0 if side == 0 else 1.0) * into_hub @ self.by[side][which].astype(np.float64)
        across = into_hub[:, :, 1] if side else np.tile([0.0, 1.0], (len(which), 1))
        skew = across[:, None] * -late[:, :, None]
        used = (stage < counts[:, None])[:, None, :, None]
        sight, motion, out = _line_of_sight(camera), self.motions[side], []
        for beside in (0.0, -hub.line_period, hub.line_period):
            angles = motion.at(np.clip(instants + beside, *motion.span).ravel())
            about_sight = (angles @ sight).reshape(instants.shape)
            moved = np.einsum("nca,npka->npkc", turn, angles.reshape(*instants.shape, 3))
            moved += skew[:, None] * about_sight[..., None]
            out.append(moved - (moved * used).sum(axis=2, keepdims=True) / counts[:, None, None, None])
        at, before, after = (one.reshape(-1, len(stage), 2) for one in out)
        places = np.stack([at, 0.5 * (after - before), after + before - 2.0 * at], axis=2)
        return places, np.repeat(counts, len(_PLACES))


def _line_of_sight(camera: PushbroomCamera) -> Array:
    """(3,) in body axes, the other way round behind an odd number of mirrors: about it the image turns."""
    # a mirror is known over its table, a mount at all times
    lines = camera.times(np.array([0.0, camera.lines - 1.0]))
    middle = float(np.clip(lines, *camera.known_span).mean())
    axes = pointing_matrices(camera.pointing, np.array([middle]))[0]
    return np.asarray(np.linalg.det(axes) * axes[:, 2])


@njit(cache=True, nogil=True)
def _powers(phase, factors):  # type: ignore[no-untyped-def]
    """Phase factors of 0, 1, 2, ... times `phase`, into `factors`."""
    base = complex(math.cos(phase), math.sin(phase))
    factors[0] = 1.0
    for k in range(1, len(factors)):
        factors[k] = factors[k - 1] * base


@njit(cache=True, nogil=True)
def _shown(moved, count, y, x, slopes, by_y, by_x, sums):  # type: ignore[no-untyped-def]
    """What a filter shows of means of phase factors at frequencies `y` and `x`, over the filter: `sums[0]`.

    `moved` (S, 3, 2): place of each stage, its change and that one's change from line to line. `by_y`, `by_x`
    and `sums` (3, Y X) are room to work in.
    """
    sums[:] = 0.0
    for s in range(count):
        _powers(y[1] * moved[s, 0, 0], by_y)
        _powers(x[1] * moved[s, 0, 1], by_x)
        for j in range(len(y)):
            # frequencies along lines as `numpy.fft.fftfreq` has them: the negative ones mirror the first
            of_y = by_y[j] if j < len(by_y) else by_y[len(y) - j].conjugate()
            rate_y, bend_y = y[j] * moved[s, 1, 0], y[j] * moved[s, 2, 0]
            for i in range(len(x)):
                factor = of_y * by_x[i]
                rate = rate_y + x[i] * moved[s, 1, 1]
                bend = bend_y + x[i] * moved[s, 2, 1]
                k = j * len(x) + i
                sums[0, k] += factor
                sums[1, k] += 1j * rate * factor
                sums[2, k] += (1j * bend - rate * rate) * factor
    for k in range(sums.shape[1]):
        sums[0, k] = (sums[0, k] + 1j * slopes[k, 0] * sums[1, k] - 0.5 * slopes[k, 1] * sums[2, k]) / count


@njit(cache=True, nogil=True)
def _phase_factors(  # type: ignore[no-untyped-def]
    hub, hub_counts, partner, partner_counts, y, x, slopes, shares, re, im
):
    """What windows of several lines, their `shares`, show of frequencies in the product of both images."""
    by_y, by_x = np.empty(len(y) // 2 + 1, np.complex128), np.empty(len(x), np.complex128)
    of_hub, of_partner = np.empty((3, re.shape[1]), np.complex128), np.empty((3, re.shape[1]), np.complex128)
    for n in range(len(re)):
        re[n] = 0.0
        im[n] = 0.0
        for p in range(len(shares)):
            m = n * len(shares) + p
            _shown(hub[m], hub_counts[m], y, x, slopes[0], by_y, by_x, of_hub)
            _shown(partner[m], partner_counts[m], y, x, slopes[1], by_y, by_x, of_partner)
            for k in range(re.shape[1]):
                both = of_partner[0, k] * of_hub[0, k].conjugate()
                re[n, k] += shares[p] * both.real
                im[n, k] += shares[p] * both.imag


@njit(cache=True, nogil=True)
def _shifts(re, im, frequency, weight, out):  # type: ignore[no-untyped-def]
    """Shift that fits phase factors (N, Q) best, into `out` (N, 2)."""
    for n in range(len(out)):
        for _ in range(ROUNDS):
            a11, a12, a22, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(len(weight)):
                y, x = frequency[k, 0], frequency[k, 1]
                phase = y * out[n, 0] + x * out[n, 1]
                left = weight[k] * (im[n, k] * math.cos(phase) - re[n, k] * math.sin(phase))
                w = weight[k] * math.hypot(re[n, k], im[n, k])
                a11 += w * y * y
                a12 += w * y * x
                a22 += w * x * x
                b1 += left * y
                b2 += left * x
            det = a11 * a22 - a12 * a12
            if det > 0.0:
                out[n, 0] += (a22 * b1 - a12 * b2) / det
                out[n, 1] += (a11 * b2 - a12 * b1) / det
