"""The certificate against a search that shares no code with it, and limits as hard as in the choice."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.tdi_noise import snr
from sightline.imaging.tdi_transfer import drift_transfer
from sightline.tdi import table_build
from sightline.tdi.choose import choose_settings, merit_of
from sightline.tdi.setting import TdiGrid
from sightline.tdi.table_build import build_table
from sightline.tdi.table_certificate import dense_signals, shift_of, table_loss
from sightline.tdi.table_kernels import ALL, FEASIBLE, bounds_of_blocks, good_settings
from sightline.tdi.table_stretches import finer_codes, well_codes
from tdi.tdi_example import field


def merits(choice, columns, signals):
    """MTFs (C, P, 2), SNR (S, P), merit (C, S, P) of every setting, from the closed forms."""
    stages, ratio = choice.grid.settings
    fx, fy = choice.rules.frequencies
    detector, scan = choice.detector, choice.columns
    args = (stages, ratio, scan.velocity[columns, None], scan.slip[columns, None])
    mtf = np.stack(
        [np.abs(drift_transfer(*args, *f, detector.exposure)) for f in ((fx, 0.0), (0.0, fy))], axis=-1
    )
    mtf *= scan.static_mtf[columns, None, :]
    noise = snr(signals[:, None], stages, ratio, detector.noise, detector.exposure)
    shape = {"product": mtf.prod(axis=-1), "min": mtf.min(axis=-1), "geomean": np.sqrt(mtf.prod(axis=-1))}
    return mtf, shape[choice.rules.merit][:, None, :] * noise


def searched(choice, table, columns, signals):
    """Relative loss (C, S) of the table, whether some setting keeps all limits, whether the table's does."""
    stages, ratio = choice.grid.settings
    scan, rules, detector = choice.columns, choice.rules, choice.detector
    mtf, merit = merits(choice, columns, signals)
    across = np.abs(scan.velocity[columns] * np.tan(scan.slip[columns])) * rules.frequencies[0]
    along = np.abs(scan.velocity[columns] - 1.0) * rules.frequencies[1]
    lobe = stages * np.maximum(across, along)[:, None] <= 1.0
    in_bounds = ((mtf >= rules.mtf_min) & (mtf <= rules.mtf_max)).all(axis=-1)
    # head lines at .25, the others at their ratio; signals are those of a head line. The table knows their
    # whole electrons only: wells are judged one electron higher, SNR at the whole ones
    whole = np.floor(signals)
    total = np.minimum(whole + 1.0, choice.signals.max())[:, None] * (2.0 + (stages - 2) * ratio / 0.25)
    least = snr(whole[:, None], stages, ratio, detector.noise, detector.exposure)
    kept = (lobe & in_bounds)[:, None, :] & ((total <= detector.full_well_sum) & (least >= rules.snr_min))
    whole = np.broadcast_to(signals[:, None], (len(signals), table.columns))
    words = table.lookup(whole)[:, scan.column[columns].astype(int) - table.edges[0]]
    n, kt = table.unpack(words)
    same = (stages == n.T[..., None]) & np.isclose(ratio, kt.T[..., None])
    assert (same.sum(axis=-1) == 1).all()
    allowed = np.where(kept, merit, 0.0)
    best = allowed.max(axis=-1)
    got = np.take_along_axis(allowed, same.argmax(axis=-1)[..., None], axis=-1)[..., 0]
    with np.errstate(invalid="ignore"):
        return 1.0 - got / best, best > 0.0, got > 0.0, words.T


CASES = {
    "free": ({}, 0.005),
    "tight": ({}, 0.001),
    "min": ({"merit": "min"}, 0.02),
    "geomean": ({"merit": "geomean"}, 0.01),
    "mtf_max": ({"mtf_max": 0.15}, 0.01),
    "wells": ({"full_well": 3e4}, 0.02),
    "snr": ({"snr_min": 40.0}, 0.01),
    "mtf": ({"mtf_min": 0.08}, 0.01),
    # each column is sure of few settings, and of some stretches of signals by one end only
    "narrow": ({"full_well": 2e3, "snr_min": 40.0}, 0.3),
    "all": ({"full_well": 3e4, "snr_min": 30.0, "mtf_min": 0.05}, 0.02),
}


