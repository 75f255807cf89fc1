"""Posterior, evidence and its gradient against dense matrices and against celerite2."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from sightline.estimation.evidence import EvenRate, Posterior, posterior
from sightline.estimation.prior import Autoregressive, Matern, Spectrum, Tone
from sightline.estimation.series import DifferenceSeries, Grid, image_variances, series_equations

STEP = 1e-3
N = 300
IMAGES = (0, 150, 157, 172)  # ms
SIGMA = np.array([0.02, 0.03, 0.03, 0.02])
TREE = [(0, 3), (0, 1), (1, 2)]
CLOSED = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def spectrum(timescale: float = 1.0, broadband: float = 0.1, frequency: float = 47.0) -> Spectrum:
    return Spectrum((Matern(2.0, timescale, "5/2"), Matern(broadband, 0.005), Tone(0.3, frequency, 0.8)))


@functools.cache
def truth() -> np.ndarray:
    """A smooth motion; which one does not matter where both sides see the same data."""
    t = np.arange(N) * STEP
    return np.asarray(2.0 * np.sin(3.0 * t) + 0.3 * np.cos(2.0 * np.pi * 47.0 * t))


def scene(pairs: list[tuple[int, int]]) -> tuple[list[DifferenceSeries], np.ndarray, np.ndarray, np.ndarray]:
    """Series of pairs that share image errors, the dense rows (H, J) and the noise covariance."""
    rng = np.random.default_rng(1)
    x = truth()
    k = np.arange(0, N - 172, 5)
    errors = rng.normal(size=(4, len(k))) * SIGMA[:, None]
    series, rows, constants, roots = [], [], [], []
    for a, b in pairs:
        h, j, m = np.zeros((len(k), N)), np.zeros((len(k), 4)), np.zeros((len(k), 4, len(k)))
        i = np.arange(len(k))
        h[i, k + IMAGES[a]], h[i, k + IMAGES[b]] = -1.0, 1.0
        j[:, a], j[:, b] = -1.0, 1.0
        m[i, a, i], m[i, b, i] = -SIGMA[a], SIGMA[b]
        series.append(
            DifferenceSeries(
                (k + IMAGES[a]) * STEP, np.full(len(k), (IMAGES[b] - IMAGES[a]) * STEP),
                h @ x + errors[b] - errors[a], np.full(len(k), SIGMA[a] ** 2 + SIGMA[b] ** 2),
                images=(a, b), patch=i,
            )
        )  # fmt: skip
        rows.append(h)
        constants.append(j)
        roots.append(m.reshape(len(k), -1))
    root = np.vstack(roots)
    return series, np.vstack(rows), np.vstack(constants), root @ root.T


def solved(series: list[DifferenceSeries], offsets: bool) -> Posterior:
    equations = series_equations(series, Grid(0.0, STEP, N), offsets=offsets)
    return posterior(equations, spectrum().autoregressive(STEP, N - 1, N), offset_sigma=0.5)


@pytest.mark.parametrize("pairs", [TREE, CLOSED], ids=["tree", "closed"])
@pytest.mark.parametrize("offsets", [False, True])
def test_mean_and_covariance_are_those_of_dense_conditioning(dense, pairs, offsets) -> None:  # type: ignore[no-untyped-def]
    series, rows, constants, noise = scene(pairs)
    now = solved(series, offsets)
    y = np.concatenate([s.values for s in series])
    if offsets:
        noise = noise + 0.25 * constants @ constants.T
    exact = dense.solve(dense.covariance(N), rows, noise, y)
    # The dense inverse of a condition of ~1e6 limits the comparison to 1e-7 of motions of size 2.
    np.testing.assert_allclose(now.mean, exact.mean, atol=5e-7)
    band = now.covariance_band(5)
    np.testing.assert_allclose(band[0], np.diag(exact.covariance), atol=1e-7)
    np.testing.assert_allclose(band[5, :-5], np.diag(exact.covariance, -5), atol=1e-7)
    if len(pairs) == 3:
        assert now.deviance == pytest.approx(exact.deviance, abs=1e-3)


def test_pairs_that_close_triangles_are_counted_once() -> None:
    tree, closed = solved(scene(TREE)[0], False), solved(scene(CLOSED)[0], False)
    assert closed.equations.measurements == tree.equations.measurements
    np.testing.assert_allclose(closed.covariance_band(0), tree.covariance_band(0), rtol=1e-4)


def test_the_variance_of_each_image_follows_from_those_of_closed_pairs() -> None:
    found = image_variances(scene(CLOSED)[0])
    np.testing.assert_allclose([found[k] for k in range(4)], SIGMA**2, rtol=1e-4)


def test_an_independent_part_makes_closing_pairs_count_again() -> None:
    series = scene(CLOSED)[0]
    grid = Grid(0.0, STEP, N)
    assert series_equations(series, grid, independent=0.1).measurements == 6 * len(series[0].t)
    assert series_equations(series, grid).measurements == 3 * len(series[0].t)


@pytest.mark.parametrize("seen", [False, True])
def test_a_known_rate_is_conditioned_on(dense, seen) -> None:  # type: ignore[no-untyped-def]
    series, rows, constants, noise = scene(TREE)
    grid = Grid(0.0, STEP, N)
    equations = series_equations(series, grid, offsets=True)
    known = EvenRate(1.5, seen)
    now = posterior(equations, spectrum().autoregressive(STEP, N - 1, N), offset_sigma=0.5, rate=known)
    t = grid.nodes - grid.nodes.mean()
    rate = t / (t @ t)
    free = dense.covariance(N)
    before = rate @ free @ rate
    held = free - np.outer(free @ rate, free @ rate) / before
    shape = free @ rate / before * known.value
    y = np.concatenate([s.values for s in series]) - rows @ shape
    noise = noise + 0.25 * constants @ constants.T
    exact = dense.solve(held, rows, noise, y)
    # as without: the dense inverse limits the comparison to 1e-7 of motions of size 2
    np.testing.assert_allclose(now.mean, exact.mean + shape, atol=5e-7)
    square = exact.covariance[0, 0] + now.mean[0] ** 2
    np.testing.assert_allclose(now.moments.start[0, 0], square, atol=1e-6)
    told = known.value**2 / before + np.log(before) if seen else 0.0
    assert now.deviance == pytest.approx(exact.deviance + told, abs=1e-3)
    whitened = np.linalg.solve(rows @ held @ rows.T + noise, y)
    np.testing.assert_allclose(now.score, rows.T @ whitened, atol=1e-5 * np.abs(now.score).max())
    waves = np.random.default_rng(2).normal(size=(N, 3))
    along = rows @ waves
    expected = along.T @ np.linalg.solve(rows @ held @ rows.T + noise, along)
    np.testing.assert_allclose(now.seen_of(waves), expected, rtol=1e-5)


@pytest.mark.parametrize("rate", [None, EvenRate(1.5), EvenRate(1.5, seen=True)])
def test_the_gradient_by_moments_is_the_slope_of_the_deviance(rate) -> None:  # type: ignore[no-untyped-def]
    series = scene(TREE)[0]
    equations = series_equations(series, Grid(0.0, STEP, N), offsets=True)

    def at(p: np.ndarray) -> Posterior:
        prior = spectrum(*p[:3]).autoregressive(STEP, 40, N)
        return posterior(equations, prior, noise_scale=p[3], offset_sigma=0.5, rate=rate)

    p = np.array([1.0, 0.1, 47.0, 1.1])
    now = at(p)
    assert isinstance(now.prior, Autoregressive)
    lags = STEP * np.arange(41.0)
    by_lag = now.moments.deviance_slope(now.prior, spectrum(*p[:3]).autocovariance(lags))
    for k in range(3):
        step = np.zeros(4)
        step[k] = 1e-4 * p[k]
        slope = at(p + step).deviance - at(p - step).deviance
        moved = [spectrum(*(p + s * step)[:3]).autocovariance(lags) for s in (1, -1)]
        assert by_lag @ (moved[0] - moved[1]) == pytest.approx(slope, rel=1e-4, abs=1e-7)
    ratio = np.array([1.0, 1.0, 1.0, np.exp(1e-4)])
    slope = (at(p * ratio).deviance - at(p / ratio).deviance) / 2e-4
    assert at(p).deviance_by_noise_scale == pytest.approx(slope, rel=1e-4)


def test_the_evidence_of_a_very_long_lag_is_that_of_celerite2() -> None:
    # Over a lag at which the process has forgotten itself (exp(-pi 10 Hz 2 s) = 5e-28) a difference is the
    # sum of two independent copies: twice the kernel, which celerite2 solves with an algorithm of its own.
    celerite2 = pytest.importorskip("celerite2", reason="the celerite2 package is not installed")
    rng = np.random.default_rng(3)
    step, n, sigma = 5e-3, 200, 0.05
    t = step * np.arange(n)
    part = Tone(0.3, 20.0, 10.0)
    damping, turn = np.pi * part.bandwidth, 2.0 * np.pi * part.frequency
    own = np.hypot(damping, turn)
    term = celerite2.terms.SHOTerm(sigma=np.sqrt(2.0) * part.sigma, rho=2.0 * np.pi / own, tau=1.0 / damping)
    process = celerite2.GaussianProcess(term, mean=0.0)
    process.compute(t, diag=np.full(n, sigma**2))
    y = 0.3 * np.sin(2.0 * np.pi * 20.0 * t) + sigma * rng.normal(size=n)
    grid = Grid(0.0, step, 600)
    equations = series_equations([DifferenceSeries(t, np.full(n, 2.0), y, np.full(n, sigma**2))], grid)
    now = posterior(equations, Spectrum((part,)).autoregressive(step, 100, grid.count))
    expected = -2.0 * process.log_likelihood(y) - n * np.log(2.0 * np.pi)
    assert now.deviance == pytest.approx(expected, abs=1e-4)
