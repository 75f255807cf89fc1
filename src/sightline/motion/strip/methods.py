"""S1's other estimators (claim 6) on a strip: the motion from its angular differences, by a named method.

Select, predict, match and the static parameters are those of the joint estimate; the methods differ in the
last step alone, from the differences of step b to the motion. None of them states an error that can be
relied on (filters lose motion, a polynomial has no jitter, errors shared between pairs are left out), so that
the sigma of the result is found otherwise: with d the departure of the method's motion from the joint
estimate, of covariance C, the mean square error of that motion, given the images, is ``d d' + C``.

Not here: the joint estimate itself (``motion/strip/estimate.py``), the estimators (``motion/estimators/``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import TabulatedPsd
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences, by_pair
from sightline.motion.estimators.inverse import inverse
from sightline.motion.estimators.kalman import epoch_step, kalman
from sightline.motion.estimators.polynomial import polynomial
from sightline.motion.estimators.wiener import wiener
from sightline.motion.results import LineOfSight, NamedMethod, TimeCovariance
from sightline.motion.strip.estimate import StripState
from sightline.motion.strip.hyper import angle_differences
from sightline.motion.strip.normal_equations import modelled
from sightline.motion.strip.strip import Strip
from sightline.motion.strip.viewing_axes import turned_directions

Array = NDArray[np.float64]

#: Filters need pairs that see the whole strip: those with less than this share of the differences of the
#: fullest pair are left out.
WHOLE = 0.5
#: Epochs of the longest lag that the Kalman filter's state holds at most: its time grows with their square.
MOST_EPOCHS = 450


def strip_differences(strip: Strip, state: StripState) -> list[AngleDifferences]:
    """S1's angular differences of every pair of a strip, about the axes of the estimate."""
    sigmas = (0.0, 0.0)
    if state.prior.relief is not None:
        # of the first row, of which nothing before it tells
        mean, slope = (math.sqrt(float(p.startup_variances[0])) for p in state.prior.relief)
        sigmas = mean, slope
    stars = [record.star for record in state.records]
    return by_pair(angle_differences(stars, state.with_relief_px, state.estimate, sigmas))


def check_method(method: str, strip: Strip) -> None:
    """Refuse a method that the strip's prior cannot serve, before any work."""
    spectra = strip.known.spectra or ()
    if method == "kalman" and any(isinstance(c, TabulatedPsd) for s in spectra for c in s.components):
        raise InputError(
            "the method kalman needs a motion of Matern parts and tones, and [known_motion] psd is a table: "
            "leave it out, or take another method: joint, inverse, wiener, polynomial"
        )


def by_method(strip: Strip, state: StripState, result: LineOfSight, method: str) -> LineOfSight:
    """The result with the motion of a named method in the place of the joint estimate.

    Parameters
    ----------
    strip : Strip
    state : StripState
        Of the joint estimate.
    result : LineOfSight
        The joint estimate as a result, with its differences.
    method : str
        ``"inverse"``, ``"wiener"``, ``"polynomial"`` or ``"kalman"``.

    Notes
    -----
    What the images cannot see (``hidden``) is as in the joint estimate; the rest of the departure is the
    method's. Of its square a mean over the longest lag is taken.
    """
    differences = [one.turned(strip.turn.T) for one in result.differences]
    if not differences:
        raise EstimationError(
            f"the method {method} needs rows of windows that show all three angles, and no pair has any: "
            "leave --method out"
        )
    grid, turn, t = strip.grid, strip.turn, result.motion.t
    instants = np.concatenate([np.concatenate([one.t, one.t + one.lag]) for one in differences])
    inside = np.flatnonzero((grid.nodes >= instants.min()) & (grid.nodes <= instants.max()))
    found = _estimated(method, differences, grid.nodes[inside], state)
    # before the first and after the last difference the departure stays what it was
    held = np.clip(np.arange(grid.count), inside[0], inside[-1]) - inside[0]
    departure = (found.angles - state.estimate.nodes[inside])[held]
    departure = _less_hidden(departure @ turn.T, strip, state, t)
    own = np.einsum("ij,njk,ik->ni", turn, _covariance(found), turn)[held]
    longest = max(abs(float(np.median(one.lag))) for one in differences)
    width = max(round(longest / grid.step), 1)
    outer = _local_mean(departure[:, :, None] * departure[:, None, :], width)
    lost = _linear(grid.nodes, outer, t)
    assert result.motion.covariance is not None  # of a strip both are there
    assert result.band is not None
    nodes = state.estimate.nodes + departure @ turn
    on_lines = grid.interpolate(departure, t)
    left = [
        post - modelled(record.star, grid, departure @ turn, np.zeros(record.star.by_static.shape[3]))
        for record, post in zip(state.records, state.post_px, strict=True)
    ]
    band = TimeCovariance(
        grid.nodes, result.band.angles + departure, _with_products(result.band.band, departure, width)
    )
    return replace(
        result,
        motion=Motion(t, result.motion.angles + on_lines, result.motion.covariance + lost),
        absolute_sigma=np.sqrt(result.absolute_sigma**2 + np.einsum("nii->ni", lost)),
        after_px=tuple(left),
        cameras=tuple(strip.body_cameras(nodes, state.estimate.statics)),
        band=band,
        functional_covariance=partial(_functional, result.functional_covariance, on_lines),
        method=NamedMethod(method, on_lines, np.sqrt(_linear(grid.nodes, own, t))),
    )


