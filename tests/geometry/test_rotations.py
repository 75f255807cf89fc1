"""Rotations at the border. Signs and orders are in ``tests/test_conventions.py``."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.rotations import (
    from_quat_xyzw,
    from_roll_pitch_yaw,
    orbital_axes,
    to_quat_xyzw,
    to_roll_pitch_yaw,
)


def test_many_angles_go_there_and_back():
    angles = np.random.default_rng(0).uniform(-1.4, 1.4, (20, 3))
    assert_allclose(to_roll_pitch_yaw(from_roll_pitch_yaw(*angles.T)), angles, atol=1e-14)


def test_orbital_axes_look_down_and_forward():
    axes = orbital_axes([[7e6, 0.0, 0.0]], [[10.0, 0.0, 7e3]]).as_matrix()[0]
    assert_allclose(axes[:, 2], [-1, 0, 0], atol=1e-15)
    assert_allclose(axes[:, 0], [0, 0, 1], atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_quaternion_signs_run_on_through_a_full_turn():
    turn = Rotation.from_rotvec(np.linspace(0, 4 * np.pi, 50)[:, None] * [0, 0, 1.0])
    quat = to_quat_xyzw(turn)
    assert ((quat[1:] * quat[:-1]).sum(axis=1) > 0).all()
    assert_allclose((from_quat_xyzw(quat).inv() * turn).magnitude(), 0.0, atol=1e-14)


def test_a_quaternion_that_is_not_of_unit_length_is_named():
    with pytest.raises(InputError, match=r"scalar last: row 1 has length 2"):
        from_quat_xyzw([[0, 0, 0, 1], [0, 0, 0, 2]])
    with pytest.raises(InputError, match=r"shape \(N, 4\) as \(x, y, z, w\), got \(1, 3\)"):
        from_quat_xyzw([[0, 0, 0]])
    with pytest.raises(InputError, match="row 0 has length nan"):
        from_quat_xyzw([[np.nan, 0, 0, 1]])
