"""Sightings of one point by two cameras in one shot, laid side by side: the rows of S2's linear estimators.

Not here: what is estimated from them (``epipolar.py``, ``plane.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays
from sightline.photogrammetry.block.pose_noise import PoseNoise, aim_sensitivity
from sightline.photogrammetry.sightings import Images, Index, Sightings


@dataclass(frozen=True, eq=False)
class SightingPairs(ReadOnlyArrays):
    """Pairs of sightings of two cameras that saw the same point in the same shot, shot by shot.

    Attributes
    ----------
    sightings : Sightings
        Of frames.
    rows : (2, N) int
        Of `sightings`: by the first camera, by the second.
    shot : (N,) int
        Row of `images` of each pair, not decreasing.
    images : (2, K) int
        Images of the shots with at least one pair, in order of their number.
    starts : (K + 1,) int
        Pairs ``starts[k]`` to ``starts[k + 1] - 1`` are of shot k.
    """

    sightings: Sightings
    rows: Index
    shot: Index
    images: Index
    starts: Index

    def __len__(self) -> int:
        """Number of pairs."""
        return self.rows.shape[1]

    def kept(self, keep: NDArray[np.bool_]) -> SightingPairs:
        """Only the pairs where `keep` (N,) is true; shots that lose all their pairs go."""
        return _grouped(self.sightings, self.rows[:, keep])

    @property
    def baselines(self) -> Array:
        """First camera less second (K, 3), m, world axes."""
        position = self.sightings.position
        return np.asarray(position[self.images[0]] - position[self.images[1]])

    @property
    def point(self) -> Index:
        """Point of each pair (N,)."""
        return self.sightings.point[self.rows[0]]


@dataclass(frozen=True, eq=False)
class PairOrientation(ReadOnlyArrays):
    """Constant attitude errors of two cameras.

    Attributes
    ----------
    angles : (2, 3)
        rad: rotation vector (roll, pitch, yaw) in body axes by which each camera's actual attitude is the
        planned one turned, on the right. nan where it is not determined.
    covariance : (6, 6)
        rad^2, in the order of `angles`; inf and nan where they are not determined.
    information : (6, 6)
        rad^-2; 0 along unobservable directions.
    unobservable : (G, 6)
        Unit vectors of the directions that are not observable.
    bias : (2, 3)
        rad: what noise in the coefficients adds to ordinary least squares on the average. Still in `angles`
        of a raw estimate, else already out of them.
    residual_px : (N,)
        Of each pair; which residual, the estimator says.
    """

    angles: Array
    covariance: Array
    information: Array
    unobservable: Array
    bias: Array
    residual_px: Array


def pair_sightings(sightings: Sightings, cameras: tuple[int, int] = (0, 1)) -> SightingPairs:
    """Pairs of sightings of two cameras; points that only one of them saw in a shot are left out.

    Parameters
    ----------
    sightings : Sightings
        Of frames: one pose per image.
    cameras : (first, second)
        Which two.

    Returns
    -------
    SightingPairs

    Raises
    ------
    InputError
        Poses that differ within an image, one camera twice, a point twice in an image, no pair at all.
    """
    first, second = cameras
    if first == second or not (0 <= min(cameras) and max(cameras) < sightings.cameras):
        raise InputError(f"a pair needs two cameras of the {sightings.cameras} there are, got {cameras}")
    if not np.array_equal(sightings.pose, sightings.image):
        raise InputError("pairs need frames, with one pose per image; adjust pushbroom images by ml-track")
    shot, camera = sightings.shot[sightings.image], sightings.camera[sightings.image]
    key = shot * sightings.points + sightings.point
    by_camera = [np.flatnonzero(camera == one) for one in cameras]
    keys, rows = [key[of] for of in by_camera], list(by_camera)
    for which in range(2):
        if not (np.diff(keys[which]) > 0).all():
            order = np.argsort(keys[which], kind="stable")
            keys[which], rows[which] = keys[which][order], rows[which][order]
        twice = np.flatnonzero(np.diff(keys[which]) == 0)
        if len(twice):
            row = rows[which][twice[0]]
            raise InputError(
                f"point {sightings.point[row]} is given twice in image {sightings.image[row]} (shot "
                f"{shot[row]}); keep one sighting of a point per image"
            )
    if not np.array_equal(keys[0], keys[1]):
        shared = np.isin(keys[0], keys[1], assume_unique=True), np.isin(keys[1], keys[0], assume_unique=True)
        rows = [rows[which][shared[which]] for which in range(2)]
    if not len(rows[0]):
        raise InputError(
            f"cameras {first} and {second} saw no point in the same shot: each shot has one camera only, or "
            "its points bear different numbers; give both images of a shot the same shot and point numbers"
        )
    return _grouped(sightings, np.stack(rows))


def _grouped(sightings: Sightings, rows: Index) -> SightingPairs:
    """Pairs from their rows (2, N), already in order of shots."""
    image = sightings.image[rows]
    starts = np.flatnonzero(np.diff(image[0], prepend=-1))
    shot = np.repeat(np.arange(len(starts)), np.diff(starts, append=rows.shape[1]))
    return SightingPairs(sightings, rows, shot, image[:, starts], np.append(starts, rows.shape[1]))


def position_turns(pairs: SightingPairs, noise: PoseNoise) -> Array:
    """How attitudes in hand turn with errors of the positions in hand.

    Parameters
    ----------
    pairs : SightingPairs
        K shots.
    noise : PoseNoise

    Returns
    -------
    (2, 2, K, 3, 3)
        rad/m: [camera turned, camera moved]: rotation vector in body axes by a move along world axes. 0 where
        attitudes are independent of positions.
    """
    count = pairs.images.shape[1]
    if noise.aim_point is None:
        return np.zeros((2, 2, count, 3, 3))
    sightings, chosen = pairs.sightings, pairs.images.ravel()
    images = Images(
        sightings.camera[chosen],
        sightings.shot[chosen],
        sightings.t[chosen],
        sightings.position[chosen],
        Rotation.from_matrix(sightings.world_from_body[chosen]),
    )
    _, turn = aim_sensitivity(images, noise.aim_point)
    own, partner = np.moveaxis(turn, 1, 0).reshape(2, 2, count, 3, 3)
    return np.stack([np.stack([own[0], partner[0]]), np.stack([partner[1], own[1]])])
