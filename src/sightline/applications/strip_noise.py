"""The noise law and the column pattern of a TDI strip, from one raw image and the pixels beside it.

Figures come in digital numbers (DN), as far as the data carry them, and in electrons by a conversion gain
that somebody else measured: one scene bounds it only.

Not here: how each is estimated (``imaging/noise_estimation.py``), reading (``io/hirise_edr.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.imaging.noise_estimation import (
    SMOOTH,
    CodeTable,
    ColumnPattern,
    Estimate,
    LawFit,
    RampNoise,
    RestingNoise,
    WhiteNoise,
    column_pattern,
    fit_law,
    measure_blocks,
    ramp_noise,
    resting_noise,
    white_noise,
)
from sightline.imaging.tdi_noise import NoiseLaw

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]

#: Lines after the ramp that are not used, and columns at either end of a channel (the response falls there).
SETTLING, EDGES = 30, (16, 8)
#: Of the dark columns the first are lit by the image; the last few are the darkest.
LIT, DARKEST = 1, 4
#: Lines, just behind the calibration lines, whose dark level is compared with theirs.
FIRST_LINES = 100


@dataclass(frozen=True, eq=False)
class StripPixels:
    """Codes of a strip and of what was read beside it.

    Attributes
    ----------
    table : CodeTable
    image, buffer, dark : (lines, columns | buffer columns | dark columns) uint8
    reverse, reverse_buffer, reverse_dark : (reverse lines, same) uint8
        Lines without charge, read just before.
    ramp : (ramp lines, columns) uint8
        Lines in which the TDI fills.
    """

    table: CodeTable
    image: Codes
    buffer: Codes
    dark: Codes
    reverse: Codes
    reverse_buffer: Codes
    reverse_dark: Codes
    ramp: Codes


@dataclass(frozen=True, eq=False)
class StripNoise:
    """What a strip says of its noise, DN.

    Attributes
    ----------
    buffer, dark : RestingNoise
        Empty pixels, and masked detectors.
    white : WhiteNoise
        Of the image; its `signal` is above the dark level here.
    ramp : RampNoise
    law, plain : LawFit
        A, B, C^2 of the sum by read noise, image and ramp; and B, C^2 if there is no gain noise (A = 0).
    columns : ColumnPattern
    offsets : Estimate
        What `columns` would show if columns differed by their offsets only, coding of these included.
    dark_signal : Estimate
        Level of the darkest masked columns above their own without charge: dark current and the tail of the
        image's light.
    dark_shot : Estimate
        Excess variance of masked columns per signal in them: shot noise, if that signal is charge.
    percentiles : (3,) float64
        1, 50 and 99 % of the image's signal.
    ceiling : float
        Largest signal that has a code.
    """

    buffer: RestingNoise
    dark: RestingNoise
    white: WhiteNoise
    ramp: RampNoise
    law: LawFit
    plain: LawFit
    columns: ColumnPattern
    offsets: Estimate
    dark_signal: Estimate
    dark_shot: Estimate
    percentiles: Array
    ceiling: float


def estimate_strip_noise(pixels: StripPixels) -> StripNoise:
    """All figures of a strip.

    Raises
    ------
    EstimationError
        If a part does not show its noise.
    """
    table = pixels.table
    values, rounding = table.values(pixels.image), table.rounding(pixels.image)
    level = _level(table, pixels.reverse)
    buffer = resting_noise(pixels.buffer, table)
    masked = resting_noise(pixels.dark[:, LIT:], table)
    drift = _drift(pixels, buffer)
    signal = values - level - drift[:, None]
    use = (slice(SETTLING, None), slice(EDGES[0], values.shape[1] - EDGES[1]))
    white = white_noise(measure_blocks(values[use], rounding[use]))
    white = WhiteNoise(
        float(np.nanmean(signal[use])), white.variance, white.bound, white.slope, white.covariance
    )
    rising = pixels.ramp[1:, use[1]]
    ramp = ramp_noise(table.values(rising) - level[use[1]], table.rounding(rising), buffer.pooled.value**2)
    charge = masked.level - _level(table, pixels.reverse_dark)[LIT:] - drift[:, None]
    return StripNoise(
        buffer,
        masked,
        white,
        ramp,
        *_laws(buffer.pooled, white, ramp),
        # less one level for all columns: that of each is known to some DN, as large as the pattern itself
        column_pattern((values - level.mean() - drift[:, None])[SETTLING:], edges=EDGES),
        _offsets(table, pixels.reverse, white.signal),
        _dark_signal(table, charge),
        _dark_shot(buffer.pooled, masked, charge),
        np.nanpercentile(signal[use], [1.0, 50.0, 99.0]),
        float(np.nanmax(table.upper) - level.mean()),
    )


def _level(table: CodeTable, codes: Codes) -> Array:
    """Of lines without charge, less the first and the last."""
    return np.asarray(np.nanmean(table.values(codes[1:-1]), axis=0))


def _offsets(table: CodeTable, reverse: Codes, signal: float) -> Estimate:
    values = table.values(reverse[1:-1])
    return column_pattern(values - np.nanmean(values) + signal, parts=4, edges=EDGES).variance


def _drift(pixels: StripPixels, buffer: RestingNoise) -> Array:
    """Level of the empty pixels of each line above that of the lines without charge."""
    above = buffer.level - _level(pixels.table, pixels.reverse_buffer)
    known = np.isfinite(above).any(axis=1)
    lines = np.arange(len(above))
    return np.asarray(np.interp(lines, lines[known], np.nanmean(above[known], axis=1)))


def _laws(resting: Estimate, white: WhiteNoise, ramp: RampNoise) -> tuple[LawFit, LawFit]:
    s = white.signal
    covariance = np.diag(
        [
            (2.0 * resting.value * resting.sigma) ** 2,
            white.variance.sigma**2,
            white.slope.sigma**2,
            ramp.shot.sigma**2,
        ]
    )
    covariance[1, 2] = covariance[2, 1] = white.covariance
    rows = np.array([[0.0, 0.0, 1.0], [s * s, s, 1.0], [2.0 * s, 1.0, 0.0], [0.0, 1.0, 0.0]])
    measured = [resting.value**2, white.variance.value, white.slope.value, ramp.shot.value]
    return fit_law(rows, measured, covariance), fit_law(rows[:, 1:], measured, covariance)


def _dark_signal(table: CodeTable, charge: Array) -> Estimate:
    each = np.nanmean(charge[:FIRST_LINES, -DARKEST:], axis=0)
    # the level without charge is the mean of a few lines of codes: off by up to half a step per column
    rounding = np.nanmin(table.upper - table.lower) / np.sqrt(12.0 * DARKEST)
    return Estimate(float(each.mean()), float(np.hypot(rounding, each.std(ddof=1) / np.sqrt(DARKEST))))


def _dark_shot(resting: Estimate, masked: RestingNoise, charge: Array) -> Estimate:
    signal = float(np.nanmean(charge))
    excess = masked.pooled.value**2 - resting.value**2
    sigma = 2.0 * np.hypot(masked.pooled.value * masked.pooled.sigma, resting.value * resting.sigma)
    return Estimate(excess / signal, float(sigma) / signal)


@dataclass(frozen=True)
class Figure:
    """A printed figure: a value with its sigma, or a bound of 2 sigma.

    Attributes
    ----------
    name, unit : str
    said : str
        Value and sigma, or "<=" or ">=" and the bound.
    how : str
    """

    name: str
    unit: str
    said: str
    how: str

    def __str__(self) -> str:
        """One line of a table."""
        return f"{self.name:34} {self.said:>20} {self.unit:9} {self.how}"


def noise_law(noise: StripNoise, stages: int, electrons_per_dn: float) -> NoiseLaw:
    """The law of a TDI line in electrons, of a detector that sums charge and reads it once.

    `gain` and `dark` are upper bounds (2 sigma), `shot` is 1 by the meaning of the conversion gain.

    Parameters
    ----------
    noise : StripNoise
    stages : int
        That were summed.
    electrons_per_dn : float
    """
    if stages < 1 or not electrons_per_dn > 0.0:
        raise InputError(f"{stages} stages and {electrons_per_dn:g} electrons per DN; both are above 0")
    return NoiseLaw(
        gain=stages * gain_bound(noise, electrons_per_dn),
        shot=1.0,
        read=0.0,
        dark=max(noise.dark_signal.upper(), 0.0) * electrons_per_dn / stages,
        output=noise.buffer.pooled.value * electrons_per_dn,
        column_fixed=max(noise.columns.variance.value, 0.0),
    )


def gain_bound(noise: StripNoise, electrons_per_dn: float) -> float:
    """Largest A of the sum (2 sigma) if its shot noise is that of a conversion gain."""
    s = noise.white.signal
    rest = noise.white.bound.upper() - noise.buffer.pooled.value**2 - s / electrons_per_dn
    return max(rest, 0.0) / s**2


def conversion_bound(noise: StripNoise) -> float:
    """Least electrons per DN (2 sigma): the image's noise is all read and shot noise."""
    return noise.white.signal / (noise.white.bound.upper() - noise.buffer.pooled.value**2)


