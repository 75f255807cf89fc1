"""Where to match: a regular grid of windows, their texture, a subset that is strong and well spread.

Not the matching itself: see `match_images`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import only_read
from sightline.errors import InputError
from sightline.imaging.source import ImageSource, read_padded
from sightline.matching import kernels

__all__ = ["Selection", "chosen_windows", "grid_points", "select_points", "spread_subset", "texture_strength"]

#: Ways to choose among the windows of a grid (S1, claim 3).
WAYS = ("all", "textured", "spread", "listed")
#: Most cells across the field over which a well spread subset is dealt out.
CELLS_ACROSS = 8

_STRIP_PIXELS = 4_000_000


def grid_points(
    shape: tuple[int, int], *, window: tuple[int, int] = (10, 100), step: tuple[int, int] | None = None
) -> NDArray[np.float64]:
    """Centres of windows on a regular grid that lies centred in the image.

    Parameters
    ----------
    shape : (int, int)
        Lines and columns of the image.
    window : (int, int)
        Lines and columns of a window.
    step : (int, int), optional
        Lines and columns from one window to the next; the window's own size by default (side by side).

    Returns
    -------
    (N, 2) float64, (line, column), ordered by line then column; windows lie wholly inside the image, on whole
    pixels, and N is 0 when none fits.

    Examples
    --------
    >>> grid_points((20, 30), window=(10, 10)).tolist()[:2]
    [[4.5, 4.5], [4.5, 14.5]]
    """
    step = window if step is None else step
    if min(step) < 1 or min(window) < 1:
        raise InputError(
            f"grid refused: window {tuple(window)}, step {tuple(step)}; whole numbers from 1 are allowed; "
            "give pixels"
        )
    axes = []
    for size, extent, stride in zip(shape, window, step, strict=True):
        count = (size - extent) // stride + 1 if size >= extent else 0
        first = (size - extent - (count - 1) * stride) // 2 if count else 0
        axes.append(first + stride * np.arange(count) + 0.5 * (extent - 1))
    lines, columns = np.meshgrid(*axes, indexing="ij")
    return np.ascontiguousarray(np.stack([lines.ravel(), columns.ravel()], axis=1), dtype=np.float64)


def texture_strength(
    image: ImageSource, points: NDArray[np.float64], window: tuple[int, int] = (10, 100)
) -> NDArray[np.float64]:
    """How well each window can be located: the weaker direction of its structure tensor.

    Parameters
    ----------
    image : ImageSource
    points : (N, 2)
        Window centres, (line, column).
    window : (int, int)
        Lines and columns of the windows.

    Returns
    -------
    (N,) smaller eigenvalue of the mean of ``grad I grad I'``, (pixel value / px)^2; NaN where the window
    leaves the image or holds an unusable pixel.

    Notes
    -----
    S1 asks for points whose second derivatives of correlation are large in two directions; the curvature of
    the correlation peak is this tensor. One strip of lines is read at a time.
    """
    corner = np.floor(points - 0.5 * (np.array(window) - 1) + 0.5).astype(np.int64)
    strength = np.full(len(points), np.nan)
    fits = np.flatnonzero(np.all((corner >= 1) & (corner + window <= np.array(image.shape) - 1), axis=1))
    fits = fits[np.argsort(corner[fits, 0], kind="stable")]
    lines = max(_STRIP_PIXELS // image.shape[1], 4 * window[0])
    first = 0
    while first < len(fits):
        low = corner[fits[first], 0]
        last = int(np.searchsorted(corner[fits, 0], low + lines - window[0], side="right"))
        rows = fits[first:last]
        high = int(corner[rows, 0].max()) + window[0]
        pixels, unusable = read_padded(image, (int(low) - 1, high + 1), (0, image.shape[1]))
        strength[rows] = _weaker_curvature(pixels, unusable, corner[rows] - (low - 1, 0), window)
        first = last
    return strength


def _weaker_curvature(
    pixels: NDArray[np.float32],
    unusable: NDArray[np.bool_] | None,
    corner: NDArray[np.int64],
    window: tuple[int, int],
) -> NDArray[np.float64]:
    """Smaller eigenvalue of the mean gradient product of windows."""
    sums = np.empty((len(corner), 3))
    kernels.window_curvature(*only_read(pixels), corner, (int(window[0]), int(window[1])), sums)
    yy, yx, xx = (sums / (window[0] * window[1])).T
    weaker = 0.5 * (yy + xx) - np.hypot(0.5 * (yy - xx), yx)
    if unusable is not None:
        weaker[_window_sums(unusable, corner, window) > 0] = np.nan
    return np.asarray(weaker)


def _window_sums(
    values: NDArray[np.generic], corner: NDArray[np.int64], window: tuple[int, int]
) -> NDArray[np.float64]:
    """Sums of values over windows."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1, out=total[1:, 1:])
    y, x = corner[:, 0], corner[:, 1]
    h, w = window
    return np.asarray(total[y + h, x + w] - total[y, x + w] - total[y + h, x] + total[y, x])


