"""Image files of a sequence as sources that are opened when they are read, a few at a time.

Not here: the reading of pixels (``io/formats/images.py``), which files there are (``frames.py``).
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.access import Access, current_access, using
from sightline.errors import FormatError
from sightline.execution import thread_count
from sightline.io.formats.images import RasterImage, Source, check_content, open_image

#: Files kept open at a time: those that are matched with one another, and those that show one row of a map's
#: tiles. Each thread has handles of its own: no more than half of those that a process may hold.
_KEPT = 192
_opened: OrderedDict[tuple[Path, int | str, int, Access], Source] = OrderedDict()
_opening = threading.Lock()


def opened(path: Path, band: int | str, access: Access | None = None) -> Source:
    """The source of a file, opened unless it was read a short while ago."""
    access = current_access() if access is None else access
    # a file that was written anew is another one
    key = path, band, path.stat().st_mtime_ns if path.exists() else 0, access
    with _opening:
        source = _opened.get(key)
        if source is None:
            with using(access):
                source = _opened[key] = open_image(path, band)
            while len(_opened) > _kept():
                _opened.popitem(last=False)
        _opened.move_to_end(key)
    return source


def _kept() -> int:
    """How many files are kept open."""
    try:
        import resource
    except ImportError:  # not a Unix system
        return _KEPT
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _KEPT if most == resource.RLIM_INFINITY else min(_KEPT, max(most // (2 * thread_count() + 2), 1))


@dataclass(frozen=True)
class FrameFile:
    """One frame of a sequence: an `ImageSource` without an open file.

    Attributes
    ----------
    path : Path
    shape : (lines, columns)
        As the camera has it; a file of another shape is not read.
    band : int or "luminance"
        From 1, or the mean of all.
    access : Access
        What the file may refer to: that of where it was named.
    """

    path: Path
    shape: tuple[int, int]
    band: int | str = 1
    access: Access = field(default_factory=current_access, repr=False, compare=False)

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of lines [first, last) and columns [first, last), float32, C order."""
        return opened(self.path, self.band, self.access).read(lines, columns)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """True where a pixel is not to be used; None if all are good."""
        return opened(self.path, self.band, self.access).mask(lines, columns)


@dataclass(frozen=True)
class Probe:
    """What a look into a file gave.

    Attributes
    ----------
    shape : (lines, columns) or None
        None where it cannot be read.
    bands : int
        Of the image.
    reason : str
        Why it cannot be used; "" where it can.
    """

    shape: tuple[int, int] | None
    bands: int
    reason: str


def reason_of(path: Path, error: FormatError) -> str:
    """Why a frame is left out, without its path and what to do."""
    return str(error).removeprefix(f"{path}: ").split("; ")[0]


def probe(path: Path) -> Probe:
    """Open a file, look at its first, middle and last lines, and close it."""
    shape, bands = None, 0
    try:
        source = open_image(path, "luminance")
        shape, bands = source.shape, source.bands if isinstance(source, RasterImage) else 1
        check_content(source)
    except FormatError as error:
        return Probe(shape, bands, reason_of(path, error))
    return Probe(shape, bands, "")
