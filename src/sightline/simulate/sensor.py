"""Images of a scene: exact rays through true cameras, then light, noise and 12-bit numbers.

Rays come from the camera at nodes along each line and are carried to the pixels in between by cubic
interpolation of where they pierce two level planes (a ray is straight, so the two planes give it wholly);
the interpolation error is below 1e-9 of a pixel for any detector as smooth as a lens. Images are made in
chunks of lines with a random stream each: the result does not depend on how many chunks are asked for.

Rays, motions and detectors are those of ``geometry``; what they see is in ``scene.py``. Only scenes over a
flat world (local x east, y north, z up) are rendered here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit, only_read
from sightline.errors import GeometryError
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.simulate.scene import Relief, Scene
from sightline.simulate.texture import Array, Array32

#: Columns between the nodes at which the rays of a smooth detector line are computed.
NODE_STEP = 32
CHUNK_LINES = 64
"""Lines rendered at a time, each chunk with a random stream of its own."""


@dataclass(frozen=True)
class Radiometry:
    """How light becomes numbers.

    Parameters
    ----------
    mean_dn : float
        Digital number of the mean ground in a band of gain 1.
    snr : float
        Mean over noise, of the mean ground in every band.
    bits : int
        Depth of the converter: values are rounded and cut to 0 ... 2**bits - 1.
    photon_share : float
        Share of the noise variance at the mean that grows with the signal; the rest is constant (reading).
    """

    mean_dn: float = 1200.0
    snr: float = 120.0
    bits: int = 12
    photon_share: float = 0.8

    def digitise(self, dn: Array32, band_mean: float, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Noisy integers from noiseless digital numbers; `band_mean` is the DN at which `snr` holds."""
        variance = (band_mean / self.snr) ** 2
        level = np.float32(variance * self.photon_share / band_mean)
        spread = np.sqrt(level * np.maximum(dn, 0.0) + np.float32(variance * (1.0 - self.photon_share)))
        noisy = dn + spread * rng.standard_normal(dn.shape, dtype=np.float32)
        return np.clip(np.rint(noisy), 0, 2**self.bits - 1).astype(np.uint16)


@dataclass(frozen=True, eq=False)
class Footprint:
    """Where the pixels of a block of lines look.

    Parameters
    ----------
    t : (lines, columns) s
    x, y, z : (lines, columns) m, the ground seen
    x_slope, y_slope : (lines, columns) horizontal run of the ray per metre of height
    """

    t: Array
    x: Array
    y: Array
    z: Array
    x_slope: Array
    y_slope: Array

    def at_height(self, height: float) -> tuple[Array, Array]:
        """x and y where the rays pass the level `height`, m."""
        rise = height - self.z
        return self.x + self.x_slope * rise, self.y + self.y_slope * rise


