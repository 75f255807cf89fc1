"""MTFs of what stands still against integrals and numerical autocorrelation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from sightline.errors import InputError
from sightline.imaging.mtf import aperture_mtf, diffusion_mtf, optics_mtf


def test_aperture_is_the_transform_of_a_box():
    value, _ = quad(lambda x: np.cos(2.0 * np.pi * 0.4 * x) / 0.9, -0.45, 0.45)
    assert aperture_mtf(0.4, 0.9) == pytest.approx(abs(value))


def test_diffusion_is_the_transform_of_a_gaussian():
    gaussian = norm(scale=0.2).pdf
    value, _ = quad(lambda x: np.cos(2.0 * np.pi * 0.5 * x) * gaussian(x), -2.0, 2.0)
    assert diffusion_mtf(0.5, 0.2) == pytest.approx(value)


@pytest.mark.parametrize("obscuration", [0.0, 0.35, 0.6])
def test_diffraction_is_the_autocorrelation_of_the_pupil(obscuration):
    n = 1024
    x = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    radius = 2.0 * np.hypot(x[:, None], x[None, :])  # pupil of diameter 1 in a field of 2
    pupil = ((radius <= 1.0) & (radius >= obscuration)).astype(float)
    for shift in (64, 200, 400):
        common = (pupil[shift:] * pupil[:-shift]).sum() / pupil.sum()
        # of edges drawn in steps of a pixel: perimeter / area x pixel
        assert optics_mtf(shift / n * 2.0, 1.0, obscuration=obscuration) == pytest.approx(common, abs=6e-3)


def test_a_wavefront_error_costs_most_in_the_middle():
    assert optics_mtf(0.5, 1.0, wavefront=0.09) == pytest.approx(0.75 * optics_mtf(0.5, 1.0))
    assert optics_mtf([0.0, 1.2], 1.0, wavefront=0.09).tolist() == [1.0, 0.0]


@pytest.mark.parametrize(("key", "value"), [("obscuration", 1.0), ("wavefront", 0.2)])
def test_impossible_optics_are_refused(key, value):
    with pytest.raises(InputError, match=key):
        optics_mtf(0.5, 1.0, **{key: value})
