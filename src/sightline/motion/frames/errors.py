"""How errors of matches, relief and prior move an estimate of frames: covariance, also of differences.

Noise of an image moves every match that uses the same pixels: the windows of a hub at all its
lags, and windows of neighbouring stars that overlap. Estimates from different lags share it, as
they share the ground and what was believed before.

Not here: the estimate (``solve.py``), the laws of the errors (``noise.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.noise import FrameNoise, cholesky_factors

Array = NDArray[np.float64]

#: px; 1-sigma of what interpolation and aliasing move whole regions of one image: what mean residuals of
#: pairs of rendered frames scatter beyond the noise of their windows (0.0009 px per pair,
#: benchmarks/frames_validation.py).
BIAS_PX = 0.0006
#: How far such a region reaches, in windows.
BIAS_LENGTH_WINDOWS = 3.0
#: Pairs of windows of one image that are held at one time, 56 bytes each; more are gone through in blocks.
HELD = 1 << 23


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
        gains = [gain @ matrix.T for gain in self.gains]
        fields = tuple(field @ matrix.T for field in self.fields)
        return replace(self, gains=gains, fields=fields, prior=self.prior @ matrix.T)

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


def outcome_covariance(
    influence: Influence, noise: FrameNoise, ground: Array, prior_covariance: Array
) -> Array:
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
    """What different windows of one image err together, beyond each by itself: covariance (P, P).

    Windows that use the same pixels share their noise; and interpolation biases whole regions of an image
    alike, by a thousandth of a pixel, which many windows cannot average.

    Parameters
    ----------
    influence : Influence
    shared : float
        Variance that the noise of one image brings, in units of the matcher's.
    """
    outcomes = influence.prior.shape[1]
    out = np.zeros((outcomes, outcomes))
    star = influence.stars[0]
    length = BIAS_LENGTH_WINDOWS * max(star.window)
    for places, gains, gains_px in _uses(influence):
        rows = max(HELD // max(len(places), 1), 1)
        for first in range(0, len(places), rows):
            block = slice(first, first + rows)
            common = common_share(places[block], places, star.window)
            np.fill_diagonal(common[:, first:], 0.0)
            apart = ((places[block, None] - places[None]) ** 2).sum(axis=2) / length**2
            alike = BIAS_PX**2 * np.exp(-0.5 * apart)
            for axis in range(2):
                out += shared * gains[block, axis].T @ (common @ gains[:, axis])
                out += gains_px[block, axis].T @ (alike @ gains_px[:, axis])
    return np.asarray(0.5 * (out + out.T))


def _uses(influence: Influence) -> Iterator[tuple[Array, Array, Array]]:
    """Per image: places (M, 2) px of the windows that use it, their gains (M, 2, P), hubs erring backwards.

    Gains are given twice: per unit of the scaled error, and per px.
    """
    images = sorted({image for star in influence.stars for image in (star.hub, *star.images)})
    found: dict[int, list[tuple[Array, Array, Array]]] = {image: [] for image in images}
    for star, gain in zip(influence.stars, influence.gains, strict=True):
        used = star.present
        windows = used.any(axis=1)
        scaled_gain = np.where(used[..., None, None], gain, 0.0)
        inverse = np.linalg.inv(cholesky_factors(star.covariance_px))
        gain_px = np.einsum("gkij,gkip->gkjp", inverse, scaled_gain)
        hub = (-scaled_gain.sum(axis=1)[windows], -gain_px.sum(axis=1)[windows])
        found[star.hub].append((star.pixels[windows], *hub))
        for k, image in enumerate(star.images):
            rows = used[:, k]
            found[image].append((star.measured[rows, k], scaled_gain[rows, k], gain_px[rows, k]))
    for image in images:
        places, gains, gains_px = (np.concatenate(column) for column in zip(*found.pop(image), strict=True))
        yield places, gains, gains_px


def common_share(first: Array, second: Array, window: tuple[int, int]) -> Array:
    """Share of pixels (N, M) that windows at `first` and `second` (px) have in common."""
    out = np.ones((len(first), len(second)))
    for axis in range(2):
        apart = np.abs(first[:, None, axis] - second[None, :, axis]) / window[axis]
        out *= np.maximum(1.0 - apart, 0.0)
    return out
