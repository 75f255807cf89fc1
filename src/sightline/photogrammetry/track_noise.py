"""How sightings of followed windows err: each by itself, and all of a track by a slow drift.

A window changes while it is followed, with its wavelength and with the angle it is seen under; what that
moves it by is much the same in the next frame. Sightings that err alike count for fewer than they are.

Not here: following (``matching/follow.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from sightline.geometry.checks import Array
from sightline.photogrammetry.sightings import Tracks

#: Fewest pairs of sightings that tell of a lag.
_PAIRS = 100
#: Share of a usual track up to which lags are looked at: longer drifts the point's place takes up.
_SHORT = 0.3


def drift_of_tracks(tracks: Tracks, residual_px: Array, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Variance of each sighting by itself (px^2), and its growth from frame to frame (px^2 per frame).

    Parameters
    ----------
    tracks : Tracks
    residual_px : (N, 2)
    used : (N,) bool
        Good sightings.

    Notes
    -----
    Mean squares of differences of residuals of a track, n frames apart, are twice the one and n times the
    other. What the adjustment takes up of a drift over the whole track leaves short lags nearly alone.
    """
    order = np.lexsort((tracks.image, tracks.point))
    order = order[used[order]]
    image, point, r = tracks.image[order], tracks.point[order], residual_px[order]
    longest = max(int(_SHORT * np.median(_spans(tracks)[order])), 2) if len(order) else 0
    lags, squares, weights = [], [], []
    for lag in range(1, longest + 1):
        same = (point[lag:] == point[:-lag]) & (image[lag:] - image[:-lag] == lag)
        if same.sum() >= _PAIRS:
            lags.append(float(lag))
            squares.append(0.5 * float(((r[lag:] - r[:-lag])[same] ** 2).sum(axis=1).mean()))
            weights.append(np.sqrt(float(same.sum())))
    if len(lags) < 2:
        return 0.0, 0.0
    rows = np.column_stack([np.full(len(lags), 2.0), lags])
    scale = (np.array(weights) / np.maximum(squares, 1e-12))[:, None]
    own, growth = nnls(rows * scale, np.array(squares) * scale[:, 0])[0]
    return float(own), float(growth)


def _spans(tracks: Tracks) -> NDArray[np.intp]:
    """Frames (N,) from the first to the last sighting of each sighting's point, both counted."""
    count = int(tracks.point.max()) + 1
    first, last = np.full(count, np.iinfo(np.intp).max), np.zeros(count, dtype=np.intp)
    np.minimum.at(first, tracks.point, tracks.image)
    np.maximum.at(last, tracks.point, tracks.image)
    return np.asarray((last - first + 1)[tracks.point])


def with_drift(tracks: Tracks, residual_px: Array, used: NDArray[np.bool_]) -> Tracks:
    """The same tracks with sigmas that count their drift as if sightings erred independently.

    Parameters
    ----------
    tracks : Tracks
        Followed windows.
    residual_px : (N, 2)
        Of a solution near by.
    used : (N,) bool

    Notes
    -----
    The slope of n sightings of variance s^2 has the variance 12 s^2 / n^3; that of a random walk of g per
    frame 6 g / (5 n). Both are alike for s^2 = g n^2 / 10.
    """
    own, growth = drift_of_tracks(tracks, residual_px, used)
    if own + growth == 0.0:
        return tracks
    # what a match says of itself holds where there is no drift; some windows are better than others
    relative = tracks.sigma_px**2 / np.median(tracks.sigma_px**2)
    variance = relative * (own + growth * _spans(tracks) ** 2 / 10.0)
    return Tracks(tracks.image, tracks.point, tracks.pixels, np.sqrt(variance))
