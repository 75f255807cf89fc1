"""How matches answer where the lines of an image stand unevenly on the ground.

A platform that pitches to and fro takes lines closer together and farther apart. A turn of the line of sight
then moves the lines of one window by unlike numbers of lines, and a match finds a mean of these in which
lines count by their detail, and by what the filter takes from their neighbours: at rates of the scan that
vary by a quarter, three quarters of what the rate at the middle of the window would ask for. The share is
measured: a partner is laid on the hub once more, by a camera that was turned a little.

Not here: pixels of unlike size, which answer otherwise too (``aliasing.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.execution import slices
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.matching.matches import Matches
from sightline.motion.measure.aliasing import RESPONSE_STEP
from sightline.motion.measure.predict import AT_ONCE, MovingCamera, ground_of_column, turned
from sightline.writing import let_go

Array = NDArray[np.float64]

#: Relative spread (rms) of the distances of lines from which on answers are measured: their mean departs by
#: the square of it and more, 1 % here and 16 % at a quarter.
UNEVEN = 0.1
#: An answer farther from that of most windows than this is a false match, and one of less than that a window
#: whose lines all but stand on one another.
FARTHEST, LEAST = 0.5, 0.3
#: Angles that may move lines: roll and pitch.
TURNS = 2


def uneven(camera: MovingCamera, surface: Surface) -> bool:
    """Whether the lines of a camera stand so unevenly on the ground that matches answer by less."""
    if not isinstance(camera, PushbroomCamera) or camera.trajectory.motion is None or camera.lines < 2:
        return False
    steps = np.diff(ground_of_column(camera, surface, 0.5 * (camera.columns - 1.0)), axis=0)
    steps = steps[np.isfinite(steps).all(axis=1)]
    if not len(steps):
        return False
    track = steps.mean(axis=0)
    along = steps @ track / max(float(track @ track), np.finfo(float).tiny)
    return bool(along.std() > UNEVEN)


def answers(
    cameras: Sequence[MovingCamera],
    partner: int,
    matches: Matches,
    by_partner: NDArray[np.float32],
    affine: Array,
    matched: Callable[[Sequence[MovingCamera]], Matches],
) -> Array:
    """Shares (G,) of the motion along lines that matches find, 1 where they find all of it.

    Parameters
    ----------
    cameras : sequence of cameras
        Of all images, with the best motion known.
    partner : int
    matches : Matches
        Of the hub's windows with the partner laid on it by these.
    by_partner : (G, 2, 3)
        px/rad; change of the predicted partner with its attitude.
    affine : (G, 2, 2)
        px/px; change of the predicted partner with the pixel of the hub.
    matched : callable
        The same matches with the partner laid on the hub by other cameras.
    """
    out = np.ones(len(affine))
    good = np.flatnonzero(matches.kept & np.isfinite(by_partner).all(axis=(1, 2)))
    if not len(good):
        return out
    along = by_partner[good, 0, :TURNS].astype(np.float64)
    usual = np.median(np.abs(along), axis=0)
    axis = int(np.argmax(usual))
    if not usual[axis] > 0.0:
        return out
    turn = np.zeros(3)
    turn[axis] = RESPONSE_STEP / usual[axis]
    other = list(cameras)
    other[partner] = turned(cameras[partner], turn)
    moved = matched(other)
    share = np.empty(len(good))
    for part in slices(len(good), AT_ONCE):
        some = good[part]
        found = np.einsum("nj,nj->n", affine[some, 0], moved.b[some] - matches.b[some])
        with np.errstate(invalid="ignore", divide="ignore"):
            share[part] = -found / (along[part, axis] * turn[axis])
        let_go()
    usable = moved.kept[good] & np.isfinite(share)
    if not usable.any():
        return out
    middle = max(float(np.median(share[usable])), LEAST)
    usable &= (np.abs(share - middle) <= FARTHEST) & (share >= LEAST)
    out[good] = np.where(usable, share, middle)
    return out
