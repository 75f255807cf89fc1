"""S1: the line of sight from the bands of one strip, as one call.

``recover_line_of_sight`` reads like figure 15 of the document: select and predict windows,
match, residual, angular variations, integrate, refined estimate, and again with windows
compensated by the motion found, until it no longer changes.

Not here: the strip itself (``motion/strip/strip.py``), the estimate of one pass
(``motion/strip/estimate.py``), files (``io/``), the report (``report/``), frames of a matrix instrument
(``frame_attitude.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError, computes
from sightline.estimation.likelihood import WORK
from sightline.estimation.search import CLOSELY, ORDER, SETTLED
from sightline.execution import (
    Progress,
    Step,
    give_back_memory,
    no_step,
    one_blas_thread,
    silent,
    slices,
    steps_of,
)
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.checks import not_negative
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.rasters import CACHE_MIB, raster_cache
from sightline.imaging.source import in_memory
from sightline.matching.matches import NOT_CHOSEN, OUTSIDE, STATUS_NAMES
from sightline.motion.band import Band
from sightline.motion.measure.match_noise import single_errors
from sightline.motion.measure.pair_order import best_first, pair_correlations
from sightline.motion.measure.plan import MatchingPlan, hub_windows
from sightline.motion.measure.stars import StarRecord, learned_filters, match_star
from sightline.motion.results import (
    ControlFit,
    LineOfSight,
    StaticEstimate,
    TimeCovariance,
    without_common_ground,
)
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.strip.alternatives import mistake
from sightline.motion.strip.checks import check_images, checked, farthest_control, farthest_sensor
from sightline.motion.strip.control_only import alone, check_alone, controlled_lines, solve_by_control
from sightline.motion.strip.estimate import (
    DRAFT_ROUNDS,
    ROUNDS,
    StripState,
    initial_attitude,
    observed_lines,
    solve_strip,
    with_blur_errors,
)
from sightline.motion.strip.fusion import uses
from sightline.motion.strip.hyper import KnownContent, PriorModel, fit_prior_model
from sightline.motion.strip.joint import (
    INSTANTS,
    JointEstimate,
    angles_at,
    directions_at,
    less_directions,
    nodes_on,
    variance_between_nodes,
)
from sightline.motion.strip.lost_bands import ENOUGH_KEPT, like_none, spoilt_hub, without_lost
from sightline.motion.strip.methods import by_method, check_method, strip_differences
from sightline.motion.strip.relief import RowRelief
from sightline.motion.strip.shape import (
    ask_for_shapes,
    shape_warnings,
    unknown_shapes,
    windows_over_bends,
    with_shapes,
)
from sightline.motion.strip.strip import RecoverOptions, Shapes, Strip, finer_rows, prepared, suited
from sightline.motion.strip.viewing_axes import (
    turned_amplitudes,
    turned_band,
    turned_directions,
    turned_errors,
    turned_spectra,
    turned_star,
)
from sightline.motion.strip.warnings import control_warnings, strip_warnings
from sightline.motion.strip.withheld import (
    contradictions,
    judged,
    unjudged,
    withheld_numbers,
    without_pairs,
)
from sightline.motion.tones import hann
from sightline.result import makes_result
from sightline.stages import Stages
from sightline.writing import let_go

Array = NDArray[np.float64]

#: Error of the first linearisation as a share of the residual: products of mrad-sized angles and of the shift
#: between the predicted and the actual line with the rate of the motion, seen at 5-7 % of residuals of
#: 1-4 px.
LINEARISATION_SHARE = 0.07
#: Drafts of wide strips: how much coarser their grid is (at 2 it would bend tones above 100 Hz, of which the
#: one pass on the fine grid leaves a trace), and how far from settled (in tolerances) they may stop: the last
#: pass linearises once more, which divides what is left by about four.
DRAFT_NODES, DRAFT_TOLERANCE = 1.5, 3.0
#: Most of what a pass of a draft changed that is left for the next one to change: a ninth to a fifteenth on
#: strips of 3,000 columns, more where the motion is large against the search.
DRAFT_LEFT = 0.25
#: What the spectra of drafts cost against those of the last pass.
DRAFT_WORK = 0.5
#: A given spectrum that moves the motion by more of its sigmas is not that of the motion.
FOREIGN_SPECTRUM = 3.0
#: Share of a change of the motion that lies about one frequency: most of it.
MOST_OF_CHANGE = 0.5
#: Windows by which shapes of detector lines are found: narrow, and of enough lines to match well.
SHAPE_WINDOW = (10, 32)
#: px of all bands together that are read at once (32 MB).
MOST_AT_ONCE = 8_000_000
#: Of larger ones, lines (of four bytes a pixel) that are kept decoded, two rows of tiles of each image, and
#: the least MiB that are.
LINES_AT_HAND, LEAST_CACHE_MIB = 1024, 8
#: Cosine of the angle, 18 degrees, from which on a camera looks far off the body's z: the turn about its line
#: of sight then holds a third of the body's angles across it.
ASIDE = 0.95
#: Fewer matches than these, or first ones than this share of the windows tried, are such as chance keeps: the
#: prediction is wrong, texture is not what is missing.
FEWEST_KEPT, MIN_KEPT_SHARE = 20, 0.02
#: How more windows are chosen, by how they are.
CHOOSE_MORE = {
    "textured": "lower `strength`",
    "spread": "raise `points`",
    "listed": "name more `features`, of ground that several bands see",
}
#: Where fewer windows than half of those tried are kept, or a band looks like none, the first search goes so
#: many times as far, up to so many px, and counts if it keeps so many times as many, or finds the band.
FARTHER, FARTHEST, MORE_KEPT = 3, 32, 1.3
#: Times that what nothing was found of for longer than the memory of the motion's model is sought again, each
#: of which must find so much more of all windows: over clouds and water there is nothing to be found.
SOUGHT_AGAIN, FOUND_AGAIN = 3, 0.005
#: Stages that are kept: the state after so many passes, after the last one of a wide strip, and after that
#: under a given spectrum.
_AFTER, _WHOLE, _GIVEN = "pass-{}", "pass-last", "pass-given"


@dataclass(frozen=True, eq=False)
class _Passed:
    """What is known after a pass.

    `changes` are by how much each pass so far changed the motion, `at` (Hz) about which frequency most of the
    last of them lies, if about any, `left` by how much a given spectrum did;
    `shapes` are those that were found of detector lines, `order` that in which windows are cut from the
    bands, `window` and `step` what they were matched by, or will be in the next pass.
    """

    name: str
    state: StripState
    changes: tuple[float, ...] = ()
    left: float = 0.0
    at: float = 0.0
    shapes: Shapes = ()
    order: tuple[int, ...] = ()
    window: tuple[int, int] = RecoverOptions.window
    step: int = RecoverOptions.step

    def matched_by(self, options: RecoverOptions) -> _Passed:
        """The same with the windows and rows of these options."""
        return replace(self, window=options.window, step=options.step)


@makes_result
@one_blas_thread
@computes("the motion of the line of sight")
def recover_line_of_sight(
    bands: Sequence[Band],
    surface: Surface,
    *,
    height_sigma: float = 0.0,
    sensors: Sequence[AttitudeSensor] = (),
    control_points: ControlSightings | None = None,
    known: KnownContent | None = None,
    options: RecoverOptions | None = None,
    progress: Progress | None = None,
    stages: Stages | None = None,
) -> LineOfSight:
    """Attitude of the platform against time from the bands of one strip, with covariance.

    Parameters
    ----------
    bands : sequence of Band
        Two or more images of one scene, a lag apart, with their nominal cameras; or one, with control points.
    surface : Surface
        What the lines of sight meet; a DEM removes the parallax of relief.
    height_sigma : float
        m; what is not known of the surface's height: the sigma then owns what relief can hide.
    sensors : sequence of AttitudeSensor
        Star trackers and gyros: where matching starts, and observations in the same estimate.
    control_points : ControlSightings, optional
        Likewise.
    known : KnownContent, optional
        Frequencies of the motion that are known beforehand.
    options : RecoverOptions, optional
    progress : callable, optional
        Called with what is being done, in words.
    stages : Stages, optional
        Finished passes that a run which was stopped has left, and where those of this run are kept.

    Returns
    -------
    LineOfSight

    Raises
    ------
    InputError
        One band without control points, images that do not fit their cameras, or no sigma of heights.
    EstimationError
        The images have no ground in common, or cannot be matched; too few control points of one band.

    Notes
    -----
    S1, figure 15. The motion is the joint maximum a posteriori of roll, pitch, yaw, band offsets and
    rotations (``motion/strip/joint.py``) with priors by marginal likelihood (``motion/strip/hyper.py``); with
    ``options.method`` that of one of S1's own estimators (``motion/strip/methods.py``). That of one band is
    what its control points say, and between them what their spectrum lets believe
    (``motion/strip/control_only.py``): the height's sigma has no part in it.
    """
    not_negative(height_sigma, "height_sigma", "m")
    if not bands or not all(isinstance(band, Band) for band in bands):
        given = ", ".join(sorted({type(band).__name__ for band in bands})) or "none"
        raise InputError(f"`bands` must be two or more `sightline.Band` (image and camera), got {given}")
    if not hasattr(surface, "intersect"):
        raise InputError(f"`surface` must be a Plane, Ellipsoid or Dem, got {surface!r}")
    options = options or RecoverOptions()
    tell = progress or silent
    strip, options = ready_strip(bands, surface, sensors, control_points, known, options)
    if alone(strip.bands):
        tell("from control points to the motion")
        return controlled_line_of_sight(strip)
    stages = stages or Stages()
    check_images(strip)
    stages.depend([bands, surface, height_sigma, sensors, control_points, known, options])
    with _images_at_hand(strip) as strip:
        strip, state, result = joint_line_of_sight(strip, options, height_sigma, tell, stages)
    if options.method == "joint":
        return result
    tell(f"from the angular differences to the motion: {options.method}")
    return by_method(strip, state, result, options.method)


def ready_strip(
    bands: Sequence[Band],
    surface: Surface,
    sensors: Sequence[AttitudeSensor],
    control_points: ControlSightings | None,
    known: KnownContent | None,
    options: RecoverOptions,
) -> tuple[Strip, RecoverOptions]:
    """What `recover_line_of_sight` begins with; its errors, as far as files and geometry tell them.

    The options come back with the rows of windows that the strip is matched in.
    """
    check_alone(bands, control_points, options)
    options = suited(options, bands, surface)
    strip = replace(
        prepared(bands, surface, options),
        sensors=tuple(sensors),
        control=control_points,
        known=known or KnownContent(),
    )
    withheld = withheld_numbers(strip, options.withhold)
    strip = replace(strip, views=without_pairs(strip, withheld), withheld=tuple(withheld))
    strip = checked(strip, options)
    check_method(options.method, strip)
    return strip, options


@contextmanager
def _images_at_hand(strip: Strip) -> Iterator[Strip]:
    """The strip with its images in memory where they are small: windows are read from them over and over.

    Of others the lines about a window are: GDAL would fill its whole cache with those that were left behind.
    """
    shapes = [band.image.shape for band in strip.bands]
    if sum(lines * columns for lines, columns in shapes) > MOST_AT_ONCE:
        lines = 4 * LINES_AT_HAND * sum(columns for _, columns in shapes)
        with raster_cache(min(max(lines, LEAST_CACHE_MIB << 20), CACHE_MIB << 20)):
            yield strip
        return
    bands = (replace(band, image=in_memory(band.image)) for band in strip.bands)
    yield replace(strip, bands=tuple(bands))


def joint_line_of_sight(
    strip: Strip, options: RecoverOptions, height_sigma: float, tell: Progress, stages: Stages | None = None
) -> tuple[Strip, StripState, LineOfSight]:
    """All passes over a strip that was prepared and checked: its last state, and that as a result."""
    stages = stages or Stages()
    if options.hybridise == "iterative":
        tell("comparing pairs: the best correlated one comes first")
        strip = replace(strip, order=_best_first(strip, options))
    wide = strip.nominal[0].columns // options.window[1] > options.draft_blocks
    draft = replace(strip, grid=strip.grid.coarser(DRAFT_NODES), draft=True) if wide else strip
    tolerance = options.tolerance * (DRAFT_TOLERANCE / DRAFT_LEFT if draft.draft else 1.0)
    names = [_AFTER.format(number) for number in range(options.passes + 1)]
    names += [_WHOLE] * wide + [_GIVEN] * (strip.known.spectra is not None)
    passed = _resumed(stages, names)
    if passed is None:
        passed = _kept(stages, names, _begun(draft, options, height_sigma, tell, names[0]))
    strip, draft = (with_shapes(replace(s, order=passed.order), passed.shapes) for s in (strip, draft))
    options = replace(options, window=passed.window, step=passed.step)
    while len(passed.changes) < options.passes:
        # the first of the changes has no spectrum of its own yet
        if len(passed.changes) > 1 and passed.changes[-1] < tolerance:
            break
        number, state = len(passed.changes), _light(passed.state)
        passed = replace(passed, state=state)
        if number and not draft.draft:
            options = finer_rows(options, strip.bands, [record.star for record in state.records])
        step = steps_of(tell, f"pass {number + 1} of at most {options.passes}: matching")
        refined = _compensated_pass(draft, state, number, options, height_sigma, tell, step)
        change = _change(draft, state, refined)
        at = _changed_about(draft, state, refined) if change > 1.0 else 0.0
        # without its factors, which lie in memory and on disk as long as it does
        refined = replace(refined, estimate=replace(refined.estimate))
        changes = (*passed.changes, change)
        passed = replace(passed, name=names[number + 1], state=refined, changes=changes, at=at)
        passed = _kept(stages, names, passed.matched_by(options))
        del refined  # the next pass holds the windows of this one but for what is heavy of them
    if wide and passed.name not in (_WHOLE, _GIVEN):
        step = steps_of(tell, "last pass: matching over the whole field")
        passed = replace(passed, state=_light(passed.state))
        options = finer_rows(options, strip.bands, [record.star for record in passed.state.records])
        state = _compensated_pass(strip, passed.state, options.passes, options, height_sigma, tell, step)
        passed = _kept(stages, names, replace(passed, name=_WHOLE, state=state).matched_by(options))
    if strip.known.spectra is not None and passed.name != _GIVEN:
        step = steps_of(tell, "last pass: under the given spectrum")
        found = passed.state
        state = _compensated_pass(
            strip, found, options.passes, options, height_sigma, tell, step, strip.given_model()
        )
        left = _change(strip, found, state)
        passed = _kept(stages, names, replace(passed, name=_GIVEN, state=state, left=left))
    state = passed.state
    warnings: tuple[str, ...] = ()
    if passed.left > FOREIGN_SPECTRUM:
        warnings = (
            "the spectrum that is given does not hold the motion that the images show: without it they "
            f"give another, {passed.left:.3g} sigma away; check [known_motion] psd, or leave it out",
        )
    if len(strip.bands) > 2:
        tell("predicting what was not used")
    give_back_memory()
    withheld = judged(strip, state, options)
    give_back_memory()
    result = replace(_result(strip, state, passed, options, draft), withheld=withheld)
    differences = tuple(one.turned(strip.turn) for one in strip_differences(strip, state))
    tdi = any(band.camera.stages is not None for band in strip.bands)
    warnings = (*result.warnings, *warnings, *contradictions(withheld, tdi=tdi, sensors=bool(result.sensors)))
    warnings = (*warnings, *unjudged(options.withhold, withheld))
    return strip, state, replace(result, differences=differences, warnings=warnings)


def controlled_line_of_sight(strip: Strip) -> LineOfSight:
    """The motion of a strip of one band that was prepared and checked, from its control points."""
    strip, state, fit = solve_by_control(strip)
    passed = _Passed("", state)
    return replace(_result(strip, state, passed, RecoverOptions(), strip, fit), control=fit)


def _resumed(stages: Stages, names: Sequence[str]) -> _Passed | None:
    """The last pass that an earlier run has finished; None where there is none."""
    for name in reversed(names):
        passed = stages.held(name, _Passed, writeable=True)
        if passed is not None:
            return passed
    return None


def _kept(stages: Stages, names: Sequence[str], passed: _Passed) -> _Passed:
    """A pass that was finished now, kept in the place of those before it."""
    stages.put(passed.name, passed)
    for name in names:
        if name != passed.name:
            stages.drop(name)
    return passed


def _light(state: StripState) -> StripState:
    """A state without what only its own solution needed: the windows of two passes are not held together."""
    records, none = [], np.zeros((0, 0, 2, 0), dtype=np.float32)
    for record in state.records:
        star = replace(record.star, by_hub=none, by_partner=none, by_static=none, uneven=None, uneven_at=None)
        records.append(replace(record, star=star))
    return replace(
        state,
        estimate=state.estimate.alone(),
        records=tuple(records),
        with_relief_px=(),
        before_px=(),
    )


def _best_first(strip: Strip, options: RecoverOptions) -> tuple[int, ...]:
    """The bands in the order in which pairs are taken one after the other."""
    images = [band.image for band in strip.bands]
    window, search = options.first_window, options.search_px
    allowed = set(strip.views)
    return best_first(pair_correlations(images, strip.nominal, strip.surface, window, search, allowed))


def _begun(strip: Strip, options: RecoverOptions, height_sigma: float, tell: Progress, name: str) -> _Passed:
    """The first state, with the shapes of detector lines that it shows."""
    strip, state = _begin(strip, options, height_sigma, tell)
    shapes = _found_shapes(strip, state, options, tell)
    if shapes:
        strip, state = _begin(with_shapes(strip, shapes), options, height_sigma, tell)
    begun = _Passed(name, state, shapes=shapes, order=strip.order)
    return begun.matched_by(windows_over_bends(options, strip.bands))


def _begin(
    strip: Strip, options: RecoverOptions, height_sigma: float, tell: Progress
) -> tuple[Strip, StripState]:
    """The first state: from all bands, or from the first pair, then with one band after the other.

    With the strip, whose bands may have another order (`_compared`).
    """
    if options.hybridise == "global":
        return _first_pass(strip, options, height_sigma, tell)
    _, state = _first_pass(replace(strip, order=strip.order[:2]), options, height_sigma, tell)
    for count in range(3, len(strip.order) + 1):
        some = replace(strip, order=strip.order[:count])
        if not any((some.order[-1], earlier) in strip.views for earlier in some.order[:-1]):
            continue  # the first of a pair that is matched with none of the others: it comes with its partner
        name = strip.bands[some.order[-1]].name
        step = steps_of(tell, f"band {count} of at most {len(strip.order)}: adding {name}")
        # the second time about where the band was found: a linearisation about pixels too far away lets what
        # is hidden drift, and the next band would be sought there
        for search in (options.search_px, (0, 0)):
            plan = some.plan(options, options.first_window, options.first_window[0], search)
            nodes, statics = state.estimate.nodes, state.estimate.statics
            records = tuple(_with_floor(r) for r in _match(some, nodes, statics, plan, step=step))
            state = solve_strip(some, records, nodes, statics, some.broad, height_sigma, before=state)
    return strip, state


def _first_pass(
    strip: Strip, options: RecoverOptions, height_sigma: float, tell: Progress
) -> tuple[Strip, StripState]:
    """Search about the nominal prediction with large windows; solve under a broad prior."""
    statics = np.zeros(len(strip.parameters))
    nodes = initial_attitude(strip, statics)
    plan = strip.plan(options, options.first_window, 2 * options.first_window[0], options.search_px)
    strip, records, searched = _searched(strip, nodes, statics, plan, tell)
    records = tuple(_with_floor(r) for r in records)
    kept, tried = _windows(records)
    if kept < max(FEWEST_KEPT, MIN_KEPT_SHARE * tried):
        _check_for_one_mistake(strip, options, f"{kept} of {tried} windows kept")
        inside, way = _inside(records), options.selection.way
        if way != "all" and inside < 2 * FEWEST_KEPT:
            raise EstimationError(
                f"[matching] select = {way!r} leaves {inside} windows of bands that lie in both images "
                f"({_counts(records)}), of which {kept} were kept; {FEWEST_KEPT} are needed: "
                f"{CHOOSE_MORE[way]}, or leave `select` out"
            )
        raise EstimationError(
            f"the images do not match where the cameras say: {kept} of {tried} windows kept within "
            f"{searched} px of the prediction ({_counts(records)}); check look angles, line times "
            "and that the bands overlap, or search farther: [matching] search_px"
            f"{farthest_control(strip)}{farthest_sensor(strip, searched)}"
        )
    # robust weights leave some out, which are found every time
    found = _share_kept(records)
    state = solve_strip(strip, records, nodes, statics, strip.broad, height_sigma, before=None)
    for _ in range(SOUGHT_AGAIN):
        # over less than half of what the prior looks back it leads to what was lost by itself
        if _longest_lost(state.records) <= 0.5 * ORDER * strip.grid.step:
            break
        # where a long strip moved out of reach of the search, what its neighbours show leads there
        nodes, statics = state.estimate.nodes, state.estimate.statics
        step = steps_of(tell, "first pass: searching where nothing was found")
        records = tuple(_with_floor(r) for r in _match(strip, nodes, statics, plan, step=step))
        _some_left(strip, state, records, options)
        before, found = found, _share_kept(records)
        if found < before + FOUND_AGAIN:
            break
        state = solve_strip(strip, records, nodes, statics, strip.broad, height_sigma, before=state)
    # once more about the motion found: nearly all that was left of the first linearisation is gone before
    # dense matching
    plan = replace(strip.plan(options, options.first_window, options.first_window[0]), rough=True)
    step = steps_of(tell, "first pass: matching once more")
    nodes, statics = state.estimate.nodes, state.estimate.statics
    records = _match(strip, nodes, statics, plan, records, step, learned=True)
    records = tuple(_with_floor(r) for r in records)
    _some_left(strip, state, records, options)
    return strip, solve_strip(strip, records, nodes, statics, strip.broad, height_sigma, before=state)


def _searched(
    strip: Strip, nodes: Array, statics: Array, plan: MatchingPlan, tell: Progress
) -> tuple[Strip, tuple[StarRecord, ...], tuple[int, int]]:
    """The first matches, and how far (lines, columns) px they were searched: farther where some are lost.

    A turn about the line of sight moves bands that look ahead of a narrow line far across it: of several
    bands it may be one that is out of reach.
    """
    strip, records = _compared(strip, nodes, statics, plan, tell)
    lines, columns = (max(min(FARTHER * px, FARTHEST), px) for px in plan.search_px)
    lost = like_none(records, len(strip.bands))
    if (_share_kept(records) >= ENOUGH_KEPT and not lost.any()) or (lines, columns) == plan.search_px:
        return strip, records, plan.search_px
    step = steps_of(tell, f"first pass: searching within {lines} lines and {columns} columns")
    farther = _match(strip, nodes, statics, replace(plan, search_px=(lines, columns)), step=step)
    more = _share_kept(farther) / max(_share_kept(records), 1e-9)
    # among so many places a quarter of the windows matches by chance: half of them do not
    found = lost & ~like_none(farther, len(strip.bands), ENOUGH_KEPT)
    better = more > MORE_KEPT or (found.any() and more > 1.0)
    return strip, farther if better else records, (lines, columns)


def _compared(
    strip: Strip, nodes: Array, statics: Array, plan: MatchingPlan, tell: Progress
) -> tuple[Strip, tuple[StarRecord, ...]]:
    """The first matches; where the band that others are compared through looks like none, it comes last."""
    records = _match(strip, nodes, statics, plan, step=steps_of(tell, "first pass: wide search"))
    best = strip, records
    for _ in range(len(strip.bands) - 2):
        hub = spoilt_hub(records, len(strip.bands))
        if hub is None:
            break
        strip = replace(strip, order=(*(band for band in strip.order if band != hub), hub))
        step = steps_of(tell, f"first pass: {strip.bands[hub].name} matches nothing, comparing the others")
        records = _match(strip, nodes, statics, plan, step=step)
        if _share_kept(records) > MORE_KEPT * _share_kept(best[1]):
            best = strip, records
    return best


def _found_shapes(strip: Strip, state: StripState, options: RecoverOptions, tell: Progress) -> Shapes:
    """Shapes of detector lines that are not given, where the first matches show any, from narrow windows.

    A line that is not straight spoils what the first pass found: the narrow windows are sought anew.
    """
    if not ask_for_shapes(strip, state):
        return ()
    statics = np.zeros(len(strip.parameters))
    nodes = initial_attitude(strip, statics)
    plan = strip.plan(options, SHAPE_WINDOW, SHAPE_WINDOW[0], options.search_px)
    step = steps_of(tell, "looking for the shape of detector lines")
    records = _match(strip, nodes, statics, replace(plan, most_blocks=0), step=step)
    return unknown_shapes(strip, records, strip.cameras(nodes, statics), state.height_sigma)


def _counts(records: Sequence[StarRecord]) -> str:
    """How many windows ended how, the most frequent first: ``"150 low score, 90 outside"``."""
    if not records:
        return "no two of them see the same ground"
    numbers = np.bincount(np.concatenate([r.status.ravel() for r in records]), minlength=len(STATUS_NAMES))
    order = np.argsort(-numbers, kind="stable")
    return ", ".join(f"{numbers[code]} {STATUS_NAMES[code]}" for code in order if numbers[code])


def _check_for_one_mistake(strip: Strip, options: RecoverOptions, seen: str) -> None:
    """EstimationError where a pair would match but for a mistake in its description; `seen` is in words."""
    words = mistake(strip.bands, strip.surface, options.search_px)
    if words:
        raise EstimationError(
            f"the images do not match where the cameras say ({seen}), but for one mistake they would: {words}"
        )


def _windows(records: Sequence[StarRecord]) -> tuple[int, int]:
    """Windows whose matches were kept, and those that were tried."""
    tried = sum(int((r.status != NOT_CHOSEN).sum()) for r in records)
    return sum(int(r.star.present.sum()) for r in records), tried


def _inside(records: Sequence[StarRecord]) -> int:
    """Windows that were tried and lie in both images."""
    return sum(int(((r.status != NOT_CHOSEN) & (r.status != OUTSIDE)).sum()) for r in records)


def _share_kept(records: Sequence[StarRecord]) -> float:
    """Share of the windows that were tried, and lie in both images, whose matches were kept."""
    return _windows(records)[0] / max(_inside(records), 1)


def _longest_lost(records: Sequence[StarRecord]) -> float:
    """s; the longest time in which no row of windows has a match, between rows of the same star that have."""
    longest = 0.0
    for star in (record.star for record in records):
        t = star.t_hub[star.present.any(axis=1)]
        longest = max(longest, float(np.diff(np.sort(t)).max(initial=0.0)))
    return longest


def _with_floor(record: StarRecord) -> StarRecord:
    """First-pass matches with the error of linearising about no motion added: it grows with the residual."""
    star = record.star
    size = float(np.sqrt(np.nanmean(star.residual_px**2))) if star.present.any() else 0.0
    floor = (LINEARISATION_SHARE * size) ** 2 * np.eye(2)
    covariance = star.each(lambda own: own + floor, star.covariance_px)
    return replace(record, star=replace(star, covariance_px=covariance))


def _compensated_pass(
    strip: Strip,
    state: StripState,
    number: int,
    options: RecoverOptions,
    height_sigma: float,
    tell: Progress,
    step: Step,
    given: PriorModel | None = None,
) -> StripState:
    """Match again with windows moved by the motion found; refit the prior, or take the one given; solve."""
    nodes, statics = nodes_on(state.estimate, strip.grid), state.estimate.statics
    plan = strip.plan(options, options.window, options.step)
    records = _match(strip, nodes, statics, plan, state.records, step, learned=number > 0)
    records = without_lost(records, len(strip.bands))
    _some_left(strip, state, records, options)
    solved = solve_strip(strip, records, nodes, statics, state.model, height_sigma, before=state)
    _some_left(strip, solved, solved.records, options)
    if given is not None:
        # what it does not hold is no jump
        return solve_strip(
            strip,
            solved.records,
            nodes,
            statics,
            given,
            height_sigma,
            before=state,
            rounds=ROUNDS,
            jumps=False,
        )
    if number == 0 and options.passes > 1:
        # the first linearisation still shows in this pass: a spectrum fitted to it would hold its error
        return solved
    if strip.draft and number > 1:
        # the last pass fits the spectrum anew: until then that of the pass before serves
        return solved
    fitted = steps_of(tell, "fitting the spectrum of the motion")
    model = fit_prior_model(
        [r.star for r in solved.records],
        solved.with_relief_px,
        solved.estimate,
        strip.scale,
        state.model if number > 1 else None,
        solved.jumps(),
        state.model.noise_scale,
        WORK * (DRAFT_WORK if strip.draft else 1.0),
        strip.known.tones,
        fitted,
        SETTLED if strip.draft else CLOSELY,
        near=number > 1,
        # the last pass of a wide strip asks anew, with all windows
        smoothness=not strip.draft and (number <= 1 or number == options.passes),
        aside=bool(abs(strip.turn[2, 2]) < ASIDE),
    )
    if solved.prior.relief is not None:
        model = model.beside_relief(strip.grid.step * strip.grid.count)
    rounds, records = DRAFT_ROUNDS if strip.draft else ROUNDS, solved.records
    del solved  # long strips hold one solution at a time
    return solve_strip(strip, records, nodes, statics, model, height_sigma, before=state, rounds=rounds)


def _some_left(
    strip: Strip, state: StripState, records: Sequence[StarRecord], options: RecoverOptions
) -> None:
    """EstimationError where hardly a window is left, as where a detector line is not straight."""
    if _windows(records)[0] >= FEWEST_KEPT:
        return
    words = shape_warnings(strip, state)
    if not words:
        _check_for_one_mistake(strip, options, "windows of a row do not agree")
        words = ["check look angles, line times and `[surface]`, or clouds hide all"]
    raise EstimationError(f"no windows of a row agree with each other: {'; '.join(words)}")


def _match(
    strip: Strip,
    nodes: Array,
    statics: Array,
    plan: MatchingPlan,
    before: Sequence[StarRecord] = (),
    step: Step = no_step,
    *,
    learned: bool = False,
) -> tuple[StarRecord, ...]:
    """All stars of one pass, by `step` so many windows of all; `before` are those of the pass before.

    `learned`: the filters of pairs are those of the pass before. A pair has one set for all its windows.
    """
    earlier = {(record.star.hub, record.star.images): record for record in before}
    cameras = strip.cameras(nodes, statics)
    images = [band.image for band in strip.bands]
    hubs = hub_windows(cameras, strip.surface, [i.shape for i in images], strip.order, plan, strip.views)
    windows = [len(grid.centres) * len(partners) for _, partners, grid in hubs]
    out: list[StarRecord] = []
    # where too little could be seen, thinned or not compensated yet, it is tried again
    filters = learned_filters(before) if learned else {}
    for hub, partners, grid in hubs:
        done, total = sum(windows[: len(out)]), sum(windows)
        star = match_star(
            images,
            cameras,
            strip.surface,
            hub,
            partners,
            grid,
            strip.parameters,
            plan,
            earlier.get((hub, partners)),
            lambda some, _, done=done, total=total: step(done + some, total),  # type: ignore[misc]
            filters,
        )
        out.append(star)
    return tuple(out)


def _change(strip: Strip, old: StripState, new: StripState) -> float:
    """Change of the motion between passes in units of its sigma, hidden part left out (worst axis)."""
    t = strip.grid.nodes[4:-4:4]
    moved, directions = _moved(strip, old, new, t)
    variance = new.estimate.relative_covariance(t, directions, strip.scale)[:, [0, 1, 2], [0, 1, 2]]
    return float(np.sqrt((moved**2).mean(axis=0) / variance.mean(axis=0)).max())


def _changed_about(strip: Strip, old: StripState, new: StripState) -> float:
    """Frequency (Hz) about which most of a change of the motion in px lies; 0 where it does about none."""
    t = strip.grid.nodes
    moved, _ = _moved(strip, old, new, t)
    power = (np.abs(np.fft.rfft(moved / strip.scale * hann(len(t))[:, None], axis=0)) ** 2).sum(axis=1)
    top = int(np.argmax(power))
    about = power[max(top - 2, 0) : top + 3].sum()
    return top / (len(t) * strip.grid.step) if about > MOST_OF_CHANGE * power.sum() else 0.0


def _moved(strip: Strip, old: StripState, new: StripState, t: Array) -> tuple[Array, Array]:
    """Change (N, 3) of the motion at `t` less its hidden part, and the hidden directions there."""
    hidden = new.estimate.hidden_directions(new.estimate.hidden_drifts)
    directions = directions_at(strip.grid, hidden, t)
    moved = angles_at(new.estimate, t) - angles_at(old.estimate, t)
    return less_directions(moved, directions, strip.scale), directions


def _relief(strip: Strip, state: StripState) -> RowRelief | None:
    """The ground that was found, at the exposures of the image whose rows carry it."""
    estimate = state.estimate
    if estimate.relief is None:
        return None
    hub = state.records[0].star.hub
    camera = strip.nominal[hub]
    first, last = camera.times(np.array([-0.5, camera.lines - 0.5]))
    t = state.ground.seen(strip.grid.nodes)
    rows = (t >= first) & (t <= last)
    return RowRelief(hub, t[rows], estimate.relief[rows], estimate.relief_sigma()[rows])


def _hidden_names(drifts: Sequence[int], turn: Array) -> tuple[str, ...]:
    """Names of the constants, and of the drifts of these axes; some, not all, are of the line of sight's."""
    axes = ("roll", "pitch", "yaw")
    turned = 0 < len(drifts) < 3 and not np.array_equal(turn, np.eye(3))
    about = " about the line of sight's axes" if turned else ""
    return (*(f"constant of {axis}" for axis in axes), *(f"drift of {axes[k]}{about}" for k in drifts))


