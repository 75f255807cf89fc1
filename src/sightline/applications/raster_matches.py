"""Any two rasters: where the second shows what the first shows, window by window, each with its covariance.

By their place on a map where both have one (sizes of pixels, coordinate systems and extents may differ), else
by their pixels, a shift of any size between them being looked for first.

Not here: the comparison of windows (``matching/``), files (``io/results/raster_matches.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.execution import Progress, silent, steps_of
from sightline.imaging.placed import PlacedImage
from sightline.imaging.reduce import whole_pixels
from sightline.imaging.source import ImageSource
from sightline.matching.agreement import departures, disagreeing, scatter
from sightline.matching.coarse import CommonShift, LearntShifts, learn_shifts
from sightline.matching.kernels import RADIUS
from sightline.matching.match_images import MAX_SIGMA_PX, match_images
from sightline.matching.matches import KEPT, OUTLIER, TEXTURELESS, Matches, largest_sigma
from sightline.matching.on_geometry import PairOnGeometry, lattice_points, middle_of, within
from sightline.matching.select import grid_points
from sightline.matching.whitening import Whitening, gradient_filter, pair_whitening
from sightline.result import Result, makes_result

__all__ = ["BandMatches", "MatchProfile", "RasterMatches", "match_bands", "match_rasters"]

Array = NDArray[np.float64]

#: How images are laid on each other.
GEOMETRIES = ("auto", "map", "pixels")
#: (lines, columns) px of windows: low and wide where lines were acquired one after the other.
WINDOWS = {"map": (32, 32), "pixels": (10, 100)}
#: px; furthest shift that is looked for.
SEARCH = 64.0
#: px; shortest side of images that are searched.
_SHORTEST = 24
#: Sigmas of the pilot windows about the field that the search about it takes in, and px beyond.
_REACH, _BEYOND = 4.0, 1
#: px; longest search about the field.
_LONGEST = 16
#: Kept matches below which there is no answer, share of those tried below which it is warned of.
_FEWEST, _FEW = 4, 0.2
#: Scatter of faint matches beyond which they are chance: that of true ones is 1, up to 1.4 where contrast is
#: faintest; of chance 2.2 and more, lying anywhere within a pixel or more to each side at a stated .4 px.
_FAINT_SCATTER = 1.7
#: px of tiles that filters of square windows are estimated from.
_SQUARE_TILE = (48, 48)
#: Change of a pixel's side up to which two grids count as alike.
_ALIKE = 1e-9
#: px inside an image from which on its pixels may be asked for: less than one beyond it.
_RIM = -1.0 + 1e-9


@dataclass(frozen=True, eq=False)
class MatchProfile:
    """Means of the shifts over the windows of each row, or of each column, of windows.

    Attributes
    ----------
    place : (n,)
        px of a; centres of the windows, lines or columns.
    shift_px : (n, 2)
        Weighted mean of d_line and d_column; NaN where no window was kept.
    sigma_px : (n, 2)
        What the covariances of the windows make of it.
    windows : (n,) int
        Windows kept.
    """

    place: Array
    shift_px: Array
    sigma_px: Array
    windows: NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class RasterMatches(Result):
    """Shifts between two rasters.

    Attributes
    ----------
    matches : Matches
        px of image a; `a` are the windows' centres, ``b - a`` the shifts once b is laid on the grid of a.
    shape : (int, int)
        Rows and columns of windows; `matches` has them row by row.
    first : (float, float)
        px; centre of the first window.
    step : (int, int)
        px from one window to the next.
    window : (int, int)
        px; lines and columns.
    geometry : str
        "map" or "pixels".
    reduced : int
        px of a, and of its windows, that were taken together because b has pixels as large.
    common_px : (2,)
        px; the shift that was found for the whole image before windows were matched.
    common_strength : float
        How far it stands out, in sigmas; NaN where none was looked for.
    names : (str, str)
    warnings : tuple of str
    """

    matches: Matches
    shape: tuple[int, int]
    first: tuple[float, float]
    step: tuple[int, int]
    window: tuple[int, int]
    geometry: str
    reduced: int
    common_px: Array
    common_strength: float
    names: tuple[str, str] = ("a", "b")
    warnings: tuple[str, ...] = ()
    overlay: Overlay | None = field(default=None, compare=False)

    @property
    def shift_px(self) -> Array:
        """(N, 2) d_line and d_column of every window; NaN where it was not kept."""
        kept = self.matches.kept[:, None]
        return np.where(kept, self.matches.b - self.matches.a, np.nan)

    @property
    def sigma_px(self) -> Array:
        """(N, 2) of `shift_px`; NaN where a window was not kept."""
        return np.where(self.matches.kept[:, None], self.matches.sigma_px, np.nan)

    @property
    def correlation(self) -> Array:
        """(N,) of the errors of d_line and d_column; NaN where a window was not kept."""
        covariance = self.matches.covariance_px
        with np.errstate(invalid="ignore"):
            value = covariance[:, 0, 1] / np.sqrt(covariance[:, 0, 0] * covariance[:, 1, 1])
        return np.where(self.matches.kept, value, np.nan)

    @property
    def row_means(self) -> MatchProfile:
        """Over the windows of each row."""
        return self._means(0)

    @property
    def column_means(self) -> MatchProfile:
        """Over the windows of each column."""
        return self._means(1)

    def _means(self, axis: int) -> MatchProfile:
        shift = self.shift_px.reshape(*self.shape, 2)
        variance = self.sigma_px.reshape(*self.shape, 2) ** 2
        there = np.asarray(np.isfinite(shift).all(axis=2))
        with np.errstate(invalid="ignore", divide="ignore"):
            weight = np.where(there[..., None], 1.0 / variance, 0.0)
            total = np.asarray(weight.sum(axis=1 - axis))
            mean = (weight * np.where(there[..., None], shift, 0.0)).sum(axis=1 - axis) / total
            sigma = 1.0 / np.sqrt(total)
        none = total[:, :1] == 0.0
        place = self.first[axis] + self.step[axis] * np.arange(self.shape[axis], dtype=np.float64)
        return MatchProfile(
            place, np.where(none, np.nan, mean), np.where(none, np.nan, sigma), there.sum(axis=1 - axis)
        )


@dataclass(frozen=True, eq=False, repr=False)
class BandMatches(Result):
    """Shifts between the bands of one raster, pair by pair.

    Attributes
    ----------
    bands : tuple of str
        Names of the bands.
    pairs : tuple of (int, int)
        Numbers of the bands that were compared, from 0.
    matches : tuple of RasterMatches
        Of each pair.
    warnings : tuple of str
    """

    bands: tuple[str, ...]
    pairs: tuple[tuple[int, int], ...]
    matches: tuple[RasterMatches, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Overlay:
    """One image on the grid of another.

    Attributes
    ----------
    a, b : ImageSource
        Both as they are matched: reduced, b resampled where its grid is another.
    offset : (2,)
        px of both; where the first pixel of a lies in b.
    reduced : int
        px of image a as given in one of `a`.
    geometry : str
    pair : PairOnGeometry or None
        What lays b on a; None where pixels do.
    """

    a: ImageSource
    b: ImageSource
    offset: Array
    reduced: int
    geometry: str
    pair: PairOnGeometry | None = None

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Which of points (N, 2) of `a` lie within b."""
        return np.ones(len(points), dtype=np.bool_) if self.pair is None else self.pair.inside(points, _RIM)

    @classmethod
    def of(cls, pair: PairOnGeometry, reduced: int, spacing: int) -> Overlay:
        """The partner of a pair laid on its hub, which was reduced; positions known at every `spacing` px."""
        return cls(pair.hub, pair.warped(spacing), np.zeros(2), reduced, "map", pair)


