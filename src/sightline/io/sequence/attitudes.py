"""Rough attitudes of frames: a table of quaternions or angles, a SBET, gimbals of photographs.

Not here: rows at the times of frames (``matched_rows.py``), what angles mean (``io/formats/angle_tables.py``,
``io/formats/xmp.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.earth import local_axes
from sightline.io.acquisition.acquired import InputFolder, attitude_to_world
from sightline.io.acquisition.ground import exchanged_view_words
from sightline.io.formats.angle_tables import (
    ENU_FROM_NED,
    OPK,
    YPR,
    body_of_ypr,
    camera_of_opk,
    kind_of_angles,
    origin_of_angles,
)
from sightline.io.formats.sbet import is_sbet
from sightline.io.formats.tables import check_quaternions, header_of, read_columns
from sightline.io.quantities import ANGLE_SIGMA
from sightline.io.sequence.flown import flown_at_frames
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.matched_rows import GivenRows, in_time, matched, radii_of, sigmas_of
from sightline.io.sequence.models import GivenPoses
from sightline.io.sequence.schema import SequenceFile
from sightline.io.sequence.times import read_timed
from sightline.photogrammetry.block.point_priors import level_axes

Array = NDArray[np.float64]

ATTITUDE_SIGMAS = ("sigma_roll", "sigma_pitch", "sigma_yaw")
QUATERNION = ("qx", "qy", "qz", "qw")
#: rad from straight down beyond which angles of a mapping camera are taken to be wrong.
_OFF_NADIR = np.radians(80.0)
#: Degrees; pitch of a table of angles from which down on it is asked whether it is that of a gimbal.
_GIMBAL_PITCH = -45.0


def given_attitudes(
    file: SequenceFile,
    files: InputFolder,
    frames: FrameList,
    mount: Rotation,
    position: Array,
    model: GivenPoses | None,
    warnings: list[str],
) -> GivenRows | None:
    """Given attitudes (quaternions world_from_body of computation); None where there are none."""
    radii = radii_of(file)
    if file.attitudes is not None:
        path = files(file.attitudes)
        given = _table_attitudes(file, path, frames, mount, position, warnings)
    elif model is not None:
        path, given = model.path, model.attitudes
    elif frames.xmp:
        path, given = frames.path, _gimbal_attitudes(file, frames, mount, position, warnings)
    else:
        return None
    if given is None:
        return None
    down = -level_axes(position_at(frames.t, position, given.t), radii)[0]
    looks = Rotation.from_quat(given.values).apply(mount.as_matrix()[:, 2])
    off = np.arccos(np.clip(np.einsum("ni,ni->n", down, looks), -1.0, 1.0))
    wrong = off > _OFF_NADIR
    gimbal = _gimbal_words(path) if file.attitudes is not None else ""
    exchanged = exchanged_view_words(position_at(frames.t, position, given.t), looks, radii)
    if wrong.all():
        raise FormatError(
            f"{path}: by these attitudes the camera looks {np.degrees(np.median(off)):.0f} degrees "
            "from straight down, "
            "away from the ground, in every frame; check qx,qy,qz,qw (world_from_body, scalar last), "
            "[camera] mount, "
            f"and [world]; or remove the attitudes{exchanged}{gimbal}"
        )
    if gimbal:
        warnings.append(f"{path.name}: {gimbal.removeprefix('; ')}")
    if exchanged:
        warnings.append(f"{path.name}: {exchanged.removeprefix('; ')}")
    if wrong.any():
        name = (
            frames.names[given.frame[wrong][0]]
            if given.frame[wrong][0] >= 0
            else f"t = {given.t[wrong][0]:g}"
        )
        warnings.append(
            f"{path.name}: {int(wrong.sum())} attitudes look away from the ground (first: {name}): left out"
        )
    return in_time(given.frame, given.t, given.values, given.sigma, ~wrong, common=given.common)


def _gimbal_words(path: Path) -> str:
    """A doubt, to end a message, where pitch of a table of angles is that of a gimbal."""
    if is_sbet(path) or kind_of_angles(path) != YPR:
        return ""
    pitch = float(np.median(np.asarray(read_columns(path, ("pitch",))["pitch"], dtype=np.float64)))
    if pitch > _GIMBAL_PITCH:
        return ""
    return (
        f"; pitch, {pitch:.3g} degrees in the middle, is that of the body: 0 in level flight with the camera "
        "straight down. Is it that of a gimbal, which is -90 there? Then add 90 to each"
    )


def position_at(t: Array, position: Array, at: Array) -> Array:
    """Positions (n, 3) at other times than those of the frames."""
    return np.column_stack([np.interp(at, t, axis) for axis in position.T])


def _table_attitudes(
    file: SequenceFile,
    path: Path,
    frames: FrameList,
    mount: Rotation,
    position: Array,
    warnings: list[str],
) -> GivenRows | None:
    if is_sbet(path):
        _, flown = flown_at_frames(file, path, frames, warnings)
        rows = np.arange(len(frames.t))
        _say_assumed(file, warnings, len(rows))
        sigma = np.full((len(rows), 3), file.attitude_sigma)
        kept = np.ones(len(rows), dtype=np.bool_)
        return in_time(rows, frames.t, flown.as_quat(), sigma, kept, common=True)
    header = header_of(path)
    kind = kind_of_angles(path)
    with_sigma = [name for name in ATTITUDE_SIGMAS if name in header]
    if with_sigma and len(with_sigma) < 3:
        raise FormatError(
            f"{path}: has {', '.join(with_sigma)} alone; sigma_roll,sigma_pitch,sigma_yaw are expected"
        )
    angles = QUATERNION if kind is None else kind
    timed = ("t",) if "t" in header or kind is None else ()
    columns = ("frame", *timed, *angles, *with_sigma)
    if timed:
        table = read_timed(path, columns, frames.epoch, text=("frame",), infinite=ATTITUDE_SIGMAS)
    else:
        table = read_columns(path, columns, text=("frame",), infinite=ATTITUDE_SIGMAS)
    names = tuple(str(word) for word in table["frame"])
    frame, t = matched(path, frames, names, np.asarray(table["t"], dtype=np.float64) if timed else None)
    values = np.column_stack([np.asarray(table[name], dtype=np.float64) for name in angles])
    if kind is None:
        attitude = attitude_to_world(Rotation.from_quat(check_quaternions(path, values)), file)
    else:
        level = _axes_of_angles(file, path, position_at(frames.t, position, np.nan_to_num(t)))
        body = camera_of_opk(values) * mount.inv() if kind == OPK else body_of_ypr(values)
        attitude = level * body
    if not with_sigma:
        _say_assumed(file, warnings, len(t))
    sigma = sigmas_of(path, table, with_sigma, len(t), file.attitude_sigma, ANGLE_SIGMA)
    return in_time(frame, t, attitude.as_quat(), sigma, np.ones(len(t), dtype=np.bool_))


def _axes_of_angles(file: SequenceFile, path: Path, position: Array) -> Rotation:
    """World from the level axes of a table of angles: at its origin, or at each place where it has none."""
    origin, radii = origin_of_angles(path), radii_of(file)
    if origin is None or radii is None:
        return level_at(position, radii)
    return Rotation.concatenate([local_axes(*np.radians(origin[:2]))] * len(position))


def _say_assumed(file: SequenceFile, warnings: list[str], count: int) -> None:
    """The sigma that is taken where none is given."""
    if count and "attitude_sigma" not in file.model_fields_set:
        warnings.append(
            f"{count} attitudes have no sigma: {file.attitude_sigma:.3g} rad "
            f"({np.degrees(file.attitude_sigma):.3g} degrees) per axis is assumed; set attitude_sigma"
        )


def _gimbal_attitudes(
    file: SequenceFile, frames: FrameList, mount: Rotation, position: Array, warnings: list[str]
) -> GivenRows | None:
    """Attitudes by the gimbals of photographs."""
    rows, turns = [], []
    for k, xmp in enumerate(frames.xmp):
        camera = None if xmp is None else xmp.north_east_down_from_camera()
        if camera is not None:
            rows.append(k)
            turns.append(camera)
    if not rows:
        return None
    frame = np.array(rows, dtype=np.intp)
    level = level_at(position[frame], radii_of(file))
    body = level * ENU_FROM_NED * Rotation.concatenate(turns) * mount.inv()
    _say_assumed(file, warnings, len(rows))
    sigma = np.full((len(rows), 3), file.attitude_sigma)
    kept = np.ones(len(rows), dtype=np.bool_)
    return in_time(frame, frames.t[frame], body.as_quat(), sigma, kept, common=True)


def level_at(position: Array, radii: tuple[float, float] | None) -> Rotation:
    """World from east, north, up at positions (M, 3)."""
    up, east, north = level_axes(position, radii)
    return Rotation.from_matrix(np.stack([east, north, up], axis=-1))
