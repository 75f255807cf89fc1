"""Some lines of an image as an image of their own: the filters of one chip, read out as one frame.

Not here: the frame itself (``source.py``, ``io/formats/images.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.imaging.source import ImageSource


@dataclass(frozen=True, eq=False)
class ImageLines:
    """Lines `first` to `first + lines - 1` of another image.

    Parameters
    ----------
    source : ImageSource
    first : int
        First line.
    lines : int
        How many.

    Examples
    --------
    >>> from sightline.imaging.source import ArrayImage
    >>> whole = ArrayImage(np.arange(12.0).reshape(6, 2))
    >>> ImageLines(whole, 2, 3).read((0, 1), (0, 2)).tolist()
    [[4.0, 5.0]]
    """

    source: ImageSource
    first: int
    lines: int

    def __post_init__(self) -> None:
        """Check that the lines are there."""
        last = self.first + self.lines
        if self.first < 0 or self.lines < 1 or last > self.source.shape[0]:
            raise InputError(
                f"lines [{self.first}, {last}) do not lie in an image of {self.source.shape[0]} lines; "
                "give the first line and the number of lines of the part"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns)."""
        return self.lines, self.source.shape[1]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window: first and one past the last line (column), counted in the part."""
        return self.source.read((lines[0] + self.first, lines[1] + self.first), columns)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window, or None when the image has no mask."""
        return self.source.mask((lines[0] + self.first, lines[1] + self.first), columns)
