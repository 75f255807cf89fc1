"""Rendered pixels against rays and light worked out by hand, without the package's geometry."""

import numpy as np
import pytest

from sightline.simulate.scenarios import line_of_sight_case
from sightline.simulate.scene import BandShine, Relief, Scene, relief_at
from sightline.simulate.sensor import Radiometry, footprint, render_block, render_chunks
from sightline.simulate.texture import TextureLayer, padded, spline_response

H, V, IFOV, TE = 680e3, 6800.0, 5e-6, 5e-4


def hand_ground(t, angles, columns, look_ahead, offset_px, rotation, height=0.0):
    """x, y of one line on the plane z = height: Rodrigues' turn of each look direction, by hand."""
    j = np.arange(columns) - (columns - 1) / 2
    across = IFOV * (j * np.cos(rotation) + offset_px[1])
    along = np.tan(look_ahead) + IFOV * (j * np.sin(rotation) + offset_px[0])
    # camera (columns, lines, depth) -> body (forward, right, down): columns increase to the left
    v = np.stack([along, -across, np.ones_like(across)], axis=1)
    angle = np.linalg.norm(angles)
    k = angles / angle
    turned = (
        v * np.cos(angle)
        + np.cross(np.broadcast_to(k, v.shape), v) * np.sin(angle)
        + np.outer(v @ k, k) * (1.0 - np.cos(angle))
    )
    forward, right, down = turned.T
    return (H - height) * right / down, V * t + (H - height) * forward / down


def sinusoid(wave_x, wave_y):
    """A layer that is 0.2 sin(2 pi (x / wave_x + y / wave_y)), its period 16 waves."""
    n = 320  # 20 knots per wave: the spline's images are 8e-6 of the amplitude
    p = np.arange(n) / 20.0
    phase = 2 * np.pi * (p[None, :] + p[:, None])
    gain = 0.2 / spline_response(np.array(0.05)) ** 2
    return TextureLayer(padded((gain * np.sin(phase)).astype(np.float32)), (wave_x / 20.0, wave_y / 20.0))


@pytest.fixture(scope="module")
def strip():
    return line_of_sight_case("nominal", 11, lines=300, columns=200)


@pytest.mark.parametrize("band", [0, 3])
def test_a_known_texture_appears_where_the_hand_formula_says(strip, band):
    wave_x, wave_y = 37.0, 29.0
    scene = Scene(sinusoid(wave_x, wave_y), (BandShine(None),) * 4)
    block = render_block(strip.cameras[band], scene, band, (120, 140), 200)
    truth = strip.bands[band]
    for row, line in enumerate(range(120, 140)):
        t = line * TE
        angles = strip.motion.angles[np.abs(strip.motion.t - t).argmin()]
        x, y = hand_ground(t, angles, 200, truth.look_ahead, truth.offset_px, truth.rotation)
        expected = 1.0 + 0.2 * np.sin(2 * np.pi * (x / wave_x + y / wave_y))
        # float32 of the spline and its images: 2e-5; a hundredth of a pixel would be 0.0015
        np.testing.assert_allclose(block[row], expected, atol=2e-5)


def test_a_look_behind_sees_the_same_ground_one_lag_later(strip):
    for truth in strip.bands:
        assert np.tan(truth.look_ahead) == pytest.approx(-V * truth.lag / H, abs=1e-15)
    nominal = [footprint(camera, (0, 300), 200, None) for camera in strip.nominal_cameras]
    # 22.2 ms (44.4 lines) between B1 and B2
    assert nominal[1].y[0, 100] == pytest.approx(nominal[3].y[0, 100] + 0.0222 * V, abs=1e-3)
    assert nominal[3].y[200, 100] == pytest.approx(nominal[1].y[200 - 44, 100] - 0.4 * TE * V, abs=1e-3)


def test_a_hill_moves_between_bands_by_its_parallax(strip):
    # the top is a table of height Z: in the band of lag tau it is seen Z tau / (H Te) lines early
    table = np.zeros((120, 120))
    table[20:100, 20:100] = 300.0
    relief = Relief(table, -1800.0, 1800.0, (30.0, 30.0))
    on_hill = footprint(strip.nominal_cameras[3], (100, 200), 200, relief)
    on_plane = footprint(strip.nominal_cameras[3], (100, 200), 200, None)
    assert np.all(on_hill.z == 300.0)
    shift_lines = (on_hill.y - on_plane.y) / (V * TE)
    # 300 m x 172.2 ms / (680 km x 0.5 ms) = 0.152 lines further forward at the same line
    np.testing.assert_allclose(shift_lines, 300.0 * 0.1722 / (H * TE), rtol=1e-6)


def test_rays_stop_on_the_bilinear_relief(strip):
    rng = np.random.default_rng(4)
    relief = Relief(rng.normal(0.0, 40.0, (60, 60)), -900.0, 900.0, (30.0, 30.0))
    seen = footprint(strip.cameras[3], (20, 60), 200, relief)
    np.testing.assert_allclose(relief_at(relief, seen.x, seen.y), seen.z, atol=1e-6)
    # and each ray is the straight one of the plane case
    plane = footprint(strip.cameras[3], (20, 60), 200, None)
    x, y = seen.at_height(0.0)
    np.testing.assert_allclose(x, plane.x, atol=1e-6)
    np.testing.assert_allclose(y, plane.y, atol=1e-6)


def test_the_noise_has_the_snr_asked_for_and_grows_with_the_light():
    radiometry = Radiometry(mean_dn=1200.0, snr=120.0)
    rng = np.random.default_rng(0)
    for level in (600.0, 1200.0, 2400.0):
        flat = np.full((500, 500), level, dtype=np.float32)
        spread = radiometry.digitise(flat, 1200.0, rng).astype(float).std()
        # 10 DN at the mean, 80 % of the variance from photons; rounding adds 1/12
        expected = np.sqrt(100.0 * (0.2 + 0.8 * level / 1200.0) + 1.0 / 12.0)
        assert spread == pytest.approx(expected, rel=0.01)  # 250 000 draws: sd 0.14 %


def test_numbers_stay_within_twelve_bits():
    rng = np.random.default_rng(0)
    bright = Radiometry().digitise(np.full((10, 10), 9000.0, dtype=np.float32), 1200.0, rng)
    dark = Radiometry().digitise(np.full((10, 10), -50.0, dtype=np.float32), 1200.0, rng)
    assert bright.max() == 4095 and dark.min() == 0


def test_the_noise_of_a_rendered_band_is_the_one_asked_for(strip):
    image = strip.image(1).astype(float)
    clean = render_block(strip.cameras[1], strip.scene, 1, (0, 300), 200) * 1200.0
    residual = image - clean
    # band mean 1020 DN over SNR 120: 8.5 DN at the mean; scaled by each pixel's own light
    expected = np.sqrt((1020.0 / 120.0) ** 2 * (0.2 + 0.8 * clean / 1020.0) + 1.0 / 12.0)
    assert (residual / expected).std() == pytest.approx(1.0, rel=0.01)  # 60 000 draws: sd 0.3 %


def test_a_band_asked_for_twice_is_the_same(strip):
    seed = np.random.SeedSequence(9)
    twice = [
        np.concatenate(
            [
                block
                for _, block in render_chunks(
                    strip.cameras[0], strip.scene, 0, (100, 200), Radiometry(), seed
                )
            ]
        )
        for _ in range(2)
    ]
    np.testing.assert_array_equal(*twice)
