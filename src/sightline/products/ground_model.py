"""Heights of the ground from scattered points with errors: the smoothest surface that agrees with them.

Over a grid of nodes the sum of squared residuals of the points (bilinear between nodes, weighted, robust) and
of the surface's curvatures is least; how much curvature counts is chosen so that points left out are met
best. Solved block by block with a margin, so that cost and memory grow with the area alone.

Not here: where the points come from (``photogrammetry/``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigma, robust_sigmas
from sightline.geometry.checks import ReadOnlyArrays, frozen

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Nodes per side of a block that is kept, and solved beside it.
_BLOCK, _MARGIN = 96, 24
#: Weights of curvature that are tried, times the typical one.
_TRIED = 10.0 ** np.arange(-3.0, 4.1, 1.0)
#: Residuals (robust sigmas) from which on a point counts less, and from which it is no point of the ground.
_HUBER, _WRONG = 1.5, 4.5
_ROUNDS = 4
#: Fewest points that make a surface.
_FEWEST = 12
#: One point in so many is left out, and most points looked at, to choose the smoothness.
_LEFT_OUT, _MOST_TRIED = 4, 2000
#: Neighbours that show whether a point stands out.
_NEIGHBOURS = 10


@dataclass(frozen=True, eq=False)
class GroundModel(ReadOnlyArrays):
    """Heights over a map, bilinear between nodes.

    Attributes
    ----------
    west, south : float
        m; node (0, 0).
    posting : float
        m between nodes.
    heights : (rows, columns)
        m; rows go north.
    sigma : float
        m; what the surface misses points by that it does not know, robust rms: errors of surface and points
        together.
    used : (n,) bool
        Points that agree with it.
    """

    west: float
    south: float
    posting: float
    heights: Array
    sigma: float
    used: Flags

    def at(self, x: Array, y: Array) -> Array:
        """Heights (...) m at map places; those of the border beyond it."""
        shape = np.shape(x)
        row, column, share = _cells(
            np.ravel(x), np.ravel(y), self.west, self.south, self.posting, self.heights.shape
        )
        flat = self.heights.ravel()
        nodes = _corners(row, column, self.heights.shape[1])
        return np.asarray((flat[nodes] * share).sum(axis=1).reshape(shape))


def _cells(
    x: Array, y: Array, west: float, south: float, posting: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """South-western node (row, column) of the cell of each place, and the shares (N, 4) of its corners."""
    p = np.clip((x - west) / posting, 0.0, shape[1] - 1.0)
    q = np.clip((y - south) / posting, 0.0, shape[0] - 1.0)
    column = np.minimum(p.astype(np.intp), shape[1] - 2)
    row = np.minimum(q.astype(np.intp), shape[0] - 2)
    p, q = p - column, q - row
    return row, column, np.stack([(1 - q) * (1 - p), (1 - q) * p, q * (1 - p), q * p], axis=1)


def _corners(row: NDArray[np.intp], column: NDArray[np.intp], columns: int) -> NDArray[np.intp]:
    """Flat indices (N, 4) of the corners of cells."""
    first = row * columns + column
    return np.stack([first, first + 1, first + columns, first + columns + 1], axis=1)


def fit_ground(
    points: Array,
    sigma: Array | None = None,
    extent: tuple[float, float, float, float] | None = None,
    posting: float | None = None,
) -> GroundModel:
    """The smoothest surface that agrees with points.

    Parameters
    ----------
    points : (n, 3)
        m, easting, northing, height; NaN rows are left out.
    sigma : (n,), optional
        m, of the heights, up to a common factor.
    extent : (west, south, east, north), optional
        m; beyond the points the surface goes on evenly. Default theirs.
    posting : float, optional
        m between nodes; default the typical distance of neighbouring points.

    Raises
    ------
    EstimationError
        If there are too few points.
    """
    known = np.isfinite(points).all(axis=1)
    if sigma is not None:
        known &= np.isfinite(sigma) & (sigma > 0.0)
    if known.sum() < _FEWEST:
        raise EstimationError(
            f"{int(known.sum())} points do not make a surface; {_FEWEST} are needed: use the given one"
        )
    places = points[known]
    weight = np.ones(len(places)) if sigma is None else sigma[known] ** -2.0
    weight = np.minimum(weight / np.median(weight), 10.0)
    usual = ~_standing_out(places)
    step = posting or _spacing(places[:, :2])
    west, south, east, north = extent or _box(places)
    shape = (int(np.ceil((north - south) / step)) + 2, int(np.ceil((east - west) / step)) + 2)
    frame = (west, south, step, (max(shape[0], 3), max(shape[1], 3)))
    stiffness, missed = _stiffness(places[usual], weight[usual], step)
    heights, inlier = _solve_blocks(places, weight * usual, frame, stiffness)
    used = np.zeros(len(points), dtype=np.bool_)
    used[np.flatnonzero(known)] = inlier & usual
    return GroundModel(west, south, step, frozen(heights), missed, used)


def _box(places: Array) -> tuple[float, float, float, float]:
    low, high = places.min(axis=0), places.max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _spacing(flat: Array) -> float:
    """m; side of the square that each point has to itself, in the median over places."""
    near = min(_NEIGHBOURS, len(flat) - 1)
    distance = np.asarray(cKDTree(flat).query(flat, near + 1)[0])
    return float(max(np.median(distance[:, -1]) * np.sqrt(np.pi / near), 1e-6))


def _standing_out(places: Array) -> Flags:
    """Points (n,) that leave the plane through their neighbours far more than points do."""
    near = min(_NEIGHBOURS, len(places) - 1)
    around = np.asarray(cKDTree(places[:, :2]).query(places[:, :2], near + 1)[1])
    off = places[around[:, 1:]] - places[:, None, :]
    middle = np.median(off[:, :, 2], axis=1)
    spread = robust_sigmas(off[:, :, 2] - middle[:, None], axis=1)
    scale = np.maximum(spread, robust_sigma(middle))
    return np.asarray(np.abs(middle) > 2.0 * _WRONG * np.maximum(scale, 1e-9))


def _curvature(rows: int, columns: int) -> sparse.csr_array:
    """Second differences along both axes and across them (twice the weight), of a grid of nodes."""

    def second(n: int) -> sparse.csr_array:
        return sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n)).tocsr()

    def first(n: int) -> sparse.csr_array:
        return sparse.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(n - 1, n)).tocsr()

    parts = [
        sparse.kron(second(rows), sparse.eye_array(columns)),
        sparse.kron(sparse.eye_array(rows), second(columns)),
        np.sqrt(2.0) * sparse.kron(first(rows), first(columns)),
    ]
    return sparse.vstack(parts).tocsr()


def _solve(
    places: Array,
    weight: Array,
    frame: tuple[float, float, float, tuple[int, int]],
    stiffness: float,
    rounds: int = _ROUNDS,
) -> tuple[Array, Array]:
    """Heights (rows, columns) of the nodes and residuals (n,) m, with points that disagree counting less."""
    west, south, step, shape = frame
    row, column, share = _cells(places[:, 0], places[:, 1], west, south, step, shape)
    nodes = _corners(row, column, shape[1])
    lines = np.repeat(np.arange(len(places)), 4)
    size = (len(places), shape[0] * shape[1])
    design = sparse.csr_array((share.ravel(), (lines, nodes.ravel())), shape=size)
    bend = _curvature(*shape)
    # next to nothing holds nodes that neither points nor curvature do: a tilt where all points are in a line
    prior = stiffness * (bend.T @ bend) + 1e-9 * sparse.eye_array(size[1])
    level = float(np.average(places[:, 2], weights=np.maximum(weight, 1e-12)))
    target, robust = places[:, 2] - level, weight
    for _ in range(rounds):
        normal = (design.T @ sparse.diags_array(robust) @ design + prior).tocsc()
        right = np.asarray(design.T @ (robust * target))
        heights = splu(normal, permc_spec="MMD_AT_PLUS_A").solve(right)
        residual = target - design @ heights
        size_of = np.sqrt(np.maximum(weight, 1e-12)) * np.abs(residual)
        scale = max(robust_sigma(size_of[weight > 0.0]), 1e-12)
        ratio = size_of / scale
        robust = weight * np.where(ratio > _WRONG, 0.0, np.minimum(1.0, _HUBER / np.maximum(ratio, 1e-9)))
    return heights.reshape(shape) + level, np.where(ratio > _WRONG, np.nan, residual)


def _solve_blocks(
    places: Array, weight: Array, frame: tuple[float, float, float, tuple[int, int]], stiffness: float
) -> tuple[Array, Flags]:
    """All nodes, block by block, and which points agree."""
    west, south, step, shape = frame
    heights = np.full(shape, np.nan)
    inlier = np.ones(len(places), dtype=np.bool_)
    at = np.stack([(places[:, 1] - south) / step, (places[:, 0] - west) / step], axis=1)
    for row in range(0, shape[0], _BLOCK):
        for column in range(0, shape[1], _BLOCK):
            first = np.maximum([row - _MARGIN, column - _MARGIN], 0)
            last = np.minimum([row + _BLOCK + _MARGIN, column + _BLOCK + _MARGIN], shape)
            first = np.maximum(np.minimum(first, last - 3), 0)
            near = ((at >= first) & (at <= last - 1)).all(axis=1) & (weight > 0.0)
            if near.sum() < _FEWEST:
                continue
            part = (
                west + step * first[1],
                south + step * first[0],
                step,
                tuple(int(n) for n in last - first),
            )
            solved, residual = _solve(places[near], weight[near], part, stiffness)  # type: ignore[arg-type]
            end = np.minimum([row + _BLOCK, column + _BLOCK], shape)
            heights[row : end[0], column : end[1]] = solved[
                row - first[0] : end[0] - first[0], column - first[1] : end[1] - first[1]
            ]
            core = near & (at >= [row, column]).all(axis=1) & (at < end).all(axis=1)
            inlier[core] = np.isfinite(residual[core[near]])
    return _filled(heights), inlier


def _filled(heights: Array) -> Array:
    """Nodes of blocks without points take the height of the nearest node that has one."""
    from scipy.ndimage import distance_transform_edt

    gap = np.isnan(heights)
    if not gap.any():
        return heights
    nearest = distance_transform_edt(gap, return_distances=False, return_indices=True)
    return np.asarray(heights[tuple(nearest)])


def _stiffness(places: Array, weight: Array, step: float) -> tuple[float, float]:
    """Weight of curvature that meets points left out best, and how well it does: robust rms, m."""
    some = places
    heavy = weight
    if len(places) > _MOST_TRIED:
        # the points about one place: thinning them would ask for another smoothness
        middle = places[len(places) // 2, :2]
        rows = cKDTree(places[:, :2]).query(middle, _MOST_TRIED)[1]
        some, heavy = places[rows], weight[rows]
    west, south, east, north = _box(some)
    shape = (max(int(np.ceil((north - south) / step)) + 2, 3), max(int(np.ceil((east - west) / step)) + 2, 3))
    frame = (west, south, step, shape)
    out = np.random.default_rng(0).permutation(len(some)) % _LEFT_OUT == 0
    missed = [_missed(some, heavy, frame, out, float(stiffness)) for stiffness in _TRIED]
    best = int(np.argmin(missed))
    return float(_TRIED[best]), missed[best]


def _missed(
    places: Array,
    weight: Array,
    frame: tuple[float, float, float, tuple[int, int]],
    out: Flags,
    stiffness: float,
) -> float:
    """m; robust rms of what points `out` are missed by that a surface through the others does not know."""
    west, south, step, shape = frame
    heights, _ = _solve(places[~out], weight[~out], frame, stiffness, rounds=2)
    row, column, share = _cells(places[out, 0], places[out, 1], west, south, step, shape)
    found = (heights.ravel()[_corners(row, column, shape[1])] * share).sum(axis=1)
    return robust_sigma(places[out, 2] - found)
