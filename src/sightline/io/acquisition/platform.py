"""``[platform]`` and ``[world]`` → a Trajectory in the axes everything is computed in.

Level flight over a flat Earth; a spinning body; positions and attitudes of files, in Earth-fixed, local or
geodetic coordinates.

Not here: files of orbits and attitudes, and their axes (``ephemeris.py``), what a spin's keys mean
(``spin.py``), sensor-model files, which bring trajectory and detector together (``io/formats/isd.py``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder, attitude_to_world, world_kind
from sightline.io.acquisition.apparent import along_straight_lines
from sightline.io.acquisition.ephemeris import (
    GivenOrbit,
    earth_of,
    fixed_attitude,
    fixed_orbit,
    is_inertial,
    say_orientation,
)
from sightline.io.acquisition.schema import (
    AcquisitionFile,
    EphemerisPlatform,
    LevelFlight,
    SpinPlatform,
    WorldSection,
)
from sightline.io.acquisition.spin import spin_of
from sightline.io.formats.earth_orientation import TurningEarth

Array = NDArray[np.float64]

#: m; positions lie no deeper than this below the smallest radius of the body.
DEPTH = 20e3
#: m, and radii of the body; positions lie no further from its centre than the larger of both.
FARTHEST, FARTHEST_RADII = 1e9, 150.0
#: m; height, and distance from the origin, up to which a world may be flat.
HIGHEST_FLAT, WIDEST_FLAT = 1e6, 6e6
#: Share of the strip's duration by which a closed-form trajectory reaches beyond it on both sides.
MARGIN_SHARE = 0.1
#: The same in seconds, for images of one instant.
MARGIN = 1.0


def build_trajectory(config: AcquisitionFile, files: InputFolder, span: tuple[float, float]) -> Trajectory:
    """The nominal trajectory of ``[platform]`` kinds level-flight, ephemeris and spin.

    Parameters
    ----------
    config : AcquisitionFile
    files : InputFolder
        Finds the tables.
    span : (first, last)
        s; exposure of the first and last line (or frame) of all images.

    Returns
    -------
    Trajectory
        World axes are local (x east, y north, z up) or Earth-fixed, by ``world_kind``.

    Raises
    ------
    SpanError
        If a table does not reach over `span`.
    """
    platform = config.platform
    if isinstance(platform, LevelFlight):
        margin = MARGIN + MARGIN_SHARE * (span[1] - span[0])
        return Trajectory.level_flight(
            platform.altitude, platform.ground_speed, span[0] - margin, span[1] + margin
        )
    if isinstance(platform, SpinPlatform):
        return _spinning(config, platform, files, span)
    if not isinstance(platform, EphemerisPlatform):
        raise FormatError(
            f"{files.toml}: [platform] kind {platform.kind!r} takes its trajectory from the model file"
        )
    earth = earth_of(config, files)
    orbit = _positions(config, files(platform.positions), span, earth, files)
    t_position, position, velocity = orbit.t, orbit.position, orbit.velocity
    given: str | None = None
    if platform.attitudes == "along-track":
        t_attitude, attitude = (
            t_position,
            along_track_attitude(t_position, position, world_kind(config), config.surface.radii or WGS84),
        )
    else:
        places = files(platform.positions), orbit
        t_attitude, attitude, given = fixed_attitude(
            config, files(platform.attitudes), span, earth, files, places
        )
        if given is None:
            attitude = attitude_to_world(attitude, config)
        elif is_inertial(given):
            axes = given
            files.fixed_from_given = lambda t: Rotation.from_matrix(earth.axes(axes, np.array([t])).turn[0])
    if platform.earth_orientation is not None and orbit.axes is None and given is None:
        raise FormatError(
            f"{files.toml}: [platform] earth_orientation = {platform.earth_orientation} turns axes of the "
            "stars, and tables are in those of [world]; give position_axes or attitude_axes, or remove it"
        )
    say_orientation(earth, orbit, given, span, config.surface.radii, files)
    trajectory = Trajectory(
        t_position, position, t_attitude, attitude, epoch=config.acquisition.epoch, velocity=velocity
    )
    return along_straight_lines(config, trajectory, span, files)


def _positions(
    config: AcquisitionFile, path: Path, span: tuple[float, float], earth: TurningEarth, files: InputFolder
) -> GivenOrbit:
    """Positions of a file, axes of computation."""
    given = fixed_orbit(config, path, span, earth, files)
    return replace(given, position=to_world(given.position, config, path))


def _spinning(
    config: AcquisitionFile, platform: SpinPlatform, files: InputFolder, span: tuple[float, float]
) -> Trajectory:
    """The trajectory of ``[platform]`` kind spin."""
    margin = MARGIN + MARGIN_SHARE * (span[1] - span[0])
    wide = span[0] - margin, span[1] + margin
    velocity: Array | None = None
    if platform.positions is not None:
        earth = earth_of(config, files)
        orbit = _positions(config, files(platform.positions), span, earth, files)
        t, position, velocity = orbit.t, orbit.position, orbit.velocity
        say_orientation(earth, orbit, None, span, config.surface.radii, files)
    else:
        at = np.zeros((1, 3))  # only directions matter: the ground is at infinity
        if platform.position is not None:
            at = to_world(np.array([platform.position]), config, files.toml)
        t, position = np.array(wide), np.repeat(at, 2, axis=0)
    spin = spin_of(config)
    assert spin is not None  # the platform is one
    return spin.trajectory(t, position, wide, velocity=velocity, epoch=config.acquisition.epoch)


def to_world(points: Array, config: AcquisitionFile, path: Path | None = None) -> Array:
    """Points (N, 3) in the axes of ``[world]`` → the axes of computation, m; see `points_to_world`."""
    if world_kind(config) == "local":
        return points
    return points_to_world(points, config.world, config.surface.radii, path)


def points_to_world(
    points: Array, world: WorldSection, radii: tuple[float, float] | None, path: Path | None = None
) -> Array:
    """Points in the axes of ``[world]`` → the axes of computation.

    Parameters
    ----------
    points : (N, 3)
        m, or degrees and m for "lonlat".
    world : WorldSection
        With frame "local" and no origin points stay as they are.
    radii : (equatorial, polar) or None
        m; of another body than the Earth.
    path : Path, optional
        Named in messages.

    Returns
    -------
    (N, 3)
        m.

    Raises
    ------
    FormatError
        If coordinates are impossible in those axes; swapped and mis-scaled columns show here.
    """
    place = f"{path}: " if path is not None else ""
    body = radii or WGS84
    if world.frame == "lonlat":
        lon, lat = points[:, 0], points[:, 1]
        if np.any(np.abs(lat) > 90.0) or np.any(np.abs(lon) > 360.0):
            raise FormatError(
                f"{place}longitudes (x) reach {np.abs(lon).max():.6g}, latitudes (y) reach "
                f'{np.abs(lat).max():.6g} degrees; with [world] frame = "lonlat" the columns are '
                "x = longitude, y = latitude (degrees), z = height (m); are x and y swapped, or are they "
                'metres? Of metres about a place of the site give frame = "local"'
            )
        return from_geodetic(np.column_stack([np.radians(lon), np.radians(lat), points[:, 2]]), body)
    if world.frame == "local":
        if world.origin is None:
            _check_flat(points, place)
            return points
        lon, lat, height = np.radians(world.origin[0]), np.radians(world.origin[1]), world.origin[2]
        places = np.asarray(from_geodetic([[lon, lat, height]], body) + local_axes(lon, lat).apply(points))
        _check_distance(places, body, place, "Earth-fixed, not east, north and up about [world] origin?")
        return places
    _check_distance(points, body, place, 'in other axes ([world] frame = "local" or "lonlat")?')
    return points


def _check_distance(points: Array, radii: tuple[float, float], place: str, other: str) -> None:
    """Refuse positions (N, 3) m that lie deep inside a body, or too far from it to image it."""
    distance = np.linalg.norm(points, axis=1)
    low, high = min(radii) - DEPTH, max(FARTHEST, FARTHEST_RADII * max(radii))
    odd = (distance < low) | (distance > high)
    if odd.any():
        row = int(np.argmax(odd))
        centre = "Earth's" if radii == WGS84 else "body's"
        raise FormatError(
            f"{place}a position lies {distance[row]:.6g} m from the {centre} centre; positions in "
            f"metres lie between {low:.4g} m and {high:.3g} m from it; are they in "
            f"{'km' if distance[row] < low else 'mm'}, or {other}"
        )


def _check_flat(points: Array, place: str) -> None:
    """Refuse positions (N, 3) m that no flat world about its origin can hold."""
    far = (np.abs(points[:, 2]) > HIGHEST_FLAT) | (np.linalg.norm(points, axis=1) > WIDEST_FLAT)
    if far.any():
        row = int(np.argmax(far))
        raise FormatError(
            f"{place}a position is x, y, z = {', '.join(f'{v:.6g}' for v in points[row])} m; with [world] "
            'frame = "local" and no origin the columns are metres east, north and up over a flat ground; '
            'are they Earth-fixed (frame = "earth-fixed"), or in mm?'
        )


def along_track_attitude(
    t: Array, position: Array, world: str, radii: tuple[float, float] = WGS84
) -> Rotation:
    """world_from_body that looks straight down with the nose along the ground track.

    Parameters
    ----------
    t : (N,)
        s.
    position : (N, 3)
        m, world axes.
    world : str
        ``"local"`` (down is -z) or ``"earth-fixed"`` (down is the ellipsoid's normal).
    radii : (equatorial, polar)
        m; of the ellipsoid.

    Returns
    -------
    Rotation
        N rotations; body x forward, y right, z down.
    """
    if len(t) < 2:
        raise FormatError("one position only; attitudes along the track need two or more")
    velocity = np.gradient(position, t, axis=0)
    if world == "local":
        down = np.tile([0.0, 0.0, -1.0], (len(t), 1))
    else:
        lon, lat, _ = to_geodetic(position, radii).T
        down = -local_axes(lon, lat).apply([0.0, 0.0, 1.0])
    forward = velocity - np.sum(velocity * down, axis=1)[:, None] * down
    speed = np.linalg.norm(forward, axis=1)
    if np.any(speed <= 0.0):
        raise FormatError("the positions stand still or rise vertically; give attitudes = FILE")
    forward /= speed[:, None]
    return Rotation.from_matrix(np.stack([forward, np.cross(down, forward), down], axis=2))
