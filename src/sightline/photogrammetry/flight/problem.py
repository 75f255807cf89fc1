"""System S4: the pose of every frame of a multispectral sequence, from a subset and the frames between.

Not here: reading a SEQUENCE.toml (``io/sequence/load.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, read_only
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.rig import RigCamera
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.result import one_line


@dataclass(frozen=True, eq=False, repr=False)
class SequenceProblem(ReadOnlyArrays):
    """What a SEQUENCE.toml says, as objects.

    Attributes
    ----------
    frames : tuple of str
        Name of each frame, M in the order of their times, those that cannot be used too.
    t : (M,)
        s from the epoch, increasing; of line 0 where there is a rolling shutter.
    sources : tuple of ImageSource
        One per frame, opened when first read; of plain colour the mean of the channels.
    detector : AreaDetector
        Of all frames; `wavelength_nm` where each line has its own.
    mount : Rotation
        body_from_camera.
    images : Images
        Rough poses, camera 0, shot counting the frames; interpolated where tables have none.
    known : RoughPoses
        How rough they are: inf where a pose was interpolated or guessed.
    surface : Surface
        What the lines of sight meet, as well as it is known.
    height_sigma : float
        m; what is not known about it, 0: nothing was said.
    readout_time : float
        s from the exposure of line 0 to that of the last line; 0: all at once.
    readout_sigma : float
        s, 1-sigma of `readout_time`, which is then found with the poses; 0: it is kept.
    overlap : float
        Wanted along the flight between frames of the subset, share of the frame.
    excluded : tuple of str
        Why a frame's image cannot be used, M; "" where it can.
    mosaic_nm : (rows, columns) or None
        Pattern that repeats from pixel (0, 0): pixel (line, column) sees ``[line % rows, column % columns]``.
    channel_nm : tuple of float
        Of each channel of plain colour; empty where the image has one.
    channels : tuple of tuple of ImageSource
        Per frame, its channels in that order; empty where the image has one.
    focal_length_sigma_px : float
        px, 1-sigma of the focal length of `detector`, which is then found with the poses; inf: nothing is
        known of it, 0: it is kept.
    control : ControlPoints or None
        Known points; `point` counts them.
    control_tracks : Tracks or None
        Where they were seen: `image` is a frame, `point` one of `control`.
    radii : (float, float) or None
        Of the ellipsoid whose normals are the verticals; None where the world is flat, z up.
    epoch : str or None
        UTC, ISO 8601: the instant t = 0.
    start : Images or None
        Poses nearer to the truth than `images`, of a model: where the adjustment starts; else from `images`.
    rig : tuple of RigCamera
        All cameras of a rig, whose first is the camera above: a frame is a capture then; empty where there is
        one camera.
    warnings : tuple of str
        What was noticed while reading.
    """

    frames: tuple[str, ...]
    t: Array
    sources: tuple[ImageSource, ...]
    detector: AreaDetector
    mount: Rotation
    images: Images
    known: RoughPoses
    surface: Surface
    height_sigma: float
    readout_time: float
    overlap: float
    excluded: tuple[str, ...]
    mosaic_nm: Array | None = None
    channel_nm: tuple[float, ...] = ()
    channels: tuple[tuple[ImageSource, ...], ...] = ()
    focal_length_sigma_px: float = 0.0
    readout_sigma: float = 0.0
    control: ControlPoints | None = None
    control_tracks: Tracks | None = None
    radii: tuple[float, float] | None = None
    epoch: str | None = None
    start: Images | None = None
    rig: tuple[RigCamera, ...] = ()
    warnings: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Check that every frame has all its parts."""
        sizes = [
            len(self.frames),
            len(self.t),
            len(self.sources),
            len(self.images),
            len(self.known.position),
            len(self.excluded),
        ]
        if len(set(sizes)) != 1 or (self.channels and len(self.channels) != sizes[0]):
            raise InputError(
                f"frames, t, sources, images, known and excluded need as many entries each, got {sizes}"
            )
        if any(len(camera.sources) != sizes[0] for camera in self.rig):
            raise InputError(f"each camera of `rig` needs {sizes[0]} sources, one for each frame")

    def __repr__(self) -> str:
        """One line."""
        lines, columns = self.detector.shape
        facts = {
            "frames": f"{len(self)} of {lines} x {columns} px, {int(self.usable.sum())} usable",
            "times": f"{self.t[0]:g} to {self.t[-1]:g} s",
            "positions": "given" if np.isfinite(self.known.position).any() else "not given",
            "attitudes": "given" if np.isfinite(self.known.attitude).any() else "not given",
            "surface": type(self.surface).__name__,
        }
        return one_line("SequenceProblem", facts)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def known_poses(self) -> RoughPoses:
        """What is known beforehand of the poses, and of the focal length."""
        relative = self.focal_length_sigma_px / self.detector.focal_length_px
        return replace(self.known, focal_length=relative)

    @property
    def filter_period(self) -> int:
        """px; side of the squares whose means all see the same wavelengths: 1 without a mosaic filter."""
        return 1 if self.mosaic_nm is None else int(np.lcm(*self.mosaic_nm.shape))

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Which frames (M,) have an image that can be used."""
        return np.array([not reason for reason in self.excluded], dtype=np.bool_)


def seen_ground(problem: SequenceProblem) -> Array:
    """m (M, 3): the ground in the middle of each frame, by the rough poses; NaN where it shows none."""
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    axis = problem.images.world_from_body.apply(problem.mount.apply(problem.detector.directions(middle))[0])
    return np.asarray(problem.surface.intersect(read_only(problem.images.position), read_only(axis)))
