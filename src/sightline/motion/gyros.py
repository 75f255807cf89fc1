"""Gyros whose counts have no scale, no axes: fitted to attitudes that are known, and turned into increments.

Four heads or more about three axes hold a parity: the sum that no turn of the body changes. What is left in
it is their noise.

Not here: reading counters (``io/formats/products/``), gyros as rows of the estimate (``strip/fusion.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.estimation.allan import allan_deviation, random_walk
from sightline.geometry.interpolation import interpolate

Array = NDArray[np.float64]

#: s by which readings may be late or early, and the steps in which that is sought.
_MOST_LAG, _LAG_STEP = 0.06, 0.002
#: Readings of the shortest record that is fitted: three axes and an offset want more attitudes than these.
_FEWEST = 6
#: Angle between two axes of a regular tetrahedron, degrees.
_TETRAHEDRON = float(np.degrees(np.arccos(-1.0 / 3.0)))


@dataclass(frozen=True, eq=False)
class GyroFit:
    """How the heads of a set of gyros sit in the body, by attitudes that were known.

    Attributes
    ----------
    gain : (G, 3)
        Counts per rad of the body's turn about x, y, z.
    offset : (G,)
        Counts per s that remain at rest.
    lag : float
        s by which the readings fit best when they are taken as that much late.
    residual : (M, 3)
        rad; increments of the gyros less those of the attitudes, from each attitude to the next.
    offset_sigma : float
        rad/s; 1-sigma of the body's rate by the scatter of `residual`.
    """

    gain: Array
    offset: Array
    lag: float
    residual: Array
    offset_sigma: float

    @property
    def scale(self) -> Array:
        """(G,) rad per count."""
        return np.asarray(1.0 / np.linalg.norm(self.gain, axis=1))

    @property
    def axes(self) -> Array:
        """(G, 3) unit vectors, body axes."""
        return np.asarray(self.gain * self.scale[:, None])

    def body(self, t: Array, counts: Array) -> Array:
        """Integrals (N, 3), rad, of the body's rates about x, y, z of `counts` (N, G) at `t` (N,) s."""
        return np.asarray(
            (counts - counts[0] - np.outer(t - t[0], self.offset)) @ np.linalg.pinv(self.gain).T
        )

    def parity(self, counts: Array) -> Array:
        """(N,) rad: what of `counts` (N, G) no turn of the body makes, with the noise of one head.

        Raises
        ------
        InputError
            Of three heads, which have none.

        Notes
        -----
        Four axes within a degree of a regular tetrahedron are taken as one: the sum of all heads is then free
        of turns, while what a fit over seconds finds lets some of them through by its own noise.
        """
        if len(self.gain) < 4:
            raise InputError(f"{len(self.gain)} gyros have no parity; four or more about three axes have one")
        left = np.linalg.svd(self.axes)[0][:, -1]
        apart = (self.axes @ self.axes.T)[np.triu_indices(len(self.axes), 1)]
        if len(self.gain) == 4 and (np.abs(np.degrees(np.arccos(apart)) - _TETRAHEDRON) < 1.0).all():
            left = np.full(4, 0.5)
        return np.asarray(((counts - counts[0]) * self.scale.mean()) @ left)

    def noise(self, t: Array, counts: Array) -> GyroNoise:
        """Noise by the Allan deviation of the parity of `counts` (N, G) at even times `t` (N,) s."""
        step = float(np.diff(t).mean())
        tau, deviation = allan_deviation(self.parity(counts), step)
        axes = np.linalg.pinv(self.axes)
        share = np.sqrt((axes**2).sum(axis=1))
        return GyroNoise(tau, deviation, np.asarray(random_walk(tau, deviation) * np.sqrt(step) * share))


@dataclass(frozen=True, eq=False)
class GyroNoise:
    """Noise of gyros by their parity.

    Attributes
    ----------
    tau, deviation : (K,)
        s, rad/s; Allan deviation of one head.
    sigma : (3,)
        rad; 1-sigma of an increment from reading to reading about x, y, z of the body: of a random walk that
        is nowhere below the deviation, so that increments may be taken as independent.
    """

    tau: Array
    deviation: Array
    sigma: Array


