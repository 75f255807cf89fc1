"""What aliasing makes of matches of coarse pixels, as a finer image of the ground or they themselves show it.

Detail finer than a pixel comes back at other frequencies, and moves there otherwise than the edges do, as
moire does. What it does to a match depends on where the ground's detail meets the pixels of both images: on
the motion itself, of which it feigns up to a tenth.

Not here: how images are laid on one another (``laid_strips.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.robust import robust_sigmas
from sightline.matching.matches import Matches
from sightline.matching.whitening import Whitening

Array = NDArray[np.float64]

#: px of the hub by which a finer partner is moved to see how matches respond, and how far the response of a
#: window may lie from the usual one.
RESPONSE_STEP, RESPONSE_SPREAD = 0.05, 0.5
#: Sigmas beyond which shifts do not tell how far aliasing explains them.
FOLD_CLIP = 4.0
#: Cycles per pixel below which detail is hardly aliased, windows by which it is compared with all detail, and
#: in how many stretches of the strip these lie: reading what is between them would cost more than they do.
HARDLY_ALIASED, PHASE_WINDOWS, PHASE_STRETCHES = 0.29, 3000, 15
#: Sigmas by which the mean bias of a hub's pairs must be negative to be taken for one, and px of the largest.
PHASE_SHOWN, PHASE_MOST = 4.0, 0.1
#: px that the sigma of a bias may have to tell anything, and the fewest windows that do.
PHASE_SIGMA, PHASE_LEAST = 0.02, 50


def response(matches: Matches, moved: Sequence[Matches]) -> Array:
    """(N, 2, 2) change of matches with the shift of a finer partner, as `moved` shows it.

    What a coarse pixel shows of detail finer than itself moves otherwise than its edges, as moire does, and
    takes part of the shift back: measured once, the shift is found as a share of itself. Windows that were
    not matched again, or answer otherwise than most, respond as the median does.
    """
    out = np.stack([(matches.b - other.b) / RESPONSE_STEP for other in moved], axis=2)
    usable = matches.kept & np.isfinite(out).all(axis=(1, 2))
    for other in moved:
        usable &= other.kept
    if not usable.any():
        return np.broadcast_to(np.eye(2), out.shape)
    middle = np.median(out[usable], axis=0)
    with np.errstate(invalid="ignore"):
        usable &= (np.abs(out - middle) <= RESPONSE_SPREAD).all(axis=(1, 2))
    out[~usable] = middle
    return out


def folding(shift: Array, fold: Array, known: NDArray[np.bool_], rows: Array) -> tuple[Array, Array]:
    """What aliasing adds to matches of two coarse images.

    A finer image is averaged over the pixels of both, as each lay on the ground, and these two are matched as
    the images themselves were: they hold the same detail at the same places, and no motion that is unknown to
    the cameras. What is found between them is aliasing, as far as the finer image lies where the cameras have
    it and shows what the coarse ones show: its share in the shifts is the slope within rows of windows, which
    see the same motion.

    Parameters
    ----------
    shift : (N, 2)
        px; matches of the two images.
    fold : (N, 2)
        px; matches of what the finer image makes of them.
    known : (N,) bool
        Where that was found.
    rows : (N,)
        Equal for windows of one row.

    Returns
    -------
    folded : (N, 2)
        px, to be taken off; 0 where it is not known.
    covariance : (N, 2, 2)
        px^2, of what is not known; 0 where it is.
    """
    folded, unknown = np.zeros(shift.shape), np.zeros((len(shift), 2, 2))
    known = known & np.isfinite(fold).all(axis=1)
    if known.sum() < 2:
        return folded, unknown
    _, row = np.unique(rows[known], return_inverse=True)
    count = np.bincount(row)
    within = []
    for values in (shift[known], fold[known]):
        mean = np.stack([np.bincount(row, part) / count for part in values.T], axis=1)
        within.append(values - mean[row])
    usual = np.ones(len(row), dtype=bool)
    for values in within:
        usual &= (np.abs(values) <= FOLD_CLIP * robust_sigmas(values, 0)).all(axis=1)
    own, made = within[0][usual], within[1][usual]
    square = float((made**2).sum())
    share = float(np.clip((own * made).sum() / square, 0.0, 1.0)) if square > 0.0 else 0.0
    folded[known] = share * fold[known]
    unknown[~known] = share**2 * (fold[known].T @ fold[known]) / known.sum()
    return folded, unknown


def phase_between(places: Array, found: Array, affine: Array) -> Array:
    """(N, 2) px of the hub, modulo 1: by how much the pixels of a partner lie before those of the hub.

    `found` (N, 2) is where `places` (N, 2) lie in the partner, `affine` (N, 2, 2) how that changes.
    """
    line, column = (np.rint(found) - found).T
    (a, b), (c, d) = np.moveaxis(affine, 0, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        nearest = np.stack([d * line - b * column, a * column - c * line], axis=1) / (a * d - b * c)[:, None]
    return np.asarray(-(places + nearest))


def in_stretches(count: int) -> NDArray[np.intp]:
    """Which of so many windows, row by row, tell the bias: all, or stretches evenly spaced over the strip."""
    if count <= PHASE_WINDOWS:
        return np.arange(count)
    each = PHASE_WINDOWS // PHASE_STRETCHES
    first = np.linspace(0, count - each, PHASE_STRETCHES).astype(np.intp)
    return np.asarray((first[:, None] + np.arange(each)).ravel())


def phase_bias(
    matched: Callable[[Whitening], Matches], whitening: Whitening, phase: Array
) -> tuple[Array, Array]:
    """Sizes of what aliasing adds to matches of two images alike, along lines and columns, and their sigmas.

    Parameters
    ----------
    matched : callable
        Matches of the same N windows through any filters.
    whitening : Whitening
        Filters of the pair.
    phase : (N, 2)
        px; as `phase_between` gives them.

    Returns
    -------
    sizes, sigmas : (2,)
        px; of ``sin(2 pi phase)``. Infinite sigmas where the windows do not tell.

    Notes
    -----
    With the power P(f) that a pixel lets through, two images x px apart have the cross-spectrum
    ``exp(2 pi i f x) (P(f) + P(1 - f) exp(-2 pi i x))``: matches are drawn towards whole pixels by
    ``sin(2 pi x)``, the more the nearer to the Nyquist frequency. What all detail finds less what detail far
    below finds is most of it, seven to nine tenths, and hardly any motion.
    """
    whole, low = matched(whitening), matched(whitening.below(HARDLY_ALIASED))
    good = whole.kept & low.kept & np.isfinite(phase).all(axis=1)
    slopes = [
        _slope(
            (whole.b - low.b)[good, axis],
            np.sin(2.0 * np.pi * phase[good, axis]),
            1.0 / low.covariance_px[good, axis, axis],
        )
        for axis in range(2)
    ]
    sizes, sigmas = np.transpose(slopes)
    return sizes, sigmas


def pooled_bias(sizes: Array, sigmas: Array) -> Array:
    """What sizes of one axis (K,) px with their sigmas most likely are, as a normal family of them.

    0 of all where their mean is not plainly negative: aliasing draws matches towards whole pixels alone. 0 of
    one whose windows do not tell, too: where the phase does not vary, the bias is an offset.
    """
    told = sigmas <= PHASE_SIGMA
    out = np.zeros(sizes.shape)
    own, variance = sizes[told], np.maximum(sigmas[told], 1e-3 * PHASE_SIGMA) ** 2
    weight = 1.0 / variance
    if not told.any() or weight @ own > -PHASE_SHOWN * np.sqrt(weight.sum()):
        return out
    mean = float(weight @ own) / float(weight.sum())
    between = 0.0
    if len(own) > 1:
        # spread among them by its moment (DerSimonian and Laird), no larger than such a bias may be
        excess = float(weight @ (own - mean) ** 2) - (len(own) - 1)
        between = max(excess / float(weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
        between = min(between, (0.5 * mean) ** 2)
    weight = 1.0 / (variance + between)
    mean = float(weight @ own) / float(weight.sum())
    out[told] = np.clip(mean + between * weight * (own - mean), -PHASE_MOST, 0.0)
    return out


def _slope(y: Array, x: Array, weight: Array) -> tuple[float, float]:
    """Slope of y with x beside a constant, and its sigma; values that lie far off have no part in it."""
    slope, sigma = 0.0, np.inf
    usual = np.ones(len(y), dtype=bool)
    for _ in range(3):
        w = np.where(usual, weight, 0.0)
        total = max(float(w.sum()), np.finfo(float).tiny)
        across = x - (w @ x) / total
        square = float(w @ across**2)
        if usual.sum() < PHASE_LEAST or square <= 0.0:
            return 0.0, np.inf
        slope = float(w @ (across * y)) / square
        left = y - (w @ y) / total - slope * across
        scaled = left * np.sqrt(weight)
        spread = float(robust_sigmas(scaled[usual, None], 0)[0])
        sigma = spread / np.sqrt(square)
        usual = np.abs(scaled) <= FOLD_CLIP * spread
    return slope, sigma
