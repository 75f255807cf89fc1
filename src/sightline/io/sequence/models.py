"""Poses of frames from another program's model: COLMAP, OpenSfM, or an angle table with positions.

A model needs a place: ``origin.csv`` beside a COLMAP model (``longitude,latitude,height`` of its east,
north, up axes, or ``x,y,z`` in a flat world) or Earth-fixed coordinates, ``reference_lla`` of OpenSfM, the
first line of an angle table. Without one the last two are in the axes of a local ``[world]``; a COLMAP model,
whose place, size and direction mean nothing by themselves, is refused.

Not here: the formats (``io/formats/colmap.py``, ``io/formats/opensfm.py``, ``io/formats/angle_tables.py``),
tables of quaternions (``attitudes.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.earth import from_geodetic, local_axes
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.formats.angle_tables import kind_of_angles, read_angles
from sightline.io.formats.colmap import colmap_files, read_colmap_model
from sightline.io.formats.opensfm import read_opensfm
from sightline.io.formats.tables import header_of, read_columns
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.matched_rows import GivenRows, in_time, matched, radii_of
from sightline.io.sequence.schema import SequenceFile

Array = NDArray[np.float64]
Place = tuple[float, float, float]

#: Where a COLMAP model gives its place.
ORIGIN_FILE = "origin.csv"
GEODETIC, FLAT = ("longitude", "latitude", "height"), ("x", "y", "z")
#: Polar radii of the body beyond which coordinates are counted from its centre.
_EARTH_FIXED = 0.99
#: What may be named.
_NAMED = (
    "`poses` names a folder with a COLMAP model, a reconstruction.json of OpenSfM, or a table "
    "frame,x,y,z,omega,phi,kappa or ...,yaw,pitch,roll"
)


@dataclass(frozen=True, eq=False)
class PoseModel:
    """Poses as a file has them.

    Attributes
    ----------
    kind : str
        In words.
    names : tuple of str
    position : (n, 3)
        m, axes of the file.
    camera : Rotation
        n rotations, axes of the file from those of the camera.
    place : (3,) or None
        Longitude, latitude (degrees), height (m) of the origin of east, north, up axes.
    """

    kind: str
    names: tuple[str, ...]
    position: Array
    camera: Rotation
    place: Place | None


@dataclass(frozen=True, eq=False)
class GivenPoses:
    """Positions (m) and attitudes (world_from_body quaternions) of frames, axes of computation.

    Attributes
    ----------
    path : Path
    positions, attitudes : GivenRows or None
    """

    path: Path
    positions: GivenRows | None
    attitudes: GivenRows | None


def given_poses(
    file: SequenceFile, files: InputFolder, frames: FrameList, mount: Rotation, warnings: list[str]
) -> GivenPoses | None:
    """Poses of the frames that the model `file` names has; None where it names none.

    Raises
    ------
    FormatError
        If the model cannot be read, has no place in ``[world]``, or none of the frames.
    """
    if file.poses is None:
        return None
    path = files.path(file.poses)
    if path.is_dir():
        model, position, attitude = _of_colmap(file, files, path)
    else:
        path = files(file.poses, advice=_NAMED)
        model = _opensfm(path) if path.suffix == ".json" else _angles(path, mount)
        position, attitude = _to_world(file, path, model, model.place)
    frame, t = matched(path, frames, _names_of_files(model.names, frames), None)
    kept = frame >= 0
    warnings.append(
        f"poses by {model.kind} {path.name}: of {int(kept.sum())} of {len(frames.names)} frames; its camera "
        "is not used, [camera] is"
    )
    body = (attitude * mount.inv()).as_quat()
    sigma = np.ones((len(frame), 3))
    positions = in_time(frame, t, position, file.position_sigma * sigma, kept, common=True)
    attitudes = in_time(frame, t, body, file.attitude_sigma * sigma, kept, common=True)
    return GivenPoses(path, positions, attitudes)


def model_attitudes(file: SequenceFile, files: InputFolder) -> tuple[tuple[str, ...], Rotation] | None:
    """Names and attitudes (axes of the file from the camera's) of all images of a COLMAP or OpenSfM model.

    None where `poses` names none of these.
    """
    path = None if file.poses is None else files.path(file.poses)
    if path is None or not (path.is_dir() or path.suffix == ".json"):
        return None
    model = read_colmap_model(path) if path.is_dir() else read_opensfm(path)[0]
    return model.names, model.world_from_camera


def _names_of_files(names: tuple[str, ...], frames: FrameList) -> tuple[str, ...]:
    """Names without the folders that other programs write before them."""
    known = {*frames.names, *(path.name for path in frames.files)}
    return tuple(name if name in known else name.replace("\\", "/").rsplit("/", 1)[-1] for name in names)


def _opensfm(path: Path) -> PoseModel:
    model, place = read_opensfm(path)
    return PoseModel("the OpenSfM model", model.names, model.position, model.world_from_camera, place)


def _angles(path: Path, mount: Rotation) -> PoseModel:
    if kind_of_angles(path) is None:
        raise FormatError(
            f"{path}: the header is {','.join(header_of(path))!r}; `poses` takes a table "
            "frame,x,y,z,omega,phi,kappa or frame,x,y,z,yaw,pitch,roll; give one with quaternions, such as "
            "poses.csv, as positions and as attitudes"
        )
    table = read_angles(path)
    return PoseModel("the table", table.names, table.position, table.camera(mount), table.origin)


def _of_colmap(file: SequenceFile, files: InputFolder, folder: Path) -> tuple[PoseModel, Array, Rotation]:
    """A COLMAP model; its positions and attitudes of the camera, axes of computation."""
    read = read_colmap_model(folder)
    for path in colmap_files(folder):
        files(f"{file.poses}/{path.name}")
    model = PoseModel("the COLMAP model", read.names, read.position, read.world_from_camera, None)
    radii, origin = radii_of(file), folder / ORIGIN_FILE
    if origin.is_file():
        place = _read_origin(files(f"{file.poses}/{ORIGIN_FILE}"), flat=radii is None)
        if radii is None:
            return model, model.position + place, model.camera
        return model, *_to_world(file, folder, model, place)
    far = np.linalg.norm(model.position, axis=1)
    if radii is not None and (far > _EARTH_FIXED * radii[1]).all():
        return model, model.position, model.camera
    raise FormatError(
        f"{folder}: the COLMAP model does not say where it lies: place, size and direction of such a model "
        f"are arbitrary; bring it to the world (colmap model_aligner, --alignment_type enu) and write "
        f"{ORIGIN_FILE} beside it: "
        + (
            "x,y,z of its origin in the flat [world]"
            if radii is None
            else "longitude,latitude,height of its east, north, up axes (or --alignment_type ecef without)"
        )
    )


def _read_origin(path: Path, *, flat: bool) -> Place:
    """The one row of ``origin.csv``."""
    columns = FLAT if flat else GEODETIC
    if not set(columns) <= set(header_of(path)):
        raise FormatError(
            f"{path}: the header is {','.join(header_of(path))!r}; of a [world] "
            + ("without a place on the Earth" if flat else "on the Earth")
            + f" {','.join(columns)!r} are expected"
        )
    table = read_columns(path, columns)
    x, y, z = (float(np.asarray(table[name], dtype=np.float64)[0]) for name in columns)
    return x, y, z


def _to_world(
    file: SequenceFile, path: Path, model: PoseModel, place: Place | None
) -> tuple[Array, Rotation]:
    """Positions and attitudes of the camera in the axes of computation, of level axes at `place`."""
    radii = radii_of(file)
    if radii is None:
        if place is not None:
            raise FormatError(
                f"{path}: {model.kind} lies at longitude {place[0]:.6g}, latitude {place[1]:.6g}, [world] "
                f"has no place: give [world] origin = [{place[0]:.10g}, {place[1]:.10g}, {place[2]:.6g}]"
            )
        return model.position, model.camera
    if place is None and file.world.frame == "local":
        place = file.world.origin
    if place is None:
        raise FormatError(
            f"{path}: {model.kind} does not say where its axes are (reference_lla of OpenSfM, a first line "
            '"# origin = longitude,latitude,height" of a table); add it, or give [world] frame = "local" '
            "with their origin"
        )
    longitude, latitude = np.radians(place[:2])
    level = local_axes(longitude, latitude)
    origin = from_geodetic([[longitude, latitude, place[2]]], radii)[0]
    return origin + level.apply(np.array(model.position)), level * model.camera
