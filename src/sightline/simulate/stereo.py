"""A pass of synchronous cameras over one scene: the truth for constant errors of their attitude (S2).

True points are projected through true poses with exact rotations; then noise is added to pixels and to the
poses that are given. S2's angles w of a camera turn its nominal axes into its actual ones by
Q = A_z A_y A_x; the package's (`angles`) are the rotation vector of the inverse of Q, on the body side.

Files are written by ``stereo_files.py``; options and cases are in ``stereo_options.py``.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import GeometryError, InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.earth import WGS84, from_geodetic, to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.orbit_pair import SPHERE, OrbitPair
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Dem, Ellipsoid
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.simulate.option_checks import options_of
from sightline.simulate.stereo_ground import lay_ground, lay_points
from sightline.simulate.stereo_options import CASE_OPTIONS, StereoOptions

EPOCH = "2026-01-01T00:00:00Z"
MISMATCH_PX = (2.0, 50.0)
"""Least and largest distance of a mismatch from where the point is."""

_SIGNS = np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class StereoScenario(ReadOnlyArrays):
    """A pass: truth, and what a user would know.

    Parameters
    ----------
    case : str
    seed : int
    options : StereoOptions
    pair : OrbitPair
        Orbits, aim point, ellipsoid.
    detectors : tuple of AreaDetector
        True, one per camera.
    surface : Dem or Ellipsoid
        The ground, Earth-fixed axes.
    points : (n, 3) m, true, Earth-fixed axes
    s2_angles : (C, 3) rad, S2's w of each camera at the middle of the window
    s2_rates : (C, 3) rad/s, their drift
    true_images : Images
        True poses.
    images : Images
        The same images with the given poses.
    tracks : Tracks
        Given pixels; `image` is a row of `images`, `point` one of `points`.
    displacement : (N, 2) px, how far each of them is off by mismatch: zero for most
    """

    case: str
    seed: int
    options: StereoOptions
    pair: OrbitPair
    detectors: tuple[AreaDetector, ...]
    surface: Dem | Ellipsoid
    points: Array
    s2_angles: Array
    s2_rates: Array
    true_images: Images
    images: Images
    tracks: Tracks
    displacement: Array

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(str(number + 1) for number in range(self.options.cameras))

    @property
    def mounts(self) -> tuple[Rotation, ...]:
        """body_from_camera of each camera: the nominal mount."""
        return (NADIR_MOUNT,) * self.options.cameras

    @property
    def middle(self) -> float:
        """s, the time at which `angles` hold where they drift."""
        return self.pair.middle_time + self.options.offset

    @cached_property
    def angles(self) -> Array:
        """(C, 3) rad, true constant errors: rotation vector about body axes, actual from planned."""
        return frozen(_body_angles(self.s2_angles, self.options.leader))

    @cached_property
    def rates(self) -> Array:
        """(C, 3) rad/s, true drift of `angles` at the middle of the window."""
        step = 1.0  # s: the angles bend by drift^2 x step, far below 1e-9 of the drift
        ends = [
            _body_angles(self.s2_angles + sign * step * self.s2_rates, self.options.leader)
            for sign in (1.0, -1.0)
        ]
        return frozen((ends[0] - ends[1]) / (2.0 * step))

    @cached_property
    def true_pixels(self) -> Array:
        """(N, 2) px where the points of `tracks` truly are, (line, column)."""
        every = _project(self.true_images, self.detectors, self.points)
        return frozen(every[self.tracks.image, self.tracks.point])

    @property
    def mismatched(self) -> NDArray[np.bool_]:
        """(N,) which rows of `tracks` are mismatches."""
        return np.asarray((self.displacement != 0.0).any(axis=1))

    @property
    def noise(self) -> PoseNoise:
        """What is known of the poses' errors."""
        options = self.options
        aim = self.pair.aim_point if options.attitude_knowledge == "from-position" else None
        return PoseNoise(options.sigma_position, options.sigma_attitude, aim)

    @property
    def given_detectors(self) -> tuple[AreaDetector, ...]:
        """The detectors as given: the focal length without its error."""
        focal = self.options.focal_length_px
        return tuple(dataclasses.replace(true, focal_length_px=focal) for true in self.detectors)

    @property
    def height_prior(self) -> HeightPrior | None:
        """The given DEM, if any."""
        if self.options.dem_sigma == 0.0:
            return None
        return HeightPrior(self.surface, self.options.dem_sigma, self.pair.radii)

    def control_points(self, count: int, sigma: float = 1.0) -> ControlPoints:
        """`count` of the sighted points whose coordinates are known to `sigma` m, drawn by the seed."""
        seen = np.unique(self.tracks.point)
        if not 1 <= count <= len(seen):
            raise InputError(f"`count` of control points must be from 1 to {len(seen)}, got {count}")
        rng = np.random.default_rng(_noise_seeds(self.seed)[6])
        chosen = np.sort(rng.choice(seen, count, replace=False))
        error = self.options.noise_scale * sigma * rng.standard_normal((count, 3))
        return ControlPoints(chosen, self.points[chosen] + error, np.full(count, sigma))

    def problem(self, control_points: int = 0, control_sigma: float = 1.0) -> dict[str, Any]:
        """What a user would know, as the fields of ``StereoProblem``, without going through files.

        Points are those that were sighted, counted anew; `point_names` are their rows in `points`.
        """
        names, point = np.unique(self.tracks.point, return_inverse=True)
        control = None
        if control_points:
            known = self.control_points(control_points, control_sigma)
            control = ControlPoints(np.searchsorted(names, known.point), known.position, known.sigma)
        return {
            "cameras": self.cameras,
            "images": self.images,
            "shot_names": np.arange(self.options.shots, dtype=np.float64),
            "detectors": self.given_detectors,
            "mounts": self.mounts,
            "tracks": Tracks(self.tracks.image, point, self.tracks.pixels, self.tracks.sigma_px),
            "point_names": names.astype(np.float64),
            "noise": self.noise,
            "radii": self.pair.radii,
            "heights": self.height_prior,
            "control": control,
            "focal_sigma": (np.inf,) * self.options.cameras if self.options.focal_error else None,
            "epoch": EPOCH,
        }


