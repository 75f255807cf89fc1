"""A recovered line of sight → the files of its folder: what a chain reads, and the summary.

``motion.csv``, ``attitude.csv``, ``attitude.aem``, ``differences.csv``, ``hidden.csv``, ``relief.csv``,
``spectrum.csv``, ``smear.csv``, ``covariance.npz``, ``summary.json``; their columns are described in
``docs/formats.md``.

Not here: the page for people (``report/``).
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.spin_attitude import SpinAttitude
from sightline.evaluation.error_spectrum import error_psd
from sightline.evaluation.observed import observed
from sightline.evaluation.score import less_hidden, remove_directions, words_of_hidden
from sightline.evaluation.tone_errors import judged_tones
from sightline.execution import give_back_memory
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import WGS84
from sightline.geometry.rotations import to_quat_xyzw
from sightline.geometry.surface import Dem, Ellipsoid, Surface
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.acquisition.describe import what_is_doubtful
from sightline.io.formats.ccsds import write_aem
from sightline.io.formats.json_text import json_text
from sightline.io.formats.tables import (
    ANGLES,
    MotionTable,
    write_attitudes,
    write_differences,
    write_motion,
    write_spectrum,
)
from sightline.io.results.hidden import TABLE as HIDDEN_TABLE
from sightline.io.results.hidden import write_hidden
from sightline.io.results.microvibration import microvibration_summary, write_smear
from sightline.io.results.relief import RELIEF, write_relief
from sightline.io.results.spin import spin_summary
from sightline.motion.observability import Passbands
from sightline.motion.results import LineOfSight, PairResiduals
from sightline.motion.tones import DetectedTone, detect_tones, spectrum
from sightline.version import VERSION
from sightline.writing import whole, whole_text

Array = NDArray[np.float64]

#: Every file a recovery may leave in its folder; which of them it does depends on the data.
RESULT_FILES = (
    "attitude.aem", "attitude.csv", "covariance.npz", "differences.csv", "hidden.csv", "motion.csv",
    "relief.csv", "report.html", "smear.csv", "spectrum.csv", "summary.json",
)  # fmt: skip
#: The highest frequency spoken of, in units of the line rate: windows of some lines cut beyond.
HIGHEST_FREQUENCY = 0.25
#: From this probability of chance on a peak is not spoken of.
MERE_CHANCE = 0.5
#: Names of the world axes in CCSDS messages.
AEM_FRAMES = {"earth-fixed": "ITRF", "local": "LOCAL_ENU"}
#: Frequencies at which visibility is evaluated for the ends of the passbands.
_FREQUENCIES = 20_001


def write_result(
    folder: Path, result: LineOfSight, acquisition: Acquisition, *, wall_seconds: float
) -> dict[str, Any]:
    """Write every file of a recovery but the report.

    Parameters
    ----------
    folder : Path
        Exists.
    result : LineOfSight
    acquisition : Acquisition
        What it was recovered from.
    wall_seconds : float
        s; of the whole command so far.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.
    """
    # what was freed lies between what is held: of a long strip it is a good part of what is in memory
    give_back_memory()
    motion = result.motion
    sigmas = result.sigma, result.absolute_sigma
    table = MotionTable(motion.t, motion.angles, *sigmas, result.observed, result.lines)
    write_motion(folder / "motion.csv", table)
    attitude = refined_attitude(result, acquisition)
    write_attitudes(folder / "attitude.csv", motion.t, attitude)
    if acquisition.epoch is not None and not on_another_body(acquisition.surface):
        frame, name = AEM_FRAMES[acquisition.world], acquisition.name.upper()
        write_aem(
            folder / "attitude.aem", motion.t, attitude, acquisition.epoch, object_name=name, frame=frame
        )
    del attitude, table, sigmas
    give_back_memory()
    summary = whole_summary(result, acquisition, wall_seconds=wall_seconds)
    if result.hidden.shape[2]:
        left_out = motion.angles - less_hidden(motion.angles, result.hidden, **_field(result, acquisition))
        write_hidden(folder, motion.t, result.hidden, result.hidden_names, left_out)
        del left_out
    give_back_memory()
    _write_spectrum(folder / "spectrum.csv", result, summary["passbands"])
    if _is_strip(acquisition):
        write_smear(folder / "smear.csv", result, summary["microvibration"])
    if result.differences:
        write_differences(folder / "differences.csv", result.differences, result.image_names)
    give_back_memory()
    if result.relief is not None:
        write_relief(folder / RELIEF, result.relief)
    if result.band is not None:
        _write_covariance(folder / "covariance.npz", result)
    write_json(folder / "summary.json", summary)
    return summary


def whole_summary(result: LineOfSight, acquisition: Acquisition, *, wall_seconds: float) -> dict[str, Any]:
    """All of ``summary.json``: `summarize`, with what the spin and the hidden directions are."""
    summary = summarize(result, acquisition, wall_seconds=wall_seconds)
    if isinstance(result, SpinAttitude):
        summary["spin"] = spin_summary(result, acquisition.chip.names)
    if result.hidden.shape[2]:
        field = _field(result, acquisition)
        words = words_of_hidden(result.hidden_names, result.motion.t, result.hidden, **field)
        entry = {"table": HIDDEN_TABLE, "names": list(result.hidden_names), "words": list(words)}
        if result.hidden_covariance is not None:
            entry["covariance"] = result.hidden_covariance.tolist()
        summary["hidden_directions"] = entry
    return summary


def _field(result: LineOfSight, acquisition: Acquisition) -> dict[str, float]:
    """What turns hidden directions into px."""
    return {"ifov": result.ifov, "half_field_px": acquisition.half_field_px}


def on_another_body(surface: Surface) -> bool:
    """Whether a surface is another body's than the Earth's: a message in Earth-fixed axes would be wrong."""
    if isinstance(surface, Dem):
        radii = surface.radii
    elif isinstance(surface, Ellipsoid):
        radii = (surface.a, surface.b)
    else:
        return False
    return abs(radii[0] / WGS84[0] - 1.0) > 1e-3


def _row_nyquist(result: LineOfSight) -> float:
    """Highest frequency (Hz) that rows of windows sample; faster motion shows as images about it."""
    star = result.records[0].star if result.records else None
    if star is None or star.duration <= 0.0 or star.shape[0] < 2:
        return float("inf")
    instants = star.t_hub.reshape(star.shape)[:, 0]
    return float(0.5 / np.median(np.diff(instants)))


def refined_attitude(result: LineOfSight, acquisition: Acquisition) -> Array:
    """Quaternions (N, 4), scalar last, world_from_body, at the instants of the recovered motion."""
    reference = acquisition.cameras[0].trajectory.at(result.motion.t).world_from_body
    return to_quat_xyzw(reference * Rotation.from_rotvec(np.array(result.motion.angles)))


def highest_frequency(acquisition: Acquisition) -> float:
    """Hz; up to where passbands and blind frequencies are given (half the rate of frames)."""
    cameras = acquisition.cameras
    if isinstance(cameras[0], PushbroomCamera):
        return HIGHEST_FREQUENCY / min(
            c.detector.line_period for c in cameras if isinstance(c, PushbroomCamera)
        )
    times = np.unique([camera.t for camera in cameras if not isinstance(camera, PushbroomCamera)])
    return float(0.5 / np.median(np.diff(times)))


def summarize(result: LineOfSight, acquisition: Acquisition, *, wall_seconds: float) -> dict[str, Any]:
    """What a recovery found, in names and numbers (the content of ``summary.json``).

    Parameters
    ----------
    result : LineOfSight
    acquisition : Acquisition
    wall_seconds : float
        s.

    Returns
    -------
    dict
        Angles in rad, frequencies in Hz, residuals in px.
    """
    upper = highest_frequency(acquisition)
    seen = observed(result, np.linspace(0.0, upper, _FREQUENCIES))
    in_px = remove_directions(result.motion.angles / result.scale, result.hidden, result.scale)
    visible = in_px * result.scale
    give_back_memory()
    error = error_psd(result, spectrum(result.motion).frequency)
    highest = min(upper, _row_nyquist(result))
    tones = judged_tones(result, detect_tones(result.motion, highest=highest, error_psd=error))
    give_back_memory()
    strip = _is_strip(acquisition)
    bands = dict(zip(ANGLES, seen.passbands, strict=True))
    return {
        "name": acquisition.name,
        "result": type(result).__name__,
        "version": VERSION,
        "epoch": acquisition.epoch,
        "images": list(result.image_names),
        "lines": len(result.motion.t),
        "ifov": result.ifov,
        "half_field_px": acquisition.half_field_px,
        "half_field": result.half_field,
        "scale": _per_axis(result.scale),
        "reference_image": result.image_names[0],
        "method": _method(result),
        "highest_frequency": upper,
        "passbands": bands,
        "blind_frequencies": {_name(result.image_names, pair): list(f) for pair, f in seen.blind.items()},
        "tones": _by_axis(tones.found),
        "tones_hardly_seen": _by_axis([t for t in tones.hardly_seen if t.false_alarm < MERE_CHANCE]),
        "microvibration": microvibration_summary(result, tones.found, bands) if strip else None,
        "rms_motion": _per_axis(np.sqrt((visible**2).mean(axis=0))),
        "rms_motion_px": _per_axis(np.sqrt((in_px**2).mean(axis=0))),
        "rms_sigma": _per_axis(np.sqrt((result.sigma**2).mean(axis=0))),
        "rms_sigma_px": _per_axis(np.sqrt((result.sigma**2).mean(axis=0)) / result.scale),
        "median_sigma_px": _per_axis(np.median(result.sigma, axis=0) / result.scale),
        "max_sigma_px": _per_axis(result.sigma.max(axis=0) / result.scale),
        "observed_share": float(np.mean(result.observed)),
        "residual_rms_px": _rms(result, result.after_px),
        "residual_rms_before_px": _rms(result, result.before_px),
        "residual_sigma_px": _expected(result),
        "residual_rms_rejected_px": _rms(result, result.after_px, rejected=True),
        "matches": _matches(result),
        "control": _control(result),
        "pairs": [_pair(result, one) for one in result.pairs],
        "withheld": [vars(one) | {"pair": list(one.pair)} for one in result.withheld],
        "relief": _relief(result),
        "statics": [vars(static) for static in result.statics],
        "sensors": [vars(sensor) for sensor in result.sensors],
        "absolute_sigma_px": _per_axis(np.sqrt((result.absolute_sigma**2).mean(axis=0)) / result.scale),
        "hidden_directions": None,
        "changes": list(result.changes),
        "warnings": [*result.warnings, *_unused(acquisition), *what_is_doubtful(acquisition)],
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "sources": list(acquisition.sources),
        "inputs": acquisition.input_hashes(),
    }


def _control(result: LineOfSight) -> dict[str, Any] | None:
    """What control points of a strip of one band lay off, and lie off; None of other images."""
    found = result.control
    if found is None:
        return None
    sizes = {"rms_before": found.before_px, "rms": found.after_px, "sigma": found.sigma_px}
    rms = {f"residual_{k}_px": float(np.sqrt(np.mean(px[found.kept] ** 2))) for k, px in sizes.items()}
    return {"points": len(found.t), "kept": int(found.kept.sum()), **rms}


def _relief(result: LineOfSight) -> dict[str, Any] | None:
    """Which file holds the ground that was found, and how far it goes; None where none was sought."""
    found = result.relief
    if found is None:
        return None
    rms = np.sqrt((found.heights**2).mean(axis=0))
    sigma = np.sqrt((found.sigma**2).mean(axis=0))
    return {
        "file": RELIEF,
        "image": result.image_names[found.image],
        "rms_height": float(rms[0]),
        "rms_slope": float(rms[1]),
        "sigma_height": float(sigma[0]),
        "sigma_slope": float(sigma[1]),
    }


def _is_strip(acquisition: Acquisition) -> bool:
    """Whether the motion is given line by line."""
    return isinstance(acquisition.cameras[0], PushbroomCamera)


def _unused(acquisition: Acquisition) -> list[str]:
    """What was given and read but does not take part in the estimate."""
    if not acquisition.frames or acquisition.spin is None:
        return []
    given = ["[surface] height_sigma"] if acquisition.height_sigma > 0.0 else []
    given += ["time_sigma"] if any(frame.time_sigma > 0.0 for frame in acquisition.frames) else []
    return [f"not used: {', '.join(given)}; a spin takes both for exact"] if given else []


def _method(result: LineOfSight) -> dict[str, Any]:
    """The estimator of the motion; of those beside the joint estimate how far they lie from it, and their own
    sigma."""
    used = result.method
    if used is None:
        return {"name": "joint"}
    departure, stated = (
        _per_axis(np.sqrt((values**2).mean(axis=0)) / result.scale)
        for values in (used.departure, used.stated_sigma)
    )
    return {"name": used.name, "rms_departure_from_joint_px": departure, "rms_stated_sigma_px": stated}


def _by_axis(tones: Sequence[DetectedTone]) -> dict[str, list[dict[str, Any]]]:
    """Tones as lists of their fields by the names of the axes."""
    return {axis: [vars(tone) for tone in tones if tone.axis == axis] for axis in ANGLES}


def _per_axis(values: Array) -> dict[str, float]:
    """Three numbers by the names of the axes."""
    return {axis: float(value) for axis, value in zip(ANGLES, values, strict=True)}


def _name(names: Sequence[str], pair: tuple[int, int]) -> str:
    """``"PAN - B1"``."""
    return " - ".join(names[image] for image in pair)


def _rms(result: LineOfSight, residuals: tuple[Array, ...], *, rejected: bool = False) -> float | None:
    """Root mean square of residuals (px): of the windows kept, or of those matched and then rejected.

    None where there are no such windows.
    """
    parts = []
    for record, part in zip(result.records, residuals, strict=True):
        chosen = part[~record.star.present if rejected else record.star.present]
        parts.append(chosen[np.isfinite(chosen)])
    values = np.concatenate(parts) if parts else np.empty(0)
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _expected(result: LineOfSight) -> float | None:
    """What the matches' own sigma asks for of the residuals (px): rms over the windows kept, or None."""
    pairs = [pair for pair in result.pairs if pair.kept]
    kept = [pair.kept for pair in pairs]
    return float(np.sqrt(np.average([pair.sigma_px**2 for pair in pairs], weights=kept))) if pairs else None


