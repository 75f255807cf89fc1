"""Strips whose geometry is known by hand: level flight over a plane, square pixels.

A band that looks k pixels ahead of nadir sees a piece of ground k line periods before one that looks straight
down, in the same column. With tangents x (columns, to the left) and y (lines, ahead) a direction of the body
is (y, -x, 1), and a small turn w of the body changes it by w x (y, -x, 1).
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.motion.measure.observations import Star, shared_image_correlation

IFOV, PERIOD, ALTITUDE = 5e-6, 5e-4, 680e3
SPEED = IFOV * ALTITUDE / PERIOD
T0, T1 = -1.0, 2.0


def strip_cameras(
    ahead_px: tuple[float, ...], lines: int = 600, columns: int = 320, motion: Motion | None = None
) -> list[PushbroomCamera]:
    """Bands that look `ahead_px` pixels ahead of nadir; line 0 of each at t = 0."""
    flight = Trajectory.level_flight(ALTITUDE, SPEED, T0, T1).with_motion(motion)
    return [
        PushbroomCamera(
            LineDetector.from_ifov(f"band {k}", columns, IFOV, PERIOD, look_ahead=float(np.arctan(p * IFOV))),
            flight,
            FixedMount(),
            0.0,
            lines,
        )
        for k, p in enumerate(ahead_px)
    ]


def sampled_motion(roll=None, pitch=None, yaw=None) -> Motion:
    """Motion of given functions of time (rad), sampled every line period."""
    t = np.arange(T0, T1 + PERIOD / 2, PERIOD)
    zero = np.zeros_like
    return Motion(t, np.stack([(f or zero)(t) for f in (roll, pitch, yaw)], axis=1))


def moved_by_turn(pixels: NDArray[np.float64], ahead_px: float, columns: int = 320) -> NDArray[np.float64]:
    """px/rad, (N, 2, 3): how far a fixed direction moves in the image of a band when its body turns.

    The direction d = (y, -x, 1) becomes d - w x d in the turned body; divided by its third component again:
    y' - y = -(pitch (1 + y^2) + yaw x + roll x y), x' - x = -(roll (1 + x^2) - yaw y + pitch x y). One pixel
    of tangent is one column; the band waits one line period for one pixel of y.
    """
    x = IFOV * (pixels[:, 1] - (columns - 1) / 2)
    y = np.full(len(pixels), IFOV * ahead_px)
    line = np.stack([-x * y, -(1 + y * y), -x], axis=1)
    column = np.stack([-(1 + x * x), -x * y, y], axis=1)
    return np.stack([line, column], axis=1) / IFOV


def plain_star(rows: int, blocks: int, pairs: int, sigma: float = 0.05, duration: float = 0.0) -> Star:
    """A star of windows without residuals: unit geometry of roll and pitch, `sigma` px per axis."""
    g = rows * blocks
    field = np.tile(np.linspace(-0.9, 0.9, blocks), rows)
    by_partner = np.zeros((g, pairs, 2, 3), np.float32)
    by_partner[:, :, 0, 1] = by_partner[:, :, 1, 0] = -1 / IFOV
    by_partner[:, :, 0, 2] = -(field / IFOV * 800 * IFOV)[:, None]
    t_hub = np.repeat(0.1 + 4 * PERIOD * np.arange(rows), blocks)
    return Star(
        hub=0,
        images=tuple(range(1, pairs + 1)),
        shape=(rows, blocks),
        pixels=np.stack([np.repeat(4.0 * np.arange(rows), blocks), 400.0 + 400.0 * field], axis=1),
        t_hub=t_hub,
        t=t_hub[:, None] + 0.02 * np.arange(1, pairs + 1),
        duration=duration,
        residual_px=np.zeros((g, pairs, 2)),
        covariance_px=np.tile(sigma**2 * np.eye(2), (g, pairs, 1, 1)),
        by_hub=-by_partner,
        by_partner=by_partner,
        by_static=np.zeros((g, pairs, 2, 0), np.float32),
        by_height=np.zeros((g, pairs, 2), np.float32),
        field=field,
        correlation=shared_image_correlation(pairs),
        weight=np.ones((g, pairs)),
    )


def given_bands(names, offset_sigma_px, rotation_sigma, scale_sigma=None):
    """What is given of detector lines, as far as statics ask."""
    scales = [0.0] * len(names) if scale_sigma is None else scale_sigma
    keys = ("name", "offset_sigma_px", "rotation_sigma", "scale_sigma")
    rows = zip(names, offset_sigma_px, rotation_sigma, scales, strict=True)
    return [SimpleNamespace(**dict(zip(keys, row, strict=True)), shape="line") for row in rows]
