"""``[[band]]``, ``[instrument]``, ``[camera]`` → images with their nominal pushbroom cameras.

Not here: bands with a sensor-model file (``model_bands.py``), frames (``frames.py``), the trajectory of
the platform (``platform.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.platform import build_trajectory
from sightline.io.acquisition.quality import read_match_sigma
from sightline.io.acquisition.schema import (
    AcquisitionFile,
    BandSection,
    LineGeometry,
)
from sightline.io.acquisition.spin import pointing_of
from sightline.io.acquisition.stages import stages_of
from sightline.io.formats import tables
from sightline.io.formats.images import MissingImage, Source, check_band, check_content, open_image
from sightline.io.quantities import shown
from sightline.motion.band import Band

Array = NDArray[np.float64]

#: Lines of a strip that is described without any of its images.
UNKNOWN_LINES = 1000
#: Fewest lines of an image in which motion against time means anything.
FEWEST_LINES = 32


@dataclass(frozen=True, eq=False)
class _Timing:
    """When the lines of a band are exposed."""

    first: float
    period: float
    lines: int
    table: Array | None

    @property
    def span(self) -> tuple[float, float]:
        """s; centre of exposure of the first and last line."""
        if self.table is not None:
            return float(self.table[0]), float(self.table[-1])
        return self.first, self.first + self.period * (self.lines - 1)


def build_bands(config: AcquisitionFile, files: InputFolder, *, look: bool = True) -> tuple[Band, ...]:
    """Every ``[[band]]`` with its image and nominal camera.

    Parameters
    ----------
    config : AcquisitionFile
    files : InputFolder
        Finds the files named.
    look : bool
        Probe the images' content.

    Returns
    -------
    tuple of Band
        Empty when the file has frames.
    """
    if not config.band:
        return ()
    shape = _shape_of_missing(config, files)
    images = [
        open_band_image(band, files, look=look, shape=shape(band) if shape else None) for band in config.band
    ]
    plans = [
        _detector_and_timing(config, band, index, image, files)
        for index, (band, image) in enumerate(zip(config.band, images, strict=True))
    ]
    stages = [
        stages_of(band, image.shape, f"{files.toml}: [[band]] number {index + 1} ({band.name})", files)
        for index, (band, image) in enumerate(zip(config.band, images, strict=True))
    ]
    spans = [timing.span for _, timing in plans]
    span = min(s[0] for s in spans), max(s[1] for s in spans)
    trajectory = build_trajectory(config, files, span)
    pointing = pointing_of(config, files, span)
    return tuple(
        Band(
            band.name,
            image,
            PushbroomCamera(
                detector,
                trajectory,
                pointing,
                timing.first,
                timing.lines,
                line_times=timing.table,
                stages=counts,
                time_reference=band.time_reference or "centre",
            ),
            band.offset_sigma_px,
            band.rotation_sigma,
            band.scale_sigma,
            match_sigma_of(band, image, files),
            band.shape,
            band.shape_sigma_px,
            pieces_of(band, image, files),
        )
        for band, image, (detector, timing), counts in zip(config.band, images, plans, stages, strict=True)
    )


def match_sigma_of(band: BandSection, image: Source, files: InputFolder) -> Array | None:
    """Relative sigma of matches at every column, where the band names a table of its quality."""
    return None if band.quality is None else read_match_sigma(files(band.quality), image.shape[1])


def pieces_of(band: BandSection, image: Source, files: InputFolder) -> tuple[int, ...]:
    """First columns of the further CCDs of a band; none where they are not given."""
    columns, pieces = image.shape[1], band.pieces
    if pieces is None:
        return ()
    last = 2 * pieces - 1 if isinstance(pieces, int) else pieces[-1]
    if last >= columns:
        raise FormatError(
            f"{files.toml}: [[band]] {band.name}: pieces = {pieces} does not fit the {columns} columns of "
            f"{image.path.name}; give the first column of each CCD after the first, from 0, or their number"
        )
    if isinstance(pieces, int):
        return tuple(round(k * columns / pieces) for k in range(1, pieces))
    return tuple(pieces)


def _shape_of_missing(
    config: AcquisitionFile, files: InputFolder
) -> Callable[[BandSection], tuple[int, int] | None] | None:
    """Lines and columns of images that are not there, where these are only described; None otherwise.

    Lines fill the time of the first image that is there, or of `UNKNOWN_LINES` of the longest; columns as
    given, or of that image.
    """
    if not files.describing:
        return None
    there = next((band for band in config.band if not files.lacks_file(band.image)), None)
    like = open_image(files(there.image), there.image_band).shape if there is not None else None
    known = there or max(config.band, key=lambda band: _given(config, band, "line_period") or 0.0)

    def shape(band: BandSection) -> tuple[int, int] | None:
        if band.name in files.sizes:
            return files.sizes[band.name]
        columns = _given(config, band, "columns") or (like and like[1])
        periods = [_given(config, one, "line_period") for one in (known, band)]
        longer = periods[1] / periods[0] if all(periods) else 1.0
        lines = math.ceil((like[0] if like else UNKNOWN_LINES) / longer - 1e-9)
        return None if columns is None else (lines, int(columns))

    return shape


def open_band_image(
    band: BandSection, files: InputFolder, *, look: bool, shape: tuple[int, int] | None = None
) -> Source:
    """The image of a band, opened and looked into; of that `shape` if it is not there and need not be."""
    if shape is not None and files.lacks(band.image, shape):
        return MissingImage(files.path(band.image), shape)
    mask = None if band.mask is None else files(band.mask)
    image = open_image(files(band.image), band.image_band, mask)
    if image.shape[0] < FEWEST_LINES:
        raise FormatError(
            f"{image.path}: has {image.shape[0]} lines and {image.shape[1]} columns; a strip needs "
            f"{FEWEST_LINES} lines "
            "or more; are lines and columns swapped?"
        )
    if look:
        check_content(image)
    return image


def _given(config: AcquisitionFile, band: BandSection, key: str) -> Any:
    """A key of the band, else of ``[instrument]``."""
    own = getattr(band, key)
    return own if own is not None else getattr(config.instrument, key)


def _detector_and_timing(
    config: AcquisitionFile, band: BandSection, index: int, image: Source, files: InputFolder
) -> tuple[LineDetector, _Timing]:
    """Where a band looks and when its lines are exposed; its table agrees with its image."""
    where = f"{files.toml}: [[band]] number {index + 1} ({band.name})"
    if band.first_pixel is not None:
        raise FormatError(
            f"{where}: first_pixel is of a part of a sensor model's image ([platform] kind camera-model); in "
            "its place give columns, first_line_time and tables of the part"
        )
    if band.model is not None:
        raise FormatError(
            f'{where}: model = {shown(band.model)} is given, and [platform] kind = "{config.platform.kind}" '
            'takes no sensor-model file: remove it, or give [platform] kind = "camera-model"'
        )
    if not isinstance(image, MissingImage):
        # of a sensor model image_band is the number of its own band too, whatever the image is stored in
        check_band(image, band.image_band, "image_band")
    lines, width = image.shape
    columns = _given(config, band, "columns")
    if columns is not None and columns != width:
        raise FormatError(
            f"{where}: {image.path.name} has {width} columns ({lines} lines), columns = {columns}; they "
            f"must agree; "
            "correct columns or name the right image"
        )
    timing = _timing(config, band, where, lines, files)
    directions = _own_or_shared(config.instrument, band, "directions", "ifov")
    if directions is not None:
        detector = LineDetector(band.name, _read_directions(files(directions), width), timing.period)
        detector = _placed(detector, band)
    else:
        ifov = _given(config, band, "ifov")
        if ifov is None:
            raise FormatError(
                f"{where}: ifov is missing; give ifov (or directions = FILE) there or in [instrument]"
            )
        detector = LineDetector.from_ifov(
            band.name, width, ifov, timing.period, band.look_ahead, band.offset_px, band.rotation
        )
    return detector, timing


def _own_or_shared(shared: LineGeometry, band: BandSection, key: str, other: str) -> Any:
    """`key` of the band, else of ``[instrument]`` unless the band gives `other` in its place."""
    if getattr(band, key) is not None:
        return getattr(band, key)
    return None if getattr(band, other) is not None else getattr(shared, key)


def _read_directions(path: Path, columns: int) -> Array:
    """A table of directions with one row per column of the image."""
    directions = tables.read_directions(path)
    if len(directions) != columns:
        raise FormatError(
            f"{path}: has {len(directions)} columns, the image {columns}; give one direction per column"
        )
    return directions


def _placed(detector: LineDetector, band: BandSection) -> LineDetector:
    """A detector from a table, with the band's own look-ahead, offset and rotation on top."""
    ahead_px = float(np.tan(band.look_ahead)) / detector.pixel_step
    return detector.adjusted(ahead_px + band.offset_px[0], band.offset_px[1], band.rotation)


def _timing(
    config: AcquisitionFile, band: BandSection, where: str, lines: int, files: InputFolder
) -> _Timing:
    """Line times of a band, from a period or a table."""
    period = _given(config, band, "line_period")
    if band.line_times is None:
        if period is None:
            raise FormatError(f"{where}: line_period is missing; give it there or in [instrument] (s)")
        return _Timing(band.first_line_time or 0.0, period, lines, None)
    if band.first_line_time is not None:
        raise FormatError(f"{where}: first_line_time and line_times are both given; keep one of them")
    path = files(band.line_times)
    times = tables.read_line_times(path)
    if len(times) != lines:
        raise FormatError(f"{path}: has {len(times)} lines, {band.image} has {lines}; give one time per line")
    mean = float((times[-1] - times[0]) / (lines - 1))
    return _Timing(float(times[0]), mean if period is None else period, lines, times)