def stereo_options(case: str = "A_paper_T6_K64", **overrides: Any) -> StereoOptions:
    """The options of `stereo_case`, nothing drawn; parameters as there."""
    return options_of(StereoOptions, CASE_OPTIONS, case, overrides)


def stereo_case(case: str = "A_paper_T6_K64", seed: int = 0, **overrides: Any) -> StereoScenario:
    """A pass of one of the named cases.

    Parameters
    ----------
    case : str
        One of `CASE_OPTIONS`.
    seed : int
        The same seed gives the same pass, bit for bit.
    **overrides
        Fields of :class:`~sightline.simulate.stereo_options.StereoOptions`.

    Examples
    --------
    >>> pass_over = stereo_case("A_paper_T6_K64", 0, shots=3, points=10)
    >>> len(pass_over.images), len(pass_over.tracks)
    (6, 60)
    """
    options = stereo_options(case, **overrides)
    scene = options.scene_seed if options.scene_seed >= 0 else seed
    relief_seed, point_seed, sign_seed = np.random.SeedSequence(scene, spawn_key=(0,)).spawn(3)
    pair = orbit_pair(options)
    surface = lay_ground(options, pair, relief_seed)
    points = lay_points(options, pair, surface, point_seed)
    angles, rates = _draw_errors(options, sign_seed)
    seeds = _noise_seeds(seed)
    points = _off_the_dem(options, pair, points, seeds[7])
    true_images, images = _draw_poses(options, pair, angles, rates, seeds)
    lines, columns = options.frame
    detector = AreaDetector(
        "frame",
        options.frame,
        options.focal_length_px * (1.0 + options.focal_error),
        (0.5 * (lines - 1), 0.5 * (columns - 1)),
    )
    detectors = (detector,) * options.cameras
    tracks, displacement = _draw_tracks(options, true_images, detectors, points, seeds)
    return StereoScenario(
        case, seed, options, pair, detectors, surface, frozen(points), angles, rates, true_images, images,
        tracks, frozen(displacement),
    )  # fmt: skip


def orbit_pair(options: StereoOptions) -> OrbitPair:
    """The orbits of a pass and the point that all cameras look at."""
    return OrbitPair(
        altitude=options.altitude,
        inclination=options.inclination,
        latitude=options.latitude,
        separation=options.separation,
        cameras=options.cameras,
        leader=options.leader,
        longitude=options.longitude,
        cross_track=options.cross_track,
        node_offset=options.node_offset,
        inclination_offset=options.inclination_offset,
        radii=SPHERE if options.earth == "sphere" else WGS84,
    )


def _noise_seeds(seed: int) -> list[np.random.SeedSequence]:
    """Of jitter, positions, pixels, mismatches, visibility, images never taken, control points, heights."""
    return np.random.SeedSequence(seed, spawn_key=(1,)).spawn(8)


