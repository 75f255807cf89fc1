"""A strip imaged by brute force: sinusoids by the closed forms, noise by its law, wells, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError
from sightline.imaging.mtf import aperture_mtf, diffusion_mtf
from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure, drift_transfer, motion_transfer
from sightline.simulate.tdi_strip import (
    FineScene,
    StripSettings,
    exposed_stages,
    one_setting,
    read_strip,
)
from sightline.simulate.tdi_target import FLAT, LEVEL, SHAPE, tdi_target
from sightline.tdi.setting import TdiDetector

PER_PIXEL, MARGIN, PIXELS = 8, 16, 16
#: Pixels of the whole scene: sinusoids of whole periods in it repeat, as the blur by Fourier transform needs.
WHOLE = PIXELS + 2 * MARGIN
#: The midpoint rule over 16 instants of half a cycle: (pi / 2 / 16)^2 / 6; as much again for interpolating
#: between cells, an eighth of a pixel apart (cubic, third order: below (pi / 8)^3 / 60).
TOLERANCE = 3e-3


def wave(periods_x, periods_y, phase):
    """Scene 1 + cos, with that many periods in its width and height, as means over cells."""
    places = (np.arange(WHOLE * PER_PIXEL) + 0.5) / PER_PIXEL - 0.5 - MARGIN
    fx, fy = periods_x / WHOLE, periods_y / WHOLE
    cell = np.sinc(fx / PER_PIXEL) * np.sinc(fy / PER_PIXEL)
    turn = 2.0 * np.pi * (fx * places[None, :] + fy * places[:, None]) + phase
    return FineScene(1.0 + cell * np.cos(turn), PER_PIXEL, MARGIN)


def response(periods_x, periods_y, settings, detector, blur=(0.0, 0.0), aperture=(0.0, 0.0)):
    """Complex contrast (lines, columns) of a sinusoid, relative to its phase at each pixel."""
    parts = []
    for phase in (0.0, -0.5 * np.pi):
        scene = wave(periods_x, periods_y, phase).blurred(blur, aperture)
        parts.append(read_strip(exposed_stages(scene, settings, detector), settings, detector, 100.0))
    line, column = np.mgrid[:PIXELS, :PIXELS]
    still = np.exp(2j * np.pi * (periods_x * column + periods_y * line) / WHOLE)
    return (parts[0].radiance - 1.0 + 1j * (parts[1].radiance - 1.0)) / still


class TestImage:
    @pytest.mark.parametrize("align", ["centre", "start", "end"])
    @pytest.mark.parametrize(("periods_x", "periods_y"), [(24, 0), (0, 24), (13, 17), (-9, 22)])
    def test_sinusoids_keep_the_contrast_of_the_closed_form(self, periods_x, periods_y, align):
        exposure = Exposure(3, 0.2, align)
        velocity, slip, stages, ratio = 1.012, np.radians(1.5), 20, 0.9
        settings = one_setting(PIXELS, stages, ratio, velocity, slip)
        found = response(periods_x, periods_y, settings, TdiDetector(exposure))
        fx, fy = periods_x / WHOLE, periods_y / WHOLE
        # lines of the image grow against the motion over the detector: hence the sign
        expected = drift_transfer(stages, ratio, velocity, slip, fx, -fy, exposure)
        assert_allclose(found, np.full((PIXELS, PIXELS), expected), atol=TOLERANCE)

    def test_blur_and_aperture_are_their_mtf(self):
        settings = one_setting(PIXELS, 1, 0.01, 1.0, 0.0)
        found = response(14, 20, settings, TdiDetector(), blur=(0.3, 0.5), aperture=(0.9, 0.7))
        fx, fy = 14 / WHOLE, 20 / WHOLE
        expected = diffusion_mtf(fx, 0.3) * diffusion_mtf(fy, 0.5)
        expected = expected * aperture_mtf(fx, 0.9) * aperture_mtf(fy, 0.7)
        assert_allclose(np.abs(found), np.full((PIXELS, PIXELS), expected), atol=TOLERANCE)

    def test_each_column_drifts_and_each_pixel_is_set_by_itself(self):
        velocity, slip = np.linspace(0.99, 1.01, PIXELS), np.linspace(-0.03, 0.03, PIXELS)
        stages = 5 + np.arange(PIXELS * PIXELS).reshape(PIXELS, PIXELS) % 17
        ratio = np.linspace(0.3, 1.0, PIXELS)[:, None] * np.ones(PIXELS)
        found = response(15, 0, StripSettings(stages, ratio, velocity, slip), TdiDetector())
        expected = drift_transfer(stages, ratio, velocity, slip, 15 / WHOLE, 0.0)
        assert_allclose(found, expected, atol=TOLERANCE)

    def test_a_motion_moves_every_line_at_its_own_time(self):
        stages, ratio, exposure = 12, 0.6, Exposure(2, 0.3)
        rng = np.random.default_rng(2)
        motion = 0.04 * np.cumsum(rng.normal(size=(PIXELS + stages + 2, 2)), axis=0)
        settings = StripSettings(
            np.full(PIXELS, stages),
            np.full(PIXELS, ratio),
            np.full(PIXELS, 1.003),
            np.full(PIXELS, 0.01),
            motion,
        )  # fmt: skip
        found = response(11, 20, settings, TdiDetector(exposure))
        for line in range(1, PIXELS):
            # along the image, lines grow against the motion: hence the sign
            expected = motion_transfer(
                stages, ratio, 1.003, 0.01, 11 / WHOLE, -20 / WHOLE, motion, line, exposure
            )
            assert_allclose(found[line], np.full(PIXELS, expected[0, -1]), atol=TOLERANCE)

    def test_radiance_does_not_depend_on_the_setting(self):
        scene = FineScene(np.ones((WHOLE * 2, WHOLE * 2)), 2, MARGIN)
        detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(dark=30.0))
        stages = np.arange(1, PIXELS + 1)[:, None] * np.ones(PIXELS, dtype=int)
        settings = StripSettings(stages, np.full(PIXELS, 0.8), np.ones(PIXELS), np.full(PIXELS, 0.02))
        strip = read_strip(exposed_stages(scene, settings, detector), settings, detector, 50.0)
        assert_allclose(strip.radiance, 1.0, rtol=1e-9)
        # 50 electrons in a head line of 0.25: 2 head lines, 14 of 0.8, and dark current
        assert_allclose(strip.electrons[-1], (200.0 + 30.0) * (2 * 0.25 + 14 * 0.8), rtol=1e-9)


class TestNoise:
    @pytest.mark.parametrize(
        "law",
        [
            NoiseLaw(),
            NoiseLaw(shot=0.0, gain=0.01),
            NoiseLaw(shot=3.0, read=20.0),
            NoiseLaw(shot=0.0, read=20.0),
            NoiseLaw(shot=0.0, dark=900.0),
            NoiseLaw(shot=0.0, output=150.0),
            NoiseLaw(shot=0.0, column_fixed=0.01),
            NoiseLaw(gain=1e-3, read=12.0, dark=50.0, output=40.0, column_fixed=1e-3),
        ],
    )
    def test_a_flat_scene_has_the_snr_of_the_law(self, law):
        lines, columns, stages, ratio = 12, 1500, 9, 0.7
        detector = TdiDetector(Exposure(2, 0.25), law)
        settings = one_setting(columns, stages, ratio, 1.0, 0.0)
        lengths = np.where(np.arange(stages) < 2, 0.25, ratio)
        exposed = np.broadcast_to(lengths, (lines, columns, stages))
        strip = read_strip(exposed, settings, detector, 60.0, np.random.default_rng(4))
        expected = snr(60.0, stages, ratio, law, detector.exposure)
        # variance of the whole, columns being independent of one another: 1500 values at least
        found = strip.radiance.mean() / strip.radiance.std()
        assert found == pytest.approx(float(expected), rel=4.0 / np.sqrt(2 * columns))
        assert strip.radiance.mean() == pytest.approx(1.0, abs=4.0 / expected / np.sqrt(columns))

    def test_what_a_column_keeps_is_common_to_its_lines(self):
        detector = TdiDetector(noise=NoiseLaw(shot=0.0, column_fixed=0.01))
        settings = one_setting(400, 4, 1.0, 1.0, 0.0)
        strip = read_strip(np.ones((6, 400, 4)), settings, detector, 60.0, np.random.default_rng(1))
        assert np.ptp(strip.radiance, axis=0).max() < 1e-12
        assert strip.radiance[0].std() == pytest.approx(0.1, rel=4.0 / np.sqrt(800))

    def test_full_wells_hold_no_more(self):
        settings = one_setting(3, 4, 1.0, 1.0, 0.0)
        exposed = np.ones((2, 3, 4)) * np.array([0.5, 1.0, 1.5])[:, None]
        line = read_strip(exposed, settings, TdiDetector(full_well_line=100.0), 100.0)
        assert_allclose(line.electrons[0], [200.0, 400.0, 400.0])
        assert line.saturated[0].tolist() == [False, False, True]
        total = read_strip(exposed, settings, TdiDetector(full_well_sum=399.0), 100.0)
        assert_allclose(total.electrons[0], [200.0, 399.0, 399.0])
        assert total.saturated[1].tolist() == [False, True, True]


class TestRefusals:
    SCENE = FineScene(np.ones((WHOLE * 2, WHOLE * 2)), 2, MARGIN)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            (one_setting(PIXELS - 1, 4, 1.0, 1.0, 0.0), "the scene has 16 columns"),
            (one_setting(PIXELS, 60, 1.0, 1.0, np.radians(15.0)), "the scene's margin is 16 px"),
            (StripSettings(np.ones(5), np.ones(16), np.ones(16), np.zeros(16)), r"\(16,\) or \(16, 16\)"),
            (
                StripSettings(np.full(16, 4), np.ones(16), np.ones(16), np.zeros(16), np.zeros((20, 2))),
                "covers 20 line periods; 16 lines of 4 stages need 21",
            ),
        ],
    )
    def test_what_cannot_be_imaged_is_refused(self, settings, message):
        with pytest.raises(InputError, match=message):
            exposed_stages(self.SCENE, settings, TdiDetector())


def test_the_target_is_what_it_is_said_to_be():
    target = tdi_target(3, per_pixel=4)
    assert target.shape == SHAPE
    pixels = target.radiance.reshape(SHAPE[0] + 32, 4, SHAPE[1] + 32, 4).mean(axis=(1, 3))[16:-16, 16:-16]
    top, bottom, left, right = FLAT
    assert_allclose(pixels[top:bottom, left:right], LEVEL)
    # every patch is as long and as wide as it says: just outside lies the surround
    assert not np.isclose(pixels[top - 1, left:right], LEVEL).any()
    assert (target.radiance > 0.0).all()
