"""What the kept matches can see, against least squares on the very rows they make."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.evaluation.observed import observed

ROWS, STEP, LAG, SIGMA_PX, IFOV, HALF_FIELD = 2000, 2e-3, 0.025, 0.05, 5e-6, 500.0
FIELD = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
SCALE = np.array([IFOV, IFOV, 1.0 / HALF_FIELD])


def recovery(weight=1.0, duration=0.0):
    """One pair of images: five windows per row, each seeing roll across, pitch and yaw along."""
    t_hub = np.repeat(STEP * np.arange(ROWS), FIELD.size)
    field = np.tile(FIELD, ROWS)
    slope = np.zeros((t_hub.size, 1, 2, 3))
    slope[:, 0, 1, 0] = 1.0 / IFOV
    slope[:, 0, 0, 1] = 1.0 / IFOV
    slope[:, 0, 0, 2] = HALF_FIELD * field
    present = np.ones((t_hub.size, 1), dtype=bool)
    star = SimpleNamespace(
        tdi_hub=None,
        hub=0,
        images=(1,),
        t_hub=t_hub,
        t=t_hub[:, None] + LAG,
        duration=duration,
        covariance_px=np.broadcast_to(SIGMA_PX**2 * np.eye(2), (t_hub.size, 1, 2, 2)),
        by_hub=-slope,
        by_partner=slope,
        correlation=np.eye(2),
        stretches=lambda: [slice(0, t_hub.size)],
        weight=np.full((t_hub.size, 1), weight),
        present=present,
    )
    motion = SimpleNamespace(t=STEP * np.arange(ROWS))
    return SimpleNamespace(records=(SimpleNamespace(star=star),), scale=SCALE, motion=motion, control=None)


def amplitude_sigma(frequency, sigma):
    """Of a tone fitted to differences of one axis with independent errors, by its normal equations."""
    t = STEP * np.arange(ROWS)
    phase = 2.0 * np.pi * frequency * np.array([t, t + LAG])
    rows = np.stack([np.diff(np.cos(phase), axis=0)[0], np.diff(np.sin(phase), axis=0)[0]], axis=1)
    return sigma * np.sqrt(np.trace(np.linalg.inv(rows.T @ rows)) / 2.0)


@pytest.mark.parametrize("frequency", [3.0, 17.0, 36.5, 61.0])
def test_the_sigma_of_a_tone_is_that_of_least_squares(frequency):
    found = observed(recovery(), np.array([frequency])).tone_sigma[0]
    per_row = np.array(
        [SIGMA_PX * IFOV / np.sqrt(5.0)] * 2 + [SIGMA_PX / HALF_FIELD / np.sqrt(np.sum(FIELD**2))]
    )
    expected = amplitude_sigma(frequency, per_row)
    # The sums over rows of cos^2 and sin^2 are half their number up to one period: 1 / (frequency * 4 s).
    assert found == pytest.approx(expected, rel=1.0 / (frequency * ROWS * STEP))


def test_half_the_weight_is_half_the_information():
    f = np.array([17.0])
    ratio = observed(recovery(weight=0.5), f).tone_sigma / observed(recovery(), f).tone_sigma
    assert ratio == pytest.approx(np.sqrt(2.0))


def test_the_passband_ends_at_the_blind_frequencies_of_the_lag():
    f = np.linspace(0.0, 100.0, 20_001)
    # So many matches that the lowest edge is that of one period per strip, not of noise.
    found = observed(recovery(weight=100.0), f)
    assert found.blind[0, 1] == pytest.approx([40.0, 80.0])
    for band in found.passbands:
        assert band[0][0] == pytest.approx(1.0 / (STEP * (ROWS - 1)), abs=f[1])
        assert band[0][1] < 40.0 < band[1][0] and band[1][1] < 80.0 < band[2][0]
    assert not found.seen[f == 40.0].any() and found.seen[f == 20.0].all()


def test_a_window_that_spans_a_whole_period_sees_nothing_of_it():
    found = observed(recovery(duration=0.05), np.array([20.0 - 1e-9, 10.0]))
    assert found.tone_sigma[0].min() > 1e6 * found.tone_sigma[1].max() / 500.0
    assert not found.seen[0].any() and found.seen[1].all()
