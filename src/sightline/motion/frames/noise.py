"""Errors of matches between frames: what lags share, what windows share, and unknown relief.

Four causes are kept apart: noise of each image (shared by every match that uses the same pixels,
so that neighbouring pairs err against each other), disagreement of a pair (which grows with the
change of view), parallax of relief, and what drifts over the ground, as clouds do. The last two
are fields on the ground that all frames see: relief moves windows along the parallax, drift
across it, both in proportion to the base between two frames (drift along it looks like relief).

Not here: the estimate (``solve.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.robust import robust_sigma
from sightline.motion.measure.observations import Star

Array = NDArray[np.float64]

#: Scaled errors beyond this do not teach the covariance.
CLIP = 4.0
#: Fewest matches from which the covariance of a pair of lags is learned.
MIN_COUNT = 60
#: Points from which the law of a ground field is learned (a subset is drawn if there are more).
RELIEF_POINTS = 600


@dataclass(frozen=True, eq=False)
class GroundField:
    """Relief, or drift across the parallax in heights of the same effect: offset, smooth part, rough part.

    Attributes
    ----------
    offset_sigma : float
        m; of the mean.
    sigma, length : float
        m; of the smooth part, Matern 3/2.
    rough_sigma, rough_length : float
        m; of what only windows that overlap share, and how far that reaches (about half a window).
    """

    offset_sigma: float
    sigma: float
    length: float
    rough_sigma: float
    rough_length: float

    def covariance(self, first: Array, second: Array) -> Array:
        """Covariance (N, M) m^2 of the heights at ground points (N, 3) and (M, 3) m; NaN rows are alone."""
        from scipy.spatial.distance import cdist

        distance = np.sqrt(3.0) * cdist(np.nan_to_num(first), np.nan_to_num(second))
        out = np.full(distance.shape, self.offset_sigma**2)
        for sigma, length in ((self.sigma, self.length), (self.rough_sigma, self.rough_length)):
            r = distance / length
            out += sigma**2 * (1.0 + r) * np.exp(-r)
        return out


@dataclass(frozen=True, eq=False)
class FrameNoise:
    """Errors of matches, in units of the matcher's own sigma.

    Attributes
    ----------
    lags : tuple of int
    gamma : (L, L)
        Covariance of the errors of one window found at several lags.
    shared : float
        Variance that the noise of one image brings, shared by all matches that use the same pixels.
    fields : tuple of GroundField
        Relief and drift, or none where heights are known.
    """

    lags: tuple[int, ...]
    gamma: Array
    shared: float
    fields: tuple[GroundField, ...] = ()

    @classmethod
    def start(
        cls, lags: Sequence[int], fields: tuple[GroundField, ...] = (), scale: float = 1.0
    ) -> FrameNoise:
        """Two images of equal noise, as the matcher says, times `scale` in sigma."""
        gamma = scale**2 * (0.5 + 0.5 * np.eye(len(lags)))
        return cls(tuple(lags), gamma, 0.5 * scale**2, fields)

    def of(self, lags: Sequence[int]) -> Array:
        """Covariance (K, K) for some lags."""
        rows = [self.lags.index(lag) for lag in lags]
        return np.asarray(self.gamma[np.ix_(rows, rows)])


def cholesky_factors(covariance_px: Array) -> Array:
    """Lower Cholesky factors (..., 2, 2) of the matches' covariances."""
    return np.asarray(np.linalg.cholesky(covariance_px), dtype=np.float64)


def whitened_by(values: Array, factors: Array) -> Array:
    """`values` (G, K, 2, ...) divided by the Cholesky factors (G, K, 2, 2)."""
    first = values[:, :, 0] / _like(factors[:, :, 0, 0], values[:, :, 0])
    second = (values[:, :, 1] - _like(factors[:, :, 1, 0], first) * first) / _like(
        factors[:, :, 1, 1], values[:, :, 1]
    )
    return np.stack([first, second], axis=2)


def _like(factor: Array, values: Array) -> Array:
    """(G, K) given as many trailing axes as `values`."""
    return factor.reshape(factor.shape + (1,) * (values.ndim - 2))


