"""Student weights: near one where the motion is as believed, small where it jumps."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.estimation.evidence import posterior
from sightline.estimation.prior import Matern, Spectrum
from sightline.estimation.robust import expected_innovations, robust_sigma, robust_sigmas, student_weights
from sightline.estimation.series import DifferenceSeries, Grid, series_equations

STEP, N = 1e-3, 500
PRIOR = Spectrum((Matern(0.5, 0.1, "5/2"), Matern(0.02, 0.01))).autoregressive(STEP, 30, N)
LAGS = (43, 11)


def measured(x: np.ndarray) -> list[DifferenceSeries]:
    rng = np.random.default_rng(1)
    return [
        DifferenceSeries(
            np.arange(N - lag) * STEP, np.full(N - lag, lag * STEP),
            x[lag:] - x[:-lag] + 0.01 * rng.normal(size=N - lag), np.full(N - lag, 1e-4),
        )
        for lag in LAGS
    ]  # fmt: skip


def settled(x: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights and error after some rounds."""
    equations = series_equations(measured(x), Grid(0.0, STEP, N))
    weights = np.ones(N)
    for _ in range(rounds + 1):
        now = posterior(equations, PRIOR, weights=weights)
        error = now.mean - x
        expected = expected_innovations(PRIOR, now.mean, now.covariance_band(PRIOR.order))
        weights = student_weights(expected)
    return weights, error - error.mean()


def smooth_motion() -> np.ndarray:
    t = np.arange(N) * STEP
    return np.asarray(0.4 * np.sin(9.0 * t) + 0.02 * np.sin(60.0 * t))


def test_the_expected_squares_are_those_of_the_full_covariance() -> None:
    equations = series_equations(measured(smooth_motion()), Grid(0.0, STEP, N))
    now = posterior(equations, PRIOR)
    covariance = now.covariance_times(np.eye(N))
    unit = np.eye(N)
    rows = np.stack([PRIOR.innovations(unit[:, k]) for k in range(N)], axis=1)
    expected = (rows @ now.mean) ** 2 + np.einsum("ij,jk,ik->i", rows, covariance, rows)
    found = expected_innovations(PRIOR, now.mean, now.covariance_band(PRIOR.order))
    # Variances 1e-6 of those of the terms that cancel in them.
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_a_motion_as_believed_keeps_weights_near_one() -> None:
    weights, _ = settled(smooth_motion(), 3)
    assert 0.8 < weights.min() and weights.max() < 1.25


def test_a_step_is_followed_instead_of_smeared() -> None:
    jump = smooth_motion() + 0.3 * (np.arange(N) >= 250)
    _, plain = settled(jump, 0)
    weights, robust = settled(jump, 8)
    assert abs(int(np.argmin(weights)) - 250) <= 2
    near = slice(235, 265)
    assert np.abs(robust[near]).max() < 0.5 * np.abs(plain[near]).max()


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="`degrees` must be positive"):
        student_weights(np.ones(3), degrees=0.0)
    with pytest.raises(InputError, match="30 subdiagonals"):
        expected_innovations(PRIOR, np.zeros(N), np.zeros((5, N)))


def test_the_robust_sigma_is_that_of_gaussian_numbers_whatever_a_few_outliers_are():
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(20_000, 3)) * [1.0, 2.0, 5.0]
    # the median size of n numbers is known to 1.17 / sqrt(n)
    np.testing.assert_allclose(robust_sigmas(noise, axis=0), [1.0, 2.0, 5.0], rtol=0.03)
    assert robust_sigma(noise[:, 1]) == pytest.approx(2.0, rel=0.03)
    # one in a hundred outliers moves it as far as the quantile 0.505 lies from 0.5 of sizes: 1 %
    noise[::100] = 1e9
    np.testing.assert_allclose(robust_sigmas(noise.T, axis=1), [1.0, 2.0, 5.0], rtol=0.05)
    # nothing is subtracted: numbers about another place are not about zero
    assert robust_sigma([10.0, -10.0, 10.0]) == pytest.approx(14.826)
