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

from sightline.compiled import only_read
from sightline.errors import EstimationError
from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.block.bundle_kernels import curvatures, gradients, statistics
from sightline.photogrammetry.block.linked_frames import LinkedFrames, reduce_block
from sightline.photogrammetry.block.observability import Observability, observability
from sightline.photogrammetry.block.point_priors import PointPriors
from sightline.photogrammetry.block.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.block.reduced import (
    Curvature,
    PointsFirst,
    PosesFirst,
    gather,
    invert_points,
)
from sightline.photogrammetry.sightings import Sightings
from sightline.photogrammetry.triangulate import triangulate

#: Steps end when the next would lower the cost by less (chi-square units): a millionth of a sigma.
CONVERGED = 1e-10
#: The same where steps have become many: a third of a sigma in one direction, along which a curved valley is
#: followed slowly, such as the depth of one point that is hardly observable.
NEAR = 0.1
#: Largest number of steps for one set of weights, and of those with fresh normal equations; of such sets.
STEPS, FRESH, ROUNDS = 100, 50, 12
#: Chance that one good sighting or more of a whole block is called a gross error.
FALSE_ALARM = 0.05
#: Share of sightings up to which gross errors are left out one per point, without weights in between.
_FEW = 1e-3
#: Median of the chi-square distribution with two degrees of freedom.
_MEDIAN_2 = 1.3863
#: Fewest sightings that an adjustment is tried with: three points seen twice.
LEAST = 6
#: Promise of a step (chi-square units) below which only the curve of a valley can be in its way.
_LAST = 1.0
#: How often a step is tried with its globals held more, and then halved.
_TRIALS = 9
#: Steps after which a step that raised the cost must have lowered it.
_WATCHED = 5
#: Share of the cost that a step must promise for the cost to be looked at, rounding being larger than less.
_ROUNDING = 1e-9
#: Share of the cost below which the promise of a step shows that gross errors can be judged.
_ROUGHLY = 1e-2
#: Share of a residual's variance below which it says nothing (along an epipolar line).
_SEEN = 0.05
BoolArray = NDArray[np.bool_]
Reduction = PosesFirst | PointsFirst | LinkedFrames


class DivergedError(EstimationError):
    """Steps do not end, or lead nowhere."""


@dataclass(frozen=True, eq=False)
class State:
    """Unknowns of a block."""

    common: Array  # (G,)
    own: Array  # (K, 6 n)
    points: Array  # (n, 3), less the block's origin


