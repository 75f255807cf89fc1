"""Dense Gaussian-process reference: the formulas of a smoother with full matrices, for tests only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import toeplitz


@dataclass(frozen=True)
class Dense:
    """Posterior mean and covariance, and -2 log evidence without log(2 pi)."""

    mean: np.ndarray
    covariance: np.ndarray
    deviance: float


class DenseReference:
    """Drift (5/2, 2, 1 s) + broadband (3/2, 0.1, 5 ms) + a tone (0.3, 47 Hz, 0.8 Hz wide), 1 ms grid."""

    step = 1e-3

    def covariance(self, n: int, *, drift: float = 2.0, timescale: float = 1.0) -> np.ndarray:
        """Covariance (n, n) of the motion."""
        lag = np.arange(n) * self.step
        a, b = np.sqrt(5.0) * lag / timescale, np.sqrt(3.0) * lag / 0.005
        row = drift**2 * (1.0 + a + a * a / 3.0) * np.exp(-a) + 0.01 * (1.0 + b) * np.exp(-b)
        turn = 2.0 * np.pi * 47.0 * lag
        row += 0.09 * np.exp(-np.pi * 0.8 * lag) * (np.cos(turn) + 0.8 / (2.0 * 47.0) * np.sin(turn))
        row[0] *= 1.0 + 1e-10
        return toeplitz(row)

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """One motion (n,)."""
        return np.linalg.cholesky(self.covariance(n)) @ rng.normal(size=n)

    def solve(self, prior: np.ndarray, rows: np.ndarray, noise: np.ndarray, y: np.ndarray) -> Dense:
        """Gaussian conditioning; where `noise` is singular the deviance means nothing."""
        total = rows @ prior @ rows.T + noise
        gain = prior @ rows.T @ np.linalg.pinv(total, rcond=1e-11, hermitian=True)
        deviance = float(y @ np.linalg.solve(total, y) + np.linalg.slogdet(total)[1])
        return Dense(gain @ y, prior - gain @ rows @ prior, deviance)


@pytest.fixture(scope="session")
def dense() -> DenseReference:
    """The reference."""
    return DenseReference()
