"""Which windows saw the ground: those that agree with others of their row, for as long as they see it.

Motion can only shift and tilt the residuals of one row of windows. A window under a cloud, on its edge or
on a moving ship departs from that line by the share of its texture that moves otherwise: for half a cloud
by less than one window shows, but alike over as many rows as the cloud is long. The departures are
therefore averaged along the strip before they are judged. Where two groups of windows agree among
themselves the lower layer is the ground: clouds stand above it, and the cameras know which way height
shifts a match. Windows of which brightness tells (``bright_layer.py``) are left out first.

Not here: how exact the windows are that did see the ground (``match_noise.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.motion.measure.bright_layer import MIN_BLOCKS, RowShifts, bright_windows, sum_along, sum_beside
from sightline.motion.measure.observations import Star
from sightline.writing import let_go

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Departures are averaged over so many lines to either side: a small cloud's half, a large one's.
REACHES = (26.0, 80.0)
#: Squared departure, in variances of the mean of two components, up to which a window counts in full (3 % of
#: windows that saw the ground lie beyond at one of the reaches: at 13 % the noise that is left would look a
#: tenth smaller than it is); then its weight falls as its inverse, as that of an error that lasts; beyond
#: FOREIGN (0.005 %) it counts no more.
USUAL, FOREIGN = 8.0, 20.0
#: Departures beyond this many sigmas count alike when a row's line is sought.
BEYOND = 3.0
#: A window below the line (nearer to the Earth) speaks so many times as much against it as one above.
BELOW = 2.0
#: Rows that are judged together at most, beside so many of the longest reach that only lend to them: what is
#: usual in a strip may change along it.
MOST_ROWS, HALO = 4096, 8
#: Columns whose pairs are tried as a row's line, and their least distance as a share of half the field.
MOST_TRIED, APART = 16, 0.3
#: Beside foreign windows, which have soft edges, departures speak so many times as loud.
NEAR = 3.0
#: Rows in which, neighbours included, more than this share is foreign say nothing.
MOST_FOREIGN = 0.8
#: A row is undermined where more than this share of its windows lie below its line.
UNDERMINED = 0.1
#: A window is lonely where less than this share of those around it was matched.
LONELY = 0.15
#: Lines and weights are found from each other so many times.
ROUNDS = 3
#: A row's line is laid through windows of at least this weight.
TRUSTED = 0.2
#: Median of a squared standard Gaussian.
MEDIAN_SQUARE = 0.4549


def ground_weights(stars: Sequence[Star], post_px: Sequence[Array], relief_sigma: float = 0.0) -> list[Array]:
    """Weights (G, K) in [0, 1] per star: 1 where a window agrees with its row, 0 where it saw something else.

    Parameters
    ----------
    stars : sequence of Star
    post_px : sequence of (G, K, 2)
        Residuals of each after an estimate of the motion, px.
    relief_sigma : float
        m; of unknown heights about the mean and slope of their row: what relief shifts is no cloud.

    Notes
    -----
    All pairs of a window see the same cloud, which moves with the lag: they are judged together by one shift
    per unit of lag, and each loses weight by what that shift makes of its own lag. The weight of a window
    whose departure lasts n rows is that of an error of variance sigma^2 + n departure^2, so that what cannot
    be proved costs information instead of honesty. Windows of other stars on ground that the largest star
    saw too are not trusted more than that ground was there.
    """
    largest = int(np.argmax([s.shape[0] * s.shape[1] for s in stars]))
    first = stars[largest]
    foreign, cloudy = _foreign(first, post_px[largest], np.zeros(first.shape), relief_sigma)
    out = []
    for k, (star, post) in enumerate(zip(stars, post_px, strict=True)):
        squared = foreign
        if k != largest:
            least = _on_same_ground(star, first, foreign)
            squared, _ = _foreign(star, post, least, relief_sigma, cloudy=cloudy)
        out.append(_pair_weights(star, squared))
    return out


def _pair_weights(star: Star, foreign: Array) -> Array:
    """Weights (G, K) of the pairs of windows whose worst departure has this squared size, (rows, blocks)."""
    lag = _relative_lags(star)

    def weights(squared: Array, residual_px: Array, covariance_px: Array) -> Array:
        ground = squared <= FOREIGN
        sensitivity = _sensitivity(residual_px, covariance_px, lag)
        return np.where(ground, _weight(np.where(ground, squared, 0.0) * sensitivity), 0.0)

    return star.each(weights, foreign.reshape(-1, 1), star.residual_px, star.covariance_px)


def _foreign(
    star: Star, post_px: Array, least: Array, relief_sigma: float, *, cloudy: bool = False
) -> tuple[Array, bool]:
    """Squared size (rows, blocks) of each window's worst departure, at least `least`; infinite if unseen.

    And whether brightness told clouds anywhere; `cloudy`: whether it did elsewhere.
    """
    rows, blocks = star.shape
    if rows < 2:
        return least, False
    told = False
    parts, halo, out = -(-rows // MOST_ROWS), HALO * _reaches(star)[-1], np.empty(least.shape)
    for first, last in pairwise(np.linspace(0, rows, parts + 1).round().astype(int).tolist()):
        with_halo = slice(max(first - halo, 0), min(last + halo, rows))
        post = post_px[with_halo.start * blocks : with_halo.stop * blocks]
        found, here = _foreign_near(star.rows(with_halo), post, least[with_halo], relief_sigma, cloudy)
        out[first:last] = found[first - with_halo.start : last - with_halo.start]
        told = told or here
    return out, told


def _foreign_near(
    star: Star, post_px: Array, least: Array, relief_sigma: float, cloudy: bool
) -> tuple[Array, bool]:
    """The same of rows that are judged together."""
    rows, blocks = star.shape
    shift = _common_shift(star, post_px)
    reaches = _reaches(star)
    matched = star.each(lambda post: np.isfinite(post).all(axis=-1).any(axis=1), post_px).reshape(
        rows, blocks
    )
    seen = shift.seen
    tried = np.ones_like(seen) if star.chosen is None else star.chosen.reshape(star.shape)
    shift = replace(shift, seen=seen & ~_lonely(seen, tried, reaches[0]))
    shift = shift.scaled(_row_noise(shift, reaches[0]))
    by_height = _by_height(star, shift.lag)
    shift = replace(shift, lasting=(by_height * relief_sigma) ** 2)
    per_metre = float(np.hypot(*by_height))
    up = by_height / max(per_metre, 1e-30)
    bright = np.zeros(star.shape, dtype=bool)
    if star.brightness is not None:
        # brightness has judged these: the rest is judged by itself
        shifts = RowShifts(shift.x, shift.value, shift.variance + shift.lasting, shift.seen)
        brightness = star.brightness.reshape(star.shape)
        bright, tells = bright_windows(
            shifts,
            brightness,
            matched,
            _line_step(star),
            per_metre,
            star.brightness_elsewhere,
            cloudy=cloudy,
        )
        shift = replace(shift, seen=shift.seen & ~bright, lent=0 if tells else shift.lent)
    if blocks < MIN_BLOCKS:
        # a line through so few passes near all of them: no row tells more
        return np.where(seen & bright, np.inf, least), bool(bright.any())
    worst = _worst_departures(shift, reaches, up, least)
    undermined = _undermined(shift, worst, reaches, up)
    # where hardly any window saw the ground, nothing vouches for those that seem to
    foreign = sum_along((shift.seen & (worst > FOREIGN)).sum(axis=1).astype(float), reaches[0])
    lost = foreign > MOST_FOREIGN * sum_along(shift.seen.sum(axis=1).astype(float), reaches[0])
    lost |= undermined
    # images of one instant see a cloud where they see the ground: their matches cannot be judged
    unjudged = np.where(matched & ~seen, least, np.inf)
    return np.where(shift.seen & ~lost[:, None], worst, unjudged), bool(bright.any())


def _undermined(shift: _Shift, worst: Array, reaches: list[int], up: Array) -> Flags:
    """Rows of which more foreign windows lie below the line than above, neighbours included: (rows,).

    Nothing lies below the ground: there a cloud was most of the row, and took the line.
    """
    weight = np.where(shift.seen, _weight(worst), 0.0)
    departure, _, use = _from_row_line(shift, weight)
    foreign = use & (worst > FOREIGN)
    side = departure @ up
    below = sum_along((foreign & (side < 0.0)).sum(axis=1).astype(float), reaches[0])
    above = sum_along((foreign & (side > 0.0)).sum(axis=1).astype(float), reaches[0])
    seen = sum_along(shift.seen.sum(axis=1).astype(float), reaches[0])
    return np.asarray((below > above) & (below > UNDERMINED * seen))


def _on_same_ground(star: Star, first: Star, foreign: Array) -> Array:
    """What `foreign` (rows, blocks) of star `first` says of the ground that the windows of `star` saw.

    The windows nearest along the strip that were seen within REACHES[0] count, the worst of three; infinite
    where `first` looked and saw none.
    """
    least = np.zeros(len(star.t_hub))
    if first.hub not in star.images or first.shape[0] < 2:
        return least.reshape(star.shape)
    rows, blocks = first.shape
    t = first.t_hub.reshape(rows, blocks)[:, 0]
    instant = star.t[:, star.images.index(first.hub)]
    column = np.abs(star.field[:, None] - first.field[:blocks]).argmin(axis=1)
    reach = _reaches(first)[0]
    rising = np.argsort(t, kind="stable")
    index = np.interp(instant, t[rising], rising.astype(float), left=-np.inf, right=np.inf)
    step = float(np.median(np.diff(t)))
    for k in np.flatnonzero(np.isfinite(instant)):
        row = index[k]
        if not np.isfinite(row):  # beyond an end: so many rows
            row = (instant[k] - t[0]) / step
        if not -reach <= row <= rows - 1 + reach:
            continue
        near = np.arange(max(0, math.floor(row) - reach), min(rows, math.ceil(row) + reach + 1))
        near = near[np.argsort(np.abs(near - row), kind="stable")]
        found = foreign[near, column[k]]
        found = found[np.isfinite(found)][:3]
        least[k] = found.max() if len(found) else np.inf
    return least.reshape(star.shape)


def _worst_departures(shift: _Shift, reaches: list[int], up: Array, least: Array) -> Array:
    """Squared size (rows, blocks) of each window's worst departure, alone or lasting; at least `least`."""
    weight = _first_weights(shift, reaches[0], up, least <= FOREIGN)
    worst = least
    for _ in range(ROUNDS):
        departure, variance, use = _from_row_line(shift, weight)
        worst = np.where(use, (departure**2 / (variance + shift.lasting)).sum(axis=-1), 0.0)
        worst = np.maximum(np.where(worst > FOREIGN, worst, 0.0), least)
        for reach in reaches:
            # what is known as foreign already must not smear over its neighbours
            left = use & (worst <= FOREIGN)
            worst = np.maximum(worst, _lasting(shift, departure, variance, left, weight > TRUSTED, reach))
        worst = _with_neighbours(worst, use, reaches[0])
        weight = np.where(shift.seen, _weight(worst), 0.0)
    return worst


