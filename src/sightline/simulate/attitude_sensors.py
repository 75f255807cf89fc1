"""Star trackers and gyros, which feel the body and not the instrument's own modes; control points.

Rows are the columns of the ACQUISITION contract's tables; ``files.py`` writes them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.simulate.texture import Array

ARC_SECOND = float(np.pi / 180.0 / 3600.0)
"""One arc second, rad."""


def star_tracker_table(
    body: Motion, span: tuple[float, float], seed: np.random.SeedSequence, *, rate: float, sigma: float
) -> Array:
    """Attitude readings with white noise.

    Parameters
    ----------
    body : Motion
        True motion of the body.
    span : (float, float)
        s, first and last instant; the first reading falls half a period after the first.
    seed : numpy.random.SeedSequence
    rate : float
        Hz
    sigma : float
        rad, of each reading and axis.

    Returns
    -------
    (N, 5) t, roll, pitch, yaw, sigma
    """
    count = max(1, int(np.floor((span[1] - span[0]) * rate)))
    t = span[0] + (np.arange(count) + 0.5) / rate
    t = t[t <= span[1]]
    noise = sigma * np.random.default_rng(seed).standard_normal((t.size, 3))
    return np.column_stack([t, body.at(t) + noise, np.full(t.size, sigma)])


def gyro_table(
    body: Motion,
    span: tuple[float, float],
    seed: np.random.SeedSequence,
    *,
    rate: float,
    random_walk: float,
    bias: float = 0.0,
) -> Array:
    """Angle increments with white rate noise and, if asked, a constant rate bias.

    Parameters
    ----------
    body, span, seed : as :func:`star_tracker_table`
    rate : float
        Hz
    random_walk : float
        rad per square root of second (1e-3 degrees per root hour is 2.9e-7).
    bias : float
        rad/s, standard deviation of a constant rate error per axis.

    Returns
    -------
    (N, 6) t_start, t_end, roll, pitch, yaw, sigma; increments over each interval
    """
    rng = np.random.default_rng(seed)
    edges = np.arange(span[0], span[1] + 1e-12, 1.0 / rate)
    angles = body.at(edges)
    width = np.diff(edges)
    sigma = random_walk * np.sqrt(width)
    increments = np.diff(angles, axis=0) + sigma[:, None] * rng.standard_normal((width.size, 3))
    increments += width[:, None] * bias * rng.standard_normal(3)
    return np.column_stack([edges[:-1], edges[1:], increments, sigma])


def control_point_table(
    cameras: Sequence[PushbroomCamera],
    surface: Surface,
    seed: np.random.SeedSequence,
    *,
    count: int,
    sigma: float,
    pointing_px: float = 0.1,
) -> tuple[NDArray[np.intp], Array]:
    """Ground points of known coordinates, each pointed at in one image.

    Parameters
    ----------
    cameras : sequence of PushbroomCamera
        The true ones.
    surface : Surface
        The true ground.
    seed : numpy.random.SeedSequence
    count : int
    sigma : float
        m, error of each coordinate.
    pointing_px : float
        px, error of line and column.

    Returns
    -------
    images : (count,) numbers of the images
    table : (count, 6) x, y, z, sigma, line, column
    """
    rng = np.random.default_rng(seed)
    images = rng.integers(0, len(cameras), count)
    table = np.empty((count, 6))
    for k, image in enumerate(images):
        camera = cameras[image]
        pixel = rng.uniform([0.0, 0.0], [camera.lines - 1.0, camera.columns - 1.0])
        ground = camera.locate(pixel[None], surface)[0]
        table[k, :3] = ground + sigma * rng.standard_normal(3)
        table[k, 3] = sigma
        table[k, 4:] = pixel + pointing_px * rng.standard_normal(2)
    return images, table
