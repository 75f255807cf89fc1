"""Two-line elements (TLE) and CCSDS orbit mean-elements messages (OMM) → positions, by sgp4, in TEME.

Not here: TEME to Earth-fixed axes (``geometry/earth_orientation.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.geometry.earth_orientation import orbit_package
from sightline.io.formats.ccsds_message import is_earth, read_message
from sightline.io.formats.instants import modified_julian_day, parse_utc, tai_offset
from sightline.io.formats.packed import head_lines, read_packed_text

Array = NDArray[np.float64]

#: km, 1-sigma of a position by mean elements: at their epoch, and per day from it. D. Vallado et al. (2006),
#: Revisiting Spacetrack Report #3: about 1 km, growing by 1 to 3 km a day in low orbits.
_AT_EPOCH, _PER_DAY = 1.0, 2.0
#: s between positions, and by which they reach beyond the images.
_STEP, _MARGIN = 10.0, 60.0
_LENGTH, _MJD_0 = 69, 2400000.5
#: Day 0 of sgp4, 1949 December 31, as a modified Julian day.
_SGP4_0 = 33281.0
#: Mean elements by these theories are what sgp4 takes.
_THEORIES = ("SGP4", "SGP", "SGP/SGP4")
_ELEMENTS = (
    "MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY",
    "BSTAR",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PropagatedOrbit:
    """Positions by mean elements.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    position, velocity : (N, 3)
        m, m/s; true equator, mean equinox of date (TEME).
    name : str
        Of the satellite.
    age : float
        Days from the elements to the images, negative where they are later.
    sigma : float
        m per axis; what such elements are known to be good to.
    """

    t: Array
    position: Array
    velocity: Array
    name: str
    age: float
    sigma: float


def is_tle(path: Path) -> bool:
    """Whether a file holds two-line elements, by its first lines."""
    lines = [line.rstrip() for line in head_lines(path) if line.strip()][:3]
    return any(
        first.startswith("1 ") and second.startswith("2 ") and min(len(first), len(second)) >= _LENGTH - 1
        for first, second in pairwise(lines)
    )


@reads("two-line elements (TLE)")
def read_tle(path: Path, epoch: str, span: tuple[float, float] = (0.0, 0.0)) -> PropagatedOrbit:
    """Positions over the images by the elements of a file whose epoch is nearest.

    Parameters
    ----------
    path : Path
        Two-line elements of one satellite, one set or more, each with a line of its name or not.
    epoch : str
        UTC of t = 0.
    span : (first, last)
        s; of the images.

    Raises
    ------
    FormatError
        If a line's check sum is wrong, there are several satellites, or sgp4 cannot propagate.
    """
    lines = [line.rstrip() for line in read_packed_text(path, "two-line elements").splitlines()]
    api = orbit_package("sgp4.api", "a TLE")
    found: list[tuple[Any, str]] = []
    for number, line in enumerate(lines):
        if not line.startswith("1 "):
            continue
        second = lines[number + 1] if number + 1 < len(lines) else ""
        for place, text, first in ((number + 1, line, "1"), (number + 2, second, "2")):
            _check_line(path, place, text, first)
        if line[2:7] != second[2:7]:
            raise FormatError(f"{path}: line {number + 2} is of another satellite than the line before it")
        before = lines[number - 1].removeprefix("0 ").strip() if number else ""
        name = before if before and not before.startswith(("1 ", "2 ")) else f"satellite {line[2:7].strip()}"
        found.append((api.Satrec.twoline2rv(line, second), name))
    if not found:
        raise FormatError(f"{path}: holds no two-line elements: lines that begin with 1 and 2")
    if len({satellite.satnum for satellite, _ in found}) > 1:
        raise FormatError(
            f"{path}: holds elements of several satellites; keep those of the one that took the images"
        )
    return _nearest(path, found, epoch, span)


def _check_line(path: Path, place: int, line: str, first: str) -> None:
    """FormatError unless a line of two-line elements is whole."""
    if not line.startswith(f"{first} ") or len(line) < _LENGTH:
        raise FormatError(
            f"{path}: line {place}: is no line {first} of two-line elements of {_LENGTH} characters; the "
            "file was "
            "cut, or a line is missing"
        )
    total = sum(int(c) if c.isdigit() else c == "-" for c in line[: _LENGTH - 1]) % 10
    if line[_LENGTH - 1] != str(total):
        raise FormatError(
            f"{path}: line {place}: its check sum is {line[_LENGTH - 1]!r}, its characters give {total}; "
            "the line "
            "was changed"
        )


@reads("a CCSDS OMM")
def read_omm(path: Path, epoch: str, span: tuple[float, float] = (0.0, 0.0)) -> PropagatedOrbit:
    """The same of an orbit mean-elements message (KVN or XML), whose theory is SGP4.

    Parameters
    ----------
    path, epoch, span
        As of `read_tle`.
    """
    message = read_message(path, "OMM")
    values: dict[str, str] = {}
    for line, text in message.segments[0].rows:
        key, equals, value = text.partition("=")
        if not equals:
            raise FormatError(f"{message.at(line)}: {text[:80]!r} is not KEYWORD = value")
        values[key.strip()] = value.split("[")[0].strip()
    for key in ("CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "MEAN_ELEMENT_THEORY", "EPOCH", *_ELEMENTS):
        if key not in values:
            raise FormatError(f"{path}: {key} is missing, which SGP4 needs")
    for key, allowed in (
        ("REF_FRAME", ("TEME",)),
        ("TIME_SYSTEM", ("UTC",)),
        ("MEAN_ELEMENT_THEORY", _THEORIES),
    ):
        if values[key].upper() not in allowed:
            raise FormatError(
                f"{path}: {key} = {values[key][:40]} is not handled; allowed: {', '.join(allowed)}"
            )
    if not is_earth(values["CENTER_NAME"]) or values.get("EPHEMERIS_TYPE", "0") not in ("0", "2", "3"):
        raise FormatError(f"{path}: SGP4 is of the Earth, and of EPHEMERIS_TYPE 0; give an OEM of this orbit")
    return _nearest(path, [(_satellite(path, values), values.get("OBJECT_NAME", "satellite"))], epoch, span)


def _satellite(path: Path, values: dict[str, str]) -> Any:
    """What sgp4 propagates, of the keywords of an OMM: degrees, revolutions per day."""
    api = orbit_package("sgp4.api", "an OMM")
    try:
        numbers = {key: float(values[key]) for key in _ELEMENTS}
        number = int(float(values.get("NORAD_CAT_ID", "0")))
    except ValueError as error:
        raise FormatError(f"{path}: an element is no number ({error})") from None
    parse_utc(values["EPOCH"], f"{path}: EPOCH")
    satellite, turn = api.Satrec(), 2.0 * np.pi
    day, second, _ = modified_julian_day(0.0, values["EPOCH"])
    satellite.sgp4init(
        api.WGS72, "i", min(max(number, 0), 99999), day - _SGP4_0 + second / 86400.0, numbers["BSTAR"],
        0.0, 0.0,
        numbers["ECCENTRICITY"], np.radians(numbers["ARG_OF_PERICENTER"]), np.radians(numbers["INCLINATION"]),
        np.radians(numbers["MEAN_ANOMALY"]), numbers["MEAN_MOTION"] * turn / 1440.0,
        np.radians(numbers["RA_OF_ASC_NODE"]),
    )  # fmt: skip
    return satellite


def _nearest(
    path: Path, found: list[tuple[Any, str]], epoch: str, span: tuple[float, float]
) -> PropagatedOrbit:
    """Positions over a span (s) by the elements that are nearest to it."""
    day, second, _ = modified_julian_day(0.5 * sum(span), epoch)
    middle = day + second / 86400.0

    def age(satellite: Any) -> float:
        return float(middle - (satellite.jdsatepoch - _MJD_0 + satellite.jdsatepochF))

    satellite, name = min(found, key=lambda item: abs(age(item[0])))
    reach = span[1] - span[0] + 2.0 * _MARGIN
    t = np.linspace(span[0] - _MARGIN, span[1] + _MARGIN, int(np.ceil(reach / _STEP)) + 1)
    day, second, _ = modified_julian_day(0.0, epoch)
    # sgp4 takes the time since the elements for a difference of days of 86400 s
    start = datetime(1858, 11, 17, tzinfo=UTC)
    of_elements = start + timedelta(days=satellite.jdsatepoch - _MJD_0 + satellite.jdsatepochF)
    second += tai_offset(parse_utc(epoch, "epoch")[0]) - tai_offset(of_elements)
    errors, place, speed = satellite.sgp4_array(np.full(len(t), _MJD_0 + day), (second + t) / 86400.0)
    if errors.any() or not np.isfinite(place).all():
        words = orbit_package("sgp4.api", "a TLE").SGP4_ERRORS.get(int(errors.max()), "no finite position")
        raise FormatError(f"{path}: SGP4 cannot propagate these elements to the images: {words}")
    days = age(satellite)
    sigma = 1e3 * float(np.hypot(_AT_EPOCH, _PER_DAY * days))
    return PropagatedOrbit(t, place * 1e3, speed * 1e3, name, days, sigma)
