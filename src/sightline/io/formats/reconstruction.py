"""Cameras, poses and points as programs of photogrammetry exchange them, free of any one format.

Camera axes: x to larger columns, y to larger lines, z along the line of sight. Pixels are (line, column), 0
at the centre of the first one. World axes are the writer's, right-handed.

Not here: the formats (``colmap.py``, ``opensfm.py``).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.sightings import Index, as_index


def _no_numbers() -> Index:
    return np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Reconstruction(ReadOnlyArrays):
    """What photogrammetry gives.

    Attributes
    ----------
    names : tuple of str
        Of the images, M.
    detectors : tuple of AreaDetector
    camera : (M,) int
        Which of `detectors` took each image.
    position : (M, 3)
        m; of the projection centres.
    world_from_camera : Rotation
        M rotations.
    points : (n, 3)
        m; NaN for those that are not known, which no format is given.
    residual_px : (n,)
        rms of each point; NaN where it is not known.
    image, point : (N,) int
        Of each sighting; empty where the format has none. A sighting of no (known) point has -1 as its point.
    pixels : (N, 2)
        (line, column).
    """

    names: tuple[str, ...]
    detectors: tuple[AreaDetector, ...]
    camera: Index
    position: Array
    world_from_camera: Rotation
    points: Array = field(default_factory=lambda: np.empty((0, 3)))
    residual_px: Array = field(default_factory=lambda: np.empty(0))
    image: Index = field(default_factory=_no_numbers)
    point: Index = field(default_factory=_no_numbers)
    pixels: Array = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name in ("position", "points", "residual_px", "pixels"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "camera", as_index(self.camera, "camera", len(self.detectors)))
        object.__setattr__(self, "image", as_index(self.image, "image", len(self.names)))
        object.__setattr__(self, "point", as_index(self.point, "point", len(self.points), least=-1))
        images = [len(self.names), len(self.camera), len(self.position), len(self.world_from_camera)]
        sights = [len(self.image), len(self.point), len(self.pixels)]
        if len(set(images)) != 1 or len(set(sights)) != 1 or len(self.points) != len(self.residual_px):
            raise InputError(
                f"a reconstruction needs as many of each: images {images}, sightings {sights}, points "
                f"{len(self.points)} and residuals {len(self.residual_px)}"
            )
        name, count = Counter(self.names).most_common(1)[0] if self.names else ("", 0)
        if count > 1:
            raise InputError(f"{count} images are called {name!r}; each needs a name of its own")

    @property
    def known(self) -> list[int]:
        """Rows of the points that are known."""
        return [int(k) for k in np.flatnonzero(np.isfinite(self.points).all(axis=1))]


def points_of(points: Array, point: Index, square: Array, good: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Points that good sightings show, and their rms residual (px).

    Parameters
    ----------
    points : (n, 3)
        m.
    point : (N,) int
        Of each sighting.
    square : (N,)
        px^2; its squared residual.
    good : (N,) bool

    Returns
    -------
    points : (n, 3)
        NaN where no good sighting is.
    rms : (n,)
    """
    count = np.bincount(point[good], minlength=len(points))
    total = np.bincount(point[good], square[good], minlength=len(points))
    rms = np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)
    return np.where(count[:, None] > 0, points, np.nan), rms


def by_image(image: NDArray[np.intp], count: int) -> tuple[list[NDArray[np.intp]], NDArray[np.intp]]:
    """Rows of the sightings of each image, and the place of each sighting among those of its image."""
    order = np.argsort(image, kind="stable")
    counts = np.bincount(image, minlength=count)
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.split(order, np.cumsum(counts)[:-1]), place
