"""Attitude of every frame of a matrix instrument, its lens and its clock, in one dense solution.

Unknowns: three angles per frame, one time error per frame, the constants of the lens, and the
relief as a field. Maximum a posteriori with wide independent priors on the angles; the covariance
owns what neighbouring pairs share (the same image, the same ground).

Not here: matching (``matches.py``), the loop over passes (``applications/frame_attitude.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.frames.errors import Influence, neighbour_covariance
from sightline.motion.frames.lag_turns import LagTurns
from sightline.motion.frames.lens_field import LensField
from sightline.motion.frames.linear import linearise_frames
from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.noise import (
    FrameNoise,
    across,
    cholesky_factors,
    free_directions,
    match_information,
    whitened_by,
)
from sightline.motion.frames.ties import FrameTies
from sightline.motion.measure.observations import Star
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.statics import apply_statics

Array = NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)

#: 1-sigma (rad) of each frame's departure from the reference attitude, and of what all frames share of it.
ATTITUDE_SIGMA, CONSTANT_SIGMA = 0.05, 0.1
#: Step of the finite difference by time (s).
TIME_STEP = 1e-3
#: Gauss-Newton stops when no unknown moves by more than this part of its sigma.
SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class FrameUnknowns:
    """What is estimated: angles of n frames (roll, pitch, yaw of the first, ...), then the statics.

    Attributes
    ----------
    nominal : tuple of FrameCamera
    statics : tuple of StaticParameter
        Time errors and lens constants (`time_statics`, ``statics.frame_statics``).
    field : LensField or None
        What the lens does beyond its constants; None where it is known.
    attitude_sigma, constant_sigma : float
        rad; prior of each frame's angles, and of a constant they share.
    ties : FrameTies or None
        Star trackers, gyros and control points.
    turns : LagTurns or None
        What pairs of one lag err alike; None where lags agree.
    """

    nominal: tuple[FrameCamera, ...]
    statics: tuple[StaticParameter, ...]
    field: LensField | None = None
    attitude_sigma: float = ATTITUDE_SIGMA
    constant_sigma: float = CONSTANT_SIGMA
    ties: FrameTies | None = None
    turns: LagTurns | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.nominal)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.of_turns.stop

    @property
    def lens(self) -> int:
        """Number of unknowns before those of the lens field."""
        return 3 * self.frames + len(self.statics)

    @property
    def of_field(self) -> slice:
        """The unknowns of the lens field."""
        return slice(self.lens, self.lens + (0 if self.field is None else self.field.size))

    @property
    def of_turns(self) -> slice:
        """The turns of lags."""
        first = self.of_field.stop
        return slice(first, first + (0 if self.turns is None else self.turns.size))

    def prior_precision(self) -> Array:
        """(P, P) inverse prior covariance."""
        n = self.frames
        one = self.attitude_sigma**2 * np.eye(n) + self.constant_sigma**2
        out = np.zeros((self.size, self.size))
        for axis in range(3):
            out[axis : 3 * n : 3, axis : 3 * n : 3] = np.linalg.inv(one)
        statics = slice(3 * n, self.lens)
        out[statics, statics] = np.diag([1.0 / parameter.sigma**2 for parameter in self.statics])
        if self.field is not None:
            out[self.of_field, self.of_field] = self.field.prior_precision()
        if self.turns is not None:
            out[self.of_turns, self.of_turns] = self.turns.prior_precision()
        return out

    def lens_at_control(self) -> Array:
        """Shift (M, 2, unknowns from the lens field on) of the sightings of control points."""
        control = None if self.ties is None else self.ties.control
        out = np.zeros((0 if control is None else len(control.sigma), 2, self.size - self.lens))
        if self.field is not None and control is not None:
            at = self.field.weights(control.pixels)
            out[:, 0, : at.shape[1]] = out[:, 1, at.shape[1] : 2 * at.shape[1]] = at
        return out

    def known(self, cameras: Sequence[FrameCamera], x: Array) -> tuple[Array, Array]:
        """Information (P, P) and right side (P,) of what is known besides the images, about `x`."""
        if self.ties is None:
            return np.zeros((self.size, self.size)), np.zeros(self.size)
        return self.ties.equations(cameras, self.statics, self.lens_at_control(), x)

    def field_design(self, star: FrameStar) -> Array:
        """Shift of a star's matches with the unknowns of the lens field, (G, K, 2, size of the field).

        A pair sees the field at the partner less that at the hub (the change of view over a tenth of a pixel
        is left out).
        """
        if self.field is None:
            return np.zeros((*star.measured.shape, 0))
        at_hub = self.field.weights(star.pixels)
        out = np.zeros((*star.measured.shape, 2, at_hub.shape[1]))
        for k in range(len(star.images)):
            difference = self.field.weights(star.measured[:, k]) - at_hub
            for axis in range(2):
                out[:, k, axis, axis] = difference
        return out.reshape(*star.measured.shape, -1)

    def further_design(self, star: FrameStar, line: Star) -> Array:
        """Shift of a star's matches with unknowns that are not in its cameras, (G, K, 2, all from `lens`)."""
        field = self.field_design(star)
        return field if self.turns is None else np.concatenate([field, self.turns.design(line)], axis=3)

    def linearised(
        self, stars: Sequence[FrameStar], cameras: Sequence[FrameCamera], surface: Surface, x: Array
    ) -> list[Star]:
        """All stars about `cameras` (those of `x`), what else `x` says taken out of the residuals."""
        lines = linearise_frames(stars, cameras, surface, self.statics)
        if self.size == self.lens:
            return lines
        return [
            replace(line, residual_px=line.residual_px - self.further_design(star, line) @ x[self.lens :])
            for star, line in zip(stars, lines, strict=True)
        ]

    def cameras(self, x: Array) -> list[FrameCamera]:
        """The cameras with every unknown `x` (P,) away from nominal."""
        moved: list[MovingCamera] = []
        for camera, angles in zip(self.nominal, x[: 3 * self.frames].reshape(-1, 3), strict=True):
            begin, end = camera.trajectory.span
            nodes = np.array([begin, end]) if end > begin else np.array([begin])
            motion = Motion(nodes, np.tile(angles, (len(nodes), 1)))
            moved.append(camera.with_trajectory(camera.trajectory.with_motion(motion)))
        adjusted = apply_statics(moved, self.statics, x[3 * self.frames : self.lens])
        return [camera for camera in adjusted if isinstance(camera, FrameCamera)]


