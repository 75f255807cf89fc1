"""Ground that each frame covers, as GeoJSON (RFC 7946): longitude, latitude in degrees, counterclockwise.

A frame across 180 degrees is two polygons, one on each side; one with a pole in it reaches to that pole.

Not here: which frames there are (``io/sequence/load.py``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import read_only
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.writing import whole_text

Array = NDArray[np.float64]

#: Decimals of degrees: 0.1 mm.
_DIGITS = 9


def ground_outlines(
    detector: AreaDetector,
    mount: Rotation,
    position: Array,
    world_from_body: Rotation,
    surface: Surface,
    per_side: int = 4,
) -> Array:
    """Ground (M, 4 per_side, 3) m under the edges of frames, world axes; NaN where an edge sees no ground.

    Parameters
    ----------
    detector : AreaDetector
    mount : Rotation
        body_from_camera.
    position : (M, 3)
        m.
    world_from_body : Rotation
        M rotations.
    surface : Surface
    per_side : int
        Points on each side of a frame, one of its corners among them.
    """
    lines, columns = (size - 0.5 for size in detector.shape)
    part = np.arange(per_side) / per_side
    top = np.column_stack([np.full(per_side, -0.5), -0.5 + part * (columns + 0.5)])
    right = np.column_stack([-0.5 + part * (lines + 0.5), np.full(per_side, columns)])
    bottom = np.array([lines - 0.5, columns - 0.5]) - top
    left = np.array([lines - 0.5, columns - 0.5]) - right
    looks = mount.apply(detector.directions(np.concatenate([top, right, bottom, left])))
    world = np.einsum("mij,kj->mki", world_from_body.as_matrix(), looks)
    origins = np.repeat(position, len(looks), axis=0)
    rays = world.reshape(-1, 3)
    ground = np.full_like(rays, np.nan)
    good = np.isfinite(rays).all(axis=1)
    ground[good] = surface.intersect(read_only(origins[good]), read_only(rays[good]))
    return ground.reshape(len(position), -1, 3)


def write_footprints(
    path: Path,
    names: Sequence[str],
    edges: Array,
    radii: tuple[float, float] | None = WGS84,
    properties: Mapping[str, Sequence[Any]] | None = None,
) -> int:
    """A FeatureCollection of one polygon a frame, or one MultiPolygon where it is cut at 180 degrees.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Of the frames: property ``frame``.
    edges : (M, k, 3)
        m, Earth-centred; as of `ground_outlines`.
    radii : (float, float) or None
        Of the ellipsoid.
    properties : mapping, optional
        Further properties, a value per frame each.

    Returns
    -------
    int
        Frames written: those whose whole edge sees ground.

    Raises
    ------
    InputError
        If the world is flat: it has no longitude and latitude.
    """
    features = footprint_features(names, edges, radii, properties)
    whole_text(path, json.dumps({"type": "FeatureCollection", "features": features}))
    return len(features)


def footprint_features(
    names: Sequence[str],
    edges: Array,
    radii: tuple[float, float] | None = WGS84,
    properties: Mapping[str, Sequence[Any]] | None = None,
) -> list[dict[str, Any]]:
    """The features that `write_footprints` writes; parameters as there."""
    if radii is None:
        raise InputError("footprints need longitude and latitude; give [world] an origin, or another frame")
    features = []
    for k, name in enumerate(names):
        if not np.isfinite(edges[k]).all():
            continue
        more = {key: values[k] for key, values in (properties or {}).items()}
        outline = np.degrees(to_geodetic(edges[k], radii)[:, :2])
        features.append(feature_of(outline, {"frame": name, **more}))
    return features


def feature_of(lonlat: Array, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A GeoJSON feature of an outline (k, 2), degrees: a polygon, or two where it is cut at 180 degrees."""
    rings = rings_of(lonlat)
    geometry = (
        {"type": "Polygon", "coordinates": rings}
        if len(rings) == 1
        else {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}
    )
    return {"type": "Feature", "properties": dict(properties), "geometry": geometry}


def rings_of(lonlat: Array) -> list[list[list[float]]]:
    """Closed rings, counterclockwise, each between -180 and 180 degrees, of the outline of a piece of ground.

    Parameters
    ----------
    lonlat : (k, 2)
        Longitude, latitude (degrees) round the outline, less than 180 degrees from one to the next.

    Returns
    -------
    list
        Of rings, each a list of [longitude, latitude] whose last is the first; more than one where the
        outline is cut at 180 degrees (RFC 7946, 3.1.9).
    """
    around = np.degrees(np.unwrap(np.radians(np.append(lonlat[:, 0], lonlat[0, 0]))))
    outline = np.column_stack([around[:-1], lonlat[:, 1]])
    if abs(around[-1] - around[0]) > 180.0:  # once round a pole: along its meridian to it, and back
        pole = np.copysign(90.0, lonlat[:, 1].mean())
        end = [[around[-1], lonlat[0, 1]], [around[-1], pole], [around[0], pole]]
        outline = np.concatenate([outline, end])
    x, y = (outline - outline.mean(axis=0)).T
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0.0:
        outline = outline[::-1]
    first, last = (int(np.floor((x + 180.0) / 360.0)) for x in (outline[:, 0].min(), outline[:, 0].max()))
    rings = []
    for turn in range(first, last + 1):
        part = outline - [360.0 * turn, 0.0]
        for side in (-1.0, 1.0):
            part = _this_side(part, side)
        part = np.round(part, _DIGITS)
        if len(part) >= 3 and np.ptp(part[:, 0]) > 0.0:
            rings.append(np.concatenate([part, part[:1]]).tolist())
    return rings


def _this_side(outline: Array, side: float) -> Array:
    """The part of an outline (k, 2) with side * longitude <= 180 degrees (Sutherland and Hodgman, 1974)."""
    beyond = side * outline[:, 0] - 180.0
    kept: list[Array] = []
    for k, point in enumerate(outline):
        before = k - 1
        if (beyond[k] > 0.0) != (beyond[before] > 0.0):
            part = beyond[before] / (beyond[before] - beyond[k])
            latitude = outline[before, 1] + part * (point[1] - outline[before, 1])
            kept.append(np.array([side * 180.0, latitude]))
        if beyond[k] <= 0.0:
            kept.append(point)
    return np.array(kept).reshape(-1, 2)
