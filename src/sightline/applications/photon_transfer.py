"""A detector's noise by photon transfer: bright frames, two or more of each exposure, and dark ones.

Not here: what one exposure shows (``imaging/photon_transfer.py``), scenes and strips (``detector_noise.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sightline.applications.detector_noise import (
    CLIPPED_SHARE,
    DEAD,
    LEAST_STEPS,
    OFFSET_UNKNOWN,
    DarkNoise,
    DetectorNoise,
    ExposureNoise,
    ImageNoise,
    PhotonTransfer,
    PixelValues,
    chunks_of,
    dark_noise,
    detector_noise,
    look_through,
    pattern_of_parts,
)
from sightline.errors import EstimationError, InputError
from sightline.execution import Progress
from sightline.imaging.noise_estimation import BLOCK, Estimate, WhiteNoise
from sightline.imaging.photon_transfer import (
    AT_ONCE,
    Stack,
    TransferFit,
    compare_columns,
    fit_transfer,
    measure_stack,
    same_exposure,
    usable_stacks,
    with_noise_of,
)
from sightline.imaging.source import ImageSource
from sightline.imaging.strip_noise import LawRows, NoiseFigure, bounded_figure, measured_figure

Array = NDArray[np.float64]

#: Share of the signal by which a lamp may drift between frames of one exposure, and sigmas of their means.
DRIFT, SIGMAS = 3e-3, 5.0
#: Frames differ by noise alone where means of blocks scatter less than so many times as noise has them.
SAME_SCENE = 25.0
#: Largest scatter of the response that is one of pixels and not of the light.
MOST_UNEVEN = 0.25


class FrameLevel(NamedTuple):
    """Mean of a frame and how far one of the same exposure may be, DN."""

    mean: float
    sigma: float


class EvenExposures(NamedTuple):
    """Which frames show the same exposure, and the level of every frame."""

    groups: list[list[int]]
    levels: list[FrameLevel]


def even_exposures(
    names: Sequence[str], images: Sequence[ImageSource], dark: Sequence[ImageSource], dark_level: float | None
) -> EvenExposures | None:
    """Which frames show the same exposure; None where no two do: then they are scenes.

    Frames of one exposure are of one size, have one mean within what noise and a lamp's drift allow, and
    differ by noise alone.
    """
    if len(images) < 2:
        return None
    sizes = sorted({image.shape for image in images})
    for size in sizes if len(sizes) > 1 else ():
        alike = [image for image in images if image.shape == size]
        if even_exposures(names, alike, dark, dark_level) is not None:
            other = next(k for k, image in enumerate(images) if image.shape != size)
            raise InputError(
                f"{names[other]} has {images[other].shape[0]} lines x {images[other].shape[1]} columns, "
                f"frames of one exposure {size[0]} x {size[1]}; give frames of one size"
            )
    if len(sizes) > 1:
        return None
    levels = [_level(image) for image in images]
    means = np.array([one.mean for one in levels])
    if not np.isfinite(means).all():
        return None
    if dark and dark[0].shape == images[0].shape:
        rest = _level(dark[0]).mean
    else:
        rest = dark_level or 0.0
    drift = DRIFT * np.abs(means - rest)
    groups = same_exposure(means, drift + SIGMAS * np.array([one.sigma for one in levels]))
    shared = [group for group in groups if len(group) > 1]
    if not any(_differ_by_noise(images[a], images[b]) for a, b, *_ in shared):
        return None
    return EvenExposures(groups, levels)


def photon_transfer(
    names: Sequence[str],
    images: Sequence[ImageSource],
    even: EvenExposures,
    dark: Sequence[ImageSource],
    dark_level: float | None,
    report: Progress,
    *,
    stages: int = 1,
    electrons_per_dn: float | None = None,
) -> DetectorNoise:
    """The law and the columns of a detector from frames of even light.

    Parameters
    ----------
    names : sequence of str
    images : sequence of ImageSource
    even : EvenExposures
        Of `even_exposures`: those that show the same exposure.
    dark : sequence of ImageSource
        As many as `images`, each the one of its exposure, or any number, common to all.
    dark_level : float or None
        DN; in their place.
    report : callable
    stages : int
    electrons_per_dn : float, optional
        The conversion gain, from somewhere else.

    Raises
    ------
    InputError
        If frames without light are of another size or brighter than those with light.
    EstimationError
        If no exposure is left that is not cut off, or the noise does not grow with the signal.
    """
    shape, (groups, levels) = images[0].shape, even
    for number, frame in enumerate(dark):
        if frame.shape != shape:
            raise InputError(
                f"--dark number {number + 1} has {frame.shape[0]} lines x {frame.shape[1]} columns, frames "
                f"with light {shape[0]} x {shape[1]}; give frames of one size"
            )
    looks = []
    for number, image in enumerate(images):
        report("looking through frames", number, len(images))
        looks.append(_look(image))
    means = np.array([one.mean for one in levels])
    uncut = CLIPPED_SHARE * shape[0] * shape[1]
    whole = [one for one in looks if one.cut <= uncut]
    if not whole:
        said = " and ".join(sorted({one.ends for one in looks}))
        raise EstimationError(f"all frames are cut off, at {said} DN; give exposures of less light")
    step = min((one.step for one in whole if one.step > 0.0), default=0.0)
    low, high = _ends(looks, means[[one.cut <= uncut for one in looks]])
    dead = np.logical_and.reduce([one.dead for one in whole])
    cuts = [float(np.mean([looks[k].cut for k in group])) / (shape[0] * shape[1]) for group in groups]
    # all exposures that are cut off look alike: their dark frames need not be
    alike = [
        group for group, cut in zip(groups, cuts, strict=True) if len(group) > 1 and cut <= CLIPPED_SHARE
    ]
    rest = _without_light(dark, len(images), alike, step, dark_level, report)
    warnings, exposures = list(rest.warnings), []
    signals = [float(np.mean(means[group] - rest.levels[group])) for group in groups]
    unsure = [SIGMAS * max(levels[k].sigma for k in group) for group in groups]
    darkest = int(np.argmin(np.add(signals, unsure)))
    if signals[darkest] < -unsure[darkest] or max(signals) <= 0.0:
        raise InputError(
            f"{names[groups[darkest][0]]} has a mean {abs(signals[darkest]):.4g} DN below its frames without "
            "light; frames with light are brighter: exchange them and --dark, or give the dark frames of "
            "each exposure in its order"
        )
    for number, (group, signal, cut) in enumerate(zip(groups, signals, cuts, strict=True)):
        report("comparing frames of an exposure", number, len(groups))
        first = names[group[0]]
        if signal <= 0.0:
            warnings.append(
                f"{first}: its exposure, a mean of {means[group[0]]:.5g} DN, is no brighter than frames "
                "without light, and it is left out"
            )
            continue
        if len(group) == 1:
            warnings.append(
                f"{first}: no other frame shows its exposure, a mean of {means[group[0]]:.5g} DN, and it is "
                "left out; give two frames or more of each exposure"
            )
            continue
        stack = None
        if cut <= CLIPPED_SHARE:
            stack = measure_stack([images[k] for k in group], means[group].tolist(), low, high, dead)
        exposures.append(_Exposure(first, len(group), signal, cut, stack))
    return _assembled(
        sorted(exposures, key=lambda one: one.signal), rest, step, dead, warnings, stages, electrons_per_dn
    )


@dataclass(frozen=True, eq=False)
class _Exposure:
    """Frames that show the same light; `stack` is None where they are cut off."""

    name: str
    frames: int
    signal: float
    cut: float
    stack: Stack | None


@dataclass(frozen=True, eq=False)
class _Rest:
    """What is known without light.

    Attributes
    ----------
    levels : (frames,)
        DN, of each frame with light.
    columns : (columns,)
    noise : Estimate or None
        Variance, rounding taken off.
    stack : Stack or None
    frames : DarkNoise or None
    given : bool
    warnings : tuple of str
    """

    levels: Array
    columns: Array
    noise: Estimate | None
    stack: Stack | None
    frames: DarkNoise | None
    given: bool
    warnings: tuple[str, ...]


def _without_light(
    dark: Sequence[ImageSource],
    count: int,
    groups: Sequence[Sequence[int]],
    step: float,
    level: float | None,
    report: Progress,
) -> _Rest:
    """Level and noise without light: of each frame's own exposure where there are as many dark ones."""
    if not dark:
        said = (
            ()
            if level is not None
            else (
                "the level without light is taken for 0 DN; give frames without light (--dark) or that level "
                "(--dark-level), or signals are too large, and gains and shot noise too small",
            )
        )
        return _Rest(np.full(count, level or 0.0), np.array(level or 0.0), None, None, None, False, said)
    if len(dark) == 1:
        found = dark_noise(dark)
        read = found.resting
        noise = None if read is None else Estimate(read.value**2, 2.0 * read.value * read.sigma)
        levels = np.full(count, float(np.mean(found.level)))
        return _Rest(levels, found.level, noise, None, found, True, found.warnings)
    looks, means = [], np.empty(len(dark))
    for number, frame in enumerate(dark):
        report("frames without light", number, len(dark))
        looks.append(_look(frame))
        means[number] = _level(frame).mean
    pixels = dark[0].shape[0] * dark[0].shape[1]
    cut = float(np.mean([one.cut for one in looks])) / pixels
    if cut > 0.5:
        raise EstimationError(
            f"frames without light are cut off, at {looks[0].ends} DN, and show neither level nor noise; "
            "give frames with an offset, or their level (--dark-level)"
        )
    dead = np.logical_and.reduce([one.dead for one in looks])
    ends = -np.inf, np.inf
    stack = measure_stack(dark, means.tolist(), *ends, dead)
    if len(dark) == count and groups:
        # the dark current of pixels grows with the exposure: from one to the next it is no noise
        own = [
            measure_stack([dark[k] for k in group], means[group].tolist(), *ends, dead) for group in groups
        ]
        stack = with_noise_of(stack, own)
    value = stack.noise.value - step**2 / 12.0
    warnings = []
    noise = Estimate(value, stack.noise.sigma)
    if cut > CLIPPED_SHARE:
        warnings.append(
            f"{100.0 * cut:.2g} % of the pixels without light are cut off, at {looks[0].ends} DN: their "
            "level is too large, and their noise is not used"
        )
    elif value <= (LEAST_STEPS * step) ** 2:
        warnings.append(
            f"frames without light do not show their noise: it is below a fifth of the step of {step:g} DN, "
            "and the read noise is not taken from them"
        )
    columns = stack.columns()
    places = np.arange(len(columns))
    alive = np.isfinite(columns)
    levels = means if len(dark) == count else np.full(count, float(means.mean()))
    return _Rest(
        levels,
        np.interp(places, places[alive], columns[alive]),
        None if warnings else noise,
        None if cut > CLIPPED_SHARE else stack,
        None,
        True,
        tuple(warnings),
    )


