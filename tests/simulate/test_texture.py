"""Layers are the functions they are said to be, and have the spectrum asked for."""

import numpy as np
import pytest

from sightline.simulate.scene import Extent, TextureLaw, layer_shape, mtf_at, scene_layers
from sightline.simulate.texture import TextureLayer, padded, random_layer, raster_layer

GSD = (3.4, 3.4)


def test_one_coefficient_gives_the_cubic_b_spline():
    table = np.zeros((8, 8), dtype=np.float32)
    table[3, 4] = 1.0
    layer = TextureLayer(padded(table), (2.0, 5.0), (10.0, 20.0))
    # at half a knot east and one knot north: (23/48) x (1/6), by the spline's closed form
    value = layer.at(np.array([10.0 + 4.5 * 2.0]), np.array([20.0 + 4.0 * 5.0]))
    assert value[0] == pytest.approx(23.0 / 48.0 / 6.0, rel=1e-6)


def test_a_layer_repeats_after_its_period_and_nowhere_jumps():
    rng = np.random.default_rng(0)
    layer = TextureLayer(padded(rng.standard_normal((12, 9)).astype(np.float32)), (1.0, 1.0))
    x = np.linspace(-3.0, 12.0, 3001)
    y = np.full_like(x, -0.3)
    np.testing.assert_allclose(layer.at(x, y), layer.at(x + 9.0, y - 12.0), atol=2e-5)
    # the slope of a cubic spline is at most the largest step of its coefficients
    assert np.abs(np.diff(layer.at(x, y))).max() < 0.005 * 8.0


def test_a_random_texture_has_the_contrast_and_the_spectrum_asked_for():
    law = TextureLaw(0.2, GSD)
    layer = random_layer(np.random.SeedSequence(1), (2048, 2048), (1.7, 1.7), law.psd)
    n = 1024
    j, i = np.meshgrid(np.arange(n) * 3.4, np.arange(n) * 3.4)
    image = layer.at(j, i).astype(np.float64)
    power = np.abs(np.fft.fft2(image)) ** 2 / n**2
    f = np.fft.fftfreq(n)
    radius = np.hypot(f[:, None], f[None, :])
    decay = -8.0 * np.log(0.15)
    for low, high in ((0.02, 0.04), (0.08, 0.12), (0.2, 0.25)):
        ring = (radius > low) & (radius < high)
        # by hand, aliases included: A / f^2 MTF^2 with A from the reference scenes' gradient, 0.00109
        total = np.zeros_like(radius)
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                square = (f[:, None] + a) ** 2 + (f[None, :] + b) ** 2
                total += 1.09e-3 / np.maximum(square, 1e-9) * np.exp(-decay * square)
        # thousands of independent periodogram values: 3 % is over three standard deviations
        assert power[ring].mean() == pytest.approx(total[ring].mean(), rel=0.03)


def test_the_gradient_of_the_texture_is_that_of_the_reference_scenes():
    # reference scenes: gradient bounds .0067 px at SNR 100 for 10 x 100 px mean a slope of .0667 per px
    law = TextureLaw(0.2, GSD)
    layer = random_layer(np.random.SeedSequence(2), (1024, 1024), (1.7, 1.7), law.psd)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.0, 1740.0, (2, 200_000))
    slope = (layer.at(x + 0.05, y).astype(np.float64) - layer.at(x - 0.05, y)) / 0.1 * 3.4
    assert slope.std() == pytest.approx(0.0667, rel=0.02)


def test_the_mtf_is_what_was_asked_at_nyquist():
    np.testing.assert_allclose(mtf_at(np.array([0.0, 0.5, 0.25]), 0.15), [1.0, 0.15, 0.15**0.25])


def test_any_two_bands_have_the_coherence_asked_for():
    law = TextureLaw(0.2, GSD)
    weights = (0.98, 0.95, 0.4)
    texture, bands = scene_layers(
        np.random.SeedSequence(5), Extent(0, 3400, 0, 3400), law, weights, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)
    )
    rng = np.random.default_rng(6)
    x, y = rng.uniform(100.0, 3300.0, (2, 300_000))
    step = 2.0  # differences: short waves only, so that thousands of independent ones are averaged
    seen = [
        band.weight * (texture.at(x + step, y) - texture.at(x, y))
        + np.sqrt(1.0 - band.weight**2) * (band.own.at(x + step, y) - band.own.at(x, y))
        for band in bands
    ]
    correlation = np.corrcoef(seen)
    np.testing.assert_allclose(
        correlation[np.triu_indices(3, 1)], np.outer(weights, weights)[np.triu_indices(3, 1)], atol=0.01
    )


def test_a_raster_layer_passes_through_the_pixels_it_was_made_from():
    j, i = np.meshgrid(np.arange(40), np.arange(30))
    raster = 50.0 + 10.0 * np.cos(np.pi * (i + 0.5) * 6 / 30) * np.cos(np.pi * (j + 0.5) * 8 / 40)
    layer = raster_layer(raster, (2.0, 3.0), (100.0, 200.0))
    np.testing.assert_allclose(layer.at(100.0 + 2.0 * j, 200.0 + 3.0 * i), raster, atol=2e-2)
    # and between them it is the same cosine: band-limited interpolation of a mirrored image
    middle = layer.at(100.0 + 2.0 * (j + 0.37), 200.0 + 3.0 * (i + 0.61))
    expected = 50.0 + 10.0 * np.cos(np.pi * (i + 1.11) * 6 / 30) * np.cos(np.pi * (j + 0.87) * 8 / 40)
    np.testing.assert_allclose(middle, expected, atol=2e-2)


def test_layers_of_a_long_scene_stay_bounded_and_repeat_out_of_step():
    long = Extent(0.0, 20_000.0, 0.0, 40_000.0)
    shapes = [layer_shape(long, (1.7, 1.7), 2048, 1.0 + 0.0371 * k) for k in range(1, 5)]
    assert max(max(shape) for shape in shapes) < 1.25 * 2048
    # no two layers have the same period along either side
    assert len({shape[0] for shape in shapes}) == len({shape[1] for shape in shapes}) == 4
