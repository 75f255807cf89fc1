"""What frames cannot tell: constants of the three axes, and what free lens constants and clocks imitate.

Not here: hidden directions of a strip (``motion/strip/joint.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")
#: A drift whose sigma exceeds so many times that of the rest of the motion counts as hidden.
HIDDEN_DRIFT = 3.0
#: A constant known to no better than this part of its prior is not tied by anything.
UNTIED = 0.5


def hidden_directions(covariance: Array, t: Array, scale: Array) -> tuple[Array, tuple[str, ...]]:
    """Motions that the frames see badly or not at all, each with what is tied to it.

    Parameters
    ----------
    covariance : (3n, 3n)
        rad^2; posterior of the angles, frame by frame.
    t : (n,)
        s; of the frames.
    scale : (3,)
        rad; one pixel of each axis.

    Returns
    -------
    directions : (n, 3, H)
        Constants of roll, pitch, yaw; then those drifts (ends at -1 and 1) that are hidden.
    names : tuple of str

    Notes
    -----
    A direction is how all angles move together when the mean (or the slope) of one axis is off:
    ``Cov(angles, f) / Cov(f, f)``, f the means and slopes. Drifts count when their sigma stands
    `HIDDEN_DRIFT` times above that of the motion left.
    """
    n = len(t)
    u = (t - t.mean()) / max(float(np.abs(t - t.mean()).max()), 1e-12)
    candidates = [("constant", axis, np.full(n, 1.0 / n)) for axis in range(3)]
    if n >= 4:
        candidates += [("drift", axis, u / (u @ u)) for axis in range(3)]
    chosen = list(range(3))
    while True:
        functionals = np.zeros((len(chosen), n, 3))
        for row, index in enumerate(chosen):
            functionals[row, :, candidates[index][1]] = candidates[index][2]
        flat = functionals.reshape(len(chosen), -1)
        across = covariance @ flat.T
        directions = (across @ np.linalg.inv(flat @ across)).reshape(n, 3, -1)
        left = relative_covariance(covariance, directions, scale)
        rest = np.sqrt(np.einsum("npnp->np", left.reshape(n, 3, n, 3)).mean(axis=0))
        worst = None
        for index in range(3, len(candidates)):
            if index in chosen:
                continue
            axis, weights = candidates[index][1], candidates[index][2]
            part = left.reshape(n, 3, n, 3)[:, axis, :, axis]
            sigma = float(np.sqrt(max(weights @ part @ weights, 0.0)))
            detrended = float(np.sqrt(max(rest[axis] ** 2 - sigma**2 * float(u @ u) / n, 1e-30)))
            if sigma > HIDDEN_DRIFT * detrended and (worst is None or sigma / detrended > worst[0]):
                worst = (sigma / detrended, index)
        if worst is None:
            names = tuple(f"{candidates[index][0]} of {AXES[candidates[index][1]]}" for index in chosen)
            return np.asarray(directions), names
        chosen = sorted([*chosen, worst[1]])


def relative_covariance(covariance: Array, directions: Array, scale: Array) -> Array:
    """Covariance (3n, 3n) of the angles, `directions` (n, 3, H) fitted away, every angle in `scale`."""
    n = directions.shape[0]
    units = np.tile(scale, n)
    q, _ = np.linalg.qr((directions / scale[None, :, None]).reshape(3 * n, -1))
    keep = np.eye(3 * n) - q @ q.T
    out = keep @ (covariance / np.outer(units, units)) @ keep * np.outer(units, units)
    return np.asarray(0.5 * (out + out.T))


def without(values: Array, directions: Array, scale: Array) -> Array:
    """`values` (n, 3) less their least-squares fit by `directions` (n, 3, H), in units of `scale`."""
    basis = (directions / scale[None, :, None]).reshape(values.size, -1)
    fit, *_ = np.linalg.lstsq(basis, (values / scale).ravel(), rcond=None)
    return np.asarray(values - (basis @ fit).reshape(values.shape) * scale)


def absolute_sigma(covariance: Array, prior: Array) -> Array:
    """Sigmas (n, 3) rad of the angles, hidden part included; infinite for an axis that only the prior ties.

    Parameters
    ----------
    covariance, prior : (3n, 3n)
        rad^2; posterior and prior of the angles.
    """
    n = len(covariance) // 3
    out = np.sqrt(np.diag(covariance)).reshape(n, 3).copy()
    for axis in range(3):
        mean = np.zeros((n, 3))
        mean[:, axis] = 1.0 / n
        w = mean.ravel()
        if np.sqrt(w @ covariance @ w) > UNTIED * np.sqrt(w @ prior @ w):
            out[:, axis] = np.inf
    return out
