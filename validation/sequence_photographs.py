"""Photographs that overlap too little to be followed: poses of lines and blocks of lines against the truth.

    python validation/sequence_photographs.py [lines] [blocks of each kind] [rendered blocks]

Lines of 5 to 12 photographs of 55 to 90 per cent of overlap, and blocks of several lines, over level ground
or hills, GPS good to 3 m and a gimbal to 2 degrees, each with a constant error of that size beside; focal
length known, or to 2 per cent. The points of features are drawn, not found; pinholes are written out here.
Rendered blocks are photographs whose windows are found.

Absolute poses hang on the constant errors of the tables, one draw a flight. How frames lie to each other
hangs on the windows: that is judged by the poses of all frames in the axes of the first and in units of the
farthest, with the covariance between all of them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import gates
import numpy as np
from rigs import height_error
from scipy.spatial.transform import Rotation
from sequence_poses import problem_of

from sightline.applications.sequence_poses import georeference_sequence
from sightline.errors import EstimationError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.solver import SequenceSolver
from sightline.photogrammetry.flight.table_check import misfits
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import sequence_case

#: px, m, s: of a small drone's camera, 40 m above the ground, and between photographs.
SHAPE, FOCAL, HEIGHT, EVERY = (2250, 4000), 2311.0, 40.0, 7.0
#: s from line to line beside that.
TURNING = 10.0
#: m, degrees: of the tables, per axis, of each row and of all of them alike.
GPS, GIMBAL = 3.0, 2.0
#: px of a sighting; points on the ground; m, degrees by which the path and the attitudes sway.
SIGMA, POINTS, SWAY, TILT = 0.5, 1500, 0.5, 3.0
#: Times their true size that the sigmas of sightings in blocks are stated: matches cannot know by how much
#: two views of one place differ.
STATED = 4.0
#: Blocks: lines, photographs in each, overlap along and across, m rms of the hills, relative sigma of the
#: focal length.
BLOCKS = {
    "3 lines of 8, flat": (3, 8, 0.6, 0.35, 0.3, 0.0),
    "3 lines of 8, hills": (3, 8, 0.6, 0.35, 3.0, 0.0),
    "2 short lines of 5": (2, 5, 0.6, 0.4, 1.0, 0.0),
    "2 long lines of 20": (2, 20, 0.7, 0.4, 2.0, 0.0),
    "5 lines of 5, focal length to 2 %": (5, 5, 0.7, 0.4, 3.0, 0.02),
}
#: Of rendered blocks: two lines of six photographs that sway as drones do.
RENDERED = {
    "filter": "pan", "shape": (480, 640), "focal_length_px": 500.0, "overlap": 0.55, "frames": 6,
    "flight_lines": 2, "side_overlap": 0.4, "frame_rate": 0.33, "jitter": 0.01, "position_jitter": 0.5,
    "position_sigma": GPS, "position_bias_sigma": GPS, "attitude_sigma": float(np.radians(GIMBAL)),
    "attitude_bias_sigma": float(np.radians(GIMBAL)), "spectra": "law",
}  # fmt: skip
#: Squared error over covariance / 6 from which on a line is printed.
SHOWN = 2.0


@dataclass(frozen=True)
class Line:
    """A flight line: what is given of it, what was seen, and the truth."""

    problem: SequenceProblem
    followed: Followed
    position: np.ndarray
    attitude: Rotation

    def errors(self, poses: FramePoses) -> np.ndarray:
        """(M, 6) m, rad."""
        turn = (self.attitude.inv() * poses.world_from_body).as_rotvec()
        return np.concatenate([poses.position - self.position, turn], axis=1)

    def squares(self, poses: FramePoses) -> np.ndarray:
        """(M,) squared error over covariance: 6 on average."""
        error = self.errors(poses)
        return np.einsum("ki,ki->k", error, np.linalg.solve(poses.covariance, error[..., None])[..., 0])

    def apart(self, poses: FramePoses) -> tuple[float, int]:
        """Squared error over covariance of all poses to each other, and how many numbers they are.

        In the axes of the first, in units of the farthest from it: a flight that is turned, or too large, as
        a whole moves its frames against each other by more than is linear.
        """
        return apart(self.position, self.attitude, poses)

    def stretch(self, poses: FramePoses) -> float:
        """Length found over that flown."""
        found, true = (np.linalg.norm(np.diff(x, axis=0), axis=1) for x in (poses.position, self.position))
        return float(found.sum() / true.sum())


def apart(position: np.ndarray, attitude: Rotation, poses: FramePoses) -> tuple[float, int]:
    """As of `Line`."""

    def seen(place: np.ndarray, turn: Rotation) -> tuple[np.ndarray, Rotation]:
        back = turn[0].inv()
        return back.apply(place[1:] - place[0]), back * turn[1:]

    place, turn = seen(position, attitude)
    place_found, turn_found = seen(poses.position, poses.world_from_body)
    far = int(np.linalg.norm(place, axis=1).argmax())
    length, length_found = np.linalg.norm(place[far]), np.linalg.norm(place_found[far])
    moved = place_found / length_found - place / length
    error = np.concatenate([moved, (turn.inv() * turn_found).as_rotvec()], axis=1).ravel()
    count, back = len(place), attitude[0].as_matrix().T
    # the change of both with all poses: turns of the first move and turn all others
    by = np.zeros((count, 6, count + 1, 6))
    for k, (x, y, z) in enumerate(place):
        by[k, :3, k + 1, :3], by[k, :3, 0, :3] = back / length, -back / length
        by[k, :3, 0, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / length
        by[k, 3:, k + 1, 3:], by[k, 3:, 0, 3:] = np.eye(3), -turn[k].as_matrix().T
    # the unit of length is that of the farthest, which has none of its own
    ahead = place[far] / length
    along = np.einsum("a,akb->kb", ahead, by[far, :3])
    by[:, :3] -= np.einsum("na,kb->nakb", place / length, along)
    free = np.eye(6 * count)
    free[6 * far : 6 * far + 3, 6 * far : 6 * far + 3] = np.linalg.svd(ahead[None])[2]
    free = np.delete(free, 6 * far, axis=0)
    flat = free @ by.reshape(6 * count, -1)
    assert poses.pair_covariance is not None
    whole = poses.pair_covariance.reshape(flat.shape[1], flat.shape[1])
    left = free @ error
    return float(left @ np.linalg.solve(flat @ whole @ flat.T, left)), len(left)


class Hills:
    """Heights in closed form that go together over the area of a frame, as a given height is taken to."""

    def __init__(self, rng: np.random.Generator, rms: float) -> None:
        area = SHAPE[0] * SHAPE[1] * (HEIGHT / FOCAL) ** 2
        self.rms, self.wave = rms, rng.standard_normal((40, 2)) * np.sqrt(2.0 * np.pi / area)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 40)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """m, of places."""
        angle = self.wave[:, 0] * x[:, None] + self.wave[:, 1] * y[:, None] + self.phase
        return np.asarray(self.rms * np.sqrt(2.0 / 40) * np.sin(angle).sum(axis=1))


def draw(
    seed: int,
    frames: int,
    overlap: float,
    hills: float,
    focal_sigma: float = 0.0,
    *,
    lines: int = 1,
    side: float = 0.0,
    stated: float = 1.0,
) -> Line:
    """Lines flown along x, to and fro; `hills` m rms, `focal_sigma` relative.

    `side`: overlap of neighbouring lines; `stated`: sigma given of sightings over the true one.
    """
    rng = np.random.default_rng(seed)
    scale, count = HEIGHT / FOCAL, lines * frames
    along, across = (1.0 - overlap) * SHAPE[0] * scale, (1.0 - side) * SHAPE[1] * scale
    line, place = np.divmod(np.arange(count), frames)
    back = line % 2 == 1
    forward = along * np.where(back, frames - 1 - place, place)
    position = np.column_stack([forward, across * line, np.full(count, HEIGHT)])
    position += rng.normal(0.0, SWAY, (count, 3))
    # x forward, y right, z down
    level = Rotation.from_rotvec(np.pi * np.outer(back, [0.0, 0.0, 1.0])) * Rotation.from_matrix(
        np.diag([1.0, -1.0, -1.0])
    )
    attitude = level * Rotation.from_rotvec(np.radians(rng.normal(0.0, TILT, (count, 3))))
    points = int(POINTS * (1.0 + 0.6 * (lines - 1)))
    x = rng.uniform(-30.0, along * (frames - 1) + 30.0, points)
    y = rng.uniform(-40.0, across * (lines - 1) + 40.0, points)
    ground = np.column_stack([x, y, Hills(rng, hills)(x, y)])
    image, point, pixels = _seen(position, attitude, ground, rng)
    given = position + rng.normal(0.0, GPS, (count, 3)) + rng.normal(0.0, GPS, 3)
    wrong = np.radians(rng.normal(0.0, GIMBAL, (count, 3)) + rng.normal(0.0, GIMBAL, 3))
    order, turn = np.arange(count), np.radians(GIMBAL)
    t = EVERY * order + TURNING * line
    images = Images(np.zeros(count, dtype=int), order, t, given, attitude * Rotation.from_rotvec(wrong))
    known = RoughPoses(np.full((count, 3), GPS), np.full((count, 3), turn), GPS, turn)
    focal = FOCAL / (1.0 + focal_sigma * rng.normal())
    middle = ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0)
    names = tuple(f"photograph {k}" for k in range(count))
    camera = AreaDetector("camera", SHAPE, focal, middle)
    problem = SequenceProblem(
        names, t, (ArrayImage(np.ones((4, 4))),) * count, camera, NADIR_MOUNT, images, known,
        Plane(0.0), hills, 0.0, 0.8, ("",) * count, focal_length_sigma_px=focal_sigma * FOCAL,
    )  # fmt: skip
    ones = np.ones(count)
    followed = Followed(
        image, point, pixels, np.full(len(image), stated * SIGMA), order - 1, np.zeros((count, 4)),
        np.bincount(image, minlength=count), ones, ones, ("",) * count, True,
    )  # fmt: skip
    return Line(problem, followed, position, attitude)


def _seen(
    position: np.ndarray, attitude: Rotation, ground: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photograph, point and (line, column) px of points that two show or more."""
    image, point, pixels = [], [], []
    middle = (np.array(SHAPE) - 1.0) / 2.0
    for k in range(len(position)):
        forward, right, down = attitude[k].inv().apply(ground - position[k]).T
        # lines count forward, columns to the left
        at = middle + FOCAL * np.column_stack([forward, -right]) / down[:, None]
        inside = np.flatnonzero(((at > 5.0) & (at < np.array(SHAPE) - 6.0)).all(axis=1))
        image.append(np.full(len(inside), k))
        point.append(inside)
        pixels.append(at[inside])
    images, points = np.concatenate(image), np.concatenate(point)
    twice = np.bincount(points, minlength=len(ground))[points] >= 2
    order = np.flatnonzero(twice)[np.lexsort((images[twice], points[twice]))]
    found = np.concatenate(pixels)[order] + rng.normal(0.0, SIGMA, (len(order), 2))
    return images[order], np.unique(points[order], return_inverse=True)[1], found


