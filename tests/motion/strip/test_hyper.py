"""Rows collapsed to angle differences, and the priors learned from them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import IFOV, plain_star
from sightline.errors import EstimationError
from sightline.estimation.prior import Matern, Spectrum, TabulatedPsd, Tone
from sightline.motion.strip import estimate as estimates
from sightline.motion.strip import hidden, hyper
from sightline.motion.strip.hyper import (
    BROAD,
    PriorModel,
    _blind_modes,
    _corners_elsewhere,
    _own_share,
    _row_sigma,
    _rows_see,
    _shown,
    _tones_elsewhere,
    angle_differences,
    fit_prior_model,
    window_means,
)
from sightline.motion.strip.joint import JointEstimate, JointPrior
from sightline.motion.strip.normal_equations import GroundOrder, TimeGrid, normal_equations

STEP = 1e-3
SIGMA = 0.05


def estimate_of(star, motion) -> JointEstimate:
    """An estimate that says `motion(t)` -> (N, 3) rad."""
    grid = TimeGrid(0.0, STEP, 600)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()])
    spectrum = Spectrum((Matern(1e-5, 0.1, "3/2"),))
    prior = JointPrior((spectrum.autoregressive(STEP, 4, grid.count),) * 3, np.zeros(0))
    return JointEstimate(grid, motion(grid.nodes), None, np.zeros(0), np.zeros(0), data, prior)


def still(t):
    return np.zeros((len(t), 3))


class TestAveraged:
    def test_without_length_it_is_the_motion_itself(self):
        grid = TimeGrid(0.0, STEP, 100)
        t = np.array([0.0102, 0.0555])
        # cubics are interpolated exactly
        assert_allclose(window_means(grid, (grid.nodes**3)[:, None], t, 0.0)[:, 0], t**3, rtol=1e-9)

    def test_a_sine_is_damped_by_the_sinc_of_the_window(self):
        grid, f, d = TimeGrid(0.0, STEP, 400), 30.0, 0.012
        t = np.linspace(0.05, 0.35, 31)
        got = window_means(grid, np.sin(2 * np.pi * f * grid.nodes)[:, None], t, d)[:, 0]
        want = np.sinc(f * d) * np.sin(2 * np.pi * f * t)
        # a midpoint rule of p = 14 points or so has (pi f d / p)^2 / 6 of it too much, 0.12 %; cubic
        # interpolation less than (2 pi f step)^4 * 9 / 384 = 0.19^4 * 9 / 384 = 3e-5
        assert_allclose(got, want, atol=2e-3)
        assert np.sinc(f * d) < 0.85


class TestDifferences:
    def test_what_the_estimate_explains_is_added_back(self):
        star = plain_star(60, 8, 2, SIGMA)
        rate = np.array([3e-4, -5e-4, 2e-4])
        found = angle_differences([star], [star.residual_px], estimate_of(star, lambda t: t[:, None] * rate))
        assert [one.images for one in found] == [(0, 1), (0, 2)]
        for one, lag in zip(found, (0.02, 0.04), strict=True):
            assert_allclose(one.lag, lag, atol=1e-12)
            assert_allclose(one.angles, np.tile(rate * lag, (60, 1)), rtol=1e-9)
            assert_allclose(one.t, star.t_hub[::8])

    def test_what_is_left_over_is_read_as_a_turn_of_the_partner(self):
        star = plain_star(60, 8, 1, SIGMA)
        turn = np.array([2.0, -3.0, 1.5]) * IFOV * np.linspace(-1, 1, 60)[:, None]
        by = star.by_partner[:, 0].astype(float)
        post = np.einsum("gca,ga->gc", by, np.repeat(turn, 8, axis=0))[:, None]
        (found,) = angle_differences([star], [post], estimate_of(star, still))
        # weak information of 1e2 holds an axis no row sees; yaw has 8 * 0.36 * (800 / 0.05)^2 = 7e8 counts
        assert_allclose(found.angles, turn, atol=1e-6 * np.abs(turn).max())

    def test_their_covariance_is_that_of_weighted_least_squares(self):
        star = plain_star(20, 8, 2, SIGMA)
        weight = np.random.default_rng(0).uniform(0.2, 1.0, star.weight.shape)
        scale = np.diag([1.3, 1.3, 2.0, 2.0])
        star = star.with_weight(weight).with_correlation(scale)
        _, found = angle_differences([star], [star.residual_px], estimate_of(star, still))
        rows = slice(8 * 5, 8 * 6)
        j = star.by_partner[rows, 1].astype(float).reshape(-1, 3)
        w = np.repeat(weight[rows, 1], 2) / (2.0 * SIGMA**2)
        want = np.linalg.inv(j.T @ (w[:, None] * j))
        assert_allclose(found.covariance[5], want, rtol=1e-4, atol=1e-6 * want.max())

    def test_windows_without_weight_count_neither_for_the_angle_nor_for_its_time(self):
        star = plain_star(20, 8, 1, SIGMA)
        post = np.zeros((*star.t.shape, 2))
        post[::8] = 100.0
        weight = np.ones_like(star.weight)
        weight[::8] = 0.0
        star = replace(star, t_hub=star.t_hub + 1e-4 * np.tile(np.arange(8.0), 20))
        (found,) = angle_differences([star.with_weight(weight)], [post], estimate_of(star, still))
        assert_allclose(found.angles, 0.0, atol=1e-12)
        assert_allclose(found.t, star.t_hub.reshape(20, 8)[:, 1:].mean(axis=1))

    def test_pairs_of_a_hub_share_the_numbers_of_their_patches_and_hubs_do_not(self):
        star = plain_star(20, 8, 2, SIGMA)
        other = replace(plain_star(15, 8, 1, SIGMA), hub=1, images=(2,))
        posts = [star.residual_px, other.residual_px]
        first, second, third = angle_differences([star, other], posts, estimate_of(star, still))
        assert first.patch.tolist() == second.patch.tolist() == list(range(20))
        assert third.patch.tolist() == list(range(20, 35)) and third.images == (1, 2)

    def test_relief_that_nobody_knows_is_in_their_covariance(self):
        # 0.01 px of line per metre: a row's mean height of 3 m is pitch, a slope of 2 m at the edge is yaw
        star = plain_star(20, 8, 1, SIGMA)
        per_metre = 0.01
        height = np.zeros_like(star.by_height)
        height[..., 0] = per_metre
        star = replace(star, by_height=height)
        estimate = estimate_of(star, still)
        (known,) = angle_differences([star], [star.residual_px], estimate)
        (found,) = angle_differences([star], [star.residual_px], estimate, (3.0, 2.0))
        grown = found.covariance[4] - known.covariance[4]
        pitch = (per_metre * 3.0 * IFOV) ** 2
        yaw = (per_metre * 2.0 / 800.0) ** 2  # the edge is 800 px from the middle
        assert_allclose(np.diag(grown), [0.0, pitch, yaw], rtol=1e-3, atol=1e-6 * pitch)

    def test_pairs_of_fewer_than_eight_rows_are_left_out(self):
        star = plain_star(7, 8, 1, SIGMA)
        assert angle_differences([star], [star.residual_px], estimate_of(star, still)) == []


def test_one_axis_of_the_differences_keeps_times_and_variances():
    star = plain_star(20, 8, 1, SIGMA, duration=0.002)
    (found,) = angle_differences([star], [star.residual_px], estimate_of(star, still))
    series = found.of_axis(1)
    assert_allclose(series.variance, found.covariance[:, 1, 1])
    assert_allclose(series.lag, found.lag)
    assert series.window == 0.002 and series.images == (0, 1)


def test_the_share_of_a_row_s_error_that_is_no_other_angle_s():
    star = plain_star(20, 8, 1, SIGMA)
    (found,) = angle_differences([star], [star.residual_px], estimate_of(star, still))
    mixed = np.array([[1.0, 0.0, 1.8], [0.0, 1.0, 0.0], [1.8, 0.0, 4.0]])
    # roll and yaw correlate by 0.9: given the other, 0.19 of the variance is left; unseen rows do not count
    covariance = np.tile(mixed, (20, 1, 1))
    covariance[:5] = np.diag([np.inf, 1.0, np.inf])
    assert_allclose(_own_share([replace(found, covariance=covariance)]), [0.19, 1.0, 0.19], rtol=1e-9)
    blind = np.tile(np.diag([np.inf, 1.0, np.inf]), (20, 1, 1))
    assert_allclose(_own_share([replace(found, covariance=blind)]), 1.0)


class TestPriorModel:
    def test_pixels_become_angles_and_yaw_counts_at_the_field_edge(self):
        scaled = BROAD.scaled(5e-6, 8e-4)
        ratio = [s.sigma / b.sigma for s, b in zip(scaled.spectra, BROAD.spectra, strict=True)]
        assert_allclose(ratio, [5e-6, 5e-6, 5e-6 / 8e-4])

    def test_a_turn_about_the_line_of_sight_is_no_smaller_than_those_across_it(self):
        roll = Spectrum((Matern(2e-6, 1.0, "5/2"), Matern(1e-7, 0.01, "3/2")))
        pitch = Spectrum((Matern(5e-6, 1.0, "5/2"), Matern(1e-7, 0.02, "3/2"), Tone(1e-6, 47.0, 1.0)))
        unseen = Spectrum((Matern(1e-9, 1.0, "5/2"), Matern(1e-9, 0.01, "3/2")))
        assert PriorModel((roll, pitch, unseen)).with_turns(0.7).spectra == (roll, pitch, pitch)
        # an unseen roll stays: shifts of the whole image are seen, or hidden, in any field
        large = Spectrum((Matern(4e-3, 1.0, "5/2"), Matern(1e-4, 0.01, "3/2")))
        assert PriorModel((unseen, pitch, large)).with_turns(0.7).spectra == (unseen, pitch, large)

    def test_drifts_are_compared_by_how_far_they_bend_over_the_strip(self):
        jitter = Matern(1e-7, 0.01, "3/2")
        # a drift of 4 s bends as sigma / timescale^2: 16 times less than its sigma says
        roll = Spectrum((Matern(2e-6, 1.0, "5/2"), jitter))
        pitch = Spectrum((Matern(4e-6, 4.0, "5/2"), jitter))
        yaw = Spectrum((Matern(3e-6, 4.0, "5/2"), jitter))
        assert PriorModel((roll, pitch, yaw)).with_turns(0.7).spectra == (roll, pitch, roll)
        long = PriorModel((roll, pitch, yaw)).with_turns(100.0)
        assert long.spectra == (roll, pitch, pitch)

    def test_beside_unknown_relief_pitch_drifts_no_less_than_roll(self):
        jitter, tone = Matern(1e-7, 0.01, "3/2"), Tone(1e-6, 47.0, 1.0)
        roll = Spectrum((Matern(2e-6, 1.0, "5/2"), jitter))
        still = Spectrum((Matern(1e-7, 1.0, "5/2"), jitter, tone))
        found = PriorModel((roll, still, still), (1.0, 2.0, 1.0)).beside_relief(4.0)
        # its own jitter and tones stay, and yaw, which relief does not imitate alike, is left alone
        assert found.spectra == (roll, Spectrum((roll.components[0], jitter, tone)), still)
        assert found.noise_scale == (1.0, 2.0, 1.0)
        assert PriorModel((still, roll, still)).beside_relief(4.0).spectra == (still, roll, still)
        # in a strip of 1 s it may be as quick as half of it, and bends as far
        quick = PriorModel((roll, still, still)).beside_relief(1.0).spectra[1].components[0]
        assert quick.timescale == 0.5
        lags = np.array([0.0, 0.5, 1.0])
        bends = [c.autocovariance(lags) @ [6.0, -8.0, 2.0] for c in (quick, roll.components[0])]
        assert bends[0] == pytest.approx(bends[1])

    def test_tones_of_one_strip_are_the_same_within_its_resolution(self):
        drift = (Matern(2e-6, 1.0, "5/2"), Matern(1e-7, 0.01, "3/2"))
        still = (Matern(1e-9, 1.0, "5/2"), Matern(1e-9, 0.01, "3/2"))
        pitch, yaw = Spectrum((*drift, Tone(1e-6, 47.0, 1.0))), Spectrum((*still, Tone(1e-7, 48.0, 1.0)))
        # 1 Hz apart: one mode in a strip of 0.7 s, two in one of 3 s
        for length, expected in ((0.7, [47.0]), (3.0, [47.0, 48.0])):
            turns = PriorModel((pitch, pitch, yaw)).with_turns(length).spectra[2]
            assert [tone.frequency for tone in turns.tones] == expected

    def test_the_corner_of_jitter_below_the_rows_noise_is_that_of_the_axis_that_shows_it(self):
        def jitter(sigma, timescale):
            return Spectrum((Matern(1.0, 1.0, "5/2"), Matern(sigma, timescale, "3/2")))

        spectra = [jitter(0.1, 0.001), jitter(0.1, 0.010), jitter(0.1, 0.001)]
        corner = Matern(0.1, 0.010, "3/2").corner
        assert _corners_elsewhere(spectra, _shown(spectra, [0.05, 0.01, np.inf])) == [corner, None, corner]
        assert _corners_elsewhere(spectra, _shown(spectra, [0.02, 0.01, 0.02])) == [None, None, None]
        # nobody shows it
        assert _corners_elsewhere(spectra, _shown(spectra, [0.2, 0.2, 0.2])) == [None, None, None]

    def test_the_noise_of_a_row_is_that_of_rows_that_see_the_angle(self):
        # of a detector one window wide most rows see no roll: what the others err by counts, however few
        covariance = np.tile(np.diag([4.0, 1.0, np.inf]), (10, 1, 1))
        covariance[:7, 0, 0] = np.inf
        some = [SimpleNamespace(covariance=covariance)]
        assert [_row_sigma(some, axis) for axis in range(3)] == [2.0, 1.0, np.inf]
        assert [_rows_see(some, axis) for axis in range(3)] == [0.3, 1.0, 0.0]

    def test_tones_of_other_axes_that_an_axis_does_not_have_are_named_once(self):
        drift = (Matern(1.0, 1.0, "5/2"), Matern(0.1, 0.01, "3/2"))
        tones = [
            Spectrum((*drift, *(Tone(0.1, f, 1.0) for f in fs))) for fs in ((47.0, 83.0), (47.6,), (121.0,))
        ]
        named = [[tone.frequency for tone in _tones_elsewhere(tones, axis, 2.0)] for axis in range(3)]
        assert named == [[121.0], [83.0, 121.0], [47.0, 83.0]]

    def test_a_tone_of_another_axis_is_as_large_as_others_that_both_have_let_expect(self):
        drift = (Matern(9.0, 1.0, "5/2"), Matern(0.1, 0.01, "3/2"))
        roll = Spectrum((*drift, Tone(0.3, 47.0, 0.1), Tone(0.2, 83.0, 0.2)))
        yaw = Spectrum((*drift, Tone(0.9, 47.1, 0.1)))
        alone = Spectrum(drift)
        (tone,) = _tones_elsewhere((roll, alone, yaw), 2, 1.0)
        assert (tone.sigma, tone.frequency, tone.bandwidth) == pytest.approx((0.6, 83.0, 0.2))
        # of an axis that shares none with another nothing is known
        assert [tone.sigma for tone in _tones_elsewhere((roll, alone, alone), 2, 1.0)] == [9.0, 9.0]
        # one that has tones, if others, is as large as these: of pitch with tones of .07 and .11 px one of a
        # yaw (96 Hz, beside a blind frequency) had been 7 px beforehand, sigma of pitch five times too large
        other = Spectrum((*drift, Tone(0.4, 120.0, 0.1), Tone(0.1, 200.0, 0.1)))
        assert [tone.sigma for tone in _tones_elsewhere((roll, alone, other), 2, 1.0)] == [0.4, 0.4]

    def test_its_processes_have_the_variance_of_their_spectra(self):
        spectra = tuple(Spectrum((Matern(s, 0.05, "3/2"),)) for s in (1.0, 2.0, 3.0))
        grid = TimeGrid(0.0, STEP, 30)
        for process, spectrum in zip(PriorModel(spectra).processes(grid), spectra, strict=True):
            ab = process.precision_band()
            lower = sum(np.diag(ab[d, : 30 - d], -d) for d in range(len(ab)))
            covariance = np.linalg.inv(lower + np.tril(lower, -1).T)
            # the nugget, below 1e-6 of the variance, and rounding of an inverse of condition 1e6
            assert_allclose(np.diag(covariance), spectrum.sigma**2, rtol=1e-4)

    def test_the_strength_of_the_motion_is_learned_from_rows_that_saw_it(self):
        # roll jitters by 3 px; the whole of it is left over (the estimate says nothing moves)
        rng = np.random.default_rng(1)
        star = plain_star(125, 8, 2, SIGMA)
        truth = Spectrum((Matern(3 * IFOV, 0.02, "3/2"),))
        t = np.unique(np.concatenate([star.t_hub, star.t.ravel()]).round(9))
        k = truth.autocovariance(np.abs(np.subtract.outer(t, t)).ravel()).reshape(len(t), len(t))
        roll = np.linalg.cholesky(k + 1e-10 * k[0, 0] * np.eye(len(t))) @ rng.standard_normal(len(t))
        moved = np.interp(star.t, t, roll) - np.interp(star.t_hub, t, roll)[:, None]
        post = SIGMA * rng.standard_normal((*star.t.shape, 2))
        post[..., 1] -= moved / IFOV
        pixel = np.array([IFOV, IFOV, IFOV / (800 * IFOV)])
        model = fit_prior_model([star], [post], estimate_of(star, still), pixel)
        # What pairs see is the variance of the change over their lags, 2 (k(0) - k(lag)). A strip of 0.25 s
        # holds some twelve independent changes over 0.02 s: their variance is known to sqrt(2 / 12) = 40 %,
        # two of these
        for lag in (0.02, 0.04):
            learned, true = (
                2 * np.ptp(s.autocovariance(np.array([0.0, lag]))) for s in (model.spectra[0], truth)
            )
            assert 0.2 * true < learned < 1.8 * true
            # pitch did not move: errors of a row are 0.05 px / sqrt(8) against 3 px
            pitch = 2 * np.ptp(model.spectra[1].autocovariance(np.array([0.0, lag])))
            assert pitch < 0.01 * true

    def test_differences_across_a_jump_say_nothing_of_the_spectrum(self, monkeypatch):
        given = []

        def remember(series, **_):
            given.append(series)
            one = Spectrum((Matern(1.0, 1.0, "3/2"),))
            return SimpleNamespace(
                spectrum=one, as_found=one, noise_scale=1.0, hidden=(), products=(), through=()
            )

        monkeypatch.setattr(hyper, "fit_spectrum", remember)
        star = plain_star(250, 8, 1, SIGMA)
        jumps = [np.zeros(0), np.array([0.3]), np.arange(0.1, 0.6, 0.015)]
        fit_prior_model([star], [star.residual_px], estimate_of(star, still), np.ones(3), jumps=jumps)
        roll, pitch, yaw = (np.isinf(series[0].variance) for series in given)
        t = star.t_hub[::8]
        assert_allclose(pitch, (t < 0.3) & (t + 0.02 > 0.3))
        # yaw jumps within every lag: that is how it moves, and all of it counts
        assert not roll.any() and not yaw.any()

    def test_images_without_common_rows_are_refused(self):
        star = plain_star(60, 8, 1, SIGMA)
        blind = star.with_weight(np.zeros(star.weight.shape))
        with pytest.raises(
            EstimationError, match="no row of windows is seen by any pair; check that the bands overlap"
        ):
            fit_prior_model([blind], [star.residual_px], estimate_of(star, still), np.ones(3))


def test_rows_of_one_window_say_nothing_of_yaw_and_pitch():
    """One window per row, beside the middle of the field: along the lines pitch and yaw do the same to it."""
    star = plain_star(125, 1, 2, SIGMA)
    for found in angle_differences([star], [star.residual_px], estimate_of(star, still)):
        assert np.isinf(found.covariance[:, [1, 2], [1, 2]]).all()
        assert_allclose(found.covariance[:, 0, 0], (SIGMA * IFOV) ** 2, rtol=0.01)
    with pytest.raises(EstimationError, match="kept matches to show pitch, yaw: too few windows side"):
        fit_prior_model([star], [star.residual_px], estimate_of(star, still), np.ones(3))


def with_stages(star, of_row):
    """The star whose hub and partners average over what `of_row` (B,) says, s, window by window of a row."""
    rows, _ = star.shape
    each = np.tile(np.asarray(of_row), rows)
    return replace(star, tdi_hub=each, tdi=np.repeat(each[:, None], len(star.images), axis=1))


def test_windows_that_average_unlike_are_apart_where_they_tell_enough_alone():
    star = with_stages(plain_star(60, 8, 1, SIGMA), [8e-3] * 4 + [16e-3] * 4)
    found = angle_differences([star], [star.residual_px], estimate_of(star, still))
    assert [one.tdi for one in found] == [(8e-3, 8e-3), (16e-3, 16e-3)]
    # one window of each in a row: pitch and yaw are seen by both together, not by either
    star = with_stages(plain_star(60, 2, 1, SIGMA), [8e-3, 16e-3])
    (found,) = angle_differences([star], [star.residual_px], estimate_of(star, still))
    assert np.isfinite(found.covariance).all() and found.tdi == pytest.approx((12e-3, 12e-3))


def test_rows_are_in_order_of_time_whichever_windows_of_them_are_there():
    # the right half of every line looks 30 ms later, longer than from row to row
    star = plain_star(60, 8, 1, SIGMA)
    later = np.tile([0.0] * 4 + [0.03] * 4, 60)
    star = replace(star, t_hub=star.t_hub + later, t=star.t + later[:, None])
    weight = np.ones(star.weight.shape)
    weight[8 * 20 : 8 * 20 + 4] = 0.0
    (found,) = angle_differences([star.with_weight(weight)], [star.residual_px], estimate_of(star, still))
    assert (np.diff(found.t) >= 0.0).all() and len(found.t) == 60
    assert (np.diff(found.patch) < 0).any()


def test_weighted_sums_own_what_is_hidden_and_so_does_a_single_instant() -> None:
    # tones of 2 and 1 px in roll: an instant has their variances, its difference to one half a period of the
    # first later four times that of the first alone, where the other has gone through whole periods
    tones = (Tone(2.0, 50.0, 1e-6), Tone(1.0, 100.0, 1e-6))
    model = replace(hyper.BROAD, unseen=(tones[:1], (), ()), products=(tones[1:], (), ()))
    assert model.whole()[0].tones == tones[:1]  # the body does not move as the products do
    t = 0.7 + 1e-3 * np.arange(40)
    weights = np.zeros((40, 3, 3))
    weights[5, 0, 0] = 1.0
    weights[[5, 15], 0, 1] = 1.0, -1.0
    weights[5, 1, 2] = 1.0
    found = model.unseen_functionals(t, weights)
    assert_allclose(np.diag(found), [5.0, 16.0, 0.0], rtol=1e-4)
    assert_allclose(found[0, 1], 8.0, rtol=1e-4)
    assert_allclose(model.unseen_variance, [5.0, 0.0, 0.0])


def test_weighted_sums_at_uneven_lines_own_what_is_hidden_at_their_times() -> None:
    # lines up to 3 % longer in the middle: as even ones the waves would come apart over 90 periods
    tone, count = Tone(2.0, 121.0, 1.0), 1500
    t = np.cumsum(5e-4 * (1.0 + 0.03 * np.sin(np.pi * np.arange(count) / count)))
    weights = np.zeros((count, 3, 2))
    weights[:, 0] = (
        2.0 / count * np.stack([np.cos(2.0 * np.pi * 121.0 * t), np.sin(2.0 * np.pi * 121.0 * t)], axis=1)
    )
    found = replace(hyper.BROAD, unseen=((tone,), (), ())).unseen_functionals(t, weights)
    dense = Spectrum((tone,)).autocovariance(np.abs(np.subtract.outer(t, t)).ravel()).reshape(count, count)
    expected = weights[:, 0].T @ dense @ weights[:, 0]
    assert_allclose(found, expected, atol=0.01 * expected.max())


def test_odds_that_axes_share_a_mode_are_those_of_their_other_modes() -> None:
    # of two modes both, one or none are shared: rule of succession (k + 1) / (n + 2), as odds 3, 1 and 1/3
    def spectrum(*tones: float) -> Spectrum:
        return Spectrum((Matern(1.0, 1.0, "5/2"), *(Tone(0.1, f, 0.1) for f in tones)))

    other = spectrum(47.0, 83.0)
    found = [
        hyper._odds_of_sharing(spectrum(*own), other, 1.0, 1.0) for own in ((47.2, 83.0), (83.9,), (60.0,))
    ]
    assert_allclose(found, [3.0, 1.0, 1.0 / 3.0])
    # three quarters of a chance of a half that there is one: .375
    assert_allclose(hyper._odds_of_sharing(spectrum(47.2, 83.0), other, 1.0, 0.5), 0.375 / 0.625)


def test_errors_of_a_given_density_are_owned_and_no_motion() -> None:
    # 2 px^2/Hz between 40 and 50 Hz: 20 px^2, about one over 10 Hz long
    band = TabulatedPsd((40.0, 50.0), (2.0, 2.0))
    model = hyper.BROAD.with_errors([None, band, None])
    assert model.whole() == hyper.BROAD.whole()
    assert_allclose(model.unseen_variance, [0.0, 20.0, 0.0])
    weights = np.zeros((400, 3, 1))
    weights[[0, 22], 1, 0] = 1.0, 1.0  # a period of 45 Hz apart
    (found,) = model.unseen_functionals(1e-3 * np.arange(400), weights)[0]
    apart = 0.022
    tone = np.sinc(10.0 * apart) * np.cos(2.0 * np.pi * 45.0 * apart)
    assert_allclose(found, 2.0 * 20.0 * (1.0 + tone), rtol=1e-6)


def test_blur_that_is_taken_off_is_doubted_by_the_motion_that_it_would_be(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    # blur that shifts windows as a pitch of 2 px at 40 Hz does: the motion would be that pitch; .05 of it,
    # .07 px rms, is not known; of roll and yaw nothing
    star = plain_star(220, 8, 2, 1e-4)
    f, size = 40.0, 2.0 * IFOV
    motion = [size * np.sin(2.0 * np.pi * f * t)[..., None] for t in (star.t, star.t_hub[:, None])]
    blur = star.by_partner[..., 1] * motion[0] + star.by_hub[..., 1] * motion[1]
    estimate = estimate_of(star, still)
    orders = [GroundOrder()]
    monkeypatch.setattr(estimates, "_ground_orders", lambda strip, stars: orders)
    strip = SimpleNamespace(grid=estimate.grid, scale=np.full(3, IFOV))
    records = [SimpleNamespace(star=replace(star, blur_px=blur))]
    state = SimpleNamespace(records=records, estimate=estimate, slow=None, model=hyper.BROAD)
    model = estimates.with_blur_errors(strip, state)
    roll, pitch, yaw = np.sqrt(model.unseen_variance) / IFOV
    assert pitch == pytest.approx(0.05 * 2.0 / np.sqrt(2.0), rel=0.1)
    assert roll < 0.007 and yaw < 0.007
    (part,) = model.products[1]
    near = np.abs(np.array(part.frequency) - f) < 5.0
    assert np.array(part.density)[near].sum() > 0.95 * np.sum(part.density)
    without = [SimpleNamespace(star=star)]
    assert (
        estimates.with_blur_errors(strip, SimpleNamespace(**{**vars(state), "records": without}))
        == hyper.BROAD
    )


def test_what_moves_where_all_pairs_are_blind_may_be_of_each_axis() -> None:
    grid = TimeGrid(0.0, STEP, 700)
    rng = np.random.default_rng(3)
    # the rms of the amplitude that its error, white of 0.02, makes: 0.02 (6 / 700)^(1/2) = 0.002
    nodes = 0.02 * rng.standard_normal((700, 3)) + np.sin(2 * np.pi * 2.0 * grid.nodes)[:, None]

    def functional_covariance(_, weights):
        return 0.02**2 * np.einsum("nak,nal->kl", weights, weights)

    def modes(*lags, moves=0.0, tones=((50.0, 0.2),), pixel=(1.0, 1.0, 1.0), shown_by=(0,)):
        moved = nodes + np.outer(moves * np.sin(2 * np.pi * 53.2 * grid.nodes), [0.0, 0.0, 1.0])
        estimate = SimpleNamespace(grid=grid, nodes=moved, functional_covariance=functional_covariance)
        t = np.linspace(0.0, 0.7 - max(lags), 150)
        differences = [SimpleNamespace(t=t, lag=np.full(150, lag)) for lag in lags]
        shown = Spectrum((*BROAD.spectra[0].components, *(Tone(size, f, 0.1) for f, size in tones)))
        found = [shown if axis in shown_by else BROAD.spectra[axis] for axis in range(3)]
        return _blind_modes(found, differences, estimate, np.array(pixel), 0.7)  # type: ignore[arg-type]

    # a tone of yaw of 0.02 is ten times that: of each axis one of half the variance of that of 50 Hz,
    # which falls as f^-3
    each = modes(0.0375, 0.075, moves=0.02, pixel=(1.0, 1.0, 3.0), tones=((50.0, 0.2), (44.0, 0.01)))
    for size, (tone,) in zip((1.0, 1.0, 3.0), each, strict=True):
        assert tone.frequency == pytest.approx(2.0 / 0.0375)
        assert tone.sigma == pytest.approx(size * 0.2 * np.sqrt(0.5 * (50.0 * 0.0375 / 2.0) ** 3), rel=0.01)
    none = ((), (), ())
    # nothing moves, a pair sees it, or no tone tells how large one may be
    assert modes(0.0375, 0.075) == none
    assert modes(0.0375, 0.07, moves=0.02) == none
    # what roll shows by itself may be some of it, or all
    assert modes(0.0375, 0.075, moves=0.02, tones=((50.0, 0.2), (52.9, 0.2))) != none
    assert modes(0.0375, 0.075, moves=0.02, tones=()) == none
    # it is near enough to be one, though nothing else moves: where it is found; 1.5 / 0.7 Hz is not
    for f, is_near in ((51.4, True), (51.0, False), (55.3, True), (55.7, False)):
        for one in modes(0.0375, 0.075, tones=((f, 0.2),)):
            assert [tone.frequency for tone in one] == ([pytest.approx(f)] if is_near else [])
    assert modes(0.0375, 0.07, tones=((51.4, 0.2),)) == none
    # what moves along the lines is pitch: of what it shows by itself it has no more
    assert [len(one) for one in modes(0.0375, 0.075, tones=((51.4, 0.2),), shown_by=(0, 1))] == [1, 0, 1]
    model = replace(BROAD, blind=each)
    assert [s.components[-1] for s in model.estimated().spectra] == [tone for (tone,) in each]
    assert not model.estimated().estimated().unseen_variance.any()
    assert model.whole() == model.estimated().spectra


def test_what_blur_shows_of_hidden_motion_is_estimated_and_no_error_of_its_own() -> None:
    tone = Tone(2.0, 120.0, 5.0)
    model = replace(hyper.BROAD, unseen=((tone,), (), ()), blur_shows=True)
    assert model.estimated().spectra[0].components[-1] == tone
    assert not model.unseen_variance.any()
    assert replace(model, blur_shows=False).estimated().spectra == hyper.BROAD.spectra


BROAD_SPECTRA = (Spectrum((Matern(1.0, 1.0, "5/2"), Matern(0.1, 0.01, "3/2"))),) * 3


def hidden_estimate(nodes: np.ndarray, variance_of) -> SimpleNamespace:
    """An estimate of `nodes` (count, 3) whose weighted sums err by `variance_of` them."""
    grid = TimeGrid(0.0, STEP, len(nodes))

    def functional_covariance(t, weights):
        return variance_of(t, weights)

    return SimpleNamespace(grid=grid, nodes=nodes, functional_covariance=functional_covariance)


def known_sinusoid():
    """An estimate that knows pitch to be a sinusoid of 121 Hz and .1 px rms."""
    nodes = np.zeros((600, 3))
    nodes[:, 1] = 0.1 * np.sqrt(2.0) * np.cos(2.0 * np.pi * 121.0 * STEP * np.arange(600))
    return hidden_estimate(nodes, lambda t, w: np.zeros((w.shape[2],) * 2))


def pitch_hides(tone: Tone) -> PriorModel:
    """A model of hardly any jitter, and of one hidden tone of pitch."""
    quiet = Spectrum((Matern(1.0, 1.0, "5/2"), Matern(1e-4, 0.01, "3/2")))
    return PriorModel((quiet,) * 3, unseen=((), (tone,), ()), blur_shows=True)


def test_a_hidden_tone_becomes_as_large_and_as_narrow_as_it_is_found() -> None:
    # a tone that was found within the resolution settles on the sinusoid
    estimate, model = known_sinusoid(), pitch_hides(Tone(0.2, 122.0, 1.5))
    widths = []
    for _ in range(4):
        model = hidden.learned(model, estimate, (0.0, 0.6))
        widths.append(model.unseen[1][0].bandwidth)
    (tone,) = model.unseen[1]
    # the line has some of its power beyond where it is looked at: a tenth
    assert tone.sigma == pytest.approx(0.1, rel=0.1)
    assert tone.frequency == pytest.approx(121.0, abs=0.3)
    assert np.all(np.diff(widths) < 0.0) and widths[-1] < 0.5


def test_a_hidden_tone_that_was_guessed_keeps_its_place_and_becomes_as_large_as_it_is_found() -> None:
    # where rows show none of it, its place would be that of what they do show
    estimate, model = known_sinusoid(), pitch_hides(Tone(0.2, 126.0, 8.0))
    (tone,) = hidden.learned(model, estimate, (0.0, 0.6)).unseen[1]
    assert (tone.frequency, tone.bandwidth) == (126.0, 8.0)
    assert tone.sigma == pytest.approx(0.1, rel=0.2)


def test_a_hidden_tone_of_which_nothing_is_seen_stays_as_it_was() -> None:
    # nothing found, and an error as large as all that is expected
    tone = Tone(0.2, 126.0, 8.0)
    quiet = Spectrum((Matern(1e-3, 1.0, "5/2"), Matern(1e-4, 0.01, "3/2")))
    model = PriorModel((quiet,) * 3, unseen=((tone,), (), ()), blur_shows=True)

    def variance_of(t, weights):
        return replace(model, blur_shows=False).unseen_functionals(t, weights)

    estimate = hidden_estimate(np.zeros((600, 3)), variance_of)
    (after,) = hidden.learned(model, estimate, (0.0, 0.6)).unseen[0]
    assert_allclose((after.sigma, after.frequency, after.bandwidth), (0.2, 126.0, 8.0), rtol=0.02)


def test_a_hidden_tone_that_is_not_estimated_is_not_learned() -> None:
    model = PriorModel(BROAD_SPECTRA, unseen=((Tone(0.2, 126.0, 8.0),), (), ()), blur_shows=False)
    estimate = hidden_estimate(np.zeros((600, 3)), lambda t, w: np.zeros((w.shape[2],) * 2))
    assert hidden.learned(model, estimate, (0.0, 0.6)).unseen == model.unseen


def shown_by_noisy_instants(motion: np.ndarray, noise: float, seed: int) -> SimpleNamespace:
    """An estimate of no motion beside measurements of every node's three angles, of an even `noise`."""
    rng = np.random.default_rng(seed)
    measured = motion + noise * rng.standard_normal(motion.shape)

    def shown_of(waves):
        flat = waves.reshape(-1, waves.shape[2])
        return flat.T @ measured.ravel() / noise**2, flat.T @ flat / noise**2

    return SimpleNamespace(grid=TimeGrid(0.0, STEP, len(motion)), shown_of=shown_of)