def _assembled(
    exposures: list[_Exposure],
    rest: _Rest,
    step: float,
    dead: NDArray[np.bool_],
    warnings: list[str],
    stages: int,
    electrons_per_dn: float | None,
) -> DetectorNoise:
    """The fit of all exposures, the fixed pattern and the columns."""
    stacks = [(one, one.stack) for one in exposures if one.stack is not None]
    signals = np.array([one.signal for one, _ in stacks])
    # what is cut off below shows no saturation
    brightest = max(signals.tolist(), default=0.0)
    saturated = any(one.stack is None and one.signal > brightest for one in exposures)
    used, top = usable_stacks(signals, [stack for _, stack in stacks], saturated)
    if not used.any():
        raise EstimationError(
            "no two frames show an exposure that is neither cut off nor above 70 % of the saturation; give "
            "pairs of exposures of less light"
        )
    # exposures that are all cut off look alike: frames are counted
    cut = sum(one.frames for one in exposures if one.stack is None)
    beyond = sum(one.frames for (one, _), use in zip(stacks, used, strict=True) if not use)
    said = [f"{cut} cut off"] if cut else []
    said += [f"{beyond} above 70 % of the saturation"] if beyond else []
    if said:
        warnings.append(
            f"of {sum(one.frames for one in exposures)} frames, {' and '.join(said)} are left out; signals "
            f"of {signals[used].min():.4g} to {signals[used].max():.4g} DN are used"
        )
    variances = [Estimate(stack.noise.value - step**2 / 12.0, stack.noise.sigma) for _, stack in stacks]
    taken = np.flatnonzero(used).tolist()
    law = fit_transfer(signals[taken], [variances[k] for k in taken], rest.noise)
    shot = law.fit.estimate(0)
    c2 = law.fit.estimate(1) if len(law.fit.coefficients) > 1 else None
    if not shot.value > 2.0 * shot.sigma:
        raise EstimationError(
            f"the noise does not grow with the signal: by {shot.value:.3g} +- {shot.sigma:.2g} DN^2 per DN; "
            "give exposures of more unlike light, neither resampled nor filtered"
        )
    chosen = [stacks[k] for k in taken]
    images = [
        _image(one, stack, variances[k], rest, dead) for k, (one, stack) in zip(taken, chosen, strict=True)
    ]
    best = min(chosen, key=lambda pair: pair[1].fixed.sigma / pair[0].signal ** 2)
    pixels = _relative(best[1].pixels, None, best[0].signal)
    columns = max(images, key=lambda one: one.weight).columns.variance
    own, error = _columns_alone(chosen, rest, law, c2)
    weights = np.array([one.weight for one in images])
    left = float(np.sum((weights / weights.sum()) ** 2 / weights))
    sigma_gain = np.full(len(dead), np.sqrt(left + max(pixels.value, 0.0) / best[1].lines))
    sigma_offset = np.full(len(dead), np.nan if rest.stack is None else rest.stack.column_sigma())
    alike = {"conversion": compare_columns(own, error)}
    pattern = np.average([one.columns.pattern for one in images], axis=0, weights=weights)
    alike["gain"] = compare_columns(pattern, sigma_gain)
    if rest.stack is not None:
        alike["offset"] = compare_columns(rest.stack.columns(), sigma_offset)
    with np.errstate(divide="ignore", invalid="ignore"):
        per_dn, sigma_per_dn = 1.0 / own, error / own**2
    transfer = PhotonTransfer(
        shot,
        c2 if c2 is not None and c2.value >= 0.0 else None,
        pixels,
        columns,
        tuple(
            ExposureNoise(
                one.name,
                one.frames,
                one.signal,
                None
                if one.stack is None
                else Estimate(one.stack.noise.value - step**2 / 12.0, one.stack.noise.sigma),
                one.cut,
                any(one is kept for kept, _ in chosen),
            )
            for one in exposures
        ),
        per_dn,
        sigma_per_dn,
        sigma_gain,
        sigma_offset,
        alike,
        tuple(_figures(law, shot, c2, best, rest, None if top is None else float(signals[top]), warnings)),
    )
    images[0] = replace(images[0], warnings=tuple(warnings))
    if top is not None:
        images = [replace(one, ceiling=float(signals[top])) for one in images]
    return detector_noise(
        images, rest.frames, stages=stages, electrons_per_dn=electrons_per_dn, transfer=transfer
    )


