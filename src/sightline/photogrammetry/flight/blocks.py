"""A long sequence in overlapping blocks: parts of a problem, and the whole from their solutions.

Not here: how a block is solved (``applications/sequence_poses.py``), how the whole follows
(``joined_blocks.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, frozen
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.flight.focal import FocalStretch
from sightline.photogrammetry.flight.joined_blocks import (
    BlockPoses,
    BlockRange,
    BlockStore,
    SolvedBlock,
    block_ranges,
    join_blocks,
)
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Index, Sightings, Tracks, as_index
from sightline.stages import Stages
from sightline.writing import scratch_folder

#: Frames of a block; a flight of fewer than twice as many is solved at once.
BLOCK_FRAMES = 500
#: Sightings of its own that a block needs.
_LEAST_SIGHTINGS = 1000


@dataclass(frozen=True, eq=False)
class PartSolution:
    """A part of a sequence, solved.

    Attributes
    ----------
    tracks : Tracks
        With the sigmas found; without points of control.
    sightings : Sightings
        As they were solved, points of control last.
    priors : PointPriors or None
    poses : FramePoses
    """

    tracks: Tracks
    sightings: Sightings
    priors: PointPriors | None
    poses: FramePoses


@dataclass(frozen=True, eq=False)
class _Part:
    """Some frames in a row: their problem, what was followed, rows and points of the whole's."""

    problem: SequenceProblem
    followed: Followed
    rows: Index
    names: Index
    control_rows: Index
    control_names: Index


@dataclass(frozen=True, eq=False)
class _Result:
    """Of a part's solution what the whole needs."""

    position: Array
    world_from_body: Rotation
    bias: Array
    roughness: Array
    scale: float
    block: SolvedBlock
    focal: FocalStretch | None = None


class _Spans:
    """Frames over which points are followed, and points of control seen."""

    def __init__(self, followed: Followed, control: Tracks | None) -> None:
        self.points = int(followed.point[-1]) + 1
        self._ends = np.searchsorted(followed.point, np.arange(self.points + 1))
        seen = np.diff(self._ends) > 0
        starts, lasts = self._ends[:-1], np.maximum(self._ends[1:] - 1, 0)
        self.first = np.where(seen, followed.image[np.minimum(starts, len(followed.image) - 1)], 0)
        self.last = np.where(seen, followed.image[lasts], 0)
        # points are numbered as they were first seen
        self.first = np.maximum.accumulate(self.first)
        #: Frames from the first to the last sighting of a point, at most.
        self.reach = int((self.last - self.first).max())
        self._control = np.zeros(0, dtype=np.intp)
        if control is not None and len(control):
            count = int(control.point.max()) + 1
            self._control, last = np.full(count, np.iinfo(np.intp).max), np.zeros(count, dtype=np.intp)
            np.minimum.at(self._control, control.point, control.image)
            np.maximum.at(last, control.point, control.image)
            self.reach = max(self.reach, int((last - self._control).max()))

    def begin(self, names: NDArray[np.intp]) -> NDArray[np.intp]:
        """First frame of points, those of control numbered after the others."""
        return np.concatenate([self.first, self._control])[names]

    def merged(self, ranges: list[BlockRange]) -> list[BlockRange]:
        """The same blocks, where hardly anything is followed made one with the next."""
        out: list[BlockRange] = []
        first = 0
        for place in ranges:
            low, high = np.searchsorted(self.first, [first, place.last])
            if int(self._ends[high] - self._ends[low]) >= _LEAST_SIGHTINGS:
                out.append(BlockRange(first, place.last, place.end))
                first = place.last
        if first < ranges[-1].last:
            first = out.pop().first if out else 0
            out.append(BlockRange(first, ranges[-1].last, ranges[-1].end))
        return out

    def rows(self, place: BlockRange) -> slice:
        """Sightings of all points that may be seen in frames of a block."""
        low, high = np.searchsorted(self.first, [place.first - self.reach, place.end])
        return slice(int(self._ends[low]), int(self._ends[high]))


