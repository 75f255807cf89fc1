"""What a user should know before trusting a recovered strip: unseen lines, lost windows, doubtful sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.prior import Matern
from sightline.estimation.search import SEEN_THROUGH
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import KEPT, NOT_CHOSEN, OUTLIER, OUTSIDE, STATUS_NAMES
from sightline.motion.estimators.differences import PITCH, YAW
from sightline.motion.measure.laid_strips import groups_of_pixels
from sightline.motion.measure.stars import StarRecord
from sightline.motion.observability import blind_together
from sightline.motion.results import ControlFit
from sightline.motion.statics import ALONG
from sightline.motion.strip.alternatives import agree, alternative, exchanged_bands
from sightline.motion.strip.checks import windows_in_common
from sightline.motion.strip.estimate import StripState, averaging_times, matched_span
from sightline.motion.strip.fusion import uses
from sightline.motion.strip.hidden import likely_modes
from sightline.motion.strip.hyper import ATTITUDE_SIGMA, NOT_FAR, RATE_SIGMA
from sightline.motion.strip.joint import JointEstimate
from sightline.motion.strip.lost_bands import (
    ENOUGH_KEPT,
    FEWEST_KEPT,
    pair_tells,
    pairs_compared,
)
from sightline.motion.strip.shape import shape_warnings
from sightline.motion.strip.strip import RecoverOptions, Strip, longest_lag
from sightline.motion.strip.viewing_axes import turned_spectra

Array = NDArray[np.float64]

#: A sensor whose residuals are so many times its sigma is worth a warning.
DOUBTFUL = 2.0
#: Matches that span less than this share of the field hardly tell yaw.
ENOUGH_FIELD = 0.3

#: px; smear over TDI stages that do not follow the ground: half a pixel is what designs allow.
OUT_OF_STEP_PX = 0.5

#: Frequencies that are named at most.
NAMED = 6

#: px; hidden modes beyond this blur by phases of a radian, of which steps about an estimate may go astray.
LARGE_HIDDEN_PX = 0.2

#: Odds of modes that sigma does not hold, from which on they are worth a warning; frequencies less likely
#: than so much of the likeliest are not named.
WORTH_SAYING, MAIN = 0.05, 0.1

#: px; jitter that one detector line hardly ever has.
WILD_PX = 5.0
#: Sigmas stated beforehand by which what was found may be off, unsaid.
FAR_OFF = 3.0
#: Of the rate at which the ground passes, an even rate of pitch as a wrong speed would look like: that bends
#: short strips by some sigmas.
OTHER_SPEED = 0.03
#: Sigmas of an offset along by which it may differ from that of a band with another one's image.
AS_EXCHANGED = 2.0


def _spanned_field(strip: Strip, records: Sequence[StarRecord]) -> float:
    """Share of the field of all detectors that the kept windows (all but 5 % at either side) reach over."""
    low: list[Array] = []
    high: list[Array] = []
    ends: list[float] = []
    for band in strip.bands:
        across = band.camera.detector.tangents[[0, -1], 0]
        ends += [float(across.min()), float(across.max())]
    for record in records:
        star, detector = record.star, strip.bands[record.star.hub].camera.detector
        columns = star.pixels[star.present.any(axis=1), 1]
        half = (star.window[1] - 1) / 2.0 if star.window else 0.0
        for out, side in ((low, -half), (high, half)):
            out.append(detector.directions_at(columns + side)[:, 0])
    seen = np.concatenate(low)
    if len(seen) == 0 or max(ends) <= min(ends):
        return 0.0
    return float(np.quantile(np.concatenate(high), 0.95) - np.quantile(seen, 0.05)) / (max(ends) - min(ends))


def _off_along(strip: Strip, state: StripState) -> Array:
    """(bands,) sigmas of its offset along by which each lies off its place; 0 of one that is exact."""
    found = {
        parameter.name: abs(float(value)) / parameter.sigma
        for parameter, value in zip(strip.parameters, state.estimate.statics, strict=True)
    }
    return np.array([found.get(f"{band.name} {ALONG}", 0.0) for band in strip.bands])


def _lost_windows(records: Sequence[StarRecord]) -> str:
    """What to say where most windows of the largest star that lay on both images were lost; "" if not so."""
    largest = max(records, key=lambda record: record.status.size)
    tried = (largest.status != OUTSIDE) & (largest.status != NOT_CHOSEN)
    kept = largest.star.present
    if not tried.any() or kept.sum() >= ENOUGH_KEPT * tried.sum():
        return ""
    # matched, but thrown out for what it said
    ended = np.where((largest.status == KEPT) & ~kept, OUTLIER, largest.status)[tried & ~kept]
    numbers = np.bincount(ended, minlength=len(STATUS_NAMES))
    worst = int(np.argmax(numbers))
    share = 100.0 * kept.sum() / tried.sum()
    return (
        f"only {share:.0f} % of the windows tried were kept; the others are mostly "
        f"{STATUS_NAMES[worst]!r} ({numbers[worst]} of {len(ended)}): clouds, water, or cameras that say the "
        "wrong place"
    )


def out_of_step(strip: Strip) -> list[str]:
    """Bands whose TDI stages, a pixel apart, do not follow the ground as it passes from line to line."""
    said = []
    for name, camera in zip((band.name for band in strip.bands), strip.nominal, strict=True):
        if camera.stages is None:
            continue
        passed = _px_a_line(camera, strip.surface)
        most = int(np.max(camera.stages))
        smear = abs(passed - 1.0) * (most - 1)
        if smear > OUT_OF_STEP_PX:
            said.append(
                f"the ground passes {passed:.3g} px a line of {name}, whose {most} TDI stages are one "
                f"px apart: by these cameras a point smears over {smear:.2g} px, and jitter within the "
                "stages counts otherwise than is modelled; check line_period, altitude, speed and ifov"
            )
    return said


def _middle(camera: PushbroomCamera) -> Array:
    """(1, 2) px; the middle of an image."""
    return np.array([[0.5 * (camera.lines - 1.0), 0.5 * (camera.columns - 1.0)]])


def _px_a_line(camera: PushbroomCamera, surface: Surface) -> float:
    """px along that the ground passes from line to line, in the middle of an image."""
    middle = _middle(camera)
    ahead = replace(camera, detector=camera.detector.adjusted(1.0))
    here, pixel, line = (
        one.locate(middle + np.array([lines, 0.0]), surface)[0]
        for one, lines in ((camera, 0.0), (ahead, 0.0), (camera, 1.0))
    )
    along = pixel - here
    return float((line - here) @ along / (along @ along))


def _blind_to(state: StripState, upper: float) -> tuple[list[float], float]:
    """Frequencies up to `upper` (Hz) that all pairs of bands are blind to, and the resolution (Hz)."""
    stars = [record.star for record in state.records if record.star.present.any()]
    if not stars or upper <= 0.0:
        return [], 0.0
    lags, weights = [], []
    for star in stars:
        for k in np.flatnonzero(star.present.any(axis=0)):
            kept = star.present[:, k]
            lags.append(float(np.median(star.t[kept, k] - star.t_hub[kept])))
            weights.append(float(kept.sum()))
    if not all(lags):
        return [], 0.0
    first, last = matched_span(stars)
    return blind_together(lags, weights, upper).tolist(), 1.0 / (last - first)


def blind_warnings(state: StripState) -> list[str]:
    """That all pairs of bands are blind where modes are not unlikely beside those that are seen."""
    seen = sorted({round(tone.frequency) for one in state.model.spectra for tone in one.tones})
    blind, apart = _blind_to(state, NOT_FAR * seen[-1] if seen else 0.0)
    if not blind:
        return []
    named = ", ".join(f"{f:.3g}" for f in blind[:NAMED]) + ", ..." * (len(blind) > NAMED)
    said = (
        f"all pairs of bands are blind at {named} Hz: nothing is known of a tone there, and hardly anything "
        f"of one within {apart:.2g} Hz, not unlikely beside those of {', '.join(map(str, seen))} Hz"
    )
    found = sorted({tone.frequency for tones in state.model.blind for tone in tones})
    if not found:
        return [f"{said}; sigma holds none but those that were found; a band at another lag would show them"]
    places = ", ".join(f"{f:.3g}" for f in found)
    return [
        f"{said}. Something moves at {places} Hz, about which axis no match tells: sigma holds such a tone "
        "of each; a band at another lag would tell"
    ]


def _unsettled(strip: Strip, state: StripState, change: float, at: float) -> str:
    """That the last pass changed the motion by many sigma, most of it about `at` (Hz, or 0), and why."""
    said = f"the passes did not settle: the last changed the motion by {change:.1f} sigma"
    blind, apart = _blind_to(state, 2.0 * at)
    near = [f for f in blind if abs(f - at) <= apart]
    if near:
        return (
            f"{said}, most of it about {at:.3g} Hz: all pairs of bands are blind at {near[0]:.3g} Hz, and "
            "what moves there no match tells; a band at another lag would"
        )
    stages = [band.camera.stages for band in strip.bands if band.camera.stages is not None]
    most = max((int(np.asarray(one).max()) for one in stages), default=1)
    described = f"camera description, {most} TDI stages among it" if most > 1 else "camera description"
    return f"{said}; check the {described}, or allow more with [matching] passes"


def _averaged_away(strip: Strip, state: StripState) -> list[str]:
    """Bands of lines so long that modes may be hidden in them not far beyond those that are seen.

    None where two bands of the finest lines are matched: these show them.
    """
    stars = [record.star for record in state.records if record.star.present.any()]
    if not stars or any(star.stretch == 0.0 for star in stars):
        return []
    highest = max(SEEN_THROUGH / (star.duration + star.stretch) for star in stars)
    seen = sorted({round(tone.frequency) for one in state.model.spectra for tone in one.tones})
    if not seen or highest > NOT_FAR * seen[-1]:
        return []
    names = [strip.bands[hub].name for hub in sorted({star.hub for star in stars})]
    return [
        f"windows in the long lines of {', '.join(names)} average away motion above {highest:.0f} Hz: modes "
        f"there, not unlikely beside those of {', '.join(map(str, seen))} Hz, show in no image, and "
        "sigma holds of them only what is likely; a pair of bands of shorter lines would show them"
    ]


def _large_hidden(strip: Strip, state: StripState) -> list[str]:
    """Modes that TDI averages away and that are so large that their blur may not show them as they are."""
    if not state.model.blur_shows:
        return []
    large = [
        f"{tone.frequency:.0f} Hz of {axis} ({tone.sigma / size:.2g} px)"
        for axis, size, tones in zip(("roll", "pitch", "yaw"), strip.scale, state.model.unseen, strict=True)
        for tone in tones
        if tone.sigma > LARGE_HIDDEN_PX * size
    ]
    if not large:
        return []
    return [
        f"the TDI stages average away {', '.join(large)}: only their blur shows them, and of modes so large "
        "not in proportion, so that they, and what is near their sums and differences with others, may be "
        "wrong by as much as that, which sigma does not hold; fewer stages would show them"
    ]


def _hidden_by_stages(strip: Strip, state: StripState, motion: Motion) -> list[str]:
    """Modes larger than sigma that TDI may hide, where rows are too few, or too noisy, to show them.

    None where something is known to be hidden: sigma holds what is likely of it, or spectra that are given.
    """
    averages = averaging_times(strip)
    if not averages or any(state.model.unseen) or strip.known.spectra is not None:
        return []
    assert motion.covariance is not None
    own = strip.turn.T @ motion.covariance @ strip.turn  # about the axes of the spectra
    sigma = np.sqrt(np.median(np.diagonal(own, axis1=1, axis2=2), axis=0))
    span = matched_span([record.star for record in state.records])
    f, odds, sizes = likely_modes(state.model, state.estimate, span, averages, sigma)
    if odds.sum() < WORTH_SAYING:
        return []
    main = odds > MAIN * odds.max()
    largest = (sizes[main] / strip.scale).max()
    tones = sorted({round(tone.frequency) for one in state.model.spectra for tone in one.tones})
    known, chance = ", ".join(map(str, tones)), odds.sum() / (1.0 + odds.sum())
    return [
        f"the TDI stages average away {f[main].min():.0f} to {f[main].max():.0f} Hz, and their blur tells "
        f"too little here of modes of some {largest:.2g} px rms there (probability {chance:.2g}, by those of "
        f"{known} Hz): sigma holds none; a longer or wider strip, or a band of fewer stages, would show them"
    ]


def _unmatched_bands(strip: Strip, state: StripState, options: RecoverOptions) -> list[str]:
    """Bands none of whose pairs keeps enough windows, and the one mistake that is why where there is one."""
    records = state.records
    compared, kept = pairs_compared(records, len(strip.bands))
    named = {name for pair in options.pairs for name in pair} or {band.name for band in strip.bands}
    asked = np.array([band.name in named for band in strip.bands])
    alone = np.asarray(~pair_tells(kept, compared).any(axis=1))
    # those of coarse pixels first, whose windows are compared with those of fine ones
    groups = np.array(groups_of_pixels([band.camera for band in strip.bands]))
    matched, lost = np.flatnonzero(~alone), np.flatnonzero(alone & asked)
    matched = matched[np.argsort(groups[matched], kind="stable")]
    out = [
        f"{strip.bands[b].name} is in none of the `pairs` that are to be matched: no match of it has a part "
        "in the motion, or measures its place"
        for b in np.flatnonzero(~asked)
    ]
    # a wide search finds another band's image too: of such as match, the one nearest to its place is sound
    off = _off_along(strip, state)
    sound = min(matched, key=lambda b: (groups[b], off[b]), default=None)
    doubtful = sorted([*lost, *(b for b in matched if b != sound and off[b] > FAR_OFF)])
    if sound is not None and len(lost) and len(doubtful) > 1:
        some = [strip.bands[b] for b in (sound, *doubtful)]
        words, names, _ = exchanged_bands(some, strip.surface, RecoverOptions().search_px)
        # only of lost or far ones: the others match as they are
        if words and some[0].name not in names:
            both = {strip.bands[b].name for b in lost} >= set(names)
            found = "match nothing" if both else "match nothing, or far from their places"
            out.append(f"{' and '.join(names)} {found}: {words}")
            lost = np.array([b for b in lost if strip.bands[b].name not in names], dtype=int)
    return out + [
        f"{strip.bands[b].name} matches nothing: {kept[b].sum()} of {compared[b].sum()} windows kept, so "
        f"nothing measures its place; {_why_unmatched(strip, int(b), matched, options)}"
        for b in lost
    ]


def _why_unmatched(strip: Strip, lost: int, matched: NDArray[np.intp], options: RecoverOptions) -> str:
    """The one mistake without which it would match, where matches prove it; else what to check."""
    if any(band.camera.stages is not None for band in strip.bands):
        common = windows_in_common(strip, options, options.window, options.step)
        if common.clear_of[lost] < FEWEST_KEPT <= common.whole_of[lost]:
            return (
                "nearly all of its windows lie across a change of TDI stages, in it or in the other band: "
                "let `stages` change less often from column to column"
            )
    for other in matched:
        words = alternative(strip.bands[other], strip.bands[lost], strip.surface, RecoverOptions().search_px)
        if words:
            return words
    for other in matched:
        if agree(strip.bands[other], strip.bands[lost], strip.surface, RecoverOptions().search_px):
            return (
                f"it matches {strip.bands[other].name} where the cameras say, but was compared only with "
                "bands that it does not match: set these right"
            )
    return (
        "check its `look_ahead` (sign), `ifov` and line times; or it looks like no other band, or clouds "
        "hide it"
    )


def _sensor_warnings(strip: Strip, estimate: JointEstimate) -> list[str]:
    """Sensors that said nothing, or something else than the images."""
    used = () if estimate.ties is None else uses(estimate.ties, estimate.own, estimate.own_sigma)
    silent = [s.name for s in strip.sensors if s.name not in {use.name for use in used}]
    out = [
        f"{name}: no reading during the images, so it takes no part; check the times of its table"
        for name in silent
    ]
    if strip.control is not None and "control points" not in {use.kind for use in used}:
        out.append("no control point is seen where its image says: they take no part; check x, y, z and line")
    for use in used:
        if use.kind == "control points" and use.used < use.given:
            out.append(_beyond_image(use.given - use.used, use.given))
        off = _factor_words(use.sigma_factor)
        if off:
            out.append(
                f"{use.name}: its residuals are {off} what its sigma says, and it is believed so "
                "much less; check its sigma, its axes (alignment_sigma) and its times"
            )
    return out


def _beyond_image(number: int, given: int) -> str:
    """That so many control points of those given take no part."""
    return (
        f"{number} of {given} control points lie beyond the image, or so near its ends that the camera as "
        "given does not show them, and take no part"
    )


def _factor_words(factors: tuple[float, ...]) -> str:
    """By how many times their sigma the axes of a sensor scatter; "" where none does."""
    # control points have one factor for all axes
    axes = (" (roll)", " (pitch)", " (yaw)") if len(factors) > 1 else ("",)
    named = zip(factors, axes, strict=True)
    return ", ".join(f"{factor:.2g} times{axis}" for factor, axis in named if factor > DOUBTFUL)


def _far_off(strip: Strip, state: StripState, motion: Motion) -> list[str]:
    """Statics, constant angles and even rates far from what was given, by what was said of them."""
    said, far = [], {}
    for parameter, value in zip(strip.parameters, state.estimate.statics, strict=True):
        ratio = abs(float(value)) / parameter.sigma
        if ratio > FAR_OFF:
            far[parameter.name] = float(value)
            said.append(
                f"{parameter.name} is {value:.3g} {parameter.unit}".rstrip() + f" ({ratio:.2g} sigmas)"
            )
    half = 0.5 * strip.grid.step * max(strip.grid.count - 1, 1)
    turns = (state.prior.constant_sigma[YAW], state.prior.drift_sigma[YAW] / half)
    allowed = [(s, s, max(s, turn)) for s, turn in zip(strip.known.usual(), turns, strict=True)]
    kinds = (
        ("a constant {} of {:.3g} rad", allowed[0]),
        ("an even rate of {} of {:.3g} rad/s", allowed[1]),
    )
    for (words, sigmas), values in zip(kinds, _constants_and_rates(motion), strict=False):
        for axis, value, sigma in zip(("roll", "pitch", "yaw"), values.tolist(), sigmas, strict=True):
            if abs(value) > FAR_OFF * sigma > 0.0:
                said.append(f"{words.format(axis, value)} ({abs(value) / sigma:.2g} sigmas)")
    if not said:
        return []
    usual = [
        name
        for name, stated in (
            (f"attitude_sigma {ATTITUDE_SIGMA:g} rad", strip.known.attitude_sigma),
            (f"rate_sigma {RATE_SIGMA:g} rad/s", strip.known.rate_sigma),
        )
        if stated is None
    ]
    taken = (
        f" (not given, and taken as: {', '.join(usual)}, of yaw as much more as it moves)" if usual else ""
    )
    return [
        f"far from what was given: {', '.join(said)}; {_exchanged(strip, far)}check ifov or directions, "
        f"look_ahead, rotation, line times and attitudes, or the sigmas that are stated of them{taken}"
    ]


def _constants_and_rates(motion: Motion) -> Array:
    """(2, 3) rad, rad/s; of each angle the line through it, in mid-strip; (1, 3) of a single instant."""
    t = motion.t - motion.t.mean()
    return np.polynomial.polynomial.polyfit(t, motion.angles, 1) if len(t) > 1 else motion.angles


def _other_speed(strip: Strip, motion: Motion) -> list[str]:
    """An even rate of pitch that lags, all some per cent longer or shorter than given, would look like."""
    if strip.sensors or strip.control is not None or len(motion.t) < 2:
        return []
    camera = strip.nominal[0]
    passing = _px_a_line(camera, strip.surface) * strip.pixel_angle / camera.detector.line_period
    rate = float(_constants_and_rates(motion)[1, PITCH])
    share = rate / passing
    # over short lags offsets that are not known look alike, and no more is said of them
    finest = min(camera.detector.line_period for camera in strip.nominal)
    loose = max(
        b.offset_sigma_px * c.detector.pixel_step for b, c in zip(strip.bands, strip.nominal, strict=True)
    )
    lag = finest * longest_lag(strip.nominal, strip.surface)
    if not (abs(share) > OTHER_SPEED and abs(rate) * lag > FAR_OFF * math.sqrt(2.0) * loose):
        return []
    return [
        f"pitch turns evenly by {rate:.3g} rad/s, {100.0 * abs(share):.2g} % of the rate at which the ground "
        "passes: lags that are all as much longer or shorter than given look the same, and bend the motion "
        "by more than its sigma; unless the camera turns so, check altitude and speed, line_period, "
        "first_line_time and look_ahead"
    ]


def _exchanged(strip: Strip, far: Mapping[str, float]) -> str:
    """Two bands whose images look exchanged, by what is far off of each; "" if none do.

    The first pass finds lags within its search, so that each of the two matches where the other should, and
    its offset along becomes the difference of their lags: forward in the one, backward in the other.
    """
    offsets = {k: far.get(f"{band.name} {ALONG}", np.nan) for k, band in enumerate(strip.bands)}
    for i, j in combinations((k for k, offset in offsets.items() if np.isfinite(offset)), 2):
        one, other = strip.bands[i], strip.bands[j]
        if one.image.shape != other.image.shape:
            continue
        middle = _middle(strip.nominal[i])
        seen = strip.nominal[j].project(strip.nominal[i].locate(middle, strip.surface))
        lines = float((seen - middle)[0, 0])
        if all(
            abs(offsets[k] - sign * lines * _px_a_line(strip.nominal[k], strip.surface))
            < AS_EXCHANGED * strip.bands[k].offset_sigma_px
            for k, sign in ((i, -1.0), (j, 1.0))
        ):
            return (
                f"the images of {one.name} and {other.name} look exchanged, as each lies where the other "
                "should: give each band the other's image; or "
            )
    return ""


def control_warnings(
    strip: Strip, state: StripState, motion: Motion, observed: NDArray[np.bool_], fit: ControlFit
) -> tuple[str, ...]:
    """What a user of a strip of one band should know before trusting the numbers."""
    out = []
    if not observed.all():
        out.append(
            f"{(~observed).sum()} of {len(observed)} lines lie beside no control point: the motion there is "
            "interpolated, its sigma grown by what the spectrum of the others lets believe"
        )
    given = 0 if strip.control is None else len(strip.control.sigma)
    if given > len(fit.kept):
        out.append(_beyond_image(given - len(fit.kept), given))
    lost = int((~fit.kept).sum())
    if lost:
        out.append(
            f"{lost} of {len(fit.kept)} control points are contradicted by the others, and believed so much "
            "less"
        )
    if strip.known.spectra is None:
        # drift, then what is quicker (`control_only.fit_control_spectrum`)
        seen = zip(state.model.spectra[:2], strip.scale[:2], strict=True)
        quick = [c.sigma / px for s, px in seen for c in s.components[1:2] if isinstance(c, Matern)]
        if max(quick, default=0.0) > WILD_PX:
            out.append(
                f"control points depart from each other by {max(quick):.3g} px, which passes for jitter: are "
                "columns counted from the other side, lines and columns exchanged, or places of another band "
                "or projection? Look at some in the image"
            )
    return (*out, *_far_off(strip, state, motion), *_sensor_warnings(strip, state.estimate))


def strip_warnings(
    strip: Strip,
    state: StripState,
    motion: Motion,
    observed: NDArray[np.bool_],
    changes: list[float],
    options: RecoverOptions,
    left: float = 1.0,
    at: float = 0.0,
) -> tuple[str, ...]:
    """What a user should know before trusting the numbers.

    `options`: with the windows of the last pass. `left`: share of the last of the `changes` that was left for
    a pass that is not among them; `at`: Hz about which most of that change lies, 0 where it does about none.
    """
    out = []
    if changes and left * changes[-1] > 1.0:
        out.append(_unsettled(strip, state, changes[-1], at))
        if all(band.offset_sigma_px == 0.0 for band in strip.bands):
            out.append("band offsets are given as exact (offset_sigma_px = 0); give a sigma if they are not")
    out += _unmatched_bands(strip, state, options)
    lost = _lost_windows(state.records)
    if lost:
        out.append(lost)
    if not observed.all():
        out.append(
            f"{(~observed).sum()} of {len(observed)} lines are seen by no match: the motion there is "
            "interpolated, its sigma grown"
        )
    out += out_of_step(strip)
    out += blind_warnings(state)
    out += _averaged_away(strip, state) + _large_hidden(strip, state)
    out += _hidden_by_stages(strip, state, motion)
    out += _far_off(strip, state, motion) + _other_speed(strip, motion)
    out += _sensor_warnings(strip, state.estimate)
    out += shape_warnings(strip, state)
    covariance = motion.covariance
    assert covariance is not None
    prior_yaw = turned_spectra(state.model.spectra, strip.turn)[2].sigma
    sigma_yaw = float(np.sqrt(np.median(covariance[:, 2, 2])))
    spanned = _spanned_field(strip, state.records)
    if spanned < ENOUGH_FIELD:
        out.append(
            f"yaw is nearly blind: the matches span {100 * spanned:.0f} % of the field (30 % are enough); "
            f"it is known to {sigma_yaw / strip.scale[2]:.2g} px at the field's edge, roll and pitch no "
            "better away from the matches"
        )
    elif sigma_yaw > 0.3 * prior_yaw:
        out.append(
            f"yaw is hardly observable: its sigma, {sigma_yaw / strip.scale[2]:.2g} px at the field edge, is "
            f"close to that of the prior; the field of {2 * strip.half_field:.2g} rad is narrow, or the "
            "matches do not span it"
        )
    return tuple(out)
