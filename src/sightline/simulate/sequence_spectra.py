"""Spectra of four kinds of ground: a law written out here, or clusters of the pixels of real bands.

Where each kind lies on the ground is in ``sequence_ground.py``; which wavelengths a pixel sees in
``sequence_filter.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sightline.errors import InputError
from sightline.imaging.rasters import open_raster, raster_errors
from sightline.simulate.measured import data_file, landsat_bands
from sightline.simulate.texture import Array, Array32

KINDS = 4
"""Kinds of ground, each with a spectrum of its own."""

_REDEDGE_NM = (475.0, 560.0, 668.0, 840.0, 717.0)
# (column, line) of the same ground in each of the five lenses over that in the first, px
_REDEDGE_SHIFTS = ((0, 0), (7, 10), (6, 7), (20, 12), (22, 6))
_REDEDGE_BLACK = 4800.0
_LANDSAT_NM = (835.0, 660.0, 560.0, 485.0)
_BLOCK = 8  # px, side of the blocks that are sorted into kinds: the lenses agree to about that


@dataclass(frozen=True, eq=False)
class Spectra:
    """Brightness of each kind of ground against wavelength.

    Parameters
    ----------
    name : str
        Where they are from.
    wavelength_nm : (n,) rising
    brightness : (KINDS, n)
        Of any unit per wavelength: only ratios at one wavelength count.
    share : (KINDS,)
        Of the ground that each covers; sum 1.
    """

    name: str
    wavelength_nm: Array
    brightness: Array
    share: Array

    def at(self, wavelength_nm: Array) -> Array:
        """Brightness (N, KINDS) at wavelengths (N,), nm; level beyond the first and the last."""
        from scipy.interpolate import PchipInterpolator

        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        curve = PchipInterpolator(self.wavelength_nm, self.brightness, axis=1)
        return np.ascontiguousarray(curve(np.clip(wavelength_nm, low, high)).T)


def ground_spectra(name: str) -> Spectra:
    """Spectra by name: "law", or those of a real scene, "rededge" or "landsat"."""
    return law_spectra() if name == "law" else measured_spectra(name)


def law_spectra() -> Spectra:
    """Plants, soil, stone and shade from 400 to 1000 nm, as reflectance.

    Notes
    -----
    Textbook shapes, no data: plants absorb below the red edge (a logistic step of 12 nm at 715 nm to 0.46)
    save for a green hump of 0.05 at 550 nm; soil rises evenly from 0.08 to 0.36; stone is nearly grey, 0.25
    to 0.35; shade is lit by blue sky.
    """
    nm = np.arange(400.0, 1001.0, 10.0)
    rise = (nm - 400.0) / 600.0
    plants = 0.04 + 0.05 * np.exp(-(((nm - 550.0) / 35.0) ** 2)) + 0.42 / (1.0 + np.exp((715.0 - nm) / 12.0))
    brightness = np.stack([plants, 0.08 + 0.28 * rise, 0.25 + 0.1 * rise, 0.02 + 0.06 * (400.0 / nm) ** 2])
    return Spectra("law", nm, brightness, np.array([0.4, 0.3, 0.15, 0.15]))


def measured_spectra(name: str, folder: Path | None = None) -> Spectra:
    """Spectra of the kinds of ground that a real scene shows; raises FormatError where it is not found.

    Notes
    -----
    Means of blocks of pixels, each band over its own mean (gains and exposures are not known), are sorted
    into `KINDS` clusters by Lloyd's iteration, which begins at even quantiles of the first principal
    component: the same data give the same spectra.
    """
    from scipy.cluster.vq import kmeans2

    wavelength_nm, bands = real_bands(name, folder)
    count, rows, columns = bands.shape
    rows, columns = rows // _BLOCK * _BLOCK, columns // _BLOCK * _BLOCK
    blocks = bands[:, :rows, :columns].reshape(count, rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK)
    spectra = blocks.mean(axis=(2, 4)).reshape(count, -1).T.astype(np.float64)
    direction = np.linalg.svd(spectra - spectra.mean(axis=0), full_matrices=False)[2][0]
    order = np.argsort(spectra @ direction)
    begin = spectra[order[((np.arange(KINDS) + 0.5) / KINDS * len(order)).astype(int)]]
    centres, label = kmeans2(spectra, begin, iter=40, minit="matrix")
    share = np.bincount(label, minlength=KINDS) / len(label)
    rising = np.argsort(wavelength_nm)
    brightness = np.maximum(centres[:, rising].astype(np.float64), 0.02)
    return Spectra(name, wavelength_nm[rising], brightness, share)


def real_bands(name: str, folder: Path | None = None) -> tuple[Array, Array32]:
    """Wavelengths (n,) nm and bands (n, rows, columns) of a real scene, each band over its mean.

    "rededge": five lenses, laid on the first by a shift of whole pixels (they agree to some pixels; that
    makes the scene what it is, and is no error). "landsat": four registered bands; saturated pixels keep
    their value.
    """
    if name == "landsat":
        bands = landsat_bands(folder).astype(np.float32)
        wavelength = np.array(_LANDSAT_NM)
    elif name == "rededge":
        bands, wavelength = _rededge(folder), np.array(_REDEDGE_NM)
    else:
        raise InputError(f"unknown real scene: got {name!r}; allowed are rededge, landsat")
    return wavelength, np.asarray(bands / bands.mean(axis=(1, 2), keepdims=True), dtype=np.float32)


def _rededge(folder: Path | None) -> Array32:
    right, down = (max(shift[axis] for shift in _REDEDGE_SHIFTS) for axis in (0, 1))
    bands = []
    for number, (x, y) in enumerate(_REDEDGE_SHIFTS, start=1):
        path = data_file(f"rededge_capture/IMG_0001_{number}.tif", folder)
        with raster_errors(path), open_raster(path) as source:
            image = source.read(1).astype(np.float32) - np.float32(_REDEDGE_BLACK)
        rows, columns = image.shape
        bands.append(image[y : rows - down + y, x : columns - right + x])
    return np.maximum(np.stack(bands), 1.0)
