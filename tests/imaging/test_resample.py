"""The interpolation kernel shared by matching, products and simulation."""

import numpy as np
from scipy.integrate import quad

from sightline.imaging.resample import (
    PHASES,
    TAPS,
    delay_weights,
    kernel_table,
    natural_correlation,
    sample,
)


def response(fractions, f):
    k = np.arange(TAPS) - (TAPS // 2 - 1)
    return delay_weights(fractions) @ np.exp(2j * np.pi * np.outer(k, f))


def test_weights_sum_to_one_and_a_whole_pixel_is_nearly_untouched():
    w = delay_weights(np.linspace(0, 1, 41))
    assert np.abs(w.sum(axis=1) - 1).max() < 1e-12
    assert np.abs(w[0] - np.eye(TAPS)[3]).max() < 0.02


def test_weights_mirror_when_the_fraction_does():
    w = delay_weights(np.array([0.3, 0.7]))
    assert np.abs(w[0] - w[1][::-1]).max() < 1e-9


def test_a_sine_of_the_band_moves_by_less_than_five_thousandths_of_a_pixel_too_much():
    # the least-squares kernel is claimed faithful up to 0.36 cycle/px; beyond, matching fades it out
    f = np.linspace(0.02, 0.36, 60)
    d = np.linspace(0, 1, 33)
    error = np.angle(response(d, f) * np.exp(-2j * np.pi * np.outer(d, f))) / (2 * np.pi * f)
    assert np.abs(error).max() < 0.005
    assert np.abs(np.abs(response(d, f)) - 1).max() < 0.03


def test_the_table_is_dense_enough_for_linear_interpolation():
    between = 0.5 * (kernel_table()[:-1] + kernel_table()[1:])
    exact = delay_weights((np.arange(PHASES) + 0.5) / PHASES)
    assert np.abs(between - exact).max() < 2e-5
    assert not kernel_table().flags.writeable


def test_sampling_equals_the_plain_double_sum_and_is_nan_beyond_the_border():
    rng = np.random.default_rng(1)
    image = rng.normal(size=(30, 40)).astype(np.float32)
    positions = np.column_stack([rng.uniform(4, 24, 50), rng.uniform(4, 34, 50)])
    expected = []
    for y, x in positions:
        i, j = int(y), int(x)
        wy, wx = delay_weights(np.array([y - i, x - j]))
        expected.append(wy @ image[i - 3 : i + 5, j - 3 : j + 5] @ wx)
    # float32 sums of 64 products of order 1
    assert np.abs(sample(image, positions) - expected).max() < 1e-4
    assert np.isnan(sample(image, np.array([[1.0, 20.0], [27.0, 20.0], [20.0, 38.0], [np.nan, 3.0]]))).all()


def test_natural_ground_is_alike_over_a_distance_as_the_integral_of_its_spectrum_says():
    band, lags = 0.4, np.array([[0.0, 0.5, 1.0], [7.0, -20.0, 60.0]])

    def integral(lag):
        return quad(lambda f: np.cos(2 * np.pi * f * lag) / (f + 0.005) ** 2, 0.0, band, limit=500)[0]

    expected = np.vectorize(integral)(lags) / integral(0.0)
    np.testing.assert_allclose(natural_correlation(band, 400)(lags), expected, atol=1e-7)


def test_weights_for_natural_ground_keep_its_long_waves_best():
    """Of 16 taps: the error of waves weighed by 1 / f^2 is below that of weights for a flat spectrum."""
    k, f = np.arange(16) - 7.0, np.linspace(0.01, 0.3, 60)
    wave = np.exp(2j * np.pi * np.outer(k, f))
    errors = []
    for natural in (True, False):
        weights = delay_weights(np.array([0.3]), 16, 0.45, natural=natural)[0]
        assert abs(weights.sum() - 1.0) < 1e-12
        errors.append(np.abs(weights @ wave - np.exp(2j * np.pi * 0.3 * f)) ** 2 @ (f + 0.005) ** -2.0)
    assert errors[0] < 0.1 * errors[1]
