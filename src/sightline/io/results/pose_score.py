"""``poses.csv`` and ``covariance.npz`` of a folder, against ``poses-truth.csv``, as a score.

Not here: what is made of them (``evaluation/score_poses.py``), the score as a table (``score_table.py``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.evaluation.score_poses import score_poses
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
