"""``poses.csv`` and ``covariance.npz`` of a folder, against ``poses-truth.csv``, as a score.

Not here: what is made of them (``evaluation/score_poses.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.evaluation.score_poses import PARAMETERS, score_poses
from sightline.io.formats.tables import read_columns
from sightline.io.results.poses import (
    FocalLength,
    FramePoseTable,
    read_pose_covariance,
    read_pose_table,
    read_pose_truth,
)


def score_pose_folder(folder: Path, truth: Path) -> dict[str, Any]:
    """Score of the ``poses.csv`` in `folder`, with its ``covariance.npz`` where there is one.

    Frames are compared by name; those of one side alone are counted. A focal length that was found is
    compared with that of ``truth-focal.csv`` beside `truth`.
    """
    path = folder / "poses.csv"
    poses, true = read_pose_table(path), read_pose_truth(truth)
    rows, true_rows = _common(poses, true)
    if not len(rows):
        raise FormatError(
            f"{truth}: no frame of {path} is in it: the first there is {poses.frames[0]!r}, here "
            f"{true.frames[0]!r}"
        )
    file = folder / "covariance.npz"
    covariance, focal = None, dict[str, Any]()
    if file.is_file():
        given = read_pose_covariance(file)
        if given.frames != poses.frames:
            raise FormatError(f"{file}: is of other frames than poses.csv beside it; write both anew")
        covariance = given.covariance[rows]
        focal = _focal_score(given.focal_length, truth.with_name("truth-focal.csv"))
    score = score_poses(
        poses.position[rows],
        Rotation.from_quat(poses.quat_xyzw[rows]),
        true.position[true_rows],
        Rotation.from_quat(true.quat_xyzw[true_rows]),
        sigma=None if poses.sigma is None else poses.sigma[rows],
        covariance=covariance,
        source=tuple(poses.source[k] for k in rows),
    )
    return score | focal | {"not_in_truth": len(poses) - len(rows), "not_in_result": len(true) - len(rows)}


def _focal_score(found: FocalLength | None, truth: Path) -> dict[str, Any]:
    """Of a focal length that was found, where the true one lies beside the truth of the poses."""
    if found is None or not truth.is_file():
        return {}
    true = read_columns(truth, ("camera", "focal_length_px"), text=("camera",))["focal_length_px"]
    error, sigma = found.px - float(np.ravel(true)[0]), float(np.sqrt(found.covariance[6]))
    return {"focal_length": {"error_px": error, "sigma_px": sigma, "error_over_sigma": error / sigma}}


def _common(poses: FramePoseTable, true: FramePoseTable) -> tuple[np.ndarray, np.ndarray]:
    """Rows of both tables, of the frames that both have."""
    number = {name: k for k, name in enumerate(true.frames)}
    pairs = [(k, number[name]) for k, name in enumerate(poses.frames) if name in number]
    found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return found[:, 0], found[:, 1]


#: Columns of the table of a score: head, key of an entry, form; angles are in degrees.
_COLUMNS = (
    ("rms", "rms", ".3g"),
    ("max", "max", ".3g"),
    ("sigma", "sigma", ".3g"),
    ("NEES", "nees", ".2f"),
    ("in 95 %", "coverage_95", ".0%"),
)
_ALONE = {"not_in_truth": "frames that are not in the truth", "not_in_result": "that are not in the result"}


def pose_score_lines(score: dict[str, Any]) -> list[str]:
    """A score of poses as lines of a table.

    Parameters
    ----------
    score : dict
        As of `score_pose_folder`.

    Returns
    -------
    list of str
        Per kind of frame and parameter: rms, largest error and rms of the stated sigma (m, degrees), NEES,
        share of the true values inside their 95 % interval.
    """
    count = score["frames"]
    lines = [_line("frames", "", [head for head, _, _ in _COLUMNS])]
    lines += _part_lines(f"all ({count})", score["absolute"])
    for source, part in score["by_source"].items():
        lines += _part_lines(f"{source} ({part['frames']})", part)
    if "rigid" in score:
        lines += _part_lines(f"all, turned and moved ({count})", score["rigid"])
    lines.append(
        "NEES: mean squared error over the stated variance; 1 is expected, of all six together 6. Frames "
        "share the error of their datum: one flight is one draw of it."
    )
    alone = [f"{score[key]} {words}" for key, words in _ALONE.items() if score[key]]
    return lines + ([f"not compared: {', '.join(alone)}"] if alone else [])


def _part_lines(name: str, entries: dict[str, Any]) -> list[str]:
    """Of each parameter, and of all together."""
    lines = []
    for parameter in PARAMETERS:
        entry = entries[parameter]
        unit, factor = ("m", 1.0) if entry["unit"] == "m" else ("deg", float(np.degrees(1.0)))
        cells = [
            format(entry[key] * (factor if form == ".3g" else 1.0), form) if key in entry else "-"
            for _, key, form in _COLUMNS
        ]
        lines.append(_line(name, f"{parameter} {unit}", cells))
        name = ""
    together = entries.get("nees")
    return lines if together is None else [*lines, _line("", "all six", ["", "", "", f"{together:.2f}"])]


def _line(name: str, parameter: str, cells: Sequence[str]) -> str:
    return f"{name:30}{parameter:10}" + "".join(f"{cell:>10}" for cell in cells)