def _image(
    one: _Exposure, stack: Stack, variance: Estimate, rest: _Rest, dead: NDArray[np.bool_]
) -> ImageNoise:
    """What one exposure says, as other images say it."""
    pattern = pattern_of_parts(_lit(one, stack, rest))
    rows = LawRows(
        np.array([[one.signal**2, one.signal, 1.0]]),
        np.array([variance.value]),
        np.array([[variance.sigma**2]]),
    )
    unknown = Estimate(np.nan, np.nan)
    flags = (DEAD * dead + OFFSET_UNKNOWN * (not rest.given)).astype(np.uint8)
    noise = stack.noise.value / stack.frames / stack.lines
    return ImageNoise(
        f"{one.name} and {one.frames - 1} more of its exposure",
        rows,
        WhiteNoise(one.signal, variance, variance, unknown, np.nan),
        pattern,
        np.broadcast_to(rest.columns, dead.shape),
        flags,
        None,
        one.signal,
        None,
        (
            measured_figure(
                f"noise at {one.signal:.4g} DN", "DN^2", variance, f"{one.frames} frames, differences"
            ),
            measured_figure("part common to a row", "DN^2", stack.rows, "jumps from frame to frame"),
        ),
        weight=one.signal**2 / noise,
    )


def _lit(one: _Exposure, stack: Stack, rest: _Rest) -> Array:
    """Means of columns in parts above those without light, (PARTS, columns); the level is of its exposure."""
    above = stack.column_means - rest.columns
    return np.asarray(above + (one.signal - float(np.nanmean(above))))


