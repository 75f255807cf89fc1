import numpy as np
import pytest

from sightline.errors import InputError, SpanError
from sightline.evaluation.score import effective_samples, remove_directions, score_motion, words_of_hidden

T = np.linspace(0.0, 2.0, 4001)


def truth_angles(t):
    return 1e-5 * np.stack([np.sin(3 * t), np.cos(5 * t), t**2], axis=1)


def scored(error, sigma, **options):
    return score_motion(T, truth_angles(T) + error, sigma, T, truth_angles(T), **options)


def test_a_constant_per_axis_costs_nothing():
    score = scored(np.array([1e-3, -2e-3, 5e-3]) + 0.0 * T[:, None], np.full((4001, 3), 1e-7))
    for axis in score.axes.values():
        assert axis.rms == pytest.approx(0.0, abs=1e-9)
        assert axis.coverage_95 == 1.0
    assert score.hidden == ("constant roll", "constant pitch", "constant yaw")


def test_white_errors_of_the_stated_sigma_score_one():
    rng = np.random.default_rng(0)
    sigma = 1e-6 * (1.0 + 0.5 * np.sin(T))[:, None] * np.array([1.0, 2.0, 3.0])
    score = scored(sigma * rng.standard_normal((4001, 3)), sigma)
    for axis in score.axes.values():
        # 4001 independent samples: sd of the NEES sqrt(2/4001) = 0.022, of the coverage 0.0034.
        assert axis.nees == pytest.approx(1.0, abs=0.09)
        assert axis.coverage_95 == pytest.approx(0.95, abs=0.014)
        assert axis.effective_samples == pytest.approx(4001, rel=0.1)
        assert (axis.nees_low, axis.nees_high) == pytest.approx((0.957, 1.044), abs=0.005)
        assert axis.unit == "urad"


def test_roll_and_pitch_are_in_pixels_and_yaw_in_pixels_at_the_edge():
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * 40 * T)[:, None] * np.ones(3)
    score = scored(1e-6 * wave, np.full((4001, 3), 2e-6), ifov=5e-6, half_field_px=500.0)
    assert score.roll.rms == pytest.approx(0.2, rel=1e-3)
    # Samples 0.5 ms apart miss the crest by up to 0.25 ms: (2 pi 40 * 0.25e-3)^2 / 2 = 2e-3.
    assert score.pitch.max == pytest.approx(0.2 * np.sqrt(2), rel=2e-3)
    assert score.yaw.rms == pytest.approx(5e-4, rel=1e-3)
    assert score.roll.sigma == pytest.approx(0.4)
    assert score.yaw.unit == "px at the field edge"
    assert score.roll.nees == pytest.approx(0.25, rel=1e-3)


def test_a_hidden_direction_that_ties_two_axes_is_removed_from_both_together():
    u = T - T.mean()
    tied = np.zeros((4001, 3, 4))
    tied[:, 0, 0] = tied[:, 1, 1] = tied[:, 2, 2] = 1.0
    tied[:, 2, 3], tied[:, 0, 3] = u, 0.005 * u**2
    along = 1e-4 * tied[:, :, 3]
    sigma = np.full((4001, 3), 1e-7)
    assert scored(along, sigma, hidden=tied).yaw.rms == pytest.approx(0.0, abs=1e-9)
    assert scored(along, sigma, hidden=tied).roll.rms == pytest.approx(0.0, abs=1e-9)
    # A drift of yaw without its roll is not the hidden motion, and is not forgiven altogether.
    alone = along.copy()
    alone[:, 0] = -along[:, 0]
    left = scored(alone, sigma, hidden=tied)
    assert left.roll.rms > 1.9 * 1e6 * np.std(along[:, 0])


def test_hidden_directions_are_named_with_what_they_bring_on_other_axes():
    rate = 6800.0 / 680e3  # V / H, 1/s
    directions = np.zeros((4001, 3, 5))
    directions[:, 0, 0] = 1.0
    directions[:, 1, 0] = 1e-4 * np.sin(T)  # of no size beside the constant
    directions[:, 2, 1], directions[:, 0, 1] = 1.0, -rate * T  # the crab angle: docs/theory/s1.md (21)
    directions[:, 2, 2], directions[:, 0, 2] = T, -0.5 * rate * T**2  # (22)
    directions[:, 1, 3], directions[:, 2, 3] = T - 1.0, 30.0 * np.sin(9.0 * T)
    directions[:, 2, 4] = T
    names = ("constant of roll", "constant of yaw", "drift of yaw", "drift of pitch", "drift of yaw")
    said = words_of_hidden(names, T, directions, ifov=5e-6, half_field_px=500.0)
    assert said == (
        "constant of roll",
        "constant of yaw (with a drift of roll)",
        "drift of yaw (with a parabola of roll)",
        "drift of pitch (with a curve of yaw)",
        "drift of yaw",
    )
    assert words_of_hidden(("drift of yaw",), T[:2], directions[:2, :, 2:3]) == ("drift of yaw",)