SEEN_TONES = (Tone(0.3, 47.0, 0.1), Tone(0.15, 83.0, 0.1))
LOUD_SPECTRA = (Spectrum((Matern(1.0, 1.0, "5/2"), Matern(0.1, 0.01, "3/2"), *SEEN_TONES)),) * 3
#: s; sixteen lines of .5 ms: .03 of 121 Hz is left, .6 of 60 Hz.
AVERAGED = (8e-3,)


def test_a_mode_that_blur_shows_is_found_where_it_is_and_all_axes_have_it() -> None:
    # .08 px rms of 121.3 Hz in roll and yaw; 600 instants of .3 px tell its frequency to .1 Hz
    t = STEP * np.arange(600)
    motion = np.zeros((600, 3))
    motion[:, 0] = 0.12 * np.sin(2.0 * np.pi * 121.3 * t)
    motion[:, 2] = 0.11 * np.cos(2.0 * np.pi * 121.3 * t)
    wide, far = Tone(0.05, 126.0, 9.0), Tone(0.02, 267.0, 20.0)
    model = PriorModel(LOUD_SPECTRA, unseen=((wide, far), (far,), ()), blur_shows=True)
    for seed in range(3):
        estimate = shown_by_noisy_instants(motion, 0.3, seed)
        roll, pitch, yaw = hidden.with_shown_mode(model, estimate, (0.0, 0.6), AVERAGED).unseen
        assert roll[0] == pitch[0] == far  # a guess about there stood for it
        for tones in (roll[1:], pitch[1:], yaw):
            (tone,) = tones
            assert tone.frequency == pytest.approx(121.3, abs=0.4)
            assert 0.02 < tone.sigma < 0.2
            assert tone.bandwidth < 1.0
        # what is there is not found again
        again = replace(model, unseen=(roll, pitch, yaw))
        assert hidden.with_shown_mode(again, estimate, (0.0, 0.6), AVERAGED) == again


