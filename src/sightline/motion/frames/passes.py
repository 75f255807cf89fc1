"""The passes of the recovery of frames: coarse start, wide search, then matching and solving in turns.

Not here: the call and its result (``applications/frame_attitude.py``), the estimate itself
(``motion/frames/solve.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigma
from sightline.execution import Step
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource, MaskedImage
from sightline.motion.band import Frame
from sightline.motion.frames.lag_turns import LagTurns
from sightline.motion.frames.lens_field import LensField
from sightline.motion.frames.matches import FramePlan, FrameStar, kept_matches, match_neighbours
from sightline.motion.frames.noise import FrameNoise, GroundField, learn_field, learn_noise
from sightline.motion.frames.solve import FrameEstimate, FrameUnknowns, solve_frames
from sightline.motion.frames.start import (
    MAX_TURN,
    STILL_SHIFT_PX,
    CoarseShift,
    standing_still,
    turn_about_axis,
    turned_mount,
)
from sightline.motion.frames.ties import FrameTies
from sightline.motion.measure.consensus import ground_weights
from sightline.motion.measure.match_noise import robust_weights
from sightline.motion.measure.predict import StaticParameter
from sightline.stages import Stages

Array = NDArray[np.float64]

#: Prior of the attitudes (rad: each frame, all together) while nothing but coarse shifts speak.
START_SIGMAS = (0.005, 0.02)
#: Matches of the first pass are believed to so many times the matcher's sigma: lens and relief are not known
#: yet.
FIRST_SCALE = 10.0
#: Sigma of the lens field before the matches have spoken (px).
FIELD_START_PX = 0.1
#: Most windows of all frames together when heights are unknown (their covariance is dense).
MAX_HEIGHTS = 2400
#: Start value of drift (clouds) in heights of the same effect, as a share of the relief's.
DRIFT_SHARE = 0.1
#: Turns (px) of all pairs of one lag: sigma while they are let go, and the least one where lags disagree.
FREE_TURN_PX, LEAST_TURN_PX = 1.0, 1e-3
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
    drifting : float
        Windows whose drift stands so many robust sigmas out of that of the others lie on clouds, and are left
        out. 3.5: one good window in 2000 is beyond; lower it over broken cloud, raise it over rough relief.
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
    drifting: float = 3.5

    def spacing(
        self, window: tuple[int, int], shape: tuple[int, int], frames: int, height_sigma: float
    ) -> int:
        """Distance of windows (px) in so many frames of a shape: `step`, or for about as many as wanted."""
        if self.step is not None:
            return self.step
        wanted = self.windows
        if height_sigma > 0.0:
            wanted = min(wanted, max(MAX_HEIGHTS // frames, 24))
        # a frame without room for a window is refused where it is matched
        room = max(shape[0] - window[0], 1) * max(shape[1] - window[1], 1)
        return max(8, round(math.sqrt(room / wanted)))

    @classmethod
    def from_matching(cls, matching: Mapping[str, Any]) -> FrameOptions:
        """Options of a ``[matching]`` table, whose names are those for strips."""
        given = dict(matching)
        if "search_px" in given:
            given["first_search_px"] = max(given.pop("search_px"))
        return cls(**given)


@dataclass(frozen=True, eq=False)
class FramePasses:
    """What does not change from pass to pass."""

    frames: tuple[Frame, ...]
    images: tuple[ImageSource, ...]
    surface: Surface
    statics: tuple[StaticParameter, ...]
    free_lens: bool
    height_sigma: float
    options: FrameOptions
    ties: FrameTies | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns) of a frame."""
        return self.images[0].shape

    def unknowns(self, field: LensField | None) -> FrameUnknowns:
        """All unknowns, with a lens field where the lens is not known."""
        return FrameUnknowns(
            tuple(frame.camera for frame in self.frames), self.statics, field, ties=self.ties
        )

    def step(self, window: tuple[int, int]) -> int:
        """Distance of windows (px) that gives about the wanted number of them."""
        return self.options.spacing(window, self.shape, len(self.frames), self.height_sigma)


@dataclass(frozen=True, eq=False)
class PassState:
    """What one pass hands to the next.

    `drifting` are the windows (G,) of each hub that lie on clouds: what was found so stays so, or passes do
    not settle. None while lens and relief are not known yet.
    """

    estimate: FrameEstimate
    stars: tuple[FrameStar, ...]
    drifting: Mapping[int, NDArray[np.bool_]] = field(default_factory=dict)


def masked(sequence: FramePasses, shifts: Sequence[CoarseShift]) -> FramePasses:
    """The frames with what stands still in them masked."""
    if float(np.median([np.linalg.norm(shift.shift_px) for shift in shifts])) < STILL_SHIFT_PX:
        return sequence
    still = standing_still(sequence.images)
    if still is None:
        return sequence
    return replace(sequence, images=tuple(MaskedImage(image, still) for image in sequence.images))


def start(sequence: FramePasses, shifts: Sequence[CoarseShift]) -> Array:
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


def first_pass(sequence: FramePasses, x: Array, stages: Stages, step: Step) -> PassState:
    """Neighbours matched with large windows and a wide search."""
    options, unknowns = sequence.options, sequence.unknowns(None)
    plan = FramePlan(
        options.first_window, sequence.step(options.first_window), options.first_search_px, options.lags[:1]
    )
    stars = kept_matches(
        stages,
        "matches-0",
        lambda: match_neighbours(sequence.images, unknowns.cameras(x), sequence.surface, plan, step),
    )
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
    return PassState(estimate, tuple(stars))


