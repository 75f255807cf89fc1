"""Where the pixels of a cube go while it is made.

Not here: files (``io/results/cube_files.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.source import ArrayImage, ImageSource
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid

Array32 = NDArray[np.float32]


class CubeStore(Protocol):
    """Where a cube is written, tile by tile."""

    def begin(self, grid: CubeGrid, layout: BandLayout) -> None:
        """Make room for all bands."""
        ...

    def write(self, row: int, column: int, values: Array32) -> None:
        """Pixels (B, rows, columns) of a tile that begins at (row, column)."""
        ...

    def source(self, band: int) -> ImageSource:
        """A band as it was written."""
        ...


@dataclass(eq=False)
class MemoryStore:
    """A cube held in memory.

    Attributes
    ----------
    values : (B, rows, columns) float32
    """

    values: Array32 = field(default_factory=lambda: np.empty((0, 0, 0), np.float32))

    def begin(self, grid: CubeGrid, layout: BandLayout) -> None:
        """Make room for all bands."""
        self.values = np.full((len(layout), *grid.shape), np.nan, dtype=np.float32)

    def write(self, row: int, column: int, values: Array32) -> None:
        """Pixels (B, rows, columns) of a tile that begins at (row, column)."""
        self.values[:, row : row + values.shape[1], column : column + values.shape[2]] = values

    def source(self, band: int) -> ImageSource:
        """A band as it was written."""
        return ArrayImage(self.values[band])
