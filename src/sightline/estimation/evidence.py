"""Posterior of one axis under a given prior, and how well that prior explains the data.

The posterior is Gaussian: precision = prior's band + the data's normal equations. The evidence is
its exact marginal likelihood, and its derivative by any parameter of the prior costs no more than
the band of the inverse (Fisher's identity), so that many parameters can be fitted at once.

Not here: the search for those parameters (``likelihood.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sightline.estimation.banded import BorderedFactor
from sightline.estimation.prior import Autoregressive
from sightline.estimation.series import NormalEquations

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of one axis after the measurements.

    Build it with `posterior`.

    Attributes
    ----------
    equations : NormalEquations
        The data.
    prior : Autoregressive
        The prior on the same grid.
    noise_scale : float
        Factor on every measurement variance.
    offset_sigma : float
        Prior sigma of the constant of each image.
    factor : BorderedFactor
        Of the posterior precision.
    mean : (n,)
        Posterior mean of the motion on the grid.
    offsets : (q,)
        Posterior mean of the images' constants.
    """

    equations: NormalEquations
    prior: Autoregressive
    noise_scale: float
    offset_sigma: float
    factor: BorderedFactor
    mean: Array
    offsets: Array
    prior_band: Array

    def covariance_band(self, width: int) -> Array:
        """Lower band of the covariance of the motion on the grid, (width + 1, n)."""
        return self.factor.covariance_band(width)

    @property
    def misfit(self) -> float:
        """Chi-square of data and prior together after the fit; its expectation is `measurements`."""
        e = self.equations
        return (e.misfit - float(e.rhs @ self.mean) - float(e.rhs_border @ self.offsets)) / self.noise_scale

    @property
    def deviance(self) -> float:
        """-2 log of the marginal likelihood, without the constant ``measurements * log(2 pi)``."""
        e = self.equations
        q = len(self.offsets)
        logdet_prior = self.prior.logdet - 2.0 * q * math.log(self.offset_sigma)
        logdet_noise = e.logdet_noise + e.measurements * math.log(self.noise_scale)
        return self.misfit + self.factor.logdet - logdet_prior + logdet_noise

    @cached_property
    def moments(self) -> Moments:
        """Second moments of the motion that the evidence's gradient needs."""
        return _moments(self.mean, self.covariance_band(self.prior.order), self.prior.order)

    @property
    def deviance_by_noise_scale(self) -> float:
        """Derivative of `deviance` by the logarithm of the noise scale."""
        e, s = self.equations, self.noise_scale
        fit = float(self.mean @ band_times(e.band, self.mean)) + float(
            self.offsets @ (2.0 * (e.border.T @ self.mean) + e.corner @ self.offsets)
        )
        residual = e.misfit - 2.0 * float(e.rhs @ self.mean + e.rhs_border @ self.offsets) + fit
        # trace(N Z) of data and covariance, from trace((prior + N / s) Z) = number of unknowns
        covariance = self.covariance_band(self.prior.order)
        prior_trace = 2.0 * float(np.sum(self.prior_band * covariance))
        prior_trace -= float(self.prior_band[0] @ covariance[0])
        unknowns = len(self.mean) + len(self.offsets)
        offset_trace = float(np.trace(self.factor.border_covariance)) / self.offset_sigma**2
        spread = s * (unknowns - prior_trace - offset_trace)
        return e.measurements - (residual + spread) / s


@dataclass(frozen=True, eq=False)
class Moments:
    """Posterior second moments of a motion as an autoregression sees them.

    start : (p, p)        E[x_i x_j] of the first p epochs
    inner : (p + 1, p + 1)  sum over t >= p of E[x_{t-k} x_{t-l}]
    """

    start: Array
    inner: Array

    def expected_deviance(self, prior: Autoregressive) -> float:
        """Expectation of -2 log density of the motion under `prior` (constant dropped).

        Its derivative by the prior's parameters, at the prior that gave these moments, is that of
        the evidence (Fisher's identity).
        """
        p = prior.order
        row = np.concatenate([[1.0], -prior.coefficients])
        total = float(row @ self.inner @ row) / prior.variance
        if p:
            total += _start_misfit(prior.startup, prior.startup_variances, self.start)
        return total - prior.logdet


def posterior(
    equations: NormalEquations,
    prior: Autoregressive,
    *,
    noise_scale: float = 1.0,
    offset_sigma: float = 1.0,
    weights: Array | None = None,
) -> Posterior:
    """Combine data and prior.

    Parameters
    ----------
    equations : NormalEquations
        The data on a grid of n epochs.
    prior : Autoregressive
        Of the same n epochs.
    noise_scale : float
        Factor on every measurement variance.
    offset_sigma : float
        Prior sigma of the constant of each image, where the equations have them.
    weights : array (n,), optional
        Weights of the prior's rows; see `Autoregressive.precision_band`. The deviance leaves them out.
    """
    e = equations
    prior_band = prior.precision_band(weights)
    width = max(len(prior_band), len(e.band))
    band = np.zeros((width, e.grid.count))
    band[: len(e.band)] = e.band / noise_scale
    band[: len(prior_band)] += prior_band
    corner = e.corner / noise_scale + np.eye(len(e.corner)) / offset_sigma**2
    factor = BorderedFactor(band, e.border / noise_scale, corner)
    mean, offsets = factor.solve(e.rhs / noise_scale, e.rhs_border / noise_scale)
    return Posterior(e, prior, noise_scale, offset_sigma, factor, mean, offsets, prior_band)


def band_times(band: Array, x: Array) -> Array:
    """Product of a symmetric matrix in lower band storage with `x`, (n,) or (n, k)."""
    n = len(x)
    out = band[0].reshape((-1,) + (1,) * (x.ndim - 1)) * x
    for d in range(1, min(len(band), n)):
        row = band[d, : n - d].reshape((-1,) + (1,) * (x.ndim - 1))
        out[d:] += row * x[: n - d]
        out[: n - d] += row * x[d:]
    return np.asarray(out, dtype=np.float64)


def _moments(mean: Array, covariance: Array, p: int) -> Moments:
    """Second moments from posterior mean and band of the covariance."""
    n = len(mean)
    start = np.zeros((p, p))
    inner = np.zeros((p + 1, p + 1))
    for d in range(p + 1):
        product = covariance[d, : n - d] + mean[d:] * mean[: n - d]
        if d < p:
            rows = np.arange(p - d)
            start[rows + d, rows] = start[rows, rows + d] = product[: p - d]
        running = np.concatenate([[0.0], np.cumsum(product)])
        later = np.arange(d, p + 1)  # the further look-back of the two
        inner[later, later - d] = running[n - later] - running[p - later]
        inner[later - d, later] = inner[later, later - d]
    return Moments(start, inner)


@njit(cache=True)
def _start_misfit(startup, variances, moments):  # type: ignore[no-untyped-def]
    """Expected sum of squared standardised innovations of the first p epochs."""
    total = 0.0
    for t in range(len(variances)):
        square = moments[t, t]
        for k in range(t):
            square -= 2.0 * startup[t, k] * moments[t, t - 1 - k]
            for h in range(t):
                square += startup[t, k] * startup[t, h] * moments[t - 1 - k, t - 1 - h]
        total += square / variances[t]
    return total
