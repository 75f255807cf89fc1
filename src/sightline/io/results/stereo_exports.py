"""Corrected poses for other programs: ``cameras.csv`` again, CCSDS AEM, a COLMAP text model.

Not here: the tables of the result (``stereo.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.io.formats.ccsds import write_aem
from sightline.io.formats.colmap import write_colmap_model
from sightline.io.formats.reconstruction import Reconstruction, points_of
from sightline.io.formats.tables import write_attitudes, write_columns
from sightline.io.names import file_stems, single_words
from sightline.io.results.line_of_sight import AEM_FRAMES
from sightline.io.stereo.load import Stereo
from sightline.io.stereo.strips import StripProblem
from sightline.io.stereo.tables import CAMERAS
from sightline.photogrammetry.pair.problem import StereoProblem

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
    stems = file_stems(problem.cameras)
    for camera, name, stem, angles in zip(problem.strips, problem.cameras, stems, result.angles, strict=True):
        t = camera.times(np.arange(float(camera.lines)))
        attitude = (camera.trajectory.at(t).world_from_body * Rotation.from_rotvec(angles.copy())).as_quat()
        write_attitudes(folder / f"attitude_{stem}.csv", t, attitude)
        if messages:
            write_aem(
                folder / f"attitude_{stem}.aem",
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


def write_attitude_messages(folder: Path, stereo: Stereo, result: StereoOrientation) -> None:
    """``attitude_CAMERA.aem``: corrected attitudes of each camera's body."""
    problem, images = stereo.problem, stereo.problem.images
    if problem.epoch is None:
        return
    corrected = (images.world_from_body * corrections(problem, result)).as_quat()
    for number, (camera, stem) in enumerate(zip(problem.cameras, file_stems(problem.cameras), strict=True)):
        rows = np.flatnonzero(images.camera == number)
        write_aem(
            folder / f"attitude_{stem}.aem",
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
    problem = stereo.problem
    known = np.asarray(np.isfinite(result.points).all(axis=1), dtype=np.bool_)
    origin = np.round(result.points[known].mean(axis=0)) if known.any() else np.zeros(3)
    images, tracks = problem.images, problem.tracks
    good = ~result.rejected & known[tracks.point]
    body = images.world_from_body * corrections(problem, result)
    model = Reconstruction(
        _picture_names(stereo),
        problem.detectors,
        images.camera,
        images.position - origin,
        body * Rotation.concatenate(list(problem.mounts))[images.camera],
        *points_of(result.points - origin, tracks.point, result.residual_px**2, good),
        tracks.image,
        np.where(good, tracks.point, -1),
        tracks.pixels,
    )
    write_colmap_model(folder, model)
    write_columns(
        folder / "origin.csv", dict(zip("xyz", origin[:, None], strict=True)), dict.fromkeys("xyz", "%.0f")
    )


def _picture_names(stereo: Stereo) -> tuple[str, ...]:
    """Of the pictures, where each has one of its own, else ``camera/shot``; without spaces."""
    problem, images = stereo.problem, stereo.problem.images
    names = [
        f"{problem.cameras[camera]}/{problem.shot_names[shot]:.0f}"
        for camera, shot in zip(images.camera, images.shot, strict=True)
    ]
    labels = list(names)
    if stereo.pictures is not None:
        for row, source in zip(stereo.pictures.image, stereo.pictures.sources, strict=True):
            labels[row] = source.path.name
    if len(set(labels)) < len(labels):
        labels = names
    return single_words(labels)
