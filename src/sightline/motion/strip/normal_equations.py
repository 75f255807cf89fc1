"""Normal equations of the joint estimate: attitude on one time grid, static parameters, relief.

Every match contributes two rows that hold the attitude at its own two times (local Lagrange
weights on the grid, averaged over the window's length), the static parameters, and, where the
ground is not known, a relief process (mean height and cross-track slope of the row). The rows of
one patch share the hub's error. The sum is a band with a narrow border.

Not here: the rows' content (``motion/measure/observations.py``), prior and solution (``joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.estimation.banded import products
from sightline.estimation.banded_blocks import StoredBand
from sightline.estimation.series_kernels import share_of_instant
from sightline.execution import available_processors, give_back_memory, in_threads, slices
from sightline.motion.measure.observations import Star
from sightline.motion.measure.windows import stretches
from sightline.motion.strip.slow_errors import SlowErrors
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]

#: Nodes of the local interpolation (cubic Lagrange).
TAPS = 4
#: Patches, and rows of windows, that are summed by one thread at a time; rows where errors that wander are
#: unknowns, of which those near by are all that a part has.
PART_PATCHES, PART_ROWS, SLOW_ROWS = 16384, 512, 64
#: Instants that are interpolated at a time.
_INSTANTS = 16384
#: Bytes of the band of a part, unless lags alone ask for more, and of those that are summed at a time, one
#: part at least.
PART_BYTES, AT_ONCE_BYTES = 16_000_000, 64_000_000


@dataclass(frozen=True)
class TimeGrid:
    """Evenly spaced nodes of the unknown motion: ``t = start + step * k``, k = 0 .. count - 1 (s)."""

    start: float
    step: float
    count: int

    @property
    def nodes(self) -> Array:
        """(count,) s."""
        return np.asarray(self.start + self.step * np.arange(self.count), dtype=np.float64)

    def coarser(self, factor: float) -> TimeGrid:
        """A grid over the same time with nodes `factor` times as far apart."""
        return TimeGrid(self.start, factor * self.step, math.ceil((self.count - 1) / factor) + 1)

    def weights(self, t: Array) -> tuple[NDArray[np.intp], Array]:
        """First node (N,) and cubic Lagrange weights (N, 4) of the instants `t` (N,)."""
        x = (np.asarray(t) - self.start) / self.step
        first = np.clip(np.floor(x).astype(np.intp) - 1, 0, self.count - TAPS)
        u = x - first
        w = np.empty((len(x), TAPS))
        w[:, 0] = -(u - 1) * (u - 2) * (u - 3) / 6
        w[:, 1] = u * (u - 2) * (u - 3) / 2
        w[:, 2] = -u * (u - 1) * (u - 3) / 2
        w[:, 3] = u * (u - 1) * (u - 2) / 6
        return first, w

    def interpolate(self, values: Array, t: Array) -> Array:
        """Node values (count, ...) at the instants `t` (N,)."""
        out = scratch_array((len(t), *values.shape[1:]))
        for some in slices(len(t), _INSTANTS):
            first, w = self.weights(t[some])
            gathered = values[first[:, None] + np.arange(TAPS)]
            out[some] = np.einsum("nk,nk...->n...", w, gathered)
            let_go()
        return out

    def spread(self, values: Array, t: Array) -> Array:
        """Transpose of `interpolate`: values (N, C) at the instants `t` summed onto the nodes (count, C)."""
        first, w = self.weights(t)
        out = np.zeros((self.count, values.shape[1]))
        for k in range(TAPS):
            np.add.at(out, first + k, w[:, k : k + 1] * values)
        return out


@njit(cache=True, nogil=True)
def _window_weights(t, duration, tdi, start, step, count, support, weights):  # type: ignore[no-untyped-def]
    """Lagrange weights averaged over a window of `duration` about `t`; returns the first node.

    Each line of the window is an average over `tdi` (s): the weight of an instant is a trapezium.
    """
    half = 0.5 * (duration + tdi)
    first = int(math.floor((t - half - start) / step)) - 1
    if first < 0:
        first = 0
    if first > count - support:
        first = count - support
    for k in range(support):
        weights[k] = 0.0
    whole = duration + tdi
    points = 2 + int(math.ceil((2.0 if tdi > 0.0 else 1.0) * whole / step)) if whole > 0.0 else 1
    total = float(points)
    if tdi > 0.0:
        total = 0.0
        for p in range(points):
            total += share_of_instant(abs(whole * ((p + 0.5) / points - 0.5)), duration, tdi)
    for p in range(points):
        offset = whole * ((p + 0.5) / points - 0.5)
        # without stages all count alike
        share, over = 1.0, total
        if tdi > 0.0:
            share, over = share_of_instant(abs(offset), duration, tdi) / total, 1.0
        x = (t + offset - start) / step
        node = min(max(int(math.floor(x)) - 1, first), first + support - 4)
        u = x - node
        o = node - first
        weights[o] += -(u - 1) * (u - 2) * (u - 3) / 6 * share / over
        weights[o + 1] += u * (u - 2) * (u - 3) / 2 * share / over
        weights[o + 2] += -u * (u - 1) * (u - 3) / 2 * share / over
        weights[o + 3] += u * (u - 1) * (u - 2) / 6 * share / over
    return first


@njit(cache=True, nogil=True)
def _scatter(local, index, used, n_local, block_n, ab, border, corner, rhs_grid, rhs_static):  # type: ignore[no-untyped-def]
    """Add one local normal matrix (last column: right side) to band, border and corner; clear it."""
    for i in range(n_local):
        if not used[i]:
            continue
        gi = index[i]
        value = local[i, n_local]
        if gi < block_n:
            rhs_grid[gi] += value
        else:
            rhs_static[gi - block_n] += value
        local[i, n_local] = 0.0
        for j in range(i, n_local):
            value = local[i, j]
            if value == 0.0:
                continue
            local[i, j] = 0.0
            gj = index[j]
            if gi >= block_n and gj >= block_n:
                corner[gi - block_n, gj - block_n] += value
                if i != j:
                    corner[gj - block_n, gi - block_n] += value
            elif gj >= block_n:
                border[gi, gj - block_n] += value
            elif gi >= block_n:
                border[gj, gi - block_n] += value
            else:
                low, high = (gi, gj) if gi < gj else (gj, gi)
                if gi == gj and i != j:
                    value = 2.0 * value
                ab[high - low, low] += value


@njit(cache=True, nogil=True)
def _expand(product, w, compact, statics, instants, support, n_local, local):  # type: ignore[no-untyped-def]
    """Spread one patch's compact product over the nodes its instants are interpolated from.

    Unknown p of the patch has the places ``p * support ..`` of `local`, one per node.
    """
    moving = compact - statics
    for p in range(moving):
        group_p = min(p // 3, instants)
        top = p * support
        for q in range(p, moving):
            value = product[p, q]
            if value == 0.0:
                continue
            group_q = min(q // 3, instants)
            left = q * support
            for m in range(support):
                share = value * w[group_p, m]
                for n in range(m if p == q else 0, support):
                    local[top + m, left + n] += share * w[group_q, n]
        for m in range(support):
            share = w[group_p, m]
            for s in range(statics + 1):
                local[top + m, n_local - statics + s] += share * product[p, moving + s]
    for s in range(statics):
        for r in range(s, statics + 1):
            local[n_local - statics + s, n_local - statics + r] += product[moving + s, moving + r]


@njit(cache=True, nogil=True)
def _add_uneven(uneven, at, t, first, start, step, support, out):  # type: ignore[no-untyped-def]
    """Add weights (3, B) at instants `at` beside `t` to `out` (3, support) of the nodes from `first` on."""
    for b in range(len(at)):
        x = (t + at[b] - start) / step
        node = min(max(int(math.floor(x)) - 1, first), first + support - 4)
        u = x - node
        o = node - first
        w0 = -(u - 1) * (u - 2) * (u - 3) / 6
        w1 = u * (u - 2) * (u - 3) / 2
        w2 = -u * (u - 1) * (u - 3) / 2
        w3 = u * (u - 1) * (u - 2) / 6
        for axis in range(3):
            value = uneven[axis, b]
            out[axis, o] += w0 * value
            out[axis, o + 1] += w1 * value
            out[axis, o + 2] += w2 * value
            out[axis, o + 3] += w3 * value


@njit(cache=True, nogil=True)
def _accumulate(  # type: ignore[no-untyped-def]
    t_hub,
    t,
    t_ground,
    duration,
    along,
    tdi_hub,
    tdi,
    support,
    residual,
    covariance,
    weight,
    by_hub,
    by_partner,
    by_static,
    by_height,
    field,
    correlation,
    uneven,
    uneven_at,
    relief,
    start,
    step,
    count,
    node,
    ab,
    border,
    corner,
    rhs_grid,
    rhs_static,
):
    """Sum the normal equations of patches onto the nodes from `node` on; returns (chi-square, rows)."""
    patches, pairs = t.shape
    statics = by_static.shape[3]
    block = 5 if relief else 3
    block_n = ab.shape[1]
    # where what is measured along lines averages over another time, each instant counts twice
    parts = 1 if along == duration else 2
    instants = parts * (1 + pairs)
    n_local = (3 * instants + (2 if relief else 0)) * support + statics
    rows_max = 2 * pairs
    local = np.zeros((n_local, n_local + 1))
    index = np.zeros(n_local, np.int64)
    used = np.zeros(n_local, np.int64)
    first, previous = np.zeros(1 + instants, np.int64), np.zeros(1 + instants, np.int64)
    first[:] = -1
    previous[:] = -1
    # one column per angle of each instant, height and its tilt, statics, the data: weights in time come later
    compact = 3 * instants + (2 if relief else 0) + statics
    heights = 3 * instants
    w = np.zeros((1 + instants, support))
    product = np.zeros((compact, compact + 1))
    a = np.zeros((rows_max, compact + 1))
    r = np.zeros((rows_max, rows_max))
    # where stages count unevenly each row has weights in time of its own; where there are no stages `uneven`
    # is None, and what is for them is not compiled
    if uneven is not None and len(uneven_at) > 0:
        wide = np.zeros((rows_max, n_local + 1))
        added = np.zeros((3, support))
    chi2, rows_total = 0.0, 0
    for s in range(statics):
        index[n_local - statics + s] = block_n + s
        used[n_local - statics + s] = 1
    for g in range(patches):
        rows = 0
        for k in range(pairs):
            if weight[g, k] > 0.0 and residual[g, k, 0] == residual[g, k, 0]:
                rows += 2
        if rows == 0:
            continue
        for c in range(parts):
            spans = along if parts == 2 and c == 0 else duration
            first[c] = _window_weights(t_hub[g], spans, tdi_hub[g], start, step, count, support, w[c])
        for k in range(parts, instants):
            first[k] = -2
        if relief:
            first[instants] = _window_weights(
                t_ground[g], duration, 0.0, start, step, count, support, w[instants]
            )
        # rows of this patch
        row = 0
        for k in range(pairs):
            if not (weight[g, k] > 0.0 and residual[g, k, 0] == residual[g, k, 0]):
                continue
            for c in range(parts):
                spans, q = along if parts == 2 and c == 0 else duration, parts * (1 + k) + c
                first[q] = _window_weights(t[g, k], spans, tdi[g, k], start, step, count, support, w[q])
            for c in range(2):
                for j in range(compact + 1):
                    a[row + c, j] = 0.0
                part = c if parts == 2 else 0
                for axis in range(3):
                    a[row + c, 3 * part + axis] = by_hub[g, k, c, axis]
                    a[row + c, 3 * (parts * (1 + k) + part) + axis] = by_partner[g, k, c, axis]
                if relief:
                    a[row + c, heights] = by_height[g, k, c]
                    a[row + c, heights + 1] = by_height[g, k, c] * field[g]
                for s in range(statics):
                    a[row + c, compact - statics + s] = by_static[g, k, c, s]
                a[row + c, compact] = residual[g, k, c]
            if uneven is not None and len(uneven_at) > 0:
                for c in range(2):
                    for j in range(n_local + 1):
                        wide[row + c, j] = 0.0
                    for side in range(2):
                        q = (0 if side == 0 else parts * (1 + k)) + (c if parts == 2 else 0)
                        added[:] = 0.0
                        at = t_hub[g] if side == 0 else t[g, k]
                        _add_uneven(
                            uneven[g, k, side, c], uneven_at, at, first[q], start, step, support, added
                        )
                        for axis in range(3):
                            for m in range(support):
                                wide[row + c, (3 * q + axis) * support + m] = added[axis, m]
            row += 2
        # error covariance of the rows: own Cholesky factors around the shared-image correlation
        ri = 0
        for k in range(pairs):
            if first[parts * (1 + k)] == -2:
                continue
            k11 = math.sqrt(covariance[g, k, 0, 0] / weight[g, k])
            k21 = covariance[g, k, 1, 0] / weight[g, k] / k11
            k22 = math.sqrt(max(covariance[g, k, 1, 1] / weight[g, k] - k21 * k21, 1e-30))
            rj = 0
            for q in range(k + 1):
                if first[parts * (1 + q)] == -2:
                    continue
                q11 = math.sqrt(covariance[g, q, 0, 0] / weight[g, q])
                q21 = covariance[g, q, 1, 0] / weight[g, q] / q11
                q22 = math.sqrt(max(covariance[g, q, 1, 1] / weight[g, q] - q21 * q21, 1e-30))
                g11 = correlation[2 * k, 2 * q]
                g12 = correlation[2 * k, 2 * q + 1]
                g21 = correlation[2 * k + 1, 2 * q]
                g22 = correlation[2 * k + 1, 2 * q + 1]
                r[ri, rj] = k11 * g11 * q11
                r[ri, rj + 1] = k11 * (g11 * q21 + g12 * q22)
                r[ri + 1, rj] = (k21 * g11 + k22 * g21) * q11
                r[ri + 1, rj + 1] = (k21 * g11 + k22 * g21) * q21 + (k21 * g12 + k22 * g22) * q22
                rj += 2
            ri += 2
        # Cholesky in place, then forward substitution of the rows
        for i in range(rows):
            for j in range(i + 1):
                total = r[i, j]
                for m in range(j):
                    total -= r[i, m] * r[j, m]
                if i == j:
                    r[i, i] = math.sqrt(max(total, 1e-30))
                else:
                    r[i, j] = total / r[j, j]
        for i in range(rows):
            for m in range(i):
                f = r[i, m]
                for j in range(compact + 1):
                    a[i, j] -= f * a[m, j]
                if uneven is not None and len(uneven_at) > 0:
                    for j in range(heights * support):
                        wide[i, j] -= f * wide[m, j]
            inverse = 1.0 / r[i, i]
            for j in range(compact + 1):
                a[i, j] *= inverse
            if uneven is not None and len(uneven_at) > 0:
                for j in range(heights * support):
                    wide[i, j] *= inverse
            chi2 += a[i, compact] * a[i, compact]
        rows_total += rows
        # same nodes as before? else hand over what was summed
        same = True
        for k in range(1 + instants):
            if first[k] != -2 and previous[k] != -2 and first[k] != previous[k]:
                same = False
        if not same:
            _scatter(local, index, used, n_local, block_n, ab, border, corner, rhs_grid, rhs_static)
            for j in range(n_local - statics):
                used[j] = 0
            for k in range(1 + instants):
                previous[k] = first[k]
        for k in range(instants):
            if first[k] == -2:
                continue
            previous[k] = first[k]
            for axis in range(3):
                for m in range(support):
                    j = (3 * k + axis) * support + m
                    index[j] = (first[k] + m - node) * block + axis
                    used[j] = 1
        if relief:
            previous[instants] = first[instants]
            for axis in range(2):
                for m in range(support):
                    j = (heights + axis) * support + m
                    index[j] = (first[instants] + m - node) * block + 3 + axis
                    used[j] = 1
        if uneven is not None and len(uneven_at) > 0:
            for row in range(rows):
                for p in range(compact - statics):
                    group = min(p // 3, instants)
                    for m in range(support):
                        wide[row, p * support + m] += a[row, p] * w[group, m]
                for s in range(statics + 1):
                    wide[row, n_local - statics + s] = a[row, compact - statics + s]
                for i in range(n_local):
                    f = wide[row, i]
                    if f != 0.0:
                        for j in range(i, n_local + 1):
                            local[i, j] += f * wide[row, j]
            continue
        for i in range(compact):
            for j in range(i, compact + 1):
                product[i, j] = 0.0
        for row in range(rows):
            for i in range(compact):
                f = a[row, i]
                if f != 0.0:
                    for j in range(i, compact + 1):
                        product[i, j] += f * a[row, j]
        _expand(product, w, compact, statics, instants, support, n_local, local)
    _scatter(local, index, used, n_local, block_n, ab, border, corner, rhs_grid, rhs_static)
    return chi2, rows_total


@njit(cache=True, nogil=True)
def _modelled(  # type: ignore[no-untyped-def]
    t_hub,
    t,
    t_ground,
    duration,
    along,
    tdi_hub,
    tdi,
    support,
    by_hub,
    by_partner,
    by_static,
    by_height,
    field,
    uneven,
    uneven_at,
    relief,
    start,
    step,
    nodes,
    statics,
    out,
):
    """What the rows would read for given node values (count, block) and statics; into `out` (G, K, 2)."""
    patches, pairs = t.shape
    count = nodes.shape[0]
    parts = 1 if along == duration else 2
    w = np.zeros(support)
    hub = np.zeros((2, 3))
    partner = np.zeros((2, 3))
    if uneven is not None and len(uneven_at) > 0:
        added = np.zeros((3, support))
    for g in range(patches):
        for c in range(parts):
            spans = along if parts == 2 and c == 0 else duration
            first = _window_weights(t_hub[g], spans, tdi_hub[g], start, step, count, support, w)
            for axis in range(3):
                hub[c, axis] = 0.0
                for m in range(support):
                    hub[c, axis] += w[m] * nodes[first + m, axis]
        height = 0.0
        if relief:
            first = _window_weights(t_ground[g], duration, 0.0, start, step, count, support, w)
            for m in range(support):
                height += w[m] * (nodes[first + m, 3] + field[g] * nodes[first + m, 4])
        for k in range(pairs):
            if not (t[g, k] == t[g, k]):
                out[g, k, 0] = np.nan
                out[g, k, 1] = np.nan
                continue
            for c in range(parts):
                spans = along if parts == 2 and c == 0 else duration
                first = _window_weights(t[g, k], spans, tdi[g, k], start, step, count, support, w)
                for axis in range(3):
                    partner[c, axis] = 0.0
                    for m in range(support):
                        partner[c, axis] += w[m] * nodes[first + m, axis]
            for c in range(2):
                total, q = by_height[g, k, c] * height, c if parts == 2 else 0
                for axis in range(3):
                    total += (
                        by_hub[g, k, c, axis] * hub[q, axis] + by_partner[g, k, c, axis] * partner[q, axis]
                    )
                for s in range(statics.shape[0]):
                    total += by_static[g, k, c, s] * statics[s]
                if uneven is not None and len(uneven_at) > 0:
                    for side in range(2):
                        at = t_hub[g] if side == 0 else t[g, k]
                        spans, whole = along if parts == 2 and c == 0 else duration, tdi_hub[g]
                        if side == 1:
                            whole = tdi[g, k]
                        first = _window_weights(at, spans, whole, start, step, count, support, w)
                        added[:] = 0.0
                        _add_uneven(uneven[g, k, side, c], uneven_at, at, first, start, step, support, added)
                        for axis in range(3):
                            for m in range(support):
                                total += added[axis, m] * nodes[first + m, axis]
                out[g, k, c] = total


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Band, border and corner of the data's information, its right side, and what a likelihood needs.

    Attributes
    ----------
    grid : TimeGrid
        Nodes of the unknowns.
    block : int
        Unknowns per node: 3 angles (rad), or 5 with relief (two heights, m).
    ab : StoredBand
        Lower band (bandwidth + 1, block * count); unknown ``block * node + axis``.
    border : (block * count, Q)
    corner : (Q, Q)
    rhs : (block * count,)
    rhs_static : (Q,)
    chi2 : float
        Squared whitened data.
    rows : int
        Number of scalar measurements.
    """

    grid: TimeGrid
    block: int
    ab: StoredBand
    border: Array
    corner: Array
    rhs: Array
    rhs_static: Array
    chi2: float
    rows: int

    def times(self, x: Array) -> tuple[Array, Array]:
        """Information times a grid vector: (block*count, ...) -> same, and the statics' part (Q, ...)."""
        return self.ab.times(x), products(self.border, x)