def spread_subset(
    points: NDArray[np.float64], strength: NDArray[np.float64], count: int, cells: tuple[int, int]
) -> NDArray[np.intp]:
    """Rows of the strongest points of every cell of the image, dealt out evenly.

    Parameters
    ----------
    points : (N, 2)
    strength : (N,)
        Larger is better; NaN is never chosen.
    count : int
        How many to choose, at most.
    cells : (int, int)
        How many cells along lines and columns the box of the points is cut into.

    Returns
    -------
    (k,) sorted row numbers, k <= count

    Notes
    -----
    Maximises spread first, strength second (S1, claim 3): every cell gives its best point, then its second
    best, and so on until `count` are chosen; in the last round the strongest go first.
    """
    usable = np.flatnonzero(np.isfinite(strength))
    if not len(usable) or count <= 0:
        return np.empty(0, np.intp)
    low, high = points[usable].min(axis=0), points[usable].max(axis=0)
    place = (points[usable] - low) / np.maximum(high - low, 1e-9) * cells
    cell = np.minimum(place.astype(np.int64), np.array(cells) - 1) @ np.array([cells[1], 1])
    order = np.lexsort((-strength[usable], cell))
    starts = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1]
    lengths = np.diff(np.r_[starts, len(order)])
    turn = np.arange(len(order)) - np.repeat(starts, lengths)
    chosen = np.lexsort((-strength[usable][order], turn))[:count]
    return np.sort(usable[order][chosen])


def select_points(
    image: ImageSource,
    *,
    window: tuple[int, int] = (10, 100),
    step: tuple[int, int] | None = None,
    count: int | None = None,
    cells: tuple[int, int] = (64, 8),
    allowed: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
) -> NDArray[np.float64]:
    """Window centres worth matching, on a grid, in the order of lines.

    Parameters
    ----------
    image : ImageSource
    window : (int, int)
        Lines and columns of a window.
    step : (int, int), optional
        Grid step; the window's size by default.
    count : int, optional
        Keep at most so many, strong and well spread; all those with any texture by default.
    cells : (int, int)
        Cells along lines and columns that share the count evenly.
    allowed : callable, optional
        Which of centres (N, 2) may be chosen; all by default.

    Returns
    -------
    (N, 2) (line, column)
    """
    points = grid_points(image.shape, window=window, step=step)
    if allowed is not None:
        points = points[allowed(points)]
    strength = texture_strength(image, points, window)
    if count is None:
        return points[strength > 0]
    strength[~(strength > 0)] = np.nan
    return points[spread_subset(points, strength, count, cells)]


@dataclass(frozen=True, eq=False)
class Selection:
    """Which windows of a grid are matched.

    Attributes
    ----------
    way : str
        ``"all"``; ``"textured"``: those that can be located in two directions, the double gradient of S1;
        ``"spread"``: the strongest, evenly spread over the image; ``"listed"``: those that hold a feature.
    strength : float
        For "textured": least weaker curvature, in units of its median over the image.
    points : int
        For "spread": at most so many windows.
    features : mapping of int to (N, 2), optional
        For "listed": known features of each image, (line, column) px.
    """

    way: str = "all"
    strength: float = 1.0
    points: int = 2000
    features: Mapping[int, NDArray[np.float64]] | None = None

    def __post_init__(self) -> None:
        if self.way not in WAYS:
            raise InputError(f"`way` is {self.way!r}; allowed are {', '.join(WAYS)}")
        if self.way == "listed" and not self.features:
            raise InputError('`way` is "listed" but no features are given; list image, line, column of each')


def chosen_windows(
    image: ImageSource,
    number: int,
    centres: NDArray[np.float64],
    window: tuple[int, int],
    selection: Selection,
) -> NDArray[np.bool_]:
    """Windows that a selection takes, (G,).

    Parameters
    ----------
    image : ImageSource
        The one they are cut from, image `number`.
    centres : (G, 2)
        (line, column) px.
    window : (lines, columns)
    selection : Selection
    """
    if selection.way == "all":
        return np.ones(len(centres), dtype=bool)
    if selection.way == "listed":
        features = (selection.features or {}).get(number, np.empty((0, 2)))
        return _holding(centres, window, features)
    strength = texture_strength(image, centres, window)
    usable = strength > 0.0
    if selection.way == "textured":
        middle = float(np.median(strength[usable])) if usable.any() else np.inf
        return np.asarray(usable & (strength >= selection.strength * middle))
    strength[~usable] = np.nan
    chosen = np.zeros(len(centres), dtype=bool)
    # two windows of a cell at least: else the strongest cells would take all
    across = max(min(CELLS_ACROSS, int(np.sqrt(selection.points))), 1)
    cells = (max(selection.points // (2 * across), 1), across)
    chosen[spread_subset(centres, strength, selection.points, cells)] = True
    return chosen


def _holding(
    centres: NDArray[np.float64], window: tuple[int, int], features: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Windows within which a feature lies."""
    half = 0.5 * np.array(window)
    found = np.zeros(len(centres), dtype=bool)
    for feature in features:
        found |= np.all(np.abs(centres - feature) <= half, axis=1)
    return found
