"""Spin, camera and departures of a spinning matrix camera from matched strips, in one dense solution.

Unknowns: rate and axis of the spin and the attitude at t = 0, constants of lens and chip, and three small
angles per exposure: what the body does besides spinning evenly. Departures have a prior of their own, white,
whose size the data say.

Not here: matching (``matches.py``), the loop over passes (``applications/spin_attitude.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.estimation.robust import robust_sigmas
from sightline.geometry.camera import FrameCamera
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Infinity, Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.band import ChipKnowledge, Frame, LensKnowledge
from sightline.motion.frames.linear import linearise_frames
from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.ties import FrameTies
from sightline.motion.measure.observations import Star
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.spin.departure_size import departure_sizes
from sightline.motion.spin.matches import StripPair, pair_of, reuse
from sightline.motion.statics import apply_statics, frame_statics

Array = NDArray[np.float64]

#: The six unknowns of the spin, with their units.
SPIN_NAMES = (
    ("spin rate", "rad/s"),
    ("spin axis 1", "rad"),
    ("spin axis 2", "rad"),
    ("attitude roll", "rad"),
    ("attitude pitch", "rad"),
    ("attitude yaw", "rad"),
)
#: Steps of their finite differences.
SPIN_STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])
#: m; step of the finite difference by the height of a layer.
LAYER_STEP = 1e3
#: Sigma of what is said to be known exactly, in units of nothing: so small that nothing moves it.
EXACT = 1e-12
#: rad; departures of single exposures before the data have said how large they are.
DEPARTURE_START = 5e-5
#: Residuals beyond so many sigmas (of the distance in both axes) are mismatches: one in a thousand of two
#: Gaussian components.
REJECT = 3.7
#: Rounds of weighing matches and learning their errors, within a pass.
ROUNDS = 5


@dataclass(frozen=True)
class AttitudeSigma:
    """How well an attitude is known.

    Attributes
    ----------
    across : float
        rad; about axes across the line to the world's origin (the centre of the body): where the body is in
        the images says it.
    about : float
        rad; about that line.
    """

    across: float
    about: float

    def root(self, down: Array) -> Array:
        """(3, 3) symmetric root of the covariance; `down` (3,) is that line, body axes."""
        out = max(self.across, EXACT) * np.eye(3)
        return np.asarray(out + (max(self.about, EXACT) - max(self.across, EXACT)) * np.outer(down, down))


@dataclass(frozen=True, eq=False)
class SpinUnknowns:
    """What is estimated: six numbers of the spin, Q constants, three departures of each of n exposures.

    Attributes
    ----------
    frames : tuple of Frame
        Images with nominal cameras.
    spin : Spin
        Nominal.
    attitude_sigma : AttitudeSigma
        Of the attitude at t = 0.
    statics : tuple of StaticParameter
        Lens, chip, parallax.
    departure_sigma : (3,)
        rad; prior of the departures about each axis.
    layers : tuple of (str, float)
        Per strip, its name and how well the height of the layer that it sees is known, m; empty where all
        see one surface.
    ties : FrameTies or None
        Star trackers, gyros and control points.
    """

    frames: tuple[Frame, ...]
    spin: Spin
    attitude_sigma: AttitudeSigma
    statics: tuple[StaticParameter, ...]
    departure_sigma: Array
    layers: tuple[tuple[str, float], ...] = ()
    ties: FrameTies | None = None

    @property
    def t(self) -> Array:
        """(n,) s; of the exposures."""
        times = {frame.exposure: frame.camera.t for frame in self.frames}
        return np.array([times[k] for k in sorted(times)])

    @property
    def constants(self) -> int:
        """Number of unknowns before the departures."""
        return len(SPIN_NAMES) + len(self.statics) + len(self.layers)

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.constants + 3 * len(self.t)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the constants."""
        layers = (f"{name} height" for name, _ in self.layers)
        return (*(name for name, _ in SPIN_NAMES), *(p.name for p in self.statics), *layers)

    @property
    def units(self) -> tuple[str, ...]:
        """Of the constants."""
        return (
            *(unit for _, unit in SPIN_NAMES),
            *(p.unit for p in self.statics),
            *("m",) * len(self.layers),
        )

    @property
    def prior_sigma(self) -> Array:
        """(size,) 1-sigma of every unknown beforehand, each in its unit."""
        return np.asarray(np.sqrt((self.prior_root**2).sum(axis=1)))

    @property
    def prior_root(self) -> Array:
        """(size, size) symmetric root of the prior covariance."""
        spin = [self.spin.rate_sigma, self.spin.axis_sigma, self.spin.axis_sigma, 0.0, 0.0, 0.0]
        known = [*spin, *(p.sigma for p in self.statics), *(sigma for _, sigma in self.layers)]
        constants = np.maximum(known, EXACT)
        out = np.diag(np.concatenate([constants, np.tile(self.departure_sigma, len(self.t))]))
        out[3:6, 3:6] = self.attitude_sigma.root(self._down())
        return out

    def _down(self) -> Array:
        """(3,) unit vector from the platform to the world's origin at t = 0, body axes; 0 at the origin."""
        trajectory = self.frames[0].camera.trajectory
        begin, end = trajectory.span
        place = trajectory.at(float(np.clip(0.0, begin, end))).position[0]
        down = self.spin.attitude.inv().apply(-place)
        length = float(np.linalg.norm(down))
        return np.asarray(down / length if length > 0.0 else down)

    def heights(self, x: Array) -> Array:
        """(strips,) m; of the layer that each strip sees, above the surface."""
        return x[self.constants - len(self.layers) : self.constants]

    def angles(self, x: Array) -> Array:
        """(n, 3) rad; departure of the body from its nominal attitude at every exposure."""
        t = self.t
        moved = self.spin.adjusted(x[: len(SPIN_NAMES)]).at(t)
        own = Rotation.from_rotvec(x[self.constants :].reshape(-1, 3))
        return np.asarray((self.spin.at(t).inv() * moved * own).as_rotvec())

    def by_spin(self, x: Array) -> Array:
        """(n, 3, 6): change of `angles` with the numbers of the spin, by central differences."""
        out = np.empty((len(self.t), 3, len(SPIN_NAMES)))
        for k, step in enumerate(SPIN_STEPS):
            plus, minus = x.copy(), x.copy()
            plus[k] += step
            minus[k] -= step
            out[:, :, k] = (self.angles(plus) - self.angles(minus)) / (2.0 * step)
        return out

    def to_angles(self, x: Array) -> Array:
        """(3n, size): change of `angles`, exposure by exposure, with every unknown."""
        n = len(self.t)
        out = np.zeros((3 * n, self.size))
        out[:, : len(SPIN_NAMES)] = self.by_spin(x).reshape(3 * n, -1)
        out[:, self.constants :] = np.eye(3 * n)
        return out

    def known(self, x: Array) -> tuple[Array, Array]:
        """Information (P, P) and right side (P,) of what is known besides the images, about `x` (P,).

        The right side is that of all of `x`, not of a step from it.
        """
        information, rhs = np.zeros((self.size, self.size)), np.zeros(self.size)
        if self.ties is None:
            return information, rhs
        to_angles = self.to_angles(x)
        own, side = self.ties.attitude(len(to_angles), self.angles(x).ravel())
        information += to_angles.T @ own @ to_angles
        rhs += to_angles.T @ side
        if self.ties.control is not None:
            value, design, covariance = self._sightings(x, self.ties)
            if len(value):
                weighed = np.linalg.solve(covariance, design)
                information += design.T @ weighed
                rhs += weighed.T @ value
        return information, rhs + information @ x

    def _sightings(self, x: Array, ties: FrameTies) -> tuple[Array, Array, Array]:
        """Residuals (2M,) of control points, by all unknowns (2M, P), their covariance (2M, 2M), px."""
        none = np.zeros((len(ties.control_weight), 2, 0))
        value, by_images, covariance = ties.sightings(self.cameras(x), self.statics, none)
        turns, to_angles = 3 * len(self.frames), self.to_angles(x).reshape(-1, 3, self.size)
        of_images = to_angles[[frame.exposure for frame in self.frames]].reshape(turns, self.size)
        design = by_images[:, :turns] @ of_images
        first = len(SPIN_NAMES)
        design[:, first : first + len(self.statics)] += by_images[:, turns:]
        return value, design, covariance

    def learned(self, information: Array, rhs: Array, x: Array) -> SpinUnknowns:
        """The same with what is known weighed by what the images alone say, by their normal equations."""
        if self.ties is None:
            return self
        root = self.prior_root
        alone = root @ np.linalg.inv(root @ information @ root + np.eye(len(root))) @ root
        by_images = alone @ rhs
        to_angles = self.to_angles(x)
        angles = self.angles(x).ravel() + to_angles @ (by_images - x)
        ties = self.ties.learned(angles, to_angles @ alone @ to_angles.T)
        cameras = self.cameras(x)
        none = np.zeros((len(ties.control_weight), 2, 0))
        return replace(self, ties=ties.weighed(cameras, self.statics, none))

    def cameras(self, x: Array) -> list[FrameCamera]:
        """The cameras of all images with every unknown `x` (size,) away from nominal."""
        angles = self.angles(x)
        moved: list[MovingCamera] = []
        for frame in self.frames:
            trajectory = frame.camera.trajectory
            motion = Motion(np.array(trajectory.span), np.tile(angles[frame.exposure], (2, 1)))
            moved.append(frame.camera.with_trajectory(trajectory.with_motion(motion)))
        first = len(SPIN_NAMES)
        adjusted = apply_statics(moved, self.statics, x[first : first + len(self.statics)])
        return [camera for camera in adjusted if isinstance(camera, FrameCamera)]


