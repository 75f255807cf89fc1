"""SBET: the smoothed best estimate of an aircraft's trajectory, as Applanix POSPac writes it.

Records of 17 little-endian doubles: time (s of the GPS week), latitude, longitude (rad), height above the
ellipsoid (m), velocities (3, m/s), roll, pitch, platform heading, wander angle (rad), accelerations (3) and
rates (3) of the body. True heading is platform heading less wander angle. The file has no header and names
no week. Sources: PDAL, ``readers.sbet``; LiDAR360, "OUT File", after Applanix's guide to POSPac.

Not here: orbits and attitudes of spacecraft (``ccsds.py``), the axes of ``[world]``.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import LARGE, check_file, read_bytes
from sightline.errors import FormatError, foreign_errors, reads
from sightline.geometry.earth import from_geodetic, local_axes
from sightline.io.formats.instants import parse_utc, tai_offset

Array = NDArray[np.float64]

_RECORD = np.dtype(("<f8", 17))
_TIME, _LATITUDE, _LONGITUDE, _HEIGHT, _NORTH, _EAST, _ROLL, _PITCH, _HEADING, _WANDER = (
    0,
    1,
    2,
    3,
    4,
    5,
    7,
    8,
    9,
    10,
)
#: Names of what is used, for messages, and the largest size that each may have; s, rad, m.
_LIMITS = {
    _TIME: ("time", 2 * 604800.0),
    _LATITUDE: ("latitude", np.pi / 2.0),
    _LONGITUDE: ("longitude", 2.0 * np.pi),
    _HEIGHT: ("height", 1e5),
    _ROLL: ("roll", 2.0 * np.pi),
    _PITCH: ("pitch", np.pi / 2.0),
    _HEADING: ("heading", 4.0 * np.pi),
    _WANDER: ("wander angle", 2.0 * np.pi),
}
#: No value of a record is as large, even where its units are others than they should be.
_LARGEST = 1e8
#: Nor is it 0 by as little: text in 16 bits, and the numbers of a raster, make such doubles.
_SMALLEST = 1e-30
_WEEK = 604800.0
_GPS_BEGAN = datetime(1980, 1, 6, tzinfo=UTC)
#: GPS time less TAI, s.
_GPS_LESS_TAI = -19
#: s by which rows are kept beyond the images: some steps even at 1 Hz.
_MARGIN = 10.0
#: m/s above which the course is that of the positions; rad that it may lie beside that of the velocities.
_MOVING, _COURSE = 5.0, 0.02
#: rad from which on a wander angle matters.
_TURNED = 1e-4
#: North, east, down in east, north, up.
_ENU_FROM_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class SmoothedTrajectory:
    """Positions and attitudes of a SBET.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    position : (N, 3)
        m, Earth-fixed.
    fixed_from_body : Rotation
        N rotations; body x forward, y right, z down.
    words : str
        What was understood.
    doubt : str
        What contradicts; empty where nothing does.
    """

    t: Array
    position: Array
    fixed_from_body: Rotation
    words: str
    doubt: str = ""


def is_sbet(path: Path) -> bool:
    """Whether a file begins with a record of a SBET.

    Raises
    ------
    FormatError
        If it cannot be opened, or is a SBET most byte first.
    """
    check_file(path, "check the name in the TOML file")
    with foreign_errors(path, "cannot be read", "a table, a message or a SBET is expected"):
        with path.open("rb") as stream:
            head = stream.read(_RECORD.itemsize)
    # text has none of these, and the doubles that its letters make may be small
    if len(head) < _RECORD.itemsize or not any(byte < 9 for byte in head):
        return False
    row = np.frombuffer(head, _RECORD)[0]
    if _is_record(row):
        return True
    if _is_record(row.byteswap()) and _wrong(row.byteswap()[None]) is None:
        raise FormatError(
            f"{path}: is a SBET most byte first; least byte first is expected, as POSPac writes it: turn the "
            "8 bytes of every number round"
        )
    return False


def _is_record(row: Array) -> bool:
    """Whether 17 numbers may be a record."""
    size = np.abs(row)
    return bool(
        0.0 <= row[_TIME] <= _LIMITS[_TIME][1]
        and size.max() < _LARGEST
        and ((size == 0.0) | (size > _SMALLEST)).all()
    )


@reads("a SBET")
def read_sbet(path: Path, epoch: str | None, span: tuple[float, float] | None = None) -> SmoothedTrajectory:
    """Positions and attitudes of a SBET.

    Parameters
    ----------
    path : Path
    epoch : str or None
        UTC of t = 0; the file has no date of its own.
    span : (first, last), optional
        s from the epoch; rows about it are kept where there are such.

    Returns
    -------
    SmoothedTrajectory

    Raises
    ------
    FormatError
        If there is no epoch, the file is cut short, a value is impossible, times do not increase, or a
        wander angle is contradicted by the velocities.
    """
    if epoch is None:
        raise FormatError(
            f"{path}: its times are seconds of a GPS week, and there is no epoch; add "
            'epoch = "..." (UTC of t = 0)'
        )
    content = read_bytes(path, "a SBET", most=LARGE)
    count, rest = divmod(len(content), _RECORD.itemsize)
    if rest or not count:
        raise FormatError(
            f"{path}: holds {count} records of {_RECORD.itemsize} bytes and {rest} bytes more; it is cut "
            "short or no SBET; fetch it again"
        )
    rows = np.frombuffer(content, _RECORD).astype(np.float64)
    wrong = _wrong(rows)
    if wrong is not None:
        raise FormatError(f"{path}: record {wrong}; a SBET holds s, rad, m, m/s, least byte first")
    late = np.flatnonzero(np.diff(rows[:, _TIME]) <= 0.0)
    if late.size:
        raise FormatError(f"{path}: record {late[0] + 2}: its time does not follow that of the record before")
    middle = 0.5 * sum(span) if span is not None else 0.0
    t = _since(rows[:, _TIME], epoch, middle)
    if span is not None:
        kept = (t >= span[0] - _MARGIN) & (t <= span[1] + _MARGIN)
        if kept.sum() > 1:
            rows, t = rows[kept], t[kept]
    lon, lat = rows[:, _LONGITUDE], rows[:, _LATITUDE]
    position = from_geodetic(np.column_stack([lon, lat, rows[:, _HEIGHT]]))
    heading = rows[:, _HEADING] - rows[:, _WANDER]
    level_from_body = Rotation.from_euler("ZYX", np.column_stack([heading, rows[:, _PITCH], rows[:, _ROLL]]))
    return SmoothedTrajectory(
        t,
        position,
        local_axes(lon, lat) * _ENU_FROM_NED * level_from_body,
        f"a SBET of {count} records; its times are taken as GPS seconds of the week of the epoch, its places "
        "as WGS 84, neither of which it says",
        _courses(path, t, position, rows),
    )


def _wrong(rows: Array) -> str | None:
    """Which value (N, 17) is impossible, in words; None where none is."""
    for column, (name, most) in _LIMITS.items():
        odd = ~(np.abs(rows[:, column]) <= most)
        if column == _TIME:
            odd |= rows[:, column] < 0.0
        if odd.any():
            row = int(np.argmax(odd))
            return f"{row + 1}: {name} is {rows[row, column]:.6g}; up to {most:.6g} is possible"
    return None


def _since(seconds: Array, epoch: str, middle: float) -> Array:
    """t (s) of seconds of a GPS week: of the week in which the middle of the table is nearest to `middle`."""
    whole, fraction = parse_utc(epoch, "epoch")
    began = (whole - _GPS_BEGAN).total_seconds() + tai_offset(whole) + _GPS_LESS_TAI
    t = seconds - began % _WEEK - fraction
    beside = 0.5 * float(t[0] + t[-1]) - middle
    return np.asarray(t - _WEEK * np.round(beside / _WEEK))


def _courses(path: Path, t: Array, position: Array, rows: Array) -> str:
    """What is said where velocities do not lead along the positions.

    Raises
    ------
    FormatError
        If there is a wander angle too: which way it turns the heading is then contradicted.
    """
    if len(t) < 3:
        return ""
    level = local_axes(rows[:, _LONGITUDE], rows[:, _LATITUDE]).inv().apply(np.gradient(position, t, axis=0))
    moving = np.hypot(level[:, 0], level[:, 1]) > _MOVING
    if not moving.any():
        return ""
    stated = np.arctan2(rows[:, _EAST], rows[:, _NORTH]) - rows[:, _WANDER]
    apart = np.angle(np.exp(1j * (stated - np.arctan2(level[:, 0], level[:, 1])))[moving])
    beside = float(np.median(np.abs(apart)))
    if beside <= _COURSE:
        return ""
    words = f"velocities point {beside:.2g} rad beside the way of the positions"
    if np.abs(rows[:, _WANDER]).max() > _TURNED:
        raise FormatError(
            f"{path}: {words} (platform heading less wander angle is taken as true heading); export it with "
            "wander angle 0"
        )
    return f"{path.name}: {words}; they are not used, but are its headings from true north?"
