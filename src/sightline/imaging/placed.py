"""An image with its place on a map: an affine of its pixels and a coordinate system.

Not here: reading it from a file (``io/formats/images.py``), surfaces (``geometry/surface.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.imaging.source import ImageSource
from sightline.result import one_line

__all__ = ["PlacedImage"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedImage:
    """An image that is read in windows, and where its pixels lie on a map.

    Parameters
    ----------
    source : ImageSource
    transform : six numbers (a, b, c, d, e, f)
        x = a column + b line + c, y = d column + e line + f, with the corner of the first pixel at line 0,
        column 0 and its centre at (0.5, 0.5): the affine of GDAL and rasterio.
    crs : str, optional
        Coordinate system of x and y ("EPSG:32645", WKT, ...); None: axes that nothing is known about, which
        must be those of every image that it is laid on.

    Examples
    --------
    >>> import numpy as np
    >>> from sightline.imaging.source import ArrayImage
    >>> image = PlacedImage(ArrayImage(np.zeros((2, 3))), (10.0, 0.0, 500.0, 0.0, -10.0, 900.0))
    >>> image.places(np.array([[0.0, 0.0]])).tolist()
    [[505.0, 895.0]]
    """

    source: ImageSource
    transform: Sequence[float]
    crs: str | None = None

    def __post_init__(self) -> None:
        """Check."""
        transform = tuple(float(v) for v in self.transform)[:6]
        if len(transform) != 6 or not np.isfinite(transform).all():
            raise InputError(f"`transform` must be six finite numbers, got {tuple(self.transform)}")
        if transform[0] * transform[4] - transform[1] * transform[3] == 0.0:
            raise InputError(f"`transform` {transform} maps the image onto a line: its determinant is zero")
        object.__setattr__(self, "transform", transform)

    def __repr__(self) -> str:
        """One line."""
        (lines, columns), crs = self.shape, self.crs or "none"
        # of WKT the name, which is the first text in it
        name = crs.split('"')[1] if crs.count('"') > 1 else crs
        facts = {
            "": repr(self.source),
            "crs": name[:60],
            "transform": " ".join(f"{v:.7g}" for v in self.transform),
        }
        return one_line("PlacedImage", {**facts, "px": f"{lines} x {columns}"})

    @property
    def shape(self) -> tuple[int, int]:
        """Number of lines and of columns."""
        return self.source.shape

    @property
    def path(self) -> Any:
        """The file that it is read from; None of an array."""
        return getattr(self.source, "path", None)

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window; first and one past the last line (column)."""
        return self.source.read(lines, columns)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window; None if there are none."""
        return self.source.mask(lines, columns)

    @property
    def linear(self) -> Array:
        """(2, 2); change of (x, y) with (line, column)."""
        a, b, _, d, e, _ = self.transform
        return np.array([[b, a], [e, d]])

    def places(self, pixels: Array) -> Array:
        """x and y (N, 2) of pixels (N, 2), (line, column)."""
        _, _, c, _, _, f = self.transform
        return np.asarray((np.asarray(pixels) + 0.5) @ self.linear.T + np.array([c, f]))

    def pixels(self, places: Array) -> Array:
        """Pixels (N, 2), (line, column), of x and y (N, 2)."""
        _, _, c, _, _, f = self.transform
        inverse = np.linalg.inv(self.linear)
        return np.asarray((np.asarray(places) - np.array([c, f])) @ inverse.T - 0.5)
