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
#: Steps to the shift that fits: beside a motion of half a pixel the first is a fifth too short.
ROUNDS = 30
#: Steps (px) of less are none.
CLOSE = 1e-5
#: A fit bends, where it is, at least by this share of what it may bend at most: less is not near its top.
STEEP = 0.2
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
    offsets: Array | None = None,
) -> tuple[Array, NDArray[np.float32] | None]:
    """How far matches of a partner lie beyond where the mean motion has them, and how that changes with it.

    The first, (G, 2) px of the hub; the second, (G, 2, 2, 3, B) px/rad, by the attitude of hub and of partner
    at each of the `offsets`, None without any.

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
    offsets : (B,), optional
        s; beside the middle of an exposure, evenly spaced.

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
        return out, None
    weights = _weights(coherence, whitening)
    motions = [one for one in (cameras[image].trajectory.motion for image in pair) if one is not None]
    seen = np.flatnonzero(np.isfinite(t[0]) & np.isfinite(t[1]) & np.isfinite(pixels[1]).all(axis=1))
    if not len(seen):
        return out, None
    windows = _Windows(cameras, pair, pixels, t, by, affine, motions, lines, weights)
    sample = seen[np.unique(np.linspace(0, len(seen) - 1, _SAMPLE).astype(int))]
    left = np.maximum(np.hypot(*windows.shown(windows.sides(sample))).mean(axis=0), _LEAST)
    weight, frequency = weights.weight / np.sqrt(left * weights.mirrored(left)), weights.frequency

    changes = None if offsets is None else np.zeros((len(out), 2, 2, 3, len(offsets)), dtype=np.float32)

    def values(first: int) -> None:
        which = seen[first : first + _AT_ONCE]
        shift = np.zeros((len(which), 2))
        sides = windows.sides(which)
        shown = windows.shown(sides)
        _shifts(*shown, frequency, weight, shift)
        out[which] = shift
        if changes is not None and offsets is not None:
            changes[which] = windows.changes(which, sides, shown, shift, weight, offsets)

    in_threads(values, range(0, len(seen), _AT_ONCE))
    return out, changes


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

    def sides(self, which: NDArray[np.intp]) -> list[Array | NDArray[np.int64]]:
        """Stages of hub and partner, as `_stages` gives them."""
        return [value for side in range(2) for value in self._stages(side, which)]

    def shown(self, sides: Sequence[Array | NDArray[np.int64]]) -> tuple[Array, Array]:
        """What windows show of each frequency in the product of both images: (N, Q) real and imaginary."""
        re, im = np.empty((2, len(sides[0]) // len(_SHARES), len(self.weights.weight)))
        _phase_factors(*sides, self.weights.y, self.weights.x, self.weights.slopes, 0.5 * _SHARES, re, im)
        return re, im

    def changes(
        self,
        which: NDArray[np.intp],
        sides: Sequence[Array | NDArray[np.int64]],
        shown: tuple[Array, Array],
        shift: Array,
        weight: Array,
        offsets: Array,
    ) -> NDArray[np.float32]:
        """(N, 2, 2, 3, B) px of the hub per rad: of the `shift` (N, 2) that fits what is `shown`."""
        hub = self.cameras[self.pair[0]].detector
        assert isinstance(hub, LineDetector)
        moves = [self._moves(side, which) for side in range(2)]
        places = 0.5 * self.lines * hub.line_period * _PLACES
        out = np.zeros((len(which), 2, 2, 3, len(offsets)), dtype=np.float32)
        _changes(
            *sides, self.weights.y, self.weights.x,
            self.weights.slopes, 0.5 * _SHARES, places, *shown, shift, self.weights.frequency, weight,
            *[value for move in moves for value in move], hub.line_period, offsets[0],
            offsets[1] - offsets[0], out,
        )  # fmt: skip
        return out

    def _moves(self, side: int, which: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        """How an angle moves what an image shows: (N, 2, 3) px of the hub per rad, and more of late stages.

        (N, 2, 3) px/rad for each line that a stage is late, and the lines (N, S) that stages are late; the
        time (N,) of these in s.
        """
        camera = self.cameras[self.pair[side]]
        assert isinstance(camera, PushbroomCamera)
        whole = camera.stages_of(self.pixels[side][which]).astype(np.int64)
        counts = np.minimum(whole, _STAGES)
        stage = np.arange(int(counts.max()))
        late = ((np.minimum(stage, counts[:, None] - 1) + 0.5) / counts[:, None] - 0.5) * whole[:, None]
        into_hub = np.linalg.inv(self.affine[which])
        turn = (-1.0 if side == 0 else 1.0) * into_hub @ self.by[side][which].astype(np.float64)
        across = into_hub[:, :, 1] if side else np.tile([0.0, 1.0], (len(which), 1))
        skew = -across[:, :, None] * _line_of_sight(camera)
        return np.asarray(turn), np.asarray(skew), np.asarray(late), late * camera.detector.line_period

    def _stages(self, side: int, which: NDArray[np.intp]) -> tuple[Array, NDArray[np.int64]]:
        """Where stages lie beside their mean, (N lines, S, 3, 2) px of the hub, and how many (N lines,).

        In lines that stand for the windows; with the change of that from line to line, and its change.
        """
        hub, camera = self.cameras[self.pair[0]].detector, self.cameras[self.pair[side]]
        assert isinstance(hub, LineDetector)
        assert isinstance(camera, PushbroomCamera)
        turn, skew, late, seconds = self._moves(side, which)
        counts = np.minimum(camera.stages_of(self.pixels[side][which]).astype(np.int64), _STAGES)
        stage = np.arange(late.shape[1])
        instants = self.t[side][which][:, None] + seconds
        instants = instants[:, None] + (0.5 * self.lines * hub.line_period * _PLACES)[:, None]
        used = (stage < counts[:, None])[:, None, :, None]
        moves = turn[:, None] + skew[:, None] * late[:, :, None, None]
        motion, out = self.motions[side], []
        for beside in (0.0, -hub.line_period, hub.line_period):
            angles = motion.at(np.clip(instants + beside, *motion.span).ravel())
            angles = angles.reshape(*instants.shape, 1, 3)
            moved = sum(moves[:, None, ..., axis] * angles[..., axis] for axis in range(3))
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
def _is_steep(c11, c12, c22, a11, a12, a22):  # type: ignore[no-untyped-def]
    """Whether a fit that bends by `c` bends in every direction by STEEP of what it may, `a`, or more."""
    d11, d12, d22 = c11 - STEEP * a11, c12 - STEEP * a12, c22 - STEEP * a22
    return d11 > 0.0 and d11 * d22 > d12 * d12


@njit(cache=True, nogil=True)
def _shifts(re, im, frequency, weight, out):  # type: ignore[no-untyped-def]
    """Shift that fits phase factors (N, Q) best, into `out` (N, 2): the nearest top uphill of none.

    Steps by the bend there may be at most never lead downhill; those by the bend there is are quicker, and
    are taken back where they do.
    """
    for n in range(len(out)):
        height, safe_y, safe_x = -math.inf, 0.0, 0.0
        for _ in range(ROUNDS):
            a11, a12, a22, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0
            c11, c12, c22, here = 0.0, 0.0, 0.0, 0.0
            for k in range(len(weight)):
                y, x = frequency[k, 0], frequency[k, 1]
                phase = y * out[n, 0] + x * out[n, 1]
                cosine, sine = math.cos(phase), math.sin(phase)
                left = weight[k] * (im[n, k] * cosine - re[n, k] * sine)
                most = weight[k] * math.hypot(re[n, k], im[n, k])
                bend = weight[k] * (re[n, k] * cosine + im[n, k] * sine)
                a11 += most * y * y
                a12 += most * y * x
                a22 += most * x * x
                c11 += bend * y * y
                c12 += bend * y * x
                c22 += bend * x * x
                b1 += left * y
                b2 += left * x
                here += bend
            if here < height:
                out[n, 0], out[n, 1], height = safe_y, safe_x, -math.inf
                continue
            det = a11 * a22 - a12 * a12
            if not det > 0.0:
                break
            by, bx = (a22 * b1 - a12 * b2) / det, (a11 * b2 - a12 * b1) / det
            height, safe_y, safe_x = here, out[n, 0] + by, out[n, 1] + bx
            if _is_steep(c11, c12, c22, a11, a12, a22):
                det = c11 * c22 - c12 * c12
                by, bx = (c22 * b1 - c12 * b2) / det, (c11 * b2 - c12 * b1) / det
            out[n, 0] += by
            out[n, 1] += bx
            if math.hypot(by, bx) < CLOSE:
                break


@njit(cache=True, nogil=True)
def _slopes_of_stages(moved, count, y, x, slopes, pull, by_y, by_x, out):  # type: ignore[no-untyped-def]
    """How what pulls at a shift changes with each stage's place, its change and that one's change: `out`.

    `out` (S, 3, 3): of y y, y x, x x. `pull` (Q,) is by what a phase factor of the image pulls.
    """
    for s in range(count):
        for m in range(3):
            for n in range(3):
                out[s, m, n] = 0.0
        _powers(y[1] * moved[s, 0, 0], by_y)
        _powers(x[1] * moved[s, 0, 1], by_x)
        for j in range(len(y)):
            of_y = by_y[j] if j < len(by_y) else by_y[len(y) - j].conjugate()
            rate_y, bend_y = y[j] * moved[s, 1, 0], y[j] * moved[s, 2, 0]
            # sums over the frequencies across: of none, of one, of two of them
            v0, v1, v2, r0, r1, r2, c0, c1, c2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(len(x)):
                k = j * len(x) + i
                rate = rate_y + x[i] * moved[s, 1, 1]
                bend = bend_y + x[i] * moved[s, 2, 1]
                first, second = slopes[k, 0], slopes[k, 1]
                factor = of_y * by_x[i] * pull[k]
                re, im = factor.real, factor.imag
                v = re * (1.0 - first * rate + 0.5 * second * rate * rate) + im * 0.5 * second * bend
                r = (second * rate - first) * im
                c = -0.5 * second * re
                v0 += v
                v1 += v * x[i]
                v2 += v * x[i] * x[i]
                r0 += r
                r1 += r * x[i]
                r2 += r * x[i] * x[i]
                c0 += c
                c1 += c * x[i]
                c2 += c * x[i] * x[i]
            out[s, 0, 0] += v0 * y[j] * y[j]
            out[s, 0, 1] += v1 * y[j]
            out[s, 0, 2] += v2
            out[s, 1, 0] += r0 * y[j] * y[j]
            out[s, 1, 1] += r1 * y[j]
            out[s, 1, 2] += r2
            out[s, 2, 0] += c0 * y[j] * y[j]
            out[s, 2, 1] += c1 * y[j]
            out[s, 2, 2] += c2


@njit(cache=True, nogil=True)
def _changes(  # type: ignore[no-untyped-def]
    hub, hub_counts, partner, partner_counts, y, x, slopes, shares, places, re, im, shift, frequency, weight,
    hub_turn, hub_skew, hub_late, hub_seconds, turn, skew, late, seconds, period, first, step, out,
):  # fmt: skip
    """How shifts that fit phase factors change with the angles of hub and partner, into `out`."""
    q = re.shape[1]
    by_y, by_x = np.empty(len(y) // 2 + 1, np.complex128), np.empty(len(x), np.complex128)
    of_hub, of_partner = np.empty((3, q), np.complex128), np.empty((3, q), np.complex128)
    other = np.empty(q, np.complex128)
    stages = np.empty((max(hub.shape[1], partner.shape[1]), 3, 3))
    coefficients = np.empty((stages.shape[0], 3, 3))
    bins = out.shape[4]
    for n in range(len(re)):
        a11, a12, a22, m11, m12, m22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(q):
            fy, fx = frequency[k, 0], frequency[k, 1]
            phase = fy * shift[n, 0] + fx * shift[n, 1]
            w = weight[k] * (re[n, k] * math.cos(phase) + im[n, k] * math.sin(phase))
            most = weight[k] * math.hypot(re[n, k], im[n, k])
            a11 += w * fy * fy
            a12 += w * fy * fx
            a22 += w * fx * fx
            m11 += most * fy * fy
            m12 += most * fy * fx
            m22 += most * fx * fx
        if not _is_steep(a11, a12, a22, m11, m12, m22):
            continue  # a fit as flat as that goes anywhere: one window of thousands would bend the motion
        det = a11 * a22 - a12 * a12
        for p in range(len(shares)):
            m = n * len(shares) + p
            _shown(hub[m], hub_counts[m], y, x, slopes[0], by_y, by_x, of_hub)
            _shown(partner[m], partner_counts[m], y, x, slopes[1], by_y, by_x, of_partner)
            for side in range(2):
                for k in range(q):
                    phase = frequency[k, 0] * shift[n, 0] + frequency[k, 1] * shift[n, 1]
                    back = complex(math.cos(phase), -math.sin(phase)) * weight[k]
                    # of the hub the conjugate is what shows, and what pulls the other way
                    if side == 0:
                        other[k] = -(back * of_partner[0, k]).conjugate()
                    else:
                        other[k] = back * of_hub[0, k].conjugate()
                moved = hub[m] if side == 0 else partner[m]
                count = hub_counts[m] if side == 0 else partner_counts[m]
                filters = slopes[0] if side == 0 else slopes[1]
                _slopes_of_stages(moved, count, y, x, filters, other, by_y, by_x, stages)
                for e in range(3):
                    for s in range(count):
                        coefficients[s, 0, e] = stages[s, 0, e] - 2.0 * stages[s, 2, e]
                        coefficients[s, 1, e] = stages[s, 2, e] - 0.5 * stages[s, 1, e]
                        coefficients[s, 2, e] = stages[s, 2, e] + 0.5 * stages[s, 1, e]
                    for b in range(3):  # places are beside their mean
                        mean = 0.0
                        for s in range(count):
                            mean += coefficients[s, b, e]
                        for s in range(count):
                            coefficients[s, b, e] -= mean / count
                for s in range(count):
                    for b in range(3):
                        yy, yx, xx = coefficients[s, b]
                        scale = shares[p] / count / det
                        g00, g01 = (a22 * yy - a12 * yx) * scale, (a22 * yx - a12 * xx) * scale
                        g10, g11 = (a11 * yx - a12 * yy) * scale, (a11 * xx - a12 * yx) * scale
                        at = hub_seconds[n, s] if side == 0 else seconds[n, s]
                        at += places[p] + (0.0 if b == 0 else (-period if b == 1 else period))
                        place = (at - first) / step
                        node = min(max(int(math.floor(place)) - 1, 0), bins - 4)
                        u = place - node
                        w0 = -(u - 1) * (u - 2) * (u - 3) / 6
                        w1 = u * (u - 2) * (u - 3) / 2
                        w2 = -u * (u - 1) * (u - 3) / 2
                        w3 = u * (u - 1) * (u - 2) / 6
                        for axis in range(3):
                            if side == 0:
                                along = hub_turn[n, 0, axis] + hub_late[n, s] * hub_skew[n, 0, axis]
                                across = hub_turn[n, 1, axis] + hub_late[n, s] * hub_skew[n, 1, axis]
                            else:
                                along = turn[n, 0, axis] + late[n, s] * skew[n, 0, axis]
                                across = turn[n, 1, axis] + late[n, s] * skew[n, 1, axis]
                            for c in range(2):
                                value = g00 * along + g01 * across if c == 0 else g10 * along + g11 * across
                                out[n, side, c, axis, node] += w0 * value
                                out[n, side, c, axis, node + 1] += w1 * value
                                out[n, side, c, axis, node + 2] += w2 * value
                                out[n, side, c, axis, node + 3] += w3 * value