def spin_statics(
    frames: Sequence[Frame],
    surface: Surface,
    lens: LensKnowledge,
    chip: ChipKnowledge,
    parallax_sigma: float,
) -> tuple[StaticParameter, ...]:
    """Constants of lens, chip and parallax that are not known exactly.

    Parameters
    ----------
    frames : sequence of Frame
    surface : Surface
    lens : LensKnowledge
    chip : ChipKnowledge
    parallax_sigma : float
        rad/s; speed over distance, on a surface at infinity.
    """
    names = [frame.name for frame in frames]
    every = tuple(range(len(frames)))
    out = frame_statics(
        names,
        focal_length_sigma_px=lens.focal_length_sigma_px,
        # along the lines it is the chip's
        principal_point_sigma_px=(0.0, lens.principal_point_sigma_px),
        distortion_sigma=(lens.distortion_sigma,),
    )
    line = lens.principal_point_sigma_px if len(chip.names) == 1 else chip.common_line_sigma_px
    if line > 0.0:
        out.append(StaticParameter("axis line", "px", line, 0.5, _moved_line(every), every))
    for strip, name in enumerate(chip.names):
        own = tuple(k for k, frame in enumerate(frames) if frame.strip == strip)
        if len(chip.names) > 1 and chip.line_sigma_px[strip] > 0.0:
            sigma = chip.line_sigma_px[strip]
            out.append(StaticParameter(f"{name} line", "px", sigma, 0.1, _moved_line(own), own))
        if len(chip.names) > 1 and chip.scale_sigma[strip] > 0.0:
            sigma = chip.scale_sigma[strip]
            out.append(StaticParameter(f"{name} scale", "", sigma, 1e-4, _scaled(own), own))
    if parallax_sigma > 0.0 and isinstance(surface, Infinity):
        for axis, name in enumerate("xyz"):
            change = _drifting(axis, surface.distance)
            out.append(StaticParameter(f"parallax {name}", "rad/s", parallax_sigma, 1e-6, change, every))
    return tuple(out)


