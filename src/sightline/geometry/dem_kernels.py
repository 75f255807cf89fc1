"""Compiled loops of the surfaces: ellipsoid hits, and the march of rays over a grid of heights.

A grid of heights is read in (row, column, height) coordinates. Three ways lead there from world axes: local
(an affine map of x, y), geographic (longitude and latitude, then affine), projected (the foot of the point on
the ellipsoid, seen on a plane that touches it, then a table of rows and columns: no pole or date line in it).

Not here: what the grid is and where it comes from (``surface.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.geometry.checks import Array
from sightline.geometry.earth import normal_of
from sightline.geometry.interpolation import unit_weights

#: How world axes become (row, column, height).
LOCAL, GEOGRAPHIC, PROJECTED = 0, 1, 2
#: A ray is walked in pieces at most this long (m); in each its path over the grid is a cubic. The term left
#: out, of fourth order, is below 1e-4 m there, and the last steps use the exact path.
_PIECE = 2.0e4
#: Horizontal step of the walk, in cells.
_STRIDE = 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def plane_hits(origins: Array, directions: Array, height: float, out: Array) -> None:
    """First meeting of rays with the plane z = `height`, into `out` (N, 3)."""
    for n in range(len(origins)):
        s = (height - origins[n, 2]) / directions[n, 2]
        if s > 0.0 and np.isfinite(s):
            out[n, 0] = origins[n, 0] + s * directions[n, 0]
            out[n, 1] = origins[n, 1] + s * directions[n, 1]
            out[n, 2] = height
        else:
            out[n] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _roots(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, a: float, b: float
) -> tuple[float, float]:
    """Both distances at which a ray crosses an ellipsoid, near then far; NaN where it passes by."""
    ratio = a / b
    oz, dz = oz * ratio, dz * ratio
    aa = dx * dx + dy * dy + dz * dz
    half = ox * dx + oy * dy + oz * dz
    cc = ox * ox + oy * oy + oz * oz - a * a
    discriminant = half * half - aa * cc
    if not discriminant >= 0.0:
        return np.nan, np.nan
    root = np.sqrt(discriminant)
    # the form without cancellation for each sign
    q = -half - root if half > 0.0 else -half + root
    s1, s2 = q / aa, (cc / q if q != 0.0 else 0.0)
    return min(s1, s2), max(s1, s2)


@njit(cache=True, nogil=True, error_model="numpy")
def ellipsoid_hits(origins: Array, directions: Array, a: float, b: float, height: float, out: Array) -> None:
    """First meeting of rays with the surface `height` above an ellipsoid, into `out` (N, 3).

    For a height other than zero the ellipsoid with both axes longer is the start (it is off by less than 1e-5
    of the height), then Newton steps along the ray set the geodetic height.
    """
    for n in range(len(origins)):
        ox, oy, oz = origins[n]
        dx, dy, dz = directions[n]
        near, far = _roots(ox, oy, oz, dx, dy, dz, a + height, b + height)
        s = near if near > 0.0 else far
        if not s > 0.0:
            out[n] = np.nan
            continue
        if height != 0.0:
            for _ in range(3):
                x, y, z = ox + s * dx, oy + s * dy, oz + s * dz
                rho = np.sqrt(x * x + y * y)
                c, up, h = normal_of(rho, z, a, b)
                east = (dx * x + dy * y) / rho if rho > 0.0 else 0.0
                s += (height - h) / (c * east + up * dz)
        out[n, 0], out[n, 1], out[n, 2] = ox + s * dx, oy + s * dy, oz + s * dz


@njit(cache=True, nogil=True, error_model="numpy")
def _warped(u: float, v: float, warp: Array) -> tuple[float, float]:
    """Bicubic reading of the table `warp` (rows, columns, 2) at fractional indices u (row), v (column)."""
    i = min(max(int(np.floor(u)) - 1, 0), warp.shape[0] - 4)
    j = min(max(int(np.floor(v)) - 1, 0), warp.shape[1] - 4)
    wu, wv = unit_weights(u - i), unit_weights(v - j)
    row = column = 0.0
    for k in range(4):
        a = wu[0] if k == 0 else (wu[1] if k == 1 else (wu[2] if k == 2 else wu[3]))
        for m in range(4):
            b = a * (wv[0] if m == 0 else (wv[1] if m == 1 else (wv[2] if m == 2 else wv[3])))
            row += b * warp[i + k, j + m, 0]
            column += b * warp[i + k, j + m, 1]
    return row, column


@njit(cache=True, nogil=True, error_model="numpy")
def to_grid(
    x: float, y: float, z: float, kind: int, affine: Array, warp: Array, a: float, b: float
) -> tuple[float, float, float]:
    """(row, column, height) of a point in world axes.

    `affine` (16,): row = [0] + [1] u + [2] v, column = [3] + [4] u + [5] v, where u, v are x, y (local);
    longitude and latitude, rad, the longitude counted from [6] (geographic); or the offsets of the foot of
    the point from [7:10] along the axes [10:13] and [13:16], m (projected: they lead into `warp`).
    """
    if kind == LOCAL:
        u, v, h = x, y, z
    else:
        rho = np.sqrt(x * x + y * y)
        c, s, h = normal_of(rho, z, a, b)
        if kind == GEOGRAPHIC:
            u, v = np.arctan2(y, x) - affine[6], np.arctan2(s, c)
            if u > np.pi:
                u -= 2.0 * np.pi
            elif u < -np.pi:
                u += 2.0 * np.pi
        else:
            scale = h * c / rho if rho > 0.0 else 0.0
            fx, fy, fz = x * (1.0 - scale) - affine[7], y * (1.0 - scale) - affine[8], z - h * s - affine[9]
            u = fx * affine[10] + fy * affine[11] + fz * affine[12]
            v = fx * affine[13] + fy * affine[14] + fz * affine[15]
    row = affine[0] + affine[1] * u + affine[2] * v
    column = affine[3] + affine[4] * u + affine[5] * v
    if kind == PROJECTED:
        if not (-1.0 <= row <= warp.shape[0] and -1.0 <= column <= warp.shape[1]):
            return np.nan, np.nan, h
        row, column = _warped(row, column, warp)
    return row, column, h


@njit(cache=True, nogil=True, error_model="numpy")
def height_at(heights: Array, row: float, column: float) -> float:
    """Bilinear height at fractional (row, column); NaN outside the nodes or where a corner is NaN."""
    rows, columns = heights.shape
    if not (0.0 <= row <= rows - 1.0 and 0.0 <= column <= columns - 1.0):
        return np.nan
    i, j = min(int(row), rows - 2), min(int(column), columns - 2)
    y, x = row - i, column - j
    upper = heights[i, j] * (1.0 - x) + heights[i, j + 1] * x
    lower = heights[i + 1, j] * (1.0 - x) + heights[i + 1, j + 1] * x
    return upper * (1.0 - y) + lower * y


@njit(cache=True, nogil=True, error_model="numpy")
def heights_below(
    points: Array,
    heights: Array,
    offset: float,
    kind: int,
    affine: Array,
    warp: Array,
    a: float,
    b: float,
    out: Array,
) -> None:
    """Surface height above the datum under (or above) each point, into `out` (N,)."""
    for n in range(len(points)):
        row, column, _ = to_grid(points[n, 0], points[n, 1], points[n, 2], kind, affine, warp, a, b)
        out[n] = height_at(heights, row, column) + offset


@njit(cache=True, nogil=True, error_model="numpy")
def _layer(
    origin: Array, direction: Array, low: float, high: float, kind: int, a: float, b: float
) -> tuple[float, float]:
    """Distances at which a ray enters the layer of possible heights and leaves it (below, or above again)."""
    if kind == LOCAL:
        if direction[2] == 0.0:
            return np.nan, np.nan
        s_low, s_high = (low - origin[2]) / direction[2], (high - origin[2]) / direction[2]
        return max(min(s_low, s_high), 0.0), max(s_low, s_high)
    ox, oy, oz = origin
    dx, dy, dz = direction
    # ellipsoids with longer axes are off from true height surfaces by < 1e-5 of the height: 1 m covers that
    enter, leave = _roots(ox, oy, oz, dx, dy, dz, a + high + 1.0, b + high + 1.0)
    floor, _ = _roots(ox, oy, oz, dx, dy, dz, a + low - 1.0, b + low - 1.0)
    if floor > 0.0:
        leave = floor
    return max(enter, 0.0), leave


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _clearance(path: Array, w: float, heights: Array, offset: float) -> float:
    """Height of a path above the ground at its parameter `w` (0 to 1); NaN where the ground is unknown.

    `path` (4, 3) holds the coefficients of row, column and height, constants first.
    """
    row = path[0, 0] + w * (path[1, 0] + w * (path[2, 0] + w * path[3, 0]))
    column = path[0, 1] + w * (path[1, 1] + w * (path[2, 1] + w * path[3, 1]))
    z = path[0, 2] + w * (path[1, 2] + w * (path[2, 2] + w * path[3, 2]))
    return z - offset - height_at(heights, row, column)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_path(
    o: Array,
    d: Array,
    start: float,
    length: float,
    kind: int,
    affine: Array,
    warp: Array,
    a: float,
    b: float,
    path: Array,
) -> float:
    """Cubic over the grid of a piece of a ray, into `path`; returns the cells it crosses, NaN off the map."""
    g = np.empty((4, 3))
    for k in range(4):
        s = start + k * length / 3.0
        g[k, 0], g[k, 1], g[k, 2] = to_grid(
            o[0] + s * d[0], o[1] + s * d[1], o[2] + s * d[2], kind, affine, warp, a, b
        )
    for k in range(3):
        d1, d2, d3 = g[1, k] - g[0, k], g[2, k] - g[0, k], g[3, k] - g[0, k]
        path[0, k] = g[0, k]
        path[1, k] = 9.0 * d1 - 4.5 * d2 + d3
        path[2, k] = -22.5 * d1 + 18.0 * d2 - 4.5 * d3
        path[3, k] = 13.5 * d1 - 13.5 * d2 + 4.5 * d3
    return np.sqrt((g[3, 0] - g[0, 0]) ** 2 + (g[3, 1] - g[0, 1]) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(
    path: Array, w1: float, w2: float, f1: float, f2: float, heights: Array, offset: float
) -> tuple[float, float]:
    """Where a path meets the ground between w1 (clearance f1 > 0) and w2 (f2 <= 0), and the slope there.

    False position with the Illinois rule; NaN where the ground is unknown.
    """
    side = 0
    w, slope, near = w2, (f2 - f1) / (w2 - w1), 1e-3 * (w2 - w1)
    for _ in range(100):
        w = w1 + (w2 - w1) * f1 / (f1 - f2)
        f = _clearance(path, w, heights, offset)
        if not np.isfinite(f):
            return np.nan, np.nan
        if abs(f) < 1e-9 or w2 - w1 < 1e-15:
            break
        if f > 0.0:
            w1, f1 = w, f
            f2 *= 0.5 if side == 1 else 1.0
            side = 1
        else:
            w2, f2 = w, f
            f1 *= 0.5 if side == -1 else 1.0
            side = -1
    around = _clearance(path, w + near, heights, offset) - _clearance(path, w - near, heights, offset)
    if around < 0.0:
        slope = around / (2.0 * near)
    return w, slope


@njit(cache=True, nogil=True, error_model="numpy")
def dem_hits(
    origins: Array,
    directions: Array,
    heights: Array,
    limits: tuple[float, float],
    offset: float,
    kind: int,
    affine: Array,
    warp: Array,
    a: float,
    b: float,
    out: Array,
) -> None:
    """First meeting of rays with a grid of heights, into `out` (N, 3).

    Each ray is walked from where it enters the layer between the lowest and the highest height, in steps of
    half a cell, until it passes from above the ground to below. NaN where it leaves the grid, meets a void,
    or is below the ground where it enters.
    """
    low, high = limits[0] + offset, limits[1] + offset
    # a little more at both ends, so that the highest and the lowest points themselves are bracketed
    slack = 1e-6 * (1.0 + high - low) + 1e-3
    path = np.empty((4, 3))
    for n in range(len(origins)):
        out[n] = np.nan
        o, d = origins[n], directions[n]
        if not np.isfinite(o[0] + o[1] + o[2] + d[0] + d[1] + d[2]):
            continue
        enter, leave = _layer(o, d, low, high, kind, a, b)
        if not leave >= enter:
            continue
        enter, leave = max(enter - slack, 0.0), leave + slack
        pieces = max(1, int(np.ceil((leave - enter) / _PIECE)))
        length = (leave - enter) / pieces
        f_before = np.nan  # clearance one step before; NaN where unknown
        for piece in range(pieces):
            start = enter + piece * length
            cells = _fit_path(o, d, start, length, kind, affine, warp, a, b, path)
            if not np.isfinite(cells):
                f_before = np.nan
                continue
            steps = max(1, int(np.ceil(cells / _STRIDE)))
            f = f_before
            for k in range(1 if np.isfinite(f_before) else 0, steps + 1):
                f = _clearance(path, k / steps, heights, offset)
                if f <= 0.0:
                    if f_before > 0.0:
                        w, g = _crossing(path, (k - 1) / steps, k / steps, f_before, f, heights, offset)
                        s, g = start + w * length, g / length
                        s = _polish(o, d, s, g, heights, offset, kind, affine, warp, a, b)
                        for c in range(3):
                            out[n, c] = o[c] + s * d[c]
                    break
                f_before = f
            if f <= 0.0:
                break


@njit(cache=True, nogil=True, error_model="numpy")
def _polish(
    o: Array,
    d: Array,
    s: float,
    slope: float,
    heights: Array,
    offset: float,
    kind: int,
    affine: Array,
    warp: Array,
    a: float,
    b: float,
) -> float:
    """Distance at which the exact path meets the ground, from the answer of its cubic: steps of known slope.

    The cubic is off by so little that one step is enough but for pieces of many kilometres.
    """
    if kind == LOCAL:
        return s  # the path is straight over the grid: its cubic is exact
    for _ in range(20):
        row, column, z = to_grid(o[0] + s * d[0], o[1] + s * d[1], o[2] + s * d[2], kind, affine, warp, a, b)
        step = -(z - offset - height_at(heights, row, column)) / slope
        s += step
        if abs(step) < 1e-8:
            return s
    return s if abs(step) < 1e-4 else np.nan
