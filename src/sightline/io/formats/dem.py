"""Elevation rasters → Dem: voids, units, coordinate systems, heights above ellipsoid or geoid.

Not here: what a ray does with a Dem (``geometry/surface.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.geometry.earth import WGS84
from sightline.geometry.surface import Dem
from sightline.imaging.rasters import open_raster, raster_errors

Array = NDArray[np.float64]

#: Heights outside this range (m) are voids, whatever the file says: no ground of any known body lies there.
HEIGHT_RANGE = (-15_000.0, 30_000.0)
#: Values outside that mark voids: a raster has one, or a few where several were joined.
MOST_MARKS = 16
#: Cells that are read at most, as of 0.1 degrees of a survey at 1 m.
MOST_CELLS = 250_000_000
#: Elevation rasters up to this many cells are read whole; of larger ones only the part that is asked for.
WHOLE_CELLS = 40_000_000
#: Cells added around the part of a large raster.
MARGIN_CELLS = 16


@dataclass(frozen=True)
class Bounds:
    """A box in longitude and latitude (degrees), or in x and y (m) for local axes."""

    west: float
    south: float
    east: float
    north: float


@reads("a raster of heights")
def read_dem(
    path: Path,
    *,
    datum: str | None = None,
    geoid: Path | float | None = None,
    local: bool = False,
    radii: tuple[float, float] | None = None,
    bounds: Bounds | None = None,
) -> Dem:
    """A raster of heights in metres as a surface.

    Parameters
    ----------
    path : Path
        Any GDAL raster, SRTM .hgt included; its first band.
    datum : "ellipsoid", "geoid" or None
        What its heights count from; None if it was not said (then a vertical coordinate system in the file
        is refused rather than ignored).
    geoid : Path or float, optional
        With datum "geoid": raster of the geoid's height above the ellipsoid, or one number (m).
    local : bool
        The world is x east, y north, z up; the raster must have no geographic coordinate system.
    radii : (equatorial, polar), optional
        m; of another body than the Earth.
    bounds : Bounds, optional
        Where a raster of more than `WHOLE_CELLS` cells is needed.

    Returns
    -------
    Dem
        Voids are NaN: a ray that meets one has no point.

    Raises
    ------
    FormatError
        Names the file and what to do.
    """
    with raster_errors(path), open_raster(path) as dataset:
        crs = _coordinate_system(path, dataset, local, radii)
        _check_unit(path, dataset)
        window = _window(dataset, bounds, crs)
        cells = dataset.width * dataset.height if window is None else window.width * window.height
        if cells > MOST_CELLS:
            raise FormatError(
                f"{path}: {cells:,} cells of it would be read, {MOST_CELLS:,} at most are; cut it to the "
                "ground that is seen, or make it coarser"
            )
        heights = _heights(path, dataset, window)
        transform = dataset.transform if window is None else _of_window(dataset.transform, window)
    if datum == "geoid":
        n = (
            float(geoid)
            if isinstance(geoid, int | float)
            else _geoid_on(geoid, path, crs, transform, heights.shape)
        )
        return Dem(heights, tuple(transform)[:6], crs, n, radii or WGS84)
    if datum is None:
        _refuse_vertical_system(path, crs)
    return Dem(heights, tuple(transform)[:6], crs, None, radii or WGS84)


def _coordinate_system(
    path: Path, dataset: Any, local: bool, radii: tuple[float, float] | None
) -> str | None:
    """The crs as `Dem` takes it, or a complaint when it does not fit the world's axes."""
    if dataset.transform.is_identity:
        raise FormatError(
            f"{path}: has no georeferencing (its transform is the identity); write one: cell size and corner"
        )
    crs = dataset.crs
    engineering = crs is None or not (crs.is_geographic or crs.is_projected)
    if local:
        if not engineering:
            raise FormatError(
                f"{path}: has the coordinate system {_crs_name(crs)}, but the world is local (x east, y "
                f"north from the "
                "nadir at t = 0); remove the coordinate system from the raster, or give [world] an origin"
            )
        return None
    if engineering:
        raise FormatError(
            f"{path}: has no geographic or projected coordinate system, but the world is Earth-fixed; "
            "assign the one it was made in"
        )
    if radii is not None and crs.is_geographic:
        return "lonlat"
    return str(crs.to_wkt())


def _crs_name(crs: Any) -> str:
    """Short name of a coordinate system."""
    epsg = crs.to_epsg()
    return f"EPSG:{epsg}" if epsg else str(crs.to_wkt())[:60]


def _check_unit(path: Path, dataset: Any) -> None:
    """Heights must be metres."""
    unit = (dataset.units[0] or "").strip().lower()
    if unit not in ("", "m", "metre", "meter", "metres", "meters"):
        raise FormatError(f"{path}: heights are in {unit!r}; metres are expected; convert the raster")