def layers_of(surface: Surface, chip: ChipKnowledge) -> tuple[tuple[str, float], ...]:
    """Strips that see layers of their own; none at infinity, or where all heights are known."""
    if isinstance(surface, Infinity) or not any(sigma > 0.0 for sigma in chip.height_sigma):
        return ()
    return tuple(zip(chip.names, chip.height_sigma, strict=True))


def _changed(
    images: tuple[int, ...], change: Callable[[FrameCamera, float], FrameCamera]
) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    """`change` applied to some cameras."""

    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        for k in images:
            camera = out[k]
            if isinstance(camera, FrameCamera):
                out[k] = change(camera, value)
        return out

    return apply


def _moved_line(images: tuple[int, ...]) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    """The optical axis some lines further."""

    def change(camera: FrameCamera, value: float) -> FrameCamera:
        line, column = camera.detector.principal_point_px
        return camera.with_detector(replace(camera.detector, principal_point_px=(line + value, column)))

    return _changed(images, change)


def _scaled(images: tuple[int, ...]) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    """The focal length longer by a part of itself."""

    def change(camera: FrameCamera, value: float) -> FrameCamera:
        focal = camera.detector.focal_length_px * (1.0 + value)
        return camera.with_detector(replace(camera.detector, focal_length_px=focal))

    return _changed(images, change)


