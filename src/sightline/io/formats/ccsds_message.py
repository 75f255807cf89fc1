"""CCSDS navigation messages as keywords and lines: header, segments with metadata and data; what all share.

Keyword = value notation (KVN) is read here; XML is turned into it. Files may be compressed.

Not here: XML (``ccsds_xml.py``), what data mean: orbits (``ccsds.py``), attitudes (``ccsds_attitude.py``).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.geometry.earth_orientation import AXES, axes_of
from sightline.io.formats.ccsds_xml import kvn_of_xml
from sightline.io.formats.instants import TIME_SCALES, clock, parse_utc
from sightline.io.formats.packed import head_lines, read_packed_text
from sightline.io.formats.tables import check_times

Array = NDArray[np.float64]
Row = tuple[int, str]

#: Kinds that are read, with their versions.
VERSIONS = {"OEM": ("1.0", "2.0", "3.0"), "AEM": ("1.0", "2.0"), "APM": ("1.0", "2.0"), "OMM": ("2.0", "3.0")}
_HEADER = ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "CLASSIFICATION")
#: Names of axes that turn with the body they are about, beside IAU_MARS and MARS_FIXED.
_BODY_FIXED = ("FIXED_CB", "BODY_FIXED", "BODYFIXED")
#: Axes that go round with the satellite.
_ORBITAL = (
    "RSW",
    "RTN",
    "TNW",
    "QSW",
    "LVLH",
    "UVW",
    "NTW",
    "VNC",
    "PQW",
    "RIC",
    "RPQ",
    "EQW",
    "SEZ",
    "LOCAL",
)
_ROOT = re.compile(r"<(?:\w+:)?(oem|aem|apm|omm|opm|ocm|acm|tdm|cdm|rdm|ndm)\b", re.IGNORECASE)
_ELEMENT = re.compile(r"<([A-Za-z_][\w:.-]*)")
_UNIT = re.compile(r"\s*\[[^\]]*\]$")
#: s by which rows may lie beyond the span that their metadata state, which may be rounded.
_ROUNDED = 1.0
#: Usual steps that may lie between segments that are joined.
_GAP = 2.5


@dataclass
class Segment:
    """Metadata and the lines that follow them."""

    line: int
    meta: dict[str, str] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)


@dataclass(frozen=True)
class Message:
    """A message as it is written.

    Attributes
    ----------
    path : Path
    kind, version : str
        As "OEM", "2.0".
    header : dict
    segments : list of Segment
        One for messages without metadata blocks of their own.
    turned : bool
        Whether it was XML: lines are counted of its KVN form.
    """

    path: Path
    kind: str
    version: str
    header: dict[str, str]
    segments: list[Segment]
    turned: bool

    def at(self, line: int) -> str:
        """A place, for messages."""
        return f"{self.path}: line {line}" + (" (of the message as KVN)" if self.turned else "")


def message_kind(path: Path) -> str | None:
    """The kind of a CCSDS message ("OEM", "AEM", ...) by how it begins, packed or not; None for others.

    Raises
    ------
    FormatError
        If it is XML of another kind.
    """
    lines = [line.strip() for line in head_lines(path)]
    text = next((line for line in lines if line and not line.startswith("COMMENT")), "")
    if text.startswith("CCSDS_"):
        return text.split("=")[0].strip().removeprefix("CCSDS_").removesuffix("_VERS")
    if text.startswith("<"):
        root = _ROOT.search("\n".join(lines))
        if root is not None:
            return root[1].upper()
        other = _ELEMENT.search("\n".join(lines))
        raise FormatError(
            f"{path}: is XML or HTML{f' that begins with <{other[1][:40]}>' if other else ''}, and no CCSDS "
            "message; a message in XML or KVN, or a table in CSV, is expected: is another file meant?"
        )
    return None


def kinds_within(path: Path) -> tuple[str, ...]:
    """Kinds of the messages that an NDM in XML combines, each as often as it is there."""
    text = read_packed_text(path, "a CCSDS message in XML")
    return tuple(kind.upper() for kind in _ROOT.findall(text) if kind.upper() != "NDM")


def read_message(path: Path, kind: str) -> Message:
    """A message of a kind, its form checked; FormatError that says what is wrong where."""
    text = read_packed_text(path, "a CCSDS message in KVN or XML")
    turned = text.lstrip().startswith("<")
    if turned:
        text = kvn_of_xml(path, text, kind)
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not (line.strip() + " ").startswith("COMMENT ")
    ]
    before = next((line for line in text.splitlines() if line.strip()), "")
    first = f"CCSDS_{kind}_VERS"
    if not lines or not before.strip().startswith(first):
        raise FormatError(
            f"{path}: begins with {before.strip()[:60]!r}; its first line must be {first} = ..."
        )
    version = _pair(path, lines[0])[1]
    if version not in VERSIONS[kind]:
        raise FormatError(
            f"{path}: {first} = {version[:20]} is not known; versions that are read: "
            f"{', '.join(VERSIONS[kind])}"
        )
    message = Message(path, kind, version, {}, [], turned)
    # parameter messages are metadata and data in a row; later ones mark their metadata
    marked = any(line == "META_START" for _, line in lines)
    _fill(message, lines[1:], flat=kind == "OMM" or (kind == "APM" and not marked))
    for key in _HEADER[:2]:
        if key not in message.header:
            raise FormatError(f"{path}: {key} is missing; every message begins with it: the header was cut")
    parse_utc(message.header["CREATION_DATE"], f"{path}: CREATION_DATE")
    return message


def _pair(path: Path, row: Row) -> tuple[str, str]:
    key, equals, value = row[1].partition("=")
    if not equals:
        raise FormatError(f"{path}: line {row[0]}: {row[1][:80]!r} is not KEYWORD = value")
    unit = _UNIT.search(value.strip())
    if unit and "rad" in unit.group().lower():
        raise FormatError(
            f"{path}: line {row[0]}: {key.strip()} is in {unit.group().strip()}; angles of CCSDS messages "
            "are in degrees: give it in [deg] or [deg/s]"
        )
    return key.strip(), _UNIT.sub("", value.strip())


def _fill(message: Message, rows: Iterable[Row], *, flat: bool) -> None:
    """Header and segments of the lines after the first."""
    inside = False
    segments = message.segments
    for row in rows:
        line, text = row
        if text == "META_START":
            if inside:
                raise FormatError(f"{message.at(line)}: META_START within metadata; META_STOP is missing")
            segments.append(Segment(line))
            inside = True
        elif text == "META_STOP":
            if not inside:
                raise FormatError(f"{message.at(line)}: META_STOP without META_START")
            inside = False
        elif segments and not inside:
            segments[-1].rows.append(row)
        else:
            key, value = _pair(message.path, row)
            if flat and not segments and key not in _HEADER:
                segments.append(Segment(line, rows=[row]))
                continue
            meta = segments[-1].meta if segments else message.header
            if not segments and key not in _HEADER:
                raise FormatError(
                    f"{message.at(line)}: {key} before META_START; the header is {', '.join(_HEADER)}"
                )
            if key in meta:
                raise FormatError(f"{message.at(line)}: {key} is given twice; keep one")
            meta[key] = value
    if inside:
        raise FormatError(f"{message.path}: ends within metadata: META_STOP is missing; the file was cut")
    if not segments:
        raise FormatError(
            f"{message.path}: has no META_START; a {message.kind} is metadata with data after them"
        )


def check_keys(message: Message, segment: Segment, needed: Collection[str], known: Collection[str]) -> None:
    """FormatError where a keyword of the metadata is missing or unknown."""
    for key in needed:
        if key not in segment.meta:
            raise FormatError(f"{message.at(segment.line)}: metadata keyword {key} is missing")
    for key in segment.meta:
        if key not in known and key not in needed and not key.startswith("USER_DEFINED_"):
            raise FormatError(
                f"{message.at(segment.line)}: metadata keyword {key[:60]} is not known"
                f"{nearest(key, [*needed, *known])}"
            )


def check_alike(message: Message, key: str) -> None:
    """FormatError where segments differ in a keyword."""
    given = {segment.meta.get(key, "") for segment in message.segments}
    if len(given) > 1:
        raise FormatError(
            f"{message.path}: its segments differ in {key}: {' and '.join(sorted(given))[:200]}; give a "
            "message of one"
        )


def nearest(name: str, known: Collection[str]) -> str:
    """The end of a message: what may be meant by a name."""
    found = difflib.get_close_matches(name.upper(), list(known), 1)
    return f"; is {found[0]} meant?" if found else ""


@dataclass(frozen=True)
class Clock:
    """Instants of a message as s from the epoch.

    Attributes
    ----------
    scale : str
        One of `TIME_SCALES`.
    seconds : callable
        Of a text and its place.
    """

    scale: str
    seconds: Callable[[str, str], float]


def clock_of(message: Message, epoch: str, ut1_less_utc: Callable[[float], float]) -> Clock:
    """The clock of TIME_SYSTEM, which all segments share."""
    check_alike(message, "TIME_SYSTEM")
    segment = message.segments[0]
    scale = segment.meta.get("TIME_SYSTEM", "").upper()
    if scale not in TIME_SCALES:
        raise FormatError(
            f"{message.path}: TIME_SYSTEM = {scale[:20] or '(nothing)'} is not handled; allowed: "
            f"{', '.join(TIME_SCALES)}{nearest(scale, TIME_SCALES)}; convert the times first"
        )
    return Clock(scale, clock(scale, epoch, ut1_less_utc))


def useable_span(message: Message, segment: Segment, clock: Clock) -> tuple[float, float]:
    """First and last s of a segment that may be used, by its metadata."""
    at = {
        key: clock.seconds(segment.meta[key], f"{message.at(segment.line)}: {key}")
        for key in ("START_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "STOP_TIME")
        if key in segment.meta
    }
    order = list(at)
    for before, after in pairwise(order):
        if at[before] > at[after]:
            raise FormatError(
                f"{message.at(segment.line)}: {before} = {segment.meta[before]} lies after {after} = "
                f"{segment.meta[after]}; {', '.join(order)} must not fall"
            )
    return at.get("USEABLE_START_TIME", at["START_TIME"]), at.get("USEABLE_STOP_TIME", at["STOP_TIME"])


def check_interpolation(message: Message, segment: Segment, way: str) -> None:
    """FormatError where a way of interpolation has no degree, or one that is no whole number from 1 on."""
    degree = segment.meta.get("INTERPOLATION_DEGREE")
    if (way in segment.meta) and degree is None:
        raise FormatError(
            f"{message.at(segment.line)}: {way} = {segment.meta[way]} without INTERPOLATION_DEGREE"
        )
    if degree is not None and not (degree.isdigit() and int(degree) > 0):
        raise FormatError(
            f"{message.at(segment.line)}: INTERPOLATION_DEGREE = {degree[:20]} is no whole number from 1 on"
        )


def numbers(message: Message, row: Row, counts: Collection[int], clock: Clock) -> tuple[float, list[float]]:
    """Time (s) and numbers of a data line: an instant, then as many as one of `counts`."""
    line, text = row
    cells = text.split()
    if len(cells) - 1 not in counts:
        raise FormatError(
            f"{message.at(line)} holds {len(cells)} values; an instant and "
            f"{' or '.join(map(str, sorted(counts)))} numbers are expected"
        )
    t = clock.seconds(cells[0], message.at(line))
    try:
        values = [float(cell) for cell in cells[1:]]
    except ValueError:
        raise FormatError(f"{message.at(line)}: {' '.join(cells[1:])!r} are not numbers") from None
    if not np.isfinite(values).all():
        raise FormatError(f"{message.at(line)}: not a finite number")
    return t, values


def timed_numbers(
    message: Message, segment: Segment, rows: list[Row], counts: Collection[int], clock: Clock
) -> tuple[Array, Array]:
    """Times (N,), s, and the first numbers (N, min(counts)) of the data lines of a segment."""
    if not rows:
        raise FormatError(f"{message.at(segment.line)}: a segment without data; at least one row is needed")
    read = [numbers(message, row, counts, clock) for row in rows]
    t = np.array([at for at, _ in read])
    check_times(message.path, t, "epoch")
    span = [clock.seconds(segment.meta[key], message.at(segment.line)) for key in ("START_TIME", "STOP_TIME")]
    if t[0] < span[0] - _ROUNDED or t[-1] > span[1] + _ROUNDED:
        row = rows[0] if t[0] < span[0] - _ROUNDED else rows[-1]
        raise FormatError(
            f"{message.at(row[0])}: {row[1].split()[0]} lies outside START_TIME to STOP_TIME of its segment, "
            f"{segment.meta['START_TIME']} to {segment.meta['STOP_TIME']}: epochs are mixed"
        )
    return t, np.array([values[: min(counts)] for _, values in read])


def known_axes(message: Message, line: int, key: str, name: str) -> str:
    """A key of `AXES`, or the name of axes fixed to another body; FormatError for others."""
    found = axes_of(name)
    if found is not None:
        return found
    plain = name.upper().strip()
    if plain in _BODY_FIXED or (
        (plain.startswith("IAU_") or plain.endswith("_FIXED")) and "EARTH" not in plain
    ):
        return plain
    stem = plain.split("_")[0].split("-")[0]
    known = [other for names in AXES.values() for other in names]
    reason = "; it goes round with the satellite" if stem in _ORBITAL else nearest(plain, known)
    raise FormatError(
        f"{message.at(line)}: {key} = {name[:40]} is not handled{reason}; allowed: {', '.join(AXES)}, or "
        "IAU_MARS (any body) where [surface] has its radii; convert it first"
    )


def body_of(axes: str, centre: str) -> str:
    """The body that axes of `known_axes` are of; "" where neither they nor CENTER_NAME say it."""
    if axes in AXES:
        return "EARTH"
    named = "" if axes in _BODY_FIXED else axes.removeprefix("IAU_").removesuffix("_FIXED")
    return named or centre.upper().strip()


def is_earth(centre: str) -> bool:
    """Whether a CENTER_NAME is the Earth (its barycentre with the Moon is not)."""
    return centre.upper().strip() in ("EARTH", "EARTH CENTER", "EARTH CENTRE", "399", "")


@dataclass(frozen=True, eq=False)
class TimedRows:
    """What a segment gives: a table between two times.

    Attributes
    ----------
    useable : (first, last)
        s.
    t : (N,)
        s.
    values : (N, M)
    axes : str
        As of `known_axes`.
    """

    useable: tuple[float, float]
    t: Array
    values: Array
    axes: str


def chosen(
    message: Message, parts: list[TimedRows], span: tuple[float, float] | None
) -> tuple[TimedRows, int]:
    """The part that covers a span, or those that do so together, and how many these are.

    Parameters
    ----------
    message : Message
    parts : list of TimedRows
    span : (first, last) or None
        s; of the images. None: all of them.
    """
    for before, after in pairwise(parts):
        stop, start = min(before.t[-1], before.useable[1]), max(after.t[0], after.useable[0])
        if start < stop:
            raise FormatError(
                f"{message.path}: segments overlap, or do not follow each other: one is useable up to "
                f"{stop:.6f} s from the epoch, the next from {start:.6f} s on"
            )
    whole = [part for part in parts if span is not None and _reaches(part, span)]
    used = whole[:1] or _touched(parts, span)
    if len({part.axes for part in used}) > 1:
        raise FormatError(
            f"{message.path}: segments that the images need are in different axes: "
            f"{', '.join(part.axes for part in used)}; give a message of one"
        )
    if len(used) == 1:
        return used[0], 1
    times, values = np.zeros(0), np.zeros((0, used[0].values.shape[1]))
    for number, part in enumerate(used):
        kept = part.t > (times[-1] if len(times) else -np.inf)
        if number and part.t[0] <= used[number - 1].t[-1]:
            kept &= part.t >= part.useable[0]
        if number + 1 < len(used) and part.t[-1] >= used[number + 1].t[0]:
            kept &= part.t <= part.useable[1]
        t = part.t[kept]
        if (
            span is not None
            and len(times)
            and len(t)
            and t[0] - times[-1] > _GAP * max(_step(times), _step(t))
        ):
            raise FormatError(
                f"{message.path}: between segments {t[0] - times[-1]:.6g} s are without data, from "
                f"{times[-1]:.6f} s from the epoch on, within the time of the images; give a message "
                "without gaps"
            )
        times, values = np.concatenate([times, t]), np.concatenate([values, part.values[kept]])
    return TimedRows((used[0].useable[0], used[-1].useable[1]), times, values, used[0].axes), len(used)


def _step(t: Array) -> float:
    """The usual s between rows; that of a single one is 0."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def _reaches(part: TimedRows, span: tuple[float, float]) -> bool:
    """Whether a part alone covers a span."""
    return bool(max(part.t[0], part.useable[0]) <= span[0] and span[1] <= min(part.t[-1], part.useable[1]))


def _touched(parts: list[TimedRows], span: tuple[float, float] | None) -> list[TimedRows]:
    """Parts that share a time with a span, all where none does."""
    if span is None:
        return parts
    return [part for part in parts if part.t[0] <= span[1] and part.t[-1] >= span[0]] or parts
