"""An INSTRUMENT.toml as a FocalPlane, and in words: units in px and s, defaults filled in.

Not here: keys and allowed values (``schema.py``).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.focal_plane import FocalPlane, NamedLayout
from sightline.errors import FormatError, InputError
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.io.acquisition.acquired import input_files
from sightline.io.config import read_toml, validate
from sightline.io.layout.schema import InstrumentFile, LayoutSection, PriorSection
from sightline.motion.layout.information import (
    MOST_PERIODS,
    blind_frequencies_of,
    common_lags,
    listed_up_to,
)
from sightline.motion.layout.search import check_room
from sightline.result import set_source

#: Relative bandwidth of a tone that gives none.
_BANDWIDTH = 0.01
#: Blind frequencies, and groups of lags that share one, named of a layout.
_NAMED = 6
#: Focal lengths from the first to the last detector beyond which a layout is doubted: 62 degrees.
_WIDE = 1.2
#: Synchronism of ground and lines below which nothing is said of it.
_SYNCHRONOUS = 0.05


def load_instrument(path: str | Path) -> FocalPlane:
    """The instrument of an INSTRUMENT.toml.

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed; also where the detectors do not fit into their span.
    """
    path = Path(path)
    file = validate(InstrumentFile, read_toml(path), path)
    with input_files(path, file):
        plane = _instrument(path, file)
    set_source(plane, path)
    return plane


def _instrument(path: Path, file: InstrumentFile) -> FocalPlane:
    """What the file says."""
    rate = 1.0 / file.line_period if file.ground_rate_px is None else file.ground_rate_px
    lines = np.arange(float(file.lines)) if isinstance(file.lines, int) else file.lines
    if lines is not None:
        lines = np.sort(np.asarray(lines, dtype=np.float64))
        span = float(np.ptp(lines))
    else:
        span = file.span_px if file.span_px is not None else (file.span_s or 0.0) * rate
    plane = FocalPlane(
        focal_length_px=file.focal_length_px,
        line_period=file.line_period,
        ground_rate_px=rate,
        image_sigma_px=_image_sigma(file),
        span_px=span,
        min_spacing_px=file.min_spacing_px,
        step_px=file.step_px,
        lines=lines,
        window_lines=file.window_lines,
        step_lines=file.step_lines,
        stages=_stages(file),
        prior=Spectrum(tuple(_component(part) for part in file.prior)) if file.prior else None,
        duration=file.duration,
        layouts=tuple(_named(entry, rate) for entry in file.layout),
        name=file.name,
    )
    try:
        check_room(plane.candidates(0.5 * plane.row_rate), plane.detectors)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None
    return plane


def _image_sigma(file: InstrumentFile) -> tuple[float, ...]:
    """Error of each image: what is given, or an equal part of a match's variance."""
    if file.image_sigma_px is not None:
        return tuple(file.image_sigma_px)
    each = (file.match_sigma_px or 0.0) / math.sqrt(2.0)
    return (each,) * (file.detectors or 0)


def _stages(file: InstrumentFile) -> tuple[int, ...]:
    """TDI stages of each image; empty without TDI."""
    if file.stages is None:
        return ()
    return tuple(file.stages) if isinstance(file.stages, list) else (file.stages,) * len(_image_sigma(file))


def _component(part: PriorSection) -> Matern | Tone:
    """One part of the prior."""
    if part.kind == "tone":
        frequency = part.frequency or 0.0
        return Tone(part.sigma_px, frequency, part.bandwidth or _BANDWIDTH * frequency)
    unit = Matern(part.sigma_px, 1.0, part.order or "3/2")
    timescale = part.timescale if part.timescale is not None else unit.corner / (part.corner or 1.0)
    return Matern(part.sigma_px, timescale, unit.order)


def _named(entry: LayoutSection, rate: float) -> NamedLayout:
    """A layout of the user's, in s from its first detector."""
    if entry.positions_px is not None:
        positions = np.asarray(entry.positions_px, dtype=np.float64) / rate
    else:
        positions = np.asarray(entry.positions_s, dtype=np.float64)
    return NamedLayout(entry.name, positions - positions.min())


