"""MTF of an image from an edge that crosses its pixels at a slant, with a 1-sigma.

After ISO 12233: rows that cross the edge at different fractions of a pixel are laid over one another into an
edge profile finer than the pixels; its derivative is the line spread, whose Fourier transform is the MTF.

Unlike ISO 12233, the window is flat over the line spread, the means over bins are undone, and frequencies
are those of the rows, not of the edge's normal: an edge turned by `angle` shows (f, f tan(angle)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]

#: Bins per pixel of the edge profile.
OVERSAMPLING = 4
#: Pixels beyond this share of the profile's half width lie on the flats, whence noise and levels.
FLAT_SHARE = 0.65
#: Least half width of the profile, pixels.
LEAST_HALF_WIDTH = 5.0


@dataclass(frozen=True, eq=False)
class EdgeMtf:
    """MTF along the rows of a patch with a slanted edge.

    Attributes
    ----------
    frequency : (F,)
        Cycles per pixel.
    mtf, sigma : (F,)
        MTF, and its 1-sigma by the noise of the flats on both sides.
    angle : float
        rad of the edge to the columns of the patch: later rows meet it at smaller columns where positive.
    """

    frequency: Array
    mtf: Array
    sigma: Array
    angle: float


def slanted_edge_mtf(patch: ArrayLike, frequency: ArrayLike) -> EdgeMtf:
    """MTF along the rows of `patch`; give the transpose for that along its columns.

    Parameters
    ----------
    patch : (rows, columns)
        One edge, near the middle, some degrees from the columns; flat on both sides of it.
    frequency : array_like
        Cycles per pixel, above 0.

    Raises
    ------
    InputError
        No edge, one that leaves less than 5 px on a side, or one that is not slanted enough for bins of a
        quarter of a pixel to be filled.
    """
    pixels = np.asarray(patch, dtype=np.float64)
    f = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    place, slope = _edge_line(pixels)
    rows, columns = pixels.shape
    crossing = place + slope * np.arange(rows)
    half = min(float(crossing.min()), columns - 1.0 - float(crossing.max())) - 0.5
    if not half >= LEAST_HALF_WIDTH:
        raise InputError(
            f"the edge leaves {half:.3g} px beside it; {LEAST_HALF_WIDTH:g} px of flat image are needed"
        )
    whole = np.floor(abs(slope) * rows)
    if whole < 1.0:
        raise InputError(
            f"the edge moves by {abs(slope) * rows:.2g} px over the patch; 1 px or more is needed"
        )
    # rows that cross whole pixels meet the edge at all fractions of a pixel alike
    kept = round(float(whole) / abs(slope))
    pixels, crossing = pixels[:kept], crossing[:kept]
    distance = np.arange(columns) - crossing[:, None]
    bins = np.floor((distance + half) * OVERSAMPLING).astype(np.intp)
    count = int(2.0 * half * OVERSAMPLING)
    inside = (bins >= 0) & (bins < count)
    filled = np.bincount(bins[inside], minlength=count)
    profile = np.bincount(bins[inside], weights=pixels[inside], minlength=count) / np.maximum(filled, 1)
    if not filled.all():
        raise InputError(
            "the edge leaves bins of a quarter of a pixel empty; give more rows or another slant"
        )
    # pixels do not fill a bin evenly: its mean is carried from their mean place to its middle
    middle = np.bincount(bins[inside], weights=distance[inside], minlength=count) / filled
    off = (np.arange(count) + 0.5) / OVERSAMPLING - half - middle
    profile += np.gradient(profile) * OVERSAMPLING * off
    variance = _noise(pixels, distance, half, profile) / filled
    return EdgeMtf(f, *_transform(profile, variance, f), angle=float(np.arctan(-slope)))


def _edge_line(pixels: Array) -> tuple[float, float]:
    """Column at which row 0 meets the edge, and columns per row."""
    rows, columns = pixels.shape
    if rows < 4 or columns < 2 * LEAST_HALF_WIDTH:
        raise InputError(f"a patch of {rows} x {columns} px is too small for an edge")
    left, right = (float(np.median(pixels[:, part])) for part in (slice(0, 3), slice(-3, None)))
    noise = 1.5 * float(np.median(np.abs(pixels[:, :3] - left)))
    if not abs(right - left) > 5.0 * noise:
        raise InputError(f"no edge: the sides differ by {abs(right - left):.3g}, with a noise of {noise:.3g}")
    # a row holds as much of the right level as it lies right of the edge, whatever the blur
    crossing = columns - 0.5 - ((pixels - left) / (right - left)).sum(axis=1)
    slope, place = np.polyfit(np.arange(rows), crossing, 1)
    return float(place), float(slope)


def _noise(pixels: Array, distance: Array, half: float, profile: Array) -> Array:
    """Variance of a pixel in every bin: that of the flats, between them by level."""
    low, high = (
        pixels[(side * distance > FLAT_SHARE * half) & (side * distance < half)] for side in (-1.0, 1.0)
    )
    share = np.clip((profile - low.mean()) / (high.mean() - low.mean()), 0.0, 1.0)
    return np.asarray(low.var() + share * (high.var() - low.var()))


def _transform(profile: Array, variance: Array, frequency: Array) -> tuple[Array, Array]:
    """MTF and its sigma at `frequency` from the means of bins and their variances."""
    from scipy.signal.windows import tukey

    steps = len(profile) - 1
    window = tukey(steps + 2)[1:-1]
    wave = window * np.exp(-2j * np.pi * frequency[:, None] * np.arange(steps) / OVERSAMPLING)
    # the transform as weights of the bins: differences of neighbours, summed by parts
    weights = np.zeros((len(frequency), steps + 1), dtype=np.complex128)
    weights[:, 1:] += wave
    weights[:, :-1] -= wave
    whole = np.zeros(steps + 1)
    whole[1:] += window
    whole[:-1] -= window
    step = float(whole @ profile)
    found = weights @ profile / step
    # a difference over a bin and a mean over it, both undone
    undone = np.sinc(frequency / OVERSAMPLING) ** 2
    size = np.abs(found)
    direction = np.conj(found / np.maximum(size, 1e-300))[:, None]
    by_bin = (direction * (weights - found[:, None] * whole)).real / step
    return size / undone, np.sqrt(by_bin**2 @ variance) / undone
