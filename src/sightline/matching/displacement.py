"""A smooth field through scattered displacements, some of which may be wrong.

What a coarse look found at some points tells where to look for the rest, and how windows are deformed.

Not here: where displacements come from (``match_images.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sightline.estimation.robust import robust_sigma

Array = NDArray[np.float64]

#: Neighbours that a local quadratic is fitted to: four for each of its six terms. Fewer, or windows that lie
#: closer, follow relief better, but then the field follows the noise of matches within a window too.
NEIGHBOURS = 24
#: Fewest points for a quadratic; a plane is fitted to fewer, a mean to less than `LEAST_PLANE`.
LEAST_QUADRATIC, LEAST_PLANE = 15, 6
#: Residuals of so many of the field's own spread (`robust_sigma`) carry no weight.
CUT = 5.0
#: px; spread below which residuals are not distinguished: what relief leaves between neighbours.
LEAST_SPREAD = 0.1
#: Rounds of weights, as many as they take to settle while under a third of the points is wrong.
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class DisplacementField:
    """Local regression of displacements over the image, with robust weights.

    Attributes
    ----------
    points : (N, 2)
        (line, column), px.
    values : (N, 2)
        px; finite.
    """

    points: Array
    values: Array

    @cached_property
    def weights(self) -> Array:
        """(N,) 0 to 1; 0 where a displacement does not go with those around it."""
        weights = np.ones(len(self.points))
        for _ in range(_ROUNDS):
            if weights.sum() < LEAST_PLANE:
                break
            miss = np.hypot(*(self.values - self._fit(self.points, weights, own=False)).T)
            spread = max(robust_sigma(miss[weights > 0.0]), LEAST_SPREAD)
            weights = np.clip(1.0 - (miss / (CUT * spread)) ** 2, 0.0, None) ** 2
        return weights

    def at(self, places: Array) -> Array:
        """Displacements (M, 2) px at `places` (M, 2); zero where there are no points at all."""
        return self._fit(places, self.weights, own=True)

    def _fit(self, places: Array, weights: Array, *, own: bool) -> Array:
        """The field at places; `own` False leaves out the point that lies there itself."""
        used = np.flatnonzero(weights > 0.0)
        if len(used) == 0:
            return np.zeros((len(places), 2))
        count = min(NEIGHBOURS + (not own), len(used))
        found = cKDTree(self.points[used]).query(places, k=np.arange(1, count + 1))
        distance, row = np.asarray(found[0]), used[np.asarray(found[1])]
        scale = 1.01 * distance[:, -1:] + 1e-9
        near = (1.0 - (distance / scale) ** 3) ** 3 * weights[row]
        if not own and count > LEAST_PLANE:
            near[distance < 1e-6] = 0.0
        u = (self.points[row] - places[:, None]) / scale[..., None]
        basis = _basis(u, len(used))
        weighed = np.swapaxes(near[..., None] * basis, 1, 2)
        normal = weighed @ basis
        # a trace of the size of rounding keeps points on one line from making it singular
        normal += 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(basis.shape[2])
        right = weighed @ self.values[row]
        return np.asarray(np.linalg.solve(normal, right)[:, 0])


def _basis(u: Array, count: int) -> Array:
    """Terms (M, k, n) of the local polynomial that `count` points allow, the constant first."""
    y, x = u[..., 0], u[..., 1]
    terms = [np.ones_like(y)]
    if count >= LEAST_PLANE:
        terms += [y, x]
    if count >= LEAST_QUADRATIC:
        terms += [y * y, y * x, x * x]
    return np.stack(terms, axis=-1)
