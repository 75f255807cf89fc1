"""Image velocity and slip angle per column: how the scene moves over a line detector while a line is exposed.

The bridge from camera motion (S1) to the choice of TDI stages (S3): V(i) and g(i) of S3 from any camera.

Not here: what they do to MTF and SNR (``imaging/``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.checks import Array, as_pixels
from sightline.geometry.surface import Surface

#: Half of the interval (lines) over which the movement of the scene is taken.
_HALF_STEP = 0.5


@dataclass(frozen=True, eq=False)
class ScanVelocity:
    """Movement of the scene over the detector.

    Attributes
    ----------
    velocity : (N,)
        px per line period, the speed along its path; 1 = synchronised. S3's V(i), along the column, is this
        times cos(slip) (``tdi/scan_columns.py``).
    slip : (N,)
        rad; angle of the movement from that direction, positive towards increasing columns (S3's g(i)).
    """

    velocity: Array
    slip: Array


def scan_velocity(camera: PushbroomCamera, pixels: ArrayLike, surface: Surface) -> ScanVelocity:
    """How the ground seen by pixels moves over the detector while they are exposed.

    Parameters
    ----------
    camera : PushbroomCamera
        With the motion to be accounted for in its trajectory.
    pixels : (N, 2)
        (line, column), at least half a line inside the lines known to the camera.
    surface : Surface
        What the rays meet.

    Returns
    -------
    ScanVelocity
        NaN where the ray misses the surface.

    Notes
    -----
    The fixed ground point is followed in the focal plane from half a line before to half a line after its
    exposure, as it moves towards the last line of the scene already seen (decreasing camera y when nominal).
    """
    given = as_pixels(pixels)
    points = camera.locate(given, surface)
    before = camera.camera_tangents(points, given[:, 0] - _HALF_STEP)
    after = camera.camera_tangents(points, given[:, 0] + _HALF_STEP)
    move = (after - before) / (2.0 * _HALF_STEP * camera.detector.pixel_step)
    ex, ey = camera.detector.axis
    along, across = ex * move[:, 0] + ey * move[:, 1], ey * move[:, 0] - ex * move[:, 1]
    return ScanVelocity(np.hypot(along, across), np.arctan2(along, across))
