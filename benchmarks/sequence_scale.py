"""Time and memory of a frame sequence against its length: 1,000, 3,000, 10,000 rendered frames of 160 x 200.

Frames are rendered into one file and read one at a time; what is measured is a process of its own that reads
them. ``python benchmarks/sequence_scale.py [FRAMES ...] [--whole]``; "--whole" solves all frames at once, for
comparison. Rendering takes 6 CPU ms per frame, the solution three times as much.
The ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.applications import sequence_poses
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.photogrammetry.flight.blocks import BLOCK_FRAMES
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Images

SIZES = (1000, 3000, 10000)


@dataclass(frozen=True)
class StoredFrame:
    """One frame of many in a file of bytes, read when it is asked for."""

    path: Path
    number: int
    shape: tuple[int, int]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
        """Pixels."""
        size = self.shape[0] * self.shape[1]
        pixels = np.fromfile(self.path, np.uint8, size, offset=self.number * size).reshape(self.shape)
        return np.ascontiguousarray(pixels[slice(*lines), slice(*columns)], np.float32)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> None:
        """No pixel is bad."""


def render(folder: Path, frames: int) -> None:
    """Write frames, what a user knows of them, and the truth."""
    from sightline.simulate.sequence import sequence_case

    scenario = sequence_case("long", 0, spectra="rededge", frames=frames)
    with (folder / "frames.bin").open("wb") as file:
        for number in range(frames):
            file.write(scenario.image(number)[0].tobytes())
    options, (t, position, attitude) = scenario.options, scenario.poses
    np.savez(
        folder / "known.npz", t=t, position=scenario.given_positions,
        attitude=scenario.given_attitudes.as_quat(),
        true_position=position, true_attitude=attitude.as_quat(), shape=options.shape,
        camera=[options.focal_length_px, *options.centre_px], nm=scenario.detector.wavelength_nm,
        sigma=[options.position_sigma, options.attitude_sigma],
        bias=[options.position_bias_sigma, options.attitude_bias_sigma],
        relief=scenario.ground.relief.heights.std(),
    )  # fmt: skip


def problem_of(folder: Path) -> SequenceProblem:
    """The problem of rendered frames."""
    with np.load(folder / "known.npz") as file:
        held = {name: file[name] for name in file.files}
    count, shape = len(held["t"]), (int(held["shape"][0]), int(held["shape"][1]))
    focal, line, column = map(float, held["camera"])
    detector = AreaDetector("frame", shape, focal, (line, column), (), held["nm"])
    known = RoughPoses(
        np.full((count, 3), held["sigma"][0]), np.full((count, 3), held["sigma"][1]),
        float(held["bias"][0]), float(held["bias"][1]),
    )  # fmt: skip
    images = Images(
        np.zeros(count), np.arange(count), held["t"], held["position"], Rotation.from_quat(held["attitude"])
    )
    return SequenceProblem(
        tuple(map(str, range(count))), held["t"],
        tuple(StoredFrame(folder / "frames.bin", k, shape) for k in range(count)), detector, NADIR_MOUNT,
        images, known, Plane(0.0), float(held["relief"]), 0.0, 0.8, ("",) * count,
    )  # fmt: skip


def peak_mb() -> float:
    """Largest resident size of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def solve(folder: Path, whole: bool) -> None:
    """Print what the solution took, as JSON."""
    problem = problem_of(folder)
    if whole:
        sequence_poses.BLOCK_FRAMES = len(problem) + 1
    before, began = peak_mb(), time.process_time()
    found = sequence_poses.georeference_sequence(problem)
    seconds = time.process_time() - began
    with np.load(folder / "known.npz") as file:
        true = Rotation.from_quat(file["true_attitude"])
        move = found.poses.position - file["true_position"]
    error = np.concatenate([move, (true.inv() * found.poses.world_from_body).as_rotvec()], axis=1)
    squares = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.poses.covariance), error)
    print(
        json.dumps(
            {
                "frames": len(problem), "seconds": seconds, "stages": found.seconds, "start": before,
                "peak": peak_mb(), "sightings": len(found.tracks), "nees": float(squares.mean()),
            }
        )
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Print the table."""
    whole = "--whole" in arguments
    sizes = [int(a) for a in arguments if a.isdigit()] or list(SIZES)
    print(f"blocks of {BLOCK_FRAMES} frames" if not whole else "all frames at once")
    print(" frames   CPU s   follow  subset   poses   ms/frame   peak MB  (start)  sightings   NEES / 6")
    for frames in sizes:
        with tempfile.TemporaryDirectory() as folder:
            for step in (["render", folder, str(frames)], ["solve", folder, str(int(whole))]):
                done = subprocess.run(
                    [sys.executable, __file__, *step], check=True, capture_output=True, text=True
                )
        row = json.loads(done.stdout)
        follow, subset, poses = (row["stages"][name] for name in (
            sequence_poses.FOLLOWED, sequence_poses.CHOSEN, sequence_poses.SOLVED_ALL))  # fmt: skip
        print(
            f"{frames:7d} {row['seconds']:7.1f} {follow:8.1f} {subset:7.1f} {poses:7.1f} "
            f"{1e3 * row['seconds'] / frames:10.2f} {row['peak']:9.0f}  ({row['start']:.0f}) "
            f"{row['sightings']:13d} {row['nees'] / 6.0:10.2f}",
            flush=True,
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["render"]:
        render(Path(sys.argv[2]), int(sys.argv[3]))
    elif sys.argv[1:2] == ["solve"]:
        solve(Path(sys.argv[2]), sys.argv[3] == "1")
    else:
        main(sys.argv[1:])
