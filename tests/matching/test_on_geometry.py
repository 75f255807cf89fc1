"""The front of matching: found where the scene is, as well as stated, each image with its share of the error.

The scene is a sum of waves, known at any place: images of it need no resampling.
"""

from __future__ import annotations

import numpy as np
import pytest

from sightline.imaging.source import ArrayImage
from sightline.matching.matches import OUTSIDE, Matches
from sightline.matching.on_geometry import FoundWindows, PairOnGeometry, lattice_points, middle_of, within
from sightline.matching.select import grid_points
from sightline.matching.whitening import pair_whitening

SIZE, WINDOW, NOISE = 330, (16, 16), 0.03
#: Turn (rad), growth and shift (px) of each partner against the hub, and what the geometry is off by (px).
VIEWS = ((0.05, 1.0, (6.0, -4.0)), (-0.3, 1.08, (60.0, -30.0)), (0.12, 0.95, (-12.0, 25.0)))
OFF = np.array([0.3, -0.4])


def scene(places: np.ndarray) -> np.ndarray:
    """Values (N,) of 160 waves of power 1/f^2, up to 0.28 cycles per px, at places (N, 2)."""
    rng = np.random.default_rng(7)
    f, angle, phase = (
        rng.uniform(0.02, 0.28, 160),
        rng.uniform(0.0, np.pi, 160),
        rng.uniform(0.0, 2 * np.pi, 160),
    )
    k = 2.0 * np.pi * f * np.stack([np.sin(angle), np.cos(angle)])
    out = np.zeros(len(places))
    for n in range(160):
        out += np.cos(places @ k[:, n] + phase[n]) / np.sqrt(f[n])
    return out / out.std()


