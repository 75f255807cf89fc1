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
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.bundle_kernels import curvatures, gradients, statistics
from sightline.photogrammetry.observability import Observability, marginal, observability
from sightline.photogrammetry.point_priors import PointPriors
from sightline.photogrammetry.pose_noise import PoseNoise
from sightline.photogrammetry.pose_unknowns import PoseUnknowns, pose_unknowns
from sightline.photogrammetry.reduced import LOOSE, Curvature, PointsFirst, PosesFirst, gather, reduce_block
from sightline.photogrammetry.sightings import Sightings, as_index
from sightline.photogrammetry.triangulate import triangulate

#: Steps end when the next would lower the cost by less (chi-square units): a millionth of a sigma.
CONVERGED = 1e-10
#: Largest number of steps, and of those with fresh normal equations.
STEPS, FRESH = 40, 20
#: Chance that one good sighting or more of a whole block is called a gross error.
FALSE_ALARM = 0.05
#: Share of sightings up to which gross errors are left out one per point, without weights in between.
_FEW = 1e-3
#: Median of the chi-square distribution with two degrees of freedom.
_MEDIAN_2 = 1.3863
#: Fewest sightings that an adjustment is tried with: three points seen twice.
_LEAST = 6
#: Share of a residual's variance below which it says nothing (along an epipolar line).
_SEEN = 0.05
BoolArray = NDArray[np.bool_]
Reduction = PosesFirst | PointsFirst


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
    iterations: int
    seconds: float


@dataclass(frozen=True, eq=False)
class _State:
    """Unknowns of a block."""

    common: Array  # (G,)
    own: Array  # (K, 6 n)
    points: Array  # (n, 3), less the block's origin


class _Block:
    """Sums over the sightings of a block at any state."""

    def __init__(self, sightings: Sightings, unknowns: PoseUnknowns, priors: PointPriors | None) -> None:
        self.sightings, self.unknowns, self.priors = sightings, unknowns, priors
        self.origin = sightings.position.mean(axis=0)
        self.position = frozen(sightings.position - self.origin)
        self.image_of_pose = np.zeros(len(sightings.position), dtype=np.intp)
        self.image_of_pose[sightings.pose] = sightings.image
        self.camera_from_body = np.swapaxes(sightings.body_from_camera, 1, 2)[sightings.camera]
        self.scale = frozen(sightings.px_per_tangent / sightings.sigma_px[:, None, None])

    def _arguments(self, state: _State) -> tuple[Any, ...]:
        s = self.sightings
        x = self.unknowns.departures(state.own, state.common)
        turned, jacobian = turns(x[:, :3])
        of_pose = (self.camera_from_body @ turned)[self.image_of_pose]
        return (
            state.points, s.image, s.point, s.pose, s.tangents, self.scale, self.position,
            of_pose @ np.swapaxes(s.world_from_body, 1, 2), self.camera_from_body @ jacobian, x,
        )  # fmt: skip

    def gradient(self, state: _State, weight: Array) -> tuple[Array, Array, Array, Array, float]:
        """Right-hand sides of shots, points and globals; residuals (N, 2), whitened; cost."""
        by_image = np.zeros((len(self.sightings.camera), self.unknowns.width))
        by_point, r = np.zeros_like(state.points), np.empty((len(self.sightings), 2))
        arguments = (*self._arguments(state), weight, r, by_image, by_point)
        gradients(*arguments)
        own, common = gather(self.unknowns, by_image)
        known = self.unknowns.global_information
        pulled = self.unknowns.prior_times(state.own)
        cost = float(
            (weight * (r**2).sum(axis=1)).sum() + (state.own * pulled).sum() + known @ state.common**2
        )
        if self.priors is not None:
            pull, _, more = self.priors.at(state.points + self.origin)
            by_point += pull
            cost += more
        return own - pulled, by_point, common - known * state.common, r, cost

    def cost(self, state: _State, weight: Array) -> float:
        """Sum of squares at a state; inf where a point lies behind a camera."""
        cost = self.gradient(state, weight)[4]
        return cost if np.isfinite(cost) else np.inf

    def curvature(self, state: _State, weight: Array) -> tuple[Curvature, Array]:
        """Second derivatives; whitened residuals."""
        s, width = self.sightings, self.unknowns.width
        of_images = np.zeros((len(s.camera), width, width))
        of_points, r = np.zeros((len(state.points), 3, 3)), np.empty((len(s), 2))
        rows = np.empty((len(s), 2, width + 3))
        arguments = (*self._arguments(state), weight, r, of_images, of_points, rows)
        curvatures(*arguments)
        if self.priors is not None:
            of_points += self.priors.at(state.points + self.origin)[1]
        return Curvature(rows, weight, s.image, s.point, of_images, of_points), r


