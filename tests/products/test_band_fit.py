"""How well two images fit: known shifts, false matches, too little to say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from sightline.imaging.source import ArrayImage
from sightline.products.band_fit import WINDOW, BandFit, fit_bands, fit_points, lie_together

SHAPE = (220, 400)


@pytest.fixture(scope="module")
def pair():
    """Two images of one texture, the second shifted by (0.3, -0.2) px by Fourier phase, each with noise."""
    rng = np.random.default_rng(0)
    half = np.fft.rfft2(rng.standard_normal(SHAPE))
    fy, fx = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])[None, :]
    half *= np.exp(-8.0 * (fy**2 + fx**2)) / np.sqrt(fy**2 + fx**2 + 1e-4)
    half[0, 0] = 0.0
    images = [
        np.fft.irfft2(half * np.exp(-2j * np.pi * (fy * a + fx * b)), s=SHAPE)
        for a, b in ((0, 0), (0.3, -0.2))
    ]
    scale = 100.0 / images[0].std()
    return [1000.0 + scale * image + rng.standard_normal(SHAPE) * 2.0 for image in images]


def test_a_shift_is_found_on_both_axes(pair):
    fit = fit_bands(ArrayImage(pair[0]), ArrayImage(pair[1]), (0, 1))
    # some 90 windows, each good to a few hundredths of a pixel by its own sigma
    slack = 4.0 * np.array(fit.noise_px) / math.sqrt(len(fit.points))
    assert np.all(np.abs(np.array(fit.mean_px) - [0.3, -0.2]) < slack + 1e-3)
    assert fit.rms_px == pytest.approx((0.3, 0.2), abs=0.02)


def test_images_that_fit_are_apart_by_their_noise_only(pair):
    rng = np.random.default_rng(1)
    again = ArrayImage(pair[0] + rng.standard_normal(SHAPE) * 2.0)
    fit = fit_bands(ArrayImage(pair[0]), again, (0, 1))
    # 90 windows: their rms scatters by 1 / sqrt(180) about its expectation
    assert np.hypot(*fit.rms_px) == pytest.approx(np.hypot(*fit.noise_px), rel=0.35)


def test_a_moving_thing_is_left_out(pair):
    spoiled = pair[1].copy()
    spoiled[60:120, 100:200] = np.roll(pair[1], (3, 3), axis=(0, 1))[60:120, 100:200]
    fit = fit_bands(ArrayImage(pair[0]), ArrayImage(spoiled), (0, 1))
    assert np.hypot(*fit.rms_px) < 0.5  # with the windows on it 1.3
    assert len(fit.points) < fit.tried


def test_nothing_alike_says_nothing(pair):
    noise = ArrayImage(np.random.default_rng(2).standard_normal(SHAPE))
    fit = fit_bands(ArrayImage(pair[0]), noise, (0, 1), search_px=(0, 0))
    assert all(math.isnan(value) for value in (*fit.rms_px, *fit.noise_px, *fit.mean_px))


def test_an_image_smaller_than_a_window_has_no_points():
    assert fit_points((10, 30)).shape == (0, 2)
    tiny = ArrayImage(np.zeros((10, 30)))
    assert fit_bands(tiny, tiny, (0, 1)).tried == 0


def test_windows_lie_inside_and_are_not_too_many():
    points = fit_points((5000, 3000), most=500)
    assert len(points) <= 500
    half = 0.5 * (np.array(WINDOW) - 1)
    assert (points - half >= 0).all() and (points + half <= np.array([4999, 2999])).all()


def test_numbers_of_an_empty_fit_are_unknown():
    empty = np.empty((0, 2))
    assert math.isnan(BandFit((0, 1), empty, empty, empty, 0).rms_px[0])


def test_only_windows_with_common_ground_are_tried(pair):
    narrow = pair[1].copy()
    narrow[:, 150:] = np.nan
    fit = fit_bands(ArrayImage(pair[0]), ArrayImage(narrow), (0, 1))
    whole = fit_bands(ArrayImage(pair[0]), ArrayImage(pair[1]), (0, 1))
    # windows begin at columns 2, 49.1, 96.3, ...: of eight, three end left of 150
    assert 0 < fit.tried <= 3 * whole.tried / 8
    assert len(fit.points) > 0.8 * fit.tried


def test_so_small_a_share_of_windows_says_nothing():
    points = np.zeros((30, 2))
    assert BandFit((0, 1), points, points, points + 0.1, 100).known
    assert not BandFit((0, 1), points, points, points + 0.1, 2000).known


def test_false_matches_are_left_out_though_they_are_more_than_the_true_ones():
    """40 of 100 windows about one place to .05 px, the others anywhere within a search of 8 px."""
    rng = np.random.default_rng(3)
    true = np.arange(100) < 40
    offset = np.where(true[:, None], rng.normal([0.4, -0.3], 0.05, (100, 2)), rng.uniform(-9, 9, (100, 2)))
    kept = lie_together(offset, np.full((100, 2), 0.05), (8, 8))
    assert kept[true].mean() > 0.95
    # a false one lies within .3 px of the place once in (18 / .6)^2 windows: none of 60, or one or two
    assert (kept & ~true).sum() <= 2


def test_windows_that_scatter_along_one_axis_are_all_kept():
    """A motion of 2 px rms between the bands is no false match."""
    rng = np.random.default_rng(4)
    offset = rng.normal(0.0, [0.05, 2.0], (300, 2))
    assert lie_together(offset, np.full((300, 2), 0.05), (8, 8)).mean() > 0.97


@pytest.mark.parametrize(("shift", "search"), [((6, 0), (8, 2)), ((0, 6), (2, 8))])
def test_coarse_pixels_are_sought_as_far_along_each_axis_as_asked(pair, shift, search):
    moved = ArrayImage(np.roll(pair[0], shift, axis=(0, 1)))
    fit = fit_bands(ArrayImage(pair[0]), moved, (0, 1), search_px=search, factor=2)
    assert fit.mean_px == pytest.approx(shift, abs=0.05)


def test_windows_are_kept_that_are_more_likely_true_than_anywhere():
    """A normal density of each window's own sigmas against an even one; the share of true ones solved for."""
    rng = np.random.default_rng(13)
    sigma = np.concatenate([np.full((60, 2), 0.02), rng.uniform(0.3, 2.5, (120, 2))])
    offset = np.concatenate([np.zeros((60, 2)), rng.uniform([-8.0, -12.0], [8.0, 12.0], (120, 2))])
    offset[60:120] *= 0.4
    density = np.exp(-0.5 * ((offset / sigma) ** 2).sum(axis=1)) / (2.0 * np.pi * sigma.prod(axis=1))
    even = 1.0 / (18.0 * 26.0)  # searched 8 and 12 px to either side, and a pixel more

    def true(share):
        return share * density / (share * density + (1.0 - share) * even)

    share = brentq(lambda p: true(p).mean() - p, 0.2, 0.9)
    kept = lie_together(offset, sigma, (8, 12))
    clear = np.abs(true(share) - 0.5) > 0.02
    assert clear.sum() > 170 and 80 < kept.sum() < 150
    np.testing.assert_array_equal(kept[clear], true(share)[clear] > 0.5)
