"""Poses that a sequence's adjustment starts from, once it is known how its frames moved.

Not here: reading what tables say (``io/sequence/poses.py``), a model by photogrammetry
(``photogrammetry/flight/reconstruct.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sightline.errors import EstimationError
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.turned_frames import carried_attitudes, quarter_turns, turned_images
from sightline.photogrammetry.sightings import Tracks

#: Share of a frame's longer side by which points may lie off the rough poses; each round sees this finer.
_FAR_OFF, _FINER = 0.03, 5.0
#: Share of a frame that the next one shows, from which on it is not little overlap that hinders following.
_MUCH = 0.6


def begun(problem: SequenceProblem, followed: Followed) -> SequenceProblem:
    """The problem with attitudes that go with how its frames moved, and with words of what was wrong.

    Parameters
    ----------
    problem : SequenceProblem
    followed : Followed
        How its frames moved.
    """
    given = np.isfinite(problem.known.attitude).all(axis=1)
    words = []
    if followed.wide:
        words.append(_wide_words(problem, followed))
    images, camera = problem.images, (problem.detector, problem.mount)
    if given.any():
        quarters = quarter_turns(images, problem.known, *camera, problem.surface, followed)
        images = turned_images(images, np.asarray(0.5 * np.pi * quarters, dtype=np.float64), *camera)
        for number in (1, 2, 3):
            rows = np.flatnonzero(quarters == number)
            if len(rows):
                words.append(
                    f"{len(rows)} of {len(problem)} frames (the first: {problem.frames[rows[0]]}) are turned "
                    f"by {90 * number} degrees against the angles given for them: taken as turned; "
                    + ("check [camera] mount" if len(rows) == len(problem) else "were they written anew?")
                )
        if followed.wide and not given.all():
            images = carried_attitudes(images, problem.known, *camera, followed)
    return replace(problem, images=images, warnings=(*problem.warnings, *words))


def _wide_words(problem: SequenceProblem, followed: Followed) -> str:
    """Why frames were not followed, by how features say that they moved: a long step, or little overlap."""
    by_features = "their windows were found by features"
    rows = np.flatnonzero(followed.before == np.arange(len(followed.before)) - 1)
    rows = rows[(followed.before[rows] >= 0) & np.isfinite(followed.motion[rows]).all(axis=1)]
    if not len(rows):
        return f"neighbouring frames could not be followed from one to the next: {by_features}"
    step = np.median(np.abs(followed.motion[rows, :2]), axis=0)
    shared = float(np.prod(np.maximum(1.0 - step / problem.detector.shape, 0.0)))
    if shared < _MUCH:
        return f"neighbouring frames overlap too little to be followed (about {shared:.0%}): {by_features}"
    turn = float(np.degrees(np.median(np.abs(followed.motion[rows, 2]))))
    return (
        f"neighbouring frames share about {shared:.0%}, but are {float(np.hypot(*step)):.0f} px and "
        f"{turn:.2g} degrees of turn apart, too much to be followed from one to the next: {by_features}"
    )


def approached(
    solve: Callable[[Tracks, FramePoses | None], FramePoses], tracks: Tracks, side_px: int
) -> tuple[Tracks, FramePoses, list[str]]:
    """Poses of few frames far apart, the tracks as they counted, and words where they did not count in full.

    Sightings count for little at first, for more as poses come nearer; what is far from them is left out.

    Parameters
    ----------
    solve : callable
        Poses of tracks, from those of before.
    tracks : Tracks
    side_px : int
        Longer side of a frame.

    Raises
    ------
    EstimationError
        If the sightings do not go with the rough poses at all.

    Notes
    -----
    Such frames are held by tables alone until their points are: sightings that count in full from the start
    would be taken for gross errors under poses that are tens of pixels off. Where the last rounds
    do not settle, the frames' geometry being too weak, the round before them stands, with its larger sigmas.
    """
    poses, loose, counted = None, _FAR_OFF * side_px, tracks
    while True:
        last = loose <= 2.0 * float(np.median(tracks.sigma_px))
        weighed = tracks if last else replace(tracks, sigma_px=np.hypot(tracks.sigma_px, loose))
        try:
            found = solve(weighed, poses)
        except EstimationError:
            if poses is None:
                raise
            size = float(np.median(counted.sigma_px))
            words = f"the frames' geometry is weak: sightings count as good to {size:.2g} px, not better"
            return counted, poses, [words]
        poses, counted = found, weighed
        if last:
            return counted, poses, []
        near = np.flatnonzero(~found.rejected[: len(tracks)])
        tracks = tracks[near]
        loose /= _FINER
