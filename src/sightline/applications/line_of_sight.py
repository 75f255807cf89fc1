"""S1: the line of sight from the bands of one strip, as one call.

``recover_line_of_sight`` reads like figure 15 of the document: select and predict windows,
match, residual, angular variations, integrate, refined estimate, and again with windows
compensated by the motion found, until it no longer changes.

Not here: files (``io/``), the report (``report/``), frames of a matrix instrument (``frame_attitude.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight, StaticEstimate, TimeCovariance, without_common_ground
from sightline.errors import EstimationError, InputError
from sightline.estimation.likelihood import WORK
from sightline.execution import one_blas_thread
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.matching.match_images import match_images
from sightline.matching.matches import KEPT, NOT_CHOSEN, OUTLIER, OUTSIDE, STATUS_NAMES
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.common_view import Views, common_views
from sightline.motion.consensus import ground_weights
from sightline.motion.fusion import (
    UNSEEN_PX,
    SensorRows,
    attitude_rows,
    control_rows,
    own_parts,
    reweighted,
    tie,
    unfelt_tones,
    uses,
)
from sightline.motion.hyper import BROAD, ORDER, KnownContent, PriorModel, fit_prior_model
from sightline.motion.joint import (
    JointEstimate,
    JointPrior,
    angles_at,
    directions_at,
    innovation_weights,
    interpolation_variance,
    longest_gap,
    nodes_on,
    remove_directions,
    solve_joint,
)
from sightline.motion.match_noise import estimate_correlation, robust_weights, row_weights
from sightline.motion.normal_equations import TimeGrid, modelled, no_information, normal_equations
from sightline.motion.observations import Star, shared_image_correlation
from sightline.motion.pair_order import best_first, pair_correlations
from sightline.motion.predict import MovingCamera, StaticParameter, predict_match
from sightline.motion.relief import hub_delay, relief_length, relief_matters, row_processes
from sightline.motion.sensors import AttitudeSensor, ControlPoints
from sightline.motion.stars import (
    SIMILARITIES,
    WEIGHTINGS,
    MatchingPlan,
    StarRecord,
    hub_windows,
    match_star,
)
from sightline.motion.statics import apply_statics, band_statics
from sightline.motion.viewing_axes import (
    in_axes,
    turned_band,
    turned_directions,
    turned_spectra,
    turned_star,
    viewing_axes,
)
from sightline.motion.windows import window_grid

Array = NDArray[np.float64]
Progress = Callable[[str], None]

#: Error of the first linearisation as a share of the residual: products of mrad-sized angles and of the shift
#: between the predicted and the actual line with the rate of the motion, seen at 5-7 % of residuals of
#: 1-4 px.
LINEARISATION_SHARE = 0.07
#: So many windows, most of them matching on the other side, prove a lag of the wrong sign.
MIN_BACKWARDS = 10
#: Times that matches are weighed by their own scatter and the motion solved again: once a spectrum is fitted
#: in the pass, and in drafts and before.
ROUNDS, DRAFT_ROUNDS = 4, 2
#: Drafts of wide strips: how much coarser their grid is (at 2 it would bend tones above 100 Hz, of which the
#: one pass on the fine grid leaves a trace), and how far from settled (in tolerances) they may stop: the last
#: pass linearises once more, which divides what is left by about four.
DRAFT_NODES, DRAFT_TOLERANCE = 1.5, 3.0
#: Tiles per pair that teach the whitening of drafts, and what their spectra cost against the last ones.
DRAFT_TILES, DRAFT_WORK = 128, 0.3
#: Fewer first matches than this share of the windows tried mean a wrong prediction, not missing texture.
MIN_KEPT_SHARE = 0.02
#: Times that control points are linearised before the first matching.
INITIAL_ROUNDS = 3
#: A sensor whose residuals are so many times its sigma is worth a warning.
DOUBTFUL = 2.0
#: How pairs may be brought together.
HYBRIDISE = ("global", "iterative")
#: Fewer windows than this share kept at the end are worth a warning.
ENOUGH_KEPT = 0.5
#: Matches that span less than this share of the field hardly tell yaw.
ENOUGH_FIELD = 0.3
#: Lines at which the ground of a strip is sought.
GROUND_PLACES = 9


@dataclass(frozen=True)
class RecoverOptions:
    """How the strip is looked at.

    Attributes
    ----------
    first_window, window : (lines, columns)
        px; of the first, searching pass, and of the passes compensated by motion.
    step : int
        Lines between rows of windows in the compensated passes.
    search_px : (lines, columns)
        px; half-range of the first search about the prediction.
    grid_lines : float
        Lines between nodes of the estimated motion.
    passes : int
        At most so many compensated passes.
    draft_blocks : int
        Strips of more windows per row are wide: they have so many at most until the last pass.
    tolerance : float
        Stop when the motion changes by less than this part of its sigma.
    hybridise : str
        How pairs begin: ``"global"``, all at once; ``"iterative"``, the best correlated one, whose motion
        then predicts where to match the next image, and so on (S1, claim 10). Later passes take all.
    selection : Selection
        Which windows are matched (S1, claim 3).
    similarity : str
        What is compared: ``"whitened"`` images, ``"radiometric"``: as they are, ``"gradient"``: their edges.
    weighting : str
        ``"covariance"``: each match counts for what it knows; ``"none"``: all alike, for comparison.
    pairs : tuple of (str, str)
        Names of the pairs of bands that are matched; empty: every pair that shares ground.
    """

    first_window: tuple[int, int] = (10, 100)
    window: tuple[int, int] = (4, 100)
    step: int = 4
    search_px: tuple[int, int] = (8, 8)
    grid_lines: float = 2.0
    passes: int = 4
    draft_blocks: int = 10
    tolerance: float = 0.2
    hybridise: str = "global"
    selection: Selection = field(default_factory=Selection)
    similarity: str = "whitened"
    weighting: str = "covariance"
    pairs: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Refuse an unknown word."""
        if self.hybridise not in HYBRIDISE:
            raise InputError(
                f"`hybridise` is {self.hybridise!r}; allowed are {', '.join(HYBRIDISE)}: all pairs at once, "
                "or one after the other"
            )
        for name, given, allowed in (
            ("similarity", self.similarity, SIMILARITIES),
            ("weighting", self.weighting, WEIGHTINGS),
        ):
            if given not in allowed:
                raise InputError(f"`{name}` is {given!r}; allowed are {', '.join(allowed)}")


