"""Windows of each frame found in its next few: the measurements of a matrix instrument.

Every frame is the hub of its neighbours at given lags. A partner is laid on the hub's geometry
first (present cameras), so that large changes of view do not trouble the matcher. What is kept is
where each window was found, whatever the cameras: it can be linearised again and again.

Not here: the first guess (``start.py``), sensitivities (``linear.py``), the estimate
(``solve.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.imaging.warp import WarpedImage, lattice_map
from sightline.matching import matches as codes
from sightline.matching.match_images import match_images
from sightline.matching.whitening import Whitening
from sightline.motion.measure.stars import pair_whitening
from sightline.motion.measure.windows import WindowGrid, predict_windows, window_grid
from sightline.stages import Stages

Array = NDArray[np.float64]

#: Columns between places where the map between two frames is handed to the resampler, which goes in straight
#: lines between: h px bias a window by about d h^2 / (6 f^2) for a displacement d and focal length f, 3e-4 px
#: for d = 100, h = 4 and f = 1000.
MAP_SPACING = 4
#: Fewest windows a pair must share to be matched at all.
MIN_WINDOWS = 6


@dataclass(frozen=True)
class FramePlan:
    """How one pass looks at the frames.

    Attributes
    ----------
    window : (lines, columns)
        px.
    step : int
        px between windows, along lines and columns.
    search_px : int
        px; half-range of the integer search about the prediction.
    lags : tuple of int
        Frames ahead in which each frame is looked for.
    """

    window: tuple[int, int]
    step: int
    search_px: int
    lags: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class FrameStar:
    """Windows of one frame and where they were found in others.

    Attributes
    ----------
    hub : int
    images : tuple of int
        The K partners.
    shape : (rows, blocks)
        Of the grid of G windows.
    window : (lines, columns)
        px.
    pixels : (G, 2)
        Centres in the hub, px.
    measured : (G, K, 2)
        Where they were found, px; NaN where they were not.
    covariance_px : (G, K, 2, 2)
        The matcher's, px^2.
    status : (G, K) uint8
    score : (G, K)
    weight : (G, K)
        Robust weight in [0, 1].
    """

    hub: int
    images: tuple[int, ...]
    shape: tuple[int, int]
    window: tuple[int, int]
    pixels: Array
    measured: Array
    covariance_px: Array
    status: NDArray[np.uint8]
    score: Array
    weight: Array

    @property
    def lags(self) -> tuple[int, ...]:
        """Frames from the hub to each partner."""
        return tuple(image - self.hub for image in self.images)

    @property
    def present(self) -> NDArray[np.bool_]:
        """(G, K): matches that exist and carry weight."""
        return np.asarray(np.isfinite(self.measured[..., 0]) & (self.weight > 0.0))

    def with_weight(self, weight: Array) -> FrameStar:
        """The same matches with other robust weights, (G, K)."""
        return replace(self, weight=weight)

    def of_lags(self, lags: Sequence[int]) -> FrameStar | None:
        """Only the partners at some lags; None if there is none."""
        keep = [k for k, lag in enumerate(self.lags) if lag in lags]
        if not keep:
            return None
        names = ("measured", "covariance_px", "status", "score", "weight")
        kept = {name: getattr(self, name)[:, keep] for name in names}
        return replace(self, images=tuple(self.images[k] for k in keep), **kept)

    def residuals(self, cameras: Sequence[FrameCamera], surface: Surface) -> Array:
        """Measured minus predicted, (G, K, 2) px, for any cameras."""
        ground = cameras[self.hub].locate(self.pixels, surface)
        predicted = np.stack([cameras[image].project(ground) for image in self.images], axis=1)
        return self.measured - predicted


@dataclass(frozen=True, eq=False)
class _Matched:
    """What one pass of matching found."""

    stars: tuple[FrameStar, ...]


def kept_matches(stages: Stages, name: str, match: Callable[[], Sequence[FrameStar]]) -> list[FrameStar]:
    """What a pass of matching found: now, or in an earlier run that was stopped.

    Parameters
    ----------
    stages : Stages
    name : str
        Of the pass, as a stage.
    match : callable
        Matches now.
    """
    found = stages.held(name, _Matched, writeable=True)
    if found is None:
        found = _Matched(tuple(match()))
        stages.put(name, found)
    return list(found.stars)


def match_neighbours(
    images: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    plan: FramePlan,
    step: Step = no_step,
) -> list[FrameStar]:
    """Match every frame with its neighbours at the plan's lags, counting frames by `step`.

    Returns
    -------
    list of FrameStar
        One per frame that shares ground with a later one.
    """
    grid = window_grid(images[0].shape, plan.window, plan.step, columns_step=plan.step)
    whitenings: dict[int, Whitening | None] = {}
    out = []
    for hub in stepped(range(len(images) - 1), step):
        partners = tuple(hub + lag for lag in plan.lags if hub + lag < len(images))
        star = match_hub(images, cameras, surface, hub, partners, grid, plan, whitenings)
        if star is not None:
            out.append(star)
    return out


def laid_frame(
    images: Sequence[ImageSource], cameras: Sequence[FrameCamera], surface: Surface, hub: int, partner: int
) -> WarpedImage:
    """The partner's frame in the geometry of the hub, as far as the cameras know it."""
    source, target = cameras[hub], cameras[partner]

    def exact(pixels: Array) -> Array:
        return target.project(source.locate(pixels, surface))

    return WarpedImage(images[partner], lattice_map(exact), images[hub].shape, MAP_SPACING)


