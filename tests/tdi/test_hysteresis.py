"""Settings that change seldom: against all paths tried one by one, at limits, and from line to line."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.hysteresis import (
    LineHold,
    line_loss,
    merit_factors,
    nearest_settings,
    signal_cells,
    steady_choice,
)
from sightline.tdi.merit import DriftMtf, column_factors, signal_factors
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.steady_kernels import fewest_changes

NOISE = NoiseLaw(9e-6, 1.0, 12.0)


def a_case(columns=60, signals=(5.0, 50.0, 500.0, 5000.0), *, rules=None, **detector):
    """The reference example's columns: velocity and slip that grow to the edges."""
    rules = rules or ChoiceRules()
    x = np.linspace(-1.0, 1.0, columns)
    scan = ScanColumns(
        np.arange(columns), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((columns, 2), 0.3)
    )
    grid = TdiGrid(np.arange(3, 65), np.arange(1, 11) / 10.0)
    body = TdiDetector(Exposure(2, 0.25), NOISE, **detector)
    model = DriftMtf(scan, grid, body.exposure, rules)
    return model, choose_settings(model, np.asarray(signals), grid, body, rules)


def all_paths(merit, allowed, best, share, rows, step):
    """Cost (too far, changes, loss) of the best of all paths through settings within `share`."""
    sets = [
        [
            p
            for p in range(merit.shape[1])
            if p == best[c] or (allowed[c, p] and merit[c, p] >= merit[c, best[c]] * (1.0 - share))
        ]
        for c in range(len(merit))
    ]
    costs = []
    for path in itertools.product(*sets):
        apart = np.abs(np.diff(rows[list(path)]))
        far = 0 if step is None else int((apart > step).sum())
        loss = sum(1.0 - merit[c, p] / merit[c, best[c]] for c, p in enumerate(path))
        costs.append((far, int(np.count_nonzero(np.diff(path))), loss))
    return min(costs)


@pytest.mark.parametrize("step", [None, 1, 2])
@pytest.mark.parametrize("seed", range(8))
def test_the_path_is_the_best_of_all_paths(step, seed):
    # 6 cells of 12 settings (4 numbers of stages x 3 ratios), some forbidden
    rng = np.random.default_rng(seed)
    along, fixed = rng.uniform(0.3, 1.0, (6, 12)), rng.uniform(0.8, 1.0, 12)
    along, fixed = along.astype(np.float32), fixed.astype(np.float32)  # as the choice hands them over
    kept = np.where(rng.random((6, 12)) < 0.8, 15, 7).astype(np.uint8)
    kept[:, rng.integers(12)] = 15
    merit, allowed = along.astype(np.float64) * fixed, kept == 15
    best = np.where(allowed, merit, 0.0).argmax(axis=1)
    out, far = np.empty(6, dtype=np.intp), np.empty(6, dtype=bool)
    share, levels = 0.25, 2**20
    fewest_changes(
        along, kept, fixed, np.zeros(12, dtype=np.uint8), best, np.full(6, 15, dtype=np.uint8),
        share, 3, -1 if step is None else step, levels, out, far,
    )  # fmt: skip
    cells, rows = np.arange(6), np.arange(12) // 3
    wanted = all_paths(merit, allowed, best, share, rows, step)
    loss = 1.0 - merit[cells, out] / merit[cells, best]
    apart = np.abs(np.diff(rows[out]))
    assert allowed[cells, out].all()
    assert (int(far.sum()), int(np.count_nonzero(np.diff(out)))) == wanted[:2]
    assert np.array_equal(far[1:], apart > (99 if step is None else step)) and not far[0]
    # each of 6 losses is rounded by half of share / levels
    assert loss.sum() == pytest.approx(wanted[2], abs=6 * share / levels)


