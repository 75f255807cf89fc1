"""Control points that do not go with the others: found by solving without each, then used as plain points.

Not here: reading them (``io/sequence/control.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sightline.geometry.checks import Array
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Tracks

#: Sigmas by which a control point may miss; and from which on it is tried without one.
_MISS, _SUSPECT = 4.0, 2.0
#: Share of the control points that may be wrong: more leave nothing to find them by.
_WRONG = 3


def misses(control: ControlPoints, own: Tracks, tracks: Tracks, poses: FramePoses) -> Array:
    """Sigmas (G,) by which each control point in use lies from where the frames see it.

    Its largest coordinate; inf where its sightings do not go with the frames at all.

    Parameters
    ----------
    control : ControlPoints
        Those in use.
    own : Tracks
        Sightings of all control points.
    tracks : Tracks
        All sightings, those last.
    poses : FramePoses
    """
    first = int(tracks.point[len(tracks) - len(own)] - own.point[0])
    place = poses.points[first + control.point]
    miss = np.abs(place - control.position).max(axis=1) / control.sigma
    return np.where(np.isfinite(miss), miss, np.inf)


def screened(
    problem: SequenceProblem,
    tracks: Tracks,
    poses: FramePoses,
    solve: Callable[[SequenceProblem, FramePoses], FramePoses],
) -> tuple[SequenceProblem, FramePoses]:
    """The problem with control points that go together, its poses, and words of those that do not.

    Parameters
    ----------
    problem : SequenceProblem
    tracks : Tracks
        Sightings of control points last.
    poses : FramePoses
        With all control points.
    solve : callable
        Poses of a problem with fewer control points, from those of before.

    Returns
    -------
    problem : SequenceProblem
        Control points that are wrong are plain points in it; that is among its warnings.
    poses : FramePoses
    """
    control, own = problem.control, problem.control_tracks
    if control is None or own is None or not len(control.point):
        return problem, poses
    first = misses(control, own, tracks, poses)
    kept, best, miss, words = control, poses, first, list[str]()
    for _ in range(len(control.point) // _WRONG):
        if miss.max() <= _MISS:
            break
        tried = []
        for row in np.flatnonzero(miss > _SUSPECT).tolist():
            less = _without(kept, row)
            found = solve(replace(problem, control=less), best)
            tried.append((float(misses(less, own, tracks, found).max(initial=0.0)), row, less, found))
        _, row, less, best = min(tried, key=lambda each: each[0])
        words.append(
            f"control point {_named(kept, row)} does not go with the others and the frames: its coordinates "
            "are not used; check them, and where it was seen"
        )
        kept, miss = less, misses(less, own, tracks, best)
    if miss.max(initial=0.0) > _MISS:
        # they contradict each other, and nothing shows which are right
        kept, best, words = control, poses, _contradicting(control, first)
    return replace(problem, control=kept, warnings=(*problem.warnings, *words)), best


def _without(control: ControlPoints, row: int) -> ControlPoints:
    """The others; sightings stay, as of a plain point."""
    rest = np.arange(len(control.point)) != row
    return control[rest]


def _contradicting(control: ControlPoints, miss: Array) -> list[str]:
    """A warning for each control point that misses."""
    return [
        f"control point {_named(control, int(row))} lies "
        + (f"{miss[row]:.1f} of its sigmas from" if np.isfinite(miss[row]) else "nowhere near")
        + " where the frames see it, and nothing shows which control points are right; check them all"
        for row in np.flatnonzero(miss > _MISS)
    ]


def _named(control: ControlPoints, row: int) -> str:
    place = ", ".join(f"{v:.7g}" for v in control.position[row])
    return f"{int(control.point[row]) + 1} at ({place}) m"
