"""Compiled loops of the hysteresis: the path of fewest changes along a line, and the setting held from line
to line.

Not here: what is lost, and which limits a cell keeps (``hysteresis.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit

#: Bits of what a setting keeps; a cell needs some of them.
UNSATURATED, IN_LOBE, IN_BOUNDS, CLEAR = 1, 2, 4, 8
#: Cost of what cannot be reached.
_NEVER = 2**63 - 1


@njit(cache=True, nogil=True)
def _lossless_share(along, fixed, p, best):  # type: ignore[no-untyped-def]
    """Share of the best setting's merit that another setting loses; 1 where the best has none."""
    most = along[best] * fixed[best]
    if not most > 0.0:
        return 0.0 if p == best else 1.0
    return max(1.0 - along[p] * fixed[p] / most, 0.0)


@njit(cache=True, nogil=True)
def _near_best(along, along_kept, fixed, fixed_kept, best, needed, share, found, loss):  # type: ignore[no-untyped-def]
    """Settings (into `found`, rising) that lose no more than `share` of the best; gives their number."""
    count = 0
    most = along[best] * fixed[best]
    least = most * (1.0 - share) if most > 0.0 else np.inf
    for p in range(along.shape[0]):
        if p == best or (along[p] * fixed[p] >= least and (along_kept[p] | fixed_kept[p]) & needed == needed):
            found[count] = p
            loss[count] = min(_lossless_share(along, fixed, p, best), share)
            count += 1
    return count


