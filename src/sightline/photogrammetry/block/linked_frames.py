"""Normal equations of flights of several lines: each line's band by itself, then the frames that tie them.

Points are eliminated first. Points that were followed tie frames to neighbours in time; points that lines
share tie a few frames to frames of other lines. These few (`PoseUnknowns.last`) are solved last: without them
the lines fall apart into bands as narrow as of single lines.

Not here: which frames are solved last (``photogrammetry/flight/solving_order.py``), the algebra
(``estimation/linked_bands.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.linked_bands import LinkedBand, LinkedBands
from sightline.geometry.checks import Array
from sightline.photogrammetry.block.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.block.reduced import (
    UNSOLVABLE,
    Curvature,
    PointsEliminated,
    PointsFirst,
    PosesFirst,
    gather,
    poses_first,
)
from sightline.photogrammetry.sightings import Index

#: Frames that show points up to which a point may stay unseen and still be one that is followed.
_SKIPPED = 3


def reduce_block(curvature: Curvature, unknowns: PoseUnknowns) -> PosesFirst | PointsFirst | LinkedFrames:
    """Normal equations by whichever order is cheaper; lines by themselves where some shots are kept last."""
    if unknowns.last is not None:
        return LinkedFrames(curvature, unknowns)
    return (PosesFirst if poses_first(curvature, unknowns) else PointsFirst)(curvature, unknowns)


def runs_of_points(frame: Index, point: Index) -> tuple[Index, Index, NDArray[np.bool_]]:
    """Sightings in order of point and frame, and the runs of frames in which points are followed.

    Parameters
    ----------
    frame, point : (N,) int

    Returns
    -------
    order : (N,) int
    run : (N,) int
        Of each sighting in this order; a point that is seen again after a while begins another.
    shared : (n,) bool
        Points of more than one run.
    """
    order = np.lexsort((frame, point)).astype(np.intp)
    if not len(order):
        return order, order, np.zeros(0, dtype=bool)
    # frames that show nothing are skipped by all points alike
    number = np.cumsum(np.bincount(frame) > 0)[frame[order]]
    same = np.diff(point[order]) == 0
    again = same & (np.diff(number) > _SKIPPED)
    run = np.concatenate([[0], np.cumsum(~same | again)]).astype(np.intp)
    shared = np.zeros(int(point.max()) + 1, dtype=bool)
    shared[point[order][1:][again]] = True
    return order, run, shared


class _Sums:
    """Blocks of the normal equations, sorted into bands of lines, links, and what ties both."""

    def __init__(self, last: NDArray[np.bool_], reach: int) -> None:
        self.last = last
        count = len(last)
        self.frames, self.links = np.flatnonzero(~last), np.flatnonzero(last)
        self.place = np.empty(count, dtype=np.intp)
        self.place[self.frames] = np.arange(len(self.frames))
        self.place[self.links] = np.arange(len(self.links))
        self.band = np.zeros((6 * (reach + 1), 6 * len(self.frames)))
        self.corner = np.zeros((len(self.links), 6, len(self.links), 6))
        self._ties: list[tuple[Index, Index, Array]] = []  # frame, link, block with rows of the frame
        self._covered = np.zeros(len(self.frames) + 1, dtype=np.intp)

    def add(self, here: Index, there: Index, small: Array) -> None:
        """Blocks with rows of shots `here` and columns of shots `there`, here >= there; no pair twice."""
        i, j, h, t = self.place[here], self.place[there], self.last[here], self.last[there]
        filled = small.any(axis=(1, 2))
        rows = np.flatnonzero(~h & ~t & filled)
        self._add_band(i[rows], j[rows], small[rows])
        rows = np.flatnonzero(h & t)
        self.corner[i[rows], :, j[rows]] += small[rows]
        rows = rows[i[rows] != j[rows]]
        self.corner[j[rows], :, i[rows]] += np.swapaxes(small[rows], 1, 2)
        rows = np.flatnonzero(~h & t & filled)
        self._ties.append((i[rows], j[rows], small[rows]))
        rows = np.flatnonzero(h & ~t & filled)
        self._ties.append((j[rows], i[rows], np.swapaxes(small[rows], 1, 2)))

    def _add_band(self, i: Index, j: Index, small: Array) -> None:
        """Blocks of frames i >= j of the bands."""
        for a in range(6):
            for b in range(6):
                rows = slice(None) if a >= b else i > j
                self.band[6 * (i - j)[rows] + a - b, 6 * j[rows] + b] += small[rows, a, b]
        np.add.at(self._covered, j + 1, 1)
        np.add.at(self._covered, i + 1, -1)

    def bands(self, border: Array) -> tuple[list[LinkedBand], list[Index]]:
        """Bands, each with its border of links and globals (`border` (K, 6, G)), and the shots of each."""
        # a band ends where no block spans two frames
        part = np.cumsum(np.cumsum(self._covered[:-1]) == 0) - 1
        frame, link, block = (np.concatenate(each) for each in zip(*self._ties, strict=True))
        common = np.arange(border.shape[2])
        out, shots = [], []
        for number in range(int(part[-1]) + 1 if len(part) else 0):
            rows = np.flatnonzero(part == number)
            first, count = int(rows[0]), len(rows)
            own = np.flatnonzero(part[frame] == number)
            names, column = np.unique(link[own], return_inverse=True)
            sides = np.zeros((count, len(names), 6, 6))
            np.add.at(sides, (frame[own] - first, column), block[own])
            own_shots = self.frames[rows]
            whole = np.concatenate(
                [np.swapaxes(sides, 1, 2).reshape(count, 6, -1), border[own_shots]], axis=2
            )
            columns = (6 * names[:, None] + np.arange(6)).ravel()
            out.append(
                LinkedBand(
                    self.band[:, 6 * first : 6 * (first + count)],
                    whole.reshape(6 * count, -1),
                    np.concatenate([columns, 6 * len(self.links) + common]).astype(np.intp),
                )
            )
            shots.append(own_shots)
        return out, shots


class LinkedFrames:
    """Points eliminated first, then the frames of each line, then those that tie lines together.

    `unknowns`: shots of one image each, in order of time, and `last` given.
    """

    reusable = True

    def __init__(self, curvature: Curvature, unknowns: PoseUnknowns) -> None:
        assert unknowns.last is not None
        if unknowns.own != 6:
            raise InputError(f"shots solved last must move as one body each, got {unknowns.own} unknowns")
        self._unknowns = unknowns
        shared = np.zeros(len(curvature.of_points), dtype=bool)
        shot = unknowns.shot[curvature.image]
        order, run, found = runs_of_points(shot, curvature.point)
        shared[: len(found)] = found
        self._left = PointsEliminated(curvature, unknowns, shared)
        tied = shared[curvature.point[order]]
        reach = max(self._left.reach, longest(shot[order][tied], run[tied]))
        sums = _Sums(unknowns.last, reach)
        border, corner = self._left.sums(
            lambda step, there, small: sums.add(there + step, there, np.asarray(small))
        )
        self._add_shared(sums, border, corner)
        bands, self._shots = sums.bands(border)
        self._links = sums.links
        size, common = 6 * len(sums.links), unknowns.globals
        whole = np.zeros((size + common, size + common))
        whole[:size, :size] = sums.corner.reshape(size, size)
        whole[:size, size:] = border[sums.links].reshape(size, common)
        whole[size:, :size] = whole[:size, size:].T
        whole[size:, size:] = corner
        try:
            self._factor = LinkedBands(bands, whole, common)
        except EstimationError:
            raise EstimationError(UNSOLVABLE) from None
        self.information = self._factor.information

    def _add_shared(self, sums: _Sums, border: Array, corner: Array) -> None:
        """Add what points that lines share take from frames and globals."""
        u = self._unknowns
        image, point, taken = self._left.taken()
        shot = u.shot[image]
        of_images = u.of_images()
        by_own, by_global = taken @ of_images[0][image], taken @ of_images[1][image]
        _, of_point = np.unique(point, return_inverse=True)
        together = np.zeros((int(of_point.max(initial=-1)) + 1, 3, u.globals))
        np.add.at(together, of_point, by_global)
        np.add.at(border, shot, -np.swapaxes(by_own, 1, 2) @ together[of_point])
        corner -= np.einsum("nkg,nkh->gh", together, together)
        # pairs of sightings of one point, the later frame first
        later, earlier = pairs_of_points(point)
        names, pair = np.unique(shot[later] * u.shots + shot[earlier], return_inverse=True)
        blocks = np.zeros((len(names), 6, 6))
        np.add.at(blocks, pair, -np.swapaxes(by_own[later], 1, 2) @ by_own[earlier])
        sums.add(names // u.shots, names % u.shots, blocks)

    def condense(self, shots: Array, points: Array, common: Array) -> Array:
        """Right-hand side (G,) left for the globals."""
        return self._factor.left(self._condensed(shots, points, common)[1])

    def _condensed(self, shots: Array, points: Array, common: Array) -> tuple[list[Array], Array]:
        own, right = self._left.eliminate(shots, points, common)
        return self._factor.condense(
            [own[s].ravel() for s in self._shots], np.concatenate([own[self._links].ravel(), right])
        )

    def solve(self, shots: Array, points: Array, common: Array, step: Array) -> tuple[Array, Array]:
        """Steps (K, 6) and (n, 3) for right-hand sides, the globals having taken `step` (G,)."""
        own_step = self._placed(*self._condensed(shots, points, common), step)
        return own_step, self._left.points(points, own_step, step)

    def form_covariance(self, covariance: Array, forms: Array) -> Array:
        """Covariance (M, D, n) of all departures with `forms` (M, D, n), weights of n sums of them.

        `covariance` (G, G) is that of the globals.
        """
        own, common = gather(self._unknowns, forms)
        out = np.empty(forms.shape)
        for k in range(forms.shape[2]):
            halves, right = self._factor.condense(
                [own[s, :, k].ravel() for s in self._shots],
                np.concatenate([own[self._links, :, k].ravel(), common[:, k]]),
            )
            step = covariance @ self._factor.left(right)
            out[:, :, k] = self._unknowns.departures(self._placed(halves, right, step), step)
        return out

    def _placed(self, halves: list[Array], right: Array, step: Array) -> Array:
        """Steps (K, 6) of the shots in their order."""
        bands, links = self._factor.solve(halves, right, step)
        own_step = np.empty((self._unknowns.shots, 6))
        for rows, solved in zip([*self._shots, self._links], [*bands, links], strict=True):
            own_step[rows] = solved.reshape(-1, 6)
        return own_step

    def departure_covariance(self, covariance: Array) -> Array:
        """Covariance (M, D, D) of the departure of each image, `covariance` (G, G) that of the globals."""
        u = self._unknowns
        inner, bridge = np.empty((u.shots, 6, 6)), np.empty((u.shots, 6, u.globals))
        found = self._factor.covariance(6)
        for rows, (blocks, follow) in zip([*self._shots, self._links], found, strict=True):
            inner[rows], bridge[rows] = blocks, follow.reshape(len(rows), 6, -1)
        by_own, by_global = u.of_images()
        common = by_global - by_own @ bridge[u.shot]
        whole = by_own @ inner[u.shot] @ np.swapaxes(by_own, 1, 2)
        return np.asarray(whole + common @ covariance @ np.swapaxes(common, 1, 2))

    def following_covariance(self, covariance: Array, count: int) -> None:
        """Not kept in this order: see `form_covariance`."""
        return None

    def point_covariance(self, covariance: Array) -> None:
        """Not kept in this order: triangulate the points with the poses found."""
        return None


def pairs_of_points(point: Index) -> tuple[Index, Index]:
    """Rows (P,) of all pairs of sightings of one point, the later row first; each with itself too.

    `point` (N,) is sorted.
    """
    later, earlier = [np.arange(len(point))], [np.arange(len(point))]
    for step in range(1, len(point)):
        rows = np.flatnonzero(point[step:] == point[:-step])
        if not len(rows):
            break
        later.append(rows + step)
        earlier.append(rows)
    return np.concatenate(later), np.concatenate(earlier)


def longest(frame: Index, run: Index) -> int:
    """Most frames from the first to the last of a run; `run` (N,) is sorted, as are frames within one."""
    if not len(run):
        return 0
    first = np.flatnonzero(np.concatenate([[True], np.diff(run) > 0]))
    last = np.append(first[1:], len(run)) - 1
    return int((frame[last] - frame[first]).max(initial=0))
