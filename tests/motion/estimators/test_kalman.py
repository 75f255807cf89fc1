from dataclasses import replace

import numpy as np
import pytest

from consistency import assert_consistent
from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.kalman import kalman, state_space

SMALL = Spectrum((Matern(1.0, 0.3, "5/2"), Matern(0.1, 0.01), Tone(0.3, 47.0, 0.5)))


def dense_posterior(prior, pairs, count, step, axis):
    """Mean and variance of the mean-free motion by plain Gaussian conditioning on the grid."""
    from scipy.linalg import toeplitz

    c = toeplitz(prior.autocovariance(step * np.arange(count)))
    rows, y, r = [], [], []
    for pair in pairs:
        row = np.zeros((len(pair.t), count))
        each = np.arange(len(pair.t))
        np.add.at(row, (each, np.rint(pair.t / step).astype(int)), -1.0)
        np.add.at(row, (each, np.rint((pair.t + pair.lag) / step).astype(int)), 1.0)
        rows.append(row)
        y.append(pair.angles[:, axis])
        r.append(pair.covariance[:, axis, axis])
    h = np.concatenate(rows)
    k = np.linalg.solve(h @ c @ h.T + np.diag(np.concatenate(r)), h @ c).T
    projection = np.eye(count) - 1.0 / count
    posterior = projection @ (c - k @ h @ c) @ projection
    return projection @ k @ np.concatenate(y), np.diag(posterior)


@pytest.mark.parametrize("gap", [None, (0.15, 0.25)])
def test_it_equals_the_dense_posterior_with_and_without_a_gap(series, gap):
    rng = np.random.default_rng(0)
    theta = series.cholesky_of(SMALL, 401) @ rng.standard_normal((401, 3))
    pairs = series.measure(theta, [60, 22, 7], 0.03, rng, gap=gap)
    t = series.step * np.arange(401)
    motion = kalman(pairs, t, prior=SMALL, grid_step=series.step)
    for axis in range(3):
        mean, variance = dense_posterior(SMALL, pairs, 401, series.step, axis)
        # The constant is known to 3 sigma of the prior (1 px) instead of not at all: of a constant of 1 px
        # the share (relative variance / constant's variance) = 0.03^2 / (9 + 1) = 1e-4 is taken for motion.
        assert motion.angles[:, axis] == pytest.approx(mean, abs=1e-4)
        assert motion.covariance[:, axis, axis] == pytest.approx(variance, rel=1e-3)


@pytest.mark.parametrize("order", ["3/2", "5/2", "9/2", "17/2"])
def test_the_state_space_of_a_matern_keeps_its_autocovariance(order):
    # nine states of one size: transition and stationary covariance are good to 1e-9 of the variance
    part = Matern(0.7, 0.02, order)
    space = state_space(Spectrum((part,)), 2e-3)
    power = np.eye(len(space.output))
    for lag in range(12):
        found = space.output @ power @ space.stationary @ space.output
        assert found == pytest.approx(float(part.autocovariance(np.array([2e-3 * lag]))[0]), abs=1e-8)
        power = space.transition @ power


def test_negative_lags_and_times_off_the_grid_are_followed(series):
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0.1, 0.8, 300))
    lag = -0.05 + 2e-3 * rng.standard_normal(300)

    def angle(when):
        return np.stack([np.sin(9 * when), np.cos(7 * when), when**2], axis=1)

    pair = AngleDifferences(t, lag, angle(t + lag) - angle(t), np.tile(1e-10 * np.eye(3), (300, 1, 1)))
    at = np.linspace(0.1, 0.75, 50)
    smooth = Spectrum((Matern(1.0, 0.3, "5/2"),))
    motion = kalman([pair], at, prior=smooth, grid_step=5e-3)
    # Cubic interpolation on 5 ms of sin(9 t): (9 * 5e-3)^4 * 3/128 = 1e-7; noise 1e-5 times about T/lag.
    assert series.centred(motion.angles) == pytest.approx(series.centred(angle(at)), abs=2e-4)


def test_a_mean_over_a_window_is_followed_as_one(series):
    # 8 ms of a tone of 47 Hz leave sinc(0.376) = 0.78 of it
    window, frequency = 8e-3, 47.0
    t = np.arange(0.02, 0.8, 2e-3)

    def angle(when):
        return np.sin(2.0 * np.pi * frequency * when)[:, None] * np.array([1.0, -0.5, 0.2])

    seen = np.sinc(frequency * window) * (angle(t + 0.027) - angle(t))
    pair = AngleDifferences(t, 0.027, seen, np.tile(1e-8 * np.eye(3), (len(t), 1, 1)), window=window)
    at = np.linspace(0.05, 0.75, 400)
    tone = Spectrum((Matern(1.0, 0.3, "5/2"), Tone(1.0, frequency, 0.01)))
    found = kalman([pair], at, prior=tone, grid_step=1e-3)
    # a midpoint rule of p = 10 points has (pi f d / p)^2 / 6 = 0.2 % of it too much, and cubic interpolation
    # on 1 ms (2 pi f step)^4 * 9 / 384 = 2e-4; a window taken for an instant would leave 0.78
    assert series.centred(found.angles) == pytest.approx(series.centred(angle(at)), abs=0.01)


