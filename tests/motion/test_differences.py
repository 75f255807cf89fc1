"""AngleDifferences: what is accepted, and what is refused with which words."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.motion.differences import AngleDifferences

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