class BlockSums:
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
        turned, jacobian = rotations_of(x[:, :3])
        of_pose = (self.camera_from_body @ turned)[self.image_of_pose]
        return (
            state.points, *only_read(s.image, s.point, s.pose, s.tangents), self.scale, self.position,
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
        known = None if self.priors is None else self.priors.at(state.points + self.origin)[1]
        if known is not None:
            of_points += known
        return Curvature(rows, weight, s.image, s.point, of_images, of_points, known), r


def rotations_of(angles: Array) -> tuple[Array, Array]:
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


def still_seen(block: BlockSums, weight: Array) -> BoolArray:
    """Which points (n,) are still seen by sightings that count."""
    return np.bincount(block.sightings.point, weight > 0.0, minlength=block.sightings.points) > 0


def first_state(block: BlockSums, usable: BoolArray, start: Array | None) -> tuple[State, BoolArray]:
    """Planned poses, angles of `start`, points where their rays meet; and which sightings are then usable."""
    unknowns, s = block.unknowns, block.sightings
    angles = np.zeros((s.cameras, 3)) if start is None else np.nan_to_num(start)
    common = np.zeros(unknowns.globals)
    if start is not None:
        common[: 3 * s.cameras] = np.ravel(angles)
    points = np.array(triangulate(s, angles, used=usable).position)
    if block.priors is not None:
        points = block.priors.start(points, *_rays(s, angles), s.point)
    found = np.isfinite(points).all(axis=1)
    points[np.flatnonzero(~found)] = block.origin
    own = np.zeros((unknowns.shots, unknowns.own))
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
class Equations:
    """Normal equations of a block at one state, factorised.

    Attributes
    ----------
    curvature : Curvature
    reduced : PosesFirst, PointsFirst or LinkedFrames
    known : Observability
        What they know of the globals.
    """

    curvature: Curvature
    reduced: Reduction
    known: Observability


def _equations(block: BlockSums, state: State, weight: Array) -> Equations:
    """Normal equations at a state."""
    curvature, _ = block.curvature(state, weight)
    reduced = reduce_block(curvature, block.unknowns)
    known = observability(reduced.information, block.unknowns.names, block.unknowns.limit)
    return Equations(curvature, reduced, known)


@dataclass(frozen=True, eq=False)
class Fit:
    """The least cost for some weights.

    Attributes
    ----------
    state : State
    weight : (N,)
        0 at gross errors.
    equations : Equations
        Of a state near by.
    steps : int
        Taken in all.
    statistic : (N,)
        Squared residual over its expectation.
    checked : (N,) bool
        Whether other sightings could have contradicted this one in both directions.
    scale : float
        Robust size of the residuals relative to the stated ones.
    freedom : (N,)
        Squared residual, whitened, that is expected of each sighting, its point following it: 2 at most.
    """

    state: State
    weight: Array
    equations: Equations
    steps: int
    statistic: Array
    checked: BoolArray
    scale: float
    freedom: Array


def gross_error(sightings: int) -> float:
    """Chi-square of one of so many sightings from which on it is a gross error."""
    # two degrees of freedom: exp(-limit / 2) of good ones are larger
    return float(2.0 * np.log(max(sightings, 1) / FALSE_ALARM))


def descend(
    block: BlockSums,
    state: State,
    usable: BoolArray,
    *,
    robust: bool,
    weight: Array | None = None,
    converged: float = CONVERGED,
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
    converged : float
        Steps end when the next would lower the cost by less (chi-square units).

    Returns
    -------
    Fit

    Raises
    ------
    EstimationError
        If steps do not end.
    """
    limit = gross_error(int(usable.sum()))
    now = usable.astype(np.float64) if weight is None else np.array(weight)
    softened, fit = weight is not None, None
    if robust and not softened:
        # many gross errors are found long before the fit that they spoil has settled
        rough = _settle(block, state, now, usable, converged, enough=_ROUGHLY)
        state, fit = rough.state, rough
        if int(_gross(rough, usable, limit).sum()) > _FEW * int(usable.sum()):
            state, now = _redescend(block, state, usable, limit)
            softened, fit = True, None
    tried: set[bytes] = set()
    for _ in range(ROUNDS):
        fit = _settle(block, state, now, usable, converged, known=fit)
        tried.add(now.tobytes())
        state, gross = fit.state, _gross(fit, usable, limit)
        good = together(block, usable & ~gross)
        if not robust or bool((good == now).all()):
            return fit
        few = int(gross.sum()) <= _FEW * int(usable.sum())
        if few or softened:
            worst = _worst(gross, fit.statistic, block.sightings.point) if few else gross
            now = together(block, usable & ~worst)
            # sightings at the margin come and go: either way they change little
            if now.tobytes() in tried:
                return fit
        else:
            state, now = _redescend(block, state, usable, limit)
        if not few:
            softened, fit = True, None
    return _settle(block, state, now, usable, converged)


def together(block: BlockSums, good: BoolArray) -> Array:
    """Weights (N,): 1 for good sightings of points that are still seen twice, or known of."""
    return seen_twice(block.sightings, block.priors, good).astype(np.float64)


def _gross(fit: Fit, usable: BoolArray, limit: float) -> BoolArray:
    """Usable sightings (N,) whose residual is beyond chance."""
    return np.asarray(usable & (fit.statistic > limit * max(fit.scale**2, 1.0)))


def _settle(
    block: BlockSums,
    state: State,
    weight: Array,
    usable: BoolArray,
    converged: float,
    *,
    known: Fit | None = None,
    enough: float = 0.0,
) -> Fit:
    """Steps until none lowers the cost, or promises more than a share `enough` of it.

    `known`: a fit of other weights near by, whose equations serve first.
    """
    taken, fresh, last = 0 if known is None else known.steps, 0, np.inf
    equations = None if known is None or not known.equations.reduced.reusable else known.equations
    for steps in range(taken + 1, taken + STEPS + 1):
        if equations is None:
            equations, fresh, last = _equations(block, state, weight), fresh + 1, np.inf
        reduced, directions = equations.reduced, equations.known
        pull = _pull(block, state, weight, reduced)
        step, decrease = _step(pull, reduced, directions)
        if not np.isfinite(decrease):
            break
        late = fresh > FRESH or steps == taken + STEPS
        if late and decrease > NEAR and not directions.hidden.any():
            break  # with a hidden direction no number depends on how near the end of the valley is
        settled = late or decrease < converged or (decrease < 1e-6 and decrease > 0.5 * last)
        going = not settled and decrease >= enough * pull.cost
        if not settled and decrease > 0.1 * last:
            equations = None  # those of an earlier state lead no further
            continue
        earlier = fresh == 0 or np.isfinite(last)
        if going and earlier and not _lowers(block, state, weight, pull, step, decrease):
            equations = None
            continue
        if going or settled:
            try:
                state, whole = _descended(block, state, weight, pull, step, decrease, equations)
            except EstimationError:
                if earlier:
                    equations = None  # those of other weights know nothing of points that count again
                    continue
                if decrease > NEAR:
                    raise
                going = False  # what is left to gain is less than the equations bend
        if going:
            last = decrease
            if not (whole and reduced.reusable):
                equations = None
            continue
        statistic, checked, freedom = _statistic(replace(equations.curvature, weight=weight), pull.residuals)
        scale = np.sqrt(_scale(statistic[usable & checked]))
        return Fit(state, weight, equations, steps, statistic, checked, float(scale), freedom)
    raise DivergedError(DIVERGED)


def _lowers(block: BlockSums, state: State, weight: Array, pull: _Pull, step: State, decrease: float) -> bool:
    """Whether a whole step lowers the cost, as far as rounding lets it be known.

    None lowers it by more than it is; equations of an earlier state may promise that.
    """
    if decrease > pull.cost:
        return False
    little = decrease < _ROUNDING * max(pull.cost, 1.0)
    return little or block.cost(_moved(state, step), weight) <= pull.cost


def _worst(gross: BoolArray, statistic: Array, point: NDArray[np.intp]) -> BoolArray:
    """Of the sightings called `gross`, the worst of each point: it may have spoilt the others."""
    rows = np.flatnonzero(gross)
    order = rows[np.lexsort((-statistic[rows], point[rows]))]
    _, first = np.unique(point[order], return_index=True)
    out = np.zeros(len(gross), dtype=bool)
    out[order[first]] = True
    return out


@dataclass(frozen=True, eq=False)
class _Pull:
    """Right-hand sides at a state, and what is left of them for the globals."""

    own: Array  # (K, 6 n)
    points: Array  # (n, 3)
    common: Array  # (G,)
    condensed: Array  # (G,)
    residuals: Array  # (N, 2), whitened
    cost: float


def _pull(block: BlockSums, state: State, weight: Array, reduced: Reduction) -> _Pull:
    """Pull of all sightings and priors at a state."""
    own, by_point, common, r, cost = block.gradient(state, weight)
    return _Pull(own, by_point, common, reduced.condense(own, by_point, common), r, cost)


def _step(pull: _Pull, reduced: Reduction, known: Observability, damping: float = 0.0) -> tuple[State, float]:
    """A step, and how much it should lower the cost; `damping` (1 / their unit squared) holds the globals."""
    step = known.solve(pull.condensed, damping)
    own, points = reduced.solve(pull.own, pull.points, pull.common, step)
    decrease = float((pull.own * own).sum() + (pull.points * points).sum() + pull.common @ step)
    return State(step, own, points), decrease


def _descended(
    block: BlockSums,
    state: State,
    weight: Array,
    pull: _Pull,
    step: State,
    decrease: float,
    equations: Equations,
) -> tuple[State, bool]:
    """State after a step that does not raise the cost, and whether it was the whole one.

    Where the whole step raises it, the globals are held ever more (their weakest directions first: there the
    equations bend), then all is halved. Steps that promise little are taken whole: their gain is
    rounding's.
    """
    reduced, known = equations.reduced, equations.known
    seen = known.sigmas[~known.hidden]
    weakest = float(seen.max()) ** -2.0 if len(seen) else 0.0
    if decrease < _ROUNDING * max(pull.cost, 1.0):
        return _moved(state, step), True
    for trial in range(_TRIALS):
        if trial:
            step, _ = _step(pull, reduced, known, weakest * (3.0**trial - 1.0))
        tried = _moved(state, step)
        if block.cost(tried, weight) <= pull.cost:
            return tried, trial == 0
        followed = _followed(block, tried, weight, reduced)
        if block.cost(followed, weight) <= pull.cost:
            return followed, False
        if trial == 0 and (decrease < _LAST or not len(seen)):
            beyond = _beyond(block, tried, weight, pull.cost)
            if beyond is not None:
                return beyond, False
        if not len(seen):
            break
    # with the globals held as with none it is the images themselves along whose motion the equations bend
    beyond = _beyond(block, _moved(state, step), weight, pull.cost) if len(seen) else None
    if beyond is not None:
        return beyond, False
    for _ in range(_TRIALS):
        step = State(0.5 * step.common, 0.5 * step.own, 0.5 * step.points)
        tried = _moved(state, step)
        if block.cost(tried, weight) <= pull.cost:
            return tried, False
    raise DivergedError(DIVERGED)


def _beyond(block: BlockSums, tried: State, weight: Array, cost: float) -> State | None:
    """State of lower cost some steps after one that raised it to `tried`; None if there is none.

    A flight that tables hold loosely may dome and tilt, or turn about its line, along a curved valley: a step
    along its tangent leaves it, and fresh equations lead back into it further down.
    """
    for _ in range(_WATCHED):
        if not np.isfinite(block.cost(tried, weight)):
            return None
        try:
            equations = _equations(block, tried, weight)
        except EstimationError:
            return None  # so far off that the sightings tie nothing there
        pull = _pull(block, tried, weight, equations.reduced)
        if pull.cost < cost:
            return tried
        tried = _moved(tried, _step(pull, equations.reduced, equations.known)[0])
    return None


def _followed(block: BlockSums, state: State, weight: Array, reduced: Reduction) -> State:
    """State after shots and points have followed the globals, which stay, once more."""
    own, by_point, common, _, _ = block.gradient(state, weight)
    still = np.zeros_like(state.common)
    return _moved(state, State(still, *reduced.solve(own, by_point, common, still)))


def _moved(state: State, step: State) -> State:
    return State(state.common + step.common, state.own + step.own, state.points + step.points)


def _redescend(block: BlockSums, state: State, usable: BoolArray, limit: float) -> tuple[State, Array]:
    """State and 0/1 weights after steps with weights that fall with the residual (Geman-McClure)."""
    soft = usable.astype(np.float64)
    previous = np.inf
    for _ in range(12):
        # leverage as of full weights: a point that only gross errors see would else seem to explain them
        curvature, r = block.curvature(state, usable.astype(np.float64))
        statistic, checked, _ = _statistic(curvature, r)
        scale = max(_scale(statistic[usable & checked]), 1.0)
        soft = np.where(usable, (1.0 + statistic / (9.0 * scale)) ** -2, 0.0)
        if scale > 0.9 * previous:
            break
        previous = scale
        equations = _equations(block, state, soft)
        pull = _pull(block, state, soft, equations.reduced)
        step, decrease = _step(pull, equations.reduced, equations.known)
        state, _ = _descended(block, state, soft, pull, step, decrease, equations)
    return state, together(block, usable & (statistic <= limit * scale))


def _statistic(curvature: Curvature, r: Array) -> tuple[Array, BoolArray, Array]:
    """Squared residual over its expectation (N,), whether both its directions are checked by others, freedom.

    Sightings of a point of which fewer than two are left are judged by each other, as if none had been left
    out: one alone can be met exactly, wherever it is.
    """
    c = curvature
    idle = np.bincount(c.point, c.weight > 0.0, minlength=len(c.of_points))[c.point] < 2
    of_points = np.array(c.of_points)
    by_point = c.rows[idle, :, c.rows.shape[2] - 3 :]
    np.add.at(of_points, c.point[idle], np.einsum("nka,nkb->nab", by_point, by_point))
    inverse = invert_points(of_points)
    out, checked, freedom = np.empty((3, len(r)))
    statistics(
        c.rows, np.where(idle, 1.0, c.weight), *only_read(c.point), inverse, r, _SEEN, out, checked, freedom
    )
    return out, checked > 0.0, freedom


def _scale(statistic: Array) -> float:
    """Robust variance of residuals relative to what was stated, from chi-squares (N,) of two degrees."""
    return float(np.median(statistic)) / _MEDIAN_2 if len(statistic) else 1.0


DIVERGED = (
    "the adjustment does not converge: the matches do not belong to the planned poses, or these are off by "
    "far more than [noise] says; check the camera numbers of the matches, (line, column) order, focal "
    "length, mount and quaternions (scalar last), axes and order of x, y, z of control points"
)
