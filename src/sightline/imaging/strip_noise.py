"""The noise law and the column pattern of a TDI strip, from one raw image and the pixels beside it.

Figures come in digital numbers (DN), as far as the data carry them, and in electrons by a conversion gain
that somebody else measured: one scene bounds it only.

Not here: how each is estimated (``imaging/noise_estimation.py``), reading (``io/formats/hirise_edr.py``),
several images and plain ones (``detector_noise.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[np.float64]
Codes = NDArray[np.unsignedinteger[Any]]

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
    image, buffer, dark : (lines, columns | buffer columns | dark columns) uint8 or uint16
    reverse, reverse_buffer, reverse_dark : (reverse lines, same) uint8 or uint16
        Lines without charge, read just before.
    ramp : (ramp lines, columns) uint8 or uint16
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
    level : (columns,) float64
        Of each column without charge.
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
    level: Array


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
    rows = law_rows(white, buffer.pooled, ramp)
    return StripNoise(
        buffer,
        masked,
        white,
        ramp,
        rows.fit(),
        rows.fit(gain=False),
        # less one level for all columns: that of each is known to some DN, as large as the pattern itself
        column_pattern((values - level.mean() - drift[:, None])[SETTLING:], edges=EDGES),
        _offsets(table, pixels.reverse, white.signal),
        _dark_signal(table, charge),
        _dark_shot(buffer.pooled, masked, charge),
        np.nanpercentile(signal[use], [1.0, 50.0, 99.0]),
        float(np.nanmax(table.upper) - level.mean()),
        level,
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


@dataclass(frozen=True, eq=False)
class LawRows:
    """What an image says of A, B and C^2: ``rows @ (A, B, C^2)`` is measured as `values`.

    Attributes
    ----------
    rows : (m, 3)
    values : (m,)
    covariance : (m, m)
    """

    rows: Array
    values: Array
    covariance: Array

    def fit(self, gain: bool = True) -> LawFit:
        """A, B, C^2; without `gain` B and C^2 with A = 0."""
        return fit_law(self.rows if gain else self.rows[:, 1:], self.values, self.covariance)


def law_rows(white: WhiteNoise, resting: Estimate | None, ramp: RampNoise | None = None) -> LawRows:
    """Rows of an image's white noise and its slope, and, where known, of the noise at rest and of a ramp."""
    s = white.signal
    rows = [[s * s, s, 1.0], [2.0 * s, 1.0, 0.0]]
    values = [white.variance.value, white.slope.value]
    sigmas = [white.variance.sigma, white.slope.sigma]
    if resting is not None:
        rows, values = [[0.0, 0.0, 1.0], *rows], [resting.value**2, *values]
        sigmas = [2.0 * resting.value * resting.sigma, *sigmas]
    if ramp is not None:
        rows, values = [*rows, [0.0, 1.0, 0.0]], [*values, ramp.shot.value]
        sigmas = [*sigmas, ramp.shot.sigma]
    covariance = np.diag(np.square(sigmas))
    at = 0 if resting is None else 1
    covariance[at, at + 1] = covariance[at + 1, at] = white.covariance
    return LawRows(np.array(rows), np.array(values), covariance)


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
class NoiseFigure:
    """A printed figure: a value with its sigma, or a bound of 2 sigma.

    Attributes
    ----------
    name, unit : str
    value : float
        Or the bound.
    sigma : float or None
        None of a bound.
    relation : str
        ``"="``, or ``"<="`` or ``">="`` of a bound.
    how : str
    """

    name: str
    unit: str
    value: float
    sigma: float | None
    relation: str
    how: str

    @property
    def said(self) -> str:
        """Value and sigma, or the bound with its sign."""
        if self.sigma is None:
            return f"{self.relation} {self.value:.3g}"
        return f"{self.value:.4g} +- {self.sigma:.2g}"

    def __str__(self) -> str:
        """One line of a table."""
        return f"{self.name:34} {self.said:>20} {self.unit:9} {self.how}"


def gain_bound(noise: StripNoise, electrons_per_dn: float) -> float:
    """Largest A of the sum (2 sigma) if its shot noise is that of a conversion gain."""
    s = noise.white.signal
    rest = noise.white.bound.upper() - noise.buffer.pooled.value**2 - s / electrons_per_dn
    return max(rest, 0.0) / s**2