def next_pass(sequence: FramePasses, before: PassState, number: int, stages: Stages, step: Step) -> PassState:
    """Match again at all lags with the cameras found; solve, weigh, learn the errors."""
    options = sequence.options
    plan = FramePlan(options.window, sequence.step(options.window), options.search_px, options.lags)
    stars = kept_matches(
        stages,
        f"matches-{number + 1}",
        lambda: match_neighbours(sequence.images, before.estimate.cameras, sequence.surface, plan, step),
    )
    fields = _ground_fields(sequence, before.estimate, plan)
    if number == 0:
        lens_field = LensField.over(sequence.shape, FIELD_START_PX) if sequence.free_lens else None
        unknowns = sequence.unknowns(lens_field)
        x = np.concatenate([before.estimate.x, np.zeros(unknowns.size - len(before.estimate.x))])
        noise = FrameNoise.start(options.lags, fields, scale=3.0)
    else:
        unknowns, x = before.estimate.unknowns, before.estimate.x
        noise = replace(before.estimate.noise, fields=fields)
    drifting = [before.drifting.get(star.hub, np.zeros(len(star.pixels), dtype=bool)) for star in stars]
    stars = [
        s.with_weight(np.where(far[:, None], 0.0, s.weight)) for s, far in zip(stars, drifting, strict=True)
    ]
    for _ in range(ROUNDS):
        estimate = solve_frames(stars, unknowns, sequence.surface, noise, x, steps=2)
        x = estimate.x
        drifting = _drifting(estimate, drifting, options.drifting)
        stars = _weighed(stars, estimate, drifting)
        noise = _learned(estimate, options.lags)
        if unknowns.ties is not None:
            ties = unknowns.ties.learned(*estimate.by_images())
            ties = ties.weighed(estimate.cameras, unknowns.statics, unknowns.lens_at_control())
            unknowns = replace(unknowns, ties=ties)
        if unknowns.field is not None:
            rows = unknowns.of_field
            unknowns = replace(
                unknowns, field=unknowns.field.learned(x[rows], estimate.posterior[rows, rows])
            )
    estimate = solve_frames(stars, unknowns, sequence.surface, noise, x, steps=2)
    found = {star.hub: far for star, far in zip(stars, drifting, strict=True)} if number else {}
    return PassState(estimate, tuple(stars), found)


def lags_owned(surface: Surface, state: PassState, pixel: Array) -> PassState:
    """The last pass, with what pairs of one lag err alike among the unknowns where lags disagree.

    All turns of lags are let go first; what they depart by in units of its covariance says whether chance
    does that. `pixel` (3,) rad is one of roll, of pitch, and of yaw at the edge of the field.
    """
    estimate = state.estimate
    unknowns, noise = estimate.unknowns, estimate.noise
    lags = tuple(sorted({lag for star in state.stars for lag in star.lags}))
    if len(lags) < 2 or unknowns.turns is not None:
        return state

    def solved(turns: LagTurns) -> FrameEstimate:
        x = np.concatenate([estimate.x, np.zeros(turns.size)])
        return solve_frames(state.stars, replace(unknowns, turns=turns), surface, noise, x, steps=2)

    free = LagTurns(lags, FREE_TURN_PX * pixel)
    found = solved(free)
    rows = found.unknowns.of_turns
    turns = free.learned(found.x[rows], found.covariance[rows, rows], LEAST_TURN_PX * pixel)
    return replace(state, estimate=solved(turns)) if turns.disagree.any() else state


def _weighed(
    stars: Sequence[FrameStar], estimate: FrameEstimate, drifting: Sequence[NDArray[np.bool_]] | None = None
) -> list[FrameStar]:
    """Stars with robust weights from the residuals of an estimate; windows on drifting ground have none."""
    out = []
    for k, (star, line, clean) in enumerate(zip(stars, estimate.stars, estimate.clean_px, strict=True)):
        weight = robust_weights(replace(line, weight=np.ones_like(line.weight)), clean)
        weight *= ground_weights([line], [clean])[0]
        if drifting is not None:
            weight = np.where(drifting[k][:, None], 0.0, weight)
        out.append(star.with_weight(weight))
    return out


def _drifting(
    estimate: FrameEstimate, before: list[NDArray[np.bool_]], most: float
) -> list[NDArray[np.bool_]]:
    """Windows on clouds: their drift, smoothed over neighbours, stands far out of what still ground shows."""
    if not estimate.fields:
        return before
    drift = estimate.fields[1]
    used = drift.precision > 0
    centre = float(np.median(drift.value[used]))
    spread = robust_sigma(drift.value[used] - centre)
    far = used & (np.abs(drift.value - centre) > most * max(spread, 1e-9))
    return [old | new for old, new in zip(before, estimate.per_star(far), strict=True)]


def _ground_fields(
    sequence: FramePasses, estimate: FrameEstimate, plan: FramePlan
) -> tuple[GroundField, ...]:
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
    noise = learn_noise(estimate.stars, estimate.clean_px, estimate.explained(), lags, estimate.noise)
    fields = tuple(
        learn_field(estimate.ground, found.alone, found.precision, law)
        for found, law in zip(estimate.fields, noise.fields, strict=True)
    )
    return replace(noise, fields=fields)
