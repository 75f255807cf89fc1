"""The ground under a filter camera: relief, and how much of each kind of ground shines at each place.

The amounts are one spline with four channels, so that a place costs one stencil whatever the wavelength:
``signal(place, wavelength) = sum over kinds of amount(place) x weight(wavelength)``. What a scene is made of
does not depend on who looks at it; rays are cut in ``sequence_render.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.simulate.scene import Extent, Relief, mtf_at, random_relief
from sightline.simulate.sequence_options import SequenceOptions
from sightline.simulate.sequence_spectra import (
    KINDS,
    Spectra,
    ground_spectra,
    measured_spectra,
    real_bands,
)
from sightline.simulate.texture import Array, Array32, raster_layer, spline_response

_MARGIN = 3  # rows and columns repeated beyond the period, so that a 4 x 4 stencil never wraps
_LARGEST = 16384  # samples along a side of the table; the ground repeats beyond
_PATCH_PX, _TEXTURE_PX = 250.0, 600.0  # periods beyond which the kinds and the brightness vary no more
_SHARPNESS = 2.5  # how decidedly a place is of one kind
_POSTING_PX = 4.0
_WATER_DARKNESS = 0.5  # of water, over the mean ground


@dataclass(frozen=True, eq=False)
class SimulatedGround:
    """What lies under a flight.

    Parameters
    ----------
    amounts : (rows + 3, columns + 3, KINDS) float32
        B-spline coefficients of the amounts of each kind, periodic, the first three rows and columns
        repeated; rows go north, columns east.
    grid : (4,) m
        x and y of coefficient [0, 0], spacing along x and y.
    mean : (KINDS,) amounts over all the ground
    spectra : Spectra
    relief : Relief
    water : (n, 2) m
        Stretches of y without texture.
    edge : float
        m over which their border turns.
    """

    amounts: Array32
    grid: Array
    mean: Array
    spectra: Spectra
    relief: Relief
    water: Array
    edge: float

    def signal(self, x: Array, y: Array, weights: Array32) -> Array32:
        """Relative signal (..., n) at places `x`, `y` m (any one shape) for `weights` (n, KINDS)."""
        flat_x, flat_y = (np.ascontiguousarray(v, dtype=np.float64).ravel() for v in (x, y))
        out = np.empty((flat_x.size, len(weights)), dtype=np.float32)
        still = (weights @ self.mean).astype(np.float32) * np.float32(_WATER_DARKNESS)
        _signal(self.amounts, self.grid, flat_x, flat_y, weights, still, self.water, self.edge, out)
        return out.reshape(*np.shape(x), len(weights))

    @property
    def still(self) -> Array:
        """(KINDS,) amounts that water shines like."""
        return _WATER_DARKNESS * self.mean


def draw_ground(options: SequenceOptions, extent: Extent, seed: np.random.SeedSequence) -> SimulatedGround:
    """Relief and kinds of ground over `extent`, without water."""
    relief_seed, texture_seed = seed.spawn(2)
    gsd = options.gsd
    if options.texture == "spectrum":
        spectra = ground_spectra("law" if options.spectra == "auto" else options.spectra)
        amounts = _drawn_amounts(options, extent, spectra, texture_seed)
    else:
        spectra = ground_spectra(options.texture if options.spectra == "auto" else options.spectra)
        amounts = _real_amounts(options.texture)
    # the table repeats: its margin does not count
    inner = amounts[:-_MARGIN, :-_MARGIN]
    mean = np.array([inner[..., k].mean(dtype=np.float64) for k in range(KINDS)])
    return SimulatedGround(
        amounts,
        np.array([extent.west, extent.south, 0.5 * gsd, 0.5 * gsd]),
        mean,
        spectra,
        _draw_relief(options, extent, relief_seed),
        np.empty((0, 2)),
        5.0 * gsd,
    )


def _draw_relief(options: SequenceOptions, extent: Extent, seed: np.random.SeedSequence) -> Relief:
    posting = _POSTING_PX * options.gsd
    relief = random_relief(seed, extent, 1.0, posting, options.relief_scale * options.altitude)
    low, high = relief.heights.min(), relief.heights.max()
    heights = (relief.heights - 0.5 * (low + high)) * (2.0 * options.relief * options.altitude / (high - low))
    return Relief(heights, relief.west, relief.north, relief.posting)


def _field(rng: np.random.Generator, shape: tuple[int, int], outer_px: float, slope: float) -> Array32:
    """A Gaussian field of unit variance, half a pixel between samples, power f^-slope within `outer_px`."""
    spectrum = scipy.fft.rfft2(rng.standard_normal(shape, dtype=np.float32), overwrite_x=True)
    fx = (2.0 * scipy.fft.rfftfreq(shape[1])).astype(np.float32)
    fy = (2.0 * scipy.fft.fftfreq(shape[0])).astype(np.float32)
    floor = np.float32(1.0 / outer_px**2)
    for row, f in enumerate(fy):
        spectrum[row] *= (fx * fx + f * f + floor) ** np.float32(-0.25 * slope)
    spectrum[0, 0] = 0.0
    field = scipy.fft.irfft2(spectrum, shape, overwrite_x=True).astype(np.float32, copy=False)
    field *= np.float32(1.0 / field.std(dtype=np.float64))
    return field


def _drawn_amounts(
    options: SequenceOptions, extent: Extent, spectra: Spectra, seed: np.random.SeedSequence
) -> Array32:
    """Coefficients of patches of the kinds, times a brightness common to all, seen through the MTF."""
    width, height = extent.size
    rows, columns = (
        scipy.fft.next_fast_len(min(int(np.ceil(2.0 * length / options.gsd)) + 8, _LARGEST), real=True)
        for length in (height, width)
    )
    children = seed.spawn(KINDS + 1)
    table = np.empty((rows + _MARGIN, columns + _MARGIN, KINDS), dtype=np.float32)
    amounts = table[:rows, :columns]
    for k in range(KINDS):
        amounts[..., k] = _field(np.random.default_rng(children[k]), (rows, columns), _PATCH_PX, 2.6)
    light = _field(np.random.default_rng(children[KINDS]), (rows, columns), _TEXTURE_PX, 2.0)
    sample = amounts[:: max(1, rows // 300), :: max(1, columns // 300)].reshape(-1, KINDS)
    _mix(amounts, light, _biases(sample, spectra.share), np.float32(options.contrast))
    del light
    _sharpen(amounts, options.mtf_nyquist)
    return _wrapped(table)


def _wrapped(table: Array32) -> Array32:
    """The table (rows + _MARGIN, columns + _MARGIN, ...) its margin filled by its beginning, in place."""
    table[-_MARGIN:] = table[:_MARGIN]
    table[:, -_MARGIN:] = table[:, :_MARGIN]
    return table


def _biases(sample: Array32, share: Array) -> Array32:
    """(KINDS,) what must be added to fields (n, KINDS) for the kinds to have their shares of the ground."""
    bias = np.zeros(KINDS)
    for _ in range(30):
        power = np.exp(_SHARPNESS * sample + bias)
        bias += np.log(share / (power / power.sum(axis=1, keepdims=True)).mean(axis=0))
    return bias.astype(np.float32)


@njit(cache=True, nogil=True, fastmath=True)
def _mix(amounts: Array32, light: Array32, bias: Array32, contrast: np.float32) -> None:
    """Fields to amounts, in place: soft choice among the kinds, times one plus a brightness."""
    sharp = np.float32(_SHARPNESS)
    for i in range(amounts.shape[0]):
        for j in range(amounts.shape[1]):
            total = np.float32(0.0)
            for k in range(amounts.shape[2]):
                amounts[i, j, k] = np.exp(sharp * amounts[i, j, k] + bias[k])
                total += amounts[i, j, k]
            scale = max(np.float32(1.0) + contrast * light[i, j], np.float32(0.1)) / total
            for k in range(amounts.shape[2]):
                amounts[i, j, k] *= scale


def _sharpen(amounts: Array32, mtf_nyquist: float) -> None:
    """Samples half a pixel apart to coefficients of their spline through the system's MTF, in place."""
    rows, columns = amounts.shape[:2]
    gains = []
    for frequency in (scipy.fft.fftfreq(rows), scipy.fft.rfftfreq(columns)):
        gains.append((mtf_at(2.0 * frequency, mtf_nyquist) / spline_response(frequency)).astype(np.float32))
    for k in range(KINDS):
        spectrum = scipy.fft.rfft2(amounts[..., k])
        spectrum *= gains[0][:, None]
        spectrum *= gains[1]
        amounts[..., k] = scipy.fft.irfft2(spectrum, (rows, columns), overwrite_x=True)


