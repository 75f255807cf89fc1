"""Which windows of a grid are taken, on images made of a strong and a weak half."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.source import ArrayImage
from sightline.matching.select import Selection, chosen_windows, grid_points
from sightline.matching.whitening import gradient_filter

SHAPE, WINDOW = (200, 400), (10, 50)


@pytest.fixture(scope="module")
def scene():
    """Noise ten times stronger on the right, and no texture at all in the first forty lines."""
    image = np.random.default_rng(0).normal(100.0, 1.0, SHAPE)
    image[:, 200:] = 100.0 + 10.0 * (image[:, 200:] - 100.0)
    image[:40] = 100.0
    return ArrayImage(image), grid_points(SHAPE, window=WINDOW)


def within(centres):
    """Windows with texture that do not touch the border, where no gradient can be taken."""
    return (centres[:, 0] > 45) & (centres[:, 0] < 190) & (centres[:, 1] > 30) & (centres[:, 1] < 370)


def take(scene, **options):
    image, centres = scene
    return centres, chosen_windows(image, 0, centres, WINDOW, Selection(**options))


def test_by_default_every_window_is_taken(scene):
    _, chosen = take(scene)
    assert chosen.all()


def test_textured_takes_what_reaches_the_median_and_never_what_has_none(scene):
    centres, chosen = take(scene, way="textured")
    # beside the border a window sees its edge
    assert not chosen[centres[:, 0] < 30].any()
    left, right = centres[:, 1] < 150, centres[:, 1] > 200
    # of the windows with texture half are ten times stronger: the median is that of a weak one of these
    assert chosen[right & within(centres)].mean() > 0.7
    assert not chosen[left].any()


def test_a_lower_strength_takes_the_weak_half_too(scene):
    centres, chosen = take(scene, way="textured", strength=1e-3)
    assert chosen[within(centres)].all()


def test_spread_takes_so_many_over_the_whole_image(scene):
    centres, chosen = take(scene, way="spread", points=40)
    assert chosen.sum() == 40
    # 3 x 6 cells give two windows each, weak or strong; the last four go to the strongest
    assert (centres[chosen, 1] < 200).sum() >= 16


def test_listed_takes_the_windows_that_hold_a_feature(scene):
    features = {0: np.array([[72.0, 130.0], [100.0, 350.0]]), 1: np.array([[5.0, 5.0]])}
    centres, chosen = take(scene, way="listed", features=features)
    for feature in features[0]:
        assert (np.abs(centres[chosen] - feature) <= [5.0, 25.0]).all(axis=1).any()
    assert 2 <= chosen.sum() <= 4  # a feature on the border of two windows takes both


@pytest.mark.parametrize(
    ("options", "words"), [({"way": "best"}, "allowed are all, textured"), ({"way": "listed"}, "no features")]
)
def test_what_cannot_be_chosen_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        Selection(**options)


def test_the_gradient_filter_is_blind_to_brightness_and_grows_with_frequency():
    response = np.abs(gradient_filter().response())
    assert response[0, 0] < 1e-6 * response.max()
    assert response[2, 0] < response[5, 0] < response[10, 0]
