"""The laws of simulated motions: sizes, spectra, and what attitude sensors feel of them."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.simulate.jitter import (
    ChirpJitter,
    ConstantJitter,
    CurveJitter,
    JitterProfile,
    MaternJitter,
    StepJitter,
    ToneJitter,
    nominal_profile,
)

T = np.arange(3000) * 5e-4


def draws(part, t, count, seed=0):
    return np.array([part.sample(t, np.random.default_rng([seed, k])) for k in range(count)])


@pytest.mark.parametrize("order", ["3/2", "5/2"])
def test_a_matern_motion_has_the_covariance_of_its_closed_form(order):
    part = MaternJitter(2.0, 0.05, order)
    t = np.arange(400) * 1e-3
    values = draws(part, t, 600)
    for lag in (0, 10, 50):
        products = values[:, 0] * values[:, lag]
        # by hand: the polynomial times the exponential of the decay
        r = np.sqrt({"3/2": 3.0, "5/2": 5.0}[order]) * lag * 1e-3 / 0.05
        expected = 4.0 * np.exp(-r) * (1.0 + r + (r * r / 3.0 if order == "5/2" else 0.0))
        # the mean of 600 products of normals has sd sqrt((s^4 + c^2) / 600); four of them
        assert abs(products.mean() - expected) < 4.0 * np.sqrt((16.0 + expected**2) / 600)


def test_the_corner_of_a_matern_motion_is_where_its_power_has_fallen_as_the_law_says():
    part = MaternJitter.with_corner(0.1, 30.0)
    lags = np.arange(-40000, 40000) * 1e-4
    covariance = part.autocovariance(lags)
    psd = [float(np.sum(covariance * np.cos(2 * np.pi * f * lags)) * 1e-4) for f in (0.0, 30.0)]
    assert psd[1] / psd[0] == pytest.approx(0.25, rel=1e-3)


def test_a_drift_longer_than_the_scene_keeps_its_size():
    values = draws(MaternJitter(2.0, 1.0, "5/2"), T, 400)
    # variance of 400 independent normals: relative sd sqrt(2/400) = 0.071; four of them
    assert values[:, 1500].var() == pytest.approx(4.0, rel=0.28)


def test_a_tone_has_its_rms_and_its_frequency():
    t = np.arange(20000) * 5e-4
    values = ToneJitter(0.3, 47.0).sample(t, np.random.default_rng(1))
    assert np.sqrt(np.mean(values**2)) == pytest.approx(0.3, rel=1e-3)
    assert np.abs(np.fft.rfft(values)).argmax() / (t.size * 5e-4) == pytest.approx(47.0)


def test_a_chirp_sweeps_between_its_frequencies():
    values = ChirpJitter(0.2, 15.0, 105.0).sample(T, np.random.default_rng(3))
    crossings = np.flatnonzero(np.diff(np.sign(values)) != 0)
    early, late = crossings[crossings < 500].size / 0.25, crossings[crossings >= 2500].size / 0.25
    # two crossings per turn; the mean frequency of the first and last quarter of a second: 22.5, 97.5 Hz
    assert early == pytest.approx(2 * 22.5, abs=5)
    assert late == pytest.approx(2 * 97.5, abs=5)


def test_a_step_has_its_height_and_stands_away_from_the_ends():
    values = StepJitter(0.5).sample(T, np.random.default_rng(5))
    assert abs(values[-1] - values[0]) == pytest.approx(0.5, abs=1e-6)
    assert 600 <= np.abs(np.diff(values)).argmax() <= 2400


def test_a_measured_curve_is_scaled_to_the_wanted_rms():
    clock = np.arange(1000) * 0.01
    part = CurveJitter(clock, np.sin(clock), rms=1.5, stretch=0.5)
    values = part.sample(T, np.random.default_rng(0))
    assert np.sqrt(np.mean(values**2)) == pytest.approx(1.5)


def test_a_curve_shorter_than_the_scene_says_by_how_much_to_stretch_it():
    clock = np.arange(100) * 0.01
    with pytest.raises(InputError, match=r"too short: 0.990 s .* raise `stretch` above 1.5"):
        CurveJitter(clock, clock).sample(T, np.random.default_rng(0))


def test_uneven_times_are_refused():
    with pytest.raises(InputError, match="evenly spaced"):
        MaternJitter(1.0, 1.0).sample(np.array([0.0, 1.0, 3.0]), np.random.default_rng(0))


def test_the_body_does_not_feel_the_tones_of_the_instrument():
    tones = (ConstantJitter(1.0), ToneJitter(0.3, 47.0))
    profile = JitterProfile(tones, tones, tones)
    sight, body = profile.draw(T, np.ones(3), np.random.SeedSequence(2))
    assert np.ptp(body.angles, axis=0).max() == 0.0
    assert np.sqrt(np.mean((sight.angles - body.angles) ** 2)) == pytest.approx(0.3, rel=0.01)


def test_the_axes_are_scaled_by_their_own_pixel_and_are_independent():
    scale = np.array([5e-6, 5e-6, 2e-3])
    motion, _ = nominal_profile().draw(T, scale, np.random.SeedSequence(4))
    again, _ = nominal_profile().draw(T, np.ones(3), np.random.SeedSequence(4))
    np.testing.assert_allclose(motion.angles, again.angles * scale, rtol=1e-12)
    assert not np.allclose(again.angles[:, 0], again.angles[:, 1])


def test_the_nominal_motion_has_the_tones_of_the_reference_scene():
    t = np.arange(40000) * 5e-4
    motion, _ = nominal_profile(0.0).draw(t, np.ones(3), np.random.SeedSequence(8))
    f = np.fft.rfftfreq(t.size, 5e-4)
    amplitude = np.abs(np.fft.rfft(motion.angles * np.hanning(t.size)[:, None], axis=0)) * 4.0 / t.size
    for tone, rms in ((47.0, 0.30), (83.0, 0.15), (121.0, 0.08)):
        here = amplitude[np.abs(f - tone).argmin()]
        # the broadband part adds some 0.003 px over the width of one line of the spectrum; six of them
        np.testing.assert_allclose(here, rms * np.sqrt(2.0), atol=0.02)
