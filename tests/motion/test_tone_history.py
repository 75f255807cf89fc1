"""Tones through time and tones closer than 1/T, on sinusoids written out here."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.trajectory import Motion
from sightline.motion.tone_history import close_pairs, tone_histories
from sightline.motion.tones import detect_tones

STEP, N = 5e-4, 4000  # two seconds: a resolution of 0.5 Hz
T = STEP * np.arange(N)
NOISE = 2e-7


def motion(roll, seed=0) -> Motion:
    """A roll of so many microradians on white noise of 0.2."""
    angles = NOISE * np.random.default_rng(seed).standard_normal((N, 3))
    angles[:, 0] += 1e-6 * roll
    return Motion(T, angles)


def sine(f, phase=0.0):
    """A sine of unit amplitude."""
    return np.sin(2 * np.pi * f * T + phase)


def test_a_steady_tone_is_steady_and_as_large_as_it_is():
    chances, errors = [], []
    for seed in range(20):
        moved = motion(sine(64.3, 1.0), seed)
        (history,) = tone_histories(moved, detect_tones(moved))
        chances.append(history.steady_chance)
        errors.append((history.amplitude - 1e-6) / history.sigma)
    # the sigma comes from the larger of two medians about the peak: up to 1.3 times too large
    size = np.sqrt(np.mean(np.square(errors)))
    assert 0.6 < size < 1.1
    # one strip in a thousand would be said to vary
    assert min(chances) > 1e-3


def test_a_tone_that_begins_in_the_middle_is_seen_to_begin():
    moved = motion(sine(64.0, 1.0) * (T > 1.0))
    (history,) = tone_histories(moved, detect_tones(moved))
    early, late = history.t < 0.85, history.t > 1.15
    assert history.steady_chance < 1e-6
    # the level about the peak holds the switch's own spectrum, so sigma is generous: 4 of them
    assert (history.amplitude[early] < 4 * history.sigma).all()
    assert np.abs(history.amplitude[late] - 1e-6).max() < 4 * history.sigma
    # half of the time one, half of the time nothing: 0.5 rms about the mean
    assert history.variation == pytest.approx(0.5e-6, rel=0.15)


def test_a_steady_tone_beside_one_thirty_times_as_strong_is_steady():
    chances = []
    for seed in range(5):
        moved = motion(sine(64.0, 1.0) + 30.0 * sine(70.0, 0.3) + 20.0 * sine(41.0, 2.0), seed)
        histories = tone_histories(moved, detect_tones(moved))
        assert [round(history.tone.frequency) for history in histories] == [41, 64, 70]
        chances += [history.steady_chance for history in histories]
        weak = histories[1]
        assert np.abs(weak.amplitude - 1e-6).max() < 4.0 * weak.sigma
    assert min(chances) > 1e-3


def test_a_tone_with_a_neighbour_is_cut_into_longer_pieces():
    lone, beside = motion(sine(64.0)), motion(sine(64.0) + sine(70.0, 0.3))
    (one,) = tone_histories(lone, detect_tones(lone))
    first, _ = tone_histories(beside, detect_tones(beside))
    assert len(first.t) < len(one.t)
    # pieces of 3 / 6 Hz tell the two apart: the neighbour leaks less than a tenth
    assert np.abs(first.amplitude - 1e-6).max() < 0.1e-6


@pytest.mark.parametrize("separation", [0.3, 0.4])
def test_two_tones_closer_than_the_resolution_are_separated(separation):
    errors = []
    for seed in range(6):
        moved = motion(sine(83.03, 1.0) + 0.7 * sine(83.03 + separation, seed), seed)
        (pair,) = close_pairs(moved, detect_tones(moved))
        errors.append((np.array(pair.frequencies) - [83.03, 83.03 + separation]) / pair.sigma_frequencies)
        errors.append((np.array(pair.amplitudes) - [1e-6, 0.7e-6]) / pair.sigma_amplitudes)
    # 24 errors, sigma up to 1.3 times too large
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.3


@pytest.mark.parametrize(
    "roll",
    [
        sine(83.03),
        sine(83.03) * (T > 1.0),
        sine(83.03) * (1.0 + 0.8 * np.sin(2 * np.pi * 0.7 * T) + 0.4 * np.cos(2 * np.pi * 1.7 * T)),
    ],
    ids=["one", "switched on", "swelling"],
)
def test_one_tone_is_not_taken_for_two(roll):
    for seed in range(4):
        moved = motion(roll, seed)
        assert close_pairs(moved, detect_tones(moved)) == ()


def test_two_tones_that_drown_are_not_separated():
    moved = motion(0.05 * (sine(83.03) + sine(83.2, 2.0)))
    assert close_pairs(moved, detect_tones(moved)) == ()
