"""A prior whose slow drift has unknowns of its own, so that long gaps are bridged as they should be.

One autoregression on a fine grid looks back some tens of epochs. Under broadband jitter that is too
short to know the slope of a slow drift, and what it says across a gap longer than its memory is
neither right nor honest. Here the drift lives on a coarse grid, interleaved with the fine one, and
the autoregression holds only what is fast:

    x = P c + z,   z fast on the fine grid, c slow on the coarse one, P interpolation.

The unknowns are x and c; the data see x alone. Everything stays banded.

Not here: the plain prior (``prior.py``), which is enough where data are dense.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.errors import InputError
from sightline.estimation.banded import ROWS_AT_ONCE, BorderedFactor
from sightline.estimation.prior import NUGGET, Autoregressive, Matern, Spectrum, autoregressive
from sightline.execution import slices
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Order of the autoregression of the drift on its own grid: a sampled Matern 5/2 has three poles and a
#: zero at -0.43, of which the sixth power is below 1 %.
SLOW_ORDER = 6
#: Coarse steps per timescale of the drift, least and most: below 12 the cubic interpolation would show
#: (1e-3 of the drift), above 60 the drift is predictable to the last digit.
RESOLUTION = (12.0, 60.0)
#: Taps of the interpolation between coarse nodes.
TAPS = 4


@dataclass(frozen=True, eq=False)
class SplitPrior:
    """Fast and slow part of one process of n epochs.

    Build it with `split`.

    Attributes
    ----------
    fast : Autoregressive
        z, on the fine grid.
    slow : Autoregressive
        c, on the coarse grid.
    ratio : int
        Fine steps per coarse step; coarse node j stands at fine node ``ratio * j``.
    """

    fast: Autoregressive
    slow: Autoregressive
    ratio: int

    @property
    def n(self) -> int:
        """Number of fine epochs."""
        return self.fast.n

    @property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the joint precision of (x, c), unit row weights."""
        return self.fast.logdet + self.slow.logdet

    def width(self, layout: Layout, axis: int = 0) -> int:
        """Subdiagonals that the joint precision needs in a layout."""
        fine, coarse = layout.fine[:, axis], layout.coarse[:, axis]
        first, _ = _interpolation(0, self.n, self.slow.n, self.ratio)
        earliest = np.maximum(np.arange(self.n) - self.fast.order, 0)
        low = np.minimum(fine[earliest], coarse[first[earliest]])
        high = np.maximum(fine, coarse[first + TAPS - 1])
        q = self.slow.order
        return int(max(np.max(high - low), np.max(coarse[q:] - coarse[: len(coarse) - q])))

    def add_to(
        self, band: Array, layout: Layout, axis: int = 0, weights: Array | None = None, begin: int = 0
    ) -> None:
        """Add the joint precision of (x, c) to a lower band in a layout, in place.

        Parameters
        ----------
        band : array (b + 1, m)
            With b at least `width`: the columns from `begin` on of a band of `layout.size` columns.
        layout : Layout
            Where the unknowns stand.
        axis : int
            Which process of the layout this is the prior of.
        weights : array (n,), optional
            Of the fast innovations; see `Autoregressive.precision_band`.
        begin : int
            Column of the whole band that is the first of `band`.
        """
        fine = np.ascontiguousarray(layout.fine[:, axis])
        coarse = np.ascontiguousarray(layout.coarse[:, axis])
        end = begin + band.shape[1]
        for process, place, own in ((self.fast, fine, weights), (self.slow, coarse, None)):
            low, high = np.searchsorted(place, (begin, end)).tolist()
            if low < high:
                spread_columns(process.precision_columns(low, high, own), place, low, band, begin)
        # rows of which some unknown stands in these columns, and the epochs that they look back on: of all
        # epochs, as often as there are pieces of columns, these would cost the square of their number
        order, near = self.fast.order, self.fast.order + TAPS * self.ratio
        low, high = np.searchsorted(fine, (begin, end)).tolist()
        since, until = max(low - near - order, 0), min(high + near, self.n)
        first, taps = _interpolation(since, until, self.slow.n, self.ratio)
        places = np.ascontiguousarray(fine[since:until])
        earliest = np.maximum(np.arange(until - since) - order, 0)
        lowest = np.minimum(places[earliest], coarse[first[earliest]])
        highest = np.maximum(places, coarse[first + TAPS - 1])
        rows = np.flatnonzero((highest >= begin) & (lowest < end))
        if len(rows):
            some = slice(since, until)
            row_weights = 1.0 if weights is None else weights[some]
            row_weights = row_weights / self.fast.variances[some]
            span = (int(rows[0]), int(rows[-1]) + 1)
            _add_coarse(self.fast.table, row_weights, first, taps, places, coarse, since, span, begin, band)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where fine and coarse unknowns of one or more processes stand among all unknowns.

    Attributes
    ----------
    fine : (n, block)
        Position of epoch k of each process.
    coarse : (m, block)
        Position of coarse node j of each process, just before fine epoch ``ratio * j``.
    """

    fine: Index
    coarse: Index

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.fine.size + self.coarse.size

    @classmethod
    def interleaved(cls, n: int, ratio: int, *, block: int = 1, slow: int | None = None) -> Layout:
        """Layout of n epochs of `block` processes; the first `slow` of them (all) have coarse nodes."""
        slow = block if slow is None else slow
        k = np.arange(n, dtype=np.int64)
        j = np.arange(coarse_count(n, ratio), dtype=np.int64)
        fine = (k * block + (k // ratio + 1) * slow)[:, None] + np.arange(block)
        coarse = (np.minimum(j * ratio, n) * block + j * slow)[:, None] + np.arange(slow)
        return cls(fine, coarse)


class LaidFactor:
    """A factor of fine and coarse unknowns that answers for the fine ones alone, in their own order.

    Parameters
    ----------
    factor : BorderedFactor
        Of all unknowns.
    position : (n,)
        Where the fine unknowns stand among them, rising.
    """

    def __init__(self, factor: BorderedFactor, position: Index) -> None:
        self._factor = factor
        self._position = position

    @property
    def n(self) -> int:
        """Number of fine unknowns."""
        return len(self._position)

    @property
    def q(self) -> int:
        """Number of unknowns of the border."""
        return self._factor.q

    @property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the whole matrix, coarse unknowns included."""
        return self._factor.logdet

    @property
    def border_covariance(self) -> Array:
        """The (q, q) block of the inverse that belongs to the border."""
        return self._factor.border_covariance

    def solve(self, b: Array, d: Array) -> tuple[Array, Array]:
        """Fine unknowns (n,) or (n, k) and border (q,) or (q, k) for such right sides."""
        spread, fine = (scratch_array((n, *b.shape[1:])) for n in (self._factor.n, self.n))
        for some in slices(self.n, ROWS_AT_ONCE):
            spread[self._position[some]] = b[some]
            let_go()
        x, y = self._factor.solve(spread, d)
        for some in slices(self.n, ROWS_AT_ONCE):
            fine[some] = x[self._position[some]]
            let_go()
        return fine, y

    def times(self, directions: Array) -> tuple[Array, Array]:
        """Inverse times [directions; 0]: its (n, k) and (q, k) parts; `directions` is (n, k) or (n,)."""
        return self.solve(directions, np.zeros((self.q, *directions.shape[1:])))

    def row_variance(self, rows: Any, beside: Array) -> Array:
        """As `BorderedFactor.row_variance`, of rows of the fine unknowns."""
        from scipy.sparse import csr_array

        rows = rows.tocsr()
        shape = (rows.shape[0], self._factor.n)
        laid = csr_array((rows.data, self._position[rows.indices], rows.indptr), shape=shape)
        return self._factor.row_variance(laid, beside)

    def covariance_band(self, width: int) -> Array:
        """Band of the covariance of the fine unknowns, ``out[d, j]``, shape (width + 1, n)."""
        reach = farthest(self._position, width)
        return gather_band(self._factor.covariance_band(reach), self._position, width)


