"""What a table of settings loses at worst, found on all columns and on signals denser than it was built on.

Not here: building the table (``table_build.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sightline.tdi.choose import CHUNK, TdiChoice
from sightline.tdi.merit import (
    ColumnMtf,
    SignalFactors,
    column_factors,
    signal_factors,
    unsaturated,
)
from sightline.tdi.setting import Array, Index, TdiDetector
from sightline.tdi.table import TdiTable
from sightline.tdi.table_kernels import (
    largest_products,
)

#: Signals judged per nominal one.
DENSER = 4
#: Ends of stretches worked on at once; even.
AT_ONCE = 256
#: Whole electrons judged one by one from the lowest signal on.
LOWEST = 32
#: Signals judged together.
SIGNAL_BLOCK = 16
#: Just below: signals have parts of an electron, which the table drops.
BELOW = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Certificate:
    """What a table was found to lose.

    Attributes
    ----------
    max_loss : float
        Relative loss of merit that was asked for.
    loss : float
        Worst found, where some setting keeps all limits; 1 where the table's would break one. A limit is
        kept where all signals keep it that the table cannot distinguish.
    column, signal : float
        Where; the signal in electrons, rounded down to 0.0001: one just below a whole number stays below it.
    mean_loss : float
        Over all points judged.
    points : (int, int)
        Columns and signals judged: all columns; the nominal signals, several between each two, both sides of
        the borders of all cells and of each of the lowest electrons.
    flagged : float
        Share of points at which no setting keeps all limits.
    bytes : int
        Of the table's whole memory image.
    at_limits: float
        Worst loss against the best that a signal's own limits allow: within the electron in which a well
        fills or the least SNR is reached, the table keeps clear of what the signal alone would still permit.
    """

    max_loss: float
    loss: float
    column: float
    signal: float
    mean_loss: float
    points: tuple[int, int]
    flagged: float
    bytes: int
    at_limits: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether the bound is kept."""
        return self.loss <= self.max_loss


def table_loss(
    model: ColumnMtf, choice: TdiChoice, table: TdiTable, signals: Array, *, own_limits: bool = False
) -> Array:
    """Relative loss of merit (C, S) of a table against the best setting; NaN where none keeps all limits.

    Parameters
    ----------
    model : ColumnMtf
    choice : TdiChoice
    table : TdiTable
    signals : (S,)
        Electrons of one line, rising.
    own_limits : bool
        Against the best that keeps limits for the signal itself, not for all that the table confuses with
        it.
    """
    setting, group = _settings_at(table, choice, signals)
    loss = np.empty((len(group), len(signals)))
    for of_kind, places in choice.detector.by_kind(choice.columns):
        by_signal = _by_signal(signals, choice, of_kind, own_limits=own_limits)
        blocks = signal_blocks(by_signal)
        for begin in range(0, len(places), CHUNK):
            part = places[begin : begin + CHUNK]
            a = column_factors(model, part, choice.grid, choice.rules).allowed
            for (block, *_), best in zip(blocks, best_of_blocks(a, by_signal, blocks), strict=True):
                chosen = setting[group[part], block]
                merit = np.take_along_axis(a, chosen, axis=1)
                merit *= np.take_along_axis(by_signal[block], chosen.T, axis=1).T
                with np.errstate(invalid="ignore", divide="ignore"):
                    loss[part, block] = np.where(best > 0.0, np.maximum(1.0 - merit / best, 0.0), np.nan)
    return loss


def _by_signal(signals: Array, choice: TdiChoice, detector: TdiDetector, *, own_limits: bool) -> Array:
    """(S, P) what signals give to the merit of a kind of column; parameters as of `table_loss`."""
    if own_limits:
        return signal_factors(signals, choice.grid, detector, choice.rules).allowed
    parts = range(0, len(signals), AT_ONCE)
    return np.concatenate(
        [whole_electrons(signals[k : k + AT_ONCE], choice, detector).allowed for k in parts]
    )


def signal_blocks(by_signal: Array) -> list[tuple[slice, Array, Array]]:
    """Signals (S, P) in blocks, and what each gives to every setting at least and at most."""
    blocks = [slice(k, k + SIGNAL_BLOCK) for k in range(0, len(by_signal), SIGNAL_BLOCK)]
    return [(block, by_signal[block].min(axis=0), by_signal[block].max(axis=0)) for block in blocks]


def best_of_blocks(a: Array, by_signal: Array, blocks: list[tuple[slice, Array, Array]]) -> Iterator[Array]:
    """Best merit (c, s) of columns (c, P) at each block of signals."""
    most, least = a.max(axis=0), a.min(axis=0)
    for block, low, high in blocks:
        # a setting whose merit is nowhere above what another has everywhere is nowhere the best
        could = most * high
        rivals = np.flatnonzero((could >= (least * low).max()) & (could > 0.0))
        best = np.empty((len(a), len(by_signal[block])))
        largest_products(
            np.ascontiguousarray(a[:, rivals]), np.ascontiguousarray(by_signal[block][:, rivals]), best
        )
        yield best


