"""Intervals of the poses of a sequence: how often 95 % intervals hold the truth, over many flights of points.

No images: points on hills are sighted through frames with the errors that the dense stage assumes: each
sighting by itself, windows that drift while they are followed, a few gross errors, tables with noise and a
bias, a surface that is wrong. All is drawn anew for every flight. The truth has its own closed form (rolls,
hills and pinholes are written out here), and the estimate is the application's own.

Where the whole flight lies (the datum: biases, mean height) is one draw a flight: all its frames are off
together. So the share of frames inside their intervals is taken per flight, and the scatter of these shares
over flights tells how sure their mean is. Rendered flights are a check beside them: ten tell a share only to
some seven per cent. Run with numbers of both: ``sequence_covariance.py 500 10``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from sequence_poses import problem_of

from sightline.applications.frame_sequence import SequenceProblem
from sightline.applications.sequence_poses import georeference_sequence, poses_of_windows
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.frame_poses import FramePoses, RoughPoses
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import sequence_case

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
SHAPE, FOCAL, ALTITUDE, RATE = (160, 200), 250.0, 80.0, 25.0
FRAMES, STEP, WINDOWS, LIFE = 48, 0.02, 60, 0.4
#: m and rad: noise and bias of the tables.
PLACE, PLACE_BIAS, TURN, TURN_BIAS = 1.0, 2.0, np.radians(0.5), np.radians(1.0)
#: px of a sighting by itself, px of drift from frame to frame, share of gross errors.
OWN, DRIFT, GROSS = 0.06, 0.012, 0.003
#: m: of the hills, rms.
HILLS = 1.0
INSIDE = 1.959964


@dataclass(frozen=True)
class Setting:
    """What is flown over, and how well it is told.

    Attributes
    ----------
    place, place_bias : float
        m, noise and constant error of positions.
    no_heights : bool
        Heights of positions are not told: the estimate starts 5 m (1 sigma) off.
    hills : float
        m, rms of the hills.
    climb : float
        m, gained from the first frame to the last.
    focal_sigma : float
        Relative 1-sigma of the focal length told, by which it is drawn wrong; 0: it is told as it is.
    free : bool
        Nothing is said of how well the focal length is known.
    """

    place: float = PLACE
    place_bias: float = PLACE_BIAS
    no_heights: bool = False
    hills: float = HILLS
    climb: float = 0.0
    focal_sigma: float = 0.0
    free: bool = False

    @property
    def places(self) -> np.ndarray:
        """m (3,), noise of positions."""
        return np.array([self.place, self.place, np.inf if self.no_heights else self.place])


USUAL = Setting()


@dataclass(frozen=True, eq=False)
class Flight:
    """One flight: truth and what is told of it."""

    position: np.ndarray
    matrix: np.ndarray  # world_from_body
    problem: SequenceProblem
    followed: Followed


class Hills:
    """A surface in closed form: sinusoids of all directions, of a Gaussian covariance over places.

    Its correlated area, the integral of the correlation over the plane, is that of a frame.
    """

    def __init__(self, rng: np.random.Generator, rms: float) -> None:
        self.rms = rms
        area = SHAPE[0] * SHAPE[1] * (ALTITUDE / FOCAL) ** 2
        self.wave = rng.standard_normal((40, 2)) * np.sqrt(2.0 * np.pi / area)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 40)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        angle = self.wave[:, 0] * x[..., None] + self.wave[:, 1] * y[..., None] + self.phase
        return self.rms * np.sqrt(2.0 / 40) * np.sin(angle).sum(axis=-1)


def matrices(roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """world_from_body (M, 3, 3) of a body flying north: x forward, y right, z down; world east, north, up."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    forward = np.stack([cp * sy, cp * cy, sp], axis=-1)
    right = np.stack([sr * sp * sy + cr * cy, sr * sp * cy - cr * sy, -sr * cp], axis=-1)
    return np.stack([forward, right, np.cross(forward, right)], axis=-1)