def test_noise_shows_no_hidden_mode_nor_is_one_looked_for_that_stages_leave() -> None:
    model = PriorModel(LOUD_SPECTRA, unseen=((), (), ()), blur_shows=True)
    noise = [shown_by_noisy_instants(np.zeros((600, 3)), 0.3, seed) for seed in range(20)]
    assert all(hidden.with_shown_mode(model, one, (0.0, 0.6), AVERAGED) is model for one in noise)
    t = STEP * np.arange(600)
    plain = shown_by_noisy_instants(0.3 * np.sin(2.0 * np.pi * 60.0 * t)[:, None] * np.ones(3), 0.3, 0)
    assert hidden.with_shown_mode(model, plain, (0.0, 0.6), AVERAGED) is model
    mute = replace(model, blur_shows=False)
    assert hidden.with_shown_mode(mute, plain, (0.0, 0.6), AVERAGED) is mute
    # 32 stages hide a mode in a third of strips and more: where, rows of 20 px do not tell
    deaf = [shown_by_noisy_instants(np.zeros((600, 3)), 20.0, seed) for seed in range(5)]
    odds = [hidden.likely_modes(model, one, (0.0, 0.6), (16e-3,), np.zeros(3))[1].sum() for one in deaf]
    assert min(odds) > 0.5
    assert all(hidden.with_shown_mode(model, one, (0.0, 0.6), (16e-3,)) is model for one in deaf)