def certify(
    model: ColumnMtf, choice: TdiChoice, table: TdiTable, max_loss: float
) -> tuple[Certificate, tuple[Index, Array]]:
    """Judge a table at all columns and dense signals.

    Returns
    -------
    certificate, (columns, signals)
        Places (numbers of columns from 0; electrons) where the bound is broken.
    """
    signals = dense_signals(choice.signals, table)
    loss = table_loss(model, choice, table, signals)
    judged = np.isfinite(loss)
    # no copies: there may be tens of millions of points
    c = int(np.argmax(np.fmax.reduce(loss, axis=1, where=judged, initial=-1.0)))
    s = int(np.argmax(np.where(judged[c], loss[c], -1.0)))
    points = int(np.count_nonzero(judged))
    column, signal = np.nonzero(loss > max_loss)
    certificate = Certificate(
        max_loss,
        float(loss[c, s]) if points else 0.0,
        float(choice.columns.column[c]),
        float(np.floor(signals[s] * 1e4) / 1e4),
        float(loss.sum(where=judged)) / max(points, 1),
        (loss.shape[0], loss.shape[1]),
        1.0 - points / loss.size,
        len(table.to_bytes()),
    )
    return certificate, (column, signals[signal])


def loss_at_limits(model: ColumnMtf, choice: TdiChoice, table: TdiTable) -> float:
    """Worst loss at those signals whose own limits allow more than whole electrons do, unflagged ones."""
    signals = dense_signals(choice.signals, table)
    near = np.zeros(len(signals), dtype=bool)
    for of_kind, _ in choice.detector.by_kind(choice.columns):
        if of_kind.without_wells and choice.rules.snr_min <= 0.0:
            continue
        own = _by_signal(signals, choice, of_kind, own_limits=True)
        near |= (own != _by_signal(signals, choice, of_kind, own_limits=False)).any(axis=1)
    if not near.any():
        return 0.0
    loss = table_loss(model, choice, table, signals[near], own_limits=True)
    # where no setting keeps the limits of whole electrons the word is flagged, and nothing is promised
    promised = np.isfinite(table_loss(model, choice, table, signals[near]))
    return float(np.max(loss, where=promised & np.isfinite(loss), initial=0.0))


def dense_signals(nominal: Array, table: TdiTable) -> Array:
    """Signals that a table is judged at, both sides of every border of its cells among them.

    Parameters
    ----------
    nominal : (S,)
        Those of the choice.
    table : TdiTable
    """
    nominal = np.sort(nominal)
    low, high = nominal[0], nominal[-1]
    between = [np.linspace(a, b, DENSER, endpoint=False) for a, b in pairwise(nominal)]
    ends = np.unique(table.thresholds).astype(np.float64) * 2.0**table.shift
    lowest = np.arange(np.ceil(low), np.ceil(low) + LOWEST)
    every = np.concatenate([nominal, *between, ends, ends * BELOW, lowest, lowest * BELOW])
    return np.unique(np.append(every[(every >= low) & (every <= high)], low))


def _settings_at(table: TdiTable, choice: TdiChoice, signals: Array) -> tuple[Index, Index]:
    """(G, S) setting that the table has for each group and signal, (C,) group of each column."""
    column = choice.columns.column.astype(np.intp)
    group = np.searchsorted(table.edges, column, side="right") - 1
    firsts = np.asarray(table.edges[:-1])
    per_group = np.empty((len(firsts), len(signals)), dtype=np.intp)
    one_each = replace(table, edges=np.arange(len(firsts) + 1))
    for s, signal in enumerate(signals):
        stages, ratio = table.unpack(one_each.lookup(np.full(len(firsts), signal)))
        number = np.searchsorted(choice.grid.stages, stages) * len(choice.grid.ratios)
        per_group[:, s] = number + np.searchsorted(choice.grid.ratios, ratio)
    return per_group, group


def whole_electrons(signals: Array, choice: TdiChoice, detector: TdiDetector) -> SignalFactors:
    """What signals give to the merit of a kind of column; limits are kept by all that the table confuses."""
    grid, rules = choice.grid, choice.rules
    unit = 2.0 ** shift_of(choice.signals)
    whole = np.floor(signals / unit) * unit
    most = unsaturated(np.minimum(whole + unit, choice.signals.max()), grid, detector, rules)
    factors = signal_factors(signals, grid, detector, rules)
    clear = factors.clear
    if rules.snr_min > 0.0:
        least = signal_factors(np.maximum(whole, choice.signals.min()), grid, detector, rules)
        clear = clear & least.clear
    return replace(factors, unsaturated=factors.unsaturated & most, clear=clear)


def shift_of(signals: Array) -> int:
    """Bits that quantisation drops so that all signals, and one step more, fit 16 bits."""
    return max(int(signals.max() + 1.0).bit_length() - 16, 0)
