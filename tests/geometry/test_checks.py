"""Arguments: what is accepted, and what the refusals say."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.geometry.checks import (
    as_pixels,
    as_points,
    as_times,
    as_vector,
    finite,
    frozen,
    not_negative,
    positive,
    read_only,
    same_length,
)


def test_the_error_of_swapped_axes_says_how_to_be_right():
    with pytest.raises(
        InputError,
        match=r"`pixels` must have shape \(N, 2\) as \(line, column\), got \(2, 500\); did you mean pixels.T",
    ):
        as_pixels(np.zeros((2, 500)))


def test_one_point_may_be_given_without_its_row():
    assert as_points([1.0, 2.0, 3.0]).shape == (1, 3)


def test_a_nan_row_is_a_missing_point_but_an_infinity_is_a_mistake():
    assert np.isnan(as_points([[np.nan, 0.0, 0.0]])).any()
    with pytest.raises(InputError, match=r"`points` must be finite, or NaN where unknown: row 1"):
        as_points([[0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]])


def test_words_are_not_numbers():
    with pytest.raises(InputError, match="must be numbers of shape"):
        as_points([["a", "b", "c"]])


@pytest.mark.parametrize(
    ("t", "message"),
    [
        ([0.0, 1.0, 1.0], r"1 s \(element 2\) comes twice, after 1 s; sort the rows and drop repeated"),
        ([0.0, 2.0, 1.0], r"1 s \(element 2\) comes out of order, after 2 s"),
        ([0.0, np.nan], r"element 1 is nan; remove that row"),
        ([[0.0], [1.0]], r"must have shape \(N,\) in seconds, got \(2, 1\)"),
    ],
)
def test_times_out_of_order_repeated_or_missing_are_named(t, message):
    with pytest.raises(InputError, match=message):
        as_times(t, increasing=True)


def test_what_is_checked_cannot_be_changed_and_the_original_still_can():
    original = np.zeros((2, 3))
    checked, kept = as_points(original), frozen(original)
    with pytest.raises(ValueError, match="read-only"):
        checked[0, 0] = 1.0
    original[0, 0] = 5.0
    assert kept[0, 0] == 0.0


def test_a_frozen_array_is_not_copied_again_but_a_read_only_view_of_another_is():
    first = frozen(np.arange(3.0))
    assert frozen(first) is first
    source = np.arange(3.0)
    view = read_only(source)
    kept = frozen(view)
    source[0] = 9.0
    assert kept[0] == 0.0


def test_scalars_and_lengths_are_checked():
    assert positive(2, "x") == 2.0 and finite(-1.0, "x") == -1.0
    with pytest.raises(InputError, match=r"`line_period` must be positive \(s\), got 0"):
        positive(0.0, "line_period", "s")
    assert not_negative(0, "x") == 0.0
    for wrong in (-1e-9, np.nan, np.inf):
        with pytest.raises(InputError, match=rf"`sigma` must be 0 or more \(m\), got {wrong!r}"):
            not_negative(wrong, "sigma", "m")
    with pytest.raises(InputError, match=r"`height` must be finite \(m\), got nan"):
        finite(np.nan, "height", "m")
    with pytest.raises(InputError, match="`axis` must be 3 finite numbers"):
        as_vector([1.0, 2.0], "axis")
    with pytest.raises(InputError, match="as many rows, got 1 and 2"):
        same_length(np.zeros(1), "a", np.zeros(2), "b")
