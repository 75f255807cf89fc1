"""Which constant angles an information matrix makes observable, and which it does not.

Not here: the information itself (``reduced.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.checks import Array, ReadOnlyArrays, frozen

#: rad; a direction whose sigma is larger is not observable: the cameras' model is linear no further, and a
#: spacecraft knows its attitude better without images. Rounding alone gives about 10 rad.
LIMIT = 0.1
#: Part of a sigma by which a hidden direction may move an unknown that is still given a number.
PART = 0.2


@dataclass(frozen=True, eq=False)
class Observability(ReadOnlyArrays):
    """Principal directions of unknown angles, the weakest first.

    Attributes
    ----------
    sigmas : (G,)
        rad, 1-sigma along each direction; inf where it is not observable.
    directions : (G, G)
        Rows are unit vectors over the unknowns.
    names : tuple of str
        Of the unknowns.
    limit : float
        rad; how far a hidden direction may lead.
    """

    sigmas: Array
    directions: Array
    names: tuple[str, ...]
    limit: float = LIMIT

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """(G,) directions that are not observable."""
        return ~np.isfinite(self.sigmas)

    @property
    def touched(self) -> NDArray[np.bool_]:
        """(G,) unknowns that a hidden direction may move by a good part of their sigma: no number then."""
        hidden = self.hidden
        seen = np.sqrt(((self.directions[~hidden].T * self.sigmas[~hidden]) ** 2).sum(axis=1))
        moved = np.abs(self.directions[hidden])
        return np.asarray((moved > 0.0).any(axis=0) & ((moved * self.limit) > PART * seen).any(axis=0))

    def covariance(self) -> Array:
        """Covariance (G, G), rad^2: inf on the diagonal and NaN beside it for the unknowns `touched`."""
        seen = ~self.hidden
        out = (self.directions[seen].T * self.sigmas[seen] ** 2) @ self.directions[seen]
        touched = self.touched
        out[touched] = np.nan
        out[:, touched] = np.nan
        out[touched, touched] = np.inf
        return np.asarray(out)

    def solve(self, right: Array, damping: float = 0.0) -> Array:
        """Step (G,) for a right-hand side (G,), none along hidden directions.

        `damping` adds to the information along every direction, which holds the weakest most.
        """
        seen = ~self.hidden
        along = self.directions[seen]
        return np.asarray(along.T @ ((along @ right) / (self.sigmas[seen] ** -2.0 + damping)))


def observability(information: Array, names: Sequence[str], limit: float = LIMIT) -> Observability:
    """Principal directions of an information matrix.

    Parameters
    ----------
    information : (G, G)
        1/rad^2, symmetric; singular where the gauge is free.
    names : sequence of str
        Of the unknowns.
    limit : float
        rad; sigmas beyond it count as not observable.

    Returns
    -------
    Observability

    Examples
    --------
    >>> found = observability(np.diag([1e12, 0.0]), ["roll", "yaw"])
    >>> found.sigmas.tolist(), found.touched.tolist()
    ([inf, 1e-06], [False, True])
    """
    symmetric = 0.5 * (information + information.T)
    values, vectors = np.linalg.eigh(symmetric)
    seen = values > max(limit**-2, 0.0)
    sigmas = np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), np.inf)
    directions = vectors.T
    # the largest part of each counts as positive; there may be no unknown at all
    extremes = directions.max(axis=1, initial=0.0), directions.min(axis=1, initial=0.0)
    signs = np.where(extremes[0] >= -extremes[1], 1.0, -1.0)
    return Observability(frozen(sigmas), frozen(directions * signs[:, None]), tuple(names), limit)


def marginal(information: Array, keep: int) -> Array:
    """Information (keep, keep) on the first unknowns when the others are not known.

    Others that are hardly seen themselves are left out by a pseudo-inverse in units of their own size.
    """
    if keep == len(information):
        return np.asarray(0.5 * (information + information.T))
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(size, size)
    inner = np.linalg.pinv(scaled[keep:, keep:], rcond=1e-13, hermitian=True)
    out = scaled[:keep, :keep] - scaled[:keep, keep:] @ inner @ scaled[keep:, :keep]
    return np.asarray(out * np.outer(size[:keep], size[:keep]))
