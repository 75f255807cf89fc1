"""Lines of an image as an image of their own."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.part import ImageLines
from sightline.imaging.source import ArrayImage


def test_pixels_and_mask_are_those_of_the_lines():
    pixels = np.arange(60.0, dtype=np.float32).reshape(12, 5)
    unusable = pixels % 7 == 0
    part = ImageLines(ArrayImage(pixels, unusable), 4, 6)
    assert part.shape == (6, 5)
    np.testing.assert_array_equal(part.read((1, 3), (0, 4)), pixels[5:7, :4])
    np.testing.assert_array_equal(part.mask((0, 6), (0, 5)), unusable[4:10])
    assert ImageLines(ArrayImage(pixels), 4, 6).mask((0, 6), (0, 5)) is None


@pytest.mark.parametrize(("first", "lines"), [(-1, 3), (0, 0), (8, 5)])
def test_lines_that_are_not_there_are_refused(first, lines):
    with pytest.raises(InputError, match="do not lie in an image of 12 lines"):
        ImageLines(ArrayImage(np.zeros((12, 5), np.float32)), first, lines)
