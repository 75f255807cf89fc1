"""The tests' own test of sigma: what it passes, what it rejects, and what it calls too little to tell."""

from __future__ import annotations

import numpy as np
import pytest

from consistency import LARGER, SMALLER, assert_consistent, assert_possible


@pytest.fixture(scope="module")
def squares():
    """Squared errors of six angles over their covariance, sixty draws."""
    return np.random.default_rng(0).chisquare(6, 60)


def test_true_sigmas_pass(squares):
    assert_consistent(squares, 6)


@pytest.mark.parametrize("factor", [LARGER, SMALLER])
def test_sigmas_a_quarter_too_large_or_a_fifth_too_small_are_rejected(squares, factor):
    with pytest.raises(AssertionError, match="mean squared error over covariance"):
        assert_consistent(squares / factor**2, 6)


def test_samples_that_could_not_show_it_are_too_few(squares):
    with pytest.raises(AssertionError, match="pool more"):
        assert_consistent(squares[:10], 6)


@pytest.mark.parametrize("square", [0.0, 1e-3, 60.0, float("nan")])
def test_one_draw_is_neither_far_too_small_nor_far_too_large(square):
    assert_possible(5.0, 6)
    with pytest.raises(AssertionError, match="squared error over covariance"):
        assert_possible(square, 6)
