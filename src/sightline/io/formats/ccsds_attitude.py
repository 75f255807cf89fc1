"""CCSDS attitude messages read: AEM (ephemeris) and APM (one attitude, with its rate), 504.0-B-1 and -2.

Not here: the form of messages (``ccsds_message.py``), written ones (``ccsds.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, reads
from sightline.io.formats.ccsds import no_ut1
from sightline.io.formats.ccsds_message import (
    Message,
    Segment,
    TimedRows,
    check_alike,
    check_interpolation,
    check_keys,
    chosen,
    clock_of,
    known_axes,
    nearest,
    read_message,
    timed_numbers,
    useable_span,
)
from sightline.io.formats.tables import check_quaternions

Array = NDArray[np.float64]

#: Names for the axes of our body in an attitude message.
BODY_FRAMES = ("SC_BODY", "BODY", "SPACECRAFT_BODY")
#: Numbers per line of each type; quaternions and angles come first, derivatives and rates are read past.
_TYPES = {
    "QUATERNION": 4, "QUATERNION/DERIVATIVE": 8, "QUATERNION/RATE": 7, "QUATERNION/ANGVEL": 7,
    "EULER_ANGLE": 3, "EULER_ANGLE/RATE": 6, "EULER_ANGLE/DERIVATIVE": 6, "EULER_ANGLE/ANGVEL": 6,
}  # fmt: skip
_NEEDED = (
    "OBJECT_NAME", "OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "START_TIME", "STOP_TIME",
    "ATTITUDE_TYPE",
)  # fmt: skip
_KNOWN = (
    "CENTER_NAME", "ATTITUDE_DIR", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "QUATERNION_TYPE",
    "EULER_ROT_SEQ", "RATE_FRAME", "ANGVEL_FRAME", "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE",
    "MESSAGE_ID",
)  # fmt: skip
#: An attitude of one instant serves images so many s from it; it is written out in such steps (s).
_APM_REACH, _APM_STEP = 600.0, 1.0
#: Metadata of an APM, which need no marks about them.
_APM_META = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "TIME_SYSTEM")
#: Rates of an APM by how their keywords begin, the blocks of version 2 left out, or end.
_APM_RATES, _DOT = ("ANGVEL_X", "X_RATE", "Y_RATE", "Z_RATE"), "_DOT"


@dataclass(frozen=True, eq=False)
class AttitudeEphemeris:
    """Attitudes of a message as arrays.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    quat_xyzw : (N, 4)
        From body axes to `axes`, scalar last.
    axes : str
        A key of ``AXES`` of ``geometry/earth_orientation.py``, or a name of axes fixed to another body.
    centre : str
        Of the message; empty where it gives none.
    time_scale : str
    useable : (first, last)
        s.
    segments : int
        How many were joined.
    words : str
        What was assumed of it.
    """

    t: Array
    quat_xyzw: Array
    axes: str = "ITRF"
    centre: str = ""
    time_scale: str = "UTC"
    useable: tuple[float, float] = (-np.inf, np.inf)
    segments: int = 1
    words: str = ""


@reads("a CCSDS AEM")
def read_aem(
    path: Path,
    epoch: str,
    *,
    span: tuple[float, float] | None = None,
    ut1_less_utc: Callable[[float], float] = no_ut1,
) -> AttitudeEphemeris:
    """Attitudes of an attitude ephemeris message.

    Parameters
    ----------
    path : Path
        An AEM, version 1 or 2, in KVN or XML, compressed or not; quaternions or Euler angles.
    epoch : str
        UTC of t = 0.
    span : (first, last), optional
        s; of the images: the segment that covers it is taken, else those that do so together.
    ut1_less_utc : callable, optional
        UT1 - UTC (s) at t (s), for messages whose time scale is UT1.

    Returns
    -------
    AttitudeEphemeris
        From body axes to those of the message, whatever order and direction it uses.

    Notes
    -----
    CCSDS 504.0-B: the quaternion describes the rotation from frame A to frame B and turns the
    *components* of a vector from A into B: v_B = M(q) v_A with the passive matrix, which is scipy's
    ``Rotation(q).inv()``. With A the body and B the Earth that is earth_from_body = Rotation(q).inv(),
    and with A the Earth and B the body, earth_from_body = Rotation(q). Euler angles are given in the order of
    their sequence (3.2.5.4.4), and are turns of the axes, one after the other.
    """
    message = read_message(path, "AEM")
    for segment in message.segments:
        check_keys(message, segment, _NEEDED, _KNOWN)
    for key in ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME"):
        check_alike(message, key)
    clock = clock_of(message, epoch, ut1_less_utc)
    parts = []
    for segment in message.segments:
        kind = _type_of(message, segment)
        check_interpolation(message, segment, "INTERPOLATION_METHOD")
        useable = useable_span(message, segment, clock)
        rows = [row for row in segment.rows if row[1] not in ("DATA_START", "DATA_STOP")]
        marks = [row[1] for row in segment.rows if row[1] in ("DATA_START", "DATA_STOP")]
        if marks != ["DATA_START", "DATA_STOP"]:
            raise FormatError(
                f"{message.at(segment.line)}: its data are not between one DATA_START and one DATA_STOP; "
                "the file was cut, or is damaged"
            )
        t, values = timed_numbers(message, segment, rows, (_TYPES[kind],), clock)
        axes, to_body = _ends(message, segment.line, segment.meta, message.version)
        parts.append(TimedRows(useable, t, _quaternions(message, segment, kind, values, to_body), axes))
    part, count = chosen(message, parts, span)
    return AttitudeEphemeris(
        part.t, check_quaternions(path, part.values), part.axes,
        message.segments[0].meta.get("CENTER_NAME", ""), clock.scale, part.useable, count,
    )  # fmt: skip


def _type_of(message: Message, segment: Segment) -> str:
    """ATTITUDE_TYPE, with its words parted by / alone."""
    kind = segment.meta["ATTITUDE_TYPE"].upper().replace("EULER ANGLE", "EULER_ANGLE").replace(" ", "")
    if kind.startswith("SPIN"):
        raise FormatError(
            f"{message.at(segment.line)}: ATTITUDE_TYPE = {kind[:40]} is not handled: it does not say "
            'which axis of the body spins; export quaternions, or use [platform] kind = "spin"'
        )
    if kind not in _TYPES:
        raise FormatError(
            f"{message.at(segment.line)}: ATTITUDE_TYPE = {kind[:40]} is not "
            f"handled{nearest(kind, list(_TYPES))}; allowed: {', '.join(_TYPES)}"
        )
    return kind


def _quaternions(message: Message, segment: Segment, kind: str, values: Array, to_body: bool) -> Array:
    """Quaternions (N, 4) from body axes, scalar last, of data lines."""
    if kind.startswith("EULER"):
        sequence = euler_sequence(message, segment.line, segment.meta.get("EULER_ROT_SEQ"))
        quaternions = Rotation.from_euler(sequence, values[:, :3], degrees=True).as_quat()
    else:
        order = segment.meta.get("QUATERNION_TYPE", "LAST").upper()
        if order not in ("FIRST", "LAST"):
            raise FormatError(
                f"{message.at(segment.line)}: QUATERNION_TYPE = {order[:20]} is not known; allowed: FIRST, "
                "LAST (where the scalar stands)"
            )
        quaternions = values[:, [1, 2, 3, 0] if order == "FIRST" else [0, 1, 2, 3]]
        # the length of each is checked of all together, when rows of segments are joined
    return np.asarray(quaternions if to_body else quaternions * [-1.0, -1.0, -1.0, 1.0])


def euler_sequence(message: Message, line: int, given: str | None) -> str:
    """EULER_ROT_SEQ, as 312 or ZXY, as scipy calls turns about turned axes: ``"ZXY"``."""
    name = (given or "").upper().translate(str.maketrans("123", "XYZ"))
    if len(name) != 3 or set(name) - set("XYZ") or name[0] == name[1] or name[1] == name[2]:
        raise FormatError(
            f"{message.at(line)}: EULER_ROT_SEQ = {(given or '(nothing)')[:20]} is no sequence of three "
            "turns; write it like 312 or ZXY, no axis twice in a row"
        )
    return name


def _ends(message: Message, line: int, meta: dict[str, str], version: str) -> tuple[str, bool]:
    """The axes that are not the body's, and whether the rotation goes from them to the body."""
    frames = [meta.get("REF_FRAME_A", ""), meta.get("REF_FRAME_B", "")]
    direction = meta.get("ATTITUDE_DIR", "A2B").upper().replace(">", "2").replace("-", "")
    if direction not in ("A2B", "B2A") or (version != "1.0" and direction != "A2B"):
        raise FormatError(
            f"{message.at(line)}: ATTITUDE_DIR = {direction[:20]} is not known in version {version}; "
            f"allowed: {'A2B, B2A' if version == '1.0' else 'A2B alone'}"
        )
    if direction == "B2A":
        frames.reverse()
    own = [_is_body(frame) for frame in frames]
    if own[0] == own[1]:
        raise FormatError(
            f"{message.at(line)}: attitude from {frames[0][:40] or '(nothing)'} to "
            f"{frames[1][:40] or '(nothing)'}; one of both must be the body ({', '.join(BODY_FRAMES)}), "
            "the other axes of the Earth or the stars"
        )
    other = own.index(False)
    # after a message of direction B to A has been turned round, frames are no longer A and B by name
    return known_axes(message, line, "REF_FRAME", frames[other]), own[1]


