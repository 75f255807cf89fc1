"""Where one camera shows what another shows: locate in the one, project into the other.

Not here: how that place moves with attitude (``motion/measure/predict.py``), measuring it (``matching/``).
"""

from __future__ import annotations

from sightline.geometry.camera import Camera
from sightline.geometry.checks import Array
from sightline.geometry.surface import Surface


def predict_match(
    camera_a: Camera, camera_b: Camera, surface: Surface, pixels_a: Array, height: float = 0.0
) -> Array:
    """Pixels of image b that should show what `pixels_a` show in image a.

    Parameters
    ----------
    camera_a, camera_b : Camera
        Geometry of the two images.
    surface : Surface
        What the lines of sight meet.
    pixels_a : (N, 2)
        (line, column), px.
    height : float
        m; by which the ground lies above the surface.

    Returns
    -------
    (N, 2)
        (line, column), px; NaN where the ray misses the surface or b never sees the point.

    Notes
    -----
    S1's matching model, in the order that works: ``Loc_b^-1 o Loc_a``. Without pixels it is the `PixelMap` of
    a pair: ``functools.partial(predict_match, camera_a, camera_b, surface)``.
    """
    return camera_b.project(camera_a.locate(pixels_a, surface.raised(height) if height else surface))
