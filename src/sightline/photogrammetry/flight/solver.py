"""The sightings of a sequence, solved again and again: with their noise, with the path within frames.

Not here: which sightings, and what is made of the poses (``applications/sequence_poses.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sightline.errors import EstimationError
from sightline.geometry.checks import Array, frozen, read_only
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.descent import DivergedError
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors, level_axes
from sightline.photogrammetry.flight.blocks import PartSolution
from sightline.photogrammetry.flight.cross_links import CrossPlan
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses, adjust_frames
from sightline.photogrammetry.flight.problem import SequenceProblem, seen_ground
from sightline.photogrammetry.flight.readout import ReadoutChange
from sightline.photogrammetry.flight.reconstruct import held
from sightline.photogrammetry.flight.rolling_shutter import (
    as_of_first_lines,
    first_line_pixels,
    line_delays,
)
from sightline.photogrammetry.flight.start import approached
from sightline.photogrammetry.flight.track_noise import with_drift, with_scatter
from sightline.photogrammetry.pair.relief import points_alike
from sightline.photogrammetry.sightings import (
    Images,
    Sightings,
    Tracks,
    appended,
    as_index,
    sight_frames,
    stretched_sightings,
)

#: Rounds in which the noise of the sightings is taken from the residuals of the solution before.
_NOISE_ROUNDS = 1
#: The same of windows found from afar: with sigmas far from true the first leaves out the wrong ones.
_SCATTER_ROUNDS = 2
#: Chi-square by which a start must end lower than another to have found a better minimum, not the same.
_OTHER = 1.0
#: Rounds in which the path within frames is taken from the solution before.
_SHUTTER_ROUNDS = 2
#: Rounds in which the readout time is sought too; s, of its finite difference.
_READOUT_ROUNDS, _READOUT_STEP = 4, 1e-3


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What an adjustment of all frames gave."""

    poses: FramePoses
    tracks: Tracks
    words: tuple[str, ...] = ()


def tracks_of(followed: Followed) -> Tracks:
    """Windows that were followed, as sightings of points."""
    return Tracks(followed.image, followed.point, followed.pixels, followed.sigma_px)


