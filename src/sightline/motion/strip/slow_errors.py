"""Errors of matching that wander along the strip with what covers the ground, as unknowns of their own.

Where colours differ by what grows or stands there, an image is found a few hundredths of a pixel off its
place, alike over whole rows of windows for hundreds of lines. Rows do not average that, and it is no motion,
which moves all images that are exposed at one time: it belongs to an image and to a place of the ground. Each
image has an error along lines at nodes along the ground, straight between them; beforehand they are
Gauss-Markov processes, whose sizes are learned from what the estimate finds.

Not here: errors of single matches, and whether rows err alike for long (``motion/measure/match_noise.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.motion.measure.match_noise import lasts
from sightline.motion.measure.observations import Star

Array = NDArray[np.float64]

#: Lines of the hub between nodes, and over which an error falls to 1/e: fields, woods and towns of some
#: hundred pixels.
NODE_LINES, LENGTH_LINES = 120.0, 500.0
#: Strips of more nodes keep what lasts as part of the noise: all nodes stand in one dense border.
MOST_NODES = 40
#: Sizes begin at this part of the error of a row of windows, and stay near it where the images hardly tell.
BEGIN = 0.25
#: What a step of EM changes a size by is taken so many times, up to a factor of FASTEST: EM alone is slow
#: where the images hardly tell an error from the motion.
AHEAD, FASTEST = 3.0, 1.5
#: px; an error is taken for no smaller, so that its precision stays a number.
LEAST = 1e-4


@dataclass(frozen=True, eq=False)
class SlowErrors:
    """Unknowns of all images, node by node.

    Attributes
    ----------
    start, step : float
        s; first node and distance of nodes, in times that order the ground (`GroundOrder`).
    count : int
        Nodes.
    images : tuple of int
        Whose errors they are.
    sizes : (I,)
        px; standard deviation beforehand of each image's error along lines.
    """

    start: float
    step: float
    count: int
    images: tuple[int, ...]
    sizes: Array

    @property
    def each(self) -> int:
        """Unknowns of one node."""
        return len(self.images)

    def covers(self, stars: Sequence[Star]) -> bool:
        """Whether all images of these stars have unknowns."""
        return {i for s in stars for i in (s.hub, *s.images)} <= set(self.images)

    @property
    def _chain(self) -> Array:
        """(count, count) precision of a Gauss-Markov process of unit variance at the nodes."""
        kept = np.exp(-NODE_LINES / LENGTH_LINES)
        beside = np.eye(self.count, k=1) + np.eye(self.count, k=-1)
        out = np.diag(np.full(self.count, 1.0 + kept**2)) - kept * beside
        out[0, 0] = out[-1, -1] = 1.0
        return np.asarray(out / (1.0 - kept**2))

    @property
    def precision(self) -> Array:
        """(E, E) px^-2, of all unknowns beforehand."""
        return np.asarray(np.kron(self._chain, np.diag(1.0 / self.sizes**2)))

    def columns(self, star: Star, t_ground: Array) -> tuple[slice, NDArray[np.float32]]:
        """What the unknowns move some windows of a star by.

        Parameters
        ----------
        star : Star
        t_ground : (G,)
            s; of these windows, in times that order the ground.

        Returns
        -------
        slice
            The unknowns that reach them, C.
        (G, K, 2, C) float32
            px per px.
        """
        place = self._place(t_ground)
        node = np.minimum(place.astype(int), self.count - 2)
        first, last = int(node.min()), int(node.max()) + 2
        near = np.maximum(1.0 - np.abs(place[:, None] - np.arange(first, last)), 0.0)
        out = np.zeros((len(place), len(star.images), 2, last - first, self.each), np.float32)
        for k, image in enumerate(star.images):
            out[:, k, 0, :, self.images.index(star.hub)] = -near
            out[:, k, 0, :, self.images.index(image)] = near
        return slice(first * self.each, last * self.each), out.reshape(*out.shape[:3], -1)

    def moved(self, star: Star, t_ground: Array, found: Array) -> Array:
        """What errors that were found, (E,) px, move all windows of a star by, (G, K, 2) px."""
        place, at = self._place(t_ground), np.arange(self.count)
        nodes = dict(zip(self.images, found.reshape(self.count, self.each).T, strict=True))
        hub = np.interp(place, at, nodes[star.hub])
        out = np.zeros((len(place), len(star.images), 2))
        for k, image in enumerate(star.images):
            out[:, k, 0] = np.interp(place, at, nodes[image]) - hub
        return out

    def learned(self, found: Array, covariance: Array) -> SlowErrors:
        """Sizes nearer to those of the largest likelihood, by a posterior, (E,) px and (E, E) px^2."""
        nodes = found.reshape(self.count, self.each)
        spread = covariance.reshape(self.count, self.each, self.count, self.each)
        chain = self._chain
        power = np.einsum("ij,iu,ju->u", chain, nodes, nodes) + np.einsum("ij,iuju->u", chain, spread)
        change = np.sqrt(power / self.count) / self.sizes
        grown = self.sizes * np.clip(change**AHEAD, 1.0 / FASTEST, FASTEST)
        return replace(self, sizes=np.maximum(grown, LEAST))

    def _place(self, t_ground: Array) -> Array:
        """Where among the nodes, 0 to count - 1."""
        return np.asarray(np.clip((t_ground - self.start) / self.step, 0.0, self.count - 1.0))


def slow_errors(
    stars: Sequence[Star], post_px: Sequence[Array], t_ground: Sequence[Array]
) -> SlowErrors | None:
    """Errors to be followed where rows of windows err alike for long; None where they do not.

    Parameters
    ----------
    stars : sequence of Star
    post_px : sequence of (G, K, 2)
        Residuals after an estimate.
    t_ground : sequence of (G,)
        s; of all windows, in times that order the ground.
    """
    largest = int(np.argmax([star.present.sum() for star in stars]))
    star = stars[largest]
    if star.window is None or star.duration <= 0.0:
        return None
    step = NODE_LINES * star.duration / star.window[0]
    start = min(float(t.min()) for t in t_ground if len(t))
    end = max(float(t.max()) for t in t_ground if len(t))
    count = max(int(np.ceil((end - start) / step)) + 1, 2)
    if count > MOST_NODES or not lasts(star, post_px[largest]):
        return None
    row = float(np.sqrt(np.median(star.covariance_px[star.present][:, 0, 0]) / star.shape[1]))
    images = tuple(sorted({i for s in stars for i in (s.hub, *s.images)}))
    return SlowErrors(start, step, count, images, np.full(len(images), BEGIN * row))
