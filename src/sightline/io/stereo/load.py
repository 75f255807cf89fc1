"""A STEREO.toml as a StereoProblem.

Not here: keys and allowed values (``schema.py``), its tables (``tables.py``), what is refused
of its geometry (``checks.py``), push-broom strips (``strips.py``), the results
(``io/results/stereo.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, GeometryError
from sightline.geometry.earth import WGS84
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.io.acquisition.acquired import InputFolder, attitude_to_world, input_files, sha256
from sightline.io.acquisition.platform import points_to_world
from sightline.io.camera_schema import wide_words
from sightline.io.config import read_toml, validate
from sightline.io.formats.images import Source, check_content, open_image
from sightline.io.stereo.checks import (
    aim_of,
    boresights,
    check_aim,
    check_baseline,
    check_in_front,
    check_spread,
)
from sightline.io.stereo.points import block_of, check_points, ground_of, without_single
from sightline.io.stereo.schema import StereoCamera, StereoFile
from sightline.io.stereo.strips import strip_problem
from sightline.io.stereo.tables import (
    PointTable,
    StereoPoseTable,
    listed,
    read_image_list,
    read_observations,
    read_poses,
    read_stereo_matches,
)
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Images, Tracks, rays_of
from sightline.result import set_source

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Relative difference of the radius of a sphere that stands for the Earth.
SPHERE = 5e-3


@dataclass(frozen=True, eq=False)
class StereoImages:
    """Pictures in which points are to be found.

    Attributes
    ----------
    image : (M,) int
        Row of the problem's images, for each picture.
    sources : tuple of ImageSource
    floor_px : float
        px; to be added to the sigma of every match in quadrature.
    """

    image: Index
    sources: tuple[Source, ...]
    floor_px: float = 0.0


@dataclass(frozen=True, eq=False)
class Stereo:
    """A STEREO.toml with what only its files and its page need.

    Attributes
    ----------
    path : Path
    name : str
        Title of the report.
    problem : StereoProblem
    surface : Surface
        The ground, as well as it is known.
    world : str
        ``"local"`` (z up) or ``"earth-fixed"``.
    another_body : bool
        Whether ``[surface] radii`` are not those of the Earth, nor of a sphere like it.
    poses : PoseTable
        Planned poses as they stand in the file, axes of ``[world]``.
    pairs : int or None
        Of ``matches``: how many; sighting n and sighting n + pairs are one match.
    pictures : StereoImages or None
        Where points are not found yet.
    inputs : tuple of Path
        Every file that was read or will be.
    absent : tuple of str
        Pictures that are not there, where the problem was only to be described.
    """

    path: Path
    name: str
    problem: StereoProblem
    surface: Surface
    world: str
    another_body: bool
    poses: StereoPoseTable
    pairs: int | None
    pictures: StereoImages | None
    inputs: tuple[Path, ...] = field(repr=False)
    absent: tuple[str, ...] = ()

    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of every input file by its name (for ``summary.json``)."""
        return {path.name: sha256(path) for path in self.inputs}


def load_stereo(path: str | Path) -> StereoProblem:
    """The problem of a STEREO.toml.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed; also for the tables it names.
    GeometryError
        If the cameras do not look at the same ground.
    EstimationError
        If there are too few points, or all on one line.
    """
    return read_stereo(Path(path)).problem


def read_stereo_file(path: Path) -> StereoFile:
    """The validated content of a STEREO.toml, no file it names opened."""
    return validate(StereoFile, read_toml(path), path)


def read_stereo(path: Path, *, planned: bool = False, describe: bool = False) -> Stereo:
    """Everything a STEREO.toml says; errors as of `load_stereo`.

    With `planned`, points need not be there yet: a prediction lays them out. With `describe`, pictures need
    not be there: those that are not are named in `Stereo.absent`.
    """
    file = read_stereo_file(path)
    with input_files(path, file) as files:
        files.describing = describe
        stereo = _stereo(path, file, files, planned=planned)
    set_source(stereo.problem, stereo)
    set_source(stereo.problem.tracks, stereo)
    return stereo


