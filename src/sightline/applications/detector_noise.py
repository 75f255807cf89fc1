"""The noise law and the columns of a detector, from one raw image or several: what ``sightline noise`` finds.

Strips that were read with pixels beside the image say most (``imaging/strip_noise.py``). Plain images say
what the scatter of their pixels shows at their own signals; frames without light give the level of
each column and the noise at rest. All that is known of A, B and C^2 then goes into one fit.

Not here: how each is estimated (``imaging/noise_estimation.py``), files (``io/results/noise.py``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from sightline.errors import EstimationError, InputError
from sightline.estimation.robust import robust_sigma
from sightline.imaging.noise_estimation import (
    BLOCK,
    ORDER,
    PARTS,
    SMOOTH,
    Blocks,
    ColumnPattern,
    Estimate,
    WhiteNoise,
    even_noise,
    fit_law,
    measure_blocks,
    pattern_of_means,
    shows_texture,
    white_noise,
)
from sightline.imaging.photon_transfer import Alike
from sightline.imaging.source import ImageSource, usable_lines
from sightline.imaging.strip_noise import (
    LawRows,
    NoiseFigure,
    StripPixels,
    bounded_figure,
    estimate_strip_noise,
    law_rows,
    measured_figure,
    noise_figures,
)
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.result import Result, makes_result

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]

#: Bits of a column's flag.
GAIN_UNKNOWN, OFFSET_UNKNOWN, DEAD, OUTLYING = 1, 2, 4, 8
#: A column departs where it does so by so many robust sigmas of all.
OUTLIER_SIGMAS = 6.0
#: Pixels that are worked on at once.
AT_ONCE = 1 << 22
#: Share of the pixels at the largest (smallest) value from which it is where they are cut off.
CLIPPED_SHARE = 1e-3
#: And it holds so many times the pixels of the value next to it.
PILED = 3.0
#: Share of columns that never change up to which they are dead; more of them are cut off.
MOST_DEAD = 0.05
#: Largest share of pixels that may be cut off.
MOST_CLIPPED = 0.5
#: Noise below this part of the step of the codes is not seen in their scatter.
LEAST_STEPS = 0.2
#: B is known where its sigma is at most this share of it; more terms than that allows are not fitted.
KNOWN = 0.5
#: A given conversion gain is said to contradict the images beyond so many sigmas.
CONTRADICTS = 3.0


@dataclass(frozen=True, eq=False)
class ImageNoise:
    """What one image says of the detector's noise, DN.

    Attributes
    ----------
    name : str
    rows : LawRows
        Of A, B and C^2 of the sum.
    white : WhiteNoise
    columns : ColumnPattern
    level : (columns,)
        Of each column without light.
    flags : (columns,) uint8
        OFFSET_UNKNOWN, DEAD.
    dark_signal : Estimate or None
        Dark current of the sum, an upper bound.
    median : float
        Signal.
    ceiling : float or None
        Largest signal that has a value; None where no pixel reaches it.
    figures : tuple of Figure
    warnings : tuple of str
    weight : float
        Of its columns beside those of other images.
    """

    name: str
    rows: LawRows
    white: WhiteNoise
    columns: ColumnPattern
    level: Array
    flags: Flags
    dark_signal: Estimate | None
    median: float
    ceiling: float | None
    figures: tuple[NoiseFigure, ...]
    warnings: tuple[str, ...] = ()
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class DarkNoise:
    """What frames without light say, DN.

    Attributes
    ----------
    level : (columns,)
    resting : Estimate or None
        Noise; None where it is too small for the step of the values.
    figures : tuple of Figure
    warnings : tuple of str
    """

    level: Array
    resting: Estimate | None
    figures: tuple[NoiseFigure, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ExposureNoise:
    """Frames of one exposure.

    Attributes
    ----------
    name : str
        Of the first frame.
    frames : int
    signal : float
        DN above the level without light.
    variance : Estimate or None
        Between frames, DN^2, rounding taken off; None where they are cut off.
    cut : float
        Share of pixels that are cut off.
    used : bool
        For the conversion gain.
    """

    name: str
    frames: int
    signal: float
    variance: Estimate | None
    cut: float
    used: bool


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """What frames of even light say of a detector (EMVA 1288).

    Attributes
    ----------
    shot, rest : Estimate
        B, DN per electron, and C^2, DN^2; `rest` is None where nothing parts it.
    pixels, columns : Estimate
        Relative variance of the response of pixels that neither rows, columns nor a shading have; of columns,
        finer than their neighbours.
    exposures : tuple of ExposureNoise
        By signal.
    electrons_per_dn, sigma_electrons_per_dn, sigma_gain, sigma_offset : (columns,)
        Of each column by itself; NaN where it is not known.
    alike : dict of str to Alike
        Whether columns differ in ``conversion`` (DN per electron), ``gain`` and ``offset`` (DN).
    figures : tuple of NoiseFigure
        EMVA 1288's.
    """

    shot: Estimate
    rest: Estimate | None
    pixels: Estimate
    columns: Estimate
    exposures: tuple[ExposureNoise, ...]
    electrons_per_dn: Array
    sigma_electrons_per_dn: Array
    sigma_gain: Array
    sigma_offset: Array
    alike: dict[str, Alike]
    figures: tuple[NoiseFigure, ...]


@dataclass(frozen=True, eq=False, repr=False)
class DetectorNoise(Result):
    """A detector's noise as TDI takes it.

    Attributes
    ----------
    law : NoiseLaw
        Of a TDI line, in `unit`.
    unit : str
        ``"e-"``, or ``"DN"`` where no conversion gain was given.
    stages : int
    electrons_per_dn : float or None
    gain, offset : (columns,)
        Response of each column over its neighbours', 1 where it is not known; its level without light, DN.
    flags : (columns,) uint8
        GAIN_UNKNOWN, OFFSET_UNKNOWN, DEAD, OUTLYING.
    signals : (float, float)
        Of one line, in `unit`: what the images span.
    full_well_sum : float or None
        Largest sum that has a value, in `unit`.
    figures : tuple of Figure
        Of all images together.
    images : tuple of ImageNoise
    warnings : tuple of str
    transfer : PhotonTransfer or None
        Where the images are frames of even light, two or more of an exposure.
    """

    law: NoiseLaw
    unit: str
    stages: int
    electrons_per_dn: float | None
    gain: Array
    offset: Array
    flags: Flags
    signals: tuple[float, float]
    full_well_sum: float | None
    figures: tuple[NoiseFigure, ...]
    images: tuple[ImageNoise, ...]
    warnings: tuple[str, ...]
    transfer: PhotonTransfer | None = None


def strip_image_noise(
    name: str, pixels: StripPixels, stages: int, electrons_per_dn: float | None = None
) -> ImageNoise:
    """What a strip says that was read with empty and masked pixels and lines without charge beside it.

    Raises
    ------
    EstimationError
        If a part does not show its noise.
    """
    noise = estimate_strip_noise(pixels)
    dead = (pixels.image == pixels.image[:1]).all(axis=0)
    return ImageNoise(
        name,
        law_rows(noise.white, noise.buffer.pooled, noise.ramp),
        noise.white,
        noise.columns,
        noise.level,
        (DEAD * dead).astype(np.uint8),
        noise.dark_signal,
        float(noise.percentiles[1]),
        noise.ceiling,
        tuple(noise_figures(noise, stages, electrons_per_dn)),
    )


def dark_noise(frames: Sequence[ImageSource]) -> DarkNoise:
    """Level and noise of frames without light, all of the same columns."""
    levels, variances, sigmas, steps = [], [], [], []
    for frame in frames:
        _must_be_large(frame)
        found = look_through(frame)
        steps.append(found.step)
        chunks = ((part, found.usable(raw)) for part, raw in chunks_of(frame))
        means, blocks = _means_and_blocks(chunks, found.step, frame.shape[1])
        levels.append(np.average(means, axis=0, weights=[len(part) for part in _ranges(frame)]))
        known = blocks.white[np.isfinite(blocks.white)]
        variances.append(float(known.mean()))
        sigmas.append(float(known.std(ddof=1)) / np.sqrt(len(known)))
    if len({len(level) for level in levels}) != 1:
        widths = sorted({len(level) for level in levels})
        raise InputError(f"frames without light have {widths} columns; give frames of one detector")
    variance, sigma = float(np.mean(variances)), float(np.linalg.norm(sigmas)) / len(sigmas)
    every = np.arange(len(levels[0]))
    level = np.mean(levels, axis=0)
    alive = np.isfinite(level)
    # a dead column has no level of its own
    level, step = np.interp(every, every[alive], level[alive]), max(steps)
    if variance <= (LEAST_STEPS * step) ** 2:
        said = (
            f"frames without light do not show their noise: it is below a fifth of the step of {step:g} DN, "
            "and the read noise is not taken from them"
        )
        return DarkNoise(level, None, (), (said,))
    root = float(np.sqrt(variance))
    resting = Estimate(root, sigma / (2.0 * root))
    how = f"high differences of {len(frames)} frame{'s' if len(frames) > 1 else ''} without light"
    return DarkNoise(level, resting, (measured_figure("read noise C", "DN rms", resting, how),))


def plain_image_noise(
    name: str, image: ImageSource, dark: DarkNoise | None = None, dark_level: float | None = None
) -> ImageNoise:
    """What the pixels of an image say, with nothing beside it.

    Parameters
    ----------
    name : str
    image : ImageSource
        As read, (lines, columns): neither resampled nor filtered, which would take noise away.
    dark : DarkNoise, optional
        Of frames without light.
    dark_level : float, optional
        DN; in their place, of all columns. By default 0.

    Raises
    ------
    EstimationError
        If the image is too small or its scene leaves no room for noise.
    """
    _must_be_large(image)
    found = look_through(image)
    columns = image.shape[1]
    share = found.cut / (image.shape[0] * columns)
    if share > MOST_CLIPPED:
        raise EstimationError(
            f"{100.0 * share:.3g} % of its pixels are cut off, at {found.ends} DN, and show no noise: leave "
            "it out"
        )
    level = dark.level if dark is not None else np.full(columns, dark_level or 0.0)
    if len(level) != columns:
        raise InputError(f"frames without light have {len(level)} columns, the image {columns}; give its own")
    chunks = ((part, found.usable(raw) - level) for part, raw in chunks_of(image))
    means, blocks = _means_and_blocks(chunks, found.step, columns)
    white = white_noise(blocks) if shows_texture(blocks) else even_noise(blocks)
    pattern = pattern_of_parts(means)
    warnings = list(dark.warnings) if dark is not None else []
    if dark is None and dark_level is None:
        warnings.append(
            f"{name}: the level without light is taken for 0 DN; give frames without light (--dark) or that "
            "level (--dark-level), or signals are too large, and gains and shot noise too small"
        )
    if share > CLIPPED_SHARE:
        warnings.append(
            f"{name}: {100.0 * share:.2g} % of the pixels are cut off, at {found.ends} DN, and left out"
        )
    flags = (DEAD * found.dead + OFFSET_UNKNOWN * (dark is None)).astype(np.uint8)
    at = f"image noise at {white.signal:.4g} DN"
    finer = f"common to the image, < {SMOOTH} columns wide"
    return ImageNoise(
        name,
        law_rows(white, None),
        white,
        pattern,
        level,
        flags,
        None,
        float(np.nanmedian(means)),
        float(found.high - level[~found.dead].mean()) if np.isfinite(found.high) else None,
        (
            measured_figure(at, "DN^2", white.variance, "high differences, no texture"),
            bounded_figure(
                "image noise", "DN^2", "<=", white.bound.upper(), "high differences as they stand"
            ),
            measured_figure("its slope with signal", "DN", white.slope, "over the signals of the scene"),
            measured_figure("column pattern A_col", "1", pattern.variance, finer),
        ),
        tuple(warnings),
    )


@makes_result
def detector_noise(
    images: Sequence[ImageNoise],
    dark: DarkNoise | None = None,
    *,
    stages: int = 1,
    electrons_per_dn: float | None = None,
    transfer: PhotonTransfer | None = None,
) -> DetectorNoise:
    """The law and the columns that images of one detector show together.

    Parameters
    ----------
    images : sequence of ImageNoise
    dark : DarkNoise, optional
        Of frames without light, where `images` are plain.
    stages : int
        That were summed, as charge that is read once.
    electrons_per_dn : float, optional
        The conversion gain, from somewhere else. Without it the law is in DN.
    transfer : PhotonTransfer, optional
        Where `images` are exposures of even light: it measures A, B, C^2, columns and conversion.

    Raises
    ------
    InputError
        If images have different numbers of columns, or a number is impossible.
    EstimationError
        If the images show no noise that grows with the signal.
    """
    columns = {len(one.level) for one in images}
    if len(columns) != 1:
        raise InputError(f"images of {sorted(columns)} columns are not of one detector; give one at a time")
    if stages < 1 or not (electrons_per_dn is None or 0.0 < electrons_per_dn < np.inf):
        raise InputError(f"{stages} stages and {electrons_per_dn} electrons per DN; both are above 0")
    given = electrons_per_dn
    if transfer is None:
        gain_noise, shot, rest = _law(images, dark)
        pattern = _weighted([one.columns.variance for one in images])
    else:
        gain_noise, shot, rest, pattern = transfer.pixels, transfer.shot, transfer.rest, transfer.columns
        electrons_per_dn = 1.0 / shot.value if given is None else given
    unit, scale = ("DN", 1.0) if electrons_per_dn is None else ("e-", electrons_per_dn)
    of = "image" if transfer is None else "exposure"
    how = f"all of {len(images)} {of}{'s' if len(images) > 1 else ''} and what stands beside"
    conversion = Estimate(1.0 / shot.value, shot.sigma / shot.value**2)
    warnings = [said for one in images for said in one.warnings]
    known = rest is not None
    if rest is None:
        rest, at_rest = Estimate(0.0, 0.0), "if there is no other noise"
        of_law = [
            bounded_figure("B", "DN", "<=", shot.upper(), at_rest),
            bounded_figure("conversion gain 1 / B", "e-/DN", ">=", 1.0 / shot.upper(), at_rest),
        ]
        warnings.append(
            "all of the noise is taken for shot noise: images of one signal do not part it from read noise; "
            "give frames without light (--dark), or images of other signals"
        )
    else:
        of_law = [
            measured_figure("B", "DN", shot, how),
            measured_figure(
                "conversion gain 1 / B", "e-/DN", conversion, "if shot noise is that of electrons"
            ),
            measured_figure("C^2 of the sum", "DN^2", rest, how),
        ]
    figures = [
        *(transfer.figures if transfer is not None else ()),
        *(dark.figures if dark is not None else ()),
        _gain_bound(images, rest)
        if gain_noise is None
        else measured_figure("A of the sum", "1", gain_noise, how),
        *of_law,
        measured_figure("A_col", "1", pattern, f"columns, finer than {SMOOTH} of them"),
    ]
    gain = max(gain_noise.value, 0.0) if gain_noise is not None else 0.0
    if given is not None:
        apart = abs(shot.value - 1.0 / scale)
        # where B is a bound, a larger conversion gain contradicts nothing
        if apart > CONTRADICTS * shot.sigma and (known or 1.0 / scale > shot.value):
            warnings.append(
                f"{scale:g} electrons per DN are given; the noise of the images asks for "
                f"{conversion.value:.4g} +- {conversion.sigma:.2g}"
            )
        if gain_noise is None:  # what is left of the noise when shot noise is what the conversion makes it
            gain = float(np.mean([_gain_left(one.white, rest, 1.0 / scale) for one in images]))
    darks = [one.dark_signal for one in images if one.dark_signal is not None]
    dark_current = max(float(np.mean([one.upper() for one in darks])), 0.0) if darks else 0.0
    law = NoiseLaw(
        gain=stages * gain,
        shot=shot.value if electrons_per_dn is None else 1.0,
        # its noise: of electrons, their number
        dark=dark_current * (shot.value if electrons_per_dn is None else scale) / stages,
        output=float(np.sqrt(max(rest.value, 0.0))) * scale,
        column_fixed=max(pattern.value, 0.0),
    )
    ceilings = [one.ceiling for one in images if one.ceiling is not None]
    top = min(ceilings) if ceilings else None
    least = 0.1 * min(one.median for one in images)
    most = top if top is not None else 2.0 * max(one.median for one in images)
    if not 0.0 < least < most:
        raise EstimationError(
            f"the images have a median signal of {10.0 * least:.4g} DN above the level without light; light "
            "is needed to see noise that grows with it: check the dark level"
        )
    return DetectorNoise(
        law,
        unit,
        stages,
        electrons_per_dn,
        *_columns(images),
        signals=(least * scale / stages, most * scale / stages),
        full_well_sum=None if top is None else top * scale,
        figures=tuple(figures),
        images=tuple(images),
        warnings=tuple(dict.fromkeys(warnings)),
        transfer=transfer,
    )


def _law(
    images: Sequence[ImageNoise], dark: DarkNoise | None
) -> tuple[Estimate | None, Estimate, Estimate | None]:
    """A, B and C^2 of the sum, DN; None where A, or C^2 too, cannot be separated from B."""
    parts = [one.rows for one in images]
    if dark is not None and dark.resting is not None:
        read = dark.resting
        variance = np.array([[(2.0 * read.value * read.sigma) ** 2]])
        parts.append(LawRows(np.array([[0.0, 0.0, 1.0]]), np.array([read.value**2]), variance))
    rows, values = np.concatenate([p.rows for p in parts]), np.concatenate([p.values for p in parts])
    covariance = np.zeros((len(values), len(values)))
    at = 0
    for part in parts:
        here = slice(at, at + len(part.values))
        covariance[here, here] = part.covariance
        at = here.stop
    for terms in ((0, 1, 2), (1, 2), (1,)):
        try:
            fit = fit_law(rows[:, terms], values, covariance)
        except EstimationError:
            continue
        found = {term: fit.estimate(place) for place, term in enumerate(terms)}
        shot = found[1]
        if min(one.value for one in found.values()) >= 0.0 and shot.sigma <= KNOWN * shot.value:
            return found.get(0), shot, found.get(2)
    raise EstimationError(
        "the images show no noise that grows with their signal: give images of other signals, frames without "
        "light, or a brighter scene; images that were resampled or compressed have lost theirs"
    )


def _gain_left(white: WhiteNoise, rest: Estimate, shot: float) -> float:
    """Largest A of the sum (2 sigma) where B is `shot`."""
    return max(white.bound.upper() - rest.value - shot * white.signal, 0.0) / white.signal**2


def _gain_bound(images: Sequence[ImageNoise], rest: Estimate) -> NoiseFigure:
    least = min(_gain_left(one.white, rest, 0.0) for one in images)
    return bounded_figure("A of the sum", "1", "<=", least, "image noise if there is no shot noise")


def _weighted(estimates: Sequence[Estimate]) -> Estimate:
    """Mean by inverse variances."""
    weight = np.array([1.0 / one.sigma**2 for one in estimates])
    values = np.array([one.value for one in estimates])
    return Estimate(float(weight @ values / weight.sum()), float(weight.sum() ** -0.5))


def _columns(images: Sequence[ImageNoise]) -> tuple[Array, Array, Flags]:
    """Gain, offset and flags of every column."""
    patterns = np.array([one.columns.pattern for one in images])
    known = np.isfinite(patterns)
    weights = np.array([[one.weight] for one in images])
    count = (known * weights).sum(axis=0)
    total = np.where(known, weights * patterns, 0.0).sum(axis=0)
    pattern = np.divide(total, count, out=np.zeros(patterns.shape[1]), where=count > 0)
    flags = np.bitwise_or.reduce([one.flags for one in images])
    unknown = (count == 0) | (flags & DEAD != 0)
    flags |= np.where(unknown, GAIN_UNKNOWN, 0).astype(np.uint8)
    usual = pattern[~unknown]
    sigma = robust_sigma(usual - np.median(usual)) if len(usual) else 0.0
    departs = ~unknown & (np.abs(pattern) > OUTLIER_SIGMAS * sigma) & (sigma > 0.0)
    flags |= np.where(departs, OUTLYING, 0).astype(np.uint8)
    gain = np.where(unknown, 1.0, 1.0 + pattern)
    return gain, np.mean([one.level for one in images], axis=0), flags


def _must_be_large(image: ImageSource) -> None:
    """Refuse what is too small for any estimate."""
    lines, columns = image.shape
    least = max(2 * BLOCK + 2 * ORDER, 4 * PARTS), max(2 * BLOCK + 2 * ORDER, 2 * SMOOTH)
    if lines < least[0] or columns < least[1]:
        raise EstimationError(
            f"{lines} lines x {columns} columns are too few to separate noise from a scene; {least[0]} x "
            f"{least[1]} at the least are needed, and some 500 x 500 to know it well"
        )


def _ranges(image: ImageSource) -> list[range]:
    """Lines of an image in `PARTS` parts."""
    ends = np.linspace(0, image.shape[0], PARTS + 1).round().astype(int).tolist()
    return [range(a, b) for a, b in pairwise(ends)]


def chunks_of(image: ImageSource) -> Iterator[tuple[int, Array]]:
    """Some lines of an image after the other, with the number of their part; NaN where not to be used."""
    size = max(AT_ONCE // image.shape[1], 2 * BLOCK + 2 * ORDER)
    for number, part in enumerate(_ranges(image)):
        for first in range(part.start, part.stop, size):
            yield number, usable_lines(image, first, min(first + size, part.stop))


def _means_and_blocks(chunks: Iterable[tuple[int, Array]], step: float, columns: int) -> tuple[Array, Blocks]:
    """Mean of each column in each part (parts, columns), and the squares of all lines together."""
    total, count = np.zeros((PARTS, columns)), np.zeros((PARTS, columns))
    blocks, waiting = [], list[Array]()
    for part, values in chunks:
        known = np.isfinite(values)
        count[part] += known.sum(axis=0)
        total[part] += np.where(known, values, 0.0).sum(axis=0)
        waiting.append(values)
        # of too few lines no square is whole
        if sum(map(len, waiting)) >= 2 * BLOCK + 2 * ORDER:
            lines = np.concatenate(waiting)
            blocks.append(measure_blocks(lines, np.full(lines.shape, step**2 / 12.0)))
            waiting = []
    means = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    names = [field.name for field in fields(Blocks)]
    return means, Blocks(*(np.concatenate([getattr(b, name) for b in blocks]) for name in names))


@dataclass(frozen=True, eq=False)
class PixelValues:
    """What the values of an image are like.

    Attributes
    ----------
    low, high : float
        At which pixels are cut off, infinite where they are not.
    step : float
        Between neighbouring values; 0 where they are no whole numbers.
    dead : (columns,) bool
        Columns that never change.
    cut : int
        Pixels that are cut off.
    """

    low: float
    high: float
    step: float
    dead: NDArray[np.bool_]
    cut: int

    @property
    def ends(self) -> str:
        """Where pixels are cut off, in words."""
        return " and ".join(f"{end:g}" for end in (self.low, self.high) if np.isfinite(end))

    def usable(self, values: Array) -> Array:
        """The values, NaN where a pixel is cut off or its column dead."""
        return np.where((values > self.low) & (values < self.high) & ~self.dead, values, np.nan)


def look_through(image: ImageSource) -> PixelValues:
    """Look through an image, part after part."""
    lines, columns = image.shape
    least, most = np.full(columns, np.inf), np.full(columns, -np.inf)
    histogram: Counter[float] = Counter()
    whole = True
    for _, values in chunks_of(image):
        least = np.fmin(least, np.fmin.reduce(values))
        most = np.fmax(most, np.fmax.reduce(values))
        known = values[np.isfinite(values)]
        whole = whole and bool((known == np.round(known)).all())
        if whole:
            found, counts = np.unique(known, return_counts=True)
            histogram.update(dict(zip(found.tolist(), counts.tolist(), strict=True)))
    dead = ~(most > least)
    if dead.all():
        raise EstimationError("no column has values that change: nothing shows its noise")
    if not whole:
        return PixelValues(-np.inf, np.inf, 0.0, dead, 0)
    if dead.mean() <= MOST_DEAD:
        for value in least[dead & np.isfinite(least)].tolist():
            histogram[value] -= lines  # a dead column is no pile of cut pixels
    values = np.array(sorted(value for value, count in histogram.items() if count > 0))
    counts = np.array([histogram[value] for value in values.tolist()])
    enough = CLIPPED_SHARE * counts.sum()
    bottom = counts[0] > max(enough, PILED * counts[1])
    top = counts[-1] > max(enough, PILED * counts[-2])
    return PixelValues(
        float(values[0]) if bottom else -np.inf,
        float(values[-1]) if top else np.inf,
        float(np.diff(values).min()),
        dead,
        int(counts[0] * bottom + counts[-1] * top),
    )


def pattern_of_parts(means: Array) -> ColumnPattern:
    """Pattern of columns from means (parts, columns), NaN where a column has none.

    A column that stands out would bend the parabola that its neighbours are judged by: it is left out of it.
    """
    usable = np.asarray(np.isfinite(means).all(axis=0))
    usual = usable.copy()
    while True:
        filled = _filled(means, usual)
        found = pattern_of_means(filled)
        size = np.where(usual, np.abs(np.nan_to_num(found.pattern)), 0.0)
        sigma = robust_sigma(size[usual])
        # the shadow of a larger one beside it is none itself
        out = (size > OUTLIER_SIGMAS * sigma) & (size == maximum_filter1d(size, SMOOTH))
        if sigma == 0.0 or not out.any():
            break
        usual &= ~out
    own = (means / filled).mean(axis=0) - 1.0 + np.nan_to_num(found.pattern)
    return replace(found, pattern=np.where(usual, found.pattern, np.where(usable, own, np.nan)))


def _filled(means: Array, usable: NDArray[np.bool_]) -> Array:
    """Means with columns that are not to be used by their neighbours."""
    if usable.all():
        return means
    places = np.flatnonzero(usable)
    if len(places) < SMOOTH:
        raise EstimationError(
            f"{len(places)} of {len(usable)} columns have values that change; others are dead"
        )
    every = np.arange(len(usable))
    return np.array([np.interp(every, places, row[places]) for row in means])
