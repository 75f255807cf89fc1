"""Symmetric positive definite systems that are banded, or banded with a dense border.

Every smoother of the package ends here: normal equations of a motion on a time grid (a band
as wide as the longest lag) with a few constants beside it (the border: offsets, rotations).
Factor once, then solve, take the determinant, and take the band of the inverse, which is the
covariance of neighbouring epochs. All of it costs O(n b^2) for n unknowns and b subdiagonals.
A factor is one, however long: its pieces lie in memory or on disk.

Band storage is "lower": ``band[d, j] = M[j + d, j]``, shape (b + 1, n), as scipy.linalg uses.

Not here: where the rows come from (``prior.py``, ``series.py``).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded, solve_triangular
from scipy.linalg.lapack import dtrtri

from sightline.compiled import njit
from sightline.errors import EstimationError, InputError
from sightline.execution import slices
from sightline.writing import let_go, naming_file, scratch_array, scratch_place

Array = NDArray[np.float64]


#: Bytes of one piece of columns of a band, and what a band holds in memory at most before it lies on disk.
PIECE_BYTES, HELD_BYTES = 6_000_000, 12_000_000
#: Columns of a piece at least.
LEAST_COLUMNS = 64
#: Unknowns of arrays beside a band that are worked on at a time.
ROWS_AT_ONCE = 32768
#: Right sides from which on one sweep over the factor for all of them beats one sweep each (LAPACK's way).
SWEEP_COLUMNS = 8


#: Subdiagonals of an inverse that are kept at least: what covariances of neighbours and windows ask for.
INVERSE_KEPT = 96
#: Columns of the inverse that are found at once, and how many times as many its window moves through before
#: it is put back.
INVERSE_BLOCK, INVERSE_ROOM = 32, 4

#: What is said of a matrix that is not positive definite.
NOT_DEFINITE = (
    "the normal equations are not positive definite: some unknown is hardly seen, or sigmas are "
    "looser than can be weighed; give every unknown a prior or a measurement, and smaller sigmas "
    "of heights, offsets and rotations"
)


@njit(cache=True, nogil=True)
def add_band_times(band, x, first, out):  # type: ignore[no-untyped-def]
    """Add a symmetric matrix times `x` (n, k) to `out`: of its lower band, the columns from `first` on."""
    n, columns = x.shape
    for d in range(min(band.shape[0], n)):
        for i in range(first, min(first + band.shape[1], n - d)):
            value = band[d, i - first]
            if value == 0.0:
                continue
            for c in range(columns):
                out[i + d, c] += value * x[i, c]
            if d > 0:
                for c in range(columns):
                    out[i, c] += value * x[i + d, c]


def band_times(band: Array, x: Array) -> Array:
    """Product of a symmetric matrix in lower band storage (b + 1, n) with `x`, (n,) or (n, k)."""
    columns = np.ascontiguousarray(x.reshape(len(x), -1), dtype=np.float64)
    out = np.zeros(columns.shape)
    add_band_times(band, columns, 0, out)
    return out.reshape(x.shape)


@njit(cache=True, nogil=True)
def sweep_forward(lower, x, first):  # type: ignore[no-untyped-def]
    """Solve L y = x in place for all columns of `x` (n, k), as far as columns of L from `first` on go.

    Row j of `lower` is column first + j of L.
    """
    n, columns = x.shape
    count, depth = lower.shape
    for j in range(count):
        inverse = 1.0 / lower[j, 0]
        for c in range(columns):
            x[first + j, c] *= inverse
        for d in range(1, min(depth, n - first - j)):
            value = lower[j, d]
            for c in range(columns):
                x[first + j + d, c] -= value * x[first + j, c]


@njit(cache=True, nogil=True)
def sweep_backward(lower, x, first):  # type: ignore[no-untyped-def]
    """Solve L' y = x likewise, once all unknowns behind these columns are solved."""
    n, columns = x.shape
    count, depth = lower.shape
    for j in range(count - 1, -1, -1):
        for d in range(1, min(depth, n - first - j)):
            value = lower[j, d]
            for c in range(columns):
                x[first + j, c] -= value * x[first + j + d, c]
        inverse = 1.0 / lower[j, 0]
        for c in range(columns):
            x[first + j, c] *= inverse


