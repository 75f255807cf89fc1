"""Shares of a turn that matches find where lines stand unevenly on the ground, against known turns."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.surface import Plane
from sightline.motion.measure import stars
from sightline.motion.measure.predict import turned
from sightline.motion.measure.stars import MatchingPlan, match_star
from sightline.motion.measure.uneven_lines import uneven
from sightline.motion.measure.windows import window_grid
from sightline.simulate.scenarios import line_of_sight_case

#: Lines of 2 ms, among tones of 47, 83 and 121 Hz: rates of the scan vary by a quarter.
SLOW = {
    "ifov": 2e-5, "line_period": 2e-3, "names": ("first", "second"), "lags": (0.0, 0.0222),
    "gains": (1.0, 1.0), "gammas": (1.0, 1.0), "snr": 300.0, "coherence": 1.0,
}  # fmt: skip
#: px; of the turn that is looked for.
TURN = 0.1


@pytest.fixture(scope="module")
def scenario():
    return line_of_sight_case("nominal", 2, lines=500, columns=300, **SLOW)


def share_found(scenario) -> float:
    """Of a turn of the second camera, how much of it matches say, in the mean of all windows."""
    images, cameras = [band.image for band in scenario.as_given()], list(scenario.cameras)
    plan = MatchingPlan((4, 100), 4)
    grid = window_grid(images[0].shape, plan.window, plan.step)

    def star(second):
        return match_star(images, [cameras[0], second], Plane(), 0, (1,), grid, [], plan).star

    turn = np.array([0.0, TURN * scenario.options.ifov, 0.0])
    true, moved = star(cameras[1]), star(turned(cameras[1], turn))
    wanted = -np.einsum("gca,a->gc", true.by_partner[:, 0].astype(float), turn)[:, 0]
    found = (moved.residual_px - true.residual_px)[:, 0, 0]
    seen = np.isfinite(found) & (np.abs(found) < 1.5)
    assert seen.sum() > 250
    return float(wanted[seen] @ found[seen] / (wanted[seen] @ wanted[seen]))


def test_lines_of_a_steady_scan_are_even(scenario):
    assert uneven(scenario.cameras[0], Plane())
    assert not uneven(scenario.nominal_cameras[0], Plane())
    assert not uneven(line_of_sight_case("nominal", 2, lines=500, columns=300).cameras[0], Plane())


def test_a_turn_is_found_almost_in_full(scenario, monkeypatch):
    # Differences of matches of the same textures hold hardly any noise. Shares of single windows spread by a
    # quarter and are measured to a tenth: two thirds of what is lost in the mean must come back.
    found = share_found(scenario)
    monkeypatch.setattr(stars, "uneven", lambda camera, surface: False)
    plain = share_found(scenario)
    assert plain < 0.88
    assert abs(found - 1.0) < 0.4 * (1.0 - plain)
