"""Matched windows of one hub image, gathered into a star of observations.

S1's boxes 20 to 26 for a whole strip: lay windows, predict, match, residual. Which hubs are
needed is decided here too: the first image serves all ground it sees, later images only what
no earlier hub has seen, and their own first and last lines, so that no pair is counted twice.

Not here: what is done with the observations (``motion/strip/joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.execution import Step, in_threads, no_step
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Dem, Surface
from sightline.imaging.source import ImageSource
from sightline.imaging.warp import WarpedImage
from sightline.matching.match_images import match_images
from sightline.matching.matches import KEPT, MASKED, NOT_CHOSEN, OUTLIER, OUTSIDE
from sightline.matching.select import Selection, chosen_windows
from sightline.matching.whitening import Whitening, estimate_whitening, gradient_filter
from sightline.motion.measure.common_view import Views, common_views, partners_of, usable
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.measure.sampled_sensitivities import sampled_sensitivities
from sightline.motion.measure.windows import (
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
#: Tiles that teach the whitening of a pair.
TILES = 400
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
    tiles : int
        At most so many tiles of each pair teach its whitening.
    selection : Selection
        Which windows are matched.
    similarity : str
        One of SIMILARITIES: what is compared.
    weighting : str
        One of WEIGHTINGS: how matches count.
    predicted : tuple of (columns, 2) or None
        Of every image, the relative sigma along lines and columns of a match at each of its columns, as
        predicted from MTF and SNR; only ratios matter, and only with weighting ``"predicted"``.
    """

    window: tuple[int, int]
    step: int
    search_px: tuple[int, int] = (0, 0)
    most_blocks: int = 0
    tiles: int = TILES
    selection: Selection = field(default_factory=Selection)
    similarity: str = "whitened"
    weighting: str = "covariance"
    predicted: tuple[Array | None, ...] = ()

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
    """

    star: Star
    status: NDArray[np.uint8]
    score: Array


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
    out = []
    for place, hub in enumerate(order):
        for group in partners_of(views, order, place, shapes[hub][1]):
            grid = plan.grid(shapes[hub], group.columns)
            if group.earlier:
                grid = _fresh(cameras, surface, shapes, hub, group.earlier, grid)
            if len(grid.lines):
                out.append((hub, group.images, grid))
        first = next((image for image in order[:place] if (hub, image) in views), None)
        if first is not None and max(plan.search_px) == 0:
            grid = plan.grid(shapes[hub], usable(views[hub, first], shapes[hub][1]))
            lines = _end_lines(shapes[hub][0], grid.window[0], plan.step)
            out.append((hub, (first,), WindowGrid(grid.window, lines, grid.columns)))
    return out


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
) -> StarRecord:
    """Match one hub's windows in all its partners and write down what they say.

    `step` is called with the number of windows that are done, and of all.

    Windows that `before`, the same star of an earlier pass, found to be wrong are not tried again: clouds
    among them would spoil the whitening and the pooled errors of the good ones.
    """
    predicted = predict_windows(cameras, hub, partners, surface, grid)
    g, k = len(grid.centres), len(partners)
    wrong = found_wrong(before, hub, grid, k)
    chosen = chosen_windows(images[hub], hub, grid.centres, grid.window, plan.selection)
    residual = np.full((g, k, 2), np.nan)
    covariance = np.tile(np.eye(2), (g, k, 1, 1))
    status = np.ones((g, k), dtype=np.uint8)
    score = np.full((g, k), np.nan)

    seen = [np.isfinite(one.b[:, 0]) for one in predicted]
    laid = [laid_on(images, cameras, surface, hub, partner) for partner in partners]

    def whitening(j: int) -> Whitening | None:
        if plan.similarity != "whitened":
            return GRADIENT if plan.similarity == "gradient" else None
        if grid.narrow(images[hub].shape[1]):
            return _narrow_whitening(images[hub], laid[j], grid, plan)
        points = _learning(grid.centres[seen[j] & ~wrong[:, j]], images[hub], plan)
        return pair_whitening(images[hub], laid[j], points, plan.tiles)

    def sensitivity(j: int) -> NDArray[np.float32]:
        return sampled_sensitivities(cameras, hub, partners[j], surface, grid, seen[j], statics)

    whitenings = in_threads(whitening, range(k))
    values = np.stack(in_threads(sensitivity, range(k)), axis=1)
    # one pair after the other: its blocks are matched on threads, and only so many are held at a time
    for j, partner in enumerate(partners):

        def blocks(done: int, total: int, j: int = j) -> None:
            step(j * g + done * g // total, k * g)

        points = np.where((seen[j] & ~wrong[:, j] & chosen)[:, None], grid.centres, np.nan)
        matches = match_images(
            images[hub],
            laid[j],
            points,
            points,
            window=grid.window,
            search_px=plan.search_px,
            whitening=whitenings[j],
            step=blocks,
        )
        good = matches.kept & np.isfinite(values[:, j]).all(axis=(1, 2)) & seen[j]
        turn = predicted[j].affine[good]
        residual[good, j] = np.einsum("nij,nj->ni", turn, matches.b[good] - grid.centres[good])
        covariance[good, j] = turn @ matches.covariance_px[good] @ np.swapaxes(turn, 1, 2)
        beyond = ~within_image(predicted[j].b, images[partner].shape, grid.window)
        status[:, j] = np.where(beyond & (matches.status == MASKED), OUTSIDE, matches.status)
        status[seen[j] & ~chosen, j] = NOT_CHOSEN
        if plan.weighting != "covariance" and good.any():
            mean = 0.5 * np.einsum("nii->n", covariance[good, j]).mean()
            places = np.stack([grid.centres[good, 1], predicted[j].b[good, 1]])
            covariance[good, j] = mean * _relative(plan, (hub, partner), places)
        score[:, j] = matches.score
    camera = cameras[hub]
    star = Star(
        hub=hub,
        images=partners,
        shape=grid.shape,
        pixels=grid.centres,
        t_hub=exposure_times(camera, grid.centres),
        t=np.stack([p.t for p in predicted], axis=1),
        duration=_duration(camera, grid),
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
    return StarRecord(star, status, score)


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


def laid_on(
    images: Sequence[ImageSource], cameras: Sequence[MovingCamera], surface: Surface, hub: int, partner: int
) -> WarpedImage:
    """The partner's image in the geometry of the hub, as far as the cameras know it."""
    source, target = cameras[hub], cameras[partner]

    def mapping(lines: Array, columns: Array) -> Array:
        pixels = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        b = target.project(source.locate(pixels, surface))
        return b.reshape(len(lines), len(columns), 2)

    spacing = RELIEF_SPACING if isinstance(surface, Dem) else SMOOTH_SPACING
    return WarpedImage(images[partner], mapping, images[hub].shape, spacing, line_places(target, surface))


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
    return pair_whitening(image, laid, points, plan.tiles, tile) if tile[1] >= TILE_LINES else None


