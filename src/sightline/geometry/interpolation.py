"""Local polynomial interpolation of tables: four nodes around the place asked for.

A cubic through the four nearest nodes needs no fit, so a long table costs nothing where it is not read, and a
bad node spoils three intervals at most. Tables of fewer nodes use the polynomial that passes through them.

The kernels are given read-only arrays alone: for arrays of another kind each would be compiled once more.

Not here: which quantity is interpolated and where it ends (``trajectory.py``, ``camera.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.geometry.checks import Array, read_only

#: Nodes of the local polynomial.
POINTS = 4


@njit(cache=True, nogil=True, error_model="numpy")
def unit_weights(x: float) -> tuple[float, float, float, float]:
    """Lagrange weights at `x` of four nodes at 0, 1, 2, 3."""
    a, b, c = x - 1.0, x - 2.0, x - 3.0
    return -a * b * c / 6.0, 0.5 * x * b * c, -0.5 * x * a * c, x * a * b / 6.0


def stencils(nodes: Array, t: Array, most: int = POINTS) -> tuple[np.ndarray, np.ndarray, Array]:
    """Where each `t` falls among `nodes`: its interval, the first node of its stencil, the weights there.

    Parameters
    ----------
    nodes : (A,)
        Strictly increasing.
    t : (N,)
        Where to interpolate; beyond the ends the end stencil is used.
    most : int
        Nodes of a stencil.

    Returns
    -------
    interval : (N,) int
        Node at or before t (0 to A - 2; 0 when A = 1).
    first : (N,) int
        First node of the stencil.
    weights : (N, min(most, A))
        Lagrange weights of the nodes first, first + 1, ...
    """
    return _stencils(read_only(nodes), read_only(t), most)


def interpolate(nodes: Array, values: Array, t: Array, most: int = POINTS) -> Array:
    """Values (A, K) known at `nodes` (A,), at the places `t` (N,): (N, K), by the local cubic.

    Other numbers of nodes than four (`most`) are of tables that were made for them.
    """
    return np.asarray(_interpolate(read_only(nodes), read_only(values), read_only(t), most))


def interpolate_hermite(nodes: Array, values: Array, slopes: Array, t: Array) -> Array:
    """Like `interpolate`, through values and `slopes` (A, K) of the same nodes: degree 7 instead of 3."""
    tables = read_only(nodes), read_only(values), read_only(slopes)
    return np.asarray(_interpolate_hermite(*tables, read_only(t), POINTS))


@njit(cache=True, nogil=True, error_model="numpy")
def _stencils(nodes: Array, t: Array, most: int) -> tuple[np.ndarray, np.ndarray, Array]:
    count = len(nodes)
    points = min(most, count)
    interval = np.empty(len(t), np.int64)
    first = np.empty(len(t), np.int64)
    weights = np.empty((len(t), points))
    for row in range(len(t)):
        i, past = 0, count  # by halves: what numpy has for it takes longer to compile than the rest
        while i < past:
            middle = (i + past) // 2
            if t[row] < nodes[middle]:
                past = middle
            else:
                i = middle + 1
        i -= 1
        i = min(max(i, 0), max(count - 2, 0))
        start = min(max(i - (points - 1) // 2, 0), count - points)
        interval[row] = i
        first[row] = start
        for a in range(points):
            weight = 1.0
            for b in range(points):
                if b != a:
                    weight *= (t[row] - nodes[start + b]) / (nodes[start + a] - nodes[start + b])
            weights[row, a] = weight
    return interval, first, weights


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(nodes: Array, values: Array, t: Array, most: int) -> Array:
    _, first, weights = _stencils(nodes, t, most)
    out = np.zeros((len(t), values.shape[1]))
    for row in range(len(t)):
        for a in range(weights.shape[1]):
            for k in range(values.shape[1]):
                out[row, k] += weights[row, a] * values[first[row] + a, k]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate_hermite(nodes: Array, values: Array, slopes: Array, t: Array, most: int) -> Array:
    _, first, weights = _stencils(nodes, t, most)
    points = weights.shape[1]
    out = np.zeros((len(t), values.shape[1]))
    for row in range(len(t)):
        start = first[row]
        for a in range(points):
            slope = 0.0  # derivative of the Lagrange weight at its own node
            for b in range(points):
                if b != a:
                    slope += 1.0 / (nodes[start + a] - nodes[start + b])
            step = t[row] - nodes[start + a]
            square = weights[row, a] ** 2
            for k in range(values.shape[1]):
                out[row, k] += square * (
                    (1.0 - 2.0 * step * slope) * values[start + a, k] + step * slopes[start + a, k]
                )
    return out