def _relative(bright: Estimate, dark: Estimate | None, signal: float) -> Estimate:
    """Variance of the response over the squared signal, less what is there without light."""
    less = Estimate(0.0, 0.0) if dark is None else dark
    sigma = float(np.hypot(bright.sigma, less.sigma))
    return Estimate((bright.value - less.value) / signal**2, sigma / signal**2)


def _root(square: Estimate) -> tuple[float, float]:
    """Root and its sigma; of a square that is not seen, sigma is that of a bound."""
    if square.value > square.sigma:
        root = float(np.sqrt(square.value))
        return root, square.sigma / (2.0 * root)
    return float(np.sqrt(max(square.value, 0.0))), float(np.sqrt(square.sigma))


def _rooted(name: str, unit: str, square: Estimate, how: str, scale: float) -> NoiseFigure:
    """Figure of a root, a bound where it is not seen at 2 sigma."""
    if square.value > 2.0 * square.sigma:
        root, sigma = _root(square)
        return measured_figure(name, unit, Estimate(root, sigma), how, scale)
    return bounded_figure(name, unit, "<=", scale * float(np.sqrt(max(square.upper(), 0.0))), how)


def _columns_alone(
    chosen: Sequence[tuple[_Exposure, Stack]], rest: _Rest, law: TransferFit, c2: Estimate | None
) -> tuple[Array, Array]:
    """DN per electron of each column by itself, and its sigma beside the other columns."""
    width = len(chosen[0][1].column_noise)
    if rest.stack is not None:
        still, of_still = rest.stack.column_noise, 2.0 * rest.stack.noise.value**2
        of_still /= rest.stack.lines * rest.stack.freedom
    else:
        still, of_still = np.full(width, 0.0 if c2 is None else c2.value), 0.0
    top, bottom, variance = np.zeros(width), np.zeros(width), of_still * law.weights.sum() ** 2
    for weight, (one, stack) in zip(law.weights, chosen, strict=True):
        top += weight * (stack.column_noise - still)
        bottom += weight * np.nanmean(_lit(one, stack, rest), axis=0)
        variance += weight**2 * 2.0 * stack.noise.value**2 / (stack.lines * stack.freedom)
    with np.errstate(divide="ignore", invalid="ignore"):
        return top / bottom, np.sqrt(variance) / np.abs(bottom)


