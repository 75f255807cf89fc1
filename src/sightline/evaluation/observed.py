"""What a recovery could see, frequency by frequency: the smallest tone, passbands, blind frequencies.

From the matches that were really kept: their number, sigma, sensitivities, lags and window length.

Not here: what a lag sees in principle (``motion/observability.py``), errors against truth (``score.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.motion.measure.observations import Star
from sightline.motion.observability import (
    Passbands,
    averaged_away,
    blind_frequencies,
    intervals_above,
    power_transfer,
    window_gain,
)
from sightline.motion.results import LineOfSight

Array = NDArray[np.float64]

#: A frequency is seen where a steady tone of this amplitude (px) would stand out by so many sigmas.
SEEN_TONE_PX = 0.1
SEEN_SIGMAS = 5.0


@dataclass(frozen=True, eq=False)
class MatchedDirections:
    """What the kept matches can see.

    Attributes
    ----------
    frequency : (F,)
        Hz.
    tone_sigma : (F, 3)
        rad; 1-sigma of the amplitude of a steady tone through the whole strip; infinite where blind.
    seen : (F, 3) bool
        Where a tone of 0.1 px (yaw: at the field's edge) would stand out by 5 sigma, from one period per
        strip on.
    passbands : three tuples of (low, high)
        Hz; the same as intervals, for roll, pitch, yaw.
    blind : dict
        (hub, partner) -> blind frequencies of that pair of images, Hz.
    """

    frequency: Array
    tone_sigma: Array
    seen: NDArray[np.bool_]
    passbands: tuple[Passbands, Passbands, Passbands]
    blind: dict[tuple[int, int], Array]


def observed(result: LineOfSight, frequency: ArrayLike) -> MatchedDirections:
    """What the kept matches of a recovery can see at `frequency` (F,) Hz.

    Notes
    -----
    A pair that brings the information R per second (1/rad^2/s) about a difference of angles leaves the motion
    an error of one-sided density ``2 / (R |G|^2 W^2)``, G that of its lag and W of its window; densities of
    several pairs add as their inverses (the error of a shared image is counted as if it were not shared,
    which moves a band's edge by less than its own width). Over a time T the amplitude of a tone then has the
    variance ``2 / (T sum of R |G|^2 W^2)``. Control points, where they alone carry the motion, bring their
    information about the angles themselves, up to half the rate at which they stand.
    """
    f = np.asarray(frequency, dtype=np.float64)
    total = np.zeros((len(f), 3))
    blind = {}
    for record in result.records:
        star = record.star
        for k, image in enumerate(star.images):
            information, lag = _information(star, k)
            if not np.isfinite(lag) or lag == 0.0:
                continue
            shape = power_transfer(f, lag) * window_gain(f, star.duration) ** 2
            upper = float(f[-1])
            here = blind_frequencies(lag, upper)
            if star.tdi_hub is not None:
                shape *= _left_by_stages(star, k, f)
                stages = _stage_times(result, star.hub), _stage_times(result, image)
                if all(stages):
                    here = np.unique(np.concatenate([here, averaged_away([*stages[0], *stages[1]], upper)]))
            total += shape[:, None] * information
            blind[star.hub, image] = here
    if result.control is not None:
        # instants of the angles themselves: seen from 0 Hz to half their rate
        points = result.control.t[result.control.kept]
        nyquist = 0.5 * max(len(np.unique(points)) - 1, 0) / max(float(np.ptp(points)), 1e-12)
        total += (f <= nyquist)[:, None] * result.control.information
    with np.errstate(divide="ignore"):
        sigma = np.sqrt(2.0 / total)
        margin = SEEN_TONE_PX * result.scale / (SEEN_SIGMAS * sigma)
    duration = float(result.motion.t[-1] - result.motion.t[0])
    margin[f * duration < 1.0] = 0.0  # less than one period: like a drift
    bands = [intervals_above(f, np.minimum(margin[:, axis], 2.0), 1.0) for axis in range(3)]
    return MatchedDirections(f, sigma, margin >= 1.0, (bands[0], bands[1], bands[2]), blind)


def _stage_times(result: LineOfSight, image: int) -> tuple[float, ...]:
    """s that the stages of an image take; none without TDI."""
    camera = result.cameras[image]
    return camera.stage_times if isinstance(camera, PushbroomCamera) else ()


def _left_by_stages(star: Star, k: int, f: Array) -> Array:
    """(F,) share of the power of a motion that TDI leaves in the kept windows of a pair, on average."""
    kept = star.present[:, k]
    times, counts = np.unique(
        np.round(np.stack([t[kept] for t in (star.averaging()[0], star.averaging()[1][:, k])], axis=1), 9),
        axis=0,
        return_counts=True,
    )
    left = 0.5 * (np.sinc(f * times[:, :1]) ** 2 + np.sinc(f * times[:, 1:]) ** 2)
    return np.asarray((counts[:, None] * left).sum(axis=0) / counts.sum())


def _information(star: Star, k: int) -> tuple[Array, float]:
    """Of one pair: information (3,) about roll, pitch, yaw differences, 1/rad^2; median lag, s."""
    kept = star.present[:, k]
    if not kept.any():
        return np.zeros(3), float("nan")
    lag = float(np.median((star.t[:, k] - star.t_hub)[kept]))
    slope = star.by_partner[kept, k].astype(np.float64)
    weighted = np.linalg.solve(star.covariance_px[kept, k], slope)
    each = np.einsum("gia,gia->ga", slope, weighted)
    return np.asarray((each * star.weight[kept, k, None]).sum(axis=0)), lag