def conversion_bound(noise: StripNoise) -> float:
    """Least electrons per DN (2 sigma): the image's noise is all read and shot noise."""
    return noise.white.signal / (noise.white.bound.upper() - noise.buffer.pooled.value**2)


def noise_figures(noise: StripNoise, stages: int, electrons_per_dn: float | None = None) -> list[NoiseFigure]:
    """Every figure with its sigma or as a bound of 2 sigma: of the sum in DN, then in electrons if given."""
    signal, columns = noise.white.signal, noise.columns
    least = conversion_bound(noise)
    read = noise.buffer.pooled
    fit = noise.law.covariance
    tied = float(fit[0, 1] / np.sqrt(fit[0, 0] * fit[1, 1]))
    left = max(columns.single - columns.variance.value, 0.0)
    in_dn = [
        measured_figure(
            "read noise C", "DN rms", read, "empty pixels, by lines on either side of codes' edges"
        ),
        measured_figure(
            "noise of masked columns", "DN rms", noise.dark.pooled, "the same; light leaks into them"
        ),
        measured_figure(
            f"image noise at {signal:.0f} DN", "DN^2", noise.white.variance, "high differences, no texture"
        ),
        bounded_figure(
            "image noise", "DN^2", "<=", noise.white.bound.upper(), "high differences as they stand"
        ),
        measured_figure(
            "its slope with signal", "DN", noise.white.slope, "over the few per cent of the scene"
        ),
        measured_figure("shot noise B, ramp", "DN", noise.ramp.shot, "photon transfer while the TDI fills"),
        measured_figure(
            "shot noise B, masked columns", "DN", noise.dark_shot, "if what leaks into them is charge"
        ),
        bounded_figure("shot noise B, image", "DN", "<=", 1.0 / least, "image noise is read and shot noise"),
        measured_figure(
            "B, joint, if A = 0", "DN", noise.plain.estimate(0), "read noise, image and its slope, ramp"
        ),
        measured_figure("B, joint", "DN", noise.law.estimate(1), "the same, A free"),
        measured_figure("A of the sum, joint", "1", noise.law.estimate(0), f"correlation with B {tied:.2f}"),
        bounded_figure(
            "A of the sum", "1", "<=", 1.0 / (least * signal), "image noise if there is no shot noise"
        ),
        bounded_figure("conversion gain", "e-/DN", ">=", least, "by B of the image: Poisson"),
        measured_figure(
            "column pattern A_col", "1", columns.variance, f"common to the strip, < {SMOOTH} columns wide"
        ),
        measured_figure(
            "  parts less than half apart", "1", columns.near, "as the next if it is the detector's"
        ),
        measured_figure("  parts half a strip apart", "1", columns.far, "or more"),
        bounded_figure(
            "  offsets' share of it", "1", "<=", noise.offsets.upper(), "same, of lines without charge"
        ),
        bounded_figure("  scene left in one part", "1", "<=", left, "not in A_col"),
        measured_figure(
            "darkest masked columns", "DN", noise.dark_signal, "above their own level without charge"
        ),
    ]
    if electrons_per_dn is None:
        return in_dn
    g = electrons_per_dn
    of_sum, dark = gain_bound(noise, g), max(noise.dark_signal.upper(), 0.0) * g / stages
    return [
        *in_dn,
        bounded_figure("A of the sum", "1", "<=", of_sum, f"if B is that of {g:.4g} e-/DN"),
        measured_figure("C_out", "e- rms", read, f"at {g:.4g} e-/DN, whose own error is not known", g),
        bounded_figure(
            "A of a stage", "1", "<=", stages * of_sum, f"{stages} stages, each with a gain of its own"
        ),
        bounded_figure("D", "e-/stage", "<=", dark, "integration ratio 1; leaked light included"),
    ]


def measured_figure(name: str, unit: str, estimate: Estimate, how: str, scale: float = 1.0) -> NoiseFigure:
    """The figure of an estimate, `scale` times it."""
    return NoiseFigure(name, unit, estimate.value * scale, estimate.sigma * scale, "=", how)


def bounded_figure(name: str, unit: str, relation: str, value: float, how: str) -> NoiseFigure:
    """The figure of a bound; `relation` is ``"<="`` or ``">="``."""
    return NoiseFigure(name, unit, value, None, relation, how)
