"""Captures of a rig adjusted with the offsets of its cameras; sightings made by a projection of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors
from sightline.photogrammetry.flight.poses import RoughPoses, adjust_frames
from sightline.photogrammetry.flight.rig import RigCamera, RigOffsets, given_offsets
from sightline.photogrammetry.flight.rig_poses import RigSolution, _alike_again, adjust_rig
from sightline.photogrammetry.sightings import Images, Tracks, sight_frames

SHAPE, FOCAL, HEIGHT = (300, 400), (400.0, 390.0, 405.0), 100.0
SIGMA_PX, ANGLE, LEVER = 0.1, np.radians(1.0), 0.005
CAPTURES, SIZE = 12, 3


def _truth(seed: int):
    rng = np.random.default_rng(seed)
    position = np.column_stack([np.zeros(CAPTURES), 15.0 * np.arange(CAPTURES), np.full(CAPTURES, HEIGHT)])
    position = position + rng.normal(0.0, 0.3, position.shape)
    # x forward to the north, z down
    north = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    body = north * Rotation.from_rotvec(rng.normal(0.0, 0.02, (CAPTURES, 3)))
    turn = rng.normal(0.0, ANGLE, (SIZE, 3))
    lever = np.array([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.04, 0.05, 0.0]]) + rng.normal(
        0.0, LEVER, (SIZE, 3)
    )
    turn[0], lever[0] = 0.0, 0.0
    return rng, position, body, Rotation.from_rotvec(turn), lever


def _pixels(points, position, body, turn, lever, focal):
    """Pixels by the formula of a pinhole: columns to the left of the body, lines forward."""
    origin = position + body.apply(lever)
    q = (body * turn).inv().apply(points - origin)
    return np.column_stack([
        0.5 * (SHAPE[0] - 1) + focal * q[:, 0] / q[:, 2], 0.5 * (SHAPE[1] - 1) - focal * q[:, 1] / q[:, 2]
    ])  # fmt: skip


def _flight(seed: int) -> tuple[RigSolution, np.ndarray, Rotation, Rotation, np.ndarray, Images]:
    rng, position, body, turn, lever = _truth(seed)
    points = np.column_stack([
        rng.uniform(-60, 60, 350), rng.uniform(-40, 15 * CAPTURES + 40, 350), rng.normal(0, 4, 350)
    ])  # fmt: skip
    image, point, pixels = [], [], []
    for c in range(SIZE):
        for k in range(CAPTURES):
            seen = _pixels(points, position[k], body[k], turn[c], lever[c], FOCAL[c])
            inside = ((seen > 0) & (seen < np.array(SHAPE) - 1)).all(axis=1)
            if c == 1 and k == 5:
                inside[:] = False  # one band of one capture is missing
            image.append(np.full(inside.sum(), c * CAPTURES + k))
            point.append(np.flatnonzero(inside))
            pixels.append(seen[inside] + rng.normal(0.0, SIGMA_PX, (inside.sum(), 2)))
    _, number = np.unique(np.concatenate(point), return_inverse=True)
    tracks = Tracks(np.concatenate(image), number, np.concatenate(pixels), SIGMA_PX)
    cameras = [
        RigCamera(
            f"camera {c}", AreaDetector("frame", SHAPE, FOCAL[c], (149.5, 199.5)), NADIR_MOUNT, (), (),
            orientation_sigma=ANGLE if c else 0.0,
            position=[[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.04, 0.05, 0.0]][c],
            position_sigma=np.full(3, LEVER if c else 0.0),
        )
        for c in range(SIZE)
    ]  # fmt: skip
    order = np.arange(CAPTURES)
    images = Images(
        np.zeros(CAPTURES, int), order, order.astype(float), position + rng.normal(0.0, 0.5, position.shape),
        body * Rotation.from_rotvec(rng.normal(0.0, 0.01, (CAPTURES, 3))),
    )  # fmt: skip
    known = RoughPoses(np.full((CAPTURES, 3), 0.5), np.full((CAPTURES, 3), 0.01))
    priors = PointPriors(HeightPrior(Plane(0.0), 5.0, None), None)
    own = tracks[tracks.image < CAPTURES]
    first = np.unique(own.point)
    alone = adjust_frames(
        images,
        sight_frames(images, [cameras[0].detector], [NADIR_MOUNT], own),
        known,
        priors=priors,
    )
    assert len(first) > 200
    start = given_offsets(cameras)
    found = adjust_rig(images, cameras, tracks, known, start=alone, begin=start, priors=priors)
    return found, position, body, turn, lever, images


def _offset_errors(offsets: RigOffsets, turn: Rotation, lever: np.ndarray, camera: int) -> np.ndarray:
    angle = (turn[camera].inv() * offsets.orientation[camera]).as_rotvec()
    return np.concatenate([angle, offsets.position[camera] - lever[camera]])


@pytest.mark.parametrize("seeds", [range(6)])
def test_offsets_and_poses_err_by_what_their_covariance_says(seeds) -> None:
    """Pooled NEES of 6 seeds x 2 cameras x 6 offsets = 72 degrees of freedom, and of poses."""
    rig, poses = [], []
    for seed in seeds:
        found, position, body, turn, lever, _ = _flight(seed)
        for c in (1, 2):
            error = _offset_errors(found.offsets, turn, lever, c)
            covariance = found.offsets.covariance[c, :6, :6]
            rig.append(error @ np.linalg.solve(covariance, error) / 6.0)
        error = np.concatenate(
            [found.poses.position - position, (body.inv() * found.poses.world_from_body).as_rotvec()], axis=1
        )
        information = np.linalg.inv(found.poses.covariance)
        poses.append(np.einsum("ka,kab,kb->k", error, information, error).mean() / 6.0)
        assert found.offsets.observed[1:, :3].all()
    # chi-square of 72 over 72 has a sigma of 0.17; poses of a flight share their datum: 6 x some 10 of them
    assert 0.5 < np.mean(rig) < 1.5, np.mean(rig)
    assert 0.5 < np.mean(poses) < 1.5, np.mean(poses)


def test_residuals_of_a_point_go_together_by_the_mean_product_of_its_pairs():
    rng = np.random.default_rng(7)
    point = rng.integers(0, 40, 160)
    unit = rng.normal(size=(40, 2))[point] + rng.normal(size=(160, 2))
    together = [unit[i] @ unit[j] for i in range(160) for j in range(160) if i != j and point[i] == point[j]]
    expected = np.mean(together) / np.mean((unit**2).sum(axis=1))
    assert 0.2 < expected < 0.8
    assert _alike_again(point, unit) == pytest.approx(expected)
    # fewer than thirty pairs tell nothing, and nothing is less than none
    assert _alike_again(np.arange(160), unit) == 0.0
    assert _alike_again(np.repeat(np.arange(80), 2), np.tile([[1.0, 1.0], [-1.0, -1.0]], (80, 1))) == 0.0