def match_information(star: Star, noise: FrameNoise) -> Array:
    """Information (G, K, K) of each window's matches together: the inverse of gamma where they are present.

    Robust weights multiply sqrt(w) on either side.
    """
    gamma = noise.of([image - star.hub for image in star.images])
    present = star.present
    out = np.zeros((*present.shape, present.shape[1]))
    for pattern in np.unique(present, axis=0):
        if not pattern.any():
            continue
        rows = np.flatnonzero((present == pattern).all(axis=1))
        seen = np.flatnonzero(pattern)
        inverse = np.linalg.inv(gamma[np.ix_(seen, seen)])
        out[np.ix_(rows, seen, seen)] = inverse
    root = np.sqrt(np.where(present, star.weight, 0.0))
    return np.asarray(out * root[:, :, None] * root[:, None, :])


def across(along: Array) -> Array:
    """Scaled sensitivities (G, K, 2) to a height, turned by a right angle: those to a drift of the same size.

    With matches weighed alike on both (scaled) axes, the two know nothing of each other: what a window says
    of its height and what it says of its drift are independent.
    """
    return np.stack([-along[..., 1], along[..., 0]], axis=-1)


def learn_noise(
    stars: Sequence[Star],
    clean_px: Sequence[Array],
    explained: Sequence[Array],
    lags: Sequence[int],
    before: FrameNoise,
) -> FrameNoise:
    """Covariance of errors from residuals that no height can make.

    Parameters
    ----------
    stars : sequence of Star
    clean_px : (G, K, 2) each
        Residuals after the fit, what the ground fields explain taken out, px.
    explained : (parts, G, K, K) each
        Covariance of what the fit takes out of the errors, which is given back (expectation-maximisation):
        ``FrameEstimate.explained``. With ground fields, only residuals across the parallax are used: along
        it, heights of single windows take too much.
    lags : sequence of int
    before : FrameNoise
        Stays where there are too few matches at any lag.
    """
    index = {lag: k for k, lag in enumerate(lags)}
    total, count = np.zeros((len(lags), len(lags))), np.zeros((len(lags), len(lags)))
    relief = bool(before.fields)
    spread = _spreads(stars, clean_px, lags, relief)
    for star, clean, taken in zip(stars, clean_px, explained, strict=True):
        rows = [index[image - star.hub] for image in star.images]
        limit = CLIP * spread[rows]
        for part, covariance in zip(_free_of_height(star, clean, relief), taken, strict=True):
            good = (star.present & np.isfinite(part) & (np.abs(part) <= limit)).astype(np.float64)
            values = np.where(good > 0.0, part, 0.0)
            total[np.ix_(rows, rows)] += values.T @ values
            total[np.ix_(rows, rows)] += np.einsum("gij,gi,gj->ij", covariance, good, good, optimize=True)
            count[np.ix_(rows, rows)] += good.T @ good
    gamma = _completed(total / np.maximum(count, 1.0), count >= MIN_COUNT)
    if gamma is None:
        return before
    return FrameNoise(tuple(lags), gamma, _shared(gamma), before.fields)


def _completed(gamma: Array, known: NDArray[np.bool_]) -> Array | None:
    """A covariance of lags whose rarely matched ones take what the others have; None where nothing is known.

    Lags that are not known err as much as the worst that is, and share with others what two images of equal
    noise do: a guess that mixes levels would let their differences seem exact.
    """
    seen = np.diag(known)
    if not seen.any():
        return None
    size = np.where(seen, np.sqrt(np.diag(gamma)), np.sqrt(np.diag(gamma)[seen].max()))
    both = known & np.outer(seen, seen)
    correlation = np.where(both, gamma / np.outer(size, size), 0.5)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    correlation = (vectors * np.maximum(values, 0.1)) @ vectors.T
    return np.asarray(correlation * np.outer(size, size))


def _shared(gamma: Array) -> float:
    """Variance of one image's noise: what lags have in common, at most half of the smallest variance."""
    half = 0.5 * float(np.diag(gamma).min())
    if len(gamma) == 1:
        return half
    return float(np.clip(np.median(gamma[~np.eye(len(gamma), dtype=bool)]), 0.0, half))


