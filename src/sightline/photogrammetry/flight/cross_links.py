"""Points that stretches of a flight have in common: flight lines beside each other, crossing, or flown again.

Frames of one stretch look alike; frames of two look alike where they overlap and the filter shows the ground
in like wavelengths. Poses must be known to some pixels.

Not here: points within a stretch (``matching/follow.py``); blocks of few frames from all
sides (``photogrammetry/match_frames.py``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera
from sightline.geometry.checks import Array, read_only
from sightline.geometry.conjugate import predict_match
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.imaging.reduce import pattern_means, whole_pixels
from sightline.imaging.source import ImageSource
from sightline.matching.on_geometry import PairOnGeometry, lattice_points, within
from sightline.matching.select import select_points
from sightline.matching.whitening import gradient_filter
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Images, Tracks, joined

#: nm; wavelengths that far apart are not compared.
_ALIKE_NM = 90.0
#: Places along each side of a frame that show what two frames share; and the least share of them.
_PROBES, _LEAST_SHARE = 17, 0.03
#: Share of a frame's lines that it moves from one frame that is compared to the next.
_SPACING = 0.12
#: Windows of a pair: at most, at least; cells along a side that share them; share that must go together.
_POINTS, _LEAST_WINDOWS, _CELLS, _AGREEMENT = 60, 5, 6, 0.6
#: px; longest search, and how far windows may lie from each other, relief apart.
_LONGEST_SEARCH, _DISAGREE = 30, 2.0
#: Lowest correlation; px: what other wavelengths and another view move a window by.
_MIN_SCORE, _FLOOR = 0.55, 0.05


@dataclass(frozen=True)
class CrossPlan:
    """How stretches are compared.

    Attributes
    ----------
    height_range : float
        m; the ground lies within this of the surface.
    pointing_error : float
        rad; poses are wrong by about this.
    partners : int
        Frames of each other stretch that a frame is compared with, at most.
    window : int
        Pixels of what is compared.
    reduction : int
        Pixels are averaged in squares of this side first: the period of a mosaic filter, whose pattern would
        look like itself wherever the ground is.
    """

    height_range: float
    pointing_error: float
    partners: int = 2
    window: int = 21
    reduction: int = 1


def cross_pairs(
    images: Images,
    detector: AreaDetector,
    mount: Rotation,
    surface: Surface,
    group: NDArray[np.intp],
    partners: int = 2,
) -> list[tuple[int, int, NDArray[np.bool_]]]:
    """Pairs of frames of different stretches that see the same ground in like wavelengths.

    Parameters
    ----------
    images : Images
    detector, mount
        Of all frames.
    surface : Surface
    group : (M,) int
        Stretch of each frame; -1 leaves it out.
    partners : int
        Of each frame in each other stretch, at most.

    Returns
    -------
    list of (frame, partner, lines)
        `lines` (bool): those of the frame that the partner sees in like wavelengths.
    """
    lines = detector.shape[0]
    probes = lattice_points(detector.shape, _PROBES)
    cameras = frame_cameras(images, [detector], [mount])
    nm = _line_nm(detector)
    chosen = _spaced(images, detector, mount, surface, group)
    ground = {k: cameras[k].locate(probes, surface) for k in chosen}
    centre = {k: np.nanmean(g, axis=0) for k, g in ground.items()}
    # a frame that looks beside the surface shares nothing that is known
    chosen = [k for k in chosen if np.isfinite(centre[k]).all()]
    tree = cKDTree(np.array([centre[k] for k in chosen]).reshape(-1, 3))
    out = []
    for i in chosen:
        best: dict[int, list[tuple[float, int, NDArray[np.bool_]]]] = {}
        extent = np.nanmax(np.linalg.norm(ground[i] - centre[i], axis=1))
        for j in (chosen[row] for row in sorted(tree.query_ball_point(centre[i], 2.0 * extent))):
            if group[j] <= group[i]:
                continue
            found = _alike(cameras[j], probes, ground[i], nm, lines)
            if found is not None:
                best.setdefault(int(group[j]), []).append((found[0], j, found[1]))
        for candidates in best.values():
            candidates.sort(key=lambda c: -c[0])
            out += [(i, j, rows) for _, j, rows in candidates[:partners]]
    return out


def _line_nm(detector: AreaDetector) -> Array:
    """Wavelength (lines,) nm; 0 where all lines see alike."""
    if detector.wavelength_nm is None:
        return np.zeros(detector.shape[0])
    return np.asarray(detector.wavelength_nm, dtype=np.float64)


def _spaced(
    images: Images, detector: AreaDetector, mount: Rotation, surface: Surface, group: NDArray[np.intp]
) -> list[int]:
    """Frames of each stretch some way apart."""
    middle = 0.5 * (np.array([detector.shape]) - 1.0)
    ends = np.concatenate([middle, [[0.0, middle[0, 1]]]])
    rays = mount.apply(detector.directions(ends))
    out: list[int] = []
    last: Array | None = None
    for k in np.flatnonzero(group >= 0):
        seen = surface.intersect(
            read_only(np.repeat(images.position[k : k + 1], 2, axis=0)),
            read_only(images.world_from_body[int(k)].apply(rays)),
        )
        far = last is None or group[k] != group[out[-1]]
        if last is not None and not far:
            far = bool(np.linalg.norm(seen[0] - last) > _SPACING * 2.0 * np.linalg.norm(seen[0] - seen[1]))
        if far:
            out.append(int(k))
            last = seen[0]
    return out


def _alike(
    camera: FrameCamera, probes: Array, ground: Array, nm: Array, lines: int
) -> tuple[float, NDArray[np.bool_]] | None:
    """Share of a frame that another sees in like wavelengths, and its lines there; None if too little."""
    seen = camera.project(ground)
    inside = within(seen, camera.shape)
    if not inside.any():
        return None
    places = np.arange(lines)
    other = np.interp(np.where(inside, np.nan_to_num(seen[:, 0]), 0.0), places, nm)
    near = inside & (np.abs(np.interp(probes[:, 0], places, nm) - other) < _ALIKE_NM)
    if near.mean() < _LEAST_SHARE:
        return None
    half = 0.5 * (lines - 1.0) / (_PROBES - 1)
    low, high = probes[near, 0].min() - half, probes[near, 0].max() + half
    return float(near.mean()), np.asarray((places >= low) & (places <= high))


def link_stretches(
    sources: Sequence[ImageSource],
    images: Images,
    detector: AreaDetector,
    mount: Rotation,
    surface: Surface,
    group: NDArray[np.intp],
    plan: CrossPlan,
    progress: Callable[[int, int], None] | None = None,
) -> Tracks | None:
    """Points that frames of different stretches have in common; None if there are none.

    Parameters
    ----------
    sources : sequence of ImageSource
        M frames.
    images : Images
        Their poses, to some pixels.
    detector, mount
        Of all frames.
    surface : Surface
    group : (M,) int
        Stretch of each; -1 leaves it out.
    plan : CrossPlan
    progress : callable, optional
        Called with the number of pairs compared and of all.

    Notes
    -----
    Where most pairs of two stretches are not found alike within what is known of the poses, these pairs are
    searched once more as far as is ever searched: tables may have constant errors that nothing states, and
    turn lines that are flown to and fro apart.
    """
    found: list[Tracks] = []
    names = 0
    farther = replace(
        plan, pointing_error=_LONGEST_SEARCH * plan.reduction / (2.0 * detector.focal_length_px)
    )
    to_do = cross_pairs(images, detector, mount, surface, group, plan.partners)
    done, total = 0, len(to_do)
    for each in (plan, farther):
        untied = []
        for i, j, lines in to_do:
            if progress is not None:
                progress(done, total)
            done += 1
            cameras = frame_cameras(images[np.array([i, j])], [detector], [mount])
            two = _match_pair((sources[i], sources[j]), cameras, surface, lines, each)
            if two is None:
                untied.append((i, j, lines))
                continue
            image = np.array([i, j])[two.image]
            found.append(replace(two, image=image, point=names + two.point))
            names += len(two) // 2
        if plan.pointing_error >= farther.pointing_error:
            break
        to_do = _mostly(untied, to_do, group)
        total += len(to_do)
    return joined(found) if found else None


def _mostly(
    some: list[tuple[int, int, NDArray[np.bool_]]],
    of: list[tuple[int, int, NDArray[np.bool_]]],
    group: NDArray[np.intp],
) -> list[tuple[int, int, NDArray[np.bool_]]]:
    """Those pairs of frames whose stretches have more than half of theirs among them."""

    def stretches(pair: tuple[int, int, NDArray[np.bool_]]) -> tuple[int, int]:
        return int(group[pair[0]]), int(group[pair[1]])

    count, every = Counter(map(stretches, some)), Counter(map(stretches, of))
    return [pair for pair in some if 2 * count[stretches(pair)] > every[stretches(pair)]]


def _match_pair(
    sources: tuple[ImageSource, ImageSource],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    lines: NDArray[np.bool_],
    plan: CrossPlan,
) -> Tracks | None:
    """Points of a pair of frames, which are images 0 and 1; None if too few agree."""
    k, size = plan.reduction, (plan.window, plan.window)
    images = (pattern_means(sources[0], k), pattern_means(sources[1], k)) if k > 1 else sources
    whole = PairOnGeometry(*sources, partial(predict_match, cameras[0], cameras[1], surface))
    pair = PairOnGeometry(*images, whole.reduced(k).geometry)

    def alike(points: Array) -> NDArray[np.bool_]:
        """Which windows of the hub the partner sees in like wavelengths."""
        return lines[np.rint(whole_pixels(points, k)[:, 0]).astype(np.intp)] & pair.inside(points)

    step = 2 * plan.window // 3
    points = select_points(
        pair.hub, window=size, step=(step, step), count=_POINTS, cells=(_CELLS, _CELLS), allowed=alike
    )
    if len(points) < _LEAST_WINDOWS:
        return None
    high = pair.reach(points, plan.height_range)
    seen = np.isfinite(high).all(axis=1)
    if seen.sum() < _LEAST_WINDOWS:
        return None  # ground as high or low as it may be here lies out of the partner's sight
    points, high = points[seen], high[seen]
    loose = 2.0 * plan.pointing_error * cameras[1].detector.focal_length_px / k
    reach = np.minimum(np.ceil(high.max(axis=0) + loose) + 1, _LONGEST_SEARCH).astype(int)
    found = pair.found(
        points, window=size, search_px=(int(reach[0]), int(reach[1])), whitening=gradient_filter(),
        min_score=_MIN_SCORE,
    )  # fmt: skip
    matches = found.matches
    if matches.kept.sum() < _LEAST_WINDOWS:
        return None
    # windows that lie on a spurious peak lie anywhere; true ones go together but for the relief
    moved = matches.b - pair.where(points)
    spread = np.median(high, axis=0) + _DISAGREE
    near = matches.kept & (np.abs(moved - np.median(moved[matches.kept], axis=0)) < spread).all(axis=1)
    if near.sum() < max(_LEAST_WINDOWS, _AGREEMENT * matches.kept.sum()):
        return None
    own, shared = (k * np.sqrt(part[near] + _FLOOR**2) for part in found.variances())
    return Tracks(
        np.repeat([0, 1], near.sum()),
        np.tile(np.arange(near.sum()), 2),
        whole_pixels(np.concatenate([points[near], matches.b[near]]), k),
        np.concatenate([shared, own]),
    )
