"""Groups of windows whose boxes stay small."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.matching.patches import _box, group_windows

WINDOW = (4, 100)


def grid(columns: np.ndarray) -> np.ndarray:
    """Centres of windows in 500 rows 4 lines apart, (N, 2)."""
    line, column = np.meshgrid(40.0 + 4.0 * np.arange(500), columns, indexing="ij")
    return np.stack([line.ravel(), column.ravel()], axis=1)


@pytest.mark.parametrize("apart", [100.0, 600.0], ids=["side by side", "far apart"])
def test_every_window_is_in_one_group_and_none_reads_columns_between_windows_far_apart(apart):
    points = grid(300.0 + apart * np.arange(9))
    rows = np.arange(len(points))[::2]
    groups = list(group_windows(points, points, rows, WINDOW, 1_500_000))
    assert np.array_equal(np.sort(np.concatenate(groups)), rows)
    widest = max(np.ptp(points[group, 1]) for group in groups)
    if apart > 300:
        assert widest == 0
    else:
        assert widest > apart


def test_lines_between_rows_of_windows_far_apart_are_not_read():
    points = grid(300.0 + 100.0 * np.arange(12))[: 12 * 200]
    rows = np.flatnonzero(points[:, 0] % 300.0 == 40.0)
    groups = list(group_windows(points, points, rows, WINDOW, 1_500_000))
    assert np.array_equal(np.sort(np.concatenate(groups)), rows)
    assert len(groups) == 3 and all(np.ptp(points[group, 0]) == 0 for group in groups)


def test_few_windows_far_apart_stay_together():
    # two rows at nine columns: pieces of 40 x 140 px each, whose calls would cost more than what lies between
    points = grid(300.0 + 600.0 * np.arange(9))[:18]
    assert len(list(group_windows(points, points, np.arange(18), WINDOW, 1_500_000))) == 1


@pytest.mark.parametrize("turned", [False, True])
def test_the_boxes_of_groups_are_small_in_both_images(turned):
    """Pixels that a group reads, its windows with a margin, by the corners of its windows."""
    size, most = (60, 90), 60_000
    line, column = np.meshgrid(20.0 * np.arange(12), 30.0 * np.arange(15), indexing="ij")
    near = np.stack([line.ravel(), column.ravel()], axis=1)
    # the other image sees the windows at half the scale, or twice; either may be the larger
    points = (near, 0.5 * near + 7.0) if not turned else (near, 2.0 * near - 5.0)
    groups = list(group_windows(*points, np.arange(len(near)), size, most))
    assert np.array_equal(np.sort(np.concatenate(groups)), np.arange(len(near)))
    assert 3 < len(groups) < len(near)
    for group in groups:
        for p in points:
            corners = np.concatenate([p[group] - np.array(size) / 2, p[group] + np.array(size) / 2])
            assert len(group) == 1 or np.ptp(corners, axis=0).prod() < most


@pytest.mark.parametrize("size", [(4, 7), (5, 10)])
def test_a_box_holds_every_pixel_of_its_windows_and_its_margin(size):
    points = np.array([[10.2, 40.0], [13.7, 31.6], [11.0, 55.3]])
    margin = np.array([3, 5])
    pixels = [
        p + np.array([i, j]) - 0.5 * (np.array(size) - 1)
        for p in points for i in range(size[0]) for j in range(size[1])
    ]  # fmt: skip
    box = _box(points, size, margin)
    # whole pixels on either side of every place
    np.testing.assert_array_equal(box[:, 0], np.floor(np.min(pixels, axis=0)) - margin)
    np.testing.assert_array_equal(box[:, 1], np.ceil(np.max(pixels, axis=0)) + 1 + margin)
