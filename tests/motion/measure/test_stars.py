"""Stars of matched windows, on strips whose images are Fourier-shifted textures."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from matching.fourier_textures import shifted_pair
from motion.strips import IFOV, PERIOD, given_bands, plain_star, sampled_motion, strip_cameras
from sightline.geometry.conjugate import predict_match
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ArrayImage
from sightline.matching.matches import KEPT, LOW_SCORE, MASKED, OUTLIER, OUTSIDE
from sightline.matching.select import Selection
from sightline.matching.whitening import pair_whitening
from sightline.motion.band import Band
from sightline.motion.measure import stars
from sightline.motion.measure.aliasing import phase_between
from sightline.motion.measure.common_view import partners_of
from sightline.motion.measure.laid_strips import (
    _rough_columns,
    groups_of_pixels,
    laid_on,
    line_places,
)
from sightline.motion.measure.plan import END, MatchingPlan, hub_windows
from sightline.motion.measure.predict import turned
from sightline.motion.measure.stars import StarRecord, _brightness_elsewhere, found_wrong, match_star
from sightline.motion.measure.windows import brightest_parts, predict_windows, window_grid
from sightline.motion.statics import band_statics
from sightline.simulate.scenarios import line_of_sight_case

SHAPE, AHEAD = (240, 320), (40.0, 0.0)
#: What the images are shifted by beyond what the cameras know, (line, column) px.
UNKNOWN = np.array([0.31, -0.22])
PLAN = MatchingPlan((10, 100), 10)
SEARCH = MatchingPlan((10, 100), 10, (8, 8))


@pytest.fixture(scope="module")
def images():
    shift = (AHEAD[0] + UNKNOWN[0], UNKNOWN[1])
    return [ArrayImage(image) for image in shifted_pair(SHAPE, shift, snr=150.0, seed=1)]


@pytest.fixture(scope="module")
def cameras():
    return strip_cameras(AHEAD, *SHAPE)


@pytest.fixture(scope="module")
def record(images, cameras):
    statics = band_statics(given_bands(["first", "second"], [0.0, 1.0], [0.0, 0.0]))
    grid = window_grid(SHAPE, PLAN.window, PLAN.step)
    return match_star(images, cameras, Plane(), 0, (1,), grid, statics, PLAN)


def test_windows_elsewhere_are_as_large_as_those_of_the_star(images, record):
    end = window_grid(SHAPE, (4, 100), 4)
    end = replace(end, lines=end.lines[:20])
    want = brightest_parts(images[0], window_grid(SHAPE, (4, 100), 4))
    # a pass before that searched with taller windows
    other = replace(record, star=replace(record.star, brightness_elsewhere=np.full(9, 7.0)))
    assert_allclose(_brightness_elsewhere(other, images[0], end, 4), want)
    again = replace(other, star=replace(other.star, window=(4, 100)))
    assert _brightness_elsewhere(again, images[0], end, 4) is again.star.brightness_elsewhere
    assert _brightness_elsewhere(None, images[0], window_grid(SHAPE, (4, 100), 4), 4) is None


class TestHubs:
    def test_the_first_image_serves_all_it_sees_and_later_ones_only_ground_that_is_new(self):
        cameras = strip_cameras((100.0, 0.0, -50.0))
        hubs = hub_windows(cameras, Plane(), [(600, 320)] * 3, (0, 1, 2), SEARCH)
        assert [(hub, partners) for hub, partners, _ in hubs] == [(0, (1, 2)), (1, (2,))]
        (_, _, first), (_, _, second) = hubs
        assert len(first.lines) == 60
        # image 1 sees line p of image 0 at p + 100: its lines before 100 (less half a window, 5) are new
        assert_allclose(second.lines, np.arange(4.5, 105.0, 10.0))

    def test_a_hub_that_sees_nothing_new_is_left_out(self):
        first, second, third = strip_cameras((0.0, 0.0, -50.0))
        # the second image stops 100 lines after it began, 100 lines into the first
        late = replace(second, first_line_time=100 * PERIOD, lines=100)
        hubs = hub_windows(
            [first, late, third], Plane(), [(600, 320), (100, 320), (600, 320)], (0, 1, 2), SEARCH
        )
        assert [hub for hub, _, _ in hubs] == [0]

    def test_the_ends_of_later_images_are_cut_from_them_and_found_in_the_first(self):
        cameras = strip_cameras((100.0, 0.0, -50.0))
        dense = MatchingPlan((4, 100), 4)
        ends = {
            (hub, partners): grid.lines
            for hub, partners, grid in hub_windows(cameras, Plane(), [(600, 320)] * 3, (0, 1, 2), dense)
            if partners[0] < hub
        }
        assert sorted(ends) == [
            (1, (0,)),
            (2, (0,)),
        ]  # in the first only: the others' pairs are among its own
        # windows of another hub are found from line 8 to 591: rows of four lines fill what is left
        for lines in ends.values():
            assert_allclose(lines, [1.5, 5.5, 593.5, 597.5])


class TestMatchStar:
    def test_the_residual_is_what_the_cameras_do_not_know(self, record):
        star = record.star
        kept = star.present[:, 0]
        assert kept.sum() >= 50
        error = star.residual_px[kept, 0] - UNKNOWN
        covariance = star.covariance_px[kept, 0]
        squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
        # 2 per match on average, give or take sqrt(4 / n); the matcher's sigma is true to 15 %, its variance
        # to 30 %
        n = kept.sum()
        assert 2 * 0.7 - 4 * np.sqrt(4 / n) < squares.mean() < 2 * 1.3 + 4 * np.sqrt(4 / n)
        # kernel and matcher may be off by a hundredth of a pixel together
        sigma = np.sqrt(np.einsum("nii->ni", covariance).mean(axis=0) / n)
        assert np.all(np.abs(error.mean(axis=0)) < 0.01 + 4 * sigma)

    def test_windows_beyond_the_partner_are_outside_and_have_no_residual(self, record):
        line = record.star.pixels[:, 0]
        beyond = line + AHEAD[0] + 4.5 > SHAPE[0] - 1
        assert beyond.any() and (record.status[beyond, 0] == OUTSIDE).all()
        assert np.isnan(record.star.residual_px[beyond]).all()
        assert (record.status[~beyond, 0] == KEPT).mean() > 0.9

    def test_times_places_and_length_are_those_of_the_windows(self, record):
        star = record.star
        line, column = star.pixels.T
        assert star.shape == (24, 3)
        assert_allclose(star.t_hub, line * PERIOD, atol=1e-12)
        seen = np.isfinite(star.t[:, 0])
        assert_allclose(star.t[seen, 0], (line[seen] + AHEAD[0]) * PERIOD, atol=1e-9)
        assert_allclose(star.field, (column - 159.5) / 159.5)
        # ten lines have the variance of a boxcar of sqrt(10^2 - 1) lines
        assert_allclose(star.duration, np.sqrt(99) * PERIOD, rtol=1e-9)

    def test_sensitivities_come_apart_into_hub_partner_static_and_height(self, record):
        star = record.star
        kept = star.present[:, 0]
        # opposite turns of hub and partner cancel but for their different looks ahead (40 px of yaw)
        both = star.by_hub[kept, 0].astype(float) + star.by_partner[kept, 0]
        assert_allclose(both[:, 0, 1], 0.0, atol=0.5)
        assert_allclose(both[:, 1, 2], -40.0, atol=0.5)
        assert_allclose(star.by_static[kept, 0], np.tile(-np.eye(2), (kept.sum(), 1, 1)), atol=1e-5)
        assert_allclose(star.by_height[kept, 0, 0], -40.0 / 680e3, rtol=1e-3)

    def test_a_search_finds_what_lies_pixels_away(self, images):
        # the first camera claims to look 5 px further ahead than it does
        wrong = strip_cameras((AHEAD[0] + 5.0, 0.0), *SHAPE)
        grid = window_grid(SHAPE, PLAN.window, 40)
        plan = MatchingPlan(PLAN.window, 40, (8, 8))
        star = match_star(images, wrong, Plane(), 0, (1,), grid, [], plan).star
        found = star.residual_px[star.present[:, 0], 0]
        assert len(found) >= 9
        assert_allclose(np.median(found, axis=0), UNKNOWN - [5.0, 0.0], atol=0.03)

    def test_windows_at_the_very_end_of_an_image_match_where_those_of_another_do_not(self, images, cameras):
        # line l of image 0 is line l + 40 of image 1: windows on the last lines of each
        star = match_star(
            images, cameras, Plane(), 0, (1,), window_grid(SHAPE, (4, 100), 4), (), MatchingPlan((4, 100), 4)
        ).star
        assert star.t[star.present[:, 0], 0].max() <= (SHAPE[0] - 1 - END) * PERIOD
        _, (_, _, grid) = hub_windows(cameras, Plane(), [SHAPE] * 2, (0, 1), MatchingPlan((4, 100), 4))
        end = match_star(images, cameras, Plane(), 1, (0,), grid, (), MatchingPlan((4, 100), 4)).star
        assert end.t_hub[end.present[:, 0]].max() == pytest.approx((SHAPE[0] - 2.5) * PERIOD)
        error = end.residual_px[end.present[:, 0], 0] + UNKNOWN
        covariance = end.covariance_px[end.present[:, 0], 0]
        squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
        # six windows: 2 each give or take sqrt(4 / 6), the variance true to 30 %
        assert squares.mean() < 2 * 1.3 + 4 * np.sqrt(4 / 6)

    def test_masked_ground_of_the_partner_is_masked_not_outside(self, images, cameras):
        mask = np.zeros(SHAPE, bool)
        mask[100:140] = True
        partner = ArrayImage(images[1].read((0, SHAPE[0]), (0, SHAPE[1])), mask)
        grid = window_grid(SHAPE, PLAN.window, PLAN.step)
        record = match_star([images[0], partner], cameras, Plane(), 0, (1,), grid, [], PLAN)
        inside = np.abs(record.star.pixels[:, 0] + AHEAD[0] - 119.5) < 14
        assert inside.any() and (record.status[inside, 0] == MASKED).all()

    def test_windows_that_were_not_to_be_matched_are_known(self, images, cameras, record):
        grid = window_grid(SHAPE, PLAN.window, PLAN.step)
        some = replace(PLAN, selection=Selection("spread", points=9))
        star = match_star(images, cameras, Plane(), 0, (1,), grid, [], some).star
        assert record.star.chosen is None and star.chosen is not None
        assert star.chosen.sum() == 9 and 0 < star.present.sum() <= 9
        assert not star.present[~star.chosen].any()
        assert star.rows(slice(2, 5)).chosen.tolist() == star.chosen.reshape(star.shape)[2:5].ravel().tolist()

    def test_a_residual_is_in_pixels_of_the_partner(self):
        # the partner has lines of half the period: hub line p is its line 2 p + 80, and 0.4 of its pixels
        # more
        rng = np.random.default_rng(4)
        waves = [(rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0, 6.3)) for _ in range(60)]

        def scene(line, column):
            return sum(np.cos(2 * np.pi * (f * line + g * column) + p) for f, g, p in waves)

        shape = (2 * SHAPE[0], SHAPE[1])
        line, column = np.mgrid[0.0 : SHAPE[0], 0.0 : SHAPE[1]]
        hub = scene(line, column) + 0.05 * rng.standard_normal(SHAPE)
        line, column = np.mgrid[0.0 : shape[0], 0.0 : shape[1]]
        partner = scene((line - 80.4) / 2, column - 0.25) + 0.05 * rng.standard_normal(shape)
        first, second = strip_cameras((40.0, 0.0), *SHAPE)
        second = replace(second, detector=replace(second.detector, line_period=PERIOD / 2), lines=shape[0])
        grid = window_grid(SHAPE, PLAN.window, 20)
        pair = [ArrayImage(hub), ArrayImage(partner)]
        star = match_star(pair, [first, second], Plane(), 0, (1,), grid, [], PLAN).star
        found = star.residual_px[star.present[:, 0], 0]
        assert len(found) >= 20
        assert_allclose(np.median(found, axis=0), [0.4, 0.25], atol=0.03)


class TestFoundWrong:
    GRID = window_grid((40, 400), (10, 100), 10)

    def record(self, status, weight) -> StarRecord:
        star = plain_star(4, 4, 1)
        star = replace(star, pixels=self.GRID.centres, weight=np.array(weight, float).reshape(16, 1))
        return StarRecord(star, np.array(status, np.uint8).reshape(16, 1), np.ones((16, 1)))

    def test_windows_thrown_out_before_are_wrong_and_those_never_matched_are_not(self):
        status, weight = np.full((4, 4), KEPT), np.ones((4, 4))
        weight[0, 1] = weight[1, 1] = weight[2, 1] = 0.0
        status[1, 1], status[2, 1] = OUTLIER, LOW_SCORE
        wrong = found_wrong(self.record(status, weight), 0, self.GRID, 1).reshape(4, 4)
        assert np.argwhere(wrong).tolist() == [[0, 1], [1, 1]]

    def test_a_row_that_lost_nearly_all_is_tried_again(self):
        weight = np.ones((4, 4))
        weight[2] = 0.0
        assert not found_wrong(self.record(np.full((4, 4), KEPT), weight), 0, self.GRID, 1).any()

    def test_other_windows_or_another_hub_are_not_compared(self):
        weight = np.ones((4, 4))
        weight[0, 0] = 0.0
        before = self.record(np.full((4, 4), KEPT), weight)
        assert found_wrong(before, 0, self.GRID, 1).any()
        other = window_grid((44, 400), (10, 100), 11)
        for answer in (
            found_wrong(None, 0, self.GRID, 1),
            found_wrong(before, 1, self.GRID, 1),
            found_wrong(before, 0, other, 1),
            found_wrong(before, 0, self.GRID, 2),
        ):
            assert answer.dtype == bool and not answer.any()

    def test_they_are_not_matched_again(self, images, cameras, record):
        weight = record.star.weight.copy()
        weight[10] = 0.0
        before = StarRecord(record.star.with_weight(weight), record.status, record.score)
        grid = window_grid(SHAPE, PLAN.window, PLAN.step)
        again = match_star(images, cameras, Plane(), 0, (1,), grid, [], PLAN, before)
        assert record.star.present[10, 0] and not again.star.present[10, 0]
        assert again.star.present[[9, 11], 0].all()


def test_the_partner_laid_on_the_hub_shows_the_same_picture(images, cameras):
    laid = laid_on(images, cameras, Plane(), 0, 1)
    got = laid.read((20, 180), (10, 310))
    # cameras know 40 lines of the shift by 40.31: what is left is a third of a pixel
    same = images[0].read((20, 180), (10, 310))
    raw = images[1].read((20, 180), (10, 310))
    assert np.corrcoef(got.ravel(), same.ravel())[0, 1] > 0.95
    assert np.corrcoef(raw.ravel(), same.ravel())[0, 1] < 0.8


def test_a_bent_line_is_laid_along_its_bends(cameras):
    u = np.linspace(-1.0, 1.0, SHAPE[1])
    bend = 0.5 * np.polynomial.Legendre.basis(3)(u)
    bent = cameras[1].with_detector(cameras[1].detector.adjusted(bend, bend[::-1]))
    # a slope, which the kernel keeps: its values are the columns that are shown
    slope = ArrayImage(np.broadcast_to(np.arange(SHAPE[1], dtype=np.float32), SHAPE).copy())
    for two in ([cameras[0], bent], [bent, cameras[0]]):
        columns = np.arange(20.0, SHAPE[1] - 20.0)
        pixels = np.stack([np.full(len(columns), 100.0), columns], axis=1)
        exact = predict_match(*two, Plane(), pixels)[:, 1]
        got = laid_on([slope, slope], two, Plane(), 0, 1).read((100, 101), (20, SHAPE[1] - 20))[0]
        # chords over 4 columns of bends of 0.5 * 15 / 160^2 px per column^2 at most depart by 0.0006 px,
        # and the kernel keeps a slope within 0.0012
        assert_allclose(got, exact, atol=0.002)


def test_lines_stand_where_the_pitch_and_the_yaw_of_the_camera_put_them(cameras):
    camera = cameras[0]
    assert line_places(camera, Plane()) is None  # an even scan
    lines = np.arange(-8.0, SHAPE[0] + 8.0)
    pixel = np.arccos(camera.detector.directions[0] @ camera.detector.directions[1])
    nod = np.sin(2.0 * np.pi * 0.21 * lines)
    angles = np.stack([0.0 * nod, 0.1 * pixel * nod, 0.2 * nod / (SHAPE[1] / 2)], axis=1)
    shaken = camera.with_trajectory(camera.trajectory.with_motion(Motion(camera.times(lines), angles)))
    places = line_places(shaken, Plane())
    # +- pitch and yaw at either side; the mean of 17 lines keeps some of it, most at the ends
    want = np.diff(np.outer(nod[8:-8], [0.1 - 0.2, 0.1 + 0.2]), 2, axis=0)[8:-8]
    assert_allclose(np.diff(places, 2, axis=0)[8:-8], want, atol=0.03 * np.abs(want).max())


def test_columns_are_rough_where_the_line_of_the_other_camera_steps_between_them(cameras):
    stages = np.ones(SHAPE[1], dtype=int)
    stages[11:] = 4
    other = replace(cameras[1], stages=stages[None, :])
    assert other.rough_columns.tolist() == [10.0, 11.0]

    def rough(shift, sign=1.0):
        def mapping(lines, columns):
            seen = np.where(columns < 300.0, sign * columns + shift, np.nan)
            return np.stack(np.broadcast_arrays(lines[:, None], seen), axis=-1)

        return _rough_columns(cameras[0], other, mapping, SHAPE).tolist()

    assert rough(0.25) == [9.5, 10.5]
    assert rough(0.0) == [9.5, 10.5, 11.5]
    assert rough(20.25, -1.0) == [9.5, 10.5]
    assert rough(-280.25) == [290.5, 291.5] and rough(-289.5) == []


def test_roughness_everywhere_takes_no_table_of_columns_by_columns(cameras):
    columns = 4000
    camera = replace(
        cameras[0],
        detector=LineDetector.from_ifov("wide", columns, IFOV, PERIOD),
        stages=1 + np.arange(columns)[None, :] % 2,
    )

    def mapping(lines, columns):
        return np.stack(np.broadcast_arrays(lines[:, None], columns + 0.25), axis=-1)

    assert len(camera.rough_columns) == columns
    tracemalloc.start()
    got = _rough_columns(cameras[0], camera, mapping, (SHAPE[0], columns))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert got.tolist() == (np.arange(columns - 1) + 0.5).tolist()
    assert peak < columns**2 / 4


def test_a_step_of_a_finer_partner_moves_a_window_by_the_share_of_its_own_columns(cameras):
    fine = replace(cameras[0], detector=LineDetector.from_ifov("fine", 4 * SHAPE[1], IFOV / 4, PERIOD))
    bands = [
        Band(name, None, camera, 0.0, 0.0, 0.0, shape=shape, pieces=pieces)
        for name, camera, shape, pieces in (
            ("coarse", cameras[0], "line", ()),
            ("fine", fine, "pieces", (500,)),
        )
    ]
    noise = np.random.default_rng(1).normal(100.0, 20.0, (SHAPE[0], 4 * SHAPE[1]))
    grid = window_grid(SHAPE, (40, 40), 80)
    found = match_star(
        [ArrayImage(noise[:, ::4]), ArrayImage(noise)], [cameras[0], fine], Plane(), 0, (1,), grid,
        band_statics(bands), MatchingPlan((40, 40), 80),
    )  # fmt: skip
    # the window of columns 120 to 159 fills 480 to 639 of the partner: 140 beyond, less the mean of all
    across = found.star.by_static[grid.centres[:, 1] == 139.5, 0, 1, 1]
    assert_allclose(across, -(140 / 160 - 780 / 1280), atol=1e-4)


def test_without_texture_there_is_no_whitening(images, cameras):
    flat = ArrayImage(np.full(SHAPE, 7.0))
    grid = window_grid(SHAPE, PLAN.window, PLAN.step).centres
    assert pair_whitening(flat, laid_on([flat, flat], cameras, Plane(), 0, 1), grid) is None
    laid = laid_on(images, cameras, Plane(), 0, 1)
    assert pair_whitening(images[0], laid, grid[grid[:, 0] < 180]) is not None
    assert pair_whitening(images[0], laid, grid[:0]) is None


@pytest.fixture(scope="module")
def scenario():
    return line_of_sight_case("pan-xs", 5, lines=480, columns=256, motion="none", snr=1000.0)


class TestUnlikePixels:
    """A fine band, and coarse ones four times as wide and long."""

    def test_the_coarsest_images_are_the_hubs_and_the_finest_is_asked_once(self, scenario):
        cameras = scenario.nominal_cameras
        assert groups_of_pixels(cameras) == (1, 0, 0, 0)
        hubs = hub_windows(cameras, Plane(), scenario.shapes, (0, 1, 2, 3), MatchingPlan((4, 100), 4))
        assert hubs[0][:2] == (1, (2, 3, 0))
        # of like pixels the order stays as it is
        assert groups_of_pixels(strip_cameras((30.0, 0.0))) == (0, 0)

    def test_finer_images_that_see_the_same_are_left_to_their_own_grid(self):
        views = {(a, b): (0, 99) for a in range(4) for b in range(4) if a != b}
        (one,) = partners_of(views, (0, 1, 2, 3), 0, 100, grains=(0, 1, 1, 2))
        assert one.images == (1,)
        (other,) = partners_of(views, (0, 1, 2, 3), 1, 100, grains=(0, 1, 1, 2))
        assert other.images == (2, 3) and other.earlier == ()
        # a finer one that sees other columns is asked too
        apart = {**views, (0, 2): (60, 99), (0, 1): (0, 40)}
        found = partners_of(apart, (0, 1, 2), 0, 100, grains=(0, 1, 1))
        assert [group.images for group in found] == [(1,), (2,)]

    def test_windows_of_a_coarse_hub_are_as_many_seconds_and_metres(self):
        plan = MatchingPlan((12, 120), 12).coarser((4.0, 4.0))
        assert (plan.window, plan.step) == ((3, 30), 3)
        least = MatchingPlan((4, 100), 4).coarser((6.0, 6.0))
        assert (least.window, least.step) == ((2, 24), 1)
        searched = MatchingPlan((10, 100), 20, (8, 8)).coarser((4.0, 4.0))
        assert searched.search_px == (5, 5) and np.prod(searched.window) >= 200
        # a lag of 6 fine lines is 3 of these
        assert MatchingPlan((12, 120), 12, lag=6.0).coarser((2.0, 2.0)).window[0] == 3

    @pytest.mark.parametrize("axis", [0, 1])
    def test_a_shift_of_the_finer_image_is_found_whole(self, scenario, axis):
        # the partner alone is turned by 0.1 of the hub's pixels: its share of the noise is the same both ways
        images = [ArrayImage(scenario.image(k)) for k in (1, 0)]
        hub, partner = scenario.cameras[1], scenario.cameras[0]
        plan = MatchingPlan((16, 100), 16)
        grid = plan.coarser((4.0, 4.0)).grid(images[0].shape)
        turn, component = 0.4 * 5e-6 * np.eye(3)[axis], 1 - axis
        found = []
        for sign in (1.0, -1.0):
            cameras = [hub, turned(partner, sign * turn)]
            star = match_star(images, cameras, Plane(), 0, (1,), grid, (), plan).star
            found.append(star.residual_px[:, 0, component])
        moved = 0.5 * (found[0] - found[1])
        kept = np.isfinite(moved)
        assert kept.mean() > 0.3  # of 480 lines 300, and what kernels read, lie beyond the partner
        # without the response 0.8 to 0.85 of it; its own step (0.05 px) and that of this test differ
        share = -moved[kept] / (star.by_partner[kept, 0, component, axis] * turn[axis])
        assert np.median(share) == pytest.approx(1.0, abs=0.07)


class TestPhaseBias:
    """Undersampled columns, of which roll moves the fraction of a pixel between the images."""

    SHAPE, AHEAD, PLAN = (600, 320), (40.25, 0.0), MatchingPlan((4, 60), 4)

    @pytest.fixture
    def strip(self):
        """Cameras that know the motion, and images of ground whose rows they moved; lines hold no alias."""
        (rows, columns), over = self.SHAPE, 6
        rolled = 0.35 * np.sin(2.0 * np.pi * np.arange(rows) * PERIOD / 0.08)  # px
        cameras = strip_cameras(
            self.AHEAD,
            *self.SHAPE,
            sampled_motion(roll=lambda t: IFOV * 0.35 * np.sin(2.0 * np.pi * t / 0.08)),
        )
        rng = np.random.default_rng(0)
        fy, fx = np.fft.fftfreq(rows + 160)[:, None], np.fft.rfftfreq(columns * over, 1.0 / over)[None]
        f = np.hypot(fy, fx)
        ground = np.fft.fft2(rng.standard_normal((rows + 160, columns * over)))[:, : fx.size]
        ground *= np.where(f > 0, np.maximum(f, 1e-3) ** -1.0, 0.0) * (np.abs(fy) <= 0.42)
        images = []
        for ahead in self.AHEAD:
            along = np.fft.ifft(ground * np.exp(2j * np.pi * fy * ahead), axis=0)[40 : 40 + rows]
            seen = along * np.exp(2j * np.pi * fx * rolled[:, None]) * np.sinc(fx)
            image = np.fft.irfft(seen, columns * over, axis=1)[:, ::over]
            images.append(ArrayImage(image / image.std() + 0.05 * rng.standard_normal(image.shape)))
        return cameras, images

    def slope(self, strip, hub, filters):
        """Of residuals across with the sine of the phase, its sigma, and mean residual along; the star."""
        cameras, images = strip
        grid = window_grid(self.SHAPE, self.PLAN.window, self.PLAN.step)
        record = match_star(images, cameras, Plane(), hub, (1 - hub,), grid, (), self.PLAN, filters=filters)
        star = record.star
        (predicted,) = predict_windows(cameras, hub, star.images, Plane(), grid)
        good = star.present[:, 0]
        sine = np.sin(2.0 * np.pi * phase_between(star.pixels, predicted.b, predicted.affine)[good, 1])
        along, across = star.residual_px[good, 0].T
        slope = np.polyfit(sine, across, 1)[0]
        return slope, across.std() / sine.std() / np.sqrt(good.sum()), along.mean(), record

    def test_it_is_learned_taken_off_and_shared_both_ways(self, strip, monkeypatch):
        filters = {}
        after, sigma, along, record = self.slope(strip, 0, filters)
        back = self.slope(strip, 1, dict(filters))
        assert back[3].filters[0].phase_bias == record.filters[0].phase_bias
        monkeypatch.setattr(stars, "_with_phase_bias", lambda strips, whitenings, *_: whitenings)
        before, _, plain_along, _ = self.slope(strip, 0, {})
        plain_back = self.slope(strip, 1, {})
        # .008 px and more, towards whole pixels; two thirds of it and more go
        assert before < -0.006 and plain_back[0] < -0.006
        for left, whole in ((after, before), (back[0], plain_back[0])):
            assert 0.34 * whole - 3.0 * sigma < left < 3.0 * sigma
        # lines lie a quarter of a pixel apart all over: nothing tells their bias, and nothing is put there
        assert record.filters[0].phase_bias[0] == 0.0
        assert along == pytest.approx(plain_along, abs=1e-9)

    def test_a_rough_pass_looks_neither_for_it_nor_for_uneven_lines(self, strip, monkeypatch):
        asked = []
        monkeypatch.setattr(stars, "uneven", lambda *_: asked.append(True) or False)
        self.slope(strip, 0, {})
        assert asked
        asked.clear()
        monkeypatch.setattr(type(self), "PLAN", replace(self.PLAN, rough=True))
        record = self.slope(strip, 0, {})[3]
        assert record.filters[0].phase_bias is None and not asked
