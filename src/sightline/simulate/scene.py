"""What the cameras look at: brightness of the ground in each band, relief, clouds, blank stretches.

Positions are local: x east, y north, z up, metres. The texture already carries the MTF of the system (on a
scene this flat and near the nadir, blurring the ground and blurring the image are the same), so that
sampling it at pixel centres gives the image, aliasing included.

Random functions are made in ``texture.py``; rays are cut and noise is added in ``sensor.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.simulate.texture import Array, Array32, TextureLayer, random_layer

OUTER_SCALE_PX = 1800.0
"""Period, px, beyond which the texture's spectrum stops growing (that of S1's reference scenes)."""


#: m, between the posts of a relief.
POSTING = 30.0


@dataclass(frozen=True)
class Extent:
    """A rectangle on the ground, metres."""

    west: float
    east: float
    south: float
    north: float

    def grown(self, margin: float) -> Extent:
        """The rectangle with `margin` metres more on every side."""
        return Extent(self.west - margin, self.east + margin, self.south - margin, self.north + margin)

    @property
    def size(self) -> tuple[float, float]:
        """Lengths along x and y, metres."""
        return self.east - self.west, self.north - self.south


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights on a grid, bilinear between posts, constant beyond the edges.

    Parameters
    ----------
    heights : (rows, columns) m, row 0 the most northern
    west, north : m, x and y of the centre of post [0, 0]
    posting : (float, float)
        m between columns (towards the east) and between rows (towards the south), both positive.
    """

    heights: Array
    west: float
    north: float
    posting: tuple[float, float]

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) from (column, row) of pixel corners to (x, y)."""
        dx, dy = self.posting
        return dx, 0.0, self.west - 0.5 * dx, 0.0, -dy, self.north + 0.5 * dy


@dataclass(frozen=True, eq=False)
class Clouds:
    """Bright cloud in a layer at one height, drifting with the wind.

    Parameters
    ----------
    thickness : Layer or None
        Gaussian of unit variance; a cloud stands where it exceeds `threshold`. None: no scattered clouds.
    threshold : float
    softness : float
        Rise of the thickness over which the cloud turns from clear to opaque.
    brightness : Layer
        Of the cloud tops, about 0, in units of the ground's contrast.
    height : float
        m
    wind : (float, float)
        m/s east and north
    level : float
        Brightness of a cloud top over that of the mean ground.
    banks : tuple of (float, float)
        m, stretches of y (at t = 0) wholly covered by a flat white bank.
    edge : float
        m over which the border of a bank turns from clear to opaque.
    """

    thickness: TextureLayer | None
    threshold: float
    softness: float
    brightness: TextureLayer
    height: float
    wind: tuple[float, float]
    level: float = 2.6
    banks: tuple[tuple[float, float], ...] = ()
    edge: float = 20.0

    def opacity(self, x: Array, y: Array, t: Array) -> Array32:
        """Share of the light that comes from the cloud, 0-1, at cloud-height places and times (one shape)."""
        x = x - self.wind[0] * t
        y = y - self.wind[1] * t
        cover = np.zeros(x.shape, dtype=np.float32)
        if self.thickness is not None:
            rise = (self.thickness.at(x, y) - np.float32(self.threshold)) / np.float32(self.softness)
            rise = np.clip(rise, 0.0, 1.0)
            cover = rise * rise * (3.0 - 2.0 * rise)
        return np.maximum(cover, stretch_weight(x, y, self.banks, self.edge))

    def shine(self, x: Array, y: Array, t: Array) -> Array32:
        """Brightness of the cloud tops over that of the mean ground."""
        x = x - self.wind[0] * t
        y = y - self.wind[1] * t
        texture = self.brightness.at(x, y) * (1.0 - stretch_weight(x, y, self.banks, self.edge))
        return np.asarray(self.level * (1.0 + texture), dtype=np.float32)


def stretch_weight(x: Array, y: Array, stretches: tuple[tuple[float, float], ...], edge: float) -> Array32:
    """One inside stretches of y, zero outside, over a smooth and winding border `edge` metres wide."""
    weight = np.zeros(np.shape(x), dtype=np.float32)
    winding = 1.5 * edge * np.sin(x / (3.7 * edge)) + edge * np.sin(x / (1.3 * edge) + 1.0)
    for south, north in stretches:
        depth = np.minimum(y - south, north - y) + winding
        rise = np.clip(depth / edge, 0.0, 1.0).astype(np.float32)
        weight = np.maximum(weight, rise * rise * (3.0 - 2.0 * rise))
    return weight


@dataclass(frozen=True, eq=False)
class BandShine:
    """How one band sees the ground: ``gain * max(1 + w z + sqrt(1 - w^2) z_own, floor) ** gamma``.

    Parameters
    ----------
    own : Layer or None
        The part of the texture that only this band sees, with the spectrum of the common part; None where
        the band is the common part itself or where `common` is the band's own raster.
    weight : float
        w, amplitude of the common part; two bands of weights w1, w2 have the coherence w1 w2.
    gain, gamma : float
    common : Layer or None
        In place of the scene's common texture (real rasters: one per band).
    """

    own: TextureLayer | None
    weight: float = 1.0
    gain: float = 1.0
    gamma: float = 1.0
    common: TextureLayer | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything in front of the cameras.

    Parameters
    ----------
    texture : Layer
        Common texture, relative to the mean brightness (its standard deviation is the contrast).
    bands : tuple of BandShine
    relief : Relief or None
        None: the plane z = 0.
    clouds : Clouds or None
    blank : tuple of (float, float)
        m, stretches of y whose ground has no texture at all (water, snow).
    blank_edge : float
        m, width of their border.
    """

    texture: TextureLayer
    bands: tuple[BandShine, ...]
    relief: Relief | None = None
    clouds: Clouds | None = None
    blank: tuple[tuple[float, float], ...] = ()
    blank_edge: float = 20.0

    def ground_brightness(self, band: int, x: Array, y: Array) -> Array32:
        """Brightness in one band, in units of the mean, of ground places `x`, `y` (one shape)."""
        shine = self.bands[band]
        common = self.texture if shine.common is None else shine.common
        relative = np.float32(shine.weight) * common.at(x, y)
        if shine.own is not None:
            relative += np.float32(np.sqrt(1.0 - shine.weight**2)) * shine.own.at(x, y)
        if self.blank:
            relative *= 1.0 - stretch_weight(x, y, self.blank, self.blank_edge)
        value = np.maximum(1.0 + relative, np.float32(0.02))
        if shine.gamma != 1.0:
            value = value ** np.float32(shine.gamma)
        return value * np.float32(shine.gain)