def _with_neighbours(worst: Array, use: Flags, reach: int) -> Array:
    """Departures (rows, blocks) seen in the light of those around.

    Foreign is what stands among windows of its column most of which are; beside one, in its column or the
    next, departures count NEAR times.
    """
    foreign = (use & (worst > FOREIGN)).astype(float)
    number = sum_along(foreign, reach)
    most = number > 0.5 * sum_along(use.astype(float), reach)
    beside = sum_beside(number) > 0.0
    return np.asarray(np.where(most, np.inf, np.where(beside, NEAR * worst, worst)))


def _weight(squared: Array) -> Array:
    """Weight of a window whose mean departure has this squared size."""
    weight = USUAL / np.maximum(squared, USUAL)
    return np.asarray(np.where(squared > FOREIGN, 0.0, weight))


@dataclass(frozen=True, eq=False)
class _Shift:
    """One shift per window, (rows, blocks, 2) px at the longest lag, its variance, and where it is seen.

    Rows too empty for a line of their own are judged by those up to `lent` rows away. Where brightness tells
    clouds from ground they need no judge: between clouds the motion itself may be unknown, and what is left
    of it is no departure.
    """

    x: Array
    lag: Array
    value: Array
    variance: Array
    seen: Flags
    lent: int
    lasting: Array

    def scaled(self, factor: Array) -> _Shift:
        """The same with variances multiplied by `factor` (2,)."""
        return replace(self, variance=self.variance * factor)


