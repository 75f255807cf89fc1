"""How well the bands of a cube lie on each other: pairs of near and of far wavelengths matched anew.

Not here: the matching of one pair (``band_fit.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.source import ImageSource
from sightline.products.band_fit import BandFit, fit_bands

Array = NDArray[np.float64]

#: Bands, evenly over the wavelengths, that are matched with their neighbours and with each other.
_POSTS = 6
#: Cells of the error map along its longer side.
_CELLS = 48


@dataclass(frozen=True, eq=False)
class PairFit:
    """Where one band lies against another.

    Attributes
    ----------
    fit : BandFit
    """

    fit: BandFit

    @property
    def bands(self) -> tuple[int, int]:
        """Their numbers."""
        return self.fit.images

    @property
    def rms_px(self) -> float:
        """px per axis; NaN: too little in common."""
        return float(np.sqrt(np.mean(np.square(self.fit.rms_px))))

    @property
    def noise_px(self) -> float:
        """px per axis; what the matches' own sigma makes of it."""
        return float(np.sqrt(np.mean(np.square(self.fit.noise_px))))

    @property
    def windows(self) -> int:
        """Windows kept."""
        return len(self.fit.points)


def pairs_of(wavelength_nm: Array) -> list[tuple[int, int]]:
    """Pairs of bands: neighbours at a few wavelengths over the range, and these few among each other."""
    order = np.argsort(wavelength_nm, kind="stable")
    last = len(order) - 1
    posts = np.unique(np.linspace(0, last, _POSTS).round().astype(int))
    pairs = {(int(p), int(p) + 1) if p < last else (last - 1, last) for p in posts if last > 0}
    pairs |= {(int(a), int(b)) for k, a in enumerate(posts) for b in posts[k + 1 :]}
    return [(int(order[a]), int(order[b])) for a, b in sorted(pairs, key=lambda p: (p[1] - p[0], p))]


def fit_pairs(
    bands: Sequence[ImageSource],
    wavelength_nm: Array,
    progress: Callable[[int, int], None] | None = None,
    *,
    search_px: tuple[int, int] = (6, 6),
) -> list[PairFit]:
    """Match bands with each other, nearest wavelengths first.

    Parameters
    ----------
    bands : sequence of ImageSource
        Of one map.
    wavelength_nm : (B,)
    progress : callable, optional
        Called with the pairs done, and all of them.
    search_px : (int, int)
        px; how far bands may lie off each other and still be matched.
    """
    if not len(bands):
        return []
    out, pairs = [], pairs_of(wavelength_nm)
    for a, b in pairs:
        out.append(PairFit(fit_bands(bands[a], bands[b], (a, b), search_px=search_px)))
        if progress is not None:
            progress(len(out), len(pairs))
    return out


def error_map(fits: Sequence[PairFit], shape: tuple[int, int]) -> Array:
    """px (h, w): rms per axis of the offsets of all pairs in each part of the map; NaN: nothing matched."""
    side = max(max(shape) / _CELLS, 1.0)
    size = tuple(int(np.ceil(n / side)) for n in shape)
    total, count = np.zeros(size), np.zeros(size)
    for pair in fits:
        if not pair.fit.known:
            continue
        cell = tuple(np.minimum((pair.fit.points / side).astype(int), np.array(size) - 1).T)
        np.add.at(total, cell, 0.5 * (pair.fit.offset_px**2).sum(axis=1))
        np.add.at(count, cell, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(total / count))
