"""What is known of points before they are sighted: that they lie on a surface, or where they are.

Not here: reading elevation rasters or tables of control points (``io/``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, as_points, frozen, read_only
from sightline.geometry.earth import local_axes, to_geodetic
from sightline.geometry.surface import Ellipsoid, Surface
from sightline.photogrammetry.sightings import Index, as_index

#: m; half the base over which the slope of a surface is taken, and how far above a point its vertical begins.
_STEP, _REACH = 15.0, 30e3
#: m; the same above an ellipsoid, where no terrain has to be searched.
_DEEP = 1e6


@dataclass(frozen=True, eq=False)
class ControlPoints(ReadOnlyArrays):
    """Points whose coordinates are known.

    Attributes
    ----------
    point : (G,) int
        Which of the block's points.
    position : (G, 3)
        m, world axes.
    sigma : (G,)
        m, 1-sigma of each coordinate.
    """

    point: Index
    position: Array
    sigma: Array

    def __post_init__(self) -> None:
        """Check and freeze."""
        object.__setattr__(self, "point", as_index(self.point, "point"))
        object.__setattr__(self, "position", frozen(as_points(self.position, "position")))
        object.__setattr__(self, "sigma", frozen(np.broadcast_to(self.sigma, self.point.shape)))
        if len(self.point) != len(self.position):
            raise InputError(
                f"`point` and `position` need as many rows, got {len(self.point)} and {len(self.position)}"
            )
        if not (self.sigma > 0.0).all():
            raise InputError(f"`sigma` of control points must be positive, got {self.sigma.min():g} m")

    def __getitem__(self, rows: NDArray[np.bool_] | Index) -> ControlPoints:
        """Some of the points, by their old numbers."""
        return ControlPoints(self.point[rows], self.position[rows], self.sigma[rows])

    def among(self, points: Index) -> ControlPoints:
        """Those of some of the block's points, given in rising order, numbered as they stand there."""
        own = self[np.isin(self.point, points)]
        return ControlPoints(as_index(np.searchsorted(points, own.point), "point"), own.position, own.sigma)


@dataclass(frozen=True, eq=False)
class HeightPrior:
    """All points lie on a surface, to `sigma` along the vertical, each with an error of its own.

    Attributes
    ----------
    surface : Surface
    sigma : float
        m, positive.
    radii : (float, float) or None
        Of the ellipsoid whose normals are the verticals; None where the world is flat, z up.
    """

    surface: Surface
    sigma: float
    radii: tuple[float, float] | None

    def __post_init__(self) -> None:
        """Check."""
        if not (np.isfinite(self.sigma) and self.sigma > 0.0):
            raise InputError(f"`sigma` of a height prior must be positive, got {self.sigma} m")

    def above(self, points: Array) -> tuple[Array, Array]:
        """Height (n,) m of `points` above the surface along the vertical, and its change (n, 3) with them.

        NaN where the surface is not known there.
        """
        up, east, north = level_axes(points, self.radii)
        heights = self._height(points, up)
        slope = np.array(up)
        for axis in (east, north):
            rise = self._height(points + _STEP * axis, up) - self._height(points - _STEP * axis, up)
            slope = slope + (rise / (2.0 * _STEP))[:, None] * axis
        return heights, slope

    def _height(self, points: Array, up: Array) -> Array:
        """Height (n,) of points above the surface along `up` (n, 3)."""
        # from under it a ray would meet the far side of the Earth
        reach = _DEEP if isinstance(self.surface, Ellipsoid) else _REACH
        ground = self.surface.intersect(read_only(points + reach * up), read_only(-up))
        return np.asarray(((points - ground) * up).sum(axis=1))


def level_axes(points: Array, radii: tuple[float, float] | None) -> tuple[Array, Array, Array]:
    """Unit vectors up, east and north (n, 3 each) at points; x east, y north, z up in a flat world."""
    if radii is None:
        up, east, north = (np.broadcast_to(row, points.shape) for row in np.eye(3)[[2, 0, 1]])
        return np.array(up), np.array(east), np.array(north)
    longitude, latitude, _ = to_geodetic(points, radii).T
    axes = local_axes(longitude, latitude).as_matrix()
    return axes[:, :, 2], axes[:, :, 0], axes[:, :, 1]


@dataclass(frozen=True, eq=False)
class PointPriors(ReadOnlyArrays):
    """What is known of a block's points, as rows of its normal equations.

    Attributes
    ----------
    heights : HeightPrior or None
        Of all points.
    control : ControlPoints or None
        Of some.
    """

    heights: HeightPrior | None = None
    control: ControlPoints | None = None

    @classmethod
    def of(cls, heights: HeightPrior | None, control: ControlPoints | None) -> PointPriors | None:
        """Both together; None where nothing is known."""
        return None if heights is None and control is None else cls(heights, control)

    def count(self, points: int) -> int:
        """Number of conditions that are added to a block in which so many points are used."""
        of_heights = 0 if self.heights is None else points
        return of_heights + (0 if self.control is None else 3 * len(self.control.point))

    def known(self, points: int) -> NDArray[np.bool_]:
        """Which of so many points something is known of, so that one sighting is of use."""
        out = np.full(points, self.heights is not None)
        if self.control is not None:
            out[self.control.point] = True
        return out

    def at(self, points: Array) -> tuple[Array, Array, float]:
        """Pull (n, 3) and curvature (n, 3, 3) of the cost at `points` (n, 3), and the cost."""
        pull, curvature, cost = np.zeros(points.shape), np.zeros((len(points), 3, 3)), 0.0
        if self.heights is not None:
            above, slope = self.heights.above(points)
            inside = np.isfinite(above)
            size = np.where(inside, above, 0.0) / self.heights.sigma
            slope = np.where(inside[:, None], slope, 0.0) / self.heights.sigma
            pull -= slope * size[:, None]
            curvature += slope[:, :, None] * slope[:, None, :]
            cost += float((size**2).sum())
        if self.control is not None:
            c = self.control
            miss = c.position - points[c.point]
            np.add.at(pull, c.point, miss / c.sigma[:, None] ** 2)
            np.add.at(curvature, c.point, np.eye(3) / c.sigma[:, None, None] ** 2)
            cost += float(((miss / c.sigma[:, None]) ** 2).sum())
        return pull, curvature, cost

    def for_copies(self, point_of: Index) -> PointPriors:
        """The same knowledge of copies (n,) of the points `point_of`, each with errors of its own."""
        if self.control is None:
            return self
        order = np.argsort(point_of, kind="stable")
        points, rows = [], []
        for number, point in enumerate(self.control.point):
            low, high = np.searchsorted(point_of[order], [point, point + 1])
            points.append(order[low:high])
            rows.append(np.full(high - low, number))
        row = np.concatenate(rows)
        copies = ControlPoints(
            as_index(np.concatenate(points), "point"), self.control.position[row], self.control.sigma[row]
        )
        return PointPriors(self.heights, copies)

    def start(self, points: Array, rays: Array, origins: Array, point: Index) -> Array:
        """Points (n, 3) to start from: `points`, but known places, and the surface for points on one ray.

        `rays`, `origins` (N, 3) and `point` (N,): the sightings.
        """
        out = np.array(points)
        if self.heights is not None:
            once = np.bincount(point, minlength=len(points))[point] == 1
            if once.any():
                meet = self.heights.surface.intersect(read_only(origins[once]), read_only(rays[once]))
                out[point[once]] = np.where(np.isfinite(meet), meet, out[point[once]])
        if self.control is not None:
            out[self.control.point] = self.control.position
        return out
