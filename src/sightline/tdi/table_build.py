"""A table that keeps a bound on the loss of merit, with few bytes, and the certificate that it does.

Columns are sampled, signals are cut into short stretches. For every sampled column and stretch the settings
that lose little at both ends are bits of a set; columns and signals may share a cell where their sets
intersect. Groups of columns are chosen so that the table is smallest. It is then judged at every column, on
signals several times denser, and sampled closer where it fails.

Not here: the table itself (``table.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.tdi.choose import CHUNK, INFEASIBLE, SATURATION, SNR, TdiChoice
from sightline.tdi.merit import (
    ColumnMtf,
    SignalFactors,
    column_factors,
    fullest_signals,
    signal_factors,
    unsaturated,
    well_levels,
)
from sightline.tdi.setting import Array, Index
from sightline.tdi.table import INFEASIBLE as INFEASIBLE_FLAG
from sightline.tdi.table import STAGE_BITS, TdiTable, check_words_fit
from sightline.tdi.table_kernels import (
    BLOCK,
    FEASIBLE,
    MIXED,
    add_to_group,
    best_merits,
    bounds_of_blocks,
    cheapest_groups,
    fairest_setting,
    good_settings,
    largest_products,
    split_signals,
)

Bits = NDArray[np.uint64]
Small = NDArray[np.uint8]

#: Columns that are sampled at first.
SAMPLES = 1024
#: A failing block of columns is cut into so many.
FINER = 8
#: Ratio of neighbouring signals where no limit is near.
SIGNAL_STEP = 1.1
#: Most stretches that signals are cut into.
MOST_STRETCHES = 1500
#: Ratio of signals up to which feasible and infeasible columns share a (flagged) cell.
MIXED_SPAN = 1.05
#: Ratio of neighbouring signals, less 1, as a share of the bound: where limits of the SNR are near, and where
#: wells decide.
NEAR_STEP, SMOOTH_STEP = 0.5, 2.0
#: Columns that say at which signals wells cut off their best settings.
WELL_COLUMNS = 33
#: A fall of the best merit that counts, as a share of the bound.
WELL_STEP = 0.25
#: Share of the bound that cells are built to; the rest is for what lies between samples.
BUILT_TO = 0.98
#: Share by which that falls for columns in which the bound was broken.
TIGHTER = 0.02
#: Signals judged per nominal one.
DENSER = 4
#: Ends of stretches worked on at once; even.
AT_ONCE = 256
#: Whole electrons judged one by one from the lowest signal on.
LOWEST = 32
#: Signals judged together.
SIGNAL_BLOCK = 16
ROUNDS = 8
#: Just below: signals have parts of an electron, which the table drops.
BELOW = 1.0 - 1e-9
#: Memory for sets of settings, bytes.
PANEL_BYTES = 96 << 20


@dataclass(frozen=True, eq=False)
class Certificate:
    """What a table was found to lose.

    Attributes
    ----------
    max_loss : float
        Relative loss of merit that was asked for.
    loss : float
        Worst found, where some setting keeps all limits; 1 where the table's would break one. A limit is
        kept where all signals keep it that the table cannot tell apart.
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
        Of the table's memory image, all told.
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


