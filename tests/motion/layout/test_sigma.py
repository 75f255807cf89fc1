"""Posterior sigma before any image is taken: two ways, and their limits."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.motion.layout.information import RowNoise
from sightline.motion.layout.search import Candidates
from sightline.motion.layout.sigma import (
    harmonic_sigma,
    least_sigma,
    pair_rows,
    posterior_psd,
    smoother_sigma,
)

PRIOR = Spectrum((Matern(1.0, 0.3, "5/2"), Matern(0.1, 0.01, "3/2"), Tone(0.2, 31.0, 0.1)))
NOISE = RowNoise.alike(3, 0.03, 2e-3)
POSITIONS = np.array([0.0, 0.006, 0.040])


def test_without_information_the_prior_is_left_less_its_mean():
    # variance of x less its mean over T: r(0) - 2/T^2 int (T - u) r(u) du
    duration, u = 2.0, np.linspace(0.0, 2.0, 200_001)
    covariance = PRIOR.autocovariance(u)
    mean = 2.0 / duration**2 * np.trapezoid((duration - u) * covariance, u)
    blind = RowNoise.alike(3, 1e6, 1e-4)
    # the tail beyond half the row rate counts as unknown and the quadrature is good to 1e-3
    assert harmonic_sigma(POSITIONS, blind, PRIOR, duration) == pytest.approx(np.sqrt(1.05 - mean), rel=2e-3)


def test_the_part_within_a_band_is_the_integral_of_the_posterior_spectrum():
    f = np.linspace(20.0, 60.0, 40_001)
    left = 1.0 / (1.0 / PRIOR.psd(f) + _information(f) / (2.0 * NOISE.period))
    assert posterior_psd(f, POSITIONS, NOISE, PRIOR) == pytest.approx(left, rel=1e-9)
    expected = np.sqrt(np.trapezoid(left, f))
    got = harmonic_sigma(POSITIONS, NOISE, PRIOR, 2.0, passband=(20.0, 60.0))
    assert got == pytest.approx(expected, rel=2e-3)


def _information(f):
    total = np.exp(2j * np.pi * f[:, None] * POSITIONS).sum(axis=1)
    return (3.0 - np.abs(total) ** 2 / 3.0) / (0.03**2 / 2.0)


def test_the_smoother_agrees_but_for_the_ends():
    t, sigma = smoother_sigma(POSITIONS, NOISE, PRIOR, 6.0)
    harmonic = harmonic_sigma(POSITIONS, NOISE, PRIOR, 6.0)
    # two ends of about a timescale (0.3 s) each, with twice the variance, on 6 s: 5 % of the rms
    assert harmonic < np.sqrt(np.mean(sigma**2)) < 1.1 * harmonic
    inner = sigma[(t > 1.0) & (t < 5.0)]
    assert sigma[0] > 1.2 * inner.max() and sigma[-1] > 1.2 * inner.max()


def test_rows_are_where_all_detectors_are_exposing_two_by_two():
    noise = RowNoise((0.01, 0.02, 0.03), 2e-3, 4e-3)
    series = pair_rows(POSITIONS, noise, 0.1)
    assert [s.images for s in series] == [(0, 1), (0, 2), (1, 2)]
    for s in series:
        a, b = s.images
        assert s.lag == pytest.approx(np.full(len(s.t), POSITIONS[b] - POSITIONS[a]))
        assert s.t.min() >= 0.002 - 1e-12 and (s.t + s.lag).max() <= 0.098 + 1e-12
        assert s.variance == pytest.approx(np.full(len(s.t), noise.sigma_px[a] ** 2 + noise.sigma_px[b] ** 2))
    # the same row of ground has the same number in every pair
    ground = [
        dict(zip(s.patch.tolist(), (s.t - POSITIONS[s.images[0]]).tolist(), strict=True)) for s in series
    ]
    for row, at in ground[1].items():
        assert ground[0].get(row, at) == pytest.approx(at) and ground[2].get(row, at) == pytest.approx(at)


def test_the_layout_of_least_sigma_is_not_bettered_by_any_one_place():
    candidates = Candidates.even_grid(0.05, 1e-3, 1e-3)
    best = least_sigma(POSITIONS, candidates, NOISE, PRIOR, 2.0)
    own = harmonic_sigma(best, NOISE, PRIOR, 2.0)
    assert own < harmonic_sigma(POSITIONS, NOISE, PRIOR, 2.0)
    for k in (1, 2):
        for place in candidates.t[1:]:
            other = best.copy()
            other[k] = place
            if np.diff(np.sort(other)).min() >= 1e-3 * (1.0 - 1e-9):
                assert harmonic_sigma(other, NOISE, PRIOR, 2.0) >= own * (1.0 - 1e-3)
