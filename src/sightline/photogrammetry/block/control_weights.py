"""Control points that do not go with the others: they weigh less the farther they lie off.

Not here: control points of flights, which are tried one by one (``flight/control_check.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.estimation.robust import doubted_weights
from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.sightings import Sightings

#: Sigmas by which a control point may lie off the others, the mean over its coordinates: a chi-square of 48
#: for three numbers, 2e-10 by chance, so that of any number of right ones none weighs less. Weight below
#: which one is named: 4 sigmas times the fourth root of 2, 4.8, as one at the limit says nearly what it did.
_CUT, _DOUBTED = 4.0, 0.5
#: Times that weights are found, first beside what the most of the control points are off; when they stay.
_WEIGHINGS, _STAY = 4, 0.05
#: Median of chi squared of three numbers, over three; squares of what the adjustment left out altogether.
_MEDIAN, _LEFT_OUT = 2.366 / 3.0, 1e6
#: Control points that are named.
_NAMED = 8


@dataclass(frozen=True, eq=False)
class AdjustedPlaces:
    """Points of an adjustment.

    Attributes
    ----------
    points : (n, 3)
        m
    covariance : (n, 3, 3)
        m^2
    held : bool
        What is known of points beforehand is in the covariance; that of their rays alone is given otherwise.
    """

    points: Array
    covariance: Array
    held: bool


def squared_misses(control: ControlPoints, weight: Array, found: AdjustedPlaces) -> Array:
    """How far control points lie from where all else puts them, (G,): square over variance, a coordinate's.

    Parameters
    ----------
    control : ControlPoints
        With the sigmas that are given.
    weight : (G,)
        With which they counted: information over that given.
    found : AdjustedPlaces
        Adjusted with them.

    Notes
    -----
    Of an adjusted place X of covariance C the control point c of information W took its part: without it the
    covariance is P = inv(inv(C) - W), and the place lies (1 + P W) (X - c) off.
    """
    out = np.full(len(control.point), _LEFT_OUT)
    place, known = found.points[control.point], found.covariance[control.point]
    seen = np.isfinite(place).all(axis=1)
    # of one ray and no covariance: what its two directions pull the place off
    out[seen] = ((place[seen] - control.position[seen]) ** 2).sum(axis=1) / (2.0 * control.sigma[seen] ** 2)
    seen &= np.isfinite(known).all(axis=(1, 2))
    variance = control.sigma[seen, None] ** 2
    own = weight[seen, None] / variance
    size, axes = np.linalg.eigh(known[seen])
    if found.held:
        # nothing but the control point itself may hold a point along an axis
        size = 1.0 / np.maximum(1.0 / size - own, 1e-9 * own)
    off = np.einsum("nja,nj->na", axes, place[seen] - control.position[seen]) * (1.0 + size * own)
    out[seen] = (off**2 / (size + variance)).mean(axis=1)
    return out


def weighed_control(
    sightings: Sightings,
    control: ControlPoints,
    names: Array,
    first: AdjustedPlaces,
    solve: Callable[[ControlPoints], AdjustedPlaces],
) -> tuple[ControlPoints, tuple[str, ...]]:
    """Control points with the sigmas that the others bear out, and words of those that are doubted.

    Parameters
    ----------
    sightings : Sightings
    control : ControlPoints
    names : (n,)
        Number of each point as the user gave it.
    first : AdjustedPlaces
        Adjusted with the control points as they are given.
    solve : callable
        The same with others.

    Raises
    ------
    EstimationError
        More than half of them are doubted: nothing shows which are right.
    """
    squared = squared_misses(control, np.ones(len(control.point)), first)
    if squared.max(initial=0.0) <= _CUT**2:
        return control, ()
    # wrong ones have drawn the poses, and right ones may seem gross errors: begin with all as good as rays
    weight = np.minimum(1.0, (control.sigma / _beside_rays(sightings, control)) ** 2)
    for number in range(2 * _WEIGHINGS):
        squared = squared_misses(control, weight, solve(_weighed(control, weight)))
        beside = max(float(np.median(squared)) / _MEDIAN, 1.0) if number < _WEIGHINGS else 1.0
        last, weight = weight, doubted_weights(squared / beside, _CUT)
        if number >= _WEIGHINGS and np.allclose(weight, last, atol=_STAY):
            break
    doubted = np.flatnonzero(weight < _DOUBTED)
    if 2 * len(doubted) > len(weight):
        raise EstimationError(
            f"{len(doubted)} of {len(weight)} control points do not go with the others and the planned poses "
            f"({_listed(control, names, doubted, squared)}): nothing shows which are right; check their axes "
            "and units, [world] frame, their sigma, and where they were seen"
        )
    return _weighed(control, weight), tuple(
        f"{_named(control, names, row)} lies {np.sqrt(squared[row]):.3g} of its sigmas from where all else "
        f"puts it, and weighs {weight[row]:.2g} of what was given: check its coordinates, and where it was "
        "seen"
        for row in doubted.tolist()
    )


def _weighed(control: ControlPoints, weight: Array) -> ControlPoints:
    """With information of so much of that given."""
    return replace(control, sigma=frozen(control.sigma / np.sqrt(np.maximum(weight, 1e-12))))


def _beside_rays(sightings: Sightings, control: ControlPoints) -> float:
    """m by which control points lie beside the rays of planned poses, the median."""
    row = np.full(sightings.points, -1, dtype=np.intp)
    row[control.point] = np.arange(len(control.point))
    seen: NDArray[np.intp] = np.flatnonzero(row[sightings.point] >= 0)
    pose, camera = sightings.pose[seen], sightings.camera[sightings.image[seen]]
    rays = np.column_stack([sightings.tangents[seen], np.ones(len(seen))])
    rays = np.einsum(
        "nij,njk,nk->ni", sightings.world_from_body[pose], sightings.body_from_camera[camera], rays
    )
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    to = control.position[row[sightings.point[seen]]] - sightings.position[pose]
    beside = np.linalg.norm(to - (to * rays).sum(axis=1)[:, None] * rays, axis=1)
    return max(float(np.median(beside)) if len(seen) else 0.0, float(control.sigma.min()))


def _named(control: ControlPoints, names: Array, row: int) -> str:
    place = ", ".join(f"{v:.7g}" for v in control.position[row])
    return f"control point {names[control.point[row]]:g} at ({place}) m"


def _listed(control: ControlPoints, names: Array, rows: NDArray[np.intp], squared: Array) -> str:
    """The first of them, with the sigmas that they lie off."""
    some = [f"{names[control.point[r]]:g} by {np.sqrt(squared[r]):.3g} sigmas" for r in rows[:_NAMED]]
    return ", ".join(some) + (f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else "")


__all__ = ["AdjustedPlaces", "squared_misses", "weighed_control"]