def test_no_hysteresis_gives_the_free_choice():
    model, choice = a_case()
    steady = steady_choice(model, choice, 0.0)
    # merits equal to the last bit of single precision count as one: hardly any cell has two
    assert steady.worst_loss < 1e-6
    assert steady.changes_after <= steady.changes_before
    assert (steady.choice.setting == choice.setting).mean() > 0.99


@pytest.mark.parametrize("along", ["columns", "signals"])
def test_changes_fall_and_no_cell_loses_more_than_asked(along):
    model, choice = a_case(signals=np.geomspace(2.0, 4000.0, 30))
    steady = steady_choice(model, choice, 0.01, along=along)
    # the merit anew, from the choice's own MTF and SNR, in double precision: 1e-6 is that of single
    loss = 1.0 - steady.choice.merit / choice.merit
    assert loss.max() <= 0.01 + 1e-6
    assert loss == pytest.approx(steady.loss, abs=1e-6)
    assert steady.changes_after < 0.5 * steady.changes_before
    assert steady.mean_loss < steady.worst_loss <= 0.01 + 1e-6
    assert not steady.too_far.any()


def test_more_hysteresis_means_fewer_changes():
    model, choice = a_case()
    changes = [steady_choice(model, choice, h).changes_after for h in (0.0, 0.002, 0.01, 0.05)]
    assert changes == sorted(changes, reverse=True) and changes[-1] < changes[0]


def test_the_step_is_kept_where_the_hysteresis_leaves_a_way():
    model, choice = a_case(columns=400)
    free, bound = (steady_choice(model, choice, 0.05, largest_step=step) for step in (None, 2))
    assert free.largest_step_after > 2
    assert bound.largest_step_after <= 2 and not bound.too_far.any()
    assert bound.worst_loss <= 0.05 + 1e-6


def test_a_step_that_cannot_be_kept_is_reported():
    model, choice = a_case(columns=2)
    far_apart = ScanColumns(
        choice.columns.column, np.ones(2), np.radians([0.0, 4.0]), choice.columns.static_mtf
    )
    model = replace(model, columns=far_apart)
    choice = choose_settings(model, choice.signals, choice.grid, choice.detector, choice.rules)
    steady = steady_choice(model, choice, 0.01, largest_step=5)
    assert steady.too_far[1].all() and not steady.too_far[0].any()
    assert steady.largest_step_after > 5


def test_limits_are_never_given_up():
    model, choice = a_case(
        signals=np.geomspace(2.0, 4000.0, 12), full_well_line=9000.0, full_well_sum=60_000.0,
        rules=ChoiceRules(mtf_min=0.05, snr_min=3.0),
    )  # fmt: skip
    steady = steady_choice(model, choice, 0.3)
    assert (choice.limit > 0).any() and not (choice.limit == 0).all()
    of_columns = column_factors(model, slice(0, 60), choice.grid, choice.rules)
    of_signals = signal_factors(choice.signals, choice.grid, choice.detector, choice.rules)
    column, signal = np.indices(choice.setting.shape)
    for setting in (choice.setting, steady.choice.setting):
        kept = of_signals.unsaturated[signal, setting] & of_columns.in_lobe[column, setting]
        kept &= of_columns.in_bounds[column, setting] & of_signals.clear[signal, setting]
        assert kept[~choice.infeasible].all()
    # the free choice without limits would break them: the test can fail
    loose = choose_settings(
        model, choice.signals, choice.grid, TdiDetector(Exposure(2, 0.25), NOISE), ChoiceRules()
    )
    assert not of_signals.unsaturated[signal, loose.setting].all()


def test_where_every_well_overflows_the_least_full_setting_stays():
    model, choice = a_case(signals=(10.0, 1e6), full_well_line=5000.0)
    steady = steady_choice(model, choice, 0.5)
    assert np.array_equal(steady.choice.setting[:, 1], choice.setting[:, 1])


