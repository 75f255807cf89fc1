"""What a bound of stereo orientation depends on, taken from a problem or a plan, and how it is varied.

A `Setting` is planned images, which point each of them shows, and what is known beforehand: no measurements.
Settings of a plan are made anew from its orbits. Those of a problem, whose orbits are not known, are varied
by moving its images: along their own paths, apart along their baselines, always looking where they looked.

Not here: the bound of a setting (``applications/stereo_prediction.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.aim import axes_towards
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen, positive, read_only
from sightline.geometry.earth import from_geodetic, to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.orbit_pair import OrbitPair
from sightline.geometry.surface import level_surface
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Images, Index, Sightings, Tracks, sight_frames
from sightline.photogrammetry.triangulate import triangulate

#: Points laid out where no matches are named.
POINTS = 300
#: px; noise of matches where nobody says any.
SIGMA_PX = 0.1
#: Part of the narrower side of a frame that laid out points cover: all are then in all frames.
_COVERED = 0.9


@dataclass(frozen=True, eq=False)
class StereoPlan(ReadOnlyArrays):
    """A pass of spacecraft over a common aim point, not yet flown.

    Attributes
    ----------
    pair : OrbitPair
    detectors : tuple of AreaDetector
        One per camera.
    mounts : tuple of Rotation
        body_from_camera, one per camera.
    noise : PoseNoise
    sigma_px : float
        px, of each coordinate of a sighting.
    window : float
        s, in which the shots are taken.
    shots : int
    offset : float
        s, of the middle of the window from the middle of the pass.
    points : int
        How many conjugate points.
    scene_size : float or None
        m, side of the square that they cover; None takes 0.9 of what a frame covers from nearest.
    heights : HeightPrior or None
        What is known of the points' heights.
    cameras : tuple of str
        Names; numbers from 1 unless given.
    """

    pair: OrbitPair
    detectors: tuple[AreaDetector, ...]
    mounts: tuple[Rotation, ...]
    noise: PoseNoise
    sigma_px: float = SIGMA_PX
    window: float = 64.0
    shots: int = 64
    offset: float = 0.0
    points: int = POINTS
    scene_size: float | None = None
    heights: HeightPrior | None = None
    cameras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check."""
        positive(self.sigma_px, "sigma_px", "px")
        if self.scene_size is not None:
            positive(self.scene_size, "scene_size", "m")
        if self.points < 1:
            raise InputError(f"`points` must be 1 or more, got {self.points}")
        if not len(self.detectors) == len(self.mounts) == self.pair.cameras:
            raise InputError(
                f"a plan of {self.pair.cameras} cameras needs as many detectors and mounts, got "
                f"{len(self.detectors)} and {len(self.mounts)}"
            )
        if not self.cameras:
            object.__setattr__(self, "cameras", tuple(str(c + 1) for c in range(self.pair.cameras)))


@dataclass(frozen=True, eq=False)
class Setting(ReadOnlyArrays):
    """Everything that a bound depends on.

    Attributes
    ----------
    images : Images
        As planned.
    detectors : tuple of AreaDetector
    mounts : tuple of Rotation
    image, point : (N,) int
        Which image will show which point.
    sigma_px : (N,)
        px.
    places : (n, 3)
        m, world axes; where the points are.
    noise : PoseNoise
    radii : (float, float) or None
        Of the ellipsoid whose normals are the verticals; None where the world is flat.
    heights : HeightPrior or None
    control : ControlPoints or None
    how : str
        Where the points come from, in words.
    """

    images: Images
    detectors: tuple[AreaDetector, ...]
    mounts: tuple[Rotation, ...]
    image: Index
    point: Index
    sigma_px: Array
    places: Array
    noise: PoseNoise
    radii: tuple[float, float] | None
    heights: HeightPrior | None = None
    control: ControlPoints | None = None
    how: str = ""

    @property
    def shots(self) -> int:
        """Number of shots."""
        return len(np.unique(self.images.shot))

    @property
    def window(self) -> float:
        """s; span of the shots' times and one interval more; 0 for one shot."""
        return float(np.ptp(self.images.t) * self.shots / max(self.shots - 1, 1))

    @property
    def baseline(self) -> float:
        """m; mean distance of the first and the last camera of the shots that have two or more; else 0."""
        first, last = _ends(self.images)
        apart = np.linalg.norm(self.images.position[first] - self.images.position[last], axis=1)
        return float(apart[apart > 0.0].mean()) if (apart > 0.0).any() else 0.0

    @property
    def priors(self) -> PointPriors | None:
        """What is known of the points."""
        return PointPriors.of(self.heights, self.control)

    def sightings(self) -> Sightings:
        """The sightings as planned."""
        pixels = pixels_of_places(
            self.images, self.detectors, self.mounts, self.image, self.places[self.point]
        )
        return sight_frames(
            self.images, self.detectors, self.mounts, Tracks(self.image, self.point, pixels, self.sigma_px)
        )


