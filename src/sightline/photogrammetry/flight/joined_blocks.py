"""Poses of a long flight: blocks of frames, each solved by itself, brought together in one exact solution.

Blocks overlap by as many frames as a point is followed for, so that each point belongs to one block whole.
What they give is near the solution of the whole flight but for what tables alone say over longer stretches.
Steps of the whole are then taken from there: equations are made block by block, frames eliminated in their
order, points with their blocks. Memory is that of one block and a few numbers per frame.

Not here: the solution of a block (``poses.py``), elimination (``estimation/banded_blocks.py``).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.estimation.banded_blocks import BlockwiseFactor
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.block.descent import DIVERGED, BlockSums, DivergedError, State
from sightline.photogrammetry.block.observability import observability
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.block.reduced import PointsEliminated, gather
from sightline.photogrammetry.flight.focal import FocalStretch, common_errors, globals_of
from sightline.photogrammetry.flight.path import scale_form, trend_forms
from sightline.photogrammetry.flight.poses import (
    POSE_ORDER,
    FramePoses,
    RoughPoses,
    bias_rows,
    frame_unknowns,
    from_poses,
    held_at,
    moved_images,
)
from sightline.photogrammetry.sightings import Images, Index, Sightings, as_index

#: Steps end when the next promises to lower the cost by less: a thirtieth of a sigma, in one direction.
_CONVERGED = 1e-3
#: Steps of the whole flight, at most.
_STEPS = 8
#: Frames over which the path's smoothness ties each frame to earlier ones.
_TIED = 2
#: Share by which the cost may rise: turns are added as if they commuted, anew at each step.
_RISE = 1e-3


@dataclass(frozen=True)
class BlockRange:
    """Frames of a block: its own from `first` to `last` (not counted), its points reach to `end`."""

    first: int
    last: int
    end: int


@dataclass(frozen=True, eq=False)
class SolvedBlock(ReadOnlyArrays):
    """A block as it was solved by itself.

    Attributes
    ----------
    sightings : Sightings
        Of the frames from the block's first, by the poses of the tables, of its own points only.
    used : (N,) bool
        Good ones.
    points : (n, 3)
        m, where they were found; NaN where they were not.
    rows, names : (N,), (n,) int
        Of the whole flight's sightings and points.
    control : ControlPoints or None
        By the block's own numbers.
    """

    sightings: Sightings
    used: NDArray[np.bool_]
    points: Array
    rows: Index
    names: Index
    control: ControlPoints | None = None


@dataclass(frozen=True, eq=False)
class BlockPoses:
    """Poses of all frames as their blocks have them: where the whole starts from.

    Attributes
    ----------
    position : (M, 3)
        m, world axes.
    world_from_body : Rotation
        M.
    bias : (6,)
        As of `FramePoses`.
    sightings : (M,) int
        Good ones of each frame.
    roughness : (6,)
        Of the path within blocks, as of `FramePoses`.
    scale : float
        Robust size of residuals over the stated one.
    focal : FocalStretch or None
        As of `FramePoses`; only its value counts.
    """

    position: Array
    world_from_body: Rotation
    bias: Array
    sightings: NDArray[np.intp]
    roughness: Array
    scale: float
    focal: FocalStretch | None = None


def block_ranges(frames: int, reach: int, length: int) -> list[BlockRange]:
    """Blocks of about `length` frames, overlapping by `reach`, which no block is shorter than.

    Parameters
    ----------
    frames : int
        M
    reach : int
        Frames from the first to the last sighting of a point, at most.
    length : int
    """
    reach = max(reach, _TIED)
    count = max(1, round(frames / max(length, reach + 1)))
    ends = np.linspace(0, frames, count + 1).round().astype(int)
    return [
        BlockRange(int(first), int(last), int(min(last + reach, frames)))
        for first, last in itertools.pairwise(ends)
    ]


class BlockStore:
    """Solved blocks on disk, one of which is read at a time."""

    def __init__(self, folder: Path, heights: HeightPrior | None) -> None:
        self.folder, self.heights = folder, heights
        self.ranges: list[BlockRange] = []
        self._control: list[ControlPoints | None] = []
        self.sightings = self.points = 0

    def __len__(self) -> int:
        """Number of blocks."""
        return len(self.ranges)

    def add(self, place: BlockRange, block: SolvedBlock) -> None:
        """Keep a block, the next in order."""
        arrays: dict[str, Any] = {f.name: getattr(block.sightings, f.name) for f in fields(Sightings)}
        own: dict[str, Any] = {"used": block.used, "rows": block.rows, "names": block.names}
        number = len(self.ranges)
        np.savez(self.folder / f"block-{number}.npz", **arrays, **own)
        self.ranges.append(place)
        self._control.append(block.control)
        self.move(number, block.points)
        self.sightings += len(block.rows)
        self.points = max(self.points, int(block.names.max(initial=-1)) + 1)

    def move(self, number: int, points: Array) -> None:
        """Note new places (n, 3) of a block's points."""
        np.save(self.folder / f"points-{number}.npy", points)

    def read(self, number: int) -> SolvedBlock:
        """A block."""
        with np.load(self.folder / f"block-{number}.npz") as held:
            arrays = {name: held[name] for name in held.files}
        for value in arrays.values():
            value.setflags(write=False)
        sightings = Sightings(**{f.name: arrays[f.name] for f in fields(Sightings)})
        points = np.load(self.folder / f"points-{number}.npy")
        return SolvedBlock(
            sightings, arrays["used"], points, arrays["rows"], arrays["names"], self._control[number]
        )


