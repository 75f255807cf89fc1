"""Windows that did not see the ground, against drawn departures of known place and size."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from motion.strips import plain_star
from sightline.motion.measure import consensus
from sightline.motion.measure.consensus import ground_weights
from sightline.motion.measure.observations import Star

SIGMA = 0.05
ROWS, BLOCKS = 150, 12


def star_of(pairs: int = 1, blocks: int = BLOCKS) -> Star:
    """Rows of windows 4 lines apart; the k-th pair has a lag of 0.02 k s."""
    return plain_star(ROWS, blocks, pairs, SIGMA)


def noise(star: Star, seed: int) -> NDArray[np.float64]:
    """Independent errors of the stated size, (rows, blocks, K, 2) px."""
    return SIGMA * np.random.default_rng(seed).standard_normal((*star.shape, star.t.shape[1], 2))


def weights(star: Star, post: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, blocks, K)."""
    return ground_weights([star], [post.reshape(*star.t.shape, 2)])[0].reshape(*star.shape, -1)


def seeing_heights(star: Star) -> Star:
    """The same where a higher target shifts along the lines, in proportion to lag."""
    lag = star.t - star.t_hub[:, None]
    by_height = np.stack([-0.01 * lag, np.zeros_like(lag)], axis=-1)
    return replace(star, by_height=by_height.astype(np.float32))