def _real_amounts(name: str) -> Array32:
    """Coefficients, half a pixel apart, of a real scene mirrored at its edges; its long side goes north.

    Each pixel is shared among the kinds by how near its spectrum, whatever its brightness, is to theirs;
    their sum has the pixel's brightness.
    """
    wavelength_nm, bands = real_bands(name)
    if bands.shape[1] < bands.shape[2]:
        bands = np.ascontiguousarray(bands.transpose(0, 2, 1))
    kinds = measured_spectra(name).at(wavelength_nm).T.astype(np.float32)
    light = bands.mean(axis=0)
    colours = kinds / kinds.mean(axis=1, keepdims=True)
    near = np.empty((*light.shape, KINDS), dtype=np.float32)
    for k in range(KINDS):
        # brightness counts too, a quarter as much: some kinds differ in nothing else
        shape = ((bands / light - colours[k][:, None, None]) ** 2).mean(axis=0)
        near[..., k] = np.exp(-8.0 * (shape + 0.25 * np.log(light / kinds[k].mean()) ** 2))
    amounts = near / near.sum(axis=2, keepdims=True)
    amounts *= (light / (amounts @ kinds.mean(axis=1)))[..., None]
    # a layer has the same margin as the table
    return np.stack([raster_layer(amounts[..., k], (1.0, 1.0)).coefficients for k in range(KINDS)], axis=-1)


