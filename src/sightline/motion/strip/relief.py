"""Relief that is not in the surface: a process of its own beside the motion.

Parallax of unknown heights looks like pitch (mean height of a row) and yaw (its slope across the
field), grows with the lag and belongs to the ground, not to the time. Two processes per row carry
it, so that the sigma of the motion owns what relief can hide, and pairs of several lags separate
what they can (S1, relief nuisance A_h + j B_h).

Not here: known relief, which is in the surface (``geometry/surface.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from sightline.estimation.prior import Autoregressive, autoregressive
from sightline.geometry.checks import ReadOnlyArrays
from sightline.geometry.surface import Surface
from sightline.motion.measure.match_noise import scatter
from sightline.motion.measure.observations import Star
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.windows import exposure_times, image_shape
from sightline.motion.strip.normal_equations import TimeGrid

Array = NDArray[np.float64]

#: Order of the relief's autoregressions.
ORDER = 40
#: Positions across the field at which a row of ground is sampled.
ROW_SAMPLES = 21
#: Unknown relief is no smoother than this: its correlation length is at most so many half swaths, or that of
#: slopes (sigma over length) so small. What does not show within a row is not thereby known to be flat.
LONGEST, LEAST_SLOPE = 2.0, 0.1
#: Nor is it rougher than hills of such slopes: foreign windows, and textures that err more along lines than
#: along columns, scatter as fine relief would, which averages out of a row and would own nothing.
STEEPEST_SLOPE = 0.5
#: Products of residuals that tell a variance; rows of windows over which hills may be alike; variances of
#: matches along lines and columns are unlike by such a share of themselves.
FEWEST_PRODUCTS, ALIKE_ROWS, UNLIKE_AXES = 30, 9, 0.2
#: Standard deviations by which what residuals show of relief may be wrong.
SURE = 2.0
#: Rows of a strip, and correlation lengths, of which is compared what they hide; of the strip no more than so
#: many of the longest length: what that hides shrinks with all alike.
HIDING_ROWS, HIDING_LENGTHS, HIDING_ALONG = 31, 12, 10.0
#: Sizes that unknown relief may have, as shares of the sigma that was given; how probable each is beforehand.
SHARES = 0.25 ** np.arange(3)
BELIEF = np.array([0.8, 0.1, 0.1])
#: Correlation lengths over which likelihoods are averaged, from the shortest to the longest that is believed.
LENGTHS = 3
#: Smaller sizes are not tried where one is less likely than the best by this, in natural logarithms.
FAR_LESS = 12.0


@dataclass(frozen=True, eq=False)
class RowRelief(ReadOnlyArrays):
    """Ground that was found beside the motion: rows of it, as one image sees them.

    Attributes
    ----------
    image : int
        Number of that image.
    t : (N,)
        s; when it sees each row.
    heights : (N, 2)
        m above the surface that was given: mean of the row, and what its end at the last column adds.
    sigma : (N, 2)
        m; of both.
    """

    image: int
    t: Array
    heights: Array
    sigma: Array

    def at(self, t: Array, field: Array) -> Array:
        """Heights (N,) m where the image sees ground at times `t` (N,) and places `field` (N,), -1 to 1."""
        mean, slope = (np.interp(t, self.t, column) for column in self.heights.T)
        return np.asarray(mean + slope * field)


def relief_matters(stars: Sequence[Star], height_sigma: float) -> bool:
    """Whether heights unknown by `height_sigma` (m) move matches by a noticeable part of their error."""
    if height_sigma <= 0.0:
        return False
    for star in stars:
        seen = star.present
        if seen.any():
            parallax = np.abs(star.by_height[seen]).max(axis=0) * height_sigma
            variance = np.median(star.covariance_px[seen][:, [0, 1], [0, 1]], axis=0)
            # a row of windows averages the errors of its blocks: a tenth of one window's sigma matters there
            if (parallax > 0.1 * np.sqrt(variance)).any():
                return True
    return False


def hub_delay(cameras: Sequence[MovingCamera], surface: Surface, hub: int, first: int) -> float:
    """How much later (s) the image `hub` sees a piece of ground than the image `first` does."""
    if hub == first:
        return 0.0
    camera = cameras[hub]
    lines, columns = image_shape(camera)
    pixels = np.stack([np.linspace(0, lines - 1, 41), np.full(41, (columns - 1) / 2)], axis=1)
    there = exposure_times(cameras[first], cameras[first].project(camera.locate(pixels, surface)))
    delay = exposure_times(camera, pixels) - there
    return float(np.nanmedian(delay)) if np.isfinite(delay).any() else 0.0


def terrain_covariance(distance: Array, length: float) -> Array:
    """Covariance of unit terrain at `distance` (m): Matern 3/2 of correlation length `length` (m)."""
    r = np.sqrt(3.0) * distance / length
    return np.asarray((1.0 + r) * np.exp(-r))


def _row_functionals() -> tuple[Array, Array, Array]:
    """Positions (-1 .. 1), and the weights that give mean and slope-at-the-edge of a row."""
    x = np.linspace(-1.0, 1.0, ROW_SAMPLES)
    return x, np.full(ROW_SAMPLES, 1.0 / ROW_SAMPLES), x / (x @ x)


def _row_covariances(length: float, half_width: float, apart: Array) -> tuple[Array, Array]:
    """Covariance of the means, and of the slopes, of rows of unit terrain `apart` (m) from the first."""
    x, *functionals = _row_functionals()
    across = half_width * np.subtract.outer(x, x)
    k = terrain_covariance(np.hypot(across[None], apart[:, None, None]), length)
    first, second = (np.einsum("i,lij,j->l", w, k, w) for w in functionals)
    return first, second


def row_processes(
    sigma: float, lengths: tuple[float, float], half_width: float, ground_speed: float, grid: TimeGrid
) -> tuple[Autoregressive, Autoregressive]:
    """Mean height and cross-track slope of rows of terrain as processes on the time grid.

    Parameters
    ----------
    sigma : float
        m; of the terrain.
    lengths : (2,)
        m; its correlation lengths, as the mean and as the slope has them.
    half_width : float
        m; half of the swath.
    ground_speed : float
        m/s; along the track.
    grid : TimeGrid
    """
    apart = grid.step * ground_speed * np.arange(ORDER + 1.0)
    of_each = (_row_covariances(length, half_width, apart)[k] for k, length in enumerate(lengths))
    mean, slope = (autoregressive(sigma**2 * one, ORDER, grid.count) for one in of_each)
    return mean, slope


def detrended_share(length: float, half_width: float) -> float:
    """Share of the terrain's variance left in a row after its mean and slope are taken out."""
    x, mean, slope = _row_functionals()
    k = terrain_covariance(half_width * np.abs(np.subtract.outer(x, x)), length)
    keep = np.eye(len(x)) - np.outer(np.ones(len(x)), mean) - np.outer(x, slope)
    return float(np.trace(keep @ k @ keep.T) / len(x))


