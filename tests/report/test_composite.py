"""The overlay: a true PNG, and greyer after than before."""

from __future__ import annotations

import base64
import warnings

import numpy as np
import rasterio

from sightline.report.composite import MISSING, colours, composite
from sightline.report.raster import data_png


def decoded(address):
    """Pixels (lines, columns, 3) of a ``data:`` address, read by GDAL."""
    head, content = address.split(",", 1)
    assert head == "data:image/png;base64"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.MemoryFile(base64.b64decode(content)) as file, file.open() as picture:
            return picture.read().transpose(1, 2, 0)


def test_a_picture_comes_back_pixel_by_pixel():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decoded(data_png(pixels)), pixels)


def test_red_and_cyan_agree_better_after_than_before(recovery):
    found = composite(recovery.result, recovery.acquisition)
    before, after = (decoded(picture).astype(float) for picture in (found.before, found.after))
    assert before.shape == after.shape == (found.lines, found.columns, 3)

    def misfit(picture):
        # Both layers are stretched to the same range; flat grey is where an image is missing.
        red, cyan = picture[..., 0], picture[..., 1]
        return np.abs(red - cyan)[~missing].mean()

    missing = (before == MISSING).all(axis=2) | (after == MISSING).all(axis=2)
    np.testing.assert_array_equal(before[~missing, 0], after[~missing, 0])
    # The residual before is of pixels, after of hundredths: what is left is noise and colour.
    assert misfit(after) < 0.7 * misfit(before)


def test_where_an_image_has_no_value_the_picture_is_no_misfit():
    red, cyan = np.random.default_rng(1).random((2, 6, 8))
    cyan[:, 5:] = np.nan
    picture = colours([red, cyan])
    assert (picture[:, 5:] == MISSING).all()
    assert not (picture[:, :5] == MISSING).all(axis=2).any()
