"""Bands on the grid of another: masks, edges, the map between its columns, blocks."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.imaging.source import ArrayImage
from sightline.products import register_bands
from sightline.products.register_bands import (
    MASK_SHARE,
    RegisteredImage,
    band_map,
    line_blocks,
)
from sightline.products.resample import product_weights

SHAPE = (96, 120)


@pytest.fixture
def pixels():
    """A smooth image: two waves of some 20 px."""
    i, j = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return (100.0 + 10.0 * np.sin(0.3 * i + 0.1 * j) + 10.0 * np.cos(0.25 * j)).astype(np.float32)


def shifted(line=0.0, column=0.0):
    """The map of a constant shift."""

    def mapping(lines, columns):
        return np.stack(np.meshgrid(lines + line, columns + column, indexing="ij"), axis=-1)

    return mapping


def whole(image):
    return image.read((0, image.shape[0]), (0, image.shape[1]))


def test_no_shift_gives_the_image_itself_to_its_very_edges(pixels):
    seen = whole(RegisteredImage(ArrayImage(pixels), shifted(), SHAPE))
    np.testing.assert_allclose(seen, pixels, rtol=1e-5)


def test_a_shift_moves_what_is_seen_from_where_the_map_says(pixels):
    seen = whole(RegisteredImage(ArrayImage(pixels), shifted(3.0, -2.0), SHAPE))
    np.testing.assert_allclose(seen[:-3, 2:], pixels[3:, :-2], rtol=1e-5)
    assert np.isnan(seen[-3:]).all() and np.isnan(seen[:, :2]).all()


def test_only_the_pixel_itself_is_lost_where_the_shift_is_whole(pixels):
    unusable = np.zeros(SHAPE, dtype=bool)
    unusable[40, 50] = True
    seen = whole(RegisteredImage(ArrayImage(pixels, unusable), shifted(1.0, 1.0), SHAPE))
    lost = np.argwhere(np.isnan(seen[:-1, :-1]))
    assert lost.tolist() == [[39, 49]]


def test_the_mask_grows_by_what_the_kernel_weighs_too_much(pixels):
    """With half a pixel of shift along lines only, the rows lost about a masked pixel are those whose weight
    on it is above the share; every one kept is off by less than that share of what was made up wrongly."""
    unusable = np.zeros(SHAPE, dtype=bool)
    unusable[40, 50] = True
    spoiled = np.where(unusable, np.float32(1e6), pixels)
    seen = whole(RegisteredImage(ArrayImage(spoiled, unusable), shifted(0.5, 0.0), SHAPE))
    weights = np.abs(product_weights(np.array([0.5])))[0]
    assert np.isnan(seen[20:70, 50]).sum() == (weights > MASK_SHARE).sum()
    assert not np.isnan(seen[20:70, [48, 49, 51, 52]]).any()
    clean = whole(RegisteredImage(ArrayImage(pixels), shifted(0.5, 0.0), SHAPE))
    # the mean of 17 x 17 px stands in for the pixel: off by 2 amplitudes of 10 at most
    assert np.nanmax(np.abs(seen - clean)[20:70]) < MASK_SHARE * 40.0


def test_nan_counts_as_unusable_and_spreads_no_further_than_a_mask(pixels):
    holed = pixels.copy()
    holed[30:34, 60:70] = np.nan
    by_nan = whole(RegisteredImage(ArrayImage(holed), shifted(0.3, 0.4), SHAPE))
    masked = RegisteredImage(ArrayImage(np.nan_to_num(holed), np.isnan(holed)), shifted(0.3, 0.4), SHAPE)
    np.testing.assert_array_equal(by_nan, whole(masked))
    assert np.isnan(by_nan[30:34, 60:69]).all() and not np.isnan(by_nan[44:, 80:110]).all()


def test_places_the_map_does_not_know_have_no_value(pixels):
    def mapping(lines, columns):
        out = shifted(0.2, 0.2)(lines, columns)
        out[(lines >= 20) & (lines < 30)] = np.nan
        out[:, columns < 64, :] = np.where((lines < 10)[:, None, None], np.nan, out[:, columns < 64, :])
        return out

    image = RegisteredImage(ArrayImage(pixels), mapping, SHAPE)
    seen = whole(image)
    assert np.isnan(seen[20:30]).all()
    assert np.isnan(seen[:10, :60]).all()
    assert np.isfinite(seen[32:-8, 8:-8]).all()


def test_a_map_that_never_meets_the_image_gives_nothing(pixels):
    assert np.isnan(whole(RegisteredImage(ArrayImage(pixels), shifted(5000.0, 0.0), SHAPE))).all()


def test_windows_agree_with_the_whole(pixels):
    image = RegisteredImage(ArrayImage(pixels), shifted(0.37, -1.21), SHAPE)
    np.testing.assert_allclose(image.read((30, 50), (40, 90)), whole(image)[30:50, 40:90], rtol=1e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_blocks_make_up_the_image_whatever_the_threads(pixels, monkeypatch, threads):
    monkeypatch.setattr(register_bands, "BLOCK_PIXELS", 10 * SHAPE[1])
    unusable = np.zeros(SHAPE, dtype=bool)
    unusable[5, 5] = True
    images = [ArrayImage(pixels, unusable), RegisteredImage(ArrayImage(pixels), shifted(0.4, 0.1), SHAPE)]
    got = list(line_blocks(images, threads=threads))
    assert [first for first, _ in got] == list(range(0, SHAPE[0], 10))
    for k, image in enumerate(images):
        joined = np.concatenate([blocks[k] for _, blocks in got])
        expected = whole(image)
        if k == 0:
            expected = np.where(unusable, np.nan, expected)
        np.testing.assert_array_equal(joined, expected)


class Watched(ArrayImage):
    """An image that remembers how many lines were read at most."""

    most = 0

    def read(self, lines, columns):
        Watched.most = max(Watched.most, lines[1] - lines[0])
        return super().read(lines, columns)


def test_the_whole_strip_is_never_read(pixels, monkeypatch):
    monkeypatch.setattr(register_bands, "BLOCK_PIXELS", 10 * SHAPE[1])
    image = RegisteredImage(Watched(np.tile(pixels, (5, 1))), shifted(0.4, 0.1), (480, SHAPE[1]))
    assert len(list(line_blocks([image], threads=2))) == 48
    # ten lines and what the kernel reads about them
    assert 10 < Watched.most <= 10 + 2 * 12


def test_the_map_of_two_cameras_is_that_of_their_rays():
    from sightline.geometry.conjugate import predict_match
    from sightline.geometry.surface import Plane
    from sightline.simulate.scenarios import line_of_sight_case

    scenario = line_of_sight_case("nominal", 3, lines=420, columns=64)
    first, other = scenario.cameras[0], scenario.cameras[3]
    lines, columns = np.array([5.0, 60.0]), np.array([0.0, 31.0, 64.0])
    places = band_map(first, other, Plane(0.0))(lines, columns)
    points = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(
        places.reshape(-1, 2), predict_match(first, other, Plane(0.0), points), atol=1e-9
    )
    # beyond what the motion covers there is no place, and no error
    assert np.isnan(band_map(first, other, Plane(0.0))(np.array([-500.0]), columns)).all()
