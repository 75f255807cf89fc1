"""The estimate of one pass over a strip: motion, statics, relief and sensors from its matches.

Not here: where matches come from and how often (``applications/line_of_sight.py``), the solution itself
(``motion/strip/joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.prior import Autoregressive, TabulatedPsd
from sightline.estimation.search import ORDER
from sightline.execution import give_back_memory
from sightline.geometry.trajectory import Motion
from sightline.motion.measure.consensus import ground_weights
from sightline.motion.measure.match_noise import estimate_correlation, robust_weights, row_weights
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.measure.stars import StarRecord, blurred_by
from sightline.motion.measure.windows import near_instants
from sightline.motion.strip.fusion import (
    UNSEEN_PX,
    SensorRows,
    attitude_rows,
    control_rows,
    own_parts,
    reweighted,
    tie,
    unfelt_tones,
)
from sightline.motion.strip.hidden import learned, with_shown_mode
from sightline.motion.strip.hyper import PriorModel
from sightline.motion.strip.joint import (
    CONSTANT_SIGMA,
    DRIFT_SIGMA,
    JointEstimate,
    JointPrior,
    innovation_weights,
    less_directions,
    longest_gap,
    mean_and_drift,
    solve_joint,
)
from sightline.motion.strip.normal_equations import (
    GroundOrder,
    modelled,
    modelled_by_blur,
    no_information,
    normal_equations,
    ordered_ground,
)
from sightline.motion.strip.relief import (
    beside_row,
    hub_delay,
    relief_lengths,
    relief_matters,
    relief_share,
    row_processes,
    row_scatter,
)
from sightline.motion.strip.slow_errors import LEAST, SlowErrors, slow_errors
from sightline.motion.strip.strip import Strip
from sightline.motion.tones import MotionSpectrum, spectrum
from sightline.writing import let_go

Array = NDArray[np.float64]

#: Times that matches are weighed by their own scatter and the motion solved again: once a spectrum is fitted
#: in the pass, and in drafts and before.
ROUNDS, DRAFT_ROUNDS = 4, 2
#: Rounds end where weights moved residuals by less than this (rms) of a match's sigma, and no further jump
#: was found: the next round would move them by a tenth of it. Errors that wander hardly move them any more
#: while their sizes still grow, by which sigmas of the motion grow: these change by less than SAME_SIZE.
STILL, SAME_SIZE = 0.025, 0.1
#: Share to which the displacement of matches by jitter within the stages of TDI is known. With the
#: motion known, tones of 47 and 83 Hz and their products were .00, .00 and .03 of themselves off in the mean
#: square beyond what noise makes them (16 and 32 stages, three scenes, SNR 3000).
BLUR_ERROR = 0.05
#: Motion of which stages leave the second share shows plainly, of what they leave less of less, down to not
#: at all at the first; so many nodes at least.
HARDLY, PLAINLY, FEWEST_NODES = 0.2, 0.3, 16
#: Frequencies at most where the error of that is owned: of its modes, and sums and differences of them.
MOST_LINES = 200
#: Times that control points are linearised before the first matching.
INITIAL_ROUNDS = 3
#: Times that readings are weighed by what an estimate from sensors alone leaves of them, so that one wrong
#: reading does not send the first matching astray.
SENSOR_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class StripState:
    """What one pass hands to the next."""

    estimate: JointEstimate
    prior: JointPrior
    model: PriorModel
    records: tuple[StarRecord, ...]
    post_px: tuple[Array, ...]
    with_relief_px: tuple[Array, ...]
    before_px: tuple[Array, ...]
    relief_lengths: tuple[float, float]
    ground: GroundOrder
    height_sigma: float = 0.0
    relief_share: float = 1.0
    slow: SlowErrors | None = None

    def jumps(self) -> list[Array]:
        """Instants (s) at which roll, pitch, yaw were let jump."""
        weights = self.prior.innovation_weights
        if weights is None:
            return []
        return [self.estimate.grid.nodes[weights[:, axis] < 1.0] for axis in range(3)]


def initial_attitude(strip: Strip, statics: Array) -> Array:
    """Angles (count, 3) that sensors and control points tell before any matching (S1, claim 12)."""
    nodes = np.zeros((strip.grid.count, 3))
    grid = strip.grid
    prior = JointPrior(strip.broad.processes(grid), np.array([p.sigma for p in strip.parameters]))
    nothing = no_information(grid, len(strip.parameters))
    for _ in range(INITIAL_ROUNDS if strip.control is not None else 1):
        rows = sensor_rows(strip, strip.broad, nodes, statics)
        if not rows:
            return nodes
        estimate = solve_joint(nothing, prior, tie(rows, grid, 3))
        for _ in range(SENSOR_ROUNDS):
            rows = reweighted_rows(rows, estimate, believed=True)
            estimate = solve_joint(nothing, prior, tie(rows, grid, 3))
        nodes = estimate.nodes
    return nodes


def sensor_rows(
    strip: Strip, model: PriorModel, nodes: Array, statics: Array, memory: float = 0.0
) -> list[SensorRows]:
    """Rows of all sensors about the present estimate; `model` tells which tones they may not feel."""
    grid, first = strip.grid, strip.nominal[0]
    span = (grid.start, grid.start + grid.step * (grid.count - 1))
    unseen = (UNSEEN_PX if model == strip.broad else 0.0) * strip.scale
    unfelt = unfelt_tones(model.spectra)
    # angles of the body about the axes of the estimate
    sensors = [replace(s, angles=s.angles @ strip.turn) for s in strip.sensors]
    rows = [
        attitude_rows(s, span, len(strip.parameters), unfelt, unseen, first.trajectory, memory)
        for s in sensors
    ]
    if strip.control is not None:
        cameras = strip.cameras(nodes, statics)
        rows.append(control_rows(strip.control, cameras, strip.parameters, grid, nodes, statics))
    return [r for r in rows if r is not None]


def solve_strip(
    strip: Strip,
    records: tuple[StarRecord, ...],
    nodes: Array,
    statics: Array,
    model: PriorModel,
    height_sigma: float,
    before: StripState | None,
    *,
    rounds: int = DRAFT_ROUNDS,
    jumps: bool = True,
) -> StripState:
    """Solve; weigh matches by their scatter, let the motion jump where it did, solve again, in `rounds`."""
    grid = strip.grid
    stars = [r.star for r in records]
    give_back_memory()
    # by the motion that windows were moved by, and by that about which blur within stages is known
    known = [modelled(replace(s, uneven=None), grid, nodes, statics) for s in stars]

    def moved_back(stars: Sequence[Star], about: Array) -> list[Array]:
        moved = [
            k if s.uneven is None else s.each(np.add, k, modelled_by_blur(s, grid, about))
            for k, s in zip(known, stars, strict=True)
        ]
        return [s.each(np.add, s.residual_px, m) for s, m in zip(stars, moved, strict=True)]

    about, uneven = nodes, any(s.uneven is not None for s in stars)
    if uneven and model == strip.broad:
        about = plainly_seen(strip, nodes)
        stars = _blurred_anew(strip, records, stars, about, statics)
    measured = moved_back(stars, about)
    orders = _ground_orders(strip, stars)
    for camera in strip.nominal:
        camera.forget()
    sigmas = np.array([p.sigma for p in strip.parameters])
    unknown_relief = relief_matters(stars, height_sigma)
    settled = model != strip.broad
    angles = model.estimated().processes(grid)
    constant, drift = gauge(strip, angles)
    curves = unknown_curves(angles, nodes) if settled else (0.0, 0.0, 0.0)
    prior = JointPrior(angles, sigmas, constant_sigma=constant, drift_sigma=drift, curve_sigma=curves)
    alike = model.alike(strip.scale, grid.step * grid.count)
    ample_angles = alike.processes(grid)
    stated, even = gauge(strip, ample_angles, held=False)
    ample_prior = JointPrior(ample_angles, sigmas, constant_sigma=stated, drift_sigma=even)
    lengths = before.relief_lengths if before is not None else 2 * (2.0 * strip.half_width,)
    share = before.relief_share if before is not None else 1.0
    beside = 0.0

    ground_speed = strip.ground_speed / orders[0].rate

    def relief_of(sigma: float, lengths: tuple[float, float]) -> tuple[Autoregressive, Autoregressive]:
        return row_processes(sigma, lengths, strip.half_width, ground_speed, grid)

    if unknown_relief:
        beside = share * height_sigma * beside_row(lengths[0], strip.half_width)
        prior = replace(prior, relief=relief_of(share * height_sigma, lengths))

    # errors of a gyro are followed twice as far as the images tie the motion to itself
    longest = 2.0 * max(_longest_lag(s) for s in stars)
    rows = sensor_rows(strip, model, nodes, statics, longest)

    t_ground = [order.of(s.t_hub) for s, order in zip(stars, orders, strict=True)]
    slow = before.slow if before is not None and settled else None
    if slow is not None and not slow.covers(stars):
        slow = None

    def solution() -> tuple[JointEstimate, list[Array], list[Array]]:
        data = normal_equations(stars, measured, grid, orders=orders, relief=unknown_relief, slow=slow)
        # across a gap longer than its memory an autoregression knows no slope of the drift
        long = longest_gap(data) > ORDER
        width = (data.ab.subdiagonals + 1) // data.block
        apart, alike_apart = (m.estimated().apart(grid, width) if long else None for m in (model, alike))
        wander = None if slow is None else slow.precision
        ample = replace(ample_prior, relief=prior.relief, apart=alike_apart, slow_precision=wander)
        ties = tie(rows, grid, data.block) if rows else None
        more = replace(prior, apart=apart, ample=ample, slow_precision=wander, common=strip.common_offsets)
        found = solve_joint(data, more, ties)
        clear = measured
        if slow is not None:
            errors = [slow.moved(s, t, found.slow) for s, t in zip(stars, t_ground, strict=True)]
            clear = [s.each(np.subtract, m, e) for s, m, e in zip(stars, measured, errors, strict=True)]
        motion_only = [modelled(s, grid, found.nodes, found.statics) for s in stars]
        without = [s.each(np.subtract, m, w) for s, m, w in zip(stars, clear, motion_only, strict=True)]
        if not unknown_relief:
            return found, without, without
        whole = [
            modelled(s, grid, found.unknowns(), found.statics, o) for s, o in zip(stars, orders, strict=True)
        ]
        left = [s.each(np.subtract, m, w) for s, m, w in zip(stars, clear, whole, strict=True)]
        return found, left, without

    averaged = averaging_times(strip)
    news = False
    estimate, post, without = solution()
    for _ in range(rounds):
        ground = ground_weights(stars, post, beside)
        weights = [
            s.each(np.multiply, robust_weights(s, r), w) for s, r, w in zip(stars, post, ground, strict=True)
        ]
        stars = [s.with_weight(w) for s, w in zip(stars, weights, strict=True)]
        stars = [
            s.with_weight(s.each(np.multiply, s.weight, row_weights(s, r)))
            for s, r in zip(stars, post, strict=True)
        ]
        unlearned = slow
        if slow is not None:
            slow = slow.learned(estimate.slow, estimate.slow_covariance)
        elif settled:
            slow = slow_errors(stars, post, t_ground)
        stars = [
            s.with_correlation(model.grown(c)) for s, c in zip(stars, _correlations(stars, post), strict=True)
        ]
        rows = reweighted_rows(rows, estimate, believed=not settled)
        jumped = prior.innovation_weights
        if settled and jumps:
            prior = replace(prior, innovation_weights=innovation_weights(estimate))
        earlier = post
        if uneven:
            if model.blur_shows:
                # what was found last is in the blur of the next estimate only
                more = model if news else with_shown_mode(model, estimate, matched_span(stars), averaged)
                news = more is not model
                model = more if news else learned(model, estimate, matched_span(stars))
                prior = replace(prior, angles=model.estimated().processes(grid))
            about = estimate.nodes if settled else plainly_seen(strip, estimate.nodes)
            stars = _blurred_anew(strip, records, stars, about, estimate.statics)
            measured = moved_back(stars, about)
        del estimate, without  # long strips hold one solution at a time
        estimate, post, without = solution()
        same = not news and _same_jumps(jumped, prior.innovation_weights) and _same_sizes(unlearned, slow)
        if same and _moved(stars, earlier, post) < STILL:
            break
    if unknown_relief:
        if settled:
            share = relief_share(
                lambda sigma, length: estimate.likelihood_of(relief_of(sigma, (length, length))),
                height_sigma,
                strip.half_width,
            )
        along = ground_speed * grid.step * grid.count
        beside_rows = row_scatter(stars, without)
        lengths = relief_lengths(beside_rows, share * height_sigma, strip.half_width, along)
    kept = tuple(replace(r, star=s) for s, r in zip(stars, records, strict=True))
    return StripState(
        estimate,
        prior,
        model,
        kept,
        tuple(post),
        tuple(without),
        tuple(measured),
        lengths,
        orders[0],
        height_sigma,
        share,
        slow,
    )


def averaging_times(strip: Strip) -> list[float]:
    """s; over which the stages of all images average: an image without stages shows all, and leaves none."""
    hiding = all(camera.stage_times for camera in strip.nominal)
    return sorted({each for camera in strip.nominal for each in camera.stage_times}) if hiding else []


def matched_span(stars: Sequence[Star]) -> tuple[float, float]:
    """First and last instant (s) of windows: beyond them a motion is what its neighbours make of it."""
    first, last = np.inf, -np.inf
    for star in stars:
        present = star.present
        for some in star.stretches():
            seen, t = present[some], star.t[some]
            for times in (t[seen], (star.t_hub[some, None] + 0.0 * t)[seen]):
                first, last = min(first, times.min(initial=np.inf)), max(last, times.max(initial=-np.inf))
        let_go()
    return float(first), float(last)


def observed_lines(strip: Strip, state: StripState, t: Array) -> NDArray[np.bool_]:
    """Lines within half a window, and half a step of the grid, of an instant at which a match was exposed."""
    marks = []
    for record in state.records:
        star, present = record.star, record.star.present
        marks += [star.t_hub[present.any(axis=1)], star.t[present]]
    reach = 0.5 * (max(r.star.longest for r in state.records) + strip.grid.step)
    return near_instants(np.concatenate(marks), t, reach)


def _longest_lag(star: Star) -> float:
    """s; the most between the instants of a window's two images."""
    apart = (np.abs(star.t[some] - star.t_hub[some, None]) for some in star.stretches())
    return max((float(np.nanmax(each, initial=0.0)) for each in apart), default=0.0)


