"""Frames of textured relief on a curved ground, seen by any cameras: truth for points matched across views.

The ground has an infinitely fine texture for the sensor's purposes; the blur of the system is applied in
the image, where it belongs when one place is seen from many directions.

Poses and relief come from ``stereo.py``; nothing here knows how points are matched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from sightline.errors import GeometryError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.earth import to_geodetic
from sightline.simulate.scene import Extent, TextureLaw, layer_shape
from sightline.simulate.texture import Array, Array32, Layer, random_layer

#: Rays per pixel along lines and columns: the texture ends at one cycle per pixel, of which three samples
#: leave nothing to fold.
_RAYS = 3
#: px between exact rays; positions between them are cubic. Relief of 100 px and longer is bent by less than
#: 1e-5 of its parallax.
_NODE_STEP = 2.0
#: px rendered beyond the frame, for the blur.
_BORDER = 4
#: m; rays are followed until they meet the ground this closely.
_CLOSE = 1e-6


@dataclass(frozen=True, eq=False)
class TexturedGround:
    """What the cameras look at.

    Attributes
    ----------
    origin : (3,)
        m, world axes; where the local axes begin.
    world_from_local : Rotation
        x east, y north, z up there.
    radii : (float, float) or None
        m; of the ellipsoid that heights are above; None: above the plane z = 0 of the local axes.
    heights : callable
        Height (m) of local places (x, y) of any one shape.
    texture : Layer
        Brightness less its mean, in units of the mean, at local places (x, y).
    """

    origin: Array
    world_from_local: Rotation
    radii: tuple[float, float] | None
    heights: Callable[[Array, Array], Array]
    texture: Layer

    def local(self, points: Array) -> Array:
        """Points (N, 3) m in local axes."""
        return np.asarray((points - self.origin) @ self.world_from_local.as_matrix())

    def above(self, points: Array) -> Array:
        """Height (N,) m of points (N, 3), world axes, over the ground under them."""
        local = self.local(points)
        height = local[:, 2] if self.radii is None else to_geodetic(points, self.radii)[:, 2]
        return np.asarray(height - self.heights(local[:, 0], local[:, 1]))

    def intersect(self, origins: Array, directions: Array) -> Array:
        """Where rays (N, 3) first settle on the ground, (N, 3) m, world axes.

        Raises
        ------
        GeometryError
            If a ray does not, within 60 steps: the ground is too steep for it, or it misses.
        """
        up = self.world_from_local.as_matrix()[:, 2]
        sink = directions @ up
        if not (sink < 0.0).all():
            raise GeometryError("a line of sight does not point down; turn the cameras to the ground")
        reach = -((origins - self.origin) @ up) / sink
        for _ in range(60):
            points = origins + reach[:, None] * directions
            miss = self.above(points)
            if np.abs(miss).max() < _CLOSE:
                return np.asarray(points)
            reach = reach - miss / sink
        raise GeometryError(
            "lines of sight do not settle on the relief: the ground is steeper than the rays; use gentler "
            "relief or view it closer to the vertical"
        )


def random_texture(seed: np.random.SeedSequence, gsd: float, reach: float, contrast: float = 0.2) -> Layer:
    """Texture of 1/f^2 power down to one cycle per pixel.

    Parameters
    ----------
    seed : numpy.random.SeedSequence
    gsd : float
        m of the finest pixel that looks at it.
    reach : float
        m from the origin that has a texture of its own; it repeats beyond.
    contrast : float
        Standard deviation, in units of the mean brightness.
    """
    law = TextureLaw(contrast, (0.5 * gsd, 0.5 * gsd))
    spacing = (0.25 * gsd, 0.25 * gsd)
    extent = Extent(-reach, reach, -reach, reach)
    return random_layer(seed, layer_shape(extent, spacing, 8192), spacing, law.psd, (-reach, -reach))


def render_frame(camera: FrameCamera, ground: TexturedGround, mtf_nyquist: float = 0.15) -> Array32:
    """Noiseless brightness of one frame, in units of the mean: (lines, columns) float32.

    Parameters
    ----------
    camera : FrameCamera
        With the true pose.
    ground : TexturedGround
    mtf_nyquist : float
        Of the system, a Gaussian in the image, at half a cycle per pixel.
    """
    lines, columns = (_fine(size) for size in camera.shape)
    rows, places = _nodes(lines), _nodes(columns)
    rays = camera.rays(np.stack(np.meshgrid(rows, places, indexing="ij"), axis=-1).reshape(-1, 2))
    local = ground.local(ground.intersect(rays.origins, rays.directions)).reshape(len(rows), len(places), 3)
    x, y = (RectBivariateSpline(rows, places, local[..., k])(lines, columns) for k in range(2))
    light = np.float32(1.0) + ground.texture.at(x, y)
    # exp(-2 pi^2 sigma^2 f^2) = mtf_nyquist at f = 1/2 per pixel
    sigma = _RAYS * np.sqrt(-2.0 * np.log(mtf_nyquist)) / np.pi
    blurred = gaussian_filter(light, sigma, truncate=5.0)
    inside = slice(_BORDER * _RAYS, -_BORDER * _RAYS, _RAYS)
    return np.ascontiguousarray(blurred[inside, inside])


def _fine(size: int) -> Array:
    """Places of the rays along one axis of `size` pixels: whole pixels are the first of every `_RAYS`."""
    return np.arange((size + 2 * _BORDER) * _RAYS) / _RAYS - _BORDER


def _nodes(fine: Array) -> Array:
    """Places of exact rays that enclose all of `fine`."""
    return np.arange(fine[0] - _NODE_STEP, fine[-1] + 2.0 * _NODE_STEP, _NODE_STEP)
