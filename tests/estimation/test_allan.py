"""Allan deviation against closed forms of noise and against the definition in plain steps."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.estimation.allan import allan_deviation, random_walk


def test_it_is_the_definition_step_by_step():
    angles = np.random.default_rng(2).standard_normal(40).cumsum()
    tau, deviation = allan_deviation(angles, 0.5, [1, 3])
    for m, found in zip((1, 3), deviation, strict=True):
        rates = [(angles[k + m] - angles[k]) / (0.5 * m) for k in range(len(angles) - m)]
        pairs = [0.5 * (rates[k + m] - rates[k]) ** 2 for k in range(len(rates) - m)]
        assert found == pytest.approx(np.sqrt(np.mean(pairs)), rel=1e-12)
    np.testing.assert_allclose(tau, [0.5, 1.5])


def test_white_rate_and_white_angle_have_their_slopes():
    rng = np.random.default_rng(5)
    walk, angle = rng.standard_normal(20_000).cumsum(), rng.standard_normal(20_000)
    spans = [1, 4, 16, 64]
    # 20000 / 64 independent differences: 4 % of one sigma, three of them
    tau, found = allan_deviation(walk, 0.25, spans)
    np.testing.assert_allclose(found, 2.0 / np.sqrt(tau), rtol=0.12)
    tau, found = allan_deviation(angle, 0.25, spans)
    np.testing.assert_allclose(found, np.sqrt(3.0) / tau, rtol=0.12)


def test_a_constant_rate_has_none():
    assert allan_deviation(0.3 * np.arange(50), 1.0)[1].max() < 1e-14


def test_the_random_walk_is_nowhere_below():
    tau, deviation = np.array([0.1, 1.0, 10.0]), np.array([3.0, 1.0, 0.2])
    assert random_walk(tau, deviation) == pytest.approx(1.0)


def test_too_few_readings_are_refused():
    with pytest.raises(InputError, match="more than twice as many"):
        allan_deviation([0.0, 1.0, 2.0], 1.0, [2])
    with pytest.raises(InputError, match="finite numbers"):
        allan_deviation([0.0, np.nan, 2.0], 1.0)
