"""Sigmas of tones against motions whose error is drawn from a known covariance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.evaluation.tone_errors import judged_tones
from sightline.geometry.trajectory import Motion
from sightline.motion.results import TimeCovariance
from sightline.motion.tones import detect_tones

STEP, N = 2e-3, 500  # one second
T = STEP * np.arange(N)
SCATTER = 1e-2


def hidden_error(size: float):
    """Covariance (N, N) of an error that looks like a tone of 47 Hz: an estimate beside a blind frequency."""
    # a damped cosine, which is no tone of a prior: some of it lies beside 47 Hz
    return toeplitz(size**2 * np.exp(-np.pi * 0.5 * T) * np.cos(2 * np.pi * 47.0 * T))


def estimate(c, seed: int, whole: bool = False, size: float = 0.3) -> SimpleNamespace:
    """A tone of amplitude 0.3 on every axis with such an error; all that `judged_tones` asks of a result."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(c + 1e-9 * c[0, 0] * np.eye(N))
    wave = size * np.sin(2 * np.pi * 47.0 * T[:, None] + rng.uniform(0, 2 * np.pi, 3))
    moved = wave + root @ rng.standard_normal((N, 3)) + SCATTER * rng.standard_normal((N, 3))
    if whole:  # unknown 3 * node + axis
        full = np.kron(c, np.eye(3))
        band = np.zeros_like(full)
        for d in range(len(full)):
            band[d, : len(full) - d] = np.diag(full, -d)
        return SimpleNamespace(
            motion=Motion(T, moved), functional_covariance=None, band=TimeCovariance(T, moved, band)
        )

    def covariance(weights):
        return np.einsum("nak,nm,mal->kl", weights, c, weights, optimize=True)

    return SimpleNamespace(motion=Motion(T, moved), functional_covariance=covariance, band=None)


def test_sigmas_hold_the_error_of_the_motion_that_no_scatter_shows():
    c = hidden_error(0.03)
    scatter, judged, against_truth = [], [], []
    for seed in range(40):
        result = estimate(c, seed)
        alone = detect_tones(result.motion)
        tones = judged_tones(result, alone)
        assert not tones.hardly_seen
        for kept, found in ((scatter, alone), (judged, tones.found)):
            near = [tone for tone in found if abs(tone.frequency - 47.0) < 1.5]
            assert {tone.axis for tone in near} == {"roll", "pitch", "yaw"}
            kept += [
                ((t.amplitude - 0.3) / t.sigma_amplitude, (t.frequency - 47.0) / t.sigma_frequency)
                for t in near
            ]
            against_truth += [
                ((t.amplitude - 0.3) / t.error_amplitude, (t.frequency - 47.0) / t.error_frequency)
                for t in tones.found
                if abs(t.frequency - 47.0) < 1.5 and kept is judged
            ]
    # what they were without it: an error of 0.03 on a sigma of some 0.001
    assert (np.mean(np.square(scatter), axis=0) > 5.0).all()
    # 120 errors: sd of the mean square sqrt(2 / 120) = 0.13, three of them. The scatter counts the flanks of
    # the error once more, which is nothing in the amplitude and up to as much again in the frequency
    size, turn = np.mean(np.square(judged), axis=0)
    assert 0.6 < size < 1.4
    assert 0.3 < turn < 1.4
    # the white scatter is 0.0008 of the amplitude, and 0.0006 Hz: a thousandth of these errors' squares
    assert np.mean(np.square(against_truth), axis=0) == pytest.approx([1.0, 1.0], abs=0.4)


def test_a_tone_below_three_sigma_is_hardly_seen_and_not_found():
    for size, found in ((0.03, 3), (0.15, 0)):
        result = estimate(hidden_error(0.03), 1)
        stated = estimate(hidden_error(size), 1)
        result.functional_covariance = stated.functional_covariance
        tones = judged_tones(result, detect_tones(result.motion, lowest=40.0, highest=54.0))
        assert len(tones.found) == found
        assert len(tones.hardly_seen) == 3 - found
        for tone in (*tones.found, *tones.hardly_seen):
            assert (tone.amplitude >= 3.0 * tone.sigma_amplitude) is (tone in tones.found)


def test_the_error_of_a_strip_makes_tones_no_more_often_than_stated():
    # no tone, and no density of the error, as beside a blind frequency, where it is one of an endless strip
    c, alone, judged = hidden_error(0.03), 0, 0
    for seed in range(100):
        result = estimate(c, seed, size=0.0)
        peaks = detect_tones(result.motion)
        tones = judged_tones(result, peaks)
        alone += len({tone.axis for tone in peaks if tone.false_alarm < 0.01})
        judged += len({t.axis for t in (*tones.found, *tones.hardly_seen) if t.false_alarm < 0.01})
    assert alone > 200
    # of 300 axes at 1 %: 3, sd 1.7, three of them on top
    assert judged <= 8


def test_a_tone_that_chance_makes_beside_the_error_is_hardly_seen():
    result = estimate(hidden_error(0.03), 1)
    # 0.3 is ten sigma of that error; at 47 Hz an error of unknown size says nothing of either
    blind = np.zeros((N // 2 + 1, 3))
    blind[45:50] = np.inf
    for error, found in ((np.zeros_like(blind), 3), (blind, 0)):
        alone = detect_tones(result.motion, lowest=40.0, highest=54.0, error_psd=error)
        tones = judged_tones(result, alone)
        assert (len(tones.found), len(tones.hardly_seen)) == (found, 3 - found)


def test_the_whole_covariance_of_frames_gives_the_same_sigmas():
    c = hidden_error(0.03)
    one, other = estimate(c, 2), estimate(c, 2, whole=True)
    tones = detect_tones(one.motion)
    for a, b in zip(judged_tones(one, tones).found, judged_tones(other, tones).found, strict=True):
        assert a.sigma_amplitude == pytest.approx(b.sigma_amplitude, rel=1e-9)
        assert a.sigma_frequency == pytest.approx(b.sigma_frequency, rel=1e-9)


def test_no_tones_no_judgement():
    assert judged_tones(SimpleNamespace(), ()).found == ()