class SequenceSolver:
    """The sightings of a problem, solved again and again."""

    def __init__(self, problem: SequenceProblem, followed: Followed) -> None:
        self.problem, self.followed = problem, followed
        self.alike = _alike_heights(problem, tracks_of(followed))

    def with_control(self, tracks: Tracks) -> Tracks:
        """The same tracks and those of points of control, which are numbered after the others."""
        own = self.problem.control_tracks
        if own is None or self.problem.control is None:
            return tracks
        return appended(tracks, own)

    def priors(self, tracks: Tracks) -> PointPriors | None:
        """What is known of the points: a surface, points of control."""
        p = self.problem
        heights, control = self.heights(tracks), None
        if p.control is not None and p.control_tracks is not None:
            first = int(tracks.point.max()) + 1
            control = ControlPoints(
                as_index(p.control.point + first, "point"), p.control.position, p.control.sigma
            )
        return None if heights is None and control is None else PointPriors(heights, control)

    def heights(self, tracks: Tracks | None = None) -> HeightPrior | None:
        """What is known of the heights of all points: of those that were followed, or of `tracks`."""
        p, alike = self.problem, self.alike
        if not p.height_sigma > 0.0:
            return None
        if tracks is not None and int(tracks.point.max()) > int(self.followed.point.max()):
            # points that stretches share lie on the same ground: they know its height no better
            alike = _alike_heights(p, tracks)
        # a surface is wrong over a whole frame alike: all points in it together give its height once
        return HeightPrior(p.surface, p.height_sigma * np.sqrt(alike), p.radii)

    def rounds(self) -> int:
        """How many times a part is solved."""
        if self.problem.readout_sigma > 0.0:
            return 1 + _READOUT_ROUNDS
        return 1 + (_SHUTTER_ROUNDS if self.problem.readout_time != 0.0 else _NOISE_ROUNDS)

    def part(
        self, problem: SequenceProblem, followed: Followed, progress: Callable[[int], None] | None = None
    ) -> PartSolution:
        """Frames in a row solved, with the noise of their sightings and with the path within frames."""
        own = copy(self)
        own.problem, own.followed = problem, followed
        tracks = tracks_of(followed)
        try:
            poses = own.solve(tracks, None)
        except DivergedError:
            known = problem.known_poses
            if problem.start is None or (closer := held(known)) is known:
                raise
            # attitudes of a model, which narrow fields hardly show, are held until poses are nearer
            poses = own.solve(tracks, None, known=closer)
        for number in range(1, self.rounds()):
            if progress is not None:
                progress(number)
            if number <= _NOISE_ROUNDS:
                good = ~poses.rejected[: len(tracks)]
                tracks = with_drift(tracks, poses.residual_px[: len(tracks)], good)
            poses = own.solve(tracks, poses)
        if progress is not None:
            progress(self.rounds())
        sightings, priors, *_ = own.equations(tracks, poses)
        return PartSolution(tracks, sightings, priors, poses)

    def approached(self) -> Adjusted:
        """Few frames far apart solved: from the tables, and in rounds in which sightings count more and more.

        The start that ends in the least cost holds.
        """
        tracks = tracks_of(self.followed)
        tracks, poses, words = self._best_start(tracks)
        given = tracks
        for _ in range(0 if words else _SCATTER_ROUNDS):
            finer = _scattered(given, poses)
            try:
                poses, tracks = self.solve(finer, poses), finer
            except EstimationError:
                words = ["the frames' geometry is weak: sightings count as good as their matches say of them"]
        return Adjusted(poses, tracks, tuple(words))

    def _best_start(self, tracks: Tracks) -> tuple[Tracks, FramePoses, list[str]]:
        """Of the best start: tracks as they counted, poses, words where they did not count in full."""
        counted, poses, words = approached(self.anew, tracks, max(self.problem.detector.shape))
        try:
            straight = self.solve(tracks, None)
            alike = self.anew(counted, straight)
        except EstimationError:
            return counted, poses, words
        better = alike.cost < poses.cost - _OTHER
        return (tracks, straight, []) if better else (counted, poses, words)

    def anew(self, tracks: Tracks, near: FramePoses | None) -> FramePoses:
        """Poses of all frames from poses `near`, of which nothing else is kept.

        The roughness of the path least of all: where sightings counted for little it was that of the tables.
        A path that may not bend as it does can be met by sightings if it shrinks, to nothing in the end.
        """
        return self.solve(tracks, near, keep=False)

    def solve(
        self,
        tracks: Tracks,
        before: FramePoses | None,
        *,
        keep: bool = True,
        known: RoughPoses | None = None,
    ) -> FramePoses:
        """Poses of all frames; `before` says where points are, and how frames moved while read out.

        `keep`: it is a solution of the same sightings, whose roughness and biases hold. `known`: in place of
        what the problem says of poses.
        """
        p = self.problem
        known = p.known_poses if known is None else known
        sightings, priors, points, change = self.equations(tracks, before)
        start: FramePoses | Images | None = p.start if before is None else before
        if before is not None and not keep:
            start = estimated_images(p.images, before)
        return adjust_frames(
            p.images, sightings, known, priors=priors, points=points, start=start, readout=change
        )

    def equations(
        self, tracks: Tracks, before: FramePoses | None
    ) -> tuple[Sightings, PointPriors | None, Array, ReadoutChange | None]:
        """Sightings, what is known of points, where they are (n, 3) m, how the first follow the readout."""
        p = self.problem
        detector = p.detector if before is None else before.detector(p.detector)
        priors = self.priors(tracks)
        tracks = self.with_control(tracks)
        if p.readout_time != 0.0 and before is None:
            still = first_line_pixels(
                tracks.image, tracks.pixels, self.followed, p.t, p.readout_time, p.detector.shape
            )
            tracks = replace(tracks, pixels=still)
        sightings = sight_frames(p.images, [detector], [p.mount], tracks)
        near = sightings if p.start is None else sight_frames(p.start, [detector], [p.mount], tracks)
        points = _on_surface(near, p)
        if before is not None:
            known = len(before.points)
            points[:known] = np.where(np.isfinite(before.points), before.points, points[:known])[
                : len(points)
            ]
            sightings, change = self._at_first_lines(tracks, sightings, points, before)
            return sightings, priors, points, change
        return sightings, priors, points, None

    def _at_first_lines(
        self, tracks: Tracks, sightings: Sightings, points: Array, before: FramePoses
    ) -> tuple[Sightings, ReadoutChange | None]:
        """Sightings as of first lines, with the focal length found; how they follow the readout time."""
        p = self.problem
        estimated, linked = estimated_images(p.images, before), self.followed.linked()

        def made(readout_time: float) -> Sightings:
            out = sightings
            if readout_time != 0.0:
                delay = line_delays(tracks.pixels[:, 0], readout_time, p.detector.shape)
                out = as_of_first_lines(sightings, estimated, points, delay, linked)
            return out if before.focal is None else stretched_sightings(out, before.focal.stretch)

        seconds = before.readout_time(p.readout_time)
        now = made(seconds)
        if not p.readout_sigma > 0.0:
            return now, None
        by_second = (made(seconds + _READOUT_STEP).tangents - now.tangents) / _READOUT_STEP
        return now, ReadoutChange(frozen(by_second), seconds, p.readout_time, p.readout_sigma)

    def cross_plan(self, poses: FramePoses) -> CrossPlan:
        """How far to look for what stretches share."""
        sigma = np.sqrt(np.einsum("kii->ki", poses.covariance))
        found = np.isfinite(poses.points).all(axis=1)
        heights = poses.points[found]
        prior = HeightPrior(self.problem.surface, 1.0, self.problem.radii)
        above = np.abs(prior.above(heights)[0])
        far = float(np.median(ground_distances(self.problem)))
        # biases of the tables are the same for all stretches, up to where the flight turns
        loose = float(np.median(np.hypot(sigma[:, 3:].max(axis=1), sigma[:, :3].max(axis=1) / far)))
        return CrossPlan(
            float(np.nanquantile(above, 0.99)), min(loose, 0.05), reduction=self.problem.filter_period
        )


