"""Cameras of a rig: how each sits in the body, what is known of that, and what an adjustment made of it.

The body is that of the first camera. Another camera is turned against it by `orientation` and its lens lies
at `position` in it. One pose per capture gives those of all its images.

Not here: how offsets are found in images (``rig_matches.py``), the adjustment (``rig_poses.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, as_vector, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ImageSource
from sightline.photogrammetry.sightings import Images, as_index

#: Offsets of a camera, in the order of all tables: rad and m about and along body axes, then the relative
#: change of its focal length.
OFFSETS = ("roll", "pitch", "yaw", "x", "y", "z", "stretch")
#: Share of its prior sigma below which an offset counts as observed by the images.
OBSERVED = 0.7


@dataclass(frozen=True, eq=False, repr=False)
class RigCamera:
    """One camera of a rig, as it is given.

    Attributes
    ----------
    name : str
    detector : AreaDetector
    mount : Rotation
        body_from_camera as if there were no offset.
    sources : tuple of ImageSource
        One per capture.
    excluded : tuple of str
        Why the image of a capture cannot be used, "" where it can.
    wavelength_nm : float
        Of its band; NaN: all light.
    orientation : Rotation
        first_body_from_body: how it is turned against the first camera.
    orientation_sigma : float
        rad, 1-sigma per axis; 0: known exactly.
    position : (3,)
        m, of its lens from that of the first camera, body axes.
    position_sigma : (3,)
        m, 1-sigma per axis; 0: known exactly.
    focal_sigma : float
        1-sigma of the relative error of its focal length; 0: known exactly.
    prior : str
        Where its orientation is from, in words.
    channel_nm : tuple of float
        Of each channel of a colour camera; empty where its image has one.
    channels : tuple of tuple of ImageSource
        Those channels, one source per capture each.
    """

    name: str
    detector: AreaDetector
    mount: Rotation
    sources: tuple[ImageSource, ...]
    excluded: tuple[str, ...]
    wavelength_nm: float = np.nan
    orientation: Rotation = field(default_factory=Rotation.identity)
    orientation_sigma: float = 0.0
    position: Array = field(default_factory=lambda: frozen(np.zeros(3)))
    position_sigma: Array = field(default_factory=lambda: frozen(np.zeros(3)))
    focal_sigma: float = 0.0
    prior: str = "given"
    channel_nm: tuple[float, ...] = ()
    channels: tuple[tuple[ImageSource, ...], ...] = ()

    def __post_init__(self) -> None:
        """Check."""
        for name in ("position", "position_sigma"):
            object.__setattr__(self, name, frozen(as_vector(getattr(self, name), name, 3)))
        if len(self.sources) != len(self.excluded):
            raise InputError(
                f"camera {self.name}: as many `sources` as `excluded` are needed, got {len(self.sources)} "
                f"and {len(self.excluded)}"
            )
        if min(self.orientation_sigma, self.focal_sigma, float(self.position_sigma.min())) < 0.0:
            raise InputError(f"camera {self.name}: sigmas must be 0 or more")

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Captures (M,) whose image can be used."""
        return np.array([not reason for reason in self.excluded], dtype=np.bool_)

    @property
    def prior_sigma(self) -> Array:
        """(7,) 1-sigma of each of `OFFSETS` beforehand."""
        return np.concatenate([np.full(3, self.orientation_sigma), self.position_sigma, [self.focal_sigma]])


@dataclass(frozen=True, eq=False)
class RigOffsets(ReadOnlyArrays):
    """Offsets of all C cameras of a rig; those of the first are zero.

    Attributes
    ----------
    names : tuple of str
    orientation : Rotation
        C, first_body_from_body.
    position : (C, 3)
        m, body axes.
    stretch : (C,)
        Relative change of each focal length.
    covariance : (C, 7, 7)
        Of `OFFSETS`: rad about the camera's body axes, m along those of the first, relative.
    prior_sigma : (C, 7)
        Of each beforehand; 0 was kept.
    sightings : (C,) int
        Good ones of each camera.
    residual_px : (C,)
        px rms per axis.
    """

    names: tuple[str, ...]
    orientation: Rotation
    position: Array
    stretch: Array
    covariance: Array
    prior_sigma: Array
    sightings: NDArray[np.intp]
    residual_px: Array

    def __len__(self) -> int:
        """Number of cameras."""
        return len(self.names)

    @property
    def sigma(self) -> Array:
        """(C, 7) 1-sigma of `OFFSETS`."""
        return np.sqrt(np.einsum("cii->ci", self.covariance))

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(C, 7): the images know it better than was known beforehand; the rest is held at what was given."""
        return np.asarray((self.prior_sigma > 0.0) & (self.sigma < OBSERVED * self.prior_sigma))

    def detector(self, camera: int, given: AreaDetector) -> AreaDetector:
        """The detector of a camera with the focal length found."""
        return stretched(given, float(self.stretch[camera]))

    def images(self, captures: Images) -> Images:
        """Poses (C M) of the images of all captures (M), camera by camera."""
        return rig_images(captures, self.orientation, self.position)


def stretched(detector: AreaDetector, stretch: float) -> AreaDetector:
    """The detector with another focal length."""
    if stretch == 0.0:
        return detector
    return AreaDetector(
        detector.name, detector.shape, detector.focal_length_px * (1.0 + stretch),
        detector.principal_point_px, detector.distortion, detector.wavelength_nm,
    )  # fmt: skip


def given_offsets(cameras: Sequence[RigCamera]) -> RigOffsets:
    """Offsets as they are given."""
    count = len(cameras)
    prior = np.array([c.prior_sigma for c in cameras])
    return RigOffsets(
        tuple(c.name for c in cameras),
        Rotation.concatenate([c.orientation for c in cameras]),
        np.array([c.position for c in cameras]),
        np.zeros(count),
        np.einsum("ci,ij->cij", prior**2, np.eye(len(OFFSETS))),
        prior,
        np.zeros(count, dtype=np.intp),
        np.full(count, np.nan),
    )


def rig_images(captures: Images, orientation: Rotation, position: Array) -> Images:
    """Images (C M) of a rig, camera by camera, from the poses of its captures (M)."""
    count, cameras = len(captures), len(position)
    body = captures.world_from_body
    return Images(
        as_index(np.repeat(np.arange(cameras), count), "camera"),
        as_index(np.tile(captures.shot, cameras), "shot"),
        np.tile(captures.t, cameras),
        np.concatenate([captures.position + body.apply(lever) for lever in np.array(position)]),
        Rotation.concatenate([body * turn for turn in orientation]),
    )
