"""Transfer of a TDI column against a brute-force column, published limits and another formula."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.special import j0

from sightline.errors import InputError
from sightline.imaging.tdi_transfer import (
    ALIGNMENTS,
    Exposure,
    dirichlet,
    drift_transfer,
    jitter_transfer,
    motion_transfer,
    patent_transfer,
    phases,
)
from tdi.brute_force_column import TdiColumn


def drifting(velocity, slip):
    """Path of a scene in constant drift."""
    across = velocity * np.tan(slip)
    return lambda t: (across * t, velocity * t)


class TestDrift:
    def test_it_is_what_a_brute_force_column_images(self):
        rng = np.random.default_rng(7)
        for case in range(60):
            n, head = int(rng.integers(3, 30)), int(rng.integers(0, 4))
            ratio, head_ratio = rng.uniform(0.05, 1.0, 2)
            velocity, slip = 1.0 + 0.01 * rng.normal(), 0.03 * rng.normal()
            fx, fy = rng.uniform(0.0, 0.5, 2)
            align = list(ALIGNMENTS)[case % 3]
            exposure = Exposure(head, head_ratio, align)
            column = TdiColumn(n, ratio, head, head_ratio, ALIGNMENTS[align], instants=100)
            # 100 instants of the midpoint rule over at most half a cycle: (pi / 2 / 100)^2 / 6
            expected = column.response(fx, fy, drifting(velocity, slip))
            assert_allclose(drift_transfer(n, ratio, velocity, slip, fx, fy, exposure), expected, atol=5e-5)

    def test_uniform_exposures_are_a_sinc_times_a_dirichlet_kernel(self):
        n, ratio, velocity, slip = 17, 0.7, 1.004, 0.011
        psi, phi = phases(velocity, slip, 0.35, 0.35)
        expected = abs(np.sinc(ratio * psi) * np.sin(np.pi * n * phi) / (n * np.sin(np.pi * phi)))
        assert_allclose(abs(drift_transfer(n, ratio, velocity, slip, 0.35, 0.35)), expected, rtol=1e-12)

    def test_whole_exposures_and_slip_alone_are_one_long_smear(self):
        # Kt = 1, fy = 0: the line is exposed without a break while the scene crosses N tan(g)
        n, slip = 40, np.radians(1.0)
        assert_allclose(abs(drift_transfer(n, 1.0, 1.0, slip, 0.5, 0.0)), np.sinc(n * np.tan(slip) * 0.5))

    def test_johnsons_synchronism_mtf(self):
        # pyBSM's tdi_OTF with one phase and beta = 1 / V: a sinc of the motion within a stage, a Dirichlet
        # kernel of the mismatch
        velocity, n, f = 1.02, 20, 0.5
        step = (velocity - 1.0) * f
        expected = abs(np.sinc(velocity * f) * np.sin(np.pi * n * step) / (n * np.sin(np.pi * step)))
        assert_allclose(abs(drift_transfer(n, 1.0, velocity, 0.0, 0.0, f)), expected, rtol=1e-12)

    def test_no_frequency_no_loss(self):
        found = drift_transfer([1, 5, 64], 0.4, 1.1, 0.2, 0.0, 0.0, Exposure(2, 0.25, "start"))
        assert_allclose(found, np.ones(3), atol=1e-14)

    def test_best_number_of_stages_for_photons(self):
        # sin x / sqrt x is largest where tan x = 2 x: N |phi| = 0.3710, MTF 0.7885
        found = minimize_scalar(
            lambda x: -np.sqrt(x) * abs(drift_transfer(1.0, x, 1.0, np.arctan(1e-0), 1.0, 0.0)),
            bounds=(0.1, 0.9), method="bounded", options={"xatol": 1e-9},
        )  # fmt: skip
        assert found.x == pytest.approx(0.3710, abs=5e-5)
        assert abs(drift_transfer(1.0, found.x, 1.0, np.arctan(1.0), 1.0, 0.0)) == pytest.approx(
            0.7885, abs=5e-5
        )


class TestPatent:
    def test_full_exposures_differ_by_the_smear_within_a_stage_only(self):
        # slip 1 degree, 40 stages at half a cycle per pixel: 0.811 in both forms; 0.988 in the patent's for
        # short exposures, which is wrong
        slip = np.radians(1.0)
        assert patent_transfer(40, 1.0, 1.0, slip, 0.5, 0.0) == pytest.approx(0.811, abs=5e-4)
        for ratio, flattered in ((0.8, 0.877), (0.5, 0.951), (0.25, 0.988)):
            assert patent_transfer(40, ratio, 1.0, slip, 0.5, 0.0) == pytest.approx(flattered, abs=5e-4)
            assert abs(drift_transfer(40, ratio, 1.0, slip, 0.5, 0.0)) == pytest.approx(0.811, abs=1.5e-3)

    @pytest.mark.parametrize(
        ("head", "head_ratio", "n", "ratio", "patent", "centred", "started"),
        [
            (2, 0.1, 10, 1.0, 0.746, 0.645, 0.625),
            (4, 0.1, 10, 1.0, 0.840, 0.659, 0.610),
            (2, 0.1, 20, 0.8, 0.795, 0.760, 0.753),
            (2, 0.5, 20, 0.8, 0.773, 0.766, 0.760),
        ],
    )
    def test_mixed_exposures(self, head, head_ratio, n, ratio, patent, centred, started):
        assert patent_transfer(n, ratio, 1.0, 0.0, 0.0, 0.5, Exposure(head, head_ratio)) == pytest.approx(
            patent, abs=6e-4
        )
        for align, expected in (("centre", centred), ("start", started), ("end", started)):
            exact = drift_transfer(n, ratio, 1.0, 0.0, 0.0, 0.5, Exposure(head, head_ratio, align))
            assert abs(exact) == pytest.approx(expected, abs=6e-4)


class TestDirichlet:
    def test_at_whole_numbers_it_is_one_or_minus_one(self):
        assert_allclose(dirichlet([4, 5, 4, 5], [0.0, 1.0, 1.0, 2.0]), [1.0, 1.0, -1.0, 1.0])
        near = dirichlet([4, 5, 4, 5], np.array([0.0, 1.0, 1.0, 2.0]) + 1e-7)
        assert_allclose(near, [1.0, 1.0, -1.0, 1.0], rtol=1e-10)


class TestJitter:
    def test_it_is_what_a_brute_force_column_images(self):
        amplitude, frequency, phase, n, ratio = (0.15, 0.25), 0.07, 0.4, 12, 0.6

        def path(t):
            wave = np.sin(2.0 * np.pi * frequency * t + phase)
            return 0.01 * t + amplitude[0] * wave, 1.002 * t + amplitude[1] * wave

        expected = TdiColumn(n, ratio).response(0.3, 0.45, path)
        slip = np.arctan(0.01 / 1.002)
        found = jitter_transfer(n, ratio, 1.002, slip, 0.3, 0.45, amplitude, frequency, phase)
        assert_allclose(found, expected, atol=1e-5)

    def test_one_whole_period_is_the_bessel_function(self):
        found = jitter_transfer(20, 1.0, 1.0, 0.0, 0.5, 0.0, (0.2, 0.0), 1.0 / 20.0, 1.0)
        assert abs(found) == pytest.approx(j0(2.0 * np.pi * 0.5 * 0.2), abs=1e-4)

    def test_a_whole_number_of_periods_per_line_is_frozen_by_a_short_shutter(self):
        found = jitter_transfer(20, 1e-3, 1.0, 0.0, 0.5, 0.0, (0.2, 0.0), 1.0)
        assert abs(found) == pytest.approx(1.0, abs=1e-4)


class TestMotion:
    def test_every_number_of_stages_is_what_a_brute_force_column_images(self):
        rng = np.random.default_rng(3)
        # a motion that is linear between line periods, as the function takes it
        walk = 0.05 * np.cumsum(rng.normal(size=(40, 2)), axis=0)
        exposure, start = Exposure(2, 0.3, "start"), 4.0
        ratios = np.array([0.4, 0.9])
        found = motion_transfer(12, ratios, 1.003, 0.01, 0.2, 0.4, walk, start, exposure)

        def path(t):
            x, y = (np.interp(t, np.arange(40), walk[:, c]) for c in range(2))
            return 1.003 * np.tan(0.01) * (t - start) + x, 1.003 * (t - start) + y

        for r, ratio in enumerate(ratios):
            for n in (1, 5, 12):
                column = TdiColumn(n, ratio, 2, 0.3, 0.5)
                # exposures that straddle a bend of the motion: Gauss points miss it by 1e-3 of its size
                assert_allclose(found[r, n - 1], column.response(0.2, 0.4, path, start), atol=2e-4)

    def test_a_motion_that_ends_too_soon_is_refused(self):
        with pytest.raises(InputError, match="give a longer motion, or fewer stages"):
            motion_transfer(20, 0.5, 1.0, 0.0, 0.5, 0.0, np.zeros((20, 2)), 2.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((2, 0.5, "middle"), "`align` is 'middle'"), ((-1, 0.5), "0 or more"), ((2, 0.0), "share of the line")],
)
def test_exposures_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Exposure(*arguments)
