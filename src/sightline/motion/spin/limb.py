"""Attitude of a camera from the limb of a body it sees: where to start when no attitude is known.

The outline of an ellipsoid, seen from a known place, gives two angles well (where its centre is) and the turn
about the line to the centre by its flattening, weakly and with a mirror solution half a turn away; seen from
above a pole it does not give it at all. Errors of neighbouring points are alike (haze, brightness), so that
sigmas are those of sectors of the outline, not of points.

Not here: refining by the motion of what is seen on the body (``solve.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigma

Array = NDArray[np.float64]

#: rad; limb points further from the outline than this start to lose weight (a third of a pixel of 0.7 mrad).
SOFT = 2e-4
#: Limb points needed, rounds of leaving out those far off, and steps of the fit in each.
LEAST_POINTS, ROUNDS, TRIES = 50, 6, 15
#: Part of the equatorial radius by which a limb may lie above or below the ellipsoid: 700 km at Jupiter,
#: where haze and the brightness at which it is cut make 300.
MOST_HEIGHT = 0.01
#: Part of the equatorial radius by which the limb is higher where e times as much light falls: a scale height
#: of the atmosphere (25 km at Jupiter), whose haze is seen down to one brightness.
HIGHER = 3.5e-4
#: Sectors of the outline, and how much of its points may face away from the Sun: none does but by noise.
SECTORS, MOST_DARK = 24, 0.1
#: Sine of the angle between Sun and camera above which the terminator is told from the limb, and of that by
#: which brightness must rise away from the Sun: the ends of the crescent are both.
_BESIDE, _AWAY = 0.05, 0.1
#: Sine of the height of the Sun from which on less light makes no difference.
_DUSK = 0.02
#: Sine of the height of the Sun below which a point is on the dark side.
_NIGHT = -0.02
#: rad; a drift that is known exactly, in units of nothing.
EXACT = 1e-12
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
    rising: Array | None = None,
    drift: tuple[Array, float] | None = None,
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
    rising : (N, 3), optional
        Unit vectors in which brightness rises at the points, body axes. With `sun`: at the lit limb it rises
        away from the Sun, at the terminator towards it. Points there are left out.
    drift : pair of (N, 3) and float, optional
        Rotation vectors, body axes, of what turned the body meanwhile beside what `directions` hold (an error
        of its spin, of unit size), and how large that may be (1-sigma).

    Raises
    ------
    EstimationError
        If there are too few points, or they are no lit limb: their outline lies too far above or below the
        body, or on its dark side, as the terminator of an overexposed image does.
    """
    from scipy.optimize import least_squares

    _check_count(len(directions))
    outline = _Outline.of(directions, positions, radii, hint, sun, rising, drift)
    x = np.append(outline.start.as_rotvec(), np.zeros(3))
    kept, light = outline.lit(x), np.zeros(len(directions))

    def weighed(x: Array) -> Array:
        return np.append(outline.miss(x, light)[kept], SOFT * outline.beforehand(x))

    for _ in range(ROUNDS):
        x = least_squares(
            weighed,
            x,
            loss="soft_l1",
            f_scale=SOFT,
            x_scale=[1e-2, 1e-2, 1e-2, *outline.sizes],
            max_nfev=TRIES,
        ).x
        left, of, light = np.abs(outline.miss(x, light)), outline.lit(x), outline.light(x)
        kept = of & (left < 3.0 * robust_sigma(left[of]) + SOFT)
    turn = Rotation.from_rotvec(x[:3])
    _check_limb(
        turn.apply(directions[kept]), positions[kept], outline.axes + x[3], float(x[3]) / radii[0], sun
    )
    rms = float(np.sqrt((outline.miss(x, light)[kept] ** 2).mean()))
    sigma, sigma_turn = _sigmas(outline, x, light, kept)
    return LimbFit(turn, float(x[3]), rms, int(kept.sum()), sigma, sigma_turn)