def _drifting(axis: int, distance: float) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    """The platform moving past what it sees, `value` times the distance per second along a world axis."""

    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        for k, camera in enumerate(cameras):
            trajectory = camera.trajectory
            position = trajectory.position.copy()
            position[:, axis] += value * distance * trajectory.t_position
            out[k] = camera.with_trajectory(replace(trajectory, position=position))
        return out

    return apply


@dataclass(frozen=True, eq=False)
class SpinRows:
    """Every match as two equations about given unknowns.

    Attributes
    ----------
    residual : (M, 2)
        px; measured less predicted.
    design : (M, 2, P)
        px per unit of every unknown.
    covariance : (M, 2, 2)
        px^2; the matcher's.
    pair : (M,) int
        Which pair of strips.
    own : (M,)
        Share of the window's pixels that is its own.
    star, window, hub : (M,) int
        Where the match stands in the list of stars, and the image its window was cut from.
    at : (P,)
        The unknowns about which this is.
    lines : list of Star
        The stars as linearised.
    """

    residual: Array
    design: Array
    covariance: Array
    pair: NDArray[np.intp]
    own: Array
    star: NDArray[np.intp]
    window: NDArray[np.intp]
    hub: NDArray[np.intp]
    at: Array
    lines: list[Star]

    def left(self, x: Array) -> Array:
        """(M, 2) px; residuals at other unknowns `x` (P,)."""
        return np.asarray(self.residual - self.design @ (x - self.at))


def linear_rows(
    stars: Sequence[FrameStar],
    unknowns: SpinUnknowns,
    surface: Surface,
    pairs: Sequence[StripPair],
    x: Array,
) -> SpinRows:
    """All matches about the unknowns `x`."""
    cameras = unknowns.cameras(x)
    lines = linearise_frames(stars, cameras, surface, unknowns.statics)
    by_spin = unknowns.by_spin(x)
    six, constants = len(SPIN_NAMES), unknowns.constants
    seventh = constants - len(unknowns.layers)
    residual, design, covariance, pair, own, number, window, images = ([] for _ in range(8))
    for k, (star, line) in enumerate(zip(stars, lines, strict=True)):
        rows = np.flatnonzero(line.present[:, 0])
        if not len(rows):
            continue
        hub, partner = (unknowns.frames[image].exposure for image in (star.hub, star.images[0]))
        part = np.zeros((len(rows), 2, unknowns.size))
        by_hub, by_partner = line.by_hub[rows, 0], line.by_partner[rows, 0]
        part[:, :, :six] = by_hub @ by_spin[hub] + by_partner @ by_spin[partner]
        part[:, :, six:seventh] = line.by_static[rows, 0]
        left = line.residual_px[rows, 0]
        if unknowns.layers:
            lifted = _by_layer(star, cameras, surface, rows)
            of_hub, of_partner = (unknowns.frames[image].strip for image in (star.hub, star.images[0]))
            part[:, :, seventh + of_partner] += lifted
            part[:, :, seventh + of_hub] -= lifted
            left = left - part[:, :, seventh:constants] @ unknowns.heights(x)
        part[:, :, constants + 3 * hub : constants + 3 * hub + 3] += by_hub
        part[:, :, constants + 3 * partner : constants + 3 * partner + 3] += by_partner
        residual.append(left)
        design.append(part)
        covariance.append(line.covariance_px[rows, 0])
        pair.append(np.full(len(rows), pair_of(star, unknowns.frames, pairs)))
        own.append(reuse(star)[rows])
        number.append(np.full(len(rows), k))
        window.append(rows)
        images.append(np.full(len(rows), star.hub))
    return SpinRows(
        np.concatenate(residual),
        np.concatenate(design),
        np.concatenate(covariance),
        np.concatenate(pair),
        np.concatenate(own),
        np.concatenate(number),
        np.concatenate(window),
        np.concatenate(images),
        x.copy(),
        lines,
    )


