"""Images of an ellipsoidal Earth: rays met with the ellipsoid in closed form, light, noise, space beyond.

Another ground may be met in its place: any function of rays.

The ground's brightness is a function of two coordinates of a ground point: its projection on a plane
square to a line of sight in the middle of the scene. On the side of the Earth that is seen they name every
place once, and a pixel covers about as much of the plane at the limb as at the nadir.

Not here: flat worlds (``sensor.py``), the ground's spectrum (``scene.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import GeometryError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import WGS84
from sightline.simulate.scene import Extent, Scene
from sightline.simulate.sensor import CHUNK_LINES, Radiometry, single_stages
from sightline.simulate.texture import Array, Array32

SPACE = 0.01
"""Brightness of the sky, in units of the mean ground."""

_GRID = 33
"""Rays along each side of the grid that stands for an image when its extent is sought."""


def meet_ellipsoid(origins: Array, directions: Array, radii: tuple[float, float] = WGS84) -> Array:
    """First meeting points (N, 3) of half-lines with an ellipsoid at height 0; NaN where they miss.

    The quadratic in axes scaled by the semi-axes, where the ellipsoid is a unit sphere.
    """
    scale = np.array([radii[0], radii[0], radii[1]])
    o, d = origins / scale, directions / scale
    a, half_b = (d * d).sum(axis=1), (o * d).sum(axis=1)
    # |o|^2 - 1 times a, less half_b^2, as one square of the distance from the centre: no cancellation
    nearest = o - (half_b / a)[:, None] * d
    under_root = (1.0 - (nearest * nearest).sum(axis=1)) / a
    with np.errstate(invalid="ignore"):
        along = -half_b / a - np.sqrt(np.where(under_root >= 0.0, under_root, np.nan))
    along = np.where(along > 0.0, along, np.nan)
    return origins + along[:, None] * directions


@dataclass(frozen=True, eq=False)
class ViewPlane:
    """Two coordinates of ground points: along the columns and along the lines of a scene.

    Parameters
    ----------
    origin : (3,) m, Earth-fixed
    axes : (2, 3) unit vectors square to the line of sight
    pixel : (float, float)
        m in the plane from one column, one line, to the next, in the middle of the scene.
    meet : callable
        Ground points (N, 3) that half-lines from origins (N, 3) along directions (N, 3) see; NaN where none.
    """

    origin: Array
    axes: Array
    pixel: tuple[float, float]
    meet: Callable[[Array, Array], Array] = meet_ellipsoid

    @classmethod
    def of(cls, camera: PushbroomCamera, meet: Callable[[Array, Array], Array] = meet_ellipsoid) -> ViewPlane:
        """The plane square to the middle of an image's lines of sight."""
        middle = np.array([(camera.lines - 1) / 2.0, (camera.columns - 1) / 2.0])
        rays = camera.rays(middle + np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]]))
        ground = meet(rays.origins, rays.directions)
        if not np.isfinite(ground).all():
            raise GeometryError("the middle of the scene looks past the ground; reduce the viewing angle")
        look = rays.directions[0]
        line, column = (
            step - look * (look @ step) for step in (ground[1] - ground[2], ground[3] - ground[4])
        )
        ahead = line / np.linalg.norm(line)
        aside = column - ahead * (ahead @ column)
        size = float(np.linalg.norm(aside)), float(np.linalg.norm(line))
        return cls(ground[0], np.stack([aside / size[0], ahead]), size, meet)

    def coordinates(self, points: Array) -> tuple[Array, Array]:
        """Coordinates x, y (N,) m of ground points (N, 3)."""
        x, y = self.axes @ (points - self.origin).T
        return x, y

    def extent(self, cameras: list[PushbroomCamera], margin: float) -> Extent:
        """What the images see of the plane, with `margin` pixels more."""
        found = []
        for camera in cameras:
            lines, columns = (np.linspace(0.0, n - 1.0, _GRID) for n in camera.shape)
            pixels = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)
            rays = camera.rays(pixels)
            found.append(np.stack(self.coordinates(self.meet(rays.origins, rays.directions))))
        x, y = np.concatenate(found, axis=1)
        more = margin * self.pixel[0], margin * self.pixel[1]
        low_x, high_x = np.nanmin(x) - more[0], np.nanmax(x) + more[0]
        return Extent(low_x, high_x, np.nanmin(y) - more[1], np.nanmax(y) + more[1])


def earth_brightness(
    camera: PushbroomCamera,
    scene: Scene,
    plane: ViewPlane,
    band: int,
    lines: tuple[int, int],
    parts: tuple[int, int] = (1, 1),
    stages: Mapping[int, Sequence[PushbroomCamera]] | None = None,
) -> Array32:
    """Noiseless brightness of lines ``lines[0]`` to ``lines[1] - 1``, in units of the mean ground.

    Each is the mean over `parts` points of a pixel along its lines and columns, and with TDI over what the
    cameras of its `stages` see, by how many it has.
    """
    down, along = ((np.arange(n) + 0.5) / n - 0.5 for n in parts)
    shifts = np.stack(np.meshgrid(down, along, indexing="ij"), axis=-1).reshape(-1, 2)
    pixels = np.stack(
        np.meshgrid(np.arange(*lines), np.arange(camera.columns), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    total = np.zeros(len(pixels), dtype=np.float32)
    counts = camera.stages_of(pixels.astype(np.float64))
    for count in np.unique(counts).astype(int).tolist():
        here = np.flatnonzero(counts == count)
        for one in (camera,) if stages is None else stages[count]:
            for shift in shifts:
                total[here] += _brightness_at(one, scene, plane, band, pixels[here] + shift)
        if stages is not None:
            total[here] /= np.float32(count)
    light = total / np.float32(len(shifts))
    return light.reshape(lines[1] - lines[0], camera.columns)


def _brightness_at(
    camera: PushbroomCamera, scene: Scene, plane: ViewPlane, band: int, pixels: Array
) -> Array32:
    """Brightness (N,) of what pixels (N, 2) see, fractions allowed."""
    rays = camera.rays(pixels)
    x, y = plane.coordinates(plane.meet(rays.origins, rays.directions))
    seen = np.isfinite(x)
    light = np.full(len(x), SPACE, dtype=np.float32)
    light[seen] = scene.ground_brightness(band, x[seen], y[seen])
    return light


def earth_chunks(
    camera: PushbroomCamera,
    scene: Scene,
    plane: ViewPlane,
    band: int,
    radiometry: Radiometry,
    seed: np.random.SeedSequence,
    parts: tuple[int, int] = (1, 1),
) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """The image of one band as (first line, block of lines), top to bottom; again alike at every call."""
    starts = range(0, camera.lines, CHUNK_LINES)
    streams = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key).spawn(len(starts))
    band_mean = radiometry.mean_dn * scene.bands[band].gain
    stages = None
    if camera.stages is not None:
        stages = {count: single_stages(camera, count) for count in np.unique(camera.stages).tolist()}
    for first, stream in zip(starts, streams, strict=True):
        last = min(first + CHUNK_LINES, camera.lines)
        light = earth_brightness(camera, scene, plane, band, (first, last), parts, stages)
        dn = light * np.float32(radiometry.mean_dn)
        yield first, radiometry.digitise(dn, band_mean, np.random.default_rng(stream))
