"""Frames of a matrix instrument against a pinhole worked out by hand."""

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.simulate.frames import frames_case
from sightline.simulate.sensor import footprint


def test_a_pixel_of_a_frame_sees_the_ground_of_the_pinhole():
    scenario = frames_case(4, frames=3, shape=(60, 90), distortion=(), step_sigma=0.0)
    seen = footprint(scenario.cameras[2], (0, 60), 90, None, 4)
    gsd = 420e3 / 3600.0
    i, j = np.meshgrid(np.arange(60) - 29.5, np.arange(90) - 44.5, indexing="ij")
    # lines forward (north), columns to the left (west), the nadir at 7200 m/s x 12 s
    np.testing.assert_allclose(seen.x, -gsd * j, atol=1e-6)
    np.testing.assert_allclose(seen.y, 7200.0 * 12.0 + gsd * i, atol=1e-6)


def test_barrel_distortion_draws_the_corners_in():
    bent = frames_case(
        4, frames=2, shape=(60, 90), focal_length_px=100.0, distortion=(-0.05,), step_sigma=0.0
    )
    seen = footprint(bent.cameras[0], (0, 60), 90, None, 4)
    # the ground at tangent r lands at r (1 - 0.05 r^2): invert by a few fixed-point steps
    i, j = np.meshgrid((np.arange(60) - 29.5) / 100.0, (np.arange(90) - 44.5) / 100.0, indexing="ij")
    u, v = j.copy(), i.copy()
    for _ in range(60):
        scale = 1.0 - 0.05 * (u**2 + v**2)
        u, v = j / scale, i / scale
    # four columns between exact rays of a 100-px lens, the coarsest case: 1e-6 of a pixel
    np.testing.assert_allclose(seen.x / -420e3, u, atol=1e-8)
    np.testing.assert_allclose(seen.y / 420e3, v, atol=1e-8)


def test_the_random_walk_of_the_attitude_has_its_step():
    steps = np.concatenate(
        [
            np.diff(frames_case(seed, frames=12, shape=(16, 16)).truth[:, 1:], axis=0).ravel()
            for seed in range(6)
        ]
    )
    # 198 draws: relative sd 5 %; four of them
    assert steps.std() == pytest.approx(1e-3, rel=0.2)


def test_the_same_seed_gives_the_same_frames():
    first, second = (frames_case(3, frames=2, shape=(32, 48)).image(1) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_times_too_uncertain_to_order_the_frames_are_refused():
    with pytest.raises(InputError, match="frames change places"):
        frames_case(0, interval=1.0, time_sigma=0.3)
