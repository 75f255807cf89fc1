"""A line-scan sensor model in our terms: what the readers of such files give, and how they make it.

A reader brings where the sensor is and how it is turned at any time, where each of its columns looks, and
when its lines are exposed.

Not here: reading files (``isd.py``, ``products/``), which reader a file is for (``sensor_model.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.trajectory import Trajectory

Array = NDArray[np.float64]

#: Lines and samples beyond which a file is damaged: no line scanner makes such images.
MOST_LINES, MOST_SAMPLES = 4_000_000, 1_000_000
#: Steps of a table by which positions and attitudes are continued beyond its ends, where lines lie there.
MOST_STEPS = 2.0
#: Lines beyond the image at whose times the trajectory is known too, where the tables reach there.
_MARGIN_LINES = 16
#: s within which the one instant of a table is that asked for: as far apart as instants near 1e9 s are told.
_INSTANT = 1e-5
#: Line periods within which an instant of a table and the time of a line are one.
_SAME = 1e-3


@dataclass(frozen=True)
class OneGrid:
    """Bands that their maker has resampled onto one virtual detector: they show all ground at one time.

    Attributes
    ----------
    of : str
        Bands of which this is the same share the virtual detector.
    reason : str
        What the file says of it, and what would do in its place.
    """

    of: str
    reason: str


def shared_grid(grids: Sequence[OneGrid | None]) -> OneGrid | None:
    """The one grid of all bands; None where some have none, or they have several."""
    found = [grid for grid in grids if grid is not None]
    return found[0] if found and len(found) == len(grids) and len({one.of for one in found}) == 1 else None


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
        The instant t = 0: s past 2000-01-01T12:00 of `scale` of the middle or begin of an image, and s from
        there.
    doubts : tuple of str
        What the file leaves open, and what was done about it.
    body : ((K,), Rotation) or None
        Instants (s from t = 0), and body-fixed from J2000 at each: it turns evenly between. None of states.
    scale : str
        ``"TDB"``, or ``"UTC"`` of products: their labels, leap seconds not counted.
    lacks : tuple of str
        Which of ``aberration``, ``light_time`` and ``refraction`` its attitudes do not hold, so that they are
        to be applied.
    one_grid : OneGrid or None
        Where bands of this model hold no motion against one another.
    padded : (int, int) or None
        Lines and columns of the file where it holds more than the image of `camera`, after its last line and
        column.
    """

    camera: PushbroomCamera
    radii: tuple[float, float]
    reference: tuple[float, float]
    doubts: tuple[str, ...] = ()
    body: tuple[Array, Rotation] | None = None
    scale: str = "TDB"
    lacks: tuple[str, ...] = ()
    one_grid: OneGrid | None = None
    padded: tuple[int, int] | None = None

    @property
    def reference_et(self) -> float | None:
        """s past J2000 (TDB), the instant t = 0; resolved to 6e-8 s. None of products."""
        return sum(self.reference) if self.scale == "TDB" else None


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """Where the sensor is and how it is turned, body-fixed, at any time.

    Attributes
    ----------
    nodes : (K,)
        s; instants of the file's own table.
    position : callable
        Of times (N,), s: (N, 3), m.
    world_from_sensor : callable
        Of times (N,), s: N rotations.
    body : ((K,), Rotation) or None
        As of `LineScanModel`.
    """

    nodes: Array
    position: Callable[[Array], Array]
    world_from_sensor: Callable[[Array], Rotation]
    body: tuple[Array, Rotation] | None = None


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants (s) of a table of the file, under its name."""

    name: str
    t: Array

    def check(self, line_times: Array, refused: Callable[[str, str], FormatError]) -> str | None:
        """What is said where lines lie up to two steps beyond it; more are refused.

        Parameters
        ----------
        line_times : (N,)
            s, in the same count as the table.
        refused : callable
            The error of a table (its name) for a reason.
        """
        first, last = float(line_times[0]), float(line_times[-1])
        early, late = self.t[0] - first, last - self.t[-1]
        if max(early, late) <= 0.0:
            return None
        if len(self.t) < 2 and max(early, late) <= _INSTANT:
            return None
        if len(self.t) < 2:
            raise refused(self.name, "has one instant, and another is asked for; two or more are needed")
        words = []
        for beyond, step, which in (
            (early, self.t[1] - self.t[0], "begins {} s after the first line"),
            (late, self.t[-1] - self.t[-2], "ends {} s before the last line"),
        ):
            if beyond > MOST_STEPS * step:
                raise refused(
                    self.name,
                    f"{which.format(f'{beyond:.6g}')}, {beyond / step:.3g} of its steps of {step:.6g} s; "
                    f"lines are exposed from {first:.6f} to {last:.6f} s after the centre of the image, the "
                    f"table holds {self.t[0]:.6f} to {self.t[-1]:.6f} s; {MOST_STEPS:g} steps are continued",
                )
            if beyond > 0.0:
                words.append(f"{which.format(f'{beyond:.4g}')} ({beyond / step:.2g} steps)")
        return f"{self.name} {' and '.join(words)}: continued evenly"


def shared_instants(tables: Sequence[Instants]) -> Array:
    """Instants of the first table in the time that all of them hold."""
    t = tables[0].t
    return t[(t >= max(table.t[0] for table in tables)) & (t <= min(table.t[-1] for table in tables))]


def assemble(
    motion: SensorMotion,
    directions: Array,
    line_times: Array,
    *,
    even: bool,
    later: float = 0.0,
    ends: tuple[float, float] | None = None,
) -> PushbroomCamera:
    """The camera of a sensor: body axes chosen, directions turned into camera axes.

    Parameters
    ----------
    motion : SensorMotion
    directions : (columns, 3)
        Where each column looks, sensor axes, of any length; z of all above 0.
    line_times : (lines,)
        s, centre of the exposure of each line, in the count of `motion`.
    even : bool
        Whether they are evenly spaced.
    later : float
        s from t = 0 of the camera to that of `motion`.
    ends : (float, float), optional
        s from line to line before the first and after the last; needed where there is one line.

    Returns
    -------
    PushbroomCamera

    Notes
    -----
    Body axes are chosen by what the sensor does: z along its boresight, x across its row of pixels to
    the side it flies. Columns may then increase to the left or to the right.
    """
    steps = np.diff(line_times)
    before, after = ends or (float(steps[0]), float(steps[-1]))
    nodes = _nodes(motion.nodes, line_times, before, after)
    position, world_from_sensor = motion.position(nodes), motion.world_from_sensor(nodes)
    body_from_sensor = _body_axes(directions, nodes, position, world_from_sensor)
    looks = (NADIR_MOUNT.inv() * body_from_sensor).apply(directions)
    t, nodes = line_times + later, nodes + later
    return PushbroomCamera(
        LineDetector(
            "model",
            looks / np.linalg.norm(looks, axis=1)[:, None],
            float(steps.mean()) if len(steps) else before,
        ),
        Trajectory(nodes, position, nodes, world_from_sensor * body_from_sensor.inv()),
        FixedMount(),
        float(t[0]),
        len(t),
        line_times=None if even else t,
    )


def of_size(camera: PushbroomCamera, shape: tuple[int, int]) -> PushbroomCamera:
    """The same camera for a file of more lines and columns, which follow after those of its image."""
    lines, columns = shape
    directions = camera.detector.directions_at(np.arange(float(columns)))
    times = None if camera.line_times is None else camera.times(np.arange(float(lines)))
    return replace(
        camera, detector=replace(camera.detector, directions=directions), lines=lines, line_times=times
    )


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


def one_side(quaternions: Array) -> Array:
    """The same rotations, each quaternion on the side of the one before it."""
    turns = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    return quaternions * np.cumprod(np.concatenate([[1.0], np.where(turns < 0.0, -1.0, 1.0)]))[:, None]
