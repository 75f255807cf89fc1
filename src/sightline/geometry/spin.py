"""A body that turns evenly about an axis of its own: spin-stabilised platforms (S1, fig. 16).

Not here: departures from the even turn, which are a ``Motion``; a mirror that turns (``pointing.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, as_times, as_vector, finite, frozen
from sightline.geometry.trajectory import Trajectory

#: Turn of the body between two attitudes of its table (rad). An even turn is interpolated exactly; that of
#: the world axes, seen from the body, to world_rate / rate times 4e-9 rad.
_STEP = 0.02
#: Most attitudes of a table; 3,000 turns.
_MOST = 1_000_000


@dataclass(frozen=True, eq=False)
class Spin(ReadOnlyArrays):
    """Attitude of a body that turns evenly, relative to the stars, about an axis fixed in it.

    Attributes
    ----------
    attitude : Rotation
        world_from_body at t = 0.
    axis : (3,)
        Of the spin, body axes; normalised on construction.
    rate : float
        rad/s about `axis`, right-handed, relative to the stars.
    world_rate : float
        rad/s at which the world axes turn about their z relative to the stars: the Earth's for Earth-fixed
        axes, 0 for axes that do not turn.
    axis_sigma, rate_sigma : float
        rad each way across the axis, rad/s: how well axis and rate are known; 0 = exactly.

    Notes
    -----
    world_from_body(t) = Rz(-world_rate t) * attitude * Rotation.from_rotvec(axis * rate * t).
    """

    attitude: Rotation
    axis: Array
    rate: float
    world_rate: float = 0.0
    axis_sigma: float = 0.0
    rate_sigma: float = 0.0

    def __post_init__(self) -> None:
        """Check, normalise and freeze."""
        axis = as_vector(self.axis, "axis")
        length = float(np.sqrt((axis**2).sum()))
        if not length > 0.0:
            raise InputError("`axis` of a spin has no length; give the axis of rotation in body axes")
        object.__setattr__(self, "axis", frozen(axis / length))
        for name, unit in (("rate", "rad/s"), ("world_rate", "rad/s")):
            finite(getattr(self, name), name, unit)
        for name in ("axis_sigma", "rate_sigma"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"`{name}` of a spin must be 0 or more, got {getattr(self, name)}")

    def at(self, t: ArrayLike) -> Rotation:
        """world_from_body at times `t` (N,) s: N rotations."""
        times = as_times(t)[:, np.newaxis]
        world = Rotation.from_rotvec(-self.world_rate * times * np.array([0.0, 0.0, 1.0]))
        return world * self.attitude * Rotation.from_rotvec(self.rate * times * self.axis)

    def departures(self, t: ArrayLike) -> Array:
        """What errors of rate and axis do to the attitude, as departures in body axes.

        Parameters
        ----------
        t : (N,)
            s.

        Returns
        -------
        (N, 3, 3)
            Roll, pitch, yaw (second axis) per unit of: the rate (s), and the two components of the axis
            across itself (rad/rad).

        Notes
        -----
        With phi = rate t and e across the axis a, to first order:
        R(-a phi) R((a + eps e) phi) = 1 + eps (sin(phi) e - (1 - cos(phi)) a x e).
        """
        times = as_times(t)[:, np.newaxis]
        across = _across(self.axis)
        phi = self.rate * times
        parts = [times * self.axis]
        parts += [np.sin(phi) * e - (1.0 - np.cos(phi)) * np.cross(self.axis, e) for e in across]
        return np.stack(parts, axis=2)

    def adjusted(self, change: ArrayLike) -> Spin:
        """The spin with rate, axis and attitude a little changed.

        Parameters
        ----------
        change : (6,)
            Of the rate, rad/s; of the axis, rad along two directions across it (those of `departures`); of
            the attitude at t = 0, a rotation vector in body axes, rad.
        """
        given = as_vector(change, "change", 6)
        first, second = _across(self.axis)
        return replace(
            self,
            rate=self.rate + float(given[0]),
            axis=self.axis + given[1] * first + given[2] * second,
            attitude=self.attitude * Rotation.from_rotvec(np.array(given[3:])),
        )

    def trajectory(
        self,
        t_position: ArrayLike,
        position: ArrayLike,
        span: tuple[float, float],
        *,
        velocity: ArrayLike | None = None,
        epoch: str | None = None,
    ) -> Trajectory:
        """Trajectory of the spinning body.

        Parameters
        ----------
        t_position : (P,)
            s.
        position : (P, 3)
            m, world axes.
        span : (first, last)
            s; attitudes are made for these times.
        velocity : (P, 3), optional
            m/s, as in Trajectory.
        epoch : str, optional
            UTC of t = 0.
        """
        turn = abs(self.rate) * (span[1] - span[0])
        count = int(np.ceil(turn / _STEP)) + 5
        if count > _MOST:
            raise InputError(
                f"the spin turns {turn / (2 * np.pi):.6g} times between t = {span[0]:.6g} and "
                f"{span[1]:.6g} s; at most {_MOST * _STEP / (2 * np.pi):.0f} turns are handled at once; "
                "check `rate` (rad/s)"
            )
        t = np.linspace(span[0], span[1], count)
        given = None if velocity is None else np.asarray(velocity, dtype=np.float64)
        return Trajectory(
            as_times(t_position, "t_position"), np.asarray(position), t, self.at(t), None, epoch, given
        )


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed set with `axis` (3,)."""
    least = np.zeros(3)
    least[int(np.argmin(np.abs(axis)))] = 1.0
    first = np.cross(axis, least)
    first /= np.sqrt((first**2).sum())
    return first, np.cross(axis, first)
