"""The banded smoother: exact against dense conditioning, honest about its sigma, patient with gaps."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.estimation.likelihood import FittedSpectrum
from sightline.estimation.prior import Matern, Spectrum
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.smoother import axis_series, fit_spectra, smooth

LAGS = (86, 22, 7, 15)


def test_error_and_sigma_are_those_of_dense_conditioning(series) -> None:  # type: ignore[no-untyped-def]
    n, sigma = 400, 0.03
    rng = np.random.default_rng(0)
    root = series.cholesky_of(series.scene, n)
    theta = root @ rng.normal(size=(n, 3))
    pairs = series.measure(theta, LAGS, sigma, rng)
    motion = smooth(pairs, series.step * np.arange(n), prior=series.scene, grid_step=series.step)
    rows = []
    for pair, lag in zip(pairs, LAGS, strict=True):
        k = np.rint(pair.t / series.step).astype(int)
        h = np.zeros((len(k), n))
        h[np.arange(len(k)), k], h[np.arange(len(k)), k + lag] = -1.0, 1.0
        rows.append(h)
    h, prior = np.vstack(rows), root @ root.T
    gain = prior @ h.T @ np.linalg.inv(h @ prior @ h.T + sigma**2 * np.eye(len(h)))
    centring = np.eye(n) - 1.0 / n
    mean = centring @ gain @ np.concatenate([p.angles for p in pairs])
    exact = np.sqrt(np.diag(centring @ (prior - gain @ h @ prior) @ centring))
    # An autoregression of order 60 costs less than 1 % of sigma over the strip (a prototype: 0.0285 to
    # 0.0287), more at the ends, and never claims less; the means then differ by sqrt(1.01^2 - 1) = 14 %.
    found = series.sigmas(motion)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.sqrt(np.mean(exact**2)), rel=0.01)
    assert (found > 0.995 * exact[:, None]).all()
    assert np.sqrt(np.mean(((motion.angles - mean) / exact[:, None]) ** 2)) < 0.14


def test_each_axis_is_treated_alike(series) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(1)
    theta = np.repeat(rng.normal(size=(300, 1)).cumsum(axis=0) * 0.01, 3, axis=1)
    pairs = series.measure(theta, LAGS, 1e-6, rng)
    motion = smooth(pairs, series.step * np.arange(300), prior=series.scene, grid_step=series.step)
    np.testing.assert_allclose(motion.angles[:, 1:], motion.angles[:, :1] @ np.ones((1, 2)), atol=1e-4)


def test_sigma_grows_in_a_gap_and_nothing_is_missing(series) -> None:  # type: ignore[no-untyped-def]
    n = 800
    rng = np.random.default_rng(2)
    theta = series.cholesky_of(series.scene, n) @ rng.normal(size=(n, 3))
    t = series.step * np.arange(n)
    pairs = [
        AngleDifferences(p.t[keep], p.lag[keep], p.angles[keep], p.covariance[keep], p.images)
        for p in series.measure(theta, LAGS, 0.03, rng)
        for keep in [((p.t < 0.37) | (p.t > 0.43)) & ((p.t + p.lag < 0.37) | (p.t + p.lag > 0.43))]
    ]
    motion = smooth(pairs, t, prior=series.scene, grid_step=series.step)
    sigma = series.sigmas(motion)[:, 0]
    inside = (t > 0.38) & (t < 0.42)  # the longest lag still bridges the gap
    assert sigma[inside].min() > 2.0 * np.median(sigma[(t > 0.1) & (t < 0.3)])
    assert np.isfinite(motion.angles).all()
    # A hundred values, of which few are independent: four sigma is beyond chance for all of them.
    assert np.abs((motion.angles - series.centred(theta))[inside] / sigma[inside, None]).max() < 4.0


def test_the_window_of_a_measurement_is_undone(series) -> None:  # type: ignore[no-untyped-def]
    # A 10-line window passes 0.637 of a 100 Hz tone of 5 ms length : modelled, the tone
    # comes back whole; ignored, it does not.
    t = series.step * np.arange(1000)
    w, f = 5e-3, 100.0
    prior = Spectrum((Matern(0.5, 0.5, "5/2"), Matern(1.0, 0.003)))
    rng = np.random.default_rng(3)
    pairs = {0.0: [], w: []}
    for lag in (0.0172, 0.0226):
        epochs = np.arange(0.01, 0.95, 0.002)
        seen = np.sinc(f * w) * (np.sin(2 * np.pi * f * (epochs + lag)) - np.sin(2 * np.pi * f * epochs))
        angles = np.repeat(seen[:, None], 3, axis=1) + 1e-3 * rng.normal(size=(len(epochs), 3))
        covariance = np.tile(1e-6 * np.eye(3), (len(epochs), 1, 1))
        for window, out in pairs.items():
            out.append(AngleDifferences(epochs, np.full(len(epochs), lag), angles, covariance, window=window))
    middle = slice(200, 800)
    wave = np.sin(2 * np.pi * f * t[middle])
    gain = {
        window: float(smooth(p, t, prior=prior, grid_step=1e-3).angles[middle, 0] @ wave / (wave @ wave))
        for window, p in pairs.items()
    }
    assert gain[w] == pytest.approx(1.0, abs=0.02)
    assert gain[0.0] == pytest.approx(np.sinc(f * w), abs=0.02)


def test_pairs_that_share_images_do_not_shrink_sigma(series) -> None:  # type: ignore[no-untyped-def]
    n = 400
    at, k = (0, 50, 57, 72), np.arange(0, 320, 5)
    rng = np.random.default_rng(4)
    theta = series.cholesky_of(series.scene, n) @ rng.normal(size=(n, 3))
    noise = 0.02 * rng.normal(size=(4, len(k), 3))
    covariance = np.tile(8e-4 * np.eye(3), (len(k), 1, 1))

    def pair(a: int, b: int) -> AngleDifferences:
        values = theta[k + at[b]] - theta[k + at[a]] + noise[b] - noise[a]
        lag = np.full(len(k), (at[b] - at[a]) * 1e-3)
        return AngleDifferences((k + at[a]) * 1e-3, lag, values, covariance, (a, b), patch=np.arange(len(k)))

    t = series.step * np.arange(n)
    tree = [pair(0, 1), pair(0, 2), pair(0, 3)]
    three = smooth(tree, t, prior=series.scene, grid_step=series.step)
    six = smooth([*tree, pair(1, 2), pair(1, 3), pair(2, 3)], t, prior=series.scene, grid_step=series.step)
    np.testing.assert_allclose(series.sigmas(six), series.sigmas(three), rtol=1e-6)
    np.testing.assert_allclose(six.angles, three.angles, atol=1e-6)


def test_with_free_offsets_a_trend_is_hidden_and_the_offsets_do_no_harm(series) -> None:  # type: ignore[no-untyped-def]
    n = 600
    rng = np.random.default_rng(5)
    theta = series.cholesky_of(series.scene, n) @ rng.normal(size=(n, 3))
    t = series.step * np.arange(n)
    pairs = series.measure(theta, LAGS, 0.03, rng)
    moved = [
        AngleDifferences(p.t, p.lag, p.angles + 0.7 * (k + 1), p.covariance, p.images)
        for k, p in enumerate(pairs)
    ]
    options = {"prior": series.scene, "grid_step": series.step, "offset_sigma": 3.0}
    motion = smooth(moved, t, **options)
    shapes = np.stack([np.ones(n), t], axis=1)
    truth = theta - shapes @ np.linalg.lstsq(shapes, theta, rcond=None)[0]
    np.testing.assert_allclose(shapes.T @ motion.angles, 0.0, atol=1e-8)
    z = (motion.angles - truth) / series.sigmas(motion)
    # 3 axes x 0.6 s: some 100 independent values, so that the mean square has a sigma near 0.15.
    assert 0.5 < np.mean(z**2) < 1.6


def test_a_motion_that_may_jump_follows_a_step(series) -> None:  # type: ignore[no-untyped-def]
    n = 600
    rng = np.random.default_rng(8)
    t = series.step * np.arange(n)
    theta = np.repeat((0.4 * np.sin(9.0 * t) + 0.3 * (t >= 0.3))[:, None], 3, axis=1)
    pairs = series.measure(theta, LAGS, 0.01, rng, every=1)
    prior = Spectrum((Matern(0.5, 0.1, "5/2"), Matern(0.02, 0.01)))
    near = slice(285, 315)
    worst = {
        jumps: float(
            np.abs(
                smooth(pairs, t, prior=prior, grid_step=series.step, jumps=jumps).angles
                - series.centred(theta)
            )[near].max()
        )
        for jumps in (False, True)
    }
    assert worst[True] < 0.5 * worst[False]


def test_what_is_found_in_the_data_serves_as_the_prior(series) -> None:  # type: ignore[no-untyped-def]
    n = 1000
    rng = np.random.default_rng(6)
    t = series.step * np.arange(n)
    theta = np.stack(
        [0.4 * np.sin(2 * np.pi * 31.0 * t), 0.8 * np.sin(4.0 * t), 0.3 * np.sin(2 * np.pi * 55.0 * t)],
        axis=1,
    )
    theta = theta + 0.01 * rng.normal(size=theta.shape)
    pairs = series.measure(theta, LAGS, 0.03, rng)
    found = fit_spectra(pairs)
    assert [[round(tone.frequency) for tone in axis.spectrum.tones] for axis in found] == [[31], [], [55]]
    motion = smooth(pairs, t, prior=found)
    assert np.std(motion.angles - series.centred(theta)) < 0.03


# steps of 1 ms; 4/7 by default, of a fit of the whole motion .81
@pytest.mark.parametrize("steps", [0.5, 0.6])
def test_on_a_fine_grid_what_begins_late_is_known_too(series, steps) -> None:  # type: ignore[no-untyped-def]
    # a fit on the middle of the motion, all that a fine grid leaves room for at so long a lag, knew nothing
    # of what is struck later: errors of twelve sigma
    rng = np.random.default_rng(5)
    t = series.step * np.arange(1200)
    since = np.maximum(t - 0.95, 0.0)
    struck = 0.1 * np.exp(-since / 0.25) * np.sin(2.0 * np.pi * 20.0 * since)
    theta = (0.5 * np.sin(2.0 * np.pi * 0.9 * t) + struck)[:, None] * np.ones(3)
    pairs = series.measure(theta, (164, 4), 0.03, rng, every=1)
    motion = smooth(pairs, t, grid_step=steps * series.step)
    error = motion.angles - (theta - theta.mean(axis=0))
    late = t > 0.95
    # some 10 numbers an axis: of true sigmas the mean square is below 2 in all but one of a thousand cases
    assert np.mean((error / series.sigmas(motion))[late] ** 2) < 2.0


def test_a_fitted_noise_scale_scales_sigma(series) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(7)
    pairs = series.measure(np.zeros((200, 3)), LAGS, 0.03, rng)
    t = series.step * np.arange(200)
    believed = [FittedSpectrum(series.scene, scale, 0.0, 1e-3) for scale in (1.0, 1.0, 4.0)]
    sigma = series.sigmas(smooth(pairs, t, prior=believed, grid_step=series.step))
    np.testing.assert_allclose(sigma[:, 0], sigma[:, 1])
    assert (sigma[:, 2] > sigma[:, 0]).all()


def test_bad_input_is_named(series) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="`differences` is empty"):
        axis_series([], 0)
    pairs = series.measure(np.zeros((200, 3)), (7,), 0.03, np.random.default_rng(0))
    with pytest.raises(InputError, match="one spectrum or one for each of"):
        smooth(pairs, np.arange(3) * 0.01, prior=[series.scene, series.scene])