def _scattered(tracks: Tracks, poses: FramePoses) -> Tracks:
    """Windows found from afar, as good as residuals of a solution show them to be."""
    assert poses.freedom is not None
    rows = slice(len(tracks))
    return with_scatter(tracks, poses.residual_px[rows], poses.freedom[rows], ~poses.rejected[rows])


def ground_distances(problem: SequenceProblem) -> Array:
    """m (M,) from each frame to the ground in its middle, by the rough poses."""
    far = np.linalg.norm(seen_ground(problem) - problem.images.position, axis=1)
    known = np.isfinite(far)
    return np.where(known, far, np.median(far[known]) if known.any() else np.nan)


def _alike_heights(problem: SequenceProblem, tracks: Tracks) -> float:
    """How many points share one error of the surface, which goes together over the area of a frame."""
    first = np.unique(tracks.point, return_index=True)[1]
    image = tracks.image[first]
    rays = problem.images.world_from_body[image].apply(
        problem.mount.apply(problem.detector.directions(tracks.pixels[first]))
    )
    met = problem.surface.intersect(read_only(problem.images.position[image]), read_only(rays))
    met = met[np.isfinite(met).all(axis=1)]
    if len(met) < 2:
        return 1.0
    _, east, north = level_axes(met.mean(axis=0, keepdims=True), problem.radii)
    side = float(np.nanmedian(ground_distances(problem))) / problem.detector.focal_length_px
    area = float(np.prod(problem.detector.shape)) * side**2
    return points_alike((met - met.mean(axis=0)) @ np.concatenate([east, north]).T, area)


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


def estimated_images(images: Images, poses: FramePoses) -> Images:
    """Images with the poses found."""
    return replace(images, position=poses.position, world_from_body=poses.world_from_body)
