"""An image at a coarser scale: means of blocks read window by window, or over a mosaic's pattern.

Not here: matching at several scales (``photogrammetry/match_frames.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.imaging.source import ArrayImage, ImageSource, read_padded

#: From lines (L,) and columns (C,) of a grid to places in an image, (L, C, 2).
Mapping = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class ReducedImage:
    """Means of `factor` x `factor` pixels of another image; lines and columns left over are cut off.

    Pixel (i, j) is centred at (i, j) * factor + (factor - 1) / 2 of the source, each axis by its own.

    Parameters
    ----------
    source : ImageSource
    factor : int or (int, int)
        Pixels per block along each side, or along lines and columns.

    Examples
    --------
    >>> from sightline.imaging.source import ArrayImage
    >>> ReducedImage(ArrayImage(np.arange(16.0).reshape(4, 4)), 2).read((0, 2), (0, 1)).tolist()
    [[2.5], [10.5]]
    """

    source: ImageSource
    factor: int | tuple[int, int]

    def __post_init__(self) -> None:
        """Check that one block fits."""
        (m, n), (lines, columns) = self._block, self.source.shape
        if not (1 <= m <= lines and 1 <= n <= columns):
            raise InputError(
                f"`factor` must be 1 to the sides of the image {self.source.shape}, got {self.factor}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns) of whole blocks."""
        return self.source.shape[0] // self._block[0], self.source.shape[1] // self._block[1]

    @property
    def _block(self) -> tuple[int, int]:
        return (self.factor, self.factor) if isinstance(self.factor, int) else self.factor

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Means of blocks, float32; NaN where a pixel of the block is. First and one past the last."""
        blocks = self._blocks(self.source.read(*self._window(lines, columns)))
        return np.ascontiguousarray(blocks.mean(axis=(1, 3), dtype=np.float64), dtype=np.float32)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Blocks that hold an unusable pixel, or None when the image has no mask."""
        unusable = self.source.mask(*self._window(lines, columns))
        return None if unusable is None else np.asarray(self._blocks(unusable).any(axis=(1, 3)))

    def _window(
        self, lines: tuple[int, int], columns: tuple[int, int]
    ) -> tuple[tuple[int, int], tuple[int, int]]:
        """The window of the source that holds a window of blocks."""
        m, n = self._block
        return (lines[0] * m, lines[1] * m), (columns[0] * n, columns[1] * n)

    def _blocks(self, pixels: NDArray[Any]) -> NDArray[Any]:
        return _in_blocks(pixels, self._block)


def _in_blocks(pixels: NDArray[Any], block: tuple[int, int]) -> NDArray[Any]:
    """Pixels as (lines, lines of a block, columns, columns of a block)."""
    m, n = block
    return pixels.reshape(pixels.shape[0] // m, m, pixels.shape[1] // n, n)


def reduced_pixels(pixels: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Places (N, 2) of an image in its means over squares of `factor` pixels a side."""
    return (pixels - 0.5 * (factor - 1)) / factor


def whole_pixels(pixels: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Places (N, 2) of means over squares in the image: the inverse of `reduced_pixels`."""
    return pixels * factor + 0.5 * (factor - 1)


def pattern_means(source: ImageSource, period: int) -> ArrayImage:
    """A frame behind a mosaic filter as means over its pattern, held in memory.

    Every cell of the pattern counts alike: did the brighter ones count for more, a mean would lie nearer to
    them, and on the other side where the frame is turned.

    Parameters
    ----------
    source : ImageSource
        Lines and columns left over are cut off.
    period : int
        px, side of the squares that show each cell equally often.
    """
    lines, columns = (side // period for side in source.shape)
    pixels, unusable = read_padded(source, (0, lines * period), (0, columns * period))
    cells = _in_blocks(pixels, (period, period))
    level = cells.mean(axis=(0, 2), keepdims=True, dtype=np.float64)
    usual = float(level.mean())
    # a cell that is dark on the whole shows nothing: it is not made a hundred times brighter
    gain = np.maximum(level / usual, 0.05) if usual > 0.0 else np.ones_like(level)
    means = np.asarray((cells / gain).mean(axis=(1, 3)), dtype=np.float32)
    if unusable is None:
        return ArrayImage(means)
    return ArrayImage(means, np.asarray(_in_blocks(unusable, (period, period)).any(axis=(1, 3))))


def averaged(
    laid: Callable[[Mapping, tuple[int, int]], ImageSource],
    mapping: Mapping,
    shape: tuple[int, int],
    parts: tuple[int, int],
) -> ImageSource:
    """An image laid on a grid of coarser pixels: means over `parts` (lines, columns) of each of them.

    Parameters
    ----------
    laid : callable
        Lays the image by a mapping on a grid of a shape.
    mapping : callable
        From the grid to the image.
    shape : (lines, columns)
        Of the grid.
    parts : (int, int)
        (1, 1) for pixels that are alike.

    Notes
    -----
    What lies between lines of the grid is mapped as exposed then: the mean is over pixel and exposure.
    """
    if parts == (1, 1):
        return laid(mapping, shape)
    m, n = parts

    def of_parts(lines: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
        return mapping((lines - 0.5 * (m - 1)) / m, (columns - 0.5 * (n - 1)) / n)

    return ReducedImage(laid(of_parts, (shape[0] * m, shape[1] * n)), parts)
