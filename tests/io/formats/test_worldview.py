"""WorldView and QuickBird, level 1B."""

from __future__ import annotations

import numpy as np
import pytest
from tests.product_files import WorldViewScene

from sightline.io.formats.products.recognise import read_product


@pytest.mark.parametrize("form", ["xml", "text"])
def test_rays_are_those_of_the_scene(form, tmp_path):
    scene = WorldViewScene()
    product = read_product(getattr(scene, form)(tmp_path))
    camera = product.model.camera
    for line, column in ((0.0, 0.0), (319.0, 199.0), (100.0, 57.0)):
        rays = camera.rays([[line, column]])
        origin, look = scene.ray(line, column)
        np.testing.assert_allclose(rays.origins[0], origin, atol=1e-5)
        np.testing.assert_allclose(rays.directions[0], look / np.linalg.norm(look), atol=1e-10)
    assert product.attitude_sigma == pytest.approx(20e-6)
    assert product.model.doubts == ()
