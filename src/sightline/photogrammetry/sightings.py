"""Points sighted in images of known poses: what every estimate of orientation and structure starts from.

`Tracks` are pixels: one point in many images. `Images` are the planned poses of a block of frames.
`Sightings` are both made free of lens and camera: tangents, the pose each was taken from, and how pixels
follow from tangents. Frames and pushbroom images give the same `Sightings`.

Not here: how points are found in images (``matching/``), what is solved from them
(``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.apparent import BentMount
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.checks import Array, ReadOnlyArrays, as_pixels, as_points, as_times, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.pose_table import camera_poses

Index = NDArray[np.intp]

#: Step (px) of the differences that give how pixels follow from tangents.
_STEP = 0.5


def as_index(values: object, name: str, count: int | None = None, least: int = 0) -> Index:
    """Whole numbers (N,) from `least`, below `count` where given, as a read-only array."""
    if isinstance(values, np.ndarray) and values.dtype == np.intp and not values.flags.writeable:
        array = whole = values
    else:
        array = np.array(values, dtype=np.float64)
        whole = array.astype(np.intp)
    if array.ndim != 1 or not (array == whole).all():
        raise InputError(f"`{name}` must be whole numbers of shape (N,), got {array.dtype} of {array.shape}")
    if len(whole) and (whole.min() < least or (count is not None and whole.max() >= count)):
        allowed = f"{least} or more" if count is None else f"{least} to {count - 1}"
        raise InputError(f"`{name}` must be {allowed}, got {whole.min()} to {whole.max()}")
    whole.setflags(write=False)
    return whole


@dataclass(frozen=True, eq=False)
class Tracks(ReadOnlyArrays):
    """Conjugate points of many images: each row is one point found in one image.

    Attributes
    ----------
    image : (N,) int
        Row of the block's images.
    point : (N,) int
        Which point; 0 to the number of points less 1.
    pixels : (N, 2)
        (line, column), px.
    sigma_px : (N,)
        px, 1-sigma of each coordinate, independent from image to image.
    """

    image: Index
    point: Index
    pixels: Array
    sigma_px: Array

    @classmethod
    def none(cls) -> Tracks:
        """No point at all."""
        nothing = np.empty(0, dtype=np.intp)
        return cls(nothing, nothing, np.empty((0, 2)), np.empty(0))

    def __post_init__(self) -> None:
        """Check and freeze."""
        object.__setattr__(self, "image", as_index(self.image, "image"))
        object.__setattr__(self, "point", as_index(self.point, "point"))
        object.__setattr__(self, "pixels", frozen(as_pixels(self.pixels)))
        sigma = np.broadcast_to(np.asarray(self.sigma_px, dtype=np.float64), self.image.shape)
        object.__setattr__(self, "sigma_px", frozen(sigma))
        if not len(self.image) == len(self.point) == len(self.pixels):
            raise InputError(
                f"`image`, `point` and `pixels` must have as many rows, got {len(self.image)}, "
                f"{len(self.point)} and {len(self.pixels)}"
            )
        if not np.isfinite(self.pixels).all():
            raise InputError("`pixels` of Tracks must be finite: leave out points that were not found")
        if not (self.sigma_px > 0.0).all():
            raise InputError(f"`sigma_px` must be positive, got {self.sigma_px.min():g} px at least")

    def __len__(self) -> int:
        """Number of sightings."""
        return len(self.image)

    def __getitem__(self, rows: NDArray[np.bool_] | Index) -> Tracks:
        """The same tracks, only some rows."""
        return Tracks(self.image[rows], self.point[rows], self.pixels[rows], self.sigma_px[rows])


def joined(tracks: Sequence[Tracks]) -> Tracks:
    """Tracks one after the other, as they are numbered."""
    return Tracks(
        *(np.concatenate([getattr(t, n) for t in tracks]) for n in ("image", "point", "pixels", "sigma_px"))
    )


def appended(tracks: Tracks, more: Tracks) -> Tracks:
    """Tracks, and `more` after them, whose points are numbered after theirs."""
    first = int(tracks.point.max()) + 1
    return joined([tracks, replace(more, point=as_index(more.point + first, "point"))])


@dataclass(frozen=True, eq=False)
class Images(ReadOnlyArrays):
    """Planned poses of the frames of a block.

    Attributes
    ----------
    camera : (M,) int
        Which camera took each image; 0 to the number of cameras less 1.
    shot : (M,) int
        Images of one shot were exposed together; their poses' errors may be tied.
    t : (M,)
        s from the epoch.
    position : (M, 3)
        m, world axes.
    world_from_body : Rotation
        M rotations.
    """

    camera: Index
    shot: Index
    t: Array
    position: Array
    world_from_body: Rotation

    def __post_init__(self) -> None:
        """Check and freeze."""
        object.__setattr__(self, "camera", as_index(self.camera, "camera"))
        object.__setattr__(self, "shot", as_index(self.shot, "shot"))
        object.__setattr__(self, "t", frozen(as_times(self.t)))
        object.__setattr__(self, "position", frozen(as_points(self.position, "position")))
        sizes = [len(self.camera), len(self.shot), len(self.t), len(self.position), len(self.world_from_body)]
        if len(set(sizes)) != 1:
            raise InputError(
                f"camera, shot, t, position and world_from_body need as many rows each, got {sizes}"
            )
        pairs = np.stack([self.camera, self.shot])
        if len(np.unique(pairs, axis=1).T) < len(self.camera):
            raise InputError("a camera has two images in one shot: give every exposure a shot of its own")

    def __len__(self) -> int:
        """Number of images."""
        return len(self.camera)

    def __getitem__(self, rows: NDArray[np.bool_] | Index | slice) -> Images:
        """Some of the images."""
        return Images(
            self.camera[rows],
            self.shot[rows],
            self.t[rows],
            self.position[rows],
            self.world_from_body[rows],
        )

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return int(self.camera.max()) + 1 if len(self.camera) else 0


@dataclass(frozen=True, eq=False)
class Sightings(ReadOnlyArrays):
    """Points sighted from poses, free of lens and kind of camera.

    Attributes
    ----------
    camera, shot, t : (M,)
        Of each image, as in `Images`. The errors of its pose are one per image.
    image, point, pose : (N,) int
        Of each sighting: image, point, and row of the poses below (frames: one pose per image; pushbroom: one
        per sighting).
    tangents : (N, 2)
        x/z and y/z in camera axes, lens undone.
    px_per_tangent : (N, 2, 2)
        Change of (line, column) with the tangents; of pushbroom images with the line's pose in mind.
    sigma_px : (N,)
        px, 1-sigma of each coordinate.
    position : (P, 3)
        m, world axes; of each pose, as planned.
    world_from_body : (P, 3, 3)
        Matrices, as planned.
    body_from_camera : (C, 3, 3)
        How each camera sits in its body.

    Notes
    -----
    A point at X seen from a pose turned by small body angles w and moved by e: q = body_from_camera^T
    exp(-[w]x) world_from_body^T (X - position - e); residual (px) = px_per_tangent @ (tangents - q_xy / q_z).
    """

    camera: Index
    shot: Index
    t: Array
    image: Index
    point: Index
    pose: Index
    tangents: Array
    px_per_tangent: Array
    sigma_px: Array
    position: Array
    world_from_body: Array
    body_from_camera: Array

    def __len__(self) -> int:
        """Number of sightings."""
        return len(self.image)

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(self.body_from_camera)

    @property
    def points(self) -> int:
        """Number of points (the largest index and one)."""
        return int(self.point.max()) + 1 if len(self.point) else 0


def sight_frames(
    images: Images, detectors: Sequence[AreaDetector], mounts: Sequence[Rotation], tracks: Tracks
) -> Sightings:
    """Sightings of tracks in frames.

    Parameters
    ----------
    images : Images
    detectors : sequence of AreaDetector
        One per camera.
    mounts : sequence of Rotation
        body_from_camera, one per camera.
    tracks : Tracks
        Rows of `images` by their `image`.

    Returns
    -------
    Sightings
        One pose per image.
    """
    tangents, change = np.empty((len(tracks), 2)), np.empty((len(tracks), 2, 2))
    camera = images.camera[tracks.image]
    for number, detector in enumerate(detectors):
        rows = camera == number
        tangents[rows], change[rows] = _tangents(detector, tracks.pixels[rows])
    if not np.isfinite(tangents).all():
        row = int(np.flatnonzero(~np.isfinite(tangents).all(axis=1))[0])
        raise InputError(
            f"pixel {tracks.pixels[row].tolist()} lies where the lens brings no light; check (line, column) "
            "order and the distortion"
        )
    return Sightings(
        images.camera,
        images.shot,
        images.t,
        tracks.image,
        tracks.point,
        tracks.image,
        frozen(tangents),
        frozen(change),
        tracks.sigma_px,
        images.position,
        frozen(images.world_from_body.as_matrix()),
        frozen(np.stack([mount.as_matrix() for mount in mounts])),
    )


def rays_of(
    images: Images, detectors: Sequence[AreaDetector], mounts: Sequence[Rotation], tracks: Tracks
) -> Array:
    """Directions (N, 3) in world axes of what was seen, by the planned poses; NaN where no light comes."""
    camera = images.camera[tracks.image]
    directions = np.empty((len(tracks), 3))
    for number, (detector, mount) in enumerate(zip(detectors, mounts, strict=True)):
        rows = camera == number
        directions[rows] = detector.directions(tracks.pixels[rows]) @ mount.as_matrix().T
    body = images.world_from_body.as_matrix()
    return np.einsum("nij,nj->ni", body[tracks.image], directions)


def stretched_sightings(sightings: Sightings, stretch: float) -> Sightings:
    """Sightings of a camera whose focal length was refined, in tangents of the one given.

    Parameters
    ----------
    sightings : Sightings
        By the refined focal length, whose lens alone may have undone the distortion rightly.
    stretch : float
        The refined focal length over the one given, less 1.

    Returns
    -------
    Sightings
        What a stretch of exactly so much predicts, whatever the distortion: tangents times 1 and it.
    """
    factor = 1.0 + stretch
    return replace(
        sightings,
        tangents=frozen(sightings.tangents * factor),
        px_per_tangent=frozen(sightings.px_per_tangent / factor),
    )


def frames_of(sightings: Sightings) -> Images:
    """The planned poses of frames; InputError for images that are not taken at one instant each."""
    if len(sightings.position) != len(sightings.camera):
        raise InputError(
            "attitudes rebuilt from positions are known for frames only, not for pushbroom images"
        )
    return Images(
        sightings.camera,
        sightings.shot,
        sightings.t,
        sightings.position,
        Rotation.from_matrix(sightings.world_from_body),
    )


def _tangents(detector: AreaDetector, pixels: Array) -> tuple[Array, Array]:
    """Tangents (N, 2) of pixels and the change (N, 2, 2) of (line, column) with them."""

    def at(line: float, column: float) -> Array:
        d = detector.directions(pixels + np.array([line, column]))
        return np.asarray(d[:, :2] / d[:, 2:])

    by_line = (at(_STEP, 0.0) - at(-_STEP, 0.0)) / (2.0 * _STEP)
    by_column = (at(0.0, _STEP) - at(0.0, -_STEP)) / (2.0 * _STEP)
    return at(0.0, 0.0), np.linalg.inv(np.stack([by_line, by_column], axis=-1))


def sight_pushbroom(cameras: Sequence[PushbroomCamera], tracks: Tracks) -> Sightings:
    """Sightings of tracks in pushbroom images, one image per camera.

    Parameters
    ----------
    cameras : sequence of PushbroomCamera
        Fixed mounts. The error sought is one constant for each.
    tracks : Tracks
        Rows of `cameras` by their `image`.

    Returns
    -------
    Sightings
        One pose per sighting: that of its own line. All images are of one shot 0.
    """
    n = len(tracks)
    ranges = _ranges(cameras, tracks)
    tangents, change = np.empty((n, 2)), np.empty((n, 2, 2))
    position, world_from_body, t = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(len(cameras))
    mounts = []
    for number, camera in enumerate(cameras):
        if not isinstance(camera.pointing, FixedMount | BentMount):
            raise InputError("a constant error is sought for cameras that sit still in their body only")
        mount = camera.pointing.body_from_camera.as_matrix()
        mounts.append(mount)
        t[number] = float(np.mean(camera.times(np.array([0.0, camera.lines - 1.0]))))
        rows = np.flatnonzero(tracks.image == number)
        pixels = tracks.pixels[rows]
        lever = np.asarray(camera.lever_arm, dtype=np.float64)
        times = camera.times(pixels[:, 0])
        matrices, position[rows] = camera_poses(times, camera.trajectory, camera.pointing, lever)
        if isinstance(camera.pointing, BentMount):
            # the nearest rotations: where points are seen from there holds what light does
            matrices = Rotation.from_matrix(matrices).as_matrix()
        world_from_body[rows] = matrices @ mount.T
        rays = camera.rays(pixels)
        points = rays.origins + ranges[rows, None] * rays.directions

        def seen(points: Array, matrices: Array = matrices, origin: Array = position[rows]) -> Array:
            q = np.einsum("nji,nj->ni", matrices, points - origin)
            return np.asarray(q[:, :2] / q[:, 2:])

        tangents[rows] = seen(points)
        for axis, step in enumerate(np.diag([_STEP, _STEP])):
            moved = []
            for sign in (1.0, -1.0):
                other = camera.rays(pixels + sign * step)
                moved.append(seen(other.origins + ranges[rows, None] * other.directions))
            # where the pixel `step` further looks, seen from the pose of this line
            change[rows, :, axis] = (moved[0] - moved[1]) / (2.0 * _STEP)
    zero = np.zeros(len(cameras), dtype=np.intp)
    return Sightings(
        as_index(np.arange(len(cameras)), "camera"),
        as_index(zero, "shot"),
        frozen(t),
        tracks.image,
        tracks.point,
        as_index(np.arange(n), "pose"),
        frozen(tangents),
        frozen(np.linalg.inv(change)),
        tracks.sigma_px,
        frozen(position),
        frozen(world_from_body),
        frozen(np.stack(mounts)),
    )


def _ranges(cameras: Sequence[PushbroomCamera], tracks: Tracks) -> Array:
    """Distance (N,) m from the camera to each point, roughly: where the rays of a point pass closest.

    A line's motion carries its rays by so much more on the ground the farther that is.
    """
    origins, directions = np.empty((len(tracks), 3)), np.empty((len(tracks), 3))
    for number, camera in enumerate(cameras):
        rows = np.flatnonzero(tracks.image == number)
        rays = camera.rays(tracks.pixels[rows])
        origins[rows], directions[rows] = rays.origins, rays.directions
    centre = origins.mean(axis=0)
    count = int(tracks.point.max()) + 1
    square = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    pulled = np.einsum("nij,nj->ni", square, origins - centre)
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, tracks.point, square)
    np.add.at(right, tracks.point, pulled)
    points = np.linalg.solve(matrix + 1e-9 * np.eye(3), right[..., None])[..., 0] + centre
    ranges = ((points[tracks.point] - origins) * directions).sum(axis=1)
    if not (ranges > 0.0).all():
        raise InputError(
            f"{int((ranges <= 0.0).sum())} of {len(ranges)} sightings are of points behind their camera; "
            "check which matches belong to which image, and (line, column) order"
        )
    return np.asarray(ranges)