@pytest.mark.parametrize("name", CASES)
def test_the_certificate_is_what_a_search_finds(name):
    options, max_loss = CASES[name]
    model, choice = field(**options)
    table, certificate = build_table(model, choice, max_loss)
    assert certificate.holds and table.certified_loss == certificate.loss <= max_loss
    # the head of the example has two lines at 0.25, and signals are those of one of them
    assert (table.signal_ratio, table.head_stages) == (0.25, 2)
    rng = np.random.default_rng(0)
    signals = np.unique(np.append(np.exp(rng.uniform(0.0, np.log(8000.0), 300)), np.arange(1.0, 40.0)))
    loss, feasible, kept, words = searched(choice, table, np.arange(40), signals)
    # a limit is never broken where some setting keeps it
    assert kept[feasible].all()
    # signals between those judged lose no more than a little beyond the bound: merits are smooth there
    assert loss[feasible].max() <= max_loss * 1.02
    flagged = table.flags(words)[0]
    assert flagged[~feasible].all()
    # a flag stands where no setting serves some column of the cell at some of its signals, nearly all of it
    assert (flagged & feasible).mean() < 0.05
    at = dense_signals(choice.signals, table)
    loss, feasible, *_ = searched(choice, table, np.arange(40), at)
    assert loss[feasible].max() == pytest.approx(certificate.loss, abs=1e-9)
    assert certificate.points == (40, len(at))


def test_wells_hold_for_parts_of_an_electron():
    model, choice = field(full_well=3e4)
    table, _ = build_table(model, choice, 0.02)
    rng = np.random.default_rng(1)
    signals = np.exp(rng.uniform(np.log(100.0), np.log(8000.0), 3000))
    stages, ratio = table.unpack(table.lookup(np.repeat(signals[:, None], 40, axis=1)))
    total = signals[:, None] * (2.0 + (stages - 2) * ratio / 0.25)
    assert total.max() <= 3e4 and total.max() > 0.98 * 3e4


def test_what_keeping_clear_of_a_limit_costs_is_reported():
    """Every electron judged by its own limits: no loss above the bound but what `at_limits` owns up to."""
    model, choice = field(8, full_well=3e4, top=2000.0)
    table, certificate = build_table(model, choice, 0.01)
    signals = np.arange(1.0, 2001.0)
    grid, detector, rules = choice.grid, choice.detector, choice.rules
    best = choose_settings(model, signals, grid, detector, rules)
    stages, ratio = table.unpack(table.lookup(np.repeat(signals[:, None], 8, axis=1)))
    setting = np.searchsorted(grid.stages, stages) * len(grid.ratios) + np.searchsorted(grid.ratios, ratio)
    merit = [merit_of(model, signals, chosen, grid, detector, rules) for chosen in (setting.T, best.setting)]
    worst = float((1.0 - merit[0] / merit[1]).max())
    assert certificate.holds and certificate.at_limits > 0.01
    # the electrons of all borders are among those that the certificate judges
    assert worst == pytest.approx(certificate.at_limits, rel=1e-9)


