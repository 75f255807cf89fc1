"""Pairs of bands that the estimate did not use: predicted from it, compared with their own matches.

A referee without truth. Windows of one band are found in the other, in the cameras that the estimate
left; where they lie is predicted by the motion, the statics, the relief and the errors that wander found, and
the covariance of what is left is that of the prediction and that of the match, less what they share. Nothing
of it reaches the estimate.

Not here: the estimate (``estimate.py``, ``joint.py``), the words (``report/``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from sightline.errors import InputError
from sightline.estimation.robust import robust_sigmas
from sightline.matching.match_images import match_images
from sightline.matching.whitening import Whitening
from sightline.motion.measure.common_view import Views, common_views, usable
from sightline.motion.measure.laid_strips import groups_of_pixels, laid_on, ratio_to_finest
from sightline.motion.measure.match_noise import robust_weights, single_errors
from sightline.motion.measure.observations import Star
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.stars import StarRecord, learned_filters, match_star
from sightline.motion.measure.windows import WindowGrid, exposure_times, near_instants
from sightline.motion.strip.estimate import StripState
from sightline.motion.strip.normal_equations import GroundOrder, modelled, window_rows
from sightline.motion.strip.relief import hub_delay
from sightline.motion.strip.slow_errors import SlowErrors
from sightline.motion.strip.strip import RecoverOptions, Strip

Array = NDArray[np.float64]

#: Windows of a pair that is left out on demand, and of one that a run looks at by itself.
ASKED_WINDOWS, SAMPLE_WINDOWS = 600, 240
#: Pairs that a run looks at by itself: of many bands neighbours come first.
SAMPLE_PAIRS = 3
#: Rows of these at least.
LEAST_ROWS = 8
#: Fewer matched windows judge nothing.
LEAST_WINDOWS = 10
#: Rows of windows over which errors of neighbours are looked at for what they share.
REACH = 12
#: What is left of a match's variance at least where its error and that of its prediction are shared.
LEAST_LEFT = 0.5
#: Two-sided 95 % point of the normal distribution.
Z95 = NormalDist().inv_cdf(0.975)
AXES = ("along", "across")
#: NEES of a left-out pair from which on it is warned of, where that has less than this chance.
CONTRADICTED, CONTRADICTION_CHANCE = 2.0, 1e-4


@dataclass(frozen=True)
class WithheldAxis:
    """How one axis of a left-out pair's matches agrees with what the estimate predicts of it.

    Attributes
    ----------
    pair : (str, str)
        Names of the two bands.
    axis : str
        ``"along"`` or ``"across"``.
    count : int
        Windows compared; none overlaps another.
    samples : float
        Independent ones that they are worth: neighbours share texture and the error of the motion.
    nees : float
        Mean of (measured less predicted, over its sigma)^2: 1 where the sigmas are true.
    coverage : float
        Share within 1.96 sigma: 0.95 where they are true.
    rms_px : float
        Of measured less predicted.
    sigma_px : float
        rms of its sigma, of the prediction and of the matches, less what they share.
    prediction_sigma_px : float
        rms of the former alone.
    asked : bool
        Whether it was left out on demand; else it is one that the estimate does without.
    """

    pair: tuple[str, str]
    axis: str
    count: int
    samples: float
    nees: float
    coverage: float
    rms_px: float
    sigma_px: float
    prediction_sigma_px: float
    asked: bool


def contradictions(
    withheld: Sequence[WithheldAxis], *, tdi: bool = False, sensors: bool = False
) -> tuple[str, ...]:
    """Warnings of left-out pairs that show far more than the sigma of their prediction owns.

    `tdi`: whether bands have TDI stages; `sensors`: whether attitude sensors took part.
    """
    said = []
    stages = "motion so large within the TDI stages that it blurs as much as it shifts, " if tdi else ""
    if sensors:
        stages += "vibration of the camera that attitude sensors on the body do not feel, "
    for one in withheld:
        chance = float(chdtrc(one.samples, one.nees * one.samples))
        if one.nees >= CONTRADICTED and chance < CONTRADICTION_CHANCE:
            said.append(
                f"{'–'.join(one.pair)}, which the estimate did not use, contradicts it {one.axis} the lines: "
                f"NEES {one.nees:.2g} where 1 is right, so sigmas, of the motion or of its matches, are some "
                f"{one.nees**0.5:.2g} times too small; look for {stages}clouds, relief that is not "
                "given ([surface] height_sigma), or a wrong lag or line time"
            )
    return tuple(said)


def unjudged(asked: Sequence[tuple[str, str]], withheld: Sequence[WithheldAxis]) -> tuple[str, ...]:
    """Warnings of pairs (names of bands) that were asked for and judge nothing."""
    judging = {frozenset(one.pair) for one in withheld}
    return tuple(
        f"--withhold {a} {b}: fewer than {LEAST_WINDOWS} windows of these bands match where the motion puts "
        "them, so they judge nothing; leave out a pair whose images are more alike"
        for a, b in asked
        if frozenset((a, b)) not in judging
    )


def withheld_numbers(strip: Strip, pairs: Sequence[tuple[str, str]]) -> list[tuple[int, int]]:
    """The pairs that are to be left out, as numbers of bands; InputError where one cannot be."""
    names = [band.name for band in strip.bands]
    out = []
    for a, b in pairs:
        for name in (a, b):
            if name not in names:
                raise InputError(
                    f"--withhold {a} {b}: there is no band {name!r}; bands are: {', '.join(names)}"
                )
        if a == b:
            raise InputError(f"--withhold {a} {b}: a pair is of two bands; name another beside {a!r}")
        if len(names) < 3:
            raise InputError(
                f"--withhold {a} {b}: two bands are one pair, and without it nothing is left to estimate "
                "from; three bands or more are needed"
            )
        out.append((names.index(a), names.index(b)))
    return out


def without_pairs(strip: Strip, pairs: Sequence[tuple[int, int]]) -> Views:
    """What of the strip's views remains without these pairs; InputError where that parts the bands."""
    names = [band.name for band in strip.bands]
    gone = {frozenset(pair) for pair in pairs}
    left = {key: view for key, view in strip.views.items() if frozenset(key) not in gone}
    before, after = (_groups(len(names), views) for views in (strip.views, left))
    for a, b in pairs:
        if before[a] == before[b] and after[a] != after[b]:
            alone = [name for k, name in enumerate(names) if after[k] == after[b]]
            others = [name for k, name in enumerate(names) if after[k] == after[a]]
            raise InputError(
                f"--withhold {names[a]} {names[b]}: that pair is the only link between {', '.join(others)} "
                f"and {', '.join(alone)}, so nothing would predict it; leave out a pair whose bands are both "
                "matched with a third"
            )
        if not _view(strip, a, b):
            raise InputError(
                f"--withhold {names[a]} {names[b]}: these bands see no columns of ground in common, so there "
                "is nothing to compare; name another pair"
            )
    return left


