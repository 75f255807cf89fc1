"""How the partner of a pixel moves with attitude.

The matching model of S1 (boxes 22 and 26 of its figure 15): locate in image a, project into
image b (``geometry/conjugate.py``), compare with what was measured, differentiate by attitude, by the static
parameters of the instrument and by the height of the ground.

Not here: measuring the partner (``matching/match_images.py``), solving (``motion/strip/joint.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sightline.execution import slices
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import Matches
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
MovingCamera = PushbroomCamera | FrameCamera
Pair = tuple[MovingCamera, MovingCamera]

#: Step of the finite differences by attitude (rad): a tenth of a pixel of a 5 urad camera; projections are
#: good to 1e-9 lines, sensitivities so to 1e-3 px/rad. Two pixels would average the speed of the image over
#: four lines, and lose a tenth of what jitter of 120 Hz modulates it by: free offsets hide drifts of 10 px,
#: which turn that into errors of 0.005 px, alike in all windows of a row.
ANGLE_STEP = 5e-7
#: Step of the finite difference by height (m).
HEIGHT_STEP = 10.0
#: Lines of an image up to which turned cameras are kept (100 bytes a line and turn).
KEPT_LINES = 8192
#: Lines that are located, and windows of which it is asked how they move, at a time.
AT_ONCE = 16384

#: Turned cameras by camera and angles.
_KEPT: WeakKeyDictionary[PushbroomCamera, dict[tuple[float, ...], MovingCamera]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class StaticParameter:
    """One constant of the instrument that the estimate may adjust.

    Attributes
    ----------
    name : str
        What it is, for example ``"PAN offset along"``.
    unit : str
        Its unit as printed (``"px"``, ``"rad"``, ``"s"``, or ``""``).
    sigma : float
        How well it is known beforehand (1-sigma, in `unit`); always positive.
    step : float
        Step of its finite difference, in `unit`.
    apply : callable
        ``apply(cameras, value)`` gives the cameras with the parameter `value` away from nominal.
    images : tuple of int
        Which images it touches.
    whole : StaticParameter or None
        Where it moves the columns of its one image unlike, and not smoothly: what moves all of them alike.
    profile : (columns,) or None
        How far it moves each of them, as a share of what `whole` does.
    """

    name: str
    unit: str
    sigma: float
    step: float
    apply: Callable[[Sequence[MovingCamera], float], list[MovingCamera]]
    images: tuple[int, ...]
    whole: StaticParameter | None = None
    profile: Array | None = None


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Change of the predicted partner, in px, with everything that can move it.

    Attributes
    ----------
    angles_a, angles_b : (N, 2, 3)
        px/rad; by roll, pitch, yaw of the body when image a, image b was exposed
        (S1's C_T, C_L, C_R in one matrix, for exact rays).
    statics : (N, 2, Q)
        px per unit of each static parameter.
    height : (N, 2)
        px/m; by the height of the ground (S1's C_h).
    """

    angles_a: Array
    angles_b: Array
    statics: Array
    height: Array


def residuals(matches: Matches, predicted: Array) -> Array:
    """Measured minus predicted partners, (N, 2) px (S1's Res = M2 M2'); NaN where not matched."""
    return np.asarray(matches.b - predicted)


def ground_of_column(camera: PushbroomCamera, surface: Surface, column: float) -> Array:
    """(lines, 3) m; what one column of all lines sees, found some lines at a time."""
    out = scratch_array((camera.lines, 3))
    for some in slices(camera.lines, AT_ONCE):
        lines = np.arange(some.start, some.stop, dtype=np.float64)
        out[some] = camera.locate(np.column_stack([lines, np.full(len(lines), column)]), surface)
        let_go()
    return out


def turned(camera: MovingCamera, angles: Array) -> MovingCamera:
    """The same camera with its body turned by constant small `angles` (roll, pitch, yaw; rad).

    All stars of a pass ask for the same few: those of short images are kept as long as the camera, with the
    poses of their lines.
    """
    if not isinstance(camera, PushbroomCamera) or camera.lines > KEPT_LINES:
        return _turned(camera, angles)
    kept, key = _KEPT.setdefault(camera, {}), tuple(float(angle) for angle in angles)
    if key not in kept:
        kept[key] = _turned(camera, angles)
    return kept[key]


def _turned(camera: MovingCamera, angles: Array) -> MovingCamera:
    """A new camera, turned."""
    trajectory = camera.trajectory
    motion = trajectory.motion
    if motion is None:
        first, last = trajectory.span
        # a frame is exposed at one instant
        motion = Motion.zero(first, last) if last > first else Motion.zero(first - 0.5, last + 0.5)
    return camera.with_trajectory(trajectory.with_motion(motion.shifted(angles)))


