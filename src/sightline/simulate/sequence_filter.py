"""Which wavelength each pixel of a filter camera sees, and what it makes of each kind of ground.

Spectra of the ground are in ``sequence_spectra.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.simulate.sequence_options import SequenceOptions
from sightline.simulate.sequence_spectra import Spectra
from sightline.simulate.texture import Array, Array32

RGB_NM = (620.0, 540.0, 460.0)
_RGB_FWHM_NM = 80.0
_PAN_NM = (450.0, 900.0)
_SIGMA_OF_FWHM = 1.0 / 2.354820045


@dataclass(frozen=True, eq=False)
class FilterLayout:
    """Wavelengths over the detector, repeated from its first pixel.

    Parameters
    ----------
    kind : str
        One of ``sequence_options.FILTERS``.
    wavelength_nm : (channels, a, b)
        Of pixel (line, column) of a channel: ``[channel, line % a, column % b]``; b = 1: a wavelength per
        line. NaN: all wavelengths alike.
    given_nm : (channels, a, b)
        What a user is given of them.
    fwhm_nm : float
    """

    kind: str
    wavelength_nm: Array
    given_nm: Array
    fwhm_nm: float

    def at(self, wavelength_nm: Array, spectra: Spectra) -> Array:
        """Brightness (N, kinds) of the kinds of ground through filters of centres (N,); NaN: all light."""
        centre = np.asarray(wavelength_nm, dtype=np.float64)
        # the pass-band by seven places of equal weight, whose mean square is that of a Gaussian
        place = np.linspace(-1.5, 1.5, 7)
        offsets = place / np.sqrt((place**2).mean()) * self.fwhm_nm * _SIGMA_OF_FWHM
        wide = np.linspace(*_PAN_NM, len(offsets))
        through = np.where(np.isnan(centre)[:, None], wide, centre[:, None] + offsets)
        return spectra.at(through.ravel()).reshape(*through.shape, -1).mean(axis=1)


def detector_response(wavelength_nm: Array) -> Array:
    """Relative sensitivity of the detector, 1 at 620 nm: silicon behind a filter; 1 where NaN (all light)."""
    bell = 0.4 + 0.6 * np.exp(-(((np.asarray(wavelength_nm) - 620.0) / 200.0) ** 2))
    return np.where(np.isnan(bell), 1.0, bell)


def filter_layout(options: SequenceOptions) -> FilterLayout:
    """The filter of a camera."""
    lines = options.shape[0]
    low, high = options.wavelengths_nm
    fwhm = _RGB_FWHM_NM if options.filter == "rgb" else options.fwhm_nm
    if options.filter == "pan":
        true = given = np.full((1, 1, 1), np.nan)
    elif options.filter == "rgb":
        true = given = np.array(RGB_NM).reshape(3, 1, 1)
    elif options.filter == "mosaic":
        side = options.pattern
        true = given = np.linspace(low, high, side * side).reshape(1, side, side)
    else:
        every = np.linspace(low, high, lines)
        grouped = _grouped(every, options.bands) if options.bands else every
        given = grouped.reshape(1, lines, 1)
        true = given if options.filter == "stepwise" else every.reshape(1, lines, 1)
    return FilterLayout(options.filter, true, given, fwhm)


def _grouped(values: Array, count: int) -> Array:
    """Values (n,) replaced by their means over `count` groups as even as can be."""
    group = np.arange(len(values)) * count // len(values)
    return np.asarray((np.bincount(group, values) / np.bincount(group))[group])


def filter_weights(layout: FilterLayout, spectra: Spectra, mean_share: Array) -> Array32:
    """Weights (channels, a, b, kinds) that turn amounts of each kind of ground into relative signal.

    The mean ground, `mean_share` (kinds,) of each, gives ``detector_response(wavelength)``.
    """
    flat = layout.wavelength_nm.ravel()
    brightness = layout.at(flat, spectra)
    weights = brightness / (brightness @ mean_share)[:, None] * detector_response(flat)[:, None]
    return weights.reshape(*layout.wavelength_nm.shape, -1).astype(np.float32)