def plainly_seen(strip: Strip, nodes: Array) -> Array:
    """Angles (count, 3) less what stages average away: that hardly shows, and its blur as much as its mean.

    Where the first estimate has the sign of such a motion wrong, blur about it would keep it wrong; blur
    about the others shows it as it is.
    """
    cameras = [c for c in strip.nominal if c.stages is not None]
    if not cameras or len(nodes) < FEWEST_NODES:
        return nodes
    line = nodes[0] + (nodes[-1] - nodes[0]) * np.linspace(0.0, 1.0, len(nodes))[:, None]
    # what is left between the ends of a line through both has no jump where it is continued
    rest = np.concatenate([nodes - line, -(nodes - line)[::-1]])
    frequency = np.fft.rfftfreq(len(rest), strip.grid.step)
    shortest = min(float(np.min(c.stages)) * c.detector.line_period for c in cameras)  # type: ignore[arg-type]
    share = np.clip((np.abs(np.sinc(frequency * shortest)) - HARDLY) / (PLAINLY - HARDLY), 0.0, 1.0)
    kept = np.fft.irfft(np.fft.rfft(rest, axis=0) * share[:, None], len(rest), axis=0)
    return np.asarray(line + kept[: len(nodes)])


def _blurred_anew(
    strip: Strip, records: Sequence[StarRecord], stars: Sequence[Star], nodes: Array, statics: Array
) -> list[Star]:
    """Stars displaced by jitter within the stages of TDI of a motion (count, 3)."""
    cameras = strip.cameras(nodes, statics)
    return [
        blurred_by(replace(r, star=s), cameras, strip.surface) for r, s in zip(records, stars, strict=True)
    ]


