import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.errors import InputError
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.geometry.trajectory import Motion
from sightline.motion.tones import detect_tones, lowest_sought, spectrum

STEP, COUNT = 2e-3, 1000
T = STEP * np.arange(COUNT)
MOTIONS = {
    "white": Spectrum((Matern(1.0, 1e-6),)),
    "drift and broadband": Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 5e-3))),
    "drift and white": Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.02, 1e-6))),
}


#: 800 lines of 0.5 ms: twenty frequencies below a peak are known from 62.5 Hz on only.
SHORT = 5e-4 * np.arange(800)
#: Red, flat and falling where few frequencies below tell the level: corners (Hz) 0.4, 30, 60 and 4.
SHORT_MOTIONS = {
    "white": Spectrum((Matern(1.0, 1e-6),)),
    "drift and broadband": Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 9.2e-3))),
    "flat to 60 Hz, then nothing": Spectrum((Matern(0.1, 1.1e-2, "17/2"),)),
    "fast drift and broadband": Spectrum((Matern(2.0, 0.1, "5/2"), Matern(0.1, 9.2e-3))),
}


def draws(prior, number, seed, t=T):
    c = toeplitz(prior.autocovariance(t))
    root = np.linalg.cholesky(c + 1e-9 * c[0, 0] * np.eye(len(t)))
    return (root @ np.random.default_rng(seed).standard_normal((len(t), 3 * number))).reshape(-1, number, 3)


def with_tones(x, tones, phase=0.3, t=T):
    out = x.copy()
    for frequency, amplitude in tones:
        out += amplitude * np.sin(2 * np.pi * frequency * t + phase)[:, None]
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


@pytest.mark.parametrize("name", SHORT_MOTIONS)
def test_slow_tones_are_not_seen_where_there_are_none(name):
    x = draws(SHORT_MOTIONS[name], 300, 7, SHORT)
    found = [detect_tones(Motion(SHORT, x[:, i]), false_alarm=0.02) for i in range(300)]
    # 900 axes at 2 %: 18 expected at most, sd 4.2; three of them on top. 17 of some 390 frequencies are below
    # 62.5 Hz: 0.8 of the 18, and more than 3 of them once in a hundred.
    assert sum(len({tone.axis for tone in tones}) for tones in found) <= 31
    assert sum(tone.frequency < 62.0 for tones in found for tone in tones) <= 3


def test_the_three_tones_of_a_strip_of_800_lines_are_named():
    x = draws(SHORT_MOTIONS["drift and broadband"], 20, 8, SHORT)
    tones = [(47.0, 0.42), (83.0, 0.21), (121.0, 0.11)]
    for i in range(20):
        found = detect_tones(Motion(SHORT, with_tones(x[:, i], tones, t=SHORT)))
        for axis in ("roll", "pitch", "yaw"):
            slowest = next(tone for tone in found if tone.axis == axis)
            # The level is taken at half the frequency and the motion falls as f^-4: sigmas err to the large
            # side, so that 4 of them hold 60 draws.
            assert abs(slowest.frequency - 47.0) < 4.0 * slowest.sigma_frequency < 1.0
            assert abs(slowest.amplitude - 0.42) < 4.0 * slowest.sigma_amplitude < 0.3
            assert [round(tone.frequency / 2.5) for tone in found if tone.axis == axis] == [19, 33, 48]


def test_a_strong_tone_is_named_from_eight_cycles_on_and_its_flank_is_none():
    x = 1e-3 * np.random.default_rng(9).standard_normal((len(SHORT), 3))
    lowest = lowest_sought(Motion(SHORT, x))
    assert lowest == pytest.approx(20.0, rel=2e-3)
    for frequency, number in ((lowest, 3), (lowest - 4.0, 0)):
        found = detect_tones(Motion(SHORT, with_tones(x, [(frequency, 0.3)], t=SHORT)))
        assert len(found) == number
        assert all(tone.frequency == pytest.approx(frequency, abs=0.05) for tone in found)


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
    short = Motion(T[:40], np.sin(T[:40])[:, None] * np.ones(3))
    assert detect_tones(short) == ()
    assert lowest_sought(short) == np.inf


def test_a_false_alarm_of_zero_is_refused():
    with pytest.raises(InputError, match="`false_alarm` must be between 0 and 1, got 0"):
        detect_tones(Motion(T, np.ones((COUNT, 3))), false_alarm=0)


def test_false_alarms_hold_where_the_motion_is_hardly_seen():
    # an error that is all about 53 Hz, as where all pairs are blind, beside white motion: no tone at all
    unseen, white = Spectrum((Tone(0.05, 53.0, 3.0),)), Spectrum((Matern(3e-3, 1e-6),))
    x = draws(unseen, 200, 7, SHORT) + draws(white, 200, 8, SHORT)
    error = np.tile(unseen.psd(spectrum(Motion(SHORT, x[:, 0])).frequency)[:, None], 3)

    def alarms(error_psd):
        found = [detect_tones(Motion(SHORT, x[:, i]), error_psd=error_psd) for i in range(200)]
        return sum(len({tone.axis for tone in tones if tone.false_alarm < 0.01}) for tones in found)

    # neighbours tell nothing of it: most of 600 axes had a tone "by no chance"
    assert alarms(None) > 400
    # 600 axes at 1 %: 6 expected at most, sd 2.4; three of them on top
    assert alarms(error) <= 13
    tones = detect_tones(Motion(SHORT, with_tones(x[:, 0], [(53.0, 1.0)], t=SHORT)), error_psd=error)
    assert {tone.axis for tone in tones if tone.false_alarm < 1e-3} == {"roll", "pitch", "yaw"}