def pixels_of_places(
    images: Images,
    detectors: tuple[AreaDetector, ...],
    mounts: tuple[Rotation, ...],
    image: Index,
    places: Array,
) -> Array:
    """Pixels (N, 2) at which images (N,) show places (N, 3), in the frame or not; NaN behind the camera."""
    out = np.empty((len(image), 2))
    body = images.world_from_body.as_matrix()
    camera = images.camera[image]
    for number, (detector, mount) in enumerate(zip(detectors, mounts, strict=True)):
        rows = np.flatnonzero(camera == number)
        turned = body[image[rows]] @ mount.as_matrix()
        out[rows] = detector.pixels(
            np.einsum("nji,nj->ni", turned, places[rows] - images.position[image[rows]])
        )
    return out


def in_frame(
    images: Images, detectors: tuple[AreaDetector, ...], image: Index, pixels: Array
) -> NDArray[np.bool_]:
    """Which pixels (N, 2) of images (N,) lie in the frame."""
    size = np.array([detector.shape for detector in detectors])[images.camera[image]]
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=1))


def setting_of_plan(plan: StereoPlan) -> Setting:
    """The images of a pass, and points laid out evenly over a square about its aim point.

    The square is turned along the track of the first camera; a point counts where it falls into a frame.
    """
    pair = plan.pair
    t = pair.shot_times(plan.window, plan.shots, plan.offset)
    place = pair.positions(t)
    count = pair.cameras
    images = Images(
        np.repeat(np.arange(count), plan.shots),
        np.tile(np.arange(plan.shots), count),
        np.tile(t, count),
        place.reshape(-1, 3),
        Rotation.from_matrix(pair.world_from_body(t).reshape(-1, 3, 3)),
    )
    size = plan.scene_size
    if size is None:
        nearest = float(np.linalg.norm(place - pair.aim_point, axis=2).min())
        widths = [min(detector.shape) / detector.focal_length_px for detector in plan.detectors]
        size = _COVERED * nearest * min(widths)
    places = _square(pair, size, plan.points, images.world_from_body.as_matrix()[plan.shots // 2, :, 0])
    image, point = _shown(images, plan.detectors, plan.mounts, places)
    how = (
        f"{plan.points} points laid out evenly over a level square of {size / 1e3:.3g} km along the track, "
        "about the aim point; a point counts in every frame that it falls into"
    )
    return Setting(
        images, plan.detectors, plan.mounts, image, point, np.full(len(image), plan.sigma_px), places,
        plan.noise, pair.radii, plan.heights, None, how,
    )  # fmt: skip


def _even_places(count: int) -> Array:
    """Points (count, 2) spread evenly over the unit square: Fibonacci's lattice, any number of points."""
    n = np.arange(count)
    return np.column_stack([(n + 0.5) / count, np.mod((n + 0.5) * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)])


def _square(pair: OrbitPair, size: float, count: int, ahead: Array) -> Array:
    """Points (count, 3) on the ellipsoid about the aim point, in a square with a side along `ahead`."""
    up = pair.world_from_local.apply([0.0, 0.0, 1.0])
    along = ahead - (ahead @ up) * up
    along = along / np.linalg.norm(along)
    flat = (_even_places(count) - 0.5) * size
    geodetic = to_geodetic(
        pair.aim_point + flat[:, :1] * along + flat[:, 1:] * np.cross(up, along), pair.radii
    )
    geodetic[:, 2] = pair.aim_height
    return frozen(from_geodetic(geodetic, pair.radii))


def _shown(
    images: Images, detectors: tuple[AreaDetector, ...], mounts: tuple[Rotation, ...], places: Array
) -> tuple[Index, Index]:
    """Image and point of everything that is in a frame, for points that two frames or more show."""
    image = np.repeat(np.arange(len(images)), len(places))
    point = np.tile(np.arange(len(places)), len(images))
    pixels = pixels_of_places(images, detectors, mounts, image, places[point])
    kept = in_frame(images, detectors, image, pixels)
    kept &= np.bincount(point[kept], minlength=len(places))[point] >= 2
    if not kept.any():
        raise InputError(
            "no frames of two images show common ground: check altitude, aim point, focal length and mount"
        )
    return image[kept], point[kept]


def setting_of_problem(problem: StereoProblem) -> Setting:
    """The planned images of a problem, with its own conjugate points or, having none, points laid out.

    Points of the matches are where their rays meet under the planned poses; those that do not meet are left
    out.
    """
    tracks = problem.tracks
    if len(tracks) == 0:
        return _laid_out(problem)
    places = np.array(triangulate(problem.sightings()).position)
    if problem.control is not None:
        places[problem.control.point] = problem.control.position
    kept = np.asarray(np.isfinite(places).all(axis=1))
    rows = kept[tracks.point]
    renumbered = np.cumsum(kept) - 1
    control = problem.control
    if control is not None:
        control = ControlPoints(renumbered[control.point], control.position, control.sigma)
    how = f"the {int(kept.sum())} points of the matches, where their rays meet under the planned poses"
    return Setting(
        problem.images, problem.detectors, problem.mounts, tracks.image[rows],
        renumbered[tracks.point[rows]], tracks.sigma_px[rows], frozen(places[kept]), problem.noise,
        problem.radii, problem.heights, control, how,
    )  # fmt: skip


def _laid_out(problem: StereoProblem) -> Setting:
    """Points laid out evenly over the first camera's middle frame, where another frame shows them too."""
    images, surface = problem.images, level_surface(problem.radii)
    if problem.heights is not None:
        surface = problem.heights.surface
    own = np.flatnonzero(images.camera == images.camera.min())
    middle = own[np.argsort(images.t[own], kind="stable")[len(own) // 2]]
    camera = images.camera[middle]
    detector = problem.detectors[camera]
    body = images.world_from_body[int(middle)] * problem.mounts[camera]

    def ground(count: int) -> Array:
        pixels = _even_places(count) * np.array(detector.shape) - 0.5
        rays = body.apply(detector.directions(pixels))
        origins = np.tile(images.position[middle], (count, 1))
        points = surface.intersect(read_only(origins), read_only(rays))
        return np.asarray(points[np.isfinite(points).all(axis=1)])

    trial = ground(POINTS)
    if len(trial) == 0:
        raise InputError("the cameras do not look at the ground: check poses, mount and [surface]")
    seen = _shown(images, problem.detectors, problem.mounts, trial)[1]
    places = ground(int(POINTS * POINTS / max(len(np.unique(seen)), 1)))
    image, point = _shown(images, problem.detectors, problem.mounts, places)
    names, point = np.unique(point, return_inverse=True)
    sigma, whose = problem.sigma_px, "as given"
    if sigma is None:
        sigma, whose = SIGMA_PX, "assumed, as none is given ([noise] sigma_px)"
    how = (
        f"{len(names)} points laid out evenly over the middle frame of camera {problem.cameras[camera]}, on "
        f"the surface, where another frame shows them too; image noise of {sigma:g} px, {whose}"
    )
    return Setting(
        images, problem.detectors, problem.mounts, image, point, np.full(len(image), sigma),
        frozen(places[names]), problem.noise, problem.radii, problem.heights, None, how,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------ variations


def _ends(images: Images) -> tuple[Index, Index]:
    """For every image the first and the last image (by camera) of its shot."""
    order = np.lexsort((images.camera, images.shot))
    _, begin, row = np.unique(images.shot[order], return_index=True, return_inverse=True)
    end = np.append(begin[1:], len(order)) - 1
    place = np.empty(len(order), dtype=np.intp)
    place[order] = row
    return order[begin[place]], order[end[place]]


def moved(setting: Setting, t: Array, base: float = 1.0) -> Setting:
    """The same images at other times, and further apart.

    Parameters
    ----------
    setting : Setting
    t : (M,)
        s; when each image is taken. Its camera goes along its own path, a cubic through its positions.
    base : float
        The cameras of a shot are this many times as far from their middle.

    Returns
    -------
    Setting
        Every image keeps its attitude relative to the plane of its shot's baseline and the middle of the
        points, so that it looks where it looked.
    """
    images, aim = setting.images, setting.places.mean(axis=0)
    position, ahead = np.array(images.position), np.zeros((len(images), 3))
    for camera in np.unique(images.camera):
        rows = np.flatnonzero(images.camera == camera)
        path, speed = _path(images.t[rows], images.position[rows])
        position[rows] += path(t[rows]) - path(images.t[rows])
        ahead[rows] = speed
    _, row = np.unique(images.shot, return_inverse=True)
    size = np.bincount(row)[:, None]
    middle = np.stack([np.bincount(row, position[:, i]) for i in range(3)], axis=1) / size
    position = middle[row] + base * (position - middle[row])
    first, last = _ends(images)
    before = np.where((first == last)[:, None], ahead, images.position[first] - images.position[last])
    after = np.where((first == last)[:, None], ahead, position[first] - position[last])
    from_axes = axes_towards(position, after, aim)
    axes = axes_towards(images.position, before, aim)
    body = from_axes @ np.swapaxes(axes, 1, 2) @ images.world_from_body.as_matrix()
    return replace(
        setting, images=Images(images.camera, images.shot, t, position, Rotation.from_matrix(body))
    )


def _path(t: Array, position: Array) -> tuple[Callable[[Array], Array], Array]:
    """Positions (N, 3) against time, and the mean velocity (3,)."""
    middle, half = t.mean(), max(float(np.ptp(t)) / 2.0, 1.0)
    scaled = (t - middle) / half
    degree = min(3, len(np.unique(t)) - 1)
    c = np.polynomial.polynomial.polyfit(scaled, position - position.mean(axis=0), degree)
    mean = position.mean(axis=0)

    def at(times: Array) -> Array:
        s = (times - middle) / half
        return np.asarray(np.polynomial.polynomial.polyval(s, c).T + mean)

    speed = c[1] if degree > 0 else np.array([1.0, 0.0, 0.0])
    return at, speed


def with_window(setting: Setting, factor: float) -> Setting:
    """As many shots in a window `factor` times as long about the same middle."""
    t = setting.images.t
    middle = 0.5 * (t.min() + t.max())
    return moved(setting, middle + factor * (t - middle))


def with_shots(setting: Setting, count: int) -> Setting:
    """`count` shots, spread evenly over the same window; each shows what the nearest of the shots showed."""
    images, window = setting.images, setting.window
    names, shot = np.unique(images.shot, return_inverse=True)
    step = window / len(names)
    when = (np.arange(count) + 0.5) * len(names) / count - 0.5
    source = np.clip(np.rint(when), 0, len(names) - 1).astype(np.intp)
    rows = [np.flatnonzero(shot == s) for s in source]
    taken = np.concatenate(rows)
    new_shot = np.repeat(np.arange(count), [len(r) for r in rows])
    shift = ((when - source) * step)[new_shot]
    copied = Images(
        images.camera[taken], new_shot, images.t[taken], images.position[taken],
        images.world_from_body[taken],
    )  # fmt: skip
    order = np.argsort(setting.image, kind="stable")
    begin = np.searchsorted(setting.image[order], np.arange(len(images) + 1))
    of_images = [order[begin[i] : begin[i + 1]] for i in taken]
    sighted = np.concatenate(of_images)
    image = np.repeat(np.arange(len(taken)), [len(s) for s in of_images])
    out = replace(
        setting, images=copied, image=image, point=setting.point[sighted],
        sigma_px=setting.sigma_px[sighted],
    )  # fmt: skip
    return moved(out, copied.t + shift)


def with_points(setting: Setting, count: int) -> Setting:
    """`count` points: some, drawn with equal chances, or each several times; control points are kept."""
    total = len(setting.places)
    known = np.zeros(0, dtype=np.intp) if setting.control is None else np.unique(setting.control.point)
    others = np.setdiff1d(np.arange(total), known)
    wanted = max(count - len(known), 0)
    # points often come in the order of a grid: every so many of them would lie on few lines
    drawn = np.random.default_rng(0).permutation(others)
    source = np.concatenate([known, np.resize(drawn, wanted if len(others) else 0)])
    order = np.argsort(setting.point, kind="stable")
    begin = np.searchsorted(setting.point[order], np.arange(total + 1))
    rows = [order[begin[p] : begin[p + 1]] for p in source]
    sighted = np.concatenate(rows)
    control = setting.control
    if control is not None:
        control = replace(control, point=np.searchsorted(known, control.point))
    point = np.repeat(np.arange(len(source)), [len(r) for r in rows])
    return replace(
        setting, image=setting.image[sighted], point=point,
        sigma_px=setting.sigma_px[sighted], places=setting.places[source], control=control,
    )  # fmt: skip


def with_heights(setting: Setting, sigma: float) -> Setting:
    """Heights of all points known to `sigma` (m), each with an error of its own: an elevation model."""
    if setting.radii is None:
        height = float(setting.places[:, 2].mean())
    else:
        height = float(to_geodetic(setting.places, setting.radii)[:, 2].mean())
    surface = level_surface(setting.radii, height)
    return replace(setting, heights=HeightPrior(surface, sigma, setting.radii))


def with_control(setting: Setting, count: int, sigma: float) -> Setting:
    """`count` of the points, spread as far as can be, known to `sigma` (m) per coordinate."""
    places = setting.places
    known = [] if setting.control is None else np.unique(setting.control.point).tolist()
    reach = np.linalg.norm(places - places.mean(axis=0), axis=1)
    chosen: list[int] = []
    for last in known:
        reach = np.minimum(reach, np.linalg.norm(places - places[last], axis=1))
    for _ in range(min(count, len(places) - len(known))):
        chosen.append(int(np.argmax(reach)))
        reach = np.minimum(reach, np.linalg.norm(places - places[chosen[-1]], axis=1))
    point, where, sigmas = np.array(chosen), places[chosen], np.full(len(chosen), sigma)
    if setting.control is not None:
        point = np.concatenate([setting.control.point, point])
        where = np.concatenate([setting.control.position, where])
        sigmas = np.concatenate([setting.control.sigma, sigmas])
    return replace(setting, control=ControlPoints(point, where, sigmas))


def with_noise(
    setting: Setting, *, image: float = 1.0, position: float = 1.0, attitude: float = 1.0
) -> Setting:
    """Noise of sightings, positions and attitudes times these factors."""
    noise = setting.noise
    noise = replace(noise, position=noise.position * position, attitude=noise.attitude * attitude)
    return replace(setting, sigma_px=setting.sigma_px * image, noise=noise)
