"""Single flight lines of photographs that overlap too little to be followed: poses against the truth.

    python validation/sequence_photographs.py [flights]

Lines of 5 to 12 photographs of 55 to 90 per cent of overlap over level ground or hills, GPS good to 3 m and a
gimbal to 2 degrees, each with a constant error of that size beside; focal length known, or to 2 per cent. The
points of features are drawn, not found. Pinholes are written out here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import gates
import numpy as np
from scipy.spatial.transform import Rotation

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

#: px, m, s: of a small drone's camera, 40 m above the ground, and between photographs.
SHAPE, FOCAL, HEIGHT, EVERY = (2250, 4000), 2311.0, 40.0, 7.0
#: m, degrees: of the tables, per axis, of each row and of all of them alike.
GPS, GIMBAL = 3.0, 2.0
#: px of a sighting; points on the ground; m, degrees by which the path and the attitudes sway.
SIGMA, POINTS, SWAY, TILT = 0.5, 1500, 0.5, 3.0
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

    def stretch(self, poses: FramePoses) -> float:
        """Length found over that flown."""
        found, true = (np.linalg.norm(np.diff(x, axis=0), axis=1) for x in (poses.position, self.position))
        return float(found.sum() / true.sum())


def draw(seed: int, frames: int, overlap: float, hills: float, focal_sigma: float = 0.0) -> Line:
    """A line flown along x; `hills` m rms, `focal_sigma` relative."""
    rng = np.random.default_rng(seed)
    along = (1.0 - overlap) * SHAPE[0] * HEIGHT / FOCAL * np.arange(frames)
    position = np.column_stack([along, np.zeros(frames), np.full(frames, HEIGHT)])
    position += rng.normal(0.0, SWAY, (frames, 3))
    # x forward, y right, z down
    level = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    attitude = level * Rotation.from_rotvec(np.radians(rng.normal(0.0, TILT, (frames, 3))))
    ground = np.column_stack(
        [
            rng.uniform(-30.0, along[-1] + 30.0, POINTS),
            rng.uniform(-40.0, 40.0, POINTS),
            rng.normal(0.0, hills, POINTS),
        ]
    )
    image, point, pixels = _seen(position, attitude, ground, rng)
    given = position + rng.normal(0.0, GPS, (frames, 3)) + rng.normal(0.0, GPS, 3)
    wrong = np.radians(rng.normal(0.0, GIMBAL, (frames, 3)) + rng.normal(0.0, GIMBAL, 3))
    order, turn = np.arange(frames), np.radians(GIMBAL)
    images = Images(
        np.zeros(frames, dtype=int), order, EVERY * order, given, attitude * Rotation.from_rotvec(wrong)
    )
    known = RoughPoses(np.full((frames, 3), GPS), np.full((frames, 3), turn), GPS, turn)
    focal = FOCAL / (1.0 + focal_sigma * rng.normal())
    middle = ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0)
    names = tuple(f"photograph {k}" for k in range(frames))
    camera = AreaDetector("camera", SHAPE, focal, middle)
    problem = SequenceProblem(
        names, EVERY * order, (ArrayImage(np.ones((4, 4))),) * frames, camera, NADIR_MOUNT, images, known,
        Plane(0.0), max(hills, 1.0), 0.0, 0.8, ("",) * frames, focal_length_sigma_px=focal_sigma * FOCAL,
    )  # fmt: skip
    ones = np.ones(frames)
    followed = Followed(
        image, point, pixels, np.full(len(image), SIGMA), order - 1, np.zeros((frames, 4)),
        np.bincount(image, minlength=frames), ones, ones, ("",) * frames, True,
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


def main(flights: int) -> None:
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


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    gates.run(lambda: main(count), __file__)