def mtf_at(frequency_px: Array, at_nyquist: float) -> Array:
    """Gaussian system MTF at `frequency_px` (cycles per pixel), `at_nyquist` at half a cycle per pixel."""
    return np.asarray(at_nyquist ** ((np.asarray(frequency_px) / 0.5) ** 2), dtype=np.float64)


@dataclass(frozen=True)
class TextureLaw:
    """The law of a ground texture: 1/f^2 power, a contrast, the system's MTF.

    Parameters
    ----------
    contrast : float
        Standard deviation over mean, of the image.
    gsd : (float, float)
        m of one pixel along x and y.
    mtf_nyquist : float
        System MTF at the Nyquist frequency of lines and of columns.
    outer_scale_px : float
        Periods longer than this add no further power.
    """

    contrast: float
    gsd: tuple[float, float]
    mtf_nyquist: float = 0.15
    outer_scale_px: float = OUTER_SCALE_PX

    def psd(self, fx: Array, fy: Array) -> Array:
        """Two-sided density, m^2, at `fx`, `fy` cycles/m (broadcast).

        Notes
        -----
        In cycles per pixel, S = A / (f^2 + f0^2) x MTF(fx)^2 MTF(fy)^2; with MTF^2 = exp(-a f^2) the
        variance is A pi e^(a f0^2) E1(a f0^2), which is set to the square of the contrast.
        """
        from scipy.special import exp1

        decay = -8.0 * np.log(self.mtf_nyquist)
        floor = 1.0 / self.outer_scale_px**2
        amplitude = self.contrast**2 / (np.pi * np.exp(decay * floor) * exp1(decay * floor))
        px, py = fx * self.gsd[0], fy * self.gsd[1]
        radius = px**2 + py**2
        # density per (cycle/m)^2 is that per (cycle/px)^2 times the pixel's area
        return np.asarray(amplitude * self.gsd[0] * self.gsd[1] * np.exp(-decay * radius) / (radius + floor))


def layer_shape(
    extent: Extent, spacing: tuple[float, float], largest: int, stretch: float = 1.0
) -> tuple[int, int]:
    """Rows and columns of a layer over `extent`, no side above `largest` (the layer repeats beyond).

    `stretch` makes the periods of the several layers of a scene incommensurate, so that no combination of
    them comes back within the scene.
    """
    from scipy.fft import next_fast_len

    width, height = extent.size
    columns, rows = (
        next_fast_len(int(np.ceil(min(length / step, largest) * stretch)) + 8, real=True)
        for length, step in ((width, spacing[0]), (height, spacing[1]))
    )
    return rows, columns


def random_relief(
    seed: np.random.SeedSequence,
    extent: Extent,
    rms: float,
    posting: float = POSTING,
    outer_scale: float = 5000.0,
    slope: float = 5.0,
) -> Relief:
    """Hills with a power-law spectrum.

    Parameters
    ----------
    seed : numpy.random.SeedSequence
    extent : Extent
    rms : float
        m, of the heights about their mean (which is zero) over the extent.
    posting : float
        m
    outer_scale : float
        m, period beyond which the spectrum is flat.
    slope : float
        The two-dimensional power falls as frequency to minus this; 5 gives slopes of
        ``2 pi sqrt(2) rms / outer_scale`` (0.53 for 300 m over 5 km).
    """
    width, height = extent.size
    rows, columns = int(np.ceil(height / posting)) + 1, int(np.ceil(width / posting)) + 1
    # a table twice as long as the extent keeps its periodicity out of sight
    shape = (2 * rows, 2 * columns)
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal(shape))
    fx = np.fft.rfftfreq(shape[1], posting)[None, :]
    fy = np.fft.fftfreq(shape[0], posting)[:, None]
    power = (fx**2 + fy**2 + 1.0 / outer_scale**2) ** (-0.5 * slope)
    power[0, 0] = 0.0
    heights = np.fft.irfft2(spectrum * np.sqrt(power), shape)[:rows, :columns]
    heights -= heights.mean()
    heights *= rms / heights.std()
    return Relief(heights, extent.west, extent.south + (rows - 1) * posting, (posting, posting))


