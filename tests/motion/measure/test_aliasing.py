"""What aliasing makes of matches, taken off as a finer image shows it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from sightline.imaging.reduce import averaged
from sightline.imaging.source import ArrayImage
from sightline.imaging.warp import WarpedImage
from sightline.matching.match_images import match_images
from sightline.motion.measure.aliasing import folding

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
