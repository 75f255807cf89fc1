"""CCSDS orbit ephemeris messages (OEM, 502.0-B) read and written, attitude ephemeris messages (AEM) written.

Times become seconds from the epoch, axes are those of the message.

Not here: the form of messages (``ccsds_message.py``), attitudes read (``ccsds_attitude.py``), other axes
(``geometry/earth_orientation.py``), CSV tables (``tables.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, InputError, printable, reads, shortened
from sightline.io.formats.ccsds_message import (
    Clock,
    Message,
    Row,
    Segment,
    TimedRows,
    check_alike,
    check_interpolation,
    check_keys,
    chosen,
    clock_of,
    kinds_within,
    known_axes,
    message_kind,
    read_message,
    timed_numbers,
    useable_span,
)
from sightline.io.formats.instants import utc_text
from sightline.writing import creation_date, whole

Array = NDArray[np.float64]

#: Characters that a name in a message has at most.
_LONGEST_NAME = 80
_NEEDED = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "START_TIME", "STOP_TIME")
_KNOWN = (
    "REF_FRAME_EPOCH",
    "USEABLE_START_TIME",
    "USEABLE_STOP_TIME",
    "INTERPOLATION",
    "INTERPOLATION_DEGREE",
)
#: Numbers of a data line: place and velocity, with acceleration or without.
_COUNTS = (6, 9)
#: Share of the largest by which an eigenvalue of scaled covariances may lie below 0: eight written digits.
_NEGATIVE = 1e-6


@dataclass(frozen=True, eq=False)
class OrbitEphemeris:
    """An OEM as arrays.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    position : (N, 3)
        m.
    velocity : (N, 3)
        m/s.
    axes : str
        A key of ``AXES`` of ``geometry/earth_orientation.py``, or a name of axes fixed to another body.
    centre : str
        The body they are about.
    time_scale : str
        Of the message.
    useable : (first, last)
        s; rows beyond serve interpolation alone.
    sigma : float or None
        m per axis; of the covariance nearest to the middle of the images.
    segments : int
        How many were joined.
    """

    t: Array
    position: Array
    velocity: Array
    axes: str = "ITRF"
    centre: str = "EARTH"
    time_scale: str = "UTC"
    useable: tuple[float, float] = (-np.inf, np.inf)
    sigma: float | None = None
    segments: int = 1


def is_ccsds(path: Path, *kinds: str) -> str | None:
    """Which of the kinds ("OEM", ...) of CCSDS messages a file is; FormatError if it is of another one.

    A file that is no CCSDS message (a CSV table) gives None.
    """
    found = message_kind(path)
    if found == "NDM":
        within = kinds_within(path)
        allowed = sorted({kind for kind in within if kind in kinds})
        if len(allowed) == 1:
            return allowed[0]
        raise FormatError(
            f"{path}: is an NDM of {', '.join(within) or 'no message'}; one {' or '.join(kinds)} is needed "
            "here: write it into a file of its own"
        )
    if found is not None and found not in kinds:
        raise FormatError(f"{path}: is a CCSDS {found[:20]}; {' or '.join(kinds)} is needed here")
    return found


def need_epoch(path: Path, epoch: str | None) -> str:
    """The epoch, which a CCSDS message cannot do without."""
    if epoch is None:
        raise FormatError(
            f'{path}: its times are UTC and [acquisition] has no epoch; add epoch = "..." (UTC of t = 0)'
        )
    return epoch


def no_ut1(t: float) -> float:
    """UT1 - UTC where nothing is known of the Earth's rotation: 0 s."""
    return 0.0 * t


@reads("a CCSDS OEM")
def read_oem(
    path: Path,
    epoch: str,
    *,
    span: tuple[float, float] | None = None,
    ut1_less_utc: Callable[[float], float] = no_ut1,
) -> OrbitEphemeris:
    """Positions and velocities of an orbit ephemeris message.

    Parameters
    ----------
    path : Path
        An OEM, version 1 to 3, in KVN or XML, compressed or not.
    epoch : str
        UTC of t = 0.
    span : (first, last), optional
        s; of the images: the segment that covers it is taken, else those that do so together.
    ut1_less_utc : callable, optional
        UT1 - UTC (s) at t (s), for messages whose time scale is UT1.

    Returns
    -------
    OrbitEphemeris
        In the axes of the message; kilometres have become metres.

    Raises
    ------
    FormatError
        For what the standard does not allow, and for axes and time scales that are not known.
    """
    message = read_message(path, "OEM")
    for segment in message.segments:
        check_keys(message, segment, _NEEDED, (*_KNOWN, "MESSAGE_ID"))
    clock = clock_of(message, epoch, ut1_less_utc)
    for key in ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME"):
        check_alike(message, key)
    sigmas: list[tuple[float, float]] = []
    parts = [_part(message, segment, clock, sigmas) for segment in message.segments]
    part, count = chosen(message, parts, span)
    middle = 0.5 * sum(span) if span is not None else 0.5 * float(part.t[0] + part.t[-1])
    return OrbitEphemeris(
        part.t, part.values[:, :3] * 1e3, part.values[:, 3:] * 1e3, part.axes,
        message.segments[0].meta["CENTER_NAME"], clock.scale, part.useable,
        min(sigmas, key=lambda known: abs(known[0] - middle))[1] if sigmas else None, count,
    )  # fmt: skip


