"""``[platform] aberration, light_time, refraction`` → cameras whose rays lead straight to what they see.

Of tables (kind ephemeris) the attitudes are turned by what it comes to in the middle of the field: towards
its edges, at an angle a from the middle, the aberration of some 25 urad differs by a part a of itself at
most. Of camera models the whole field is exact.

Not here: the formulas (``geometry/apparent.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.apparent import APPARENT, bent_camera, straight_directions
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import to_geodetic
from sightline.geometry.surface import Ellipsoid, Surface
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder, world_kind
from sightline.io.acquisition.ground import image_grid
from sightline.io.acquisition.schema import AcquisitionFile, CameraModelPlatform, EphemerisPlatform
from sightline.io.acquisition.spin import mount_of
from sightline.motion.band import Band

Array = NDArray[np.float64]

#: s before and after an instant between which the velocity is taken.
_STEP = 0.05


def along_straight_lines(
    config: AcquisitionFile, trajectory: Trajectory, span: tuple[float, float], files: InputFolder
) -> Trajectory:
    """The same with attitudes that lead along straight lines to what is seen, where that is asked for.

    Raises
    ------
    FormatError
        For flat worlds, other bodies, and lines of sight that a mirror moves.
    """
    platform = config.platform
    if not isinstance(platform, EphemerisPlatform):
        return trajectory
    asked = [key for key in APPARENT if getattr(platform, key)]
    if not asked:
        return trajectory
    _refuse_other_worlds(config, asked[0], files)
    if config.pointing.kind != "fixed":
        raise FormatError(
            f"{files.toml}: [platform] {asked[0]} = true is of lines of sight that are fixed to the body; "
            "remove it, or [pointing]"
        )
    height = config.surface.height
    place, velocity, seen = _middle_of_field(config, trajectory)
    t = trajectory.t_attitude
    middle = int(np.argmin(np.abs(t - 0.5 * sum(span))))
    files.said += _words(place[[middle]], velocity[[middle]], seen[[middle]], height, asked)
    straight = straight_directions(place, velocity, seen, height, asked)
    turn = Rotation.from_rotvec(np.cross(seen, straight))
    return replace(trajectory, world_from_body=turn * trajectory.world_from_body)


def _refuse_other_worlds(config: AcquisitionFile, key: str, files: InputFolder) -> None:
    """The air and the turn are the Earth's."""
    surface = config.surface
    if world_kind(config) == "local" or surface.radii is not None or surface.kind == "infinity":
        raise FormatError(
            f"{files.toml}: [platform] {key} = true is of the turning Earth below a satellite: its world is "
            "Earth-fixed; remove it, or [world] and [surface] radii, kind"
        )


def _middle_of_field(config: AcquisitionFile, trajectory: Trajectory) -> tuple[Array, Array, Array]:
    """Place (m), velocity (m/s) and boresight (N, 3) at the times of the attitudes."""
    boresight = mount_of(config.camera).body_from_camera.apply([0.0, 0.0, 1.0])
    first, last = trajectory.t_position[0] + _STEP, trajectory.t_position[-1] - _STEP
    alone = replace(
        trajectory, t_attitude=trajectory.t_position[[0, -1]], world_from_body=Rotation.identity(2)
    )
    t = np.clip(trajectory.t_attitude, first, last)
    return alone.at(t).position, _velocity(alone, t), trajectory.world_from_body.apply(boresight)


def _words(place: Array, velocity: Array, seen: Array, height: float, keys: Sequence[str]) -> list[str]:
    """What each comes to where the camera is at `place` (1, 3), m, and looks along `seen` (1, 3)."""
    ground = Ellipsoid(height=height).intersect(place, seen)
    distance = float(np.linalg.norm(ground - place))
    turns = {
        key: float(np.linalg.norm(np.cross(seen, straight_directions(place, velocity, seen, height, [key]))))
        for key in keys
    }
    return [
        f"{key.replace('_', ' ')} is applied: {1e6 * turn:.3g} urad, {distance * turn:.2g} m square to the "
        "line of sight"
        for key, turn in turns.items()
    ]


def bent_bands(
    config: AcquisitionFile, bands: tuple[Band, ...], surface: Surface, files: InputFolder
) -> tuple[Band, ...]:
    """Bands of camera models with what their attitudes do not hold, over the whole field.

    The keys of ``[platform]`` count, where they are not given what each model says of itself.

    Raises
    ------
    FormatError
        For flat worlds and other bodies.
    """
    platform = config.platform
    if not isinstance(platform, CameraModelPlatform) or not bands:
        return bands
    given = {key: getattr(platform, key) for key in APPARENT}
    wrong = [
        key
        for key in APPARENT
        if given[key] is not None and any(given[key] != (key in lacks) for lacks in files.bends)
    ]
    if wrong:
        needed = "needs" if not given[wrong[0]] else "does not need"
        files.doubts.append(
            f"[platform] {wrong[0]} = {str(given[wrong[0]]).lower()}, which its model {needed}; leave it out"
        )
    out = []
    for index, (band, lacks) in enumerate(zip(bands, files.bends, strict=True)):
        keys = [key for key in APPARENT if (key in lacks if given[key] is None else given[key])]
        if keys:
            _refuse_other_worlds(config, keys[0], files)
            camera, height = band.camera, _height_below(band.camera, surface)
            band = replace(band, camera=bent_camera(camera, height, keys))
            if index == 0:
                rays = camera.rays((np.array([camera.shape]) - 1.0) / 2.0)
                velocity = _velocity(camera.trajectory, rays.t)
                files.said += _words(rays.origins, velocity, rays.directions, height, keys)
        out.append(band)
    return tuple(out)


def _height_below(camera: PushbroomCamera, surface: Surface) -> float:
    """Median height (m above the ellipsoid) of the ground that a camera sees."""
    if isinstance(surface, Ellipsoid):
        return surface.height
    points = camera.locate(image_grid(camera), surface)
    heights = to_geodetic(points[np.isfinite(points[:, 0])])[:, 2]
    return float(np.median(heights)) if len(heights) else 0.0


def _velocity(trajectory: Trajectory, t: Array) -> Array:
    """m/s (N, 3), relative to the axes of computation."""
    begin, end = trajectory.span
    ends = [np.clip(t + shift, begin, end) for shift in (-_STEP, _STEP)]
    before, after = (trajectory.at(times).position for times in ends)
    return np.asarray((after - before) / (ends[1] - ends[0])[:, np.newaxis])
