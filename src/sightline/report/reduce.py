"""Long curves and large maps cut down to what a page can show, nothing visible lost.

Not here: how they are drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Points of a curve up to which it is drawn whole; most cells of a map along the strip.
POINTS, CELLS = 1000, 400


def outline_rows(x: Array, y: Array) -> NDArray[np.intp]:
    """Points of a curve (px) that keep its outline: the lowest and the highest in each px of x.

    Returns
    -------
    (M,) int
        Increasing; all points where they are few, or where x turns back.
    """
    n = len(x)
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if n <= POINTS or (np.diff(x[known]) < 0.0).any():
        return np.arange(n)
    column = np.floor(x[known])
    order = np.lexsort((y[known], column))
    start = np.flatnonzero(np.diff(column[order], prepend=-np.inf))
    stop = np.append(start[1:], len(order)) - 1
    # the gaps stay: a curve is not drawn across what is missing
    gaps = np.flatnonzero(~(np.isfinite(x) & np.isfinite(y)))
    return np.unique(np.concatenate([known[order[start]], known[order[stop]], gaps, [0, n - 1]]))


def cell_edges(rows: int, cells: int = CELLS) -> NDArray[np.intp]:
    """First rows of at most `cells` cells, and the number of rows at the end."""
    return np.linspace(0, rows, min(rows, cells) + 1).astype(int)


def cell_means(values: Array, edges: NDArray[np.intp]) -> Array:
    """Mean of the finite values (rows, columns) in each cell: (cells, columns), NaN if there is none."""
    finite = np.isfinite(values)
    total = np.add.reduceat(np.where(finite, values, 0.0), edges[:-1], axis=0)
    count = np.add.reduceat(finite.astype(np.intp), edges[:-1], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, total / count, np.nan)


def cell_modes(codes: NDArray[np.uint8], edges: NDArray[np.intp], kinds: int) -> NDArray[np.uint8]:
    """The most frequent of `kinds` codes (rows, columns) in each cell of rows: (cells, columns)."""
    counts = [np.add.reduceat((codes == kind).astype(np.intp), edges[:-1], axis=0) for kind in range(kinds)]
    return np.argmax(np.stack(counts), axis=0).astype(np.uint8)


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every unbroken run of True."""
    padded = np.concatenate([[False], flags, [False]]).astype(np.int8)
    change = np.diff(padded)
    return list(
        zip(np.flatnonzero(change == 1).tolist(), (np.flatnonzero(change == -1) - 1).tolist(), strict=True)
    )
