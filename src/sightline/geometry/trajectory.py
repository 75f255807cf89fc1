"""Where the platform is and how it is turned against time: Pose, Motion, Trajectory.

Positions, attitudes and motion keep their own clocks. ``at`` never extrapolates.

Not here: estimating any of it (``motion/``), or how the camera sits in the body (``pointing.py``).
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, SpanError
from sightline.geometry.checks import (
    Array,
    ReadOnlyArrays,
    as_points,
    as_times,
    as_vector,
    finite,
    frozen,
    positive,
    same_length,
)
from sightline.geometry.interpolation import interpolate, interpolate_hermite, stencils
from sightline.writing import let_go, scratch_array

#: Times this close beyond a span count as its end (s): ten times the float64 step of t at one day.
TIME_SLACK = 1e-10
#: Tables of reference poses that a trajectory keeps: two for each number of stages of each band, and fewer
#: where they are long, so that poses of 56 bytes stay below 12 MB; and the shortest (rows) kept at all.
_KEPT, _KEPT_ROWS, _WORTH_KEEPING = 64, 200_000, 200
#: Held while tables are kept and dropped: threads share them.
_KEEPING = threading.Lock()


def _departed(reference: Rotation, angles: Array) -> Rotation:
    """Rotations (M,), each after that by its row of `angles` (M, 3) rad: ``*`` takes ten times as long."""
    (x, y, z, w), (a, b, c, d) = reference.as_quat().T, Rotation.from_rotvec(angles).as_quat().T
    product = (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )
    return Rotation.from_quat(np.stack(product, axis=1))


def _check_span(t: Array, span: tuple[float, float], what: str) -> None:
    """Raise SpanError if a time lies outside `span`; `what` names what would have to be longer."""
    outside = (t < span[0] - TIME_SLACK) | (t > span[1] + TIME_SLACK)
    if outside.any():
        worst = float(t[np.argmax(np.maximum(span[0] - t, t - span[1]))])
        side = "from" if worst < span[0] else "up to"
        raise SpanError(
            f"{what} is not known at t = {worst:.6f} s: its span is [{span[0]:.6f}, {span[1]:.6f}] s and it "
            f"is never extrapolated; supply it {side} {worst:.6f} s or ask within the span"
        )


@dataclass(frozen=True, eq=False)
class Motion(ReadOnlyArrays):
    """Small departures of the body from its reference attitude, against time.

    Attributes
    ----------
    t : (N,)
        s from the epoch, strictly increasing.
    angles : (N, 3)
        rad; roll, pitch, yaw = rotation vector in body axes.
    covariance : (N, 3, 3) or None
        rad^2; None when exact (simulated truth).

    Notes
    -----
    actual world_from_body = reference world_from_body * Rotation.from_rotvec(angles).

    Examples
    --------
    >>> motion = Motion([0.0, 1.0], [[0.0, 0.0, 0.0], [1e-5, 0.0, 0.0]])
    >>> motion.at(0.5).tolist()
    [[5e-06, 0.0, 0.0]]
    """

    t: Array
    angles: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "t", frozen(as_times(self.t, "t", increasing=True)))
        object.__setattr__(self, "angles", frozen(as_points(self.angles, "angles")))
        same_length(self.t, "t", self.angles, "angles")
        if len(self.t) == 0:
            raise InputError("`t` of a Motion is empty: give at least one time with its angles")
        if not np.isfinite(self.angles).all():
            row = int(np.flatnonzero(~np.isfinite(self.angles).all(axis=1))[0])
            raise InputError(f"`angles` of a Motion must be finite: row {row} is {self.angles[row].tolist()}")
        if self.covariance is not None:
            covariance = frozen(self.covariance)
            if covariance.shape != (len(self.t), 3, 3):
                raise InputError(
                    f"`covariance` must have shape ({len(self.t)}, 3, 3) in rad^2, got {covariance.shape}"
                )
            object.__setattr__(self, "covariance", covariance)

    @classmethod
    def zero(cls, t0: float, t1: float) -> Motion:
        """No departure between two times (s)."""
        return cls(np.array([t0, t1]), np.zeros((2, 3)))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.t[0]), float(self.t[-1])

    def at(self, t: ArrayLike) -> Array:
        """Angles at times `t` (N,): (N, 3) rad, by the cubic through the four nearest nodes.

        Raises
        ------
        SpanError
            A time lies outside the span.
        """
        times = as_times(t)
        _check_span(times, self.span, "the motion")
        return interpolate(self.t, self.angles, times)

    def covariance_at(self, t: ArrayLike) -> Array | None:
        """Covariance at times `t` (N,): (N, 3, 3) rad^2, linear between nodes; None when exact."""
        times = as_times(t)
        _check_span(times, self.span, "the motion")
        if self.covariance is None:
            return None
        flat = self.covariance.reshape(len(self.t), 9)
        return np.stack([np.interp(times, self.t, flat[:, k]) for k in range(9)], axis=1).reshape(-1, 3, 3)

    def __sub__(self, other: Motion) -> Motion:
        """Difference at the times of `self` (error = estimate - truth); covariances add."""
        angles = self.angles - other.at(self.t)
        parts = [c for c in (self.covariance, other.covariance_at(self.t)) if c is not None]
        return Motion(self.t, angles, sum(parts[1:], parts[0]) if parts else None)

    def shifted(self, angles: ArrayLike) -> Motion:
        """The same motion plus constant `angles` (roll, pitch, yaw; rad)."""
        # a dozen turned cameras are held at a time: of a long strip their motions are more than all else
        shifted = scratch_array(self.angles.shape)
        np.add(self.angles, as_vector(angles, "angles"), out=shifted)
        shifted.setflags(write=False)  # nobody else has it: not copied
        motion = replace(self, angles=shifted)
        let_go()
        return motion


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the body is and how it is turned, at M instants.

    Attributes
    ----------
    position : (M, 3)
        m, world axes.
    world_from_body : Rotation
        M rotations.
    """

    position: Array
    world_from_body: Rotation


