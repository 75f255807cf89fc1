"""Polynomial motion by weighted least squares: S1's method for the low frequencies.

``theta(t) = sum of theta_k t^k, k = 1 .. degree``; the constant is never observable.

Not here: what is left over, jitter (``inverse.py``, ``wiener.py`` take it from there).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import EstimationError, InputError
from sightline.geometry.checks import as_times
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.observability import polynomial_terms

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PolynomialFit:
    """A polynomial motion in Legendre terms 1 .. degree over a span.

    Attributes
    ----------
    coefficients : (degree, 3)
        rad; roll, pitch, yaw.
    covariance : (degree, 3, degree, 3)
        rad^2, from the errors of the differences alone.
    span : (float, float)
        s; where the terms run from -1 to 1.
    """

    coefficients: Array
    covariance: Array
    span: tuple[float, float]

    @property
    def degree(self) -> int:
        """Highest power of time."""
        return len(self.coefficients)

    def angles(self, t: Array) -> Array:
        """(N, 3) rad at times `t`, less the constant that nobody sees."""
        return np.asarray(polynomial_terms(t, *self.span, self.degree) @ self.coefficients)

    def differences(self, t: Array, lag: Array) -> Array:
        """(N, 3) rad: what a pair of this `lag` sees of the polynomial."""
        return self.angles(t + lag) - self.angles(t)

    def relative_covariance(self, t: Array) -> Array:
        """(N, 3, 3) rad^2 of the motion at `t` less its mean over `t`."""
        terms = polynomial_terms(t, *self.span, self.degree)
        terms = terms - terms.mean(axis=0)
        return np.einsum("na,axby,nb->nxy", terms, self.covariance, terms, optimize=True)


def fit_polynomial(differences: Sequence[AngleDifferences], *, degree: int = 5) -> PolynomialFit:
    """Polynomial through all differences of all pairs, weighted by their inverse covariance.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        Each with its own times and lags; gaps do no harm.
    degree : int
        Highest power of time, 1 or more.

    Raises
    ------
    EstimationError
        If there are fewer differences than terms.

    Notes
    -----
    S1, III: rows ``(t + tau)^k - t^k``, ``Theta = (M' G^-1 M)^-1 M' G^-1 DTheta``. The same motions are
    spanned here by Legendre terms, which keeps the normal equations well conditioned. G holds the errors of
    the differences only; that of a motion that is no polynomial is correlated over a lag and is not in it.
    """
    if degree < 1:
        raise InputError(f"`degree` must be 1 or more, got {degree}; the constant is never observable")
    pairs = checked_differences(differences)
    t = np.concatenate([d.t for d in pairs])
    end = np.concatenate([d.t + d.lag for d in pairs])
    if len(t) < degree:
        raise EstimationError(
            f"a polynomial of degree {degree} cannot be fitted to {len(t)} differences; "
            f"at least {degree} are needed; lower `degree`"
        )
    span = (float(min(t.min(), end.min())), float(max(t.max(), end.max())))
    rows = polynomial_terms(end, *span, degree) - polynomial_terms(t, *span, degree)
    weight = np.linalg.inv(np.concatenate([d.covariance for d in pairs]))
    values = np.concatenate([d.angles for d in pairs])
    normal = np.einsum("ia,ib,ixy->axby", rows, rows, weight, optimize=True).reshape(3 * degree, -1)
    right = np.einsum("ia,ixy,iy->ax", rows, weight, values, optimize=True).ravel()
    scale = 1.0 / np.sqrt(np.diag(normal))
    try:
        inverse = np.linalg.inv(normal * scale[:, None] * scale)
    except np.linalg.LinAlgError:
        raise EstimationError(
            f"the {len(t)} differences do not determine a polynomial of degree {degree}: their times are "
            "too few or too close; lower `degree`"
        ) from None
    covariance = inverse * scale[:, None] * scale
    coefficients = (covariance @ right).reshape(degree, 3)
    return PolynomialFit(coefficients, covariance.reshape(degree, 3, degree, 3), span)


def polynomial(differences: Sequence[AngleDifferences], t: ArrayLike, *, degree: int = 5) -> Motion:
    """Motion as a polynomial of time, fitted to all pairs.

    Parameters
    ----------
    differences : sequence of AngleDifferences
    t : (N,)
        s; where the motion is wanted.
    degree : int
        S1: "in general not above 5".

    Returns
    -------
    Motion
        Of mean zero over `t`. The covariance holds the errors of the differences and, as white jitter, what
        the residuals show beyond them: S1's ``epsilon(t)``.
    """
    times = as_times(t, "t", increasing=True)
    fit = fit_polynomial(differences, degree=degree)
    angles = fit.angles(times)
    covariance = fit.relative_covariance(times) + np.diag(unexplained_variance(differences, fit))
    return Motion(times, angles - angles.mean(axis=0), covariance)


def unexplained_variance(differences: Sequence[AngleDifferences], fit: PolynomialFit) -> Array:
    """(3,) rad^2: variance of the motion that is not in the polynomial, from the residuals.

    Jitter that changes over a lag enters a difference twice, so half of what the residuals show beyond their
    own errors; slower jitter shows less and is underestimated.
    """
    excess, weights = np.zeros(3), np.zeros(3)
    for d in checked_differences(differences):
        own = np.einsum("nii->ni", d.covariance)
        residual = d.angles - fit.differences(d.t, d.lag)
        excess += ((residual**2 - own) / own).sum(axis=0)
        weights += (1.0 / own).sum(axis=0)
    return np.asarray(np.maximum(0.5 * excess / weights, 0.0))


def checked_differences(differences: Sequence[AngleDifferences]) -> Sequence[AngleDifferences]:
    """The same differences, refused where there is none."""
    if isinstance(differences, AngleDifferences):
        raise InputError(
            "`differences` is a sequence, one item per pair of images; put the single one in a list"
        )
    if sum(len(d) for d in differences) == 0:
        raise EstimationError(
            "there are no angle differences at all; match images before recovering a motion"
        )
    return [d for d in differences if len(d)]
