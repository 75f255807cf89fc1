"""Shapes of detector lines: a bent one, CCDs in steps, and straight ones that must not pass for such."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import plain_star
from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import EstimationError
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import KEPT
from sightline.motion.band import Band
from sightline.motion.measure.stars import StarRecord
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.shape import line_departures
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case

OPTIONS = RecoverOptions(window=(8, 30), first_window=(16, 60), step=8, passes=2)


def record(rows: int = 200, blocks: int = 10) -> StarRecord:
    """Windows 80 columns apart and wide, all matched."""
    star = replace(plain_star(rows, blocks, 1), window=(4, 80))
    return StarRecord(star, np.full((rows * blocks, 1), KEPT, np.uint8), np.ones((rows * blocks, 1)))


def left(seed: int, rows: int = 200, blocks: int = 10) -> np.ndarray:
    """Residuals of 0.1 px, and a motion of its own in every row, which is none of the shape."""
    rng = np.random.default_rng(seed)
    rough = rng.standard_normal((rows, 2, 2)) @ np.array([[1.0, 0.0], [0.3, 1.0]])
    u = np.linspace(-0.9, 0.9, blocks)[None, :, None]
    values = rough[:, :1] + rough[:, 1:] * u + 0.1 * rng.standard_normal((rows, blocks, 2))
    return values.reshape(rows * blocks, 1, 2)


def test_straight_lines_depart_as_often_as_the_chance_says():
    chances = np.array([line_departures([record()], [left(seed)])[0, 1].chance for seed in range(150)])
    # of the least of two tests: twice that of one, less their product. 150 strips: sd 0.024, four of them
    assert abs((chances < 0.1).mean() - (1.0 - 0.95**2)) < 0.1
    assert chances.min() > 1e-4 / 150 * 2


@pytest.mark.parametrize("bad", [0, 100])
def test_steps_are_found_where_they_are_whatever_rows_do_and_some_windows_say(bad):
    star, values = record(), left(1)
    # 0.2 px from column 370 on, across: a window of columns 320 to 399 has 30 of its 80 beyond
    share = np.clip((star.star.pixels[:, 1] + 40.0 - 369.5) / 80.0, 0.0, 1.0)
    values[:, 0, 1] += 0.2 * share
    values[np.random.default_rng(2).choice(len(values), bad, replace=False)] += 5.0
    found = line_departures([star], [values])[0, 1]
    # 0.036 px rms of 10 columns known to 0.007 px: F of 8 and 42 is about 27; half as much has 1e-8
    assert found.chance < 1e-8
    # the step is known to 0.1 / sqrt(200) / 0.2 of a window
    assert len(found.borders) == 1 and abs(found.borders[0] - 370) < 4 * 80 * 0.035


def test_a_bend_is_told_from_steps():
    star, values = record(), left(3)
    u = star.star.field
    values[:, 0, 0] += 0.1 * (1.5 * u**2 - 0.5) + 0.1 * (2.5 * u**3 - 1.5 * u)
    found = line_departures([star], [values])[0, 1]
    assert found.chance < 1e-8 and found.borders == ()
    assert found.size_px > 0.02


def test_too_few_windows_say_nothing():
    assert line_departures([record(rows=5)], [left(0, rows=5)]) == {}
    assert line_departures([record(blocks=2)], [left(0, blocks=2)]) == {}


def strip(**keys):
    """Two bands whose shapes differ by some 0.1 px rms."""
    return line_of_sight_case(
        "nominal", 1, lines=400, columns=320, names=("A", "B"), lags=(0.0, 0.02), gains=(1.0, 0.9),
        gammas=(1.0, 1.0), rotation_sigma=1e-4, scale_sigma=1e-4, **keys,
    )  # fmt: skip


def given(scene, shape) -> list[Band]:
    return [replace(band, shape=shape, pieces=()) for band in scene.as_given()]


def beyond_line(px: np.ndarray) -> np.ndarray:
    a = np.stack([np.ones(len(px)), np.linspace(-1.0, 1.0, len(px))], axis=1)
    return px - a @ np.linalg.lstsq(a, px, rcond=None)[0]


def wrong_px(scene, found) -> np.ndarray:
    """(2,) px rms by which recovered cameras miss the departure of B from A, off the steps."""
    bands = given(scene, None)
    motion = Motion.zero(*bands[0].camera.trajectory.span)
    bent = recovered_cameras(bands, motion, {s.name: s.value for s in found.statics})[1].detector
    plain = bands[1].camera.detector
    departure = beyond_line((bent.tangents - plain.tangents)[:, ::-1] / plain.pixel_step)
    wrong = departure - beyond_line(scene.bands[1].departure_px - scene.bands[0].departure_px)
    for column in scene.options.pieces:
        wrong[column - 5 : column + 5] = 0.0
    return np.sqrt((wrong**2).mean(axis=0))


# sigmas of bends and steps are 0.004 to 0.01 px each; a bend of 0.1 px over half the field changes by
# 0.005 px where the bands are some px apart
GOOD_PX = 0.03


@pytest.mark.parametrize(
    "keys", [{"bend_sigma_px": 0.1}, {"pieces": (110, 220), "piece_sigma_px": 0.15}], ids=str
)
def test_a_shape_that_was_not_given_is_found_and_said(keys):
    scene = strip(**keys)
    # windows of the usual width, three of them side by side, would not tell bends from a stretch
    options = OPTIONS if scene.options.pieces else RecoverOptions(step=8, passes=2)
    found = recover_line_of_sight(given(scene, None), Plane(), options=options)
    said = [words for words in found.warnings if "B departs from a straight line" in words]
    assert len(said) == 1
    if scene.options.pieces:
        columns = [
            int(word) for word in re.search(r'shape = "pieces", pieces = \[(.*?)\]', said[0])[1].split(",")
        ]
        assert_allclose(columns, scene.options.pieces, atol=5)
    else:
        assert 'shape = "polynomial"' in said[0]
    assert (wrong_px(scene, found) < GOOD_PX).all()


@pytest.mark.parametrize("columns", [(110, 220), ()], ids=["given", "sought"])
def test_steps_between_ccds_are_found(columns):
    scene = strip(pieces=(110, 220), piece_sigma_px=0.15)
    bands = [replace(band, pieces=columns) for band in scene.as_given()]
    found = recover_line_of_sight(bands, Plane(), options=OPTIONS)
    steps = [s for s in found.statics if s.name.startswith("B step ")]
    assert len(steps) == 4 and {s.prior_sigma for s in steps} == {0.15}
    assert (wrong_px(scene, found) < GOOD_PX).all()
    assert not any("departs from" in words for words in found.warnings) or not columns


def test_a_band_that_is_given_as_a_line_stays_one_and_what_is_wrong_is_said():
    scene = strip(bend_sigma_px=0.1)
    with pytest.raises(EstimationError) as problem:
        recover_line_of_sight(given(scene, "line"), Plane(), options=OPTIONS)
    assert "no windows of a row agree with each other: B departs from its shape" in str(problem.value)
    assert 'may say shape = "polynomial"' in str(problem.value)


def test_straight_lines_stay_lines():
    scene = strip()
    runs = [recover_line_of_sight(given(scene, shape), Plane(), options=OPTIONS) for shape in (None, "line")]
    np.testing.assert_array_equal(runs[0].motion.angles, runs[1].motion.angles)
    assert [s.name for s in runs[0].statics] == [s.name for s in runs[1].statics]
    assert not any("departs from" in words for words in runs[0].warnings)
