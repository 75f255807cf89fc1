"""Compiled loops of the cube: where a ground point lies in a frame, which frame sees it best, its value.

Not here: which frames, bands and tiles (``frame_cube.py``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sightline.geometry.camera_kernels import brown
from sightline.imaging.resample import weights_of_sum_one
from sightline.products.resample import BAND, TAPS

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Fractions of a pixel in the table of weights; between two of them weights are linear (error < 2e-5).
PHASES = 256
#: Noise over signal that weights are made for, and how much of the noise's power they may let through.
_NOISE, _MOST_NOISE = (1e-13, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2), 2.0
#: Steps that find the line of a rolling shutter; each leaves a hundredth of the error before and less.
_LINE_STEPS = 4


@cache
def place_weights() -> Array32:
    """Weights of 16 taps for places from the first of them to the last.

    Row p is the place ``p / PHASES``. In the middle they are those of ``products/resample.py``; towards
    the ends, for places near the border of an image, they are as true as taps on one side can be without
    doubling the noise.
    """
    nodes, share = np.polynomial.legendre.leggauss(200)
    f = 0.5 * BAND * (nodes + 1.0)
    power = share / (f + 1.0 / 200.0) ** 2
    power /= power.sum()
    taps = np.arange(TAPS, dtype=np.float64)
    places = np.arange((TAPS - 1) * PHASES + 1) / PHASES

    def correlation(lag: Array) -> Array:
        return np.asarray(np.cos(2.0 * np.pi * lag[..., None] * f) @ power)

    right = correlation(taps[:, None] - places[None, :])
    normal = correlation(taps[:, None] - taps[None, :])
    best = np.zeros((len(places), TAPS))
    open_ = np.ones(len(places), dtype=np.bool_)
    for noise in _NOISE:
        # the least noise that keeps weights from amplifying it: in the middle next to none is needed
        weights = weights_of_sum_one(normal + noise * np.eye(TAPS), right)
        best[open_] = weights[open_]
        open_ &= (best**2).sum(axis=1) > _MOST_NOISE
    table = best.astype(np.float32)
    table.setflags(write=False)
    return table


@njit(cache=True, nogil=True, error_model="numpy")
def seen_at(point, matrices, positions, lens, coefficients, reach, lines):  # type: ignore[no-untyped-def]
    """(line, column) at which a frame sees a world point (3,); NaN behind it or beyond the lens.

    `matrices` (K, 3, 3) camera_from_world and `positions` (K, 3), K = 1, or 3 for the first, middle and last
    line; `lens` focal length, principal line, principal column.
    """
    rolling = matrices.shape[0] == 3
    line = 0.5 * (lines - 1.0)
    column = np.nan
    for _ in range(_LINE_STEPS if rolling else 1):
        a, b, c = 1.0, 0.0, 0.0
        if rolling:
            s = min(max(line / (lines - 1.0), -0.5), 1.5)
            a, b, c = (1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)
        px = point[0] - a * positions[0, 0]
        py = point[1] - a * positions[0, 1]
        pz = point[2] - a * positions[0, 2]
        m = matrices[0]
        qx = a * (m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz)
        qy = a * (m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz)
        qz = a * (m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz)
        if rolling:
            # the interpolated matrix about the interpolated place
            px -= b * positions[1, 0] + c * positions[2, 0]
            py -= b * positions[1, 1] + c * positions[2, 1]
            pz -= b * positions[1, 2] + c * positions[2, 2]
            n, o = matrices[1], matrices[2]
            qx = (a * m[0, 0] + b * n[0, 0] + c * o[0, 0]) * px
            qx += (a * m[0, 1] + b * n[0, 1] + c * o[0, 1]) * py
            qx += (a * m[0, 2] + b * n[0, 2] + c * o[0, 2]) * pz
            qy = (a * m[1, 0] + b * n[1, 0] + c * o[1, 0]) * px
            qy += (a * m[1, 1] + b * n[1, 1] + c * o[1, 1]) * py
            qy += (a * m[1, 2] + b * n[1, 2] + c * o[1, 2]) * pz
            qz = (a * m[2, 0] + b * n[2, 0] + c * o[2, 0]) * px
            qz += (a * m[2, 1] + b * n[2, 1] + c * o[2, 1]) * py
            qz += (a * m[2, 2] + b * n[2, 2] + c * o[2, 2]) * pz
        if qz <= 0.0:
            return np.nan, np.nan
        x, y = qx / qz, qy / qz
        if x * x + y * y > reach * reach:
            return np.nan, np.nan
        x, y = brown(x, y, coefficients)
        line, column = lens[1] + lens[0] * y, lens[2] + lens[0] * x
    return line, column


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inside(line, column, shape, period):  # type: ignore[no-untyped-def]
    """Whether pixels of every band lie on all sides of a place, so that none is made up beyond the frame."""
    low, left = period[0] - 1.0, period[1] - 1.0
    return low <= line <= shape[0] - period[0] and left <= column <= shape[1] - period[1]


@njit(cache=True, nogil=True, error_model="numpy")
def choose_views(  # type: ignore[no-untyped-def]
    world, box, matrices, positions, lens, coefficients, reach, shape, period, offset, entry_group, centre,
    half, spare, penalty, frame, cost, view, beyond, swept,
):  # fmt: skip
    """Take a frame where it shows places of a tile better than those before it did.

    `world` (rows, columns, 3); `box` first and one past the last row and column to look at; `cost`, `view`
    and `beyond` (groups, rows, columns) are written; `swept` (rows, columns, 2) first and last line that saw
    each place.
    """
    lines, columns = shape
    middle = 0.5 * (columns - 1.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            line, column = seen_at(world[i, j], matrices, positions, lens, coefficients, reach, lines)
            if not inside(line, column, shape, period):
                continue
            swept[i, j, 0] = min(swept[i, j, 0], line)
            swept[i, j, 1] = max(swept[i, j, 1], line)
            aside = (column - middle) / (0.5 * columns)
            at = int(np.floor(line + 0.5))
            for e in range(offset[at], offset[at + 1]):
                off = (line - centre[e]) / half[e]
                value = off * off + aside * aside + penalty
                g = entry_group[e]
                if value < cost[g, i, j]:
                    cost[g, i, j] = value
                    view[g, i, j] = frame
                    beyond[g, i, j] = spare[e]


@njit(cache=True, nogil=True, error_model="numpy")
def needed_box(  # type: ignore[no-untyped-def]
    world,
    box,
    matrices,
    positions,
    lens,
    coefficients,
    reach,
    shape,
    period,
    offset,
    entry_group,
    frame,
    view,
    out,
):
    """First and last line and column of a frame among the places of which it is the view, into `out` (4,).

    Returns how many there are.
    """
    lines = shape[0]
    count = 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            line, column = seen_at(world[i, j], matrices, positions, lens, coefficients, reach, lines)
            if not inside(line, column, shape, period):
                continue
            at = int(np.floor(line + 0.5))
            for e in range(offset[at], offset[at + 1]):
                if view[entry_group[e], i, j] == frame:
                    if count == 0:
                        out[0], out[1], out[2], out[3] = line, line, column, column
                    out[0], out[1] = min(out[0], line), max(out[1], line)
                    out[2], out[3] = min(out[2], column), max(out[3], column)
                    count += 1
    return count


@njit(cache=True, nogil=True, fastmath=True)
def _value(image, bad, line, column, table):  # type: ignore[no-untyped-def]
    """The image at a place; and how much pixels that cannot be used weigh in it."""
    r0 = min(max(int(np.floor(line)) - (TAPS // 2 - 1), 0), image.shape[0] - TAPS)
    c0 = min(max(int(np.floor(column)) - (TAPS // 2 - 1), 0), image.shape[1] - TAPS)
    p = min(max((line - r0) * PHASES, 0.0), table.shape[0] - 1.001)
    q = min(max((column - c0) * PHASES, 0.0), table.shape[0] - 1.001)
    ip, iq = int(p), int(q)
    sp, sq = np.float32(p - ip), np.float32(q - iq)
    wq = np.empty(TAPS, np.float32)
    for m in range(TAPS):
        wq[m] = table[iq, m] + sq * (table[iq + 1, m] - table[iq, m])
    total = np.float32(0.0)
    weight = np.float32(0.0)
    for k in range(TAPS):
        wp = table[ip, k] + sp * (table[ip + 1, k] - table[ip, k])
        part = np.float32(0.0)
        for m in range(TAPS):
            part += wq[m] * image[r0 + k, c0 + m]
        total += wp * part
        if bad.shape[0]:
            for m in range(TAPS):
                if bad[r0 + k, c0 + m]:
                    weight += abs(wp * wq[m])
    return total, weight


@njit(cache=True, nogil=True, error_model="numpy")
def fill_bands(  # type: ignore[no-untyped-def]
    world, box, matrices, positions, lens, coefficients, reach, shape, period, offset, entry_group, frame,
    view, image, bad, corner, first, bands, phase, level, table, share, out,
):  # fmt: skip
    """Values of `bands` at the places of a tile of which a frame is the view, into `out` (B, rows, columns).

    `image` is the part of the frame from `corner` on, which begins at a whole period of the filter; `bands`
    and their `phase` go group by group, group g from ``first[g]`` on; values are multiplied by `level` (B,).
    """
    lines = shape[0]
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            line, column = seen_at(world[i, j], matrices, positions, lens, coefficients, reach, lines)
            if not inside(line, column, shape, period):
                continue
            at = int(np.floor(line + 0.5))
            for e in range(offset[at], offset[at + 1]):
                g = entry_group[e]
                if view[g, i, j] != frame:
                    continue
                for n in range(first[g], first[g + 1]):
                    cells = image[phase[n, 0] :: period[0], phase[n, 1] :: period[1]]
                    spoiled = bad[phase[n, 0] :: period[0], phase[n, 1] :: period[1]]
                    value, weight = _value(
                        cells,
                        spoiled,
                        (line - corner[0] - phase[n, 0]) / period[0],
                        (column - corner[1] - phase[n, 1]) / period[1],
                        table,
                    )
                    out[bands[n], i, j] = level[bands[n]] * value if weight <= share else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def count_seams(view, values, sums):  # type: ignore[no-untyped-def]
    """Pairs of neighbours of one band with values, and their squared differences, into `sums` (4,).

    `view` (rows, columns) the frame of each place; sums: pairs of one frame, their squared differences, pairs
    of two frames, theirs.
    """
    rows, columns = view.shape
    for i in range(rows):
        for j in range(columns):
            if not np.isfinite(values[i, j]):
                continue
            for step in range(2):
                k, m = i + (1 - step), j + step
                if k >= rows or m >= columns or not np.isfinite(values[k, m]):
                    continue
                two = 2 if view[i, j] != view[k, m] else 0
                difference = values[i, j] - values[k, m]
                sums[two] += 1.0
                sums[two + 1] += difference * difference
