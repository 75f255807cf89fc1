"""Control points between images and a map: a reference orthoimage found in images whose cameras are rough.

The reference is laid on each image as its camera, roughly known, sees the ground of the DEM; what is left
between the two is how far the camera is off. Where the image shows a window of the reference, the ground of
that window is known from the map.

Not here: the comparison of images (``raster_matches.py``), what control points do
(``motion/strip/fusion.py``, ``photogrammetry/block/point_priors.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from sightline.applications.raster_matches import WINDOWS, Overlay, RasterMatches, match_laid
from sightline.errors import EstimationError, GeometryError, InputError
from sightline.execution import Progress, silent
from sightline.geometry.camera import Camera, PushbroomCamera
from sightline.geometry.earth import local_axes, to_geodetic
from sightline.geometry.surface import Dem, Surface
from sightline.imaging.placed import PlacedImage
from sightline.imaging.reduce import reduced_pixels
from sightline.imaging.source import ImageSource
from sightline.matching.coarse import CHANCE, common_shift, learn_shifts
from sightline.matching.on_geometry import PairOnGeometry, lattice_points, middle_of
from sightline.matching.select import spread_subset
from sightline.motion.measure.predict import MovingCamera, turned
from sightline.motion.sensors import ControlSightings
from sightline.products.cube_grid import MapSystem
from sightline.result import Result, makes_result

__all__ = ["ReferenceTie", "tie_to_reference"]

Array = NDArray[np.float64]
Mapping = Callable[[Array], Array]

#: px; how far the cameras may be off.
SEARCH = 200.0
#: Control points of a band and of a frame, at most: more would tie single lines, of which a window only shows
#: the mean, and nothing is gained for what is slow. Frames of a flight that are tried.
BAND_POINTS, FRAME_POINTS, IMAGES = 100, 30, 40
#: The same of a strip of one band, whose control points alone tell how it moved.
ALONE_POINTS = 2000
#: px; lines and columns of windows of bands: a window shows the mean of its lines, and microvibration moves
#: them.
BAND_WINDOW = (4, 100)
#: px at the edge of the field; turns about the vertical that are tried where nothing is found without.
TURNS = tuple(sign * px for px in range(8, 57, 8) for sign in (1, -1))
#: Columns between places where the map to the reference is handed to the resampler.
_SPACING = 8
#: px beyond an image where its camera still has rays.
_AROUND = 12.0
#: px; least sigma of a control point's pixel.
_LEAST_PX = 0.005
#: m, and control points of an image: more than either makes no sense.
_LARGEST_SIGMA, _MOST_POINTS = 1e6, 1_000_000
#: Share of an image that the reference must cover for it to be tried.
_COVERED = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class ReferenceTie(Result):
    """Control points that a reference gives.

    Attributes
    ----------
    names : tuple of str
        Of all images.
    image : (N,) int
        Of each control point.
    pixels : (N, 2)
        Where the image shows it, (line, column).
    ground : (N, 3)
        m, world axes: on the DEM, where the reference has it.
    sigma : (N,)
        m, per coordinate: the reference's own and the part of the match beyond `control_sigma_px`.
    control_sigma_px : float
        px, of the pixels of all.
    match_sigma_px : (N, 2)
        px; of each match, lines and columns.
    offset_px : (N, 2)
        px; where the image shows the point, less where its camera as given would.
    matches : dict of int to RasterMatches
        Of each image that was tied.
    left_out : dict of int to str
        Why others were not.
    places : (N, 3)
        `ground` in the axes of tables.
    ground_sigma : (N,)
        m, per coordinate: the reference's own alone, which goes with `match_sigma_px` of each pixel.
    lines : (N,) or None
        Lines of a band that each pixel's place is the mean of; None of frames.
    warnings : tuple of str
    """

    names: tuple[str, ...]
    image: NDArray[np.intp]
    pixels: Array
    ground: Array
    sigma: Array
    control_sigma_px: float
    match_sigma_px: Array
    offset_px: Array
    matches: dict[int, RasterMatches]
    left_out: dict[int, str]
    places: Array
    ground_sigma: Array
    lines: Array | None = None
    warnings: tuple[str, ...] = ()

    def sightings(self) -> ControlSightings:
        """The control points as `recover_line_of_sight` and `recover_frame_attitude` take them.

        Those of bands have a sigma of each pixel coordinate: windows are narrow along the lines, wide across.
        """
        if self.lines is None:
            return ControlSightings(self.ground, self.sigma, self.image, self.pixels, self.control_sigma_px)
        return ControlSightings(
            self.ground, self.ground_sigma, self.image, self.pixels, self.control_sigma_px, self.lines,
            np.maximum(self.match_sigma_px, _LEAST_PX),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _View:
    """An image, its camera, and where each of its pixels lies on the reference."""

    image: ImageSource
    camera: Camera
    surface: Surface
    reference: PlacedImage
    system: MapSystem
    given: Camera | None = None

    def ground(self, pixels: Array) -> Array:
        """World points (N, 3) m of pixels (N, 2) by the camera as given; NaN where it sees no ground."""
        out = np.full((len(pixels), 3), np.nan)
        # cameras have poses for their own lines, and a few around
        with np.errstate(invalid="ignore"):
            inside = (pixels > -_AROUND).all(axis=1) & (
                pixels < np.array(self.image.shape) + _AROUND - 1
            ).all(axis=1)
        if inside.any():
            out[inside] = self.camera.locate(pixels[inside], self.surface)
        return out

    def seen(self, pixels: Array, _height: float = 0.0, /) -> Array:
        """Pixels (N, 2) of the reference, NaN where there is none: the `PixelMap` of the two images."""
        places = self.system.places(self.ground(pixels))
        return self.reference.pixels(places[:, :2])

    def turned(self, yaw: float) -> _View:
        """The same, its camera turned by `yaw` (rad)."""
        camera = turned(cast(MovingCamera, self.camera), np.array([0.0, 0.0, yaw]))
        return replace(self, camera=camera, given=self.camera)


@makes_result
def tie_to_reference(
    images: Sequence[ImageSource],
    cameras: Sequence[Camera],
    reference: ImageSource,
    dem: Dem,
    *,
    names: Sequence[str] | None = None,
    search_px: float = SEARCH,
    window: tuple[int, int] | None = None,
    points: int | None = None,
    reference_sigma: float = 0.0,
    dem_sigma: float = 0.0,
    to_table: Mapping | None = None,
    progress: Progress = silent,
) -> ReferenceTie:
    """Control points of images: where they show what an orthoimage shows, and where that lies.

    Parameters
    ----------
    images : sequence of ImageSource
        Bands of a strip (one is enough: the others are tied to it by their own matches), frames.
    cameras : sequence of Camera
        As they are known: off by up to `search_px`.
    reference : ImageSource
        A `PlacedImage` on a map; without a coordinate system where the world is flat.
    dem : Dem
        The ground, in the same world as the cameras.
    names : sequence of str, optional
    search_px : float
        px of the images; furthest that cameras may be off.
    window : (int, int), optional
        px of windows; (4, 100) of push-brooms, (32, 32) of frames.
    points : int, optional
        Control points of an image, at most: the best known, evenly spread. 100 of a band, 30 of a frame; a
        strip of one band is recovered from them alone, and asks for more (2000).
    reference_sigma : float
        m, per coordinate; of the reference's places, each for itself.
    dem_sigma : float
        m; of heights. It counts as far as the line of sight is tilted, and whole where a frame looks on.
    to_table : callable, optional
        World points (N, 3) in the axes in which control points are written; those of the world by default.
    progress : callable

    Returns
    -------
    ReferenceTie

    Raises
    ------
    InputError
        If the reference has no place, or not the world's axes; if numbers are out of range.
    GeometryError
        If no image sees the reference's ground.
    EstimationError
        If no image shows what the reference shows there: which is decided by whether chance explains the
        shift that its windows share.

    Notes
    -----
    An error that all of the reference has in common (its own shift) cannot be seen: it is an error of the
    attitude that these points give. `reference_sigma` is that of each point for itself.
    """
    labels = tuple(names or (f"image {k + 1}" for k in range(len(images))))
    placed, system = _checked(images, cameras, reference, dem, labels, search_px, points)
    for what, sigma in (("the reference", reference_sigma), ("the DEM", dem_sigma)):
        if not 0.0 <= sigma <= _LARGEST_SIGMA:
            raise InputError(
                f"the sigma of {what} is {sigma:g} m; 0 (it is exact) to {_LARGEST_SIGMA:g} m is allowed"
            )
    views = [_View(image, camera, dem, placed, system) for image, camera in zip(images, cameras, strict=True)]
    found, left = _all_matched(views, labels, window, search_px, progress)
    if not found and all(kind is EstimationError for kind, _ in left.values()):
        progress("trying cameras that are turned")
        yaw = _turn_of(views[len(views) // 2], search_px)
        if yaw is not None:
            views = [view.turned(yaw) for view in views]
            found, left = _all_matched(views, labels, window, search_px, progress)
    if not found:
        kind, reason = next(iter(left.values()))
        raise kind(f"{labels[next(iter(left))]}: {reason}")
    rows = {
        k: _chosen(matches, points or (BAND_POINTS if _is_band(cameras[k]) else FRAME_POINTS))
        for k, matches in found.items()
    }
    parts = [_points_of(views[k], found[k], rows[k], reference_sigma, dem_sigma) for k in sorted(found)]
    of_image = np.concatenate([np.full(len(rows[k]), k, dtype=np.intp) for k in sorted(found)])
    pixels, ground, base, sigma_px, offset, gsd = (
        np.concatenate([part[n] for part in parts]) for n in range(6)
    )
    mean_px = np.sqrt(0.5 * (sigma_px**2).sum(axis=1))
    common = max(float(np.quantile(mean_px, 0.1)), _LEAST_PX)
    extra = np.maximum(mean_px**2 - common**2, 0.0) * gsd**2
    # every row needs a sigma; a thousandth of a pixel is none
    own = np.hypot(base, 1e-3 * gsd)
    sigma = np.sqrt(own**2 + extra)
    bands = all(map(_is_band, cameras))
    said = tuple(f"{labels[k]}: left out: {text}" for k, (_, text) in left.items())
    return ReferenceTie(
        labels, of_image, pixels, ground, sigma, common, sigma_px, offset, found,
        {k: text for k, (_, text) in left.items()}, ground if to_table is None else to_table(ground),
        own, _window_lines(of_image, found) if bands else None, (*_warnings(found, labels), *said),
    )  # fmt: skip


def _checked(
    images: Sequence[ImageSource],
    cameras: Sequence[Camera],
    reference: ImageSource,
    dem: Dem,
    names: Sequence[str],
    search_px: float,
    points: int | None,
) -> tuple[PlacedImage, MapSystem]:
    """The reference with its map, or what does not fit."""
    if not len(images) == len(cameras) == len(names) > 0:
        raise InputError(f"as many cameras as images, one or more, got {len(cameras)} and {len(images)}")
    if not (np.isfinite(search_px) and search_px > 0.0):
        raise InputError(
            f"cameras are sought {search_px:g} px around; give more than 0 px, as far as they may be off "
            f"({SEARCH:g} unless given)"
        )
    if points is not None and not 1 <= points <= _MOST_POINTS:
        raise InputError(f"{points} control points of an image are wanted; 1 to {_MOST_POINTS} are allowed")
    if not isinstance(reference, PlacedImage):
        raise InputError("the reference has no georeferencing; give an orthoimage with an affine transform")
    flat = dem.crs is None
    if flat and reference.crs is not None:
        raise InputError(
            "the reference has a coordinate system, but the world of the cameras is flat (x east, y north in "
            "metres); give a reference without one, in those axes"
        )
    if not flat and reference.crs is None:
        raise InputError("the reference has no coordinate system; write that of its map into the file")
    return reference, MapSystem(reference.crs, dem.radii)


def _all_matched(
    views: Sequence[_View],
    names: Sequence[str],
    window: tuple[int, int] | None,
    search_px: float,
    progress: Progress,
) -> tuple[dict[int, RasterMatches], dict[int, tuple[type, str]]]:
    """Matches of every image that can be tied, and why others cannot."""
    found: dict[int, RasterMatches] = {}
    left: dict[int, tuple[type, str]] = {}
    for number, view in enumerate(views):
        progress("tying images to the reference", number, len(views))
        try:
            found[number] = _matched(view, names[number], window, search_px)
        except (EstimationError, GeometryError, InputError) as error:
            left[number] = type(error), str(error)
    return found, left


def _turn_of(view: _View, search_px: float) -> float | None:
    """rad; yaw by which a camera is off where nothing is found as it is given; None where no turn helps."""
    half = 0.5 * (view.image.shape[1] - 1)
    best, chosen = 0.0, None
    for px in TURNS:
        laid = _laid(view.turned(px / half))
        reach = min(search_px, float(max(view.image.shape))) / laid.reduced
        found = common_shift(laid.a, laid.b, reach=reach)
        # as many tries, as many chances
        if found.by_chance * len(TURNS) < CHANCE and found.strength > best:
            best, chosen = found.strength, px / half
    return chosen


def _is_band(camera: Camera) -> bool:
    """Whether lines are exposed one after the other."""
    return isinstance(camera, PushbroomCamera)


def _matched(view: _View, name: str, window: tuple[int, int] | None, search_px: float) -> RasterMatches:
    """Shifts between an image and the reference laid on it, in pixels of the image."""
    laid = _laid(view)
    reach = min(search_px, float(max(view.image.shape))) / laid.reduced
    k, pair = laid.reduced, cast(PairOnGeometry, laid.pair)
    learnt = learn_shifts(laid.a, laid.b, reach=reach, inside=laid.inside)
    affine = _affine(learnt.field.points, learnt.field.values, learnt.field.weights)

    def moved(pixels: Array, _height: float = 0.0, /) -> Array:
        return pair.where(pixels + affine(pixels))

    again = Overlay.of(replace(pair, geometry=moved), k, _SPACING)
    default = BAND_WINDOW if _is_band(view.camera) else WINDOWS["map"]
    found = match_laid(again, (name, "reference"), default, window, None, 0.0, silent)
    # the shifts found, and what the reference was moved by there
    shown = found.matches.b
    total = shown + k * affine(reduced_pixels(shown, k))
    matches = replace(found.matches, b=total)
    strength = np.nan if learnt.common is None else learnt.common.strength
    common = k * np.median(learnt.field.values, axis=0)
    return replace(
        found, matches=matches, common_px=common, common_strength=strength, overlay=laid, geometry="map"
    )


def _laid(view: _View) -> Overlay:
    """The reference on the grid of an image."""
    pair = PairOnGeometry(view.image, view.reference, view.seen)
    probes = lattice_points(view.image.shape, 41)
    there = pair.inside(probes)
    if there.mean() < _COVERED:
        raise GeometryError(
            f"the reference and the DEM cover {100 * there.mean():.0f} % of what the image sees by its "
            f"camera as given, {100 * _COVERED:.0f} % are needed at least; give those of the place, or check "
            "positions and attitudes"
        )
    return Overlay.of(*pair.alike(middle_of(probes[there]), 32), _SPACING)


def _affine(points: Array, values: Array, weights: Array) -> Callable[[Array], Array]:
    """The affine displacement nearest to a field's values, as a function of pixels."""
    middle, scale = points.mean(axis=0), max(float(np.ptp(points, axis=0).max()), 1.0)
    used = weights > 0.0
    basis = np.concatenate([np.ones((len(points), 1)), (points - middle) / scale], axis=1)
    if used.sum() < 6:
        basis = basis[:, :1]
    root = np.sqrt(weights)[:, None]
    solution = np.linalg.lstsq(basis * root, values * root, rcond=1e-6)[0]

    def at(pixels: Array) -> Array:
        out = np.broadcast_to(solution[0], pixels.shape)
        return out if len(solution) == 1 else out + ((pixels - middle) / scale) @ solution[1:]

    return at


