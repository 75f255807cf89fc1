"""Poses of many frames of one flight: rough tables, points seen in frame after frame, and a smooth path.

Every frame is free. Tables of positions and attitudes hold it where they are, each with a constant bias of
its own; between neighbours the path is as smooth as it was found to be. One banded solution gives all frames
with the covariance of each, those that no image evidence reaches too.

Not here: finding the points (``applications/``), constant errors of calibrated cameras (``bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.descent import Block, Fit, descend, first_state, seen_twice
from sightline.photogrammetry.point_priors import PointPriors
from sightline.photogrammetry.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.reduced import PointsFirst
from sightline.photogrammetry.sightings import Images, Sightings, as_index

#: rad, m: units of the unknowns; any of the size of the corrections keeps numbers near one.
_UNITS = np.array([1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1])
#: Roughness (unit^2 / s^3 in `_UNITS`) with which the first solution starts: hardly any smoothness.
_LOOSE_ROUGHNESS = 1e8
#: Rounds in which the roughness of the path is measured anew.
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class RoughPoses(ReadOnlyArrays):
    """What tables say of the frames' poses, apart from the poses themselves (those of `Images`).

    Attributes
    ----------
    position : (M, 3)
        m, 1-sigma per world axis of each position; inf where the table has none.
    attitude : (M, 3)
        rad, 1-sigma per body axis; inf where the table has none.
    position_bias : float
        m, 1-sigma per axis of a constant error of all positions; 0 where there is none.
    attitude_bias : float
        rad, 1-sigma per axis of a constant error of all attitudes, body axes; 0 where there is none.
    """

    position: Array
    attitude: Array
    position_bias: float = 0.0
    attitude_bias: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name in ("position", "attitude"):
            value = frozen(getattr(self, name))
            if value.ndim != 2 or value.shape[1] != 3 or not (value > 0.0).all():
                raise InputError(f"`{name}` must be positive sigmas of shape (M, 3), got {value.shape}")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class FramePoses(ReadOnlyArrays):
    """Adjusted poses of all frames.

    Attributes
    ----------
    position : (M, 3)
        m, world axes.
    world_from_body : Rotation
        M rotations.
    covariance : (M, 6, 6)
        Of position (m, world axes) and angles (rad, body axes), in that order: of the absolute pose, the
        uncertainty of the biases in it.
    bias : (6,)
        Constant errors found of the tables: of positions (m), of attitudes (rad): table less truth.
    bias_covariance : (6, 6)
    points : (n, 3)
        m, world axes; NaN where seen less than twice.
    residual_px : (N, 2)
        px, measured less predicted.
    rejected : (N,) bool
    sightings : (M,) int
        How many good ones each frame has.
    roughness : (6,)
        Of the path: spectral density of the acceleration of (turn, move), rad^2/s^3 and m^2/s^3.
    scale : float
        Robust size of residuals over the stated one.
    """

    position: Array
    world_from_body: Rotation
    covariance: Array
    bias: Array
    bias_covariance: Array
    points: Array
    residual_px: Array
    rejected: NDArray[np.bool_]
    sightings: NDArray[np.intp]
    roughness: Array
    scale: float


def path_precision(t: Array, roughness: Array) -> Array:
    """Prior precision (M, 3, 6, 6) that ties each frame to the two before it.

    Parameters
    ----------
    t : (M,)
        s, increasing, three or more.
    roughness : (6,)
        Spectral density of the second derivative of each unknown, unit^2 / s^3.

    Returns
    -------
    (M, 3, 6, 6)
        As `PoseUnknowns.precision`. Straight and even motion costs nothing.

    Notes
    -----
    With white acceleration the bend (x3 - x2)/h2 - (x2 - x1)/h1 has variance roughness (h1 + h2)/3; that
    neighbouring bends go together is left out.
    """
    count = len(t)
    out = np.zeros((count, 3, 6, 6))
    h = np.diff(t)
    first, last = 1.0 / h[:-1], 1.0 / h[1:]
    row = np.stack([first, -(first + last), last], axis=1)
    at = np.arange(2, count)
    axis = np.arange(6)
    strength = 3.0 / ((h[:-1] + h[1:])[:, None] * roughness)
    for i in range(3):
        for j in range(i + 1):
            out[(at - 2 + i)[:, None], i - j, axis, axis] += (row[:, i] * row[:, j])[:, None] * strength
    return out


def frame_unknowns(images: Images, known: RoughPoses, roughness: Array) -> PoseUnknowns:
    """Unknowns of a flight: every frame free, held by tables, biases and the smoothness of the path.

    Parameters
    ----------
    images : Images
        One camera, in order of time.
    known : RoughPoses
    roughness : (6,)
        Of (turn, move), rad^2/s^3 and m^2/s^3.

    Returns
    -------
    PoseUnknowns
        Globals: what biases of the tables make of the poses, ``turn_1`` ..., ``move_1`` ...
    """
    count = len(images)
    precision = path_precision(images.t, roughness / _UNITS**2) if count > 2 else np.zeros((count, 3, 6, 6))
    sigma = np.concatenate([known.attitude, known.position], axis=1) / _UNITS
    axis = np.arange(6)
    precision[:, 0, axis, axis] += sigma**-2.0
    parts, names, information = [], [], []
    for first, bias, name in ((0, known.attitude_bias, "turn"), (3, known.position_bias, "move")):
        if bias > 0.0:
            part = np.zeros((count, 6, 3))
            part[:, first + np.arange(3), np.arange(3)] = 1.0
            parts.append(part)
            names += [f"{name}_{k + 1}" for k in range(3)]
            information += [bias**-2.0] * 3
    by_global = np.concatenate([np.zeros((count, 6, 0)), *parts], axis=2)
    half = 0.5 * float(np.ptp(images.t))
    return PoseUnknowns(
        as_index(np.arange(count), "shot"),
        as_index(np.zeros(count), "slot"),
        frozen(np.broadcast_to(np.diag(_UNITS), (count, 6, 6))),
        frozen(by_global),
        frozen(np.array(information)),
        tuple(names),
        (float(images.t[0]) + half, half),
        frozen(precision),
        np.inf,  # each has a prior
    )


def adjust_frames(
    images: Images,
    sightings: Sightings,
    known: RoughPoses,
    *,
    priors: PointPriors | None = None,
    points: Array | None = None,
    roughness: Array | None = None,
    robust: bool = True,
) -> FramePoses:
    """Poses of all frames, and the points, in one banded adjustment.

    Parameters
    ----------
    images : Images
        Rough poses of one camera, in order of time; where tables have none, any guess.
    sightings : Sightings
        Of these images.
    known : RoughPoses
        How rough they are.
    priors : PointPriors, optional
        Known heights, control points.
    points : (n, 3), optional
        m; where to start from. Where the rays of the rough poses meet, otherwise.
    roughness : (6,), optional
        Of the path; measured on the solution otherwise.
    robust : bool
        Find gross errors and leave them out.

    Returns
    -------
    FramePoses
    """
    measured = roughness is None
    rough = np.full(6, _LOOSE_ROUGHNESS) * _UNITS**2 if roughness is None else np.asarray(roughness)
    unknowns = frame_unknowns(images, known, rough)
    block = Block(sightings, unknowns, priors)
    state, usable = first_state(block, seen_twice(sightings, priors), None)
    if points is not None:
        given = np.asarray(np.isfinite(points).all(axis=1))
        state.points[given] = points[given] - block.origin
        usable = usable | (given[sightings.point] & seen_twice(sightings, priors))
    fit = descend(block, state, usable, robust=robust)
    for _ in range(_ROUNDS if measured and len(images) > 2 else 0):
        rough = _roughness(images.t, fit.state.own * _UNITS, _count(sightings, fit.weight, images))
        unknowns = replace(unknowns, precision=frame_unknowns(images, known, rough).precision)
        block = Block(sightings, unknowns, priors)
        fit = descend(block, fit.state, usable, robust=robust, weight=fit.weight)
    return _poses(images, block, fit, rough, known)


def _count(sightings: Sightings, weight: Array, images: Images) -> Array:
    """Sightings (M,) that count of each frame."""
    return np.asarray(np.bincount(sightings.image, weight, minlength=len(images)), dtype=np.float64)


def _roughness(t: Array, departures: Array, seen: Array) -> Array:
    """Roughness (6,) of a path by its bends where three frames in a row are well seen (all, if none are)."""
    h = np.diff(t)[:, None]
    slope = np.diff(departures, axis=0) / h
    bend = np.diff(slope, axis=0) ** 2 * 3.0 / (h[:-1] + h[1:])
    good = (seen >= 4)[:-2] & (seen >= 4)[1:-1] & (seen >= 4)[2:]
    used = bend[good] if good.any() else bend
    return np.maximum(used.mean(axis=0), 1e-12 * _UNITS**2)


def _poses(images: Images, block: Block, fit: Fit, roughness: Array, known: RoughPoses) -> FramePoses:
    """A solution as poses with covariance."""
    unknowns, sightings, state, reduced = block.unknowns, block.sightings, fit.state, fit.equations.reduced
    assert isinstance(reduced, PointsFirst)  # frames are tied to their neighbours
    common = fit.equations.known.covariance()
    x = unknowns.departures(state.own, state.common)
    order = [3, 4, 5, 0, 1, 2]
    covariance = reduced.departure_covariance(common)[:, order][:, :, order]
    bias, bias_covariance = np.zeros(6), np.zeros((6, 6))
    places = [k for k, on in ((3, known.attitude_bias > 0.0), (0, known.position_bias > 0.0)) if on]
    rows = np.concatenate([np.arange(p, p + 3) for p in places]) if places else np.zeros(0, dtype=np.intp)
    bias[rows] = -state.common
    bias_covariance[np.ix_(rows, rows)] = common
    used = seen_twice(sightings, block.priors, fit.weight > 0.0)
    r = block.gradient(state, used.astype(np.float64))[3]
    kept = np.bincount(sightings.point, used, minlength=sightings.points) > 0
    return FramePoses(
        frozen(images.position + x[:, 3:6]),
        images.world_from_body * Rotation.from_rotvec(x[:, :3]),
        frozen(covariance),
        frozen(bias),
        frozen(bias_covariance),
        frozen(np.where(kept[:, None], state.points + block.origin, np.nan)),
        frozen(r * sightings.sigma_px[:, None]),
        ~used,
        np.bincount(sightings.image, used, minlength=len(images)).astype(np.intp),
        frozen(roughness),
        fit.scale,
    )
