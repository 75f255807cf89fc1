"""Aberration, light time and refraction against light that is followed step by step."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.apparent import LIGHT_SPEED, aberration_velocity, refraction_angle

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
