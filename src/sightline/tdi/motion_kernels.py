"""Compiled loop of the transfer under a measured motion: every setting of many columns in one pass.

Not here: its formula for one column (``imaging/tdi_transfer.py``, which checks it), what the motion is
(``motion_mtf.py``).
"""

from __future__ import annotations

import math

import numpy as np

from sightline.compiled import njit

#: Taylor series of sine and cosine of 2 pi x; |x| <= 1/8 leaves 1e-17.
_SINE = tuple((-1.0) ** i * (2.0 * math.pi) ** (2 * i + 1) / math.factorial(2 * i + 1) for i in range(8))
_COSINE = tuple((-1.0) ** i * (2.0 * math.pi) ** (2 * i) / math.factorial(2 * i) for i in range(9))
_S0, _S1, _S2, _S3, _S4, _S5, _S6, _S7 = _SINE
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8 = _COSINE


@njit(cache=True, nogil=True, inline="always")
def _wave(turns):  # type: ignore[no-untyped-def]
    """Cosine and sine of an angle in turns: no branch and no call, so that loops over it run side by side."""
    quarter = math.floor(4.0 * turns + 0.5)
    x = turns - 0.25 * quarter
    z = x * x
    s = x * (_S0 + z * (_S1 + z * (_S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * (_S6 + z * _S7)))))))
    c = _C0 + z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * (_C6 + z * (_C7 + z * _C8)))))))
    quarter -= 4.0 * math.floor(0.25 * quarter)
    half = math.floor(0.5 * quarter)
    odd, sign = quarter - 2.0 * half, 1.0 - 2.0 * half
    return sign * (c - odd * (c + s)), sign * (s + odd * (c - s))


@njit(cache=True, nogil=True, fastmath=True)
def moved_mtf(  # type: ignore[no-untyped-def]
    across, along, velocity, levers, fx, fy, last, ratios, head, head_ratio, offset, moved, weight, out
):  # fmt: skip
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
    offset : (K, R Q)
        Line periods from the middle of a stage's line to the Q points of the exposure of every ratio.
    moved : (D, K, R Q)
        The motion at these points.
    weight : (Q,)
        Of the points, summing to 1.
    out : (G, n R, 2)
        Overwritten; settings ordered by stages, then ratio.
    """
    n_ratios, points, kinds, width = ratios.shape[0], weight.shape[0], levers.shape[2], offset.shape[1]
    turns, cosine, sine = np.empty(width), np.empty(width), np.empty(width)
    real, imaginary, total = np.empty(n_ratios), np.empty(n_ratios), np.empty(n_ratios)
    for g in range(across.shape[0]):
        for axis in range(2):
            f = -(fx if axis == 0 else fy)
            by_stage = f * (across[g] if axis == 0 else along[g])
            within = f * (across[g] if axis == 0 else velocity[g])
            for r in range(n_ratios):
                real[r] = imaginary[r] = total[r] = 0.0
            n = 0
            for k in range(last[-1]):
                for j in range(width):
                    turns[j] = by_stage * k + within * offset[k, j]
                for d in range(kinds):
                    lever = f * levers[g, axis, d]
                    for j in range(width):
                        turns[j] += lever * moved[d, k, j]
                for j in range(width):
                    cosine[j], sine[j] = _wave(turns[j])
                for r in range(n_ratios):
                    length = head_ratio if k < head else ratios[r]
                    re = im = 0.0
                    for q in range(points):
                        re += weight[q] * cosine[r * points + q]
                        im += weight[q] * sine[r * points + q]
                    real[r] += length * re
                    imaginary[r] += length * im
                    total[r] += length
                if k + 1 == last[n]:
                    for r in range(n_ratios):
                        size = math.sqrt(real[r] * real[r] + imaginary[r] * imaginary[r])
                        out[g, n * n_ratios + r, axis] = size / total[r]
                    n += 1
