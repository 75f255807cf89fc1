"""The choice against a search that shares no code with it, its limits, its fallbacks, its ties."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure, drift_transfer, patent_transfer
from sightline.tdi.choose import LIMITS, choose_settings, merit_of
from sightline.tdi.merit import DriftMtf, fullest_signals, main_lobe, mtf_merit, unsaturated
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid

FORMS = {
    "product": lambda x, y: x * y,
    "geomean": lambda x, y: math.sqrt(x * y),
    "mean": lambda x, y: (x + y) / 2,
    "min": min,
    "x": lambda x, y: x,
    "y": lambda x, y: y,
}


def columns_of(velocity, slip, static=(0.3, 0.25)):
    count = len(velocity)
    return ScanColumns(np.arange(count), np.asarray(velocity), np.asarray(slip), np.tile(static, (count, 1)))


def chosen(columns, signals, grid, detector=None, rules=None):
    detector, rules = detector or TdiDetector(), rules or ChoiceRules()
    model = DriftMtf(columns, grid, detector.exposure, rules)
    return choose_settings(model, np.asarray(signals, dtype=float), grid, detector, rules)


def mtf_written_out(n, kt, velocity, slip, f, axis, head, head_ratio):
    """Stage by stage, the sum written out: no closed form."""
    across = velocity * math.tan(slip)
    psi, phi = (across * f, across * f) if axis == 0 else (velocity * f, (velocity - 1.0) * f)
    total, weight = 0j, 0.0
    for k in range(n):
        length = head_ratio if k < head else kt
        size = math.sin(math.pi * length * psi) / (math.pi * psi) if psi else length
        total += size * complex(math.cos(2 * math.pi * k * phi), -math.sin(2 * math.pi * k * phi))
        weight += length
    return abs(total) / weight


def snr_written_out(s, n, kt, law, head, head_ratio):
    signal, variance = 0.0, law.output**2
    for k in range(n):
        ratio = head_ratio if k < head else kt
        line = s * ratio / head_ratio
        signal += line
        variance += law.gain * line**2 + law.shot * line + law.dark * ratio + law.read**2
    return signal / math.sqrt(variance + law.column_fixed * signal**2)


class TestAgainstASearchWrittenOut:
    @pytest.mark.parametrize("merit", FORMS)
    def test_it_finds_the_same_settings(self, merit):
        rng = np.random.default_rng(list(FORMS).index(merit))
        head, head_ratio = 2, 0.5
        law = NoiseLaw(9e-6, 1.0, 12.0, dark=5.0, output=20.0, column_fixed=1e-5)
        columns = columns_of(1.0 + 0.004 * rng.normal(size=4), np.radians(1.0) * rng.normal(size=4))
        signals = np.sort(np.exp(rng.uniform(1.0, 8.0, 3)))
        grid = TdiGrid(np.arange(3, 41, 2), np.array([0.2, 0.5, 0.8, 1.0]))
        rules = ChoiceRules(merit=merit)
        found = chosen(columns, signals, grid, TdiDetector(Exposure(head, head_ratio), law), rules)
        for c, s in itertools.product(range(4), range(3)):
            v, g = columns.velocity[c], columns.slip[c]
            best, where = -1.0, (0, 0.0)
            for n, kt in itertools.product(grid.stages, grid.ratios):
                # guard: stages slip by at most one cycle in all
                if n * max(abs(v * math.tan(g)), abs(v - 1.0)) * 0.5 > 1.0:
                    continue
                x, y = (
                    mtf_written_out(n, kt, v, g, 0.5, axis, head, head_ratio) * columns.static_mtf[c, axis]
                    for axis in (0, 1)
                )
                worth = FORMS[merit](x, y) * snr_written_out(signals[s], n, kt, law, head, head_ratio)
                if worth > best * (1.0 + 1e-9):
                    best, where = worth, (n, kt)
            assert (found.stages[c, s], found.integration_ratio[c, s]) == where
            assert found.merit[c, s] == pytest.approx(best, rel=1e-9)
            assert LIMITS[found.limit[c, s]] in ("none", "main-lobe")

    @pytest.mark.parametrize("align", ["centre", "start", "end"])
    @pytest.mark.parametrize("form", ["exact", "patent"])
    def test_the_compiled_loops_are_the_formulas(self, form, align):
        exposure = Exposure(3, 0.35, align)
        grid = TdiGrid(np.array([1, 2, 3, 4, 9, 40, 200]), np.array([0.1, 0.35, 1.0]))
        columns = columns_of([1.0, 0.997, 1.02, 1.0], [0.0, 0.02, -0.03, 1e-7])
        rules = ChoiceRules(model=form, frequencies=(0.31, 0.44))
        found = DriftMtf(columns, grid, exposure, rules).central(slice(None))
        stages, ratio = grid.settings
        formula = drift_transfer if form == "exact" else patent_transfer
        for axis, f in enumerate(((0.31, 0.0), (0.0, 0.44))):
            args = (columns.velocity[:, None], columns.slip[:, None], *f, exposure)
            # 200 rounded sums of unit vectors
            assert_allclose(found[..., axis], np.abs(formula(stages, ratio, *args)), atol=1e-13)


class TestLimits:
    GRID = TdiGrid(np.arange(3, 65), np.arange(1, 11) / 10)
    HEAD = Exposure(2, 0.5)

    def test_the_reference_examples(self):
        law, static = NoiseLaw(9e-6, 1.0, 12.0), 0.35 * np.sinc(0.45) * np.exp(-2 * (np.pi * 0.2 * 0.5) ** 2)
        for slip, form, stages, ratio, merit in (
            (0.0, "exact", 64, 0.8, 5.54485),
            (2.0, "exact", 22, 0.8, 2.54072),
            (2.0, "patent", 53, 0.4, None),
        ):
            columns = columns_of([1.0], [np.radians(slip)], (static, static))
            found = chosen(columns, [400.0], self.GRID, TdiDetector(self.HEAD, law), ChoiceRules(model=form))
            assert (found.stages[0, 0], found.integration_ratio[0, 0]) == (stages, ratio)
            assert merit is None or found.merit[0, 0] == pytest.approx(merit, abs=6e-6)

    def test_side_lobes_are_not_taken(self):
        # The geometric mean is as large in every side lobe, |sin(pi N phi)| alone decides: 12 stages are
        # 0.4839 cycles here, 37 are 1.4919, nearer to the summit of their lobe.
        columns, grid = columns_of([1.0], [np.arctan(1 / 12.4)]), TdiGrid(np.arange(3, 257), np.array([1.0]))
        guarded = chosen(columns, [400.0], grid, rules=ChoiceRules(merit="geomean"))
        loose = chosen(columns, [400.0], grid, rules=ChoiceRules(merit="geomean", main_lobe_only=False))
        assert guarded.stages[0, 0] == 12 and loose.stages[0, 0] >= 37
        assert guarded.mtf[0, 0, 0] > 3 * loose.mtf[0, 0, 0]
        assert LIMITS[guarded.limit[0, 0]] == "main-lobe"

    def test_the_main_lobe_ends_where_stages_slip_by_a_cycle_of_either_frequency(self):
        rng, fx, fy = np.random.default_rng(6), 0.31, 0.44
        columns = columns_of(1.0 + 0.05 * rng.normal(size=9), 0.05 * rng.normal(size=9))
        found = main_lobe(columns, self.GRID, ChoiceRules(frequencies=(fx, fy)))
        slipped = [
            (v * math.tan(g) * fx, (v - 1.0) * fy)
            for v, g in zip(columns.velocity, columns.slip, strict=True)
        ]
        stages, _ = self.GRID.settings
        assert_array_equal(found, [[n * max(abs(x), abs(y)) <= 1.0 for n in stages] for x, y in slipped])
        # each of them decides somewhere
        assert {abs(x) > abs(y) for x, y in slipped} == {True, False} and 0.1 < found.mean() < 0.9
        assert main_lobe(columns, self.GRID, ChoiceRules(main_lobe_only=False)).all()

    @pytest.mark.parametrize(("quantile", "sigmas"), [(None, 1.644854), (0.1, 1.281552), (0.7, 0.0)])
    def test_wells_hold_a_signal_so_many_sigmas_above_the_one_expected(self, quantile, sigmas):
        # the upper 5 % of a normal distribution, or as much above it as the quantile lies below
        detector = TdiDetector(self.HEAD, NoiseLaw(), None, 900.0, 20_000.0)
        rules = ChoiceRules(signal_sigma=0.2, quantile=quantile)
        stages, ratio = self.GRID.settings
        line, total = np.maximum(ratio / 0.5, 1.0), 2 + (stages - 2) * ratio / 0.5
        full = np.minimum(900.0 / line, 20_000.0 / total) / (1.0 + 0.2 * sigmas)
        assert_allclose(fullest_signals(self.GRID, detector, rules), full, rtol=1e-6)
        signals = np.array([150.0, 420.0, 700.0])
        assert_array_equal(unsaturated(signals, self.GRID, detector, rules), signals[:, None] <= full)

    def test_a_well_is_never_overfilled_where_that_can_be(self):
        detector = TdiDetector(self.HEAD, NoiseLaw(read=12.0), None, 900.0, 20_000.0)
        found = chosen(columns_of([1.0], [0.0]), [20.0, 400.0, 800.0], self.GRID, detector)
        line = found.signals * np.maximum(found.integration_ratio[0] / 0.5, 1.0)
        total = found.signals * (2 + (found.stages[0] - 2) * found.integration_ratio[0] / 0.5)
        assert (line <= 900.0).all() and (total <= 20_000.0).all()
        assert [LIMITS[code] for code in found.limit[0]] == ["none", "saturation", "saturation"]

    def test_the_least_full_stands_in_where_every_setting_saturates(self):
        detector = TdiDetector(self.HEAD, NoiseLaw(), None, np.inf, 500.0)
        found = chosen(columns_of([1.0], [0.0]), [400.0], self.GRID, detector)
        assert LIMITS[found.limit[0, 0]] == "infeasible-saturation"
        assert (found.stages[0, 0], found.integration_ratio[0, 0]) == (3, 0.1)

    def test_snr_is_given_up_before_mtf_and_mtf_before_the_well(self):
        detector = TdiDetector(self.HEAD, NoiseLaw(), None, np.inf, 4000.0)
        columns = columns_of([1.0], [np.radians(1.0)])
        # 4000 electrons have an SNR of 63 at most
        noisy = chosen(columns, [400.0], self.GRID, detector, ChoiceRules(snr_min=64.0, mtf_min=0.2))
        assert LIMITS[noisy.limit[0, 0]] == "infeasible-snr" and noisy.mtf.min() >= 0.2
        free = chosen(columns, [400.0], self.GRID, detector)
        low = chosen(columns, [400.0], self.GRID, detector, ChoiceRules(snr_min=64.0, mtf_min=0.99))
        assert LIMITS[low.limit[0, 0]] == "infeasible-mtf"
        # with SNR and MTF given up, the best below the well remains
        assert low.setting[0, 0] == free.setting[0, 0]

    def test_an_mtf_of_one_is_within_its_default_bound(self):
        """With nothing static to blur, MTF comes to 1 + 1e-15 by rounding: no reason to refuse a setting."""
        slip = 10.0 ** np.linspace(-12.0, -7.0, 300)
        columns = columns_of(np.ones(300), slip, static=(1.0, 1.0))
        found = chosen(columns, [20.0, 400.0], self.GRID, rules=ChoiceRules(merit="x"))
        assert (found.stages == self.GRID.stages[-1]).all()
        assert {LIMITS[code] for code in found.limit.ravel()} == {"none"} and found.mtf.max() <= 1.0

    def test_bounds_of_mtf_move_the_choice(self):
        columns = columns_of([1.0], [np.radians(2.0)])
        free = chosen(columns, [400.0], self.GRID)
        bound = chosen(columns, [400.0], self.GRID, rules=ChoiceRules(mtf_min=0.22))
        assert bound.mtf.min() >= 0.22 > free.mtf.min() and LIMITS[bound.limit[0, 0]] == "mtf"
        blurred = chosen(columns, [400.0], self.GRID, rules=ChoiceRules(mtf_max=0.2))
        assert blurred.mtf.max() <= 0.2 and LIMITS[blurred.limit[0, 0]] == "mtf"

    def test_equal_merits_go_to_fewer_stages_then_shorter_integration(self):
        # nothing but a fixed pattern: SNR is the same for all; at rest MTF across is 1 for all
        detector = TdiDetector(Exposure(), NoiseLaw(shot=0.0, column_fixed=1e-4))
        found = chosen(columns_of([1.0], [0.0]), [400.0], self.GRID, detector, ChoiceRules(merit="x"))
        assert (found.stages[0, 0], found.integration_ratio[0, 0]) == (3, 0.1)


class TestUncertainty:
    GRID = TdiGrid(np.arange(3, 129), np.array([0.8]))

    def test_unsure_of_the_slip_one_takes_fewer_stages(self):
        def stages(sigma, quantile):
            covariance = np.zeros((1, 2, 2))
            covariance[0, 1, 1] = sigma**2
            columns = ScanColumns(
                np.arange(1), np.ones(1), np.radians([0.8]), np.full((1, 2), 0.3), covariance
            )
            return int(chosen(columns, [400.0], self.GRID, rules=ChoiceRules(quantile=quantile)).stages[0, 0])

        sure = stages(0.0, None)
        assert stages(np.radians(0.3), 0.05) < stages(np.radians(0.3), None) < sure

    def test_the_mean_is_that_of_random_draws(self):
        covariance = np.array([[[4e-6, -1e-6], [-1e-6, 9e-6]]])
        columns = ScanColumns(np.arange(1), np.ones(1), np.array([0.01]), np.full((1, 2), 0.3), covariance)
        grid, rules, detector = self.GRID, ChoiceRules(), TdiDetector()
        model = DriftMtf(columns, grid, detector.exposure, rules)
        setting = np.array([[20], ])  # fmt: skip
        found = merit_of(model, np.array([400.0]), setting, grid, detector, rules)[0, 0]
        stages, ratio = int(grid.stages_of(setting)[0, 0]), 0.8
        draws = np.random.default_rng(1).multivariate_normal([1.0, 0.01], covariance[0], 20_000)
        mtf = [np.abs(drift_transfer(stages, ratio, *draws.T, *f)) for f in ((0.5, 0.0), (0.0, 0.5))]
        each = 0.09 * mtf[0] * mtf[1] * np.sqrt(400.0 * stages * ratio)
        # 64 points of a Sobol sequence: some 1/64 of the spread
        assert found == pytest.approx(each.mean(), abs=each.std() / 16)

    def test_a_signal_that_may_be_higher_must_not_saturate(self):
        detector = TdiDetector(Exposure(), NoiseLaw(), None, np.inf, 10_000.0)
        sure = chosen(columns_of([1.0], [0.0]), [400.0], self.GRID, detector)
        unsure = chosen(
            columns_of([1.0], [0.0]),
            [400.0],
            self.GRID,
            detector,
            ChoiceRules(signal_sigma=0.1, quantile=0.05),
        )
        # 1.645 sigma of 10 % above: 10,000 / 1.1645 electrons at most
        assert (unsure.stages * 0.8 * 400.0 <= 10_000.0 / 1.1645).all()
        assert unsure.stages[0, 0] < sure.stages[0, 0]


def test_chunks_do_not_matter():
    columns = columns_of(np.full(300, 1.001), np.linspace(-0.02, 0.02, 300))
    grid = TdiGrid(np.arange(3, 65), np.array([0.5, 1.0]))
    whole = chosen(columns, [10.0, 1000.0], grid)
    parts = [chosen(columns.part(slice(k, k + 1)), [10.0, 1000.0], grid).setting for k in (0, 127, 128, 299)]
    assert_array_equal(whole.setting[[0, 127, 128, 299]], np.concatenate(parts))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TdiGrid(np.array([]), np.array([1.0])), "whole numbers from 1 up"),
        (lambda: TdiGrid(np.array([3, 2]), np.array([1.0])), "rising"),
        (lambda: TdiGrid(np.array([2.5]), np.array([1.0])), "whole number"),
        (lambda: TdiGrid(np.array([2]), np.array([0.5, 1.2])), "above 0 up to 1"),
        (lambda: TdiGrid(np.array([2]), np.array([0.0])), "above 0 up to 1"),
        (lambda: TdiDetector(full_well_line=0.0), "a full well is above 0"),
        (lambda: ChoiceRules(merit="sum"), "allowed are product"),
        (lambda: ChoiceRules(mtf_min=0.5, mtf_max=0.4), "mtf_min <= mtf_max"),
        (lambda: ChoiceRules(quantile=1.0), "between 0 and 1"),
        (lambda: columns_of([1.0, np.nan], [0.0, 0.0]), "finite values"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_merit_forms():
    mtf = np.array([0.2, 0.8])
    assert [float(mtf_merit(mtf, name)) for name in FORMS] == pytest.approx([0.16, 0.4, 0.5, 0.2, 0.2, 0.8])
