"""Poses of the captures of a rig and the offsets of its cameras, in one adjustment with the points.

Every capture has the six unknowns of a frame; images of its cameras move with it. Offsets are unknowns of the
whole flight, held by what is known of them beforehand.

Not here: what sightings are (``rig_matches.py``), flights of one camera (``poses.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, frozen
from sightline.photogrammetry.block.descent import BlockSums, Fit, State, descend, first_state, seen_twice
from sightline.photogrammetry.block.point_priors import PointPriors
from sightline.photogrammetry.block.pose_unknowns import STRETCH, PoseUnknowns
from sightline.photogrammetry.flight.focal import globals_of
from sightline.photogrammetry.flight.path import UNITS
from sightline.photogrammetry.flight.poses import (
    FramePoses,
    RoughPoses,
    as_frame_poses,
    bias_rows,
    departures_of,
    frame_unknowns,
    held_at,
    moved_images,
)
from sightline.photogrammetry.flight.rig import OFFSETS, RigCamera, RigOffsets, rig_images
from sightline.photogrammetry.flight.solving_order import solving_order
from sightline.photogrammetry.flight.track_noise import alike_beside
from sightline.photogrammetry.sightings import Images, Tracks, as_index, sight_frames

#: Rounds in which the equations are linearised about the solution before.
_ROUNDS = 3
#: Steps end when the next would lower the cost by less (chi-square units): a hundredth of a sigma.
_CONVERGED = 1e-4
#: Roughness (unit^2 / s^3 in `UNITS`) of a path of which nothing is known.
_LOOSE_ROUGHNESS = 1e8
#: Groups of sightings that tell how they err together, at least and about at most; parts of a single capture
#: along each side.
_LEAST_GROUPS, _MOST_GROUPS, _CELLS = 5, 10, 5
_PLACES, _ANGLES = slice(3, 6), slice(0, 3)


@dataclass(frozen=True, eq=False)
class RigSolution:
    """What an adjustment of a rig gave.

    Attributes
    ----------
    poses : FramePoses
        Of the captures; residuals of all sightings.
    offsets : RigOffsets
    statistic : (N,)
        Squared residual of each sighting over its expectation.
    """

    poses: FramePoses
    offsets: RigOffsets
    statistic: Array


def adjust_rig(
    captures: Images,
    cameras: Sequence[RigCamera],
    tracks: Tracks,
    known: RoughPoses,
    *,
    start: FramePoses | Images | None = None,
    begin: RigOffsets | None = None,
    priors: PointPriors | None = None,
    points: Array | None = None,
) -> RigSolution:
    """Poses of all captures and offsets of all cameras.

    Parameters
    ----------
    captures : Images
        Rough poses of the body, M in order of time.
    cameras : sequence of RigCamera
        C; the first is the body.
    tracks : Tracks
        `image` counts the images of the first camera, then those of the second: camera M + capture.
    known : RoughPoses
        How rough the poses are.
    start : FramePoses or Images, optional
        A solution of the first camera, or poses near one.
    begin : RigOffsets, optional
        Offsets near the solution; those given by default.
    priors : PointPriors, optional
    points : (n, 3), optional
        m; where to start from.

    Returns
    -------
    RigSolution

    Raises
    ------
    EstimationError
        If sightings do not tie captures, cameras and points together.
    """
    count = len(captures)
    order = solving_order(captures, replace(tracks, image=as_index(tracks.image % count, "image")))
    solved = start if isinstance(start, FramePoses) else None
    moved = np.zeros((count, 6)) if start is None else departures_of(captures, start)
    rough = np.full(6, _LOOSE_ROUGHNESS) * UNITS**2 if solved is None else solved.roughness
    common = np.concatenate([
        globals_of(np.zeros(6) if solved is None else solved.bias, bias_rows(known),
                   None if solved is None else solved.focal, known.focal_length),
        _begun(cameras, begin),
    ])  # fmt: skip
    detectors, mounts = [c.detector for c in cameras], [c.mount for c in cameras]
    orientation = Rotation.concatenate([c.orientation for c in cameras])
    position = np.array([c.position for c in cameras])
    state: State | None = None
    weight: Array | None = None
    usable, block = np.zeros(len(tracks), dtype=bool), None
    for _ in range(_ROUNDS):
        now = moved_images(captures, moved)
        plain = replace(frame_unknowns(captures, known, rough, order.rank, moved), last=order.last)
        unknowns = _with_offsets(plain, now, cameras, common)
        planned = sight_frames(rig_images(now, orientation, position), detectors, mounts, tracks)
        before: BlockSums | None = block
        block = BlockSums(planned, unknowns, priors)
        own = held_at(plain, common[: plain.globals])
        if state is None or before is None:
            state, usable = first_state(block, seen_twice(planned, priors), None)
            if points is not None:
                given = np.asarray(np.isfinite(points).all(axis=1))
                state.points[given] = points[given] - block.origin
                usable = usable | (given[planned.point] & seen_twice(planned, priors))
            state = State(common, own, state.points)
        else:
            state = State(common, own, state.points + before.origin - block.origin)
        fit = descend(block, state, usable, robust=True, weight=weight, converged=_CONVERGED)
        state, weight, common = fit.state, fit.weight, fit.state.common
        step = plain.departures(state.own, common[: plain.globals])
        turned = Rotation.from_rotvec(moved[:, :3]) * Rotation.from_rotvec(step[:, :3])
        last, moved = moved, np.concatenate([turned.as_rotvec(), moved[:, 3:] + step[:, 3:6]], axis=1)
    assert block is not None
    assert state is not None
    poses, _ = as_frame_poses(moved_images(captures, last), block, fit, rough, known)
    offsets = _design_effect(block, fit, state, _groups(tracks, count), plain.globals, _free(cameras))
    return RigSolution(
        poses,
        _offsets(cameras, tracks, poses, common[plain.globals :], offsets),
        fit.statistic,
    )


def _free(cameras: Sequence[RigCamera]) -> list[tuple[int, int]]:
    """Camera and offset of each unknown, in their order."""
    return [
        (c, k)
        for c, camera in enumerate(cameras)
        for k, sigma in enumerate(camera.prior_sigma)
        if c > 0 and sigma > 0.0
    ]


def _begun(cameras: Sequence[RigCamera], begin: RigOffsets | None) -> Array:
    """Values of the unknown offsets, as departures from those given, of a solution near by."""
    out = np.zeros((len(cameras), len(OFFSETS)))
    if begin is not None:
        given = Rotation.concatenate([c.orientation for c in cameras])
        out[:, _ANGLES] = (given.inv() * begin.orientation).as_rotvec()
        out[:, _PLACES] = begin.position - np.array([c.position for c in cameras])
        out[:, 6] = begin.stretch
    return np.array([out[c, k] for c, k in _free(cameras)])


def _with_offsets(
    plain: PoseUnknowns, captures: Images, cameras: Sequence[RigCamera], common: Array
) -> PoseUnknowns:
    """Unknowns of all images of a rig from those of its captures.

    Notes
    -----
    A capture's body turned by w and moved by e, an offset changed by the turn o and the lever l:
    the image turns by log(exp(R^T w) exp(o)), R the orientation given, and moves by e + B (w x L + l), B
    world_from_body and L the lever arm. Both are taken linear in w about 0, where the rounds lead it to.
    """
    free = _free(cameras)
    values = np.zeros((len(cameras), len(OFFSETS)))
    for (c, k), value in zip(free, common[plain.globals :], strict=True):
        values[c, k] = value
    count, size, rank = len(captures), len(cameras), plain.shot
    body = captures.world_from_body.as_matrix()
    width = max(plain.width, 7 if any(k == STRETCH for _, k in free) else 6)
    follows = np.zeros((count, size, width, plain.width))  # departure of an image by that of its capture
    columns = np.zeros((count, size, width, len(free)))
    for c, camera in enumerate(cameras):
        turn = values[c, _ANGLES]
        follows[:, c, :3, :3] = _left_inverse(turn) @ camera.orientation.inv().as_matrix()
        follows[:, c, 3:6, :3] = -body @ _cross(camera.position + values[c, _PLACES])
        follows[:, c, 3:6, 3:6] = np.eye(3)
        if c == 0 and plain.width > STRETCH:
            follows[:, c, STRETCH, STRETCH] = 1.0
    for number, (c, k) in enumerate(free):
        if k in range(3, 6):
            columns[:, c, 3:6, number] = body[:, :, k - 3]
        else:
            columns[:, c, k, number] = 1.0
    by_shot = np.zeros((count, size, width, plain.own))
    by_global = np.zeros((count, size, width, plain.globals + len(free)))
    by_shot[rank] = follows @ plain.by_shot[rank][:, None]
    by_global[rank, ..., : plain.globals] = follows @ plain.by_global[rank][:, None]
    by_global[rank, ..., plain.globals :] = columns
    prior = np.array([cameras[c].prior_sigma[k] for c, k in free])
    return replace(
        plain,
        shot=as_index(np.tile(rank, size), "shot"),
        slot=as_index(np.repeat(np.arange(size), count), "slot"),
        by_shot=frozen(by_shot.reshape(count, size * width, -1)),
        by_global=frozen(by_global.reshape(count, size * width, -1)),
        global_information=frozen(np.concatenate([plain.global_information, prior**-2.0])),
        names=(*plain.names, *(f"{OFFSETS[k]}_{c + 1}" for c, k in free)),
    )


def _cross(v: Array) -> Array:
    """Matrix (3, 3) of the product v x."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _left_inverse(angles: Array) -> Array:
    """Matrix J with exp(w) exp(o) = exp(o + J w) for small w; `angles` (3,) rad is o, small itself.

    To the second order of o: for a degree the rest is 1e-8.
    """
    cross = _cross(angles)
    return np.asarray(np.eye(3) - 0.5 * cross + cross @ cross / 12.0)


