"""Shares of a turn that matches find where lines stand unevenly on the ground, against known turns."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.geometry.surface import Plane
from sightline.motion.measure import stars
from sightline.motion.measure.plan import MatchingPlan
from sightline.motion.measure.predict import turned
from sightline.motion.measure.stars import match_star
from sightline.motion.measure.uneven_lines import answers, uneven
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


def test_false_answers_are_those_of_most_windows():
    camera = SimpleNamespace(trajectory=SimpleNamespace(motion=None, span=(0.0, 1.0)))
    camera.with_trajectory = lambda trajectory: camera
    camera.trajectory.with_motion = lambda motion: camera.trajectory
    by, affine = np.zeros((6, 2, 3)), np.broadcast_to(np.eye(2), (6, 2, 2))
    by[:, 0, 1] = 1e5
    first = SimpleNamespace(kept=np.ones(6, bool), b=np.zeros((6, 2)))
    found = -0.05 * np.array([0.8, 0.9, 0.7, -0.2, 0.05, 0.8])
    second = SimpleNamespace(
        kept=np.arange(6) < 5, b=np.column_stack([np.append(found[:5], np.nan), np.zeros(6)])
    )
    got = answers([camera, camera], 1, first, by, affine, lambda other: second)
    # of the kept ones the median is .7, which the two that are hardly any and the one not kept are given
    np.testing.assert_allclose(got, [0.8, 0.9, 0.7, 0.7, 0.7, 0.7])
    nothing = SimpleNamespace(kept=np.zeros(6, bool), b=np.full((6, 2), np.nan))
    np.testing.assert_array_equal(answers([camera] * 2, 1, first, by, affine, lambda other: nothing), 1.0)
    np.testing.assert_array_equal(
        answers([camera] * 2, 1, first, 0.0 * by, affine, lambda other: second), 1.0
    )
