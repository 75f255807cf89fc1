"""Whether the lags of a strip have the right sign, where its bands match as well with the other one.

Images of bands that lie on one another already (crops, granules in sensor geometry) do not show by their
matches which band looked first: offsets of the bands take what the other sign would move them by, and three
bands fit by some motion either way. A fourth that has no part in the motion is placed well by it with the
right sign only.

Not here: bands that match on the other side, farther than the search (``motion/strip/alternatives.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import SightlineError, computes
from sightline.estimation.robust import robust_sigmas
from sightline.execution import Progress
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.imaging.part import ImageLines
from sightline.matching.match_images import match_images
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.measure.windows import window_grid
from sightline.motion.results import LineOfSight
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.lost_bands import pair_tells
from sightline.motion.strip.strip import RecoverOptions
from sightline.motion.strip.warnings import FAR_OFF

Array = NDArray[np.float64]

#: Windows (lines, columns) px of the band that is placed, lines from one row of them to the next, and how far
#: each is searched for.
WINDOW, STEP, SEARCH = (12, 64), 12, (6, 6)
OWN_LINES = np.arange(WINDOW[0]) - 0.5 * (WINDOW[0] - 1)
#: Parts of the strip over which windows are averaged: offset and slope are fitted to these; fewest windows of
#: one that counts, and fewest parts.
PARTS, FEWEST, FEWEST_PARTS = 8, 5, 5
#: Rounds in which windows of something else than ground, so many sigmas from the others, are left out.
ROUNDS, FALSE = 5, 3.0
#: px; how well offset and slope of a band are known beforehand: hardly.
FREE = 100.0
#: Pixels of an image that are looked at, at most, from its first line on: two more recoveries are dear.
MOST_PIXELS = 1_500_000
#: Difference of deviances by which lags of the other sign are a hundred times likelier: beforehand either may
#: be, as staggered detectors look in turn.
LIKELIER = 2.0 * math.log(100.0)


@dataclass(frozen=True, eq=False)
class Placed:
    """How a band lies, across, that had no part in the motion by which it is placed.

    Attributes
    ----------
    parts : (n,) int
        Parts of the strip, of PARTS, that hold enough windows.
    lines : (n,)
        Mean line of the windows of each.
    means : (n,)
        px; their mean offset, with offset, turn and scale of the band fitted.
    noise : (n,)
        px^2; variance of that by their scatter.
    motion : (n, n)
        px^2; its covariance by that of the motion.
    """

    parts: NDArray[np.intp]
    lines: Array
    means: Array
    noise: Array
    motion: Array

    @property
    def left_px(self) -> float:
        """rms of the means."""
        return float(np.sqrt((self.means**2).mean()))

    @property
    def noise_px(self) -> float:
        """What the scatter of windows lets expect of that."""
        return float(np.sqrt(self.noise.mean()))

    @property
    def stated_px(self) -> float:
        """What the sigma of the motion lets expect of it, a line fitted."""
        without = np.eye(len(self.lines)) - self._free @ np.linalg.pinv(self._free)
        return float(np.sqrt(np.trace(without @ self.motion @ without) / len(self.lines)))

    def less_likely(self, other: Placed) -> float:
        """By how much -2 log of the likelihood exceeds that of another; NaN where that is of other parts.

        The noise of each part is the smaller of both: what a false motion leaves within a part is none. Where
        both leave more than noise and motion explain, the band errs by itself, and tells the less.
        """
        if not np.array_equal(self.parts, other.parts):
            return math.nan
        noise = np.minimum(self.noise, other.noise)
        wholes = [one.motion + np.diag(noise) + FREE**2 * one._free @ one._free.T for one in (self, other)]
        squares = [
            float(one.means @ np.linalg.solve(whole, one.means))
            for one, whole in zip((self, other), wholes, strict=True)
        ]
        sizes = [float(np.linalg.slogdet(whole)[1]) for whole in wholes]
        beyond = max(min(squares) / (len(self.parts) - 2), 1.0)
        return (squares[0] - squares[1]) / beyond + sizes[0] - sizes[1]

    @property
    def _free(self) -> Array:
        """(n, 2); an offset and a slope along the strip."""
        rise = self.lines - self.lines.mean()
        return np.column_stack([np.ones(len(rise)), rise / np.ptp(rise)])


def placed_by(
    found: LineOfSight, bands: Sequence[Band], surface: Surface, hub: int, band: int
) -> Placed | None:
    """How well one of the `bands` is placed beside another, `hub`, by a motion in which it had no part.

    None where it matches in too few parts of the strip.
    """
    statics = {estimate.name: estimate.value for estimate in found.statics}
    cameras = recovered_cameras([bands[hub], bands[band]], found.motion, statics)
    images = bands[hub].image, bands[band].image
    points = window_grid(images[0].shape, WINDOW, STEP).centres
    there = _mean_match(cameras, surface, points)
    seen = np.isfinite(there).all(axis=1)
    points, there = points[seen], there[seen]
    if len(points) < PARTS * FEWEST:
        return None
    match = match_images(*images, points, there, window=WINDOW, search_px=SEARCH)
    if match.kept.sum() < PARTS * FEWEST:
        return None
    left, (line, column) = (match.b - there)[match.kept, 1], points[match.kept].T
    shape, good = np.column_stack([np.ones_like(line), line, column]), np.ones(len(left), dtype=bool)
    for _ in range(ROUNDS):
        left = left - shape @ np.linalg.lstsq(shape[good], left[good], rcond=None)[0]
        good = np.abs(left) < FALSE * robust_sigmas(left[good], axis=0)
    part = np.minimum(line * PARTS / images[0].shape[0], PARTS - 1).astype(int)
    rows = {k: np.flatnonzero(good & (part == k)) for k in range(PARTS)}
    rows = {k: row for k, row in rows.items() if len(row) >= FEWEST}
    if len(rows) < FEWEST_PARTS:
        return None
    motion = _covariance(
        found,
        [
            [camera.times((at[row, 0, None] + OWN_LINES).ravel()) for row in rows.values()]
            for camera, at in zip(cameras, (points[match.kept], there[match.kept]), strict=True)
        ],
    )
    return Placed(
        np.array(list(rows)),
        np.array([line[row].mean() for row in rows.values()]),
        np.array([left[row].mean() for row in rows.values()]),
        np.array([left[row].var() / len(row) for row in rows.values()]),
        motion,
    )


def _mean_match(cameras: Sequence[PushbroomCamera], surface: Surface, points: Array) -> Array:
    """Where windows of the first image lie in the second, in the mean of their lines, which jitter moves."""
    each = []
    for line in OWN_LINES:
        apart = np.array([line, 0.0])
        each.append(predict_match(cameras[0], cameras[1], surface, points + apart) - apart)
    return np.mean(each, axis=0)


def _covariance(found: LineOfSight, times: Sequence[Sequence[Array]]) -> Array:
    """Covariance (parts, parts) px^2 of roll at the second exposures less that at the first, in the mean."""
    t, count = found.motion.t, len(times[0])
    weights = np.zeros((len(t), 3, count))
    for each, sign in zip(times, (-1.0, 1.0), strict=True):
        for k, instants in enumerate(each):
            place = np.clip(np.interp(instants, t, np.arange(len(t))), 0.0, len(t) - 1.000001)
            first = place.astype(int)
            for node, share in ((first, 1.0 - (place - first)), (first + 1, place - first)):
                np.add.at(weights[:, 0, k], node, sign * share / len(instants))
    assert found.functional_covariance is not None
    return np.asarray(found.functional_covariance(weights) / found.ifov**2)


def with_reversed_lags(bands: Sequence[Band]) -> list[Band]:
    """Bands in the opposite order of time, each looking as far behind the middle of all as it looked ahead.

    Their lags have the other sign, within the time for which poses are known.
    """
    begin, ahead = [_middle_time(band) for band in bands], [_ahead(band) for band in bands]
    out = []
    for band, t, y in zip(bands, begin, ahead, strict=True):
        camera = band.camera
        later, further = min(begin) + max(begin) - 2.0 * t, min(ahead) + max(ahead) - 2.0 * y
        times = None if camera.line_times is None else camera.line_times + later
        turned = replace(
            camera,
            detector=camera.detector.adjusted(further / camera.detector.pixel_step),
            first_line_time=camera.first_line_time + later,
            line_times=times,
        )
        out.append(replace(band, camera=turned))
    return out


def _middle_time(band: Band) -> float:
    """s; exposure of the middle of its image."""
    return float(band.camera.times(np.array([0.5 * (band.camera.lines - 1)]))[0])


def _ahead(band: Band) -> float:
    """Tangent by which the middle of a row looks towards larger lines."""
    tangents = band.camera.detector.tangents
    return float(tangents[[(len(tangents) - 1) // 2, len(tangents) // 2], 1].mean())


def wrong_lag_sign(
    found: LineOfSight,
    bands: Sequence[Band],
    surface: Surface,
    *,
    height_sigma: float = 0.0,
    options: RecoverOptions | None = None,
    progress: Progress | None = None,
) -> str:
    """What to say where all lags seem to have the wrong sign; "" where they do not, or nothing tells.

    Parameters
    ----------
    found : LineOfSight
        Of all `bands`: which match how well.
    bands : sequence of Band
        Four at least, of pixels of one size and without TDI, which lie on one another as nearly as their
        offsets are known.
    surface : Surface
    height_sigma : float
        m
    options : RecoverOptions, optional
    progress : callable, optional
        Called with what is being done, where something is.

    Notes
    -----
    Of the four that match best the last is left out. The others are recovered as they are and with lags
    reversed, and it is placed by either motion. What is left across tells the two apart; its offset, turn and
    scale are free.
    """
    options = options or RecoverOptions()
    chosen = _chosen(found, bands, surface)
    if len(chosen) < 4:
        return ""
    some = [_begun(bands[k]) for k in chosen]
    if progress is not None:
        progress("looking whether lags of the other sign fit better")
    try:
        both = [_last_placed(one, surface, height_sigma, options) for one in (some, with_reversed_lags(some))]
    except SightlineError:  # it cannot be told
        return ""
    pairs = [(a, b) for a, b in zip(*both, strict=True) if a and b]
    if not pairs:
        return ""
    given, turned = min(pairs, key=lambda pair: max(pair[0].noise_px, pair[1].noise_px))
    if not (given.less_likely(turned) >= LIKELIER and turned.left_px < given.left_px):
        return ""
    expected = [math.hypot(one.noise_px, one.stated_px) for one in (given, turned)]
    return (
        f"all lags seem to have the wrong sign: {some[-1].name}, placed by the motion of "
        f"{', '.join(band.name for band in some[:-1])}, lies {given.left_px:.2g} px off across "
        f"({expected[0]:.2g} are to be expected), and {turned.left_px:.2g} px ({expected[1]:.2g}) with lags "
        "of the other sign: change the sign of every `look_ahead` and `first_line_time`, or give `init` the "
        "other --lag-sign"
    )


def _chosen(found: LineOfSight, bands: Sequence[Band], surface: Surface) -> list[int]:
    """Four bands, that which matches worst last; none where the other sign would put them far from there."""
    inexact = [k for k, band in enumerate(bands) if band.offset_sigma_px > 0.0]
    groups = [[k for k in inexact if _of_one_kind(bands[first], bands[k])] for first in inexact]
    alike = max(groups, key=len, default=[])
    if len(alike) < 4:
        return []
    first = bands[alike[0]]
    middle = np.array([[0.5 * (first.camera.lines - 1), 0.5 * (first.camera.columns - 1)]])
    for k in alike[1:]:
        moved = predict_match(first.camera, bands[k].camera, surface, middle)[0, 0] - middle[0, 0]
        if not 2.0 * abs(moved) < FAR_OFF * math.hypot(first.offset_sigma_px, bands[k].offset_sigma_px):
            return []
    compared, kept = np.zeros((2, len(bands)), dtype=int)
    for pair in found.pairs:
        for image in pair.images:
            compared[image] = max(compared[image], pair.tried)
            kept[image] = max(kept[image], pair.kept)
    tell = pair_tells(kept, compared) & (kept >= PARTS * FEWEST)
    # the last may be one that had no part in the motion anyway
    best = sorted((k for k in alike if tell[k] or not compared[k]), key=lambda k: -kept[k])[:4]
    if len(best) < 4 or not kept[best[2]]:
        return []
    # bands that looked at once are one
    if np.diff(np.sort([_middle_time(bands[k]) for k in best])).min() <= 0.0:
        return []
    return [*sorted(best[:3]), best[3]]


def _of_one_kind(first: Band, band: Band) -> bool:
    """Whether two bands are lines across the flight of one camera, of the same pixels, without TDI."""
    a, b = first.camera, band.camera
    if not (isinstance(a.pointing, FixedMount) and isinstance(b.pointing, FixedMount)):
        return False
    turned = a.pointing.body_from_camera.inv() * b.pointing.body_from_camera
    across = b.pointing.body_from_camera.apply([*b.detector.axis, 0.0])
    return bool(
        a.stages is None
        and b.stages is None
        and first.image.shape == band.image.shape
        and turned.magnitude() < 1e-9
        and abs(across[0]) < 0.1
        and abs(b.detector.axis[1]) < 0.1
        and abs(b.detector.pixel_step / a.detector.pixel_step - 1.0) < 0.01
        and abs(b.detector.line_period / a.detector.line_period - 1.0) < 0.01
    )


def _begun(band: Band) -> Band:
    """The first lines of a band."""
    camera = band.camera
    lines = min(camera.lines, max(MOST_PIXELS // camera.columns, 1))
    if lines == camera.lines:
        return band
    times = None if camera.line_times is None else camera.line_times[:lines]
    return replace(
        band,
        image=ImageLines(band.image, 0, lines),
        camera=replace(camera, lines=lines, line_times=times),
    )


@computes("whether lags of the other sign fit better")
def _last_placed(
    bands: Sequence[Band], surface: Surface, height_sigma: float, options: RecoverOptions
) -> list[Placed | None]:
    """The last of the bands, placed by the motion of the others beside each of these."""
    # pairs and features are named by bands of the whole strip
    plain = replace(options, pairs=(), withhold=(), method="joint", selection=Selection())
    found = recover_line_of_sight(bands[:-1], surface, height_sigma=height_sigma, options=plain)
    return [placed_by(found, bands, surface, hub, len(bands) - 1) for hub in range(len(bands) - 1)]
