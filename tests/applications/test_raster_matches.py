"""Truth: textures shifted in the Fourier domain line by line, and sums of waves that are known everywhere.

Neither shares anything with the matcher, the resampling kernel or the maps.
"""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Transformer
from tests.matching.fourier_textures import shifted_pair

import sightline
from sightline import ArrayImage, PlacedImage, match_bands, match_rasters
from sightline.applications.raster_matches import _in_agreement
from sightline.errors import EstimationError, InputError
from sightline.matching.matches import KEPT, OUTLIER, TEXTURELESS, Matches

SHAPE = (400, 640)


def jitter(lines: int) -> np.ndarray:
    """px of each line, lines and columns."""
    t = np.arange(lines)
    return np.stack([0.5 * np.sin(2 * np.pi * t / 130.0), 0.3 * np.sin(2 * np.pi * t / 71.0 + 1.0)], axis=1)


def mean_motion(motion: np.ndarray, lines: np.ndarray, window: int) -> np.ndarray:
    """Mean shift over the lines of windows: line i of the second shows what lies `motion[i]` before it."""
    out = np.zeros((len(lines), 2))
    for offset in np.arange(window) - 0.5 * (window - 1):
        at = lines + offset
        for _ in range(30):
            at = lines + offset + np.interp(at, np.arange(len(motion)), motion[:, 0])
        out += (
            np.stack([np.interp(at, np.arange(len(motion)), motion[:, k]) for k in (0, 1)], axis=1) / window
        )
    return out


