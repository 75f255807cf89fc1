"""Where the cameras of an acquisition look and which way they go, in words, and what is hardly meant of it.

Not here: what the ground makes of that (``ground.py``), places in words (``io/whereabouts.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.earth import WGS84, local_axes
from sightline.geometry.pointing import ScanMirror
from sightline.geometry.surface import Dem, Ellipsoid, Infinity, Surface
from sightline.io.acquisition.acquired import Acquisition, world_kind
from sightline.io.acquisition.ground import base_surface, ground_steps
from sightline.io.acquisition.schema import AcquisitionFile, EphemerisPlatform
from sightline.io.whereabouts import compass_words, level_axes_at, place_words
from sightline.motion.sensors import AttitudeSensor

Array = NDArray[np.float64]
MovingCamera = PushbroomCamera | FrameCamera

#: Degrees ahead, aside and about the vertical from straight down along the track, beyond which it is asked
#: whether that is meant: agile satellites look to the side, aircraft crab.
_AHEAD, _ASIDE, _TWISTED = 15.0, 45.0, 20.0
#: The same beyond which quaternions in another order are tried, and up to which these make a sensible look.
_ODD = 5.0
#: Ratio of the size of a line to that of a pixel on the ground, either way, from which on it is mentioned.
_UNLIKE = 1.5
#: rad; departures of the body from its reference attitude, and their sigmas, beyond which sensors may be in
#: degrees.
_LARGE_DEPARTURE = 0.02
#: s before and after an instant between which the flown direction is taken.
_STEP = 0.1
#: Other ways in which quaternions are written, with what each makes of a scalar-last world_from_body.
_WRITTEN: tuple[tuple[str, Callable[[Array], Array]], ...] = (
    ("with the scalar first (qw,qx,qy,qz)", lambda q: q[[1, 2, 3, 0]]),
    ("as body_from_world, the inverse,", lambda q: q * [-1.0, -1.0, -1.0, 1.0]),
    (
        "with the scalar first and as body_from_world, the inverse,",
        lambda q: q[[1, 2, 3, 0]] * [-1.0, -1.0, -1.0, 1.0],
    ),
)


@dataclass(frozen=True)
class Look:
    """A direction against straight down and the flown direction, degrees.

    Attributes
    ----------
    off : float
        From straight down.
    ahead, right : float
        Its parts along the track and square to it.
    """

    off: float
    ahead: float
    right: float

    def words(self) -> str:
        """``0.06 degrees off nadir (0.06 ahead, 0 right)``."""
        along, across = _sided(self.ahead, "ahead", "behind"), _sided(self.right, "right", "left")
        return f"{round(self.off, 3):g} degrees ({along}, {across})"


@dataclass(frozen=True)
class _Frame:
    """The level frame of a camera at an instant: rows of `axes` are forward, right, down."""

    t: float
    place: Array
    axes: Array

    def look(self, direction: Array) -> Look:
        """A direction of the world (3,)."""
        forward, right, down = self.axes @ direction
        off = np.arctan2(np.hypot(forward, right), down)
        return Look(
            *(float(v) for v in np.degrees([off, np.arctan2(forward, down), np.arctan2(right, down)]))
        )

    def heading(self, direction: Array) -> float:
        """Degrees by which a direction points to the right of the flown one."""
        forward, right, _ = self.axes @ direction
        return float(np.degrees(np.arctan2(right, forward)))


def _sided(angle: float, positive: str, negative: str) -> str:
    """An angle (degrees) without a sign: ``0.057 ahead``."""
    return f"{round(abs(angle), 3):g} {positive if round(angle, 3) >= 0.0 else negative}"


def radii_of_surface(surface: Surface, world: str) -> tuple[float, float] | None:
    """Of the ellipsoid whose normals are the verticals; None where the world is flat."""
    if world == "local":
        return None
    if isinstance(surface, Ellipsoid):
        return surface.a, surface.b
    return surface.radii if isinstance(surface, Dem) else WGS84


def _frame(camera: MovingCamera, t: float, radii: tuple[float, float] | None) -> _Frame | None:
    """The level frame at time t (s); None where the camera does not move on."""
    begin, end = camera.trajectory.span
    t = float(np.clip(t, begin, end))
    ends = np.array([max(begin, t - _STEP), min(end, t + _STEP)])
    if not ends[1] > ends[0]:
        return None
    (before, after), (place,) = (camera.trajectory.at(at).position for at in (ends, np.array([t])))
    up = level_axes_at(place, radii)[2]
    forward = after - before - up * (up @ (after - before))
    size = float(np.linalg.norm(forward))
    if not size > 0.0:
        return None
    forward = forward / size
    return _Frame(t, place, np.stack([forward, np.cross(forward, up), -up]))


def look_words(acquisition: Acquisition) -> list[str]:
    """Where the camera is at t = 0, where it looks from there, and how its lines and columns lie."""
    if isinstance(acquisition.surface, Infinity) or acquisition.spin is not None:
        return []
    camera = acquisition.cameras[0]
    radii = radii_of_surface(acquisition.surface, acquisition.world)
    frame = _frame(camera, 0.0, radii)
    if frame is None:
        return []
    middle = (np.array(camera.shape) - 1.0)[np.newaxis] / 2.0
    (ground,) = camera.locate(middle, base_surface(acquisition.surface))
    said = [
        f"at t = {frame.t:.4g} s: {place_words(frame.place, radii)}, flies "
        f"{compass_words(frame.axes[0], level_axes_at(frame.place, radii))}; the middle of "
        f"{acquisition.names[0]} sees {place_words(ground, radii)}"
    ]
    if not isinstance(camera, PushbroomCamera):
        return said
    if isinstance(camera.pointing, ScanMirror):
        return said
    looks = []
    for name, each in zip(acquisition.names, acquisition.cameras, strict=True):
        at = (each.shape[0] - 1.0) / 2.0
        own = _frame(each, float(each.times([at])[0]), radii)
        if own is not None:
            ray = each.rays([[at, (each.shape[1] - 1.0) / 2.0]]).directions[0]
            looks.append(f"{name} {own.look(ray).words()}")
    said.append(f"off nadir: {'; '.join(looks)}")
    body = camera.trajectory.at([frame.t]).world_from_body.apply([1.0, 0.0, 0.0])[0]
    turned = frame.heading(body)
    side = "right" if _column_zero(camera, frame) @ frame.axes[1] > 0.0 else "left"
    said.append(
        f"body x points {_sided(turned, 'degrees right', 'degrees left')} of the flown direction; column 0 "
        f"lies on the {side}"
    )
    along, across = ground_steps(camera, acquisition.surface)
    if max(along, across) >= _UNLIKE * min(along, across):
        said.append(
            f"note: lines are {along / across:.3g} times as far apart on the ground as pixels are wide: of "
            "a camera that images squares, ifov, line_period or altitude is wrong by as much"
        )
    return said


def _column_zero(camera: PushbroomCamera, frame: _Frame) -> Array:
    """Direction (3,) of the world from the last column to the first."""
    last = camera.columns - 1.0
    line = (camera.lines - 1.0) / 2.0
    first, end = camera.rays([[line, 0.0], [line, last]]).directions
    return np.asarray(first - end)


def look_doubts(
    config: AcquisitionFile,
    cameras: Sequence[MovingCamera],
    names: Sequence[str],
    surface: Surface,
    axes_at: Callable[[float], Rotation] | None = None,
) -> tuple[str, ...]:
    """What is hardly meant of where cameras look: far from straight down, across the track, backwards.

    Said of attitudes that a table gives; a mount, a look angle or a model that is tilted is meant.
    """
    camera = cameras[0]
    if (
        not isinstance(config.platform, EphemerisPlatform)
        or not isinstance(camera, PushbroomCamera)
        or isinstance(camera.pointing, ScanMirror)
        or isinstance(surface, Infinity)
    ):
        return ()
    radii = radii_of_surface(surface, world_kind(config))
    frame = _frame(camera, float(camera.times([(camera.lines - 1.0) / 2.0])[0]), radii)
    if frame is None:
        return ()
    body = camera.trajectory.at([frame.t]).world_from_body[0]
    seen, twist = _aims(camera, frame, body)
    said = []
    if abs(seen.ahead) > _AHEAD or abs(seen.right) > _ASIDE:
        said.append(f"the camera looks {seen.words()} from straight down")
    if abs(twist) > _TWISTED:
        said.append(
            f"its lines follow each other {_sided(twist, 'degrees right', 'degrees left')} of the flown "
            "direction"
        )
    other = otherwise_written(config, camera, surface, axes_at)
    if said or other:
        said = said or [f"the camera looks {seen.words()} from straight down, turned by {twist:.3g} degrees"]
        said = [
            f"{' and '.join(said)}, by the attitudes: if that is not meant, check quaternions "
            f"(world_from_body, qx,qy,qz,qw), [world] frame and [camera] mount{other}"
        ]
    backwards = [
        name
        for name, each in zip(names, cameras, strict=True)
        if isinstance(each, PushbroomCamera) and _runs_backwards(each, surface, radii)
    ]
    if backwards:
        said.append(
            f"lines of {', '.join(backwards)} run backwards over the ground, against the flown direction: "
            "check attitudes and times"
        )
    return tuple(said)


def _aims(camera: PushbroomCamera, frame: _Frame, body: Rotation) -> tuple[Look, float]:
    """Where body z or the optical axis looks, whichever is nearer to straight down, and how far (degrees) the
    lines follow each other to the right of the flown direction."""
    at = np.array([frame.t])
    # camera x is to larger columns, y to later lines, z along the optical axis
    later, optical = camera.pointing.to_body(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.repeat(at, 2))
    looks = [frame.look(body.apply(axis)) for axis in (np.array([0.0, 0.0, 1.0]), optical)]
    return min(looks, key=lambda look: look.off), frame.heading(body.apply(later))


def otherwise_written(
    config: AcquisitionFile,
    camera: MovingCamera,
    surface: Surface,
    axes_at: Callable[[float], Rotation] | None = None,
) -> str:
    """The end of a message where quaternions written in another way make the camera look straight down.

    `axes_at` gives the axes of computation against those that the file is in, at a time (s).
    """
    platform = config.platform
    if (
        not isinstance(platform, EphemerisPlatform)
        or platform.attitudes == "along-track"
        or not isinstance(camera, PushbroomCamera)
    ):
        return ""
    radii = radii_of_surface(surface, world_kind(config))
    frame = _frame(camera, float(camera.times([(camera.lines - 1.0) / 2.0])[0]), radii)
    if frame is None:
        return ""
    given = camera.trajectory.at([frame.t]).world_from_body[0]

    def odd(body: Rotation) -> float:
        seen, twist = _aims(camera, frame, body)
        return max(seen.off, abs(twist))

    if odd(given) <= _ODD:
        return ""
    axes = Rotation.identity() if axes_at is None else axes_at(frame.t)
    if config.world.frame == "local" and config.world.origin is not None:
        axes = local_axes(*np.radians(config.world.origin[:2]))
    written = (axes.inv() * given).as_quat()
    for how, turned in _WRITTEN:
        body = axes * Rotation.from_quat(turned(written))
        if odd(body) <= _ODD:
            seen, twist = _aims(camera, frame, body)
            return (
                f"; read {how} they would make it look {round(seen.off, 3):g} degrees from straight down and "
                f"{round(abs(twist), 3):g} degrees from the flown direction: are they written so?"
            )
    return ""


def _runs_backwards(camera: PushbroomCamera, surface: Surface, radii: tuple[float, float] | None) -> bool:
    """Whether later lines see ground that lies behind that of earlier ones."""
    line, column = (camera.lines - 1.0) / 2.0, (camera.columns - 1.0) / 2.0
    frame = _frame(camera, float(camera.times([line])[0]), radii)
    first, last = camera.locate([[0.0, column], [camera.lines - 1.0, column]], base_surface(surface))
    return frame is not None and bool((last - first) @ frame.axes[0] < 0.0)


def sensor_doubts(
    sensors: Sequence[AttitudeSensor], span: tuple[float, float], attitude_sigma: float = 0.0
) -> tuple[str, ...]:
    """What is hardly meant of attitude sensors: departures from the reference attitude in degrees.

    Parameters
    ----------
    sensors : sequence of AttitudeSensor
    span : (float, float)
        s; first and last exposure of the images.
    attitude_sigma : float
        rad; how far angles may be from the reference attitude, as far as that is said.
    """
    said = []
    for sensor in sensors:
        during = (sensor.t_start >= span[0]) & (sensor.t_end <= span[1])
        angles = sensor.angles[during] if during.any() else sensor.angles
        if sensor.kind == "gyro":
            angles = np.cumsum(angles, axis=0)
        largest = float(np.abs(angles).max(initial=0.0))
        known = float(np.linalg.norm([sensor.alignment_sigma, sensor.bias_sigma, attitude_sigma]))
        if largest > max(_LARGE_DEPARTURE, 3.0 * known):
            said.append(
                f"{sensor.kind} {sensor.name}: up to {largest:.3g} rad ({np.degrees(largest):.3g} degrees) "
                "from the reference attitude: is it in degrees? rad are expected, about body axes, relative "
                "to the attitudes of [platform]"
            )
        elif len(sensor.sigma) and float(np.median(sensor.sigma)) > _LARGE_DEPARTURE:
            usual = float(np.median(sensor.sigma))
            said.append(
                f"{sensor.kind} {sensor.name}: a sigma of {usual:.3g} rad is {np.degrees(usual):.3g} "
                "degrees: is it in degrees? rad are expected"
            )
    return tuple(said)
