"""A scene to judge a TDI detector by: slanted edges, bars, a flat patch, and something like ground.

Not here: how it is imaged (``tdi_strip.py``), how edges are measured (``evaluation/slanted_edge.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.simulate.tdi_strip import FineScene
from sightline.simulate.texture import random_layer

Array = NDArray[np.float64]
#: First line, end line, first column, end column.
Region = tuple[int, int, int, int]

#: Lines and columns of the target.
SHAPE = (184, 144)
#: Edges are turned by so much against the column and against the line.
EDGE_ANGLE = float(np.radians(5.0))
#: The edge along the columns shows the MTF across, that along the lines the MTF along.
EDGE_ACROSS: Region = (4, 92, 4, 44)
EDGE_ALONG: Region = (4, 44, 52, 140)
FLAT: Region = (52, 92, 52, 92)
BARS: Region = (52, 92, 98, 140)
GROUND: Region = (98, 180, 4, 140)
#: Radiance of the two sides of an edge, of the flat patch, and around the patches.
DARK, BRIGHT, LEVEL, AROUND = 0.4, 1.6, 1.0, 0.7
#: Periods of the bars, pixels.
PERIODS = (6.0, 4.0, 3.0)


@dataclass(frozen=True, eq=False)
class _Canvas:
    """Cells of a fine grid being painted; places are pixels, (0, 0) the centre of the first pixel."""

    cells: Array
    x: Array
    y: Array
    per_pixel: int

    def covered(self, distance: Array) -> Array:
        """Share of cells on the positive side of a border `distance` pixels from their centres."""
        return np.clip(distance * self.per_pixel + 0.5, 0.0, 1.0)

    def box(self, region: tuple[float, float, float, float]) -> Array:
        """Share of cells inside a rectangle, its borders in pixels from the first pixel's corner."""
        top, bottom, left, right = (v - 0.5 for v in region)
        rows = self.covered(self.y - top) * self.covered(bottom - self.y)
        return rows * (self.covered(self.x - left) * self.covered(right - self.x))

    def paint(self, region: tuple[float, float, float, float], value: Array | float) -> None:
        """Lay `value` over a rectangle."""
        share = self.box(region)
        self.cells[...] += share * (value - self.cells)


def tdi_target(seed: int = 0, *, per_pixel: int = 8, margin: int = 16) -> FineScene:
    """The target, `SHAPE` pixels; radiance 1 is that of the flat patch.

    Parameters
    ----------
    seed : int
        Of the ground.
    per_pixel : int
        Cells per pixel, each way.
    margin : int
        Pixels around it.
    """
    cells = np.full([(n + 2 * margin) * per_pixel for n in SHAPE], AROUND)
    y, x = ((np.arange(n) + 0.5) / per_pixel - 0.5 - margin for n in cells.shape)
    canvas = _Canvas(cells, x[None, :], y[:, None], per_pixel)
    for region, along in ((EDGE_ACROSS, False), (EDGE_ALONG, True)):
        down = canvas.y - 0.5 * (region[0] + region[1] - 1)
        right = canvas.x - 0.5 * (region[2] + region[3] - 1)
        one, other = (down, right) if along else (right, down)
        side = canvas.covered(one * np.cos(EDGE_ANGLE) + other * np.sin(EDGE_ANGLE))
        canvas.paint(region, DARK + (BRIGHT - DARK) * side)
    canvas.paint(FLAT, LEVEL)
    _bars(canvas)
    rows = slice(int(np.searchsorted(y, GROUND[0] - 1)), int(np.searchsorted(y, GROUND[1] + 1)))
    ground = _Canvas(cells[rows], canvas.x, canvas.y[rows], per_pixel)
    ground.paint(GROUND, _ground(ground, seed))
    return FineScene(cells, per_pixel, margin)


def _bars(canvas: _Canvas) -> None:
    """Three bars of each period: standing ones (MTF across) above lying ones (MTF along)."""
    top, bottom, left, _ = BARS
    middle = 0.5 * (top + bottom)
    canvas.paint(BARS, DARK)
    begin = left + 2.0
    for period in PERIODS:
        end = begin + 2.5 * period
        for start in period * np.arange(3):
            canvas.paint((top + 2.0, middle - 1.0, begin + start, begin + start + 0.5 * period), BRIGHT)
            canvas.paint((middle + 1.0 + start, middle + 1.0 + start + 0.5 * period, begin, end), BRIGHT)
        begin = end + 2.0


def _ground(canvas: _Canvas, seed: int) -> Array:
    """Fields, some of them ploughed, roads and houses, over a fine texture."""
    from scipy.spatial import cKDTree

    sequence = np.random.SeedSequence([seed, 7])
    rng = np.random.default_rng(sequence)
    x, y = np.broadcast_arrays(canvas.x, canvas.y)
    seeds = rng.uniform((-8.0, 90.0), (152.0, 190.0), (38, 2))
    found = cKDTree(seeds).query(np.stack([x, y], axis=-1), k=2)
    # the nearest two seeds: the field, and how far its border is
    field, gap = np.asarray(found[1])[..., 0], np.diff(np.asarray(found[0]), axis=-1)[..., 0]
    level = rng.uniform(0.55, 1.25, len(seeds))[field]
    # furrows: a grating of its own direction and period in every other field
    angle, period = rng.uniform(0.0, np.pi, len(seeds)), rng.uniform(2.6, 6.0, len(seeds))
    depth = np.where(rng.random(len(seeds)) < 0.6, 0.35, 0.0)
    turn = angle[field]
    wave = np.sin(2.0 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / period[field])
    texture = random_layer(
        sequence.spawn(1)[0], (512, 512), (0.5, 0.5), lambda fx, fy: (fx * fx + fy * fy + 0.01) ** -1.2
    ).at(x, y)
    ground = level * (1.0 + depth[field] * wave + 0.12 * texture / texture.std())
    hedge = np.clip(1.0 - gap / 1.2, 0.0, 1.0)
    ground += hedge * (0.35 - ground)
    for offset, slope, width in ((128.0, 0.22, 2.2), (230.0, -0.9, 1.6), (60.0, 1.1, 1.6)):
        away = np.abs(y - offset - slope * x) / np.hypot(1.0, slope)
        ground += np.clip((0.5 * width - away) * canvas.per_pixel + 0.5, 0.0, 1.0) * (1.7 - ground)
    layer = _Canvas(np.array(ground), canvas.x, canvas.y, canvas.per_pixel)
    for _ in range(26):
        left, top = rng.uniform(8.0, 132.0), rng.uniform(102.0, 172.0)
        width, height = rng.uniform(2.5, 6.0, 2)
        layer.paint((top + 1.5, top + height + 1.5, left + 1.5, left + width + 1.5), 0.15)
        layer.paint((top, top + height, left, left + width), rng.uniform(1.2, 1.9))
    return np.maximum(layer.cells, 0.05)