def _stereo(path: Path, file: StereoFile, files: InputFolder, *, planned: bool) -> Stereo:
    """The file with everything that it names."""
    if file.plan is not None:
        raise FormatError(
            f"{path}: [plan] is a pass not yet flown: ask for its bound with --predict, or give cameras = "
            "FILE and points in place of [plan]"
        )
    if not file.sources and not planned:
        raise FormatError(
            f"{path}: nothing brings points: give matches = FILE (two cameras), observations = FILE (any "
            "number of cameras) or images = FILE; or ask for the bound with --predict, which needs none"
        )
    if file.strip:
        return _strips(file, files)
    if file.cameras is None or file.camera is None:
        raise FormatError(f"{path}: cameras and [camera] are missing; add them")
    poses_path = files(file.cameras)
    poses = read_poses(poses_path)
    cameras = camera_sections(file.camera, poses.cameras, path)
    detectors = tuple(
        stereo_detector(name, section) for name, section in zip(poses.cameras, cameras, strict=True)
    )
    mounts = tuple(section.mounting for section in cameras)
    images = _images(poses, poses_path, file)
    check_baseline(poses_path, poses.cameras, images, file.noise.sigma_position)
    table, points_path = _points(file, files, poses)
    shapes, local = [detector.shape for detector in detectors], _is_local(file)
    tracks, names, control = block_of(file, files, poses, table, images.camera, shapes, local=local)
    aim = _aim(file, path, poses.cameras, images, mounts)
    warnings: tuple[str, ...] = ()
    if table is not None:
        tracks, names, control, warnings = without_single(tracks, names, control)
    origins, looks = images.position, boresights(images, mounts)
    # where points are to be found yet, control points alone are seen, each in one image
    seen = tracks if table is not None else Tracks.none()
    if len(seen):
        origins, looks = origins[seen.image], rays_of(images, detectors, mounts, seen)
        if control is not None:
            check_in_front(f"{path}: {file.control_points}", control, names, seen, origins, looks)
    camera = images.camera[seen.image]
    doubts = tuple(dict.fromkeys(words for detector in detectors for words in wide_words(detector)))
    try:
        heights, surface, more = ground_of(
            file, files, points_path, poses.cameras, camera, seen, origins, looks, local=local
        )
    except GeometryError as error:
        raise GeometryError("; ".join([str(error), *doubts])) from None
    if table is not None:
        check_points(points_path, len(poses.cameras), tracks, names, control, heights)
        check_spread(points_path, camera, tracks)
    problem = StereoProblem(
        cameras=poses.cameras,
        images=images,
        shot_names=poses.shots,
        detectors=detectors,
        mounts=mounts,
        tracks=tracks,
        point_names=names,
        noise=PoseNoise(file.noise.sigma_position, file.noise.sigma_attitude, aim),
        radii=None if _is_local(file) else (file.surface.radii or WGS84),
        heights=heights,
        control=control,
        focal_sigma=_focal_sigma(cameras),
        epoch=file.stereo.epoch,
        warnings=warnings + doubts + more,
        sigma_px=file.noise.sigma_px,
    )
    pictures = None if file.images is None else _pictures(files, file, poses, detectors)
    return Stereo(
        path,
        file.stereo.name,
        problem,
        surface,
        "local" if _is_local(file) else "earth-fixed",
        _on_another_body(file),
        poses,
        None if table is None else table.pairs,
        pictures,
        tuple(files.used),
        tuple(files.absent),
    )


def _strips(file: StereoFile, files: InputFolder) -> Stereo:
    """A file with ``[[strip]]``."""
    problem, poses, surface, local = strip_problem(file, files)
    return Stereo(
        files.toml,
        file.stereo.name,
        problem,
        surface,
        "local" if local else "earth-fixed",
        _on_another_body(file),
        poses,
        None,
        None,
        tuple(files.used),
    )


def _is_local(file: StereoFile) -> bool:
    return file.world.frame == "local" and file.world.origin is None


def _on_another_body(file: StereoFile) -> bool:
    radii = file.surface.radii
    return radii is not None and abs(radii[0] / WGS84[0] - 1.0) > SPHERE


