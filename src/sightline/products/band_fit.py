"""How well bands lie on each other: matched again, on windows that the estimate of the motion never saw.

Not here: laying them on each other (``register_bands.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.reduce import ReducedImage, whole_pixels
from sightline.imaging.source import ImageSource
from sightline.matching.match_images import match_images
from sightline.matching.matches import MASKED, OUTSIDE
from sightline.matching.whitening import pair_whitening

Array = NDArray[np.float64]

#: (lines, columns) px of the windows, unlike those of the recovery, and how many there are at most.
WINDOW, MOST_WINDOWS = (16, 48), 3000
#: Rounds in which windows that lie where most do, and false ones that lie anywhere, are told apart.
_ROUNDS = 30
#: Windows, about, among which their place is sought first.
_ASKED = 300
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
    whitening = pair_whitening(a, b, points)
    found = match_images(a, b, points, points, window=window, search_px=search_px, whitening=whitening)
    offset = found.b - found.a
    kept = found.kept.copy()
    kept[kept] = lie_together(offset[kept], found.sigma_px[kept], search_px)
    tried = int((~np.isin(found.status, (OUTSIDE, MASKED))).sum())
    return BandFit(images, found.a[kept], offset[kept], found.sigma_px[kept], tried)


def lie_together(offset: Array, sigma: Array, search_px: tuple[int, int]) -> NDArray[np.bool_]:
    """Which windows show where the second image lies; the others are false matches.

    A window without common detail is found anywhere within the search, each place as likely as the next; the
    true ones lie about one place. Which share is true, where that is and how far they scatter is estimated
    from all of them (a normal density beside an even one, by expectation and maximisation). Bands of little
    in common have more false windows than true ones: the median of all then means nothing.

    Parameters
    ----------
    offset, sigma : (N, 2)
        px.
    search_px : (lines, columns)
        px; half-range of the search.

    Returns
    -------
    (N,) bool
        Those that are more likely true than false.
    """
    if len(offset) < 3:
        return np.ones(len(offset), dtype=bool)
    reach = np.array(search_px) + 1.0
    # begin at the window that has the nearest neighbours, a quarter of those asked
    asked = offset[:: 1 + len(offset) // _ASKED]
    apart = np.sort(np.linalg.norm((asked[:, None] - asked[None]) / reach, axis=2), axis=1)
    near = apart[:, max(len(asked) // 4, 1)]
    middle, variance = asked[np.argmin(near)], np.full(2, 1e-6) + (near.min() * reach) ** 2
    true, anywhere = 0.5, 1.0 / np.prod(2.0 * reach)
    for _ in range(_ROUNDS):
        total = variance + sigma**2
        away = offset - middle
        density = np.exp(-0.5 * (away**2 / total).sum(axis=1)) / (2.0 * np.pi * np.sqrt(total.prod(axis=1)))
        share = true * density / (true * density + (1.0 - true) * anywhere)
        true = min(max(float(share.mean()), 0.01), 0.99)
        weight = share[:, None] / total
        middle = (weight * offset).sum(axis=0) / weight.sum(axis=0)
        # what each scatters beyond its own error: its expectation, and how far it may lie from that
        gain = variance / total
        scatter = (gain * away) ** 2 + gain * sigma**2
        variance = 1e-6 + (share[:, None] * scatter).sum(axis=0) / share.sum()
    return np.asarray(share > 0.5)