def lines(flights: int) -> None:
    """Print lines that are far off, check all of them together."""
    for focal_sigma, words in ((0.0, "focal length known"), (0.02, "focal length to 2 %")):
        squares, unsaid = [], 0
        for seed in range(flights):
            rng = np.random.default_rng(1000 + seed)
            frames, overlap = int(rng.integers(5, 13)), float(rng.uniform(0.55, 0.9))
            line = draw(seed, frames, overlap, float(rng.choice([0.3, 3.0])), focal_sigma)
            try:
                found = SequenceSolver(line.problem, line.followed).approached()
            except EstimationError as error:
                print(f"  {words}, {seed}: refused: {error}")
                continue
            poses = found.poses
            square = float(line.squares(poses).mean()) / 6.0
            error = np.abs(line.errors(poses)) / np.sqrt(np.einsum("kii->ki", poses.covariance))
            said = [*found.words, *(misfit.words for misfit in misfits(line.problem, poses))]
            squares.append(square)
            unsaid += bool(error.max() > 5.0 and not said)
            if square > SHOWN or said:
                print(
                    f"  {words}, {seed}: {frames} photographs, overlap {overlap:.0%}, length "
                    f"{line.stretch(poses):.3f} of the true one, squared error over covariance / 6 "
                    f"{square:.2f}, worst {error.max():.1f} sigma, {len(said)} warnings"
                )
        gates.check(f"{words}: lines solved, %", 100.0 * len(squares) / flights, 95.0)
        # of six parameters, whose datum is one draw a flight
        bounds = gates.nees_bounds(6 * len(squares))
        gates.check(f"{words}: squared error over covariance / 6", float(np.mean(squares)), *bounds)
        gates.check(f"{words}: lines 5 sigma off without a warning", float(unsaid), 0.0, 0.0)