@dataclass(frozen=True, eq=False)
class _Strip:
    """What does not change from pass to pass; a `draft` is a wide strip before its last pass.

    `nominal` are the cameras in the axes of the estimate; `turn` (3, 3) leads from them to body axes.
    """

    bands: tuple[Band, ...]
    surface: Surface
    nominal: tuple[PushbroomCamera, ...]
    turn: Array
    parameters: tuple[StaticParameter, ...]
    views: Views
    grid: TimeGrid
    order: tuple[int, ...]
    pixel_angle: float
    half_field: float
    half_width: float
    ground_speed: float
    broad: PriorModel
    sensors: tuple[AttitudeSensor, ...] = ()
    control: ControlPoints | None = None
    known: KnownContent = field(default_factory=KnownContent)
    draft: bool = False

    def plan(
        self, options: RecoverOptions, window: tuple[int, int], step: int, search: tuple[int, int] = (0, 0)
    ) -> MatchingPlan:
        """How a pass matches; drafts of wide strips thin the windows and the tiles of their whitening."""
        if self.draft:
            plan = MatchingPlan(window, step, search, options.draft_blocks, DRAFT_TILES)
        else:
            plan = MatchingPlan(window, step, search)
        return replace(
            plan,
            selection=options.selection,
            similarity=options.similarity,
            weighting=options.weighting,
        )

    @property
    def scale(self) -> Array:
        """(3,) rad; one pixel of roll, of pitch, and of yaw at the edge of the field."""
        return np.array([self.pixel_angle, self.pixel_angle, self.pixel_angle / self.half_field])

    def cameras(self, nodes: Array, statics: Array) -> list[MovingCamera]:
        """Cameras that carry the motion and statics found so far."""
        return self._moved(self.nominal, self._motion(nodes), statics)

    def body_cameras(self, nodes: Array, statics: Array) -> list[MovingCamera]:
        """The same in body axes."""
        motion = self._motion(nodes)
        turned = Motion(motion.t, motion.angles @ self.turn.T)
        return self._moved([band.camera for band in self.bands], turned, statics)

    def _motion(self, nodes: Array) -> Motion:
        half = self.grid.step / 2.0
        t = self.grid.nodes[0] + half * np.arange(2 * self.grid.count - 1)
        return Motion(t, self.grid.interpolate(nodes, t))

    def _moved(
        self, cameras: Sequence[PushbroomCamera], motion: Motion, statics: Array
    ) -> list[MovingCamera]:
        moved = [c.with_trajectory(c.trajectory.with_motion(motion)) for c in cameras]
        return apply_statics(moved, self.parameters, statics)


