"""USGS CSM line-scan sensor models → PushbroomCamera: image support data (ISD) and model states.

An ISD holds positions and attitudes in J2000 and the rotation of the body; a model state holds
them in body-fixed axes already. Both are evaluated at the time of every line as the library ``usgscsm`` and
ALE, which write them, do: attitudes of an ISD by slerp, positions through their velocities, both of a state
by Lagrange's polynomial through the eight nearest.

Not here: the focal plane and its distortion (``focal_plane.py``), the camera made of it (``line_scan.py``),
frame cameras (``isd_frame.py``), writing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError, reads
from sightline.geometry.interpolation import interpolate, interpolate_hermite
from sightline.io.formats.csm_keys import LINE_SCANNER, CsmKeys, read_keys
from sightline.io.formats.focal_plane import isd_plane, state_plane
from sightline.io.formats.line_scan import (
    MOST_LINES,
    MOST_SAMPLES,
    Instants,
    LineScanModel,
    SensorMotion,
    assemble,
    lagrange,
    one_side,
    shared_instants,
)

Array = NDArray[np.float64]

#: Share of the way between two positions by which velocities may disagree with them and still be used.
_AGREE = 0.01
#: Lists of a model state that hold rows one after the other, and the length of these.
_FLAT = (("m_positions", 3), ("m_velocities", 3), ("m_quaternions", 4))
#: Nodes of the polynomial by which a state is interpolated: of platforms of kind 1, of 0, where its table
#: holds few quaternions (``usgscsm`` counts their numbers).
_LAGRANGE, _LAGRANGE_OF_0, _FEW, _LAGRANGE_OF_FEW = 8, 4, 6, 4


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

    """
    data = read_keys(path, LINE_SCANNER)
    timing = (_state_timing if data.is_state else _isd_timing)(data)
    plane = (state_plane if data.is_state else isd_plane)(data)
    motion, doubts = (_state_motion if data.is_state else _isd_motion)(
        data, timing.centre_et, timing.line_times()
    )
    line_times = timing.line_times()
    reference = reference or (timing.centre_et, float(line_times[0]))
    later = (timing.centre_et - reference[0]) - reference[1]
    camera = assemble(
        motion,
        plane.row(timing.samples),
        line_times,
        even=len(timing.rates) == 1,
        later=later,
        ends=(float(timing.rates[0, 2]), float(timing.rates[-1, 2])),
    )
    over = plane.turned_over(timing.samples)
    if over is not None:
        doubts += (
            f"the radial distortion takes a pixel {over[0]:.3g} mm from the axis across it, to {over[1]:.3g} "
            "mm on its other side, as no lens does: are its coefficients those of another formula?",
        )
    body = None if motion.body is None else (motion.body[0] + later, motion.body[1])
    return LineScanModel(camera, timing.radii, reference, doubts, body)


def _isd_timing(data: CsmKeys) -> _Timing:
    """Timing of an ISD."""
    return _checked(
        data,
        "line_scan_rate",
        _Timing(
            data.count("image_lines", 1, MOST_LINES),
            data.count("image_samples", 1, MOST_SAMPLES),
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
            data.count("m_nLines", 1, MOST_LINES),
            data.count("m_nSamples", 1, MOST_SAMPLES),
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


def _turning(
    data: CsmKeys, name: str, centre_et: float
) -> tuple[Instants | None, Callable[[Array], Rotation]]:
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
        return Instants(name, t), lambda at: constant * turns[np.zeros(len(at), dtype=np.intp)]
    slerp = Slerp(t, turns)
    rates = (turns[:-1].inv() * turns[1:])[[0, -1]].as_rotvec() / np.diff(t)[[0, -1], None]

    def at(when: Array) -> Rotation:
        inside = np.clip(when, t[0], t[-1])
        beyond = when - inside
        rate = np.where((beyond > 0.0)[:, None], rates[1], rates[0])
        return constant * slerp(inside) * Rotation.from_rotvec(beyond[:, None] * rate)

    return Instants(name, t), at


def _isd_position(data: CsmKeys, centre_et: float) -> tuple[Instants, Callable[[Array], Array]]:
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
                return Instants(name, t), lambda at: interpolate_hermite(t, position, velocity, at)
    return Instants(name, t), lambda at: interpolate(t, position, at)


def isd_radii(data: CsmKeys) -> tuple[float, float]:
    """Equatorial and polar radius of the body of an ISD, m."""
    unit = data.metres("radii.unit")
    return data.positive("radii.semimajor") * unit, data.positive("radii.semiminor") * unit


def body_fixed(data: CsmKeys, et: float) -> tuple[Array, Rotation]:
    """Position (3,) m and world_from_sensor of an ISD at one instant, s past J2000; body-fixed axes."""
    motion, _ = _isd_motion(data, et, np.zeros(1))
    return motion.position(np.zeros(1))[0], motion.world_from_sensor(np.zeros(1))[0]


def _isd_motion(data: CsmKeys, centre_et: float, line_times: Array) -> tuple[SensorMotion, tuple[str, ...]]:
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
    said = [table.check(line_times, data.refused) for table in asked]
    motion = SensorMotion(
        shared_instants(tables),
        lambda t: body(t).apply(place(t)),
        lambda t: body(t) * pointing(t).inv(),
        _even(body, body_table, line_times),
    )
    return motion, tuple(f"{data.path.name}: {words}" for words in said if words)


def _even(
    body: Callable[[Array], Rotation], table: Instants | None, line_times: Array
) -> tuple[Array, Rotation]:
    """Instants and rotations of the body between which it turns evenly: two or more."""
    t = line_times[[0, -1]] if table is None or len(table.t) < 2 else table.t
    t = t if t[-1] > t[0] else np.array([t[0], t[0] + 1.0])
    return t, body(t)


def _state_motion(data: CsmKeys, _: float, line_times: Array) -> tuple[SensorMotion, tuple[str, ...]]:
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
    signed = one_side(quaternions)
    t_position = _evenly(data.number("m_t0Ephem"), data.positive("m_dtEphem"), len(position))
    t_attitude = _evenly(data.number("m_t0Quat"), data.positive("m_dtQuat"), len(quaternions))
    usual = _LAGRANGE_OF_0 if data.has("m_platformFlag") and data.number("m_platformFlag") == 0 else _LAGRANGE
    order = _LAGRANGE_OF_FEW if quaternions.size < _FEW else usual
    tables = (Instants("m_quaternions", t_attitude), Instants("m_positions", t_position))
    said = [table.check(line_times, data.refused) for table in tables]
    motion = SensorMotion(
        shared_instants(tables),
        lambda t: lagrange(t_position, position, t, usual),
        lambda t: Rotation.from_quat(lagrange(t_attitude, signed, t, order)),
    )
    return motion, tuple(f"{data.path.name}: {words}" for words in said if words)


def _evenly(start: float, step: float, count: int) -> Array:
    """`count` instants `step` apart."""
    return np.asarray(start + step * np.arange(count), dtype=np.float64)