def solve_in_blocks(
    problem: SequenceProblem,
    followed: Followed,
    solve: Callable[[SequenceProblem, Followed], PartSolution],
    heights: HeightPrior | None,
    *,
    length: int = BLOCK_FRAMES,
    stages: Stages | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FramePoses, Tracks]:
    """Poses of all frames, and tracks with the sigmas found in their blocks; points of control last.

    Parameters
    ----------
    problem : SequenceProblem
    followed : Followed
        Points numbered as they were first seen, sightings in their order.
    solve : callable
        Solves a part.
    heights : HeightPrior or None
        As of all parts.
    length : int
        Frames of a block.
    stages : Stages, optional
        Where solved blocks are kept until the whole is.
    progress : callable, optional
        Called with the number of blocks done and of all, the steps of the whole counted as one.
    """
    spans = _Spans(followed, problem.control_tracks)
    ranges = spans.merged(block_ranges(len(problem), spans.reach, length))
    if len(ranges) == 1:
        solved = solve(problem, followed)
        return solved.poses, solved.tracks
    stages = stages or Stages()
    stages.depend(length)
    sigma = np.zeros(len(followed.image))
    with scratch_folder() as folder:
        gathered = _Gathered(len(problem), BlockStore(folder, heights))
        for number, place in enumerate(ranges):

            def own(place: BlockRange = place) -> _Result:
                part = _part(problem, followed, spans, place)
                return _own(place, part, solve(part.problem, part.followed), spans)

            result = stages.stage(f"block-{number}", _Result, own)
            gathered.add(place, result)
            tracked = result.block.rows < len(sigma)
            sigma[result.block.rows[tracked]] = result.block.sightings.sigma_px[tracked]
            if progress is not None:
                progress(number + 1, len(ranges) + 1)
        poses = join_blocks(problem.images, problem.known_poses, gathered.store, gathered.poses())
    for number in range(len(ranges)):
        stages.drop(f"block-{number}")
    tracks = Tracks(followed.image, followed.point, followed.pixels, sigma)
    if progress is not None:
        progress(len(ranges) + 1, len(ranges) + 1)
    return poses, tracks


class _Gathered:
    """What blocks found, put together."""

    def __init__(self, count: int, store: BlockStore) -> None:
        self.store = store
        self._position = np.zeros((count, 3))
        self._quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        self._seen = np.zeros(count, dtype=np.intp)
        self._bias: list[Array] = []
        self._roughness: list[Array] = []
        self._scale: list[float] = []
        self._focal: list[FocalStretch] = []

    def add(self, place: BlockRange, result: _Result) -> None:
        """Keep a block's own points, and its frames but for the first it shares with the one before."""
        early = (place.end - place.last) // 2 if place.first else 0
        frames = slice(place.first + early, place.end)
        self._position[frames] = result.position[early:]
        self._quaternion[frames] = result.world_from_body[early:].as_quat()
        self._bias.append(result.bias)
        self._roughness.append(result.roughness)
        self._scale.append(result.scale)
        if result.focal is not None:
            self._focal.append(result.focal)
        image = result.block.sightings.image + place.first
        self._seen += np.bincount(image[result.block.used], minlength=len(self._seen))
        self.store.add(place, result.block)

    def poses(self) -> BlockPoses:
        """Where the whole starts from."""
        return BlockPoses(
            self._position,
            Rotation.from_quat(self._quaternion),
            np.mean(self._bias, axis=0),
            self._seen,
            np.mean(self._roughness, axis=0),
            float(np.median(self._scale)),
            self._common_focal(),
        )

    def _common_focal(self) -> FocalStretch | None:
        """The focal length to start from: the blocks' mean, better known ones counting more."""
        if not self._focal:
            return None
        weight = np.array([focal.sigma**-2.0 for focal in self._focal])
        mean = float(weight @ [focal.stretch for focal in self._focal] / weight.sum())
        return replace(self._focal[0], stretch=mean)