@one_blas_thread
def recover_line_of_sight(
    bands: Sequence[Band],
    surface: Surface,
    *,
    height_sigma: float = 0.0,
    sensors: Sequence[AttitudeSensor] = (),
    control_points: ControlPoints | None = None,
    known: KnownContent | None = None,
    options: RecoverOptions | None = None,
    progress: Progress | None = None,
) -> LineOfSight:
    """Attitude of the platform against time from the bands of one strip, with covariance.

    Parameters
    ----------
    bands : sequence of Band
        Two or more images of one scene, a lag apart, with their nominal cameras.
    surface : Surface
        What the lines of sight meet; a DEM removes the parallax of relief.
    height_sigma : float
        m; what is not known of the surface's height: the sigma then owns what relief can hide.
    sensors : sequence of AttitudeSensor
        Star trackers and gyros: where matching starts, and observations in the same estimate.
    control_points : ControlPoints, optional
        Likewise.
    known : KnownContent, optional
        Frequencies of the motion that are known beforehand.
    options : RecoverOptions, optional
    progress : callable, optional
        Told in words what is being done.

    Returns
    -------
    LineOfSight

    Raises
    ------
    InputError
        Fewer than two bands, or images that do not fit their cameras.
    EstimationError
        The images have no ground in common, or cannot be matched.

    Notes
    -----
    S1, figure 15. The motion is the joint maximum a posteriori of roll, pitch, yaw, band offsets and
    rotations (``motion/joint.py``) with priors by marginal likelihood (``motion/hyper.py``).
    """
    options = options or RecoverOptions()
    tell = progress or (lambda text: None)
    strip = replace(
        _prepare(bands, surface, options),
        sensors=tuple(sensors),
        control=control_points,
        known=known or KnownContent(),
    )
    if options.hybridise == "iterative":
        tell("comparing pairs: the best correlated one comes first")
        strip = replace(strip, order=_best_first(strip, options))
    wide = strip.nominal[0].columns // options.window[1] > options.draft_blocks
    draft = replace(strip, grid=strip.grid.coarser(DRAFT_NODES), draft=True) if wide else strip
    tolerance = options.tolerance * (DRAFT_TOLERANCE if draft.draft else 1.0)
    state = _begin(draft, options, height_sigma, tell)
    changes: list[float] = []
    for number in range(options.passes):
        tell(f"pass {number + 1}: matching windows compensated by the motion found")
        refined = _compensated_pass(draft, state, number, options, height_sigma, tell)
        changes.append(_change(draft, state, refined))
        state = refined
        if number and changes[-1] < tolerance:  # the first of them has no spectrum of its own yet
            break
    if wide:
        tell("last pass: windows side by side over the whole field")
        state = _compensated_pass(strip, state, options.passes, options, height_sigma, tell)
    return _result(strip, state, changes, options.window)


@dataclass(frozen=True, eq=False)
class _State:
    """What one pass hands to the next."""

    estimate: JointEstimate
    prior: JointPrior
    model: PriorModel
    records: tuple[StarRecord, ...]
    post_px: tuple[Array, ...]
    before_px: tuple[Array, ...]
    relief_length: float

    def jumps(self) -> list[Array]:
        """Instants (s) at which roll, pitch, yaw were let jump."""
        weights = self.prior.innovation_weights
        if weights is None:
            return []
        return [self.estimate.grid.nodes[weights[:, axis] < 1.0] for axis in range(3)]


def _prepare(bands: Sequence[Band], surface: Surface, options: RecoverOptions) -> _Strip:
    """Check the input and lay the time grid."""
    if len(bands) < 2:
        raise InputError(
            f"one image cannot show motion: {len(bands)} band given; two or more bands that see the same "
            "ground a lag apart are needed; add a [[band]]"
        )
    for band in bands:
        expected = (band.camera.lines, band.camera.columns)
        if tuple(band.image.shape) != expected:
            raise InputError(
                f"image and camera of band {band.name!r} differ: image {band.image.shape}, camera {expected} "
                "(lines, columns); give the image its own size in the instrument description"
            )
    pairs = _numbered(options.pairs, bands)
    views = common_views([band.camera for band in bands], surface, pairs)
    axes = viewing_axes([band.camera for band in bands], views)
    cameras = tuple(band.camera if axes is None else in_axes(band.camera, axes) for band in bands)
    parameters = band_statics(
        [b.name for b in bands], [b.offset_sigma_px for b in bands], [b.rotation_sigma for b in bands]
    )
    ends = np.array([[c.times(np.array([-2.0]))[0], c.times(np.array([c.lines + 1.0]))[0]] for c in cameras])
    period = min((ends[k, 1] - ends[k, 0]) / (c.lines + 3) for k, c in enumerate(cameras))
    step = options.grid_lines * period
    start = float(ends[:, 0].min()) - 2 * step
    count = math.ceil((float(ends[:, 1].max()) - start) / step) + 3
    first = cameras[0]
    pixel_angle, half_field = _field(first)
    half_width, ground_speed = _on_ground(first, surface)
    return _Strip(
        bands=tuple(bands),
        surface=surface,
        nominal=cameras,
        turn=np.eye(3) if axes is None else axes.as_matrix(),
        parameters=tuple(parameters),
        views=views,
        grid=TimeGrid(start, step, count),
        order=tuple(range(len(bands))),
        pixel_angle=pixel_angle,
        half_field=half_field,
        half_width=half_width,
        ground_speed=ground_speed,
        broad=BROAD.scaled(pixel_angle, half_field),
    )


