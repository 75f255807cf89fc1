"""Points from sightings: against points chosen beforehand and against the scatter of drawn noise."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.photogrammetry.block.pose_noise import PoseNoise, aimed_axes
from sightline.photogrammetry.sightings import Sightings
from sightline.photogrammetry.triangulate import meet_rays, triangulate

HEIGHT, FOCAL_PX = 500e3, 27000.0
MOUNT = Rotation.from_euler("ZYX", [80.0, 3.0, -2.0], degrees=True).as_matrix()


def block(shots, points, seed=0, *, base=500e3, sigma_px=0.1, step=7000.0):
    """Two cameras `base` apart that fly along x over points about the origin; sightings without noise."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-5000.0, 5000.0, (points, 3)) * [1.0, 1.0, 0.1]
    along = (np.arange(shots) - (shots - 1) / 2.0) * step
    place = np.zeros((2, shots, 3))
    place[0, :, 0], place[1, :, 0] = along + base / 2.0, along - base / 2.0
    place[..., 2] = HEIGHT
    place[..., 1] = 20e3
    body = np.stack(aimed_axes(place[0], place[1], np.zeros(3)))
    images = 2 * shots
    camera, shot = np.repeat([0, 1], shots), np.tile(np.arange(shots), 2)
    image = np.repeat(np.arange(images), points)
    flat = Sightings(
        camera,
        shot,
        shot.astype(float),
        image,
        np.tile(np.arange(points), images),
        image,
        np.zeros((images * points, 2)),
        np.broadcast_to(FOCAL_PX * np.eye(2), (images * points, 2, 2)),
        np.full(images * points, sigma_px),
        place.reshape(-1, 3),
        body.reshape(-1, 3, 3),
        np.stack([np.eye(3), MOUNT]),
    )
    return seen(flat, truth), truth


def seen(block, truth, *, small=0.0, move=0.0):
    """The same sightings from bodies turned by `small` (M, 3) and moved by `move` (M, 3)."""
    turned = (
        block.world_from_body @ Rotation.from_rotvec(np.zeros((len(block.camera), 3)) + small).as_matrix()
    )
    turned = turned @ block.body_from_camera[block.camera]
    place = block.position + move
    q = np.einsum("nji,nj->ni", turned[block.image], truth[block.point] - place[block.image])
    values = {name: getattr(block, name) for name in block.__dataclass_fields__}
    return Sightings(**values | {"tangents": q[:, :2] / q[:, 2:]})


@pytest.mark.parametrize("by_shot", [False, True])
def test_points_are_found_under_given_errors_of_the_poses(by_shot):
    rng = np.random.default_rng(1)
    plain, truth = block(3, 20)
    angles, small = rng.normal(0.0, 2e-4, (2, 3)), rng.normal(0.0, 1e-5, (6, 3))
    move = rng.normal(0.0, 10.0, (6, 3))
    turned = seen(plain, truth, small=angles[plain.camera] + small, move=move)
    found = triangulate(turned, angles, attitude=small, position=move, by_shot=by_shot)
    # rounding: 1e-16 of 5e5 m over a convergence of half a radian, some operations
    np.testing.assert_allclose(found.position, truth[found.point], atol=1e-7)
    assert len(found) == (60 if by_shot else 20)
    assert np.array_equal(found.point[found.row], plain.point)
    assert found.shot is None or np.array_equal(found.shot[found.row], plain.shot[plain.image])


def errors(found, truth):
    """Errors (n, 3) whitened by the covariance: of unit variance and independent where it is true."""
    lower = np.linalg.cholesky(found.covariance)
    return np.linalg.solve(lower, (found.position - truth[found.point])[..., None])[..., 0]


def near_one(squares, count):
    """Mean of `count` squares of independent unit normals: within four of its sigmas."""
    assert abs(squares.mean() - 1.0) < 4.0 * np.sqrt(2.0 / count)


@pytest.mark.parametrize("by_shot", [False, True])
def test_covariance_is_that_of_drawn_image_noise(by_shot):
    plain, truth = block(4, 500)
    rng = np.random.default_rng(2)
    values = {name: getattr(plain, name) for name in plain.__dataclass_fields__}
    noisy = Sightings(
        **values | {"tangents": plain.tangents + rng.normal(0.0, 0.1 / FOCAL_PX, (len(plain), 2))}
    )
    found = triangulate(noisy, by_shot=by_shot)
    near_one(errors(found, truth) ** 2, found.position.size)


def test_covariance_is_that_of_drawn_noise_of_poses_and_angles():
    plain, truth = block(2, 1)
    rng = np.random.default_rng(3)
    spread = rng.normal(0.0, 3e-5, (6, 6))
    noise, of_angles = PoseNoise(7.5, 1e-5), spread @ spread.T
    squares = []
    for _ in range(200):
        angles = rng.multivariate_normal(np.zeros(6), of_angles).reshape(2, 3)
        small = angles[plain.camera] + rng.normal(0.0, noise.attitude, (4, 3))
        turned = seen(plain, truth, small=small, move=rng.normal(0.0, noise.position, (4, 3)))
        found = triangulate(turned, noise=noise, angle_covariance=of_angles)
        squares.append(errors(found, truth) ** 2)
    near_one(np.array(squares), 600)


