"""What the rough poses of a sequence let expect before anything is solved: gaps, overlap, speed.

Not here: the size of the maps (``products/cube_plan.py``), all this in words
(``io/sequence/outlook.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sightline.geometry.checks import Array, read_only
from sightline.photogrammetry.flight.path import stretches
from sightline.photogrammetry.flight.problem import SequenceProblem, seen_ground

#: Times the usual step from which on frames are missing between two of a stretch.
_MISSING = 1.6
#: Sigmas of the positions by which the places that give a speed are apart, no farther as flights turn; of a
#: short stretch at least.
_SPEED_SIGMAS, _LEAST_SIGMAS = 4.0, 2.0
#: m/s; of drones that hardly move, and of orbits, beyond which units may be wrong.
SLOWEST, FASTEST = 0.1, 12e3
#: rad; sigma of attitudes beyond which they may have been given in degrees.
LARGE_ATTITUDE_SIGMA = 0.2
#: rad; the same of their constant error, which a camera mounted by hand may have large.
LARGE_ATTITUDE_BIAS = 0.5
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
    """Expected overlap of successive frames; None where positions or times do not give it.

    Steps are speed times time: positions of single frames may be noisier than their distance.
    """
    times = times_of(problem.t)
    if not (np.isfinite(problem.known.position).any() and np.isfinite(times.step)):
        return None
    moved, speed = ground_motion(problem)
    if not np.isfinite(moved).any():
        return None
    rate = np.abs(np.nanmedian(moved, axis=0)) / problem.detector.shape
    dt = np.diff(problem.t)
    inside = np.flatnonzero(np.diff(times.stretch) == 0)
    worst = int(inside[np.argmax(dt[inside])])

    def share(seconds: float) -> float:
        return float(np.prod(np.maximum(1.0 - rate * seconds, 0.0)))

    covered = speed / float(rate.max()) if rate.max() > 0.0 else np.inf
    return Overlap(speed * times.step, covered, share(times.step), share(float(dt[worst])), worst)


def ground_motion(problem: SequenceProblem) -> tuple[Array, float]:
    """How the rough poses let the ground move through each frame.

    Returns
    -------
    moved : (M, 2)
        px/s of (line, column); NaN where the positions of a stretch do not give a speed.
    speed : float
        m/s of the camera, median; NaN likewise.
    """
    velocity = _velocity(problem, stretches(problem.t))
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    ends = problem.detector.directions(read_only(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
    camera = problem.images.world_from_body * problem.mount
    distance = np.linalg.norm(seen_ground(problem) - problem.images.position, axis=1)
    if not (np.isfinite(velocity).any() and np.isfinite(distance).any()):
        return np.full((len(problem.t), 2), np.nan), np.nan
    # tangents of a pixel along lines and along columns
    pixel = ends[1:] - ends[0]
    along = camera.inv().apply(velocity) @ (pixel / (pixel**2).sum(axis=1)[:, None]).T
    # the camera goes forward, the ground through its frames goes back
    moved = -along / np.nanmedian(distance)
    return np.asarray(moved), float(np.nanmedian(np.linalg.norm(velocity, axis=1)))


def _velocity(problem: SequenceProblem, stretch: NDArray[np.intp]) -> Array:
    """m/s (M, 3), between places farther apart than their noise; NaN in a stretch too short for it."""
    t, position = problem.t, problem.images.position
    known = problem.known.position[np.isfinite(problem.known.position)]
    out = np.full((len(t), 3), np.nan)
    if not len(known):
        return out
    noise = float(np.median(known))
    for number in np.unique(stretch):
        rows = np.flatnonzero(stretch == number)
        half, at = 1, np.arange(len(rows))
        while len(rows) > 1:
            before, after = rows[np.maximum(at - half, 0)], rows[np.minimum(at + half, len(rows) - 1)]
            moved = position[after] - position[before]
            far = float(np.median(np.linalg.norm(moved, axis=1)))
            if far > _SPEED_SIGMAS * noise or half >= len(rows):
                if far > _LEAST_SIGMAS * noise:
                    out[rows] = moved / (t[after] - t[before])[:, None]
                break
            half *= 2
    return out


def side_overlap(problem: SequenceProblem) -> float:
    """Share of the frames that see ground which another stretch sees too; NaN of a single stretch.

    By the rough poses: middles of frames nearer to each other than most of a frame is wide.
    """
    stretch = times_of(problem.t).stretch
    if stretch[-1] == 0 or not np.isfinite(problem.known.position).any():
        return np.nan
    ground = seen_ground(problem)
    known = np.flatnonzero(np.isfinite(ground).all(axis=1))
    if not len(known):
        return np.nan
    distance = np.linalg.norm(ground[known] - problem.images.position[known], axis=1)
    width = (
        _SHARED * float(np.median(distance)) * min(problem.detector.shape) / problem.detector.focal_length_px
    )
    shared = np.zeros(len(known), dtype=bool)
    for number in np.unique(stretch[known]):
        own = stretch[known] == number
        if own.all():
            return 0.0
        near, _ = cKDTree(ground[known][~own]).query(ground[known][own], distance_upper_bound=width)
        shared[own] = np.isfinite(near)
    return float(shared.mean())


def unit_doubts(problem: SequenceProblem) -> tuple[str, ...]:
    """What speed and sigmas let suspect of the units of the tables."""
    said = []
    sigma, bias = problem.known.attitude, problem.known.attitude_bias
    own = np.isfinite(sigma).all(axis=1)
    if own.any() and bias > LARGE_ATTITUDE_BIAS:
        said.append(
            f"attitude_bias_sigma = {bias:.3g} rad is {np.degrees(bias):.3g} degrees: were degrees meant? "
            f"{bias:.3g} degrees are {np.radians(bias):.3g} rad"
        )
    usual = float(np.median(sigma[own])) if own.any() else 0.0
    if usual > LARGE_ATTITUDE_SIGMA:
        said.append(
            f"a sigma of attitudes of {usual:.3g} rad is {np.degrees(usual):.3g} degrees: is it in degrees? "
            "rad are expected"
        )
    overlap = overlap_of(problem)
    speed = np.nan if overlap is None else overlap.step / times_of(problem.t).step
    if np.isfinite(speed) and not SLOWEST < speed < FASTEST:
        said.append(
            f"the camera flies at {speed:.2g} m/s by the tables: are times in seconds and positions in "
            "metres?"
        )
    return tuple(said)
