"""What the lines of sight meet: plane, ellipsoid, digital elevation model, or nothing near (infinity).

Heights of ellipsoids and DEMs in Earth-centred axes are above the ellipsoid.

Not here: reading a DEM from a file (``io/``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, as_points, finite, frozen, same_length
from sightline.geometry.dem_kernels import (
    GEOGRAPHIC,
    LOCAL,
    PROJECTED,
    dem_hits,
    ellipsoid_hits,
    heights_below,
    plane_hits,
)
from sightline.geometry.earth import WGS84, check_radii, from_geodetic, local_axes, to_geodetic

#: Spacing of the table that leads from a plane touching the ellipsoid to the cells of a projected DEM, in
#: radii of the body: 10 km on Earth. A map projection bends by (10 km / R)^4 R over it, so that less than a
#: micrometre is lost between its nodes.
_WARP_STEP = 1.6e-3
#: Fewest and most nodes per side of that table.
_WARP_NODES = (33, 1025)


class Surface(Protocol):
    """What the lines of sight meet: Plane, Ellipsoid, Dem."""

    def intersect(self, origins: Array, directions: Array) -> Array:
        """First meeting point of each ray, (N, 3) m; NaN row where a ray misses."""
        ...

    def raised(self, height: float) -> Surface:
        """The same surface `height` metres higher."""
        ...


def _checked_rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
    """Both as (N, 3) of one length."""
    o, d = as_points(origins, "origins"), as_points(directions, "directions")
    same_length(o, "origins", d, "directions")
    return o, d


@dataclass(frozen=True, eq=False)
class Plane:
    """A level plane in local axes (x east, y north, z up).

    Attributes
    ----------
    height : float
        m, its z.

    Examples
    --------
    >>> Plane(10.0).intersect([[0.0, 0.0, 100.0]], [[0.0, 0.6, -0.8]]).tolist()
    [[0.0, 67.5, 10.0]]
    """

    height: float = 0.0

    def __post_init__(self) -> None:
        """Check."""
        finite(self.height, "height", "m")

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """First meeting point of each ray (N, 3), m; NaN where it runs away from the plane or along it."""
        o, d = _checked_rays(origins, directions)
        out = np.empty_like(o)
        plane_hits(o, d, float(self.height), out)
        return out

    def raised(self, height: float) -> Plane:
        """The plane `height` metres higher."""
        return Plane(self.height + height)


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """All points of one height above an ellipsoid of revolution, in its Earth-centred axes.

    Attributes
    ----------
    a, b : float
        Equatorial and polar semi-axes, m; WGS 84 unless given.
    height : float
        m above the ellipsoid, along its normal.
    """

    a: float = WGS84[0]
    b: float = WGS84[1]
    height: float = 0.0

    def __post_init__(self) -> None:
        """Check."""
        check_radii((self.a, self.b))
        finite(self.height, "height", "m")

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """First meeting point of each ray (N, 3), m; NaN where it passes by."""
        o, d = _checked_rays(origins, directions)
        out = np.empty_like(o)
        ellipsoid_hits(o, d, float(self.a), float(self.b), float(self.height), out)
        return out

    def raised(self, height: float) -> Ellipsoid:
        """The surface `height` metres higher."""
        return replace(self, height=self.height + height)


def level_surface(radii: tuple[float, float] | None, height: float = 0.0) -> Surface:
    """Level ground at a height (m): above the ellipsoid of these radii (m), or of a flat world without."""
    return Plane(height) if radii is None else Ellipsoid(*radii, height)


@dataclass(frozen=True, eq=False)
class Infinity:
    """No surface near: every ray ends so far away that the position of the camera does not matter.

    Attributes
    ----------
    distance : float
        m; far enough that a whole orbit moves nothing by 1e-12 rad.
    """

    distance: float = 1e20

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """The point at `distance` along each ray (N, 3), m."""
        o, d = _checked_rays(origins, directions)
        return np.asarray(o + self.distance * d)

    def raised(self, height: float) -> Infinity:
        """Itself: height means nothing at infinity."""
        return self


def _table_axis(values: Array, step: float) -> Array:
    """Nodes about `step` apart that cover the values and a margin for rays that come in from the side."""
    margin = 0.1 * np.ptp(values) + step
    low, high = values.min() - margin, values.max() + margin
    return np.linspace(low, high, int(np.clip((high - low) / step, *_WARP_NODES)))


@dataclass(frozen=True, eq=False)
class Dem(ReadOnlyArrays):
    """Heights on a regular grid, bilinear between the nodes.

    Attributes
    ----------
    heights : (rows, columns)
        m; NaN where unknown. Above the ellipsoid, or above the geoid where `geoid` is given.
    transform : six numbers (a, b, c, d, e, f)
        x = a column + b row + c, y = d column + e row + f, in the units of `crs`, with the corner of the
        first cell at row 0, column 0 and its node at (0.5, 0.5): the affine of GDAL and rasterio.
    crs : str or None
        Coordinate system of the grid ("EPSG:4326", "EPSG:32632", WKT, ...), to be met by rays in
        Earth-centred axes; "lonlat" for degrees on the ellipsoid `radii` itself, of any body. None: x east,
        y north, z up, in the local axes of the rays.
    geoid : float or (rows, columns) or None
        m; height of the geoid above the ellipsoid, added to `heights`.
    radii : (equatorial, polar)
        m; of the ellipsoid.
    offset : float
        m; added to every height (see `raised`).

    Examples
    --------
    >>> dem = Dem(np.full((3, 3), 50.0), (10.0, 0.0, -15.0, 0.0, -10.0, 15.0))
    >>> dem.intersect([[0.0, 0.0, 100.0]], [[0.0, 0.0, -1.0]]).tolist()
    [[0.0, 0.0, 50.0]]
    """

    heights: Array
    transform: Sequence[float]
    crs: str | None = None
    geoid: float | Array | None = None
    radii: tuple[float, float] = WGS84
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze."""
        heights = frozen(self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InputError(f"`heights` must be a grid of 2 x 2 nodes or more, got shape {heights.shape}")
        if not np.isfinite(heights).any():
            raise InputError("`heights` holds no finite height; check the no-data value of the DEM")
        if np.isinf(heights).any():
            raise InputError("`heights` holds infinities; give NaN where the height is unknown")
        object.__setattr__(self, "heights", heights)
        transform = tuple(float(v) for v in self.transform)[:6]
        if len(transform) != 6 or not np.isfinite(transform).all():
            raise InputError(
                f"`transform` must be six finite numbers (a, b, c, d, e, f), got {self.transform}"
            )
        if transform[0] * transform[4] - transform[1] * transform[3] == 0.0:
            raise InputError(f"`transform` {transform} maps the grid onto a line: its determinant is zero")
        object.__setattr__(self, "transform", transform)
        object.__setattr__(self, "radii", check_radii(self.radii))
        if self.geoid is not None:
            geoid = np.asarray(self.geoid, dtype=np.float64)
            if geoid.shape not in ((), heights.shape):
                raise InputError(
                    f"`geoid` must be one number or like `heights` {heights.shape}, got {geoid.shape}"
                )
        finite(self.offset, "offset", "m")

    @cached_property
    def ellipsoidal(self) -> Array:
        """(rows, columns) heights above the ellipsoid (or above z = 0), m, without `offset`."""
        return self.heights if self.geoid is None else frozen(self.heights + self.geoid)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Lowest and highest height, m, without `offset`."""
        return float(np.nanmin(self.ellipsoidal)), float(np.nanmax(self.ellipsoidal))

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height, m, `offset` included."""
        return self._limits[0] + self.offset, self._limits[1] + self.offset

    @cached_property
    def _grid(self) -> tuple[int, Array, Array]:
        """Kind, affine and table that lead from world axes to rows and columns (see ``to_grid``)."""
        no_warp = frozen(np.zeros((4, 4, 2)))
        if self.crs is None:
            return LOCAL, self._node_affine(1.0, 0.0), no_warp
        if self.crs.lower() == "lonlat":
            return GEOGRAPHIC, self._node_affine(np.pi / 180.0, self._middle()[0]), no_warp
        from pyproj import CRS, Transformer

        crs = CRS.from_user_input(self.crs)
        if not (crs.is_geographic or crs.is_projected) or crs.ellipsoid is None:
            raise InputError(
                f"`crs` of a DEM must be geographic or projected, got {self.crs!r}; None for local axes"
            )
        a = crs.ellipsoid.semi_major_metre
        if abs(a / self.radii[0] - 1.0) > 1e-3:
            raise InputError(
                f"`crs` {self.crs!r} has an equatorial radius of {a:.0f} m but `radii` is {self.radii}; "
                "give the radii of the body that the DEM belongs to"
            )
        earth = abs(a / WGS84[0] - 1.0) < 1e-3
        lonlat = CRS.from_epsg(4326) if earth else crs.geodetic_crs
        to_lonlat = Transformer.from_crs(crs, lonlat, always_xy=True)
        if crs.is_geographic:
            unit = float(crs.axis_info[0].unit_conversion_factor)
            x, y = self._middle()
            moved = np.array(to_lonlat.transform(x, y)) - np.rad2deg(unit) * np.array([x, y])
            if (np.abs((moved + 180.0) % 360.0 - 180.0) < 1e-7).all():  # same datum to 1 cm
                return GEOGRAPHIC, self._node_affine(unit, x), no_warp
        return PROJECTED, *self._warp(to_lonlat)

    def _middle(self) -> tuple[float, float]:
        """x, y of the middle of the grid, in the units of the crs."""
        a, b, c, d, e, f = self.transform
        row, column = self.heights.shape[0] / 2, self.heights.shape[1] / 2
        return a * column + b * row + c, d * column + e * row + f

    def _node_affine(self, unit: float, x0: float) -> Array:
        """Affine of ``to_grid`` for coordinates in `unit` (rad, m), x counted from `x0` (in that crs)."""
        a, b, c, d, e, f = self.transform
        inverse = np.linalg.inv(np.array([[a, b], [d, e]]))
        (c1, c2), (r1, r2) = inverse / unit
        column0, row0 = -inverse @ np.array([c - x0, f])
        return frozen([row0 - 0.5, r1, r2, column0 - 0.5, c1, c2, x0 * unit, *[0.0] * 9])

    def _warp(self, to_lonlat: Any) -> tuple[Array, Array]:
        """Affine into, and values of, a table of (row, column) over a plane that touches the ellipsoid."""
        a, b, c, d, e, f = self.transform
        rows, columns = self.heights.shape
        lon, lat = to_lonlat.transform(*self._middle())
        middle = from_geodetic(np.array([[np.deg2rad(lon), np.deg2rad(lat), 0.0]]), self.radii)[0]
        east, north, up = local_axes(np.deg2rad(lon), np.deg2rad(lat)).as_matrix().T
        at_row, at_column = np.meshgrid(np.linspace(0, rows, 41), np.linspace(0, columns, 41))
        x, y = a * at_column + b * at_row + c, d * at_column + e * at_row + f
        lon, lat = (np.deg2rad(v).ravel() for v in to_lonlat.transform(x, y))
        if not np.isfinite(lon + lat).all():
            raise InputError(f"the DEM reaches beyond the area of its crs {self.crs!r}; check `transform`")
        feet = from_geodetic(np.stack([lon, lat, 0.0 * lon], axis=1), self.radii) - middle
        if (feet @ up < -0.5 * self.radii[0]).any():
            raise InputError("the DEM covers more than 60 degrees around its middle; cut out the part needed")
        step = _WARP_STEP * self.radii[0]
        grid_u, grid_v = _table_axis(feet @ east, step), _table_axis(feet @ north, step)
        u, v = (grid.ravel() for grid in np.meshgrid(grid_u, grid_v))
        above = middle + self.radii[0] * up + u[:, np.newaxis] * east + v[:, np.newaxis] * north
        nodes = to_geodetic(Ellipsoid(*self.radii).intersect(above, np.tile(-up, (len(u), 1))), self.radii)
        x, y = to_lonlat.transform(*np.rad2deg(nodes[:, :2]).T, direction="INVERSE")
        inverse = np.linalg.inv(np.array([[a, b], [d, e]]))
        column = inverse[0, 0] * (x - c) + inverse[0, 1] * (y - f) - 0.5
        row = inverse[1, 0] * (x - c) + inverse[1, 1] * (y - f) - 0.5
        per_u, per_v = 1.0 / (grid_u[1] - grid_u[0]), 1.0 / (grid_v[1] - grid_v[0])
        into = [-grid_v[0] * per_v, 0.0, per_v, -grid_u[0] * per_u, per_u, 0.0, 0.0]
        table = np.stack([row, column], axis=-1).reshape(len(grid_v), len(grid_u), 2)
        return frozen(np.concatenate([into, middle, east, north])), frozen(table)

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """First meeting point of each ray.

        Parameters
        ----------
        origins, directions : (N, 3)
            m and unit vectors; Earth-centred axes, or local ones where `crs` is None.

        Returns
        -------
        (N, 3)
            m; NaN where the ray misses, leaves the grid, meets a void, or starts below the ground.
        """
        o, d = _checked_rays(origins, directions)
        kind, affine, warp = self._grid
        out = np.empty_like(o)
        dem_hits(
            o, d, self.ellipsoidal, self._limits, float(self.offset), kind, affine, warp, *self.radii, out
        )
        return out

    def height_at(self, points: ArrayLike) -> Array:
        """Height of the surface (N,), m, on the vertical of `points` (N, 3); NaN outside and over voids."""
        given = as_points(points)
        kind, affine, warp = self._grid
        out = np.empty(len(given))
        heights_below(given, self.ellipsoidal, float(self.offset), kind, affine, warp, *self.radii, out)
        return out

    def covers(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether the surface is known on the vertical of each of `points` (N, 3)."""
        return np.isfinite(self.height_at(points))

    def raised(self, height: float) -> Self:
        """The surface `height` metres higher; the grid itself is shared, not copied."""
        other = replace(self, offset=self.offset + height)
        for name in ("ellipsoidal", "_limits", "_grid"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other
