"""Windows of each frame found in its next few: the measurements of a matrix instrument.

Every frame is the hub of its neighbours at given lags. A partner is laid on the hub's geometry
first (present cameras), so that large changes of view do not trouble the matcher. What is kept is
where each window was found, whatever the cameras: it can be linearised again and again.

Not here: the first guess (``start.py``), sensitivities (``linear.py``), the estimate
(``solve.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource, in_memory
from sightline.matching.on_geometry import FoundWindows, PairOnGeometry
from sightline.matching.whitening import TILES, Whitening, pair_whitening
from sightline.motion.measure.windows import WindowGrid, window_grid
from sightline.stages import Stages

Array = NDArray[np.float64]

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
    # whole frames at once: windows overlap, and a frame fits in memory
    whole, points = in_memory(images[hub]), grid.centres
    found: dict[int, FoundWindows] = {}
    for partner in partners:
        geometry = partial(predict_match, cameras[hub], cameras[partner], surface)
        pair = PairOnGeometry(whole, images[partner], geometry)
        seen = np.isfinite(pair.where(points)).all(axis=1)
        if seen.sum() < MIN_WINDOWS:
            continue
        laid, lag = pair.laid(), partner - hub
        if whitenings is not None and whitenings.get(lag) is None:
            whitenings[lag] = pair_whitening(whole, laid, points[seen], most_tiles=TILES)
        found[partner] = pair.found(
            points, window=grid.window, search_px=(plan.search_px, plan.search_px), laid=laid,
            whitening=None if whitenings is None else whitenings[lag],
        )  # fmt: skip
    return frame_star(hub, found, grid.shape, grid.window) if found else None


def frame_star(
    hub: int, found: Mapping[int, FoundWindows], shape: tuple[int, int], window: tuple[int, int]
) -> FrameStar:
    """What was found of a frame's windows, (rows, blocks) of them, in partners by their number."""
    matches = [one.matches for one in found.values()]
    kept = np.stack([one.kept for one in matches], axis=1)
    covariance = np.stack([one.covariance_px for one in matches], axis=1)
    return FrameStar(
        hub,
        tuple(found),
        shape,
        window,
        matches[0].a,
        np.where(kept[..., None], np.stack([one.b for one in matches], axis=1), np.nan),
        np.where(kept[..., None, None], covariance, np.eye(2)),
        np.stack([one.status for one in matches], axis=1),
        np.stack([one.score for one in matches], axis=1),
        np.ones(kept.shape),
    )