def _is_body(frame: str) -> bool:
    """Whether axes are those of the spacecraft's body."""
    plain = frame.upper().strip()
    return plain.startswith(BODY_FRAMES) and not plain.startswith("BODY_FIXED")


@reads("a CCSDS APM")
def read_apm(
    path: Path,
    epoch: str,
    *,
    span: tuple[float, float] | None = None,
    ut1_less_utc: Callable[[float], float] = no_ut1,
) -> AttitudeEphemeris:
    """The attitude of an attitude parameter message, carried to the times of the images.

    Parameters
    ----------
    path, epoch, span, ut1_less_utc
        As of `read_aem`. The attitude keeps still in its axes, or turns evenly where the message has a rate.

    Returns
    -------
    AttitudeEphemeris
        Rows over the span.

    Raises
    ------
    FormatError
        If the message holds no quaternion and no Euler angles, or is of more than 600 s before or after.
    """
    message = read_message(path, "APM")
    values = _keywords(message)
    clock = clock_of(message, epoch, ut1_less_utc)
    t = clock.seconds(_one(message, values, "EPOCH"), f"{path}: EPOCH")
    axes, body, rate = _apm_attitude(message, values)
    first, last = span if span is not None else (t, t)
    if first < t - _APM_REACH or last > t + _APM_REACH:
        raise FormatError(
            f"{path}: is of {t:.3f} s from the epoch, the images of {first:.3f} to {last:.3f} s; one "
            f"attitude is carried over {_APM_REACH:g} s at most; give attitudes over that time (AEM, CSV)"
        )
    times = np.linspace(first, last, int(np.ceil((last - first) / _APM_STEP)) + 1)
    turned = body * Rotation.from_rotvec((times - t)[:, np.newaxis] * rate)
    size = float(np.linalg.norm(rate))
    how = f"turning evenly at {size:.4g} rad/s" if size > 0.0 else "still"
    return AttitudeEphemeris(
        times, turned.as_quat(), axes, message.segments[0].meta.get("CENTER_NAME", ""), clock.scale,
        words=f"one attitude, of {t:.3f} s from the epoch, {how} in {axes}",
    )  # fmt: skip


