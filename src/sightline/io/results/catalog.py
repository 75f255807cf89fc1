"""What a result covers, for catalogues: an item of STAC, a table of footprints as GeoParquet.

Not here: outlines of frames (``io/formats/footprints.py``), which result gives what (``kinds/``).
"""

from __future__ import annotations

import json
import os
import re
import struct
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.surface import Surface
from sightline.io.formats.footprints import feature_of
from sightline.io.formats.instants import utc_text
from sightline.io.names import file_stem
from sightline.writing import final_folder, whole, whole_text

Array = NDArray[np.float64]
Features = Sequence[Mapping[str, Any]]

STAC_VERSION = "1.1.0"
PROJECTION = "https://stac-extensions.github.io/projection/v2.0.0/schema.json"
#: Media types of files by their endings.
MEDIA = {
    ".csv": "text/csv", ".json": "application/json", ".html": "text/html", ".txt": "text/plain",
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized", ".png": "image/png",
    ".geojson": "application/geo+json", ".nc": "application/netcdf", ".zarr": "application/vnd.zarr",
}  # fmt: skip
#: Files that tell of a result, in place of being it.
_METADATA = (".json", ".html")
#: Points on each side of a strip's outline.
_PER_SIDE = 16


def strip_features(
    cameras: Mapping[str, PushbroomCamera], surface: Surface, radii: tuple[float, float]
) -> list[dict[str, Any]]:
    """GeoJSON features of what each band of a strip shows, with the time (s) of its first and last line.

    Raises
    ------
    GeometryError
        If an edge of a band sees no ground.
    """
    features = []
    for name, camera in cameras.items():
        lines, columns = (size - 0.5 for size in camera.shape)
        part = np.linspace(0.0, 1.0, _PER_SIDE, endpoint=False)
        low, high = (max(camera.known_lines[0], -0.5), min(camera.known_lines[1], lines))
        down, right = low + part * (high - low), -0.5 + part * (columns + 0.5)
        edge = np.concatenate([
            np.column_stack([np.full(_PER_SIDE, low), right]),
            np.column_stack([down, np.full(_PER_SIDE, columns)]),
            np.column_stack([np.full(_PER_SIDE, high), right[::-1] + (columns + 0.5) / _PER_SIDE]),
            np.column_stack([down[::-1] + (high - low) / _PER_SIDE, np.full(_PER_SIDE, -0.5)]),
        ])  # fmt: skip
        ground = camera.locate(edge, surface)
        if not np.isfinite(ground).all():
            raise GeometryError(f"{name}: its edge sees no ground everywhere: what it covers has no outline")
        ends = camera.times(np.array([0.0, camera.lines - 1.0]))
        said = {"name": name, "t_first": float(ends[0]), "t_last": float(ends[1])}
        features.append(feature_of(np.degrees(to_geodetic(ground, radii)[:, :2]), said))
    return features


def hull_of(features: Features) -> dict[str, Any]:
    """Geometry of the convex hull of all features, cut at 180 degrees."""
    from scipy.spatial import ConvexHull

    rings = [np.array(ring) for feature in features for ring in _rings(feature["geometry"])]
    points = np.concatenate(rings)
    if np.ptp(points[:, 0]) > 180.0:  # on both sides of 180 degrees
        points[:, 0] %= 360.0
    outline = points[ConvexHull(points).vertices]
    return dict(feature_of(outline, {})["geometry"])


def _rings(geometry: Mapping[str, Any]) -> list[Any]:
    """Outer rings of a Polygon or MultiPolygon."""
    parts = geometry["coordinates"]
    return [parts[0]] if geometry["type"] == "Polygon" else [part[0] for part in parts]


def bounds_of(geometry: Mapping[str, Any]) -> list[float]:
    """West, south, east, north (degrees); west is the greater number where 180 degrees lie between."""
    rings = [np.array(ring) for ring in _rings(geometry)]
    points = np.concatenate(rings)
    south, north = float(points[:, 1].min()), float(points[:, 1].max())
    if len(rings) > 1:
        east_of = [ring for ring in rings if ring[:, 0].mean() > 0.0]
        west_of = [ring for ring in rings if ring[:, 0].mean() <= 0.0]
        west, east = min(r[:, 0].min() for r in east_of), max(r[:, 0].max() for r in west_of)
        return [float(west), south, float(east), north]
    return [float(points[:, 0].min()), south, float(points[:, 0].max()), north]


def instant(t: float, epoch: str) -> str:
    """RFC 3339, UTC, to the microsecond."""
    return utc_text(t, epoch)[:26].rstrip("Z") + "Z"


