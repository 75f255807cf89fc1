"""Poses of a camera at successive image lines, as the compiled loops read them.

Attitude is evaluated once per line, by ``Rotation``; everything per pixel works on the numbers kept here.

Not here: which lines, and when they are exposed (``camera.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.execution import slices
from sightline.geometry.camera_kernels import ROW
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen, read_only
from sightline.geometry.interpolation import POINTS, interpolate
from sightline.geometry.pointing import FixedMount, Pointing, pointing_matrices
from sightline.geometry.trajectory import MeanPose, Trajectory
from sightline.writing import let_go, scratch_array

#: Lines whose poses are found at a time.
_AT_ONCE = 16384


def camera_poses(
    t: Array,
    trajectory: Trajectory,
    pointing: Pointing,
    lever_arm: Array,
    around: Array | None = None,
    lean: float = 0.0,
) -> tuple[Array, Array]:
    """Camera axes and entrance pupil at times `t` (M,).

    Parameters
    ----------
    t : (M,)
        s from the epoch.
    trajectory : Trajectory
        Of the body.
    pointing : Pointing
        How camera axes sit in the body.
    lever_arm : (3,)
        m, body axes.
    around : (K,), optional
        s; the attitude is the mean of those so much later than each of `t`.
    lean : float
        1/s; by how much of a tangent what looks later looks toward smaller lines. A turn about the line of
        sight that grows meanwhile moves its columns, as one about the axis of lines does.

    Returns
    -------
    world_from_camera : (M, 3, 3)
        Matrices; det = -1 behind an odd number of mirrors.
    position : (M, 3)
        m, world axes.
    """
    pose = trajectory.at(t) if around is None else trajectory.mean_at(t, around)
    world_from_body = pose.world_from_body.as_matrix()
    if isinstance(pointing, FixedMount):
        body_from_camera = pointing.body_from_camera.as_matrix()[np.newaxis]
    else:
        body_from_camera = pointing_matrices(pointing, t)
    world_from_camera = world_from_body @ body_from_camera
    if isinstance(pose, MeanPose):
        # about the line of sight; mirrors turn the other way round
        turning = np.linalg.det(body_from_camera) * (body_from_camera[..., 2] * pose.moment).sum(axis=-1)
        world_from_camera = world_from_camera @ _about_lines(lean * turning)
    return world_from_camera, pose.position + world_from_body @ lever_arm


def _about_lines(angle: Array) -> Array:
    """Turns (M, 3, 3) by `angle` (M,) rad about the camera's y, towards larger lines."""
    out = np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 2, 2] = np.cos(angle)
    out[:, 0, 2], out[:, 2, 0] = np.sin(angle), -np.sin(angle)
    out[:, 1, 1] = 1.0
    return out


@dataclass(frozen=True, eq=False)
class PoseTable(ReadOnlyArrays):
    """Camera poses at successive image lines.

    Attributes
    ----------
    first, last : int
        Lines of the first and the last pose.
    rows : (R, 12)
        world_from_camera row by row, then position less `origin`, m.
    origin : (3,)
        m, world axes.
    """

    first: int
    last: int
    rows: Array
    origin: Array

    @classmethod
    def of(
        cls,
        first: int,
        t: Array,
        trajectory: Trajectory,
        pointing: Pointing,
        lever_arm: Array,
        around: Array | None = None,
        lean: float = 0.0,
    ) -> PoseTable:
        """Table for the exposure times `t` (R,), s, of the lines first, first + 1, ...

        `around` (K,): s from each to the stages of its pixels; `lean`: see `camera_poses`.

        Fewer lines than a cubic needs become samples of the polynomial through them.
        """
        rows, total = scratch_array((len(t), ROW)), np.zeros((1, 3))
        for some in slices(len(t), _AT_ONCE):
            attitude, rows[some, 9:] = camera_poses(t[some], trajectory, pointing, lever_arm, around, lean)
            rows[some, :9] = attitude.reshape(-1, 9)
            # as of all at once: down a column one row is added after the other
            total = np.concatenate([total, rows[some, 9:]]).sum(axis=0, keepdims=True)
            let_go()
        origin = total[0] / len(t)
        for some in slices(len(t), _AT_ONCE):
            rows[some, 9:] -= origin
            let_go()
        if len(rows) < POINTS:
            nodes, places = np.arange(float(len(rows))), np.arange(float(POINTS))
            rows = interpolate(read_only(nodes), read_only(rows), read_only(places))
        rows.setflags(write=False)  # nobody else has it: not copied
        return cls(first, first + len(t) - 1, frozen(rows), frozen(origin))
