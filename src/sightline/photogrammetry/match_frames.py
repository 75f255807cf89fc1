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

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.imaging.reduce import ReducedImage, reduced_pixels, whole_pixels
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.imaging.warp import WarpedImage, lattice_map
from sightline.matching import matches as codes
from sightline.matching.displacement import DisplacementField
from sightline.matching.match_images import match_images
from sightline.matching.matches import Matches
from sightline.matching.select import grid_points, spread_subset, texture_strength
from sightline.matching.whitening import Whitening, estimate_whitening, gradient_filter
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
#: Columns between places where the map between two frames is handed to the resampler.
_SPACING = 4
#: Share of the windows tried that must agree with those around them, or the search is widened by the next of
#: these factors of the pointing error.
_AGREEMENT, _WIDENINGS = 0.6, (1.0, 8.0, 64.0)
#: Fewest windows that two frames must share.
_LEAST_WINDOWS = 6
#: px; tiles that filters are estimated from.
_TILE = (32, 32)
#: Cycles per pixel; frequencies that filters let pass.
_HIGHEST = 0.45
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
        axes = [np.linspace(0.0, size - 1.0, _PROBES) for size in camera.shape]
        probes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        ground = camera.locate(probes, surface)
        there = np.isfinite(ground).all(axis=1)
        if not there.any():
            continue
        sight = _sight(camera, ground)
        for j, other in enumerate(cameras):
            if j == i:
                continue
            pixels = other.project(ground)
            with np.errstate(invalid="ignore"):
                inside = ((pixels >= 0.0) & (pixels <= np.array(other.shape) - 1.0)).all(axis=1)
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


@dataclass(frozen=True, eq=False)
class _Found:
    """Where one frame shows the points of a hub: rows, pixels and the two shares of the error (px^2)."""

    image: int
    rows: NDArray[np.intp]
    pixels: Array
    own: Array
    hub: Array


