"""The spectrum of the error that remains, beside the sigma that is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sightline.estimation.prior import Spectrum, Tone
from sightline.evaluation.error_spectrum import error_psd
from sightline.evaluation.observed import observed


def test_its_integral_is_about_the_square_of_the_stated_sigma(recovery):
    result = recovery.result
    # what turns less than once in the strip, of 0.32 s, is hidden, and no part of the sigma that is stated
    frequency = np.linspace(3.125, 1000.0, 8001)
    rms = np.sqrt(np.trapezoid(error_psd(result, frequency), frequency, axis=0))
    # The formula knows an endless strip and no unknown statics; sigma is that of ends, too, and of the half
    # that a single pair of lags sees
    assert (rms < 1.1 * np.median(result.sigma, axis=0)).all()
    assert (rms > 0.8 * np.median(result.sigma, axis=0)).all()


def test_where_nothing_is_measured_the_error_is_the_motion_itself(recovery):
    result, frequency = recovery.result, np.array([5.0, 50.0, 200.0])
    blind = tuple(
        replace(record, star=record.star.with_weight(np.zeros_like(record.star.weight)))
        for record in result.records
    )
    prior = np.stack([spectrum.psd(frequency) for spectrum in result.spectra], axis=1)
    np.testing.assert_allclose(error_psd(replace(result, records=blind), frequency), prior)


def test_a_constant_is_hidden_on_every_axis(recovery):
    # of yaw, too, though it moves what looks ahead otherwise than what looks back
    result, frequency = recovery.result, np.array([0.0, 10.0])
    assert "constant of yaw" in result.hidden_names
    prior = np.stack([spectrum.psd(frequency) for spectrum in result.spectra], axis=1)
    error = error_psd(result, frequency)
    np.testing.assert_allclose(error[0], prior[0])
    assert (error[1] < 0.1 * prior[1]).all()


def test_the_error_is_less_than_the_prior_and_less_than_that_of_the_matches_alone(recovery):
    result, frequency = recovery.result, np.linspace(1.0, 450.0, 200)
    error = error_psd(result, frequency)
    alone = error_psd(replace(result, spectra=None), frequency)
    prior = np.stack([spectrum.psd(frequency) for spectrum in result.spectra], axis=1)
    # as written, without units in which it stays exact where densities are far apart
    told = observed(result, frequency).information / np.ptp(result.motion.t)
    both = np.linalg.inv(told + np.eye(3) / prior[:, :, None])
    np.testing.assert_allclose(error, np.einsum("faa->fa", both).real, rtol=1e-6)
    assert (error <= prior).all() and (error <= alone).all()
    # as of a Wiener smoother, where no other axis takes part of what is seen; roll and yaw, which move what
    # looks ahead alike, know more of each other by their priors
    bound = 1.0 / (1.0 / prior + 1.0 / alone)
    np.testing.assert_allclose(error[:, 1], bound[:, 1], rtol=1e-2)
    assert (error <= 1.0001 * bound).all()


def test_products_of_hidden_modes_are_errors_and_no_motion(recovery):
    # at 45 Hz motion is seen well, and so is what averaging puts there: a tone of 2 urad, none of the body's
    result, frequency = recovery.result, np.linspace(20.0, 70.0, 5001)
    made = replace(result, intermodulation=(None, Spectrum((Tone(2e-6, 45.0, 1.0),)), None))
    more = error_psd(made, frequency) - error_psd(result, frequency)
    # a line of 1 Hz within 25 Hz on both sides: 2 / pi atan(50) of it
    np.testing.assert_allclose(np.trapezoid(more, frequency, axis=0), [0.0, 3.95e-12, 0.0], rtol=3e-3)
    assert made.spectra == result.spectra
