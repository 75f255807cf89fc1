"""A SEQUENCE.toml in plain words: what was understood, what is missing, what will be observable.

Not here: reading the file (``load.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.surface import Ellipsoid, Plane
from sightline.io.camera_schema import field_degrees
from sightline.io.formats.instants import epoch_words
from sightline.io.sequence.load import FrameSequence
from sightline.io.sequence.outlook import cadence_words, map_words, overlap_words, program_words
from sightline.io.whereabouts import flight_words
from sightline.photogrammetry.flight.problem import SequenceProblem, seen_ground

Array = NDArray[np.float64]

#: Frames that are named in a message.
LISTED = 5


def describe_sequence(sequence: FrameSequence) -> dict[str, Any]:
    """A sequence in words: ``understood``, ``missing``, ``observable``, lists of sentences."""
    problem = sequence.problem
    return {
        "understood": _understood(sequence),
        "missing": _missing(sequence) + program_words(sequence),
        "observable": _observable(problem) + ([] if _one_capture(problem) else map_words(sequence)),
        "frames": len(problem),
        "usable": int(problem.usable.sum()),
    }


def _one_capture(problem: SequenceProblem) -> bool:
    """Whether it is a single capture of a rig, whose pose is not sought."""
    return bool(problem.rig) and len(problem) == 1


def frame_spacing(problem: SequenceProblem) -> tuple[Array, float]:
    """By the rough poses: m from frame to frame, over so many that noise hardly counts; m a frame covers."""
    detector = problem.detector
    distance = np.linalg.norm(seen_ground(problem) - problem.images.position, axis=1)
    position, over = problem.images.position, max(1, len(problem) // 8)
    steps = np.linalg.norm(position[over:] - position[:-over], axis=1) / over
    return steps, float(np.nanmedian(distance)) * detector.shape[0] / detector.focal_length_px


def _understood(sequence: FrameSequence) -> list[str]:
    problem = sequence.problem
    lines, columns = problem.detector.shape
    steps, length = frame_spacing(problem)
    said = [
        f"{sequence.name}: {len(problem)} frames of {lines} lines x {columns} columns over "
        f"{np.ptp(problem.t):.6g} s, {int(problem.usable.sum())} of them usable",
        epoch_words(problem.epoch),
        _focal_words(problem),
        *(_rig_words(problem) if problem.rig else [_filter_words(problem)]),
    ]
    known = np.isfinite(problem.known.position).all(axis=1)
    if known.any():
        said.append(f"the first position: {flight_words(problem.images.position[known], problem.radii)}")
    if np.isfinite(problem.known.position).any():
        said.append(
            f"by the rough poses{_over(problem)} a frame covers {length:.4g} m along its lines; a subset of "
            f"{problem.overlap:.0%} overlap "
            f"has a frame every {(1.0 - problem.overlap) * length:.4g} m"
        )
        if len(steps):
            said.append(f"frames are {float(np.median(steps)):.4g} m apart, by the rough positions")
    said += cadence_words(problem)
    if problem.readout_time > 0.0:
        said.append(f"rolling shutter: {problem.readout_time:g} s from the first line to the last")
    for what, sigma, bias, unit in (
        ("positions", problem.known.position, problem.known.position_bias, "m"),
        ("attitudes", problem.known.attitude, problem.known.attitude_bias, "rad"),
    ):
        own = np.isfinite(sigma).all(axis=1)
        if own.any():
            said.append(
                f"{what} of {int(own.sum())} frames, sigma {_sigma_words(sigma[own], unit)}"
                + (f", with a constant error of {bias:.3g} {unit}" if bias else "")
                + (f" ({np.degrees(bias):.3g} degrees)" if bias and unit == "rad" else "")
            )
    if problem.control is not None and problem.control_tracks is not None:
        said.append(f"{len(problem.control.point)} control points, seen {len(problem.control_tracks)} times")
    said += [f"note: {words}" for words in problem.warnings if words not in sequence.doubts]
    return said


def _rig_words(problem: SequenceProblem) -> list[str]:
    """The cameras of a rig, and what is known of how they sit."""
    first = problem.rig[0]
    said = [
        f"a rig of {len(problem.rig)} cameras, one pose per capture, that of the first, {first.name}: a "
        "frame is a capture"
    ]
    for camera in problem.rig:
        nm = ", ".join(f"{value:g} nm" for value in camera.channel_nm or (camera.wavelength_nm,))
        lens, count = camera.detector, int(camera.usable.sum())
        words = (
            f"camera {camera.name}: {nm if 'nan' not in nm else 'all light'}, {lens.shape[0]} x "
            f"{lens.shape[1]} px, focal length {lens.focal_length_px:.6g} px, {count} of {len(problem)} "
            "images usable"
        )
        if camera is not first:
            turn = ", ".join(f"{v:.3g}" for v in np.degrees(camera.orientation.as_rotvec()))
            place = ", ".join(f"{1e3 * v:.3g}" for v in camera.position)
            words += (
                f"; turned by {turn} degrees to {np.degrees(camera.orientation_sigma):.2g} ({camera.prior}), "
                f"at {place} mm to {1e3 * float(camera.position_sigma.max()):.2g} from the first"
            )
        said.append(words)
    return said


def _sigma_words(sigma: Array, unit: str) -> str:
    """Usual sigma of each axis (n, 3) m or rad, once where they are alike."""
    usual = [f"{value:.3g}" for value in np.median(sigma, axis=0)]
    axes = ("x", "y", "z") if unit == "m" else ("roll", "pitch", "yaw")
    degrees = [f"{value:.3g}" for value in np.degrees(np.median(sigma, axis=0))]

    def each(values: list[str], unit: str) -> str:
        if len(set(values)) == 1:
            return f"{values[0]} {unit}"
        return ", ".join(f"{axis} {value}" for axis, value in zip(axes, values, strict=True)) + f" {unit}"

    return each(usual, unit) + (f" ({each(degrees, 'degrees')})" if unit == "rad" else "")


def _over(problem: SequenceProblem) -> str:
    """The height of ground that is a start only."""
    if not isinstance(problem.surface, Plane | Ellipsoid) or problem.height_sigma > 0.0:
        return ""
    return f", over ground at {problem.surface.height:g} m,"


def _focal_words(problem: SequenceProblem) -> str:
    """The focal length, and whether it is found with the poses."""
    sigma, view = problem.focal_length_sigma_px, field_degrees(problem.detector)
    said = (
        f"focal length {problem.detector.focal_length_px:.6g} px (a field of view of {view[0]:.3g} degrees "
        f"along x {view[1]:.3g} across)"
    )
    if not sigma > 0.0:
        return f"{said}, kept as given"
    known = f"+- {sigma:.3g} px" if np.isfinite(sigma) else "to start from"
    return f"{said} {known}: it is found with the poses"


def _filter_words(problem: SequenceProblem) -> str:
    wavelength = problem.detector.wavelength_nm
    if wavelength is not None:
        bands = len(np.unique(wavelength))
        ends = f"{wavelength.min():.4g} to {wavelength.max():.4g} nm"
        return f"filter: {bands} wavelengths along the lines, {ends}"
    if problem.mosaic_nm is not None:
        rows, columns = problem.mosaic_nm.shape
        return f"filter: a mosaic of {rows} x {columns}"
    if problem.channel_nm and np.isnan(problem.channel_nm).any():
        return f"no filter said: {len(problem.channel_nm)} bands in each image (channel_nm names them)"
    if problem.channel_nm:
        names = ", ".join(f"{nm:g} nm" for nm in problem.channel_nm)
        return f"filter: {names} in the bands of each image"
    return "no filter: panchromatic"


def _missing(sequence: FrameSequence) -> list[str]:
    problem = sequence.problem
    lost = np.flatnonzero(~problem.usable)
    said = [f"suspicious: {words}" for words in sequence.doubts]
    said += [f"frame {problem.frames[k]}: {problem.excluded[k]}" for k in lost[:LISTED]]
    if len(lost) > LISTED:
        said.append(f"and {len(lost) - LISTED} more frames that cannot be used")
    for camera in problem.rig[1:]:
        lacking = [(k, why) for k, why in enumerate(camera.excluded) if why]
        said += [f"camera {camera.name}, {problem.frames[k]}: {why}" for k, why in lacking[:LISTED]]
    if problem.usable.sum() == 1 and not problem.rig:
        said.append("frames: the pose of one alone is not observable; two or more that overlap are needed")
    if _one_capture(problem):
        return said
    if not np.isfinite(problem.known.attitude).any() and np.isfinite(problem.known.position).all(1).sum() < 3:
        said.append("positions of three frames or more: without attitudes they bring a model to the world")
    if not np.isfinite(problem.known.attitude).any():
        said.append(
            "attitudes: none; georeference will begin with a model by pycolmap (extra sfm), and a bow of the "
            "strip is estimated from positions and control points alone"
        )
    if problem.height_sigma <= 0.0:
        said.append(
            "[surface] height_sigma: heights of the ground are a start only"
            + (
                f"; they are {problem.surface.height:g} m"
                if isinstance(problem.surface, Plane | Ellipsoid)
                else ""
            )
            + "; ground known to height_sigma (or a dem) would give heights, tilts and the scale better"
        )
    return said


def _observable(problem: SequenceProblem) -> list[str]:
    said = ["place, size and direction of the whole: by " + _datum_words(problem)]
    if problem.rig:
        said.append(
            "offsets of the cameras: angles from windows that the bands share; lever arms over ground with "
            "relief alone, else as given"
        )
    if _one_capture(problem):
        return [*said[1:], "bands laid on the first camera (registered.tif); the pose is that of the tables"]
    if problem.focal_length_sigma_px > 0.0:
        said.append(_focal_observable(problem))
    return said + overlap_words(problem)


def _focal_observable(problem: SequenceProblem) -> str:
    """What will make the focal length observable: mostly the flying height above a ground that is known."""
    known = problem.known
    heights = np.isfinite(known.position[:, 2]).any() or problem.control is not None
    if not (heights and (problem.height_sigma > 0.0 or problem.control is not None)):
        return (
            "focal length: hardly observable: heights of positions and of the ground ([surface] "
            "height_sigma), or control points, are needed; it goes with the flying height otherwise"
        )
    return "focal length: as well as the flying height above the ground is known, or by control points"


def _datum_words(problem: SequenceProblem) -> str:
    words = []
    if np.isfinite(problem.known.position).any():
        words.append("positions")
    if np.isfinite(problem.known.attitude).any():
        words.append("attitudes")
    if problem.control is not None:
        words.append("control points")
    return ", ".join(words)
