"""Corrected poses for other programs: ``cameras.csv`` again, CCSDS AEM, a COLMAP text model.

Not here: the tables of the result (``stereo_results.py``).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import StereoOrientation, StereoProblem
from sightline.geometry.instrument import AreaDetector
from sightline.io.ccsds import write_aem
from sightline.io.colmap import CORNER, camera_of
from sightline.io.results import AEM_FRAMES
from sightline.io.stereo import Stereo
from sightline.io.stereo_strips import StripProblem
from sightline.io.stereo_tables import CAMERAS
from sightline.io.tables import write_attitudes, write_columns

Array = NDArray[np.float64]


def write_exports(folder: Path, stereo: Stereo, result: StereoOrientation) -> tuple[str, ...]:
    """Every export that the result allows.

    Parameters
    ----------
    folder : Path
        Exists.
    stereo : Stereo
    result : StereoOrientation

    Returns
    -------
    tuple of str
        Why some are missing.
    """
    if not np.isfinite(result.angles).all():
        return ("no corrected poses were written: some angles are not observable",)
    if isinstance(stereo.problem, StripProblem):
        return write_strip_attitudes(folder, stereo, stereo.problem, result)
    write_corrected_cameras(folder / "cameras_corrected.csv", stereo, result)
    write_colmap(folder / "colmap", stereo, result)
    if stereo.problem.epoch is None:
        return ("no attitude message (AEM) was written: [stereo] has no epoch",)
    if stereo.another_body:
        return ("no attitude message (AEM) was written: the body is not the Earth",)
    write_attitude_messages(folder, stereo, result)
    return ()


def write_strip_attitudes(
    folder: Path, stereo: Stereo, problem: StripProblem, result: StereoOrientation
) -> tuple[str, ...]:
    """``attitude_NAME.csv``: corrected attitude of each strip's body at every line; the same as an AEM."""
    messages = problem.epoch is not None and not stereo.another_body
    for camera, name, angles in zip(problem.strips, problem.cameras, result.angles, strict=True):
        t = camera.times(np.arange(float(camera.lines)))
        attitude = (camera.trajectory.at(t).world_from_body * Rotation.from_rotvec(angles.copy())).as_quat()
        write_attitudes(folder / f"attitude_{file_name(name)}.csv", t, attitude)
        if messages:
            write_aem(
                folder / f"attitude_{file_name(name)}.aem",
                t,
                attitude,
                str(problem.epoch),
                object_name=f"STRIP {name}".upper(),
                frame=AEM_FRAMES[stereo.world],
            )
    return () if messages else ("no attitude messages (AEM) were written: no epoch, or another body",)


def corrections(problem: StereoProblem, result: StereoOrientation) -> Rotation:
    """Planned body from actual body of every image, M rotations: constant angles, and their drift."""
    images = problem.images
    angles = result.angles[images.camera]
    if result.drift is not None:
        middle = (images.t.min() + images.t.max()) / 2.0
        angles = angles + (images.t - middle)[:, None] * result.drift[images.camera]
    return Rotation.from_rotvec(angles)


def write_corrected_cameras(path: Path, stereo: Stereo, result: StereoOrientation) -> None:
    """The table of cameras with corrected attitudes, in the axes of ``[world]``, in its own order."""
    poses, problem = stereo.poses, stereo.problem
    corrected = Rotation.from_quat(poses.quat_xyzw) * corrections(problem, result)
    values = [
        np.array(poses.cameras, dtype=str)[poses.camera],
        poses.shots[poses.shot].astype(np.int64),
        poses.t,
        *poses.position.T,
        *corrected.as_quat().T,
    ]
    write_columns(path, dict(zip(CAMERAS, values, strict=True)), dict.fromkeys(CAMERAS, "%.17g"))


def file_name(camera: str) -> str:
    """A camera's name as part of a file's."""
    return re.sub(r"[^\w.-]+", "_", camera) or "_"


def write_attitude_messages(folder: Path, stereo: Stereo, result: StereoOrientation) -> None:
    """``attitude_CAMERA.aem``: corrected attitudes of each camera's body."""
    problem, images = stereo.problem, stereo.problem.images
    if problem.epoch is None:
        return
    corrected = (images.world_from_body * corrections(problem, result)).as_quat()
    for number, camera in enumerate(problem.cameras):
        rows = np.flatnonzero(images.camera == number)
        write_aem(
            folder / f"attitude_{file_name(camera)}.aem",
            images.t[rows],
            corrected[rows],
            problem.epoch,
            object_name=f"CAMERA {camera}".upper(),
            frame=AEM_FRAMES[stereo.world],
        )


