"""System S4: poses of all frames of a sequence, from rough tables and what the frames show.

Reads like figure 7 of S4: displacement and yaw of successive frames (750), the subset (720), photogrammetry
on it (730/740), the parameters of all frames (760). Windows followed from frame to frame carry 750 and 760 at
once: all frames are solved together with the points, so that nothing is interpolated that an image tells.

Not here: files (``io/sequence.py``), the cube (``products/``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.control_check import screened
from sightline.applications.frame_sequence import SequenceProblem
from sightline.applications.sequence_blocks import BLOCK_FRAMES, PartSolution, solve_in_blocks
from sightline.applications.sequence_start import approached, begun
from sightline.applications.sequence_warnings import bow_warnings
from sightline.applications.sequence_words import words_of_parts
from sightline.applications.stages import Stages
from sightline.errors import EstimationError, InputError
from sightline.geometry.checks import Array, read_only
from sightline.matching.follow import Followed, FollowPlan, FollowState
from sightline.photogrammetry.cross_links import CrossPlan, joined, link_stretches
from sightline.photogrammetry.frame_poses import FramePoses, adjust_frames
from sightline.photogrammetry.frame_subset import Subset, choose_subset
from sightline.photogrammetry.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.pose_interpolation import by_displacement
from sightline.photogrammetry.reconstruct import (
    Reconstruction,
    RefinedModel,
    filter_pairs,
    looking_down,
    reconstruct,
    refined,
)
from sightline.photogrammetry.rolling_shutter import sight_lines
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, as_index, sight_frames
from sightline.photogrammetry.track_noise import with_drift
from sightline.photogrammetry.wide_links import followed_or_linked

SOLVED, ESTIMATED, INTERPOLATED = "solved", "estimated", "interpolated"
#: Stages, in their order: `SequencePoses.seconds`, progress.
FOLLOWED, CHOSEN, MODELLED = "750 displacement and yaw", "720 subset", "730/740 photogrammetry"
SOLVED_ALL, COMPARED = "760 all poses", "730 stretches compared"
#: Called with a stage, how much of it is done, how much it is.
Progress = Callable[[str, int, int], None]
#: Good sightings from which on a frame's own image tells its pose.
_ENOUGH = 6
#: Rounds in which the noise of the sightings is taken from the residuals of the solution before.
_NOISE_ROUNDS = 1
#: Rounds in which the path within frames is taken from the solution before.
_SHUTTER_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class SequencePoses:
    """What was found of a sequence.

    Attributes
    ----------
    poses : FramePoses
        Of all M frames of the problem.
    source : tuple of str
        Of each: "solved" (of the subset), "estimated", "interpolated" (its image says nothing of it).
    reason : tuple of str
        Why a frame is interpolated; "" otherwise.
    subset : Subset
    followed : Followed
    tracks : Tracks
        All sightings, points of control last.
    stretch : (M,) int
        Frames linked to each other, directly or through others; -1: to none.
    seconds : dict of str to float
        CPU time of each stage.
    warnings : tuple of str
    model : RefinedModel or None
        Of the subset by photogrammetry, where it was made.
    """

    poses: FramePoses
    source: tuple[str, ...]
    reason: tuple[str, ...]
    subset: Subset
    followed: Followed
    tracks: Tracks
    stretch: NDArray[np.intp]
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    model: RefinedModel | None = None


def georeference_sequence(
    problem: SequenceProblem,
    *,
    plan: FollowPlan | None = None,
    stride: int | None = None,
    cross: bool = True,
    photogrammetry: bool | None = None,
    progress: Progress | None = None,
    stages: Stages | None = None,
) -> SequencePoses:
    """Pose and covariance of every frame of a sequence.

    Parameters
    ----------
    problem : SequenceProblem
    plan : FollowPlan, optional
        How windows are followed.
    stride : int, optional
        A subset of every so many frames, for comparison.
    cross : bool
        Look for what stretches of the flight have in common.
    photogrammetry : bool, optional
        Begin with a model of the subset by pycolmap (extra ``sfm``); where no attitude is told, otherwise.
    progress : callable, optional
        Called with a stage's name, how much of it is done, and how much it is.
    stages : Stages, optional
        Finished stages that a run which was stopped has left, and where those of this run are kept.

    Returns
    -------
    SequencePoses

    Raises
    ------
    EstimationError
        If no two frames are alike.
    """
    run = _Run(progress or _nothing, stages or Stages())
    run.stages.depend(problem)
    followed = _followed(problem, plan, run)
    run.note(FOLLOWED)
    run.stages.depend(stride)
    subset = run.stages.stage(
        "subset", Subset,
        lambda: choose_subset(
            followed, problem.images.position, _distances(problem), problem.detector.shape,
            overlap=problem.overlap, stride=stride,
        ),
    )  # fmt: skip
    run.note(CHOSEN)
    if photogrammetry is None:
        photogrammetry = not np.isfinite(problem.known.attitude).any()
    run.stages.depend([photogrammetry, cross])
    problem = begun(problem, followed)
    model = None
    if photogrammetry:
        problem, model = _with_model(problem, followed, subset, run)
        run.note(MODELLED)
    found, tracks = _all_poses(problem, followed, cross, run)
    problem, poses = screened(problem, tracks, found.poses, _without_control(followed, tracks))
    source, reason = _sources(problem, followed, subset, poses)
    return SequencePoses(
        poses, source, reason, subset, followed, tracks, _linked(followed), run.seconds,
        (*_warnings(problem, poses, source), *found.words, *words_of_parts(problem, tracks, poses)),
        model,
    )  # fmt: skip


def _without_control(
    followed: Followed, tracks: Tracks
) -> Callable[[SequenceProblem, FramePoses], FramePoses]:
    """Solves a problem again with fewer control points, which are seen last in `tracks`."""

    def solve(problem: SequenceProblem, before: FramePoses) -> FramePoses:
        own = problem.control_tracks
        rows = slice(0, len(tracks) - (0 if own is None else len(own)))
        plain = Tracks(tracks.image[rows], tracks.point[rows], tracks.pixels[rows], tracks.sigma_px[rows])
        return _Block(problem, followed).solve(plain, before)

    return solve


def _with_model(
    problem: SequenceProblem, followed: Followed, subset: Subset, run: _Run
) -> tuple[SequenceProblem, RefinedModel]:
    """The problem with attitudes where none are told, and the model of the subset they are of."""
    p, images = problem, problem.images
    run.progress(MODELLED, 0, 1)
    model = run.stages.stage(
        "photogrammetry", Reconstruction,
        lambda: reconstruct(
            p.sources, subset.frames,
            filter_pairs(subset.frames, followed, p.detector, images.position, _reach(problem)),
            p.detector, p.mount, images.position, p.known.position, p.radii,
        ),
    )  # fmt: skip
    run.progress(MODELLED, 1, 1)
    heights = HeightPrior(p.surface, p.height_sigma, p.radii) if p.height_sigma > 0.0 else None
    better = refined(model, images, p.known, p.detector, p.mount, heights)
    known = p.known if heights is not None else looking_down(p.known)
    distance = float(np.median([np.linalg.norm(model.points - x, axis=1).min() for x in model.position]))
    place, attitude = by_displacement(
        p.t, model.frames, better.poses.position, better.poses.world_from_body, followed, p.detector, p.mount,
        distance,
    )  # fmt: skip
    own = np.isfinite(p.known.attitude.sum(axis=1))[:, None]
    quat = np.where(own, images.world_from_body.as_quat(), attitude.as_quat())
    told = np.isfinite(p.known.position.sum(axis=1))[:, None]
    images = replace(
        images,
        position=np.where(told, images.position, place),
        world_from_body=Rotation.from_quat(quat),
    )
    start = replace(images, position=place, world_from_body=attitude)
    return replace(p, images=images, known=known, start=start), better


def _reach(problem: SequenceProblem) -> Array:
    """m (M,): the ground that a frame shows lies within this of its place; inf where no place is told."""
    lines, columns = problem.detector.shape
    corner = problem.detector.directions(np.array([[0.0, 0.0], [lines - 1.0, columns - 1.0]]))
    slant = float(np.max(np.linalg.norm(corner[:, :2], axis=1) / corner[:, 2]))
    loose = problem.known.position.max(axis=1)
    return np.asarray(_distances(problem) * slant + 3.0 * loose)


class _Run:
    """Progress, stages kept, and CPU seconds since the last note."""

    def __init__(self, progress: Progress, stages: Stages) -> None:
        self.progress, self.stages = progress, stages
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()

    def note(self, stage: str) -> None:
        """Add the time since the last note to a stage."""
        now = time.process_time()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now


def _nothing(stage: str, done: int, total: int) -> None:
    """Progress that nobody looks at."""


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """What an adjustment of all frames gave."""

    poses: FramePoses
    tracks: Tracks
    words: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Shared:
    """What stretches have in common."""

    tracks: Tracks | None


def _followed(problem: SequenceProblem, plan: FollowPlan | None, run: _Run) -> Followed:
    """Windows followed, from where an earlier run stood."""
    run.stages.depend(plan)
    states: list[FollowState] = []

    def name() -> str:
        return f"follow-{len(states)}"

    def unreachable() -> FollowState:
        raise AssertionError("a stage that is there is not computed")

    if not run.stages.has("follow"):
        while run.stages.has(name()):
            states.append(run.stages.stage(name(), FollowState, unreachable))
    before = tuple(states)

    def keep(state: FollowState) -> None:
        states.append(run.stages.stage(name(), FollowState, lambda: state))

    followed = run.stages.stage(
        "follow", Followed, lambda: follow_sequence(problem, plan, run.progress, keep, before)
    )
    for number in range(len(states)):
        run.stages.drop(f"follow-{number}")
    return followed


def follow_sequence(
    problem: SequenceProblem,
    plan: FollowPlan | None = None,
    progress: Progress | None = None,
    keep: Callable[[FollowState], None] | None = None,
    states: Sequence[FollowState] = (),
) -> Followed:
    """Windows of all usable frames followed (750).

    Parameters
    ----------
    problem : SequenceProblem
    plan : FollowPlan, optional
        Its reduction is the period of the problem's mosaic filter where it has one.
    progress : callable, optional
        Called with "750 displacement and yaw", the number of frames done, and of all.
    keep, states
        As of `follow_windows`.
    """
    plan = FollowPlan() if plan is None else plan
    if problem.mosaic_nm is not None:
        plan = replace(plan, reduction=int(np.lcm(*problem.mosaic_nm.shape)))
    sources = [s if not why else None for s, why in zip(problem.sources, problem.excluded, strict=True)]
    if not any(source is not None for source in sources):
        raise InputError("no frame of the sequence can be used; see why each was excluded")

    def report(done: int) -> None:
        if progress is not None:
            progress(FOLLOWED, done, len(sources))

    return followed_or_linked(
        sources, plan, problem.images.position, problem.known.position,
        progress=report, keep=keep, states=states,
    )  # fmt: skip


def _distances(problem: SequenceProblem) -> Array:
    """m (M,) from each frame to the ground in its middle, by the rough poses."""
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    axis = problem.images.world_from_body.apply(problem.mount.apply(problem.detector.directions(middle))[0])
    ground = problem.surface.intersect(read_only(problem.images.position), read_only(axis))
    far = np.linalg.norm(ground - problem.images.position, axis=1)
    known = np.isfinite(far)
    return np.where(known, far, np.median(far[known]) if known.any() else np.nan)


def _all_poses(
    problem: SequenceProblem, followed: Followed, cross: bool, run: _Run
) -> tuple[_Adjusted, Tracks]:
    """All frames solved together (760), once more with what stretches share; all sightings."""
    block = _Block(problem, followed)
    found = run.stages.stage("poses", _Adjusted, lambda: _adjusted(block, run))
    run.note(SOLVED_ALL)
    group = _linked(followed)
    if cross and len(np.unique(group[group >= 0])) > 1:
        shared = run.stages.stage("cross", _Shared, lambda: _compared(block, found.poses, group, run)).tracks
        run.note(COMPARED)
        if shared is not None:
            first = int(found.tracks.point.max()) + 1
            moved = Tracks(shared.image, shared.point + first, shared.pixels, shared.sigma_px)
            before, words, tracks = found.poses, found.words, joined([found.tracks, moved])
            run.progress(SOLVED_ALL, 0, 1)
            found = run.stages.stage(
                "poses-linked", _Adjusted, lambda: _Adjusted(block.solve(tracks, before), tracks, words)
            )
            run.progress(SOLVED_ALL, 1, 1)
            run.note(SOLVED_ALL)
    return found, block.with_control(found.tracks)


def _adjusted(block: _Block, run: _Run) -> _Adjusted:
    """Frames of each stretch solved, a long flight in blocks."""
    if block.followed.wide:
        return block.approached()
    if len(block.problem) >= 2 * BLOCK_FRAMES:
        heights = block.heights()

        def report(done: int, total: int) -> None:
            run.progress(SOLVED_ALL, done, total)

        poses, tracks = solve_in_blocks(
            block.problem, block.followed, block.part, heights,
            length=BLOCK_FRAMES, stages=run.stages, progress=report,
        )  # fmt: skip
        return _Adjusted(poses, tracks)
    rounds = block.rounds()

    def count(done: int) -> None:
        run.progress(SOLVED_ALL, done, rounds)

    solved = block.part(block.problem, block.followed, count)
    return _Adjusted(solved.poses, solved.tracks)


def _compared(block: _Block, poses: FramePoses, group: NDArray[np.intp], run: _Run) -> _Shared:
    """Stretches compared with each other."""
    p = block.problem

    def report(done: int, total: int) -> None:
        run.progress(COMPARED, done, total)

    return _Shared(
        link_stretches(
            p.sources, _estimated(p.images, poses), p.detector, p.mount, p.surface, group,
            block.cross_plan(poses), report,
        )
    )  # fmt: skip


class _Block:
    """The sightings of a problem, solved again and again."""

    def __init__(self, problem: SequenceProblem, followed: Followed) -> None:
        self.problem, self.followed = problem, followed
        self.per_frame = float(max(np.median(followed.windows[followed.windows > 0]), 1.0))

    def with_control(self, tracks: Tracks) -> Tracks:
        """The same tracks and those of points of control, which are numbered after the others."""
        own = self.problem.control_tracks
        if own is None or self.problem.control is None:
            return tracks
        first = int(tracks.point.max()) + 1
        return joined([tracks, Tracks(own.image, own.point + first, own.pixels, own.sigma_px)])

    def _priors(self, tracks: Tracks) -> PointPriors | None:
        """What is known of the points: a surface, points of control."""
        p = self.problem
        heights, control = self.heights(), None
        if p.control is not None and p.control_tracks is not None:
            first = int(tracks.point.max()) + 1
            control = ControlPoints(
                as_index(p.control.point + first, "point"), p.control.position, p.control.sigma
            )
        return None if heights is None and control is None else PointPriors(heights, control)

    def heights(self) -> HeightPrior | None:
        """What is known of the heights of all points."""
        p = self.problem
        if not p.height_sigma > 0.0:
            return None
        # a surface is wrong over a whole frame alike: all points in it together tell its height once
        return HeightPrior(p.surface, p.height_sigma * np.sqrt(self.per_frame), p.radii)

    def rounds(self) -> int:
        """How many times a part is solved."""
        return 1 + (_SHUTTER_ROUNDS if self.problem.readout_time != 0.0 else _NOISE_ROUNDS)

    def part(
        self, problem: SequenceProblem, followed: Followed, progress: Callable[[int], None] | None = None
    ) -> PartSolution:
        """Frames in a row solved, with the noise of their sightings and with the path within frames."""
        own = copy(self)
        own.problem, own.followed = problem, followed
        tracks = Tracks(followed.image, followed.point, followed.pixels, followed.sigma_px)
        poses = own.solve(tracks, None)
        for number in range(1, self.rounds()):
            if progress is not None:
                progress(number)
            if number <= _NOISE_ROUNDS:
                good = ~poses.rejected[: len(tracks)]
                tracks = with_drift(tracks, poses.residual_px[: len(tracks)], good)
            poses = own.solve(tracks, poses)
        if progress is not None:
            progress(self.rounds())
        sightings, priors, _ = own.equations(tracks, poses)
        return PartSolution(tracks, sightings, priors, poses)

    def approached(self) -> _Adjusted:
        """Few frames far apart solved, in rounds in which sightings count for more and more."""
        tracks = Tracks(*(getattr(self.followed, n) for n in ("image", "point", "pixels", "sigma_px")))
        tracks, poses, words = approached(self.solve, tracks, max(self.problem.detector.shape))
        for _ in range(0 if words else _NOISE_ROUNDS):
            finer = with_drift(tracks, poses.residual_px[: len(tracks)], ~poses.rejected[: len(tracks)])
            try:
                poses, tracks = self.solve(finer, poses), finer
            except EstimationError:
                words = ["the frames' geometry is weak: sightings count as good as their matches say of them"]
        return _Adjusted(poses, tracks, tuple(words))

    def solve(self, tracks: Tracks, before: FramePoses | None) -> FramePoses:
        """Poses of all frames; `before` tells where points are, and how frames moved while read out."""
        p = self.problem
        sightings, priors, points = self.equations(tracks, before)
        start = p.start if before is None else before
        return adjust_frames(p.images, sightings, p.known, priors=priors, points=points, start=start)

    def equations(
        self, tracks: Tracks, before: FramePoses | None
    ) -> tuple[Sightings, PointPriors | None, Array]:
        """Sightings, what is known of points, and where they are (n, 3) m."""
        p = self.problem
        priors = self._priors(tracks)
        tracks = self.with_control(tracks)
        shutter = p.readout_time != 0.0
        if shutter and before is None:
            still = first_line_pixels(tracks, self.followed, p.t, p.readout_time, p.detector.shape)
            tracks = Tracks(tracks.image, tracks.point, still, tracks.sigma_px)
        sightings = sight_frames(p.images, [p.detector], [p.mount], tracks)
        near = sightings if p.start is None else sight_frames(p.start, [p.detector], [p.mount], tracks)
        points = _on_surface(near, p)
        if before is not None:
            known = len(before.points)
            points[:known] = np.where(np.isfinite(before.points), before.points, points[:known])[
                : len(points)
            ]
            if shutter:
                delay = p.readout_time * tracks.pixels[:, 0] / (p.detector.shape[0] - 1.0)
                sightings = sight_lines(sightings, p.images, _estimated(p.images, before), delay)
        return sightings, priors, points

    def cross_plan(self, poses: FramePoses) -> CrossPlan:
        """How far to look for what stretches share."""
        sigma = np.sqrt(np.einsum("kii->ki", poses.covariance))
        found = np.isfinite(poses.points).all(axis=1)
        heights = poses.points[found]
        prior = HeightPrior(self.problem.surface, 1.0, self.problem.radii)
        above = np.abs(prior.above(heights)[0])
        far = float(np.median(_distances(self.problem)))
        # biases of the tables are the same for all stretches, up to where the flight turns
        loose = float(np.median(np.hypot(sigma[:, 3:].max(axis=1), sigma[:, :3].max(axis=1) / far)))
        return CrossPlan(float(np.nanquantile(above, 0.99)), min(loose, 0.05))


def poses_of_windows(problem: SequenceProblem, followed: Followed) -> tuple[FramePoses, Tracks]:
    """Poses of all frames from windows that were followed (760), and their sightings; no image is read.

    Parameters
    ----------
    problem : SequenceProblem
    followed : Followed
    """
    found, tracks = _all_poses(problem, followed, False, _Run(_nothing, Stages()))
    return found.poses, tracks


def first_line_pixels(
    tracks: Tracks, followed: Followed, t: Array, readout_time: float, shape: tuple[int, int]
) -> Array:
    """Pixels (N, 2) where points would be if all lines were exposed with the first, by how frames move.

    Relief apart, whose share of the motion within a frame is not known yet.
    """
    rate = np.zeros((len(t), 4))
    weight = np.zeros(len(t))
    for k in np.flatnonzero(followed.before >= 0):
        each = followed.motion[k] / (t[k] - t[followed.before[k]])
        for frame in (int(k), int(followed.before[k])):
            rate[frame] += each
            weight[frame] += 1.0
    rate /= np.maximum(weight, 1.0)[:, None]
    delay = readout_time * tracks.pixels[:, 0] / (shape[0] - 1.0)
    moved = rate[tracks.image] * delay[:, None]
    x = tracks.pixels - 0.5 * (np.array(shape) - 1.0)
    turn, growth = moved[:, 2], moved[:, 3]
    shift = moved[:, :2] + np.stack(
        [growth * x[:, 0] - turn * x[:, 1], turn * x[:, 0] + growth * x[:, 1]], axis=1
    )
    return np.asarray(tracks.pixels - shift)


def _on_surface(sightings: Sightings, problem: SequenceProblem) -> Array:
    """Points (n, 3) m: where rough rays meet the surface, mean over sightings; NaN where they do not."""
    rays = np.column_stack([sightings.tangents, np.ones(len(sightings))])
    turned = np.einsum("nij,nj->ni", sightings.world_from_body[sightings.pose], problem.mount.apply(rays))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    met = problem.surface.intersect(read_only(sightings.position[sightings.pose]), read_only(turned))
    good = np.isfinite(met).all(axis=1)
    count = np.bincount(sightings.point, good, minlength=sightings.points)
    sums = [
        np.bincount(sightings.point, np.where(good, met[:, axis], 0.0), minlength=sightings.points)
        for axis in range(3)
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack(sums, axis=1) / count[:, None]


def _estimated(images: Images, poses: FramePoses) -> Images:
    """Images with the poses found."""
    return replace(images, position=poses.position, world_from_body=poses.world_from_body)


def _linked(followed: Followed) -> NDArray[np.intp]:
    """Stretch (M,) of each frame; -1 where it stands alone."""
    out = np.full(len(followed.before), -1, dtype=np.intp)
    count = 0
    for k, before in enumerate(followed.before):
        if before < 0:
            continue
        if out[before] < 0:
            out[before] = count
            count += 1
        out[k] = out[before]
    return out


def _sources(
    problem: SequenceProblem, followed: Followed, subset: Subset, poses: FramePoses
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """How each frame's pose came about, and why its image told nothing of it."""
    chosen = set(subset.frames.tolist())
    source, reason = [], []
    for k in range(len(problem)):
        if poses.sightings[k] >= _ENOUGH:
            source.append(SOLVED if k in chosen else ESTIMATED)
            reason.append("")
            continue
        source.append(INTERPOLATED)
        why = problem.excluded[k] or followed.reason[k]
        reason.append(why or f"{int(poses.sightings[k])} of {int(followed.windows[k])} windows are good")
    return tuple(source), tuple(reason)


def _warnings(problem: SequenceProblem, poses: FramePoses, source: tuple[str, ...]) -> list[str]:
    """What a user should know."""
    out = list(problem.warnings)
    idle = source.count(INTERPOLATED)
    if idle:
        out.append(f"{idle} of {len(source)} frames are interpolated: their images tell nothing of them")
    return out + bow_warnings(problem, poses)
