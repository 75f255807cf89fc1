"""Attitude of a camera from the limb of a body it sees: where to start when no attitude is known.

The outline of an ellipsoid, seen from a known place, gives two angles well (where its centre is) and the turn
about the line to the centre by its flattening, weakly and with a mirror solution half a turn away.

Not here: refining by the motion of what is seen on the body (``solve.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigma

Array = NDArray[np.float64]

#: rad; limb points further from the outline than this start to lose weight (a third of a pixel of 0.7 mrad).
SOFT = 2e-4
#: Limb points needed, and rounds of leaving out those far off.
LEAST_POINTS, ROUNDS = 50, 4


@dataclass(frozen=True, eq=False)
class LimbFit:
    """Attitude that lays an ellipsoid's outline on limb points.

    Attributes
    ----------
    world_from_body : Rotation
    height : float
        m; of the limb seen above the ellipsoid (haze, and the brightness at which it is cut).
    rms : float
        rad; of the points kept.
    kept : int
        Points.
    """

    world_from_body: Rotation
    height: float
    rms: float
    kept: int


def attitude_from_limb(
    directions: Array, positions: Array, radii: tuple[float, float], hint: tuple[Array, Array]
) -> LimbFit:
    """The rotation of `directions` after which they touch the limb.

    Parameters
    ----------
    directions : (N, 3)
        Unit vectors to limb points, body axes.
    positions : (N, 3)
        m; where each was seen from, world axes with the body's centre as origin and its axis as z.
    radii : (equatorial, polar)
        m.
    hint : pair of (3,)
        A body vector and about where it points in world axes (within 60 degrees): decides between the mirror
        solutions.

    Raises
    ------
    EstimationError
        If there are too few points.
    """
    from scipy.optimize import least_squares

    if len(directions) < LEAST_POINTS:
        raise EstimationError(
            f"{len(directions)} limb points; {LEAST_POINTS} or more are needed to find the attitude; give it"
        )
    axes = np.array([radii[0], radii[0], radii[1]])
    distance = np.linalg.norm(positions, axis=1)

    def miss(x: Array, kept: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Angle by which each ray passes outside the outline, rad."""
        shrink = 1.0 / (axes + x[3])
        ray, origin = Rotation.from_rotvec(x[:3]).apply(directions) * shrink, positions * shrink
        nearest = -(origin * ray).sum(axis=1) / (ray**2).sum(axis=1)
        reach = np.linalg.norm(origin + nearest[:, None] * ray, axis=1)
        return np.asarray((reach - 1.0) * radii[0] / distance)[kept]

    middle = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
    down = -positions.mean(axis=0) / np.linalg.norm(positions.mean(axis=0))
    start, _ = Rotation.align_vectors([down, hint[1]], [middle, hint[0]])
    x = np.append(start.as_rotvec(), 0.0)
    kept = np.ones(len(directions), dtype=bool)
    for _ in range(ROUNDS):
        fit = least_squares(
            partial(miss, kept=kept),
            x,
            loss="soft_l1",
            f_scale=SOFT,
            x_scale=[1e-2, 1e-2, 1e-2, 1e-3 * radii[0]],
        )
        x = fit.x
        left = np.abs(miss(x))
        kept = left < 3.0 * robust_sigma(left) + SOFT
    rms = float(np.sqrt((miss(x)[kept] ** 2).mean()))
    return LimbFit(Rotation.from_rotvec(x[:3]), float(x[3]), rms, int(kept.sum()))
