"""A strip of one band from control points alone, whose places no camera of the package has computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline import Band, Plane, recover_line_of_sight
from sightline.errors import EstimationError, InputError
from sightline.motion.sensors import ControlSightings
from sightline.motion.strip import control_only, fusion
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case

LINES, COLUMNS, POINTS, SIGMA_PX = 600, 400, 70, 0.05
OFF = np.array([30.0, -20.0, 3.0])  # px; constant, of yaw at the edge
#: Lines of the window that every place is the mean of.
WINDOW = 6


@pytest.fixture(scope="module")
def band():
    """The first band of a level flight, no offset unknown; its pixels are never read."""
    scenario = line_of_sight_case("nominal", 1, lines=LINES, columns=COLUMNS, offset_sigma_px=0.0)
    camera = scenario.nominal_cameras[0]
    return Band("PAN", _Unread(), camera, offset_sigma_px=0.0, rotation_sigma=0.0), scenario.options


class _Unread:
    shape = (LINES, COLUMNS)

    def read(self, lines, columns):
        raise AssertionError("no pixel is needed")

    def mask(self, lines, columns):
        return None


def motion(rng, lines):
    """px (len(lines), 3): a bend, and waves of 25 to 120 lines in all angles."""
    u, out = lines / LINES - 0.5, np.zeros((len(lines), 3))
    for axis in range(3):
        out[:, axis] = OFF[axis] + 2.0 * rng.normal() * u + 4.0 * rng.normal() * u**2
        for length in np.geomspace(25.0, 120.0, 12):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            out[:, axis] += 0.1 * rng.normal() * np.sin(2.0 * np.pi * lines / length + phase)
    return out


def sighted(options, px, seed):
    """Control points of a motion `px` (LINES, 3) on the plane z = 0, seen with noise in a window's lines."""
    rng = np.random.default_rng([seed, 1])
    line = np.sort(rng.uniform(WINDOW, LINES - WINDOW, POINTS))
    column = rng.uniform(20, COLUMNS - 20, POINTS)
    # the mean over the window's lines
    offsets, every = np.arange(WINDOW) - 0.5 * (WINDOW - 1), np.arange(LINES)
    at = np.mean([[np.interp(line + o, every, px[:, k]) for k in range(3)] for o in offsets], axis=0)
    angles = at.T * [options.ifov, options.ifov, 2.0 / (COLUMNS - 1)]
    left = (column - 0.5 * (COLUMNS - 1)) * options.ifov
    # body axes: forward, right, down
    d = Rotation.from_rotvec(angles).apply(np.stack([np.zeros(POINTS), -left, np.ones(POINTS)], axis=1)).T
    y = options.ground_speed * line * options.line_period + options.altitude * d[0] / d[2]
    ground = np.stack([options.altitude * d[1] / d[2], y, np.zeros(POINTS)], axis=1)
    seen = np.stack([line, column], axis=1) + SIGMA_PX * rng.normal(size=(POINTS, 2))
    return ControlSightings(
        ground, np.full(POINTS, 1e-3), np.zeros(POINTS, dtype=np.intp), seen, SIGMA_PX,
        np.full(POINTS, float(WINDOW)),
    )  # fmt: skip


def test_the_absolute_attitude_of_every_line_lies_within_its_sigma(band):
    given, options = band
    squares, worst = [], 0.0
    for seed in range(3):
        px = motion(np.random.default_rng(seed), np.arange(float(LINES)))
        found = recover_line_of_sight([given], Plane(0.0), control_points=sighted(options, px, seed))
        error = found.motion.angles / found.scale - px
        squares.append((error * found.scale / found.absolute_sigma) ** 2)
        worst = max(worst, float(np.sqrt((error[:, :2] ** 2).mean(axis=0)).max()))
        assert found.hidden.shape[2] == 3 and found.control.kept.all()
    # 3 strips of 3 angles, each worth the 25 or more waves that its 70 control points tell apart: 1 +- 0.1 by
    # chance; the sizes of drift and jitter are known to a tenth or so beside it, which counts twice
    assert 0.6 < np.mean(squares) < 1.4
    # the waves are 0.24 px rms beside 3 px of bend; control points stand closer than most of them are long
    assert worst < 0.24


def test_a_control_point_that_is_wrong_is_found_by_the_others(band):
    given, options = band
    px = motion(np.random.default_rng(0), np.arange(float(LINES)))
    points = sighted(options, px, 0)
    pixels = points.pixels.copy()
    pixels[30] += [6.0, -9.0]
    found = recover_line_of_sight([given], Plane(0.0), control_points=replace(points, pixels=pixels))
    assert not found.control.kept[30] and found.control.kept.sum() == POINTS - 1
    assert "1 of 70 control points are contradicted" in " ".join(found.warnings)
    error = found.motion.angles / found.scale - px
    assert np.sqrt((error[:, :2] ** 2).mean(axis=0)).max() < 0.24