def _groups(count: int, views: Views) -> list[int]:
    """For each band the first band that it is linked to, over any number of pairs."""
    group = list(range(count))
    for a, b in views:
        low, high = sorted((group[a], group[b]))
        group = [low if g == high else g for g in group]
    return group


def _view(strip: Strip, a: int, b: int) -> Views:
    """Columns that two bands have in common, whether or not they are matched."""
    cameras = [strip.nominal[a], strip.nominal[b]]
    return common_views(cameras, strip.surface)


def unused_pairs(strip: Strip, records: Sequence[StarRecord]) -> list[tuple[int, int]]:
    """Pairs of bands that were both matched with windows of a third; neighbours first.

    Not necessarily with the same windows: unlike pixels of a third band's partners part its ground.
    """
    count = len(strip.bands)
    by_hub = np.zeros((count, count), dtype=int)
    for record in records:
        by_hub[record.star.hub, list(record.star.images)] += record.star.present.sum(axis=0)
    through = np.minimum(by_hub[:, :, None], by_hub[:, None, :]).max(axis=0)
    pairs = [(a, a + apart) for apart in range(1, count) for a in range(count - apart)]
    checkable = (pair for pair in pairs if through[pair] >= LEAST_WINDOWS and _view(strip, *pair))
    return list(islice(checkable, SAMPLE_PAIRS))