def _numbered(pairs: Sequence[tuple[str, str]], bands: Sequence[Band]) -> list[tuple[int, int]] | None:
    """Pairs of names as pairs of numbers of `bands`; None, for all pairs, where none are given."""
    names = [band.name for band in bands]
    for name in (name for pair in pairs for name in pair):
        if name not in names:
            raise InputError(f"`pairs` names the band {name!r}; bands are: {', '.join(names)}")
    return [(names.index(a), names.index(b)) for a, b in pairs] or None


def _field(camera: PushbroomCamera) -> tuple[float, float]:
    """Angle of one pixel and of half the field (rad) of a detector line."""
    directions = camera.detector.directions
    ends = directions[[0, -1]]
    whole = math.acos(float(np.clip(ends[0] @ ends[1], -1.0, 1.0)))
    columns = len(directions)
    return whole / max(columns - 1, 1), whole / 2.0


def _on_ground(camera: PushbroomCamera, surface: Surface) -> tuple[float, float]:
    """Half of the swath (m) and speed of its middle over the ground (m/s), as near the middle as it is seen.

    Sweeps of a spin or a mirror may look past the limb at either end.
    """
    right = camera.columns - 1.0
    centre, step = right / 2.0, max(camera.lines / 10.0, 1.0)
    places = np.linspace(step, max(camera.lines - 1.0 - step, step), GROUND_PLACES)
    for line in sorted(places, key=lambda place: abs(place - (camera.lines - 1) / 2.0)):
        pixels = np.array([[line, 0.0], [line, right], [line - step, centre], [line + step, centre]])
        ground = camera.locate(pixels, surface)
        if np.isfinite(ground).all():
            t = camera.times(pixels[2:, 0])
            speed = float(np.linalg.norm(ground[3] - ground[2]) / (t[1] - t[0]))
            return float(np.linalg.norm(ground[1] - ground[0])) / 2.0, speed
    raise EstimationError(
        "the strip does not meet the surface: its rays miss, or the DEM does not cover it; "
        "check the platform's height and attitude and the extent of the DEM"
    )


def _best_first(strip: _Strip, options: RecoverOptions) -> tuple[int, ...]:
    """The bands in the order in which pairs are taken one after the other."""
    images = [band.image for band in strip.bands]
    window, search = options.first_window, options.search_px
    return best_first(pair_correlations(images, strip.nominal, strip.surface, window, search))


def _begin(strip: _Strip, options: RecoverOptions, height_sigma: float, tell: Progress) -> _State:
    """The first state: from all bands, or from the first pair, then with one band after the other."""
    if options.hybridise == "global":
        return _first_pass(strip, options, height_sigma, tell)
    state = _first_pass(replace(strip, order=strip.order[:2]), options, height_sigma, tell)
    for count in range(3, len(strip.order) + 1):
        some = replace(strip, order=strip.order[:count])
        tell(f"adding {strip.bands[some.order[-1]].name}, predicted by the motion found so far")
        # the second time about where the band was found: a linearisation about pixels too far away lets what
        # is hidden drift, and the next band would be sought there
        for search in (options.search_px, (0, 0)):
            plan = some.plan(options, options.first_window, options.first_window[0], search)
            nodes, statics = state.estimate.nodes, state.estimate.statics
            records = tuple(_with_floor(r) for r in _match(some, nodes, statics, plan))
            state = _solve(some, records, nodes, statics, some.broad, height_sigma, before=state)
    return state


