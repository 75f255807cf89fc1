"""How true stated sigmas are, against tables of chi-square and draws."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.evaluation.consistency import consistency, likely_mean, squares_over_covariance


def test_the_likely_mean_is_chi_square_over_its_degrees():
    # tables of chi-square: 2.5 % and 97.5 % of 1, 6 and 30 degrees of freedom
    for degrees, low, high in ((1, 0.000982, 5.0239), (6, 1.2373, 14.4494), (30, 16.7908, 46.9792)):
        assert likely_mean(degrees) == pytest.approx((low / degrees, high / degrees), rel=1e-4)


def test_true_sigmas_are_consistent_as_often_as_said_and_wrong_ones_are_not():
    rng = np.random.default_rng(4)
    draws = rng.normal(size=(400, 25))
    found = [consistency(row) for row in draws]
    inside = np.mean([one.nees_low <= one.nees <= one.nees_high for one in found])
    assert inside == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / 400))
    assert np.mean([one.coverage_95 for one in found]) == pytest.approx(0.95, abs=0.007)
    assert found[0].nees == pytest.approx(np.mean(draws[0] ** 2)) and found[0].samples == 25.0
    # each number ten times: worth as many as they are, not as they stand there
    repeated = consistency(np.repeat(draws[0], 10), samples=25.0)
    assert (repeated.nees_low, repeated.nees_high) == (found[0].nees_low, found[0].nees_high)
    halved = consistency(2.0 * draws.ravel())
    assert halved.nees > halved.nees_high and halved.coverage_95 < 0.7


def test_squares_over_covariance_count_degrees_of_freedom_whatever_the_axes():
    rng = np.random.default_rng(5)
    factor = rng.normal(size=(3, 3))
    errors = rng.normal(size=(2000, 3)) @ factor.T
    squares = squares_over_covariance(errors, np.broadcast_to(factor @ factor.T, (2000, 3, 3)))
    assert squares.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 2000))
    assert squares_over_covariance(np.array([[3.0, 4.0]]), np.diag([9.0, 4.0])[None]) == pytest.approx([5.0])
    with pytest.raises(np.linalg.LinAlgError):
        squares_over_covariance(errors[:1], np.zeros((1, 3, 3)))