def time_statics(names: Sequence[str], time_sigma: Sequence[float]) -> list[StaticParameter]:
    """One time error per frame; frames of sigma 0 are left out."""
    return [
        StaticParameter(f"{name} time", "s", float(sigma), TIME_STEP, _later(k), (k,))
        for k, (name, sigma) in enumerate(zip(names, time_sigma, strict=True))
        if sigma > 0.0
    ]


def _later(image: int) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        camera = out[image]
        if isinstance(camera, FrameCamera):
            begin, end = camera.trajectory.span
            reach = abs(camera.readout_time)
            out[image] = replace(camera, t=float(np.clip(camera.t + value, begin + reach, end - reach)))
        return out

    return apply


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Sums over all stars: information and right-hand side of the unknowns, and of every ground field."""

    information: Array
    rhs: Array
    fields: tuple[_FieldSums, ...]


@dataclass(frozen=True, eq=False)
class _FieldSums:
    """Of one ground field: information with the unknowns (sum of G, P), its own, right side (sum of G,)."""

    crossed: Array
    information: Array
    rhs: Array


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """Posterior of the dense problem.

    Attributes
    ----------
    unknowns : FrameUnknowns
    x : (P,)
    cameras : list of FrameCamera
    matched : sequence of FrameStar
    stars : list of Star
        `matched`, linearised at `cameras`.
    fields : tuple of FieldEstimate
        Relief and drift of all windows; empty where the relief is known.
    post_px : per star (G, K, 2)
        Residuals, ground fields not taken out; `clean_px` with them taken out.
    noise : FrameNoise
    ground : (sum of G, 3)
        m; where the windows look.
    information : (P, P)
        Of the matches on x, relief taken out.
    posterior : (P, P)
        Covariance of x, but for what windows of one image err together.
    """

    unknowns: FrameUnknowns
    x: Array
    cameras: list[FrameCamera]
    matched: Sequence[FrameStar]
    stars: list[Star]
    fields: tuple[FieldEstimate, ...]
    post_px: list[Array]
    noise: FrameNoise
    ground: Array
    information: Array
    posterior: Array

    @cached_property
    def influence(self) -> Influence:
        """Of matches, ground fields and prior on x."""
        return _influence(self)

    @cached_property
    def covariance(self) -> Array:
        """(P, P), with all that pairs share."""
        return self.posterior + neighbour_covariance(self.influence, self.noise.shared)

    @property
    def angles(self) -> Array:
        """(n, 3) rad; roll, pitch, yaw."""
        return self.x[: 3 * self.unknowns.frames].reshape(-1, 3)

    @property
    def angle_covariance(self) -> Array:
        """(3n, 3n) rad^2, in the order of `angles`."""
        size = 3 * self.unknowns.frames
        return self.covariance[:size, :size]

    def by_images(self) -> tuple[Array, Array]:
        """(P,) the unknowns and (P, P) their covariance as the images and the prior alone have them."""
        prior = self.unknowns.prior_precision()
        posterior = np.linalg.inv(self.information + prior)
        _, rhs = self.unknowns.known(self.cameras, self.x)
        # at the estimate, right sides of images, of what is known and of the prior cancel
        return self.x - posterior @ rhs, 0.5 * (posterior + posterior.T)

    @property
    def clean_px(self) -> list[Array]:
        """Residuals with what relief and drift explain taken out, (G, K, 2) px per star."""
        out = []
        for k, (star, post) in enumerate(zip(self.stars, self.post_px, strict=True)):
            clean = post
            for level, field in zip(_levers(star), self.fields, strict=False):
                clean = clean - level * self.per_star(field.value)[k][:, None, None]
            out.append(clean)
        return out

    def explained(self) -> list[Array]:
        """Covariance (parts, G, K, K) of what the fit takes out of each window's errors, per star.

        Of their parts that are free of heights (`free_directions`), in sigmas of the matcher. Residuals
        are smaller than the errors by what the unknowns and the ground fields follow them.
        """
        out = []
        for line, windows, design, levers in self.followed():
            parts = []
            for direction in free_directions(line, bool(self.fields)):
                rows = np.einsum("gkc,gkcp->gkp", direction, design)
                spread = (rows.reshape(-1, self.unknowns.size) @ self.posterior).reshape(rows.shape)
                covariance = spread @ np.swapaxes(rows, 1, 2)
                for lever, field in zip(levers, self.fields, strict=True):
                    arm = (direction * lever).sum(axis=2)
                    covariance += field.variance[windows, None, None] * arm[:, :, None] * arm[:, None, :]
                parts.append(covariance)
            out.append(np.stack(parts))
        return out

    def followed(self) -> Iterator[tuple[Star, slice, Array, tuple[Array, ...]]]:
        """Per star: it, its windows among all, what its matches show of the unknowns, and of each field.

        Of the unknowns, (G, K, 2, P), less what the ground fields take of them; of a field, (G, K, 2).
        """
        first = 0
        for star, line in zip(self.matched, self.stars, strict=True):
            _, design, height = _rows(star, line, self.unknowns)
            windows = slice(first, first + len(star.pixels))
            first = windows.stop
            levers = (height, across(height))[: len(self.fields)]
            for lever, field in zip(levers, self.fields, strict=True):
                design -= lever[..., None] * field.follows[windows][:, None, None, :]
            yield line, windows, design, levers

    def per_star(self, values: NDArray[Scalar]) -> list[NDArray[Scalar]]:
        """Values of all windows (sum of G,) cut into stars."""
        return np.split(values, np.cumsum([len(star.pixels) for star in self.stars])[:-1])


@dataclass(frozen=True, eq=False)
class FieldEstimate:
    """Relief (or drift, in heights of the same effect) under every window.

    Attributes
    ----------
    value, variance : (sum of G,)
        m, m^2; posterior, the unknowns being where they are.
    alone, precision : (sum of G,)
        m, 1/m^2; what each window's own matches say.
    follows : (sum of G, P)
        m; what the field takes of each unknown, per unit of it.
    """

    value: Array
    variance: Array
    alone: Array
    precision: Array
    follows: Array


def _levers(star: Star) -> tuple[Array, Array]:
    """Shift (G, K, 2) px per m of height, and per m of drift, of a star's matches."""
    height = np.asarray(star.by_height, dtype=np.float64)
    factors = cholesky_factors(star.covariance_px)
    return height, np.einsum("gkij,gkj->gki", factors, across(whitened_by(height, factors)))


