"""One picture of all exposures of a camera, per filter, as a still camera would have seen the body.

Every strip is laid on the picture through the recovered cameras, resampled once by the package's kernel, and
blended into its neighbours over the lines that both saw.

Not here: bands of a push-broom (``register_bands.py``), the cameras (``applications/``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ArrayImage, ImageSource
from sightline.matching.on_geometry import resampled
from sightline.motion.band import Frame
from sightline.result import Result, makes_result

Array = NDArray[np.float64]
Image = NDArray[np.float32]

#: Lines over which a strip fades in at its ends, beside those the kernel cannot reach.
FADE_LINES, UNREACHED_LINES = 5.0, 3.0
#: Pixels per side of the grid that finds where a strip lies in the picture.
GRID = 9
#: Largest picture (px) that is made.
MOST_PIXELS = 100_000_000
#: cos of the largest angle from the middle of the picture at which anything is shown (a pinhole ends at 90
#: degrees).
LEAST_COSINE = 0.3


@dataclass(frozen=True, eq=False)
class BeforeSky:
    """A body with the sky behind it: rays that miss it end where they pass it nearest.

    Attributes
    ----------
    body : Surface
        Centred on the origin of the world axes.
    """

    body: Surface

    def intersect(self, origins: Array, directions: Array) -> Array:
        """Points (N, 3) m on the body, or beside it."""
        hit = self.body.intersect(origins, directions)
        along = np.maximum(-(origins * directions).sum(axis=1), 1.0)
        beside = origins + along[:, None] * directions
        return np.where(np.isfinite(hit), hit, beside)

    def raised(self, height: float) -> BeforeSky:
        """The same with the body `height` metres higher."""
        return BeforeSky(self.body.raised(height))


@dataclass(frozen=True, eq=False)
class CloudLayer:
    """What lies above the points of a body: clouds that one filter sees higher than another.

    Attributes
    ----------
    body : Surface
        Centred on the origin of the world axes.
    height : float
        m.
    """

    body: Surface
    height: float

    def intersect(self, origins: Array, directions: Array) -> Array:
        """Points (N, 3) m, `height` above where the rays meet the body."""
        hit = self.body.intersect(origins, directions)
        return np.asarray(hit * (1.0 + self.height / np.linalg.norm(hit, axis=1, keepdims=True)))

    def raised(self, height: float) -> CloudLayer:
        """The same over the body `height` metres higher."""
        return CloudLayer(self.body.raised(height), self.height)


@dataclass(frozen=True, eq=False, repr=False)
class Mosaic(Result):
    """A picture per strip, all in one geometry.

    Attributes
    ----------
    names : tuple of str
        Of the strips.
    pixels : (strips, lines, columns) float32
        In units of the images; NaN where nothing was seen.
    camera : FrameCamera
        Sees as the picture does.
    """

    names: tuple[str, ...]
    pixels: Image
    camera: FrameCamera


@makes_result
def frame_mosaic(
    frames: Sequence[Frame],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    *,
    names: Sequence[str] | None = None,
    heights: Sequence[float] | None = None,
    masked: bool = True,
) -> Mosaic:
    """All exposures as one picture per strip, seen from where the middle one was taken.

    Parameters
    ----------
    frames : sequence of Frame
        Images.
    cameras : sequence of FrameCamera
        As recovered, in the order of `frames`.
    surface : Surface
        The body; what misses it is sky.
    names : sequence of str, optional
        Of the strips.
    heights : sequence of float, optional
        m; of the layer that each strip sees above the surface.
    masked : bool
        Leave out masked pixels. Masks that only say where not to match (limb, night) are for
        ``masked=False``.

    Returns
    -------
    Mosaic

    Raises
    ------
    InputError
        If the picture would be too large.

    Notes
    -----
    The picture is that of a pinhole of the same focal length at the middle exposure. Where two exposures
    saw a point, they are averaged with weights that fall to zero at the ends of a strip: no seam remains but
    that of what changed between them.
    """
    whole = BeforeSky(surface)
    target = picture_camera(cameras, whole)
    strips = sorted({frame.strip for frame in frames})
    total = np.zeros((len(strips), *target.shape))
    weight = np.zeros((len(strips), *target.shape))
    for frame, camera in zip(frames, cameras, strict=True):
        box = _seen_box(camera, target, whole)
        if box is None:
            continue
        sources = (
            frame.image if masked else ArrayImage(_whole(frame.image)),
            ArrayImage(_fade(camera.shape)),
        )
        geometry = partial(predict_match, target, camera, whole)
        pixels, fade = (resampled(source, geometry, target.shape).read(*box) for source in sources)
        good = np.isfinite(pixels) & np.isfinite(fade)
        share = np.where(good, np.clip(fade, 1e-3, 1.0), 0.0)
        place = (strips.index(frame.strip), slice(*box[0]), slice(*box[1]))
        total[place] += np.where(good, pixels, 0.0) * share
        weight[place] += share
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(weight > 0.0, total / weight, np.nan).astype(np.float32)
    given = tuple(names) if names is not None else tuple(f"strip {k}" for k in strips)
    return Mosaic(given, mean, target)


def picture_camera(cameras: Sequence[FrameCamera], surface: Surface) -> FrameCamera:
    """A still pinhole at the middle exposure that sees what any of `cameras` sees of `surface`.

    Raises
    ------
    InputError
        If that is too much for one picture (a camera that has turned too far).
    """
    middle = cameras[len(cameras) // 2]
    line, column = middle.detector.principal_point_px
    plain = replace(middle.detector, distortion=())
    still = replace(middle, detector=plain, readout_time=0.0)
    axes, origin = _axes(still)
    places = []
    for camera in cameras:
        seen = (camera.locate(_grid(camera), surface) - origin) @ axes
        ahead = seen[:, 2] > LEAST_COSINE * np.linalg.norm(seen, axis=1)
        places.append(plain.pixels(seen[ahead]))
    every = np.concatenate(places)
    low, high = np.floor(every.min(axis=0)), np.ceil(every.max(axis=0))
    shape = int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1
    if shape[0] * shape[1] > MOST_PIXELS:
        raise InputError(
            f"the picture would have {shape[0]} x {shape[1]} pixels, more than {MOST_PIXELS}; give fewer "
            "exposures"
        )
    moved = (float(line - low[0]), float(column - low[1]))
    return still.with_detector(replace(plain, shape=shape, principal_point_px=moved))


def _axes(camera: FrameCamera) -> tuple[Array, Array]:
    """Camera axes in the world as columns (3, 3), and position (3,) m, of a camera without distortion."""
    line, column = camera.detector.principal_point_px
    focal = camera.detector.focal_length_px
    rays = camera.rays([[line, column], [line, column + focal], [line + focal, column]])
    ahead = rays.directions[0]
    right, down = (np.sqrt(2.0) * rays.directions[k] - ahead for k in (1, 2))
    return np.stack([right, down, ahead], axis=1), rays.origins[0]


def _grid(camera: FrameCamera) -> Array:
    """Pixels (GRID * GRID, 2) over a strip, corners included."""
    lines, columns = camera.shape
    grid = np.meshgrid(np.linspace(0, lines - 1, GRID), np.linspace(0, columns - 1, GRID), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 2)


def _seen_box(
    camera: FrameCamera, target: FrameCamera, surface: Surface
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Lines and columns (first, one past the last) of the picture that a strip covers; None if none."""
    pixels = target.project(camera.locate(_grid(camera), surface))
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(pixels):
        return None
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 3, target.shape)
    if (high <= low).any():
        return None
    return (int(low[0]), int(high[0])), (int(low[1]), int(high[1]))


def _whole(image: ImageSource) -> Image:
    """All pixels of a strip, whatever its mask says."""
    lines, columns = image.shape
    return np.asarray(image.read((0, lines), (0, columns)), dtype=np.float32)


def _fade(shape: tuple[int, int]) -> Image:
    """Weights of a strip's pixels: 1, falling to almost nothing at its first and last lines."""
    line = np.arange(shape[0])
    end = np.minimum(line, shape[0] - 1 - line) - UNREACHED_LINES
    return np.repeat(np.clip(end / FADE_LINES, 0.01, 1.0)[:, None], shape[1], axis=1).astype(np.float32)