def overlay(a: ImageSource, b: ImageSource, geometry: str = "auto") -> Overlay:
    """Image b on the grid of image a.

    Parameters
    ----------
    a, b : ImageSource
    geometry : str
        Of `GEOMETRIES`; "auto": the map where both are `PlacedImage`.

    Raises
    ------
    InputError
        If only one has a place, or their places do not overlap.
    """
    if geometry not in GEOMETRIES:
        raise InputError(f"`geometry` is {geometry!r}; allowed are {', '.join(GEOMETRIES)}")
    placed = [isinstance(image, PlacedImage) for image in (a, b)]
    if geometry == "pixels" or (geometry == "auto" and not any(placed)):
        return Overlay(a, b, np.zeros(2), 1, "pixels")
    if not all(placed):
        which = ("the first", "the second")[placed.index(False)]
        raise InputError(
            f"{which} image has no georeferencing"
            + (", the other has" if any(placed) else "")
            + "; give both a place on a map, or compare them pixel by pixel (--geometry pixels)"
        )
    return _on_map(cast(PlacedImage, a), cast(PlacedImage, b))


def _on_map(a: PlacedImage, b: PlacedImage) -> Overlay:
    """Image b on the grid of a by their places."""
    transformer = _between(a, b)

    def exact(pixels: Array, _height: float = 0.0, /) -> Array:
        return b.pixels(transformer(a.places(pixels)))

    pair = PairOnGeometry(a, b, exact)
    middle = _overlap(a, b, pair)
    turn = pair.turn(middle)[0]
    if transformer is _same and np.abs(turn - np.eye(2)).max() * max(a.shape) < _ALIKE * max(a.shape) + 1e-6:
        return Overlay(a, b, exact(np.zeros((1, 2)))[0], 1, "map", pair)
    return Overlay.of(*pair.alike(middle, 16), 64)