def beside_row(length: float, half_width: float) -> float:
    """Standard deviation of unit terrain about mean and slope of its row; of hills of half a swath at most.

    A length is learned from windows that were believed: one too long would have others of the same hills not
    believed.
    """
    return math.sqrt(detrended_share(min(length, half_width), half_width))


def row_scatter(stars: Sequence[Star], post_px: Sequence[Array]) -> tuple[float, float]:
    """Least and largest variance (m^2) that unknown relief may have about mean and slope of its rows.

    Notes
    -----
    What residuals share along the parallax beyond what they share square to it is taken for relief: matching
    errs alike on both axes (in units of its own sigma), relief moves points along the parallax only: lines
    where bands look ahead, columns behind a mirror that scans across. Products of pairs are weighed by their
    scatter. Their mean is known to that of its rows, which are alike over ALIKE_ROWS and hold the errors of
    the hub once for all pairs, and to what errors of both axes may be unlike, once for all; SURE of both lie
    between the two. At short lags the errors alone look like mountains a kilometre high.
    """
    excess, weight, variance, unlike = 0.0, 0.0, 0.0, 0.0
    for star, post in zip(stars, post_px, strict=True):
        z = scatter(star, post).z
        rows, pairs = star.shape[0], star.t.shape[1]
        left = z.reshape(-1, pairs, 2)
        sigma_px = np.sqrt(star.covariance_px[..., [0, 1], [0, 1]])
        # in units of the errors, in which residuals are compared
        by_height = star.by_height / sigma_px
        way = np.nanmedian(by_height.reshape(-1, pairs, 2), axis=0)
        size = np.hypot(way[:, 0], way[:, 1])
        way = np.where(size[:, None] > 0.0, way / np.where(size > 0.0, size, 1.0)[:, None], [1.0, 0.0])
        # heights (1/m) in those units
        gain = np.hypot(by_height[..., 0], by_height[..., 1])
        parallel = np.einsum("gka,ka->gk", left, way)
        square = np.einsum("gka,ka->gk", left, way[:, ::-1] * [-1.0, 1.0])
        of_rows = np.zeros(rows)
        for j, k in combinations(range(pairs), 2) if pairs > 1 else [(0, 0)]:
            errors = square[:, j] * square[:, k]
            beyond = parallel[:, j] * parallel[:, k] - errors
            seen = np.isfinite(beyond)
            number = int(seen.sum())
            if number < FEWEST_PRODUCTS:
                continue
            height = float(np.median((gain[:, j] * gain[:, k])[seen]))
            spread = float(np.var(beyond[seen])) / number
            if not (height > 0.0 and spread > 0.0):
                continue
            share = height / spread
            weight += height * share
            unlike += UNLIKE_AXES * share * float(np.mean(np.abs(errors[seen])))
            of_rows += np.where(seen, beyond, 0.0).reshape(rows, -1).sum(axis=1) * (share / number)
        excess += float(of_rows.sum())
        variance += _variance_of_sum(of_rows)
    if weight == 0.0:
        return 0.0, math.inf
    error = SURE * math.hypot(math.sqrt(variance), unlike)
    return max((excess - error) / weight, 0.0), max((excess + error) / weight, 0.0)


