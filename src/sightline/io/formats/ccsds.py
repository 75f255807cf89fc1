"""CCSDS orbit and attitude messages in keyword = value notation (KVN).

OEM (orbit ephemeris, CCSDS 502.0-B) read; AEM (attitude ephemeris, CCSDS 504.0-B) read and
written, quaternions only. Times are UTC and become seconds from the epoch.

Not here: CSV tables (``tables.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.access import check_file, read_text
from sightline.errors import FormatError, InputError, foreign_errors, printable, reads, shortened
from sightline.io.formats.tables import check_quaternions, check_times
from sightline.writing import creation_date, whole

Array = NDArray[np.float64]

#: Reference frames that turn with the Earth; others need an Earth-rotation model and are refused.
EARTH_FIXED_FRAMES = ("EARTH_FIXED", "ECEF", "ITRF", "ITRS", "TDR", "WGS84", "EFG")
#: Years in which images are taken: the oldest photographs of land from above are of 1858.
FIRST_YEAR, LAST_YEAR = 1850, 2200
#: Characters that a name in a message has at most.
_LONGEST_NAME = 80
#: Names for the axes of our body in an attitude message.
BODY_FRAMES = ("SC_BODY", "BODY", "SC_BODY_1", "SPACECRAFT_BODY")
#: Bytes in which the first line of a message is looked for.
_HEAD = 65536


@dataclass(frozen=True, eq=False)
class OrbitEphemeris:
    """An OEM as arrays.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    position : (N, 3)
        m, Earth-fixed.
    velocity : (N, 3)
        m/s, Earth-fixed.
    """

    t: Array
    position: Array
    velocity: Array


@dataclass(frozen=True, eq=False)
class AttitudeEphemeris:
    """An AEM as arrays.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    quat_xyzw : (N, 4)
        world_from_body, scalar last.
    """

    t: Array
    quat_xyzw: Array


def epoch_words(epoch: str | None) -> str:
    """When t = 0 is, in words; that a time without a zone is taken as UTC."""
    if epoch is None:
        return "no epoch"
    zoned = epoch.strip().endswith(("Z", "+00:00"))
    return f"t = 0 at {epoch}" + ("" if zoned else " (assumed: UTC, as it has no Z)")


def parse_utc(text: str, place: str) -> tuple[datetime, float]:
    """A UTC instant as whole seconds and the fraction that datetime would cut at a microsecond.

    Parameters
    ----------
    text : str
        ISO 8601, calendar (2026-01-31T...) or ordinal (2026-031T...), with or without Z.
    place : str
        Named in messages.

    Returns
    -------
    whole : datetime
    fraction : float
        s, 0 <= fraction < 1.
    """
    body, dot, digits = text.strip().removesuffix("Z").removesuffix("+00:00").partition(".")
    for form in ("%Y-%m-%dT%H:%M:%S", "%Y-%jT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M", "%Y-%m-%d"):
        try:
            whole = datetime.strptime(body, form).replace(tzinfo=UTC)
        except ValueError:
            continue
        if not FIRST_YEAR <= whole.year <= LAST_YEAR:
            raise FormatError(
                f"{place}: {text!r} is an instant of the year {whole.year}; images are of {FIRST_YEAR} to "
                f"{LAST_YEAR}"
            )
        if not dot or digits.isdigit():
            return whole, float(f"0.{digits or 0}")
    raise FormatError(f"{place}: {text[:80]!r} is not a UTC instant; write it like 2026-01-31T12:00:00.123Z")


def seconds_from_epoch(text: str, epoch: str, place: str) -> float:
    """Seconds from `epoch` to the instant `text` (both UTC, no leap second counted)."""
    whole, fraction = parse_utc(text, place)
    start, start_fraction = parse_utc(epoch, "epoch")
    return (whole - start).total_seconds() + (fraction - start_fraction)


def utc_text(t: float, epoch: str) -> str:
    """The instant `t` seconds after `epoch`, to the nanosecond, as CCSDS writes it."""
    start, fraction = parse_utc(epoch, "epoch")
    nanoseconds = round((t + fraction) * 1e9)
    whole = start + timedelta(seconds=nanoseconds // 1_000_000_000)
    return f"{whole:%Y-%m-%dT%H:%M:%S}.{nanoseconds % 1_000_000_000:09d}"


def need_epoch(path: Path, epoch: str | None) -> str:
    """The epoch, which a CCSDS message cannot do without."""
    if epoch is None:
        raise FormatError(
            f'{path}: its times are UTC and [acquisition] has no epoch; add epoch = "..." (UTC of t = 0)'
        )
    return epoch


def is_ccsds(path: Path, kind: str) -> bool:
    """Whether the file is a CCSDS message of `kind` ("OEM", "AEM"); FormatError if it is of another kind.

    A file that is not CCSDS at all (a CSV table) gives False.
    """
    check_file(path, "check the name in the TOML file")
    with foreign_errors(path, "cannot be read", "a table or a CCSDS message is expected"):
        with path.open("rb") as stream:
            lines = stream.read(_HEAD).decode("utf-8", "replace").lstrip("\ufeff").splitlines()
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first.startswith("CCSDS_"):
        if first.startswith("<?xml"):
            raise FormatError(f"{path}: XML messages are not read; write it as KVN (keyword = value)")
        return False
    found = first.split("=")[0].strip().removeprefix("CCSDS_").removesuffix("_VERS")
    if found != kind:
        raise FormatError(f"{path}: is a CCSDS {found}; {kind} is needed here")
    return True


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines without comments and blank ones."""
    text = read_text(path, "a CCSDS message in KVN")
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if stripped and not stripped.startswith("COMMENT"):
            yield number, stripped


