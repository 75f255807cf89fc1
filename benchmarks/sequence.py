"""Poses of all frames of a flight beside what else gives them: error, CPU seconds, memory, in one table.

    python benchmarks/sequence.py                     the reference flight, 640 frames: ten minutes of CPU
    python benchmarks/sequence.py --case small        seconds
    python benchmarks/sequence.py --only ours slerp --work DIR     some rows; DIR keeps frames and poses

Frames are rendered once, to a file that everyone reads frame by frame; rendering and compilation are not
counted. Each way runs in a process of its own: CPU seconds are user and system of it, its threads and its
children, less what a flight of a few frames takes (imports, compiled code); memory is the most it held. The
ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.

Ways. `ours`: rough tables of the simulation (positions 1 m, attitudes 0.5 deg, both with a bias).
`ours, fine attitudes`: 0.05 deg. `ours, no attitudes`: begins with a model of the subset by pycolmap (extra
`sfm`). `ours, weak positions`: no attitudes either, positions 5 m, heights of the ground not given: the
strip's bow is hardly known, and the result must say so. Interpolations (`slerp`, `spline`, `displacement`)
begin with *true* poses of one frame in 20. `resection`: a model of the subset by pycolmap, then SIFT of every
frame left, matched to the model's points in the two nearest frames of the subset, and OpenCV's solvePnPRansac
and refinement; measured on some frames, the rest extrapolated. `photogrammetry`: pycolmap on the first frames
only, pairs in sequence, a growing number of them; the whole is extrapolated by the power of the last two (too
low, if anything: mapping grows faster than that).

Errors are those left after a similarity has aligned positions with the truth; positions along, across and up,
in ground pixels; angles pitch, roll, yaw. The bow is the even trend of pitch over the strip, rms, and what
the result itself states of it (1-sigma). Ground between anchors: what is left of the ground error when its
straight line between anchors, one in 20, is taken away.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import json
import pickle
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))

from sightline.applications.sequence_poses import follow_sequence, georeference_sequence  # noqa: E402
from sightline.errors import SightlineError  # noqa: E402
from sightline.evaluation.score_poses import align, pose_errors  # noqa: E402
from sightline.geometry.rotations import NADIR_MOUNT  # noqa: E402
from sightline.geometry.surface import Plane  # noqa: E402
from sightline.io.sequence.poses import track_attitude  # noqa: E402
from sightline.photogrammetry.flight.interpolation import between_anchors, by_displacement  # noqa: E402
from sightline.photogrammetry.flight.poses import RoughPoses  # noqa: E402
from sightline.photogrammetry.flight.problem import SequenceProblem  # noqa: E402
from sightline.photogrammetry.flight.reconstruct import FrameModel, filter_pairs, reconstruct  # noqa: E402
from sightline.photogrammetry.flight.subset import choose_subset  # noqa: E402
from sightline.photogrammetry.sightings import Images  # noqa: E402
from sightline.simulate.sequence import SequenceScenario, sequence_case  # noqa: E402

Array = NDArray[np.float64]

STRIDE = 20
WAYS = (
    "ours", "ours, fine attitudes", "ours, no attitudes", "ours, weak positions", "slerp", "spline",
    "displacement", "resection", "photogrammetry",
)  # fmt: skip
#: What a way is given otherwise.
GIVEN: dict[str, dict[str, float]] = {
    "ours, fine attitudes": {"attitude_sigma": float(np.radians(0.05))},
    "ours, weak positions": {"position_sigma": 5.0, "position_bias_sigma": 10.0},
}
BLIND = ("ours, no attitudes", "ours, weak positions", "resection", "photogrammetry")
#: Frames whose resection is measured; frames of the growing photogrammetry, shares of the flight.
RESECTED, GROWING = 40, (0.05, 0.1)
#: What is asked for: ground between anchors (px), pitch, roll, yaw (deg), bow (deg), CPU s.
TARGETS = "1 px; 0.09 / 0.012 / 0.009 deg; bow 0.03 deg with attitudes of 0.05 deg; 60 CPU s; 100 % of frames"


@dataclass(frozen=True, eq=False)
class FrameFile:
    """One frame of a file of 16-bit frames, read when asked for."""

    path: Path
    number: int
    shape: tuple[int, int]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        size = self.shape[0] * self.shape[1]
        pixels = np.fromfile(self.path, "<u2", size, offset=2 * size * self.number).reshape(self.shape)
        return np.ascontiguousarray(pixels[slice(*lines), slice(*columns)], dtype=np.float32)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> None:
        return None


def flight(case: str, seed: int, way: str) -> SequenceScenario:
    """The flight as that way is given it; motion, ground and frames are the same for all."""
    return sequence_case(case, seed, spectra="rededge", **GIVEN.get(way, {}))


def rendered(case: str, seed: int, work: Path) -> Path:
    """The file of all frames."""
    path = work / f"{case}-{seed}.frames"
    scenario = flight(case, seed, WAYS[0])
    if not path.exists():
        with open(path.with_suffix(".part"), "wb") as file:
            for k in range(scenario.options.total_frames):
                file.write(scenario.image(k).mean(axis=0).astype("<u2").tobytes())
        path.with_suffix(".part").rename(path)
    return path


def stored(case: str, seed: int, way: str, work: Path) -> Path:
    """A file with the flight, of its ground the relief only: memory is then that of the way."""
    path = work / f"{case}-{seed}-{WAYS.index(way)}.flight"
    scenario = flight(case, seed, way)
    light = replace(scenario, ground=SimpleNamespace(relief=scenario.ground.relief))
    light.__dict__.update(poses=scenario.poses, _given_poses=scenario._given_poses)
    path.write_bytes(pickle.dumps(light))
    return path


def problem_of(
    scenario: SequenceScenario, path: Path, count: int, blind: bool, surface: bool = True
) -> SequenceProblem:
    """What a user would know of the first frames of a flight; `blind`: no attitudes."""
    o, t = scenario.options, scenario.poses[0][:count]
    given = scenario.given_positions[:count]
    position_sigma = np.full((count, 3), o.position_sigma)
    attitude = track_attitude(t, given, position_sigma, None) if blind else scenario.given_attitudes[:count]
    known = RoughPoses(
        position_sigma, np.full((count, 3), np.inf if blind else o.attitude_sigma), o.position_bias_sigma,
        0.0 if blind else o.attitude_bias_sigma,
    )  # fmt: skip
    images = Images(np.zeros(count), np.arange(count), t, given, attitude)
    return SequenceProblem(
        tuple(map(str, range(count))), t, tuple(FrameFile(path, k, o.shape) for k in range(count)),
        scenario.detector, NADIR_MOUNT, images, known, Plane(0.0),
        float(scenario.ground.relief.heights.std()) if surface else 0.0, o.readout_time, 0.8, ("",) * count,
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------- the ways

Poses = tuple[NDArray[np.intp], Array, Rotation, dict[str, Any]]


def ours(scenario: SequenceScenario, path: Path, count: int, way: str) -> Poses:
    """All frames adjusted."""
    found = georeference_sequence(problem_of(scenario, path, count, way in BLIND, "weak" not in way))
    stated = np.isfinite(found.poses.covariance).all(axis=(1, 2))
    more = {
        "stages": {name: round(took, 1) for name, took in found.seconds.items()},
        "covariances": int(stated.sum()),
        "bow sigma": float(np.degrees(found.poses.bow[0, 1])),
        "warnings": list(found.warnings),
    }
    return np.arange(count), found.poses.position, found.poses.world_from_body, more


def interpolated(scenario: SequenceScenario, path: Path, count: int, way: str) -> Poses:
    """Between true poses of some frames."""
    t, position, attitude = scenario.poses
    t, anchors = t[:count], np.unique(np.append(np.arange(0, count, STRIDE), count - 1))
    known = (t, anchors, position[anchors], attitude[anchors])
    if way != "displacement":
        return np.arange(count), *between_anchors(*known, way), {}
    followed = follow_sequence(problem_of(scenario, path, count, False))
    camera = (scenario.detector, NADIR_MOUNT, scenario.options.altitude)
    return np.arange(count), *by_displacement(*known, followed, *camera), {}


def model_of_subset(problem: SequenceProblem, scenario: SequenceScenario) -> FrameModel:
    """What resection is made against."""
    followed = follow_sequence(problem)
    far = np.full(len(problem), scenario.options.altitude)
    chosen = choose_subset(followed, problem.images.position, far, problem.detector.shape).frames
    return reconstruct(
        problem.sources, chosen, filter_pairs(chosen, followed, problem.detector), problem.detector,
        problem.mount, problem.images.position, problem.known.position, enlarged=True,
    )  # fmt: skip


def resection(scenario: SequenceScenario, path: Path, count: int, way: str) -> Poses:
    """Each frame on its own, by SIFT and PnP against a model of the subset."""
    import cv2

    cv2.setNumThreads(1)
    problem = problem_of(scenario, path, count, True)
    model = model_of_subset(problem, scenario)
    modelled = cpu_seconds()
    sift = cv2.SIFT_create(nfeatures=2000)
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def features(k: int) -> tuple[Array, NDArray[np.float32]]:
        pixels = problem.sources[k].read((0, problem.detector.shape[0]), (0, problem.detector.shape[1]))
        low, high = np.quantile(pixels, [0.005, 0.995])
        grey = np.clip(255.0 * (pixels - low) / (high - low), 0, 255).astype(np.uint8)
        points, descriptors = sift.detectAndCompute(grey, None)
        return np.array([p.pt[::-1] for p in points]), descriptors

    named = {}
    for row, k in enumerate(model.frames):
        # both look for the same kind of feature: those of the model are found again in the same place
        rows = np.flatnonzero(model.tracks.image == row)
        places, descriptors = features(int(k))
        if not len(rows):
            continue
        apart = np.linalg.norm(places[:, None] - model.tracks.pixels[rows][None], axis=2)
        near = apart.argmin(axis=1)
        good = apart[np.arange(len(places)), near] < 1.0
        named[row] = descriptors[good], model.points[model.tracks.point[rows[near[good]]]]
    began = cpu_seconds()
    left = np.setdiff1d(np.arange(count), model.frames)
    tried = left[np.unique(np.linspace(0, len(left) - 1, min(RESECTED, len(left))).astype(int))]
    middle = np.asarray(scenario.detector.principal_point_px)[::-1]
    camera = np.array([[scenario.detector.focal_length_px, 0.0, middle[0]],
                       [0.0, scenario.detector.focal_length_px, middle[1]], [0.0, 0.0, 1.0]])  # fmt: skip
    frames, place, turn = list(model.frames), list(model.position), list(model.world_from_body)
    for k in tried:
        places, descriptors = features(int(k))
        pixels, ground = [], []
        for row in np.argsort(np.abs(model.frames - k))[:2]:
            theirs, points = named.get(int(row), ((), ()))
            if len(theirs) < 2:
                continue
            for best, second in matcher.knnMatch(descriptors, theirs, k=2):
                if best.distance < 0.8 * second.distance:
                    pixels.append(places[best.queryIdx][::-1])
                    ground.append(points[best.trainIdx])
        pose = posed(cv2, np.array(ground), np.array(pixels), camera)
        if pose is not None:
            frames.append(int(k))
            place.append(pose[0])
            turn.append(pose[1] * camera_axes(scenario).inv() * NADIR_MOUNT.inv())
    each = (cpu_seconds() - began) / len(tried)
    order = np.argsort(frames)
    share = (len(frames) - len(model.frames)) / len(tried)
    more = {
        "extrapolated": modelled + each * len(left) + (began - modelled),
        "per frame": each,
        "posed": len(model.frames) + share * len(left),
    }
    return np.array(frames)[order], np.array(place)[order], Rotation.concatenate(turn)[order], more


def posed(cv2: Any, ground: Array, pixels: Array, camera: Array) -> tuple[Array, Rotation] | None:
    """Place and world_from_camera (its axes: columns, lines, depth) of a frame."""
    if len(ground) < 12:
        return None
    centre = ground.mean(axis=0)
    good, turn, move, inliers = cv2.solvePnPRansac(
        ground - centre, pixels, camera, None, iterationsCount=500, reprojectionError=3.0, confidence=0.999
    )
    if not good or inliers is None or len(inliers) < 12:
        return None
    rows = inliers.ravel()
    turn, move = cv2.solvePnPRefineLM(ground[rows] - centre, pixels[rows], camera, None, turn, move)
    world_from_camera = Rotation.from_rotvec(turn.ravel()).inv()
    return centre - world_from_camera.apply(move.ravel()), world_from_camera


def camera_axes(scenario: SequenceScenario) -> Rotation:
    """Of columns, lines and depth in the axes of the detector."""
    middle = np.array([scenario.detector.principal_point_px])
    steps = scenario.detector.directions(middle + np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
    axes = np.column_stack([steps[1] - steps[0], steps[2] - steps[0], steps[0]])
    return Rotation.from_matrix(axes / np.linalg.norm(axes, axis=0))


def photogrammetry(scenario: SequenceScenario, path: Path, count: int, way: str) -> Poses:
    """pycolmap on every frame of the first part of the flight."""
    problem = problem_of(scenario, path, count, True)
    steps = [*range(1, 11), 16, 32, 64]
    pairs = [(i, i + step) for i in range(count) for step in steps if i + step < count]
    model = reconstruct(
        problem.sources, np.arange(count), pairs, problem.detector, problem.mount, problem.images.position,
        problem.known.position, enlarged=True,
    )  # fmt: skip
    return model.frames, model.position, model.world_from_body, {}


def run(way: str, scenario: SequenceScenario, path: Path, count: int) -> Poses:
    """One way of the table."""
    if way.startswith("ours"):
        return ours(scenario, path, count, way)
    others = {"resection": resection, "photogrammetry": photogrammetry}
    return others.get(way, interpolated)(scenario, path, count, way)


# ---------------------------------------------------------------------------------------------- measured


def cpu_seconds() -> float:
    """User and system, of this process, its threads and its children."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, who))


