"""Cubes of simulated flights: how much of the ground every band shows, and how well bands lie on each other.

Poses are found from rough tables, the ground from the points that were followed. Bands are matched with each
other, and their true error follows from true poses and true relief. Run with seeds:
``python validation/sequence_cube.py 3 4`` (about 80 CPU seconds each); then memory and time against the
number of frames. The ground has real spectra: SIGHTLINE_DATA names the folder of the data sets.
"""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import gates
import numpy as np
from sequence_poses import problem_of

from sightline.applications.frame_cube import CubeSummary, assemble_cube, found_views, images_of
from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Dem
from sightline.io.formats.images import open_image
from sightline.io.results.cube_files import CubeFolder
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_ground import choose_ground, frame_outlines
from sightline.products.cube_plan import CubePlan, choose_bands, map_of
from sightline.products.frame_cube import CubeMaker, FrameViews, tiles_of
from sightline.simulate.sequence import SequenceScenario, sequence_case

PLACES = 4000


def true_offsets(
    scenario: SequenceScenario, problem: SequenceProblem, found: SequencePoses, summary: CubeSummary
) -> np.ndarray:
    """px (groups, places, 2): where what a band shows at places of the map truly lies, less the place."""
    views, system = found_views(problem, found), map_of(problem)
    ground = choose_ground(problem, found.poses, found.tracks, system, "auto")
    outline, reach = frame_outlines(problem, system, ground, views)
    layout = choose_bands(problem, CubePlan(), outline, summary.gsd)
    maker = CubeMaker(summary.grid, layout, views, reach, ground.heights, images_of(problem))
    rng = np.random.default_rng(1)
    rows, columns = (rng.integers(0, n, PLACES) for n in summary.grid.shape)
    out = np.full((layout.groups, PLACES, 2), np.nan)
    for tile in tiles_of(summary.grid, layout):
        here = (rows >= tile.row) & (rows < tile.row + tile.rows)
        here &= (columns >= tile.column) & (columns < tile.column + tile.columns)
        frames = maker.frames_of(tile)
        if not frames or not here.any():
            continue
        world = maker.world(tile)
        view = maker.choose(tile, world, frames).view[:, rows[here] - tile.row, columns[here] - tile.column]
        points = world[rows[here] - tile.row, columns[here] - tile.column]
        moved = np.full((*view.shape, 2), np.nan)
        for frame in np.unique(view[view >= 0]):
            moved[view == frame] = _moved(scenario, views, int(frame), points[np.nonzero(view == frame)[1]])
        out[:, here] = moved / summary.gsd
    return out[:, np.isfinite(out).all(axis=(0, 2))]


def _moved(scenario: SequenceScenario, views: FrameViews, frame: int, points: np.ndarray) -> np.ndarray:
    """m (n, 2): from points to the true ground that the pixel which shows them saw."""
    relief, (_, position, attitude) = scenario.ground.relief, scenario.poses
    seen = views.detector.pixels((points - views.position[frame, 0]) @ views.camera_from_world[frame, 0].T)
    rays = (attitude[frame] * NADIR_MOUNT).apply(views.detector.directions(seen))
    origin = np.broadcast_to(position[frame], rays.shape)
    return Dem(relief.heights, relief.transform).intersect(origin, rays)[:, :2] - points[:, :2]


def height_error(
    scenario: SequenceScenario, problem: SequenceProblem, found: SequencePoses
) -> tuple[float, float]:
    """px rms of heights of points and of the surface through them, less a similarity (the datum is free)."""
    relief, gsd, tracks = scenario.ground.relief, scenario.options.gsd, found.tracks
    dem = Dem(relief.heights, relief.transform)
    ground = choose_ground(problem, found.poses, found.tracks, map_of(problem), "model")
    assert ground.model is not None
    # what the first sighting of a point shows is the point
    point, first = np.unique(tracks.point, return_index=True)
    frame = tracks.image[first]
    rays = NADIR_MOUNT.apply(scenario.detector.directions(tracks.pixels[first]))
    true = dem.intersect(np.array(scenario.poses[1][frame]), scenario.poses[2][frame].apply(rays))
    used = ground.model.used[point] & np.isfinite(true).all(axis=1)
    true, points = true[used], found.poses.points[point[used]]
    middle, centre = true.mean(axis=0), points.mean(axis=0)
    u, sizes, v = np.linalg.svd((points - centre).T @ (true - middle))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    growth = float(sizes.sum() / ((true - middle) ** 2).sum())

    def moved(places: np.ndarray) -> np.ndarray:
        return centre + growth * (places - middle) @ turn.T

    low, high = true.min(axis=0), true.max(axis=0)
    flat = np.column_stack([np.random.default_rng(2).uniform(low, high, (3000, 3))[:, :2], np.zeros(3000)])
    flat[:, 2] = dem.height_at(flat)
    between = moved(flat)
    off = ground.heights(between[:, 0], between[:, 1]) - between[:, 2]
    at_points = (points - moved(true))[:, 2]
    return tuple(float(np.sqrt(np.nanmean(d**2)) / gsd) for d in (at_points, off))  # type: ignore[return-value]


