"""Which windows of which image are matched with which others, and how: S1's box 20 for a whole strip.

The first image serves all ground it sees, later images only what no earlier hub has seen, and their own first
and last lines, so that no pair is counted twice.

Not here: how one image is laid on another (``laid_strips.py``), what the windows say (``stars.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.matching.select import Selection
from sightline.motion.measure.common_view import Views, common_views, partners_of, usable
from sightline.motion.measure.laid_strips import groups_of_pixels, ratio_to_finest
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.windows import WindowGrid, window_grid

Array = NDArray[np.float64]

#: Windows of another image are not found nearer than this to the ends of an image (px): the kernel that lays
#: one image on the other reads 4, the derivative another 4.
END = 8
#: Windows in a row of a narrow view, and their least width (px).
NARROW_BLOCKS, LEAST_WIDTH = 4, 16
#: What may be compared, and how matches may count.
SIMILARITIES = ("whitened", "radiometric", "gradient")
WEIGHTINGS = ("covariance", "predicted", "none")
#: Least windows (lines, columns) on grids coarser than the finest.
COARSE_WINDOW = (2, 24)
#: px that are searched there beyond what is as far on the finest (offsets are known in pixels of each band),
#: and least pixels of a window that is searched for.
COARSE_SEARCH, SEARCHED_PIXELS = 3, 200
#: Rows of windows in the shortest lag at least, and lines of a window at least.
ROWS_IN_LAG, LEAST_WINDOW = 1.8, 2
#: Share of a window's columns that may lie where TDI has another number of stages than at its middle.
MIXED = 0.1
#: Windows are narrowed, by whole parts to at most so many, where that lets so much more of a line be used.
MOST_PARTS, MORE_USED = 4, 1.1


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
    rough : bool
        Later passes match again: how matches answer where lines stand unevenly, and what aliasing adds to
        those of like images, is not looked for.
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
    rough: bool = False
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
