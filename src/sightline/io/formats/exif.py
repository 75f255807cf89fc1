"""Time and place that a camera wrote into the EXIF of a photograph; positions table from a series.

EXIF gives times to the second, by some cameras to a fraction, and places to what the writer rounded to:
enough to start from.

Not here: pixels (``images.py``), angles of gimbals and tags of rigs (``xmp.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, foreign_errors, reads
from sightline.imaging.rasters import open_raster
from sightline.io.formats.instants import parse_utc, seconds_from_epoch
from sightline.io.formats.tables import write_positions
from sightline.io.names import toml_string

Array = NDArray[np.float64]

#: GPSAltitudeRef: 0 above, 1 below sea level; since EXIF 3.0 2 above, 3 below the ellipsoid.
_BELOW, _OF_ELLIPSOID = (1, 3), (2, 3)
#: Digits beyond the second, by the names that libraries give them.
_FRACTIONS = ("EXIF_SubSecTime_Original", "EXIF_SubSecTimeOriginal", "EXIF_SubSecTime")
#: What is read: text in others, as of the artist, may be in any code.
_TAGS = (
    *_FRACTIONS, "EXIF_DateTimeOriginal", "EXIF_DateTime", "EXIF_GPSAltitude", "EXIF_GPSAltitudeRef",
    "EXIF_GPSLatitude", "EXIF_GPSLatitudeRef", "EXIF_GPSLongitude", "EXIF_GPSLongitudeRef",
    "EXIF_FocalLengthIn35mmFilm", "EXIF_FocalPlaneResolutionUnit", "EXIF_FocalPlaneXResolution",
)  # fmt: skip


@dataclass(frozen=True)
class Exif:
    """What EXIF says about one photograph.

    Attributes
    ----------
    time : str
        ISO 8601, as the camera's clock had it (taken as UTC), to the second or what the camera gave beyond.
    longitude_deg, latitude_deg : float or None
        Degrees, east and north positive; None where the file has no GPS entry.
    height : float or None
        m, as the file has it, negative where its reference says "below"; None where the file has none.
    focal_35mm : float or None
        mm; focal length of the same field of view on 36 mm x 24 mm film.
    unreferenced : bool
        Whether longitude or latitude have no E, W, N or S beside them.
    above_ellipsoid : bool
        Whether the height's reference says that it is one above the ellipsoid (values 2 and 3 of EXIF 3.0),
        not above sea level (0, 1, and where there is none).
    """

    time: str
    longitude_deg: float | None
    latitude_deg: float | None
    height: float | None
    focal_35mm: float | None = None
    unreferenced: bool = False
    above_ellipsoid: bool = False


class NoExifTime(FormatError):
    """A photograph that has no time, as of a camera without a clock."""


@reads("a photograph")
def read_exif(path: Path) -> Exif:
    """Time and place of a photograph.

    Parameters
    ----------
    path : Path
        JPEG or another format whose EXIF the raster library exposes.

    Returns
    -------
    Exif

    Raises
    ------
    FormatError
        If a value cannot be understood; `NoExifTime` if there is no time.
    """
    tags = read_tags(path)
    stamp = tags.get("EXIF_DateTimeOriginal") or tags.get("EXIF_DateTime")
    if stamp is None or not stamp.strip(" :0"):
        raise NoExifTime(f"{path}: has no EXIF time; give time = seconds or a UTC instant in its [[frame]]")
    match = re.fullmatch(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)", stamp.strip())
    if match is None:
        raise FormatError(
            f"{path}: the EXIF time {stamp!r} is not of the form YYYY:MM:DD hh:mm:ss; give time by hand"
        )
    year, month, day, clock = match.groups()
    instant = _with_fraction(f"{year}-{month}-{day}T{clock}", tags)
    parse_utc(instant, f"{path}: EXIF time")
    altitude = _numbers(tags.get("EXIF_GPSAltitude"))
    reference = _altitude_reference(tags.get("EXIF_GPSAltitudeRef", ""))
    focal = _numbers(tags.get("EXIF_FocalLengthIn35mmFilm"))
    longitude, latitude = _degrees(tags, "EXIF_GPSLongitude", "W"), _degrees(tags, "EXIF_GPSLatitude", "S")
    if abs(longitude or 0.0) > 180.0 or abs(latitude or 0.0) > 90.0:
        raise FormatError(f"{path}: the EXIF place {longitude}, {latitude} (degrees east, north) is none")
    references = ("EXIF_GPSLongitudeRef", "EXIF_GPSLatitudeRef")
    return Exif(
        instant,
        longitude,
        latitude,
        (-altitude[0] if reference in _BELOW else altitude[0]) if altitude else None,
        focal[0] if focal and focal[0] > 0.0 else None,
        longitude is not None and not all(tags.get(name, "").strip() for name in references),
        reference in _OF_ELLIPSOID,
    )


def read_tags(path: Path) -> dict[str, str]:
    """What EXIF has under the names that are used here, those that are there."""
    with foreign_errors(path, "its EXIF cannot be read", "leave it out, or write it anew"):
        with open_raster(path) as dataset:
            found = {name: dataset.get_tag_item(name, "EXIF") or dataset.get_tag_item(name) for name in _TAGS}
    return {name: value for name, value in found.items() if value is not None}


def _altitude_reference(text: str) -> int:
    """GPSAltitudeRef from a byte as the raster library shows it, a digit in ASCII too; 0 where it is none."""
    match = re.fullmatch(r"(0x[0-9a-f]+|\d+)\b.*", text.strip().lower())
    value = 0 if match is None else int(match[1], 16 if match[1].startswith("0x") else 10)
    return value - ord("0") if ord("0") <= value <= ord("3") else value


def _with_fraction(instant: str, tags: dict[str, str]) -> str:
    """The instant with the digits of the sub-second tag; some cameras count them back from the second."""
    digits = next((tags[name].strip() for name in _FRACTIONS if tags.get(name, "").strip()), "")
    if re.fullmatch(r"-\d+", digits) and float(digits):
        back = datetime.fromisoformat(instant) - timedelta(seconds=1)
        count = len(digits) - 1
        return f"{back.isoformat()}.{10**count - int(digits[1:]):0{count}d}Z"
    return f"{instant}.{digits}Z" if digits.isdigit() else f"{instant}Z"


def _numbers(text: str | None) -> list[float]:
    """All decimal numbers of a tag such as ``(31) (12) (5.3)``."""
    return [float(word) for word in re.findall(r"-?\d+(?:\.\d+)?", text or "")]


def _degrees(tags: dict[str, str], name: str, negative: str) -> float | None:
    """Degrees from a tag of degrees, minutes, seconds; None if there is none."""
    values = _numbers(tags.get(name))
    if not values:
        return None
    whole = sum(value / 60.0**k for k, value in enumerate(values[:3]))
    return -whole if tags.get(f"{name}Ref", "").strip().upper() == negative else whole


def positions_from_exif(paths: Sequence[Path], epoch: str, height: float) -> tuple[Array, Array]:
    """A table of positions in longitude and latitude from a series of photographs.

    Parameters
    ----------
    paths : sequence of Path
        Photographs with EXIF time and GPS, in the order of their times.
    epoch : str
        UTC of t = 0.
    height : float
        m above the ellipsoid, for photographs that do not say.

    Returns
    -------
    t : (N,)
        s from the epoch.
    positions : (N, 3)
        Longitude, latitude (degrees), height (m): what ``[world] frame = "lonlat"`` expects, ready for
        `sightline.io.formats.tables.write_positions`.
    """
    t, rows = [], []
    for path in paths:
        entry = read_exif(path)
        if entry.longitude_deg is None or entry.latitude_deg is None:
            raise FormatError(f"{path}: has no EXIF position; give positions = FILE")
        t.append(seconds_from_epoch(entry.time, epoch, str(path)))
        rows.append(
            (entry.longitude_deg, entry.latitude_deg, height if entry.height is None else entry.height)
        )
    return np.array(t), np.array(rows, dtype=np.float64)


def write_photo_acquisition(
    paths: Sequence[Path],
    folder: Path,
    *,
    height: float,
    body_from_camera: Sequence[float] | None = None,
    time_sigma: float = 0.29,
    ground: tuple[float, float] = (0.0, 0.0),
    masks: Sequence[Path] | None = None,
) -> Path:
    """An ``acquisition.toml`` and its ``positions.csv`` for photographs that carry EXIF time and place.

    Parameters
    ----------
    paths : sequence of Path
        Photographs in the order of their times; they stay where they are.
    folder : Path
        Exists; receives the two files.
    height : float
        m above the ellipsoid of the platform, where EXIF does not say.
    body_from_camera : (4,), optional
        Quaternion x, y, z, w; nominal (lines forward) if not given.
    time_sigma : float
        s; 0.29 is that of a stamp cut to the second.
    ground : (float, float)
        m; height of the ground above the ellipsoid, and how well it is known.
    masks : sequence of Path, optional
        One per photograph: non-zero pixels are not used.

    Returns
    -------
    Path
        The TOML file. The lens is left to be estimated, the attitude is along the track.
    """
    epoch = read_exif(paths[0]).time
    t, positions = positions_from_exif(paths, epoch, height)
    write_positions(folder / "positions.csv", t, positions)
    lines = [
        "[acquisition]",
        f"name = {toml_string(paths[0].parent.name)}",
        f"epoch = {toml_string(epoch)}",
        "[platform]",
        'kind = "ephemeris"',
        'positions = "positions.csv"',
        'attitudes = "along-track"',
        "[world]",
        'frame = "lonlat"',
        "[surface]",
        f"height = {ground[0]}",
        f"height_sigma = {ground[1]}",
        "[camera]",
        'focal_length_px = "estimate"',
        'principal_point_px = "estimate"',
        'distortion = "estimate"',
    ]
    if body_from_camera is not None:
        lines.append(f"body_from_camera = {[float(value) for value in body_from_camera]}")
    for number, path in enumerate(paths):
        image = toml_string(str(path.resolve()))
        lines += ["[[frame]]", f"image = {image}", 'time = "exif"', f"time_sigma = {time_sigma}"]
        if masks is not None:
            lines.append(f"mask = {toml_string(str(masks[number].resolve()))}")
    toml = folder / "acquisition.toml"
    toml.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return toml