def peak_mb() -> float:
    """Most memory of this process, MB (`ru_maxrss` would begin with that of the process that made it)."""
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return float(next(line.split()[1] for line in text.splitlines() if line.startswith("VmHWM"))) / 1024.0


def between_px(scenario: SequenceScenario, frames: NDArray[np.intp], place: Array, turn: Rotation) -> float:
    """px rms of the ground error that is left between anchors."""
    lines, columns = scenario.options.shape
    grid = np.meshgrid(np.linspace(20, lines - 21, 5), np.linspace(20, columns - 21, 5), indexing="ij")
    rays = NADIR_MOUNT.apply(scenario.detector.directions(np.stack(grid, axis=-1).reshape(-1, 2)))
    _, true_place, true_turn = scenario.poses

    def met(where: Array, attitude: Rotation) -> Array:
        ray = attitude.apply(rays)
        return np.asarray((where - ray * (where[2] / ray[:, 2])[:, None])[:, :2])

    error = {int(k): met(place[n], turn[n]) - met(true_place[k], true_turn[k]) for n, k in enumerate(frames)}
    left = []
    # a frame without a pose is no anchor: the next on is
    anchors = [min(error, key=lambda k, a=a: abs(k - a)) for a in range(0, max(error) + 1, STRIDE)]
    for a, b in pairwise(anchors):
        for k in range(a + 1, b):
            if k in error:
                w = (k - a) / (b - a)
                left.append(error[k] - (1.0 - w) * error[a] - w * error[b])
    return float(np.sqrt((np.array(left) ** 2).sum(axis=-1).mean()) / scenario.options.gsd)


