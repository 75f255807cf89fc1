"""Robust rejection: matches that disagree with their neighbours along the strip.

Not the quality thresholds of a single match: those are in `match_images`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.matching import matches as codes
from sightline.matching.matches import Matches

__all__ = ["local_deviation", "reject_outliers", "robust_sigma"]


def robust_sigma(values: NDArray[np.float64], axis: int = 0) -> NDArray[np.float64]:
    """Standard deviation of the good majority: 1.4826 times the median distance from the median.

    Parameters
    ----------
    values : (..., N, ...)
        NaN is left out.
    axis : int
        Axis to reduce.

    Examples
    --------
    >>> import numpy as np
    >>> robust_sigma(np.array([0.0, 1.0, 2.0, 3.0, 1000.0])).round(4)
    np.float64(1.4826)
    """
    middle = np.nanmedian(values, axis=axis, keepdims=True)
    return np.asarray(1.4826 * np.nanmedian(np.abs(values - middle), axis=axis))[()]


def local_deviation(
    t: NDArray[np.float64], values: NDArray[np.float64], neighbours: int = 40
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Departure of each value from the median of its neighbours, and their robust sigma.

    Parameters
    ----------
    t : (N,)
        Position along the strip (line or time), in any order.
    values : (N,)
        Residuals; NaN rows take no part.
    neighbours : int
        How many points along `t` are compared, about half on each side.

    Returns
    -------
    departure : (N,)
        Value less the running median; NaN where the value is.
    sigma : (N,)
        Robust sigma of the departures around the point.

    Notes
    -----
    The runs are those of the points in the order of `t`; a run of many columns of one line compares that line
    with itself, which is what makes jitter, common to the line, no outlier.
    """
    departure, sigma = np.full(len(t), np.nan), np.full(len(t), np.nan)
    good = np.flatnonzero(np.isfinite(values) & np.isfinite(t))
    if not len(good):
        return departure, sigma
    order = good[np.argsort(t[good], kind="stable")]
    size = min(neighbours | 1, len(order) - (1 - len(order) % 2))
    runs = np.lib.stride_tricks.sliding_window_view(values[order], size)
    half = size // 2
    place = np.clip(np.arange(len(order)) - half, 0, len(runs) - 1)
    middle = np.median(runs, axis=1)[place]
    departure[order] = values[order] - middle
    spread = np.lib.stride_tricks.sliding_window_view(np.abs(departure[order]), size)
    sigma[order] = 1.4826 * np.median(spread, axis=1)[place]
    return departure, sigma


def reject_outliers(
    matches: Matches,
    residuals_px: NDArray[np.float64],
    *,
    along: NDArray[np.float64] | None = None,
    neighbours: int = 40,
    limit: float = 5.0,
) -> Matches:
    """The same matches, those marked as outliers that stand out from their neighbours.

    Parameters
    ----------
    matches : Matches
    residuals_px : (N, 2)
        Measured less predicted, px; need not be zero-mean.
    along : (N,), optional
        Position along the strip; the line in image a by default.
    neighbours : int
        How many points are compared at a time.
    limit : float
        Departure, in sigmas, from which on a match is an outlier. The sigma is the larger of the match's own
        and the neighbours' robust one, so that true spread (relief) is not cut.

    Returns
    -------
    Matches
    """
    residuals_px = np.asarray(residuals_px, dtype=np.float64)
    if residuals_px.shape != (len(matches), 2):
        raise InputError(
            f"`residuals_px` must have shape ({len(matches)}, 2), one row per match; "
            f"got {residuals_px.shape}; give measured less predicted"
        )
    t = matches.a[:, 0] if along is None else np.asarray(along, dtype=np.float64)
    own = matches.sigma_px
    outlier = np.zeros(len(matches), np.bool_)
    for axis in range(2):
        values = np.where(matches.kept, residuals_px[:, axis], np.nan)
        departure, sigma = local_deviation(t, values, neighbours)
        with np.errstate(invalid="ignore"):
            outlier |= np.abs(departure) > limit * np.fmax(sigma, own[:, axis])
    return matches.with_status(outlier, codes.OUTLIER)