@dataclass(frozen=True, eq=False)
class _Outline:
    """Limb points, and how far a solution x leaves them beside the outline.

    x is the rotation vector of world_from_body, the height of the limb (m), how much higher it is for each
    e-fold of light (m), and the size of the drift. Arguments are those of `attitude_from_limb`.
    """

    directions: Array
    positions: Array
    axes: Array
    sun: Array | None
    rising: Array | None
    turned: Array
    largest: float
    down: Array
    start: Rotation

    @classmethod
    def of(
        cls,
        directions: Array,
        positions: Array,
        radii: tuple[float, float],
        hint: tuple[Array, Array],
        sun: Array | None,
        rising: Array | None,
        drift: tuple[Array, float] | None,
    ) -> _Outline:
        """Where the fit starts: the middle of the points on the centre, turned about it by the hint."""
        middle = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
        down = -positions.mean(axis=0) / np.linalg.norm(positions.mean(axis=0))
        # the hint turns about the line to the centre alone: it may point up to 60 degrees elsewhere
        start, _ = Rotation.align_vectors([down, hint[1]], [middle, hint[0]], weights=[1e4, 1.0])
        turned, largest = (np.zeros_like(directions), EXACT) if drift is None else drift
        axes = np.array([radii[0], radii[0], radii[1]])
        return cls(directions, positions, axes, sun, rising, turned, largest, down, start)

    @property
    def sizes(self) -> Array:
        """(3,) of the unknowns after the rotation, beforehand."""
        return np.array([MOST_HEIGHT * self.axes[0], HIGHER * self.axes[0], self.largest])

    def rays(self, x: Array) -> Array:
        """(N, 3) where points are seen, world axes."""
        return np.asarray(
            Rotation.from_rotvec(x[:3]).apply(Rotation.from_rotvec(x[5] * self.turned).apply(self.directions))
        )

    def miss(self, x: Array, light: Array) -> Array:
        """Angle by which each ray passes outside the outline, rad."""
        shrink = 1.0 / (self.axes + (x[3] + x[4] * light)[:, None])
        ray, origin = self.rays(x) * shrink, self.positions * shrink
        nearest = -(origin * ray).sum(axis=1) / (ray**2).sum(axis=1)
        reach = np.linalg.norm(origin + nearest[:, None] * ray, axis=1)
        return np.asarray((reach - 1.0) * self.axes[0] / np.linalg.norm(self.positions, axis=1))

    def light(self, x: Array) -> Array:
        """Logarithm of the sine of the Sun's height at each point: haze is seen by its light."""
        if self.sun is None:
            return np.zeros(len(self.directions))
        return np.asarray(
            np.log(np.maximum(_normals(self.rays(x), self.positions, self.axes) @ self.sun, _DUSK))
        )

    def lit(self, x: Array) -> NDArray[np.bool_]:
        """Points where brightness rises away from the Sun; all where it cannot be told."""
        across = np.zeros(3) if self.sun is None else self.sun - (self.sun @ self.down) * self.down
        size = float(np.sqrt(across @ across))
        if self.rising is None or size < _BESIDE:
            return np.ones(len(self.directions), dtype=bool)
        found = np.asarray(Rotation.from_rotvec(x[:3]).apply(self.rising) @ across < -_AWAY * size)
        _check_count(int(found.sum()), len(found))
        return found

    def beforehand(self, x: Array) -> Array:
        """(4,) what is known without the points, over its size: the turn by the hint, and `sizes`.

        Without these a fit from above a pole runs off along the turn, which nothing there tells.
        """
        about = float(self.down @ (Rotation.from_rotvec(x[:3]) * self.start.inv()).as_rotvec())
        return np.append(about, x[3:] / self.sizes)


def _normals(rays: Array, origins: Array, axes: Array) -> Array:
    """(N, 3) unit normals of the ellipsoid where rays pass it nearest."""
    ray, origin = rays / axes, origins / axes
    nearest = origin - ((origin * ray).sum(axis=1) / (ray**2).sum(axis=1))[:, None] * ray
    normal = nearest / axes
    return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])


