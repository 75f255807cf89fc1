"""What outliers do not move: a robust sigma; weights of a prior's innovations where a motion jumps.

A stationary prior takes a single step or the switch-on of a tone for something it cannot be, and
smears it over its neighbours. With innovations of Student's distribution instead of a Gaussian one,
each epoch gets a weight from how surprising it is after the data; a few rounds settle it
(expectation and maximisation). Where the motion is as believed all weights stay near one.

Not here: the estimate under given weights (``evidence.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.compiled import njit
from sightline.errors import InputError
from sightline.estimation.prior import Autoregressive

Array = NDArray[np.float64]

#: Degrees of freedom of the innovations: 4 lets one epoch in a thousand be 7 times its sigma.
DEGREES = 4.0
#: Sigma over the median size of Gaussian numbers.
_GAUSSIAN = 1.4826


def robust_sigma(residuals: ArrayLike) -> float:
    """1-sigma of Gaussian numbers about zero from their median size, which outliers hardly move.

    Parameters
    ----------
    residuals : array
        In any unit; at least one, none of them NaN.
    """
    return _GAUSSIAN * float(np.median(np.abs(residuals)))


def robust_sigmas(residuals: ArrayLike, axis: int) -> Array:
    """As `robust_sigma`, of the numbers along an axis: one for each place of the others."""
    return np.asarray(_GAUSSIAN * np.median(np.abs(residuals), axis=axis))


def expected_innovations(prior: Autoregressive, mean: Array, covariance_band: Array) -> Array:
    """Posterior expectation of the squared standardised innovations, (n,).

    Parameters
    ----------
    prior : Autoregressive
        Of n epochs and order p.
    mean : (n,)
        Posterior mean of the motion.
    covariance_band : (p + 1 or more, n)
        Lower band of its posterior covariance.

    Returns
    -------
    (n,)
        On average 1 where the motion is as believed, whatever the data say.
    """
    if len(mean) != prior.n or covariance_band.shape[1] != prior.n or len(covariance_band) <= prior.order:
        raise InputError(
            f"`mean` and `covariance_band` must cover {prior.n} epochs and {prior.order} subdiagonals, got "
            f"{np.shape(mean)} and {covariance_band.shape}"
        )
    spread = _row_variances(prior.table, np.ascontiguousarray(covariance_band))
    return prior.innovations(mean) ** 2 + np.maximum(spread, 0.0) / prior.variances


def student_weights(expected: Array, *, degrees: float = DEGREES) -> Array:
    """Weights (n,) of innovations or residuals from their expected squares, ``(nu + 1) / (nu + e^2)``.

    Scaled so that an expected square of one weighs one.
    """
    if not degrees > 0.0:
        raise InputError(f"`degrees` must be positive, got {degrees}; 4 is usual, large means Gaussian")
    return np.asarray((degrees + 1.0) / (degrees + np.asarray(expected)), dtype=np.float64)


def doubted_weights(squared: ArrayLike, cut: float) -> Array:
    """Weights (n,) of measurements by squares, over their variance, of what they lie off the others.

    1 within `cut` sigmas, the fourth power of cut over that beyond: what lies farther off has less to say,
    not the same.
    """
    beyond = np.minimum(1.0, cut**2 / np.maximum(np.asarray(squared, dtype=np.float64), 1e-12))
    return np.asarray(beyond**2)


@njit(cache=True, nogil=True)
def _row_variances(table, band):  # type: ignore[no-untyped-def]
    """Variance of every innovation row under a covariance given as a lower band."""
    p = table.shape[0] - 1
    out = np.zeros(band.shape[1])
    for t in range(band.shape[1]):
        m = min(t, p)
        row = table[m]
        total = 0.0
        for k in range(m + 1):
            part = 0.5 * row[k] * band[0, t - k]
            for h in range(k):
                part += row[h] * band[k - h, t - k]
            total += 2.0 * row[k] * part
        out[t] = total
    return out
