"""How heights of the ground that a model leaves out add up to an error of what it estimates.

Not here: the surfaces themselves (``geometry/surface.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.geometry.checks import Array

#: Most points whose covariance is built whole; of more, cells of a grid.
_WHOLE = 1000
#: Cells along each side of that grid.
_CELLS = 30
#: Points from which the correlation of heights is measured, at most.
_SAMPLE = 600
#: Patterns that a fitted plane takes out of heights, and the least share of their variance taken to be left.
_TAKEN, _LEAST_LEFT = 3, 0.25
#: Classes of distance, up to half the extent of the scene.
_LAGS = 15


def relief_spread(place: Array, height: Array, influence: Array) -> Array:
    """Covariance of a sum of influences times heights.

    Parameters
    ----------
    place : (n, 2)
        m, on the ground.
    height : (n,)
        m, above what the model has.
    influence : (n, P)
        What 1 m of height at each point adds.

    Returns
    -------
    (P, P)
        With heights of the rms given, correlated as exp(-d^2 / (2 l^2)) at a distance d.
    """
    length = correlation_length(place, height)
    # the mean and the slopes that the model took out of the heights had as much of them as that many patches
    # of 2 pi l^2, over which heights go together, of the whole scene
    patch = 2.0 * np.pi * length**2 / max(float(np.prod(np.ptp(place, axis=0))), np.finfo(np.float64).tiny)
    variance = float(np.mean(height**2)) / max(1.0 - _TAKEN * patch, _LEAST_LEFT)
    if len(place) > _WHOLE:
        middles, sums, size = _in_cells(place, influence)
        if length < 0.5 * size:
            length = 0.0
        else:
            place, influence = middles, sums
    if length == 0.0:
        return np.asarray(variance * (influence.T @ influence))
    apart = ((place[:, None] - place) ** 2).sum(axis=-1)
    return np.asarray(variance * (influence.T @ np.exp(-apart / (2.0 * length**2)) @ influence))


def points_alike(place: Array, area: float) -> float:
    """How many points have one error of height between them, as to their mean.

    Parameters
    ----------
    place : (n, 2)
        m, on the ground.
    area : float
        m^2 over which heights go together: the integral of their correlation, exp(-d^2 / (2 l^2)).
    """
    count = len(place)
    place = place[:: -(-count // _SAMPLE)]
    if len(place) < 2:
        return 1.0
    apart = ((place[:, None] - place) ** 2).sum(axis=-1)
    others = np.exp(-apart * (np.pi / area)).sum() - len(place)
    return float(1.0 + (count - 1) * others / (len(place) * (len(place) - 1)))


def correlation_length(place: Array, height: Array) -> float:
    """Length l (m) over which heights (n,) at places (n, 2) go together as exp(-d^2 / (2 l^2)); may be 0."""
    step = -(-len(place) // _SAMPLE)
    place, height = place[::step], height[::step]
    extent = float(np.ptp(place, axis=0).max())
    variance = float(np.mean(height**2))
    if not (extent > 0.0 and variance > 0.0):
        return 0.0
    first, second = np.triu_indices(len(place), 1)
    apart = np.sqrt(((place[first] - place[second]) ** 2).sum(axis=1))
    near = apart < 0.5 * extent
    which = (apart[near] * (2 * _LAGS / extent)).astype(np.intp)
    count = np.bincount(which, minlength=_LAGS)
    product = np.bincount(which, (height[first] * height[second])[near], _LAGS) / (
        variance * np.maximum(count, 1)
    )
    distance = np.bincount(which, apart[near], _LAGS) / np.maximum(count, 1)
    lengths = np.concatenate([[0.0], np.geomspace(extent / (4 * _LAGS), extent, 40)])
    shapes = np.exp(-0.5 * (distance / np.maximum(lengths[:, None], 1e-9 * extent)) ** 2)
    return float(lengths[np.argmin((count * (product - shapes) ** 2).sum(axis=1))])


def _in_cells(place: Array, influence: Array) -> tuple[Array, Array, float]:
    """Middles (m, 2) of the cells of a grid that hold points, sums (m, P) of influences there, cell size."""
    low = place.min(axis=0)
    size = float(np.ptp(place, axis=0).max()) / _CELLS
    key = np.minimum((place - low) // size, _CELLS - 1).astype(np.intp)
    cells, which = np.unique(key[:, 0] * _CELLS + key[:, 1], return_inverse=True)
    sums = np.stack([np.bincount(which, column) for column in influence.T], axis=1)
    middles: Array = low + size * (np.stack([cells // _CELLS, cells % _CELLS], axis=1) + 0.5)
    return middles, sums.astype(np.float64), size
