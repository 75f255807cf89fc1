"""A raw strip of one TDI detector, coded to 8 bits: a random scene, a noise law, a column pattern, and the
pixels beside it that see nothing. What an estimate of the noise is tested on.

Not here: motion (the scene is the image).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.noise_estimation import CodeTable

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]

#: Samples of the scene per pixel and direction: frequencies up to the sampling frequency fold back.
FINE = 2
#: Lines of scene that are left over.
REPEAT = 600
#: Columns of empty and of masked pixels, and lines without charge.
BUFFER, DARK, REVERSE = 12, 16, 20


@dataclass(frozen=True)
class RawStripOptions:
    """What is simulated, in digital numbers (DN).

    Attributes
    ----------
    lines, columns : int
    signal : float
        Mean, above the dark level.
    contrast : float
        Rms of the scene over its mean.
    fall : float
        The scene's power falls as frequency to minus this (2 rough, 4 smooth).
    patchy : float
        Rms of the logarithm of the contrast from place to place.
    shear : float
        How much the scene is drawn out along a diagonal (0: alike in all directions).
    gain, shot, read : float
        Variance A s^2 + B s + C^2 of the sum.
    column_fixed : float
        Variance of the columns' response.
    level, drift : float
        Dark level, and how far it sinks over the strip.
    ramp_lines : int
        Lines in which the signal rises to full.
    """

    lines: int = 2000
    columns: int = 256
    signal: float = 4300.0
    contrast: float = 0.03
    fall: float = 2.7
    patchy: float = 0.3
    shear: float = 0.0
    gain: float = 0.0
    shot: float = 0.05
    read: float = 3.6
    column_fixed: float = 1e-6
    level: float = 1050.0
    drift: float = 30.0
    ramp_lines: int = 12


@dataclass(frozen=True, eq=False)
class RawStrip:
    """Codes of a strip, of what is read beside it, and the table behind them.

    Attributes
    ----------
    image : (lines, columns) uint8
    buffer, dark : (lines, 12 | 16) uint8
        Empty pixels; masked ones, into which light leaks.
    reverse, reverse_buffer, reverse_dark : (20, columns | 12 | 16) uint8
        Lines without charge.
    ramp : (ramp_lines, columns) uint8
    table : CodeTable
    response : (columns,) float64
        Of each column, about 1.
    """

    image: Codes
    buffer: Codes
    dark: Codes
    reverse: Codes
    reverse_buffer: Codes
    reverse_dark: Codes
    ramp: Codes
    table: CodeTable
    response: Array


def two_step_table() -> CodeTable:
    """Steps of 18 DN up to 1,300 and of 28.6 above, as of a stored table of HiRISE."""
    edges = np.concatenate([np.arange(808.5, 1300.0, 17.85), np.arange(1301.5, 7400.0, 28.6)])[:254]
    edges = np.round(edges - 0.5) + 0.5
    lower, upper = np.full(256, np.nan), np.full(256, np.nan)
    lower[1 : len(edges)], upper[1 : len(edges)] = edges[:-1], edges[1:]
    return CodeTable(lower, upper)


def simulate_raw_strip(seed: int, options: RawStripOptions | None = None) -> RawStrip:
    """A strip by one seed."""
    o = options or RawStripOptions()
    rng = np.random.default_rng(seed)
    scene = _scene(rng, o.lines + o.ramp_lines, o)
    response = 1.0 + np.sqrt(o.column_fixed) * rng.standard_normal(o.columns)
    rise = np.arange(1, o.ramp_lines + 1)[:, None] / o.ramp_lines
    full = o.signal * (1.0 + scene) * response
    start = o.level + 0.5 * o.drift
    drift = start - o.drift * np.linspace(0.0, 1.0, o.lines)[:, None]
    # each column of empty or masked pixels has an offset of its own, half a step of the table either way
    buffer, dark = rng.uniform(-9.0, 9.0, BUFFER), rng.uniform(-9.0, 9.0, DARK)
    leak = 100.0 * np.exp(-np.arange(DARK) / 5.0) + 40.0
    table = two_step_table()

    def coded(signal: Array, level: Array | float) -> Codes:
        variance = o.gain * signal**2 + o.shot * np.maximum(signal, 0.0) + o.read**2
        value = signal + level + np.sqrt(variance) * rng.standard_normal(signal.shape)
        return _encode(np.round(value), table)

    return RawStrip(
        coded(full[o.ramp_lines :], drift),
        coded(np.zeros((o.lines, BUFFER)), drift + buffer),
        coded(np.tile(leak, (o.lines, 1)), drift + dark),
        coded(np.zeros((REVERSE, o.columns)), start),
        coded(np.zeros((REVERSE, BUFFER)), start + buffer),
        coded(np.zeros((REVERSE, DARK)), start + dark),
        coded(full[: o.ramp_lines] * rise, start),
        table,
        response,
    )


def _encode(values: Array, table: CodeTable) -> Codes:
    usable = np.flatnonzero(np.isfinite(table.lower))
    at = np.searchsorted(table.lower[usable], values, side="right") - 1
    codes = usable[np.clip(at, 0, len(usable) - 1)]
    codes[(at < 0) | (values > table.upper[usable[-1]])] = 255
    return codes.astype(np.uint8)


def _scene(rng: np.random.Generator, lines: int, o: RawStripOptions) -> Array:
    """(lines, columns) relative brightness, seen through square pixels."""
    # the scene repeats itself: what is left over keeps its two ends apart
    shape = ((lines + REPEAT) * FINE, (o.columns + REPEAT // 4) * FINE)
    fy, fx = np.fft.fftfreq(shape[0])[:, None] * FINE, np.fft.rfftfreq(shape[1])[None, :] * FINE
    squared = fy**2 + fx**2 + 1.6 * o.shear * fy * fx + (1.0 / 300.0) ** 2
    amplitude = squared ** (-0.25 * o.fall) * np.sinc(fy) * np.sinc(fx)
    noise = np.fft.rfft2(rng.standard_normal(shape))
    noise[0, 0] = 0.0
    scene = np.fft.irfft2(noise * amplitude, s=shape)[::FINE, ::FINE]
    calm = np.fft.irfft2(noise * np.exp(-((60.0 * np.hypot(fy, fx)) ** 2)), s=shape)[::FINE, ::FINE]
    scene = scene * np.exp(o.patchy * calm[::-1] / calm.std())
    scene = scene[:lines, : o.columns]
    return np.asarray(o.contrast * scene / scene.std())