@dataclass(frozen=True)
class GroundOrder:
    """Instants that order the ground of several hubs on the grid of the motion: ``begin + rate (t - t0)``.

    Attributes
    ----------
    t0 : float
        s; when a hub sees the ground that comes first.
    begin : float
        s; where the grid has it.
    rate : float
        Below 1 where hubs see more ground than has room on the grid, beyond which it would be extrapolated.
    """

    t0: float = 0.0
    begin: float = 0.0
    rate: float = 1.0

    def of(self, t: Array) -> Array:
        """Instants on the grid of ground that the hub sees at `t` (s)."""
        return np.asarray(self.begin + self.rate * (t - self.t0))

    def later(self, delay: float) -> GroundOrder:
        """The same for a hub that sees a piece of ground `delay` (s) later than this one."""
        return replace(self, t0=self.t0 + delay)

    def seen(self, nodes: Array) -> Array:
        """When (s) the hub sees the ground at instants on the grid."""
        return np.asarray(self.t0 + (nodes - self.begin) / self.rate)


def ordered_ground(hubs: Sequence[Array], delays: Sequence[float], grid: TimeGrid) -> list[GroundOrder]:
    """How the ground of every star lies on the grid.

    Parameters
    ----------
    hubs : sequence of (G,)
        Per star, s: when its hub sees each piece of ground.
    delays : sequence of float
        Per star, s: how much later its hub sees a piece of ground than the first star's hub.
    grid : TimeGrid
    """
    first = min(float(t.min()) - delay for t, delay in zip(hubs, delays, strict=True) if len(t))
    last = max(float(t.max()) - delay for t, delay in zip(hubs, delays, strict=True) if len(t))
    # a node is left at either end, so that all is interpolated
    start, end = grid.start + grid.step, grid.start + (grid.count - 2) * grid.step
    if start <= first and last <= end:
        return [GroundOrder().later(delay) for delay in delays]
    rate = min((end - start) / max(last - first, grid.step), 1.0)
    begin = start if rate < 1.0 else min(max(first, start), end - (last - first))
    return [GroundOrder(first, begin, rate).later(delay) for delay in delays]


