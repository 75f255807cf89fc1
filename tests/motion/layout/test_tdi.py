"""Layouts of TDI images: what is averaged away, against the ground eliminated from the images."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest

from sightline.applications.focal_plane import FocalPlane, NamedLayout, choose_layout
from sightline.errors import InputError
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.motion.layout.information import RowNoise, blind_frequencies_of, information
from sightline.motion.layout.search import Candidates, search_layouts
from sightline.motion.layout.sigma import harmonic_sigma, smoother_sigma

PERIOD = 1e-3
T = np.array([0.0, 0.007, 0.019])


def eliminated(f, t, sigma, tdi):
    """Information on a motion exp(2 i pi f t) of unknown size, in images of unknown ground.

    Each image shows the ground plus the mean of the motion over its stages; the ground is an unknown of its
    own and leaves by a Schur complement.
    """
    out = []
    within = (np.arange(4000) + 0.5) / 4000 - 0.5
    for frequency in f:
        at = np.asarray(t)[:, None] + np.asarray(tdi)[:, None] * within
        seen = np.exp(2j * np.pi * frequency * at).mean(axis=1)
        design = np.stack([seen, np.ones(len(t))], axis=1) / np.asarray(sigma)[:, None]
        normal = design.conj().T @ design
        out.append((normal[0, 0] - abs(normal[0, 1]) ** 2 / normal[1, 1]).real)
    return np.array(out)


@pytest.mark.parametrize("tdi", [(0.016,) * 3, (0.008, 0.016, 0.004), (0.0, 0.016, 0.016)])
def test_information_is_what_eliminating_the_ground_leaves(tdi):
    f, sigma = np.linspace(1.0, 300.0, 150), (0.02, 0.03, 0.05)
    found = information(f, T, RowNoise(sigma, PERIOD, tdi=tdi))
    assert found == pytest.approx(eliminated(f, T, sigma, tdi), rel=1e-6, abs=1e-3)


def test_equal_stages_are_a_factor_and_their_zeros_are_blind():
    f, noise = np.linspace(1.0, 300.0, 150), RowNoise((0.02,) * 3, PERIOD)
    averaged = information(f, T, replace(noise, tdi=(0.016,) * 3))
    assert averaged == pytest.approx(np.sinc(0.016 * f) ** 2 * information(f, T, noise))
    blind = np.array([b.frequency for b in blind_frequencies_of(T, 200.0, (0.016,) * 3)])
    for k in (1, 2, 3):  # k / (N T): 62.5, 125, 187.5 Hz
        assert np.abs(blind - k * 62.5).min() < 0.1
    assert not any(abs(b.frequency - 62.5) < 2.0 for b in blind_frequencies_of(T, 200.0))


@pytest.mark.parametrize("exhaustive", [True, False])
def test_the_search_places_images_of_unlike_stages(exhaustive):
    band, tdi = (40.0, 150.0), (0.002, 0.005, 0.002)
    noise, candidates = RowNoise((1.0,) * 3, PERIOD, tdi=tdi), Candidates.even_grid(0.02, 1e-3, 1e-3)
    found = search_layouts(candidates, noise, band, exhaustive=exhaustive)
    f = np.arange(40.0, 150.01, 0.5)
    worth = {
        (places, order): float(information(f, candidates.t[list(places)], noise.ordered(order)).min())
        for places in combinations(range(21), 3)
        if places[0] == 0
        for order in permutations(range(3))
    }
    best = max(worth.values())
    got = worth[tuple(int(k) for k in found.places[0]), tuple(int(k) for k in found.order[0])]
    # the frequencies of the search are others: 1 % covers the difference
    assert got >= 0.99 * best and found.worst[0] == pytest.approx(best, rel=0.01)


def test_smoother_and_spectrum_agree_on_unlike_stages():
    prior = Spectrum((Matern(1.0, 0.3, "5/2"), Matern(0.1, 0.01, "3/2"), Tone(0.2, 31.0, 0.1)))
    noise, t = RowNoise((0.02,) * 3, 2e-3, tdi=(0.016, 0.008, 0.016)), np.array([0.0, 0.006, 0.040])
    both = [
        (np.sqrt(np.mean(smoother_sigma(t, n, prior, 6.0)[1] ** 2)), harmonic_sigma(t, n, prior, 6.0))
        for n in (noise, replace(noise, tdi=()))
    ]
    # the ends add some per cent, with TDI as without (6 of 6,000 ms more of them)
    assert both[0][0] / both[0][1] == pytest.approx(both[1][0] / both[1][1], rel=0.01)
    assert both[0][1] > 1.05 * both[1][1]


PLANE = FocalPlane(
    2e5, 1e-3, 1000.0, (0.02,) * 3, span_px=40.0, stages=(4, 4, 4), duration=1.0,
    layouts=(NamedLayout("ours", T), NamedLayout("two", T[:2])),
)  # fmt: skip


def test_a_layout_is_judged_with_its_stages():
    with_tdi, without = (choose_layout(p, (40.0, 150.0), count=1) for p in (PLANE, replace(PLANE, stages=())))
    assert with_tdi.best.worst_information < without.best.worst_information
    assert with_tdi.best.harmonic_sigma_px > without.best.harmonic_sigma_px
    at = with_tdi.best.worst_frequency
    assert with_tdi.best.worst_information == pytest.approx(
        float(np.sinc(4e-3 * at) ** 2 * without.best.noise.weights[0] * _worth(with_tdi.best, at))
    )
    assert [own.noise.tdi for own in with_tdi.compared[:2]] == [(4e-3,) * 3, (4e-3,) * 2]
    one = choose_layout(replace(PLANE, stages=(1, 1, 1)), (40.0, 150.0), count=1)
    assert one.best.worst_information == without.best.worst_information


def _worth(layout, f):
    z = np.exp(2j * np.pi * f * layout.positions)
    return len(z) - abs(z.sum()) ** 2 / len(z)


def test_a_band_that_stages_average_away_is_refused():
    with pytest.raises(InputError, match="holds 125 Hz, which TDI of 8 stages averages away in every image"):
        choose_layout(replace(PLANE, stages=(8, 8, 8)), (40.0, 150.0))
    with pytest.raises(InputError, match="holds 125 Hz, which TDI of 8 and 16 stages"):
        choose_layout(replace(PLANE, stages=(8, 16, 8)), (70.0, 150.0))
    # 7 stages see what 8 do not
    assert choose_layout(replace(PLANE, stages=(8, 7, 8)), (40.0, 130.0), count=1).best.worst_images > 0.0
