"""Poses of many frames of one flight: rough tables, points seen in frame after frame, and a smooth path.

Every frame is free. Tables of positions and attitudes hold it where they are, each with a constant bias of
its own; between neighbours of one stretch the path is as smooth as it was found to be. One banded solution
gives all frames with the covariance of each, those that no image evidence reaches too.

Not here: how smooth a path is (``path.py``), finding the points (``applications/``), constant errors
of calibrated cameras (``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, InputError
from sightline.execution import one_blas_thread
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.block.descent import (
    BlockSums,
    Fit,
    State,
    descend,
    first_state,
    gross_error,
    seen_twice,
)
from sightline.photogrammetry.block.linked_frames import LinkedFrames
from sightline.photogrammetry.block.point_priors import PointPriors
from sightline.photogrammetry.block.pose_unknowns import STRETCH, PoseUnknowns
from sightline.photogrammetry.block.reduced import PointsFirst
from sightline.photogrammetry.flight.focal import (
    FocalStretch,
    common_errors,
    focal_information,
    globals_of,
    unobservable_focal_length,
)
from sightline.photogrammetry.flight.path import (
    UNITS,
    bends,
    path_precision,
    path_roughness,
    path_turns,
    scale_form,
    stretches,
    trend_forms,
)
from sightline.photogrammetry.flight.readout import ReadoutChange, ReadoutTime, WithReadout, readout_step
from sightline.photogrammetry.flight.solving_order import solving_order
from sightline.photogrammetry.sightings import Images, Sightings, as_index

#: Roughness (unit^2 / s^3 in `UNITS`) with which the first solution starts: hardly any smoothness.
_LOOSE_ROUGHNESS = 1e8
#: Rounds in which the roughness of the path is measured anew; frames up to which it is measured once: 28
#: bends give a variance to sqrt(2 / 28), a quarter of it. Of fewer it is chance to a good part, which another
#: round on the path that it smoothed would carry on.
_ROUNDS, _FEW = 2, 30
#: Sigmas of a bend of the path from which on it is a turn: 2e-9 by chance, so once in 1e8 frames. A turn
#: taken for none bends the whole flight (a chi-square of a thousand); a bend taken for one, as sway is not
#: quite Gaussian, loses what smoothness says of one frame.
_TURN = 6.0
#: Steps end when the next would lower the cost by less (chi-square units): a hundredth of a sigma.
_CONVERGED = 1e-4
#: Frames up to which the covariance of all poses with each other is kept: 3 MB.
MOST_PAIRED = 100
#: Frames whose covariance with all others is computed at once.
_PAIRED_AT_ONCE = 50
#: Position (world axes), then angles (body axes), in departures.
POSE_ORDER = [3, 4, 5, 0, 1, 2]
_Covariances = PointsFirst | LinkedFrames | WithReadout


@dataclass(frozen=True, eq=False)
class RoughPoses(ReadOnlyArrays):
    """What tables say of the frames' poses, apart from the poses themselves (those of `Images`).

    Attributes
    ----------
    position : (M, 3)
        m, 1-sigma of each position along the axes of its table; inf where the table has none.
    attitude : (M, 3)
        rad, 1-sigma per body axis; inf where the table has none.
    position_bias : float
        m, 1-sigma per axis of a constant error of all positions; 0 where there is none.
    attitude_bias : float
        rad, 1-sigma per axis of a constant error of all attitudes, body axes; 0 where there is none.
    axes : (M, 3, 3) or None
        World axes from those that the sigmas of positions are along, such as east, north, up; None: the same.
    focal_length : float
        Relative 1-sigma of the one focal length of all frames, to be found with the poses; 0: it is kept,
        inf: nothing is known of it but what the images show.
    """

    position: Array
    attitude: Array
    position_bias: float = 0.0
    attitude_bias: float = 0.0
    axes: Array | None = None
    focal_length: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name in ("position", "attitude"):
            value = frozen(getattr(self, name))
            if value.ndim != 2 or value.shape[1] != 3 or not (value > 0.0).all():
                raise InputError(f"`{name}` must be positive sigmas of shape (M, 3), got {value.shape}")
            object.__setattr__(self, name, value)
        if not self.focal_length >= 0.0:
            raise InputError(f"`focal_length` must be a relative sigma, 0 or more, got {self.focal_length}")
        if self.axes is not None:
            axes = frozen(self.axes)
            if axes.shape != (len(self.position), 3, 3):
                raise InputError(f"`axes` must be of shape ({len(self.position)}, 3, 3), got {axes.shape}")
            object.__setattr__(self, "axes", axes)

    def __getitem__(self, rows: NDArray[np.intp] | slice) -> RoughPoses:
        """What tables say of some of the frames."""
        axes = None if self.axes is None else self.axes[rows]
        return replace(self, position=self.position[rows], attitude=self.attitude[rows], axes=axes)

    def along_world(self) -> Array:
        """Sigmas (M, 3) of positions along world axes, m; their correlations are left out."""
        if self.axes is None:
            return self.position
        known = np.isfinite(self.position).all(axis=1)
        out = np.full_like(self.position, np.inf)
        out[known] = np.sqrt(np.einsum("nij,nj->ni", self.axes[known] ** 2, self.position[known] ** 2))
        return out

    def precision(self) -> Array:
        """1 / variance (M, 6, 6) of (attitude, position): rad^-2, body axes; m^-2, world axes."""
        out = np.zeros((len(self.position), 6, 6))
        axis = np.arange(3)
        out[:, axis, axis] = self.attitude**-2.0
        if self.axes is None:
            out[:, 3 + axis, 3 + axis] = self.position**-2.0
        else:
            out[:, 3:, 3:] = np.einsum("nij,nj,nkj->nik", self.axes, self.position**-2.0, self.axes)
        return out


@dataclass(frozen=True, eq=False)
class FramePoses(ReadOnlyArrays):
    """Adjusted poses of all frames.

    Attributes
    ----------
    position : (M, 3)
        m, world axes.
    world_from_body : Rotation
        M rotations.
    covariance : (M, 6, 6)
        Of position (m, world axes) and angles (rad, body axes), in that order: of the absolute pose, the
        uncertainty of the biases in it.
    bias : (6,)
        Constant errors found of the tables: of positions (m), of attitudes (rad): table less truth.
    bias_covariance : (6, 6)
    points : (n, 3)
        m, world axes; NaN where seen less than twice.
    residual_px : (N, 2)
        px, measured less predicted.
    rejected : (N,) bool
    sightings : (M,) int
        How many good ones each frame has.
    roughness : (6,)
        Of the path: spectral density of the acceleration of (turn, move), rad^2/s^3 and m^2/s^3.
    scale : float
        Robust size of residuals over the stated one.
    bow : (S, 3)
        rad, 1-sigma of how each of S stretches is bent about body axes: of the even trend of the angles'
        errors from its first frame to its last, rms over it.
    scale_sigma : float
        Relative 1-sigma of how large the flight is as a whole, by its positions; 0 of a single frame.
    next_covariance : (M - 1, 6, 6)
        Of the pose of each frame but the first (rows) with that of the frame before it (columns), as of
        `covariance`.
    pair_covariance : (M, 6, M, 6) or None
        Of all poses with each other; None beyond `MOST_PAIRED` frames.
    focal : FocalStretch or None
        None where the focal length was kept. What is not known of it is in the covariances.
    readout : ReadoutTime or None
        None where the readout time was kept. What is not known of it is in the covariances.
    cost : float
        What is minimised: chi-square of sightings that count, of tables and of all else that is known, and
        for each gross error what it exceeds at least; inf where nobody asked.
    freedom : (N,) or None
        Squared residual over variance that is expected of each sighting, its point following it; None where
        nobody asked.
    """

    position: Array
    world_from_body: Rotation
    covariance: Array
    bias: Array
    bias_covariance: Array
    points: Array
    residual_px: Array
    rejected: NDArray[np.bool_]
    sightings: NDArray[np.intp]
    roughness: Array
    scale: float
    bow: Array
    scale_sigma: float
    next_covariance: Array
    pair_covariance: Array | None
    focal: FocalStretch | None = None
    cost: float = np.inf
    readout: ReadoutTime | None = None
    freedom: Array | None = None

    def readout_time(self, given: float) -> float:
        """s; that of the frames found, from the one given."""
        return given if self.readout is None else self.readout.seconds

    def detector(self, given: AreaDetector) -> AreaDetector:
        """The camera of the frames with the focal length found, from the one given."""
        if self.focal is None:
            return given
        return replace(given, focal_length_px=given.focal_length_px * (1.0 + self.focal.stretch))


def moved_images(images: Images, moved: Array) -> Images:
    """Images turned and moved by (M, 6)."""
    turned = images.world_from_body * Rotation.from_rotvec(moved[:, :3])
    return replace(images, position=images.position + moved[:, 3:], world_from_body=turned)


def frame_unknowns(
    images: Images,
    known: RoughPoses,
    roughness: Array,
    rank: NDArray[np.intp] | None = None,
    moved: Array | None = None,
) -> PoseUnknowns:
    """Unknowns of a flight: every frame free, held by tables, biases and the smoothness of the path.

    Parameters
    ----------
    images : Images
        One camera, in order of time.
    known : RoughPoses
    roughness : (6,)
        Of (turn, move), rad^2/s^3 and m^2/s^3.
    rank : (M,) int, optional
        Order in which frames are solved; that of time otherwise.
    moved : (M, 6), optional
        (turn, move), rad and m, by which poses already depart from the tables; unknowns count from there.

    Returns
    -------
    PoseUnknowns
        Globals: what biases of the tables make of the poses, ``turn_1`` ..., ``move_1`` ..., and last
        ``stretch_1`` where the focal length is sought: its relative change.

    Notes
    -----
    Turns are added as if they commuted. Half their product is wrong by that: where tables are noisy it would
    look like bends, that a constant turn makes larger or smaller. So unknowns count from poses near the
    solution.
    """
    count = len(images)
    moved = np.zeros((count, 6)) if moved is None else moved
    rank = np.arange(count) if rank is None else rank
    stretch = stretches(images.t)
    small = roughness / UNITS**2
    # it is the path itself that is smooth, not what tables have wrong of it
    row, at, strength = bends(images.t, small, stretch)
    planned = path_turns(moved_images(images, moved), stretch) / UNITS
    bend = np.einsum("nk,nka->na", row, planned[at[:, None] + np.arange(-2, 1)])
    # where a flight turns it is not smooth: frames that show nothing may hide that from the roughness; they
    # lie where the tables have them
    noise = np.concatenate([known.attitude, known.along_world()], axis=1) / UNITS
    loose = np.einsum("nk,nka->na", row**2, noise[at[:, None] + np.arange(-2, 1)] ** 2)
    turns = (bend**2 > _TURN**2 * (loose + 1.0 / strength)).any(axis=1)
    strength = np.where(turns[:, None], 0.0, strength)
    precision = path_precision(row, at, strength, rank)
    pull = np.zeros((count, 6))
    for k in range(3):
        pull[rank[at + k - 2]] += row[:, k, None] * strength * bend
    prior = known.precision() * np.multiply.outer(UNITS, UNITS)
    precision[rank, 0] += prior
    departed = np.einsum("mab,mb->ma", prior, moved / UNITS)
    pull[rank] += departed
    parts, names, information = [], [], []
    width = 7 if known.focal_length > 0.0 else 6
    for first, bias, name in ((0, known.attitude_bias, "turn"), (3, known.position_bias, "move")):
        if bias > 0.0:
            part = np.zeros((count, width, 3))
            part[:, first + np.arange(3), np.arange(3)] = 1.0
            parts.append(part)
            names += [f"{name}_{k + 1}" for k in range(3)]
            information += [bias**-2.0] * 3
    if width > STRETCH:
        part = np.zeros((count, width, 1))
        part[:, STRETCH] = 1.0
        parts.append(part)
        names.append("stretch_1")
        information.append(focal_information(known.focal_length))
    by_global = np.concatenate([np.zeros((count, width, 0)), *parts], axis=2)
    half = 0.5 * float(np.ptp(images.t))
    return PoseUnknowns(
        as_index(rank, "shot"),
        as_index(np.zeros(count), "slot"),
        frozen(np.broadcast_to(np.eye(width, 6) * UNITS, (count, width, 6))),
        frozen(by_global),
        frozen(np.array(information)),
        tuple(names),
        (float(images.t[0]) + half, half),
        frozen(precision),
        np.inf,  # each has a prior
        frozen(pull),
        float((strength * bend**2).sum() + (departed * moved / UNITS).sum()),
    )


@one_blas_thread
def adjust_frames(
    images: Images,
    sightings: Sightings,
    known: RoughPoses,
    *,
    priors: PointPriors | None = None,
    points: Array | None = None,
    start: FramePoses | Images | None = None,
    roughness: Array | None = None,
    robust: bool = True,
    readout: ReadoutChange | None = None,
) -> FramePoses:
    """Poses of all frames, and the points, in one banded adjustment.

    Parameters
    ----------
    images : Images
        Rough poses of one camera, in order of time; where tables have none, any guess.
    sightings : Sightings
        Of these images.
    known : RoughPoses
        How rough they are.
    priors : PointPriors, optional
        Known heights, control points.
    points : (n, 3), optional
        m; where to start from. Where the rays of the rough poses meet, otherwise.
    start : FramePoses or Images, optional
        A solution near by, or poses near one.
    roughness : (6,), optional
        Of the path; measured on the solution otherwise.
    robust : bool
        Find gross errors and leave them out.
    readout : ReadoutChange, optional
        How sightings follow the readout time, which is then found too.

    Returns
    -------
    FramePoses
    """
    order = solving_order(images, sightings)
    moved = np.zeros((len(images), 6)) if start is None else departures_of(images, start)
    solved = start if isinstance(start, FramePoses) else None
    rough = np.full(6, _LOOSE_ROUGHNESS) * UNITS**2 if solved is None else solved.roughness
    common = (
        None
        if solved is None
        else globals_of(solved.bias, bias_rows(known), solved.focal, known.focal_length)
    )
    # from tables as rough as these are, a focal length that is free leads into false minima
    kept = solved is None and known.focal_length > 0.0
    first = replace(known, focal_length=0.0) if kept else known
    unknowns = replace(frame_unknowns(images, first, rough, order.rank, moved), last=order.last)
    block = BlockSums(from_poses(sightings, moved), unknowns, priors)
    state, usable = first_state(block, seen_twice(sightings, priors), None)
    if common is not None:
        state = replace(state, common=common, own=held_at(unknowns, common))
    if points is not None:
        given = np.asarray(np.isfinite(points).all(axis=1))
        state.points[given] = points[given] - block.origin
        usable = usable | (given[sightings.point] & seen_twice(sightings, priors))
    fit = descend(block, state, usable, robust=robust, converged=_CONVERGED)
    for number in range(_rounds(len(images), known, solved)):
        first_round = number == 0
        step = block.unknowns.departures(fit.state.own, fit.state.common)
        turned = Rotation.from_rotvec(moved[:, :3]) * Rotation.from_rotvec(step[:, :3])
        moved = np.concatenate([turned.as_rotvec(), moved[:, 3:] + step[:, 3:6]], axis=1)
        path = path_turns(moved_images(images, moved), stretches(images.t))
        seen = _count(sightings, fit.weight, images)
        if roughness is not None:
            rough = np.asarray(roughness)
        elif solved is None and (first_round or len(images) > _FEW):
            rough = path_roughness(images.t, path, seen)
        # otherwise that of before: measured on a path that it has smoothed it would shrink every time, and of
        # few frames at once, with the path itself
        unknowns = replace(frame_unknowns(images, known, rough, order.rank, moved), last=order.last)
        before, block = block, BlockSums(from_poses(block.sightings, step), unknowns, priors)
        common = np.zeros(unknowns.globals)
        common[: len(fit.state.common)] = fit.state.common
        held = held_at(unknowns, common)
        state = State(common, held, fit.state.points + before.origin - block.origin)
        try:
            fit = descend(block, state, usable, robust=robust, weight=fit.weight, converged=_CONVERGED)
        except EstimationError as error:
            raise (unobservable_focal_length(known.focal_length) if known is not first else error) from None
        first = known
    return as_frame_poses(moved_images(images, moved), block, fit, rough, known, readout)[0]


def _rounds(frames: int, known: RoughPoses, solved: FramePoses | None) -> int:
    """How often poses are solved again: with the roughness found, with the focal length."""
    if frames > 2:
        return 1 if solved is not None else _ROUNDS
    return 1 if solved is None and known.focal_length > 0.0 else 0


def departures_of(images: Images, poses: FramePoses | Images) -> Array:
    """(M, 6) rad and m, by which poses depart from those of images."""
    turn = (images.world_from_body.inv() * poses.world_from_body).as_rotvec()
    return np.concatenate([turn, poses.position - images.position], axis=1)


def bias_rows(known: RoughPoses) -> NDArray[np.intp]:
    """Places of the biases sought in `FramePoses.bias`, in the order of the globals."""
    places = [k for k, on in ((3, known.attitude_bias > 0.0), (0, known.position_bias > 0.0)) if on]
    return np.concatenate([np.arange(p, p + 3) for p in places]) if places else np.zeros(0, dtype=np.intp)


def from_poses(sightings: Sightings, step: Array) -> Sightings:
    """The same sightings, their poses turned and moved by `step` (M, 6 or 7) of their images."""
    of_pose = np.zeros(len(sightings.position), dtype=np.intp)
    of_pose[sightings.pose] = sightings.image
    turn = Rotation.from_rotvec(step[:, :3]).as_matrix()[of_pose]
    return replace(
        sightings,
        position=frozen(sightings.position + step[of_pose, 3:6]),
        world_from_body=frozen(sightings.world_from_body @ turn),
    )


def held_at(unknowns: PoseUnknowns, common: Array) -> Array:
    """Own unknowns (K, 6) that keep poses where they are when the biases are `common`."""
    return np.asarray(-(unknowns.by_global[:, :6] @ common) / np.diag(unknowns.by_shot[0]))


def _count(sightings: Sightings, weight: Array, images: Images) -> Array:
    """Sightings (M,) that count of each frame."""
    return np.asarray(np.bincount(sightings.image, weight, minlength=len(images)), dtype=np.float64)


def as_frame_poses(
    images: Images,
    block: BlockSums,
    fit: Fit,
    roughness: Array,
    known: RoughPoses,
    change: ReadoutChange | None = None,
) -> tuple[FramePoses, Array]:
    """A solution as poses with covariance, and the covariance of the globals.

    Parameters
    ----------
    images : Images
        M, where the equations are linear about; the block may have more, of further cameras.
    block : BlockSums
    fit : Fit
    roughness : (6,)
    known : RoughPoses
    change : ReadoutChange, optional
        Where the readout time is an unknown too.
    """
    unknowns, sightings, state, reduced = block.unknowns, block.sightings, fit.state, fit.equations.reduced
    assert isinstance(reduced, PointsFirst | LinkedFrames)  # frames are tied to their neighbours
    count, common = len(images), fit.equations.known.covariance()
    x = unknowns.departures(state.own, state.common)
    points, of_globals, globals_covariance = state.points, state.common, common
    used = seen_twice(sightings, block.priors, fit.weight > 0.0)
    step = None if change is None else readout_step(block, fit, used.astype(np.float64), change)
    covariances: _Covariances = reduced
    if step is not None:
        x, points = x + step.step * step.departures, points + step.step * step.points
        of_globals = of_globals + step.step * step.common
        globals_covariance = common + step.found.sigma**2 * np.outer(step.common, step.common)
        covariances = WithReadout(reduced, step)
    x = x[:count]
    covariance = covariances.departure_covariance(common)[:count][:, POSE_ORDER][:, :, POSE_ORDER]
    final = images.position + x[:, 3:6]
    bow, scale = _bow_and_scale(images.t, final, len(unknowns.shot), unknowns.width, covariances, common)
    following, pairs = _between(count, len(unknowns.shot), unknowns.width, covariances, common)
    bias, bias_covariance, focal = common_errors(
        of_globals, globals_covariance, bias_rows(known), known.focal_length
    )
    *_, r, cost = block.gradient(state, used.astype(np.float64))
    kept = np.bincount(sightings.point, used, minlength=sightings.points) > 0
    poses = FramePoses(
        frozen(final),
        images.world_from_body * Rotation.from_rotvec(x[:, :3]),
        frozen(covariance),
        bias,
        bias_covariance,
        frozen(np.where(kept[:, None], points + block.origin, np.nan)),
        frozen(r * sightings.sigma_px[:, None]),
        ~used,
        np.bincount(sightings.image % count, used, minlength=count).astype(np.intp),
        frozen(roughness),
        fit.scale,
        bow,
        scale,
        following,
        pairs,
        focal,
        float(cost + gross_error(len(sightings)) * np.count_nonzero(~used)),
        None if step is None else step.found,
        frozen(fit.freedom),
    )
    return poses, common


def _bow_and_scale(
    t: Array, position: Array, images: int, width: int, covariances: _Covariances, common: Array
) -> tuple[Array, float]:
    """Sigma (S, 3) of the trend of the angles over each stretch, rms over it, and that of the scale."""
    own = np.concatenate([trend_forms(t, width), scale_form(position, width)], axis=2)
    forms = np.concatenate([own, np.zeros((images - len(t), width, own.shape[2]))])
    taken = covariances.form_covariance(common, forms)
    sigma = np.sqrt(np.einsum("mak,mak->k", forms, taken))
    return frozen(sigma[:-1].reshape(-1, 3)), float(sigma[-1])


def _between(
    count: int, images: int, width: int, covariances: _Covariances, common: Array
) -> tuple[Array, Array | None]:
    """Covariance of each of `count` frames with the next (count - 1, 6, 6), and of all of them, if few."""
    if count > MOST_PAIRED:
        near = covariances.following_covariance(common, count)
        if near is not None:
            return frozen(near[:, POSE_ORDER][:, :, POSE_ORDER]), None
    following = np.zeros((count - 1, 6, 6))
    pairs = np.zeros((count, 6, count, 6)) if count <= MOST_PAIRED else None
    for first in range(0, count, _PAIRED_AT_ONCE):
        frames = np.arange(first, min(first + _PAIRED_AT_ONCE, count))
        forms = np.zeros((images, width, len(frames), 6))
        for axis, place in enumerate(POSE_ORDER):
            forms[frames, place, frames - first, axis] = 1.0
        found = covariances.form_covariance(common, forms.reshape(images, width, -1))
        whole = found[:count, POSE_ORDER].reshape(count, 6, len(frames), 6)
        if pairs is not None:
            pairs[:, :, frames] = whole
        before = frames[frames < count - 1]
        following[before] = whole[before + 1, :, before - first]
    return frozen(following), None if pairs is None else frozen(pairs)
