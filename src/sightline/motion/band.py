"""One image of an acquisition with its nominal camera and what is not known about it.

Not here: reading them from files (``io/``), recovering their motion (``applications/``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.imaging.source import ImageSource

#: A detector line is as its directions say, bent smoothly, or made of CCDs that meet in steps.
SHAPES = ("line", "polynomial", "pieces")


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
    scale_sigma : float
        Relative; how well its magnification beside the first band's is known (0: exactly).
    match_sigma : (columns, 2) or None
        Relative sigma along lines and columns of matches at each column, as predicted from MTF and SNR.
    shape : str or None
        One of SHAPES: how the line departs from the directions given of it; None: as the images show.
    shape_sigma_px : float
        px; size of these departures: of each bend at the ends of the line, of each step (0: none).
    pieces : tuple of int
        First column of every further CCD of a line in ``"pieces"``.
    """

    name: str
    image: ImageSource
    camera: PushbroomCamera
    offset_sigma_px: float = 1.0
    rotation_sigma: float = 3e-4
    scale_sigma: float = 1e-3
    match_sigma: NDArray[np.float64] | None = None
    shape: str | None = None
    shape_sigma_px: float = 0.5
    pieces: tuple[int, ...] = ()


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
    exposure, strip : int
        Images of one exposure share time and attitude; images of one strip of the chip (one filter) share
        its place on the chip. Without strips every frame is an exposure of its own.
    """

    name: str
    image: ImageSource
    camera: FrameCamera
    time_sigma: float = 0.0
    exposure: int = 0
    strip: int = 0


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


@dataclass(frozen=True)
class ChipKnowledge:
    """How well the strips of one chip (filters in front of one detector) are known, 1-sigma; 0 = exactly.

    Attributes
    ----------
    names : tuple of str
        Of the strips.
    common_line_sigma_px : float
        px; of the line of the optical axis on the chip, common to all strips.
    line_sigma_px : tuple of float
        px; of each strip's own place along the lines.
    scale_sigma : tuple of float
        Of each strip's focal length relative to the common one (colours are magnified differently).
    height_sigma : tuple of float
        m; of the layer that each strip sees above the surface (colours see clouds of different depth).
    """

    names: tuple[str, ...]
    common_line_sigma_px: float = 0.0
    line_sigma_px: tuple[float, ...] = ()
    scale_sigma: tuple[float, ...] = ()
    height_sigma: tuple[float, ...] = ()