def judged(strip: Strip, state: StripState, options: RecoverOptions) -> tuple[WithheldAxis, ...]:
    """Left-out pairs against the estimate: those asked for, else a sample of those it does without."""
    asked = strip.withheld
    pairs = list(asked) or unused_pairs(strip, state.records)
    most = ASKED_WINDOWS if asked else SAMPLE_WINDOWS
    cameras = strip.cameras(state.estimate.nodes, state.estimate.statics)
    out: list[WithheldAxis] = []
    for a, b in pairs:
        found = compared(strip, state, options, (a, b), most, cameras)
        if found is not None:
            out += _axes(found, (strip.bands[a].name, strip.bands[b].name), asked=bool(asked))
    return tuple(out)


def _axes(found: Compared, names: tuple[str, str], *, asked: bool) -> list[WithheldAxis]:
    """Both axes of one pair."""
    seen = found.star.present[:, 0]
    out = []
    for k, axis in enumerate(AXES):
        z = found.error_px[:, k] / found.sigma_px[:, k]
        out.append(
            WithheldAxis(
                names,
                axis,
                int(seen.sum()),
                _worth(np.where(seen, z, np.nan).reshape(found.star.shape)),
                float(np.mean(z[seen] ** 2)),
                float(np.mean(np.abs(z[seen]) <= Z95)),
                float(np.sqrt(np.mean(found.error_px[seen, k] ** 2))),
                float(np.sqrt(np.mean(found.sigma_px[seen, k] ** 2))),
                float(np.sqrt(np.mean(found.prediction_px[seen, k] ** 2))),
                asked,
            )
        )
    return out


@dataclass(frozen=True, eq=False)
class Compared:
    """Windows of a left-out pair.

    Attributes
    ----------
    star : Star
        Matches of the one pair, weighed by their own scatter.
    error_px : (G, 2)
        Measured less predicted.
    sigma_px, prediction_px : (G, 2)
        Of that, and of the prediction alone.
    """

    star: Star
    error_px: Array
    sigma_px: Array
    prediction_px: Array


def compared(
    strip: Strip,
    state: StripState,
    options: RecoverOptions,
    pair: tuple[int, int],
    most: int,
    cameras: Sequence[MovingCamera],
) -> Compared | None:
    """At most so many windows of `pair` matched and predicted; None where too few of them match.

    `cameras` carry the motion and the statics of the state.
    """
    grains = groups_of_pixels(strip.nominal)
    hub, partner = sorted(pair, key=lambda image: grains[image])  # the coarser one is the matching grid
    view = _view(strip, hub, partner)
    record = _matched(strip, state, options, (hub, partner), view[0, 1], most, cameras)
    if record is None:
        return None
    star, estimate = record.star, state.estimate
    # cameras carry motion and statics: the rows know more than these
    error = star.residual_px - _beside_cameras(strip, state, star)
    star = star.with_weight(robust_weights(star, error))
    seen = star.present[:, 0]
    if seen.sum() < LEAST_WINDOWS:
        return None
    block = 3 if estimate.relief is None else 5
    which, order = np.flatnonzero(seen), _ground(strip, state, hub)
    rows, beside = window_rows(star, strip.grid, block, order, which, _wandering(state, star))
    variance = np.full((len(seen), 2), np.nan)
    variance[seen] = estimate.row_variance(rows, beside).reshape(-1, 2)
    (single,) = single_errors([star], [error])
    own = replace(star, single=single).error_variance(slice(None))[:, 0]
    own = own / np.where(seen, star.weight[:, 0], np.nan)[:, None]
    shared = _shared(strip, state, star, record.filters[0], cameras)
    whole = np.maximum(own + (1.0 - 2.0 * shared) * variance, LEAST_LEFT * own)
    return Compared(star, error[:, 0], np.sqrt(whole), np.sqrt(variance))