def _matches(result: LineOfSight) -> dict[str, Any]:
    """Numbers of windows tried, kept, and rejected by reason."""
    rejected: Counter[str] = Counter()
    for pair in result.pairs:
        rejected.update(pair.rejected)
    return {
        "tried": sum(pair.tried for pair in result.pairs),
        "kept": sum(pair.kept for pair in result.pairs),
        "rejected": dict(rejected),
    }


def _pair(result: LineOfSight, pair: PairResiduals) -> dict[str, Any]:
    """One pair of images with what it left over."""
    entry = dict(vars(pair))
    entry["images"] = [result.image_names[image] for image in entry["images"]]
    return entry


def _write_spectrum(path: Path, result: LineOfSight, bands: Mapping[str, Passbands]) -> None:
    """``spectrum.csv``: PSD of the motion and of its error, and where the passbands are."""
    found = spectrum(result.motion)
    error = error_psd(result, found.frequency)
    seen = np.zeros(found.psd.shape, dtype=bool)
    for axis, name in enumerate(ANGLES):
        for low, high in bands[name]:
            seen[:, axis] |= (found.frequency >= low) & (found.frequency <= high)
    write_spectrum(path, found.frequency, found.psd, error, seen)


def _write_covariance(path: Path, result: LineOfSight) -> None:
    """``covariance.npz``: t (s), angles (rad) on the grid of the estimate, and the lower band (rad^2)."""
    assert result.band is not None  # the caller looked
    with whole(path) as draft:
        np.savez_compressed(draft, t=result.band.t, angles=result.band.angles, band=result.band.band)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON file, complete or not at all; numbers that are not finite become null."""
    whole_text(path, json_text(content) + "\n")


def peak_memory() -> int | None:
    """Largest resident memory of this process so far, bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return None
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(largest if sys.platform == "darwin" else 1024 * largest)
