"""What is known of points before they are sighted: that they lie on a surface, or where they are.

Not here: reading elevation rasters or tables of control points (``io/``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, as_points, frozen
from sightline.geometry.surface import Surface
from sightline.photogrammetry.sightings import Index, as_index


@dataclass(frozen=True, eq=False)
class ControlPoints(ReadOnlyArrays):
    """Points whose coordinates are known.

    Attributes
    ----------
    point : (G,) int
        Which of the block's points.
    position : (G, 3)
        m, world axes.
    sigma : (G,)
        m, 1-sigma of each coordinate.
    """

    point: Index
    position: Array
    sigma: Array

    def __post_init__(self) -> None:
        """Check and freeze."""
        object.__setattr__(self, "point", as_index(self.point, "point"))
        object.__setattr__(self, "position", frozen(as_points(self.position, "position")))
        object.__setattr__(self, "sigma", frozen(np.broadcast_to(self.sigma, self.point.shape)))
        if len(self.point) != len(self.position):
            raise InputError(
                f"`point` and `position` need as many rows, got {len(self.point)} and {len(self.position)}"
            )
        if not (self.sigma > 0.0).all():
            raise InputError(f"`sigma` of control points must be positive, got {self.sigma.min():g} m")


@dataclass(frozen=True, eq=False)
class HeightPrior:
    """All points lie on a surface, to `sigma` along the vertical, each with an error of its own.

    Attributes
    ----------
    surface : Surface
    sigma : float
        m, positive.
    radii : (float, float) or None
        Of the ellipsoid whose normals are the verticals; None where the world is flat, z up.
    """

    surface: Surface
    sigma: float
    radii: tuple[float, float] | None

    def __post_init__(self) -> None:
        """Check."""
        if not (np.isfinite(self.sigma) and self.sigma > 0.0):
            raise InputError(f"`sigma` of a height prior must be positive, got {self.sigma} m")
