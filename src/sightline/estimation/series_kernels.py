"""Compiled loops that sum measured differences into normal equations.

Not here: what they are called with (``series.py``).
"""

from __future__ import annotations

import math

import numpy as np

from sightline.compiled import njit

#: Nodes of the local interpolation on the grid. Six (degree 5) keep the error of a sinusoid below
#: 0.2 % down to 7 nodes per period; four would need 12.
TAPS = 6
#: A measurement whose error is explained by others of its patch to this fraction is redundant.
REDUNDANT = 1e-6


@njit(cache=True, nogil=True)
def share_of_instant(away, window, tdi):  # type: ignore[no-untyped-def]
    """What an instant `away` (s) from the middle counts in a mean over `window` of means over `tdi` (s).

    A trapezium: 1 where it is flat; to be divided by its sum. Instants beyond its ends are none.
    """
    if away <= 0.5 * abs(window - tdi):
        return 1.0
    return (0.5 * (window + tdi) - away) / min(window, tdi)


@njit(cache=True, nogil=True)
def _window_weights(t, window, tdi, start, step, count, support, weights):  # type: ignore[no-untyped-def]
    """Interpolation weights at `t` averaged over `window`, into `weights`; returns the first node.

    What is in the window is itself an average over `tdi` (s): the weight of an instant is a trapezium.
    """
    first = math.floor((t - 0.5 * (window + tdi) - start) / step + 1e-6) - (TAPS // 2 - 1)
    first = max(0, min(first, count - support))
    for k in range(support):
        weights[k] = 0.0
    whole = window + tdi
    points = 1 if whole <= 0.0 else 2 + 2 * math.ceil(whole / step)
    total = 0.0
    if tdi > 0.0:
        points *= 2
        for p in range(points):
            total += share_of_instant(abs(whole * ((p + 0.5) / points - 0.5)), window, tdi)
    for p in range(points):
        offset = whole * ((p + 0.5) / points - 0.5)
        share = 1.0 / points
        if tdi > 0.0:
            share = share_of_instant(abs(offset), window, tdi) / total
        x = (t + offset - start) / step
        nearest = math.floor(x + 0.5)
        if abs(x - nearest) < 1e-6:
            x = nearest
        node = math.floor(x) - (TAPS // 2 - 1)
        node = max(first, min(node, first + support - TAPS))
        for i in range(TAPS):
            w = share
            for j in range(TAPS):
                if j != i:
                    w *= (x - node - j) / (i - j)
            weights[node - first + i] += w
    return first


@njit(cache=True, nogil=True)
def fill_grid_weights(t, window, tdi, start, step, count, first, weights):  # type: ignore[no-untyped-def]
    """Rows of interpolation weights for many instants."""
    for k in range(len(t)):
        first[k] = _window_weights(t[k], window, tdi, start, step, count, weights.shape[1], weights[k])


@njit(cache=True, nogil=True)
def _patch_weight(k0, m, image_a, image_b, var_a, var_b, var_own, lower, kept, weight):  # type: ignore[no-untyped-def]
    """Inverse covariance of the measurements of a patch, less redundant ones; returns (kept, log det)."""
    count, logdet = 0, 0.0
    for k in range(m):
        i = k0 + k
        variance = var_a[i] + var_b[i] + var_own[i]
        rest = variance
        for j in range(count):
            h = k0 + kept[j]
            value = 0.0
            if image_a[i] == image_a[h]:
                value += math.sqrt(var_a[i] * var_a[h])
            if image_b[i] == image_b[h]:
                value += math.sqrt(var_b[i] * var_b[h])
            if image_a[i] == image_b[h]:
                value -= math.sqrt(var_a[i] * var_b[h])
            if image_b[i] == image_a[h]:
                value -= math.sqrt(var_b[i] * var_a[h])
            for s in range(j):
                value -= lower[count, s] * lower[j, s]
            lower[count, j] = value / lower[j, j]
            rest -= lower[count, j] ** 2
        if rest > REDUNDANT * variance:
            lower[count, count] = math.sqrt(rest)
            logdet += math.log(rest)
            kept[count] = k
            count += 1
    # weight = inv(L)' inv(L); the inverse of L is built in place, row by row.
    for i in range(count):
        for j in range(i):
            value = 0.0
            for s in range(j, i):
                value += lower[i, s] * lower[s, j]
            weight[i, j] = -value / lower[i, i]
        for j in range(i):
            lower[i, j] = weight[i, j]
        lower[i, i] = 1.0 / lower[i, i]
    for i in range(count):
        for j in range(i + 1):
            value = 0.0
            for s in range(i, count):
                value += lower[s, i] * lower[s, j]
            weight[i, j] = value
            weight[j, i] = value
    return count, logdet


@njit(cache=True, nogil=True)
def accumulate(  # type: ignore[no-untyped-def]
    starts, t_a, t_b, window, tdi_a, tdi_b, y, image_a, image_b, var_a, var_b, var_own, start, step, support,
    band, rhs, border, corner, rhs_border,
):  # fmt: skip
    """Sum the rows of all patches into the normal equations; returns (y'R^-1 y, log det R, rows kept)."""
    count = band.shape[1]
    patches = len(starts) - 1
    largest = 1
    for g in range(patches):
        largest = max(largest, starts[g + 1] - starts[g])
    columns = border.shape[1]
    first, rows = np.zeros(2 * largest, np.int64), np.zeros((2 * largest, support))  # of both instants
    lower, weight = np.zeros((largest, largest)), np.zeros((largest, largest))
    kept = np.zeros(largest, np.int64)
    misfit, logdet, used = 0.0, 0.0, 0
    for g in range(patches):
        k0, m = starts[g], starts[g + 1] - starts[g]
        independent, log_patch = _patch_weight(
            k0, m, image_a, image_b, var_a, var_b, var_own, lower, kept, weight
        )
        used += independent
        logdet += log_patch
        for k in range(independent):
            i = k0 + kept[k]
            for p in range(2):
                t, tdi = (t_a[i], tdi_a[i]) if p == 0 else (t_b[i], tdi_b[i])
                at = 2 * k + p
                first[at] = _window_weights(t, window[i], tdi, start, step, count, support, rows[at])
        for k in range(independent):
            i = k0 + kept[k]
            for h in range(independent):
                j = k0 + kept[h]
                w = weight[k, h]
                misfit += w * y[i] * y[j]
                if columns:
                    rhs_border[image_b[i]] += w * y[j]
                    rhs_border[image_a[i]] -= w * y[j]
                    corner[image_b[i], image_b[j]] += w
                    corner[image_b[i], image_a[j]] -= w
                    corner[image_a[i], image_b[j]] -= w
                    corner[image_a[i], image_a[j]] += w
                for p in range(2):
                    for u in range(support):
                        value = w * rows[2 * k + p, u] * (2 * p - 1)
                        if value == 0.0:
                            continue
                        gu = first[2 * k + p] + u
                        rhs[gu] += value * y[j]
                        if columns:
                            border[gu, image_b[j]] += value
                            border[gu, image_a[j]] -= value
                        for q in range(2):
                            gq = first[2 * h + q]
                            for v in range(min(support, gu - gq + 1)):
                                band[gu - gq - v, gq + v] += value * rows[2 * h + q, v] * (2 * q - 1)
    return misfit, logdet, used
