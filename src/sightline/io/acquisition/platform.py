"""``[platform]`` and ``[world]`` → a Trajectory in the axes everything is computed in.

Level flight over a flat Earth; a spinning body; positions and attitudes from CSV tables or CCSDS messages,
in Earth-fixed, local or geodetic coordinates.

Not here: what a spin's keys mean (``spin.py``), sensor-model files, which bring trajectory and detector
together (``io/formats/isd.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder, attitude_to_world, world_kind
from sightline.io.acquisition.schema import (
    AcquisitionFile,
    EphemerisPlatform,
    LevelFlight,
    SpinPlatform,
    WorldSection,
)
from sightline.io.acquisition.spin import must_cover, spin_of
from sightline.io.formats import ccsds, tables

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
    t_position, position, velocity = _positions(config, files(platform.positions), span)
    if platform.attitudes == "along-track":
        t_attitude, attitude = (
            t_position,
            along_track_attitude(t_position, position, world_kind(config), config.surface.radii or WGS84),
        )
    else:
        path = files(platform.attitudes)
        t_attitude, quat_xyzw = read_attitudes(path, config.acquisition.epoch)
        must_cover(path, "attitudes", t_attitude, span)
        attitude = attitude_to_world(Rotation.from_quat(quat_xyzw), config)
    return Trajectory(
        t_position, position, t_attitude, attitude, epoch=config.acquisition.epoch, velocity=velocity
    )


def _positions(
    config: AcquisitionFile, path: Path, span: tuple[float, float]
) -> tuple[Array, Array, Array | None]:
    """Times (N,) s, positions (N, 3) and velocities (N, 3) or None of a table, axes of computation."""
    t, raw, velocity = read_positions(path, config.acquisition.epoch)
    must_cover(path, "positions", t, span)
    if velocity is not None and config.world.frame != "earth-fixed":
        raise FormatError(
            f'{path}: an OEM is in Earth-fixed axes; [world] frame must be "earth-fixed" or left out'
        )
    return t, to_world(raw, config, path), velocity


def _spinning(
    config: AcquisitionFile, platform: SpinPlatform, files: InputFolder, span: tuple[float, float]
) -> Trajectory:
    """The trajectory of ``[platform]`` kind spin."""
    margin = MARGIN + MARGIN_SHARE * (span[1] - span[0])
    wide = span[0] - margin, span[1] + margin
    velocity: Array | None = None
    if platform.positions is not None:
        t, position, velocity = _positions(config, files(platform.positions), span)
    else:
        at = np.zeros((1, 3))  # only directions matter: the ground is at infinity
        if platform.position is not None:
            at = to_world(np.array([platform.position]), config, files.toml)
        t, position = np.array(wide), np.repeat(at, 2, axis=0)
    spin = spin_of(config)
    assert spin is not None  # the platform is one
    return spin.trajectory(t, position, wide, velocity=velocity, epoch=config.acquisition.epoch)


def read_positions(path: Path, epoch: str | None) -> tuple[Array, Array, Array | None]:
    """Positions of a CSV table or a CCSDS OEM: times (N,) s, positions (N, 3), velocities (N, 3) or None."""
    if ccsds.is_ccsds(path, "OEM"):
        ephemeris = ccsds.read_oem(path, ccsds.need_epoch(path, epoch))
        return ephemeris.t, ephemeris.position, ephemeris.velocity
    return *tables.read_positions(path), None


def read_attitudes(path: Path, epoch: str | None) -> tuple[Array, Array]:
    """Attitudes from a CSV table or a CCSDS AEM: times (N,) s from the epoch, quaternions (N, 4) x y z w."""
    if ccsds.is_ccsds(path, "AEM"):
        attitude = ccsds.read_aem(path, ccsds.need_epoch(path, epoch))
        return attitude.t, attitude.quat_xyzw
    return tables.read_attitudes(path)


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