def _ground_orders(strip: Strip, stars: Sequence[Star]) -> list[GroundOrder]:
    """How the ground of each star lies on the grid."""
    delays = [hub_delay(strip.nominal, strip.surface, s.hub, stars[0].hub) for s in stars]
    return ordered_ground([s.t_hub[s.present.any(axis=1)] for s in stars], delays, strip.grid)


def with_blur_errors(strip: Strip, state: StripState) -> PriorModel:
    """The model with the errors of what was taken off matches for jitter within the stages of TDI.

    Notes
    -----
    What that moved the motion by is known to BLUR_ERROR of itself at every frequency, in any phase: its
    spectrum times the square of that is the error's.
    """
    stars, estimate = [r.star for r in state.records], state.estimate
    if not any(s.blur_px is not None and s.blur_px.any() for s in stars):
        return state.model
    blurs = [
        np.where(np.isfinite(s.residual_px), 0.0 if s.blur_px is None else s.blur_px, np.nan) for s in stars
    ]
    orders, relief = _ground_orders(strip, stars), estimate.relief is not None
    nodes, (first, last) = strip.grid.nodes, matched_span(stars)
    inside = (nodes >= first) & (nodes <= last)
    directions = estimate.hidden_directions(estimate.hidden_drifts)[inside]

    def moved_by(blurs: Sequence[Array]) -> MotionSpectrum:
        data = normal_equations(stars, blurs, strip.grid, orders=orders, relief=relief, slow=state.slow)
        moved = less_directions(estimate.moved_by(data)[inside], directions, strip.scale)
        return spectrum(Motion(nodes[inside], moved))

    found = [moved_by([b * component for b in blurs]) for component in np.eye(2)]
    density = BLUR_ERROR**2 * (found[0].psd + found[1].psd)
    return state.model.with_errors([_lines(found[0].frequency, one) for one in density.T])


