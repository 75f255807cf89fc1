"""What an estimate of a spinning camera says, in numbers: spin, rank, pairs of strips, departures.

Not here: the estimate (``solve.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.motion.spin.solve import EXACT, SPIN_NAMES, SpinEstimate

Array = NDArray[np.float64]

#: px; the mean over the windows of one exposure is spoken of where it is known to this.
FRAME_SIGMA = 0.1
#: Components of a direction that are named.
NAMED_SHARE = 0.2
#: Information (in units of the prior's) below which nothing at all is seen of a direction.
BLIND = 1e-6


@dataclass(frozen=True)
class StripResiduals:
    """What one pair of strips left over at one lag.

    Attributes
    ----------
    hub, partner : int
        Strips.
    lag : int
        Exposures.
    kept, tried : int
        Windows believed, and matched.
    mean_px, mean_sigma_px, rms_px, scale, nees : (line, column)
        Mean residual with its sigma, rms of single windows, the factor by which the matcher's sigma was
        rescaled, and mean square of the residuals in units of the sigma so rescaled.
    frame_means_px : (line, column)
        rms over the exposures of the mean over each exposure's windows, where that is known to 0.1 px; NaN
        where none is.
    frame_nees : (line, column)
        Mean square of the means of all exposures in units of their sigma.
    """

    hub: int
    partner: int
    lag: int
    kept: int
    tried: int
    mean_px: tuple[float, float]
    mean_sigma_px: tuple[float, float]
    rms_px: tuple[float, float]
    scale: tuple[float, float]
    nees: tuple[float, float]
    frame_means_px: tuple[float, float]
    frame_nees: tuple[float, float]


@dataclass(frozen=True)
class StripClosure:
    """Mean residual of two pairs of strips one after the other less that of the direct pair.

    Attributes
    ----------
    strips : (int, int, int)
        First, by way of the second, to the third.
    lags : (int, int)
        Exposures from first to second and from second to third.
    value_px, sigma_px : (line, column)
    """

    strips: tuple[int, int, int]
    lags: tuple[int, int]
    value_px: tuple[float, float]
    sigma_px: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Rank:
    """How many of the constants are observable, and which combination is least so.

    Attributes
    ----------
    names : tuple of str
        The constants that are not known exactly.
    information : (C,)
        Of the images, in units of what was known before (1: as much), weakest first.
    directions : (C, C)
        Its directions, columns, in units of the prior sigmas.
    """

    names: tuple[str, ...]
    information: Array
    directions: Array

    @property
    def rank(self) -> int:
        """Directions of which the images say more than was known."""
        return int((self.information > 1.0).sum())

    @property
    def blind(self) -> int:
        """Directions of which they say nothing."""
        return int((self.information < BLIND).sum())

    @property
    def weakest(self) -> str:
        """The observable direction that is estimated worst, in words."""
        k = min(self.blind, len(self.names) - 1)
        direction = self.directions[:, k]
        order = np.argsort(-np.abs(direction))
        first = direction[order[0]]
        parts = [
            f"{direction[i] / first:+.2f} {self.names[i]}" for i in order if abs(direction[i]) > NAMED_SHARE
        ]
        return f"{' '.join(parts)} (known {np.sqrt(1.0 + self.information[k]):.2f} times better than before)"


@dataclass(frozen=True, eq=False)
class SpinFindings:
    """Spin and what is behind it.

    Attributes
    ----------
    rate, rate_nominal : float
        rad/s.
    rate_sigma_images, rate_sigma_camera, rate_sigma_parallax : float
        rad/s: with lens and chip (and parallax) held, what not knowing lens and chip adds, and what not
        knowing the parallax adds. Their squares add up to the whole.
    rate_times_focal, rate_times_focal_sigma : float
        px/s; what the images give themselves.
    interval : float
        s between exposures, median.
    axis : (3,)
        Body axes.
    axis_sigma : (2,)
        rad; each way across.
    rank : Rank
    strips : tuple of StripResiduals
    closures : tuple of StripClosure
    departure_rms, departure_sigma, departure_size, departure_limit : (3,)
        rad: rms of the departures found, rms of their sigmas, the size that was taken for them, and the size
        that 95 % of what is likely stays below.
    """

    rate: float
    rate_nominal: float
    rate_sigma_images: float
    rate_sigma_camera: float
    rate_sigma_parallax: float
    rate_times_focal: float
    rate_times_focal_sigma: float
    interval: float
    axis: Array
    axis_sigma: Array
    rank: Rank
    strips: tuple[StripResiduals, ...]
    closures: tuple[StripClosure, ...]
    departure_rms: Array
    departure_sigma: Array
    departure_size: Array
    departure_limit: Array


def findings(estimate: SpinEstimate) -> SpinFindings:
    """All numbers of an estimate."""
    unknowns = estimate.unknowns
    spin = unknowns.spin.adjusted(estimate.x[: len(SPIN_NAMES)])
    images, camera, parallax = rate_sigmas(estimate)
    focal = estimate.cameras[0].detector.focal_length_px
    product = np.zeros(len(estimate.x))
    product[0] = focal
    names = unknowns.names
    if "focal length" in names:
        product[names.index("focal length")] = spin.rate
    strips = strip_residuals(estimate)
    departures, sigmas = estimate.departures, estimate.departure_sigmas
    return SpinFindings(
        spin.rate,
        unknowns.spin.rate,
        images,
        camera,
        parallax,
        spin.rate * focal,
        float(np.sqrt(product @ estimate.covariance @ product)),
        float(np.median(np.diff(unknowns.t))),
        spin.axis,
        np.sqrt(np.diag(estimate.covariance)[1:3]),
        rank_of(estimate),
        strips,
        closures(strips),
        np.sqrt((departures**2).mean(axis=0)),
        np.sqrt((sigmas**2).mean(axis=0)),
        unknowns.departure_sigma,
        estimate.departure_limit,
    )


def rate_sigmas(estimate: SpinEstimate) -> tuple[float, float, float]:
    """Sigma of the rate (rad/s): images alone, what lens and chip add, what parallax adds."""
    names = list(estimate.unknowns.names)
    first = len(SPIN_NAMES)
    camera = list(range(first, first + len(estimate.unknowns.statics)))
    parallax = [k for k in camera if names[k].startswith("parallax")]
    camera = [k for k in camera if k not in parallax]
    whole = float(estimate.covariance[0, 0])
    held = _held(estimate.covariance, parallax)
    alone = _held(estimate.covariance, camera + parallax)
    return float(np.sqrt(alone)), float(np.sqrt(max(held - alone, 0.0))), float(
        np.sqrt(max(whole - held, 0.0))
    )  # fmt: skip


def _held(covariance: Array, fixed: Sequence[int]) -> float:
    """Variance of the first unknown when some others are held."""
    if not fixed:
        return float(covariance[0, 0])
    block, across = covariance[np.ix_(fixed, fixed)], covariance[0, fixed]
    scale = np.sqrt(np.diag(block))
    solved = np.linalg.solve(block / np.outer(scale, scale), across / scale)
    return float(covariance[0, 0] - (across / scale) @ solved)


def at_camera(estimate: SpinEstimate, constants: Array) -> tuple[float, float]:
    """Rate and its sigma (rad/s) if lens and chip were as given.

    Parameters
    ----------
    estimate : SpinEstimate
    constants : (Q,)
        Of lens and chip, departures from nominal, in the order of the statics.
    """
    first = len(SPIN_NAMES)
    rows = list(range(first, first + len(constants)))
    covariance = estimate.covariance
    block, across = covariance[np.ix_(rows, rows)], covariance[0, rows]
    scale = np.sqrt(np.diag(block))
    gain = np.linalg.solve(block / np.outer(scale, scale), across / scale) / scale
    value = estimate.x[0] + gain @ (constants - estimate.x[rows])
    return float(estimate.unknowns.spin.rate + value), float(np.sqrt(covariance[0, 0] - across @ gain))


def rank_of(estimate: SpinEstimate) -> Rank:
    """Information of the images on the constants, departures taken out."""
    unknowns = estimate.unknowns
    first = unknowns.constants
    sigma, root = unknowns.prior_sigma, unknowns.prior_root
    scaled = root @ estimate.information @ root
    own, cross = scaled[first:, first:] + np.eye(len(sigma) - first), scaled[:first, first:]
    left = scaled[:first, :first] - cross @ np.linalg.solve(own, cross.T)
    free = np.flatnonzero(sigma[:first] > EXACT)
    values, vectors = np.linalg.eigh(left[np.ix_(free, free)])
    names = tuple(unknowns.names[k] for k in free)
    return Rank(names, np.maximum(values, 0.0), vectors)


def strip_residuals(estimate: SpinEstimate) -> tuple[StripResiduals, ...]:
    """What every pair of strips left over."""
    rows = estimate.rows
    left = rows.residual
    sigma = np.sqrt(np.einsum("mii->mi", estimate.noise.covariance(rows)))
    out = []
    for number, pair in enumerate(estimate.pairs):
        of = rows.pair == number
        good = of & estimate.kept
        if not good.any():
            continue
        weight = rows.own[good, None] / sigma[good] ** 2
        mean = (weight * left[good]).sum(axis=0) / weight.sum(axis=0)
        out.append(
            StripResiduals(
                pair.hub,
                pair.partner,
                pair.lag,
                int(good.sum()),
                int(of.sum()),
                _two(mean),
                _two(1.0 / np.sqrt(weight.sum(axis=0))),
                _two(np.sqrt((left[good] ** 2).mean(axis=0))),
                _two(estimate.noise.scale[number]),
                _two(((left[good] / sigma[good]) ** 2).mean(axis=0)),
                *_frame_means(left[good], rows.star[good], rows.own[good], sigma[good]),
            )
        )
    return tuple(out)


def _frame_means(
    left: Array, star: NDArray[np.intp], own: Array, sigma: Array
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Means over single stars (one exposure and pair each): rms (px), and mean square in their sigma."""
    means, sigmas = [], []
    for k in np.unique(star):
        of = star == k
        weight = own[of, None] / sigma[of] ** 2
        means.append((weight * left[of]).sum(axis=0) / weight.sum(axis=0))
        sigmas.append(1.0 / np.sqrt(weight.sum(axis=0)))
    mean, error = np.array(means), np.array(sigmas)
    rms = []
    for axis in range(2):
        known = mean[error[:, axis] <= FRAME_SIGMA, axis]
        rms.append(float(np.sqrt((known**2).mean())) if len(known) else float("nan"))
    return (rms[0], rms[1]), _two(((mean / error) ** 2).mean(axis=0))


def closures(strips: Sequence[StripResiduals]) -> tuple[StripClosure, ...]:
    """Every way from one strip to a second by a third, against the direct one."""
    table = {(s.hub, s.partner, s.lag): s for s in strips}
    out = []
    for (a, b, first), one in table.items():
        for (c, d, second), two in table.items():
            direct = table.get((a, d, first + second))
            if b != c or direct is None or len({a, b, d}) < 3:
                continue
            value = np.array(one.mean_px) + two.mean_px - np.array(direct.mean_px)
            variance = sum(np.array(part.mean_sigma_px) ** 2 for part in (one, two, direct))
            out.append(StripClosure((a, b, d), (first, second), _two(value), _two(np.sqrt(variance))))
    return tuple(out)


def _two(values: Array) -> tuple[float, float]:
    """Line and column."""
    return float(values[0]), float(values[1])
