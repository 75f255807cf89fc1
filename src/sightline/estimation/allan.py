"""Allan deviation of a rate whose integral was read, and the random walk that is nowhere too small for it.

Not here: which sensor was read (``motion/gyros.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]


def allan_deviation(angles: ArrayLike, step: float, spans: ArrayLike | None = None) -> tuple[Array, Array]:
    """Overlapping Allan deviation of a rate against the time over which it is averaged.

    Parameters
    ----------
    angles : (N,)
        The integral of the rate, any unit, at even steps.
    step : float
        s from one reading to the next.
    spans : (K,) of int, optional
        Steps over which rates are averaged; powers of two up to a fifth of the readings if not given.

    Returns
    -------
    tau : (K,)
        s; `spans` times `step`.
    deviation : (K,)
        Unit of `angles` per s.

    Raises
    ------
    InputError
        Unless there are three readings or more at every span.

    Notes
    -----
    Half the mean square of the difference of successive mean rates (D. W. Allan, 1966), over all shifts
    (IEEE Std 952). White noise of a rate falls as tau^-1/2, of its integral as 1/tau.

    Examples
    --------
    >>> tau, deviation = allan_deviation([0.0, 1.0, 0.0, 1.0, 0.0], 0.5, [1])
    >>> deviation.tolist()
    [2.8284271247461903]
    """
    given = np.asarray(angles, dtype=np.float64)
    if given.ndim != 1 or not np.isfinite(given).all() or not step > 0.0:
        raise InputError(
            f"`angles` must be (N,) finite numbers at a step above 0 s, got {given.shape}, {step!r}"
        )
    if spans is None:
        spans = 2 ** np.arange(max(int(np.log2(max(len(given) // 5, 1))) + 1, 1))
    counts = np.asarray(spans, dtype=np.intp)
    if (counts < 1).any() or (2 * counts >= len(given)).any():
        raise InputError(
            f"`angles` are {len(given)} readings; each of `spans` needs more than twice as many, got "
            f"{counts.tolist()}"
        )
    bends = [given[2 * m :] - 2.0 * given[m:-m] + given[: -2 * m] for m in counts]
    tau = np.asarray(counts * step, dtype=np.float64)
    return np.asarray(tau), np.asarray(np.sqrt([0.5 * np.mean(bend**2) for bend in bends]) / tau)


def random_walk(tau: Array, deviation: Array) -> float:
    """Random walk of the angle (unit / s^.5) whose Allan deviation is nowhere below `deviation` (K,)."""
    return float((np.asarray(deviation) * np.sqrt(tau)).max())