def _lines(frequency: Array, psd: Array) -> TabulatedPsd | None:
    """Where most of a density is, at most MOST_LINES frequencies of it; drifts are not its own."""
    own = np.where(np.arange(len(psd)) >= 2, psd, 0.0)
    kept = own >= max(np.sort(own)[-min(MOST_LINES, len(own))], 1e-30)
    near = kept.copy()
    near[1:] |= kept[:-1]
    near[:-1] |= kept[1:]
    if not kept.any():
        return None
    return TabulatedPsd(tuple(frequency[near].tolist()), tuple(np.where(kept, own, 0.0)[near].tolist()))


def _same_jumps(before: Array | None, after: Array | None) -> bool:
    """Whether the motion was let jump at the same instants."""
    none = np.zeros(1, dtype=bool)
    old, new = (none if w is None or (w >= 1.0).all() else w < 1.0 for w in (before, after))
    return np.array_equal(old, new)


def _same_sizes(before: SlowErrors | None, after: SlowErrors | None) -> bool:
    """Whether errors that wander are about as large as they were."""
    if before is None or after is None:
        return before is after
    return bool(np.allclose(after.sizes, before.sizes, rtol=SAME_SIZE, atol=LEAST))


def _moved(stars: Sequence[Star], before: Sequence[Array], after: Sequence[Array]) -> float:
    """By how much residuals changed, rms over the windows that count, in sigmas of their matches."""
    total, count = 0.0, 0
    for star, old, new in zip(stars, before, after, strict=True):
        present = star.present
        for some in star.stretches():
            used, covariance = present[some], star.covariance_px[some]
            variance = covariance[..., 0, 0] + covariance[..., 1, 1]
            total += float((((new[some] - old[some]) ** 2).sum(axis=-1)[used] / variance[used]).sum())
            count += int(used.sum())
            let_go()
    return float(np.sqrt(total / max(count, 1)))


