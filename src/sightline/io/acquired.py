"""What an ACQUISITION.toml becomes: bands or frames with cameras, sensors, control points, hashes.

Not here: reading the file (``acquisition.py``).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.earth import local_axes
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.io.acquisition_schema import AcquisitionFile, WorldSection
from sightline.io.inputs import note
from sightline.motion.band import Band, ChipKnowledge, Frame, LensKnowledge
from sightline.motion.hyper import KnownContent
from sightline.motion.sensors import AttitudeSensor, ControlPoints
from sightline.motion.spin_frames import AttitudeSigma


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Everything an ACQUISITION.toml says, ready for ``recover_line_of_sight``.

    Attributes
    ----------
    path : Path
        The file.
    name, epoch : str
        Title; UTC instant of t = 0 or None.
    bands, frames : tuple
        One of the two is empty.
    surface : Surface
        What the lines of sight meet.
    height_sigma : float
        m; what is not known about it.
    sensors : tuple of AttitudeSensor
    control_points : ControlPoints or None
    known_motion : KnownContent
    lens : LensKnowledge
    matching : dict
        What ``[matching]`` gives, by the names of ``RecoverOptions``; empty where the default is wanted.
    platform : str
        Kind of ``[platform]``.
    world : str
        ``"local"`` (x east, y north, z up) or ``"earth-fixed"``.
    spin : Spin or None
        How the body turns, where it spins, and how well that is known.
    chip : ChipKnowledge
        How well the strips of a frame are known.
    attitude_sigma : AttitudeSigma or None
        How well the attitude of a spinning body at t = 0 is known.
    parallax_sigma : float
        rad/s; how fast directions may drift because the platform moves (ground at infinity).
    inputs : tuple of Path
        Every file that was read or will be.
    """

    path: Path
    name: str
    epoch: str | None
    bands: tuple[Band, ...]
    frames: tuple[Frame, ...]
    surface: Surface
    height_sigma: float
    sensors: tuple[AttitudeSensor, ...]
    control_points: ControlPoints | None
    known_motion: KnownContent
    lens: LensKnowledge
    matching: dict[str, Any]
    platform: str
    world: str
    spin: Spin | None
    chip: ChipKnowledge
    attitude_sigma: AttitudeSigma | None
    parallax_sigma: float
    inputs: tuple[Path, ...] = field(repr=False)

    @property
    def images(self) -> tuple[ImageSource, ...]:
        """Image sources of all bands or frames, in order."""
        return (*(band.image for band in self.bands), *(frame.image for frame in self.frames))

    @property
    def cameras(self) -> tuple[PushbroomCamera | FrameCamera, ...]:
        """Nominal cameras of all bands or frames, in order."""
        return (*(band.camera for band in self.bands), *(frame.camera for frame in self.frames))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bands or frames, in order."""
        return (*(band.name for band in self.bands), *(frame.name for frame in self.frames))

    @property
    def ifov(self) -> float:
        """rad (a tangent); mean step between neighbouring pixels of the first image."""
        return field_of_view(self.cameras[0])[0]

    @property
    def half_field_px(self) -> float:
        """px; from the middle of the field to its edge."""
        return field_of_view(self.cameras[0])[1]

    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of every input file, by its path relative to the TOML file (for ``summary.json``)."""
        return {_relative(path, self.path.parent): sha256(path) for path in self.inputs}


def field_of_view(camera: PushbroomCamera | FrameCamera) -> tuple[float, float]:
    """IFOV (a tangent) and half field (px) of a camera."""
    if isinstance(camera, FrameCamera):
        return 1.0 / camera.detector.focal_length_px, (camera.detector.shape[1] - 1) / 2.0
    directions = camera.detector.directions
    tangents = directions[:, :2] / directions[:, 2:]
    length = float(np.linalg.norm(tangents[-1] - tangents[0]))
    return length / (len(tangents) - 1), (len(tangents) - 1) / 2.0


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _relative(path: Path, folder: Path) -> str:
    """The path as the TOML file would name it, or in full when it lies elsewhere."""
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return str(path)


class HasWorld(Protocol):
    """A file with a table ``[world]``."""

    @property
    def world(self) -> WorldSection:
        """Axes of its positions and attitudes."""
        ...


class InputFolder:
    """Paths relative to the TOML file, remembered as they are used."""

    def __init__(self, toml: Path) -> None:
        """Start with the TOML file itself."""
        self.toml = toml
        self.used: list[Path] = [toml]
        note(toml)

    def __call__(self, name: str) -> Path:
        """The path behind a name in the file; it is listed among the inputs."""
        path = self.toml.parent / name
        if path not in self.used:
            self.used.append(path)
            note(path)
        return path


def world_kind(config: AcquisitionFile) -> str:
    """``"local"`` for level flight and for local axes without an origin, else ``"earth-fixed"``."""
    local = config.world.frame == "local" and config.world.origin is None
    return "local" if config.platform.kind == "level-flight" or local else "earth-fixed"


def attitude_to_world(attitude: Rotation, config: HasWorld) -> Rotation:
    """Attitudes in the axes of ``[world]`` → the axes of computation.

    Quaternions are Earth-fixed unless the frame is "local"; with "lonlat" only positions are geodetic.
    """
    if config.world.frame == "local" and config.world.origin is not None:
        lon, lat = np.radians(config.world.origin[:2])
        return local_axes(lon, lat) * attitude
    return attitude