def _shared(
    strip: Strip, state: StripState, star: Star, whitening: Whitening | None, cameras: Sequence[MovingCamera]
) -> Array:
    """Covariance (G, 2) of each match's error with that of its prediction, in units of the latter's variance.

    Notes
    -----
    Errors are taken for those of the images (theory, 6.2): e_b - e_a. Where the estimate used windows of one
    hub found in both bands, the part of the prediction that stems from the window's own ground errs as the
    match does, but for what the pair alone gets wrong, which is looked for. Where it used either band against
    others, half of the errors of those matches are shared, with either's share of the prediction: 1/4 each.
    """
    records, reach = state.records, 0.5 * star.duration + 2.0 * strip.grid.step
    pair = (star.hub, star.images[0])
    together = near_instants(_used_exposures(records, pair), star.t_hub, reach)
    apart = np.zeros(len(star.t_hub))
    for image, t in zip(pair, (star.t_hub, star.t[:, 0]), strict=True):
        seen = [_exposures(r.star)[image] for r in records if image in (r.star.hub, *r.star.images)]
        if seen:
            apart += near_instants(np.concatenate(seen), t, reach)
    alike = _alike(strip, state, pair, whitening, cameras) if together.any() else np.ones(2)
    return np.where(together[:, None], alike, 0.25 * apart[:, None])


def _alike(
    strip: Strip,
    state: StripState,
    pair: tuple[int, int],
    whitening: Whitening | None,
    cameras: Sequence[MovingCamera],
) -> Array:
    """Share (2,) of the variance of a pair's matches that those of both bands with a third err by too.

    The pair is matched on windows of the hub that was found in both, each laid on it, so that three matches
    are of the same ground.
    """
    a, b = pair
    through = [k for k, r in enumerate(state.records) if {a, b} <= set(r.star.images)]
    if not through:
        return np.ones(2)
    best = max(through, key=lambda k: int(state.records[k].star.present.sum()))
    used, post = state.records[best].star, state.post_px[best]
    ja, jb = used.images.index(a), used.images.index(b)
    which = _whole_rows(used.present[:, ja] & used.present[:, jb], used.shape)
    if used.window is None or len(which) < LEAST_WINDOWS:
        return np.ones(2)
    images = [band.image for band in strip.bands]
    first, second = (laid_on(images, cameras, strip.surface, used.hub, image) for image in pair)
    points = used.pixels[which]
    found = match_images(first, second, points, points, window=used.window, whitening=whitening)
    if found.kept.sum() < LEAST_WINDOWS:
        return np.ones(2)
    moved = _beside_cameras(strip, state, used)[which]
    direct = found.b - points - (moved[:, jb] - moved[:, ja])
    apart = post[which, jb] - post[which, ja]
    size = 5.0 * robust_sigmas(direct[found.kept], axis=0)
    good = found.kept & (np.abs(direct) < size).all(axis=1)
    if good.sum() < LEAST_WINDOWS:
        return np.ones(2)
    direct, apart = (part[good] - part[good].mean(axis=0) for part in (direct, apart))
    return np.clip((direct * apart).mean(axis=0) / (direct**2).mean(axis=0), 0.0, 1.0)


