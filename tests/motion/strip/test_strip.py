"""The strip that is estimated: which lines its motion is given at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motion.strips import IFOV, PERIOD, plain_star, strip_cameras
from sightline.applications.expected_cost import strip_cost
from sightline.errors import InputError
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.strip.strip import RecoverOptions, finer_rows, prepared, suited

SHAPE = (401, 220)
# a sixth of the columns is less than the least width
WIDTH = 48


@pytest.mark.parametrize(
    ("starts", "first", "last"),
    [
        ((0.0, 0.0), 0, 400),
        # exposed 30.5 lines later, and 12 earlier
        ((0.0, 30.5), 0, 431),
        ((0.0, -12.0), -12, 400),
        # times as tables tell them, to a nanosecond
        ((0.0, 20.0 + 1e-9 / PERIOD), 0, 420),
    ],
)
def test_the_motion_is_given_from_the_first_exposure_of_any_band_to_the_last(starts, first, last):
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))
    cameras = [
        replace(camera, first_line_time=camera.first_line_time + start * PERIOD)
        for camera, start in zip(strip_cameras((30.0, 0.0), *SHAPE), starts, strict=True)
    ]
    bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(cameras)]
    lines = prepared(bands, Plane(), RecoverOptions()).lines()
    assert (lines[0], lines[-1]) == (first, last) and (np.diff(lines) == 1).all()


@pytest.mark.parametrize(
    ("lag", "step", "window", "grid_lines"),
    [(83.0, 4, 4, 2.0), (7.3, 4, 4, 2.0), (6.0, 3, 3, 1.5), (3.7, 2, 2, 1.0), (1.0, 1, 2, 0.5)],
)
def test_rows_follow_a_short_lag(lag, step, window, grid_lines):
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))
    cameras = strip_cameras((0.0, -lag), *SHAPE)
    bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(cameras)]
    found = suited(RecoverOptions(), bands, Plane())
    assert (found.step, found.window, found.grid_lines) == (step, (window, WIDTH), grid_lines)
    # what was asked for stays; windows that were not are as narrow as the bands ask for all the same
    asked = RecoverOptions(asked=("window",))
    assert suited(asked, bands, Plane()) is asked
    usual = RecoverOptions()
    for asked in (RecoverOptions(step=3), RecoverOptions(asked=("step",))):
        kept = suited(asked, bands, Plane())
        assert (kept.step, kept.grid_lines) == (asked.step, usual.grid_lines)
        assert kept.window == (usual.window[0], WIDTH) and kept.first_window == (usual.first_window[0], WIDTH)
    first = suited(RecoverOptions(asked=("first_window",)), bands, Plane())
    assert first.first_window == (10, 100) and first.window == found.window


@pytest.mark.parametrize(
    ("period", "lag", "step", "grid_lines"),
    # at most 3.2 ms apart, nodes as near as 300 of them in the longest lag; slower lines show no 150 Hz
    [
        (0.7e-3, 80.0, 4, 2.0),
        (1.5e-3, 80.0, 2, 1.0),
        (1.5e-3, 450.0, 2, 1.5),
        (2.5e-3, 80.0, 1, 0.5),
        (4e-3, 80.0, 4, 2.0),
    ],
)
def test_rows_of_long_lines_are_near_enough_for_vibrations(period, lag, step, grid_lines):
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))
    cameras = [
        replace(camera, detector=replace(camera.detector, line_period=period))
        for camera in late_cameras(0.0, lag * period / PERIOD)
    ]
    bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(cameras)]
    found = suited(RecoverOptions(), bands, Plane())
    assert (found.step, found.window) == (step, (4, WIDTH))
    assert found.grid_lines == pytest.approx(grid_lines, rel=0.05)


@pytest.mark.parametrize(("columns", "width"), [(1000, 100), (400, 100), (399, 66), (300, 50), (150, 48)])
def test_rows_of_narrow_bands_hold_six_windows_where_these_are_wide_enough(columns, width):
    image = ArrayImage(np.zeros((401, columns)))
    cameras = strip_cameras((0.0, -83.0), 401, columns)
    bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(cameras)]
    found = suited(RecoverOptions(), bands, Plane())
    assert found.window == (4, width) and found.first_window == (10, width)
    asked = RecoverOptions(first_window=(12, 90))
    assert suited(asked, bands, Plane()).first_window == (12, 90)


def late_cameras(*lags):
    """Cameras whose lines show the same ground so many lines later."""
    return [
        replace(camera, first_line_time=camera.first_line_time + lag * PERIOD)
        for camera, lag in zip(strip_cameras([-lag for lag in lags], *SHAPE), lags, strict=True)
    ]


@pytest.mark.parametrize(
    ("lag", "wide", "expected"),
    [
        # 1920 lines are 960 nodes two lines apart: 300 of them are 3.2 times as far, if lines are as long
        (1920.0, 4.0, 6.4), (1920.0, 2.0, 4.0), (1920.0, 1.0, 2.0), (500.0, 4.0, 2.0),
    ],
)  # fmt: skip
def test_nodes_are_farther_apart_where_a_long_lag_meets_long_lines(lag, wide, expected):
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))
    cameras = late_cameras(0.0, 0.8 * lag, lag)
    if wide > 1.0:
        cameras = [cameras[0]] + [
            replace(camera, detector=replace(camera.detector, line_period=PERIOD * wide))
            for camera in cameras[1:]
        ]
    bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(cameras)]
    assert suited(RecoverOptions(), bands, Plane()).grid_lines == pytest.approx(expected, rel=0.02)
    # a node that is asked for stays
    kept = suited(RecoverOptions(grid_lines=2.5), bands, Plane())
    assert (kept.grid_lines, kept.step) == (2.5, RecoverOptions().step)


def test_a_long_lag_costs_its_square():
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))

    def seconds(lag):
        bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(late_cameras(0.0, lag))]
        return strip_cost(bands, RecoverOptions(), Plane()).seconds

    short, long, longer = (seconds(lag) for lag in (50.0, 1500.0, 3000.0))
    # squares of 1500 and 3000, of 1901 and 3401 lines from the first exposure to the last
    assert (longer - short) / (long - short) == pytest.approx(4.0 * 3401 / 1901, rel=0.02)


def test_lines_of_a_coarse_image_cost_as_many_fine_ones_as_they_last():
    image = ArrayImage(np.random.default_rng(0).standard_normal(SHAPE))
    cameras = late_cameras(0.0, 50.0)

    def seconds(*wide):
        unlike = [
            replace(camera, detector=replace(camera.detector, line_period=PERIOD * times))
            for camera, times in zip(cameras, wide, strict=True)
        ]
        bands = [Band(f"band {k}", image, camera) for k, camera in enumerate(unlike)]
        return strip_cost(bands, RecoverOptions()).seconds

    # less the start alone, which is alike: 12 s
    assert seconds(1.0, 4.0) - 12.0 == pytest.approx(4.0 * (seconds(1.0, 1.0) - 12.0), rel=1e-9)
    assert seconds(4.0, 4.0) == pytest.approx(seconds(1.0, 1.0))


@pytest.mark.parametrize(
    ("ifov", "period", "what"),
    [
        (7.0, 1.0, r"pixel \(ifov\) of 'coarse' is 7 times that of 'fine'"),
        (1.0, 6.5, "line period of 'coarse'"),
    ],
    ids=["pixels", "lines"],
)
def test_pixels_more_unlike_than_six_to_one_are_refused_by_name(ifov, period, what):
    rng = np.random.default_rng(0)
    fine, other = strip_cameras((30.0, 0.0), *SHAPE)
    columns, lines = max(int(SHAPE[1] / ifov), 16), int(SHAPE[0] / period)
    detector = LineDetector.from_ifov("coarse", columns, ifov * IFOV, period * PERIOD)
    coarse = replace(other, detector=detector, lines=lines)
    bands = [
        Band("fine", ArrayImage(rng.standard_normal(SHAPE)), fine),
        Band("coarse", ArrayImage(rng.standard_normal((lines, columns))), coarse),
    ]
    with pytest.raises(InputError, match=what):
        prepared(bands, Plane(), RecoverOptions())


def wide_bands(columns=1000, periods=(PERIOD, PERIOD), stages=None):
    """Two bands that are not read, whose lines are so wide and so long."""
    image = ArrayImage(np.zeros((40, columns)))
    return [
        Band(
            f"band {k}", image, replace(camera, detector=replace(camera.detector, line_period=period), **tdi)
        )
        for k, (camera, period, tdi) in enumerate(
            zip(strip_cameras((0.0, -83.0), 40, columns), periods, ({}, stages or {}), strict=True)
        )
    ]


@pytest.mark.parametrize(("period", "lines"), [(0.7e-3, 2), (0.5e-3, 2), (0.35e-3, 3), (0.25e-3, 4)])
def test_windows_of_wide_bands_whose_matches_are_good_span_a_millisecond(period, lines):
    options, star = RecoverOptions(), plain_star(20, 10, 1, sigma=0.049)
    found = finer_rows(options, wide_bands(periods=(period, period)), [star])
    assert (found.window, found.step) == ((lines, 100), lines)
    assert found.grid_lines == options.grid_lines


@pytest.mark.parametrize(
    ("bands", "options", "sigma"),
    [
        ({}, {}, 0.051),
        ({"columns": 999}, {}, 0.01),
        ({"periods": (PERIOD, 4 * PERIOD)}, {}, 0.01),
        ({"stages": {"stages": 16}}, {}, 0.01),
        ({}, {"asked": ("window",)}, 0.01),
        ({}, {"step": 5}, 0.01),
        ({}, {"grid_lines": 1.0}, 0.01),
        # so many windows however near rows are: lower ones would see less of the ground
        ({}, {"selection": Selection("spread")}, 0.01),
        ({}, {"selection": Selection("listed", features={0: np.zeros((1, 2))})}, 0.01),
    ],
)
def test_other_windows_stay_as_they_are(bands, options, sigma):
    asked = RecoverOptions(**options)
    assert finer_rows(asked, wide_bands(**bands), [plain_star(20, 10, 1, sigma=sigma)]) is asked


@pytest.mark.parametrize(("blocks", "finer"), [(4, False), (5, True)])
def test_wide_bands_that_share_little_of_their_width_keep_usual_windows(blocks, finer):
    options = RecoverOptions()
    found = finer_rows(options, wide_bands(), [plain_star(20, blocks, 1, sigma=0.01)])
    assert (found is not options) == finer


def test_without_a_match_nothing_is_known_of_windows():
    star = plain_star(20, 10, 1, sigma=0.01)
    gone = star.with_weight(np.zeros_like(star.weight))
    options = RecoverOptions()
    assert (
        finer_rows(options, wide_bands(), [gone]) is options
        and finer_rows(options, wide_bands(), []) is options
    )
