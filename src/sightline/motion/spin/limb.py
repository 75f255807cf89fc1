"""Attitude of a camera from the limb of a body it sees: where to start when no attitude is known.

The outline of an ellipsoid, seen from a known place, gives two angles well (where its centre is) and the turn
about the line to the centre by its flattening, weakly and with a mirror solution half a turn away; seen from
above a pole it does not give it at all. Errors of neighbouring points are alike (haze, brightness), so that
sigmas are those of sectors of the outline, not of points.

Not here: refining by the motion of what is seen on the body (``solve.py``).
"""

from __future__ import annotations

from collections.abc import Callable
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
#: Part of the equatorial radius by which a limb may lie above or below the ellipsoid: 700 km at Jupiter,
#: where haze and the brightness at which it is cut make 300.
MOST_HEIGHT = 0.01
#: Sectors of the outline, and how much of its points may face away from the Sun: none does but by noise.
SECTORS, MOST_DARK = 24, 0.1
#: Sine of the height of the Sun below which a point is on the dark side.
_NIGHT = -0.02
#: rad; a turn about the line to the centre is not known better than half a turn, whatever is fitted.
_UNKNOWN = np.pi / 2.0


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
    sigma, sigma_turn : float
        rad; of where the centre is, per axis across the line to it, and of the turn about that line.
    """

    world_from_body: Rotation
    height: float
    rms: float
    kept: int
    sigma: float = 0.0
    sigma_turn: float = 0.0


def attitude_from_limb(
    directions: Array,
    positions: Array,
    radii: tuple[float, float],
    hint: tuple[Array, Array],
    sun: Array | None = None,
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
    sun : (3,), optional
        Unit vector to the Sun, world axes: the limb is seen where it is lit.

    Raises
    ------
    EstimationError
        If there are too few points, or they are no lit limb: their outline lies too far above or below the
        body, or on its dark side, as the terminator of an overexposed image does.
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
    # the hint turns about the line to the centre alone: it may point up to 60 degrees elsewhere
    start, _ = Rotation.align_vectors([down, hint[1]], [middle, hint[0]], weights=[1e4, 1.0])
    x = np.append(start.as_rotvec(), 0.0)
    kept = np.ones(len(directions), dtype=bool)

    def weighed(x: Array, kept: NDArray[np.bool_]) -> Array:
        """Misses, and what is known beforehand, as one point each: the turn by the hint, the height by haze.

        Without these a fit from above a pole runs off along the turn, which nothing there tells.
        """
        about = float(down @ (Rotation.from_rotvec(x[:3]) * start.inv()).as_rotvec())
        return np.append(miss(x, kept), [SOFT * about, SOFT * x[3] / (MOST_HEIGHT * radii[0])])

    for _ in range(ROUNDS):
        fit = least_squares(
            partial(weighed, kept=kept),
            x,
            loss="soft_l1",
            f_scale=SOFT,
            x_scale=[1e-2, 1e-2, 1e-2, 1e-3 * radii[0]],
        )
        x = fit.x
        left = np.abs(miss(x))
        kept = left < 3.0 * robust_sigma(left) + SOFT
    turn = Rotation.from_rotvec(x[:3])
    _check_limb(turn.apply(directions[kept]), positions[kept], axes + x[3], float(x[3]) / radii[0], sun)
    rms = float(np.sqrt((miss(x)[kept] ** 2).mean()))
    sigma, sigma_turn = _sigmas(x, miss, turn.apply(directions), down, kept)
    return LimbFit(turn, float(x[3]), rms, int(kept.sum()), sigma, sigma_turn)


def _check_limb(rays: Array, origins: Array, axes: Array, height: float, sun: Array | None) -> None:
    """EstimationError unless points, seen along rays (N, 3), can be the lit limb of a body with half-axes."""
    ray, origin = rays / axes, origins / axes
    nearest = origin - ((origin * ray).sum(axis=1) / (ray**2).sum(axis=1))[:, None] * ray
    normal = nearest / axes
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    dark = 0.0 if sun is None else float((normal @ sun < _NIGHT).mean())
    if dark > MOST_DARK:
        raise EstimationError(
            f"{100 * dark:.0f} % of the limb points face away from the Sun: they lie on the terminator, as "
            "in an overexposed image whose day side has no gradient; give the attitude, or another image"
        )
    if abs(height) > MOST_HEIGHT:
        raise EstimationError(
            f"limb points lie {100 * abs(height):.2g} % of the radius {'above' if height > 0 else 'below'} "
            f"the body, more than {100 * MOST_HEIGHT:g} %: they are no limb but blooming, or the terminator "
            "of an overexposed image; give the attitude"
        )


def _sigmas(
    x: Array,
    miss: Callable[[Array], Array],
    rays: Array,
    down: Array,
    kept: NDArray[np.bool_],
) -> tuple[float, float]:
    """rad; across the line to the centre and about it: by how sectors of the outline contradict others."""
    steps = np.array([1e-6, 1e-6, 1e-6, 1.0])
    slope = np.stack([(miss(x + d) - miss(x - d)) / (2.0 * d.sum()) for d in np.diag(steps)], axis=1)[kept]
    left = miss(x)[kept]
    side = np.cross(down, [0.6, 0.0, 0.8] if abs(down[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = np.arctan2(rays[kept] @ np.cross(down, side), rays[kept] @ side)
    sector = np.floor((angle + np.pi) / (2.0 * np.pi) * SECTORS).astype(int)
    scale = np.array([1.0, 1.0, 1.0, 1e-6])
    slope = slope / scale
    # small turns of the rotation vector, as turns about world axes
    turned = np.stack(
        [
            (Rotation.from_rotvec(x[:3] + d) * Rotation.from_rotvec(x[:3] - d).inv()).as_rotvec() / 2e-6
            for d in 1e-6 * np.eye(3)
        ],
        axis=1,
    )
    about = np.append(down @ turned, 0.0) / _UNKNOWN
    sectors = np.unique(sector)
    # errors of the points of a sector taken as one: how well the flattening shows the turn at all
    alike = float((left**2).mean()) * len(left) / len(sectors)
    by_sector = np.linalg.inv(slope.T @ slope / alike + np.outer(about, about))
    sums = np.array([slope[sector == k].T @ left[sector == k] for k in sectors]) / alike
    spare = max(len(sectors) - len(x), 1)
    found = by_sector @ (sums.T @ sums * len(sectors) / spare + np.outer(about, about)) @ by_sector
    both = [turned @ covariance[:3, :3] @ turned.T for covariance in (found, by_sector)]
    turn = max(float(down @ covariance @ down) for covariance in both)
    across = max(float(np.trace(covariance) - down @ covariance @ down) / 2.0 for covariance in both)
    return float(np.sqrt(max(across, 0.0))), float(min(np.sqrt(turn), _UNKNOWN))