def describe_instrument(plane: FocalPlane) -> dict[str, Any]:
    """An instrument in words: ``understood``, ``missing``, ``observable``, lists of sentences."""
    return {
        "understood": _understood(plane),
        "missing": _missing(plane),
        "observable": _observable(plane),
        "highest_frequency": 0.5 * plane.row_rate,
    }


def _understood(plane: FocalPlane) -> list[str]:
    sigma = ", ".join(f"{value:.4g}" for value in dict.fromkeys(plane.image_sigma_px))
    rate = plane.ground_rate_px
    lines = [
        f"{plane.name}: {plane.detectors} detectors, one pixel is {1e6 / plane.focal_length_px:.4g} urad",
        f"the ground crosses {rate:.6g} px a second: 1 px of separation is {1e3 / rate:.4g} ms of lag",
        f"each image is placed to {sigma} px by a row of windows, every {1e3 / plane.row_rate:.4g} ms",
    ]
    if plane.lines is not None:
        lines.append(f"{len(plane.lines)} lines of one detector to choose from, over {plane.span_px:.6g} px")
    else:
        step = "any place" if plane.step_px is None else f"multiples of {plane.step_px:g} px"
        lines.append(
            f"within {plane.span_px:.6g} px ({1e3 * plane.span_px / rate:.5g} ms), "
            f"{plane.min_spacing_px:g} px apart at least; {step} will do"
        )
    if plane.prior is not None:
        lines.append(
            f"prior of the motion: {len(plane.prior.components)} parts, {plane.prior.sigma:.3g} px in all"
        )
    return lines


def _missing(plane: FocalPlane) -> list[str]:
    lines = []
    if plane.prior is None:
        lines.append("[[prior]]: sigmas will be for a drift and a broadband jitter that nobody asked for")
    if not plane.layouts:
        lines.append("[[layout]]: a layout of your own to compare with")
    for own in plane.layouts:
        span = float(np.ptp(own.positions)) * plane.ground_rate_px
        if span > _WIDE * plane.focal_length_px:
            view = 2.0 * math.degrees(math.atan(0.5 * span / plane.focal_length_px))
            lines.append(
                f"suspicious: {own.name} spans {span:.6g} px, {view:.3g} degrees by focal_length_px = "
                f"{plane.focal_length_px:.6g}: are its positions, and ground_rate_px, right?"
            )
    synchronism = plane.ground_rate_px * plane.line_period
    if abs(synchronism - 1.0) > _SYNCHRONOUS:
        lines.append(
            f"synchronism: the ground moves {synchronism:.3g} px in a line period; is ground_rate_px right?"
        )
    return lines


def _observable(plane: FocalPlane) -> list[str]:
    upper = 0.5 * plane.row_rate
    lines = [f"rows of windows sample motion up to {upper:.5g} Hz: the pass-band must end below"]
    counts = sorted({count for count in plane.stages if count > 1})
    if counts:
        first = ", ".join(f"{1.0 / (count * plane.line_period):.5g}" for count in counts)
        said = ", ".join(map(str, counts))
        lines.append(f"TDI of {said} stages averages motion away at {first} Hz and its multiples")
    most = MOST_PERIODS // max(len(plane.layouts), 1)
    for own in plane.layouts:
        listed = listed_up_to(own.positions, upper, most)
        reach = f" up to {listed:.4g} Hz" if listed < upper else ""
        tdi = plane.noise_of(len(own.positions)).tdi
        blind = [f"{b.frequency:.4g}" for b in blind_frequencies_of(own.positions, listed, tdi)]
        named = ", ".join(blind[:_NAMED]) + (", ..." if len(blind) > _NAMED else "")
        lines.append(
            f"{own.name}: all pairs blind at {named} Hz" if blind else f"{own.name}: nowhere blind{reach}"
        )
        several = [common for common in common_lags(own.positions, listed) if len(common.pairs) > 2]
        for common in several[:_NAMED]:
            ratio = " : ".join(str(p) for p in common.periods)
            lines.append(
                f"{own.name}: {len(common.pairs)} lags as {ratio}, blind at {common.frequency:.4g} Hz"
            )
        if len(several) > _NAMED:
            lines.append(f"{own.name}: and {len(several) - _NAMED} more such frequencies")
    return lines