def _error_rotation(w: Array) -> Rotation:
    """S2's Q = A_z A_y A_x of angles w (..., 3): actual from nominal camera axes, about them."""
    return Rotation.from_euler("xyz", w)


def _to_body(leader: int) -> Array:
    """(3,) signs that lead from S2's camera axes to body axes: x and y are reversed where the last leads."""
    return np.array([1.0, 1.0, 1.0] if leader == 1 else [-1.0, -1.0, 1.0])


def _body_angles(w: Array, leader: int) -> Array:
    """Rotation vectors (..., 3) about body axes, actual from planned, of S2's angles w."""
    return np.asarray(_error_rotation(w).inv().as_rotvec() * _to_body(leader))


def _draw_errors(options: StereoOptions, seed: np.random.SeedSequence) -> tuple[Array, Array]:
    """S2's angles (C, 3) rad and their rates (C, 3) rad/s."""
    rng = np.random.default_rng(seed)
    random_signs, rate_signs = rng.choice([-1.0, 1.0], (2, options.cameras, 3))
    signs = _SIGNS[np.arange(options.cameras) % 2] if options.signs == "s2" else random_signs
    angles = np.array(options.angles) if options.angles else options.error * signs
    return frozen(angles), frozen(options.drift * rate_signs)


def _off_the_dem(
    options: StereoOptions, pair: OrbitPair, points: Array, seed: np.random.SeedSequence
) -> Array:
    """The points, raised by as much as the given DEM is wrong."""
    if options.dem_sigma == 0.0:
        return points
    geodetic = to_geodetic(points, pair.radii)
    error = np.random.default_rng(seed).standard_normal(len(points))
    geodetic[:, 2] += options.noise_scale * options.dem_sigma * error
    return from_geodetic(geodetic, pair.radii)


def _draw_poses(
    options: StereoOptions,
    pair: OrbitPair,
    angles: Array,
    rates: Array,
    seeds: list[np.random.SeedSequence],
) -> tuple[Images, Images]:
    """True poses of the images that were taken, and the given ones."""
    t = pair.shot_times(options.window, options.shots, options.offset)
    places = pair.positions(t)
    noise = np.random.default_rng(seeds[1]).standard_normal(places.shape)
    given_places = places + options.noise_scale * options.sigma_position * noise
    planned = pair.world_from_body(t)
    given = planned
    if options.attitude_knowledge == "from-position":
        given = pair.world_from_body(t, given_places)
    since = (t - (pair.middle_time + options.offset))[:, np.newaxis]
    w = angles[:, np.newaxis] + rates[:, np.newaxis] * since + _draw_jitter(options, t, seeds[0])
    turned = Rotation.from_rotvec(_body_angles(w.reshape(-1, 3), options.leader))
    actual = Rotation.from_matrix(planned.reshape(-1, 3, 3)) * turned
    taken = np.random.default_rng(seeds[5]).uniform(size=len(actual)) >= options.missing_images
    camera, shot = (
        index.ravel()[taken] for index in np.indices((options.cameras, options.shots), dtype=np.intp)
    )

    def images(places: Array, attitudes: Rotation) -> Images:
        return Images(camera, shot, t[shot], places.reshape(-1, 3)[taken], attitudes[taken])

    if not taken.any():
        raise InputError("no image was taken; lower `missing_images`")
    return images(places, actual), images(given_places, Rotation.from_matrix(given.reshape(-1, 3, 3)))


def _draw_jitter(options: StereoOptions, t: Array, seed: np.random.SeedSequence) -> Array:
    """What is added to S2's angles shot by shot, (C, K, 3) rad."""
    rng = np.random.default_rng(seed)
    shape = (options.cameras, len(t), 3)
    rms = options.noise_scale * options.sigma_attitude
    if options.jitter == "white":
        return np.asarray(rms * rng.standard_normal(shape))
    phase = rng.uniform(0.0, 2.0 * np.pi, (options.cameras, 1, 3))
    if options.jitter_shared:
        phase = phase[:1]
    swing = np.sin(2.0 * np.pi * options.jitter_frequency * t[:, np.newaxis] + phase)
    return np.broadcast_to(np.sqrt(2.0) * rms * swing, shape)


def _project(images: Images, detectors: tuple[AreaDetector, ...], points: Array) -> Array:
    """(M, n, 2) px: every point in every image, not clipped to the frame; NaN behind the camera."""
    out = np.empty((len(images), len(points), 2))
    for row in range(len(images)):
        camera_from_world = (images.world_from_body[row] * NADIR_MOUNT).inv()
        q = camera_from_world.apply(points - images.position[row])
        out[row] = detectors[images.camera[row]].pixels(q)
    return out


