"""Lopsided jitter within TDI stages displaces what is matched."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.matching.whitening import Whitening
from sightline.motion.measure.uneven_blur import displacement

PERIOD, STAGES = 5e-4, 16
T = np.arange(-100, 500) * PERIOD
FLAT = Whitening(np.zeros((7, 7)), np.zeros((7, 7)), coherence=np.full((64, 33), 0.5))


def found(roll_px, whitening=FLAT, stages=STAGES, finer=1.0):
    """Displacement (G, 2) of windows at rising times of a partner that rolls; the hub stands still."""
    flight = Trajectory.level_flight(680e3, 6800.0, T[0], T[-1])
    detector = LineDetector.from_ifov("PAN", 100, 5e-6, PERIOD)
    cameras = [
        PushbroomCamera(
            detector, flight.with_motion(Motion(T, 5e-6 * np.stack([roll, 0.0 * T, 0.0 * T], axis=1))),
            FixedMount(), 0.0, 400, stages=stages,
        )
        for roll in (0.0 * T, roll_px)
    ]  # fmt: skip
    t = PERIOD * np.arange(20.0, 380.0, 7.0)
    pixels = np.stack([t / PERIOD, np.full(len(t), 50.0)], axis=1)
    by = np.zeros((len(t), 2, 3), dtype=np.float32)
    by[:, 1, 0] = finer / 5e-6
    affine = np.tile(finer * np.eye(2), (len(t), 1, 1))
    return t, displacement(cameras, (0, 1), (pixels, pixels), (t, t), (by, by), affine, whitening)


def test_the_shift_is_the_third_moment_of_a_small_motion():
    # phase of E exp(i q d) = -q^3 E d^3 / 6; a flat weight over the frequencies fits q s to it
    roll = 0.08 * np.sin(2.0 * np.pi * 50.0 * T) + 0.05 * np.cos(2.0 * np.pi * 90.0 * T)
    t, shift = found(roll)
    stage = (np.arange(STAGES) - (STAGES - 1) / 2) * PERIOD
    d = np.interp(t[:, None] + stage, T, roll)
    third = ((d - d.mean(axis=1, keepdims=True)) ** 3).mean(axis=1)
    ratio = shift[:, 1] @ third / (third @ third)
    q = 2.0 * np.pi * np.arange(0, 29, 4) / 64.0
    assert_allclose(ratio, -(q**4).sum() / (q**2).sum() / 6.0, rtol=0.05)
    assert_allclose(shift[:, 1], ratio * third, atol=0.05 * np.abs(shift[:, 1]).max())
    assert np.abs(shift[:, 0]).max() < 1e-9


def test_there_is_none_without_tdi_and_none_is_claimed_without_weights():
    roll = 0.3 * np.sin(2.0 * np.pi * 50.0 * T)
    assert not found(roll, stages=None)[1].any()
    assert not found(roll, whitening=None)[1].any()


def test_motion_that_the_stages_average_away_is_not_relied_on():
    hidden = 0.5 * np.sin(2.0 * np.pi / (STAGES * PERIOD) * T)
    assert np.abs(found(hidden)[1]).max() < 1e-3


def test_the_same_motion_displaces_as_far_on_the_hub_whatever_the_pixels_of_the_partner():
    roll = 0.3 * np.sin(2.0 * np.pi * 50.0 * T) + 0.2 * np.cos(2.0 * np.pi * 90.0 * T)
    like = found(roll)[1]
    assert np.abs(like).max() > 1e-3
    assert_allclose(found(roll, finer=4.0)[1], like, rtol=1e-6, atol=1e-12)