def _functionals(estimate: JointEstimate, model: PriorModel, t: Array, turn: Array, weights: Array) -> Array:
    """Covariance (K, K) rad^2 of weighted sums (N, 3, K) of the motion at `t`, of what is hidden too."""
    own = np.einsum("pa,npk->nak", turn, weights)
    return estimate.functional_covariance(t, own) + model.unseen_functionals(t, own)


def _result(
    strip: Strip,
    state: StripState,
    passed: _Passed,
    options: RecoverOptions,
    draft: Strip,
    fit: ControlFit | None = None,
) -> LineOfSight:
    """The last state as a result at the lines of the first band, gone on to all exposures."""
    estimate, lines = state.estimate, strip.lines()
    t = strip.nominal[0].times(lines.astype(np.float64))
    turn, drifts = strip.turn, estimate.hidden_drifts
    on_grid = turned_directions(estimate.hidden_directions(drifts), turn)
    hidden = directions_at(strip.grid, on_grid, t)
    covariance = estimate.relative_covariance(t, hidden, strip.scale, turn)
    spectra = state.model.estimated().spectra
    between = np.stack([variance_between_nodes(one, strip.grid, t) for one in spectra], axis=1)
    model = with_blur_errors(strip, state)
    unseen = turn @ np.diag(model.unseen_variance) @ turn.T
    give_back_memory()
    for some in slices(len(t), INSTANTS):
        covariance[some] += turn @ (between[some, :, None] * np.eye(3)) @ turn.T + unseen
        let_go()
    covariance.setflags(write=False)  # nobody else has it: not copied
    motion = Motion(t, angles_at(estimate, t) @ turn.T, covariance)
    statics = tuple(
        StaticEstimate(p.name, p.unit, float(v), float(s), p.sigma)
        for p, v, s in zip(strip.parameters, estimate.statics, estimate.statics_sigma, strict=True)
    )
    observed = observed_lines(strip, state, t) if fit is None else controlled_lines(strip, fit, t)
    cameras = tuple(strip.body_cameras(estimate.nodes, estimate.statics))
    stars = [record.star for record in state.records]
    singles = single_errors(stars, state.post_px)
    stars = [turned_star(replace(s, single=one), turn) for s, one in zip(stars, singles, strict=True)]
    records = tuple(
        without_common_ground(replace(r, star=s), cameras, strip.surface, options.window)
        for r, s in zip(state.records, stars, strict=True)
    )
    for camera in cameras:
        if isinstance(camera, PushbroomCamera):
            camera.forget()
    return LineOfSight(
        motion=motion,
        absolute_sigma=np.sqrt(estimate.absolute_sigma(t, turn) ** 2 + np.diag(unseen)),
        hidden=hidden,
        hidden_names=_hidden_names(drifts, turn),
        hidden_covariance=turned_amplitudes(estimate.hidden_covariance(drifts), turn),
        observed=observed,
        scale=strip.scale,
        ifov=strip.pixel_angle,
        half_field=strip.half_field,
        statics=statics,
        spectra=strip.known.spectra or turned_spectra(state.model.whole(), turn),
        intermodulation=turned_errors(model.products, turn),
        records=records,
        before_px=state.before_px,
        after_px=state.post_px,
        cameras=cameras,
        image_names=tuple(b.name for b in strip.bands),
        changes=passed.changes,
        sensors=() if estimate.ties is None else uses(estimate.ties, estimate.own, estimate.own_sigma),
        band=TimeCovariance(
            strip.grid.nodes, estimate.nodes @ turn.T, turned_band(estimate.covariance_band(), turn)
        ),
        functional_covariance=partial(_functionals, estimate, model, t, turn),
        relief=_relief(strip, state),
        lines=lines,
        warnings=strip_warnings(
            strip,
            state,
            motion,
            observed,
            list(passed.changes),
            options,
            DRAFT_LEFT if draft.draft else 1.0,
            passed.at,
        )
        if fit is None
        else control_warnings(strip, state, motion, observed, fit),
    )
