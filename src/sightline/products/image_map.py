"""The map from one image to another, evaluated no more often than its smoothness asks.

Along a line of the grid the map bends with the ground, from line to line it jumps with the motion. So it is
evaluated at every line at columns far apart, and what relief makes of it between them at lines and columns
nearer to each other: bent ground passes under all lines alike.

Not here: resampling along the map (``register_bands.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.reduce import Mapping

Array = NDArray[np.float64]

#: px; deviation from the map, halfway between the places where it was evaluated, up to which they serve: a
#: fifth of what motion is known to at its best. Ground of 1/f^2 power changes by 3e-4 of its rms over it.
MAP_TOLERANCE = 1e-3
#: Pixels between those places: the first that holds the tolerance.
SPACINGS = (256, 128, 64, 32, 16, 8, 4)
#: Columns between the places of every line; nearer ones are shared by lines.
COARSE = 64
#: Columns between places where the map ends within a window: so far from its end it may be lost.
AT_ENDS = 16
#: Lines of a window on which the deviation is looked at.
CHECKED_LINES = 4


@dataclass(frozen=True, eq=False)
class MapSamples:
    """A map over one window of the grid.

    Attributes
    ----------
    nodes : (M,)
        Columns, from the first of the window to one past its last; the map is linear between them.
    position : (lines, M, 2)
        px, (line, column) in the image; NaN where there is none.
    error : float
        px; largest deviation found halfway between the places of evaluation.
    """

    nodes: NDArray[np.int64]
    position: Array
    error: float


def sample_map(mapping: Mapping, lines: tuple[int, int], columns: tuple[int, int]) -> MapSamples:
    """Evaluate a map over a window, as often as `MAP_TOLERANCE` asks.

    Parameters
    ----------
    mapping : callable
        ``mapping(lines, columns)``, (n,) and (M,) px of the grid, gives (n, M, 2) px in the image.
    lines, columns : (int, int)
        First and one past the last line (column) of the window.
    """
    for spacing in SPACINGS:
        nodes, error = _nodes(columns, spacing), _deviation(mapping, lines, columns, spacing)
        if error <= MAP_TOLERANCE:
            break
    rows = np.arange(*lines, dtype=np.float64)
    position = _position(mapping, rows, nodes, spacing, lines)
    if np.isfinite(position).all():
        return MapSamples(nodes, position, error)
    nodes = _nodes(columns, min(spacing, AT_ENDS))
    return MapSamples(nodes, mapping(rows, nodes.astype(np.float64)), error)


def _nodes(columns: tuple[int, int], spacing: int) -> NDArray[np.int64]:
    """Columns `spacing` apart, and one past the last."""
    return np.append(np.arange(columns[0], columns[1], spacing), columns[1])


def _position(
    mapping: Mapping, rows: Array, nodes: NDArray[np.int64], spacing: int, lines: tuple[int, int]
) -> Array:
    """The map at some rows (n,) of a window and at `nodes`, (n, M, 2)."""
    places = nodes.astype(np.float64)
    if spacing >= COARSE:
        return mapping(rows, places)
    some = np.unique(np.append(np.arange(0, len(nodes), COARSE // spacing), len(nodes) - 1))
    before = np.floor((rows - lines[0]) / spacing) * spacing + lines[0]
    after = np.minimum(before + spacing, lines[1] - 1)
    knots = np.union1d(before, after)
    at_knots = mapping(knots, places)
    bend = at_knots - _along(at_knots[:, some], places[some], places)
    low, high = np.searchsorted(knots, before), np.searchsorted(knots, after)
    share = ((rows - before) / np.maximum(after - before, 1.0))[:, None, None]
    return (
        _along(mapping(rows, places[some]), places[some], places)
        + bend[low]
        + share * (bend[high] - bend[low])
    )


def _along(values: Array, known: Array, places: Array) -> Array:
    """Values (n, K, 2) at columns `known` (K,) as (n, M, 2) at `places` (M,), linear between."""
    k = np.clip(np.searchsorted(known, places, side="right") - 1, 0, len(known) - 2)
    share = ((places - known[k]) / (known[k + 1] - known[k]))[None, :, None]
    return np.asarray(values[:, k] + share * (values[:, k + 1] - values[:, k]))


def _deviation(mapping: Mapping, lines: tuple[int, int], columns: tuple[int, int], spacing: int) -> float:
    """px; largest deviation halfway between columns, and between lines where these share places."""
    nodes = _nodes(columns, spacing)
    count = max(1, (lines[1] - lines[0]) // spacing)
    steps = np.unique(np.linspace(0, count - 1, CHECKED_LINES).astype(int))
    rows = np.unique(np.minimum(lines[0] + steps * spacing + spacing // 2, lines[1] - 1)).astype(np.float64)
    found = _position(mapping, rows, nodes, spacing, lines)
    halfway = 0.5 * (nodes[1:] + nodes[:-1]).astype(np.float64)
    exact = mapping(rows, halfway)
    off = np.abs(exact - 0.5 * (found[:, 1:] + found[:, :-1]))
    return float(np.nanmax(off)) if np.isfinite(off).any() else 0.0
