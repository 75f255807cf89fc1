"""The search for the shift of two images: its parts by brute force, the whole over a known map."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from sightline.errors import EstimationError
from sightline.imaging.source import ArrayImage
from sightline.matching.coarse import _MASKED, _own_peaks, _surface, common_shift, learn_shifts


@pytest.mark.parametrize(
    "corner", [(14, 20), (1, 20), (30, 47)], ids=["inside", "first lines", "last corner"]
)
def test_a_template_is_compared_with_every_place_that_shows_enough_of_it(corner):
    rng = np.random.default_rng(2)
    image = rng.normal(size=(44, 60)).astype(np.float32)
    side, span = 9, 4
    template = image[15 : 15 + side, 22 : 22 + side] + 0.1 * rng.normal(size=(side, side)).astype(np.float32)
    bad = np.zeros(image.shape, dtype=bool)
    bad[16:19, 18:31] = bad[30:40, 50:52] = True
    bad[rng.random(bad.shape) < 0.02] = True
    expected = np.full((2 * span + 1, 2 * span + 1), np.nan)
    for i in range(2 * span + 1):
        for j in range(2 * span + 1):
            y, x = corner[0] - span + i, corner[1] - span + j
            if 0 <= y <= image.shape[0] - side and 0 <= x <= image.shape[1] - side:
                part = (slice(y, y + side), slice(x, x + side))
                if bad[part].sum() <= _MASKED * side**2:
                    expected[i, j] = np.corrcoef(template.ravel(), image[part].ravel())[0, 1]
    assert 0.05 < np.isnan(expected).mean() < 0.9
    found = _surface(template, image, bad, np.array(corner), span)
    # float32 of transforms of a few hundred numbers
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-5)


def test_each_window_has_its_own_highest_place_near_the_common_one():
    rng = np.random.default_rng(3)
    surfaces = rng.normal(size=(6, 15, 17)).astype(np.float32)
    surfaces[1, 6:9] = np.nan
    surfaces[5] = np.nan
    for place in ((8, 9), (1, 15), (14, 0)):
        expected = []
        for surface in surfaces:
            near = [
                (surface[i, j], i, j)
                for i in range(place[0] - 2, place[0] + 3)
                for j in range(place[1] - 2, place[1] + 3)
                if 0 <= i < 15 and 0 <= j < 17 and np.isfinite(surface[i, j])
            ]
            expected.append(max(near)[1:] if near else place)
        np.testing.assert_array_equal(_own_peaks(surfaces, np.array(place), near=2), expected)


@pytest.mark.parametrize("reach", [0.0, 60.0])
def test_a_shift_that_grows_over_the_image_is_learnt_from_coarse_to_fine(reach):
    """One texture seen twice, the second moved and stretched by a smooth map."""
    rng = np.random.default_rng(4)
    texture = gaussian_filter(rng.normal(size=(420, 460)), 1.5)
    line, column = np.mgrid[0.0:360.0, 0.0:400.0]
    stretch = np.array([[0.004, -0.006], [0.008, 0.003]])
    start = np.array([24.0, -18.0])

    def seen(points):  # where a point of the first lies in the second
        return points + start + points @ stretch.T

    first = texture[30:390, 30:430]
    at = np.stack([line, column], axis=-1)
    back = (at - start) @ np.linalg.inv(np.eye(2) + stretch).T
    second = map_coordinates(texture, 30.0 + back.transpose(2, 0, 1), order=3, mode="nearest")
    near = (23.0, -17.0) if reach == 0.0 else (0.0, 0.0)
    found = learn_shifts(
        ArrayImage(first.astype(np.float32)), ArrayImage(second.astype(np.float32)), near, reach=reach
    )
    points = np.stack(np.meshgrid([60.0, 180.0, 290.0], [60.0, 200.0, 340.0], indexing="ij"), axis=-1)
    points = points.reshape(-1, 2)
    # windows of 32 px, of a texture without noise
    np.testing.assert_allclose(found.at(points), seen(points) - points, atol=0.05)
    assert found.spread.max() < 0.05 and found.agreeing > 0.8 * found.tried > 50
    assert (found.common is None) == (reach == 0.0)
    if found.common is not None:
        middle = np.array([180.0, 200.0])
        assert found.common.believed and found.common.by_chance < 1e-6
        # whole pixels of the reduced images, about the middle of what both show
        assert np.abs(found.common.shift - (seen(middle) - middle)).max() <= 2.0 * found.common.factor
        own = found.common.values - (seen(found.common.points) - found.common.points)
        assert np.median(np.abs(own)) <= 0.75 * found.common.factor


def test_images_of_nothing_in_common_are_not_believed():
    rng = np.random.default_rng(5)
    a, b = (ArrayImage(gaussian_filter(rng.normal(size=(200, 220)), 1.5).astype(np.float32)) for _ in "ab")
    assert common_shift(a, b, reach=20.0).by_chance > 1e-3
    with pytest.raises(EstimationError, match="do not show the same within 20 px"):
        learn_shifts(a, b, reach=20.0)
