"""Banded systems that are made a stretch of columns at a time; what is long lies on disk.

`BlockwiseFactor` is given its matrix stretch by stretch, with right-hand sides that go along; `StoredBand` is
added to from anywhere, and factored by `BandedFactor.of_columns`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from sightline.errors import InputError
from sightline.estimation.banded import (
    Pieces,
    add_band_times,
    dense_columns,
    eliminated,
    inverse_columns,
    piece_columns,
)
from sightline.writing import let_go

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
        lower, left = eliminated(band[:, :count], np.zeros((0, 0)), total - count)
        solved = dtbtrs(lower, right[:count], uplo="L")[0]
        self.gram += solved.T @ solved
        near, bridge = self._bridge(lower)
        rest = dense_columns(band[:, count:], b)[0]
        self._carried = (
            np.tril(rest) + np.tril(rest, -1).T + left,
            right[count:] - bridge[: total - count] @ solved[count - near :],
        )
        np.save(self._folder / f"lower-{self._blocks}.npy", lower)
        np.save(self._folder / f"right-{self._blocks}.npy", solved)
        self._blocks += 1

    def _bridge(self, lower: Array) -> tuple[int, Array]:
        """How many of the last columns of a block reach beyond it, and their rows (b, near) there."""
        near = min(self._b, lower.shape[1])
        return near, dense_columns(lower[:, lower.shape[1] - near :], self._b)[1]

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
            near, bridge = self._bridge(lower)
            reach = min(len(after), b)
            right[count - near :] -= bridge[:reach].T @ after[:reach]
            solution = np.asarray(dtbtrs(lower, right, uplo="L", trans="T")[0])
            inverse = np.zeros((0, count))
            if width is not None:
                inverse, window = inverse_columns(lower, width, window)
            after = np.concatenate([solution, after])[:b]
            yield number, solution, inverse


class StoredBand:
    """A symmetric matrix in lower band storage, kept in pieces of columns, on disk where it is large.

    Parameters
    ----------
    subdiagonals : int
        Width b of the band below the diagonal.
    n : int
        Unknowns. All entries are zero until something is added.
    """

    def __init__(self, subdiagonals: int, n: int) -> None:
        self.subdiagonals, self.n = min(subdiagonals, n - 1), n
        self._columns = piece_columns(self.subdiagonals)
        self._pieces = Pieces(8 * (self.subdiagonals + 1) * n)
        #: Pieces that something was added to, not yet put back: what reaches over an end of one goes on in
        #: the next.
        self._open: dict[int, Array] = {}

    @classmethod
    def of(cls, band: Array) -> StoredBand:
        """That of an array (b + 1, n)."""
        out = cls(band.shape[0] - 1, band.shape[1])
        out.add(0, band[: out.subdiagonals + 1])
        return out

    @property
    def size(self) -> tuple[int, int]:
        """Subdiagonals, unknowns: what `StoredBand` is made of."""
        return self.subdiagonals, self.n

    @property
    def parts(self) -> list[Callable[[], Array]]:
        """What gives the columns of each piece; in this order `of_parts` takes them."""
        return [partial(self.columns, *span) for span in self.spans()]

    @classmethod
    def of_parts(cls, size: tuple[int, int], parts: Iterable[Array]) -> StoredBand:
        """The band of these pieces."""
        out = cls(*size)
        for (first, _), part in zip(out.spans(), parts, strict=True):
            out.add(first, part)
            let_go()
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        """As its pieces, all of them in memory."""
        return StoredBand.of_parts, (self.size, [part() for part in self.parts])

    def spans(self) -> list[tuple[int, int]]:
        """First and one past the last column of every piece."""
        return [(k, min(k + self._columns, self.n)) for k in range(0, self.n, self._columns)]

    def columns(self, first: int, last: int) -> Array:
        """Columns [first, last) as an array (b + 1, last - first) that may be written to."""
        self._put_back()
        spans = self.spans()
        if self._pieces.on_disk and (first, last) in spans:
            # as it was read: a copy would be as large again
            whole = self._pieces.get(spans.index((first, last)))
            if whole is not None:
                return whole
        out = np.zeros((self.subdiagonals + 1, last - first))
        for number, (begin, end) in enumerate(spans):
            low, high = max(begin, first), min(end, last)
            piece = self._pieces.get(number) if low < high else None
            if piece is not None:
                out[:, low - first : high - first] = piece[:, low - begin : high - begin]
        return out

    def whole(self) -> Array:
        """All of it, (b + 1, n)."""
        return self.columns(0, self.n)

    def add(self, first: int, band: Array) -> None:
        """Add columns (at most b + 1, m) from column `first` on."""
        last = first + band.shape[1]
        for number, (begin, end) in enumerate(self.spans()):
            low, high = max(begin, first), min(end, last)
            if low >= high:
                continue
            piece = self._opened(number, end - begin)
            piece[: len(band), low - begin : high - begin] += band[:, low - first : high - first]

    def _opened(self, number: int, columns: int) -> Array:
        """A piece to be added to."""
        if number not in self._open:
            if len(self._open) == 2:
                done = next(iter(self._open))
                self._pieces.put(done, self._open.pop(done))
            piece = self._pieces.get(number)
            self._open[number] = np.zeros((self.subdiagonals + 1, columns)) if piece is None else piece
        self._open[number] = self._open.pop(number)  # the one used last is last
        return self._open[number]

    def _put_back(self) -> None:
        """Keep what was added last."""
        for number, piece in self._open.items():
            self._pieces.put(number, piece)
        self._open = {}

    def plus(self, other: StoredBand) -> StoredBand:
        """The sum of two matrices."""
        out = StoredBand(max(self.subdiagonals, other.subdiagonals), self.n)
        for first, last in out.spans():
            out.add(first, self.columns(first, last))
            out.add(first, other.columns(first, last))
        return out

    def diagonal(self) -> Array:
        """(n,)."""
        # copies: a row of a piece would hold all of it
        return np.concatenate([self.columns(*span)[0].copy() for span in self.spans()])

    def times(self, x: Array) -> Array:
        """Product with `x`, (n,) or (n, k)."""
        columns = np.ascontiguousarray(x.reshape(len(x), -1), dtype=np.float64)
        out = np.zeros(columns.shape)
        for first, last in self.spans():
            add_band_times(self.columns(first, last), columns, first, out)
        return out.reshape(x.shape)