@dataclass(frozen=True, eq=False)
class Sides:
    """Both cameras of a pair, and what they become by a step either way of all that moves the partner.

    To be kept from one stretch of a pair's windows to the next: poses of all lines of a long image, found
    anew for every stretch, cost the square of its length.

    Attributes
    ----------
    cameras : (camera, camera)
        Of the first and of the second image.
    turned_a, turned_b : three times (camera, camera)
        The first or the second turned about roll, pitch, yaw: forward, and back.
    changed : Q times ((camera, camera), (camera, camera)) or None
        The pair by each static parameter: more of it, and less; None: it touches neither.
    steps : (Q,)
        Of these, in the units of the parameters.
    """

    cameras: Pair
    turned_a: tuple[Pair, ...]
    turned_b: tuple[Pair, ...]
    changed: tuple[tuple[Pair, Pair] | None, ...]
    steps: tuple[float, ...]

    @classmethod
    def of(
        cls,
        cameras: Sequence[MovingCamera],
        image_a: int,
        image_b: int,
        statics: Sequence[StaticParameter] = (),
    ) -> Sides:
        """Those of a pair of all `cameras`; its arguments are those of `sensitivities`."""
        turns = ANGLE_STEP * np.eye(3)
        turned_a, turned_b = (
            tuple((turned(cameras[image], turn), turned(cameras[image], -turn)) for turn in turns)
            for image in (image_a, image_b)
        )

        def changed(parameter: StaticParameter, value: float) -> Pair:
            all_of_them = parameter.apply(cameras, value)
            return all_of_them[image_a], all_of_them[image_b]

        return cls(
            (cameras[image_a], cameras[image_b]),
            turned_a,
            turned_b,
            tuple(
                (changed(one, one.step), changed(one, -one.step))
                if image_a in one.images or image_b in one.images
                else None
                for one in statics
            ),
            tuple(one.step for one in statics),
        )


def sensitivities(
    cameras: Sequence[MovingCamera],
    image_a: int,
    image_b: int,
    surface: Surface,
    pixels_a: Array,
    statics: Sequence[StaticParameter] = (),
) -> Sensitivities:
    """Derivatives of the predicted partner by attitude, statics and height, by central differences.

    Parameters
    ----------
    cameras : sequence of cameras
        All images, with the best motion and statics known so far.
    image_a, image_b : int
        The pair.
    surface : Surface
        What the lines of sight meet.
    pixels_a : (N, 2)
        (line, column) in image a, px.
    statics : sequence of StaticParameter
        Parameters to differentiate by.

    Returns
    -------
    Sensitivities
        NaN rows where the partner leaves image b.

    Notes
    -----
    S1: ``d di/d theta ~ (i2(theta + dtheta) - i2(theta)) / dtheta`` per focal-plane point and epoch. A turn
    that lasts the whole strip is used for each image alone, so the derivative is by the attitude at the
    two instants of exposure.
    """
    return sensitivities_by(Sides.of(cameras, image_a, image_b, statics), surface, pixels_a)


def sensitivities_by(sides: Sides, surface: Surface, pixels_a: Array) -> Sensitivities:
    """The same where the cameras of the pair, moved by each step, are there already."""
    camera_a, camera_b = sides.cameras
    n = len(pixels_a)
    ground = camera_a.locate(pixels_a, surface)
    by_a, by_b = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    for axis in range(3):
        plus, minus = (camera_b.project(one.locate(pixels_a, surface)) for one in sides.turned_a[axis])
        by_a[:, :, axis] = (plus - minus) / (2 * ANGLE_STEP)
        plus, minus = (one.project(ground) for one in sides.turned_b[axis])
        by_b[:, :, axis] = (plus - minus) / (2 * ANGLE_STEP)
    by_static = np.zeros((n, 2, len(sides.steps)))
    for k, (changed, step) in enumerate(zip(sides.changed, sides.steps, strict=True)):
        if changed is not None:
            plus, minus = (predict_match(a, b, surface, pixels_a) for a, b in changed)
            by_static[:, :, k] = (plus - minus) / (2 * step)
    up = camera_b.project(camera_a.locate(pixels_a, surface.raised(HEIGHT_STEP)))
    down = camera_b.project(camera_a.locate(pixels_a, surface.raised(-HEIGHT_STEP)))
    return Sensitivities(by_a, by_b, by_static, (up - down) / (2 * HEIGHT_STEP))
