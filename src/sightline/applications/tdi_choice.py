"""S3, figures 2 and 3: number of TDI stages and integration ratio for every column and signal.

``choose_tdi`` judges every setting of the grid by what motion, optics and noise leave of a scene, takes the
best that keeps the limits, and says what other ways of choosing would have lost.

Not here: the steps themselves (``tdi/``), files (``io/tdi/load.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError, computes
from sightline.execution import Progress, one_blas_thread, silent, steps_of
from sightline.result import Result, makes_result, one_line
from sightline.stages import Stages
from sightline.tdi.choose import FREE, LIMITS, TdiChoice, choose_settings, merit_of
from sightline.tdi.hysteresis import SteadyChoice, steady_choice
from sightline.tdi.merit import (
    ColumnMtf,
    DriftMtf,
    SomeColumns,
    column_factors,
    main_lobe,
    signal_factors,
)
from sightline.tdi.predict_loss import PredictedLoss, predict_loss
from sightline.tdi.setting import Array, ChoiceRules, Index, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table import TdiTable
from sightline.tdi.table_build import build_table
from sightline.tdi.table_certificate import Certificate, table_loss

#: Columns over which other ways of choosing are compared, evenly spread: the whole is not judged thrice.
COMPARED = 512
#: Signals of the map of the table's loss.
MAPPED = 200
#: Loss of merit by the patent's form above which it is said.
SAID_LOSS = 0.01
#: Ratio of the stages of neighbouring columns above which it is said.
LARGE_JUMP = 2


@dataclass(frozen=True, eq=False, repr=False)
class TdiProblem:
    """A detector, what moves over it, and what is wanted.

    Attributes
    ----------
    columns : ScanColumns
    signals : (S,)
        Electrons of one head line, rising (without a head: of one line at `detector.signal_ratio`).
    grid : TdiGrid
    detector : TdiDetector
    rules : ChoiceRules
    motion : ColumnMtf or None
        MTF by a recovered motion; None: by constant drift.
    max_loss : float
        Most relative merit that the table may lose.
    hysteresis : float
        Share of its merit that a cell may lose so that neighbouring columns keep one setting; 0: none.
    largest_step : int or None
        Most change of stages between neighbouring columns, steps of the grid.
    aperture : (float, float)
        Photosensitive width of a pixel across and along, px; for pictures.
    name : str
    notes : tuple of str
        What had to be left out; the result repeats them as warnings.
    """

    columns: ScanColumns
    signals: Array
    grid: TdiGrid
    detector: TdiDetector = field(default_factory=TdiDetector)
    rules: ChoiceRules = field(default_factory=ChoiceRules)
    motion: ColumnMtf | None = None
    max_loss: float = 0.005
    hysteresis: float = 0.0
    largest_step: int | None = None
    aperture: tuple[float, float] = (1.0, 1.0)
    name: str = "TDI choice"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be chosen for."""
        signals = np.asarray(self.signals, dtype=np.float64)
        rising = signals.ndim == 1 and len(signals) > 0 and bool((np.diff(signals) > 0.0).all())
        if not (rising and np.isfinite(signals).all() and signals[0] > 0.0):
            raise InputError(f"`signals` is {self.signals!r}; electrons, above 0 and rising, are needed")
        object.__setattr__(self, "signals", signals)

    def __repr__(self) -> str:
        """One line."""
        low, high = self.signals[0], self.signals[-1]
        facts = {
            "": repr(self.name),
            "columns": str(len(self.columns)),
            "signals": f"{len(self.signals)} from {low:g} to {high:g} electrons",
            "settings": str(len(self.grid)),
            "motion": "constant drift" if self.motion is None else "recovered",
        }
        return one_line("TdiProblem", facts)

    @property
    def model(self) -> ColumnMtf:
        """What motion does to each column."""
        return self.motion or DriftMtf(self.columns, self.grid, self.detector.exposure, self.rules)


@dataclass(frozen=True, eq=False)
class OtherWay:
    """What another way of choosing would have lost.

    Attributes
    ----------
    name : str
    columns : (c,) int
        Columns compared, counted from the first.
    setting : (c, S) int
        What it would choose.
    loss : (c, S)
        Relative merit lost against the best by the exact form; 1 beyond the main lobe and where a well is
        full.
    """

    name: str
    columns: Index
    setting: Index
    loss: Array


@dataclass(frozen=True, eq=False)
class Landscape:
    """Merit of every setting, limits aside, for a few columns and one signal.

    Attributes
    ----------
    columns : (c,) int
        Counted from the first.
    signal : int
        Counted from the first.
    merit : (c, n, k)
        Over numbers of stages and integration ratios.
    """

    columns: Index
    signal: int
    merit: Array


