"""Poses of a sequence → ``poses.csv``, ``covariance.npz``, and the files of other programs.

Positions of ``colmap/``, ``reconstruction.json`` and the angle tables are small numbers: level axes (east,
north, up) about a place near the middle of the flight, which each file names; COLMAP's in
``colmap/origin.csv``.

Not here: the formats (``poses.py``, ``io/formats/colmap.py``, ``io/formats/opensfm.py``,
``io/formats/odm.py``, ``io/formats/angle_tables.py``, ``io/formats/footprints.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import frozen
from sightline.geometry.earth import from_geodetic, local_axes, to_geodetic
from sightline.io.formats.angle_tables import OPK, YPR, AngleTable, opk_of_camera, write_angles, ypr_of_body
from sightline.io.formats.colmap import write_colmap_model
from sightline.io.formats.footprints import footprint_features, ground_outlines, write_footprints
from sightline.io.formats.odm import write_geo
from sightline.io.formats.opensfm import write_opensfm
from sightline.io.formats.reconstruction import Reconstruction
from sightline.io.formats.tables import write_columns
from sightline.io.names import single_words
from sightline.io.results.poses import (
    FocalLength,
    FramePoseTable,
    PoseCovariance,
    in_table_axes,
    pose_axes,
    write_pose_covariance,
    write_poses,
)
from sightline.io.sequence.load import FrameSequence
from sightline.io.sequence.models import FLAT, GEODETIC, ORIGIN_FILE
from sightline.photogrammetry.flight.found_ground import level_ground
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig_solver import RigAdjusted
from sightline.photogrammetry.sightings import Tracks

Array = NDArray[np.float64]

#: Beside a COLMAP model: positions of its images with their covariance.
PRIORS_FILE = "pose_priors.csv"


@dataclass(frozen=True, eq=False)
class LevelAxes:
    """East, north, up about a place.

    Attributes
    ----------
    origin : (3,)
        m, axes of computation.
    axes : Rotation
        computation_from_level.
    place : (3,) or None
        Longitude, latitude (degrees), height (m); None in a flat world, whose own axes they are.
    """

    origin: Array
    axes: Rotation
    place: tuple[float, float, float] | None

    def points(self, points: Array) -> Array:
        """Points (n, 3) in these axes."""
        return np.asarray(self.axes.inv().apply(points - self.origin))

    def turned(self, attitude: Rotation) -> Rotation:
        """Attitudes in these axes."""
        return self.axes.inv() * attitude


def level_axes_of(problem: SequenceProblem, position: Array) -> LevelAxes:
    """Level axes about the middle of the flight, rounded to 1e-4 degrees and m; of a flat world its own."""
    if problem.radii is None:
        return LevelAxes(np.zeros(3), Rotation.identity(), None)
    lon, lat, height = to_geodetic(position.mean(axis=0)[None], problem.radii)[0]
    place = (round(float(np.degrees(lon)), 4), round(float(np.degrees(lat)), 4), round(float(height), 0))
    radians = np.radians(place[:2])
    origin = from_geodetic([[*radians, place[2]]], problem.radii)[0]
    return LevelAxes(origin, local_axes(*radians), place)


def write_sequence_poses(
    folder: Path, sequence: FrameSequence, poses: FramePoses, source: Sequence[str]
) -> None:
    """``poses.csv`` and ``covariance.npz`` in the axes of ``[world]``.

    Parameters
    ----------
    folder : Path
        Exists.
    sequence : FrameSequence
    poses : FramePoses
        Of all its frames.
    source : sequence of str
        Of each: solved, estimated or interpolated.
    """
    problem = sequence.problem
    position, attitude, covariance = in_table_axes(
        sequence.world, problem.radii, poses.position, poses.world_from_body, poses.covariance
    )
    sigma = np.sqrt(np.einsum("mii->mi", covariance))
    table = FramePoseTable(problem.frames, problem.t, position, attitude.as_quat(), sigma, tuple(source))
    write_poses(folder / "poses.csv", table)
    turn = np.eye(6)
    turn[:3, :3] = pose_axes(sequence.world, problem.radii)[1].as_matrix().T
    focal = None
    if poses.focal is not None:
        given = problem.detector.focal_length_px
        row = np.append(given * turn @ poses.focal.with_bias, (given * poses.focal.sigma) ** 2)
        focal = FocalLength(poses.detector(problem.detector).focal_length_px, frozen(row))
    pairs = poses.pair_covariance
    if pairs is not None:
        pairs = frozen(np.einsum("ij,mjnk,lk->minl", turn, pairs, turn))
    write_pose_covariance(
        folder / "covariance.npz",
        PoseCovariance(
            problem.frames, covariance, turn @ poses.bias, turn @ poses.bias_covariance @ turn.T, focal,
            frozen(turn @ poses.next_covariance @ turn.T), pairs, poses.scale_sigma,
        ),
    )  # fmt: skip


def write_pose_exports(
    folder: Path,
    sequence: FrameSequence,
    poses: FramePoses,
    source: Sequence[str],
    tracks: Tracks | None = None,
    rig: RigAdjusted | None = None,
) -> tuple[str, ...]:
    """The same poses for other programs.

    ``colmap/`` (text), ``reconstruction.json``, ``opk.csv``, ``ypr.csv``, ``geo.txt``,
    ``footprints.geojson``.

    Parameters
    ----------
    folder : Path
        Exists.
    sequence : FrameSequence
    poses : FramePoses
    source : sequence of str
        As of `write_sequence_poses`.
    tracks : Tracks, optional
        Sightings of the points of `poses`, as many as its residuals.
    rig : RigAdjusted, optional
        Of several cameras: models for other programs hold the images of all.

    Returns
    -------
    tuple of str
        Why an export is missing.
    """
    problem = sequence.problem
    level = level_axes_of(problem, poses.position)
    names = picture_names(sequence)
    model = reconstruction_of(problem, names, poses, tracks, level)
    whole = model if rig is None else rig_reconstruction(sequence, poses, rig, level)
    write_colmap_model(folder / "colmap", whole)
    place = level.place or (0.0, 0.0, 0.0)
    columns = GEODETIC if level.place is not None else FLAT
    write_columns(
        folder / "colmap" / ORIGIN_FILE,
        dict(zip(columns, np.array(place)[:, None], strict=True)),
        dict.fromkeys(columns, "%.10g"),
    )
    _write_priors(folder / "colmap" / PRIORS_FILE, model, poses, level)
    write_opensfm(folder / "reconstruction.json", whole, level.place)
    body = level.turned(poses.world_from_body)
    for name, kind, angles in (
        ("opk.csv", OPK, opk_of_camera(model.world_from_camera)),
        ("ypr.csv", YPR, ypr_of_body(body)),
    ):
        write_angles(folder / name, AngleTable(problem.frames, model.position, angles, kind, level.place))
    if problem.radii is None:
        return ("geo.txt and footprints.geojson were not written: [world] has no place on the Earth",)
    _write_places(folder, sequence, poses, source, names)
    return ()


def _write_priors(path: Path, model: Reconstruction, poses: FramePoses, level: LevelAxes) -> None:
    """Positions of the images (of a rig: of its first camera's) with their covariance, axes of the model."""
    axes = level.axes.inv().as_matrix()
    rows = np.flatnonzero(np.isfinite(poses.covariance).all(axis=(1, 2)))
    covariance = axes @ poses.covariance[rows, :3, :3] @ axes.T
    columns: dict[str, Any] = {"image": np.array(model.names, dtype=str)[rows]}
    columns |= {axis: model.position[rows, k] for k, axis in enumerate("xyz")}
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    columns |= {f"cov_{'xyz'[i]}{'xyz'[j]}": covariance[:, i, j] for i, j in pairs}
    write_columns(path, columns)


def picture_names(sequence: FrameSequence) -> tuple[str, ...]:
    """Names of the images' files; of the frames, where two files have the same or one is not one word."""
    names = tuple(path.name for path in sequence.files)
    return names if single_words(names) == names else single_words(sequence.problem.frames)


def reconstruction_of(
    problem: SequenceProblem,
    names: tuple[str, ...],
    poses: FramePoses,
    tracks: Tracks | None,
    level: LevelAxes,
) -> Reconstruction:
    """Poses, good sightings and their points in level axes."""
    position = level.points(np.array(poses.position))
    attitude = level.turned(poses.world_from_body) * problem.mount
    detectors = (poses.detector(problem.detector),)
    camera = np.zeros(len(problem), dtype=np.intp)
    if tracks is None:
        return Reconstruction(names, detectors, camera, position, attitude)
    known = np.flatnonzero(np.isfinite(poses.points).all(axis=1))
    good = np.flatnonzero(~poses.rejected & np.isin(tracks.point, known))
    point = tracks.point[good]
    kept, number = np.unique(point, return_inverse=True)
    square = np.bincount(number, (poses.residual_px[good] ** 2).sum(axis=1), len(kept))
    rms = np.sqrt(square / np.maximum(np.bincount(number, minlength=len(kept)), 1))
    return Reconstruction(
        names,
        detectors,
        camera,
        position,
        attitude,
        level.points(poses.points[kept]),
        rms,
        tracks.image[good],
        number,
        _of_first_lines(problem, poses, tracks, good),
    )


def rig_reconstruction(
    sequence: FrameSequence, poses: FramePoses, rig: RigAdjusted, level: LevelAxes
) -> Reconstruction:
    """Poses of the images of all cameras of a rig, and points that they show, in level axes."""
    problem, offsets, count = sequence.problem, rig.offsets, len(sequence.problem)
    captures = replace(problem.images, position=poses.position, world_from_body=poses.world_from_body)
    images = offsets.images(captures)
    cameras = problem.rig
    files = sequence.rig_files or tuple((None,) * count for _ in cameras)
    there = np.array([
        camera.usable[k] for camera in cameras for k in range(count)
    ])  # fmt: skip
    rows = np.flatnonzero(there)
    number = np.full(len(there), -1)
    number[rows] = np.arange(len(rows))
    mounts = Rotation.concatenate([cameras[c].mount for c in images.camera[rows]])
    names = tuple(_image_name(problem, files, int(k), count) for k in rows)
    if len(set(names)) < len(names):
        names = tuple(f"{cameras[k // count].name}/{name}" for k, name in zip(rows, names, strict=True))
    known = np.flatnonzero(np.isfinite(rig.poses.points).all(axis=1))
    good = np.flatnonzero(~rig.poses.rejected & np.isin(rig.tracks.point, known) & there[rig.tracks.image])
    kept, point = np.unique(rig.tracks.point[good], return_inverse=True)
    square = np.bincount(point, (rig.poses.residual_px[good] ** 2).sum(axis=1), len(kept))
    rms = np.sqrt(square / np.maximum(np.bincount(point, minlength=len(kept)), 1))
    return Reconstruction(
        single_words(names),
        tuple(offsets.detector(c, camera.detector) for c, camera in enumerate(cameras)),
        images.camera[rows],
        level.points(np.array(images.position[rows])),
        level.turned(images.world_from_body[rows]) * mounts,
        level.points(rig.poses.points[kept]),
        rms,
        number[rig.tracks.image[good]],
        point,
        rig.tracks.pixels[good],
        single_words(problem.frames),
        rows % count,
    )


def _image_name(
    problem: SequenceProblem, files: Sequence[Sequence[Path | None]], image: int, count: int
) -> str:
    """Name of the file of an image of a rig; made of capture and camera where it has none."""
    camera, capture = divmod(image, count)
    path = files[camera][capture]
    return f"{problem.frames[capture]}-{problem.rig[camera].name}" if path is None else path.name


def _of_first_lines(
    problem: SequenceProblem, poses: FramePoses, tracks: Tracks, rows: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Pixels (n, 2) of some sightings as if all lines had been exposed with the first.

    These formats know one pose a frame: raw pixels beside the poses of first lines would contradict them.
    """
    if poses.readout_time(problem.readout_time) == 0.0:
        return tracks.pixels[rows]
    image = tracks.image[rows]
    seen = poses.points[tracks.point[rows]] - poses.position[image]
    rays = (poses.world_from_body[image] * problem.mount).inv().apply(seen)
    return np.asarray(poses.detector(problem.detector).pixels(rays) + poses.residual_px[rows])


def _write_places(
    folder: Path, sequence: FrameSequence, poses: FramePoses, source: Sequence[str], names: tuple[str, ...]
) -> None:
    """``geo.txt`` and footprints."""
    problem = sequence.problem
    radii = problem.radii
    if radii is None:
        return
    geodetic = to_geodetic(poses.position, radii)
    axes = local_axes(geodetic[:, 0], geodetic[:, 1]).as_matrix()
    known = np.isfinite(poses.covariance).all(axis=(1, 2))
    variance = np.full((len(problem), 3), np.inf)
    variance[known] = np.einsum("mji,mjk,mki->mi", axes[known], poses.covariance[known, :3, :3], axes[known])
    horizontal = np.sqrt(variance[:, :2].mean(axis=1))
    lonlat = np.column_stack([np.degrees(geodetic[:, :2]), geodetic[:, 2]])
    write_geo(folder / "geo.txt", names, lonlat, np.column_stack([horizontal, np.sqrt(variance[:, 2])]))
    write_footprints(folder / "footprints.geojson", *_outlines(problem, poses, source))


def _outlines(
    problem: SequenceProblem, poses: FramePoses, source: Sequence[str]
) -> tuple[tuple[str, ...], Array, tuple[float, float] | None, dict[str, list[Any]]]:
    """What `write_footprints` and `footprint_features` take."""
    detector, ground = poses.detector(problem.detector), level_ground(problem, poses)
    edges = ground_outlines(detector, problem.mount, poses.position, poses.world_from_body, ground)
    return problem.frames, edges, problem.radii, {"t": problem.t.tolist(), "source": list(source)}


def frame_features(
    problem: SequenceProblem, poses: FramePoses, source: Sequence[str]
) -> list[dict[str, Any]]:
    """GeoJSON features of what each frame shows; none in a flat world."""
    return [] if problem.radii is None else footprint_features(*_outlines(problem, poses, source))
