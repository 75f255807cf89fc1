"""Static parameters: what each moves, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import ALTITUDE, T0, T1, given_bands, strip_cameras
from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.motion.band import Band
from sightline.motion.measure.predict import sensitivities
from sightline.motion.statics import apply_statics, band_statics, frame_statics, recovered_cameras

PIXELS = np.array([[10.0, 0.0], [100.0, 159.5], [200.0, 300.0]])


def bands():
    return band_statics(given_bands(["PAN", "red"], [0.0, 1.5], [0.0, 3e-4]))


def shaped(cameras, *shapes):
    """Two bands known but for their shape, in pieces of 100 columns where they are."""
    pieces = {"pieces": (100, 200)}
    return [
        Band(name, None, camera, 0.0, 0.0, 0.0, shape=shape, pieces=pieces.get(shape, ()))
        for name, camera, shape in zip(("PAN", "red"), cameras, shapes, strict=True)
    ]


def matrix_cameras(distortion: tuple[float, ...] = ()) -> list[FrameCamera]:
    """Two frames of one matrix camera, a second apart: 6800 m of ground, 20 px of 340 m."""
    detector = AreaDetector("matrix", (101, 101), 2000.0, (50.0, 50.0), distortion)
    flight = Trajectory.level_flight(ALTITUDE, 6800.0, T0, T1)
    return [FrameCamera(detector, flight, FixedMount(), t) for t in (0.0, 1.0)]


class TestBands:
    def test_what_is_known_exactly_is_no_parameter(self):
        assert [(p.name, p.unit, p.sigma) for p in bands()] == [
            ("red offset along", "px", 1.5),
            ("red offset across", "px", 1.5),
            ("red rotation", "rad", 3e-4),
        ]

    def test_a_band_that_looks_further_ahead_sees_the_same_ground_earlier(self):
        cameras = strip_cameras((0.0, -83.0))
        moved = apply_statics(cameras, bands(), np.array([0.7, -0.4, 0.0]))
        before, after = (predict_match(*pair, Plane(), PIXELS) for pair in (cameras, moved))
        # one pixel further ahead: one line earlier; looking one pixel to larger columns: one column less
        assert_allclose(after - before, np.tile([-0.7, 0.4], (3, 1)), atol=1e-5)

    def test_a_turned_band_is_early_at_large_columns(self):
        cameras = strip_cameras((0.0, -83.0))
        moved = apply_statics(cameras, bands(), np.array([0.0, 0.0, 1e-3]))
        before, after = (predict_match(*pair, Plane(), PIXELS) for pair in (cameras, moved))
        assert_allclose((after - before)[:, 0], -np.tan(1e-3) * (PIXELS[:, 1] - 159.5), atol=1e-5)

    def test_a_stretched_band_sees_as_much_further_from_its_middle(self):
        statics = band_statics(given_bands(["PAN", "red"], [0.0, 0.0], [0.0, 0.0], [1e-3, 1e-3]))
        assert [(p.name, p.unit, p.sigma) for p in statics] == [("red scale", "", 1e-3)]
        cameras = strip_cameras((0.0, -83.0))
        moved = apply_statics(cameras, statics, np.array([2e-3]))
        before, after = (predict_match(*pair, Plane(), PIXELS) for pair in (cameras, moved))
        # what lies k pixels from the middle is met by a pixel k / (1 + scale) from it
        want = -(1.0 - 1.0 / 1.002) * (before[:, 1] - 159.5)
        assert_allclose((after - before)[:, 1], want, atol=1e-5)
        assert_allclose((after - before)[:, 0], 0.0, atol=1e-5)

    def test_a_bent_band_departs_by_a_polynomial_that_neither_shifts_nor_turns_it(self):
        cameras = strip_cameras((0.0, -83.0))
        statics = band_statics(shaped(cameras, "line", "polynomial"))
        assert [p.name for p in statics[:2]] == ["red bend along of degree 2", "red bend along of degree 3"]
        assert len(statics) == 8 and {p.sigma for p in statics} == {0.5}
        moved = apply_statics(cameras, statics, np.array([0.3, 0, 0, 0, 0, 0.2, 0, 0]))
        before, after = (predict_match(*pair, Plane(), PIXELS) for pair in (cameras, moved))
        u = (PIXELS[:, 1] - 159.5) / 159.5
        # what lies there is met up to 0.2 px beside the column; the bends change by 6e-3 and 8e-3 per px
        assert_allclose((after - before)[:, 0], -0.3 * (1.5 * u**2 - 0.5), atol=1.2e-3)
        assert_allclose((after - before)[:, 1], -0.2 * (2.5 * u**3 - 1.5 * u), atol=2e-3)

    def test_the_first_line_that_is_straight_is_the_measure_of_the_others_and_else_the_first(self):
        cameras = strip_cameras((0.0, -83.0))
        assert [p.name for p in band_statics(shaped(cameras, "pieces", "line"))] == [
            f"PAN step {axis} at column {column}" for axis in ("along", "across") for column in (100, 200)
        ]
        both = shaped(cameras, "pieces", "pieces")
        both[1] = replace(both[1], pieces=(50, 205))
        # those of the measure are seen as the others'; two that nearly meet are one
        assert [p.name for p in band_statics(both)[:3]] == [
            f"red step along at column {column}" for column in (50, 100, 205)
        ]

    def test_steps_that_were_found_where_none_were_given_go_into_the_cameras(self):
        bands = [replace(band, pieces=()) for band in shaped(strip_cameras((0.0, -83.0)), "line", "pieces")]
        still = Motion.zero(T0, T1)
        found = {"red step along at column 120": 0.4, "PAN step along at column 7": 9.0}
        moved = recovered_cameras(bands, still, found)[1].detector
        step = np.diff(moved.tangents, axis=0) / moved.pixel_step
        assert_allclose(step[119], [1.0, 0.4], atol=1e-3)
        assert_allclose(np.delete(step, 119, axis=0)[:, 1], 0.0, atol=1e-9)
        assert_allclose(moved.rough_columns, [119.0, 120.0])

    def test_ccds_that_would_overlap_are_an_error_that_says_what_to_check(self):
        cameras = strip_cameras((0.0, -83.0))
        statics = band_statics(shaped(cameras, "line", "pieces"))
        with pytest.raises(EstimationError, match=r"'band 1', found up to 1.2 px, .* check `pieces`"):
            apply_statics(cameras, statics, np.array([0.0, 0.0, -1.2, 0.0]))

    def test_an_offset_of_the_hub_acts_the_other_way(self):
        cameras = strip_cameras((0.0, -83.0))
        statics = band_statics(given_bands(["PAN", "red"], [1.0, 1.0], [0.0, 0.0]))
        by = sensitivities(cameras, 0, 1, Plane(), PIXELS, statics).statics
        want = np.concatenate([np.eye(2), -np.eye(2)], axis=1)
        # 1e-6 px of two positions over a step of 1 px; tangents of 1e-3 leave 1e-6 of a pixel per pixel
        assert_allclose(by, np.tile(want, (3, 1, 1)), atol=5e-6)

    def test_parameters_of_other_images_leave_a_pair_alone(self):
        cameras = strip_cameras((0.0, -83.0, -100.0))
        statics = band_statics(given_bands(["a", "b", "c"], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]))
        assert not sensitivities(cameras, 0, 1, Plane(), PIXELS, statics).statics.any()

    def test_nothing_away_from_nominal_leaves_the_cameras_as_they_are(self):
        cameras = strip_cameras((0.0, -83.0))
        assert apply_statics(cameras, bands(), np.zeros(3)) == cameras

    def test_one_value_per_parameter_is_needed(self):
        with pytest.raises(ValueError, match="shorter"):
            apply_statics(strip_cameras((0.0, -83.0)), bands(), np.zeros(2))


class TestFrames:
    def statics(self):
        return frame_statics(
            ["1", "2"],
            focal_length_sigma_px=5.0,
            principal_point_sigma_px=(0.0, 2.0),
            distortion_sigma=(1e-2, 0.0),
        )

    def test_names_say_which_constant_of_the_lens_is_free(self):
        assert [p.name for p in self.statics()] == [
            "focal length", "principal point column", "distortion k1",
        ]  # fmt: skip
        assert all(p.images == (0, 1) for p in self.statics())

    def test_a_longer_lens_spreads_the_scene_from_the_principal_point(self):
        cameras = matrix_cameras()
        moved = apply_statics(cameras, self.statics(), np.array([20.0, 0.0, 0.0]))
        ground = cameras[0].locate(np.array([[50.0, 50.0], [80.0, 30.0]]), Plane())
        assert_allclose(moved[0].project(ground), [[50.0, 50.0], [80.3, 29.8]], atol=1e-9)

    def test_a_moved_principal_point_moves_the_scene_with_it(self):
        cameras = matrix_cameras()
        moved = apply_statics(cameras, self.statics(), np.array([0.0, 1.5, 0.0]))
        ground = cameras[0].locate(np.array([[80.0, 30.0]]), Plane())
        assert_allclose(moved[0].project(ground), [[80.0, 31.5]], atol=1e-9)

    def test_distortion_grows_with_the_cube_of_the_field(self):
        cameras = matrix_cameras()
        moved = apply_statics(cameras, self.statics(), np.array([0.0, 0.0, 3.0]))
        ground = cameras[0].locate(np.array([[50.0, 90.0]]), Plane())
        # x (1 + k1 x^2) with x = 40 px / 2000 px
        want = [[50.0, 50.0 + 40.0 * (1 + 3.0 * (40.0 / 2000.0) ** 2)]]
        assert_allclose(moved[0].project(ground), want, atol=1e-9)

    def test_distortion_given_before_is_kept_and_changed(self):
        statics = frame_statics(["1"], distortion_sigma=(0.0, 0.0, 1e-3))
        (moved, _) = apply_statics(matrix_cameras((0.25,)), statics, np.array([2e-3]))
        assert_allclose(moved.detector.distortion, (0.25, 0.0, 2e-3))

    def test_parameters_of_a_lens_do_not_touch_a_strip(self):
        strip = strip_cameras((0.0,))
        assert apply_statics(strip, self.statics(), np.ones(3)) == strip
