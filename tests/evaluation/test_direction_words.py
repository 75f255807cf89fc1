"""Directions of attitude errors in words, and the score of an orientation."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.evaluation.direction_words import angle_names, direction_words
from sightline.evaluation.score_orientation import score_orientation
from sightline.geometry.units import ARCSEC


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ([0, 0, 1, 0, 0, 1], "yaw of both cameras together"),
        ([0, 0, -1, 0, 0, -1], "yaw of both cameras together"),
        ([1, 0, 0, -1, 0, 0.1], "roll of camera a against camera b"),
        ([0.1, 1, 0, 0, 0, 0], "pitch of camera a"),
        (
            [0.62, 0, -0.34, 0.62, 0, 0.34],
            "roll of both cameras together, with yaw of camera a against camera b",
        ),
        ([0, 1, 0, 0, 0.5, 0], "pitch of camera a (+1.00) and camera b (+0.50)"),
    ],
)
def test_directions_are_named_by_the_angles_that_turn(direction, words):
    assert direction_words(np.array(direction, dtype=float), ["a", "b"]) == words


def test_many_cameras():
    assert direction_words(np.tile([0.0, 1.0, 0.0], 3), "abc") == "pitch of all cameras together"
    assert angle_names(["x", "y"]) == ["roll_x", "pitch_x", "yaw_x", "roll_y", "pitch_y", "yaw_y"]


def test_the_score_uses_correlations():
    truth = np.zeros((1, 3))
    angles = np.array([[1.0, 1.0, 0.0]]) * ARCSEC
    covariance = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]]) * ARCSEC**2
    score = score_orientation(["1"], angles, np.full((1, 3), ARCSEC), truth, covariance)
    # (1, 1) by the inverse of [[1, .9], [.9, 1]]: 2 / 1.9
    assert score["nees"] == pytest.approx(2.0 / 1.9) and score["nees_independent"] == pytest.approx(2.0)
    assert score["rms_arcsec"] == pytest.approx(np.sqrt(2.0 / 3.0)) and score["coverage_95"] == 1.0


def test_angles_that_are_not_observable_are_left_out():
    angles, sigma = np.array([[np.nan, 2e-6, 1e-6]]), np.array([[np.inf, 1e-6, 1e-6]])
    covariance = np.full((3, 3), np.nan)
    covariance[1:, 1:] = np.eye(2) * 1e-12
    score = score_orientation(["1"], angles, sigma, np.zeros((1, 3)), covariance)
    assert score["not_observable"] == ["roll_1"] and score["expected"] == 2
    assert score["nees"] == pytest.approx(5.0) and score["coverage_95"] == 0.5
    with pytest.raises(InputError, match="no angle of the result is observable"):
        score_orientation(["1"], angles * np.nan, sigma, np.zeros((1, 3)))


def test_a_singular_covariance_is_reported():
    with pytest.raises(InputError, match="singular"):
        score_orientation(["1"], np.ones((1, 3)), np.ones((1, 3)), np.zeros((1, 3)), np.ones((3, 3)))