def blocks(flights: int) -> None:
    """Blocks of several lines whose sightings are better than stated."""
    every = []
    for title, (count, frames, overlap, side, hills, focal_sigma) in BLOCKS.items():
        squares, own = [], []
        for seed in range(flights):
            flight = draw(
                seed, frames, overlap, hills, focal_sigma, lines=count, side=side, stated=STATED
            )  # fmt: skip
            poses = SequenceSolver(flight.problem, flight.followed).approached().poses
            squares.append(flight.apart(poses))
            own.append(float(flight.squares(poses).mean()) / 6.0)
        square, numbers = np.sum(squares, axis=0)
        every.append(float(np.mean(own)))
        print(f"  {title}: between frames {square / numbers:.3f}, of each frame {np.mean(own):.3f}")
        gates.check(f"{title}: NEES between frames", float(square / numbers), 0.8, 1.25)
    bounds = gates.nees_bounds(6 * flights * len(BLOCKS))
    gates.check("blocks: squared error over covariance / 6", float(np.mean(every)), *bounds)


def rendered(flights: int) -> None:
    """Blocks of rendered photographs.

    Poses of single frames are shown, not judged: six draws a flight say nothing of four flights, and relief
    of the extent of a frame tilts the ground by less than a height prior takes it to (docs/theory/s4.md, 4).
    """
    squares, own, said = [], [], 0
    for seed in range(100, 100 + flights):
        scenario = sequence_case("lvf", seed, **RENDERED)
        problem = problem_of(scenario)
        problem = replace(problem, surface=problem.surface.raised(height_error(scenario)))
        found = georeference_sequence(problem)
        if not found.followed.wide:
            continue
        said += 1
        flight = Line(problem, found.followed, *scenario.poses[1:])
        squares.append(flight.apart(found.poses))
        own.append(float(flight.squares(found.poses).mean()) / 6.0)
        print(
            f"  rendered, {seed}: between frames {squares[-1][0] / squares[-1][1]:.2f}, of each {own[-1]:.2f}"
        )
    gates.check("rendered blocks: linked by features", float(said), 2.0)
    if squares:
        square, numbers = np.sum(squares, axis=0)
        gates.check("rendered blocks: NEES between frames", float(square / numbers), 0.8, 1.25)


def main(of_lines: int, of_blocks: int, of_rendered: int) -> None:
    """All figures."""
    lines(of_lines)
    blocks(of_blocks)
    rendered(of_rendered)


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    gates.run(lambda: main(*(numbers + [60, 12, 4][len(numbers) :])), __file__)
