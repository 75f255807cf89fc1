"""Registered bands → cloud-optimised GeoTIFFs, written block of lines by block of lines.

Integers keep their type, with a mask of pixels without a value; float32 marks them by NaN.

Not here: the pixels (``products/register_bands.py``), the summary (``registration.py``).
"""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.registration import Registration
from sightline.errors import printable
from sightline.execution import Progress, Step, silent, steps_of, thread_count
from sightline.imaging.rasters import open_raster, raster_errors
from sightline.imaging.source import ImageSource
from sightline.inputs import will_write
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.images import open_image
from sightline.io.names import file_stems
from sightline.products.register_bands import line_blocks, values_of_lines
from sightline.stages import Stages
from sightline.writing import must_fit, naming_file, whole_raster

Pixels = NDArray[np.float32]

#: Lines and columns of a tile.
TILE = 512


@dataclass(frozen=True)
class MapGrid:
    """Shape of the registered images and what their reference file says about its place on the ground.

    Attributes
    ----------
    shape : (lines, columns)
    tags : dict
        ``crs``, ``transform``, ``gcps``, ``rpcs`` of the reference file, where it has them.
    """

    shape: tuple[int, int]
    tags: dict[str, Any]


def grid_of(acquisition: Acquisition, band: int) -> MapGrid:
    """The grid of a band's image, with the georeferencing of its file."""
    image = acquisition.bands[band].image
    path, tags = getattr(image, "path", None), {}
    if path is not None and Path(path).suffix.lower() != ".npy":
        with raster_errors(path), open_raster(path, getattr(image, "access", None)) as source:
            points, system = source.gcps
            if points:
                tags = {"gcps": points, "crs": system}
            elif not source.transform.is_identity:
                tags = {"transform": source.transform, "crs": source.crs}
            if source.rpcs is not None:
                tags["rpcs"] = source.rpcs
    return MapGrid(image.shape, tags)


def pixel_type(acquisition: Acquisition, bands: Sequence[int], name: str | None) -> np.dtype[Any]:
    """Type to write: `name`, or the one that holds all pixels of the bands as they are (float32 at most)."""
    if name is not None:
        return np.dtype(name)
    kinds = [getattr(acquisition.bands[k].image, "dtype", np.dtype(np.float32)) for k in bands]
    common = np.result_type(*kinds)
    whole = common.kind in "ui" and common.itemsize <= 2
    return common if whole else np.dtype(np.float32)


@dataclass(frozen=True, eq=False)
class Written:
    """What was written, opened again.

    Attributes
    ----------
    files : tuple of str
        Names of the products; of one file for each band, or of one for all.
    before, after : tuple of ImageSource
        All bands on the grid, by the nominal cameras and as written.
    valid : tuple of float
        Share of the pixels of each band that have a value.
    clipped : tuple of float
        Share of these that their type cannot hold: they are at the end of its range.
    dtypes : tuple of str
        Types of the pixels of each band.
    """

    files: tuple[str, ...]
    before: tuple[ImageSource, ...]
    after: tuple[ImageSource, ...]
    valid: tuple[float, ...]
    clipped: tuple[float, ...]
    dtypes: tuple[str, ...]


@contextmanager
def write_products(
    folder: Path,
    registration: Registration,
    acquisition: Acquisition,
    *,
    pixels: str | None = None,
    stack: bool = False,
    tell: Progress = silent,
    stages: Stages | None = None,
) -> Iterator[Written]:
    """Write the registered bands; what they were before lies beside them until the block ends.

    Parameters
    ----------
    folder : Path
        Exists.
    registration : Registration
    acquisition : Acquisition
    pixels : str, optional
        Type of the pixels; that of each image by default (with `stack` one that holds them all).
    stack : bool
        One file, ``registered.tif``, in place of ``NAME.tif`` for each band.
    tell : callable
        Called with what is being done, in words.
    stages : Stages, optional
        Each block of lines is one, where the disk has room for them besides the images.
    """
    names, every = acquisition.names, range(len(acquisition.bands))
    parts = [list(every)] if stack else [[k] for k in every]
    files = ["registered.tif"] if stack else [f"{stem}.tif" for stem in file_stems(names)]
    will_write(files)
    dtypes = [pixel_type(acquisition, part, pixels) for part in parts]
    step = steps_of(tell, "resampling the bands")
    size = sum(len(part) * dtype.itemsize for part, dtype in zip(parts, dtypes, strict=True))
    kept = stages if stages is not None and _room_for_stages(folder, stages, registration, size) else Stages()
    reference, grid = registration.reference, grid_of(acquisition, registration.reference)
    valid, clipped = write_registered(
        [folder / file for file in files],
        [[names[k] for k in part] for part in parts],
        counted_lines(kept_lines(registration.after, reference, kept, "after"), grid.shape[0], step),
        grid,
        dtypes,
    )
    places = [(part.index(k) + 1, file) for part, file in zip(parts, files, strict=True) for k in part]
    after = tuple(open_image(folder / file, number) for number, file in places)
    step = steps_of(tell, "resampling them by the nominal cameras, to compare")
    draft = folder / ".before"
    draft.mkdir()
    try:
        before = _stored(draft, registration, step, kept)
        types = tuple(dtypes[n].name for n, part in enumerate(parts) for _ in part)
        yield Written(tuple(files), before, after, tuple(valid), tuple(clipped), types)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


