"""Symmetric positive definite systems of several bands that some unknowns link.

    [ A_1            B_1 ]
    [      A_2       B_2 ]
    [           ...  ... ]
    [ B_1'  B_2' ...  D  ]

Each A_s is banded, and D is dense; B_s has columns for those linking unknowns alone that touch band s. Lines
of a flight that overlap are such: frames of one line are tied to frames near them in time, and few frames
have points in common with other lines. With A_s = L_s L_s' and Y_s = inv(L_s) B_s, D - sum Y_s' Y_s is left
for the linking unknowns.

Not here: one band with a border of few columns (``banded.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotri, dtbtrs

from sightline.errors import EstimationError
from sightline.estimation.banded import BandedFactor, dense_columns

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Columns of a band that are eliminated together.
_TOGETHER = 96


@dataclass(eq=False)
class LinkedBand:
    """One band and what links it.

    Attributes
    ----------
    band : (b + 1, n)
        A in lower band storage.
    border : (n, q)
        B, of the linking unknowns `columns`; it is overwritten.
    columns : (q,) int
    """

    band: Array
    border: Array
    columns: Index


class LinkedBands:
    """Cholesky factor of bands that some unknowns link; the last unknowns are left.

    Parameters
    ----------
    bands : sequence of Band
    corner : (q, q)
        D of all linking unknowns.
    left : int
        Unknowns, the last of the linking ones, that are not eliminated.

    Attributes
    ----------
    information : (left, left)
        What is left for them.

    Raises
    ------
    EstimationError
        If the matrix is not positive definite.
    """

    def __init__(self, bands: Sequence[LinkedBand], corner: Array, left: int) -> None:
        self._parts = [_Part(band) for band in bands]
        reduced = np.array(corner)
        for part in self._parts:
            reduced[np.ix_(part.columns, part.columns)] -= part.gram
        own = len(corner) - left
        try:
            self._root = np.linalg.cholesky(reduced[:own, :own])
        except np.linalg.LinAlgError as error:
            raise EstimationError(
                f"the unknowns that link bands are not determined ({error}); "
                "give every unknown a prior or a measurement"
            ) from None
        half = solve_triangular(self._root, reduced[:own, own:], lower=True, check_finite=False)
        self._bridge = solve_triangular(self._root, half, lower=True, trans="T", check_finite=False)
        information = reduced[own:, own:] - half.T @ half
        self.information = 0.5 * (information + information.T)

    @property
    def _linking(self) -> int:
        return len(self._root)

    def condense(self, sides: Sequence[Array], links: Array) -> tuple[list[Array], Array]:
        """Right-hand sides with bands eliminated: (n_s,) halves for `solve`, and (q,) of linking unknowns."""
        halves, right = [], np.array(links)
        for part, side in zip(self._parts, sides, strict=True):
            halves.append(part.half(side))
            right[part.columns] -= part.bridge.T @ halves[-1]
        return halves, right

    def left(self, right: Array) -> Array:
        """Right-hand side (left,) once the linking unknowns (q,) are eliminated too."""
        own = self._linking
        return np.asarray(right[own:] - self._bridge.T @ right[:own])

    def solve(self, halves: Sequence[Array], right: Array, step: Array) -> tuple[list[Array], Array]:
        """Solutions (n_s,) of bands and (q - left,) of links, the unknowns left having taken `step`."""
        own = self._linking
        inner = solve_triangular(self._root, right[:own], lower=True, check_finite=False)
        moved = solve_triangular(self._root, inner, lower=True, trans="T", check_finite=False)
        links = np.concatenate([moved - self._bridge @ step, step])
        solved = [
            part.whole(half - part.bridge @ links[part.columns])
            for part, half in zip(self._parts, halves, strict=True)
        ]
        return solved, links[:own]

    def covariance(self, size: int) -> Iterator[tuple[Array, Array]]:
        """What the unknowns are known to when those left are, and how they follow these.

        Parameters
        ----------
        size : int
            Of the diagonal blocks wanted; it divides the number of unknowns of every band.

        Yields
        ------
        blocks : (n_s / size, size, size)
            Diagonal blocks of the inverse, those left known; of each band, then of the linking unknowns.
        bridge : (n_s, left)
            The unknowns are bridge times what is left less.
        """
        own = self._linking
        inverse = np.tril(dpotri(self._root, lower=1)[0])
        inverse += np.tril(inverse, -1).T
        for part in self._parts:
            inner = part.columns < own
            links = part.columns[inner]
            yield part.covariance(size, inner, inverse[np.ix_(links, links)], self._bridge[links])
        count = own // size
        at = np.arange(count)
        yield inverse.reshape(count, size, count, size)[at, :, at, :], self._bridge


class _Part:
    """One band factored, with its part Y = inv(L) B in what is left."""

    def __init__(self, content: LinkedBand) -> None:
        self._factor = BandedFactor(content.band)
        border = content.border
        n = self._factor.n
        # a column is zero down to the first unknown that it touches, and so is Y
        start = np.where((border != 0.0).any(axis=0), (border != 0.0).argmax(axis=0), n)
        order = np.argsort(start, kind="stable")
        self.columns = content.columns[order]
        self.bridge = np.ascontiguousarray(border[:, order])
        self.gram = np.zeros((len(order),) * 2)
        lower = self._factor.lower
        depth = len(lower) - 1
        start = start[order]
        for begin in range(0, n, _TOGETHER):
            stop = min(begin + _TOGETHER, n)
            active = int(np.searchsorted(start, stop))
            corner, below = dense_columns(lower[:, begin:stop], depth)
            rows = solve_triangular(corner, self.bridge[begin:stop, :active], lower=True, check_finite=False)
            self.bridge[begin:stop, :active] = rows
            after = self.bridge[stop : stop + depth, :active]
            after -= below[: len(after)] @ rows
            self.gram[:active, :active] += rows.T @ rows

    def half(self, side: Array) -> Array:
        """inv(L) times a vector (n,)."""
        return np.asarray(dtbtrs(self._factor.lower, side, uplo="L")[0].reshape(-1))

    def whole(self, half: Array) -> Array:
        """inv(L') times a vector (n,)."""
        return np.asarray(dtbtrs(self._factor.lower, half, uplo="L", trans="T")[0].reshape(-1))

    def covariance(
        self, size: int, inner: NDArray[np.bool_], links: Array, bridge: Array
    ) -> tuple[Array, Array]:
        """As of `LinkedBands.covariance`; `links` is the inverse at the columns `inner`, `bridge` theirs."""
        lower, n = self._factor.lower, self._factor.n
        depth = len(lower) - 1
        band = self._factor.inverse_band(size - 1)
        blocks = np.zeros((n // size, size, size))
        at = size * np.arange(n // size)
        for a in range(size):
            for b in range(a + 1):
                blocks[:, a, b] = blocks[:, b, a] = band[a - b, at + b]
        out = np.empty((n, bridge.shape[1]))
        # inv(L') Y from the last rows to the first: only as many rows as the band is deep are kept
        after = np.zeros((depth, self.bridge.shape[1]))
        together = max(size, _TOGETHER // size * size)
        for begin in range((n - 1) // together * together, -1, -together):
            stop = min(begin + together, n)
            corner, below = dense_columns(lower[:, begin:stop], depth)
            rows = self.bridge[begin:stop] - below.T @ after
            rows = solve_triangular(corner, rows, lower=True, trans="T", check_finite=False)
            after = np.concatenate([rows, after])[:depth]
            by_links = rows[:, inner]
            out[begin:stop] = rows[:, ~inner] - by_links @ bridge
            # a line that is tied to no other has no links
            shape = (stop - begin) // size, size, len(links)
            spread, own = (by_links @ links).reshape(shape), by_links.reshape(shape)
            blocks[begin // size : stop // size] += spread @ np.swapaxes(own, 1, 2)
        return blocks, out
