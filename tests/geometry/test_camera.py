"""Cameras beyond the round trips of ``tests/laws``: edges, spans, messages, changes."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, SpanError
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.checks import read_only
from sightline.geometry.instrument import AreaDetector, LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory

IFOV, PERIOD, ALTITUDE, SPEED = 5e-6, 5e-4, 680e3, 6800.0
DETECTOR = LineDetector.from_ifov("PAN", 1000, IFOV, PERIOD)
FLIGHT = Trajectory.level_flight(ALTITUDE, SPEED, -1.0, 2.0)


def pushbroom(flight: Trajectory = FLIGHT, lines: int = 1000, **options) -> PushbroomCamera:
    return PushbroomCamera(
        options.pop("detector", DETECTOR),
        flight,
        options.pop("pointing", FixedMount()),
        0.0,
        lines,
        **options,
    )


class TestSpans:
    def test_a_line_exposed_after_the_trajectory_is_named_with_its_time(self):
        camera = pushbroom(Trajectory.level_flight(ALTITUDE, SPEED, 0.0, 0.4))
        with pytest.raises(SpanError) as problem:
            camera.locate([[10.0, 0.0], [940.0, 0.0]], Plane())
        assert str(problem.value) == (
            "line 940 is exposed at t = 0.470000 s, outside the trajectory span [0.000000, 0.400000] s; "
            "supply position, attitude and motion up to 0.470000 s or crop the image"
        )

    def test_a_line_exposed_before_the_trajectory_is_named_too(self):
        camera = pushbroom(FLIGHT.with_motion(Motion.zero(0.1, 1.0)))
        with pytest.raises(SpanError, match=r"line 0 is exposed at t = 0\.000000 s.*from 0\.000000 s"):
            camera.rays([[0.0, 0.0]])

    def test_a_trajectory_of_another_epoch_is_noticed(self):
        camera = PushbroomCamera(DETECTOR, FLIGHT, FixedMount(), 5e8, 1000)
        with pytest.raises(SpanError, match=r"no line of the image is exposed inside.*check the epoch"):
            camera.project([[0.0, 0.0, 0.0]])

    def test_a_line_far_from_the_image_hints_at_swapped_axes(self):
        with pytest.raises(SpanError, match=r"line 1500 lies outside.*check \(line, column\) order"):
            pushbroom().rays([[1500.0, 3.0]])

    def test_half_a_line_beyond_the_last_pose_has_rays_and_no_more(self):
        camera = pushbroom(Trajectory.level_flight(ALTITUDE, SPEED, 0.0, 999 * PERIOD))
        edge = [[-0.5, 0.0], [999.5, 0.0]]
        assert_allclose(camera.project(camera.locate(edge, Plane())), edge, atol=1e-6)
        with pytest.raises(SpanError):
            camera.rays([[999.6, 0.0]])

    def test_points_of_lines_without_pose_are_not_seen(self):
        full, half = pushbroom(), pushbroom(Trajectory.level_flight(ALTITUDE, SPEED, 0.0, 0.25))
        points = full.locate([[100.0, 5.0], [900.0, 5.0]], Plane())
        assert np.isnan(half.project(points)).any(axis=1).tolist() == [False, True]


class TestProject:
    def test_points_off_the_image_are_nan_but_columns_may_run_50_px_over(self):
        camera = pushbroom()
        pixels = np.array([[500.0, -49.0], [500.0, 1048.0], [500.0, -52.0], [-0.4, 3.0], [-0.6, 3.0]])
        seen = camera.project(camera.locate(pixels, Plane()))
        assert np.isnan(seen).any(axis=1).tolist() == [False, False, True, False, True]

    def test_a_margin_of_lines_can_be_asked_for(self):
        camera = pushbroom()
        pixels = np.array([[-10.0, 3.0], [1009.0, 3.0]])
        assert_allclose(camera.project(camera.locate(pixels, Plane()), line_margin=12.0), pixels, atol=1e-6)

    def test_a_point_above_the_camera_is_not_seen(self):
        assert np.isnan(pushbroom().project([[0.0, 500.0, 2 * ALTITUDE]])).all()

    def test_no_points_give_no_pixels(self):
        assert pushbroom().project(np.zeros((0, 3))).shape == (0, 2)
        assert pushbroom().locate(np.zeros((0, 2)), Plane()).shape == (0, 3)

    def test_a_camera_mounted_backwards_sees_lines_run_the_other_way(self):
        """y towards increasing lines is then backward: the scan still goes forward, along -y, and columns
        increase to the right."""
        back = FixedMount(NADIR_MOUNT * Rotation.from_euler("Z", np.pi))
        camera = pushbroom(pointing=back)
        assert_allclose(camera.locate([[0.0, 500.5]], Plane())[0], [3.4, 0, 0], atol=1e-6)
        assert_allclose(camera.project([[3.4, 0.0, 0.0]]), [[0.0, 500.5]], atol=1e-6)

    def test_a_point_shown_three_times_gets_one_of_its_lines(self):
        """Pitch swings by 20 px at 40 lines a period: 3.1 px per line, so the scene runs back and forth."""
        t = PERIOD * np.arange(-20.0, 1020.0)
        swing = 20 * IFOV * np.sin(2 * np.pi * t / (40 * PERIOD))
        camera = pushbroom(FLIGHT.with_motion(Motion(t, swing[:, None] * [0.0, 1.0, 0.0])))
        points = camera.locate(np.stack([np.arange(50.0, 950.0), np.full(900, 400.0)], axis=1), Plane())
        pixels = camera.project(points)
        assert np.isfinite(pixels).all()
        assert_allclose(camera.locate(pixels, Plane()), points, atol=1e-6)

    def test_a_point_reached_only_by_turning_back_is_found_by_the_scan(self):
        """A slew ahead and back: both ends of the image see the same side of the point."""
        t = np.linspace(-1.0, 2.0, 61)
        slew = 0.02 * np.sin(np.pi * np.clip(t, 0.0, 0.5) / 0.5)
        camera = pushbroom(FLIGHT.with_motion(Motion(t, slew[:, None] * [0.0, 1.0, 0.0])))
        point = camera.locate([[450.0, 321.0]], Plane())
        pixel = camera.project(point)
        assert_allclose(camera.locate(pixel, Plane()), point, atol=1e-5)

    @pytest.mark.parametrize("size", [1.0, 30.0])  # the larger one shows some points more than once
    def test_the_plane_of_a_straight_line_finds_the_lines_that_poses_find(self, size):
        t = np.linspace(-0.2, 0.8, 4001)
        waves = [(2.0, 2e-5), (35.0, 3e-6), (130.0, 4e-7)]
        angles = sum(a * np.sin(2 * np.pi * f * t[:, None] + np.arange(3.0)) for f, a in waves)
        flight = FLIGHT.with_motion(Motion(t, size * np.asarray(angles)))
        by_plane, by_poses = pushbroom(flight), pushbroom(flight)
        by_poses.__dict__["_planes"] = read_only(np.empty((0, 4)))
        rng = np.random.default_rng(0)
        points = by_plane.locate(rng.uniform(-0.4, 999.4, (2000, 2)), Plane(50.0))
        found = by_plane.project(points)
        if size == 1.0:
            # both end within 3e-10 lines
            assert_allclose(found, by_poses.project(points), rtol=0.0, atol=1e-9)
        seen = np.isfinite(found[:, 0])
        assert seen.mean() > 0.99
        # whichever line it is, the point is seen there
        assert_allclose(by_plane.locate(found[seen], Plane(50.0)), points[seen], atol=1e-7 * size)

    def test_motion_in_roll_moves_columns_only(self):
        roll = Motion.zero(-1.0, 2.0).shifted([10 * IFOV, 0.0, 0.0])
        start = np.array([[400.0, 500.0]])
        moved = pushbroom(FLIGHT.with_motion(roll)).project(pushbroom().locate(start, Plane()))
        assert_allclose(moved - start, [[0.0, -10.0]], atol=1e-5)


class TestChanges:
    def test_another_detector_keeps_the_poses_and_another_line_period_does_not(self):
        camera = pushbroom()
        camera.project([[0.0, 0.0, 0.0]])
        shifted = camera.with_detector(DETECTOR.adjusted(line_px=2.0))
        assert shifted._table is camera._table
        slower = camera.with_detector(LineDetector.from_ifov("PAN", 1000, IFOV, 2 * PERIOD))
        assert slower._table is not camera._table
        assert_allclose(slower.locate([[100.0, 499.5]], Plane())[0, 1], 2 * SPEED * PERIOD * 100)

    def test_another_trajectory_gives_other_poses(self):
        camera = pushbroom()
        camera.project([[0.0, 0.0, 0.0]])
        higher = camera.with_trajectory(Trajectory.level_flight(2 * ALTITUDE, SPEED, -1.0, 2.0))
        assert_allclose(higher.locate([[0.0, 0.0]], Plane()), 2 * camera.locate([[0.0, 0.0]], Plane()))

    def test_uneven_line_times_are_followed_and_reported(self):
        times = PERIOD * np.arange(1000.0) ** 1.01
        camera = pushbroom(line_times=times)
        assert camera.first_line_time == 0.0
        assert_allclose(camera.times([0.0, 10.0, 999.0]), times[[0, 10, 999]])
        assert_allclose(camera.times([-1.0, 1001.0]), [-times[1], 3 * times[999] - 2 * times[998]])
        assert_allclose(camera.locate([[10.0, 499.5]], Plane())[0, 1], SPEED * times[10])

    def test_a_lever_arm_moves_the_pupil_in_body_axes(self):
        """2 m forward, 3 m right, 1 m down: north, east, down here."""
        rays = pushbroom(lever_arm=(2.0, 3.0, 1.0)).rays([[0.0, 499.5]])
        assert_allclose(rays.origins, [[3.0, 2.0, ALTITUDE - 1.0]])

    def test_rays_tell_when_each_pixel_was_exposed_and_have_unit_length(self):
        rays = pushbroom().rays([[10.0, 0.0], [np.nan, 0.0]])
        assert rays.t[0] == pytest.approx(5e-3)
        assert np.isnan(rays.t[1]) and np.isnan(rays.origins[1]).all() and np.isnan(rays.directions[1]).all()
        assert (rays.directions[0] ** 2).sum() == pytest.approx(1.0, abs=1e-15)

    def test_a_camera_survives_a_trip_to_another_process(self):
        camera = pushbroom()
        pixels = np.array([[3.0, 4.0]])
        expected = camera.locate(pixels, Plane())
        again = pickle.loads(pickle.dumps(camera))
        assert_allclose(again.locate(pixels, Plane()), expected)
        assert not again._table.rows.flags.writeable

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"lines": 0}, "`lines` must be a whole number of 1 or more"),
            ({"line_times": [0.0, 1.0]}, r"one time per line, \(1000,\), got \(2,\)"),
            ({"lever_arm": (1.0, np.nan, 0.0)}, "`lever_arm` must be 3 finite numbers"),
        ],
    )
    def test_impossible_cameras_are_refused(self, options, message):
        with pytest.raises(InputError, match=message):
            pushbroom(**options)


def test_a_camera_that_forgot_its_poses_finds_the_same_ones_again():
    camera = PushbroomCamera(
        LineDetector.from_ifov("pan", 20, 1e-5, 1e-3),
        Trajectory.level_flight(6e5, 7e3, -1.0, 1.0),
        FixedMount(),
        0.0,
        50,
    )
    pixels = np.array([[0.0, 0.0], [20.5, 7.25], [49.0, 19.0]])
    before, table = camera.locate(pixels, Plane()), camera._table
    camera.forget()
    assert "_table" not in vars(camera)
    np.testing.assert_array_equal(camera.locate(pixels, Plane()), before)
    assert camera._table is not table


class TestFrame:
    def frame(self, **options) -> FrameCamera:
        detector = AreaDetector("frame", (100, 200), 1000.0, (49.5, 99.5), options.pop("distortion", ()))
        return FrameCamera(detector, FLIGHT, FixedMount(), 0.0, **options)

    def test_one_instant_is_enough_for_a_global_shutter(self):
        still = Trajectory([0.0], [[0.0, 0.0, 1000.0]], [0.0], FLIGHT.world_from_body[0])
        camera = self.frame().with_trajectory(still)
        ground = camera.locate([[49.5, 99.5], [59.5, 99.5], [49.5, 109.5]], Plane())
        assert_allclose(ground, [[0, 0, 0], [0, 10, 0], [-10, 0, 0]], atol=1e-9)

    def test_a_rolling_shutter_exposes_the_last_line_after_the_readout_time(self):
        camera = self.frame(readout_time=0.05)
        assert_allclose(camera.times([0.0, 99.0]), [0.0, 0.05])
        rays = camera.rays([[0.0, 0.0], [99.0, 0.0]])
        assert_allclose(rays.origins[:, 1], [0.0, 0.05 * SPEED], atol=1e-9)

    def test_a_rolling_shutter_sees_a_point_by_the_line_that_looks_there_when_it_is_exposed(self):
        """Each line is exposed by itself, as a frame of one instant; roots between lines by bisection."""
        flight = FLIGHT.with_motion(Motion([-1.0, 2.0], [[-0.02, 0.03, -0.01], [0.04, -0.06, 0.02]]))
        camera = self.frame(readout_time=0.05, distortion=(0.2, -0.1)).with_trajectory(flight)
        pixels = np.array([[0.4, 3.0], [33.25, 150.0], [50.0, 99.5], [98.7, 199.0]])
        points = camera.locate(pixels, Plane())
        expected = []
        for point in points:

            def at(line, point=point):
                still = replace(camera, t=0.05 * line / 99.0, readout_time=0.0)
                return still.detector.pixels(
                    (point - still.rays([[0.0, 0.0]]).origins)
                    @ (flight.at([still.t]).world_from_body * NADIR_MOUNT).as_matrix()[0]
                )[0]

            line = brentq(lambda line, at=at: at(line)[0] - line, -20.0, 120.0, xtol=1e-12)
            expected.append([line, at(line)[1]])
        assert_allclose(camera.project(points), expected, rtol=0.0, atol=1e-6)
        assert_allclose(expected, pixels, rtol=0.0, atol=1e-6)

    def test_a_trajectory_that_ends_during_readout_is_refused(self):
        with pytest.raises(SpanError, match=r"the trajectory is not known at t = 3\.000000 s"):
            self.frame(readout_time=3.0).rays([[0.0, 0.0]])

    def test_points_outside_the_frame_are_nan_beyond_50_px(self):
        camera = self.frame()
        ground = camera.locate([[-40.0, 0.0], [-60.0, 0.0], [0.0, 260.0]], Plane())
        assert np.isnan(camera.project(ground)).any(axis=1).tolist() == [False, True, True]
        assert np.isnan(camera.project([[0.0, 0.0, 2 * ALTITUDE], [np.nan, 0, 0]])).all()

    def test_another_lens_replaces_the_first(self):
        bent = self.frame(distortion=(0.5,)).detector
        camera = self.frame().with_detector(bent)
        assert camera.detector is bent and camera.shape == (100, 200)


class TestTdiStages:
    T = np.arange(-200, 1300) * PERIOD
    JITTER = Motion(T, 1e-6 * np.stack([np.sin(300.0 * T), np.cos(500.0 * T), np.sin(400.0 * T)], axis=1))
    MOVING = FLIGHT.with_motion(JITTER)
    PIXELS = np.array([[100.0, 0.0], [333.0, 499.0], [334.5, 998.0], [700.0, 700.0]])

    def stage(self, late: float) -> PushbroomCamera:
        """What one stage is: so many line periods later, so many pixels further back."""
        return PushbroomCamera(DETECTOR.adjusted(-late), self.MOVING, FixedMount(), late * PERIOD, 1000)

    @pytest.mark.parametrize(
        ("reference", "first"), [("centre", -7.5), ("first-stage", 0), ("last-stage", -15)]
    )
    def test_a_pixel_looks_where_its_stages_look_on_average(self, reference, first):
        camera = pushbroom(self.MOVING, stages=16, time_reference=reference)
        each = [self.stage(first + k).locate(self.PIXELS, Plane()) for k in range(16)]
        # 3.4 m are a pixel
        assert_allclose(camera.locate(self.PIXELS, Plane()), np.mean(each, axis=0), atol=2e-3)
        assert_allclose(camera.rays(self.PIXELS).t, (self.PIXELS[:, 0] + first + 7.5) * PERIOD, atol=1e-9)

    def test_a_turn_that_grows_from_stage_to_stage_moves_columns_by_where_each_looks(self):
        # 15 mrad at 47 Hz: the outermost of 16 stages lie 7.5 px from the middle; the mean is moved by up to
        # (16^2 - 1) / 12 * .015 * 2 pi 47 * 5e-4 = .047 px, less what the stages average away
        motion = Motion(self.T, 0.015 * np.outer(np.sin(2.0 * np.pi * 47.0 * self.T), [0.0, 0.0, 1.0]))
        moving = FLIGHT.with_motion(motion)
        pixels = np.stack([np.linspace(50.0, 900.0, 40), np.full(40, 499.5)], axis=1)
        found = pushbroom(moving, stages=16).locate(pixels, Plane())
        each = [
            PushbroomCamera(DETECTOR.adjusted(-late), moving, FixedMount(), late * PERIOD, 1000)
            for late in np.arange(16) - 7.5
        ]
        expected = np.mean([camera.locate(pixels, Plane()) for camera in each], axis=0)
        middle = pushbroom(moving).locate(pixels, Plane())
        assert np.abs(expected - middle)[:, 0].max() > 0.1  # m; 3.4 m are a pixel
        # what is left is of second order: 7.5 px times the square of the .008 rad that a stage is turned by
        assert_allclose(found, expected, atol=1e-3)

    def test_columns_of_other_stages_have_their_own_times_and_averages(self):
        counts = np.where(np.arange(1000) < 600, 4, 32)
        camera = pushbroom(self.MOVING, stages=counts, time_reference="first-stage")
        for column, count in ((100.0, 4), (800.0, 32)):
            pixel = np.array([[400.0, column]])
            whole = pushbroom(self.MOVING, stages=count, time_reference="first-stage")
            assert_allclose(camera.locate(pixel, Plane()), whole.locate(pixel, Plane()), atol=1e-9)
            assert camera.integration(pixel)[0] == pytest.approx(np.sqrt(count**2 - 1.0) * PERIOD)

    def test_points_are_found_again_where_columns_differ(self):
        counts = np.where(np.arange(1000) < 600, 4, 32)
        camera = pushbroom(self.MOVING, stages=counts, time_reference="first-stage")
        assert_allclose(camera.project(camera.locate(self.PIXELS, Plane())), self.PIXELS, atol=1e-6)
        moved = camera.with_detector(DETECTOR.adjusted(0.5, 0.25))
        assert_allclose(moved.project(moved.locate(self.PIXELS, Plane())), self.PIXELS, atol=1e-6)

    @pytest.mark.parametrize(
        ("reference", "reach"),
        [("centre", (16, 16)), ("first-stage", (0.5, 31.5)), ("last-stage", (31.5, 0.5))],
    )
    def test_stages_begin_and_end_where_the_first_and_the_last_of_all_columns_do(self, reference, reach):
        """Stages are a period long about their middles: 32 of them and, of other columns, 4."""
        counts = np.where(np.arange(1000) < 600, 4, 32)
        camera = pushbroom(self.MOVING, stages=counts, time_reference=reference)
        assert camera.reach == pytest.approx(np.array(reach) * PERIOD)
        assert camera.rough_columns.tolist() == [599, 600]
        assert camera.stage_times == pytest.approx((4 * PERIOD, 32 * PERIOD))

    def test_one_stage_is_no_tdi(self):
        camera = pushbroom(self.MOVING, stages=1)
        assert camera.stages is None
        assert np.array_equal(
            camera.project([[0.0, 300.0, 0.0]]), pushbroom(self.MOVING).project([[0, 300, 0]])
        )

    @pytest.mark.parametrize(
        "stages", [0, np.ones(999), np.full((2, 1000), 4)], ids=["none", "short", "lines"]
    )
    def test_stages_that_do_not_go_with_the_image_are_refused(self, stages):
        with pytest.raises(InputError, match="`stages` must be whole numbers from 1 to"):
            pushbroom(stages=stages)


def test_poses_and_planes_of_many_lines_are_those_of_all_at_once(monkeypatch):
    t = np.linspace(-0.9, 1.9, 1400)
    shake = Motion(t, 1e-4 * np.stack([np.sin(40.0 * t), np.cos(70.0 * t), t], axis=1))
    whole = pushbroom(FLIGHT.with_motion(shake))
    tables = whole._table.rows, whole._planes, whole._table.origin
    for place in ("pose_table", "camera"):
        monkeypatch.setattr(f"sightline.geometry.{place}._AT_ONCE", 37)
    pieces = pushbroom(FLIGHT.with_motion(shake))
    for one, other in zip(tables, (pieces._table.rows, pieces._planes, pieces._table.origin), strict=True):
        assert np.array_equal(one, other)