def piece_columns(subdiagonals: int) -> int:
    """Columns of the pieces in which a band of so many subdiagonals is kept: of wide ones, fewer."""
    return max(PIECE_BYTES // (8 * (subdiagonals + 1)), LEAST_COLUMNS)


class Pieces:
    """Arrays in memory or, where they are large together, one after the other in a scratch file without name.

    `total` are the bytes of all of them.
    """

    def __init__(self, total: int) -> None:
        self._held: dict[int, Array] = {}
        self._file: Any = None
        if total > HELD_BYTES:
            self._file = tempfile.TemporaryFile(buffering=0, dir=scratch_place())
        self._shapes: dict[int, tuple[int, tuple[int, ...]]] = {}
        # what is in memory can be copied and pickled
        self._end, self._lock = 0, Lock() if self._file is not None else nullcontext()

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

    @property
    def on_disk(self) -> bool:
        """Whether `get` gives an array of its own each time."""
        return self._file is not None

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


class BandedFactor:
    """Cholesky factor of a symmetric positive definite banded matrix.

    It is made and kept in pieces of columns, on disk where these are large together; that of an array is one
    piece. What a piece leaves to the next is its Schur complement, (b, b).

    Parameters
    ----------
    band : array (b + 1, n)
        Lower band storage, ``band[d, j] = M[j + d, j]``; the unused tail of each row is ignored.

    Raises
    ------
    InputError
        If `band` is not two-dimensional or holds values that are not finite.
    EstimationError
        If the matrix is not positive definite.

    Examples
    --------
    >>> factor = BandedFactor(np.array([[2.0, 2.0], [1.0, 0.0]]))
    >>> factor.solve(np.array([3.0, 3.0]))
    array([1., 1.])
    """

    def __init__(self, band: Array) -> None:
        band = np.asarray(band, dtype=np.float64)
        if band.ndim != 2 or band.shape[1] == 0:
            raise InputError(f"`band` must have shape (subdiagonals + 1, n) with n > 0, got {band.shape}")
        # A band wider than the matrix holds nothing beyond the first n rows.
        band = band[: band.shape[1]]
        self._make(len(band) - 1, band.shape[1], band.shape[1], lambda first, last: band)
        self._kept_width = 0

    @classmethod
    def of_columns(cls, subdiagonals: int, n: int, columns: Callable[[int, int], Array]) -> BandedFactor:
        """The factor of a matrix whose columns [first, last) ``columns(first, last)`` gives, (b + 1, m).

        These arrays may be written to. Such a factor keeps what was asked of its inverse last, as wide as
        `INVERSE_KEPT` at least: many ask, and the width hardly counts.
        """
        out, b = cls.__new__(cls), min(subdiagonals, n - 1)
        out._make(b, n, piece_columns(b), columns)
        out._kept_width = min(INVERSE_KEPT, b)
        return out

    def _make(self, subdiagonals: int, n: int, size: int, columns: Callable[[int, int], Array]) -> None:
        """Factor piece by piece of `size` columns."""
        self._b, self._n = subdiagonals, n
        self._spans = [(k, min(k + size, n)) for k in range(0, n, size)]
        self._pieces = Pieces(0 if size >= n else 8 * (subdiagonals + 1) * n)
        self._inverse: tuple[int, Pieces] | None = None
        self._logdet = 0.0
        carried = np.zeros((0, 0))
        for number, (first, last) in enumerate(self._spans):
            band = columns(first, last)
            if not np.isfinite(band).all():
                raise InputError("`band` holds values that are not finite; check the rows that were summed")
            lower, carried = eliminated(band, carried, n - last)
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
        parts = [self._piece(number).T for number in range(len(self._spans))]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    @property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the matrix."""
        return self._logdet

    def solve(self, rhs: Array) -> Array:
        """Solution x of M x = rhs; `rhs` is (n,) or (n, k) and x has the same shape."""
        if len(self._spans) == 1 and (rhs.ndim == 1 or rhs.shape[1] < SWEEP_COLUMNS):
            return np.asarray(cho_solve_banded((self.lower, True), rhs, check_finite=False), dtype=np.float64)
        x = self._copied(rhs)
        for number, (first, _) in enumerate(self._spans):
            sweep_forward(self._piece(number), x, first)
            self._let_go()
        for number, (first, _) in reversed(list(enumerate(self._spans))):
            sweep_backward(self._piece(number), x, first)
            self._let_go()
        return x.reshape(rhs.shape)

    def _copied(self, rhs: Array) -> Array:
        """Right sides as (n, k) that may be written to, in a scratch array where the factor has pieces."""
        if len(self._spans) == 1:
            return np.array(rhs.reshape(len(rhs), -1), dtype=np.float64, order="C")
        x = scratch_array((len(rhs), math.prod(rhs.shape[1:])))
        for first, last in self._spans:
            x[first:last] = rhs[first:last].reshape(last - first, -1)
            self._let_go()
        return x

    def _let_go(self) -> None:
        """Scratch arrays leave the memory after a piece; of one piece alone nothing would be gained."""
        if len(self._spans) > 1:
            let_go()

    def inverse_pieces(self, width: int) -> Iterator[tuple[int, Array]]:
        """Pieces of `inverse_band`, the last first: first column, band (width + 1, m)."""
        backwards = reversed(list(enumerate(self._spans)))
        if self._inverse is not None and self._inverse[0] >= width:
            for number, (first, _) in backwards:
                kept = self._inverse[1].get(number)
                assert kept is not None
                yield first, kept[: width + 1]
            return
        # of a wider window it would be the same but for rounding
        found = max(width, self._kept_width) if width <= self._b else width
        pieces = Pieces(8 * (found + 1) * self._n) if 0 < self._kept_width else None
        # rows past the end of the matrix stay zero
        keep = max(self._b, min(width, self._n - 1))
        window = np.zeros((keep, keep))
        for number, (first, _) in backwards:
            band, window = inverse_columns(self._piece(number).T, found, window)
            if pieces is not None:
                pieces.put(number, band)
            yield first, band[: width + 1]
        if pieces is not None:
            self._inverse = found, pieces

    def inverse_band(self, width: int) -> Array:
        """Band of the inverse: ``out[d, j] = inv(M)[j + d, j]``, shape (width + 1, n).

        Entries beyond the end of a column are zero.

        Notes
        -----
        Takahashi's recursion from the last column to the first, in blocks. With the block
        column J of the factor, the rows R under it and Z the inverse,

            Z_RJ = -Z_RR L_RJ inv(L_JJ),   Z_JJ = inv(L_JJ)' (inv(L_JJ) - L_RJ' Z_RJ),

        where Z_RR is the dense window of the inverse already known. It costs 2 n b^2 operations,
        nearly all of them in one matrix product per block.
        """
        if width < 0:
            raise InputError(f"`width` must be 0 or more, got {width}")
        out = scratch_array((width + 1, self._n))
        for first, band in self.inverse_pieces(width):
            out[:, first : first + band.shape[1]] = band
            self._let_go()
        for d in range(1, min(width, self._n - 1) + 1):
            out[d, self._n - d :] = 0.0
        return out


def eliminated(band: Array, carried: Array, after: int) -> tuple[Array, Array]:
    """Columns (b + 1, m) of a factor, and what they leave to the `after` unknowns behind them.

    `band` are those of the matrix, `carried` what those before have left to them: it is added in place.
    """
    depth, count = band.shape
    for d in range(min(len(carried), depth)):
        diagonal = np.diagonal(carried, -d)[:count]
        band[d, : len(diagonal)] += diagonal
    try:
        lower = np.asarray(cholesky_banded(band[:count], lower=True, check_finite=False))
    except np.linalg.LinAlgError:
        raise EstimationError(NOT_DEFINITE) from None
    if count < depth:  # rows below the columns
        lower = np.concatenate([lower, np.zeros((depth - count, count))])
    if after == 0:
        return lower, np.zeros((0, 0))
    near, reach = min(depth - 1, count), min(depth - 1, after)
    corner, _ = dense_columns(lower[:, count - near :], depth - 1)
    _, below = dense_columns(band[:, count - near :], depth - 1)
    bridge = np.zeros((depth - 1, near))
    bridge[:reach] = solve_triangular(corner, below[:reach].T, lower=True, check_finite=False).T
    dense = np.zeros((near + depth, near), order="F")
    dense[:near], dense[near : near + depth - 1] = corner, bridge
    lower[:, count - near :] = _skewed(dense, depth)
    left = -(bridge[:reach] @ bridge[:reach].T)
    later = len(carried) - count
    if later > 0:  # what those before have left to unknowns behind these
        left[:later, :later] += carried[count:, count:]
    return lower, left


def inverse_columns(lower: Array, width: int, window: Array) -> tuple[Array, Array]:
    """Band of the inverse for some columns of a factor, from what is known of it after them.

    Parameters
    ----------
    lower : (b + 1, n)
        Columns of the factor, rows below the last of them too.
    width : int
        Of the band wanted.
    window : (w, w)
        The inverse at the w unknowns after these, w at least b; zero beyond the end of the matrix.

    Returns
    -------
    band : (width + 1, n)
    window : (w, w)
        The inverse at the first w unknowns from these columns on.
    """
    depth, n, keep = lower.shape[0], lower.shape[1], len(window)
    block = int(np.clip(depth - 1, 24, INVERSE_BLOCK))
    result = np.zeros((width + 1, n))
    copied = min(width, keep)
    # the window moves up through a larger array, and back to its end where it has reached the top
    size = keep + INVERSE_ROOM * block
    field = np.zeros((size, size), order="F")
    at = size - keep
    field[at:, at:] = window
    for stop in range(n, 0, -block):
        start = max(0, stop - block)
        count = stop - start
        if at < count:
            known = field[at : at + keep, at : at + keep].copy()
            at = size - keep
            field[at:, at:] = known
        corner, below = dense_columns(lower[:, start:stop], keep)
        inverse = dtrtri(corner, lower=1)[0]
        new = at - count
        z = field[new : at + keep, new:at]
        np.matmul(field[at : at + keep, at : at + keep], below @ -inverse, out=z[count:])
        here = inverse.T @ (inverse - below.T @ z[count:])
        z[:count] = 0.5 * (here + here.T)
        field[new:at, at : at + keep] = z[count:].T
        result[: copied + 1, start:stop] = _skewed(z, copied + 1)
        at = new
    return result, field[at : at + keep, at : at + keep].copy()


@njit(cache=True, nogil=True)
def _add_row_variance(starts, places, values, first, band, out):  # type: ignore[no-untyped-def]
    """Add ``r' Z r`` of sparse rows, places rising: what columns of Z's lower band from `first` on hold."""
    last = first + band.shape[1]
    for r in range(len(out)):
        for k in range(starts[r], starts[r + 1]):
            column = places[k]
            if column < first or column >= last:
                continue
            total = 0.0
            for h in range(k, starts[r + 1]):
                value = values[h] * band[places[h] - column, column - first]
                total += value if h == k else 2.0 * value
            out[r] += values[k] * total


class BorderedFactor:
    """Factor of ``[[A, B], [B', D]]`` with A banded (n, n), B (n, q) dense and D (q, q) small.

    Parameters
    ----------
    band : array (b + 1, n) or BandedFactor
        A in lower band storage, or its factor where that is known.
    border : array (n, q)
        B; q may be 0.
    corner : array (q, q)
        D.
    tied : array (n, q), optional
        A's inverse times B, where that is known.

    Raises
    ------
    InputError
        If the shapes do not fit together.
    EstimationError
        If the whole matrix is not positive definite.
    """

    def __init__(
        self, band: Array | BandedFactor, border: Array, corner: Array, tied: Array | None = None
    ) -> None:
        self._banded = band if isinstance(band, BandedFactor) else BandedFactor(band)
        border = np.asarray(border, dtype=np.float64)
        corner = np.asarray(corner, dtype=np.float64)
        n = self._banded.n
        if border.ndim != 2 or border.shape[0] != n or corner.shape != (border.shape[1],) * 2:
            raise InputError(
                f"`border` must be (n, q) and `corner` (q, q) with n = {n}, "
                f"got {border.shape} and {corner.shape}"
            )
        # not the border itself: it is as long as the matrix, and what is asked later takes `tied`
        self._q = border.shape[1]
        if tied is None:
            tied = self._banded.solve(border) if border.shape[1] else np.zeros((n, 0))
        self._tied: Array = tied
        schur = corner - products(border, self._tied)
        # Unknowns of the border may have any unit: scale before factoring.
        self._scale = np.sqrt(np.maximum(np.diag(corner), np.finfo(float).tiny))
        scaled = schur / np.outer(self._scale, self._scale)
        try:
            self._schur = cho_factor(0.5 * (scaled + scaled.T), lower=True, check_finite=True)
        except (np.linalg.LinAlgError, ValueError):
            raise EstimationError(
                "the constants beside the motion are not determined: some is hardly seen, or sigmas are "
                "looser than can be weighed; give each a finite prior sigma, and smaller ones of heights, "
                "offsets and rotations"
            ) from None

    @property
    def n(self) -> int:
        """Number of banded unknowns."""
        return self._banded.n

    @property
    def q(self) -> int:
        """Number of unknowns of the border."""
        return int(self._q)

    @cached_property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the whole matrix."""
        diagonal = np.log(np.diag(self._schur[0])) + np.log(self._scale)
        return self._banded.logdet + 2.0 * float(np.sum(diagonal))

    def _solve_schur(self, rhs: Array) -> Array:
        scale = self._scale.reshape((-1,) + (1,) * (rhs.ndim - 1))
        return np.asarray(cho_solve(self._schur, rhs / scale, check_finite=False) / scale, dtype=np.float64)

    def solve(self, b: Array, d: Array) -> tuple[Array, Array]:
        """Solution (x, y) of A x + B y = b, B' x + D y = d; `b` is (n,) or (n, k), `d` (q,) or (q, k)."""
        if self.q == 0:
            return self._banded.solve(b), np.zeros_like(d)
        y = self._solve_schur(d - products(self._tied, b))
        x = self._banded.solve(b)
        for some in _rows(self.n):
            x[some] -= self._tied[some] @ y
        return x, y

    def times(self, directions: Array) -> tuple[Array, Array]:
        """Inverse times [directions; 0]: its (n, k) and (q, k) parts; `directions` is (n, k) or (n,)."""
        return self.solve(directions, np.zeros((self.q, *directions.shape[1:])))

    def row_variance(self, rows: Any, beside: Array) -> Array:
        """``r' inv(M) r`` (R,) of sparse rows r, each within few neighbouring unknowns of the band.

        Parameters
        ----------
        rows : (R, n) sparse
        beside : (R, q)
            Of the border.
        """
        rows = rows.tocsr(copy=True)
        rows.sum_duplicates()
        starts, places, values = rows.indptr, rows.indices, rows.data
        filled = np.flatnonzero(np.diff(starts))
        low, high = places[starts[filled]].astype(np.int64), places[starts[filled + 1] - 1]
        out = np.zeros(len(beside))
        for first, band in self._banded.inverse_pieces(int((high - low).max(initial=0))):
            _add_row_variance(starts, places, values, first, band, out)
        left = beside - rows @ self._tied
        if self.q:
            out += np.einsum("rq,qr->r", left, self._solve_schur(left.T))
        return out

    @cached_property
    def border_covariance(self) -> Array:
        """The (q, q) block of the inverse that belongs to the border."""
        return self._solve_schur(np.eye(self.q))

    def covariance_band(self, width: int) -> Array:
        """Band of the (n, n) block of the inverse, ``out[d, j]``, shape (width + 1, n)."""
        result = self._banded.inverse_band(width)
        if self.q:
            n = self.n
            for some in _rows(n):
                # with the rows that the band reaches beyond them
                tied = self._tied[some.start : min(some.stop + width, n)] / self._scale
                half = solve_triangular(self._schur[0], tied.T, lower=True, check_finite=False)
                for d in range(min(width, n - 1) + 1):
                    count = max(min(some.stop, n - d) - some.start, 0)
                    part = np.einsum("ij,ij->j", half[:, d : d + count], half[:, :count])
                    result[d, some.start : some.start + count] += part
        return result


def _rows(n: int) -> Iterator[slice]:
    """So many unknowns, some at a time; scratch arrays of more leave the memory in between."""
    for some in slices(n, ROWS_AT_ONCE):
        yield some
        if n > ROWS_AT_ONCE:
            let_go()


def products(a: Array, b: Array) -> Array:
    """``a' b`` of arrays as long as a band, (n, p) and (n,) or (n, k): (p, ...)."""
    out = np.zeros((a.shape[1], *b.shape[1:]))
    for some in _rows(len(a)):
        out += a[some].T @ b[some]
    return out


def dense_columns(lower: Array, keep: int) -> tuple[Array, Array]:
    """Columns of a banded factor as dense blocks: on the diagonal (s, s) and below it (keep, s)."""
    depth, size = lower.shape
    dense = np.zeros((size + keep, size), order="F")
    _skewed(dense, depth)[...] = lower
    return dense[:size], dense[size:]


def _skewed(dense: Array, depth: int) -> Array:
    """View ``v[d, j] = dense[j + d, j]`` of a Fortran-ordered array at least `depth` rows taller."""
    item = dense.itemsize
    return as_strided(dense, (depth, dense.shape[1]), (item, dense.strides[1] + item))
