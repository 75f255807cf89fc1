"""A panchromatic strip and colours of pixels four times as large: recovered, and laid on one another."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.applications.registration import fit_every_pair, register_bands
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case

#: px of the finest band: three colours of 80 columns, and tones that windows of 4 ms hardly pass.
ROLL_PITCH, YAW = 0.12, 0.15


@pytest.fixture(scope="module")
def strip():
    scenario = line_of_sight_case("pan-xs", 1, lines=900, columns=320, snr=100.0, offset_sigma_px=0.8)
    return scenario, recover_line_of_sight(scenario.as_given(), Plane(), options=RecoverOptions(passes=2))


def test_the_motion_comes_at_the_rate_of_the_first_band(strip):
    scenario, result = strip
    truth = scenario.truth
    assert np.median(np.diff(result.motion.t)) == pytest.approx(5e-4)
    score = score_result(result, truth[:, 0], truth[:, 1:])
    assert score.roll.rms < ROLL_PITCH and score.pitch.rms < ROLL_PITCH and score.yaw.rms < YAW
    # a good sigma gives 1; of some 60 independent samples 95 in 100 lie within a third of it
    for axis in score.axes.values():
        assert 0.4 < axis.nees < 2.5


def test_nearly_all_windows_that_lie_in_both_are_kept(strip):
    _, result = strip
    pairs = {pair.images: pair for pair in result.pairs if pair.tried > 100}
    assert set(pairs) == {(1, 2), (1, 3), (1, 0)}
    assert all(pair.kept >= 0.9 * pair.tried for pair in pairs.values())


@pytest.mark.parametrize("onto", ["PAN", "B1"], ids=["onto the fine one", "onto a coarse one"])
def test_bands_are_registered_on_either_grid(strip, onto):
    scenario, result = strip
    statics = {static.name: static.value for static in result.statics}
    registration = register_bands(scenario.as_given(), Plane(), result.motion, statics, onto=onto)
    pixel = 1.0 if onto == "PAN" else 4.0
    assert registration.coarse == ((1, 4, 4, 4) if onto == "PAN" else (1, 1, 1, 1))
    for band in (1, 2, 3):
        images, coarse = ([values[0], values[band]] for values in (registration.after, registration.coarse))
        (fit,) = fit_every_pair(images, coarse=coarse)
        # windows of the coarse pixels match to some 0.02 of one; before they lay 5 px of the finest apart
        offset = fit.offset_px * pixel
        assert len(offset) >= 6 and np.sqrt((offset**2).sum(axis=1).mean()) < 0.25
