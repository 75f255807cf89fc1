"""Mounts and mirrors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, SpanError
from sightline.geometry.pointing import FixedMount, ScanMirror, pointing_matrices, turned_pointing
from sightline.geometry.rotations import NADIR_MOUNT

MIRROR = ScanMirror(Rotation.identity(), [0, 2.0, 0], [1.0, 0, -1.0], [0.0, 1.0], [0.0, 0.1])


def test_a_fixed_mount_turns_there_and_back():
    vectors, t = np.random.default_rng(0).normal(size=(5, 3)), np.zeros(5)
    mount = FixedMount()
    assert_allclose(mount.to_camera(mount.to_body(vectors, t), t), vectors, atol=1e-15)
    assert_allclose(
        pointing_matrices(mount, np.zeros(2)), np.stack([NADIR_MOUNT.as_matrix()] * 2), atol=1e-15
    )


def test_a_stack_of_mounts_is_refused():
    with pytest.raises(InputError, match="must be one rotation, got 3"):
        FixedMount(Rotation.identity(3))


def test_a_mirror_at_45_degrees_turns_the_axis_by_90():
    """Camera looks along +z, the normal is (1, 0, -1): the ray leaves along +x."""
    assert_allclose(MIRROR.to_body(np.array([[0, 0, 1.0]]), np.zeros(1)), [[1, 0, 0]], atol=1e-15)


def test_turning_the_mirror_turns_the_ray_twice_as_far():
    ray = MIRROR.to_body(np.array([[0, 0, 1.0]]), np.ones(1))[0]
    assert np.arccos(ray @ [1, 0, 0]) == pytest.approx(0.2)


def test_a_mirror_turns_the_image_over_and_undoes_itself():
    t = np.linspace(0, 1, 5)
    vectors = np.random.default_rng(1).normal(size=(5, 3))
    assert_allclose(np.linalg.det(pointing_matrices(MIRROR, t)), -1.0)
    assert_allclose(MIRROR.to_camera(MIRROR.to_body(vectors, t), t), vectors, atol=1e-14)


def test_the_mirror_angle_is_not_extrapolated():
    with pytest.raises(SpanError, match=r"mirror angle is known for t = \[0\.000000, 1\.000000\] s"):
        MIRROR.to_body(np.array([[0, 0, 1.0]]), np.array([2.0]))


def test_other_body_axes_leave_the_camera_where_it_is():
    """Directions in the other axes, turned back into the body's, are those of the pointing itself."""
    turn, t = Rotation.from_rotvec([0.2, -0.1, 0.4]), np.array([0.0, 0.5, 1.0])
    vectors = np.random.default_rng(2).normal(size=(3, 3))
    for pointing in (FixedMount(), MIRROR):
        other = turned_pointing(pointing, turn)
        there = other.to_body(vectors, t)
        assert_allclose(turn.apply(there), pointing.to_body(vectors, t), atol=1e-14)
        assert_allclose(other.to_camera(there, t), vectors, atol=1e-14)
        assert other.span == pointing.span
