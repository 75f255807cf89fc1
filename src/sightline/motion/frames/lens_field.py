"""What a lens does beyond its few constants: a smooth field of small shifts fixed to the detector.

Windows in front of a camera, filters and moulded lenses leave tenths of a pixel that no radial
polynomial follows. All frames share them, so that neighbouring pairs err together: the covariance
must know it. The field is estimated with the attitudes, its size learned from the matches.

Not here: focal length, principal point, distortion (``motion/statics.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Correlation length of the field in larger sides of the detector, and distance of its nodes in lengths.
LENGTH_SHARE, NODE_SHARE = 0.1, 0.8
#: Smallest sigma (px) that a learned field falls to.
LEAST_SIGMA_PX = 1e-3


@dataclass(frozen=True, eq=False)
class LensField:
    """Shifts (line, column) px of the image against the lens model, Gaussian with a Matern 5/2 covariance.

    Attributes
    ----------
    shape : (lines, columns)
        Of the detector.
    sigma_px : float
        px; of each component.
    length_px : float
        px.
    """

    shape: tuple[int, int]
    sigma_px: float
    length_px: float

    @classmethod
    def over(cls, shape: tuple[int, int], sigma_px: float) -> LensField:
        """A field of the usual smoothness over a detector."""
        return cls(shape, sigma_px, LENGTH_SHARE * max(shape))

    @cached_property
    def nodes(self) -> Array:
        """(M, 2) px; where the field is an unknown, evenly over the detector."""
        axes = []
        for size in self.shape:
            count = max(2, math.ceil(size / (NODE_SHARE * self.length_px)) + 1)
            axes.append(np.linspace(0.0, size - 1.0, count))
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)

    def _law(self, first: Array, second: Array) -> Array:
        """Correlation of the field at pixels (N, 2) and (M, 2)."""
        r = math.sqrt(5.0) * np.hypot(*(first[:, None] - second[None]).transpose(2, 0, 1)) / self.length_px
        return np.asarray((1.0 + r + r * r / 3.0) * np.exp(-r))

    @cached_property
    def _inverse(self) -> Array:
        """(M, M) inverse correlation of the nodes."""
        law = self._law(self.nodes, self.nodes) + 1e-8 * np.eye(len(self.nodes))
        return np.asarray(np.linalg.inv(law), dtype=np.float64)

    def weights(self, pixels: Array) -> Array:
        """(N, M): the field at `pixels` (N, 2) from that at the nodes, by kriging; 0 for NaN rows."""
        out = np.zeros((len(pixels), len(self.nodes)))
        known = np.isfinite(pixels).all(axis=1)
        out[known] = self._law(pixels[known], self.nodes) @ self._inverse
        return out

    @property
    def size(self) -> int:
        """Number of unknowns: all line shifts, then all column shifts."""
        return 2 * len(self.nodes)

    def prior_precision(self) -> Array:
        """(2M, 2M) inverse prior covariance of the unknowns."""
        return np.asarray(np.kron(np.eye(2), self._inverse / self.sigma_px**2), dtype=np.float64)

    def learned(self, values: Array, covariance: Array) -> LensField:
        """The field with sigma from its posterior (one step of expectation-maximisation)."""
        inverse = np.kron(np.eye(2), self._inverse)
        variance = float(values @ inverse @ values + np.sum(inverse * covariance)) / self.size
        return replace(self, sigma_px=max(math.sqrt(variance), LEAST_SIGMA_PX))
