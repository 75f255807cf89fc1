"""Two-body motion: the arc between two positions, for a spacecraft of which little else is known.

Not here: tables of positions (``trajectory.py``), orbits for simulation (``simulate/``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sightline.errors import GeometryError
from sightline.geometry.checks import Array, as_times, as_vector, positive

#: Newton steps for the universal anomaly; it converges quadratically.
_STEPS = 60


def propagate(position: ArrayLike, velocity: ArrayLike, t: ArrayLike, mu: float) -> tuple[Array, Array]:
    """Position and velocity at other times of a body on a Kepler orbit.

    Parameters
    ----------
    position, velocity : (3,)
        m, m/s at t = 0; axes that do not turn.
    t : (N,)
        s.
    mu : float
        m^3/s^2; gravitational parameter of the centre.

    Returns
    -------
    position, velocity : (N, 3)
        m, m/s.

    Notes
    -----
    Universal variables: R. R. Bate, D. D. Mueller, J. E. White, Fundamentals of Astrodynamics, chapter 4.

    Examples
    --------
    >>> place, _ = propagate([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [np.pi], 1.0)
    >>> np.round(place, 9).tolist()
    [[-1.0, 0.0, 0.0]]
    """
    r0, v0 = as_vector(position, "position"), as_vector(velocity, "velocity")
    times = as_times(t)
    root = np.sqrt(positive(mu, "mu", "m^3/s^2"))
    distance, radial = float(np.linalg.norm(r0)), float(r0 @ v0) / root
    alpha = 2.0 / distance - float(v0 @ v0) / mu  # 1 / semi-major axis
    chi = root * times / distance
    for _ in range(_STEPS):
        c, s = _stumpff(alpha * chi**2)
        miss = radial * chi**2 * c + (1.0 - alpha * distance) * chi**3 * s + distance * chi - root * times
        slope = chi**2 * c + radial * chi * (1.0 - alpha * chi**2 * s) + distance * (1.0 - alpha * chi**2 * c)
        step = miss / slope
        chi = chi - step
        if np.all(np.abs(step) <= 1e-14 * np.maximum(np.abs(chi), 1e-300)):
            break
    c, s = _stumpff(alpha * chi**2)
    f, g = 1.0 - chi**2 * c / distance, times - chi**3 * s / root
    place = f[:, None] * r0 + g[:, None] * v0
    far = np.linalg.norm(place, axis=1)
    f_dot = root / (far * distance) * chi * (alpha * chi**2 * s - 1.0)
    g_dot = 1.0 - chi**2 * c / far
    return place, f_dot[:, None] * r0 + g_dot[:, None] * v0


def _stumpff(z: Array) -> tuple[Array, Array]:
    """Stumpff's functions C and S of `z` (N,)."""
    root = np.sqrt(np.abs(z))
    small = np.abs(z) < 1e-3
    safe = np.where(small, 1.0, z)
    r = np.where(small, 1.0, root)
    bound = z > 0.0
    c = np.where(bound, (1.0 - np.cos(r)) / safe, (1.0 - np.cosh(np.where(bound, 0.0, r))) / safe)
    s = np.where(bound, (r - np.sin(r)) / r**3, (np.sinh(np.where(bound, 0.0, r)) - r) / r**3)
    c = np.where(small, 0.5 - z / 24.0 + z**2 / 720.0, c)
    s = np.where(small, 1.0 / 6.0 - z / 120.0 + z**2 / 5040.0, s)
    return c, s


def velocity_between(first: ArrayLike, second: ArrayLike, interval: float, mu: float) -> Array:
    """Velocity (3,) m/s at the first of two positions on a short two-body arc.

    Parameters
    ----------
    first, second : (3,)
        m; axes that do not turn. Less than half a turn apart.
    interval : float
        s from the first to the second.
    mu : float
        m^3/s^2.

    Raises
    ------
    GeometryError
        If no arc joins them (positions, time or centre do not belong together).
    """
    from scipy.optimize import root

    a, b = as_vector(first, "first"), as_vector(second, "second")
    size = float(np.linalg.norm(b - a))

    def miss(velocity: Array) -> Array:
        return np.asarray((propagate(a, velocity * size / interval, [interval], mu)[0][0] - b) / size)

    found = root(miss, (b - a) / size, tol=1e-13)
    if not np.abs(miss(found.x)).max() < 1e-8:
        raise GeometryError(
            f"no two-body arc of {interval:g} s joins the positions {a.tolist()} and {b.tolist()} m; check "
            "the time between them, their units (m) and `mu`"
        )
    return np.asarray(found.x * size / interval)
