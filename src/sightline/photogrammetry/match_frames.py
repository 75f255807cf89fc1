"""Points found in many frames of one scene, each with the error of its own image: pixels to `Tracks`.

A point is a window of one frame, its hub; every other frame that sees it is laid on the hub's geometry, as
planned poses and the surface have it, and the window is found there. What was found at a coarse scale,
smoothed over the frame, becomes part of the map at the next: errors of pose, relief and lens are learnt
together, so that in the end windows differ by noise alone and not by how they are deformed.

The hub is a sighting like the others. A pair's match errs by the noise of both windows; given to each image
its share, the errors of all sightings of a point are independent (docs/decisions/0003).

Not here: the comparison of windows (``matching/``), orientation (``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.reduce import whole_pixels
from sightline.imaging.source import ImageSource
from sightline.matching import matches as codes
from sightline.matching.on_geometry import FoundWindows, PairOnGeometry, lattice_points, within
from sightline.matching.select import select_points
from sightline.matching.whitening import Whitening, gradient_filter, pair_whitening
from sightline.photogrammetry.sightings import Tracks

Array = NDArray[np.float64]

#: Pixels of the coarsest scale that a search may span to each side: few enough for one clear peak.
_COARSE_SEARCH = 6
#: Pixels that it spans at most, where the frame is too small to be reduced further.
_LONGEST_SEARCH = 16
#: px; search at each finer scale: what the scale before, half as sharp, and relief between points leave.
_FINE_SEARCH = 3
#: Fewest windows along a side of the coarsest scale.
_COARSE_WINDOWS = 3
#: Share of the windows tried that must agree with those around them, or the search is widened by the next of
#: these factors of the pointing error.
_AGREEMENT, _WIDENINGS = 0.6, (1.0, 8.0, 64.0)
#: Fewest windows that two frames must share.
_LEAST_WINDOWS = 6
#: px; tiles that filters are estimated from.
_TILE = (32, 32)
#: Cells along each side of a frame that share the points evenly.
_CELLS = 8
#: Places per side of a frame that show what two frames share.
_PROBES = 5


@dataclass(frozen=True)
class TrackPlan:
    """How points are sought.

    Attributes
    ----------
    points : int
        Per hub, at most.
    window : int
        px, side of a window.
    height_range : float
        m; the ground lies within this of the surface.
    pointing_error : float
        rad; planned attitudes of frames are wrong by about this; searches are widened where more.
    view_angle : float
        rad; largest angle between the lines of sight under which a window is sought again.
    hubs : tuple of int or None
        Frames whose windows are sought in the others; None: as few as see all.
    min_score : float
        Lowest normalised correlation of a match.
    floor_px : float
        px per coordinate, added to every sigma in quadrature: what the lens and the ground do that the noise
        of images does not show.
    least_share : float
        Share of a frame that another must see for its windows to be sought there. 0.2: windows of less common
        ground lie at the rims, where views and lenses differ most.
    """

    points: int = 300
    window: int = 21
    height_range: float = 1000.0
    pointing_error: float = 5e-4
    view_angle: float = np.radians(65.0)
    hubs: tuple[int, ...] | None = None
    min_score: float = 0.3
    floor_px: float = 0.0
    least_share: float = 0.2

    def __post_init__(self) -> None:
        """Check."""
        if self.points < 1 or self.window < 9:
            raise InputError(
                f"points must be 1 or more and windows 9 px or more, got {self.points} and {self.window} px"
            )
        for name in ("height_range", "pointing_error", "view_angle", "floor_px"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(f"`{name}` must be 0 or more, got {getattr(self, name)}")
        if not 0.0 < self.least_share <= 1.0:
            raise InputError(f"`least_share` must lie above 0, at most at 1, got {self.least_share}")


def match_frames(
    sources: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    plan: TrackPlan | None = None,
    step: Step = no_step,
) -> Tracks:
    """Points of a block of frames in every frame that sees them.

    Parameters
    ----------
    sources : sequence of ImageSource
        One per frame; unusable pixels by their mask.
    cameras : sequence of FrameCamera
        With the planned poses, as many.
    surface : Surface
        The ground, roughly: a plane, an ellipsoid, a DEM.
    plan : TrackPlan, optional
    step : callable
        Called with the number of frames whose windows were sought in the others, and of all such frames.

    Returns
    -------
    Tracks
        `image` counts the frames; points that were found in no second frame are left out.

    Raises
    ------
    EstimationError
        If no point is found in two frames.
    """
    plan = plan or TrackPlan()
    if len(sources) != len(cameras):
        raise InputError(f"as many images as cameras are needed, got {len(sources)} and {len(cameras)}")
    for number, (source, camera) in enumerate(zip(sources, cameras, strict=True)):
        if tuple(source.shape) != tuple(camera.shape):
            raise InputError(f"image {number} has {source.shape} pixels, its camera {camera.shape}")
    partners = shared_views(cameras, surface, plan.view_angle, plan.least_share)
    hubs = choose_hubs(partners) if plan.hubs is None else plan.hubs
    found = [
        track
        for hub in stepped(list(hubs), step)
        for track in [_match_hub(sources, cameras, surface, hub, np.flatnonzero(partners[hub]), plan)]
        if track is not None
    ]
    if not found:
        raise EstimationError(
            f"no point was found in two of {len(sources)} frames; check the poses, the surface and the order "
            "of the images, or raise height_range and pointing_error"
        )
    first = np.cumsum([0] + [int(track.point.max()) + 1 for track in found])
    return Tracks(
        np.concatenate([track.image for track in found]),
        np.concatenate([track.point + start for track, start in zip(found, first, strict=False)]),
        np.concatenate([track.pixels for track in found]),
        np.concatenate([track.sigma_px for track in found]),
    )


def shared_views(
    cameras: Sequence[FrameCamera], surface: Surface, view_angle: float, least_share: float = 0.2
) -> NDArray[np.float64]:
    """How well each frame can serve as hub for each other.

    Parameters
    ----------
    cameras : sequence of FrameCamera
        M frames.
    surface : Surface
    view_angle : float
        rad; largest angle between lines of sight.
    least_share : float
        Of frame i that frame j must see.

    Returns
    -------
    (M, M)
        Share of frame i that frame j sees, times the cosine of the angle between their views; 0 where it is
        too little, or i = j.
    """
    m = len(cameras)
    out = np.zeros((m, m))
    for i, camera in enumerate(cameras):
        probes = lattice_points(camera.shape, _PROBES)
        ground = camera.locate(probes, surface)
        there = np.isfinite(ground).all(axis=1)
        if not there.any():
            continue
        sight = _sight(camera, ground)
        for j, other in enumerate(cameras):
            if j == i:
                continue
            pixels = other.project(ground)
            inside = within(pixels, other.shape)
            if inside.mean() < least_share:
                continue
            cosine = float(np.einsum("ni,ni->n", sight, _sight(other, ground))[inside].mean())
            if cosine >= np.cos(view_angle):
                out[i, j] = inside.mean() * cosine
    return out


def _sight(camera: FrameCamera, ground: Array) -> Array:
    """Unit vectors (N, 3) from a camera to points."""
    sight = ground - camera.rays(np.zeros((1, 2))).origins
    return np.asarray(sight / np.linalg.norm(sight, axis=1, keepdims=True))


def choose_hubs(shared: Array) -> tuple[int, ...]:
    """As few frames as see all that any frame shares with another.

    Parameters
    ----------
    shared : (M, M)
        What `shared_views` gives.

    Notes
    -----
    Each is the one that sees most of those not yet seen; among equals the one that sees them best.
    """
    left = (shared > 0.0).any(axis=0)
    hubs: list[int] = []
    while left.any():
        seen = (shared > 0.0) & left
        gain = seen.sum(axis=1) + (seen.any(axis=1) & left)
        best = int(np.lexsort(((shared * left).sum(axis=1), gain))[-1])
        hubs.append(best)
        left &= ~seen[best]
        left[best] = False
    return tuple(sorted(hubs))


def _match_hub(
    sources: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    hub: int,
    partners: NDArray[np.intp],
    plan: TrackPlan,
) -> Tracks | None:
    """The points of one hub; None if no other frame shows any."""
    size = (plan.window, plan.window)
    points = select_points(sources[hub], window=size, count=plan.points, cells=(_CELLS, _CELLS))
    found: dict[int, FoundWindows] = {}
    for partner in partners:
        geometry = partial(predict_match, cameras[hub], cameras[partner], surface)
        focal = max(cameras[frame].detector.focal_length_px for frame in (hub, partner))
        pair = PairOnGeometry(sources[hub], sources[partner], geometry)
        one = _match_pair(pair, points, plan, 2.0 * plan.pointing_error * focal)
        if one is not None:
            found[int(partner)] = one
    if not found:
        return None
    own, shared = (np.stack(parts) for parts in zip(*(f.variances() for f in found.values()), strict=True))
    kept = np.stack([one.matches.kept for one in found.values()])
    seen = np.flatnonzero(kept.any(axis=0))
    hub_variance = np.nanmedian(np.where(kept, shared, np.nan)[:, seen], axis=0)
    name = np.cumsum(kept.any(axis=0)) - 1
    which, rows = np.nonzero(kept)
    places = [one.matches.b[one.matches.kept] for one in found.values()]
    return Tracks(
        np.concatenate([np.full(len(seen), hub), np.array(list(found))[which]]),
        name[np.concatenate([seen, rows])],
        np.concatenate([points[seen], *places]),
        np.sqrt(np.concatenate([hub_variance, own[kept]]) + plan.floor_px**2),
    )


def _match_pair(
    pair: PairOnGeometry, points: Array, plan: TrackPlan, pointing_px: float
) -> FoundWindows | None:
    """Points of the hub in one partner, from coarse to fine; None if they share too little.

    Where most windows do not agree, the search is widened: poses may be worse than planned. In the end the
    partner is laid on the hub as well as can be, and filters are learnt.
    """
    for widening in _WIDENINGS:
        learnt, agreement = _coarse_to_fine(pair, points, plan, widening * pointing_px)
        if agreement >= _AGREEMENT:
            break
    if learnt is None:
        return None
    laid = learnt.laid()
    whitening = pair_whitening(pair.hub, laid, points, tile=_TILE, reach=(1, 1)) or gradient_filter()
    found = _found(learnt, laid, points, (0, 0), plan, whitening)
    return found if found.matches.kept.sum() >= _LEAST_WINDOWS else None


def _coarse_to_fine(
    pair: PairOnGeometry, points: Array, plan: TrackPlan, pointing_px: float
) -> tuple[PairOnGeometry | None, float]:
    """The pair with its map learnt (None: too few windows found), and the share of windows that agree."""
    reach = (
        np.nanmax(pair.reach(lattice_points(pair.hub.shape, 3), plan.height_range), axis=0, initial=0.0)
        + pointing_px
    )
    scale = _coarsest(reach, pair.hub.shape, plan.window)
    lines, columns = np.minimum(np.ceil(reach / scale), _LONGEST_SEARCH).astype(int) + 1
    search, size = (int(lines), int(columns)), (plan.window, plan.window)
    agreement = 1.0
    while True:
        coarse = pair.reduced(scale)
        look = points
        if scale > 1:
            look = select_points(coarse.hub, window=size, step=(plan.window // 2, plan.window // 2))
        found = _found(coarse, coarse.laid(), look, search, plan, gradient_filter()).matches
        kept = found.kept
        if kept.sum() < _LEAST_WINDOWS:
            return None, 0.0
        pair = pair.after(whole_pixels(look[kept], scale), whole_pixels(found.b[kept], scale))
        tried = kept.sum() + np.isin(found.status, (codes.NO_CONVERGENCE, codes.LOW_SCORE)).sum()
        assert pair.learnt is not None
        agreement = min(agreement, float((pair.learnt.weights > 0.0).sum() / tried))
        if scale == 1:
            return pair, agreement
        scale //= 2
        search = (_FINE_SEARCH, _FINE_SEARCH)


def _found(
    pair: PairOnGeometry,
    laid: ImageSource,
    points: Array,
    search: tuple[int, int],
    plan: TrackPlan,
    whitening: Whitening,
) -> FoundWindows:
    """Points (N, 2) of the hub found in a partner that is laid on it."""
    return pair.found(
        points, window=(plan.window, plan.window), search_px=search, whitening=whitening, laid=laid,
        min_score=plan.min_score,
    )  # fmt: skip


def _coarsest(reach: Array, shape: tuple[int, int], window: int) -> int:
    """The reduction (a power of two) at which the search is short, while enough windows fit."""
    scale = 1
    while reach.max() / scale > _COARSE_SEARCH and min(shape) // (2 * scale) >= _COARSE_WINDOWS * window:
        scale *= 2
    return scale
