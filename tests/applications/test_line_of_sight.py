"""One strip from images to line of sight: a small rendered one, and input that must be refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from consistency import assert_consistent, assert_possible
from motion.strips import plain_star, strip_cameras
from sightline import execution
from sightline.applications.line_of_sight import (
    _first_pass,
    _hidden_names,
    _match,
    _searched,
    _share_kept,
    recover_line_of_sight,
)
from sightline.errors import EstimationError, InputError
from sightline.evaluation.score import score_result
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Dem, Plane
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ArrayImage
from sightline.io.formats.tables import read_motion
from sightline.matching.matches import KEPT, LOW_SCORE, NO_CONVERGENCE, OUTSIDE
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.measure.plan import MatchingPlan
from sightline.motion.measure.stars import StarRecord, match_star
from sightline.motion.measure.windows import window_grid
from sightline.motion.strip.estimate import initial_attitude
from sightline.motion.strip.hyper import PriorModel
from sightline.motion.strip.joint import JointPrior, less_directions, solve_joint
from sightline.motion.strip.lost_bands import like_none
from sightline.motion.strip.normal_equations import GroundOrder, normal_equations
from sightline.motion.strip.strip import RecoverOptions, prepared
from sightline.motion.strip.viewing_axes import turned_directions
from sightline.motion.strip.warnings import _lost_windows
from sightline.simulate.scenarios import line_of_sight_case

SHAPE = (300, 220)


def bands(ahead_px=(30.0, 0.0), images=None) -> list[Band]:
    """Bands of unlike noise: nothing in them matches."""
    rng = np.random.default_rng(0)
    images = images or [1000.0 + 50.0 * rng.standard_normal(SHAPE) for _ in ahead_px]
    cameras = strip_cameras(ahead_px, *SHAPE)
    return [Band(f"band {k}", ArrayImage(i), c) for k, (i, c) in enumerate(zip(images, cameras, strict=True))]


class TestRefused:
    def test_one_band_cannot_show_motion(self):
        with pytest.raises(InputError) as problem:
            recover_line_of_sight(bands()[:1], Plane())
        assert str(problem.value) == (
            "one image cannot show motion: 1 [[band]] given (band 0); add a [[band]] that sees the same "
            "ground a lag apart, or control points ([acquisition] control_points), which `sightline tie` "
            "finds in an orthoimage"
        )

    def test_what_is_no_band_and_no_surface(self):
        for given, said in (([], "got none"), ([bands()[0].image] * 2, "got ArrayImage")):
            with pytest.raises(InputError, match=rf"two or more `sightline.Band`.* {said}"):
                recover_line_of_sight(given, Plane())
        with pytest.raises(InputError, match=r"`surface` must be a Plane, Ellipsoid or Dem, got 0\.0"):
            recover_line_of_sight(bands(), 0.0)

    @pytest.mark.parametrize("sigma", [-1.0, np.nan, np.inf, "300", None, [3.0], True])
    def test_what_is_no_sigma_of_heights(self, sigma):
        said = re.escape(f"`height_sigma` must be 0 or more (m), got {sigma!r}")
        with pytest.raises(InputError, match=said):
            recover_line_of_sight(bands(), Plane(), height_sigma=sigma)

    def test_an_image_of_another_size_than_its_camera_is_named(self):
        first, second = bands()
        wrong = Band("red", ArrayImage(np.zeros((100, 220))), second.camera)
        with pytest.raises(InputError) as problem:
            recover_line_of_sight([first, wrong], Plane())
        assert str(problem.value) == (
            "image and camera of band 'red' differ: image (100, 220), camera (300, 220) (lines, columns); "
            "give the image its own size in the instrument description"
        )

    @pytest.mark.parametrize(
        "given",
        [bands(images=[np.full(SHAPE, 7.0)] * 2), bands()],
        ids=["no texture", "nothing alike"],
    )
    def test_images_that_do_not_match_where_the_cameras_say_are_refused(self, given):
        with pytest.raises(EstimationError) as problem:
            recover_line_of_sight(given, Plane())
        said = str(problem.value)
        assert said.startswith("the images do not match where the cameras say: ")
        assert "windows kept within (24, 24) px of the prediction" in said
        assert said.endswith("that the bands overlap, or search farther: [matching] search_px")

    def test_a_band_like_no_other_through_which_the_others_are_compared_comes_last(self):
        # the first of the coarse bands: the others of its pixels, and the fine one, are compared with it
        scene = line_of_sight_case("pan-xs", 1, lines=400, columns=200)
        given = scene.as_given()
        lost = replace(given[1], image=ArrayImage(np.random.default_rng(0).normal(500.0, 50.0, (100, 50))))
        options = RecoverOptions(passes=1)
        found = recover_line_of_sight([given[0], lost, *given[2:]], Plane(), options=options)
        last = recover_line_of_sight([given[0], *given[2:], lost], Plane(), options=options)
        # the same windows of the same images, in another order of bands
        assert_allclose(found.motion.angles / found.scale, last.motion.angles / found.scale, atol=1e-3)
        assert any("B1 matches nothing" in one for one in found.warnings)

    def test_bands_beyond_the_first_search_are_searched_farther(self):
        # a drift of 4 px a second and a turn of 4 px beside constants of 2 px: far beyond a search of 1 px
        scene = line_of_sight_case("nominal", 5, lines=500, columns=160)
        strip = prepared(scene.as_given(), Plane(0.0), RecoverOptions())
        statics = np.zeros(len(strip.parameters))
        nodes = initial_attitude(strip, statics)
        plan = strip.plan(RecoverOptions(), (10, 48), 20, (1, 1))
        near = _match(strip, nodes, statics, plan)
        _, found, searched = _searched(strip, nodes, statics, plan, lambda *_: None)
        assert _share_kept(near) < 0.5 and searched == (3, 3)
        assert _share_kept(found) > 1.3 * _share_kept(near)
        plan = strip.plan(RecoverOptions(), (10, 48), 20, (16, 16))
        _, found, searched = _searched(strip, nodes, statics, plan, lambda *_: None)
        assert _share_kept(found) > 0.9 and searched == (16, 16)

    def test_one_band_beyond_the_first_search_is_searched_farther(self):
        # two of three bands match in most windows, the third lies 9 columns off, where 4 are searched
        scene = line_of_sight_case("nominal", 5, lines=500, columns=160)
        given = scene.as_given()[:3]
        off = ArrayImage(np.roll(scene.image(2), 9, axis=1))
        strip = prepared([*given[:2], replace(given[2], image=off)], Plane(0.0), RecoverOptions())
        statics = np.zeros(len(strip.parameters))
        nodes = initial_attitude(strip, statics)
        plan = strip.plan(RecoverOptions(), (10, 48), 20, (4, 4))
        near = _match(strip, nodes, statics, plan)
        assert like_none(near, 3).tolist() == [False, False, True]
        _, found, searched = _searched(strip, nodes, statics, plan, lambda *_: None)
        assert searched == (12, 12) and not like_none(found, 3).any()

    @pytest.mark.parametrize("again", [0, 3])
    def test_a_stretch_that_moved_beyond_the_first_search_is_found_from_its_ends(self, again, monkeypatch):
        monkeypatch.setattr("sightline.applications.line_of_sight.SOUGHT_AGAIN", again)
        lines, columns, lag = 1200, 220, 150
        scene = gaussian_filter(np.random.default_rng(5).standard_normal((lines + lag, columns + 60)), 0.8)
        # roll by 0.08 px a line between lines 400 and 800: over the lag of 150 lines the bands part by 12 px,
        # where 8 are searched
        line = np.arange(lines)
        roll = 0.08 * np.clip(line - 400.0, 0.0, 400.0)
        images = []
        for ahead in (lag, 0):
            rows, places = np.meshgrid(line + ahead, np.arange(columns), indexing="ij")
            images.append(1000.0 + 50.0 * map_coordinates(scene, [rows, places + 10.0 + roll[:, None]]))
        cameras = strip_cameras((float(lag), 0.0), lines, columns)
        given = [
            Band(f"band {k}", ArrayImage(image), camera)
            for k, (image, camera) in enumerate(zip(images, cameras, strict=True))
        ]
        options = RecoverOptions()
        _, state = _first_pass(prepared(given, Plane(), options), options, 0.0, execution.silent)
        # what lies in both images was kept where the search reached it: 1050 lines, less some 350
        assert _share_kept(state.records) > 0.95 if again else _share_kept(state.records) < 0.75

    def test_images_without_common_ground_are_refused(self):
        # 4000 px ahead of an image of 300 lines: no window lies on both images
        with pytest.raises(EstimationError, match="too little ground in common: 0 windows of 10 x 48 px"):
            recover_line_of_sight(bands((4000.0, 0.0)), Plane())

    @pytest.mark.parametrize("asked", [{"window": (10, 200)}, {"step": 50}, {"window": (4, 150), "step": 40}])
    def test_windows_of_the_later_passes_that_make_too_few_rows_are_refused_before_matching(self, asked):
        with pytest.raises(EstimationError, match=r"\[matching\] window, step\) make \d rows with two side"):
            recover_line_of_sight(
                bands(), Plane(), options=RecoverOptions(first_window=(10, 60), **asked), progress=pytest.fail
            )

    def test_the_refusal_counts_the_windows_by_what_became_of_them(self):
        with pytest.raises(EstimationError, match=r"0 of \d+ windows kept within .* \(\d+ no convergence, "):
            recover_line_of_sight(bands(images=[np.full(SHAPE, 7.0)] * 2), Plane())

    def test_a_dem_that_does_not_cover_the_strip_is_named(self):
        far = Dem(np.zeros((4, 4)), (1e6, 10.0, 0.0, 1e6, 0.0, -10.0), None)
        with pytest.raises(EstimationError, match=r"the strip does not meet the surface.*extent of the DEM"):
            recover_line_of_sight(bands(), far)


class TestWarned:
    def test_offsets_held_exact_are_named_where_the_passes_do_not_settle(self):
        given = line_of_sight_case("nominal", 3, lines=320, columns=160).as_given()[:3]
        held = [replace(band, offset_sigma_px=0.0, rotation_sigma=0.0) for band in given]
        # the strip's offsets are of about a pixel, dozens of sigmas of the motion
        result = recover_line_of_sight(held, Plane(0.0), options=RecoverOptions(passes=1))
        unsettled, exact = result.warnings[:2]
        assert unsettled.startswith("the passes did not settle")
        assert unsettled.endswith("or allow more with [matching] passes")
        assert exact == (
            "band offsets are given as exact (offset_sigma_px = 0); give a sigma if they are not"
        )

    def test_few_kept_windows_are_reported_with_their_share_and_the_main_reason(self):
        star = plain_star(5, 4, 1, sigma=0.1)
        # 16 of 20 windows lie on both images; 5 are kept, and one more was thrown out for what it said
        codes = [OUTSIDE] * 4 + [NO_CONVERGENCE] * 7 + [LOW_SCORE] * 3 + [KEPT] * 6
        status = np.array(codes, dtype=np.uint8)[:, None]
        weight = np.ones((20, 1))
        weight[-1] = 0.0
        residual = np.where((status == KEPT)[..., None], 0.0, np.nan)
        record = StarRecord(replace(star, weight=weight, residual_px=residual), status, np.ones((20, 1)))
        assert _lost_windows([record]).startswith(
            "only 31 % of the windows tried were kept; the others are mostly 'no convergence' (7 of 11)"
        )

    def test_a_strip_that_matched_says_nothing_of_lost_windows(self, recovery):
        assert _lost_windows(recovery.result.records) == ""


class TestRendered:
    def test_the_motion_is_given_at_the_lines_of_the_first_band(self, recovery):
        result, first = recovery.result, recovery.acquisition.bands[0]
        assert_allclose(result.motion.t, first.camera.times(np.arange(first.camera.lines)), atol=1e-12)
        assert result.hidden.shape == (first.camera.lines, 3, len(result.hidden_names))
        assert result.hidden_names[:3] == ("constant of roll", "constant of pitch", "constant of yaw")
        assert result.image_names == tuple(b.name for b in recovery.acquisition.bands)

    def test_the_passes_settled_before_they_were_used_up(self, recovery):
        assert recovery.result.changes[-1] < RecoverOptions().tolerance
        assert len(recovery.result.changes) <= RecoverOptions().passes

    def test_images_matched_anew_lie_where_the_recovered_cameras_say(self, recovery):
        result, acquisition = recovery.result, recovery.acquisition
        images = [b.image for b in acquisition.bands]
        nominal = [b.camera for b in acquisition.bands]
        grid = window_grid(images[0].shape, (10, 100), 20)
        plan = MatchingPlan((10, 100), 20, (8, 8))
        claimed = np.diag(result.records[0].star.correlation)[:2].mean()
        rms = []
        for cameras in (result.cameras, nominal):
            star = match_star(images, cameras, acquisition.surface, 0, (1,), grid, [], plan).star
            kept = star.present[:, 0]
            assert kept.sum() > 30
            sigma = np.sqrt(np.einsum("nii->n", star.covariance_px[kept, 0]).mean() / 2 * claimed)
            # the middle of the residuals' size against that of a Gaussian: mismatches of a first look stay
            # out
            rms.append(1.4826 * np.median(np.abs(star.residual_px[kept, 0])) / sigma)
        # larger windows than the recovery used, hence half new errors; the motion's own error is a part of
        # theirs
        assert rms[0] < 1.5
        assert rms[1] > 5 * rms[0]

    @pytest.mark.parametrize("axis", [0, 1], ids=["roll", "pitch"])
    def test_a_hidden_constant_leaves_every_pair_of_pixels_as_it_is(self, recovery, axis):
        result, surface = recovery.result, recovery.acquisition.surface
        line, column = np.meshgrid([100.0, 200.0, 300.0], [20.0, 160.0, 300.0], indexing="ij")
        pixels = np.stack([line.ravel(), column.ravel()], axis=1)
        turn = 5 * result.ifov

        def matches(direction):
            old = result.cameras[0].trajectory.motion
            at = np.clip(old.t, result.motion.t[0], result.motion.t[-1])
            change = np.stack([np.interp(at, result.motion.t, direction[:, k]) for k in range(3)], axis=1)
            motion = Motion(old.t, old.angles + turn * change)
            moved = [c.with_trajectory(c.trajectory.with_motion(motion)) for c in result.cameras[:2]]
            return predict_match(*moved, surface, pixels) - predict_match(
                *result.cameras[:2], surface, pixels
            )

        # 5 px of constant; what is left are products of 5 px (2.5e-5 rad) with the other angles and the
        # field, below 1e-2 rad each, in pixels: 5 * 1e-2
        assert np.abs(matches(result.hidden[:, :, axis])).max() < 0.05
        # a ramp of 5 px over the strip is no constant: the lag makes it visible
        ramp = np.zeros((len(result.motion.t), 3))
        ramp[:, axis] = np.linspace(0.0, 20.0, len(ramp))
        assert np.abs(matches(ramp)).max() > 0.5

    def test_lines_without_matches_are_reported(self, recovery):
        result = recovery.result
        unseen = int((~result.observed).sum())
        reported = [w for w in result.warnings if "seen by no match" in w]
        assert bool(reported) == (unseen > 0)
        assert all(w.startswith(f"{unseen} of {len(result.observed)} lines") for w in reported)

    def test_sigma_grows_at_the_ends_where_matches_lie_on_one_side_only(self, recovery):
        result = recovery.result
        # an end is extrapolated over half a window from half as many matches as the middle has around it
        assert np.all(result.sigma[[0, -1]] > 1.2 * np.median(result.sigma, axis=0))


class TestHiddenDrifts:
    """Which drifts free offsets and rotations hide: shifts of the bands that grow with their lags imitate one
    of pitch (along) or roll (across), rotations (with offsets for their middle) one of yaw."""

    @staticmethod
    def estimate(recovery, free, noise=1.0, still=()):
        """The strip's matches, solved with only those static parameters that `free` says.

        Errors are `noise` times as large as they were; the prior holds the axes `still`.
        """
        bands = recovery.acquisition.bands
        strip = prepared(bands, recovery.acquisition.surface, RecoverOptions())
        chosen = [k for k, p in enumerate(strip.parameters) if free(p.name, p.images[0])]
        stars = [r.star for r in recovery.result.records]
        stars = [replace(s, by_static=np.ascontiguousarray(s.by_static[..., chosen])) for s in stars]
        stars = [replace(s, covariance_px=noise**2 * s.covariance_px) for s in stars]
        data = normal_equations(
            stars, [s.residual_px for s in stars], strip.grid, orders=[GroundOrder()] * len(stars)
        )
        sigmas = np.array([strip.parameters[k].sigma for k in chosen])
        broad = strip.broad.processes(strip.grid)
        quiet = PriorModel(tuple(s.scaled(1e-3) for s in strip.broad.spectra)).processes(strip.grid)
        fitted = tuple(quiet[axis] if axis in still else broad[axis] for axis in range(3))
        return solve_joint(data, JointPrior(fitted, sigmas, ample=JointPrior(broad, sigmas)))

    @pytest.mark.parametrize(
        ("free", "hidden"),
        [
            (lambda name, image: True, (0, 1, 2)),
            (lambda name, image: image > 0, (0, 1, 2)),
            (lambda name, image: "offset" in name, (0, 1)),
            (lambda name, image: "along" in name, (1,)),
            (lambda name, image: "across" in name, (0,)),
            (lambda name, image: "rotation" in name, ()),
            # the others, of known places and unlike lags, see every drift
            (lambda name, image: image == 3, ()),
            (lambda name, image: False, ()),
        ],
        ids=["all", "all but one band", "offsets", "along", "across", "rotations", "one band", "nothing"],
    )
    def test_only_drifts_that_free_places_imitate_are_hidden(self, recovery, free, hidden):
        estimate = self.estimate(recovery, free)
        assert estimate.hidden_drifts == hidden
        directions = estimate.hidden_directions(hidden)
        assert directions.shape[2] == 3 + len(hidden)
        u = np.linspace(-1.0, 1.0, estimate.grid.count)
        for k, axis in enumerate(hidden):
            # a ramp where there are matches (ends, of some lines and the lag, are extrapolated), no wiggle:
            # of yaw, seen by little more than its turn of the rows, curves of a tenth may be left
            inside = np.abs(u) < 0.8
            assert np.corrcoef(directions[inside, axis, 3 + k], u[inside])[0, 1] > 0.98

    def test_drifts_of_which_the_prior_says_more_than_the_images_are_hidden(self, recovery):
        # offsets are known, so that images see every drift: by matches of some hundredths of a pixel well, by
        # such of hundreds of pixels less than a prior of tens
        for noise, hidden in ((1.0, ()), (1e4, (0, 1, 2))):
            estimate = self.estimate(recovery, lambda name, image: "rotation" in name, noise=noise)
            assert estimate.hidden_drifts == hidden

    def test_a_prior_that_holds_roll_still_does_not_bend_the_drift_of_yaw(self, recovery):
        estimate = self.estimate(recovery, lambda name, image: True, noise=3.0, still=(0,))
        t = estimate.grid.nodes - estimate.grid.nodes.mean()
        roll, _, yaw = estimate.hidden_directions((0, 1, 2))[:, :, 5].T
        inside = np.abs(t) < 0.8 * t[-1]
        bend, rate = np.polyfit(t[inside], roll[inside], 2)[0], np.polyfit(t[inside], yaw[inside], 1)[0]
        # roll = -(V / 2H) t^2 times the rate of yaw (theory 7, equation 22), V / H = .01 per s; the jitter of
        # this strip leaves a few per cent of the drift to be seen
        assert bend == pytest.approx(-0.005 * rate, rel=0.1)

    def test_names_and_columns_agree(self):
        plain, tilted = np.eye(3), Rotation.from_rotvec([0.5, 0.0, 0.0]).as_matrix()
        assert _hidden_names((1,), plain)[3:] == ("drift of pitch",)
        assert _hidden_names((0, 1, 2), tilted)[3:] == ("drift of roll", "drift of pitch", "drift of yaw")
        assert _hidden_names((1,), tilted)[3:] == ("drift of pitch about the line of sight's axes",)
        four = np.random.default_rng(0).standard_normal((5, 3, 4))
        turned = turned_directions(four, tilted)
        assert turned.shape == four.shape
        assert_allclose(turned[..., 3], four[..., 3] @ tilted.T)


class TestWide:
    """Strips with drafts of fewer windows than they have."""

    def test_the_result_is_bitwise_the_same_on_any_number_of_threads(self, monkeypatch):
        bands = line_of_sight_case("nominal", 5, lines=240, columns=320).as_given()[:3]
        results = []
        for threads in (1, 3):
            monkeypatch.setattr(execution, "available_processors", lambda threads=threads: threads)
            options = RecoverOptions(draft_blocks=2, passes=1)
            results.append(recover_line_of_sight(bands, Plane(0.0), options=options))
        one, three = results
        assert len(one.records) == len(three.records) > 0
        assert one.motion.angles.tobytes() == three.motion.angles.tobytes()
        assert one.motion.covariance.tobytes() == three.motion.covariance.tobytes()
        assert one.spectra == three.spectra

    def test_thinned_drafts_leave_no_trace_in_the_last_pass(self, recovery):
        bands, surface = recovery.acquisition.bands, recovery.acquisition.surface
        wide = recover_line_of_sight(bands, surface, options=RecoverOptions(draft_blocks=2))
        plain = recovery.result
        assert wide.records[0].star.shape == plain.records[0].star.shape
        moved = less_directions(wide.motion.angles - plain.motion.angles, plain.hidden, plain.scale)
        seen = plain.observed & wide.observed
        share = (moved[seen] ** 2).mean(axis=0) / (plain.sigma[seen] ** 2).mean(axis=0)
        # drafts may stop 0.6 sigma from settled, of which the last pass leaves a quarter; the plain recovery
        # is as far from its own limit at most, 0.2 sigma / 4
        assert np.sqrt(share).max() < 0.2


def test_sigma_is_true_over_strips(recovery):
    # On so short a strip sigma is known to 10 %, its square to 0.2, each strip's by itself.
    # validation/line_of_sight.py pools long strips, and asks more.
    truth = read_motion(recovery.scene / "truth.csv")
    scenario = line_of_sight_case("nominal", 5, lines=640, columns=240)
    result = recover_line_of_sight(scenario.as_given(), Plane(0.0), options=RecoverOptions(passes=1))
    scores = [
        score_result(recovery.result, truth.t, truth.angles),
        score_result(result, scenario.truth[:, 0], scenario.truth[:, 1:]),
    ]
    axes = [axis for score in scores for axis in score.axes.values()]
    degrees = sum(axis.effective_samples for axis in axes)
    assert_consistent([axis.nees for axis in axes], degrees=degrees, wider=0.2 / np.sqrt(len(scores)))


@pytest.mark.slow
def test_drift_and_jitter_are_told_apart_on_a_short_narrow_strip():
    # priors that looked back no farther than the lags took the jitter of roll for drift: NEES 5.3 and 2.5
    scene = line_of_sight_case("nominal", 15, lines=600, columns=200)
    result = recover_line_of_sight(scene.as_given(), Plane(0.0))
    for axis in score_result(result, scene.truth[:, 0], scene.truth[:, 1:]).axes.values():
        assert_possible(axis.effective_samples * axis.nees, axis.effective_samples)


@pytest.mark.slow
def test_a_mode_that_stages_hide_is_found_by_its_blur_in_a_quarter_of_a_second():
    # 16 stages of .5 ms leave .03 of 121 Hz: not found, it is an error of .08 px of which sigma knows nothing
    scene = line_of_sight_case("nominal", 45, lines=500, columns=300, stages=(16,))
    # the mode is sought in every pass: the first must find it, and later ones change errors by a twentieth
    result = recover_line_of_sight(scene.as_given(), Plane(0.0), options=RecoverOptions(passes=1))
    axes = score_result(result, scene.truth[:, 0], scene.truth[:, 1:]).axes.values()
    assert all(any(abs(tone.frequency - 121.0) < 1.0 for tone in one.tones) for one in result.spectra)
    assert all(axis.rms < 0.055 for axis in axes)
    # most of the error is that of cosine and sine of the mode: one strip says little more of sigma
    for axis in axes:
        assert_possible(2.0 * axis.nees, 2.0, chance=0.05)
    # three axes together
    assert 0.4 < np.mean([axis.nees for axis in axes]) < 2.5


def test_too_few_windows_of_ones_own_choice_are_said_to_be_that():
    scene = line_of_sight_case("nominal", 1, lines=240, columns=110)
    for chosen, advice in (
        (Selection("textured", strength=50.0), "lower `strength`, or leave `select` out"),
        (Selection("spread", points=6), "raise `points`, or leave `select` out"),
    ):
        with pytest.raises(EstimationError, match=f"select = '{chosen.way}' leaves") as error:
            recover_line_of_sight(scene.as_given(), Plane(0.0), options=RecoverOptions(selection=chosen))
        assert advice in str(error.value) and "look angles" not in str(error.value)
