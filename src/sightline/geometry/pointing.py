"""How camera axes sit in the body: fixed, or through a mirror that turns.

At any instant the relation is linear, so three unit vectors say all of it (`pointing_matrices`).

Not here: motion of the body (``trajectory.py``); a spinning platform is a Trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, SpanError
from sightline.geometry.checks import (
    Array,
    ReadOnlyArrays,
    as_points,
    as_times,
    as_vector,
    frozen,
    positive,
    same_length,
)
from sightline.geometry.interpolation import interpolate
from sightline.geometry.rotations import NADIR_MOUNT


class Pointing(Protocol):
    """How camera axes sit in the body: fixed mount, scan mirror, ..."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time (s) at which it is known."""
        ...

    def to_body(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in camera axes at times t (N,), in body axes."""
        ...

    def to_camera(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in body axes at times t (N,), in camera axes."""
        ...


@dataclass(frozen=True, eq=False)
class FixedMount:
    """A camera bolted to the body.

    Attributes
    ----------
    body_from_camera : Rotation
        One rotation; the nominal mount unless given (lines forward, columns to the left).
    """

    body_from_camera: Rotation = NADIR_MOUNT

    def __post_init__(self) -> None:
        """Refuse a stack of rotations."""
        if not self.body_from_camera.single:
            raise InputError(
                f"`body_from_camera` must be one rotation, got {len(self.body_from_camera)}; use rotation[0]"
            )

    @property
    def span(self) -> tuple[float, float]:
        """All times."""
        return -np.inf, np.inf

    def to_body(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in camera axes, in body axes; the same at all times."""
        return np.asarray(as_points(directions, "directions") @ self.body_from_camera.as_matrix().T)

    def to_camera(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in body axes, in camera axes; the same at all times."""
        return np.asarray(as_points(directions, "directions") @ self.body_from_camera.as_matrix())


@dataclass(frozen=True, eq=False)
class ScanMirror(ReadOnlyArrays):
    """A camera that looks at the scene through a plane mirror that turns about an axis (S1, fig. 17).

    Attributes
    ----------
    body_from_camera : Rotation
        How the camera itself sits in the body.
    axis : (3,)
        Axis of rotation of the mirror, body axes; normalised on construction.
    normal : (3,)
        Normal of the mirror at angle 0, body axes; normalised on construction.
    t : (K,)
        s from the epoch, strictly increasing.
    angle : (K,)
        rad; of the mirror about `axis`, at each `t`; cubic between.

    Notes
    -----
    A mirror turns the image over: the matrix from camera to body has det = -1, and columns run the other way
    on the ground. The mirror stands at the entrance pupil: it moves no origin.
    """

    body_from_camera: Rotation
    axis: Array
    normal: Array
    t: Array
    angle: Array

    def __post_init__(self) -> None:
        """Check, normalise and freeze."""
        for name in ("axis", "normal"):
            vector = as_vector(getattr(self, name), name)
            length = float(np.sqrt((vector**2).sum()))
            positive(length, f"length of {name}")
            object.__setattr__(self, name, frozen(vector / length))
        object.__setattr__(self, "t", frozen(as_times(self.t, "t", increasing=True)))
        object.__setattr__(self, "angle", frozen(as_times(self.angle, "angle")))
        same_length(self.t, "t", self.angle, "angle")

    @property
    def span(self) -> tuple[float, float]:
        """First and last time (s) of the table of angles."""
        return float(self.t[0]), float(self.t[-1])

    def _reflect(self, directions: Array, t: Array) -> Array:
        """Mirror images of body `directions` (N, 3) at times `t` (N,)."""
        times = as_times(t)
        if len(times) and not self.t[0] <= times.min() <= times.max() <= self.t[-1]:
            raise SpanError(
                f"the mirror angle is known for t = [{self.t[0]:.6f}, {self.t[-1]:.6f}] s, asked for "
                f"[{times.min():.6f}, {times.max():.6f}] s; supply a longer table"
            )
        angle = interpolate(self.t, self.angle[:, np.newaxis], times)
        normals = Rotation.from_rotvec(angle * self.axis).apply(np.array(self.normal))
        inner = (directions * normals).sum(axis=1, keepdims=True)
        return np.asarray(directions - 2.0 * inner * normals)

    def to_body(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in camera axes at times t (N,), in body axes after the mirror."""
        before = as_points(directions, "directions") @ self.body_from_camera.as_matrix().T
        return self._reflect(before, t)

    def to_camera(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in body axes at times t (N,), in camera axes before the mirror."""
        return np.asarray(
            self._reflect(as_points(directions, "directions"), t) @ self.body_from_camera.as_matrix()
        )


@dataclass(frozen=True, eq=False)
class TurnedBody:
    """A pointing given in other axes of the same body.

    Attributes
    ----------
    pointing : Pointing
        In the body axes it was given in.
    body_from_other : Rotation
        From the other axes to those.
    """

    pointing: Pointing
    body_from_other: Rotation

    @property
    def span(self) -> tuple[float, float]:
        """That of the pointing."""
        return self.pointing.span

    def to_body(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in camera axes at times t (N,), in the other axes."""
        return np.asarray(self.pointing.to_body(directions, t) @ self.body_from_other.as_matrix())

    def to_camera(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in the other axes at times t (N,), in camera axes."""
        return self.pointing.to_camera(
            as_points(directions, "directions") @ self.body_from_other.as_matrix().T, t
        )


def turned_pointing(pointing: Pointing, body_from_other: Rotation) -> Pointing:
    """The same pointing in other body axes; a fixed mount stays one."""
    if isinstance(pointing, FixedMount):
        return FixedMount(body_from_other.inv() * pointing.body_from_camera)
    return TurnedBody(pointing, body_from_other)


def pointing_matrices(pointing: Pointing, t: Array) -> Array:
    """Matrices body_from_camera at times `t` (N,): (N, 3, 3); det = -1 behind an odd number of mirrors."""
    times = as_times(t)
    columns = []
    for axis in np.eye(3):
        column = pointing.to_body(np.tile(axis, (len(times), 1)), times)
        same_length(times, "t", column, "pointing.to_body(...)")
        columns.append(column)
    return np.stack(columns, axis=-1)