@dataclass(eq=False)
class _Equations:
    """One block of the whole flight's equations, at the present poses."""

    block: BlockSums
    state: State
    used: NDArray[np.bool_]
    left: PointsEliminated
    gradient: tuple[Array, Array, Array, Array, float]
    content: SolvedBlock


@dataclass(frozen=True, eq=False)
class _Forward:
    """What is left once all frames are eliminated."""

    factor: BlockwiseFactor
    information: Array  # (G, G)
    right: Array  # (G,)
    forms: Array  # (G, 3 S + 1): of those whose variances are the bow's and the scale's
    cost: float
    decrease: float  # promised by frames and points, the globals held


class _Whole:
    """The whole flight, stepped."""

    def __init__(self, images: Images, known: RoughPoses, store: BlockStore, start: BlockPoses) -> None:
        self.images, self.known, self.store = images, known, store
        turn = (images.world_from_body.inv() * start.world_from_body).as_rotvec()
        self.moved = np.concatenate([turn, start.position - images.position], axis=1)
        self.common = globals_of(start.bias, bias_rows(known), start.focal, known.focal_length)
        self.reach = max(r.end - r.last for r in store.ranges) if len(store) > 1 else len(images) - 1
        self.roughness = start.roughness
        self.unknowns = self._unknowns()

    def _unknowns(self) -> PoseUnknowns:
        return frame_unknowns(self.images, self.known, self.roughness, None, self.moved)

    def equations(self, number: int) -> _Equations:
        """Those of one block, the priors of its own frames among them."""
        place, content = self.store.ranges[number], self.store.read(number)
        unknowns = _part(self.unknowns, place)
        frames = slice(place.first, place.end)
        heights = self.store.heights
        priors = PointPriors.of(heights, content.control)
        block = BlockSums(from_poses(content.sightings, self.moved[frames]), unknowns, priors)
        found = np.isfinite(content.points).all(axis=1, keepdims=True)
        points = np.where(found, content.points, block.origin) - block.origin
        state = State(self.common, held_at(unknowns, self.common), points)
        weight = content.used.astype(np.float64)
        curvature, _ = block.curvature(state, weight)
        left = PointsEliminated(curvature, unknowns)
        return _Equations(block, state, content.used, left, block.gradient(state, weight), content)

    def forward(self) -> _Forward:
        """Equations eliminated, and what they say of the globals."""
        b = 6 * (self.reach + 1) - 1
        globals_ = self.unknowns.globals
        width, place_now = self.unknowns.width, self.images.position + self.moved[:, 3:]
        forms = np.concatenate([trend_forms(self.images.t, width), scale_form(place_now, width)], axis=2)
        factor = BlockwiseFactor(self.store.folder, b, globals_ + 1 + forms.shape[2])
        own_forms, common_forms = gather(self.unknowns, forms)
        information = np.diag(self.unknowns.global_information)
        pull = -self.unknowns.global_information * self.common
        cost, alone = float(-pull @ self.common) + self.unknowns.rest, 0.0
        for number, place in enumerate(self.store.ranges):
            e = self.equations(number)
            band, border, corner = e.left.assembled()
            own, by_point, common, _, more = e.gradient
            alone += float((by_point * e.left.points(by_point, np.zeros_like(own), 0.0 * common)).sum())
            own, common = e.left.eliminate(own, by_point, common)
            information, pull, cost = information + corner, pull + common, cost + more
            sides = np.concatenate([border, own[:, :, None], own_forms[place.first : place.end]], axis=2)
            # what lies beyond a block's own frames is the next one's
            sides[place.last - place.first :, :, globals_ + 1 :] = 0.0
            full = np.zeros((b + 1, band.shape[1]))
            full[: len(band)] = band
            factor.eliminate(full, sides.reshape(-1, sides.shape[2]), 6 * (place.last - place.first))
        information -= factor.gram[:globals_, :globals_]
        right = np.concatenate([pull[:, None], common_forms], axis=1) - factor.gram[:globals_, globals_:]
        alone += float(factor.gram[globals_, globals_])
        return _Forward(factor, information, right[:, 0], right[:, 1:], cost, alone)

    def take(self, factor: BlockwiseFactor, step: Array) -> None:
        """Move frames and points by the step that goes with a step (G,) of the globals."""
        combine = np.zeros((len(factor.gram), 1))
        combine[: len(step), 0] = -step
        combine[len(step), 0] = 1.0
        x = np.zeros((len(self.images), 6))
        for number, solution, _ in factor.backward(combine):
            place = self.store.ranges[number]
            x[place.first : place.last] = solution.reshape(-1, 6)
            e = self.equations(number)
            moved = e.left.points(e.gradient[1], x[place.first : place.end], step)
            self.store.move(number, e.state.points + moved + e.block.origin)
        own = x + held_at(self.unknowns, self.common)
        self.common = self.common + step
        change = self.unknowns.departures(own, self.common)
        turned = Rotation.from_rotvec(self.moved[:, :3]) * Rotation.from_rotvec(change[:, :3])
        self.moved = np.concatenate([turned.as_rotvec(), self.moved[:, 3:] + change[:, 3:6]], axis=1)
        self.unknowns = self._unknowns()

    def covariance(self, factor: BlockwiseFactor, of_globals: Array) -> tuple[Array, Array]:
        """Of the departures (turn, move, stretch where it is sought) of all frames.

        (M, D, D) of each with itself, (M - 1, D, D) of each but the first with the one before it.
        """
        u = self.unknowns
        combine = np.eye(len(factor.gram))[:, : u.globals]
        inner, later = np.zeros((2, len(self.images), 6, 6))
        common = np.zeros(u.by_global.shape)
        for number, bridge, inverse in factor.backward(combine, 11):
            place = self.store.ranges[number]
            frames, count = slice(place.first, place.last), place.last - place.first
            for a in range(6):
                for b in range(6):
                    later[frames, a, b] = inverse[6 + a - b, b::6]
                    if b <= a:
                        inner[frames, a, b] = inner[frames, b, a] = inverse[a - b, b::6]
            common[frames] = u.by_global[frames] - u.by_shot[frames] @ bridge.reshape(count, 6, -1)
        back = np.swapaxes(common, 1, 2)
        own = u.by_shot @ inner @ np.swapaxes(u.by_shot, 1, 2) + common @ of_globals @ back
        following = u.by_shot[1:] @ later[:-1] @ np.swapaxes(u.by_shot[:-1], 1, 2)
        return own, following + common[1:] @ of_globals @ back[:-1]


