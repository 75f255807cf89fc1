"""S1: the line of sight from the bands of one strip, as one call.

``recover_line_of_sight`` reads like figure 15 of the document: select and predict windows,
match, residual, angular variations, integrate, refined estimate, and again with windows
compensated by the motion found, until it no longer changes.

Not here: files (``io/``), the report (``report/``), frames of a matrix instrument (``frame_attitude.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ImageSource
from sightline.motion.band import Band
from sightline.motion.hyper import BROAD, PriorModel, fit_prior_model
from sightline.motion.joint import (
    JointEstimate,
    JointPrior,
    angles_at,
    directions_at,
    remove_directions,
    solve_joint,
)
from sightline.motion.match_noise import estimate_correlation, robust_weights
from sightline.motion.normal_equations import TimeGrid, modelled, normal_equations
from sightline.motion.observations import Star
from sightline.motion.predict import MovingCamera, StaticParameter
from sightline.motion.stars import MatchingPlan, StarRecord, hub_windows, match_star
from sightline.motion.statics import apply_statics, band_statics

Array = NDArray[np.float64]
Progress = Callable[[str], None]

#: Error of the first linearisation as a share of the residual: products of mrad-sized angles and of the shift
#: between the predicted and the actual line with the rate of the motion, seen at 5-7 % of residuals of 1-4 px.
LINEARISATION_SHARE = 0.07


@dataclass(frozen=True)
class RecoverOptions:
    """How the strip is looked at.

    Attributes
    ----------
    first_window, window : (lines, columns)
        px; of the first, searching pass, and of the passes compensated by motion.
    step : int
        Lines between rows of windows in the compensated passes.
    search_px : (lines, columns)
        px; half-range of the first search about the prediction.
    grid_lines : float
        Lines between nodes of the estimated motion.
    passes : int
        At most so many compensated passes.
    tolerance : float
        Stop when the motion changes by less than this part of its sigma.
    """

    first_window: tuple[int, int] = (10, 100)
    window: tuple[int, int] = (4, 100)
    step: int = 4
    search_px: tuple[int, int] = (8, 8)
    grid_lines: float = 2.0
    passes: int = 4
    tolerance: float = 0.2


@dataclass(frozen=True, eq=False)
class StaticEstimate:
    """A static parameter after the fit: value and sigma in `unit`, beside the sigma before."""

    name: str
    unit: str
    value: float
    sigma: float
    prior_sigma: float


@dataclass(frozen=True, eq=False)
class LineOfSight:
    """Result of S1.

    Attributes
    ----------
    motion : Motion
        At the lines of the first band: departures from the reference attitude with the covariance of the motion
        less its hidden part.
    absolute_sigma : (N, 3)
        rad; with the hidden part, infinite where nothing ties it.
    hidden : (N, 3, H)
        Motions that the images cannot see, at the lines; `hidden_names` names them.
    observed : (N,) bool
        Lines that matches speak of; elsewhere only prior and interpolation do.
    statics : tuple of StaticEstimate
    estimate : JointEstimate
        Posterior on the time grid.
    spectra : the three priors used, with what tones were found
    records : the last pass's stars with status of every match
    post_px, before_px : per star (G, K, 2)
        Residuals after the fit, and before any motion was known (against the nominal cameras).
    cameras : list
        Cameras with the recovered motion and statics.
    iterations : int
    changes : tuple of float
        Per pass: change of the motion in units of its sigma.
    warnings : tuple of str
    """

    motion: Motion
    absolute_sigma: Array
    hidden: Array
    hidden_names: tuple[str, ...]
    observed: NDArray[np.bool_]
    statics: tuple[StaticEstimate, ...]
    estimate: JointEstimate
    prior: JointPrior
    fitted: object
    records: tuple[StarRecord, ...]
    post_px: tuple[Array, ...]
    before_px: tuple[Array, ...]
    cameras: tuple[MovingCamera, ...]
    iterations: int
    changes: tuple[float, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Strip:
    """What does not change from pass to pass."""

    bands: tuple[Band, ...]
    surface: Surface
    nominal: tuple[PushbroomCamera, ...]
    parameters: tuple[StaticParameter, ...]
    grid: TimeGrid
    order: tuple[int, ...]
    pixel_angle: float
    half_field: float

    @property
    def scale(self) -> Array:
        """(3,) rad; one pixel of roll, of pitch, and of yaw at the edge of the field."""
        return np.array([self.pixel_angle, self.pixel_angle, self.pixel_angle / self.half_field])

    def cameras(self, nodes: Array, statics: Array) -> list[MovingCamera]:
        """Cameras that carry the motion and statics found so far."""
        half = self.grid.step / 2.0
        t = self.grid.nodes[0] + half * np.arange(2 * self.grid.count - 1)
        motion = Motion(t, self.grid.interpolate(nodes, t))
        moved = [c.with_trajectory(c.trajectory.with_motion(motion)) for c in self.nominal]
        return apply_statics(moved, self.parameters, statics)


def recover_line_of_sight(
    bands: Sequence[Band],
    surface: Surface,
    *,
    height_sigma: float = 0.0,
    options: RecoverOptions | None = None,
    progress: Progress | None = None,
) -> LineOfSight:
    """Attitude of the platform against time from the bands of one strip, with covariance.

    Parameters
    ----------
    bands : sequence of Band
        Two or more images of one scene, a lag apart, with their nominal cameras.
    surface : Surface
        What the lines of sight meet; a DEM removes the parallax of relief.
    height_sigma : float
        m; what is not known of the surface's height: the sigma then owns what relief can hide.
    options : RecoverOptions, optional
    progress : callable, optional
        Told in words what is being done.

    Returns
    -------
    LineOfSight

    Raises
    ------
    InputError
        Fewer than two bands, or images that do not fit their cameras.
    EstimationError
        The images have no ground in common, or cannot be matched.

    Notes
    -----
    S1, figure 15. The motion is the joint maximum a posteriori of roll, pitch, yaw, band offsets and rotations
    (``motion/joint.py``) with priors by marginal likelihood (``motion/hyper.py``).
    """
    options = options or RecoverOptions()
    tell = progress or (lambda text: None)
    strip = _prepare(bands, surface, options)
    state = _first_pass(strip, options, height_sigma, tell)
    changes: list[float] = []
    for number in range(options.passes):
        tell(f"pass {number + 1}: matching windows compensated by the motion found")
        refined = _compensated_pass(strip, state, number, options, height_sigma, tell)
        changes.append(_change(strip, state, refined))
        state = refined
        if changes[-1] < options.tolerance:
            break
    return _result(strip, state, changes)


@dataclass(frozen=True, eq=False)
class _State:
    """What one pass hands to the next."""

    estimate: JointEstimate
    prior: JointPrior
    model: PriorModel
    records: tuple[StarRecord, ...]
    post_px: tuple[Array, ...]
    before_px: tuple[Array, ...]


def _prepare(bands: Sequence[Band], surface: Surface, options: RecoverOptions) -> _Strip:
    """Check the input and lay the time grid."""
    if len(bands) < 2:
        raise InputError(
            f"one image cannot show motion: {len(bands)} band given; two or more bands that see the same ground a lag "
            "apart are needed; add a [[band]]"
        )
    for band in bands:
        expected = (band.camera.lines, band.camera.columns)
        if tuple(band.image.shape) != expected:
            raise InputError(
                f"image and camera of band {band.name!r} differ: image {band.image.shape}, camera {expected} "
                "(lines, columns); give the image its own size in the instrument description"
            )
    cameras = tuple(band.camera for band in bands)
    parameters = band_statics(
        [b.name for b in bands], [b.offset_sigma_px for b in bands], [b.rotation_sigma for b in bands]
    )
    ends = np.array([[c.times(np.array([-2.0]))[0], c.times(np.array([c.lines + 1.0]))[0]] for c in cameras])
    period = min((ends[k, 1] - ends[k, 0]) / (c.lines + 3) for k, c in enumerate(cameras))
    step = options.grid_lines * period
    start = float(ends[:, 0].min()) - 2 * step
    count = math.ceil((float(ends[:, 1].max()) - start) / step) + 3
    first = cameras[0]
    pixel_angle, half_field = _field(first)
    return _Strip(
        bands=tuple(bands),
        surface=surface,
        nominal=cameras,
        parameters=tuple(parameters),
        grid=TimeGrid(start, step, count),
        order=tuple(range(len(bands))),
        pixel_angle=pixel_angle,
        half_field=half_field,
    )


def _field(camera: PushbroomCamera) -> tuple[float, float]:
    """Angle of one pixel and of half the field (rad) of a detector line."""
    directions = camera.detector.directions
    ends = directions[[0, -1]]
    whole = math.acos(float(np.clip(ends[0] @ ends[1], -1.0, 1.0)))
    columns = len(directions)
    return whole / max(columns - 1, 1), whole / 2.0


def _first_pass(strip: _Strip, options: RecoverOptions, height_sigma: float, tell: Progress) -> _State:
    """Search about the nominal prediction with large windows; solve under a broad prior."""
    tell("first pass: searching about the nominal prediction")
    nodes = np.zeros((strip.grid.count, 3))
    statics = np.zeros(len(strip.parameters))
    model = BROAD.scaled(strip.pixel_angle, strip.half_field)
    plan = MatchingPlan(options.first_window, 2 * options.first_window[0], options.search_px)
    records = _match(strip, nodes, statics, plan)
    records = tuple(_with_floor(r) for r in records)
    kept = sum(int(r.star.present.sum()) for r in records)
    if kept < 20:
        raise EstimationError(
            f"the images do not match where the cameras say: {kept} windows kept of "
            f"{sum(r.star.present.size for r in records)}; check look angles, line times and that the bands overlap"
        )
    return _solve(strip, records, nodes, statics, model, height_sigma, before=None)


def _with_floor(record: StarRecord) -> StarRecord:
    """First-pass matches with the error of linearising about no motion added: it grows with the residual."""
    star = record.star
    size = float(np.sqrt(np.nanmean(star.residual_px**2))) if star.present.any() else 0.0
    floor = (LINEARISATION_SHARE * size) ** 2 * np.eye(2)
    return StarRecord(replace(star, covariance_px=star.covariance_px + floor), record.status, record.score)


def _compensated_pass(
    strip: _Strip, state: _State, number: int, options: RecoverOptions, height_sigma: float, tell: Progress
) -> _State:
    """Match again with windows moved by the motion found; refit the prior; solve."""
    nodes, statics = state.estimate.nodes, state.estimate.statics
    records = _match(strip, nodes, statics, MatchingPlan(options.window, options.step))
    solved = _solve(strip, records, nodes, statics, state.model, height_sigma, before=state)
    if number == 0:
        # the first linearisation still shows in this pass: a spectrum fitted to it would hold its error
        return solved
    tell("fitting the spectrum of the motion")
    stars = [r.star for r in solved.records]
    start = state.model if number > 1 else None
    model = fit_prior_model(stars, solved.post_px, solved.estimate, strip.scale, start)
    return _solve(strip, solved.records, nodes, statics, model, height_sigma, before=state)


def _match(strip: _Strip, nodes: Array, statics: Array, plan: MatchingPlan) -> tuple[StarRecord, ...]:
    """All stars of one pass."""
    cameras = strip.cameras(nodes, statics)
    images = [band.image for band in strip.bands]
    hubs = hub_windows(cameras, strip.surface, [i.shape for i in images], strip.order, plan)
    return tuple(
        match_star(images, cameras, strip.surface, hub, partners, grid, strip.parameters, plan)
        for hub, partners, grid in hubs
    )


def _solve(
    strip: _Strip,
    records: tuple[StarRecord, ...],
    nodes: Array,
    statics: Array,
    model: PriorModel,
    height_sigma: float,
    before: _State | None,
) -> _State:
    """Solve, weigh the matches by their own scatter, solve again."""
    grid = strip.grid
    stars = [r.star for r in records]
    explained = [modelled(s, grid, nodes, statics) for s in stars]
    measured = [s.residual_px + e for s, e in zip(stars, explained, strict=True)]
    sigmas = np.array([p.sigma for p in strip.parameters])
    prior = JointPrior(model.processes(grid), sigmas)
    delays = [0.0] * len(stars)
    post: list[Array] = []
    for _ in range(2):
        estimate = solve_joint(normal_equations(stars, measured, grid, delays=delays), prior)
        post = [m - modelled(s, grid, estimate.nodes, estimate.statics) for s, m in zip(stars, measured, strict=True)]
        stars = [s.with_weight(robust_weights(s, r)) for s, r in zip(stars, post, strict=True)]
        stars = [s.with_correlation(estimate_correlation(s, r)) for s, r in zip(stars, post, strict=True)]
    estimate = solve_joint(normal_equations(stars, measured, grid, delays=delays), prior)
    post = [m - modelled(s, grid, estimate.nodes, estimate.statics) for s, m in zip(stars, measured, strict=True)]
    records = tuple(StarRecord(s, r.status, r.score) for s, r in zip(stars, records, strict=True))
    return _State(estimate, prior, model, records, tuple(post), tuple(measured))


def _change(strip: _Strip, old: _State, new: _State) -> float:
    """Change of the motion between passes in units of its sigma, hidden part left out (worst axis)."""
    t = strip.grid.nodes[4:-4:4]
    directions = directions_at(strip.grid, new.estimate.hidden_directions(drifts=bool(strip.parameters)), t)
    moved = remove_directions(angles_at(new.estimate, t) - angles_at(old.estimate, t), directions, strip.scale)
    variance = new.estimate.relative_covariance(t, directions, strip.scale)[:, [0, 1, 2], [0, 1, 2]]
    return float(np.sqrt((moved**2).mean(axis=0) / variance.mean(axis=0)).max())
