"""A strip as S1 sees it: how it is looked at, its cameras in the axes of the estimate, and the time grid.

Not here: the estimate (``estimate.py``), the passes (``applications/line_of_sight.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.measure.bright_layer import MIN_BLOCKS
from sightline.motion.measure.common_view import Views, common_views
from sightline.motion.measure.laid_strips import MOST_UNLIKE, UNLIKE, pixel_sizes
from sightline.motion.measure.observations import Star
from sightline.motion.measure.plan import (
    LEAST_WINDOW,
    ROWS_IN_LAG,
    SIMILARITIES,
    WEIGHTINGS,
    MatchingPlan,
)
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.measure.windows import exposure_times
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.statics import ACROSS, ALONG, apply_statics, band_statics
from sightline.motion.strip.hyper import BROAD, KnownContent, PriorModel
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.viewing_axes import in_axes, turned_spectra, viewing_axes

Array = NDArray[np.float64]

#: Shapes of detector lines: number of the band, one of ``band.SHAPES``, columns where its CCDs meet, and px
#: (rms over the columns) by which it departs from a straight line.
Shapes = tuple[tuple[int, str, tuple[int, ...], float], ...]

#: Estimators of the motion (S1, claim 6).
METHODS = ("joint", "inverse", "wiener", "polynomial", "kalman")
#: How pairs may be brought together.
HYBRIDISE = ("global", "iterative")
#: Lines at which the ground of a strip is sought.
GROUND_PLACES = 9
#: Nodes of the motion in the longest lag beyond which they are laid farther apart where images allow it.
MOST_NODES = 300
#: Windows in a row of bands that hold fewer of the usual width than tell which saw a cloud, and least columns
#: of one. Four, of which a cloud covers two or three, hardly tell more than three.
ROW_BLOCKS, LEAST_COLUMNS = 6, 48
#: s between rows of windows at most, where lines are faster: spacecraft vibrate at up to some 150 Hz.
ROW_SECONDS = 3.2e-3
#: Windows span so little time (s), and rows are so near, where a row holds so many windows at least and a
#: match of usual ones errs by so little (px, 1-sigma): then vibrations stand above the noise that usual rows
#: average away. Half a window errs by sqrt(2) of that, a noisy one by more.
FINE_SECONDS, FINE_BLOCKS, FINE_SIGMA = 1e-3, 10, 0.05
#: Ways to select windows that take hardly more of them where rows are nearer.
BY_NUMBER = ("spread", "listed")


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
        ``"covariance"``: each match counts for what it knows; ``"predicted"``: for what its columns' MTF and
        SNR (``Band.match_sigma``) let expect; ``"none"``: all alike, for comparison.
    pairs : tuple of (str, str)
        Names of the pairs of bands that are matched; empty: every pair that shares ground.
    withhold : tuple of (str, str)
        Names of pairs of bands that are left out of the estimate, predicted from it and compared with their
        own matches (`LineOfSight.withheld`).
    method : str
        ``"joint"``: the maximum a posteriori of all matches; ``"inverse"``, ``"wiener"``, ``"polynomial"`` or
        ``"kalman"``: S1's own estimators (claim 6), from the angular differences of its step b.
    asked : tuple of str
        Names of options that stay as they are also where they are the usual ones: windows, rows and nodes
        otherwise follow the bands.
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
    withhold: tuple[tuple[str, str], ...] = ()
    method: str = "joint"
    asked: tuple[str, ...] = ()

    @classmethod
    def from_matching(
        cls, matching: Mapping[str, Any], method: str, withhold: tuple[tuple[str, str], ...] = ()
    ) -> RecoverOptions:
        """Options of a ``[matching]`` table, which holds what was asked for, and of the command's flags."""
        return cls(**matching, method=method, withhold=withhold, asked=tuple(matching))

    def own(self, name: str) -> bool:
        """Whether an option was asked for."""
        return name in self.asked or getattr(self, name) != getattr(RecoverOptions(), name)

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
            ("method", self.method, METHODS),
        ):
            if given not in allowed:
                raise InputError(f"`{name}` is {given!r}; allowed are {', '.join(allowed)}")