def _refuse_vertical_system(path: Path, crs: str | None) -> None:
    """A file that says its heights are not ellipsoidal must not be taken as if they were."""
    if crs is None or crs == "lonlat":
        return
    from pyproj import CRS

    system = CRS.from_user_input(crs)
    if system.is_compound:
        vertical = system.sub_crs_list[-1].name
        raise FormatError(
            f'{path}: its heights count from {vertical!r}; say what to do: datum = "geoid" with geoid = a '
            f"raster of "
            'geoid heights or a number in metres, or datum = "ellipsoid" if the file is wrong'
        )


def _window(dataset: Any, bounds: Bounds | None, crs: str | None) -> Any:
    """The part of a large raster that covers `bounds`; None for all of it."""
    if bounds is None or dataset.width * dataset.height <= WHOLE_CELLS:
        return None
    from rasterio.warp import transform_bounds
    from rasterio.windows import Window

    box = (bounds.west, bounds.south, bounds.east, bounds.north)
    if crs is not None and crs != "lonlat":
        box = transform_bounds("EPSG:4326", dataset.crs, *box, densify_pts=21)
    left, bottom, right, top = box
    back = ~dataset.transform
    corners = [(left, bottom), (left, top), (right, bottom), (right, top)]
    columns = [back.a * x + back.b * y + back.c for x, y in corners]
    rows = [back.d * x + back.e * y + back.f for x, y in corners]
    first_row = max(0, math.floor(min(rows)) - MARGIN_CELLS)
    first_column = max(0, math.floor(min(columns)) - MARGIN_CELLS)
    last_row = min(dataset.height, math.ceil(max(rows)) + MARGIN_CELLS)
    last_column = min(dataset.width, math.ceil(max(columns)) + MARGIN_CELLS)
    if last_row - first_row < 2 or last_column - first_column < 2:
        return None
    return Window(first_column, first_row, last_column - first_column, last_row - first_row)


def _of_window(transform: Any, window: Any) -> Any:
    """The transform of a window; rasterio's own warns with some versions of affine."""
    from rasterio.transform import Affine

    a, b, c, d, e, f = transform[:6]
    column, row = window.col_off, window.row_off
    return Affine(a, b, c + a * column + b * row, d, e, f + d * column + e * row)


def _heights(path: Path, dataset: Any, window: Any) -> Array:
    """Heights in m, NaN where unknown."""
    heights: Array = dataset.read(1, window=window, masked=True).astype(np.float64).filled(np.nan)
    none = (heights < HEIGHT_RANGE[0]) | (heights > HEIGHT_RANGE[1])
    marks = np.unique(heights[none])
    if len(marks) > MOST_MARKS:
        raise FormatError(
            f"{path}: {int(none.sum())} cells hold {len(marks)} values from {marks[0]:.3g} to "
            f"{marks[-1]:.3g}: no heights in metres, and too many to mark voids; is it damaged, or in "
            "another unit?"
        )
    heights[none] = np.nan
    if not np.isfinite(heights).any():
        raise FormatError(
            f"{path}: no height between {HEIGHT_RANGE[0]:g} and {HEIGHT_RANGE[1]:g} m; is it a DEM in metres?"
        )
    return heights


def _geoid_on(
    geoid: Path | None, dem: Path, crs: str | None, transform: Any, shape: tuple[int, ...]
) -> Array:
    """The geoid's height at every node of a DEM, from a raster; FormatError if it does not cover it."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.warp import reproject

    if geoid is None:
        raise FormatError(f'{dem}: datum "geoid" needs geoid = a raster or a number in metres')
    out = np.full(shape, np.nan)
    with raster_errors(geoid), open_raster(geoid) as dataset:
        if dataset.crs is None or dataset.transform.is_identity:
            raise FormatError(
                f"{geoid}: has no coordinate system, or no place in it; a georeferenced raster of geoid "
                "heights is expected"
            )
        _check_unit(geoid, dataset)
        reproject(
            rasterio.band(dataset, 1),
            out,
            dst_transform=transform,
            dst_crs=_horizontal(crs) if crs not in (None, "lonlat") else dataset.crs,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
        )
    missing = float(np.mean(~np.isfinite(out)))
    if missing > 0.0:
        raise FormatError(
            f"{geoid}: does not cover {100 * missing:.1f} % of {dem.name}; give a geoid raster that covers "
            f"the whole DEM, "
            "or one number in metres"
        )
    return out


def _horizontal(crs: str | None) -> str:
    """The horizontal part of a coordinate system, as WKT."""
    from pyproj import CRS

    system = CRS.from_user_input(crs)
    return str((system.sub_crs_list[0] if system.is_compound else system).to_wkt())
