"""Whether sigmas are true: bounds of squared errors over covariances, on both sides.

`assert_consistent` is the test of a covariance: it fails where all sigmas are a quarter larger or a fifth
smaller than they are, and fails as well where so few samples could not show that: pool seeds then.
`assert_possible` is what one draw can show: neither far too large nor suspiciously small. What takes more
flights or strips than a test may cost is held by the same bounds in validation/ (`make validate`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

#: Factors of sigma that a test must reject.
LARGER, SMALLER = 1.25, 0.8


def bounds(degrees: float, chance: float = 1e-3) -> tuple[float, float]:
    """Bounds of a chi-square over its `degrees` of freedom, missed by `chance` in all where sigma is true."""
    return chi2.ppf(0.5 * chance, degrees) / degrees, chi2.isf(0.5 * chance, degrees) / degrees


def assert_consistent(
    squares: ArrayLike, freedom: float = 1.0, *, degrees: float | None = None, wider: float = 0.0
) -> None:
    """Squared errors over covariances, each of `freedom` degrees, are as large as they should be on the mean.

    Parameters
    ----------
    squares : (N,)
    freedom : float
        Degrees of freedom of each.
    degrees : float, optional
        What all are worth as independent ones, by default N x `freedom`.
    wider : float
        By how much more the mean over its degrees may be off, where sigma is only known so well; derive it.
    """
    values = np.asarray(squares, dtype=np.float64)
    mean = float(values.mean() / freedom)
    low, high = bounds(values.size * freedom if degrees is None else degrees)
    low, high = low - wider, high + wider
    assert low <= mean <= high, (
        f"mean squared error over covariance {mean:.3f}, {low:.3f} to {high:.3f} expected"
    )
    larger, smaller = mean / LARGER**2, mean / SMALLER**2
    assert larger < low, f"sigmas {LARGER} times as large would pass ({larger:.3f}): pool more"
    assert smaller > high, f"sigmas {SMALLER} times as large would pass ({smaller:.3f}): pool more"


def assert_possible(square: float, freedom: float, chance: float = 2e-4) -> None:
    """One squared error over its covariance is within what one draw is, on both sides."""
    low, high = chi2.ppf(0.5 * chance, freedom), chi2.isf(0.5 * chance, freedom)
    assert low <= square <= high, (
        f"squared error over covariance {square:.3g}, {low:.3g} to {high:.3g} expected"
    )
