"""Rough positions of frames: a table, a SBET, ``geo.txt``, GPS of photographs.

Not here: rows at the times of frames (``matched_rows.py``), longitudes that cannot be
(``io/formats/gps_places.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.platform import points_to_world
from sightline.io.formats.exif import Exif
from sightline.io.formats.gps_places import places
from sightline.io.formats.odm import read_geo
from sightline.io.formats.sbet import is_sbet
from sightline.io.formats.tables import header_of
from sightline.io.formats.xmp import Xmp
from sightline.io.quantities import LENGTH_SIGMA
from sightline.io.sequence.flown import flown_at_frames
from sightline.io.sequence.frames import PAUSE, FrameList
from sightline.io.sequence.matched_rows import GivenRows, in_time, is_local, matched, radii_of, sigmas_of
from sightline.io.sequence.models import GivenPoses
from sightline.io.sequence.schema import SequenceFile
from sightline.io.sequence.times import read_timed

Array = NDArray[np.float64]

#: s, 1-sigma of a time that is given to the second; times the positions' sigma from which on that matters.
_SECOND_SIGMA, _FAST = 0.3, 2.0
POSITION_SIGMAS = ("sigma_x", "sigma_y", "sigma_z")


def given_positions(
    file: SequenceFile,
    files: InputFolder,
    frames: FrameList,
    model: GivenPoses | None,
    warnings: list[str],
) -> GivenRows | None:
    """Given positions in the axes of computation; None where there are none."""
    if file.positions is not None:
        return _table_positions(file, files(file.positions), frames, warnings)
    if file.geo is not None:
        return _geo_positions(file, files(file.geo), frames, warnings)
    if model is not None:
        return model.positions
    if frames.exif:
        return _exif_positions(file, frames, warnings)
    return None


def _table_positions(
    file: SequenceFile, path: Path, frames: FrameList, warnings: list[str]
) -> GivenRows | None:
    if is_sbet(path):
        position, _ = flown_at_frames(file, path, frames, warnings)
        rows = np.arange(len(position))
        _say_assumed(file, warnings, rows)
        sigma = np.full((len(position), 3), file.position_sigma)
        kept = np.ones(len(rows), dtype=np.bool_)
        return in_time(rows, frames.t, position, sigma, kept, _level_axes(file, position), common=True)
    header = header_of(path)
    with_sigma = [name for name in POSITION_SIGMAS if name in header]
    if with_sigma and len(with_sigma) < 3:
        raise FormatError(f"{path}: has {', '.join(with_sigma)} alone; sigma_x,sigma_y,sigma_z are expected")
    columns = ("frame", "t", "x", "y", "z", *with_sigma)
    table = read_timed(path, columns, frames.epoch, text=("frame",), infinite=POSITION_SIGMAS)
    names = tuple(str(word) for word in table["frame"])
    frame, t = matched(path, frames, names, np.asarray(table["t"], dtype=np.float64))
    values = np.column_stack([np.asarray(table[axis], dtype=np.float64) for axis in "xyz"])
    kept = np.ones(len(t), dtype=np.bool_)
    if file.world.frame == "lonlat":
        kept = places(t, values, names, str(path), warnings)
    if not with_sigma:
        _say_assumed(file, warnings, np.flatnonzero(kept))
    sigma = sigmas_of(path, table, with_sigma, len(t), file.position_sigma, LENGTH_SIGMA)
    position = points_to_world(values, file.world, file.surface.radii, path)
    return in_time(frame, t, position, sigma, kept, _sigma_axes(file, position))


def _sigma_axes(file: SequenceFile, position: Array) -> Array | None:
    """Axes of computation (n, 3, 3) from those of the sigmas of a table; None: the same."""
    if is_local(file) or file.world.frame == "earth-fixed":
        return None
    if file.world.frame == "local" and file.world.origin is not None:
        lon, lat = np.radians(file.world.origin[:2])
        return np.tile(local_axes(lon, lat).as_matrix(), (len(position), 1, 1))
    return _level_axes(file, position)


def _level_axes(file: SequenceFile, position: Array) -> Array:
    """East, north, up (n, 3, 3) of each position, in the axes of computation."""
    lon, lat, _ = to_geodetic(position, radii_of(file) or WGS84).T
    return np.asarray(local_axes(lon, lat).as_matrix())


def _geodetic(file: SequenceFile, lonlat: Array) -> Array:
    """Points of computation of longitude, latitude (degrees), height."""
    return from_geodetic(np.column_stack([np.radians(lonlat[:, :2]), lonlat[:, 2]]), radii_of(file) or WGS84)


def _with_heights(file: SequenceFile, lonlat: Array, place: str) -> Array:
    """Heights that are not given are `altitude`."""
    none = ~np.isfinite(lonlat[:, 2])
    if none.any() and file.altitude is None:
        raise FormatError(
            f"{place}: {int(none.sum())} positions have no height; give altitude = m above the "
            "ellipsoid, or positions = "
            "FILE"
        )
    return np.column_stack([lonlat[:, :2], np.where(none, file.altitude or 0.0, lonlat[:, 2])])


def _geo_positions(
    file: SequenceFile, path: Path, frames: FrameList, warnings: list[str]
) -> GivenRows | None:
    geo = read_geo(path)
    frame, t = matched(path, frames, geo.names, None)
    if geo.angles:
        warnings.append(f"{path.name}: its angles are not used; give attitudes = FILE")
    kept = places(t, geo.lonlat, geo.names, str(path), warnings)
    position = _geodetic(file, _with_heights(file, geo.lonlat, str(path)))
    _say_assumed(file, warnings, np.flatnonzero(kept & ~np.isfinite(geo.sigma).all(axis=1)))
    _say_heights(warnings, path.name, int((kept & np.isfinite(geo.lonlat[:, 2])).sum()))
    sigma = np.where(np.isfinite(geo.sigma), geo.sigma, file.position_sigma)[:, [0, 0, 1]]
    return in_time(frame, t, position, sigma, kept, _level_axes(file, position), common=True)


def _say_heights(warnings: list[str], table: str, count: int, what: str = "heights") -> None:
    """That heights of which the zero is not known are not corrected for it."""
    if count:
        warnings.append(
            f"{table}: {count} {what} are taken as they are written, as if above the ellipsoid: no geoid is "
            "applied; where they are above sea level the result is off by the geoid's height, up to 100 m; "
            "[surface] and control points have to count from the same level"
        )


def _say_assumed(file: SequenceFile, warnings: list[str], rows: NDArray[np.intp]) -> None:
    """That nothing but a default says how good positions are."""
    if len(rows) and "position_sigma" not in file.model_fields_set:
        warnings.append(
            f"{len(rows)} positions have no sigma: {file.position_sigma:g} m per axis is assumed; set "
            "position_sigma"
        )


def _say_whole_seconds(
    frames: FrameList, position: Array, sigma: Array, rows: NDArray[np.intp], warnings: list[str]
) -> None:
    """What stamps without a fraction of a second alone leave open of a fast camera's places."""
    stamps = [exif.time for exif in frames.exif if exif is not None]
    step = np.diff(frames.t[rows])
    if any("." in stamp for stamp in stamps) or not (step > 0.0).any():
        return
    # of a whole stretch, as stamps of single steps are off by up to a second
    moved = np.linalg.norm(np.diff(position[rows], axis=0), axis=1)
    usual = step <= PAUSE
    speed = float(moved[usual].sum() / step[usual].sum()) if step[usual].sum() > 0.0 else 0.0
    off, typical = speed * _SECOND_SIGMA, float(np.median(sigma[rows]))
    if off > _FAST * typical:
        warnings.append(
            f"the photographs' stamps are whole seconds, the camera flies at {speed:.3g} m/s: the stamp "
            f"alone leaves {off:.2g} m along the flight uncertain ({_SECOND_SIGMA:g} s x speed), beyond the "
            f"{typical:.3g} m that positions are assumed good to; a GPS that is read once a second is off "
            f"likewise: position_sigma = {off:.2g} if so, or a table of frames with finer times"
        )


