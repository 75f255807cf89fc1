"""Lines set from their own head: what becomes known when, and what that costs."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.hysteresis import LineHold, merit_factors, nearest_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from tdi.causal_lines import clairvoyant_loss, head_readings, set_lines

GROUPS = 6


def a_case(latency=0, **wells):
    """Noise, head and drift of the example; signals 1.8 % apart, so that rounding to them costs nothing."""
    x = np.linspace(-1.0, 1.0, GROUPS)
    scan = ScanColumns(
        np.arange(GROUPS), 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((GROUPS, 2), 0.3)
    )
    detector = TdiDetector(Exposure(2 + latency, 0.25), NoiseLaw(9e-6, 1.0, 12.0, dark=4.0), **wells)
    grid, rules = TdiGrid(np.arange(8, 129, 2), np.arange(2, 21) / 20.0), ChoiceRules()
    model = DriftMtf(scan, grid, detector.exposure, rules)
    return model, choose_settings(model, np.geomspace(1.0, 8000.0, 500), grid, detector, rules)


def a_scene(lines=300, seed=1):
    """Fields of texture between 5 and 4000 electrons, with edges."""
    rng = np.random.default_rng(seed)
    fields = np.repeat(np.exp(rng.uniform(np.log(5.0), np.log(4000.0), (lines // 20, GROUPS))), 20, axis=0)
    return np.maximum(fields * np.exp(0.1 * rng.standard_normal(fields.shape)), 5.0)


def a_run(choice, readings, latency, *, hold=True):
    """Settings of a run, held where asked."""
    factors = merit_factors(a_case(latency)[0], choice)
    decide = LineHold(choice, factors, 0.01, 2) if hold else lambda s: nearest_settings(choice, s)
    return set_lines(readings, decide, choice.detector, choice.grid, latency=latency)


@pytest.mark.parametrize("latency", [0, 3])
def test_nothing_that_comes_later_is_used(latency):
    _, choice = a_case(latency)
    readings = head_readings(a_scene(), choice.detector, latency, np.random.default_rng(0))
    taken_in = np.arange(300)[:, None] + np.arange(2)  # line period of reading [l, k]
    now = 151
    run = a_run(choice, readings, latency)
    other = readings.copy()
    other[taken_in > now] = 4000.0 - other[taken_in > now]
    changed = a_run(choice, other, latency)
    known = run.known_in <= now
    assert np.array_equal(run.setting[known], changed.setting[known])
    assert np.array_equal(run.measured[known], changed.measured[known])
    # the line whose second reading comes one period later is the first to differ
    assert known.sum() == 151 and (run.measured[151] != changed.measured[151]).all()
    assert (run.setting[~known] != changed.setting[~known]).any()
    # and what was read in time is used: the last reading in time matters to the last known line
    other = readings.copy()
    other[150, 1] = 4000.0 - other[150, 1]
    assert (a_run(choice, other, latency).setting[150] != run.setting[150]).any()


@pytest.mark.parametrize("latency", [0, 3])
def test_a_setting_acts_before_its_fewest_stages_have_passed(latency):
    _, choice = a_case(latency)
    readings = head_readings(a_scene(40), choice.detector, latency, np.random.default_rng(0))
    run = a_run(choice, readings, latency)
    first_stage = run.acts_from - np.arange(40)
    assert (first_stage == 2 + latency).all()
    assert (first_stage[:, None] <= choice.grid.stages_of(run.setting)).all()
    assert (run.acts_from > run.known_in).all()


def test_the_signal_is_that_of_the_head_with_its_noise():
    _, choice = a_case()
    scene = np.tile([5.0, 20.0, 100.0, 400.0, 1000.0, 4000.0], (4000, 1))
    readings = head_readings(scene, choice.detector, 0, np.random.default_rng(3))
    measured = a_run(choice, readings, 0, hold=False).measured
    sigma = np.sqrt(choice.detector.noise.line_variance(scene[0], 0.25) / 2.0)
    # mean and spread of 4000 draws: sigma / 63 and 1.1 %; four of them
    assert np.abs(measured.mean(axis=0) - scene[0]).max() < np.max(4.0 * sigma / np.sqrt(4000))
    assert np.abs((measured.mean(axis=0) - scene[0]) / sigma).max() < 4.0 / np.sqrt(4000)
    assert measured.std(axis=0) == pytest.approx(sigma, rel=0.045)


def test_a_full_head_reads_as_full():
    _, choice = a_case(full_well_line=3000.0)
    readings = head_readings(np.full((50, GROUPS), 1e5), choice.detector, 0, np.random.default_rng(0))
    assert np.abs(readings - 3000.0).max() < 5 * 12.0 + 1.0


def test_the_head_alone_costs_little():
    model, choice = a_case()
    scene = a_scene(600)
    readings = head_readings(scene, choice.detector, 0, np.random.default_rng(0))
    run = a_run(choice, readings, 0, hold=False)
    loss, overflows = clairvoyant_loss(model, scene, run.setting, choice.grid, choice.detector, choice.rules)
    # a prototype's figures: 0.06 % in the mean, 0.7 % at worst, down to 5 electrons; noise has no
    # worst, so that one line in a thousand may exceed it (a head that reads 4 of 41 electrons loses 1.5 %)
    assert loss.mean() < 6e-4 and np.quantile(loss, 0.999) < 7e-3
    assert loss.min() > -1e-12 and not overflows.any()
    # one setting for all signals would lose more: the figure means something
    one = np.broadcast_to(choice.setting[:, 0], run.setting.shape)
    of_one = clairvoyant_loss(model, scene, one, choice.grid, choice.detector, choice.rules)[0]
    assert of_one.mean() > 10.0 * loss.mean()


def test_held_lines_lose_no_more_than_allowed_and_change_less():
    model, choice = a_case()
    scene = a_scene()
    readings = head_readings(scene, choice.detector, 0, np.random.default_rng(0))
    factors = merit_factors(model, choice)
    free = a_run(choice, readings, 0, hold=False)
    held = set_lines(readings, LineHold(choice, factors, 0.01), choice.detector, choice.grid)
    loss = clairvoyant_loss(model, scene, held.setting, choice.grid, choice.detector, choice.rules)[0]
    # the hysteresis, and the noise of the head on top of it
    assert np.quantile(loss, 0.999) < 0.01 + 7e-3
    changes = [np.count_nonzero(np.diff(run.setting, axis=0)) for run in (free, held)]
    assert changes[1] < 0.2 * changes[0]


@pytest.mark.parametrize(
    ("head", "latency", "first", "says"),
    [(2, 2, 8, "no stage to measure"), (2, -1, 8, "latency"), (9, 7, 8, "stages have passed")],
)
def test_an_order_that_cannot_be_is_refused(head, latency, first, says):
    detector = TdiDetector(Exposure(head, 0.25), NoiseLaw(read=12.0))
    grid = TdiGrid(np.arange(first, 20), np.array([0.5, 1.0]))
    with pytest.raises(InputError, match=says):
        readings = head_readings(np.ones((5, 2)), detector, latency, np.random.default_rng(0))
        set_lines(readings, lambda s: np.zeros(2, dtype=np.intp), detector, grid, latency=latency)


def test_readings_of_another_head_are_refused():
    detector, grid = TdiDetector(Exposure(2, 0.25)), TdiGrid(np.arange(8, 20), np.array([1.0]))
    with pytest.raises(InputError, match="do not make the head"):
        set_lines(np.ones((5, 3, 2)), lambda s: np.zeros(2, dtype=np.intp), detector, grid)
