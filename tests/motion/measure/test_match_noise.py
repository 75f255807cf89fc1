"""Errors of matching learned from their scatter, against drawn errors of known covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import PERIOD, plain_star
from sightline.motion.measure.match_noise import (
    estimate_correlation,
    least_blocks,
    robust_weights,
    row_weights,
    scatter,
    single_errors,
)
from sightline.motion.measure.observations import Star, shared_image_correlation

SIGMA = 0.05


def drawn(star: Star, seed: int, correlation: np.ndarray | None = None) -> np.ndarray:
    """Independent errors of every window, (G, K, 2) px, of the covariance between pairs that is given."""
    rng = np.random.default_rng(seed)
    g, pairs = star.t.shape
    factor = np.linalg.cholesky(np.eye(2 * pairs) if correlation is None else correlation)
    return SIGMA * (rng.standard_normal((g, 2 * pairs)) @ factor.T).reshape(g, pairs, 2)


def row_motion(star: Star, seed: int, size: float = 1.0) -> np.ndarray:
    """A shift and a tilt of each row, pair and axis, (G, K, 2) px."""
    rows, blocks = star.shape
    rng = np.random.default_rng(seed)
    shift, tilt = size * rng.standard_normal((2, rows, 1, star.t.shape[1], 2))
    return (shift + tilt * star.field.reshape(rows, blocks, 1, 1)).reshape(*star.t.shape, 2)


def uneven(star: Star, times: float) -> Star:
    """The star with sigmas that are so many times as large in the right half of its rows."""
    rows, blocks = star.shape
    size = np.tile(np.where(np.arange(blocks) < blocks // 2, 1.0, times), rows)
    return replace(star, covariance_px=star.covariance_px * size[:, None, None, None] ** 2)


class TestScatter:
    def test_shift_and_tilt_of_a_row_leave_no_scatter(self):
        star = plain_star(30, 7, 2, SIGMA)
        found = scatter(star, row_motion(star, 0))
        assert np.abs(found.z).max() < 1e-9
        assert_allclose(found.degrees, 5.0)
        assert_allclose(found.counts, 1.0)

    def test_what_is_left_is_that_of_a_line_fitted_to_the_windows_that_are_there(self):
        star = plain_star(12, 9, 2, SIGMA)
        residual = drawn(star, 1)
        residual[3::8, 0] = np.nan
        star = replace(star, residual_px=residual)
        found = scatter(star, residual + row_motion(star, 2))
        z, degrees = found.z, found.degrees
        x, table = star.field[:9], residual.reshape(12, 9, 4) / SIGMA
        for row in range(12):
            for c in range(4):
                y = table[row, :, c]
                there = np.isfinite(y)
                left = y[there] - np.polyval(np.polyfit(x[there], y[there], 1), x[there])
                assert_allclose(z[row, there, c], left, atol=1e-9)
                assert np.isnan(z[row, ~there, c]).all()
                assert degrees[row, c] == pytest.approx(there.sum() - 2)

    def test_matches_without_weight_are_absent(self):
        star = plain_star(10, 6, 1, SIGMA)
        weight = np.ones((60, 1))
        weight[::6] = 0.0
        post = drawn(star, 3)
        post[::6] = 1e3
        found = scatter(star.with_weight(weight), post)
        z, degrees = found.z, found.degrees
        assert np.isnan(z[:, 0]).all() and np.abs(z[:, 1:]).max() < 5.0
        assert_allclose(degrees, 3.0)

    def test_a_shift_of_windows_of_unlike_sigmas_leaves_no_scatter(self):
        star = uneven(plain_star(30, 8, 2, SIGMA), 5.0)
        found = scatter(star, row_motion(star, 13))
        assert np.abs(found.z).max() < 1e-9
        assert_allclose(found.degrees, 6.0)
        # four windows tell 25 times what the other four do, 8 in all
        assert_allclose(found.counts[0, :, 0], np.repeat([8 * 25, 8], 4) / (4 * 26))

    def test_the_share_that_a_line_leaves_is_that_of_drawn_errors(self):
        star = uneven(plain_star(6000, 8, 1, SIGMA), 5.0)
        found = scatter(star, np.sqrt(star.covariance_px[..., 0, 0])[..., None] / SIGMA * drawn(star, 14))
        # squares of 12,000 normal values scatter by sqrt(2 / 12000) = 1.3 %; five of these
        squares = (found.z**2).mean(axis=(0, 2))
        assert_allclose(squares, found.freedom.mean(axis=(0, 2)), rtol=0.065)

    def test_rows_of_too_few_windows_say_nothing(self):
        star = plain_star(10, 3, 1, SIGMA)
        found = scatter(star, drawn(star, 4))
        assert np.isnan(found.z).all() and not found.degrees.any()


def test_errors_are_the_same_however_many_windows_are_worked_on_at_a_time(monkeypatch):
    star = plain_star(200, 9, 2, SIGMA)
    post = drawn(star, 11, TestCorrelation.TRUE) + row_motion(star, 12, SIGMA)
    post[5::37, 1], post[7::41, 0] = np.nan, 40.0 * SIGMA
    star = replace(star, residual_px=post)

    def found():
        noise = (estimate_correlation, row_weights, robust_weights)
        return [scatter(star, post).z, *(function(star, post) for function in noise)]

    whole = found()
    monkeypatch.setattr("sightline.motion.measure.windows._AT_ONCE", 100)
    monkeypatch.setattr("sightline.motion.measure.match_noise.SUMMED", 200)
    for one, other in zip(whole, found(), strict=True):
        assert_allclose(other, one, rtol=1e-12)


class TestCorrelation:
    # hub's share of the error 0.7, of the two partners 0.3 and 0.5: pair variances 1.0 and 1.2
    TRUE = np.kron(np.array([[1.0, 0.7], [0.7, 1.2]]), np.eye(2))

    def test_the_error_that_pairs_share_is_found(self):
        star = plain_star(1500, 16, 2, SIGMA)
        post = drawn(star, 5, self.TRUE) + row_motion(star, 6)
        got = estimate_correlation(star, post)
        # 1500 * 14 = 21000 free squares; the plain variance scatters by sqrt(2 / n), each of up to eight rows
        # on either side that are added by 2 / sqrt(n): below sqrt(2 + 8 * 4) / sqrt(n) = 0.04; four of these
        assert_allclose(got, self.TRUE, atol=0.16)
        assert_allclose(got, got.T)

    def test_rows_that_two_windows_decide_leave_numbers(self):
        star = plain_star(400, 8, 1, SIGMA)
        rng = np.random.default_rng(16)
        sigma = np.full((400, 8), 1e9)
        for row in sigma:
            row[rng.choice(8, 2, replace=False)] = rng.uniform(1.0, 3.0, 2)
        sigma = sigma.ravel()
        star = replace(star, covariance_px=star.covariance_px * sigma[:, None, None, None] ** 2)
        got = estimate_correlation(star, drawn(star, 16) * sigma[:, None, None])
        assert np.isfinite(got).all() and (np.linalg.eigvalsh(got) > 0.0).all()

    @pytest.mark.parametrize("wrong", [0.5, 2.0])
    def test_noisy_windows_whose_sigma_is_wrong_do_not_make_that_of_good_ones_wrong(self, wrong):
        # the right half: ten times the sigma, by which the matcher is wrong
        star = uneven(plain_star(1500, 16, 1, SIGMA), 10.0)
        right = np.tile(np.arange(16) >= 8, 1500)
        post = drawn(star, 15) * np.where(right, 10.0 * wrong, 1.0)[:, None, None]
        got = estimate_correlation(star, post)
        # the right half has 1 % of what rows tell, and an error of 2 to 4 in 1 % of the sum; chance as above
        # (0.04) times sqrt 2 for half the windows, four of these
        assert_allclose(got, np.eye(2), atol=0.26)

    def test_errors_that_last_from_row_to_row_count_with_all_their_sum(self):
        star = plain_star(1500, 16, 1, SIGMA)
        fresh = drawn(star, 7).reshape(1500, 16, 1, 2)
        lasting = (fresh[1:] + fresh[:-1]) / np.sqrt(2)
        lasting = np.concatenate([fresh[:1], lasting]).reshape(-1, 1, 2)
        # correlation 1/2 with the row before and the row after: the mean of many rows has twice the variance
        got = estimate_correlation(star, lasting)
        # twice the scatter of independent rows at the most, 0.04 (above) times 2; four of these
        assert_allclose(got, 2 * np.eye(2), atol=0.32)

    @pytest.mark.parametrize(("lines", "variance"), [(4.0, 37 / 9), (20.0, 5.0)])
    def test_rows_that_share_pixels_count_in_full(self, lines, variance):
        rows, blocks = 3000, 16
        star = plain_star(rows, blocks, 1, SIGMA, duration=lines * PERIOD)
        fresh = SIGMA * np.random.default_rng(13).standard_normal((rows + 4, blocks, 1, 2))
        lasting = sum(fresh[k : k + rows] for k in range(5)) / np.sqrt(5)
        # means of five rows: correlation .8, .6, .4, .2 with the next; the mean of many has five times the
        # variance. Windows of 20 lines, 4 apart, share pixels over just so many rows; where they share none,
        # Bartlett's weights 8/9 ... 5/9 of what lasts make it 1 + 2 (.8 8 + .6 7 + .4 6 + .2 5) / 9.
        # Sums of 42,000 squares and eight rows on either side, each of five alike rows, scatter by
        # sqrt(34 / 42000) = 3 % of that; four of these
        got = estimate_correlation(star, lasting.reshape(-1, 1, 2))
        assert_allclose(np.diag(got), variance, atol=0.12 * variance)

    def test_rows_that_share_pixels_count_however_many_they_are(self):
        rows, blocks, many = 3000, 16, 20
        star = plain_star(rows, blocks, 1, SIGMA, duration=4 * many * PERIOD)
        fresh = SIGMA * np.random.default_rng(17).standard_normal((rows + many - 1, blocks, 1, 2))
        lasting = sum(fresh[k : k + rows] for k in range(many)) / np.sqrt(many)
        # as above, means of twenty rows: the mean of many has twenty times the variance. Sums of 42,000
        # squares and 19 rows on either side scatter by sqrt(2 (1 + 2 * 19) / 42000) = 4.3 %; four of these
        got = estimate_correlation(star, lasting.reshape(-1, 1, 2))
        assert_allclose(np.diag(got), many, atol=0.18 * many)

    def test_errors_that_neighbouring_windows_share_count_as_the_mean_of_the_row_feels_them(self):
        star = plain_star(1500, 10, 1, SIGMA)
        fresh = SIGMA * np.random.default_rng(31).standard_normal((1500, 11, 1, 2))
        shared = (fresh[:, 1:] + fresh[:, :-1]) / np.sqrt(2)
        # correlation 1/2 between neighbours: the mean of ten has 1 + 2 * 0.5 * 0.9 = 1.9 times the variance
        # of independent ones. Of 1667 runs of nine rows the fit errs by 2 / sqrt(1667) = 5 %; four of these
        got = estimate_correlation(star, shared.reshape(-1, 1, 2))
        assert_allclose(np.diag(got), 1.9, rtol=0.2)
        own = estimate_correlation(star, drawn(star, 32))
        assert_allclose(own, np.eye(2), atol=0.16)

    def test_a_matcher_that_claims_too_little_is_corrected(self):
        star = plain_star(1500, 16, 1, SIGMA / 2)
        # errors of twice the claimed sigma; scatter 0.04 (above) of a variance of 4, four of these
        assert_allclose(estimate_correlation(star, drawn(star, 8)), 4 * np.eye(2), atol=4 * 4 * 0.04)

    def test_too_few_windows_leave_the_start_value(self):
        star = plain_star(20, 5, 2, SIGMA)
        assert_allclose(estimate_correlation(star, drawn(star, 9)), shared_image_correlation(2))

    def test_rows_of_three_windows_tell_the_size_of_errors_too(self):
        # crops of real bands: 88 rows of three windows, whose matches err by 1.8 times the variance claimed
        found = []
        for seed in range(12):
            star = plain_star(88, 3, 2, SIGMA)
            found.append(np.diag(estimate_correlation(star, np.sqrt(1.8) * drawn(star, seed))))
        # one degree of freedom per row, ten of the start value; sqrt(2 / 88) each, and twice by chance
        expected = (88 * 1.8 + 10.0) / 98.0
        assert np.mean(found) == pytest.approx(expected, rel=5.0 * np.sqrt(2.0 / (88 * 48)) + 0.05)

    def test_rows_of_which_water_leaves_three_windows_tell_the_size_of_errors_too(self):
        found = []
        for seed in range(12):
            star = plain_star(175, 6, 2, SIGMA)
            post = np.sqrt(1.8) * drawn(star, seed).reshape(175, 6, 2, 2)
            post[:, 3:] = np.nan
            # now and then a window of the shore
            post[::4, 3] = post[1::4, 2]
            post = post.reshape(-1, 2, 2)
            found.append(np.diag(estimate_correlation(replace(star, residual_px=post), post)))
        # 48 values of one degree of freedom per row at least, whose sums over eight rows scatter by
        # sqrt(4/3 * 9 / 175) = 26 %; five of their means
        assert np.mean(found) == pytest.approx(1.8, rel=5.0 * 0.26 / np.sqrt(48))

    @pytest.mark.parametrize(
        ("held", "least"), [((6, 6, 6), 4), ((3, 3, 6), 3), ((3, 6, 6), 4), ((3, 2, 1), 3), ((2, 1, 4), 4)]
    )
    def test_three_windows_tell_of_errors_where_most_rows_that_do_hold_no_more(self, held, least):
        star = plain_star(30, 6, 1, SIGMA)
        post = np.zeros((30, 6, 1, 2))
        for row in range(30):
            post[row, held[row % 3] :] = np.nan
        assert least_blocks(replace(star, residual_px=post.reshape(-1, 1, 2))) == least

    def test_of_few_rows_errors_that_last_are_found_and_chance_is_not_taken_for_them(self):
        rng = np.random.default_rng(5)
        rho, rows, blocks = 0.8, 88, 3
        lasting = np.empty((rows, blocks, 2))
        lasting[0] = rng.standard_normal((blocks, 2))
        for row in range(1, rows):
            lasting[row] = rho * lasting[row - 1] + np.sqrt(1.0 - rho**2) * rng.standard_normal((blocks, 2))
        star = plain_star(rows, blocks, 1, SIGMA)
        found = np.diag(estimate_correlation(star, SIGMA * lasting.reshape(-1, 1, 2)))
        lags = np.arange(1, 9)
        # the sum over eight lags, 5.1; known to 40 % of so few rows
        total = 1.0 + 2.0 * np.sum((1.0 - lags / 9.0) * rho**lags)
        assert np.all(found > 0.4 * total) and np.all(found < 2.0 * total)
        alone = [np.diag(estimate_correlation(star, drawn(star, seed))) for seed in range(20)]
        # errors of a size to 15 %, and no long sums but by a chance of 1 in 40
        assert np.quantile(alone, 0.9) < 1.4

    @pytest.mark.parametrize("matched", [0, 3, 5])
    def test_a_pair_with_hardly_any_match_errs_as_the_others_do(self, matched):
        star = plain_star(400, 8, 2, SIGMA)
        # errors of twice the claimed sigma, two rows alike: long means err by nearly eight times the variance
        post = 2.0 * np.repeat(drawn(star, 9).reshape(400, 8, 2, 2)[::2], 2, axis=0).reshape(-1, 2, 2)
        post[matched:, 1] = np.nan
        alone = plain_star(400, 8, 1, SIGMA)
        own = estimate_correlation(alone, post[:, :1])
        got = estimate_correlation(replace(star, residual_px=post), post)
        assert_allclose(got[:2, :2], own)
        assert np.diag(own).min() > 6.0
        if matched < 4:  # no row holds enough to say anything
            assert_allclose(np.diag(got)[2:], np.diag(own))
            assert_allclose(np.diag(got[2:, :2]), 0.5 * np.diag(own))
        else:
            # a row of five leaves three squares beside ten that are given; three squares are not above 15
            # times their size but by a chance of 1 in 500
            size = np.diag(got)[2:] / np.diag(own)
            assert 10.0 / 13.0 <= size.min() and size.max() < 25.0 / 13.0

    def test_where_most_rows_are_absent_chance_is_not_taken_for_errors_that_last(self):
        found = []
        for seed in range(40):
            star = plain_star(240, 3, 1, SIGMA)
            post = drawn(star, seed).reshape(240, 3, 1, 2)
            post[np.random.default_rng(seed).permutation(240)[:180]] = np.nan
            post = post.reshape(-1, 1, 2)
            found.append(np.diag(estimate_correlation(replace(star, residual_px=post), post)))
        # 60 rows of one square beside ten of the start: sizes to 16 %, three of these; long sums beyond twice
        # their chance in 1 of 40. Of 80 values 2 are larger, and 1.4 of their scatter four times
        assert np.mean(np.array(found) > 1.5) < 0.1

    def test_the_result_is_a_covariance_even_of_errors_that_are_the_same_in_both_pairs(self):
        star = plain_star(400, 8, 2, SIGMA)
        one = drawn(star, 10)[:, :1]
        got = estimate_correlation(star, np.concatenate([one, one], axis=1))
        assert np.linalg.eigvalsh(got).min() > 0.0


class TestRobustWeights:
    ROWS, BLOCKS = 60, 12

    def star(self, pairs: int = 1) -> Star:
        return plain_star(self.ROWS, self.BLOCKS, pairs, SIGMA)

    def weights(self, post: np.ndarray) -> np.ndarray:
        return robust_weights(self.star(post.shape[1]), post).reshape(self.ROWS, self.BLOCKS, -1)

    def test_errors_of_the_expected_size_keep_their_weight(self):
        got = self.weights(drawn(self.star(2), 11))
        # beyond 3 sigmas of two Gaussian components lies exp(-9/2) = 1.1 %; tests by row and neighbourhood
        # may cost as much again each
        assert (got < 1.0).mean() < 0.035
        assert (got == 0.0).mean() < 0.01

    def test_a_jump_that_a_whole_row_shares_is_motion_and_stays(self):
        post = drawn(self.star(), 13).reshape(self.ROWS, self.BLOCKS, 2)
        # two sigmas of a single window: eight of the mean of a row, seen by every window of it alike
        post[30] += 2 * SIGMA
        got = self.weights(post.reshape(-1, 1, 2))[30, :, 0]
        assert (got > 0.0).mean() > 0.9

    def test_one_mismatch_is_thrown_out_alone(self):
        post = drawn(self.star(), 14).reshape(self.ROWS, self.BLOCKS, 2)
        calm = self.weights(post.reshape(-1, 1, 2).copy())[..., 0]
        post[30, 5] += 20 * SIGMA
        got = self.weights(post.reshape(-1, 1, 2))[..., 0]
        assert got[30, 5] == 0.0
        around = got[29:32, 4:7].copy()
        around[1, 1] = calm[30, 5] = 1.0
        assert (around > 0.0).sum() >= (calm[29:32, 4:7] > 0.0).sum()

    def test_weight_falls_between_what_is_usual_and_what_is_impossible(self):
        post = np.zeros((self.ROWS * self.BLOCKS, 1, 2))
        post[::5, 0] = SIGMA * 0.7
        star = plain_star(self.ROWS, 3, 1, SIGMA)
        post = post[: self.ROWS * 3]
        post[10, 0], post[100, 0] = (4.0 * SIGMA, 0.0), (9.0 * SIGMA, 0.0)
        got = robust_weights(star, post)[:, 0]
        assert 0.0 < got[10] < 1.0 and got[100] == 0.0
        assert (np.delete(got, [10, 100]) == 1.0).all()

    def test_absent_matches_have_no_weight(self):
        post = drawn(self.star(2), 15)
        post[:50, 0] = np.nan
        got = robust_weights(self.star(2), post)
        assert not got[:50, 0].any() and (got[:50, 1] > 0).mean() > 0.9

    def test_a_pair_that_matched_nowhere_has_no_weight(self):
        post = drawn(self.star(2), 16)
        post[:, 1] = np.nan
        got = robust_weights(self.star(2), post)
        assert not got[:, 1].any() and got[:, 0].any()


class TestRowWeights:
    def test_a_stretch_of_rows_that_scatters_three_times_as_much_counts_a_ninth(self):
        star = plain_star(300, 20, 2, SIGMA)
        post = drawn(star, 17).reshape(300, 20, 2, 2)
        post[100:160, :, 1] *= 3.0
        got = row_weights(star, post.reshape(-1, 2, 2)).reshape(300, 20, 2)
        assert (got == got[:, :1]).all()
        # thirteen rows of 20 windows and two components: 470 squares, a scatter of 6.5 % of the variance
        inside, outside = got[115:145, 0, 1], np.concatenate([got[:80, 0, 1], got[180:, 0, 1]])
        assert_allclose(inside, 1 / 9, rtol=4 * 0.065)
        assert outside.min() > 1 - 4 * 0.065 and np.median(outside) > 0.93
        assert got[..., 0].min() > 1 - 4 * 0.065

    def test_motion_of_the_rows_is_no_scatter(self):
        star = plain_star(100, 10, 1, SIGMA)
        post = drawn(star, 18)
        moved = post + row_motion(star, 19) * (np.arange(1000) < 500)[:, None, None]
        assert_allclose(row_weights(star, moved), row_weights(star, post), rtol=1e-6)

    def test_no_row_counts_for_more_than_it_claims(self):
        star = plain_star(100, 10, 1, SIGMA)
        assert row_weights(star, 0.1 * drawn(star, 20)).max() <= 1.0

    @pytest.mark.parametrize("blocks", [1, 3])
    def test_rows_too_narrow_to_judge_keep_their_weight(self, blocks):
        star = plain_star(50, blocks, 1, SIGMA)
        assert_allclose(row_weights(star, drawn(star, 21)), 1.0)


def test_the_start_value_is_the_correlation_of_differences_that_share_an_image():
    rng = np.random.default_rng(1)
    hub, *partners = rng.standard_normal((4, 2, 40_000))  # errors of four images, two axes
    differences = np.concatenate([partner - hub for partner in partners])
    # correlations of 40 000 draws scatter by 0.005
    assert_allclose(np.corrcoef(differences), shared_image_correlation(3), atol=0.025)


@pytest.mark.parametrize(("rows", "blocks", "start"), [(100, 8, 0.0), (88, 3, 10.0)])
def test_the_variance_of_single_matches_is_that_within_rows(rows, blocks, start):
    star = plain_star(rows, blocks, 1, SIGMA)
    lasting = drawn(star, 3).reshape(rows, blocks, 1, 2)
    # alike in eight rows: sums over rows grow, single matches do not
    lasting = np.sqrt(2.0) * np.repeat(lasting[::8], 8, axis=0)[:rows]
    (found,) = single_errors([star], [lasting.reshape(-1, 1, 2) + row_motion(star, 4)])
    degrees = rows * (blocks - 2)
    expected = (degrees * 2.0 + start) / (degrees + start)
    # an eighth of the rows are independent; five of their sigma
    chance = 5.0 * np.sqrt(2.0 / (degrees / 8))
    assert_allclose(found[0], expected * np.eye(2), atol=chance * expected)


def test_too_few_windows_leave_the_variance_that_the_matcher_claims():
    star = plain_star(30, 3, 1, SIGMA)
    (found,) = single_errors([star], [3.0 * drawn(star, 0)])
    assert_allclose(found, np.eye(2)[None])
    # where there are others, it is theirs: of one whose errors have four times the variance claimed
    other = plain_star(1500, 8, 2, SIGMA)
    post = 2.0 * drawn(other, 1)
    post[:, 1] = np.nan
    few, both = single_errors([star, other], [3.0 * drawn(star, 0), post])
    # 9000 degrees: sqrt(2 / 9000) = 1.5 %, four of these
    assert_allclose(both[0], 4.0 * np.eye(2), atol=0.06 * 4.0)
    assert_allclose(both[1], both[0])
    assert_allclose(few[0], both[0])


def test_what_single_matches_err_by_is_along_lines_and_columns_that_of_drawn_ones():
    # the matcher claims errors that correlate by 0.8; along lines they are twice as large, and what columns
    # add to that half
    star = plain_star(3000, 8, 1, SIGMA)
    claimed = SIGMA**2 * np.array([[1.0, 0.8], [0.8, 1.0]])
    post = (drawn(star, 5) * [2.0, 0.5]) @ (np.linalg.cholesky(claimed) / SIGMA).T
    # alike in nine rows: long means err by nine times as much, which is no matter of single matches
    post = np.repeat(post.reshape(3000, 8, 1, 2)[::9], 9, axis=0)[:3000].reshape(-1, 1, 2)
    star = replace(star, covariance_px=np.tile(claimed, (24000, 1, 1, 1)))
    (single,) = single_errors([star], [post])
    found = replace(star, single=single).error_variance(slice(0, 3))
    expected = SIGMA**2 * np.array([4.0, 0.64 * 4.0 + 0.36 * 0.25])
    # 18000 degrees, 2000 of them independent: sqrt(2 / 2000) = 3.2 %, four of these
    assert_allclose(found, np.tile(expected, (3, 1, 1)), rtol=0.13)
    long = star.with_correlation(estimate_correlation(star, post)).error_variance(slice(0, 3))
    assert (long > 2.0 * found).all()


def test_pairs_that_are_not_seen_together_still_have_a_covariance():
    # each row shows two of three partners, whose errors are alike, alike, opposite: no three numbers are so
    rng = np.random.default_rng(3)
    star = plain_star(90, 3, 3, SIGMA)
    alike = rng.normal(size=(270, 2)) * SIGMA
    post = np.full((270, 3, 2), np.nan)
    for pair, (one, other, sign) in enumerate([(0, 1, 1.0), (1, 2, 1.0), (0, 2, -1.0)]):
        rows = (np.arange(270) // 3) % 3 == pair
        post[rows, one], post[rows, other] = alike[rows], sign * alike[rows]
    star = replace(star, residual_px=post)
    correlation = estimate_correlation(star, post)
    assert np.linalg.eigvalsh(correlation)[0] > 0.0
    assert np.abs(correlation[0, 2]) > 0.2


def test_few_rows_do_not_make_some_pairs_look_better_than_others():
    # 75 rows of four windows leave 150 squares a component: long sums of them scatter by
    # sqrt(4/3 * 9 / 150) = 28 %, and the variances of six components, averaged over three pairs, by
    # 28 / sqrt(3) = 16 % and what is left of the plain ones, sqrt(2 / 150) = 12 %: 20 %
    found = []
    for seed in range(20):
        star = plain_star(75, 4, 3, SIGMA)
        found.append(np.diag(estimate_correlation(star, drawn(star, 700 + seed))))
    assert np.std(found) < 0.24
    # the mean of 40 independent draws of that: 4 sigma
    assert np.mean(found) == pytest.approx(1.0, abs=4 * 0.2 / np.sqrt(40))


def test_pairs_whose_errors_last_are_told_from_those_whose_errors_do_not():
    # 1,500 rows of ten windows: long sums scatter by sqrt(4/3 * 9 / 12,000) = 3 %
    star = plain_star(1500, 10, 2, SIGMA)
    error = drawn(star, 3).reshape(1500, 10, 2, 2)
    error[1:, :, 1] = (error[1:, :, 1] + error[:-1, :, 1]) / np.sqrt(2.0)
    size = np.diag(estimate_correlation(star, error.reshape(-1, 2, 2)))
    assert size[:2] == pytest.approx(1.0, abs=0.15)
    # a mean of two neighbours: twice the variance in long sums, of which the weights of nine rows see
    # 1 + 8/9
    assert size[2:] == pytest.approx(1.0 + 8.0 / 9.0, abs=0.2)
