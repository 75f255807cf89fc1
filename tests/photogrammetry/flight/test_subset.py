"""The subset of a sequence: wanted overlap, parallax, sharpness, and the reason of each choice."""

from __future__ import annotations

import numpy as np
import pytest
from tests.photogrammetry.steady_flight import steady

from sightline.errors import InputError
from sightline.photogrammetry.flight.subset import (
    Subset,
    _relative_sharpness,
    chained,
    choose_subset,
    motion_overlap,
)

SHAPE = (200, 300)


def chosen(followed, *, base: float = 2.0, **options) -> Subset:
    """At 100 m; `base` m from frame to frame."""
    count = len(followed.before)
    position = np.column_stack([np.zeros(count), base * np.arange(count), np.full(count, 100.0)])
    return choose_subset(followed, position, np.full(count, 100.0), SHAPE, **options)


def test_overlap_of_a_motion_is_the_area_that_stays():
    # to the width of a cell of the 32 x 32 places
    assert motion_overlap(np.array([50.0, 75.0, 0.0, 0.0]), SHAPE) == pytest.approx(0.75**2, abs=0.04)
    assert motion_overlap(np.zeros(4), SHAPE) == 1.0
    assert motion_overlap(np.array([210.0, 0.0, 0.0, 0.0]), SHAPE) == 0.0
    # a quarter turn leaves a square of the shorter side: 200 of 300 columns
    assert motion_overlap(np.array([0.0, 0.0, np.pi / 2.0, 0.0]), SHAPE) == pytest.approx(2 / 3, abs=0.05)


def test_motions_follow_each_other():
    turn = chained(np.array([10.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, np.pi / 2.0, 0.0]))
    np.testing.assert_allclose(turn, [0.0, 10.0, np.pi / 2.0, 0.0], atol=1e-12)
    grown = chained(np.array([10.0, 0.0, 0.1, 0.0]), np.array([1.0, 2.0, 0.0, 0.5]))
    np.testing.assert_allclose(grown, [16.0, 2.0, 0.1, 0.5], atol=1e-12)


@pytest.mark.parametrize(("overlap", "each"), [(0.8, 10), (0.9, 5), (0.6, 20)])
def test_frames_are_as_far_apart_as_wanted(overlap, each):
    subset = chosen(steady(41, 4.0), overlap=overlap)
    # 4 of 200 lines a frame: 2 %; overlaps within 3 % of the wanted one are as good
    steps = np.diff(subset.frames)
    assert subset.frames[0] == 0 and subset.frames[-1] == 40
    assert np.abs(steps[:-1] - each).max(initial=0) <= 2
    np.testing.assert_allclose(subset.overlap[1:], 1.0 - 0.02 * steps, atol=0.035)
    np.testing.assert_allclose(subset.parallax[1:], 2.0 * np.arctan(0.01 * steps), rtol=1e-9)
    assert subset.reason[0] == "first of its stretch"
    assert all("overlap" in reason for reason in subset.reason[1:])
    assert subset.reason[-1].startswith("last of its stretch") or "wanted" in subset.reason[-1]


def test_blurred_frames_are_passed_over_and_it_is_said():
    sharp = np.ones(41)
    sharp[10] = 0.3
    subset = chosen(steady(41, 4.0, sharpness=sharp))
    assert 10 not in subset.frames and "1 blurred passed over" in subset.reason[1]
    sharp[:] = 1.0
    sharp[0] = 0.3
    first = chosen(steady(41, 4.0, sharpness=sharp))
    assert first.frames[0] == 1 and first.reason[0] == "first sharp frame of its stretch"


def test_a_blurred_frame_is_taken_where_there_is_no_other():
    sharp = np.ones(81)
    sharp[8:13] = 0.3  # all that overlap as wanted; their neighbours to both sides are sharp
    subset = chosen(steady(81, 4.0, sharpness=sharp))
    assert 8 <= subset.frames[1] <= 12
    assert subset.reason[1].endswith("blurred, but there is no other")


def test_more_parallax_is_bought_with_overlap():
    # 0.15 m a frame at 100 m: 10 frames make 0.015 rad, less than the 0.02 that tell depth; 14 make 0.021
    subset = chosen(steady(61, 4.0), base=0.15)
    assert subset.frames[1] == 14
    assert subset.reason[1].endswith("nearer ones have too little parallax")


def test_every_stretch_has_a_subset_of_its_own():
    subset = chosen(steady(60, 4.0, breaks=(30,)))
    assert subset.reason.count("first of its stretch") == 2
    assert {0, 29, 30, 59} <= set(subset.frames.tolist())
    assert np.flatnonzero(np.isnan(subset.overlap)).tolist() == [
        0, subset.frames.tolist().index(30)
    ]  # fmt: skip


def test_a_stride_takes_every_so_many():
    subset = chosen(steady(41, 4.0, sharpness=np.linspace(0.1, 2.0, 41)), stride=7)
    assert subset.frames.tolist() == list(range(0, 41, 7))
    assert set(subset.reason) == {"every 7 frames"}


def test_overlap_must_make_sense():
    with pytest.raises(InputError, match="overlap"):
        chosen(steady(5, 4.0), overlap=1.0)


def test_sharpness_is_judged_by_the_frame_itself_and_eight_to_either_side():
    sharpness = np.random.default_rng(4).uniform(0.2, 3.0, 60)
    sharpness[[5, 6, 30]] = np.nan
    sharpness[40:] = np.nan  # of the last ones none is known
    found = _relative_sharpness(sharpness)
    for k in range(60):
        known = [one for j, one in enumerate(sharpness) if abs(j - k) <= 8 and np.isfinite(one)]
        expected = sharpness[k] / np.median(known) if known else np.nan
        assert found[k] == pytest.approx(expected, rel=1e-12, nan_ok=True)