def _figures(
    law: TransferFit,
    shot: Estimate,
    c2: Estimate | None,
    best: tuple[_Exposure, Stack],
    rest: _Rest,
    top: float | None,
    warnings: list[str],
) -> list[NoiseFigure]:
    """The figures of EMVA 1288, each with its sigma."""
    one, stack = best
    found = [measured_figure("K", "DN/e-", shot, "noise between frames over their signal")]
    if law.misfit > 0.0:
        found.append(
            NoiseFigure(
                "departure from its line",
                "DN/e-",
                law.misfit,
                None,
                "=",
                "from exposure to exposure, rms; in sigma of K",
            )
        )
    if c2 is not None and c2.value > 0.0:
        tied = float(law.fit.covariance[0, 1]) / (c2.value * shot.value)
        root = float(np.sqrt(c2.value)) / shot.value
        relative = c2.sigma**2 / (4.0 * c2.value**2) + (shot.sigma / shot.value) ** 2 - tied
        found.append(
            measured_figure(
                "dark noise",
                "e- rms",
                Estimate(root, root * float(np.sqrt(max(relative, 0.0)))),
                "between frames, rounding taken off",
            )
        )
    dark = rest.stack
    response = _relative(stack.fixed, None if dark is None else dark.fixed, one.signal)
    how = f"mean of {stack.frames} frames at {one.signal:.4g} DN, shading included"
    if response.value > MOST_UNEVEN**2:
        warnings.append(
            f"pixels differ by {100.0 * response.value**0.5:.3g} % at {one.signal:.4g} DN: the light is not "
            "even, and PRNU and columns are those of the scene"
        )
    found.append(_rooted("PRNU", "%", response, how, 100.0))
    found.append(
        _rooted(
            "  of pixels",
            "%",
            _relative(stack.pixels, None, one.signal),
            "beside rows, columns and shading",
            100.0,
        )
    )
    if dark is not None:
        for name, square, how in (
            ("DSNU", dark.fixed, f"mean of {dark.frames} frames without light"),
            ("rows that jump together", dark.rows, "without light, from frame to frame; in dark noise"),
        ):
            electrons = _rooted(name, "e-", square, how, 1.0 / shot.value)
            if electrons.sigma is not None:
                of_gain = electrons.value * shot.sigma / shot.value
                electrons = replace(electrons, sigma=float(np.hypot(electrons.sigma, of_gain)))
            found.append(electrons)
    if top is not None:
        found.append(
            measured_figure(
                "saturation",
                "e-",
                Estimate(top / shot.value, top * shot.sigma / shot.value**2),
                "largest noise; its exposure's",
            )
        )
    return found


