"""What a recovery could see, frequency by frequency: the smallest tone, passbands, blind frequencies.

From the matches that were really kept: their number, sigma, sensitivities, lags and window length.

Not here: what a lag sees in principle (``motion/observability.py``), errors against truth (``score.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.execution import slices
from sightline.geometry.camera import PushbroomCamera
from sightline.motion.measure.observations import Star, scale_residuals
from sightline.motion.observability import (
    Passbands,
    averaged_away,
    blind_frequencies,
    intervals_above,
    window_gain,
)
from sightline.motion.results import LineOfSight
from sightline.writing import let_go

Array = NDArray[np.float64]

#: A frequency is seen where a steady tone of this amplitude (px) would stand out by so many sigmas.
SEEN_TONE_PX = 0.1
SEEN_SIGMAS = 5.0
#: Windows of a star from which information is summed: by chance it is a hundredth off.
ENOUGH_WINDOWS = 16384
#: Of these, windows that are looked at at a time.
AT_ONCE = 2048


@dataclass(frozen=True, eq=False)
class MatchedDirections:
    """What the kept matches can see.

    Attributes
    ----------
    frequency : (F,)
        Hz.
    information : (F, 3, 3) complex
        rad^-2, about amplitudes of steady tones of roll, pitch and yaw through the whole strip; Hermitian.
    tone_sigma : (F, 3)
        rad; 1-sigma of each amplitude, whatever the other two are; infinite, or past all sizes, where blind.
    seen : (F, 3) bool
        Where a tone of 0.1 px (yaw: at the field's edge) would stand out by 5 sigma, from one period per
        strip on.
    passbands : three tuples of (low, high)
        Hz; the same as intervals, for roll, pitch, yaw.
    blind : dict
        (hub, partner) -> blind frequencies of that pair of images, Hz.
    """

    frequency: Array
    information: NDArray[np.complex128]
    tone_sigma: Array
    seen: NDArray[np.bool_]
    passbands: tuple[Passbands, Passbands, Passbands]
    blind: dict[tuple[int, int], Array]


def observed(result: LineOfSight, frequency: ArrayLike) -> MatchedDirections:
    """What the kept matches of a recovery can see at `frequency` (F,) Hz.

    Notes
    -----
    The matches of a hub's pairs see a motion at f through ``A = H + P exp(2 pi i f lag)``, H and P their
    sensitivities to the angles of the hub and of the partner, times what window and stages leave of it. They
    err together (the hub's error is in all of them), and as rows of windows err alike: with C the covariance
    that the estimate used, tones have the information ``A^H C^-1 A / 2``, summed over all windows. A turn
    about the line of sight moves what looks ahead across it, so axes hide each other. Control points, where
    they alone carry the motion, bring their information about the angles themselves, up to half the rate at
    which they stand.
    """
    f = np.asarray(frequency, dtype=np.float64)
    total = np.zeros((len(f), 3, 3), dtype=np.complex128)
    blind = {}
    for record in result.records:
        star = record.star
        lags, information = _information(star)
        let_go()
        known = np.isfinite(lags)
        phase = 2j * np.pi * f[:, None] * np.where(known, lags, 0.0)
        gain = np.stack([np.ones_like(phase), np.exp(phase)], axis=2)  # (F, K, 2): of the hub, of the partner
        if star.tdi_hub is not None:
            for k in np.flatnonzero(known):
                gain[:, k] *= _left_by_stages(star, int(k), f)
        seen = np.einsum("fku,kualvb,flv->fab", gain.conj(), information, gain, optimize=True)
        seen[f == 0.0] = 0.0  # a constant is hidden: unknown offsets of bands do all that it does
        total += 0.5 * window_gain(f, star.duration)[:, None, None] ** 2 * seen
        for k in np.flatnonzero(known & (lags != 0.0)):
            image, upper = star.images[k], float(f[-1])
            here = blind_frequencies(float(lags[k]), upper)
            if star.tdi_hub is not None:
                stages = _stage_times(result, star.hub), _stage_times(result, image)
                if all(stages):
                    here = np.unique(np.concatenate([here, averaged_away([*stages[0], *stages[1]], upper)]))
            blind[star.hub, image] = here
    if result.control is not None:
        # instants of the angles themselves: seen from 0 Hz to half their rate
        points = result.control.t[result.control.kept]
        nyquist = 0.5 * max(len(np.unique(points)) - 1, 0) / max(float(np.ptp(points)), 1e-12)
        total += 0.5 * np.where((f <= nyquist)[:, None, None], np.diag(result.control.information), 0.0)
    sigma = _amplitudes(total, result.scale)
    with np.errstate(divide="ignore"):
        margin = SEEN_TONE_PX * result.scale / (SEEN_SIGMAS * sigma)
    duration = float(result.motion.t[-1] - result.motion.t[0])
    margin[f * duration < 1.0] = 0.0  # less than one period: like a drift
    bands = [intervals_above(f, np.minimum(margin[:, axis], 2.0), 1.0) for axis in range(3)]
    return MatchedDirections(f, total, sigma, margin >= 1.0, (bands[0], bands[1], bands[2]), blind)


def _amplitudes(information: NDArray[np.complex128], scale: Array) -> Array:
    """(F, 3) rad: sigmas of amplitudes, from their information (F, 3, 3); infinite where nothing is told."""
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    least = np.finfo(np.float64).eps * values[:, -1:]  # smaller ones are of rounding
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.abs(vectors) ** 2 / np.maximum(values, least)[:, None, :]
    parts[np.isnan(parts)] = np.inf  # no information at all
    return np.asarray(np.sqrt(parts.sum(axis=2)) * scale)


def _stage_times(result: LineOfSight, image: int) -> tuple[float, ...]:
    """s that the stages of an image take; none without TDI."""
    camera = result.cameras[image]
    return camera.stage_times if isinstance(camera, PushbroomCamera) else ()


def _left_by_stages(star: Star, k: int, f: Array) -> Array:
    """(F, 2) what TDI leaves of a motion in the kept windows of a pair, of hub and partner, on average."""
    kept = star.present[:, k]
    times, counts = np.unique(
        np.round(np.stack([t[kept] for t in (star.averaging()[0], star.averaging()[1][:, k])], axis=1), 9),
        axis=0,
        return_counts=True,
    )
    left = np.sinc(f[:, None, None] * times)  # (F, kinds, 2)
    size = np.sqrt(np.average(left**2, axis=1, weights=counts))
    # beyond the first frequency that they average away, stages leave a motion upside down
    return np.asarray(np.copysign(size, np.average(left, axis=1, weights=counts)))


def _information(star: Star) -> tuple[Array, Array]:
    """Median lags (K,) s of the pairs, and what they tell of the angles together, (K, 2, 3, K, 2, 3) rad^-2.

    Of roll, pitch and yaw of the hub and of the partner, pair by pair: the sensitivities of all windows
    through the inverse covariance of their matches. A lag is NaN where a pair has no match. Of very many
    windows some stand for all: each set of pairs that saw a window has an inverse of its own.
    """
    present = star.present
    lags = np.array([
        float(np.median((t - star.t_hub)[kept])) if kept.any() else math.nan
        for t, kept in zip(star.t.T, present.T, strict=True)
    ])  # fmt: skip
    count, angles = len(lags), np.arange(6)
    total = np.zeros((count, 6, count, 6))
    windows = np.arange(len(present))
    if len(windows) > ENOUGH_WINDOWS:
        # drawn: even steps could meet the same column of each row
        windows = np.sort(np.random.default_rng(0).choice(windows, ENOUGH_WINDOWS, replace=False))
    here = present[windows]
    for kept in np.unique(here[here.any(axis=1)], axis=0):
        pairs = np.flatnonzero(kept)
        alike = windows[(here == kept).all(axis=1)]
        rows = np.empty((len(alike), 2 * len(pairs), 6))
        for some in slices(len(alike), AT_ONCE):
            at = np.ix_(alike[some], pairs)
            slope = np.concatenate([star.by_hub[at], star.by_partner[at]], axis=3, dtype=np.float64)
            weight, covariance = np.repeat(np.sqrt(star.weight[at]), 2, axis=1), star.covariance_px[at]
            for angle, one in enumerate(np.moveaxis(slope, 3, 0)):
                rows[some, :, angle] = scale_residuals(one, covariance) * weight
            let_go()
        both = np.repeat(2 * pairs, 2) + np.tile([0, 1], len(pairs))
        inverse = np.linalg.inv(star.correlation[np.ix_(both, both)])
        squares = np.tensordot(rows, rows, axes=(0, 0)) * inverse[:, None, :, None]
        each = squares.reshape(len(pairs), 2, 6, len(pairs), 2, 6).sum(axis=(1, 4))
        total[np.ix_(pairs, angles, pairs, angles)] += each
    total *= len(present) / max(len(windows), 1)
    return lags, total.reshape(count, 2, 3, count, 2, 3)
