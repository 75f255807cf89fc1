"""Continuous random functions of the ground with a known spectrum, as periodic cubic B-splines.

A :class:`Layer` *is* the function: every camera samples the same spline, so that no interpolation error
stands between two bands of a scene. Its coefficients are made in the Fourier domain from white noise, or
from a raster; the spectrum asked for is met to about 1e-4 of its power at twice the image's sampling.

What is put on the ground and how it shines is in ``scene.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

_PAD = 3  # coefficients repeated beyond each period, so that a 4 x 4 stencil never wraps


@dataclass(frozen=True, eq=False)
class TextureLayer:
    """A function of ground position, periodic, twice differentiable.

    Parameters
    ----------
    coefficients : (rows + 3, columns + 3) float32
        B-spline coefficients, the first three rows and columns repeated at the end; rows go north (+y),
        columns east (+x).
    spacing : (float, float)
        m between columns (x) and between rows (y).
    origin : (float, float)
        m, the place (x, y) of coefficient [0, 0].
    """

    coefficients: Array32
    spacing: tuple[float, float]
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def period(self) -> tuple[float, float]:
        """m along x and y after which the function repeats."""
        rows, columns = self.coefficients.shape
        return (columns - _PAD) * self.spacing[0], (rows - _PAD) * self.spacing[1]

    def at(self, x: Array, y: Array) -> Array32:
        """Values at ground places `x`, `y` (any one shape) m; same shape, float32."""
        out = np.empty(np.shape(x), dtype=np.float32)
        _sample(
            self.coefficients,
            np.ascontiguousarray(x, dtype=np.float64).ravel(),
            np.ascontiguousarray(y, dtype=np.float64).ravel(),
            np.array([*self.origin, *self.spacing]),
            out.ravel(),
        )
        return out


@njit(cache=True, nogil=True, fastmath=True)
def _sample(coefficients: Array32, x: Array, y: Array, grid: Array, out: Array32) -> None:
    """Cubic B-spline of a padded periodic table at N places; `grid` is (x0, y0, dx, dy)."""
    rows = coefficients.shape[0] - 3
    columns = coefficients.shape[1] - 3
    inverse_x = 1.0 / (grid[2] * columns)
    inverse_y = 1.0 / (grid[3] * rows)
    for n in range(x.size):
        u = (x[n] - grid[0]) * inverse_x
        v = (y[n] - grid[1]) * inverse_y
        u = (u - np.floor(u)) * columns
        v = (v - np.floor(v)) * rows
        # the stencil begins one coefficient before the cell
        j = int(u)
        i = int(v)
        if j >= columns:
            j = columns - 1
        if i >= rows:
            i = rows - 1
        a = np.float32(u - j)
        b = np.float32(v - i)
        j = j - 1 if j > 0 else columns - 1
        i = i - 1 if i > 0 else rows - 1
        sixth = np.float32(1.0 / 6.0)
        third2 = np.float32(2.0 / 3.0)
        half = np.float32(0.5)
        one = np.float32(1.0)
        a1 = one - a
        wx0 = a1 * a1 * a1 * sixth
        wx1 = third2 - a * a * (one - half * a)
        wx2 = third2 - a1 * a1 * (one - half * a1)
        wx3 = a * a * a * sixth
        b1 = one - b
        wy0 = b1 * b1 * b1 * sixth
        wy1 = third2 - b * b * (one - half * b)
        wy2 = third2 - b1 * b1 * (one - half * b1)
        wy3 = b * b * b * sixth
        total = wy0 * (
            wx0 * coefficients[i, j]
            + wx1 * coefficients[i, j + 1]
            + wx2 * coefficients[i, j + 2]
            + wx3 * coefficients[i, j + 3]
        )
        total += wy1 * (
            wx0 * coefficients[i + 1, j]
            + wx1 * coefficients[i + 1, j + 1]
            + wx2 * coefficients[i + 1, j + 2]
            + wx3 * coefficients[i + 1, j + 3]
        )
        total += wy2 * (
            wx0 * coefficients[i + 2, j]
            + wx1 * coefficients[i + 2, j + 1]
            + wx2 * coefficients[i + 2, j + 2]
            + wx3 * coefficients[i + 2, j + 3]
        )
        total += wy3 * (
            wx0 * coefficients[i + 3, j]
            + wx1 * coefficients[i + 3, j + 1]
            + wx2 * coefficients[i + 3, j + 2]
            + wx3 * coefficients[i + 3, j + 3]
        )
        out[n] = total


def padded(coefficients: Array32) -> Array32:
    """The table with its first three rows and columns repeated at the end."""
    wrapped = np.pad(coefficients, ((0, _PAD), (0, _PAD)), mode="wrap")
    wrapped.setflags(write=False)
    return wrapped


def spline_response(frequencies: Array) -> Array:
    """Fourier transform of the cubic B-spline at `frequencies`, cycles per knot: sinc^4."""
    return np.sinc(frequencies) ** 4


def random_layer(
    seed: np.random.SeedSequence,
    shape: tuple[int, int],
    spacing: tuple[float, float],
    psd: Callable[[Array, Array], Array],
    origin: tuple[float, float] = (0.0, 0.0),
) -> TextureLayer:
    """A Gaussian layer with the two-dimensional spectrum `psd`.

    Parameters
    ----------
    seed : numpy.random.SeedSequence
    shape : (rows, columns) of the table; best with small prime factors
    spacing : (x, y) m
    psd : callable
        ``psd(fx, fy)``, cycles/m broadcast, returns the two-sided density, m^2 x unit^2. It is set to zero
        at frequency zero: the layer's mean is zero.
    origin : (x, y) m of the table's first coefficient

    Returns
    -------
    Layer
    """
    import scipy.fft

    rows, columns = shape
    white = np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
    spectrum = scipy.fft.rfft2(white, overwrite_x=True)
    del white
    fx = scipy.fft.rfftfreq(columns)
    response_x = spline_response(fx)
    # by bands of rows, so that the transfer function never stands in memory as a whole
    for first in range(0, rows, 256):
        last = min(first + 256, rows)
        fy = scipy.fft.fftfreq(rows)[first:last, None]
        density = psd(fx[None, :] / spacing[0], fy / spacing[1])
        if first == 0:
            density[0, 0] = 0.0
        gain = np.sqrt(density / (spacing[0] * spacing[1])) / (response_x[None, :] * spline_response(fy))
        spectrum[first:last] *= gain.astype(np.float32)
    coefficients = scipy.fft.irfft2(spectrum, shape, overwrite_x=True).astype(np.float32, copy=False)
    return TextureLayer(padded(coefficients), spacing, origin)


def raster_layer(
    raster: NDArray[np.generic], spacing: tuple[float, float], origin: tuple[float, float] = (0.0, 0.0)
) -> TextureLayer:
    """A real image as a layer: mirrored at its edges, band-limited to its own sampling.

    Parameters
    ----------
    raster : (rows, columns)
        Row 0 lies at the origin; rows go north. The layer repeats after twice its size, mirrored.
    spacing : (x, y) m between raster columns and rows
    origin : (x, y) m of raster[0, 0]

    Notes
    -----
    The mirrored image is upsampled twice by its Fourier series (the band-limited function through the
    samples), of which the spline takes the coefficients: images of the spectrum stay under 1.3 % of the
    amplitude at the raster's Nyquist frequency and fall as the fourth power below it.
    """
    import scipy.fft

    image = np.asarray(raster, dtype=np.float64)
    tile = np.concatenate([image, image[::-1]])
    tile = np.concatenate([tile, tile[:, ::-1]], axis=1)
    rows, columns = tile.shape
    spectrum = scipy.fft.rfft2(tile)
    fine = np.zeros((2 * rows, columns + 1), dtype=np.complex128)
    half = rows // 2
    fine[:half, : columns // 2] = spectrum[:half, : columns // 2]
    fine[-half + 1 :, : columns // 2] = spectrum[-half + 1 :, : columns // 2]
    fine *= 4.0
    fine /= spline_response(scipy.fft.rfftfreq(2 * columns))[None, :]
    fine /= spline_response(scipy.fft.fftfreq(2 * rows))[:, None]
    coefficients = scipy.fft.irfft2(fine, (2 * rows, 2 * columns)).astype(np.float32)
    return TextureLayer(padded(coefficients), (spacing[0] / 2.0, spacing[1] / 2.0), origin)