@dataclass(frozen=True, eq=False)
class TableLoss:
    """Merit that the table loses, over columns and signals.

    Attributes
    ----------
    columns : (c,) int
        Counted from the first.
    signals : (s,)
        Electrons of one line.
    loss : (c, s)
        Relative; NaN where no setting keeps all limits.
    """

    columns: Index
    signals: Array
    loss: Array


@dataclass(frozen=True, eq=False, repr=False)
class TdiResult(Result):
    """What ``choose_tdi`` gives.

    Attributes
    ----------
    problem : TdiProblem
    choice : TdiChoice
        As it is to be used, steady where that was asked for.
    steady : SteadyChoice or None
        What keeping settings from column to column cost.
    one_setting, one_signal, patent : OtherWay
        One setting for all, from the centre column; one signal per column; the form of EP2733929.
    landscape : Landscape
        Of the first, the middle and the last column.
    table : TdiTable
        Of settings by column and signal.
    certificate : Certificate
        What the table loses at worst.
    table_loss : TableLoss
        What it loses where.
    predicted_loss : PredictedLoss or None
        What the choice gives away because velocity, slip or motion are not known exactly; None where they
        are.
    warnings : tuple of str
    comparison : str or None
        The last of the warnings where it says only what the form of EP2733929 would have lost.
    """

    problem: TdiProblem
    choice: TdiChoice
    steady: SteadyChoice | None
    one_setting: OtherWay
    one_signal: OtherWay
    patent: OtherWay
    landscape: Landscape
    table: TdiTable
    certificate: Certificate
    table_loss: TableLoss
    predicted_loss: PredictedLoss | None
    warnings: tuple[str, ...]
    comparison: str | None = None


@makes_result
@one_blas_thread
@computes("the choice of TDI stages")
def choose_tdi(
    problem: TdiProblem, *, progress: Progress | None = None, stages: Stages | None = None
) -> TdiResult:
    """Choose the number of TDI stages and the integration ratio of every column and signal.

    Parameters
    ----------
    problem : TdiProblem
    progress : callable, optional
        Called with what is being done, how much of it is done, and how much it is.
    stages : Stages, optional
        Where finished steps are kept, to go on from after a stop.

    Returns
    -------
    TdiResult

    Raises
    ------
    InputError
        A column slips by more than the limit.

    Examples
    --------
    >>> import numpy as np
    >>> columns = ScanColumns(np.arange(3), np.ones(3), np.radians([0.0, 1.0, 2.0]), np.full((3, 2), 0.3))
    >>> grid = TdiGrid(np.arange(3, 65), np.arange(1, 11) / 10)
    >>> choose_tdi(TdiProblem(columns, np.array([400.0]), grid)).choice.stages.ravel().tolist()
    [64, 43, 21]
    """
    check_slip(problem.columns, problem.rules)
    tell, kept = progress or silent, stages or Stages()
    kept.depend(problem)
    step = steps_of(tell, f"choosing among {len(problem.grid)} settings")
    choice = choose_settings(
        problem.model, problem.signals, problem.grid, problem.detector, problem.rules, step, kept
    )
    tell("comparing with other ways to choose")
    ways = kept.once("other-ways", _OtherWays, lambda: _OtherWays(*_other_ways(problem, choice)))
    steady = None
    if problem.hysteresis > 0.0 or problem.largest_step is not None:
        steady = kept.once("steady", _Steady, lambda: _Steady.of(problem, choice)).of_choice(choice)
    tell("building the table")
    built = kept.once("table", _Built, lambda: _Built.of(problem, choice))
    table, certificate = built.table, built.certificate
    used = choice if steady is None else steady.choice
    losses = kept.once(
        "losses",
        _Losses,
        lambda: _Losses(predict_loss(used, problem.model), _table_loss(problem, choice, table)),
    )
    patent = ways.patent
    warnings = (
        problem.notes
        + _warnings(problem, choice, patent, certificate)
        + _jumps(used, moved=problem.motion is not None)
    )
    comparison = _comparison(problem, patent)
    return TdiResult(
        problem,
        used,
        steady,
        ways.one_setting,
        ways.one_signal,
        patent,
        _landscape(problem),
        table,
        certificate,
        losses.of_table,
        losses.predicted if len(losses.predicted.draws) > 1 else None,
        warnings if comparison is None else (*warnings, comparison),
        comparison,
    )


# What is kept of a step: arrays and numbers; columns, signals and detector are the problem's.


@dataclass(frozen=True, eq=False)
class _OtherWays:
    one_setting: OtherWay
    one_signal: OtherWay
    patent: OtherWay


