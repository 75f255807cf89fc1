"""The grid of a map: rows from north to south, columns from west to east; where they lie in the world.

Not here: what lies on it (``frame_cube.py``), files (``io/results/cube_files.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import positive
from sightline.geometry.earth import WGS84, from_geodetic, to_geodetic

Array = NDArray[np.float64]

#: Degrees of latitude beyond which maps are polar stereographic ones.
_POLAR = 84.0


def map_system(point: Array, radii: tuple[float, float]) -> str:
    """Coordinate system of a map about a place: UTM or UPS on Earth, else transverse Mercator about it.

    Parameters
    ----------
    point : (3,)
        m, Earth-centred (body-centred) axes.
    radii : (equatorial, polar)
        m.

    Returns
    -------
    str
        "EPSG:..." or a PROJ string.
    """
    lon, lat, _ = to_geodetic(point[None], radii)[0]
    lon, lat = float(np.degrees(lon)), float(np.degrees(lat))
    if abs(radii[0] / WGS84[0] - 1.0) > 1e-6:
        return (
            f"+proj=tmerc +lat_0={lat:.6f} +lon_0={lon:.6f} +k=1 +x_0=0 +y_0=0 +a={radii[0]!r} "
            f"+b={radii[1]!r} +units=m +no_defs"
        )
    if abs(lat) > _POLAR:
        return "EPSG:5041" if lat > 0.0 else "EPSG:5042"
    zone = int(np.floor((lon + 180.0) / 6.0)) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0.0 else 32700) + zone}"


@dataclass(frozen=True)
class MapSystem:
    """Axes of a map: easting, northing (m) and height (m).

    Attributes
    ----------
    crs : str or None
        As `map_system` gives it; None: the world is flat, and these are its x, y and z.
    radii : (equatorial, polar)
        m; of the ellipsoid that heights are above.
    """

    crs: str | None = None
    radii: tuple[float, float] = WGS84

    @cached_property
    def _to_lonlat(self) -> Any:
        from pyproj import CRS, Transformer

        crs = CRS.from_user_input(self.crs)
        return Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)

    def world(self, places: Array) -> Array:
        """World points (N, 3) m of map places (N, 3): easting, northing, height."""
        if self.crs is None:
            return np.asarray(places, dtype=np.float64)
        lon, lat = self._to_lonlat.transform(places[:, 0], places[:, 1])
        return from_geodetic(np.stack([np.radians(lon), np.radians(lat), places[:, 2]], axis=1), self.radii)

    def places(self, world: Array) -> Array:
        """Map places (N, 3) of world points (N, 3) m; NaN rows stay NaN."""
        given = np.asarray(world, dtype=np.float64)
        if self.crs is None:
            return given
        out = np.full_like(given, np.nan)
        known = np.isfinite(given).all(axis=1)
        geodetic = to_geodetic(given[known], self.radii)
        x, y = self._to_lonlat.transform(*np.degrees(geodetic[:, :2]).T, direction="INVERSE")
        out[known] = np.stack([x, y, geodetic[:, 2]], axis=1)
        return out


@dataclass(frozen=True)
class CubeGrid:
    """Pixels of a map.

    Attributes
    ----------
    system : MapSystem
    west, north : float
        m; outer corner of pixel (0, 0).
    gsd : float
        m, side of a pixel.
    shape : (rows, columns)
    """

    system: MapSystem
    west: float
    north: float
    gsd: float
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        """Check."""
        positive(self.gsd, "gsd", "m")
        if min(self.shape) < 1:
            raise InputError(f"`shape` of a map must be (rows, columns), both positive, got {self.shape}")

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """x = a column + b row + c, y = d column + e row + f of pixel corners: the affine of GDAL."""
        return self.gsd, 0.0, self.west, 0.0, -self.gsd, self.north

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north (m)."""
        rows, columns = self.shape
        return self.west, self.north - rows * self.gsd, self.west + columns * self.gsd, self.north

    def centres(self, rows: Array, columns: Array) -> Array:
        """Easting and northing (..., 2) m of pixels (row, column), fractions allowed."""
        x = self.west + self.gsd * (np.asarray(columns) + 0.5)
        y = self.north - self.gsd * (np.asarray(rows) + 0.5)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def pixels(self, places: Array) -> Array:
        """Pixels (N, 2), (row, column), of map places (N, 2 or 3)."""
        column = (places[:, 0] - self.west) / self.gsd - 0.5
        row = (self.north - places[:, 1]) / self.gsd - 0.5
        return np.stack([row, column], axis=1)