def _same(places: Array) -> Array:
    return places


def _between(a: PlacedImage, b: PlacedImage) -> Any:
    """Places (N, 2) on the map of a as those on the map of b."""
    if a.crs == b.crs:
        return _same
    if a.crs is None or b.crs is None:
        which = "first" if a.crs is None else "second"
        raise InputError(
            f"the {which} image has no coordinate system, the other has; write it into the file "
            "(`gdal_edit.py -a_srs`), or compare the images pixel by pixel (--geometry pixels)"
        )
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    try:
        first, second = CRS.from_user_input(a.crs), CRS.from_user_input(b.crs)
        if first.equals(second, ignore_axis_order=True):
            return _same
        change = Transformer.from_crs(first, second, always_xy=True)
    except ProjError as error:
        raise InputError(f"no way between the coordinate systems of the two images: {error}") from error

    def moved(places: Array) -> Array:
        x, y = change.transform(places[:, 0], places[:, 1])
        return np.where(np.isfinite(x + y)[:, None], np.stack([x, y], axis=1), np.nan)

    return moved


def _overlap(a: PlacedImage, b: PlacedImage, pair: PairOnGeometry) -> Array:
    """A pixel (1, 2) of a about the middle of what both show; InputError if that is nothing."""
    probes = lattice_points(a.shape, 257)
    seen = probes[pair.inside(probes, -0.5)]
    if not len(seen):
        said = [_box(image) for image in (a, b)]
        raise InputError(
            f"the two images do not overlap on the map: the first covers {said[0]}, the second {said[1]}; "
            "give images of one place, or compare them pixel by pixel (--geometry pixels)"
        )
    return middle_of(seen)


def _box(image: PlacedImage) -> str:
    """Where an image lies, in words."""
    corners = np.array([[-0.5, -0.5], [image.shape[0] - 0.5, image.shape[1] - 0.5]])
    (x0, y0), (x1, y1) = image.places(corners)
    name = "its own axes"
    if image.crs is not None:
        from pyproj import CRS

        name = CRS.from_user_input(image.crs).name
    return f"x {min(x0, x1):.9g} to {max(x0, x1):.9g}, y {min(y0, y1):.9g} to {max(y0, y1):.9g} in {name}"