def camera_sections(
    given: StereoCamera | list[StereoCamera], names: tuple[str, ...], path: Path
) -> list[StereoCamera]:
    """The section of each camera, in the order of `names`; FormatError where one is missing or unknown."""
    if not isinstance(given, list):
        return [given] * len(names)
    by_name = {str(section.name): section for section in given}
    unknown = [name for name in by_name if name not in names]
    if unknown:
        raise FormatError(
            f"{path}: [[camera]] name = {unknown[0]!r} is no camera of the table of cameras; there are: "
            f"{listed(names)}"
        )
    missing = [name for name in names if name not in by_name]
    if missing:
        raise FormatError(
            f"{path}: no [[camera]] is called {missing[0]!r}; each camera of the table of cameras needs "
            "one, or "
            "one [camera] for all"
        )
    return [by_name[name] for name in names]


def stereo_detector(name: str, section: StereoCamera) -> AreaDetector:
    """The detector of a camera; the principal point is the centre of the frame unless given."""
    middle = (section.shape[0] - 1) / 2.0, (section.shape[1] - 1) / 2.0
    return AreaDetector(
        name,
        section.shape,
        section.focal_length_px,
        section.principal_point_px or middle,
        tuple(section.distortion),
    )


def _focal_sigma(cameras: list[StereoCamera]) -> tuple[float, ...] | None:
    """Relative sigma of each focal length; None where all are kept."""
    sigmas = tuple(
        np.inf if c.focal_length == "estimate" else c.focal_length_sigma_px / c.focal_length_px
        for c in cameras
    )
    return sigmas if any(sigmas) else None


def _images(poses: StereoPoseTable, path: Path, file: StereoFile) -> Images:
    """Planned poses in the axes of computation."""
    return Images(
        poses.camera,
        poses.shot,
        poses.t,
        points_to_world(poses.position, file.world, file.surface.radii, path),
        attitude_to_world(Rotation.from_quat(poses.quat_xyzw), file),
    )


def _points(file: StereoFile, files: InputFolder, poses: StereoPoseTable) -> tuple[PointTable | None, Path]:
    """The table of points and its path; None where images are to be matched."""
    sigma = file.noise.sigma_px
    if file.matches is not None:
        path = files(file.matches)
        return read_stereo_matches(path, poses, sigma), path
    if file.observations is not None:
        path = files(file.observations)
        return read_observations(path, poses, sigma), path
    return None, files.toml


def _aim(
    file: StereoFile, path: Path, names: tuple[str, ...], images: Images, mounts: tuple[Rotation, ...]
) -> Array | None:
    """The common aim point where attitudes were rebuilt from positions."""
    if file.noise.attitude_knowledge == "independent":
        return None
    if len(names) != 2:
        raise FormatError(
            f'{path}: noise.attitude_knowledge = "from-position" is for two cameras, the table of cameras '
            "has "
            f'{len(names)} ({listed(names)}); say "independent"'
        )
    given = file.noise.aim_point
    if given is None:
        aim = aim_of(path, images, mounts)
    else:
        aim = points_to_world(np.array([given]), file.world, file.surface.radii, path)[0]
    check_aim(path, names, images, mounts, aim)
    return aim


def _pictures(
    files: InputFolder, file: StereoFile, poses: StereoPoseTable, detectors: tuple[AreaDetector, ...]
) -> StereoImages:
    """Pictures of the table of images, opened; FormatError for a shape that is not the camera's."""
    path = files(str(file.images))
    table = read_image_list(path, poses)
    rows, sources = [], []
    for row, image, mask in zip(table.row, table.files, table.masks, strict=True):
        place = f"{files.toml}: images: {path.name}"
        shape = detectors[poses.camera[row]].shape
        if any(files.lacks(name, shape) for name in (image, mask) if name is not None):
            continue
        source = open_image(files(image, place), 1, None if mask is None else files(mask, place))
        if source.shape != shape:
            raise FormatError(
                f"{path}: {image} has {source.shape[0]} lines x {source.shape[1]} columns, [camera] shape = "
                f"{list(shape)}; they must agree; are lines and columns exchanged?"
            )
        check_content(source)
        rows.append(row)
        sources.append(source)
    return StereoImages(np.array(rows, dtype=np.intp), tuple(sources), file.noise.sigma_px or 0.0)
