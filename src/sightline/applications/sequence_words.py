"""What a user should know of a sequence that was solved: that it falls into parts that nothing ties.

Not here: what was noticed while reading (``io/sequence.py``); control points (``control_check.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sightline.applications.frame_sequence import SequenceProblem
from sightline.photogrammetry.frame_poses import FramePoses
from sightline.photogrammetry.sightings import Tracks


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


def words_of_parts(problem: SequenceProblem, tracks: Tracks, poses: FramePoses) -> list[str]:
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