def _common_shift(star: Star, post_px: Array) -> _Shift:
    """Least-squares shift of each window that grows with lag, from all its pairs."""
    rows, blocks = star.shape
    lag = _relative_lags(star)
    shifts, seen = np.empty((2, len(post_px), 2)), np.empty(len(post_px), dtype=bool)
    for some in star.stretches():
        post, covariance = post_px[some], star.covariance_px[some]
        own = np.stack([covariance[..., 0, 0], covariance[..., 1, 1]], axis=-1)
        present = np.isfinite(post).all(axis=-1, keepdims=True) & np.isfinite(own)
        share = np.where(present, lag[:, None] / np.where(present, own, 1.0), 0.0)
        information = (share * lag[:, None]).sum(axis=1)
        known = (information > 0).all(axis=1)
        information = np.where(known[:, None], information, 1.0)
        shift = (share * np.where(present, post, 0.0)).sum(axis=1) / information
        shifts[:, some] = np.where(known[:, None], shift, 0.0), 1.0 / information
        seen[some] = known
        let_go()
    value, variance = shifts.reshape(2, rows, blocks, 2)
    x = star.field.reshape(rows, blocks)[0]
    return _Shift(x, lag, value, variance, seen.reshape(rows, blocks), _reaches(star)[-1], np.zeros(2))