def farthest(position: Index, width: int) -> int:
    """Most places between two fine unknowns that are up to `width` apart in their own order."""
    near = min(width, len(position) - 1)
    return int(np.max(position[near:] - position[: len(position) - near]))


def coarse_count(n: int, ratio: int) -> int:
    """Coarse nodes that span n fine epochs, enough to interpolate."""
    return max(TAPS, -(-(n - 1) // ratio) + 1)


def split(
    spectrum: Spectrum, step: float, order: int, n: int, *, width: int = 0, ratio: int | None = None
) -> SplitPrior | None:
    """The prior with its slow drift apart, or None where nothing is slow (or nothing is fast).

    Parameters
    ----------
    spectrum : Spectrum
        Its Matern 5/2 parts much longer than the autoregression's memory are the drift.
    step : float
        s; of the fine grid.
    order : int
        Of the fast autoregression.
    n : int
        Fine epochs.
    width : int
        Subdiagonals that the data need anyway: the coarse step is chosen to stay within.
    ratio : int, optional
        Fine steps per coarse step, where several processes must share it.
    """
    slow = [c for c in spectrum.components if _is_slow(c, step, order)]
    fast = [c for c in spectrum.components if not _is_slow(c, step, order)]
    if not slow or not fast:
        return None
    if ratio is None:
        ratio = coarse_ratio(spectrum, step, order, width=width)
    if ratio is None or n < 3 * ratio:
        return None
    slow_part, fast_part = Spectrum(tuple(slow)), Spectrum(tuple(fast))
    order = min(order, n - 1)
    covariance = fast_part.autocovariance(step * np.arange(order + 1, dtype=np.float64))
    nugget = NUGGET * max(1.0, (spectrum.sigma / fast_part.sigma) ** 2)
    coarse = slow_part.autoregressive(step * ratio, SLOW_ORDER, coarse_count(n, ratio))
    return SplitPrior(autoregressive(covariance, order, n, nugget=nugget), coarse, ratio)


def coarse_ratio(spectrum: Spectrum, step: float, order: int, *, width: int = 0) -> int | None:
    """Fine steps per coarse step that suit the drift of a spectrum; None where it has none."""
    times = [c.timescale for c in spectrum.components if isinstance(c, Matern) and _is_slow(c, step, order)]
    if not times:
        return None
    steps = min(times) / step
    wanted = max(width - order, 0) // (SLOW_ORDER + 1)
    return int(np.clip(wanted, math.ceil(max(times) / step / RESOLUTION[1]), max(4, steps // RESOLUTION[0])))


def spread_band(band: Array, position: Index, out: Array) -> None:
    """Add a symmetric band (b + 1, n) of unknowns that stand at rising positions (n,) to a larger band."""
    if len(position) != band.shape[1]:
        raise InputError(f"`position` must hold {band.shape[1]} places, got {len(position)}")
    spread_columns(band, position, 0, out, 0)


def spread_columns(band: Array, position: Index, first: int, out: Array, begin: int) -> None:
    """Add some columns of a symmetric band to some columns of a larger one.

    Parameters
    ----------
    band : (b + 1, m)
        Its columns from number `first` on.
    position : (n,)
        Where all its unknowns stand in the larger band, rising.
    first : int
    out : (c + 1, k)
        Columns from `begin` on of the larger band: all those in which the m unknowns stand.
    begin : int
    """
    _spread(band, position[first:], out, begin)


def gather_band(band: Array, position: Index, width: int) -> Array:
    """Part of a symmetric band that belongs to the unknowns at rising positions (n,): (width + 1, n)."""
    n = len(position)
    out = scratch_array((width + 1, n))
    for d in range(min(width, n - 1) + 1):
        for some in slices(n - d, ROWS_AT_ONCE):
            here = position[some]
            out[d, some] = band[position[some.start + d : some.stop + d] - here, here]
        let_go()
    return out


def _is_slow(component: object, step: float, order: int) -> bool:
    """Whether a part of a spectrum is drift to a fine grid: long against the memory of its autoregression."""
    if not isinstance(component, Matern) or component.order != "5/2":
        return False
    return component.timescale > max(48.0, 1.5 * order) * step


def _interpolation(since: int, until: int, coarse: int, ratio: int) -> tuple[Index, Array]:
    """First coarse node (n,) and cubic weights (n, 4) of the n fine epochs from `since` up to `until`."""
    x = np.arange(since, until) / ratio
    first = np.clip(np.floor(x).astype(np.int64) - 1, 0, coarse - TAPS)
    u = x - first
    weights = np.stack([
        -(u - 1) * (u - 2) * (u - 3) / 6, u * (u - 2) * (u - 3) / 2,
        -u * (u - 1) * (u - 3) / 2, u * (u - 1) * (u - 2) / 6,
    ], axis=1)  # fmt: skip
    return first, weights


@njit(cache=True, nogil=True)
def _spread(band, position, out, begin):  # type: ignore[no-untyped-def]
    """Add columns of a band to those of another from `begin` on, unknown i going to position[i]."""
    n = len(position)
    for d in range(min(band.shape[0], n)):
        for i in range(min(n - d, band.shape[1])):
            out[position[i + d] - position[i], position[i] - begin] += band[d, i]


@njit(cache=True, nogil=True)
def _add_coarse(table, weights, first, taps, fine, coarse, since, span, begin, band):  # type: ignore[no-untyped-def]
    """Blocks (fine, coarse) and (coarse, coarse) of the sum of innovation rows of z = x - P c.

    Of the rows `span`, into the columns of the whole from `begin` on that `band` holds. Rows and all that is
    known of epochs are counted from epoch `since` on.
    """
    p, end = table.shape[0] - 1, begin + band.shape[1]
    window = np.zeros(p + 3 * taps.shape[1])
    for t in range(span[0], span[1]):
        m = min(since + t, p)
        row = table[m]
        base = first[t - m]
        size = first[t] + taps.shape[1] - base
        for j in range(size):
            window[j] = 0.0
        for k in range(m + 1):
            for i in range(taps.shape[1]):
                window[first[t - k] - base + i] += row[k] * taps[t - k, i]
        for j in range(size):
            cj = coarse[base + j]
            scaled = weights[t] * window[j]
            for k in range(m + 1):
                f = fine[t - k]
                column = min(f, cj)
                if begin <= column < end:
                    band[max(f, cj) - column, column - begin] -= scaled * row[k]
            for i in range(j + 1):
                ci = coarse[base + i]
                if begin <= ci < end:
                    band[cj - ci, ci - begin] += scaled * window[i]