def _whole_rows(seen: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.intp]:
    """About SAMPLE_WINDOWS of the windows `seen` (G,), whole rows of them: what lies between is not read."""
    rows = np.flatnonzero(seen.reshape(shape).any(axis=1))
    count = min(len(rows), max(SAMPLE_WINDOWS * len(rows) // max(int(seen.sum()), 1), LEAST_ROWS))
    chosen = np.zeros(shape, dtype=bool)
    chosen[rows[np.linspace(0, len(rows) - 1, count).round().astype(int)]] = True
    return np.flatnonzero(seen & chosen.ravel())


def _beside_cameras(strip: Strip, state: StripState, star: Star) -> Array:
    """What the relief and the errors that wander found move the windows of a star by, (G, K, 2) px."""
    moved, order = np.zeros(star.residual_px.shape), _ground(strip, state, star.hub)
    slow = _wandering(state, star)
    if slow is not None:
        moved += slow.moved(star, order.of(star.t_hub), state.estimate.slow)
    if state.estimate.relief is not None:
        nodes = state.estimate.unknowns()
        nodes[:, :3] = 0.0
        moved += modelled(star, strip.grid, nodes, np.zeros(len(state.estimate.statics)), order)
    return moved


def _wandering(state: StripState, star: Star) -> SlowErrors | None:
    """Errors that wander of a star's images; None where the estimate has none of one of them."""
    slow = state.slow
    return slow if slow is not None and slow.covers([star]) else None


def _ground(strip: Strip, state: StripState, hub: int) -> GroundOrder:
    """How the ground that a hub sees lies on the grid."""
    return state.ground.later(hub_delay(strip.nominal, strip.surface, hub, state.records[0].star.hub))


def _used_exposures(records: Sequence[StarRecord], pair: tuple[int, int], *, directly: bool = False) -> Array:
    """s; when the first band of a pair saw the windows that the estimate used in both, of whichever hub.

    `directly`: only where one of the two was the hub.
    """
    used = [np.zeros(0)]
    for record in records:
        times = _exposures(record.star)
        if set(pair) <= set(times) and (record.star.hub in pair or not directly):
            used.append(np.where(np.isfinite(times[pair[1]]), times[pair[0]], np.nan))
    return np.concatenate(used)


def _exposures(star: Star) -> dict[int, Array]:
    """By image, when each window of a star was exposed there (G,) s; NaN where it took no part."""
    out = {star.hub: np.where(star.present.any(axis=1), star.t_hub, np.nan)}
    for k, image in enumerate(star.images):
        out[image] = np.where(star.present[:, k], star.t[:, k], np.nan)
    return out


def _matched(
    strip: Strip,
    state: StripState,
    options: RecoverOptions,
    pair: tuple[int, int],
    view: tuple[int, int],
    most: int,
    cameras: Sequence[MovingCamera],
) -> StarRecord | None:
    """The pair's windows in the recovered cameras: whole rows, evenly spread, none overlapping another.

    None where the estimate used the pair itself everywhere.
    """
    hub, partner = pair
    plan = strip.plan(options, options.window, options.step).coarser(ratio_to_finest(strip.nominal, hub))
    images = [band.image for band in strip.bands]
    shape = images[hub].shape
    whole = plan.grid(shape, usable(view, shape[1]))
    apart = max(-(-whole.window[0] // plan.step), 1)
    lines = whole.lines[::apart]
    camera = strip.nominal[hub]
    used = _used_exposures(state.records, pair, directly=True)
    middles = np.column_stack([lines, np.full(len(lines), 0.5 * (view[0] + view[1]))])
    reach = whole.window[0] * camera.detector.line_period
    lines = lines[~near_instants(used, exposure_times(camera, middles), reach)]
    if not len(lines):
        return None
    # a row apart from the next tells more than a neighbour in it: rows are thinned last
    blocks = max(min(len(whole.columns), most // max(min(len(lines), most // 4), 1)), 1)
    columns = whole.columns[np.unique(np.linspace(0, len(whole.columns) - 1, blocks).round().astype(int))]
    rows = min(len(lines), max(most // len(columns), 1))
    lines = lines[np.unique(np.linspace(0, len(lines) - 1, rows).round().astype(int))]
    grid = WindowGrid(whole.window, lines, columns)
    filters = learned_filters(state.records)
    return match_star(
        images, cameras, strip.surface, hub, (partner,), grid, strip.parameters, plan, filters=filters
    )


def _worth(z: Array) -> float:
    """Independent errors that scaled errors (rows, blocks) are worth, NaN where absent.

    Notes
    -----
    The mean of n squares of errors of correlation rho_ij has the variance of the mean of
    ``n / (1 + (1/n) sum_(i != j) rho_ij^2)`` independent ones. The correlations of neighbours along the
    strip and beside each other in a row are those found, less what chance makes of none.
    """
    seen = np.isfinite(z)
    n = int(seen.sum())
    v = np.where(seen, z, 0.0)
    power = float((v**2).sum()) / max(n, 1)
    if n < LEAST_WINDOWS or power <= 0.0:
        return float(n)
    rows, blocks = z.shape
    shared = 0.0
    for down in range(min(REACH, rows - 1) + 1):
        for side in range(-(blocks - 1), blocks):
            if (down, side) <= (0, 0):
                continue
            first = (slice(0, rows - down), slice(max(0, -side), blocks - max(0, side)))
            second = (slice(down, rows), slice(max(0, side), blocks - max(0, -side)))
            both = seen[first] & seen[second]
            number = int(both.sum())
            if number < LEAST_WINDOWS:
                continue
            rho = float((v[first] * v[second])[both].sum()) / (number * power)
            # less the square that chance alone makes
            shared += 2.0 * number / n * (rho**2 - 1.0 / number)
    return n / (1.0 + max(shared, 0.0))
