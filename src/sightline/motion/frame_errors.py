"""How errors of matches, relief and prior move an estimate of frames: its covariance, and that of differences.

Noise of an image moves every match that uses the same pixels: the windows of a hub at all its
lags, and windows of neighbouring stars that overlap. Estimates from different lags share it, as
they share the ground and what was believed before.

Not here: the estimate (``frames.py``), the laws of the errors (``frame_noise.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.motion.frame_matches import FrameStar
from sightline.motion.frame_noise import FrameNoise

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Influence:
    """Linear map from everything that errs to P outcomes.

    Attributes
    ----------
    stars : sequence of FrameStar
        The matches that were used.
    gains : per star (G, K, 2, P)
        Change of the outcomes with the error of each match, in units of the matcher's Cholesky factor.
    fields : tuple of (sum of G, P)
        Change with the true height (and drift) of each window's ground, per m; none where heights are known.
    prior : (U, P)
        Change with the departure of each true unknown from its prior mean.
    """

    stars: Sequence[FrameStar]
    gains: list[Array]
    fields: tuple[Array, ...]
    prior: Array

    def through(self, matrix: Array) -> Influence:
        """Influence on ``matrix @ outcomes``, matrix (Q, P)."""
        fields = tuple(field @ matrix.T for field in self.fields)
        return replace(self, gains=[g @ matrix.T for g in self.gains], fields=fields, prior=self.prior @ matrix.T)

    def spread_over(self, stars: Sequence[FrameStar]) -> Influence:
        """The same influence laid out over more matches of the same windows, which have none."""
        place = {star.hub: k for k, star in enumerate(self.stars)}
        outcomes = self.prior.shape[1]
        first = np.cumsum([0] + [len(star.pixels) for star in self.stars])
        gains: list[Array] = []
        fields: list[list[Array]] = [[] for _ in self.fields]
        for star in stars:
            gain = np.zeros((len(star.pixels), len(star.images), 2, outcomes))
            k = place.get(star.hub)
            if k is not None:
                gain[:, [star.images.index(image) for image in self.stars[k].images]] = self.gains[k]
            gains.append(gain)
            for parts, field in zip(fields, self.fields, strict=True):
                none = np.zeros((len(star.pixels), outcomes))
                parts.append(none if k is None else field[first[k] : first[k + 1]])
        return Influence(stars, gains, tuple(np.concatenate(parts) for parts in fields), self.prior)

    def plus(self, other: Influence) -> Influence:
        """Sum of two influences on the same outcomes through the same matches."""
        gains = [a + b for a, b in zip(self.gains, other.gains, strict=True)]
        fields = tuple(a + b for a, b in zip(self.fields, other.fields, strict=True))
        return Influence(self.stars, gains, fields, self.prior + other.prior)


def outcome_covariance(influence: Influence, noise: FrameNoise, ground: Array, prior_covariance: Array) -> Array:
    """Covariance (P, P) of the outcomes.

    Parameters
    ----------
    influence : Influence
    noise : FrameNoise
    ground : (sum of G, 3)
        m; where the windows look.
    prior_covariance : (U, U)
        Of the unknowns before any match.
    """
    out = influence.prior.T @ prior_covariance @ influence.prior
    for gain, field in zip(influence.fields, noise.fields, strict=True):
        out = out + gain.T @ field.covariance(ground, ground) @ gain
    for star, gain in zip(influence.stars, influence.gains, strict=True):
        # a match of robust weight w was taken for one of variance 1/w
        size = np.where(star.present, 1.0 / np.sqrt(np.maximum(star.weight, 1e-12)), 0.0)
        errors = gain * size[:, :, None, None]
        out = out + np.einsum("gkcp,kl,glcq->pq", errors, noise.of(star.lags), errors, optimize=True)
    return out + neighbour_covariance(influence, noise.shared)


def neighbour_covariance(influence: Influence, shared: float) -> Array:
    """What different windows that use the same pixels add to the covariance (P, P).

    Parameters
    ----------
    influence : Influence
    shared : float
        Variance that the noise of one image brings, in units of the matcher's.
    """
    outcomes = influence.prior.shape[1]
    out = np.zeros((outcomes, outcomes))
    for places, gains in _uses(influence):
        common = common_share(places, places, influence.stars[0].window)
        np.fill_diagonal(common, 0.0)
        for axis in range(2):
            out += shared * gains[:, axis].T @ (common @ gains[:, axis])
    return np.asarray(0.5 * (out + out.T))


def _uses(influence: Influence) -> list[tuple[Array, Array]]:
    """Per image: places (M, 2) px of the windows that use it, and their gains (M, 2, P); hubs err backwards."""
    images = sorted({star.hub for star in influence.stars} | {i for star in influence.stars for i in star.images})
    places: dict[int, list[Array]] = {image: [] for image in images}
    gains: dict[int, list[Array]] = {image: [] for image in images}
    for star, gain in zip(influence.stars, influence.gains, strict=True):
        used = star.present
        windows = used.any(axis=1)
        places[star.hub].append(star.pixels[windows])
        gains[star.hub].append(-np.where(used[..., None, None], gain, 0.0).sum(axis=1)[windows])
        for k, image in enumerate(star.images):
            places[image].append(star.measured[used[:, k], k])
            gains[image].append(gain[used[:, k], k])
    return [(np.concatenate(places[image]), np.concatenate(gains[image])) for image in images]


def common_share(first: Array, second: Array, window: tuple[int, int]) -> Array:
    """Share of pixels (N, M) that windows at `first` and `second` (px) have in common."""
    out = np.ones((len(first), len(second)))
    for axis in range(2):
        apart = np.abs(first[:, None, axis] - second[None, :, axis]) / window[axis]
        out *= np.maximum(1.0 - apart, 0.0)
    return out
