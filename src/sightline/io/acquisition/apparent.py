"""``[platform] aberration, light_time, refraction`` → attitudes along which light seems to come straight.

The line of sight is turned in the middle of the field: towards its edges, at an angle a from the middle, the
aberration of some 25 urad differs by a part a of itself at most.

Not here: the formulas (``geometry/apparent.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.apparent import LIGHT_SPEED, aberration_velocity, refraction_angle, straight_turn
from sightline.geometry.surface import Ellipsoid
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder, world_kind
from sightline.io.acquisition.schema import AcquisitionFile, EphemerisPlatform
from sightline.io.acquisition.spin import mount_of

Array = NDArray[np.float64]

#: s before and after an instant between which the velocity is taken.
_STEP = 0.05
_KEYS = ("aberration", "light_time", "refraction")


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
    asked = [key for key in _KEYS if getattr(platform, key, False)]
    if not asked or not isinstance(platform, EphemerisPlatform):
        return trajectory
    surface = config.surface
    if world_kind(config) == "local" or surface.radii is not None or surface.kind == "infinity":
        raise FormatError(
            f"{files.toml}: [platform] {asked[0]} = true is of the turning Earth below a satellite: its "
            "world is "
            "Earth-fixed; remove it, or [world] and [surface] radii, kind"
        )
    if config.pointing.kind != "fixed":
        raise FormatError(
            f"{files.toml}: [platform] {asked[0]} = true is of lines of sight that are fixed to the body; "
            "remove it, or "
            "[pointing]"
        )
    turns = _turns(config, trajectory)
    total = np.sum([turns[key] for key in asked], axis=0)
    middle = int(np.argmin(np.abs(trajectory.t_attitude - 0.5 * sum(span))))
    distance = float(turns["distance"][middle, 0])
    files.said += [
        f"{key.replace('_', ' ')} is applied: {1e6 * float(np.linalg.norm(turns[key][middle])):.3g} urad, "
        f"{distance * float(np.linalg.norm(turns[key][middle])):.2g} m square to the line of sight"
        for key in asked
    ]
    return replace(trajectory, world_from_body=Rotation.from_rotvec(total) * trajectory.world_from_body)


def _turns(config: AcquisitionFile, trajectory: Trajectory) -> dict[str, Array]:
    """Turns (N, 3), rad, world axes, at the times of the attitudes; `distance` (N, 1), m, of the ground."""
    boresight = mount_of(config.camera).body_from_camera.apply([0.0, 0.0, 1.0])
    seen = trajectory.world_from_body.apply(boresight)
    first, last = trajectory.t_position[0] + _STEP, trajectory.t_position[-1] - _STEP
    alone = replace(
        trajectory, t_attitude=trajectory.t_position[[0, -1]], world_from_body=Rotation.identity(2)
    )
    t = np.clip(trajectory.t_attitude, first, last)
    before, place, after = (alone.at(t + shift).position for shift in (-_STEP, 0.0, _STEP))
    velocity = (after - before) / (2.0 * _STEP)
    ground = Ellipsoid(height=config.surface.height).intersect(place, seen)
    turns: dict[str, Array] = {"distance": np.linalg.norm(ground - place, axis=1, keepdims=True)}
    for key in ("aberration", "light_time"):
        shift = aberration_velocity(
            place, velocity, ground, aberration=key == "aberration", light_time=key == "light_time"
        )
        # seen is along straight + v / c
        straight = seen - shift / LIGHT_SPEED
        turns[key] = straight_turn(seen, straight / np.linalg.norm(straight, axis=1, keepdims=True))
    radius = np.linalg.norm(place, axis=1)
    down = -place / radius[:, np.newaxis]
    off = np.arccos(np.clip(np.sum(seen * down, axis=1), -1.0, 1.0))
    level = float(np.nanmedian(np.linalg.norm(ground, axis=1)))
    axis = np.cross(seen, down)
    size = np.linalg.norm(axis, axis=1)
    angle = np.nan_to_num(refraction_angle(radius, level, off))
    turns["refraction"] = axis * (angle / np.where(size > 0.0, size, 1.0))[:, np.newaxis]
    return turns
