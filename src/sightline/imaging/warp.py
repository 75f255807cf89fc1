"""An image seen in the geometry of another: resampled along a smooth map, window by window.

Filters that reach over several lines see the same distortions in both images only when one is
laid on the other first. The map is given at some columns of every line; between them positions
are linear, and the kernel's weights are carried linearly with them.

Not here: the kernel (``resample.py``), registered products.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.geometry.checks import read_only
from sightline.geometry.interpolation import POINTS, interpolate, unit_weights
from sightline.imaging.resample import TAPS, fill_weights, kernel_table, sample_at
from sightline.imaging.source import ImageSource

Array = NDArray[np.float64]

#: Half-width of what the kernel reads about a position, px.
REACH = TAPS // 2
#: Change of a position against the regular grid within one interval up to which the fast path serves, px.
SLACK = 0.25
#: px between places where a map is computed exactly, where `lattice_map` makes it.
_LATTICE = 8.0
#: px by which a map may bend away from a straight line between the places where it is evaluated, where these
#: are farther apart than asked for.
STRAIGHT = 5e-4
#: px up to which cubics through every fourth of these places are as good, and lines that show it.
CUBIC, SHOWN = 1e-5, 5
#: Spacing (columns) of maps that are smooth.
SMOOTH = 64
#: Columns on either side of a rough one at which the map is evaluated more often.
ROUGH = 6
#: Highest frequency (cycles per line) that must come through between uneven lines, as between even ones.
_BAND = 0.38
#: Places per line at which autocorrelations are tabulated; weights of uneven lines that are found together.
_TABLED, _ABREAST = 1024, 16


@njit(cache=True, nogil=True, fastmath=True)
def _slow_interval(image, l0, l1, c0, c1, first, last, table, wy, wx, out):  # type: ignore[no-untyped-def]
    """Pixels first .. last - 1 of one output row, weights for each pixel."""
    rows, columns = image.shape
    n = last - first
    for j in range(n):
        share = j / n
        line, column = l0 + share * (l1 - l0), c0 + share * (c1 - c0)
        if 3 <= line < rows - 4 and 3 <= column < columns - 4:
            out[first + j] = sample_at(image, line, column, table, wy, wx)
        else:
            out[first + j] = np.nan


@njit(cache=True, nogil=True, fastmath=True)
def _fill_uneven_weights(places, rows, lines, shares, flat, out):  # type: ignore[no-untyped-def]
    """Weights (N, 8) of lines rows - 3 .. rows + 4 at positions `lines`, where these stand as `places` says.

    Those of `resample.delay_weights`, with the lines where they are: the normal matrix is the autocorrelation
    of a spectrum that is flat up to a frequency between the lines, the right side that between lines and
    place; `flat` tabulates it (`_flat_table`), its last entry stands for what is farther, beyond a gap in the
    lines. `shares` of the way from the first to the last column. Some positions are worked on side by side:
    the innermost loops are those that a processor does at once.
    """
    x, y = np.empty((8, _ABREAST)), np.empty(_ABREAST)
    free, ones, factor = np.empty((8, _ABREAST)), np.empty((8, _ABREAST)), np.empty((8, 8, _ABREAST))
    last = len(flat) - 2
    for begin in range(0, len(rows), _ABREAST):
        for n in range(_ABREAST):
            place = min(begin + n, len(rows) - 1)
            row, share = rows[place], shares[place]
            for k in range(8):
                line = row - 3 + k
                x[k, n] = _TABLED * ((1.0 - share) * places[line, 0] + share * places[line, 1])
            a, b, c, d = unit_weights(lines[place] - row + 1.0)
            y[n] = a * x[2, n] + b * x[3, n] + c * x[4, n] + d * x[5, n]
        for i in range(8):
            for j in range(i):
                for n in range(_ABREAST):
                    lag = min(abs(x[i, n] - x[j, n]), last + 1.0)
                    at = min(int(lag), last)
                    factor[i, j, n] = flat[at] + (lag - at) * (flat[at + 1] - flat[at])
            for n in range(_ABREAST):
                lag = min(abs(x[i, n] - y[n]), last + 1.0)
                at = min(int(lag), last)
                free[i, n] = flat[at] + (lag - at) * (flat[at + 1] - flat[at])
                factor[i, i, n], ones[i, n] = flat[0] + 1e-9, 1.0
        for i in range(8):  # Cholesky, the inverse of its diagonal in its place, and forward substitution
            for j in range(i):
                for k in range(j):
                    for n in range(_ABREAST):
                        factor[i, j, n] -= factor[i, k, n] * factor[j, k, n]
                for n in range(_ABREAST):
                    factor[i, j, n] *= factor[j, j, n]
            for k in range(i):
                for n in range(_ABREAST):
                    factor[i, i, n] -= factor[i, k, n] * factor[i, k, n]
                    free[i, n] -= factor[i, k, n] * free[k, n]
                    ones[i, n] -= factor[i, k, n] * ones[k, n]
            for n in range(_ABREAST):
                factor[i, i, n] = 1.0 / np.sqrt(max(factor[i, i, n], 1e-12))
                free[i, n] *= factor[i, i, n]
                ones[i, n] *= factor[i, i, n]
        for i in range(7, -1, -1):
            for k in range(i + 1, 8):
                for n in range(_ABREAST):
                    free[i, n] -= factor[k, i, n] * free[k, n]
                    ones[i, n] -= factor[k, i, n] * ones[k, n]
            for n in range(_ABREAST):
                free[i, n] *= factor[i, i, n]
                ones[i, n] *= factor[i, i, n]
        for n in range(min(_ABREAST, len(rows) - begin)):
            sum_free, sum_ones = 0.0, 0.0
            for i in range(8):
                sum_free += free[i, n]
                sum_ones += ones[i, n]
            for i in range(8):
                out[begin + n, i] = free[i, n] + ones[i, n] / sum_ones * (1.0 - sum_free)


@njit(cache=True, nogil=True, fastmath=True)
def _uneven(position, lines, places, shares, slack, flat):  # type: ignore[no-untyped-def]
    """Weights (E, 8) of uneven lines, and which of them serve the ends of each interval (rows, nodes - 1, 2).

    Intervals of one row of the image share those of the node between them. -1 where too much is turned, or
    the kernel would leave the image (of so many `lines`).
    """
    rows, count = position.shape[0], position.shape[1] - 1
    number, used = np.full((rows, count, 2), -1), 0
    row_of, at = np.empty(2 * rows * count, np.int64), np.empty((2, 2 * rows * count))
    for i in range(rows):
        before = -1
        for m in range(count):
            l0, l1 = position[i, m, 0], position[i, m + 1, 0]
            row = int(np.floor(0.5 * (l0 + l1)))
            if not abs(l1 - l0) <= slack or row < 3 or row + 4 >= lines:
                before = -1
                continue
            for end in range(2):
                if end == 0 and row == before:
                    number[i, m, 0] = number[i, m - 1, 1]
                    continue
                row_of[used], at[0, used] = row, position[i, m + end, 0]
                at[1, used] = shares[0] + shares[1] * position[i, m + end, 1]
                number[i, m, end] = used
                used += 1
            before = row
    weights = np.empty((used, 8), np.float32)
    _fill_uneven_weights(places, row_of[:used], at[0, :used], at[1, :used], flat, weights)
    return weights, number


@cache
def _flat_table() -> Array:
    """Autocorrelation of a spectrum that is flat up to `_BAND`, by lag in 1 / `_TABLED` lines; read-only.

    Between its entries it is linear, within 2e-7.
    """
    table = 2.0 * _BAND * np.sinc(2.0 * _BAND * np.arange(16 * _TABLED) / _TABLED)
    table.setflags(write=False)
    return table


@njit(cache=True, nogil=True, fastmath=True)
def _fast_interval(image, l0, l1, c0, c1, first, last, table, w, v, out, uneven, ends):  # type: ignore[no-untyped-def]
    """The same where positions run almost with the pixels; whether it is served.

    Lines first, then columns, weights carried linearly; where lines are `uneven`, those for lines at both
    `ends` are given.
    """
    rows, columns = image.shape
    n = last - first
    row = int(np.floor(0.5 * (l0 + l1)))
    shift0, shift1 = c0, c1 - n
    offset = int(np.floor(0.5 * (shift0 + shift1)))
    if row < 3 or row + 4 >= rows or offset < 3 or offset + n + 4 >= columns:
        return False
    if len(uneven):
        for k in range(8):  # a whole row at once would compile the words of an error with it
            w[0, k], w[1, k] = uneven[ends[0], k], uneven[ends[1], k]
    else:
        fill_weights(table, l0 - row, w[0])
        fill_weights(table, l1 - row, w[1])
    fill_weights(table, shift0 - offset, w[2])
    fill_weights(table, shift1 - offset, w[3])
    width = n + 7
    scale = np.float32(1.0 / n)
    # column j of these belongs to the place in the row whose columns come from there: part of a pixel back
    back = np.float32(0.5 * (shift0 + shift1) - offset) + np.float32(3.0)
    first_column, past = offset - 3, offset - 3 + width
    p0, p1 = image[row - 3, first_column:past], image[row - 2, first_column:past]
    p2, p3 = image[row - 1, first_column:past], image[row, first_column:past]
    p4, p5 = image[row + 1, first_column:past], image[row + 2, first_column:past]
    p6, p7 = image[row + 3, first_column:past], image[row + 4, first_column:past]
    a0, a1, a2, a3, a4, a5, a6, a7 = w[0, 0], w[0, 1], w[0, 2], w[0, 3], w[0, 4], w[0, 5], w[0, 6], w[0, 7]
    b0, b1, b2, b3 = w[1, 0] - a0, w[1, 1] - a1, w[1, 2] - a2, w[1, 3] - a3
    b4, b5, b6, b7 = w[1, 4] - a4, w[1, 5] - a5, w[1, 6] - a6, w[1, 7] - a7
    line = v[0]
    for j in range(width):
        here = a0 * p0[j] + a1 * p1[j] + a2 * p2[j] + a3 * p3[j]
        here += a4 * p4[j] + a5 * p5[j] + a6 * p6[j] + a7 * p7[j]
        slope = b0 * p0[j] + b1 * p1[j] + b2 * p2[j] + b3 * p3[j]
        slope += b4 * p4[j] + b5 * p5[j] + b6 * p6[j] + b7 * p7[j]
        line[j] = here + (np.float32(j) - back) * scale * slope
    a0, a1, a2, a3, a4, a5, a6, a7 = w[2, 0], w[2, 1], w[2, 2], w[2, 3], w[2, 4], w[2, 5], w[2, 6], w[2, 7]
    b0, b1, b2, b3 = w[3, 0] - a0, w[3, 1] - a1, w[3, 2] - a2, w[3, 3] - a3
    b4, b5, b6, b7 = w[3, 4] - a4, w[3, 5] - a5, w[3, 6] - a6, w[3, 7] - a7
    q0, q1, q2, q3 = line, line[1:], line[2:], line[3:]
    q4, q5, q6, q7 = line[4:], line[5:], line[6:], line[7:]
    part = out[first:last]
    for j in range(n):
        here = a0 * q0[j] + a1 * q1[j] + a2 * q2[j] + a3 * q3[j]
        here += a4 * q4[j] + a5 * q5[j] + a6 * q6[j] + a7 * q7[j]
        slope = b0 * q0[j] + b1 * q1[j] + b2 * q2[j] + b3 * q3[j]
        slope += b4 * q4[j] + b5 * q5[j] + b6 * q6[j] + b7 * q7[j]
        part[j] = here + np.float32(j) * scale * slope
    return True


@njit(cache=True, nogil=True, fastmath=True)
def _warp(image, position, nodes, start, slack, table, out, places, shares, flat):  # type: ignore[no-untyped-def]
    """Rows of `out` from positions (rows, nodes, 2) at columns `nodes`; `start`: column of out[:, 0].

    `places` (lines, 2) of the image's lines at the first and the last column of its source, none where they
    are even; `shares` (2,): how far between these the image's column 0 lies, and the step to the next;
    `flat`: `_flat_table`.
    """
    wy, wx = np.empty(8, np.float32), np.empty(8, np.float32)
    w = np.empty((4, 8), np.float32)
    longest = 0
    for m in range(len(nodes) - 1):
        longest = max(longest, nodes[m + 1] - nodes[m])
    v = np.empty((3, longest + 8), np.float32)
    uneven, ends = np.empty((0, 8), np.float32), np.empty((1, 1, 2), np.int64)
    if len(places):
        uneven, ends = _uneven(position, len(image), places, shares, slack, flat)
    for i in range(out.shape[0]):
        for m in range(len(nodes) - 1):
            first, last = nodes[m] - start, nodes[m + 1] - start
            n = last - first
            l0, l1 = position[i, m, 0], position[i, m + 1, 0]
            c0, c1 = position[i, m, 1], position[i, m + 1, 1]
            served = abs(l1 - l0) <= slack and abs(c1 - c0 - n) <= slack
            if served:
                own = ends[i, m] if len(uneven) else ends[0, 0]
                served = _fast_interval(image, l0, l1, c0, c1, first, last, table, w, v, out[i], uneven, own)
            if not served:
                _slow_interval(image, l0, l1, c0, c1, first, last, table, wy, wx, out[i])


def lattice_map(exact: Callable[[Array], Array]) -> Callable[[Array, Array], Array]:
    """The mapping of a `WarpedImage` by cubics between places `_LATTICE` px apart: only there it is computed.

    Parameters
    ----------
    exact : callable
        Pixels (N, 2) of the grid to places (N, 2) in the source, smooth over some `_LATTICE`.
    """

    def mapping(lines: Array, columns: Array) -> Array:
        rows, places = _lattice(lines), _lattice(columns)
        grid = np.stack(np.meshgrid(rows, places, indexing="ij"), axis=-1).reshape(-1, 2)
        along = interpolate(rows, exact(grid).reshape(len(rows), -1), read_only(lines))
        turned = along.reshape(len(lines), len(places), 2).transpose(1, 0, 2).reshape(len(places), -1)
        out = interpolate(places, np.ascontiguousarray(turned), read_only(columns))
        return np.ascontiguousarray(out.reshape(len(columns), len(lines), 2).transpose(1, 0, 2))

    return mapping


def _lattice(places: Array) -> Array:
    """Places `_LATTICE` px apart that enclose all of `places`."""
    first, last = float(places.min()) - _LATTICE, float(places.max()) + _LATTICE
    count = max(4, math.ceil((last - first) / _LATTICE) + 1)
    return first + _LATTICE * np.arange(count, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class WarpedImage:
    """An image resampled onto the grid of another.

    Parameters
    ----------
    source : ImageSource
        The image to resample.
    mapping : callable
        ``mapping(lines, columns)`` with (n,) and (M,) pixel positions of the grid gives (n, M, 2): where each
        lies in `source`, (line, column); NaN where it does not.
    shape : (lines, columns)
        Of the grid.
    spacing : int
        Columns between the places where the map is evaluated.
    places : (source lines, 2), optional
        Where the lines of `source` stand along the track at its first and at its last column, in lines of
        even spacing: a platform that shakes scans unevenly.
    rough : tuple of float
        Columns of the grid about which the map is not smooth: it is evaluated at every second one there.
    smooth : bool
        Whether the map is worth a look for cubics between fewer places. Over relief it is not.

    Notes
    -----
    A kernel for even lines takes the motion between them for texture: what it brings lags behind the motion
    the more the finer the texture. At 0.06, 0.17 and 0.24 cycles per line 1, 6 and 15 % of a motion along the
    track were lost between whitened images.
    """

    source: ImageSource
    mapping: Callable[[Array, Array], Array]
    shape: tuple[int, int]
    spacing: int = 64
    places: Array | None = None
    rough: tuple[float, ...] = ()
    smooth: bool = True

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Resampled pixels, float32; NaN where the kernel would leave the source or meet an unusable pixel.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column) of the grid.
        """
        out = np.full((lines[1] - lines[0], columns[1] - columns[0]), np.nan, dtype=np.float32)
        nodes, position = self._positions(lines, columns)
        usable = np.isfinite(position)
        if not usable.any():
            return out
        low, high = np.nanmin(position, axis=(0, 1)), np.nanmax(position, axis=(0, 1))
        first = np.maximum(np.floor(low).astype(int) - REACH - 1, 0)
        last = np.minimum(np.ceil(high).astype(int) + REACH + 2, self.source.shape)
        if np.any(last - first < TAPS + 1):
            return out
        image, bad = self._piece((int(first[0]), int(last[0])), (int(first[1]), int(last[1])))
        moved = np.where(usable.all(axis=2, keepdims=True), position, -1e6) - first
        places, width = np.empty((0, 2)), max(self.source.shape[1] - 1, 1)
        if self.places is not None:
            places = np.ascontiguousarray(self.places[first[0] : last[0]])
        shares = np.array([first[1] / width, 1.0 / width])
        moved, numbers = np.ascontiguousarray(moved), nodes.astype(np.int64)
        _warp(image, moved, numbers, columns[0], SLACK, kernel_table(), out, places, shares, _flat_table())
        if bad is not None:
            out[_hit(bad, moved, nodes - columns[0])] = np.nan
        return out

    def _positions(self, lines: tuple[int, int], columns: tuple[int, int]) -> tuple[NDArray[np.int64], Array]:
        """Columns at which the map is evaluated, and where it leads on each line, (lines, columns, 2).

        Twice as far apart as `spacing` where the map is straight enough; of relief it never is.
        """
        rows = np.arange(*lines, dtype=np.float64)
        wide = self.spacing >= SMOOTH and columns[1] - columns[0] >= 8 * self.spacing
        for spacing in (2 * self.spacing, self.spacing)[0 if wide else 1 :]:
            nodes = np.append(np.arange(columns[0], columns[1], spacing), columns[1])
            if len(self.rough):
                about = np.rint(np.array(self.rough)[:, None] + np.arange(-ROUGH, ROUGH + 1, 2))
                about = about.astype(np.int64)
                nodes = np.union1d(nodes, about[(about > columns[0]) & (about < columns[1])])
            position = self._mapped(rows, nodes.astype(np.float64))
            if spacing == self.spacing or self._straight(nodes, position):
                break
        return nodes, position

    def _mapped(self, rows: Array, nodes: Array) -> Array:
        """The map on lines `rows` at columns `nodes`, (lines, columns, 2).

        Exactly at every fourth place only, and by cubics between them, where some lines show that these are
        as good: the lines of a smooth map are alike but for how they are moved and turned.
        """
        few = np.linspace(nodes[0], nodes[-1], len(nodes) // 4 + 1)
        if self.smooth and len(few) >= POINTS and not len(self.rough) and len(rows) > 2 * SHOWN:
            shown = rows[np.linspace(0, len(rows) - 1, SHOWN).astype(int)]
            apart = np.abs(_between(few, self.mapping(shown, few), nodes) - self.mapping(shown, nodes))
            if apart.max() < CUBIC:  # not where any is NaN
                position = _between(few, self.mapping(rows, few), nodes)
                if np.isfinite(position).all():
                    return position
        return self.mapping(rows, nodes)

    @staticmethod
    def _straight(nodes: NDArray[np.int64], position: Array) -> bool:
        """Whether the map runs with the pixels between nodes, and is as straight as `STRAIGHT` asks for."""
        if not np.isfinite(position).all():
            return False
        apart = np.diff(nodes)[:, None]
        step = np.diff(position, axis=1)
        beside = np.maximum(np.abs(step[..., 0]), np.abs(step[..., 1] - apart[:, 0]))
        bend = np.abs(np.diff(step / apart, axis=1)) * np.minimum(apart[1:], apart[:-1])
        return bool(beside.max() <= 0.5 * SLACK and bend.max() < 8.0 * STRAIGHT)

    def _piece(
        self, lines: tuple[int, int], columns: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        """Pixels of the source made finite, and which of them must not be touched (None: all may)."""
        image = self.source.read(lines, columns)
        bad = self.source.mask(lines, columns)
        finite = np.isfinite(image)
        if not finite.all():
            bad = ~finite if bad is None else bad | ~finite
            image = np.where(finite, image, np.float32(image[finite].mean() if finite.any() else 0.0))
        image = np.ascontiguousarray(image).view()
        image.setflags(write=False)  # whether it may be written to or not: the kernel is compiled once
        return image, bad if bad is not None and bad.any() else None

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """None: unusable pixels are NaN in `read`."""
        return None


def _between(few: Array, values: Array, nodes: Array) -> Array:
    """Positions (lines, columns, 2) at `nodes` of those known at `few` columns."""
    turned = np.ascontiguousarray(values.transpose(1, 0, 2)).reshape(len(few), -1)
    out = interpolate(few, turned, nodes).reshape(len(nodes), -1, 2)
    return np.ascontiguousarray(out.transpose(1, 0, 2))


def _hit(bad: NDArray[np.bool_], position: Array, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels whose kernel meets a bad pixel."""
    from scipy.ndimage import maximum_filter

    near = maximum_filter(bad, size=TAPS + 1)
    columns = np.arange(nodes[-1])
    m = np.clip(np.searchsorted(nodes, columns, side="right") - 1, 0, len(nodes) - 2)
    share = (columns - nodes[m]) / (nodes[m + 1] - nodes[m])
    at = position[:, m] + share[None, :, None] * (position[:, m + 1] - position[:, m])
    row = np.clip(np.rint(at[..., 0]).astype(int), 0, bad.shape[0] - 1)
    column = np.clip(np.rint(at[..., 1]).astype(int), 0, bad.shape[1] - 1)
    return np.asarray(near[row, column])