def _part(problem: SequenceProblem, followed: Followed, spans: _Spans, place: BlockRange) -> _Part:
    """The frames of a block as a problem of their own."""
    chosen = slice(place.first, place.end)
    near = spans.rows(place)
    inside = (followed.image[near] >= place.first) & (followed.image[near] < place.end)
    rows = near.start + np.flatnonzero(inside)
    names, point = np.unique(followed.point[rows], return_inverse=True)
    before = followed.before[chosen] - place.first
    part = Followed(
        as_index(followed.image[rows] - place.first, "image"),
        as_index(point, "point"),
        frozen(followed.pixels[rows]),
        frozen(followed.sigma_px[rows]),
        np.where(before < 0, -1, before),
        frozen(followed.motion[chosen]),
        followed.windows[chosen],
        frozen(followed.sharpness[chosen]),
        frozen(followed.contrast[chosen]),
        followed.reason[chosen],
    )
    control, tracks, control_rows, control_names = _control_in(problem, place)
    small = replace(
        problem,
        frames=problem.frames[chosen],
        t=problem.t[chosen],
        sources=problem.sources[chosen],
        images=problem.images[chosen],
        known=problem.known[chosen],
        excluded=problem.excluded[chosen],
        channels=problem.channels[chosen] if problem.channels else (),
        control=control,
        control_tracks=tracks,
        start=None if problem.start is None else problem.start[chosen],
    )
    return _Part(
        small,
        part,
        as_index(rows, "rows"),
        as_index(names, "names"),
        as_index(len(followed.image) + control_rows, "rows"),
        as_index(spans.points + control_names, "names"),
    )


def _control_in(
    problem: SequenceProblem, place: BlockRange
) -> tuple[ControlPoints | None, Tracks | None, NDArray[np.intp], NDArray[np.intp]]:
    """Points of control seen in a block's frames, where; their rows and numbers in the whole."""
    control, tracks = problem.control, problem.control_tracks
    none = np.zeros(0, dtype=np.intp)
    if control is None or tracks is None:
        return None, None, none, none
    rows = np.flatnonzero((tracks.image >= place.first) & (tracks.image < place.end))
    if not len(rows):
        return None, None, none, none
    names, point = np.unique(tracks.point[rows], return_inverse=True)
    seen = Tracks(tracks.image[rows] - place.first, point, tracks.pixels[rows], tracks.sigma_px[rows])
    return control.among(names), seen, rows, names


def _own(place: BlockRange, part: _Part, solved: PartSolution, spans: _Spans) -> _Result:
    """What of a part's solution is its block's own: points first seen in its frames."""
    s = solved.sightings
    rows = np.concatenate([part.rows, part.control_rows])
    names = np.concatenate([part.names, part.control_names])
    first = spans.begin(names[s.point])
    kept = (first >= place.first) & (first < place.last)
    point, number = np.unique(s.point[kept], return_inverse=True)
    sightings = _some(s, kept, number)
    control = None if solved.priors is None else solved.priors.control
    poses = solved.poses
    block = SolvedBlock(
        sightings,
        ~poses.rejected[kept],
        poses.points[point],
        as_index(rows[kept], "rows"),
        as_index(names[point], "names"),
        None if control is None else control.among(point),
    )
    return _Result(
        poses.position, poses.world_from_body, poses.bias, poses.roughness, poses.scale, block, poses.focal
    )


def _some(s: Sightings, kept: NDArray[np.bool_], point: NDArray[np.intp]) -> Sightings:
    """Some of the sightings, their points numbered anew."""
    single = len(s.position) == len(s.image) and bool((s.pose == np.arange(len(s.image))).all())
    pose = np.arange(int(kept.sum())) if single else s.pose[kept]
    return replace(
        s,
        image=as_index(s.image[kept], "image"),
        point=as_index(point, "point"),
        pose=as_index(pose, "pose"),
        tangents=frozen(s.tangents[kept]),
        px_per_tangent=frozen(s.px_per_tangent[kept]),
        sigma_px=frozen(s.sigma_px[kept]),
        position=frozen(s.position[kept]) if single else s.position,
        world_from_body=frozen(s.world_from_body[kept]) if single else s.world_from_body,
    )