def build_table(model: ColumnMtf, choice: TdiChoice, max_loss: float = 0.005) -> tuple[TdiTable, Certificate]:
    """The smallest table found that loses at most `max_loss` against the best setting everywhere.

    Parameters
    ----------
    model : ColumnMtf
        What motion does to each column; the one that the choice was made with.
    choice : TdiChoice
    max_loss : float
        Largest relative loss of merit, above 0, below 1.

    Returns
    -------
    table, certificate
        Where quantised signals are too coarse for the bound, the certificate says so (`holds`).

    Raises
    ------
    InputError
        A bound that cannot be; settings that do not fit a word; columns or signals that cannot be counted.

    Notes
    -----
    A limit is as hard in the table as in the choice: the setting of a cell keeps it from the lower end of its
    signals to the upper one. Where no setting can, the word is flagged, its setting is one that the choice
    falls back to there, and the bound is not promised. Between columns that the choice does not name the
    nearest is taken.
    """
    if not 0.0 < max_loss < 1.0:
        raise InputError(f"`max_loss` is {max_loss:g}; a share of the merit above 0 and below 1 is allowed")
    check_words_fit(choice.grid)
    _check_axes(choice)
    builder = _Builder(model, choice, max_loss)
    samples = _first_samples(len(choice.columns))
    codes = np.union1d(first_codes(choice, max_loss), well_codes(model, choice, max_loss))
    best: tuple[TdiTable, Certificate] | None = None
    for _ in range(ROUNDS):
        table, samples = builder.build(samples, codes)
        certificate, failed = certify(model, choice, table, max_loss)
        if best is None or certificate.loss < best[1].loss:
            best = table, certificate
        finer = _finer_samples(samples, failed, len(choice.columns))
        finer_codes = codes if len(finer) > len(samples) else _finer_codes(codes, failed)
        exhausted = len(finer) == len(samples) and len(finer_codes) == len(codes)
        if certificate.holds or exhausted or len(finer_codes) > 2 * MOST_STRETCHES:
            break
        builder.tighten(failed[0])
        samples, codes = finer, finer_codes
    assert best is not None  # there is a first round
    table, certificate = best
    at_limits = _loss_at_limits(model, choice, table)
    return replace(table, certified_loss=certificate.loss), replace(certificate, at_limits=at_limits)


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
        Against the best that keeps limits for the signal itself, not for all that the table cannot tell from
        it.
    """
    grid, rules = choice.grid, choice.rules
    if own_limits:
        by_signal = signal_factors(signals, grid, choice.detector, rules).allowed
    else:
        by_signal = np.concatenate(
            [
                whole_electrons(signals[k : k + AT_ONCE], choice).allowed
                for k in range(0, len(signals), AT_ONCE)
            ]
        )
    setting, group = _settings_at(table, choice, signals)
    loss = np.empty((len(group), len(signals)))
    blocks = _signal_blocks(by_signal)
    for begin in range(0, len(choice.columns), CHUNK):
        part = slice(begin, min(begin + CHUNK, len(choice.columns)))
        a = column_factors(model, part, grid, rules).allowed
        for block, best in zip((b for b, *_ in blocks), _best_of_blocks(a, by_signal, blocks), strict=True):
            chosen = setting[group[part], block]
            merit = np.take_along_axis(a, chosen, axis=1)
            merit *= np.take_along_axis(by_signal[block], chosen.T, axis=1).T
            with np.errstate(invalid="ignore", divide="ignore"):
                loss[part, block] = np.where(best > 0.0, np.maximum(1.0 - merit / best, 0.0), np.nan)
    return loss


def _signal_blocks(by_signal: Array) -> list[tuple[slice, Array, Array]]:
    """Signals (S, P) in blocks, and what each gives to every setting at least and at most."""
    blocks = [slice(k, k + SIGNAL_BLOCK) for k in range(0, len(by_signal), SIGNAL_BLOCK)]
    return [(block, by_signal[block].min(axis=0), by_signal[block].max(axis=0)) for block in blocks]


def _best_of_blocks(a: Array, by_signal: Array, blocks: list[tuple[slice, Array, Array]]) -> Iterator[Array]:
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


def _loss_at_limits(model: ColumnMtf, choice: TdiChoice, table: TdiTable) -> float:
    """Worst loss at those signals whose own limits allow more than whole electrons do, unflagged ones."""
    signals = dense_signals(choice.signals, table)
    near = np.zeros(len(signals), dtype=bool)
    for k in range(0, len(signals), AT_ONCE):
        part = signals[k : k + AT_ONCE]
        own = signal_factors(part, choice.grid, choice.detector, choice.rules).allowed
        near[k : k + AT_ONCE] = (own != whole_electrons(part, choice).allowed).any(axis=1)
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


def _check_axes(choice: TdiChoice) -> None:
    """InputError where columns or signals cannot be counted."""
    column, signals = choice.columns.column, choice.signals
    if (column < 0).any() or (column != np.floor(column)).any() or (np.diff(column) <= 0).any():
        raise InputError(
            "the table needs columns that are whole numbers, rising, from 0 up; number them so in the choice"
        )
    if not (np.isfinite(signals).all() and signals.min() >= 0.0 and signals.max() < 2.0**31):
        raise InputError(
            f"the table needs signals from 0 to 2^31 electrons; those given reach from {signals.min():g} to "
            f"{signals.max():g}"
        )


def _first_samples(count: int) -> Index:
    """Numbers of the columns that are sampled first, first and last included."""
    return np.unique(np.linspace(0, count - 1, min(count, SAMPLES)).round().astype(np.intp))


def _finer_samples(samples: Index, failed: tuple[Index, Array], count: int) -> Index:
    """Samples with those blocks cut that hold columns at which the bound is broken."""
    return _cut(samples, np.unique(np.searchsorted(samples, failed[0], side="right") - 1), count)


def _cut(samples: Index, blocks: Index, count: int) -> Index:
    ends = np.append(samples, count)
    more = [np.linspace(ends[k], ends[k + 1], FINER + 1)[:-1].astype(np.intp) for k in blocks]
    return np.unique(np.concatenate([samples, *more]))


def shift_of(signals: Array) -> int:
    """Bits that quantisation drops so that all signals, and one step more, fit 16 bits."""
    return max(int(signals.max() + 1.0).bit_length() - 16, 0)


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
    # where wells cut settings off `well_codes` tells; between these the merit is smooth
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
    unit, low, high = 2.0 ** shift_of(choice.signals), choice.signals.min(), choice.signals.max()
    full = fullest_signals(choice.grid, choice.detector, choice.rules)
    full = full[(full >= low) & (full < high)] / unit
    # where one is a whole number but for rounding, both sides
    codes = np.unique(np.floor(np.concatenate([full * BELOW, full / BELOW])))
    codes = codes[(codes * unit > low) & (codes * unit < high)]
    a = np.concatenate(
        [
            column_factors(model, np.array([k]), choice.grid, choice.rules).allowed
            for k in np.unique(np.linspace(0, len(choice.columns) - 1, WELL_COLUMNS).astype(np.intp))
        ]
    )
    missed = np.zeros(len(codes), dtype=bool)
    for begin in range(0, len(codes), AT_ONCE // 2):
        at = codes[begin : begin + AT_ONCE // 2] * unit
        by_signal = whole_electrons(np.stack([at * BELOW, at], axis=1).ravel(), choice).allowed
        best = np.concatenate(list(_best_of_blocks(a, by_signal, _signal_blocks(by_signal))), axis=1)
        falls = best[:, 1::2] < (1.0 - WELL_STEP * max_loss) * best[:, ::2]
        missed[begin : begin + AT_ONCE // 2] = falls.any(axis=0)
    return codes[missed].astype(np.intp)


def _between(limit: NDArray[np.uint8], which: tuple[int, ...]) -> NDArray[np.bool_]:
    """(S - 1,) whether at one of two neighbouring signals such a limit decides, in any column."""
    some = np.asarray(np.isin(limit, which).any(axis=0))
    return np.asarray(some[:-1] | some[1:])


def _finer_codes(codes: Index, failed: tuple[Index, Array]) -> Index:
    """Codes with those stretches cut in which the bound is broken."""
    # both neighbours too: a cell that ends there may be at fault
    place = np.searchsorted(codes, np.unique(failed[1]), side="right") - 1
    place = np.unique(np.clip(np.concatenate([place - 1, place, place + 1]), 0, max(len(codes) - 2, 0)))
    more = [
        np.linspace(codes[k], codes[k + 1], 5).round().astype(np.intp) for k in place if k + 1 < len(codes)
    ]
    return np.unique(np.concatenate([codes, *more]))


@dataclass(frozen=True, eq=False)
class _Panel:
    """Settings that sampled columns can take, by stretch of signals, and the merits behind them."""

    columns: Index
    level: Small
    merit: Array
    best: Array
    tiers: Small
    strict: Bits
    loose: Bits
    kind: Small


@dataclass(frozen=True, eq=False)
class _SignalAxis:
    """Stretches of signals from code to code, and what signals give to the merit at both ends of each.

    `safe` is zero, and `safe_level` too, for settings with which a well overflows anywhere in the stretch.
    `least` and `most` are bounds of `allowed` over blocks of ends.
    """

    codes: Index
    ends: Array
    allowed: Array
    level: Small
    merit: Array
    safe: Array
    safe_level: Small
    least_full: Index
    least: Array
    most: Array


@dataclass(eq=False)
class _Builder:
    """Builds a table panel by panel; panels whose samples have not changed are kept from round to round."""

    model: ColumnMtf
    choice: TdiChoice
    max_loss: float
    axis: _SignalAxis | None = None
    begins: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    built_to: dict[int, float] = field(default_factory=dict)
    kept: dict[tuple[int, float, bytes], tuple[list[_Group], Index]] = field(default_factory=dict)

    def build(self, samples: Index, codes: Index) -> tuple[TdiTable, Index]:
        """Table from sampled columns, and the samples, to which those are added that blocks need."""
        if self.axis is None or not np.array_equal(self.axis.codes, codes):
            self.axis = _signal_axis(codes, self.choice)
            self.kept.clear()
        count = len(self.choice.columns)
        while True:
            self._set_panels(samples, self.axis)
            ends = np.append(np.searchsorted(samples, self.begins), len(samples))
            built = [self._built(samples, int(a), int(b), self.axis) for a, b in pairwise(ends)]
            broken = np.concatenate([invalid for _, invalid in built])
            if not len(broken):
                return self._table([group for groups, _ in built for group in groups], self.axis), samples
            samples = _cut(samples, np.searchsorted(samples, broken), count)

    def tighten(self, failed: Index) -> None:
        """Leave more room in panels that hold columns at which the bound is broken."""
        for panel in np.unique(np.searchsorted(self.begins, failed, side="right") - 1):
            first = int(self.begins[panel])
            self.built_to[first] = self.built_to.get(first, BUILT_TO) * (1.0 - TIGHTER)

    def _built(self, samples: Index, begin: int, end: int, axis: _SignalAxis) -> tuple[list[_Group], Index]:
        """Groups of a panel, or the columns at which blocks begin that must be cut first."""
        # the first column after a block is its last but one step: it tells what lies between
        columns = samples[begin : end + 1]
        share = self.built_to.get(int(columns[0]), BUILT_TO)
        key = (end - begin, share, columns.tobytes())
        if key not in self.kept:
            panel = self._panel(columns, axis, 1.0 - share * self.max_loss)
            blocks, invalid = _blocks(panel, axis, end - begin, len(self.choice.columns))
            groups = [] if len(invalid) else _groups(panel, blocks, axis, self._bytes())
            self.kept[key] = groups, columns[invalid]
        return self.kept[key]

    def _set_panels(self, samples: Index, axis: _SignalAxis) -> None:
        """Columns at which runs of samples begin that fit the memory; those there are stay."""
        stretches, settings = len(axis.codes), len(self.choice.grid)
        each = stretches * (settings // 64 + 1) * 32 + settings * 32
        size = max(PANEL_BYTES // each, 64)
        if not len(self.begins):
            self.begins = samples[::size]
        ends = np.append(np.searchsorted(samples, self.begins), len(samples))
        more = [samples[a + size : b : size] for a, b in pairwise(ends) if b - a > 2 * size]
        self.begins = np.unique(np.concatenate([self.begins, *more]))

    def _bytes(self) -> tuple[int, int]:
        """Of a group and of a cell."""
        return (4 if self.choice.columns.column[-1] < 1 << 16 else 8), 4

    def _panel(self, columns: Index, axis: _SignalAxis, keep: float) -> _Panel:
        choice, ends = self.choice, len(axis.ends)
        n, settings = len(columns), len(choice.grid)
        words = settings // 64 + 1
        level, merit = np.empty((n, settings), dtype=np.uint8), np.empty((n, settings))
        allowed = np.empty((n, settings))
        for k, part in _slices(columns):
            factors = column_factors(self.model, part, choice.grid, choice.rules)
            here = slice(k, k + len(factors.merit))
            merit[here], allowed[here] = factors.merit, factors.allowed
            level[here] = 1 + factors.in_lobe + (factors.in_lobe & factors.in_bounds)
        best, tiers = np.empty((n, ends)), np.empty((n, ends), dtype=np.uint8)
        best_merits(
            allowed, level, merit, axis.allowed, axis.least, axis.most, axis.level, axis.merit, axis.ends,
            best, tiers,
        )  # fmt: skip
        shape = (n, ends // 2)
        strict, loose = np.empty((*shape, words), dtype=np.uint64), np.empty((*shape, words), dtype=np.uint64)
        kind = np.empty(shape, dtype=np.uint8)
        good_settings(
            allowed, level, merit, axis.safe, axis.least, axis.most, axis.safe_level, axis.merit,
            axis.least_full, best, tiers, keep, strict, loose, kind,
        )  # fmt: skip
        return _Panel(columns, level, merit, best, tiers, strict, loose, kind)

    def _table(self, groups: list[_Group], axis: _SignalAxis) -> TdiTable:
        choice, exposure = self.choice, self.choice.detector.exposure
        column = choice.columns.column.astype(np.intp)
        first = [0] + [int(column[g.first - 1] + column[g.first]) // 2 + 1 for g in groups[1:]]
        first[0] = int(column[0])
        thresholds = [np.where(np.arange(len(g.stretch)) == 0, 0, axis.codes[g.stretch]) for g in groups]
        setting = np.concatenate([g.setting for g in groups])
        ratios = len(choice.grid.ratios)
        words = choice.grid.stages_of(setting) | (setting % ratios) << STAGE_BITS
        words = words | np.where(np.concatenate([g.flagged for g in groups]), INFEASIBLE_FLAG, 0)
        return TdiTable(
            np.append(first, column[-1] + 1),
            np.concatenate([[0], np.cumsum([len(g.stretch) for g in groups])]).astype(np.intp),
            np.concatenate(thresholds).astype(np.uint16),
            words.astype(np.uint16),
            choice.grid.ratios,
            (float(choice.signals.min()), float(choice.signals.max())),
            0.0,
            shift_of(choice.signals),
            choice.detector.signal_ratio,
            exposure.head_stages if choice.detector.signal_ratio == exposure.head_ratio else 0,
        )


@dataclass(frozen=True, eq=False)
class _Group:
    """Columns that share their cells: its first, and the first stretch, setting and flag of each cell."""

    first: int
    stretch: Index
    setting: Index
    flagged: NDArray[np.bool_]


def _slices(columns: Index) -> list[tuple[int, slice]]:
    """Columns that rise, as slices of few: (place, slice); the step between them may vary."""
    steps = np.diff(columns)
    found, k = [], 0
    while k < len(columns):
        step = int(steps[k]) if k < len(steps) else 1
        end = k + 1
        while end < min(len(columns), k + CHUNK) and steps[end - 1] == step:
            end += 1
        found.append((k, slice(int(columns[k]), int(columns[end - 1]) + 1, step)))
        k = end
    return found


def whole_electrons(signals: Array, choice: TdiChoice) -> SignalFactors:
    """What signals give to the merit; limits are kept by all that the table cannot tell from them."""
    grid, detector, rules = choice.grid, choice.detector, choice.rules
    unit = 2.0 ** shift_of(choice.signals)
    whole = np.floor(signals / unit) * unit
    most = unsaturated(np.minimum(whole + unit, choice.signals.max()), grid, detector, rules)
    factors = signal_factors(signals, grid, detector, rules)
    clear = factors.clear
    if rules.snr_min > 0.0:
        least = signal_factors(np.maximum(whole, choice.signals.min()), grid, detector, rules)
        clear = clear & least.clear
    return replace(factors, unsaturated=factors.unsaturated & most, clear=clear)


def _signal_axis(codes: Index, choice: TdiChoice) -> _SignalAxis:
    """Stretches from code to code, each up to where the next begins."""
    low, high = float(choice.signals.min()), float(choice.signals.max())
    first = np.clip(codes * 2.0 ** shift_of(choice.signals), low, high)
    last = np.maximum(np.append(first[1:], high) * BELOW, first)
    ends = np.stack([first, last], axis=1).ravel()
    shape = (len(ends), len(choice.grid))
    blocks = (-(-len(ends) // BLOCK), len(choice.grid))
    axis = _SignalAxis(
        codes, ends, np.empty(shape), np.empty(shape, dtype=np.uint8), np.empty(shape, dtype=np.float32),
        np.empty(shape), np.empty(shape, dtype=np.uint8), np.empty(len(ends), dtype=np.intp),
        np.empty(blocks), np.empty(blocks),
    )  # fmt: skip
    for begin in range(0, len(ends), AT_ONCE):
        part = slice(begin, begin + AT_ONCE)
        factors = whole_electrons(ends[part], choice)
        # what overflows at the upper end of a stretch is no setting for it
        safe = np.repeat(factors.unsaturated[1::2], 2, axis=0)
        axis.allowed[part], axis.merit[part] = factors.allowed, factors.merit
        axis.level[part] = np.where(factors.unsaturated, 1 + factors.clear, 0)
        axis.safe[part] = np.where(safe, axis.allowed[part], 0.0)
        axis.safe_level[part] = np.where(safe, axis.level[part], 0)
        axis.least_full[part] = _least_full(ends[part], choice)
    bounds_of_blocks(axis.allowed, axis.least, axis.most)
    return axis


def _least_full(signals: Array, choice: TdiChoice) -> Index:
    """(S,) setting that fills the fuller of its two wells least."""
    line, total = well_levels(signals, choice.grid, choice.detector)
    full = np.maximum(line / choice.detector.full_well_line, total / choice.detector.full_well_sum)
    return np.asarray(full.argmin(axis=1))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Settings that all columns from one sample to the next can take."""

    strict: Bits
    loose: Bits
    kind: Small


