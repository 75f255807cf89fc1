"""S4 as its document writes it: poses of a subset; frames between by displacement and yaw, or by a curve.

For comparison with the adjustment of all frames: frames between have no covariance.

Not here: the curves themselves (``photogrammetry/flight/interpolation.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sightline.applications.sequence_poses import ESTIMATED, INTERPOLATED, SOLVED, SequencePoses
from sightline.errors import EstimationError, InputError, computes
from sightline.geometry.checks import frozen
from sightline.photogrammetry.flight.interpolation import WAYS, between_anchors, by_displacement
from sightline.photogrammetry.flight.solver import SequenceSolver, ground_distances

__all__ = ["WAYS", "interpolate_between"]


@computes("poses between those of the subset")
def interpolate_between(found: SequencePoses, way: str) -> SequencePoses:
    """The same sequence by its subset alone.

    Parameters
    ----------
    found : SequencePoses
        Of `georeference_sequence`: its subset, windows, motions of frames and the problem that it solved are
        used, its poses are not.
    way : str
        "displacement": how successive frames moved and turned, spread so that it meets the subset (S4, 750
        and 760); "slerp", "spline": a curve through the poses of the subset, whatever images show.

    Returns
    -------
    SequencePoses
        Poses of the subset are of an adjustment of its own sightings; those between have infinite sigmas.

    Raises
    ------
    InputError
        If there is no such way.
    EstimationError
        If the subset has fewer than two frames that were solved.
    """
    if way not in WAYS:
        raise InputError(f"`way` must be one of {', '.join(WAYS)}, got {way!r}")
    problem = found.problem
    if problem is None:
        raise InputError("`found` must be of `georeference_sequence`, with the problem it solved")
    tracks = found.tracks[np.isin(found.tracks.image, found.subset.frames)]
    # control points are plain ones here: they stand among the tracks
    plain = replace(problem, control=None, control_tracks=None)
    poses = SequenceSolver(plain, found.followed).solve(tracks, None)
    anchors = found.subset.frames[poses.sightings[found.subset.frames] > 0]
    if len(anchors) < 2:
        raise EstimationError(
            f"{len(anchors)} frames of the subset could be solved; interpolation needs two: lower the "
            "overlap wanted, or use the adjustment of all frames"
        )
    known = (problem.t, anchors, poses.position[anchors], poses.world_from_body[anchors])
    if way == "displacement":
        distance = float(np.median(ground_distances(problem)))
        camera = (poses.detector(problem.detector), problem.mount, distance)
        position, attitude = by_displacement(*known, found.followed, *camera)
    else:
        position, attitude = between_anchors(*known, way)
    covariance = np.full((len(problem), 6, 6), np.nan)
    covariance[:, np.arange(6), np.arange(6)] = np.inf
    covariance[anchors] = poses.covariance[anchors]
    solved = np.zeros(len(problem), dtype=np.bool_)
    solved[anchors] = True
    between = ESTIMATED if way == "displacement" else INTERPOLATED
    return replace(
        found,
        poses=replace(
            poses,
            position=frozen(position),
            world_from_body=attitude,
            covariance=frozen(covariance),
            next_covariance=frozen(np.full((len(problem) - 1, 6, 6), np.nan)),
            pair_covariance=None,
        ),
        source=tuple(SOLVED if each else between for each in solved),
        reason=tuple("" if each else f"between frames of the subset: {way}" for each in solved),
        tracks=tracks,
        warnings=(*found.warnings, f"poses between the subset's are by {way}: they have no covariance"),
    )