def pair_whitening(
    image: ImageSource,
    laid: ImageSource,
    points: Array,
    tiles: int = TILES,
    tile: tuple[int, int] | None = None,
) -> Whitening | None:
    """Whitening filters of a pair from some of `points` (N, 2); None where too little can be seen there."""
    try:
        return estimate_whitening(image, laid, points, points, most_tiles=tiles, tile=tile)
    except EstimationError:
        return None


def within_image(pixels: Array, shape: tuple[int, int], window: tuple[int, int]) -> NDArray[np.bool_]:
    """Windows about `pixels` that lie in an image of `shape`; False for NaN."""
    half = (np.array(window) - 1) / 2.0
    with np.errstate(invalid="ignore"):
        inside = (pixels >= half - 0.5) & (pixels <= np.array(shape) - 0.5 - half)
    return np.asarray(inside.all(axis=1))


def _duration(camera: MovingCamera, grid: WindowGrid) -> float:
    """Length (s) of the boxcar that spreads as the window's h line centres do: sqrt(h^2 - 1) line periods."""
    if not isinstance(camera, PushbroomCamera):
        return 0.0
    ends = exposure_times(camera, np.array([[0.0, 0.0], [camera.lines - 1.0, 0.0]]))
    period = (ends[1] - ends[0]) / max(camera.lines - 1, 1)
    return float(period * math.sqrt(grid.window[0] ** 2 - 1.0))
