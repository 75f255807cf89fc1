"""Smear, what lies above the band, and tones of a recovered strip."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.evaluation.microvibration import line_smear, microvibration
from sightline.geometry.trajectory import Motion
from sightline.io.formats.tables import read_columns, read_motion


def test_the_smear_of_a_tone_is_its_speed_times_the_line_period(recovery):
    result = recovery.result
    t = result.motion.t
    roll = 2.0 * result.ifov * np.sin(2 * np.pi * 40.0 * t)
    angles = np.stack([roll, np.zeros_like(t), np.zeros_like(t)], axis=1)
    smear = line_smear(replace(result, motion=Motion(t, angles, result.motion.covariance)))
    # 2 px at 40 Hz move 503 px/s, 0.251 px in 0.5 ms; half the difference of two lines lacks (w Te)^2 / 6
    assert np.abs(smear.px[1:-1, 0]).max() == pytest.approx(0.2513, rel=0.005)
    assert not smear.px[:, 1:].any()
    # a smear of 0.25 px leaves sinc(0.125) = 0.974 of the contrast at its worst, half of the loss on average
    assert smear.mtf_at_nyquist[0] == pytest.approx(1.0 - 0.5 * 0.0257, abs=1e-3)


def test_the_smear_is_as_wrong_as_its_sigma_says(recovery):
    result = recovery.result
    truth = read_motion(recovery.scene / "truth.csv")
    true = np.gradient(truth.angles / result.scale, axis=0)
    smear = line_smear(result)
    # a drift is hidden, and with it an even smear
    error = (smear.px - true)[20:-20]
    ratio = np.std(error, axis=0) / smear.sigma_px
    # one strip of 640 lines: half of it is motion of 150 Hz and more, which nothing shows, by a fitted size
    assert ((ratio > 0.5) & (ratio < 1.6)).all(), ratio


def test_what_lies_above_the_band_is_what_the_fitted_spectrum_holds_there(recovery):
    spectrum = Spectrum((Matern(1e-6, 0.01, "3/2"), Tone(3e-7, 300.0, 1.0), Tone(5e-7, 40.0, 1.0)))
    result = replace(recovery.result, spectra=(spectrum, spectrum, spectrum))
    bands = {axis: [(2.0, 100.0)] for axis in ("roll", "pitch", "yaw")}
    edge, rms = microvibration(result, (), bands).above["roll"]
    f = np.arange(100.0, 200_000.0, 0.5)
    expected = np.trapezoid(spectrum.without_tones.psd(f), f) + 9e-14
    assert edge == 100.0
    assert rms == pytest.approx(np.sqrt(expected), rel=1e-3)


def test_the_summary_and_the_table_hold_it(recovery):
    found = json.loads((recovery.folder / "summary.json").read_text())["microvibration"]
    assert set(found) == {"tones", "close_pairs", "above_passband", "smear_px"}
    table = read_columns(
        recovery.folder / "smear.csv",
        ("t", "roll", "pitch", "yaw", "sigma_roll", "sigma_pitch", "sigma_yaw"),
    )
    rms = np.sqrt(np.mean(np.square(table["roll"])))
    assert rms == pytest.approx(found["smear_px"]["roll"]["rms"], rel=1e-6)
    assert len(table["t"]) == 640


def test_the_smear_of_tdi_is_that_within_its_stages(recovery):
    result = recovery.result
    t = result.motion.t
    # an even motion of 0.01 px per line moves 0.16 px within 16 stages
    angles = 0.01 * result.ifov * np.arange(len(t))[:, None] * np.array([[1.0, 0.0, 0.0]])
    camera = replace(result.cameras[0], stages=16)
    tdi = replace(
        result, motion=Motion(t, angles, result.motion.covariance), cameras=(camera, *result.cameras[1:])
    )
    smear = line_smear(tdi)
    assert smear.px[20:-20, 0] == pytest.approx(0.16, rel=0.01)
    assert (smear.sigma_px > line_smear(result).sigma_px).all()
