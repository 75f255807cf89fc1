"""The prior with its drift apart: exact across gaps where a plain autoregression is not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.estimation.evidence import posterior
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.series import DifferenceSeries, Grid, series_equations
from sightline.estimation.split import Layout, coarse_ratio, gather_band, split, spread_band

STEP = 1e-3
SPECTRUM = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 0.005), Tone(0.3, 47.0, 0.8)))


def gappy(n: int, gap: tuple[int, int], lags: tuple[int, ...]) -> tuple[list[DifferenceSeries], np.ndarray]:
    """Pairs of a known motion without anything that touches the gap, and their dense rows."""
    rng = np.random.default_rng(2)
    t = np.arange(n) * STEP
    x = 1.5 * np.sin(2.5 * t) + 0.3 * np.cos(2.0 * np.pi * 47.0 * t)
    series, rows = [], []
    for lag in lags:
        k = np.arange(0, n - lag, 5)
        outside = [(e < gap[0]) | (e >= gap[1]) for e in (k, k + lag)]
        k = k[outside[0] & outside[1]]
        h = np.zeros((len(k), n))
        h[np.arange(len(k)), k], h[np.arange(len(k)), k + lag] = -1.0, 1.0
        values = h @ x + 0.03 * rng.normal(size=len(k))
        series.append(DifferenceSeries(t[k], np.full(len(k), lag * STEP), values, np.full(len(k), 9e-4)))
        rows.append(h)
    return series, np.vstack(rows)


def test_across_a_gap_longer_than_its_memory_mean_and_sigma_are_those_of_the_exact_prior(dense) -> None:  # type: ignore[no-untyped-def]
    n = 600
    series, rows = gappy(n, (250, 400), (90, 22, 7))
    y = np.concatenate([s.values for s in series])
    exact = dense.solve(dense.covariance(n), rows, 9e-4 * np.eye(len(y)), y)
    equations = series_equations(series, Grid(0.0, STEP, n))
    apart = split(SPECTRUM, STEP, 60, n, width=90)
    assert apart is not None
    now = posterior(equations, apart)
    centring = np.eye(n) - 1.0 / n
    true = np.sqrt(np.diag(centring @ exact.covariance @ centring))
    covariance = now.covariance_times(np.eye(n))
    found = np.sqrt(np.diag(centring @ covariance @ centring))
    # An order of 60 for the fast part costs up to 2 % of sigma in the middle of the gap; a plain
    # autoregression of that order is off by a third there.
    np.testing.assert_allclose(found, true, rtol=0.03)
    assert np.max(np.abs(centring @ (now.mean - exact.mean)) / true) < 0.25
    plain = posterior(equations, SPECTRUM.autoregressive(STEP, 60, n)).covariance_times(np.eye(n))
    wrong = np.sqrt(np.diag(centring @ plain @ centring))
    assert np.max(np.abs(wrong / true - 1.0)) > 0.2


def test_mean_band_and_product_of_one_posterior_agree() -> None:
    series, _ = gappy(300, (120, 160), (40, 7))
    equations = series_equations(series, Grid(0.0, STEP, 300))
    apart = split(SPECTRUM, STEP, 30, 300, width=40)
    assert apart is not None
    now = posterior(equations, apart)
    covariance = now.covariance_times(np.eye(300))
    band = now.covariance_band(7)
    for d in (0, 3, 7):
        np.testing.assert_allclose(band[d, : 300 - d], np.diag(covariance, -d), rtol=1e-6)


def test_the_determinant_of_the_joint_precision_is_the_sum_of_both() -> None:
    n = 200
    apart = split(SPECTRUM, STEP, 20, n)
    assert apart is not None
    layout = Layout.interleaved(n, apart.ratio)
    band = np.zeros((apart.width(layout) + 1, layout.size))
    apart.add_to(band, layout)
    lower = sum(np.diag(band[d, : layout.size - d], -d) for d in range(len(band)))
    full = lower + np.tril(lower, -1).T
    assert np.linalg.slogdet(full)[1] == pytest.approx(apart.logdet, rel=1e-6)


def test_three_processes_interleave_without_touching_each_other() -> None:
    n, block = 120, 3
    apart = split(SPECTRUM, STEP, 10, n)
    assert apart is not None
    layout = Layout.interleaved(n, apart.ratio, block=block)
    assert sorted([*layout.fine.ravel(), *layout.coarse.ravel()]) == list(range(layout.size))
    single = Layout.interleaved(n, apart.ratio)
    alone = np.zeros((apart.width(single) + 1, single.size))
    apart.add_to(alone, single)
    band = np.zeros((max(apart.width(layout, a) for a in range(block)) + 1, layout.size))
    for axis in range(block):
        apart.add_to(band, layout, axis)
    places = np.sort(np.concatenate([layout.fine[:, 1], layout.coarse[:, 1]]))
    np.testing.assert_allclose(gather_band(band, places, len(alone) - 1), alone)


@pytest.mark.parametrize("weighted", [False, True])
def test_some_columns_are_those_of_the_whole(weighted: bool) -> None:
    apart = split(SPECTRUM, STEP, 12, 400, ratio=8)
    assert apart is not None
    layout = Layout.interleaved(400, 8, block=3)
    weights = np.random.default_rng(5).uniform(0.1, 1.0, 400) if weighted else None
    whole = np.zeros((max(apart.width(layout, axis) for axis in range(3)) + 1, layout.size))
    for axis in range(3):
        apart.add_to(whole, layout, axis, weights)
    for begin, end in pairwise([0, 1, 170, 171, 640, layout.size]):
        piece = np.zeros((len(whole), end - begin))
        for axis in range(3):
            apart.add_to(piece, layout, axis, weights, begin)
        assert np.array_equal(piece, whole[:, begin:end])


def test_nothing_slow_or_nothing_fast_is_left_to_the_plain_prior() -> None:
    assert split(Spectrum((Matern(1.0, 0.005),)), STEP, 40, 500) is None
    assert split(Spectrum((Matern(1.0, 1.0, "5/2"),)), STEP, 40, 500) is None
    assert coarse_ratio(Spectrum((Matern(1.0, 0.01, "5/2"),)), STEP, 40) is None


def test_spreading_a_band_over_the_wrong_places_is_refused() -> None:
    with pytest.raises(InputError, match="`position` must hold 5 places"):
        spread_band(np.ones((2, 5)), np.arange(4), np.ones((9, 9)))