def solve_frames(
    stars: Sequence[FrameStar],
    unknowns: FrameUnknowns,
    surface: Surface,
    noise: FrameNoise,
    x: Array | None = None,
    *,
    steps: int = 6,
    fixed: int | None = None,
) -> FrameEstimate:
    """Maximum a posteriori of all unknowns for given matches, by Gauss-Newton.

    Parameters
    ----------
    stars : sequence of FrameStar
    unknowns : FrameUnknowns
    surface : Surface
        What the lines of sight meet; relief above it is in `noise`.
    noise : FrameNoise
    x : (P,), optional
        Where to start; the nominal cameras by default.
    steps : int
        At most so many Gauss-Newton steps.
    fixed : int, optional
        Unknowns from this one on stay where `x` puts them, and are taken for true.

    Raises
    ------
    EstimationError
        Without matches.
    """
    if not any(star.present.any() for star in stars):
        raise EstimationError("no window of any frame is found in another; check overlap, mount and times")
    x = np.zeros(unknowns.size) if x is None else x.copy()
    prior = unknowns.prior_precision()
    for _ in range(max(steps, 1)):
        cameras = unknowns.cameras(x)
        lines = unknowns.linearised(stars, cameras, surface, x)
        reduced = _reduce(stars, lines, unknowns, noise)
        known = unknowns.known(cameras, x)
        solver = _Solver(reduced, prior, noise, _ground(stars, cameras, surface), fixed, known)
        step = solver.step(x)
        x = x + step
        if np.all(np.abs(step) <= SETTLED * np.sqrt(np.diag(solver.posterior))):
            break
    cameras = unknowns.cameras(x)
    lines = unknowns.linearised(stars, cameras, surface, x)
    ground = _ground(stars, cameras, surface)
    reduced = _reduce(stars, lines, unknowns, noise)
    solver = _Solver(reduced, prior, noise, ground, fixed, unknowns.known(cameras, x))
    return FrameEstimate(
        unknowns,
        x,
        cameras,
        stars,
        lines,
        tuple(part.estimate() for part in solver.fields),
        [line.residual_px for line in lines],
        noise,
        ground,
        solver.information,
        solver.posterior,
    )


