"""What aliasing makes of matches of coarse pixels, as a finer image of the same ground shows it.

Detail finer than a pixel comes back at other frequencies, and moves there otherwise than the edges do, as
moire does. What it does to a match depends on where the ground's detail meets the pixels of both images: on
the motion itself, of which it feigns up to a tenth.

Not here: how images are laid on one another (``laid_strips.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.robust import robust_sigmas
from sightline.matching.matches import Matches

Array = NDArray[np.float64]

#: px of the hub by which a finer partner is moved to see how matches respond, and how far the response of a
#: window may lie from the usual one.
RESPONSE_STEP, RESPONSE_SPREAD = 0.05, 0.5
#: Sigmas beyond which shifts do not tell how far aliasing explains them.
FOLD_CLIP = 4.0


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
