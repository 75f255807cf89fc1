"""The search for layouts against going through all of them with another formula."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.motion.layout.information import RowNoise, worst_case
from sightline.motion.layout.search import Candidates, choices, distinct_orders, polished, search_layouts

BAND = (40.0, 150.0)
GRID = np.arange(40.0, 150.01, 0.25)


def brute(t, sigma, spacing=0.0, ordered=False):
    """Best worst case of all layouts, by the sum of squared distances of phasors from their weighted mean."""
    weights = 1.0 / np.square(sigma)
    best = -np.inf
    orders = set(permutations(weights)) if ordered else {tuple(weights)}
    for places in combinations(range(len(t)), len(weights)):
        at = t[list(places)]
        if np.diff(at).min() < spacing * (1.0 - 1e-9):
            continue
        z = np.exp(2j * np.pi * GRID[:, None] * at)
        for w in orders:
            mean = z @ np.array(w) / np.sum(w)
            best = max(best, float((np.abs(z - mean[:, None]) ** 2 @ np.array(w)).min()))
    return best


def value(candidates, found, noise):
    """Worst case of the best layout found, in full."""
    order = found.order[0]
    sigma = tuple(noise.sigma_px[k] for k in order)
    return worst_case(candidates.t[found.places[0]], BAND, RowNoise(sigma, 1e-3))[0]


# Both are judged on frequencies of their own: 0.25 Hz here, 1 / (24 span) there; 1 % covers the difference.
@pytest.mark.parametrize("exhaustive", [True, False])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_it_finds_the_best_of_equal_images_on_an_even_grid(count, exhaustive):
    noise = RowNoise((1.0,) * count, 1e-3)
    candidates = Candidates.even_grid(0.03, 1e-3, 2e-3)
    found = search_layouts(candidates, noise, BAND, exhaustive=exhaustive)
    assert found.exhaustive is exhaustive
    assert value(candidates, found, noise) == pytest.approx(
        brute(candidates.t, (1.0,) * count, 2e-3), rel=0.01
    )
    assert np.diff(candidates.t[found.places], axis=1).min() >= 2e-3 * (1.0 - 1e-9)


@pytest.mark.parametrize("exhaustive", [True, False])
def test_it_finds_the_best_order_of_unlike_images(exhaustive):
    sigma = (1.0, 2.0, 1.0)
    noise, candidates = RowNoise(sigma, 1e-3), Candidates.even_grid(0.03, 1e-3, 1e-3)
    found = search_layouts(candidates, noise, BAND, exhaustive=exhaustive)
    assert value(candidates, found, noise) == pytest.approx(
        brute(candidates.t, sigma, ordered=True), rel=0.01
    )


@pytest.mark.parametrize("exhaustive", [True, False])
def test_it_chooses_among_lines_at_uneven_places(exhaustive):
    t = np.cumsum(np.random.default_rng(0).uniform(3e-4, 2e-3, 22))
    candidates, noise = Candidates(t - t[0], 1e-4, False), RowNoise((1.0,) * 3, 1e-3)
    found = search_layouts(candidates, noise, BAND, exhaustive=exhaustive)
    assert value(candidates, found, noise) == pytest.approx(brute(t, (1.0,) * 3), rel=0.01)


def test_layouts_are_ranked_and_the_best_of_every_span_is_kept():
    candidates, noise = Candidates.even_grid(0.03, 1e-3, 1e-3), RowNoise((1.0,) * 3, 1e-3)
    found = search_layouts(candidates, noise, BAND)
    assert (np.diff(found.worst) <= 0.0).all() and found.worst[0] == found.by_span.max()
    for span in (5, 17, 30):
        inner = [worst_case(candidates.t[[0, k, span]], BAND, noise)[0] for k in range(1, span)]
        assert found.by_span[span] == pytest.approx(max(inner), rel=0.01)
        assert found.by_span_places[span][-1] == span


def test_moving_off_the_grid_gains_and_keeps_span_and_spacing():
    noise, start = RowNoise((1.0,) * 3, 1e-3), np.array([0.0, 0.004, 0.010])
    better = polished(start, noise, BAND, step=5e-4, span=0.0102, min_spacing=0.0038)
    assert worst_case(better, BAND, noise)[0] > worst_case(start, BAND, noise)[0]
    assert better[0] == 0.0 and better[-1] <= 0.0102 * (1 + 1e-9)
    assert np.diff(better).min() >= 0.0038 * (1 - 1e-9)
    held = polished(start, noise, BAND, step=5e-4, span=0.02, min_spacing=1e-3, fixed_span=True)
    assert held[-1] == start[-1]


def test_orders_of_images_that_differ_are_counted_once():
    assert len(distinct_orders((1.0, 1.0, 1.0), mirrored=True)) == 1
    # two unlike among four, equal ones not distinguished: 4! / 2! = 12, mirrored ones once: 6
    assert len(distinct_orders((1.0, 2.0, 3.0, 1.0), mirrored=False)) == 12
    assert len(distinct_orders((1.0, 2.0, 3.0, 1.0), mirrored=True)) == 6
    grid = Candidates.even_grid(0.02, 1e-3, 1e-3)
    assert choices(grid, RowNoise((1.0,) * 3, 1e-3)) == 190 / 2  # 20 choose 2, mirrored ones once
    assert choices(grid, RowNoise((1.0, 1.0, 2.0), 1e-3)) == 3 * 190 / 2


@pytest.mark.parametrize(
    ("count", "span", "message"),
    [(1, 0.1, "2 or more"), (5, 0.007, "room for 4"), (3, 0.0, "room for 1")],
)
def test_detectors_that_do_not_fit_are_refused(count, span, message):
    candidates = Candidates.even_grid(span, 1e-3, 2e-3)
    with pytest.raises(InputError, match=message):
        search_layouts(candidates, RowNoise((1.0,) * count, 1e-3), BAND)