def scored(scenario: SequenceScenario, poses: Poses) -> dict[str, Any]:
    """Errors of a way."""
    frames, place, turn, more = poses
    _, true_place, true_turn = scenario.poses
    truth = (true_place[frames], true_turn[frames])
    fit = align(place, turn, *truth, scaled=True)
    aligned = fit.apply(place, turn)
    error = pose_errors(*aligned, *truth)
    # the flight is north: along, across, up
    rms = np.sqrt((error**2).mean(axis=0))
    far = (frames - frames.mean()) / frames.std()
    return {
        "between": between_px(scenario, frames, *aligned),
        "position": (rms[[1, 0, 2]] / scenario.options.gsd).tolist(),
        "angles": np.degrees(rms[[4, 3, 5]]).tolist(),
        "bow": float(np.degrees((error[:, 4] * far).mean())),
        "posed": more.get("posed", len(frames)),
        **more,
    }


def child(way: str, file: Path, frames: Path, count: int) -> dict[str, Any]:
    """One way in a process of its own."""
    command = [sys.executable, __file__, "--child", way, "--flight", str(file), "--frames", str(frames)]
    found = subprocess.run([*command, "--count", str(count)], capture_output=True, text=True, check=False)
    if found.returncode:
        return {"failed": found.stderr.strip().splitlines()[-1:]}
    return dict(json.loads(found.stdout.splitlines()[-1]))


