"""Banded systems, eliminated a stretch of columns at a time; what is long lies on disk.

What is solved is the same as `BandedFactor` and `BorderedFactor` solve; memory is that of one stretch,
however many there are. `BlockwiseFactor` is given its matrix stretch by stretch, with right-hand sides that
go along; `StoredFactor` takes the place of a `BandedFactor`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_triangular
from scipy.linalg.lapack import dtbtrs

from sightline.errors import EstimationError, InputError
from sightline.estimation.banded import (
    NOT_DEFINITE,
    SWEEP_COLUMNS,
    BandedFactor,
    add_band_times,
    dense_columns,
    inverse_columns,
    sweep_backward,
    sweep_forward,
)
from sightline.writing import naming_file, scratch_place

Array = NDArray[np.float64]

#: Bytes of one piece of columns of a band, and what a band holds in memory at most before it lies on disk.
PIECE_BYTES, HELD_BYTES = 12_000_000, 24_000_000


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
            raise EstimationError(NOT_DEFINITE) from None
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


def piece_columns(subdiagonals: int) -> int:
    """Columns of the pieces in which a band of so many subdiagonals is kept: more than it is wide."""
    return max(PIECE_BYTES // (8 * (subdiagonals + 1)), 2 * (subdiagonals + 1))


class _Pieces:
    """Arrays in memory or, where they are large together, one after the other in a scratch file without name.

    `total` are the bytes of all of them.
    """

    def __init__(self, total: int) -> None:
        self._held: dict[int, Array] = {}
        self._file: Any = None
        if total > HELD_BYTES:
            self._file = tempfile.TemporaryFile(buffering=0, dir=scratch_place())
        self._shapes: dict[int, tuple[int, tuple[int, ...]]] = {}
        self._end, self._lock = 0, Lock()

    def put(self, number: int, piece: Array) -> None:
        """Keep a piece, in the place of the one before of this number."""
        if self._file is None:
            self._held[number] = piece
            return
        piece = np.ascontiguousarray(piece)
        if number not in self._shapes:
            self._shapes[number] = (self._end, piece.shape)
            self._end += piece.nbytes
        left, place = piece.ravel().view(np.uint8).data, self._shapes[number][0]
        with naming_file(scratch_place() or Path(tempfile.gettempdir())), self._lock:
            self._file.seek(place)
            while left:
                left = left[self._file.write(left) :]

    def get(self, number: int) -> Array | None:
        """A piece; None where none was put."""
        if self._file is None:
            return self._held.get(number)
        if number not in self._shapes:
            return None
        place, shape = self._shapes[number]
        out = np.empty(shape)
        left = out.ravel().view(np.uint8).data
        with self._lock:
            self._file.seek(place)
            while left:
                left = left[self._file.readinto(left) :]
        return out


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
        self._pieces = _Pieces(8 * (self.subdiagonals + 1) * n)
        #: The piece that something was added to last: not yet put back.
        self._open: tuple[int, Array] | None = None

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
        out = np.zeros((self.subdiagonals + 1, last - first))
        for number, (begin, end) in enumerate(self.spans()):
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
        if self._open is None or self._open[0] != number:
            self._put_back()
            piece = self._pieces.get(number)
            self._open = number, np.zeros((self.subdiagonals + 1, columns)) if piece is None else piece
        return self._open[1]

    def _put_back(self) -> None:
        """Keep what was added last."""
        if self._open is not None:
            self._pieces.put(*self._open)
            self._open = None

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


class StoredFactor(BandedFactor):
    """Cholesky factor of a symmetric positive definite band that is made piece by piece, and kept so.

    Parameters
    ----------
    subdiagonals : int
        Width b of the band.
    n : int
    columns : callable
        ``columns(first, last)`` gives these columns of the matrix, (b + 1, last - first).

    Raises
    ------
    EstimationError
        If the matrix is not positive definite.

    Notes
    -----
    A band of one piece is factored as `BandedFactor` does. What a piece leaves to the next is its Schur
    complement, (b, b).
    """

    def __init__(self, subdiagonals: int, n: int, columns: Callable[[int, int], Array]) -> None:
        self._b, self._n = min(subdiagonals, n - 1), n
        size = piece_columns(self._b)
        self._spans = [(k, min(k + size, n)) for k in range(0, n, size)]
        self._pieces = _Pieces(8 * (self._b + 1) * n)
        self._logdet = 0.0
        carried = np.zeros((0, 0))
        for number, (first, last) in enumerate(self._spans):
            band = columns(first, last)
            if not np.isfinite(band).all():
                raise InputError("`band` holds values that are not finite; check the rows that were summed")
            lower, carried = _eliminated(band, carried, n - last)
            self._logdet += 2.0 * float(np.sum(np.log(lower[0])))
            # a column of the factor lies in one piece of memory
            self._pieces.put(number, np.ascontiguousarray(lower.T))

    def _piece(self, number: int) -> Array:
        """Columns of the factor as rows (m, b + 1)."""
        piece = self._pieces.get(number)
        assert piece is not None
        return piece

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self._n

    @property
    def subdiagonals(self) -> int:
        """Width b of the band below the diagonal."""
        return self._b

    @property
    def lower(self) -> Array:
        """The factor (b + 1, n) in lower band storage, all of it in memory."""
        return np.concatenate([self._piece(k).T for k in range(len(self._spans))], axis=1)

    @property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the matrix."""
        return self._logdet

    def solve(self, rhs: Array) -> Array:
        """Solution x of M x = rhs; `rhs` is (n,) or (n, k) and x has the same shape."""
        one = len(self._spans) == 1
        if one and (rhs.ndim == 1 or rhs.shape[1] < SWEEP_COLUMNS):
            lower = self._piece(0).T
            return np.asarray(cho_solve_banded((lower, True), rhs, check_finite=False), dtype=np.float64)
        x = np.array(rhs.reshape(len(rhs), -1), dtype=np.float64, order="C")
        for number, (first, _) in enumerate(self._spans):
            sweep_forward(self._piece(number), x, first)
        for number, (first, _) in reversed(list(enumerate(self._spans))):
            sweep_backward(self._piece(number), x, first)
        return x.reshape(rhs.shape)

    def inverse_pieces(self, width: int) -> Iterator[tuple[int, Array]]:
        """Pieces of `inverse_band`, the last first: first column, band (width + 1, m)."""
        keep = max(self._b, min(width, self._n - 1))
        window = np.zeros((keep, keep))
        for number, (first, _) in reversed(list(enumerate(self._spans))):
            band, window = inverse_columns(self._piece(number).T, width, window)
            yield first, band

    def inverse_band(self, width: int) -> Array:
        """Band of the inverse: ``out[d, j] = inv(M)[j + d, j]``, shape (width + 1, n)."""
        if width < 0:
            raise InputError(f"`width` must be 0 or more, got {width}")
        out = np.empty((width + 1, self._n))
        for first, band in self.inverse_pieces(width):
            out[:, first : first + band.shape[1]] = band
        for d in range(1, min(width, self._n - 1) + 1):
            out[d, self._n - d :] = 0.0
        return out