Keywords = dict[str, list[str]]


def _keywords(message: Message) -> Keywords:
    """The data of an APM: KEYWORD as it is, within blocks of version 2 as BLOCK.KEYWORD; all values of each.

    Metadata without marks about them are put where they belong.
    """
    if len(message.segments) > 1:
        raise FormatError(
            f"{message.at(message.segments[1].line)}: a second segment; an APM is of one attitude: give "
            "attitudes over time (AEM), or the message that is meant alone"
        )
    values: Keywords = {}
    block = ""
    meta = message.segments[0].meta
    marked = bool(meta)
    for line, text in message.segments[0].rows:
        if text.endswith(("_START", "_STOP")):
            block = text.removesuffix("_START") + "." if text.endswith("_START") else ""
            continue
        key, equals, value = text.partition("=")
        if not equals:
            raise FormatError(f"{message.at(line)}: {text[:80]!r} is not KEYWORD = value")
        if not marked and key.strip() in _APM_META:
            meta[key.strip()] = value.strip()
            continue
        values.setdefault(block + key.strip(), []).append(value.split("[")[0].strip())
    return values


def _one(message: Message, values: Keywords, key: str) -> str:
    """The value of a keyword that stands once."""
    if len(values.get(key, [])) != 1:
        raise FormatError(f"{message.path}: {key} stands {len(values.get(key, []))} times; once is needed")
    return values[key][0]


def _floats(message: Message, values: Keywords, keys: list[str]) -> Array:
    """Numbers of keywords; one that stands twice gives its values in turn."""
    left = {key: list(values.get(key, [])) for key in keys}
    for key in left:
        if len(left[key]) < keys.count(key):
            raise FormatError(f"{message.path}: {key} is missing, which the attitude needs")
    try:
        found = np.array([float(left[key].pop(0)) for key in keys])
    except ValueError:
        raise FormatError(f"{message.path}: {', '.join(keys)} are not all numbers") from None
    if not np.isfinite(found).all():
        raise FormatError(f"{message.path}: {', '.join(keys)} are not all finite")
    return found


