from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from tests.io.conftest import noise, write_tif

from sightline.errors import FormatError, InputError
from sightline.imaging.source import ImageSource
from sightline.io.formats.images import check_content, open_image


def test_a_window_of_a_raster_is_that_of_the_array(tmp_path):
    array = noise(3, (50, 40))
    image = open_image(write_tif(tmp_path / "a.tif", array))
    assert isinstance(image, ImageSource) and image.shape == (50, 40)
    window = image.read((7, 20), (5, 9))
    assert window.dtype == np.float32 and window.flags.c_contiguous
    np.testing.assert_array_equal(window, array[7:20, 5:9])
    assert image.mask((7, 20), (5, 9)) is None


def test_a_window_of_an_npy_file_is_that_of_the_array(tmp_path):
    array = np.random.default_rng(0).normal(size=(50, 40))
    array[10, 10] = np.nan
    np.save(tmp_path / "a.npy", array)
    image = open_image(tmp_path / "a.npy")
    np.testing.assert_array_equal(image.read((0, 50), (3, 30)), array[:, 3:30].astype(np.float32))
    assert image.mask((0, 5), (0, 5)) is None
    assert image.mask((8, 12), (8, 12)).sum() == 1


def test_no_data_nan_and_the_mask_image_are_not_to_be_used(tmp_path):
    array = noise(0, (30, 20)).astype(np.float32)
    array[2, 3], array[4, 5] = -999.0, np.nan
    write_tif(tmp_path / "a.tif", array, nodata=-999.0)
    extra = np.zeros((30, 20), dtype=np.uint8)
    extra[6, 7] = 1
    np.save(tmp_path / "mask.npy", extra)
    image = open_image(tmp_path / "a.tif", mask=tmp_path / "mask.npy")
    bad = image.mask((0, 30), (0, 20))
    assert sorted(zip(*np.nonzero(bad), strict=True)) == [(2, 3), (4, 5), (6, 7)]


@pytest.mark.filterwarnings("error")
def test_numbers_that_float32_has_not_are_masked_without_a_word(tmp_path):
    pixels = np.arange(400.0).reshape(20, 20)
    pixels[3, 4] = 1e300
    pixels.view(np.uint64)[5, 6] = 0x7FF0000000000001  # a NaN that signals
    np.save(tmp_path / "band.npy", pixels)
    mask = open_image(tmp_path / "band.npy").mask((0, 20), (0, 20))
    assert np.argwhere(mask).tolist() == [[3, 4], [5, 6]]


def test_luminance_is_the_mean_of_the_bands(tmp_path):
    import rasterio

    data = np.random.default_rng(1).integers(0, 255, (3, 20, 30)).astype(np.uint8)
    with rasterio.open(
        tmp_path / "rgb.tif", "w", driver="GTiff", count=3, height=20, width=30, dtype="uint8"
    ) as target:
        target.write(data)
    image = open_image(tmp_path / "rgb.tif", "luminance")
    np.testing.assert_allclose(image.read((0, 20), (0, 30)), data.mean(axis=0), rtol=1e-6)


def test_threads_and_processes_read_the_same_image(tmp_path):
    array = noise(5, (400, 60))
    image = open_image(write_tif(tmp_path / "a.tif", array))
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda k: image.read((k, k + 40), (0, 60)), range(0, 400, 40)))
    np.testing.assert_array_equal(np.vstack(parts), array)
    again = pickle.loads(pickle.dumps(image))
    np.testing.assert_array_equal(again.read((0, 400), (0, 60)), array)


def test_a_window_outside_the_image_is_refused(tmp_path):
    image = open_image(write_tif(tmp_path / "a.tif", noise(0, (30, 20))))
    with pytest.raises(InputError, match="lines 20 to 31 are asked for; the image has 0 to 30"):
        image.read((20, 31), (0, 20))


def test_a_missing_image_is_named(tmp_path):
    with pytest.raises(FormatError, match=r"none\.tif: no such file"):
        open_image(tmp_path / "none.tif")


def test_a_file_that_is_no_image_is_named(tmp_path):
    (tmp_path / "a.tif").write_text("these are not the pixels you are looking for")
    with pytest.raises(FormatError, match=r"a\.tif: is no raster, a damaged one"):
        open_image(tmp_path / "a.tif")


def test_a_truncated_raster_is_found_before_work_starts(tmp_path):
    path = write_tif(tmp_path / "a.tif", noise(0, (600, 200)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FormatError, match=r"a\.tif: the pixels cannot be read .* truncated"):
        check_content(open_image(path))


def test_a_truncated_npy_file_is_named(tmp_path):
    np.save(tmp_path / "a.npy", noise(0))
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data[: len(data) // 2])
    with pytest.raises(FormatError, match=r"a\.npy: cannot be read as \.npy"):
        open_image(tmp_path / "a.npy")


def test_a_three_dimensional_array_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((3, 4, 5)))
    with pytest.raises(FormatError, match=r"shape \(3, 4, 5\).*an image is \(lines, columns\)"):
        open_image(tmp_path / "a.npy")


def test_a_constant_image_is_refused(tmp_path):
    image = open_image(write_tif(tmp_path / "a.tif", np.full((100, 50), 7, dtype=np.uint16)))
    with pytest.raises(FormatError, match=r"a\.tif: the image is constant \(every pixel looked at is 7\)"):
        check_content(image)


def test_a_saturated_image_is_refused(tmp_path):
    array = noise(0, (100, 50))
    array[:, 10:] = 4095  # the top of 12 bits in a 16-bit file
    image = open_image(write_tif(tmp_path / "a.tif", array))
    with pytest.raises(FormatError, match=r"a\.tif: 80 % of the pixels looked at are saturated \(at 4095\)"):
        check_content(image)


def test_an_empty_image_is_refused(tmp_path):
    array = np.zeros((100, 50), dtype=np.uint16)
    array[::20, :] = noise(0, (5, 50))
    image = open_image(write_tif(tmp_path / "a.tif", array))
    with pytest.raises(FormatError, match=r"a\.tif: 9. % of the pixels looked at are empty \(at 0\)"):
        check_content(image)


def test_an_image_of_nothing_but_nan_is_refused(tmp_path):
    image = open_image(write_tif(tmp_path / "a.tif", np.full((100, 50), np.nan, dtype=np.float32)))
    with pytest.raises(FormatError, match=r"a\.tif: no usable pixel"):
        check_content(image)


def test_a_mask_of_another_size_is_refused(tmp_path):
    write_tif(tmp_path / "a.tif", noise(0, (30, 20)))
    write_tif(tmp_path / "m.tif", noise(0, (20, 30)))
    with pytest.raises(FormatError, match=r"m\.tif: the mask is 20 lines x 30 columns.*30 x 20"):
        open_image(tmp_path / "a.tif", mask=tmp_path / "m.tif")


def test_a_band_that_the_file_does_not_have_is_refused(tmp_path):
    write_tif(tmp_path / "a.tif", noise(0, (30, 20)))
    with pytest.raises(FormatError, match="band 4 is asked for; the file has 1"):
        open_image(tmp_path / "a.tif", 4)