def path(rng: np.random.Generator, t: np.ndarray, climb: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and matrices: even motion, and sinusoids of slow and fast jitter."""

    def swings(size: float, low: float, high: float) -> np.ndarray:
        f, phase = rng.uniform(low, high, (3, 1)), rng.uniform(0.0, 2.0 * np.pi, (3, 1))
        return size * np.sin(2.0 * np.pi * f * t + phase)

    angle = swings(np.radians(1.0), 0.1, 0.8) + swings(np.radians(0.1), 2.7, 3.3)
    place = swings(0.2, 0.05, 0.4)
    speed = STEP * SHAPE[0] * ALTITUDE / FOCAL * RATE
    height = ALTITUDE + climb * (t / t[-1] - 0.5) + place[2]
    position = np.stack([place[0], speed * t + place[1], height], axis=1)
    return position, matrices(*angle)


def see(points: np.ndarray, position: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of points in one frame: lines run forward, columns to the left."""
    forward, right, down = ((points - position) @ matrix).T
    middle = 0.5 * (np.array(SHAPE) - 1.0)
    return middle + FOCAL * np.column_stack([forward / down, -right / down])


def on_ground(pixels: np.ndarray, position: np.ndarray, matrix: np.ndarray, hills: Hills) -> np.ndarray:
    """Where rays of pixels (n, 2) of one frame meet the hills."""
    x = (pixels - 0.5 * (np.array(SHAPE) - 1.0)) / FOCAL
    ray = np.column_stack([x[:, 0], -x[:, 1], np.ones(len(x))]) @ matrix.T
    height = np.zeros(len(x))
    for _ in range(25):
        met = position + ray * ((height - position[2]) / ray[:, 2])[:, None]
        height = hills(met[:, 0], met[:, 1])
    return met


def windows(
    rng: np.random.Generator, position: np.ndarray, matrix: np.ndarray, hills: Hills
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sightings (image, point, pixels) of windows followed from a hub till they leave or live out."""
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    points, hub, walk = np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2))
    name, count = np.empty(0, dtype=int), 0
    for k in range(FRAMES):
        seen = see(points, position[k], matrix[k])
        good = ((seen > 10.0) & (seen < np.array(SHAPE) - 11.0)).all(axis=1)
        good &= np.abs(seen - hub).max(axis=1) < LIFE * SHAPE[0]
        points, hub, walk, name, seen = points[good], hub[good], walk[good], name[good], seen[good]
        walk = walk + DRIFT * rng.standard_normal(walk.shape)
        found = seen + walk + OWN * rng.standard_normal(seen.shape)
        wild = rng.random(len(found)) < GROSS
        found[wild] += rng.uniform(-3.0, 3.0, (wild.sum(), 2))
        if k % 3 == 0 and len(points) < WINDOWS:
            new = rng.uniform(10.0, np.array(SHAPE) - 11.0, (WINDOWS - len(points), 2))
            points = np.concatenate([points, on_ground(new, position[k], matrix[k], hills)])
            hub, walk = np.concatenate([hub, new]), np.concatenate([walk, np.zeros(new.shape)])
            name = np.concatenate([name, count + np.arange(len(new))])
            count += len(new)
            # a hub's own place is where all others are compared to
            found = np.concatenate([found, new + OWN * rng.standard_normal(new.shape)])
        rows.append((np.full(len(name), k), name.copy(), found))
    image, point, pixels = (np.concatenate(part) for part in zip(*rows, strict=True))
    order = np.lexsort((image, point))
    return image[order], point[order], pixels[order]


def draw(seed: int, setting: Setting = USUAL) -> Flight:
    """A flight."""
    rng = np.random.default_rng(seed)
    t = np.arange(FRAMES) / RATE
    position, matrix = path(rng, t, setting.climb)
    image, point, pixels = windows(rng, position, matrix, Hills(rng, setting.hills))
    bias, noise = setting.place_bias * rng.standard_normal(3), rng.standard_normal((FRAMES, 3))
    told = position + bias + setting.place * noise
    if setting.no_heights:
        told[:, 2] = position[:, 2] + 5.0 * noise[0, 2]
    turn = TURN_BIAS * rng.standard_normal(3) + TURN * rng.standard_normal((FRAMES, 3))
    attitude = Rotation.from_matrix(matrix) * Rotation.from_rotvec(turn)
    place = np.tile(setting.places, (FRAMES, 1))
    known = RoughPoses(place, np.full((FRAMES, 3), TURN), setting.place_bias, TURN_BIAS)
    middle = 0.5 * (np.array(SHAPE) - 1.0)
    focal = FOCAL * (1.0 + setting.focal_sigma * rng.standard_normal())
    detector = AreaDetector("frame", SHAPE, focal, (middle[0], middle[1]))
    blank = ArrayImage(np.zeros(SHAPE))
    problem = SequenceProblem(
        tuple(map(str, range(FRAMES))), t, (blank,) * FRAMES, detector, NADIR_MOUNT,
        Images(np.zeros(FRAMES), np.arange(FRAMES), t, told, attitude), known, Plane(0.0),
        setting.hills, 0.0, 0.8, ("",) * FRAMES,
        focal_length_sigma_px=np.inf if setting.free else setting.focal_sigma * focal,
    )  # fmt: skip
    nothing = np.full(FRAMES, np.nan)
    followed = Followed(
        image, point, pixels, np.full(len(image), OWN), np.arange(FRAMES) - 1, np.full((FRAMES, 4), np.nan),
        np.bincount(image, minlength=FRAMES), nothing, nothing, ("",) * FRAMES,
    )  # fmt: skip
    return Flight(position, matrix, problem, followed)


def errors(flight: Flight, poses: FramePoses) -> np.ndarray:
    """(M, 6): of positions (m), of angles (rad, body axes)."""
    turn = np.swapaxes(flight.matrix, 1, 2) @ poses.world_from_body.as_matrix()
    # a small turn by its antisymmetric part
    angle = 0.5 * np.stack([
        turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1],
    ], axis=1)  # fmt: skip
    return np.concatenate([poses.position - flight.position, angle], axis=1)


def scaled_errors(error: np.ndarray, poses: FramePoses) -> tuple[np.ndarray, float]:
    """Errors (M, 6) over their sigmas, and the mean over frames of squared error over covariance."""
    sigma = np.sqrt(np.einsum("kii->ki", poses.covariance))
    solved = np.linalg.solve(poses.covariance, error[..., None])[..., 0]
    return error / sigma, float((error * solved).sum(axis=1).mean())


def of_points(seed: int) -> tuple[np.ndarray, float]:
    """Errors over sigmas of a flight of points."""
    flight = draw(seed)
    poses, _ = poses_of_windows(flight.problem, flight.followed)
    return scaled_errors(errors(flight, poses), poses)


def rendered(seed: int) -> tuple[np.ndarray, float]:
    """Errors over sigmas of a rendered flight."""
    scenario = sequence_case("small", seed)
    poses = georeference_sequence(problem_of(scenario)).poses
    _, position, attitude = scenario.poses
    turn = (attitude.inv() * poses.world_from_body).as_rotvec()
    return scaled_errors(np.concatenate([poses.position - position, turn], axis=1), poses)


def table(title: str, of_seed: Callable[[int], tuple[np.ndarray, float]], flights: int) -> None:
    """Print how often intervals hold the truth."""
    began = time.process_time()
    found = [of_seed(seed) for seed in range(1000, 1000 + flights)]
    scaled = np.array([row[0] for row in found])
    inside = np.abs(scaled) < INSIDE
    share = inside.mean(axis=1)
    print(f"{flights} {title}, {time.process_time() - began:.0f} CPU s")
    print("  frames in their 95 % intervals, per cent; of the middle frame alone; rms of error over sigma")
    for k, name in enumerate(NAMES):
        sure = share[:, k].std() / np.sqrt(flights)
        middle = inside[:, inside.shape[1] // 2, k].mean()
        rms = np.sqrt((scaled[:, :, k] ** 2).mean())
        mean = share[:, k].mean()
        print(f"  {name:6s} {100 * mean:6.1f} +- {100 * sure:.1f}   {100 * middle:6.1f}   {rms:.2f}")
    print(
        f"  mean of squared error over covariance, 6 wanted: {np.mean([row[1] for row in found]):.2f}",
        flush=True,
    )


def main(flights: int, images: int) -> None:
    """Print both tables."""
    if flights:
        table(f"flights of points, {FRAMES} frames", of_points, flights)
    if images:
        table('rendered flights, case "small"', rendered, images)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500, int(sys.argv[2]) if len(sys.argv) > 2 else 10)
