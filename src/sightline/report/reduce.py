"""Long curves and large maps cut down to what a page can show, nothing visible lost.

Not here: how they are drawn.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Most points of one curve, and most cells of a map along the strip.
POINTS, CELLS = 3000, 400


def envelope_rows(values: Array, points: int = POINTS) -> NDArray[np.intp]:
    """Rows of `values` (N,) that keep its outline: the smallest and the largest of every short piece.

    Returns
    -------
    (M,) int
        Increasing; all rows where there are no more than `points`.
    """
    n = len(values)
    if n <= points:
        return np.arange(n)
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    rows = [
        start + extreme
        for start, stop in pairwise(edges)
        for extreme in (int(np.argmin(values[start:stop])), int(np.argmax(values[start:stop])))
    ]
    return np.unique(np.append(rows, [0, n - 1]))


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
