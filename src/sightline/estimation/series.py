"""One axis of differences ``x(t + lag) - x(t)`` as normal equations on an even time grid.

A measurement is a row of local interpolation weights at its own two times, averaged over the
length of its matching window. Measurements of one patch of ground share the errors of the images
they share: three images give three pairs but only two independent errors, so a pair that closes
a triangle adds nothing (docs/theory/s1.md) and is left out where it is exactly redundant.

Not here: the inner loops (``series_kernels.py``), the prior (``prior.py``), the solution (``evidence.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import only_read
from sightline.errors import InputError
from sightline.estimation.prior import Spectrum, Tone
from sightline.estimation.series_kernels import TAPS, accumulate, fill_grid_weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Variances beyond this multiple of the median carry no information and are left out.
UNOBSERVED = 1e8


@dataclass(frozen=True, eq=False)
class DifferenceSeries:
    """Measured differences of one scalar motion between the two images of one pair.

    Attributes
    ----------
    t : (N,)
        s; time in image a.
    lag : (N,)
        s; time in image b minus time in image a.
    values : (N,)
        ``x(t + lag) - x(t)``, each averaged over the window; any unit.
    variance : (N,)
        Of `values`; infinite where nothing was observed.
    images : (int, int), optional
        Which images a and b are. Series that name the same image share its error.
    window : float
        s; length over which the matching window averages the motion.
    tdi : (float, float)
        s; over which what is in the window averages the motion by itself, in image a and in image b (TDI).
    window_most : float
        s; windows of coarse lines, whose filter mixes neighbouring ones, may average over as much as this; 0:
        `window` is what they do.
    patch : (N,) of int, optional
        Ground patch of each measurement: equal numbers in two series mean the same piece of ground.
    """

    t: Array
    lag: Array
    values: Array
    variance: Array
    images: tuple[int, int] | None = None
    window: float = 0.0
    patch: Index | None = None
    tdi: tuple[float, float] = (0.0, 0.0)
    window_most: float = 0.0

    def __post_init__(self) -> None:
        shapes = {np.shape(a) for a in (self.t, self.lag, self.values, self.variance)}
        if len(shapes) != 1 or len(shapes.pop()) != 1:
            raise InputError(
                "`t`, `lag`, `values` and `variance` must all have shape (N,), got "
                f"{[np.shape(a) for a in (self.t, self.lag, self.values, self.variance)]}"
            )
        if self.patch is not None and np.shape(self.patch) != np.shape(self.t):
            raise InputError(f"`patch` must have shape {np.shape(self.t)}, got {np.shape(self.patch)}")

    @property
    def whole(self) -> float:
        """s; from the first to the last instant of an average."""
        return self.window + max(self.tdi)

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """(N,) where the measurement is finite and says something."""
        finite = np.isfinite(self.t) & np.isfinite(self.lag) & np.isfinite(self.values)
        finite &= np.isfinite(self.variance) & (self.variance > 0.0)
        if finite.any():
            finite &= self.variance < UNOBSERVED * np.median(self.variance[finite])
        return finite


@dataclass(frozen=True)
class Grid:
    """Even time grid of the unknown motion: nodes ``start + step * k`` (s), k = 0 .. count - 1."""

    start: float
    step: float
    count: int

    @property
    def nodes(self) -> Array:
        """(count,) s."""
        return self.start + self.step * np.arange(self.count, dtype=np.float64)

    @classmethod
    def covering(cls, first: float, last: float, step: float) -> Grid:
        """Grid with a node at `first` that reaches beyond `last` and holds enough nodes to interpolate."""
        count = math.ceil((last - first) / step * (1.0 - 1e-12) - 1e-9) + 1
        return cls(first, step, max(count, TAPS))

    def weights(self, t: Array, window: float = 0.0, tdi: float = 0.0) -> tuple[Index, Array]:
        """First node (N,) and weights (N, K) that interpolate at `t` (N,), averaged over `window` (s).

        And over `tdi` (s) besides, as in `DifferenceSeries`.
        """
        (t,) = only_read(np.asarray(t, dtype=np.float64))
        first = np.empty(len(t), dtype=np.int64)
        weights = np.empty((len(t), _support(window + tdi, self.step, self.count)))
        fill_grid_weights(t, float(window), float(tdi), self.start, self.step, self.count, first, weights)
        return first, weights


@dataclass(frozen=True, eq=False)
class SeriesEquations:
    """What a set of series says about the motion on a grid, and about a constant per image.

    With rows H (motion) and J (constants), measurements y and their covariance R:

    Attributes
    ----------
    grid : Grid
    band : (b + 1, n)
        H' R^-1 H, lower band.
    rhs : (n,)
        H' R^-1 y.
    border : (n, q), corner : (q, q), rhs_border : (q,)
        H' R^-1 J, J' R^-1 J, J' R^-1 y; q is 0 where the constants are known.
    misfit : float
        y' R^-1 y.
    logdet_noise : float
        log det R of the independent measurements.
    measurements : int
        How many those are.
    """

    grid: Grid
    band: Array
    rhs: Array
    border: Array
    corner: Array
    rhs_border: Array
    misfit: float
    logdet_noise: float
    measurements: int


def series_equations(
    series: Sequence[DifferenceSeries],
    grid: Grid,
    *,
    offsets: bool = False,
    independent: float = 0.0,
    spectrum: Spectrum | None = None,
) -> SeriesEquations:
    """Sum all measurements of all series on `grid`.

    Parameters
    ----------
    series : sequence of DifferenceSeries
        All in one unit. Their times must lie on the grid.
    grid : Grid
        Of the unknown motion.
    offsets : bool
        Whether every image has an unknown constant of its own (a pair measures their difference);
        a series without `images` has one for itself.
    independent : float
        Fraction of every pair's variance that it shares with no other pair (0: the errors of the
        images explain all; measured on rendered scenes: about 0.1).
    spectrum : Spectrum, optional
        Of the motion: what it does between the nodes of the grid then counts as an error of each
        image (nothing where measurements fall on nodes).

    Raises
    ------
    InputError
        If there is no usable measurement or one lies outside the grid.
    """
    flat = _flatten(series, independent)
    if spectrum is not None:
        flat = _with_interpolation_error(flat, grid, spectrum)
    last = grid.start + grid.step * (grid.count - 1)
    times = np.concatenate([flat.t_a, flat.t_b])
    if len(times) == 0:
        raise InputError("no series holds a finite measurement; check the matches of every pair")
    slack = 0.5 * grid.step + 0.5 * max(s.whole for s in series)
    if times.min() < grid.start - slack or times.max() > last + slack:
        raise InputError(
            f"measurements from {times.min():.6g} to {times.max():.6g} s lie outside the grid "
            f"[{grid.start:.6g}, {last:.6g}] s; extend the grid or drop them"
        )
    support = _support(float(flat.whole.max()), grid.step, grid.count)
    reach = int(np.ceil(_longest_span(flat) / grid.step)) + support
    band = np.zeros((min(reach, grid.count - 1) + 1, grid.count))
    columns = flat.constants if offsets else 0
    border = np.zeros((grid.count, columns))
    corner = np.zeros((columns, columns))
    rhs, rhs_border = np.zeros(grid.count), np.zeros(columns)
    misfit, logdet, used = accumulate(
        flat.starts, flat.t_a, flat.t_b, flat.window, flat.tdi_a, flat.tdi_b, flat.values,
        flat.image_a, flat.image_b,
        flat.variance_a, flat.variance_b, flat.variance_own, grid.start, grid.step, support,
        band, rhs, border, corner, rhs_border,
    )  # fmt: skip
    return SeriesEquations(grid, band, rhs, border, corner, rhs_border, misfit, logdet, used)


@dataclass(frozen=True, eq=False)
class _Flat:
    """All measurements, those of one patch side by side; `starts` marks the patches."""

    starts: Index
    t_a: Array
    t_b: Array
    window: Array
    tdi_a: Array
    tdi_b: Array
    values: Array
    image_a: Index
    image_b: Index
    variance_a: Array  # of image a at this patch
    variance_b: Array
    variance_own: Array  # of this pair alone
    constants: int

    @property
    def whole(self) -> Array:
        """(N,) s; from the first to the last instant of an average."""
        return self.window + np.maximum(self.tdi_a, self.tdi_b)


def _flatten(series: Sequence[DifferenceSeries], independent: float) -> _Flat:
    """Measurements of all series, grouped by patch, with their variance split over the images."""
    shares = image_variances(series)
    names = {image: k for k, image in enumerate(shares)}
    constants = len(names)
    patches = [np.max(s.patch, initial=0) for s in series if s.patch is not None]
    next_patch = 1 + int(max(patches, default=0))
    columns: list[list[NDArray[np.generic]]] = []
    for s in series:
        use = s.used
        count = int(use.sum())
        if s.images is None:  # two images of its own, shared with nobody
            a, b, s_a, s_b = constants, constants + 1, 0.5, 0.5
            constants += 2
        else:
            a, b = names[s.images[0]], names[s.images[1]]
            s_a, s_b = shares[s.images[0]], shares[s.images[1]]
        if s.patch is None or s.images is None:
            patch = next_patch + np.arange(count)
            next_patch += count
        else:
            patch = np.asarray(s.patch, dtype=np.int64)[use]
        own_constants: list[list[float]] = [[s.window], [s.tdi[0]], [s.tdi[1]], [a], [b], [s_a], [s_b]]
        constant = np.broadcast_to(own_constants, (7, count))
        columns.append([patch, s.t[use], s.lag[use], s.values[use], s.variance[use], *constant])
    patch, t, lag, values, variance, window, tdi_a, tdi_b, image_a, image_b, s_a_all, s_b_all = (
        np.concatenate(parts) for parts in zip(*columns, strict=True)
    )
    order = np.argsort(patch, kind="stable")
    starts = np.append(np.flatnonzero(np.diff(patch[order], prepend=-1)), len(patch))
    expected = (s_a_all + s_b_all)[order]
    shared, own = _split_variance(variance[order], expected, starts, independent)
    return _Flat(
        starts.astype(np.int64), t[order], (t + lag)[order], window[order], tdi_a[order],
        tdi_b[order], values[order],
        image_a[order].astype(np.int64), image_b[order].astype(np.int64),
        shared * s_a_all[order] / expected, shared * s_b_all[order] / expected, own, constants,
    )  # fmt: skip


def _with_interpolation_error(flat: _Flat, grid: Grid, spectrum: Spectrum) -> _Flat:
    """The measurements with what the motion does between nodes added to the variance of each image.

    A tone counts as a pure one: what models the wandering of its phase has tails beyond what a real mode may
    have, and they would dominate.
    """
    bins = 32
    parts = [replace(c, bandwidth=1e-9) if isinstance(c, Tone) else c for c in spectrum.components]
    spectrum = Spectrum(tuple(parts))
    extra = [np.zeros(len(flat.values)), np.zeros(len(flat.values))]
    sides = ((flat.t_a, flat.tdi_a), (flat.t_b, flat.tdi_b))
    every = np.stack([np.tile(flat.window, 2), np.concatenate([flat.tdi_a, flat.tdi_b])], axis=1)
    for window, tdi in np.unique(every, axis=0):
        table = interpolation_variance(spectrum, grid.step, float(window), np.arange(bins) / bins, float(tdi))
        for k, (t, own) in enumerate(sides):
            same = (flat.window == window) & (own == tdi)
            place = (t[same] - grid.start) / grid.step * bins
            extra[k][same] = table[np.rint(place).astype(np.int64) % bins]
    return replace(flat, variance_a=flat.variance_a + extra[0], variance_b=flat.variance_b + extra[1])


def interpolation_variance(
    spectrum: Spectrum, step: float, window: float, fraction: Array, tdi: float = 0.0
) -> Array:
    """Variance (N,) of a windowed motion less its interpolation from a grid of `step` (s).

    Parameters
    ----------
    spectrum : Spectrum
        Of the motion.
    step, window : float
        s.
    fraction : (N,)
        Where the centre of the window stands between two nodes, in steps.
    tdi : float
        s; over which what is in the window averages by itself.
    """
    grid = Grid(0.0, step, 2 * TAPS + _support(window + tdi, step, 10**9))
    centre = (grid.count // 2 + np.asarray(fraction)) * step
    first, weights = grid.weights(centre, window, tdi)
    whole = window + tdi
    points = 1 if whole <= 0.0 else 2 + 4 * math.ceil(whole / step)
    offsets = whole * ((np.arange(points) + 0.5) / points - 0.5)
    shares = np.full(points, 1.0 / points)
    if tdi > 0.0 and window > 0.0:
        shares = np.minimum(1.0, (0.5 * whole - np.abs(offsets)) / min(window, tdi))
        shares /= shares.sum()
    out = np.empty(len(centre))
    for k, t in enumerate(centre):
        at = np.concatenate([t + offsets, (first[k] + np.arange(weights.shape[1])) * step])
        row = np.concatenate([shares, -weights[k]])
        out[k] = row @ spectrum.autocovariance(at[:, None] - at) @ row
    return np.maximum(out, 0.0)


def _split_variance(
    variance: Array, expected: Array, starts: Index, independent: float
) -> tuple[Array, Array]:
    """Part of each variance that stems from the images, and part of this pair alone.

    All pairs of a patch see the same texture, so one factor per patch scales the images' variances
    (exact closure needs that). A pair far above it (x 3) keeps the excess to itself.
    """
    image_part = _patch_scale(variance / expected, starts) * expected
    poor = variance > 3.0 * image_part
    shared = (1.0 - independent) * image_part
    own = np.where(poor, variance - shared, independent * image_part)
    alone = np.repeat(np.diff(starts) == 1, np.diff(starts))
    return np.where(alone, variance, shared), np.where(alone, 0.0, own)


def _patch_scale(ratio: Array, starts: Index) -> Array:
    """Per measurement, the median over its patch of measured over expected variance."""
    sizes = np.diff(starts)
    out = ratio.copy()
    for size in np.unique(sizes):
        if size == 1:
            continue
        rows = starts[:-1][sizes == size][:, None] + np.arange(size)
        out[rows] = np.median(ratio[rows], axis=1)[:, None]
    return out


def image_variances(series: Sequence[DifferenceSeries]) -> dict[int, float]:
    """Error variance of each named image, from those of the pairs.

    A pair's variance is the sum of those of its images. With three or more images in closed
    triangles that determines them; what stays open is shared evenly.
    """
    named = [s for s in series if s.images is not None and s.used.any()]
    if not named:
        return {}
    images = sorted({i for s in named for i in s.images or ()})
    column = {image: k for k, image in enumerate(images)}
    variance = np.array([float(np.median(s.variance[s.used])) for s in named])
    rows = np.zeros((len(named), len(images)))
    for k, s in enumerate(named):
        for image in s.images or ():
            rows[k, column[image]] += 1.0
    mean = 0.5 * float(np.mean(variance))
    weak = 1e-3 * np.eye(len(images))
    system = np.vstack([rows / variance[:, None] * mean, weak])
    target = np.concatenate([np.full(len(named), 1.0), np.full(len(images), 1e-3)])
    solution = mean * np.linalg.lstsq(system, target, rcond=None)[0]
    return dict(zip(images, np.maximum(solution, 0.02 * mean).tolist(), strict=True))


def _longest_span(flat: _Flat) -> float:
    """Longest time between two instants that meet in one row or one patch (s)."""
    low = np.minimum(flat.t_a, flat.t_b) - 0.5 * flat.whole
    high = np.maximum(flat.t_a, flat.t_b) + 0.5 * flat.whole
    starts = flat.starts[:-1]
    return float(np.max(np.maximum.reduceat(high, starts) - np.minimum.reduceat(low, starts)))


def _support(window: float, step: float, count: int) -> int:
    """Nodes that one averaged interpolation may touch."""
    return int(min(count, TAPS + (math.ceil(window / step - 1e-9) if window > 0.0 else 0)))
