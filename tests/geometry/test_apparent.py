"""Aberration, light time and refraction against light that is followed step by step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from tests.product_files import orbit

from sightline.applications.export import poses_of
from sightline.geometry.apparent import (
    APPARENT,
    LIGHT_SPEED,
    aberration_velocity,
    bent_camera,
    refraction_angle,
)
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Ellipsoid
from sightline.geometry.trajectory import Trajectory

#: Of the ellipsoid that heights count from, m.
WGS84 = 6378137.0, 6356752.314245179
EARTH, RATE, C = 6371e3, 7.292115e-5, 299_792_458.0


def followed(radius: float, off_nadir: float, shells: int = 4000) -> float:
    """Angle at the camera between a ray and the straight line to its end: Snell's law, shell by shell."""
    heights = np.linspace(120e3, 0.0, shells)
    place = np.array([0.0, radius])
    way = np.array([np.sin(off_nadir), -np.cos(off_nadir)])
    index = 1.0
    for height in heights:
        r = EARTH + height
        along = -place @ way - np.sqrt((place @ way) ** 2 - place @ place + r * r)
        place = place + along * way
        normal = place / np.linalg.norm(place)
        # the air between this shell and the next, at its middle
        inner = 1.0 + 2.77e-4 * np.exp(-(height - 0.5 * 120e3 / (shells - 1)) / 8434.0)
        if height == 0.0:
            break
        cosine = -normal @ way
        ratio = index / inner
        way = ratio * way + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal
        index = inner
    to_end = place - np.array([0.0, radius])
    return off_nadir - float(np.arctan2(to_end[0], -to_end[1]))


@pytest.mark.parametrize("off_nadir", [0.0, 5.0, 20.0, 34.0, 55.0])
def test_refraction_is_that_of_a_ray_followed_through_shells(off_nadir):
    radius, angle = EARTH + 700e3, np.radians(off_nadir)
    found = float(refraction_angle(np.array([radius]), EARTH, np.array([angle]))[0])
    # shells of 30 m: some parts in a thousand of the air; directions of float64: 1e-11 rad
    assert found == pytest.approx(followed(radius, angle), rel=3e-3, abs=2e-10)


def test_refraction_is_the_column_of_air_times_the_slope():
    """Flat layers: 2.336 m tan z / cos^2 z along the ground, z on the ground; a curved Earth is near that."""
    off = np.radians(20.0)
    radius = EARTH + 700e3
    zenith = np.arcsin(radius / EARTH * np.sin(off))
    about = zenith - off
    distance = EARTH * np.sin(about) / np.sin(off)
    expected = 2.77e-4 * 8434.0 * np.tan(zenith) / np.cos(zenith) ** 2 * np.cos(zenith) / distance
    assert float(refraction_angle(np.array([radius]), EARTH, np.array([off]))[0]) == pytest.approx(
        expected, rel=0.01
    )


def test_a_line_of_sight_past_the_earth_is_not_refracted():
    assert np.isnan(refraction_angle(np.array([EARTH + 700e3]), EARTH, np.array([1.4]))[0])


def test_light_is_followed_from_the_turning_ground_to_the_moving_camera():
    """In axes of the stars: light leaves the ground where that was, and meets a camera that moves."""
    t = np.linspace(0.0, 300.0, 5)
    rng = np.random.default_rng(4)
    place = rng.normal(size=(5, 3))
    place *= 7.08e6 / np.linalg.norm(place, axis=1, keepdims=True)
    speed = np.cross(place, rng.normal(size=(5, 3)))
    speed *= 7.5e3 / np.linalg.norm(speed, axis=1, keepdims=True)
    ground = place * 6.37e6 / 7.08e6 + rng.normal(size=(5, 3)) * 1e5

    def turned(vectors, angles):
        c, s = np.cos(angles), np.sin(angles)
        x, y, z = vectors.T
        return np.stack([c * x - s * y, s * x + c * y, z], axis=1)

    camera, inertial = turned(place, RATE * t), turned(speed + np.cross([0, 0, RATE], place), RATE * t)
    delay = np.linalg.norm(place - ground, axis=1) / C
    for _ in range(3):
        left = turned(ground, RATE * (t - delay))
        delay = np.linalg.norm(camera - left, axis=1) / C
    to_light = (left - camera) / np.linalg.norm(left - camera, axis=1, keepdims=True)
    seen = turned(to_light + inertial / C, -RATE * t)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    shift = aberration_velocity(place, speed, ground, aberration=True, light_time=True)
    straight = seen - shift / LIGHT_SPEED
    straight /= np.linalg.norm(straight, axis=1, keepdims=True)
    expected = (ground - place) / np.linalg.norm(ground - place, axis=1, keepdims=True)
    # first order in v / c = 2.5e-5: what is left is 6e-10
    np.testing.assert_allclose(straight, expected, atol=1e-9)
    assert np.abs(seen - expected).max() > 1e-5


