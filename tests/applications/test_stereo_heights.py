"""Heights before and after: against the true ground of a simulated pass, sigmas against the errors."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.stereo_heights import height_sigmas, heights_of, stereo_heights
from sightline.applications.stereo_orientation import orient
from sightline.errors import InputError
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.simulate.stereo import stereo_case

CASE = {"shots": 24, "points": 60, "window": 48.0}


def solved(**given):
    scenario = stereo_case("A_paper_T6_K64", 5, **(CASE | given))
    problem = StereoProblem(**scenario.problem())
    true = heights_of(scenario.points[problem.point_names.astype(int)], problem.radii)
    return problem, orient(problem), true


def test_noise_free_heights_are_true_after_and_trend_before():
    # 1e-4 of the noise: a mm or so of height
    problem, found, true = solved(noise_scale=1e-4)
    heights = stereo_heights(problem, found, true)
    np.testing.assert_allclose(heights.after, true, atol=0.05)
    np.testing.assert_allclose(heights.shot_after, 0.0, atol=0.05)
    # pitches of opposite signs of 36 arcsec each: the rays meet some 200 m off (prototype: 207-242 m)
    assert ((np.abs(heights.shot_before) > 150.0) & (np.abs(heights.shot_before) < 300.0)).all()
    np.testing.assert_allclose(np.abs(heights.before - true), 218.0, rtol=0.2)
    np.testing.assert_array_equal(heights.shot, np.arange(24))
    np.testing.assert_allclose(np.diff(heights.t), 2.0)


def test_sigma_is_that_of_the_errors_and_shots_scatter_as_their_noise():
    squares, scatter = [], []
    for seed in range(6):
        scenario = stereo_case("A_paper_T6_K64", seed, **CASE)
        problem = StereoProblem(**scenario.problem())
        true = heights_of(scenario.points[problem.point_names.astype(int)], problem.radii)
        heights = stereo_heights(problem, orient(problem), true)
        squares.append(np.mean(((heights.after - true) / heights.sigma) ** 2))
        scatter.append(heights.scatter_after)
    # errors of the points of a pass go together: one or two independent numbers per pass
    assert 0.2 < np.mean(squares) < 2.5
    # prototype: 14 m at a point, from positions of 7.5 m and jitter of 1.8 arcsec
    assert np.mean(scatter) == pytest.approx(14.0, rel=0.15)


def test_heights_need_no_truth_and_stay_unknown_where_angles_are():
    problem, found, _ = solved()
    heights = stereo_heights(problem, found)
    assert abs(np.mean(heights.shot_after)) < 5.0 < np.abs(np.mean(heights.shot_before))
    one = stereo_case("A_paper_T6_K64", 0, shots=1)
    problem = StereoProblem(**one.problem())
    heights = stereo_heights(problem, orient(problem))
    assert np.isnan(heights.after).all() and np.isfinite(heights.before).all()
    assert np.isnan(heights.shot_after).all() and len(heights.shot) == 1
    assert np.isnan(heights.scatter_after)


def test_heights_of_a_flat_world_are_z():
    points = np.array([[1.0, 2.0, 3.0], [np.nan, np.nan, np.nan]])
    covariance = np.stack([np.diag([1.0, 4.0, 9.0]), np.full((3, 3), np.nan)])
    np.testing.assert_array_equal(heights_of(points, None), [3.0, np.nan])
    np.testing.assert_array_equal(height_sigmas(points, covariance, None), [3.0, np.nan])
    pole = np.array([[0.0, 0.0, 6371e3], [np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(height_sigmas(pole, covariance, (6371e3, 6371e3)), [3.0, np.nan])


def test_a_reference_of_another_length_is_refused():
    problem, found, true = solved()
    with pytest.raises(InputError, match="reference"):
        stereo_heights(problem, found, true[:-1])
