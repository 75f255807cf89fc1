"""Star trackers, gyros and control points beside frames, against bodies that wander between them too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.motion import pinholes

from consistency import assert_possible
from sightline.geometry.surface import Plane
from sightline.motion.frames.noise import FrameNoise
from sightline.motion.frames.solve import FrameUnknowns, solve_frames
from sightline.motion.frames.ties import FrameTies
from sightline.motion.sensors import AttitudeSensor, ControlSightings

COUNT, PIXEL = 5, 1.0 / pinholes.FOCAL
#: rad: a reading, the tracker's alignment; rad/s: the gyro's drift; rad per root s: how the body wanders.
READING, ALIGNMENT, DRIFT, WANDER = 1e-4, 2e-4, 3e-5, 2e-4
LAST = pinholes.INTERVAL * (COUNT - 1)


def flown(rng):
    """Attitudes at 0.05 s, a Brownian motion about a constant that nothing told of; those of the frames."""
    t = np.arange(0.0, LAST + 0.025, 0.05)
    steps = WANDER * np.sqrt(0.05) * rng.standard_normal((len(t), 3))
    steps[0] = 5e-3 * rng.standard_normal(3)
    angles = np.cumsum(steps, axis=0)
    return t, angles, angles[np.round(pinholes.INTERVAL * np.arange(COUNT) / 0.05).astype(int)]


def tracker(rng, t, angles, every=0.7):
    at = np.round(np.arange(0.35, LAST, every) / 0.05).astype(int)
    offset = ALIGNMENT * rng.standard_normal(3)
    read = angles[at] + offset + READING * rng.standard_normal((len(at), 3))
    return AttitudeSensor(
        "st", "star-tracker", t[at], t[at], read, np.full(len(at), READING), ALIGNMENT, 0.0, 0.0
    )


def gyro(rng, t, angles):
    at = np.arange(0, len(t), 4)
    read = np.diff(angles[at], axis=0) + 0.2 * READING * rng.standard_normal((len(at) - 1, 3))
    read += DRIFT * rng.standard_normal(3) * np.diff(t[at])[:, None]
    sigma = np.full(len(at) - 1, 0.2 * READING)
    return AttitudeSensor("gyro", "gyro", t[at[:-1]], t[at[1:]], read, sigma, 0.0, DRIFT, 0.0)


def control(rng, frames, count=3, sigma=80.0, pixel=0.1):
    """Points that each frame sees which can; the position of each is off by as much in all of them."""
    place, where, image, seen = [], [], [], []
    for _ in range(count):
        known = pinholes.ground(rng.uniform(60.0, 240.0, (1, 2)), 2, frames[2])
        off = sigma * rng.standard_normal(3)
        for k, angles in enumerate(frames):
            at = pinholes.pixels(known, k, angles)[0]
            if (at > 5).all() and (at < np.array(pinholes.SHAPE) - 6).all():
                place.append([-known[0, 1], known[0, 0], 0.0])
                where.append(off)
                image.append(k)
                seen.append(at + pixel * rng.standard_normal(2))
    # of the world: x to the right of a flight to the north, y ahead
    position = np.array(place) * [-1.0, 1.0, 1.0] + np.array(where)
    return ControlSightings(position, np.full(len(place), sigma), np.array(image), np.array(seen), pixel)


def solved(seed, kinds):
    """Estimate and true attitudes; the sizes of all errors learned once."""
    rng = np.random.default_rng(seed)
    t, angles, frames = flown(rng)
    sensors = [make(rng, t, angles) for name, make in (("s", tracker), ("g", gyro)) if name in kinds]
    points = control(rng, frames) if "c" in kinds else None
    cameras = pinholes.cameras(COUNT)
    unknowns = FrameUnknowns(cameras, (), ties=FrameTies.of(cameras, sensors, points))
    stars, noise = pinholes.stars(frames, lags=(1,), rng=rng), FrameNoise.start((1,))
    found = solve_frames(stars, unknowns, Plane(), noise, steps=3)
    ties = unknowns.ties.learned(*found.by_images())
    ties = ties.weighed(found.cameras, (), unknowns.lens_at_control())
    return solve_frames(stars, replace(unknowns, ties=ties), Plane(), noise, found.x, steps=2), frames


def of_constants(found, frames):
    """Error (3,) of the mean of all frames, which images do not see, and its covariance (3, 3)."""
    mean = np.kron(np.full(COUNT, 1.0 / COUNT), np.eye(3))
    return mean @ (found.angles - frames).ravel(), mean @ found.angle_covariance @ mean.T


def tracker_information():
    """(3n, 3n) 1/rad^2; what the readings say of the frames, by conditioning the Brownian motion on these."""
    frames, at = pinholes.INTERVAL * np.arange(COUNT), np.arange(0.35, LAST, 0.7)
    at = np.round(at / 0.05) * 0.05
    free = frames[1:]  # it begins at the first
    by = np.minimum(at[:, None], free) @ np.linalg.inv(np.minimum(free[:, None], free))
    left = np.minimum(at[:, None], at) - by @ np.minimum(free[:, None], at)
    covariance = WANDER**2 * left + READING**2 * np.eye(len(at)) + ALIGNMENT**2
    design = np.column_stack([1.0 - by.sum(axis=1), by])
    return np.kron(design.T @ np.linalg.solve(covariance, design), np.eye(3))


@pytest.fixture(scope="module", params=["s", "sgc"])
def several(request):
    return request.param, [solved(seed, request.param) for seed in range(8)]


def test_what_images_do_not_see_lies_within_its_absolute_sigma(several):
    """Pooled over seeds; the bounds of `assert_possible` lie on both sides."""
    kinds, runs = several
    total = 0.0
    for found, frames in runs:
        error, covariance = of_constants(found, frames)
        total += error @ np.linalg.solve(covariance, error)
    print(f"{kinds}: NEES of the constants {total / (3 * len(runs)):.2f}")
    assert_possible(total, 3 * len(runs))


def test_the_sigma_of_a_tracker_is_that_of_the_bound(several):
    kinds, runs = several
    ratio = []
    mean = np.kron(np.full(COUNT, 1.0 / COUNT), np.eye(3))
    for found, frames in runs:
        of_images = np.linalg.inv(found.by_images()[1][: 3 * COUNT, : 3 * COUNT])
        bound = mean @ np.linalg.inv(of_images + tracker_information()) @ mean.T
        ratio.append(np.sqrt(np.diag(of_constants(found, frames)[1]) / np.diag(bound)))
    print(f"{kinds}: sigma over the bound of a tracker {np.mean(ratio):.3f}")
    assert 0.9 < np.mean(ratio) < 1.1 if kinds == "s" else np.mean(ratio) < 0.9  # more is known


def test_each_sensor_says_what_it_gave(several):
    kinds, runs = several
    for found, _ in runs:
        used = {use.name: use for use in found.unknowns.ties.uses(found.x, found.covariance)}
        assert used["st"].used == used["st"].given > 10
        offset, sigma = used["st"].constants["offset of roll"]
        assert abs(offset) < 4.5 * sigma < 4.5 * ALIGNMENT * 1.01
        assert ("gyro" in used, "control points" in used) == (kinds == "sgc", kinds == "sgc")


def test_a_wrong_reading_and_a_wrong_point_lose_their_weight():
    rng = np.random.default_rng(3)
    t, angles, frames = flown(rng)
    sensor, points = tracker(rng, t, angles), control(rng, frames, count=6)
    sensor.angles[4] += 0.02
    points.pixels[2] += 30.0
    cameras = pinholes.cameras(COUNT)
    unknowns = FrameUnknowns(cameras, (), ties=FrameTies.of(cameras, [sensor], points))
    stars, noise, x = pinholes.stars(frames, lags=(1,), rng=rng), FrameNoise.start((1,)), None
    for _ in range(2):
        found = solve_frames(stars, unknowns, Plane(), noise, x, steps=3)
        x = found.x
        ties = unknowns.ties.learned(*found.by_images())
        unknowns = replace(unknowns, ties=ties.weighed(found.cameras, (), unknowns.lens_at_control()))
    uses = {use.name: use for use in unknowns.ties.uses(found.x, found.covariance)}
    assert uses["st"].outliers >= 3 and uses["control points"].outliers == 2
    error, covariance = of_constants(solve_frames(stars, unknowns, Plane(), noise, x, steps=2), frames)
    assert_possible(error @ np.linalg.solve(covariance, error), 3)


def test_nothing_during_the_frames_is_nothing_known():
    cameras = pinholes.cameras(3)
    late = AttitudeSensor("st", "star-tracker", np.array([90.0]), np.array([90.0]), np.zeros((1, 3)),
                          np.ones(1), 0.0, 0.0, 0.0)  # fmt: skip
    assert FrameTies.of(cameras, [late], None) is None
