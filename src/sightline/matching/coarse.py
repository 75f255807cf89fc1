"""Where one image lies on another, known to many pixels only: the shift that they share, then its field.

Windows of reduced images are correlated with all places within reach, and the surfaces of all windows are
added: windows of one scene agree on a place, those of two scenes do not. Whether they do is a question of
chance, which the surfaces answer themselves.

Not here: the last look at full resolution (``match_images.py``), the cameras of either image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.robust import robust_sigmas
from sightline.imaging.reduce import ReducedImage, reduced_pixels, whole_pixels
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.matching.correlate import correlation_surface
from sightline.matching.displacement import DisplacementField
from sightline.matching.match_images import match_images
from sightline.matching.select import grid_points
from sightline.matching.whitening import gradient_filter

Array = NDArray[np.float64]

#: Probability by chance below which a shift that windows share is believed.
CHANCE = 1e-4
#: px of the coarsest scale: sides of its windows, most and least; pixels of an image that it aims at.
_WINDOW, _LEAST_WINDOW, _AIM = 64, 16, 600 * 600
#: Most windows of a scale, and pixels of a window's search that are wanted at the coarsest one.
_MOST, _SHORT = 300, 16
#: Windows of the finer scales (px), and their search about what the scale before left.
_FINE_WINDOW, _FINE_SEARCH = (32, 32), 4
#: Factor from one scale to the next.
_STEP = 4
#: px over which a shift may differ between windows of one scale and still be found together.
_BLURS = (1, 5)
#: Share of a window that may be unusable, and of all windows that must see a place.
_MASKED, _SEEN = 0.2, 0.3
#: Pixels read at once.
_READ = 8_000_000


@dataclass(frozen=True, eq=False)
class CommonShift:
    """The shift that most windows of two images share.

    Attributes
    ----------
    shift : (2,)
        px; the place in b less the one in a.
    strength : float
        Height of the common peak, in sigmas of the surfaces.
    by_chance : float
        Probability of so high a peak somewhere in the search between images that have nothing in common.
    points, values : (N, 2)
        px; centres of windows in a, and what each shows by itself near the common shift.
    factor : int
        px; reduction at which it was found.
    """

    shift: Array
    strength: float
    by_chance: float
    points: Array
    values: Array
    factor: int

    @property
    def believed(self) -> bool:
        """Whether chance does not explain it."""
        return self.by_chance < CHANCE


@dataclass(frozen=True, eq=False)
class LearntShifts:
    """How b lies on a, smooth over the image, and how far single windows depart from it.

    Attributes
    ----------
    field : DisplacementField
    spread : (2,)
        px, robust sigma of windows about the field, lines and columns.
    common : CommonShift or None
        None where no search was wanted.
    agreeing, tried : int
        Windows of the last scale that go with the field, and all of them.
    """

    field: DisplacementField
    spread: Array
    common: CommonShift | None
    agreeing: int
    tried: int

    def at(self, points: Array) -> Array:
        """Displacements (N, 2) px at points (N, 2) of a, some thousands at a time."""
        parts = [self.field.at(points[first : first + 20000]) for first in range(0, len(points), 20000)]
        return np.concatenate(parts) if parts else np.empty((0, 2))


def reduction(shape: tuple[int, int], reach: float) -> int:
    """The power of two by which images of a shape are reduced to search `reach` px."""
    factor = 1
    while min(shape) // (2 * factor) >= 3 * _LEAST_WINDOW and (
        shape[0] * shape[1] > _AIM * factor * factor or reach / factor > _SHORT
    ):
        factor *= 2
    return factor


def _held(source: ImageSource, factor: int) -> ArrayImage:
    """A reduced image in memory, read block by block; pixels that are not usable are NaN."""
    reduced = source if factor == 1 else ReducedImage(source, factor)
    lines, columns = reduced.shape
    out = np.empty((lines, columns), np.float32)
    height = max(1, _READ // (columns * factor * factor))
    for first in range(0, lines, height):
        window = (first, min(first + height, lines)), (0, columns)
        pixels, bad = reduced.read(*window), reduced.mask(*window)
        out[slice(*window[0])] = pixels if bad is None else np.where(bad, np.nan, pixels)
    return ArrayImage(out)


def _edges(pixels: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A band of middle frequencies of an image, 0 where there is none; and where that is."""
    from scipy.ndimage import gaussian_filter

    good = np.isfinite(pixels)
    filled = np.where(good, pixels, np.float32(pixels[good].mean() if good.any() else 0.0))
    band = gaussian_filter(filled, 0.7) - gaussian_filter(filled, 3.0)
    # a single bright building must not outweigh the rest of its window
    level = 4.0 * float(np.sqrt(np.mean(band[good] ** 2))) if good.any() else 0.0
    return np.where(good, np.clip(band, -level, level), np.float32(0.0)).astype(np.float32), ~good


