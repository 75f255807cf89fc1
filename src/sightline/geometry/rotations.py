"""How axes are turned: the nominal mount, roll-pitch-yaw and quaternions at the border, orbital axes.

All algebra is scipy's ``Rotation``. Names say the direction:
``v_target = target_from_source.apply(v_source)``.

Not here: attitude against time (``trajectory.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, as_points, same_length

#: body_from_camera of the nominal mount: lines increase forward, hence columns increase to the left. Camera x
#: (columns) is body -y, camera y (lines) is body +x, the optical axes agree. The only image not mirrored.
NADIR_MOUNT: Rotation = Rotation.from_matrix([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def from_roll_pitch_yaw(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Rotation:
    """Attitude from large angles: yaw about z, then pitch about the new y, then roll about the new x.

    Parameters
    ----------
    roll, pitch, yaw : scalar or (N,)
        rad.

    Returns
    -------
    Rotation
        reference_from_body: the aerospace order, ``Rotation.from_euler("ZYX", [yaw, pitch, roll])``.
    """
    angles = np.stack(np.broadcast_arrays(yaw, pitch, roll), axis=-1).astype(np.float64)
    return Rotation.from_euler("ZYX", angles)


def to_roll_pitch_yaw(rotation: Rotation) -> Array:
    """Inverse of `from_roll_pitch_yaw`: (N, 3) or (3,) rad, in the order roll, pitch, yaw."""
    return np.ascontiguousarray(rotation.as_euler("ZYX")[..., ::-1])


def from_quat_xyzw(quat_xyzw: ArrayLike, name: str = "quat_xyzw") -> Rotation:
    """Attitudes from quaternions of a file or table, scalar last.

    Parameters
    ----------
    quat_xyzw : (N, 4)
        Unit quaternions; a departure of 1e-3 from unit length (rounded digits) is forgiven.
    name : str
        Argument name for the message.

    Returns
    -------
    Rotation
        N rotations.

    Raises
    ------
    InputError
        Wrong shape, not finite, or not of unit length.
    """
    array = np.atleast_2d(np.asarray(quat_xyzw, dtype=np.float64))
    if array.ndim != 2 or array.shape[1] != 4:
        raise InputError(f"`{name}` must have shape (N, 4) as (x, y, z, w), got {array.shape}")
    norm = np.sqrt((array**2).sum(axis=1))
    wrong = ~(np.abs(norm - 1.0) < 1e-3)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"`{name}` must be unit quaternions (x, y, z, w), scalar last: "
            f"row {row} has length {norm[row]:.6g}"
        )
    return Rotation.from_quat(array)


def to_quat_xyzw(rotation: Rotation) -> Array:
    """Quaternions (N, 4), scalar last, with signs that run on: neighbours have a positive product."""
    quat = np.atleast_2d(rotation.as_quat()).copy()
    flips = np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0
    quat[1:][np.cumsum(flips) % 2 == 1] *= -1.0
    return quat


def orbital_axes(position: ArrayLike, velocity: ArrayLike) -> Rotation:
    """Attitude of a platform that looks straight down and flies forward.

    Parameters
    ----------
    position, velocity : (N, 3)
        m and m/s. To fly along the track over the ground give the velocity relative to the ground.

    Returns
    -------
    Rotation
        world_from_body: z towards the origin of the world axes, x forward, y to the right.
    """
    position, velocity = as_points(position, "position"), as_points(velocity, "velocity")
    same_length(position, "position", velocity, "velocity")
    down = -position / np.sqrt((position**2).sum(axis=1, keepdims=True))
    right = np.cross(down, velocity)
    right /= np.sqrt((right**2).sum(axis=1, keepdims=True))
    return Rotation.from_matrix(np.stack([np.cross(right, down), right, down], axis=-1))