def fit_gyros(t: Array, counts: Array, t_known: Array, known: Rotation) -> GyroFit:
    """Scale, axes and offsets of gyros by attitudes of the body.

    Parameters
    ----------
    t : (N,)
        s, increasing.
    counts : (N, G)
        Of each head, unwrapped.
    t_known : (M,)
        s, increasing, within `t`.
    known : Rotation
        M attitudes, axes of the stars from body.

    Returns
    -------
    GyroFit

    Raises
    ------
    InputError
        If there are too few attitudes, or the body turned about fewer than three axes.

    Notes
    -----
    Integrals of body rates are taken as sums of rotation vectors from attitude to attitude: turns of a few
    mrad about axes that hardly move within a step.
    """
    if len(t_known) < _FEWEST or counts.shape[1] < 3:
        raise InputError(
            f"{counts.shape[1]} gyros and {len(t_known)} attitudes: three or more gyros and {_FEWEST} or "
            "more attitudes within their records are needed to fit scale and axes"
        )
    turned = np.vstack([np.zeros(3), np.cumsum((known[:-1].inv() * known[1:]).as_rotvec(), axis=0)])
    design = np.column_stack([turned, t_known - t_known[0], np.ones(len(t_known))])
    scale = np.abs(design).max(axis=0)
    if (scale == 0.0).any() or np.linalg.cond(design / scale) > 1e8:
        raise InputError(
            "the body turned about fewer than three axes: scale and axes of gyros cannot be fitted"
        )

    def fitted(lag: float) -> tuple[Array, Array]:
        read = interpolate(t, counts, t_known + lag)
        found = np.linalg.lstsq(design, read, rcond=None)[0]
        return found, read - design @ found

    lag = _best_lag(t, t_known, lambda shift: float((fitted(shift)[1] ** 2).sum()))
    found, _ = fitted(0.0)
    gain, offset = found[:3].T, found[3]
    read = interpolate(t, counts, t_known)
    increments = (np.diff(read, axis=0) - np.diff(t_known)[:, None] * offset) @ np.linalg.pinv(gain).T
    residual = increments - np.diff(turned, axis=0)
    # angles at both ends of the record bound the rate that is common to it
    sigma = float(np.sqrt(2.0) * residual.std() / (t_known[-1] - t_known[0]))
    return GyroFit(gain, offset, lag, residual, sigma)


def _best_lag(t: Array, t_known: Array, misfit: Callable[[float], float]) -> float:
    """The lag (s) of least misfit, by a parabola through the best of a grid and its neighbours."""
    least, most = max(-_MOST_LAG, t[0] - t_known[0]), min(_MOST_LAG, t[-1] - t_known[-1])
    lags = np.arange(least, most + 0.5 * _LAG_STEP, _LAG_STEP)
    values = np.array([misfit(float(lag)) for lag in lags])
    best = int(np.argmin(values))
    if not 0 < best < len(lags) - 1:
        return float(lags[best])
    before, here, after = values[best - 1 : best + 2]
    return float(lags[best] + 0.5 * _LAG_STEP * (before - after) / (before - 2.0 * here + after))


def departures(t: Array, turned: Array, reference: Rotation, rate: Array) -> Array:
    """Increments of the departure from a reference attitude that gyros show.

    Parameters
    ----------
    t : (N,)
        s.
    turned : (N, 3)
        rad; integrals of the body's rates relative to the stars.
    reference : Rotation
        N attitudes, world from body, at `t`.
    rate : (3,)
        rad/s of the world axes relative to the stars, world axes.

    Returns
    -------
    (N - 1, 3)
        rad, body axes; from each time to the next.
    """
    stars_from_body = Rotation.from_rotvec(np.outer(t - t[0], rate)) * reference
    expected = stars_from_body[:-1].inv() * stars_from_body[1:]
    return np.asarray((expected.inv() * Rotation.from_rotvec(np.diff(turned, axis=0))).as_rotvec())