def common_shift(
    a: ImageSource,
    b: ImageSource,
    offset: tuple[float, float] = (0.0, 0.0),
    *,
    reach: float,
    factor: int | None = None,
) -> CommonShift:
    """The shift of b against a that the windows of both share.

    Parameters
    ----------
    a, b : ImageSource
        NaN, or a mask, where they cannot be used.
    offset : (float, float)
        px; where the first pixel of a should lie in b: the search is about it.
    reach : float
        px; furthest shift from it, along lines and columns.
    factor : int, optional
        Reduction at which is searched; `reduction` says which by default.

    Returns
    -------
    CommonShift
        `shift` includes `offset`.

    Raises
    ------
    InputError
        If the images are too small to cut windows from, no window of a has texture that may be used, or b has
        none where they are sought.

    Notes
    -----
    Each window's surface of normalised correlation is divided by the root of the summed variances of all: at
    places that do not belong together the sum is a standard normal number, whatever the textures. The peak is
    compared with the largest of as many such numbers as there are places.
    """
    factor = reduction(a.shape, reach) if factor is None else factor
    a_low, b_low = _held(a, factor), _held(b, factor)
    (edges_a, bad_a), (edges_b, bad_b) = _edges(a_low.array), _edges(b_low.array)  # type: ignore[arg-type]
    side = int(min(_WINDOW, max(min(edges_a.shape) // 3, _LEAST_WINDOW)))
    points = grid_points(edges_a.shape, window=(side, side))
    if not len(points):
        raise InputError(
            f"an image of {a.shape[0]} x {a.shape[1]} px is too small to be searched; {_LEAST_WINDOW} px a "
            "side are needed at least"
        )
    points = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST)).astype(int))]
    corner = np.rint(points - 0.5 * (side - 1)).astype(int)
    start = np.rint(np.array(offset) / factor).astype(int)
    span = math.ceil(reach / factor) + 2
    cut = [edges_a[y : y + side, x : x + side] for y, x in corner]
    shown = [bad_a[y : y + side, x : x + side].mean() <= _MASKED for y, x in corner]
    keep = [n for n, c in enumerate(cut) if shown[n] and c.std() > 0.0]
    if not keep:
        raise InputError(
            "no window of the first image can be used: it is constant, or unusable (no data, masked) nearly "
            "everywhere the second reaches; give images that overlap, with texture"
        )
    surfaces = np.stack([_surface(cut[n], edges_b, bad_b, corner[n] + start, span) for n in keep])
    strength, place, chance = _peak(surfaces)
    if not np.isfinite(strength):
        raise InputError(
            f"the second image has no texture within {reach:g} px of where windows of the first should lie: "
            "it is constant, or unusable (no data, masked) there; give one that shows the same scene"
        )
    own = _own_peaks(surfaces, place)
    scaled = whole_pixels(points[keep] + start + own - span, factor) - whole_pixels(points[keep], factor)
    shift = factor * (start + place - span).astype(np.float64)
    return CommonShift(shift, strength, chance, whole_pixels(points[keep], factor), scaled, factor)


def _surface(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    bad: NDArray[np.bool_],
    corner: NDArray[np.int64],
    span: int,
) -> NDArray[np.float32]:
    """Correlation of a template with places up to `span` px from `corner`; NaN where there is too little."""
    side = len(template)
    size = side + 2 * span
    low = corner - span
    first, last = np.maximum(low, 0), np.minimum(low + size, image.shape)
    out = np.full((2 * span + 1, 2 * span + 1), np.nan, np.float32)
    if np.any(last - first < side):
        return out
    part = (slice(first[0], last[0]), slice(first[1], last[1]))
    region = np.ascontiguousarray(image[part])
    surface = correlation_surface(template[None], region[None])[0]
    share = np.zeros((region.shape[0] + 1, region.shape[1] + 1))
    np.cumsum(np.cumsum(bad[part], axis=0), axis=1, out=share[1:, 1:])
    masked = share[side:, side:] - share[:-side, side:] - share[side:, :-side] + share[:-side, :-side]
    surface[masked > _MASKED * side * side] = np.nan
    (y, x), (h, w) = first - low, surface.shape
    out[y : y + h, x : x + w] = surface
    return out