def write_stac(
    folder: Path,
    name: str,
    features: Features,
    span: tuple[float, float],
    epoch: str,
    source: Path | None,
    files: Sequence[str],
    cube: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """``stac.json``: an item of STAC 1.1 whose assets are the files of the result, where they lie.

    Parameters
    ----------
    folder : Path
        Exists.
    name : str
        Title of the result; its identifier is made of it.
    features : sequence of GeoJSON features
        What it covers.
    span : (float, float)
        s from the epoch: first and last exposure.
    epoch : str
        UTC of t = 0.
    source : Path or None
        Folder of the result; None: an acquisition, which has no files.
    files : sequence of str
        Their names below it.
    cube : mapping, optional
        Entry ``cube`` of the summary of a flight: the map, for the projection extension.
    """
    geometry = hull_of(features)
    place = final_folder(folder)
    properties: dict[str, Any] = {
        "title": name,
        "datetime": instant(0.5 * (span[0] + span[1]), epoch),
        "start_datetime": instant(span[0], epoch),
        "end_datetime": instant(span[1], epoch),
        "proj:code": None,
    }
    if cube is not None and cube["crs"] is not None:
        west, _, _, north = cube["extent"]
        properties |= _code(cube["crs"]) | {
            "proj:shape": list(cube["shape"]),
            "proj:transform": [cube["gsd"], 0.0, west, 0.0, -cube["gsd"], north],
        }
    assets: dict[str, Any] = {}
    for file in sorted({re.sub(r"(\.zarr)/.*", r"\1", one) for one in files}):
        assert source is not None
        ending = Path(file).suffix
        asset: dict[str, Any] = {
            "href": Path(os.path.relpath(source.absolute() / file, place.absolute())).as_posix(),
            "roles": ["metadata"] if ending in _METADATA else ["data"],
        }
        if ending in MEDIA:
            asset["type"] = MEDIA[ending]
        assets[file] = asset
    item = {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [PROJECTION],
        "id": file_stem(name),
        "geometry": geometry,
        "bbox": bounds_of(geometry),
        "properties": properties,
        "links": [],
        "assets": assets,
    }
    whole_text(folder / "stac.json", json.dumps(item, indent=1))
    return {"axes": "longitude, latitude (degrees, WGS84)", "assets": len(assets)}


def _code(system: str) -> dict[str, Any]:
    """How the projection extension names a coordinate system."""
    from pyproj import CRS

    crs = CRS.from_user_input(system)
    authority = crs.to_authority(min_confidence=100)
    return {"proj:code": ":".join(authority)} if authority else {"proj:code": None, "proj:wkt2": crs.to_wkt()}


def write_geoparquet(
    path: Path, features: Features, radii: tuple[float, float], epoch: str | None
) -> dict[str, Any]:
    """Footprints as GeoParquet 1.1: their properties as columns, geometry as WKB.

    Parameters
    ----------
    path : Path
    features : sequence of GeoJSON features
        With the same properties each.
    radii : (equatorial, polar)
        m; of the ellipsoid of longitude and latitude.
    epoch : str or None
        UTC of t = 0; with it every time has a column of instants.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "GeoParquet files need pyarrow, which is not installed; run `pip install pyarrow`"
        ) from None
    columns: dict[str, Any] = {}
    for key in features[0]["properties"]:
        columns[key] = pyarrow.array([feature["properties"][key] for feature in features])
        if epoch is not None and (key == "t" or key.startswith("t_")):
            at = [datetime.fromisoformat(instant(float(t), epoch)) for t in columns[key].to_pylist()]
            columns["datetime" + key[1:]] = pyarrow.array(at, pyarrow.timestamp("us", tz="UTC"))
    columns["geometry"] = pyarrow.array([_wkb(feature["geometry"]) for feature in features], pyarrow.binary())
    points = np.concatenate([np.array(r) for feature in features for r in _rings(feature["geometry"])])
    about: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": sorted({feature["geometry"]["type"] for feature in features}),
        "orientation": "counterclockwise",
        "bbox": [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()],
    }
    if abs(radii[0] / WGS84[0] - 1.0) > 1e-6:
        from pyproj import CRS

        about["crs"] = CRS.from_user_input(
            f"+proj=longlat +a={radii[0]!r} +b={radii[1]!r} +no_defs"
        ).to_json_dict()
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": about}}
    table = pyarrow.table(columns).replace_schema_metadata({"geo": json.dumps(geo)})
    with whole(path) as draft:
        pyarrow.parquet.write_table(table, draft)
    return {"rows": len(features), "axes": "longitude, latitude (degrees)"}


def _wkb(geometry: Mapping[str, Any]) -> bytes:
    """Well-known binary, little endian, of a Polygon or MultiPolygon without holes."""
    polygons = [
        struct.pack("<BIII", 1, 3, 1, len(ring)) + np.asarray(ring, dtype="<f8").tobytes()
        for ring in _rings(geometry)
    ]
    if geometry["type"] == "Polygon":
        return polygons[0]
    return struct.pack("<BII", 1, 6, len(polygons)) + b"".join(polygons)
