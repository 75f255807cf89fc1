import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.errors import InputError
from sightline.estimation.prior import Matern, Spectrum
from sightline.geometry.trajectory import Motion
from sightline.motion.tones import detect_tones, spectrum

STEP, COUNT = 2e-3, 1000
T = STEP * np.arange(COUNT)
MOTIONS = {
    "white": Spectrum((Matern(1.0, 1e-6),)),
    "drift and broadband": Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 5e-3))),
    "drift and white": Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.02, 1e-6))),
}


def draws(prior, number, seed):
    c = toeplitz(prior.autocovariance(STEP * np.arange(COUNT)))
    root = np.linalg.cholesky(c + 1e-9 * c[0, 0] * np.eye(COUNT))
    return (root @ np.random.default_rng(seed).standard_normal((COUNT, 3 * number))).reshape(COUNT, number, 3)


def with_tones(x, tones, phase=0.3):
    out = x.copy()
    for frequency, amplitude in tones:
        out += amplitude * np.sin(2 * np.pi * frequency * T + phase)[:, None]
    return out


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_without_a_tone_yield_one_no_more_often_than_stated(name):
    x = draws(MOTIONS[name], 300, 0)
    alarms = sum(
        len({tone.axis for tone in detect_tones(Motion(T, x[:, i]), false_alarm=0.02)}) for i in range(300)
    )
    # 900 axes at 2 %: 18 expected at most, sd 4.2; three of them on top.
    assert alarms <= 31


def test_tones_in_drift_and_broadband_are_found_with_true_sigmas():
    x = draws(MOTIONS["drift and broadband"], 60, 1)
    pulls = []
    for i in range(60):
        found = [t for t in detect_tones(Motion(T, with_tones(x[:, i], [(47.0, 0.3), (83.0, 0.15)])))]
        for axis in ("roll", "pitch", "yaw"):
            mine = [tone for tone in found if tone.axis == axis]
            assert len(mine) == 2
            for tone, (frequency, amplitude) in zip(mine, [(47.0, 0.3), (83.0, 0.15)], strict=True):
                pulls.append(
                    [
                        (tone.frequency - frequency) / tone.sigma_frequency,
                        (tone.amplitude - amplitude) / tone.sigma_amplitude,
                    ]
                )
    # 360 tones. The level is the larger of two medians, so the sigmas err to the large side by some 10 %.
    assert np.sqrt(np.mean(np.square(pulls), axis=0)) == pytest.approx([0.9, 0.9], abs=0.2)


def test_a_single_sinusoid_is_known_to_1_percent_and_its_frequency_to_0_1_percent():
    # Noise of a fourteenth of the amplitude per sample: sigma of the amplitude 0.4 %, of the frequency 1e-5.
    rng = np.random.default_rng(2)
    x = np.sqrt(2.0) * np.sin(2 * np.pi * 61.3 * T + 1.0)[:, None] + 0.1 * rng.standard_normal((COUNT, 3))
    tones = detect_tones(Motion(T, x))
    assert [tone.axis for tone in tones] == ["roll", "pitch", "yaw"]
    for tone in tones:
        assert tone.amplitude == pytest.approx(np.sqrt(2.0), rel=1e-2)
        assert tone.frequency == pytest.approx(61.3, rel=1e-3)
        assert tone.false_alarm < 1e-6


def test_a_harmonic_is_named_after_its_fundamental():
    rng = np.random.default_rng(3)
    x = with_tones(0.01 * rng.standard_normal((COUNT, 3)), [(47.0, 0.3), (94.0, 0.1)])
    names = [tone.name for tone in detect_tones(Motion(T, x)) if tone.axis == "roll"]
    assert names == ["47.0 Hz", "94.0 Hz (2 × 47.0 Hz)"]


def test_a_tone_whose_phase_wanders_is_one_tone_with_a_width():
    rng = np.random.default_rng(4)
    wander = np.cumsum(rng.standard_normal(COUNT)) * np.sqrt(2 * np.pi * 0.5 * STEP)
    x = 0.01 * rng.standard_normal((COUNT, 3)) + 0.3 * np.sin(2 * np.pi * 60.0 * T + wander)[:, None]
    tones = [tone for tone in detect_tones(Motion(T, x)) if tone.axis == "roll"]
    assert len(tones) == 1
    assert tones[0].width > 0.1
    # The phase makes one random turn in 2 s: the mean frequency is uncertain by some 0.5 Hz.
    assert tones[0].frequency == pytest.approx(60.0, abs=1.5)
    assert tones[0].amplitude == pytest.approx(0.3, rel=0.15)


def test_the_spectrum_integrates_to_the_variance():
    x = draws(MOTIONS["white"], 1, 5)[:, 0]
    found = spectrum(Motion(T, x, np.tile(0.04 * np.eye(3), (COUNT, 1, 1))))
    power = found.psd.sum(axis=0) * found.frequency[1]
    # A Hann window leaves 2/3 of the samples' weight: sd of the variance sqrt(2 * 1.94 / 1000) = 6 %.
    assert power == pytest.approx(x.var(axis=0), rel=0.2)
    assert found.noise_psd.sum(axis=0) * found.frequency[1] == pytest.approx(0.04, rel=5e-3)


def test_uneven_times_are_put_on_an_even_grid():
    rng = np.random.default_rng(6)
    t = T + 2e-4 * rng.standard_normal(COUNT)
    x = 0.3 * np.sin(2 * np.pi * 25.0 * t)[:, None] * np.ones(3) + 1e-3 * rng.standard_normal((COUNT, 3))
    assert detect_tones(Motion(t, x))[0].frequency == pytest.approx(25.0, abs=0.01)


def test_a_motion_too_short_to_tell_a_level_has_no_tones():
    assert detect_tones(Motion(T[:40], np.sin(T[:40])[:, None] * np.ones(3))) == ()


def test_a_false_alarm_of_zero_is_refused():
    with pytest.raises(InputError, match="`false_alarm` must be between 0 and 1, got 0"):
        detect_tones(Motion(T, np.ones((COUNT, 3))), false_alarm=0)