def test_modes_that_each_axis_sees_beside_its_place_count_once_and_faint_tones_for_nothing() -> None:
    # .2 s resolve 5 Hz: 46 to 49 Hz are one mode
    grid = SimpleNamespace(grid=TimeGrid(0.0, STEP, 200))
    broad = LOUD_SPECTRA[0].components[:2]

    def chance(*tones: tuple[Tone, ...]) -> float:
        roll, pitch, yaw = (Spectrum((*broad, *of_axis)) for of_axis in tones)
        model = PriorModel((roll, pitch, yaw), blur_shows=False)
        return float(hidden.likely_modes(model, grid, (0.0, 0.2), AVERAGED, np.zeros(3))[1].sum())

    one = (Tone(0.3, 47.0, 0.1),)
    faint = (*one, Tone(0.01, 96.0, 0.1))
    apart = chance((Tone(0.3, 45.9, 0.1),), one, (Tone(0.3, 49.0, 0.1),))
    assert apart == pytest.approx(chance(one, one, one), rel=0.1)
    assert chance(faint, faint, faint) == pytest.approx(chance(one, one, one), rel=0.1)
    # half a mode lies beyond 47 Hz, 47 / f of that beyond f: stages leave little of 108 to 149 Hz, and of 213
    # to the 300 Hz that steps of 1 ms show
    expected = 0.5 * 47.0 * (1.0 / 108.0 - 1.0 / 149.0 + 1.0 / 213.0 - 1.0 / 300.0)
    assert chance(one, one, one) == pytest.approx(expected, rel=0.1)