def figures(noise: StripNoise, stages: int, electrons_per_dn: float) -> list[Figure]:
    """Every figure with its sigma or as a bound of 2 sigma: of the sum in DN, then in electrons."""
    signal, g, columns = noise.white.signal, electrons_per_dn, noise.columns
    law = noise_law(noise, stages, electrons_per_dn)
    least = conversion_bound(noise)
    read = noise.buffer.pooled
    fit = noise.law.covariance
    tied = float(fit[0, 1] / np.sqrt(fit[0, 0] * fit[1, 1]))
    left = max(columns.single - columns.variance.value, 0.0)
    return [
        _value("read noise C", "DN rms", read, "empty pixels, by lines on either side of codes' edges"),
        _value("noise of masked columns", "DN rms", noise.dark.pooled, "the same; light leaks into them"),
        _value(
            f"image noise at {signal:.0f} DN", "DN^2", noise.white.variance, "high differences, no texture"
        ),
        _bound("image noise", "DN^2", "<=", noise.white.bound.upper(), "high differences as they stand"),
        _value("its slope with signal", "DN", noise.white.slope, "over the few per cent of the scene"),
        _value("shot noise B, ramp", "DN", noise.ramp.shot, "photon transfer while the TDI fills"),
        _value("shot noise B, masked columns", "DN", noise.dark_shot, "if what leaks into them is charge"),
        _bound("shot noise B, image", "DN", "<=", 1.0 / least, "image noise is read and shot noise"),
        _value("B, joint, if A = 0", "DN", noise.plain.estimate(0), "read noise, image and its slope, ramp"),
        _value("B, joint", "DN", noise.law.estimate(1), "the same, A free"),
        _value("A of the sum, joint", "1", noise.law.estimate(0), f"correlation with B {tied:.2f}"),
        _bound("A of the sum", "1", "<=", 1.0 / (least * signal), "image noise if there is no shot noise"),
        _bound("A of the sum", "1", "<=", law.gain / stages, f"if B is that of {g:.4g} e-/DN"),
        _bound("conversion gain", "e-/DN", ">=", least, "by B of the image: Poisson"),
        _value(
            "column pattern A_col", "1", columns.variance, f"common to the strip, < {SMOOTH} columns wide"
        ),
        _value("  parts less than half apart", "1", columns.near, "as the next if it is the detector's"),
        _value("  parts half a strip apart", "1", columns.far, "or more"),
        _bound("  offsets' share of it", "1", "<=", noise.offsets.upper(), "same, of lines without charge"),
        _bound("  scene left in one part", "1", "<=", left, "not in A_col"),
        _value("darkest masked columns", "DN", noise.dark_signal, "above their own level without charge"),
        _value("C_out", "e- rms", read, f"at {g:.4g} e-/DN, whose own error is not known", g),
        _bound("A of a stage", "1", "<=", law.gain, f"{stages} stages, each with a gain of its own"),
        _bound("D", "e-/stage", "<=", law.dark, "integration ratio 1; leaked light included"),
    ]


def _value(name: str, unit: str, estimate: Estimate, how: str, scale: float = 1.0) -> Figure:
    return Figure(name, unit, f"{estimate.value * scale:.4g} +- {estimate.sigma * scale:.2g}", how)


def _bound(name: str, unit: str, relation: str, value: float, how: str) -> Figure:
    return Figure(name, unit, f"{relation} {value:.3g}", how)
