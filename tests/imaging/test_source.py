"""Images read in windows."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.source import ArrayImage, ImageSource, in_memory, read_padded


def test_an_array_is_an_image_source_and_reads_float32():
    image = ArrayImage(np.arange(20, dtype=np.uint16).reshape(4, 5))
    assert isinstance(image, ImageSource)
    window = image.read((1, 3), (2, 5))
    assert window.dtype == np.float32 and window.flags.c_contiguous
    assert window.tolist() == [[7, 8, 9], [12, 13, 14]]
    assert image.mask((0, 2), (0, 2)) is None


@pytest.mark.parametrize("bad", [np.zeros((2, 3, 4)), np.zeros((0, 5)), np.zeros((3, 3), complex)])
def test_what_is_no_single_band_image_is_refused_with_advice(bad):
    with pytest.raises(InputError, match="real array \\(lines, columns\\)"):
        ArrayImage(bad)


def test_a_mask_of_another_shape_is_refused():
    with pytest.raises(InputError, match="one flag per pixel"):
        ArrayImage(np.zeros((3, 4)), np.zeros((4, 3), bool))


def test_reading_beyond_the_border_reflects_and_does_not_flag():
    image = ArrayImage(np.array([[1.0, 2.0], [3.0, 4.0]]))
    pixels, unusable = read_padded(image, (-1, 3), (0, 2))
    assert pixels.tolist() == [[1, 2], [1, 2], [3, 4], [3, 4]]
    assert unusable is None


def test_nan_and_masked_pixels_are_flagged_and_made_finite():
    array = np.array([[1.0, np.nan], [3.0, 5.0]])
    pixels, unusable = read_padded(ArrayImage(array, np.array([[0, 0], [1, 0]], bool)), (0, 2), (0, 2))
    assert pixels[0, 1] == 3.0  # the mean of the finite ones
    assert unusable.tolist() == [[False, True], [True, False]]


def test_a_window_wholly_outside_is_refused():
    with pytest.raises(InputError, match="must meet the image"):
        read_padded(ArrayImage(np.zeros((4, 4))), (6, 9), (0, 2))


def test_an_image_in_memory_is_the_whole_of_it_and_of_its_mask():
    pixels, mask = np.arange(35.0).reshape(5, 7), np.arange(35).reshape(5, 7) % 4 == 1
    for image in (ArrayImage(pixels, mask), ArrayImage(pixels.T, mask.T)):
        held = in_memory(image)
        np.testing.assert_array_equal(held.array, image.array)
        np.testing.assert_array_equal(held.unusable, image.unusable)
    assert in_memory(ArrayImage(pixels)).unusable is None


@pytest.mark.parametrize("fill", [-3.4028235e38, 3e38, np.inf, np.nan])
def test_fill_values_that_no_file_declares_are_no_pixels(fill):
    # they are floats like others, but their squares are infinite in float32
    array = np.full((4, 6), 500.0, np.float32)
    array[1:3, 2] = fill
    pixels, unusable = read_padded(ArrayImage(array), (0, 4), (0, 6))
    assert (pixels == 500.0).all()
    assert unusable is not None and unusable.tolist() == (array != 500.0).tolist()
