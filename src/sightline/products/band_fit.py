"""How well bands lie on each other: matched again, on windows that the estimate of the motion never saw.

Not here: laying them on each other (``register_bands.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigmas
from sightline.imaging.reduce import ReducedImage, whole_pixels
from sightline.imaging.source import ImageSource
from sightline.matching.match_images import match_images
from sightline.matching.matches import MASKED, OUTSIDE
from sightline.matching.whitening import estimate_whitening

Array = NDArray[np.float64]

#: (lines, columns) px of the windows, unlike those of the recovery, and how many there are at most.
WINDOW, MOST_WINDOWS = (16, 48), 3000
#: Windows this many robust sigmas from the median are false matches.
OUTLYING = 5.0
#: Fewer windows kept than this, or a smaller share of those tried, say nothing: so many false matches pass.
_FEWEST, _FEWEST_SHARE = 20, 0.02


@dataclass(frozen=True, eq=False)
class BandFit:
    """Where one band lies against another, window by window.

    Attributes
    ----------
    images : (int, int)
    points : (N, 2)
        px; centres of the windows kept, (line, column).
    offset_px : (N, 2)
        px; where the second image shows them, less where the first does.
    sigma_px : (N, 2)
        px; of the match.
    tried : int
        Windows on which both images have values.
    """

    images: tuple[int, int]
    points: Array
    offset_px: Array
    sigma_px: Array
    tried: int

    @property
    def known(self) -> bool:
        """Whether enough windows were kept to say how well the two fit."""
        return len(self.points) >= max(_FEWEST, _FEWEST_SHARE * self.tried)

    @property
    def rms_px(self) -> tuple[float, float]:
        """px, of lines and of columns; NaN where too few windows were kept."""
        if not self.known:
            return math.nan, math.nan
        return _two(np.sqrt((self.offset_px**2).mean(axis=0)))

    @property
    def noise_px(self) -> tuple[float, float]:
        """px; what the matches' own sigma makes of it."""
        if not self.known:
            return math.nan, math.nan
        return _two(np.sqrt((self.sigma_px**2).mean(axis=0)))

    @property
    def mean_px(self) -> tuple[float, float]:
        """px; mean offset."""
        if not self.known:
            return math.nan, math.nan
        return _two(self.offset_px.mean(axis=0))


def _two(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def fit_points(shape: tuple[int, int], window: tuple[int, int] = WINDOW, most: int = MOST_WINDOWS) -> Array:
    """Centres (N, 2) px of windows spread over an image, at most about `most` of them."""
    room = np.array(shape) - np.array(window) - 4
    if (room < 0).any():
        return np.empty((0, 2))
    across = max(1, min(int(room[1] // window[1]) + 1, int(math.sqrt(most))))
    down = max(1, min(int(room[0] // window[0]) + 1, most // across))
    half = 0.5 * (np.array(window) - 1)
    lines = 2 + half[0] + np.floor(np.linspace(0.0, room[0], down))
    columns = 2 + half[1] + np.floor(np.linspace(0.0, room[1], across))
    return np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)


def fit_bands(
    a: ImageSource,
    b: ImageSource,
    images: tuple[int, int],
    *,
    search_px: tuple[int, int] = (8, 8),
    factor: int = 1,
    window: tuple[int, int] = WINDOW,
) -> BandFit:
    """Match two images of one grid with each other, window by window, and drop false matches.

    Parameters
    ----------
    a, b : ImageSource
        Of one shape.
    images : (int, int)
        Their numbers, for the result.
    search_px : (lines, columns)
        px; half-range of the search about no offset.
    factor : int
        Where a pixel of either band fills so many of the grid along each side, means over these are matched:
        between them there is no detail to compare.
    window : (lines, columns)
        px, of means where these are matched: half of it.
    """
    if factor > 1:
        coarse = fit_bands(
            ReducedImage(a, factor),
            ReducedImage(b, factor),
            images,
            search_px=(-(-search_px[0] // factor), -(-search_px[1] // factor)),
            window=(window[0] // 2, window[1] // 2),
        )
        points, offset, sigma = coarse.points, factor * coarse.offset_px, factor * coarse.sigma_px
        return replace(coarse, points=whole_pixels(points, factor), offset_px=offset, sigma_px=sigma)
    points = fit_points((min(a.shape[0], b.shape[0]), min(a.shape[1], b.shape[1])), window)
    empty = np.empty((0, 2))
    if not len(points):
        return BandFit(images, empty, empty, empty, 0)
    try:
        whitening = estimate_whitening(a, b, points, points)
    except EstimationError:
        whitening = None
    found = match_images(a, b, points, points, window=window, search_px=search_px, whitening=whitening)
    offset = found.b - found.a
    kept = found.kept
    if kept.any():
        middle = np.median(offset[kept], axis=0)
        spread = robust_sigmas(offset[kept] - middle, axis=0) + 1e-6
        kept = kept & (np.abs(np.nan_to_num(offset) - middle) <= OUTLYING * spread).all(axis=1)
    tried = int((~np.isin(found.status, (OUTSIDE, MASKED))).sum())
    return BandFit(images, found.a[kept], offset[kept], found.sigma_px[kept], tried)