def test_a_mode_that_others_let_expect_is_taken_though_chance_might_show_as_much(monkeypatch) -> None:
    # two modes up to 83 Hz let expect one of .15 (83 / f)^1.5 rms beyond in a third of strips. Of .1 rms at
    # 122 Hz in all axes 600 instants of .9 gain 3 * 600 * .01 / .81 / 2 = 11 on average, less the freedom
    # of six amplitudes costs: in every tenth draw the log (60 / .01) = 8.7 that chance does not reach
    t = STEP * np.arange(600)
    motion = 0.1 * np.sqrt(2.0) * np.cos(2.0 * np.pi * 122.0 * t[:, None] + np.array([0.0, 1.0, 2.0]))
    model = PriorModel(LOUD_SPECTRA, unseen=((), (), ()), blur_shows=True)
    shown = [shown_by_noisy_instants(motion, 0.9, seed) for seed in range(12)]

    def places() -> list[float]:
        after = [hidden.with_shown_mode(model, one, (0.0, 0.6), AVERAGED).unseen[0] for one in shown]
        return [tones[0].frequency for tones in after if tones]

    found = np.array(places())
    monkeypatch.setattr(hidden, "LIKELY", np.inf)
    beyond_chance = places()
    # .6 s resolve 1.7 Hz
    assert np.abs(found - 122.0).max() < 1.7
    assert len(found) >= len(beyond_chance) + 3


