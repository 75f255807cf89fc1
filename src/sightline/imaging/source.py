"""Images read in windows: what every stage that needs pixels asks for.

Not the reading of files: the rasterio form of `ImageSource` is in `sightline.io`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError

__all__ = ["ArrayImage", "ImageSource", "MaskedImage", "read_padded"]


@runtime_checkable
class ImageSource(Protocol):
    """An image that is read window by window, so that no strip has to fit in memory."""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of lines and of columns."""
        ...

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column); the caller stays inside the image.

        Returns
        -------
        (lines, columns) float32, C order. NaN where there is no measurement.
        """
        ...

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window (True = do not use), or None when all are usable.

        Parameters
        ----------
        lines, columns : (int, int)
            As in `read`.
        """
        ...


@dataclass(frozen=True, eq=False)
class ArrayImage:
    """An image held in memory.

    Parameters
    ----------
    array : (lines, columns)
        Any real type; NaN means no measurement.
    unusable : (lines, columns) bool, optional
        True where a pixel must not be used.

    Raises
    ------
    InputError
        If the array is not two-dimensional and real, or the mask has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> ArrayImage(np.arange(12.0).reshape(3, 4)).read((1, 3), (0, 2)).tolist()
    [[4.0, 5.0], [8.0, 9.0]]
    """

    array: NDArray[np.generic]
    unusable: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        array = np.asarray(self.array)
        if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "fiub":
            raise InputError(
                f"image refused: `array` has shape {array.shape} and type {array.dtype}; "
                "a real array (lines, columns) with at least one pixel is needed; pass one band at a time"
            )
        object.__setattr__(self, "array", array)
        if self.unusable is not None:
            unusable = np.asarray(self.unusable)
            if unusable.shape != array.shape:
                raise InputError(
                    f"mask refused: `unusable` has shape {unusable.shape}, the image {array.shape}; "
                    "they must be the same; give one flag per pixel"
                )
            object.__setattr__(self, "unusable", unusable.astype(np.bool_, copy=False))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of lines and of columns."""
        return (int(self.array.shape[0]), int(self.array.shape[1]))

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window, float32, C order.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column).
        """
        return np.ascontiguousarray(self.array[slice(*lines), slice(*columns)], dtype=np.float32)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window, or None when the image has no mask.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column).
        """
        if self.unusable is None:
            return None
        return self.unusable[slice(*lines), slice(*columns)]


@dataclass(frozen=True, eq=False)
class MaskedImage:
    """An image with further pixels that must not be used.

    Parameters
    ----------
    source : ImageSource
    unusable : (lines, columns) bool
        True where a pixel must not be used, besides those that the source names.
    """

    source: ImageSource
    unusable: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of lines and of columns."""
        return self.source.shape

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window, as the source gives them.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column).
        """
        return self.source.read(lines, columns)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column).
        """
        own = self.source.mask(lines, columns)
        more = self.unusable[slice(*lines), slice(*columns)]
        return more if own is None else own | more


#: Values beyond are no light but no data that the file does not declare, as -3.4e38: their squares overflow.
LARGEST = np.float32(1e15)


def usable_lines(image: ImageSource, first: int, last: int) -> NDArray[np.float64]:
    """Whole lines [first, last) as float64; NaN where not to be used."""
    window = (first, last), (0, image.shape[1])
    values = image.read(*window).astype(np.float64)
    unusable = image.mask(*window)
    return values if unusable is None else np.where(unusable, np.nan, values)


def in_memory(image: ImageSource) -> ArrayImage:
    """An image read at once, with its mask: for what reads windows of it again and again."""
    whole = (0, image.shape[0]), (0, image.shape[1])
    return ArrayImage(image.read(*whole), image.mask(*whole))


def read_padded(
    image: ImageSource, lines: tuple[int, int], columns: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Pixels and unusable pixels of a window that may reach beyond the image.

    What lies outside is filled by reflection (so that filters stay quiet at the border) and is not
    flagged: whoever needs real pixels there checks positions. NaN becomes the mean of the window and is
    flagged.

    Parameters
    ----------
    image : ImageSource
    lines, columns : (int, int)
        First and one past the last line (column), possibly outside the image but meeting it.

    Returns
    -------
    pixels : (lines, columns) float32, finite; what is not, or beyond LARGEST, is filled and unusable
    unusable : (lines, columns) bool, or None when every pixel is usable
    """
    inside, pads = [], []
    for (first, last), size in zip((lines, columns), image.shape, strict=True):
        low, high = max(first, 0), min(last, size)
        if high <= low:
            raise InputError(
                f"window refused: it spans [{first}, {last}) of an image axis of {size} pixels; "
                "it must meet the image; crop the points first"
            )
        inside.append((low, high))
        pads.append((low - first, last - high))
    pixels = image.read(inside[0], inside[1])
    unusable = image.mask(inside[0], inside[1])
    finite = np.abs(pixels) <= LARGEST  # false for NaN too
    if not finite.all():
        unusable = ~finite if unusable is None else unusable | ~finite
        pixels = np.where(finite, pixels, np.float32(pixels[finite].mean() if finite.any() else 0.0))
    if any(a or b for a, b in pads):
        pixels = np.pad(pixels, pads, mode="symmetric")
        unusable = None if unusable is None else np.pad(unusable, pads, mode="symmetric")
    if unusable is not None and not unusable.any():
        unusable = None
    return np.ascontiguousarray(pixels, dtype=np.float32), unusable
