"""Laws of what frames do not know, learned from fields that were drawn."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from sightline.motion.frames.noise import GroundField, learn_field


def test_the_law_of_a_drawn_field_is_found_from_either_side():
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(0.0, 400e3, (350, 2)), np.zeros(350)])
    # Matern 3/2 of 300 m over 40 km, written out; windows say it to 30 m
    r = np.sqrt(3.0) * cdist(ground, ground) / 40e3
    root = np.linalg.cholesky(300.0**2 * (1.0 + r) * np.exp(-r) + 1e-3 * np.eye(350))
    height = root @ rng.standard_normal(350) + 30.0 * rng.standard_normal(350)
    for sigma, length in ((1000.0, 15e3), (100.0, 120e3)):
        start = GroundField(500.0, sigma, length, 30.0, 2e3)
        found = learn_field(ground, height, np.full(350, 30.0**-2), start)
        # some hundred patches of 40 km: sigma to a tenth or so; the two trade with each other
        assert 0.6 < found.sigma / 300.0 < 1.7
        assert 0.5 < found.length / 40e3 < 2.0
        assert found.offset_sigma == 500.0 and found.rough_length == 2e3
