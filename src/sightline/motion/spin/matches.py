"""Windows of each strip found in strips of later exposures: the measurements of a spinning camera.

The spin carries the ground from strip to strip of the chip (S1, fig. 16): each filter sees it a few exposures
after the one before, and each strip overlaps itself one exposure later. Every pair of strips that shares
lines is matched at every number of exposures at which it does: with one such lag per pair, spin rate and
places of the strips are confounded.

Windows are compared as they are: low strips with masked specks leave some ten clean tiles to learn a
whitening from, and such filters made the matches of real strips worse (0.33 px in place of 0.25).

Not here: matching of whole frames (``motion/frames/matches.py``), the estimate (``solve.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Infinity, Surface
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.matching import matches as codes
from sightline.matching.on_geometry import PairOnGeometry
from sightline.motion.band import Frame
from sightline.motion.frames.matches import FramePlan, FrameStar, frame_star, match_hub
from sightline.motion.measure.windows import WindowGrid, window_grid

Array = NDArray[np.float64]

#: Fewest lines two strips must share to be matched.
LEAST_LINES = 8
#: Lines beyond a window that interpolation wants to see on either side. Where two strips share less, they are
#: matched as they are, without one being laid on the other.
BESIDE_LINES = 8
#: Lines of a narrow overlap left free at either end, for the prediction's error and the interpolation.
NARROW_END = 1
#: px along columns: structure larger than the second, and noise smaller than the first, is taken out before
#: narrow overlaps are compared.
NARROW_BAND = (0.7, 6.0)
#: px; narrow windows known less well than this say little, and some of them lie.
NARROW_SIGMA = 0.25


@dataclass(frozen=True)
class StripPair:
    """Two strips and how many exposures lie between them.

    Attributes
    ----------
    hub, partner : int
        Numbers of the strips; the hub's exposure is the earlier one.
    lag : int
        Exposures.
    lines : int
        Lines that both see.
    """

    hub: int
    partner: int
    lag: int
    lines: int


@dataclass(frozen=True)
class SpinPlan:
    """How one pass looks at the strips.

    Attributes
    ----------
    window : (lines, columns)
        px; narrower overlaps get windows as high as they allow.
    search_px : int
        px; half-range of the integer search about the prediction.
    """

    window: tuple[int, int]
    search_px: int


def strip_pairs(frames: Sequence[Frame]) -> list[StripPair]:
    """Every pair of strips that shares lines, at every lag at which it does.

    Parameters
    ----------
    frames : sequence of Frame
        Exposure by exposure; those about the middle of the sequence are asked.
    """
    place = image_places(frames)
    exposures = sorted({frame.exposure for frame in frames})
    strips = sorted({frame.strip for frame in frames})
    out: list[StripPair] = []
    for lag in range(1, len(exposures)):
        first = exposures[(len(exposures) - lag) // 2]
        second = exposures[exposures.index(first) + lag]
        found = []
        for a in strips:
            for b in strips:
                shared = _shared_lines(frames[place[first, a]].camera, frames[place[second, b]].camera)
                if shared >= LEAST_LINES:
                    found.append(StripPair(a, b, lag, shared))
        if not found and out:
            break
        out += found
    return out


def image_places(frames: Sequence[Frame]) -> dict[tuple[int, int], int]:
    """Number of the image of every (exposure, strip)."""
    return {(frame.exposure, frame.strip): k for k, frame in enumerate(frames)}


def _shared_lines(hub: FrameCamera, partner: FrameCamera) -> int:
    """Lines of the hub, in its middle column, that the partner sees far away."""
    lines = np.arange(hub.shape[0], dtype=np.float64)
    pixels = np.column_stack([lines, np.full(len(lines), (hub.shape[1] - 1) / 2.0)])
    seen = partner.project(hub.locate(pixels, Infinity()))
    return int(((seen[:, 0] >= 0.0) & (seen[:, 0] <= partner.shape[0] - 1.0)).sum())


def match_strips(
    frames: Sequence[Frame],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    pairs: Sequence[StripPair],
    plan: SpinPlan,
    step: Step = no_step,
) -> list[FrameStar]:
    """Match every pair of strips at every exposure.

    Parameters
    ----------
    frames : sequence of Frame
        Images.
    cameras : sequence of FrameCamera
        As known so far, in the order of `frames`.
    surface : Surface
    pairs : sequence of StripPair
    plan : SpinPlan
    step : callable
        Called with the number of pairs of images that are done, and of all.

    Returns
    -------
    list of FrameStar
        One per pair of images that match, each with one partner.
    """
    images = [frame.image for frame in frames]
    place = image_places(frames)
    exposures = sorted({frame.exposure for frame in frames})
    out = []
    jobs = [(pair, k) for pair in pairs for k in range(len(exposures) - pair.lag)]
    for pair, k in stepped(jobs, step):
        hub = place[exposures[k], pair.hub]
        partner = place[exposures[k + pair.lag], pair.partner]
        star = _match_pair(images, cameras, surface, hub, partner, pair, plan)
        if star is not None and star.present.any():
            out.append(star)
    return sorted(out, key=lambda star: (star.hub, star.images))


def _match_pair(
    images: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    hub: int,
    partner: int,
    pair: StripPair,
    plan: SpinPlan,
) -> FrameStar | None:
    """The windows of one strip found in one other."""
    if pair.lines >= plan.window[0] + BESIDE_LINES:
        window = plan.window
        grid = window_grid(images[hub].shape, window, window[0] // 2, columns_step=window[1] // 2)
        frame_plan = FramePlan(window, grid.window[0] // 2, plan.search_px, (partner - hub,))
        return match_hub(images, cameras, surface, hub, (partner,), grid, frame_plan, None)
    window = min(pair.lines - 2 * NARROW_END, plan.window[0]), 2 * plan.window[1]
    grid = window_grid(images[hub].shape, window, 1, columns_step=window[1] // 2)
    return _match_narrow(images, cameras, surface, hub, partner, grid, plan.search_px)


def _match_narrow(
    images: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    hub: int,
    partner: int,
    grid: WindowGrid,
    search_px: int,
) -> FrameStar | None:
    """One row of low windows where two strips share too few lines for filters along them.

    Both images keep their own lines; only along the columns is structure selected.
    """
    geometry = partial(predict_match, cameras[hub], cameras[partner], surface)
    pair = PairOnGeometry(_along_columns(images[hub]), _along_columns(images[partner]), geometry)
    # of all heights of the row, that which leaves most lines free on both sides
    half = (grid.window[0] - 1) / 2.0
    sides = ((pair.hub, grid.centres[:, 0]), (pair.partner, pair.where(grid.centres)[:, 0]))
    room = [np.minimum(line - half, image.shape[0] - 1.0 - half - line) for image, line in sides]
    free = np.nan_to_num(np.minimum(*room), nan=-1.0).reshape(grid.shape)
    best, blocks = np.argmax(free, axis=0), np.arange(grid.shape[1])
    inside = free[best, blocks] >= 0.0
    if not inside.any():
        return None
    found = pair.found(
        grid.centres[best * grid.shape[1] + blocks], window=grid.window, search_px=(0, search_px),
        whitening=None, max_sigma_px=NARROW_SIGMA,
    )  # fmt: skip
    found = replace(found, matches=found.matches.with_status(~inside, codes.OUTSIDE))
    return frame_star(hub, {partner: found}, (1, len(best)), grid.window)


def _along_columns(image: ImageSource) -> ArrayImage:
    """A strip with structure of some columns' width only."""
    from scipy.ndimage import gaussian_filter1d

    lines, columns = image.shape
    pixels = np.nan_to_num(image.read((0, lines), (0, columns)).astype(np.float64))
    fine, coarse = (gaussian_filter1d(pixels, sigma, axis=1) for sigma in NARROW_BAND)
    return ArrayImage((fine - coarse).astype(np.float32), image.mask((0, lines), (0, columns)))


def reuse(star: FrameStar) -> Array:
    """(G,) share of each kept window that is its own: 1 apart from others, 1/4 where four overlap."""
    kept = star.present[:, 0]
    out = np.ones(len(star.pixels))
    if not kept.any():
        return out
    at = star.pixels[kept]
    overlap = np.ones((len(at), len(at)))
    for axis in range(2):
        apart = np.abs(at[:, None, axis] - at[None, :, axis]) / star.window[axis]
        overlap *= np.maximum(1.0 - apart, 0.0)
    out[kept] = 1.0 / overlap.sum(axis=1)
    return out


def pair_of(star: FrameStar, frames: Sequence[Frame], pairs: Sequence[StripPair]) -> int:
    """Which of `pairs` a star belongs to."""
    hub, partner = frames[star.hub], frames[star.images[0]]
    for number, pair in enumerate(pairs):
        if (pair.hub, pair.partner) == (hub.strip, partner.strip) and partner.exposure == (
            hub.exposure + pair.lag
        ):
            return number
    raise KeyError(f"images {star.hub} and {star.images[0]} are of no pair of strips")
