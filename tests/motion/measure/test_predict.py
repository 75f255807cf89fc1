"""Predicted partners and their sensitivities against the geometry of level flight, worked out by hand."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from motion.strips import ALTITUDE, IFOV, PERIOD, SPEED, moved_by_turn, sampled_motion, strip_cameras
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Plane
from sightline.matching.matches import Matches
from sightline.motion.measure.predict import residuals, sensitivities, turned

AHEAD = (400.0, -200.0)
PIXELS = np.array([[0.0, 0.0], [100.0, 159.5], [300.25, 31.5], [350.0, 319.0]])
# positions close to 1e-9 px (what the camera's iteration promises) at both ends of a central difference over
# 1e-6 rad are 2e-3 px/rad; ten times that
BY_ANGLE = 0.02


def cameras(**options):
    return strip_cameras(AHEAD, lines=1000, **options)


def test_level_flight_moves_the_partner_by_the_difference_of_the_looks_ahead():
    first, second = cameras()
    found = predict_match(first, second, Plane(), PIXELS)
    assert_allclose(found, PIXELS + np.array([AHEAD[0] - AHEAD[1], 0.0]), atol=1e-6)


def test_ground_that_the_partner_never_sees_has_no_prediction():
    first, second = cameras()
    # line 500 is seen 600 lines later, beyond the last line of 1000
    assert np.isnan(predict_match(first, second, Plane(), np.array([[500.0, 10.0]]))).all()


def test_residuals_are_measured_minus_predicted():
    b = np.array([[3.0, 4.0], [np.nan, np.nan]])
    matches = Matches(np.zeros((2, 2)), b, np.tile(np.eye(2), (2, 1, 1)), np.ones(2), np.array([0, 6]))
    got = residuals(matches, np.array([[2.5, 4.25], [1.0, 1.0]]))
    assert_allclose(got, [[0.5, -0.25], [np.nan, np.nan]])


def test_a_turn_adds_to_the_motion_that_is_there():
    rolled = sampled_motion(roll=lambda t: 0.01 + 0.0 * t)
    camera = turned(cameras(motion=rolled)[0], np.array([0.02, 0.0, 0.0]))
    flat = turned(cameras()[0], np.array([0.03, 0.0, 0.0]))
    # a roll to the right lifts the left side: the middle of the line looks left, to the west, by H tan(roll)
    middle = np.array([[100.0, 159.5]])
    west = -ALTITUDE * np.tan(0.03)
    assert_allclose(camera.locate(middle, Plane())[:, 0], west, rtol=1e-9)
    assert_allclose(camera.locate(middle, Plane()), flat.locate(middle, Plane()), atol=1e-6)


def test_the_partner_moves_against_the_turn_of_its_own_body():
    by = sensitivities(cameras(), 0, 1, Plane(), PIXELS)
    assert_allclose(by.angles_b, moved_by_turn(PIXELS, AHEAD[1]), atol=BY_ANGLE)
    # in words: roll takes 1/ifov columns, pitch 1/ifov lines, yaw lines in proportion to the field angle
    assert_allclose(by.angles_b[:, 1, 0], -1 / IFOV, rtol=1e-5)
    assert_allclose(by.angles_b[:, 0, 1], -1 / IFOV, rtol=1e-5)
    assert_allclose(by.angles_b[:, 0, 2], 159.5 - PIXELS[:, 1], atol=BY_ANGLE)


def test_jitter_modulates_how_many_lines_a_radian_of_pitch_is():
    # phi + pitch(t) = (X - V t) / H: dt / dpitch = -1 / (V / H + pitch'), V / H = IFOV / PERIOD. 0.3 px at
    # 100 Hz make 9 % of it; differences over four lines, 0.6 rad of its phase each way, would lose 6 % of
    # those, 0.6 % in all. Cubic interpolation at 20 samples a period bends pitch' by 3e-4, 3e-5 in all.
    size, f = 0.3 * IFOV, 2 * np.pi * 100.0
    shaken = cameras(motion=sampled_motion(pitch=lambda t: size * np.sin(f * t)))
    by = sensitivities(shaken, 0, 1, Plane(), PIXELS)
    t = PERIOD * predict_match(*shaken, Plane(), PIXELS)[:, 0]
    expected = -1.0 / (IFOV + PERIOD * size * f * np.cos(f * t))
    assert np.ptp(expected) > 0.05 / IFOV
    assert_allclose(by.angles_b[:, 0, 1], expected, rtol=5e-4)


def test_a_turn_of_the_hub_moves_the_partner_the_other_way():
    by = sensitivities(cameras(), 0, 1, Plane(), PIXELS)
    assert_allclose(by.angles_a, -moved_by_turn(PIXELS, AHEAD[0]), atol=BY_ANGLE)


def test_higher_ground_is_seen_earlier_by_height_times_lag_times_speed_over_distance_squared():
    by = sensitivities(cameras(), 0, 1, Plane(), PIXELS)
    lag = (AHEAD[0] - AHEAD[1]) * PERIOD
    # 1e-6 px of each of two positions over 20 m
    assert_allclose(by.height[:, 0], -lag * SPEED / (ALTITUDE**2 * IFOV), atol=1e-7)
    assert_allclose(by.height[:, 1], 0.0, atol=1e-7)


def test_windows_without_a_partner_have_no_sensitivities():
    by = sensitivities(cameras(), 0, 1, Plane(), np.array([[700.0, 10.0]]))
    assert np.isnan(by.angles_a).all() and np.isnan(by.angles_b).all() and np.isnan(by.height).all()
    assert by.statics.shape == (1, 2, 0)