@njit(cache=True, nogil=True)
def fewest_changes(  # type: ignore[no-untyped-def]
    along, along_kept, fixed, fixed_kept, best, needed, share, n_ratios, largest_step, levels, out, far
):
    """Settings along one line of cells: fewest steps too far, then fewest changes, then least loss.

    Parameters
    ----------
    along, along_kept : (L, P)
        Factor of the merit that varies along the line; bits of what a setting keeps.
    fixed, fixed_kept : (P,)
        The other factor, the same for all cells.
    best : (L,) int
        Freely best setting.
    needed : (L,) uint8
        Bits that a setting of the cell has to keep.
    share : float
        Of the merit that a cell may lose.
    n_ratios : int
        Settings of equal stages stand side by side, so many of them.
    largest_step : int
        Of the number of stages between neighbours, grid steps; below 0: any.
    levels : int
        A loss of `share` counts as so much; L^3 levels must be a 63-bit number.
    out : (L,) int
        Overwritten.
    far : (L,) bool
        Overwritten: a cell that lies further from the one before than `largest_step`.

    Notes
    -----
    Dynamic programming over the settings near each cell's best: a path keeps its setting at no cost or
    changes to any other that is near enough. A setting too far away is taken where no other path goes on.
    """
    length, settings = along.shape
    rows = settings // n_ratios
    change = np.int64(length) * levels + 1
    leap = change * (length + 1)
    found, loss = np.empty(settings, dtype=np.int32), np.empty(settings)
    # of the cell before: cost of the path to each setting, its place in the list, and the best of each row
    cost, place = np.empty(settings, dtype=np.int64), np.full(settings, -1, dtype=np.int32)
    new_cost = np.empty(settings, dtype=np.int64)
    row_cost, row_place = np.full(rows, _NEVER), np.full(rows, -1, dtype=np.int32)
    start = np.zeros(length + 1, dtype=np.int64)
    kept, came_from = np.empty(1024, dtype=np.int32), np.empty(1024, dtype=np.int32)
    top_cost, top_place = np.int64(_NEVER), np.int32(0)
    for c in range(length):
        n = _near_best(along[c], along_kept[c], fixed, fixed_kept, best[c], needed[c], share, found, loss)
        begin = start[c]
        start[c + 1] = begin + n
        while start[c + 1] > kept.shape[0]:
            more_kept = np.empty(2 * kept.shape[0], dtype=np.int32)
            more_came_from = np.empty(2 * kept.shape[0], dtype=np.int32)
            for i in range(begin):
                more_kept[i], more_came_from[i] = kept[i], came_from[i]
            kept, came_from = more_kept, more_came_from
        at_row, near_cost, near_place = -1, np.int64(_NEVER), np.int32(-1)
        for i in range(n):
            p = found[i]
            own = np.int64(round(loss[i] / share * levels)) if share > 0.0 else np.int64(0)
            if c == 0:
                new_cost[i], came_from[begin + i] = own, -1
                kept[begin + i] = p
                continue
            row = p // n_ratios
            if row != at_row:
                at_row, near_cost, near_place = row, np.int64(_NEVER), np.int32(-1)
                if largest_step < 0:
                    near_cost, near_place = top_cost, top_place
                else:
                    for r in range(max(row - largest_step, 0), min(row + largest_step + 1, rows)):
                        if row_cost[r] < near_cost:
                            near_cost, near_place = row_cost[r], row_place[r]
            least, where = top_cost + leap + change, top_place
            if near_cost < _NEVER and near_cost + change < least:
                least, where = near_cost + change, near_place
            if place[p] >= 0 and cost[p] <= least:
                least, where = cost[p], place[p]
            new_cost[i], came_from[begin + i] = least + own, where
            kept[begin + i] = p
        if c > 0:
            for i in range(start[c - 1], begin):
                place[kept[i]] = -1
                row_cost[kept[i] // n_ratios] = _NEVER
        top_cost = np.int64(_NEVER)
        for i in range(n):
            p = found[i]
            row = p // n_ratios
            cost[p], place[p] = new_cost[i], i
            if new_cost[i] < row_cost[row]:
                row_cost[row], row_place[row] = new_cost[i], i
            if new_cost[i] < top_cost:
                top_cost, top_place = new_cost[i], np.int32(i)
    at = top_place
    for c in range(length - 1, -1, -1):
        out[c] = kept[start[c] + at]
        at = came_from[start[c] + at]
        far[c] = False
        if largest_step >= 0 and c + 1 < length:
            far[c + 1] = abs(out[c + 1] // n_ratios - out[c] // n_ratios) > largest_step


@njit(cache=True, nogil=True)
def hold(  # type: ignore[no-untyped-def]
    by_column,
    column_kept,
    by_signal,
    signal_kept,
    first,
    best,
    needed,
    share,
    n_ratios,
    largest_step,
    cell,
    last,
    out,
):
    """Settings of successive lines: the last one as long as it is good enough.

    Parameters
    ----------
    by_column, column_kept : (G, P)
        Factor of the merit by column group; bits of what a setting keeps.
    by_signal, signal_kept : (K S, P)
        The same by signal, for K kinds of columns.
    first : (G,) int
        Row of the first signal of each group.
    best : (G, S) int
        Freely best setting.
    needed : (G, S) uint8
        Bits that a setting of the cell has to keep.
    share, n_ratios, largest_step
        As of `fewest_changes`; the step is that from line to line.
    cell : (L, G) int
        Number of the signal.
    last : (G,) int
        Setting before the first line, below 0 where there is none; overwritten with that of the last line.
    out : (L, G) int
        Overwritten.
    """
    for line in range(cell.shape[0]):
        for g in range(cell.shape[1]):
            s, p = cell[line, g], last[g]
            aim = best[g, s]
            if p < 0:
                p = aim
            elif p != aim:
                row = first[g] + s
                most = by_column[g, aim] * by_signal[row, aim]
                need = needed[g, s]
                good = (column_kept[g, p] | signal_kept[row, p]) & need == need
                if not (good and by_column[g, p] * by_signal[row, p] >= most * (1.0 - share) > 0.0):
                    p = _towards(p, aim, signal_kept[row], n_ratios, largest_step)
            last[g] = out[line, g] = p


@njit(cache=True, nogil=True)
def _towards(p, aim, kept, n_ratios, largest_step):  # type: ignore[no-untyped-def]
    """The aim, or the step towards it; a well that would overflow allows no step in between."""
    apart = aim // n_ratios - p // n_ratios
    if largest_step < 0 or abs(apart) <= largest_step:
        return aim
    row = p // n_ratios + (largest_step if apart > 0 else -largest_step)
    between = row * n_ratios + aim % n_ratios
    full = not (kept[p] & UNSATURATED and kept[between] & UNSATURATED)
    return aim if full else between
