"""How sightings of windows err: each by itself, and all of a track together, ever more with time.

A window changes while it is followed, with its wavelength and with the angle it is seen under; what that
moves it by is much the same in the next frame, and in the one after it more of the same. Sightings that err
alike count for fewer than they are; so do windows that lie so near each other that they share pixels.

Not here: following (``matching/follow.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls
from scipy.spatial import cKDTree

from sightline.geometry.checks import Array
from sightline.photogrammetry.sightings import Tracks

#: Fewest pairs of sightings that measure a lag.
_PAIRS = 100
#: Share of a usual track up to which lags are looked at: few tracks are longer.
_LONGEST = 0.9
#: Windows around one that may err like it; sightings from which on they are asked.
_NEIGHBOURS, _LEAST_BESIDE = 8, 30
#: Squares of residuals from which on they say how good sightings are; numbers of a pose that follow them.
_LEAST_FREEDOM, _POSE = 100.0, 6
#: Variances that are looked at, over those stated.
_FINEST, _COARSEST = 1e-4, 1e4


@dataclass(frozen=True)
class TrackNoise:
    """Variances of the sightings of a track, of one coordinate.

    Attributes
    ----------
    own : float
        px^2, of each sighting by itself.
    walk : float
        px^2 per frame: growth of the variance of a drift whose steps are independent.
    ramp : float
        px^2 per squared frame: variance of the rate of an even drift.
    """

    own: float
    walk: float
    ramp: float

    def equivalent(self, frames: Array) -> Array:
        """Variance (px^2) of sightings that err independently and know as much of the motion.

        Parameters
        ----------
        frames : (N,)
            From the first to the last sighting of a track, both counted.

        Notes
        -----
        The slope of n sightings of variance s^2 has the variance 12 s^2 / n^3; that of a random walk of g
        per frame 6 g / (5 n), that of a ramp its own: alike for s^2 = g n^2 / 10 and s^2 = ramp n^3 / 12.
        """
        return np.asarray(self.own + self.walk * frames**2 / 10.0 + self.ramp * frames**3 / 12.0)


def noise_of_tracks(tracks: Tracks, residual_px: Array, used: NDArray[np.bool_]) -> TrackNoise | None:
    """Noise of tracks from the residuals of a solution near by; None where too few show it.

    Parameters
    ----------
    tracks : Tracks
    residual_px : (N, 2)
    used : (N,) bool
        Good sightings.

    Notes
    -----
    The mean square of differences of residuals of a track, n frames apart, is 2 own + n walk + n^2 ramp.
    Only residuals across the motion of each track are looked at: along it the height of the point takes up
    what drifts evenly.
    """
    order = np.lexsort((tracks.image, tracks.point))
    order = order[used[order]]
    image, point = tracks.image[order], tracks.point[order]
    if not len(order):
        return None
    r = _across(tracks.pixels[order], residual_px[order], point)
    longest = max(int(_LONGEST * np.median(_spans(image, point))), 2)
    lags, squares, weights = [], [], []
    for lag in range(1, longest + 1):
        same = (point[lag:] == point[:-lag]) & (image[lag:] - image[:-lag] == lag)
        if same.sum() >= _PAIRS:
            lags.append(float(lag))
            squares.append(float(((r[lag:] - r[:-lag])[same] ** 2).mean()))
            weights.append(np.sqrt(float(same.sum())))
    if len(lags) < 3:
        return None
    n = np.array(lags)
    scale = np.array(weights) / np.maximum(squares, 1e-12)
    rows = np.column_stack([np.full(len(n), 2.0), n, n**2])
    return TrackNoise(*(float(v) for v in nnls(rows * scale[:, None], np.array(squares) * scale)[0]))


def alike_neighbours(tracks: Tracks, residual_px: Array, used: NDArray[np.bool_]) -> float:
    """How many times fewer independent windows there are than windows, because neighbours drift alike.

    Parameters
    ----------
    tracks : Tracks
    residual_px : (N, 2)
        Of a solution near by.
    used : (N,) bool
        Good sightings.

    Returns
    -------
    float
        1 and the sum of the correlations with the nearest windows of the same frame; 1 at least.

    Notes
    -----
    Drifts over half a track are compared.
    """
    order = np.lexsort((tracks.image, tracks.point))
    order = order[used[order]]
    image, point = tracks.image[order], tracks.point[order]
    if not len(order):
        return 1.0
    r = _across(tracks.pixels[order], residual_px[order], point)
    lag = max(int(0.5 * np.median(_spans(image, point))), 1)
    # a sighting and that of the same point so many frames before it
    same = np.flatnonzero((point[lag:] == point[:-lag]) & (image[lag:] - image[:-lag] == lag)) + lag
    moved, frame, place = r[same] - r[same - lag], image[same], tracks.pixels[order][same]
    products = np.zeros(_NEIGHBOURS)
    squares, count = 0.0, 0
    for number in np.unique(frame)[:: max(lag // 2, 1)]:
        rows = np.flatnonzero(frame == number)
        if len(rows) < 2 * _NEIGHBOURS:
            continue
        d = moved[rows]
        near = np.asarray(cKDTree(place[rows]).query(place[rows], _NEIGHBOURS + 1)[1])[:, 1:]
        products += (d[:, None] * d[near]).sum(axis=0)
        squares += float((d**2).sum())
        count += len(rows)
    if count < _PAIRS or squares == 0.0:
        return 1.0
    return max(1.0 + float(products.sum()) / squares, 1.0)


def _across(pixels: Array, residual: Array, point: NDArray[np.intp]) -> Array:
    """Residuals (N,) across the line from the first to the last sighting of each track; rows by point."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(point) > 0]))
    count = np.diff(np.append(first, len(point)))
    along = pixels[first + count - 1] - pixels[first]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    along = np.repeat(along, count, axis=0)
    return np.asarray(residual[:, 1] * along[:, 0] - residual[:, 0] * along[:, 1])


