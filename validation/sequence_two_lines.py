"""Two flight lines beside each other, with a rolling shutter: are they tied, straight, and their sigmas true.

Rendered flights of the case "two-lines" (a filter of varying wavelength, 20 ms of readout, 40 % side overlap)
from rough tables. Ground errors are where rays meet the mean ground, less where they do by the true poses,
px. Lines see the ground between them from both sides, so that a height of the whole that is off (the datum)
would look like lines apart: what points of both lines lie too high is taken off first. The bow of a line is
the trend of its angles' errors from end to end. ``sequence_two_lines.py 3 200``: three flights of 200 frames
a line.

Then flights of small frames whose tables have constant errors that are stated nowhere (2 m, 0.3 degrees per
axis, beside sigmas of 1 m and 0.5 degrees a frame that are): lines have to lie on each other all the same.
``sequence_two_lines.py 0 0 20``: twenty of these alone. The ground has real spectra: SIGHTLINE_DATA names the
folder of the data sets.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import gates
import numpy as np
from sequence_poses import SIDE, between_px, ground_px, problem_of

from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.matching.follow import FollowPlan
from sightline.photogrammetry.flight.table_check import misfits
from sightline.simulate.sequence import SequenceScenario, sequence_case

#: Constant errors of the tables that are not stated: m, degrees.
UNSTATED = (2.0, 0.3)
#: Flights with these: small frames, so that twenty take minutes.
SMALL = {"shape": (160, 200), "focal_length_px": 250.0, "frames": 50, "overlap": 0.96}


def too_high(scenario: SequenceScenario, points: np.ndarray) -> float:
    """m that points lie above the true relief on the whole."""
    relief = scenario.ground.relief
    known = points[np.isfinite(points[:, 0])]
    columns = np.rint((known[:, 0] - relief.west) / relief.posting[0]).astype(int)
    rows = np.rint((relief.north - known[:, 1]) / relief.posting[1]).astype(int)
    last = np.array(relief.heights.shape) - 1
    return float(
        (known[:, 2] - relief.heights[np.clip(rows, 0, last[0]), np.clip(columns, 0, last[1])]).mean()
    )


def bows(scenario: SequenceScenario, found: SequencePoses) -> np.ndarray:
    """Bow (2, 3) of both lines over its own sigma."""
    _, _, attitude = scenario.poses
    error = (attitude.inv() * found.poses.world_from_body).as_rotvec()
    frames = scenario.options.frames
    place = np.arange(frames) - 0.5 * (frames - 1)
    trend = [place @ error[k * frames : (k + 1) * frames] / np.sqrt(frames * (place @ place)) for k in (0, 1)]
    return np.abs(trend) / found.poses.bow


def lines_apart(scenario: SequenceScenario, found: SequencePoses) -> float:
    """px by which ground seen from both lines is laid apart, what it lies too high taken off."""
    poses, frames, tracks = found.poses, scenario.options.frames, found.tracks
    second = tracks.image >= frames
    both = np.intersect1d(tracks.point[second], tracks.point[~second])
    down = np.array([0.0, 0.0, too_high(scenario, poses.points[both] if len(both) else poses.points)])
    # both lines see the ground between them on their right, in low columns
    shared = ground_px(scenario, poses.position - down, poses.world_from_body)[:, :, : SIDE // 2]
    return float(np.hypot(*(shared[:frames].mean(axis=(0, 1, 2)) - shared[frames:].mean(axis=(0, 1, 2)))))


def unstated(flights: int) -> None:
    """Flights whose tables are off by constants that are stated nowhere."""
    print(f"\n{flights} flights, constant errors of {UNSTATED[0]:g} m and {UNSTATED[1]:g} degrees unstated")
    print("  seed  lines apart px  warnings of the tables")
    all_apart = []
    for seed in range(400, 400 + flights):
        scenario = sequence_case(
            "two-lines", seed, spectra="rededge", **SMALL,
            position_bias_sigma=UNSTATED[0], attitude_bias_sigma=float(np.radians(UNSTATED[1])),
        )  # fmt: skip
        problem = problem_of(scenario)
        known = replace(problem.known, position_bias=0.0, attitude_bias=0.0)
        found = georeference_sequence(replace(problem, known=known))
        all_apart.append(lines_apart(scenario, found))
        said = len(misfits(found.problem, found.poses))
        print(f"  {seed:4d}  {all_apart[-1]:14.3f}  {said}", flush=True)
    gates.check("constant errors unstated: lines apart, px, largest", max(all_apart), 0.0, 0.5)


def main(flights: int, frames: int, without: int) -> None:
    """Print the tables."""
    if flights:
        stated(flights, frames)
    if without:
        unstated(without)


def stated(flights: int, frames: int) -> None:
    """Flights whose tables' constant errors are stated."""
    every = []
    print(f"two lines of {frames} frames, rolling shutter of 20 ms")
    print("  seed  between anchors px  lines apart px  bow over sigma: roll pitch yaw  squared error  CPU s")
    for seed in range(300, 300 + flights):
        overlap = 1.0 - 2.0 / frames  # as much ground, however many frames
        scenario = sequence_case("two-lines", seed, spectra="rededge", frames=frames, overlap=overlap)
        began = time.process_time()
        found = georeference_sequence(problem_of(scenario), plan=FollowPlan(points=200))
        seconds = time.process_time() - began
        poses = found.poses
        raw = ground_px(scenario, poses.position, poses.world_from_body)
        between = np.sqrt(0.5 * (between_px(raw[:frames]) ** 2 + between_px(raw[frames:]) ** 2))
        apart = lines_apart(scenario, found)
        bow = bows(scenario, found).max(axis=0)
        _, position, attitude = scenario.poses
        turn = (attitude.inv() * poses.world_from_body).as_rotvec()
        error = np.concatenate([poses.position - position, turn], axis=1)
        squared = np.einsum("ki,ki->k", error, np.linalg.solve(poses.covariance, error[..., None])[..., 0])
        gates.check(f"seed {seed}: px between anchors", float(between), 0.0, 1.0)
        gates.check(f"seed {seed}: lines apart, px", apart, 0.0, 0.5)
        gates.check(f"seed {seed}: largest bow over its sigma", float(bow.max()), 0.0, 2.0)
        every.append(float(squared.mean()))
        print(
            f"  {seed:4d}  {between:18.3f}  {apart:14.3f}"
            f"  {bow[0]:20.2f} {bow[1]:5.2f} {bow[2]:3.2f}  {squared.mean():13.1f}  {seconds:5.0f}",
            flush=True,
        )
    # the datum of a flight is one draw of six numbers
    low, high = gates.nees_bounds(6 * flights)
    gates.check("squared error over covariance, mean", float(np.mean(every)), 6.0 * low, 6.0 * high)


if __name__ == "__main__":
    given = [int(number) for number in sys.argv[1:]]
    gates.run(lambda: main(*(given + [5, 100, 20][len(given) :])), __file__)
