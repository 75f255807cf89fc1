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
from sightline.errors import EstimationError, InputError, SpanError
from sightline.estimation.robust import robust_sigmas
from sightline.execution import Progress
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.imaging.part import ImageLines
from sightline.matching.match_images import match_images
from sightline.motion.band import Band
from sightline.motion.measure.windows import window_grid
from sightline.motion.results import LineOfSight
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.strip import RecoverOptions
from sightline.motion.strip.warnings import pair_tells

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
#: Lines that are looked at, at most: seconds of motion tell as much as the whole strip.
MOST_LINES = 1500
#: Difference of deviances by which lags of the other sign are a thousand times likelier.
LIKELIER = 2.0 * math.log(1000.0)


@dataclass(frozen=True)
class Placed:
    """How well a band lies, across, that had no part in a motion by which it is placed.

    Attributes
    ----------
    left_px : float
        rms of means over PARTS of the strip, with its offset, turn and scale fitted.
    noise_px, stated_px : float
        What the scatter of its windows, and the sigma of the motion, let expect of that.
    deviance : float
        -2 log of its likelihood.
    parts : int
        That count.
    """

    left_px: float
    noise_px: float
    stated_px: float
    deviance: float
    parts: int


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
    rows = [np.flatnonzero(good & (part == k)) for k in range(PARTS)]
    rows = [row for row in rows if len(row) >= FEWEST]
    if len(rows) < FEWEST_PARTS:
        return None
    means = np.array([left[row].mean() for row in rows])
    noise = np.array([left[row].var() / len(row) for row in rows])
    motion = _covariance(
        found,
        [
            [camera.times((at[row, 0, None] + OWN_LINES).ravel()) for row in rows]
            for camera, at in zip(cameras, (points[match.kept], there[match.kept]), strict=True)
        ],
    )
    lines = np.column_stack([np.ones(len(rows)), [line[row].mean() for row in rows]])
    lines[:, 1] = (lines[:, 1] - lines[:, 1].mean()) / np.ptp(lines[:, 1])
    whole = motion + np.diag(noise) + FREE**2 * lines @ lines.T
    _, size = np.linalg.slogdet(whole)
    without = np.eye(len(rows)) - lines @ np.linalg.pinv(lines)
    return Placed(
        float(np.sqrt((means**2).mean())),
        float(np.sqrt(noise.mean())),
        float(np.sqrt(np.trace(without @ motion @ without) / len(rows))),
        float(means @ np.linalg.solve(whole, means) + size),
        len(rows),
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
        Four at least, of pixels of one size and without TDI, which lie on one another but for less than twice
        the search.
    surface : Surface
    height_sigma : float
        m
    options : RecoverOptions, optional
    progress : callable, optional
        Called with what is being done, where something is.

    Notes
    -----
    The band that matches worst is left out. The others are recovered as they are and with lags reversed, and
    it is placed by either motion. Its deviance across tells the two apart; its offset, turn and scale are
    free.
    """
    options = options or RecoverOptions()
    chosen = _chosen(found, bands, surface, options)
    if len(chosen) < 4:
        return ""
    some = [_begun(bands[k]) for k in chosen]
    if progress is not None:
        progress("looking whether lags of the other sign fit better")
    try:
        both = [_last_placed(one, surface, height_sigma, options) for one in (some, with_reversed_lags(some))]
    except (EstimationError, SpanError, InputError):  # it cannot be told
        return ""
    alike = [(a, b) for a, b in zip(*both, strict=True) if a and b and a.parts == b.parts]
    if not alike:
        return ""
    given, turned = min(alike, key=lambda pair: max(pair[0].noise_px, pair[1].noise_px))
    if given.deviance - turned.deviance < LIKELIER:
        return ""
    expected = math.hypot(given.noise_px, given.stated_px), math.hypot(turned.noise_px, turned.stated_px)
    return (
        f"all lags seem to have the wrong sign: {some[-1].name}, placed by the motion of "
        f"{', '.join(band.name for band in some[:-1])}, lies {given.left_px:.2g} px off across "
        f"({expected[0]:.2g} are to be expected), and {turned.left_px:.2g} px ({expected[1]:.2g}) with lags "
        "of the other sign: change the sign of every `look_ahead` and of all lags (`init --lag-sign`)"
    )


def _chosen(
    found: LineOfSight, bands: Sequence[Band], surface: Surface, options: RecoverOptions
) -> list[int]:
    """Four bands, that which matches worst last; none where lags of either sign do not match alike."""
    first = bands[0]
    if len(bands) < 4 or not all(_of_one_kind(first, band) for band in bands):
        return []
    middle = np.array([[0.5 * (first.camera.lines - 1), 0.5 * (first.camera.columns - 1)]])
    there = [predict_match(first.camera, band.camera, surface, middle)[0, 0] for band in bands]
    if not (np.abs(np.array(there) - middle[0, 0]) < 2 * options.search_px[0]).all():
        return []
    compared, kept = np.zeros((2, len(bands)), dtype=int)
    for pair in found.pairs:
        for image in pair.images:
            compared[image] = max(compared[image], pair.tried)
            kept[image] = max(kept[image], pair.kept)
    lags = np.array([_middle_time(band) for band in bands])
    tell = np.flatnonzero(pair_tells(kept, compared) & (kept >= PARTS * FEWEST))
    best = sorted(tell.tolist(), key=lambda k: -kept[k])[:4]
    # bands that looked at once are one
    if len(best) < 4 or np.diff(np.sort(lags[best])).min() <= 0.0:
        return []
    return [*sorted(best[:3]), best[3]]


def _of_one_kind(first: Band, band: Band) -> bool:
    """Whether bands have pixels of one size, no TDI, one mount, images of one shape, and unknown places."""
    a, b = first.camera, band.camera
    if not (isinstance(a.pointing, FixedMount) and isinstance(b.pointing, FixedMount)):
        return False
    turned = a.pointing.body_from_camera.inv() * b.pointing.body_from_camera
    return bool(
        a.stages is None
        and b.stages is None
        and first.image.shape == band.image.shape
        and band.offset_sigma_px > 0.0
        and turned.magnitude() < 1e-9
        and abs(b.detector.axis[1]) < 0.1
        and abs(b.detector.pixel_step / a.detector.pixel_step - 1.0) < 0.01
    )


def _begun(band: Band) -> Band:
    """The first lines of a band."""
    camera = band.camera
    if camera.lines <= MOST_LINES:
        return band
    times = None if camera.line_times is None else camera.line_times[:MOST_LINES]
    return replace(
        band,
        image=ImageLines(band.image, 0, MOST_LINES),
        camera=replace(camera, lines=MOST_LINES, line_times=times),
    )


def _last_placed(
    bands: Sequence[Band], surface: Surface, height_sigma: float, options: RecoverOptions
) -> list[Placed | None]:
    """The last of the bands, placed by the motion of the others beside each of these."""
    plain = replace(options, pairs=(), withhold=(), method="joint")
    found = recover_line_of_sight(bands[:-1], surface, height_sigma=height_sigma, options=plain)
    return [placed_by(found, bands, surface, hub, len(bands) - 1) for hub in range(len(bands) - 1)]
