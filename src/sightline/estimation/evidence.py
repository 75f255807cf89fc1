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
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.estimation.banded import BorderedFactor, band_times
from sightline.estimation.prior import Autoregressive
from sightline.estimation.series import SeriesEquations
from sightline.estimation.split import Layout, SplitPrior, gather_band, spread_band

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EvenRate:
    """The even rate of a motion, by least squares over its grid, known beside the differences.

    Attributes
    ----------
    value : float
        Unit of the motion per s.
    seen : bool
        Whether something saw it, so that it tells of the spectrum as well. Otherwise it is where something
        hidden was put.
    sigma : float
        Unit of the motion per s; to which it is known.
    """

    value: float
    seen: bool = False
    sigma: float = 0.0

    def told(self, prior_variance: float) -> float:
        """-2 log density of the rate where it is not to tell of the spectrum, else 0."""
        variance = prior_variance + self.sigma**2
        return 0.0 if self.seen else self.value**2 / variance + math.log(variance)


@dataclass(frozen=True, eq=False)
class _Held:
    """How a posterior is held at an even rate.

    Attributes
    ----------
    rate : EvenRate
    weights : (n,)
        Of the motion on the grid, 1/s.
    column : (n,), beside : (q,)
        Covariance of motion and constants with the rate, before it was held.
    variance : float
        Of the rate then, beside what it is known by.
    pull : float
        By how much the rate was larger than it is held at, over its variance.
    prior_variance : float
        Of the rate under the prior.
    """

    rate: EvenRate
    weights: Array
    column: Array
    beside: Array
    variance: float
    pull: float
    prior_variance: float

    @property
    def deviance(self) -> float:
        """What holding adds to that of the data, beside the misfit."""
        return math.log(self.variance) - self.rate.told(self.prior_variance)


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of one axis after the measurements.

    Build it with `posterior`.

    Attributes
    ----------
    equations : NormalEquations
        The data.
    prior : Autoregressive or SplitPrior
        The prior on the same grid.
    noise_scale : float
        Factor on every measurement variance.
    offset_sigma : float
        Prior sigma of the constant of each image.
    factor : BorderedFactor
        Of the posterior precision.
    position : (n,)
        Where the epochs stand among the unknowns of `factor`.
    mean : (n,)
        Posterior mean of the motion on the grid.
    offsets : (q,)
        Posterior mean of the images' constants.
    prior_band : (p + 1, N)
        Precision of the prior, all unknowns.
    held : _Held or None
        Where the even rate of the motion is known.
    """

    equations: SeriesEquations
    prior: Autoregressive | SplitPrior
    noise_scale: float
    offset_sigma: float
    factor: BorderedFactor
    position: NDArray[np.int64]
    mean: Array
    offsets: Array
    prior_band: Array
    held: _Held | None = None

    def covariance_band(self, width: int) -> Array:
        """Lower band of the covariance of the motion on the grid, (width + 1, n)."""
        n = len(self.position)
        if self.factor.n == n:
            return self.factor.covariance_band(width)
        near = min(width, n - 1)
        reach = int(np.max(self.position[near:] - self.position[: n - near]))
        return gather_band(self.factor.covariance_band(reach), self.position, width)

    def covariance_times(self, directions: Array) -> Array:
        """Covariance of the motion on the grid times `directions`, (n,) or (n, k)."""
        spread = np.zeros((self.factor.n, *directions.shape[1:]))
        spread[self.position] = directions
        return np.asarray(self.factor.times(spread)[0][self.position], dtype=np.float64)

    @property
    def misfit(self) -> float:
        """Chi-square of data and prior together after the fit; its expectation is `measurements`."""
        e = self.equations
        out = (e.misfit - float(e.rhs @ self.mean) - float(e.rhs_border @ self.offsets)) / self.noise_scale
        return out if self.held is None else out - self.held.rate.value * self.held.pull

    @property
    def deviance(self) -> float:
        """-2 log of the marginal likelihood, without the constant ``measurements * log(2 pi)``."""
        e = self.equations
        q = len(self.offsets)
        logdet_prior = self.prior.logdet - 2.0 * q * math.log(self.offset_sigma)
        logdet_noise = e.logdet_noise + e.measurements * math.log(self.noise_scale)
        held = 0.0 if self.held is None else self.held.deviance
        return self.misfit + self.factor.logdet - logdet_prior + logdet_noise + held

    @property
    def score(self) -> Array:
        """Derivative (n,) of the data's log-likelihood by the motion, at the posterior mean."""
        out = band_times(self.prior_band, self.mean)
        if self.held is not None:
            out += self.held.weights * self.held.pull
        return out

    def seen_of(self, waves: Array) -> Array:
        """Expected products (k, k) of the score's parts along `waves` (n, k) where the model is right."""
        e, scale = self.equations, self.noise_scale
        data = band_times(e.band, waves) / scale
        explained, _ = self.factor.solve(data, e.border.T @ waves / scale)
        out = band_times(self.prior_band, waves).T @ explained
        if self.held is not None:
            along = waves.T @ (self.held.weights - band_times(self.prior_band, self.held.column))
            out += np.outer(along, along) / self.held.variance
        return np.asarray(out)

    @cached_property
    def moments(self) -> Moments:
        """Second moments of the motion that the evidence's gradient needs; for a plain prior only."""
        held = self.held
        rate, weights = (None, None) if held is None else (held.rate, held.weights)
        return moments_of(self.mean, self._near_covariance, len(self.prior_band) - 1, rate, weights)

    @cached_property
    def _near_covariance(self) -> Array:
        """Covariance of all unknowns as far from the diagonal as the prior's precision reaches."""
        out = self.factor.covariance_band(len(self.prior_band) - 1)
        if self.held is not None:
            column = self.held.column / math.sqrt(self.held.variance)
            for d in range(len(out)):
                out[d, : len(column) - d] -= column[d:] * column[: len(column) - d]
        return out

    @property
    def deviance_by_noise_scale(self) -> float:
        """Derivative of `deviance` by the logarithm of the noise scale."""
        e, s = self.equations, self.noise_scale
        fit = float(self.mean @ band_times(e.band, self.mean)) + float(
            self.offsets @ (2.0 * (e.border.T @ self.mean) + e.corner @ self.offsets)
        )
        residual = e.misfit - 2.0 * float(e.rhs @ self.mean + e.rhs_border @ self.offsets) + fit
        # trace(N Z) of data and covariance, from trace((prior + N / s) Z) = number of unknowns
        covariance = self._near_covariance
        prior_trace = 2.0 * float(np.sum(self.prior_band * covariance))
        prior_trace -= float(self.prior_band[0] @ covariance[0])
        unknowns = self.factor.n + len(self.offsets)
        offset_trace = float(np.trace(self.factor.border_covariance))
        if self.held is not None:
            unknowns -= 1
            offset_trace -= float(self.held.beside @ self.held.beside) / self.held.variance
        offset_trace /= self.offset_sigma**2
        spread = s * (unknowns - prior_trace - offset_trace)
        return e.measurements - (residual + spread) / s


