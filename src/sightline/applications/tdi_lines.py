"""S3's settings of an image of signals, line by line, as the detector would have had them.

The table of a choice is looked up for every pixel, or, where the choice is to keep its settings, they are
held from line to line. What was set, what from, and what is expected of it go into tags, a record per pixel.

Not here: the choice (``tdi_choice.py``), files (``io/results/tdi_settings.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.tdi_choice import TdiResult
from sightline.errors import InputError
from sightline.imaging.source import ImageSource
from sightline.stages import Stages
from sightline.tdi.hysteresis import LineHold, MeritFactors, merit_factors
from sightline.tdi.merit import SomeColumns
from sightline.tdi.setting import Array, Index, ScanColumns
from sightline.tdi.table import TdiTable
from sightline.tdi.tagging import SystemMtf, TdiTags, overflows, tag_lines

#: Pixels that are worked on at once.
AT_ONCE = 1 << 19
#: Relative step to which tags round signals: an even scene then takes little room.
SIGNAL_STEP = 0.05
#: Share of pixels without a signal, or beyond the table's range, from which it is said.
SAID_SHARE = 0.001


@dataclass
class LineCounts:
    """What happened to the pixels of an image of signals.

    Attributes
    ----------
    lines, columns : int
    without_signal : int
        Masked, no number, or not above 0: they are set as the lowest signal is.
    below, beyond : int
        Below and above the signals that the table was certified for.
    infeasible : int
        In cells for some of whose signals no setting keeps all limits.
    saturated : int
        A line or the sum fills its well at the setting.
    changes : int
        Settings that differ from those of the line before.
    fewest, most : int
        Stages.
    total : int
        Stages of all pixels together.
    """

    lines: int
    columns: int
    without_signal: int = 0
    below: int = 0
    beyond: int = 0
    infeasible: int = 0
    saturated: int = 0
    changes: int = 0
    fewest: int = np.iinfo(np.int64).max
    most: int = 0
    total: int = 0

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.lines * self.columns

    def warnings(self, table: TdiTable) -> list[str]:
        """What to know before the settings are used."""
        low, high = table.signals
        said = []
        for count, words in (
            (self.without_signal, "have no signal above 0 and are set as the lowest signal is"),
            (self.below, f"lie below {low:g} electrons, the lowest of [signals]: they are set as it is"),
            (
                self.beyond,
                f"lie above {high:g} electrons, the highest of [signals]: neither merit nor wells are known "
                "there; let [signals] reach as far as the image",
            ),
            (self.saturated, "fill a well at their setting"),
        ):
            if count > SAID_SHARE * self.pixels:
                said.append(
                    f"{100.0 * count / self.pixels:.3g} % of the pixels of the image of signals {words}"
                )
        return said


@dataclass(frozen=True, eq=False)
class _LinesDone:
    """Tags of some lines; and when they were done what was counted so far, and the settings to go on from."""

    tags: TdiTags
    counts: LineCounts
    last: Index
    held: Index


def check_columns(image: ImageSource, columns: ScanColumns) -> None:
    """Refuse an image of signals that has no pixel for every column, before anything is chosen."""
    first, last = int(columns.column[0]), int(columns.column[-1])
    if image.shape[1] != last - first + 1:
        raise InputError(
            f"the image of signals has {image.shape[1]} columns, [columns] of the choice {last - first + 1} "
            f"(numbers {first} to {last}); give an image with a pixel for each of them, or correct [columns]"
        )


class SignalLines:
    """Settings and tags of an image of signals, some lines at a time.

    Parameters
    ----------
    result : TdiResult
        A choice with its table. Where its file asks for hysteresis, settings are held from line to line
        within it, wells kept; else they are those of the table.
    image : ImageSource
        Electrons of one line, as the signals of the choice are given: a pixel for every column of the table.

    Raises
    ------
    InputError
        If the image has another number of columns than the table.
    """

    def __init__(self, result: TdiResult, image: ImageSource) -> None:
        problem, table = result.problem, result.table
        check_columns(image, problem.columns)
        lines, columns = image.shape
        self.image, self.result = image, result
        self.counts = LineCounts(lines, columns)
        numbers = problem.columns.column
        # a column that the file does not name has what the nearest named one has, as in the table
        borders = 0.5 * (numbers[1:] + numbers[:-1])
        self._nearest = np.searchsorted(borders, int(numbers[0]) + np.arange(columns), side="left").astype(
            np.intp
        )
        self._model = SomeColumns(problem.model, self._nearest)
        self._hold = self._held(problem.hysteresis, problem.largest_step)
        used = self._of_words(table.words)[0]
        if self._hold is not None:
            used = np.concatenate([used, result.choice.setting.ravel()])
        self._system = SystemMtf(self._model, np.unique(used))

    def _held(self, hysteresis: float, largest_step: int | None) -> LineHold | None:
        """What holds settings from line to line; None where the table is looked up."""
        if hysteresis == 0.0 and largest_step is None:
            return None
        choice, nearest = self.result.choice, self._nearest
        factors = merit_factors(self.result.problem.model, choice)
        wide = MeritFactors(
            factors.by_column[nearest],
            factors.by_signal,
            factors.column_kept[nearest],
            factors.signal_kept,
            factors.first[nearest],
        )
        return LineHold(
            replace(
                choice,
                columns=choice.columns.part(nearest),
                setting=choice.setting[nearest],
                mtf=choice.mtf[nearest],
                snr=choice.snr[nearest],
                limit=choice.limit[nearest],
            ),
            wide,
            hysteresis,
            largest_step,
        )

    def _of_words(self, words: NDArray[np.uint16]) -> tuple[Index, NDArray[np.bool_]]:
        """Settings as the grid counts them, of words, and which are infeasible."""
        grid, table = self.result.problem.grid, self.result.table
        stages, ratio = table.unpack(words)
        row = np.searchsorted(grid.stages, stages)
        number = np.searchsorted(grid.ratios, ratio - 1e-12)
        return (row * len(grid.ratios) + number).astype(np.intp), table.flags(words)[0]

    def blocks(self, stages: Stages | None = None) -> Iterator[TdiTags]:
        """Tags of some lines after the other; `counts` is complete when the last was given.

        Each block is a stage: those that an earlier run has done are taken from there.
        """
        result, counts, kept = self.result, self.counts, stages or Stages()
        table = result.table
        size = max(AT_ONCE // counts.columns, 1)
        before: Index | None = None
        for number, first in enumerate(range(0, counts.lines, size)):
            done = kept.held(f"lines-{number}", _LinesDone, writeable=True)
            if done is not None:
                before = done.last
                for each in fields(LineCounts):
                    setattr(counts, each.name, getattr(done.counts, each.name))
                if self._hold is not None:
                    self._hold.last = done.held
                yield done.tags
                continue
            signals = self._read(first, min(first + size, counts.lines))
            setting, infeasible = self._settings(signals)
            tags = tag_lines(
                self._model,
                setting,
                signals,
                result.problem.grid,
                result.problem.detector,
                first_column=np.arange(counts.columns),
                columns=counts.columns,
                table=0 if self._hold is not None else table.identity,
                system=self._system,
                step=SIGNAL_STEP,
            )
            counts.without_signal += int((signals == 0.0).sum())
            counts.below += int(((signals > 0.0) & (signals < table.signals[0])).sum())
            counts.beyond += int((signals > table.signals[1]).sum())
            counts.infeasible += int(infeasible.sum())
            counts.saturated += int(tags.saturated.sum())
            rows = setting if before is None else np.concatenate([before[None], setting])
            counts.changes += int(np.count_nonzero(np.diff(rows, axis=0)))
            counts.fewest = min(counts.fewest, int(tags.stages.min()))
            counts.most = max(counts.most, int(tags.stages.max()))
            counts.total += int(tags.stages.sum(dtype=np.int64))
            before = setting[-1]
            held = np.zeros(0, dtype=np.intp) if self._hold is None else self._hold.last
            kept.put(f"lines-{number}", _LinesDone(tags, counts, before, held))
            yield tags

    def _read(self, first: int, last: int) -> Array:
        """Signals of some lines, 0 where there is none."""
        window = (first, last), (0, self.counts.columns)
        signals = self.image.read(*window).astype(np.float64)
        unusable = self.image.mask(*window)
        if unusable is not None:
            signals[unusable] = 0.0
        return np.where(signals > 0.0, signals, 0.0)

    def _settings(self, signals: Array) -> tuple[Index, NDArray[np.bool_]]:
        """Settings (L, C) of the next lines, and which of them break a limit of their own."""
        looked_up, infeasible = self._of_words(self.result.table.lookup(signals))
        if self._hold is None:
            return looked_up, infeasible
        # held by the nearest of the listed signals: between two of them a well may fill
        held = self._hold(signals)
        return np.where(self._fills(signals, held), looked_up, held), self._hold.infeasible(signals)

    def _fills(self, signals: Array, setting: Index) -> NDArray[np.bool_]:
        """Where a line or the sum fills its well."""
        grid, detector = self.result.problem.grid, self.result.problem.detector
        stages, ratio = grid.stages_of(setting), grid.ratio_of(setting)
        return overflows(signals, stages, ratio, self._model.columns, detector)
