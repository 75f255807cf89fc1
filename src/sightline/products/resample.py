"""The kernel of products: 16 taps per axis, lines first, then columns.

A row of the output is the image along a row of places, one per pixel. Weights come from a table. Where the
whole row is shifted alike they are computed once for it; over stretches where the shift changes slowly they
follow a parabola; elsewhere every pixel has its own.

Not here: where the places are (``register_bands.py``), the kernel of matching (``imaging/resample.py``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.imaging.resample import delay_weights

__all__ = ["BEFORE", "TAPS", "product_kernel", "product_weights", "resample_rows"]

Array = NDArray[np.float64]

TAPS = 16
"""Taps along each axis; a place lies between taps 7 and 8."""
BEFORE = TAPS // 2 - 1
"""Pixels that the kernel reads before the pixel that a place begins with; it reads `TAPS` in all."""
BAND = 0.41
"""Cycles per pixel up to which the kernel is made true; beyond, no 16 taps could be."""
PHASES = 512
"""Fractions of a pixel in the table; between two of them weights are linear (error < 3e-6)."""

#: Half-range of a fraction over which one set of weights serves: a value is then off by at most the gradient
#: times as much, for ground of 1/f^2 power 9e-5 of its rms, a third of what the kernel leaves.
CONSTANT = 1.0 / 2048.0
#: Half-range over which weights follow a parabola through three phases; a wave of f cycles per pixel gets an
#: error of (2 pi f h)^3 / 15.6: 2.4e-4 of its amplitude at 0.4.
PARABOLA = 1.0 / 16.0
#: Rows of the table before fraction 0 and after fraction 1.
MARGIN = int(PHASES * PARABOLA) + 1
#: Pixels of a stretch with weights of its own, and the shortest that is worth it.
STRETCH, SHORTEST = 64, 8
#: Lines per column above which a row is interpolated pixel by pixel: lines first, then columns would shear
#: fine detail out of the kernel's band.
STEEP = 1.0 / 16.0


def product_weights(fractions: Array) -> Array:
    """Weights (N, TAPS) of places so far after tap `BEFORE`, (N,) in samples; at 0 that sample itself."""
    return delay_weights(fractions, TAPS, BAND, natural=True)


@cache
def product_kernel(*, absolute: bool = False) -> NDArray[np.float32]:
    """Weights for `resample_rows`, float32, read-only: row p is the fraction (p - MARGIN) / PHASES.

    Fractions run a little beyond 0 and 1, because weights of a stretch begin where its middle does. With
    `absolute` their magnitudes: what they give of an image of flags is how much flagged pixels weigh.
    """
    weights = product_weights(np.arange(-MARGIN, PHASES + MARGIN + 1) / PHASES)
    table = (np.abs(weights) if absolute else weights).astype(np.float32)
    table.setflags(write=False)
    return table


@njit(cache=True, nogil=True, fastmath=True)
def _weights(table, fraction, out):  # type: ignore[no-untyped-def]
    """Weights of a fraction, which may lie outside 0 .. 1 by `PARABOLA`."""
    place = fraction * PHASES + MARGIN
    index = min(max(int(place), 0), table.shape[0] - 2)
    share = np.float32(place - index)
    for k in range(TAPS):
        out[k] = table[index, k] + share * (table[index + 1, k] - table[index, k])


@njit(cache=True, nogil=True, fastmath=True)
def _parabola(table, middle, half, w):  # type: ignore[no-untyped-def]
    """Weights as w[0] + t (w[1] + t w[2]), t the fraction less `middle`, exact at t = 0 and t = +-half."""
    _weights(table, middle, w[0])
    _weights(table, middle - half, w[1])
    _weights(table, middle + half, w[2])
    one, two = np.float32(0.5 / half), np.float32(0.5 / (half * half))
    for k in range(TAPS):
        low, high = w[1, k], w[2, k]
        w[1, k] = one * (high - low)
        w[2, k] = two * (low + high - np.float32(2.0) * w[0, k])


@njit(cache=True, nogil=True, fastmath=True)
def _sum_constant(data, start, pitch, w, out):  # type: ignore[no-untyped-def]
    """out[j] = sum over k of w[k] data[start + k pitch + j]: lines for the pitch of the image, columns for 1.

    Four taps at a time: one pass over `out` for every four rows read.
    """
    n = out.shape[0]
    for k in range(0, TAPS, 4):
        a, b, c, d = w[k], w[k + 1], w[k + 2], w[k + 3]
        p0 = start + k * pitch
        p, q = data[p0 : p0 + n], data[p0 + pitch : p0 + pitch + n]
        r, s = data[p0 + 2 * pitch : p0 + 2 * pitch + n], data[p0 + 3 * pitch : p0 + 3 * pitch + n]
        if k == 0:
            for j in range(n):
                out[j] = a * p[j] + b * q[j] + c * r[j] + d * s[j]
        else:
            for j in range(n):
                out[j] += a * p[j] + b * q[j] + c * r[j] + d * s[j]


@njit(cache=True, nogil=True, fastmath=True)
def _sum_parabola(data, start, pitch, w, t, out):  # type: ignore[no-untyped-def]
    """The same with weights w[0] + t[j] (w[1] + t[j] w[2])."""
    n = out.shape[0]
    for j in range(n):
        out[j] = np.float32(0.0)
    for k in range(0, TAPS, 4):
        a0, b0, c0, d0 = w[0, k], w[0, k + 1], w[0, k + 2], w[0, k + 3]
        a1, b1, c1, d1 = w[1, k], w[1, k + 1], w[1, k + 2], w[1, k + 3]
        a2, b2, c2, d2 = w[2, k], w[2, k + 1], w[2, k + 2], w[2, k + 3]
        p0 = start + k * pitch
        p, q = data[p0 : p0 + n], data[p0 + pitch : p0 + pitch + n]
        r, s = data[p0 + 2 * pitch : p0 + 2 * pitch + n], data[p0 + 3 * pitch : p0 + 3 * pitch + n]
        for j in range(n):
            x = t[j]
            out[j] += (
                (a0 + x * (a1 + x * a2)) * p[j]
                + (b0 + x * (b1 + x * b2)) * q[j]
                + (c0 + x * (c1 + x * c2)) * r[j]
                + (d0 + x * (d1 + x * d2)) * s[j]
            )


@njit(cache=True, nogil=True, fastmath=True)
def _sum_single(data, start, pitch, table, place, w, out):  # type: ignore[no-untyped-def]
    """The same with weights for every pixel: tap 7 of pixel j is the one before `place[j]`."""
    for j in range(out.shape[0]):
        whole = int(np.floor(place[j]))
        _weights(table, place[j] - whole, w[0])
        p0 = start + whole * pitch + j
        total = np.float32(0.0)
        for k in range(TAPS):
            total += w[0, k] * data[p0 + k * pitch]
        out[j] = total


@njit(cache=True, nogil=True, fastmath=True)
def _steady(data, start, pitch, table, middle, w, out):  # type: ignore[no-untyped-def]
    """out[j] = the image at `middle` along one axis, counted from tap 7 of data[start + k pitch + j]."""
    whole = int(np.floor(middle))
    _weights(table, middle - whole, w[0])
    _sum_constant(data, start + whole * pitch, pitch, w[0], out)


@njit(cache=True, nogil=True, fastmath=True)
def _changing(data, start, pitch, table, place, w, t, out):  # type: ignore[no-untyped-def]
    """The same at `place[j]`, in stretches, each with the cheapest weights that are true enough."""
    n, first, size = out.shape[0], 0, STRETCH
    while first < n:
        last = min(first + size, n)
        low, high = place[first], place[first]
        for j in range(first, last):
            low, high = min(low, place[j]), max(high, place[j])
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        whole = int(np.floor(middle))
        if half <= CONSTANT:
            _steady(data, start + first, pitch, table, middle, w, out[first:last])
        elif half <= PARABOLA:
            _parabola(table, middle - whole, half, w)
            for j in range(first, last):
                t[j - first] = np.float32(place[j] - middle)
            _sum_parabola(data, start + whole * pitch + first, pitch, w, t, out[first:last])
        elif size > SHORTEST:
            size //= 2
            continue
        else:
            _sum_single(data, start + first, pitch, table, place[first:last], w, out[first:last])
        first, size = last, STRETCH


@njit(cache=True, nogil=True, fastmath=True)
def _by_pixel(image, line, column, table, w, out):  # type: ignore[no-untyped-def]
    """Both axes at once for every pixel: for maps too steep for lines first, then columns."""
    for j in range(out.shape[0]):
        row, col = int(np.floor(line[j])), int(np.floor(column[j]))
        _weights(table, line[j] - row, w[0])
        _weights(table, column[j] - col, w[1])
        total = np.float32(0.0)
        for k in range(TAPS):
            part = np.float32(0.0)
            for m in range(TAPS):
                part += w[1, m] * image[row - BEFORE + k, col - BEFORE + m]
            total += w[0, k] * part
        out[j] = total


@njit(cache=True, nogil=True)
def _is_steep(position, nodes):  # type: ignore[no-untyped-def]
    """Whether a row of places (M, 2) is too steep, or turns back, for lines first, then columns."""
    for m in range(len(nodes) - 1):
        ahead = position[m + 1, 1] - position[m, 1]
        aside = abs(position[m + 1, 0] - position[m, 0])
        if ahead < 0.5 * (nodes[m + 1] - nodes[m]) or aside > STEEP * ahead:
            return True
    return False


@njit(cache=True, nogil=True)
def _range_of(position, nodes, axis, less):  # type: ignore[no-untyped-def]
    """Middle and half-range over a row of one coordinate of its places less `less` times the column."""
    low = high = position[0, axis] - less * nodes[0]
    for m in range(1, len(nodes)):
        value = position[m, axis] - less * nodes[m]
        low, high = min(low, value), max(high, value)
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, nogil=True)
def _lines_along(position, first, line):  # type: ignore[no-untyped-def]
    """Line at which the row of places crosses each source column from `first` on; prolonged at its ends."""
    x, last = 0, position.shape[0] - 2
    for m in range(last + 1):
        step = (position[m + 1, 0] - position[m, 0]) / (position[m + 1, 1] - position[m, 1])
        begin = position[m, 0] + step * (first - position[m, 1])
        end = len(line) if m == last else min(max(int(position[m + 1, 1]) + 1 - first, x), len(line))
        for k in range(x, end):
            line[k] = begin + k * step
        x = end


@njit(cache=True, nogil=True)
def _between(position, nodes, axis, less, out):  # type: ignore[no-untyped-def]
    """One coordinate of the places at every pixel, linear between nodes, less `less` times the pixel."""
    for m in range(len(nodes) - 1):
        a, n = position[m, axis], nodes[m + 1] - nodes[m]
        step = (position[m + 1, axis] - a) / n - less
        a -= less * nodes[m]
        for j in range(n):
            out[nodes[m] + j] = a + j * step


@njit(cache=True, nogil=True)
def _resample_rows(image, position, nodes, table, out):  # type: ignore[no-untyped-def]
    """Work of `resample_rows`."""
    pitch, data = image.shape[1], image.ravel()
    w, t = np.empty((3, TAPS), np.float32), np.empty(STRETCH, np.float32)
    place = np.empty(max(out.shape[1], pitch))
    column = np.empty(out.shape[1])
    v = np.empty(pitch, np.float32)
    # of a type, not literals: what they are given to would be compiled for each
    along, across, next_pixel = np.int64(0), np.int64(1), np.int64(1)
    for i in range(out.shape[0]):
        at = position[i]
        if _is_steep(at, nodes):
            _between(at, nodes, along, 0.0, place)
            _between(at, nodes, across, 0.0, column)
            _by_pixel(image, place, column, table, w, out[i])
            continue
        # a pixel more on both sides: the weights of a stretch begin where its middle does
        first = max(int(np.floor(at[0, 1])) - BEFORE - 1, 0)
        count = min(int(np.floor(at[-1, 1])) + TAPS - BEFORE + 1, pitch) - first
        line, half = _range_of(at, nodes, along, 0.0)
        if half <= CONSTANT:
            _steady(data, first - BEFORE * pitch, pitch, table, line, w, v[:count])
        else:
            _lines_along(at, first, place[:count])
            _changing(data, first - BEFORE * pitch, pitch, table, place[:count], w, t, v[:count])
        shift, half = _range_of(at, nodes, across, 1.0)
        if half <= CONSTANT:
            _steady(v, -BEFORE - first, next_pixel, table, shift, w, out[i])
        else:
            _between(at, nodes, across, 1.0, place)
            _changing(v, -BEFORE - first, next_pixel, table, place, w, t, out[i])


def resample_rows(
    image: NDArray[np.float32],
    position: Array,
    nodes: NDArray[np.int64],
    out: NDArray[np.float32],
    *,
    table: NDArray[np.float32] | None = None,
) -> None:
    """Fill rows of `out` with the image at given places.

    Parameters
    ----------
    image : (lines, columns) float32, finite
    position : (rows, M, 2)
        px; where in `image` (line, column) the columns `nodes` of each row lie; linear between nodes. Every
        place keeps 10 px from the edges of the image.
    nodes : (M,)
        Columns of `out`, increasing; the first is 0, the last one past the last column.
    out : (rows, columns) float32
        Written.
    table : (PHASES + 2 MARGIN + 1, TAPS) float32, optional
        Weights; those of `product_kernel` by default.

    Notes
    -----
    Lines first: ``v(x) = image(line(x), x)`` along the row of places, at the image's own columns x; then
    columns of v. For smooth maps that is the two-dimensional kernel but for a shear of the spectrum by the
    slope of the row of places, at most `STEEP`.
    """
    weights = product_kernel() if table is None else table
    _resample_rows(
        np.ascontiguousarray(image, dtype=np.float32),
        np.ascontiguousarray(position, dtype=np.float64),
        np.ascontiguousarray(nodes, dtype=np.int64),
        weights,
        out,
    )
