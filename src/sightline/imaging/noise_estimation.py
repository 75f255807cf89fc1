"""Noise of a detector from one image of an unknown scene, and from pixels beside it that saw none.

Three things are separated by what they do along and across the strip:

- noise of pixels at rest (buffer, dark): the level drifts slowly, so the share of lines on either side of a
  code's edge says how wide the noise is, even where it is far below the step (an ordered probit);
- white noise of the image: the variance of high differences in both directions, which a scene hardly
  reaches, taken to no texture by regression on the texture of the block, measured in other frequencies and
  on other pixels;
- the column pattern: what distant parts of the strip have in common.

Rounding to codes adds the square of the step over 12 and is white where values spread over steps.

Not here: electrons and TDI stages (``imaging/strip_noise.py``), files (``io/formats/hirise_edr.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import convolve1d
from scipy.optimize import minimize
from scipy.special import ndtr

from sightline.errors import EstimationError, InputError

Array = NDArray[np.float64]
Codes = NDArray[np.unsignedinteger[Any]]

#: Of a drift's spline: pieces over the lines. Noise slower than these counts as drift.
PIECES = 12
#: Order of the differences whose variance is the noise, and pixels along the side of a block.
ORDER, BLOCK = 6, 32
#: Parts of a strip that are left out in turn, for sigma.
PARTS = 20
#: Columns over which the response is taken for smooth (the window of a local parabola).
SMOOTH = 33
#: Noise that is looked for, in steps of the table at the least; a column whose sigma has a larger relative
#: error than this shows nothing (below a fifth of the step a level with plateaus explains the codes as well).
LEAST_STEP, LARGEST_ERROR = 0.02, 0.2
#: Sigmas beyond which no code comes, and codes to either side of one that are looked at at most.
FARTHEST_CODE, MOST_CODES = 4.0, 100
#: Relative bias of noise at rest that the allowance for the drift leaves, by simulation (``validation/``).
DRIFT_BIAS = 0.015
#: Least share of a block's pixels that must hold a value.
LEAST_SHARE = 0.9
#: Spread of a scene's roughness, as a share of it, that is rounding.
EVENLY = 1e-9


@dataclass(frozen=True)
class Estimate:
    """A number and its standard deviation.

    Attributes
    ----------
    value, sigma : float
    """

    value: float
    sigma: float

    def upper(self, sigmas: float = 2.0) -> float:
        """The value and so many sigmas."""
        return self.value + sigmas * self.sigma


@dataclass(frozen=True, eq=False)
class CodeTable:
    """Edges of the values behind codes.

    Attributes
    ----------
    lower, upper : (codes,) float64
        A code stands for values from `lower` up to `upper`; NaN where it stands for none.
    """

    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        """Refuse edges that do not rise."""
        usable = np.isfinite(self.lower) & np.isfinite(self.upper)
        edges = np.stack([self.lower[usable], self.upper[usable]], axis=1).ravel()
        if self.lower.shape != self.upper.shape or edges.size < 4 or (np.diff(edges) < 0.0).any():
            raise InputError(
                "the edges of codes do not rise; two usable codes or more, each above the last, are needed"
            )
        if (self.upper[usable] <= self.lower[usable]).any():
            raise InputError("a code stands for no value: its upper edge is not above its lower one")

    def values(self, codes: Codes) -> Array:
        """Middles, same shape; NaN where a code is no value."""
        return np.asarray((0.5 * (self.lower + self.upper))[codes])

    def rounding(self, codes: Codes) -> Array:
        """Variances that the step adds, same shape."""
        return np.asarray(((self.upper - self.lower) ** 2 / 12.0)[codes])


@dataclass(frozen=True, eq=False)
class RestingNoise:
    """Noise of columns that saw no scene.

    Attributes
    ----------
    each : list of Estimate
        Standard deviation of each column (unit of the table).
    pooled : Estimate
        Root mean square of the columns that show it; sigma is the larger of the formal one and what their
        scatter says, and the bias that may be left.
    level : (lines, columns) float64
        The slow drift; NaN where a line has no value.
    """

    each: list[Estimate]
    pooled: Estimate
    level: Array


def resting_noise(codes: Codes, table: CodeTable, pieces: int = PIECES) -> RestingNoise:
    """Noise of columns whose level only drifts, from how often their codes change.

    Parameters
    ----------
    codes : (lines, columns) uint8 or uint16
    table : CodeTable
    pieces : int
        Of the spline of each column's drift.

    Raises
    ------
    EstimationError
        If most columns do not show their noise (below about a fifth of the step, or no edge met), or lines
        are too few.
    """
    each, levels = [], np.full(codes.shape, np.nan)
    for column in range(codes.shape[1]):
        good = np.isfinite(table.values(codes[:, column]))
        sigma, levels[good, column] = _ordered_probit(
            codes[good, column], np.flatnonzero(good), table, pieces
        )
        each.append(sigma)
    shown = [e for e in each if e.sigma <= LARGEST_ERROR * e.value]
    if 2 * len(shown) < len(each):
        raise EstimationError(
            f"the codes of {len(each) - len(shown)} of {len(each)} columns do not show how wide their noise "
            "is: it is below about a fifth of the step, or the level meets no edge; give more lines"
        )
    squares = np.array([e.value**2 for e in shown])
    errors = 2.0 * np.array([e.value * e.sigma for e in shown])
    formal = float(np.linalg.norm(errors)) / len(shown)
    scatter = float(squares.std(ddof=1)) / np.sqrt(len(shown)) if len(shown) > 1 else 0.0
    value = float(np.sqrt(squares.mean()))
    sigma = np.hypot(max(formal, scatter) / (2.0 * value), DRIFT_BIAS * value)
    return RestingNoise(each, Estimate(value, float(sigma)), levels)


def _ordered_probit(
    codes: Codes, lines: NDArray[np.intp], table: CodeTable, pieces: int
) -> tuple[Estimate, Array]:
    """Sigma of Gaussian noise about a cubic spline whose values were coded, and the spline."""
    if codes.size < 20 * pieces:
        raise EstimationError(f"{codes.size} lines with values; {20 * pieces} are needed for noise at rest")
    basis = _spline_basis(lines, pieces)
    lower, upper = table.lower[codes], table.upper[codes]
    step = float(np.median(upper - lower))
    middle = 0.5 * (lower + upper)
    start = np.linalg.lstsq(basis, middle, rcond=None)[0]
    # of far less than the noise there is no code far from the level could have come, and no step leads on
    begin = max(float(np.sqrt(np.mean((middle - basis @ start) ** 2))), step / 4.0)

    def cost(unknowns: Array) -> tuple[float, Array]:
        level, sigma = basis @ unknowns[:-1], np.exp(unknowns[-1])
        share, by_level, by_sigma = _share_of_code(lower, upper, level, sigma)
        rate = -1.0 / share
        gradient = np.append(basis.T @ (rate * by_level), (rate * by_sigma).sum() * sigma)
        return float(-np.log(share).sum()), gradient

    found = minimize(
        cost,
        np.append(start, np.log(begin)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(None, None)] * basis.shape[1] + [(np.log(LEAST_STEP * step), None)],
        options={"maxiter": 2000, "maxfun": 3000},
    )
    level, sigma = basis @ found.x[:-1], float(np.exp(found.x[-1]))
    ridge = step**-2.0
    own, shared, of_level = _information(basis, level, sigma, codes, table, ridge)
    left = max(float(own - shared @ np.linalg.solve(of_level, shared)) * sigma**2, 1e-12)
    # what the fit of the drift took away is given back (Cox and Reid's adjusted likelihood, one step)
    wider = _information(basis, level, sigma * 1.05, codes, table, ridge)[2]
    lost = -0.5 * (np.linalg.slogdet(wider)[1] - np.linalg.slogdet(of_level)[1]) / np.log(1.05)
    sigma *= float(np.exp(np.clip(lost / left, 0.0, 0.3)))
    return Estimate(sigma, sigma / float(np.sqrt(left))), level


def _spline_basis(lines: NDArray[np.intp], pieces: int) -> Array:
    at = (lines - lines[0]) / (lines[-1] - lines[0])
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, pieces + 1), np.ones(3)])
    return np.asarray(BSpline.design_matrix(at, knots, 3).toarray())


def _share_of_code(lower: Array, upper: Array, level: Array, sigma: float) -> tuple[Array, Array, Array]:
    """Probability of a code, and its derivatives by level and by sigma."""
    a, b = (upper - level) / sigma, (lower - level) / sigma
    density_a = np.exp(-0.5 * a * a) / np.sqrt(2.0 * np.pi)
    density_b = np.exp(-0.5 * b * b) / np.sqrt(2.0 * np.pi)
    share = np.maximum(ndtr(a) - ndtr(b), 1e-300)
    return share, -(density_a - density_b) / sigma, -(density_a * a - density_b * b) / sigma


def _information(
    basis: Array, level: Array, sigma: float, codes: Codes, table: CodeTable, ridge: float
) -> tuple[float, Array, Array]:
    """Expected information on sigma, on sigma and the spline together, and on the spline.

    Codes that could have come instead are counted with theirs: as far on the other side of the level as the
    one that came may lie. `ridge` is what is known of each coefficient from the code itself, a step: a part
    of the drift that no edge is near shows no more.
    """
    own, shared, weight = 0.0, np.zeros(level.size), np.zeros(level.size)
    reach = min(max(2, math.ceil(2.0 * FARTHEST_CODE * sigma * math.sqrt(ridge))), MOST_CODES)
    for shift in range(-reach, reach + 1):
        there = codes.astype(np.int64) + shift
        at = np.clip(there, 0, table.lower.size - 1)
        share, by_level, by_sigma = _share_of_code(table.lower[at], table.upper[at], level, sigma)
        known = np.isfinite(share) & (share > 1e-12) & (at == there)
        use = np.where(known, 1.0 / np.where(known, share, 1.0), 0.0)
        by_level, by_sigma = np.nan_to_num(by_level), np.nan_to_num(by_sigma)
        weight += use * by_level**2
        shared += use * by_level * by_sigma
        own += float((use * by_sigma**2).sum())
    return own, basis.T @ shared, basis.T @ (basis * weight[:, None]) + ridge * np.eye(basis.shape[1])


@dataclass(frozen=True, eq=False)
class Blocks:
    """Squares of an image: their mean, and the variance of differences in several frequencies.

    Attributes
    ----------
    signal : (rows, columns) float64
        Mean value of each square; NaN where too few of its pixels hold one, here and below.
    white : (rows, columns) float64
        Variance by high differences in both directions, rounding subtracted.
    texture : (rows, columns) float64
        Variance of lower frequencies less that of higher ones, in which white noise cancels on average and
        which is uncorrelated with what noise does to `white`.
    """

    signal: Array
    white: Array
    texture: Array


def measure_blocks(values: Array, rounding: Array, *, order: int = ORDER, block: int = BLOCK) -> Blocks:
    """Variances of the squares of an image.

    Parameters
    ----------
    values : (lines, columns) float64
        NaN where there is none.
    rounding : (lines, columns) float64
        Variance that rounding added.
    order : int
        Of the differences in each direction for the noise.
    block : int
        Side, pixels.
    """
    if min(values.shape) < 2 * block + 2 * order:
        raise InputError(f"the image is {values.shape}; {2 * block + 2 * order} lines and columns are needed")
    high = _differences(_differences(values, order, 0), order, 1) ** 2 - rounding
    low = sum(
        weight * (_differences(values, k, 0) ** 2 + _differences(values, k, 1) ** 2)
        for k, weight in _texture_weights(order).items()
    )
    inner = (slice(order, -order),) * 2
    filled = _block_means(np.isfinite(high[inner]).astype(float), block) >= LEAST_SHARE
    signal, white, texture = (
        np.where(filled, _block_means(np.asarray(field)[inner], block), np.nan)
        for field in (values, high, low)
    )
    return Blocks(signal, white, texture)


def _difference_kernel(order: int) -> Array:
    kernel = np.ones(1)
    for _ in range(order):
        kernel = np.convolve(kernel, [1.0, -1.0])
    return np.asarray(kernel / np.linalg.norm(kernel))


def _differences(values: Array, order: int, axis: int) -> Array:
    """Differences of unit noise gain along an axis, same shape; NaN spreads over the kernel."""
    out = convolve1d(values, _difference_kernel(order), axis=axis, mode="nearest")
    return np.asarray(out)


def _texture_weights(order: int) -> dict[int, float]:
    """Weights of the squares of first, second and third differences of one direction: they sum to zero, and
    for white noise the sum is uncorrelated with the square of the differences of `order`."""

    def overlap(k: int) -> float:
        # covariance of two squares summed over an area: the product of the autocorrelations, summed
        first, second = (
            np.correlate(c, c, "full") for c in (_difference_kernel(order), _difference_kernel(k))
        )
        middle, reach = len(first) // 2, min(len(first), len(second)) // 2
        own = len(second) // 2
        return float(first[middle - reach : middle + reach + 1] @ second[own - reach : own + reach + 1])

    one, two, three = (overlap(k) for k in (1, 2, 3))
    second = -(one - three) / (two - three)
    return {1: 1.0, 2: second, 3: -1.0 - second}


def _block_means(field: Array, block: int) -> Array:
    lines, columns = (n // block for n in field.shape)
    cut = field[: lines * block, : columns * block].reshape(lines, block, columns, block)
    known = np.isfinite(cut)
    total = np.where(known, cut, 0.0).sum(axis=(1, 3))
    count = known.sum(axis=(1, 3))
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


@dataclass(frozen=True)
class WhiteNoise:
    """Variance of the image's white noise at its mean signal.

    Attributes
    ----------
    signal : float
        Mean value of the blocks.
    variance : Estimate
        Taken to no texture.
    bound : Estimate
        Variance of the high differences as it stands: noise and what is left of the scene.
    slope : Estimate
        Change of the variance with the signal.
    covariance : float
        Of `variance` and `slope`.
    """

    signal: float
    variance: Estimate
    bound: Estimate
    slope: Estimate
    covariance: float


def white_noise(blocks: Blocks, parts: int = PARTS) -> WhiteNoise:
    """Noise of an image, by regression of the high differences on texture and signal.

    The texture of a block is that of one realisation of the ground, and its high frequencies are another;
    what both share is how rough the place is, and the neighbouring blocks have that too. So the mean texture
    of the neighbours is the instrument of the regression. Sigma by leaving out parts of the strip.

    Raises
    ------
    EstimationError
        If there are fewer than 10 blocks a part, or roughness does not last from block to block, or is the
        same in all of them.
    """
    beside = _of_neighbours(blocks.texture)
    use = np.isfinite(blocks.white) & np.isfinite(beside)
    if use.sum() < 10 * parts:
        raise EstimationError(f"{use.sum()} blocks with values; {10 * parts} are needed for an image's noise")
    signal, white, texture, instrument = (
        field[use] for field in (blocks.signal, blocks.white, blocks.texture, beside)
    )
    row = np.broadcast_to(np.arange(len(use))[:, None], use.shape)[use]
    part = row * parts // len(use)
    centre = float(signal.mean())

    def solve(kept: NDArray[np.bool_]) -> Array:
        shared = np.stack([np.ones(kept.sum()), signal[kept] - centre])
        regressors, instruments = (np.vstack([shared, field[kept]]) for field in (texture, instrument))
        answer = np.linalg.solve(instruments @ regressors.T, instruments @ white[kept])
        return np.append(answer[:2], white[kept].mean())

    if texture.std() <= EVENLY * np.abs(texture).mean():
        raise EstimationError("the scene is as rough everywhere, and noise passes for it; give another strip")
    if np.corrcoef(texture, instrument)[0, 1] < 2.0 / np.sqrt(use.sum()):
        raise EstimationError("the scene's roughness does not last from block to block; give another strip")
    whole = solve(np.ones(signal.size, dtype=bool))
    left_out = np.array([solve(part != k) for k in range(parts)])
    spread = (left_out - left_out.mean(axis=0)).T
    covariance = (parts - 1) / parts * spread @ spread.T
    variance, slope, bound = (
        Estimate(float(value), float(sigma))
        for value, sigma in zip(whole, np.sqrt(np.diag(covariance)), strict=True)
    )
    return WhiteNoise(centre, variance, bound, slope, float(covariance[0, 1]))


def shows_texture(blocks: Blocks) -> bool:
    """Whether an image's squares show more than noise and slow shading (at 3 sigma)."""
    known = blocks.texture[np.isfinite(blocks.texture)]
    if known.size < 2:
        return True
    return bool(known.mean() > 3.0 * known.std(ddof=1) / np.sqrt(known.size))


