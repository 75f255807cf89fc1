"""Settings that do not flicker: from column to column, from signal to signal, and from line to line.

A cell may give up a share of its merit so that its neighbours keep one setting. Limits stay limits: a setting
that the choice refused for a cell is never taken for it. From line to line a bounded step may need some lines
to get there; only wells are never overfilled for it.

Not here: the free choice (``choose.py``), settings of an image of signals
(``applications/tdi_lines.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.tdi.choose import CHUNK, LIMITS, TdiChoice
from sightline.tdi.merit import ColumnMtf, column_factors, signal_factors
from sightline.tdi.setting import Array, Index
from sightline.tdi.steady_kernels import CLEAR, IN_BOUNDS, IN_LOBE, UNSATURATED, fewest_changes, hold

Single = NDArray[np.float32]
Small = NDArray[np.uint8]
Flags = NDArray[np.bool_]

#: Along what a choice can be kept steady.
DIRECTIONS = ("columns", "signals")
_ALL = UNSATURATED | IN_LOBE | IN_BOUNDS | CLEAR
#: What the settings of a cell keep, by its limit: SNR is given up first, then MTF, then the main lobe.
_KEPT_THOUGH = {
    "infeasible-snr": UNSATURATED | IN_LOBE | IN_BOUNDS,
    "infeasible-mtf": UNSATURATED | IN_LOBE,
    "infeasible-main-lobe": UNSATURATED,
    "infeasible-saturation": 128,  # no setting has this bit: the least full one stands alone
}
_NEEDED = np.array([_KEPT_THOUGH.get(name, _ALL) for name in LIMITS], dtype=np.uint8)
#: Losses are distinguished to this share of the hysteresis, or as finely as 63 bits allow.
_LEVELS = 2**20


@dataclass(frozen=True, eq=False)
class MeritFactors:
    """Both factors of the merit of every setting, and what each setting keeps.

    Attributes
    ----------
    by_column, by_signal : (C, P), (K S, P) float32
        Their product is the merit by the rules; signals kind of column by kind.
    column_kept, signal_kept : (C, P), (K S, P) uint8
        Bits: main lobe and bounds of the MTF; full wells and least SNR.
    first : (C,) int
        Row of `by_signal` of the first signal, as columns of this kind see it.
    """

    by_column: Single
    by_signal: Single
    column_kept: Small
    signal_kept: Small
    first: Index

    def rows(self, cell: Index | int, column: Index) -> Index:
        """Rows of `by_signal` of signals by their number, at columns by their place; broadcast."""
        return np.asarray(self.first[column] + cell)


def merit_factors(model: ColumnMtf, choice: TdiChoice) -> MeritFactors:
    """The factors from which `choice` was made: 5 bytes per column (or signal) and setting.

    Parameters
    ----------
    model : ColumnMtf
        Of the columns of `choice`.
    choice : TdiChoice
    """
    shape = (len(choice.columns), len(choice.grid))
    by_column, column_kept = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8)
    for begin in range(0, shape[0], CHUNK):
        part = slice(begin, min(begin + CHUNK, shape[0]))
        of_columns = column_factors(model, part, choice.grid, choice.rules)
        by_column[part] = of_columns.merit
        column_kept[part] = of_columns.in_lobe * np.uint8(IN_LOBE) | of_columns.in_bounds * np.uint8(
            IN_BOUNDS
        )
    first, merit, kept = np.empty(shape[0], dtype=np.intp), [], []
    for k, (of_kind, places) in enumerate(choice.detector.by_kind(choice.columns)):
        of_signals = signal_factors(choice.signals, choice.grid, of_kind, choice.rules)
        merit.append(of_signals.merit.astype(np.float32))
        kept.append(of_signals.unsaturated * np.uint8(UNSATURATED) | of_signals.clear * np.uint8(CLEAR))
        first[places] = k * len(choice.signals)
    return MeritFactors(by_column, np.concatenate(merit), column_kept, np.concatenate(kept), first)


@dataclass(frozen=True, eq=False)
class SteadyChoice:
    """A choice that changes seldom, and what that costs.

    Attributes
    ----------
    choice : TdiChoice
        Its `limit` is that of the free choice.
    loss : (C, S)
        Share of the free choice's merit that is given up.
    too_far : (C, S) bool
        Cells whose number of stages lies further from that of the cell before than asked, because no setting
        within the loss lies nearer.
    changes_before, changes_after : int
        Neighbouring cells of different settings, in the free choice and in this.
    largest_step_before, largest_step_after : int
        Largest difference of stages between neighbouring cells, grid steps.
    """

    choice: TdiChoice
    loss: Array
    too_far: Flags
    changes_before: int
    changes_after: int
    largest_step_before: int
    largest_step_after: int

    @property
    def mean_loss(self) -> float:
        """Mean share of merit given up."""
        return float(self.loss.mean())

    @property
    def worst_loss(self) -> float:
        """Largest share of merit given up."""
        return float(self.loss.max(initial=0.0))


def steady_choice(
    model: ColumnMtf,
    choice: TdiChoice,
    hysteresis: float = 0.01,
    *,
    largest_step: int | None = None,
    along: str = "columns",
    factors: MeritFactors | None = None,
) -> SteadyChoice:
    """A choice of as few changes as possible, each cell within `hysteresis` of its best merit.

    Parameters
    ----------
    model : ColumnMtf
        Of the columns of `choice`.
    choice : TdiChoice
    hysteresis : float
        Share of its merit that a cell may lose, 0 up to 1.
    largest_step : int, optional
        Largest change of the number of stages between neighbouring cells, steps of the grid; any by default.
        Kept wherever the hysteresis leaves a way; elsewhere `too_far` says so.
    along : str
        ``"columns"``: one signal after the other, its changes from column to column; or ``"signals"``: one
        column after the other, its changes from signal to signal.
    factors : MeritFactors, optional
        Of `model` and `choice`, where they are known already.

    Returns
    -------
    SteadyChoice

    Raises
    ------
    InputError
        A hysteresis or step that cannot be.

    Notes
    -----
    Optimal: fewest steps too far, then fewest changes, then least total loss (dynamic programming, a
    shortest path). Merits are compared in single precision.
    """
    step = checked_hysteresis(hysteresis, largest_step)
    if along not in DIRECTIONS:
        raise InputError(f"`along` is {along!r}; allowed are {', '.join(DIRECTIONS)}")
    both = factors if factors is not None else merit_factors(model, choice)
    setting, far = np.empty_like(choice.setting), np.empty(choice.setting.shape, dtype=bool)
    axis = DIRECTIONS.index(along)
    length, others = setting.shape[axis], setting.shape[1 - axis]
    levels = int(min(_LEVELS, 2**62 // (length + 2) ** 3))
    needed = _NEEDED[choice.limit]
    for i in range(others):
        cells = (slice(None), i) if axis == 0 else (i, slice(None))
        path, jumps = np.empty(length, dtype=np.intp), np.empty(length, dtype=bool)
        fewest_changes(
            *_factors_along(both, i, axis, length),
            np.ascontiguousarray(choice.setting[cells]), np.ascontiguousarray(needed[cells]),
            float(hysteresis), len(choice.grid.ratios), step, levels, path, jumps,
        )  # fmt: skip
        setting[cells], far[cells] = path, jumps
    steady = with_settings(model, choice, setting)
    before, after = (_differences(c.setting, len(c.grid.ratios), axis) for c in (choice, steady))
    return SteadyChoice(
        steady, _loss(both, choice.setting, setting), far, before[0], after[0], before[1], after[1]
    )


def _factors_along(both: MeritFactors, i: int, axis: int, length: int) -> tuple[Single, Small, Single, Small]:
    """Factor that varies along a line of cells with what settings keep, and the same of the other factor."""
    if axis == 1:
        rows = slice(both.first[i], both.first[i] + length)
        return both.by_signal[rows], both.signal_kept[rows], both.by_column[i], both.column_kept[i]
    rows_of = both.rows(i, np.arange(length))
    if (rows_of == rows_of[0]).all():
        return both.by_column, both.column_kept, both.by_signal[rows_of[0]], both.signal_kept[rows_of[0]]
    # unlike columns see a signal unlike: all of it varies
    of_column = both.by_column * both.by_signal[rows_of], both.column_kept | both.signal_kept[rows_of]
    return *of_column, np.ones_like(both.by_signal[0]), np.zeros_like(both.signal_kept[0])


def checked_hysteresis(hysteresis: float, largest_step: int | None) -> int:
    """The largest step as the kernels take it; InputError for a hysteresis or step that cannot be."""
    if not 0.0 <= hysteresis < 1.0:
        raise InputError(f"`hysteresis` is {hysteresis:g}; a share of the merit from 0 up to 1 is allowed")
    if largest_step is not None and largest_step < 1:
        raise InputError(f"`largest_step` is {largest_step}; 1 or more steps of the grid are allowed")
    return -1 if largest_step is None else int(largest_step)


def _differences(setting: Index, n_ratios: int, axis: int) -> tuple[int, int]:
    """Number of neighbours that differ, and their largest difference of stages in grid steps."""
    rows = np.abs(np.diff(setting // n_ratios, axis=axis))
    return int(np.count_nonzero(np.diff(setting, axis=axis))), int(rows.max(initial=0))


def _loss(factors: MeritFactors, best: Index, setting: Index) -> Array:
    """(C, S) share of merit lost where `setting` (C, S) stands for `best`."""
    column, signal = np.ogrid[: setting.shape[0], : setting.shape[1]]
    row = factors.rows(signal, column)

    def merit(of: Index) -> Array:
        product = factors.by_column[column, of].astype(np.float64) * factors.by_signal[row, of]
        return np.asarray(product)

    free, taken = merit(best), merit(setting)
    share = 1.0 - np.divide(taken, free, out=np.ones_like(free), where=free > 0.0)
    return np.asarray(np.maximum(share, 0.0))


def with_settings(model: ColumnMtf, choice: TdiChoice, setting: Index) -> TdiChoice:
    """A choice with other settings (C, S), their MTF and SNR; its limits stay those of `choice`."""
    mtf = np.empty((*setting.shape, 2))
    for begin in range(0, len(setting), CHUNK):
        part = slice(begin, min(begin + CHUNK, len(setting)))
        system = model.central(part) * choice.columns.static_mtf[part][:, None, :]
        mtf[part] = np.take_along_axis(system, setting[part][..., None], axis=1)
    snr = np.empty(setting.shape)
    for of_kind, places in choice.detector.by_kind(choice.columns):
        of_signals = signal_factors(choice.signals, choice.grid, of_kind, choice.rules)
        snr[places] = np.take_along_axis(of_signals.snr, setting[places].T, axis=1).T
    return replace(choice, setting=setting, mtf=mtf, snr=snr)


def signal_cells(measured: ArrayLike, signals: Array) -> Index:
    """Number of the nearest of the rising `signals` (S,) by ratio; the first for 0 and below."""
    borders = np.sqrt(signals[1:] * signals[:-1])
    return np.asarray(np.searchsorted(borders, np.asarray(measured, dtype=np.float64), side="right"))


def nearest_settings(choice: TdiChoice, signals: ArrayLike) -> Index:
    """The choice of the nearest signal for column groups, lines (L, G) or one line (G,), without memory."""
    return np.asarray(choice.setting[np.arange(len(choice.columns)), signal_cells(signals, choice.signals)])


@dataclass(eq=False)
class LineHold:
    """Settings of column groups from line to line, held while they are good enough.

    The last setting stays while it loses no more than `hysteresis` under the new signal and keeps the limits.
    Otherwise it moves to the best, by no more than `largest_step` per line; a well that overflows is left at
    once, whatever the step. On the way, bounds of MTF and SNR may be missed for some lines.

    Attributes
    ----------
    choice : TdiChoice
        Of the column groups.
    factors : MeritFactors
        By which `choice` was made.
    hysteresis : float
        Share of its merit that a cell may lose.
    largest_step : int or None
        Largest change of the number of stages from line to line, steps of the grid.
    last : (G,) int
        Settings of the last line, -1 before the first.
    """

    choice: TdiChoice
    factors: MeritFactors
    hysteresis: float = 0.01
    largest_step: int | None = None

    def __post_init__(self) -> None:
        self._step = checked_hysteresis(self.hysteresis, self.largest_step)
        self.last: Index = np.full(len(self.choice.columns), -1, dtype=np.intp)

    def __call__(self, signals: ArrayLike) -> Index:
        """Settings of the next lines (L, G), or of one (G,), from their signals of the same shape."""
        cells = signal_cells(signals, self.choice.signals)
        lines = np.ascontiguousarray(np.atleast_2d(cells))
        out = np.empty(lines.shape, dtype=np.intp)
        both = self.factors
        hold(
            both.by_column, both.column_kept, both.by_signal, both.signal_kept, both.first,
            self.choice.setting, _NEEDED[self.choice.limit],
            float(self.hysteresis), len(self.choice.grid.ratios), self._step, lines, self.last, out,
        )  # fmt: skip
        return out.reshape(cells.shape)

    def infeasible(self, signals: ArrayLike) -> Flags:
        """Where no setting keeps all limits of the nearest signal; shapes as of a call."""
        cell = signal_cells(signals, self.choice.signals)
        return np.asarray(self.choice.infeasible[np.arange(len(self.choice.columns)), cell])


def line_loss(factors: MeritFactors, choice: TdiChoice, setting: Index, signals: ArrayLike) -> Array:
    """Share of merit (L, G) that settings of lines lose against the choice of the nearest signal.

    Parameters
    ----------
    factors : MeritFactors
    choice : TdiChoice
        Of the column groups.
    setting : (L, G) int
    signals : (L, G)
        Electrons of one line, as `choice.signals` are given.
    """
    cell = signal_cells(signals, choice.signals)
    group = np.broadcast_to(np.arange(setting.shape[1]), setting.shape)
    row = factors.rows(cell, group)

    def merit(of: Index) -> Array:
        return np.asarray(factors.by_column[group, of].astype(np.float64) * factors.by_signal[row, of])

    free, taken = merit(choice.setting[group, cell]), merit(setting)
    return np.asarray(1.0 - np.divide(taken, free, out=np.ones_like(free), where=free > 0.0))