def test_wells_cut_off_the_best_setting_at_the_codes_that_are_said():
    model, choice = field(full_well=3e4)
    codes = well_codes(model, choice, 0.02)
    _, merit = merits(choice, np.arange(40), np.array([1000.0]))
    stages, ratio = choice.grid.settings
    scan = choice.columns
    across = np.abs(scan.velocity * np.tan(scan.slip)) * 0.5
    lobe = stages * np.maximum(across, np.abs(scan.velocity - 1.0) * 0.5)[:, None] <= 1.0
    found = []
    for code in range(2, 7999):
        # a whole electron stands for all below the next
        total = np.array([code, code + 1.0])[:, None] * (2.0 + (stages - 2) * ratio / 0.25)
        if ((total[0] <= 3e4) == (total[1] <= 3e4)).all():
            continue
        noise = snr(float(code), stages, ratio, choice.detector.noise, choice.detector.exposure)
        mtf = merit[:, 0] / snr(1000.0, stages, ratio, choice.detector.noise, choice.detector.exposure)
        best = [np.where(lobe & (t <= 3e4), mtf * noise, 0.0).max(axis=1) for t in total]
        if (best[1] < (1.0 - 0.25 * 0.02) * best[0]).any():
            found.append(code)
    # some of the columns are asked, and falls right at the limit of what counts may differ by rounding
    assert len(found) > 20 and len(set(found) ^ set(codes.tolist())) <= 0.05 * len(found)


def test_a_tighter_bound_costs_bytes_and_signals_hardly_matter():
    model, choice = field()
    sizes = [build_table(model, choice, loss)[1].bytes for loss in (0.002, 0.01, 0.05)]
    assert sizes[0] > sizes[1] > sizes[2]
    table, _ = build_table(model, choice, 0.01)
    # columns drive the choice
    assert len(table.edges) - 1 > np.diff(table.starts).max()


def test_columns_without_order_fall_back_to_groups_of_few():
    slip = np.radians(np.random.default_rng(2).uniform(-1.5, 1.5, 40))
    model, choice = field(slip=slip)
    table, certificate = build_table(model, choice, 0.005)
    assert certificate.holds and len(table.edges) - 1 > 25


def test_a_step_between_chips_is_a_border():
    slip = np.radians(np.where(np.arange(2000) < 777, 0.4, 1.1))
    model, choice = field(2000, 6, slip=slip)
    table, certificate = build_table(model, choice, 0.005)
    assert certificate.holds and 777 in table.edges


def test_columns_that_are_sampled_first_do_not_hide_the_others():
    # one bad column among 1500, between the samples
    slip = np.radians(np.full(1500, 0.3))
    slip[731] = np.radians(2.0)
    model, choice = field(1500, 6, slip=slip)
    table, certificate = build_table(model, choice, 0.01)
    assert certificate.holds
    words = table.lookup(np.full(1500, 200.0))
    assert words[731] != words[730] == words[732]


def test_uncertain_columns_are_judged_by_the_merit_they_were_chosen_by():
    covariance = np.tile(np.diag([1e-6, 1e-5]), (12, 1, 1))
    model, choice = field(12, 6, covariance=covariance, quantile=0.1)
    table, certificate = build_table(model, choice, 0.01)
    assert certificate.holds
    loss = table_loss(model, choice, table, np.floor(choice.signals))
    assert loss.shape == (12, 6) and loss.max() <= 0.01


def test_columns_may_begin_anywhere_and_leave_gaps():
    column = np.arange(40) * 5.0 + 100.0
    model, choice = field(column=column)
    table, certificate = build_table(model, choice, 0.005)
    assert (table.edges[0], table.edges[-1]) == (100, 296) and certificate.holds


def test_signals_beyond_16_bits_are_quantised():
    model, choice = field(top=5e5)
    table, certificate = build_table(model, choice, 0.005)
    assert certificate.holds and table.shift == 3 and table.top == 500_000 >> 3