def _part(unknowns: PoseUnknowns, place: BlockRange) -> PoseUnknowns:
    """Unknowns of a block's frames; what ties a frame to later ones is in the block whose own it is."""
    frames = slice(place.first, place.end)
    tied, pulled = unknowns.precision, unknowns.pull
    # frames are tied to their neighbours
    assert tied is not None
    assert pulled is not None
    precision, pull = np.array(tied[frames]), np.array(pulled[frames])
    own = place.last - place.first
    pull[own:] = 0.0
    for step in range(precision.shape[1]):
        # rows of frame k, columns of frame k - step
        column = np.arange(len(precision)) - step
        precision[(column < 0) | (column >= own), step] = 0.0
    count = place.end - place.first
    return replace(
        unknowns,
        shot=as_index(np.arange(count), "shot"),
        slot=as_index(np.zeros(count), "slot"),
        by_shot=frozen(unknowns.by_shot[frames]),
        by_global=frozen(unknowns.by_global[frames]),
        global_information=frozen(np.zeros(unknowns.globals)),
        precision=frozen(precision),
        pull=frozen(pull),
        rest=0.0,
    )


def join_blocks(
    images: Images,
    known: RoughPoses,
    store: BlockStore,
    start: BlockPoses,
    *,
    progress: Callable[[int], None] | None = None,
) -> FramePoses:
    """Poses of a whole flight from its blocks.

    Parameters
    ----------
    images : Images
        Rough poses of all M frames, in order of time.
    known : RoughPoses
    store : BlockStore
        All blocks, solved; their points are moved.
    start : BlockPoses
    progress : callable, optional
        Called with the number of steps taken.

    Returns
    -------
    FramePoses
        Those of one adjustment of all sightings that count in the blocks.

    Raises
    ------
    EstimationError
        If steps do not end.
    """
    whole, last = _Whole(images, known, store, start), np.inf
    for steps in range(_STEPS):
        found = whole.forward()
        if found.cost > last * (1.0 + _RISE):
            break
        equations = observability(found.information, whole.unknowns.names, np.inf)
        step = equations.solve(found.right)
        if found.decrease + float(found.right @ step) < _CONVERGED:
            return _poses(whole, found, equations.covariance(), start)
        whole.take(found.factor, step)
        last = found.cost
        if progress is not None:
            progress(steps + 1)
    raise DivergedError(DIVERGED)


