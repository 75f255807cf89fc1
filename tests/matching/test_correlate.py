"""How alike the gradients of two windows are, and what noise makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.matching import kernels
from sightline.matching.correlate import agreement_of_gradients, chance_agreement


def test_gradients_agree_by_the_smaller_eigenvalue_of_their_common_part():
    rng = np.random.default_rng(5)
    fits = np.full((40, kernels.COLUMNS), np.nan)
    expected = []
    for row in fits[:-1]:
        root = rng.normal(size=(2, 3, 2))
        noise, own = root[0].T @ root[0], root[1].T @ root[1]
        both = own - rng.uniform(0.0, 1.2) * noise  # of either image with the other
        h, g = both, 0.5 * (both + own)
        row[2:5], row[5:8] = h[[0, 0, 1], [0, 1, 1]], g[[0, 0, 1], [0, 1, 1]]
        expected.append(np.linalg.eigvals(np.linalg.solve(own, h)).real.min())
    found = agreement_of_gradients(fits)
    # two by two, of determinants that may be a hundredth of the squares in them
    np.testing.assert_allclose(found[:-1], expected, rtol=1e-8, atol=1e-10)
    assert np.isnan(found[-1])


def test_chance_reaches_what_its_places_and_independent_pixels_let_it():
    # 7 by 11 places, a pixel more than the search on all sides: (2 ln 77)^1/2 = 2.9475, and 1.2; 400 pixels
    assert chance_agreement((10, 100), (2, 4), 0.4) == pytest.approx(4.1475 / 20.0, abs=1e-5)
    assert chance_agreement((10, 100), (2, 4)) == pytest.approx(4.1475 / np.sqrt(500.0), abs=1e-5)
