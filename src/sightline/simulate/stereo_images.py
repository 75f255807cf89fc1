"""Frames of textured relief on a curved ground, seen by any cameras: truth for points matched across views.

The ground has an infinitely fine texture for the sensor's purposes; the blur of the system is applied in
the image, where it belongs when one place is seen from many directions.

Poses and relief come from ``stereo.py``; nothing here knows how points are matched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from sightline.errors import GeometryError, InputError
from sightline.execution import Step, no_step
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Images
from sightline.simulate.files import write_image
from sightline.simulate.scene import Extent, TextureLaw, layer_shape
from sightline.simulate.sensor import Radiometry
from sightline.simulate.texture import Array, Array32, TextureLayer, random_layer

#: Rays per pixel along lines and columns: the texture ends at one cycle per pixel, of which three samples
#: leave nothing to fold.
_RAYS = 3
#: px between exact rays; positions between them are cubic. Relief of 100 px and longer is bent by less than
#: 1e-5 of its parallax.
_NODE_STEP = 2.0
#: px rendered beyond the frame, for the blur.
_BORDER = 4


@dataclass(frozen=True)
class Sensor:
    """How the cameras see.

    Attributes
    ----------
    snr : float
        Mean over noise of the mean ground.
    contrast : float
        Standard deviation of the ground's brightness, in units of its mean.
    mtf_nyquist : float
        Of the system, a Gaussian in the image, at half a cycle per pixel.
    """

    snr: float = 80.0
    contrast: float = 0.2
    mtf_nyquist: float = 0.15

    def __post_init__(self) -> None:
        """Check."""
        if not (self.snr > 0.0 and self.contrast > 0.0 and 0.0 < self.mtf_nyquist < 1.0):
            raise InputError(
                "`snr` and `contrast` must be positive and `mtf_nyquist` between 0 and 1, got "
                f"{self.snr:g}, {self.contrast:g} and {self.mtf_nyquist:g}"
            )


@dataclass(frozen=True, eq=False)
class TexturedGround:
    """What the cameras look at.

    Attributes
    ----------
    surface : Surface
        World axes.
    origin : (3,)
        m, world axes; where the local axes begin.
    world_from_local : Rotation
        x east, y north, z up there.
    texture : Layer
        Brightness less its mean, in units of the mean, at local places (x, y).
    """

    surface: Surface
    origin: Array
    world_from_local: Rotation
    texture: TextureLayer


def random_texture(
    seed: np.random.SeedSequence, gsd: float, reach: float, contrast: float = 0.2
) -> TextureLayer:
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


def render_frame(camera: FrameCamera, ground: TexturedGround, mtf_nyquist: float) -> Array32:
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
    met = ground.surface.intersect(rays.origins, rays.directions)
    if not np.isfinite(met).all():
        raise GeometryError("a line of sight misses the ground; make it larger (`ground_size`)")
    local = ((met - ground.origin) @ ground.world_from_local.as_matrix()).reshape(len(rows), len(places), 3)
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


def textured(
    surface: Surface, origin: Array, world_from_local: Rotation, frames: Sequence[FrameCamera], seed: int,
    contrast: float,
) -> TexturedGround:  # fmt: skip
    """The ground under some frames, with a random texture fine enough for all of them.

    Parameters
    ----------
    surface : Surface
    origin : (3,)
        m, world axes; the texture is laid out about it.
    world_from_local : Rotation
        x east, y north, z up there.
    frames : sequence of FrameCamera
    seed : int
    contrast : float
        Standard deviation, in units of the mean brightness.
    """
    finest, reach = np.inf, 0.0
    for camera in frames:
        lines, columns = camera.shape
        corners = np.array([[0, 0], [0, columns - 1], [lines - 1, 0], [lines - 1, columns - 1]], dtype=float)
        rays = camera.rays(corners)
        met = surface.intersect(rays.origins, rays.directions)
        if not np.isfinite(met).all():
            raise GeometryError("a frame does not lie on the ground; make it larger (`ground_size`)")
        ranges = np.linalg.norm(met - rays.origins, axis=1)
        finest = min(finest, float(ranges.min()) / camera.detector.focal_length_px)
        reach = max(reach, float(np.linalg.norm(met - origin, axis=1).max()))
    texture = random_texture(np.random.SeedSequence(seed, spawn_key=(2,)), finest, 1.05 * reach, contrast)
    return TexturedGround(surface, origin, world_from_local, texture)


def render_frames(
    frames: Sequence[FrameCamera], ground: TexturedGround, sensor: Sensor, seed: int
) -> Iterator[NDArray[np.uint16]]:
    """Each frame as the sensor gives it, (lines, columns) uint16, one at a time."""
    radiometry = Radiometry(snr=sensor.snr)
    for number, camera in enumerate(frames):
        light = render_frame(camera, ground, sensor.mtf_nyquist)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3, number)))
        yield radiometry.digitise(light * np.float32(radiometry.mean_dn), radiometry.mean_dn, rng)


def write_stereo_images(
    folder: Path,
    names: Sequence[str],
    images: Images,
    detectors: Sequence[AreaDetector],
    mounts: Sequence[Rotation],
    ground: tuple[Surface, Array, Rotation],
    sensor: Sensor,
    seed: int,
    step: Step = no_step,
) -> dict[str, Path]:
    """Render the frames of a block into `folder`, with ``images.csv`` (camera, shot, image).

    Parameters
    ----------
    folder : Path
        Exists.
    names : sequence of str
        Of the cameras.
    images : Images
        True poses.
    detectors, mounts : sequence
        True detector and body_from_camera of each camera.
    ground : (Surface, (3,), Rotation)
        Surface; origin and attitude (world_from_local) of the level axes that the texture is laid out in.
    sensor : Sensor
    seed : int
    step : callable
        Called with the number of frames that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name.
    """
    frames = frame_cameras(images, detectors, mounts)
    scene = textured(*ground, frames, seed, sensor.contrast)
    written, rows = {}, ["camera,shot,image"]
    for row, pixels in enumerate(render_frames(frames, scene, sensor, seed)):
        camera, shot = names[images.camera[row]], images.shot[row]
        name = f"camera-{camera}-shot-{shot:03d}.tif"
        written[name] = write_image(folder / name, pixels.shape, iter([(0, pixels)]))
        rows.append(f"{camera},{shot},{name}")
        step(row + 1, len(frames))
    table = folder / "images.csv"
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return {table.name: table, **written}