@pytest.mark.parametrize("whole", [True, False])
def test_covariance_is_that_of_attitudes_that_go_with_positions(whole):
    """Cameras look at the aim point from where they truly are; attitudes follow from measured positions."""
    plain, truth = block(2, 1, sigma_px=1e-6)
    rng = np.random.default_rng(4)
    noise = PoseNoise(7.5, 0.0, aim_point=np.zeros(3))
    # a sighting left out: its camera's position still turns the partner's
    used = np.array([True, True, True, whole])
    squares = []
    for _ in range(200):
        move = rng.normal(0.0, noise.position, (4, 3))
        true = np.concatenate(aimed_axes(*np.split(plain.position + move, 2), np.zeros(3)))
        small = Rotation.from_matrix(np.swapaxes(plain.world_from_body, 1, 2) @ true).as_rotvec()
        found = triangulate(seen(plain, truth, small=small, move=move), noise=noise, used=used)
        squares.append(errors(found, truth) ** 2)
    near_one(np.array(squares), 600)


def test_points_that_cannot_be_had_are_nan():
    plain, truth = block(1, 4)
    tangents = plain.tangents.copy()
    # point 0: second ray parallel to the first; point 1: rays meet behind the cameras
    first, second = plain.image == 0, plain.image == 1
    world = np.einsum("ij,j->i", plain.world_from_body[0], [*tangents[first][0], 1.0])
    q = (plain.world_from_body[1] @ MOUNT).T @ world
    tangents[np.flatnonzero(second)[0]] = q[:2] / q[2]
    for camera, away in ((first, 1.0), (second, -1.0)):
        n = np.flatnonzero(camera)[1]
        mount = plain.body_from_camera[plain.camera[plain.image[n]]]
        q = (plain.world_from_body[plain.image[n]] @ mount).T @ np.array([away, 0.0, -1.0])
        tangents[n] = q[:2] / q[2]
    values = {name: getattr(plain, name) for name in plain.__dataclass_fields__}
    used = np.ones(len(plain), dtype=bool)
    used[np.flatnonzero(second)[2]] = False  # point 2: one sighting only
    found = triangulate(Sightings(**values | {"tangents": tangents}), used=used)
    assert np.isnan(found.position).all(axis=1).tolist() == [True, True, True, False]
    assert np.isnan(found.covariance).all(axis=(1, 2)).tolist() == [True, True, True, False]
    assert found.count.tolist() == [2, 2, 1, 2]
    np.testing.assert_allclose(found.position[3], truth[3], atol=1e-7)


def test_two_images_from_one_place_tell_no_distance():
    plain, _ = block(1, 5, base=1e-3)
    assert np.isnan(triangulate(plain).position).all()


def test_many_sightings_take_memory_of_their_number():
    plain, truth = block(1024, 300)
    tracemalloc.start()
    found = triangulate(plain)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # some twelve numbers of each sighting at a time; its pairs with all others of its point would be 2048
    assert peak < 200 * plain.image.size
    np.testing.assert_allclose(found.position, truth, atol=1e-6)


def test_rays_meet_between_them_and_miss_by_the_angles_that_they_are_off():
    """Pairs of rays that cross at right angles 2 h apart, one point each, and others in closed form."""
    h, along = 0.5, np.array([3.0, 10.0])
    middle = np.array([[20.0, -4.0, 7.0], [-1.0, 2.0, 30.0]])
    x, y, z = np.eye(3)
    origins = [
        middle[0] - along[0] * x + h * z, middle[0] - along[1] * y - h * z,  # along x above, along y below
        middle[1] - along[0] * y + h * x, middle[1] + along[1] * z - h * x,
        5.0 * x, 9.0 * y,  # parallel
        middle[0] - 2.0 * x, middle[0] - 6.0 * (y + z), middle[0] + 4.0 * z,  # through one point, one away
        y,  # alone
    ]  # fmt: skip
    directions = [x, y, y, -z, z, z, x, (y + z) / np.sqrt(2.0), z, x]
    point = np.array([0, 0, 1, 1, 2, 2, 3, 3, 3, 5])
    met = meet_rays(np.array(origins), np.array(directions), point, 6)
    expected = np.array([middle[0], middle[1], [np.nan] * 3, middle[0], [np.nan] * 3, [np.nan] * 3])
    np.testing.assert_allclose(met.points, expected, atol=1e-12)
    np.testing.assert_allclose(met.miss[:4], np.arctan(h / np.tile(along, 2)), atol=1e-12)
    np.testing.assert_allclose(met.miss[6:9], [0.0, 0.0, np.pi], atol=1e-7)