def _groups(tracks: Tracks, count: int) -> Index:
    """Group (N,) of each sighting: ground that one capture showed first, or a part of a single capture."""
    points = int(tracks.point.max()) + 1
    first = np.full(points, count)
    np.minimum.at(first, tracks.point, tracks.image % count)
    if count > 1:
        # ground that neighbours show first lies side by side
        return np.asarray(first[tracks.point] // max(count // _MOST_GROUPS, 1))
    cell = np.zeros(points, dtype=np.intp)
    own = tracks.image == 0
    low, high = tracks.pixels[own].min(axis=0), tracks.pixels[own].max(axis=0)
    place = np.floor(_CELLS * (tracks.pixels[own] - low) / np.maximum(high - low + 1.0, 1.0)).astype(np.intp)
    cell[tracks.point[own]] = _CELLS * place[:, 0] + place[:, 1]
    return cell[tracks.point]


def _design_effect(
    block: BlockSums, fit: Fit, state: State, group: Index, others: int, free: list[tuple[int, int]]
) -> Array:
    """Covariance of the offsets that owns what sightings of the same ground have in common.

    Parameters
    ----------
    block : BlockSums
    fit : Fit
    state : State
        The solution.
    group : (N,) int
        Of each sighting: those of one group may err alike.
    others : int
        Globals before the offsets.
    free : list of (int, int)
        Camera and offset of each unknown.

    Returns
    -------
    (n, n)

    Notes
    -----
    What two bands show unlike of one ground moves all windows about it, in all captures and cameras: no
    residual shows it, as the points follow. The pulls of the groups on the angles of a camera scatter by
    more than their information allows then; over it, that is the design effect of clustered samples, by
    which the information on the offsets of that camera is less (K. Y. Liang, S. L. Zeger, Biometrika 73,
    1986). It is 1 at least. Of few groups pulls are smaller than those of new ground, by (G - 1) / G each as
    the solution follows them (the jackknife's factor), and one over a scatter of n degrees of freedom is too
    large by n / (n - 2) on the mean.
    """
    reduced, known = fit.equations.reduced, block.unknowns.global_information
    whole = 0.5 * (reduced.information + reduced.information.T)
    base, rest = whole[:others, :others], whole[others:, :others]
    held = np.linalg.solve(base, rest.T).T if others else np.zeros((len(free), 0))
    information = whole[others:, others:] - held @ rest.T - np.diag(known[others:])
    names = np.unique(group)
    nothing = block.gradient(state, np.zeros(len(group)))
    pulls = np.zeros((len(names), len(free)))
    for row, name in enumerate(names):
        of_group = block.gradient(state, fit.weight * (group == name))
        pull = reduced.condense(*(a - b for a, b in zip(of_group[:3], nothing[:3], strict=True)))
        pulls[row] = pull[others:] - held @ pull[:others]
    pulls -= pulls.mean(axis=0)
    groups, freedom = len(names), 3.0 * (len(names) - 1.0)
    small = (groups / max(groups - 1.0, 1.0)) ** 2 * freedom / max(freedom - 2.0, 1.0)
    shrink = np.ones(len(free))  # one over the root of the effect
    for camera in dict.fromkeys(c for c, _ in free):
        own = [i for i, (c, k) in enumerate(free) if c == camera and k < 3]
        if len(own) == 3 and len(names) >= _LEAST_GROUPS:
            scatter = pulls[:, own].T @ pulls[:, own] * small
            effect = float(np.trace(np.linalg.solve(information[np.ix_(own, own)], scatter))) / 3.0
            shrink[[i for i, (c, _) in enumerate(free) if c == camera]] = max(effect, 1.0) ** -0.5
    return np.asarray(np.linalg.inv(shrink[:, None] * information * shrink + np.diag(known[others:])))


def _offsets(
    cameras: Sequence[RigCamera], tracks: Tracks, poses: FramePoses, values: Array, covariance: Array
) -> RigOffsets:
    """Offsets from the values of their unknowns and their covariance."""
    size, count = len(cameras), len(poses.position)
    free = _free(cameras)
    out, of_camera = np.zeros((size, len(OFFSETS))), np.zeros((size, len(OFFSETS), len(OFFSETS)))
    for i, (c, k) in enumerate(free):
        out[c, k] = values[i]
        for j, (other, m) in enumerate(free):
            if other == c:
                of_camera[c, k, m] = covariance[i, j]
    if poses.focal is not None:
        out[0, STRETCH], of_camera[0, STRETCH, STRETCH] = poses.focal.stretch, poses.focal.sigma**2
    seen_by = (tracks.image // count)[~poses.rejected]
    square = (poses.residual_px[~poses.rejected] ** 2).sum(axis=1)
    sightings = np.bincount(seen_by, minlength=size).astype(np.intp)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.bincount(seen_by, square, minlength=size) / (2.0 * sightings))
    return RigOffsets(
        tuple(c.name for c in cameras),
        Rotation.concatenate([c.orientation for c in cameras]) * Rotation.from_rotvec(out[:, _ANGLES]),
        np.array([c.position for c in cameras]) + out[:, _PLACES],
        out[:, STRETCH],
        of_camera,
        np.array([c.prior_sigma for c in cameras]),
        sightings,
        rms,
    )


def rig_noise(solution: RigSolution, tracks: Tracks, given: Tracks, cameras: int, count: int) -> Tracks:
    """Tracks with sigmas of all cameras but the first that their residuals bear out.

    Parameters
    ----------
    solution : RigSolution
        Of `tracks`.
    tracks : Tracks
    given : Tracks
        The same with the sigmas of the matches themselves.
    cameras, count : int
        Cameras and captures.

    Notes
    -----
    What two bands show unlike of one place moves a window in every capture alike, and windows that share
    pixels together: n sightings of one point that go together by rho count for n / (1 + (n - 1) rho) of them,
    windows whose neighbours go with them by rho_k for 1 / (1 + sum rho_k) of a window.
    """
    sigma, camera = np.array(given.sigma_px), tracks.image // count
    for c in range(1, cameras):
        own = np.flatnonzero(camera == c)
        rows = own[~solution.poses.rejected[own]]
        if len(rows) < _LEAST_SCALED:
            continue
        # robust: the median of a chi-square of two degrees of freedom
        square = solution.statistic[rows] * (tracks.sigma_px[rows] / given.sigma_px[rows]) ** 2
        # not below: what all cameras see alike of a point moves the point, and no residual shows it
        factor = np.full(len(own), max(float(np.median(square)) / _MEDIAN_2, 1.0))
        unit = solution.poses.residual_px[rows] / given.sigma_px[rows, None]
        again = np.bincount(given.point[rows], minlength=int(given.point.max()) + 1)[given.point[own]]
        factor *= 1.0 + np.maximum(again - 1, 0) * _alike_again(given.point[rows], unit)
        factor *= 1.0 + alike_beside(given.image[rows], given.pixels[rows], unit)
        sigma[own] *= np.sqrt(factor)
    return replace(given, sigma_px=sigma)


def _alike_again(point: Index, unit: Array) -> float:
    """Correlation of the residuals (N, 2) of one point from capture to capture; 0 to 1."""
    count = np.bincount(point)
    sums = np.stack([np.bincount(point, unit[:, k]) for k in range(2)], axis=1)
    squares = np.bincount(point, (unit**2).sum(axis=1))
    pairs = float((count * (count - 1.0)).sum())
    if pairs < _LEAST_SCALED:
        return 0.0
    together = float(((sums**2).sum(axis=1) - squares).sum()) / pairs
    return float(np.clip(together / (squares.sum() / len(point)), 0.0, 1.0))


#: Sightings from which on residuals tell how good those of a camera are; median of their chi-square.
_LEAST_SCALED, _MEDIAN_2 = 30, 1.3863
Index = NDArray[np.intp]