def _relative_lags(star: Star) -> Array:
    """(K,) lag of each pair over the longest; zero where a pair sees nothing.

    Where partners have finer pixels than the hub it is times so many: residuals are in pixels of the partner.
    """
    apart = (star.t[:, k] - star.t_hub for k in range(star.t.shape[1]))
    seen = (lags[np.isfinite(lags)] for lags in apart)
    lag = np.array([np.median(lags) if len(lags) else 0.0 for lags in seen])
    let_go()
    lag = lag * np.array(star.fineness or 1.0)
    return np.asarray(lag / max(float(np.abs(lag).max()), 1e-12))


def _sensitivity(residual_px: Array, covariance_px: Array, lag: Array) -> Array:
    """(G, K): how much of a window's evidence against it bears on each of its pairs."""
    with np.errstate(invalid="ignore"):
        size = lag**2 / np.maximum(np.trace(covariance_px, axis1=2, axis2=3), 1e-30)
    size = np.where(np.isfinite(residual_px[..., 0]), size, 0.0)
    return np.asarray(size / np.maximum(size.max(axis=1, keepdims=True), 1e-30))


def _by_height(star: Star, lag: Array) -> Array:
    """(2,) px per metre by which a higher target shifts at the longest lag."""
    shift, size = np.zeros(2), 0.0
    for k in range(len(lag)):
        known = np.isfinite(star.by_height[:, k]).all(axis=-1)
        if known.any():
            shift += lag[k] * np.median(star.by_height[known, k], axis=0)
            size += lag[k] ** 2
    let_go()
    return np.asarray(shift / max(size, 1e-30), dtype=np.float64)


def _reaches(star: Star) -> list[int]:
    """REACHES, in lines of the finest image, in rows."""
    step = _line_step(star) * star.coarseness
    return [max(1, round(reach / step)) for reach in REACHES]


def _line_step(star: Star) -> float:
    """Lines between rows of windows."""
    lines = star.pixels[:, 0].reshape(star.shape)[:, 0]
    return max(float(np.median(np.diff(lines))), 1e-6)