def _segments(path: Path) -> Iterator[tuple[dict[str, str], list[tuple[int, list[str]]]]]:
    """Metadata and data rows of every segment of a message."""
    meta: dict[str, str] | None = None
    rows: list[tuple[int, list[str]]] = []
    inside, skip = False, False
    for number, line in _lines(path):
        if line == "META_START":
            if meta is not None:
                yield meta, rows
            meta, rows, inside = {}, [], True
        elif line == "META_STOP":
            inside = False
        elif line in ("DATA_START", "DATA_STOP"):
            continue
        elif line in ("COVARIANCE_START", "COVARIANCE_STOP"):
            skip = line == "COVARIANCE_START"
        elif inside and meta is not None:
            key, equals, value = line.partition("=")
            if not equals:
                raise FormatError(f"{path}: line {number}: {line!r} is not KEYWORD = value")
            meta[key.strip()] = value.strip()
        elif meta is not None and not skip:
            rows.append((number, line.split()))
    if meta is None:
        raise FormatError(f"{path}: has no META_START; a CCSDS ephemeris message in KVN is expected")
    yield meta, rows


def _numeric(path: Path, rows: list[tuple[int, list[str]]], count: int, epoch: str) -> tuple[Array, Array]:
    """Times (N,) s and the `count` numbers after each time, (N, count)."""
    times, values = np.empty(len(rows)), np.empty((len(rows), count))
    for k, (number, cells) in enumerate(rows):
        if len(cells) < count + 1:
            raise FormatError(
                f"{path}: line {number} holds {len(cells)} values; an instant and {count} numbers are "
                f"expected"
            )
        times[k] = seconds_from_epoch(cells[0], epoch, f"{path}: line {number}")
        try:
            values[k] = [float(cell) for cell in cells[1 : count + 1]]
        except ValueError:
            raise FormatError(f"{path}: line {number}: {' '.join(cells[1:])!r} are not numbers") from None
    if not len(rows):
        raise FormatError(f"{path}: a segment without data; at least one row is needed")
    if not np.isfinite(values).all():
        raise FormatError(
            f"{path}: line {rows[int(np.argmin(np.isfinite(values).all(axis=1)))][0]}: not a finite number"
        )
    return times, values


