"""What is not known of the pose of each image beyond its camera's constant error.

Independent positions and attitudes (a star tracker beside a receiver), or attitudes that were rebuilt from
the measured positions, whose errors then go together.

Not here: the constant errors themselves (``bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.errors import InputError
from sightline.geometry.aim import aimed_axes
from sightline.geometry.checks import Array, ReadOnlyArrays, as_vector, frozen
from sightline.photogrammetry.sightings import Images, Index


@dataclass(frozen=True, eq=False)
class PoseNoise(ReadOnlyArrays):
    """Errors of planned poses that differ from shot to shot.

    Attributes
    ----------
    position : float
        m, 1-sigma per axis; independent from image to image.
    attitude : float
        rad, 1-sigma per body axis; independent from image to image and of positions.
    aim_point : (3,) or None
        m, world axes. Given, attitudes are not measured: each camera did look at this point from where it
        truly was, with y square to the plane of both cameras and it, and the attitudes in hand were rebuilt
        so from the measured positions. Two cameras only.
    """

    position: float
    attitude: float
    aim_point: Array | None = None

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name, unit in (("position", "m"), ("attitude", "rad")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"`{name}` noise must be 0 or more, got {value} {unit}")
        if self.aim_point is not None:
            object.__setattr__(self, "aim_point", frozen(as_vector(self.aim_point, "aim_point")))


def aim_sensitivity(images: Images, aim_point: Array) -> tuple[Index, Array]:
    """How attitudes rebuilt from positions turn with the errors of these.

    Parameters
    ----------
    images : Images
        Of two cameras, both in every shot.
    aim_point : (3,)
        m, world axes.

    Returns
    -------
    partner : (M,) int
        The other image of the same shot.
    turn : (M, 2, 3, 3)
        rad/m: rotation vector in body axes of each image by a move (world axes) of its own camera, and of its
        partner's, when the boresight stays on the aim point.
    """
    partner = partners(images)
    own = images.position
    other = own[partner]
    leads = images.camera < images.camera[partner]
    turn = np.empty((len(images), 2, 3, 3))
    body = images.world_from_body.as_matrix()
    step = 1e-5 * float(np.linalg.norm(own - aim_point, axis=1).min())
    for which in range(2):
        for axis in range(3):
            move = np.zeros(3)
            move[axis] = step
            ends = []
            for sign in (1.0, -1.0):
                here = own + (sign * move if which == 0 else 0.0)
                there = other + (sign * move if which == 1 else 0.0)
                a, b = aimed_axes(
                    np.where(leads[:, None], here, there), np.where(leads[:, None], there, here), aim_point
                )
                ends.append(np.where(leads[:, None, None], a, b))
            # small rotation from one end to the other, world axes
            difference = (ends[0] @ np.swapaxes(ends[1], 1, 2)) / (2.0 * step)
            w = 0.5 * np.stack(
                [
                    difference[:, 2, 1] - difference[:, 1, 2],
                    difference[:, 0, 2] - difference[:, 2, 0],
                    difference[:, 1, 0] - difference[:, 0, 1],
                ],
                axis=1,
            )
            turn[:, which, :, axis] = np.einsum("nji,nj->ni", body, w)
    return partner, turn


def partners(images: Images) -> Index:
    """The other image (M,) of each shot of two cameras; InputError where a shot has not exactly two."""
    order = np.argsort(images.shot, kind="stable")
    shots = images.shot[order]
    whole = len(order) % 2 == 0 and bool((shots[0::2] == shots[1::2]).all())
    if not whole or len(np.unique(images.shot)) * 2 != len(order):
        raise InputError(
            "attitudes rebuilt from positions need two cameras in every shot; give both images of each "
            'shot, or say attitude_knowledge = "independent"'
        )
    partner = np.empty(len(order), dtype=np.intp)
    partner[order[0::2]], partner[order[1::2]] = order[1::2], order[0::2]
    return partner