def _check_count(count: int, among: int | None = None) -> None:
    """EstimationError unless there are enough points, of those that are `among` them on the lit limb."""
    if count >= LEAST_POINTS:
        return
    if among is None:
        said = f"{count} limb points"
    else:
        said = (
            f"brightness rises towards the Sun at {among - count} of {among} limb points: they lie on the "
            "terminator, as in an overexposed image whose day side has no gradient"
        )
    raise EstimationError(
        f"{said}; {LEAST_POINTS} or more on the lit limb are needed to find the attitude; give it, or "
        "another image"
    )


def _check_limb(rays: Array, origins: Array, axes: Array, height: float, sun: Array | None) -> None:
    """EstimationError unless points, seen along rays (N, 3), can be the lit limb of a body with half-axes."""
    normal = _normals(rays, origins, axes)
    dark = 0.0 if sun is None else float((normal @ sun < _NIGHT).mean())
    if dark > MOST_DARK:
        raise EstimationError(
            f"{100 * dark:.0f} % of the limb points face away from the Sun: they lie on the terminator, as "
            "in an overexposed image whose day side has no gradient; give the attitude, or another image"
        )
    if abs(height) > MOST_HEIGHT:
        raise EstimationError(
            f"limb points lie {100 * abs(height):.2g} % of the radius {'above' if height > 0 else 'below'} "
            f"the body, more than {100 * MOST_HEIGHT:g} %: they are no limb but haze, blooming, noise where "
            "the limb is hardly brighter than the sky, or the terminator of an overexposed image; give the "
            "attitude"
        )


def _sigmas(outline: _Outline, x: Array, light: Array, kept: NDArray[np.bool_]) -> tuple[float, float]:
    """rad; across the line to the centre and about it: by how sectors of the outline contradict others."""
    down, rays = outline.down, outline.rays(x)[kept]
    unit = np.append(np.ones(3), outline.sizes)
    slope = np.stack(
        [
            (outline.miss(x + d, light) - outline.miss(x - d, light))[kept] / 2e-6
            for d in 1e-6 * np.diag(unit)
        ],
        axis=1,
    )
    left = outline.miss(x, light)[kept]
    side = np.cross(down, [0.6, 0.0, 0.8] if abs(down[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = np.arctan2(rays @ np.cross(down, side), rays @ side)
    sector = np.floor((angle + np.pi) / (2.0 * np.pi) * SECTORS).astype(int)
    # small turns of the rotation vector, as turns about world axes
    turned = np.stack(
        [
            (Rotation.from_rotvec(x[:3] + d) * Rotation.from_rotvec(x[:3] - d).inv()).as_rotvec() / 2e-6
            for d in 1e-6 * np.eye(3)
        ],
        axis=1,
    )
    # beforehand: half a turn about the line to the centre, and how much higher it gets with light, and drift
    about = np.append(down @ turned, np.zeros(3)) / _UNKNOWN
    known = np.outer(about, about) + np.diag([0.0, 0.0, 0.0, 0.0, 1.0, 1.0])
    sectors = np.unique(sector)
    # errors of the points of a sector taken as one: how well the flattening shows the turn at all
    alike = float((left**2).mean()) * len(left) / len(sectors)
    by_sector = np.linalg.inv(slope.T @ slope / alike + known)
    sums = np.array([slope[sector == k].T @ left[sector == k] for k in sectors]) / alike
    spare = max(len(sectors) - len(x), 1)
    found = by_sector @ (sums.T @ sums * len(sectors) / spare + known) @ by_sector
    both = [turned @ covariance[:3, :3] @ turned.T for covariance in (found, by_sector)]
    turn = max(float(down @ covariance @ down) for covariance in both)
    across = max(float(np.trace(covariance) - down @ covariance @ down) / 2.0 for covariance in both)
    return float(np.sqrt(max(across, 0.0))), float(min(np.sqrt(turn), _UNKNOWN))
