"""Windows on a hub and where they are predicted, by hand geometry of level flight."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import ALTITUDE, IFOV, PERIOD, T0, T1, sampled_motion, strip_cameras
from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.imaging.source import ArrayImage
from sightline.motion.measure import laid_strips
from sightline.motion.measure.laid_strips import exposed, finest_view
from sightline.motion.measure.windows import (
    brightest_parts,
    exposure_times,
    field_positions,
    image_shape,
    predict_windows,
    window_grid,
)


def frame(readout_time: float = 0.0) -> FrameCamera:
    detector = AreaDetector("matrix", (101, 80), 2000.0, (50.0, 39.5))
    flight = Trajectory.level_flight(ALTITUDE, 6800.0, T0, T1)
    return FrameCamera(detector, flight, FixedMount(), 0.25, readout_time)


class TestGrid:
    def test_windows_lie_side_by_side_in_the_middle_of_the_image(self):
        grid = window_grid((100, 330), (10, 100), 20)
        # 30 columns are left over, 15 on each side; the last row that fits begins at line 80
        assert_allclose(grid.lines, [4.5, 24.5, 44.5, 64.5, 84.5])
        assert_allclose(grid.columns, [64.5, 164.5, 264.5])
        assert grid.shape == (5, 3)
        assert_allclose(grid.centres[:4], [[4.5, 64.5], [4.5, 164.5], [4.5, 264.5], [24.5, 64.5]])

    def test_a_window_larger_than_the_image_is_cut_to_it(self):
        grid = window_grid((8, 60), (10, 100), 4)
        assert grid.window == (8, 60)
        assert_allclose(grid.centres, [[3.5, 29.5]])

    def test_windows_may_overlap_across(self):
        grid = window_grid((10, 200), (10, 100), 10, columns_step=50)
        assert_allclose(grid.columns, [49.5, 99.5, 149.5])


class TestPrediction:
    def test_a_window_is_predicted_at_the_mean_over_its_lines(self):
        amplitude, period = 2.0 * IFOV, 60 * PERIOD
        motion = sampled_motion(pitch=lambda t: amplitude * np.sin(2 * np.pi * t / period))
        cameras = strip_cameras((0.0, -83.0), motion=motion)
        grid = window_grid((500, 320), (10, 100), 20)
        (got,) = predict_windows(cameras, 0, [1], Plane(), grid)
        lines = np.arange(10) - 4.5
        each = np.array(
            [predict_match(*cameras, Plane(), grid.centres + np.array([step, 0.0])) for step in lines]
        )
        # Two points at the rms distance have the mean of x^2 right; of the mean of x^4 (120.9 for ten lines)
        # they have 68.1. A sine of 2 px and 60 lines in both images:
        # 2 * 2 * (2 pi / 60)^4 / 24 * (120.9 - 68.1).
        quartic = 2 * 2.0 * (2 * np.pi / 60) ** 4 / 24 * (120.9 - 68.1)
        assert_allclose(got.b, each.mean(axis=0), atol=2 * quartic)
        # the place of the centre alone would miss by twenty times as much
        centre = predict_match(*cameras, Plane(), grid.centres)
        assert np.abs(centre - each.mean(axis=0)).max() > 20 * quartic

    @pytest.mark.parametrize("width", [100, 320])
    def test_a_turned_detector_shows_in_the_map_across(self, width):
        first, second = strip_cameras((0.0, -83.0))
        turn = 0.01
        second = second.with_detector(second.detector.adjusted(rotation=turn))
        grid = window_grid((500, 320), (10, width), 100)
        (got,) = predict_windows([first, second], 0, [1], Plane(), grid)
        # a turned row of pixels looks x tan(turn) further ahead at field x and takes x / cos(turn) pixels
        want = np.array([[1.0, -np.tan(turn)], [0.0, 1 / np.cos(turn)]])
        # positions close to 1e-6 px, over the 10 lines or more between those compared
        assert_allclose(got.affine, np.broadcast_to(want, got.affine.shape), atol=1e-6)

    def test_a_growing_roll_rate_shows_in_the_map_along(self):
        lag_lines, growth = 83, 0.02
        cameras = strip_cameras((0.0, -83.0), motion=sampled_motion(roll=lambda t: growth * t**2))
        (got,) = predict_windows(cameras, 0, [1], Plane(), window_grid((500, 320), (10, 100), 100))
        # column_b - column_a = -(c tb^2 - c ta^2) / ifov with tb = ta + lag: its change with ta is
        # -2 c lag / ifov; terms of the roll squared are (c t^2)^2 < 1e-5 of it
        want = -2 * growth * lag_lines * PERIOD**2 / IFOV
        assert_allclose(got.affine[:, 1, 0], want, rtol=1e-2)

    def test_the_partner_is_exposed_a_lag_later_and_unseen_windows_have_no_place(self):
        cameras = strip_cameras((0.0, -83.0), lines=500)
        grid = window_grid((500, 320), (10, 100), 10)
        (got,) = predict_windows(cameras, 0, [1], Plane(), grid)
        seen = np.isfinite(got.b[:, 0])
        # both of the two lines that stand for a window must be seen, 2.9 lines off its centre
        assert_allclose(seen, grid.centres[:, 0] + 83 + 2.9 < 499.5)
        assert_allclose(got.t[seen], (grid.centres[seen, 0] + 83) * PERIOD, atol=1e-9)
        assert np.isnan(got.t[~seen]).all()
        assert np.isfinite(got.affine[..., 1]).all()


class TestTimes:
    def test_a_frame_is_exposed_at_one_instant(self):
        assert_allclose(exposure_times(frame(), np.array([[0.0, 0.0], [100.0, 3.0]])), 0.25)

    def test_a_rolling_shutter_reads_line_0_at_t_and_the_last_line_a_readout_later(self):
        pixels = np.array([[0.0, 5.0], [50.0, 5.0], [100.0, 5.0], [np.nan, np.nan]])
        assert_allclose(exposure_times(frame(0.1), pixels), [0.25, 0.3, 0.35, np.nan], atol=1e-12)

    def test_lines_of_a_pushbroom_are_exposed_one_period_apart(self):
        camera = strip_cameras((0.0,))[0]
        got = exposure_times(camera, np.array([[0.0, 0.0], [10.5, 3.0], [np.nan, np.nan]]))
        assert_allclose(got, [0.0, 10.5 * PERIOD, np.nan], atol=1e-12)

    def test_a_camera_of_unknown_kind_is_named(self):
        with pytest.raises(EstimationError, match=r"exposure times are not known .* SimpleNamespace"):
            exposure_times(SimpleNamespace(), np.zeros((1, 2)))


def test_the_field_runs_from_minus_one_to_one_between_the_outer_pixels():
    assert_allclose(field_positions(np.array([0.0, 159.5, 319.0]), 320), [-1.0, 0.0, 1.0])


def test_an_image_has_the_size_of_its_strip_or_its_detector():
    assert image_shape(strip_cameras((0.0,))[0]) == (600, 320)
    assert image_shape(frame()) == (101, 80)


def test_a_line_shows_the_mean_of_a_motion_over_its_exposure():
    """A tone of f keeps sinc(f T) of its size over an exposure of T, here half a period and less."""
    tones = np.array([200.0, 450.0, 1000.0])
    t = np.arange(T0, T1, PERIOD / 20)
    motion = Motion(t, 1e-5 * np.sin(2.0 * np.pi * np.outer(t, tones) + [0.0, 1.0, 2.0]))
    (line,) = strip_cameras((0.0,), motion=motion)
    found = exposed(line).trajectory.motion
    inner = (t > T0 + PERIOD) & (t < T1 - 2 * PERIOD)
    # five parts of an exposure: above the integral by (pi f T / 5)^2 / 6
    short = np.abs(found.angles - motion.angles * np.sinc(tones * PERIOD))[inner].max(axis=0)
    assert (short < 1.1e-5 * (np.pi * tones * PERIOD / 5.0) ** 2 / 6.0).all()
    (still,) = strip_cameras((0.0,))
    assert exposed(still) is still and exposed(frame()).trajectory.motion is None


class TestBrightestParts:
    def test_parts_of_drawn_pixels_whatever_the_stretch_that_is_read(self, monkeypatch):
        pixels = np.random.default_rng(5).uniform(0.0, 4000.0, (61, 90)).astype(np.float32)
        pixels[10:20, 30:60] = np.nan
        grid = window_grid(pixels.shape, (4, 25), 3)
        want = []
        for line, column in grid.centres:
            top, left = round(line - 1.5), round(column - 12)
            # 25 columns hold three parts of 8 at least
            parts = [pixels[top : top + 4, left + a : left + b] for a, b in ((0, 8), (8, 16), (16, 25))]
            means = [p[np.isfinite(p)].mean(dtype=float) for p in parts if np.isfinite(p).any()]
            want.append(max(means) if means else np.nan)
        assert np.isnan(want).any() and np.isfinite(want).any()
        assert_allclose(brightest_parts(ArrayImage(pixels), grid), want, rtol=1e-9)
        monkeypatch.setattr("sightline.motion.measure.windows._READ_PIXELS", 1000)
        assert_allclose(brightest_parts(ArrayImage(pixels), grid), want, rtol=1e-9)

    def test_a_cloud_on_a_tenth_of_a_window_shows(self):
        pixels = np.full((40, 200), 100.0, dtype=np.float32)
        pixels[8:12, 88:98] = 300.0
        grid = window_grid(pixels.shape, (4, 100), 4)
        bright = brightest_parts(ArrayImage(pixels), grid).reshape(grid.shape)
        # ten of the 12 or 13 columns of one part
        assert bright[2, 0] > 250.0 and (np.delete(bright, 2, axis=0) == 100.0).all()


def test_the_finest_view_is_the_fine_image_that_sees_most_windows(monkeypatch):
    """Images 1 and 2 are finer than the hub; each sees windows from a column on."""

    def camera(first: float) -> SimpleNamespace:
        def project(ground):
            return np.where(ground[:, 1:] >= first, ground, np.nan)

        return SimpleNamespace(project=project, locate=lambda centres, surface: centres)

    monkeypatch.setattr(laid_strips, "groups_of_pixels", lambda cameras: (0, 1, 1))
    grid = window_grid((100, 330), (10, 100), 20)
    coarse, some, most, none = camera(0.0), camera(200.0), camera(100.0), camera(400.0)
    assert finest_view([coarse, some, most], Plane(), 0, grid) == 2
    assert finest_view([coarse, most, some], Plane(), 0, grid) == 1
    assert finest_view([coarse, none, none], Plane(), 0, grid) is None
    assert finest_view([coarse, some, most], Plane(), 2, grid) is None
