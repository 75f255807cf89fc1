"""Jitter within TDI stages displaces what is matched where it is lopsided, or grows from line to line."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.matching.whitening import Whitening
from sightline.motion.measure.uneven_blur import (
    STEEP,
    _is_steep,
    _shifts,
    _slopes_of_stages,
    displacement,
)

PERIOD, STAGES = 5e-4, 16
T = np.arange(-100, 500) * PERIOD
FLAT = Whitening(np.zeros((7, 7)), np.zeros((7, 7)), coherence=np.full((64, 33), 0.5))


def found(roll_px, whitening=FLAT, stages=STAGES, finer=1.0, axis=0, yaw=0.0, lines=1.0, offsets=None):
    """Displacement (G, 2) of windows at rising times of a partner that rolls; the hub stands still.

    Pitch in place of roll with `axis` 1; the partner is turned by a constant `yaw`, rad. With `offsets`, how
    it changes besides.
    """
    angles = [
        5e-6 * np.stack([one if k == axis else 0.0 * T for k in range(3)], axis=1)
        for one in (0.0 * T, roll_px)
    ]
    angles[1][:, 2] += yaw
    flight = Trajectory.level_flight(680e3, 6800.0, T[0], T[-1])
    detector = LineDetector.from_ifov("PAN", 100, 5e-6, PERIOD)
    cameras = [
        PushbroomCamera(detector, flight.with_motion(Motion(T, one)), FixedMount(), 0.0, 400, stages=stages)
        for one in angles
    ]
    t = PERIOD * np.arange(20.0, 380.0, 7.0)
    pixels = np.stack([t / PERIOD, np.full(len(t), 50.0)], axis=1)
    by = np.zeros((len(t), 2, 3), dtype=np.float32)
    by[:, 1 - axis, axis] = finer / 5e-6
    affine = np.tile(finer * np.eye(2), (len(t), 1, 1))
    shift, changes = displacement(
        cameras, (0, 1), (pixels, pixels), (t, t), (by, by), affine, whitening, lines, offsets=offsets
    )
    return (t, shift) if offsets is None else (t, shift, changes)


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


def test_it_changes_with_a_motion_as_the_third_moment_does():
    # beside d a small e adds 3 E d^2 e to E d^3, both less their means: of a tone that the mean hides as well
    roll = 0.08 * np.sin(2.0 * np.pi * 50.0 * T)
    offsets = PERIOD * np.arange(-10.0, 11.0)
    t, _, changes = found(roll, offsets=offsets)
    more = np.cos(2.0 * np.pi / (STAGES * PERIOD) * T)
    added = 5e-6 * np.interp(t[:, None] + offsets, T, more)
    change = np.einsum("gb,gcb->gc", added, changes[:, 1, :, 0])
    stage = (np.arange(STAGES) - (STAGES - 1) / 2) * PERIOD
    d, e = (np.interp(t[:, None] + stage, T, one) for one in (roll, more))
    d, e = d - d.mean(axis=1, keepdims=True), e - e.mean(axis=1, keepdims=True)
    q = 2.0 * np.pi * np.arange(0, 29, 4) / 64.0
    moment = -(q**4).sum() / (q**2).sum() / 2.0 * (d**2 * e).mean(axis=1)
    assert_allclose(change[:, 1], moment, atol=0.05 * np.abs(moment).max())
    assert np.abs(change[:, 0]).max() < 1e-6
    # the hub, which stands still here, moves what is seen the other way, in its own blur: none
    assert np.abs(np.einsum("gb,gcb->gc", added, changes[:, 0, :, 0])).max() < 0.2 * np.abs(moment).max()
    # a motion alike in all stages adds nothing
    assert_allclose(changes.sum(axis=-1), 0.0, atol=1e-4 * np.abs(changes).max())


@pytest.mark.parametrize("axis", [0, 1])
def test_it_changes_with_a_motion_as_differences_of_displacements_do(axis):
    # through a filter that compares lines, whose slopes let change from line to line count
    size = 64
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size))
    taps = Whitening.from_response(np.hypot(f, 0.05) * np.exp(-0.5 * (f / 0.35) ** 2)).taps_a
    whitening = Whitening(taps, taps, coherence=np.full((size, 33), 0.5))
    offsets = PERIOD * np.arange(-16.0, 17.0)
    base, more = 0.3 * np.sin(2.0 * np.pi * 47.0 * T), np.sin(2.0 * np.pi * 121.0 * T + 0.3)
    t, _, changes = found(base, whitening, axis=axis, offsets=offsets, lines=9.0)
    step = 1e-3
    ahead, behind = (
        found(base + by * more, whitening, axis=axis, offsets=offsets, lines=9.0)[1] for by in (step, -step)
    )
    slope = (ahead - behind) / (2.0 * step)
    added = 5e-6 * np.interp(t[:, None] + offsets, T, more)
    change = np.einsum("gb,gcb->gc", added, changes[:, 1, :, axis])
    # cubic weights of four instants, 1 ms apart: 2 % of waves of 121 Hz
    assert_allclose(change, slope, atol=0.03 * np.abs(slope).max())
    assert np.abs(slope).max() > 5e-3


def test_the_same_motion_displaces_as_far_on_the_hub_whatever_the_pixels_of_the_partner():
    roll = 0.3 * np.sin(2.0 * np.pi * 50.0 * T) + 0.2 * np.cos(2.0 * np.pi * 90.0 * T)
    like = found(roll)[1]
    assert np.abs(like).max() > 1e-3
    assert_allclose(found(roll, finer=4.0)[1], like, rtol=1e-6, atol=1e-12)


def test_a_constant_yaw_skews_the_stages_of_a_tone():
    # the third moment of both: a stage so many lines late lies so many pixels of the turn aside
    roll, yaw = 0.08 * np.sin(2.0 * np.pi * 50.0 * T), 0.02
    t, shift = found(roll, yaw=yaw)
    late = np.arange(STAGES) - (STAGES - 1) / 2
    d = np.interp(t[:, None] + late * PERIOD, T, roll)
    q = 2.0 * np.pi * np.arange(0, 29, 4) / 64.0
    per_moment = -(q**4).sum() / (q**2).sum() / 6.0
    for sign, close in ((-1.0, True), (1.0, False)):
        moved = d - d.mean(axis=1, keepdims=True) + sign * yaw * late
        moment = per_moment * (moved**3).mean(axis=1)
        off = np.abs(shift[:, 1] - moment).max() / np.abs(moment).max()
        assert (off < 0.05) == close, (sign, off)


def test_frequencies_count_by_what_a_sharp_image_shows_of_them():
    # coherence is alike at all frequencies of images that a roll of .6 px and a skew smear: before there
    # was more of the fine ones. Least squares on the phases of all frequencies of a match, and without that
    roll, yaw = 0.6 * np.sin(2.0 * np.pi * 50.0 * T), 0.06
    t, shift = found(roll, yaw=yaw)
    late = np.arange(STAGES) - (STAGES - 1) / 2
    d = np.interp(t[:, None] + late * PERIOD, T, roll)
    d += -d.mean(axis=1, keepdims=True) - yaw * late
    step = 2.0 * np.pi * 4.0 / 64.0
    q = np.repeat(step * np.arange(1, 8), 15)  # across, with each of the frequencies along
    seen = np.exp(1j * q[:, None, None] * d).mean(axis=2)
    off = []
    for weight in (1.0 / np.abs(seen).mean(axis=1), np.ones(len(q))):
        fitted = np.zeros(len(t))
        for _ in range(6):
            left = np.imag(seen * np.exp(-1j * q[:, None] * fitted))
            fitted += (weight * q) @ left / ((weight * q * q) @ np.abs(seen))
        off.append(np.abs(shift[:, 1] - fitted).max() / np.abs(fitted).max())
    assert off[0] < 0.03 and off[1] > 0.08


def test_a_window_shows_the_mean_over_its_lines():
    # the third moment of 30 Hz holds 30 and 90 Hz: of these a mean over 18 lines leaves .88 and .22
    roll = 0.08 * np.sin(2.0 * np.pi * 30.0 * T)
    t, high = found(roll, lines=18.0)
    _, one = found(roll)
    waves = np.stack([f(2.0 * np.pi * r * t) for r in (30.0, 90.0) for f in (np.cos, np.sin)], axis=1)
    fitted, expected = (np.linalg.lstsq(waves, shift[:, 1], rcond=None)[0] for shift in (high, one))
    left = np.sinc(np.repeat([30.0, 90.0], 2) * 18.0 * PERIOD)
    # three points of a cosine of 2.5 rad to either side: 1 % of it, and of waves beside these 2 %
    assert_allclose(fitted, left * expected, atol=0.03 * np.abs(expected).max())
    assert np.abs(expected[2:]).max() > 0.1 * np.abs(expected).max()


def test_a_filter_takes_blur_that_grows_from_line_to_line_for_a_displacement():
    # lines of random phases, seen stage by stage, filtered, and least squares on them: what is expected of
    # each line, of a motion less its mean over the stages
    size, period, lines = 64, PERIOD, np.arange(20, 380, 7)
    which = np.arange(4, 29, 4)  # as they are sampled
    frequency = 2.0 * np.pi * which / size
    power = 1.0 / frequency**2
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size))
    taps = Whitening.from_response(np.hypot(f, 0.05) * np.exp(-0.5 * (f / 0.35) ** 2)).taps_a
    response = Whitening(taps, taps).response()[which, 0]
    pitch = 0.4 * np.sin(2.0 * np.pi * 47.0 * T)
    stage = (np.arange(STAGES) - (STAGES - 1) / 2) * period
    every = np.arange(lines[0] - 7, lines[-1] + 8)
    d = np.interp(every[:, None] * period + stage, T, pitch)
    d -= d.mean(axis=1, keepdims=True)
    seen = np.exp(-1j * d[:, :, None] * frequency).mean(axis=1)

    coherence = np.zeros((size, 33))
    weight = power * response**2 * np.abs(seen).mean(axis=0)  # coherence is that of the blurred images
    weight = 0.9 * weight / weight.max()
    coherence[which, 0] = coherence[-which, 0] = weight / (1.0 + weight)
    coherence[:, 1:] = 1e-9  # det > 0
    whitening = Whitening(taps, taps, coherence=coherence)
    _, shift = found(pitch, whitening, axis=1)
    along = taps.astype(float) @ np.where(np.arange(7) == 0, 1.0, 2.0)  # over columns
    filtered = sum(
        along[abs(o)] * seen[7 - o : len(seen) - 7 - o] * np.exp(-1j * frequency * o) for o in range(-6, 7)
    )
    size = (power * frequency**2 * response**2 * np.abs(seen[7:-7])).sum(axis=1)
    whole = (power * frequency * response * np.imag(-filtered)).sum(axis=1) / size
    lopsided = (power * frequency * response**2 * np.imag(-seen[7:-7])).sum(axis=1) / size
    whole, lopsided = whole[::7], lopsided[::7]
    assert np.abs(whole - lopsided).max() > 5e-4
    # the next order of the product of filter and blur is left
    assert_allclose(shift[:, 0], whole, atol=1e-4)


def test_the_shift_lies_within_what_stages_moved_by_and_climbs_however_large_the_motion():
    """Frequencies are multiples of one: what fits recurs every 16 px, and a step of no bound lands there."""
    rng = np.random.default_rng(0)
    along, across = (2.0 * np.pi * f[np.abs(f) < 0.45] for f in (np.fft.fftfreq(16), np.fft.rfftfreq(16)))
    frequency = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = 1.0 / (0.05 + (frequency**2).sum(axis=1))
    late = np.linspace(0.0, 1.0, 16)
    shown, most = np.ones((1100, len(weight)), dtype=complex), np.zeros(1100)
    for n in range(len(shown)):
        for side in (1.0, -1.0):  # hub and partner, about two modes each
            places = np.zeros((16, 2))
            for _ in range(2):
                size, cycles, phase = rng.normal(size=2), rng.uniform(0.5, 2.5), rng.uniform()
                places += 0.8 * size * np.sin(2.0 * np.pi * (late * cycles + phase))[:, None]
            places -= places.mean(axis=0)
            most[n] += np.abs(places).max()
            shown[n] *= np.exp(side * 1j * frequency @ places.T).mean(axis=1)
    shift = np.zeros((len(shown), 2))
    _shifts(shown.real.copy(), shown.imag.copy(), frequency, weight, shift)
    assert (np.abs(shift).max(axis=1) < most).all()
    here = (weight * (shown * np.exp(-1j * shift @ frequency.T)).real).sum(axis=1)
    none = (weight * shown.real).sum(axis=1)
    assert (here >= none - 1e-9 * np.abs(none)).all()


def test_a_fit_is_steep_where_it_is_in_its_flattest_direction():
    rng = np.random.default_rng(1)
    for least in (0.5 * STEEP, 0.95 * STEEP, 1.05 * STEEP, 0.9):
        root, turn = rng.normal(size=(2, 2)), np.linalg.qr(rng.normal(size=(2, 2)))[0]
        a, c = root @ root.T, root @ turn @ np.diag([least, 1.0]) @ turn.T @ root.T
        steep = _is_steep(c[0, 0], c[0, 1], c[1, 1], a[0, 0], a[0, 1], a[1, 1])
        assert steep == (least > STEEP)


def test_the_pull_at_a_shift_changes_with_stages_as_its_derivatives_say():
    """Frequencies times the imaginary part of what a filter shows, of second order in the changes."""
    rng, stages = np.random.default_rng(7), 3
    y, x = 2.0 * np.pi * np.fft.fftfreq(7), 2.0 * np.pi * np.fft.rfftfreq(10)[:5]
    by_y, by_x = (part.ravel() for part in np.meshgrid(y, x, indexing="ij"))
    first, second = rng.normal(size=(2, 35))
    pull = rng.normal(size=35) + 1j * rng.normal(size=35)
    moved = rng.uniform(-0.6, 0.6, (stages, 3, 2))

    def pulled(place, change, bend):
        along = [by_y * one[0] + by_x * one[1] for one in (place, change, bend)]
        # a filter of slopes takes i d / dt, and half of - d^2 / dt^2, of exp(i phase)
        shown = 1.0 - first * along[1] - 0.5 * second * (1j * along[2] - along[1] ** 2)
        each = (pull * np.exp(1j * along[0]) * shown).imag
        return np.array([each @ by_y, each @ by_x])

    out, rooms = np.empty((stages, 3, 3)), (np.empty(4, complex), np.empty(5, complex))
    plain = getattr(_slopes_of_stages, "py_func", _slopes_of_stages)
    plain(moved, stages, y, x, np.stack([first, second], axis=1), pull, *rooms, out)
    h = 1e-5
    for s in range(stages):
        for order in range(3):
            slope = np.empty((2, 2))
            for axis in range(2):
                ends = []
                for sign in (1.0, -1.0):
                    at = moved[s].copy()
                    at[order, axis] += sign * h
                    ends.append(pulled(*at))
                slope[axis] = (ends[0] - ends[1]) / (2.0 * h)
            # central differences: h^2 and rounding / h, of sums of 35 numbers of some ten
            assert_allclose(out[s, order], [slope[0, 0], slope[0, 1], slope[1, 1]], rtol=0.0, atol=1e-6)
            assert_allclose(slope[0, 1], slope[1, 0], rtol=0.0, atol=1e-6)