def _exif_positions(file: SequenceFile, frames: FrameList, warnings: list[str]) -> GivenRows | None:
    """GPS of photographs."""
    if is_local(file):
        warnings.append('[world] frame = "local" without origin: GPS of the photographs is not used')
        return None
    lonlat, sigma = (
        np.full((len(frames.names), 3), np.nan),
        np.full((len(frames.names), 3), file.position_sigma),
    )
    signs, bare = 0, 0
    assumed = np.ones(len(frames.names), dtype=np.bool_)
    for k, (exif, xmp) in enumerate(zip(frames.exif, frames.xmp, strict=True)):
        place, turned = place_of(exif, xmp)
        lonlat[k] = place
        signs += turned
        bare += exif is not None and exif.unreferenced and not turned
        if xmp is not None and xmp.position_sigma is not None:
            sigma[k] = xmp.position_sigma
            assumed[k] = False
    if signs:
        warnings.append(f"{signs} photographs: EXIF and XMP disagree on the hemisphere: that of XMP is taken")
    if bare:
        warnings.append(
            f"{bare} photographs give longitude or latitude without E, W, N, S: taken as east and north"
        )
    kept = places(frames.t, lonlat, frames.names, str(frames.path), warnings)
    if not kept.any():
        return None
    _say_assumed(file, warnings, np.flatnonzero(kept & assumed))
    from_sea = [e is not None and e.height is not None and not e.above_ellipsoid for e in frames.exif]
    what = "heights of EXIF (above sea level, by its standard)"
    _say_heights(warnings, frames.path.name, int((kept & np.array(from_sea)).sum()), what)
    lonlat[~kept] = np.where(np.isfinite(lonlat[~kept]), lonlat[~kept], 0.0)
    lonlat = _with_heights(file, lonlat, str(frames.path))
    position = _geodetic(file, lonlat)
    _say_whole_seconds(frames, position, sigma, np.flatnonzero(kept), warnings)
    frame = np.arange(len(kept))
    return in_time(frame, frames.t, position, sigma, kept, _level_axes(file, position), common=True)


def place_of(exif: Exif | None, xmp: Xmp | None) -> tuple[tuple[float, float, float], bool]:
    """Longitude, latitude (degrees), height of a photograph, NaN where missing; whether a sign was XMP's."""
    if exif is None or exif.longitude_deg is None or exif.latitude_deg is None:
        return (np.nan, np.nan, np.nan), False
    lon, lat = exif.longitude_deg, exif.latitude_deg
    turned = False
    if xmp is not None and xmp.longitude_deg is not None and xmp.latitude_deg is not None:
        turned = lon * xmp.longitude_deg < 0.0 or lat * xmp.latitude_deg < 0.0
        if turned:
            lon, lat = np.copysign(lon, xmp.longitude_deg), np.copysign(lat, xmp.latitude_deg)
    return (float(lon), float(lat), np.nan if exif.height is None else exif.height), turned
