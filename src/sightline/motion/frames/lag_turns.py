"""What all pairs of one lag err alike: a turn of the partner for each lag, where lags disagree.

Pairs of one lag look at the same parts of the detector, over the same overlap, with the same change of view:
what biases one biases all, and many frames do not average it. Pairs of another lag err otherwise, and tell.

Not here: when they become unknowns (``passes.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from sightline.motion.measure.observations import Star

Array = NDArray[np.float64]

#: Lags disagree about an axis where chance does so in fewer cases than this.
CHANCE = 0.01


@dataclass(frozen=True, eq=False)
class LagTurns:
    """Turns (roll, pitch, yaw) of the partners at each of L lags, Gaussian and independent.

    Attributes
    ----------
    lags : tuple of int
    sigma : (3,)
        rad; 1-sigma of each axis.
    chi_square : (3,)
        Of what lags disagree by about each axis, nothing of it owned; of L - 1 numbers.
    """

    lags: tuple[int, ...]
    sigma: Array
    chi_square: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def disagree(self) -> NDArray[np.bool_]:
        """(3,) axes about which lags disagree by more than chance does."""
        return np.asarray(chdtrc(len(self.lags) - 1, self.chi_square) < CHANCE)

    @property
    def size(self) -> int:
        """Number of unknowns: axes of the first lag, then of the next."""
        return 3 * len(self.lags)

    def prior_precision(self) -> Array:
        """(3L, 3L) inverse prior covariance."""
        return np.diag(np.tile(1.0 / self.sigma**2, len(self.lags)))

    def design(self, star: Star) -> Array:
        """Shift of a star's matches with the turns, (G, K, 2, 3L) px per rad."""
        out = np.zeros((*star.present.shape, 2, len(self.lags), 3))
        for k, image in enumerate(star.images):
            out[:, k, :, self.lags.index(image - star.hub)] = star.by_partner[:, k]
        return out.reshape(*star.present.shape, 2, -1)

    def contrasts(self) -> Array:
        """(L - 1, L) orthonormal: all turns but those that grow with the lag, as a drift of the body does."""
        grows = np.asarray(self.lags, dtype=np.float64)[:, None]
        return np.asarray(np.linalg.svd(grows)[0][:, 1:].T)

    def learned(self, turns: Array, covariance: Array, least: Array) -> LagTurns:
        """Sigmas by the moments of what wide ones let be found: `least` (3,) rad where lags do not disagree.

        Parameters
        ----------
        turns : (3L,)
            rad.
        covariance : (3L, 3L)
            rad^2.
        least : (3,)
        """
        moments, chi_square, rows = np.zeros(3), np.zeros(3), self.contrasts()
        for axis in range(3):
            found = rows @ turns[axis::3]
            spread = rows @ covariance[axis::3, axis::3] @ rows.T
            chi_square[axis] = found @ np.linalg.solve(spread, found)
            moments[axis] = (found**2 - np.diag(spread)).mean()
        out = LagTurns(self.lags, least, chi_square)
        larger = out.disagree & (moments > least**2)
        return replace(out, sigma=np.sqrt(np.where(larger, moments, least**2)))
