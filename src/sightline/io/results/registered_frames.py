"""Frames of a spinning camera and what was recovered of them → one registered picture of all exposures.

``picture.tif`` holds the values, one raster band per strip; ``picture.png`` is for looking at; what they are
is in ``docs/formats.md``.

Not here: the picture itself (``products/frame_mosaic.py``), bands of a push-broom.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, FormatError
from sightline.geometry.camera import FrameCamera
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.tables import ANGLES
from sightline.io.results.hidden import read_summary
from sightline.motion.spin.solve import SpinUnknowns, layers_of, spin_statics
from sightline.products.frame_mosaic import Mosaic, frame_mosaic
from sightline.writing import whole_raster

Array = NDArray[np.float64]

#: Brightest share of the lit pixels that may saturate in the PNG, and the power of its tone curve.
BRIGHTEST, GAMMA = 0.005, 0.6
#: Strips by their colour of the PNG.
COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class RecoveredSpin:
    """Cameras of all images as a recovery found them.

    Attributes
    ----------
    cameras : tuple of FrameCamera
    heights : tuple of float or None
        m; of the layer that each strip sees, where they were estimated.
    """

    cameras: tuple[FrameCamera, ...]
    heights: tuple[float, ...] | None


def read_recovered_spin(folder: Path, acquisition: Acquisition) -> RecoveredSpin:
    """What ``sightline recover`` wrote for frames of a spinning camera.

    Parameters
    ----------
    folder : Path
        With ``summary.json``.
    acquisition : Acquisition
        That it was recovered from.

    Raises
    ------
    FormatError
        If the folder holds another kind of result, or that of another acquisition.
    """
    summary = read_summary(folder)
    place = folder / "summary.json"
    if "spin" not in summary or acquisition.spin is None or acquisition.attitude_sigma is None:
        raise FormatError(
            f"{place}: no result of a spinning camera; recover the acquisition first: sightline recover "
            f"{acquisition.path} --out {folder}"
        )
    if summary.get("images") != list(acquisition.names):
        raise FormatError(f"{place}: its images are not those of {acquisition.path}; recover that first")
    unknowns = SpinUnknowns(
        acquisition.frames,
        acquisition.spin,
        acquisition.attitude_sigma,
        spin_statics(
            acquisition.frames,
            acquisition.surface,
            acquisition.lens,
            acquisition.chip,
            acquisition.parallax_sigma,
        ),
        np.ones(3),
        layers_of(acquisition.surface, acquisition.chip),
    )
    x = _unknowns(summary, unknowns, place)
    heights = tuple(float(v) for v in unknowns.heights(x)) if unknowns.layers else None
    try:
        return RecoveredSpin(tuple(unknowns.cameras(x)), heights)
    except ValueError as error:  # turns that are none: infinite, or too large to be counted
        raise FormatError(f"{place}: `statics` and `spin` are no motion ({error}); recover again") from None


def _unknowns(summary: Mapping[str, Any], unknowns: SpinUnknowns, place: Path) -> Array:
    """The values of all unknowns as the summary has them."""
    try:
        values = {entry["name"]: float(entry["value"]) for entry in summary["statics"]}
        constants = [values[name] for name in unknowns.names]
        departures = [[float(e["departure"][axis]) for axis in ANGLES] for e in summary["spin"]["exposures"]]
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{place}: lacks {error}; it does not belong to this acquisition, or was written by another "
            "version: recover again"
        ) from None
    if len(departures) != len(unknowns.t):
        raise FormatError(
            f"{place}: {len(departures)} exposures for the {len(unknowns.t)} of the acquisition; recover "
            "again"
        )
    return np.concatenate([constants, np.ravel(departures)])


def frames_picture(acquisition: Acquisition, motion: Path) -> Mosaic:
    """The registered picture of an acquisition.

    Parameters
    ----------
    acquisition : Acquisition
        Frames of a spinning camera.
    motion : Path
        Folder that ``sightline recover`` wrote for it.
    """
    recovered = read_recovered_spin(motion, acquisition)
    mosaic = frame_mosaic(
        acquisition.frames,
        recovered.cameras,
        acquisition.surface,
        names=acquisition.chip.names,
        heights=recovered.heights,
        masked=False,
    )
    if not _lit(mosaic.pixels).any():
        raise EstimationError(
            f"{acquisition.path}: no place of the picture is seen by every strip and lit; look at the images "
            "and at what was recovered of them: the frames must overlap, and show more than sky"
        )
    return mosaic


def without_margin(mosaic: Mosaic) -> Mosaic:
    """The picture cut to where every strip saw something that is lit."""
    from dataclasses import replace

    lit = _lit(mosaic.pixels)
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    margin = 24
    low = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    high = int(rows[-1]) + margin + 1, int(columns[-1]) + margin + 1
    pixels = mosaic.pixels[:, low[0] : high[0], low[1] : high[1]]
    detector = mosaic.camera.detector
    line, column = detector.principal_point_px
    moved = replace(
        detector,
        shape=(pixels.shape[1], pixels.shape[2]),
        principal_point_px=(line - low[0], column - low[1]),
    )
    return Mosaic(mosaic.names, pixels, mosaic.camera.with_detector(moved))


def _lit(pixels: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(lines, columns) seen by every strip and not as dark as the sky, specks left out."""
    from scipy import ndimage

    seen = np.isfinite(pixels).all(axis=0)
    bright = np.where(seen, np.nan_to_num(pixels).mean(axis=0), 0.0)
    level = 0.1 * float(np.quantile(bright[seen], 0.99)) if seen.any() else 0.0
    return np.asarray(ndimage.binary_opening(bright > max(level, 1e-6), np.ones((7, 7), bool)))


def write_values(path: Path, mosaic: Mosaic) -> None:
    """A GeoTIFF without georeference: one float32 band per strip, NaN where nothing was seen."""
    import rasterio

    count, lines, columns = mosaic.pixels.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(
            draft, "w", driver="COG", width=columns, height=lines, count=count, dtype="float32",
            nodata=float("nan"), compress="deflate",
        ) as raster:  # fmt: skip
            raster.write(mosaic.pixels)
            for k, name in enumerate(mosaic.names):
                raster.set_band_description(k + 1, name)


def write_colours(path: Path, mosaic: Mosaic) -> None:
    """An 8-bit colour PNG, each colour as bright as the others; black where a colour is missing.

    Strips called red, green and blue take these colours; others are taken in their order.
    """
    import rasterio

    order = [mosaic.names.index(name) if name in mosaic.names else k for k, name in enumerate(COLOURS)]
    chosen = mosaic.pixels[[min(k, len(mosaic.names) - 1) for k in order]]
    lit = _lit(mosaic.pixels)
    seen = np.isfinite(chosen).all(axis=0)
    tones = []
    for colour in chosen:
        white = float(np.quantile(colour[lit & seen], 1.0 - BRIGHTEST)) if (lit & seen).any() else 1.0
        level = np.clip(np.where(seen, np.nan_to_num(colour), 0.0) / white, 0.0, 1.0)
        tones.append(np.rint(255.0 * level**GAMMA).astype(np.uint8))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(
            draft, "w", driver="PNG", width=chosen.shape[2], height=chosen.shape[1], count=3, dtype="uint8"
        ) as raster:  # fmt: skip
            raster.write(np.stack(tones))
