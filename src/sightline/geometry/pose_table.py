"""Poses of a camera at successive image lines, as the compiled loops read them.

Attitude is evaluated once per line, by ``Rotation``; everything per pixel works on the numbers kept here.

Not here: which lines, and when they are exposed (``camera.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.geometry.camera_kernels import ROW
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen, read_only
from sightline.geometry.interpolation import POINTS, interpolate
from sightline.geometry.pointing import FixedMount, Pointing, pointing_matrices
from sightline.geometry.trajectory import Trajectory


def camera_poses(
    t: Array,
    trajectory: Trajectory,
    pointing: Pointing,
    lever_arm: Array,
    around: Array | None = None,
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
        world_from_camera = world_from_body @ pointing.body_from_camera.as_matrix()
    else:
        world_from_camera = world_from_body @ pointing_matrices(pointing, t)
    return world_from_camera, pose.position + world_from_body @ lever_arm


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
    ) -> PoseTable:
        """Table for the exposure times `t` (R,), s, of the lines first, first + 1, ...

        `around` (K,): s from each to the stages of its pixels.

        Fewer lines than a cubic needs become samples of the polynomial through them.
        """
        world_from_camera, position = camera_poses(t, trajectory, pointing, lever_arm, around)
        origin = position.mean(axis=0)
        rows = np.empty((len(t), ROW))
        rows[:, :9] = world_from_camera.reshape(-1, 9)
        rows[:, 9:] = position - origin
        if len(rows) < POINTS:
            nodes, places = np.arange(float(len(rows))), np.arange(float(POINTS))
            rows = interpolate(read_only(nodes), read_only(rows), read_only(places))
        return cls(first, first + len(t) - 1, frozen(rows), frozen(origin))