def _peak(surfaces: NDArray[np.float32]) -> tuple[float, NDArray[np.int64], float]:
    """Height (sigmas), place and probability by chance of the common peak of all surfaces."""
    from scipy.ndimage import uniform_filter
    from scipy.special import log_ndtr

    seen = np.isfinite(surfaces)
    values = np.where(seen, surfaces, 0.0).astype(np.float64)
    count = np.maximum(seen.sum(axis=(1, 2)), 1)
    mean = values.sum(axis=(1, 2)) / count
    variance = (values**2).sum(axis=(1, 2)) / count - mean**2
    total = np.where(seen, values - mean[:, None, None], 0.0).sum(axis=0)
    spread = np.sqrt(np.where(seen, variance[:, None, None], 0.0).sum(axis=0))
    enough = seen.sum(axis=0) >= max(1.0, _SEEN * seen.sum(axis=0).max())
    score = np.where(enough & (spread > 0.0), total / np.maximum(spread, 1e-30), -np.inf)
    if not np.isfinite(score).any():
        return -np.inf, np.array(total.shape) // 2, 1.0
    best: tuple[float, NDArray[np.int64], float] = (0.0, np.array(total.shape) // 2, np.inf)
    places = int(enough.sum())
    for blur in _BLURS:
        shown = score
        if blur > 1:
            finite = np.where(np.isfinite(score), score, 0.0)
            shown = uniform_filter(finite, blur, mode="nearest")
            shown = np.where(np.isfinite(score), shown / max(float(shown[enough].std()), 1e-30), -np.inf)
        top = float(shown.max())
        chance = len(_BLURS) * places * float(np.exp(log_ndtr(-top)))
        if chance < best[2]:
            best = top, np.array(np.unravel_index(int(shown.argmax()), shown.shape)), chance
    return best[0], best[1], min(best[2], 1.0)


def _own_peaks(surfaces: NDArray[np.float32], place: NDArray[np.int64], near: int = 3) -> Array:
    """Highest place (N, 2) of each surface near the common one."""
    low = np.maximum(place - near, 0)
    part = surfaces[:, low[0] : place[0] + near + 1, low[1] : place[1] + near + 1]
    filled = np.where(np.isfinite(part), part, -np.inf).reshape(len(part), -1)
    best = filled.argmax(axis=1)
    own = low + np.stack(np.unravel_index(best, part.shape[1:]), axis=1).astype(np.float64)
    own[~np.isfinite(filled.max(axis=1))] = place
    return own


def learn_shifts(
    a: ImageSource,
    b: ImageSource,
    offset: tuple[float, float] = (0.0, 0.0),
    *,
    reach: float,
    inside: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> LearntShifts:
    """How b lies on a, from coarse to fine.

    Parameters
    ----------
    a, b, offset, reach
        As for `common_shift`; with `reach` 0 the offset is taken as known to `_FINE_SEARCH` px.
    inside : callable, optional
        Which points (N, 2) of a may be tried; all by default.

    Raises
    ------
    EstimationError
        If the windows share no shift, or too few are found at full resolution.
    """
    common = None
    if reach > 0.0:
        common = common_shift(a, b, offset, reach=reach)
        if not common.believed:
            raise EstimationError(
                f"the two images do not show the same within {reach:g} px of each other: the shift that most "
                f"windows share stands out by {common.strength:.1f} sigma, which images that have nothing in "
                f"common reach with a probability of {common.by_chance:.2g}; check that they belong "
                "together, or search further"
            )
        points, values, factor = common.points, common.values, common.factor
    else:
        points, factor = np.zeros((1, 2)), _STEP
        values = np.array([offset], dtype=np.float64)
    field = DisplacementField(points, values)
    found, tried = points, len(points)
    while factor > 1:
        factor = max(1, factor // _STEP)
        field, found, tried = _refined(a, b, field, factor, inside)
    left = (field.values - field.at(found))[field.weights > 0.0]
    spread = robust_sigmas(left, axis=0) if len(left) else np.full(2, float(_FINE_SEARCH))
    return LearntShifts(field, spread, common, int((field.weights > 0.0).sum()), tried)


def _refined(
    a: ImageSource,
    b: ImageSource,
    field: DisplacementField,
    factor: int,
    inside: Callable[[Array], NDArray[np.bool_]] | None,
) -> tuple[DisplacementField, Array, int]:
    """The field found anew on images reduced by less, its points, and how many windows were tried."""
    first, second = (one if factor == 1 else ReducedImage(one, factor) for one in (a, b))
    side = int(min(_FINE_WINDOW[0], max(8, (min(first.shape) - 2) // 2)))
    window = (side, side)
    points = grid_points(first.shape, window=window)
    if inside is not None:
        points = points[inside(whole_pixels(points, factor))]
    points = points[np.unique(np.linspace(0, max(len(points) - 1, 0), min(len(points), _MOST)).astype(int))]
    whole = whole_pixels(points, factor)
    start = reduced_pixels(whole + field.at(whole), factor)
    search = (_FINE_SEARCH, _FINE_SEARCH)
    found = match_images(
        first, second, points, start, window=window, search_px=search, whitening=gradient_filter()
    )
    kept = found.kept
    if kept.sum() < 4:
        raise EstimationError(
            f"{int(kept.sum())} of {len(points)} windows of {side} x {side} px were found in the second "
            "image; 4 are needed at least; check that the images show the same ground, without clouds, in "
            "bands that look alike"
        )
    values = whole_pixels(found.b[kept], factor) - whole[kept]
    return DisplacementField(whole[kept], values), whole[kept], len(points)
