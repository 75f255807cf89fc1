"""Inverse, Wiener, max-band and in-turn: the filters of ``motion/estimators/harmonic.py``."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from motion.estimators.s1_combinations import in_turn, max_band
from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import Matern, Spectrum
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.harmonic import restore, strength
from sightline.motion.estimators.inverse import inverse
from sightline.motion.estimators.wiener import wiener
from sightline.motion.observability import chain_gain, combined_gain, noise_gain

ESTIMATORS = {
    "inverse": inverse,
    "wiener": partial(wiener, prior=Spectrum((Matern(1.0, 0.02),))),
    "max-band": max_band,
    "in turn": in_turn,
}
T = np.arange(0.0, 2.0, 1e-3)


def tone_pair(frequency, lag, amplitude=1.0, sigma=0.0, seed=0, step=2e-3, extent=2.0):
    t = np.arange(0.0, extent - lag + 1e-9, step)

    def angle(when):
        return amplitude * np.sin(2 * np.pi * frequency * when + 0.4)[:, None] * np.array([1.0, -0.5, 2.0])

    noise = sigma * np.random.default_rng(seed).standard_normal((len(t), 3))
    covariance = np.tile(max(sigma, 1e-3) ** 2 * np.eye(3), (len(t), 1, 1))
    return AngleDifferences(t, lag, angle(t + lag) - angle(t) + noise, covariance), angle(T)


def amplitude_in_the_middle(angles, frequency):
    """Complex amplitude of a tone per axis over the middle second, relative to sin(2 pi f t + 0.4)."""
    middle = (T >= 0.5) & (T < 1.5)
    carrier = np.exp(-1j * (2 * np.pi * frequency * T[middle] + 0.4 - np.pi / 2))
    return 2.0 * (carrier[:, None] * angles[middle]).mean(axis=0)


@pytest.mark.parametrize("frequency", [20.0, 67.0, 110.0])
def test_a_tone_comes_back_with_the_chain_gain_and_no_phase(frequency):
    pair, _ = tone_pair(frequency, 7.4e-3)
    found = amplitude_in_the_middle(inverse([pair], T, k=0.1, degree=0).angles, frequency)
    # The record is 40 periods or more; what leaks from its ends is below 1 %.
    expected = chain_gain(frequency, 7.4e-3, 0.1) * np.array([1.0, -0.5, 2.0])
    assert found == pytest.approx(expected, abs=0.02)


def test_the_plain_inverse_brings_a_tone_back_whole():
    pair, _ = tone_pair(67.0, 7.4e-3)
    found = amplitude_in_the_middle(inverse([pair], T, k=0.0, degree=0).angles, 67.0)
    assert found == pytest.approx([1.0, -0.5, 2.0], abs=0.02)


def test_several_pairs_bring_a_tone_back_with_their_joint_gain():
    lags = [7.4e-3, 22.2e-3, 15e-3]
    pairs = [tone_pair(60.0, lag)[0] for lag in lags]
    found = amplitude_in_the_middle(inverse(pairs, T, k=0.5, degree=0).angles, 60.0)
    assert found[0] == pytest.approx(combined_gain(60.0, lags, 0.5), abs=0.02)
    best = amplitude_in_the_middle(max_band(pairs, T, k=0.5, degree=0).angles, 60.0)
    assert best[0] == pytest.approx(combined_gain(60.0, lags, 0.5, "max-band"), abs=0.02)


@pytest.mark.parametrize("lag", [7.4e-3, 0.1722])
def test_white_noise_comes_through_with_the_closed_form_gain_whatever_the_lag(lag):
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 2e-3)
    pair = AngleDifferences(t, lag, rng.standard_normal((len(t), 3)), np.tile(np.eye(3), (len(t), 1, 1)))
    motion = inverse([pair], t[200:-200], k=0.5, degree=0)
    # 3 x 30000 samples, correlated over a few; the spread of the rms is about 1 %.
    assert motion.angles.std() == pytest.approx(noise_gain(0.5), rel=0.03)


def test_the_two_orders_of_a_pair_give_the_same_motion():
    pair, _ = tone_pair(40.0, 0.02, sigma=0.02)
    swapped = AngleDifferences(pair.t + pair.lag, -pair.lag, -pair.angles, pair.covariance)
    for estimator in (inverse, wiener):
        a, b = estimator([pair], T).angles, estimator([swapped], T).angles
        assert a == pytest.approx(b, abs=1e-6)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_filter_improves_on_nothing_and_states_a_sigma_everywhere(name, series):
    rng = np.random.default_rng(5)
    prior = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.3, 0.02)))
    theta = series.centred(series.cholesky_of(prior, 1501) @ rng.standard_normal((1501, 3)))
    pairs = series.measure(theta, [150, 22, 7], 0.02, rng, every=2)
    t = series.step * np.arange(1501)
    motion = ESTIMATORS[name](pairs, t)
    error = series.centred(motion.angles - theta)
    assert np.sqrt((error**2).mean()) < 0.2 * np.sqrt((theta**2).mean())
    assert np.isfinite(motion.covariance).all()
    assert (series.sigmas(motion) > 0.0).all()
    assert motion.angles.mean(axis=0) == pytest.approx(0.0, abs=1e-12)


def test_a_gap_is_bridged_without_nan_and_with_a_larger_sigma(series):
    rng = np.random.default_rng(6)
    theta = series.centred(series.cholesky_of(series.scene, 2001) @ rng.standard_normal((2001, 3)))
    pairs = series.measure(theta, [172, 15], 0.03, rng, gap=(0.9, 1.2))
    t = series.step * np.arange(2001)
    motion = inverse(pairs, t)
    inside, outside = (t > 1.08) & (t < 1.19), t < 0.7
    assert np.isfinite(motion.angles).all()
    assert series.sigmas(motion)[inside].mean() > 2.0 * series.sigmas(motion)[outside].mean()


def test_the_wiener_filter_finds_the_spectrum_it_is_not_given(series):
    rng = np.random.default_rng(7)
    prior = Spectrum((Matern(0.5, 0.02),))
    theta = series.centred(series.cholesky_of(prior, 2001) @ rng.standard_normal((2001, 3)))
    pairs = series.measure(theta, [22, 7], 0.1, rng, every=2)
    t = series.step * np.arange(2001)

    def rms(motion):
        return np.sqrt((series.centred(motion.angles - theta) ** 2).mean())

    informed, found = rms(wiener(pairs, t, prior=prior)), rms(wiener(pairs, t))
    # Four smoothed bins per 1/T leave the estimated spectrum with a scatter of about a third, which costs
    # its square in the error power at most.
    assert found < 1.15 * informed


def test_differences_of_one_instant_are_refused():
    pair = AngleDifferences(np.zeros(6), 0.1, np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)))
    with pytest.raises(EstimationError, match="all differences are of one instant"):
        inverse([pair], np.linspace(0.0, 0.1, 4), degree=0)


def test_a_negative_k_is_refused():
    with pytest.raises(InputError, match="`k` must be 0 or more, got -1"):
        inverse([tone_pair(20.0, 0.01)[0]], T, k=-1)


def test_max_band_and_joint_filter_are_floored_by_the_line_above_their_nyquist_frequency(series):
    # Another implementation gave 0.111 px (max-band) and 0.109 px (joint) over 40 draws of this scene:
    # the 121 Hz line, above the Nyquist frequency, of 0.08 px, its alias, and what is left at the ends.
    root = series.cholesky_of(series.scene, 2001)
    rng = np.random.default_rng(8)
    t = series.step * np.arange(2001)
    squared = {"max": [], "joint": []}
    for _ in range(4):
        theta = series.centred(root @ rng.standard_normal((2001, 3)))
        pairs = series.measure(theta, [172, 22, 7, 15], 0.03, rng)
        for name, estimator in (("max", max_band), ("joint", inverse)):
            squared[name].append((series.centred(estimator(pairs, t).angles - theta) ** 2).mean())
    for name in squared:
        # 12 series; the drift left at the ends scatters the rms by some 10 %.
        assert np.sqrt(np.mean(squared[name])) == pytest.approx(0.110, rel=0.2)


def test_when_the_clock_starts_changes_nothing(series):
    rng = np.random.default_rng(11)
    theta = series.centred(series.cholesky_of(series.scene, 1001) @ rng.standard_normal((1001, 3)))
    pairs, t = series.measure(theta, [40, 15], 0.03, rng, gap=(0.4, 0.5)), series.step * np.arange(1001)
    later = [replace(pair, t=pair.t + 64.0) for pair in pairs]
    found, moved = inverse(pairs, t), inverse(later, t + 64.0)
    # times of 64 s hold 1e-14 s
    assert moved.angles == pytest.approx(found.angles, abs=1e-6)
    assert series.sigmas(moved) == pytest.approx(series.sigmas(found), rel=1e-6)


def test_a_filter_is_chosen_by_the_density_of_each_pair_and_axis():
    """White noise of variance v has v up to its Nyquist frequency; a tone of amplitude a has a^2 / 2."""
    t, seen = np.arange(0.0, 4.0, 2e-3), []
    variances = np.array([[1.0, 4.0, 0.25], [9.0, 0.5, 2.0]])
    pairs = [
        AngleDifferences(t, lag, np.zeros((len(t), 3)), np.tile(np.diag(v), (len(t), 1, 1)))
        for lag, v in zip((0.01, 0.05), variances, strict=True)
    ]

    def choose(bins):
        seen.append(bins)
        return np.zeros((3, *bins.gain.shape), dtype=complex)

    restore(pairs, t, choose, degree=0, motion_psd=lambda f: np.ones((3, len(f))))
    (bins,) = seen
    nyquist = 0.5 / 2e-3
    assert bins.frequency[[0, -1]] == pytest.approx([0.0, nyquist], rel=1e-3)
    assert bins.noise_psd * nyquist == pytest.approx(variances.T, rel=1e-6)
    # angle(t + lag) - angle(t) of exp(2 pi i f t)
    lags = np.array([0.01, 0.05])[:, None]
    sine = 4.0 * np.sin(np.pi * bins.frequency * lags) ** 2 * nyquist
    assert strength(bins) == pytest.approx(
        np.array([(sine.T / v).sum(axis=1) for v in variances.T]), rel=1e-6
    )
    assert bins.gain == pytest.approx(np.exp(2j * np.pi * bins.frequency * lags) - 1.0, abs=1e-9)
