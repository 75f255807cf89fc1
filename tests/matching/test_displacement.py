"""A smooth field through scattered displacements."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.matching.displacement import DisplacementField


def scattered(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 400.0, (count, 2))


def bowl(points: np.ndarray) -> np.ndarray:
    y, x = (points / 100.0 - 2.0).T
    return np.stack([3.0 * y * y - x, 2.0 + x * y], axis=1)


def test_a_quadratic_field_comes_back_exactly_between_the_points():
    points, places = scattered(150), scattered(60, 2) * 0.8 + 40.0
    # the normal equations carry a trace of 1e-6, of values up to 20 px
    assert np.abs(DisplacementField(points, bowl(points)).at(places) - bowl(places)).max() < 1e-3


def test_wrong_displacements_carry_no_weight_and_leave_no_trace():
    points = scattered(150)
    values = bowl(points)
    wrong = np.arange(150) % 7 == 0
    values[wrong] += np.random.default_rng(3).choice([-1.0, 1.0], (wrong.sum(), 2)) * 12.0
    field = DisplacementField(points, values)
    assert (field.weights[wrong] == 0.0).all()
    assert (field.weights[~wrong] > 0.0).mean() > 0.9
    places = scattered(60, 2) * 0.8 + 40.0
    assert np.abs(field.at(places) - bowl(places)).max() < 0.05


@pytest.mark.parametrize("count", [1, 3, 8])
def test_few_points_give_a_plain_field_and_none_gives_zero(count):
    points = scattered(count)
    values = np.tile([1.5, -0.5], (count, 1))
    assert np.allclose(DisplacementField(points, values).at(scattered(5, 4)), [1.5, -0.5], atol=1e-4)
    nothing = DisplacementField(np.empty((0, 2)), np.empty((0, 2)))
    assert (nothing.at(scattered(5, 4)) == 0.0).all()
