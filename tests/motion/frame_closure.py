"""Do pairs of one lag tell the same story as pairs of another, within the sigmas they claim?

Attitude increments chained from neighbouring frames are compared with those that longer lags see
directly. Both share images, ground, lens and clock: the covariance of their difference knows it.

Not here: the estimates themselves (``frames.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.surface import Surface
from sightline.motion.frames.errors import Influence, outcome_covariance
from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.solve import FrameEstimate, solve_frames

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Closure:
    """Increments of attitude over `lag` frames from pairs at lag 1 alone, and from pairs at `lag` alone.

    Attributes
    ----------
    lag : int
    difference : (m, 3)
        rad; chained less direct.
    covariance : (3m, 3m)
        rad^2; of the differences, row by row.
    chained_sigma, direct_sigma : (m, 3)
        rad; of the increments by themselves.
    """

    lag: int
    difference: Array
    covariance: Array
    chained_sigma: Array
    direct_sigma: Array

    @property
    def sigma(self) -> Array:
        """(m, 3) rad; of the differences."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 3)

    @property
    def mean_square(self) -> Array:
        """(3,) mean square of the normalised differences of roll, pitch, yaw: 1 where the sigmas are true."""
        return np.asarray(((self.difference / self.sigma) ** 2).mean(axis=0))


def closure(
    stars: Sequence[FrameStar], estimate: FrameEstimate, surface: Surface, lag: int, *, chain: int = 1
) -> Closure:
    """Compare pairs at lag `chain` with pairs at `lag`, each solved alone for the attitudes.

    Parameters
    ----------
    stars : sequence of FrameStar
        Those of `estimate`.
    estimate : FrameEstimate
        Of all lags together: gives lens, clock and the laws of the errors.
    surface : Surface
    lag, chain : int
        Frames.
    """
    n = estimate.unknowns.frames
    rows = np.zeros((3 * (n - lag), estimate.unknowns.size))
    for k in range(n - lag):
        for axis in range(3):
            rows[3 * k + axis, 3 * (k + lag) + axis] = 1.0
            rows[3 * k + axis, 3 * k + axis] = -1.0
    chained, direct = (_alone(stars, estimate, surface, lags) for lags in (chain, lag))
    prior = np.asarray(np.linalg.inv(estimate.unknowns.prior_precision()), dtype=np.float64)

    def covariance(influence: Influence) -> Array:
        return outcome_covariance(influence, estimate.noise, estimate.ground, prior)

    both = chained.influence.plus(direct.influence.through(-np.eye(estimate.unknowns.size)))
    return Closure(
        lag,
        (rows @ (chained.x - direct.x)).reshape(-1, 3),
        covariance(both.through(rows)),
        *(
            np.sqrt(np.diag(covariance(part.influence.through(rows)))).reshape(-1, 3)
            for part in (chained, direct)
        ),
    )


@dataclass(frozen=True, eq=False)
class _Alone:
    """Unknowns from one lag, and how everything that errs moves them."""

    x: Array
    influence: Influence


def _alone(stars: Sequence[FrameStar], estimate: FrameEstimate, surface: Surface, lag: int) -> _Alone:
    """Attitudes from pairs at one lag, lens and clock as all lags together have them.

    What pairs of that lag err alike is not corrected: it would make lags agree that do not.
    """
    some = [part for part in (star.of_lags((lag,)) for star in stars) if part is not None]
    if not some:
        raise InputError(f"no pairs of frames at lag {lag} were matched; allowed are those in `stars`")
    unknowns, fixed = estimate.unknowns, 3 * estimate.unknowns.frames
    x, turns = estimate.x.copy(), unknowns.of_turns
    x[turns] = 0.0
    found = solve_frames(some, unknowns, surface, estimate.noise, x, steps=3, fixed=fixed)
    # an error of the constants that were taken for true moves the attitudes: -C N error
    response = np.zeros((unknowns.size, unknowns.size))
    response[:fixed, fixed:] = -np.linalg.solve(
        (found.information + unknowns.prior_precision())[:fixed, :fixed], found.information[:fixed, fixed:]
    )
    uncorrected = -response[:, turns].T
    response[:, turns] = 0.0
    constants = estimate.influence.through(response)
    constants.prior[turns] += uncorrected
    return _Alone(found.x, found.influence.spread_over(estimate.influence.stars).plus(constants))
