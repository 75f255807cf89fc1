"""Poses of the frames between anchors without adjustment: slerp, a spline, S4's displacement and yaw.

For comparison: what lies between anchors is jitter, which a curve through them cannot know; displacement
scaled by one distance knows it but for the relief.

Not here: the adjustment of all frames (``poses.py``).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from sightline.errors import InputError
from sightline.geometry.checks import Array
from sightline.geometry.instrument import AreaDetector
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.subset import chained
from sightline.photogrammetry.sightings import Images

#: rad; a track that turns by more from one anchor to the next is flown in another direction.
_TURNED = 1.0

WAYS = ("slerp", "spline", "displacement")


def between_anchors(
    t: Array, anchors: NDArray[np.intp], position: Array, attitude: Rotation, way: str = "slerp"
) -> tuple[Array, Rotation]:
    """Poses at all times from those of anchors, along a curve.

    Parameters
    ----------
    t : (M,)
        s, increasing.
    anchors : (K,) int
        Frames whose poses are known, in order; two or more. Frames outside of them take the nearest.
    position : (K, 3)
        m
    attitude : Rotation
        K.
    way : str
        "slerp": straight lines and even turns; "spline": cubic through all anchors.

    Returns
    -------
    position : (M, 3)
    attitude : Rotation
        M.
    """
    if way not in WAYS[:2]:
        raise InputError(f"`way` must be {' or '.join(WAYS[:2])}, got {way!r}")
    if len(anchors) < 2:
        raise InputError(f"two anchors or more are needed, got {len(anchors)}")
    known = t[anchors]
    at = np.clip(t, known[0], known[-1])
    if way == "slerp":
        place = np.stack([np.interp(at, known, position[:, k]) for k in range(3)], axis=1)
        return place, Slerp(known, attitude)(at)
    return np.asarray(CubicSpline(known, position)(at)), RotationSpline(known, attitude)(at)


def by_displacement(
    t: Array,
    anchors: NDArray[np.intp],
    position: Array,
    attitude: Rotation,
    followed: Followed,
    detector: AreaDetector,
    mount: Rotation,
    distance: float,
    rough: Images | None = None,
) -> tuple[Array, Rotation]:
    """Poses at all times from those of anchors and how successive frames moved and turned (S4, 750/760).

    Parameters
    ----------
    t, anchors, position, attitude
        As of `between_anchors`.
    followed : Followed
        How frames moved.
    detector, mount
        Of all frames.
    distance : float
        m, from the camera to the ground: one for all.
    rough : Images, optional
        M, as well as poses are known otherwise.

    Returns
    -------
    position : (M, 3)
    attitude : Rotation
        M.

    Notes
    -----
    Places lie on straight lines. What they do not explain of the displacement is a turn; what is left at the
    next anchor is spread evenly over the frames before it. Where a link is missing, and outside of the
    anchors, poses depart from the rough ones as those of anchors do: there the flight may have turned.
    Without rough poses it is slerp.
    """
    place, turned = between_anchors(t, anchors, position, attitude)
    linked = [(followed.before[a + 1 : b + 1] == np.arange(a, b)).all() for a, b in pairwise(anchors)]
    if rough is not None:
        own = np.ones(len(t), dtype=bool)
        own[anchors] = False
        for (a, b), whole in zip(pairwise(anchors), linked, strict=True):
            own[a:b] &= not whole
        place_there, turned_there = _beside(t, anchors, position, attitude, rough)
        place = np.where(own[:, None], place_there, place)
        turned = Rotation.from_quat(np.where(own[:, None], turned_there.as_quat(), turned.as_quat()))
    out = list(turned)
    middle = 0.5 * (np.array(detector.shape) - 1.0)
    step = detector.directions(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    hand = np.sign(np.cross(step[1] - step[0], step[2] - step[0])[2])
    for n, (a, b) in enumerate(pairwise(anchors)):
        if not linked[n]:
            continue
        start = attitude[n] * mount
        ground = position[n] + distance * start.apply(step[0])
        motion, chain = np.zeros(4), []
        for k in range(a + 1, b + 1):
            motion = chained(motion, followed.motion[k])
            rolled = start * Rotation.from_rotvec([0.0, 0.0, -hand * motion[2]])
            seen = rolled.apply(detector.directions((middle + motion[:2])[None])[0])
            aim = (ground - place[k]) / np.linalg.norm(ground - place[k])
            chain.append(_onto(seen, aim) * rolled * mount.inv())
        left = (chain[-1].inv() * attitude[n + 1]).as_rotvec()
        for k in range(a + 1, b):
            share = (t[k] - t[a]) / (t[b] - t[a])
            out[k] = chain[k - a - 1] * Rotation.from_rotvec(share * left)
    return place, Rotation.concatenate(out)


def _beside(
    t: Array, anchors: NDArray[np.intp], position: Array, attitude: Rotation, rough: Images
) -> tuple[Array, Rotation]:
    """Poses that depart from rough ones as those of the anchors do, of places as most of them do."""
    place = rough.position + np.median(position - rough.position[anchors], axis=0)
    planned = rough.world_from_body[anchors]
    # where the track turns, a carrier turns with it, or keeps its nose where it is
    steps = _steps(planned)
    turns = steps > _TURNED
    if turns.any() and float(np.median(_steps(attitude)[turns] / steps[turns])) < 0.5:
        return place, between_anchors(t, anchors, position, attitude)[1]
    away = between_anchors(t, anchors, position, planned.inv() * attitude)[1]
    return place, rough.world_from_body * away


def _steps(attitude: Rotation) -> Array:
    """rad (K - 1,); by how much an attitude turns from each to the next."""
    return np.asarray((attitude[:-1].inv() * attitude[1:]).magnitude())


def _onto(first: Array, second: Array) -> Rotation:
    """The smallest rotation that takes one unit vector to another."""
    axis = np.cross(first, second)
    sine = float(np.linalg.norm(axis))
    if sine == 0.0:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, float(first @ second)))