@dataclass(frozen=True, eq=False)
class Moments:
    """Posterior second moments of a motion as an autoregression sees them.

    Build them with `moments_of`.

    Attributes
    ----------
    start : (p, p)
        E[x_i x_j] of the first p epochs.
    inner : (p + 1, p + 1)
        Sum over t >= p of E[x_{t-k} x_{t-l}].
    rate : EvenRate or None
        Where it is known; `weights` (n,) are those of `rate_weights`.
    """

    start: Array
    inner: Array
    rate: EvenRate | None = None
    weights: Array | None = None

    def deviance_slope(self, prior: Autoregressive, autocovariance: Array) -> Array:
        """Derivative (p + 1,) of the evidence's deviance by the autocovariances that `prior` was made of.

        That of the expectation of -2 log density of the motion, at the prior that gave these moments
        (Fisher's identity).
        """
        by_rows, by_variances = _slopes(
            prior.table[:, 1:], prior.all_variances, prior.n, self.start, self.inner
        )
        if self.rate is not None and self.weights is not None and not self.rate.seen:
            variance = prior.variance_of(self.weights) + self.rate.sigma**2
            more = prior.slopes_of_variance(self.weights)
            by_told = self.rate.value**2 / variance**2 - 1.0 / variance
            by_rows += by_told * more[0]
            by_variances += by_told * more[1]
        return prior.slope(autocovariance, by_rows, by_variances)


def posterior(
    equations: SeriesEquations,
    prior: Autoregressive | SplitPrior,
    *,
    noise_scale: float = 1.0,
    offset_sigma: float = 1.0,
    weights: Array | None = None,
    rate: EvenRate | None = None,
) -> Posterior:
    """Combine data and prior.

    Parameters
    ----------
    equations : NormalEquations
        The data on a grid of n epochs.
    prior : Autoregressive or SplitPrior
        Of the same n epochs.
    noise_scale : float
        Factor on every measurement variance.
    offset_sigma : float
        Prior sigma of the constant of each image, where the equations have them.
    weights : array (n,), optional
        Weights of the prior's rows; see `Autoregressive.precision_band`. The deviance leaves them out.
    rate : EvenRate, optional
        Of the motion: the posterior, and the likelihood of the data, are those of motions that have it. For
        a plain prior only.
    """
    e = equations
    n, q = e.border.shape
    if isinstance(prior, SplitPrior):
        layout = Layout.interleaved(n, prior.ratio)
        position, size = np.ascontiguousarray(layout.fine[:, 0]), layout.size
        prior_band = np.zeros((prior.width(layout) + 1, size))
        prior.add_to(prior_band, layout, weights=weights)
    else:
        position, size = np.arange(n, dtype=np.int64), n
        prior_band = prior.precision_band(weights)
    near = min(len(e.band) - 1, n - 1)
    reach = int(np.max(position[near:] - position[: n - near]))
    band = np.zeros((max(len(prior_band), reach + 1), size))
    spread_band(e.band / noise_scale, position, band)
    band[: len(prior_band)] += prior_band
    border, rhs = np.zeros((size, q)), np.zeros(size)
    border[position], rhs[position] = e.border / noise_scale, e.rhs / noise_scale
    factor = BorderedFactor(band, border, e.corner / noise_scale + np.eye(q) / offset_sigma**2)
    mean, offsets = factor.solve(rhs, e.rhs_border / noise_scale)
    held = None
    if rate is not None and isinstance(prior, Autoregressive):
        held = _held(rate, e, factor, prior, mean)
        mean = mean - held.column * held.pull
        offsets = offsets - held.beside * held.pull
    return Posterior(
        e, prior, noise_scale, offset_sigma, factor, position, mean[position], offsets, prior_band, held
    )


