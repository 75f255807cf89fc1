"""Frames of a matrix instrument with star tracker, gyro and control points: is the whole angle known as said?

Six rendered frames a run, whose body wanders from one to the next; a star tracker at 2 Hz with an alignment
of its own, a gyro at 10 Hz with a drift, six points whose positions are known to 10 m. NEES are of all angles
and of the three constants, which the images hardly see, with the whole covariance.

Then a spinning camera with three strips whose attitude is hardly known but by a star tracker that reads it
at ten exposures, from drawn matches (`tests/motion/spin/test_solve.py`). What nothing else tells of its
constants is known to the tracker's alignment and the mean of its readings: sigmas are compared with that.

    python validation/frame_sensors.py [--seeds 20] [--first 0]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import gates
import numpy as np
from numpy.typing import NDArray

from sightline.applications.frame_attitude import FrameAttitude, recover_frame_attitude
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame
from sightline.motion.frames.passes import FrameOptions
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.simulate.frames import FrameScenario, frames_case

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from tests.motion.spin.test_solve import EXPOSURES, tracked  # noqa: E402

Array = NDArray[np.float64]

SHAPE, FRAMES, INTERVAL = (300, 400), 6, 2.0
#: rad: a reading, the axes of the tracker, an increment; rad/s: drift of the gyro; m, px: of a point.
READING, ALIGNMENT, INCREMENT, DRIFT, PLACE, PIXEL = 1e-5, 2e-5, 2e-6, 1e-5, 10.0, 0.1
#: Windows per frame.
WINDOWS = 60


def _sensors(scenario: FrameScenario, rng: np.random.Generator) -> list[AttitudeSensor]:
    last = float(scenario.times[-1])
    t, g = np.arange(0.0, last + 0.01, 0.5), np.arange(0.0, last + 0.001, 0.1)
    read = scenario.motion.at(t) + READING * rng.standard_normal((len(t), 3))
    read += ALIGNMENT * rng.standard_normal(3)
    turned = np.diff(scenario.motion.at(g), axis=0) + INCREMENT * rng.standard_normal((len(g) - 1, 3))
    turned += DRIFT * np.diff(g)[:, None] * rng.standard_normal(3)
    sigma = np.full(len(g) - 1, INCREMENT)
    return [
        AttitudeSensor("tracker", "star-tracker", t, t, read, np.full(len(t), READING), ALIGNMENT, 0.0, 0.0),
        AttitudeSensor("gyro", "gyro", g[:-1], g[1:], turned, sigma, 0.0, DRIFT, 0.0),
    ]


def _points(scenario: FrameScenario, rng: np.random.Generator) -> ControlSightings:
    place, image, pixel = [], [], []
    for frame in (0, 0, 2, 2, 5, 5):
        pixels = rng.uniform(40.0, [SHAPE[0] - 40.0, SHAPE[1] - 40.0])[None]
        true = scenario.cameras[frame].locate(pixels, Plane(0.0))
        given = true[0] + PLACE * rng.standard_normal(3)
        for k, camera in enumerate(scenario.cameras):
            seen = camera.project(true)[0]
            if np.isfinite(seen).all() and (seen >= 0).all() and (seen <= np.array(SHAPE) - 1.0).all():
                place.append(given)
                image.append(k)
                pixel.append(seen + PIXEL * rng.standard_normal(2))
    sigma = np.full(len(place), PLACE)
    return ControlSightings(np.array(place), sigma, np.array(image), np.array(pixel), PIXEL)


def _run(seed: int) -> tuple[FrameAttitude, Array]:
    scenario = frames_case(seed, frames=FRAMES, interval=INTERVAL, shape=SHAPE)
    rng = np.random.default_rng(1000 + seed)
    frames = [
        Frame(f"{k}", ArrayImage(scenario.image(k)),
              FrameCamera(scenario.detector, scenario.reference, FixedMount(), float(t)), 0.0)
        for k, t in enumerate(scenario.nominal_times)
    ]  # fmt: skip
    found = recover_frame_attitude(
        frames, Plane(0.0), sensors=_sensors(scenario, rng), control_points=_points(scenario, rng),
        options=FrameOptions(windows=WINDOWS),
    )  # fmt: skip
    return found, scenario.truth[:, 1:]


def _over(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error) / len(error))


def spins(seeds: range) -> None:
    """NEES of a spinning camera with a star tracker, and its sigma beside the bound."""
    mean = np.kron(np.full(EXPOSURES, 1.0 / EXPOSURES), np.eye(3))
    every, constant, sigmas = [], [], []
    for seed in seeds:
        angles, found = tracked(seed, axes=3)
        error, covariance = (found.angles - angles).ravel(), found.angle_covariance
        of_mean = mean @ covariance @ mean.T
        every.append(_over(error, covariance))
        constant.append(_over(mean @ error, of_mean))
        sigmas.append(np.sqrt(np.diag(of_mean)))
        print(f"spin {seed}: NEES of all angles {every[-1]:.2f}, of the constants {constant[-1]:.2f}")
    gates.check("spins: NEES of all angles, pooled", float(np.mean(every)), 0.8, 1.25)
    gates.check("spins: NEES of the constants, pooled", float(np.mean(constant)), 0.8, 1.25)
    # across its axis the body in the images tells more; the largest is what only the tracker tells
    bound = float(np.hypot(3e-5, 2e-5 / np.sqrt(EXPOSURES)))
    gates.check("spins: largest sigma over its bound", float(np.mean(sigmas, axis=0).max()) / bound, 0.9, 1.1)


def main() -> None:
    """Run the flights and print what their sigma is worth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    mean = np.kron(np.full(FRAMES, 1.0 / FRAMES), np.eye(3))
    every, constant, sigmas = [], [], []
    for seed in range(given.first, given.first + given.seeds):
        found, truth = _run(seed)
        error, covariance = (found.motion.angles - truth).ravel(), found.estimate.angle_covariance
        of_mean = mean @ covariance @ mean.T
        every.append(_over(error, covariance))
        constant.append(_over(mean @ error, of_mean))
        sigmas.append(np.sqrt(np.diag(of_mean)) / found.ifov)
        print(f"seed {seed}: NEES of all angles {every[-1]:.2f}, of the constants {constant[-1]:.2f}")
    print(f"sigma of the constants, px: {np.array2string(np.mean(sigmas, axis=0), precision=3)}")
    gates.check("NEES of all angles, pooled", float(np.mean(every)), 0.8, 1.25)
    gates.check("NEES of the constants, pooled", float(np.mean(constant)), 0.8, 1.25)
    spins(range(given.first, given.first + given.seeds))


if __name__ == "__main__":
    gates.run(main, __file__)