def _mean_along(values: Array, variance: Array, use: Flags, reach: int) -> tuple[Array, Array, Array]:
    """Mean over rows, its variance, and from how many rows: (rows, blocks, 2) twice, (rows, blocks, 1)."""
    there = use[..., None]
    count = sum_along(use.astype(float)[..., None], reach)
    some = np.maximum(count, 1.0)
    mean = sum_along(np.where(there, values, 0.0), reach) / some
    spread = sum_along(np.where(there, variance, 0.0), reach) / some**2
    return mean, np.where(count > 0.0, spread, 1.0), count


def _lonely(seen: Flags, tried: Flags, reach: int) -> Flags:
    """Windows of whose tried neighbours hardly any was matched: chance matches of blank ground."""
    near, all_ = (sum_beside(sum_along(part.astype(float), reach)) for part in (seen, tried))
    return np.asarray(seen & (near < LONELY * all_))


def _row_noise(shift: _Shift, reach: int) -> Array:
    """(2,) variance of single windows over the stated one, from what changes from row to row."""
    mean, _, count = _mean_along(shift.value, shift.variance, shift.seen, reach)
    # what bends across the field is no motion
    quick = np.where(shift.seen[..., None] & (count > 1.0), shift.value - mean, np.nan)
    variance = shift.variance * (1.0 - 1.0 / np.maximum(count, 2.0))
    bend = quick[:, :-2] - 2.0 * quick[:, 1:-1] + quick[:, 2:]
    squares = bend**2 / (variance[:, :-2] + 4.0 * variance[:, 1:-1] + variance[:, 2:])
    if np.isfinite(squares[..., 0]).sum() < 2 * MIN_BLOCKS:
        return np.ones(2)
    return np.asarray(np.maximum(np.nanmedian(squares, axis=(0, 1)) / MEDIAN_SQUARE, 1e-6))


def _first_weights(shift: _Shift, reach: int, up: Array, asked: Flags) -> Array:
    """Weights from the line that most windows `asked` agree on, each row averaged with its neighbours."""
    mean, variance, count = _mean_along(shift.value, shift.variance, shift.seen, reach)
    variance = variance + shift.lasting
    seen = asked & (count[..., 0] >= min(3, 2 * reach + 1))
    tried = np.unique(np.linspace(0, len(shift.x) - 1, min(len(shift.x), MOST_TRIED)).round().astype(np.intp))
    couples = [(a, b) for a, b in combinations(tried, 2) if abs(shift.x[a] - shift.x[b]) >= APART]
    couples = couples or [(tried[0], tried[-1])]
    squared = np.zeros(seen.shape)
    for _ in range(2):
        line = _consensus(mean, variance, seen, shift.x, np.array(couples), up)
        squares = (mean - line) ** 2 / variance
        squared = squares.sum(axis=-1)
        # relief that nobody knows makes all windows depart: what is usual is what half of them do
        spread = np.median(squares[seen], axis=0) / MEDIAN_SQUARE if seen.any() else np.ones(2)
        if (spread < 2.0).all():
            break
        variance = variance * np.maximum(spread, 1.0)
    return np.where(seen & shift.seen, _weight(squared), 0.0)


def _row_lines(shift: _Shift, weight: Array) -> tuple[Array, Array, Flags]:
    """Level and slope (rows, 2, 2) of the lines through the trusted windows of rows, covariance, where laid.

    The covariance (rows, 3, 2) has those of the level, of both and of the slope.
    """
    w = np.where(weight > TRUSTED, weight, 0.0)[..., None] / shift.variance
    x = shift.x[:, None]
    s0, s1, s2 = w.sum(1), (w * x).sum(1), (w * x * x).sum(1)
    y0, y1 = (w * shift.value).sum(1), (w * x * shift.value).sum(1)
    det = s0 * s2 - s1**2
    laid = ((weight > TRUSTED).sum(axis=1) >= MIN_BLOCKS - 1) & (det > 1e-6 * s0 * s0).all(axis=1)
    det = np.where(laid[:, None], det, 1.0)
    lines = np.stack([(s2 * y0 - s1 * y1) / det, (s0 * y1 - s1 * y0) / det], axis=1)
    return lines, np.stack([s2, -s1, s0], axis=1) / det[:, None], laid


