"""What a recovered strip gives to other programs: poses of its lines, what the motion moved pixels by.

Not here: the formats (``io/formats/``), rational functions in the place of a camera (``products/rpc.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.interpolation import interpolate
from sightline.geometry.surface import Surface

Array = NDArray[np.float64]

#: Lines beyond the image on either side whose poses are given too, where they are known.
MARGIN_LINES = 4
#: States at most, in lines of the image.
MOST_STATES = 8
#: Columns at which shifts are computed; those between follow by the local cubic.
_COLUMNS = 65


@dataclass(frozen=True, eq=False)
class LineStates:
    """Where a camera is and how it is turned, at evenly spaced instants.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    position, velocity : (N, 3)
        m, m/s, world axes: of the entrance pupil.
    world_from_camera : Rotation
        N rotations. Camera axes: x towards increasing columns, y towards increasing lines, z to the scene.
    """

    t: Array
    position: Array
    velocity: Array
    world_from_camera: Rotation


def line_states(camera: PushbroomCamera) -> LineStates:
    """States of a camera at every line of its image, and of some lines beyond where they are known.

    Where lines are not evenly spaced in time, at instants as far apart as the nearest two.

    Parameters
    ----------
    camera : PushbroomCamera
        All columns of a line share its pose: TDI stages may not differ by column.

    Returns
    -------
    LineStates

    Raises
    ------
    InputError
        If columns have their own times.
    """
    if camera.stages is not None and len(np.unique(camera.stages)) > 1:
        raise InputError(
            f"{camera.detector.name}: TDI stages differ from column to column, with them times and "
            "the mean attitude of a line's pixels; one pose per line holds none: give --to shifts or rpc"
        )
    low, high = camera.known_lines
    first = max(-MARGIN_LINES, int(np.ceil(low)))
    last = min(camera.lines - 1 + MARGIN_LINES, int(np.floor(high)))
    t = camera.times(np.arange(first, last + 1, dtype=np.float64))
    if camera.line_times is not None and len(t) > 1:
        steps = np.diff(t)
        count = (t[-1] - t[0]) / steps.min()
        if not count <= MOST_STATES * len(t):
            raise InputError(
                f"{camera.detector.name}: lines are {steps.min():g} s to {np.median(steps):g} s apart (the "
                "least, the usual); even states as near as the nearest two would be too many: mend the line "
                "times"
            )
        t = np.linspace(t[0], t[-1], int(np.ceil(count)) + 1)
    return states_at(camera, t)


def states_at(camera: PushbroomCamera, t: Array) -> LineStates:
    """States of a camera at instants `t` (N,), s from the epoch, within the lines that have rays."""
    if camera.line_times is None:
        lines = (t - camera.first_line_time) / camera.detector.line_period
    else:
        around = np.arange(-MARGIN_LINES, camera.lines + MARGIN_LINES, dtype=np.float64)
        lines = np.interp(t, camera.times(around), around)
    position, turn = poses_of(camera, np.clip(lines, *camera.known_lines))
    velocity = rates(position, t)
    return LineStates(np.asarray(t, dtype=np.float64), position, velocity, turn)


def poses_of(camera: PushbroomCamera, lines: Array) -> tuple[Array, Rotation]:
    """Entrance pupil (N, 3) m and world_from_camera of `lines` (N,), from where their end columns look."""
    last = camera.columns - 1.0
    ends = [camera.rays(np.column_stack([lines, np.full(len(lines), column)])) for column in (0.0, last)]
    known = camera.detector.directions_at([0.0, last])
    seen = _triads(ends[0].directions, ends[1].directions)
    own = _triads(known[:1], known[1:])
    return ends[0].origins, Rotation.from_matrix(seen @ own.transpose(0, 2, 1))


def _triads(a: Array, b: Array) -> Array:
    """Orthonormal axes (N, 3, 3), as columns, of pairs of directions."""
    middle = a + b
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    across = (b - a) - ((b - a) * middle).sum(axis=1, keepdims=True) * middle
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([middle, across, np.cross(middle, across)], axis=-1)


def without_motion(camera: PushbroomCamera) -> PushbroomCamera:
    """The same camera on its reference attitude."""
    return camera.with_trajectory(camera.trajectory.with_motion(None))


def motion_shifts(camera: PushbroomCamera, surface: Surface, lines: Array) -> Array:
    """What the recovered motion moved pixels by.

    Parameters
    ----------
    camera : PushbroomCamera
        With the recovered motion.
    surface : Surface
        What its rays meet.
    lines : (N,)
        Of the image.

    Returns
    -------
    (N, columns, 2)
        px, lines and columns: where the ground that a pixel shows would be without the motion, less where the
        pixel is; NaN where that is not known.
    """
    still = without_motion(camera)
    columns = np.unique(np.rint(np.linspace(0.0, camera.columns - 1.0, min(_COLUMNS, camera.columns))))
    grid = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    moved = still.project(camera.locate(grid, surface), line_margin=float(MARGIN_LINES)) - grid
    coarse = moved.reshape(len(lines), len(columns), 2).transpose(1, 0, 2).reshape(len(columns), -1)
    fine = interpolate(columns, np.ascontiguousarray(coarse), np.arange(float(camera.columns)))
    return fine.reshape(camera.columns, len(lines), 2).transpose(1, 0, 2)


def rates(values: Array, t: Array) -> Array:
    """Change per second of rows (N, C) at `t` (N,): of second order at the ends too; 0 of one row."""
    if len(t) < 2:
        return np.zeros_like(values)
    return np.asarray(np.gradient(values, t, axis=0, edge_order=2 if len(t) > 2 else 1))
