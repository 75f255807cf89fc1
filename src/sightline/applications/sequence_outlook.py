"""What the rough poses of a sequence let expect before anything is solved: gaps, overlap, size of the maps.

Not here: in words (``io/describe_outlook.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sightline.applications.cube_ground import Ground, frame_outlines, given_heights
from sightline.applications.frame_cube import CubePlan, choose_bands, frame_views, map_of, pixel_size
from sightline.applications.frame_sequence import SequenceProblem
from sightline.geometry.checks import Array, read_only
from sightline.photogrammetry.frame_poses import stretches
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.products.frame_cube import grid_of

#: Times the usual step from which on frames are missing between two of a stretch.
_MISSING = 1.6
#: Sigmas of the positions by which the places that tell a speed are apart.
_SPEED_SIGMAS = 10.0
#: Share of the ground that a frame may cover at least, in each direction, to count as shared.
_SHARED = 0.8


@dataclass(frozen=True, eq=False)
class Times:
    """How frames follow one another.

    Attributes
    ----------
    stretch : (M,) int
        Number of the stretch of each frame; pauses are between stretches.
    step : float
        s, usual, from frame to frame within stretches; NaN where no stretch has two frames.
    gaps : (G,) int
        Frames after which others are missing within their stretch.
    missing : (G,) int
        How many, by the usual step.
    """

    stretch: NDArray[np.intp]
    step: float
    gaps: NDArray[np.intp]
    missing: NDArray[np.intp]


def times_of(t: Array) -> Times:
    """Stretches of a flight and gaps in them.

    Parameters
    ----------
    t : (M,)
        s, increasing.
    """
    stretch = stretches(t)
    step = np.diff(t)
    within = np.diff(stretch) == 0
    usual = float(np.median(step[within])) if within.any() else np.nan
    gaps = np.flatnonzero(within & (step > _MISSING * usual))
    return Times(stretch, usual, gaps, np.rint(step[gaps] / usual).astype(np.intp) - 1)


@dataclass(frozen=True, eq=False)
class Overlap:
    """What successive frames share, by the rough poses.

    Attributes
    ----------
    step : float
        m flown from frame to frame, usual.
    covered : float
        m of ground that a frame covers along the flight.
    usual, least : float
        Share of a frame that the next one shows; 0 where it shows nothing.
    worst : int
        Frame before the longest step.
    """

    step: float
    covered: float
    usual: float
    least: float
    worst: int


def overlap_of(problem: SequenceProblem) -> Overlap | None:
    """Expected overlap of successive frames; None where positions or times do not tell.

    Steps are speed times time: positions of single frames may be noisier than their distance.
    """
    times = times_of(problem.t)
    if not (np.isfinite(problem.known.position).any() and np.isfinite(times.step)):
        return None
    velocity = _velocity(problem, times.stretch)
    lines, columns = problem.detector.shape
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    ends = problem.detector.directions(read_only(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
    camera = problem.images.world_from_body * problem.mount
    ground = problem.surface.intersect(problem.images.position, read_only(camera.apply(ends[0])))
    distance = float(np.nanmedian(np.linalg.norm(ground - problem.images.position, axis=1)))
    if not (np.isfinite(velocity).all(axis=1).any() and np.isfinite(distance)):
        return None
    seen = camera.inv().apply(velocity)
    # frames per second that the ground moves through, along lines and along columns
    per_px = np.linalg.norm(ends[1:] - ends[0], axis=1) * distance
    axes = (ends[1:] - ends[0]) / np.linalg.norm(ends[1:] - ends[0], axis=1)[:, None]
    rate = np.abs(np.nanmedian(seen @ axes.T, axis=0)) / (per_px * (lines, columns))
    dt = np.diff(problem.t)
    inside = np.flatnonzero(np.diff(times.stretch) == 0)
    worst = int(inside[np.argmax(dt[inside])])

    def share(seconds: float) -> float:
        return float(np.prod(np.maximum(1.0 - rate * seconds, 0.0)))

    speed = float(np.nanmedian(np.linalg.norm(velocity, axis=1)))
    covered = speed / max(float(rate.max()), 1e-12) if speed > 0.0 else np.inf
    return Overlap(speed * times.step, covered, share(times.step), share(float(dt[worst])), worst)


def _velocity(problem: SequenceProblem, stretch: NDArray[np.intp]) -> Array:
    """m/s (M, 3), between places farther apart than their noise; NaN where a stretch is too short for that."""
    t, position = problem.t, problem.images.position
    known = problem.known.position[np.isfinite(problem.known.position)]
    apart = _SPEED_SIGMAS * float(np.median(known))
    out = np.full((len(t), 3), np.nan)
    for number in np.unique(stretch):
        rows = np.flatnonzero(stretch == number)
        if len(rows) < 2:
            continue
        half = 1
        while True:
            a, b = np.maximum(np.arange(len(rows)) - half, 0), np.minimum(np.arange(len(rows)) + half, len(rows) - 1)
            moved = position[rows[b]] - position[rows[a]]
            if half >= len(rows) or float(np.median(np.linalg.norm(moved, axis=1))) > apart:
                break
            half *= 2
        out[rows] = moved / (t[rows[b]] - t[rows[a]])[:, None]
    return out


def side_overlap(problem: SequenceProblem) -> float:
    """Share of the frames that see ground which another stretch sees too; NaN of a single stretch.

    By the rough poses: middles of frames nearer to each other than most of a frame is wide.
    """
    stretch = times_of(problem.t).stretch
    if stretch[-1] == 0 or not np.isfinite(problem.known.position).any():
        return np.nan
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    look = (problem.images.world_from_body * problem.mount).apply(
        problem.detector.directions(read_only(middle))[0]
    )
    ground = problem.surface.intersect(problem.images.position, read_only(look))
    known = np.flatnonzero(np.isfinite(ground).all(axis=1))
    if not len(known):
        return np.nan
    distance = np.linalg.norm(ground[known] - problem.images.position[known], axis=1)
    width = _SHARED * float(np.median(distance)) * min(problem.detector.shape) / problem.detector.focal_length_px
    shared = np.zeros(len(known), dtype=bool)
    for number in np.unique(stretch[known]):
        own = stretch[known] == number
        if own.all():
            return 0.0
        near, _ = cKDTree(ground[known][~own]).query(ground[known][own], distance_upper_bound=width)
        shared[own] = np.isfinite(near)
    return float(shared.mean())


def expected_cube(problem: SequenceProblem, plan: CubePlan) -> tuple[CubeGrid, BandLayout]:
    """The map and the bands that a plan would come to by the rough poses.

    Parameters
    ----------
    problem : SequenceProblem
    plan : CubePlan

    Raises
    ------
    InputError
        If the plan asks for what the camera does not see, or no frame looks at the ground.
    """
    views, system = frame_views(problem), map_of(problem)
    ground = Ground(given_heights(problem.surface, system), "", 0.0)
    outline, _ = frame_outlines(problem, system, ground, views)
    gsd = plan.gsd or pixel_size(problem, views, outline)
    overlap = overlap_of(problem)
    step = None if overlap is None else overlap.step / gsd
    layout = choose_bands(problem, plan, outline, gsd, step)
    return grid_of(outline[np.isfinite(views.penalty)].reshape(-1, 2), system, gsd), layout