def footprint(
    camera: PushbroomCamera | FrameCamera,
    lines: tuple[int, int],
    columns: int,
    relief: Relief | None,
    node_step: int = NODE_STEP,
    parts: tuple[int, int] = (1, 1),
) -> Footprint:
    """Ground seen by all columns of lines ``lines[0]`` to ``lines[1] - 1``, by exact rays.

    Parameters
    ----------
    camera : PushbroomCamera or FrameCamera
        Over a flat world.
    lines : (first, last + 1)
    columns : int
    relief : Relief or None
        None: the plane z = 0.
    node_step : int
        Columns between exact rays.
    parts : (int, int)
        So many evenly spread places of every line's exposure and of every pixel in place of their middles.

    Returns
    -------
    Footprint

    Raises
    ------
    GeometryError
        Where a ray points upwards or does not settle on the relief.
    """
    rows, columns = (lines[1] - lines[0]) * parts[0], columns * parts[1]
    nodes, first, weights = _nodes(columns, node_step * parts[1])
    pixels = np.empty((rows, nodes.size, 2))
    pixels[..., 0] = _places(np.arange(lines[0] * parts[0], lines[1] * parts[0]), parts[0])[:, None]
    pixels[..., 1] = _places(nodes, parts[1])
    rays = camera.rays(pixels.reshape(-1, 2))
    if not np.all(rays.directions[:, 2] < 0.0):
        raise GeometryError(
            "a line of sight does not point down: rendering needs every ray to meet the ground; "
            "reduce the motion or the viewing angles"
        )
    run = rays.directions[:, :2] / rays.directions[:, 2:]
    ground = rays.origins[:, :2] - run * rays.origins[:, 2:]
    t = np.repeat(rays.t.reshape(rows, nodes.size)[:, :1], columns, axis=1)
    x, y, u, v = (
        _between(np.ascontiguousarray(a.reshape(rows, nodes.size)), first, weights)
        for a in (ground[:, 0], ground[:, 1], run[:, 0], run[:, 1])
    )
    z = np.zeros_like(x)
    if relief is not None:
        corner = np.array([relief.west, relief.north, *relief.posting])
        if not _drop(x, y, z, u, v, *only_read(relief.heights), corner):
            raise GeometryError(
                "lines of sight do not settle on the relief: the ground is steeper than the rays; "
                "use gentler relief or view it closer to the vertical"
            )
    return Footprint(t, x, y, z, u, v)


def _places(numbers: NDArray[Any], parts: int) -> Array:
    """Where parts of pixels lie, by their number counted through."""
    return np.asarray((numbers - 0.5 * (parts - 1)) / parts, dtype=np.float64)


def _nodes(columns: int, step: int) -> tuple[Array, NDArray[np.intp], Array]:
    """Node columns, and per column the first of its four nodes with their weights (Lagrange)."""
    count = max(4, int(np.ceil((columns - 1) / step)) + 1)
    nodes = np.linspace(0.0, columns - 1.0, count)
    spacing = nodes[1] - nodes[0]
    place = np.arange(columns) / spacing
    first = np.clip(np.floor(place).astype(np.intp) - 1, 0, count - 4)
    s = place - first
    weights = np.stack(
        [
            -(s - 1) * (s - 2) * (s - 3) / 6,
            s * (s - 2) * (s - 3) / 2,
            -s * (s - 1) * (s - 3) / 2,
            s * (s - 1) * (s - 2) / 6,
        ],
        axis=1,
    )
    return nodes, first, weights


@njit(cache=True, nogil=True)
def _between(values: Array, first: NDArray[np.intp], weights: Array) -> Array:
    """Values (lines, nodes) carried to all columns: (lines, columns)."""
    out = np.empty((values.shape[0], first.size))
    for i in range(values.shape[0]):
        for j in range(first.size):
            k = first[j]
            out[i, j] = (
                weights[j, 0] * values[i, k]
                + weights[j, 1] * values[i, k + 1]
                + weights[j, 2] * values[i, k + 2]
                + weights[j, 3] * values[i, k + 3]
            )
    return out


@njit(cache=True, nogil=True)
def _drop(x: Array, y: Array, z: Array, u: Array, v: Array, heights: Array, corner: Array) -> bool:
    """Slide every ray along itself until it touches the bilinear relief; False if one does not settle.

    `x`, `y` enter at z = 0 and leave, with `z`, at the ground; `u`, `v` are the run per metre of height;
    `corner` is (west, north, posting x, posting y). Fixed-point iteration, to 1e-7 m.
    """
    rows, columns = heights.shape
    settled = True
    for i in range(x.shape[0]):
        height = 0.0
        for j in range(x.shape[1]):
            found = False
            for _ in range(60):
                p = (x[i, j] + u[i, j] * height - corner[0]) / corner[2]
                q = (corner[1] - y[i, j] - v[i, j] * height) / corner[3]
                p = min(max(p, 0.0), columns - 1.0)
                q = min(max(q, 0.0), rows - 1.0)
                c = min(int(p), columns - 2)
                r = min(int(q), rows - 2)
                p -= c
                q -= r
                new = (1.0 - q) * ((1.0 - p) * heights[r, c] + p * heights[r, c + 1]) + q * (
                    (1.0 - p) * heights[r + 1, c] + p * heights[r + 1, c + 1]
                )
                change = abs(new - height)
                height = new
                if change < 1e-7:
                    found = True
                    break
            settled = settled and found
            z[i, j] = height
            x[i, j] += u[i, j] * height
            y[i, j] += v[i, j] * height
    return settled


