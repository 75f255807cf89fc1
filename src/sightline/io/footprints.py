"""Ground that each frame covers, as GeoJSON (RFC 7946): longitude, latitude in degrees, counterclockwise.

Not here: which frames there are (``sequence.py``).
"""

from __future__ import annotations

import json
import os
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

Array = NDArray[np.float64]


def outlines(
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
    """A FeatureCollection of one polygon a frame.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Of the frames: property ``frame``.
    edges : (M, k, 3)
        m, Earth-centred; as of `outlines`.
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
    if radii is None:
        raise InputError("footprints need longitude and latitude; give [world] an origin, or another frame")
    features = []
    for k, name in enumerate(names):
        if not np.isfinite(edges[k]).all():
            continue
        lonlat = np.degrees(to_geodetic(edges[k], radii)[:, :2])
        lonlat[:, 0] = np.degrees(np.unwrap(np.radians(lonlat[:, 0])))
        x, y = (lonlat - lonlat.mean(axis=0)).T
        if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0.0:
            lonlat = lonlat[::-1]
        ring = np.round(np.concatenate([lonlat, lonlat[:1]]), 9).tolist()
        more = {key: values[k] for key, values in (properties or {}).items()}
        features.append(
            {
                "type": "Feature",
                "properties": {"frame": name, **more},
                "geometry": {"type": "Polygon", "coordinates": [ring]},
            }
        )
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    os.replace(temporary, path)
    return len(features)
