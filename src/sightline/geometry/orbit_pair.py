"""Spacecraft that follow one another on circular orbits and look at one point: shots, positions, attitudes.

S2's geometry (docs/theory/s2.md): what a pass is simulated with, and what a plan is judged by.

Not here: errors, points on the ground (``simulate/stereo.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import GeometryError, InputError
from sightline.geometry.aim import axes_towards
from sightline.geometry.checks import Array, as_times, finite, frozen, positive
from sightline.geometry.circular_orbit import CircularOrbit
from sightline.geometry.earth import EARTH_RATE, check_radii, from_geodetic, local_axes, to_geodetic

#: S2's Earth (m): equatorial and polar semi-axes of a sphere.
SPHERE: tuple[float, float] = (6371000.0, 6371000.0)


@dataclass(frozen=True)
class OrbitPair:
    """Two or more spacecraft, each on a circular orbit, that keep one point of the ground in view.

    Attributes
    ----------
    altitude : float
        m above the equatorial radius.
    inclination : float
        rad; below 90 degrees eastbound.
    latitude : float
        rad, geocentric, that an undisplaced spacecraft passes at the middle of the pass, northbound.
    separation : float
        s between the first and the last spacecraft's passages of the node; the others evenly between.
    cameras : int
        How many spacecraft.
    leader : int
        1: the camera numbered 1 flies ahead of the others; otherwise the last does: `leader = cameras`.
    longitude : float
        rad, of the point that an undisplaced spacecraft passes at the middle of the pass.
    cross_track : float
        m along the great circle, of the aim point from there, to the left of the flight.
    node_offset, inclination_offset : float
        rad; how far the last spacecraft's orbit differs from the first's, evenly about the mean orbit.
    radii : (equatorial, polar)
        m; S2's sphere unless given, WGS 84 for the Earth.
    aim_height : float
        m above the ellipsoid, of the aim point.

    Examples
    --------
    >>> pair = OrbitPair(separation=70.0)
    >>> t = pair.shot_times(64.0, 2)
    >>> pair.positions(t).shape, pair.world_from_body(t).shape
    ((2, 2, 3), (2, 2, 3, 3))
    """

    altitude: float = 500e3
    inclination: float = float(np.radians(97.4))
    latitude: float = float(np.radians(55.0))
    separation: float = 70.0
    cameras: int = 2
    leader: int = 1
    longitude: float = 0.0
    cross_track: float = 0.0
    node_offset: float = 0.0
    inclination_offset: float = 0.0
    radii: tuple[float, float] = SPHERE
    aim_height: float = 0.0

    def __post_init__(self) -> None:
        """Check."""
        check_radii(self.radii)
        positive(self.altitude, "altitude", "m")
        for name in ("latitude", "longitude", "cross_track", "node_offset", "inclination_offset"):
            finite(getattr(self, name), name)
        finite(self.aim_height, "aim_height", "m")
        if self.cameras < 2:
            raise InputError(f"`cameras` must be 2 or more, got {self.cameras}")
        if self.leader not in (1, self.cameras):
            raise InputError(f"`leader` must be 1 or {self.cameras} (the last), got {self.leader}")
        if not self.separation >= 0.0:
            raise InputError(f"`separation` must be 0 or more, got {self.separation} s")
        if self.separation == self.node_offset == self.inclination_offset == 0.0:
            raise InputError(
                "the cameras are at one place: there is no baseline; give a `separation` in time, or another "
                "orbit by `node_offset` or `inclination_offset`"
            )
        if not 0.0 < self.inclination < np.pi:
            raise InputError(
                f"`inclination` must be above 0 and below 180 degrees, got {np.degrees(self.inclination):g}"
            )
        if not abs(np.sin(self.latitude)) < np.sin(self.inclination):
            highest = np.degrees(np.arcsin(np.sin(self.inclination)))
            raise InputError(
                f"`latitude` must be below {highest:.4g} degrees for an orbit inclined by "
                f"{np.degrees(self.inclination):.4g}, got {np.degrees(self.latitude):.4g}"
            )

    def _orbit(self, share: float = 0.0, passage: float = 0.0, node: float = 0.0) -> CircularOrbit:
        """Orbit `share` of the way from the mean one towards the last's, past its node at time `passage`."""
        inclination = self.inclination + share * self.inclination_offset
        rate = CircularOrbit(self.altitude, inclination, body_radius=self.radii[0]).rate
        node += share * self.node_offset
        return CircularOrbit(self.altitude, inclination, node, -rate * passage, self.radii[0])

    @cached_property
    def middle_time(self) -> float:
        """s from the passage of the node: when an undisplaced spacecraft passes `latitude`."""
        return float(np.arcsin(np.sin(self.latitude) / np.sin(self.inclination)) / self._orbit().rate)

    @cached_property
    def orbits(self) -> tuple[CircularOrbit, ...]:
        """The orbit of each camera."""
        shares = np.linspace(-0.5, 0.5, self.cameras)
        passages = self.separation * (shares if self.leader == 1 else -shares)
        return tuple(
            self._orbit(float(share), float(passage), self._node)
            for share, passage in zip(shares, passages, strict=True)
        )

    @cached_property
    def _node(self) -> float:
        """rad, longitude of the node at t = 0 that leads over `longitude` at the middle of the pass."""
        (x, y, _), _ = (v[0] for v in self._orbit().inertial(np.array([self.middle_time])))
        return float(self.longitude - np.arctan2(y, x) + EARTH_RATE * self.middle_time)

    @cached_property
    def aim_point(self) -> Array:
        """(3,) m, Earth-fixed axes: what all cameras look at."""
        position, velocity = self._orbit(node=self._node).inertial(np.array([self.middle_time]))
        up = position[0] / np.linalg.norm(position[0])
        aside = np.cross(up, velocity[0])
        angle = self.cross_track / self.radii[0]
        moved = np.cos(angle) * up + np.sin(angle) * aside / np.linalg.norm(aside)
        turned = Rotation.from_rotvec([0.0, 0.0, -EARTH_RATE * self.middle_time]).apply(moved)
        foot = to_geodetic(turned * np.linalg.norm(position[0]), self.radii)
        foot[0, 2] = self.aim_height
        return frozen(from_geodetic(foot, self.radii)[0])

    @cached_property
    def world_from_local(self) -> Rotation:
        """Level axes at the aim point: local x east, y north, z up."""
        longitude, latitude, _ = to_geodetic(self.aim_point, self.radii)[0]
        return local_axes(longitude, latitude)

    def shot_times(self, window: float, shots: int, offset: float = 0.0) -> Array:
        """Times (shots,) s of shots spread evenly over a window.

        Parameters
        ----------
        window : float
            s; the first shot is half an interval after its beginning.
        shots : int
        offset : float
            s, of the middle of the window from the middle of the pass.
        """
        positive(window, "window", "s")
        finite(offset, "offset", "s")
        if shots < 1:
            raise InputError(f"`shots` must be 1 or more, got {shots}")
        steps = np.arange(shots) - 0.5 * (shots - 1)
        return frozen(self.middle_time + offset + steps * (window / shots))

    def positions(self, t: Array) -> Array:
        """Earth-fixed positions (cameras, K, 3) m at times `t` (K,) s.

        Raises
        ------
        GeometryError
            If a camera has the aim point below its horizon.
        """
        t = as_times(t)
        places = np.stack([orbit.earth_fixed(t)[0] for orbit in self.orbits])
        up = self.world_from_local.apply([0.0, 0.0, 1.0])
        rise = (places - self.aim_point) @ up
        if not (rise > 0.0).all():
            camera, shot = (int(v) for v in np.argwhere(~(rise > 0.0))[0])
            raise GeometryError(
                f"camera {camera + 1} is below the horizon of the aim point {t[shot] - self.middle_time:.0f} "
                "s from the middle of the pass; shorten `window`, `offset`, `separation` or `cross_track`"
            )
        return np.asarray(places)

    def world_from_body(self, t: Array, positions: Array | None = None) -> Array:
        """Planned attitudes at times `t`.

        Parameters
        ----------
        t : (K,)
            s.
        positions : (cameras, K, 3), optional
            m; where the cameras are or are thought to be, in place of their orbits.

        Returns
        -------
        (cameras, K, 3, 3)
            Matrices: z at the aim point, y square to the plane of the first and the last camera and that
            point, x towards the leader: forward where they follow one another. These are S2's axes of two
            cameras where the one numbered 1 leads; else S2's x and y are theirs reversed.
        """
        places = self.positions(t) if positions is None else positions
        ahead = places[0] - places[-1]
        if not np.linalg.norm(ahead, axis=-1).min() > 0.0:
            raise GeometryError("the cameras are at one place in a shot: there is no baseline")
        if self.leader != 1:
            ahead = -ahead
        return np.stack([axes_towards(own, ahead, self.aim_point) for own in places])

    def elevations(self, t: Array) -> Array:
        """Elevation (cameras, K) rad of each camera over the level plane at the aim point."""
        d = self.positions(t) - self.aim_point
        up = self.world_from_local.apply([0.0, 0.0, 1.0])
        return np.asarray(np.arcsin(d @ up / np.linalg.norm(d, axis=-1)))

    def convergence(self, t: Array) -> Array:
        """Angle (K,) rad at the aim point between the first and the last camera."""
        d = self.positions(t) - self.aim_point
        n = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return np.asarray(2.0 * np.arcsin(0.5 * np.linalg.norm(n[0] - n[-1], axis=-1)))