def _match_hub(
    sources: Sequence[ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    hub: int,
    partners: NDArray[np.intp],
    plan: TrackPlan,
) -> Tracks | None:
    """The points of one hub; None if no other frame shows any."""
    points = _points(sources[hub], plan)
    parts = []
    for partner in partners:
        pair = _Pair(sources[hub], sources[partner], cameras[hub], cameras[partner], surface)
        part = _match_pair(pair, int(partner), points, plan)
        if part is not None:
            parts.append(part)
    if not parts:
        return None
    hub_variance = np.full((len(parts), len(points)), np.nan)
    for k, part in enumerate(parts):
        hub_variance[k, part.rows] = part.hub
    found = np.flatnonzero(np.isfinite(hub_variance).any(axis=0))
    own = np.nanmedian(hub_variance[:, found], axis=0)
    name = np.full(len(points), -1, dtype=np.intp)
    name[found] = np.arange(len(found))
    return Tracks(
        np.concatenate([np.full(len(found), hub), *(np.full(len(p.rows), p.image) for p in parts)]),
        np.concatenate([name[found], *(name[p.rows] for p in parts)]),
        np.concatenate([points[found], *(p.pixels for p in parts)]),
        np.sqrt(np.concatenate([own, *(p.own for p in parts)]) + plan.floor_px**2),
    )


def _points(source: ImageSource, plan: TrackPlan) -> Array:
    """Centres (N, 2) of windows side by side that can be located in two directions, well spread."""
    window = (plan.window, plan.window)
    points = grid_points(source.shape, window=window)
    strength = texture_strength(source, points, window)
    strength[~(strength > 0.0)] = np.nan
    return points[spread_subset(points, strength, plan.points, (_CELLS, _CELLS))]


@dataclass(frozen=True, eq=False)
class _Pair:
    """A hub and a partner, with the map from one to the other."""

    hub: ImageSource
    partner: ImageSource
    hub_camera: FrameCamera
    partner_camera: FrameCamera
    surface: Surface
    learnt: DisplacementField | None = None

    def map(self, pixels: Array) -> Array:
        """Where the partner shows pixels (N, 2) of the hub, as far as is known."""
        where = self.partner_camera.project(self.hub_camera.locate(pixels, self.surface))
        return where if self.learnt is None else where + self.learnt.at(pixels)

    @property
    def weights(self) -> Array:
        """(N,) 0 to 1; of the displacements learnt, 0 where one does not go with those around it."""
        return np.ones(0) if self.learnt is None else self.learnt.weights

    def jacobian(self, pixels: Array) -> Array:
        """Change (N, 2, 2) of the map with (line, column) of the hub, px/px."""
        step = np.diag([2.0, 2.0])
        return np.stack([(self.map(pixels + s) - self.map(pixels - s)) / 4.0 for s in step], axis=-1)

    def laid(self, scale: int) -> ImageSource:
        """The partner in the geometry of the hub, both reduced by `scale`."""

        def exact(pixels: Array) -> Array:
            return reduced_pixels(self.map(whole_pixels(pixels, scale)), scale)

        lines, columns = _at_scale(self.hub, scale).shape
        warped = WarpedImage(_at_scale(self.partner, scale), lattice_map(exact), (lines, columns), _SPACING)
        # windows and tiles read it again and again: one frame at a time is kept
        return ArrayImage(warped.read((0, lines), (0, columns)))

    def after(self, points: Array, where: Array) -> _Pair:
        """The same pair once `points` (N, 2) of the hub were found at pixels `where` of the partner."""
        planned = self.partner_camera.project(self.hub_camera.locate(points, self.surface))
        field = DisplacementField(points, where - planned)
        return _Pair(self.hub, self.partner, self.hub_camera, self.partner_camera, self.surface, field)


def _at_scale(source: ImageSource, scale: int) -> ImageSource:
    return source if scale == 1 else ReducedImage(source, scale)


def _match_pair(pair: _Pair, partner: int, points: Array, plan: TrackPlan) -> _Found | None:
    """Points of the hub in one partner, from coarse to fine; None if they share too little.

    Where most windows do not agree, the search is widened: poses may be worse than planned.
    """
    for widening in _WIDENINGS:
        learnt, agreement = _coarse_to_fine(pair, points, plan, widening)
        if agreement >= _AGREEMENT:
            break
    return None if learnt is None else _last_look(learnt, partner, points, plan)


def _coarse_to_fine(
    pair: _Pair, points: Array, plan: TrackPlan, widening: float
) -> tuple[_Pair | None, float]:
    """The pair with its map learnt (None: too few windows found), and the share of windows that agree."""
    reach = _search_range(pair, plan, widening)
    scale = _coarsest(reach, pair.hub.shape, plan.window)
    lines, columns = np.minimum(np.ceil(reach / scale), _LONGEST_SEARCH).astype(int) + 1
    search = (int(lines), int(columns))
    agreement = 1.0
    while True:
        hub = _at_scale(pair.hub, scale)
        look = points if scale == 1 else _dense_points(hub, plan.window)
        found = _matched(hub, pair.laid(scale), look, search, plan, gradient_filter())
        kept = found.kept
        if kept.sum() < _LEAST_WINDOWS:
            return None, 0.0
        pair = pair.after(whole_pixels(look[kept], scale), pair.map(whole_pixels(found.b[kept], scale)))
        tried = kept.sum() + np.isin(found.status, (codes.NO_CONVERGENCE, codes.LOW_SCORE)).sum()
        agreement = min(agreement, float((pair.weights > 0.0).sum() / tried))
        if scale == 1:
            return pair, agreement
        scale //= 2
        search = (_FINE_SEARCH, _FINE_SEARCH)


def _last_look(pair: _Pair, partner: int, points: Array, plan: TrackPlan) -> _Found | None:
    """Points of the hub in a partner that is laid on it as well as can be, with both shares of the error."""
    laid = pair.laid(1)
    whitening = _whitening(pair.hub, laid, points)
    found = _matched(pair.hub, laid, points, (0, 0), plan, whitening)
    kept = np.flatnonzero(found.kept)
    if len(kept) < _LEAST_WINDOWS:
        return None
    turn = pair.jacobian(points[kept])
    size = np.abs(np.linalg.det(turn))
    # one texture under noise of one strength: where the hub's covariance is C, the partner's own is
    # turn C turn^T / |turn|, in pixels of the hub C / |turn|
    share = hub_share(whitening) * 2.0 * size / (1.0 + size)
    seen = found.covariance_px[kept]
    turned = turn @ seen @ np.swapaxes(turn, 1, 2)
    return _Found(
        partner,
        kept,
        pair.map(found.b[kept]),
        0.5 * np.trace(turned, axis1=1, axis2=2) * (1.0 - share),
        0.5 * np.trace(seen, axis1=1, axis2=2) * share,
    )


def _whitening(hub: ImageSource, laid: ImageSource, points: Array) -> Whitening:
    """Filters for a pair laid one on the other; fixed ones where the images do not show them."""
    try:
        return estimate_whitening(hub, laid, points, points, tile=_TILE, reach=(1, 1))
    except EstimationError:
        return gradient_filter()


def hub_share(whitening: Whitening) -> float:
    """Share of a match's variance that is the hub's own noise, the same in all its matches.

    Notes
    -----
    With the signal-to-noise ratio r of each of two images alike, the score's variance is 2 / r + 1 / r^2 at
    each frequency: noise of either image times the texture, and noise times noise, which is new in every
    pair. Their coherence is c = (r / (1 + r))^2, a match weighs frequencies by f^2 c / (1 - c).
    """
    if whitening.coherence is None:
        return 0.5
    c = whitening.coherence
    ratio = np.sqrt(c) / (1.0 - np.sqrt(c))
    fy, fx = np.meshgrid(np.fft.fftfreq(len(c)), np.fft.rfftfreq(len(c)), indexing="ij")
    # frequencies beyond this are filtered out; columns but the first stand for two
    weight = (fy**2 + fx**2) * (np.maximum(np.abs(fy), fx) < _HIGHEST) * np.where(fx > 0.0, 2.0, 1.0)
    odds = c / (1.0 - c)
    return float((weight * odds**2 / ratio).sum() / (weight * odds).sum())


def _matched(
    hub: ImageSource,
    laid: ImageSource,
    points: Array,
    search: tuple[int, int],
    plan: TrackPlan,
    whitening: Whitening,
) -> Matches:
    """Points (N, 2) of the hub found in a partner that is laid on it."""
    window = (plan.window, plan.window)
    return match_images(
        hub, laid, points, points, window=window, search_px=search, whitening=whitening,
        min_score=plan.min_score,
    )  # fmt: skip


def _dense_points(reduced: ImageSource, window: int) -> Array:
    """Centres of windows of an image, half over each other, that can be located."""
    size = (window, window)
    points = grid_points(reduced.shape, window=size, step=(window // 2, window // 2))
    return points[texture_strength(reduced, points, size) > 0.0]


def _search_range(pair: _Pair, plan: TrackPlan, widening: float) -> Array:
    """How far (lines, columns; px) heights and (widened) pointing can move what the hub shows, at most."""
    shape = np.array(pair.hub.shape)
    axes = [np.linspace(0.0, size - 1.0, 3) for size in shape]
    probes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    level = pair.map(probes)
    reach = np.zeros(2)
    for height in (-plan.height_range, plan.height_range):
        moved = (
            pair.partner_camera.project(pair.hub_camera.locate(probes, pair.surface.raised(height))) - level
        )
        reach = np.fmax(reach, np.nanmax(np.abs(moved), axis=0, initial=0.0))
    focal = max(pair.hub_camera.detector.focal_length_px, pair.partner_camera.detector.focal_length_px)
    return np.asarray(reach + 2.0 * widening * plan.pointing_error * focal)


def _coarsest(reach: Array, shape: tuple[int, int], window: int) -> int:
    """The reduction (a power of two) at which the search is short, while enough windows fit."""
    scale = 1
    while reach.max() / scale > _COARSE_SEARCH and min(shape) // (2 * scale) >= _COARSE_WINDOWS * window:
        scale *= 2
    return scale