def _part(message: Message, segment: Segment, clock: Clock, sigmas: list[tuple[float, float]]) -> TimedRows:
    """The table of a segment; sigmas of its covariances (s, m) are appended."""
    meta = segment.meta
    axes = known_axes(message, segment.line, "REF_FRAME", meta["REF_FRAME"])
    if "REF_FRAME_EPOCH" in meta and axes in ("TOD", "MOD", "TEME", "CIRS"):
        raise FormatError(
            f"{message.at(segment.line)}: REF_FRAME = {meta['REF_FRAME']} of one REF_FRAME_EPOCH is not "
            "handled, "
            "only of date; export it in EME2000 or ITRF"
        )
    check_interpolation(message, segment, "INTERPOLATION")
    useable = useable_span(message, segment, clock)
    rows, blocks = _split(message, segment)
    sigmas += [_position_sigma(message, block, clock) for block in blocks]
    return TimedRows(useable, *timed_numbers(message, segment, rows, _COUNTS, clock), axes)


def _split(message: Message, segment: Segment) -> tuple[list[Row], list[list[Row]]]:
    """Data lines, and the lines of each covariance, from its EPOCH on."""
    rows: list[Row] = []
    blocks: list[list[Row]] = []
    inside = False
    for line, text in segment.rows:
        if text in ("COVARIANCE_START", "COVARIANCE_STOP"):
            if inside == text.endswith("START"):
                raise FormatError(f"{message.at(line)}: {text} without the other one before it")
            inside = not inside
        elif not inside:
            rows.append((line, text))
        elif text.replace(" ", "").startswith("EPOCH="):
            blocks.append([(line, text)])
        elif not blocks:
            raise FormatError(f"{message.at(line)}: a covariance begins with EPOCH = ...; got {text[:60]!r}")
        else:
            blocks[-1].append((line, text))
    if inside:
        raise FormatError(
            f"{message.path}: ends within covariances: COVARIANCE_STOP is missing; the file was cut"
        )
    return rows, blocks


def _position_sigma(message: Message, block: list[Row], clock: Clock) -> tuple[float, float]:
    """Time (s) of a covariance and the rms position sigma per axis (m), whatever its axes."""
    line, text = block[0]
    t = clock.seconds(text.partition("=")[2].strip(), f"{message.at(line)}: EPOCH")
    rows = [row for row in block[1:] if not row[1].startswith("COV_REF_FRAME")]
    matrix = np.zeros((6, 6))
    if [len(row[1].split()) for row in rows] != [1, 2, 3, 4, 5, 6]:
        raise FormatError(
            f"{message.at(line)}: a covariance is 6 lines of 1 to 6 numbers, the lower triangle; got lines "
            "of "
            f"{', '.join(str(len(row[1].split())) for row in rows[:8]) or 'nothing'}"
        )
    for k, (place, cells) in enumerate(rows):
        try:
            matrix[k, : k + 1] = [float(cell) for cell in cells.split()]
        except ValueError:
            raise FormatError(f"{message.at(place)}: {cells[:80]!r} are not numbers") from None
    matrix += np.tril(matrix, -1).T
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    if (
        not np.isfinite(matrix).all()
        or np.any(np.diag(matrix) < 0.0)
        or (np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] < -6.0 * _NEGATIVE)
    ):
        raise FormatError(
            f"{message.at(line)}: the covariance is not positive: a variance is below 0 or a correlation "
            "beyond 1; "
            "remove the block, or correct it"
        )
    return t, 1e3 * float(np.sqrt(np.mean(np.diag(matrix)[:3])))


