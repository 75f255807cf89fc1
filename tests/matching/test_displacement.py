"""A smooth field through scattered displacements."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

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


def regressed(place, points, values, weights) -> np.ndarray:
    """Locally weighted regression as its text has it (Cleveland 1979), by another solver."""
    used = np.flatnonzero(weights > 0.0)
    off = points[used] - place
    near = np.argsort(np.hypot(*off.T))[:24]
    distance = np.hypot(*off[near].T)
    reach = 1.01 * distance[-1]
    y, x = off[near].T / reach
    root = np.sqrt((1.0 - (distance / reach) ** 3) ** 3 * weights[used[near]])[:, None]
    rows = root * np.stack([np.ones(24), y, x, y * y, x * y, x * x], axis=1)
    # a millionth of all squares holds each term to zero, so that points on a line are no trouble
    held = 1e-3 * np.linalg.norm(rows) * np.eye(6)
    seen = np.concatenate([root * values[used[near]], np.zeros((6, 2))])
    return np.linalg.lstsq(np.concatenate([rows, held]), seen, rcond=None)[0][0]


def test_the_field_is_the_quadratic_of_the_nearest_points_by_tricube_weights():
    rng = np.random.default_rng(5)
    points, places = scattered(90), scattered(40, 6)
    values = bowl(points) + 0.3 * rng.standard_normal((90, 2))
    values[:6] += 4.0
    # biweights of what each point departs from the others by, in spreads that Gaussian numbers would have
    weights = np.ones(90)
    for _ in range(4):
        miss = np.empty(90)
        for row in range(90):
            others = np.where(np.arange(90) == row, 0.0, weights)
            miss[row] = np.hypot(*(values[row] - regressed(points[row], points, values, others)))
        spread = np.median(miss[weights > 0.0]) / norm.ppf(0.75)
        weights = np.clip(1.0 - (miss / (5.0 * spread)) ** 2, 0.0, None) ** 2
    field = DisplacementField(points, values)
    assert (weights[:6] == 0.0).all() and np.median(weights) > 0.8
    np.testing.assert_allclose(field.weights, weights, atol=1e-4)  # 1.4826 has five digits
    wanted = [regressed(place, points, values, field.weights) for place in places]
    np.testing.assert_allclose(field.at(places), wanted, atol=1e-8)


def test_a_point_is_weighed_by_the_others_about_it_alone():
    # on a plane field all but one of 60: its own displacement must not vouch for it
    points = scattered(60)
    values = points @ np.array([[0.01, 0.0], [0.0, -0.02]])
    values[7, 0] += 0.3
    # the spread of the others is none, so the least, 0.1 px, and the weight (1 - (0.3 / 0.5)^2)^2; those
    # beside the point are fitted to it too, and count a little less
    weights = DisplacementField(points, values).weights
    assert weights[7] == pytest.approx((1.0 - 0.36) ** 2, rel=0.02)
    assert np.delete(weights, 7).min() > 0.9
