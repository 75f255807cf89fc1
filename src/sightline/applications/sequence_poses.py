"""System S4: poses of all frames of a sequence, from rough tables and what the frames show.

Reads like figure 7 of S4: displacement and yaw of successive frames (750), the subset (720), photogrammetry
on it (730/740), the parameters of all frames (760). Windows followed from frame to frame carry 750 and 760 at
once: all frames are solved together with the points, so that nothing is interpolated where an image shows it.

Not here: files (``io/sequence/load.py``), the cube (``products/``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, InputError, computes
from sightline.execution import CpuClock, machine_memory, one_blas_thread, silent
from sightline.geometry.checks import Array
from sightline.matching.follow import Followed, FollowPlan, FollowState, check_followable
from sightline.photogrammetry.block.descent import DivergedError
from sightline.photogrammetry.block.point_priors import HeightPrior
from sightline.photogrammetry.flight.blocks import BLOCK_FRAMES, solve_in_blocks
from sightline.photogrammetry.flight.control_check import screened
from sightline.photogrammetry.flight.cross_links import link_stretches
from sightline.photogrammetry.flight.found_ground import ground_warnings
from sightline.photogrammetry.flight.interpolation import by_displacement
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.reconstruct import (
    FrameModel,
    RefinedModel,
    check_modelling,
    check_positions,
    filter_pairs,
    looking_down,
    reconstruct,
    refined,
)
from sightline.photogrammetry.flight.rig_solver import (
    RigAdjusted,
    check_rig,
    first_camera,
    solve_capture,
    solve_rig,
)
from sightline.photogrammetry.flight.rolling_shutter import first_line_pixels
from sightline.photogrammetry.flight.solver import (
    Adjusted,
    SequenceSolver,
    estimated_images,
    ground_distances,
)
from sightline.photogrammetry.flight.solving_order import solving_order
from sightline.photogrammetry.flight.start import begun
from sightline.photogrammetry.flight.subset import Subset, choose_subset
from sightline.photogrammetry.flight.table_check import (
    misfits,
    motion_warnings,
    refuse_apart,
    refuse_contradicted,
    unsolved_words,
)
from sightline.photogrammetry.flight.warnings import (
    bow_warnings,
    focal_warnings,
    part_warnings,
    refuse_unobservable_focal,
    short_warnings,
)
from sightline.photogrammetry.flight.wide_links import followed_or_linked
from sightline.photogrammetry.sightings import Tracks, appended
from sightline.result import Result, makes_result
from sightline.stages import Stages

SOLVED, ESTIMATED, INTERPOLATED = "solved", "estimated", "interpolated"
#: Stages, in their order: `SequencePoses.seconds`, progress.
FOLLOWED, CHOSEN, MODELLED = "frames followed", "subset chosen", "subset modelled"
SOLVED_ALL, COMPARED, RIG = "all poses", "stretches compared", "cameras of the rig"
#: Called with a stage, how much of it is done, how much it is.
Progress = Callable[[str, int, int], None]
#: Share of the machine's memory that a solution of all frames at once may take.
_SHARE = 0.6
#: Good sightings from which on a frame's own image gives its pose.
_ENOUGH = 6


@dataclass(frozen=True, eq=False, repr=False)
class SequencePoses(Result):
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
        CPU time of each stage, with that of earlier runs whose results were taken over.
    warnings : tuple of str
    model : RefinedModel or None
        Of the subset by photogrammetry, where it was made.
    taken_over : dict of str to float
        How many of the `seconds` are of earlier runs, by stage; without stages that are all of this one.
    rig : RigAdjusted or None
        Of several cameras: their offsets, and all sightings; `tracks` has those of the first camera.
    problem : SequenceProblem or None
        As it was solved: frames turned as their images show, attitudes of the subset's model where none are
        given.
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
    taken_over: dict[str, float] = field(default_factory=dict)
    problem: SequenceProblem | None = None
    rig: RigAdjusted | None = None


def check_flight(
    problem: SequenceProblem, plan: FollowPlan | None = None, *, photogrammetry: bool | None = None
) -> None:
    """What `georeference_sequence` refuses before an image is looked at; parameters as there.

    Parameters
    ----------
    problem : SequenceProblem
    plan : FollowPlan, optional
    photogrammetry : bool, optional

    Raises
    ------
    InputError
        Fewer than two frames can be used, or they are too small; neither attitudes nor three positions are
        given.
    EstimationError
        By the tables successive frames show places far from one another.
    """
    usable = int(problem.usable.sum())
    if problem.rig:
        check_rig(problem)
        if len(problem) == 1:
            return
    if not usable:
        raise InputError("no frame of the sequence can be used; see why each was excluded")
    if usable == 1:
        raise InputError(
            f"1 of {len(problem)} frames can be used: poses come from what frames share; give two or more "
            "that overlap"
        )
    if problem.readout_sigma > 0.0 and len(problem) >= 2 * BLOCK_FRAMES:
        raise InputError(
            f"readout_time_sigma: the readout time is sought of up to {2 * BLOCK_FRAMES - 1} frames at once, "
            f"got {len(problem)}: find it with a part of the flight, and give it"
        )
    check_followable(problem.detector.shape, follow_plan(problem, plan))
    refuse_apart(problem)
    if photogrammetry or (photogrammetry is None and not np.isfinite(problem.known.attitude).any()):
        check_positions(problem.known.along_world())


def follow_plan(problem: SequenceProblem, plan: FollowPlan | None = None) -> FollowPlan:
    """How windows are followed: a mosaic filter is averaged over its period first."""
    plan = FollowPlan() if plan is None else plan
    return plan if problem.mosaic_nm is None else replace(plan, reduction=problem.filter_period)


@makes_result
@one_blas_thread
@computes("poses of the frames")
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
        Begin with a model of the subset by pycolmap (extra ``sfm``); by default where no attitude is given.
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
    run = _Run(progress or silent, stages or Stages())
    check_flight(problem, plan, photogrammetry=photogrammetry)
    if problem.rig and len(problem) == 1:
        run.stages.depend(problem)
        return _one_capture(problem, run)
    if photogrammetry is None:
        photogrammetry = not np.isfinite(problem.known.attitude).any()
    if photogrammetry:
        check_modelling(problem.known.along_world())
    run.stages.depend(problem)
    followed = _followed(problem, plan, run)
    run.note(FOLLOWED)
    run.stages.depend(stride)
    subset = run.stages.stage(
        "subset", Subset,
        lambda: choose_subset(
            followed, problem.images.position, ground_distances(problem), problem.detector.shape,
            overlap=problem.overlap, stride=stride,
        ),
    )  # fmt: skip
    run.note(CHOSEN)
    run.stages.depend([photogrammetry, cross])
    given = problem = begun(problem, followed)
    model = None
    try:
        if photogrammetry:
            problem, model = _with_model(problem, followed, subset, run)
            run.note(MODELLED)
        problem, found, tracks = _solved(problem, followed, cross, run)
    except DivergedError as error:
        raise EstimationError(unsolved_words(given)) from error
    problem, poses = screened(problem, tracks, found.poses, _without_control(followed, tracks))
    rig = _with_rig(problem, followed, poses, tracks, run) if problem.rig else None
    poses = poses if rig is None else first_camera(rig, len(tracks))
    refuse_contradicted(problem, poses, () if rig is None else rig.words)
    source, reason = _sources(problem, followed, subset, poses)
    words = (
        *_warnings(problem, poses, source, followed),
        *short_warnings(subset),
        *found.words,
        *part_warnings(problem, tracks, poses),
        *(() if rig is None else rig.words),
    )
    return SequencePoses(
        poses, source, reason, subset, followed, tracks, followed.linked(), run.seconds, words, model,
        run.taken_over, problem, rig,
    )  # fmt: skip


def _with_rig(
    problem: SequenceProblem, followed: Followed, poses: FramePoses, tracks: Tracks, run: _Run
) -> RigAdjusted:
    """All cameras of a rig together, from a solution of the first."""

    def report(done: int, total: int) -> None:
        run.progress(RIG, done, total)

    found = run.stages.stage("rig", RigAdjusted, lambda: solve_rig(problem, followed, poses, tracks, report))
    run.note(RIG)
    return found


def _one_capture(problem: SequenceProblem, run: _Run) -> SequencePoses:
    """One capture of a rig: offsets of its cameras; the pose is that of its tables."""
    run.progress(RIG, 0, 1)
    rig = run.stages.stage("rig", RigAdjusted, lambda: solve_capture(problem))
    run.progress(RIG, 1, 1)
    run.note(RIG)
    own = rig.tracks[rig.tracks.image == 0]
    followed = Followed(
        own.image, own.point, own.pixels, own.sigma_px, np.array([-1]), np.full((1, 4), np.nan),
        np.array([len(own)]), np.full(1, np.nan), np.full(1, np.nan), ("",),
    )  # fmt: skip
    subset = Subset(np.zeros(1, dtype=np.intp), np.full(1, np.nan), np.full(1, np.nan), ("the only capture",))
    words = (
        *problem.warnings,
        "one capture: its pose is that of its tables; found are the offsets of the cameras, whose lever arms "
        "and angles go together over ground of one height",
        *rig.words,
    )
    return SequencePoses(
        first_camera(rig, len(own)), (SOLVED,), ("",), subset, followed, own, np.zeros(1, dtype=np.intp),
        run.seconds, words, None, run.taken_over, problem, rig,
    )  # fmt: skip


def _without_control(
    followed: Followed, tracks: Tracks
) -> Callable[[SequenceProblem, FramePoses], FramePoses]:
    """Solves a problem again with fewer control points, which are seen last in `tracks`."""

    def solve(problem: SequenceProblem, before: FramePoses) -> FramePoses:
        own = problem.control_tracks
        plain = np.arange(len(tracks) - (0 if own is None else len(own)))
        return SequenceSolver(problem, followed).solve(tracks[plain], before)

    return solve


def _with_model(
    problem: SequenceProblem, followed: Followed, subset: Subset, run: _Run
) -> tuple[SequenceProblem, RefinedModel]:
    """The problem with attitudes where none are given, and the model of the subset they are of."""
    p, images = problem, problem.images
    still = partial(
        first_line_pixels,
        followed=followed, t=p.t, readout_time=p.readout_time, shape=p.detector.shape,
    )  # fmt: skip
    run.progress(MODELLED, 0, 1)
    model = run.stages.stage(
        "photogrammetry", FrameModel,
        lambda: reconstruct(
            p.sources, subset.frames,
            filter_pairs(subset.frames, followed, p.detector, images.position, _reach(problem)),
            p.detector, p.mount, images.position, p.known.along_world(), p.radii,
            at_first_line=still if p.readout_time != 0.0 else None,
        ),
    )  # fmt: skip
    run.progress(MODELLED, 1, 1)
    heights = HeightPrior(p.surface, p.height_sigma, p.radii) if p.height_sigma > 0.0 else None
    better = refined(model, images, p.known, p.detector, p.mount, heights)
    known = p.known if heights is not None else looking_down(p.known)
    distance = float(np.median([np.linalg.norm(model.points - x, axis=1).min() for x in model.position]))
    place, attitude = by_displacement(
        p.t, model.frames, better.poses.position, better.poses.world_from_body, followed, p.detector, p.mount,
        distance, images,
    )  # fmt: skip
    own = np.isfinite(p.known.attitude.sum(axis=1))[:, None]
    quat = np.where(own, images.world_from_body.as_quat(), attitude.as_quat())
    given = np.isfinite(p.known.position.sum(axis=1))[:, None]
    images = replace(
        images,
        position=np.where(given, images.position, place),
        world_from_body=Rotation.from_quat(quat),
    )
    start = replace(images, position=place, world_from_body=attitude)
    return replace(p, images=images, known=known, start=start), better


def _reach(problem: SequenceProblem) -> Array:
    """m (M,): the ground that a frame shows lies within this of its place; inf where no place is given."""
    lines, columns = problem.detector.shape
    corner = problem.detector.directions(np.array([[0.0, 0.0], [lines - 1.0, columns - 1.0]]))
    slant = float(np.max(np.linalg.norm(corner[:, :2], axis=1) / corner[:, 2]))
    loose = problem.known.position.max(axis=1)
    return np.asarray(ground_distances(problem) * slant + 3.0 * loose)


class _Run(CpuClock):
    """Progress, stages kept, and CPU seconds."""

    def __init__(self, progress: Progress, stages: Stages) -> None:
        super().__init__()
        self.progress, self.stages = progress, stages
        self.taken_over: dict[str, float] = {}
        self._noted = 0.0

    def note(self, stage: str) -> None:
        """Add the time since the last note to a stage, and that of earlier runs which was taken over."""
        super().note(stage)
        taken, self._noted = self.stages.taken_over - self._noted, self.stages.taken_over
        if taken > 0.0:
            self.taken_over[stage] = self.taken_over.get(stage, 0.0) + taken
            self.seconds[stage] += taken


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

    def keep(state: FollowState) -> None:
        states.append(run.stages.keep(name(), state))

    def follow() -> Followed:
        while run.stages.has(name()):
            states.append(run.stages.stage(name(), FollowState, unreachable))
        return follow_sequence(problem, plan, run.progress, keep, tuple(states))

    followed = run.stages.stage("follow", Followed, follow)
    for number in range(len(states)):
        run.stages.drop(f"follow-{number}")
    return followed


@one_blas_thread
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
    plan = follow_plan(problem, plan)
    sources = [s if not why else None for s, why in zip(problem.sources, problem.excluded, strict=True)]

    def report(done: int) -> None:
        if progress is not None:
            progress(FOLLOWED, done, len(sources))

    return followed_or_linked(
        sources, plan, problem.images.position, problem.known.position,
        progress=report, keep=keep, states=states,
    )  # fmt: skip


def _solved(
    problem: SequenceProblem, followed: Followed, cross: bool, run: _Run
) -> tuple[SequenceProblem, Adjusted, Tracks]:
    """All poses (760); where those of a model do not come together, of cameras that look down."""
    known = problem.known if problem.start is None else looking_down(problem.known)
    try:
        return problem, *_all_poses(problem, followed, cross, run)
    except DivergedError:
        if known is problem.known:
            raise
    blocks = range(len(problem) // BLOCK_FRAMES + 1)
    for name in ("poses", "cross", *(f"block-{number}" for number in blocks)):
        run.stages.drop(name)
    run.stages.depend("cameras look down")
    problem = replace(problem, known=known)
    return problem, *_all_poses(problem, followed, cross, run)


def _all_poses(
    problem: SequenceProblem, followed: Followed, cross: bool, run: _Run
) -> tuple[Adjusted, Tracks]:
    """All frames solved together (760), once more with what stretches share; all sightings."""
    block = SequenceSolver(problem, followed)
    found = run.stages.stage("poses", Adjusted, lambda: _adjusted(block, run))
    run.note(SOLVED_ALL)
    group = followed.linked()
    if cross and len(np.unique(group[group >= 0])) > 1:
        shared = run.stages.stage("cross", _Shared, lambda: _compared(block, found.poses, group, run)).tracks
        run.note(COMPARED)
        if shared is not None and (untied := _too_large(problem, appended(found.tracks, shared))):
            return replace(found, words=(*found.words, untied)), block.with_control(found.tracks)
        if shared is not None:
            before, words, tracks = found.poses, found.words, appended(found.tracks, shared)
            run.progress(SOLVED_ALL, 0, 1)
            found = run.stages.stage(
                "poses-linked", Adjusted, lambda: Adjusted(block.solve(tracks, before), tracks, words)
            )
            run.progress(SOLVED_ALL, 1, 1)
            run.note(SOLVED_ALL)
    refuse_unobservable_focal(found.poses)
    return found, block.with_control(found.tracks)


def _too_large(problem: SequenceProblem, tracks: Tracks) -> str:
    """Why lines are not solved together; "" where they can be."""
    wanted, there = solving_order(problem.images, tracks).memory, _SHARE * machine_memory()
    if wanted <= there:
        return ""
    return (
        f"stretches of the flight overlap, but are not solved together: {len(problem)} frames at once would "
        f"take {wanted / 1e9:.1f} GB of memory, {there / 1e9:.1f} GB may be used; each stretch is solved by "
        "itself, by its own tables. Leave frames out (every other one, say), or use a larger machine"
    )


def _adjusted(block: SequenceSolver, run: _Run) -> Adjusted:
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
        return Adjusted(poses, tracks)
    rounds = block.rounds()

    def count(done: int) -> None:
        run.progress(SOLVED_ALL, done, rounds)

    solved = block.part(block.problem, block.followed, count)
    return Adjusted(solved.poses, solved.tracks)


def _compared(block: SequenceSolver, poses: FramePoses, group: NDArray[np.intp], run: _Run) -> _Shared:
    """Stretches compared with each other."""
    p = block.problem

    def report(done: int, total: int) -> None:
        run.progress(COMPARED, done, total)

    return _Shared(
        link_stretches(
            p.sources, estimated_images(p.images, poses), poses.detector(p.detector), p.mount, p.surface,
            group, block.cross_plan(poses), report,
        )
    )  # fmt: skip


@one_blas_thread
def poses_of_windows(problem: SequenceProblem, followed: Followed) -> tuple[FramePoses, Tracks]:
    """Poses of all frames from windows that were followed (760), and their sightings; no image is read.

    Parameters
    ----------
    problem : SequenceProblem
    followed : Followed
    """
    found, tracks = _all_poses(problem, followed, False, _Run(silent, Stages()))
    return found.poses, tracks


def _sources(
    problem: SequenceProblem, followed: Followed, subset: Subset, poses: FramePoses
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """How each frame's pose came about, and why its image gave nothing for it."""
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


def _warnings(
    problem: SequenceProblem, poses: FramePoses, source: tuple[str, ...], followed: Followed
) -> list[str]:
    """What a user should know."""
    out = list(problem.warnings)
    idle = source.count(INTERPOLATED)
    if idle:
        are = (
            "is interpolated: its image is missing or shows too little"
            if idle == 1
            else "are interpolated: their images are missing or show too little"
        )
        out.append(f"{idle} of {len(source)} frames {are}")
    out += focal_warnings(problem, poses)
    # ground at another height moves otherwise too: said once
    out += ground_warnings(problem, poses) or motion_warnings(problem, followed)
    return out + [misfit.words for misfit in misfits(problem, poses)] + bow_warnings(problem, poses)
