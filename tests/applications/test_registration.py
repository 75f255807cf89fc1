"""Bands laid on one by what was recovered: against the true map of a rendered strip with relief."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.registration import fit_pairs, recovered_cameras, register_bands
from sightline.errors import InputError
from sightline.geometry.surface import Dem, Plane
from sightline.motion.measure.predict import predict_match
from sightline.simulate.scenarios import line_of_sight_case


@pytest.fixture(scope="module")
def strip():
    """A strip over relief, its bands as a user knows them, its DEM and the true statics."""
    scenario = line_of_sight_case("relief", 4, lines=600, columns=160)
    bands = scenario.as_told()
    relief = scenario.scene.relief
    statics = {}
    for band in scenario.bands:
        statics[f"{band.name} offset along"], statics[f"{band.name} offset across"] = band.offset_px
        statics[f"{band.name} rotation"] = band.rotation
    return scenario, bands, Dem(relief.heights, relief.transform), statics


def misfit(registration, pair):
    fits = {fit.images: fit for fit in fit_pairs(registration)}
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
    assert misfit(found.after, (2, 3))[0] < 1.3 * misfit(found.after, (2, 3))[1]


def test_a_band_that_is_not_there_is_refused_by_name(strip):
    scenario, bands, dem, _ = strip
    with pytest.raises(InputError, match=r"'NIR'.* PAN, B1, B0, B2"):
        register_bands(bands, dem, scenario.motion, onto="NIR")