def _by_layer(
    star: FrameStar, cameras: Sequence[FrameCamera], surface: Surface, rows: NDArray[np.intp]
) -> Array:
    """(M, 2) px per m that what the partner sees lies higher than what the hub sees.

    Both strips look at the same ground from nearly the same place: only the difference of heights counts.
    """
    ground = cameras[star.hub].locate(star.pixels[rows], surface)
    up = ground / np.linalg.norm(ground, axis=1, keepdims=True)
    partner = cameras[star.images[0]]
    plus, minus = (partner.project(ground + side * LAYER_STEP * up) for side in (1.0, -1.0))
    return np.nan_to_num((plus - minus) / (2.0 * LAYER_STEP))


@dataclass(frozen=True, eq=False)
class SpinNoise:
    """Errors of matches in units of the matcher's sigma: a factor per pair of strips, line and column.

    Attributes
    ----------
    scale : (pairs, 2)
    """

    scale: Array

    def covariance(self, rows: SpinRows) -> Array:
        """(M, 2, 2) px^2 of single matches."""
        s = self.scale[rows.pair]
        return np.asarray(rows.covariance * s[:, :, None] * s[:, None, :])


@dataclass(frozen=True, eq=False)
class SpinEstimate:
    """Posterior of the dense problem.

    Attributes
    ----------
    unknowns : SpinUnknowns
        With the size of the departures that the data ask for.
    x : (P,)
    covariance : (P, P)
    information : (P, P)
        Of the matches alone.
    cameras : list of FrameCamera
        Of all images.
    rows : SpinRows
        About `x`.
    kept : (M,) bool
        Matches that are believed.
    noise : SpinNoise
    pairs : tuple of StripPair
    departure_limit : (3,)
        rad; size of the departures about each axis that 95 % of what is likely stays below.
    """

    unknowns: SpinUnknowns
    x: Array
    covariance: Array
    information: Array
    cameras: list[FrameCamera]
    rows: SpinRows
    kept: NDArray[np.bool_]
    noise: SpinNoise
    pairs: tuple[StripPair, ...]
    departure_limit: Array

    @property
    def angles(self) -> Array:
        """(n, 3) rad; departure from the nominal attitude."""
        return self.unknowns.angles(self.x)

    @property
    def angle_covariance(self) -> Array:
        """(3n, 3n) rad^2, in the order of `angles`."""
        change = self.unknowns.to_angles(self.x)
        return np.asarray(change @ self.covariance @ change.T)

    @property
    def departures(self) -> Array:
        """(n, 3) rad; of every exposure from an even spin."""
        return self.x[self.unknowns.constants :].reshape(-1, 3)

    @property
    def departure_sigmas(self) -> Array:
        """(n, 3) rad; of `departures`."""
        return np.sqrt(np.diag(self.covariance)[self.unknowns.constants :]).reshape(-1, 3)


