"""Windows that depart from their neighbours, window by window with medians of lists."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.matching.agreement import CUT, NEIGHBOURS, departures, disagreeing, scatter


def by_hand(shift, sigma):
    rows, columns = shift.shape[:2]
    out = np.full((rows, columns), np.nan)
    for i in range(rows):
        for j in range(columns):
            steps = [k for k in range(-NEIGHBOURS, NEIGHBOURS + 1) if k]
            column = [shift[i + k, j] for k in steps if 0 <= i + k < rows]
            row = [shift[i, j + k] for k in steps if 0 <= j + k < columns]
            found = []
            for around in (column, row):
                around = np.array([one for one in around if np.isfinite(one).all()]).reshape(-1, 2)
                if len(around) >= 2 and np.isfinite(shift[i, j]).all():
                    # a median of n values has pi / 2n of the variance of one
                    spread = sigma[i, j] * np.sqrt(1.0 + np.pi / (2 * len(around)))
                    found.append(np.linalg.norm((shift[i, j] - np.median(around, axis=0)) / spread))
            out[i, j] = min(found, default=np.nan)
    return out


def test_a_window_is_compared_with_its_row_or_its_column_whichever_it_is_more_like():
    rng = np.random.default_rng(1)
    shift, sigma = rng.normal(size=(7, 9, 2)), rng.uniform(0.5, 2.0, (7, 9, 2))
    shift[:, 4] += 20.0  # relief along a column
    shift[2] -= 15.0  # a row that shook
    shift[rng.random((7, 9)) < 0.2] = np.nan
    shift[0, :6] = np.nan
    np.testing.assert_allclose(departures(shift, sigma), by_hand(shift, sigma), rtol=1e-12)
    one = shift[:1, :2]
    assert np.isnan(departures(one, np.ones_like(one))).all()


def test_departures_beyond_chance_and_what_is_common_to_most_disagree():
    rng = np.random.default_rng(2)
    # lengths of two normal components: one in 3000 beyond four
    usual = np.hypot(*rng.standard_normal((2, 100, 100)))
    assert scatter(usual) == pytest.approx(1.0, abs=0.03)
    assert scatter(3.0 * usual) == pytest.approx(3.0, abs=0.1)
    assert np.isnan(scatter(np.full(3, np.nan)))
    for size, limit in ((0.5, CUT), (1.0, CUT), (3.0, 3.0 * CUT)):
        spoilt = size * usual
        spoilt[0, :4] = np.array([0.9, 1.1, 5.0, np.nan]) * limit
        found = disagreeing(spoilt)
        assert found[0, :4].tolist() == [False, True, True, False]
        assert found.sum() < 10