def _poses(whole: _Whole, found: _Forward, of_globals: Array, start: BlockPoses) -> FramePoses:
    """The solution as poses with covariance."""
    factor, forms = found.factor, found.forms
    covariance, following = (c[:, POSE_ORDER][:, :, POSE_ORDER] for c in whole.covariance(factor, of_globals))
    bias, bias_covariance, focal = common_errors(
        whole.common, of_globals, bias_rows(whole.known), whole.known.focal_length
    )
    variance = np.diag(factor.gram)[len(forms) + 1 :] + np.einsum("gk,gh,hk->k", forms, of_globals, forms)
    sigma = np.sqrt(variance)
    points = np.full((whole.store.points, 3), np.nan)
    residual, rejected = np.zeros((whole.store.sightings, 2)), np.ones(whole.store.sightings, dtype=bool)
    for at, names, places, left, used in _solved_blocks(whole):
        points[names], residual[at], rejected[at] = places, left, ~used
    final = moved_images(whole.images, whole.moved)
    return FramePoses(
        final.position,
        final.world_from_body,
        frozen(covariance),
        bias,
        bias_covariance,
        frozen(points),
        frozen(residual),
        rejected,
        start.sightings,
        frozen(whole.roughness),
        start.scale,
        frozen(sigma[:-1].reshape(-1, 3)),
        float(sigma[-1]),
        frozen(following),
        None,
        focal,
    )


def _solved_blocks(whole: _Whole) -> Iterator[tuple[Index, Index, Array, Array, NDArray[np.bool_]]]:
    """Of each block: rows and names of the whole flight, points, residuals (px), which count."""
    for number in range(len(whole.store)):
        e = whole.equations(number)
        left = e.gradient[3] * e.content.sightings.sigma_px[:, None]
        kept = np.bincount(e.content.sightings.point, e.used, minlength=len(e.content.points)) > 0
        places = np.where(kept[:, None], e.content.points, np.nan)
        yield e.content.rows, e.content.names, places, left, e.used
