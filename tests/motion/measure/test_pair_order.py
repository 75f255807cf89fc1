"""Which bands come first: the best correlated pair, measured on rendered bands."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.measure.pair_order import best_first, pair_correlations
from sightline.simulate.scenarios import line_of_sight_case


def symmetric(upper):
    table = np.zeros((4, 4))
    table[np.triu_indices(4, 1)] = upper
    return table + table.T


@pytest.mark.parametrize(
    ("upper", "order"),
    [
        # pairs 01, 02, 03, 12, 13, 23
        ([0.9, 0.8, 0.7, 0.6, 0.5, 0.4], (0, 1, 2, 3)),
        ([0.1, 0.2, 0.3, 0.4, 0.5, 0.9], (2, 3, 1, 0)),
        ([0.3, 0.3, 0.0, 0.9, 0.0, 0.0], (1, 2, 0, 3)),
    ],
)
def test_the_best_pair_then_whichever_is_most_like_one_taken(upper, order):
    assert best_first(symmetric(upper)) == order


def test_only_allowed_pairs_are_ranked_and_a_group_apart_begins_by_itself():
    # pairs 01, 02, 03, 12, 13, 23: only 02 and 13 may be matched
    assert best_first(symmetric([-1.0, 0.4, -1.0, -1.0, 0.9, -1.0])) == (1, 3, 0, 2)
    # 0 and 2 with nothing of their own left: a pair without a partner comes last
    assert best_first(symmetric([-1.0, -1.0, 0.3, -1.0, 0.9, -1.0])) == (1, 3, 0, 2)


def test_pairs_that_may_not_be_matched_are_not_looked_at():
    scenario = line_of_sight_case("nominal", 1, lines=128, columns=120)
    images = [ArrayImage(scenario.image(k)) for k in range(4)]
    found = pair_correlations(
        images, scenario.nominal_cameras, Plane(0.0), (10, 100), (4, 4), allowed=[(2, 1)]
    )
    assert found[1, 2] > 0.5 and found[2, 1] == found[1, 2]
    assert (found[np.triu_indices(4, 1)] == -1.0).sum() == 5


def test_two_images_stay_as_they_are():
    assert best_first(np.array([[0.0, 0.2], [0.2, 0.0]])) == (0, 1)


def test_correlations_are_those_of_the_bands():
    """Textures that correlate by 0.4 and 0.97: noise (SNR 120, contrast 0.2) takes little of that."""
    scenario = line_of_sight_case(
        "nominal", 1, lines=500, columns=120, names=("A", "B", "C"), lags=(0.0, 0.0222, 0.1), motion="none",
        gains=(1.0,) * 3, gammas=(1.0,) * 3, coherence_with_first=(1.0, 0.97, 0.4),
    )  # fmt: skip
    images = [ArrayImage(scenario.image(k)) for k in range(3)]
    found = pair_correlations(images, scenario.nominal_cameras, Plane(0.0), (10, 100), (8, 8))
    assert best_first(found) == (0, 1, 2)
    assert found[0, 1] == pytest.approx(0.97, abs=0.05)
    # windows of 1000 px whose long waves dominate: few independent samples each, some 30 windows
    assert found[0, 2] == pytest.approx(0.4, abs=0.15)


def test_images_without_common_ground_count_as_unlike():
    scenario = line_of_sight_case("nominal", 1, lines=128, columns=120)
    images = [ArrayImage(scenario.image(k)) for k in range(4)]
    found = pair_correlations(images, scenario.nominal_cameras, Plane(0.0), (10, 100), (4, 4))
    assert found[0, 1] == 0.0  # 300 lines apart
    assert found[1, 2] > 0.5
