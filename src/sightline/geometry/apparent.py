"""Where light comes from against where it seems to: aberration, light time, refraction by the Earth's air.

Not here: whether the attitudes of a product hold them already (``[platform]``, ``io/acquisition/schema.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.geometry.checks import Array
from sightline.geometry.earth import EARTH_RATE

#: m/s.
LIGHT_SPEED = 299_792_458.0
#: Refractivity of air at sea level, and the height (m) over which it falls by e: a column of 2.34 m.
AIR, AIR_SCALE = 2.77e-4, 8434.0
#: m; height from which on air is left out: 1e-9 of it is above. Nodes of the integral up to there.
_TOP, _NODES = 180e3, 64


def aberration_velocity(
    position: Array, velocity: Array, ground: Array, *, aberration: bool, light_time: bool
) -> Array:
    """Velocity by which directions are shifted, over that of light.

    Parameters
    ----------
    position, ground : (N, 3)
        m, Earth-fixed: of the camera, and what it sees.
    velocity : (N, 3)
        m/s, relative to the turning Earth.
    aberration : bool
        Of the camera's motion against the stars.
    light_time : bool
        Of the ground's motion, while light is under way.

    Returns
    -------
    (N, 3)
        m/s. With both it is the velocity against the ground: v + w x (S - P).
    """
    spin = np.array([0.0, 0.0, EARTH_RATE])
    total = np.zeros_like(velocity)
    if aberration:
        total = total + velocity + np.cross(spin, position)
    if light_time:
        total = total - np.cross(spin, ground)
    return total


def refraction_angle(radius: Array, ground_radius: float, off_nadir: Array) -> Array:
    """How much nearer to straight down the ground lies than light seems to come from it.

    Parameters
    ----------
    radius : (N,)
        m; from the Earth's centre to the camera.
    ground_radius : float
        m; to the ground.
    off_nadir : (N,)
        rad; where the camera sees it.

    Returns
    -------
    (N,)
        rad at the camera; NaN where the line of sight misses the sphere.

    Notes
    -----
    Spherical shells of n(h) = 1 + 2.77e-4 exp(-h / 8434 m): n r sin(angle) is the same along a ray, whose
    angle about the centre is the integral of K / (r sqrt(n^2 r^2 - K^2)). Its departure from the straight
    line's is summed by Gauss's rule.
    """
    k = radius * np.sin(off_nadir)
    k = np.where(k < ground_radius, k, np.nan)
    straight = np.arcsin(k / ground_radius) - off_nadir
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # half of the air lies in the lowest thirtieth: heights as the square of even steps
    share = 0.5 * (nodes + 1.0)
    height, step = _TOP * share**2, _TOP * share * weights
    r = ground_radius + height[:, np.newaxis]
    n = 1.0 + AIR * np.exp(-(r - ground_radius) / AIR_SCALE)
    bent = k / (r * np.sqrt((n * r) ** 2 - k**2)) - k / (r * np.sqrt(r**2 - k**2))
    about = straight + (step[:, np.newaxis] * bent).sum(axis=0)
    return np.asarray(
        off_nadir - np.arctan2(ground_radius * np.sin(about), radius - ground_radius * np.cos(about))
    )


def straight_turn(seen: Array, straight: Array) -> Array:
    """Rotation vectors (N, 3), rad, that turn directions (N, 3) into others near them; 0 in NaN rows."""
    turned = np.cross(seen, straight)
    return np.where(np.isfinite(turned).all(axis=1, keepdims=True), turned, 0.0)
