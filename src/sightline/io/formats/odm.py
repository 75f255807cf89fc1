"""Text files of OpenDroneMap: ``geo.txt`` (places of images) and ``gcp_list.txt`` (control points).

First line of both: the coordinate system, ``EPSG:CODE``, a PROJ string, or ``WGS84 UTM 32N``. Then, apart by
spaces, ``#`` beginning a comment: ``image_name geo_x geo_y [geo_z [omega phi kappa [horizontal vertical]]]``,
accuracies in m, and ``geo_x geo_y geo_z im_x im_y image_name [gcp_name]``. x is easting or longitude, y
northing or latitude whatever the order of the system's own axes; heights stay as they are. im_x counts
columns, im_y lines, both from 0 at the centre of the first pixel. Angles of ``geo.txt`` are not used:
OpenDroneMap does not either, and its pages disagree on which they are.

Not here: what the places are used for (``io/sequence/load.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_text
from sightline.errors import FormatError, reads
from sightline.writing import whole_text

Array = NDArray[np.float64]

_UTM = re.compile(r"WGS ?84\s+UTM\s+(\d{1,2})\s*([NS])?", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class GeoPlaces:
    """``geo.txt``.

    Attributes
    ----------
    names : tuple of str
        Of the images.
    lonlat : (N, 3)
        Longitude, latitude (degrees), height (m; NaN where the file has none).
    sigma : (N, 2)
        m, 1-sigma horizontal and vertical; NaN where the file has none.
    angles : bool
        Whether it holds angles other than 0.
    """

    names: tuple[str, ...]
    lonlat: Array
    sigma: Array
    angles: bool


@dataclass(frozen=True, eq=False)
class ControlList:
    """``gcp_list.txt``, a row per sighting.

    Attributes
    ----------
    lonlat : (N, 3)
        Longitude, latitude (degrees), height (m).
    pixels : (N, 2)
        (line, column).
    images, names : tuple of str
        Image and control point; the coordinates as given where a point has no name.
    """

    lonlat: Array
    pixels: Array
    images: tuple[str, ...]
    names: tuple[str, ...]


@reads("geo.txt of OpenDroneMap")
def read_geo(path: Path) -> GeoPlaces:
    """Places of images; FormatError names file and line."""
    crs, rows = _rows(path, 3)
    names = tuple(cells[0] for _, cells in rows)
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise FormatError(
            f"{path}: image {twice[0]!r} has two rows; an image has one place; remove the other"
        )
    values = np.full((len(rows), 8), np.nan)
    for k, (number, cells) in enumerate(rows):
        given = cells[1:9]
        values[k, : len(given)] = [_number(path, number, word) for word in given]
    if not np.isfinite(values[:, :2]).all():
        row = int(np.flatnonzero(~np.isfinite(values[:, :2]).all(axis=1))[0])
        raise FormatError(f"{path}: line {rows[row][0]} has no place (nan); remove the line")
    sigma = np.where(values[:, 6:8] > 0.0, values[:, 6:8], np.nan)
    return GeoPlaces(
        names, _lonlat(crs, values[:, :3], path), sigma, bool((np.nan_to_num(values[:, 3:6]) != 0).any())
    )


@reads("gcp_list.txt of OpenDroneMap")
def read_gcp_list(path: Path) -> ControlList:
    """Control points and where they were seen; FormatError names file and line."""
    crs, rows = _rows(path, 6)
    values = np.array([[_number(path, number, word) for word in cells[:5]] for number, cells in rows])
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise FormatError(f"{path}: line {rows[row][0]} holds nan or inf; finite numbers are expected")
    return ControlList(
        _lonlat(crs, values[:, :3], path),
        values[:, [4, 3]],
        tuple(cells[5] for _, cells in rows),
        tuple(cells[6] if len(cells) > 6 else " ".join(cells[:3]) for _, cells in rows),
    )


def write_geo(path: Path, names: Sequence[str], lonlat: Array, sigma: Array | None = None) -> None:
    """``geo.txt`` in EPSG:4326.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Of the images, without spaces.
    lonlat : (N, 3)
        Longitude, latitude (degrees), height (m).
    sigma : (N, 2), optional
        m, horizontal and vertical; the angles before them are written as 0.
    """
    spaced = [name for name in names if re.search(r"\s", name)]
    if spaced:
        raise FormatError(f"{path}: the image name {spaced[0]!r} has a space, which geo.txt cannot hold")
    lines = ["EPSG:4326"]
    for k, (name, place) in enumerate(zip(names, np.asarray(lonlat).tolist(), strict=True)):
        line = f"{name} {place[0]:.10f} {place[1]:.10f} {place[2]:.4f}"
        if sigma is not None:
            line += f" 0 0 0 {sigma[k, 0]:.6g} {sigma[k, 1]:.6g}"
        lines.append(line)
    whole_text(path, "\n".join(lines) + "\n")


def _rows(path: Path, least: int) -> tuple[Any, list[tuple[int, list[str]]]]:
    """Coordinate system, and line number and cells of every row."""
    text = read_text(path, "a text file of OpenDroneMap", advice="check the name in the TOML file")
    lines = [(n, line.strip()) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise FormatError(f"{path}: the file is empty; a coordinate system and rows are expected")
    crs = _crs(path, lines[0][1])
    rows = [(n, line.split()) for n, line in lines[1:] if not line.startswith("#")]
    if not rows:
        raise FormatError(f"{path}: no rows below the coordinate system; at least one is needed")
    for number, cells in rows:
        if len(cells) < least:
            raise FormatError(
                f"{path}: line {number} has {len(cells)} values; {least} at least are expected, apart "
                "by spaces"
            )
    return crs, rows


def _crs(path: Path, text: str) -> Any:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    utm = _UTM.fullmatch(text)
    try:
        if utm:
            south = (utm[2] or "N").upper() == "S"
            return CRS.from_epsg((32700 if south else 32600) + int(utm[1]))
        return CRS.from_user_input("EPSG:4326" if text.upper() in ("WGS84", "WGS 84") else text)
    except CRSError:
        raise FormatError(
            f"{path}: line 1: {text!r} is no coordinate system; give EPSG:CODE, a PROJ string, or "
            "WGS84 UTM 32N"
        ) from None


def _lonlat(crs: Any, values: Array, path: Path) -> Array:
    """Longitude, latitude (degrees) and height of x, y, z; FormatError of what is no place on Earth."""
    from pyproj import Transformer

    transformer = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    longitude, latitude = transformer.transform(values[:, 0], values[:, 1])
    places = np.column_stack([longitude, latitude, values[:, 2]])
    wrong = ~((np.abs(longitude) <= 360.0) & (np.abs(latitude) <= 90.0))
    if wrong.any():
        x, y = values[int(np.argmax(wrong)), :2]
        raise FormatError(
            f"{path}: {x:.9g}, {y:.9g} is no place in the coordinate system of line 1 (x, longitude first); "
            "are x and y swapped, or are these metres about a place of the site? Give such as a table of "
            'positions (control_points) with [world] frame = "local"'
        )
    return places


def _number(path: Path, line: int, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise FormatError(f"{path}: line {line}: {word!r} is not a number") from None
