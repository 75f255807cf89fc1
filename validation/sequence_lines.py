"""Flight lines that share points, solved line by line and as one band: poses apart, time, memory.

``python validation/sequence_lines.py [lines] [cross lines] [frames a line]``; 4 lines of 250 frames: two
minutes, half of them rendering. Flights of the case "long", neighbouring lines overlap by 40 %. All lines
are solved together once more from what was found. Memory is what arrays take at most beyond what was there.
The ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.
"""

from __future__ import annotations

import sys
import time
import tracemalloc

import gates
import numpy as np
from sequence_poses import problem_of

from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.photogrammetry.flight import poses as frame_poses
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.solver import SequenceSolver
from sightline.photogrammetry.flight.solving_order import SolvingOrder, one_band, solving_order
from sightline.photogrammetry.sightings import Images, Sightings
from sightline.simulate.sequence import sequence_case


def as_one_band(images: Images, sightings: Sightings) -> SolvingOrder:
    """Frames of all lines together."""
    return one_band(len(images), sightings)


def solved(solver: SequenceSolver, found: SequencePoses) -> tuple[FramePoses, float, float]:
    """Poses, CPU s, MB."""
    began = time.process_time()
    poses = solver.solve(found.tracks, found.poses)
    seconds = time.process_time() - began
    tracemalloc.start()  # slows what it watches
    solver.solve(found.tracks, found.poses)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return poses, seconds, peak / 1e6


def main(lines: int, cross: int, frames: int) -> None:
    """Print the table."""
    scenario = sequence_case(
        "long", 0, spectra="rededge", frames=frames, flight_lines=lines, cross_lines=cross
    )
    problem = problem_of(scenario)
    found = georeference_sequence(problem)
    solver = SequenceSolver(problem, found.followed)
    order = solving_order(problem.images, found.tracks)
    count = 0 if order.last is None else int(order.last.sum())
    print(f"{lines} lines and {cross} across, of {frames} frames; {count} frames are solved last")
    linked, seconds, memory = solved(solver, found)
    print(f"line by line: {seconds:.1f} CPU s, {memory:.0f} MB (predicted: {order.memory / 1e6:.0f} MB)")
    frame_poses.solving_order = as_one_band
    predicted = one_band(len(problem), found.tracks).memory / 1e6
    linked_memory = memory
    whole, seconds, memory = solved(solver, found)
    gates.check("memory line by line over that of one band", linked_memory / memory, 0.0, 0.5)
    print(f"one band:     {seconds:.1f} CPU s, {memory:.0f} MB (predicted: {predicted:.0f} MB)")
    sigma = np.sqrt(np.einsum("kii->ki", whole.covariance))
    turn = (whole.world_from_body.inv() * linked.world_from_body).as_rotvec()
    apart = np.concatenate([linked.position - whole.position, turn], axis=1) / sigma
    unit = sigma[:, :, None] * sigma[:, None, :]
    # the same equations, in another order: rounding alone
    gates.check("poses apart, sigma, largest", float(np.abs(apart).max()), 0.0, 1e-6)
    between = np.abs((linked.covariance - whole.covariance) / unit).max()
    gates.check("covariances apart, of sigmas squared, largest", float(between), 0.0, 1e-5)
    print(
        f"poses apart by {np.abs(apart).max():.1e} sigma at most, covariances by "
        f"{np.abs((linked.covariance - whole.covariance) / unit).max():.1e} of sigmas squared"
    )


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    gates.run(lambda: main(*(numbers + [4, 0, 250][len(numbers) :])), __file__)