def _window_lines(of_image: NDArray[np.intp], found: dict[int, RasterMatches]) -> Array:
    """(N,) lines of the window of each control point."""
    return np.array([found[k].window[0] for k in of_image.tolist()], dtype=np.float64)


def _chosen(matches: RasterMatches, count: int) -> NDArray[np.intp]:
    """Rows of the best known windows, evenly spread over the image."""
    sigma = np.sqrt((matches.sigma_px**2).sum(axis=1))
    across = max(1, min(8, int(np.sqrt(count))))
    return spread_subset(matches.matches.a, 1.0 / sigma, count, (max(1, count // (2 * across)), across))


def _points_of(
    view: _View, matches: RasterMatches, rows: NDArray[np.intp], reference_sigma: float, dem_sigma: float
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Pixels, ground, sigma (m) without the match, sigma of the match (px), offset (px), m per px."""
    pixels, shown = matches.matches.a[rows], matches.matches.b[rows]
    ground = view.ground(shown)
    steps = [view.ground(shown + s) - view.ground(shown - s) for s in np.eye(2)]
    area = np.linalg.norm(np.cross(steps[0], steps[1]), axis=1) / 4.0
    known = np.isfinite(ground).all(axis=1) & np.isfinite(area) & (area > 0.0)
    pixels, shown, ground = pixels[known], shown[known], ground[known]
    tilt = _tilt(view, shown, ground)
    if not _is_band(view.camera):
        # heights of points are heights of the pose
        tilt = np.maximum(tilt, 1.0)
    base = np.hypot(reference_sigma, dem_sigma * tilt)
    offset = pixels - (shown if view.given is None else view.given.project(ground))
    return pixels, ground, base, matches.sigma_px[rows][known], offset, np.sqrt(area[known])


def _tilt(view: _View, pixels: Array, ground: Array) -> Array:
    """Tangent (N,) of the angle between the line of sight and the vertical."""
    directions = view.camera.rays(pixels).directions
    up = np.tile([0.0, 0.0, 1.0], (len(ground), 1))
    if view.system.crs is not None:
        geodetic = to_geodetic(ground, view.system.radii)
        up = np.stack([local_axes(lon, lat).as_matrix()[:, 2] for lon, lat, _ in geodetic])
    down = np.abs(np.einsum("ni,ni->n", directions, up))
    return np.asarray(np.sqrt(np.maximum(1.0 - down**2, 0.0)) / np.maximum(down, 1e-3))


def _warnings(found: dict[int, RasterMatches], names: Sequence[str]) -> list[str]:
    """What windows of each image said."""
    out: list[Any] = []
    for number, matches in found.items():
        out += [f"{names[number]}: {text}" for text in matches.warnings]
    return out