def bandwidth_of(
    stars: Sequence[Star], grid: TimeGrid, block: int, orders: Sequence[GroundOrder], relief: bool
) -> int:
    """Bandwidth the rows of `stars` need, in unknowns."""
    widest = 0.0
    support = 4
    for star, order in zip(stars, orders, strict=True):
        support = max(support, _support(star, grid))
        present = star.present
        for some in star.stretches():
            seen, t_hub = present[some], star.t_hub[some]
            every = np.concatenate([t_hub[:, None], np.where(seen, star.t[some], np.nan)], axis=1)
            if relief:
                every = np.concatenate([every, order.of(t_hub)[:, None]], axis=1)
            used = seen.any(axis=1)
            if used.any():
                spread = np.nanmax(every[used], axis=1) - np.nanmin(every[used], axis=1)
                widest = max(widest, float(np.max(spread)))
            let_go()
    return block * (math.ceil(widest / grid.step) + 2 * support) - 1


def normal_equations(
    stars: Sequence[Star],
    measured: Sequence[Array],
    grid: TimeGrid,
    *,
    orders: Sequence[GroundOrder],
    relief: bool = False,
    slow: SlowErrors | None = None,
) -> NormalEquations:
    """Sum the information of all stars.

    Parameters
    ----------
    stars : sequence of Star
        Sensitivities, times, covariances.
    measured : sequence of (G, K, 2)
        What stands on the left side of the rows, px (residual plus what the present estimate explains).
    grid : TimeGrid
        Nodes of the unknowns.
    orders : sequence of GroundOrder
        Per star: how its ground lies on the grid (`ordered_ground`).
    relief : bool
        With two heights per node.
    slow : SlowErrors, optional
        Errors that wander along the strip: unknowns of the border, after the static parameters.
    """
    block = 5 if relief else 3
    n = block * grid.count
    statics = stars[0].by_static.shape[3] + (0 if slow is None else slow.count * slow.each)
    width = min(bandwidth_of(stars, grid, block, orders, relief), n - 1)
    # what earlier solutions have freed would stay beside pieces of the band
    give_back_memory()
    ab = StoredBand(width, n)
    border, corner = scratch_array((n, statics)), np.zeros((statics, statics))
    rhs, rhs_static = np.zeros(n), np.zeros(statics)
    chi2, rows = 0.0, 0
    most = PART_ROWS if slow is None else SLOW_ROWS
    pieces = [
        _Piece(star, left, order, part, slow)
        for star, left, order in zip(stars, measured, orders, strict=True)
        for part in _parts(star, min(most, _rows_with_room(star, grid, block, width)))
    ]
    # those of all stars in the order of time, so that what lies on disk is gone through once
    pieces.sort(key=lambda piece: float(piece.star.t_hub[piece.part.start]))

    def add(sums: _Sums) -> None:
        nonlocal chi2, rows
        for one in sums.stretches:
            here = slice(one.first, one.first + len(one.rhs))
            ab.add(one.first, one.ab)
            border[here, sums.beside] += one.border
            rhs[here] += one.rhs
        corner[np.ix_(sums.beside, sums.beside)] += sums.corner
        rhs_static[sums.beside] += sums.rhs_static
        chi2 += sums.chi2
        rows += sums.rows

    # some at a time: each holds a band of its own, and the order of the sums is that of the pieces
    at_once = _at_once(pieces, grid, block, width)
    for begin in range(0, len(pieces), at_once):
        found = in_threads(lambda piece: _summed(piece, grid, block, width), pieces[begin : begin + at_once])
        while found:  # none of them is held while the next are summed
            add(found.pop(0))
        let_go()
    return NormalEquations(grid, block, ab, border, corner, rhs, rhs_static, chi2, rows)


