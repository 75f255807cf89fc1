"""A banded system eliminated in blocks is the system solved at once."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import EstimationError, InputError
from sightline.estimation.banded import BandedFactor
from sightline.estimation.banded_blocks import BlockwiseFactor

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
