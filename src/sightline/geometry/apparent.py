"""Where light comes from against where it seems to: aberration, light time, refraction by the Earth's air.

Not here: whether the attitudes of a product hold them already (``[platform]``, ``io/acquisition/schema.py``).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.checks import Array, ReadOnlyArrays, as_points, as_times, frozen
from sightline.geometry.earth import EARTH_RATE, local_axes, to_geodetic
from sightline.geometry.interpolation import interpolate
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Ellipsoid
from sightline.geometry.trajectory import Trajectory

#: What attitudes may lack, as ``[platform]`` calls it.
APPARENT = ("aberration", "light_time", "refraction")

#: m/s.
LIGHT_SPEED = 299_792_458.0
#: Refractivity of air at sea level, and the height (m) over which it falls by e: a column of 2.34 m.
AIR, AIR_SCALE = 2.77e-4, 8434.0
#: m; height from which on air is left out: 1e-9 of it is above. Nodes of the integral up to there.
_TOP, _NODES = 180e3, 64
#: s between instants at which the bend of light is computed (it changes with the attitude), fewest and most.
_BEND_STEP, _FEWEST_BENDS, _MOST_BENDS = 0.1, 4, 400
#: Directions each way over the field by which the bend is fitted; the least part that one side of it has of
#: the other, so that turns of the detector line stay inside.
_FIELD, _LEAST_SIDE = 5, 0.1


def aberration_velocity(
    position: Array, velocity: Array, ground: Array, *, aberration: bool, light_time: bool
) -> Array:
    """Velocity by which directions are shifted, over that of light.

    Parameters
    ----------
    position, ground : (N, 3)
        m, Earth-fixed: of the camera, and what it sees.
    velocity : (N, 3)
        m/s, relative to the turning Earth.
    aberration : bool
        Of the camera's motion against the stars.
    light_time : bool
        Of the ground's motion, while light is under way.

    Returns
    -------
    (N, 3)
        m/s. With both it is the velocity against the ground: v + w x (S - P).
    """
    spin = np.array([0.0, 0.0, EARTH_RATE])
    total = np.zeros_like(velocity)
    if aberration:
        total = total + velocity + np.cross(spin, position)
    if light_time:
        total = total - np.cross(spin, ground)
    return total


def refraction_angle(
    radius: Array, ground_radius: float | Array, off_nadir: Array, height: float = 0.0
) -> Array:
    """How much nearer to straight down the ground lies than light seems to come from it.

    Parameters
    ----------
    radius : (N,)
        m; from the Earth's centre to the camera.
    ground_radius : float or (N,)
        m; to the ground.
    off_nadir : (N,)
        rad; where the camera sees it.
    height : float
        m; of the ground above the sea: below it there is no air on the way.

    Returns
    -------
    (N,)
        rad at the camera; NaN where the line of sight misses the sphere.

    Notes
    -----
    Spherical shells of n(h) = 1 + 2.77e-4 exp(-h / 8434 m): n r sin(angle) is the same along a ray, whose
    angle about the centre is the integral of K / (r sqrt(n^2 r^2 - K^2)). Its departure from the straight
    line's is summed by Gauss's rule.
    """
    k = radius * np.sin(off_nadir)
    k = np.where(k < ground_radius, k, np.nan)
    straight = np.arcsin(k / ground_radius) - off_nadir
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # half of the air lies in the lowest thirtieth: heights as the square of even steps
    share = 0.5 * (nodes + 1.0)
    above, step = _TOP * share[:, np.newaxis] ** 2, _TOP * share * weights
    r = ground_radius + above
    n = 1.0 + AIR * np.exp(-(above + height) / AIR_SCALE)
    bent = k / (r * np.sqrt((n * r) ** 2 - k**2)) - k / (r * np.sqrt(r**2 - k**2))
    about = straight + (step[:, np.newaxis] * bent).sum(axis=0)
    return np.asarray(
        off_nadir - np.arctan2(ground_radius * np.sin(about), radius - ground_radius * np.cos(about))
    )


def straight_directions(
    position: Array, velocity: Array, seen: Array, height: float, keys: Collection[str]
) -> Array:
    """The straight directions in which the ground lies that is seen along others.

    Parameters
    ----------
    position : (N, 3)
        m, Earth-fixed: of the camera.
    velocity : (N, 3)
        m/s, relative to the turning Earth.
    seen : (N, 3)
        Unit vectors, Earth-fixed axes: where light seems to come from.
    height : float
        m above the ellipsoid: of the ground.
    keys : collection of str
        Which of `APPARENT` are not in `seen`.

    Returns
    -------
    (N, 3)
        Unit vectors; those given where they miss the ground.

    Notes
    -----
    Light that comes along s seems to come along s + v / c. Shells of air lie about the centre of the sphere
    that touches the ellipsoid below the ground point.
    """
    ground = Ellipsoid(height=height).intersect(position, seen)
    shift = aberration_velocity(
        position,
        velocity,
        ground,
        aberration="aberration" in keys,
        light_time="light_time" in keys,
    )
    straight = seen - shift / LIGHT_SPEED
    straight /= np.linalg.norm(straight, axis=1, keepdims=True)
    if "refraction" in keys:
        straight = _unrefracted(position, straight, ground, height)
    return np.where(np.isfinite(straight).all(axis=1, keepdims=True), straight, seen)


def _unrefracted(position: Array, seen: Array, ground: Array, height: float) -> Array:
    """Directions (N, 3) to ground points (N, 3) whose light comes along `seen`."""
    lon, lat, _ = to_geodetic(ground).T
    known = np.isfinite(lon)
    up = local_axes(np.where(known, lon, 0.0), np.where(known, lat, 0.0)).apply([0.0, 0.0, 1.0])
    radius = np.linalg.norm(ground, axis=1)
    down = ground - radius[:, np.newaxis] * up - position
    far = np.linalg.norm(down, axis=1)
    down = down / far[:, np.newaxis]
    off = np.arccos(np.clip(np.sum(seen * down, axis=1), -1.0, 1.0))
    axis = np.cross(seen, down)
    size = np.linalg.norm(axis, axis=1)
    angle = refraction_angle(far, radius, off, height)
    return Rotation.from_rotvec(
        axis * (np.nan_to_num(angle) / np.where(size > 0.0, size, 1.0))[:, None]
    ).apply(seen)


@dataclass(frozen=True, eq=False)
class BentMount(ReadOnlyArrays):
    """A camera bolted to the body, with what bends light on its way: rays lead straight to what it sees.

    Attributes
    ----------
    mount : FixedMount
        How it is bolted.
    t : (K,)
        s from the epoch, increasing.
    matrices : (K, 3, 3)
        From camera axes to the body, along straight lines; cubic between, constant beyond.

    Notes
    -----
    Aberration and refraction change over the field by less than a pixel, all but linearly: a matrix that is
    not quite a rotation holds both, to some nanoradians within 2 degrees of the middle.
    """

    mount: FixedMount
    t: Array
    matrices: Array

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "t", frozen(as_times(self.t, "t", increasing=True)))
        object.__setattr__(self, "matrices", frozen(self.matrices))

    @property
    def body_from_camera(self) -> Rotation:
        """How the camera is bolted to the body."""
        return self.mount.body_from_camera

    @property
    def span(self) -> tuple[float, float]:
        """All times."""
        return -np.inf, np.inf

    def _at(self, t: Array) -> Array:
        """Matrices (N, 3, 3) at times `t` (N,)."""
        within = np.clip(as_times(t), self.t[0], self.t[-1])
        return interpolate(self.t, self.matrices.reshape(-1, 9), within).reshape(-1, 3, 3)

    def to_body(self, directions: Array, t: Array) -> Array:
        """Directions (N, 3) in camera axes at times t (N,), in body axes, along straight lines."""
        return np.einsum("nij,nj->ni", self._at(t), as_points(directions, "directions"))

    def to_camera(self, directions: Array, t: Array) -> Array:
        """Straight directions (N, 3) in body axes at times t (N,), as the camera sees them."""
        inverse = np.linalg.inv(self._at(t))
        return np.einsum("nij,nj->ni", inverse, as_points(directions, "directions"))


def bent_camera(camera: PushbroomCamera, height: float, keys: Collection[str]) -> PushbroomCamera:
    """The camera whose attitudes do not hold what bends light, its rays led straight to the ground.

    Parameters
    ----------
    camera : PushbroomCamera
        With a fixed mount; world axes Earth-fixed.
    height : float
        m above the ellipsoid: of the ground.
    keys : collection of str
        Which of `APPARENT` are to be applied.

    Returns
    -------
    PushbroomCamera
        What stretches the field in the middle of the image is in its detector, so that a rotation of each
        line holds nearly all of the rest.
    """
    mount = camera.pointing
    if not isinstance(mount, FixedMount):
        raise InputError(f"aberration and refraction are of fixed mounts, got {type(mount).__name__}")
    begin, end = camera.times(np.array(camera.known_lines))
    low, high = camera.known_span
    span = max(float(begin), low), min(float(end), high)
    bent = _bent_mount(mount, camera.trajectory, span, camera.detector.tangents, height, keys)
    middle = np.linalg.solve(mount.body_from_camera.as_matrix(), bent.matrices[len(bent.t) // 2])
    _, sizes, axes = np.linalg.svd(middle)
    stretch = axes.T @ np.diag(sizes) @ axes  # symmetric: what is left of it without its rotation
    looks = camera.detector.directions @ stretch.T
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    return replace(
        camera,
        detector=replace(camera.detector, directions=looks),
        pointing=replace(bent, matrices=bent.matrices @ np.linalg.inv(stretch)),
    )


def _bent_mount(
    mount: FixedMount,
    trajectory: Trajectory,
    span: tuple[float, float],
    tangents: Array,
    height: float,
    keys: Collection[str],
) -> BentMount:
    """The mount of a camera that is used in a `span` (s) and looks along `tangents` (N, 2)."""
    count = int(np.clip(np.ceil((span[1] - span[0]) / _BEND_STEP) + 1, _FEWEST_BENDS, _MOST_BENDS))
    t = np.linspace(*span, count)
    pose = trajectory.at(t)
    velocity = np.gradient(pose.position, t, axis=0, edge_order=2)
    world_from_camera = pose.world_from_body.as_matrix() @ mount.body_from_camera.as_matrix()
    middle = 0.5 * (tangents.min(axis=0) + tangents.max(axis=0))
    half = 0.5 * np.ptp(tangents, axis=0)
    half = np.maximum(half, _LEAST_SIDE * half.max())
    steps = np.linspace(-1.0, 1.0, _FIELD)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    looks = np.column_stack([middle + half * grid, np.ones(len(grid))])
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    seen = np.einsum("kij,nj->kni", world_from_camera, looks)
    many = len(grid)
    straight = straight_directions(
        np.repeat(pose.position, many, axis=0),
        np.repeat(velocity, many, axis=0),
        seen.reshape(-1, 3),
        height,
        keys,
    ).reshape(count, many, 3)
    matrices = _linear(looks, np.einsum("kji,knj->kni", world_from_camera, straight), middle)
    return BentMount(mount, t, mount.body_from_camera.as_matrix() @ matrices)


def _linear(looks: Array, straight: Array, middle: Array) -> Array:
    """Matrices (K, 3, 3) that turn directions (N, 3) into those of each set (K, N, 3), up to their length.

    A rotation, and what the tangents then lack, which is linear in them about their middle.
    """
    turn = Rotation.from_rotvec(np.cross(looks, straight).mean(axis=1))
    own = looks[:, :2] / looks[:, 2:]
    design = np.column_stack([np.ones(len(own)), own - middle])
    back = np.stack([turn.inv().apply(straight[:, n]) for n in range(len(own))], axis=1)
    left = back[..., :2] / back[..., 2:] - own
    constant, by_x, by_y = np.einsum("an,knc->akc", np.linalg.pinv(design), left)
    stretch = np.tile(np.eye(3), (len(straight), 1, 1))
    stretch[:, :2, 0] += by_x
    stretch[:, :2, 1] += by_y
    stretch[:, :2, 2] = constant - by_x * middle[0] - by_y * middle[1]
    return np.asarray(turn.as_matrix() @ stretch)