@pytest.mark.parametrize("cross", [False, True])
def test_jitter_of_lines_is_found_with_a_covariance_that_is_true(cross):
    motion = jitter(SHAPE[0])
    a, b = shifted_pair(SHAPE, (0.0, 0.0), snr=100, seed=3, cross=cross, motion=motion)
    found = match_rasters(ArrayImage(a), ArrayImage(b))
    kept = found.matches.kept
    error = (found.shift_px - mean_motion(motion, found.matches.a[:, 0], 10))[kept]
    covariance = found.matches.covariance_px[kept]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 2.0
    # 2 x 230 numbers scatter by 2 / sqrt(480) = 0.09 about 1; four times that on both sides
    assert kept.sum() > 200 and 0.65 < nees.mean() < 1.4
    rows = found.row_means
    departure = (rows.shift_px - mean_motion(motion, rows.place, 10)) / rows.sigma_px
    # 80 numbers: 1 +- 0.16
    assert 0.4 < np.nanmean(departure**2) < 1.7


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Many waves over easting and northing (m), the shortest of 40 m, each as strong as it is long."""
    rng = np.random.default_rng(8)
    out = np.zeros(np.broadcast(x, y).shape)
    for _ in range(200):
        length, angle, phase = 40.0 * 2.0 ** rng.uniform(0.0, 4.0), *rng.uniform(0.0, 2 * np.pi, 2)
        out += length / 640.0 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase)
    return out


def on_map(transform, shape, crs="EPSG:32645", moved=(0.0, 0.0), noise=0.02, seed=0):
    """The waves seen by an image on some map; `moved` m further east and north than they are."""
    lines, columns = np.meshgrid(np.arange(shape[0]) + 0.5, np.arange(shape[1]) + 0.5, indexing="ij")
    a, b, c, d, e, f = transform
    x, y = a * columns + b * lines + c, d * columns + e * lines + f
    if crs != "EPSG:32645":
        x, y = Transformer.from_crs(crs, "EPSG:32645", always_xy=True).transform(x, y)
    pixels = waves(x - moved[0], y - moved[1]) + noise * np.random.default_rng(seed).normal(size=shape)
    return PlacedImage(ArrayImage(pixels.astype(np.float32)), transform, crs)


A = (10.0, 0.0, 480000.0, 0.0, -10.0, 3100000.0)


@pytest.mark.parametrize(
    ("transform", "shape", "crs", "reduced"),
    [
        ((10.0, 0.0, 480123.0, 0.0, -10.0, 3099951.0), (220, 240), "EPSG:32645", 1),
        ((20.0, 0.0, 480003.0, 0.0, -20.0, 3099991.0), (110, 120), "EPSG:32645", 2),
        ((4.0, 1.0, 479800.0, 1.0, -4.0, 3100000.0), (600, 620), "EPSG:32645", 1),
        ((1e-4, 0.0, 86.7955, 0.0, -1e-4, 28.0255), (240, 260), "EPSG:4326", 1),
    ],
)
def test_images_on_unlike_maps_are_matched_in_pixels_of_the_first(transform, shape, crs, reduced):
    first = on_map(A, (240, 256))
    second = on_map(transform, shape, crs, moved=(23.0, 31.0), seed=1)
    found = match_rasters(first, second)
    kept = found.matches.kept
    assert found.geometry == "map" and found.reduced == reduced and kept.sum() >= 8
    # 23 m east are 2.3 columns, 31 m north are -3.1 lines
    error = found.shift_px[kept] - np.array([-3.1, 2.3])
    # of n windows the median is known to 1.25 / sqrt(n) of their scatter; windows of a kilopixel, to 0.1 px
    rms = np.sqrt((error**2).mean())
    assert rms < 0.1 and np.abs(np.median(error, axis=0)).max() < 4.0 * 1.25 * rms / np.sqrt(kept.sum())


def test_a_small_image_is_found_far_off_in_a_large_one():
    a, b = shifted_pair((512, 640), (0.4, -0.3), snr=100, seed=5)
    found = match_rasters(ArrayImage(a[200:360, 300:500]), ArrayImage(b), search_px=400)
    shift = found.shift_px[found.matches.kept]
    assert found.common_strength > 6.0
    assert np.abs(np.median(shift, axis=0) - [200.4, 299.7]).max() < 0.01


def test_images_smaller_than_the_usual_search_are_searched_as_far_as_they_reach():
    a, b = shifted_pair((48, 60), (0.4, -0.3), snr=100, seed=5)
    found = match_rasters(ArrayImage(a), ArrayImage(b))
    kept = found.matches.kept
    error = (found.shift_px[kept] - [0.4, -0.3]) / found.matches.sigma_px[kept]
    # the median of n windows, in their own sigmas: 1.25 / sqrt(n), four times that
    assert kept.sum() >= 4 and np.abs(np.median(error, axis=0)).max() < 4.0 * 1.25 / np.sqrt(kept.sum())


def test_what_a_cloud_hides_is_not_matched_and_what_disagrees_is_an_outlier():
    a, b = shifted_pair(SHAPE, (1.2, 0.7), snr=100, seed=6)
    # a patch of b shows other ground, another cannot be used
    b[100:180, 200:420] = np.roll(b, (57, 91), axis=(0, 1))[100:180, 200:420]
    unusable = np.zeros(SHAPE, dtype=bool)
    unusable[250:330, :300] = True
    found = match_rasters(ArrayImage(a), ArrayImage(b, unusable))
    matches = found.matches
    assert matches.counts()["masked"] >= 14 and matches.kept.sum() > 150
    line, column = np.abs(matches.a - [139.5, 309.5]).T
    within = (line < 35.0) & (column < 60.0)  # windows of 10 x 100 px wholly under the patch
    clear = matches.kept & ((line > 52.0) | (column > 167.0))  # and those off it, with the reach of filters
    # lengths of two components beyond 5 sigma: 4e-6 of them
    size = np.linalg.norm((found.shift_px - [1.2, 0.7])[clear] / found.sigma_px[clear], axis=1)
    assert size.max() < 5.0 and matches.kept[within].sum() <= 1 < within.sum()


def test_bands_are_compared_with_the_first_or_all_with_each_other():
    a, b = shifted_pair((200, 300), (0.5, -0.25), snr=100, seed=7)
    images = [ArrayImage(a), ArrayImage(b), ArrayImage(a)]
    assert match_bands(images).pairs == ((0, 1), (0, 2))
    every = match_bands(images, ["r", "g", "b"], pairs="all")
    middles = [np.nanmedian(one.shift_px, axis=0) for one in every.matches]
    assert every.pairs == ((0, 1), (0, 2), (1, 2)) and every.matches[2].names == ("g", "b")
    np.testing.assert_allclose(middles, [(0.5, -0.25), (0.0, 0.0), (-0.5, 0.25)], atol=0.01)
    with pytest.raises(InputError, match="two numbers from 0 to 2"):
        match_bands(images, pairs=[(0, 3)])


def refused(a, b, words, error=InputError, **options):
    with pytest.raises(error, match=words):
        match_rasters(a, b, **options)


def test_what_cannot_be_matched_is_refused_with_the_reason():
    rng = np.random.default_rng(1)
    noise = [ArrayImage(rng.normal(size=(200, 300))) for _ in range(2)]
    placed, plain = on_map(A, (60, 80)), ArrayImage(np.zeros((60, 80)))
    refused(placed, noise[0], "second image has no georeferencing")
    far = PlacedImage(placed.source, (10.0, 0.0, 0.0, 0.0, -10.0, 0.0), "EPSG:32645")
    refused(placed, far, "do not overlap on the map")
    refused(placed, PlacedImage(placed.source, A), "no coordinate system, the other has")
    refused(plain, plain, "it is constant, or unusable")
    refused(ArrayImage(np.full((60, 80), np.nan)), noise[0], "it is constant, or unusable")
    refused(ArrayImage(rng.normal(size=(20, 20))), noise[0], "24 px a side are needed")
    small = ArrayImage(rng.normal(size=(16, 58)))  # smaller than the search that nobody asked for, too
    refused(small, small, "16 x 58 and 16 x 58 px; 24 px a side are needed")
    refused(noise[0], noise[1], "`search_px` is -1", search_px=-1.0)
    refused(noise[0], noise[1], "`geometry` is", geometry="sphere")
    refused(noise[0], noise[0], "do not fit", window=(10, 400))
    refused(noise[0], noise[1], "do not show the same", EstimationError)


def test_unrelated_images_are_hardly_ever_taken_for_the_same():
    # chance is allowed once in ten thousand; textures of real scenes are as correlated as these
    for seed in range(10):
        a, _ = shifted_pair((128, 160), (0.0, 0.0), snr=100, seed=2 * seed)
        b, _ = shifted_pair((128, 160), (0.0, 0.0), snr=100, seed=2 * seed + 1)
        refused(ArrayImage(a), ArrayImage(b), "do not show the same", EstimationError)


@pytest.mark.parametrize("chance", [False, True])
def test_faint_matches_are_believed_where_they_go_with_others_and_hide_no_outlier(chance):
    rng, shape = np.random.default_rng(4), (24, 24)
    faint, wrong = rng.random(shape) < 0.5, np.zeros(shape, dtype=bool)
    wrong[3::6, 4::6] = True
    for beside in (-1, 0, 1):  # a false match has neighbours that are kept
        faint[3::6, 4 + beside :: 6] = False
    sigma = np.where(faint, 0.4, 0.1)
    shift = sigma[..., None] * rng.standard_normal((*shape, 2))
    if chance:
        shift[faint] = rng.uniform(-3.0, 3.0, (faint.sum(), 2))
    shift[wrong] += 1.5
    a = np.stack(np.indices(shape), axis=-1).reshape(-1, 2) * 20.0
    offset, status = np.array([2.0, -1.0]), np.where(faint, TEXTURELESS, KEPT).astype(np.uint8).ravel()
    covariance = sigma.reshape(-1, 1, 1) ** 2 * np.eye(2)
    given = Matches(a, a + offset + shift.reshape(-1, 2), covariance, np.ones(len(a)), status)
    found = _in_agreement(given, offset, shape).status.reshape(shape)
    assert (found[wrong] == OUTLIER).all()
    assert (found[~faint & ~wrong] == KEPT).mean() > 0.98  # chance makes one in 3000, a false neighbour more
    assert (found[faint] == (TEXTURELESS if chance else KEPT)).mean() > 0.98


def test_the_names_of_the_package_reach_it():
    assert sightline.match_rasters is match_rasters
