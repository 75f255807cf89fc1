"""Bands laid on one by what was recovered: against the true map of a rendered strip with relief."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.registration import fit_every_pair, register_bands
from sightline.errors import InputError
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Dem, Plane
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.relief import RowRelief
from sightline.simulate.scenarios import line_of_sight_case


@pytest.fixture(scope="module")
def strip():
    """A strip over relief, its bands as a user knows them, its DEM and the true statics."""
    scenario = line_of_sight_case("relief", 4, lines=600, columns=160)
    bands = scenario.as_given()
    relief = scenario.scene.relief
    statics = {}
    for band in scenario.bands:
        statics[f"{band.name} offset along"], statics[f"{band.name} offset across"] = band.offset_px
        statics[f"{band.name} rotation"] = band.rotation
    return scenario, bands, Dem(relief.heights, relief.transform), statics


def misfit(registration, pair):
    fits = {fit.images: fit for fit in fit_every_pair(registration)}
    return float(np.hypot(*fits[pair].rms_px)), float(np.hypot(*fits[pair].noise_px))


def test_cameras_carry_motion_and_statics(strip):
    scenario, bands, dem, statics = strip
    cameras = recovered_cameras(bands, scenario.motion, {**statics, "star tracker alignment": 3.0})
    points = np.array([[20.0, 10.0], [100.0, 150.0]])
    for k in range(1, 4):
        np.testing.assert_allclose(
            predict_match(cameras[0], cameras[k], dem, points),
            predict_match(scenario.cameras[0], scenario.cameras[k], dem, points),
            atol=1e-6,
        )


def test_the_true_motion_leaves_only_noise_of_matches(strip):
    scenario, bands, dem, statics = strip
    found = register_bands(bands, dem, scenario.motion, statics)
    after, noise = misfit(found.after, (0, 3))
    # some 40 windows: the rms of their noise scatters by a tenth; three of these
    assert after < 1.3 * noise < 0.1


def test_the_dem_takes_parallax_out(strip):
    """300 m of relief seen 0.1722 s apart is 0.15 line of parallax, ten times what matches are good to."""
    scenario, bands, dem, statics = strip
    flat = register_bands(bands, Plane(float(np.mean(dem.heights))), scenario.motion, statics)
    after, noise = misfit(flat.after, (0, 3))
    assert after > 2.0 * noise


def test_another_band_may_be_the_reference(strip):
    scenario, bands, dem, statics = strip
    found = register_bands(bands, dem, scenario.motion, statics, onto="B0")
    assert found.reference == 2
    assert found.after[2] is bands[2].image
    after, noise = misfit(found.after, (2, 3))
    assert after < 1.3 * noise


def test_ground_that_was_found_is_as_good_as_one_that_was_given(strip):
    scenario, bands, _, statics = strip
    t = scenario.cameras[0].times(np.array([0.0, 599.0]))
    # 150 m all over, over a ground given 150 m too low: the same rays meet the same places
    relief = RowRelief(0, t, np.array([[150.0, 0.0], [150.0, 0.0]]), np.ones((2, 2)))
    given = register_bands(bands, Plane(150.0), scenario.motion, statics)
    found = register_bands(bands, Plane(), scenario.motion, statics, relief=relief)
    places = np.arange(100.0, 500.0, 50.0), np.arange(10.0, 150.0, 20.0)
    for k in (1, 3):
        np.testing.assert_allclose(
            found.after[k].mapping(*places), given.after[k].mapping(*places), atol=1e-6
        )


def test_a_slope_that_was_found_raises_one_side(strip):
    scenario, bands, _, statics = strip
    t = scenario.cameras[0].times(np.array([0.0, 599.0]))
    relief = RowRelief(0, t, np.array([[0.0, 0.0], [200.0, 100.0]]), np.ones((2, 2)))
    found = register_bands(bands, Plane(), scenario.motion, statics, relief=relief)
    # line 299.5 is in the middle of the rows: 100 m, and 50 m more at the last column
    lines, ends = np.array([299.5]), np.array([0.0, 79.5, 159.0])
    for column, height in zip(ends, (50.0, 100.0, 150.0), strict=True):
        given = register_bands(bands, Plane(height), scenario.motion, statics)
        # the ground is met by a ray of the given surface, 1 px beside for 100 m: a third of a metre of slope
        np.testing.assert_allclose(
            found.after[3].mapping(lines, np.array([column])),
            given.after[3].mapping(lines, np.array([column])),
            atol=2e-4,
        )


def test_a_band_that_is_not_there_is_refused_by_name(strip):
    scenario, bands, dem, _ = strip
    with pytest.raises(InputError, match=r"'NIR'.* PAN, B1, B0, B2"):
        register_bands(bands, dem, scenario.motion, onto="NIR")
