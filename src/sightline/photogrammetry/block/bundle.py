"""Maximum likelihood orientation: constant angles, per-shot errors and points in one adjustment.

Angles of the cameras are free (or drift, with focal lengths free too); what differs from shot to shot has a
known covariance; points are free, or near a surface, or known. Gauss-Newton on exact projections, with the
normal equations reduced to the angles; gross errors are found by a redescending weight and left out.

Not here: the reduction (``reduced.py``), what it means in words (``applications/stereo_orientation.py``).
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.block.descent import (
    LEAST,
    BlockSums,
    BoolArray,
    Fit,
    State,
    descend,
    first_state,
    seen_twice,
    still_seen,
    together,
)
from sightline.photogrammetry.block.linked_frames import reduce_block
from sightline.photogrammetry.block.observability import Observability, marginal, observability
from sightline.photogrammetry.block.point_priors import PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.block.pose_unknowns import PoseUnknowns, pose_unknowns
from sightline.photogrammetry.sightings import Sightings, as_index


@dataclass(frozen=True, eq=False)
class Adjustment(ReadOnlyArrays):
    """What was adjusted, and how well it is known.

    Attributes
    ----------
    angles : (C, 3)
        rad; roll, pitch, yaw of each camera's constant error, body axes; NaN where not observable.
    covariance : (3 C, 3 C)
        rad^2, in that order; inf and NaN where not observable.
    observability : Observability
        Principal directions of the 3 C angles.
    unknowns : Observability
        Of all global unknowns: angles, drifts (rad per half the span of time), stretches of focal lengths.
    common : (G,)
        Values of all global unknowns.
    global_covariance : (G, G)
    time : (float, float)
        s: middle of the times, and half their span.
    points : (n, 3)
        m, world axes; NaN where seen less than twice. For ml-pair one per point and shot.
    point_covariance : (n, 3, 3) or None
        m^2, None where points were eliminated first.
    point_of : (n,) int
        Point of the sightings that each row of `points` belongs to.
    departures : (M, 6 or 7)
        Of each image from its plan: turn (rad, body axes), move (m, world axes), all errors together.
    residual_px : (N, 2)
        px, measured less predicted (line, column).
    statistic : (N,)
        Squared residual over its expectation, chi-square with two degrees of freedom or fewer.
    rejected : (N,) bool
        Gross errors, and sightings of points seen in one image only.
    checked : (N,) bool
        Whether other sightings could have contradicted this one in both directions.
    cost : float
        Sum of squared whitened residuals, priors included.
    degrees_of_freedom : int
    scale : float
        Robust size of the residuals relative to the stated ones (1 when these are true).
    pose_scale, pose_freedom : float
        Size of the poses' own errors relative to the stated ones (1 when these are true), and how many of
        them the sightings tell: its sigma is 1 / sqrt(2 pose_freedom).
    iterations : int
    seconds : float
        s, to the angles and their covariance.
    """

    angles: Array
    covariance: Array
    observability: Observability
    unknowns: Observability
    common: Array
    global_covariance: Array
    time: tuple[float, float]
    points: Array
    point_covariance: Array | None
    point_of: NDArray[np.intp]
    departures: Array
    residual_px: Array
    statistic: Array
    rejected: BoolArray
    checked: BoolArray
    cost: float
    degrees_of_freedom: int
    scale: float
    pose_scale: float
    pose_freedom: float
    iterations: int
    seconds: float


def split_by_shot(
    sightings: Sightings, priors: PointPriors | None
) -> tuple[Sightings, NDArray[np.intp], PointPriors | None]:
    """The same with every point of every shot a point of its own, and the point each was (n,)."""
    shot = sightings.shot[sightings.image]
    pairs, point = np.unique(shot.astype(np.int64) * sightings.points + sightings.point, return_inverse=True)
    was = np.asarray(pairs % sightings.points)
    known = None if priors is None else priors.for_copies(was)
    return replace(sightings, point=as_index(point, "point")), was, known


def adjust(
    sightings: Sightings,
    noise: PoseNoise,
    *,
    priors: PointPriors | None = None,
    new_points_per_shot: bool = False,
    drift: bool = False,
    focal_sigma: tuple[float, ...] | None = None,
    robust: bool = True,
    start: Array | None = None,
    suspect: NDArray[np.bool_] | None = None,
) -> Adjustment:
    """Constant angles of all cameras, the errors of each shot, and the points, by maximum likelihood.

    Parameters
    ----------
    sightings : Sightings
    noise : PoseNoise
        What is not known of each pose beyond the constant angles.
    priors : PointPriors, optional
        What is known of points beforehand.
    new_points_per_shot : bool
        ml-pair: a point is new in every shot, so that only what is seen at one instant ties the cameras.
    drift : bool
        Angles drift evenly with time, about their values in the middle.
    focal_sigma : tuple of float, optional
        Per camera, 1-sigma of the relative error of the focal length: 0 keeps it, inf leaves it free.
    robust : bool
        Find gross errors and leave them out.
    start : (C, 3), optional
        rad; where to start from; zero otherwise.
    suspect : (N,) bool, optional
        With `robust`: sightings that look like gross errors by that start; they are judged again.

    Returns
    -------
    Adjustment

    Raises
    ------
    InputError
        Too few sightings.
    EstimationError
        The equations are singular beyond the angles, or do not converge.
    """
    begun = time.perf_counter()
    point_of: NDArray[np.intp] = np.arange(sightings.points)
    if new_points_per_shot:
        sightings, point_of, priors = split_by_shot(sightings, priors)
    unknowns = pose_unknowns(sightings, noise)
    block = BlockSums(sightings, unknowns, priors)
    state, usable = first_state(block, seen_twice(sightings, priors), start)
    if int(usable.sum()) < LEAST:
        raise InputError(
            f"too few conjugate points: {int(usable.sum())} sightings of points that two images or more show "
            f"from directions that differ; at least {LEAST} are needed; supply more matches"
        )
    weight = None
    if robust and suspect is not None:
        weight = together(block, usable & ~suspect)
    fit = descend(block, state, usable, robust=robust, weight=weight)
    if drift or focal_sigma is not None:
        # weakly seen, these would run away from a start as far off as the planned attitudes are
        unknowns = pose_unknowns(sightings, noise, drift=drift, focal_sigma=focal_sigma)
        block = BlockSums(sightings, unknowns, priors)
        more = np.zeros(unknowns.globals - len(fit.state.common))
        state = replace(fit.state, common=np.concatenate([fit.state.common, more]))
        fit = descend(block, state, usable, robust=robust, weight=fit.weight)
    state, reduced, known = fit.state, fit.equations.reduced, fit.equations.known
    weight = together(block, fit.weight > 0.0)
    used = weight > 0.0
    _, _, _, r, cost = block.gradient(state, weight)
    seconds = time.perf_counter() - begun
    angles = observability(
        marginal(reduced.information, 3 * sightings.cameras), unknowns.names[: 3 * sightings.cameras]
    )
    common = np.where(known.touched, np.nan, state.common)
    covariance = known.covariance()
    seen = np.where(np.isfinite(covariance), covariance, 0.0)
    kept = still_seen(block, weight)
    points = np.where(kept[:, None], state.points + block.origin, np.nan)
    count = int(kept.sum())
    free = 3 * count + unknowns.globals - int(known.hidden.sum())
    rows = 2 * int(used.sum()) + (0 if priors is None else priors.count(count))
    return Adjustment(
        frozen(common[: 3 * sightings.cameras].reshape(-1, 3)),
        frozen(angles.covariance()),
        angles,
        known,
        frozen(common),
        frozen(covariance),
        unknowns.time,
        frozen(points),
        reduced.point_covariance(seen),
        point_of,
        frozen(unknowns.departures(state.own, state.common)),
        frozen(r * sightings.sigma_px[:, None]),
        frozen(fit.statistic),
        ~used,
        fit.checked,
        cost,
        rows - free,
        fit.scale,
        *_pose_scale(fit, unknowns),
        fit.steps,
        seconds,
    )


def _pose_scale(fit: Fit, unknowns: PoseUnknowns) -> tuple[float, float]:
    """Size of the shots' own unknowns over what they were to have, and how many of them are observable.

    Of each, the share that sightings determine is one less its variance afterwards; the sum of variances by
    random signs (M. F. Hutchinson, 1990), some per cent of it in error.
    """
    rng = np.random.default_rng(0)
    left, probes = 0.0, 4
    reduced, known = fit.equations.reduced, fit.equations.known
    points, none = np.zeros_like(fit.state.points), np.zeros(unknowns.globals)
    for _ in range(probes):
        signs = rng.choice([-1.0, 1.0], fit.state.own.shape)
        step = known.solve(reduced.condense(signs, points, none))
        left += float((signs * reduced.solve(signs, points, none, step)[0]).sum()) / probes
    observed = fit.state.own.size - left
    size = float((fit.state.own**2).sum())
    return (float(np.sqrt(size / observed)), observed) if observed > 1.0 else (1.0, 0.0)


def bound(
    sightings: Sightings,
    noise: PoseNoise,
    points: Array,
    *,
    priors: PointPriors | None = None,
    new_points_per_shot: bool = False,
    drift: bool = False,
    focal_sigma: tuple[float, ...] | None = None,
) -> tuple[Observability, Observability]:
    """What sightings of `points` would know of the angles: the Cramer-Rao bound at the planned poses.

    Parameters
    ----------
    sightings : Sightings
        Their tangents are not looked at.
    noise, priors, new_points_per_shot, drift, focal_sigma
        As for `adjust`.
    points : (n, 3)
        m, world axes; where the points are.

    Returns
    -------
    angles, all : Observability
        Of the 3 C constant angles, and of all global unknowns.
    """
    places = np.asarray(points, dtype=np.float64)
    if new_points_per_shot:
        sightings, point_of, priors = split_by_shot(sightings, priors)
        places = places[point_of]
    unknowns = pose_unknowns(sightings, noise, drift=drift, focal_sigma=focal_sigma)
    block = BlockSums(sightings, unknowns, priors)
    state = State(np.zeros(unknowns.globals), np.zeros((unknowns.shots, unknowns.own)), places - block.origin)
    weight = seen_twice(sightings, priors).astype(np.float64)
    curvature, _ = block.curvature(state, weight)
    reduced = reduce_block(curvature, unknowns)
    keep = 3 * sightings.cameras
    return (
        observability(marginal(reduced.information, keep), unknowns.names[:keep]),
        observability(reduced.information, unknowns.names),
    )


@functools.cache
def load_kernels() -> None:
    """Load the compiled code of an adjustment, so that it is in nobody's time: a tiny block is adjusted."""
    shots, points = 4, 12
    rng = np.random.default_rng(0)
    camera, shot = np.repeat([0, 1], shots), np.tile(np.arange(shots), 2)
    position = np.column_stack([1e4 * (2 * camera - 1) + 2e3 * shot, 0.0 * shot, np.full(2 * shots, 5e4)])
    level = np.diag([1.0, -1.0, -1.0])
    seen = rng.uniform(-2e3, 2e3, (points, 3)) - position[:, None]
    q = seen @ level
    count = 2 * shots * points
    sightings = Sightings(
        as_index(camera, "camera"),
        as_index(shot, "shot"),
        frozen(shot.astype(np.float64)),
        as_index(np.repeat(np.arange(2 * shots), points), "image"),
        as_index(np.tile(np.arange(points), 2 * shots), "point"),
        as_index(np.repeat(np.arange(2 * shots), points), "pose"),
        frozen((q[..., :2] / q[..., 2:]).reshape(-1, 2)),
        frozen(np.broadcast_to(1e3 * np.eye(2), (count, 2, 2))),
        frozen(np.ones(count)),
        frozen(position),
        frozen(np.broadcast_to(level, (2 * shots, 3, 3))),
        frozen(np.stack([np.eye(3)] * 2)),
    )
    noise = PoseNoise(1.0, 1e-5)
    for pairs in (False, True):
        adjust(sightings, noise, new_points_per_shot=pairs)