def main_child(way: str, file: Path, frames: Path, count: int) -> None:
    """Print what was measured, as JSON."""
    scenario = pickle.loads(file.read_bytes())
    path = frames
    # compiled code is loaded before the clock starts
    georeference_sequence(problem_of(scenario, path, 12, False))
    began = cpu_seconds()
    try:
        poses = run(way, scenario, path, count)
    except SightlineError as error:
        print(json.dumps({"failed": str(error), "cpu": cpu_seconds() - began, "peak": peak_mb()}))
        return
    seconds, peak = cpu_seconds() - began, peak_mb()
    entry = scored(scenario, poses)
    entry["cpu"] = entry.pop("extrapolated", began) - began if "extrapolated" in entry else seconds
    print(json.dumps({**entry, "peak": peak, "frames": count}))


# ------------------------------------------------------------------------------------------------- table


def row(name: str, entry: dict[str, Any], total: int, cpu: str | None = None) -> str:
    """One line of the table."""
    if "failed" in entry:
        return f"| {name} | failed: {entry['failed']} |||||||||"
    place = " ".join(f"{v:.2f}" for v in entry["position"])
    angles = " ".join(f"{v:.4f}" for v in entry["angles"])
    bow = f"{entry['bow']:+.4f}" + (f" ({entry['bow sigma']:.4f})" if "bow sigma" in entry else "")
    cpu = cpu or f"{entry['cpu']:.1f}"
    posed, stated = entry["posed"] / total, entry.get("covariances", 0) / total
    return (
        f"| {name} | {entry['between']:.3f} | {place} | {angles} | {bow} | {cpu} | {entry['peak']:.0f} "
        f"| {posed:.1%} | {stated:.0%} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", default="lvf")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=WAYS, default=list(WAYS))
    parser.add_argument("--work", type=Path)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--flight", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--frames", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--count", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        main_child(args.child, args.flight, args.frames, args.count)
        return
    with tempfile.TemporaryDirectory() as folder:
        work = args.work or Path(folder)
        work.mkdir(parents=True, exist_ok=True)
        path = rendered(args.case, args.seed, work)
        total = flight(args.case, args.seed, WAYS[0]).options.total_frames
        print(f"{args.case}, seed {args.seed}: {total} frames. Targets: {TARGETS}\n")
        print(
            "| way | between anchors (px) | along, across, up (px) | pitch roll yaw (deg) | "
            "bow (its sigma) (deg) | CPU s | peak MB | posed | with covariance |"
        )
        print("|---|---|---|---|---|---|---|---|---|")
        notes = []
        for way in args.only:
            file = stored(args.case, args.seed, way, work)
            if way == "photogrammetry":
                grown(file, path, total)
                continue
            entry = child(way, file, path, total)
            cpu = f"{entry['cpu']:.0f} extrapolated" if "per frame" in entry else None
            print(row(way, entry, total, cpu), flush=True)
            notes += [f"{way}: {k} {v}" for k in ("stages", "warnings", "per frame") if (v := entry.get(k))]
        print("", *notes, sep="\n")


def grown(file: Path, path: Path, total: int) -> None:
    """Photogrammetry of more and more frames, and what all would take."""
    counts = [max(int(share * total), 12 * (n + 1)) for n, share in enumerate(GROWING)]
    took = []
    for count in counts:
        entry = child("photogrammetry", file, path, count)
        print(row(f"photogrammetry, first {count}", entry, count), flush=True)
        if "failed" in entry:
            return
        took.append(entry["cpu"])
    power = max(np.log(took[1] / took[0]) / np.log(counts[1] / counts[0]), 1.0)
    whole = took[1] * (total / counts[1]) ** power
    print(f"| photogrammetry, all {total} | | | | | {whole:.0f} extrapolated (power {power:.2f}) | | | |")


if __name__ == "__main__":
    main()
