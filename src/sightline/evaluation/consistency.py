"""Whether stated sigmas are true: squared errors in units of them, and how many of the errors they cover.

What all scores say of their sigmas. Not here: the errors themselves (``score*.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Two-sided 95 % point of the normal distribution.
Z95 = 1.959963984540054


@dataclass(frozen=True)
class Consistency:
    """How true sigmas are.

    Attributes
    ----------
    nees : float
        Mean of (error / sigma)^2: 1 when the sigmas are true.
    samples : float
        Independent errors that the mean is worth.
    nees_low, nees_high : float
        Where `nees` falls 95 times in 100 when the sigmas are true.
    coverage_95 : float
        Part of the errors within 1.96 sigma.
    """

    nees: float
    samples: float
    nees_low: float
    nees_high: float
    coverage_95: float


def consistency(scaled: Array, samples: float | None = None) -> Consistency:
    """How true the sigmas are that errors were divided by.

    Parameters
    ----------
    scaled : (N,)
        Errors in units of their sigma.
    samples : float, optional
        Independent errors that they are worth; N by default.
    """
    degrees = float(len(scaled)) if samples is None else samples
    low, high = likely_mean(degrees)
    squares, covered = float(np.mean(scaled**2)), float(np.mean(np.abs(scaled) <= Z95))
    return Consistency(squares, degrees, low, high, covered)


def likely_mean(samples: float) -> tuple[float, float]:
    """Range that holds the mean of so many squared normal numbers 95 times in 100 (chi-square)."""
    from scipy.special import gammaincinv

    half = 0.5 * samples
    return float(gammaincinv(half, 0.025) / half), float(gammaincinv(half, 0.975) / half)


def squares_over_covariance(errors: Array, covariance: Array) -> Array:
    """Squared errors (M,) in units of their covariance.

    Parameters
    ----------
    errors : (M, k)
    covariance : (M, k, k)

    Raises
    ------
    numpy.linalg.LinAlgError
        Where a covariance is singular: it claims that a combination of errors is known exactly.
    """
    whole = np.linalg.solve(covariance, errors[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("mi,mi->m", errors, whole))
