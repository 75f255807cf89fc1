"""Bands that some unknowns link, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from sightline.errors import EstimationError
from sightline.estimation.linked_bands import LinkedBand, LinkedBands

#: Unknowns of each band and its subdiagonals (one shorter than its band, one longer than what goes at once);
#: linking unknowns, and those of them that are left.
SIZES, LINKING, LEFT = ((6, 9), (240, 20), (30, 5)), 10, 2


class System:
    """A matrix of three bands and links, dense and in parts."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        bands, borders, self.parts = [], [], []
        for n, b in SIZES:
            a = np.tril(np.triu(rng.standard_normal((n, n)), -b))
            bands.append(a + a.T)
            # links touch a stretch of the band; what is left touches all
            columns = np.sort(rng.choice(LINKING - LEFT, 4, replace=False))
            border = np.zeros((n, LINKING))
            first = rng.integers(0, n - 3, 4)
            for column, begin in zip(columns, first, strict=True):
                border[begin : begin + 3, column] = rng.standard_normal(len(border[begin : begin + 3]))
            border[:, LINKING - LEFT :] = rng.standard_normal((n, LEFT))
            borders.append(border)
            self.parts.append(np.concatenate([columns, np.arange(LINKING - LEFT, LINKING)]))
        a, b = block_diag(*bands), np.concatenate(borders)
        self.whole = np.block([[a, b], [b.T, np.zeros((LINKING, LINKING))]])
        # every row outweighs the rest of it
        self.whole += np.diag(np.abs(self.whole).sum(axis=1) + 1.0)
        self.ends = np.cumsum([0, *(n for n, _ in SIZES)])

    def factor(self) -> LinkedBands:
        content = []
        n = int(self.ends[-1])
        for (size, b), begin, columns in zip(SIZES, self.ends, self.parts, strict=False):
            own = self.whole[begin : begin + size, begin : begin + size]
            band = np.zeros((b + 1, size))
            for d in range(min(b + 1, size)):
                band[d, : size - d] = np.diag(own, -d)
            content.append(LinkedBand(band, self.whole[begin : begin + size, n + columns], columns))
        return LinkedBands(content, self.whole[n:, n:], LEFT)


def test_solutions_and_what_is_left_are_those_of_the_whole_matrix():
    system = System(1)
    factor = system.factor()
    inverse = np.linalg.inv(system.whole)
    # rounding: the matrix is nearly diagonal
    np.testing.assert_allclose(factor.information, np.linalg.inv(inverse[-LEFT:, -LEFT:]), rtol=1e-12)
    right = np.random.default_rng(2).standard_normal(len(system.whole))
    sides = np.split(right[: system.ends[-1]], system.ends[1:-1])
    halves, links = factor.condense(sides, right[system.ends[-1] :])
    wanted = inverse @ right
    step = np.linalg.solve(factor.information, factor.left(links))
    bands, moved = factor.solve(halves, links, step)
    np.testing.assert_allclose(np.concatenate([*bands, moved, step]), wanted, rtol=1e-10, atol=1e-14)


def test_diagonal_blocks_of_the_inverse_and_what_they_owe_to_what_is_left():
    system = System(3)
    found = list(system.factor().covariance(2))
    known = np.linalg.inv(system.whole[:-LEFT, :-LEFT])
    bridge = known @ system.whole[:-LEFT, -LEFT:]
    ends = [*system.ends, len(known)]
    for begin, end, (blocks, follow) in zip(ends[:-1], ends[1:], found, strict=True):
        for k, block in enumerate(blocks):
            rows = slice(begin + 2 * k, begin + 2 * k + 2)
            np.testing.assert_allclose(block, known[rows, rows], rtol=1e-10, atol=1e-15)
        np.testing.assert_allclose(follow, bridge[begin:end], rtol=1e-9, atol=1e-14)


def test_links_that_nothing_holds_are_refused():
    system = System(4)
    system.whole[-LINKING, -LINKING] = -1.0
    with pytest.raises(EstimationError, match="unknowns that link bands are not determined"):
        system.factor()
