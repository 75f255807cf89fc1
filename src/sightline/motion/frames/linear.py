"""Residuals and sensitivities of all matches between frames about given cameras.

Every changed camera (turned, a little later, with another lens) is made once and used by all
pairs, for a frame has one pose and evaluating it costs more than using it.

Not here: sensitivities of strips, line by line (``motion/measure/sampled_sensitivities.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.motion.frames.matches import FrameStar
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.measure.predict import ANGLE_STEP, HEIGHT_STEP, MovingCamera, StaticParameter, turned
from sightline.motion.measure.windows import exposure_times, field_positions

Array = NDArray[np.float64]
#: One image's cameras with an unknown a step further and a step back.
Sides = tuple[MovingCamera, MovingCamera]


@dataclass(frozen=True, eq=False)
class SteppedCameras:
    """Cameras, and the same with every unknown changed by its step either way.

    Attributes
    ----------
    base : list of FrameCamera
    angles : per image, per axis
        (plus, minus)
    statics : per parameter, {image: (plus, minus)}
        Only the images it touches.
    parameters : sequence of StaticParameter
    """

    base: Sequence[FrameCamera]
    angles: list[list[Sides]]
    statics: list[dict[int, Sides]]
    parameters: Sequence[StaticParameter]

    @classmethod
    def about(cls, cameras: Sequence[FrameCamera], parameters: Sequence[StaticParameter]) -> SteppedCameras:
        """Step every unknown of `cameras`."""
        turns = ANGLE_STEP * np.eye(3)
        angles: list[list[Sides]] = [[(turned(c, turn), turned(c, -turn)) for turn in turns] for c in cameras]
        statics: list[dict[int, Sides]] = []
        for parameter in parameters:
            plus, minus = parameter.apply(cameras, parameter.step), parameter.apply(cameras, -parameter.step)
            statics.append({image: (plus[image], minus[image]) for image in parameter.images})
        return cls(cameras, angles, statics, parameters)


def linearise_frames(
    stars: Sequence[FrameStar],
    cameras: Sequence[FrameCamera],
    surface: Surface,
    statics: Sequence[StaticParameter],
) -> list[Star]:
    """All stars as residuals and sensitivities about `cameras`.

    Parameters
    ----------
    stars : sequence of FrameStar
    cameras : sequence of FrameCamera
    surface : Surface
    statics : sequence of StaticParameter
        Parameters to differentiate by, in the order of ``Star.by_static``.
    """
    stepped = SteppedCameras.about(cameras, statics)
    return [_linearised(star, stepped, surface) for star in stars]


def _linearised(star: FrameStar, stepped: SteppedCameras, surface: Surface) -> Star:
    """One star about the base cameras; matches that cannot be predicted become NaN."""
    hub = stepped.base[star.hub]
    g, k, q = len(star.pixels), len(star.images), len(stepped.parameters)
    ground = hub.locate(star.pixels, surface)
    # the hub's own changes move the ground points, for all partners alike: base, 3 x (+, -), height +, -
    moved = [ground]
    for plus, minus in stepped.angles[star.hub]:
        moved += [plus.locate(star.pixels, surface), minus.locate(star.pixels, surface)]
    moved += [hub.locate(star.pixels, surface.raised(step)) for step in (HEIGHT_STEP, -HEIGHT_STEP)]
    by_lens = [
        [side.locate(star.pixels, surface) for side in sides.get(star.hub, ())] or [ground, ground]
        for sides in stepped.statics
    ]
    residual, by_height = np.full((g, k, 2), np.nan), np.zeros((g, k, 2))
    by_hub, by_partner, by_static = np.zeros((g, k, 2, 3)), np.zeros((g, k, 2, 3)), np.zeros((g, k, 2, q))
    for j, image in enumerate(star.images):
        there = np.isfinite(star.measured[:, j, 0])
        partner = stepped.base[image]
        seen = partner.project(np.concatenate([m[there] for m in moved])).reshape(len(moved), -1, 2)
        residual[there, j] = star.measured[there, j] - seen[0]
        for axis in range(3):
            by_hub[there, j, :, axis] = (seen[2 * axis + 1] - seen[2 * axis + 2]) / (2 * ANGLE_STEP)
            plus, minus = stepped.angles[image][axis]
            by_partner[there, j, :, axis] = (plus.project(ground[there]) - minus.project(ground[there])) / (
                2 * ANGLE_STEP
            )
        by_height[there, j] = (seen[7] - seen[8]) / (2 * HEIGHT_STEP)
        for p, (parameter, sides) in enumerate(zip(stepped.parameters, stepped.statics, strict=True)):
            if image in sides or star.hub in sides:
                plus, minus = sides.get(image, (partner, partner))
                difference = plus.project(by_lens[p][0][there]) - minus.project(by_lens[p][1][there])
                by_static[there, j, :, p] = difference / (2 * parameter.step)
    usable = np.isfinite(residual).all(axis=2) & np.isfinite(by_height).all(axis=2)
    for values in (by_hub, by_partner, by_static):
        usable &= np.isfinite(values).all(axis=(2, 3))
    residual[~usable] = np.nan
    for values in (by_hub, by_partner, by_static):
        values[~usable] = 0.0
    by_height[~usable] = 0.0
    instants = [exposure_times(stepped.base[j], star.measured[:, n]) for n, j in enumerate(star.images)]
    return Star(
        hub=star.hub,
        images=star.images,
        shape=star.shape,
        pixels=star.pixels,
        t_hub=exposure_times(hub, star.pixels),
        t=np.stack(instants, axis=1),
        duration=0.0,
        residual_px=residual,
        covariance_px=star.covariance_px,
        by_hub=by_hub.astype(np.float32),
        by_partner=by_partner.astype(np.float32),
        by_static=by_static.astype(np.float32),
        by_height=by_height.astype(np.float32),
        field=field_positions(star.pixels[:, 1], hub.shape[1]),
        correlation=shared_image_correlation(k),
        weight=np.where(usable, star.weight, 0.0),
    )
