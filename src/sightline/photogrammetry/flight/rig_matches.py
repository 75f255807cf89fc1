"""Points of a flight found in the other cameras of its rig.

Windows that were followed in the first camera are looked for in the images of the others, of the same capture
and of those after it: each is compared with its hub, so that every sighting errs by its own image alone. How
each camera is turned is found first, from a few captures, by cameras whose bands look alike.

Not here: following (``matching/follow.py``), the adjustment (``rig_poses.py``).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.checks import Array
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource, in_memory
from sightline.matching.follow import Followed
from sightline.matching.on_geometry import PairOnGeometry, within
from sightline.matching.select import grid_points
from sightline.matching.whitening import Whitening, gradient_filter, pair_whitening
from sightline.photogrammetry.flight.rig import RigCamera, RigOffsets, rig_images
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.match_frames import TrackPlan, match_frames
from sightline.photogrammetry.sightings import Images, Tracks, joined

#: Captures that tell how a camera is turned; windows in each.
_TRIED, _COARSE_POINTS = 4, 200
#: Pairs of one camera that must agree with one turn of it, and the share of those found; px within which.
_LEAST, _AGREEMENT, _AGREE_PX = 12, 0.5, 2.0
#: Captures from that of its hub on in which a window is sought; windows that are worth the look.
_SPAN, _LEAST_WINDOWS = 3, 10
#: px: window, search beyond what is predicted, tiles that filters are estimated from.
_WINDOW, _SEARCH, _TILE = 21, 3, (32, 32)
#: px; search where the first camera has no image, whose pose lies between its neighbours' then.
_LOST_SEARCH = 16
#: Lowest correlation.
_MIN_SCORE = 0.3
#: px; what lenses, other wavelengths and another view move a window by.
_FLOOR_PX = 0.03

Report = Callable[[int, int], None]


@dataclass(frozen=True)
class Reach:
    """How far ground and cameras may be from where they are thought.

    Attributes
    ----------
    height_range : float
        m; the ground lies within this of the surface.
    """

    height_range: float


def rig_cameras(
    images: Images, cameras: Sequence[RigCamera], offsets: RigOffsets, capture: int
) -> list[FrameCamera]:
    """The cameras of one capture."""
    row = images[np.array([capture])]
    own = rig_images(row, offsets.orientation, offsets.position)
    detectors = [offsets.detector(c, camera.detector) for c, camera in enumerate(cameras)]
    own = replace(own, shot=np.zeros(len(cameras), dtype=np.intp))
    return list(frame_cameras(own, detectors, [camera.mount for camera in cameras]))


def begin_offsets(
    images: Images,
    cameras: Sequence[RigCamera],
    offsets: RigOffsets,
    surface: Surface,
    reach: Reach,
    report: Report | None = None,
) -> tuple[RigOffsets, dict[str, str]]:
    """How each camera is turned, to a pixel; and why that could not be found, by name.

    Parameters
    ----------
    images : Images
        Poses of the captures, found.
    cameras : sequence of RigCamera
    offsets : RigOffsets
        As they are given.
    surface : Surface
    reach : Reach
    report : callable, optional
        Called with the number of cameras done and of all.
    """
    placed = [0]
    failed: dict[str, str] = {}
    order = sorted(range(1, len(cameras)), key=lambda c: _unlike(cameras[0], cameras[c]))
    waiting, tried = list(order), 0
    while waiting and tried < len(waiting):
        c = waiting.pop(0)
        said = ""
        for partner in sorted(placed, key=lambda p: _unlike(cameras[p], cameras[c])):
            turn, words = _turn_of(images, cameras, offsets, partner, c, surface, reach)
            if turn is not None:
                orientation = Rotation.concatenate([
                    turn if k == c else offsets.orientation[k] for k in range(len(cameras))
                ])  # fmt: skip
                offsets = replace(offsets, orientation=orientation)
                placed.append(c)
                failed.pop(cameras[c].name, None)
                tried = -1
                break
            said = words
        else:
            failed[cameras[c].name] = said
            waiting.append(c)
        tried += 1
        if report is not None:
            report(len(placed), len(cameras))
    return offsets, failed


def _unlike(one: RigCamera, other: RigCamera) -> float:
    """nm between two bands; 0 where one sees all light."""
    apart = abs(one.wavelength_nm - other.wavelength_nm)
    return apart if np.isfinite(apart) else 0.0


def _turn_of(
    images: Images,
    cameras: Sequence[RigCamera],
    offsets: RigOffsets,
    partner: int,
    camera: int,
    surface: Surface,
    reach: Reach,
) -> tuple[Rotation | None, str]:
    """Orientation of a camera from windows that it shares with one that is placed; or what was found."""
    both = np.flatnonzero(cameras[partner].usable & cameras[camera].usable)
    if not len(both):
        return None, f"no capture has a usable image of it and of {cameras[partner].name}"
    some = both[np.unique(np.linspace(0, len(both) - 1, _TRIED).round().astype(int))]
    here, there, weight = [], [], []
    plan = TrackPlan(
        points=_COARSE_POINTS, window=_WINDOW, height_range=reach.height_range,
        pointing_error=max(cameras[camera].orientation_sigma, 1e-3), hubs=(0,), min_score=_MIN_SCORE,
        least_share=0.1,
    )  # fmt: skip
    for k in some:
        pair = [rig_cameras(images, cameras, offsets, int(k))[c] for c in (partner, camera)]
        try:
            found = match_frames(
                [in_memory(cameras[c].sources[k]) for c in (partner, camera)], pair, surface, plan
            )
        except EstimationError:
            continue
        hub, other = found.image == 0, found.image == 1
        _, of_hub, of_other = np.intersect1d(found.point[hub], found.point[other], return_indices=True)
        ground = pair[0].locate(found.pixels[hub][of_hub], surface)
        predicted = pair[1].project(ground)
        mount, detector = cameras[camera].mount, pair[1].detector
        here.append(mount.apply(detector.directions(predicted)))
        there.append(mount.apply(detector.directions(found.pixels[other][of_other])))
        weight.append(np.full(len(predicted), detector.focal_length_px))
    if not here:
        return None, f"no window of {cameras[partner].name} was found in it"
    seen, looked = np.concatenate(here), np.concatenate(there)
    good = np.isfinite(seen).all(axis=1) & np.isfinite(looked).all(axis=1)
    seen, looked, focal = seen[good], looked[good], np.concatenate(weight)[good]
    turn, inside = _common_turn(seen, looked, focal)
    words = (
        f"{int(inside.sum())} of {len(inside)} windows of {cameras[partner].name} that were found in it go "
        f"together to {_AGREE_PX:g} px; {_LEAST} and {100 * _AGREEMENT:.0f} % of them are needed"
    )
    if inside.sum() < _LEAST or inside.mean() < _AGREEMENT:
        return None, words
    return offsets.orientation[camera] * turn, words


def _common_turn(predicted: Array, found: Array, focal: Array) -> tuple[Rotation, NDArray[np.bool_]]:
    """The turn that brings rays found (N, 3) to those predicted, and which of them it serves."""
    inside = np.ones(len(found), dtype=bool)
    turn = Rotation.identity()
    limit = np.inf
    for _ in range(8):
        if inside.sum() < 3:
            break
        turn = Rotation.align_vectors(predicted[inside], found[inside])[0]
        miss = np.linalg.norm(turn.apply(found) - predicted, axis=1) * focal
        limit = max(min(limit / 2.0, 3.0 * float(np.median(miss))), _AGREE_PX)
        inside = miss < limit
    return turn, inside


def find_in_rig(
    followed: Followed,
    images: Images,
    points: Array,
    cameras: Sequence[RigCamera],
    offsets: RigOffsets,
    surface: Surface,
    report: Report | None = None,
) -> Tracks | None:
    """Followed windows in the other cameras; None if none is found.

    Parameters
    ----------
    followed : Followed
        Of the first camera.
    images : Images
        Poses of the captures, found.
    points : (n, 3)
        m, of the points found.
    cameras, offsets
        With turns to a pixel.
    surface : Surface
    report : callable, optional
        Called with the number of captures done and of all.

    Returns
    -------
    Tracks
        `image` is camera M + capture.
    """
    count = len(images)
    first = np.unique(followed.point, return_index=True)[1]
    hub_of = np.full(int(followed.point.max()) + 1, -1)
    hub_of[followed.point[first]] = followed.image[first]
    found: list[Tracks] = []
    images_of = _Held(cameras)
    filters = {c: _filters(images, cameras, offsets, surface, c) for c in range(1, len(cameras))}
    for hub in range(count):
        own = first[hub_of[followed.point[first]] == hub]
        if report is not None:
            report(hub, count)
        known = np.isfinite(points[followed.point[own]]).all(axis=1)
        own = own[known]
        if len(own) < _LEAST_WINDOWS or not cameras[0].usable[hub]:
            continue
        hub_camera = rig_cameras(images, cameras, offsets, hub)[0]
        for k in range(hub, min(hub + _SPAN, count)):
            rows, search = own[np.isin(followed.point[own], _seen_about(followed, cameras[0], k))], _SEARCH
            if not cameras[0].usable[k]:
                search = _LOST_SEARCH
            if len(rows) < _LEAST_WINDOWS:
                break
            at = rig_cameras(images, cameras, offsets, k)
            for c in range(1, len(cameras)):
                if not cameras[c].usable[k]:
                    continue
                names = followed.point[rows]
                geometry = partial(predict_match, hub_camera, at[c], surface)
                track = _found(
                    PairOnGeometry(images_of(0, hub), images_of(c, k), geometry), followed.pixels[rows],
                    at[c].project(points[names]), names, c * count + k, search, filters[c],
                )  # fmt: skip
                if track is not None:
                    found.append(track)
    return joined(found) if found else None


class _Held:
    """Images of a rig, those of some captures held in memory: each is matched with several hubs."""

    def __init__(self, cameras: Sequence[RigCamera]) -> None:
        self._cameras, self._held = cameras, OrderedDict[tuple[int, int], ImageSource]()

    def __call__(self, camera: int, capture: int) -> ImageSource:
        """The image of a camera in a capture."""
        key = camera, capture
        if key not in self._held:
            self._held[key] = in_memory(self._cameras[camera].sources[capture])
            while len(self._held) > (_SPAN + 1) * len(self._cameras):
                self._held.popitem(last=False)
        return self._held[key]


def _filters(
    images: Images, cameras: Sequence[RigCamera], offsets: RigOffsets, surface: Surface, camera: int
) -> Whitening:
    """Filters of the first camera and another, from a capture of both in the middle of the flight.

    One for all: of the few windows of one capture they would be noisy, and what is noise in them moves all
    windows alike.
    """
    both = np.flatnonzero(cameras[0].usable & cameras[camera].usable)
    if not len(both):
        return gradient_filter()
    capture = int(both[len(both) // 2])
    at = rig_cameras(images, cameras, offsets, capture)
    hub, other = (in_memory(cameras[c].sources[capture]) for c in (0, camera))
    pair = PairOnGeometry(hub, other, partial(predict_match, at[0], at[camera], surface))
    places = grid_points(hub.shape, window=_TILE)
    learnt = pair_whitening(hub, pair.laid(), places, tile=_TILE, reach=(_SEARCH, _SEARCH))
    return learnt or gradient_filter()


def _seen_about(followed: Followed, first: RigCamera, capture: int) -> NDArray[np.intp]:
    """Points that the first camera shows in a capture; where its image is lost, in those beside it."""
    if first.usable[capture]:
        return followed.point[followed.image == capture]
    return followed.point[np.abs(followed.image - capture) == 1]


def _found(
    pair: PairOnGeometry,
    places: Array,
    predicted: Array,
    names: NDArray[np.intp],
    image: int,
    search: int,
    whitening: Whitening,
) -> Tracks | None:
    """Windows about `places` of a hub in one other image, sought where their points are predicted.

    The image is laid on the hub: an affine for each window would not do. A camera that is turned against the
    hub about an axis in its image plane bends the map within a window, by the same in all windows, and that
    looks like an offset.
    """
    seen = within(predicted, pair.partner.shape, 0.5 * _WINDOW)
    if seen.sum() < _LEAST_WINDOWS:
        return None
    found = pair.found(
        places[seen], at=predicted[seen], window=(_WINDOW, _WINDOW), search_px=(search, search),
        whitening=whitening, laid=pair.laid(), min_score=_MIN_SCORE,
    )  # fmt: skip
    kept = found.matches.kept
    if not kept.any():
        return None
    own, _ = found.variances()
    sigma = np.sqrt(own[kept] + _FLOOR_PX**2)
    return Tracks(np.full(len(sigma), image), names[seen][kept], found.matches.b[kept], sigma)


__all__ = ["Reach", "begin_offsets", "find_in_rig", "rig_cameras"]