@dataclass(frozen=True, eq=False)
class Strip:
    """What does not change from pass to pass; a `draft` is a wide strip before its last pass.

    `nominal` are the cameras in the axes of the estimate; `turn` (3, 3) leads from them to body axes;
    `withheld` are the pairs that were asked to be left out, of which `views` has none; `shapes` those of
    detector lines that were not given, but found.
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
    control: ControlSightings | None = None
    known: KnownContent = field(default_factory=KnownContent)
    draft: bool = False
    withheld: tuple[tuple[int, int], ...] = ()
    shortest_lag: float = math.inf
    shapes: Shapes = ()

    def plan(
        self, options: RecoverOptions, window: tuple[int, int], step: int, search: tuple[int, int] = (0, 0)
    ) -> MatchingPlan:
        """How a pass matches; drafts of wide strips thin the windows."""
        plan = MatchingPlan(window, step, search)
        if self.draft:
            plan = replace(plan, most_blocks=options.draft_blocks)
        return replace(
            plan,
            selection=options.selection,
            similarity=options.similarity,
            weighting=options.weighting,
            lag=self.shortest_lag,
            predicted=tuple(band.match_sigma for band in self.bands),
        )

    def given_model(self) -> PriorModel:
        """The spectra that are given, about the axes of the estimate: there they pass for independent."""
        assert self.known.spectra is not None
        return PriorModel(turned_spectra(self.known.spectra, self.turn.T))

    @property
    def scale(self) -> Array:
        """(3,) rad; one pixel of roll, of pitch, and of yaw at the edge of the field."""
        return np.array([self.pixel_angle, self.pixel_angle, self.pixel_angle / self.half_field])

    @property
    def common_offsets(self) -> Array | None:
        """(Q, 2): static parameters by which all bands look a pixel of the first further along, or across.

        None where the offset of a band is exact: those of the others are from it.
        """
        names = (ALONG, ACROSS)
        out = np.zeros((len(self.parameters), len(names)))
        for k, one in enumerate(self.parameters):
            for axis, name in enumerate(names):
                if one.name == f"{self.bands[one.images[0]].name} {name}":
                    out[k, axis] = self.pixel_angle / _field(self.nominal[one.images[0]])[0]
        return out if (np.count_nonzero(out, axis=0) == len(self.bands)).all() else None

    def lines(self) -> NDArray[np.int64]:
        """Lines of the first band, gone on before and after its image from the first exposure of any band to
        the last."""
        camera = self.nominal[0]
        last = camera.lines - 1
        at = camera.times(np.array([-1.0, 0.0, last, last + 1.0]))
        ends = np.array([c.times(np.array([0.0, c.lines - 1.0])) for c in self.nominal])
        before = (at[1] - ends.min()) / (at[1] - at[0])
        after = (ends.max() - at[2]) / (at[3] - at[2])
        # what is less than a thousandth of a line outside is rounding
        return np.arange(-np.ceil(before - 1e-3), last + np.ceil(after - 1e-3) + 1.0).astype(np.int64)

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


def suited(options: RecoverOptions, bands: Sequence[Band], surface: Surface) -> RecoverOptions:
    """Options with windows as narrow as the bands ask for, in rows as near as lags and vibrations do.

    A pair sees motion by how it differs over its lag: rows farther apart than some half of that sample what
    the pair sees too coarsely, and windows as high as that average it away. Lines of a millisecond and more
    are so far apart that usual rows would take vibrations for their aliases. Windows, rows or nodes that were
    asked for stay as they are.

    Rows of narrow bands hold ROW_BLOCKS windows where these are not too narrow: a window that saw a cloud
    departs from the others of its row, which takes as many to tell.

    Where lags are many nodes, whose square the solution costs, and the coarser image of every pair has long
    lines, nodes are as far apart as on these at most: windows of such lines average what lies between.
    """
    usual = RecoverOptions()
    if options.own("window"):
        return options
    width = window_columns(bands)
    first = options.first_window
    if not options.own("first_window"):
        first = (first[0], width)
    options = replace(options, first_window=first, window=(usual.window[0], width))
    if options.own("step") or options.own("grid_lines"):
        return options
    cameras = [band.camera for band in bands]
    rows = _shortest_lag(cameras, surface) / ROWS_IN_LAG
    if rows >= usual.step:
        most = longest_lag(cameras, surface) / MOST_NODES
        wider = min(_coarser_lines(cameras), most / usual.grid_lines)
        if wider > UNLIKE:
            return replace(options, grid_lines=usual.grid_lines * wider)
        step = int(ROW_SECONDS / min(camera.detector.line_period for camera in cameras))
        if not 0 < step < usual.step:
            return options
        nodes = max(usual.grid_lines * step / usual.step, min(most, usual.grid_lines))
        return replace(options, step=step, grid_lines=nodes)
    step = max(int(rows), 1)
    return replace(
        options,
        window=(max(step, LEAST_WINDOW), width),
        step=step,
        grid_lines=usual.grid_lines * step / usual.step,
    )


def finer_rows(options: RecoverOptions, bands: Sequence[Band], stars: Sequence[Star]) -> RecoverOptions:
    """Options with windows, and rows, as near in time as matches as good as those of `stars` can serve.

    Of usual windows of like bands alone: coarse lines and TDI average what nearer rows would see. Of windows
    that are chosen by their number, or by features that they hold, lower ones would not be more.
    """
    usual, periods = RecoverOptions(), [band.camera.detector.line_period for band in bands]
    lines = max(round(FINE_SECONDS / min(periods)), LEAST_WINDOW)
    if (
        any(map(options.own, ("window", "step", "grid_lines")))
        or options.selection.way in BY_NUMBER
        or lines >= usual.step
        or max(periods) > UNLIKE * min(periods)
        or max(band.camera.columns for band in bands) // usual.window[1] < FINE_BLOCKS
        or any(band.camera.stages is not None for band in bands)
    ):
        return options
    variances, side_by_side = [np.inf], 0
    for star in stars:
        present = star.present
        variances.extend(star.error_variance(slice(None)).mean(-1)[present])
        in_rows = present.reshape(*star.shape, -1).sum(axis=1)
        side_by_side = max(side_by_side, int(in_rows.max(initial=0)))
    # wide bands may share little of their width: one beside the other, or with a narrow matrix
    if np.median(variances) > FINE_SIGMA**2 or side_by_side < FINE_BLOCKS // 2:
        return options
    return replace(options, window=(lines, options.window[1]), step=lines)


def window_columns(bands: Sequence[Band]) -> int:
    """Columns of a window where none are asked for: as usual, fewer where the bands are narrow."""
    usual, widest = RecoverOptions().window[1], max(band.camera.columns for band in bands)
    return usual if widest // usual >= MIN_BLOCKS else max(widest // ROW_BLOCKS, LEAST_COLUMNS)


def _shortest_lag(cameras: Sequence[PushbroomCamera], surface: Surface) -> float:
    """Lines of the finest between two images' sights of a place, the least of all pairs; inf without any."""
    return min(_lags(cameras, surface), default=math.inf)


