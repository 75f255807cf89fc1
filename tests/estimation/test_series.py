"""Rows of differences on a grid: interpolation, windows, weights and bad input."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.estimation.series import DifferenceSeries, Grid, series_equations


def series(t: np.ndarray, lag: float, values: np.ndarray, **options: object) -> DifferenceSeries:
    return DifferenceSeries(t, np.full(len(t), lag), values, np.ones(len(t)), **options)  # type: ignore[arg-type]


def dense(band: np.ndarray) -> np.ndarray:
    n = band.shape[1]
    lower = sum(np.diag(band[d, : n - d], -d) for d in range(min(len(band), n)))
    return lower + np.tril(lower, -1).T


def test_interpolation_is_exact_for_a_polynomial_of_degree_five() -> None:
    grid = Grid(-0.3, 0.1, 30)
    x = grid.nodes**5 - 2.0 * grid.nodes**2
    t = np.array([-0.3, -0.21, 0.234, 1.0, 2.55, 2.6])
    first, w = grid.weights(t)
    values = np.einsum("nk,nk->n", w, x[first[:, None] + np.arange(w.shape[1])])
    np.testing.assert_allclose(values, t**5 - 2.0 * t**2, atol=1e-10)


def test_a_window_averages_the_motion_over_its_length() -> None:
    # The mean of a sinusoid over a window w is the sinusoid times sinc(f w); 10 nodes per period, midpoint
    # sums of 2 ceil(w / step) + 2 points err by (pi f w / points)^2 / 6 = 0.3 %.
    grid = Grid(0.0, 1e-3, 200)
    f, w = 100.0, 5e-3
    t = np.linspace(0.02, 0.17, 40)
    first, weights = grid.weights(t, w)
    x = np.sin(2.0 * np.pi * f * grid.nodes)
    values = np.einsum("nk,nk->n", weights, x[first[:, None] + np.arange(weights.shape[1])])
    np.testing.assert_allclose(values, np.sinc(f * w) * np.sin(2.0 * np.pi * f * t), atol=0.005)


def test_a_fractional_lag_acts_at_its_own_time() -> None:
    grid = Grid(0.0, 0.01, 100)
    x = np.sin(2.0 * np.pi * 2.0 * grid.nodes)
    t = np.linspace(0.1, 0.7, 30)
    y = np.sin(2.0 * np.pi * 2.0 * (t + 0.0537)) - np.sin(2.0 * np.pi * 2.0 * t)
    e = series_equations([series(t, 0.0537, y)], grid)
    residual = e.misfit - 2.0 * e.rhs @ x + x @ dense(e.band) @ x
    # 50 nodes per period: interpolation errs by (2 pi / 50)^6 * 5 / 1024 = 2e-8.
    assert residual < len(t) * (1e-7) ** 2 + 1e-12


def test_a_negative_lag_is_the_same_pair_seen_from_the_other_image() -> None:
    grid = Grid(0.0, 0.01, 60)
    t = np.linspace(0.1, 0.4, 11)
    y = np.random.default_rng(0).normal(size=11)
    forward = series_equations([series(t, 0.0537, y)], grid)
    backward = series_equations([series(t + 0.0537, -0.0537, -y)], grid)
    np.testing.assert_allclose(backward.band, forward.band, atol=1e-12)
    np.testing.assert_allclose(backward.rhs, forward.rhs, atol=1e-12)


def test_measurements_without_value_or_with_endless_variance_are_left_out() -> None:
    t = np.linspace(0.1, 0.4, 5)
    values, variance = np.array([1.0, 1.0, np.nan, 1.0, 1.0]), np.array([1.0, 1.0, 1.0, np.inf, 1e12])
    s = DifferenceSeries(t, np.full(5, 0.05), values, variance)
    assert s.used.tolist() == [True, True, False, False, False]
    assert series_equations([s], Grid(0.0, 0.01, 60)).measurements == 2


def test_a_poor_pair_of_a_patch_keeps_its_excess_to_itself() -> None:
    # Three pairs of three images on one patch; the third is 100 times worse than closure with the others
    # allows, so it is no longer redundant, but adds little.
    grid = Grid(0.0, 0.01, 60)
    one = np.ones(1)

    def pair(t: float, lag: float, variance: float, images: tuple[int, int]) -> DifferenceSeries:
        many = np.arange(50)
        return DifferenceSeries(
            np.append(t, np.full(50, t)), np.full(51, lag), np.zeros(51),
            np.append(variance * one, np.full(50, 2.0)), images, patch=np.append(999, many),
        )  # fmt: skip

    e = series_equations(
        [pair(0.1, 0.1, 2.0, (0, 1)), pair(0.2, 0.1, 2.0, (1, 2)), pair(0.1, 0.2, 200.0, (0, 2))], grid
    )
    assert e.measurements == 50 * 2 + 3


def test_bad_input_is_named() -> None:
    t = np.linspace(0.1, 0.4, 4)
    with pytest.raises(InputError, match=r"must all have shape \(N,\)"):
        DifferenceSeries(t, np.ones(3), t, t)
    with pytest.raises(InputError, match="`patch` must have shape"):
        series(t, 0.1, t, patch=np.arange(3))
    with pytest.raises(InputError, match="outside the grid"):
        series_equations([series(t, 10.0, t)], Grid(0.0, 0.01, 60))
    with pytest.raises(InputError, match="no series holds a finite measurement"):
        series_equations([series(t, 0.1, t * np.nan)], Grid(0.0, 0.01, 60))


@pytest.mark.parametrize(("window", "tdi"), [(2e-3, 16e-3), (16e-3, 2e-3), (0.0, 8e-3)])
def test_tdi_averages_a_motion_besides_the_window(window: float, tdi: float) -> None:
    grid, f = Grid(0.0, 1e-3, 200), 47.0
    t = np.linspace(0.03, 0.17, 40)
    first, weights = grid.weights(t, window, tdi)
    x = np.sin(2.0 * np.pi * f * grid.nodes)
    values = np.einsum("nk,nk->n", weights, x[first[:, None] + np.arange(weights.shape[1])])
    left = np.sinc(f * window) * np.sinc(f * tdi)
    np.testing.assert_allclose(values, left * np.sin(2.0 * np.pi * f * t), atol=0.003)