def render_block(
    camera: PushbroomCamera | FrameCamera,
    scene: Scene,
    band: int,
    lines: tuple[int, int],
    columns: int,
    node_step: int = NODE_STEP,
    parts: tuple[int, int] = (1, 1),
) -> Array32:
    """Noiseless brightness of a block of lines, in units of the mean ground: (lines, columns) float32.

    Of `parts` of every exposure and pixel it is the mean.
    """
    seen = footprint(camera, lines, columns, scene.relief, node_step, parts)
    light = scene.ground_brightness(band, seen.x, seen.y)
    if scene.clouds is not None:
        x, y = seen.at_height(scene.clouds.height)
        opacity = scene.clouds.opacity(x, y, seen.t)
        shine = scene.clouds.shine(x, y, seen.t) * np.float32(scene.bands[band].gain)
        light = light + opacity * (shine - light)
    if parts == (1, 1):
        return light
    blocks = light.reshape(lines[1] - lines[0], parts[0], columns, parts[1])
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64), dtype=np.float32)


def single_stages(camera: PushbroomCamera, count: int) -> list[PushbroomCamera]:
    """The cameras of the TDI stages, one after the other, of pixels of `camera` that have `count` of them.

    Each is a line period later than the one before, and a pixel further back.
    """
    period, out = camera.detector.line_period, []
    for stage in range(count):
        # line periods, and pixels, from the stage that the line is timed by
        late = {
            "centre": stage - 0.5 * (count - 1),
            "first-stage": float(stage),
            "last-stage": stage - (count - 1.0),
        }[camera.time_reference]
        out.append(
            replace(
                camera,
                detector=camera.detector.adjusted(-late),
                first_line_time=camera.first_line_time + late * period,
                line_times=None if camera.line_times is None else camera.line_times + late * period,
                stages=None,
                time_reference="centre",
            )
        )
    return out


def render_chunks(
    camera: PushbroomCamera | FrameCamera,
    scene: Scene,
    band: int,
    shape: tuple[int, int],
    radiometry: Radiometry,
    seed: np.random.SeedSequence,
    node_step: int = NODE_STEP,
    parts: tuple[int, int] = (1, 1),
    stages: Sequence[Sequence[PushbroomCamera]] = (),
) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """The image of one band, chunk by chunk.

    With TDI `stages` stand in the place of the camera: side by side the columns of equal numbers of stages,
    of each one camera per stage. Brightness is the mean of what they see.

    Yields
    ------
    first_line : int
    block : (lines, columns) uint16
    """
    count, columns = shape
    band_mean = radiometry.mean_dn * scene.bands[band].gain
    starts = range(0, count, CHUNK_LINES)
    # fresh children of the seed however often the image is asked for
    streams = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key).spawn(len(starts))
    for first, stream in zip(starts, streams, strict=True):
        last = min(first + CHUNK_LINES, count)
        if stages:
            sides = [
                sum(
                    render_block(one, scene, band, (first, last), one.columns, node_step, parts)
                    for one in side
                )
                / np.float32(len(side))
                for side in stages
            ]
            light = np.concatenate(sides, axis=1)
        else:
            light = render_block(camera, scene, band, (first, last), columns, node_step, parts)
        dn = light * np.float32(radiometry.mean_dn)
        yield first, radiometry.digitise(dn, band_mean, np.random.default_rng(stream))
