"""A banded system eliminated in blocks is the system solved at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from sightline.errors import EstimationError, InputError
from sightline.estimation import banded
from sightline.estimation.banded import BandedFactor, BorderedFactor, band_times
from sightline.estimation.banded_blocks import BlockwiseFactor, StoredBand

B, N = 5, 47


def system() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    band = rng.normal(size=(B + 1, N))
    band[0] = 2.0 * (B + 1)
    return band, rng.normal(size=(N, 3))


def in_blocks(folder, band, right, ends, overlap) -> BlockwiseFactor:
    factor = BlockwiseFactor(folder, B, right.shape[1])
    begin = 0
    for end in ends:
        after = min(end + overlap, N)
        # each number is given to one block only: entries (row, column) to that of the column
        part, side = np.zeros((B + 1, after - begin)), np.zeros((after - begin, 3))
        part[:, : end - begin] = band[:, begin:end]
        for column in range(end - begin):
            part[max(after - begin - column, 0) :, column] = 0.0
        side[: end - begin] = right[begin:end]
        factor.eliminate(part, side, end - begin)
        begin = end
    return factor


@pytest.mark.parametrize("ends", [(47,), (20, 47), (7, 13, 30, 47), (5, 10, 15, 47)])
def test_blocks_give_solution_and_inverse_of_the_whole(tmp_path, ends):
    band, right = system()
    whole = BandedFactor(band)
    factor = in_blocks(tmp_path, band, right, ends, B)
    solution = whole.solve(right)
    # conditions near one: rounding only
    np.testing.assert_allclose(factor.gram, right.T @ solution, atol=1e-12)
    combine = np.array([[1.0, 0.5], [0.0, 2.0], [-1.0, 0.0]])
    blocks = dict((number, (x, inverse)) for number, x, inverse in factor.backward(combine, 2))
    ordered = [blocks[number] for number in range(len(ends))]
    np.testing.assert_allclose(np.concatenate([x for x, _ in ordered]), solution @ combine, atol=1e-13)
    found = np.concatenate([inverse for _, inverse in ordered], axis=1)
    expected = whole.inverse_band(2)
    for d in range(3):
        np.testing.assert_allclose(found[d, : N - d], expected[d, : N - d], atol=1e-13)


def test_what_is_not_positive_or_does_not_fit_is_refused(tmp_path):
    band, right = system()
    factor = BlockwiseFactor(tmp_path, B, 3)
    with pytest.raises(InputError, match="do not fit"):
        factor.eliminate(band[:3], right, N)
    with pytest.raises(EstimationError, match="not positive definite"):
        factor.eliminate(-band, right, N)


def stored(band, monkeypatch, *, on_disk: bool, columns: int = 12):
    """A band, and its factor, in pieces of so many columns."""
    monkeypatch.setattr(banded, "PIECE_BYTES", 8 * (B + 1) * columns)
    monkeypatch.setattr(banded, "LEAST_COLUMNS", 1)
    monkeypatch.setattr(banded, "HELD_BYTES", 0 if on_disk else 10**9)
    laid = StoredBand(B, N)
    # given in overlapping stretches, as sums of windows are
    for begin in range(0, N, 9):
        part = np.zeros((B + 1, min(14, N - begin)))
        part[:, :9] = band[:, begin : begin + 9]
        laid.add(begin, part)
    assert len(laid.spans()) == -(-N // columns) > 1
    return laid, BandedFactor.of_columns(B, N, laid.columns)


@pytest.mark.parametrize("columns", [1, 2, 5, 12])  # the band reaches over 5 columns
@pytest.mark.parametrize("on_disk", [False, True])
def test_a_stored_band_and_its_factor_are_those_of_the_whole(monkeypatch, on_disk, columns):
    band, right = system()
    for d in range(1, B + 1):
        band[d, N - d :] = 0.0
    whole = BandedFactor(band)
    laid, factor = stored(band, monkeypatch, on_disk=on_disk, columns=columns)
    np.testing.assert_array_equal(laid.whole(), band)
    np.testing.assert_array_equal(laid.columns(7, 30), band[:, 7:30])
    np.testing.assert_allclose(laid.times(right), band_times(band, right), atol=1e-13)  # sums of up to 20
    np.testing.assert_array_equal(laid.plus(laid).diagonal(), 2.0 * band[0])
    np.testing.assert_array_equal(StoredBand.of_parts(laid.size, (one() for one in laid.parts)).whole(), band)
    # conditions near one: rounding only
    np.testing.assert_allclose(factor.lower, whole.lower, atol=1e-13)
    np.testing.assert_allclose(factor.logdet, whole.logdet, rtol=1e-14)
    for rhs in (right, right[:, 0]):
        np.testing.assert_allclose(factor.solve(rhs), whole.solve(rhs), atol=1e-13)
    # of one asked before, of a wider one, and of what that has left
    for width in (0, 2, 9, 3):
        np.testing.assert_allclose(factor.inverse_band(width), whole.inverse_band(width), atol=1e-13)


def test_a_band_that_is_filled_in_order_writes_each_piece_once(monkeypatch):
    # what reaches over the end of a piece goes on in the next: neither leaves the memory for the other
    put = []
    keep = banded.Pieces.put
    monkeypatch.setattr(banded.Pieces, "put", lambda pieces, k, one: put.append(k) or keep(pieces, k, one))
    monkeypatch.setattr(banded.BandedFactor, "of_columns", lambda *_: None)
    laid, _ = stored(system()[0], monkeypatch, on_disk=True)
    laid.diagonal()
    assert put == list(range(len(laid.spans())))


def test_an_inverse_is_kept_for_who_asks_next(monkeypatch):
    band, _ = system()
    _, factor = stored(band, monkeypatch, on_disk=True)
    asked = []
    found = banded.inverse_columns
    monkeypatch.setattr(banded, "inverse_columns", lambda *given: asked.append(given[1]) or found(*given))
    pieces = len(list(factor.inverse_pieces(0)))
    first = [factor.inverse_band(width) for width in (2, B)]
    assert asked == [B] * pieces
    np.testing.assert_array_equal(first[1][:3], first[0])


def test_a_band_has_the_same_bits_on_disk_and_in_memory(monkeypatch):
    band, right = system()
    factors = [stored(band, monkeypatch, on_disk=on_disk)[1] for on_disk in (False, True)]
    np.testing.assert_array_equal(*(factor.lower for factor in factors))
    np.testing.assert_array_equal(*(factor.solve(right) for factor in factors))
    np.testing.assert_array_equal(*(factor.inverse_band(7) for factor in factors))


def test_variances_of_rows_are_those_of_the_inverse(monkeypatch):
    band, right = system()
    _, factor = stored(band, monkeypatch, on_disk=True)
    whole = np.zeros((N, N))
    for d in range(B + 1):
        place = np.arange(N - d)
        whole[place + d, place] = whole[place, place + d] = band[d, : N - d]
    corner = 20.0 * np.eye(3)
    rows = np.zeros((4, N))
    rows[0, 3], rows[1, 8:20:3], rows[2, [20, 34]], rows[3, N - 2 :] = 1.0, 2.0, (1.0, -1.0), 0.5
    beside = np.arange(12.0).reshape(4, 3)
    dense = np.linalg.inv(np.block([[whole, right], [right.T, corner]]))
    both = np.concatenate([rows, beside], axis=1)
    # entries of a place may come one by one
    value, place = np.array([0.5, 0.5, *rows[rows != 0.0][1:]]), np.array([3, *np.nonzero(rows)[1]])
    sparse = csr_array((value, place, [0, 2, 6, 8, 10]), shape=rows.shape)
    found = BorderedFactor(factor, right, corner).row_variance(sparse, beside)
    np.testing.assert_allclose(found, np.einsum("ri,ij,rj->r", both, dense, both), rtol=1e-12)


def test_a_stored_band_that_is_not_positive_is_refused(monkeypatch):
    band, _ = system()
    band[0, 20] = -1.0
    with pytest.raises(EstimationError, match="not positive definite"):
        stored(band, monkeypatch, on_disk=False)
