"""Compiled loops of the table: words of signals, and how many bytes each group of columns costs.

Not here: what is in a table (``table.py``), how it is built (``table_build.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.tdi.kernels import TIE, largest

#: Columns worked on at once, so that signals and words stay in the first cache.
STRETCH = 4096
#: Ends of stretches that share their rivals; even.
BLOCK = 16
#: What decides a stretch of signals: all columns feasible, none, some.
FEASIBLE, INFEASIBLE, MIXED = range(3)
#: Which limits hold: all; the bounds of SNR given up; those of MTF; the main lobe; the wells; or no setting
#: is worth anything.
ALL, NO_SNR, NO_MTF, NO_LOBE, NO_WELL, WORTHLESS = range(6)


@njit(cache=True, nogil=True)
def words_by_passes(signals, edges, starts, thresholds, words, out):  # type: ignore[no-untyped-def]
    """Words of signals, one pass over a group of columns for each of its cells: fast where cells are few.

    Parameters
    ----------
    signals : (lines, columns)
    edges : (G + 1,) int
        First column of each group among those of `signals`.
    starts : (G + 1,) int
        First cell of each group.
    thresholds : (cells,), dtype of signals
        Least signal of each cell, rising within a group; the first of a group takes all below.
    words : (cells,) uint16
    out : (lines, columns) uint16
        Overwritten.
    """
    for line in range(signals.shape[0]):
        for group in range(edges.shape[0] - 1):
            for begin in range(edges[group], edges[group + 1], STRETCH):
                end = min(begin + STRETCH, edges[group + 1])
                signal, word = signals[line, begin:end], out[line, begin:end]
                word[:] = words[starts[group]]
                for cell in range(starts[group] + 1, starts[group + 1]):
                    least, this = thresholds[cell], words[cell]
                    for c in range(end - begin):
                        # not a number is not at or above anything: it stays in the lowest cell
                        word[c] = this if signal[c] >= least else word[c]


@njit(cache=True, nogil=True)
def words_by_signal(signals, edges, starts, last, shift, spread, out):  # type: ignore[no-untyped-def]
    """Words of signals from a list with one word per quantised signal: for groups of many cells.

    Parameters
    ----------
    signals, edges, out
        As of `words_by_passes`.
    starts : (G + 1,) int
        Where each group begins in `spread`.
    last : (G,) int
        Signal from which on a group's last word holds.
    shift : int
        Bits that quantisation drops.
    spread : (n,) uint16
    """
    # group by group: its part of the list stays in the first cache over all lines
    for group in range(edges.shape[0] - 1):
        most, here = last[group], spread[starts[group] : starts[group + 1]]
        for line in range(signals.shape[0]):
            signal = signals[line, edges[group] : edges[group + 1]]
            word = out[line, edges[group] : edges[group + 1]]
            for c in range(signal.shape[0]):
                code = np.int64(min(signal[c], most)) >> shift if signal[c] > 0 else 0
                word[c] = here[np.uintp(code)]


@njit(cache=True, nogil=True)
def largest_products(a, b, out):  # type: ignore[no-untyped-def]
    """Largest product of every row of a (m, P) with every row of b (n, P), into out (m, n)."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            out[i, j] = largest(a[i], b[j])


@njit(cache=True, nogil=True)
def worth(tier, column_level, column_merit, signal_level, signal_merit, p, least_full):  # type: ignore[no-untyped-def]
    """Merit of setting p under the limits of a tier; 0 where it breaks one of them."""
    if tier == WORTHLESS:
        return 1.0
    if tier == NO_WELL:
        return 1.0 if p == least_full else 0.0
    if column_level[p] < 3 - max(tier - NO_SNR, 0) or signal_level[p] < (2 if tier == ALL else 1):
        return 0.0
    return column_merit[p] * signal_merit[p]


