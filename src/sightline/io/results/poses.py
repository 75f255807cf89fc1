"""``poses.csv``, ``poses-truth.csv`` and ``covariance.npz``: the poses of the frames of a sequence.

``poses.csv``: ``frame,t,x,y,z,qx,qy,qz,qw,sigma_x,sigma_y,sigma_z,sigma_roll,sigma_pitch,sigma_yaw,source``.
World axes as `pose_axes` says; quaternions world_from_body, scalar last; sigmas of positions m along the same
axes, of angles rad about body axes; source solved, estimated or interpolated. ``poses-truth.csv`` has the
first nine columns.

``covariance.npz``: ``frame`` (M,) names, ``covariance`` (M, 6, 6) of position (m, world axes) and angles
(rad, body axes), ``datum`` (6,) the constant errors found of the tables (table less truth: position,
attitude) and ``datum_covariance`` (6, 6), ``next_covariance`` (M - 1, 6, 6) of each frame with the one before
it, ``pair_covariance`` (M, 6, M, 6) of all with each other where they are few, ``scale_sigma``.

Not here: poses for other programs (``io/formats/colmap.py``, ``io/formats/opensfm.py``,
``io/formats/odm.py``, ``io/formats/angle_tables.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import read_arrays
from sightline.errors import FormatError, InputError, foreign_errors, reads
from sightline.geometry.checks import ReadOnlyArrays, frozen
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.io.acquisition.schema import WorldSection
from sightline.io.formats.tables import check_quaternions, read_columns, write_columns
from sightline.io.sequence.frames import refuse_repeated
from sightline.writing import whole

Array = NDArray[np.float64]

TRUTH = ("frame", "t", "x", "y", "z", "qx", "qy", "qz", "qw")
SIGMAS = ("sigma_x", "sigma_y", "sigma_z", "sigma_roll", "sigma_pitch", "sigma_yaw")
POSES = (*TRUTH, *SIGMAS, "source")
SOURCES = ("solved", "estimated", "interpolated")


@dataclass(frozen=True, eq=False)
class FramePoseTable(ReadOnlyArrays):
    """The columns of ``poses.csv``, or of ``poses-truth.csv``, which has no sigmas.

    Attributes
    ----------
    frames : tuple of str
    t : (M,)
        s from the epoch.
    position : (M, 3)
        m.
    quat_xyzw : (M, 4)
        world_from_body, scalar last.
    sigma : (M, 6) or None
        m, m, m, rad, rad, rad.
    source : tuple of str
        One of `SOURCES` each; empty in a table of truth.
    """

    frames: tuple[str, ...]
    t: Array
    position: Array
    quat_xyzw: Array
    sigma: Array | None = None
    source: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check sizes and words, and freeze."""
        for name, shape in (("t", ()), ("position", (3,)), ("quat_xyzw", (4,)), ("sigma", (6,))):
            value = getattr(self, name)
            if value is None:
                continue
            array = frozen(value)
            if array.shape != (len(self.frames), *shape):
                raise InputError(
                    f"`{name}` must have a row per frame ({len(self.frames)}), got {array.shape}"
                )
            object.__setattr__(self, name, array)
        unknown = sorted(set(self.source) - set(SOURCES))
        if unknown or (self.source and len(self.source) != len(self.frames)):
            raise InputError(f"`source` must be one of {', '.join(SOURCES)} per frame, got {unknown}")

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def world_from_body(self) -> Rotation:
        """M rotations."""
        return Rotation.from_quat(self.quat_xyzw)


def write_poses(path: Path, poses: FramePoseTable) -> None:
    """``poses.csv``, or without sigmas ``poses-truth.csv``, with full precision of the poses."""
    values = [np.array(poses.frames, dtype=str), poses.t, *poses.position.T, *poses.quat_xyzw.T]
    names: tuple[str, ...] = TRUTH
    if poses.sigma is not None:
        values += [*poses.sigma.T, np.array(poses.source, dtype=str)]
        names = POSES
    write_columns(path, dict(zip(names, values, strict=True)), dict.fromkeys(TRUTH[1:], "%.17g"))


@reads("a table of poses")
def read_pose_table(path: Path) -> FramePoseTable:
    """``poses.csv``: FormatError names file, row and column; an infinite sigma is allowed."""
    table = read_columns(path, POSES, text=("frame", "source"), infinite=SIGMAS)
    source = tuple(str(word) for word in table["source"])
    odd = [k for k, word in enumerate(source) if word not in SOURCES]
    if odd:
        raise FormatError(
            f"{path}: row {odd[0] + 1}: source = {source[odd[0]]!r} is not known; allowed: "
            f"{', '.join(SOURCES)}"
        )
    sigma = _matrix(table, SIGMAS)
    if (sigma < 0.0).any():
        raise FormatError(f"{path}: row {int(np.argwhere(sigma < 0.0)[0, 0]) + 1} has a negative sigma")
    return FramePoseTable(*_pose_columns(path, table), sigma, source)


@reads("a table of poses")
def read_pose_truth(path: Path) -> FramePoseTable:
    """``poses-truth.csv``."""
    return FramePoseTable(*_pose_columns(path, read_columns(path, TRUTH, text=("frame",))))


def _pose_columns(
    path: Path, table: dict[str, list[str] | Array]
) -> tuple[tuple[str, ...], Array, Array, Array]:
    frames = tuple(str(word) for word in table["frame"])
    refuse_repeated(path, frames)
    quat = check_quaternions(path, _matrix(table, TRUTH[5:]))
    return frames, _matrix(table, ("t",))[:, 0], _matrix(table, TRUTH[2:5]), quat


