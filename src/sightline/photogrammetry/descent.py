"""Gauss-Newton over a block: poses, points and what is common, with gross errors found on the way.

Steps are taken on exact projections. The normal equations of one state serve the next states too, whose
gradients are exact, and are made anew when they lead no further.

Not here: which unknowns there are (``pose_unknowns.py``), what is made of the result (``bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.bundle_kernels import curvatures, gradients, statistics
from sightline.photogrammetry.observability import Observability, observability
from sightline.photogrammetry.point_priors import PointPriors
from sightline.photogrammetry.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.reduced import LOOSE, Curvature, PointsFirst, PosesFirst, gather, reduce_block
from sightline.photogrammetry.sightings import Sightings
from sightline.photogrammetry.triangulate import triangulate

#: Steps end when the next would lower the cost by less (chi-square units): a millionth of a sigma.
CONVERGED = 1e-10
#: Largest number of steps for one set of weights, and of those with fresh normal equations; of such sets.
STEPS, FRESH, ROUNDS = 60, 30, 12
#: Chance that one good sighting or more of a whole block is called a gross error.
FALSE_ALARM = 0.05
#: Share of sightings up to which gross errors are left out one per point, without weights in between.
_FEW = 1e-3
#: Median of the chi-square distribution with two degrees of freedom.
_MEDIAN_2 = 1.3863
#: Fewest sightings that an adjustment is tried with: three points seen twice.
LEAST = 6
#: Share of the cost that a step must promise for the cost to be looked at, rounding being larger than less.
_ROUNDING = 1e-9
#: Share of the cost below which the promise of a step shows that gross errors can be judged.
_ROUGHLY = 1e-2
#: Share of a residual's variance below which it says nothing (along an epipolar line).
_SEEN = 0.05
BoolArray = NDArray[np.bool_]
Reduction = PosesFirst | PointsFirst


@dataclass(frozen=True, eq=False)
class State:
    """Unknowns of a block."""

    common: Array  # (G,)
    own: Array  # (K, 6 n)
    points: Array  # (n, 3), less the block's origin


class Block:
    """Sums over the sightings of a block at any state."""

    def __init__(self, sightings: Sightings, unknowns: PoseUnknowns, priors: PointPriors | None) -> None:
        self.sightings, self.unknowns, self.priors = sightings, unknowns, priors
        self.origin = sightings.position.mean(axis=0)
        self.position = frozen(sightings.position - self.origin)
        self.image_of_pose = np.zeros(len(sightings.position), dtype=np.intp)
        self.image_of_pose[sightings.pose] = sightings.image
        self.camera_from_body = np.swapaxes(sightings.body_from_camera, 1, 2)[sightings.camera]
        self.scale = frozen(sightings.px_per_tangent / sightings.sigma_px[:, None, None])

    def _arguments(self, state: State) -> tuple[Any, ...]:
        s = self.sightings
        x = self.unknowns.departures(state.own, state.common)
        turned, jacobian = turns(x[:, :3])
        of_pose = (self.camera_from_body @ turned)[self.image_of_pose]
        return (
            state.points, s.image, s.point, s.pose, s.tangents, self.scale, self.position,
            of_pose @ np.swapaxes(s.world_from_body, 1, 2), self.camera_from_body @ jacobian, x,
        )  # fmt: skip

    def gradient(self, state: State, weight: Array) -> tuple[Array, Array, Array, Array, float]:
        """Right-hand sides of shots, points and globals; residuals (N, 2), whitened; cost."""
        by_image = np.zeros((len(self.sightings.camera), self.unknowns.width))
        by_point, r = np.zeros_like(state.points), np.empty((len(self.sightings), 2))
        arguments = (*self._arguments(state), weight, r, by_image, by_point)
        gradients(*arguments)
        own, common = gather(self.unknowns, by_image)
        known = self.unknowns.global_information
        pulled, tied = self.unknowns.prior_slope(state.own)
        cost = float((weight * (r**2).sum(axis=1)).sum() + tied + known @ state.common**2)
        if self.priors is not None:
            pull, _, more = self.priors.at(state.points + self.origin)
            by_point += pull
            cost += more
        return own - pulled, by_point, common - known * state.common, r, cost

    def cost(self, state: State, weight: Array) -> float:
        """Sum of squares at a state; inf where a point lies behind a camera."""
        cost = self.gradient(state, weight)[4]
        return cost if np.isfinite(cost) else np.inf

    def curvature(self, state: State, weight: Array) -> tuple[Curvature, Array]:
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


def seen_twice(sightings: Sightings, priors: PointPriors | None, among: BoolArray | None = None) -> BoolArray:
    """Whether each sighting (N,) is of a point that two of those `among` show, or that is known of."""
    counted = np.ones(len(sightings)) if among is None else among
    count = np.bincount(sightings.point, counted, minlength=sightings.points)
    enough = count >= 2
    if priors is not None:
        enough = enough | priors.known(len(enough))
    seen = enough[sightings.point]
    return np.asarray(seen if among is None else seen & among)


def still_seen(block: Block, weight: Array) -> BoolArray:
    """Which points (n,) are still seen by sightings that count."""
    return np.bincount(block.sightings.point, weight > 0.0, minlength=block.sightings.points) > 0


def first_state(block: Block, usable: BoolArray, start: Array | None) -> tuple[State, BoolArray]:
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
    return State(common, own, points - block.origin), np.asarray(usable & np.take(found, s.point))


def _rays(sightings: Sightings, angles: Array) -> tuple[Array, Array]:
    """Unit directions and origins (N, 3), world axes, of all sightings, the cameras turned by `angles`."""
    s = sightings
    camera = s.camera[s.image]
    rays = np.column_stack([s.tangents, np.ones(len(s))])
    turned = Rotation.from_rotvec(angles).as_matrix() @ s.body_from_camera
    rays = np.einsum("nij,njk,nk->ni", s.world_from_body[s.pose], turned[camera], rays, optimize=True)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), s.position[s.pose]


@dataclass(frozen=True, eq=False)
class Fit:
    """The least cost for some weights.

    Attributes
    ----------
    state : State
    weight : (N,)
        0 at gross errors.
    reduced : PosesFirst or PointsFirst
        Normal equations of a state near by.
    curvature : Curvature
        What they were made of.
    residuals : (N, 2)
        Whitened.
    steps : int
        Taken in all.
    statistic : (N,)
        Squared residual over its expectation.
    checked : (N,) bool
        Whether other sightings could have contradicted this one in both directions.
    scale : float
        Robust size of the residuals relative to the stated ones.
    """

    state: State
    weight: Array
    reduced: Reduction
    curvature: Curvature
    residuals: Array
    steps: int
    statistic: Array
    checked: BoolArray
    scale: float


def descend(
    block: Block, state: State, usable: BoolArray, *, robust: bool, weight: Array | None = None
) -> Fit:
    """The least cost, gross errors found and left out.

    Parameters
    ----------
    block : Block
    state : State
        To start from.
    usable : (N,) bool
        Sightings that may count.
    robust : bool
        Find gross errors.
    weight : (N,), optional
        What was found of them before: 0 where they are.

    Returns
    -------
    Fit

    Raises
    ------
    EstimationError
        If steps do not end.
    """
    # chi-square with two degrees of freedom: exp(-limit / 2) of good ones are larger
    limit = 2.0 * np.log(max(int(usable.sum()), 1) / FALSE_ALARM)
    now = usable.astype(np.float64) if weight is None else np.array(weight)
    softened, fit = weight is not None, None
    if robust and not softened:
        # many gross errors are told long before the fit that they spoil has settled
        rough = _settle(block, state, now, usable, enough=_ROUGHLY)
        state, fit = rough.state, rough
        if int(_gross(rough, usable, limit).sum()) > _FEW * int(usable.sum()):
            state, now = _redescend(block, state, usable, limit)
            softened, fit = True, None
    for _ in range(ROUNDS):
        fit = _settle(block, state, now, usable, known=fit)
        state, gross = fit.state, _gross(fit, usable, limit)
        if not robust or bool((gross == (usable & (now == 0.0))).all()):
            return fit
        if int(gross.sum()) <= _FEW * int(usable.sum()):
            now = (usable & ~_worst(gross, fit.statistic, block.sightings.point)).astype(np.float64)
            continue
        if softened:
            now = (usable & ~gross).astype(np.float64)
        else:
            state, now = _redescend(block, state, usable, limit)
        softened, fit = True, None
    # sightings at the margin come and go: either way they change little
    return _settle(block, state, now, usable)


def _gross(fit: Fit, usable: BoolArray, limit: float) -> BoolArray:
    """Usable sightings (N,) whose residual is beyond chance."""
    return np.asarray(usable & (fit.statistic > limit * max(fit.scale**2, 1.0)))


def _settle(
    block: Block,
    state: State,
    weight: Array,
    usable: BoolArray,
    *,
    known: Fit | None = None,
    enough: float = 0.0,
) -> Fit:
    """Steps until none lowers the cost, or promises more than a share `enough` of it.

    `known`: a fit of other weights near by, whose equations serve first.
    """
    taken, fresh, last = 0 if known is None else known.steps, 0, np.inf
    curvature = None if known is None else known.curvature
    reduced = None if known is None or not known.reduced.reusable else known.reduced
    for steps in range(taken + 1, taken + STEPS + 1):
        if reduced is None or curvature is None:
            curvature, _ = block.curvature(state, weight)
            reduced, fresh, last = reduce_block(curvature, block.unknowns), fresh + 1, np.inf
        directions = observability(reduced.information, block.unknowns.names, block.unknowns.limit)
        step, decrease, r, cost = _step(block, state, weight, reduced, directions)
        if not np.isfinite(decrease) or fresh > FRESH:
            break
        settled = decrease < CONVERGED or (decrease < 1e-6 and decrease > 0.5 * last)
        if not settled and decrease > 0.1 * last:
            reduced = None  # the equations of an earlier state lead no further
            continue
        if not settled and decrease >= enough * cost:
            state, share = _descended(block, state, weight, step, cost, decrease)
            last = decrease
            if share < 1.0 or not reduced.reusable:
                reduced = None
            continue
        if settled:
            state, _ = _descended(block, state, weight, step, cost, decrease)
        statistic, checked = _statistic(replace(curvature, weight=weight), r)
        scale = np.sqrt(_scale(statistic[usable & checked]))
        return Fit(state, weight, reduced, curvature, r, steps, statistic, checked, float(scale))
    raise EstimationError(DIVERGED)


def _worst(gross: BoolArray, statistic: Array, point: NDArray[np.intp]) -> BoolArray:
    """Of the sightings called `gross`, the worst of each point: it may have spoilt the others."""
    rows = np.flatnonzero(gross)
    order = rows[np.lexsort((-statistic[rows], point[rows]))]
    _, first = np.unique(point[order], return_index=True)
    out = np.zeros(len(gross), dtype=bool)
    out[order[first]] = True
    return out


def _step(
    block: Block, state: State, weight: Array, reduced: Reduction, known: Observability
) -> tuple[State, float, Array, float]:
    """One step; how much it should lower the cost; residuals and cost before it."""
    own, by_point, common, r, cost = block.gradient(state, weight)
    step = known.solve(reduced.condense(own, by_point, common))
    own_step, point_step = reduced.solve(own, by_point, common, step)
    decrease = float((own * own_step).sum() + (by_point * point_step).sum() + common @ step)
    return State(step, own_step, point_step), decrease, r, cost


def _descended(
    block: Block, state: State, weight: Array, step: State, cost: float, decrease: float
) -> tuple[State, float]:
    """State after the largest share 1, 1/2, 1/4 ... of a step that does not raise the cost, and the share.

    Steps that promise little are taken whole: their gain is rounding's.
    """
    share = 1.0
    while share > 1e-4:
        tried = State(
            state.common + share * step.common,
            state.own + share * step.own,
            state.points + share * step.points,
        )
        if decrease < _ROUNDING * max(cost, 1.0) or block.cost(tried, weight) <= cost:
            return tried, share
        share *= 0.5
    raise EstimationError(DIVERGED)


def _redescend(block: Block, state: State, usable: BoolArray, limit: float) -> tuple[State, Array]:
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
        known = observability(reduced.information, block.unknowns.names, block.unknowns.limit)
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
