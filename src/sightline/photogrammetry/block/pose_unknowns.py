"""Unknowns of the poses of a block: what is constant of each camera, and what differs from shot to shot.

Each image departs from its plan by x = (turn of the body, move, stretch of the focal length). x is a linear
map of few global unknowns (constant angles of its camera, their drift, its focal length) and of the shot's
own, whose covariance is known. Images of a shot sit in slots, so that all shots have one size.

Not here: what sightings say of them (``bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.block.observability import LIMIT
from sightline.photogrammetry.block.pose_noise import PoseNoise, aim_sensitivity
from sightline.photogrammetry.sightings import Index, Sightings, as_index, frames_of

#: Numbers of x: turn (3), move (3), and the stretch of the focal length where it is sought.
TURN, MOVE, STRETCH = slice(0, 3), slice(3, 6), 6


@dataclass(frozen=True, eq=False)
class PoseUnknowns(ReadOnlyArrays):
    """How the departures of all images follow from few unknowns.

    Attributes
    ----------
    shot, slot : (M,) int
        Where each image sits: row of the shots (K of them), place among the images of a shot (n of them).
    by_shot : (K, n D, 6 n), or (K, n D, 6) of a rig
        Departure of a shot's images by its own unknowns, which have unit covariance.
    by_global : (K, n D, G)
        Departure by the global unknowns.
    global_information : (G,)
        Of what is known of global unknowns beforehand: 1/sigma^2 about zero.
    names : tuple of str
        Of the global unknowns: ``roll_1``, ``roll_drift_1``, ``stretch_1`` ...; numbers are of cameras.
    time : (2,)
        s: middle of the times and half their span; a drift is in rad per half the span.
    precision : (K, 1 + s, 6 n, 6 n) or None
        What is known beforehand of the shots' own unknowns, where shots are tied to their neighbours:
        precision[k, d] has the rows of shot k and the columns of shot k - d. None: each has unit covariance.
    limit : float
        Sigma of a global unknown from which on it counts as not observable (their unit).
    pull : (K, 6 n) or None
        Slope of the prior's cost (half of it) where the shots' own unknowns are zero, where it is not least
        there; with `rest`, what it costs there.
    rest : float
    last : (K,) bool or None
        Shots that are solved after all others, as points tie them to shots far away; None: the order of shots
        serves all.
    """

    shot: Index
    slot: Index
    by_shot: Array
    by_global: Array
    global_information: Array
    names: tuple[str, ...]
    time: tuple[float, float]
    precision: Array | None = None
    limit: float = LIMIT
    pull: Array | None = None
    rest: float = 0.0
    last: NDArray[np.bool_] | None = None

    @property
    def shots(self) -> int:
        """Number of shots."""
        return len(self.by_shot)

    @property
    def width(self) -> int:
        """Numbers of x per image: 6, or 7 where focal lengths are sought."""
        return self.by_shot.shape[1] // self.slots

    @property
    def slots(self) -> int:
        """Most images of one shot."""
        return int(self.slot.max()) + 1

    @property
    def own(self) -> int:
        """Unknowns of a shot: 6 of each of its images, or 6 in all of a rig, which moves as one."""
        return self.by_shot.shape[2]

    def of_images(self) -> tuple[Array, Array]:
        """Departure of each image by its shot's own (M, D, own) and by the global unknowns (M, D, G)."""
        shape = self.shots, self.slots, self.width, -1
        place = self.shot, self.slot
        return self.by_shot.reshape(shape)[place], self.by_global.reshape(shape)[place]

    @property
    def globals(self) -> int:
        """Number of global unknowns."""
        return self.by_global.shape[2]

    def prior_block(self, step: int) -> Array:
        """Prior precision between shots (K - step, 6 n, 6 n), or (6 n, 6 n) where it is the same for all."""
        size = self.own
        if self.precision is None:
            return np.eye(size) if step == 0 else np.zeros((size, size))
        if step >= self.precision.shape[1]:
            return np.zeros((size, size))
        return self.precision[step:, step]

    def prior_times(self, own: Array) -> Array:
        """Prior precision times unknowns (K, 6 n): the pull of the prior, reversed."""
        if self.precision is None:
            return own
        out = np.einsum("kab,kb->ka", self.precision[:, 0], own)
        for step in range(1, self.precision.shape[1]):
            block = self.precision[step:, step]
            out[step:] += np.einsum("kab,kb->ka", block, own[:-step])
            out[:-step] += np.einsum("kab,ka->kb", block, own[step:])
        return out

    def prior_slope(self, own: Array) -> tuple[Array, float]:
        """Slope (K, 6 n) of half the prior's cost, and the cost."""
        pulled = self.prior_times(own)
        cost = float((own * pulled).sum()) + self.rest
        if self.pull is None:
            return pulled, cost
        return pulled + self.pull, cost + 2.0 * float((own * self.pull).sum())

    def departures(self, own: Array, common: Array) -> Array:
        """x (M, D, ...) of all images: `own` (K, 6 n, ...) and `common` (G, ...) unknowns."""
        x = np.einsum("kij,kj...->ki...", self.by_shot, own) + self.by_global @ common
        split = x.reshape(self.shots, self.slots, self.width, *x.shape[2:])
        return np.ascontiguousarray(split[self.shot, self.slot])


