"""Heights known to a sigma, and not at all, through the whole recovery of a strip."""

from __future__ import annotations

import numpy as np
import pytest

from consistency import bounds
from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Dem, Plane
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case


@pytest.fixture(scope="module")
def strip():
    """A short strip over hills of 300 m rms."""
    scenario = line_of_sight_case("relief", 3, lines=500, columns=420)
    return scenario, scenario.as_given()[:3]


def scored(strip, surface, height_sigma, passes):
    """Score of the recovery with some knowledge of the ground."""
    scenario, bands = strip
    options = RecoverOptions(passes=passes)
    result = recover_line_of_sight(bands, surface, height_sigma=height_sigma, options=options)
    truth = scenario.truth
    return score_result(result, truth[:, 0], truth[:, 1:])


@pytest.fixture(scope="module")
def owned(strip):
    """Score over a plane whose heights are known to the sigma that is true."""
    heights = strip[0].scene.relief.heights
    return scored(strip, Plane(float(heights.mean())), float(heights.std()), passes=1)


def test_a_small_height_sigma_that_matters_only_once_matches_are_dense_is_taken():
    scenario = line_of_sight_case("relief", 3, lines=260, columns=320)
    pan, _, *near = scenario.as_given()  # the second looks ahead by more lines than there are
    strip, relief = (scenario, [pan, *near]), scenario.scene.relief
    # 20 m move matches by 0.009 px at the longest lag: below the noise of the first pass, above a tenth of
    # that of the last
    score = scored(strip, Dem(relief.heights, relief.transform), 20.0, passes=2)
    assert all(np.isfinite(axis.sigma) for axis in score.axes.values())


def test_relief_left_out_must_be_owned_by_the_sigma(strip, owned):
    plane = Plane(float(strip[0].scene.relief.heights.mean()))
    ignored = scored(strip, plane, 0.0, passes=1)
    for name in ("roll", "yaw"):
        # the score's own 95 % bounds for so many independent samples, some five where relief is owned: of one
        # such strip in forty a true sigma is beyond them
        assert getattr(ignored, name).nees > getattr(ignored, name).nees_high
        low, high = bounds(getattr(owned, name).effective_samples)
        assert low < getattr(owned, name).nees < high < getattr(ignored, name).nees
    # pitch beside unknown relief rests on some four slow numbers
    assert bounds(4)[0] < owned.pitch.nees < owned.pitch.nees_high
    # a mean height that drifts by 300 m in a second imitates pitch: the sigma owns it
    # (each is known to 10 % on so short a strip)
    assert owned.pitch.sigma > 1.2 * ignored.pitch.sigma


def test_ground_known_to_a_kilometre_is_recovered_beside_the_motion(strip, owned):
    plane = Plane(float(strip[0].scene.relief.heights.mean()))
    # the bands look ahead of each other: some see ground before the first band's first line
    loose = scored(strip, plane, 1e3, passes=1)
    for name in ("roll", "yaw"):  # which unknown heights hardly touch: as well as with the sigma that is true
        assert getattr(loose, name).rms < 1.2 * getattr(owned, name).rms
        assert getattr(loose, name).nees < bounds(getattr(loose, name).effective_samples)[1]


def test_flat_ground_said_to_be_unknown_costs_little():
    """A sigma is often said for want of a DEM: the images show that such ground has hardly any of it."""
    scenario = line_of_sight_case("nominal", 1, lines=500, columns=240)
    strip = scenario, scenario.as_given()
    exact, loose = (scored(strip, Plane(0.0), sigma, passes=1) for sigma in (0.0, 100.0))
    # believed hills of 100 m take half as much again from what is known of pitch; so flat ones hardly a fifth
    for name in ("roll", "pitch", "yaw"):
        assert getattr(loose, name).sigma < 1.2 * getattr(exact, name).sigma
    # the axis that heights imitate
    assert loose.pitch.nees_low < loose.pitch.nees < loose.pitch.nees_high
