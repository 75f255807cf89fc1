"""Unknown relief as processes of rows, against drawn terrain and dense covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import ALTITUDE, IFOV, PERIOD, SPEED, plain_star, strip_cameras
from sightline.geometry.surface import Plane
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.relief import (
    detrended_share,
    hub_delay,
    relief_lengths,
    relief_matters,
    relief_share,
    row_processes,
    row_scatter,
    terrain_covariance,
)

HEIGHT, LENGTH, HALF_WIDTH, ALONG = 12.0, 700.0, 1000.0, 20000.0


def matern32(distance: np.ndarray, length: float = LENGTH) -> np.ndarray:
    """Unit Matern 3/2 by its general form, 2^(1 - v) / Gamma(v) z^v K_v(z), z = sqrt(2 v) r / length."""
    from scipy.special import gamma, kv

    z = np.maximum(np.sqrt(3.0) * np.abs(distance) / length, 1e-9)
    return 2.0 ** (1 - 1.5) / gamma(1.5) * z**1.5 * kv(1.5, z)


def dense_covariance(process) -> np.ndarray:
    """Covariance of all epochs of an autoregression, from the inverse of its precision."""
    ab = process.precision_band()
    full = sum(np.diag(ab[d, : process.n - d], -d) for d in range(len(ab)))
    return np.linalg.inv(full + np.tril(full, -1).T)


def test_terrain_is_a_matern_field_of_order_three_halves():
    r = np.array([0.0, 10.0, 300.0, 5000.0])
    # the form by Bessel functions starts at z = 1e-9
    assert_allclose(terrain_covariance(r, LENGTH), matern32(r), rtol=1e-7)


def test_rows_have_the_mean_and_slope_of_dense_fields():
    """Drawn fields of two lengths: 9 rows 100 m apart, 41 points each; functionals by least squares."""
    rows, points, step, draws = 9, 41, 100.0, 3000
    x = np.linspace(-1.0, 1.0, points)
    y, across = np.meshgrid(step * np.arange(rows), HALF_WIDTH * x, indexing="ij")
    place = np.stack([y.ravel(), across.ravel()], axis=1)
    distance = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    lengths = (LENGTH, 0.5 * LENGTH)
    processes = row_processes(HEIGHT, lengths, HALF_WIDTH, SPEED, TimeGrid(0.0, step / SPEED, 60))
    for kind, (process, length) in enumerate(zip(processes, lengths, strict=True)):
        factor = np.linalg.cholesky(HEIGHT**2 * matern32(distance, length) + 1e-6 * np.eye(len(place)))
        field = factor @ np.random.default_rng(0).standard_normal((len(place), draws))
        each_row = field.reshape(rows, points, draws).transpose(1, 0, 2).reshape(points, -1)
        values = np.polynomial.polynomial.polyfit(x, each_row, 1).reshape(2, rows, draws)[kind]
        got = dense_covariance(process)[20, 20 : 20 + rows]
        want = values @ values[0] / draws
        # a product of two correlated variables of that variance scatters by at most sqrt(2 / draws) = 2.6 %
        # of it; four of these; 21 points across instead of 41 change the variance of mean and slope by 1 / 20
        # of a point's share, at most 1 / 21 of it in a field as smooth as this: 1 %
        assert_allclose(got, want, atol=(4 * 0.026 + 0.01) * want[0])
        assert abs(want[-1]) < 0.6 * want[0]


def test_the_variance_of_a_row_is_shared_between_mean_slope_and_the_rest():
    # by numerical projection onto orthonormal Legendre polynomials with Gauss's nodes
    x, w = np.polynomial.legendre.leggauss(60)
    for length in (200.0, LENGTH, 4000.0):
        k = matern32(HALF_WIDTH * (x[:, None] - x[None, :]), length)
        taken = sum((2 * n + 1) / 2 * (w * p) @ k @ (w * p) / 2 for n, p in ((0, np.ones_like(x)), (1, x)))
        # 21 evenly spaced points stand for the row: sums differ from integrals by a twentieth
        assert_allclose(detrended_share(length, HALF_WIDTH), 1.0 - taken, rtol=0.1, atol=1e-3)


def test_short_relief_stays_in_the_row_and_long_relief_is_its_mean_and_slope():
    shares = [detrended_share(length, HALF_WIDTH) for length in (10.0, 100.0, 1000.0, 10000.0)]
    assert shares == sorted(shares, reverse=True)
    # 21 independent points lose two of their degrees of freedom
    assert_allclose(shares[0], 19 / 21, rtol=1e-3)
    assert shares[-1] < 1e-2


def terrain_rows(star, half_width: float, length: float, seed: int) -> np.ndarray:
    """Heights (G,) m of windows: every row a draw of its own."""
    rows, blocks = star.shape
    across = half_width * star.field[:blocks]
    k = matern32(across[:, None] - across[None, :], length) + 1e-9 * np.eye(blocks)
    return (
        HEIGHT
        * (np.random.default_rng(seed).standard_normal((rows, blocks)) @ np.linalg.cholesky(k).T).ravel()
    )


@pytest.mark.parametrize("component", [0, 1], ids=["along the track", "along columns"])
@pytest.mark.parametrize("length", [400.0, 1500.0])
def test_the_length_of_relief_is_found_from_what_pairs_share_along_the_parallax(length, component):
    sigma, by_height = 0.05, np.array([-0.012, -0.02])
    star = plain_star(1500, 21, 2, sigma)
    # the windows' field runs to 0.9 of half the swath
    heights = terrain_rows(star, HALF_WIDTH / 0.9, length, 3)
    rng = np.random.default_rng(4)
    shared = rng.standard_normal((len(heights), 1, 2))
    post = sigma / np.sqrt(2) * (shared + rng.standard_normal((len(heights), 2, 2)))
    post[..., component] += heights[:, None] * by_height
    table = np.zeros((len(heights), 2, 2), np.float32)
    table[..., component] = by_height
    scatter = row_scatter([replace(star, by_height=table)], [post])
    of_mean, of_slope = relief_lengths(scatter, HEIGHT, HALF_WIDTH, ALONG)
    # 1500 rows give the share to sqrt(2 / 1500) = 4 % even if one shape alone were left in a row, the errors
    # of matching, half shared, to 0.05^2 / 2 / (0.012 * 0.02 * 144 * share), below 3 % / sqrt(1500 * 19) of
    # it; the share falls with length^-1 .. length^-3, so 4 * 4 % of it is at most 16 % of length; the table
    # of lengths steps by 14 %; two standard deviations either way are a length each
    assert length / 1.3 < of_mean < length * 1.3
    assert length / 1.3 < of_slope < length * 1.3


def test_without_relief_in_the_residuals_its_length_is_the_longest_that_is_believed():
    """What does not show within a row may still be there along the strip: it is not taken for flat."""
    star = plain_star(500, 21, 2, 0.05)
    table = np.zeros((*star.t.shape, 2), np.float32)
    table[..., 0] = -0.02
    # errors alike on both axes, of either sign by chance: less than any share of 12 m
    post = 1e-4 * np.random.default_rng(5).standard_normal((*star.t.shape, 2))
    seen = [replace(star, by_height=table)]
    beside = row_scatter(seen, [post])
    assert relief_lengths(beside, HEIGHT, HALF_WIDTH, ALONG) == pytest.approx(2 * (2.0 * HALF_WIDTH,))
    # slopes of a tenth, where the swath is narrower than such hills
    assert relief_lengths(beside, HEIGHT, HEIGHT, ALONG) == pytest.approx(2 * (10.0 * HEIGHT,))


@pytest.mark.parametrize("hills", [True, False], ids=["hills", "flat"])
def test_the_variance_about_rows_lies_between_its_bounds(hills):
    """Five pairs, the hub between its partners; rows 50 m apart see one hill; lines err more by a tenth."""
    rows, blocks, sigma = 80, 9, 0.05
    by_height = np.array([-0.012, 0.02, -0.02, 0.03, -0.016])
    star = plain_star(rows, blocks, len(by_height), sigma)
    table = np.zeros((*star.t.shape, 2), np.float32)
    table[..., 0] = by_height
    seen = replace(star, by_height=table)
    x = np.linspace(-0.9, 0.9, blocks)
    place = np.stack(np.meshgrid(50.0 * np.arange(rows), HALF_WIDTH * x, indexing="ij"), axis=-1).reshape(
        -1, 2
    )
    k = HEIGHT**2 * matern32(np.linalg.norm(place[:, None] - place[None, :], axis=2))
    factor = np.linalg.cholesky(k + 1e-6 * np.eye(len(k)))
    left = np.eye(blocks) - np.vander(x, 2) @ np.linalg.pinv(np.vander(x, 2))
    # degrees of freedom that a row keeps are not given back: nor are they to residuals
    truth = np.trace(left @ k[:blocks, :blocks] @ left) / blocks if hills else 0.0
    rng, inside = np.random.default_rng(8), 0
    for _ in range(40):
        shared = rng.standard_normal((len(k), 1, 2))
        post = sigma / np.sqrt(2) * (shared + rng.standard_normal((len(k), len(by_height), 2)))
        post[..., 0] *= 1.1
        if hills:
            post[..., 0] += (factor @ rng.standard_normal(len(k)))[:, None] * by_height
        least, most = row_scatter([seen], [post])
        inside += least <= truth <= most
    # two standard deviations: 38 of 40, four in five of them where hills are longer than rows that are taken
    # as alike; less three standard deviations of so many draws. Pairs taken as independent: 1 of 40
    assert inside >= 24


def test_residuals_without_a_scatter_of_relief_leave_it_open():
    star = plain_star(40, 6, 2, 0.05)
    table = np.zeros((*star.t.shape, 2), np.float32)
    table[..., 0] = -0.02
    seen, nothing = replace(star, by_height=table), np.zeros((*star.t.shape, 2))
    # no parallax; no residuals; no windows that two pairs share
    assert row_scatter([star], [nothing + 0.01]) == (0.0, np.inf)
    assert row_scatter([seen], [nothing]) == (0.0, np.inf)
    apart = 0.05 * np.random.default_rng(3).standard_normal(nothing.shape)
    apart[: len(apart) // 2, 0] = apart[len(apart) // 2 :, 1] = np.nan
    assert row_scatter([seen], [apart]) == (0.0, np.inf)


def test_at_lags_so_short_that_relief_is_lost_in_errors_any_length_may_be_and_each_hides_what_it_can():
    """Errors of matches, alike on both axes but for chance, look like hills: they tell nothing."""
    star = plain_star(60, 6, 2, 0.03)
    table = np.zeros((*star.t.shape, 2), np.float32)
    table[..., 0] = [-2e-5, -1.3e-4]
    rng = np.random.default_rng(6)
    for _ in range(20):
        post = 0.03 * (rng.standard_normal((len(star.t), 1, 2)) + rng.standard_normal((len(star.t), 2, 2)))
        beside = row_scatter([replace(star, by_height=table)], [post])
        # 0.03^2 px^2 / sqrt(360) over 2e-5 * 1.3e-4 px^2/m^2 is (140 m)^2: two of these and more
        assert beside[0] < HEIGHT**2 < 140.0**2 < beside[1]
        # of all lengths the mean of rows has the longest over ten swaths, the slope one of about half a swath
        of_mean, of_slope = relief_lengths(beside, HEIGHT, HALF_WIDTH, ALONG)
        assert of_mean == pytest.approx(2.0 * HALF_WIDTH)
        assert 0.6 * HALF_WIDTH < of_slope < 1.2 * HALF_WIDTH


@pytest.mark.parametrize("along", [300.0, 1500.0, ALONG])
def test_of_all_lengths_each_has_that_which_hides_most(along):
    """Trend of the mean and mean of the slope by least squares in the dense covariance of 21 x 31 points."""
    x, y = np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 31)
    place = np.stack([v.ravel() for v in np.meshgrid(0.5 * along * y, HALF_WIDTH * x, indexing="ij")], axis=1)
    distance = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    # coefficients of y and of x, that is of yx^0 and y^0x
    design = np.stack([np.kron(one, two) for one in (y**0, y) for two in (x**0, x)], axis=1)
    fit = np.linalg.pinv(design)[[2, 1]]

    def hidden(length: float) -> np.ndarray:
        return np.sqrt(np.einsum("ij,jk,ik->i", fit, matern32(distance, length), fit))

    chosen = relief_lengths((0.0, np.inf), HEIGHT, HALF_WIDTH, along)
    lengths = np.geomspace(50.0, 2.0 * HALF_WIDTH, 25)
    most = np.max([hidden(length) for length in lengths], axis=0)
    # flat about the largest, between which lengths step by a third: within 2 %
    assert_allclose([hidden(length)[k] for k, length in enumerate(chosen)], most, rtol=0.02)


def test_a_strip_far_longer_than_its_hills_is_taken_as_one_of_ten_of_them():
    lengths = [relief_lengths((0.0, np.inf), HEIGHT, HALF_WIDTH, along) for along in (ALONG, 40 * ALONG)]
    assert lengths[0] == lengths[1]


def test_scatter_that_no_length_explains_tells_none():
    any_length = relief_lengths((0.0, np.inf), HEIGHT, HALF_WIDTH, ALONG)
    # more than all of its variance, and less than nothing
    assert relief_lengths((1.1 * HEIGHT**2, 9.0 * HEIGHT**2), HEIGHT, HALF_WIDTH, ALONG) == any_length
    assert relief_lengths((0.0, 0.0), HEIGHT, HALF_WIDTH, ALONG) == any_length
    # a third of it is that of short hills
    short = relief_lengths((HEIGHT**2 / 3, HEIGHT**2 / 3), HEIGHT, HALF_WIDTH, ALONG)
    assert short[0] == short[1] < 0.5 * HALF_WIDTH
    assert_allclose(detrended_share(short[0], HALF_WIDTH), 1 / 3, rtol=0.1)


class TestShare:
    def test_what_tells_nothing_leaves_most_of_what_was_given(self):
        # four fifths of the variance given, a tenth of its 16th and a tenth of its 256th
        expected = np.sqrt(0.8 + 0.1 / 16.0 + 0.1 / 256.0)
        assert relief_share(lambda sigma, length: 0.0, HEIGHT, HALF_WIDTH) == pytest.approx(expected)

    @pytest.mark.parametrize("true", [1.0, 0.25, 0.0])
    def test_many_heights_tell_their_size(self, true):
        """Heights of a size drawn beside errors of their own: a thousand say it to 5 %."""
        error = 0.05
        drawn = np.hypot(true, error) * np.random.default_rng(2).standard_normal(1000)

        def likelihood(sigma: float, length: float) -> float:
            variance = (sigma / HEIGHT) ** 2 + error**2
            # lengths far from the true one explain nothing
            far = 50.0 if length < 0.3 * LENGTH else 0.0
            return float(-0.5 * (len(drawn) * np.log(variance) + drawn @ drawn / variance)) - far

        found = relief_share(likelihood, HEIGHT, HALF_WIDTH)
        # to 2 % of itself, and the least that is asked is a 16th
        assert found == pytest.approx(max(true, 1.0 / 16.0), rel=0.05)

    def test_shares_far_less_likely_than_the_best_are_the_last(self):
        asked = []

        def likelihood(sigma: float, length: float) -> float:
            asked.append(sigma / HEIGHT)
            return 40.0 * np.log(sigma)

        assert relief_share(likelihood, HEIGHT, HALF_WIDTH) == pytest.approx(1.0, abs=1e-6)
        assert asked == [1.0] * 3 + [0.25] * 3


class TestMatters:
    def star(self, by_height: float, component: int = 0):
        star = plain_star(10, 5, 2, 0.05)
        table = np.zeros((*star.t.shape, 2), np.float32)
        table[..., component] = by_height
        return replace(star, by_height=table)

    def test_relief_matters_where_its_parallax_is_a_part_of_the_errors(self):
        # 0.05 px of error: 10 m must move a match by about a tenth of it, 0.005 px
        assert relief_matters([self.star(-1e-2)], 10.0)
        assert not relief_matters([self.star(-1e-5)], 10.0)
        assert relief_matters([self.star(-1e-5), self.star(1e-2)], 10.0)

    def test_parallax_behind_a_scan_mirror_lies_along_columns(self):
        across = self.star(-1e-2, component=1)
        assert relief_matters([across], 10.0)
        # each component against its own error: 0.1 px of parallax against a tenth of 2 px
        blurred = across.covariance_px * np.array([[1.0, 0.0], [0.0, 1600.0]])
        assert not relief_matters([replace(across, covariance_px=blurred)], 10.0)

    def test_a_known_surface_leaves_nothing_to_estimate(self):
        assert not relief_matters([self.star(1.0)], 0.0)

    def test_a_star_without_matches_says_nothing(self):
        star = self.star(1.0)
        assert not relief_matters([star.with_weight(np.zeros(star.t.shape))], 10.0)


class TestDelay:
    def test_a_hub_that_looks_back_sees_the_ground_later(self):
        cameras = strip_cameras((100.0, 0.0, -50.0))
        for hub, lines in ((0, 0), (1, 100), (2, 150)):
            assert_allclose(hub_delay(cameras, Plane(), hub, 0), lines * PERIOD, atol=1e-9)
        assert_allclose(hub_delay(cameras, Plane(), 0, 2), -150 * PERIOD, atol=1e-9)

    def test_images_without_common_ground_have_no_delay(self):
        cameras = strip_cameras((2000.0, 0.0))
        assert 2000 * IFOV * ALTITUDE > 600 * SPEED * PERIOD
        assert hub_delay(cameras, Plane(), 1, 0) == 0.0
