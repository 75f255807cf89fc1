"""The strip that is estimated: which lines its motion is given at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motion.strips import IFOV, PERIOD, strip_cameras
from sightline.errors import InputError
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band
from sightline.motion.strip.strip import RecoverOptions, prepared, suited

SHAPE = (401, 220)


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
    assert (found.step, found.window, found.grid_lines) == (step, (window, 100), grid_lines)
    # what was asked for stays
    asked = RecoverOptions(step=3)
    assert suited(asked, bands, Plane()) is asked


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
