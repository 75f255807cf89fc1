"""A TDI column imaging a moving scene, by brute force in space and time.

Every stage integrates the scene over its pixel and its exposure by sums over sub-pixels and instants; stages
are added one line period apart. It shares no formula with ``imaging/tdi_transfer.py``, which it checks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Brightness at places x across and y along the column (pixels), any shape.
Scene = Callable[[Array, Array], Array]
#: Place (x, y) of the image of the scene's origin at times t (line periods).
Path = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class TdiColumn:
    """A column of square pixels, pixel 0 at the origin, pixel k at y = k.

    Attributes
    ----------
    stages, head_stages : int
    ratio, head_ratio : float
        Integration times over the line period.
    shutter : float
        Centre of the exposure minus that of the line period, in exposures: 0 centred, 0.5 start-aligned.
    aperture : (float, float)
        Photosensitive width across and along, pixels; 0 samples a point.
    subpixels, instants : int
        Of the sums, per pixel and axis, and per exposure.
    """

    stages: int
    ratio: float
    head_stages: int = 0
    head_ratio: float = 0.0
    shutter: float = 0.0
    aperture: tuple[float, float] = (0.0, 0.0)
    subpixels: int = 24
    instants: int = 400

    def signal(self, scene: Scene, path: Path, start: float = 0.0) -> float:
        """Sum of all stages for one line whose stage 0 is centred at `start` line periods."""
        offsets = [
            width * ((np.arange(self.subpixels) + 0.5) / self.subpixels - 0.5) if width else np.zeros(1)
            for width in self.aperture
        ]
        total = 0.0
        for k in range(self.stages):
            length = self.head_ratio if k < self.head_stages else self.ratio
            fraction = (np.arange(self.instants) + 0.5) / self.instants - 0.5 + self.shutter
            x, y = path(start + k + length * fraction)
            # the scene has moved by (x, y): the pixel sees what was so much before it
            seen = scene(
                offsets[0][None, :, None] - x[:, None, None],
                k + offsets[1][None, None, :] - y[:, None, None],
            )
            total += length * float(np.mean(seen))
        return total

    def response(self, fx: float, fy: float, path: Path, start: float = 0.0) -> complex:
        """Complex contrast of a sinusoid of unit contrast, from lines of two phases a quarter apart."""

        def wave(shift: float) -> Scene:
            return lambda x, y: np.cos(2.0 * np.pi * (fx * x + fy * y) + shift)

        even, odd = (self.signal(wave(shift), path, start) for shift in (0.0, -0.5 * np.pi))
        head = min(self.head_stages, self.stages)
        exposed = head * self.head_ratio + (self.stages - head) * self.ratio
        return complex(even, odd) / exposed