@dataclass(frozen=True, eq=False)
class _LinesDone:
    """Resampled lines (lines, columns) of the bands that are not the reference, one after the other."""

    pixels: tuple[Pixels, ...]


def _room_for_stages(folder: Path, stages: Stages, registration: Registration, pixel_bytes: int) -> bool:
    """Whether the disk holds finished blocks besides what the run itself writes: they must not end it."""
    lines, columns = registration.before[registration.reference].shape
    moved = len(registration.before) - 1
    # the draft and the image made of it; blocks of both sets of cameras, and the second of them as files
    each = 2 * pixel_bytes + 3 * 4 * moved
    # an earlier run's blocks have taken some of that room
    return bool(shutil.disk_usage(folder).free + stages.size > lines * columns * each)


def kept_lines(
    sources: Sequence[ImageSource], reference: int, stages: Stages, name: str
) -> Iterator[tuple[int, list[Pixels]]]:
    """`line_blocks` of images, each block a stage: an earlier run's first blocks are taken from there.

    The image number `reference` is read in any case: it is a file, or among those left out (-1).
    """
    number, begin, lines = 0, 0, sources[0].shape[0]
    while begin < lines:
        done = stages.held(f"{name}-{number}", _LinesDone)
        if done is None:
            break
        pixels, last = list(done.pixels), begin + len(done.pixels[0])
        if reference >= 0:
            pixels.insert(reference, values_of_lines(sources[reference], begin, last))
        yield begin, pixels
        number, begin = number + 1, last
    for first, pixels in line_blocks(sources, begin=begin):
        moved = tuple(image for k, image in enumerate(pixels) if k != reference)
        if moved:
            stages.put(f"{name}-{number}", _LinesDone(moved))
        yield first, pixels
        number += 1


def counted_lines(
    blocks: Iterator[tuple[int, list[Pixels]]], lines: int, step: Step
) -> Iterator[tuple[int, list[Pixels]]]:
    """Blocks of images of so many lines, which are counted as they are done with."""
    for first, pixels in blocks:
        yield first, pixels
        step(first + len(pixels[0]), lines)


def _stored(folder: Path, registration: Registration, step: Step, stages: Stages) -> tuple[ImageSource, ...]:
    """The bands by the nominal cameras as files, so that nothing is resampled twice; the reference itself."""
    moved = [k for k in range(len(registration.before)) if k != registration.reference]
    if not moved:
        return registration.before
    with naming_file(folder), ExitStack() as stack:
        # written, not mapped: a page that a full disk cannot take would end the process without a word
        tables = {k: stack.enter_context((folder / f"{k}.npy").open("wb")) for k in moved}
        for k, table in tables.items():
            header = {"descr": "<f4", "fortran_order": False, "shape": registration.before[k].shape}
            np.lib.format.write_array_header_1_0(table, header)
        sources = [registration.before[k] for k in moved]
        blocks = kept_lines(sources, -1, stages, "before")
        for _, pixels in counted_lines(blocks, sources[0].shape[0], step):
            for k, block in zip(moved, pixels, strict=True):
                tables[k].write(np.ascontiguousarray(block, dtype="<f4").data)
    return tuple(
        open_image(folder / f"{k}.npy") if k in tables else source
        for k, source in enumerate(registration.before)
    )