def _blocks(panel: _Panel, axis: _SignalAxis, count: int, after: int) -> tuple[_Blocks, Index]:
    """The first `count` blocks of columns between samples, and those in which no setting suits both ends."""
    strict, loose, kind = panel.strict[:count].copy(), panel.loose[:count].copy(), panel.kind[:count].copy()
    wide = np.flatnonzero(np.diff(panel.columns, append=after)[:count] > 1)
    starts = np.empty(strict.shape[1], dtype=np.int64)
    invalid = []
    for k in wide:
        if k + 1 < len(panel.strict):
            add_to_group(
                strict[k], loose[k], kind[k], panel.strict[k + 1], panel.loose[k + 1], panel.kind[k + 1]
            )
        if split_signals(strict[k], loose[k], kind[k], axis.ends, MIXED_SPAN, starts) == 0:
            invalid.append(k)
    return _Blocks(strict, loose, kind), np.array(invalid, dtype=np.intp)


def _groups(panel: _Panel, blocks: _Blocks, axis: _SignalAxis, size: tuple[int, int]) -> list[_Group]:
    """Columns of a panel in groups such that the table is smallest, with their cells."""
    origin = np.zeros(len(blocks.kind) + 1, dtype=np.intp)
    cheapest_groups(blocks.strict, blocks.loose, blocks.kind, axis.ends, MIXED_SPAN, *size, origin)
    begins, end = [], len(blocks.kind)
    while end > 0:
        begins.append((int(origin[end]), end))
        end = int(origin[end])
    return [_group(panel, blocks, axis, begin, end) for begin, end in reversed(begins)]