def solve_spin(
    stars: Sequence[FrameStar],
    unknowns: SpinUnknowns,
    surface: Surface,
    pairs: Sequence[StripPair],
    x: Array | None = None,
    *,
    steps: int = 2,
) -> SpinEstimate:
    """Maximum a posteriori of all unknowns, with mismatches found and the matches' errors learned.

    Parameters
    ----------
    stars : sequence of FrameStar
        One partner each.
    unknowns : SpinUnknowns
    surface : Surface
    pairs : sequence of StripPair
    x : (P,), optional
        Where to start; nominal by default.
    steps : int
        Linearisations.
    """
    x = np.zeros(unknowns.size) if x is None else x.copy()
    for _ in range(steps):
        rows = linear_rows(stars, unknowns, surface, pairs, x)
        fit = _Fit(rows, unknowns, len(pairs))
        fit.run(ROUNDS)
        x, unknowns = fit.x, fit.unknowns.learned(fit.information, fit.rhs, fit.x)
    rows = replace(fit.rows, residual=fit.rows.left(x), at=x)
    return SpinEstimate(
        unknowns,
        x,
        fit.covariance,
        fit.information,
        unknowns.cameras(x),
        rows,
        fit.kept,
        SpinNoise(fit.scale),
        tuple(pairs),
        fit.limit,
    )


class _Fit:
    """Rounds of solving, rejecting and learning about one linearisation."""

    def __init__(self, rows: SpinRows, unknowns: SpinUnknowns, pairs: int) -> None:
        """Start with every match and wide errors."""
        self.rows, self.unknowns = rows, unknowns
        self.x, self.kept = rows.at.copy(), np.ones(len(rows.residual), dtype=bool)
        self.scale = np.full((pairs, 2), 3.0)
        self.covariance = unknowns.prior_root @ unknowns.prior_root
        self.information = np.zeros_like(self.covariance)
        self.rhs, self.limit = np.zeros(len(self.covariance)), np.zeros(3)
        self.known, self.known_rhs = unknowns.known(rows.at)

    def run(self, rounds: int) -> None:
        """Solve, tell mismatches, learn; again."""
        for number in range(rounds):
            self._solve()
            self._learn(self.rows.left(self.x), first=number == 0)
        self._solve()
        self._size_departures()
        self._solve()

    def _solve(self) -> None:
        """All unknowns for the present weights."""
        rows = self.rows
        weight = np.linalg.inv(SpinNoise(self.scale).covariance(rows))
        weight *= np.where(self.kept, rows.own, 0.0)[:, None, None]
        weighed = np.einsum("mij,mjp->mip", weight, rows.design)
        self.information = np.einsum("mip,miq->pq", rows.design, weighed, optimize=True)
        self.rhs = np.einsum("mip,mi->p", weighed, rows.residual + rows.design @ rows.at)
        root = self.unknowns.prior_root
        # unit prior: what is known exactly and what is free differ by many powers of ten
        inverse = np.linalg.inv(root @ (self.information + self.known) @ root + np.eye(len(root)))
        covariance = root @ inverse @ root
        self.covariance = 0.5 * (covariance + covariance.T)
        self.x = self.covariance @ (self.rhs + self.known_rhs)

    def _size_departures(self) -> None:
        """What the data say of the departures' size, the constants taken out."""
        first = self.unknowns.constants
        root = self.unknowns.prior_root[:first, :first]
        every, right = self.information + self.known, self.rhs + self.known_rhs
        own = root @ every[:first, :first] @ root + np.eye(first)
        cross = root @ every[:first, first:]
        out = np.linalg.solve(own, np.column_stack([cross, root @ right[:first]]))
        information = every[first:, first:] - cross.T @ out[:, :-1]
        rhs = right[first:] - cross.T @ out[:, -1]
        size, self.limit = departure_sizes(information, rhs, self.unknowns.departure_sigma)
        self.unknowns = replace(self.unknowns, departure_sigma=size)

    def _learn(self, left: Array, *, first: bool) -> None:
        """Factors of the matcher's sigma for every pair of strips, and which matches are believed."""
        sigma = np.sqrt(np.einsum("mii->mi", self.rows.covariance))
        z = left / sigma
        for pair in range(len(self.scale)):
            of = np.flatnonzero(self.rows.pair == pair)
            if not len(of):
                continue
            trusted = of if first else of[self.kept[of]]
            robust = robust_sigmas(z[trusted if len(trusted) else of], axis=0)
            distance = np.sqrt(((z[of] / np.maximum(robust, 1e-3)) ** 2).sum(axis=1))
            self.kept[of] = distance < REJECT
            good = of[self.kept[of]]
            self.scale[pair] = np.maximum(np.sqrt((z[good] ** 2).mean(axis=0)), 0.05)