def turns(angles: Array) -> tuple[Array, Array]:
    """exp(-[w]x) and the right Jacobian of rotation vectors w (M, 3), each (M, 3, 3).

    exp([w + dw]x) = exp([w]x) exp([J dw]x), J = I - (1 - cos a)/a^2 [w]x + (a - sin a)/a^3 [w]x^2.
    """
    a2 = (angles**2).sum(axis=1)
    a = np.sqrt(a2)
    small = a < 1e-2
    safe = np.where(small, 1.0, a)
    first = np.where(small, 0.5 - a2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0 - a2 / 120.0, (safe - np.sin(safe)) / safe**3)
    cross = np.zeros((len(angles), 3, 3))
    x, y, z = angles.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    square = cross @ cross
    jacobian = np.eye(3) - first[:, None, None] * cross + second[:, None, None] * square
    return frozen(Rotation.from_rotvec(-angles).as_matrix()), frozen(jacobian)


def split_by_shot(sightings: Sightings) -> tuple[Sightings, NDArray[np.intp]]:
    """The same sightings with every point of every shot a point of its own, and the point each was (n,)."""
    shot = sightings.shot[sightings.image]
    pairs, point = np.unique(shot.astype(np.int64) * sightings.points + sightings.point, return_inverse=True)
    return replace(sightings, point=as_index(point, "point")), np.asarray(pairs % sightings.points)


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
    point_of = np.arange(sightings.points)
    if new_points_per_shot:
        sightings, point_of = split_by_shot(sightings)
        if priors is not None:
            priors = priors.for_copies(point_of)
    unknowns = pose_unknowns(sightings, noise)
    block = _Block(sightings, unknowns, priors)
    state, usable = _first_state(block, seen_twice(sightings, priors), start)
    if int(usable.sum()) < _LEAST:
        raise InputError(
            f"too few conjugate points: {int(usable.sum())} sightings of points that two images or more show "
            f"from directions that differ; at least {_LEAST} are needed; supply more matches"
        )
    weight = usable.astype(np.float64)
    state, reduced, steps, scale, statistic, checked = _descend(block, state, weight, robust=robust)
    if drift or focal_sigma is not None:
        # weakly seen, these would run away from a start as far off as the planned attitudes are
        unknowns = pose_unknowns(sightings, noise, drift=drift, focal_sigma=focal_sigma)
        block = _Block(sightings, unknowns, priors)
        more = np.zeros(unknowns.globals - len(state.common))
        state = replace(state, common=np.concatenate([state.common, more]))
        weight = usable.astype(np.float64)
        state, reduced, steps, scale, statistic, checked = _descend(block, state, weight, robust=robust)
    used = seen_twice(sightings, priors, weight > 0.0)
    weight = used.astype(np.float64)
    _, _, _, r, cost = block.gradient(state, weight)
    known = observability(reduced.information, unknowns.names)
    seconds = time.perf_counter() - begun
    angles = observability(
        marginal(reduced.information, 3 * sightings.cameras), unknowns.names[: 3 * sightings.cameras]
    )
    common = np.where(known.touched, np.nan, state.common)
    covariance = known.covariance()
    seen = np.where(np.isfinite(covariance), covariance, 0.0)
    points = np.where(_twice(block, weight)[:, None], state.points + block.origin, np.nan)
    free = 3 * int(_twice(block, weight).sum()) + unknowns.globals - int(known.hidden.sum())
    rows = 2 * int(used.sum()) + (0 if priors is None else priors.count)
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
        frozen(statistic),
        ~used,
        checked,
        cost,
        rows - free,
        scale,
        steps,
        seconds,
    )


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
    """What sightings of `points` would tell of the angles: the Cramer-Rao bound at the planned poses.

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
        sightings, point_of = split_by_shot(sightings)
        places = places[point_of]
        priors = None if priors is None else priors.for_copies(point_of)
    unknowns = pose_unknowns(sightings, noise, drift=drift, focal_sigma=focal_sigma)
    block = _Block(sightings, unknowns, priors)
    state = _State(
        np.zeros(unknowns.globals), np.zeros((unknowns.shots, 6 * unknowns.slots)), places - block.origin
    )
    weight = seen_twice(sightings, priors).astype(np.float64)
    curvature, _ = block.curvature(state, weight)
    reduced = reduce_block(curvature, unknowns)
    keep = 3 * sightings.cameras
    return (
        observability(marginal(reduced.information, keep), unknowns.names[:keep]),
        observability(reduced.information, unknowns.names),
    )


def seen_twice(sightings: Sightings, priors: PointPriors | None, among: BoolArray | None = None) -> BoolArray:
    """Whether each sighting (N,) is of a point that two of those `among` show, or that is known of."""
    counted = np.ones(len(sightings)) if among is None else among
    count = np.bincount(sightings.point, counted, minlength=sightings.points)
    enough = count >= 2
    if priors is not None:
        enough = enough | priors.known(len(enough))
    seen = enough[sightings.point]
    return np.asarray(seen if among is None else seen & among)


def _twice(block: _Block, weight: Array) -> BoolArray:
    """Which points (n,) are still seen by sightings that count."""
    return np.bincount(block.sightings.point, weight > 0.0, minlength=block.sightings.points) > 0


def _first_state(block: _Block, usable: BoolArray, start: Array | None) -> tuple[_State, BoolArray]:
    """Planned poses, angles of `start`, points where their rays meet; and which sightings are then usable."""
    unknowns, s = block.unknowns, block.sightings
    angles = np.zeros((s.cameras, 3)) if start is None else np.nan_to_num(start)
    common = np.zeros(unknowns.globals)
    common[: 3 * s.cameras] = np.ravel(angles)
    points = np.array(triangulate(s, angles, used=usable).position)
    if block.priors is not None:
        points = block.priors.start(points, *_rays(s, angles), s.point)
    found = np.isfinite(points).all(axis=1)
    points[np.flatnonzero(~found)] = block.origin
    own = np.zeros((unknowns.shots, 6 * unknowns.slots))
    return _State(common, own, points - block.origin), np.asarray(usable & np.take(found, s.point))


def _rays(sightings: Sightings, angles: Array) -> tuple[Array, Array]:
    """Unit directions and origins (N, 3), world axes, of all sightings, the cameras turned by `angles`."""
    s = sightings
    camera = s.camera[s.image]
    rays = np.column_stack([s.tangents, np.ones(len(s))])
    turned = Rotation.from_rotvec(angles).as_matrix() @ s.body_from_camera
    rays = np.einsum("nij,njk,nk->ni", s.world_from_body[s.pose], turned[camera], rays, optimize=True)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), s.position[s.pose]


def _descend(
    block: _Block, state: _State, weight: Array, *, robust: bool
) -> tuple[_State, Reduction, int, float, Array, BoolArray]:
    """Steps to the least cost; `weight` becomes 0 at gross errors (and stays so)."""
    usable = weight > 0.0
    # chi-square with two degrees of freedom: exp(-limit / 2) of good ones are larger
    limit = 2.0 * np.log(max(int(usable.sum()), 1) / FALSE_ALARM)
    reduced, steps, fresh, last, new = None, 0, 0, np.inf, True
    softened = False
    while True:
        if new or reduced is None:
            curvature, r = block.curvature(state, weight)
            reduced = reduce_block(curvature, block.unknowns)
            known = observability(reduced.information, block.unknowns.names)
            fresh, new, last = fresh + 1, False, np.inf
        step, decrease, r, cost = _step(block, state, weight, reduced, known)
        steps += 1
        if not np.isfinite(decrease) or fresh > FRESH or steps > STEPS:
            raise EstimationError(DIVERGED)
        settled = decrease < CONVERGED or (decrease < 1e-6 and decrease > 0.5 * last)
        if not settled and decrease > 0.1 * last:
            new = True  # the equations of an earlier state lead no further
            continue
        state, share = _descended(block, state, weight, step, cost, decrease)
        new = not settled and (share < 1.0 or not reduced.reusable)
        last = decrease
        if not settled:
            continue
        statistic, checked = _statistic(replace(curvature, weight=weight), r)
        scale = _scale(statistic[usable & checked])
        gross = usable & (statistic > limit * max(scale, 1.0))
        if not robust or bool((gross == (usable & (weight == 0.0))).all()):
            return state, reduced, steps, float(np.sqrt(scale)), statistic, checked
        if int(gross.sum()) <= _FEW * int(usable.sum()):
            weight[:] = usable & ~_worst(gross, statistic, block.sightings.point)
            last = np.inf
            continue
        if softened:
            weight[:] = usable & ~gross
        else:
            state, weight[:] = _redescend(block, state, usable, limit)
        softened, new = True, True


def _worst(gross: BoolArray, statistic: Array, point: NDArray[np.intp]) -> BoolArray:
    """Of the sightings called `gross`, the worst of each point: it may have spoilt the others."""
    rows = np.flatnonzero(gross)
    order = rows[np.lexsort((-statistic[rows], point[rows]))]
    _, first = np.unique(point[order], return_index=True)
    out = np.zeros(len(gross), dtype=bool)
    out[order[first]] = True
    return out


def _step(
    block: _Block, state: _State, weight: Array, reduced: Reduction, known: Observability
) -> tuple[_State, float, Array, float]:
    """One step; how much it should lower the cost; residuals and cost before it."""
    own, by_point, common, r, cost = block.gradient(state, weight)
    step = known.solve(reduced.condense(own, by_point, common))
    own_step, point_step = reduced.solve(own, by_point, common, step)
    decrease = float((own * own_step).sum() + (by_point * point_step).sum() + common @ step)
    return _State(step, own_step, point_step), decrease, r, cost


def _descended(
    block: _Block, state: _State, weight: Array, step: _State, cost: float, decrease: float
) -> tuple[_State, float]:
    """State after the largest share 1, 1/2, 1/4 ... of a step that does not raise the cost, and the share.

    Steps that promise little are taken whole: their gain is rounding's.
    """
    share = 1.0
    while share > 1e-4:
        tried = _State(
            state.common + share * step.common,
            state.own + share * step.own,
            state.points + share * step.points,
        )
        if decrease < 1e-3 * max(cost, 1.0) or block.cost(tried, weight) <= cost:
            return tried, share
        share *= 0.5
    raise EstimationError(DIVERGED)


def _redescend(block: _Block, state: _State, usable: BoolArray, limit: float) -> tuple[_State, Array]:
    """State and 0/1 weights after steps with weights that fall with the residual (Geman-McClure)."""
    soft = usable.astype(np.float64)
    previous = np.inf
    for _ in range(12):
        # leverage as of full weights: a point that only gross errors see would else seem to explain them
        curvature, r = block.curvature(state, usable.astype(np.float64))
        statistic, checked = _statistic(curvature, r)
        scale = max(_scale(statistic[usable & checked]), 1.0)
        soft = np.where(usable, (1.0 + statistic / (9.0 * scale)) ** -2, 0.0)
        if scale > 0.9 * previous:
            break
        previous = scale
        curvature, _ = block.curvature(state, soft)
        reduced = reduce_block(curvature, block.unknowns)
        known = observability(reduced.information, block.unknowns.names)
        step, decrease, _, cost = _step(block, state, soft, reduced, known)
        state, _ = _descended(block, state, soft, step, cost, decrease)
    return state, (usable & (statistic <= limit * scale)).astype(np.float64)


def _statistic(curvature: Curvature, r: Array) -> tuple[Array, BoolArray]:
    """Squared residual over its expectation (N,), and whether both its directions are checked by others.

    Sightings of a point of which fewer than two are left are judged by each other, as if none had been left
    out: one alone can be met exactly, wherever it is.
    """
    c = curvature
    idle = np.bincount(c.point, c.weight > 0.0, minlength=len(c.of_points))[c.point] < 2
    of_points = np.array(c.of_points) + LOOSE * np.eye(3)
    by_point = c.rows[idle, :, c.rows.shape[2] - 3 :]
    np.add.at(of_points, c.point[idle], np.einsum("nka,nkb->nab", by_point, by_point))
    inverse: Array = np.asarray(np.linalg.inv(of_points), dtype=np.float64)
    out, checked = np.empty(len(r)), np.empty(len(r))
    statistics(c.rows, np.where(idle, 1.0, c.weight), c.point, inverse, r, _SEEN, out, checked)
    return out, checked > 0.0


def _scale(statistic: Array) -> float:
    """Robust variance of residuals relative to what was stated, from chi-squares (N,) of two degrees."""
    return float(np.median(statistic)) / _MEDIAN_2 if len(statistic) else 1.0


DIVERGED = (
    "the adjustment does not converge: the matches do not belong to the planned poses, or these are off by "
    "far more than [noise] says; check the camera numbers of the matches, (line, column) order, focal "
    "length, mount and quaternions (scalar last)"
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
