"""What a user should know of the poses of a sequence, in words.

Not here: what was noticed while reading (``io/sequence/load.py``), control points (``control_check.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sightline.errors import EstimationError
from sightline.geometry.checks import Array
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.flight.focal import FocalStretch
from sightline.photogrammetry.flight.path import stretches
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.subset import Subset
from sightline.photogrammetry.sightings import Tracks

#: px, 1-sigma at the ends of a stretch, from which on it is worth saying that the stretch may be bent.
BENT_PX = 1.0
#: Frames of a subset up to which nothing is seen from three sides.
_FEW = 2
_AXES = ("roll", "pitch", "yaw")
#: Share of the sigma beforehand from which on a focal length is not observable, and hardly observable.
UNOBSERVABLE, HARDLY = 0.9, 0.5
#: Relative sigma of a focal length of which nothing was known, from which on it is hardly observable: heights
#: above ground go with it.
_LOOSE_FOCAL = 0.02
#: The same, from which on it is not observable: perspective alone gives as much, wrongly.
_UNOBSERVABLE_FOCAL = 0.03
#: Relative change from where it started, from which on such a focal length has run away.
_RUN_AWAY = 0.5
#: Sigmas (of what was known beforehand) by which a focal length may be off: chance leads there once in 2,000.
_FAR_FOCAL = 3.5


def focal_verdict(focal: FocalStretch) -> str:
    """How well the images estimated a focal length: "observable", "hardly observable", "not observable".

    Parameters
    ----------
    focal : FocalStretch
    """
    if not np.isfinite(focal.prior):
        free = ("not observable", _UNOBSERVABLE_FOCAL), ("hardly observable", _LOOSE_FOCAL)
        return next((words for words, least in free if focal.sigma >= least), "observable")
    share = focal.sigma / focal.prior
    if share >= UNOBSERVABLE:
        return "not observable"
    return "hardly observable" if share >= HARDLY else "observable"


def refuse_unobservable_focal(poses: FramePoses) -> None:
    """EstimationError where a focal length of which nothing was known rests on perspective alone.

    Parameters
    ----------
    poses : FramePoses
        The last solution.

    Notes
    -----
    Its sigma would be too small by a factor of two to four, and heights of all frames with it: flights of
    points over flat ground, heights of positions not given.
    """
    focal = poses.focal
    if focal is None or np.isfinite(focal.prior):
        return
    if focal_verdict(focal) != "not observable" and abs(focal.stretch) < _RUN_AWAY:
        return
    raise EstimationError(
        "the focal length is not observable in the frames, and nothing is given of it: known to "
        f"{100.0 * focal.sigma:.2g} % at best, by perspective alone, and "
        f"{100.0 * focal.stretch:+.2g} % from the one given; give focal_length_px with its "
        'focal_length_sigma_px in place of "estimate", or heights of positions above a surface of known '
        "height, or control points"
    )


def focal_warnings(problem: SequenceProblem, poses: FramePoses) -> list[str]:
    """A warning where the focal length was sought and hardly found, and where it is far from the one given.

    Parameters
    ----------
    problem : SequenceProblem
    poses : FramePoses
    """
    focal = poses.focal
    if focal is None:
        return []
    out, verdict = [], focal_verdict(focal)
    known = f"{100.0 * focal.sigma:.2g} % (1-sigma)"
    if verdict != "observable":
        before = (
            f", beforehand to {100.0 * focal.prior:.2g} %; the sigmas of poses hold that, heights above "
            "ground first of all"
            if np.isfinite(focal.prior)
            else " at best: perspective alone gives it, badly, and heights above ground go with it"
        )
        out.append(
            f"the focal length is {verdict}: known to {known}{before}. Positions above a surface of known "
            "height, on a path that climbs, or control points make it observable"
        )
    if np.isfinite(focal.prior) and abs(focal.stretch) > _FAR_FOCAL * focal.prior:
        px = poses.detector(problem.detector).focal_length_px
        out.append(
            f"the focal length found, {px:.6g} px, is {abs(focal.stretch) / focal.prior:.1f} of its sigmas "
            "from the one given: check focal_length_px and its sigma, heights of positions, [surface] height"
        )
    return out


def bow_warnings(problem: SequenceProblem, poses: FramePoses) -> list[str]:
    """Stretches that may be bent for all that is known.

    Parameters
    ----------
    problem : SequenceProblem
    poses : FramePoses
        Of all its frames.

    Returns
    -------
    list of str
        One for each stretch that may be bent by a pixel and more (1-sigma) at its ends.
    """
    out = []
    detector, stretch = poses.detector(problem.detector), stretches(problem.t)
    for number, sigma in enumerate(poses.bow):
        ends = bent_px(detector, sigma)
        worst = int(np.argmax(ends))
        if ends[worst] < BENT_PX:
            continue
        count = int((stretch == number).sum())
        out.append(
            f"stretch {number + 1} ({count} frames) may be bent: an even trend of {_AXES[worst]} from end to "
            f"end is known to {np.degrees(sigma[worst]):.2g} deg rms only (1-sigma), {ends[worst]:.1f} px at "
            "its ends; attitudes, better positions, known heights or crossing flight lines would show it"
        )
    return out


def bent_px(detector: AreaDetector, bow: Array) -> Array:
    """px (..., 3), 1-sigma by which a bow about each axis moves the ground at the ends of a stretch.

    Parameters
    ----------
    detector : AreaDetector
        With the focal length found.
    bow : (..., 3)
        rad, as of `FramePoses`.
    """
    # a turn moves the ground by the focal length times it, about the line of sight by the place in the frame
    lever = np.array([detector.focal_length_px] * 2 + [0.5 * float(np.hypot(*detector.shape))])
    # an even trend of rms 1 ends at the root of 3
    return np.asarray(np.sqrt(3.0) * bow * lever)


def short_warnings(subset: Subset) -> list[str]:
    """A warning where a sequence hardly moves on, so that its frames see everything from one side."""
    if len(subset) > _FEW:
        return []
    parallax = np.degrees(subset.parallax[np.isfinite(subset.parallax)])
    angle = f" under an angle of {parallax.max():.2g} degrees" if len(parallax) else ""
    return [
        f"a very short sequence: its subset has {len(subset)} frames, which see the ground{angle}; "
        "heights and poses are hardly better than the tables that give them, nothing checks matches "
        "against a third view, and bands whose lines did not pass over a place are missing there"
    ]


def tied_parts(tracks: Tracks, used: NDArray[np.bool_], frames: int) -> NDArray[np.intp]:
    """Part (M,) that each frame is of: frames of one part share points, directly or through others.

    Parameters
    ----------
    tracks : Tracks
    used : (N,) bool
        Sightings that count.
    frames : int
        How many there are, M.

    Returns
    -------
    (M,) int
        Numbered by their first frames; -1 where a frame shares none.
    """
    image, point = tracks.image[used], tracks.point[used]
    size = frames + (int(tracks.point.max()) + 1 if len(tracks) else 0)
    graph = coo_matrix((np.ones(len(image)), (image, frames + point)), shape=(size, size))
    label = connected_components(graph, directed=False)[1][:frames]
    out = np.full(frames, -1, dtype=np.intp)
    number = 0
    for k in np.flatnonzero(np.bincount(label, minlength=size)[label] > 1):
        if out[k] < 0:
            out[label == label[k]] = number
            number += 1
    return out


def part_warnings(problem: SequenceProblem, tracks: Tracks, poses: FramePoses) -> list[str]:
    """A warning where frames fall into parts that share no ground, with the first and last of each."""
    part = tied_parts(tracks, ~poses.rejected, len(problem))
    count = int(part.max(initial=-1)) + 1
    if count < 2:
        return []
    rows = [np.flatnonzero(part == number) for number in range(count)]
    named = ", ".join(f"{problem.frames[r[0]]} to {problem.frames[r[-1]]} ({len(r)})" for r in rows[:4])
    return [
        f"the frames fall into {count} parts between which no window could be followed: "
        f"{named}{', ...' if count > 4 else ''}; each rests on its own rows of the tables, whose "
        "constant errors are taken as common: frames of another flight belong in a SEQUENCE.toml of their own"
    ]
