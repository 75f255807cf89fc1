"""Stacks of frames: how much of them is held at once, and several as one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from sightline.imaging import photon_transfer
from sightline.imaging.noise_estimation import Estimate
from sightline.imaging.photon_transfer import (
    compare_columns,
    fit_transfer,
    measure_stack,
    same_exposure,
    with_noise_of,
)
from sightline.imaging.source import ArrayImage


class Watched(ArrayImage):
    """Frame that keeps how many pixels were asked for."""

    most = 0

    def read(self, lines, columns):
        found = super().read(lines, columns)
        Watched.most = max(Watched.most, found.size)
        return found


def stack(frames, level=0.0, sigma=1.0, seed=0, shape=(64, 40)):
    rng = np.random.default_rng(seed)
    fixed = level + rng.standard_normal(shape)
    arrays = [fixed + sigma * rng.standard_normal(shape) for _ in range(frames)]
    means = [float(one.mean()) for one in arrays]
    dead = np.zeros(shape[1], dtype=bool)
    return measure_stack([Watched(one) for one in arrays], means, -np.inf, np.inf, dead)


def test_more_frames_take_fewer_lines_at_once(monkeypatch):
    whole = stack(16)
    monkeypatch.setattr(photon_transfer, "AT_ONCE", 64 * 40)
    Watched.most = 0
    parts = stack(16)
    # of eight pairs a difference each is held
    assert Watched.most * 8 <= 64 * 40
    assert parts.noise.value == pytest.approx(whole.noise.value, rel=1e-6)
    assert parts.fixed.value == pytest.approx(whole.fixed.value, rel=1e-6)


def test_noise_of_unlike_exposures_is_pooled_by_degrees_of_freedom():
    whole, few, many = stack(9, seed=3), stack(2, 10.0, 2.0, 1), stack(7, 20.0, 1.0, 2)
    both = with_noise_of(whole, [few, many])
    assert (both.frames, both.freedom) == (9, 7) and both.pixels == whole.pixels
    assert both.noise.value == pytest.approx((few.noise.value + 6.0 * many.noise.value) / 7.0)
    assert both.noise.sigma == pytest.approx(np.hypot(few.noise.sigma, 6.0 * many.noise.sigma) / 7.0)
    left = whole.fixed.value + whole.noise.value / 9.0
    assert both.fixed.value + both.noise.value / 9.0 == pytest.approx(left)
    alone = with_noise_of(many, [many])
    assert alone.noise == many.noise and alone.fixed == many.fixed


def test_the_sigma_of_a_column_is_the_scatter_of_its_means():
    """Noise of 2 DN over four frames, a pattern of 3 DN over 60 pixels: 0.41 DN, known to 1 / sqrt(2 n)."""
    rng = np.random.default_rng(5)
    pattern = 100.0 + 3.0 * rng.standard_normal((60, 500))
    frames = [ArrayImage(pattern + 2.0 * rng.standard_normal(pattern.shape)) for _ in range(4)]
    stack = measure_stack(frames, [100.0] * 4, 0.0, 1e3, np.zeros(500, np.bool_))
    scatter = np.std(stack.columns())
    assert abs(scatter / stack.column_sigma() - 1.0) < 4.0 / np.sqrt(2.0 * 500)


def test_a_law_through_exposures_weighs_them_by_their_noise_and_by_what_that_does_not_explain():
    """Weighted least squares written out; the misfit is the root of chi-square less the freedom."""
    signals = np.array([100.0, 250.0, 400.0, 800.0])
    law = np.array([0.3, 16.0])
    off = np.array([4.0, -9.0, 12.0, -20.0])
    noise = [
        Estimate(float(v), s)
        for v, s in zip(signals * law[0] + law[1] + off, (1.0, 2.0, 1.5, 4.0), strict=True)
    ]
    resting = Estimate(15.0, 0.8)
    sigma = np.array([one.sigma for one in (*noise, resting)])
    values, rows = np.array([one.value for one in (*noise, resting)]), np.ones((5, 2))
    rows[:, 0] = [*signals, 0.0]

    def solved(misfit):
        spread = np.sqrt(sigma**2 + misfit**2 * rows[:, 0] ** 2)
        found, (left,) = np.linalg.lstsq(rows / spread[:, None], values / spread, rcond=None)[:2]
        return found, left, spread

    found = fit_transfer(signals, noise, resting)
    misfit = brentq(lambda m: solved(m)[1] - 3.0, 1e-6, 1.0)
    expected, _, spread = solved(misfit)
    assert found.misfit == pytest.approx(misfit, rel=1e-6)
    np.testing.assert_allclose(found.fit.coefficients, expected, rtol=1e-6)
    np.testing.assert_allclose(
        found.fit.covariance, np.linalg.inv((rows / spread[:, None] ** 2).T @ rows), rtol=1e-5
    )
    weights = signals / spread[:4] ** 2
    np.testing.assert_allclose(found.weights, weights / (weights @ signals), rtol=1e-5)
    # values that go with the law to their sigma show no misfit
    even = [Estimate(float(v), one.sigma) for v, one in zip(signals * law[0] + law[1], noise, strict=True)]
    exact = fit_transfer(signals, even, Estimate(law[1], 0.8))
    assert exact.misfit == 0.0
    np.testing.assert_allclose(exact.fit.coefficients, law, rtol=1e-9)
    # one exposure and nothing else has a slope alone
    alone = fit_transfer(signals[:1], noise[:1], None)
    np.testing.assert_allclose(alone.fit.coefficients, [noise[0].value / 100.0])


def test_columns_are_alike_where_they_differ_by_their_sigma_and_the_rest_is_told():
    rng = np.random.default_rng(6)
    sigma = rng.uniform(0.5, 2.0, 400)
    values = 5.0 + sigma * rng.standard_normal(400)
    values[7] = np.nan
    found = compare_columns(values, sigma)
    good = np.isfinite(values)
    mean = np.average(values[good], weights=sigma[good] ** -2)
    assert found.chi_square == pytest.approx((((values - mean) / sigma)[good] ** 2).sum())
    assert found.freedom == 398 and found.alike
    # what single columns add, of one sigma each: 1.5, to a tenth, with a limit some tenths above
    rest = [compare_columns(rng.standard_normal(200) * np.hypot(1.0, 1.5), 1.0) for _ in range(40)]
    assert not any(one.alike for one in rest)
    assert np.mean([one.scatter for one in rest]) == pytest.approx(1.5, rel=0.05)
    # 2 sigma on one side: 39 of 40, in the mean
    assert 35 <= sum(one.upper > 1.5 for one in rest)
    assert np.mean([one.upper for one in rest]) < 1.5 * 1.3
    two = compare_columns(np.array([1.0, 7.0]), 3.0, free=2)
    # one degree of freedom at least: chi-square is 2 of 1, the mean variance of a column 9
    assert (two.freedom, two.scatter) == (1, pytest.approx(3.0))
    assert two.upper == pytest.approx(3.0 * np.sqrt(1.0 + 2.0 * np.sqrt(2.0) * 2.0))
    # chi-square of one degree has the sigma sqrt(2): three of it are reached 3.24 sigma apart
    assert [compare_columns(np.array([0.0, d]), 1.0).alike for d in (3.2, 3.3)] == [True, False]


def test_exposures_are_parted_where_means_are_further_apart_than_the_tolerance():
    means = np.array([50.0, 10.0, 51.0, 10.4, 53.5, 90.0])
    tolerance = np.array([2.0, 0.1, 2.0, 0.5, 2.6, 5.0])
    # the larger tolerance of two neighbours counts
    assert same_exposure(means, tolerance) == [[1, 3], [0, 2, 4], [5]]
    assert same_exposure(means, np.full(6, 0.3)) == [[1], [3], [0], [2], [4], [5]]


def test_noise_is_known_as_well_as_pairs_of_frames_agree():
    """Pairs of 1, 3, 2 and 4 DN: their scatter is far more than that of the pixels of one frame."""
    rng, sigmas = np.random.default_rng(8), np.repeat([1.0, 3.0, 2.0, 4.0], 2)
    arrays = [50.0 + s * rng.standard_normal((30, 44)) for s in sigmas]
    frames, means = [ArrayImage(one) for one in arrays], [float(one.mean()) for one in arrays]
    found = measure_stack(frames, means, 0.0, 100.0, np.zeros(44, np.bool_))
    of_pairs = [np.var(b - a) / 2.0 for a, b in zip(arrays[::2], arrays[1::2], strict=True)]
    # pixels come in single precision: 4e-6 of 50 DN over a difference of 1 DN
    assert found.noise.sigma == pytest.approx(np.std(of_pairs, ddof=1) / 2.0, rel=1e-4)
    assert found.noise.value == pytest.approx(np.var(arrays, axis=0, ddof=1).mean(), rel=0.01)


@pytest.mark.parametrize("along", [0, 1], ids=["columns jump", "rows jump"])
def test_the_fixed_pattern_scatters_as_stated_where_rows_or_columns_jump_from_frame_to_frame(along):
    """A pattern of 3 DN of 14 rows or columns that jump by 1.5 DN, and noise of 1 DN, three frames."""
    rng, shape = np.random.default_rng(9), (14, 40)[:: 1 if along else -1]
    size = tuple(1 if axis == along else shape[axis] for axis in (0, 1))
    pattern = 100.0 + 3.0 * rng.standard_normal(size)
    values, sigmas = [], []
    for _ in range(200):
        noise = rng.standard_normal((3, *shape)) + 1.5 * rng.standard_normal((3, *size))
        frames = [ArrayImage(pattern + one) for one in noise]
        fixed = measure_stack(frames, [100.0] * 3, 0.0, 1e3, np.zeros(shape[1], np.bool_)).fixed
        values.append(fixed.value)
        sigmas.append(fixed.sigma)
    # a sigma of 200 draws is known to 1 / sqrt(2 n), 5 %; four of them
    assert np.std(values) / np.mean(sigmas) == pytest.approx(1.0, abs=0.2)
