"""Parts of the search for the shift of two images, by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.matching.coarse import _MASKED, _surface


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