def _variance_of_sum(values: Array) -> float:
    """Of a series (N,) that is alike over ALIKE_ROWS: no less than if all were independent (Bartlett)."""
    left = values - values.mean()
    lags = range(1, min(ALIKE_ROWS, len(left)))
    alike = sum((1.0 - lag / ALIKE_ROWS) * float(left[lag:] @ left[:-lag]) for lag in lags)
    return float(left @ left) + 2.0 * max(alike, 0.0)


def relief_lengths(
    beside: tuple[float, float], sigma: float, half_width: float, along: float
) -> tuple[float, float]:
    """Correlation lengths (m) of mean height and slope of rows, where relief of `sigma` (m) hides most.

    Parameters
    ----------
    beside : (2,)
        m^2; between which the variance about mean and slope of its rows lies, see `row_scatter`.
    sigma, half_width, along : float
        m; of the relief, half of the swath, and how long the strip is.

    Notes
    -----
    Any length between those that have this scatter explains what was seen, all of them where none does. Of
    the mean height a trend over the strip is looked at, which bends pitch (an even one is an even rate), of
    slopes their mean, an even rate of yaw: shorter hills average out, longer ones lie flat.
    """
    lengths = _lengths(sigma, half_width, 60)
    shares = sigma**2 * np.array([detrended_share(length, half_width) for length in lengths])
    least, most = beside
    if least > shares[0] or most <= 0.0:
        least, most = 0.0, math.inf
    longest, shortest = (lengths[int(np.argmin(np.abs(shares - one)))] for one in (least, most))
    some = np.geomspace(shortest, longest, HIDING_LENGTHS)
    rows = np.linspace(0.0, min(along, HIDING_ALONG * lengths[-1]), HIDING_ROWS)
    trend, even = np.linspace(-1.0, 1.0, HIDING_ROWS), np.ones(HIDING_ROWS)
    hidden = []
    for length in some:
        mean, slope = (toeplitz(one) for one in _row_covariances(length, half_width, rows))
        hidden.append([trend @ mean @ trend, even @ slope @ even])
    of_mean, of_slope = some[np.argmax(hidden, axis=0)]
    return float(of_mean), float(of_slope)


def _lengths(sigma: float, half_width: float, number: int) -> Array:
    """Correlation lengths (m) that relief of `sigma` (m) may have."""
    longest = max(LONGEST * half_width, sigma / LEAST_SLOPE)
    return np.geomspace(max(0.05 * half_width, sigma / STEEPEST_SLOPE), longest, number)


def relief_share(likelihood: Callable[[float, float], float], sigma: float, half_width: float) -> float:
    """Root mean square size of unknown relief, as a share of the sigma that was given for it.

    Parameters
    ----------
    likelihood : callable
        Natural logarithm of the likelihood of what was measured, for relief of a sigma and a correlation
        length (m), but for a constant.
    sigma, half_width : float
        m; the sigma that was given, and half of the swath.

    Notes
    -----
    Four fifths of the belief are in what was given, a fifth in sizes down to a 16th of it: a sigma is often
    said for want of a DEM, of ground that is far flatter. Variances are averaged; where images tell nothing,
    most of what was given stays. Likelihoods are averaged over correlation lengths: of one that is wrong the
    size would take the blame.
    """
    found: list[float] = []
    for share in SHARES:
        each = [
            likelihood(share * sigma, one) for one in _lengths(share * sigma, half_width, LENGTHS).tolist()
        ]
        found.append(float(np.logaddexp.reduce(each)))
        if found[-1] < max(found) - FAR_LESS:
            break
    weights = BELIEF[: len(found)] * np.exp(np.array(found) - max(found))
    return float(np.sqrt(weights @ SHARES[: len(found)] ** 2 / weights.sum()))
