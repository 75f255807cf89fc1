"""Bounds of plans and problems: against a dense computation, and varied settings against ones made so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.photogrammetry import s2_dense
from tests.photogrammetry.pair.test_settings import DETECTOR, problem
from tests.photogrammetry.s2_dense import ARCSEC, Case

from sightline.applications.stereo_prediction import improvements, predict, predict_plan
from sightline.errors import InputError
from sightline.geometry.orbit_pair import OrbitPair
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.pair.settings import StereoPlan
from sightline.photogrammetry.sightings import Images
from sightline.simulate.stereo import stereo_case

CASE = Case(shots=16, points=60, relief=0.0)


def plan(**given) -> StereoPlan:
    known = {
        "noise": PoseNoise(CASE.sigma_position, CASE.sigma_attitude), "shots": CASE.shots,
        "points": CASE.points, "scene_size": CASE.scene,
    }  # fmt: skip
    pair = OrbitPair(separation=given.pop("separation", 70.0))
    return StereoPlan(pair, (DETECTOR, DETECTOR), (NADIR_MOUNT, NADIR_MOUNT), **known | given)


def arcsec(prediction):
    """(C, 3) sigmas, arcsec."""
    return prediction.sigmas / ARCSEC


@pytest.mark.parametrize("method", ["ml-track", "ml-pair"])
def test_bound_of_a_plan_is_that_of_a_dense_computation(method):
    found = predict_plan(plan(), method, tables=False)
    draws = [
        s2_dense.bound(replace(CASE, seed=seed), np.zeros((2, 3)), pairs=method == "ml-pair")
        for seed in range(5)
    ]
    dense = np.sqrt(np.mean([np.diag(draw) for draw in draws], axis=0)) / ARCSEC
    # points drawn there and evenly laid out here, on a plane there and a sphere here: draws differ by 10 %
    np.testing.assert_allclose(arcsec(found).ravel(), dense, rtol=0.1)
    assert (found.points, found.shots, found.sightings) == (60, 16, 2 * 16 * 60)
    assert found.window == pytest.approx(64.0)
    assert found.baseline == pytest.approx(np.linalg.norm(np.diff(s2_dense.positions(CASE)[1], axis=0)[0, 0]))


def test_a_problem_has_the_bound_of_its_plan():
    planned, found = predict_plan(plan(), tables=False), predict(problem(plan()), tables=False)
    np.testing.assert_allclose(found.sigmas, planned.sigmas, rtol=1e-6)
    assert "matches" in found.how


def test_points_are_laid_out_where_no_matches_are_named():
    found = predict(problem(plan(), matched=False), tables=False)
    assert 250 <= found.points <= 330
    assert "laid out" in found.how and "camera 1" in found.how
    # as many points laid out by the plan, over all that the frames share
    planned = predict_plan(plan(points=300, scene_size=None), tables=False)
    np.testing.assert_allclose(found.sigmas, planned.sigmas, rtol=0.25)


def test_tables_of_a_problem_are_those_of_its_plan():
    of_plan = {table.quantity: table for table in predict_plan(plan()).tables}
    of_problem = {table.quantity: table for table in predict(problem(plan())).tables}
    assert list(of_plan) == [
        "separation", "window", "shots", "points", "image noise", "position noise", "attitude noise",
    ]  # fmt: skip
    assert list(of_problem) == ["baseline", *list(of_plan)[1:]]
    for name in list(of_plan)[1:]:
        a, b = of_plan[name], of_problem[name]
        assert a.planned == pytest.approx(b.planned)
        rows = [(i, j) for i, v in enumerate(a.values) for j, w in enumerate(b.values) if np.isclose(v, w)]
        assert len(rows) >= 4
        i, j = np.array(rows).T
        # few points, thinned or laid out anew, sit elsewhere
        np.testing.assert_allclose(a.sigmas[:, i], b.sigmas[:, j], rtol=0.3 if name == "points" else 0.05)
    for table in (*of_plan.values(), *of_problem.values()):
        assert table.planned in table.values
        # points tracked through all shots tell more than points new in each
        assert (table.sigmas[0] <= table.sigmas[1] * (1.0 + 1e-6)).all()
        assert table.sigmas.shape == (2, len(table.values), 6)


def test_improvements_are_what_they_say():
    given = problem(plan())
    now = predict(given, tables=False)
    found = {change.change: change for change in improvements(given)}
    assert len(found) == 8
    by = {
        "twice the window": plan(window=128.0),
        "twice as many shots": plan(shots=32),
        "half the image": plan(sigma_px=0.05),
    }
    for words, other in by.items():
        change = next(c for name, c in found.items() if words in name)
        made = predict_plan(other, tables=False).sigmas.ravel()
        np.testing.assert_allclose(change.sigmas, made, rtol=0.03)
        np.testing.assert_allclose(change.ratio, change.sigmas / now.sigmas.ravel())
    for change in found.values():
        # a longer baseline sees the ground at a slant: pitch loses (prototype: 1.2 to 1.4 arcsec)
        if "baseline" not in change.change:
            assert (change.sigmas <= now.sigmas.ravel() * (1.0 + 1e-9)).all(), change.change


def test_angles_of_one_shot_are_not_observable_until_there_is_control():
    found = predict_plan(plan(shots=1), tables=False)
    touched = np.array([[True, False, True], [True, False, True]])
    assert np.array_equal(np.isinf(found.sigmas), touched)
    control = next(c for c in found.improvements if "control" in c.change)
    assert np.isfinite(control.sigmas).all()
    assert np.array_equal(control.ratio == 0.0, touched.ravel())
    assert not any("window" in c.change for c in predict(problem(plan(shots=1)), tables=False).improvements)


def test_what_cannot_be_planned_is_refused():
    with pytest.raises(InputError, match="as many detectors"):
        StereoPlan(OrbitPair(), (DETECTOR,), (NADIR_MOUNT,), PoseNoise(7.5, 1e-5))
    with pytest.raises(InputError, match="`points`"):
        plan(points=0)
    with pytest.raises(InputError, match="ml-track and ml-pair"):
        predict_plan(plan(), "epipolar")
    away = problem(plan(), matched=False)
    images = away.images
    up = images.world_from_body * Rotation.from_euler("x", 180.0, degrees=True)
    lost = Images(images.camera, images.shot, images.t, images.position, up)
    with pytest.raises(InputError, match="do not look at the ground"):
        predict(replace(away, images=lost))


def test_three_cameras_with_gaps_and_control_points_are_varied_too():
    scenario = stereo_case(
        "A_three_cameras", 0, shots=12, points=40, missing_images=0.2, unpaired=True, track_shots=(4, 10)
    )
    found = predict(StereoProblem(**scenario.problem(control_points=3)))
    assert found.sigmas.shape == (3, 3) and np.isfinite(found.sigmas).all()
    for table in found.tables:
        at = int(np.argmin(np.abs(table.values - table.planned)))
        np.testing.assert_allclose(table.sigmas[0, at], found.sigmas.ravel(), rtol=1e-6)
    noise = next(table for table in found.tables if table.quantity == "image noise")
    assert (np.diff(noise.sigmas[0], axis=0) > 0.0).all()
    assert any("5 more control points" in change.change for change in found.improvements)


def test_attitudes_rebuilt_from_positions_do_not_suffer_from_them():
    given = plan()
    aimed = replace(given, noise=replace(given.noise, aim_point=given.pair.aim_point))
    found = predict_plan(aimed, tables=False)
    half = next(c for c in found.improvements if "position noise" in c.change)
    # to first order the errors of positions cancel
    np.testing.assert_allclose(half.ratio, 1.0, atol=0.02)
    independent = next(
        c for c in predict_plan(given, tables=False).improvements if "position noise" in c.change
    )
    assert independent.ratio.min() < 0.95
