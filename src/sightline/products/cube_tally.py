"""What is counted while the tiles of a cube are filled, and the picture of three of its bands.

Not here: filling them (``frame_cube.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.products.cube_kernels import count_seams
from sightline.products.frame_cube import FilledTile

Array = NDArray[np.float64]

#: nm; red, green and blue of the picture where nothing else is asked for.
_RGB_NM = (650.0, 550.0, 470.0)
#: px; largest side of the picture.
_PICTURE_PX = 1200


def picture_bands(layout: BandLayout, wanted: Sequence[float] | None = None) -> tuple[int, int, int]:
    """Bands for red, green and blue: nearest to the wavelengths wanted (nm).

    By default those of red, green and blue where they are seen, else three over the range.
    """
    nm = layout.wavelength_nm
    if np.isnan(nm).any() or len(nm) < 3:
        return (len(nm) - 1, (len(nm) - 1) // 2, 0)
    low, high = float(nm.min()), float(nm.max())
    if wanted is None:
        seen = low - 30.0 <= _RGB_NM[2] and _RGB_NM[0] <= high + 30.0
        wanted = _RGB_NM if seen else (high, 0.5 * (low + high), low)
    red, green, blue = (int(np.argmin(np.abs(nm - w))) for w in wanted)
    return red, green, blue


def picture_factor(shape: tuple[int, int]) -> int:
    """Pixels of a map (rows, columns) along each side of a pixel of its picture."""
    return max(1, -(-max(shape) // _PICTURE_PX))


def picture_grid(grid: CubeGrid) -> CubeGrid:
    """The map in pixels of its picture, halved where it is reduced: each is the mean of four."""
    factor = picture_factor(grid.shape)
    if factor < 4:
        return grid
    # an even number of rows and columns: the picture of this grid has the size of that one's
    rows, columns = (2 * -(-n // factor) for n in grid.shape)
    return CubeGrid(grid.system, grid.west, grid.north, 0.5 * factor * grid.gsd, (rows, columns))


class CubeTally:
    """What is counted while tiles are filled, and the picture."""

    def __init__(self, layout: BandLayout, grid: CubeGrid, rgb: Sequence[int]) -> None:
        self.layout, self.grid, self.rgb = layout, grid, tuple(rgb)
        count = len(layout)
        self.seen = self.passed = 0
        self.of_seen, self.of_passed, self.values, self.beyond = (np.zeros(count) for _ in range(4))
        self.seams = np.zeros((count, 4))
        self.total = np.zeros(count)
        self.used: set[int] = set()
        self.picture = CubePicture(grid, len(self.rgb))

    def add(self, filled: FilledTile) -> None:
        """Count a tile."""
        passed = filled.passed.all(axis=0)
        there = np.isfinite(filled.values)
        group = self.layout.group
        seen = ((filled.view >= 0) & ~filled.beyond).all(axis=0)
        self.passed += int(passed.sum())
        self.of_passed += (there & passed).sum(axis=(1, 2))
        self.seen += int(seen.sum())
        self.of_seen += (there & seen).sum(axis=(1, 2))
        self.values += there.sum(axis=(1, 2))
        self.beyond += [(filled.beyond[g] & t).sum() for g, t in zip(group, there, strict=True)]
        self.total += np.where(there, filled.values, np.float32(0.0)).sum(axis=(1, 2), dtype=np.float64)
        self.seams += seam_sums(filled, self.layout)
        self.used |= set(np.unique(filled.view).tolist()) - {-1}
        self.picture.add(filled, self.rgb)


class CubePicture:
    """Three bands, reduced."""

    def __init__(self, grid: CubeGrid, bands: int) -> None:
        self.factor = picture_factor(grid.shape)
        rows, columns = (-(-n // self.factor) for n in grid.shape) if bands else (0, 0)
        self._sum = np.zeros((bands, rows, columns))
        self._count = np.zeros((bands, rows, columns))

    def add(self, filled: FilledTile, bands: Sequence[int]) -> None:
        """Lay in a tile."""
        tile = filled.tile
        rows = (tile.row + np.arange(tile.rows)) // self.factor
        columns = (tile.column + np.arange(tile.columns)) // self.factor
        for n, band in enumerate(bands):
            pixels = filled.values[band]
            there = np.isfinite(pixels)
            np.add.at(self._sum[n], np.ix_(rows, columns), np.where(there, pixels, 0.0))
            np.add.at(self._count[n], np.ix_(rows, columns), there)

    def window(self) -> tuple[slice, slice]:
        """The part of the picture where all three bands have values; all of it where they never meet."""
        there = np.asarray((self._count > 0).all(axis=0)) & (self._count.size > 0)
        if not there.any():
            return slice(None), slice(None)
        rows, columns = (np.flatnonzero(np.any(there, axis=axis)) for axis in (1, 0))
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    def image(self, limits: Array | None = None) -> tuple[NDArray[np.uint8], Array]:
        """(h, w, 3) uint8 stretched between `limits` (3, 2), black where there is nothing, and the limits."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(self._count > 0, self._sum / self._count, np.nan)
        if limits is None:
            known = [band[np.isfinite(band)] for band in mean]
            limits = np.array([np.quantile(v, (0.01, 0.99)) if v.size else (0.0, 1.0) for v in known])
            limits = limits.reshape(-1, 2)
        low, high = limits[:, 0, None, None], limits[:, 1, None, None]
        scaled = np.clip((mean - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
        out = np.rint(1.0 + 254.0 * scaled)
        return np.moveaxis(np.where(np.isfinite(out), out, 0.0), 0, 2).astype(np.uint8), limits


def seam_sums(filled: FilledTile, layout: BandLayout) -> Array:
    """Of each band (B, 4): neighbours from one frame, their squared differences, from two frames, theirs."""
    out = np.zeros((len(layout), 4))
    for band, group in enumerate(layout.group):
        count_seams(filled.view[group], filled.values[band], out[band])
    return out
