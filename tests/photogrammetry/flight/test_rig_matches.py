"""The turn between two cameras of a rig, from rays that both saw."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.photogrammetry.flight.rig_matches import _AGREE_PX, _common_turn


def test_the_common_turn_is_that_of_most_rays_and_tells_which():
    rng = np.random.default_rng(3)
    focal = np.repeat([400.0, 1200.0], 60)
    found = rng.normal(0.0, 0.3, (120, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    true = Rotation.from_rotvec([0.03, -0.05, 0.4])
    # a twentieth of a pixel along each axis, and every fifth ray some 40 px off
    noise = rng.normal(0.0, 0.05, (120, 3))
    wrong = np.arange(120) % 5 == 0
    noise[wrong] = 40.0 * rng.choice([-1.0, 1.0], (wrong.sum(), 3))
    turn, inside = _common_turn(true.apply(found) + noise / focal[:, None], found, focal)
    assert np.array_equal(inside, ~wrong)
    # 0.05 px of some 600 over 96 rays that see a third of a radian across: below 1e-4 rad about every axis
    assert (turn * true.inv()).magnitude() < 1e-4


def test_rays_of_many_turns_have_none_in_common():
    rng = np.random.default_rng(4)
    found = rng.normal(size=(50, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    _, inside = _common_turn(Rotation.random(50, rng=rng).apply(found), found, np.full(50, 400.0))
    # a turn has three angles: rays of a few pixels about chance, 400 px to a radian
    assert _AGREE_PX < 10.0 and inside.sum() < 5