@njit(cache=True, nogil=True)
def rivals_of(by_column, least, most, keep, rivals, merits):  # type: ignore[no-untyped-def]
    """Settings that somewhere in a block of signals may come within `keep` of the best of a column.

    Parameters
    ----------
    by_column : (P,)
    least, most : (P,)
        Bounds of what the block's signals give.
    keep : float
    rivals : (P,) int
        Overwritten from its start.
    merits : (P,)
        The same, with factors of the column.

    Returns
    -------
    int
        How many; -1 where no setting is allowed in all of the block, so that any may be good.
    """
    sure = largest(by_column, least)
    if sure <= 0.0:
        return -1
    need, count = keep * (1.0 - TIE) * sure, 0
    for p in range(by_column.shape[0]):
        rivals[count], merits[count] = p, by_column[p]
        count += by_column[p] * most[p] >= need
    return count


@njit(cache=True, nogil=True)
def bounds_of_blocks(by_signal, least, most):  # type: ignore[no-untyped-def]
    """Bounds of (E, P) over blocks of `BLOCK` rows, into (E / BLOCK, P)."""
    for block in range(least.shape[0]):
        begin = block * BLOCK
        least[block], most[block] = by_signal[begin], by_signal[begin]
        for e in range(begin + 1, min(begin + BLOCK, by_signal.shape[0])):
            for p in range(by_signal.shape[1]):
                least[block, p] = min(least[block, p], by_signal[e, p])
                most[block, p] = max(most[block, p], by_signal[e, p])


