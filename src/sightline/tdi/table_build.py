"""A table that keeps a bound on the loss of merit, with few bytes.

Columns are sampled, signals are cut into short stretches. For every sampled column and stretch the settings
that lose little at both ends are bits of a set; columns and signals may share a cell where their sets
intersect. Groups of columns are chosen so that the table is smallest. It is then judged at every column, on
signals several times denser, and sampled closer where it fails.

Not here: the table itself (``table.py``), where stretches begin (``table_stretches.py``), what the table
loses at worst (``table_certificate.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.tdi.choose import CHUNK, TdiChoice
from sightline.tdi.hysteresis import checked_hysteresis
from sightline.tdi.merit import (
    ColumnMtf,
    column_factors,
    well_levels,
)
from sightline.tdi.setting import STAGE_BITS, Array, Index, TdiDetector
from sightline.tdi.steady_kernels import fewest_changes
from sightline.tdi.table import INFEASIBLE as INFEASIBLE_FLAG
from sightline.tdi.table import TdiTable, check_words_fit
from sightline.tdi.table_certificate import (
    AT_ONCE,
    BELOW,
    Certificate,
    certify,
    loss_at_limits,
    shift_of,
    whole_electrons,
)
from sightline.tdi.table_kernels import (
    BLOCK,
    FEASIBLE,
    MIXED,
    add_to_group,
    best_merits,
    bounds_of_blocks,
    cheapest_groups,
    first_largest,
    good_settings,
    split_signals,
    worst_shares,
)
from sightline.tdi.table_stretches import MOST_STRETCHES, finer_codes, first_codes, well_codes

Bits = NDArray[np.uint64]
Small = NDArray[np.uint8]

#: Columns that are sampled at first.
SAMPLES = 1024
#: A failing block of columns is cut into so many.
FINER = 8
#: Ratio of signals up to which feasible and infeasible columns share a (flagged) cell.
MIXED_SPAN = 1.05
#: Share of the bound that cells are built to; the rest is for what lies between samples.
BUILT_TO = 0.98
#: Share by which that falls for columns in which the bound was broken.
TIGHTER = 0.02
ROUNDS = 8
#: Memory for sets of settings, bytes.
PANEL_BYTES = 96 << 20
#: Memory for what signals give to kinds of columns, bytes.
AXES_BYTES = 384 << 20
#: Where words are kept steady: share that a candidate of little worth counts with, and levels of its loss.
LEAST_SHARE, LOSS_LEVELS = 1e-6, 1000


def build_table(
    model: ColumnMtf,
    choice: TdiChoice,
    max_loss: float = 0.005,
    *,
    hysteresis: float = 0.0,
    largest_step: int | None = None,
) -> tuple[TdiTable, Certificate]:
    """The smallest table found that loses at most `max_loss` against the best setting everywhere.

    Parameters
    ----------
    model : ColumnMtf
        What motion does to each column; the one that the choice was made with.
    choice : TdiChoice
    max_loss : float
        Largest relative loss of merit, above 0, below 1.
    hysteresis : float
        Share of its merit that a column may lose besides, so that fewer words change from group to group of
        columns: the bound is then both together, against the free choice.
    largest_step : int, optional
        Largest change of the number of stages from group to group, steps of the grid, wherever the bound
        leaves a way; any by default.

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
    step = checked_hysteresis(hysteresis, largest_step)
    if hysteresis > 0.0:
        max_loss = 1.0 - (1.0 - max_loss) * (1.0 - hysteresis)
    check_words_fit(choice.grid)
    _check_axes(choice)
    steady = step if hysteresis > 0.0 or largest_step is not None else None
    builder = _Builder(model, choice, max_loss, steady)
    samples = _first_samples(len(choice.columns))
    codes = np.union1d(first_codes(choice, max_loss), well_codes(model, choice, max_loss))
    best: tuple[TdiTable, Certificate] | None = None
    for _ in range(ROUNDS):
        table, samples = builder.build(samples, codes)
        certificate, failed = certify(model, choice, table, max_loss)
        if best is None or certificate.loss < best[1].loss:
            best = table, certificate
        finer = _finer_samples(samples, failed, len(choice.columns))
        closer = codes if len(finer) > len(samples) else finer_codes(codes, failed)
        exhausted = len(finer) == len(samples) and len(closer) == len(codes)
        if certificate.holds or exhausted or len(closer) > 2 * MOST_STRETCHES:
            break
        builder.tighten(failed[0])
        samples, codes = finer, closer
    assert best is not None  # there is a first round
    table, certificate = best
    at_limits = loss_at_limits(model, choice, table)
    return replace(table, certified_loss=certificate.loss), replace(certificate, at_limits=at_limits)


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