def test_the_truth_may_be_sampled_otherwise_than_the_result():
    t = np.linspace(-0.01, 2.01, 2021)
    score = score_motion(T, truth_angles(T), np.full((4001, 3), 1e-7), t, truth_angles(t))
    # Local cubics on 1 ms of a 5 rad/s wave: 3/128 (5e-3)^4 of 10 urad.
    assert max(axis.max for axis in score.axes.values()) < 1e-6


def test_directions_that_repeat_each_other_do_no_harm():
    directions = np.ones((50, 3, 2)) * np.array([1.0, 3.0])
    directions = np.concatenate([directions, np.zeros((50, 3, 1))], axis=2)
    assert remove_directions(np.full((50, 3), 7.0), directions) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_effective_samples_of_an_autoregressive_series(rho):
    rng = np.random.default_rng(1)
    x = rng.standard_normal(200_000)
    for k in range(1, len(x)):
        x[k] = rho * x[k - 1] + np.sqrt(1 - rho**2) * x[k]
    # The mean of x^2 has the correlation rho^2k: n (1 - rho^2) / (1 + rho^2). The estimate of 5 correlation
    # times of noisy terms scatters by about sqrt(4 * 5 tau / n) = 2 % at most, and lacks e^-5 of the sum.
    assert effective_samples(x) == pytest.approx(len(x) * (1 - rho**2) / (1 + rho**2), rel=0.06)


def test_the_range_of_the_nees_holds_95_draws_in_100():
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(400):
        x = np.convolve(rng.standard_normal(2040), np.ones(40) / np.sqrt(40), mode="valid")[:2000]
        t = np.arange(2000.0)
        score = score_motion(t, np.stack([x, x, x], 1), np.ones((2000, 3)), t, np.zeros((2000, 3)))
        inside += score.roll.nees_low <= score.roll.nees <= score.roll.nees_high
    # Binomial, sd 1.1 %; the removed mean and the scatter of the effective number take a few per cent.
    assert inside / 400 == pytest.approx(0.95, abs=0.07)


def test_a_truth_that_is_too_short_is_refused():
    with pytest.raises(SpanError, match="give a truth that covers every line of the result"):
        score_motion(T, truth_angles(T), np.ones((4001, 3)), T[:-5], truth_angles(T)[:-5])


def test_a_sigma_of_zero_is_refused():
    with pytest.raises(InputError, match="`sigma` must be positive on every line; line 0"):
        scored(0.0, np.zeros((4001, 3)))


def test_pixels_without_the_width_of_the_field_are_refused_with_the_remedy():
    with pytest.raises(InputError, match="give half the number of columns"):
        scored(0.0, np.ones((4001, 3)), ifov=5e-6)


def test_what_is_hidden_leaves_a_motion_of_many_lines_as_it_leaves_one_of_few(monkeypatch):
    n, t = 1000, np.linspace(-1.0, 1.0, 1000)
    rng = np.random.default_rng(3)
    # a constant and a drift per axis that bend another, one of them twice, one that is nothing
    directions = np.zeros((n, 3, 8))
    for axis in range(3):
        directions[:, axis, axis], directions[:, axis, 3 + axis] = 1.0, t
        directions[:, (axis + 1) % 3, 3 + axis] = 0.1 * t**2
    directions[:, :, 6] = -2.0 * directions[:, :, 4]
    unit = np.array([1e-6, 3e-6, 1e-3])
    values = rng.normal(size=(n, 3)) + 50.0 * directions[:, :, 3] / unit
    whole = remove_directions(values, directions, unit)
    monkeypatch.setattr("sightline.evaluation.score.AT_ONCE", 64)
    pieces = remove_directions(values, directions, unit)
    # rounding of values up to 5e7 in sums of 3000 of them
    assert pieces == pytest.approx(whole, abs=1e-6)
    # of 3000 values of white noise seven are fitted
    assert np.std(pieces) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("lines", [64, 65, 200])
def test_where_nothing_is_hidden_a_motion_of_any_length_stays_as_it_is(monkeypatch, lines):
    monkeypatch.setattr("sightline.evaluation.score.AT_ONCE", 64)
    values = np.random.default_rng(4).normal(size=(lines, 3))
    assert np.array_equal(remove_directions(values, np.zeros((lines, 3, 0)), np.full(3, 1e-6)), values)