def pose_unknowns(
    sightings: Sightings,
    noise: PoseNoise,
    *,
    drift: bool = False,
    focal_sigma: tuple[float, ...] | None = None,
) -> PoseUnknowns:
    """Unknowns of the poses of a block.

    Parameters
    ----------
    sightings : Sightings
    noise : PoseNoise
        What is not known of each pose beyond the constant errors.
    drift : bool
        Whether the errors of each camera also drift evenly with time.
    focal_sigma : tuple of float, optional
        Per camera, 1-sigma of the relative error of its focal length: 0 keeps it, inf leaves it free.

    Returns
    -------
    PoseUnknowns
    """
    names, shot = np.unique(sightings.shot, return_inverse=True)
    order = np.lexsort((sightings.camera, shot))
    first = np.searchsorted(shot[order], np.arange(len(names)))
    slot = np.empty(len(shot), dtype=np.intp)
    slot[order] = np.arange(len(shot)) - first[shot[order]]
    stretched = [] if focal_sigma is None else [c for c, sigma in enumerate(focal_sigma) if sigma > 0.0]
    width, slots = (7 if stretched else 6), int(slot.max()) + 1
    by_shot = _by_shot(sightings, noise, shot, slot, (len(names), slots, width))
    middle, half = 0.5 * (sightings.t.max() + sightings.t.min()), 0.5 * np.ptp(sightings.t)
    if drift and not half > 0.0:
        raise InputError("a drift cannot be sought in images of one instant; leave `drift` out")
    count, cameras = len(shot), sightings.cameras
    parts, labels, information = [np.zeros((count, width, 0))], [], []
    for power, label in ((0, ""), (1, "_drift"))[: 2 if drift else 1]:
        columns = np.zeros((count, width, 3 * cameras))
        for axis in range(3):
            scale = ((sightings.t - middle) / half) ** power if power else 1.0
            columns[np.arange(count), axis, 3 * sightings.camera + axis] = scale
        parts.append(columns)
        labels += [f"{axis}{label}_{c + 1}" for c in range(cameras) for axis in ("roll", "pitch", "yaw")]
        information += [0.0] * (3 * cameras)
    for c in stretched:
        column = np.zeros((count, width, 1))
        column[sightings.camera == c, STRETCH, 0] = 1.0
        parts.append(column)
        labels.append(f"stretch_{c + 1}")
        information.append(float((focal_sigma or ())[c]) ** -2)
    by_image = np.concatenate(parts, axis=2)
    by_global = np.zeros((len(names), slots, width, by_image.shape[2]))
    by_global[shot, slot] = by_image
    return PoseUnknowns(
        as_index(shot, "shot"),
        as_index(slot, "slot"),
        frozen(by_shot),
        frozen(by_global.reshape(len(names), slots * width, -1)),
        frozen(np.array(information)),
        tuple(labels),
        (float(middle), float(half)),
    )


def _by_shot(
    sightings: Sightings, noise: PoseNoise, shot: Index, slot: Index, shape: tuple[int, int, int]
) -> Array:
    """(K, n D, 6 n): square roots of the covariance of each shot's departures."""
    shots, slots, width = shape
    out = np.zeros((shots, slots, width, slots, 6))
    for axis in range(3):
        out[shot, slot, axis, slot, axis] = noise.attitude
        out[shot, slot, 3 + axis, slot, 3 + axis] = noise.position
    if noise.aim_point is not None:
        # a position that is wrong by a move turns the rebuilt attitude of its own image and of its partner
        partner, turn = aim_sensitivity(frames_of(sightings), noise.aim_point)
        for axis in range(3):
            out[shot, slot, :3, slot, 3 + axis] += noise.position * turn[:, 0, :, axis]
            out[shot, slot, :3, slot[partner], 3 + axis] += noise.position * turn[:, 1, :, axis]
    return out.reshape(shots, slots * width, slots * 6)
