"""What else than images measures the attitude: star trackers, gyros, ground control points.

Not here: reading their tables (``io/``), what they say in the joint estimate (``motion/strip/fusion.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AttitudeSensor:
    """Angles measured by something else than the camera, relative to the reference attitude.

    Attributes
    ----------
    name, kind : str
        Kind is ``"star-tracker"`` (angles at an instant) or ``"gyro"`` (increments over an interval).
    t_start, t_end : (N,)
        s; equal for a star tracker.
    angles : (N, 3)
        rad; roll, pitch, yaw.
    sigma : (N,)
        rad, 1-sigma of each angle.
    alignment_sigma : float
        rad; a constant error of the sensor's axes against the camera's.
    bias_sigma : float
        rad (star tracker) or rad/s (gyro); constant.
    correlation_time : float
        s; 0 = errors independent from row to row.
    """

    name: str
    kind: str
    t_start: Array
    t_end: Array
    angles: Array
    sigma: Array
    alignment_sigma: float
    bias_sigma: float
    correlation_time: float


@dataclass(frozen=True, eq=False)
class ControlSightings:
    """Where ground points of known coordinates were seen, one row each time.

    Attributes
    ----------
    position : (N, 3)
        m, world axes.
    sigma : (N,)
        m, per coordinate.
    image : (N,) int
        Number of the band or frame.
    pixels : (N, 2)
        (line, column).
    sigma_px : float
        1-sigma of each pixel coordinate: by correlation a tenth of a pixel, by hand more.
    lines : (N,) or None
        Lines of a band that each place is the mean of, as windows show it; None: each is of its own line.
    each_px : (N, 2) or None
        px; of line and column of each, in the place of `sigma_px`, where they are known one by one.
    """

    position: Array
    sigma: Array
    image: NDArray[np.intp]
    pixels: Array
    sigma_px: float = 0.1
    lines: Array | None = None
    each_px: Array | None = None

    def pixel_sigma(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Array:
        """(K, 2) px; of line and column of the points `chosen`."""
        if self.each_px is None:
            return np.full((len(self.sigma), 2), self.sigma_px)[chosen]
        return self.each_px[chosen]
