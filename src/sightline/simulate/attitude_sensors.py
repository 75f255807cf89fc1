"""Star trackers and gyros: tables that feel the body, not the instrument's own modes.

Rows are the columns of the ACQUISITION contract's ``[[attitude_sensor]]`` tables; ``files.py`` writes them.
"""

from __future__ import annotations

import numpy as np

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
