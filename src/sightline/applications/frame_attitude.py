"""S1 for a matrix instrument: the attitude of every frame from the frames themselves, as one call.

``recover_frame_attitude`` reads like figure 15 of the document, with frames in place of detector
lines: coarse shift, select and predict windows, match, residual, estimate, and again with windows
laid by the cameras found, until it no longer changes. Lens and clock may be part of the estimate.

Not here: detector lines (``line_of_sight.py``), files (``io/``), the report (``report/``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight, StaticEstimate, TimeCovariance
from sightline.errors import EstimationError, InputError
from sightline.execution import one_blas_thread
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ImageSource, MaskedImage
from sightline.motion.band import Frame, LensKnowledge
from sightline.motion.frame_hidden import absolute_sigma, hidden_directions, relative_covariance, without
from sightline.motion.frame_matches import FramePlan, FrameStar, match_frames
from sightline.motion.frame_noise import FrameNoise, GroundField, learn_field, learn_noise
from sightline.motion.frame_start import (
    MAX_TURN,
    STILL_SHIFT_PX,
    CoarseShift,
    coarse_shifts,
    standing_still,
    turn_about_axis,
    turned_mount,
)
from sightline.motion.frames import FrameEstimate, FrameUnknowns, solve_frames, time_statics
from sightline.motion.lens_field import LensField
from sightline.motion.match_noise import robust_weights
from sightline.motion.predict import StaticParameter
from sightline.motion.stars import StarRecord
from sightline.motion.statics import frame_statics

Array = NDArray[np.float64]
Progress = Callable[[str], None]

#: Prior of the attitudes (rad: each frame, all together) while nothing but coarse shifts speak.
START_SIGMAS = (0.005, 0.02)
#: Matches of the first pass are believed to so many times the matcher's sigma: lens and relief are not known
#: yet.
FIRST_SCALE = 10.0
#: Sigmas of k1, k2, p1, p2, k3 in that of k1.
DISTORTION_SHARES = (1.0, 1.0, 0.05, 0.05, 1.0)
#: Sigma of the lens field before the matches have spoken (px).
FIELD_START_PX = 0.1
#: Most windows of all frames together when heights are unknown (their covariance is dense).
MAX_HEIGHTS = 2400
#: Start value of drift (clouds) in heights of the same effect, as a share of the relief's.
DRIFT_SHARE = 0.1
#: Windows whose drift stands so many robust sigmas out of that of the others lie on clouds.
DRIFTING = 3.5
#: Rounds of solving, weighing and learning within a pass.
ROUNDS = 3


@dataclass(frozen=True)
class FrameOptions:
    """How the frames are looked at.

    Attributes
    ----------
    first_window, window : (lines, columns)
        px; of the first, searching pass, and of the others.
    windows : int
        Windows per frame, about; evenly spread.
    step : int or None
        px between windows, in place of `windows`.
    first_search_px, search_px : int
        px; half-range of the search in the first pass, and in the others.
    lags : tuple of int
        Frames ahead in which each frame is looked for, as long as they overlap.
    passes : int
        At most so many passes after the first.
    tolerance : float
        Stop when the attitudes change by less than this part of their sigma.
    """

    first_window: tuple[int, int] = (48, 48)
    window: tuple[int, int] = (32, 32)
    windows: int = 190
    step: int | None = None
    first_search_px: int = 24
    search_px: int = 6
    lags: tuple[int, ...] = (1, 2, 3, 4, 5)
    passes: int = 4
    tolerance: float = 0.2

    @classmethod
    def from_matching(cls, matching: Mapping[str, Any]) -> FrameOptions:
        """Options of a ``[matching]`` table, whose names are those for strips."""
        given = dict(matching)
        if "search_px" in given:
            given["first_search_px"] = max(given.pop("search_px"))
        return cls(**given)


@dataclass(frozen=True, eq=False, kw_only=True)
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


@dataclass(frozen=True, eq=False)
class _Sequence:
    """What does not change from pass to pass."""

    frames: tuple[Frame, ...]
    images: tuple[ImageSource, ...]
    surface: Surface
    statics: tuple[StaticParameter, ...]
    free_lens: bool
    height_sigma: float
    options: FrameOptions

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns) of a frame."""
        return self.images[0].shape

    def unknowns(self, field: LensField | None) -> FrameUnknowns:
        """All unknowns, with a lens field where the lens is not known."""
        return FrameUnknowns(tuple(frame.camera for frame in self.frames), self.statics, field)

    def step(self, window: tuple[int, int]) -> int:
        """Distance of windows (px) that gives about the wanted number of them."""
        if self.options.step is not None:
            return self.options.step
        wanted = self.options.windows
        if self.height_sigma > 0.0:
            wanted = min(wanted, max(MAX_HEIGHTS // len(self.frames), 24))
        return max(8, round(math.sqrt((self.shape[0] - window[0]) * (self.shape[1] - window[1]) / wanted)))


@dataclass(frozen=True, eq=False)
class _State:
    """What one pass hands to the next."""

    estimate: FrameEstimate
    stars: tuple[FrameStar, ...]


@one_blas_thread
def recover_frame_attitude(
    frames: Sequence[Frame],
    surface: Surface,
    *,
    lens: LensKnowledge | None = None,
    height_sigma: float = 0.0,
    options: FrameOptions | None = None,
    progress: Progress | None = None,
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
        of shifts over the detector takes what the constants leave (``motion/lens_field.py``).
    height_sigma : float
        m; what is not known of the surface's height: heights of all windows are then estimated too.
    options : FrameOptions, optional
    progress : callable, optional
        Told in words what is being done.

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
    tell = progress or (lambda text: None)
    sequence = _prepare(frames, surface, lens or LensKnowledge(), height_sigma, options or FrameOptions())
    tell("shift between neighbouring frames")
    shifts = coarse_shifts(sequence.images)
    x = _start(sequence, shifts)
    sequence = _masked(sequence, shifts)
    tell("first pass: wide search")
    state = _first_pass(sequence, x)
    changes: list[float] = []
    for number in range(sequence.options.passes):
        tell(f"pass {number + 1}: matching windows laid by the cameras found")
        refined = _pass(sequence, state, number)
        changes.append(_change(state.estimate, refined.estimate, _scale(refined.estimate)))
        state = refined
        if changes[-1] < sequence.options.tolerance:
            break
    return _result(sequence, state, changes)


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
) -> _Sequence:
    """Check the input and list what is unknown besides the angles."""
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
    return _Sequence(tuple(frames), images, surface, tuple(statics), free, height_sigma, options)


def _masked(sequence: _Sequence, shifts: Sequence[CoarseShift]) -> _Sequence:
    """The frames with what stands still in them masked."""
    if float(np.median([np.linalg.norm(shift.shift_px) for shift in shifts])) < STILL_SHIFT_PX:
        return sequence
    still = standing_still(sequence.images)
    if still is None:
        return sequence
    return replace(sequence, images=tuple(MaskedImage(image, still) for image in sequence.images))


def _start(sequence: _Sequence, shifts: Sequence[CoarseShift]) -> Array:
    """Angles, times and focal length from coarse shifts of whole frames."""
    cameras = [frame.camera for frame in sequence.frames]
    turn, scale = turn_about_axis(shifts, cameras, sequence.surface)
    if abs(turn) > MAX_TURN:
        raise EstimationError(_wrong_mount(cameras[0].pointing, turn))
    unknowns = sequence.unknowns(None)
    at = [k for k, parameter in enumerate(sequence.statics) if parameter.name == "focal length"]
    if not at and not 0.5 < scale < 2.0:
        raise EstimationError(
            f"the frames move {scale:.2f} times as far as focal length, height and speed say; correct them, "
            'or set focal_length_px = "estimate"'
        )
    x = np.zeros(unknowns.size)
    if at:
        x[3 * unknowns.frames + at[0]] = (scale - 1.0) * cameras[0].detector.focal_length_px
    coarse = FrameUnknowns(unknowns.nominal, unknowns.statics, None, *START_SIGMAS)
    stars = [_coarse_star(shift, sequence.shape) for shift in shifts]
    return solve_frames(stars, coarse, sequence.surface, FrameNoise.start((1,)), x, steps=8).x


def _wrong_mount(mount: object, turn: float) -> str:
    """What to write in the TOML where the ground moves another way than the mount says."""
    advice = "give the camera's mount"
    if isinstance(mount, FixedMount):
        quaternion = ", ".join(f"{v:.6g}" for v in turned_mount(mount, turn).body_from_camera.as_quat())
        advice = f"set [camera] body_from_camera = [{quaternion}]"
    return (
        f"the ground moves through the frames {math.degrees(turn):.0f} degrees away from where the mount of "
        f"the camera says; up to {math.degrees(MAX_TURN):.0f} degrees are recovered as yaw; {advice}"
    )


def _coarse_star(shift: CoarseShift, shape: tuple[int, int]) -> FrameStar:
    """A coarse shift as one match of two frames."""
    a, b = shift.points(shape)
    covariance = (shift.sigma_px / 2.0) ** 2 * np.eye(2)
    one = np.ones((1, 1))
    return FrameStar(
        shift.hub,
        (shift.partner,),
        (1, 1),
        (1, 1),
        a[None],
        b[None, None],
        covariance[None, None],
        np.zeros((1, 1), dtype=np.uint8),
        one,
        one,
    )


def _first_pass(sequence: _Sequence, x: Array) -> _State:
    """Neighbours matched with large windows and a wide search."""
    options, unknowns = sequence.options, sequence.unknowns(None)
    plan = FramePlan(
        options.first_window, sequence.step(options.first_window), options.first_search_px, options.lags[:1]
    )
    stars = match_frames(sequence.images, unknowns.cameras(x), sequence.surface, plan)
    kept = sum(int(star.present.sum()) for star in stars)
    if kept < 20:
        raise EstimationError(
            f"neighbouring frames do not match: {kept} windows kept of "
            f"{sum(star.present.size for star in stars)}; check that they overlap, that clouds leave ground "
            "to be seen, and the order of the frames"
        )
    noise = FrameNoise.start(plan.lags, scale=FIRST_SCALE)
    for _ in range(ROUNDS):
        estimate = solve_frames(stars, unknowns, sequence.surface, noise, x)
        x = estimate.x
        stars = _weighed(stars, estimate)
    return _State(estimate, tuple(stars))


def _pass(sequence: _Sequence, before: _State, number: int) -> _State:
    """Match again at all lags with the cameras found; solve, weigh, learn the errors."""
    options = sequence.options
    plan = FramePlan(options.window, sequence.step(options.window), options.search_px, options.lags)
    stars = match_frames(sequence.images, before.estimate.cameras, sequence.surface, plan)
    fields = _ground_fields(sequence, before.estimate, plan)
    if number == 0:
        field = LensField.over(sequence.shape, FIELD_START_PX) if sequence.free_lens else None
        unknowns = sequence.unknowns(field)
        x = np.concatenate([before.estimate.x, np.zeros(unknowns.size - len(before.estimate.x))])
        noise = FrameNoise.start(options.lags, fields, scale=3.0)
    else:
        unknowns, x = before.estimate.unknowns, before.estimate.x
        noise = replace(before.estimate.noise, fields=fields)
    drifting = [np.zeros(len(star.pixels), dtype=bool) for star in stars]
    for _ in range(ROUNDS):
        estimate = solve_frames(stars, unknowns, sequence.surface, noise, x, steps=2)
        x = estimate.x
        drifting = _drifting(estimate, drifting)
        stars = _weighed(stars, estimate, drifting)
        noise = _learned(estimate, options.lags)
        if unknowns.field is not None:
            rows = slice(unknowns.lens, None)
            unknowns = replace(
                unknowns, field=unknowns.field.learned(x[rows], estimate.covariance[rows, rows])
            )
    estimate = solve_frames(stars, unknowns, sequence.surface, noise, x, steps=2)
    return _State(estimate, tuple(stars))


def _weighed(
    stars: Sequence[FrameStar], estimate: FrameEstimate, drifting: Sequence[NDArray[np.bool_]] | None = None
) -> list[FrameStar]:
    """Stars with robust weights from the residuals of an estimate; windows on drifting ground have none."""
    out = []
    for k, (star, line, clean) in enumerate(zip(stars, estimate.stars, estimate.clean_px, strict=True)):
        weight = robust_weights(replace(line, weight=np.ones_like(line.weight)), clean)
        if drifting is not None:
            weight = np.where(drifting[k][:, None], 0.0, weight)
        out.append(star.with_weight(weight))
    return out


def _drifting(estimate: FrameEstimate, before: list[NDArray[np.bool_]]) -> list[NDArray[np.bool_]]:
    """Windows on clouds: their drift, smoothed over neighbours, stands far out of what still ground shows."""
    if not estimate.fields:
        return before
    field = estimate.fields[1]
    used = field.precision > 0
    centre = float(np.median(field.value[used]))
    spread = 1.4826 * float(np.median(np.abs(field.value[used] - centre)))
    far = used & (np.abs(field.value - centre) > DRIFTING * max(spread, 1e-9))
    return [old | new for old, new in zip(before, estimate.per_star(far), strict=True)]


def _ground_fields(sequence: _Sequence, estimate: FrameEstimate, plan: FramePlan) -> tuple[GroundField, ...]:
    """Laws of unknown relief and of drift to start from; none where heights are known."""
    if sequence.height_sigma <= 0.0:
        return ()
    camera = estimate.cameras[0]
    middle = (np.array(camera.shape) - 1) / 2.0
    ground = camera.locate(np.stack([middle, middle + np.array([0.0, 1.0])]), sequence.surface)
    pixel = float(np.linalg.norm(ground[1] - ground[0]))
    sigma = sequence.height_sigma
    length, rough = 0.1 * max(camera.shape) * pixel, 0.5 * plan.window[0] * pixel
    return (
        GroundField(sigma, sigma, length, 0.2 * sigma, rough),
        # the ground as a whole stands still
        GroundField(0.0, DRIFT_SHARE * sigma, length, 0.5 * DRIFT_SHARE * sigma, rough),
    )


def _learned(estimate: FrameEstimate, lags: Sequence[int]) -> FrameNoise:
    """Errors of the matches and the laws of relief and drift as the residuals show them."""
    variance = estimate.fields[1].variance if estimate.fields else np.zeros(len(estimate.ground))
    noise = learn_noise(estimate.stars, estimate.clean_px, estimate.per_star(variance), lags, estimate.noise)
    fields = tuple(
        learn_field(estimate.ground, found.alone, found.precision, law)
        for found, law in zip(estimate.fields, noise.fields, strict=True)
    )
    return replace(noise, fields=fields)


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


def _result(sequence: _Sequence, state: _State, changes: list[float]) -> FrameAttitude:
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
    records = tuple(
        StarRecord(line.with_correlation(_both_axes(estimate.noise.of(star.lags))), star.status, star.score)
        for star, line in zip(state.stars, estimate.stars, strict=True)
    )
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
    state: _State, observed: NDArray[np.bool_], covariance: Array, scale: Array, changes: list[float]
) -> tuple[str, ...]:
    """What a user should know before trusting the numbers."""
    out = []
    if changes and changes[-1] > 1.0:
        out.append(
            f"the passes did not settle: the last changed the attitudes by {changes[-1]:.1f} sigma; allow "
            "more passes or check the camera description"
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
    field = state.estimate.unknowns.field
    if field is not None and field.sigma_px > 0.05:
        out.append(
            f"the lens departs from its constants by {field.sigma_px:.2f} px, a smooth pattern fixed to the "
            "detector: it is estimated and part of every sigma; a calibration of the lens would say more"
        )
    return tuple(out)