def _estimated(method: str, differences: Sequence[AngleDifferences], t: Array, state: StripState) -> Motion:
    """The motion at `t` (N,) s by a named method."""
    fullest = max(len(one) for one in differences)
    whole = [one for one in differences if len(one) >= WHOLE * fullest]
    if method == "inverse":
        return inverse(whole, t)
    if method == "wiener":
        return wiener(whole, t)
    if method == "polynomial":
        return polynomial(differences, t)
    scale = np.sqrt(np.array(state.model.noise_scale))
    grown = [replace(one, covariance=one.covariance * np.outer(scale, scale)) for one in differences]
    longest = max(float(np.abs(one.lag).max()) for one in differences)
    step = max(epoch_step(grown, state.model.spectra), longest / MOST_EPOCHS)
    return kalman(grown, t, prior=state.model.spectra, grid_step=step)


def _covariance(motion: Motion) -> Array:
    """(N, 3, 3) as the method states it."""
    return np.zeros((len(motion.t), 3, 3)) if motion.covariance is None else motion.covariance


def _less_hidden(departure: Array, strip: Strip, state: StripState, t: Array) -> Array:
    """A departure (count, 3) on the nodes, in body axes, less the part that the images cannot see."""
    grid, estimate = strip.grid, state.estimate
    directions = turned_directions(estimate.hidden_directions(estimate.hidden_drifts), strip.turn)
    shapes = grid.interpolate(directions, t) / strip.scale[:, None]
    values = grid.interpolate(departure, t) / strip.scale
    shapes = shapes.reshape(values.size, -1)
    size = np.linalg.norm(shapes, axis=0)
    amount = np.linalg.lstsq(shapes / size, values.ravel(), rcond=1e-9)[0] / size
    return np.asarray(departure - directions @ amount)


def _local_mean(values: Array, width: int) -> Array:
    """Mean over `width` neighbours along the first axis; fewer at the ends."""
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    at = np.arange(len(values))
    low, high = np.clip(at - width // 2, 0, None), np.clip(at + width // 2 + 1, None, len(values))
    count = (high - low).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((total[high] - total[low]) / count)


def _linear(nodes: Array, values: Array, t: Array) -> Array:
    """Values on the nodes at `t`, by straight lines: variances stay positive."""
    flat = values.reshape(len(values), -1)
    return np.stack([np.interp(t, nodes, column) for column in flat.T], axis=1).reshape(
        len(t), *values.shape[1:]
    )


def _with_products(band: Array, departure: Array, width: int) -> Array:
    """Banded covariance of node angles with the departure's own, a mean over `width` nodes."""
    flat, out = departure.ravel(), band.copy()
    for apart in range(len(band)):
        product = np.zeros(len(flat))
        product[: len(flat) - apart] = flat[: len(flat) - apart] * flat[apart:]
        out[apart] += _local_mean(product.reshape(-1, 3), width).ravel()
    return out


def _functional(joint: Callable[[Array], Array] | None, departure: Array, weights: Array) -> Array:
    """Mean square error (K, K) rad^2 of sums of the motion with `weights` (N, 3, K)."""
    assert joint is not None
    moved = np.einsum("nik,ni->k", weights, departure)
    return np.asarray(joint(weights) + np.outer(moved, moved))
