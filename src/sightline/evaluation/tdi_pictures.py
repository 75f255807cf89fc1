"""What a choice of TDI settings does to images: a target as columns of the detector image it, and measured.

Each crop is a narrow group of columns that move and are set as one column of the choice, once by its own
setting and once by that of the centre column. MTF is measured on slanted edges and SNR on a flat patch, as on
any image; what the closed forms predict stands beside them.

Not here: the imaging (``simulate/tdi_strip.py``), pages (``report/tdi_page.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.evaluation.slanted_edge import slanted_edge_mtf
from sightline.imaging.mtf import aperture_mtf, diffusion_mtf
from sightline.imaging.tdi_noise import snr
from sightline.imaging.tdi_transfer import drift_transfer
from sightline.simulate.tdi_strip import FineScene, StripSettings, exposed_stages, one_setting, read_strip
from sightline.simulate.tdi_target import (
    EDGE_ACROSS,
    EDGE_ALONG,
    EDGE_ANGLE,
    FLAT,
    Region,
    ground_scene,
    tdi_target,
)
from sightline.tdi.choose import TdiChoice
from sightline.tdi.setting import TdiDetector

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Pair = tuple[float, float]

#: Pixels left out at the borders of a patch, into which its neighbours are blurred.
INSET = 5
#: Least margin of the target, pixels.
MARGIN = 16
#: Most drift of the scene during all stages, pixels: beyond it nothing is left of the target.
MOST_REACH = 100.0
#: Lines and columns of the miniature of the whole detector line.
MINIATURE = (110, 480)


@dataclass(frozen=True)
class ColumnGroup:
    """Columns that move and are set alike, as wide as a crop.

    Attributes
    ----------
    column : float
        Number in the detector line.
    velocity, slip : float
        Pixels per line period; rad.
    stages : int
    ratio : float
        Integration ratio.
    aperture : (float, float)
        Photosensitive width across and along, pixels.
    blur : (float, float)
        Sigma of the Gaussian of optics and diffusion across and along, pixels.
    """

    column: float
    velocity: float
    slip: float
    stages: int
    ratio: float
    aperture: Pair
    blur: Pair

    @property
    def reach(self) -> float:
        """Pixels that the scene drifts by during all stages, across or along."""
        return self.stages * max(abs(self.velocity * np.tan(self.slip)), abs(self.velocity - 1.0))

    def static_mtf(self, fx: float, fy: float) -> float:
        """MTF of optics, pixel and diffusion at a frequency of two axes."""
        return float(
            np.prod([
                aperture_mtf(f, width) * diffusion_mtf(f, sigma)
                for f, width, sigma in zip((fx, fy), self.aperture, self.blur, strict=True)
            ])
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Quality:
    """MTF across and along, and SNR, of one crop.

    Attributes
    ----------
    mtf, mtf_sigma : (float, float)
        Along columns of pixels across the track and along it; sigma 0 where predicted.
    snr, snr_sigma : float
    """

    mtf: Pair
    mtf_sigma: Pair
    snr: float
    snr_sigma: float


@dataclass(frozen=True, eq=False)
class Crop:
    """The target as one column group images it.

    Attributes
    ----------
    group : ColumnGroup
    radiance : (184, 144)
        Normalised: 1 is the radiance of the flat patch.
    saturated : float
        Share of pixels with a full well.
    measured, predicted : Quality
        The prediction is at the frequencies that the slanted edges show, not quite on the axes.
    """

    group: ColumnGroup
    radiance: Array
    saturated: float
    measured: Quality
    predicted: Quality


@dataclass(frozen=True, eq=False)
class StripPictures:
    """The same target by the chosen settings and by one setting for all.

    Attributes
    ----------
    signal : float
        Electrons of one line, at the reference integration ratio, of the flat patch.
    frequencies : (float, float)
        Cycles per pixel across and along at which MTF is given.
    chosen, single : tuple of Crop
        Same columns in both.
    columns : (480,)
        Numbers, in the detector line, of the columns of the miniature: evenly over the whole line;
        some more than once where there are fewer.
    miniature_chosen, miniature_single : (110, 480)
        Radiance of ground that every one of these columns images as it moves, by its own setting and by one.
    """

    signal: float
    frequencies: Pair
    chosen: tuple[Crop, ...]
    single: tuple[Crop, ...]
    columns: Array
    miniature_chosen: Array
    miniature_single: Array


def strip_pictures(
    choice: TdiChoice,
    *,
    aperture: Pair,
    signal: float | None = None,
    places: Sequence[int] | None = None,
    seed: int = 0,
) -> StripPictures:
    """Image the target by the chosen settings and by that of the centre column.

    Parameters
    ----------
    choice : TdiChoice
        Its columns drift; what else moves is not imaged.
    aperture : (float, float)
        Photosensitive width across and along, pixels. The rest of the columns' static MTF is imaged as a
        Gaussian blur that has it at the frequencies of the rules.
    signal : float, optional
        Electrons of the flat patch; that of the choice nearest to it decides the settings. By default the
        middle one of the choice.
    places : sequence of int, optional
        Numbers of columns in the choice; the first, the centre and the last by default.
    seed : int
        Of the ground and the noise.

    Raises
    ------
    InputError
        A static MTF above that of the aperture alone; a target that is blurred, drifts or drowns in noise so
        much that nothing can be measured on it.
    """
    count = len(choice.columns)
    places = sorted({0, count // 2, count - 1}) if places is None else places
    middle = float(choice.signals[len(choice.signals) // 2])
    signal = middle if signal is None else signal
    nearest = int(np.argmin(np.abs(choice.signals - signal)))
    chosen = [column_group(choice, c, c, nearest, aperture) for c in places]
    single = [column_group(choice, c, count // 2, nearest, aperture) for c in places]
    reach = max(group.reach for group in (*chosen, *single))
    if reach > MOST_REACH:
        raise InputError(f"the scene drifts by {reach:.3g} px during all stages, more than {MOST_REACH:g}")
    margin = max(MARGIN, int(np.ceil(reach)) + 4)
    target = tdi_target(seed, margin=margin)
    crops: dict[ColumnGroup, Crop] = {}
    for number, group in enumerate(dict.fromkeys((*chosen, *single))):
        place = int(np.searchsorted(choice.columns.column, group.column))
        detector = choice.detector.of_column(choice.columns, place)
        exposed, settings = exposed_target(target, group, detector)
        strip = read_strip(exposed, settings, detector, signal, np.random.default_rng([seed, number]))
        frequencies = choice.rules.frequencies
        crops[group] = Crop(
            group, strip.radiance, float(strip.saturated.mean()),
            measured_quality(strip.radiance, frequencies),
            predicted_quality(group, detector, signal, frequencies),
        )  # fmt: skip
    which = np.linspace(0, count - 1, MINIATURE[1]).round().astype(np.intp)
    small = [
        _miniature(choice, which, at, nearest, aperture, signal, seed) for at in (which, np.array(count // 2))
    ]
    return StripPictures(
        signal, choice.rules.frequencies, tuple(crops[g] for g in chosen), tuple(crops[g] for g in single),
        np.asarray(choice.columns.column[which], dtype=np.float64), small[0], small[1],
    )  # fmt: skip


def _miniature(
    choice: TdiChoice,
    which: Index,
    setting_of: Index,
    signal_number: int,
    aperture: Pair,
    signal: float,
    seed: int,
) -> Array:
    """Radiance (lines, W) of ground as columns `which` image it, set as columns `setting_of`."""
    columns = choice.columns.part(which)
    setting = choice.setting[setting_of, signal_number]
    settings = StripSettings(
        choice.grid.stages_of(setting), choice.grid.ratio_of(setting), columns.velocity, columns.slip
    )
    drift = np.maximum(np.abs(columns.velocity * np.tan(columns.slip)), np.abs(columns.velocity - 1.0))
    margin = max(MARGIN, int(np.ceil(np.max(settings.stages) * drift.max())) + 4)
    ground = ground_scene((MINIATURE[0], len(which)), seed, margin=margin)
    # optics differ little along a line: one blur for all
    blur = column_group(choice, len(choice.columns) // 2, 0, signal_number, aperture).blur
    exposed = exposed_stages(ground.blurred(blur, aperture), settings, choice.detector)
    radiance = np.empty(exposed.shape[:2])
    for number, (detector, at) in enumerate(choice.detector.by_kind(columns)):
        alike = StripSettings(
            np.broadcast_to(settings.stages, len(which))[at], np.broadcast_to(settings.ratio, len(which))[at],
            columns.velocity[at], columns.slip[at],
        )  # fmt: skip
        noise = np.random.default_rng([seed, 1000 + number])
        radiance[:, at] = read_strip(exposed[:, at], alike, detector, signal, noise).radiance
    return radiance


def column_group(choice: TdiChoice, c: int, setting_of: int, signal: int, aperture: Pair) -> ColumnGroup:
    """Column `c` of a choice with the setting of column `setting_of` at signal number `signal`."""
    columns, blur = choice.columns, []
    for f, width, static in zip(choice.rules.frequencies, aperture, columns.static_mtf[c], strict=True):
        rest = float(static / aperture_mtf(f, width))
        if not 0.0 < rest <= 1.0 + 1e-9:
            raise InputError(
                f"a static MTF of {static:.4g} at {f:g} cycles per pixel is none of an aperture of {width:g} "
                f"px, which alone has {float(aperture_mtf(f, width)):.4g}"
            )
        blur.append(float(np.sqrt(max(-np.log(rest), 0.0) / 2.0) / (np.pi * f)))
    setting = choice.setting[setting_of, signal]
    return ColumnGroup(
        float(columns.column[c]), float(columns.velocity[c]), float(columns.slip[c]),
        int(choice.grid.stages_of(setting)), float(choice.grid.ratio_of(setting)),
        aperture, (blur[0], blur[1]),
    )  # fmt: skip


def exposed_target(
    target: FineScene, group: ColumnGroup, detector: TdiDetector
) -> tuple[Array, StripSettings]:
    """What every stage of a column group collects of the target, and its settings, for `read_strip`."""
    settings = one_setting(target.shape[1], group.stages, group.ratio, group.velocity, group.slip)
    return exposed_stages(target.blurred(group.blur, group.aperture), settings, detector), settings


def measured_quality(radiance: Array, frequencies: Pair) -> Quality:
    """MTF by the slanted edges of an image of the target, SNR by its flat patch."""
    across = slanted_edge_mtf(_patch(radiance, EDGE_ACROSS), frequencies[0])
    along = slanted_edge_mtf(_patch(radiance, EDGE_ALONG).T, frequencies[1])
    return Quality(
        (float(across.mtf[0]), float(along.mtf[0])),
        (float(across.sigma[0]), float(along.sigma[0])),
        *flat_snr(_patch(radiance, FLAT)),
    )


def flat_snr(patch: Array) -> tuple[float, float]:
    """SNR of a flat image (lines, columns) and its 1-sigma; what a column keeps counts as noise."""
    lines, columns = patch.shape
    within = float(patch.var(axis=0, ddof=1).mean())
    of_means = float(patch.mean(axis=0).var(ddof=1))
    # the means of columns scatter by their own noise too
    variance = within * (1.0 - 1.0 / lines) + of_means
    if variance == 0.0:
        return float("inf"), 0.0
    spread = np.hypot(
        within * (1.0 - 1.0 / lines) * np.sqrt(2.0 / (columns * (lines - 1))),
        of_means * np.sqrt(2.0 / (columns - 1)),
    )
    found = float(patch.mean() / np.sqrt(variance))
    return found, 0.5 * found * float(spread) / variance


def predicted_quality(group: ColumnGroup, detector: TdiDetector, signal: float, frequencies: Pair) -> Quality:
    """What the closed forms say the edges and the flat patch show."""
    exposure = detector.exposure
    tilt = float(np.tan(EDGE_ANGLE))
    fx, fy = frequencies
    # lines grow against the motion of the image: hence the sign along
    setting = (group.stages, group.ratio, group.velocity, group.slip)
    mtf = [
        group.static_mtf(x, y) * float(np.abs(drift_transfer(*setting, x, -y, exposure)))
        for x, y in ((fx, fx * tilt), (fy * tilt, fy))
    ]
    expected = snr(signal, group.stages, group.ratio, detector.noise, exposure, detector.reference)
    return Quality((mtf[0], mtf[1]), (0.0, 0.0), float(expected), 0.0)


def _patch(radiance: Array, region: Region) -> Array:
    top, bottom, left, right = region
    return radiance[top + INSET : bottom - INSET, left + INSET : right - INSET]
