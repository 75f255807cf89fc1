"""``[[strip]]`` of a STEREO.toml: push-broom images in place of the frames of a camera.

Not here: frames (``load.py``), the cameras of an acquisition (``io/acquisition/load.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.apparent import BentMount
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import WGS84
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.io.acquisition.acquired import Acquisition, InputFolder, field_of_view
from sightline.io.acquisition.load import load_acquisition
from sightline.io.stereo.checks import check_in_front, check_spread
from sightline.io.stereo.points import block_of, check_points, ground_of, without_single
from sightline.io.stereo.schema import StereoFile, StereoStrip
from sightline.io.stereo.tables import StereoPoseTable, listed, read_observations
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, sight_pushbroom

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class StripProblem(StereoProblem):
    """A problem whose images are strips: each stands for one image, posed as in its middle.

    Attributes
    ----------
    strips : tuple of PushbroomCamera
        One per camera.
    """

    strips: tuple[PushbroomCamera, ...] = ()

    def sightings(self) -> Sightings:
        """The points as sighted, each from the pose of its own line."""
        return sight_pushbroom(self.strips, self.tracks)


def strip_cameras(file: StereoFile, files: InputFolder) -> tuple[list[PushbroomCamera], list[Acquisition]]:
    """The camera of each ``[[strip]]``, and the acquisition it is from."""
    read: dict[str, Acquisition] = {}
    cameras, acquisitions = [], []
    for strip in file.strip:
        path = files(strip.acquisition)
        acquisition = read.setdefault(strip.acquisition, load_acquisition(path, look=False))
        cameras.append(_camera_of(strip, acquisition, files.toml))
        acquisitions.append(acquisition)
    worlds = {acquisition.world for acquisition in acquisitions}
    if len(worlds) > 1:
        raise FormatError(
            f"{files.toml}: strips are in different axes ({' and '.join(sorted(worlds))}); points of one "
            "ground need one kind: give all acquisitions in Earth-fixed axes, or all in local ones"
        )
    return cameras, acquisitions


def _camera_of(strip: StereoStrip, acquisition: Acquisition, path: Path) -> PushbroomCamera:
    """The nominal camera of a band; FormatError for an unknown band or one that is not a strip."""
    names = acquisition.names
    band = strip.band if strip.band is not None else names[0]
    if band not in names:
        raise FormatError(
            f"{path}: strip {strip.name}: {acquisition.path} has no band {band!r}; it has: {listed(names)}"
        )
    camera = acquisition.cameras[names.index(band)]
    if not isinstance(camera, PushbroomCamera) or not isinstance(camera.pointing, FixedMount | BentMount):
        raise FormatError(
            f"{path}: strip {strip.name}: {acquisition.path} has no push-broom camera that sits still in its "
            "body; give frames by cameras = FILE in place of [[strip]]"
        )
    return camera


def strip_problem(
    file: StereoFile, files: InputFolder
) -> tuple[StripProblem, StereoPoseTable, Surface, bool]:
    """The problem of a file with ``[[strip]]``, its poses, the ground, and whether the world is flat."""
    cameras, acquisitions = strip_cameras(file, files)
    names = tuple(strip.name for strip in file.strip)
    images = _middle_poses(cameras)
    poses = StereoPoseTable(
        names,
        images.camera,
        images.shot,
        np.zeros(1),
        images.t,
        images.position,
        images.world_from_body.as_quat(),
    )
    path = files(str(file.observations))
    table = read_observations(path, poses, file.noise.sigma_px, strips=True)
    local = acquisitions[0].world == "local"
    shapes = [camera.shape for camera in cameras]
    tracks, points, control = block_of(file, files, poses, table, images.camera, shapes, local=local)
    tracks, points, control, warnings = without_single(tracks, points, control)
    origins, looks = _rays(cameras, tracks)
    if control is not None:
        check_in_front(f"{files.toml}: {file.control_points}", control, points, tracks, origins, looks)
    heights, surface, more = ground_of(
        file, files, path, names, tracks.image, tracks, origins, looks, local=local
    )
    check_points(path, len(names), tracks, points, control, heights)
    check_spread(path, tracks.image, tracks)
    problem = StripProblem(
        cameras=names,
        images=images,
        shot_names=np.zeros(1),
        detectors=tuple(_frame_of(name, camera) for name, camera in zip(names, cameras, strict=True)),
        mounts=tuple(
            c.pointing.body_from_camera for c in cameras if isinstance(c.pointing, FixedMount | BentMount)
        ),
        tracks=tracks,
        point_names=points,
        noise=PoseNoise(file.noise.sigma_position, file.noise.sigma_attitude),
        radii=None if local else (file.surface.radii or WGS84),
        heights=heights,
        control=control,
        epoch=file.stereo.epoch or acquisitions[0].epoch,
        warnings=warnings + more,
        sigma_px=file.noise.sigma_px,
        strips=tuple(cameras),
    )
    return problem, poses, surface, local


def _middle_poses(cameras: list[PushbroomCamera]) -> Images:
    """One image per strip, posed as at its middle line, all of one shot."""
    t = np.array([float(c.times(np.array([(c.lines - 1) / 2.0]))[0]) for c in cameras])
    poses = [camera.trajectory.at(np.array([instant])) for camera, instant in zip(cameras, t, strict=True)]
    number = np.arange(len(cameras))
    return Images(
        number,
        np.zeros(len(cameras), dtype=np.intp),
        t,
        np.concatenate([pose.position for pose in poses]),
        Rotation.concatenate([pose.world_from_body for pose in poses]),
    )


def _frame_of(name: str, camera: PushbroomCamera) -> AreaDetector:
    """The shape of a strip as a frame's: figures are drawn in it, nothing is computed with it."""
    ifov, _ = field_of_view(camera)
    lines, columns = camera.shape
    return AreaDetector(name, (lines, columns), 1.0 / ifov, ((lines - 1) / 2.0, (columns - 1) / 2.0))


def _rays(cameras: list[PushbroomCamera], tracks: Tracks) -> tuple[Array, Array]:
    """Origins and unit directions (N, 3) of all sightings."""
    origins, looks = np.empty((len(tracks), 3)), np.empty((len(tracks), 3))
    for number, camera in enumerate(cameras):
        rows = np.flatnonzero(tracks.image == number)
        rays = camera.rays(tracks.pixels[rows])
        origins[rows], looks[rows] = rays.origins, rays.directions
    return origins, looks
