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
    captures : tuple of str
        Names of the captures of a rig, whose detectors sit in each other's axes the same way in all of them;
        empty where each image stands alone.
    capture : (M,) int
        Which capture each image is of; empty likewise.
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
    captures: tuple[str, ...] = ()
    capture: Index = field(default_factory=_no_numbers)

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name in ("position", "points", "residual_px", "pixels"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "camera", as_index(self.camera, "camera", len(self.detectors)))
        object.__setattr__(self, "image", as_index(self.image, "image", len(self.names)))
        object.__setattr__(self, "point", as_index(self.point, "point", len(self.points), least=-1))
        object.__setattr__(self, "capture", as_index(self.capture, "capture", len(self.captures)))
        if self.captures and len(self.capture) != len(self.names):
            raise InputError(f"`capture` needs a row for each of {len(self.names)} images")
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

    def sensors(self) -> dict[int, tuple[Rotation, Array]]:
        """Of each detector of a rig: camera_from_rig, and where the rig's origin lies in its axes (m).

        The rig's axes are those of the camera of the first detector; cameras that share no capture with it
        are left out.
        """
        out: dict[int, tuple[Rotation, Array]] = {}
        first = {int(self.capture[k]): k for k in np.flatnonzero(self.camera == 0)}
        for k, (camera, capture) in enumerate(zip(self.camera, self.capture, strict=True)):
            if int(camera) not in out and int(capture) in first:
                at = first[int(capture)]
                turn = self.world_from_camera[k].inv()
                moved = np.array(self.position[at] - self.position[k])
                out[int(camera)] = turn * self.world_from_camera[at], turn.apply(moved)
        return out

    def rig_poses(self) -> dict[int, tuple[Rotation, Array]]:
        """Of each capture: rig_from_world, and where the world's origin lies in the rig's axes (m)."""
        sensors = self.sensors()
        out: dict[int, tuple[Rotation, Array]] = {}
        for k in np.argsort(self.camera, kind="stable"):
            capture, camera = int(self.capture[k]), int(self.camera[k])
            if capture in out or camera not in sensors:
                continue
            turn, moved = sensors[camera]
            rig_from_world = turn.inv() * self.world_from_camera[int(k)].inv()
            place = -self.world_from_camera[int(k)].inv().apply(np.array(self.position[k]))
            out[capture] = rig_from_world, turn.inv().apply(place - moved)
        return out

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
