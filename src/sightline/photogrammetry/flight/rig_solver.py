"""Offsets of a rig found in a flight, or in one capture: windows of the first camera in the others, adjusted.

Not here: the flight of the first camera (``solver.py``), files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sightline.errors import EstimationError, InputError
from sightline.geometry.checks import Array, frozen
from sightline.geometry.surface import Surface
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.descent import DivergedError
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig import OFFSETS, RigCamera, RigOffsets, given_offsets
from sightline.photogrammetry.flight.rig_matches import Reach, begin_offsets, find_in_rig, rig_cameras
from sightline.photogrammetry.flight.rig_poses import RigSolution, adjust_rig, rig_noise
from sightline.photogrammetry.flight.solver import SequenceSolver, estimated_images, ground_distances
from sightline.photogrammetry.match_frames import TrackPlan, match_frames
from sightline.photogrammetry.sightings import Tracks, joined

#: rad, and share of the height above ground, by which the pose of one capture is held: it is not sought.
_HELD = 1e-4
#: Share of the height above ground within which ground lies that is known to nothing better; and by which
#: each point of one capture lies off it, which two lenses a hand apart hardly show.
_RELIEF, _ROUGH = 0.1, 0.03
#: Windows of one capture; sigmas beyond which an offset contradicts what was given.
_POINTS, _CONTRADICTED = 400, 4.0
#: Solutions, each with the noise that the residuals of the one before bear out.
_NOISE_ROUNDS = 3
#: Sightings of a camera from which on its offset is found.
_LEAST_SIGHTINGS = 20

#: px; how well it is known how a camera is turned before the adjustment, and by what an offset may be wrong.
_TURN_PX = 3.0
#: What is said of an adjustment that fails.
_APART = "the adjustment of the rig does not converge: "
_CHECK = (
    "what is given of its cameras contradicts their images; check focal lengths, distortion, offsets and "
    "their sigmas in each [[camera]]"
)

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class RigAdjusted:
    """What was found of a rig.

    Attributes
    ----------
    poses : FramePoses
        Of the captures, by all cameras.
    offsets : RigOffsets
    tracks : Tracks
        All sightings; `image` is camera M + capture.
    words : tuple of str
        What a user should know.
    """

    poses: FramePoses
    offsets: RigOffsets
    tracks: Tracks
    words: tuple[str, ...] = ()


def solve_rig(
    problem: SequenceProblem,
    followed: Followed,
    poses: FramePoses,
    tracks: Tracks,
    report: Progress | None = None,
) -> RigAdjusted:
    """Poses of the captures and offsets of the cameras, from a solution of the first camera.

    Parameters
    ----------
    problem : SequenceProblem
        With a `rig`.
    followed : Followed
        Windows of the first camera.
    poses : FramePoses
        Of the first camera.
    tracks : Tracks
        Of it, points of control last.
    report : callable, optional
        Called with how much is done and how much it is.

    Raises
    ------
    EstimationError
        Names the cameras that could not be matched, with numbers.
    """
    images = estimated_images(problem.images, poses)
    surface = _mean_ground(problem, poses.points)
    first = replace(problem.rig[0], detector=poses.detector(problem.detector))
    cameras = (first, *problem.rig[1:])
    offsets, failed = begin_offsets(
        images, cameras, given_offsets(cameras), surface, Reach(_height_range(problem, poses, surface))
    )
    _refuse_unmatched(problem, failed)
    more = find_in_rig(followed, images, poses.points, cameras, offsets, surface, report)
    if more is None:
        raise EstimationError("no followed window was found in another camera of the rig; check the cameras")
    given = whole = joined([tracks, more])
    exact = _exact_words(cameras, offsets)
    solver = SequenceSolver(problem, followed)
    priors = solver.priors(tracks)
    solution = None
    for _ in range(_NOISE_ROUNDS):
        whole = given if solution is None else rig_noise(solution, whole, given, len(cameras), len(problem))
        try:
            solution = adjust_rig(
                problem.images, problem.rig, whole, problem.known_poses, start=poses, begin=offsets,
                priors=priors, points=poses.points,
            )  # fmt: skip
        except DivergedError as error:
            raise EstimationError(f"{_APART}{exact or _CHECK}") from error
        offsets = solution.offsets
    assert solution is not None
    _refuse_unseen(solution.offsets, exact)
    return RigAdjusted(solution.poses, solution.offsets, whole, _words(problem, solution.offsets, exact))


def solve_capture(problem: SequenceProblem) -> RigAdjusted:
    """Offsets of the cameras from one capture: how they are turned; its pose stays as it is known.

    Parameters
    ----------
    problem : SequenceProblem
        Of one frame, with a `rig`.
    """
    cameras, images = problem.rig, problem.images
    if not cameras[0].usable[0]:
        raise EstimationError(f"the image of the first camera cannot be used: {cameras[0].excluded[0]}")
    far = float(ground_distances(problem)[0])
    if not np.isfinite(far):
        raise EstimationError(
            "the capture does not look at the ground; check [surface] height, and positions"
        )
    reach = Reach(max(_RELIEF * far, 2.0 * problem.height_sigma))
    offsets, failed = begin_offsets(images, cameras, given_offsets(cameras), problem.surface, reach)
    _refuse_unmatched(problem, failed)
    sources = [camera.sources[0] for camera in cameras]
    views = rig_cameras(images, cameras, offsets, 0)
    usable = [c for c in range(len(cameras)) if cameras[c].usable[0]]
    plan = TrackPlan(points=_POINTS, height_range=0.02 * far, pointing_error=1e-3, hubs=(0,), least_share=0.1)
    found = match_frames([sources[c] for c in usable], [views[c] for c in usable], problem.surface, plan)
    rows = np.argsort(found.image, kind="stable")
    tracks = Tracks(
        np.array(usable)[found.image[rows]], found.point[rows], found.pixels[rows], found.sigma_px[rows]
    )
    hub = tracks.image == 0
    points = np.full((int(tracks.point.max()) + 1, 3), np.nan)
    points[tracks.point[hub]] = views[0].locate(tracks.pixels[hub], problem.surface)
    priors = PointPriors(HeightPrior(problem.surface, _ROUGH * far, problem.radii), None)
    known = replace(
        problem.known_poses,
        attitude=np.full((1, 3), _HELD), position=np.full((1, 3), _HELD * far), axes=None,
        position_bias=0.0, attitude_bias=0.0, focal_length=0.0,
    )  # fmt: skip
    solution: RigSolution | None = None
    given, exact = tracks, _exact_words(cameras, offsets)
    for _ in range(_NOISE_ROUNDS):
        tracks = given if solution is None else rig_noise(solution, tracks, given, len(cameras), 1)
        try:
            solution = adjust_rig(
                images, cameras, tracks, known, begin=offsets, priors=priors, points=points
            )  # fmt: skip
        except DivergedError as error:
            raise EstimationError(f"{_APART}{exact or _CHECK}") from error
        offsets = solution.offsets
    assert solution is not None
    _refuse_unseen(solution.offsets, exact)
    # the pose was held, not found: it is as rough as its tables
    rough = problem.known.precision()[0][np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])]
    nothing = np.diag(rough) <= 0.0
    covariance = np.linalg.inv(rough + np.diag(nothing.astype(np.float64)))
    covariance[nothing, nothing] = np.inf
    poses = replace(
        solution.poses, position=images.position, world_from_body=images.world_from_body,
        covariance=frozen(covariance[None]), pair_covariance=None,
    )  # fmt: skip
    return RigAdjusted(poses, solution.offsets, tracks, _words(problem, solution.offsets, exact))


def first_camera(found: RigAdjusted, rows: int) -> FramePoses:
    """The poses with the residuals of the first camera alone, whose sightings are the first `rows`."""
    poses = found.poses
    return replace(poses, residual_px=frozen(poses.residual_px[:rows]), rejected=poses.rejected[:rows])


def check_rig(problem: SequenceProblem) -> None:
    """InputError for what a rig cannot have."""
    if problem.readout_time != 0.0 or problem.readout_sigma > 0.0:
        raise InputError(
            "the cameras of a rig are taken to expose all lines at once: readout_time is given for it; leave "
            "it out, or georeference each camera by itself"
        )


def _words(problem: SequenceProblem, offsets: RigOffsets, exact: str) -> tuple[str, ...]:
    """What a user should know: offsets that contradict what was given, exactly or not."""
    return (*((exact,) if exact else ()), *offset_words(problem, offsets))


def offset_words(problem: SequenceProblem, offsets: RigOffsets) -> tuple[str, ...]:
    """Offsets that contradict what was given."""
    out = []
    for c, camera in enumerate(problem.rig):
        turn = (camera.orientation.inv() * offsets.orientation[c]).as_rotvec()
        moved = offsets.position[c] - camera.position
        departed = np.concatenate([turn, moved, [offsets.stretch[c]]])
        prior = offsets.prior_sigma[c]
        for k, name in enumerate(OFFSETS):
            if prior[k] > 0.0 and abs(departed[k]) > _CONTRADICTED * prior[k]:
                size = abs(departed[k]) / prior[k]
                out.append(
                    f"camera {camera.name}: its {name} offset was found {size:.1f} of its sigmas from what "
                    f"was {camera.prior}: {_size(k, departed[k])} away, known to {_size(k, prior[k])}"
                )
    return tuple(out)


def _size(offset: int, value: float) -> str:
    """An offset in the unit that it is thought of in."""
    if offset < 3:
        return f"{np.degrees(value):.3g} degrees"
    return f"{1e3 * value:.3g} mm" if offset < 6 else f"{100.0 * value:.2g} %"


def _exact_words(cameras: Sequence[RigCamera], begun: RigOffsets) -> str:
    """Cameras whose images show another turn than that given as exact; "" where there are none."""
    words = []
    for c, camera in enumerate(cameras[1:], start=1):
        angle = float((camera.orientation.inv() * begun.orientation[c]).magnitude())
        if camera.orientation_sigma == 0.0 and angle * camera.detector.focal_length_px > _TURN_PX:
            words.append(f"[[camera]] {camera.name} as turned by {np.degrees(angle):.3g} degrees from that")
    if not words:
        return ""
    return (
        "orientation_offset_sigma = 0 gives orientation_offset as exact, and the images show "
        f"{', '.join(words)}: give a sigma above 0, or correct the offset"
    )


def _refuse_unmatched(problem: SequenceProblem, failed: dict[str, str]) -> None:
    """EstimationError that names cameras whose turn was not found."""
    if failed:
        held = {camera.name for camera in problem.rig if camera.orientation_sigma == 0.0}
        said = "; ".join(
            f"camera {name}: {words}"
            + (", its orientation_offset_sigma = 0 says that its offset is exact" if name in held else "")
            for name, words in failed.items()
        )
        raise EstimationError(
            f"{len(failed)} of {len(problem.rig)} cameras of the rig could not be matched with the others: "
            f"{said}. Check which image is of which capture, that the cameras expose together, their focal "
            "lengths and orientation_offset_sigma; or leave the camera out"
        )


def _refuse_unseen(offsets: RigOffsets, exact: str) -> None:
    """EstimationError for a camera with hardly any good sighting."""
    few = np.flatnonzero(offsets.sightings < _LEAST_SIGHTINGS)
    if len(few):
        c = int(few[0])
        raise EstimationError(
            f"camera {offsets.names[c]}: {int(offsets.sightings[c])} windows of it go together with those of "
            f"the others, {_LEAST_SIGHTINGS} are needed; "
            + (exact or "check its images and its lens, or leave it out")
        )


def _mean_ground(problem: SequenceProblem, points: Array) -> Surface:
    """The given surface, raised to where the points lie on the whole."""
    found = points[np.isfinite(points).all(axis=1)]
    if not len(found):
        return problem.surface
    above = HeightPrior(problem.surface, 1.0, problem.radii).above(frozen(found))[0]
    middle = float(np.nanmedian(above)) if np.isfinite(above).any() else 0.0
    return problem.surface.raised(middle)


def _height_range(problem: SequenceProblem, poses: FramePoses, surface: Surface) -> float:
    """m; nearly all points lie within this of the surface."""
    found = poses.points[np.isfinite(poses.points).all(axis=1)]
    above = HeightPrior(surface, 1.0, problem.radii).above(frozen(found))[0]
    return float(np.nanquantile(np.abs(above), 0.98))


__all__ = ["RigAdjusted", "check_rig", "first_camera", "offset_words", "solve_capture", "solve_rig"]
