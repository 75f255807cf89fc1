"""USGS CSM line-scan sensor models → PushbroomCamera: image support data (ISD) and model states.

An ISD holds positions and attitudes in J2000 and the rotation of the body; a model state holds
them in body-fixed axes already. Both are evaluated at the time of every line as the library ``usgscsm`` and
ALE, which write them, do: attitudes of an ISD by slerp, positions through their velocities, both of a state
by Lagrange's polynomial through the eight nearest.

Not here: the focal plane and its distortion (``focal_plane.py``), frame cameras (``isd_frame.py``), writing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError, InputError, reads
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.interpolation import interpolate, interpolate_hermite
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.trajectory import Trajectory
from sightline.io.formats.csm_keys import LINE_SCANNER, CsmKeys, read_keys
from sightline.io.formats.focal_plane import CsmFocalPlane, isd_plane, state_plane

Array = NDArray[np.float64]

#: Lines and samples beyond which a file is damaged: no line scanner makes such images.
_MOST_LINES, _MOST_SAMPLES = 4_000_000, 1_000_000
#: Steps of a table by which positions and attitudes are continued beyond its ends, where lines lie there.
MOST_STEPS = 2.0
#: Lines beyond the image at whose times the trajectory is known too, where the tables reach there.
_MARGIN_LINES = 16
#: s within which the one instant of a table is that asked for: as far apart as instants near 1e9 s are told.
_INSTANT = 1e-5
#: Line periods within which an instant of a table and the time of a line are one.
_SAME = 1e-3
#: Share of the way between two positions by which velocities may disagree with them and still be used.
_AGREE = 0.01
#: Lists of a model state that hold rows one after the other, and the length of these.
_FLAT = (("m_positions", 3), ("m_velocities", 3), ("m_quaternions", 4))
#: Nodes of the polynomial by which a state is interpolated, and those where its table holds few quaternions.
_LAGRANGE, _FEW, _LAGRANGE_OF_FEW = 8, 6, 4


@dataclass(frozen=True, eq=False)
class LineScanModel:
    """A line-scan sensor model in our terms.

    Attributes
    ----------
    camera : PushbroomCamera
        World axes are body-fixed, t = 0 at `reference`.
    radii : (float, float)
        m; equatorial and polar radius of the body.
    reference : (float, float)
        The instant t = 0: s past J2000 (TDB) of the middle of an image, and s from there.
    doubts : tuple of str
        What the file leaves open, and what was done about it.
    body : ((K,), Rotation) or None
        Instants (s from t = 0), and body-fixed from J2000 at each: it turns evenly between. None of states.
    """

    camera: PushbroomCamera
    radii: tuple[float, float]
    reference: tuple[float, float]
    doubts: tuple[str, ...] = ()
    body: tuple[Array, Rotation] | None = None

    @property
    def reference_et(self) -> float:
        """s past J2000 (TDB), the instant t = 0; resolved to 6e-8 s."""
        return sum(self.reference)


@dataclass(frozen=True, eq=False)
class _Timing:
    """Size of the image and when its lines are exposed; times in s from the centre of the image."""

    lines: int
    samples: int
    rates: Array
    centre_et: float
    radii: tuple[float, float]

    def line_times(self) -> Array:
        """(lines,) s from the centre time; centre of exposure.

        Rows of the rate table: line at which it begins to hold (0.5 is the begin of the first), time of that
        from the centre, s from each line to the next.
        """
        line = np.arange(self.lines) + 0.5
        row = np.clip(np.searchsorted(self.rates[:, 0], line, side="right") - 1, 0, None)
        first, start, period = self.rates[row].T
        return np.asarray(start + period * (line - first + 0.5))


@dataclass(frozen=True, eq=False)
class _Motion:
    """Where the sensor is and how it is turned, body-fixed, at any time (s from the centre of the image)."""

    nodes: Array
    position: Callable[[Array], Array]
    world_from_sensor: Callable[[Array], Rotation]
    body: tuple[Array, Rotation] | None = None


@dataclass(frozen=True, eq=False)
class _Table:
    """Instants (s from the centre of the image) of a table of the file, under its name."""

    name: str
    t: Array

    def check(self, data: CsmKeys, line_times: Array) -> str | None:
        """What is said where lines lie up to two steps beyond it; more are refused."""
        first, last = float(line_times[0]), float(line_times[-1])
        early, late = self.t[0] - first, last - self.t[-1]
        if max(early, late) <= 0.0:
            return None
        if len(self.t) < 2 and max(early, late) <= _INSTANT:
            return None
        if len(self.t) < 2:
            raise data.refused(self.name, "has one instant, and another is asked for; two or more are needed")
        words = []
        for beyond, step, which in (
            (early, self.t[1] - self.t[0], "begins {} s after the first line"),
            (late, self.t[-1] - self.t[-2], "ends {} s before the last line"),
        ):
            if beyond > MOST_STEPS * step:
                raise data.refused(
                    self.name,
                    f"{which.format(f'{beyond:.6g}')}, {beyond / step:.3g} of its steps of {step:.6g} s; "
                    f"lines are exposed from {first:.6f} to {last:.6f} s after the centre of the image, the "
                    f"table holds {self.t[0]:.6f} to {self.t[-1]:.6f} s; {MOST_STEPS:g} steps are continued",
                )
            if beyond > 0.0:
                words.append(f"{which.format(f'{beyond:.4g}')} ({beyond / step:.2g} steps)")
        return f"{self.name} {' and '.join(words)}: continued evenly"


@reads("a line-scan sensor model")
def read_line_scan_model(path: Path, reference: tuple[float, float] | None = None) -> LineScanModel:
    """A USGS CSM line-scan ISD or model state.

    Parameters
    ----------
    path : Path
        JSON; a model state may be preceded by a line with the model's name, as in the adjusted states of ASP.
    reference : (float, float), optional
        That of another model, whose t = 0 is meant; the first line of the image if not given.

    Returns
    -------
    LineScanModel

    Raises
    ------
    FormatError
        Names the file and the key; says which distortions are read.

    Notes
    -----
    Body axes are chosen by what the sensor does: z along its boresight, x across its row of pixels to
    the side it flies. Columns may then increase to the left or to the right.
    """
    data = read_keys(path, LINE_SCANNER)
    timing = (_state_timing if data.is_state else _isd_timing)(data)
    plane = (state_plane if data.is_state else isd_plane)(data)
    motion, doubts = (_state_motion if data.is_state else _isd_motion)(
        data, timing.centre_et, timing.line_times()
    )
    return _assemble(motion, plane, timing, reference, doubts)


def _isd_timing(data: CsmKeys) -> _Timing:
    """Timing of an ISD."""
    return _checked(
        data,
        "line_scan_rate",
        _Timing(
            data.count("image_lines", 1, _MOST_LINES),
            data.count("image_samples", 1, _MOST_SAMPLES),
            data.array("line_scan_rate", -1, 3),
            data.number("center_ephemeris_time"),
            isd_radii(data),
        ),
    )


def _state_timing(data: CsmKeys) -> _Timing:
    """Timing of a model state."""
    lines = data.array("m_intTimeLines", -1)
    rates = [data.array(key, len(lines)) for key in ("m_intTimeStartTimes", "m_intTimes")]
    return _checked(
        data,
        "m_intTimes",
        _Timing(
            data.count("m_nLines", 1, _MOST_LINES),
            data.count("m_nSamples", 1, _MOST_SAMPLES),
            np.column_stack([lines, *rates]),
            data.number("m_centerEphemerisTime"),
            (data.positive("m_majorAxis"), data.positive("m_minorAxis")),
        ),
    )


def _checked(data: CsmKeys, key: str, timing: _Timing) -> _Timing:
    """The same timing; refused where there is no pair of columns, or lines do not follow one another."""
    if timing.samples < 2:
        raise data.refused(
            "m_nSamples" if data.is_state else "image_samples",
            "is 1: the image is one column, which shows no pixel beside another; two or more are needed",
        )
    first, _, period = timing.rates.T
    if (period <= 0.0).any():
        row = int(np.argmax(period <= 0.0))
        raise data.refused(key, f"gives {period[row]:.6g} s from line to line in row {row + 1}, not above 0")
    if (np.diff(first) <= 0.0).any():
        raise data.refused(key, "gives lines that do not increase from row to row")
    if (np.diff(timing.line_times()) <= 0.0).any():
        raise data.refused(key, "gives times at which a line is exposed before the one that precedes it")
    return timing


def _turning(data: CsmKeys, name: str, centre_et: float) -> tuple[_Table | None, Callable[[Array], Rotation]]:
    """Instants and rotation at any time of an ISD's table: slerp between quaternions, then the constant part.

    Without quaternions, or with one, it is constant. Beyond the ends it turns on as between the last two.
    """
    constant = Rotation.identity()
    if data.has(f"{name}.constant_rotation"):
        constant = Rotation.from_matrix(data.array(f"{name}.constant_rotation", 9).reshape(3, 3))
    if not data.has(f"{name}.quaternions") and data.has(f"{name}.constant_rotation"):
        return None, lambda t: constant * Rotation.from_matrix(np.tile(np.eye(3), (len(t), 1, 1)))
    t = data.times(f"{name}.ephemeris_times") - centre_et
    quaternions = data.rows(name, "quaternions", 4, t)
    if (np.linalg.norm(quaternions, axis=1) == 0.0).any():
        raise data.refused(f"{name}.quaternions", "holds one of length 0")
    turns = Rotation.from_quat(quaternions, scalar_first=True)
    if len(t) == 1:
        return _Table(name, t), lambda at: constant * turns[np.zeros(len(at), dtype=np.intp)]
    slerp = Slerp(t, turns)
    rates = (turns[:-1].inv() * turns[1:])[[0, -1]].as_rotvec() / np.diff(t)[[0, -1], None]

    def at(when: Array) -> Rotation:
        inside = np.clip(when, t[0], t[-1])
        beyond = when - inside
        rate = np.where((beyond > 0.0)[:, None], rates[1], rates[0])
        return constant * slerp(inside) * Rotation.from_rotvec(beyond[:, None] * rate)

    return _Table(name, t), at


def _isd_position(data: CsmKeys, centre_et: float) -> tuple[_Table, Callable[[Array], Array]]:
    """Instants and positions (m, J2000) at any time of an ISD.

    Where velocities are given and go with the positions they are interpolated through too.
    """
    name = "instrument_position"
    t = data.times(f"{name}.ephemeris_times") - centre_et
    unit = data.metres(f"{name}.unit")
    position = unit * data.rows(name, "positions", 3, t)
    if data.has(f"{name}.velocities"):
        velocity = unit * data.rows(name, "velocities", 3, t)
        if len(t) > 1:
            way = np.diff(position, axis=0)
            lacking = way - 0.5 * np.diff(t)[:, None] * (velocity[:-1] + velocity[1:])
            if np.linalg.norm(lacking) <= _AGREE * np.linalg.norm(way):
                return _Table(name, t), lambda at: interpolate_hermite(t, position, velocity, at)
    return _Table(name, t), lambda at: interpolate(t, position, at)


def isd_radii(data: CsmKeys) -> tuple[float, float]:
    """Equatorial and polar radius of the body of an ISD, m."""
    unit = data.metres("radii.unit")
    return data.positive("radii.semimajor") * unit, data.positive("radii.semiminor") * unit


def body_fixed(data: CsmKeys, et: float) -> tuple[Array, Rotation]:
    """Position (3,) m and world_from_sensor of an ISD at one instant, s past J2000; body-fixed axes."""
    motion, _ = _isd_motion(data, et, np.zeros(1))
    return motion.position(np.zeros(1))[0], motion.world_from_sensor(np.zeros(1))[0]


def _isd_motion(data: CsmKeys, centre_et: float, line_times: Array) -> tuple[_Motion, tuple[str, ...]]:
    """Positions and attitudes of an ISD, turned from J2000 into body-fixed axes.

    ``body_rotation`` is body-fixed from J2000, ``instrument_pointing`` sensor from J2000.
    """
    for name in ("body_rotation", "instrument_pointing", "instrument_position"):
        frame = data.value(f"{name}.reference_frame", 1)
        if frame != 1:
            raise FormatError(f"{data.path}: {name} has reference_frame {frame!r:.40}; 1 (J2000) is read")
    body_table, body = _turning(data, "body_rotation", centre_et)
    pointing_table, pointing = _turning(data, "instrument_pointing", centre_et)
    place_table, place = _isd_position(data, centre_et)
    tables = [table for table in (pointing_table, place_table) if table is not None]
    asked = tables if body_table is None else [body_table, *tables]
    said = [table.check(data, line_times) for table in asked]
    motion = _Motion(
        _shared(tables),
        lambda t: body(t).apply(place(t)),
        lambda t: body(t) * pointing(t).inv(),
        _even(body, body_table, line_times),
    )
    return motion, tuple(f"{data.path.name}: {words}" for words in said if words)


def _even(
    body: Callable[[Array], Rotation], table: _Table | None, line_times: Array
) -> tuple[Array, Rotation]:
    """Instants and rotations of the body between which it turns evenly: two or more."""
    t = line_times[[0, -1]] if table is None or len(table.t) < 2 else table.t
    t = t if t[-1] > t[0] else np.array([t[0], t[0] + 1.0])
    return t, body(t)


def _state_motion(data: CsmKeys, _: float, line_times: Array) -> tuple[_Motion, tuple[str, ...]]:
    """Positions and attitudes of a model state: evenly spaced, body-fixed, quaternions scalar last."""
    if data.has("m_currentParameterValue") and data.numbers("m_currentParameterValue").any():
        raise FormatError(
            f"{data.path}: m_currentParameterValue holds adjustments, which are not read; apply them first"
        )
    flat = [(key, size, data.array(key, -1)) for key, size in _FLAT if key != "m_velocities" or data.has(key)]
    for key, size, values in flat:
        if len(values) % size:
            raise data.refused(key, f"holds {len(values)} numbers, no rows of {size}")
    rows = {key: values.reshape(-1, size) for key, size, values in flat}
    position, quaternions = rows["m_positions"], rows["m_quaternions"]
    velocity = rows.get("m_velocities")
    if velocity is not None and len(position) != len(velocity):
        raise FormatError(
            f"{data.path}: {len(position)} positions and {len(velocity)} velocities; one of each is expected"
        )
    if (np.linalg.norm(quaternions, axis=1) == 0.0).any():
        raise data.refused("m_quaternions", "holds one of length 0")
    signed = _one_side(quaternions)
    t_position = _evenly(data.number("m_t0Ephem"), data.positive("m_dtEphem"), len(position))
    t_attitude = _evenly(data.number("m_t0Quat"), data.positive("m_dtQuat"), len(quaternions))
    order = _LAGRANGE_OF_FEW if quaternions.size < _FEW else _LAGRANGE
    tables = (_Table("m_quaternions", t_attitude), _Table("m_positions", t_position))
    said = [table.check(data, line_times) for table in tables]
    motion = _Motion(
        _shared(tables),
        lambda t: lagrange(t_position, position, t, _LAGRANGE),
        lambda t: Rotation.from_quat(lagrange(t_attitude, signed, t, order)),
    )
    return motion, tuple(f"{data.path.name}: {words}" for words in said if words)


def _shared(tables: Sequence[_Table]) -> Array:
    """Instants of the first table in the time that all of them hold."""
    t = tables[0].t
    return t[(t >= max(table.t[0] for table in tables)) & (t <= min(table.t[-1] for table in tables))]


def _one_side(quaternions: Array) -> Array:
    """The same rotations, each quaternion on the side of the one before it."""
    turns = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    return quaternions * np.cumprod(np.concatenate([[1.0], np.where(turns < 0.0, -1.0, 1.0)]))[:, None]


def lagrange(nodes: Array, values: Array, t: Array, order: int) -> Array:
    """Values (A, K) at evenly spaced `nodes` (A,), at the times `t` (N,): (N, K).

    By the polynomial through the `order` nodes about each time; nearer to the ends than half of these lie,
    through so many as lie evenly about it: two in the first and last step, as ``usgscsm`` does.
    """
    count = len(nodes)
    if count == 1:
        return np.repeat(values, len(t), axis=0)
    place = (t - nodes[0]) / (nodes[-1] - nodes[0]) * (count - 1)
    index = np.clip(np.floor(place).astype(np.intp), 0, count - 2)
    half = np.minimum(np.minimum(index + 1, count - 1 - index), order // 2)
    out = np.zeros((len(t), values.shape[1]))
    for reach in np.unique(half):
        rows = np.flatnonzero(half == reach)
        first, x = index[rows] - reach + 1, place[rows]
        for a in range(2 * reach):
            weight = np.ones(len(rows))
            for b in range(2 * reach):
                if b != a:
                    weight *= (x - (first + b)) / (a - b)
            out[rows] += weight[:, None] * values[first + a]
    return out


def _evenly(start: float, step: float, count: int) -> Array:
    """`count` instants `step` apart."""
    return np.asarray(start + step * np.arange(count), dtype=np.float64)


def _assemble(
    motion: _Motion,
    plane: CsmFocalPlane,
    timing: _Timing,
    reference: tuple[float, float] | None,
    doubts: tuple[str, ...],
) -> LineScanModel:
    """The camera: body axes chosen, directions turned into camera axes, times counted from the reference."""
    line_times = timing.line_times()
    reference = reference or (timing.centre_et, float(line_times[0]))
    later = (timing.centre_et - reference[0]) - reference[1]
    nodes = _nodes(motion.nodes, line_times, float(timing.rates[0, 2]), float(timing.rates[-1, 2]))
    position, world_from_sensor = motion.position(nodes), motion.world_from_sensor(nodes)
    sensor_directions = plane.row(timing.samples)
    body_from_sensor = _body_axes(sensor_directions, nodes, position, world_from_sensor)
    directions = (NADIR_MOUNT.inv() * body_from_sensor).apply(sensor_directions)
    t, nodes = line_times + later, nodes + later
    steps = np.diff(line_times)
    period = float(steps.mean()) if len(steps) else float(timing.rates[0, 2])
    camera = PushbroomCamera(
        LineDetector("model", directions / np.linalg.norm(directions, axis=1)[:, None], period),
        Trajectory(nodes, position, nodes, world_from_sensor * body_from_sensor.inv()),
        FixedMount(),
        float(t[0]),
        timing.lines,
        line_times=None if len(timing.rates) == 1 else t,
    )
    over = plane.turned_over(timing.samples)
    if over is not None:
        doubts += (
            f"the radial distortion takes a pixel {over[0]:.3g} mm from the axis across it, to {over[1]:.3g} "
            "mm on its other side, as no lens does: are its coefficients those of another formula?",
        )
    body = None if motion.body is None else (motion.body[0] + later, motion.body[1])
    return LineScanModel(camera, timing.radii, reference, doubts, body)


def _nodes(given: Array, line_times: Array, before: float, after: float) -> Array:
    """Times at which the trajectory is known: those of all lines, and those of the table between and beyond.

    Poses of whole lines are then those of the model itself, whatever lies between the rows of its tables. So
    are those of some lines more on either side, `before` and `after` s apart, where the table reaches there.
    """
    more = np.arange(1.0, _MARGIN_LINES + 1.0)
    lines = np.concatenate([line_times[0] - before * more[::-1], line_times, line_times[-1] + after * more])
    held = np.zeros(len(lines), dtype=bool)
    if len(given):
        held = (lines >= given[0]) & (lines <= given[-1])
    held[_MARGIN_LINES:-_MARGIN_LINES] = True
    near = np.clip(np.searchsorted(lines, given), 1, len(lines) - 1)
    gap = np.minimum(np.abs(given - lines[near - 1]), np.abs(given - lines[near]))
    alone = gap > _SAME * np.diff(lines)[near - 1]
    return np.unique(np.concatenate([lines[held], given[alone]]))


def _body_axes(directions: Array, t: Array, position: Array, world_from_sensor: Rotation) -> Rotation:
    """body_from_sensor: z kept, x across the row of pixels on the side the sensor flies to."""
    row = directions[-1, :2] - directions[0, :2]
    length = np.linalg.norm(row)
    if length == 0.0:
        raise InputError("all columns look one way; are focal2pixel_samples or m_iTransS in pixels per mm?")
    across = np.array([-row[1], row[0], 0.0]) / length
    middle = min(len(t) // 2, max(len(t) - 2, 0))
    forward = across
    if len(t) > 1:
        flight = world_from_sensor[middle].inv().apply(position[middle + 1] - position[middle])
        forward = across if flight @ across > 0.0 else -across
    down = np.array([0.0, 0.0, 1.0])
    return Rotation.from_matrix(np.array([forward, np.cross(down, forward), down]))