def _first_pass(strip: _Strip, options: RecoverOptions, height_sigma: float, tell: Progress) -> _State:
    """Search about the nominal prediction with large windows; solve under a broad prior."""
    tell("first pass: searching about the nominal prediction")
    statics = np.zeros(len(strip.parameters))
    nodes = _initial_attitude(strip, statics)
    plan = strip.plan(options, options.first_window, 2 * options.first_window[0], options.search_px)
    records = tuple(_with_floor(r) for r in _match(strip, nodes, statics, plan))
    tried = sum(int((r.status != NOT_CHOSEN).sum()) for r in records)
    kept = sum(int(r.star.present.sum()) for r in records)
    if kept < max(20, MIN_KEPT_SHARE * tried):
        backwards = _backwards(strip, options)
        if backwards:
            raise EstimationError(
                f"the lag has the wrong sign: {backwards} match not where the cameras say but as far on the "
                "other side; change the sign of `look_ahead` (forward is positive) or the line times' order"
            )
        raise EstimationError(
            f"the images do not match where the cameras say: {kept} of {tried} windows kept within "
            f"{options.search_px} px of the prediction ({_counts(records)}); check look angles, line times "
            "and that the bands overlap, or search farther: [matching] search_px"
        )
    state = _solve(strip, records, nodes, statics, strip.broad, height_sigma, before=None)
    # once more about the motion found: what was left of the first linearisation is gone before dense matching
    plan = strip.plan(options, options.first_window, options.first_window[0])
    records = _match(strip, state.estimate.nodes, state.estimate.statics, plan)
    records = tuple(_with_floor(r) for r in records)
    return _solve(
        strip, records, state.estimate.nodes, state.estimate.statics, strip.broad, height_sigma, before=state
    )


def _initial_attitude(strip: _Strip, statics: Array) -> Array:
    """Angles (count, 3) that sensors and control points tell before any matching (S1, claim 12)."""
    nodes = np.zeros((strip.grid.count, 3))
    grid = strip.grid
    prior = JointPrior(strip.broad.processes(grid), np.array([p.sigma for p in strip.parameters]))
    nothing = no_information(grid, len(strip.parameters))
    for _ in range(INITIAL_ROUNDS if strip.control is not None else 1):
        rows = _sensor_rows(strip, strip.broad, nodes, statics)
        if not rows:
            return nodes
        nodes = solve_joint(nothing, prior, tie(rows, grid, 3)).nodes
    return nodes


def _sensor_rows(
    strip: _Strip, model: PriorModel, nodes: Array, statics: Array, memory: float = 0.0
) -> list[SensorRows]:
    """Rows of all sensors about the present estimate; `model` tells which tones they may not feel."""
    grid, first = strip.grid, strip.nominal[0]
    span = (grid.start, grid.start + grid.step * (grid.count - 1))
    unseen = (UNSEEN_PX if model is strip.broad else 0.0) * strip.scale
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


def _counts(records: Sequence[StarRecord]) -> str:
    """How many windows ended how, the most frequent first: ``"150 low score, 90 outside"``."""
    if not records:
        return "no two of them see the same ground"
    numbers = np.bincount(np.concatenate([r.status.ravel() for r in records]), minlength=len(STATUS_NAMES))
    order = np.argsort(-numbers, kind="stable")
    return ", ".join(f"{numbers[code]} {STATUS_NAMES[code]}" for code in order if numbers[code])


def _backwards(strip: _Strip, options: RecoverOptions) -> str:
    """Names of the first pair that matches where a lag of the other sign would have it; "" if none."""
    hub = strip.bands[0]
    size = (min(32, hub.image.shape[0]), min(200, hub.image.shape[1]))
    points = window_grid(hub.image.shape, size, size[0]).centres
    for partner in strip.bands[1:]:
        ahead = predict_match(hub.camera, partner.camera, strip.surface, points) - points
        seen = np.isfinite(ahead[:, 0])
        if not seen.any():
            continue
        shift = np.median(ahead[seen], axis=0)
        if abs(shift[0]) < 2 * options.search_px[0]:
            continue
        try:
            mirrored = match_images(
                hub.image, partner.image, points, points - shift, window=size, search_px=options.search_px
            )
        except EstimationError:
            continue
        inside = mirrored.status != OUTSIDE
        if inside.sum() >= MIN_BACKWARDS and mirrored.kept.sum() > 0.5 * inside.sum():
            return f"{hub.name} and {partner.name}"
    return ""


def _with_floor(record: StarRecord) -> StarRecord:
    """First-pass matches with the error of linearising about no motion added: it grows with the residual."""
    star = record.star
    size = float(np.sqrt(np.nanmean(star.residual_px**2))) if star.present.any() else 0.0
    floor = (LINEARISATION_SHARE * size) ** 2 * np.eye(2)
    return StarRecord(replace(star, covariance_px=star.covariance_px + floor), record.status, record.score)


