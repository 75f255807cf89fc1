"""Sensitivities of a whole grid of windows, computed on a few columns of each row and interpolated.

Across the field sensitivities are almost linear. Along the strip they follow the motion itself
(a yawing body turns a pitch into a roll), so every row gets its own: what ties a hidden constant
to the jitter of the other axes depends on it. Between rows farther apart than the jitter's periods nothing
can be interpolated: of 30,000 lines, every second row would have the slow motion wrong by several sigmas.

Not here: the exact values (``predict.sensitivities_by``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.surface import Surface
from sightline.motion.measure.predict import MovingCamera, Sides, StaticParameter, sensitivities_by
from sightline.motion.measure.windows import WindowGrid

Array = NDArray[np.float64]

#: Columns of each row that are computed exactly, and rows at once.
COLUMN_SAMPLES, AT_ONCE = 5, 512


def sampled_sensitivities(
    cameras: Sequence[MovingCamera],
    hub: int,
    image: int,
    surface: Surface,
    grid: WindowGrid,
    seen: NDArray[np.bool_],
    statics: Sequence[StaticParameter],
    places: Array,
    width: float | None = None,
) -> Iterator[tuple[slice, Array]]:
    """Sensitivities of every window of a grid, some rows at a time; nothing where no window is seen.

    Yields which windows, and theirs, (n, 2, 7 + Q): by the hub's roll, pitch, yaw; by the partner's; by
    height; by each static parameter.

    Parameters
    ----------
    seen : (G,)
        Windows whose partner lies inside the other image.
    places : (G, 2)
        px; where the windows lie in the other image.
    width : float, optional
        Columns of the other image that a window fills; as many as in the hub unless given.

    Notes
    -----
    What moves the columns of an image unlike is what moves all of them, times its profile averaged over each
    window: the few columns of a row would miss bends and steps.
    """
    own = statics
    statics = list(dict.fromkeys(parameter.whole or parameter for parameter in own))
    rows, blocks = grid.shape
    usable = np.asarray(seen.reshape(rows, blocks).any(axis=1))
    at_blocks = np.unique(np.linspace(0, blocks - 1, min(COLUMN_SAMPLES, blocks)).round().astype(int))
    other = grid.window[1] if width is None else width
    columns = {image: (places[:, 1], other), hub: (grid.centres[:, 1], grid.window[1])}
    shares = [_share(parameter, columns) for parameter in own]
    of_whole = [7 + statics.index(parameter.whole or parameter) for parameter in own]
    sides = Sides.of(cameras, hub, image, statics)
    # some rows at a time: all of a long strip would take more than all else of it
    for begin in range(0, rows, AT_ONCE):
        wanted = np.arange(begin, min(begin + AT_ONCE, rows))
        some = wanted[usable[wanted]]
        if len(some) == 0:
            continue
        pixels = np.stack(np.meshgrid(grid.lines[some], grid.columns[at_blocks], indexing="ij"), axis=-1)
        exact = sensitivities_by(sides, surface, pixels.reshape(-1, 2))
        values = np.concatenate(
            [exact.angles_a, exact.angles_b, exact.height[:, :, None], exact.statics], axis=2
        )
        values = values.reshape(len(some), len(at_blocks), -1)
        across = _fill_and_interpolate(values, at_blocks.astype(float), np.arange(blocks, dtype=float))
        across = np.ascontiguousarray(across.transpose(1, 0, 2))
        whole = _fill_and_interpolate(across, some.astype(float), wanted.astype(float)).transpose(1, 0, 2)
        whole = whole.reshape(len(wanted) * blocks, 2, -1)
        here = slice(begin * blocks, (begin + len(wanted)) * blocks)
        values = np.concatenate([whole[..., :7], whole[..., of_whole]], axis=2)
        for k, share in enumerate(shares):
            if share is not None:
                values[..., 7 + k] *= share[here, None]
        yield here, values


def _share(parameter: StaticParameter, columns: dict[int, tuple[Array, float]]) -> Array | None:
    """What a parameter moves each window by, as a share of what its `whole` does; None: as much."""
    if parameter.profile is None or parameter.images[0] not in columns:
        return None
    return _averaged(parameter.profile, *columns[parameter.images[0]])


def _averaged(profile: Array, columns: Array, width: float) -> Array:
    """Mean of a profile (columns,) over windows about `columns` (G,), `width` px wide."""
    edges = np.arange(len(profile) + 1) - 0.5
    summed = np.concatenate([[0.0], np.cumsum(profile)])
    low, high = columns - 0.5 * width, columns + 0.5 * width
    inside = np.clip(high, edges[0], edges[-1]) - np.clip(low, edges[0], edges[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((np.interp(high, edges, summed) - np.interp(low, edges, summed)) / inside)


def _fill_and_interpolate(values: Array, x: Array, wanted: Array) -> Array:
    """Linear interpolation of (rows, samples, C) along the second axis; NaN samples are bridged or held."""
    out = np.empty((values.shape[0], len(wanted), values.shape[2]))
    known = np.asarray(np.isfinite(values).all(axis=2))
    whole = np.asarray(known.all(axis=1))
    if whole.any():
        out[whole] = _between(values[whole], x, wanted)
    for r in np.flatnonzero(~whole):
        good = known[r]
        out[r] = _between(values[r : r + 1, good], x[good], wanted)[0] if good.any() else np.nan
    return out


def _between(values: Array, x: Array, wanted: Array) -> Array:
    """Linear interpolation of (rows, samples, C) known everywhere; the ends are held."""
    if len(x) == 1:
        return np.repeat(values, len(wanted), axis=1)
    right = np.clip(np.searchsorted(x, wanted), 1, len(x) - 1)
    w = np.clip((wanted - x[right - 1]) / (x[right] - x[right - 1]), 0.0, 1.0)[:, None]
    return np.asarray((1 - w) * values[:, right - 1] + w * values[:, right])