def _look(image: ImageSource) -> PixelValues:
    """What the values of a frame are like; of one value, all are cut off."""
    try:
        return look_through(image)
    except EstimationError:
        value = float(np.nanmax(image.read((0, 1), (0, image.shape[1]))))
        dead = np.ones(image.shape[1], dtype=bool)
        return PixelValues(-np.inf, value, 0.0, dead, image.shape[0] * image.shape[1])


def _ends(looks: Sequence[PixelValues], means: Array) -> tuple[float, float]:
    """Where the detector cuts off: beyond the means of frames that are not cut off, else not known."""
    low = min((one.low for one in looks if np.isfinite(one.low)), default=-np.inf)
    high = max((one.high for one in looks if np.isfinite(one.high)), default=np.inf)
    return (low if low < means.min() else -np.inf), (high if high > means.max() else np.inf)


def _level(image: ImageSource) -> FrameLevel:
    """Mean of a frame, and what rows that jump together leave in it."""
    sums, counts = [], []
    for _, values in chunks_of(image):
        known = np.isfinite(values)
        counts.append(known.sum(axis=1))
        sums.append(np.where(known, values, 0.0).sum(axis=1))
    total, count = np.concatenate(sums), np.concatenate(counts)
    if not count.sum():
        return FrameLevel(np.nan, np.nan)
    rows = total[count > 0] / count[count > 0]
    return FrameLevel(float(total.sum() / count.sum()), float(rows.std()) / np.sqrt(len(rows)))


def _differ_by_noise(one: ImageSource, other: ImageSource) -> bool:
    """Whether two images are alike but for noise, which blocks of pixels average away."""
    lines, columns = one.shape
    side = BLOCK // 2
    window = (0, min(lines, max(AT_ONCE // columns, side))), (0, columns)
    first, second = (image.read(*window).astype(np.float64) for image in (one, other))
    down, across = first.shape[0] // side, columns // side
    if down * across < 4:
        return False
    apart = (first - second)[: down * side, : across * side]
    blocks = np.nanmean(apart.reshape(down, side, across, side), axis=(1, 3))
    return bool(np.nanvar(blocks) <= SAME_SCENE * np.nanvar(apart) / side**2)
