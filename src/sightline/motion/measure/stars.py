"""Matched windows of one hub image, gathered into a star of observations.

S1's boxes 20 to 26 for a whole strip: lay windows, predict, match, residual. Which hubs are
needed is decided here too: the first image serves all ground it sees, later images only what
no earlier hub has seen, and their own first and last lines, so that no pair is counted twice.

Not here: what is done with the observations (``motion/strip/joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.execution import Step, in_threads, no_step
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Dem, Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.reduce import Mapping, averaged
from sightline.imaging.source import ImageSource
from sightline.imaging.warp import WarpedImage
from sightline.matching.match_images import match_images
from sightline.matching.matches import KEPT, MASKED, NOT_CHOSEN, OUTLIER, OUTSIDE, Matches
from sightline.matching.select import Selection, chosen_windows
from sightline.matching.whitening import Whitening, estimate_whitening, gradient_filter
from sightline.motion.measure.aliasing import RESPONSE_STEP, folding, response
from sightline.motion.measure.common_view import Views, common_views, partners_of, usable
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.measure.sampled_sensitivities import sampled_sensitivities
from sightline.motion.measure.uneven_blur import displacement
from sightline.motion.measure.uneven_lines import answers, uneven
from sightline.motion.measure.windows import (
    Predictions,
    WindowGrid,
    brightest_parts,
    exposure_times,
    field_positions,
    predict_windows,
    window_grid,
)

Array = NDArray[np.float64]

#: Columns between the places where the map of two images is evaluated: over relief, over smooth surfaces.
RELIEF_SPACING, SMOOTH_SPACING = 16, 64
#: Lines at which the columns are sought where the CCDs of a line meet in steps.
STEP_LINES = 5
#: Tiles that teach the whitening of a pair.
TILES = 128
#: A row that lost more than this share of its windows is tried again: the estimate may have been wrong.
MOST_WRONG = 0.4
#: Windows of another image are not found nearer than this to the ends of an image (px): the kernel that lays
#: one image on the other reads 4, the derivative another 4.
END = 8
#: Windows in a row of a narrow view, and their least width (px).
NARROW_BLOCKS, LEAST_WIDTH = 4, 16
#: Columns that a tile for whitening leaves free on both sides in a narrow view: where it is searched for.
TILE_MARGIN = 12
#: Lines of such a tile, and its fewest columns.
TILE_LINES = 16
#: What may be compared, and how matches may count.
SIMILARITIES = ("whitened", "radiometric", "gradient")
WEIGHTINGS = ("covariance", "predicted", "none")
#: The filter of similarity "gradient".
GRADIENT = gradient_filter()
#: Lines over which their spacing on the ground is averaged, and departures of one from the next (lines) up to
#: which lines pass for even.
PLACE_MEAN, EVEN = 17, 1e-3
#: Pixels that differ by more than this factor, along or across, are unlike.
UNLIKE = 1.25
#: Pixels that differ by more cannot be matched.
MOST_UNLIKE = 6.0
#: Parts of a pixel may be this much further apart than pixels of the image they are taken from.
_PART_SLACK = 1.05
#: Least windows (lines, columns) on grids coarser than the finest.
COARSE_WINDOW = (2, 24)
#: px that are searched there beyond what is as far on the finest (offsets are known in pixels of each band),
#: and least pixels of a window that is searched for.
COARSE_SEARCH, SEARCHED_PIXELS = 3, 200
#: Rows of windows in the shortest lag at least, and lines of a window at least.
ROWS_IN_LAG, LEAST_WINDOW = 1.8, 2
#: Lines squared by which the derivative along lines spreads what a low window averages over: tones of 30 to
#: 120 Hz in pitch are seen through windows of 2 (3) lines as through 2.7 (3.4).
NEIGHBOURS = 3.3
#: Parts of an exposure over which the motion is averaged.
EXPOSURE_PARTS = 5
#: Share of a window's columns that may lie where TDI has another number of stages than at its middle.
MIXED = 0.1
#: Windows are narrowed, by whole parts to at most so many, where that lets so much more of a line be used.
MOST_PARTS, MORE_USED = 4, 1.1
#: Windows enough to learn whitening from; a star of fewer looks all over its image instead.
ENOUGH = 100


@dataclass(frozen=True, eq=False)
class MatchingPlan:
    """How one pass of matching looks.

    Attributes
    ----------
    window : (lines, columns)
        px.
    step : int
        Lines between rows of windows.
    search_px : (lines, columns)
        px; half-range of the integer search; (0, 0) trusts the prediction.
    most_blocks : int
        At most so many windows per row; 0 lays them side by side.
    selection : Selection
        Which windows are matched.
    similarity : str
        One of SIMILARITIES: what is compared.
    weighting : str
        One of WEIGHTINGS: how matches count.
    lag : float
        Lines (of the finest image) of the shortest lag: rows and windows of coarse ones must not outlast it.
    predicted : tuple of (columns, 2) or None
        Of every image, the relative sigma along lines and columns of a match at each of its columns, as
        predicted from MTF and SNR; only ratios matter, and only with weighting ``"predicted"``.
    """

    window: tuple[int, int]
    step: int
    search_px: tuple[int, int] = (0, 0)
    most_blocks: int = 0
    selection: Selection = field(default_factory=Selection)
    similarity: str = "whitened"
    weighting: str = "covariance"
    lag: float = math.inf
    predicted: tuple[Array | None, ...] = ()

    def coarser(self, ratio: tuple[float, float]) -> MatchingPlan:
        """The plan on a grid of pixels coarser by `ratio` (along, across).

        Windows are as many seconds long and metres wide, where these hold enough pixels.
        """
        if ratio == (1.0, 1.0):
            return self

        def reduced(sizes: tuple[int, int], least: tuple[int, int]) -> tuple[int, int]:
            lines, columns = (
                max(round(size / r), min(size, fewest))
                for size, r, fewest in zip(sizes, ratio, least, strict=True)
            )
            return lines, columns

        lines, columns = reduced(self.window, COARSE_WINDOW)
        search = self.search_px
        if max(search):
            lines = max(lines, min(self.window[0], math.ceil(SEARCHED_PIXELS / columns)))
            far = reduced(search, (0, 0))
            search = min(search[0], far[0] + COARSE_SEARCH), min(search[1], far[1] + COARSE_SEARCH)
        # as near in time as on the finest grid, overlap or not: fewer would not tell tones from their aliases
        step = max(round(self.step / ratio[0]), 1)
        if not max(self.search_px) and self.lag < math.inf:
            lag = self.lag / ratio[0]
            lines = min(lines, max(int(lag), LEAST_WINDOW))
            step = min(step, max(int(lag / ROWS_IN_LAG), 1))
        return replace(self, window=(lines, columns), step=step, search_px=search)

    def grid(self, shape: tuple[int, int], columns: tuple[int, int] | None = None) -> WindowGrid:
        """The windows of this plan on an image of `shape` (lines, columns).

        Where the partners see only part of the `columns` (first, last), it holds a few windows, narrow if
        need be: rows of several tell shift from tilt, and error from motion.
        """
        if columns is not None:
            room = columns[1] - columns[0] + 1
            blocks = max(room // self.window[1], min(NARROW_BLOCKS, room // LEAST_WIDTH), 1)
            width = min(room // blocks, self.window[1])
            part = window_grid((shape[0], room), (self.window[0], width), self.step)
            return WindowGrid(part.window, part.lines, part.columns + columns[0])
        width = min(self.window[1], shape[1])
        blocks = max(shape[1] // width, 1)
        apart = -(-blocks // self.most_blocks) if self.most_blocks else 1
        return window_grid(shape, self.window, self.step, columns_step=apart * width)


#: Whitening by (hub, partner); None where nothing could be learned.
Filters = dict[tuple[int, int], Whitening | None]


@dataclass(frozen=True, eq=False)
class StarRecord:
    """A star with what the report shows of its matching.

    Attributes
    ----------
    star : Star
    status : (G, K) uint8
        Why each match was kept or not (``matching.matches.STATUS_NAMES``).
    score : (G, K)
        Normalised correlation, 0 .. 1.
    filters : tuple of (Whitening or None)
        Of each pair; empty where they are not kept.
    """

    star: Star
    status: NDArray[np.uint8]
    score: Array
    filters: tuple[Whitening | None, ...] = ()


def hub_windows(
    cameras: Sequence[MovingCamera],
    surface: Surface,
    shapes: Sequence[tuple[int, int]],
    order: Sequence[int],
    plan: MatchingPlan,
    views: Views | None = None,
) -> list[tuple[int, tuple[int, ...], WindowGrid]]:
    """Which windows to cut from which image: (hub, partners, grid) for every hub in `order`.

    Parameters
    ----------
    cameras, shapes
        Of all images.
    surface : Surface
    order : sequence of int
        Images, the first hub first.
    plan : MatchingPlan
    views : mapping, optional
        From `common_view.common_views`; found here unless given.

    Notes
    -----
    What a later image took in its very first and last lines cannot be found in it (`END`), but can be cut
    from it and found in an earlier one: without such windows, which follow the search, the motion at the ends
    of a strip would be extrapolated over 4 ms. In the first such image only: pairs of it with the others on
    that ground are among its own windows.
    """
    if views is None:
        views = common_views(cameras, surface)
    grains = groups_of_pixels(cameras)
    order = sorted(order, key=lambda image: grains[image])
    out: list[tuple[int, tuple[int, ...], WindowGrid]] = []
    for place, hub in enumerate(order):
        here = plan.coarser(ratio_to_finest(cameras, hub))
        for group in partners_of(views, order, place, shapes[hub][1], grains):
            grid = within_stages(here.grid(shapes[hub], group.columns), cameras[hub])
            if group.earlier:
                grid = _fresh(cameras, surface, shapes, hub, group.earlier, grid)
            if len(grid.lines):
                out.append((hub, group.images, grid))
        like = (image for image in order[:place] if (hub, image) in views and grains[image] == grains[hub])
        first = next(like, None)
        if first is not None and max(here.search_px) == 0:
            grid = here.grid(shapes[hub], usable(views[hub, first], shapes[hub][1]))
            grid = within_stages(grid, cameras[hub])
            lines = _end_lines(shapes[hub][0], grid.window[0], here.step)
            out.append((hub, (first,), WindowGrid(grid.window, lines, grid.columns)))
    return out


def within_stages(grid: WindowGrid, camera: MovingCamera) -> WindowGrid:
    """The same rows of windows, laid between the columns at which the number of TDI stages changes.

    They are made narrower where stages change so often that much of the line would go unused; what is less
    than a window wide still does.
    """
    if not isinstance(camera, PushbroomCamera) or camera.stages is None or not len(grid.columns):
        return grid
    first, last = (int(side) for side in grid.sides)
    stages = np.asarray(camera.stages)[:, first:last]
    if len(stages) > 1:  # differ from line to line: there is no laying windows between them
        return grid
    stages = stages[0]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(stages)) + 1, [len(stages)]])
    if len(edges) == 2:
        return grid
    runs = np.diff(edges)
    height, whole = grid.window
    # of windows that a draft thins out the gaps stay
    apart = int(np.diff(grid.columns).min(initial=whole)) // whole
    width, used = whole, 0.0
    for parts in range(1, MOST_PARTS + 1):
        narrow = max(whole // parts, min(LEAST_WIDTH, whole))
        if float((runs // narrow * narrow).sum()) > MORE_USED * used:
            width, used = narrow, float((runs // narrow * narrow).sum())
    columns: list[float] = []
    for begin, run in zip(edges, runs, strict=False):
        count = int(run) // width
        left = first + begin + (run - count * width) // 2 + (width - 1) / 2.0
        columns += (left + width * np.arange(0, count, apart)).tolist()
    if not columns:
        return grid
    return WindowGrid((height, width), grid.lines, np.array(columns))


def mixed_stages(camera: MovingCamera, centres: Array, window: tuple[float, float]) -> NDArray[np.bool_]:
    """Which windows about `centres` (N, 2) px see more than MIXED of other numbers of TDI stages."""
    out = np.zeros(len(centres), dtype=bool)
    if not isinstance(camera, PushbroomCamera) or camera.stages is None:
        return out
    middle, (height, width) = camera.stages_of(centres), window
    half = (0.5 - MIXED) * width
    for line in np.linspace(-0.5, 0.5, 3) * max(height - 1.0, 0.0):
        for column in np.linspace(-half, half, max(3, int(width // LEAST_WIDTH))):
            out |= camera.stages_of(centres + np.array([line, column])) != middle
    return out


def pixel_sizes(cameras: Sequence[MovingCamera]) -> Array:
    """(K, 2) s between lines and tangent between columns of line detectors; ones of area detectors."""
    return np.array(
        [
            (c.detector.line_period, c.detector.pixel_step) if isinstance(c, PushbroomCamera) else (1.0, 1.0)
            for c in cameras
        ]
    )


def groups_of_pixels(cameras: Sequence[MovingCamera]) -> tuple[int, ...]:
    """Number of each image's group of like pixels, the coarsest 0: a group's first hub is of its own size."""
    sizes = pixel_sizes(cameras)
    leaders: list[int] = []
    group = [0] * len(sizes)
    for image in np.argsort(-sizes.prod(axis=1), kind="stable"):
        ratios = [np.exp(np.abs(np.log(sizes[image] / sizes[leader])).max()) for leader in leaders]
        if not ratios or min(ratios) > UNLIKE:
            leaders.append(int(image))
            group[image] = len(leaders) - 1
        else:
            group[image] = int(np.argmin(ratios))
    return tuple(group)


def ratio_to_finest(cameras: Sequence[MovingCamera], image: int) -> tuple[float, float]:
    """Pixels of an image over those of the finest group, (along, across); 1 where they are like."""
    sizes, groups = pixel_sizes(cameras), groups_of_pixels(cameras)
    if groups[image] == max(groups):
        return 1.0, 1.0
    finest = sizes[np.array(groups) == max(groups)].min(axis=0)
    along, across = np.maximum(sizes[image] / finest, 1.0)
    return float(along), float(across)


def finest_view(cameras: Sequence[MovingCamera], surface: Surface, hub: int, grid: WindowGrid) -> int | None:
    """The image of the finest pixels in which most windows of a coarser hub lie; None for a hub of these."""
    groups = groups_of_pixels(cameras)
    finest = [image for image, group in enumerate(groups) if group == max(groups)]
    if hub in finest:
        return None
    ground = cameras[hub].locate(grid.centres, surface)
    seen = [np.isfinite(cameras[image].project(ground)).all(axis=1).sum() for image in finest]
    return finest[int(np.argmax(seen))] if max(seen) else None


def parts_of_pixel(cameras: Sequence[MovingCamera], hub: int, partner: int) -> tuple[int, int]:
    """Parts (along, across) of a hub's pixel over which a finer partner is averaged; 1 if they are like."""
    sizes = pixel_sizes(cameras)
    lines, columns = (
        math.ceil(ratio / _PART_SLACK) if ratio > UNLIKE else 1 for ratio in sizes[hub] / sizes[partner]
    )
    return lines, columns