def even_noise(blocks: Blocks) -> WhiteNoise:
    """Noise of an evenly lit image, all of whose high differences are noise.

    Raises
    ------
    EstimationError
        If there are fewer than 20 blocks.
    """
    use = np.isfinite(blocks.white)
    if use.sum() < PARTS:
        raise EstimationError(f"{use.sum()} blocks with values; {PARTS} are needed for an image's noise")
    signal, white = blocks.signal[use], blocks.white[use]
    centre = float(signal.mean())
    design = np.stack([np.ones(len(white)), signal - centre], axis=1)
    answer = np.linalg.lstsq(design, white, rcond=None)[0]
    scatter = float(((white - design @ answer) ** 2).sum()) / (len(white) - 2)
    covariance = scatter * np.linalg.pinv(design.T @ design)
    sigma = np.sqrt(np.diag(covariance))
    variance = Estimate(float(answer[0]), float(sigma[0]))
    return WhiteNoise(
        centre, variance, variance, Estimate(float(answer[1]), float(sigma[1])), float(covariance[0, 1])
    )


def _of_neighbours(field: Array) -> Array:
    """Mean of the four neighbours that hold a value; NaN where none does."""
    wide = np.pad(field, 1, constant_values=np.nan)
    four = np.array([wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]])
    known = np.isfinite(four)
    count = known.sum(axis=0)
    return np.asarray(np.where(count, np.where(known, four, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan))


@dataclass(frozen=True)
class RampNoise:
    """Noise of single lines of rising signal.

    Attributes
    ----------
    signal, variance, sigma : tuple of float
        Of each line: mean, variance of differences along it, its standard deviation.
    shot : Estimate
        Variance per signal.
    proportional : Estimate
        Variance per squared signal: gain noise, columns and the scene's own texture together.
    """

    signal: tuple[float, ...]
    variance: tuple[float, ...]
    sigma: tuple[float, ...]
    shot: Estimate
    proportional: Estimate


def ramp_noise(values: Array, rounding: Array, resting: float, *, order: int = 4) -> RampNoise:
    """Photon transfer of lines in which the signal rises while the scene's contrast stays.

    Parameters
    ----------
    values, rounding : (lines, columns) float64
        Signals above the dark level, and rounding variances; lines with a gap (NaN) are not used.
    resting : float
        Variance at no signal.
    order : int
        Of the differences along a line.

    Raises
    ------
    EstimationError
        If there are fewer than 4 such lines.
    """
    whole = np.isfinite(values).all(axis=1)
    if whole.sum() < 4:
        raise EstimationError(f"{whole.sum()} lines of rising signal without a gap; 4 are needed")
    values, rounding = values[whole], rounding[whole]
    half = order // 2
    square = (_differences(values, order, 1) ** 2 - rounding)[:, half:-half]
    kernel = _difference_kernel(order)
    # squares of overlapping differences are correlated: so many independent ones
    count = square.shape[1] / (np.correlate(kernel, kernel, "full") ** 2).sum()
    signal, variance = values.mean(axis=1), square.mean(axis=1)
    rough = rounding.mean(axis=1)
    design = np.stack([signal, signal**2], axis=1)
    answer = np.array([np.median((variance - resting) / signal), 0.0])
    for _ in range(20):
        # texture differs from line to line by as much as there is of it
        expected = np.maximum(design @ answer + resting, resting) + rough
        sigma = np.sqrt(2.0 * expected**2 / count + (answer[1] * signal**2) ** 2)
        normal = design.T @ (design / sigma[:, None] ** 2)
        answer = np.linalg.solve(normal, design.T @ ((variance - resting) / sigma**2))
        answer = np.maximum(answer, 0.0)
    errors = np.sqrt(np.diag(np.linalg.inv(normal)))
    residual = (variance - resting - design @ answer) / sigma
    scale = max(1.0, float(np.sqrt((residual**2).sum() / (len(signal) - 2))))
    shot, proportional = (Estimate(float(a), float(e) * scale) for a, e in zip(answer, errors, strict=True))
    return RampNoise(tuple(signal), tuple(variance), tuple(sigma), shot, proportional)


@dataclass(frozen=True, eq=False)
class ColumnPattern:
    """What the columns of a strip keep, relative to the signal.

    Attributes
    ----------
    pattern : (columns,) float64
        Departure of each column from its neighbours; NaN at the edges.
    variance : Estimate
        What parts of the strip that do not touch have in common: mean square of the pattern.
    near, far : Estimate
        The same from parts close together and from parts half a strip apart or more: alike if it is the
        detector's and not the scene's.
    single : float
        Mean square within one part: the pattern and the scene that is left in it.
    """

    pattern: Array
    variance: Estimate
    near: Estimate
    far: Estimate
    single: float


def column_pattern(
    signal: Array, *, parts: int = PARTS, smooth: int = SMOOTH, edges: tuple[int, int] = (0, 0)
) -> ColumnPattern:
    """Column fixed pattern, finer than `smooth` columns.

    Parameters
    ----------
    signal : (lines, columns) float64
        Above the dark level; NaN where there is none.
    parts : int
        Of the strip, compared with one another.
    smooth : int
        Columns of the local parabola that is taken for optics and scene.
    edges : (int, int)
        Columns left out at either end.
    """
    lines, columns = signal.shape
    if lines < 4 * parts or columns - sum(edges) < 2 * smooth:
        raise InputError(
            f"the signal is {signal.shape}; {4 * parts} lines and {2 * smooth + sum(edges)} columns are "
            "needed"
        )
    means = np.array([np.nanmean(part, axis=0) for part in np.array_split(signal, parts)])
    return pattern_of_means(means, smooth=smooth, edges=edges)


def pattern_of_means(means: Array, *, smooth: int = SMOOTH, edges: tuple[int, int] = (0, 0)) -> ColumnPattern:
    """Column fixed pattern from the mean signal (parts, columns) of each column in parts of a strip.

    Other parameters are those of `column_pattern`.
    """
    from scipy.signal import savgol_coeffs  # a quarter of a second, which every command would wait for

    parts, columns = means.shape
    inner = slice(edges[0], columns - edges[1])
    means = means[:, inner]
    relative = means / means.mean(axis=1, keepdims=True)
    kernel = -savgol_coeffs(smooth, 2)
    kernel[smooth // 2] += 1.0
    half = smooth // 2
    high = convolve1d(relative, kernel, axis=1, mode="nearest")[:, half:-half]
    products = high @ high.T / high.shape[1] / (kernel**2).sum()
    apart = np.abs(np.subtract.outer(np.arange(parts), np.arange(parts)))
    pattern = np.full(columns, np.nan)
    pattern[edges[0] + half : columns - edges[1] - half] = high.mean(axis=0)
    return ColumnPattern(
        pattern,
        _common(products, apart >= 2),
        _common(products, (apart >= 2) & (apart < parts // 2)),
        _common(products, apart >= parts // 2),
        float(np.diag(products).mean()),
    )


def _common(products: Array, pairs: NDArray[np.bool_]) -> Estimate:
    """Mean of the products of pairs of parts; sigma by leaving out each part. NaN without pairs."""
    if not pairs.any():
        return Estimate(np.nan, np.nan)
    parts = len(products)
    keep = ~np.eye(parts, dtype=bool)
    left_out = np.array(
        [products[np.ix_(keep[k], keep[k])][pairs[np.ix_(keep[k], keep[k])]].mean() for k in range(parts)]
    )
    sigma = np.sqrt((parts - 1) / parts * ((left_out - left_out.mean()) ** 2).sum())
    return Estimate(float(products[pairs].mean()), float(sigma))


@dataclass(frozen=True, eq=False)
class LawFit:
    """Coefficients of a variance A s^2 + B s + C^2, or of some of its terms, and their covariance.

    Attributes
    ----------
    coefficients : (terms,) float64
    covariance : (terms, terms) float64
    """

    coefficients: Array
    covariance: Array

    def estimate(self, index: int) -> Estimate:
        """One coefficient and its sigma."""
        return Estimate(float(self.coefficients[index]), float(np.sqrt(self.covariance[index, index])))


def fit_law(rows: ArrayLike, measured: ArrayLike, covariance: ArrayLike) -> LawFit:
    """Weighted least squares of the coefficients of a variance.

    Parameters
    ----------
    rows : (measurements, terms) array_like
        What each measurement is of the coefficients. Of A, B, C^2: (s^2, s, 1) for a variance at signal s,
        (2 s, 1, 0) for its slope, (0, 1, 0) for B itself.
    measured : (measurements,) array_like
    covariance : (measurements, measurements) array_like

    Raises
    ------
    EstimationError
        If they do not separate the terms.
    """
    design, target = np.asarray(rows, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    try:
        weighted = np.linalg.solve(np.asarray(covariance, dtype=np.float64), design)
    except np.linalg.LinAlgError:
        raise EstimationError(
            "the errors of the measurements have no inverse: numbers of unlike size; look at the signals and "
            "at the dark level"
        ) from None
    with np.errstate(divide="ignore", invalid="ignore"):
        # A s^2 and C^2 differ by seven orders of magnitude
        scale = 1.0 / np.sqrt(np.diag(design.T @ weighted))
        normal = scale[:, None] * (design.T @ weighted) * scale
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e12:
        raise EstimationError("the measurements do not separate A, B and C; give other signals")
    inverse = scale[:, None] * np.linalg.inv(normal) * scale
    return LawFit(inverse @ (weighted.T @ target), inverse)
