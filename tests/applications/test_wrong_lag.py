"""A lag of the wrong sign is named as such."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import EstimationError
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band
from sightline.simulate.scenarios import line_of_sight_case


def test_a_lag_of_the_wrong_sign_is_proved_by_the_matches() -> None:
    scene = line_of_sight_case("nominal", 3, lines=900, columns=320)
    bands = []
    for k in (0, 1):
        camera, band = scene.nominal_cameras[k], scene.bands[k]
        turned = LineDetector.from_ifov(
            band.name,
            camera.columns,
            scene.options.ifov,
            scene.options.line_period,
            look_ahead=-band.look_ahead,
        )
        bands.append(Band(band.name, ArrayImage(scene.image(k)), replace(camera, detector=turned)))
    with pytest.raises(EstimationError, match=r"the lag has the wrong sign: PAN and \S+ match"):
        recover_line_of_sight(bands, Plane(0.0))