def _compensated_pass(
    strip: _Strip,
    state: _State,
    number: int,
    options: RecoverOptions,
    height_sigma: float,
    tell: Progress,
) -> _State:
    """Match again with windows moved by the motion found; refit the prior; solve."""
    nodes, statics = nodes_on(state.estimate, strip.grid), state.estimate.statics
    plan = strip.plan(options, options.window, options.step)
    records = _match(strip, nodes, statics, plan, state.records)
    solved = _solve(strip, records, nodes, statics, state.model, height_sigma, before=state)
    if number == 0 and options.passes > 1:
        # the first linearisation still shows in this pass: a spectrum fitted to it would hold its error
        return solved
    if strip.known.spectra is not None:
        model = PriorModel(strip.known.spectra)
    else:
        tell("fitting the spectrum of the motion")
        model = fit_prior_model(
            [r.star for r in solved.records],
            solved.post_px,
            solved.estimate,
            strip.scale,
            state.model if number > 1 else None,
            solved.jumps(),
            state.model.noise_scale,
            WORK * (DRAFT_WORK if strip.draft else 1.0),
            strip.known.tones,
        )
    rounds = DRAFT_ROUNDS if strip.draft else ROUNDS
    return _solve(strip, solved.records, nodes, statics, model, height_sigma, before=state, rounds=rounds)


def _match(
    strip: _Strip, nodes: Array, statics: Array, plan: MatchingPlan, before: Sequence[StarRecord] = ()
) -> tuple[StarRecord, ...]:
    """All stars of one pass; `before` are those of the pass before."""
    earlier = {(record.star.hub, record.star.images): record for record in before}
    cameras = strip.cameras(nodes, statics)
    images = [band.image for band in strip.bands]
    hubs = hub_windows(cameras, strip.surface, [i.shape for i in images], strip.order, plan, strip.views)
    return tuple(
        match_star(
            images,
            cameras,
            strip.surface,
            hub,
            partners,
            grid,
            strip.parameters,
            plan,
            earlier.get((hub, partners)),
        )
        for hub, partners, grid in hubs
    )


