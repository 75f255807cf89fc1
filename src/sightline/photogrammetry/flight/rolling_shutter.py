"""Frames whose lines are exposed one after the other: sightings as of the first.

Within a frame the camera moves as the path through all frames does, as last found; sightings are brought to
its first line by that.

Not here: the poses of the frames (``poses.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, frozen
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.path import path_turns, stretches
from sightline.photogrammetry.sightings import Images, Index, Sightings

#: rad; frames that are turned by more against the one before are of another flight line.
_TURNED = 0.5


def line_delays(lines: Array, readout_time: float, shape: tuple[int, int]) -> Array:
    """s (N,) from the exposure of a frame's first line to those of `lines`, fractions allowed."""
    return np.asarray(readout_time * lines / (shape[0] - 1.0))


def first_line_pixels(
    image: Index, pixels: Array, followed: Followed, t: Array, readout_time: float, shape: tuple[int, int]
) -> Array:
    """Pixels (N, 2) where points would be if all lines were exposed with the first, by how frames move.

    Relief apart, whose share of the motion within a frame is not known yet.

    Parameters
    ----------
    image : (N,) int
        Frame in which each was seen.
    pixels : (N, 2)
    followed : Followed
        How the M frames moved.
    t : (M,)
        s, of their first lines.
    readout_time : float
        s from the exposure of the first line to that of the last.
    shape : (int, int)
    """
    rate = np.zeros((len(t), 4))
    weight = np.zeros(len(t))
    line = stretches(t)
    for k in np.flatnonzero(followed.before >= 0):
        if line[k] != line[followed.before[k]] or not abs(followed.motion[k, 2]) < _TURNED:
            continue  # how it came from one flight line to another is not how it moves within a frame
        each = followed.motion[k] / (t[k] - t[followed.before[k]])
        for frame in (int(k), int(followed.before[k])):
            rate[frame] += each
            weight[frame] += 1.0
    rate /= np.maximum(weight, 1.0)[:, None]
    moved = rate[image] * line_delays(pixels[:, 0], readout_time, shape)[:, None]
    x = pixels - 0.5 * (np.array(shape) - 1.0)
    turn, growth = moved[:, 2], moved[:, 3]
    shift = moved[:, :2] + np.stack(
        [growth * x[:, 0] - turn * x[:, 1], turn * x[:, 0] + growth * x[:, 1]], axis=1
    )
    return np.asarray(pixels - shift)


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


def as_of_first_lines(
    sightings: Sightings, estimated: Images, points: Array, delay: Array, linked: Index | None = None
) -> Sightings:
    """The same sightings as if every frame had been exposed with its first line.

    Parameters
    ----------
    sightings : Sightings
        Of frames: one pose per image.
    estimated : Images
        What is known of the true poses at first lines so far.
    points : (n, 3)
        m, world axes; where points are, by these poses. NaN where that is not known: as far as the others.
    delay : (N,)
        s from the first line of its frame to the line of each sighting.
    linked : (M,) int, optional
        As of `line_poses`.

    Returns
    -------
    Sightings
        Less what a point is displaced by between its line's pose and the first's.

    Notes
    -----
    What is taken off stays the same when poses and points are turned, moved and scaled together: it says
    nothing of where the flight lies. Lines with poses of their own, held while that of the frame is sought,
    would: a turn of all frames does not commute with the turn from line to line, and a move within the frame
    has a direction and a length.
    """
    image = sightings.image
    moved, turned = line_poses(estimated, image, delay, linked)
    camera = sightings.body_from_camera[sightings.camera[image]]
    first = estimated.world_from_body[image]
    away = _away(sightings, estimated, points)
    by_line = np.einsum("nji,nj->ni", camera, (first * turned).inv().apply(away - moved))
    by_first = np.einsum("nji,nj->ni", camera, first.inv().apply(away))
    displaced = by_line[:, :2] / by_line[:, 2:] - by_first[:, :2] / by_first[:, 2:]
    return replace(sightings, tangents=frozen(sightings.tangents - displaced))


def _away(sightings: Sightings, estimated: Images, points: Array) -> Array:
    """m (N, 3): from the first line's place of its frame to each point that is sighted."""
    image = sightings.image
    away = points[sightings.point] - estimated.position[image]
    rays = np.column_stack([sightings.tangents, np.ones(len(image))])
    rays = np.einsum("nij,nj->ni", sightings.body_from_camera[sightings.camera[image]], rays)
    rays = estimated.world_from_body[image].apply(rays)
    depth = np.einsum("ni,ni->n", away, rays) / np.einsum("ni,ni->n", rays, rays)
    known = depth > 0.0
    usual = float(np.median(depth[known])) if known.any() else np.inf
    return np.where(known[:, None], away, usual * rays)