def view(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and shift: the partner shows at ``matrix @ p + shift`` what the hub shows at p."""
    turn, growth, shift = VIEWS[number]
    c, s = np.cos(turn), np.sin(turn)
    return growth * np.array([[c, -s], [s, c]]), np.array(shift)


@pytest.fixture(scope="module")
def pairs():
    """A hub with three partners, by a geometry that is off."""
    rng = np.random.default_rng(3)
    every = lattice_points((SIZE, SIZE), SIZE)

    def taken(places: np.ndarray) -> ArrayImage:
        return ArrayImage((scene(places) + NOISE * rng.standard_normal(len(places))).reshape(SIZE, SIZE))

    hub, out = taken(every), []
    for number in range(len(VIEWS)):
        matrix, shift = view(number)

        def geometry(pixels, height=0.0, /, matrix=matrix, shift=shift):
            return pixels @ matrix.T + shift + OFF + height * np.array([0.0, 0.01])

        out.append(PairOnGeometry(hub, taken((every - shift) @ np.linalg.inv(matrix).T), geometry))
    return out


def found_in(pair, *, laid):
    points = grid_points((SIZE, SIZE), window=WINDOW)
    image = pair.laid() if laid else None
    whitening = pair_whitening(pair.hub, pair.laid(), points, tile=(32, 32))
    return pair.found(points, window=WINDOW, search_px=(1, 1), whitening=whitening, laid=image)


@pytest.mark.parametrize("laid", [True, False])
def test_windows_lie_where_the_scene_is_as_well_as_stated_and_share_the_hub(pairs, laid):
    errors, hubs = [], []
    for number, pair in enumerate(pairs):
        matrix, shift = view(number)
        found = found_in(pair, laid=laid)
        kept = found.matches.kept
        error = found.matches.b - found.matches.a @ matrix.T - shift
        assert kept.sum() > 150
        assert np.sqrt((error[kept] ** 2).mean()) < 0.02  # 16 x 16 px of S/N 33
        white = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.matches.covariance_px), error)[kept]
        # 2 x 150 numbers and more: 8 % of chance; the matcher's covariance is good to some per cent more
        assert 0.7 < white.mean() / 2.0 < 1.3
        own, hub = found.variances()
        # the two shares, both in pixels of the hub, are the whole
        whole = 0.5 * np.trace(found.hub_covariance_px, axis1=1, axis2=2)
        assert np.allclose((own / np.linalg.det(matrix) + hub)[kept], whole[kept], rtol=1e-6)
        errors.append(np.where(kept[:, None], error @ np.linalg.inv(matrix).T, np.nan))
        hubs.append(np.where(kept, hub, np.nan))
    shared = [np.nanmean(errors[a] * errors[b]) for a, b in ((0, 1), (0, 2), (1, 2))]
    # products of errors that share half their variance scatter by 1.1 variances: 300 of each of three pairs,
    # whose chances are half in common, 11 % of the half, and the covariance is good to 15 %
    assert 0.6 < np.mean(shared) / np.nanmean(hubs) < 1.4


def test_what_was_found_corrects_the_geometry(pairs):
    found = found_in(pairs[1], laid=True).matches
    after = pairs[1].after(found.a[found.kept], found.b[found.kept])
    matrix, shift = view(1)
    places = found.a[found.kept]
    before = pairs[1].where(places) - places @ matrix.T - shift
    assert np.allclose(before, OFF)
    assert np.abs(after.where(places) - places @ matrix.T - shift).max() < 0.03
    assert np.allclose(after.turn(places), matrix, atol=2e-3)


def test_reduced_images_go_by_the_same_geometry(pairs):
    matrix, shift = view(0)
    pair = PairOnGeometry(pairs[0].hub, pairs[0].partner, lambda p, height=0.0: 3.1 * p)
    alike, factor = pair.alike(np.array([[100.0, 100.0]]), 16)
    assert (factor, alike.hub.shape, alike.partner.shape) == (1, (SIZE, SIZE), (SIZE // 3, SIZE // 3))
    # pixel 5 of the hub lies at 15.5 of the partner, and pixel 5 of its means by three about 16
    assert np.allclose(alike.where(np.full((1, 2), 5.0)), (15.5 - 1.0) / 3.0)
    both = pairs[0].reduced(2)
    # pixel (4, 10) of means of two is centred at (8.5, 20.5)
    there = matrix @ [8.5, 20.5] + shift + OFF
    assert np.allclose(both.where(np.array([[4.0, 10.0]])), (there - 0.5) / 2.0)


def test_heights_move_what_is_seen_and_what_is_not_seen_is_said(pairs):
    points = np.array([[100.0, 120.0], [np.nan, 1.0], [3.0, 3.0], [300.0, 320.0]])
    assert np.allclose(pairs[0].reach(points[[0, 2]], 200.0), [0.0, 2.0])
    found = pairs[0].found(points, window=WINDOW, whitening=None).matches
    assert found.kept[0]
    assert (found.status[1:] == OUTSIDE).all()
    assert np.isnan(pairs[0].where(points)[1]).all()
    assert pairs[0].inside(points[[0, 2]]).tolist() == [True, False]  # (3, 3) lies 4 px left of the partner


def test_places_within_an_image_and_the_middle_of_some():
    places = np.array([[0.0, 0.0], [9.0, 19.0], [9.1, 3.0], [np.nan, 3.0], [5.0, 18.5]])
    assert within(places, (10, 20)).tolist() == [True, True, False, False, True]
    assert within(places, (10, 20), 1.0).tolist() == [False, False, False, False, False]
    assert within(places, (10, 20), -0.5).tolist() == [True, True, True, False, True]
    assert lattice_points((3, 9), 5).tolist()[:6] == [[0, 0], [0, 2], [0, 4], [0, 6], [0, 8], [1, 0]]
    assert middle_of(places[[0, 1, 4]]).tolist() == [[5.0, 18.5]]


def test_a_map_that_is_flat_finds_nothing(pairs):
    # all that a line shows falls in one pixel: there is no way back
    pair = PairOnGeometry(pairs[0].hub, pairs[0].partner, lambda p, height=0.0, /: p * [1.0, 0.0] + 90.0)
    points = grid_points((SIZE, SIZE), window=WINDOW)[:4]
    for laid in (None, pair.laid()):
        found = pair.found(points, at=points, window=WINDOW, whitening=None, laid=laid)
        assert not found.matches.kept.any()


def test_the_hub_has_its_share_of_the_error_by_how_large_the_partner_shows_the_scene():
    """Noise of one strength in pixels of each: with four pixels of the partner to one of the hub, of the five
    parts of an error one is the partner's."""
    covariance = np.array([0.01 * np.eye(2), 0.04 * np.eye(2)])
    turn = np.array([np.eye(2), [[0.0, -2.0], [2.0, 0.0]]])
    places = np.zeros((2, 2))
    matches = Matches(places, places, covariance, np.ones(2), np.zeros(2, np.uint8))
    hub = np.array([0.01 * np.eye(2), 0.01 * np.eye(2)])
    own, of_hub = FoundWindows(matches, hub, turn, 0.5).variances()
    assert own == pytest.approx([0.005, 0.04 / 5.0]) and of_hub == pytest.approx([0.005, 0.01 * 4.0 / 5.0])
