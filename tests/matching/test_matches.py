"""The table of matches."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.matching import matches
from sightline.matching.matches import Matches, concatenate_matches


def some(n=4):
    status = np.arange(n) % 8
    return Matches(np.ones((n, 2)), np.ones((n, 2)), np.tile(0.04 * np.eye(2), (n, 1, 1)), np.ones(n), status)


def test_rows_are_counted_by_reason_and_only_status_zero_is_kept():
    found = some(10)
    assert found.kept.tolist() == [True] + 7 * [False] + [True, False]
    assert (
        found.counts()["kept"] == 2 and found.counts()["outlier"] == 1 and sum(found.counts().values()) == 10
    )
    assert found.sigma_px[0] == pytest.approx([0.2, 0.2])


def test_arrays_are_read_only_and_rows_can_be_picked():
    found = some(10)
    with pytest.raises(ValueError, match="read-only"):
        found.b[0, 0] = 3.0
    assert len(found[found.kept]) == 2 and len(found[2:5]) == 3


def test_a_rejected_row_keeps_its_first_reason():
    again = some(3).with_status(np.array([True, True, False]), matches.OUTLIER)
    assert again.status.tolist() == [matches.OUTLIER, matches.OUTSIDE, matches.MASKED]


def test_parts_are_joined_in_order_and_nothing_cannot_be_joined():
    assert len(concatenate_matches([some(3), some(2)])) == 5
    with pytest.raises(InputError, match="at least one set"):
        concatenate_matches([])


def test_columns_of_unequal_length_are_refused():
    with pytest.raises(InputError, match="`score` has shape"):
        Matches(np.ones((3, 2)), np.ones((3, 2)), np.ones((3, 2, 2)), np.ones(2), np.zeros(3))
