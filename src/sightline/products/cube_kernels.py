"""Compiled loops of the cube: where a ground point lies in a frame, which frame sees it best, its value.

Not here: which frames, bands and tiles (``frame_cube.py``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.geometry.camera_kernels import brown
from sightline.imaging.resample import natural_correlation, weights_of_sum_one
from sightline.products.resample import BAND, TAPS

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Fractions of a pixel in the table of weights; between two of them weights are linear (error < 2e-5).
PHASES = 256
#: Noise over signal that weights are made for, and how much of the noise's power they may let through.
_NOISE, _MOST_NOISE = (1e-13, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2), 2.0
#: Steps that find the line of a rolling shutter; each leaves a hundredth of the error before and less.
_LINE_STEPS = 6
#: Change of that line (px) that ends them: what is left is a hundredth of it.
_LINE_ENOUGH = 0.02


@cache
def place_weights() -> Array32:
    """Weights of 16 taps for places from the first of them to the last.

    Row p is the place ``p / PHASES``. In the middle they are those of ``products/resample.py``; towards
    the ends, for places near the border of an image, they are as true as taps on one side can be without
    doubling the noise.
    """
    correlation = natural_correlation(BAND, 200)
    taps = np.arange(TAPS, dtype=np.float64)
    places = np.arange((TAPS - 1) * PHASES + 1) / PHASES
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
def _pose(m, p):  # type: ignore[no-untyped-def]
    """The nine numbers of a matrix and the three of a position."""
    return (
        m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2], p[0], p[1], p[2],
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def frame_numbers(matrices, positions, lens, coefficients):  # type: ignore[no-untyped-def]
    """A frame for `seen_at`, as numbers: a loop need not ask memory for them at every place.

    `matrices` (K, 3, 3) camera_from_world and `positions` (K, 3), K = 1, or 3 for the first, middle and last
    line; `lens` focal length, principal line, principal column; `coefficients` (5,) of the distortion.
    """
    k, last = min(1, len(matrices) - 1), len(matrices) - 1
    c = coefficients
    return (
        _pose(matrices[0], positions[0]),
        _pose(matrices[k], positions[k]),
        _pose(matrices[last], positions[last]),
        (lens[0], lens[1], lens[2]),
        (c[0], c[1], c[2], c[3], c[4]),
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _mixed(a, first, b, middle, c, last):  # type: ignore[no-untyped-def]
    """The pose with such shares of three."""
    return (
        a * first[0] + b * middle[0] + c * last[0],
        a * first[1] + b * middle[1] + c * last[1],
        a * first[2] + b * middle[2] + c * last[2],
        a * first[3] + b * middle[3] + c * last[3],
        a * first[4] + b * middle[4] + c * last[4],
        a * first[5] + b * middle[5] + c * last[5],
        a * first[6] + b * middle[6] + c * last[6],
        a * first[7] + b * middle[7] + c * last[7],
        a * first[8] + b * middle[8] + c * last[8],
        a * first[9] + b * middle[9] + c * last[9],
        a * first[10] + b * middle[10] + c * last[10],
        a * first[11] + b * middle[11] + c * last[11],
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def seen_at(x, y, z, frame, rolling, reach, lines, guess):  # type: ignore[no-untyped-def]
    """(line, column) at which a frame sees a world point; NaN behind it or beyond the lens.

    The line of a rolling shutter is looked for from `guess` on, that of a place beside it; `frame` is as
    `frame_numbers` gives it.
    """
    first, middle, last, lens, coefficients = frame
    pose = first
    line, column = guess, np.nan
    for _ in range(_LINE_STEPS if rolling else 1):
        if rolling:
            # the interpolated matrix about the interpolated place
            s = min(max(line / (lines - 1.0), -0.5), 1.5)
            a, b, c = (1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)
            pose = _mixed(a, first, b, middle, c, last)
        px, py, pz = x - pose[9], y - pose[10], z - pose[11]
        qx = pose[0] * px + pose[1] * py + pose[2] * pz
        qy = pose[3] * px + pose[4] * py + pose[5] * pz
        qz = pose[6] * px + pose[7] * py + pose[8] * pz
        if qz <= 0.0:
            return np.nan, np.nan
        right, down = qx / qz, qy / qz
        if right * right + down * down > reach * reach:
            return np.nan, np.nan
        right, down = brown(right, down, coefficients)
        before = line
        line, column = lens[1] + lens[0] * down, lens[2] + lens[0] * right
        if abs(line - before) < _LINE_ENOUGH:
            break
    return line, column


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inside(line, column, shape, period):  # type: ignore[no-untyped-def]
    """Whether pixels of every band lie on all sides of a place, so that none is made up beyond the frame."""
    low, left = period[0] - 1.0, period[1] - 1.0
    return low <= line <= shape[0] - period[0] and left <= column <= shape[1] - period[1]


@njit(cache=True, nogil=True, error_model="numpy")
def _begun_at(offset, entry_group, spare):  # type: ignore[no-untyped-def]
    """Groups that begin at each line: those of line l from ``first[l]`` to ``first[l + 1]``."""
    lines = len(offset) - 1
    first, groups = np.zeros(lines + 1, np.int64), np.empty(len(entry_group), np.int64)
    before = np.full(entry_group.max() + 1 if len(entry_group) else 0, -2)
    for line in range(lines):
        first[line + 1] = first[line]
        for e in range(offset[line], offset[line + 1]):
            g = entry_group[e]
            if spare[e] or before[g] == line:
                continue
            if before[g] != line - 1:
                groups[first[line + 1]] = g
                first[line + 1] += 1
            before[g] = line
    return first, groups


@njit(cache=True, nogil=True, error_model="numpy")
def choose_views(  # type: ignore[no-untyped-def]
    world, box, matrices, positions, lens, coefficients, reach, shape, period, offset, entry_group, centre,
    half, spare, penalty, frame, cost, view, beyond, last, passed,
):  # fmt: skip
    """Take a frame where it shows places of a tile better than those before it did.

    `world` (rows, columns, 3); `box` first and one past the last row and column to look at; `cost`, `view`
    and `beyond` (groups, rows, columns) are written; `last` (rows, columns) the line that saw each place in
    the frame before (NaN: none) and `passed` (groups, rows, columns) whether lines of the group have passed
    over it since, in this frame or on the way to it.
    """
    lines, columns = shape
    middle = 0.5 * (columns - 1.0)
    guess = 0.5 * (lines - 1.0)
    numbers, rolling = frame_numbers(matrices, positions, lens, coefficients), len(matrices) == 3
    begin, begun = _begun_at(offset, entry_group, spare)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            x, y, z = world[i, j, 0], world[i, j, 1], world[i, j, 2]
            line, column = seen_at(x, y, z, numbers, rolling, reach, lines, guess)
            if not inside(line, column, shape, period):
                last[i, j] = np.nan
                continue
            guess = line
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
            other = at if np.isnan(last[i, j]) else int(np.floor(last[i, j] + 0.5))
            low, high = min(at, other), max(at, other)
            for e in range(offset[low], offset[low + 1]):
                if not spare[e]:
                    passed[entry_group[e], i, j] = True
            for e in range(begin[low + 1], begin[high + 1]):
                passed[begun[e], i, j] = True
            last[i, j] = line


@njit(cache=True, nogil=True)
def sort_by_frame(view, first, places):  # type: ignore[no-untyped-def]
    """Places of a tile frame by frame: `view` (groups * pixels,), -1 where there is none.

    Flat indices of frame k into ``places[first[k] : first[k + 1]]``; `first` (frames + 1,) is written.
    """
    first[:] = 0
    for n in range(view.shape[0]):
        if view[n] >= 0:
            first[view[n] + 1] += 1
    for k in range(first.shape[0] - 1):
        first[k + 1] += first[k]
    place = first[:-1].copy()
    for n in range(view.shape[0]):
        if view[n] >= 0:
            places[place[view[n]]] = n
            place[view[n]] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def see_places(  # type: ignore[no-untyped-def]
    world, places, matrices, positions, lens, coefficients, reach, shape, pixels
):
    """(line, column) at which a frame sees places, flat indices over groups and `world` (n, 3)."""
    lines = shape[0]
    guess = 0.5 * (lines - 1.0)
    numbers, rolling = frame_numbers(matrices, positions, lens, coefficients), len(matrices) == 3
    count = world.shape[0]
    for n in range(places.shape[0]):
        k = places[n] % count
        x, y, z = world[k, 0], world[k, 1], world[k, 2]
        line, column = seen_at(x, y, z, numbers, rolling, reach, lines, guess)
        guess = line
        pixels[n, 0], pixels[n, 1] = line, column


@njit(cache=True, nogil=True)
def _one_sided(place, first):  # type: ignore[no-untyped-def]
    """Whether taps from `first` on do not lie evenly about a place."""
    return int(np.floor(place)) - (TAPS // 2 - 1) != first


@njit(cache=True, nogil=True, fastmath=True)
def _value(image, bad, rows, columns, line, column, table, wq):  # type: ignore[no-untyped-def]
    """The image at a place; and how much pixels that cannot be used weigh in it.

    Its first `rows` and `columns` hold pixels; `wq` (TAPS,) is scratch. Near a border, where the taps lie on
    one side, values beyond those of the pixels around are cut.
    """
    r0 = min(max(int(np.floor(line)) - (TAPS // 2 - 1), 0), rows - TAPS)
    c0 = min(max(int(np.floor(column)) - (TAPS // 2 - 1), 0), columns - TAPS)
    p = min(max((line - r0) * PHASES, 0.0), table.shape[0] - 1.001)
    q = min(max((column - c0) * PHASES, 0.0), table.shape[0] - 1.001)
    ip, iq = int(p), int(q)
    sp, sq = np.float32(p - ip), np.float32(q - iq)
    here, further = table[iq], table[iq + 1]
    for m in range(TAPS):
        wq[m] = here[m] + sq * (further[m] - here[m])
    total = np.float32(0.0)
    weight = np.float32(0.0)
    for k in range(TAPS):
        wp = table[ip, k] + sp * (table[ip + 1, k] - table[ip, k])
        part, pixels = np.float32(0.0), image[r0 + k, c0 : c0 + TAPS]
        for m in range(TAPS):
            part += wq[m] * pixels[m]
        total += wp * part
        if bad.shape[0]:
            for m in range(TAPS):
                if bad[r0 + k, c0 + m]:
                    weight += abs(wp * wq[m])
    if _one_sided(line, r0) or _one_sided(column, c0):
        low = high = image[r0, c0]
        for k in range(TAPS):
            for m in range(TAPS):
                low, high = min(low, image[r0 + k, c0 + m]), max(high, image[r0 + k, c0 + m])
        total = min(max(total, low), high)
    return total, weight


def cells_by_phase(
    image: Array32, bad: NDArray[np.bool_], period: tuple[int, int]
) -> tuple[Array32, NDArray[np.bool_], NDArray[np.int64]]:
    """Pixels of each phase of a filter by themselves, one behind the other in memory.

    Parameters
    ----------
    image : (rows, columns) float32
    bad : (rows, columns) bool
        Empty where all can be used.
    period : (int, int)

    Returns
    -------
    cells, bad : (phases, rows, columns)
    sizes : (phases, 2)
        Rows and columns that hold pixels; phases go row by row of the filter.
    """
    phases = [(i, j) for i in range(period[0]) for j in range(period[1])]
    sizes = np.array([image[i :: period[0], j :: period[1]].shape for i, j in phases], dtype=np.int64)
    if len(phases) == 1:
        return image[None], bad[None], sizes
    cells = np.zeros((len(phases), *sizes.max(axis=0)), dtype=np.float32)
    spoiled = np.zeros((len(phases), *(sizes.max(axis=0) if bad.size else (0, 0))), dtype=np.bool_)
    for k, ((i, j), (rows, columns)) in enumerate(zip(phases, sizes, strict=True)):
        cells[k, :rows, :columns] = image[i :: period[0], j :: period[1]]
        if bad.size:
            spoiled[k, :rows, :columns] = bad[i :: period[0], j :: period[1]]
    return cells, spoiled, sizes


@njit(cache=True, nogil=True, error_model="numpy")
def fill_bands(  # type: ignore[no-untyped-def]
    places, pixels, cells, bad, sizes, corner, period, first, bands, phase, level, table, share, out
):
    """Values of `bands` at `places` of a tile, which a frame sees at `pixels`, into `out` (B, places).

    `cells`, `bad` and `sizes` are the part of the frame from `corner` on, which begins at a whole period of
    the filter, as `cells_by_phase` gives it; `bands` and their `phase` go group by group, group g from
    ``first[g]`` on; values are multiplied by `level` (B,).
    """
    count = out.shape[1]
    scratch = np.empty(TAPS, np.float32)
    for k in range(places.shape[0]):
        g, at = places[k] // count, places[k] % count
        for n in range(first[g], first[g + 1]):
            which = phase[n, 0] * period[1] + phase[n, 1]
            value, weight = _value(
                cells[which],
                bad[which],
                sizes[which, 0],
                sizes[which, 1],
                (pixels[k, 0] - corner[0] - phase[n, 0]) / period[0],
                (pixels[k, 1] - corner[1] - phase[n, 1]) / period[1],
                table,
                scratch,
            )
            out[bands[n], at] = level[bands[n]] * value if weight <= share else np.nan


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
