"""Linear estimating equations: what they solve for, with covariance, and what they cannot determine.

The equations are H a + s = 0, where H and s are sums over observations whose errors are correlated; the
spread of H a + s about 0 at the true a is the meat V, so that the covariance of a is H^-1 V H^-1.

Not here: where H, s and V come from (``epipolar.py``, ``plane.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.checks import Array, ReadOnlyArrays

#: Share of the largest eigenvalue of the scaled normal matrix below which a direction has not been seen.
#: Round-off leaves 1e-16 to 1e-15; the weakest direction that two shots a second apart determine has some
#: 1e-9.
_UNSEEN = 1e-13
#: Least share of a direction's curvature that must not be noise of the coefficients.
_LEAST_SIGNAL = 0.2
#: Least component of an unobservable direction (unit vector) by which it touches an unknown.
_TOUCH = 1e-3


@dataclass(frozen=True, eq=False)
class DeterminedDirections(ReadOnlyArrays):
    """Directions that a normal matrix determines, and those it does not.

    Attributes
    ----------
    solver, forms : (P, R)
        Along R determined directions: ``coordinates = -solver.T @ right``, ``unknowns = solver @ ...``; the
        coordinates as linear forms of the unknowns.
    basis : (P, R)
        The directions themselves.
    unobservable : (G, P)
        Unit vectors that span the others.
    """

    basis: Array
    solver: Array
    forms: Array
    unobservable: Array

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Unknowns (P,) that an unobservable direction moves."""
        return np.asarray((np.abs(self.unobservable) > _TOUCH).any(axis=0))

    def solve(self, right: Array) -> Array:
        """Unknowns (P,) of normal @ unknowns + right = 0, with nothing along unobservable directions."""
        return np.asarray(-self.solver @ (self.basis.T @ right))

    def covariance(self, meat: Array) -> tuple[Array, Array]:
        """Covariance and information (P, P) of the unknowns, `meat` being that of ``normal @ truth + right``.

        The covariance of touched unknowns is inf, nan beside the diagonal; the information along unobservable
        directions is 0.
        """
        spread = self.solver.T @ meat @ self.solver
        covariance = self.basis @ spread @ self.basis.T
        away = np.eye(len(meat)) - self.unobservable.T @ self.unobservable
        forms = away @ self.forms
        information = forms @ np.linalg.pinv(spread, hermitian=True) @ forms.T
        touched = self.touched
        covariance[touched] = np.nan
        covariance[:, touched] = np.nan
        covariance[touched, touched] = np.inf
        return covariance, 0.5 * (information + information.T)


def observe(normal: Array, measured: Array | None = None) -> DeterminedDirections:
    """Which directions a normal matrix determines.

    Parameters
    ----------
    normal : (P, P)
        Symmetric; what the noise of coefficients adds to it taken out, where that is wanted.
    measured : (P, P) or None
        As measured, noise of the coefficients included; None: `normal` itself. A direction is determined
        where some curvature was measured and most of it is not noise.
    """
    measured = normal if measured is None else measured
    diagonal = np.diag(measured)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(measured * np.outer(scale, scale))
    seen = values > _UNSEEN * values[-1]
    # coordinates in which `measured` is the identity
    whitened = vectors[:, seen] / np.sqrt(values[seen])
    signal, turned = np.linalg.eigh(whitened.T @ (normal * np.outer(scale, scale)) @ whitened)
    above = signal > _LEAST_SIGNAL
    span = scale[:, None] * (whitened @ turned)
    basis = span[:, above]
    return DeterminedDirections(
        basis,
        basis / signal[above],
        measured @ basis,
        _orthonormal(np.hstack([scale[:, None] * vectors[:, ~seen], span[:, ~above]])),
    )


def marginal_information(information: Array, kept: int) -> Array:
    """Information (kept, kept) on the first unknowns when nothing is known of the others."""
    mixed = information[:kept, kept:]
    others = np.linalg.pinv(information[kept:, kept:], hermitian=True)
    return np.asarray(information[:kept, :kept] - mixed @ others @ mixed.T)


def _orthonormal(vectors: Array) -> Array:
    """Orthonormal rows (G, P) that span the columns (P, G) given."""
    if not vectors.shape[1]:
        return np.asarray(vectors.T)
    return np.ascontiguousarray(np.linalg.qr(vectors / np.linalg.norm(vectors, axis=0))[0].T)