def test_rows_of_a_long_star_are_judged_in_parts_with_rows_beside_them(monkeypatch):
    star, row = star_of(2), np.arange(float(ROWS))
    least = np.repeat(row[:, None], BLOCKS, axis=1)
    post = np.broadcast_to(row.repeat(BLOCKS)[:, None, None], (ROWS * BLOCKS, 2, 2))
    reach, parts = 2 * consensus._reaches(star)[-1], []

    def near(part, own, least, relief_sigma, cloudy):
        parts.append((int(least[0, 0]), int(least[-1, 0])))
        assert part.shape == least.shape == (len(own) // BLOCKS, BLOCKS)
        assert (own == least.reshape(-1, 1, 1)).all()
        return least + 0.5, least[0, 0] == 0.0

    monkeypatch.setattr(consensus, "_foreign_near", near)
    monkeypatch.setattr(consensus, "MOST_ROWS", 40)
    monkeypatch.setattr(consensus, "HALO", 2)
    found, told = consensus._foreign(star, post, least, 0.0)
    assert_allclose(found, least + 0.5)
    # told by one part, the first, is told; 150 rows in four parts of 37 and 38
    assert told and reach > 0
    ends = np.linspace(0, ROWS, 5).round().astype(int).tolist()
    assert parts == [(max(a - reach, 0), min(b + reach, ROWS) - 1) for a, b in pairwise(ends)]


class TestClearView:
    def test_errors_of_the_expected_size_keep_their_weight(self):
        got = weights(star_of(), noise(star_of(), 1))
        # of q ~ chi2(2) 2 % exceed 8 and lose less than half of their weight, at each of two reaches
        assert got.mean() > 0.96
        # P(q > 20) = exp(-10) = 0.005 %, for single windows and for some 200 independent means per reach
        assert (got == 0.0).mean() < 0.005

    def test_motion_of_the_rows_is_nothing_foreign(self):
        star = star_of()
        post = noise(star, 2)
        shift, tilt = np.random.default_rng(3).standard_normal((2, ROWS, 1, 1, 2))
        moved = post + shift + tilt * star.field.reshape(ROWS, BLOCKS, 1, 1)
        assert_allclose(weights(star, moved), weights(star, post), atol=1e-6)

    def test_relief_nobody_knows_is_what_is_usual(self):
        star = star_of()
        rough = np.random.default_rng(4).standard_normal((ROWS + 20, BLOCKS, 1, 2))
        hills = sum(rough[k : k + ROWS] for k in range(20)) / np.sqrt(20)
        got = weights(star, noise(star, 5) + 3 * SIGMA * hills)
        # departures of Gaussian hills, four times what the matches claim: as of plain noise a few per cent
        # are beyond USUAL, and lines through such windows are uncertain
        assert got.mean() > 0.7

    def test_matches_that_claim_too_much_or_too_little_change_nothing(self):
        star = star_of()
        post = noise(star, 6)
        modest = replace(star, covariance_px=9.0 * star.covariance_px)
        assert_allclose(weights(modest, post), weights(star, post), atol=1e-9)

    @pytest.mark.parametrize("blocks", [1, 3])
    def test_rows_too_narrow_to_judge_keep_their_weight(self, blocks):
        star = star_of(2, blocks)
        assert_allclose(weights(star, noise(star, 7)), 1.0)

    def test_images_of_one_instant_tell_nothing_and_lose_nothing(self):
        star = star_of()
        star = replace(star, t=star.t_hub[:, None].copy())
        assert_allclose(weights(star, noise(star, 33)), 1.0)

    def test_a_first_star_of_one_row_is_no_judge(self):
        one, other = plain_star(1, 6, 1, SIGMA), replace(plain_star(1, 5, 1, SIGMA), hub=1, images=(0,))
        got = ground_weights([one, other], [np.zeros((6, 1, 2)), np.zeros((5, 1, 2))])
        assert all((g == 1.0).all() for g in got)

    def test_absent_windows_have_no_weight(self):
        star = star_of(2)
        post = noise(star, 8)
        post[10:20, 4] = np.nan
        star = replace(star, residual_px=post.reshape(-1, 2, 2))
        got = weights(star, post)
        assert not got[10:20, 4].any() and got[10:20].mean() > 0.7

    def test_chance_matches_of_blank_ground_are_not_believed(self):
        star = star_of()
        post = noise(star, 30)
        post[50:110] = np.nan
        rng = np.random.default_rng(31)
        lonely = rng.uniform(size=(60, BLOCKS)) < 0.02
        post[50:110][lonely] = 0.3 * rng.standard_normal((lonely.sum(), 1, 2))
        star = replace(star, residual_px=post.reshape(-1, 1, 2))
        got = weights(star, post)[..., 0]
        assert lonely[8:-8].sum() >= 4 and not got[58:102].any()
        assert got[:50].mean() > 0.96 and got[110:].mean() > 0.96

    @pytest.mark.parametrize("blank", [False, True])
    def test_windows_that_were_not_chosen_do_not_make_the_chosen_lonely(self, blank):
        star = star_of()
        rng = np.random.default_rng(34)
        # one in twelve: less than LONELY of all; of the chosen, all or 2 % were matched
        chosen = rng.uniform(size=star.shape) < 1 / BLOCKS
        chosen |= blank
        matched = chosen & (rng.uniform(size=star.shape) < 0.02) if blank else chosen
        post = np.where(matched[..., None, None], noise(star, 35), np.nan)
        star = replace(star, residual_px=post.reshape(-1, 1, 2), chosen=chosen.ravel())
        got = weights(star, post)[..., 0]
        # as of windows of the expected size above: 4 % less than all at most, and what few windows of a row
        # leave to their line
        assert not got.any() if blank else got[matched].mean() > 0.9

    def test_a_coast_of_two_columns_is_believed(self):
        star = star_of()
        post = noise(star, 32)
        post[50:110, 2:] = np.nan
        star = replace(star, residual_px=post.reshape(-1, 1, 2))
        assert weights(star, post)[50:110, :2].mean() > 0.9


class TestClouds:
    def test_what_no_single_window_shows_is_seen_over_many(self):
        star = star_of()
        post = noise(star, 9)
        post[50:90, 3:5] += SIGMA
        got = weights(star, post)[..., 0]
        inside = got[55:85, 3:5]
        # mean of 13 rows: squared departure 2 * 13, of 41 rows three times that (without the two the
        # line is that of the other ten): far beyond what counts in full
        assert inside.mean() < 0.25
        assert got[:, 6:].mean() > 0.85
        # what the row's mean is off: a sigma of two windows in twelve, before; less than half of it, after
        bias = (got[55:85] * post[55:85, :, 0, 0]).sum() / got[55:85].sum()
        assert bias < 0.5 * SIGMA * 2 / 12 + 2 * SIGMA / np.sqrt(30 * 10)

    def test_a_patch_that_moved_by_itself_is_thrown_out(self):
        star = star_of()
        post = noise(star, 10)
        post[60:72, 3:7, 0] += (0.6, -0.5)
        got = weights(star, post)[..., 0]
        assert not got[60:72, 3:7].any()
        assert got[:30].mean() > 0.9 and got[100:].mean() > 0.9

    @pytest.mark.parametrize("edge", [20, 64, 66, 75])
    def test_it_is_thrown_out_wherever_rows_that_are_judged_together_end(self, edge, monkeypatch):
        star = star_of()
        post = noise(star, 10)
        post[60:72, 3:7, 0] += (0.6, -0.5)
        whole = weights(star, post)[..., 0]
        # 150 rows in two parts, the patch at their common end or beside it
        monkeypatch.setattr("sightline.motion.measure.consensus.MOST_ROWS", 75)
        shifted = np.roll(post, edge, axis=0)
        got = np.roll(weights(star, shifted)[..., 0], -edge, axis=0)
        assert not got[60:72, 3:7].any()
        # what is usual is learned of half as many rows: few windows lose or gain much by it
        assert abs(got.mean() - whole.mean()) < 0.02

    @pytest.mark.parametrize(("blocks", "cloudy"), [(12, 7), (6, 3)])
    def test_the_lower_of_two_layers_is_the_ground(self, blocks, cloudy):
        star = seeing_heights(star_of(2, blocks))
        lag = np.array([0.5, 1.0])
        post = noise(star, 11)
        # half of the windows and more on clouds: above, -y, as their height in `seeing_heights` shifts them
        post[40:100, :cloudy, :, 0] -= 10 * SIGMA * lag
        got = weights(star, post)
        assert not got[42:98, :cloudy].any()
        assert got[42:98, cloudy:].mean() > 0.7

    def test_more_windows_win_where_heights_shift_nothing(self):
        star = star_of(2)
        post = noise(star, 12)
        post[40:100, :7, :, 0] -= 10 * SIGMA * np.array([0.5, 1.0])
        got = weights(star, post)
        assert not got[42:98, 7:].any()
        assert got[42:98, :7].mean() > 0.7

    def test_a_pair_of_short_lag_keeps_what_a_long_one_loses(self):
        star = star_of(2)
        star = replace(star, t=star.t_hub[:, None] + np.array([0.002, 0.1]))
        post = noise(star, 13)
        post[:, 5, 1, 0] += 0.45 * SIGMA
        post[:, 5, 0, 0] += 0.45 * SIGMA * 0.02
        got = weights(star, post)[:, 5]
        # the mean of 41 rows departs by 0.45 sqrt(41 * 11 / 12) = 2.8 of its sigmas, about sqrt(USUAL)
        doubted = (got[:, 1] < 1.0) & (got[:, 1] > 0.0)
        # evidence on the short pair is (0.02)^2 of that on the long one
        assert doubted.sum() >= 10 and (got[doubted, 0] == 1.0).all()

    def test_rows_of_two_windows_are_judged_by_their_neighbours(self):
        star = star_of()
        post = noise(star, 14)
        post[70:74, :2] = post[70:74, 4:10] = np.nan
        post[70:74, 10:] = np.nan
        post[70:74, 3] += 12 * SIGMA
        star = replace(star, residual_px=post.reshape(-1, 1, 2))
        got = weights(star, post)[..., 0]
        assert not got[70:74, 3].any() and got[70:74, 2].all()

    def test_rows_of_which_hardly_any_window_saw_the_ground_say_nothing(self):
        star = star_of()
        post = noise(star, 15)
        post[60:100, :10] -= 40 * SIGMA * np.random.default_rng(16).uniform(0.3, 1.0, (1, 10, 1, 2))
        got = weights(star, post)[..., 0]
        assert not got[66:94].any()
        assert got[:50].mean() > 0.9

    def test_rows_whose_line_the_clouds_took_say_nothing(self):
        star = seeing_heights(star_of(2))
        post = noise(star, 17)
        # ten of twelve: more than twice the ground
        post[60:100, :10, :, 0] -= 10 * SIGMA * np.array([0.5, 1.0])
        got = weights(star, post)
        assert not got[62:98].any()
        assert got[:50].mean() > 0.9


class TestBrightness:
    """Two layers that agree with themselves in a stretch of rows; elsewhere the brighter one is rare."""

    def strip(self, seed: int) -> tuple[Star, NDArray[np.float64], NDArray[np.bool_]]:
        star = star_of()
        rng = np.random.default_rng(seed)
        cloudy = np.zeros(star.shape, dtype=bool)
        cloudy[64:78, :8] = True
        cloudy[:50, 2:5] = cloudy[100:140, 8:10] = True
        post = noise(star, seed + 1)
        post[cloudy, :, 0] -= 8 * SIGMA
        brightness = np.where(cloudy, 300.0, 100.0) + 20.0 * rng.standard_normal(star.shape)
        return replace(star, brightness=brightness.ravel()), post, cloudy

    def test_what_is_learned_in_clear_view_tells_the_layers_apart(self):
        star, post, cloudy = self.strip(20)
        without = weights(replace(star, brightness=None), post)[..., 0]
        assert without[66:76, :8].mean() > 0.5  # eight of twelve agree: nothing else speaks against them
        got = weights(star, post)[..., 0]
        assert not got[cloudy].any()
        assert got[66:76, 8:].mean() > 0.7

    def test_bright_ground_that_moves_with_the_rest_is_kept(self):
        star = star_of()
        brightness = 100.0 * np.random.default_rng(22).standard_exponential(star.shape)
        post = noise(star, 23)
        got = weights(replace(star, brightness=brightness.ravel()), post)
        assert_allclose(got, weights(star, post), atol=1e-12)

    def test_rows_of_few_dark_windows_are_believed_whatever_the_motion_was_thought_to_be(self):
        star, post, cloudy = self.strip(26)
        # hardly any ground between clouds: there the estimate of the motion is off, by a shift and a tilt
        cloudy[84:100, 1:11] = True
        brightness = star.brightness.reshape(star.shape).copy()
        brightness[84:100, 1:11] = 300.0
        post[84:100, :, :, 0] += 10 * SIGMA * (1.0 + star.field.reshape(star.shape)[84:100, :, None])
        got = weights(replace(star, brightness=brightness.ravel()), post)[..., 0]
        # a window of ground that happens to be beyond 2.5 sigma (14 % to be one of 24) costs five rows of one
        assert not got[cloudy].any() and (got[86:98][:, [0, 11]] > 0.0).sum() >= 24 - 5

    def test_a_bank_over_rows_too_short_for_a_line_is_left_out(self):
        star = plain_star(ROWS, 3, 1, SIGMA)
        white = np.zeros(star.shape, dtype=bool)
        white[60:80] = True
        brightness = np.where(white, 300.0, 100.0) + 20.0 * np.random.default_rng(28).standard_normal(
            star.shape
        )
        post = noise(star, 29)
        star = replace(star, brightness=brightness.ravel())
        got = ground_weights([star], [post.reshape(-1, 1, 2)])[0].reshape(star.shape)
        assert not got[white].any()
        # ABOUT is twenty rows, where 0.6 % of the ground is as bright
        assert got[:38].all() and got[102:].all() and got[~white].mean() > 0.95

    def test_few_windows_that_were_chosen_in_rows_too_short_for_a_line_are_kept(self):
        star = plain_star(ROWS, 3, 1, SIGMA)
        post = noise(star, 30).reshape(-1, 1, 2)
        chosen = np.zeros(len(post), dtype=bool)
        chosen[::17] = True  # of what lies about them 6 % was matched
        post[~chosen] = np.nan
        star = replace(star, residual_px=np.where(chosen[:, None, None], star.residual_px, np.nan))
        assert ground_weights([star], [post])[0][chosen].all()

    def test_windows_of_unknown_brightness_are_judged_by_their_departure(self):
        star, post, cloudy = self.strip(24)
        brightness = star.brightness.reshape(star.shape).copy()
        brightness[:10] = np.nan
        got = weights(replace(star, brightness=brightness.ravel()), post)[..., 0]
        assert not got[cloudy].any() and got[:10][~cloudy[:10]].mean() > 0.85


class TestSameGround:
    """A short star of another hub, on ground that the first hub's star has judged."""

    def test_a_short_star_trusts_no_more_than_the_long_one_does(self):
        long = star_of()
        post = noise(long, 40)
        post[90:140, :4] -= 10 * SIGMA
        post[60:150, 4] = np.nan
        long = replace(long, residual_px=post.reshape(-1, 1, 2), hub=0, images=(1,))
        short = plain_star(4, BLOCKS, 1, SIGMA)
        # its windows are seen in image 0 while that took rows 110 to 113 of the long star
        t = long.t_hub.reshape(ROWS, BLOCKS)[110:114].reshape(-1, 1)
        short = replace(short, hub=1, images=(0,), t=t, t_hub=t[:, 0] + 0.02)
        other = noise(short, 42)
        # the cloud tilts the four rows just enough that by themselves they would not find it
        other[:, :4] -= 0.8 * SIGMA
        posts = [post.reshape(-1, 1, 2), other.reshape(-1, 1, 2)]
        alone = ground_weights([short], posts[1:])[0].reshape(4, BLOCKS)
        assert (alone[:, :5] > 0).mean() > 0.7
        same = ground_weights([long, short], posts)[1].reshape(4, BLOCKS)
        # cloud in columns 0 to 3; in column 4 the long star looked and saw nothing
        assert not same[:, :5].any()
        assert same[:, 6:].mean() > 0.8
