"""The ground that synchronous cameras look at: relief about the aim point, and points on it.

What a pass is made of is in ``stereo_options.py``; who looks at it in ``stereo.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from sightline.errors import InputError
from sightline.geometry.earth import from_geodetic, to_geodetic
from sightline.geometry.orbit_pair import OrbitPair
from sightline.geometry.surface import Dem, Ellipsoid
from sightline.imaging.rasters import open_raster, raster_errors
from sightline.simulate.measured import srtm_relief
from sightline.simulate.scene import Extent, Relief, random_relief, relief_at
from sightline.simulate.stereo_options import StereoOptions
from sightline.simulate.texture import Array

_POSTING = 60.0  # m between the nodes of the DEM: 1/70 of the shortest sinusoid
_SINUSOIDS, _SHORTEST, _LONGEST = 8, 4e3, 12e3  # S2's smooth relief

Heights = Callable[[Array, Array], Array]


def lay_ground(options: StereoOptions, pair: OrbitPair, seed: np.random.SeedSequence) -> Dem | Ellipsoid:
    """Relief on a grid of longitudes and latitudes about the aim point; mid-range zero over the scene.

    `pair` gives the aim point and the ellipsoid. Without relief, or with one that no grid can hold
    ("white"), the ellipsoid itself.
    """
    if options.relief in ("none", "white"):
        return Ellipsoid(*pair.radii)
    size = options.ground_size or 1.5 * options.scene_size
    heights_of = _heights(options, size, seed)
    nodes, transform = _nodes(pair, size)
    x, y = _level(pair, nodes.reshape(-1, 3)).reshape(*nodes.shape[:2], 2).transpose(2, 0, 1)
    heights = heights_of(x, y)
    half = 0.5 * options.scene_size
    scene = heights[(np.abs(x) <= half) & (np.abs(y) <= half)]
    low, high = float(scene.min()), float(scene.max())
    if not high > low:
        raise InputError(
            f"`scene_size` {options.scene_size:g} m holds no relief: heights are laid every {_POSTING:g} m; "
            f'give {3 * _POSTING:g} m or more, or relief "none"'
        )
    heights = heights - 0.5 * (low + high)
    if options.relief != "dem":
        heights *= options.relief_range / (high - low)
    return Dem(heights, transform, "lonlat", radii=pair.radii)


def _heights(options: StereoOptions, size: float, seed: np.random.SeedSequence) -> Heights:
    """Heights (m, of any level and range) as a function of metres east and north of the aim point."""
    if options.relief == "smooth":
        return _sinusoids(np.random.default_rng(seed))
    half = 0.5 * size + 4.0 * _POSTING
    if options.relief == "spectrum":
        relief = random_relief(seed, Extent(-half, half, -half, half), 1.0)
    elif options.dem_file:
        relief = dem_relief(Path(options.dem_file), 2.0 * half)
    else:
        relief = srtm_relief((0.0, 0.0), (2.0 * half, 2.0 * half))
    return lambda x, y: relief_at(relief, x, y)


def _sinusoids(rng: np.random.Generator) -> Heights:
    azimuth, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _SINUSOIDS))
    number = 2.0 * np.pi / rng.uniform(_SHORTEST, _LONGEST, _SINUSOIDS)

    def heights(x: Array, y: Array) -> Array:
        along = x[..., np.newaxis] * np.cos(azimuth) + y[..., np.newaxis] * np.sin(azimuth)
        return np.asarray(np.sin(number * along + phase).sum(axis=-1))

    return heights


def dem_relief(path: Path, size: float) -> Relief:
    """The middle of a raster of heights, `size` m square, laid under the origin of local axes.

    A raster in degrees is laid out in metres by the scale at its middle. Raises FormatError where it cannot
    be read, InputError where it is too small or has voids.
    """
    from rasterio.windows import Window

    with raster_errors(path), open_raster(path) as source:
        dx, dy = abs(source.transform.a), abs(source.transform.e)
        if source.crs is not None and source.crs.is_geographic:
            metres = np.pi / 180.0 * 6371000.0
            _, latitude = source.xy(source.height // 2, source.width // 2)
            dx, dy = dx * metres * float(np.cos(np.radians(latitude))), dy * metres
        rows, columns = int(np.ceil(size / dy)) + 3, int(np.ceil(size / dx)) + 3
        if rows > source.height or columns > source.width:
            across, down = 1e-3 * source.width * dx, 1e-3 * source.height * dy
            raise InputError(
                f"{path}: covers {across:.1f} x {down:.1f} km, {size / 1e3:.1f} km square are needed; "
                "give a larger raster, or a smaller `scene_size` or `ground_size`"
            )
        window = Window((source.width - columns) // 2, (source.height - rows) // 2, columns, rows)
        masked = source.read(1, window=window, masked=True)
    heights = np.ma.filled(masked.astype(np.float64), np.nan)
    if not np.isfinite(heights).all():
        raise InputError(f"{path}: has voids in its middle {size / 1e3:.1f} km; fill them, or give another")
    return Relief(heights, -0.5 * (columns - 1) * dx, 0.5 * (rows - 1) * dy, (dx, dy))


def _nodes(pair: OrbitPair, size: float) -> tuple[Array, tuple[float, ...]]:
    """World places (rows, columns, 3) of the nodes at height 0, and the affine of their grid, degrees."""
    longitude, latitude, _ = to_geodetic(pair.aim_point, pair.radii)[0]
    count = 2 * int(np.ceil(0.5 * size / _POSTING)) + 3
    steps = _POSTING * (np.arange(count) - count // 2)
    lon = longitude + steps / (pair.radii[0] * np.cos(latitude))
    lat = latitude - steps / pair.radii[0]
    grid = np.stack([*np.meshgrid(lon, lat), np.zeros((count, count))], axis=-1)
    nodes = from_geodetic(grid.reshape(-1, 3), pair.radii).reshape(grid.shape)
    dx, dy = (float(np.degrees(v[1] - v[0])) for v in (lon, lat))
    west, north = float(np.degrees(lon[0])) - 0.5 * dx, float(np.degrees(lat[0])) - 0.5 * dy
    return nodes, (dx, 0.0, west, 0.0, dy, north)


def _level(pair: OrbitPair, points: Array) -> Array:
    """Metres (N, 2) east and north of the aim point."""
    return np.asarray(((points - pair.aim_point) @ pair.world_from_local.as_matrix())[:, :2])


def lay_points(
    options: StereoOptions, pair: OrbitPair, surface: Dem | Ellipsoid, seed: np.random.SeedSequence
) -> Array:
    """Points (N, 3) m, world axes, spread evenly over the scene, on the surface; or "white" about it."""
    rng = np.random.default_rng(seed)
    half = 0.5 * options.scene_size
    level = rng.uniform(-half, half, (options.points, 2))
    white = rng.uniform(-0.5, 0.5, options.points)
    axes = pair.world_from_local.as_matrix()
    geodetic = to_geodetic(pair.aim_point + level @ axes[:, :2].T, pair.radii)
    if isinstance(surface, Dem):
        geodetic[:, 2] = surface.height_at(from_geodetic(geodetic, pair.radii))
    else:
        geodetic[:, 2] = options.relief_range * white if options.relief == "white" else 0.0
    return from_geodetic(geodetic, pair.radii)
