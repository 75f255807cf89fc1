"""Robust rejection along the strip."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.matching.matches import OUTLIER, Matches
from sightline.matching.outliers import local_deviation, reject_outliers, robust_sigma


def strip(n, sigma=0.02):
    lines = np.repeat(np.arange(n // 10) * 4.0, 10)
    a = np.column_stack([lines, np.tile(np.arange(10) * 100.0, n // 10)])
    return Matches(a, a, np.tile(sigma**2 * np.eye(2), (n, 1, 1)), np.ones(n), np.zeros(n))


def test_robust_sigma_of_normal_numbers_is_their_sigma():
    values = np.random.default_rng(0).normal(0, 2.0, 20000)
    values[:2000] = 1e6
    # 10 % far outliers on one side raise the figure by about 13 %
    assert robust_sigma(values) == pytest.approx(2.0, rel=0.2)


def test_gross_errors_are_rejected_and_jitter_is_not():
    rng = np.random.default_rng(1)
    found = strip(2000)
    jitter = 0.3 * np.sin(2 * np.pi * found.a[:, 0] / 40)[:, None]  # a tone of 10 windows' period
    residuals = jitter + rng.normal(0, 0.02, (2000, 2))
    wrong = rng.choice(2000, 60, replace=False)
    residuals[wrong, 1] += 2.0
    status = reject_outliers(found, residuals, neighbours=20).status
    assert (status[wrong] == OUTLIER).mean() > 0.95
    assert (np.delete(status, wrong) == OUTLIER).mean() < 0.01


def test_short_and_empty_sets_are_handled():
    departure, sigma = local_deviation(np.arange(3.0), np.array([0.0, np.nan, 1.0]))
    assert np.isnan(departure[1]) and np.isfinite(departure[[0, 2]]).all() and np.isfinite(sigma[0])
    assert np.isnan(local_deviation(np.arange(2.0), np.full(2, np.nan))[0]).all()


def test_residuals_of_another_length_are_refused():
    with pytest.raises(InputError, match="one row per match"):
        reject_outliers(strip(20), np.zeros((3, 2)))
