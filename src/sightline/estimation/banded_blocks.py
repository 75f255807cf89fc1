"""A banded system with a border, eliminated a stretch of columns at a time; the factor lies on disk.

What is solved is the same as `BorderedFactor` solves; memory is that of one stretch, however many there are.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_triangular
from scipy.linalg.lapack import dtbtrs

from sightline.errors import EstimationError, InputError
from sightline.estimation.banded import inverse_columns

Array = NDArray[np.float64]


class BlockwiseFactor:
    """Cholesky factor of a symmetric positive definite banded matrix M that is made block by block.

    Parameters
    ----------
    folder : Path
        Where the factor is kept; nothing else may write there.
    subdiagonals : int
        Width b of the band below the diagonal.
    columns : int
        Right-hand sides R (n, columns) that go along.
    """

    def __init__(self, folder: Path, subdiagonals: int, columns: int) -> None:
        self._folder, self._b = folder, subdiagonals
        self._blocks = 0
        self._carried = np.zeros((0, 0)), np.zeros((0, columns))
        #: R' inv(M) R (columns, columns) of what was eliminated.
        self.gram = np.zeros((columns, columns))

    def eliminate(self, band: Array, right: Array, count: int) -> None:
        """Eliminate the next unknowns.

        Parameters
        ----------
        band : (b + 1, n)
            What is added to the matrix at the next n unknowns, lower band storage.
        right : (n, columns)
            What is added to the right-hand sides there.
        count : int
            How many of them are eliminated: nothing is added to these later. The other n - count are the
            first of the next block.

        Raises
        ------
        EstimationError
            If the matrix is not positive definite.
        """
        b, total = self._b, band.shape[1]
        held, held_right = self._carried
        if band.shape[0] != b + 1 or not 0 < count <= total or len(held) > total or total - count > b:
            raise InputError(f"blocks do not fit together: {band.shape}, {count} of {total}, {len(held)}")
        band, right = np.array(band), np.array(right)
        for d in range(len(held)):
            band[d, : len(held) - d] += np.diagonal(held, -d)
        right[: len(held)] += held_right
        try:
            lower = cholesky_banded(band[:, :count], lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            raise EstimationError(
                "the normal equations are not positive definite: some unknown is hardly seen, or sigmas are "
                "looser than can be weighed; give every unknown a prior or a measurement, and smaller sigmas "
                "of heights, offsets and rotations"
            ) from None
        solved = dtbtrs(lower, right[:count], uplo="L")[0]
        self.gram += solved.T @ solved
        bridge = self._bridge(band, lower, count)
        near = bridge.shape[1]
        rest = _dense(band[:, count:])[: total - count]
        self._carried = (
            np.tril(rest) + np.tril(rest, -1).T - bridge @ bridge.T,
            right[count:] - bridge @ solved[count - near :],
        )
        np.save(self._folder / f"lower-{self._blocks}.npy", lower)
        np.save(self._folder / f"right-{self._blocks}.npy", solved)
        self._blocks += 1

    def _bridge(self, band: Array, lower: Array, count: int) -> Array:
        """Rows of the factor below the block (total - count, near), which are written into `lower` too."""
        near, after = min(self._b, count), band.shape[1] - count
        dense = _dense(lower[:, count - near :])
        corner = dense[:near]
        below = _dense(band[:, count - near : count])[near : near + after]
        bridge = np.asarray(solve_triangular(corner, below.T, lower=True, check_finite=False).T)
        dense[near:] = 0.0
        dense[near : near + after] = bridge
        lower[:, count - near :] = _columns(dense, self._b + 1)
        return bridge

    def backward(self, combine: Array, width: int | None = None) -> Iterator[tuple[int, Array, Array]]:
        """Solutions inv(M) R `combine`, the last block first.

        Parameters
        ----------
        combine : (columns, k)
        width : int, optional
            Of the band of inv(M) that is given beside; none otherwise.

        Yields
        ------
        block : int
        solution : (count, k)
        inverse : (width + 1, count)
            As `BandedFactor.inverse_band`; the part of each column within this block and the next.
        """
        b = self._b
        after = np.zeros((0, combine.shape[1]))
        window = np.zeros((b, b))
        for number in reversed(range(self._blocks)):
            lower = np.load(self._folder / f"lower-{number}.npy")
            right = np.load(self._folder / f"right-{number}.npy") @ combine
            count = lower.shape[1]
            near = min(b, count)
            bridge = _dense(lower[:, count - near :])[near : near + b]
            reach = min(len(after), b)
            right[count - near :] -= bridge[:reach].T @ after[:reach]
            solution = np.asarray(dtbtrs(lower, right, uplo="L", trans="T")[0])
            inverse = np.zeros((0, count))
            if width is not None:
                inverse, window = inverse_columns(lower, width, window)
            after = np.concatenate([solution, after])[:b]
            yield number, solution, inverse


def _dense(columns: Array) -> Array:
    """Columns (d, n) in lower band storage as a matrix (n + d - 1, n); above the diagonal zero."""
    depth, n = columns.shape
    dense = np.zeros((n + depth, n), order="F")
    _columns(dense, depth)[...] = columns
    return dense[: n + depth - 1]


def _columns(dense: Array, depth: int) -> Array:
    """View ``v[d, j] = dense[j + d, j]`` of a Fortran-ordered array."""
    item = dense.itemsize
    return as_strided(dense, (depth, dense.shape[1]), (item, dense.strides[1] + item))
