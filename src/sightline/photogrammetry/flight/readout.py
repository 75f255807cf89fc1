"""The readout time of a rolling shutter as one more unknown of a flight, bordering all others.

Sightings are brought to the first line of their frames by it. How the least cost and what it is reached at
follow it is linear: one more right-hand side of the equations of the poses, factored as they are.

Not here: how a camera moves within a frame (``rolling_shutter.py``), the adjustment (``poses.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.block.descent import BlockSums, Fit
from sightline.photogrammetry.block.linked_frames import LinkedFrames, reduce_block
from sightline.photogrammetry.block.observability import observability
from sightline.photogrammetry.block.reduced import PointsFirst


@dataclass(frozen=True)
class ReadoutTime:
    """The readout time of all frames, found with their poses.

    Attributes
    ----------
    seconds : float
        s, from the exposure of the first line to that of the last.
    sigma : float
        s, 1-sigma.
    prior : float
        s, 1-sigma of what was given of it.
    """

    seconds: float
    sigma: float
    prior: float


@dataclass(frozen=True, eq=False)
class ReadoutChange:
    """How sightings follow the readout time.

    Attributes
    ----------
    by_second : (N, 2)
        1/s; change of their tangents.
    seconds : float
        s; with which they were brought to first lines.
    given, prior : float
        s; what is known of it beforehand, and its 1-sigma.
    """

    by_second: Array
    seconds: float
    given: float
    prior: float


@dataclass(frozen=True, eq=False)
class ReadoutStep:
    """What the equations say of the readout time, and how all else follows it.

    Attributes
    ----------
    found : ReadoutTime
    step : float
        s; from that with which sightings were brought to first lines.
    departures : (M, D)
        Of all images, per s.
    points : (n, 3)
        m/s.
    common : (G,)
        Of the globals, per s.
    """

    found: ReadoutTime
    step: float
    departures: Array
    points: Array
    common: Array


def readout_step(block: BlockSums, fit: Fit, used: Array, change: ReadoutChange) -> ReadoutStep:
    """The readout time of the least cost, all else following.

    Parameters
    ----------
    block : BlockSums
    fit : Fit
        Its least cost for the present readout time.
    used : (N,)
        Weights of sightings.
    change : ReadoutChange

    Notes
    -----
    With residuals r, their change g with the readout time, and the normal matrix A = J' J of all else: all
    else follows by ``A^-1 J' g``, and ``g' g - g' J A^-1 J' g`` is what is known of the readout time. That is
    a small difference of large numbers, as a turn of all frames takes up nearly all that a readout time does:
    A must be of this very state.
    """
    curvature, _ = block.curvature(fit.state, used)
    reduced = reduce_block(curvature, block.unknowns)
    assert isinstance(reduced, PointsFirst | LinkedFrames)
    known = observability(reduced.information, block.unknowns.names, block.unknowns.limit)
    moved = frozen(block.sightings.tangents + change.by_second)
    ahead = BlockSums(replace(block.sightings, tangents=moved), block.unknowns, block.priors)
    here, there = (sums.gradient(fit.state, used) for sums in (block, ahead))
    own, points, common, g = (b - a for a, b in zip(here[:4], there[:4], strict=True))
    step = known.solve(reduced.condense(own, points, common))
    own_step, point_step = reduced.solve(own, points, common, step)

    def along(right: tuple[Array, Array, Array]) -> float:
        return float((right[0] * own_step).sum() + (right[1] * point_step).sum() + right[2] @ step)

    information = float((used * (g**2).sum(axis=1)).sum()) - along((own, points, common))
    # what steps left undone of the least cost is followed too
    slope = along((here[0], here[1], here[2])) - float((used * (g * here[3]).sum(axis=1)).sum())
    information = max(information, 0.0) + change.prior**-2.0
    slope -= (change.seconds - change.given) * change.prior**-2.0
    sigma, moves = information**-0.5, slope / information
    return ReadoutStep(
        ReadoutTime(change.seconds + moves, sigma, change.prior),
        moves,
        block.unknowns.departures(own_step, step),
        point_step,
        step,
    )


class WithReadout:
    """Covariances of frames that know the readout time no better than it was found."""

    def __init__(self, reduced: PointsFirst | LinkedFrames, step: ReadoutStep) -> None:
        self._reduced, self._follows, self._variance = reduced, step.departures, step.found.sigma**2

    def departure_covariance(self, covariance: Array) -> Array:
        """As of `reduced`."""
        more = self._variance * self._follows[:, :, None] * self._follows[:, None, :]
        return self._reduced.departure_covariance(covariance) + more

    def following_covariance(self, covariance: Array, count: int) -> Array | None:
        """As of `reduced`."""
        found = self._reduced.following_covariance(covariance, count)
        after, before = self._follows[1:count, :, None], self._follows[: count - 1, None]
        return None if found is None else found + self._variance * after * before

    def form_covariance(self, covariance: Array, forms: Array) -> Array:
        """As of `reduced`."""
        along = self._variance * np.einsum("mak,ma->k", forms, self._follows)
        return self._reduced.form_covariance(covariance, forms) + self._follows[:, :, None] * along


__all__ = ["ReadoutChange", "ReadoutStep", "ReadoutTime", "WithReadout", "readout_step"]