@dataclass(frozen=True, eq=False)
class _Steady:
    """A `SteadyChoice` by what sets it apart from the free choice."""

    setting: Index
    mtf: Array
    snr: Array
    loss: Array
    too_far: NDArray[np.bool_]
    changes: tuple[int, int]
    steps: tuple[int, int]

    @classmethod
    def of(cls, problem: TdiProblem, choice: TdiChoice) -> _Steady:
        """It is found."""
        found = steady_choice(problem.model, choice, problem.hysteresis, largest_step=problem.largest_step)
        return cls(
            found.choice.setting, found.choice.mtf, found.choice.snr, found.loss, found.too_far,
            (found.changes_before, found.changes_after),
            (found.largest_step_before, found.largest_step_after),
        )  # fmt: skip

    def of_choice(self, choice: TdiChoice) -> SteadyChoice:
        """It is given."""
        settled = replace(choice, setting=self.setting, mtf=self.mtf, snr=self.snr)
        return SteadyChoice(settled, self.loss, self.too_far, *self.changes, *self.steps)


@dataclass(frozen=True, eq=False)
class _Built:
    table: TdiTable
    certificate: Certificate

    @classmethod
    def of(cls, problem: TdiProblem, choice: TdiChoice) -> _Built:
        """It is built."""
        table, certificate = build_table(
            problem.model, choice, problem.max_loss,
            hysteresis=problem.hysteresis, largest_step=problem.largest_step,
        )  # fmt: skip
        return cls(table, certificate)


@dataclass(frozen=True, eq=False)
class _Losses:
    predicted: PredictedLoss
    of_table: TableLoss


def check_slip(columns: ScanColumns, rules: ChoiceRules) -> None:
    """Refuse columns over which the scene moves too much askew for TDI."""
    worst = int(np.abs(columns.slip).argmax())
    if abs(columns.slip[worst]) > rules.slip_limit:
        raise InputError(
            f"column {columns.column[worst]:g} slips by {np.degrees(columns.slip[worst]):.4g} degrees, more "
            f"than the limit of {np.degrees(rules.slip_limit):.4g}; steer the camera (yaw), check the sign "
            'and unit (rad) of the slip, or allow it with slip_limit (a larger angle, or "allow")'
        )


