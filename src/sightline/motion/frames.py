"""Attitude of every frame of a matrix instrument, its lens and its clock, in one dense solution.

Unknowns: three angles per frame, one time error per frame, the constants of the lens, and the
relief as a field. Maximum a posteriori with wide independent priors on the angles; the covariance
owns what neighbouring pairs share (the same image, the same ground).

Not here: matching (``frame_matches.py``), the loop over passes (``applications/frame_attitude.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.frame_errors import Influence, neighbour_covariance
from sightline.motion.frame_linear import linearise_frames
from sightline.motion.frame_matches import FrameStar
from sightline.motion.frame_noise import FrameNoise, cholesky_factors, match_information, scaled
from sightline.motion.lens_field import LensField
from sightline.motion.observations import Star
from sightline.motion.predict import MovingCamera, StaticParameter
from sightline.motion.statics import apply_statics

Array = NDArray[np.float64]

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
    """

    nominal: tuple[FrameCamera, ...]
    statics: tuple[StaticParameter, ...]
    field: LensField | None = None
    attitude_sigma: float = ATTITUDE_SIGMA
    constant_sigma: float = CONSTANT_SIGMA

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.nominal)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.lens + (0 if self.field is None else self.field.size)

    @property
    def lens(self) -> int:
        """Number of unknowns before those of the lens field."""
        return 3 * self.frames + len(self.statics)

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
            out[self.lens :, self.lens :] = self.field.prior_precision()
        return out

    def field_design(self, star: FrameStar) -> Array:
        """Shift of a star's matches with the unknowns of the lens field, (G, K, 2, size of the field).

        A pair sees the field at the partner less that at the hub (the change of view over a tenth of a pixel is
        left out).
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

    def linearised(
        self, stars: Sequence[FrameStar], cameras: Sequence[FrameCamera], surface: Surface, x: Array
    ) -> list[Star]:
        """All stars about `cameras` (which are those of `x`), the lens field taken out of the residuals."""
        lines = linearise_frames(stars, cameras, surface, self.statics)
        if self.field is None:
            return lines
        return [
            replace(line, residual_px=line.residual_px - self.field_design(star) @ x[self.lens :])
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
        return [c for c in apply_statics(moved, self.statics, x[3 * self.frames : self.lens]) if isinstance(c, FrameCamera)]


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
    """Sums over all stars: information and right-hand side of the unknowns, relief in between."""

    information: Array
    rhs: Array
    crossed: Array
    height_information: Array
    height_rhs: Array


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """Posterior of the dense problem.

    Attributes
    ----------
    unknowns : FrameUnknowns
    x : (P,)
    covariance : (P, P)
        With all that pairs share.
    cameras : list of FrameCamera
    stars : list of Star
        Linearised at `cameras`.
    heights : per star (G,)
        m; of each window's ground above the surface; 0 where relief is known.
    post_px : per star (G, K, 2)
        Residuals, relief not taken out; `clean_px` with it taken out.
    noise : FrameNoise
    ground : (sum of G, 3)
        m; where the windows look.
    influence : Influence
        Of matches, relief and prior on x.
    information : (P, P)
        Of the matches on x, relief taken out.
    """

    unknowns: FrameUnknowns
    x: Array
    covariance: Array
    cameras: list[FrameCamera]
    stars: list[Star]
    heights: list[Array]
    post_px: list[Array]
    noise: FrameNoise
    ground: Array
    height_rhs: Array
    height_information: Array
    influence: Influence
    information: Array

    @property
    def angles(self) -> Array:
        """(n, 3) rad; roll, pitch, yaw."""
        return self.x[: 3 * self.unknowns.frames].reshape(-1, 3)

    @property
    def angle_covariance(self) -> Array:
        """(3n, 3n) rad^2, in the order of `angles`."""
        size = 3 * self.unknowns.frames
        return self.covariance[:size, :size]

    @property
    def clean_px(self) -> list[Array]:
        """Residuals with the parallax of the estimated relief taken out, (G, K, 2) px per star."""
        return [
            post - np.asarray(star.by_height, dtype=np.float64) * height[:, None, None]
            for star, post, height in zip(self.stars, self.post_px, self.heights, strict=True)
        ]


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
        solver = _Solver(reduced, prior, noise, _ground(stars, cameras, surface), fixed)
        step = solver.step(x)
        x = x + step
        if np.all(np.abs(step) <= SETTLED * np.sqrt(np.diag(solver.posterior))):
            break
    cameras = unknowns.cameras(x)
    lines = unknowns.linearised(stars, cameras, surface, x)
    ground = _ground(stars, cameras, surface)
    reduced = _reduce(stars, lines, unknowns, noise)
    solver = _Solver(reduced, prior, noise, ground, fixed)
    heights = solver.heights()
    counts = np.cumsum([0] + [len(star.pixels) for star in stars])
    influence = _influence(stars, lines, unknowns, noise, solver)
    shared = neighbour_covariance(influence, noise.shared)
    return FrameEstimate(
        unknowns,
        x,
        solver.posterior + shared,
        cameras,
        lines,
        [heights[counts[k] : counts[k + 1]] for k in range(len(stars))],
        [line.residual_px for line in lines],
        noise,
        ground,
        reduced.height_rhs,
        reduced.height_information,
        influence,
        solver.information,
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
    design[..., unknowns.lens :] = unknowns.field_design(matched)
    factors = cholesky_factors(star.covariance_px)
    residual = np.where(star.present[..., None], np.nan_to_num(star.residual_px), 0.0)
    height = np.asarray(star.by_height, dtype=np.float64)
    return scaled(residual, factors), scaled(design, factors), scaled(height, factors)


def _reduce(
    stars: Sequence[FrameStar], lines: Sequence[Star], unknowns: FrameUnknowns, noise: FrameNoise
) -> _Reduced:
    """Normal equations of all stars; one row of `crossed` per window for its height."""
    size = unknowns.size
    information, rhs = np.zeros((size, size)), np.zeros(size)
    crossed, height_information, height_rhs = [], [], []
    for star, line in zip(stars, lines, strict=True):
        z, design, height = _rows(star, line, unknowns)
        weight = match_information(line, noise)
        weighed = np.einsum("gkl,glcp->gkcp", weight, design, optimize=True)
        flat, flat_weighed = design.reshape(-1, size), weighed.reshape(-1, size)
        information += flat.T @ flat_weighed
        rhs += flat_weighed.T @ z.ravel()
        crossed.append(np.einsum("gkc,gkcp->gp", height, weighed))
        weighed_height = np.einsum("gkl,glc->gkc", weight, height)
        height_information.append(np.einsum("gkc,gkc->g", height, weighed_height))
        height_rhs.append(np.einsum("gkc,gkc->g", z, weighed_height))
    return _Reduced(
        information, rhs, np.concatenate(crossed), np.concatenate(height_information), np.concatenate(height_rhs)
    )


class _Solver:
    """Relief eliminated: posterior of the unknowns and, given them, of the heights.

    With D the information of each window on its own height, s = sqrt(D) and K the covariance of the
    relief, everything follows from C = 1 + s K s: ``s (K^-1 + D)^-1 s = 1 - C^-1``.
    """

    def __init__(
        self, reduced: _Reduced, prior: Array, noise: FrameNoise, ground: Array, fixed: int | None
    ) -> None:
        """Factor."""
        from scipy.linalg import cho_factor, cho_solve

        self.reduced, self.prior = reduced, prior
        seen = reduced.height_information > 0
        self.root = np.where(seen, np.sqrt(np.maximum(reduced.height_information, 1e-300)), 1.0)
        self.loose = np.where(seen[:, None], reduced.crossed / self.root[:, None], 0.0)
        self.loose_rhs = np.where(seen, reduced.height_rhs / self.root, 0.0)
        information, self.rhs = reduced.information, reduced.rhs
        self.relief = noise.relief is not None
        if noise.relief is not None:
            root = np.where(seen, self.root, 0.0)
            c = noise.relief.covariance(ground, ground) * root[:, None] * root[None, :] + np.eye(len(root))
            self.factor = cho_factor(c, lower=True)
            both = cho_solve(self.factor, np.column_stack([self.loose, self.loose_rhs]))
            self.kept, self.kept_rhs = self.loose - both[:, :-1], self.loose_rhs - both[:, -1]
            information = information - self.loose.T @ self.kept
            self.rhs = self.rhs - self.loose.T @ self.kept_rhs
        self.information = 0.5 * (information + information.T)
        free = slice(0, fixed)
        inverse = np.linalg.inv((self.information + prior)[free, free])
        self.posterior = np.zeros_like(prior)
        self.posterior[free, free] = 0.5 * (inverse + inverse.T)

    def step(self, x: Array) -> Array:
        """Gauss-Newton step from `x`."""
        return np.asarray(self.posterior @ (self.rhs - self.prior @ x))

    def heights(self) -> Array:
        """Posterior mean heights (sum of G,) m, the unknowns being where they are."""
        if not self.relief:
            return np.zeros(len(self.root))
        return np.asarray(self.kept_rhs / self.root)

    def height_gain(self) -> Array | None:
        """(sum of G, P): change of the right-hand side with true heights (1/m); None where they are known."""
        if not self.relief:
            return None
        return np.asarray(self.root[:, None] * (self.loose - self.kept))

    def height_correction(self) -> Array:
        """(sum of G, P): what the eliminated heights take of each unknown, m per unit."""
        if not self.relief:
            return np.zeros_like(self.loose)
        return np.asarray(self.kept / self.root[:, None])


def _influence(stars: Sequence[FrameStar], lines: Sequence[Star], unknowns: FrameUnknowns, noise: FrameNoise, solver: _Solver) -> Influence:
    """Influence of every match, height and prior mean on the unknowns."""
    correction, first, gains = solver.height_correction(), 0, []
    for star, line in zip(stars, lines, strict=True):
        _, design, height = _rows(star, line, unknowns)
        windows = slice(first, first + len(star.pixels))
        first = windows.stop
        design -= height[..., None] * correction[windows][:, None, None, :]
        weight = match_information(line, noise)
        gains.append(np.einsum("gkl,glcp->gkcp", weight, design, optimize=True) @ solver.posterior)
    heights = solver.height_gain()
    return Influence(
        [star.with_weight(line.weight) for star, line in zip(stars, lines, strict=True)],
        gains,
        None if heights is None else heights @ solver.posterior,
        -solver.prior @ solver.posterior,
    )