def test_the_variance_of_a_few_amplitudes_is_that_of_modes_of_their_kind() -> None:
    # against the integral over all variances, by quadrature: by the amplitudes, and by e^(-v / mean)
    for found, count, usual in ((0.1, 2.0, 1.0), (3.0, 3.8, 0.5), (1e-9, 4.0, 1e-9), (2.0, 12.0, 40.0)):
        v = usual * np.exp(np.linspace(-14.0, 7.0, 40_001))
        likely = v * v ** (-0.5 * count) * np.exp(-0.5 * count * found / v - v / usual)
        expected = (v * likely).sum() / likely.sum()
        assert hidden._mean_variance(found, count, usual) == pytest.approx(expected, rel=1e-3)
    assert hidden._mean_variance(0.3, 2.0, np.inf) == 0.3


def test_only_motion_that_stages_leave_much_of_is_plainly_seen() -> None:
    # 16 stages of .5 ms leave .75 of 50 Hz, .13 of 110 Hz, and nothing of 125 Hz; where tones
    # are cut off at the ends they ring, beyond 50 nodes by less than a twentieth
    camera = SimpleNamespace(stages=np.array([16]), detector=SimpleNamespace(line_period=5e-4))
    strip = SimpleNamespace(nominal=[camera], grid=TimeGrid(0.0, STEP, 600))
    t = strip.grid.nodes[:, None]
    slow = 2.0 * t + np.sin(2.0 * np.pi * 50.0 * t)
    fast = np.sin(2.0 * np.pi * 110.0 * t) + np.sin(2.0 * np.pi * 125.0 * t)
    kept = estimates.plainly_seen(strip, np.repeat(slow + fast, 3, axis=1))
    assert np.abs(kept - slow)[50:-50].max() < 0.05
    without = SimpleNamespace(nominal=[SimpleNamespace(stages=None)], grid=strip.grid)
    assert_allclose(estimates.plainly_seen(without, slow), slow)


