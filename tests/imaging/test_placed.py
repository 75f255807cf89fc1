"""Where pixels of a placed image lie."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.transform import Affine, xy

from sightline.errors import InputError
from sightline.imaging.placed import PlacedImage
from sightline.imaging.source import ArrayImage

TURNED = Affine(0.47, 0.27, 5e5, 0.17, -0.75, 4e6)


def test_pixels_lie_where_rasterio_has_them_and_are_found_again():
    image = PlacedImage(ArrayImage(np.zeros((20, 30))), tuple(TURNED)[:6], "EPSG:32632")
    pixels = np.array([[0.0, 0.0], [19.0, 0.0], [3.25, 28.5], [-4.0, 40.0]])
    expected = np.column_stack(xy(TURNED, pixels[:, 0], pixels[:, 1]))
    np.testing.assert_allclose(image.places(pixels), expected, rtol=0.0, atol=1e-8)
    # places of 4e6 m in float64, over the half metre of a pixel
    np.testing.assert_allclose(image.pixels(expected), pixels, rtol=0.0, atol=1e-8)
    step = image.places([[1.0, 0.0]]) - image.places([[0.0, 0.0]]), image.places([[0.0, 1.0]]) - expected[:1]
    np.testing.assert_allclose(image.linear, np.concatenate(step).T, rtol=0.0, atol=1e-8)


def test_transforms_that_place_nothing_are_refused():
    for transform in ((1.0, 2.0, 0.0, 2.0, 4.0, 0.0), (np.nan, 0.0, 0.0, 0.0, 1.0, 0.0), (1.0, 0.0)):
        with pytest.raises(InputError, match="`transform`"):
            PlacedImage(ArrayImage(np.zeros((2, 2))), transform)
