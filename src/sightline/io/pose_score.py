"""``poses.csv`` and ``covariance.npz`` of a folder, against ``poses-truth.csv``, as a score.

Not here: what is made of them (``evaluation/score_poses.py``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.evaluation.score_poses import score_poses
from sightline.io.poses import FramePoseTable, read_pose_covariance, read_pose_table, read_pose_truth


def score_pose_folder(folder: Path, truth: Path) -> dict[str, Any]:
    """Score of the ``poses.csv`` in `folder`, with its ``covariance.npz`` where there is one.

    Frames are compared by name; those of one side alone are counted.
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
    covariance = None
    if file.is_file():
        given = read_pose_covariance(file)
        if given.frames != poses.frames:
            raise FormatError(f"{file}: is of other frames than poses.csv beside it; write both anew")
        covariance = given.covariance[rows]
    score = score_poses(
        poses.position[rows],
        Rotation.from_quat(poses.quat_xyzw[rows]),
        true.position[true_rows],
        Rotation.from_quat(true.quat_xyzw[true_rows]),
        sigma=None if poses.sigma is None else poses.sigma[rows],
        covariance=covariance,
        source=tuple(poses.source[k] for k in rows),
    )
    return score | {"not_in_truth": len(poses) - len(rows), "not_in_result": len(true) - len(rows)}


def _common(poses: FramePoseTable, true: FramePoseTable) -> tuple[np.ndarray, np.ndarray]:
    """Rows of both tables, of the frames that both have."""
    number = {name: k for k, name in enumerate(true.frames)}
    pairs = [(k, number[name]) for k, name in enumerate(poses.frames) if name in number]
    found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return found[:, 0], found[:, 1]