def _from_row_line(shift: _Shift, weight: Array) -> tuple[Array, Array, Flags]:
    """Departure of windows from the line through the trusted ones of their row, variance, where known."""
    lines, covariance, laid = _row_lines(shift, weight)
    # a row that cannot tell by itself is judged by the line of its neighbours
    near = sum_along(laid.astype(float), shift.lent)
    some = (near >= 1.0) & ~laid

    def borrowed(values: Array) -> Array:
        own = laid[:, None, None]
        around = sum_along(np.where(own, values, 0.0), shift.lent) / np.maximum(near, 1.0)[:, None, None]
        return np.asarray(np.where(own, values, around))

    lines, covariance = borrowed(lines), borrowed(covariance)
    x = shift.x[:, None]
    line = lines[:, None, 0] + lines[:, None, 1] * x
    own = covariance[:, None, 0] + 2 * covariance[:, None, 1] * x + covariance[:, None, 2] * x * x
    # a window that takes part with weight w draws the line towards itself
    part = np.where((weight > TRUSTED) & laid[:, None], weight, 0.0)[..., None]
    apart = np.maximum(shift.variance + (1.0 - 2.0 * part) * own, 0.1 * shift.variance)
    use = shift.seen & (laid | some)[:, None]
    departure = np.where(use[..., None], shift.value - line, 0.0)
    return departure, apart, use


def _lasting(
    shift: _Shift, departure: Array, variance: Array, use: Flags, trusted: Flags, reach: int
) -> Array:
    """Squared size (rows, blocks) of the mean departure over neighbouring rows: of noise 2 on average."""
    mean, spread, count = _mean_along(departure, variance, use, reach)
    squares = mean**2 / np.maximum(spread + shift.lasting, 1e-30)
    known = use & (count[..., 0] >= min(3, 2 * reach + 1))
    return np.where(known, (squares / _excess(squares[known & trusted])).sum(axis=-1), 0.0)


def _excess(squares: Array) -> Array:
    """(2,) how many times larger squared mean departures (N, 2) are than of independent errors, at least 1.

    Errors of real textures last for some rows, and relief that nobody knows for many: that is usual.
    """
    if len(squares) == 0:
        return np.ones(2)
    return np.asarray(np.maximum(np.median(squares, axis=0) / MEDIAN_SQUARE, 1.0))


@njit(cache=True, nogil=True)
def _consensus(  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    mean, variance, seen, x, couples, up
):
    """Line (rows, blocks, 2) of each row through the couple of columns that costs the windows least."""
    rows, blocks = seen.shape
    out = np.zeros((rows, blocks, 2))
    most = BEYOND * BEYOND
    for r in range(rows):
        lowest = np.inf
        for k in range(len(couples)):
            a, b = couples[k]
            if not (seen[r, a] and seen[r, b]):
                continue
            slope0 = (mean[r, b, 0] - mean[r, a, 0]) / (x[b] - x[a])
            slope1 = (mean[r, b, 1] - mean[r, a, 1]) / (x[b] - x[a])
            level0, level1 = mean[r, a, 0] - slope0 * x[a], mean[r, a, 1] - slope1 * x[a]
            cost = 0.0
            for c in range(blocks):
                if not seen[r, c]:
                    continue
                d0 = mean[r, c, 0] - level0 - slope0 * x[c]
                d1 = mean[r, c, 1] - level1 - slope1 * x[c]
                square = d0 * d0 / variance[r, c, 0] + d1 * d1 / variance[r, c, 1]
                limit = most * BELOW if d0 * up[0] + d1 * up[1] < 0.0 else most
                cost += min(square, limit)
                if cost >= lowest:
                    break
            if cost < lowest:
                lowest = cost
                for c in range(blocks):
                    out[r, c, 0] = level0 + slope0 * x[c]
                    out[r, c, 1] = level1 + slope1 * x[c]
    return out
