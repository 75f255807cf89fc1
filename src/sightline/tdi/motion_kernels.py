"""Compiled loop of the transfer under a measured motion: every setting of many columns in one pass.

Not here: its formula for one column (``imaging/tdi_transfer.py``, which checks it), what the motion is
(``motion_mtf.py``).
"""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def moved_mtf(across, along, velocity, levers, fx, fy, last, ratios, head, head_ratio, offset, moved, weight, out):  # type: ignore[no-untyped-def]
    """MTF of motion of every setting of columns that see one motion.

    Parameters
    ----------
    across, along, velocity : (G,)
        Pixels per line period: of the drift across; along, against the clock; along, past a pixel at rest.
    levers : (G, 2, D)
        Pixels across and along per unit of each kind of motion.
    fx, fy : float
        Cycles per pixel, each on its own axis.
    last : (n,) int, rising
        Numbers of stages.
    ratios : (R,)
    head : int
    head_ratio : float
        Of the head lines.
    offset : (K, R, Q)
        Line periods from the middle of a stage's line to the points of its exposure.
    moved : (K, R, Q, D)
        The motion at these points.
    weight : (Q,)
        Of the points, summing to 1.
    out : (G, n R, 2)
        Overwritten; settings ordered by stages, then ratio.
    """
    n_ratios, points, kinds = ratios.shape[0], weight.shape[0], levers.shape[2]
    turn = -2.0 * math.pi
    for g in range(across.shape[0]):
        for axis in range(2):
            f = turn * (fx if axis == 0 else fy)
            by_stage = f * (across[g] if axis == 0 else along[g])
            within = f * (across[g] if axis == 0 else velocity[g])
            for r in range(n_ratios):
                re = im = total = 0.0
                n = 0
                for k in range(last[-1]):
                    stage_re = stage_im = 0.0
                    for q in range(points):
                        phase = by_stage * k + within * offset[k, r, q]
                        for d in range(kinds):
                            phase += f * levers[g, axis, d] * moved[k, r, q, d]
                        stage_re += weight[q] * math.cos(phase)
                        stage_im += weight[q] * math.sin(phase)
                    length = head_ratio if k < head else ratios[r]
                    re += length * stage_re
                    im += length * stage_im
                    total += length
                    if k + 1 == last[n]:
                        out[g, n * n_ratios + r, axis] = math.sqrt(re * re + im * im) / total
                        n += 1