@pytest.mark.parametrize("bits", [16, 17, 20])
def test_as_few_bits_are_dropped_as_let_signals_and_one_electron_more_fit_16(bits):
    for top in (2**bits - 2, 2**bits - 1.5, 2**bits - 1, 2**bits, 1.5 * 2**bits):
        few = next(s for s in range(20) if int(top + 1) // 2**s < 2**16)
        assert shift_of(np.array([3.0, top, 1.0])) == few, top
    assert shift_of(np.array([1.0, 8000.0])) == 0


def test_where_electrons_are_too_coarse_the_certificate_says_so():
    # the lowest signals differ by whole electrons: no table is that fine
    model, choice = field(grid=TdiGrid(np.array([3, 4, 60, 90]), np.array([0.05, 1.0])), full_well=600.0)
    table, certificate = build_table(model, choice, 1e-9)
    assert table.certified_loss == certificate.loss
    assert certificate.holds == (certificate.loss <= 1e-9)


@pytest.mark.parametrize("max_loss", [0.0, -0.1, 1.0, np.nan])
def test_an_impossible_bound_is_refused(max_loss):
    with pytest.raises(InputError, match="max_loss"):
        build_table(*field(4, 3), max_loss)


@pytest.mark.parametrize(
    "grid", [TdiGrid(np.array([512]), np.array([0.5])), TdiGrid(np.array([8]), np.linspace(0.01, 1.0, 33))]
)
def test_settings_that_do_not_fit_a_word_are_refused(grid):
    with pytest.raises(InputError, match=r"32 ratios and 511 stages: leave some out"):
        build_table(*field(3, 3, grid=grid), 0.01)


def test_columns_that_cannot_be_counted_are_refused():
    model, choice = field(4, 3, column=np.array([0.0, 1.5, 2.0, 3.0]))
    with pytest.raises(InputError, match="whole numbers"):
        build_table(model, choice, 0.01)


STEADY = {
    "hysteresis": ({"hysteresis": 0.02}, {}),
    "wells too": ({"hysteresis": 0.02}, {"full_well": 3e4, "snr_min": 30.0}),
    "step": ({"largest_step": 1}, {}),
    "both": ({"hysteresis": 0.02, "largest_step": 2}, {}),
}


@pytest.mark.parametrize("name", STEADY)
def test_a_steady_table_changes_seldom_and_owns_what_that_costs(name):
    how, options = STEADY[name]
    model, choice = field(200, **options)
    free, _ = build_table(model, choice, 0.01)
    table, certificate = build_table(model, choice, 0.01, **how)
    bound = 1.0 - 0.99 * (1.0 - how.get("hysteresis", 0.0))
    assert certificate.holds and certificate.max_loss == pytest.approx(bound)
    signals = np.geomspace(1.0, 8000.0, 150)
    loss, feasible, kept, _ = searched(choice, table, np.arange(200), signals)
    assert kept[feasible].all() and loss[feasible].max() <= 1.02 * bound
    at = dense_signals(choice.signals, table)
    loss, feasible, *_ = searched(choice, table, np.arange(200), at)
    assert loss[feasible].max() == pytest.approx(certificate.loss, abs=1e-9)
    changes, steps = zip(*(_along_columns(choice, t, signals) for t in (free, table)), strict=True)
    if "largest_step" in how:
        assert steps[1] <= how["largest_step"] < steps[0]
    else:
        assert changes[1] < 0.7 * changes[0] and len(table.words) < len(free.words)


def _along_columns(choice, table, signals):
    """Changes of words from column to column at all signals, and the largest in steps of the grid."""
    words = table.lookup(np.repeat(signals[:, None], table.columns, axis=1))
    row = np.searchsorted(choice.grid.stages, table.unpack(words)[0])
    return np.count_nonzero(np.diff(words, axis=1)), int(np.abs(np.diff(row, axis=1)).max())


def test_words_that_may_not_change_far_are_still_the_fairest():
    # of one column nothing changes from group to group: each word is the one whose worst loss is least, to
    # the thousandth in which losses are counted
    model, choice = field(1)
    signals = np.geomspace(1.0, 8000.0, 200)
    tables = [build_table(model, choice, 0.05, largest_step=step)[0] for step in (None, 90)]
    free, bound = (searched(choice, table, np.arange(1), signals)[0].mean() for table in tables)
    assert free > 0.002 and bound <= free + 0.001


def test_room_is_left_in_the_columns_in_which_the_bound_broke(monkeypatch):
    broken, tightened = [], []

    def certify(*given, whole=table_build.certify):
        certificate, failed = whole(*given)
        broken.append(failed[0])
        return certificate, failed

    def tighten(self, failed, whole=table_build._Builder.tighten):
        tightened.append(failed)
        before = dict(self.built_to)
        whole(self, failed)
        first = self.begins[np.searchsorted(self.begins, failed, side="right") - 1].tolist()
        for begin, share in self.built_to.items():
            # cells are built to 98 % of the bound, and to 98 % of that from then on
            assert share == pytest.approx(before.get(begin, 0.98) * (0.98 if begin in first else 1.0))
        assert set(self.built_to) == {*before, *first}

    monkeypatch.setattr(table_build, "SAMPLES", 2)
    monkeypatch.setattr(table_build, "certify", certify)
    monkeypatch.setattr(table_build._Builder, "tighten", tighten)
    _, certificate = build_table(*field(200), 0.3)
    assert certificate.holds and len(tightened) == len(broken) - 1 > 0
    for columns, failed in zip(broken, tightened, strict=False):
        assert len(columns) and np.array_equal(columns, failed)


@pytest.mark.parametrize("keep", [0.5, 0.999])
def test_settings_are_good_that_keep_enough_at_both_ends_or_else_the_one_that_keeps_most(keep):
    """70 settings, 3 columns, 4 stretches: merits that are any at either end, and no limits."""
    rng = np.random.default_rng(11)
    by_column, merits = rng.uniform(0.1, 1.0, (3, 70)), rng.uniform(0.1, 1.0, (8, 70)).astype(np.float32)
    by_signal, (least, most) = merits.astype(float), np.empty((2, 1, 70))
    bounds_of_blocks(by_signal, least, most)
    merit = by_column[:, None] * by_signal
    best, (bits, more) = merit.max(axis=2), np.empty((2, 3, 4, 2), np.uint64)
    kind = np.empty((3, 4), np.uint8)
    good_settings(
        by_column, np.full((3, 70), 3, np.uint8), by_column, by_signal, least, most,
        np.full((8, 70), 2, np.uint8), merits, np.zeros(8, np.intp), best, np.full((3, 8), ALL, np.uint8),
        keep, bits, more, kind,
    )  # fmt: skip
    share = (merit / best[:, :, None]).reshape(3, 4, 2, 70).min(axis=2)
    wanted = share >= keep
    none = ~wanted.any(axis=2)
    assert none.sum() > 6 if keep == 0.999 else 0 < wanted.sum() < wanted.size
    wanted[none] = (share == share.max(axis=2, keepdims=True))[none]
    found = (bits[..., None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    np.testing.assert_array_equal(found.reshape(3, 4, 128)[..., :70].astype(bool), wanted)
    np.testing.assert_array_equal(more, bits)
    assert (kind == FEASIBLE).all()


def test_stretches_in_which_the_bound_broke_and_those_beside_them_are_cut_in_four():
    codes, where = np.array([0, 8, 20, 40, 80, 160, 400]), np.zeros(3, dtype=np.intp)
    cut = {
        0: (2, 4, 6),
        8: (11, 14, 17),
        20: (25, 30, 35),
        40: (50, 60, 70),
        80: (100, 120, 140),
        160: (220, 280, 340),
    }
    for broken, stretches in (
        ([25.5], (8, 20, 40)),
        ([0.0], (0, 8)),
        ([399.0], (80, 160)),
        ([20.0], (8, 20, 40)),
    ):
        more = [code for first in stretches for code in cut[first]]
        found = finer_codes(codes, (where[: len(broken)], np.array(broken)))
        assert found.tolist() == sorted([*codes, *more])
    # nothing is left to be cut between neighbours
    assert finer_codes(np.array([5, 6]), (where[:1], np.array([5.0]))).tolist() == [5, 6]
