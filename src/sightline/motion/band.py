"""One image of an acquisition with its nominal camera and what is not known about it.

Not here: reading them from files (``io/``), recovering their motion (``applications/``).
"""

from __future__ import annotations

from dataclasses import dataclass

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.imaging.source import ImageSource


@dataclass(frozen=True, eq=False)
class Band:
    """One detector line's image with its nominal camera and what is not known about the line.

    Attributes
    ----------
    name : str
    image : ImageSource
    camera : PushbroomCamera
        Nominal: reference attitude, nominal focal plane.
    offset_sigma_px : float
        px; how well the line's place in the focal plane is known, along and across (0: exactly).
    rotation_sigma : float
        rad; how well its rotation is known (0: exactly).
    """

    name: str
    image: ImageSource
    camera: PushbroomCamera
    offset_sigma_px: float = 1.0
    rotation_sigma: float = 3e-4


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of an area detector with its nominal camera.

    Attributes
    ----------
    name : str
    image : ImageSource
    camera : FrameCamera
        Nominal, at the stamped time.
    time_sigma : float
        s; how well the time is known (0: exactly).
    """

    name: str
    image: ImageSource
    camera: FrameCamera
    time_sigma: float = 0.0


@dataclass(frozen=True)
class LensKnowledge:
    """How well the lens of an area detector is known (1-sigma); 0 = exactly.

    Attributes
    ----------
    focal_length_sigma_px : float
    principal_point_sigma_px : float
        Each of line and column.
    distortion_sigma : float
        Of k1, in normalised coordinates.
    """

    focal_length_sigma_px: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion_sigma: float = 0.0
