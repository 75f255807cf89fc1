"""Photon transfer: what frames of even light, two or more of each exposure, say of a detector.

The variance between frames of one exposure is that of the noise, whatever the fixed pattern; its slope with
the signal is the conversion gain, DN per electron (EMVA 1288). The scatter of the pixels of their mean, less
what noise leaves in it, is the fixed pattern. Frames are read one after the other; only sums are kept.

Not here: which frames show the same exposure, the law that TDI takes (``applications/photon_transfer.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.imaging.noise_estimation import PARTS, Estimate, LawFit, fit_law
from sightline.imaging.source import ImageSource, usable_lines

Array = NDArray[np.float64]

#: Pixels that are worked on at once.
AT_ONCE = 1 << 22
#: Share of the saturation up to which the noise is compared with the signal (EMVA 1288).
LINEAR_SHARE = 0.7
#: Sigmas by which a fall of the noise is a saturation, and by which columns differ.
SIGNIFICANT = 3.0
#: Pairs of frames from which their scatter says how well the noise is known.
ENOUGH_PAIRS = 4


@dataclass(frozen=True, eq=False)
class Stack:
    """What frames of one exposure show, DN; the level of each frame is taken off before they are compared.

    Attributes
    ----------
    frames : int
    lines : int
    mean : float
    noise : Estimate
        Variance between frames, rounding included.
    rows : Estimate
        The part of it that the pixels of a row share.
    fixed : Estimate
        Variance over pixels of what all frames have in common, shading included.
    pixels : Estimate
        The part of it that neither rows, columns nor a shading have: of mixed differences of neighbours.
    column_noise : (columns,)
        `noise` of each column; NaN of one without values.
    column_means : (PARTS, columns)
        Mean in parts of the frame.
    cut : float
        Share of pixels that were left out.
    freedom : int
        Degrees of freedom of the noise of a pixel.
    """

    frames: int
    lines: int
    mean: float
    noise: Estimate
    rows: Estimate
    fixed: Estimate
    pixels: Estimate
    column_noise: Array
    column_means: Array
    cut: float
    freedom: int

    def columns(self) -> Array:
        """Mean of each column, (columns,)."""
        return np.asarray(np.nanmean(self.column_means, axis=0))

    def column_sigma(self) -> float:
        """Sigma of the mean of a column: noise that is left, and the pattern of its pixels."""
        pattern = max(self.pixels.value, 0.0)
        return float(np.sqrt((self.noise.value / self.frames + pattern) / self.lines))


def measure_stack(
    frames: Sequence[ImageSource], means: Sequence[float], low: float, high: float, dead: NDArray[np.bool_]
) -> Stack:
    """Noise and fixed pattern of two frames of one exposure or more, all of one size.

    Parameters
    ----------
    frames : sequence of ImageSource
    means : sequence of float
        Of each frame, DN.
    low, high : float
        At which pixels are cut off: one that is so in any frame is left out of all.
    dead : (columns,) bool
        Columns that are left out.
    """
    n, (lines, columns) = len(frames), frames[0].shape
    level = float(np.mean(means))
    row_means = np.zeros((n, lines))
    column_sums, column_count = np.zeros((n, columns)), np.zeros(columns)
    row_noise, column_noise = np.zeros(lines), np.zeros(columns)
    part_sums, part_count = np.zeros((PARTS, columns)), np.zeros((PARTS, columns))
    row_count = np.zeros(lines)
    pairs, squares, total = np.zeros(n // 2), 0.0, 0.0
    mixed, mixed_count = 0.0, 0
    part_of = np.arange(lines) * PARTS // lines
    # a difference is kept of each pair until all frames have said which pixels are good
    size = max(AT_ONCE // (columns * max(n // 2, 1)), 2)
    for first in range(0, lines, size):
        here = slice(first, min(first + size, lines))
        shape = (here.stop - here.start, columns)
        summed, squared, odd = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        good = np.broadcast_to(~dead, shape).copy()
        differences = []
        previous = None
        for number, frame in enumerate(frames):
            values = usable_lines(frame, here.start, here.stop)
            good &= np.isfinite(values) & (values > low) & (values < high)
            values = np.nan_to_num(values - means[number])
            summed += values
            odd += values * (number % 2)
            squared += values**2
            # a pixel that a later frame leaves out counts here: its share is small
            row_means[number, here] = (values * good).sum(axis=1)
            column_sums[number] += (values * good).sum(axis=0)
            if number % 2 and previous is not None:
                differences.append((number // 2, values - previous))
            previous = values
        for number, difference in differences:
            pairs[number] += float((difference[good] ** 2).sum()) / 2.0
        between = np.where(good, (squared - summed**2 / n) / (n - 1), 0.0)
        common = np.where(good, summed / n, 0.0)
        row_count[here], row_noise[here] = good.sum(axis=1), between.sum(axis=1)
        column_count += good.sum(axis=0)
        column_noise += between.sum(axis=0)
        total, squares = total + float(common.sum()), squares + float((common**2).sum())
        for part in np.unique(part_of[here]):
            mine = part_of[here] == part
            part_sums[part] += common[mine].sum(axis=0)
            part_count[part] += good[mine].sum(axis=0)
        whole = good[1:, 1:] & good[1:, :-1] & good[:-1, 1:] & good[:-1, :-1]
        # of frames that share no noise, which need not be alike from pixel to pixel
        one, other = (_corners(half)[whole] for half in (odd / (n // 2), (summed - odd) / (n - n // 2)))
        mixed, mixed_count = mixed + float(one @ other), mixed_count + int(whole.sum())
    count = column_count.sum()
    if count < 4 or mixed_count == 0:
        raise EstimationError("no pixels are left that are not cut off; give frames of less light")
    with np.errstate(divide="ignore", invalid="ignore"):
        row_means, of_rows = row_means / row_count, row_noise / row_count
        of_columns, column_means = column_noise / column_count, column_sums / column_count
        parts = part_sums / part_count
    noise = float(column_noise.sum() / count)
    white = 2.0 * noise**2 / (count * (n - 1))
    error = _of_mean(of_rows) + _of_mean(of_columns) - white
    pairs /= count
    if len(pairs) >= ENOUGH_PAIRS:
        error = max(error, float(pairs.var(ddof=1)) / len(pairs))
    row = _shared(row_means, noise / columns)
    column = _shared(column_means, noise / lines)
    mean = float(total / count)
    scatter = float(squares / count) - mean**2
    left = noise / n
    corner = mixed / (4.0 * mixed_count)
    # fixed pattern x noise, noise x noise; rows (columns) that jump together are as many as there are rows
    spread = (4.0 * max(scatter - left, 0.0) * left + 2.0 * left**2 * n / (n - 1)) / count
    for part, size_of, fixed in (
        (row, lines, row_means.mean(axis=0)),
        (column, columns, column_means.mean(axis=0)),
    ):
        jumps = max(part.value, 0.0) / n
        spread += (4.0 * float(np.nanvar(fixed)) * jumps + 2.0 * jumps**2 * n / (n - 1)) / size_of
    # mixed differences of neighbours share pixels: 36 / 16 times as much scatter as of as many pixels
    of_odd, of_even = noise / (n // 2), noise / (n - n // 2)
    of_corner = 2.25 * (of_odd * of_even + max(corner, 0.0) * (of_odd + of_even)) / count
    return Stack(
        n,
        lines,
        level + mean,
        Estimate(noise, float(np.sqrt(max(error, white)))),
        row,
        Estimate(scatter - left, float(np.sqrt(spread))),
        Estimate(corner, float(np.sqrt(of_corner))),
        of_columns,
        level + parts,
        1.0 - float(count) / (lines * columns),
        n - 1,
    )


def with_noise_of(whole: Stack, parts: Sequence[Stack]) -> Stack:
    """A stack of unlike exposures with the noise of each by itself, by degrees of freedom."""
    freedom = np.array([one.freedom for one in parts])
    share = freedom / freedom.sum()

    def together(each: Sequence[Estimate]) -> Estimate:
        value = float(share @ [one.value for one in each])
        return Estimate(value, float(np.linalg.norm(share * [one.sigma for one in each])))

    noise = together([one.noise for one in parts])
    # of the fixed pattern too much was taken off as noise
    fixed = whole.fixed.value + (whole.noise.value - noise.value) / whole.frames
    return replace(
        whole,
        noise=noise,
        rows=together([one.rows for one in parts]),
        fixed=Estimate(fixed, whole.fixed.sigma),
        column_noise=share @ np.stack([one.column_noise for one in parts]),
        freedom=int(freedom.sum()),
    )


def _corners(values: Array) -> Array:
    """Mixed differences of neighbours: no row, no column and no shading is left in them."""
    return values[1:, 1:] - values[1:, :-1] - values[:-1, 1:] + values[:-1, :-1]


def _of_mean(values: Array) -> float:
    """Variance of the mean of numbers."""
    known = values[np.isfinite(values)]
    return float(known.var(ddof=1)) / len(known) if len(known) > 1 else 0.0


def _shared(means: Array, white: float) -> Estimate:
    """Variance between frames (frames, rows) of what a row shares; `white` is that of its own pixels."""
    n = len(means)
    each = means.var(axis=0, ddof=1)
    known = each[np.isfinite(each)]
    # the level of each frame is taken off its rows
    value = float(known.mean()) * len(known) / max(len(known) - 1, 1)
    return Estimate(value - white, value * float(np.sqrt(2.0 / (len(known) * (n - 1)))))


def usable_stacks(
    signals: Array, stacks: Sequence[Stack], saturated: bool
) -> tuple[NDArray[np.bool_], int | None]:
    """Which exposures the slope is taken from, and which of them saturates, if one does.

    The saturation is where the noise is largest, if it falls above that, or if brighter exposures are cut off
    (`saturated`); exposures up to 70 % of it are used.
    """
    noise = np.array([one.noise.value for one in stacks])
    sigma = np.array([one.noise.sigma for one in stacks])
    if not noise.size:
        return np.zeros(0, dtype=bool), None
    top = int(np.argmax(noise))
    falls = (signals > signals[top]) & (noise < noise[top] - SIGNIFICANT * np.hypot(sigma, sigma[top]))
    if not (saturated or falls.any()):
        return np.ones(len(noise), dtype=bool), None
    return np.asarray(signals <= LINEAR_SHARE * signals[top]), top


@dataclass(frozen=True, eq=False)
class TransferFit:
    """The variance B s + C^2 of the noise, DN.

    Attributes
    ----------
    fit : LawFit
        B and C^2; B alone where nothing parts them.
    weights : (exposures,)
        B is the sum of them times each exposure's variance above the one without light.
    misfit : float
        Departure of the variance over the signal from one exposure to the next beyond its noise, DN rms.
    """

    fit: LawFit
    weights: Array
    misfit: float


def fit_transfer(signals: Array, noise: Sequence[Estimate], resting: Estimate | None) -> TransferFit:
    """The noise over the signal of several exposures, and without light where that was measured.

    What the codes' unequal steps do to one exposure and not to the next scatters in proportion to the
    signal: where the noise does not explain the scatter, it is estimated and enters the weights and sigma.
    """
    rows = np.stack([signals, np.ones(len(signals))], axis=1)
    values = np.array([one.value for one in noise])
    variance = np.array([one.sigma**2 for one in noise])
    scaled = signals**2
    if resting is not None:
        rows, values = np.vstack([rows, [0.0, 1.0]]), np.append(values, resting.value)
        variance, scaled = np.append(variance, resting.sigma**2), np.append(scaled, 0.0)
    if len(values) < 2:
        rows = rows[:, :1]

    def solve(misfit: float) -> tuple[LawFit, float]:
        covariance = variance + misfit * scaled
        fit = fit_law(rows, values, np.diag(covariance))
        return fit, float(((values - rows @ fit.coefficients) ** 2 / covariance).sum())

    free = len(values) - rows.shape[1]
    fit, chi_square = solve(0.0)
    low, high = 0.0, 1e-12
    if chi_square > free > 0:
        while solve(high)[1] > free and high < 1e12:
            high *= 10.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if solve(middle)[1] > free else (low, middle)
        fit, _ = solve(high)
        low = high
    weight = signals / (variance[: len(signals)] + low * signals**2)
    return TransferFit(fit, weight / float(weight @ signals), float(np.sqrt(low)))


@dataclass(frozen=True)
class Alike:
    """Whether columns differ.

    Attributes
    ----------
    chi_square : float
    freedom : int
    scatter : float
        Root mean square of what is beyond their sigma.
    upper : float
        Its upper limit, 2 sigma.
    """

    chi_square: float
    freedom: int
    scatter: float
    upper: float

    @property
    def alike(self) -> bool:
        """Nothing beyond their sigma is seen, at 3 sigma."""
        return self.chi_square <= self.freedom + SIGNIFICANT * float(np.sqrt(2.0 * self.freedom))


def compare_columns(values: Array, sigma: Array | float, free: int = 1) -> Alike:
    """Compare columns whose values have independent errors; NaN is left out, `free` terms were fitted."""
    errors = np.broadcast_to(sigma, values.shape)
    known = np.isfinite(values) & np.isfinite(errors) & (errors > 0.0)
    kept, errors = values[known], errors[known]
    freedom = max(len(kept) - free, 1)
    weight = errors**-2
    mean = float(weight @ kept / weight.sum()) if len(kept) else 0.0
    chi_square = float((weight * (kept - mean) ** 2).sum())
    typical = float(np.mean(errors**2)) / freedom if len(kept) else 0.0
    excess = chi_square - freedom
    spread = 2.0 * float(np.sqrt(2.0 * freedom)) * max(chi_square / freedom, 1.0)
    return Alike(
        chi_square,
        freedom,
        float(np.sqrt(max(excess, 0.0) * typical)),
        float(np.sqrt(max(excess + spread, 0.0) * typical)),
    )


def same_exposure(means: Array, tolerance: Array) -> list[list[int]]:
    """Frames by exposure: those whose means, in their order, are no further apart than the tolerance."""
    order = np.argsort(means, kind="stable").tolist()
    groups = [[order[0]]]
    for before, after in pairwise(order):
        if means[after] - means[before] > max(tolerance[before], tolerance[after]):
            groups.append([])
        groups[-1].append(after)
    return [sorted(group) for group in groups]
