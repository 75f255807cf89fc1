"""Columns unlike in noise and wells: choice, table and certificate against their formulae, one by one.

Nothing of the choice's code is used to judge it: noise and wells are summed stage by stage here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure, drift_transfer
from sightline.tdi.choose import choose_settings, merit_of
from sightline.tdi.hysteresis import LineHold, line_loss, merit_factors, steady_choice
from sightline.tdi.merit import DriftMtf
from sightline.tdi.predict_loss import predict_loss
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table_build import build_table
from sightline.tdi.tagging import tag_lines

COLUMNS = 24
GRID = TdiGrid(np.arange(3, 97, 3), np.arange(1, 11) * 0.1)
SIGNALS = np.geomspace(1.0, 8000.0, 10)


@dataclass(frozen=True)
class Law:
    """Of one column: variance of a line of s electrons gain s^2 + shot s + dark K + read^2; its wells."""

    gain: float
    shot: float
    read: float
    dark: float
    output: float
    line: float
    total: float


def laws(wells: bool, kinds: int | None = None) -> list[Law]:
    """Of every column: from quiet to noisy without order, or of a few kinds in turn."""
    rng = np.random.default_rng(5)
    drawn = [
        Law(
            *np.array([9e-6, 1.0, 12.0, 20.0, 30.0]) * np.exp(rng.uniform(-2.0, 2.0, 5)),
            *(np.array([3e4, 2e5]) * np.exp(rng.uniform(-1.0, 0.5, 2)) if wells else (np.inf, np.inf)),
        )
        for _ in range(kinds or COLUMNS)
    ]
    return [drawn[c % len(drawn)] for c in range(COLUMNS)]


def problem(of_column: list[Law], **rules: object):
    """Model and choice of columns of such laws."""
    x = np.linspace(-1.0, 1.0, COLUMNS)
    base = TdiDetector(Exposure(2, 0.25), NoiseLaw())
    unlike = list(dict.fromkeys(of_column))
    kinds = tuple(
        replace(
            base,
            noise=NoiseLaw(w.gain, w.shot, w.read, w.dark, w.output),
            full_well_line=w.line,
            full_well_sum=w.total,
        )
        for w in unlike
    )
    columns = ScanColumns(
        np.arange(COLUMNS, dtype=float), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x),
        np.full((COLUMNS, 2), 0.2), None, np.array([unlike.index(w) for w in of_column]),
    )  # fmt: skip
    model = DriftMtf(columns, GRID, base.exposure, ChoiceRules(**rules))
    detector = replace(base, kinds=kinds)
    return model, choose_settings(model, SIGNALS, GRID, detector, model.rules)


def by_hand(of_column: list[Law], scan: ScanColumns, signals: np.ndarray, whole: bool = False):
    """Merit (C, S, P) of every setting, and whether wells hold, stage by stage.

    With `whole`, wells are judged one electron higher, as a table of whole electrons must.
    """
    stages, ratio = GRID.settings
    merit = np.empty((len(of_column), len(signals), len(stages)))
    holds = np.empty(merit.shape, dtype=bool)
    for c, law in enumerate(of_column):
        motion = (scan.velocity[c], scan.slip[c])
        head = Exposure(2, 0.25)
        across, along = (
            np.abs(drift_transfer(stages, ratio, *motion, *f, head)) for f in ((0.5, 0), (0, 0.5))
        )
        mtf = 0.04 * across * along
        electrons = signals[:, None]
        bright = np.minimum(np.floor(electrons) + 1.0, SIGNALS[-1]) if whole else electrons
        variance, collected, total, fullest = (np.zeros((len(signals), len(stages))) for _ in range(4))
        for k in range(int(stages.max())):
            here = k < stages
            length = np.where(here, 0.25 if k < 2 else ratio, 0.0)[here]
            line = electrons * length / 0.25
            variance[:, here] += law.gain * line**2 + law.shot * line + law.dark * length + law.read**2
            collected[:, here] += line
            filled = (bright / 0.25 + law.dark) * length
            total[:, here] += filled
            fullest[:, here] = np.maximum(fullest[:, here], filled)
        merit[c] = mtf * collected / np.sqrt(variance + law.output**2)
        holds[c] = (fullest <= law.line) & (total <= law.total)
        drift = max(abs(motion[0] * np.tan(motion[1])), abs(motion[0] - 1.0))
        holds[c] &= stages * 0.5 * drift <= 1.0
    return merit, holds


@pytest.mark.parametrize("wells", [False, True])
def test_every_column_is_judged_by_its_own_noise_and_wells(wells):
    of_column = laws(wells)
    model, choice = problem(of_column)
    merit, holds = by_hand(of_column, choice.columns, SIGNALS)
    allowed = np.where(holds, merit, 0.0)
    got = np.take_along_axis(allowed, choice.setting[..., None], axis=2)[..., 0]
    feasible = allowed.max(axis=2) > 0.0
    assert got[feasible] == pytest.approx(allowed.max(axis=2)[feasible], rel=1e-9)
    assert np.array_equal(feasible, ~choice.infeasible) and feasible.mean() > 0.7
    assert choice.merit == pytest.approx(np.take_along_axis(merit, choice.setting[..., None], 2)[..., 0])
    assert merit_of(
        model, SIGNALS, choice.setting, GRID, choice.detector, choice.rules
    ) == pytest.approx(choice.merit)  # fmt: skip
    # with the noise of the middle column for all, other settings would be taken
    alike = problem([of_column[COLUMNS // 2]] * COLUMNS)[1]
    assert (alike.setting != choice.setting).mean() > 0.2


@pytest.mark.parametrize(
    ("wells", "kinds", "hysteresis"),
    [(False, None, 0.0), (True, None, 0.0), (True, 3, 0.0), (True, None, 0.02)],
)
def test_the_table_owns_the_noise_of_every_column(wells, kinds, hysteresis):
    of_column, max_loss = laws(wells, kinds), 1.0 - 0.99 * (1.0 - hysteresis)
    model, choice = problem(of_column)
    table, certificate = build_table(model, choice, 0.01, hysteresis=hysteresis)
    assert certificate.holds
    rng = np.random.default_rng(2)
    signals = np.unique(np.exp(rng.uniform(0.0, np.log(8000.0), 60)))
    merit, holds = by_hand(of_column, choice.columns, signals, whole=True)
    words = table.lookup(np.repeat(signals[:, None], COLUMNS, axis=1)).T
    n, kt = table.unpack(words)
    stages, ratio = GRID.settings
    taken = ((stages == n[..., None]) & np.isclose(ratio, kt[..., None])).argmax(axis=2)
    allowed = np.where(holds, merit, 0.0)
    best = allowed.max(axis=2)
    got = np.take_along_axis(allowed, taken[..., None], axis=2)[..., 0]
    feasible = best > 0.0
    # no limit broken where some setting keeps it; between the signals judged merits are smooth
    assert (got[feasible] > 0.0).all()
    assert (1.0 - got[feasible] / best[feasible]).max() <= 1.02 * max_loss
    assert table.flags(words)[0][~feasible].all()


def test_kinds_that_are_alike_change_no_bit():
    of_column = laws(True, 1)
    _, one = problem(of_column)
    model, two = problem(of_column)
    kinds = two.detector.kinds * 3
    columns = replace(two.columns, kind=np.arange(COLUMNS) % 3)
    model = DriftMtf(columns, GRID, two.detector.exposure, two.rules)
    split = choose_settings(model, SIGNALS, GRID, replace(two.detector, kinds=kinds), two.rules)
    assert np.array_equal(one.setting, split.setting) and np.array_equal(one.snr, split.snr)
    first, second = (
        build_table(DriftMtf(c.columns, GRID, c.detector.exposure, c.rules), c)[0] for c in (one, split)
    )
    assert first.to_bytes() == second.to_bytes()


def test_steady_settings_lose_no_more_than_asked_of_each_columns_own_merit():
    of_column = laws(True)
    model, choice = problem(of_column)
    merit, holds = by_hand(of_column, choice.columns, SIGNALS)
    for along in ("columns", "signals"):
        steady = steady_choice(model, choice, 0.02, along=along)
        assert steady.changes_after < steady.changes_before
        feasible = ~choice.infeasible
        best = np.where(holds, merit, 0.0).max(axis=2)
        got = np.take_along_axis(np.where(holds, merit, 0.0), steady.choice.setting[..., None], 2)[..., 0]
        # merits are compared in single precision
        assert (got[feasible] >= best[feasible] * (1.0 - 0.02 - 1e-5)).all()
        own = np.take_along_axis(merit, steady.choice.setting[..., None], 2)[..., 0]
        assert steady.choice.merit == pytest.approx(own)


def test_lines_are_held_tagged_and_predicted_by_each_columns_own_noise():
    of_column = laws(True)
    model, choice = problem(of_column)
    factors = merit_factors(model, choice)
    rng = np.random.default_rng(3)
    signals = SIGNALS[rng.integers(0, 6, (40, COLUMNS))]
    held = LineHold(choice, factors, 0.05)(signals)
    feasible = ~choice.infeasible[np.arange(COLUMNS), np.searchsorted(SIGNALS, signals)]
    loss = line_loss(factors, choice, held, signals)
    assert loss[feasible].max() <= 0.05 + 1e-5
    free = choice.setting[np.arange(COLUMNS), np.searchsorted(SIGNALS, signals)]
    assert np.count_nonzero(np.diff(held, axis=0)) < np.count_nonzero(np.diff(free, axis=0))
    tags = tag_lines(
        model, held, signals, GRID, choice.detector, first_column=np.arange(COLUMNS), columns=COLUMNS
    )  # fmt: skip
    merit, holds = by_hand(of_column, choice.columns, SIGNALS)
    at = np.arange(COLUMNS), np.searchsorted(SIGNALS, signals), held
    assert tags.snr * tags.mtf_across * tags.mtf_along == pytest.approx(merit[at], rel=1e-5)
    lobe = held // len(GRID.ratios)
    assert lobe.shape == signals.shape
    assert not tags.saturated[holds[at]].any()
    blurred = replace(choice.columns, covariance=np.full((COLUMNS, 1, 1), 1e-5) * np.eye(2))
    doubted = DriftMtf(blurred, GRID, choice.detector.exposure, choice.rules)
    loss_by_draw = predict_loss(choose_settings(
        doubted, SIGNALS, GRID, choice.detector, choice.rules), doubted)  # fmt: skip
    assert 0.0 < loss_by_draw.mean.mean() < 0.2
