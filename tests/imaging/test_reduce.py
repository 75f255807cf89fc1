"""An image at a coarser scale."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.reduce import ReducedImage, pattern_means, reduced_pixels, whole_pixels
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


def test_means_over_a_pattern_do_not_lean_to_its_bright_cells():
    # a ramp along lines behind cells of unlike brightness: a mean is the ramp's in the middle of its square
    ramp = 100.0 + np.arange(40.0)[:, None] * np.ones((1, 26))
    gain = np.array([[0.5, 0.7], [1.2, 1.6]])
    means = pattern_means(ArrayImage(ramp * np.tile(gain, (20, 13))), 2)
    assert means.shape == (20, 13)
    found = means.read((0, 20), (0, 13))
    # as bright as all cells are together, but for the ramp's step of one in 120 within each square
    level = found / (gain.mean() * (ramp[::2, ::2] + 0.5))
    assert np.ptp(level) < 1e-5 and abs(level.mean() - 1.0) < 1.0 / 120.0
    leaning = ReducedImage(ArrayImage(ramp * np.tile(gain, (20, 13))), 2).read((0, 20), (0, 13))
    assert np.ptp(leaning / (ramp[::2, ::2] + 0.5)) > 1e-4


def test_means_over_a_pattern_flag_what_holds_a_bad_pixel_and_bear_a_dark_cell():
    pixels = np.random.default_rng(2).uniform(50.0, 60.0, (21, 31))
    pixels[1::3, 1::3] = 0.0
    bad = np.zeros(pixels.shape, dtype=bool)
    bad[5, 7] = True
    means = pattern_means(ArrayImage(pixels, bad), 3)
    assert means.shape == (7, 10) and np.isfinite(means.read((0, 7), (0, 10))).all()
    flags = means.mask((0, 7), (0, 10))
    assert flags is not None and np.argwhere(flags).tolist() == [[1, 2]]
    dark = pattern_means(ArrayImage(np.zeros((8, 8))), 2)
    assert (dark.read((0, 4), (0, 4)) == 0.0).all()


def test_blocks_may_be_wider_than_high():
    pixels = np.random.default_rng(2).normal(size=(7, 30))
    image = ReducedImage(ArrayImage(pixels), (2, 5))
    assert image.shape == (3, 6)
    expected = pixels[2:6, 10:25].reshape(2, 2, 3, 5).mean(axis=(1, 3))
    assert np.allclose(image.read((1, 3), (2, 5)), expected, atol=1e-6)
    with pytest.raises(InputError, match="factor"):
        ReducedImage(ArrayImage(pixels), (8, 5))


@pytest.mark.parametrize("factor", [1, 2, 5])
def test_places_of_means_are_those_of_the_middles_of_their_blocks(factor):
    """A plane's mean over a block is the plane at its middle."""
    line, column = np.mgrid[0.0:20.0, 0.0:30.0]
    means = ReducedImage(ArrayImage(3.0 * line + 7.0 * column), factor)
    pixels = np.array([[0.0, 0.0], [2.0, 4.0], [3.0, 1.0]])
    whole = whole_pixels(pixels, factor)
    read = means.read((0, 4), (0, 5))
    assert np.allclose(whole @ [3.0, 7.0], read[tuple(pixels.astype(int).T)], rtol=1e-6)
    assert np.allclose(reduced_pixels(whole, factor), pixels, atol=1e-12)
