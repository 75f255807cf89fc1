"""Information of a layout against the least squares it stands for, and its blind spots against arithmetic."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.motion.layout.information import (
    RowNoise,
    blind_frequencies_of,
    common_lags,
    images_worth,
    information,
    worst_case,
)

S1 = np.array([0.0, 0.1500, 0.1574, 0.1722])
FREQUENCY = np.array([0.3, 6.0, 47.0, 121.0, 133.5])


def by_least_squares(f, positions, sigma):
    """Schur complement of the ground: n images see the motion at phase z_k, and the ground, with errors."""
    z = np.exp(2j * np.pi * f * positions)
    rows = np.stack([z, np.ones(len(z))], axis=1) / np.asarray(sigma)[:, None]
    normal = rows.conj().T @ rows
    return float((normal[0, 0] - normal[0, 1] * normal[1, 0] / normal[1, 1]).real)


@pytest.mark.parametrize("sigma", [(0.02,) * 4, (0.02, 0.02, 0.05, 0.01)])
def test_it_is_what_least_squares_leaves_after_the_ground_is_eliminated(sigma):
    expected = [by_least_squares(f, S1, sigma) for f in FREQUENCY]
    # near zero the complement is the difference of two numbers 1e4 times as large: 1e-11 of it is lost
    assert information(FREQUENCY, S1, RowNoise(sigma, 1e-3)) == pytest.approx(expected, rel=1e-9)


def test_equal_images_tell_n_less_the_square_of_their_sum_over_n():
    total = np.exp(2j * np.pi * FREQUENCY[:, None] * S1).sum(axis=1)
    expected = (4.0 - np.abs(total) ** 2 / 4.0) / 0.02**2
    assert information(FREQUENCY, S1, RowNoise((0.02,) * 4, 1e-3)) == pytest.approx(expected, rel=1e-9)


def test_pairs_taken_for_independent_would_claim_n_halves_of_the_truth():
    # six pairs, each of variance 2 s^2: sum of |z_a - z_b|^2 / (2 s^2) = (n / 2) J, twice for n = 4
    z = np.exp(2j * np.pi * FREQUENCY[:, None] * S1)
    naive = sum(np.abs(z[:, a] - z[:, b]) ** 2 for a, b in combinations(range(4), 2)) / (2.0 * 0.02**2)
    assert naive == pytest.approx(2.0 * information(FREQUENCY, S1, RowNoise((0.02,) * 4, 1e-3)), rel=1e-9)


def test_two_images_have_the_transfer_of_their_lag_over_the_variance_of_a_match():
    noise = RowNoise.alike(2, 0.03, 1e-3)
    expected = 4.0 * np.sin(np.pi * FREQUENCY * 0.02) ** 2 / 0.03**2
    assert information(FREQUENCY, [0.0, 0.02], noise) == pytest.approx(expected, rel=1e-9)


def test_an_image_that_sees_nothing_adds_nothing_and_a_shift_or_mirror_changes_nothing():
    three = information(FREQUENCY, S1[:3], RowNoise((0.02,) * 3, 1e-3))
    poor = information(FREQUENCY, S1, RowNoise((0.02, 0.02, 0.02, 2e3), 1e-3))
    assert poor == pytest.approx(three, rel=1e-6)
    assert images_worth(FREQUENCY, 3.0 - S1) == pytest.approx(images_worth(FREQUENCY, S1), rel=1e-9)


def test_a_window_multiplies_it_by_the_square_of_its_gain():
    noise = RowNoise((0.02,) * 4, 5e-3, 5e-3)
    ratio = information(FREQUENCY, S1, noise) / information(FREQUENCY, S1, RowNoise((0.02,) * 4, 5e-3))
    assert ratio == pytest.approx(np.sinc(FREQUENCY * 5e-3) ** 2, rel=1e-12)


def test_the_worst_case_of_s1s_example_is_near_133_hz_where_all_lags_are_whole_periods():
    # by hand: 7.4, 14.8 and 22.2 ms vanish at 135.1 Hz, 172.2 ms at 133.6 Hz
    f = np.arange(40.0, 150.0, 1e-3)
    value, at = worst_case(S1, (40.0, 150.0), RowNoise((1.0,) * 4, 1e-3))
    assert value == pytest.approx(float(images_worth(f, S1).min()), rel=1e-5)
    assert at == pytest.approx(float(f[images_worth(f, S1).argmin()]), abs=2e-3)
    assert 133.0 < at < 134.0 and value < 0.03


def test_a_comb_is_blind_at_the_inverse_of_its_step_and_its_multiples_alone():
    found = blind_frequencies_of(0.0052 * np.arange(4), 400.0)
    assert [blind.frequency for blind in found] == pytest.approx([1 / 0.0052, 2 / 0.0052], rel=1e-4)
    assert all(blind.share < 1e-4 for blind in found)


def test_common_lags_are_named_with_their_ratio_and_frequency():
    (found,) = [common for common in common_lags(S1, 150.0) if len(common.pairs) == 6]
    lags = [S1[b] - S1[a] for a, b in found.pairs]
    assert sorted(found.periods) == [1, 2, 3, 20, 21, 23]
    assert found.frequency == pytest.approx(133.5, abs=0.1)
    departure = np.abs(found.frequency * np.array(lags) - found.periods)
    assert departure.max() == pytest.approx(found.mismatch) and found.mismatch < 0.05


def test_lags_out_of_step_have_nothing_in_common():
    # 1 : sqrt 2 : 1 + sqrt 2 is 0.07 of a period or more from whole below the fifth period of the first
    assert common_lags([0.0, 0.01, 0.01 * (1.0 + np.sqrt(2.0))], 190.0) == ()


@pytest.mark.parametrize(
    ("positions", "noise", "message"),
    [
        ([0.0], RowNoise((1.0,), 1e-3), "two or more"),
        ([0.0, np.nan], RowNoise((1.0, 1.0), 1e-3), "finite"),
        ([0.0, 1.0], RowNoise((1.0,), 1e-3), "1 images"),
    ],
)
def test_what_is_no_layout_is_refused(positions, noise, message):
    with pytest.raises(InputError, match=message):
        information(FREQUENCY, positions, noise)


@pytest.mark.parametrize("passband", [(150.0, 40.0), (0.0, 40.0), (40.0, float("inf")), (40.0,)])
def test_what_is_no_passband_is_refused(passband):
    with pytest.raises(InputError, match="passband"):
        worst_case(S1, passband, RowNoise((1.0,) * 4, 1e-3))
