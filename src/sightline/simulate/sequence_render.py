"""Frames of a ground: every pixel's exact ray cut with the relief, one pose per line, one stencil per pixel.

The ground is in ``sequence_ground.py``; noise and numbers are made by ``sensor.Radiometry``.
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.errors import GeometryError
from sightline.simulate.sequence_ground import SimulatedGround, spline_signal, water_share
from sightline.simulate.texture import Array, Array32

_TOLERANCE_PX = 1e-5  # of a ray's meeting with the relief


def render_channels(
    tangents: Array, matrices: Array, positions: Array, ground: SimulatedGround, weights: Array32, gsd: float
) -> Array32:
    """Noiseless relative signal (channels, lines, columns) of a frame.

    Parameters
    ----------
    tangents : (lines, columns, 2)
        x/z and y/z of every pixel in camera axes.
    matrices : (lines or 1, 3, 3)
        world_from_camera when each line is exposed; one for all lines without rolling shutter.
    positions : (lines or 1, 3) m, likewise
    ground : Ground
    weights : (channels, a, b, kinds)
        Of pixel (line, column): ``[:, line % a, column % b]``.
    gsd : float
        m, to which the meeting of a ray with the relief is refined (a hundred-thousandth of it).

    Raises
    ------
    GeometryError
        Where a ray points upwards or does not settle on the relief.
    """
    relief = ground.relief
    out = np.empty((len(weights), *tangents.shape[:2]), dtype=np.float32)
    corner = np.array([relief.west, relief.north, *relief.posting])
    # by place in the pattern, so that the channels of a pixel lie together
    by_place = np.ascontiguousarray(weights.transpose(1, 2, 0, 3))
    still = np.ascontiguousarray((by_place @ ground.still).astype(np.float32))
    if not _render(
        tangents, matrices, positions, relief.heights, corner, _TOLERANCE_PX * gsd, ground.amounts,
        ground.grid, by_place, still, ground.water, ground.edge, out,
    ):  # fmt: skip
        raise GeometryError(
            "a line of sight does not meet the relief: it looks upwards or along a slope; reduce the jitter, "
            "the field of view or the relief"
        )
    return out


@njit(cache=True, nogil=True)
def _render(
    tangents: Array,
    matrices: Array,
    positions: Array,
    heights: Array,
    corner: Array,
    tolerance: float,
    amounts: Array32,
    grid: Array,
    weights: Array32,
    still: Array32,
    water: Array,
    edge: float,
    out: Array32,
) -> bool:
    value = np.empty(out.shape[0], dtype=np.float32)
    for i in range(out.shape[1]):
        m = matrices[min(i, matrices.shape[0] - 1)]
        p = positions[min(i, positions.shape[0] - 1)]
        height = 0.0
        for j in range(out.shape[2]):
            a, b = tangents[i, j, 0], tangents[i, j, 1]
            dz = m[2, 0] * a + m[2, 1] * b + m[2, 2]
            if dz >= 0.0:
                return False
            u = (m[0, 0] * a + m[0, 1] * b + m[0, 2]) / dz
            v = (m[1, 0] * a + m[1, 1] * b + m[1, 2]) / dz
            height = _meet(p[0] - u * p[2], p[1] - v * p[2], u, v, height, heights, corner, tolerance)
            if np.isnan(height):
                return False
            x, y = p[0] + u * (height - p[2]), p[1] + v * (height - p[2])
            r, c = i % weights.shape[0], j % weights.shape[1]
            spline_signal(amounts, grid, x, y, weights[r, c], value)
            if water.shape[0] > 0:
                wet = np.float32(water_share(y, water, edge))
                for n in range(value.size):
                    value[n] += wet * (still[r, c, n] - value[n])
            for n in range(value.size):
                out[n, i, j] = value[n]
    return True


@njit(cache=True, nogil=True)
def _meet(
    x: float, y: float, u: float, v: float, height: float, heights: Array, corner: Array, tolerance: float
) -> float:
    """Height at which the ray (x + u h, y + v h, h) meets the bilinear relief, from a first guess; or NaN.

    Newton's steps within a cell; from the tenth on plain ones, which settle on any relief gentler than the
    rays.
    """
    rows, columns = heights.shape
    for step in range(80):
        p = min(max((x + u * height - corner[0]) / corner[2], 0.0), columns - 1.0)
        q = min(max((corner[1] - y - v * height) / corner[3], 0.0), rows - 1.0)
        c, r = min(int(p), columns - 2), min(int(q), rows - 2)
        p -= c
        q -= r
        nw, ne, sw, se = heights[r, c], heights[r, c + 1], heights[r + 1, c], heights[r + 1, c + 1]
        north, south = nw + p * (ne - nw), sw + p * (se - sw)
        miss = height - (north + q * (south - north))
        if abs(miss) < tolerance:
            return height - miss
        slope_x = ((1.0 - q) * (ne - nw) + q * (se - sw)) / corner[2]
        slope_y = (north - south) / corner[3]
        along = 1.0 - u * slope_x - v * slope_y
        height -= miss / along if step < 10 and along > 0.2 else miss
    return np.nan
