"""Photographs whose pixels were turned since they were taken, recognised by how they lie to each other.

Programs that show photographs upright write them anew, turned by a half or a quarter; the angles given with
them stay as they were. How frames follow each other shows it, and which of them are as they were: ground
moves over the pixels against the flight.

Not here: how frames moved (``matching/follow.py``, ``wide_links.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Surface
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Images, Index, as_index

Complex = NDArray[np.complex128]

#: rad; a turn further from whole quarters is none of them.
_CLEAR = np.radians(30.0)
#: Least correlation of motions seen with those given: less shows no direction.
_ALONG = 0.3
#: By how much the logarithm of a turn's likelihood must exceed that of others, and of none: frames that are
#: turned are rare.
_LIKELIER, _RARE = 3.0, 9.0
#: px; step over which the turn between two frames is taken.
_STEP = 50.0


def quarter_turns(
    images: Images,
    known: RoughPoses,
    detector: AreaDetector,
    mount: Rotation,
    surface: Surface,
    followed: Followed,
) -> Index:
    """By how many quarters (M,) of a turn, from line towards column, each frame is turned against its angles.

    Parameters
    ----------
    images : Images
        M rough poses.
    known : RoughPoses
        Frames without angles of their own are left alone.
    detector, mount
        Of all frames.
    surface : Surface
    followed : Followed
        How frames moved.
    """
    count = len(images)
    given = np.asarray(np.isfinite(known.attitude).all(axis=1))
    cameras = frame_cameras(images, [detector], [mount])
    middle = 0.5 * (np.array(detector.shape) - 1.0)
    places = middle + np.array([[0.0, 0.0], [_STEP, 0.0]])
    chain, own = np.arange(count), np.zeros(count, dtype=np.intp)
    seen, planned = np.zeros(count, dtype=complex), np.zeros(count, dtype=complex)
    loose = _pixel_noise(images, known, detector, mount, surface)
    for k in np.flatnonzero(followed.before >= 0):
        i = int(followed.before[k])
        if not (given[i] and given[k]):
            continue
        there = cameras[k].project(cameras[i].locate(places, surface))
        if not np.isfinite(there).all():
            continue
        turn = _complex(there[1] - there[0])
        quarters, clear = _quarters(followed.motion[k, 2] - float(np.angle(turn)))
        if not clear:
            continue
        chain[k], own[k] = chain[i], own[i] + quarters
        seen[k] = _complex(followed.motion[k, :2]) * 1j ** -int(own[k])
        planned[k] = _complex(there[0] - middle)
    for first in np.unique(chain):
        rows = chain == first
        common = (seen * planned.conj())[rows].sum()
        size = np.sqrt((np.abs(seen[rows]) ** 2).sum() * (np.abs(planned[rows]) ** 2).sum())
        quarters, clear = _quarters(float(np.angle(common)))
        likely = _likelihoods(common, np.where(rows, seen, 0.0), followed.before, loose)
        likely[0] += _RARE - _LIKELIER
        margin = likely[quarters % 4] - np.delete(likely, quarters % 4).max()
        if size > 0.0 and abs(common) > _ALONG * size and clear and margin > _LIKELIER:
            own[rows] += quarters
        elif rows.sum() > 1:
            # no motion shows which are as they were: most of them
            own[rows] -= np.bincount(own[rows] % 4).argmax()
    return as_index(own % 4, "quarter turns")


def _likelihoods(common: complex, seen: Complex, before: Index, loose: Array) -> Array:
    """Logarithms (4,), but for a constant, of how likely turns by so many quarters are.

    Given motions are those seen, turned back, plus the errors of two positions. Of successive frames those
    of the positions between cancel, but for how motions differ.
    """
    weight = seen.copy()
    rows = np.flatnonzero(seen)
    np.subtract.at(weight, before[rows], seen[rows])
    own = np.flatnonzero(weight)
    variance = float((np.abs(weight[own]) ** 2 * loose[own] ** 2).sum())
    expected = float((np.abs(seen) ** 2).sum()) * 1j ** np.arange(4)
    if not 0.0 < variance < np.inf:
        return np.zeros(4)
    return np.asarray((common * expected.conj()).real / variance)


def _pixel_noise(
    images: Images, known: RoughPoses, detector: AreaDetector, mount: Rotation, surface: Surface
) -> Array:
    """px (M,), 1-sigma per axis: by what the error of a position moves the ground in a frame's middle."""
    axis = images.world_from_body.apply(mount.as_matrix()[:, 2])
    far = np.linalg.norm(surface.intersect(images.position, axis) - images.position, axis=1)
    sigma = np.sqrt((known.along_world() ** 2).mean(axis=1)) * detector.focal_length_px / far
    given = np.isfinite(sigma)
    # one between others that are given is as good as these
    return np.where(given, sigma, np.median(sigma[given]) if given.any() else np.inf)


def _complex(vector: Array) -> complex:
    """(line, column) as a number whose angle counts from line towards column."""
    return complex(float(vector[0]), float(vector[1]))


def _quarters(angle: float) -> tuple[int, bool]:
    """Nearest number of quarters, and whether it is near."""
    number = int(np.rint(angle / (0.5 * np.pi)))
    return number, abs(angle - 0.5 * np.pi * number) < _CLEAR


def turned_images(images: Images, angle: Array, detector: AreaDetector, mount: Rotation) -> Images:
    """Images whose frames (M,) are turned about their axes by `angle` rad, from line towards column."""
    by = _about_axis(-angle, detector)
    return replace(images, world_from_body=images.world_from_body * mount * by * mount.inv())


def _about_axis(angle: Array, detector: AreaDetector) -> Rotation:
    """Turns of a camera that carry its pixels from line towards column."""
    middle = 0.5 * (np.array(detector.shape) - 1.0)
    step = detector.directions(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    hand = np.sign(np.cross(step[1] - step[0], step[2] - step[0])[2])
    return Rotation.from_rotvec(hand * np.outer(angle, [0.0, 0.0, 1.0]))


def carried_attitudes(
    images: Images, known: RoughPoses, detector: AreaDetector, mount: Rotation, followed: Followed
) -> Images:
    """Images whose frames without angles of their own have those of a neighbour, turned as pixels turned.

    Parameters
    ----------
    images, known, detector, mount, followed
        As of `quarter_turns`.
    """
    has = np.array(np.isfinite(known.attitude).all(axis=1))
    attitude = list(images.world_from_body)
    links = [(int(followed.before[k]), int(k)) for k in np.flatnonzero(followed.before >= 0)]
    while True:
        open_ = [(i, k) for i, k in links if has[i] != has[k]]
        if not open_:
            break
        for i, k in open_:
            if has[i] == has[k]:
                continue
            start, end, sign = (i, k, -1.0) if has[i] else (k, i, 1.0)
            by = _about_axis(np.array([sign * followed.motion[k, 2]]), detector)[0]
            attitude[end] = attitude[start] * mount * by * mount.inv()
            has[end] = True
    return replace(images, world_from_body=Rotation.concatenate(attitude))
