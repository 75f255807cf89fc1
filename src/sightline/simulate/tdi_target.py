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

    def paint(self, region: tuple[float, float, float, float], value: Array | float) -> None:
        """Lay `value` over a rectangle, its borders in pixels from the first pixel's corner."""
        top, bottom, left, right = (v - 0.5 for v in region)
        rows, columns = (
            slice(int(np.searchsorted(places, low - 1.0)), int(np.searchsorted(places, high + 1.0)))
            for places, low, high in ((self.y[:, 0], top, bottom), (self.x[0], left, right))
        )
        y, x, cells = self.y[rows], self.x[:, columns], self.cells[rows, columns]
        share = self.covered(y - top) * self.covered(bottom - y)
        share = share * (self.covered(x - left) * self.covered(right - x))
        laid = value[rows, columns] if isinstance(value, np.ndarray) else value
        cells += share * (laid - cells)


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
    canvas = _canvas(SHAPE, per_pixel, margin, AROUND)
    for region, along in ((EDGE_ACROSS, False), (EDGE_ALONG, True)):
        down = canvas.y - 0.5 * (region[0] + region[1] - 1)
        right = canvas.x - 0.5 * (region[2] + region[3] - 1)
        one, other = (down, right) if along else (right, down)
        side = canvas.covered(one * np.cos(EDGE_ANGLE) + other * np.sin(EDGE_ANGLE))
        canvas.paint(region, DARK + (BRIGHT - DARK) * side)
    canvas.paint(FLAT, LEVEL)
    _bars(canvas)
    rows = slice(*((line + margin) * per_pixel for line in (GROUND[0] - 1, GROUND[1] + 1)))
    ground = _Canvas(canvas.cells[rows], canvas.x, canvas.y[rows], per_pixel)
    ground.paint(GROUND, _ground(ground, GROUND, seed))
    return FineScene(canvas.cells, per_pixel, margin)


def _canvas(shape: tuple[int, int], per_pixel: int, margin: int, level: float) -> _Canvas:
    """A canvas of `shape` pixels and a margin, of one radiance."""
    cells = np.full([(n + 2 * margin) * per_pixel for n in shape], level)
    y, x = ((np.arange(n) + 0.5) / per_pixel - 0.5 - margin for n in cells.shape)
    return _Canvas(cells, x[None, :], y[:, None], per_pixel)


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


def ground_scene(shape: tuple[int, int], seed: int = 0, *, per_pixel: int = 4, margin: int = 16) -> FineScene:
    """Ground alone, `shape` pixels; parameters as of :func:`tdi_target`."""
    canvas = _canvas(shape, per_pixel, margin, AROUND)
    everywhere = (-margin, shape[0] + margin, -margin, shape[1] + margin)
    canvas.cells[...] = _ground(canvas, everywhere, seed)
    return FineScene(canvas.cells, per_pixel, margin)


def _ground(canvas: _Canvas, region: Region, seed: int) -> Array:
    """Fields, most of them ploughed, roads and houses, over a fine texture; densities per pixel."""
    from scipy.spatial import cKDTree

    sequence = np.random.SeedSequence([seed, 7])
    rng = np.random.default_rng(sequence)
    top, bottom, left, right = region
    area = (bottom - top) * (right - left)
    x, y = np.broadcast_arrays(canvas.x, canvas.y)
    seeds = rng.uniform((left - 12.0, top - 12.0), (right + 12.0, bottom + 12.0), (10 + area // 400, 2))
    found = cKDTree(seeds).query(np.stack([x, y], axis=-1), k=2)
    # the nearest two seeds: the field, and how far its border is
    field, gap = np.asarray(found[1])[..., 0], np.diff(np.asarray(found[0]), axis=-1)[..., 0]
    level = rng.uniform(0.55, 1.25, len(seeds))[field]
    # furrows: a grating of its own direction and period
    angle, period = rng.uniform(0.0, np.pi, len(seeds))[field], rng.uniform(2.6, 6.0, len(seeds))[field]
    depth = np.where(rng.random(len(seeds)) < 0.6, 0.35, 0.0)[field]
    wave = depth * np.sin(2.0 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period)
    texture = random_layer(
        sequence.spawn(1)[0], (512, 512), (0.5, 0.5), lambda fx, fy: (fx * fx + fy * fy + 0.01) ** -1.2
    ).at(x, y)
    ground = level * (1.0 + wave + 0.12 * texture / texture.std())
    ground += np.clip(1.0 - gap / 1.2, 0.0, 1.0) * (0.35 - ground)
    for _ in range(2 + area // 20000):
        # a road through a place, at an angle to both axes
        through, turn = rng.uniform((left, top), (right, bottom)), rng.uniform(0.15, 1.4)
        turn *= rng.choice([-1.0, 1.0])
        away = np.abs((x - through[0]) * np.sin(turn) - (y - through[1]) * np.cos(turn))
        ground += canvas.covered(0.5 * rng.uniform(1.6, 2.4) - away) * (1.7 - ground)
    layer = _Canvas(np.array(ground), canvas.x, canvas.y, canvas.per_pixel)
    for _ in range(area // 430):
        x0, y0 = rng.uniform((left + 4.0, top + 4.0), (right - 9.0, bottom - 9.0))
        width, height = rng.uniform(2.5, 6.0, 2)
        layer.paint((y0 + 1.5, y0 + height + 1.5, x0 + 1.5, x0 + width + 1.5), 0.15)
        layer.paint((y0, y0 + height, x0, x0 + width), rng.uniform(1.2, 1.9))
    return np.maximum(layer.cells, 0.05)