@dataclass(frozen=True, eq=False)
class _Panel:
    """Settings that sampled columns can take, by stretch of signals, and the merits behind them."""

    columns: Index
    ends: Array
    level: Small
    merit: Array
    best: Array
    tiers: Small
    strict: Bits
    loose: Bits
    kind: Small


@dataclass(frozen=True, eq=False)
class _SignalAxis:
    """Stretches of signals from code to code, and what signals give one kind of column at both ends of each.

    `safe` is zero, and `safe_level` too, for settings with which a well overflows anywhere in the stretch.
    `least` and `most` are bounds of `allowed` over blocks of ends.
    """

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
    steady: int | None = None
    codes: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    axes: dict[int, _SignalAxis] = field(default_factory=dict)
    begins: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    built_to: dict[int, float] = field(default_factory=dict)
    kept: dict[tuple[int, float, bytes], tuple[list[_Group], Index]] = field(default_factory=dict)

    def build(self, samples: Index, codes: Index) -> tuple[TdiTable, Index]:
        """Table from sampled columns, and the samples, to which those are added that blocks need."""
        if not np.array_equal(self.codes, codes):
            self.codes = codes
            self.axes.clear()
            self.kept.clear()
        count = len(self.choice.columns)
        while True:
            self._set_panels(samples)
            ends = np.append(np.searchsorted(samples, self.begins), len(samples))
            built = [self._built(samples, int(a), int(b)) for a, b in pairwise(ends)]
            broken = np.concatenate([invalid for _, invalid in built])
            if not len(broken):
                return self._table([group for groups, _ in built for group in groups]), samples
            samples = _cut(samples, np.searchsorted(samples, broken), count)

    def tighten(self, failed: Index) -> None:
        """Leave more room in panels that hold columns at which the bound is broken."""
        for panel in np.unique(np.searchsorted(self.begins, failed, side="right") - 1):
            first = int(self.begins[panel])
            self.built_to[first] = self.built_to.get(first, BUILT_TO) * (1.0 - TIGHTER)

    def axis_of(self, detector: TdiDetector) -> _SignalAxis:
        """Of one kind of column; the last few are kept."""
        if id(detector) not in self.axes:
            axis = _signal_axis(self.codes, self.choice, detector)
            while self.axes and (len(self.axes) + 1) * axis.allowed.nbytes * 3 > AXES_BYTES:
                self.axes.pop(next(iter(self.axes)))
            self.axes[id(detector)] = axis
        return self.axes[id(detector)]

    def by_kind(self, columns: Index) -> Iterator[tuple[_SignalAxis, Index | slice]]:
        """Kinds among some columns: what signals give them, and which of the columns they are."""
        scan = self.choice.columns.part(columns)
        for of_kind, rows in self.choice.detector.by_kind(scan):
            yield self.axis_of(of_kind), slice(None) if len(rows) == len(columns) else rows

    def _built(self, samples: Index, begin: int, end: int) -> tuple[list[_Group], Index]:
        """Groups of a panel, or the columns at which blocks begin that must be cut first."""
        # the first column after a block is its last but one step: it shows what lies between
        columns = samples[begin : end + 1]
        share = self.built_to.get(int(columns[0]), BUILT_TO)
        key = (end - begin, share, columns.tobytes())
        if key not in self.kept:
            panel = self._panel(columns, 1.0 - share * self.max_loss)
            blocks, invalid = _blocks(panel, end - begin, len(self.choice.columns))
            groups = [] if len(invalid) else self._groups(panel, blocks)
            self.kept[key] = groups, columns[invalid]
        return self.kept[key]

    def _set_panels(self, samples: Index) -> None:
        """Columns at which runs of samples begin that fit the memory; those there are stay."""
        stretches, settings = len(self.codes), len(self.choice.grid)
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

    def _panel(self, columns: Index, keep: float) -> _Panel:
        choice, ends = self.choice, _ends(self.codes, self.choice)
        n, settings = len(columns), len(choice.grid)
        words = settings // 64 + 1
        level, merit = np.empty((n, settings), dtype=np.uint8), np.empty((n, settings))
        allowed = np.empty((n, settings))
        for k, these in _slices(columns):
            factors = column_factors(self.model, these, choice.grid, choice.rules)
            here = slice(k, k + len(factors.merit))
            merit[here], allowed[here] = factors.merit, factors.allowed
            level[here] = 1 + factors.in_lobe + (factors.in_lobe & factors.in_bounds)
        panel = _Panel(
            columns, ends, level, merit, np.empty((n, len(ends))), np.empty((n, len(ends)), dtype=np.uint8),
            np.empty((n, len(self.codes), words), dtype=np.uint64),
            np.empty((n, len(self.codes), words), dtype=np.uint64),
            np.empty((n, len(self.codes)), dtype=np.uint8),
        )  # fmt: skip
        for axis, rows in self.by_kind(columns):
            # of some rows these are copies, of all of them views
            of_rows = (level[rows], merit[rows])
            best, tiers, kind = panel.best[rows], panel.tiers[rows], panel.kind[rows]
            strict, loose = panel.strict[rows], panel.loose[rows]
            best_merits(
                allowed[rows], *of_rows, axis.allowed, axis.least, axis.most, axis.level, axis.merit, ends,
                best, tiers,
            )  # fmt: skip
            good_settings(
                allowed[rows], *of_rows, axis.safe, axis.least, axis.most, axis.safe_level, axis.merit,
                axis.least_full, best, tiers, keep, strict, loose, kind,
            )  # fmt: skip
            if not isinstance(rows, slice):
                panel.best[rows], panel.tiers[rows], panel.kind[rows] = best, tiers, kind
                panel.strict[rows], panel.loose[rows] = strict, loose
        return panel

    def _groups(self, panel: _Panel, blocks: _Blocks) -> list[_Group]:
        """Columns of a panel in groups such that the table is smallest, with their cells.

        Where steps from group to group are bounded every sample may end a group.
        """
        if self.steady is not None and self.steady >= 0:
            each = [self._shared(panel, blocks, k, k + 1) for k in range(len(blocks.kind))]
            return self._steady_groups(panel, each, self.steady)
        origin = np.zeros(len(blocks.kind) + 1, dtype=np.intp)
        cheapest_groups(
            blocks.strict, blocks.loose, blocks.kind, panel.ends, MIXED_SPAN, *self._bytes(), origin
        )
        begins, end = [], len(blocks.kind)
        while end > 0:
            begins.append((int(origin[end]), end))
            end = int(origin[end])
        shared = [self._shared(panel, blocks, begin, end) for begin, end in reversed(begins)]
        if self.steady is not None:
            return self._steady_groups(panel, shared, self.steady)
        return [
            _Group(
                int(panel.columns[one.begin]), one.stretch,
                self._fairest(panel, one, one.stretch, [one.candidates(a, b) for a, b in one.cells]),
                one.kind[one.stretch] != FEASIBLE,
            )
            for one in shared
        ]  # fmt: skip

    def _shared(self, panel: _Panel, blocks: _Blocks, begin: int, end: int) -> _Shared:
        """What the columns of some blocks can share."""
        strict, loose, kind = (v[begin].copy() for v in (blocks.strict, blocks.loose, blocks.kind))
        for k in range(begin + 1, end):
            add_to_group(strict, loose, kind, blocks.strict[k], blocks.loose[k], blocks.kind[k])
        starts = np.empty(len(kind), dtype=np.int64)
        span = MIXED_SPAN if end - begin > 1 else np.inf
        cells = split_signals(strict, loose, kind, panel.ends, span, starts)
        columns = np.arange(begin, min(end + 1, len(panel.columns)) if _reaches(panel, end) else end)
        settings = np.where((kind == MIXED)[:, None], loose, strict)
        return _Shared(begin, columns, starts[:cells].astype(np.intp), kind, settings)

    def _steady_groups(self, panel: _Panel, shared: list[_Shared], largest_step: int) -> list[_Group]:
        """Groups whose words change seldom from one to the next, signal by signal; `fewest_changes`."""
        borders = np.unique(np.concatenate([one.stretch for one in shared]))
        ends = np.append(borders[1:], len(self.codes))
        ratios, count = len(self.choice.grid.ratios), len(self.choice.grid)
        setting = np.empty((len(shared), len(borders)), dtype=np.intp)
        none, ones = np.zeros((len(shared), count), dtype=np.uint8), np.ones(count, dtype=np.float32)
        allowed = np.zeros(len(shared), dtype=np.uint8)
        candidates = [[one.candidates(a, b) for a, b in zip(borders, ends, strict=True)] for one in shared]
        shares = [
            self._shares(panel, one, borders, some) for one, some in zip(shared, candidates, strict=True)
        ]
        far, path = np.empty(len(shared), dtype=bool), np.empty(len(shared), dtype=np.intp)
        for k in range(len(borders)):
            worth = np.zeros((len(shared), count), dtype=np.float32)
            for g in range(len(shared)):
                worth[g, candidates[g][k]] = np.clip(shares[g][k], LEAST_SHARE, 1.0)
            fewest_changes(
                worth, none, ones, none[0], worth.argmax(axis=1), allowed, 1.0 - 0.5 * LEAST_SHARE,
                ratios, largest_step, LOSS_LEVELS, path, far,
            )  # fmt: skip
            setting[:, k] = path
        groups = [
            _merged(int(panel.columns[one.begin]), borders, setting[g], one.kind[borders] != FEASIBLE)
            for g, one in enumerate(shared)
        ]
        return [one for g, one in enumerate(groups) if g == 0 or not one.same_words(groups[g - 1])]

    def _shares(self, panel: _Panel, shared: _Shared, borders: Index, candidates: list[Index]) -> list[Array]:
        """Worst share of the best merit that each candidate has in each cell."""
        shares = [np.full(len(c), np.inf) for c in candidates]
        for axis, rows in self.by_kind(panel.columns[shared.columns]):
            for cell, (a, b) in enumerate(pairwise(np.append(borders, len(self.codes)))):
                worst_shares(
                    shared.columns[rows], a, b, candidates[cell], shared.kind[a], panel.level, panel.merit,
                    axis.level, axis.merit, axis.least_full, panel.best, panel.tiers, shares[cell],
                )  # fmt: skip
        return shares

    def _fairest(self, panel: _Panel, shared: _Shared, borders: Index, candidates: list[Index]) -> Index:
        """(cells,) setting whose worst share of the best merit in a cell is largest; the first of equals."""
        shares = self._shares(panel, shared, borders, candidates)
        return np.array([c[first_largest(s)] for c, s in zip(candidates, shares, strict=True)], dtype=np.intp)

    def _table(self, groups: list[_Group]) -> TdiTable:
        choice, exposure = self.choice, self.choice.detector.exposure
        column = choice.columns.column.astype(np.intp)
        first = [0] + [int(column[g.first - 1] + column[g.first]) // 2 + 1 for g in groups[1:]]
        first[0] = int(column[0])
        thresholds = [np.where(np.arange(len(g.stretch)) == 0, 0, self.codes[g.stretch]) for g in groups]
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
class _Shared:
    """Settings that columns between samples can share: the first block and rows of the panel that show them,
    first stretch of each cell, and for every stretch what decides it and the settings as bits."""

    begin: int
    columns: Index
    stretch: Index
    kind: Small
    settings: Bits

    @property
    def cells(self) -> Iterator[tuple[int, int]]:
        """First stretch of each cell, and the one after its last."""
        return pairwise(np.append(self.stretch, len(self.kind)).tolist())

    def candidates(self, first: int, last: int) -> Index:
        """Settings that serve all stretches from `first` to before `last`."""
        bits = np.bitwise_and.reduce(self.settings[first:last], axis=0).view(np.uint8)
        return np.flatnonzero(np.unpackbits(bits, bitorder="little"))


def _merged(first: int, borders: Index, setting: Index, flagged: NDArray[np.bool_]) -> _Group:
    """A group whose neighbouring cells of one word are one."""
    new = np.append(True, (np.diff(setting) != 0) | (flagged[1:] != flagged[:-1]))
    return _Group(first, borders[new], setting[new], flagged[new])


@dataclass(frozen=True, eq=False)
class _Group:
    """Columns that share their cells: its first, and the first stretch, setting and flag of each cell."""

    first: int
    stretch: Index
    setting: Index
    flagged: NDArray[np.bool_]

    def same_words(self, other: _Group) -> bool:
        """Whether all signals have the same words in both."""
        own, others = (
            (self.stretch, self.setting, self.flagged),
            (other.stretch, other.setting, other.flagged),
        )
        return all(np.array_equal(a, b) for a, b in zip(own, others, strict=True))


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


def _ends(codes: Index, choice: TdiChoice) -> Array:
    """(2 T,) electrons at the lower and upper end of each stretch, up to where the next begins."""
    low, high = float(choice.signals.min()), float(choice.signals.max())
    first = np.clip(codes * 2.0 ** shift_of(choice.signals), low, high)
    last = np.maximum(np.append(first[1:], high) * BELOW, first)
    return np.stack([first, last], axis=1).ravel()


def _signal_axis(codes: Index, choice: TdiChoice, detector: TdiDetector) -> _SignalAxis:
    """Stretches from code to code as a kind of column sees them."""
    ends = _ends(codes, choice)
    shape = (len(ends), len(choice.grid))
    blocks = (-(-len(ends) // BLOCK), len(choice.grid))
    axis = _SignalAxis(
        np.empty(shape), np.empty(shape, dtype=np.uint8), np.empty(shape, dtype=np.float32),
        np.empty(shape), np.empty(shape, dtype=np.uint8), np.empty(len(ends), dtype=np.intp),
        np.empty(blocks), np.empty(blocks),
    )  # fmt: skip
    for begin in range(0, len(ends), AT_ONCE):
        part = slice(begin, begin + AT_ONCE)
        factors = whole_electrons(ends[part], choice, detector)
        # what overflows at the upper end of a stretch is no setting for it
        safe = np.repeat(factors.unsaturated[1::2], 2, axis=0)
        axis.allowed[part], axis.merit[part] = factors.allowed, factors.merit
        axis.level[part] = np.where(factors.unsaturated, 1 + factors.clear, 0)
        axis.safe[part] = np.where(safe, axis.allowed[part], 0.0)
        axis.safe_level[part] = np.where(safe, axis.level[part], 0)
        axis.least_full[part] = _least_full(ends[part], choice, detector)
    bounds_of_blocks(axis.allowed, axis.least, axis.most)
    return axis


def _least_full(signals: Array, choice: TdiChoice, detector: TdiDetector) -> Index:
    """(S,) setting that fills the fuller of its two wells least."""
    if detector.without_wells:
        return np.zeros(len(signals), dtype=np.intp)
    line, total = well_levels(signals, choice.grid, detector)
    full = np.maximum(line / detector.full_well_line, total / detector.full_well_sum)
    return np.asarray(full.argmin(axis=1))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Settings that all columns from one sample to the next can take."""

    strict: Bits
    loose: Bits
    kind: Small


def _blocks(panel: _Panel, count: int, after: int) -> tuple[_Blocks, Index]:
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
        if split_signals(strict[k], loose[k], kind[k], panel.ends, MIXED_SPAN, starts) == 0:
            invalid.append(k)
    return _Blocks(strict, loose, kind), np.array(invalid, dtype=np.intp)


def _reaches(panel: _Panel, end: int) -> bool:
    """Whether the block before `end` has columns between it and the next sample."""
    return end < len(panel.columns) and bool(panel.columns[end] - panel.columns[end - 1] > 1)