def _apm_attitude(message: Message, values: Keywords) -> tuple[str, Rotation, Array]:
    """Axes, the rotation from the body to them, and its rate (3,), rad/s about body axes."""
    names = ("QUAT.", "EULER.") if message.version != "1.0" else ("", "")
    plain = [key.rpartition(".")[2] for key in values]
    spins = next((key for key in plain if key.startswith("SPIN_")), None)
    if spins and not any(key in _APM_RATES or key.endswith(_DOT) for key in plain):
        raise FormatError(
            f"{message.path}: {spins} tells of a spin, not about which axis of the body; export a quaternion "
            'with its derivative or ANGVEL, or use [platform] kind = "spin"'
        )
    if f"{names[0]}QC" in values:
        return _apm_quaternion(message, values, names[0])
    if f"{names[1]}EULER_ROT_SEQ" in values:
        return _apm_angles(message, values, names[1])
    raise FormatError(f"{message.path}: holds neither a quaternion nor Euler angles; export a quaternion")


def _apm_ends(message: Message, values: Keywords, block: str, stem: str) -> tuple[str, bool]:
    """As `_ends`, of a block of version 2, or of keywords of version 1 that begin with `stem`."""
    later = bool(block)
    meta = {
        f"REF_FRAME_{end}": _one(
            message, values, f"{block}REF_FRAME_{end}" if later else f"{stem}_FRAME_{end}"
        )
        for end in "AB"
    }
    if not later:
        meta["ATTITUDE_DIR"] = values.get(f"{stem}_DIR", ["A2B"])[0]
    return _ends(message, message.segments[0].line, meta, message.version)


def _apm_quaternion(message: Message, values: Keywords, block: str) -> tuple[str, Rotation, Array]:
    """Attitude of a quaternion; its rate of its derivative, or of the angular velocity."""
    axes, to_body = _apm_ends(message, values, block, "Q")
    signs = np.ones(4) if to_body else np.array([-1.0, -1.0, -1.0, 1.0])
    keys = [block + name for name in ("Q1", "Q2", "Q3", "QC")]
    quaternion = check_quaternions(message.path, signs * _floats(message, values, keys)[np.newaxis])[0]
    body = Rotation.from_quat(quaternion)
    if f"{keys[0]}_DOT" not in values:
        return axes, body, _apm_velocity(message, values, body)
    change = signs * _floats(message, values, [f"{key}_DOT" for key in keys])
    # dq/dt = q (omega, 0) / 2 with omega about body axes
    vector, scalar = -quaternion[:3], quaternion[3]
    return axes, body, 2.0 * (scalar * change[:3] + change[3] * vector + np.cross(vector, change[:3]))


def _apm_angles(message: Message, values: Keywords, block: str) -> tuple[str, Rotation, Array]:
    """Attitude of Euler angles; its rate of their derivatives, or of the angular velocity."""
    axes, to_body = _apm_ends(message, values, block, "EULER")
    sequence = euler_sequence(
        message, message.segments[0].line, _one(message, values, f"{block}EULER_ROT_SEQ")
    )
    keys = [f"{block}ANGLE_{k}" for k in (1, 2, 3)] if block else [f"{axis}_ANGLE" for axis in sequence]
    angles = _floats(message, values, keys)

    def body_at(t: float, change: Array) -> Rotation:
        turn = Rotation.from_euler(sequence, angles + t * change, degrees=True)
        return turn if to_body else turn.inv()

    body = body_at(0.0, np.zeros(3))
    if block and f"{keys[0]}_DOT" in values:
        change = _floats(message, values, [f"{key}_DOT" for key in keys])
        return axes, body, (body.inv() * body_at(1e-3, change)).as_rotvec() / 1e-3
    return axes, body, _apm_velocity(message, values, body)


def _apm_velocity(message: Message, values: Keywords, body: Rotation) -> Array:
    """Angular velocity (3,) of the body about its axes, rad/s; 0 where the message has none."""
    names = [f"ANGVEL.ANGVEL_{axis}" for axis in "XYZ"], [f"{axis}_RATE" for axis in "XYZ"]
    keys = next((given for given in names if given[0] in values), None)
    if keys is None:
        return np.zeros(3)
    rate = np.radians(_floats(message, values, keys))
    if keys is names[0]:
        frame = _one(message, values, "ANGVEL.ANGVEL_FRAME")
        ends = [_one(message, values, f"ANGVEL.REF_FRAME_{end}") for end in "AB"]
        rate = rate if _is_body(ends[1]) else -rate
    else:
        end = _one(message, values, "RATE_FRAME")[-1:].upper()
        frame = values.get(f"EULER_FRAME_{end}", ["SC_BODY"])[0]
    return rate if _is_body(frame) else np.asarray(body.inv().apply(rate))
