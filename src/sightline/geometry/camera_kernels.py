"""Compiled loops of the cameras: rays through a table of poses, the line that saw a point, lenses.

A table of poses holds one row per image line, from `first` on: the nine numbers of world_from_camera, row by
row, and the position less a common `origin` (that keeps rounding far below a pixel for Earth-centred axes).
Between lines each number follows the cubic through the four nearest.

Not here: how the table is made (``camera.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.geometry.checks import Array
from sightline.geometry.interpolation import unit_weights

#: Numbers in a row of a table of poses.
ROW = 12
#: Steps of the line search smaller than this (lines) end it.
_LINE_STEP = 3e-10
#: A slope is measured anew only over steps larger than this (lines): below, rounding would spoil it.
_SLOPE_STEP = 1e-5
_MAX_STEPS = 150
#: Newton's steps to where a plane meets a point, at most; such a step squared, and what a plane leaves out
#: times the error of its slope, are less than `_LINE_STEP` (lines).
_PLANE_STEPS, _PLANE_STEP, _LEFT_OUT = 8, 1e-5, 1e-7
#: Steps of the scan for points whose line the ends of the image do not bracket, and of the look before it.
_SCAN, _COARSE = 96, 12


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _stencil(x: float, count: int) -> tuple[int, float, float, float, float]:
    """First row and four weights of place `x` in a table of `count` (at least 4) rows."""
    start = min(max(int(np.floor(x)) - 1, 0), count - 4)
    w0, w1, w2, w3 = unit_weights(x - start)
    return start, w0, w1, w2, w3


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _slope_weights(x: float) -> tuple[float, float, float, float]:
    """What the weights of `_stencil` change by with the place, `x` rows after its first row."""
    a, b, c = x - 1.0, x - 2.0, x - 3.0
    return (
        -(a * b + a * c + b * c) / 6.0,
        0.5 * (b * c + x * c + x * b),
        -0.5 * (a * c + x * c + x * a),
        (a * b + x * b + x * a) / 6.0,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _curve(curve: Array, column: float) -> tuple[float, float, float, float]:
    """Both coordinates of a detector line at a fractional column, and their slopes per column.

    Cubic between pixels, straight on beyond the ends.
    """
    count = len(curve)
    if column <= 0.0 or column >= count - 1 or count < 4:
        i = min(max(int(np.floor(column)), 0), count - 2)
        along, across = curve[i + 1, 0] - curve[i, 0], curve[i + 1, 1] - curve[i, 1]
        return curve[i, 0] + (column - i) * along, curve[i, 1] + (column - i) * across, along, across
    i, w0, w1, w2, w3 = _stencil(column, count)
    d0, d1, d2, d3 = _slope_weights(column - i)
    return (
        w0 * curve[i, 0] + w1 * curve[i + 1, 0] + w2 * curve[i + 2, 0] + w3 * curve[i + 3, 0],
        w0 * curve[i, 1] + w1 * curve[i + 1, 1] + w2 * curve[i + 2, 1] + w3 * curve[i + 3, 1],
        d0 * curve[i, 0] + d1 * curve[i + 1, 0] + d2 * curve[i + 2, 0] + d3 * curve[i + 3, 0],
        d0 * curve[i, 1] + d1 * curve[i + 1, 1] + d2 * curve[i + 2, 1] + d3 * curve[i + 3, 1],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def curve_at(curve: Array, columns: Array, out: Array) -> None:
    """Coordinates of a detector line (columns, 2) at fractional `columns` (N,), into `out` (N, 2)."""
    for n in range(len(columns)):
        if np.isfinite(columns[n]):
            out[n, 0], out[n, 1], _, _ = _curve(curve, columns[n])
        else:
            out[n] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def line_rays(
    pixels: Array,
    table: Array,
    first: float,
    origin: Array,
    tangents: Array,
    origins: Array,
    directions: Array,
) -> None:
    """Rays of pushbroom pixels (N, 2), into `origins` and `directions` (N, 3); NaN where a pixel is NaN."""
    count = len(table)
    row = np.empty(ROW)
    for n in range(len(pixels)):
        line, column = pixels[n, 0], pixels[n, 1]
        if not (np.isfinite(line) and np.isfinite(column)):
            origins[n] = np.nan
            directions[n] = np.nan
            continue
        i, w0, w1, w2, w3 = _stencil(line - first, count)
        for k in range(ROW):
            row[k] = w0 * table[i, k] + w1 * table[i + 1, k] + w2 * table[i + 2, k] + w3 * table[i + 3, k]
        x, y, _, _ = _curve(tangents, column)
        dx = row[0] * x + row[1] * y + row[2]
        dy = row[3] * x + row[4] * y + row[5]
        dz = row[6] * x + row[7] * y + row[8]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        directions[n, 0], directions[n, 1], directions[n, 2] = dx * scale, dy * scale, dz * scale
        for k in range(3):
            origins[n, k] = origin[k] + row[9 + k]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _into_camera(table: Array, x: float) -> tuple[float, ...]:
    """What leads into the camera at table place `x`: three rows, their sign, and the place of the camera.

    The exact inverse of the interpolated matrix, by cross products of its columns: between lines it is a
    rotation only to second order in the motion of one line.
    """
    i, w0, w1, w2, w3 = _stencil(x, len(table))
    a, b, c, d = table[i], table[i + 1], table[i + 2], table[i + 3]
    xx, yx, zx = (
        w0 * a[0] + w1 * b[0] + w2 * c[0] + w3 * d[0],
        w0 * a[1] + w1 * b[1] + w2 * c[1] + w3 * d[1],
        w0 * a[2] + w1 * b[2] + w2 * c[2] + w3 * d[2],
    )
    xy, yy, zy = (
        w0 * a[3] + w1 * b[3] + w2 * c[3] + w3 * d[3],
        w0 * a[4] + w1 * b[4] + w2 * c[4] + w3 * d[4],
        w0 * a[5] + w1 * b[5] + w2 * c[5] + w3 * d[5],
    )
    xz, yz, zz = (
        w0 * a[6] + w1 * b[6] + w2 * c[6] + w3 * d[6],
        w0 * a[7] + w1 * b[7] + w2 * c[7] + w3 * d[7],
        w0 * a[8] + w1 * b[8] + w2 * c[8] + w3 * d[8],
    )
    ax, ay, az = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    return (
        ax, ay, az,
        zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx,
        xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx,
        1.0 if xx * ax + xy * ay + xz * az > 0.0 else -1.0,
        w0 * a[9] + w1 * b[9] + w2 * c[9] + w3 * d[9],
        w0 * a[10] + w1 * b[10] + w2 * c[10] + w3 * d[10],
        w0 * a[11] + w1 * b[11] + w2 * c[11] + w3 * d[11],
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _seen(into: tuple[float, ...], p: tuple[float, float, float]) -> tuple[float, float, float]:
    """Vector from the camera to the point `p` (less the origin), camera axes; its length to second order."""
    ax, ay, az, bx, by, bz, cx, cy, cz, sign, x, y, z = into
    qx, qy, qz = p[0] - x, p[1] - y, p[2] - z
    return (
        sign * (qx * ax + qy * ay + qz * az),
        sign * (qx * bx + qy * by + qz * bz),
        sign * (qx * cx + qy * cy + qz * cz),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def seen_tangents(points: Array, lines: Array, table: Array, first: float, origin: Array, out: Array) -> None:
    """Tangents (N, 2) of `points` (N, 3) with the pose at each of `lines` (N,), into `out`."""
    for n in range(len(points)):
        p = (points[n, 0] - origin[0], points[n, 1] - origin[1], points[n, 2] - origin[2])
        out[n] = np.nan
        if np.isfinite(lines[n]):
            x, y, z = _seen(_into_camera(table, lines[n] - first), p)
            if z > 0.0:
                out[n, 0], out[n, 1] = x / z, y / z


@njit(cache=True, nogil=True, error_model="numpy")
def _miss(
    seen: tuple[float, float, float], axis: Array, curve: Array, straight: bool
) -> tuple[float, float, float]:
    """How far across the detector line a vector in camera axes points (tangent), its column and its depth.

    NaN when it does not point in front of the camera.
    """
    cx, cy, cz = seen
    if not cz > 0.0:
        return np.nan, np.nan, np.nan
    u, v = cx / cz, cy / cz
    along, across = axis[0] * u + axis[1] * v, axis[0] * v - axis[1] * u
    last = len(curve) - 1
    step = (curve[last, 0] - curve[0, 0]) / last
    column = (along - curve[0, 0]) / step
    if straight:
        return across - curve[0, 1], column, cz
    height = curve[0, 1]
    for _ in range(20):
        place, height, slope, slope_across = _curve(curve, column)
        change = (along - place) / slope
        column += change
        height += slope_across * change
        if abs(change) < 1e-11 * (1.0 + abs(column)):
            break
    return across - height, column, cz


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _plane(planes: Array, x: float) -> tuple[float, float, float, float]:
    """The plane of the detector line at place `x`."""
    i, w0, w1, w2, w3 = _stencil(x, len(planes))
    a, b, c, d = planes[i], planes[i + 1], planes[i + 2], planes[i + 3]
    return (
        w0 * a[0] + w1 * b[0] + w2 * c[0] + w3 * d[0],
        w0 * a[1] + w1 * b[1] + w2 * c[1] + w3 * d[1],
        w0 * a[2] + w1 * b[2] + w2 * c[2] + w3 * d[2],
        w0 * a[3] + w1 * b[3] + w2 * c[3] + w3 * d[3],
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _beside(planes: Array, x: float, p: tuple[float, float, float]) -> tuple[float, float]:
    """How far the point lies beside the plane of the detector line at place `x`, and how that changes."""
    i, w0, w1, w2, w3 = _stencil(x, len(planes))
    d0, d1, d2, d3 = _slope_weights(x - i)
    apart, slope = 0.0, 0.0
    for k in range(4):
        q0, q1, q2, q3 = planes[i, k], planes[i + 1, k], planes[i + 2, k], planes[i + 3, k]
        factor = p[k] if k < 3 else -1.0
        apart += factor * (w0 * q0 + w1 * q1 + w2 * q2 + w3 * q3)
        slope += factor * (d0 * q0 + d1 * q1 + d2 * q2 + d3 * q3)
    return apart, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _met_by_plane(
    table: Array,
    planes: Array,
    low: float,
    high: float,
    g_low: float,
    g_high: float,
    p: tuple[float, float, float],
    axis: Array,
    curve: Array,
) -> tuple[float, float]:
    """Table place where the plane of a straight detector line meets the point, and the column there.

    Newton's steps from where `g_low` and `g_high`, how far the point lies beside the planes of both ends, let
    expect it. NaN where these leave the range, or where the miss does not agree but for what interpolating
    planes in place of poses leaves out.
    """
    x = low - g_low * (high - low) / (g_high - g_low)
    for _ in range(_PLANE_STEPS):
        apart, slope = _beside(planes, x, p)
        step = -apart / slope
        x += step
        if not low < x < high:
            break
        if abs(step) < _PLANE_STEP:
            f, column, depth = _miss(_seen(_into_camera(table, x), p), axis, curve, True)
            step = -f * depth / slope
            if abs(step) < _LEFT_OUT:
                return x + step, column
            break
    return np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_line(
    table: Array,
    a: float,
    b: float,
    fa: float,
    fb: float,
    p: tuple[float, float, float],
    axis: Array,
    curve: Array,
    straight: bool,
) -> tuple[float, float]:
    """Table place between `a` and `b`, where the miss changes sign, and the column there.

    Secant steps kept inside the bracket; every other step halves it once they have had their chance, so that
    any motion, however rough, ends at a crossing.
    """
    slope = (fb - fa) / (b - a)
    x = a - fa / slope if slope != 0.0 else 0.5 * (a + b)
    x_before, f_before = a, fa
    if abs(b - x) < abs(x - a):
        x_before, f_before = b, fb
    for step_number in range(_MAX_STEPS):
        f, column, _ = _miss(_seen(_into_camera(table, x), p), axis, curve, straight)
        if not np.isfinite(f):
            return np.nan, np.nan
        if (f > 0.0) == (fa > 0.0):
            a, fa = x, f
        else:
            b, fb = x, f
        if abs(x - x_before) > _SLOPE_STEP:
            measured = (f - f_before) / (x - x_before)
            if measured * slope > 0.0:
                slope = measured
        step = -f / slope
        if abs(step) < _LINE_STEP or f == 0.0:
            return x + step, column
        x_before, f_before = x, f
        x = x + step
        if not (a < x < b) or (step_number > 8 and step_number % 2 == 1):
            x = 0.5 * (a + b)
        if b - a < _LINE_STEP:
            return x, column
    return np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _only_crossing(
    table: Array,
    low: float,
    high: float,
    f_low: float,
    p: tuple[float, float, float],
    axis: Array,
    curve: Array,
    straight: bool,
) -> bool:
    """Whether the ends of a range of lines say all: one change of sign, or none and far from zero.

    Judged at a few places: far from zero means by more than the miss changes from one to the next.
    """
    crossings, largest, smallest, f_before = 0, 0.0, abs(f_low), f_low
    for k in range(1, _COARSE + 1):
        x = low + (high - low) * k / _COARSE
        f, _, _ = _miss(_seen(_into_camera(table, x), p), axis, curve, straight)
        if not np.isfinite(f + f_before):
            return False
        crossings += (f > 0.0) != (f_before > 0.0)
        largest, smallest, f_before = max(largest, abs(f - f_before)), min(smallest, abs(f)), f
    return crossings == 1 or (crossings == 0 and smallest > largest)


@njit(cache=True, nogil=True, error_model="numpy")
def find_lines(
    points: Array,
    table: Array,
    first: float,
    origin: Array,
    axis: Array,
    curve: Array,
    straight: bool,
    lines: tuple[float, float],
    columns: tuple[float, float],
    planes: Array,
    pixels: Array,
) -> None:
    """Pixels (line, column) that see `points` (N, 3), into `pixels` (N, 2); NaN where none does.

    `planes` (R, 4), one for each pose of the table: the plane in which a straight detector line looks, its
    normal, which times a vector is the vector's miss times its depth, and what that gives of the camera's own
    place; (0, 4) of a bent line.
    The miss at both ends of the range of lines brackets the answer in the common case. Where that finds
    nothing and the miss does more than fall from one end to the other, the range is scanned for any change of
    sign, and the first crossing inside the range of columns wins.
    """
    low, high = lines[0] - first, lines[1] - first
    at_low, at_high = _into_camera(table, low), _into_camera(table, high)
    by_plane = len(planes) > 0
    plane_low = plane_high = (0.0, 0.0, 0.0, 0.0)
    if by_plane:
        plane_low, plane_high = _plane(planes, low), _plane(planes, high)
    for n in range(len(points)):
        pixels[n] = np.nan
        if not np.isfinite(points[n, 0] + points[n, 1] + points[n, 2]):
            continue
        p = (points[n, 0] - origin[0], points[n, 1] - origin[1], points[n, 2] - origin[2])
        if by_plane:
            g_low = p[0] * plane_low[0] + p[1] * plane_low[1] + p[2] * plane_low[2] - plane_low[3]
            g_high = p[0] * plane_high[0] + p[1] * plane_high[1] + p[2] * plane_high[2] - plane_high[3]
            if g_low * g_high < 0.0:
                x, column = _met_by_plane(table, planes, low, high, g_low, g_high, p, axis, curve)
                if columns[0] <= column <= columns[1]:
                    pixels[n, 0], pixels[n, 1] = x + first, column
                    continue
        f_low, _, _ = _miss(_seen(at_low, p), axis, curve, straight)
        f_high, _, _ = _miss(_seen(at_high, p), axis, curve, straight)
        if f_low * f_high <= 0.0:
            x, column = _solve_line(table, low, high, f_low, f_high, p, axis, curve, straight)
            if columns[0] <= column <= columns[1]:
                pixels[n, 0], pixels[n, 1] = x + first, column
                continue
        if _only_crossing(table, low, high, f_low, p, axis, curve, straight):
            continue
        a, fa = low, f_low
        for k in range(1, _SCAN + 1):
            b = low + (high - low) * k / _SCAN
            fb, _, _ = _miss(_seen(_into_camera(table, b), p), axis, curve, straight)
            if fa * fb <= 0.0:
                x, column = _solve_line(table, a, b, fa, fb, p, axis, curve, straight)
                if columns[0] <= column <= columns[1]:
                    pixels[n, 0], pixels[n, 1] = x + first, column
                    break
            a, fa = b, fb


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def brown(x: float, y: float, k: Array) -> tuple[float, float]:
    """Distorted tangents (D. C. Brown): k = k1, k2, p1, p2, k3."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def distort(tangents: Array, coefficients: Array, reach: float) -> None:
    """Distort tangents (N, 2) in place; NaN beyond the radius `reach`."""
    for n in range(len(tangents)):
        x, y = tangents[n, 0], tangents[n, 1]
        if x * x + y * y <= reach * reach:
            tangents[n, 0], tangents[n, 1] = brown(x, y, coefficients)
        else:
            tangents[n] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def undistort(tangents: Array, coefficients: Array, tolerance: float, reach: float) -> None:
    """Undo `distort` in place by Newton steps, to `tolerance`; NaN where no answer lies within `reach`."""
    k1, k2, p1, p2, k3 = coefficients
    for n in range(len(tangents)):
        tx, ty = tangents[n, 0], tangents[n, 1]
        x, y = tx, ty
        found = False
        for _ in range(50):
            px, py = brown(x, y, coefficients)
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
            jxx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            jyy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            jxy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            determinant = jxx * jyy - jxy * jxy
            sx = (jyy * (tx - px) - jxy * (ty - py)) / determinant
            sy = (jxx * (ty - py) - jxy * (tx - px)) / determinant
            x, y = x + sx, y + sy
            if abs(sx) + abs(sy) < tolerance + 4e-16 * (abs(x) + abs(y)):
                found = True
                break
        if found and x * x + y * y <= reach * reach:
            tangents[n, 0], tangents[n, 1] = x, y
        else:
            tangents[n] = np.nan
