"""What aliasing makes of matches, taken off as a finer image shows it."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from sightline.imaging.reduce import averaged
from sightline.imaging.source import ArrayImage
from sightline.imaging.warp import WarpedImage
from sightline.matching.match_images import match_images
from sightline.matching.whitening import gradient_filter, pair_whitening
from sightline.motion.measure.aliasing import (
    PHASE_STRETCHES,
    PHASE_WINDOWS,
    folding,
    in_stretches,
    phase_between,
    phase_bias,
    pooled_bias,
)

RATIO, SHAPE = 4, (120, 240)


def moved(lines, columns):
    """The mapping that goes so far on."""

    def mapping(rows, places):
        return np.stack(np.meshgrid(rows + lines, places + columns, indexing="ij"), axis=-1)

    return mapping


def on_coarse(image, offset):
    """A fine image on pixels RATIO as large, `offset` fine px further on."""

    def mapping(lines, columns):
        middle = 0.5 * (RATIO - 1)
        places = np.meshgrid(
            RATIO * lines + middle + offset[0], RATIO * columns + middle + offset[1], indexing="ij"
        )
        return np.stack(places, axis=-1)

    made = averaged(partial(WarpedImage, image), mapping, SHAPE, (RATIO, RATIO))
    return ArrayImage(made.read((0, SHAPE[0]), (0, SHAPE[1])))


@pytest.fixture(scope="module")
def folded_pair():
    """(shift, fold, known, rows) of two coarse images that lie where they should: all shift is error."""
    rng = np.random.default_rng(8)
    size = RATIO * (SHAPE[0] + 16), RATIO * (SHAPE[1] + 16)
    f = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None])
    # detail as on the ground, cut where the kernel that lays one image on the other ends
    law = np.where(f > 0, np.maximum(f, 1e-3) ** -1.0, 0.0) * (f < 0.35)
    fine = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(size)) * law, size)
    apart = 0.3 * RATIO, 0.4 * RATIO
    start = (20.0, 20.0)
    further = start[0] + apart[0], start[1] + apart[1]

    def seen(offset, noise):
        made = on_coarse(ArrayImage(fine), offset).array
        return ArrayImage(made + noise * fine.std() * rng.standard_normal(SHAPE))

    centres = np.stack(
        np.meshgrid(np.arange(20.0, 100.0, 4.0), np.arange(30.0, 210.0, 24.0), indexing="ij"), -1
    )
    centres = centres.reshape(-1, 2)

    def error(hub, partner):
        laid = WarpedImage(partner, moved(-0.3, -0.4), SHAPE)
        return match_images(hub, laid, centres, centres, window=(4, 24), search_px=(0, 0))

    real = error(seen(start, 0.01), seen(further, 0.01))
    # the finest image is another one: its own noise
    third = ArrayImage(fine + 0.04 * fine.std() * rng.standard_normal(size))
    shown = error(on_coarse(third, start), on_coarse(third, further))
    good = real.kept
    return (real.b - centres)[good], (shown.b - centres)[good], shown.kept[good], centres[good, 0]


def test_what_a_finer_image_shows_takes_most_of_the_error_away(folded_pair):
    shift, fold, known, rows = folded_pair
    assert known.mean() > 0.95 and len(shift) > 100
    folded, unknown = folding(shift, fold, known, rows)
    left = (shift - folded)[known]
    before, after = (np.sqrt((part**2).mean(axis=0)) for part in (shift[known], left))
    # detail of the ground up to 1.4 times the coarse sampling folds: without it noise alone is left
    assert (after < 0.6 * before).all()
    bias = np.abs(left.mean(axis=0)), 4.0 * left.std(axis=0) / np.sqrt(len(left))
    assert (bias[0] < bias[1]).all()
    assert (unknown[known] == 0.0).all()


def test_a_finer_image_that_lies_elsewhere_changes_nothing():
    rng = np.random.default_rng(3)
    shift, fold = rng.normal(0.0, 0.02, (400, 2)), rng.normal(0.0, 0.02, (400, 2))
    rows = np.repeat(np.arange(40.0), 10)
    folded, _ = folding(
        shift + np.repeat(rng.normal(0, 0.1, (40, 2)), 10, axis=0), fold, np.ones(400, bool), rows
    )
    # the slope of unrelated numbers is 0 within 1 / sqrt(720): five sigmas
    assert np.abs(folded).max() <= 5.0 / np.sqrt(720) * np.abs(fold).max()


def test_where_it_is_not_known_the_error_is_owned():
    rng = np.random.default_rng(4)
    fold = rng.normal(0.0, (0.02, 0.03), (600, 2))
    shift = fold + rng.normal(0.0, 0.005, fold.shape)
    known = np.arange(600) % 6 > 0
    folded, unknown = folding(
        shift, np.where(known[:, None], fold, np.nan), known, np.repeat(np.arange(50.0), 12)
    )
    assert (folded[~known] == 0.0).all() and (unknown[known] == 0.0).all()
    # 500 windows tell a variance to 6 %
    assert np.diag(unknown[~known][0]) == pytest.approx([0.02**2, 0.03**2], rel=0.25)


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_windows_are_left_as_they_are(count):
    shift = np.ones((3, 2))
    folded, unknown = folding(shift, shift, np.arange(3) < count, np.zeros(3))
    assert not folded.any() and not unknown.any()


def row_shifted(seed, blur, rows=900, columns=400, over=8):
    """Two images of ground averaged over pixels, the second `x` px further on in each row; (a, b, x).

    Exact: each row of the ground is moved by its Fourier series. `blur` px is the sigma of what is before the
    pixel.
    """
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns * over, 1.0 / over)[None]
    f = np.hypot(fy, fx)
    series = np.fft.fft2(rng.standard_normal((rows, columns * over)))[:, : fx.size]
    series *= np.where(f > 0, np.maximum(f, 1e-3) ** -1.0, 0.0) * np.exp(-2.0 * (np.pi * blur * f) ** 2)
    along = np.fft.ifft(series * np.sinc(fy), axis=0)  # rows of the ground, averaged over a line
    x = 0.25 * np.sin(2.0 * np.pi * np.arange(rows) / 170.0) + 0.4

    def seen(shift):
        moved = along * np.exp(2j * np.pi * fx * shift[:, None]) * np.sinc(fx)
        image = np.fft.irfft(moved, columns * over, axis=1)[:, ::over]
        return image / image.std() + 0.05 * rng.standard_normal(image.shape)

    return ArrayImage(seen(0.0 * x)), ArrayImage(seen(x)), x


def laid_back(image, x):
    """The image on the pixels that it was moved from."""

    def mapping(lines, columns):
        back = np.interp(lines, np.arange(len(x)), x)
        return np.stack(
            [np.broadcast_to(lines[:, None], (len(lines), len(columns))), columns - back[:, None]], -1
        )

    return WarpedImage(image, mapping, image.shape)


def test_matches_drawn_towards_whole_pixels_are_told_without_a_finer_image():
    seen = []
    for seed in range(3):
        a, b, x = row_shifted(seed, blur=0.0)
        laid = laid_back(b, x)
        points = np.stack(
            np.meshgrid(np.arange(20.5, 880, 2.0), np.arange(40.5, 360, 50.0), indexing="ij"), -1
        )
        points = points.reshape(-1, 2)
        whitening = pair_whitening(a, laid, points[::9])
        matched = lambda filters, a=a, laid=laid, points=points: match_images(  # noqa: E731
            a, laid, points, points, window=(2, 50), whitening=filters
        )
        there = points - np.column_stack([0.0 * points[:, 0], np.interp(points[:, 0], np.arange(900), x)])
        phase = phase_between(points, there, np.broadcast_to(np.eye(2), (len(points), 2, 2)))
        sizes, sigmas = phase_bias(matched, whitening, phase)
        # all that is found where the images are laid exactly is error: its slope is the truth
        matches = matched(whitening)
        good, sine = matches.kept, np.sin(2.0 * np.pi * phase[:, 1])
        slope, offset = np.polyfit(sine[good], (matches.b - points)[good, 1], 1)
        error = (matches.b - points)[good, 1] - slope * sine[good] - offset
        seen.append((sizes[1], sigmas[1], slope, error.std() / (np.sqrt(good.sum()) * sine[good].std())))
        assert sigmas[0] > 1e3  # lines lie alike everywhere: they tell nothing
    size, sigma, slope, own = np.transpose(seen)
    # a pixel's own response, .64 at the Nyquist frequency: some hundredths of a pixel
    assert slope.mean() < -0.01
    # what is found lacks what the detail kept for comparison is aliased by, up to a third
    apart = size.mean() - slope.mean()
    spread = np.sqrt((sigma**2).sum() + (own**2).sum()) / 3
    assert -3.0 * spread < apart < 3.0 * spread - 0.33 * slope.mean()


def test_smooth_images_show_no_bias():
    a, b, x = row_shifted(0, blur=0.8)
    laid = laid_back(b, x)
    points = np.stack(np.meshgrid(np.arange(20.5, 880, 2.0), np.arange(40.5, 360, 50.0), indexing="ij"), -1)
    points = points.reshape(-1, 2)
    there = points - np.column_stack([0.0 * points[:, 0], np.interp(points[:, 0], np.arange(900), x)])
    phase = phase_between(points, there, np.broadcast_to(np.eye(2), (len(points), 2, 2)))
    found = phase_bias(
        lambda filters: match_images(a, laid, points, points, window=(2, 50), whitening=filters),
        pair_whitening(a, laid, points[::9]),
        phase,
    )
    assert not pooled_bias(found[0][1:], found[1][1:]).any()


def test_the_phase_of_a_mirrored_image_is_that_of_its_pixels_in_the_hub():
    # pixel n of the partner lies at column 9.3 - n of the hub, and at line n - .2
    places = np.array([[4.5, 2.5], [7.0, 3.1]])
    found = np.column_stack([places[:, 0] + 0.2, 9.3 - places[:, 1]])
    affine = np.broadcast_to(np.diag([1.0, -1.0]), (2, 2, 2))
    apart = phase_between(places, found, affine) + np.array([-0.2, 0.3])
    assert np.allclose(apart, np.rint(apart), atol=1e-12)


def test_sizes_of_a_family_are_drawn_together_and_none_stay_none():
    rng = np.random.default_rng(5)
    sigmas = rng.uniform(1e-3, 6e-3, (2000, 6))
    truth = -0.015 + 0.003 * rng.standard_normal((2000, 6))
    found = truth + sigmas * rng.standard_normal(truth.shape)
    drawn = np.array([pooled_bias(*one) for one in zip(found, sigmas, strict=True)])
    # alone the error is 3.8e-3; a family's best is the posterior of each about its mean, about 2.5e-3
    best = np.sqrt(np.mean(1.0 / (1.0 / sigmas**2 + 1.0 / 0.003**2)))
    assert best <= np.sqrt(np.mean((drawn - truth) ** 2)) <= 1.25 * best
    none = sigmas * rng.standard_normal(sigmas.shape)
    shown = [pooled_bias(*one).any() for one in zip(none, sigmas, strict=True)]
    assert np.mean(shown) < 3e-3  # 3e-5 of a normal mean, 4 sigma below nothing
    assert not pooled_bias(np.zeros(2), np.full(2, np.inf)).any()


@pytest.mark.parametrize("vague", [0.018, 0.03, 1.0, 1e6])
def test_what_one_pair_hardly_tells_is_not_believed(vague):
    rng = np.random.default_rng(6)
    sigmas = np.array([7e-4, vague])
    drawn = np.array([pooled_bias(-0.02 + sigmas * rng.standard_normal(2), sigmas) for _ in range(500)])
    assert (np.abs(drawn[:, 0] + 0.02) < 5.0 * 7e-4).all()
    # next to the other, or nothing: where a phase does not vary, its bias is an offset
    assert (drawn[:, 1] <= 0.0).all() and (drawn[:, 1] > -0.05).all()
    assert (drawn[:, 1] == 0.0).all() == (vague > 0.02)


def test_few_windows_tell_nothing():
    rng = np.random.default_rng(7)

    def matched(count):
        a = np.column_stack([np.arange(count), np.arange(count)]).astype(float)
        covariance = np.broadcast_to(1e-4 * np.eye(2), (count, 2, 2))
        return lambda _: SimpleNamespace(
            b=a + 0.01 * rng.standard_normal((count, 2)),
            kept=np.ones(count, dtype=bool),
            covariance_px=covariance,
        )

    through = gradient_filter()
    assert (phase_bias(matched(49), through, rng.uniform(0.0, 1.0, (49, 2)))[1] == np.inf).all()
    assert (phase_bias(matched(60), through, rng.uniform(0.0, 1.0, (60, 2)))[1] < 0.02).all()


@pytest.mark.parametrize("count", [0, 7, PHASE_WINDOWS, PHASE_WINDOWS + 1, 45_000])
def test_windows_that_tell_the_bias_lie_in_stretches_from_the_first_to_the_last(count):
    some = in_stretches(count)
    assert len(some) == min(count, PHASE_WINDOWS)
    assert (np.diff(some) > 0).all()
    if count:
        assert (some[0], some[-1]) == (0, count - 1)
    assert (np.diff(some) > 1).sum() <= PHASE_STRETCHES - 1