def _other_ways(problem: TdiProblem, choice: TdiChoice) -> tuple[OtherWay, OtherWay, OtherWay]:
    """What is lost by one setting for all columns, by one signal for all scenes, and by the patent's form."""
    count, middle = len(problem.columns), len(problem.signals) // 2
    some = _spread(count)
    shape = (len(some), len(problem.signals))
    centre = choice.setting[count // 2, middle]
    part = problem.columns.part(some)
    drift = DriftMtf(part, problem.grid, problem.detector.exposure, replace(problem.rules, model="patent"))
    by_patent = choose_settings(drift, problem.signals, problem.grid, problem.detector, drift.rules).setting
    settings = {
        "one setting from the centre column": np.full(shape, centre),
        "one signal for all scenes": np.repeat(choice.setting[some, middle][:, None], shape[1], axis=1),
        "the form of EP2733929": by_patent,
    }
    rules = replace(problem.rules, model="exact")
    exact: ColumnMtf = SomeColumns(problem.model, some)
    reference = choice.setting[some]
    if problem.rules.model == "patent":
        exact = DriftMtf(part, problem.grid, problem.detector.exposure, rules)
        reference = choose_settings(exact, problem.signals, problem.grid, problem.detector, rules).setting

    def merit(setting: Index) -> Array:
        return merit_of(exact, problem.signals, setting, problem.grid, problem.detector, rules)

    # beyond the main lobe contrast comes back reversed, a full well shows nothing: worth nothing
    reversed_ = ~main_lobe(part, problem.grid, rules)

    def loss(setting: Index) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(best > 0.0, 1.0 - merit(setting) / best, 0.0)
        useless = np.take_along_axis(reversed_, setting, axis=1)
        for of_kind, at in problem.detector.by_kind(part):
            full = ~signal_factors(problem.signals, problem.grid, of_kind, rules).unsaturated
            useless[at] |= np.take_along_axis(full, setting[at].T, axis=1).T
        return np.where(useless & ~choice.infeasible[some], 1.0, np.maximum(share, 0.0))

    best = merit(reference)
    ways = [OtherWay(name, some, setting, loss(setting)) for name, setting in settings.items()]
    return ways[0], ways[1], ways[2]


def _table_loss(problem: TdiProblem, choice: TdiChoice, table: TdiTable) -> TableLoss:
    """Loss of the table at some columns, and at signals denser than those it was asked for."""
    some = _spread(len(problem.columns))
    low, high = problem.signals[[0, -1]]
    signals: Array = np.unique(np.round(np.geomspace(max(low, 1.0), max(high, 1.0), MAPPED))).astype(float)
    part = replace(
        choice,
        columns=choice.columns.part(some),
        setting=choice.setting[some],
        mtf=choice.mtf[some],
        snr=choice.snr[some],
        limit=choice.limit[some],
    )
    return TableLoss(some, signals, table_loss(SomeColumns(problem.model, some), part, table, signals))


def _spread(count: int) -> Index:
    """At most `COMPARED` of so many columns, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, COMPARED)).round().astype(np.intp))


def _landscape(problem: TdiProblem) -> Landscape:
    """Merit over the whole grid for the first, the middle and the last column, at the middle signal."""
    count, signal = len(problem.columns), len(problem.signals) // 2
    which = np.unique([0, count // 2, count - 1])
    by_column = column_factors(problem.model, which, problem.grid, problem.rules).merit
    some = problem.signals[signal : signal + 1]
    detectors = [problem.detector.of_column(problem.columns, int(place)) for place in which]
    by_signal = np.concatenate(
        [signal_factors(some, problem.grid, one, problem.rules).merit for one in detectors]
    )
    shape = (len(which), len(problem.grid.stages), len(problem.grid.ratios))
    return Landscape(which, signal, (by_column * by_signal).reshape(shape))


def _warnings(
    problem: TdiProblem, choice: TdiChoice, patent: OtherWay, certificate: Certificate
) -> tuple[str, ...]:
    """What a user must know before using the numbers."""
    said = []
    if not certificate.holds:
        said.append(
            f"the table loses up to {100.0 * certificate.loss:.3g} % of the merit (column "
            f"{certificate.column:g}, {certificate.signal:.4g} electrons), more than max_loss = "
            f"{100.0 * certificate.max_loss:.3g} %: signals are whole electrons there; allow more"
        )
    if certificate.at_limits > certificate.max_loss:
        said.append(
            "where a well fills or the least SNR is reached within an electron, the table keeps clear of it, "
            f"for up to {100.0 * certificate.at_limits:.3g} % of the merit at that electron"
        )
    worst = float(patent.loss.max(initial=0.0))
    if problem.rules.model == "patent" and worst > SAID_LOSS:
        said.append(
            "chosen by the form of EP2733929, which flatters short integrations: by the exact form it loses "
            f'up to {100.0 * worst:.1f} % of the merit; model = "exact" does not'
        )
    for code in np.unique(choice.limit[choice.infeasible]):
        share = 100.0 * float((choice.limit == code).mean())
        limit = LIMITS[code].removeprefix("infeasible-")
        said.append(
            f"in {share:.3g} % of the cells no setting keeps the limit of {limit}: the safest setting stands "
            "in (limit in choice.csv)"
        )
    stages = problem.grid.stages
    at_most = float((choice.stages == stages[-1]).mean())
    if at_most > 0.0 and len(stages) > 1:
        said.append(
            f"{100.0 * at_most:.3g} % of the cells take the most stages of the grid, {stages[-1]}: "
            "more might serve them better"
        )
    return tuple(said)


def _comparison(problem: TdiProblem, patent: OtherWay) -> str | None:
    """That the form of EP2733929 would choose worse, where the exact one was used and it matters."""
    worst = float(patent.loss.max(initial=0.0))
    if problem.rules.model == "patent" or worst <= SAID_LOSS:
        return None
    return (
        f"the form of EP2733929 would lose up to {100.0 * worst:.1f} % of the merit here (mean "
        f"{100.0 * float(patent.loss.mean()):.1f} %): its choices differ from those given"
    )


def _jumps(choice: TdiChoice, *, moved: bool) -> tuple[str, ...]:
    """That neighbouring columns differ much in stages, and what keeps them alike."""
    stages, place = choice.stages, np.searchsorted(choice.grid.stages, choice.stages)
    few, many = np.minimum(stages[1:], stages[:-1]), np.maximum(stages[1:], stages[:-1])
    # a coarse grid has no smaller step, a limit leaves no choice, columns apart may differ
    far = (many > LARGE_JUMP * few) & (np.abs(np.diff(place, axis=0)) > 1)
    far &= (choice.limit[1:] == FREE) & (choice.limit[:-1] == FREE)
    far &= np.diff(choice.columns.column)[:, None] == 1.0
    if not far.any():
        return ()
    c, s = np.unravel_index(int(np.argmax(np.where(far, many / few, 0.0))), far.shape)
    why = "as where the merit has two summits" if moved else "as steeply as their drift does"
    cure = (
        ", and none if it is as large as the valley between the summits; a narrower [grid] leaves one of them"
    )
    return (
        f"stages jump by more than a factor of {LARGE_JUMP} between neighbouring columns in {far.sum():,} "
        f"cells (columns {choice.columns.column[c]:g} and {choice.columns.column[c + 1]:g} at "
        f"{choice.signals[s]:.4g} electrons: {stages[c, s]} and {stages[c + 1, s]}), {why}: MTF and "
        "SNR jump with them; hysteresis and max_step in [choice] let fewer columns jump"
        f"{cure if moved else ''}",
    )
