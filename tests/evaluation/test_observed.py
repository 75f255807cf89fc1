"""What the kept matches can see, against least squares on the very rows they make."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.evaluation.observed import observed
from sightline.motion.measure.observations import Star

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


def test_some_of_very_many_windows_stand_for_all(monkeypatch):
    f = np.array([17.0])
    every = observed(recovery(), f).tone_sigma[0]
    monkeypatch.setattr("sightline.evaluation.observed.ENOUGH_WINDOWS", 2500)
    some = observed(recovery(), f).tone_sigma[0]
    # all windows tell the same of roll and pitch; of yaw the square of their place, .5 +- .42 in the mean of
    # five: half of three times .42 / .5 / sqrt(2500)
    assert some[:2] == pytest.approx(every[:2], rel=1e-6)
    assert some[2] == pytest.approx(every[2], rel=0.025) and some[2] != every[2]


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


def star_of_three(rng, tdi_s=None):
    """Windows (2 a row) in up to three partners: errors and sensitivities at random, some matches absent."""
    rows, pairs = 2000, 3
    count = 2 * rows
    t_hub = np.repeat(1e-3 * np.arange(rows), 2)
    by_hub = rng.choice([-1.0, 1.0], (pairs, 2, 3)) * rng.uniform(0.5e5, 1.5e5, (count, pairs, 2, 3))
    by_partner = rng.normal(0.0, 2e4, by_hub.shape) - by_hub
    root = SIGMA_PX * (np.eye(2) + np.tril(rng.uniform(-0.3, 0.3, (count, pairs, 2, 2))))
    mixed = rng.normal(size=(2 * pairs, 12 * pairs))
    residual = np.where(rng.random((count, pairs, 1)) < 0.3, np.nan, np.zeros((count, pairs, 2)))
    weight = np.where(rng.random((count, pairs)) < 0.1, 0.0, rng.uniform(0.3, 1.0, (count, pairs)))
    stages = None if tdi_s is None else np.tile(tdi_s, (count, 1))
    return Star(
        hub=0, images=(1, 2, 3), shape=(rows, 2), pixels=np.zeros((count, 2)), t_hub=t_hub,
        t=t_hub[:, None] + [0.013, -0.029, 0.08], duration=3e-3, residual_px=residual,
        covariance_px=root @ np.swapaxes(root, -1, -2), by_hub=by_hub.astype(np.float32),
        by_partner=by_partner.astype(np.float32), by_static=np.zeros((count, pairs, 2, 0), np.float32),
        by_height=np.zeros((count, pairs, 2), np.float32), field=np.zeros(count),
        correlation=mixed @ mixed.T / (12 * pairs), weight=weight,
        tdi_hub=None if stages is None else stages[:, 0], tdi=None if stages is None else stages[:, 1:],
    )  # fmt: skip


def dense_information(star, f):
    """(6, 6) of the amplitudes of cosine and sine of roll, pitch and yaw, window by window."""
    total = np.zeros((6, 6))
    for g, here in enumerate(star.present):
        pairs = np.flatnonzero(here)
        if not len(pairs):
            continue
        rows, root = [], np.zeros((2 * len(pairs), 2 * len(pairs)))
        for m, k in enumerate(pairs):
            row = 0.0
            for slope, t, stages in (
                (star.by_hub[g, k], star.t_hub[g], star.averaging()[0][g]),
                (star.by_partner[g, k], star.t[g, k], star.averaging()[1][g, k]),
            ):
                left = np.sinc(f * star.duration) * np.sinc(f * stages)
                phase = 2.0 * np.pi * f * t
                row = row + left * np.concatenate([np.cos(phase) * slope, np.sin(phase) * slope], axis=1)
            rows.append(row)
            root[2 * m : 2 * m + 2, 2 * m : 2 * m + 2] = np.linalg.cholesky(
                star.covariance_px[g, k] / star.weight[g, k]
            )
        at = (2 * pairs[:, None] + [0, 1]).ravel()
        design = np.concatenate(rows)
        total += design.T @ np.linalg.solve(root @ star.correlation[np.ix_(at, at)] @ root.T, design)
    return total


# of the hub, of the partners; at 70 Hz the hub's 20 ms leave of a motion -.22, upside down
@pytest.mark.parametrize("tdi_s", [None, (0.020, 0.008, 0.016, 0.020)])
def test_axes_and_pairs_together_tell_what_dense_least_squares_says(tdi_s):
    star, f = star_of_three(np.random.default_rng(3), tdi_s), 70.0
    motion = SimpleNamespace(t=1e-3 * np.arange(2000))
    result = SimpleNamespace(
        records=(SimpleNamespace(star=star),), scale=SCALE, motion=motion, control=None, cameras=[None] * 4
    )
    found = observed(result, np.array([f]))
    dense = dense_information(star, f)
    (cosine, both), (_, sine) = (np.split(half, 2, axis=1) for half in np.split(dense, 2))
    # sums over all windows, the same but for the order, and for the rounding of the stages' times to 1 ns
    expected = 0.5 * (cosine + sine) + 0.5j * (both - both.T)
    np.testing.assert_allclose(found.information[0], expected, atol=1e-5 * np.abs(expected).max())
    # cosine and sine differ by sums of waves of 140 Hz over 4000 uneven terms, 1 / sqrt(4000) of them; their
    # mean by the square of that, of three sigmas 2e-3
    by_wave = np.sqrt(np.diag(np.linalg.inv(dense)).reshape(2, 3))
    np.testing.assert_allclose(np.sqrt((by_wave**2).mean(axis=0)), found.tone_sigma[0], rtol=2e-3)
