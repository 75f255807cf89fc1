"""AngleDifferences: what is accepted, and what is refused with which words."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.motion.estimators.differences import AngleDifferences, by_pair

T = np.array([0.0, 0.1, 0.2])
ANGLES = np.zeros((3, 3))
COVARIANCE = np.tile(np.eye(3), (3, 1, 1))


def test_one_lag_serves_all_differences_and_the_arrays_are_frozen() -> None:
    pair = AngleDifferences(T, 0.05, ANGLES, COVARIANCE, images=(2, 5), patch=[7, 8, 9])
    assert len(pair) == 3
    np.testing.assert_array_equal(pair.lag, np.full(3, 0.05))
    for array in (pair.t, pair.lag, pair.angles, pair.covariance, pair.patch):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_a_negative_lag_means_that_image_b_was_taken_first() -> None:
    assert (AngleDifferences(T, -0.05, ANGLES, COVARIANCE).lag < 0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lag": np.zeros(3)}, "`lag` must be finite and not zero"),
        ({"lag": np.array([0.1, np.nan, 0.1])}, "`lag` must be finite and not zero"),
        ({"t": T[::-1]}, "must not decrease"),
        ({"angles": ANGLES[:2]}, "must have as many rows"),
        ({"covariance": np.eye(3)}, r"`covariance` must have shape \(3, 3, 3\)"),
        ({"window": -1.0}, "`window` must be a time of 0 s or more"),
        ({"patch": np.arange(2)}, "`patch` must hold one number per difference"),
    ],
)
def test_bad_input_is_named(change: dict[str, object], words: str) -> None:
    good = {"t": T, "lag": np.full(3, 0.1), "angles": ANGLES, "covariance": COVARIANCE}
    with pytest.raises(InputError, match=words):
        AngleDifferences(**{**good, **change})  # type: ignore[arg-type]


def test_a_pair_taken_both_ways_is_one_set_in_order_of_time() -> None:
    there = AngleDifferences(T, 0.05, ANGLES + 1.0, COVARIANCE, (2, 5), 0.01, np.arange(3))
    # image 5 at t + lag = 0.12 first, then image 2 at 0.07
    back = AngleDifferences([0.12], -0.05, [[-2.0, -3.0, -4.0]], COVARIANCE[:1], (5, 2), 0.01, [9])
    (one,) = by_pair([there, back])
    assert one.images == (2, 5) and one.window == 0.01
    np.testing.assert_allclose(one.t, [0.0, 0.07, 0.1, 0.2])
    np.testing.assert_allclose(one.lag, 0.05)
    np.testing.assert_allclose(one.angles[1], [2.0, 3.0, 4.0])
    assert one.patch is not None and one.patch.tolist() == [0, 9, 1, 2]


def test_differences_that_do_not_show_an_axis_are_left_out_and_so_is_a_pair_of_none() -> None:
    covariance = np.tile(np.eye(3), (5, 1, 1))
    covariance[1, 2, 2] = np.inf
    covariance[3, 0, 0] = 101.0
    pair = AngleDifferences(np.arange(5.0), 0.5, np.zeros((5, 3)), covariance)
    blind = AngleDifferences(T, 0.05, ANGLES, np.tile(np.diag([1.0, 1.0, np.inf]), (3, 1, 1)), (1, 2))
    (one,) = by_pair([pair, blind])
    np.testing.assert_array_equal(one.t, [0.0, 2.0, 4.0])


def test_turned_about_another_axis_roll_becomes_yaw_and_keeps_its_sigma() -> None:
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # z of the new axes is the old x
    pair = AngleDifferences(
        T, 0.05, ANGLES + np.array([1.0, 2.0, 3.0]), np.tile(np.diag([1.0, 4.0, 9.0]), (3, 1, 1))
    )
    np.testing.assert_allclose(pair.turned(turn).angles[0], [-3.0, 2.0, 1.0])
    np.testing.assert_allclose(pair.turned(turn).sigma()[0], [3.0, 2.0, 1.0])
