"""What an ACQUISITION.toml becomes: bands or frames with cameras, sensors, control points, hashes.

Not here: reading the file (``load.py``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import (
    allow_folders,
    check_file,
    current_access,
    inner_image,
    located,
    refuse_network,
    remote_name,
)
from sightline.errors import FormatError, SightlineError, foreign_errors
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.earth import local_axes
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.io.acquisition.schema import AcquisitionFile, InputFile, WorldSection
from sightline.io.formats.line_scan import OneGrid
from sightline.motion.band import Band, ChipKnowledge, Frame, LensKnowledge
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.spin.solve import AttitudeSigma
from sightline.motion.strip.hyper import KnownContent
from sightline.result import one_line


@dataclass(frozen=True, eq=False, repr=False)
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
    control_points : ControlSightings or None
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
    doubts : tuple of str
        What was given and is hardly meant.
    assumed : tuple of str
        What of the ground is not given, with what is taken for it.
    sources : tuple of str
        What orbit and attitudes are: axes, time scale, Earth orientation.
    reference_et : float or None
        s past J2000 (TDB), the instant t = 0, where a sensor model says it.
    body : ((K,), Rotation) or None
        Instants (s), and body-fixed from J2000 at each, where a sensor model says it.
    absent : tuple of str
        Images that are not there, where only the geometry is asked for.
    still : str
        Why its images hold no motion, and what would do; empty where they may.
    """

    path: Path
    name: str
    epoch: str | None
    bands: tuple[Band, ...]
    frames: tuple[Frame, ...]
    surface: Surface
    height_sigma: float
    sensors: tuple[AttitudeSensor, ...]
    control_points: ControlSightings | None
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
    doubts: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    reference_et: float | None = None
    body: tuple[NDArray[np.float64], Rotation] | None = None
    absent: tuple[str, ...] = ()
    still: str = ""

    def __repr__(self) -> str:
        """One line."""
        shapes = sorted({image.shape for image in self.images})
        facts = {
            "": repr(self.name),
            "bands" if self.bands else "frames": f"{len(self.names)} ({', '.join(self.names[:4])})",
            "px": " / ".join(f"{lines} x {columns}" for lines, columns in shapes[:3]),
            "platform": self.platform,
            "surface": type(self.surface).__name__,
            "sensors": str(len(self.sensors)),
            "file": str(self.path),
        }
        return one_line("Acquisition", facts)

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
    """Hexadecimal SHA-256 of a file, read in pieces; of what is read from servers, that it was."""
    inside = inner_image(path)
    if inside is None and remote_name(path) is not None:
        return "read from a server"
    with (path if inside is None else inside.file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _relative(path: Path, folder: Path) -> str:
    """The path as the TOML file would name it, or in full when it lies elsewhere."""
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return str(path)


#: Keys that name one file, as many as a message repeats.
_KEYS_NAMED = 3


class HasWorld(Protocol):
    """A file with a table ``[world]``."""

    @property
    def world(self) -> WorldSection:
        """Axes of its positions and attitudes."""
        ...


class InputFolder:
    """Paths relative to the TOML file, remembered as they are used, with the keys that name them.

    And what was understood of them on the way: `said`, `doubts`, what they add to the sigma of the reference
    attitude (`attitude_sigmas`, rad), and the Earth-fixed axes against those that attitudes are given in at a
    time (`fixed_from_given`, None: the same).

    Parameters
    ----------
    toml : Path
    config : InputFile, optional
        Its content, for the names of keys.
    """

    def __init__(self, toml: Path, config: InputFile | None = None) -> None:
        """Start with the TOML file itself."""
        self.toml = toml
        self.used: list[Path] = [toml]
        self.said: list[str] = []
        self.doubts: list[str] = []
        self.attitude_sigmas: list[float] = []
        self.fixed_from_given: Callable[[float], Rotation] | None = None
        #: Whether images that are not there are described all the same; and those that are not.
        self.describing = False
        self.absent: list[str] = []
        #: Lines and columns that are taken for them, by band, in place of those of others or of models.
        self.sizes: Mapping[str, tuple[int, int]] = {}
        #: Of each band with a sensor model: what its attitudes do not hold, and the grid that it shares.
        self.bends: list[tuple[str, ...]] = []
        self.grids: list[OneGrid | None] = []
        #: s past J2000 (TDB) of t = 0, and how the body turns, where a sensor model says it.
        self.radii: tuple[float, float] | None = None
        self.reference_et: float | None = None
        self.body: tuple[NDArray[np.float64], Rotation] | None = None
        self._keys_of: dict[str, list[str]] = {}
        self._place_of: dict[Path, str] = {}
        if config is not None:
            for where, name in _words(config.model_dump(exclude_unset=True), ()):
                self._keys_of.setdefault(name, []).append(_key(where))

    def path(self, name: str) -> Path:
        """The path behind a name in the file."""
        return located(self.toml.parent, name)

    def __call__(self, name: str, place: str = "", advice: str = "check the name") -> Path:
        """The path behind a name in the file, or in a table (`place`); it is listed among the inputs.

        Raises
        ------
        FormatError
            If there is no such file, or it would be asked of a server unasked; names the key.
        """
        path = self.path(name)
        place = place or f"{self.toml}: {' and '.join(self._keys_of.get(name, [name])[:_KEYS_NAMED])}"
        self._place_of[path] = place
        if path not in self.used:
            self.used.append(path)
        inside = inner_image(path)
        if inside is not None:
            check_file(inside.file, advice, place)
        elif remote_name(path) is None:
            check_file(path, advice, place)
        elif not current_access().network:
            raise refuse_network(place, f"{name} is an address")
        return path

    def lacks_file(self, name: str) -> bool:
        """Whether a name is of a file of this machine that is not there."""
        path = self.path(name)
        inside = inner_image(path)
        if inside is None and remote_name(path) is not None:
            return False
        return not os.path.lexists(path if inside is None else inside.file)

    def lacks(self, name: str, shape: tuple[int, int]) -> bool:
        """Whether an image that is only to be described, of that shape, is not there; it is noted."""
        if not self.describing or not self.lacks_file(name):
            return False
        path = self.path(name)
        keys = " and ".join(self._keys_of.get(name, [name])[:_KEYS_NAMED])
        size = f"{shape[0]} lines x {shape[1]} columns"
        said = f"{keys}: {path}: no such file; its geometry is described as that of {size}"
        if said not in self.absent:
            self.absent.append(said)
        return True

    def allowed(self, config: InputFile) -> list[Path]:
        """Folders to which the files that are named may refer."""
        folders = [self.toml.parent / name for name in config.files.allow]
        for folder in folders:
            if not folder.is_dir():
                raise FormatError(
                    f"{self.toml}: [files] allow: {folder}: no such folder; correct or remove it"
                )
        return [self.toml.parent, *folders]

    def placed(self, error: SightlineError) -> SightlineError:
        """The same error with file and key in front where it does not name them."""
        text = str(error)
        for path, place in self._place_of.items():
            if text.startswith(f"{path}: "):
                return type(error)(f"{place}: {text}")
        if any(str(path) in text for path in self.used):
            return error
        return type(error)(f"{self.toml}: {text}")


@contextmanager
def input_files(toml: Path, config: InputFile) -> Iterator[InputFolder]:
    """The files that a TOML file names; whatever goes wrong with them in the block names file and key.

    Parameters
    ----------
    toml : Path
    config : InputFile
        Its content; files may refer to what lies beside it and in the folders of ``[files] allow``.
    """
    files = InputFolder(toml, config)
    failed = "what it says, and the files that it names, cannot be computed with"
    advice = "look for values that are extreme or do not belong together; --debug shows where it failed"
    with allow_folders(files.allowed(config)), foreign_errors(toml, failed, advice):
        try:
            yield files
        except SightlineError as error:
            placed = files.placed(error)
            if placed is error:
                raise
            raise placed from error


def _words(value: Any, where: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Places and texts of all words in tables and lists."""
    if isinstance(value, str):
        yield where, value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _words(inner, (*where, str(key)))
    elif isinstance(value, list | tuple):
        for number, inner in enumerate(value, 1):
            yield from _words(inner, (*where, number))


def _key(where: tuple[str | int, ...]) -> str:
    """``("band", 2, "image")`` as ``[[band]] 2 image``."""
    if len(where) == 1:
        return str(where[0])
    table = f"[[{where[0]}]] {where[1]}" if isinstance(where[1], int) else f"[{where[0]}]"
    rest = where[2:] if isinstance(where[1], int) else where[1:]
    return " ".join([table, ".".join(map(str, rest))])


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