def _held(
    rate: EvenRate, e: SeriesEquations, factor: BorderedFactor, prior: Autoregressive, mean: Array
) -> _Held:
    """How a posterior of a `mean` is held at a rate."""
    weights = rate_weights(e.grid.nodes)
    column, beside = factor.solve(weights, np.zeros(e.border.shape[1]))
    variance = float(weights @ column) + rate.sigma**2
    pull = (float(weights @ mean) - rate.value) / variance
    return _Held(rate, weights, column, beside, variance, pull, prior.variance_of(weights))


def rate_weights(nodes: Array) -> Array:
    """Weights (count,) of a motion at `nodes` (s) whose sum is its even rate (1/s), by least squares."""
    t = nodes - nodes.mean()
    return np.asarray(t / (t @ t))


def moments_of(
    mean: Array,
    covariance: Array,
    p: int,
    rate: EvenRate | None = None,
    weights: Array | None = None,
    loose: Array | None = None,
) -> Moments:
    """Second moments for a prior of order `p`.

    Parameters
    ----------
    mean : (n,)
        Of the posterior.
    covariance : (p + 1, n)
        Lower band of its covariance.
    p : int
    rate : EvenRate, optional
        At which the posterior is held; `weights` (n,) are those of `rate_weights`.
    loose : (n,), optional
        Weights of the prior's rows, see `Autoregressive.precision_band`: 1 before the epoch `p`.
    """
    start, inner = _second_moments(mean, covariance, p)
    back = np.arange(p + 1)
    apart, later = np.abs(np.subtract.outer(back, back)), np.maximum.outer(back, back)
    for t in [] if loose is None else np.flatnonzero(loose[p:] < 1.0) + p:
        here = covariance[apart, t - later] + np.outer(mean[t - back], mean[t - back])
        inner -= (1.0 - loose[t]) * here  # type: ignore[index]
    return Moments(start, inner, rate, weights)


@njit(cache=True, nogil=True)
def _second_moments(mean, covariance, p):  # type: ignore[no-untyped-def]
    """Those of the first p epochs, and of p + 1 epochs in a row summed over all places."""
    n = len(mean)
    start = np.zeros((p, p))
    inner = np.zeros((p + 1, p + 1))
    running = np.zeros(n + 1)
    for d in range(p + 1):
        for j in range(n - d):
            product = covariance[d, j] + mean[j + d] * mean[j]
            running[j + 1] = running[j] + product
            if j + d < p:
                start[j + d, j] = start[j, j + d] = product
        for later in range(d, p + 1):  # the further look-back of the two
            inner[later, later - d] = running[n - later] - running[p - later]
            inner[later - d, later] = inner[later, later - d]
    return start, inner


@njit(cache=True, nogil=True)
def _slopes(coefficients, variances, n, start, inner):  # type: ignore[no-untyped-def]
    """Derivatives of the expected -2 log density by the table's rows (p + 1, p) and variances (p + 1,).

    A row reads ``x_t - sum(c_k x_{t-1-k})``; `coefficients` are the -c. The last row is that of all epochs
    from p on.
    """
    p = len(variances) - 1
    by_rows = np.zeros((p + 1, p))
    by_variances = np.zeros(p + 1)
    product = np.empty(p + 1)
    row = np.empty(p + 1)
    for t in range(p + 1):
        row[0] = 1.0
        for k in range(t):
            row[k + 1] = coefficients[t, k]
        square = 0.0
        for k in range(t + 1):
            total = 0.0
            if t < p:
                for h in range(t + 1):
                    total += start[t - k, t - h] * row[h]
            else:
                for h in range(t + 1):
                    total += inner[k, h] * row[h]
            product[k] = total
            square += row[k] * total
        count = 1.0 if t < p else float(n - p)
        by_variances[t] = count / variances[t] - square / variances[t] ** 2
        for k in range(t):
            by_rows[t, k] = -2.0 * product[k + 1] / variances[t]
    return by_rows, by_variances
