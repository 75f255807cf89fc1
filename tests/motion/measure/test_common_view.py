"""Where two detectors look at the same ground, and what is matched there."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Trajectory
from sightline.motion.measure.common_view import EDGE, LEAST_COLUMNS, common_views, partners_of, usable
from sightline.motion.measure.plan import LEAST_WIDTH, MatchingPlan, hub_windows, mixed_stages, within_stages
from sightline.motion.strip.viewing_axes import viewing_axes

PERIOD, IFOV, LINES = 5e-4, 5e-6, 400


def camera(columns=500, aside=0.0, behind=0.0, pointing=None, fineness=1.0):
    """A line of the focal plane, 680 km over a plane at 6800 m/s: one pixel per line."""
    look_ahead = -float(np.arctan(behind * IFOV))
    detector = LineDetector.from_ifov("x", columns, IFOV * fineness, PERIOD, look_ahead, (0.0, aside))
    flight = Trajectory.level_flight(680e3, 6800.0, -1.0, 1.0)
    return PushbroomCamera(detector, flight, pointing or FixedMount(), 0.0, LINES)


STAGGERED = (camera(aside=-226.0), camera(aside=226.0, behind=100.0))


def test_staggered_detectors_share_their_ends():
    """500 + 500 columns, centres 452 apart: the last 48 of the first are the first 48 of the second."""
    views = common_views(STAGGERED, Plane())
    assert views == {(0, 1): (452, 499), (1, 0): (0, 47)}
    # what the kernel reads at the partner's edge is left out; a detector's own edge is not
    assert usable(views[0, 1], 500) == (452 + EDGE, 499)
    (only,) = partners_of(views, (0, 1), 0, 500)
    assert only.images == (1,) and only.columns == (452 + EDGE, 499)


def test_a_detector_that_sees_all_is_matched_over_its_whole_line():
    views = common_views([camera(), camera(behind=50.0)], Plane())
    (only,) = partners_of(views, (0, 1), 0, 500)
    assert only.columns is None


def test_a_small_detector_has_windows_of_its_own_beside_those_of_the_strips():
    cameras = [camera(), camera(behind=50.0), camera(columns=100, behind=80.0)]
    groups = partners_of(common_views(cameras, Plane()), (0, 1, 2), 0, 500)
    assert [group.images for group in groups] == [(1,), (2,)]
    assert groups[0].columns is None
    # its last pixel's centre lies on that of column 299, to rounding
    np.testing.assert_allclose(groups[1].columns, (200 + EDGE, 299 - EDGE), atol=1)
    hubs = hub_windows(
        cameras, Plane(), [(LINES, 500)] * 2 + [(LINES, 100)], (0, 1, 2), MatchingPlan((4, 100), 4)
    )
    grid = hubs[1][2]
    # 90 columns: four windows side by side within them
    assert grid.window == (4, 22) and len(grid.columns) == 4
    assert grid.columns.min() - 10.5 >= 205 and grid.columns.max() + 10.5 <= 294


def test_windows_of_a_narrow_view_are_no_narrower_than_can_be_trusted():
    hubs = hub_windows(STAGGERED, Plane(), [(LINES, 500)] * 2, (0, 1), MatchingPlan((4, 100), 4))
    grid = hubs[0][2]
    # 43 columns hold two windows of at least LEAST_WIDTH
    assert grid.window[1] >= LEAST_WIDTH and len(grid.columns) == 2
    first, last = grid.sides
    assert first >= 452 + EDGE and last <= 500


def test_pairs_that_are_not_asked_for_are_left_out():
    cameras = [camera(behind=50.0 * k) for k in range(3)]
    views = common_views(cameras, Plane(), [(0, 2), (2, 1)])
    assert sorted(views) == [(0, 2), (1, 2), (2, 0), (2, 1)]
    shapes = [(LINES, 500)] * 3
    hubs = hub_windows(cameras, Plane(), shapes, (0, 1, 2), MatchingPlan((4, 100), 4), views)
    whole = [(hub, partners, len(grid.lines)) for hub, partners, grid in hubs if partners[0] > hub]
    # 1 is not matched with 0: its windows cover its whole image, though 0 saw that ground first
    assert whole == [(0, (2,), 100), (1, (2,), 100)]


def test_too_few_columns_in_common_are_none():
    cameras = (camera(aside=-226.0), camera(aside=226.0 + 48 - LEAST_COLUMNS + 2, behind=100.0))
    assert common_views(cameras, Plane()) == {}


def test_images_that_look_at_nearly_the_same_columns_share_those_that_all_see():
    views = {(0, 1): (100, 300), (0, 2): (102, 303), (0, 3): (98, 297), (0, 4): (150, 300)}
    alike, other = partners_of(views, (0, 1, 2, 3, 4), 0, 500)
    assert alike.images == (1, 2, 3) and alike.columns == (102 + EDGE, 297 - EDGE)
    assert other.images == (4,) and other.columns == (150 + EDGE, 300 - EDGE)


@pytest.mark.parametrize("window", [100, 40])
def test_windows_lie_between_the_columns_at_which_stages_change(window):
    stages = np.repeat([8, 16, 64, 16], [207, 150, 30, 113])
    line = camera()
    grid = MatchingPlan((4, window), 4).grid((LINES, 500))
    found = within_stages(grid, replace(line, stages=stages))
    half = 0.5 * (found.window[1] - 1)
    first, last = found.columns - half, found.columns + half
    assert (first == np.rint(first)).all() and (first[1:] > last[:-1]).all()
    used, sides = 0, [int(side) for side in grid.sides]
    for begin, end in pairwise([sides[0], 207, 357, 387, sides[1]]):
        run = end - begin
        inside = (found.columns > begin - 0.5) & (found.columns < begin + run - 0.5)
        used += inside.sum() * found.window[1]
        # as many as fit, side by side in the middle of their run
        assert inside.sum() == run // found.window[1]
        if inside.any():
            left, right = first[inside][0] - begin, begin + run - 1 - last[inside][-1]
            assert left >= 0 and right >= 0 and abs(left - right) <= 1
    assert used > 0.8 * 500 and found.window[0] == 4 and found.lines.tolist() == grid.lines.tolist()
    assert within_stages(grid, line) is grid
    assert within_stages(grid, replace(line, stages=np.full(500, 8))) is grid


def test_windows_are_mixed_where_a_tenth_of_them_has_other_stages():
    """Stages change behind column 199: windows 100 wide, of which so many columns lie beyond it."""
    mixed = replace(camera(), stages=np.where(np.arange(500) < 200, 8, 16))
    beyond = np.array([0.0, 8.0, 12.0, 50.0, 88.0, 92.0, 100.0])
    centres = np.column_stack([np.full(7, 100.0), 199.5 - 50.0 + beyond])
    expected = [False, False, True, True, True, False, False]
    assert mixed_stages(mixed, centres, (4, 100)).tolist() == expected
    assert not mixed_stages(camera(), centres, (4, 100)).any()
    # of stages that change from line to line a window sees those of all its lines
    lines = replace(camera(), stages=np.where(np.arange(LINES) < 100, 8, 16)[:, None] * np.ones(500, int))
    rows = np.column_stack([np.array([90.0, 97.0, 103.0, 110.0]), np.full(4, 250.0)])
    assert mixed_stages(lines, rows, (10, 40)).tolist() == [False, True, True, False]


class TestViewingAxes:
    def test_a_strip_that_looks_down_keeps_its_body_axes(self):
        cameras = [camera(), camera(behind=300.0)]
        assert viewing_axes(cameras, common_views(cameras, Plane())) is None

    def test_staggered_detectors_turn_about_what_they_share(self):
        turn = viewing_axes(STAGGERED, common_views(STAGGERED, Plane()))
        # the middle of the 48 columns lies on the boresight of the focal plane, half of 100 px behind it
        assert turn is not None
        np.testing.assert_allclose(turn.apply([0, 0, 1.0]), [-50 * IFOV, 0.0, 1.0], atol=2e-8)

    def test_a_tilted_mount_turns_to_its_line_of_sight(self):
        from scipy.spatial.transform import Rotation

        from sightline.geometry.rotations import NADIR_MOUNT

        tilted = FixedMount(Rotation.from_rotvec([-0.3, 0.0, 0.0]) * NADIR_MOUNT)
        cameras = [camera(pointing=tilted), camera(behind=60.0, pointing=tilted)]
        turn = viewing_axes(cameras, common_views(cameras, Plane()))
        assert turn is not None
        np.testing.assert_allclose(turn.apply([0, 0, 1.0])[1], np.sin(0.3), atol=1e-6)


@pytest.mark.parametrize("fineness", [0.8, 1.25])
def test_pixels_of_another_size_see_the_columns_they_cover(fineness):
    views = common_views([camera(), camera(columns=100, behind=80.0, fineness=fineness)], Plane())
    first, last = views[0, 1]
    assert (last - first) == pytest.approx(99 * fineness, abs=1.5)
