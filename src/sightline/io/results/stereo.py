"""A stereo orientation → its tables and ``summary.json``; their columns are described in ``docs/formats.md``.

Not here: poses and models for other programs (``stereo_exports.py``), the page (``report/stereo_page.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.stereo_heights import height_sigmas, heights_of
from sightline.applications.stereo_orientation import CHI_SHARE, CHI_SIGMAS, StereoOrientation
from sightline.applications.stereo_prediction import Improvement, StereoPrediction
from sightline.errors import printable
from sightline.evaluation.direction_words import AXES, angle_names, direction_words
from sightline.io.formats.tables import csv_cell, write_columns
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.io.stereo.load import Stereo
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.triangulate import triangulate
from sightline.version import VERSION
from sightline.writing import whole_text

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ORIENTATION = ("camera", *AXES, *(f"sigma_{axis}" for axis in AXES))


def write_stereo_result(
    folder: Path,
    stereo: Stereo,
    result: StereoOrientation,
    better: Sequence[Improvement] = (),
    *,
    wall_seconds: float,
    **more: Any,
) -> dict[str, Any]:
    """Write every table of an orientation and its summary.

    Parameters
    ----------
    folder : Path
        Exists.
    stereo : Stereo
        What it was found from.
    result : StereoOrientation
    better : sequence of Improvement
        What would better the angles.
    wall_seconds : float
        s; of the whole command so far.
    more
        Further entries of the summary.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.
    """
    write_orientation(folder / "orientation.csv", result.cameras, result.angles, result.sigma)
    write_covariance(folder / "covariance.csv", result.cameras, result.covariance)
    write_matches_used(folder / "matches_used.csv", stereo, result)
    write_points(folder / "points.csv", stereo.problem, result)
    summary = summarize_orientation(stereo, result, wall_seconds=wall_seconds) | more
    summary["improvements"] = [improvement_entry(change) for change in better]
    write_json(folder / "summary.json", summary)
    return summary


def write_orientation(path: Path, cameras: tuple[str, ...], angles: Array, sigma: Array) -> None:
    """``orientation.csv``: a row per camera, rad; nan and inf where an angle is not observable."""
    values = [np.array(cameras, dtype=str), *angles.T, *sigma.T]
    write_columns(path, dict(zip(ORIENTATION, values, strict=True)), dict.fromkeys(ORIENTATION, "%.17g"))


def write_covariance(path: Path, cameras: tuple[str, ...], covariance: Array) -> None:
    """``covariance.csv``: rad^2, rows and columns as the comment at its top names them."""
    lines = ["# " + ",".join(csv_cell(printable(name)) for name in angle_names(cameras))]
    lines += [",".join(f"{value:.17g}" for value in row) for row in covariance]
    whole_text(path, "\n".join(lines) + "\n")


def used(stereo: Stereo, result: StereoOrientation) -> tuple[Array, BoolArray]:
    """Residual (px) and rejection of each match, or of each sighting of observations and control points.

    A match has the residuals of both images: the root of the sum of their squares.
    """
    size, rejected = result.residual_px, result.rejected
    if stereo.pairs is None:
        return size, rejected
    first, second = slice(0, stereo.pairs), slice(stereo.pairs, 2 * stereo.pairs)
    return np.hypot(size[first], size[second]), rejected[first] | rejected[second]


def write_matches_used(path: Path, stereo: Stereo, result: StereoOrientation) -> None:
    """``matches_used.csv``: residual of each match, and whether it was rejected."""
    problem = stereo.problem
    size, rejected = used(stereo, result)
    rows = slice(0, len(size))
    image = problem.tracks.image[rows]
    columns: dict[str, Any] = {
        "shot": problem.shot_names[problem.images.shot[image]].astype(np.int64),
        "point": problem.point_names[problem.tracks.point[rows]].astype(np.int64),
        "residual_px": size,
        "rejected": rejected,
    }
    if stereo.pairs is None:
        names = np.array(problem.cameras, dtype=str)
        columns = {"camera": names[problem.images.camera[image]], **columns}
    write_columns(path, columns, {"residual_px": "%.6g"})


def planned_points(problem: StereoProblem, kept: BoolArray) -> Array:
    """Points (n, 3) m that the planned poses give, from the sightings `kept` (N,)."""
    return triangulate(problem.sightings(), used=kept).position


def write_points(path: Path, problem: StereoProblem, result: StereoOrientation) -> None:
    """``points.csv``: every point with its sigmas, and its height before and after."""
    before = planned_points(problem, ~result.rejected)
    points, covariance = result.points, result.point_covariance
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    columns: dict[str, Any] = {"point": problem.point_names.astype(np.int64)}
    columns |= {axis: points[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis}": sigma[:, k] for k, axis in enumerate("xyz")}
    columns |= {
        "height_before": heights_of(before, problem.radii),
        "height": heights_of(points, problem.radii),
        "sigma_height": height_sigmas(points, covariance, problem.radii),
    }
    write_columns(path, columns, dict.fromkeys([*"xyz", "height", "height_before"], "%.13g"))


def summarize_orientation(
    stereo: Stereo, result: StereoOrientation, *, wall_seconds: float
) -> dict[str, Any]:
    """The content of ``summary.json``."""
    problem, images = stereo.problem, stereo.problem.images
    sigma = result.sigma
    return {
        "name": stereo.name,
        "epoch": problem.epoch,
        "result": "StereoOrientation",
        "version": VERSION,
        "method": result.method,
        "cameras": list(result.cameras),
        "images": len(images),
        "shots": len(problem.shot_names),
        "points": len(problem.point_names),
        "window_seconds": float(np.ptp(images.t)),
        "angles": {
            camera: {axis: float(result.angles[c, k]) for k, axis in enumerate(AXES)}
            | {f"sigma_{axis}": float(sigma[c, k]) for k, axis in enumerate(AXES)}
            for c, camera in enumerate(result.cameras)
        },
        "principal_sigmas": principal_sigmas(result),
        "unobservable": unobservable(result, baseline_turn(problem)),
        "drift": _drift(result),
        "focal_length": _focal(problem, result),
        "bias_removed": None if result.bias is None else result.bias.tolist(),
        "matches": _matches(stereo, result),
        "cost": result.cost,
        "degrees_of_freedom": result.degrees_of_freedom,
        "chi_square": chi_square(result),
        "heights": _heights(problem, result),
        "warnings": [*problem.warnings, *result.warnings],
        "iterations": result.iterations,
        "solve_seconds": result.solve_seconds,
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": stereo.input_hashes(),
    }


def unobservable(known: StereoOrientation | StereoPrediction, turn: Array | None) -> list[dict[str, Any]]:
    """Words and direction of what is not observable; `turn` (3 C,) is that about the baseline, if any."""
    entries = []
    for entry in principal_sigmas(known):
        if math.isfinite(entry["sigma"]):
            continue
        words = entry["words"]
        if turn is not None and abs(np.array(list(entry["direction"].values())) @ turn) > _SAME_TURN:
            words = f"turn of all cameras about the baseline ({words})"
        entries.append({"words": words, "direction": entry["direction"]})
    return entries


#: Cosine from which on a direction is the turn about the baseline: within about 6 degrees.
_SAME_TURN = 0.995


def baseline_turn(problem: StereoProblem) -> Array | None:
    """Unit direction (6,) of a turn of both cameras about their mean baseline; None if they are not two."""
    images = problem.images
    if len(problem.cameras) != 2:
        return None
    first, second = (np.flatnonzero(images.camera == c) for c in (0, 1))
    _, a, b = np.intersect1d(images.shot[first], images.shot[second], return_indices=True)
    if len(a) == 0:
        return None
    first, second = first[a], second[b]
    along = images.position[first] - images.position[second]
    turns = [images.world_from_body[rows].inv().apply(along).mean(axis=0) for rows in (first, second)]
    turn = np.concatenate(turns)
    return np.asarray(turn / np.linalg.norm(turn))


def improvement_entry(change: Improvement) -> dict[str, Any]:
    """A change and the bounds of all angles with it, rad; and their ratio to those without."""
    return {"change": change.change, "sigmas": change.sigmas.tolist(), "ratio": change.ratio.tolist()}


def principal_sigmas(result: StereoOrientation | StereoPrediction) -> list[dict[str, Any]]:
    """Principal directions of the angles, the weakest first: sigma (rad), direction by name, words."""
    names, seen = angle_names(result.cameras), result.observability
    order = np.argsort(-np.asarray(seen.sigmas), kind="stable")
    return [
        {
            "sigma": float(seen.sigmas[k]),
            "direction": {name: float(part) for name, part in zip(names, seen.directions[k], strict=True)},
            "words": direction_words(seen.directions[k], result.cameras),
        }
        for k in order
    ]


def _matches(stereo: Stereo, result: StereoOrientation) -> dict[str, Any]:
    """How many were tried, kept and rejected, and their residuals (px)."""
    size, rejected = used(stereo, result)
    kept = size[~rejected & np.isfinite(size)]
    return {
        "kind": "pairs" if stereo.pairs is not None else "sightings",
        "tried": len(size),
        "kept": int((~rejected).sum()),
        "rejected": int(rejected.sum()),
        "unchecked": result.unchecked,
        "rms_px": float(np.sqrt((kept**2).mean())) if len(kept) else math.nan,
    }


def _drift(result: StereoOrientation) -> dict[str, Any] | None:
    """rad/s of every angle of every camera, where it was sought."""
    if result.drift is None or result.drift_sigma is None:
        return None
    return {
        camera: {axis: float(result.drift[c, k]) for k, axis in enumerate(AXES)}
        | {f"sigma_{axis}": float(result.drift_sigma[c, k]) for k, axis in enumerate(AXES)}
        for c, camera in enumerate(result.cameras)
    }


def _focal(problem: StereoProblem, result: StereoOrientation) -> dict[str, Any] | None:
    """px; focal lengths that were refined."""
    if result.stretch is None or result.stretch_sigma is None:
        return None
    return {
        camera: {
            "focal_length_px": detector.focal_length_px * (1.0 + float(result.stretch[c])),
            "sigma_px": detector.focal_length_px * float(result.stretch_sigma[c]),
        }
        for c, (camera, detector) in enumerate(zip(result.cameras, problem.detectors, strict=True))
    }


def chi_square(result: StereoOrientation) -> dict[str, Any]:
    """Whether residuals are as large as the sigmas of the file say."""
    freedom = result.degrees_of_freedom
    if result.cost is None or freedom is None or freedom <= 0:
        why = "no equation is left over to judge by"
        if result.cost is None:
            why = f"{result.method} adjusts no points, so it has no chi-square; ml-track has one"
        verdict = f"whether residuals are as large as the sigmas say was not judged: {why}"
        return {"per_degree": None, "sigma": None, "verdict": verdict}
    ratio, sigma = result.cost / freedom, math.sqrt(2.0 / freedom)
    off = abs(ratio - 1.0)
    if off <= max(CHI_SIGMAS * sigma, CHI_SHARE):
        verdict = "residuals are as large as the sigmas say"
    elif ratio > 1.0:
        verdict = (
            f"residuals are {math.sqrt(ratio):.3g} times as large as the sigmas say: enlarge sigma_px or "
            "those of "
            "the poses; the sigmas of the angles are too small by about that"
        )
    else:
        verdict = (
            f"residuals are {math.sqrt(ratio):.3g} times as large as the sigmas say: these are too large"
        )
    return {"per_degree": ratio, "sigma": sigma, "verdict": verdict}


def _heights(problem: StereoProblem, result: StereoOrientation) -> dict[str, float]:
    """m; how far heights moved, and their median sigma."""
    before = heights_of(planned_points(problem, ~result.rejected), problem.radii)
    moved = heights_of(result.points, problem.radii) - before
    sigma = height_sigmas(result.points, result.point_covariance, problem.radii)
    known, finite = moved[np.isfinite(moved)], sigma[np.isfinite(sigma)]
    return {
        "mean_change": float(known.mean()) if len(known) else math.nan,
        "rms_change": float(np.sqrt((known**2).mean())) if len(known) else math.nan,
        "median_sigma": float(np.median(finite)) if len(finite) else math.nan,
    }