def _ground(stars: Sequence[FrameStar], cameras: Sequence[FrameCamera], surface: Surface) -> Array:
    """Ground points (sum of G, 3) of all windows."""
    return np.concatenate([cameras[star.hub].locate(star.pixels, surface) for star in stars])


def _rows(matched: FrameStar, star: Star, unknowns: FrameUnknowns) -> tuple[Array, Array, Array]:
    """Scaled residuals (G, K, 2), sensitivities (G, K, 2, P) and parallax (G, K, 2) of a star."""
    n = unknowns.frames
    g, k = star.present.shape
    design = np.zeros((g, k, 2, unknowns.size))
    design[..., 3 * star.hub : 3 * star.hub + 3] = star.by_hub
    for j, image in enumerate(star.images):
        design[:, j, :, 3 * image : 3 * image + 3] += star.by_partner[:, j]
    design[..., 3 * n : unknowns.lens] = star.by_static
    design[..., unknowns.lens :] = unknowns.further_design(matched, star)
    factors = cholesky_factors(star.covariance_px)
    residual = np.where(star.present[..., None], np.nan_to_num(star.residual_px), 0.0)
    height = np.asarray(star.by_height, dtype=np.float64)
    return whitened_by(residual, factors), whitened_by(design, factors), whitened_by(height, factors)


def _reduce(
    stars: Sequence[FrameStar], lines: Sequence[Star], unknowns: FrameUnknowns, noise: FrameNoise
) -> _Reduced:
    """Normal equations of all stars; one row per window for each ground field."""
    size = unknowns.size
    information, rhs = np.zeros((size, size)), np.zeros(size)
    parts: list[tuple[list[Array], list[Array], list[Array]]] = [([], [], []) for _ in noise.fields]
    for star, line in zip(stars, lines, strict=True):
        z, design, height = _rows(star, line, unknowns)
        weight = match_information(line, noise)
        weighed = np.einsum("gkl,glcp->gkcp", weight, design, optimize=True)
        flat, flat_weighed = design.reshape(-1, size), weighed.reshape(-1, size)
        information += flat.T @ flat_weighed
        rhs += flat_weighed.T @ z.ravel()
        for lever, part in zip((height, across(height)), parts, strict=False):
            weighed_lever = np.einsum("gkl,glc->gkc", weight, lever)
            part[0].append(np.einsum("gkc,gkcp->gp", lever, weighed))
            part[1].append(np.einsum("gkc,gkc->g", lever, weighed_lever))
            part[2].append(np.einsum("gkc,gkc->g", z, weighed_lever))
    sums = tuple(_FieldSums(*(np.concatenate(column) for column in part)) for part in parts)
    return _Reduced(information, rhs, sums)


