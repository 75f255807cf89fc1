"""``[[camera.strip]]`` → every strip of every frame as an image with a camera of its own.

Strips are filters in front of one chip: they share time, attitude and lens of the frame, and each has its
place on the chip, counted from the optical axis.

Not here: whole frames (``frames.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from sightline.errors import FormatError
from sightline.imaging.part import ImageLines
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.schema import AcquisitionFile, SpinPlatform, StripSection
from sightline.motion.band import ChipKnowledge, Frame
from sightline.motion.spin.solve import AttitudeSigma


def cut_into_strips(
    config: AcquisitionFile, frames: Sequence[Frame], files: InputFolder
) -> tuple[Frame, ...]:
    """All strips of all frames, frame by frame.

    Parameters
    ----------
    config : AcquisitionFile
    frames : sequence of Frame
        Whole.
    files : InputFolder
        Names the TOML file in messages.

    Raises
    ------
    FormatError
        If a strip reaches beyond the frame, or two share lines.
    """
    strips = config.camera.strip
    _check_lines(strips, frames[0].image.shape[0], files)
    return tuple(_part(frame, strip, number) for frame in frames for number, strip in enumerate(strips))


def _check_lines(strips: Sequence[StripSection], lines: int, files: InputFolder) -> None:
    """Strips lie in the frame, apart from each other."""
    place = f"{files.toml}: [[camera.strip]]"
    for strip in strips:
        if strip.first_line + strip.lines > lines:
            raise FormatError(
                f"{place} {strip.name!r} ends at line {strip.first_line + strip.lines}, a frame has {lines} "
                "lines; check first_line and lines"
            )
    ordered = sorted(strips, key=lambda strip: strip.first_line)
    for one, other in pairwise(ordered):
        if one.first_line + one.lines > other.first_line:
            raise FormatError(
                f"{place} {one.name!r} and {other.name!r} share lines from {other.first_line} on; check "
                "first_line and lines"
            )


def _part(frame: Frame, strip: StripSection, number: int) -> Frame:
    """One strip of a frame."""
    detector = frame.camera.detector
    line, column = detector.principal_point_px
    axis_line = line - strip.first_line if strip.axis_line is None else strip.axis_line
    cut = replace(
        detector,
        name=strip.name,
        shape=(strip.lines, detector.shape[1]),
        principal_point_px=(axis_line, column),
    )
    return replace(
        frame,
        name=f"{frame.name} {strip.name}",
        image=ImageLines(frame.image, strip.first_line, strip.lines),
        camera=frame.camera.with_detector(cut),
        strip=number,
    )


def chip_knowledge(config: AcquisitionFile) -> ChipKnowledge:
    """How well the strips are known; a frame without strips is one strip that is known."""
    strips = config.camera.strip
    if not strips:
        return ChipKnowledge(("frame",), 0.0, (0.0,), (0.0,), (0.0,))
    return ChipKnowledge(
        tuple(strip.name for strip in strips),
        config.camera.common_line_sigma_px,
        tuple(strip.axis_line_sigma_px for strip in strips),
        tuple(strip.scale_sigma for strip in strips),
        tuple(strip.height_sigma for strip in strips),
    )


def attitude_sigma(config: AcquisitionFile) -> AttitudeSigma | None:
    """How well the attitude of a spinning body is known; None for other platforms."""
    platform = config.platform
    if not isinstance(platform, SpinPlatform):
        return None
    about = platform.attitude_turn_sigma
    return AttitudeSigma(platform.attitude_sigma, platform.attitude_sigma if about is None else about)