@dataclass(frozen=True, eq=False)
class MeanPose(Pose):
    """A pose whose attitude is a mean over some time.

    Attributes
    ----------
    moment : (M, 3)
        rad s, body axes; mean of the turns from the middle, each times how much later it is.
    """

    moment: Array


@dataclass(frozen=True, eq=False)
class Trajectory(ReadOnlyArrays):
    """Position and attitude of the platform as functions of time.

    Attributes
    ----------
    t_position : (P,)
        s from the epoch, strictly increasing.
    position : (P, 3)
        m, world axes.
    t_attitude : (A,)
        s from the epoch, strictly increasing.
    world_from_body : Rotation
        A rotations, the reference attitude.
    motion : Motion or None
        Departure from the reference attitude, applied on the body side.
    epoch : str or None
        UTC, ISO 8601: the instant t = 0; None for a simulation.
    velocity : (P, 3) or None
        m/s, world axes. Where given, positions are interpolated through it too.

    Notes
    -----
    Positions follow the cubic through the four nearest nodes (with velocities the polynomial of degree 7
    through both). Attitudes do the same in the rotation vectors of the four nearest nodes relative to the
    node before: between two nodes alone this is the great-circle path. For a low orbit sampled at 1 s the
    error is below 1 um in position; at 60 s use velocities.

    Examples
    --------
    >>> trajectory = Trajectory.level_flight(700e3, 7e3, 0.0, 2.0)
    >>> trajectory.at(1.0).position.tolist()
    [[0.0, 7000.0, 700000.0]]
    """

    t_position: Array
    position: Array
    t_attitude: Array
    world_from_body: Rotation
    motion: Motion | None = None
    epoch: str | None = None
    velocity: Array | None = None

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        for name in ("t_position", "t_attitude"):
            times = frozen(as_times(getattr(self, name), name, increasing=True))
            if len(times) == 0:
                raise InputError(
                    f"`{name}` is empty: a trajectory needs at least one position and one attitude"
                )
            object.__setattr__(self, name, times)
        for name in ("position", "velocity"):
            if getattr(self, name) is not None:
                array = frozen(as_points(getattr(self, name), name))
                same_length(self.t_position, "t_position", array, name)
                if not np.isfinite(array).all():
                    row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
                    raise InputError(f"`{name}` must be finite: row {row} is {array[row].tolist()}")
                object.__setattr__(self, name, array)
        if self.world_from_body.single:
            object.__setattr__(self, "world_from_body", Rotation.concatenate([self.world_from_body]))
        if len(self.world_from_body) != len(self.t_attitude):
            raise InputError(
                f"`t_attitude` and `world_from_body` must have as many rows, got {len(self.t_attitude)} "
                f"and {len(self.world_from_body)}"
            )
        if self.span[1] < self.span[0]:
            raise InputError(
                f"positions [{self.t_position[0]:.6g}, {self.t_position[-1]:.6g}] s, attitudes "
                f"[{self.t_attitude[0]:.6g}, {self.t_attitude[-1]:.6g}] s and motion have no time in common; "
                "give them on one epoch"
            )

    @classmethod
    def level_flight(
        cls, altitude: float, ground_speed: float, t0: float, t1: float, heading: float = 0.0
    ) -> Trajectory:
        """Straight and level over a flat Earth, above the origin at t = 0.

        Parameters
        ----------
        altitude : float
            m above z = 0.
        ground_speed : float
            m/s.
        t0, t1 : float
            Span, s.
        heading : float
            rad, clockwise from north; north by default.

        Returns
        -------
        Trajectory
            World axes: x east, y north, z up. Body: x forward, y right, z down.
        """
        altitude, ground_speed = (
            positive(altitude, "altitude", "m"),
            positive(ground_speed, "ground_speed", "m/s"),
        )
        sine, cosine = np.sin(finite(heading, "heading", "rad")), np.cos(heading)
        t = as_times([t0, t1], "t0, t1", increasing=True)
        forward, right, down = (
            np.array([sine, cosine, 0.0]),
            np.array([cosine, -sine, 0.0]),
            np.array([0.0, 0, -1]),
        )
        position = t[:, np.newaxis] * ground_speed * forward + np.array([0.0, 0.0, altitude])
        attitude = Rotation.from_matrix(np.stack([np.stack([forward, right, down], axis=-1)] * 2))
        return cls(t, position, t, attitude)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time (s) at which position, attitude and motion are all known."""
        spans = [(self.t_position[0], self.t_position[-1]), (self.t_attitude[0], self.t_attitude[-1])]
        if self.motion is not None:
            spans.append(self.motion.span)
        return float(max(s[0] for s in spans)), float(min(s[1] for s in spans))

    def at(self, t: ArrayLike) -> Pose:
        """Pose at one time or many.

        Parameters
        ----------
        t : scalar or (M,)
            s from the epoch.

        Returns
        -------
        Pose
            M positions and rotations.

        Raises
        ------
        SpanError
            A time lies outside `span`.
        """
        times = as_times(t)
        _check_span(times, self.span, "the trajectory")
        reference = self._reference(times)
        attitude = reference.world_from_body
        if self.motion is not None:
            attitude = _departed(attitude, self.motion.at(times))
        return Pose(reference.position.copy(), attitude)

    def mean_at(self, t: ArrayLike, around: ArrayLike) -> MeanPose:
        """Pose at times `t` (M,), its attitude the mean of those `around` (K,) s later: what TDI averages.

        The mean is that of small turns from the middle one. Beyond its span an attitude counts as that of the
        end: a line is only seen where its middle is.
        """
        times, offsets = as_times(t), np.asarray(around, dtype=np.float64)
        _check_span(times, self.span, "the trajectory")
        reference = self._mean_reference(times, offsets)
        attitude, moment = reference.world_from_body, reference.moment
        if self.motion is not None:
            near = np.clip(times[:, np.newaxis] + offsets, *self.motion.span)
            angles = self.motion.at(near.ravel()).reshape(*near.shape, 3)
            attitude = _departed(attitude, angles.mean(axis=1))
            moment = moment + np.einsum("k,mka->ma", offsets / len(offsets), angles)
        return MeanPose(reference.position.copy(), attitude, moment)

    def _mean_reference(self, t: Array, around: Array) -> MeanPose:
        """Pose without motion, its attitude averaged; kept like `_reference`."""
        key = hashlib.blake2b(t.tobytes() + around.tobytes(), digest_size=16).digest()
        pose = self._known.get(key)
        if pose is None:
            middle = self._reference(t)
            ends = (self.t_attitude[0], self.t_attitude[-1])
            turn, moment = np.zeros((len(t), 3)), np.zeros((len(t), 3))
            for offset in around:
                there = self._reference_attitude(np.clip(t + offset, *ends))
                each = (middle.world_from_body.inv() * there).as_rotvec() / len(around)
                turn += each
                moment += offset * each
            mean = middle.world_from_body * Rotation.from_rotvec(turn)
            pose = self._keep(key, MeanPose(middle.position, mean, moment))
        assert isinstance(pose, MeanPose)
        return pose

    @cached_property
    def _known(self) -> dict[bytes, Pose]:
        """Reference poses of the latest long tables of times; shared by all motions about one reference."""
        return {}

    def _reference(self, t: Array) -> Pose:
        """Pose without motion. A camera asks for the same line times again with every change of motion."""
        if len(t) < _WORTH_KEEPING:
            return self._reference_pose(t)
        key = hashlib.blake2b(t.tobytes(), digest_size=16).digest()
        pose = self._known.get(key)
        return self._keep(key, self._reference_pose(t)) if pose is None else pose

    def _keep(self, key: bytes, pose: Pose) -> Pose:
        """The same pose, kept in place of the oldest ones."""
        known = self._known
        with _KEEPING:
            known[key] = pose
            rows = sum(len(one.position) for one in known.values())
            while len(known) > 1 and (len(known) > _KEPT or rows > _KEPT_ROWS):
                rows -= len(known.pop(next(iter(known))).position)
        return pose

    def _reference_pose(self, t: Array) -> Pose:
        """Work of `_reference`."""
        if self.velocity is None:
            position = interpolate(self.t_position, self.position, t)
        else:
            position = interpolate_hermite(self.t_position, self.position, self.velocity, t)
        return Pose(position, self._reference_attitude(t))

    def _reference_attitude(self, t: Array) -> Rotation:
        """Reference attitude at times inside the span: local cubic in relative rotation vectors."""
        if len(self.t_attitude) == 1:
            return self.world_from_body[np.zeros(len(t), dtype=np.intp)]
        interval, first, weights = stencils(self.t_attitude, t)
        used, row = np.unique(interval, return_inverse=True)
        start = np.empty(len(used), dtype=np.intp)
        start[row] = first
        before = self.world_from_body[used]
        departure = np.zeros((len(t), 3))
        for k in range(weights.shape[1]):
            relative = (before.inv() * self.world_from_body[start + k]).as_rotvec()
            departure += weights[:, k, np.newaxis] * relative[row]
        return before[row] * Rotation.from_rotvec(departure)

    def with_motion(self, motion: Motion | None) -> Trajectory:
        """The same reference with another departure from it."""
        other = replace(self, motion=motion)
        other.__dict__["_known"] = self._known
        return other

    def __getstate__(self) -> dict[str, Any]:
        """What is copied or sent to another process: all but the poses kept for speed."""
        return {name: value for name, value in self.__dict__.items() if name != "_known"}