@makes_result
def match_rasters(
    a: ImageSource,
    b: ImageSource,
    *,
    geometry: str = "auto",
    window: tuple[int, int] | None = None,
    step: tuple[int, int] | None = None,
    search_px: float | None = None,
    min_score: float = 0.2,
    max_sigma_px: float = 0.5,
    names: tuple[str, str] | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> RasterMatches:
    """Where image b shows what image a shows, window by window, with a covariance that is true.

    Parameters
    ----------
    a, b : ImageSource
        Images, which are read in windows; with a place on a map where they are `PlacedImage` (`load_raster`
        gives one for a georeferenced file). NaN, or a mask, where pixels cannot be used.
    geometry : "auto", "map" or "pixels"
        Lay b on a by their places on the map, or by their pixels; "auto": the map where both have one.
    window : (int, int), optional
        Lines and columns of a window, px of a; (10, 100) by pixels, (32, 32) on a map.
    step : (int, int), optional
        From one window to the next; the window's own size by default, so that their errors are independent.
    search_px : float, optional
        px of a; furthest shift that is looked for, by default 64, in smaller images as far as their longest
        side; 0: less than 4 px, nothing is searched.
    min_score, max_sigma_px : float
        As of `match_images`.
    names : (str, str), optional
        Of the images, for what is written; those of their files by default.
    threads : int, optional
        All cores by default; the result does not depend on it.
    progress : callable
        Called with what is being done.

    Returns
    -------
    RasterMatches

    Raises
    ------
    InputError
        If the images do not overlap, only one has a place, or they are too small for one window.
    EstimationError
        If they do not show the same: the shift that their windows share may be chance.

    Notes
    -----
    A shift common to all windows first (`sightline.matching.coarse`), then its change over the image on some
    windows, then all windows (`match_images`: whitened, Gauss-Newton, covariance from what is left over). A
    window that goes neither with its neighbours of the same row nor with those of the same column is an
    outlier. Where pixels of b are larger, those of a are averaged to about their size; where they are
    smaller, those of b.
    """
    if min(*a.shape, *b.shape) < _SHORTEST:
        raise InputError(
            f"the images have {a.shape[0]} x {a.shape[1]} and {b.shape[0]} x {b.shape[1]} px; {_SHORTEST} px "
            "a side are needed at least"
        )
    longest = max(*a.shape, *b.shape)
    reach = min(SEARCH, longest) if search_px is None else search_px
    if not (np.isfinite(reach) and 0.0 <= reach <= longest):
        raise InputError(
            f"`search_px` is {reach:g}; 0 to {longest} px, the longest side of the images, are allowed "
            "(--search)"
        )
    laid = overlay(a, b, geometry)
    options = {"min_score": min_score, "max_sigma_px": max_sigma_px, "threads": threads}
    return match_laid(
        laid, names or _names(a, b), WINDOWS[laid.geometry], window, step, reach, progress, **options
    )


def match_laid(
    laid: Overlay,
    names: tuple[str, str],
    default: tuple[int, int],
    window: tuple[int, int] | None,
    step: tuple[int, int] | None,
    reach: float,
    progress: Progress,
    **options: Any,
) -> RasterMatches:
    """Shifts between two images that are laid on each other.

    Parameters
    ----------
    laid : Overlay
    names : (str, str)
    default : (int, int)
        Window where none is given; smaller for small images.
    window, step : (int, int) or None
        px of image a.
    reach : float
        px of image a; furthest shift.
    progress : callable
    options
        Of `match_images`.
    """
    k = laid.reduced
    window, step, size = _windows(laid, default, window, step)
    points = _points(laid.a.shape, size, step)
    shape = (len(np.unique(points[:, 0])), len(np.unique(points[:, 1])))
    _check_count(len(points), laid, step, size)
    progress("finding the shift that all windows share")
    learnt = learn_shifts(laid.a, laid.b, tuple(laid.offset), reach=reach / k, inside=laid.inside)
    inside = laid.inside(points)
    predicted = np.full(points.shape, np.nan)
    predicted[inside] = points[inside] + learnt.at(points[inside])
    predicted[_at_rim(predicted, laid.b.shape, size)] = np.nan
    inside &= np.isfinite(predicted).all(axis=1)
    search = _search(learnt)
    whitening = _whitening(laid, points[inside], predicted[inside], size, search)
    found = match_images(
        laid.a, laid.b, points, predicted, window=size, search_px=search, whitening=whitening,
        both_ways=True, step=steps_of(progress, "matching windows"), **options,
    )  # fmt: skip
    found = _in_agreement(found, laid.offset, shape)
    tried = int(inside.sum())
    _check_enough(found[inside])
    common = learnt.common
    return RasterMatches(
        _in_pixels_of_a(found, laid),
        shape,
        tuple(whole_pixels(points[0], k)),
        (step[0] * k, step[1] * k),
        (size[0] * k, size[1] * k),
        laid.geometry,
        k,
        _common(learnt, common, laid),
        np.nan if common is None else common.strength,
        names,
        tuple(_warnings(found, tried, laid, whitening)),
        laid,
    )


def _names(a: ImageSource, b: ImageSource) -> tuple[str, str]:
    """Names of the files that tell the two images apart; a and b for arrays."""
    paths = [getattr(image, "path", None) for image in (a, b)]
    first, second = (
        letter if path is None else Path(path).name for path, letter in zip(paths, "ab", strict=True)
    )
    if first != second:
        return first, second
    bands = [
        getattr(image.source if isinstance(image, PlacedImage) else image, "band", 1) for image in (a, b)
    ]
    if bands[0] != bands[1]:
        return f"{first} band {bands[0]}", f"{second} band {bands[1]}"
    return str(paths[0]), str(paths[1])


def _common(learnt: LearntShifts, common: CommonShift | None, laid: Overlay) -> Array:
    """px of image a; median of the field that windows were sought about."""
    return np.asarray(laid.reduced * (np.median(learnt.field.values, axis=0) - laid.offset))


def _windows(
    laid: Overlay,
    default: tuple[int, int],
    window: tuple[int, int] | None,
    step: tuple[int, int] | None,
) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """Window as asked, step and window in pixels of what is matched."""
    k, shape = laid.reduced, laid.a.shape
    # small images get smaller windows, but for those that were asked for
    asked = window or (k * min(default[0], max(shape[0] // 4, 8)), k * min(default[1], max(shape[1] // 4, 8)))
    size = max(asked[0] // k, 2), max(asked[1] // k, 8)
    stride = size if step is None else (max(step[0] // k, 1), max(step[1] // k, 1))
    for name, given in (("window", window), ("step", step)):
        if given is not None and min(given) < 1:
            raise InputError(
                f"`{name}` is {tuple(given)}; lines and columns, 1 px or more each, are allowed (--{name})"
            )
    if size[0] > shape[0] or size[1] > shape[1] or min(min(shape), *laid.b.shape) < _SHORTEST:
        scale = "" if k == 1 else f" (averages over {k} px: those of the other image are as large)"
        raise InputError(
            f"windows of {size[0]} x {size[1]} px do not fit into images of {shape[0]} x {shape[1]} and "
            f"{laid.b.shape[0]} x {laid.b.shape[1]} px{scale}; {_SHORTEST} px a side are needed at least, "
            "and a window within the first image"
        )
    return asked, stride, size


def _points(shape: tuple[int, int], size: tuple[int, int], step: tuple[int, int]) -> Array:
    """Centres of windows, off the rim: there the filters of the pair would read beyond the image."""
    rim = min(RADIUS, (shape[0] - size[0]) // 2, (shape[1] - size[1]) // 2)
    return rim + grid_points((shape[0] - 2 * rim, shape[1] - 2 * rim), window=size, step=step)


def _at_rim(points: Array, shape: tuple[int, int], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Windows about points (N, 2) that come closer to the rim of an image than its filter reaches."""
    return ~within(points, shape, 0.5 * (np.array(size) - 1) + RADIUS)


def _search(learnt: LearntShifts) -> tuple[int, int]:
    """px about the field, lines and columns, that hold nearly every window."""
    reach = np.clip(np.ceil(_REACH * learnt.spread) + _BEYOND, 2, _LONGEST)
    return int(reach[0]), int(reach[1])


def _whitening(
    laid: Overlay, points: Array, predicted: Array, size: tuple[int, int], search: tuple[int, int]
) -> Whitening:
    """Filters of the pair; fixed ones where the images are too small or too unlike to show them."""
    tile = None if size[1] >= 4 * size[0] else _SQUARE_TILE
    reach = (max(search[0], 3), max(search[1], 3))
    return pair_whitening(laid.a, laid.b, points, predicted, tile=tile, reach=reach) or gradient_filter()


def _in_agreement(found: Matches, offset: Array, shape: tuple[int, int]) -> Matches:
    """Matches less those that do not go with their neighbours, and with the faint ones if those do.

    A faint match could be chance (`both_ways` of `match_images`), which lies anywhere within the search: if
    they scatter as their sigmas say, they are none.
    """
    faint = (found.status == TEXTURELESS) & (largest_sigma(found.covariance_px) <= MAX_SIGMA_PX)
    departure = _departures(found, found.kept | faint, offset, shape)
    if scatter(departure[faint]) <= _FAINT_SCATTER:
        found = replace(found, status=np.where(faint, KEPT, found.status))
    elif faint.any():  # chance is no neighbour of what is kept
        departure = _departures(found, found.kept, offset, shape)
    return found.with_status(disagreeing(np.where(found.kept, departure, np.nan)), OUTLIER)


def _departures(found: Matches, of: NDArray[np.bool_], offset: Array, shape: tuple[int, int]) -> Array:
    """(N,) in sigmas, how far some of the matches depart from their neighbours; NaN of others."""
    shift, sigma = (
        np.where(of[:, None], values, np.nan).reshape(*shape, 2)
        for values in (found.b - found.a - offset, found.sigma_px)
    )
    return departures(shift, sigma).ravel()


def _in_pixels_of_a(found: Matches, laid: Overlay) -> Matches:
    """Matches in pixels of image a as given, b laid on its grid."""
    k = laid.reduced
    at = whole_pixels(found.a, k)
    shift = k * (found.b - found.a - laid.offset)
    return Matches(at, at + shift, k * k * found.covariance_px, found.score, found.status)


def _check_count(count: int, laid: Overlay, step: tuple[int, int], size: tuple[int, int]) -> None:
    """InputError where the first image holds too few windows, whatever it shows."""
    if count >= _FEWEST:
        return
    lines, columns = (laid.reduced * side for side in laid.a.shape)
    (high, wide), (down, across) = (np.multiply(laid.reduced, pair) for pair in (size, step))
    raise InputError(
        f"windows of {high} x {wide} px every {down} x {across} px: {count} of them lie in an image of "
        f"{lines} x {columns} px, {_FEWEST} are needed at least; take a smaller step (--step), or smaller "
        "windows (--window)"
    )


def _check_enough(found: Matches) -> None:
    """EstimationError where too few of the windows tried were found."""
    kept, tried = int(found.kept.sum()), len(found)
    if kept >= _FEWEST:
        return
    counts = {name: count for name, count in found.counts().items() if count and name != "kept"}
    said = ", ".join(f"{count} {name}" for name, count in counts.items())
    advice = "check masks and no-data values, take larger windows, or images that look alike"
    if found.counts()["textureless"] > 0.5 * tried:
        advice = (
            "what the images share places a window in one direction at most (stripes), or hardly at all: "
            "take larger windows (--window), or images with more texture"
        )
    if tried < _FEWEST:
        advice = "only so many lie in what the images share; take a smaller step (--step), or smaller windows"
    raise EstimationError(
        f"{kept} of {tried} windows were kept{f' ({said})' if said else ''}; {_FEWEST} are needed at least; "
        f"{advice}"
    )


def _warnings(found: Matches, tried: int, laid: Overlay, whitening: Whitening) -> list[str]:
    """What to know before trusting the shifts."""
    kept, said = int(found.kept.sum()), []
    if kept < _FEW * tried:
        said.append(
            f"only {kept} of {tried} windows were kept: the images differ over most of their area (clouds, "
            "change, no data), or have little texture"
        )
    if whitening.coherence is None:
        said.append(
            "filters of the pair could not be estimated (too small, or too unlike); fixed ones compare "
            "edges: sigma is larger than it need be"
        )
    if laid.reduced > 1:
        said.append(
            f"pixels of the first image were averaged over {laid.reduced} x {laid.reduced}: those of the "
            "second are as large"
        )
    return said


@makes_result
def match_bands(
    images: Sequence[ImageSource],
    names: Sequence[str] | None = None,
    *,
    pairs: str | Sequence[tuple[int, int]] = "first",
    progress: Progress = silent,
    **options: Any,
) -> BandMatches:
    """Shifts between images of one grid, such as the bands of a file.

    Parameters
    ----------
    images : sequence of ImageSource
        Two or more.
    names : sequence of str, optional
    pairs : "first", "all" or sequence of (int, int)
        Each against the first, every two of them, or those listed (numbers from 0).
    progress : callable
    options
        Those of `match_rasters`.

    Returns
    -------
    BandMatches
        A pair that cannot be matched is left out and named in `warnings`.

    Raises
    ------
    InputError
        If there are fewer than two bands, or a pair names one that is not there.
    EstimationError
        If no pair can be matched.
    """
    count = len(images)
    labels = tuple(f"band {k + 1}" for k in range(count)) if names is None else tuple(names)
    if count < 2 or len(labels) != count:
        raise InputError(f"two bands or more are needed, with as many names; got {count} and {len(labels)}")
    wanted = _wanted(pairs, count)
    done: list[tuple[int, int]] = []
    found: list[RasterMatches] = []
    said: list[str] = []
    reason: EstimationError | None = None
    for number, (i, j) in enumerate(wanted):
        progress("matching pairs of bands", number, len(wanted))
        try:
            one = match_rasters(images[i], images[j], names=(labels[i], labels[j]), **options)
        except EstimationError as error:
            reason = error
            said.append(f"{labels[i]} - {labels[j]}: left out: {error}")
            continue
        done.append((i, j))
        found.append(one)
        said += [f"{labels[i]} - {labels[j]}: {text}" for text in one.warnings]
    if reason is not None and not found:
        raise EstimationError(f"no pair of bands can be matched; of the last: {reason}")
    return BandMatches(labels, tuple(done), tuple(found), tuple(said))


def _wanted(pairs: str | Sequence[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    """Pairs of numbers of bands."""
    if pairs == "all":
        return list(combinations(range(count), 2))
    if pairs == "first":
        return [(0, k) for k in range(1, count)]
    listed = [] if isinstance(pairs, str) else [(int(i), int(j)) for i, j in pairs]
    if not listed or any(not (0 <= i < count and 0 <= j < count and i != j) for i, j in listed):
        raise InputError(
            f'`pairs` is {pairs!r}; "first", "all" or pairs of two numbers from 0 to {count - 1} are allowed'
        )
    return listed
