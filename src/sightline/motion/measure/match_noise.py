"""How wrong the matches are, learned from their own scatter across the field.

Within one row of windows the motion can only shift and tilt the residuals; what is left is
error of matching. Its covariance between pairs (which share the hub's error) and from row to
row (which share texture) is pooled over the strip, free of any belief about the motion.

Not here: the matcher's own covariance of a single match (``matching/``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.robust import robust_sigmas
from sightline.motion.measure.observations import (
    Star,
    scale_residuals,
    scaled_pixel,
    shared_image_correlation,
)
from sightline.motion.measure.windows import stretches
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]

#: Rows of windows need this many blocks to tell error from motion; where most have no more, three do, which
#: leave one degree of freedom each.
MIN_BLOCKS, LEAST_BLOCKS = 4, 3
#: Degrees of freedom per component from which errors are learned to the full, and what the start value counts
#: for among fewer.
PLENTY, START_COUNTS = 100.0, 10.0
#: Degrees of freedom from which they are learned at all, of rows of so many windows at least.
FEWEST = {LEAST_BLOCKS: 40.0, MIN_BLOCKS: PLENTY}
#: Of few rows, a correlation from row to row is believed where it is so many times what chance makes.
BEYOND_CHANCE = 2.0
#: Rows on either side over which the scatter of rows is averaged before it is compared with the usual one.
ROW_REACH = 6
#: Rows over which the correlation from row to row is followed, with weights that fall to zero: real textures
#: of different bands err alike over ten rows, and a sum cut hard need not be a covariance.
ROW_LAGS = 8
#: Errors last where they correlate by so much over the next ROW_LAGS rows, and by so many times more than
#: chance makes of none.
LASTING, BEYOND_LASTING = 0.05, 5.0
#: Errors beyond this many sigmas lose weight (1 % of two Gaussian components), beyond REJECT all (4e-6).
SOFT, REJECT = 3.0, 5.0
#: Blocks per row, and runs of rows, from which errors shared by neighbours are estimated; their most.
LEAST_BESIDE, MOST_BESIDE = 6, 4.0
#: Scaled residuals are cut to this size where covariances are summed.
CLIP = 6.0
#: Windows over which products are summed at a time.
SUMMED = 65536
#: Least eigenvalue of a covariance of pairs, scaled to a diagonal of 1.
LEAST_SHARE = 0.05


@dataclass(frozen=True)
class RowScatter:
    """Residuals of the windows of a star about what the motion can make of their rows.

    Attributes
    ----------
    z : (rows, blocks, 2K)
        In units of each match's sigma, its weight included; NaN where absent, or where the row holds too few.
    freedom : (rows, blocks, 2K)
        Share of each value's variance that the line of its row leaves; 0 where absent.
    counts : (rows, blocks, 2K)
        What each match tells of the motion of its row, over the mean of the row; 0 where absent.
    """

    z: Array
    freedom: Array
    counts: Array

    @property
    def degrees(self) -> Array:
        """(rows, 2K) degrees of freedom left in each row."""
        return self.freedom.sum(axis=1)

    @property
    def independent(self) -> Array:
        """(2K,) degrees of freedom of one weight that would tell as much as all do by their counts."""
        total, squares = np.zeros((2, self.z.shape[2]))
        for here in _rows(self.z):
            told = self.counts[here] * self.freedom[here]
            total += told.sum(axis=(0, 1))
            squares += (told * self.counts[here]).sum(axis=(0, 1))
            let_go()
        return np.asarray(total**2 / np.maximum(squares, 1e-30))


def scatter(star: Star, post_px: Array, least: int = MIN_BLOCKS) -> RowScatter:
    """Residuals (G, K, 2) px after an estimate, less shift and tilt of each row of `least` windows or more.

    Notes
    -----
    A shift moves all windows of a row by as many pixels, not by as many of their sigmas: where these differ,
    what is left is that of a weighted line.
    """
    rows, blocks = star.shape
    pairs = star.t.shape[1]
    z, freedom, counts = (scratch_array((rows, blocks, 2 * pairs)) for _ in range(3))
    present = star.present
    for some in star.stretches():
        here = slice(some.start // blocks, some.stop // blocks)
        weight = np.sqrt(np.repeat(star.weight[some], 2, axis=1))
        scaled = scale_residuals(post_px[some], star.covariance_px[some]) * weight
        per_px = scaled_pixel(star.covariance_px[some]) * weight
        scaled, per_px = (each.reshape(-1, blocks, 2 * pairs) for each in (scaled, per_px))
        seen = np.repeat(present[some].reshape(-1, blocks, pairs), 2, axis=2) & np.isfinite(scaled)
        field = star.field[some].reshape(-1, blocks)[:, :, None]
        z[here], freedom[here], counts[here] = _about_lines(scaled, per_px, seen, field, least)
        let_go()
    return RowScatter(z, freedom, counts)


def _about_lines(
    z: Array, per_px: Array, seen: NDArray[np.bool_], x: Array, least: int
) -> tuple[Array, Array, Array]:
    """`RowScatter` of scaled residuals (rows, blocks, 2K) at places `x`, whose units are 1 / `per_px`."""
    w, v = np.where(seen, per_px, 0.0), np.where(seen, z, 0.0)
    number = seen.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        # the mean square of a row is 1: the determinant tells whether its windows lie apart
        w = w / np.sqrt((w**2).sum(axis=1, keepdims=True) / number)
        s0, s1, s2 = (np.asarray((w * w * x**n).sum(axis=1, keepdims=True)) for n in range(3))
        y0, y1 = ((w * v * x**n).sum(axis=1, keepdims=True) for n in range(2))
        det = s0 * s2 - s1 * s1
        slope, mean = (s0 * y1 - s1 * y0) / det, (s2 * y0 - s1 * y1) / det
        left = z - w * (mean + slope * x)
        # of a match that its row hardly adds to, rounding leaves less than nothing
        freedom = np.maximum(1.0 - w * w * (s2 - 2.0 * s1 * x + s0 * x * x) / det, 0.0)
    there = seen & (number >= least) & (det > 1e-9)
    return np.where(there, left, np.nan), np.where(there, freedom, 0.0), np.where(there, w * w, 0.0)


def estimate_correlation(star: Star, post_px: Array) -> Array:
    """Error correlation (2K, 2K) of a star's pairs, rows' long-run correlation included.

    The shared-image start value where the rows hold too few windows of every pair; where they hold few,
    something between it and what they show. A pair that has too few alone errs as the others do, as far as
    its own do not say.
    """
    pairs = star.t.shape[1]
    start = shared_image_correlation(pairs)
    least = least_blocks(star)
    found = scatter(star, post_px, least)
    own = found.independent
    enough: NDArray[np.bool_] = np.all((own >= FEWEST[least]).reshape(-1, 2), axis=1)
    if not enough.any():
        return start
    told = np.repeat(enough, 2)
    counted = float(own[told].mean())
    # what rows err by is what their good matches err by: of noisy ones, which count for little in the motion,
    # the matcher's sigma may be wrong by another factor
    v, root = found.z, found.freedom
    for here in _rows(v):
        v[here] = np.nan_to_num(np.clip(v[here], -CLIP, CLIP))
        let_go()
    beside = np.tile(np.sqrt(_error_beside(v)), pairs)
    for here in _rows(v):
        size = np.sqrt(found.counts[here])
        v[here], root[here] = v[here] * size, np.sqrt(root[here]) * size
        let_go()

    def covariance(shift: int) -> tuple[Array, float]:
        total, both = np.zeros((2 * pairs, 2 * pairs)), np.zeros((2 * pairs, 2 * pairs))
        for here in _rows(v[shift:], SUMMED):
            later = slice(here.start + shift, here.stop + shift)
            both += np.einsum("rbi,rbj->ij", root[here], root[later])
            total += np.einsum("rbi,rbj->ij", v[here], v[later])
            let_go()
        return np.asarray(total / np.maximum(both, 1.0)), float(np.diag(both)[told].sum())

    plain, products = covariance(0)
    long, chance = _long_run(plain, covariance, counted / products, overlapping(star))
    usual = np.sqrt(np.diag(plain)[told].reshape(-1, 2).mean(axis=0))
    share = np.where(told, 1.0, np.sqrt(own / (own + START_COUNTS)))
    given = start * np.outer(np.tile(usual, pairs), np.tile(usual, pairs))
    plain = np.outer(share, share) * plain + (1.0 - np.outer(share, share)) * given
    if counted < PLENTY:
        total = (counted * plain + START_COUNTS * start) / (counted + START_COUNTS)
        grown = np.sqrt(_believed_ratio(long, plain, chance, enough))
        total = total * np.outer(grown, grown)
        # of pairs that are not seen in the same windows: no covariance of anything, it may be
        return _definite(total, np.sqrt(np.diag(total)))
    scale = np.sqrt(np.diag(plain))
    total = _steadied(plain, long, chance, enough)
    total = total * np.outer(beside, beside)
    scale = scale * beside
    # long-run sums may fall below the plain variance by chance or by overlap; never trust more than half
    return _definite(total, scale)


def overlapping(star: Star) -> int:
    """Later rows with which the windows of a row share lines."""
    starts = star.t_hub.reshape(star.shape)[:, 0]
    apart = float(np.median(np.diff(starts))) if len(starts) > 1 else 0.0
    return min(max(math.ceil(star.duration / apart - 1e-6), 1), len(starts)) - 1 if apart > 0.0 else 0


def _long_run(
    plain: Array, covariance: Callable[[int], tuple[Array, float]], independent: float, overlapping: int
) -> tuple[Array, float]:
    """Covariance (2K, 2K) of long means of rows by Bartlett's weights, and its scatter by chance as a share.

    Rows that share pixels certainly err alike: these count in full, however many they are.

    Parameters
    ----------
    plain : (2K, 2K)
        Of single rows.
    covariance : callable
        Of single rows with what lies so many rows on, (2K, 2K), and how many products it is of.
    independent : float
        Independent values of one component to one of these products.
    overlapping : int
        Later rows with which a row shares pixels.
    """
    total = plain
    squares = 2.0 / (independent * covariance(0)[1])
    for shift in range(1, max(ROW_LAGS, overlapping) + 1):
        step, products = covariance(shift)
        if products <= 0.0:  # beyond the last row, or between rows that are all absent
            continue
        weight = 1.0 if shift <= overlapping else 1.0 - shift / (ROW_LAGS + 1.0)
        total = total + weight * (step + step.T)
        # a mean of products, twice
        squares += 4.0 * weight**2 / (independent * products)
    return total, float(np.sqrt(squares))


def _steadied(plain: Array, long: Array, chance: float, enough: NDArray[np.bool_]) -> Array:
    """Covariance (2K, 2K) of long means, in place of one of which the sums of few rows are mostly chance.

    Parameters
    ----------
    plain, long : (2K, 2K)
        Of single rows, and of long means as sums of rows have it.
    chance : float
        By how much the variances of `long` scatter, as a share.
    enough : (K,)
        Pairs of which `long` is believed so far; the others have the mean.

    Notes
    -----
    What errors of a row share with later rows is of the texture, and much alike for all pairs: as far as the
    pairs differ by no more than chance (James and Stein), they have the mean of all.
    """
    ratio = (np.diag(long) / np.diag(plain)).reshape(-1, 2)  # along lines, along columns
    mean, number = ratio[enough].mean(axis=0), int(enough.sum())
    spread = float(np.mean((ratio[enough] / mean - 1.0) ** 2)) * number / max(number - 1, 1)
    believed = np.where(enough, max(0.0, 1.0 - chance**2 / spread) if spread > 0.0 else 0.0, 0.0)
    ratio = mean + believed[:, None] * (ratio - mean)
    size = np.sqrt(np.maximum(ratio, LEAST_SHARE).ravel() * np.diag(plain))

    def correlation(c: Array) -> Array:
        own = np.sqrt(np.maximum(np.diag(c), LEAST_SHARE * np.diag(plain)))
        return np.asarray(c / np.outer(own, own))

    trust = np.repeat(np.minimum.outer(believed, believed), 2, axis=0).repeat(2, axis=1)
    both = trust * correlation(long) + (1.0 - trust) * correlation(plain)
    return np.asarray(both * np.outer(size, size))


def lasts(star: Star, post_px: Array) -> bool:
    """Whether windows err alike over many rows, by residuals (G, K, 2) px after an estimate.

    Rows of fewer than LEAST_BESIDE windows, and fewer rows than tell of neighbours, say nothing of it; nor do
    rows that share pixels.
    """
    rows, blocks = star.shape
    apart = overlapping(star)
    if blocks < LEAST_BESIDE or rows - apart < LEAST_BESIDE * (ROW_LAGS + 1):
        return False
    z = np.clip(scatter(star, post_px).z, -CLIP, CLIP)
    products = [z[:-shift] * z[shift:] for shift in range(apart + 1, apart + ROW_LAGS + 1)]
    number = sum(int(np.isfinite(p).sum()) for p in products)
    if not number:
        return False
    correlation = sum(float(np.nansum(p)) for p in products) / number / float(np.nanmean(z**2))
    # all pairs share the hub's error: they count as one
    chance = np.sqrt(star.t.shape[1] / number)
    return bool(correlation > max(LASTING, BEYOND_LASTING * chance))


def _definite(total: Array, scale: Array) -> Array:
    """A covariance whose eigenvalues, in units of `scale`, are LEAST_SHARE at least."""
    values, vectors = np.linalg.eigh(total / np.outer(scale, scale))
    total = (vectors * np.maximum(values, LEAST_SHARE)) @ vectors.T * np.outer(scale, scale)
    return np.asarray(0.5 * (total + total.T))


def least_blocks(star: Star) -> int:
    """Windows that a row of the star must hold to tell of errors: three where most rows have no more."""
    held = star.present.reshape(*star.shape, -1).sum(axis=1)
    more, three = int((held >= MIN_BLOCKS).sum()), int((held == LEAST_BLOCKS).sum())
    return LEAST_BLOCKS if three > more else MIN_BLOCKS


def single_errors(stars: Sequence[Star], posts: Sequence[Array]) -> list[Array]:
    """`Star.single` (K, 2, 2) of each star, from the scatter of its residuals (G, K, 2) px within rows.

    Pairs of too few windows have the mean of the others; what the matcher claims where there are none.
    """
    found = [_scatter_of_pairs(*both) for both in zip(stars, posts, strict=True)]
    known = np.concatenate([np.empty((0, 2, 2)), *found])
    known = known[np.isfinite(known).all(axis=(1, 2))]
    usual = known.mean(axis=0) if len(known) else np.eye(2)
    return [np.where(np.isnan(each), usual, each) for each in found]


def _scatter_of_pairs(star: Star, post_px: Array) -> Array:
    """(K, 2, 2) scatter of scaled residuals within rows; NaN of pairs whose rows hold too few windows.

    Among few, a value as the matcher claims counts as START_COUNTS of them.
    """
    least, pairs = least_blocks(star), star.t.shape[1]
    found = scatter(star, post_px, least)
    squares = np.zeros((pairs, 2, 2))
    for here in _rows(found.z, SUMMED):
        z = np.nan_to_num(np.clip(found.z[here], -CLIP, CLIP)).reshape(-1, pairs, 2)
        squares += np.einsum("gki,gkj->kij", z, z)
        let_go()
    counted = found.degrees.sum(axis=0).reshape(pairs, 2)
    enough = (counted >= FEWEST[least]).all(axis=1)
    counted = np.sqrt(counted[:, :, None] * counted[:, None, :])
    given = np.where(counted < PLENTY, START_COUNTS, 0.0)
    out = (squares + given * np.eye(2)) / np.maximum(counted + given, 1.0)
    return np.where(enough[:, None, None], out, np.nan)


def _believed_ratio(long: Array, plain: Array, chance: float, enough: NDArray[np.bool_]) -> Array:
    """(2K,) variance of long means over that of single rows, for few rows: 1 where chance makes as much.

    Pairs (K,) that have not `enough` rows have the mean of those that do.
    """
    ratio = np.diag(long) / np.maximum(np.diag(plain), 1e-30)
    ratio = np.where(ratio > 1.0 + BEYOND_CHANCE * chance, ratio, 1.0).reshape(-1, 2)
    return np.where(enough[:, None], ratio, ratio[enough].mean(axis=0)).ravel()


def _error_beside(v: Array) -> Array:
    """(2,) variance of a row's mean over that of independent windows, for errors along lines and columns.

    Texture that reaches over several windows makes neighbours err alike, and the line fitted to a short row
    hides most of that. What residuals of a row with correlation rho between neighbours look like after the
    fit is compared with what they are, over runs of rows (``v``: (rows, blocks, 2K), zero where absent).
    """
    rows, blocks = v.shape[:2]
    run = ROW_LAGS + 1
    if blocks < LEAST_BESIDE or rows < LEAST_BESIDE * run:
        return np.ones(2)
    products = np.zeros((2, blocks, blocks))
    for here in _rows(v[run - 1 :], SUMMED):
        part = v[here.start : here.stop + run - 1]
        total = np.cumsum(np.concatenate([np.zeros_like(part[:1]), part]), axis=0)
        runs = total[run:] - total[:-run]
        for axis in range(2):
            products[axis] += np.einsum("rbi,rci->bc", runs[:, :, axis::2], runs[:, :, axis::2])
        let_go()
    x = np.linspace(-1.0, 1.0, blocks)
    line = np.stack([np.ones(blocks), x], axis=1)
    kept = np.eye(blocks) - line @ np.linalg.pinv(line)
    beside = np.eye(blocks, k=1) + np.eye(blocks, k=-1)
    expected = [[np.trace(kept @ c @ kept, offset=d) for c in (np.eye(blocks), beside)] for d in range(5)]
    out = np.ones(2)
    for axis in range(2):
        found = [np.trace(products[axis], offset=d) for d in range(5)]
        alone, shared = np.linalg.lstsq(np.array(expected), np.array(found), rcond=None)[0]
        rho = shared / max(float(alone), 1e-30)
        # of so many independent runs of windows; a correlation that chance makes as large is none
        if rho > 2.5 / np.sqrt(blocks * rows / run):
            plain = found[0] / expected[0][0]
            out[axis] = np.clip(alone / plain * (1.0 + 2.0 * rho * (1.0 - 1.0 / blocks)), 1.0, MOST_BESIDE)
    return out


def row_weights(star: Star, post_px: Array) -> Array:
    """Weights (G, K) that own the scatter of each stretch of rows where it exceeds the usual one.

    Half-clouded ground leaves windows that are wrong by less than can be rejected: where the rows scatter
    more than the median row does, their matches count for less, and the sigma there grows.
    """
    rows, blocks = star.shape
    pairs = star.t.shape[1]
    found = scatter(star, post_px)
    z, degrees = found.z, found.degrees
    out = np.ones((rows, pairs))
    kernel = np.ones(2 * ROW_REACH + 1)
    inner = slice(ROW_REACH, ROW_REACH + rows)
    for k in range(pairs):
        both = slice(2 * k, 2 * k + 2)
        squares = np.concatenate([np.nansum(z[here, :, both] ** 2, axis=(1, 2)) for here in _rows(z)])
        squares = np.convolve(squares, kernel)[inner]
        let_go()
        count = np.convolve(degrees[:, both].sum(axis=1), kernel)[inner]
        seen = count > 0
        if seen.any():
            local = np.where(seen, squares / np.maximum(count, 1.0), np.nan)
            out[:, k] = np.where(seen, np.minimum(1.0, np.nanmedian(local) / np.maximum(local, 1e-12)), 1.0)
    return np.asarray(np.repeat(out, blocks, axis=0))


def robust_weights(star: Star, post_px: Array) -> Array:
    """Weights (G, K) in [0, 1] of matches after an estimate: 1 inside, falling beyond SOFT, 0 beyond REJECT.

    Single mismatches; windows that saw something else than ground for longer: ``consensus.py``.
    """
    pairs = star.t.shape[1]
    out = scratch_array((len(post_px), pairs))
    for k in range(pairs):
        z = star.each(scale_residuals, post_px[:, k : k + 1], star.covariance_px[:, k : k + 1])
        finite = np.isfinite(z[:, 0])
        trusted = finite & (star.weight[:, k] > 0)
        if not trusted.any():
            trusted = finite
        if not finite.any():
            continue
        # by the median, so that mismatches do not widen it
        spread = np.maximum(robust_sigmas(z[trusted], axis=0), 1.0)
        for some in star.stretches():
            distance = np.sqrt(((z[some] / spread) ** 2).sum(axis=1))
            keep = finite[some] & (distance <= REJECT)
            out[some, k] = np.where(keep, np.minimum(1.0, SOFT / np.maximum(distance, 1e-12)), 0.0)
            let_go()
    return out


def _rows(z: Array, at_once: int | None = None) -> list[slice]:
    """Rows of windows (rows, blocks, ...), some at a time."""
    rows, blocks = z.shape[:2]
    return [slice(some.start // blocks, some.stop // blocks) for some in stretches(rows, blocks, at_once)]