def _solve(
    strip: _Strip,
    records: tuple[StarRecord, ...],
    nodes: Array,
    statics: Array,
    model: PriorModel,
    height_sigma: float,
    before: _State | None,
    *,
    rounds: int = DRAFT_ROUNDS,
) -> _State:
    """Solve; `rounds` times weigh matches by their scatter, let the motion jump where it did, solve again."""
    grid = strip.grid
    stars = [r.star for r in records]
    measured = [s.residual_px + modelled(s, grid, nodes, statics) for s in stars]
    delays = [hub_delay(strip.nominal, strip.surface, s.hub, stars[0].hub) for s in stars]
    sigmas = np.array([p.sigma for p in strip.parameters])
    unknown_relief = relief_matters(stars, height_sigma)
    prior = JointPrior(model.processes(grid), sigmas)
    if unknown_relief:
        length = before.relief_length if before is not None else 2.0 * strip.half_width
        relief = row_processes(height_sigma, length, strip.half_width, strip.ground_speed, grid)
        prior = replace(prior, relief=relief)
    else:
        length = 0.0

    # errors of a gyro are followed twice as far as the images tie the motion to itself
    longest = 2.0 * max(float(np.nanmax(np.abs(s.t - s.t_hub[:, None]), initial=0.0)) for s in stars)
    rows = _sensor_rows(strip, model, nodes, statics, longest)

    def solution() -> tuple[JointEstimate, list[Array], list[Array]]:
        data = normal_equations(stars, measured, grid, delays=delays, relief=unknown_relief)
        # across a gap longer than its memory an autoregression knows no slope of the drift
        long = longest_gap(data) > ORDER
        apart = model.apart(grid, len(data.ab) // data.block) if long else None
        ties = tie(rows, grid, data.block) if rows else None
        found = solve_joint(data, replace(prior, apart=apart), ties)
        motion_only = [modelled(s, grid, found.nodes, found.statics) for s in stars]
        without = [m - w for m, w in zip(measured, motion_only, strict=True)]
        if not unknown_relief:
            return found, without, without
        whole = [
            modelled(s, grid, found.unknowns(), found.statics, d) for s, d in zip(stars, delays, strict=True)
        ]
        return found, [m - w for m, w in zip(measured, whole, strict=True)], without

    settled = model is not strip.broad
    estimate, post, without = solution()
    for _ in range(rounds):
        ground = ground_weights(stars, post)
        weights = [robust_weights(s, r) * w for s, r, w in zip(stars, post, ground, strict=True)]
        stars = [s.with_weight(w) for s, w in zip(stars, weights, strict=True)]
        stars = [s.with_weight(s.weight * row_weights(s, r)) for s, r in zip(stars, post, strict=True)]
        stars = [
            s.with_correlation(model.grown(c)) for s, c in zip(stars, _correlations(stars, post), strict=True)
        ]
        if settled:
            prior = replace(prior, innovation_weights=innovation_weights(estimate))
            rows = _reweighted(rows, estimate)
        estimate, post, without = solution()
    if unknown_relief:
        length = relief_length(stars, without, height_sigma, strip.half_width)
    kept = tuple(StarRecord(s, r.status, r.score) for s, r in zip(stars, records, strict=True))
    return _State(estimate, prior, model, kept, tuple(post), tuple(measured), length)


def _reweighted(rows: Sequence[SensorRows], estimate: JointEstimate) -> list[SensorRows]:
    """Sensor rows weighed by what the estimate leaves of them."""
    if estimate.ties is None:
        return list(rows)
    own = own_parts(estimate.ties, estimate.own)
    nodes = estimate.unknowns()
    return [
        reweighted(r, estimate.grid, nodes, estimate.statics, part) for r, part in zip(rows, own, strict=True)
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


def _change(strip: _Strip, old: _State, new: _State) -> float:
    """Change of the motion between passes in units of its sigma, hidden part left out (worst axis)."""
    t = strip.grid.nodes[4:-4:4]
    directions = directions_at(strip.grid, new.estimate.hidden_directions(drifts=bool(strip.parameters)), t)
    moved = angles_at(new.estimate, t) - angles_at(old.estimate, t)
    moved = remove_directions(moved, directions, strip.scale)
    variance = new.estimate.relative_covariance(t, directions, strip.scale)[:, [0, 1, 2], [0, 1, 2]]
    return float(np.sqrt((moved**2).mean(axis=0) / variance.mean(axis=0)).max())


def _result(strip: _Strip, state: _State, changes: list[float], window: tuple[int, int]) -> LineOfSight:
    """The last state as a result at the lines of the first band."""
    camera, estimate = strip.nominal[0], state.estimate
    t = camera.times(np.arange(camera.lines, dtype=float))
    free = any(p.sigma > 0 for p in strip.parameters)
    turn = strip.turn
    on_grid = turned_directions(estimate.hidden_directions(drifts=free), turn)
    hidden = directions_at(strip.grid, on_grid, t)
    covariance = estimate.relative_covariance(t, hidden, strip.scale, turn)
    between = np.zeros((len(t), 3, 3))
    for axis, spectrum in enumerate(state.model.spectra):
        between[:, axis, axis] = interpolation_variance(spectrum, strip.grid, t)
    covariance += turn @ between @ turn.T
    motion = Motion(t, angles_at(estimate, t) @ turn.T, covariance)
    statics = tuple(
        StaticEstimate(p.name, p.unit, float(v), float(s), p.sigma)
        for p, v, s in zip(strip.parameters, estimate.statics, estimate.statics_sigma, strict=True)
    )
    names = [f"{kind} of {axis}" for kind in ("constant", "drift") for axis in ("roll", "pitch", "yaw")]
    observed = _observed(strip, state, t)
    cameras = tuple(strip.body_cameras(estimate.nodes, estimate.statics))
    records = [replace(r, star=turned_star(r.star, turn)) for r in state.records]
    return LineOfSight(
        motion=motion,
        absolute_sigma=estimate.absolute_sigma(t, turn),
        hidden=hidden,
        hidden_names=tuple(names[: hidden.shape[2]]),
        observed=observed,
        scale=strip.scale,
        ifov=strip.pixel_angle,
        half_field=strip.half_field,
        statics=statics,
        spectra=turned_spectra(state.model.spectra, turn),
        records=tuple(without_common_ground(r, cameras, strip.surface, window) for r in records),
        before_px=state.before_px,
        after_px=state.post_px,
        cameras=cameras,
        image_names=tuple(b.name for b in strip.bands),
        changes=tuple(changes),
        sensors=() if estimate.ties is None else uses(estimate.ties, estimate.own, estimate.own_sigma),
        band=TimeCovariance(
            strip.grid.nodes, estimate.nodes @ turn.T, turned_band(estimate.covariance_band(), turn)
        ),
        warnings=_warnings(strip, state, motion, observed, changes),
    )


def _observed(strip: _Strip, state: _State, t: Array) -> NDArray[np.bool_]:
    """Lines within half a window, and half a step of the grid, of an instant at which a match was exposed."""
    marks = []
    for record in state.records:
        star, present = record.star, record.star.present
        marks += [star.t_hub[present.any(axis=1)], star.t[present]]
    instants = np.sort(np.concatenate(marks))
    if len(instants) == 0:
        return np.zeros(len(t), dtype=bool)
    at = np.clip(np.searchsorted(instants, t), 1, max(len(instants) - 1, 1))
    near = np.minimum(np.abs(t - instants[at - 1]), np.abs(t - instants[np.minimum(at, len(instants) - 1)]))
    reach = 0.5 * (max(r.star.duration for r in state.records) + strip.grid.step)
    return np.asarray(near <= reach)


def _spanned_field(strip: _Strip, records: Sequence[StarRecord]) -> float:
    """Share of the field of all detectors that the kept windows (all but 5 % at either side) reach over."""
    low: list[Array] = []
    high: list[Array] = []
    ends: list[float] = []
    for band in strip.bands:
        across = band.camera.detector.tangents[[0, -1], 0]
        ends += [float(across.min()), float(across.max())]
    for record in records:
        star, detector = record.star, strip.bands[record.star.hub].camera.detector
        columns = star.pixels[star.present.any(axis=1), 1]
        half = (star.window[1] - 1) / 2.0 if star.window else 0.0
        for out, side in ((low, -half), (high, half)):
            out.append(detector.directions_at(columns + side)[:, 0])
    seen = np.concatenate(low)
    if len(seen) == 0 or max(ends) <= min(ends):
        return 0.0
    return float(np.quantile(np.concatenate(high), 0.95) - np.quantile(seen, 0.05)) / (max(ends) - min(ends))


def _lost_windows(records: Sequence[StarRecord]) -> str:
    """What to say where most windows of the largest star that lay on both images were lost; "" if not so."""
    largest = max(records, key=lambda record: record.status.size)
    tried = (largest.status != OUTSIDE) & (largest.status != NOT_CHOSEN)
    kept = largest.star.present
    if not tried.any() or kept.sum() >= ENOUGH_KEPT * tried.sum():
        return ""
    # matched, but thrown out for what it said
    ended = np.where((largest.status == KEPT) & ~kept, OUTLIER, largest.status)[tried & ~kept]
    numbers = np.bincount(ended, minlength=len(STATUS_NAMES))
    worst = int(np.argmax(numbers))
    share = 100.0 * kept.sum() / tried.sum()
    return (
        f"only {share:.0f} % of the windows tried were kept; the others are mostly "
        f"{STATUS_NAMES[worst]!r} ({numbers[worst]} of {len(ended)}): clouds, water, or cameras that say the "
        "wrong place"
    )


def _sensor_warnings(strip: _Strip, estimate: JointEstimate) -> list[str]:
    """Sensors that said nothing, or something else than the images."""
    used = () if estimate.ties is None else uses(estimate.ties, estimate.own, estimate.own_sigma)
    silent = [s.name for s in strip.sensors if s.name not in {use.name for use in used}]
    out = [
        f"{name}: no reading during the images, so it takes no part; check the times of its table"
        for name in silent
    ]
    if strip.control is not None and "control points" not in {use.kind for use in used}:
        out.append("no control point is seen where its image says: they take no part; check x, y, z and line")
    for use in used:
        worst = max(use.sigma_factor)
        if worst > DOUBTFUL:
            out.append(
                f"{use.name}: its residuals are {worst:.2g} times what its sigma says, and it is believed so "
                "much less; check its sigma, its axes (alignment_sigma) and its times"
            )
    return out


def _warnings(
    strip: _Strip, state: _State, motion: Motion, observed: NDArray[np.bool_], changes: list[float]
) -> tuple[str, ...]:
    """What a user should know before trusting the numbers."""
    out = []
    if changes and changes[-1] > 1.0:
        out.append(
            f"the passes did not settle: the last changed the motion by {changes[-1]:.1f} sigma; check the "
            "camera description, or allow more with [matching] passes"
        )
        if all(band.offset_sigma_px == 0.0 for band in strip.bands):
            out.append("band offsets are given as exact (offset_sigma_px = 0); give a sigma if they are not")
    lost = _lost_windows(state.records)
    if lost:
        out.append(lost)
    if not observed.all():
        out.append(
            f"{(~observed).sum()} of {len(observed)} lines are seen by no match: the motion there is "
            "interpolated, its sigma grown"
        )
    out += _sensor_warnings(strip, state.estimate)
    covariance = motion.covariance
    assert covariance is not None
    prior_yaw = turned_spectra(state.model.spectra, strip.turn)[2].sigma
    sigma_yaw = float(np.sqrt(np.median(covariance[:, 2, 2])))
    spanned = _spanned_field(strip, state.records)
    if spanned < ENOUGH_FIELD:
        out.append(
            f"yaw is nearly blind: the matches span {100 * spanned:.0f} % of the field (30 % or more tell "
            f"it); it is known to {sigma_yaw / strip.scale[2]:.2g} px at the field's edge, roll and pitch "
            "no better away from the matches"
        )
    elif sigma_yaw > 0.3 * prior_yaw:
        out.append(
            f"yaw is hardly observable: its sigma, {sigma_yaw / strip.scale[2]:.2g} px at the field edge, is "
            f"close to that of the prior; the field of {2 * strip.half_field:.2g} rad is narrow, or the "
            "matches do not span it"
        )
    return tuple(out)
