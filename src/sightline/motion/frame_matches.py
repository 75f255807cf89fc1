"""Windows of each frame found in its next few: the measurements of a matrix instrument.

Every frame is the hub of its neighbours at given lags. A partner is laid on the hub's geometry
first (present cameras), so that large changes of view do not trouble the matcher. What is kept is
where each window was found, whatever the cameras: it can be linearised again and again.

Not here: the first guess (``frame_start.py``), sensitivities (``frame_linear.py``), the estimate (``frames.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.matching import matches as codes
from sightline.matching.match_images import match_images
from sightline.motion.stars import laid_on, pair_whitening
from sightline.motion.windows import WindowGrid, predict_windows, window_grid

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
        return replace(
            self,
            images=tuple(self.images[k] for k in keep),
            **{name: getattr(self, name)[:, keep] for name in ("measured", "covariance_px", "status", "score", "weight")},
        )

    def residuals(self, cameras: Sequence[FrameCamera], surface: Surface) -> Array:
        """Measured minus predicted, (G, K, 2) px, for any cameras."""
        ground = cameras[self.hub].locate(self.pixels, surface)
        return np.stack([self.measured[:, k] - cameras[j].project(ground) for k, j in enumerate(self.images)], axis=1)


def match_frames(
    images: Sequence[ImageSource], cameras: Sequence[FrameCamera], surface: Surface, plan: FramePlan
) -> list[FrameStar]:
    """Match every frame with its neighbours at the plan's lags.

    Returns
    -------
    list of FrameStar
        One per frame that shares ground with a later one.
    """
    grid = window_grid(images[0].shape, plan.window, plan.step, columns_step=plan.step)
    out = []
    for hub in range(len(images) - 1):
        partners = tuple(hub + lag for lag in plan.lags if hub + lag < len(images))
        star = match_hub(images, cameras, surface, hub, partners, grid, plan)
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
) -> FrameStar | None:
    """The windows of one frame found in some others; None if none shares enough ground."""
    predicted = predict_windows(cameras, hub, partners, surface, grid)
    g = len(grid.centres)
    measured, covariances, statuses, scores, kept = [], [], [], [], []
    for partner, prediction in zip(partners, predicted, strict=True):
        inside = np.isfinite(prediction.b).all(axis=1)
        if inside.sum() < MIN_WINDOWS:
            continue
        # the whole frame at once: windows overlap, and a frame fits in memory
        lines, columns = images[hub].shape
        laid = ArrayImage(laid_on(images, cameras, surface, hub, partner).read((0, lines), (0, columns)))
        found = match_images(
            images[hub],
            laid,
            grid.centres,
            grid.centres,
            window=grid.window,
            search_px=(plan.search_px, plan.search_px),
            whitening=pair_whitening(images[hub], laid, prediction, grid),
        )
        good = found.kept & inside
        b, covariance = np.full((g, 2), np.nan), np.tile(np.eye(2), (g, 1, 1))
        turn = prediction.affine[good]
        b[good] = prediction.b[good] + np.einsum("nij,nj->ni", turn, found.b[good] - grid.centres[good])
        covariance[good] = turn @ found.covariance_px[good] @ np.swapaxes(turn, 1, 2)
        status = np.where(found.kept & ~inside, np.uint8(codes.OUTSIDE), found.status)
        for parts, value in ((measured, b), (covariances, covariance), (statuses, status), (scores, found.score)):
            parts.append(value)
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
