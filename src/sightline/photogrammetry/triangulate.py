"""Two or more sightings of a point to its position, with covariance; where planned rays meet.

Each point by itself: weighted least squares of its residuals (px) under given poses. What is not known of the
poses enters the covariance, not the weights.

Not here: poses estimated with the points (``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.compiled import only_read
from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.block.pose_noise import PoseNoise, aim_sensitivity
from sightline.photogrammetry.sightings import Index, Sightings, as_index, frames_of
from sightline.photogrammetry.triangulate_kernels import meet, spread

#: rad; rays that turn by less than this from image to image have no point in common.
_PARALLEL = 1e-6


@dataclass(frozen=True, eq=False)
class Triangulation(ReadOnlyArrays):
    """Points found from where they were sighted.

    Attributes
    ----------
    point : (n,) int
        Which point each row is.
    shot : (n,) int or None
        Of which shot, where points were found shot by shot.
    row : (N,) int
        Row, of these n, that each sighting belongs to, whether it was used or not.
    count : (n,) int
        Sightings used.
    position : (n, 3)
        m, world axes; NaN where a point cannot be had: fewer than two sightings, rays that do not show
        how far it is, or a point behind a camera.
    covariance : (n, 3, 3)
        m^2; NaN likewise.
    """

    point: Index
    shot: Index | None
    row: Index
    count: Index
    position: Array
    covariance: Array

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.point)


def triangulate(
    sightings: Sightings,
    angles: Array | None = None,
    *,
    attitude: Array | None = None,
    position: Array | None = None,
    by_shot: bool = False,
    used: NDArray[np.bool_] | None = None,
    noise: PoseNoise | None = None,
    angle_covariance: Array | None = None,
) -> Triangulation:
    """Points where the rays of their sightings meet best.

    Parameters
    ----------
    sightings : Sightings
        N sightings of M images by C cameras.
    angles : (C, 3), optional
        rad, constant errors of the cameras (roll, pitch, yaw) about body axes; none unless given.
    attitude : (M, 3), optional
        rad, error of each image beyond its camera's.
    position : (M, 3), optional
        m, world axes; error of each image's position.
    by_shot : bool
        A point of its own for each shot that sighted it, in place of one point seen in all shots.
    used : (N,) bool, optional
        False leaves a sighting out.
    noise : PoseNoise, optional
        What is not known of each image's pose; then it is in the covariance.
    angle_covariance : (3C, 3C), optional
        rad^2, of `angles`; then it is in the covariance.

    Returns
    -------
    Triangulation
        One row per point, from 0 to the largest; with `by_shot` one per point and shot that occur, in order
        of shots, then of points.

    Notes
    -----
    With weights W of the pixels and rows A of a point, errors B p of poses move it by (A' W A)^-1 A' W B p:
    the covariance is (A' W A)^-1 and what p adds. A point is given up where its least known direction has a
    sigma, from the noise of images alone, of more than a third of its distance.
    """
    row, point, shot = _rows(sightings, by_shot)
    order, begin = _runs(row, len(point), used)
    turned, place = _poses(sightings, angles, attitude, position)
    weighed = sightings.px_per_tangent / sightings.sigma_px[:, None, None]
    positions, inverse = np.empty((len(point), 3)), np.empty((len(point), 3, 3))
    pose, tangents, image, camera, body_from_camera = only_read(
        sightings.pose, sightings.tangents, sightings.image, sightings.camera, sightings.body_from_camera
    )
    meet(begin, order, pose, tangents, weighed, turned, place, positions, inverse)
    covariance = inverse.copy()
    if noise is not None or angle_covariance is not None:
        spread(
            begin, order, pose, image, camera, weighed, turned, place, body_from_camera, positions, inverse,
            *_unknown(sightings, noise), *only_read(_angle_covariance(sightings, angle_covariance)),
            covariance,
        )  # fmt: skip
    return Triangulation(
        as_index(point, "point"), None if shot is None else as_index(shot, "shot"), as_index(row, "row"),
        as_index(np.diff(begin), "count"), frozen(positions), frozen(covariance),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Meeting:
    """Where planned rays of each point meet, as near as they come.

    Attributes
    ----------
    points : (n, 3)
        m; NaN where rays are parallel.
    miss : (N,)
        rad; between each ray and the direction to its point; more than pi/2 behind the camera.
    """

    points: Array
    miss: Array


def meet_rays(origins: Array, directions: Array, point: Index, count: int) -> Meeting:
    """Least-squares meeting of rays that share a point, all of one weight.

    Parameters
    ----------
    origins, directions : (N, 3)
        m; unit vectors.
    point : (N,) int
        Below `count`.
    count : int
    """
    middle = origins.mean(axis=0)
    o = origins - middle
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    seen = np.bincount(point, minlength=count).astype(np.float64)
    share = np.maximum(seen, 1.0)[:, None]
    normal = group_sums(across.reshape(-1, 9), point, count).reshape(-1, 3, 3) / share[:, None]
    right = group_sums(np.einsum("nij,nj->ni", across, o), point, count) / share
    crossing = np.linalg.eigvalsh(normal)[:, 0] > (_PARALLEL / 2.0) ** 2
    points = np.full((count, 3), np.nan)
    points[crossing] = np.linalg.solve(normal[crossing], right[crossing][:, :, None])[:, :, 0]
    to = points[point] - o
    distance = np.linalg.norm(to, axis=1)
    along = np.einsum("ni,ni->n", to, directions)
    across_m = np.linalg.norm(to - along[:, None] * directions, axis=1)
    miss = np.where(distance > 0.0, np.arctan2(across_m, along), np.pi)
    return Meeting(points + middle, miss)


def group_sums(values: Array, group: Index, count: int) -> Array:
    """Sums (count, k) of the rows of `values` (N, k) by group."""
    return np.stack([np.bincount(group, column, count) for column in values.T], axis=1)


def _rows(sightings: Sightings, by_shot: bool) -> tuple[Index, Index, Index | None]:
    """Row of each sighting (N,), and point and shot of each row (n,)."""
    if not by_shot:
        return sightings.point, np.arange(sightings.points), None
    key = sightings.shot[sightings.image] * max(sightings.points, 1) + sightings.point
    found, row = np.unique(key, return_inverse=True)
    return row, found % max(sightings.points, 1), found // max(sightings.points, 1)


def _runs(row: Index, count: int, used: NDArray[np.bool_] | None) -> tuple[Index, Index]:
    """Sightings in order of their rows, and where each row's begin (n + 1,)."""
    kept = np.arange(len(row)) if used is None else np.flatnonzero(used)
    order = kept[np.argsort(row[kept], kind="stable")]
    begin = np.zeros(count + 1, dtype=np.intp)
    np.cumsum(np.bincount(row[kept], minlength=count), out=begin[1:])
    return order, begin


def _poses(
    sightings: Sightings, angles: Array | None, attitude: Array | None, position: Array | None
) -> tuple[Array, Array]:
    """camera_from_world (P, 3, 3) and position (P, 3) of each pose, its errors taken out."""
    image = np.zeros(len(sightings.position), dtype=np.intp)
    image[sightings.pose] = sightings.image
    camera = sightings.camera[image]
    small = np.zeros((len(image), 3))
    if angles is not None:
        small += np.asarray(angles, dtype=np.float64)[camera]
    if attitude is not None:
        small += np.asarray(attitude, dtype=np.float64)[image]
    body = sightings.world_from_body @ Rotation.from_rotvec(small).as_matrix()
    place = np.array(sightings.position)
    if position is not None:
        place += np.asarray(position, dtype=np.float64)[image]
    world_from_camera = body @ sightings.body_from_camera[camera]
    return np.ascontiguousarray(np.swapaxes(world_from_camera, 1, 2)), place


def _unknown(sightings: Sightings, noise: PoseNoise | None) -> tuple[float, float, Index, Array]:
    """Sigma of positions and attitudes, and the images and turns that the errors of positions go with."""
    images = len(sightings.camera)
    alone = np.full(images, -1, dtype=np.intp), np.zeros((images, 2, 3, 3))
    if noise is None:
        return 0.0, 0.0, *alone
    if noise.aim_point is None:
        return noise.position, noise.attitude, *alone
    return noise.position, noise.attitude, *aim_sensitivity(frames_of(sightings), noise.aim_point)


def _angle_covariance(sightings: Sightings, covariance: Array | None) -> Array:
    """(3C, 3C) rad^2; nought where none is given."""
    size = 3 * sightings.cameras
    if covariance is None:
        return np.zeros((size, size))
    given = np.ascontiguousarray(covariance, dtype=np.float64)
    if given.shape != (size, size):
        raise InputError(
            f"`angle_covariance` must be ({size}, {size}) for {size // 3} cameras: {given.shape}"
        )
    return given