def longest_lag(cameras: Sequence[PushbroomCamera], surface: Surface) -> float:
    """The same, the most of all pairs; 0 without any."""
    return max(_lags(cameras, surface), default=0.0)


def _coarser_lines(cameras: Sequence[PushbroomCamera]) -> float:
    """Line period of the coarser image of a pair, the least of all pairs, over that of the finest image."""
    periods = sorted(camera.detector.line_period for camera in cameras)
    return periods[1] / periods[0] if len(periods) > 1 else 1.0


def _lags(cameras: Sequence[PushbroomCamera], surface: Surface) -> list[float]:
    """Lines of the finest between two images' sights of a place, of every pair that shares places."""
    found, finest = [], min(camera.detector.line_period for camera in cameras)
    for k, camera in enumerate(cameras):
        lines = np.linspace(0.0, camera.lines - 1.0, GROUND_PLACES)
        pixels = np.column_stack([lines, np.full(len(lines), (camera.columns - 1) / 2.0)])
        ground = camera.locate(pixels, surface)
        for other in cameras[k + 1 :]:
            seen = other.project(ground)
            lag = np.abs(exposure_times(other, seen) - exposure_times(camera, pixels)) / finest
            known = lag[np.isfinite(lag) & (lag > 0.5)]  # half a line is none
            if len(known):
                found.append(float(np.median(known)))
    return found


def prepared(bands: Sequence[Band], surface: Surface, options: RecoverOptions) -> Strip:
    """Check the input and lay the time grid."""
    for band in bands:
        expected = (band.camera.lines, band.camera.columns)
        if tuple(band.image.shape) != expected:
            raise InputError(
                f"image and camera of band {band.name!r} differ: image {band.image.shape}, camera {expected} "
                "(lines, columns); give the image its own size in the instrument description"
            )
    pairs = _numbered(options.pairs, bands)
    views = common_views([band.camera for band in bands], surface, pairs)
    _check_pixels(bands, views)
    whole = views or {(0, 0): (0, bands[0].camera.columns - 1)}
    axes = viewing_axes([band.camera for band in bands], whole)
    cameras = tuple(band.camera if axes is None else in_axes(band.camera, axes) for band in bands)
    parameters = band_statics(bands)
    ends = np.array([[c.times(np.array([-2.0]))[0], c.times(np.array([c.lines + 1.0]))[0]] for c in cameras])
    period = min((ends[k, 1] - ends[k, 0]) / (c.lines + 3) for k, c in enumerate(cameras))
    step = options.grid_lines * period
    # the stages of a line reach beyond its time
    ends += np.array([[-c.reach[0], c.reach[1]] for c in cameras])
    start = float(ends[:, 0].min()) - 2 * step
    count = math.ceil((float(ends[:, 1].max()) - start) / step) + 3
    first = cameras[0]
    pixel_angle, half_field = _field(first)
    half_width, ground_speed = _on_ground(first, surface)
    return Strip(
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
        shortest_lag=_shortest_lag(cameras, surface),
    )


def _check_pixels(bands: Sequence[Band], views: Views) -> None:
    """No pair whose pixels or lines are too unlike to be matched."""
    sizes = pixel_sizes([band.camera for band in bands])
    for a, b in views:
        for what, ratio in zip(("line period", "pixel (ifov)"), sizes[a] / sizes[b], strict=True):
            if ratio > 1.01 * MOST_UNLIKE:
                raise InputError(
                    f"the {what} of {bands[a].name!r} is {ratio:.3g} times that of {bands[b].name!r}; pairs "
                    f"up to {MOST_UNLIKE:g} : 1 can be matched; check `ifov` and `line_period` of both, "
                    "leave a band out, or name the pairs to match: [matching] pairs"
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