def _fresh(
    cameras: Sequence[MovingCamera],
    surface: Surface,
    shapes: Sequence[tuple[int, int]],
    hub: int,
    earlier: Sequence[int],
    grid: WindowGrid,
) -> WindowGrid:
    """The rows of a hub's windows whose ground no `earlier` hub sees."""
    middle = grid.columns[len(grid.columns) // 2]
    pixels = np.stack([grid.lines, np.full(len(grid.lines), middle)], axis=1)
    ground = cameras[hub].locate(pixels, surface)
    reach = grid.window[0] / 2
    fresh = np.ones(len(pixels), dtype=bool)
    for image in earlier:
        line = cameras[image].project(ground)[:, 0]
        fresh &= ~(np.isfinite(line) & (line > reach) & (line < shapes[image][0] - 1 - reach))
    return WindowGrid(grid.window, grid.lines[fresh], grid.columns)


def _end_lines(lines: int, height: int, step: int) -> Array:
    """Centres of the rows of windows, laid inwards from both ends, in which no other window is found."""
    half = (height - 1) / 2.0
    rows = max(1, math.ceil((END - half) / step))
    inward = half + step * np.arange(rows)
    inward = inward[inward <= (lines - 1) / 2.0]
    return np.unique(np.concatenate([inward, lines - 1.0 - inward]))


def match_star(
    images: Sequence[ImageSource],
    cameras: Sequence[MovingCamera],
    surface: Surface,
    hub: int,
    partners: tuple[int, ...],
    grid: WindowGrid,
    statics: Sequence[StaticParameter],
    plan: MatchingPlan,
    before: StarRecord | None = None,
    step: Step = no_step,
    filters: Filters | None = None,
) -> StarRecord:
    """Match one hub's windows in all its partners and write down what they say.

    `step` is called with the number of windows that are done, and of all. `filters` are those of pairs that
    were learned before; what is learned here is added.

    Windows that `before`, the same star of an earlier pass, found to be wrong are not tried again: clouds
    among them would spoil the whitening and the pooled errors of the good ones.
    """
    ratio = ratio_to_finest(cameras, hub)
    plan = plan.coarser(ratio)
    predicted = predict_windows(cameras, hub, partners, surface, grid)
    g, k = len(grid.centres), len(partners)
    wrong = found_wrong(before, hub, grid, k)
    chosen = chosen_windows(images[hub], hub, grid.centres, grid.window, plan.selection)
    residual = np.full((g, k, 2), np.nan)
    covariance = np.tile(np.eye(2), (g, k, 1, 1))
    status = np.ones((g, k), dtype=np.uint8)
    score = np.full((g, k), np.nan)

    mixed = mixed_stages(cameras[hub], grid.centres, grid.window)
    sizes = [_size_in(cameras, hub, partner, grid.window) for partner in partners]
    seen = [
        np.isfinite(one.b[:, 0]) & ~mixed & ~mixed_stages(cameras[partner], one.b, size)
        for one, partner, size in zip(predicted, partners, sizes, strict=True)
    ]
    finer = [parts_of_pixel(cameras, hub, partner) != (1, 1) for partner in partners]
    blurred = [exposed(camera) for camera in cameras] if ratio[0] > UNLIKE else cameras
    laid = [
        laid_on(images, cameras if one else blurred, surface, hub, partner)
        for partner, one in zip(partners, finer, strict=True)
    ]
    searched = max(plan.search_px) > 0
    rough = not searched and uneven(cameras[hub], surface)
    finest = None if searched else finest_view(cameras, surface, hub, grid)
    shown = list(images)  # as the finest shows the ground to coarse pixels
    if finest is not None:
        for image in (hub, *(partner for partner, one in zip(partners, finer, strict=True) if not one)):
            shown[image] = laid_on(images, cameras, surface, image, finest)

    def whitening(j: int) -> Whitening | None:
        if plan.similarity != "whitened":
            return GRADIENT if plan.similarity == "gradient" else None
        if grid.narrow(images[hub].shape[1]):
            return _narrow_whitening(images[hub], laid[j], grid, plan)
        if (hub, partners[j]) in known:
            return known[hub, partners[j]]
        points = _learning(grid.centres[seen[j] & ~wrong[:, j]], images[hub], plan)
        return pair_whitening(images[hub], laid[j], points)

    def sensitivity(j: int) -> NDArray[np.float32]:
        places, width = predicted[j].b, sizes[j][1]
        return sampled_sensitivities(
            cameras, hub, partners[j], surface, grid, seen[j], statics, places, width
        )

    known = {} if filters is None else filters
    whitenings = in_threads(whitening, range(k))
    if filters is not None and not grid.narrow(images[hub].shape[1]):
        filters.update(_both_ways(cameras, hub, partners, whitenings))
    values = np.stack(in_threads(sensitivity, range(k)), axis=1)
    # one pair after the other: its blocks are matched on threads, and only so many are held at a time
    for j, partner in enumerate(partners):

        def blocks(done: int, total: int, j: int = j) -> None:
            step(j * g + done * g // total, k * g)

        points = np.where((seen[j] & ~wrong[:, j] & chosen)[:, None], grid.centres, np.nan)

        def matched(
            image: ImageSource,
            points: Array = points,
            j: int = j,
            step: Step = no_step,
            own: ImageSource = images[hub],
        ) -> Matches:
            return match_images(
                own,
                image,
                points,
                points,
                window=grid.window,
                search_px=plan.search_px,
                whitening=whitenings[j],
                step=step,
            )

        matches = matched(laid[j], step=blocks)
        good = matches.kept & np.isfinite(values[:, j]).all(axis=(1, 2)) & seen[j]
        turn = predicted[j].affine[good]
        if finer[j] and not searched:
            moved = [
                matched(laid_on(images, cameras, surface, hub, partner, moved=(line, column)))
                for line, column in ((RESPONSE_STEP, 0.0), (0.0, RESPONSE_STEP))
            ]
            turn = turn @ np.linalg.inv(response(matches, moved)[good])
        elif rough:

            def by(other: Sequence[MovingCamera], j: int = j, partner: int = partner) -> Matches:
                return matched(laid_on(images, other, surface, hub, partner))

            share = answers(blurred, partner, matches, values[:, j, :, 3:6], predicted[j].affine, by)[good]
            turn = turn / np.stack([share, np.ones(len(share))], axis=1)[:, :, None]
        shift, uncertain = matches.b[good] - grid.centres[good], matches.covariance_px[good]
        if finest is not None and not finer[j]:
            fold = matched(laid_on(shown, blurred, surface, hub, partner), own=shown[hub])
            folded, unknown = folding(
                shift, fold.b[good] - fold.a[good], fold.kept[good], grid.centres[good, 0]
            )
            shift, uncertain = shift - folded, uncertain + unknown
        if not searched:
            shift = shift - displacement(
                cameras,
                (hub, partner),
                (grid.centres[good], predicted[j].b[good]),
                (exposure_times(cameras[hub], grid.centres[good]), predicted[j].t[good]),
                (values[good, j, :, 0:3], values[good, j, :, 3:6]),
                predicted[j].affine[good],
                whitenings[j],
            )
        residual[good, j] = np.einsum("nij,nj->ni", turn, shift)
        covariance[good, j] = turn @ uncertain @ np.swapaxes(turn, 1, 2)
        beyond = ~within_image(predicted[j].b, images[partner].shape, sizes[j])
        status[:, j] = np.where(beyond & (matches.status == MASKED), OUTSIDE, matches.status)
        status[seen[j] & ~chosen, j] = NOT_CHOSEN
        if plan.weighting != "covariance" and good.any():
            mean = 0.5 * np.einsum("nii->n", covariance[good, j]).mean()
            places = np.stack([grid.centres[good, 1], predicted[j].b[good, 1]])
            covariance[good, j] = mean * _relative(plan, (hub, partner), places)
        score[:, j] = matches.score
    camera = cameras[hub]
    tdi_hub, tdi = _tdi(cameras, hub, partners, grid, predicted)
    duration, stretch = _duration(camera, grid, exposed=ratio[0] > UNLIKE)
    star = Star(
        hub=hub,
        images=partners,
        shape=grid.shape,
        pixels=grid.centres,
        t_hub=exposure_times(camera, grid.centres),
        t=np.stack([p.t for p in predicted], axis=1),
        duration=duration,
        stretch=stretch,
        tdi_hub=tdi_hub,
        tdi=tdi,
        coarseness=ratio[0],
        fineness=_fineness(cameras, hub, partners),
        residual_px=residual,
        covariance_px=covariance,
        by_hub=np.ascontiguousarray(values[..., 0:3]),
        by_partner=np.ascontiguousarray(values[..., 3:6]),
        by_static=np.ascontiguousarray(values[..., 7:]),
        by_height=np.ascontiguousarray(values[..., 6]),
        field=field_positions(grid.centres[:, 1], images[hub].shape[1]),
        correlation=shared_image_correlation(k),
        weight=np.ones((g, k)),
        brightness=_brightness(before, images[hub], hub, grid),
        window=grid.window,
    )
    return StarRecord(star, status, score, tuple(whitenings))


def _both_ways(
    cameras: Sequence[MovingCamera], hub: int, partners: Sequence[int], found: Sequence[Whitening | None]
) -> Filters:
    """Filters of pairs of a hub by (hub, partner), and with either as hub where their pixels are like."""
    out: Filters = {}
    for partner, one in zip(partners, found, strict=True):
        out[hub, partner] = one
        if {parts_of_pixel(cameras, *pair) for pair in ((hub, partner), (partner, hub))} == {(1, 1)}:
            out[partner, hub] = None if one is None else one.swapped()
    return out


def _relative(plan: MatchingPlan, pair: tuple[int, int], columns: Array) -> Array:
    """(N, 2, 2) covariance of matches at `columns` (2, N) of a pair, of mean variance 1, as predicted."""
    variance = np.zeros((columns.shape[1], 2))
    for image, at in zip(pair, columns, strict=True):
        sigma = plan.predicted[image] if plan.weighting == "predicted" and plan.predicted else None
        if sigma is None:
            variance += 1.0
        else:
            variance += sigma[np.clip(np.rint(at), 0, len(sigma) - 1).astype(np.intp)] ** 2
    return np.asarray((variance / variance.mean())[:, :, None] * np.eye(2))


def exposed(camera: MovingCamera) -> MovingCamera:
    """A line camera whose motion is its mean over the exposure of a line.

    Two images of coarse lines are laid on one another line by line: each line shows where it looked on
    average. (An image of finer lines is averaged over the parts of an exposure, each with its own motion.)
    """
    motion = camera.trajectory.motion
    if motion is None or not isinstance(camera, PushbroomCamera) or camera.stages is not None:
        return camera  # its stages are averaged over already
    parts = (np.arange(EXPOSURE_PARTS) + 0.5) / EXPOSURE_PARTS - 0.5
    instants = motion.t[:, None] + camera.detector.line_period * parts
    inside = np.clip(instants, motion.t[0], motion.t[-1])
    angles = motion.at(inside.ravel()).reshape(*inside.shape, 3).mean(axis=1)
    return camera.with_trajectory(camera.trajectory.with_motion(Motion(motion.t, angles)))


def laid_on(
    images: Sequence[ImageSource],
    cameras: Sequence[MovingCamera],
    surface: Surface,
    hub: int,
    partner: int,
    *,
    moved: tuple[float, float] = (0.0, 0.0),
) -> ImageSource:
    """The partner's image in the geometry of the hub, as far as the cameras know it.

    A partner of finer pixels is averaged over the pixels of the hub and their exposure. `moved`: (lines,
    columns) px of the hub by which it is taken further on.
    """
    source, target = cameras[hub], cameras[partner]

    def mapping(lines: Array, columns: Array) -> Array:
        places = np.meshgrid(lines + moved[0], columns + moved[1], indexing="ij")
        pixels = np.stack(places, axis=-1).reshape(-1, 2)
        b = target.project(source.locate(pixels, surface))
        return b.reshape(len(lines), len(columns), 2)

    spacing = RELIEF_SPACING if isinstance(surface, Dem) else SMOOTH_SPACING
    parts = parts_of_pixel(cameras, hub, partner)
    rough = _rough_columns(source, target, mapping, images[hub].shape)
    places = line_places(target, surface)

    def laid(mapping: Mapping, shape: tuple[int, int]) -> WarpedImage:
        return WarpedImage(images[partner], mapping, shape, spacing, places, tuple(rough * parts[1]))

    return averaged(laid, mapping, images[hub].shape, parts)


def _rough_columns(
    source: MovingCamera, target: MovingCamera, mapping: Mapping, shape: tuple[int, int]
) -> Array:
    """Columns of the source at which the line of either camera is not smooth."""
    own, other = (
        c.rough_columns if isinstance(c, PushbroomCamera) else np.empty(0) for c in (source, target)
    )
    if not len(other):
        return own
    columns = np.arange(shape[1], dtype=np.float64)
    seen = mapping(np.linspace(0.0, shape[0] - 1.0, STEP_LINES + 2)[1:-1], columns)[..., 1]
    # whether any of `other`, which rises, lies from one column to the next, both included; none beside NaN
    low, high = np.minimum(seen[:, :-1], seen[:, 1:]), np.maximum(seen[:, :-1], seen[:, 1:])
    between = np.searchsorted(other, high, "right") > np.searchsorted(other, low, "left")
    return np.union1d(own, np.flatnonzero(between.any(axis=0)) + 0.5)


def line_places(camera: MovingCamera, surface: Surface) -> Array | None:
    """Where the lines of a camera stand along its track on the ground, (lines, 2), for `WarpedImage`.

    At its first and its last column, in lines of the spacing that they have about there on average; None
    where all are even.
    """
    if not isinstance(camera, PushbroomCamera) or camera.lines <= PLACE_MEAN:
        return None
    lines = np.arange(camera.lines, dtype=np.float64)
    mean = np.hanning(PLACE_MEAN + 2)[1:-1]
    out = np.empty((camera.lines, 2))
    for side, column in enumerate((0.0, camera.columns - 1.0)):
        steps = np.diff(
            camera.locate(np.stack([lines, np.full(len(lines), column)], axis=1), surface), axis=0
        )
        known = np.isfinite(steps).all(axis=1)
        steps[~known] = 0.0
        track = np.stack([np.convolve(part, mean, "same") for part in steps.T], axis=1)
        # along the mean step, in units of it
        count = np.convolve(known, mean, "same")  # of lines, by their weight
        square = np.einsum("ni,ni->n", track, track)
        usual = np.einsum("ni,ni->n", steps, track) * count / np.where(square > 0.0, square, 1.0)
        out[:, side] = np.append(0.0, np.cumsum(np.where(known & (square > 0.0), usual, 1.0)))
    return out if np.abs(np.diff(out, 2, axis=0)).max() > EVEN else None


def found_wrong(before: StarRecord | None, hub: int, grid: WindowGrid, pairs: int) -> NDArray[np.bool_]:
    """(G, K): windows that an earlier pass matched and threw out; none in rows that lost most of theirs."""
    none = np.zeros((len(grid.centres), pairs), dtype=bool)
    if before is None or not _same_windows(before, hub, grid) or before.star.t.shape != none.shape:
        return none
    wrong = (before.star.weight == 0.0) & ((before.status == KEPT) | (before.status == OUTLIER))
    by_row = wrong.reshape(*grid.shape, pairs)
    return np.asarray((by_row & (by_row.mean(axis=1, keepdims=True) < MOST_WRONG)).reshape(none.shape))


def _same_windows(before: StarRecord, hub: int, grid: WindowGrid) -> bool:
    """Whether an earlier pass cut these very windows from the same image."""
    return before.star.hub == hub and np.array_equal(before.star.pixels, grid.centres)


def _brightness(before: StarRecord | None, image: ImageSource, hub: int, grid: WindowGrid) -> Array:
    """(G,) brightness of each window in the hub; read once for passes that cut the same windows."""
    if before is not None and before.star.brightness is not None and _same_windows(before, hub, grid):
        return before.star.brightness
    return brightest_parts(image, grid)


def _learning(points: Array, image: ImageSource, plan: MatchingPlan) -> Array:
    """Where a pair's whitening is learned: at its windows, or all over the image where they are few."""
    if len(points) >= ENOUGH:
        return points
    everywhere = plan.grid(image.shape).centres
    return everywhere[np.linspace(0, len(everywhere) - 1, min(ENOUGH, len(everywhere))).astype(int)]


def _narrow_whitening(
    image: ImageSource, laid: ImageSource, grid: WindowGrid, plan: MatchingPlan
) -> Whitening | None:
    """Whitening filters from tiles in the middle of a narrow view, of a size that fits in."""
    first, last = grid.sides
    tile = (min(TILE_LINES, image.shape[0] // 2), int(last - first) - 2 * TILE_MARGIN)
    lines = plan.grid(image.shape).lines
    points = np.stack([lines, np.full(len(lines), 0.5 * (first + last - 1.0))], axis=1)
    return pair_whitening(image, laid, points, tile) if tile[1] >= TILE_LINES else None


def pair_whitening(
    image: ImageSource,
    laid: ImageSource,
    points: Array,
    tile: tuple[int, int] | None = None,
) -> Whitening | None:
    """Whitening filters of a pair from some of `points` (N, 2); None where too little can be seen there."""
    try:
        return estimate_whitening(image, laid, points, points, most_tiles=TILES, tile=tile)
    except EstimationError:
        return None


def _fineness(cameras: Sequence[MovingCamera], hub: int, partners: Sequence[int]) -> tuple[float, ...]:
    """Pixels of each partner, across, to one of the hub: 1 where they are like."""
    across = pixel_sizes(cameras)[:, 1]
    ratios = (across[hub] / across[image] for image in partners)
    return tuple(float(ratio) if ratio > UNLIKE else 1.0 for ratio in ratios)


def _size_in(
    cameras: Sequence[MovingCamera], hub: int, partner: int, window: tuple[int, int]
) -> tuple[float, float]:
    """Lines and columns of a partner that a window of a hub fills."""
    if parts_of_pixel(cameras, hub, partner) == (1, 1):
        return window
    sizes = pixel_sizes(cameras)
    along, across = sizes[hub] / sizes[partner]
    return window[0] * along, window[1] * across


def within_image(pixels: Array, shape: tuple[int, int], window: tuple[float, float]) -> NDArray[np.bool_]:
    """Windows about `pixels` that lie in an image of `shape`; False for NaN."""
    half = (np.array(window) - 1) / 2.0
    with np.errstate(invalid="ignore"):
        inside = (pixels >= half - 0.5) & (pixels <= np.array(shape) - 0.5 - half)
    return np.asarray(inside.all(axis=1))


def _tdi(
    cameras: Sequence[MovingCamera],
    hub: int,
    partners: Sequence[int],
    grid: WindowGrid,
    predicted: Sequence[Predictions],
) -> tuple[Array | None, Array | None]:
    """Times (G,) and (G, K) s that TDI averages over in hub and partners; None where none has TDI."""

    def times(image: int, pixels: Array) -> Array:
        camera = cameras[image]
        return camera.integration(pixels) if isinstance(camera, PushbroomCamera) else np.zeros(len(pixels))

    if all(getattr(cameras[image], "stages", None) is None for image in (hub, *partners)):
        return None, None
    there = [times(image, p.b) for image, p in zip(partners, predicted, strict=True)]
    return times(hub, grid.centres), np.stack(there, axis=1)


def _duration(camera: MovingCamera, grid: WindowGrid, *, exposed: bool) -> tuple[float, float]:
    """Length (s) of the boxcar that spreads as the window's h line centres do, and what is added along lines.

    That is sqrt(h^2 - 1) line periods. With the exposure of each line, which coarse lines average over, it is
    h; and shifts along the lines, found by comparing neighbours, are averaged over NEIGHBOURS more. Of four
    of the finest lines both are some per cent, and left out.
    """
    if not isinstance(camera, PushbroomCamera):
        return 0.0, 0.0
    ends = exposure_times(camera, np.array([[0.0, 0.0], [camera.lines - 1.0, 0.0]]))
    period = (ends[1] - ends[0]) / max(camera.lines - 1, 1)
    lines = grid.window[0]
    # the exposure of TDI is averaged over beside the window
    square = lines**2 - (0.0 if exposed and camera.stages is None else 1.0)
    spread = math.sqrt(square)
    stretch = math.sqrt(square + NEIGHBOURS) - spread if exposed else 0.0
    return float(period * spread), float(period * stretch)
