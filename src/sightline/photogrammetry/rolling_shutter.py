"""Frames whose lines are exposed one after the other: each sighting from the pose of its own line.

Within a frame the camera moves as the path through all frames does. What a frame's pose departs from its plan
by is the same for all its lines.

Not here: the poses of the frames (``frame_poses.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.frame_poses import path_turns, stretches
from sightline.photogrammetry.sightings import Images, Index, Sightings, as_index


def line_poses(estimated: Images, image: Index, delay: Array) -> tuple[Array, Rotation]:
    """How the camera moved and turned since a frame's first line, along a spline through all frames.

    Parameters
    ----------
    estimated : Images
        Poses of M frames at their first lines.
    image : (N,) int
        Frame of each place asked for.
    delay : (N,)
        s after its first line.

    Returns
    -------
    moved : (N, 3)
        m, world axes.
    turned : Rotation
        N, body axes.
    """
    stretch = stretches(estimated.t)
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


def sight_lines(sightings: Sightings, images: Images, estimated: Images, delay: Array) -> Sightings:
    """The same sightings, each from the pose of its own line.

    Parameters
    ----------
    sightings : Sightings
        Of frames: one pose per image.
    images, estimated : Images
        Planned poses, and what is known of the true ones so far.
    delay : (N,)
        s from the first line of its frame to the line of each sighting.

    Returns
    -------
    Sightings
        One pose per sighting. Where departures from the plan are as estimated, its pose is the line's.
    """
    image = sightings.image
    moved, turned = line_poses(estimated, image, delay)
    departure = (images.world_from_body.inv() * estimated.world_from_body)[image]
    # R exp(w) dR = (R exp(w) dR exp(-w)) exp(w)
    planned = images.world_from_body[image] * departure * turned * departure.inv()
    return replace(
        sightings,
        pose=as_index(np.arange(len(image)), "pose"),
        position=frozen(images.position[image] + moved),
        world_from_body=frozen(planned.as_matrix()),
    )
