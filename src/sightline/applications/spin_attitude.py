"""S1 for a spinning matrix camera with filter strips (figure 16): spin, camera and departures, as one call.

``recover_spin_attitude`` reads like figure 15 of the document: select and predict windows in every pair of
strips at every lag at which the spin brings them over the same ground, match, estimate, and again with the
cameras found.

Not here: detector lines (``line_of_sight.py``), frames that do not spin (``frame_attitude.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError, computes
from sightline.execution import Progress, one_blas_thread, silent, steps_of
from sightline.geometry.checks import not_negative
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.band import ChipKnowledge, Frame, LensKnowledge
from sightline.motion.frames.hidden import absolute_sigma, hidden_directions, relative_covariance
from sightline.motion.frames.matches import FrameStar, kept_matches
from sightline.motion.frames.ties import FrameTies
from sightline.motion.measure.stars import StarRecord
from sightline.motion.results import LineOfSight, StaticEstimate, TimeCovariance
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.spin.matches import SpinPlan, StripPair, match_strips, strip_pairs
from sightline.motion.spin.report import SpinFindings, findings
from sightline.motion.spin.solve import (
    DEPARTURE_START,
    SPIN_NAMES,
    AttitudeSigma,
    SpinEstimate,
    SpinUnknowns,
    layers_of,
    solve_spin,
    spin_statics,
)
from sightline.result import makes_result
from sightline.stages import Stages

Array = NDArray[np.float64]

#: Fewest matches from which anything is said.
LEAST_MATCHES = 20


@dataclass(frozen=True)
class SpinOptions:
    """How the strips are looked at.

    Attributes
    ----------
    window : (lines, columns)
        px.
    first_search_px, search_px : int
        px; half-range of the search in the first pass, and in the others.
    passes : int
        At most so many passes after the first.
    tolerance : float
        Stop when the attitudes change by less than this part of their sigma.
    """

    window: tuple[int, int] = (36, 64)
    first_search_px: int = 6
    search_px: int = 2
    passes: int = 3
    tolerance: float = 0.2

    @classmethod
    def from_matching(cls, matching: Mapping[str, Any]) -> SpinOptions:
        """Options of a ``[matching]`` table, whose names are those for strips of detector lines."""
        given = {key: value for key, value in matching.items() if key not in ("first_window", "step")}
        if "search_px" in given:
            given["first_search_px"] = max(given.pop("search_px"))
        return cls(**given)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SpinAttitude(LineOfSight):
    """Result for a spinning camera: a `LineOfSight` at the exposures, with the spin behind it.

    Attributes
    ----------
    estimate : SpinEstimate
        All unknowns with their covariance.
    stars : tuple of FrameStar
        The matches of the last pass.
    spin : Spin
        As found.
    found : SpinFindings
        Spin, rank, pairs of strips and departures in numbers.
    """

    estimate: SpinEstimate
    stars: tuple[FrameStar, ...]
    spin: Spin
    found: SpinFindings


@makes_result
@one_blas_thread
@computes("attitudes of the spinning camera")
def recover_spin_attitude(
    frames: Sequence[Frame],
    surface: Surface,
    spin: Spin,
    *,
    lens: LensKnowledge | None = None,
    chip: ChipKnowledge | None = None,
    attitude_sigma: AttitudeSigma | None = None,
    parallax_sigma: float = 0.0,
    sensors: Sequence[AttitudeSensor] = (),
    control_points: ControlSightings | None = None,
    options: SpinOptions | None = None,
    progress: Progress | None = None,
    stages: Stages | None = None,
) -> SpinAttitude:
    """Spin, camera and departures per exposure of a camera on a spinning platform, with covariance.

    Parameters
    ----------
    frames : sequence of Frame
        Strips of two or more exposures in the order of their times, with nominal cameras.
    surface : Surface
        What the lines of sight meet.
    spin : Spin
        Nominal, with how well rate and axis are known.
    lens : LensKnowledge, optional
        How well the nominal lens is known; exactly by default.
    chip : ChipKnowledge, optional
        How well the places of the strips are known; exactly by default.
    attitude_sigma : AttitudeSigma, optional
        How well the attitude at t = 0 is known; to 0.1 rad by default.
    parallax_sigma : float
        rad/s; speed over distance of what is seen, where the surface is infinity and neither is known.
    sensors : sequence of AttitudeSensor
        Star trackers and gyros; readings between exposures count as far as the body went evenly there.
    control_points : ControlSightings, optional
    options : SpinOptions, optional
    progress : callable, optional
        Called with what is being done, in words.
    stages : Stages, optional
        What finished passes of a run that was stopped have matched, and where that of this run is kept.

    Returns
    -------
    SpinAttitude

    Raises
    ------
    InputError
        Fewer than two exposures, times out of order, or images that do not fit their cameras.
    EstimationError
        No strip is seen again, or too few windows match.
    """
    tell = progress or silent
    options = options or SpinOptions()
    tied = attitude_sigma or AttitudeSigma(0.1, 0.1)
    unknowns = _prepare(frames, surface, spin, lens or LensKnowledge(), chip, tied, parallax_sigma)
    pairs = seen_again(unknowns.frames)
    stages = stages or Stages()
    first = {frame.exposure: frame.camera for frame in reversed(frames)}
    ties = FrameTies.of([first[k] for k in sorted(first)], sensors, control_points)
    known = () if ties is None else (sensors, control_points)
    stages.depend([unknowns, surface, options, *known])
    unknowns = replace(unknowns, ties=ties)
    step = steps_of(tell, "first pass: wide search")
    plan = SpinPlan(options.window, options.first_search_px)
    cameras = [frame.camera for frame in frames]
    stars = kept_matches(
        stages, "matches-0", lambda: match_strips(frames, cameras, surface, pairs, plan, step)
    )
    _enough(stars)
    estimate = solve_spin(stars, unknowns, surface, pairs, steps=3)
    changes: list[float] = []
    for number in range(options.passes):
        most = options.passes
        stage = f"pass {number + 1} of at most {most}: matching"
        step = steps_of(tell, stage)
        plan = SpinPlan(options.window, options.search_px)
        match = partial(match_strips, frames, estimate.cameras, surface, pairs, plan, step)
        stars = kept_matches(stages, f"matches-{number + 1}", match)
        _enough(stars)
        refined = solve_spin(stars, replace(unknowns), surface, pairs, estimate.x)
        changes.append(_change(estimate, refined))
        estimate = refined
        if changes[-1] < options.tolerance:
            break
    return _result(stars, estimate, surface, changes)


def seen_again(frames: Sequence[Frame]) -> list[StripPair]:
    """Strips that see the same ground exposures apart; EstimationError where there are none."""
    pairs = strip_pairs(frames)
    if not pairs:
        raise EstimationError(
            "no strip sees again what another has seen: the spin carries the ground out of view within one "
            "exposure; check rate, axis and the places of the strips"
        )
    return pairs


def _prepare(
    frames: Sequence[Frame],
    surface: Surface,
    spin: Spin,
    lens: LensKnowledge,
    chip: ChipKnowledge | None,
    attitude_sigma: AttitudeSigma,
    parallax_sigma: float,
) -> SpinUnknowns:
    """Check the input and list what is unknown."""
    not_negative(parallax_sigma, "parallax_sigma", "rad/s")
    exposures = {frame.exposure: frame.camera.t for frame in frames}
    if len(exposures) < 2:
        raise InputError(
            f"one exposure cannot show motion: {len(exposures)} given; two or more that see the same ground "
            "are needed; add a [[frame]]"
        )
    if list(exposures) != list(range(len(exposures))):
        raise InputError("exposures must be numbered 0, 1, 2, ... in the order of the frames")
    for first, second in pairwise(exposures):
        if not exposures[second] > exposures[first]:
            raise InputError(
                f"exposures must be in the order of their times: {exposures[second]:g} s follows "
                f"{exposures[first]:g} s; sort them"
            )
    for frame in frames:
        if tuple(frame.image.shape) != tuple(frame.camera.shape):
            raise InputError(
                f"image and camera of {frame.name!r} differ: image {frame.image.shape}, camera "
                f"{frame.camera.shape} (lines, columns); give the camera the size of its image"
            )
    strips = sorted({frame.strip for frame in frames})
    zeros = (0.0,) * len(strips)
    known = chip or ChipKnowledge(tuple(f"strip {k}" for k in strips), 0.0, zeros, zeros, zeros)
    statics = spin_statics(frames, surface, lens, known, parallax_sigma)
    start, layers = np.full(3, DEPARTURE_START), layers_of(surface, known)
    return SpinUnknowns(tuple(frames), spin, attitude_sigma, statics, start, layers)


def _enough(stars: Sequence[FrameStar]) -> None:
    """EstimationError unless something matched."""
    kept = sum(int(star.present.sum()) for star in stars)
    if kept < LEAST_MATCHES:
        raise EstimationError(
            f"the strips do not match: {kept} windows kept; check that the body is in view and not masked, "
            "the order of the strips, and rate and axis of the spin"
        )


def _scale(estimate: SpinEstimate) -> Array:
    """(3,) rad; one pixel of roll, of pitch, and of yaw at the edge of the field."""
    detector = estimate.cameras[0].detector
    ifov = 1.0 / detector.focal_length_px
    return np.array([ifov, ifov, 2.0 / (detector.shape[1] - 1)])


def _change(old: SpinEstimate, new: SpinEstimate) -> float:
    """Largest change of a constant in units of its sigma."""
    first = new.unknowns.constants
    sigma = np.sqrt(np.diag(new.covariance)[:first])
    return float(np.abs((new.x - old.x)[:first] / sigma).max())


def _record(number: int, star: FrameStar, estimate: SpinEstimate) -> StarRecord:
    """A star as the report shows it, mismatches without weight."""
    rows = estimate.rows
    line = rows.lines[number]
    believed = np.zeros(line.weight.shape)
    of = (rows.star == number) & estimate.kept
    believed[rows.window[of], 0] = 1.0
    scale = estimate.noise.scale[rows.pair[rows.star == number][0]] if (rows.star == number).any() else 1.0
    s = np.ones(2) * scale
    covariance = line.covariance_px * s[:, None] * s[None, :]
    shown = replace(line, weight=believed, covariance_px=covariance).with_correlation(np.eye(2))
    return StarRecord(shown, star.status, star.score)


def _result(
    stars: Sequence[FrameStar], estimate: SpinEstimate, surface: Surface, changes: list[float]
) -> SpinAttitude:
    """The last estimate as a result at the exposures."""
    unknowns = estimate.unknowns
    n, t, scale = len(unknowns.t), unknowns.t, _scale(estimate)
    covariance = estimate.angle_covariance
    directions, names = hidden_directions(covariance, t, scale)
    relative = relative_covariance(covariance, directions, scale)
    blocks = np.stack([relative[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    change = unknowns.to_angles(estimate.x)
    root = change @ unknowns.prior_root
    prior = root @ root.T
    nominal = [frame.camera for frame in unknowns.frames]
    detector = estimate.cameras[0].detector
    observed = _observed(stars, estimate, n)
    found = findings(estimate)
    return SpinAttitude(
        motion=Motion(t, estimate.angles, blocks),
        absolute_sigma=absolute_sigma(covariance, np.asarray(prior)),
        hidden=directions,
        hidden_names=names,
        observed=observed,
        scale=scale,
        ifov=1.0 / detector.focal_length_px,
        half_field=math.atan((detector.shape[1] - 1) / 2.0 / detector.focal_length_px),
        statics=_statics(estimate),
        spectra=None,
        records=tuple(_record(k, star, estimate) for k, star in enumerate(stars)),
        before_px=tuple(star.residuals(nominal, surface) for star in stars),
        after_px=tuple(star.residuals(estimate.cameras, surface) for star in stars),
        cameras=tuple(estimate.cameras),
        image_names=tuple(frame.name for frame in unknowns.frames),
        changes=tuple(changes),
        band=TimeCovariance(t, estimate.angles, _lower_band(relative)),
        warnings=_warnings(observed, changes),
        sensors=() if unknowns.ties is None else unknowns.ties.uses(estimate.angles.ravel(), covariance),
        estimate=estimate,
        stars=tuple(stars),
        spin=unknowns.spin.adjusted(estimate.x[: len(SPIN_NAMES)]),
        found=found,
    )


def _statics(estimate: SpinEstimate) -> tuple[StaticEstimate, ...]:
    """Spin and constants; departure from nominal."""
    unknowns = estimate.unknowns
    sigmas = np.sqrt(np.diag(estimate.covariance))
    return tuple(
        StaticEstimate(name, unit, float(value), float(sigma), float(before))
        for name, unit, value, sigma, before in zip(
            unknowns.names,
            unknowns.units,
            estimate.x[: unknowns.constants],
            sigmas[: unknowns.constants],
            unknowns.prior_sigma[: unknowns.constants],
            strict=True,
        )
    )


def _lower_band(matrix: Array) -> Array:
    """A full symmetric matrix in lower band storage."""
    size = len(matrix)
    out = np.zeros((size, size))
    for d in range(size):
        out[d, : size - d] = np.diag(matrix, -d)
    return out


def _observed(stars: Sequence[FrameStar], estimate: SpinEstimate, count: int) -> NDArray[np.bool_]:
    """(count,) exposures that a believed match touches."""
    out = np.zeros(count, dtype=bool)
    frames = estimate.unknowns.frames
    for number in np.unique(estimate.rows.star[estimate.kept]):
        star = stars[number]
        out[frames[star.hub].exposure] = True
        out[frames[star.images[0]].exposure] = True
    return out


def _warnings(observed: NDArray[np.bool_], changes: list[float]) -> tuple[str, ...]:
    """What a user should know before trusting the numbers."""
    out = []
    if changes and changes[-1] > 1.0:
        out.append(
            f"the passes did not settle: the last changed spin or camera by {changes[-1]:.1f} sigma; check "
            "the camera description, or allow more with [matching] passes"
        )
    if not observed.all():
        unseen = int((~observed).sum())
        out.append(
            f"{unseen} of {len(observed)} exposures are seen by no match: there the even spin speaks alone"
        )
    return tuple(out)