def write_registered(
    paths: Sequence[Path],
    names: Sequence[Sequence[str]],
    blocks: Iterator[tuple[int, list[Pixels]]],
    grid: MapGrid,
    dtypes: Sequence[np.dtype[Any]],
) -> tuple[list[float], list[float]]:
    """Write images block by block and make them cloud-optimised.

    Parameters
    ----------
    paths : sequence of Path
        Files to make.
    names : sequence of sequences of str
        Of the bands of each file; all of them together are the images of a block, in order.
    blocks : iterator
        As ``products.register_bands.line_blocks`` gives it.
    grid : Grid
    dtypes : sequence of dtype
        Of each file.

    Returns
    -------
    valid, clipped : list of float
        Share of the pixels of each image that have a value; of these, that are beyond the range of its type.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    drafts = [path.with_name(f".{path.name}.draft.tif") for path in paths]
    pixels_in_all = grid.shape[0] * grid.shape[1]
    size = sum(len(part) * dtype.itemsize for part, dtype in zip(names, dtypes, strict=True)) * pixels_in_all
    for folder in {path.parent for path in paths}:
        must_fit(folder, size, "the registered bands", "ask for smaller pixels by --type,")
    of_images = [dtype for part, dtype in zip(names, dtypes, strict=True) for _ in part]
    counts, beyond = np.zeros(len(of_images)), np.zeros(len(of_images))
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        # an image in sensor geometry has no georeferencing, by nature
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with ExitStack() as stack:
                made = [stack.enter_context(whole_raster(draft)) for draft in drafts]
                targets = [
                    stack.enter_context(rasterio.open(path, "w", **_profile(grid, len(part), dtype)))
                    for path, part, dtype in zip(made, names, dtypes, strict=True)
                ]
                for target, part in zip(targets, names, strict=True):
                    _describe(target, part, grid)
                for first, pixels in blocks:
                    counts += [np.isfinite(image).sum() for image in pixels]
                    beyond += [_beyond(*one) for one in zip(pixels, of_images, strict=True)]
                    done = 0
                    for target, part in zip(targets, names, strict=True):
                        _write_block(target, first, pixels[done : done + len(part)])
                        done += len(part)
            for draft, path, dtype in zip(drafts, paths, dtypes, strict=True):
                optimise(draft, path, dtype)
        finally:
            for draft in drafts:
                draft.unlink(missing_ok=True)
    return (counts / pixels_in_all).tolist(), (beyond / np.maximum(counts, 1.0)).tolist()


def _beyond(pixels: Pixels, dtype: np.dtype[Any]) -> int:
    """How many pixels are beyond the range of a type, half a step of integers aside."""
    if dtype.kind == "f":
        return 0
    limits = np.iinfo(dtype)
    return int(((pixels < limits.min - 0.5) | (pixels > limits.max + 0.5)).sum())


def _profile(grid: MapGrid, count: int, dtype: np.dtype[Any]) -> dict[str, Any]:
    profile: dict[str, Any] = {
        "driver": "GTiff", "height": grid.shape[0], "width": grid.shape[1], "count": count,
        "dtype": dtype.name, "tiled": True, "blockxsize": TILE, "blockysize": TILE, "BIGTIFF": "IF_SAFER",
    }  # fmt: skip
    if dtype.kind == "f":
        profile["nodata"] = float("nan")
    profile.update({key: grid.tags[key] for key in ("crs", "transform") if key in grid.tags})
    return profile


def _describe(target: Any, names: Sequence[str], grid: MapGrid) -> None:
    for number, name in enumerate(names, 1):
        target.set_band_description(number, printable(name))
    if "gcps" in grid.tags:
        target.gcps = (grid.tags["gcps"], grid.tags["crs"])
    if "rpcs" in grid.tags:
        target.rpcs = grid.tags["rpcs"]


def _write_block(target: Any, first: int, pixels: Sequence[Pixels]) -> None:
    """A block of lines of all bands of one file; with integers the mask is where all of them have a value."""
    from rasterio.windows import Window

    window = Window(0, first, target.width, len(pixels[0]))
    dtype = np.dtype(target.dtypes[0])
    if dtype.kind != "f":
        target.write_mask(np.logical_and.reduce([np.isfinite(image) for image in pixels]), window=window)
    for number, image in enumerate(pixels, 1):
        target.write(as_type(image, dtype), number, window=window)


def as_type(pixels: Pixels, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Pixels as a type: integers are rounded and kept in range, 0 where there is no value."""
    if dtype.kind == "f":
        return pixels.astype(dtype, copy=False)
    limits = np.iinfo(dtype)
    whole = np.rint(np.clip(np.nan_to_num(pixels, nan=0.0), limits.min, limits.max))
    return whole.astype(dtype)


def optimise(draft: Path, path: Path, dtype: np.dtype[Any]) -> None:
    """A tiled file as cloud-optimised GeoTIFF with overviews, complete or not at all."""
    import rasterio.shutil

    with whole_raster(path) as made:
        rasterio.shutil.copy(
            draft, made, driver="COG", COMPRESS="DEFLATE", LEVEL="1", PREDICTOR="YES", BLOCKSIZE=str(TILE),
            BIGTIFF="IF_SAFER", OVERVIEW_RESAMPLING="AVERAGE", NUM_THREADS=str(thread_count()),
        )  # fmt: skip
