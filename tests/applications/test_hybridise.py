"""Pairs one after the other and all at once: the same motion within its sigma, for any number of bands."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import InputError
from sightline.evaluation.score import remove_directions
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Plane
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case

LAGS = (0.0, 0.0513, 0.0222, 0.0351, 0.0937, 0.0740)


def strip(count, weak=None, size=(500, 200)):
    """A short strip of so many bands, the last of another coherence."""
    coherence = (1.0,) + (0.97,) * (count - 1)
    scenario = line_of_sight_case(
        "nominal", 2, lines=size[0], columns=size[1], names=tuple("ABCDEF"[:count]), lags=LAGS[:count],
        gains=(1.0,) * count, gammas=(1.0,) * count,
        coherence_with_first=(*coherence[:-1], weak or coherence[-1]),
    )  # fmt: skip
    bands = scenario.as_given()
    return scenario, bands


def recovered(bands, hybridise):
    return recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(hybridise=hybridise, passes=1))


def test_both_ways_give_the_same_motion_within_its_sigma():
    _, bands = strip(3, size=(320, 160))
    one, other = (recovered(bands, how) for how in ("global", "iterative"))
    apart = (one.motion.angles - other.motion.angles) / one.scale
    apart = remove_directions(apart, one.hidden / one.scale[:, None])
    sigma = one.sigma / one.scale
    assert (np.sqrt((apart**2).mean(axis=0)) < np.sqrt((sigma**2).mean(axis=0))).all()
    assert len(other.cameras) == 3 and other.image_names == one.image_names


def test_groups_that_are_not_matched_with_each_other_are_begun_one_after_the_other():
    _, bands = strip(4, size=(320, 160))
    pairs = (("A", "C"), ("B", "D"))
    options = RecoverOptions(hybridise="iterative", pairs=pairs, passes=1)
    result = recover_line_of_sight(bands, Plane(0.0), options=options)
    assert {frozenset(pair.images) for pair in result.pairs} == {frozenset((0, 2)), frozenset((1, 3))}
    assert all(pair.kept > 0.5 * pair.tried for pair in result.pairs)


def test_two_bands_have_one_pair_and_one_answer():
    _, bands = strip(2, size=(320, 160))
    options = (RecoverOptions(hybridise=how, passes=1) for how in ("global", "iterative"))
    one, other = (recover_line_of_sight(bands, Plane(0.0), options=given) for given in options)
    np.testing.assert_array_equal(one.motion.angles, other.motion.angles)


def test_a_weak_band_is_placed_by_the_motion_of_the_others():
    """Of a band that correlates by 0.4 single windows are good to 0.12 px along and across; its map, by the
    motion of the others and its offset from all lines, is good to a third of that even on a short strip."""
    scenario, bands = strip(3, weak=0.4, size=(600, 300))
    result = recovered(bands, "iterative")
    lines, columns = np.arange(20.0, 500.0, 5.0), np.linspace(5.0, 294.0, 9)
    points = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    found = predict_match(result.cameras[0], result.cameras[2], Plane(0.0), points)
    error = found - predict_match(scenario.cameras[0], scenario.cameras[2], Plane(0.0), points)
    assert np.sqrt(np.nanmean(error**2, axis=0)).max() < 0.04


def test_an_unknown_word_is_refused():
    with pytest.raises(InputError, match=r"'both'; allowed are global, iterative"):
        RecoverOptions(hybridise="both")
