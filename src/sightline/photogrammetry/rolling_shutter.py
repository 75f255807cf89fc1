"""Frames whose lines are exposed one after the other: each sighting from the pose of its own line.

Within a frame the camera moves as the path through all frames does. What a frame's pose departs from its plan
by is the same for all its lines.

Not here: the poses of the frames (``frame_poses.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.flight_path import path_turns, stretches
from sightline.photogrammetry.sightings import Images, Index, Sightings, as_index

#: rad; frames that are turned by more against the one before are of another flight line.
_TURNED = 0.5


def line_poses(
    estimated: Images, image: Index, delay: Array, linked: Index | None = None
) -> tuple[Array, Rotation]:
    """How the camera moved and turned since a frame's first line, along a spline through its flight line.

    Parameters
    ----------
    estimated : Images
        Poses of M frames at their first lines.
    image : (N,) int
        Frame of each place asked for.
    delay : (N,)
        s after its first line.
    linked : (M,) int, optional
        Frames whose images are linked to each other, by number; -1: to none.

    Returns
    -------
    moved : (N, 3)
        m, world axes.
    turned : Rotation
        N, body axes.
    """
    stretch = flight_lines(estimated, linked)
    path = path_turns(estimated, stretch)
    moved, turned = np.zeros((len(image), 3)), np.zeros((len(image), 3))
    for number in np.unique(stretch):
        frames = np.flatnonzero(stretch == number)
        rows = np.flatnonzero(stretch[image] == number)
        if len(frames) < 2 or not len(rows):
            continue
        spline = CubicSpline(estimated.t[frames], path[frames])
        here = spline(estimated.t[image[rows]] + delay[rows])
        first = path[image[rows]]
        moved[rows] = here[:, 3:] - first[:, 3:]
        turn = Rotation.from_rotvec(first[:, :3]).inv() * Rotation.from_rotvec(here[:, :3])
        turned[rows] = turn.as_rotvec()
    return moved, Rotation.from_rotvec(turned)


def flight_lines(estimated: Images, linked: Index | None = None) -> NDArray[np.intp]:
    """Number (M,) of the flight line of each frame: a path that one curve follows.

    A pause ends it, and so do a turn from one frame to the next and images that are not linked over a gap: a
    camera that is off while its carrier turns may be on again after a few steps, no pause beside the others.

    Parameters
    ----------
    estimated : Images
        M frames, in order of time.
    linked : (M,) int, optional
        As of `line_poses`; a frame that is linked to none is of the line before it.
    """
    step = (estimated.world_from_body[:-1].inv() * estimated.world_from_body[1:]).magnitude()
    new = (np.diff(stretches(estimated.t)) > 0) | (step > _TURNED)
    if linked is not None:
        known = np.flatnonzero(linked >= 0)
        last = np.maximum.accumulate(np.where(linked >= 0, np.arange(len(linked)), -1))
        held = np.where(last >= 0, linked[last], linked[known[0]] if len(known) else -1)
        new |= np.diff(held) != 0
    return np.concatenate([[0], np.cumsum(new)]).astype(np.intp)


def sight_lines(
    sightings: Sightings, images: Images, estimated: Images, delay: Array, linked: Index | None = None
) -> Sightings:
    """The same sightings, each from the pose of its own line.

    Parameters
    ----------
    sightings : Sightings
        Of frames: one pose per image.
    images, estimated : Images
        Planned poses, and what is known of the true ones so far.
    delay : (N,)
        s from the first line of its frame to the line of each sighting.
    linked : (M,) int, optional
        As of `line_poses`.

    Returns
    -------
    Sightings
        One pose per sighting. Where departures from the plan are as estimated, its pose is the line's.
    """
    image = sightings.image
    moved, turned = line_poses(estimated, image, delay, linked)
    departure = (images.world_from_body.inv() * estimated.world_from_body)[image]
    # R exp(w) dR = (R exp(w) dR exp(-w)) exp(w)
    planned = images.world_from_body[image] * departure * turned * departure.inv()
    return replace(
        sightings,
        pose=as_index(np.arange(len(image)), "pose"),
        position=frozen(images.position[image] + moved),
        world_from_body=frozen(planned.as_matrix()),
    )
