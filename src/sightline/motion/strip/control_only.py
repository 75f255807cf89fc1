"""A strip of one band: its motion from control points alone, where no image shows the same ground twice.

A control point tells where one pixel looked. Between control points the spectrum of the motion tells how far
it may have gone, and that spectrum is learned from them: by the restricted likelihood of what they say, a
Gaussian process without its constants.

Not here: rows of control points and attitude sensors (``fusion.py``), where control points come from
(``applications/reference_tie.py``), strips of several bands (``estimate.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.sparse import csr_array, diags_array

from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import ORDERS, Component, Matern, Order, Spectrum, Tone
from sightline.estimation.robust import doubted_weights
from sightline.estimation.search import ORDER
from sightline.motion.band import Band
from sightline.motion.measure.windows import near_instants
from sightline.motion.results import ControlFit
from sightline.motion.sensors import ControlSightings
from sightline.motion.strip.estimate import StripState, gauge, initial_attitude, reweighted_rows, sensor_rows
from sightline.motion.strip.fusion import CUT, SensorRows, tie
from sightline.motion.strip.hyper import PriorModel
from sightline.motion.strip.joint import TIED_SIGMA, JointEstimate, JointPrior, solve_joint
from sightline.motion.strip.normal_equations import TAPS, GroundOrder, TimeGrid, no_information
from sightline.motion.strip.strip import RecoverOptions, Strip

Array = NDArray[np.float64]

#: Control points on the image that a strip of one band needs: from fewer no spectrum is learned. Of a given
#: spectrum the constants of three angles are left, which two points show; a third checks them.
FEWEST_POINTS, FEWEST_GIVEN = 8, 3
#: Control points that the spectrum is learned from, and neighbours in a run: the solution of all is dense.
MOST_POINTS, RUN = 200, 20
#: Golden section: its multiples are spread evenly over the unit, however many.
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
#: Times that control points far from what the others say of them lose weight, at most; those of less weight
#: than DOUBTED teach no spectrum: many that are wrong would pass for jitter.
WEIGHINGS, DOUBTED = 4, 0.25
#: Nodes of the motion between two control points, typically: more tell nothing.
NODES_BETWEEN = 8.0
#: What is believed of drift and broadband jitter before control points are looked at: px, by how many factors
#: of e all angles (yaw at the edge of the field) may be off, and by how many they differ; lengths of the
#: strip, likewise. Broadband jitter lives between two nodes and an eighth of the strip.
DRIFT_PX, JITTER_PX, SIZE_DOUBT, AXIS_DOUBT = 3.0, 0.1, 2.0, 0.35
DRIFT_SPANS, TIME_DOUBT = 0.3, 1.0
#: How many of the smoothnesses of jitter may be chosen: control points hardly show how the spectrum falls
#: beyond half their rate, and one that ends there would be certain that nothing follows.
STEEPEST = 2
#: Change of a logarithm by which slopes are found; how long a largest likelihood is sought.
_NUDGE, _SEARCH = 1e-5, {"maxiter": 60}
#: The same by which curvatures are found; the largest variance of the logarithm of a size that is believed.
_BEND, MOST_SPREAD = 1e-3, 0.5
#: Kind of the rows of control points.
KIND = "control points"
#: Bounds of both sizes (px), and of time scales: of the drift in lengths of the strip.
SIZES, DRIFT_BOUNDS, JITTER_SPANS = (1e-4, 1e4), (1.0 / 16.0, 10.0), 0.125


def alone(bands: Sequence[Band]) -> bool:
    """Whether a strip has no pair of bands at all."""
    return len(bands) == 1


def one_band_words(name: str) -> str:
    """Why one band is not enough, and what would do."""
    return (
        f"one image cannot show motion: 1 [[band]] given ({name}); add a [[band]] that sees the same ground "
        "a lag apart, or control points ([acquisition] control_points), which `sightline tie` finds in an "
        "orthoimage"
    )


def check_alone(bands: Sequence[Band], control: ControlSightings | None, options: RecoverOptions) -> None:
    """InputError where one band has nothing beside it, or is asked for what pairs of bands give."""
    if not alone(bands):
        return
    if control is None:
        raise InputError(one_band_words(bands[0].name))
    if options.method != "joint":
        raise InputError(
            f"the method {options.method} is made of the differences between bands, and there is one: leave "
            "--method out"
        )


def solve_by_control(strip: Strip) -> tuple[Strip, StripState, ControlFit]:
    """Motion of a strip of one band; the strip comes back with a grid that its control points can fill.

    Raises
    ------
    EstimationError
        If too few control points are seen, or they leave an angle open.
    """
    statics, nodes = np.zeros(len(strip.parameters)), np.zeros((strip.grid.count, 3))
    seen = _control_of(sensor_rows(strip, strip.broad, nodes, statics))
    _check_enough(strip, seen)
    assert seen is not None
    strip = replace(strip, grid=_filled(strip.grid, seen))
    grid, nothing = strip.grid, no_information(strip.grid, len(strip.parameters))
    sigmas = np.array([p.sigma for p in strip.parameters])
    # about a motion that is smooth: where one jumps from line to line, places hang on its rate
    rows = sensor_rows(strip, strip.broad, initial_attitude(strip, statics), statics)
    # a camera that has moved may no longer show what the one given shows
    _check_enough(strip, _control_of(rows))
    model, rows = _learned(strip, rows, sigmas)
    apart = model.apart(grid, TAPS) if _longest_gap(rows, grid) > ORDER else None
    angles = model.processes(grid)
    constant, drift = gauge(strip, angles)
    prior = JointPrior(angles, sigmas, constant_sigma=constant, drift_sigma=drift, apart=apart)
    estimate = solve_joint(nothing, prior, tie(rows, grid, 3))
    if strip.sensors:
        # control points have weights by what the others say of them
        again = reweighted_rows(rows, estimate, believed=False)
        rows = [old if old.kind == KIND else new for old, new in zip(rows, again, strict=True)]
        estimate = solve_joint(nothing, prior, tie(rows, grid, 3))
    _check_tied(estimate)
    state = StripState(estimate, prior, model, (), (), (), (), (0.0, 0.0), GroundOrder())
    used = _control_of(rows)
    assert used is not None
    fit = _fit(grid, estimate, used)
    if not fit.kept.any():
        raise EstimationError(
            f"none of the {len(fit.kept)} control points on {strip.bands[0].name} goes with what the others "
            "say: check their coordinates, what their heights are above, and their sigma"
        )
    return strip, state, fit


def _control_of(rows: Sequence[SensorRows]) -> SensorRows | None:
    """What control points say; None where none is seen."""
    return next((one for one in rows if one.kind == KIND), None)


def _check_enough(strip: Strip, seen: SensorRows | None) -> None:
    """EstimationError where too few control points lie on the image."""
    needed = FEWEST_POINTS if strip.known.spectra is None else FEWEST_GIVEN
    count = 0 if seen is None else len(seen.value) // 2
    if count < needed:
        assert strip.control is not None
        raise EstimationError(
            f"{count} of {len(strip.control.sigma)} control points are seen where {strip.bands[0].name} "
            f"looks; a strip of one band is recovered from {needed} or more: `sightline tie` finds them in "
            "an orthoimage, or check x, y, z and line of those given"
        )
    assert seen is not None
    if len(np.unique(seen.instants[::2].mean(axis=1))) < 2:
        raise EstimationError(
            "all control points on the image lie on one line, which shows no motion: give some on other lines"
        )


def _check_tied(estimate: JointEstimate) -> None:
    """EstimationError where control points leave an angle open."""
    assert estimate.ties is not None
    if not estimate.ties.tied.all():
        open_ones = [
            name for name, tied in zip(("roll", "pitch", "yaw"), estimate.ties.tied, strict=True) if not tied
        ]
        raise EstimationError(
            f"the control points leave {' and '.join(open_ones)} open: they lie in one place of the field; "
            "give some at other columns"
        )


def _instants(rows: Sequence[SensorRows]) -> Array:
    """s, rising, each once; when something is measured."""
    return np.unique(np.concatenate([one.instants.ravel() for one in rows]))


def _longest_gap(rows: Sequence[SensorRows], grid: TimeGrid) -> float:
    """Most nodes in a row between two measurements."""
    return float(np.diff(_instants(rows)).max(initial=0.0)) / grid.step


def _filled(grid: TimeGrid, seen: SensorRows) -> TimeGrid:
    """The grid, coarser where control points stand further apart than its nodes by far."""
    between = float(np.diff(_instants([seen])).mean()) if len(seen.value) > 2 else 0.0
    return grid.coarser(max(between / NODES_BETWEEN / grid.step, 1.0))


def _fit(grid: TimeGrid, estimate: JointEstimate, used: SensorRows) -> ControlFit:
    """What was measured at control points, and what the estimate leaves of it."""
    moved = np.zeros(len(used.value))
    for k in range(2):
        nodes = grid.interpolate(estimate.nodes, used.instants[:, k])
        moved += np.einsum("na,na->n", used.by[:, k], nodes)
    left = used.value - moved - used.by_static @ estimate.statics
    # errors of the two pixel coordinates of a point lean on each other, on those of no other
    blocks = np.stack(
        [used.whiten[k::2][:, m::2].diagonal() for k in range(2) for m in range(2)], axis=1
    ).reshape(-1, 2, 2)
    root = np.linalg.inv(blocks)
    sigma = np.sqrt(np.einsum("nij,nij->ni", root, root))
    weighted = csr_array(diags_array(np.sqrt(used.weight / used.scale))) @ used.whiten
    by = weighted @ used.by.sum(axis=1)
    return ControlFit(
        used.instants[::2].mean(axis=1),
        used.value.reshape(-1, 2),
        left.reshape(-1, 2),
        sigma,
        np.einsum("na,na->a", by, by),
        used.weight.reshape(-1, 2).min(axis=1) >= 0.5,
    )


# ---------------------------------------------------------------------------- the spectrum


def _learned(strip: Strip, rows: Sequence[SensorRows], sigmas: Array) -> tuple[PriorModel, list[SensorRows]]:
    """The spectrum that control points ask for, or the one given; rows with weights by what it says."""
    seen = _control_of(rows)
    assert seen is not None
    some = _some_of(seen, strip.scale, sigmas)
    # one that is wrong passes for jitter: before any spectrum is learned, beside what the most are off
    for _ in range(WEIGHINGS):
        some = replace(some, weight=some.weights(strip.broad, strip.scale, beside=True))
    start: _Found | None = None
    for _ in range(WEIGHINGS):
        if strip.known.spectra is not None:
            model = strip.given_model()
        else:
            step, tones = strip.grid.step, strip.known.tones
            model, start = fit_control_spectrum(some.believed(), strip.scale, step, tones, start)
        weights = some.weights(model, strip.scale)
        settled = np.allclose(weights, some.weight, atol=0.05)
        some = replace(some, weight=weights)
        if settled:
            break
    weighted = replace(seen, weight=_weights_of_all(seen, some, model, strip.scale, sigmas))
    return model, [weighted if one is seen else one for one in rows]


def _weights_of_all(
    rows: SensorRows, some: _Sightings, model: PriorModel, scale: Array, sigmas: Array
) -> Array:
    """(R,) of all control points: of `some` as found, of others by what those near them say."""
    weight = np.ones(len(rows.value))
    weight[some.chosen] = some.weight
    order = _in_time(rows)
    if len(some.chosen) == 2 * len(order):
        return weight
    for part in np.array_split(order, math.ceil(len(order) / MOST_POINTS)):
        near = _whitened(rows, part, scale, sigmas)
        # those that are wrong may hide each other: beside what most are off first
        for number in range(2 * WEIGHINGS):
            near = replace(near, weight=near.weights(model, scale, beside=number < WEIGHINGS))
        weight[near.chosen] = near.weight
    return weight


@dataclass(frozen=True, eq=False)
class _Sightings:
    """Whitened rows of some control points, two each.

    t (P, 2) s, of which the mean is seen; value (R,); by (R, 3) of a px of each angle; statics (R, Q) of a
    sigma of each static parameter; chosen (R,) which rows of all they are; weight (R,); far (3,) how many px
    constants may be.
    """

    t: Array
    value: Array
    by: Array
    statics: Array
    chosen: NDArray[np.intp]
    weight: Array
    far: Array

    def weighted(self) -> _Sightings:
        """The same with rows divided by the sigma that their weight gives them."""
        root = np.sqrt(self.weight)
        return replace(
            self, value=root * self.value, by=root[:, None] * self.by, statics=root[:, None] * self.statics
        )

    def believed(self) -> _Sightings:
        """Those that are not doubted; all where these are too few."""
        keep = self.weight >= DOUBTED
        if keep.sum() < 2 * FEWEST_POINTS:
            return self
        parts = {name: getattr(self, name)[keep] for name in ("value", "by", "statics", "chosen", "weight")}
        return replace(self, t=self.t[keep[::2]], **parts)

    def of_means(self, part: Component) -> Array:
        """(P, P) autocovariance of what the control points see of a motion."""
        pairs = [np.abs(self.t[:, None, i] - self.t[:, j]) for i, j in ((0, 0), (1, 1), (0, 1))]
        same, other, across = (part.autocovariance(lags) for lags in pairs)
        return np.asarray(0.25 * (same + other + across + across.T))

    def inverse(self, motions: Sequence[Array]) -> tuple[Array, float]:
        """(R, R) inverse of the covariance of the rows, constants left open, and its log determinant.

        `motions` (P, P) px^2 are the covariances of roll, pitch and yaw.
        """
        whole = np.eye(len(self.value)) + self.statics @ self.statics.T
        for axis, motion in enumerate(motions):
            whole += np.outer(self.by[:, axis], self.by[:, axis]) * np.repeat(np.repeat(motion, 2, 0), 2, 1)
        factor = cho_factor(whole, lower=True)
        pulled = cho_solve(factor, self.by)
        constants = cho_factor(self.by.T @ pulled + np.diag(1.0 / self.far**2), lower=True)
        size = 2.0 * float(sum(np.log(np.diag(one[0])).sum() for one in (factor, constants)))
        whole = cho_solve(factor, np.eye(len(self.value)))
        return whole - pulled @ cho_solve(constants, pulled.T), size

    def weights(self, model: PriorModel, scale: Array, *, beside: bool = False) -> Array:
        """(R,) by how far each control point lies from what the others say of it, in sigmas of that.

        `beside`: in units of how far the most of them do, where that is more than the model lets expect.
        """
        rows = self.weighted()
        spectra = [s.scaled(1.0 / float(px)) for s, px in zip(model.spectra, scale, strict=True)]
        inverse, _ = rows.inverse([sum(map(rows.of_means, s.components), np.zeros(())) for s in spectra])
        # of the two rows of a point, what all others leave of it: the block of the inverse
        pulled, each = (inverse @ rows.value).reshape(-1, 2), np.arange(len(self.t))
        covariance = np.linalg.inv(inverse.reshape(len(each), 2, len(each), 2)[each, :, each])
        weight = self.weight[::2]
        left = np.einsum("nij,nj->ni", covariance, pulled) / np.sqrt(weight)[:, None]
        # with its own error as it was given, whatever it weighs now
        predicted = (covariance - np.eye(2)) / weight[:, None, None] + np.eye(2)
        squared = 0.5 * np.einsum("ni,nij,nj->n", left, np.linalg.inv(predicted), left)
        if beside:
            # the median of half a chi-squared of two
            squared /= max(float(np.median(squared)) / math.log(2.0), 1.0)
        return np.repeat(doubted_weights(squared, CUT), 2)


def _some_of(rows: SensorRows, scale: Array, sigmas: Array) -> _Sightings:
    """Rows of control points, of so many at most: half spread over the strip, half in runs of neighbours."""
    order = _in_time(rows)
    count = len(order)
    spread = _evenly(count, MOST_POINTS // 2)
    runs = np.linspace(0, max(count - RUN, 0), MOST_POINTS // 2 // RUN).astype(int)[:, None] + np.arange(RUN)
    at = np.arange(count) if count <= MOST_POINTS else np.unique([*spread, *runs.ravel()])
    return _whitened(rows, order[at], scale, sigmas)


def _evenly(count: int, most: int) -> NDArray[np.intp]:
    """At most so many of `count` numbers in order, one of each part of equal length.

    Each stands elsewhere in its part: control points of a reference come in rows of some columns, and at even
    distances one column would have all of them for long.
    """
    part = np.arange(min(count, most))
    return np.asarray((part + part * GOLDEN % 1.0) * count / len(part), dtype=np.intp)


def _in_time(rows: SensorRows) -> NDArray[np.intp]:
    """Numbers of control points by when they were seen."""
    return np.argsort(rows.instants[::2].mean(axis=1), kind="stable")


def _whitened(rows: SensorRows, points: NDArray[np.intp], scale: Array, sigmas: Array) -> _Sightings:
    """Rows of some control points, all of weight 1."""
    chosen = (2 * points[:, None] + np.arange(2)).ravel()
    whiten = rows.whiten[chosen][:, chosen]
    return _Sightings(
        rows.instants[chosen[::2]],
        np.asarray(whiten @ rows.value[chosen]),
        np.asarray(whiten @ (rows.by[chosen].sum(axis=1) * scale)),
        np.asarray(whiten @ (rows.by_static[chosen] * sigmas)),
        chosen,
        np.ones(len(chosen)),
        TIED_SIGMA / scale,
    )


def fit_control_spectrum(
    sightings: _Sightings,
    scale: Array,
    step: float,
    tones: Sequence[float] = (),
    start: _Found | None = None,
) -> tuple[PriorModel, _Found]:
    """Drift, broadband jitter and known tones of the three angles, by restricted likelihood.

    Parameters
    ----------
    sightings : _Sightings
    scale : (3,)
        rad; one pixel of each angle.
    step : float
        s; between nodes of the motion: nothing quicker is looked for.
    tones : sequence of float
        Hz; known beforehand.
    start : _Found, optional
        What was found before.

    Returns
    -------
    PriorModel
    found : _Found

    Notes
    -----
    The largest of likelihood times a wide prior of sizes and time scales: what few control points leave open
    stays as large as is believed beforehand. Sizes are those of the mean variance over what they may be,
    which is larger than the most probable one where they are known badly. All axes have the same time scales,
    for what shakes one axis of a body shakes the others about as fast.
    """
    rows = sightings.weighted()
    span = max(float(np.ptp(rows.t)), 4.0 * step)
    fits = [_Likelihood(rows, span, step, tuple(tones), order) for order in ORDERS[:STEEPEST]]
    if start is not None:
        fits = [replace(fits[0], order=start.order)]
    found = [one for fit in fits for one in (fit.largest(fit.centre if start is None else start.unknowns),)]
    best = min(found, key=lambda one: one.minus)
    fit = replace(fits[0], order=best.order)
    spectra = fit.spectra(fit.mean_sizes(best.unknowns))
    roll, pitch, yaw = (s.scaled(float(px)) for s, px in zip(spectra, scale, strict=True))
    return PriorModel((roll, pitch, yaw)).with_turns(span), best


@dataclass(frozen=True, eq=False)
class _Found:
    """The unknowns (U,) of a spectrum, the smoothness of its jitter, and minus the logarithm there."""

    unknowns: Array
    order: Order
    minus: float


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Minus the logarithm of likelihood and prior, with its gradient; unknowns are logarithms.

    First the sizes (px) of each part, roll, pitch and yaw together; then the time scales (s) of drift and
    jitter.
    """

    rows: _Sightings
    span: float
    step: float
    tones: tuple[float, ...]
    order: Order

    def largest(self, begin: Array) -> _Found:
        """The unknowns of the largest likelihood, sought from `begin` (U,)."""
        low, high = np.array(self.bounds).T
        begin = np.clip(begin, low, high)
        found: Any = minimize(  # type: ignore[call-overload]
            self, begin, jac=True, method="L-BFGS-B", bounds=self.bounds, options=_SEARCH
        )
        return _Found(np.asarray(found.x), self.order, float(found.fun))

    def mean_sizes(self, x: Array) -> Array:
        """The unknowns (U,) with sizes of the mean variance, by the curvature at the largest likelihood."""
        sizes = len(x) - 2
        slopes = [(self(x + step)[1] - self(x - step)[1]) / (2.0 * _BEND) for step in _BEND * np.eye(len(x))]
        curvature = 0.5 * (np.array(slopes) + np.array(slopes).T)
        value, vector = np.linalg.eigh(curvature)
        # the prior alone bounds what the data leave open
        least = np.linalg.eigvalsh(self.trust)[0]
        spread = np.diag((vector / np.maximum(value, least)) @ vector.T)
        out = x.copy()
        # of a lognormal size s: E[s^2] = exp(2 mean + 2 variance of the logarithm)
        out[:sizes] += np.minimum(spread[:sizes], MOST_SPREAD)
        return out

    @property
    def centre(self) -> Array:
        """What is believed beforehand."""
        sizes = [DRIFT_PX, JITTER_PX, *(JITTER_PX for _ in self.tones)]
        times = [DRIFT_SPANS * self.span, math.sqrt(self.step * JITTER_SPANS * self.span)]
        return np.log([*np.repeat(sizes, 3), *times])

    @property
    def trust(self) -> Array:
        """Precision of that: sizes of the three angles are alike."""
        each = np.linalg.inv(SIZE_DOUBT**2 * np.ones((3, 3)) + AXIS_DOUBT**2 * np.eye(3))
        return block_diag(*[each] * (2 + len(self.tones)), np.eye(2) / TIME_DOUBT**2)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Of every unknown."""
        drift = (DRIFT_BOUNDS[0] * self.span, DRIFT_BOUNDS[1] * self.span)
        jitter = (0.5 * self.step, max(JITTER_SPANS * self.span, self.step))
        every = [SIZES] * (3 * (2 + len(self.tones))) + [drift, jitter]
        return [(math.log(low), math.log(high)) for low, high in every]

    def parts(self, x: Array) -> list[Matern | Tone]:
        """Parts of the spectrum, each of unit size."""
        drift, jitter = np.exp(x[-2:]).tolist()
        width = 0.5 / self.span
        return [
            Matern(1.0, drift, "5/2"),
            Matern(1.0, jitter, self.order),
            *(Tone(1.0, f, width) for f in self.tones),
        ]

    def spectra(self, x: Array) -> list[Spectrum]:
        """Of each angle, px."""
        sizes = np.exp(x[:-2]).reshape(-1, 3)
        parts = [Spectrum((one,)) for one in self.parts(x)]
        return [
            Spectrum(
                tuple(
                    c for p, s in zip(parts, sizes[:, k], strict=True) for c in p.scaled(float(s)).components
                )
            )
            for k in range(3)
        ]

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Value and gradient."""
        rows, parts = self.rows, self.parts(x)
        shapes = [rows.of_means(part) for part in parts]
        power = np.exp(2.0 * x[:-2]).reshape(-1, 3)
        motions = [sum(p * s for p, s in zip(power[:, k], shapes, strict=True)) for k in range(3)]
        inverse, size = rows.inverse([np.asarray(one) for one in motions])
        alpha = inverse @ rows.value
        off = x - self.centre
        value = 0.5 * (size + float(rows.value @ alpha) + float(off @ self.trust @ off))
        slope = 0.5 * (inverse - np.outer(alpha, alpha))
        # by the covariance of the motion: both rows of a point have its instants
        count = len(rows.t)
        weighted = [
            (slope * np.outer(rows.by[:, k], rows.by[:, k])).reshape(count, 2, count, 2).sum(axis=(1, 3))
            for k in range(3)
        ]
        gradient = np.zeros(len(x))
        gradient[:-2] = [
            2.0 * p * float((w * s).sum())
            for row, s in zip(power, shapes, strict=True)
            for p, w in zip(row, weighted, strict=True)
        ]
        for k in range(2):
            part = parts[k]
            assert isinstance(part, Matern)
            longer = replace(part, timescale=part.timescale * math.exp(_NUDGE))
            change = (rows.of_means(longer) - shapes[k]) / _NUDGE
            gradient[len(x) - 2 + k] = sum(
                p * float((w * change).sum()) for p, w in zip(power[k], weighted, strict=True)
            )
        return value, gradient + self.trust @ off


def controlled_lines(strip: Strip, fit: ControlFit, t: Array) -> NDArray[np.bool_]:
    """Lines of a strip of one band beside a control point: within a node of the finest grid."""
    camera = strip.nominal[0]
    first, last = camera.times(np.array([0.0, camera.lines - 1.0]))
    period = abs(float(last - first)) / (camera.lines - 1)
    return near_instants(fit.t[fit.kept], t, RecoverOptions().grid_lines * period)