class _Eliminated:
    """A ground field eliminated from the normal equations, and found again given the unknowns.

    With D the information of each window on its own height, s = sqrt(D) and K the covariance of the field,
    everything follows from C = 1 + s K s: ``s (K^-1 + D)^-1 s = 1 - C^-1``.
    """

    def __init__(self, sums: _FieldSums, covariance: Array) -> None:
        """Factor C."""
        from scipy.linalg import cho_factor, cho_solve

        seen = sums.information > 0
        self.sums = sums
        self.root = np.where(seen, np.sqrt(np.maximum(sums.information, 1e-300)), 1.0)
        self.loose = np.where(seen[:, None], sums.crossed / self.root[:, None], 0.0)
        self.loose_rhs = np.where(seen, sums.rhs / self.root, 0.0)
        root = np.where(seen, self.root, 0.0)
        self.prior_variance, self.seen = np.diag(covariance).copy(), seen
        self.factor = cho_factor(covariance * root[:, None] * root[None, :] + np.eye(len(root)), lower=True)
        both = cho_solve(self.factor, np.column_stack([self.loose, self.loose_rhs]))
        self.kept, self.kept_rhs = self.loose - both[:, :-1], self.loose_rhs - both[:, -1]

    @property
    def _follows(self) -> Array:
        return np.asarray(self.kept / self.root[:, None])

    def estimate(self) -> FieldEstimate:
        """Posterior of the field, the unknowns being where they are."""
        from scipy.linalg import solve_triangular

        inverse_factor = solve_triangular(self.factor[0], np.eye(len(self.root)), lower=True)
        inverse_diagonal = (inverse_factor**2).sum(axis=0)
        variance = np.where(self.seen, (1.0 - inverse_diagonal) / self.root**2, self.prior_variance)
        alone = np.where(self.seen, self.sums.rhs / self.root**2, 0.0)
        return FieldEstimate(
            self.kept_rhs / self.root, np.maximum(variance, 0.0), alone, self.sums.information, self._follows
        )


class _Solver:
    """Ground fields eliminated: posterior of the unknowns."""

    def __init__(
        self,
        reduced: _Reduced,
        prior: Array,
        noise: FrameNoise,
        ground: Array,
        fixed: int | None,
        known: tuple[Array, Array],
    ) -> None:
        """Eliminate and invert."""
        self.prior, self.rhs = prior, reduced.rhs
        information = reduced.information
        self.fields = [
            _Eliminated(sums, field.covariance(ground, ground))
            for sums, field in zip(reduced.fields, noise.fields, strict=True)
        ]
        for part in self.fields:
            information = information - part.loose.T @ part.kept
            self.rhs = self.rhs - part.loose.T @ part.kept_rhs
        self.information = 0.5 * (information + information.T)
        free = slice(0, fixed)
        self.rhs = self.rhs + known[1]
        inverse = np.linalg.inv((self.information + known[0] + prior)[free, free])
        self.posterior = np.zeros_like(prior)
        self.posterior[free, free] = 0.5 * (inverse + inverse.T)

    def step(self, x: Array) -> Array:
        """Gauss-Newton step from `x`."""
        return np.asarray(self.posterior @ (self.rhs - self.prior @ x))


def _influence(estimate: FrameEstimate) -> Influence:
    """Influence of every match, ground field and prior mean on the unknowns."""
    unknowns, noise, posterior = estimate.unknowns, estimate.noise, estimate.posterior
    gains: list[Array] = []
    moved: list[list[Array]] = [[] for _ in estimate.fields]
    for line, _, design, levers in estimate.followed():
        weighed = np.einsum("gkl,glcp->gkcp", match_information(line, noise), design, optimize=True)
        gains.append(weighed @ posterior)
        # a true field acts through the matches that it moves
        for lever, parts in zip(levers, moved, strict=True):
            parts.append(np.einsum("gkc,gkcp->gp", lever, gains[-1]))
    return Influence(
        [star.with_weight(line.weight) for star, line in zip(estimate.matched, estimate.stars, strict=True)],
        gains,
        tuple(np.concatenate(parts) for parts in moved),
        -unknowns.prior_precision() @ posterior,
    )
