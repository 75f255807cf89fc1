"""S1 for a matrix instrument: the attitude of every frame from the frames themselves, as one call.

``recover_frame_attitude`` reads like figure 15 of the document, with frames in place of detector
lines: coarse shift, select and predict windows, match, residual, estimate, and again with windows
laid by the cameras found, until it no longer changes. Lens and clock may be part of the estimate.

Not here: detector lines (``line_of_sight.py``), files (``io/``), the report (``report/``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError, computes
from sightline.execution import Progress, one_blas_thread, silent, steps_of
from sightline.geometry.checks import not_negative
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Frame, LensKnowledge
from sightline.motion.frames.hidden import absolute_sigma, hidden_directions, relative_covariance, without
from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.passes import (
    FrameOptions,
    FramePasses,
    PassState,
    first_pass,
    lags_owned,
    masked,
    next_pass,
    start,
)
from sightline.motion.frames.solve import FrameEstimate, time_statics
from sightline.motion.frames.start import coarse_shifts, turn_about_axis, turned_mount
from sightline.motion.frames.ties import FrameTies
from sightline.motion.measure.stars import StarRecord
from sightline.motion.results import LineOfSight, StaticEstimate, TimeCovariance, without_common_ground
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.statics import frame_statics
from sightline.result import makes_result
from sightline.stages import Stages

Array = NDArray[np.float64]

#: Sigmas of k1, k2, p1, p2, k3 in that of k1.
DISTORTION_SHARES = (1.0, 1.0, 0.05, 0.05, 1.0)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FrameAttitude(LineOfSight):
    """Result for frames: a `LineOfSight` at the frames' times, with the dense estimate behind it.

    Attributes
    ----------
    estimate : FrameEstimate
        All unknowns with their covariance.
    stars : tuple of FrameStar
        The matches of the last pass.
    """

    estimate: FrameEstimate
    stars: tuple[FrameStar, ...]


@makes_result
@one_blas_thread
@computes("attitudes of the frames")
def recover_frame_attitude(
    frames: Sequence[Frame],
    surface: Surface,
    *,
    lens: LensKnowledge | None = None,
    height_sigma: float = 0.0,
    sensors: Sequence[AttitudeSensor] = (),
    control_points: ControlSightings | None = None,
    options: FrameOptions | None = None,
    progress: Progress | None = None,
    stages: Stages | None = None,
) -> FrameAttitude:
    """Attitude of the platform at every frame of one camera, with covariance.

    Parameters
    ----------
    frames : sequence of Frame
        Two or more exposures in the order of their times, neighbours overlapping, with their nominal cameras.
    surface : Surface
        What the lines of sight meet.
    lens : LensKnowledge, optional
        How well the nominal lens is known; exactly by default. Where its distortion is free, a smooth field
        of shifts over the detector takes what the constants leave (``motion/frames/lens_field.py``).
    height_sigma : float
        m; what is not known of the surface's height: heights of all windows are then estimated too.
    sensors : sequence of AttitudeSensor
        Star trackers and gyros; readings between frames count as far as the body went evenly there.
    control_points : ControlSightings, optional
    options : FrameOptions, optional
    progress : callable, optional
        Called with what is being done, in words.
    stages : Stages, optional
        What finished passes of a run that was stopped have matched, and where that of this run is kept.

    Returns
    -------
    FrameAttitude

    Raises
    ------
    InputError
        Fewer than two frames, times out of order, or images that do not fit the camera.
    EstimationError
        Neighbours share no ground, or the mount turns the frames another way than the ground moves.

    Notes
    -----
    S1, figure 15, for a matrix detector: every window of a frame gives two equations per partner in three
    angles of either frame; the instants are those of the frames.
    """
    tell = progress or silent
    sequence = _prepare(frames, surface, lens or LensKnowledge(), height_sigma, options or FrameOptions())
    ties = FrameTies.of([frame.camera for frame in sequence.frames], sensors, control_points)
    stages = stages or Stages()
    given = [sequence.frames, surface, sequence.statics, height_sigma, sequence.options]
    stages.depend([*given, sensors, control_points] if ties is not None else given)
    tell("shift between neighbouring frames")
    shifts = coarse_shifts(sequence.images)
    x = start(sequence, shifts)
    # control points are rows once the frames are near: of a start they would be tens of pixels off
    sequence = replace(masked(sequence, shifts), ties=ties)
    state = first_pass(sequence, x, stages, steps_of(tell, "first pass: wide search"))
    changes: list[float] = []
    for number in range(sequence.options.passes):
        most = sequence.options.passes
        stage = f"pass {number + 1} of at most {most}: matching"
        refined = next_pass(sequence, state, number, stages, steps_of(tell, stage))
        changes.append(_change(state.estimate, refined.estimate, _scale(refined.estimate)))
        state = refined
        if changes[-1] < sequence.options.tolerance:
            break
    return _result(sequence, lags_owned(surface, state, _scale(state.estimate)), changes)


def mount_by_motion(frames: Sequence[Frame], surface: Surface) -> FixedMount:
    """The mount of the first frame's camera, turned about the optical axis until the ground moves as seen.

    Parameters
    ----------
    frames : sequence of Frame
        Neighbours overlapping; their mount may be off by any angle about the axis.
    surface : Surface

    Raises
    ------
    InputError
        If the pointing is not a fixed mount.
    EstimationError
        If no two neighbours show the same ground.
    """
    mount = frames[0].camera.pointing
    if not isinstance(mount, FixedMount):
        raise InputError(f"`frames` need a FixedMount, got {type(mount).__name__}; give their mount by hand")
    shifts = coarse_shifts([frame.image for frame in frames])
    turn, _ = turn_about_axis(shifts, [frame.camera for frame in frames], surface)
    return turned_mount(mount, turn)


def _prepare(
    frames: Sequence[Frame], surface: Surface, lens: LensKnowledge, height_sigma: float, options: FrameOptions
) -> FramePasses:
    """Check the input and list what is unknown besides the angles."""
    not_negative(height_sigma, "height_sigma", "m")
    if len(frames) < 2:
        raise InputError(
            f"one frame cannot show motion: {len(frames)} given; two or more that see the same ground are "
            "needed; add a [[frame]]"
        )
    for frame in frames:
        if tuple(frame.image.shape) != tuple(frame.camera.shape):
            raise InputError(
                f"image and camera of frame {frame.name!r} differ: image {frame.image.shape}, camera "
                f"{frame.camera.shape} (lines, columns); give the camera the size of its image"
            )
    for first, second in pairwise(frames):
        if not second.camera.t > first.camera.t:
            raise InputError(
                f"frames must be in the order of their times: {second.name!r} at t = {second.camera.t:g} s "
                f"follows {first.name!r} at {first.camera.t:g} s; sort them"
            )
    names = [frame.name for frame in frames]
    statics = time_statics(names, [frame.time_sigma for frame in frames]) + frame_statics(
        names,
        focal_length_sigma_px=lens.focal_length_sigma_px,
        principal_point_sigma_px=(lens.principal_point_sigma_px, lens.principal_point_sigma_px),
        distortion_sigma=tuple(share * lens.distortion_sigma for share in DISTORTION_SHARES),
    )
    images = tuple(frame.image for frame in frames)
    free = lens.distortion_sigma > 0.0
    return FramePasses(tuple(frames), images, surface, tuple(statics), free, height_sigma, options)


def _scale(estimate: FrameEstimate) -> Array:
    """(3,) rad; one pixel of roll, of pitch, and of yaw at the edge of the field."""
    detector = estimate.cameras[0].detector
    ifov = 1.0 / detector.focal_length_px
    return np.array([ifov, ifov, 2.0 / (detector.shape[1] - 1)])


def _change(old: FrameEstimate, new: FrameEstimate, scale: Array) -> float:
    """Change of the attitudes in units of their sigma, hidden part left out (worst axis)."""
    n = new.unknowns.frames
    t = np.array([camera.t for camera in new.cameras])
    directions, _ = hidden_directions(new.angle_covariance, t, scale)
    moved = without(new.angles - old.angles, directions, scale)
    left = relative_covariance(new.angle_covariance, directions, scale).reshape(n, 3, n, 3)
    variance = np.einsum("npnp->np", left).mean(axis=0)
    return float(np.sqrt((moved**2).mean(axis=0) / np.maximum(variance, 1e-30)).max())


def _both_axes(covariance: Array) -> Array:
    """Covariance (2K, 2K) of line and column from that of the pairs (K, K), alike on both."""
    return np.asarray(np.kron(covariance, np.eye(2)), dtype=np.float64)


def _result(sequence: FramePasses, state: PassState, changes: list[float]) -> FrameAttitude:
    """The last state as a result at the frames."""
    estimate, unknowns = state.estimate, state.estimate.unknowns
    n, scale = unknowns.frames, _scale(state.estimate)
    t = np.array([camera.t for camera in estimate.cameras])
    directions, names = hidden_directions(estimate.angle_covariance, t, scale)
    relative = relative_covariance(estimate.angle_covariance, directions, scale)
    blocks = np.stack([relative[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    prior = np.asarray(np.linalg.inv(unknowns.prior_precision()[: 3 * n, : 3 * n]), dtype=np.float64)
    sigmas = np.sqrt(np.diag(estimate.covariance))[3 * n : unknowns.lens]
    statics = tuple(
        StaticEstimate(p.name, p.unit, float(value), float(sigma), p.sigma)
        for p, value, sigma in zip(unknowns.statics, estimate.x[3 * n : unknowns.lens], sigmas, strict=True)
    )
    matched = [
        StarRecord(line.with_correlation(_both_axes(estimate.noise.of(star.lags))), star.status, star.score)
        for star, line in zip(state.stars, estimate.stars, strict=True)
    ]
    window = sequence.options.window
    records = tuple(without_common_ground(r, estimate.cameras, sequence.surface, window) for r in matched)
    nominal = [frame.camera for frame in sequence.frames]
    detector = estimate.cameras[0].detector
    observed = _observed(state.stars, n)
    return FrameAttitude(
        motion=Motion(t, estimate.angles, blocks),
        absolute_sigma=absolute_sigma(estimate.angle_covariance, prior),
        hidden=directions,
        hidden_names=names,
        observed=observed,
        scale=scale,
        ifov=1.0 / detector.focal_length_px,
        half_field=math.atan((detector.shape[1] - 1) / 2.0 / detector.focal_length_px),
        statics=statics,
        spectra=None,
        records=records,
        before_px=tuple(star.residuals(nominal, sequence.surface) for star in state.stars),
        after_px=tuple(estimate.clean_px),
        cameras=tuple(estimate.cameras),
        image_names=tuple(frame.name for frame in sequence.frames),
        changes=tuple(changes),
        band=TimeCovariance(t, estimate.angles, _lower_band(relative)),
        warnings=_warnings(state, observed, blocks, scale, changes),
        sensors=() if unknowns.ties is None else unknowns.ties.uses(estimate.x, estimate.covariance),
        estimate=estimate,
        stars=state.stars,
    )


def _lower_band(matrix: Array) -> Array:
    """A full symmetric matrix in lower band storage."""
    size = len(matrix)
    out = np.zeros((size, size))
    for d in range(size):
        out[d, : size - d] = np.diag(matrix, -d)
    return out


def _observed(stars: Sequence[FrameStar], count: int) -> NDArray[np.bool_]:
    """(count,) frames that a kept match touches."""
    out = np.zeros(count, dtype=bool)
    for star in stars:
        seen = star.present.any(axis=0)
        out[star.hub] |= bool(seen.any())
        out[np.array(star.images)[seen]] = True
    return out


def _warnings(
    state: PassState, observed: NDArray[np.bool_], covariance: Array, scale: Array, changes: list[float]
) -> tuple[str, ...]:
    """What a user should know before trusting the numbers."""
    out = []
    if changes and changes[-1] > 1.0:
        out.append(
            f"the passes did not settle: the last changed the attitudes by {changes[-1]:.1f} sigma; check "
            "the camera description, or allow more with [matching] passes"
        )
    if not observed.all():
        unseen = (~observed).sum()
        out.append(f"{unseen} of {len(observed)} frames are seen by no match: only the prior speaks there")
    sigma = np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]].mean(axis=0)) / scale
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        if sigma[axis] > 1.0:
            out.append(
                f"{name} from frame to frame is known to {sigma[axis]:.2g} px only: uncertain times, or a "
                "free lens, imitate it; give times or focal length with a smaller sigma"
            )
    turns = state.estimate.unknowns.turns
    if turns is not None:
        found = ", ".join(
            f"{name} by {turns.sigma[axis] / scale[axis]:.2g} px (chi-square {turns.chi_square[axis]:.0f} of "
            f"{len(turns.lags) - 1} numbers)"
            for axis, name in enumerate(("roll", "pitch", "yaw"))
            if turns.disagree[axis]
        )
        out.append(
            f"pairs of frames farther apart tell other attitudes than neighbours do: {found}, alike in all "
            "pairs of one lag; it is estimated and part of every sigma; clouds and dust that drift are a "
            "cause: mask them"
        )
    field = state.estimate.unknowns.field
    if field is not None and field.sigma_px > 0.05:
        out.append(
            f"the lens departs from its constants by {field.sigma_px:.2f} px, a smooth pattern fixed to the "
            "detector: it is estimated and part of every sigma; a calibration of the lens would say more"
        )
    return tuple(out)
