"""Modulation transfer of what stands still: pixel aperture, diffusion in the detector, optics.

Frequencies are in cycles per pixel of the line period's length on the focal plane.

Not here: motion (``tdi_transfer.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]

#: Loss by wavefront error: rms error (waves) over this, squared (Shannon's empirical law).
WAVEFRONT = 0.18


def aperture_mtf(frequency: ArrayLike, width: float) -> Array:
    """MTF of a photosensitive width, pixels: sinc."""
    return np.asarray(np.abs(np.sinc(width * np.asarray(frequency, dtype=np.float64))))


def diffusion_mtf(frequency: ArrayLike, sigma: ArrayLike) -> Array:
    """MTF of charge that diffuses as a Gaussian of `sigma` pixels; broadcast."""
    spread = np.pi * np.asarray(sigma, dtype=np.float64)
    return np.asarray(np.exp(-2.0 * (spread * np.asarray(frequency, dtype=np.float64)) ** 2))


def optics_mtf(
    frequency: ArrayLike, cutoff: float, *, obscuration: float = 0.0, wavefront: float = 0.0
) -> Array:
    """MTF of an annular pupil with a wavefront error.

    Parameters
    ----------
    frequency : array_like
        Cycles per pixel.
    cutoff : float
        Cycles per pixel at which diffraction leaves nothing: pixel / (wavelength x f-number).
    obscuration : float
        Diameter of the hole over that of the pupil.
    wavefront : float
        Waves rms.

    Raises
    ------
    InputError
        An obscuration outside 0 to 1, or a wavefront error whose law has ended (0.18 waves).

    Notes
    -----
    Autocorrelation of the annulus (O'Neill 1956), times 1 - (W / 0.18)^2 (1 - 4 (nu - 1/2)^2).
    """
    if not 0.0 <= obscuration < 1.0:
        raise InputError(f"`obscuration` is {obscuration:g}; it is a ratio of diameters, 0 up to 1")
    if not 0.0 <= wavefront < WAVEFRONT:
        raise InputError(f"`wavefront` is {wavefront:g} waves rms; the law holds from 0 up to {WAVEFRONT:g}")
    nu = np.clip(np.abs(np.asarray(frequency, dtype=np.float64)) / cutoff, 0.0, 1.0)
    e = obscuration
    # area common to two discs of diameters 1 and e, their centres nu apart, over a quarter of pi
    total = _common(1.0, 1.0, nu) - 2.0 * _common(1.0, e, nu) + _common(e, e, nu)
    loss = (wavefront / WAVEFRONT) ** 2 * (1.0 - 4.0 * (nu - 0.5) ** 2)
    return np.asarray(np.maximum(total / (1.0 - e * e), 0.0) * (1.0 - loss))


def _common(one: float, other: float, apart: Array) -> Array:
    """Area that two discs of these diameters share, `apart` from centre to centre, in units of pi/4."""
    r, s = 0.5 * max(one, other), 0.5 * min(one, other)
    if s == 0.0:
        return np.zeros_like(apart)
    d = np.clip(apart, max(r - s, 1e-12), r + s)
    a = np.arccos(np.clip((d * d + r * r - s * s) / (2.0 * d * r), -1.0, 1.0))
    b = np.arccos(np.clip((d * d + s * s - r * r) / (2.0 * d * s), -1.0, 1.0))
    lens = r * r * (a - 0.5 * np.sin(2.0 * a)) + s * s * (b - 0.5 * np.sin(2.0 * b))
    return np.asarray(np.where(apart <= r - s, np.pi * s * s, lens) / (0.25 * np.pi))
