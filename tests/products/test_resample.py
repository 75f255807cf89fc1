"""The 16-tap kernel against exact Fourier series, in all its ways of holding weights."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.products import resample
from sightline.products.resample import BEFORE, TAPS, product_kernel, product_weights, resample_rows

SIZE, PAD = 256, 24


def series(cut, seed=0):
    """Half spectrum of a periodic texture of power 1/f^2, unit variance, nothing at `cut` and beyond."""
    fy, fx = np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None, :]
    half = np.fft.rfft2(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))
    half *= np.where((np.abs(fy) < cut) & (np.abs(fx) < cut), 1.0, 0.0) / np.sqrt(fy**2 + fx**2 + 1e-4)
    half[0, 0] = 0.0
    return half / np.fft.irfft2(half).std()


def image_of(half):
    return np.pad(np.fft.irfft2(half), PAD, mode="wrap").astype(np.float32)


def truth_at(half, lines, columns):
    """The series at places (rows, columns), by its sum."""
    fy, fx = np.fft.fftfreq(SIZE), np.fft.rfftfreq(SIZE)
    twice = np.where((fx == 0) | (fx == 0.5), 1.0, 2.0)
    out = np.empty(lines.shape)
    for i in range(len(lines)):
        along = np.exp(2j * np.pi * np.outer(lines[i], fy)) @ half
        across = twice * np.exp(2j * np.pi * np.outer(columns[i], fx))
        out[i] = (along * across).real.sum(axis=1) / SIZE**2
    return out


def resampled(image, position, nodes):
    out = np.full((len(position), nodes[-1]), np.nan, np.float32)
    resample_rows(image, position, np.asarray(nodes), out)
    return out


def grid(rows, nodes, line_slope=0.0, column_slope=0.0, line=0.3, column=-0.4):
    """Places with constant slopes, from row 40 and column 30 of the texture on, in padded pixels."""
    nodes = np.asarray(nodes)
    lines = 40 + np.arange(rows)[:, None] + line + line_slope * nodes
    columns = 30 + nodes * (1.0 + column_slope) + column + np.zeros((rows, 1))
    return np.stack([lines, columns], axis=-1) + PAD


def exact(half, position, nodes):
    """Truth at every pixel, places linear between nodes."""
    j = np.arange(nodes[-1])
    lines = np.stack([np.interp(j, nodes, row[:, 0]) for row in position]) - PAD
    columns = np.stack([np.interp(j, nodes, row[:, 1]) for row in position]) - PAD
    return truth_at(half, lines, columns)


def by_definition(image, position, nodes):
    """The 16 x 16 weighted sum at every pixel, in float64, places linear between nodes."""
    j = np.arange(nodes[-1])
    out = np.empty((len(position), len(j)))
    for i, row in enumerate(position):
        line, column = (np.interp(j, nodes, row[:, k]) for k in (0, 1))
        wy, wx = product_weights(line % 1.0), product_weights(column % 1.0)
        reach = np.arange(TAPS) - BEFORE
        rows, columns = (
            np.floor(line).astype(int)[:, None] + reach,
            np.floor(column).astype(int)[:, None] + reach,
        )
        out[i] = np.einsum("nk,nm,nkm->n", wy, wx, image[rows[:, :, None], columns[:, None, :]])
    return out


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_weights_sum_to_one_and_a_whole_pixel_is_itself():
    weights = product_weights(np.linspace(0.0, 1.0, 11))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    itself = np.zeros(TAPS)
    itself[BEFORE] = 1.0
    np.testing.assert_allclose(weights[0], itself, atol=1e-6)
    np.testing.assert_allclose(weights[-1], np.roll(itself, 1), atol=1e-6)


def test_weights_are_symmetric():
    np.testing.assert_allclose(
        product_weights(np.array([0.3])), product_weights(np.array([0.7]))[:, ::-1], atol=1e-9
    )


@pytest.mark.parametrize(("frequency", "most"), [(0.1, 1e-3), (0.2, 1e-3), (0.3, 1e-3), (0.4, 7e-3)])
def test_a_wave_within_the_band_comes_through(frequency, most):
    """LANCZOS4 with its table of 32 phases leaves 1e-2, 2e-2, 4e-2 and 0.2 of these."""
    d, k = np.linspace(0.0, 1.0, 21), np.arange(TAPS) - BEFORE
    seen = product_weights(d) @ np.exp(2j * np.pi * frequency * k)
    assert np.abs(seen - np.exp(2j * np.pi * frequency * d)).max() < most


@pytest.mark.parametrize("cut", [0.25, 0.4])
def test_one_shift_per_line_is_a_tenth_of_lanczos4_or_better(cut):
    cv2 = pytest.importorskip("cv2", reason="opencv is not installed")
    half = series(cut)
    image, nodes = image_of(half), [0, 160]
    rng = np.random.default_rng(1)
    position = grid(64, nodes) + rng.uniform(-2.0, 2.0, (64, 1, 2))
    truth = exact(half, position, nodes)
    lines = np.repeat(position[:, :1, 0], 160, axis=1).astype(np.float32)
    columns = (position[:, :1, 1] + np.arange(160)).astype(np.float32)
    theirs = cv2.remap(image, columns, lines, cv2.INTER_LANCZOS4)
    assert rms(resampled(image, position, nodes) - truth) <= 0.1 * rms(theirs - truth)


# In turn: constant along the line, a parabola over 64 px, shorter ones, weights for every pixel, both axes
# at once (too steep for lines first). How weights are held may add a tenth to what the weights themselves
# leave (and a wave at 0.35 cycles per pixel is sheared to 0.36 while lines go first).
@pytest.mark.parametrize("slope", [0.0, 1e-3, -1e-3, 4e-3, 0.03, 0.12])
def test_every_way_of_holding_weights_is_true(slope):
    half = series(0.35)
    nodes = [0, 50, 100, 150]
    position = grid(24, nodes, line_slope=slope, column_slope=-0.7 * slope)
    image, truth = image_of(half), exact(half, position, nodes)
    least = rms(by_definition(image, position, nodes) - truth)
    assert rms(resampled(image, position, nodes) - truth) < 1.1 * least


def test_shifts_that_cross_a_whole_pixel_within_a_stretch():
    half = series(0.35)
    nodes = np.arange(0, 161, 8)
    position = grid(24, nodes, line=0.0, column=0.0)
    wave = 0.05 * np.sin(2 * np.pi * nodes / 80.0 + np.arange(24)[:, None])
    position = position + wave[:, :, None] * [1.0, -1.0]
    image, truth = image_of(half), exact(half, position, nodes)
    least = rms(by_definition(image, position, nodes) - truth)
    assert rms(resampled(image, position, nodes) - truth) < 1.1 * least


def test_a_map_that_turns_back_is_taken_pixel_by_pixel():
    half = series(0.35)
    nodes = [0, 20, 40]
    position = grid(4, nodes)
    position[:, 2, 1] = position[:, 0, 1]
    image, truth = image_of(half), exact(half, position, nodes)
    least = rms(by_definition(image, position, nodes) - truth)
    assert rms(resampled(image, position, nodes) - truth) < 1.1 * least


def test_magnitudes_of_weights_of_flags():
    """One flagged pixel weighs its own weight's magnitude at every place about it."""
    flags = np.zeros((64, 64), np.float32)
    flags[32, 32] = 1.0
    position = np.array([[[32.0, 20.25], [32.0, 44.25]]])
    out = np.empty((1, 24), np.float32)
    resample_rows(flags, position, np.array([0, 24]), out, table=product_kernel(absolute=True))
    weights = np.abs(product_weights(np.array([0.25])))[0]
    expected = [weights[k] if 0 <= (k := 32 - (20 + j) + BEFORE) < TAPS else 0.0 for j in range(24)]
    np.testing.assert_allclose(out[0], expected, atol=2e-6)


def test_the_table_reaches_as_far_as_a_stretch_may_ask():
    margin = (len(product_kernel()) - 1 - resample.PHASES) // 2
    assert margin / resample.PHASES > resample.PARABOLA
