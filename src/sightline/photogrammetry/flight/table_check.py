"""Whether the images go with what tables told: rough poses against how frames moved, and against poses found.

Not here: control points (``control_check.py``), heights of the ground (``found_ground.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.errors import EstimationError
from sightline.geometry.checks import Array
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.outlook import ground_motion, overlap_of
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem

#: How often the images may move faster or slower than the rough poses say, or against them, unsaid.
_MOST = 2.0
#: Lengths of a frame by which successive ones lie apart at most, by the tables.
MOST_APART = 3.0
#: Frames' worth of ground that a flight passes over at least before its motion says anything.
_FRAMES_FLOWN = 0.25
#: Times their sigma by which rows of tables may miss the poses found, rms; told rows for that to be said.
_MISSED, _ROWS = 3.0, 6
#: What is wrong where images and tables do not go together.
_CHECK = (
    "check units and axes of the positions ([world]), [surface] height, [camera] focal_length_px, "
    "principal_point_px and mount, quaternions (scalar last), and whether the tables are of these frames"
)
#: Median of chi squared of three numbers.
_CHI_SQUARED_3 = 2.366


def motion_warnings(problem: SequenceProblem, followed: Followed) -> list[str]:
    """A warning where the images move otherwise than the rough poses say."""
    ratio = _motion_ratio(problem, followed)
    if ratio is None or 1.0 / _MOST < ratio < _MOST:
        return []
    how = f"{ratio:.2g} times as fast as" if ratio > 0.03 else "otherwise than"
    return [
        f"the ground moves through the frames {how} the rough poses say; check heights and units of the "
        "positions, times, [surface] height, [camera] focal_length_px and mount, and whether the tables "
        "are of these frames"
    ]


def _motion_ratio(problem: SequenceProblem, followed: Followed) -> float | None:
    """Motion followed over that expected, by least squares; None where either is too little to tell."""
    expected = ground_motion(problem)[0]
    k = np.flatnonzero((followed.before >= 0) & np.isfinite(expected).all(axis=1))
    k = k[np.isfinite(followed.motion[k, :2]).all(axis=1)]
    seen = followed.motion[k, :2]
    told = expected[k] * (problem.t[k] - problem.t[followed.before[k]])[:, None]
    least = _FRAMES_FLOWN * min(problem.detector.shape)
    if not len(k) or max(np.linalg.norm(told.sum(axis=0)), np.linalg.norm(seen.sum(axis=0))) < least:
        return None
    return float((seen * told).sum() / (told**2).sum())


def refuse_apart(problem: SequenceProblem) -> None:
    """EstimationError where frames that follow one another lie frames apart by the tables: no poses go with
    such tables and with images that share anything."""
    overlap = overlap_of(problem)
    if overlap is not None and overlap.step > MOST_APART * overlap.covered:
        raise EstimationError(f"successive frames have no ground in common{_told(problem)}; {_CHECK}")


def unsolved_words(problem: SequenceProblem) -> str:
    """What to check where no poses go with both images and tables."""
    return (
        "the poses do not come together: what the frames show does not go with the rough "
        f"poses{_told(problem)}; {_CHECK}"
    )


def _told(problem: SequenceProblem) -> str:
    """In brackets, how far frames lie apart by the tables."""
    overlap = overlap_of(problem)
    if overlap is None:
        return ""
    return (
        f" (by the tables a frame covers {overlap.covered:.3g} m, successive frames are {overlap.step:.3g} m "
        f"apart and share {overlap.usual:.0%})"
    )


def table_warnings(problem: SequenceProblem, poses: FramePoses) -> list[str]:
    """Warnings where rows of the tables miss the poses found by more than their sigmas allow."""
    moved = problem.images.position - poses.position - poses.bias[:3]
    turned = (poses.world_from_body.inv() * problem.images.world_from_body).as_rotvec() - poses.bias[3:]
    out = []
    for what, error, sigma, unit, factor in (
        ("positions", moved, problem.known.along_world(), "m", 1.0),
        ("attitudes", turned, problem.known.attitude, "degrees", float(np.degrees(1.0))),
    ):
        ratio, size = _missed(error, sigma)
        if ratio > _MISSED:
            out.append(
                f"{what} of the tables miss the poses found by {factor * size:.2g} {unit}, {ratio:.2g} "
                "times their sigma: are the sigmas too small, or rows of other frames?"
            )
    return out


def _missed(error: Array, sigma: Array) -> tuple[float, float]:
    """Robust rms of errors (M, 3) over their sigmas, and their median size; 0 where too few are told."""
    told = np.isfinite(sigma).all(axis=1) & np.isfinite(error).all(axis=1)
    if told.sum() < _ROWS:
        return 0.0, 0.0
    square = ((error[told] / sigma[told]) ** 2).sum(axis=1)
    size = np.linalg.norm(error[told], axis=1)
    return float(np.sqrt(np.median(square) / _CHI_SQUARED_3)), float(np.median(size))