@njit(cache=True, nogil=True, fastmath=True)
def spline_signal(amounts: Array32, grid: Array, x: float, y: float, weights: Array32, out: Array32) -> None:
    """Amounts of each kind at a place, times each row of `weights` (n, KINDS), into `out` (n,)."""
    rows, columns = amounts.shape[0] - 3, amounts.shape[1] - 3
    u = (x - grid[0]) / (grid[2] * columns)
    v = (y - grid[1]) / (grid[3] * rows)
    u = (u - np.floor(u)) * columns
    v = (v - np.floor(v)) * rows
    # rounding may put a place at the very end of the period
    j = min(int(u), columns - 1)
    i = min(int(v), rows - 1)
    a, b = np.float32(u - j), np.float32(v - i)
    j = j - 1 if j > 0 else columns - 1
    i = i - 1 if i > 0 else rows - 1
    wx0, wx1, wx2, wx3 = _basis(a)
    wy = _basis(b)
    k0 = k1 = k2 = k3 = np.float32(0.0)
    for r in range(4):
        row = amounts[i + r]
        w0, w1, w2, w3 = wy[r] * wx0, wy[r] * wx1, wy[r] * wx2, wy[r] * wx3
        k0 += w0 * row[j, 0] + w1 * row[j + 1, 0] + w2 * row[j + 2, 0] + w3 * row[j + 3, 0]
        k1 += w0 * row[j, 1] + w1 * row[j + 1, 1] + w2 * row[j + 2, 1] + w3 * row[j + 3, 1]
        k2 += w0 * row[j, 2] + w1 * row[j + 1, 2] + w2 * row[j + 2, 2] + w3 * row[j + 3, 2]
        k3 += w0 * row[j, 3] + w1 * row[j + 1, 3] + w2 * row[j + 2, 3] + w3 * row[j + 3, 3]
    for n in range(weights.shape[0]):
        out[n] = k0 * weights[n, 0] + k1 * weights[n, 1] + k2 * weights[n, 2] + k3 * weights[n, 3]


@njit(cache=True, nogil=True, fastmath=True)
def _basis(a: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of the four coefficients around a place `a` (0-1) past the second."""
    sixth, third2, half, one = np.float32(1.0 / 6.0), np.float32(2.0 / 3.0), np.float32(0.5), np.float32(1.0)
    a1 = one - a
    return (
        a1 * a1 * a1 * sixth,
        third2 - a * a * (one - half * a),
        third2 - a1 * a1 * (one - half * a1),
        a * a * a * sixth,
    )


@njit(cache=True, nogil=True)
def water_share(y: float, water: Array, edge: float) -> float:
    """Share of a place that is water: one inside the stretches of y, over a border `edge` m wide."""
    share = 0.0
    for n in range(water.shape[0]):
        rise = min(max(min(y - water[n, 0], water[n, 1] - y) / edge, 0.0), 1.0)
        share = max(share, rise * rise * (3.0 - 2.0 * rise))
    return share


@njit(cache=True, nogil=True)
def _signal(
    amounts: Array32,
    grid: Array,
    x: Array,
    y: Array,
    weights: Array32,
    still: Array32,
    water: Array,
    edge: float,
    out: NDArray[np.float32],
) -> None:
    for n in range(x.size):
        spline_signal(amounts, grid, x[n], y[n], weights, out[n])
        wet = np.float32(water_share(y[n], water, edge))
        for c in range(weights.shape[0]):
            out[n, c] += wet * (still[c] - out[n, c])
