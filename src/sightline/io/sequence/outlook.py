"""In plain words what a SEQUENCE.toml lets expect: gaps in time, overlap, size of the maps, what is missing.

Not here: the numbers (``photogrammetry/flight/outlook.py``, ``products/cube_plan.py``), the rest of
``check`` (``describe.py``).
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from sightline.errors import InputError
from sightline.execution import size_words
from sightline.geometry.surface import Dem, Ellipsoid, Plane
from sightline.io.results.cube_summary import check_bands, cube_plan
from sightline.io.sequence.load import FrameSequence
from sightline.photogrammetry.flight.outlook import (
    Overlap,
    Times,
    overlap_of,
    side_overlap,
    times_of,
)
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_plan import expected_cube

#: Share of a frame that successive frames have to share for displacements to be measured.
LEAST_OVERLAP = 0.5
#: The same below which frames are not surely followed, and features link them: of rendered flights all frames
#: were followed at 75 %, nine in ten at 70 %, two thirds at 65 %, few at 60 %.
LEAST_FOLLOWED = 0.75
#: Gaps and stretches that are named in a message.
LISTED = 3
#: Frames from which on a sequence has overlaps enough that a gap in it stands out.
_FEW = 3


def cadence_words(problem: SequenceProblem) -> list[str]:
    """Stretches and gaps."""
    times, names = times_of(problem.t), problem.frames
    if not np.isfinite(times.step):
        return []
    said = [f"frames follow each other every {times.step:.4g} s"]
    count = int(times.stretch[-1]) + 1
    if count > 1:
        rows = [np.flatnonzero(times.stretch == number) for number in range(count)]
        named = ", ".join(f"{names[r[0]]} to {names[r[-1]]} ({len(r)})" for r in rows[:LISTED])
        more = f" and {count - LISTED} more" if count > LISTED else ""
        said[0] += f", in {count} stretches between pauses: {named}{more}"
    if len(times.gaps) and len(problem) >= _FEW:
        said.append(_gap_words(problem, times))
    return said


def _gap_words(problem: SequenceProblem, times: Times) -> str:
    step = np.diff(problem.t)
    named = ", ".join(
        f"{problem.frames[k]} and {problem.frames[k + 1]} ({step[k]:.4g} s)" for k in times.gaps[:LISTED]
    )
    more = f" and {len(times.gaps) - LISTED} more" if len(times.gaps) > LISTED else ""
    missing = int(times.missing.sum())
    gaps, frames = "gap" if len(times.gaps) == 1 else "gaps", "frame is" if missing == 1 else "frames are"
    return (
        f"note: {len(times.gaps)} {gaps} in time, in which about {missing} {frames} missing: between "
        f"{named}{more}; frames on both sides are linked where they still share enough ground"
    )


def overlap_words(problem: SequenceProblem) -> list[str]:
    """What successive frames and flight lines share, by the rough poses."""
    overlap = overlap_of(problem)
    if overlap is None:
        return []
    said = [
        f"successive frames share about {overlap.usual:.0%}, by the rough positions{_least(problem, overlap)}"
    ]
    if overlap.usual < LEAST_OVERLAP:
        said.append("with so little common ground poses are weak; check positions, height, and focal length")
    side = side_overlap(problem)
    if np.isfinite(side):
        said.append(
            f"about {side:.0%} of the frames see ground that another stretch sees too, by the rough poses"
            + ("; without such ground stretches are held to each other by tables alone" if side < 0.1 else "")
        )
    return said


def _least(problem: SequenceProblem, overlap: Overlap) -> str:
    if overlap.least > overlap.usual - 0.02:
        return ""
    k = overlap.worst
    share = f"at least {overlap.least:.0%}" if overlap.least > 0.0 else "nothing at the longest step"
    return f"; {share}, between {problem.frames[k]} and {problem.frames[k + 1]}"


def map_words(sequence: FrameSequence) -> list[str]:
    """Size of the maps that ``[cube]`` asks for, and the heights they lie on.

    Raises
    ------
    InputError
        If ``[cube]`` asks for what the camera does not see.
    """
    problem, cube = sequence.problem, sequence.cube
    if not cube.make:
        return ["no maps: [cube] make = false"]
    check_bands(sequence)
    try:
        grid, layout = expected_cube(problem, cube_plan(cube))
    except InputError as error:
        return [f"size of the maps: not known by the rough poses: {error}"]
    bands = f"about {len(layout)} bands" if len(layout) != 1 else "1 band"
    if not np.isfinite(problem.known.position).any():
        return [f"maps of {bands}; their size is known once control points have given the flying height"]
    rows, columns = grid.shape
    size = 4.0 * rows * columns * len(layout) * len(cube.formats)
    return [
        f"maps of {bands} of {rows} rows x {columns} columns of {grid.gsd:.3g} m: some "
        f"{size_words(size)} as {', '.join(cube.formats)} before compression (--poses-only: none)"
        + _by_ground(problem),
        f"heights of the maps: {_heights(sequence)}",
    ]


def _by_ground(problem: SequenceProblem) -> str:
    """Of what ground sizes are, where it is a start only: the maps are laid on the ground that is found."""
    if not isinstance(problem.surface, Plane | Ellipsoid) or problem.height_sigma > 0.0:
        return ""
    return (
        f"; by ground at {problem.surface.height:g} m, of which [surface] gives no height_sigma: sizes go "
        "with the flying height above the ground that is found"
    )


def _heights(sequence: FrameSequence) -> str:
    given = "of the dem" if isinstance(sequence.problem.surface, Dem) else "of [surface] height"
    if sequence.cube.surface == "given":
        return f"those {given}, as [cube] surface asks for"
    if sequence.cube.surface == "model":
        return "those of the points that are found, as [cube] surface asks for"
    return f"those of the points that are found, or those {given} if points meet them as well"


def program_words(sequence: FrameSequence) -> list[str]:
    """Libraries that this sequence needs, or may need, and that are not installed."""
    problem, said = sequence.problem, []
    overlap = overlap_of(problem)
    why = []
    if not np.isfinite(problem.known.attitude).any():
        why.append("no attitudes are given")
    if overlap is not None and overlap.usual < LEAST_FOLLOWED:
        why.append(f"successive frames share {overlap.usual:.0%}, where they cannot be followed")
    if why and find_spec("pycolmap") is None:
        said.append(f"pycolmap, which is needed as {' and '.join(why)}: run `pip install pycolmap`")
    if sequence.cube.make and "zarr" in sequence.cube.formats and find_spec("zarr") is None:
        said.append("zarr, for [cube] formats: run `pip install zarr`")
    return said