@njit(cache=True, nogil=True)
def best_merits(  # type: ignore[no-untyped-def]
    by_column, column_level, column_merit, by_signal, least, most_of, signal_level, signal_merit, ends, best,
    tiers,
):  # fmt: skip
    """Best merit of columns at signals, and the limits it keeps.

    Parameters
    ----------
    by_column, by_signal : (n, P), (E, P)
        Factors of the merit, 0 where a setting is not allowed.
    least, most_of : (E / BLOCK, P)
        Bounds of `by_signal` over blocks.
    column_level : (n, P) uint8
        3 within the bounds of MTF and the main lobe, 2 within the main lobe, else 1.
    signal_level : (E, P) uint8
        2 below the wells and above the least SNR, 1 below the wells, else 0.
    column_merit, signal_merit : (n, P), (E, P)
        Factors without limits.
    ends : (E,)
        The signals; of two equal neighbours one is worked out.
    best, tiers : (n, E)
        Overwritten.
    """
    rivals = np.empty(by_column.shape[1], dtype=np.int64)
    merits = np.empty(by_column.shape[1])
    for c in range(by_column.shape[0]):
        count = -1
        for e in range(by_signal.shape[0]):
            if e % BLOCK == 0:
                count = rivals_of(by_column[c], least[e // BLOCK], most_of[e // BLOCK], 1.0, rivals, merits)
            if e > 0 and ends[e] == ends[e - 1]:
                best[c, e], tiers[c, e] = best[c, e - 1], tiers[c, e - 1]
                continue
            if not signal_level[e].any():
                best[c, e], tiers[c, e] = 1.0, NO_WELL
                continue
            most, tier = 0.0, ALL
            for k in range(count):
                most = max(most, merits[k] * by_signal[e, rivals[k]])
            if count < 0:
                most = largest(by_column[c], by_signal[e])
            while most <= 0.0 and tier < NO_LOBE:
                tier += 1
                for p in range(by_column.shape[1]):
                    merit = worth(
                        tier, column_level[c], column_merit[c], signal_level[e], signal_merit[e], p, 0
                    )
                    most = max(most, merit)
            if most <= 0.0:
                most, tier = 1.0, WORTHLESS
            best[c, e], tiers[c, e] = most, tier


@njit(cache=True, nogil=True)
def good_settings(  # type: ignore[no-untyped-def]
    by_column, column_level, column_merit, by_signal, least, most_of, signal_level, signal_merit, least_full,
    best, tiers, keep, strict, loose, kind,
):  # fmt: skip
    """Settings that lose little at both ends of each stretch of signals, as bits.

    Parameters
    ----------
    by_column, column_level, column_merit, least, most_of
        As of `best_merits`.
    by_signal, signal_level, signal_merit : (2 T, P)
        The same at the lower and upper end of each stretch, but 0 where a well overflows anywhere within it.
    least_full : (2 T,) int
        Setting that fills the wells least.
    best, tiers : (n, 2 T)
    keep : float
        Share of the best merit that is enough.
    strict : (n, T, W) uint64
        Bits of settings that keep it at both ends, where limits can be kept and where not. Overwritten.
    loose : as strict
        The same, but where limits cannot be kept any setting that keeps those it can.
    kind : (n, T) uint8
        Feasible, infeasible or mixed. Overwritten.
    """
    count = column_level.shape[1]
    rivals, merits = np.empty(count, dtype=np.int64), np.empty(count)
    for c in range(column_level.shape[0]):
        rival_count = -1
        for t in range(kind.shape[1]):
            low, high = 2 * t, 2 * t + 1
            if low % BLOCK == 0:
                block = low // BLOCK
                rival_count = rivals_of(by_column[c], least[block], most_of[block], keep, rivals, merits)
                if rival_count < 0:
                    rival_count = count
                    for p in range(count):
                        rivals[p], merits[p] = p, by_column[c, p]
            low_free = tiers[c, low] == ALL or tiers[c, low] == WORTHLESS
            high_free = tiers[c, high] == ALL or tiers[c, high] == WORTHLESS
            kind[c, t] = (
                FEASIBLE if low_free and high_free else MIXED if low_free or high_free else INFEASIBLE
            )
            strict[c, t], loose[c, t] = np.uint64(0), np.uint64(0)
            need_low = keep * (1.0 - TIE) * best[c, low]
            need_high = keep * (1.0 - TIE) * best[c, high]
            if tiers[c, low] == ALL and tiers[c, high] == ALL:
                for k in range(rival_count):
                    p = rivals[k]
                    at_low = merits[k] * by_signal[low, p]
                    if at_low >= need_low and merits[k] * by_signal[high, p] >= need_high:
                        strict[c, t, p >> 6] |= np.uint64(1) << np.uint64(p & 63)
                if strict[c, t].any():
                    loose[c, t] = strict[c, t]
                    continue
            most, favourite = -1.0, 0
            overflows = tiers[c, low] == NO_WELL and tiers[c, high] == NO_WELL
            for p in range(count):
                # where all overflow nothing but the least full is worth anything
                if overflows and p != least_full[low] and p != least_full[high]:
                    continue
                share_low = worth(
                    tiers[c, low], column_level[c], column_merit[c], signal_level[low], signal_merit[low], p,
                    least_full[low],
                ) / best[c, low]  # fmt: skip
                share_high = worth(
                    tiers[c, high], column_level[c], column_merit[c], signal_level[high], signal_merit[high],
                    p, least_full[high],
                ) / best[c, high]  # fmt: skip
                bit = np.uint64(1) << np.uint64(p & 63)
                good_low, good_high = (
                    share_low * best[c, low] >= need_low,
                    share_high * best[c, high] >= need_high,
                )
                kept = share_low > 0.0 and share_high > 0.0
                if (good_low and good_high) or (kind[c, t] == MIXED and kept and (good_low or good_high)):
                    strict[c, t, p >> 6] |= bit
                if kept and kind[c, t] == INFEASIBLE:
                    loose[c, t, p >> 6] |= bit
                share = min(share_low, share_high) if kept else 0.1 * max(share_low, share_high)
                if share > most * (1.0 + TIE):
                    most, favourite = share, p
            if not strict[c, t].any():
                strict[c, t, favourite >> 6] = np.uint64(1) << np.uint64(favourite & 63)
            loose[c, t] |= strict[c, t]


@njit(cache=True, nogil=True)
def split_signals(strict, loose, kind, ends, mixed_span, starts):  # type: ignore[no-untyped-def]
    """Cut the stretches of signals of one group of columns into as few cells as can be.

    Parameters
    ----------
    strict, loose : (T, W) uint64
        Settings that all columns of the group can share.
    kind : (T,) uint8
    ends : (2 T,)
        Lower and upper end of each stretch, electrons.
    mixed_span : float
        Ratio of signals up to which columns with and without a feasible setting may share a cell.
    starts : (T,) int
        Overwritten with the first stretch of each cell.

    Returns
    -------
    int
        How many cells; 0 where the columns cannot share.
    """
    width = strict.shape[1]
    run = np.zeros(width, dtype=np.uint64)
    cells, mixed_from = 0, -1
    for e in range(strict.shape[0]):
        settings = loose[e] if kind[e] == MIXED else strict[e]
        if not settings.any():
            return 0
        if kind[e] != MIXED:
            mixed_from = -1
        elif mixed_from < 0:
            mixed_from = e
        elif ends[2 * e + 1] > mixed_span * ends[2 * mixed_from]:
            return 0
        joined = False
        if e > 0 and kind[e] == kind[e - 1]:
            for w in range(width):
                if run[w] & settings[w]:
                    joined = True
        if joined:
            for w in range(width):
                run[w] &= settings[w]
        else:
            run[:] = settings
            starts[cells] = e
            cells += 1
    return cells


@njit(cache=True, nogil=True, inline="always")
def add_to_group(strict, loose, kind, more_strict, more_loose, more_kind):  # type: ignore[no-untyped-def]
    """Leave the settings that one more block of columns can share too."""
    for e in range(strict.shape[0]):
        if kind[e] != more_kind[e]:
            kind[e] = MIXED
        for w in range(strict.shape[1]):
            strict[e, w] &= more_strict[e, w]
            loose[e, w] &= more_loose[e, w]


@njit(cache=True, nogil=True)
def cheapest_groups(strict, loose, kind, ends, mixed_span, group_bytes, cell_bytes, origin):  # type: ignore[no-untyped-def]
    """Group blocks of columns so that the table is smallest.

    Parameters
    ----------
    strict, loose, kind : (n, T, ...)
        Of each block.
    ends, mixed_span
        As of `split_signals`.
    group_bytes, cell_bytes : int
    origin : (n + 1,) int
        Overwritten: the group that ends before block k begins at block origin[k].
    """
    count = strict.shape[0]
    cost = np.full(count + 1, np.inf)
    cost[0] = 0.0
    starts = np.empty(strict.shape[1], dtype=np.int64)
    for a in range(count):
        shared, shared_loose, kinds = strict[a].copy(), loose[a].copy(), kind[a].copy()
        for b in range(a, count):
            if b > a:
                add_to_group(shared, shared_loose, kinds, strict[b], loose[b], kind[b])
            cells = split_signals(shared, shared_loose, kinds, ends, mixed_span if b > a else np.inf, starts)
            if cells == 0:
                break
            total = cost[a] + group_bytes + cell_bytes * cells
            if total < cost[b + 1]:
                cost[b + 1], origin[b + 1] = total, a


@njit(cache=True, nogil=True)
def worst_shares(  # type: ignore[no-untyped-def]
    columns, first, last, candidates, kind, column_level, column_merit, signal_level, signal_merit,
    least_full, best, tiers, shares,
):  # fmt: skip
    """Worst share of the best merit that each candidate has over columns of a cell.

    Parameters
    ----------
    columns : (m,) int
        Rows of columns of the cell, of one kind.
    first, last : int
        First stretch of signals, and the one after the last.
    candidates : (k,) int
    kind : int
        Of the cell: in a mixed one only feasible points are judged.
    shares : (k,)
        Lowered to what is found.
    others
        As of `good_settings`.
    """
    for k in range(candidates.shape[0]):
        p, share = candidates[k], shares[k]
        for c in columns:
            for e in range(2 * first, 2 * last):
                tier = tiers[c, e]
                if kind == MIXED and tier != ALL:
                    continue
                merit = worth(
                    tier, column_level[c], column_merit[c], signal_level[e], signal_merit[e], p, least_full[e]
                )
                share = min(share, merit / best[c, e])
        shares[k] = share


@njit(cache=True, nogil=True)
def first_largest(shares):  # type: ignore[no-untyped-def]
    """Number of the (nearly) largest share; the first of equals."""
    most, chosen = -1.0, 0
    for k in range(shares.shape[0]):
        if shares[k] > most * (1.0 + TIE):
            most, chosen = shares[k], k
    return chosen
