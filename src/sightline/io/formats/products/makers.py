"""What makers' sensor models share: units, labels of time, Earth-fixed orbits, attitudes between records.

Not here: a maker's own elements and axes (``dimap2.py``, ``dimap1.py``, ``pleiades.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import EARTH_RATE, WGS84, from_geodetic
from sightline.geometry.interpolation import interpolate, interpolate_hermite
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.instants import elapsed, parse_utc
from sightline.io.formats.line_scan import Instants, LineScanModel, OneGrid, SensorMotion, assemble
from sightline.io.formats.products.product import GroundMark
from sightline.io.formats.products.tree import Part

Array = NDArray[np.float64]

#: Nodes of the polynomial through positions; with fewer rows than the second, velocities take part.
_NODES, _ENOUGH = 8, 6
#: s between rows from which on all of them are nodes: labels that round to a microsecond move a satellite by
#: 7 mm, which a polynomial through rows some ms apart makes more of at its ends.
_APART = 0.1
#: m/s by which velocities at the ends of a step may differ from its slope: .6 over 30 s, 2.4 over 60 s. The
#: other kind of velocity (inertial, on Earth-fixed axes) differs by 75 m/s and more below sun-synchronous
#: orbits.
_AGREE = 10.0
#: m from the Earth's centre between which satellites that image it fly.
_RADII = (6.5e6, 5e7)
#: rad/s of Earth-fixed axes relative to the stars.
TURNING = np.array([0.0, 0.0, EARTH_RATE])
#: From when products count seconds: `LineScanModel.reference`.
_ZERO = datetime(2000, 1, 1, 12, tzinfo=UTC)
#: s from line to line that line scanners take.
_PERIODS = (1e-6, 10.0)
#: Highest degree of a polynomial (of makers' files it is 3), and how far quaternions by polynomials may be
#: from unit length.
_MOST_DEGREE, _UNIT = 20, 1e-2
#: m above the ellipsoid between which the ground of a product is sought.
_HEIGHTS = (-500.0, 9000.0)


def words(part: Part, name: str, default: str = "") -> str:
    """The words at a path; `default` where there are none."""
    found = part.element.find(name)
    return ("" if found is None else (found.text or "").strip()) or default


def scaled(part: Part, name: str, units: Mapping[str, float], width: int = 1) -> Array:
    """Numbers at a path, each times what its unit stands for: the first of `units` where none is given."""
    unit = part.part(name).element.get("unit", next(iter(units)))
    if unit not in units:
        raise part.refused(name, f"is in {unit[:20]!r}; units that are read: {', '.join(units)}")
    return part.numbers(name, width) * units[unit]


def line_period(part: Part, name: str, units: Mapping[str, float]) -> float:
    """s from line to line, at a path."""
    value = float(scaled(part, name, units)[0])
    if not _PERIODS[0] <= value <= _PERIODS[1]:
        raise part.refused(
            name, f"is {value:g} s; line scanners take {_PERIODS[0]:g} to {_PERIODS[1]:g} s a line"
        )
    return value


def check_level(data: Part, version: tuple[str, str], level: tuple[str, str], others: str) -> None:
    """FormatError unless a DIMAP is of a version and a level: each a path and what is to stand there."""
    found = data.part(version[0]).element.get("version", "")
    held = words(data, level[0], "none")
    if not found.startswith(version[1]) or held != level[1]:
        raise FormatError(
            f"{data.path}: is DIMAP {found or 'without version'} of level {held[:20]}; of level {level[1]} "
            f"the line scanner is described: order that one ({others})"
        )


def some(part: Part, name: str, least: int) -> list[Part]:
    """All elements at a path, `least` or more."""
    found = part.parts(name)
    if len(found) < least:
        raise part.refused(name, f"is there {len(found)} times, {least} or more are needed")
    return found


def record_times(rows: Sequence[Part], name: str, start: str) -> Array:
    """s (N,) from the instant `start` to that of each row, increasing."""
    zero = parse_utc(start, f"{rows[0].path}: the first instant")
    t = np.array([elapsed(row.text(name), zero, f"{row.path}: {row.place}/{name}") for row in rows])
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        raise rows[int(late[0]) + 1].refused(name, "does not follow that of the row before")
    return t


def rotations(part: Part, name: str, rows: Array) -> Rotation:
    """Rotations of quaternions (N, 4), scalar first, of unit length to a thousandth."""
    length = np.linalg.norm(rows, axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > 1e-3:
        raise part.refused(
            name, f"holds a quaternion of length {length[worst]:.6g} in row {worst + 1}, not 1"
        )
    return Rotation.from_quat(rows, scalar_first=True)


@dataclass(frozen=True, eq=False)
class Orbit:
    """Earth-fixed positions and velocities.

    Attributes
    ----------
    t : (N,)
        s, increasing.
    position, velocity : (N, 3)
        m; m/s relative to the turning Earth.
    """

    t: Array
    position: Array
    velocity: Array

    def positions(self, t: Array) -> Array:
        """(M, 3) m at `t` (M,) s, by a polynomial through eight rows; of few, through velocities too."""
        if len(self.t) >= _ENOUGH:
            rows = self._spread()
            return interpolate(self.t[rows], self.position[rows], t, _NODES)
        return interpolate_hermite(self.t, self.position, self.velocity, t)

    def _spread(self) -> NDArray[np.intp]:
        """Rows some way apart, the first and the last among them: eight or more where there are so many."""
        count = len(self.t)
        kept = max(_NODES, 1 + int((self.t[-1] - self.t[0]) / _APART))
        if kept >= count:
            return np.arange(count)
        return np.round(np.linspace(0.0, count - 1.0, kept)).astype(np.intp)

    def velocities(self, t: Array) -> Array:
        """(M, 3) m/s relative to the Earth at `t` (M,) s."""
        return interpolate(self.t, self.velocity, t, _NODES)


def orbit_of(
    part: Part, name: str, t: Array, position: Array, velocity: Array, *, inertial: bool | None
) -> Orbit:
    """An orbit as a product writes it, its velocities checked.

    Parameters
    ----------
    part, name : Part, str
        Where it stands, for messages.
    t : (N,)
        s, increasing.
    position, velocity : (N, 3)
        m, m/s, on Earth-fixed axes.
    inertial : bool or None
        Whether velocities are relative to the stars, though on Earth-fixed axes: the turn of the Earth is
        then taken off. None: whichever agrees with the positions.

    Raises
    ------
    FormatError
        Unless the velocities are the slope of the positions (in other units, or of the other kind), and
        these those of a satellite.
    """
    radius = np.linalg.norm(position, axis=1)
    if radius.min() < _RADII[0] or radius.max() > _RADII[1]:
        raise part.refused(
            name,
            f"holds a place {radius[np.argmax(np.abs(np.log(radius / _RADII[0])))]:.6g} m from the Earth's "
            "centre; positions are read in m, Earth-fixed",
        )
    slope = np.diff(position, axis=0) / np.diff(t)[:, None]
    kinds = {
        True: ("inertial velocities on Earth-fixed axes", velocity - np.cross(TURNING, position)),
        False: ("velocities relative to the Earth", velocity),
    }
    if inertial is not None:
        kinds = {inertial: kinds[inertial]}
    off = {key: float(np.abs(slope - 0.5 * (v[:-1] + v[1:])).max()) for key, (_, v) in kinds.items()}
    best = min(off, key=lambda key: off[key])
    worst, fixed = off[best], kinds[best][1]
    if worst > _AGREE:
        kind = " or ".join(word for word, _ in kinds.values())
        raise part.refused(
            name,
            f"has velocities that differ from the slope of the positions by {worst:.4g} m/s; {kind} in m/s "
            "and positions in m are read",
        )
    return Orbit(t, position, fixed)


def polynomial_attitude(
    part: Part, name: str, polynomials: str, start: str, ends: tuple[float, float]
) -> Callable[[Array], Rotation]:
    """world_from_sensor of times in s from an instant, each component of the quaternion a polynomial.

    Parameters
    ----------
    part, name : Part, str
        Where OFFSET (s of the day of `start`) and SCALE (s) stand; components by (t - OFFSET) / SCALE.
    polynomials : str
        Where Q0 (the scalar) to Q3 stand.
    start : str
        UTC.
    ends : (float, float)
        s, within which lines are exposed: there quaternions are to be of unit length.
    """
    whole, fraction = parse_utc(start, f"{part.path}")
    of_day = (whole - whole.replace(hour=0, minute=0, second=0)) / timedelta(seconds=1) + fraction
    offset, scale = part.number(f"{name}/OFFSET"), part.positive(f"{name}/SCALE")
    rows = [read_coefficients(part, f"{polynomials}/Q{k}") for k in range(4)]

    def components(t: Array) -> Array:
        x = (t + of_day - offset) / scale
        return np.stack([np.polynomial.polynomial.polyval(x, row) for row in rows], axis=1)

    length = np.linalg.norm(components(np.array(ends)), axis=1)
    worst = float(length[np.argmax(np.abs(length - 1.0))])
    if abs(worst - 1.0) > _UNIT:
        raise part.refused(
            polynomials,
            f"gives a quaternion of length {worst:.6g} at an end of the image, not near 1: are OFFSET "
            f"({offset:g} s of the day) and SCALE ({scale:g} s) those of its lines?",
        )
    return lambda t: Rotation.from_quat(components(t), scalar_first=True)


def read_coefficients(part: Part, name: str) -> Array:
    """Coefficients, the constant first."""
    return part.numbers(f"{name}/COEFFICIENTS", part.count(f"{name}/DEGREE", 0, _MOST_DEGREE) + 1)


def turned_by(
    t: Array, turns: Rotation, between: Callable[[Array], Rotation] | None = None
) -> Callable[[Array], Rotation]:
    """Attitude at any time, `between` records by slerp if not given.

    Beyond the ends it turns on as between the last two records.
    """
    between = between or Slerp(t, turns)
    rates = (turns[:-1].inv() * turns[1:])[[0, -1]].as_rotvec() / np.diff(t)[[0, -1], None]

    def at(when: Array) -> Rotation:
        inside = np.clip(when, t[0], t[-1])
        beyond = when - inside
        rate = np.where((beyond > 0.0)[:, None], rates[1], rates[0])
        return between(inside) * Rotation.from_rotvec(beyond[:, None] * rate)

    return at


def line_scan(
    path: Path,
    start: str,
    t: Array,
    attitude: tuple[Array, Callable[[Array], Rotation]],
    orbit: Orbit,
    directions: Array,
    reference: tuple[float, float] | None,
    *,
    doubts: tuple[str, ...] = (),
    one_grid: OneGrid | None = None,
) -> LineScanModel:
    """The model of an evenly spaced camera whose attitudes hold aberration and refraction already.

    Parameters
    ----------
    path : Path
    start : str
        UTC from which times count.
    t : (L,)
        s, exposure of every line.
    attitude : ((N,), callable)
        s, of the records between which it bends, none of one that does not end; world_from_sensor of times.
    orbit : Orbit
    directions : (columns, 3)
        Sensor axes, z to the ground.
    reference : (float, float) or None
        Of another model, whose t = 0 is meant.
    doubts : tuple of str
    one_grid : OneGrid, optional

    Raises
    ------
    FormatError
        Where lines lie more than two steps beyond the records.
    """
    nodes, world_from_sensor = attitude

    def refused(name: str, why: str) -> FormatError:
        return FormatError(f"{path}: {name} {why}: were its records cut? fetch the whole file")

    tables = [Instants("ephemeris", orbit.t), *([Instants("attitude", nodes)] if len(nodes) else [])]
    said = [table.check(t, refused) for table in tables]
    whole, fraction = parse_utc(start, f"{path}")
    since = (whole - _ZERO) / timedelta(seconds=1)
    reference = reference or (since, fraction + float(t[0]))
    later = (since - reference[0]) + (fraction - reference[1])
    camera = assemble(
        SensorMotion(nodes, orbit.positions, world_from_sensor), directions, t, even=True, later=later
    )
    return LineScanModel(
        camera,
        WGS84,
        reference,
        (*(f"{path.name}: {line}" for line in said if line), *doubts),
        scale="UTC",
        one_grid=one_grid,
    )


def epoch_of(start: str, t: float) -> str:
    """UTC, ISO 8601 with nanoseconds, of `t` s (below a day) after an instant; leap seconds not counted."""
    whole, fraction = parse_utc(start, "start")
    return time_label(whole, fraction + t)


def time_label(whole: datetime, t: float) -> str:
    """The same, of `t` s after whole seconds."""
    seconds, nanoseconds = divmod(round(t * 1e9), 1_000_000_000)
    return f"{whole + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def marks_inside(
    marks: Sequence[GroundMark], shape: tuple[int, int]
) -> tuple[tuple[GroundMark, ...], tuple[str, ...]]:
    """Marks of pixels that an image of `shape` has, and what is said of others."""
    lines, columns = shape
    held = tuple(mark for mark in marks if 0.0 <= mark.line < lines and 0.0 <= mark.column < columns)
    beyond = len(marks) - len(held)
    if not beyond:
        return held, ()
    return held, (f"where {beyond} places of the file lie: their rows or columns are not of the image",)


def one_height(camera: PushbroomCamera, marks: Sequence[GroundMark]) -> tuple[float, float]:
    """The height (m) at which a camera best meets marks that tell none, and the rms that is left, m."""
    pixels = np.array([[mark.line, mark.column] for mark in marks])
    places = np.radians([[mark.longitude, mark.latitude] for mark in marks])

    def apart(height: float) -> float:
        seen = camera.locate(pixels, Ellipsoid(height=height))
        given = from_geodetic(np.column_stack([places, np.full(len(places), height)]))
        return float(np.sqrt(np.mean(np.sum((seen - given) ** 2, axis=1))))

    best = minimize_scalar(apart, bounds=_HEIGHTS, method="bounded", options={"xatol": 1e-3})
    return float(best.x), float(best.fun)