def test_windows_beyond_the_image_take_no_part(band):
    given, options = band
    points = sighted(options, np.zeros((LINES, 3)), 0)
    away = np.array([5000.0, 0.0])
    some = points.pixels + away * (np.arange(POINTS) % 2)[:, None]
    found = recover_line_of_sight([given], Plane(0.0), control_points=replace(points, pixels=some))
    assert len(found.control.kept) == POINTS // 2
    assert f"{POINTS // 2} of {POINTS} control points lie beyond the image" in " ".join(found.warnings)
    every = replace(points, pixels=points.pixels + away)
    with pytest.raises(EstimationError, match=f"0 of {POINTS} control points are seen"):
        recover_line_of_sight([given], Plane(0.0), control_points=every)
    y = 300.0 * options.ground_speed * options.line_period
    line = replace(
        points,
        pixels=np.column_stack([np.full(POINTS, 300.0), points.pixels[:, 1]]),
        position=points.position * [1.0, 0.0, 1.0] + np.array([0.0, y, 0.0]),
    )
    with pytest.raises(EstimationError, match="on one line, which shows no motion"):
        recover_line_of_sight([given], Plane(0.0), control_points=line)


def test_what_one_band_cannot_give_is_refused(band):
    given, options = band
    points = sighted(options, np.zeros((LINES, 3)), 0)
    few = slice(0, 5)
    short = replace(
        points, position=points.position[few], sigma=points.sigma[few], image=points.image[few],
        pixels=points.pixels[few], lines=points.lines[few],
    )  # fmt: skip
    with pytest.raises(InputError, match="`sightline tie` finds"):
        recover_line_of_sight([given], Plane(0.0))
    with pytest.raises(InputError, match="leave --method out"):
        recover_line_of_sight(
            [given], Plane(0.0), control_points=points, options=RecoverOptions(method="wiener")
        )
    with pytest.raises(EstimationError, match=r"5 of 5 control points .* 8 or more"):
        recover_line_of_sight([given], Plane(0.0), control_points=short)


@pytest.mark.parametrize("most", [200, 60])
def test_many_that_are_wrong_neither_pass_for_jitter_nor_hide_each_other(band, monkeypatch, most):
    # of 60 points a spectrum is learned; the others have weights too
    monkeypatch.setattr(control_only, "MOST_POINTS", most)
    given, options = band
    px = motion(np.random.default_rng(1), np.arange(float(LINES)))
    points = sighted(options, px, 1)
    pixels, wrong = points.pixels.copy(), np.arange(3, POINTS, 10)
    pixels[wrong] += 10.0 * np.random.default_rng(2).choice([-1.0, 1.0], (len(wrong), 2))
    found = recover_line_of_sight([given], Plane(0.0), control_points=replace(points, pixels=pixels))
    at = np.argmin(np.abs(np.subtract.outer(found.control.t, pixels[:, 0] * options.line_period)), axis=1)
    assert not found.control.kept[np.isin(at, wrong)].any()
    assert found.control.kept[~np.isin(at, wrong)].mean() > 0.95
    error = found.motion.angles / found.scale - px
    assert np.sqrt((error[:, :2] ** 2).mean(axis=0)).max() < 0.3


@pytest.mark.parametrize("columns", range(2, 9))
def test_some_of_many_points_lie_in_all_columns_everywhere(columns):
    # rows of a grid, as a reference gives them: a hundred of a hundred rows
    chosen = control_only._evenly(100 * columns, 100)
    assert len(np.unique(chosen)) == 100 and chosen[-1] < 100 * columns
    for fifth in np.array_split(chosen, 5):
        assert set(fifth % columns) == set(range(columns))


def test_a_window_s_mean_is_that_of_two_of_its_instants(band):
    given, _ = band
    lines = np.array([1.0, 2.0, 6.0, 41.0])
    seen = np.column_stack([np.full(4, 300.0), np.full(4, 10.0)])
    t = fusion._window_instants(given.camera, seen, lines) / given.camera.times(np.array([1.0]))
    for count, instants in zip(lines, t, strict=True):
        every = 300.0 + np.arange(count) - 0.5 * (count - 1.0)
        for power in (1, 2, 3):
            np.testing.assert_allclose((instants**power).mean(), (every**power).mean(), rtol=1e-9)


def test_columns_counted_from_the_other_side_are_warned_of(band):
    given, options = band
    points = sighted(options, np.zeros((LINES, 3)), 0)
    assert "passes for jitter" not in " ".join(
        recover_line_of_sight([given], Plane(0.0), control_points=points).warnings
    )
    pixels = points.pixels * [1.0, -1.0] + [0.0, COLUMNS - 1.0]
    found = recover_line_of_sight([given], Plane(0.0), control_points=replace(points, pixels=pixels))
    assert "columns counted from the other side" in " ".join(found.warnings)
