"""Poses of all frames of a simulated flight: the adjustment beside slerp, spline and S4's plain displacement.

Rivals start from true anchors one frame in 20; the adjustment from rough tables. Run with a case and a seed:
``python validation/sequence_poses.py lvf 0``; "small" takes seconds, "lvf" a minute and a half.
The ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.
"""

from __future__ import annotations

import sys
import time

import gates
import numpy as np
from scipy.spatial.transform import Rotation

from sightline.applications.sequence_poses import georeference_sequence
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import FollowPlan
from sightline.photogrammetry.flight.interpolation import between_anchors, by_displacement
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import SequenceScenario, sequence_case

#: Frames from anchor to anchor; places along each side of a frame that ground errors are taken at.
STRIDE, SIDE = 20, 5


def problem_of(scenario: SequenceScenario) -> SequenceProblem:
    """What a user would know of a flight."""
    options, (t, _, _) = scenario.options, scenario.poses
    count = len(t)
    known = RoughPoses(
        np.full((count, 3), options.position_sigma), np.full((count, 3), options.attitude_sigma),
        options.position_bias_sigma, options.attitude_bias_sigma,
    )  # fmt: skip
    images = Images(np.zeros(count), np.arange(count), t, scenario.given_positions, scenario.given_attitudes)
    sources = tuple(ArrayImage(scenario.image(k)[0]) for k in range(count))
    heights = scenario.ground.relief.heights
    return SequenceProblem(
        tuple(map(str, range(count))), t, sources, scenario.detector, NADIR_MOUNT, images, known,
        Plane(float(heights.mean())), float(heights.std()), options.readout_time, 0.8, ("",) * count,
    )  # fmt: skip


def ground_px(scenario: SequenceScenario, position: np.ndarray, attitude: Rotation) -> np.ndarray:
    """Ground errors (M, lines, columns, 2) of places of every frame, px."""
    lines, columns = scenario.options.shape
    grid = np.meshgrid(np.linspace(20, lines - 21, SIDE), np.linspace(20, columns - 21, SIDE), indexing="ij")
    rays = NADIR_MOUNT.apply(scenario.detector.directions(np.stack(grid, axis=-1).reshape(-1, 2)))
    _, true_position, true_attitude = scenario.poses

    def met(place: np.ndarray, turn: Rotation) -> np.ndarray:
        ray = turn.apply(rays)
        return (place - ray * (place[2] / ray[:, 2])[:, None])[:, :2]

    pairs = zip(position, attitude, true_position, true_attitude, strict=True)
    error = np.array([met(*pose[:2]) - met(*pose[2:]) for pose in pairs])
    return error.reshape(len(error), SIDE, SIDE, 2) / scenario.options.gsd


def between_px(error: np.ndarray) -> float:
    """px rms of the ground error of one line that is left between every `STRIDE`-th frame."""
    left = []
    for a in range(0, len(error) - STRIDE, STRIDE):
        w = np.arange(STRIDE)[:, None, None, None] / STRIDE
        left.append(error[a : a + STRIDE] - (1.0 - w) * error[a] - w * error[a + STRIDE])
    return float(np.sqrt((np.concatenate(left) ** 2).sum(axis=-1).mean()))


def main(case: str, seed: int) -> None:
    """Print the table."""
    scenario = sequence_case(case, seed, spectra="rededge")
    problem = problem_of(scenario)
    began = time.process_time()
    found = georeference_sequence(problem, plan=FollowPlan(points=200))
    seconds = time.process_time() - began
    t, position, attitude = scenario.poses
    anchors = np.arange(0, len(t), STRIDE)
    known = (t, anchors, position[anchors], attitude[anchors])
    rows = [("all frames adjusted", found.poses.position, found.poses.world_from_body)]
    rows += [(way, *between_anchors(*known, way)) for way in ("slerp", "spline")]
    camera = (scenario.detector, NADIR_MOUNT, scenario.options.altitude)
    rows.append(("displacement and yaw", *by_displacement(*known, found.followed, *camera)))
    print(f"{case}, seed {seed}: {len(t)} frames, {seconds:.1f} CPU s")
    for stage, took in found.seconds.items():
        print(f"  {stage:28s} {took:6.1f} s")
    left = {}
    for name, place, turn in rows:
        left[name] = between_px(ground_px(scenario, place, turn))
        print(f"  {name:28s} {left[name]:7.3f} px between anchors")
    ours = left.pop("all frames adjusted")
    gates.check("all frames adjusted: px between anchors", ours, 0.0, 1.0)
    gates.check("that over the best of the others", ours / min(left.values()), 0.0, 0.5)
    error = np.degrees((attitude.inv() * found.poses.world_from_body).as_rotvec())
    print("  angles about their mean, deg rms", error.std(axis=0).round(4))
    print("  1-sigma of the bow, deg", np.degrees(found.poses.bow).round(4).tolist())


if __name__ == "__main__":
    given = (*sys.argv[1:], *("small", "0")[len(sys.argv) - 1 :])
    gates.run(lambda: main(given[0], int(given[1])), __file__)
