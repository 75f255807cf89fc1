"""What brightness tells of windows that saw a cloud in place of the ground.

Clouds are bright, and so are some fields. Whether brightness tells of foreign motion is learned from the
strip: within a row of windows motion can only shift and tilt, so that what bright windows depart by from
dark ones of their row is no motion, whichever of the two is the ground. A row that is all cloud shows no
such difference; there flat white, in which nothing can be matched, gives the cloud away, and bright windows
about it are not believed. Nor is white of which few rows show that it departs; and, in strips too narrow for
rows to show it, white of which they do not show the contrary: the motion would take the cloud's shift. All of
it costs bright ground near clouds, and nothing where there are none but white ground of narrow strips.

Not here: what the departures of single windows tell (``consensus.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Rows of windows need this many blocks to tell foreign motion from that of the row.
MIN_BLOCKS = 4
#: Brightnesses at which windows are split into bright and dark, tried from end to end of what there is; the
#: least number of windows on either side.
SPLITS, LEAST_WINDOWS = 20, 40
#: Lines that a stretch of the strip has at least: windows of one cloud, or of one hill, err alike.
STRETCH = 54.0
#: A difference between bright and dark is believed beyond so many standard errors over stretches (of 40 tests
#: with 15 degrees of freedom one strip of plain ground in 150 gets there by chance), of which there are at
#: most so many, and at least so many that tell.
CERTAIN, MOST_STRETCHES, LEAST_STRETCHES = 5.0, 16, 4.0
#: A difference below so many sigmas of one window is none of clouds: bright and dark ground are sharpened and
#: matched a little differently, which a whole strip shows to a thirtieth of a sigma.
MATERIAL = 0.5
#: m; nor is one smaller than what a cloud of that height shifts: bright and dark ground of real scenes
#: was seen to differ as if by 25 to 270 m, across the lines too. Wind of 3 m/s shifts as much.
LEAST_CLOUD = 300.0
#: Ground is at most so many of its own sigmas brighter than its median (0.6 % of Gaussian ground is beyond).
USUAL_GROUND = 2.5
#: What is brighter than its median by so many is no ground of the usual kind: white.
WHITE = 5.0
#: White is ground where rows say, to so many sigmas, that it departs by less than clouds do.
VOUCHED = 2.0
#: Flat white lies where white without matches covers more than this share of so many lines to either side;
#: about it, edges of the cloud may be so many lines away.
MOSTLY_WHITE, AREA, ABOUT = 0.5, 26.0, 80.0
#: Lines over which the edge of a cloud fades: whitened matches follow it where it hardly shows any more (a
#: hundredth of a window that is cloud was seen to shift it by a tenth of the cloud's own shift).
FADING = 8.0


@dataclass(frozen=True, eq=False)
class RowShifts:
    """Windows in rows: what each is shifted by.

    Attributes
    ----------
    x : (blocks,)
        Position across the field.
    value, variance : (rows, blocks, 2)
        Shift (px) and its variance.
    seen : (rows, blocks)
        Windows that have one.
    """

    x: Array
    value: Array
    variance: Array
    seen: Flags


def bright_windows(
    shifts: RowShifts,
    brightness: Array,
    matched: Flags,
    step: float,
    per_metre: float,
    elsewhere: Array | None = None,
    *,
    cloudy: bool = False,
) -> tuple[Flags, bool]:
    """Windows (rows, blocks) that are taken for cloud because they, or those next to them, are so bright.

    And whether brightness tells clouds from ground in all of the strip.

    Parameters
    ----------
    shifts : RowShifts
    brightness : (rows, blocks)
        Of the brightest part of each window; NaN where unknown.
    matched : (rows, blocks)
        Windows with any match.
    step : float
        Lines between rows.
    per_metre : float
        px by which a target higher by a metre is shifted.
    elsewhere : (M,), optional
        Brightness of windows of the whole strip, where these are of a part of it; NaN where unknown.
    cloudy : bool
        Whether the rest of the strip is known to show clouds: then white is ground only where rows say so.
    """
    known = np.isfinite(brightness)
    seen = shifts.seen & known
    out = np.zeros(brightness.shape, dtype=bool)
    ground = brightness[seen] if elsewhere is None else _darker(elsewhere[np.isfinite(elsewhere)])
    if len(ground) < 2 * LEAST_WINDOWS or not seen.any():
        return out, False
    brightness = np.where(known, brightness, -np.inf)
    cloud = _departing_brightness(shifts, brightness, seen, step, LEAST_CLOUD * per_metre)
    if cloud is not None:
        out |= brightness > _brightest_ground(ground, cloud)
    white = _flat_white(brightness, ground, matched, step)
    if cloud is None:
        doubted = cloudy or brightness.shape[1] < MIN_BLOCKS
        least_px = LEAST_CLOUD * per_metre
        white |= _white_not_vouched_for(shifts, brightness, ground, seen, least_px, doubted=doubted)
    if white.any():
        about = sum_beside(sum_along(white.astype(float), _rows(ABOUT, step))) > 0
        out |= about & (brightness > _brightest_ground(ground, float(np.median(brightness[white]))))
    return np.asarray(sum_along(out.astype(float), _rows(FADING, step)) > 0), cloud is not None


def _departing_brightness(
    shifts: RowShifts, brightness: Array, seen: Flags, step: float, least_px: float
) -> float | None:
    """Mean brightness of windows that, all over the strip, depart alike, by `least_px`, from darker ones.

    Every split into bright and dark windows gives one difference of their shifts, with level and tilt of
    each row left out; its standard error is that over stretches of the strip (jackknife).
    """
    rows = len(brightness)
    stretches = min(MOST_STRETCHES, int(rows * step / STRETCH))
    if stretches < LEAST_STRETCHES:
        return None
    first = (np.arange(stretches) * rows) // stretches
    low, high = np.quantile(brightness[seen], 0.05), brightness[seen].max()
    best, found = CERTAIN, None
    for component in range(2):
        least = _least_departure(shifts, component, seen, least_px)
        for split in np.linspace(low, high, SPLITS, endpoint=False):
            bright = seen & (brightness > split)
            if not LEAST_WINDOWS <= bright.sum() <= seen.sum() - LEAST_WINDOWS:
                continue
            by_row = _from_others_of_row(shifts, component, seen, bright)
            moved, size = (np.add.reduceat(sums, first) for sums in by_row)
            if size.sum() ** 2 <= LEAST_STRETCHES * (size**2).sum():
                continue
            without_one = (moved.sum() - moved) / (size.sum() - size)
            error = float(np.sqrt((stretches - 1) * without_one.var()))
            difference = abs(moved.sum() / size.sum())
            if difference > least and difference > best * error:
                best, found = difference / max(error, 1e-30), float(brightness[bright].mean())
    return found


def _white_not_vouched_for(
    shifts: RowShifts, brightness: Array, ground: Array, seen: Flags, least_px: float, *, doubted: bool
) -> Flags:
    """Windows far brighter than ground, unless rows say that they depart by less than clouds do.

    Where nothing else casts doubt on them rows must show that they depart at all.
    """
    median, spread = _median_and_spread(ground)
    white = seen & (brightness > median + WHITE * spread)
    for component in range(2):
        moved, size = (float(sums.sum()) for sums in _from_others_of_row(shifts, component, seen, white))
        least = _least_departure(shifts, component, seen, least_px)
        shown = abs(moved) > CERTAIN * math.sqrt(size)
        if (doubted or shown) and abs(moved) + VOUCHED * math.sqrt(size) >= least * size:
            return white
    return np.zeros_like(white)


def _least_departure(shifts: RowShifts, component: int, seen: Flags, least_px: float) -> float:
    """px by which clouds depart at least: `least_px`, or by how much ground differs from ground."""
    sigma = math.sqrt(float(np.median(shifts.variance[seen, component])))
    return max(MATERIAL * sigma, least_px)


def _from_others_of_row(shifts: RowShifts, component: int, seen: Flags, bright: Flags) -> tuple[Array, Array]:
    """What windows `bright` depart by from others of their row: information (rows,) times shift, and itself.

    With level and tilt of each row left out.
    """
    weight = np.where(seen, 1.0 / shifts.variance[..., component], 0.0)
    value = _without_line(shifts.value[..., component], weight, shifts.x)
    jump = _without_line(bright.astype(float), weight, shifts.x)
    return (weight * jump * value).sum(axis=1), (weight * jump**2).sum(axis=1)


def _flat_white(brightness: Array, ground: Array, matched: Flags, step: float) -> Flags:
    """Windows in the midst of what is far brighter than ground and cannot be matched."""
    median, spread = _median_and_spread(ground)
    white = ~matched & (brightness > median + WHITE * spread)
    reach = _rows(AREA, step)
    around = sum_beside(sum_along(white.astype(float), reach))
    return np.asarray(white & (around > MOSTLY_WHITE * sum_beside(sum_along(np.ones(white.shape), reach))))


def _without_line(values: Array, weight: Array, x: Array) -> Array:
    """Values (rows, blocks) less the weighted line through each row; zero where a row has none."""
    s0, s1, s2 = weight.sum(1), (weight * x).sum(1), (weight * x * x).sum(1)
    y0, y1 = (weight * values).sum(1), (weight * x * values).sum(1)
    det = s0 * s2 - s1**2
    laid = det > 1e-6 * s0 * s0
    det = np.where(laid, det, 1.0)
    level, slope = (s2 * y0 - s1 * y1) / det, (s0 * y1 - s1 * y0) / det
    return np.where(laid[:, None], values - level[:, None] - slope[:, None] * x, 0.0)


def _brightest_ground(brightness: Array, cloud: float) -> float:
    """Brightness up to which a window may be ground where clouds have the brightness `cloud`."""
    halfway = 0.5 * (float(np.quantile(brightness, 0.01)) + cloud)
    dark = brightness[brightness < halfway]
    if len(dark) == 0:
        return halfway
    median, spread = _median_and_spread(dark)
    return min(halfway, median + USUAL_GROUND * spread)


def _darker(brightness: Array) -> Array:
    """What may be ground, of windows up to two thirds of which are cloud, by the darkest quarter."""
    if len(brightness) == 0:
        return brightness
    darkest, dark = np.quantile(brightness, (0.05, 0.25))  # 1.64 and .67 sigmas below the middle
    spread = (dark - darkest) / 0.97
    return brightness[brightness <= dark + (0.67 + WHITE) * spread]


def _median_and_spread(values: Array) -> tuple[float, float]:
    """Median, and sigma of the half below it, which no cloud widens."""
    median = float(np.median(values))
    return median, median - float(np.quantile(values, 0.159))


def _rows(lines: float, step: float) -> int:
    """At least one row of windows that stand `step` lines apart."""
    return max(1, round(lines / step))


def sum_along(values: Array, reach: int) -> Array:
    """Sum over `reach` rows to either side, what lies beyond the ends left out."""
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    rows = np.arange(len(values))
    first, last = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, len(values))
    return np.asarray(total[last] - total[first])


def sum_beside(values: Array) -> Array:
    """Sum (rows, blocks) over each column and the next on either side."""
    wide = np.pad(values, ((0, 0), (1, 1)))
    return np.asarray(wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:])