def test_nees_is_one_over_draws(series):
    rng = np.random.default_rng(2)
    root = series.cholesky_of(SMALL, 301)
    t = series.step * np.arange(301)
    nees = []
    for _ in range(4):
        theta = series.centred(root @ rng.standard_normal((301, 3)))
        motion = kalman(series.measure(theta, [40, 15], 0.05, rng), t, prior=SMALL, grid_step=series.step)
        nees.append((series.centred(motion.angles - theta) ** 2 / series.sigmas(motion) ** 2).mean())
    assert_consistent(nees, degrees=720)  # 12 series of some 60 independent samples


def test_the_default_epochs_follow_the_fastest_tone(series):
    rng = np.random.default_rng(3)
    theta = series.centred(series.cholesky_of(SMALL, 301) @ rng.standard_normal((301, 3)))
    pairs = series.measure(theta, [40, 16], 0.02, rng)
    t = series.step * np.arange(301)
    own = kalman(pairs, t, prior=SMALL)
    fine = kalman(pairs, t, prior=SMALL, grid_step=series.step)
    # 16 epochs per period: the cubic loses (2 pi / 16)^4 * 3 / 128 = 6e-4 of a 0.3 px tone.
    assert series.centred(own.angles) == pytest.approx(series.centred(fine.angles), abs=5e-3)


@pytest.mark.parametrize("order", ["3/2", "5/2"])
def test_the_state_space_keeps_the_autocovariance(order):
    prior = Spectrum((Matern(0.7, 0.05, order), Tone(0.2, 30.0, 2.0)))
    space = state_space(prior, 2e-3)
    power = np.eye(len(space.output))
    for lag in range(40):
        found = space.output @ power @ space.stationary @ space.output
        assert found == pytest.approx(prior.autocovariance(np.array([lag * 2e-3]))[0], abs=1e-12)
        power = space.transition @ power
    assert np.linalg.eigvalsh(space.noise).min() > -1e-12


def test_it_does_not_extrapolate(series):
    pairs = series.measure(np.zeros((201, 3)), [20], 0.1, np.random.default_rng(0))
    with pytest.raises(InputError, match="does not extrapolate: ask within the span"):
        kalman(pairs, np.linspace(0.0, 0.3, 5), prior=SMALL)


def test_a_lag_too_long_for_its_state_is_refused_with_the_remedy(series):
    pairs = series.measure(np.zeros((401, 3)), [300], 0.1, np.random.default_rng(0))
    with pytest.raises(EstimationError, match="give a longer `grid_step`, or use the smoother"):
        kalman(pairs, np.linspace(0.0, 0.3, 5), prior=SMALL, grid_step=1e-4)


def test_it_agrees_with_the_banded_smoother(series):
    from sightline.motion.estimators.smoother import smooth

    rng = np.random.default_rng(4)
    theta = series.cholesky_of(SMALL, 401) @ rng.standard_normal((401, 3))
    pairs = series.measure(theta, [60, 22, 7], 0.03, rng)
    t = series.step * np.arange(401)
    one = kalman(pairs, t, prior=SMALL, grid_step=series.step)
    # Their images are shared (0-1, 0-2, 0-3) but their patches are not named: independent for both.
    other = smooth(pairs, t, prior=SMALL, grid_step=series.step)
    difference = series.centred(one.angles) - series.centred(other.angles)
    # An autoregression of 60 terms is the exact prior to some 0.5 % of the error.
    assert np.sqrt((difference**2).mean()) < 0.05 * series.sigmas(one).mean()
    assert series.sigmas(one) == pytest.approx(series.sigmas(other), rel=0.02)


def test_the_unit_of_the_angles_is_free(series):
    rng = np.random.default_rng(12)
    root = series.cholesky_of(SMALL, 301)
    theta = series.centred(root @ rng.standard_normal((301, 3)))
    pairs, t, unit = series.measure(theta, [40, 15], 0.05, rng), series.step * np.arange(301), 5e-6
    small = [replace(p, angles=unit * p.angles, covariance=unit**2 * p.covariance) for p in pairs]
    found = kalman(pairs, t, prior=SMALL, grid_step=series.step)
    scaled = kalman(small, t, prior=SMALL.scaled(unit), grid_step=series.step)
    assert scaled.angles / unit == pytest.approx(found.angles, abs=1e-6)
    assert series.sigmas(scaled) / unit == pytest.approx(series.sigmas(found), rel=1e-6)
