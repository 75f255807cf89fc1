"""Windows laid on a hub image, predicted in the others: S1's boxes 20 and 22 for whole strips.

A window's prediction is the mean over its lines of where they should be, so that motion
faster than the window is already in it, with the local affine map of the window.

Not here: matching them (``matching/``), what they say (``observations.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.execution import slices
from sightline.geometry.camera import Camera, FrameCamera, PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
#: Images are read in stretches of about so many pixels.
_READ_PIXELS = 1_000_000
#: Windows that are worked on at a time.
_AT_ONCE = 8192
#: Windows that reach over less than this share of a line are laid for a partner that sees no more of it.
NARROW = 0.5
#: Parts of a window whose brightness is looked at, and how many columns each has at least.
PARTS, LEAST_PART = 8, 8
MovingCamera = PushbroomCamera | FrameCamera


@dataclass(frozen=True, eq=False)
class WindowGrid:
    """Windows of one size on a regular grid: centres (rows * blocks, 2) px, row by row."""

    window: tuple[int, int]
    lines: Array
    columns: Array

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, blocks)."""
        return len(self.lines), len(self.columns)

    @property
    def count(self) -> int:
        """How many windows there are."""
        return len(self.lines) * len(self.columns)

    def stretches(self) -> list[slice]:
        """Whole rows of windows, some at a time."""
        return stretches(*self.shape)

    @property
    def centres(self) -> Array:
        """(rows * blocks, 2) px, (line, column); at half pixels where the size is even."""
        out = scratch_array((self.count, 2))
        table = out.reshape(*self.shape, 2)
        table[..., 0], table[..., 1] = self.lines[:, None], self.columns
        return out

    @property
    def sides(self) -> tuple[float, float]:
        """First column of the first window, and one past the last of the last; px."""
        half = self.window[1] / 2.0
        return float(self.columns[0] - half + 0.5), float(self.columns[-1] + half + 0.5)

    def narrow(self, columns: int) -> bool:
        """Whether the windows leave a good part of a line of so many columns out."""
        first, last = self.sides
        return last - first < NARROW * columns


@dataclass(frozen=True, eq=False)
class Predictions:
    """Where the windows of a hub should be in one partner.

    Attributes
    ----------
    b : (G, 2)
        px; mean over the window's lines; NaN where not seen.
    affine : (G, 2, 2)
        px/px; change of b with (line, column) in the hub.
    t : (G,)
        s; exposure of the partner.
    """

    b: Array
    affine: Array
    t: Array


