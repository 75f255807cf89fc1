"""Compiled loops of the search for layouts: all choices gone through, or single ones improved.

A layout's information at one frequency is ``gain (power - |S|^2 / W)``: S is the sum of the phasors of its
places (rows of `re` and `im`, one column per frequency) times `weights` (a row per detector: what it sees of
the motion, by its weight), W that of the weights, `power` that of weights by squares of what is seen. Its
worth is the least over the frequencies, given up as soon as it falls below what is wanted.

Not here: what they are called with (``search.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit


@njit(cache=True, nogil=True)
def enumerate_layouts(re, im, gain, power, weights, total, allowed, bins, firsts, mirrored, kept):  # type: ignore[no-untyped-def]
    """Go through all layouts whose first place is below `firsts`; keep the best, and those of each span."""
    places, count = re.shape
    n = len(weights)
    sums_re, sums_im = np.zeros((n, count), np.float32), np.zeros((n, count), np.float32)
    at = np.zeros(n, np.int64)
    pool, values = np.zeros((kept, n), np.int64), np.full(kept, -np.inf)
    by_span, by_span_places = np.full(places, -np.inf), np.zeros((places, n), np.int64)
    held, threshold, killer, tried = 0, -np.inf, 0, 0
    level = 0
    while level >= 0:
        if at[level] >= (firsts if level == 0 else places):
            level -= 1
            if level >= 0:
                at[level] += 1
            continue
        p = at[level]
        for f in range(count):
            sums_re[level, f] = weights[level, f] * re[p, f]
            sums_im[level, f] = weights[level, f] * im[p, f]
            if level > 0:
                sums_re[level, f] += sums_re[level - 1, f]
                sums_im[level, f] += sums_im[level - 1, f]
        if level < n - 2:
            level += 1
            at[level] = allowed[p]
            continue
        start = allowed[p]
        if mirrored and n > 2:  # of two mirrored layouts, the one whose last gap is the wider
            start = max(start, p + at[1] - at[0])
        last = weights[n - 1]
        for k in range(start, places):
            tried += 1
            span = int(round(bins[k] - bins[at[0]]))
            least = min(threshold, by_span[span])
            worst = np.inf
            for q in range(-1, count):
                f = killer if q < 0 else q
                a = sums_re[n - 2, f] + last[f] * re[k, f]
                b = sums_im[n - 2, f] + last[f] * im[k, f]
                value = gain[f] * (power[f] - (a * a + b * b) / total)
                if value < worst:
                    worst = value
                    if value <= least:
                        killer = f
                        break
            if worst <= least:
                continue
            at[n - 1] = k
            if worst > by_span[span]:
                by_span[span] = worst
                by_span_places[span] = at
            if worst > threshold:
                # to its place among the best: a sort takes longer to compile than all else here
                place = min(held, kept - 1)
                while place > 0 and values[place - 1] < worst:
                    values[place] = values[place - 1]
                    pool[place] = pool[place - 1]
                    place -= 1
                values[place] = worst
                pool[place] = at
                held = min(held + 1, kept)
                threshold = values[kept - 1]
        at[level] += 1
    return pool[:held], values[:held], by_span, by_span_places, tried


@njit(cache=True, nogil=True)
def _least(re, im, gain, power, weight, sum_re, sum_im, total, k, enough):  # type: ignore[no-untyped-def]
    """Least information of a partial sum and one detector more at place k; given up once below `enough`."""
    worst = np.inf
    for f in range(len(gain)):
        a = sum_re[f] + weight[f] * re[k, f]
        b = sum_im[f] + weight[f] * im[k, f]
        value = gain[f] * (power[f] - (a * a + b * b) / total)
        if value < worst:
            worst = value
            if worst <= enough:
                break
    return worst


@njit(cache=True, nogil=True)
def _rest(re, im, weights, at, one, two, sum_re, sum_im, allowed, open_places):  # type: ignore[no-untyped-def]
    """Sum over all detectors but `one` and `two`, and the places that these leave open."""
    sum_re[:] = 0.0
    sum_im[:] = 0.0
    open_places[:] = True
    for d in range(len(at)):
        if d == one or d == two:
            continue
        for f in range(re.shape[1]):
            sum_re[f] += weights[d, f] * re[at[d], f]
            sum_im[f] += weights[d, f] * im[at[d], f]
        for k in range(len(allowed)):
            if k < allowed[at[d]] and at[d] < allowed[k]:
                open_places[k] = False


@njit(cache=True, nogil=True)
def exchange(re, im, gain, power, weights, total, allowed, start, free, pairs, alike):  # type: ignore[no-untyped-def]
    """Move detectors from number `free` on to their best places, one or two at once, until none gains."""
    places, count = re.shape
    n = len(weights)
    at = start.copy()
    sum_re, sum_im = np.zeros(count, np.float32), np.zeros(count, np.float32)
    two_re, two_im = np.zeros(count, np.float32), np.zeros(count, np.float32)
    open_places = np.ones(places, np.bool_)
    first = np.int64(0)  # of a type, not a literal: what it is given to would be compiled for either
    _rest(re, im, weights, at, first, first, sum_re, sum_im, allowed, open_places)
    best = _least(re, im, gain, power, weights[0], sum_re, sum_im, total, at[0], -np.inf)
    tried, moved = 0, True
    while moved:
        moved = False
        for one in range(free, n):
            _rest(re, im, weights, at, one, one, sum_re, sum_im, allowed, open_places)
            for k in range(places):
                if open_places[k]:
                    tried += 1
                    value = _least(re, im, gain, power, weights[one], sum_re, sum_im, total, k, best)
                    if value > best:
                        best, moved = value, True
                        at[one] = k
        if moved or not pairs:
            continue
        for one in range(free, n):
            for two in range(one + 1, n):
                _rest(re, im, weights, at, one, two, sum_re, sum_im, allowed, open_places)
                for k in range(places):
                    if not open_places[k]:
                        continue
                    for f in range(count):
                        two_re[f] = sum_re[f] + weights[one, f] * re[k, f]
                        two_im[f] = sum_im[f] + weights[one, f] * im[k, f]
                    for m in range(allowed[k] if alike else 0, places):
                        if not open_places[m] or (m < allowed[k] and k < allowed[m]):
                            continue
                        tried += 1
                        value = _least(re, im, gain, power, weights[two], two_re, two_im, total, m, best)
                        if value > best:
                            best, moved = value, True
                            at[one], at[two] = k, m
    return at, best, tried
