"""The camera of a band as the choice of TDI stages takes it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band
from sightline.simulate.scenarios import line_of_sight_case
from sightline.tdi.scan_columns import band_camera, column_geometry, strip_span


@pytest.fixture(scope="module")
def bands():
    return line_of_sight_case("nominal", 0, lines=64, columns=64).as_given()


def test_statics_move_the_band_they_name_and_no_other(bands):
    """A row found turned by 0.01 rad slips by -0.01; its motion is left out."""
    shaken = Motion([-1.0, 1.0], [[0.0, 0.0, 0.3], [0.0, 0.0, 0.3]])
    moving = [
        Band(b.name, b.image, b.camera.with_trajectory(b.camera.trajectory.with_motion(shaken)),
             b.offset_sigma_px, b.rotation_sigma)
        for b in bands
    ]  # fmt: skip
    statics = {"B1 rotation": 0.01, "PAN rotation": -0.5}
    found = column_geometry(band_camera(moving, "B1", statics), Plane(0.0), [32])
    assert found.slip[0] == pytest.approx(-0.01, abs=1e-5)
    assert column_geometry(band_camera(moving, "B0", statics), Plane(0.0), [32]).slip[0] == pytest.approx(
        0.0, abs=1e-5
    )
    nominal = band_camera(bands, "B1")
    assert_allclose(nominal.detector.tangents, bands[1].camera.detector.tangents)


def test_the_strip_is_from_its_first_line_to_its_last(bands):
    assert strip_span(band_camera(bands, "PAN")) == pytest.approx((0.0, 63 * 5e-4))
    assert np.isfinite(strip_span(bands[2].camera)).all()


def test_a_band_that_is_not_there_and_frames_are_refused(bands):
    with pytest.raises(InputError, match="no band is called 'NIR': the bands are PAN, B1, B0, B2"):
        band_camera(bands, "NIR")
    with pytest.raises(InputError, match="needs a push-broom detector"):
        band_camera([], "PAN")