def window_grid(
    shape: tuple[int, int], window: tuple[int, int], step: int, *, columns_step: int | None = None
) -> WindowGrid:
    """Lay windows of (lines, columns) px on an image, `step` lines apart.

    Parameters
    ----------
    shape : (lines, columns)
        Of the image, px.
    window : (lines, columns)
        Of one window, px; cut to the image where it is larger.
    step : int
        Lines between rows of windows.
    columns_step : int, optional
        Columns between windows; the width by default (side by side).
    """
    height, width = min(window[0], shape[0]), min(window[1], shape[1])
    columns_step = columns_step or width
    blocks = max(1, (shape[1] - width) // columns_step + 1)
    left = (shape[1] - (width + (blocks - 1) * columns_step)) // 2
    columns = left + (width - 1) / 2 + columns_step * np.arange(blocks)
    lines = (height - 1) / 2 + np.arange(0, shape[0] - height + 1, step)
    return WindowGrid((height, width), lines.astype(float), columns.astype(float))


def stretches(rows: int, blocks: int, at_once: int | None = None) -> list[slice]:
    """Windows of whole rows, so many at a time."""
    blocks = max(blocks, 1)
    return slices(rows * blocks, max((at_once or _AT_ONCE) // blocks, 1) * blocks)


def brightest_parts(image: ImageSource, grid: WindowGrid) -> Array:
    """(rows * blocks,) mean of the brightest part of each window, in units of the image; NaN where none.

    A window has up to PARTS parts side by side: what fills one of them hardly shows in the mean of all.

    Parameters
    ----------
    image : ImageSource
    grid : WindowGrid
        Windows inside the image.
    """
    height, width = grid.window
    top = np.rint(grid.lines - (height - 1) / 2).astype(np.intp)
    left = np.rint(grid.columns - (width - 1) / 2).astype(np.intp)
    far = np.maximum(height, _READ_PIXELS // image.shape[1])
    out = np.full(grid.shape, np.nan)
    first = 0
    while first < len(top):
        # rows of windows that are near each other are read together
        last = int(np.searchsorted(top, top[first] + far, side="right"))
        part = top[first:last]
        pixels = image.read((int(part[0]), int(part[-1]) + height), (0, image.shape[1]))
        out[first:last] = _brightest(pixels, part - part[0], left, grid.window)
        first = last
    return out.ravel()


def _brightest(
    pixels: NDArray[np.float32], top: NDArray[np.intp], left: NDArray[np.intp], window: tuple[int, int]
) -> Array:
    """Mean (rows, blocks) of the brightest part of windows that begin at lines `top` and columns `left`."""
    height, width = window
    measured = np.isfinite(pixels)
    whole = bool(measured.all())
    table = pixels if whole else np.where(measured, pixels, np.float32(0.0))
    out = np.full((len(top), len(left)), np.nan)
    edges = np.linspace(0, width, max(1, min(PARTS, width // LEAST_PART)) + 1).astype(np.intp)
    for begin, end in pairwise(edges):
        size = (height, int(end - begin))
        sums = _area_sums(table, top, left + begin, size)
        number = math.prod(size) if whole else _area_sums(measured, top, left + begin, size)
        out = np.fmax(out, sums / np.where(number > 0, number, np.nan))
    return out


def _area_sums(
    table: NDArray[np.float32] | NDArray[np.bool_],
    top: NDArray[np.intp],
    left: NDArray[np.intp],
    window: tuple[int, int],
) -> Array:
    """Sums (rows, blocks) over windows of a table."""
    height, width = window
    lines = np.stack([table[:, c : c + width].sum(axis=1, dtype=np.float64) for c in left], axis=1)
    total = np.concatenate([np.zeros((1, len(left))), np.cumsum(lines, axis=0)])
    return np.asarray(total[top + height] - total[top])


def predict_windows(
    cameras: Sequence[MovingCamera], hub: int, images: Sequence[int], surface: Surface, grid: WindowGrid
) -> list[Predictions]:
    """Predict all windows of a grid in each partner, with the best motion known to the cameras.

    Notes
    -----
    The mean over the lines is taken by two-point quadrature (Gauss's nodes for evenly spaced lines: exact for
    a motion cubic in time), whose two points also give the change along the lines; the change along the
    columns comes from the neighbours in the row (or from two points inside the window when it is alone).
    """
    blocks = len(grid.columns)
    sizes = ((grid.count, 2), (grid.count, 2, 2), (grid.count,))
    found = [Predictions(*map(scratch_array, sizes)) for _ in images]
    for part in grid.stretches():
        some = WindowGrid(grid.window, grid.lines[part.start // blocks : part.stop // blocks], grid.columns)
        for whole, one in zip(found, _predicted(cameras, hub, images, surface, some), strict=True):
            whole.b[part], whole.affine[part], whole.t[part] = one.b, one.affine, one.t
        let_go()
    return found


def _predicted(
    cameras: Sequence[MovingCamera], hub: int, images: Sequence[int], surface: Surface, grid: WindowGrid
) -> list[Predictions]:
    """The same for windows of a few rows."""
    rows, blocks = grid.shape
    centres = grid.centres
    reach = math.sqrt(max(grid.window[0] ** 2 - 1, 1) / 12.0)
    ground = [cameras[hub].locate(centres + np.array([side * reach, 0.0]), surface) for side in (-1.0, 1.0)]
    sideways: list[Array] = []
    if blocks == 1:
        span = grid.window[1] / (2.0 * math.sqrt(3.0))
        for side in (-1.0, 1.0):
            sideways.append(cameras[hub].locate(centres + np.array([0.0, side * span]), surface))
    out = []
    for image in images:
        camera = cameras[image]
        low, high = camera.project(ground[0]), camera.project(ground[1])
        b = 0.5 * (low + high)
        affine = np.empty((len(b), 2, 2))
        affine[:, :, 0] = (high - low) / (2.0 * reach)
        if blocks == 1:
            affine[:, :, 1] = (camera.project(sideways[1]) - camera.project(sideways[0])) / (2.0 * span)
        else:
            table = b.reshape(rows, blocks, 2)
            slope = np.asarray(np.gradient(table, grid.columns, axis=1), dtype=np.float64)
            affine[:, :, 1] = slope.reshape(-1, 2)
        bad = ~np.isfinite(affine[:, :, 1]).all(axis=1)
        affine[bad, :, 1] = np.array([0.0, 1.0])
        out.append(Predictions(b, affine, exposure_times(camera, b)))
    return out


def exposure_times(camera: Camera, pixels: Array) -> Array:
    """Instants (N,) s at which `pixels` (N, 2) were exposed (middle of TDI stages); NaN for NaN pixels."""
    if isinstance(camera, PushbroomCamera):
        out = np.full(len(pixels), np.nan)
        seen = np.isfinite(pixels[:, 0])
        out[seen] = camera.times(pixels[seen, 0])
        if camera.stages is not None:
            out[seen] += camera.delays(pixels[seen])
        return out
    if isinstance(camera, FrameCamera):
        return camera.times(pixels[:, 0])
    raise EstimationError(f"exposure times are not known for a camera of type {type(camera).__name__}")


def near_instants(instants: Array, t: Array, reach: float) -> NDArray[np.bool_]:
    """Whether any of `instants` (s; NaN is none) lies within `reach` (s) of each of `t` (N,)."""
    known = np.sort(instants[np.isfinite(instants)])
    if not len(known):
        return np.zeros(len(t), dtype=bool)
    at = np.clip(np.searchsorted(known, t), 1, max(len(known) - 1, 1))
    gap = np.minimum(np.abs(t - known[at - 1]), np.abs(t - known[np.minimum(at, len(known) - 1)]))
    return np.asarray(gap <= reach)


def field_positions(columns: Array, width: int) -> Array:
    """Columns as positions across the field, -1 .. 1 from edge to edge."""
    half = max((width - 1) / 2.0, 1.0)
    return np.asarray((columns - half) / half)


def image_shape(camera: MovingCamera) -> tuple[int, int]:
    """(lines, columns) of the image a camera takes."""
    if isinstance(camera, PushbroomCamera):
        return camera.lines, camera.columns
    return camera.detector.shape
