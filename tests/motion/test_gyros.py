"""Gyros of unknown scale and axes, on turns that the test makes itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import maker_files as maker
from sightline.errors import InputError
from sightline.motion.gyros import departures, fit_gyros

NOISE = 2e-8


@pytest.fixture(scope="module")
def flight():
    """Times and readings of four gyros, and exact attitudes every eighth second."""
    t = np.arange(150) / 32
    read = maker.counts(t, seed=3, noise=NOISE).astype(np.int64)
    steps = (np.diff(read, axis=0) + 2**31) % 2**32 - 2**31
    counts = np.vstack([np.zeros(4), np.cumsum(steps, axis=0)])
    known = np.swapaxes(maker.turned(maker.EARTH * t[8:-8:4]), 1, 2) @ maker.attitude(t[8:-8:4])
    return t, counts, t[8:-8:4], Rotation.from_matrix(known)


def test_scale_axes_and_lag_are_found(flight):
    t, counts, t_known, known = flight
    fit = fit_gyros(t, counts, t_known, known)
    # 2e-8 rad of noise at 35 places of a turn of some mrad
    np.testing.assert_allclose(fit.axes, maker.AXES, atol=1e-3)
    np.testing.assert_allclose(fit.scale, maker.COUNT, rtol=1e-3)
    assert abs(fit.lag) < 1e-3
    assert fit_gyros(t + 0.015, counts, t_known, known).lag == pytest.approx(0.015, abs=1e-3)


def test_increments_have_the_noise_of_their_heads(flight):
    t, counts, t_known, known = flight
    fit = fit_gyros(t, counts, t_known, known)
    # four heads of a tetrahedron: 3/4 of the variance of one about each axis; twice, of an increment
    assert fit.residual.std() == pytest.approx(np.sqrt(2 * 0.75) * NOISE, rel=0.2)


def test_the_parity_holds_no_turn_and_the_noise_of_one_head(flight):
    t, counts, t_known, known = flight
    fit = fit_gyros(t, counts, t_known, known)
    parity = fit.parity(counts)
    assert parity.std() == pytest.approx(NOISE, rel=0.2)
    noise = fit.noise(t, counts)
    np.testing.assert_allclose(noise.deviation[0], np.sqrt(3.0) * NOISE * 32, rtol=0.2)
    # of a random walk that is nowhere below white angles: their Allan deviation at the first step
    np.testing.assert_allclose(noise.sigma, np.sqrt(3.0) * NOISE * np.sqrt(0.75), rtol=0.2)


def test_what_departs_from_the_reference_comes_out_and_no_more(flight):
    t, counts, t_known, known = flight
    fit = fit_gyros(t, counts, t_known, known)
    jitter = 3e-6 * np.sin(2 * np.pi * 5.0 * t)[:, None] * [1.0, 0.0, 0.0]
    earth = Rotation.from_matrix(maker.attitude(t))
    moved = earth * Rotation.from_rotvec(-jitter)  # the body departs by the jitter from this reference
    rate = np.array([0.0, 0.0, maker.EARTH])
    turned = fit.body(t, counts)
    still = departures(t, turned, earth, rate)
    # noise, and .1 % of .012 rad/s in 1/32 s by the fit of the axes
    assert still.std(axis=0).max() < 4e-8
    found = departures(t, turned, moved, rate)
    # the body turns by .5 mrad within a step: 1.5e-9 of 3e-6 rad about another axis
    np.testing.assert_allclose(found - still, np.diff(jitter, axis=0), atol=2e-9)


def test_what_cannot_be_fitted_is_refused(flight):
    t, counts, t_known, known = flight
    with pytest.raises(InputError, match="6 or more attitudes"):
        fit_gyros(t, counts, t_known[:4], known[:4])
    with pytest.raises(InputError, match="fewer than three axes"):
        fit_gyros(t, counts, t_known, Rotation.from_rotvec(np.outer(t_known, [0.01, 0.0, 0.0])))
    three = fit_gyros(t, counts[:, [0, 1, 3]], t_known, known)
    with pytest.raises(InputError, match="no parity"):
        three.parity(counts[:, [0, 1, 3]])