@pytest.mark.parametrize("largest", [0, 1, 2])
def test_motions_that_are_held_alike_are_a_third_of_the_largest_in_pixels(largest):
    scale, length, f = np.array([1e-6, 3e-6, 8e-5]), 2.0, np.geomspace(0.1, 200.0, 30)
    sizes = np.where(np.arange(3) == largest, 6.0, 0.01)  # px
    model = PriorModel(tuple(
        Spectrum((Matern(size * s, 0.5, "5/2"), Matern(0.1 * size * s, 0.01, "3/2")))
        for size, s in zip(sizes, scale, strict=True)
    ))  # fmt: skip
    alike = model.alike(scale, length)
    whole = model.spectra[largest].psd(f) / scale[largest] ** 2
    for axis in range(3):
        share = 1.0 if axis == largest else 1.0 / 9.0
        assert_allclose(alike.spectra[axis].psd(f) / scale[axis] ** 2, share * whole, rtol=1e-9)


def test_modes_that_stages_average_away_are_looked_for_at_half_the_resolution():
    """0.6 s of nodes a ms apart, stages over 16 ms: nothing is left about multiples of 62.5 Hz."""
    estimate = SimpleNamespace(grid=TimeGrid(0.0, STEP, 601))
    pieces, length, f = hidden._averaged_away(estimate, (0.0, 0.6), (16e-3,))
    assert length == pytest.approx((pieces[0].stop - pieces[0].start - 1) * STEP)
    steps = np.diff(f) * length
    # on a grid of halves, with gaps where stages leave something
    assert_allclose(steps, 0.5 * np.round(2.0 * steps), atol=1e-6)
    assert np.median(steps) == pytest.approx(0.5)
    assert_allclose(f * length, 0.5 * np.round(2.0 * f * length), atol=1e-6)
    assert hidden._averaged_away(estimate, (0.0, 0.6), ())[2].size == 0


def test_rows_that_share_lines_are_thinned_to_rows_apart_as_good_as_all_they_stand_for():
    star = plain_star(10, 5, 2, duration=0.0)
    spacing = float(star.t_hub[5] - star.t_hub[0])
    overlapping = replace(star, duration=3.0 * spacing, field=np.arange(50.0))
    post = np.arange(200.0).reshape(50, 2, 2)
    (thin, alone), (left, untouched) = hyper._rows_apart([overlapping, star], [post, post])
    kept = np.concatenate([np.arange(15 * k, 15 * k + 5) for k in range(4)])
    assert thin.shape == (4, 5)
    assert_allclose(thin.field, kept)
    assert_allclose(thin.t_hub, star.t_hub[kept])
    assert_allclose(left, post[kept])
    # means over the strip are known as well as before: a third of the rows, each of a third of the variance
    assert_allclose(thin.correlation, star.correlation / 3.0)
    assert alone.shape == star.shape and untouched is post
    assert_allclose(alone.correlation, star.correlation)
