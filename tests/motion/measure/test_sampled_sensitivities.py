"""Sensitivities of whole grids against hand geometry at every window, sampled or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from motion.strips import (
    ALTITUDE,
    IFOV,
    PERIOD,
    SPEED,
    given_bands,
    moved_by_turn,
    sampled_motion,
    strip_cameras,
)
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.pose_table import PoseTable
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.motion.band import Band
from sightline.motion.measure import predict
from sightline.motion.measure.sampled_sensitivities import _averaged, sampled_sensitivities
from sightline.motion.measure.windows import window_grid
from sightline.motion.statics import band_statics

AHEAD = (120.0, -80.0)
GRID = window_grid((600, 320), (10, 20), 30)


def sensitivities_of_all(cameras, grid, seen, statics):
    """Those of every window of a grid, (G, 2, 7 + Q); zeros where no window is seen."""
    out = np.zeros((len(grid.centres), 2, 7 + len(statics)))
    for some, values in sampled_sensitivities(cameras, 0, 1, Plane(), grid, seen, statics, grid.centres):
        out[some] = values
    return out


def test_every_window_between_the_samples_has_the_sensitivity_of_its_place():
    cameras = strip_cameras(AHEAD)
    statics = band_statics(given_bands(["first", "second"], [0.0, 1.0], [0.0, 0.0]))
    seen = GRID.centres[:, 0] + 200 < 590
    got = sensitivities_of_all(cameras, GRID, seen, statics)
    # 0.1 px/rad of the finite differences (see test_predict)
    assert_allclose(got[..., 0:3], -moved_by_turn(GRID.centres, AHEAD[0]), atol=0.12)
    assert_allclose(got[..., 3:6], moved_by_turn(GRID.centres, AHEAD[1]), atol=0.12)
    height = np.tile([-(AHEAD[0] - AHEAD[1]) / ALTITUDE, 0.0], (len(got), 1))
    assert_allclose(got[..., 6], height, atol=1e-7)
    assert_allclose(got[..., 7:], np.tile(-np.eye(2), (len(got), 1, 1)), atol=1e-5)


def test_every_row_has_the_sensitivity_of_its_own_motion():
    # Angles are one rotation vector: a roll added to a yaw of y turns the body about an axis y / 2 to the
    # right of north. It lifts the ground to the left of that axis, a partner that has yawed by y' by then has
    # y' - y / 2 of "left" behind it, and sees it sin(y' - y / 2) / ifov lines earlier. With a yaw of c t^2
    # every row has its own.
    growth, lag = 0.3, 200 * PERIOD
    cameras = strip_cameras(AHEAD, motion=sampled_motion(yaw=lambda t: growth * t**2))
    grid = window_grid((380, 320), (10, 100), 40)
    got = sensitivities_of_all(cameras, grid, np.ones(len(grid.centres), bool), [])
    t = grid.centres[:, 0] * PERIOD
    turned = growth * ((t + lag) ** 2 - t**2 / 2)
    # while the partner waits, the body yaws by 2 c t < 0.18 rad/s at a field of 8e-4, against V / H =
    # 0.01 / s: 1.5 %; another 1 % allows for the lag itself, which yaw and look ahead change
    assert_allclose(got[:, 0, 0], -np.sin(turned) / IFOV, rtol=0.025)
    assert turned.max() > 3 * turned.min()


def test_rows_of_a_long_strip_have_those_of_their_own_motion_too():
    """However many there are: yaw that turns every ten lines leaves nothing to interpolate between rows."""
    lines, size = 5000, 0.2
    rate = 2.0 * np.pi / (10.0 * PERIOD)
    t = np.arange(-100.0, lines + 100.0) * PERIOD
    yaw = Motion(t, np.stack([np.zeros_like(t), np.zeros_like(t), size * np.sin(rate * t)], axis=1))
    flight = Trajectory.level_flight(ALTITUDE, SPEED, t[0], t[-1]).with_motion(yaw)
    detector = LineDetector.from_ifov("nadir", 80, IFOV, PERIOD)
    camera = PushbroomCamera(detector, flight, FixedMount(), 0.0, lines)
    grid = window_grid((lines, 80), (2, 60), 1)
    got = sensitivities_of_all([camera, camera], grid, np.ones(len(grid.centres), bool), [])
    # both see the ground at once: half the yaw, as above; a twentieth for yaw between samples of the motion
    turned = 0.5 * size * np.sin(rate * grid.centres[:, 0] * PERIOD)
    assert_allclose(got[:, 0, 0], -np.sin(turned) / IFOV, atol=0.05 * 0.5 * size / IFOV)


def test_rows_whose_partner_is_not_seen_take_the_nearest_row_that_is():
    cameras = strip_cameras(AHEAD)
    seen = (GRID.centres[:, 0] > 100) & (GRID.centres[:, 0] < 300)
    got = sensitivities_of_all(cameras, GRID, seen, [])
    assert_allclose(got[..., 3:6], moved_by_turn(GRID.centres, AHEAD[1]), atol=0.12)


def test_a_window_that_a_step_divides_moves_by_the_share_beyond_it():
    cameras = strip_cameras(AHEAD)
    names = ("first", "second")
    bands = [
        Band(n, None, c, 0.0, 0.0, 0.0, shape="pieces", pieces=(105,))
        for n, c in zip(names, cameras, strict=True)
    ]
    bands[0] = replace(bands[0], shape="line", pieces=())
    statics = band_statics(bands)
    assert [p.name for p in statics] == [
        "second step along at column 105",
        "second step across at column 105",
    ]
    seen = np.ones(len(GRID.centres), bool)
    got = sensitivities_of_all(cameras, GRID, seen, statics)[..., 7:]
    # windows of 20 columns from 0 on: that of columns 100 to 119 has 15 of them beyond; the mean of all is 0
    beyond = np.clip((GRID.centres[:, 1] + 10.0 - 104.5) / 20.0, 0.0, 1.0) - (320 - 105) / 320
    assert_allclose(got[:, 0, 0], -beyond, atol=2e-5)
    assert_allclose(got[:, 1, 1], -beyond, atol=2e-5)
    assert_allclose(got[:, 0, 1], 0.0, atol=1e-5)


def test_a_partner_that_sees_nothing_has_no_sensitivity():
    cameras = strip_cameras(AHEAD)
    assert not sensitivities_of_all(cameras, GRID, np.zeros(len(GRID.centres), bool), []).any()


def test_a_window_over_the_border_has_the_mean_of_what_lies_inside():
    profile = np.array([3.0, 3.0, 3.0, 3.0, 9.0])
    # the first covers the left half of column 0, the last the half of column 3 and all of column 4
    columns = np.array([-2.0, 0.0, 1.0, 5.0])
    assert_allclose(_averaged(profile, columns, 4.0), [3.0, 3.0, 3.0, (0.5 * 3.0 + 9.0) / 1.5])


def test_poses_of_a_long_image_are_found_once_for_all_stretches_of_its_rows(monkeypatch):
    found = []

    def counted(cls, first, t, *others):
        found.append(len(t))
        return made(first, t, *others)

    monkeypatch.setattr(predict, "KEPT_LINES", 0)  # every image is long
    made = PoseTable.of
    monkeypatch.setattr(PoseTable, "of", classmethod(counted))
    statics = band_statics(given_bands(["first", "second"], [0.0, 1.0], [0.0, 0.0]))
    seen = GRID.centres[:, 0] + 200 < 590
    counts, values = [], []
    for rows in (1000, 3):
        monkeypatch.setattr("sightline.motion.measure.sampled_sensitivities.AT_ONCE", rows)
        found.clear()
        values.append(sensitivities_of_all(strip_cameras(AHEAD), GRID, seen, statics)[seen])
        counts.append(len(found))
    # two cameras, each turned about three axes either way, and one of each parameter's two sides
    assert counts[0] == counts[1] <= 2 * 7 + 4 * len(statics)
    assert np.array_equal(*values)