def gauge(
    strip: Strip, angles: tuple[Autoregressive, Autoregressive, Autoregressive], *, held: bool = True
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """How far constants and even drifts may lie from the reference attitude, as it is known.

    Those of roll and pitch are `held` where the attitude puts them, or not (`JointPrior.ample`). Where
    nothing is given, yaw may have as large a mean and drift as the process of its motion, one of `angles`,
    has of itself: that of a narrow field is seen in pixels of its edge, and so goes ten times as far and as
    fast as that of a wide one.
    """
    count = strip.grid.count
    half = 0.5 * strip.grid.step * (count - 1)
    usual, given = strip.known.usual(), (strip.known.attitude_sigma, strip.known.rate_sigma)
    yaw = [
        max(sigma, math.sqrt(angles[2].variance_of(shape)) if stated is None else 0.0)
        for sigma, stated, shape in zip(
            (usual[0], half * usual[1]), given, np.ascontiguousarray(mean_and_drift(count).T), strict=True
        )
    ]
    within = (CONSTANT_SIGMA, DRIFT_SIGMA) if held else 2 * ((math.inf,) * 3,)
    constant, drift = (
        (min(most[0], sigma), min(most[1], sigma), turn)
        for most, sigma, turn in zip(within, (usual[0], half * usual[1]), yaw, strict=True)
    )
    return constant, drift


def unknown_curves(
    angles: tuple[Autoregressive, Autoregressive, Autoregressive], nodes: Array
) -> tuple[float, float, float]:
    """Sigma (rad) of a parabola of each axis beside the process of its motion: what that lacks, if anything.

    Notes
    -----
    An autoregression looks back some tens of nodes; over thousands its slowest motions are several times too
    small or too large. Where images see them nothing hangs on that, but the parabola of roll that belongs to
    a drift of yaw they may not see. Nothing moves less slowly than faster: the parabola is taken to be as
    large as the curves of the next three degrees, which the images do see.
    """
    u = np.linspace(-1.0, 1.0, len(nodes))
    curves = np.polynomial.legendre.legfit(u, nodes, 5)[3:]
    parabola = (1.5 * u**2 - 0.5) * 5.0 / len(u)
    sizes = np.mean(curves**2, axis=0) - [process.variance_of(parabola) for process in angles]
    roll, pitch, yaw = np.sqrt(np.maximum(sizes, 0.0))
    return float(roll), float(pitch), float(yaw)


def reweighted_rows(
    rows: Sequence[SensorRows], estimate: JointEstimate, *, believed: bool
) -> list[SensorRows]:
    """Sensor rows weighed by what the estimate leaves of them."""
    if estimate.ties is None:
        return list(rows)
    own = own_parts(estimate.ties, estimate.own)
    nodes = estimate.unknowns()
    return [
        reweighted(r, estimate.grid, nodes, estimate.statics, part, believed=believed)
        for r, part in zip(rows, own, strict=True)
    ]


def _correlations(stars: Sequence[Star], post: Sequence[Array]) -> list[Array]:
    """Error correlation of every star; one too small to learn its own takes the sizes of the largest."""
    found = [estimate_correlation(s, r) for s, r in zip(stars, post, strict=True)]
    starts = [shared_image_correlation(s.t.shape[1]) for s in stars]
    learned = [not np.array_equal(c, start) for c, start in zip(found, starts, strict=True)]
    largest = int(np.argmax([s.present.sum() * ok for s, ok in zip(stars, learned, strict=True)]))
    size = np.sqrt(np.diag(found[largest]).reshape(-1, 2).mean(axis=0))
    out = []
    for c, ok in zip(found, learned, strict=True):
        factor = np.ones(len(c)) if ok else np.tile(size, len(c) // 2)
        out.append(c * np.outer(factor, factor))
    return out
