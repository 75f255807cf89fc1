"""Why two bands do not match where their cameras say."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sightline.geometry.surface import Plane
from sightline.motion.strip.causes import magnification_words, matches_backwards, other_magnification
from sightline.simulate.scenarios import line_of_sight_case

SEARCH = (8, 8)


def bands(**options):
    """The first two bands of a strip; the others cost time only."""
    scenario = line_of_sight_case("nominal", 2, lines=700, columns=400, **options)
    return scenario.as_given()[:2]


@pytest.fixture(scope="module", params=[(), (1.0, 4.0, 4.0, 4.0)], ids=["like", "four to one"])
def pair(request):
    return bands(pixel_ratios=request.param)


@pytest.mark.parametrize("scale", [0.02, -0.03])
def test_another_magnification_is_found_either_way_round(pair, scale):
    first, second = pair
    wrong = replace(second, camera=second.camera.with_detector(second.camera.detector.adjusted(scale=-scale)))
    # it looks further out than its camera says; matches of 0.1 px over 200 columns tell that to 1e-3
    assert other_magnification(first, wrong, Plane(), SEARCH) == pytest.approx(scale, abs=2e-3)
    assert f"{100 * abs(scale):.2g} % {'larger' if scale > 0 else 'smaller'}" in magnification_words(
        first, wrong, Plane(), SEARCH
    )
    assert other_magnification(wrong, first, Plane(), SEARCH) == pytest.approx(-scale, abs=2e-3)


def test_bands_that_match_have_no_other_magnification(pair):
    assert other_magnification(*pair, Plane(), SEARCH) is None
    assert magnification_words(*pair, Plane(), SEARCH) == ""


def test_a_lag_of_the_other_sign_is_known_by_matches_on_the_other_side(pair):
    first, second = pair
    assert not matches_backwards(first, second, Plane(), SEARCH)
    detector = second.camera.detector
    y = detector.tangents[:, 1].mean()
    step = detector.pixel_step
    turned = replace(second, camera=second.camera.with_detector(detector.adjusted(line_px=-2.0 * y / step)))
    assert matches_backwards(first, turned, Plane(), SEARCH)
