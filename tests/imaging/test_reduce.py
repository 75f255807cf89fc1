"""An image at a coarser scale."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.reduce import ReducedImage
from sightline.imaging.source import ArrayImage


def test_windows_of_a_reduced_image_are_means_of_blocks_and_flag_bad_ones():
    pixels = np.random.default_rng(1).normal(size=(20, 31))
    bad = np.zeros(pixels.shape, dtype=bool)
    bad[5, 7] = True
    image = ReducedImage(ArrayImage(pixels, bad), 3)
    assert image.shape == (6, 10)
    expected = pixels[3:9, 6:18].reshape(2, 3, 4, 3).mean(axis=(1, 3))
    assert np.allclose(image.read((1, 3), (2, 6)), expected, atol=1e-6)
    assert image.mask((1, 3), (2, 6)).tolist() == [[True, False, False, False], [False] * 4]


def test_a_block_larger_than_the_image_is_refused():
    with pytest.raises(InputError, match="factor"):
        ReducedImage(ArrayImage(np.zeros((4, 9))), 5)
