"""Circular orbits about the Earth, in the Earth-fixed axes that turn with it.

Two bodies only: over the seconds of a strip the rest of gravity moves a satellite by centimetres, alike in
all bands.

Not here: attitudes (``aim.py``), orbits of measured positions (``trajectory.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.errors import InputError
from sightline.geometry.checks import Array
from sightline.geometry.earth import WGS84, fixed_from_inertial

EARTH_GM = 3.986004418e14
"""m^3/s^2, gravitational constant times mass of the Earth (WGS 84)."""


@dataclass(frozen=True)
class CircularOrbit:
    """A circular orbit; at t = 0 Earth-fixed and inertial axes coincide.

    Parameters
    ----------
    altitude : float
        m above the equatorial radius.
    inclination : float
        rad
    node : float
        rad, longitude at which the orbit crosses the equator northwards, if it did so at t = 0.
    phase : float
        rad along the orbit from there at t = 0.
    body_radius : float
        m, equatorial radius of the body that `altitude` counts from.
    """

    altitude: float
    inclination: float
    node: float = 0.0
    phase: float = 0.0
    body_radius: float = WGS84[0]

    def __post_init__(self) -> None:
        """Refuse an orbit inside the Earth."""
        if not self.altitude > 0.0:
            raise InputError(f"`altitude` of an orbit must be positive, got {self.altitude} m")

    @property
    def radius(self) -> float:
        """m from the Earth's centre."""
        return self.body_radius + self.altitude

    @property
    def rate(self) -> float:
        """rad/s along the orbit: Kepler's third law."""
        return float(np.sqrt(EARTH_GM / self.radius**3))

    def inertial(self, t: Array) -> tuple[Array, Array]:
        """Positions and velocities (N, 3) at times `t` (N,) s: m, m/s, axes that do not turn."""
        u = self.phase + self.rate * np.asarray(t, dtype=np.float64)
        cos_i, sin_i = np.cos(self.inclination), np.sin(self.inclination)
        cos_n, sin_n = np.cos(self.node), np.sin(self.node)
        along = np.array([cos_n, sin_n, 0.0])
        across = np.array([-sin_n * cos_i, cos_n * cos_i, sin_i])
        out = np.cos(u)[:, None] * along + np.sin(u)[:, None] * across
        ahead = -np.sin(u)[:, None] * along + np.cos(u)[:, None] * across
        return self.radius * out, self.radius * self.rate * ahead

    def earth_fixed(self, t: Array) -> tuple[Array, Array]:
        """Positions and velocities (N, 3) at times `t` (N,) s, relative to the turning Earth."""
        return fixed_from_inertial(t, *self.inertial(t))
