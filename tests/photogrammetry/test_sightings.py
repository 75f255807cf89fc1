"""What sightings of pushbroom images hold, by plain geometry of a level flight over flat ground."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Trajectory
from sightline.photogrammetry.sightings import Tracks, sight_pushbroom

HEIGHT, SPEED, PERIOD, IFOV, COLUMNS = 5000.0, 70.0, 0.01, 1e-3, 201
LEVER = np.array([1.0, -2.0, 3.0])
#: Of a camera that looks down: x to the left of the flight, y forward (its columns go left).
NADIR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
#: world_from_body (x forward, y right, z down) of flight to the north; world x east, y north, z up.
NORTH = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MOUNTS = [
    Rotation.from_rotvec(turn).as_matrix() @ NADIR for turn in ([0.05, 0.3, -0.02], [-0.04, -0.25, 0.1])
]
LOOKS = (0.1, -0.05)
STARTS = (-45.0, 7.0)


def place_of(line: float, camera: int) -> np.ndarray:
    """Where the camera is while it exposes a line."""
    return np.array([0.0, SPEED * (STARTS[camera] + PERIOD * line), HEIGHT]) + NORTH @ LEVER


def tangents_of(point: np.ndarray, line: float, camera: int) -> np.ndarray:
    """Tangents (along columns, along lines) under which a point lies from where a line is exposed."""
    x, y, z = MOUNTS[camera].T @ NORTH.T @ (point - place_of(line, camera))
    return np.array([x / z, y / z])


def pixel_of(point: np.ndarray, camera: int) -> np.ndarray:
    """The pixel that sees a point: its line's plane passes through it, and the column follows."""

    def beside(pixel: np.ndarray) -> np.ndarray:
        line, column = pixel
        own = np.array([IFOV * (column - 0.5 * (COLUMNS - 1)), np.tan(LOOKS[camera])])
        return tangents_of(point, line, camera) - own

    return np.asarray(fsolve(beside, [1500.0, 100.0], xtol=1e-10))


def test_a_pushbroom_sighting_is_of_the_pose_of_its_own_line_and_knows_what_a_turn_moves():
    trajectory = Trajectory.level_flight(HEIGHT, SPEED, -60.0, 60.0)
    cameras = [
        PushbroomCamera(
            LineDetector.from_ifov(f"strip {k}", COLUMNS, IFOV, PERIOD, look_ahead=LOOKS[k]),
            trajectory, FixedMount(Rotation.from_matrix(MOUNTS[k])), STARTS[k], 3000, lever_arm=tuple(LEVER),
        )
        for k in range(2)
    ]  # fmt: skip
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-200.0, 200.0, 6), rng.uniform(-300.0, 300.0, 6), np.zeros(6)])
    pixels = np.array([pixel_of(point, camera) for camera in range(2) for point in points])
    tracks = Tracks(np.repeat([0, 1], 6), np.tile(np.arange(6), 2), pixels, np.array(0.1))
    found = sight_pushbroom(cameras, tracks)
    np.testing.assert_allclose(found.body_from_camera, MOUNTS, atol=1e-15)
    assert found.t == pytest.approx([start + PERIOD * 2999 / 2 for start in STARTS])
    for row, ((line, column), camera) in enumerate(zip(pixels, tracks.image, strict=True)):
        np.testing.assert_allclose(found.world_from_body[row], NORTH, atol=1e-12)
        np.testing.assert_allclose(found.position[row], place_of(line, camera), atol=1e-6)
        own = [IFOV * (column - 0.5 * (COLUMNS - 1)), np.tan(LOOKS[camera])]
        np.testing.assert_allclose(found.tangents[row], own, atol=1e-9)
        # a point some metres aside is seen at another pixel, and under other tangents from this line
        point = points[tracks.point[row]]
        for step in ([3.0, 0.0, 0.0], [0.0, 3.0, 0.0]):
            pixel = pixel_of(point + step, camera) - pixel_of(point - step, camera)
            tangent = tangents_of(point + step, line, camera) - tangents_of(point - step, line, camera)
            # of second order in 3 m over 5 km; each component some pixels or none
            assert found.px_per_tangent[row] @ tangent == pytest.approx(pixel, abs=0.01)
