"""Layouts of a focal plane: ranked, named, honest about what was asked and what was not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.applications.focal_plane import (
    BEST,
    FULL_SPAN,
    LEAST_SIGMA,
    FocalPlane,
    NamedLayout,
    choose_layout,
)
from sightline.errors import InputError
from sightline.estimation.prior import Matern, Spectrum

PRIOR = Spectrum((Matern(1.0, 0.5, "5/2"), Matern(0.1, 0.01, "3/2")))
PLANE = FocalPlane(
    2e5, 1e-3, 1000.0, (0.02,) * 3, span_px=60.0, prior=PRIOR, duration=1.0,
    layouts=(NamedLayout("ours", np.array([0.0, 0.02, 0.05])),),
)  # fmt: skip
BAND = (40.0, 150.0)


@pytest.fixture(scope="module")
def choice():
    return choose_layout(PLANE, BAND, count=4)


def test_layouts_are_ranked_by_their_worst_case_and_apart_from_each_other(choice):
    worst = [layout.worst_information for layout in choice.ranked]
    assert worst == sorted(worst, reverse=True) and choice.exhaustive
    assert choice.best.name == BEST and choice.best is choice.ranked[0]
    same = 0.25 / BAND[1]
    for k, one in enumerate(choice.ranked):
        assert one.positions[0] == 0.0 and one.span <= 0.060 * (1.0 + 1e-9)
        assert np.diff(one.positions).min() >= 1e-3 * (1.0 - 1e-9)
        for other in choice.ranked[k + 1 :]:
            assert np.abs(one.positions - other.positions).max() >= same


def test_each_is_as_good_as_the_cosines_of_its_lags_say(choice):
    f = np.arange(*BAND, 0.005)
    for layout in (*choice.ranked, *choice.compared):
        t = layout.positions
        lags = np.abs(t[:, None] - t)[np.triu_indices(len(t), 1)]
        worth = len(t) - 1.0 - 2.0 / len(t) * np.cos(2.0 * np.pi * f[:, None] * lags).sum(axis=1)
        assert layout.worst_images == pytest.approx(worth.min(), rel=1e-3, abs=1e-4)
        assert layout.worst_information == pytest.approx(layout.worst_images / 0.02**2)


def test_the_full_span_is_filled_and_the_least_sigma_is_least(choice):
    by_name = {layout.name: layout for layout in choice.ranked}
    assert by_name[FULL_SPAN].span == pytest.approx(0.060)
    least = by_name[LEAST_SIGMA]
    assert all(least.harmonic_sigma_px <= other.harmonic_sigma_px * 1.001 for other in choice.ranked)
    assert all(layout.band_sigma_px < layout.harmonic_sigma_px for layout in choice.ranked)


def test_own_and_published_layouts_are_judged_alike(choice):
    assert [layout.name for layout in choice.compared] == ["ours", "S1, fig. 13", "ZY-3", "ASTER SWIR"]
    ours, aster = choice.compared[0], choice.compared[3]
    assert ours.source == "yours" and choice.best.worst_images > 10.0 * ours.worst_images
    # six lines 0.356 s apart are blind at every multiple of 2.81 Hz
    assert aster.blind_in_band and aster.blind[0].frequency == pytest.approx(1.0 / 0.356, rel=1e-4)


def test_places_held_to_a_step_stay_on_it_and_lose_little(choice):
    held = choose_layout(replace(PLANE, step_px=0.5), BAND, count=1).best
    assert np.allclose(held.positions * 2000.0, np.rint(held.positions * 2000.0))
    # half a step, 0.25 ms, is 1/27 of a period of 150 Hz: the cosine of that is 0.97
    assert 0.9 * choice.best.worst_images < held.worst_images <= choice.best.worst_images * (1.0 + 1e-9)


def test_lines_of_one_detector_are_chosen_from_those_there_are():
    lines = np.array([0.0, 1.0, 2.0, 5.0, 11.0, 12.0, 30.0, 47.0])
    best = choose_layout(replace(PLANE, lines=lines, span_px=47.0), BAND, count=1).best
    assert set(np.round(1000.0 * best.positions, 6)) <= set(lines)


def test_the_noisy_image_does_not_stand_where_it_matters_most():
    choice = choose_layout(replace(PLANE, image_sigma_px=(0.08, 0.02, 0.02)), BAND, count=1)
    order = choice.best.order
    assert sorted(order) == [0, 1, 2] and choice.best.noise.sigma_px[order.index(0)] == 0.08


def test_without_a_prior_it_says_what_it_took():
    choice = choose_layout(replace(PLANE, prior=None, duration=None), BAND, count=1)
    assert any("no prior of the motion is given" in warning for warning in choice.warnings)
    assert choice.duration == 2.0 and choice.prior.sigma == pytest.approx(np.hypot(2.0, 0.1))


def test_a_search_that_is_not_exhaustive_says_so():
    choice = choose_layout(PLANE, BAND, count=1, exhaustive=False)
    assert not choice.exhaustive and any("too many to go through" in said for said in choice.warnings)


@pytest.mark.parametrize(
    ("change", "band", "message"),
    [
        ({}, (150.0, 40.0), "must rise"),
        ({"step_lines": 5.0}, BAND, "sample motion up to 100 Hz"),
        ({"window_lines": 8.0}, (10.0, 62.0), None),
        ({"span_px": 1.0}, BAND, "do not fit"),
        ({"span_px": 8000.0}, BAND, "1200 periods of 150 Hz long, the search holds 500"),
        ({"lines": np.arange(200_000.0), "span_px": 199_999.0}, BAND, "more than the search can hold"),
    ],
)
def test_what_cannot_be_placed_is_refused(change, band, message):
    plane = replace(PLANE, **change)
    if message is None:  # a window of 8 ms sees up to 125 Hz, rows of one line up to 500 Hz
        assert choose_layout(plane, band, count=1).best.worst_images > 0.1
        with pytest.raises(InputError, match="average motion away at 125 Hz"):
            choose_layout(plane, (10.0, 130.0))
        return
    with pytest.raises(InputError, match=message):
        choose_layout(plane, band)


def test_no_layout_is_listed_twice_nor_its_mirror():
    # the search of many starts meets a layout and its mirror
    plane = replace(PLANE, image_sigma_px=(0.02,) * 4, span_px=30.0, layouts=())
    ranked = choose_layout(plane, BAND, count=6, exhaustive=False).ranked
    for k, one in enumerate(ranked):
        for other in ranked[k + 1 :]:
            mirrored = other.positions[-1] - other.positions[::-1]
            apart = min(np.abs(one.positions - p).max() for p in (other.positions, mirrored))
            assert apart >= 0.25 / BAND[1]
