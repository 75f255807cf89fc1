"""Sensitivities of a whole grid of windows, computed on a few columns of each row and interpolated.

Across the field sensitivities are almost linear. Along the strip they follow the motion itself
(a yawing body turns a pitch into a roll), so every row gets its own: what ties a hidden constant
to the jitter of the other axes depends on it.

Not here: the exact values (``predict.sensitivities``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.surface import Surface
from sightline.motion.measure.predict import MovingCamera, StaticParameter, sensitivities
from sightline.motion.measure.windows import WindowGrid

Array = NDArray[np.float64]

#: Most rows computed exactly, and columns of each.
LINE_SAMPLES, COLUMN_SAMPLES = 4096, 5


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
) -> NDArray[np.float32]:
    """Sensitivities of every window of a grid, (G, 2, 7 + Q) float32.

    Columns: by the hub's roll, pitch, yaw; by the partner's; by height; by each static parameter.

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
    out = np.zeros((rows * blocks, 2, 7 + len(own)), dtype=np.float32)
    table = seen.reshape(rows, blocks)
    usable = np.flatnonzero(table.any(axis=1))
    if len(usable) == 0:
        return out
    at_rows = np.unique(np.linspace(0, len(usable) - 1, min(LINE_SAMPLES, len(usable))).round().astype(int))
    sample_rows = usable[at_rows]
    at_blocks = np.unique(np.linspace(0, blocks - 1, min(COLUMN_SAMPLES, blocks)).round().astype(int))
    pixels = np.stack(np.meshgrid(grid.lines[sample_rows], grid.columns[at_blocks], indexing="ij"), axis=-1)
    exact = sensitivities(cameras, hub, image, surface, pixels.reshape(-1, 2), statics)
    values = np.concatenate([exact.angles_a, exact.angles_b, exact.height[:, :, None], exact.statics], axis=2)
    values = values.reshape(len(sample_rows), len(at_blocks), -1)
    across = _fill_and_interpolate(values, at_blocks.astype(float), np.arange(blocks, dtype=float))
    whole = _fill_and_interpolate(
        across.transpose(1, 0, 2), sample_rows.astype(float), np.arange(rows, dtype=float)
    ).transpose(1, 0, 2)
    whole = whole.reshape(rows * blocks, 2, -1)
    if len(statics) < len(own) or any(parameter.whole for parameter in own):
        other = grid.window[1] if width is None else width
        columns = {image: (places[:, 1], other), hub: (grid.centres[:, 1], grid.window[1])}
        parts = [whole[..., :7]]
        for parameter in own:
            moved = whole[..., 7 + statics.index(parameter.whole or parameter)]
            if parameter.profile is not None and parameter.images[0] in columns:
                share = _averaged(parameter.profile, *columns[parameter.images[0]])
                moved = moved * share[:, None]
            parts.append(moved[..., None])
        whole = np.concatenate(parts, axis=2)
    return np.ascontiguousarray(whole, dtype=np.float32)


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
    for r in range(values.shape[0]):
        good = np.isfinite(values[r]).all(axis=1)
        if not good.any():
            out[r] = np.nan
            continue
        at = x[good]
        right = np.clip(np.searchsorted(at, wanted), 1, max(len(at) - 1, 1))
        if len(at) == 1:
            out[r] = values[r, good]
            continue
        w = np.clip((wanted - at[right - 1]) / (at[right] - at[right - 1]), 0.0, 1.0)
        v = values[r, good]
        out[r] = (1 - w)[:, None] * v[right - 1] + w[:, None] * v[right]
    return out
