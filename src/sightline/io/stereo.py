"""A STEREO.toml as a StereoProblem.

Not here: keys and allowed values (``stereo_schema.py``), its tables (``stereo_tables.py``), what is refused
of its geometry (``stereo_checks.py``), push-broom strips (``stereo_strips.py``), the results
(``stereo_results.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import StereoProblem
from sightline.errors import FormatError, GeometryError
from sightline.geometry.earth import WGS84
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Dem, Surface
from sightline.io.acquired import InputFolder, attitude_to_world, sha256
from sightline.io.config import read_toml, validate
from sightline.io.ground import inside_raster, surface_of
from sightline.io.images import Source, check_content, open_image
from sightline.io.platform import points_to_world
from sightline.io.stereo_checks import (
    Meeting,
    aim_of,
    boresights,
    check_aim,
    check_baseline,
    check_directions,
    check_enough,
    check_spread,
    meet,
    rays_of,
)
from sightline.io.stereo_schema import StereoCamera, StereoFile
from sightline.io.stereo_tables import (
    ControlTable,
    PointTable,
    PoseTable,
    check_inside,
    listed,
    read_control,
    read_image_list,
    read_matches,
    read_observations,
    read_poses,
)
from sightline.photogrammetry.point_priors import ControlPoints, HeightPrior
from sightline.photogrammetry.pose_noise import PoseNoise
from sightline.photogrammetry.sightings import Images, Tracks

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Share of the points that may lie beside the DEM before the whole is refused.
UNCOVERED_SHARE = 0.02
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
    """

    image: Index
    sources: tuple[Source, ...]


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
    """

    path: Path
    name: str
    problem: StereoProblem
    surface: Surface
    world: str
    another_body: bool
    poses: PoseTable
    pairs: int | None
    pictures: StereoImages | None
    inputs: tuple[Path, ...] = field(repr=False)

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


def read_stereo(path: Path) -> Stereo:
    """Everything a STEREO.toml of frames says; errors as of `load_stereo`."""
    file = read_stereo_file(path)
    if file.strip or file.cameras is None or file.camera is None:
        raise FormatError(f"{path}: has [[strip]]: read it with load_strip_stereo; frames are expected here")
    files = InputFolder(path)
    poses_path = files(file.cameras)
    poses = read_poses(poses_path)
    cameras = camera_sections(file.camera, poses.cameras, path)
    detectors = tuple(
        detector_of(name, section) for name, section in zip(poses.cameras, cameras, strict=True)
    )
    mounts = tuple(mount_of(section) for section in cameras)
    images = _images(poses, poses_path, file)
    check_baseline(poses_path, poses.cameras, images, file.noise.sigma_position)
    table, points_path = _points(file, files, poses)
    if table is not None:
        check_inside(points_path, table.image, images.camera, table.pixels, [d.shape for d in detectors])
    tracks, names, control = _block(file, files, poses, table, images, detectors)
    aim = _aim(file, path, poses.cameras, images, mounts)
    warnings: tuple[str, ...] = ()
    if table is not None:
        tracks, names, control, warnings = _without_single(tracks, names, control)
    heights, surface, more = _ground(
        file, files, points_path, images, detectors, mounts, tracks, poses.cameras
    )
    if table is not None:
        check_enough(
            points_path,
            len(poses.cameras),
            tracks,
            len(names),
            control=0 if control is None else len(control.point),
            heights=heights is not None,
        )
        check_spread(points_path, poses.cameras, images, tracks)
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
        warnings=warnings + more,
    )
    pictures = None if file.images is None else _pictures(files, file.images, poses, detectors)
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


def detector_of(name: str, section: StereoCamera) -> AreaDetector:
    """The detector of a camera; the principal point is the centre of the frame unless given."""
    middle = (section.shape[0] - 1) / 2.0, (section.shape[1] - 1) / 2.0
    return AreaDetector(
        name,
        section.shape,
        section.focal_length_px,
        section.principal_point_px or middle,
        tuple(section.distortion),
    )


def mount_of(section: StereoCamera) -> Rotation:
    """body_from_camera."""
    return NADIR_MOUNT if section.body_from_camera is None else Rotation.from_quat(section.body_from_camera)


def _focal_sigma(cameras: list[StereoCamera]) -> tuple[float, ...] | None:
    """Relative sigma of each focal length; None where all are kept."""
    sigmas = tuple(
        np.inf if c.focal_length == "estimate" else c.focal_length_sigma_px / c.focal_length_px
        for c in cameras
    )
    return sigmas if any(sigmas) else None


def _images(poses: PoseTable, path: Path, file: StereoFile) -> Images:
    """Planned poses in the axes of computation."""
    return Images(
        poses.camera,
        poses.shot,
        poses.t,
        points_to_world(poses.position, file.world, file.surface.radii, path),
        attitude_to_world(Rotation.from_quat(poses.quat_xyzw), file),
    )


def _points(file: StereoFile, files: InputFolder, poses: PoseTable) -> tuple[PointTable | None, Path]:
    """The table of points and its path; None where images are to be matched."""
    sigma = file.noise.sigma_px
    if file.matches is not None:
        path = files(file.matches)
        return read_matches(path, poses, sigma), path
    if file.observations is not None:
        path = files(file.observations)
        return read_observations(path, poses, sigma), path
    return None, files.toml


def _block(
    file: StereoFile,
    files: InputFolder,
    poses: PoseTable,
    table: PointTable | None,
    images: Images,
    detectors: tuple[AreaDetector, ...],
) -> tuple[Tracks, Array, ControlPoints | None]:
    """Sightings of all points, their numbers, and those of known coordinates."""
    if table is None:
        nothing: Array = np.empty(0)
        table = PointTable(np.empty(0, dtype=np.intp), nothing, np.empty((0, 2)), nothing)
    numbers, point = np.unique(table.point, return_inverse=True)
    image, pixels, sigma = table.image, table.pixels, table.sigma_px
    control = None
    if file.control_points is not None:
        path = files(file.control_points)
        read = read_control(path, poses, file.noise.sigma_px)
        places = points_to_world(read.position, file.world, file.surface.radii, path)
        if read.seen is None:
            which = _known(path, read, numbers)
        else:
            check_inside(path, read.seen.image, images.camera, read.seen.pixels, [d.shape for d in detectors])
            # control points seen in pixels of their own are points of their own, numbered below all others
            which = len(numbers) + np.arange(len(places))
            first = min(0.0, float(numbers.min(initial=0.0))) - len(places)
            numbers = np.concatenate([numbers, first + np.arange(len(places))])
            point = np.concatenate([point, which[read.seen.point.astype(np.intp)]])
            image = np.concatenate([image, read.seen.image])
            pixels = np.concatenate([pixels, read.seen.pixels])
            sigma = np.concatenate([sigma, read.seen.sigma_px])
        control = ControlPoints(which, places, read.sigma)
    return Tracks(image, point, pixels, sigma), numbers, control


def _known(path: Path, read: ControlTable, numbers: Array) -> Index:
    """Which of the points each control point is."""
    point = np.asarray(read.point)
    place = np.clip(np.searchsorted(numbers, point), 0, max(len(numbers) - 1, 0))
    lost = np.flatnonzero(numbers[place] != point) if len(numbers) else np.arange(len(point))
    if lost.size:
        raise FormatError(
            f"{path}: row {int(lost[0]) + 1} names point {point[lost[0]]:g}, which the table of points "
            "does not "
            "have; give where it was seen (camera,shot,line,column), or correct the number"
        )
    return np.asarray(place, dtype=np.intp)


def _without_single(
    tracks: Tracks, names: Array, control: ControlPoints | None
) -> tuple[Tracks, Array, ControlPoints | None, tuple[str, ...]]:
    """Points seen in one image only tell nothing, unless their coordinates are known."""
    seen = np.bincount(tracks.point, minlength=len(names))
    kept = seen >= 2
    if control is not None:
        kept[control.point] |= seen[control.point] > 0
    if kept.all():
        return tracks, names, control, ()
    number = np.cumsum(kept) - 1
    rows = kept[tracks.point]
    fewer = Tracks(tracks.image[rows], number[tracks.point[rows]], tracks.pixels[rows], tracks.sigma_px[rows])
    if control is not None:
        control = ControlPoints(number[control.point], control.position, control.sigma)
    lost = int((~kept).sum())
    what = "1 point" if lost == 1 else f"{lost} points"
    return fewer, names[kept], control, (f"{what} seen in one image only: left out, nothing follows from it",)


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


def _ground(
    file: StereoFile,
    files: InputFolder,
    points_path: Path,
    images: Images,
    detectors: tuple[AreaDetector, ...],
    mounts: tuple[Rotation, ...],
    tracks: Tracks,
    names: tuple[str, ...],
) -> tuple[HeightPrior | None, Surface, tuple[str, ...]]:
    """Height prior, ground, and what was noticed while looking where rays meet."""
    local, radii = _is_local(file), file.surface.radii
    origins, looks = images.position, boresights(images, mounts)
    warnings: tuple[str, ...] = ()
    meeting: Meeting | None = None
    if len(tracks):
        origins, looks = images.position[tracks.image], rays_of(images, detectors, mounts, tracks)
        _check_light(points_path, looks, tracks)
        meeting = meet(origins, looks, tracks.point, int(tracks.point.max()) + 1)
        warnings = check_directions(points_path, names, images, tracks, meeting)
    section = file.surface
    if file.dem is not None:
        section = section.model_copy(update={"dem": file.dem, "height_sigma": file.dem_sigma})
    surface = surface_of(
        section, files, lambda ground: ground.intersect(origins, looks), local=local, radii=radii
    )
    if section.height_sigma <= 0.0:
        return None, surface, warnings
    if isinstance(surface, Dem) and meeting is not None:
        _check_dem(files(str(section.dem)), surface, meeting.points)
    prior = HeightPrior(surface, section.height_sigma, None if local else (radii or WGS84))
    return prior, surface, warnings


def _check_light(path: Path, looks: Array, tracks: Tracks) -> None:
    dark = np.flatnonzero(~np.isfinite(looks).all(axis=1))
    if dark.size:
        raise FormatError(
            f"{path}: pixel {tracks.pixels[dark[0]].tolist()} (line, column) lies where the lens brings no "
            "light "
            f"({dark.size} such); check [camera] distortion and focal_length_px"
        )


def _check_dem(path: Path, dem: Dem, points: Array) -> None:
    """Refuse a raster beside which points lie."""
    found = points[np.isfinite(points).all(axis=1)]
    beside = 1.0 - float(np.mean(inside_raster(dem, found))) if len(found) else 1.0
    if beside > UNCOVERED_SHARE:
        raise GeometryError(
            f"{path}: the DEM does not cover the points: {100 * beside:.0f} % of them lie outside it; give a "
            "larger DEM, or check its coordinate system and the poses"
        )


def _pictures(
    files: InputFolder, name: str, poses: PoseTable, detectors: tuple[AreaDetector, ...]
) -> StereoImages:
    """Pictures of the table of images, opened; FormatError for a shape that is not the camera's."""
    path = files(name)
    table = read_image_list(path, poses)
    sources = []
    for row, image, mask in zip(table.row, table.files, table.masks, strict=True):
        source = open_image(files(image), 1, None if mask is None else files(mask))
        shape = detectors[poses.camera[row]].shape
        if source.shape != shape:
            raise FormatError(
                f"{path}: {image} has {source.shape[0]} lines x {source.shape[1]} columns, [camera] shape = "
                f"{list(shape)}; they must agree; are lines and columns exchanged?"
            )
        check_content(source)
        sources.append(source)
    return StereoImages(table.row, tuple(sources))