def match_hub(
    images: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    hub: int,
    partners: tuple[int, ...],
    grid: WindowGrid,
    plan: FramePlan,
    whitenings: dict[int, Whitening | None] | None,
) -> FrameStar | None:
    """The windows of one frame found in some others; None if none shares enough ground.

    `whitenings` holds the filters of each lag once they are known: one camera took all frames. Without it
    windows are compared as they are.
    """
    predicted = predict_windows(cameras, hub, partners, surface, grid)
    ground = cameras[hub].locate(grid.centres, surface)
    g = len(grid.centres)
    lines, columns = images[hub].shape
    # whole frames at once: windows overlap, and a frame fits in memory
    whole = ArrayImage(images[hub].read((0, lines), (0, columns)), images[hub].mask((0, lines), (0, columns)))
    measured: list[Array] = []
    covariances: list[Array] = []
    statuses: list[NDArray[np.uint8]] = []
    scores: list[Array] = []
    kept: list[int] = []
    for partner, prediction in zip(partners, predicted, strict=True):
        inside = np.isfinite(prediction.b).all(axis=1)
        if inside.sum() < MIN_WINDOWS:
            continue
        laid = ArrayImage(laid_frame(images, cameras, surface, hub, partner).read((0, lines), (0, columns)))
        lag = partner - hub
        if whitenings is not None and whitenings.get(lag) is None:
            whitenings[lag] = pair_whitening(whole, laid, grid.centres[inside])
        found = match_images(
            whole,
            laid,
            grid.centres,
            grid.centres,
            window=grid.window,
            search_px=(plan.search_px, plan.search_px),
            whitening=None if whitenings is None else whitenings[lag],
        )
        good = found.kept & inside
        b, covariance = np.full((g, 2), np.nan), np.tile(np.eye(2), (g, 1, 1))
        turn = prediction.affine[good]
        # the map's own value at the centre, to which the laid frame refers, not its mean over the window
        centre = cameras[partner].project(ground[good])
        b[good] = centre + np.einsum("nij,nj->ni", turn, found.b[good] - grid.centres[good])
        covariance[good] = turn @ found.covariance_px[good] @ np.swapaxes(turn, 1, 2)
        status = np.where(found.kept & ~inside, np.uint8(codes.OUTSIDE), found.status)
        measured.append(b)
        covariances.append(covariance)
        statuses.append(status)
        scores.append(found.score)
        kept.append(partner)
    if not kept:
        return None
    return FrameStar(
        hub,
        tuple(kept),
        grid.shape,
        grid.window,
        grid.centres,
        np.stack(measured, axis=1),
        np.stack(covariances, axis=1),
        np.stack(statuses, axis=1),
        np.stack(scores, axis=1),
        np.ones((g, len(kept))),
    )