def _draw_tracks(
    options: StereoOptions,
    images: Images,
    detectors: tuple[AreaDetector, ...],
    points: Array,
    seeds: list[np.random.SeedSequence],
) -> tuple[Tracks, Array]:
    """Given pixels of every point found, and how far they are off by mismatch."""
    true = _project(images, detectors, points)
    # Drawn for every camera, shot and point whether seen or not: no option changes the noise of the others.
    every = (options.cameras, options.shots, len(points), 2)
    noise = np.random.default_rng(seeds[2]).standard_normal(every)[images.camera, images.shot]
    pixels = true + options.noise_scale * options.sigma_px * noise
    found = _inside(true, options.frame) & _inside(pixels, options.frame)
    found &= _draw_found(options, images, len(points), seeds[4])
    if not options.by_sighting:
        found &= _count(images, found, options.shots)[images.shot] == options.cameras
    if not found.any():
        raise GeometryError(
            "no point is seen by the cameras: the scene lies outside their frames, or too little is found; "
            "check `fov`, `scene_size`, `match_share` and `missing_images`"
        )
    displacement = _draw_mismatches(options, images, pixels, found, seeds[3])
    image, point = np.nonzero(found)
    given = (pixels + displacement)[image, point]
    return Tracks(image, point, given, np.full(len(image), options.sigma_px)), displacement[image, point]


def _inside(pixels: Array, frame: tuple[int, int]) -> NDArray[np.bool_]:
    """Which of `pixels` (..., 2) lie on the frame."""
    last = np.array(frame) - 0.5
    return np.asarray(((pixels >= -0.5) & (pixels <= last)).all(axis=-1))


def _count(images: Images, found: NDArray[np.bool_], shots: int) -> NDArray[np.intp]:
    """(K, n) in how many images of each shot each point is found."""
    count = np.zeros((shots, found.shape[1]), dtype=np.intp)
    np.add.at(count, images.shot, found)
    return count


def _draw_found(
    options: StereoOptions, images: Images, points: int, seed: np.random.SeedSequence
) -> NDArray[np.bool_]:
    """(M, n) whether the matcher finds each point in each image, were it in the frame."""
    chance_rng, track_rng = (np.random.default_rng(child) for child in seed.spawn(2))
    chance = chance_rng.uniform(size=(options.cameras, options.shots, points))
    if not options.by_sighting:
        chance[:] = chance[0]  # a match is found or not, in both images at once
    found = (chance < options.match_share)[images.camera, images.shot]
    fewest, most = options.track_shots
    if most:
        length = track_rng.integers(fewest, most + 1, points)
        first = np.floor(track_rng.uniform(size=points) * (options.shots - length + 1))
        shot = images.shot[:, np.newaxis]
        found &= (shot >= first) & (shot < first + length)
    return np.asarray(found)


def _draw_mismatches(
    options: StereoOptions,
    images: Images,
    pixels: Array,
    found: NDArray[np.bool_],
    seed: np.random.SeedSequence,
) -> Array:
    """(M, n, 2) px: in one image of every mismatched (shot, point) a step, even over a ring; else zero."""
    rng = np.random.default_rng(seed)
    out = np.zeros_like(pixels)
    chance = rng.uniform(size=(options.shots, pixels.shape[1]))
    which = rng.uniform(size=chance.shape)
    wrong = (chance < options.mismatch_share)[images.shot] & found
    # the image that is wrong: one of those that found the point in this shot, each as likely
    order = np.zeros_like(found, dtype=np.intp)
    count = np.zeros(chance.shape, dtype=np.intp)
    for row in np.argsort(images.camera, kind="stable"):
        order[row] = count[images.shot[row]]
        count[images.shot[row]] += found[row]
    wrong &= order == np.floor(which * count)[images.shot]
    image, point = np.nonzero(wrong)
    waiting = np.arange(len(image))
    while len(waiting):
        radius = np.sqrt(rng.uniform(MISMATCH_PX[0] ** 2, MISMATCH_PX[1] ** 2, len(waiting)))
        angle = rng.uniform(0.0, 2.0 * np.pi, len(waiting))
        step = radius[:, np.newaxis] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        rows, columns = image[waiting], point[waiting]
        out[rows, columns] = step
        # a match lies on the frame: where the step leads off it, another is drawn
        waiting = waiting[~_inside(pixels[rows, columns] + step, options.frame)]
    return out