def scattered_clouds(
    seed: np.random.SeedSequence,
    extent: Extent,
    cover: float,
    gsd: tuple[float, float],
    *,
    height: float = 2000.0,
    wind: tuple[float, float] = (8.0, 5.0),
    size_px: float = 150.0,
    banks: tuple[tuple[float, float], ...] = (),
) -> Clouds:
    """Clouds over a share `cover` (0-1, on average) of the extent, of typical size `size_px` pixels.

    Their tops have a texture of contrast 0.04; `banks` as in :class:`Clouds`.
    """
    from scipy.special import ndtri

    if not 0.0 <= cover < 1.0:
        raise InputError(f"`cover` must lie in [0, 1), got {cover:g}; it is the cloudy share of the scene")
    shape_seed, top_seed = seed.spawn(2)
    spacing = (4.0 * gsd[0], 4.0 * gsd[1])
    around = extent.grown(0.02 * height + 50.0)
    bend = 1.0 / (np.pi * size_px * float(np.sqrt(gsd[0] * gsd[1])))

    def thickness_psd(fx: Array, fy: Array) -> Array:
        # Matern-like, power 4.5: integral of (1 + f^2/b^2)^-2.25 over the plane is pi b^2 / 1.25
        return np.asarray(1.25 / (np.pi * bend**2) * (1.0 + (fx**2 + fy**2) / bend**2) ** -2.25)

    thickness = None
    if cover > 0.0:
        thickness = random_layer(
            shape_seed,
            layer_shape(around, spacing, 4096),
            spacing,
            thickness_psd,
            (around.west, around.south),
        )
    law = TextureLaw(0.04, gsd)
    fine = (0.5 * gsd[0], 0.5 * gsd[1])
    tops = random_layer(top_seed, layer_shape(around, fine, 2048), fine, law.psd, (around.west, around.south))
    softness = 0.35
    threshold = float(ndtri(1.0 - cover)) - 0.5 * softness if cover > 0.0 else 0.0
    return Clouds(thickness, threshold, softness, tops, height, wind, banks=banks)


def scene_layers(
    seed: np.random.SeedSequence,
    extent: Extent,
    law: TextureLaw,
    weights: tuple[float, ...],
    gains: tuple[float, ...],
    gammas: tuple[float, ...],
    *,
    largest: int = 8192,
) -> tuple[TextureLayer, tuple[BandShine, ...]]:
    """The common texture and, per band, its own part; two bands of `weights` v and w have the coherence v w.

    Layers are sampled at half the pixel. No side of a layer exceeds about `largest` samples: longer scenes
    repeat each layer with a period of its own, so that their combination does not repeat.
    """
    if not all(0.0 < weight <= 1.0 for weight in weights):
        raise InputError(
            f"the coherence of bands must lie in (0, 1], got weights {weights}; it is that of amplitudes"
        )
    spacing = (0.5 * law.gsd[0], 0.5 * law.gsd[1])
    origin = (extent.west, extent.south)
    seeds = seed.spawn(1 + len(gains))
    texture = random_layer(seeds[0], layer_shape(extent, spacing, largest), spacing, law.psd, origin)
    bands = []
    for index, (weight, gain, gamma) in enumerate(zip(weights, gains, gammas, strict=True)):
        own = None
        if weight < 1.0:
            shape = layer_shape(extent, spacing, largest // 2, 1.0 + 0.0371 * (index + 1))
            own = random_layer(seeds[1 + index], shape, spacing, law.psd, origin)
        bands.append(BandShine(own, weight, gain, gamma))
    return texture, tuple(bands)


def relief_at(relief: Relief, x: Array, y: Array) -> NDArray[np.float64]:
    """Bilinear heights of `relief` at places `x`, `y` of any one shape, metres."""
    dx, dy = relief.posting
    rows, columns = relief.heights.shape
    u = np.clip((np.asarray(x) - relief.west) / dx, 0.0, columns - 1.0)
    v = np.clip((relief.north - np.asarray(y)) / dy, 0.0, rows - 1.0)
    j = np.minimum(u.astype(np.intp), columns - 2)
    i = np.minimum(v.astype(np.intp), rows - 2)
    a, b = u - j, v - i
    z = relief.heights
    north = (1.0 - a) * z[i, j] + a * z[i, j + 1]
    south = (1.0 - a) * z[i + 1, j] + a * z[i + 1, j + 1]
    return np.asarray((1.0 - b) * north + b * south, dtype=np.float64)
