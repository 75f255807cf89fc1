"""Noise of followed windows: each sighting by itself, walks, ramps, neighbours that err alike."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.photogrammetry.flight.track_noise import (
    TrackNoise,
    alike_neighbours,
    noise_of_tracks,
    with_drift,
    with_scatter,
)
from sightline.photogrammetry.sightings import Tracks

FRAMES, ROWS, COLUMNS, STEP = 30, 8, 10, 20.0


def drawn(
    seed: int, own: float, walk: float, ramp: float, together: float = 0.0
) -> tuple[Tracks, np.ndarray]:
    """Windows of a grid that run down the lines, and their errors; `together`: share common to neighbours."""
    rng = np.random.default_rng(seed)
    count = ROWS * COLUMNS
    line, column = (a.ravel() * STEP for a in np.indices((ROWS, COLUMNS)))
    frame = np.tile(np.arange(FRAMES), count)
    point = np.repeat(np.arange(count), FRAMES)
    pixels = np.column_stack([line[point] - 3.0 * frame, column[point]])
    rates = (
        rng.standard_normal((ROWS // 2, COLUMNS // 2, 2)).repeat(2, axis=0).repeat(2, axis=1).reshape(-1, 2)
    )
    rates = np.sqrt(together) * rates + np.sqrt(1.0 - together) * rng.standard_normal((count, 2))
    steps = np.sqrt(walk) * rng.standard_normal((count, FRAMES, 2))
    error = np.cumsum(steps, axis=1) + np.sqrt(own) * rng.standard_normal((count, FRAMES, 2))
    error += np.sqrt(ramp) * rates[:, None] * np.arange(FRAMES)[:, None]
    return Tracks(frame, point, pixels, np.array(0.05)), error.reshape(-1, 2)


@pytest.mark.parametrize("true", [(4e-3, 0.0, 0.0), (1e-4, 4e-4, 0.0), (4e-4, 0.0, 4e-5)])
def test_each_kind_of_noise_is_found(true):
    tracks, error = drawn(1, *true)
    found = noise_of_tracks(tracks, error, np.ones(len(tracks), dtype=bool))
    wanted = TrackNoise(*true)
    # 80 tracks tell the variance of a slope to sqrt(2 / 80) = 16 per cent; three sigmas
    n = np.array(float(FRAMES))
    assert found.equivalent(n) == pytest.approx(float(wanted.equivalent(n)), rel=0.5)


def test_only_errors_across_the_motion_count():
    # along it a point that is higher drifts as evenly as one whose window does
    tracks, error = drawn(2, 1e-4, 0.0, 0.0)
    drift = 0.01 * np.random.default_rng(3).standard_normal(ROWS * COLUMNS)
    error[:, 0] += drift[tracks.point] * tracks.image
    found = noise_of_tracks(tracks, error, np.ones(len(tracks), dtype=bool))
    assert found.equivalent(np.array(30.0)) < 3e-4


def test_equivalent_noise_has_the_slope_variance_of_the_drift():
    # by brute force: straight lines fitted to drawn drifts, and to independent errors of that variance
    rng = np.random.default_rng(4)
    n, draws = 20, 4000
    place = np.arange(n) - 0.5 * (n - 1)
    fit = place / (place @ place)
    walk = (np.cumsum(rng.standard_normal((draws, n)), axis=1) @ fit).var()
    ramp = ((rng.standard_normal((draws, 1)) * np.arange(n)) @ fit).var()
    white = (rng.standard_normal((draws, n)) @ fit).var()
    # each variance to sqrt(2 / 4000) = 2 per cent, the walk's continuum to 1 / n^2 less
    assert TrackNoise(0.0, 1.0, 0.0).equivalent(np.array(20.0)) == pytest.approx(walk / white, rel=0.12)
    assert TrackNoise(0.0, 0.0, 1.0).equivalent(np.array(20.0)) == pytest.approx(ramp / white, rel=0.12)


def test_neighbours_that_drift_alike_count_once():
    whole = np.ones(ROWS * COLUMNS * FRAMES, dtype=bool)
    alone = [alike_neighbours(*drawn(seed, 1e-4, 0.0, 1e-4), whole) for seed in range(6)]
    blocks = [alike_neighbours(*drawn(seed, 1e-4, 0.0, 1e-4, together=1.0), whole) for seed in range(6)]
    # of 8 neighbours in blocks of 2 by 2, three err the same (fewer at rims and where others are as near)
    assert np.mean(alone) < 1.5
    assert 2.5 < np.mean(blocks) < 5.0


def test_sigmas_grow_by_what_tracks_drift():
    tracks, error = drawn(5, 4e-4, 0.0, 4e-5)
    used = np.ones(len(tracks), dtype=bool)
    found = with_drift(tracks, error, used)
    wanted = 4e-4 + 4e-5 * FRAMES**3 / 12.0
    # neighbours are independent: a factor of 1 to 1.5 by chance (as above)
    assert 0.6 * wanted < np.median(found.sigma_px) ** 2 < 1.9 * wanted
    assert with_drift(tracks, error, ~used) is tracks


def seen_twice(seed: int, true: np.ndarray) -> tuple[Tracks, np.ndarray, np.ndarray]:
    """Windows of 8 photographs whose sigmas (N,) are true, stated wrongly; residuals and their freedom.

    Each is seen in two neighbouring ones, which both lose half of what they differ by to the point.
    """
    rng = np.random.default_rng(seed)
    image = np.concatenate([np.repeat([k, k + 1], len(true) // 14) for k in range(7)])
    pixels = rng.uniform(0.0, 4000.0, (len(image), 2))
    residual = np.zeros((len(image), 2))
    residual[:, 0] = np.sqrt(0.5) * true[: len(image)] * rng.standard_normal(len(image))
    stated = np.hypot(0.1, 3.0 * true[: len(image)])
    tracks = Tracks(image, np.arange(len(image)), pixels, stated)
    return tracks, residual, np.full(len(image), 0.5)


def test_sigmas_of_windows_found_from_afar_are_what_residuals_show():
    # most are good to 0.01 px, a third to 0.08: stated with a floor of 0.1 and three times as large
    true = np.tile([0.01, 0.01, 0.08], 1400)
    tracks, residual, freedom = seen_twice(0, true)
    found = with_scatter(tracks, residual, freedom, np.ones(len(tracks), dtype=bool))
    fine = true[: len(tracks)] < 0.05
    # of 1,400 squares or more: a sigma to sqrt(1 / 2 / 1400) = 2 %; neighbours add up to a tenth by chance
    assert 0.94 * 0.01 < np.median(found.sigma_px[fine]) < 1.15 * 0.01
    assert 0.94 * 0.08 < np.median(found.sigma_px[~fine]) < 1.15 * 0.08


def test_few_windows_keep_their_sigmas():
    tracks, residual, freedom = seen_twice(0, np.full(140, 0.01))
    assert with_scatter(tracks, residual, freedom, np.ones(len(tracks), dtype=bool)) is tracks
