"""Stacks of frames: how much of them is held at once, and several as one."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.imaging import photon_transfer
from sightline.imaging.photon_transfer import measure_stack, with_noise_of
from sightline.imaging.source import ArrayImage


class Watched(ArrayImage):
    """Frame that keeps how many pixels were asked for."""

    most = 0

    def read(self, lines, columns):
        found = super().read(lines, columns)
        Watched.most = max(Watched.most, found.size)
        return found


def stack(frames, level=0.0, sigma=1.0, seed=0, shape=(64, 40)):
    rng = np.random.default_rng(seed)
    fixed = level + rng.standard_normal(shape)
    arrays = [fixed + sigma * rng.standard_normal(shape) for _ in range(frames)]
    means = [float(one.mean()) for one in arrays]
    dead = np.zeros(shape[1], dtype=bool)
    return measure_stack([Watched(one) for one in arrays], means, -np.inf, np.inf, dead)


def test_more_frames_take_fewer_lines_at_once(monkeypatch):
    whole = stack(16)
    monkeypatch.setattr(photon_transfer, "AT_ONCE", 64 * 40)
    Watched.most = 0
    parts = stack(16)
    # of eight pairs a difference each is held
    assert Watched.most * 8 <= 64 * 40
    assert parts.noise.value == pytest.approx(whole.noise.value, rel=1e-6)
    assert parts.fixed.value == pytest.approx(whole.fixed.value, rel=1e-6)


def test_noise_of_unlike_exposures_is_pooled_by_degrees_of_freedom():
    whole, few, many = stack(9, seed=3), stack(2, 10.0, 2.0, 1), stack(7, 20.0, 1.0, 2)
    both = with_noise_of(whole, [few, many])
    assert (both.frames, both.freedom) == (9, 7) and both.pixels == whole.pixels
    assert both.noise.value == pytest.approx((few.noise.value + 6.0 * many.noise.value) / 7.0)
    assert both.noise.sigma == pytest.approx(np.hypot(few.noise.sigma, 6.0 * many.noise.sigma) / 7.0)
    left = whole.fixed.value + whole.noise.value / 9.0
    assert both.fixed.value + both.noise.value / 9.0 == pytest.approx(left)
    alone = with_noise_of(many, [many])
    assert alone.noise == many.noise and alone.fixed == many.fixed


def test_the_sigma_of_a_column_is_the_scatter_of_its_means():
    """Noise of 2 DN over four frames, a pattern of 3 DN over 60 pixels: 0.41 DN, known to 1 / sqrt(2 n)."""
    rng = np.random.default_rng(5)
    pattern = 100.0 + 3.0 * rng.standard_normal((60, 500))
    frames = [ArrayImage(pattern + 2.0 * rng.standard_normal(pattern.shape)) for _ in range(4)]
    stack = measure_stack(frames, [100.0] * 4, 0.0, 1e3, np.zeros(500, np.bool_))
    scatter = np.std(stack.columns())
    assert abs(scatter / stack.column_sigma() - 1.0) < 4.0 / np.sqrt(2.0 * 500)
