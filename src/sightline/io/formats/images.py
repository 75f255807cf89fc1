"""Rasters and .npy files as image sources, read in windows.

Not here: the ``ImageSource`` protocol (``imaging/source.py``), elevation rasters (``dem.py``).
"""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import check_file, current_access
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.imaging.placed import PlacedImage
from sightline.imaging.rasters import open_raster, raster_environment, raster_errors
from sightline.matching.match_images import MAX_MASKED
from sightline.result import one_line

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Pixels of a line, of all bands together, beyond which a header is damaged: no detector has as many.
MOST_COLUMNS = 1 << 24
#: Lines read in each of the probes of `check_content`.
PROBE_LINES = 16
#: Share of pixels at the largest value met from which an image counts as saturated, whatever its bits.
SATURATED_SHARE = 0.5
#: Share of pixels at the smallest value met from which an image counts as empty.
EMPTY_SHARE = 0.9
#: Values from which on an image is refused: sums of their squares over windows, in float32, overflow.
LARGEST = 1e15


def _as_image(pixels: NDArray[Any]) -> Image:
    """Pixels as float32, C order; what is too large for it is infinite, and masked, as NaN of any kind is."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.ascontiguousarray(pixels, dtype=np.float32)


class RasterImage:
    """One band of a raster file (any GDAL format), read in windows.

    Parameters
    ----------
    path : Path
        The file.
    band : int or "luminance"
        Which band, from 1; ``"luminance"`` is the mean of all.
    mask : RasterImage, NpyImage or None
        Another source of the same shape whose non-zero pixels are not to be used.

    Attributes
    ----------
    has_mask : bool
        Whether something else than `nodata` says which pixels are not to be used.
    nodata : float or None
        Value of pixels that hold nothing.
    description : str or None
        What the file calls the band.

    Notes
    -----
    One dataset handle per thread, because GDAL handles must not be shared; an image that travels to
    another process opens the file there again.
    """

    def __repr__(self) -> str:
        """One line."""
        lines, columns = self.shape
        return one_line(type(self).__name__, {"": self.path.name, "px": f"{lines} x {columns}"})

    def __init__(self, path: Path, band: int | str = 1, mask: RasterImage | NpyImage | None = None) -> None:
        """Open the file once to learn its shape."""
        self.path = Path(path)
        self._band = band
        self._extra_mask = mask
        self.access = current_access()
        self._local = threading.local()
        dataset = self._dataset()
        self.count: int = dataset.count
        count = self.count
        if isinstance(band, int) and not 1 <= band <= count:
            raise FormatError(
                f"{self.path}: band {band} is asked for; the file has {count}; choose 1 to {count}"
            )
        self._bands = list(range(1, count + 1)) if band == "luminance" else [int(band)]
        self._type = np.dtype(dataset.dtypes[self._bands[0] - 1])
        if self._type.kind not in "uif":
            raise FormatError(f"{self.path}: pixels are of type {self._type}; real numbers are expected")
        self._shape = (int(dataset.height), int(dataset.width))
        self._alone = dataset.driver == "GTiff" and not self.access.network
        _refuse_wide(self.path, self._shape, len(self._bands))
        flags = [{flag.name for flag in dataset.mask_flag_enums[k - 1]} for k in self._bands]
        self._all_valid = all("all_valid" in one for one in flags)
        self.has_mask: bool = mask is not None or any("per_dataset" in one for one in flags)
        self.nodata: float | None = dataset.nodatavals[self._bands[0] - 1]
        self.description: str | None = dataset.descriptions[self._bands[0] - 1]
        if mask is not None:
            _same_shape(self.path, self._shape, mask)

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the open handles, so that the image can be sent to another process."""
        state = dict(self.__dict__)
        del state["_local"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Handles are opened again where they are needed."""
        self.__dict__.update(state)
        self._local = threading.local()

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns)."""
        return self._shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of its pixels in the file."""
        return self._type

    @property
    def words(self) -> str:
        """``red.tif: band 1 of 3, uint8``."""
        which = "mean of" if self._band == "luminance" else f"band {self._band} of"
        return f"{self.path.name}: {which} {self.count}, {self._type}"

    @property
    def band(self) -> int | str:
        """Number of the band that is read, from 1, or "luminance"."""
        return self._band

    @property
    def bands(self) -> int:
        """How many bands of the file are read."""
        return len(self._bands)

    def _dataset(self) -> Any:
        """The handle of this thread."""
        dataset = getattr(self._local, "dataset", None)
        if dataset is None:
            dataset = open_raster(self.path, self.access)
            self._local.dataset = dataset
        return dataset

    def _environment(self) -> AbstractContextManager[None]:
        """What GDAL may do while it reads pixels: a local TIFF holds them all, and needs no word for it."""
        return nullcontext() if self._alone else raster_environment(self.access)

    def _window(
        self, lines: tuple[int, int], columns: tuple[int, int]
    ) -> tuple[tuple[int, int], tuple[int, int]]:
        """The window as rasterio takes it; InputError outside the image."""
        _check_window(self.path, self._shape, lines, columns)
        return lines, columns

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Image:
        """Pixels of lines [first, last) and columns [first, last), float32, C order."""
        window = self._window(lines, columns)
        with raster_errors(self.path), self._environment():
            if len(self._bands) == 1:
                data = self._dataset().read(self._bands[0], window=window)
            else:
                data = self._dataset().read(self._bands, window=window).mean(axis=0, dtype=np.float32)
        return _as_image(data)

    def read_stored(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[Any]:
        """The same pixels as the file holds them, of type `dtype`; of the first of several bands."""
        window = self._window(lines, columns)
        with raster_errors(self.path), self._environment():
            pixels: NDArray[Any] = self._dataset().read(self._bands[0], window=window)
        return pixels

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> Mask | None:
        """True where a pixel is not to be used (no data, NaN, masked); None if all are good."""
        bad: Mask | None = None
        if not self._all_valid:
            window = self._window(lines, columns)
            with raster_errors(self.path), raster_environment(self.access):
                bad = (self._dataset().read_masks(self._bands, window=window) == 0).any(axis=0)
        if self._type.kind == "f":
            gaps = ~np.isfinite(self.read(lines, columns))
            bad = gaps if bad is None else bad | gaps
        return _with_extra(bad, self._extra_mask, lines, columns)


class NpyImage:
    """A two-dimensional .npy file, mapped into memory and read in windows.

    Parameters
    ----------
    path : Path
        The file, (lines, columns).
    mask : RasterImage, NpyImage or None
        Another source of the same shape whose non-zero pixels are not to be used.
    """

    def __repr__(self) -> str:
        """One line."""
        lines, columns = self.shape
        return one_line(type(self).__name__, {"": self.path.name, "px": f"{lines} x {columns}"})

    def __init__(self, path: Path, mask: RasterImage | NpyImage | None = None) -> None:
        """Map the file once to learn its shape."""
        self.path = Path(path)
        self._extra_mask = mask
        self._array = self._map()
        _refuse_wide(self.path, self.shape)
        if mask is not None:
            _same_shape(self.path, self.shape, mask)

    def _map(self) -> NDArray[Any]:
        """The memory map, checked."""
        check_file(self.path)
        advice = "it is truncated, damaged, or holds Python objects in place of numbers; make it again"
        with foreign_errors(self.path, "cannot be read as .npy", advice):
            array: Any = np.load(self.path, mmap_mode="r", allow_pickle=False)
            if not isinstance(array, np.memmap):
                raise FormatError(
                    f"{self.path}: is an archive of arrays (.npz); save one image with numpy.save"
                )
        if array.ndim != 2 or array.dtype.kind not in "uifb":
            raise FormatError(
                f"{self.path}: holds an array of shape {array.shape} and type {array.dtype}; "
                "an image is (lines, columns) of real numbers"
            )
        # of the file, as far as it is mapped
        self._size = array.offset + array.nbytes
        return np.asarray(array)

    def __getstate__(self) -> dict[str, Any]:
        """The path, not the pixels, travels to another process."""
        state = dict(self.__dict__)
        del state["_array"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Map the file again."""
        self.__dict__.update(state)
        self._array = self._map()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of its pixels in the file."""
        return self._array.dtype

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns)."""
        return int(self._array.shape[0]), int(self._array.shape[1])

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Image:
        """Pixels of lines [first, last) and columns [first, last), float32, C order."""
        _check_window(self.path, self.shape, lines, columns)
        self._refuse_cut()
        return _as_image(self._array[slice(*lines), slice(*columns)])

    def _refuse_cut(self) -> None:
        """FormatError if the file has become shorter: the system would end a process that reads there."""
        try:
            left = self.path.stat().st_size
        except OSError:
            return  # removed: what is mapped stays
        if left < self._size:
            raise FormatError(
                f"{self.path}: was cut to {left} bytes while it was read, {self._size} are expected; run the "
                "same command again once the file stays as it is"
            )

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> Mask | None:
        """True where a pixel is not to be used (NaN, masked); None if all are good."""
        bad = ~np.isfinite(self.read(lines, columns)) if self._array.dtype.kind == "f" else None
        return _with_extra(bad, self._extra_mask, lines, columns)


@dataclass(frozen=True)
class MissingImage:
    """An image that is not there: its geometry is described, its pixels cannot be read.

    Attributes
    ----------
    path : Path
        Where it would lie.
    shape : (lines, columns)
        Taken from what else is known.
    """

    path: Path
    shape: tuple[int, int]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of pixels as they are read."""
        return np.dtype(np.float32)

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Image:
        """FormatError: there is no such file."""
        raise FormatError(f"{self.path}: no such file; check the name")

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> Mask | None:
        """None."""
        return None


#: What `open_image` gives, and what stands for it where there is no file.
Source = RasterImage | NpyImage | MissingImage


def _refuse_wide(path: Path, shape: tuple[int, int], bands: int = 1) -> None:
    """FormatError of a size that no image has: pixels are read by whole lines."""
    if min(shape) < 1 or shape[1] * bands > MOST_COLUMNS:
        raise FormatError(
            f"{path}: claims {shape[0]} lines x {shape[1]} columns, {bands} of them; lines of 1 to "
            f"{MOST_COLUMNS:,} pixels are read; is the header damaged?"
        )


def _check_window(
    path: Path, shape: tuple[int, int], lines: tuple[int, int], columns: tuple[int, int]
) -> None:
    """InputError unless 0 <= first < last <= size on both axes."""
    for name, (first, last), size in (("lines", lines, shape[0]), ("columns", columns, shape[1])):
        if not 0 <= first < last <= size:
            raise InputError(f"{path}: {name} {first} to {last} are asked for; the image has 0 to {size}")


def _same_shape(path: Path, shape: tuple[int, int], mask: RasterImage | NpyImage) -> None:
    """A mask must have the shape of its image."""
    if mask.shape != shape:
        raise FormatError(
            f"{mask.path}: the mask is {mask.shape[0]} lines x {mask.shape[1]} columns, "
            f"its image {path.name} {shape[0]} x {shape[1]}; they must agree"
        )


def _with_extra(
    bad: Mask | None, extra: RasterImage | NpyImage | None, lines: tuple[int, int], columns: tuple[int, int]
) -> Mask | None:
    """Own unusable pixels joined with those of the mask image; None if there are none."""
    if extra is not None:
        masked = extra.read(lines, columns) != 0.0
        bad = masked if bad is None else bad | masked
    return bad if bad is not None and bad.any() else None


def open_image(path: Path, band: int | str = 1, mask: Path | None = None) -> RasterImage | NpyImage:
    """An image source for a file: .npy is mapped, anything else goes through GDAL.

    Parameters
    ----------
    path : Path
        The image.
    band : int or "luminance"
        Band of a raster.
    mask : Path, optional
        Raster or .npy of the same size; non-zero: do not use.

    Returns
    -------
    RasterImage or NpyImage

    Raises
    ------
    FormatError
        Names the file and what is wrong with it.
    """
    extra = None if mask is None else open_image(mask)
    if Path(path).suffix.lower() == ".npy":
        return NpyImage(Path(path), extra)
    return RasterImage(Path(path), band, extra)


def check_band(image: RasterImage | NpyImage, band: int | str, what: str) -> None:
    """FormatError where a .npy file, which holds one band, is asked for another; `what` names the key."""
    if isinstance(image, NpyImage) and band not in (1, "luminance"):
        raise FormatError(
            f"{image.path}: {what} = {band} is given, and a .npy file holds one band: leave it out, or name "
            "the file that holds this band"
        )


def load_raster(
    path: str | Path, band: int | str = 1, mask: str | Path | None = None
) -> PlacedImage | RasterImage | NpyImage:
    """A band of a raster, with its place on the map where the file has one.

    Parameters
    ----------
    path : str or Path
        Any raster that GDAL reads, or a .npy file (lines, columns).
    band : int or "luminance"
        Band of a raster, from 1; the mean of all.
    mask : str or Path, optional
        Raster or .npy of the same size; non-zero: do not use. Pixels of no data are left out anyway.

    Returns
    -------
    ImageSource
        A `PlacedImage` of a raster with an affine transform; places given by ground control points or RPCs
        are not used.

    Raises
    ------
    FormatError
        Names the file and what is wrong with it.
    """
    image = open_image(Path(path), band, None if mask is None else Path(mask))
    check_band(image, band, "the band")
    if isinstance(image, NpyImage):
        return image
    with raster_errors(image.path), open_raster(image.path, image.access) as dataset:
        transform, crs = dataset.transform, dataset.crs
    if transform.is_identity:
        return image
    return PlacedImage(image, tuple(transform)[:6], None if crs is None else str(crs.to_wkt()))


def _clearest(bad: Mask) -> float:
    """Least share of unusable pixels in squares as high as `bad` (lines, columns)."""
    lines, columns = bad.shape
    width = min(lines, columns)
    squares = bad[:, : columns - columns % width].reshape(lines, -1, width)
    return float(squares.mean(axis=(0, 2)).min())


def check_content(image: Source, *, may_be_masked: bool = False) -> None:
    """Look into an image (first, middle and last lines) before work starts.

    Parameters
    ----------
    image : RasterImage or NpyImage
    may_be_masked : bool
        Do not mind an image of which no pixel is usable: one of many that sees the sky.

    Raises
    ------
    FormatError
        If a probe cannot be read (truncated file), holds no usable pixel, mostly values too large to
        compute with, is the same everywhere, or is mostly at its largest (saturated) or smallest (empty)
        value.

    Notes
    -----
    A probe costs 16 lines; a fault between the probes is met by the matcher, which rejects the
    windows it touches.
    """
    lines, columns = image.shape
    values, clearest, beyond = [], 1.0, 0
    for first in sorted({0, max(0, lines // 2 - PROBE_LINES // 2), max(0, lines - PROBE_LINES)}):
        window = (first, min(first + PROBE_LINES, lines)), (0, columns)
        data, bad = image.read(*window), image.mask(*window)
        values.append(data.ravel() if bad is None else data[~bad])
        beyond += int(np.isinf(data).sum())
        clearest = min(clearest, 0.0 if bad is None else _clearest(bad))
    pixels = np.concatenate(values)
    if pixels.size and float(np.median(np.abs(pixels))) > LARGEST:
        raise FormatError(
            f"{image.path}: most of its values are too large ({pixels[0]:.3g} among them; up to {LARGEST:g} "
            "can be compared); scale them down, or declare them as no data if they are"
        )
    if pixels.size == 0 and may_be_masked:
        return
    if pixels.size == 0:
        raise FormatError(
            f"{image.path}: no usable pixel in its first, middle and last lines (no data, NaN or masked"
            + (", or too large for float32: scale such values down" if beyond else "")
            + "); nothing can be matched in it; check the image and its mask"
        )
    if clearest > MAX_MASKED:
        raise FormatError(
            f"{image.path}: unusable pixels (no data, NaN or masked) lie everywhere: at least "
            f"{100 * clearest:.0f} % of any {PROBE_LINES} x {PROBE_LINES} px in its first, middle and last "
            f"lines, a window may hold {100 * MAX_MASKED:.0f} %; check the image and its mask"
        )
    if pixels.min() == pixels.max():
        raise FormatError(
            f"{image.path}: the image is constant (every pixel looked at is {pixels[0]:g}); "
            "nothing can be matched in it; check that the right file is named"
        )
    for value, words, advice in (
        (pixels.max(), "saturated", "use an image with a shorter exposure or mask the saturated part"),
        (pixels.min(), "empty", "check that the right file is named, or mask the empty part"),
    ):
        share = float(np.mean(pixels == value))
        if share > (SATURATED_SHARE if words == "saturated" else EMPTY_SHARE):
            raise FormatError(
                f"{image.path}: {100 * share:.0f} % of the pixels looked at are {words} (at {value:g}); "
                f"nothing can be matched there; {advice}"
            )