def one_seed(case: str, seed: int) -> None:
    """Print the table of one flight: bands lie within 0.3 px rms, 99 % is covered."""
    scenario = sequence_case(case, seed, spectra="rededge")
    problem = problem_of(scenario)
    found = georeference_sequence(problem)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        store = CubeFolder(Path(folder))
        summary = assemble_cube(problem, found, CubePlan(), store)
        store.finish()
    seconds = time.process_time() - began
    rows, columns = summary.grid.shape
    print(f"{case}, seed {seed}: {len(problem)} frames, {len(summary.names)} bands of {rows} x {columns} px")
    print(f"  ground: {summary.surface}")
    points, surface = height_error(scenario, problem, found)
    print(f"  heights: points {points:.2f} px rms, surface between them {surface:.2f} px rms")
    print(
        f"  coverage: {100 * summary.coverage.min():.2f} % of what every band could see in one frame or more"
    )
    print(
        f"  {100 * summary.passed.mean():.2f} % (worst band {100 * summary.passed.min():.2f} %) of all that "
        "the lines of every band passed over, gaps of long steps too"
    )
    seams, jump = 100 * summary.seams.mean(), 100 * summary.seam_jump.mean()
    print(f"  seams: {seams:.1f} % of neighbours, jump {jump:.1f} % of the mean")
    offset = true_offsets(scenario, problem, found, summary)
    print(f"  {'bands':>9s} {'matched':>9s} {'its noise':>9s} {'truth x':>9s} {'truth y':>9s}  px rms")
    for (a, b), rms, noise in zip(summary.pairs, summary.pair_rms_px, summary.pair_noise_px, strict=True):
        true = np.sqrt(((offset[a] - offset[b]) ** 2).mean(axis=0))
        print(f"  {a:4d} {b:4d} {rms:9.3f} {noise:9.3f} {true[0]:9.3f} {true[1]:9.3f}")
    every = offset - offset.mean(axis=0)
    print(
        f"  all bands about their mean, true: {np.sqrt((every**2).sum(axis=2).mean()):.3f} px rms (both axes)"
    )
    took = ", ".join(f"{stage} {s:.1f}" for stage, s in summary.seconds.items())
    each = 1000 * summary.seconds["tiles"] / len(problem)
    print(f"  {seconds:.1f} CPU s with files ({took}); {each:.0f} ms a frame", flush=True)
    worst = max(float(np.sqrt(((offset[a] - offset[b]) ** 2).sum(axis=1).mean())) for a, b in summary.pairs)
    gates.check(f"seed {seed}: worst pair of bands, true, px rms", worst, 0.0, 0.3)
    gates.check(
        f"seed {seed}: worst pair of bands, matched, px rms", float(np.max(summary.pair_rms_px)), 0.0, 0.3
    )
    gates.check(
        f"seed {seed}: ground that every band could see, %", 100 * float(summary.coverage.min()), 99.0
    )


def measure(path: str) -> None:
    """In a process of its own: the cube of a pickled problem, its time and memory."""
    with open(path, "rb") as file:
        problem, found = pickle.load(file)
    with tempfile.TemporaryDirectory() as folder:
        store = CubeFolder(Path(folder))
        summary = assemble_cube(problem, found, CubePlan(bands=20, picture=False, fit=False), store)
    # of this process alone: what getrusage tells counts the parent that it was forked from
    peak = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text(encoding="utf-8"))
    memory = int(peak[1]) / 1024 if peak else np.nan
    print(
        f"  {len(problem):5d} frames: {summary.seconds['tiles']:6.1f} CPU s, peak {memory:.0f} MiB",
        flush=True,
    )


def growth() -> None:
    """Print time and memory against the number of frames."""
    print("small frames on disk, 20 bands:", flush=True)
    for frames in (60, 240):
        scenario = sequence_case("small", 4, spectra="rededge", frames=frames)
        problem = problem_of(scenario)
        found = georeference_sequence(problem)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for k in range(frames):
                np.save(folder / f"{k}.npy", scenario.image(k)[0])
            files = tuple(open_image(folder / f"{k}.npy") for k in range(frames))
            (folder / "problem.pickle").write_bytes(pickle.dumps((replace(problem, sources=files), found)))
            subprocess.run(
                [sys.executable, __file__, "--measure", str(folder / "problem.pickle")], check=True
            )


def main() -> None:
    """All seeds, then time and memory."""
    for number in sys.argv[1:] or ["3", "4"]:
        one_seed("cube-60", int(number))
    growth()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(sys.argv[2])
    else:
        gates.run(main, __file__)
