"""Writing files: whole or not at all, with errors that name them, and the date that stands in them.

Scratch files too, and arrays that lie in such.

Not here: the folder of a command's results (``output/``), what is written.
"""

from __future__ import annotations

import errno
import logging
import math
import mmap
import os
import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, BinaryIO
from weakref import WeakSet

from sightline.errors import InputError
from sightline.execution import size_words

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

#: Environment variables by which a user says where scratch files go.
_SCRATCH_VARIABLES = ("TMPDIR", "TEMP", "TMP")
#: Last second that a date of four digits for the year can hold.
_LAST_SECOND = 253402300799
#: How a PNG begins and ends; the version of a TIFF with offsets of 8 bytes.
_PNG, _BIG_TIFF = (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"), 43
#: Bytes in which a cloud-optimised TIFF says what more it holds; that each block is followed by four bytes.
_HEAD, _REPEATED = 1024, b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED"
#: Tags of offsets and lengths: of strips, of tiles; types of such numbers, as `struct` has them.
_BLOCK_PAIRS = ((273, 279), (324, 325))
_BLOCKS = {tag for pair in _BLOCK_PAIRS for tag in pair}
_WHOLE_NUMBERS = {3: "H", 4: "L", 16: "Q"}
#: How the raster library begins the line of its log that names an error.
_GDAL_ERROR = "GDAL signalled an error"
#: Bytes from which on an array of `scratch_array` lies in a file, and of zeros that are written at a time.
_IN_FILE, _ZEROS = 1 << 19, 1 << 20

_scratch: ContextVar[Path | None] = ContextVar("_scratch", default=None)
#: The scratch files that arrays lie in, made on any thread.
_mapped: WeakSet[mmap.mmap] = WeakSet()
_mapping = Lock()
#: Page faults of this process when pages of these last left its memory, and how many are waited for: one that
#: reads brings sixteen pages, so that 8 MiB may have come.
_faults, _PAGES = 0, 128


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A file that appears under its name complete or not at all.

    Parameters
    ----------
    path : Path
        The name; a file of this name is replaced when the block ends.

    Yields
    ------
    Path
        Where to write it, with the same suffix.

    Raises
    ------
    OSError
        If it cannot be written; carries `path`, also where the system's own error names no file.
    """
    draft = path.with_name(f".{path.name}.part{path.suffix}")
    with naming_file(path):
        try:
            # one that is a link must not lead elsewhere
            draft.unlink(missing_ok=True)
            yield draft
            os.replace(draft, path)
        finally:
            if draft.exists():
                draft.unlink()


def whole_text(path: Path, text: str) -> None:
    """Write a text (UTF-8) under its name complete or not at all; errors as of `whole`."""
    with whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


@contextmanager
def whole_raster(path: Path) -> Iterator[Path]:
    """As `whole`, for a raster that GDAL writes.

    What fails when GDAL closes a file, as on a full disk, raises nothing and leaves a file that lacks some of
    its blocks: it is found in the library's log, and in the file.

    Raises
    ------
    OSError
        If it cannot be written; carries `path`.
    """
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError

    with whole(path) as draft, _gdal_errors() as said:
        try:
            yield draft
        except (RasterioError, CPLE_BaseError, SystemError) as error:
            # the last is what the library raises where GDAL fails without a word
            words = "GDAL could not finish it" if isinstance(error, SystemError) else _first_line(error)
            words = said[0] if said else words
            raise OSError(errno.EIO, words, str(path)) from error
        if said or not is_complete(draft):
            words = said[0] if said else "the file was cut short"
            raise OSError(errno.EIO, words, str(path))


def is_complete(path: Path) -> bool:
    """Whether a TIFF holds every block that it lists, in all its images, and a PNG its end; others: True."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
        if head.startswith(_PNG[0]):
            file.seek(-len(_PNG[1]), os.SEEK_END)
            return file.read() == _PNG[1]
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        try:
            end = path.stat().st_size - 4 * (_REPEATED in head)
            return order is None or _has_all_blocks(file, order, end)
        except struct.error:  # it ends within a directory
            return False


def _has_all_blocks(file: BinaryIO, order: str, end: int) -> bool:
    """Whether all strips and tiles of every directory of a TIFF lie before an offset."""

    def read(form: str, at: int) -> tuple[int, ...]:
        file.seek(at)
        return struct.unpack(order + form, file.read(struct.calcsize(order + form)))

    big = read("H", 2)[0] == _BIG_TIFF
    number, count, entry = ("Q", "Q", 20) if big else ("L", "H", 12)
    at = read(number, 8 if big else 4)[0]
    met: set[int] = set()
    while at and at not in met:
        met.add(at)
        many = read(count, at)[0]
        first = at + struct.calcsize(order + count)
        blocks: dict[int, tuple[int, ...]] = {}
        for place in range(first, first + many * entry, entry):
            tag, kind, length = read(f"HH{number}", place)
            if tag in _BLOCKS and kind in _WHOLE_NUMBERS:
                form = f"{length}{_WHOLE_NUMBERS[kind]}"
                inside = place + 4 + struct.calcsize(order + number)
                fits = struct.calcsize(order + form) <= struct.calcsize(order + number)
                blocks[tag] = read(form, inside if fits else read(number, inside)[0])
        for offsets, lengths in _BLOCK_PAIRS:
            for offset, length in zip(blocks.get(offsets, ()), blocks.get(lengths, ()), strict=True):
                if offset == 0 or length == 0 or offset + length > end:
                    return False
        at = read(number, first + many * entry)[0]
    return bool(met)


@contextmanager
def _gdal_errors() -> Iterator[list[str]]:
    """What GDAL signals as errors during the block, raised or not."""
    said: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            words = record.getMessage()
            if record.levelno >= logging.ERROR or words.startswith(_GDAL_ERROR):
                said.append(words.partition("msg=")[2].strip("'\"") or words)

    logger, listener = logging.getLogger("rasterio"), Listener(logging.INFO)
    level = logger.level
    logger.addHandler(listener)
    if logger.getEffectiveLevel() > logging.INFO:
        logger.setLevel(logging.INFO)
    try:
        yield said
    finally:
        logger.removeHandler(listener)
        logger.setLevel(level)


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """What the system refuses in the block carries `path`: of a write that fails it names no file itself."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or _first_line(error)
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error


def must_fit(folder: Path, size: int, what: str, advice: str) -> None:
    """Refuse what the disk has no room for, before work goes into it.

    Parameters
    ----------
    folder : Path
        Exists; where it is to be written.
    size : int
        Bytes.
    what, advice : str
        Of the message: what needs the room, what could be done besides taking another folder.

    Raises
    ------
    InputError
    """
    free = shutil.disk_usage(folder).free
    if size > free:
        raise InputError(
            f"{final_folder(folder)}: {what} needs {size_words(size, 3)}, {size_words(free, 3)} are free; "
            f"{advice} or give another folder"
        )


def final_folder(folder: Path) -> Path:
    """The folder in which the files of one that is not yet published will lie."""
    parts = folder.parts
    staged = [k for k, part in enumerate(parts) if part.startswith(".partial-")]
    return Path(*parts[: staged[-1]], *parts[staged[-1] + 2 :]) if staged else folder


@contextmanager
def scratch_in(folder: Path) -> Iterator[None]:
    """Scratch files of the block go below `folder`, unless the user says where by TMPDIR."""
    before = _scratch.set(folder)
    try:
        yield
    finally:
        _scratch.reset(before)


def scratch_place() -> Path | None:
    """Where scratch files go: as `scratch_in` says; None, for the system's own place, where the user says."""
    chosen = any(os.environ.get(name) for name in _SCRATCH_VARIABLES)
    return None if chosen else _scratch.get()


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for scratch files, removed at the end; errors of the system without a file name name it."""
    with tempfile.TemporaryDirectory(prefix="sightline-", dir=scratch_place()) as folder:
        try:
            yield Path(folder)
        except OSError as error:
            if error.filename is not None:
                raise
            with naming_file(Path(folder)):
                raise


def scratch_array(shape: tuple[int, ...], dtype: DTypeLike = "float64") -> NDArray[Any]:
    """Zeros (`shape`) in memory or, where they are large, in the pages of a scratch file without name.

    The file lasts as long as the array or a view of it. What is read or written comes into memory, and stays
    there until `let_go`.
    """
    import numpy as np

    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < _IN_FILE:
        return np.zeros(shape, dtype)
    place = scratch_place()
    with naming_file(place or Path(tempfile.gettempdir())), tempfile.TemporaryFile(dir=place) as file:
        _reserve(file, size)
        mapped = mmap.mmap(file.fileno(), size)
    with _mapping:
        _mapped.add(mapped)
    return np.ndarray(shape, dtype, buffer=mapped)


def scratch_copy(array: NDArray[Any]) -> NDArray[Any]:
    """The same numbers in a scratch array."""
    out = scratch_array(array.shape, array.dtype)
    out[...] = array
    return out


def _reserve(file: BinaryIO, size: int) -> None:
    """Make a file of zeros that has its room: a disk that fills up under its pages would end the process."""
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file.fileno(), 0, size)
            return
        except OSError as error:  # a file system that cannot
            if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                raise
    for begin in range(0, size, _ZEROS):
        file.write(bytes(min(_ZEROS, size - begin)))
    file.flush()


def let_go() -> None:
    """Pages of scratch files leave the memory of this process; what they hold is read again when needed.

    Not before `_PAGES` faults of any kind: until then few can have come.
    """
    if hasattr(mmap, "MADV_DONTNEED"):
        import resource

        global _faults
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        if faults - _faults < _PAGES:
            return
        _faults = faults
        with _mapping:
            files = list(_mapped)
        for mapped in files:
            mapped.madvise(mmap.MADV_DONTNEED)


def creation_date() -> datetime:
    """UTC, whole seconds: now, or what SOURCE_DATE_EPOCH says, so that files can be made again bit for bit.

    Raises
    ------
    InputError
        If SOURCE_DATE_EPOCH is set to anything but whole seconds since 1970.
    """
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given is None:
        return datetime.now(UTC).replace(microsecond=0)
    # so many digits at most that a number of thousands of them is not even read
    seconds = int(given) if given.isascii() and given.isdigit() and len(given) < 20 else -1
    if not 0 <= seconds <= _LAST_SECOND:
        shown = given if len(given) <= 40 else f"{given[:40]}..."
        raise InputError(
            f"SOURCE_DATE_EPOCH is {shown!r}; whole seconds since 1970-01-01 UTC are expected, 0 to "
            f"{_LAST_SECOND}; correct it, or unset it to have the date of today"
        )
    return datetime.fromtimestamp(seconds, UTC)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(". ")
