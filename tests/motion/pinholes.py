"""Frames whose geometry is known by hand: a pinhole in level flight over a plane, lines forward.

A pixel at tangents (x to the left, y ahead) of a body turned by R looks along R (y, -x, 1) in forward, right,
down. The body is at height H above the plane and moves forward; no function of the package is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Trajectory
from sightline.motion.frames.matches import FrameStar

ALTITUDE, SPEED, INTERVAL, FOCAL = 400e3, 7000.0, 3.0, 900.0
SHAPE = (300, 360)
WINDOW = (32, 32)


def cameras(count: int, focal: float = FOCAL) -> tuple[FrameCamera, ...]:
    """Nominal cameras `count` x INTERVAL seconds apart."""
    middle = ((SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2)
    flight = Trajectory.level_flight(ALTITUDE, SPEED, -5.0, INTERVAL * count + 5.0)
    detector = AreaDetector("frame", SHAPE, focal, middle)
    return tuple(FrameCamera(detector, flight, FixedMount(), INTERVAL * k) for k in range(count))


def ground(pixels: NDArray[np.float64], frame: int, angles: NDArray[np.float64], height=0.0):
    """Where pixels (N, 2) of a frame meet the plane at `height`: forward, right (N, 2) m."""
    x = (pixels[:, 1] - (SHAPE[1] - 1) / 2) / FOCAL
    y = (pixels[:, 0] - (SHAPE[0] - 1) / 2) / FOCAL
    ray = Rotation.from_rotvec(angles).apply(np.column_stack([y, -x, np.ones_like(x)]))
    down = (ALTITUDE - height) / ray[:, 2]
    return np.column_stack([SPEED * INTERVAL * frame + ray[:, 0] * down, ray[:, 1] * down])


def pixels(points, frame: int, angles: NDArray[np.float64], height=0.0):
    """Pixels (N, 2) of a frame that see points of the plane."""
    rays = np.column_stack(
        [points[:, 0] - SPEED * INTERVAL * frame, points[:, 1], np.full(len(points), ALTITUDE) - height]
    )
    ray = Rotation.from_rotvec(angles).inv().apply(rays)
    line = (SHAPE[0] - 1) / 2 + FOCAL * ray[:, 0] / ray[:, 2]
    column = (SHAPE[1] - 1) / 2 - FOCAL * ray[:, 1] / ray[:, 2]
    return np.column_stack([line, column])


def stars(angles: NDArray[np.float64], lags=(1, 2, 3), sigma=0.02, rng=None, height=None) -> list[FrameStar]:
    """Matches of all frames; with `rng` every image adds noise of its own, shared by all pairs of a window.

    `height` maps ground points to heights of the terrain (windows' centres see it as a step of the plane).
    """
    lines, columns = np.meshgrid(np.arange(20.0, 290, 45), np.arange(20.0, 350, 45), indexing="ij")
    windows = np.column_stack([lines.ravel(), columns.ravel()])
    out = []
    for hub in range(len(angles) - 1):
        level = np.zeros(len(windows)) if height is None else height(ground(windows, hub, angles[hub]))
        seen = ground(windows, hub, angles[hub], level)
        own = np.zeros((len(windows), 2)) if rng is None else rng.normal(size=(len(windows), 2))
        partners = [hub + lag for lag in lags if hub + lag < len(angles)]
        found = []
        for image in partners:
            at = pixels(seen, image, angles[image], level)
            noise = np.zeros_like(own) if rng is None else rng.normal(size=own.shape) - own
            at = at + sigma / np.sqrt(2.0) * noise
            inside = ((at > 16) & (at < np.array(SHAPE) - 17)).all(axis=1)
            found.append(np.where(inside[:, None], at, np.nan))
        size = (len(windows), len(partners))
        out.append(
            FrameStar(
                hub,
                tuple(partners),
                lines.shape,
                WINDOW,
                windows,
                np.stack(found, axis=1),
                np.broadcast_to(sigma**2 * np.eye(2), (*size, 2, 2)),
                np.zeros(size, dtype=np.uint8),
                np.ones(size),
                np.ones(size),
            )
        )
    return out