def write_aem(
    path: Path,
    t: Array,
    quat_xyzw: Array,
    epoch: str,
    *,
    object_name: str = "UNKNOWN",
    object_id: str = "0000-000A",
    frame: str = "ITRF",
    centre: str = "EARTH",
    originator: str = "SIGHTLINE",
) -> None:
    """An attitude ephemeris message, KVN, version 1.0, scalar last.

    Parameters
    ----------
    path : Path
        Written complete or not at all.
    t : (N,)
        s from the epoch, increasing.
    quat_xyzw : (N, 4)
        world_from_body, scalar last.
    epoch : str
        UTC of t = 0.
    object_name, object_id, frame, centre, originator : str
        Metadata; `frame` is the name of the world axes, `centre` the body they are fixed to.

    Notes
    -----
    Written from the world (frame A) to the body (frame B), direction A2B, so that the four numbers of a
    line are those of world_from_body; see `read_aem`. Times are rounded to the nanosecond.
    """
    if len(t) != len(quat_xyzw) or not len(t):
        raise InputError(
            f"{len(t)} times and {len(quat_xyzw)} quaternions were given; one of each per line is needed"
        )
    header = [
        *_header("AEM", "1.0", originator, object_name, object_id, centre),
        f"REF_FRAME_A = {frame}",
        "REF_FRAME_B = SC_BODY_1",
        "ATTITUDE_DIR = A2B",
        *_span([utc_text(float(instant), epoch) for instant in (t[0], t[-1])]),
        "ATTITUDE_TYPE = QUATERNION",
        "QUATERNION_TYPE = LAST",
        "META_STOP",
        "",
        "DATA_START",
    ]
    with whole(path) as draft, draft.open("w", encoding="utf-8") as stream:
        stream.write("\n".join(header) + "\n")
        for instant, quaternion in zip(t, np.asarray(quat_xyzw), strict=True):
            words = "".join(f" {value:.16f}" for value in quaternion.tolist())
            stream.write(utc_text(float(instant), epoch) + words + "\n")
        stream.write("DATA_STOP\n")


def write_oem(
    path: Path,
    t: Array,
    position: Array,
    velocity: Array,
    epoch: str,
    *,
    object_name: str = "UNKNOWN",
    object_id: str = "0000-000A",
    frame: str = "ITRF",
    centre: str = "EARTH",
    originator: str = "SIGHTLINE",
) -> None:
    """An orbit ephemeris message, KVN, version 2.0.

    Parameters
    ----------
    path : Path
        Written complete or not at all.
    t : (N,)
        s from the epoch, increasing.
    position, velocity : (N, 3)
        m and m/s, in the axes `frame`, relative to them.
    epoch : str
        UTC of t = 0.
    object_name, object_id, frame, centre, originator : str
        Metadata; of another body as ``frame="IAU_MARS", centre="MARS"``.

    Notes
    -----
    Times are rounded to the nanosecond, positions to the nanometre, velocities to the femtometre per second.
    """
    if not len(t) == len(position) == len(velocity) or not len(t):
        raise InputError(
            f"{len(t)} times, {len(position)} positions and {len(velocity)} velocities were given; one of "
            "each per "
            "row is needed"
        )
    stamps = [utc_text(float(instant), epoch) for instant in t]
    header = [
        *_header("OEM", "2.0", originator, object_name, object_id, centre),
        f"REF_FRAME = {frame}",
        *_span(stamps),
        "META_STOP",
        "",
    ]
    rows = np.column_stack([position, velocity]) * 1e-3
    with whole(path) as draft, draft.open("w", encoding="utf-8") as stream:
        stream.write("\n".join(header) + "\n")
        for stamp, row in zip(stamps, rows.tolist(), strict=True):
            place = "".join(f" {value:.12f}" for value in row[:3])
            stream.write(stamp + place + "".join(f" {value:.18f}" for value in row[3:]) + "\n")


def _header(kind: str, version: str, originator: str, name: str, number: str, centre: str) -> list[str]:
    """The first lines of a message, as far as its messages are alike."""
    return [
        f"CCSDS_{kind}_VERS = {version}",
        f"CREATION_DATE = {creation_date():%Y-%m-%dT%H:%M:%S}",
        f"ORIGINATOR = {originator}",
        "",
        "META_START",
        f"OBJECT_NAME = {shortened(printable(name), _LONGEST_NAME)}",
        f"OBJECT_ID = {number}",
        f"CENTER_NAME = {centre}",
    ]


def _span(stamps: list[str]) -> list[str]:
    """The lines of the metadata that say of which instants a message is."""
    return ["TIME_SYSTEM = UTC", f"START_TIME = {stamps[0]}", f"STOP_TIME = {stamps[-1]}"]
