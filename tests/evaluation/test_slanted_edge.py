"""MTF of slanted edges against known blur, and its sigma against the scatter of many draws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from sightline.errors import InputError
from sightline.evaluation.slanted_edge import slanted_edge_mtf

F = np.array([0.1, 0.25, 0.4, 0.5])


def edge(degrees, sigma, *, rows=80, columns=36, dark=0.4, bright=1.6, middle=17.87):
    """A Gaussian-blurred edge, sampled at the pixels' centres."""
    row, column = np.mgrid[:rows, :columns].astype(float)
    angle = np.radians(degrees)
    distance = (column - middle) * np.cos(angle) + (row - 0.5 * (rows - 1)) * np.sin(angle)
    return dark + (bright - dark) * ndtr(distance / sigma)


def gaussian_mtf(degrees, sigma):
    """Along the rows the edge is as wide as its normal profile over the cosine of its angle."""
    return np.exp(-2.0 * (np.pi * sigma * F / np.cos(np.radians(degrees))) ** 2)


@pytest.mark.parametrize(("degrees", "sigma"), [(5.0, 0.4), (-5.0, 0.6), (8.0, 0.6), (5.0, 1.0)])
def test_a_gaussian_edge_has_its_mtf(degrees, sigma):
    found = slanted_edge_mtf(edge(degrees, sigma), F)
    # the mean over a bin is taken as even over its quarter pixel; pixels lie 0.0875 px apart or more, so that
    # the mean square of their places is off by (0.0875^2 / 12): half of (2 pi f)^2 times that is 0.3 % of it
    assert_allclose(found.mtf, gaussian_mtf(degrees, sigma), rtol=3e-3, atol=1e-4)
    assert np.degrees(found.angle) == pytest.approx(degrees, abs=0.01)


def test_a_box_is_a_sinc_and_the_sense_of_the_edge_does_not_matter():
    width = 1.6
    fine = np.mean([edge(5.0, 0.3, middle=17.87 + d) for d in width * (np.arange(40) / 39.5 - 0.49)], axis=0)
    expected = gaussian_mtf(5.0, 0.3) * np.abs(np.sinc(width * F))
    # forty places instead of a box: its width is 40 / 39.5 wider, 1.3 % of a slope of at most 2 f
    assert_allclose(slanted_edge_mtf(fine, F).mtf, expected, atol=0.015)
    assert_allclose(slanted_edge_mtf(2.0 - fine, F).mtf, slanted_edge_mtf(fine, F).mtf, rtol=1e-9)
    assert_allclose(slanted_edge_mtf(1000.0 * fine, F).mtf, slanted_edge_mtf(fine, F).mtf, rtol=1e-9)


def test_sigma_is_the_scatter():
    rng, draws = np.random.default_rng(0), 100
    still = edge(5.0, 0.5)
    # shot noise: the bright side has four times the variance of the dark one
    noise = 0.02 * np.sqrt(still)
    found = [slanted_edge_mtf(still + noise * rng.normal(size=still.shape), F) for _ in range(draws)]
    mtf, sigma = np.array([one.mtf for one in found]), np.array([one.sigma for one in found])
    # 100 draws: the standard deviation is known to 7 %, sigmas claimed scatter less; four sigma
    assert_allclose(sigma.mean(axis=0) / mtf.std(axis=0, ddof=1), 1.0, atol=0.28)
    error = (mtf.mean(axis=0) - gaussian_mtf(5.0, 0.5)) / (mtf.std(axis=0, ddof=1) / np.sqrt(draws))
    assert np.abs(error).max() < 4.0


@pytest.mark.parametrize(
    ("patch", "message"),
    [
        (np.ones((80, 36)), "no edge"),
        (np.ones((2, 36)), "too small"),
        (edge(5.0, 0.5, middle=6.0), "px beside it"),
        (edge(0.3, 0.5), "1 px or more is needed"),
        (edge(45.0, 0.5, rows=8), "bins of a quarter of a pixel empty"),
    ],
)
def test_what_is_no_slanted_edge_is_refused(patch, message):
    with pytest.raises(InputError, match=message):
        slanted_edge_mtf(patch, F)
