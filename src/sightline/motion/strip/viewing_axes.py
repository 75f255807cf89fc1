"""Axes along the line of sight, in which the three angles do not stand for each other.

A camera that looks far from the body's z (a scan mirror, a tilted mount) sees a yaw of the body mostly as
what a pitch or roll does: the whole image shifts. Only the turn of the image, hundreds of times smaller,
tells them apart. The motion is therefore estimated about axes whose z is the mean line of sight: shifts
along and across the scan, which are seen well, and the turn about it. Angles are small: they are turned back
into body axes exactly.

Not here: the estimate itself (``joint.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.estimation.prior import Matern, Spectrum, TabulatedPsd, Tone
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.pointing import pointing_matrices, turned_pointing
from sightline.motion.measure.common_view import Views, usable
from sightline.motion.measure.observations import Star
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
Part = Matern | Tone | TabulatedPsd

#: The line of sight is off the body's z where the angle between them (rad) is larger than so many times half
#: of what the matches span across the field: there yaw shifts the image by more than it turns it. Where the
#: matches span the whole field it is also larger than OFF_AXIS.
OFF_SPANS, OFF_AXIS = 2.0, 0.02
#: Lines of each image at which the line of sight is looked at.
_LINES = 9


def viewing_axes(cameras: Sequence[PushbroomCamera], views: Views) -> Rotation | None:
    """body_from_viewing: the least turn that takes the body's z to the mean line of sight of the matches.

    None where they are near each other, and body axes serve as they are.

    Parameters
    ----------
    cameras : sequence of PushbroomCamera
    views : mapping
        What they see in common, from `common_view.common_views`.
    """
    looks, half_spans, whole = [], [], True
    for (image, _), (first, last) in sorted(views.items()):
        camera = cameras[image]
        t = camera.times(np.linspace(0.0, camera.lines - 1.0, _LINES))
        middle = camera.detector.directions_at([0.5 * (first + last)])[0]
        looks.append(pointing_matrices(camera.pointing, t) @ middle)
        half_spans.append(0.5 * camera.detector.pixel_step * (last - first))
        whole &= usable((first, last), camera.columns) is None
    if not looks:
        return None
    mean = np.concatenate(looks).mean(axis=0)
    mean /= np.sqrt(mean @ mean)
    axis = np.cross([0.0, 0.0, 1.0], mean)
    sine = float(np.sqrt(axis @ axis))
    angle = float(np.arctan2(sine, mean[2]))
    if angle <= max(OFF_AXIS if whole else 0.0, OFF_SPANS * min(half_spans)):
        return None
    # looking back along the body's -z any axis across it serves
    axis = np.array([1.0, 0.0, 0.0]) if sine < 1e-9 else axis / sine
    return Rotation.from_rotvec(angle * axis)


def in_axes(camera: PushbroomCamera, body_from_other: Rotation) -> PushbroomCamera:
    """The same camera with the body's axes replaced by others fixed in the body."""
    trajectory = camera.trajectory
    motion = trajectory.motion
    if motion is not None:
        motion = replace(motion, angles=motion.angles @ body_from_other.as_matrix(), covariance=None)
    lever = body_from_other.inv().apply(camera.lever_arm)
    return replace(
        camera,
        trajectory=replace(
            trajectory, world_from_body=trajectory.world_from_body * body_from_other, motion=motion
        ),
        pointing=turned_pointing(camera.pointing, body_from_other),
        lever_arm=(float(lever[0]), float(lever[1]), float(lever[2])),
    )


def turned_directions(directions: Array, turn: Array) -> Array:
    """Hidden directions (N, 3, H) in the axes that `turn` (3, 3) leads to, each again of its own axis.

    They come in threes, one per axis; of what is over, each keeps the axis it was of.
    """
    count = directions.shape[2] // 3
    whole, over = directions[..., : 3 * count], directions[..., 3 * count :]
    mixed = whole.reshape(*whole.shape[:2], count, 3)
    turned = np.einsum("pa,nagb,qb->npgq", turn, mixed, turn).reshape(whole.shape)
    return np.concatenate([turned, turn @ over], axis=2)


def turned_amplitudes(covariance: Array, turn: Array) -> Array:
    """Covariance (H, H) of how much a motion holds of `turned_directions`, from that of the directions."""
    size = len(covariance)
    change = np.eye(size)
    for first in range(0, size - 2, 3):
        change[first : first + 3, first : first + 3] = turn
    return np.asarray(change @ covariance @ change.T)


def turned_spectra(
    spectra: tuple[Spectrum, Spectrum, Spectrum], turn: Array
) -> tuple[Spectrum, Spectrum, Spectrum]:
    """Spectra of the three angles in the axes that `turn` leads to, of angles independent before."""
    roll, pitch, yaw = (Spectrum(parts) for parts in _turned_parts([s.components for s in spectra], turn))
    return roll, pitch, yaw


def turned_errors(errors: Sequence[Sequence[Part]], turn: Array) -> tuple[Spectrum | None, ...]:
    """Errors of the three angles, independent, in the axes that `turn` leads to; None where none are."""
    return tuple(Spectrum(parts) if parts else None for parts in _turned_parts(errors, turn))


def _turned_parts(parts: Sequence[Sequence[Part]], turn: Array) -> list[tuple[Part, ...]]:
    """What the three angles hold, of angles independent before that hold `parts`."""
    return [
        tuple(
            c
            for own, w in zip(parts, row, strict=True)
            if own and abs(w) > 1e-6
            for c in Spectrum(tuple(own)).scaled(abs(float(w))).components
        )
        for row in turn
    ]


def turned_star(star: Star, turn: Array) -> Star:
    """A star whose sensitivities are those to the angles in the axes that `turn` leads to."""
    if np.array_equal(turn, np.eye(3)):
        return star
    back = turn.T.astype(np.float32)
    uneven = star.uneven
    if uneven is not None:
        uneven = np.einsum("gksiab,ac->gksicb", uneven, back)
    return replace(star, by_hub=star.by_hub @ back, by_partner=star.by_partner @ back, uneven=uneven)


def turned_band(band: Array, turn: Array) -> Array:
    """Banded covariance of node angles, ``band[d, j] = C[j + d, j]`` with unknowns 3 node + axis, turned."""
    out = scratch_array(band.shape)
    count = band.shape[1] // 3
    for apart in range(len(band) // 3):
        lower = 3 * np.arange(count - apart)
        block = np.empty((len(lower), 3, 3))
        for p in range(3):
            for q in range(3):
                d = 3 * apart + p - q
                block[:, p, q] = band[d, lower + q] if d >= 0 else band[-d, lower + p]
        block = turn @ block @ turn.T
        for p in range(3):
            for q in range(3):
                if 3 * apart + p - q >= 0:
                    out[3 * apart + p - q, lower + q] = block[:, p, q]
        let_go()
    return out