def _join(path: Path, parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Segments one after the other; an instant that ends one and starts the next is kept once."""
    times, values = parts[0]
    for t, v in parts[1:]:
        skip = int(np.searchsorted(t, times[-1], side="right"))
        times, values = np.concatenate([times, t[skip:]]), np.concatenate([values, v[skip:]])
    check_times(path, times, "epoch")
    return times, values


def _require(path: Path, meta: dict[str, str], key: str, allowed: tuple[str, ...], hint: str) -> None:
    """FormatError unless a metadata keyword has one of the values we handle."""
    given = meta.get(key)
    if given is None:
        raise FormatError(f"{path}: metadata keyword {key} is missing; allowed: {', '.join(allowed)}")
    if not any(given.upper().startswith(name) for name in allowed):
        raise FormatError(f"{path}: {key} = {given} is not handled; allowed: {', '.join(allowed)}; {hint}")


@reads("a CCSDS OEM")
def read_oem(path: Path, epoch: str) -> OrbitEphemeris:
    """Positions and velocities of an orbit ephemeris message.

    Parameters
    ----------
    path : Path
        An OEM in KVN, Earth-fixed axes (ITRF), UTC; several segments are joined.
    epoch : str
        UTC of t = 0.

    Returns
    -------
    OrbitEphemeris
        Kilometres have become metres.

    Raises
    ------
    FormatError
        For inertial axes or other time systems; the message says what to convert.
    """
    parts = []
    for meta, rows in _segments(path):
        _require(path, meta, "REF_FRAME", EARTH_FIXED_FRAMES, "convert the orbit to ITRF first")
        _require(path, meta, "TIME_SYSTEM", ("UTC",), "convert the times to UTC first")
        parts.append(_numeric(path, rows, 6, epoch))
    t, state = _join(path, parts)
    return OrbitEphemeris(t, state[:, :3] * 1e3, state[:, 3:] * 1e3)


@reads("a CCSDS AEM")
def read_aem(path: Path, epoch: str) -> AttitudeEphemeris:
    """Attitudes of an attitude ephemeris message.

    Parameters
    ----------
    path : Path
        An AEM in KVN, version 1 or 2, quaternions between Earth-fixed and spacecraft-body axes, UTC.
    epoch : str
        UTC of t = 0.

    Returns
    -------
    AttitudeEphemeris
        world_from_body, scalar last, whatever order and direction the message uses.

    Notes
    -----
    CCSDS 504.0-B: the quaternion describes the rotation from frame A to frame B and turns the
    *components* of a vector from A into B: v_B = M(q) v_A with the passive matrix, which is scipy's
    ``Rotation(q).inv()``. With A the body and B the Earth that is earth_from_body = Rotation(q).inv(),
    and with A the Earth and B the body, earth_from_body = Rotation(q).
    """
    parts = []
    for meta, rows in _segments(path):
        _require(path, meta, "TIME_SYSTEM", ("UTC",), "convert the times to UTC first")
        _require(path, meta, "ATTITUDE_TYPE", ("QUATERNION",), "export the attitude as quaternions")
        t, values = _numeric(path, rows, 4, epoch)
        if meta.get("QUATERNION_TYPE", "LAST").upper() == "FIRST":
            values = values[:, [1, 2, 3, 0]]
        if not _earth_to_body(path, meta):
            values = values * [-1.0, -1.0, -1.0, 1.0]
        parts.append((t, values))
    t, quat_xyzw = _join(path, parts)
    return AttitudeEphemeris(t, check_quaternions(path, quat_xyzw))


def _earth_to_body(path: Path, meta: dict[str, str]) -> bool:
    """Whether the quaternion goes from Earth-fixed axes (A) to the body (B); FormatError for other frames."""
    first, second = meta.get("REF_FRAME_A", "").upper(), meta.get("REF_FRAME_B", "").upper()
    if meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A":
        first, second = second, first
    earth = [any(frame.startswith(name) for name in EARTH_FIXED_FRAMES) for frame in (first, second)]
    body = [any(frame.startswith(name) for name in BODY_FRAMES) for frame in (first, second)]
    if (earth[0] and body[1]) or (body[0] and earth[1]):
        return earth[0]
    raise FormatError(
        f"{path}: attitude from {first or '(nothing)'} to {second or '(nothing)'}; one must be Earth-fixed "
        f"({', '.join(EARTH_FIXED_FRAMES)}) and the other the body ({', '.join(BODY_FRAMES)}); convert it "
        f"first"
    )


def write_aem(
    path: Path,
    t: Array,
    quat_xyzw: Array,
    epoch: str,
    *,
    object_name: str = "UNKNOWN",
    object_id: str = "0000-000A",
    frame: str = "ITRF",
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
    object_name, object_id, frame, originator : str
        Metadata; `frame` is the name of the world axes.

    Notes
    -----
    Written from the world (frame A) to the body (frame B), direction A2B, so that the four numbers of a
    line are those of world_from_body; see `read_aem`. Times are rounded to the nanosecond.
    """
    if len(t) != len(quat_xyzw) or not len(t):
        raise InputError(
            f"{len(t)} times and {len(quat_xyzw)} quaternions were given; one of each per line is needed"
        )
    stamps = [utc_text(float(instant), epoch) for instant in t]
    header = [
        "CCSDS_AEM_VERS = 1.0",
        f"CREATION_DATE = {creation_date():%Y-%m-%dT%H:%M:%S}",
        f"ORIGINATOR = {originator}",
        "",
        "META_START",
        f"OBJECT_NAME = {shortened(printable(object_name), _LONGEST_NAME)}",
        f"OBJECT_ID = {object_id}",
        f"REF_FRAME_A = {frame}",
        "REF_FRAME_B = SC_BODY_1",
        "ATTITUDE_DIR = A2B",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}",
        f"STOP_TIME = {stamps[-1]}",
        "ATTITUDE_TYPE = QUATERNION",
        "QUATERNION_TYPE = LAST",
        "META_STOP",
        "",
        "DATA_START",
    ]
    with whole(path) as draft, draft.open("w", encoding="utf-8") as stream:
        stream.write("\n".join(header) + "\n")
        for stamp, quaternion in zip(stamps, np.asarray(quat_xyzw).tolist(), strict=True):
            stream.write(stamp + "".join(f" {value:.16f}" for value in quaternion) + "\n")
        stream.write("DATA_STOP\n")
