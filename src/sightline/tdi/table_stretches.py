"""Signals between which the cells of a table may begin: closer where a limit decides.

Not here: the cells (``table_build.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.tdi.choose import INFEASIBLE, SATURATION, SNR, TdiChoice
from sightline.tdi.merit import (
    ColumnMtf,
    column_factors,
    fullest_signals,
)
from sightline.tdi.setting import Array, Index, TdiDetector
from sightline.tdi.table_certificate import (
    AT_ONCE,
    BELOW,
    best_of_blocks,
    shift_of,
    signal_blocks,
    whole_electrons,
)

#: Ratio of neighbouring signals where no limit is near.
SIGNAL_STEP = 1.1
#: Most stretches that signals are cut into.
MOST_STRETCHES = 1500
#: Ratio of neighbouring signals, less 1, as a share of the bound: where limits of the SNR are near, and where
#: wells decide.
NEAR_STEP, SMOOTH_STEP = 0.5, 2.0
#: Columns that say at which signals wells cut off their best settings.
WELL_COLUMNS = 33
#: A fall of the best merit that counts, as a share of the bound.
WELL_STEP = 0.25


def first_codes(choice: TdiChoice, max_loss: float) -> Index:
    """Quantised signals between which stretches lie: closer where a limit of the signal is near.

    Parameters
    ----------
    choice : TdiChoice
    max_loss : float
    """
    order = np.argsort(choice.signals)
    signals, limit = choice.signals[order], choice.limit[:, order]
    unit = 2.0 ** shift_of(signals)
    near = _between(limit, (SNR, SNR + INFEASIBLE))
    near |= (limit[:, :-1] > INFEASIBLE).any(axis=0) != (limit[:, 1:] > INFEASIBLE).any(axis=0)
    wells = _between(limit, (SATURATION, SATURATION + INFEASIBLE))
    low = np.maximum(signals, unit)
    spans = np.log(low[1:] / low[:-1])
    # where wells cut settings off `well_codes` says so; between these the merit is smooth
    step = np.select([near, wells], [NEAR_STEP * max_loss, SMOOTH_STEP * max_loss], np.log(SIGNAL_STEP))
    fine = max(1e-9, spans[near | wells].sum() / MOST_STRETCHES)
    codes = [np.floor(signals / unit)]
    for a, span, most in zip(low[:-1], spans, step, strict=True):
        parts = int(np.ceil(span / max(most, fine))) + 1
        codes.append(np.floor(a * np.exp(np.linspace(0.0, span, parts)) / unit))
    return np.unique(np.concatenate(codes)).astype(np.intp)


def well_codes(model: ColumnMtf, choice: TdiChoice, max_loss: float) -> Index:
    """Quantised signals from which on a well forbids a setting that some column misses.

    There the best merit falls at once: no cell can reach across but with a setting that does not fill the
    well, which may lose too much below.

    Parameters
    ----------
    model : ColumnMtf
    choice : TdiChoice
    max_loss : float
    """
    some = np.unique(np.linspace(0, len(choice.columns) - 1, WELL_COLUMNS).astype(np.intp))
    kinds = choice.detector.by_kind(choice.columns.part(some))
    found = [_missed_codes(model, choice, max_loss, of_kind, some[places]) for of_kind, places in kinds]
    return np.unique(np.concatenate(found))


def _missed_codes(
    model: ColumnMtf, choice: TdiChoice, max_loss: float, detector: TdiDetector, columns: Index
) -> Index:
    """Those of columns of one kind."""
    unit, low, high = 2.0 ** shift_of(choice.signals), choice.signals.min(), choice.signals.max()
    full = fullest_signals(choice.grid, detector, choice.rules)
    full = full[(full >= low) & (full < high)] / unit
    # where one is a whole number but for rounding, both sides
    codes = np.unique(np.floor(np.concatenate([full * BELOW, full / BELOW])))
    codes = codes[(codes * unit > low) & (codes * unit < high)]
    a = np.concatenate(
        [column_factors(model, np.array([k]), choice.grid, choice.rules).allowed for k in columns]
    )
    missed = np.zeros(len(codes), dtype=bool)
    for begin in range(0, len(codes), AT_ONCE // 2):
        at = codes[begin : begin + AT_ONCE // 2] * unit
        by_signal = whole_electrons(np.stack([at * BELOW, at], axis=1).ravel(), choice, detector).allowed
        best = np.concatenate(list(best_of_blocks(a, by_signal, signal_blocks(by_signal))), axis=1)
        falls = best[:, 1::2] < (1.0 - WELL_STEP * max_loss) * best[:, ::2]
        missed[begin : begin + AT_ONCE // 2] = falls.any(axis=0)
    return codes[missed].astype(np.intp)


def _between(limit: NDArray[np.uint8], which: tuple[int, ...]) -> NDArray[np.bool_]:
    """(S - 1,) whether at one of two neighbouring signals such a limit decides, in any column."""
    some = np.asarray(np.isin(limit, which).any(axis=0))
    return np.asarray(some[:-1] | some[1:])


def finer_codes(codes: Index, failed: tuple[Index, Array]) -> Index:
    """Codes with those stretches cut in which the bound is broken."""
    # both neighbours too: a cell that ends there may be at fault
    place = np.searchsorted(codes, np.unique(failed[1]), side="right") - 1
    place = np.unique(np.clip(np.concatenate([place - 1, place, place + 1]), 0, max(len(codes) - 2, 0)))
    more = [
        np.linspace(codes[k], codes[k + 1], 5).round().astype(np.intp) for k in place if k + 1 < len(codes)
    ]
    return np.unique(np.concatenate([codes, *more]))