def _spans(image: NDArray[np.intp], point: NDArray[np.intp]) -> NDArray[np.intp]:
    """Frames (N,) from the first to the last sighting of each sighting's point, both counted."""
    count = int(point.max()) + 1
    first, last = np.full(count, np.iinfo(np.intp).max), np.zeros(count, dtype=np.intp)
    np.minimum.at(first, point, image)
    np.maximum.at(last, point, image)
    return np.asarray((last - first + 1)[point])


def with_drift(tracks: Tracks, residual_px: Array, used: NDArray[np.bool_]) -> Tracks:
    """The same tracks with sigmas that count their drift as if sightings erred independently.

    Parameters
    ----------
    tracks : Tracks
        Followed windows.
    residual_px : (N, 2)
        Of a solution near by.
    used : (N,) bool
    """
    noise = noise_of_tracks(tracks, residual_px, used)
    if noise is None or noise.own + noise.walk + noise.ramp == 0.0:
        return tracks
    # what a match says of itself holds where there is no drift; some windows are better than others
    relative = tracks.sigma_px**2 / np.median(tracks.sigma_px**2)
    relative *= alike_neighbours(tracks, residual_px, used)
    variance = relative * noise.equivalent(_spans(tracks.image, tracks.point).astype(np.float64))
    return Tracks(tracks.image, tracks.point, tracks.pixels, np.sqrt(variance))


def with_scatter(tracks: Tracks, residual_px: Array, freedom: Array, used: NDArray[np.bool_]) -> Tracks:
    """Tracks of windows found from afar with sigmas that their residuals bear out.

    Parameters
    ----------
    tracks : Tracks
        Sigmas are those of the matches and one that all have alike, for two views of one place that differ.
    residual_px : (N, 2)
        Of a solution near by.
    freedom : (N,)
        Squared residual over variance that is expected of each sighting, its point following it.
    used : (N,) bool
        Good sightings.

    Returns
    -------
    Tracks
        The same where too few sightings are good.

    Notes
    -----
    A match says how noise moves it; two views of one place differ besides. The variance of a sighting is
    taken as f + g v, v what its match says of itself beyond the best. Of squared residuals q of freedom n,
    less the share that the poses took by following them, f and g are those of the largest likelihood: of the
    sum over n log(f + g v) + q / (f + g v) the least. Windows that err like their neighbours count for fewer
    than they are.

    Sightings that were left out are not made up for. They lie beyond a chi-square of 2 log(20 N), by which N
    good ones lose log(20 N) / (20 N) of their variance: 4e-3 of 100 of them, 5e-4 of 1,000.
    """
    square = (residual_px[used] ** 2).sum(axis=1)
    free = np.maximum(freedom[used], 0.0)
    total, poses = float(free.sum()), _POSE * len(np.unique(tracks.image[used]))
    if total < max(_LEAST_FREEDOM, 2.0 * poses):
        return tracks
    free *= 1.0 - poses / total
    stated = tracks.sigma_px**2
    alike = float(stated[used].min())
    parts = np.stack([np.full(len(stated), alike), stated - alike])

    def unlikely(logs: Array) -> float:
        variance = np.exp(logs) @ parts[:, used]
        return float((free * np.log(variance) + square / variance).sum())

    # where all say the same of themselves g is not seen, and stays
    bounds = [(np.log(_FINEST), np.log(_COARSEST))] * 2
    start = np.full(2, np.log(max(float(square.sum() / (free * stated[used]).sum()), _FINEST)))
    found = minimize(unlikely, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 0.01})
    variance = np.exp(found.x) @ parts
    unit = residual_px[used] / np.sqrt(variance[used])[:, None]
    variance *= 1.0 + alike_beside(tracks.image[used], tracks.pixels[used], unit)
    return Tracks(tracks.image, tracks.point, tracks.pixels, np.sqrt(variance))


def alike_beside(image: NDArray[np.intp], pixels: Array, unit: Array) -> float:
    """Sum of the correlations of residuals (N, 2) with those of the nearest windows of the same image."""
    products, squares, seen = np.zeros(_NEIGHBOURS), 0.0, 0
    for number in np.unique(image):
        rows = np.flatnonzero(image == number)
        if len(rows) < 2 * _NEIGHBOURS:
            continue
        near = np.asarray(cKDTree(pixels[rows]).query(pixels[rows], _NEIGHBOURS + 1)[1])[:, 1:]
        products += (unit[rows][:, None] * unit[rows][near]).sum(axis=(0, 2))
        squares, seen = squares + float((unit[rows] ** 2).sum()), seen + len(rows)
    return max(float(products.sum()) / squares, 0.0) if seen >= _LEAST_BESIDE else 0.0