def scanned(half_field: float, pitched: tuple[float, float], rolled: float) -> PushbroomCamera:
    """A camera in 700 km that turns about its pitch while it flies 4 s over the turning Earth."""
    t = np.linspace(-0.5, 4.5, 51)
    place, speed = orbit(t)
    down = -place / np.linalg.norm(place, axis=1, keepdims=True)
    ahead = speed - (speed * down).sum(axis=1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    level = Rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down], axis=-1))
    turn = Slerp([t[0], t[-1]], Rotation.from_euler("XY", [[rolled, p] for p in pitched]))(t)
    detector = LineDetector.from_ifov("A", 1001, half_field / 500.0, 1e-2)
    return PushbroomCamera(detector, Trajectory(t, place, t, level * turn), FixedMount(), 0.0, 400)


def straight_ray(camera: PushbroomCamera, pixel, height: float):
    """Direction to the ground that one pixel sees: layers of air square to the ellipsoid's normal there, and
    v = V + w x (S - P), iterated; no code of the package but the ray that it is given."""
    rays = camera.rays([pixel])
    place, seen, t = rays.origins[0], rays.directions[0], float(rays.t[0])
    spin = np.array([0.0, 0.0, RATE])
    speed = (orbit(t + 0.01)[0][0] - orbit(t - 0.01)[0][0]) / 0.02
    axes = np.array([WGS84[0] + height, WGS84[0] + height, WGS84[1] + height])

    def ground(way):
        a, b, c = way @ (way / axes**2), place @ (way / axes**2), place @ (place / axes**2) - 1.0
        return place + (-b - np.sqrt(b * b - a * c)) / a * way

    straight = seen
    for _ in range(4):
        end = ground(straight)
        straight_before = seen - (speed + np.cross(spin, place - end)) / C
        straight_before /= np.linalg.norm(straight_before)
        up = end / axes**2
        up /= np.linalg.norm(up)
        zenith = np.arccos(-straight_before @ up)
        # flat layers, 2.336 m exp(-h / H) (tan z / cos z) square to the ray, and their bend on a round Earth
        column = 2.77e-4 * 8434.0 * np.exp(-height / 8434.0)
        curved = 1.0 - 8434.0 / EARTH * (1.0 + 3.0 * np.tan(zenith) ** 2)
        across = column * np.tan(zenith) / np.cos(zenith) * curved
        down = -up + (up @ straight_before) * straight_before
        down /= np.linalg.norm(down)
        straight = straight_before + across / np.linalg.norm(end - place) * down
        straight /= np.linalg.norm(straight)
    return straight


@pytest.mark.parametrize(
    ("half_field", "pitched", "rolled"),
    [(0.011, (0.5, 0.32), 0.2), (0.011, (-0.1, 0.1), -0.4), (0.036, (0.02, 0.0), 0.1)],
)
def test_rays_lead_straight_to_the_ground_over_the_whole_field(half_field, pitched, rolled):
    camera = scanned(half_field, pitched, rolled)
    bent = bent_camera(camera, 2000.0, APPARENT)
    pixel = 1.0 / 17_500 * 0.011  # rad; the pixel of a field of 35 000 columns
    pixels = [[line, column] for line in (0.0, 133.3, 399.0) for column in (0.0, 250.0, 500.0, 1000.0)]
    turned = []
    for place in pixels:
        expected, found = straight_ray(camera, place, 2000.0), bent.rays([place]).directions[0]
        turned.append(np.linalg.norm(camera.rays([place]).directions[0] - expected))
        # shells followed step by step differ from the closed form of `straight_ray` by some 1e-3 of 3 urad
        assert np.linalg.norm(found - expected) < 0.01 * pixel + 3e-9
        np.testing.assert_allclose(bent.project(camera_ground(bent, place)), [place], atol=1e-6)
    assert min(turned) > 15e-6


def camera_ground(camera: PushbroomCamera, pixel):
    return camera.locate([pixel], Ellipsoid(height=2000.0))


def test_one_pose_a_line_holds_what_light_does():
    """What other programs are given: a rotation for each line, and one row of directions."""
    camera = bent_camera(scanned(0.0177, (0.58, 0.56), 0.2), 2000.0, APPARENT)
    lines = np.array([0.0, 200.0, 399.0])
    origins, turns = poses_of(camera, lines)
    for k, line in enumerate(lines):
        for column in (0.0, 300.0, 1000.0):
            rays = camera.rays([[line, column]])
            look = turns[k].apply(camera.detector.directions_at([column])[0])
            np.testing.assert_allclose(rays.directions[0], look, atol=2e-9)
            np.testing.assert_allclose(rays.origins[0], origins[k], atol=1e-6)


def test_a_bent_mount_undoes_itself():
    camera = scanned(0.011, (0.5, 0.32), 0.2)
    mount = bent_camera(camera, 0.0, APPARENT).pointing
    looks, t = camera.detector.directions[::100], np.linspace(0.0, 4.0, 11)
    np.testing.assert_allclose(mount.to_camera(mount.to_body(looks, t), t), looks, atol=1e-15)