def _matrix(table: dict[str, list[str] | Array], names: Sequence[str]) -> Array:
    return np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])


@dataclass(frozen=True, eq=False)
class FocalLength(ReadOnlyArrays):
    """A focal length that was found with the poses.

    Attributes
    ----------
    px : float
    covariance : (7,)
        With the six constant errors of the tables (px m, px rad), and its own variance (px^2).
    """

    px: float
    covariance: Array


@dataclass(frozen=True, eq=False)
class PoseCovariance(ReadOnlyArrays):
    """``covariance.npz``.

    Attributes
    ----------
    frames : tuple of str
    covariance : (M, 6, 6)
        Of position (m, world axes) and angles (rad, body axes).
    datum : (6,)
        Constant errors found of the tables: of positions (m), of attitudes (rad).
    datum_covariance : (6, 6)
    focal_length : FocalLength or None
        Where it was found with the poses.
    next_covariance : (M - 1, 6, 6)
        Of each frame but the first (rows) with the one before it (columns); NaN where it is not known.
    pair_covariance : (M, 6, M, 6) or None
        Of all frames with each other; None of flights of many frames.
    scale_sigma : float
        Relative 1-sigma of the size of the flight as a whole; NaN where it is not known.
    """

    frames: tuple[str, ...]
    covariance: Array
    datum: Array
    datum_covariance: Array
    focal_length: FocalLength | None
    next_covariance: Array
    pair_covariance: Array | None
    scale_sigma: float


def write_pose_covariance(path: Path, given: PoseCovariance) -> None:
    """``covariance.npz``, complete or not at all."""
    focal, more = given.focal_length, dict[str, Any]()
    if focal is not None:
        more = {"focal_length_px": focal.px, "focal_length_covariance": focal.covariance}
    if given.pair_covariance is not None:
        more["pair_covariance"] = given.pair_covariance
    with whole(path) as draft:
        np.savez_compressed(
            draft,
            frame=np.array(given.frames, dtype=str),
            covariance=given.covariance,
            datum=given.datum,
            datum_covariance=given.datum_covariance,
            next_covariance=given.next_covariance,
            scale_sigma=given.scale_sigma,
            **more,
        )


def read_pose_covariance(path: Path) -> PoseCovariance:
    """``covariance.npz``; FormatError where something is missing or of the wrong shape."""
    what, advice = "covariances of poses", "run `sightline georeference` again"
    file = read_arrays(path, what, advice)
    with foreign_errors(path, f"cannot be read as {what}", advice):
        frames = tuple(str(word) for word in file["frame"])
        count = len(frames)
        given = dict(file)
        # a folder of an earlier version, or of another program, says nothing of frames with one another
        given.setdefault("next_covariance", np.full((max(count - 1, 0), 6, 6), np.nan))
        given.setdefault("scale_sigma", np.array(np.nan))
        names = ("covariance", "datum", "datum_covariance", "next_covariance")
        arrays = [np.asarray(given[k], dtype=np.float64) for k in names]
        scale = float(given["scale_sigma"])
        pairs = None
        if "pair_covariance" in file:
            pairs = frozen(np.asarray(file["pair_covariance"], dtype=np.float64).reshape(count, 6, count, 6))
        focal = None
        if "focal_length_px" in file:
            row = np.asarray(file["focal_length_covariance"], dtype=np.float64)
            focal = FocalLength(float(file["focal_length_px"]), frozen(row.reshape(7)))
    shapes = [array.shape for array in arrays]
    if shapes != [(count, 6, 6), (6,), (6, 6), (max(count - 1, 0), 6, 6)]:
        raise FormatError(f"{path}: arrays of shapes {shapes} for {len(frames)} frames")
    covariance, datum, datum_covariance, following = (frozen(array) for array in arrays)
    variances = [covariance[:, range(6), range(6)].ravel(), datum_covariance.diagonal()]
    if focal is not None:
        variances.append(focal.covariance[6:])
    if (np.concatenate(variances) < 0.0).any() or (focal is not None and not focal.covariance[6] > 0.0):
        raise FormatError(f"{path}: holds a variance that is not above 0; {advice}")
    return PoseCovariance(frames, covariance, datum, datum_covariance, focal, following, pairs, scale)


def pose_axes(world: WorldSection, radii: tuple[float, float] | None) -> tuple[Array, Rotation]:
    """Axes in which ``poses.csv`` is written: origin (3,) m and computation_from_table.

    Those of ``[world]`` where they are Earth-fixed or local; for "lonlat" Earth-fixed ones, m.
    """
    if world.frame == "local" and world.origin is not None:
        lon, lat = np.radians(world.origin[:2])
        return from_geodetic([[lon, lat, world.origin[2]]], radii or WGS84)[0], local_axes(lon, lat)
    return np.zeros(3), Rotation.identity()


def in_table_axes(
    world: WorldSection,
    radii: tuple[float, float] | None,
    position: Array,
    world_from_body: Rotation,
    covariance: Array,
) -> tuple[Array, Rotation, Array]:
    """Poses and their covariance (M, 6, 6) from the axes of computation to those of ``poses.csv``.

    A covariance that is not known (inf on its diagonal, NaN beside it) stays as it is.
    """
    origin, axes = pose_axes(world, radii)
    turn = np.eye(6)
    turn[:3, :3] = axes.as_matrix().T
    moved = np.asarray(axes.inv().apply(position - origin))
    known = np.isfinite(covariance).all(axis=(1, 2))
    turned = np.array(covariance)
    turned[known] = np.einsum("ij,mjk,lk->mil", turn, covariance[known], turn)
    return moved, axes.inv() * world_from_body, turned