def _spreads(stars: Sequence[Star], clean_px: Sequence[Array], lags: Sequence[int], relief: bool) -> Array:
    """Robust sigma of the scaled errors at each lag."""
    pools: dict[int, list[Array]] = {lag: [] for lag in lags}
    for star, clean in zip(stars, clean_px, strict=True):
        for part in _free_of_height(star, clean, relief):
            for k, image in enumerate(star.images):
                good = star.present[:, k] & np.isfinite(part[:, k])
                pools[image - star.hub].append(np.abs(part[good, k]))
    medians = [np.concatenate(pool) if pool else np.empty(0) for pool in pools.values()]
    return np.array([robust_sigma(pool) if len(pool) else 1.0 for pool in medians])


def free_directions(star: Star, relief: bool) -> list[Array]:
    """Directions (G, K, 2) of scaled residuals that are free of heights: both axes, or across the parallax.

    0 where there is no parallax.
    """
    along = whitened_by(np.asarray(star.by_height, dtype=np.float64), cholesky_factors(star.covariance_px))
    if not relief:
        return [np.broadcast_to(axis, along.shape) for axis in np.eye(2)]
    length = np.linalg.norm(along, axis=2, keepdims=True)
    return [across(np.divide(along, length, out=np.zeros_like(along), where=length > 0.0))]


def _free_of_height(star: Star, clean_px: Array, relief: bool) -> list[Array]:
    """Scaled residuals (G, K) free of heights, NaN where there is no parallax to tell."""
    z = whitened_by(clean_px, cholesky_factors(star.covariance_px))
    parts = []
    for direction in free_directions(star, relief):
        known = (direction != 0.0).any(axis=2)
        parts.append(np.where(known, (direction * z).sum(axis=2), np.nan))
    return parts


def learn_field(ground: Array, height: Array, precision: Array, start: GroundField) -> GroundField:
    """Law of a ground field by marginal likelihood of what single windows say.

    Parameters
    ----------
    ground : (N, 3)
        m; where the windows look.
    height : (N,)
        m; what each window's matches alone say of its height (or drift).
    precision : (N,)
        1/m^2; of `height`; 0 where a window says nothing.
    start : GroundField
        Its offset stays.
    """
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize

    usable = np.flatnonzero((precision > 0) & np.isfinite(ground).all(axis=1) & np.isfinite(height))
    if len(usable) < MIN_COUNT:
        return start
    usable = usable[np.unique(np.linspace(0, len(usable) - 1, RELIEF_POINTS).astype(int))]
    points, y, noise = ground[usable], height[usable], 1.0 / precision[usable]
    extent = float(np.ptp(points, axis=0).max())

    def cost(x: Array) -> float:
        sigma, length, rough = (float(v) for v in np.exp(x))
        field = GroundField(start.offset_sigma, sigma, length, rough, start.rough_length)
        c = field.covariance(points, points) + np.diag(noise)
        factor, lower = cho_factor(c + 1e-9 * np.trace(c) / len(c) * np.eye(len(c)), lower=True)
        fit = float(y @ cho_solve((factor, lower), y)) + 2.0 * float(np.log(np.diag(factor)).sum())
        # outside sensible laws the likelihood is flat; lean on where it is not
        low = [0.02 * start.sigma, 0.01 * extent, 0.01 * start.sigma]
        bounds = np.log([low, [5 * start.sigma, extent, 5 * start.sigma]])
        beyond = np.maximum(bounds[0] - x, 0.0) ** 2 + np.maximum(x - bounds[1], 0.0) ** 2
        return fit + 1e3 * float(beyond.sum())

    x0 = np.log([start.sigma, start.length, max(start.rough_sigma, 0.1 * start.sigma)])
    best = minimize(cost, x0, method="Nelder-Mead", options={"maxfev": 80, "xatol": 0.05, "fatol": 0.5})
    sigma, length, rough = np.exp(best.x)
    return GroundField(start.offset_sigma, float(sigma), float(length), float(rough), start.rough_length)