def write_colmap(folder: Path, stereo: Stereo, result: StereoOrientation) -> None:
    """A COLMAP text model: ``cameras.txt``, ``images.txt``, ``points3D.txt``, and ``origin.csv``.

    Coordinates are world axes less the origin, so that programs in single precision can show them.
    """
    folder.mkdir(exist_ok=True)
    problem = stereo.problem
    known = np.asarray(np.isfinite(result.points).all(axis=1), dtype=np.bool_)
    origin = np.round(result.points[known].mean(axis=0)) if known.any() else np.zeros(3)
    write_columns(
        folder / "origin.csv", dict(zip("xyz", origin[:, None], strict=True)), dict.fromkeys("xyz", "%.0f")
    )
    _write(folder / "cameras.txt", (_camera_line(k, d) for k, d in enumerate(problem.detectors, 1)))
    good = np.asarray(~result.rejected & known[problem.tracks.point], dtype=np.bool_)
    order = np.argsort(problem.tracks.image, kind="stable")
    # place of each sighting among those of its image
    counts = np.bincount(problem.tracks.image, minlength=len(problem.images))
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    _write(
        folder / "images.txt",
        _image_lines(stereo, result, origin, good, np.split(order, np.cumsum(counts)[:-1])),
    )
    _write(folder / "points3D.txt", _point_lines(problem, result, origin, good, place))


def _write(path: Path, lines: Iterable[str]) -> None:
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("w", encoding="utf-8") as stream:
        stream.writelines(line + "\n" for line in lines)
    os.replace(temporary, path)


def _camera_line(number: int, detector: AreaDetector) -> str:
    """Number, model, size and parameters of a camera."""
    model, values = camera_of(detector)
    lines, columns = detector.shape
    return f"{number} {model} {columns} {lines} " + " ".join(f"{v:.17g}" for v in values)


def _image_lines(
    stereo: Stereo,
    result: StereoOrientation,
    origin: Array,
    good: NDArray[np.bool_],
    rows: list[NDArray[np.intp]],
) -> Iterable[str]:
    """Two lines an image: its pose (camera from world), and its sightings."""
    problem, images = stereo.problem, stereo.problem.images
    body = images.world_from_body * corrections(problem, result)
    mounts = Rotation.concatenate(list(problem.mounts))[images.camera]
    camera_from_world = (body * mounts).inv()
    moved = camera_from_world.apply(images.position - origin)
    x, y, z, w = camera_from_world.as_quat().T
    names = _picture_names(stereo)
    tracks = problem.tracks
    ids = np.where(good, tracks.point + 1, -1)
    for k in range(len(images)):
        pose = [w[k], x[k], y[k], z[k], *(-moved[k])]
        yield f"{k + 1} " + " ".join(f"{v:.17g}" for v in pose) + f" {images.camera[k] + 1} {names[k]}"
        seen = zip((tracks.pixels[rows[k]] + CORNER).tolist(), ids[rows[k]].tolist(), strict=True)
        yield " ".join(f"{column:.10g} {line:.10g} {point}" for (line, column), point in seen)


def _picture_names(stereo: Stereo) -> list[str]:
    """Of the pictures, else ``camera/shot``."""
    problem, images = stereo.problem, stereo.problem.images
    names = [
        f"{problem.cameras[camera]}/{problem.shot_names[shot]:.0f}"
        for camera, shot in zip(images.camera, images.shot, strict=True)
    ]
    if stereo.pictures is not None:
        for row, source in zip(stereo.pictures.image, stereo.pictures.sources, strict=True):
            names[row] = source.path.name
    return names


def _point_lines(
    problem: StereoProblem,
    result: StereoOrientation,
    origin: Array,
    good: NDArray[np.bool_],
    place: NDArray[np.intp],
) -> Iterable[str]:
    """A line a point: place, grey, rms residual (px), and the images that see it."""
    rows = np.flatnonzero(good)
    point = problem.tracks.point[rows]
    rows = rows[np.argsort(point, kind="stable")]
    counts = np.bincount(point, minlength=len(result.points))
    square = np.bincount(problem.tracks.point[rows], result.residual_px[rows] ** 2, len(result.points))
    rms = np.sqrt(square / np.maximum(counts, 1))
    image, where = (problem.tracks.image[rows] + 1).tolist(), place[rows].tolist()
    end = np.cumsum(counts).tolist()
    for k, position in enumerate((result.points - origin).tolist()):
        if not counts[k]:
            continue
        start = end[k] - int(counts[k])
        track = " ".join(f"{image[n]} {where[n]}" for n in range(start, end[k]))
        x, y, z = position
        yield f"{k + 1} {x:.17g} {y:.17g} {z:.17g} 128 128 128 {rms[k]:.6g} {track}"