def no_information(grid: TimeGrid, statics: int, block: int = 3) -> NormalEquations:
    """Equations of no measurement at all."""
    n = block * grid.count
    border, corner = np.zeros((n, statics)), np.zeros((statics, statics))
    ab = StoredBand(0, n)
    return NormalEquations(grid, block, ab, border, corner, np.zeros(n), np.zeros(statics), 0.0, 0)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """What some windows add to the unknowns of the grid from `first` on."""

    first: int
    ab: Array
    border: Array
    rhs: Array


@dataclass(frozen=True, eq=False)
class _Sums:
    """What some windows add to the equations: stretches of the grid, and `beside` of the border."""

    stretches: list[_Stretch]
    beside: NDArray[np.intp]
    corner: Array
    rhs_static: Array
    chi2: float
    rows: int


@dataclass(frozen=True, eq=False)
class _Piece:
    """Some rows of windows of a star, what stands on their left side, and where their ground lies."""

    star: Star
    measured: Array
    order: GroundOrder
    part: slice
    slow: SlowErrors | None = None

    def t_ground(self, windows: slice) -> Array:
        """When the ground of some windows is on the grid, s."""
        return self.order.of(self.star.t_hub[windows])

    def beside(self) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """Which unknowns of the border move these windows, and by how much, (G, K, 2, C)."""
        by_static = self.star.by_static[self.part]
        fixed = np.arange(by_static.shape[3])
        if self.slow is None:
            return fixed, by_static
        near, moved = self.slow.columns(self.star, self.t_ground(self.part))
        which = np.concatenate([fixed, len(fixed) + np.arange(near.start, near.stop)])
        return which, np.concatenate([by_static, moved], axis=3)

    def stretches(self, grid: TimeGrid) -> list[tuple[slice, int, int]]:
        """Rows of windows that reach nodes without a gap between them, and the first and last + 1 of these.

        What a star has left over at either end of a strip would otherwise have a band as long as the strip.
        """
        star, part, blocks, support = self.star, self.part, self.star.shape[1], _support(self.star, grid)
        columns = [star.t_hub[part, None], star.t[part], self.t_ground(part)[:, None]]
        by_row = np.concatenate(columns, axis=1).reshape((part.stop - part.start) // blocks, -1)
        reach = 0.5 * star.longest + 4 * grid.step
        lows = np.floor((np.nanmin(by_row, axis=1) - reach - grid.start) / grid.step).astype(int)
        highs = np.ceil((np.nanmax(by_row, axis=1) + reach - grid.start) / grid.step).astype(int)
        ends = [*np.flatnonzero(lows[1:] >= np.maximum.accumulate(highs)[:-1]) + 1, len(lows)]
        out, begin = [], 0
        for end in ends:
            low, high = int(lows[begin:end].min()), int(highs[begin:end].max())
            # rows at the end of the grid use its last nodes, wherever their instants are
            low, high = max(min(low, grid.count - support), 0), min(max(high, support), grid.count)
            windows = slice(part.start + begin * blocks, part.start + end * blocks)
            out.append((windows, low, high))
            begin = end
        return out


def _uneven(star: Star, part: slice) -> tuple[NDArray[np.float32] | None, Array | None]:
    """`uneven` of a part of a star's windows and `uneven_at`, of no instants where it has none.

    None of both where no image has stages: most strips compile their kernels for one of the two only.
    """
    if star.uneven is not None and star.uneven_at is not None:
        return star.uneven[part], star.uneven_at
    if star.tdi is None and star.tdi_hub is None:
        return None, None
    return np.zeros((*star.t[part].shape, 2, 2, 3, 0), dtype=np.float32), np.zeros(0)


def _support(star: Star, grid: TimeGrid) -> int:
    """Nodes that a row of a star is interpolated from, at each of its two instants."""
    return TAPS + math.ceil(star.longest / grid.step)


def _parts(star: Star, most: int = PART_ROWS) -> list[slice]:
    """Whole rows of windows of a star, some at a time."""
    return stretches(*star.shape, min(PART_PATCHES, most * star.shape[1]))


def _rows_with_room(star: Star, grid: TimeGrid, block: int, width: int) -> int:
    """Rows of windows whose band has PART_BYTES, PART_ROWS at most and one at least.

    It spans their nodes and, beyond these, those that lags reach: at least half of it shall be the former.
    """
    rows = star.shape[0]
    if rows < 2:
        return PART_ROWS
    beyond = width / block
    nodes = max(PART_BYTES / (8 * (width + 1) * block) - beyond, beyond)
    between = abs(star.t_hub[-1] - star.t_hub[0]) / (grid.step * (rows - 1))
    return max(int(nodes / max(between, nodes / PART_ROWS)), 1)


def _at_once(pieces: Sequence[_Piece], grid: TimeGrid, block: int, width: int) -> int:
    """How many pieces are summed at a time: one per processor, as far as their bands have room in memory."""
    nodes = max((sum(high - low for _, low, high in piece.stretches(grid)) for piece in pieces), default=1)
    return max(min(available_processors(), AT_ONCE_BYTES // (8 * (width + 1) * block * nodes)), 1)


def _summed(piece: _Piece, grid: TimeGrid, block: int, width: int) -> _Sums:
    """Sum one piece on the nodes it reaches, with at most `width` subdiagonals."""
    star, support = piece.star, _support(piece.star, grid)
    beside, by_static = piece.beside()
    statics = len(beside)
    corner, rhs_static = np.zeros((statics, statics)), np.zeros(statics)
    tdi_hub, tdi = star.averaging()
    stretches, chi2, rows = [], 0.0, 0
    for part, low, high in piece.stretches(grid):
        n = block * (high - low)
        ab, border, rhs = np.zeros((min(width + 1, n), n)), np.zeros((n, statics)), np.zeros(n)
        squares, count = _accumulate(
            star.t_hub[part],
            star.t[part],
            piece.t_ground(part),
            star.duration,
            star.duration + star.stretch,
            tdi_hub[part],
            tdi[part],
            support,
            np.ascontiguousarray(piece.measured[part]),
            star.covariance_px[part],
            star.weight[part],
            star.by_hub[part],
            star.by_partner[part],
            by_static[part.start - piece.part.start : part.stop - piece.part.start],
            star.by_height[part],
            star.field[part],
            star.correlation,
            *_uneven(star, part),
            block == 5,
            grid.start,
            grid.step,
            grid.count,
            low,
            ab,
            border,
            corner,
            rhs,
            rhs_static,
        )
        stretches.append(_Stretch(block * low, ab, border, rhs))
        chi2, rows = chi2 + squares, rows + count
    return _Sums(stretches, beside, corner, rhs_static, chi2, rows)


def window_rows(
    star: Star,
    grid: TimeGrid,
    block: int,
    order: GroundOrder,
    which: NDArray[np.intp],
    slow: SlowErrors | None = None,
) -> tuple[Any, Array]:
    """The rows of the first pair of a star: by the unknowns of the grid, and by those beside them.

    Parameters
    ----------
    block : int
        Unknowns per node: 3 angles, or 5 with relief.
    which : (N,)
        Windows whose rows are wanted.
    slow : SlowErrors, optional
        Errors that wander along the strip, of both images among others.

    Returns
    -------
    rows : (2 N, block * count) scipy.sparse
        Two per window: px along and across per rad, and per m.
    beside : (2 N, Q + E)
        By the static parameters, then by the errors that wander.
    """
    from scipy.sparse import csr_array

    parts = [(star.t_hub, star.by_hub[:, 0], 0), (star.t[:, 0], star.by_partner[:, 0], 0)]
    if block == 5:
        height = star.by_height[:, 0, :, None]
        tilted = np.concatenate([height, height * star.field[:, None, None]], axis=2)
        parts.append((order.of(star.t_hub), tilted, 3))
    points = 2 + math.ceil(star.duration / grid.step) if star.duration > 0.0 else 1
    hub, partner = star.averaging()
    # hub, partner, and the ground, which TDI does not average
    stages = (hub, partner[:, 0], np.zeros(len(hub)))
    values, columns = [], []
    for (t, by, unknown), tdi in zip(parts, stages, strict=False):
        longest = float(tdi[which].max(initial=0.0))
        each = 2 + math.ceil(2.0 * longest / grid.step) if longest > 0.0 else 1
        for point, stage in product(range(points), range(each)):
            instants = t[which] + star.duration * ((point + 0.5) / points - 0.5)
            if longest > 0.0:
                instants = instants + tdi[which] * ((stage + 0.5) / each - 0.5)
            first, w = grid.weights(instants)
            node = first[:, None, None, None] + np.arange(TAPS)[:, None]
            at = np.broadcast_to(
                block * node + unknown + np.arange(by.shape[2]), (len(which), 2, TAPS, by.shape[2])
            )
            share = by[which][:, :, None, :] * w[:, None, :, None] / (points * each)
            values.append(share.reshape(2 * len(which), -1))
            columns.append(at.reshape(2 * len(which), -1))
    for side, t in enumerate((star.t_hub, star.t[:, 0])):
        if star.uneven is None or star.uneven_at is None:
            continue
        for at, by in zip(star.uneven_at, np.moveaxis(star.uneven[which, 0, side], -1, 0), strict=True):
            first, w = grid.weights(t[which] + at)
            node = first[:, None, None, None] + np.arange(TAPS)[:, None]
            place = np.broadcast_to(block * node + np.arange(3), (len(which), 2, TAPS, 3))
            values.append((by[:, :, None, :] * w[:, None, :, None]).reshape(2 * len(which), -1))
            columns.append(place.reshape(2 * len(which), -1))
    value, column = np.concatenate(values, axis=1), np.concatenate(columns, axis=1)
    each = np.arange(2 * len(which) + 1) * value.shape[1]
    shape = (2 * len(which), block * grid.count)
    rows = csr_array((value.ravel(), column.ravel(), each), shape=shape)
    beside = [star.by_static[which, 0].reshape(2 * len(which), -1)]
    if slow is not None:
        near, moved = slow.columns(star, order.of(star.t_hub[which]))
        wander = np.zeros((2 * len(which), slow.count * slow.each))
        wander[:, near] = moved[:, 0].reshape(2 * len(which), -1)
        beside.append(wander)
    return rows, np.concatenate(beside, axis=1, dtype=np.float64)


def modelled(
    star: Star, grid: TimeGrid, nodes: Array, statics: Array, order: GroundOrder = GroundOrder()
) -> Array:
    """What the rows of a star read for given unknowns, (G, K, 2) px.

    Parameters
    ----------
    nodes : (count, 3) or (count, 5)
        rad (and m).
    statics : (Q,)
        In the units of the static parameters.
    """
    out = scratch_array(star.residual_px.shape)
    t_ground, nodes = order.of(star.t_hub), np.ascontiguousarray(nodes)
    values = np.asarray(statics, dtype=float)
    support, (tdi_hub, tdi) = _support(star, grid), star.averaging()

    def work(part: slice) -> None:
        _modelled(
            star.t_hub[part],
            star.t[part],
            t_ground[part],
            star.duration,
            star.duration + star.stretch,
            tdi_hub[part],
            tdi[part],
            support,
            star.by_hub[part],
            star.by_partner[part],
            star.by_static[part],
            star.by_height[part],
            star.field[part],
            *_uneven(star, part),
            nodes.shape[1] == 5,
            grid.start,
            grid.step,
            nodes,
            values,
            out[part],
        )
        let_go()

    in_threads(work, _parts(star))
    return out


def modelled_by_blur(star: Star, grid: TimeGrid, nodes: Array) -> Array:
    """What uneven weights of stages add to what the rows of a star read, (G, K, 2) px."""
    none = np.zeros(star.by_static.shape[3])
    both = modelled(star, grid, nodes, none), modelled(replace(star, uneven=None), grid, nodes, none)
    return star.each(np.subtract, *both)