@pytest.mark.parametrize(
    ("hysteresis", "options", "says"),
    [
        (-0.1, {}, "hysteresis"),
        (1.0, {}, "hysteresis"),
        (0.01, {"largest_step": 0}, "largest_step"),
        (0.01, {"along": "rows"}, "along"),
    ],
)
def test_what_cannot_be_is_refused(hysteresis, options, says):
    model, choice = a_case(columns=3)
    with pytest.raises(InputError, match=says):
        steady_choice(model, choice, hysteresis, **options)


def test_the_nearest_signal_is_that_by_ratio():
    signals = np.array([10.0, 40.0, 160.0])
    assert signal_cells([-3.0, 0.0, 19.9, 20.1, 79.0, 81.0, 1e9], signals).tolist() == [0, 0, 0, 1, 1, 2, 2]


def noisy_border(lines=400):
    """A flat scene whose noisy signal crosses the border of two cells of different settings."""
    model, choice = a_case(columns=5, signals=np.geomspace(5.0, 2000.0, 24))
    border = next(s for s in range(23) if (choice.setting[:, s] != choice.setting[:, s + 1]).all())
    at = np.sqrt(choice.signals[border] * choice.signals[border + 1])
    # a tenth of the ratio of neighbours: the noise crosses this border and no other
    step = choice.signals[1] / choice.signals[0] - 1.0
    signals = at * (1.0 + 0.1 * step * np.random.default_rng(0).standard_normal((lines, 5)))
    return model, choice, signals


def test_a_flat_scene_at_the_border_of_two_cells_does_not_flicker():
    model, choice, signals = noisy_border()
    free = nearest_settings(choice, signals)
    # a fair coin changes in half of the lines
    assert np.count_nonzero(np.diff(free, axis=0)) > 0.4 * 399 * 5
    factors = merit_factors(model, choice)
    held = LineHold(choice, factors, 0.02)(signals)
    assert np.count_nonzero(np.diff(held, axis=0)) == 0
    assert 0.0 < line_loss(factors, choice, held, signals).max() <= 0.02


def test_lines_one_by_one_are_held_as_all_at_once():
    model, choice, signals = noisy_border(50)
    signals *= np.linspace(0.2, 5.0, 50)[:, None]
    factors = merit_factors(model, choice)
    hold = LineHold(choice, factors, 0.005, largest_step=2)
    one_by_one = np.array([hold(line) for line in signals])
    assert np.array_equal(one_by_one, LineHold(choice, factors, 0.005, largest_step=2)(signals))
    assert np.count_nonzero(np.diff(one_by_one, axis=0)) > 3


def test_a_setting_is_left_once_it_loses_too_much():
    model, choice = a_case(columns=1, signals=np.geomspace(5.0, 4000.0, 40))
    factors = merit_factors(model, choice)
    rising = np.repeat(choice.signals, 3)[:, None]
    held = LineHold(choice, factors, 0.003)(rising)
    free = nearest_settings(choice, rising)
    assert line_loss(factors, choice, held, rising).max() <= 0.003
    assert 0 < np.count_nonzero(np.diff(held, axis=0)) < np.count_nonzero(np.diff(free, axis=0))


def test_stages_move_by_no_more_than_the_step_unless_a_well_overflows():
    # the sum of a faint scene fits its well, of a bright one with fewer stages: down at once, up by steps
    model, choice = a_case(columns=1, signals=(10.0, 1000.0), full_well_sum=40_000.0)
    stages = choice.stages[0]
    assert stages[0] - stages[1] > 2 * 4
    factors = merit_factors(model, choice)
    hold = LineHold(choice, factors, 0.0, largest_step=4)
    scene = np.repeat([10.0, 1000.0, 10.0], [3, 3, 20])[:, None]
    held = choice.grid.stages_of(hold(scene))[:, 0]
    assert held[:6].tolist() == [stages[0]] * 3 + [stages[1]] * 3
    steps = np.diff(held[5:])
    assert steps.max() == 4 and steps.min() >= 0 and held[-1] == stages[0]
