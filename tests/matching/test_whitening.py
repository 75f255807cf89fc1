"""The whitening filter against the optimum computed from known spectra."""

import numpy as np
import pytest

from matching.fourier_textures import shifted_pair
from sightline.errors import InputError
from sightline.imaging.source import ArrayImage
from sightline.matching.select import grid_points
from sightline.matching.whitening import (
    _EDGE,
    Whitening,
    _phase_shift,
    _smooth_log,
    _tiles,
    estimate_whitening,
)

SHAPE = (384, 512)


@pytest.fixture(scope="module")
def estimate():
    def of(**options):
        a, b = (ArrayImage(x) for x in shifted_pair(SHAPE, (0.4, -0.6), seed=3, **options))
        points = grid_points((320, 440), window=(16, 30)) + 32
        return estimate_whitening(a, b, points, points)

    return of


def test_two_noisy_images_of_one_band_are_compared_as_they_are(estimate):
    # where the signal stands above the noise the best weight of white noise is flat
    response = estimate(snr=100.0).response()
    band = response[0, 4:20]  # 0.06 to 0.3 cycle/px
    assert band.std() / band.mean() < 0.1
    assert response[0, 31] < 0.5 * band.mean()


def test_two_bands_are_whitened_down_to_the_noise(estimate):
    # decorrelation has the spectrum of the texture: the weight undoes it, |f| / MTF
    response = estimate(snr=200.0, cross=True).response()
    f = np.fft.rfftfreq(64)[5:16]  # 0.08 to 0.25 cycle/px
    wanted = f * np.exp(-np.log(0.15) * (f / 0.5) ** 2)
    for line in (response[0, 5:16], response[5:16, 0]):
        ratio = line / wanted
        assert ratio.std() / ratio.mean() < 0.1


def test_the_coherence_found_is_that_of_the_layers(estimate):
    made = estimate(snr=200.0, cross=True)
    # rho^2 = 0.9025, where the noise is negligible; 400 tiles of about 100 modes: far below 2 %
    assert made.coherence[0, 6:14].mean() == pytest.approx(0.9025, abs=0.02)
    assert made.tiles > 100


def test_taps_reproduce_a_response_that_thirteen_taps_can_carry():
    f = np.fft.fftfreq(64)[:, None]
    wanted = np.exp(-(f**2 + np.fft.rfftfreq(64)[None, :] ** 2) / (2 * 0.15**2))
    # 13 taps span 3 sigma of this impulse; softening their cut takes 2.4 % of the middle, where all add up
    assert np.abs(Whitening.from_response(wanted).response() - wanted).max() < 0.03


def test_taps_of_another_shape_are_refused():
    with pytest.raises(InputError, match="quadrant of shape"):
        Whitening(np.ones((13, 13)), np.ones((13, 13)))


def test_a_shift_between_the_images_along_either_axis_is_no_loss_of_coherence():
    a, b = (ArrayImage(x) for x in shifted_pair(SHAPE, (0.45, -0.45), seed=3, snr=1000.0))
    points = grid_points((320, 440), window=(16, 30)) + 32
    found = estimate_whitening(a, b, points, points).coherence
    # 0.03 to 0.13 cycle/px along columns: noise is 1e-6 of it, a hundredth of a pixel off loses as little;
    # half a pixel would leave the taper 5e-4 off the texture
    assert found[0, 2:9].mean() > 1.0 - 1e-4


def test_tiles_of_b_lie_under_those_of_a_by_the_affine():
    """A plane shows where each pixel of a tile was read, to what the kernel leaves of a line (0.005 px)."""
    lines, columns = np.mgrid[0.0:160.0, 0.0:200.0]
    plane = ArrayImage((10.0 * lines + columns).astype(np.float32))
    point, predicted = np.array([[70.3, 90.4]]), np.array([[75.0, 88.0]])
    linear = np.array([[[0.02, 0.2], [-0.05, 0.01]]])
    numbered = ArrayImage((200.0 * lines + columns).astype(np.float32))
    a, b = _tiles((numbered, plane), point, predicted, linear, (16, 20), (3, 2))
    row, column = divmod(int(a[0, 0, 0]), 200)
    wider = np.array([3 + _EDGE, 2 + _EDGE])
    for k in ((0, 0), (5, 30), (20, 7)):
        own = np.array([row, column]) - wider + k
        seen = predicted[0] + (np.eye(2) + linear[0]) @ (own - point[0])
        assert b[0][k] == pytest.approx(seen @ [10.0, 1.0], abs=0.1)


def test_tiles_lie_within_the_first_image_whatever_the_size_of_the_second():
    rng, size, reach = np.random.default_rng(6), (16, 20), (3, 2)
    large, small = (ArrayImage(rng.normal(size=shape).astype(np.float32)) for shape in ((150, 170), (80, 90)))
    within, beyond = np.array([[40.5, 44.5]]), np.array([[120.5, 130.5]])
    still = np.zeros((1, 2, 2))
    for a, b, counts in ((large, small, (1, 1)), (small, large, (1, 0))):
        for point, count in zip((within, beyond), counts, strict=True):
            tiles_a, tiles_b = _tiles((a, b), point, within, still, size, reach)
            assert len(tiles_a) == len(tiles_b) == count


def test_a_smooth_spectrum_is_known_beyond_where_it_was_measured():
    """Logarithms of sixth order in the squares of frequencies, from their values at low ones."""
    fy, fx = np.meshgrid(np.fft.fftfreq(24), np.fft.rfftfreq(40), indexing="ij")

    def spectrum(y, x):
        p, q = y**2, x**2
        return np.exp(
            2.0 - 0.7 * np.log(p + q + 4e-4) + 3.0 * p - 5.0 * q + 8.0 * p * q - 6.0 * p**2 + 9.0 * q**2
            + 20.0 * p**3 - 15.0 * q**3 + 12.0 * p * q * (p + q)
        )  # fmt: skip

    use = (np.abs(fy) < 0.4) & (fx < 0.4) & (fy**2 + fx**2 > 0.0)
    values = np.where(use, spectrum(fy, fx), np.nan)
    found = _smooth_log(values, fy, fx, use, 1.0 + np.abs(fy) + fx)
    wanted = spectrum(*np.meshgrid(np.fft.fftfreq(64), np.fft.rfftfreq(64), indexing="ij"))
    # what singular values below 1e-8 of the largest would have told
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_the_phase_of_a_texture_that_runs_aslant_tells_both_its_shifts():
    """Spectra in closed form; the two shifts go together where only frequencies along a diagonal are seen."""
    tile = (16, 64)
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    signal = np.exp(-(((fy - fx) / 0.1) ** 2))
    shift = np.array([[0.4, -0.3], [-0.9, 0.7], [0.0, 0.45]])
    turns = fy[None] * shift[:, :1, None] + fx[None] * shift[:, 1:, None]
    found = _phase_shift(signal * np.exp(-2j * np.pi * turns), signal + 3.0, tile)
    # Newton steps that settle
    np.testing.assert_allclose(found, shift, atol=1e-6)
