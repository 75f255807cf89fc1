"""The best setting of every column and signal, the limit that decided it, and what to do where none will do.

Not here: what a setting makes of the image (``merit.py``), the table a flight computer holds (``table.py``).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, no_step, stepped
from sightline.stages import Stages
from sightline.tdi.kernels import best_settings
from sightline.tdi.merit import (
    ColumnFactors,
    ColumnMtf,
    SignalFactors,
    column_factors,
    mtf_merit,
    signal_factors,
    well_levels,
)
from sightline.tdi.setting import Array, ChoiceRules, Index, ScanColumns, TdiDetector, TdiGrid

Small = NDArray[np.uint8]

#: What decided a cell: nothing but merit; a limit that forbids the freely best setting; a limit that no
#: setting can keep, so that the safest stands in.
LIMITS = (
    "none", "saturation", "main-lobe", "mtf", "snr",
    "infeasible-saturation", "infeasible-main-lobe", "infeasible-mtf", "infeasible-snr",
)  # fmt: skip
FREE, SATURATION, MAIN_LOBE, MTF, SNR = range(5)
#: Added to a limit that cannot be kept.
INFEASIBLE = 4
#: Columns whose transfer functions are held at once.
CHUNK = 128
#: s after which columns that are done are kept.
KEPT_SECONDS = 10.0


@dataclass(frozen=True, eq=False)
class TdiChoice:
    """Result of S3, per column and signal.

    Attributes
    ----------
    columns : ScanColumns
    signals : (S,)
        Electrons of one line at the integration ratio of `detector.signal_ratio`.
    grid : TdiGrid
    detector : TdiDetector
    rules : ChoiceRules
    setting : (C, S) int
        Number of the chosen setting, as the grid counts them.
    mtf : (C, S, 2)
        Of the whole system at the frequencies of the rules, across and along.
    snr : (C, S)
    limit : (C, S) int
        What decided: number in `LIMITS`.
    """

    columns: ScanColumns
    signals: Array
    grid: TdiGrid
    detector: TdiDetector
    rules: ChoiceRules
    setting: Index
    mtf: Array
    snr: Array
    limit: Small

    @property
    def merit(self) -> Array:
        """(C, S) merit of the chosen setting, as expected."""
        return mtf_merit(self.mtf, self.rules.merit) * self.snr

    @property
    def stages(self) -> Index:
        """(C, S) chosen number of TDI stages."""
        return self.grid.stages_of(self.setting)

    @property
    def integration_ratio(self) -> Array:
        """(C, S) chosen integration time over the line period."""
        return self.grid.ratio_of(self.setting)

    @property
    def infeasible(self) -> NDArray[np.bool_]:
        """(C, S) where no setting keeps all limits and the safest stands in."""
        return np.asarray(self.limit > INFEASIBLE)


@dataclass(frozen=True, eq=False)
class _Chosen:
    """Arrays of a `TdiChoice` of which the first `done` blocks of columns are filled."""

    done: int
    setting: Index
    mtf: Array
    snr: Array
    limit: Small

    @classmethod
    def none(cls, shape: tuple[int, int]) -> _Chosen:
        """Room for columns x signals."""
        setting, limit = np.empty(shape, dtype=np.intp), np.empty(shape, dtype=np.uint8)
        return cls(0, setting, np.empty((*shape, 2)), np.empty(shape), limit)


def choose_settings(
    model: ColumnMtf,
    signals: Array,
    grid: TdiGrid,
    detector: TdiDetector,
    rules: ChoiceRules,
    step: Step = no_step,
    stages: Stages | None = None,
) -> TdiChoice:
    """The best setting of every column and signal.

    Parameters
    ----------
    model : ColumnMtf
        What motion does to each column.
    signals : (S,)
        Electrons of one line at the integration ratio of `detector.signal_ratio`.
    grid : TdiGrid
    detector : TdiDetector
    rules : ChoiceRules
    step : callable
        Called with the number of blocks of columns that are done, and of all.
    stages : Stages, optional
        Where the choice is kept, and every `KEPT_SECONDS` the columns that are done.

    Returns
    -------
    TdiChoice

    Notes
    -----
    Exhaustive: every setting is judged. Of equal merits the fewest stages, then the shortest integration is
    taken. Where no setting keeps all limits, the bounds of SNR are given up first, then those of MTF, then
    the main lobe; a well that overflows loses the scene, so that the least full comes last of all.
    """
    columns, kept = model.columns, stages or Stages()
    found = kept.held("choice", _Chosen, writeable=True) or _Chosen.none((len(columns), len(signals)))
    setting, limit, mtf, snr = found.setting, found.limit, found.mtf, found.snr
    last: TdiDetector | None = None
    chunks, when = _chunks(columns, detector), time.monotonic()
    for number, (of_kind, part) in enumerate(stepped(chunks, step), 1):
        if number <= found.done:
            continue
        if of_kind is not last:
            by_signal = signal_factors(signals, grid, of_kind, rules)
            fullness, last = _fullness(signals, grid, of_kind), of_kind
        by_column = column_factors(model, part, grid, rules)
        chosen, why = _best(by_column, by_signal, fullness)
        setting[part], limit[part] = chosen, why
        mtf[part] = np.take_along_axis(by_column.mtf, chosen[..., None], axis=1)
        snr[part] = np.take_along_axis(by_signal.snr, chosen.T, axis=1).T
        if number == len(chunks) or time.monotonic() - when > KEPT_SECONDS:
            kept.put("choice", replace(found, done=number))
            when = time.monotonic()
    return TdiChoice(columns, signals, grid, detector, rules, setting, mtf, snr, limit)


def merit_of(
    model: ColumnMtf,
    signals: Array,
    setting: Index,
    grid: TdiGrid,
    detector: TdiDetector,
    rules: ChoiceRules,
) -> Array:
    """Merit (C, S) of given settings (C, S), limits aside; parameters as of `choose_settings`."""
    merit = np.empty(setting.shape)
    last: TdiDetector | None = None
    for of_kind, part in _chunks(model.columns, detector):
        if of_kind is not last:
            by_signal, last = signal_factors(signals, grid, of_kind, rules), of_kind
        by_column = column_factors(model, part, grid, rules)
        of_signal = np.take_along_axis(by_signal.merit, setting[part].T, axis=1).T
        merit[part] = np.take_along_axis(by_column.merit, setting[part], axis=1) * of_signal
    return merit


def _chunks(columns: ScanColumns, detector: TdiDetector) -> list[tuple[TdiDetector, Index]]:
    """Columns of one kind, at most `CHUNK` at once, with what they are like; kinds one after the other."""
    return [
        (of_kind, places[k : k + CHUNK])
        for of_kind, places in detector.by_kind(columns)
        for k in range(0, len(places), CHUNK)
    ]


def _best(by_column: ColumnFactors, by_signal: SignalFactors, fullness: Array) -> tuple[Index, Small]:
    """Number of the best setting (c, S), and what decided it."""
    shape = (len(by_column.merit), len(by_signal.merit))
    chosen = np.empty(shape, dtype=np.intp)
    best_settings(by_column.allowed, by_signal.allowed, chosen)
    limit = np.zeros(shape, dtype=np.uint8)
    if not (
        by_column.in_lobe.all()
        and by_column.in_bounds.all()
        and by_signal.unsaturated.all()
        and by_signal.clear.all()
    ):
        free = np.empty(shape, dtype=np.intp)
        best_settings(by_column.merit, by_signal.merit, free)
        limit = _what_forbids(free, chosen, by_column, by_signal)
        _stand_in(chosen, limit, by_column, by_signal, fullness)
    # without signal or contrast every setting is worth nothing: the least is taken
    chosen[chosen < 0] = 0
    return chosen, limit


def _what_forbids(free: Index, chosen: Index, by_column: ColumnFactors, by_signal: SignalFactors) -> Small:
    """The first limit that forbids the freely best setting, where another was chosen."""
    column, signal = np.indices(free.shape)
    kept = (
        by_signal.unsaturated[signal, free],
        by_column.in_lobe[column, free],
        by_column.in_bounds[column, free],
        by_signal.clear[signal, free],
    )
    forbids = np.select([~k for k in kept], [SATURATION, MAIN_LOBE, MTF, SNR], default=FREE)
    return np.where((free == chosen) | (free < 0), FREE, forbids).astype(np.uint8)


def _stand_in(
    chosen: Index, limit: Small, by_column: ColumnFactors, by_signal: SignalFactors, fullness: Array
) -> None:
    """Fill cells in which no setting keeps all limits with the best that keeps the most important of them."""
    rounds = (
        (SNR, by_signal.unsaturated, by_column.in_lobe & by_column.in_bounds),
        (MTF, by_signal.unsaturated, by_column.in_lobe),
        (MAIN_LOBE, by_signal.unsaturated, np.ones_like(by_column.in_lobe)),
    )
    given_up = limit.copy()
    for why, signal_allowed, column_allowed in rounds:
        open_cells = chosen < 0
        if not open_cells.any():
            break
        found = np.empty_like(chosen)
        best_settings(
            np.where(column_allowed, by_column.merit, 0.0),
            np.where(signal_allowed, by_signal.merit, 0.0),
            found,
        )
        now = open_cells & (found >= 0)
        chosen[now], given_up[now] = found[now], why + INFEASIBLE
    open_cells = (chosen < 0) & ~by_signal.unsaturated.any(axis=1)
    least_full = np.broadcast_to(fullness.argmin(axis=1), chosen.shape)
    chosen[open_cells], given_up[open_cells] = least_full[open_cells], SATURATION + INFEASIBLE
    limit[...] = given_up


def _fullness(signals: Array, grid: TdiGrid, detector: TdiDetector) -> Array:
    """(S, P) how full the fuller of the two wells is."""
    line, total = well_levels(signals, grid, detector)
    return np.asarray(np.maximum(line / detector.full_well_line, total / detector.full_well_sum))
