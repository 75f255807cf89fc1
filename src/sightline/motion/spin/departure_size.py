"""How large departures from an even spin are, as the data say: an average over what is likely, and a limit.

The size about each axis is a parameter of the prior. Its likelihood, the departures integrated out, is often
flat down to zero: the most likely size alone would then claim that there are none.

Not here: the departures themselves (``solve.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: rad; sizes that are weighed, all equally likely beforehand.
SIZES = np.geomspace(3e-7, 2e-3, 45)
#: Rounds over the three axes, each with the others as last found.
SWEEPS = 3
#: Probability of the limit.
LIMIT = 0.95


def departure_sizes(information: Array, rhs: Array, start: Array) -> tuple[Array, Array]:
    """Sizes of departures about roll, pitch, yaw.

    Parameters
    ----------
    information : (3n, 3n)
        Of the matches on the departures, instant by instant, everything else taken out.
    rhs : (3n,)
        Right-hand side of the same normal equations.
    start : (3,)
        rad; where to begin.

    Returns
    -------
    size : (3,)
        rad; root of the mean square over what is likely.
    limit : (3,)
        rad; 95 % of what is likely lies below.
    """
    size, limit = np.array(start, dtype=np.float64), np.zeros(3)
    # sizes are equally likely by themselves; the grid's are equally spaced in their logarithm
    width = SIZES
    for _ in range(SWEEPS):
        for axis in range(3):
            trial = np.tile(size, (len(SIZES), 1))
            trial[:, axis] = SIZES
            logs = np.array([log_likelihood(information, rhs, sizes) for sizes in trial])
            weight = np.exp(logs - logs.max()) * width
            weight /= weight.sum()
            size[axis] = np.sqrt(weight @ SIZES**2)
            limit[axis] = np.interp(LIMIT, np.cumsum(weight), SIZES)
    return size, limit


def log_likelihood(information: Array, rhs: Array, sizes: Array) -> float:
    """Logarithm of the likelihood of `sizes` (3,), the departures integrated out, up to a constant."""
    root = np.tile(sizes, len(rhs) // 3)
    factor = np.linalg.cholesky(np.eye(len(rhs)) + information * np.outer(root, root))
    half = np.linalg.solve(factor, root * rhs)
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())