def _group(panel: _Panel, blocks: _Blocks, axis: _SignalAxis, begin: int, end: int) -> _Group:
    strict, loose, kind = (v[begin].copy() for v in (blocks.strict, blocks.loose, blocks.kind))
    for k in range(begin + 1, end):
        add_to_group(strict, loose, kind, blocks.strict[k], blocks.loose[k], blocks.kind[k])
    starts = np.empty(len(kind), dtype=np.int64)
    span = MIXED_SPAN if end - begin > 1 else np.inf
    cells = split_signals(strict, loose, kind, axis.ends, span, starts)
    stretch = starts[:cells]
    columns = np.arange(begin, min(end + 1, len(panel.columns)) if _reaches(panel, end) else end)
    setting = np.empty(cells, dtype=np.intp)
    for cell, (a, b) in enumerate(zip(stretch, np.append(stretch[1:], len(kind)), strict=True)):
        shared = np.bitwise_and.reduce((loose if kind[a] == MIXED else strict)[a:b], axis=0)
        candidates = np.flatnonzero(np.unpackbits(shared.view(np.uint8), bitorder="little"))
        setting[cell] = fairest_setting(
            columns, a, b, candidates, kind[a], panel.level, panel.merit, axis.level, axis.merit,
            axis.least_full, panel.best, panel.tiers,
        )  # fmt: skip
    return _Group(int(panel.columns[begin]), stretch.astype(np.intp), setting, kind[stretch] != FEASIBLE)


def _reaches(panel: _Panel, end: int) -> bool:
    """Whether the block before `end` has columns between it and the next sample."""
    return end < len(panel.columns) and bool(panel.columns[end] - panel.columns[end - 1] > 1)