def _eliminated(band: Array, carried: Array, after: int) -> tuple[Array, Array]:
    """Columns (b + 1, m) of a factor, and what they leave to the `after` unknowns behind them.

    `band` are those of the matrix, `carried` what those before have left to them.
    """
    depth, count = band.shape
    held = min(len(carried), count)
    for d in range(min(held, depth)):
        band[d, : held - d] += np.diagonal(carried, -d)[: held - d]
    try:
        lower = np.asarray(cholesky_banded(band[:count], lower=True, check_finite=False))
    except np.linalg.LinAlgError:
        raise EstimationError(NOT_DEFINITE) from None
    if after == 0:
        if count < depth:  # rows beyond the matrix
            lower = np.concatenate([lower, np.zeros((depth - count, count))])
        return lower, np.zeros((0, 0))
    near, reach = min(depth - 1, count), min(depth - 1, after)
    corner, _ = dense_columns(lower[:, count - near :], depth - 1)
    _, below = dense_columns(band[:, count - near :], depth - 1)
    bridge = np.zeros((depth - 1, near))
    bridge[:reach] = solve_triangular(corner, below[:reach].T, lower=True, check_finite=False).T
    dense = np.zeros((near + depth, near), order="F")
    dense[:near], dense[near : near + depth - 1] = corner, bridge
    lower[:, count - near :] = _columns(dense, depth)
    return lower, -(bridge[:reach] @ bridge[:reach].T)
