"""In which order the frames of a flight are solved, and what that takes.

Points tie the frames that show them. In a single line these are neighbours in time, and so is the order.
Where lines cross or lie beside each other, either frames of all lines go together (one band, as wide as the
frames of all lines that see the same ground), or each line goes by itself, and the few frames that share
points with other lines go last. Both give the same numbers.

Not here: the solution (``poses.py``, ``photogrammetry/block/linked_frames.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from sightline.photogrammetry.block.linked_frames import longest, pairs_of_points, runs_of_points
from sightline.photogrammetry.sightings import Images, Index, Sightings, Tracks

#: Unknowns of a frame; bytes of a number.
_OWN, _BYTES = 6, 8.0
#: Bands that an adjustment holds at once at most, and as many dense matrices of the frames solved last
#: (measured).
_BANDS, _DENSE = 6.0, 5.0
#: Share of the multiplications of one band from which on lines by themselves are worth their bookkeeping.
_CHEAPER = 0.5


@dataclass(frozen=True, eq=False)
class SolvingOrder:
    """How the frames of a flight are solved.

    Attributes
    ----------
    rank : (M,) int
        Place of each frame in the order.
    last : (M,) bool or None
        Frames, by rank, that are solved after all others; None: one band.
    multiplications : float
        Of one factorisation.
    memory : float
        Bytes that an adjustment takes, beyond a few per sighting.
    """

    rank: NDArray[np.intp]
    last: NDArray[np.bool_] | None
    multiplications: float
    memory: float


def solving_order(images: Images, sightings: Sightings | Tracks) -> SolvingOrder:
    """The cheapest order in which the frames of a flight are solved.

    Parameters
    ----------
    images : Images
        M, in order of time.
    sightings : Sightings or Tracks
        Of these images.
    """
    together = one_band(len(images), sightings)
    apart = _lines_apart(len(images), sightings)
    if apart is not None and apart.multiplications < _CHEAPER * together.multiplications:
        return apart
    return together


def one_band(count: int, sightings: Sightings | Tracks) -> SolvingOrder:
    """Frames with points in common near each other."""
    rank = _rank(count, sightings)
    points = int(sightings.point.max(initial=-1)) + 1
    low, high = np.full(points, count), np.zeros(points, dtype=np.intp)
    np.minimum.at(low, sightings.point, rank[sightings.image])
    np.maximum.at(high, sightings.point, rank[sightings.image])
    width = _OWN * (int((high - low).max(initial=0)) + 1.0)
    size = float(_OWN * count)
    return SolvingOrder(rank, None, size * width**2, _BANDS * _BYTES * size * width)


def _rank(count: int, sightings: Sightings | Tracks) -> NDArray[np.intp]:
    """Rank (M,) of each frame such that frames with points in common lie near each other.

    That of time serves a single line; where lines cross or lie beside each other, frames of all lines go
    together.
    """
    order = np.lexsort((sightings.image, sightings.point))
    image, point = sightings.image[order], sightings.point[order]
    first = np.flatnonzero(np.concatenate([[True], np.diff(point) > 0]))
    hub = np.repeat(image[first], np.diff(np.append(first, len(point))))
    near = np.arange(count - 1)
    rows, columns = np.concatenate([hub, near]), np.concatenate([image, near + 1])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    found = reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True)
    rank = np.empty(count, dtype=np.intp)
    rank[found] = np.arange(count)
    in_time = int(np.abs(rows - columns).max())
    return rank if 2 * int(np.abs(rank[rows] - rank[columns]).max()) < in_time else np.arange(count)


def _lines_apart(count: int, sightings: Sightings | Tracks) -> SolvingOrder | None:
    """Each line by itself, then the frames that tie them; None where no point ties frames far apart."""
    order, run, shared = runs_of_points(sightings.image, sightings.point)
    if not shared.any():
        return None
    frame, point = sightings.image[order], sightings.point[order]
    far = shared[point]
    pairs = _far_pairs(frame[far], point[far], run[far])
    last = _cover(pairs, count)
    width = _OWN * (longest(frame, run) + 1.0)
    part = _parts(frame, run, count)
    # a link is a column of each part that it has points in, its own among them
    links = np.flatnonzero(last)
    columns = [np.stack([part[links], links])]
    for one, other in ((0, 1), (1, 0)):
        tied = last[pairs[:, one]] & ~last[pairs[:, other]]
        columns.append(np.stack([part[pairs[tied, other]], pairs[tied, one]]))
    of_part = np.unique(np.concatenate(columns, axis=1), axis=1)[0]
    sizes = _OWN * np.bincount(part).astype(np.float64)
    borders = _OWN * np.bincount(of_part, minlength=len(sizes)).astype(np.float64)
    dense, size = float(_OWN * len(links)), float(_OWN * count)
    work = size * width**2 + dense**3 / 3.0 + float((sizes * borders * (width + 0.5 * borders)).sum())
    held = _BANDS * size * width + _DENSE * dense**2 + 2.0 * float((sizes * borders).sum())
    return SolvingOrder(np.arange(count), last, work, _BYTES * held)


def _far_pairs(frame: Index, point: Index, run: Index) -> NDArray[np.intp]:
    """Pairs (P, 2) of frames with a point in common that is not followed from one to the other."""
    later, earlier = pairs_of_points(point)
    far = run[later] != run[earlier]
    return np.unique(np.stack([frame[earlier[far]], frame[later[far]]], axis=1), axis=0)


def _cover(pairs: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    """Few frames (M,) bool, of which every pair has one: each time that of most pairs left."""
    chosen = np.zeros(count, dtype=bool)
    while len(pairs):
        most = int(np.bincount(pairs.ravel()).argmax())
        chosen[most] = True
        pairs = pairs[(pairs != most).all(axis=1)]
    return chosen


def _parts(frame: Index, run: Index, count: int) -> NDArray[np.intp]:
    """Line (M,) of each frame: one ends where no point is followed on."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(run) > 0]))
    final = np.append(first[1:], len(run)) - 1
    spans = np.bincount(frame[first] + 1, minlength=count + 1) - np.bincount(
        frame[final] + 1, minlength=count + 1
    )
    return np.asarray(np.cumsum(np.cumsum(spans[:count]) == 0) - 1, dtype=np.intp)
