"""Attitudes of bodies that look at a common point: z towards it, x forward.

Not here: where the bodies are (``orbit_pair.py``), how a camera sits in its body (``pointing.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.geometry.checks import Array


def aimed_axes(first: Array, second: Array, aim_point: Array) -> tuple[Array, Array]:
    """S2's axes of two cameras that look at one point.

    Parameters
    ----------
    first, second : (K, 3)
        m, world axes; where the cameras of each shot are.
    aim_point : (3,)
        m, world axes.

    Returns
    -------
    first, second : (K, 3, 3)
        world_from_axes: z towards the aim point, y = n1 x n2 square to the plane of both cameras and the
        point (n from the point to a camera), x = y x z. Where the first camera leads, these are body axes.

    Notes
    -----
    S2, section "Model of synchronous imaging"; its printed e_z and second index are corrected, see
    docs/theory/s2.md.
    """
    ahead = first - second
    return axes_towards(first, ahead, aim_point), axes_towards(second, ahead, aim_point)


def axes_towards(position: Array, ahead: Array, aim_point: Array) -> Array:
    """Axes of a body that looks at a point, x as near as can be to a direction.

    Parameters
    ----------
    position : (K, 3)
        m, world axes.
    ahead : (K, 3)
        World axes, any length; not along the line of sight.
    aim_point : (3,)
        m, world axes.

    Returns
    -------
    (K, 3, 3)
        world_from_axes: z towards the aim point, y = z x ahead, x = y x z. With `ahead` the baseline, y is
        square to the plane of both cameras and the point.
    """
    z = _unit(aim_point - position)
    y = _unit(np.cross(z, ahead))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _unit(vectors: Array) -> Array:
    """Vectors (K, 3) brought to length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
