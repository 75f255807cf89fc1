"""Star trackers, gyros and control points as rows of the joint estimate (S1, claim 12).

A star tracker reads the body's angles at an instant, a gyro their change over an interval, a control point
the line of sight of one pixel. Each kind has constants of its own (alignment, bias, drift) that are unknowns
beside the motion. Attitude sensors feel the body and not what trembles between it and the camera: the tones
of the motion are an error of theirs, of known spectrum.

Not here: reading tables (``io/``), the solution (``joint.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.sparse import csr_array, diags_array

from sightline.estimation.banded_blocks import StoredBand
from sightline.estimation.prior import Spectrum, Tone
from sightline.estimation.robust import robust_sigma
from sightline.geometry.trajectory import Trajectory
from sightline.motion.measure.predict import ANGLE_STEP, MovingCamera, StaticParameter, turned
from sightline.motion.measure.windows import exposure_times
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.strip.normal_equations import NormalEquations, TimeGrid

Array = NDArray[np.float64]

#: What a sensor may not feel of the motion before its spectrum is known, px of each axis.
UNSEEN_PX = 0.5
#: How much larger than in the motion its tones may be in a gyro's error. One that does not feel a tone errs
#: by just that tone: taken for an error of its own, of equal size, it would seem to halve the tone. At 5 its
#: reading counts for 4 % there.
UNFELT = 5.0
#: Earlier increments of a gyro that each one is compared with, as far as its errors remember.
MEMORY = 32
#: Readings farther than this (sigma) from the estimate lose weight, by the square.
CUT = 4.0
#: Readings of one sensor and axis from which its sigma is checked against their scatter.
ENOUGH = 12
#: An axis whose constant is known better than this is tied to the world (rad).
TIED = 0.1
#: A slow error is followed at this many readings at most; more are interpolated between.
SLOW_NODES = 64
#: Step of the finite difference by the ground position of a control point (m).
GROUND_STEP = 10.0


@dataclass(frozen=True, eq=False)
class SensorRows:
    """Readings of one sensor: linear in the motion at two instants, in statics and in constants of its own.

    Attributes
    ----------
    name, kind : str
        Kind is ``"star-tracker"``, ``"gyro"`` or ``"control points"``.
    given : int
        Readings in the table, three scalars each (two for a control point).
    instants : (N, 2)
        s.
    by : (N, 2, 3)
        By roll, pitch, yaw at each of the two instants; unit per rad.
    by_static : (N, Q)
        By the static parameters of the instrument.
    own : (N, S)
        By the sensor's own constants, of prior precision `own_precision` (S, S) and names `own_names`.
    value : (N,)
        rad (px for control points).
    whiten : sparse (N, N)
        Lower triangular; makes the errors independent, of unit size.
    axis : (N,)
        Which angle a reading tells (0 for control points): their sigmas are checked apart.
    scale : (N,)
        Factor on the variance that the scatter of the residuals asks for, at least 1.
    weight : (N,)
        Robust weights.
    """

    name: str
    kind: str
    given: int
    instants: Array
    by: Array
    by_static: Array
    own: Array
    own_precision: Array
    own_names: tuple[str, ...]
    value: Array
    whiten: csr_array
    axis: NDArray[np.intp]
    scale: Array = field(default_factory=lambda: np.empty(0))
    weight: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        """Start with the sigmas as given."""
        for name in ("scale", "weight"):
            if len(getattr(self, name)) != len(self.value):
                object.__setattr__(self, name, np.ones(len(self.value)))


@dataclass(frozen=True)
class SensorUse:
    """What one sensor gave to an estimate.

    Attributes
    ----------
    name, kind : str
    given, used : int
        Readings in its table, and during the strip.
    outliers : int
        Scalar readings that lost more than half of their weight.
    sigma_factor : tuple of float
        Per axis: by how much its sigma was enlarged to fit the scatter of its residuals.
    constants : dict
        Name -> (value, sigma) of its own constants; rad, rad/s.
    """

    name: str
    kind: str
    given: int
    used: int
    outliers: int
    sigma_factor: tuple[float, ...]
    constants: dict[str, tuple[float, float]]


# ---------------------------------------------------------------------------- rows of each kind


def attitude_rows(
    sensor: AttitudeSensor,
    span: tuple[float, float],
    statics: int,
    unfelt: Sequence[Spectrum | None],
    unseen: Array,
    reference: Trajectory,
    memory: float,
) -> SensorRows | None:
    """Readings of an attitude sensor during the strip; None if there are none.

    Parameters
    ----------
    sensor : AttitudeSensor
    span : (float, float)
        s; first and last instant of the estimated motion.
    statics : int
        Static parameters of the instrument.
    unfelt : three Spectrum or None
        Of roll, pitch, yaw: what the camera does and the body does not (rad).
    unseen : (3,)
        rad; white error of each instant beside it.
    reference : Trajectory
        The reference attitude: a misaligned gyro takes some of its rate for motion.
    memory : float
        s; how far back a gyro's correlated errors are followed.
    """
    inside = np.flatnonzero((sensor.t_start >= span[0]) & (sensor.t_end <= span[1]))
    if len(inside) == 0:
        return None
    inside = inside[np.argsort(sensor.t_start[inside], kind="stable")]
    chosen = replace(
        sensor,
        t_start=sensor.t_start[inside],
        t_end=sensor.t_end[inside],
        angles=sensor.angles[inside],
        sigma=sensor.sigma[inside],
    )
    given = len(sensor.t_start)
    if sensor.kind == "gyro":
        return _gyro_rows(chosen, given, statics, unfelt, unseen, reference, memory)
    return _star_tracker_rows(chosen, given, statics, unfelt, unseen)


def _star_tracker_rows(
    sensor: AttitudeSensor, given: int, statics: int, unfelt: Sequence[Spectrum | None], unseen: Array
) -> SensorRows:
    """Angles at instants: constant of alignment and bias, a slow error where it has a correlation time."""
    count = len(sensor.t_end)
    axis, t = np.repeat(np.arange(3), count), np.tile(sensor.t_end, 3)
    by = np.zeros((3 * count, 2, 3))
    by[np.arange(3 * count), 1, axis] = 1.0
    own, precision, names = _constant(axis, _offset_sigma(sensor), "offset")
    white, slow = _parts(sensor, np.ones(count))
    if slow > 0.0:
        follow, markov, lost = _slow_errors(sensor.t_end, slow, sensor.correlation_time)
        own, precision = np.concatenate([own, follow], axis=1), block_diag(precision, markov)
        names += ("",) * follow.shape[1]
        white = white + lost
    tones = np.array([0.0 if s is None else s.sigma**2 for s in unfelt])
    variance = np.tile(white, 3) + (tones + unseen**2)[axis]
    return SensorRows(
        sensor.name,
        sensor.kind,
        given,
        np.stack([t, t], axis=1),
        by,
        np.zeros((3 * count, statics)),
        own,
        precision,
        names,
        sensor.angles.T.ravel(),
        csr_array(diags_array(1.0 / np.sqrt(variance))),
        axis,
    )


def _offset_sigma(sensor: AttitudeSensor) -> float:
    """Of the constant of a star tracker; its bias is part of it unless it wanders."""
    bias = 0.0 if sensor.correlation_time > 0.0 else sensor.bias_sigma
    return float(np.hypot(sensor.alignment_sigma, bias))


def _constant(axis: NDArray[np.intp], sigma: float, name: str) -> tuple[Array, Array, tuple[str, ...]]:
    """Columns, precision and names of one constant per axis; none where it is known exactly."""
    if sigma == 0.0:
        return np.zeros((len(axis), 0)), np.zeros((0, 0)), ()
    names = tuple(f"{name} of {angle}" for angle in ("roll", "pitch", "yaw"))
    return np.eye(3)[axis], np.eye(3) / sigma**2, names


def _parts(sensor: AttitudeSensor, per: Array) -> tuple[Array, float]:
    """Variance (N,) of a sensor's independent errors, and the sigma of its slow one per unit of `per` (N,).

    Without a bias a correlation time says that the errors of the table themselves are alike for so long; one
    part in a hundred is left to each reading.
    """
    if sensor.correlation_time == 0.0:
        return sensor.sigma**2, 0.0
    if sensor.bias_sigma > 0.0:
        return sensor.sigma**2, sensor.bias_sigma
    return 1e-4 * sensor.sigma**2, float(np.median(sensor.sigma / per))


def _slow_errors(t: Array, sigma: float, time: float) -> tuple[Array, Array, Array]:
    """First-order Gauss-Markov errors of the three axes at instants `t` (N,).

    Returns
    -------
    weights : (3N, 3M)
        By their values at M instants.
    precision : (3M, 3M)
    lost : (N,)
        Variance of what is between these instants.
    """
    nodes = t if len(t) <= SLOW_NODES else np.linspace(t[0], t[-1], SLOW_NODES)
    rho = np.exp(-np.diff(nodes) / time)
    # the precision of a Markov chain touches neighbours only
    step = 1.0 / np.maximum(1.0 - rho**2, 1e-12)
    precision = np.diag(np.append(1.0, step) + np.append(rho**2 * step, 0.0))
    precision -= np.diag(rho * step, 1) + np.diag(rho * step, -1)
    weights, lost = np.eye(len(t)), np.zeros(len(t))
    if len(t) > len(nodes):
        at = np.clip(np.searchsorted(nodes, t), 1, len(nodes) - 1)
        right = (t - nodes[at - 1]) / (nodes[at] - nodes[at - 1])
        weights = np.zeros((len(t), len(nodes)))
        weights[np.arange(len(t)), at - 1], weights[np.arange(len(t)), at] = 1.0 - right, right
        between = np.exp(-np.abs(t[:, None] - nodes) / time)
        known = np.exp(-np.abs(nodes[:, None] - nodes) / time)
        lost = 1.0 - 2.0 * (weights * between).sum(axis=1)
        lost = sigma**2 * np.maximum(lost + np.einsum("nk,kl,nl->n", weights, known, weights), 0.0)
    every = np.asarray(np.kron(np.eye(3), weights))
    return every, np.asarray(np.kron(np.eye(3), precision) / sigma**2), lost


def _gyro_rows(
    sensor: AttitudeSensor,
    given: int,
    statics: int,
    unfelt: Sequence[Spectrum | None],
    unseen: Array,
    reference: Trajectory,
    memory: float,
) -> SensorRows:
    """Increments over intervals: drift and misalignment as constants, tones as correlated errors."""
    count = len(sensor.t_end)
    axis = np.repeat(np.arange(3), count)
    instants = np.tile(np.stack([sensor.t_start, sensor.t_end], axis=1), (3, 1))
    by = np.zeros((3 * count, 2, 3))
    by[np.arange(3 * count), 0, axis], by[np.arange(3 * count), 1, axis] = -1.0, 1.0
    width = sensor.t_end - sensor.t_start
    white, slow = _parts(sensor, width)
    drift, precision, names = _constant(axis, 0.0 if slow > 0.0 else sensor.bias_sigma, "drift")
    if slow > 0.0:
        middle = 0.5 * (sensor.t_start + sensor.t_end)
        drift, precision, lost = _slow_errors(middle, slow, sensor.correlation_time)
        names = ("",) * drift.shape[1]
        white = white + lost * width**2
    own = drift * np.tile(width, 3)[:, None]
    if sensor.alignment_sigma > 0.0:
        # a turn m of the sensor's axes reads -m x of what it turns by, reference attitude included
        turn = sensor.angles + _reference_turns(sensor, reference)
        own = np.concatenate([own, -_cross(turn).transpose(1, 0, 2).reshape(3 * count, 3)], axis=1)
        precision = block_diag(precision, np.eye(3) / sensor.alignment_sigma**2)
        names += tuple(f"misalignment about {angle}" for angle in ("roll", "pitch", "yaw"))
    steps = int(np.clip(memory / np.median(width), 4, MEMORY))
    parts = []
    for k in range(3):
        tones = unfelt[k]
        larger = None if tones is None else tones.scaled(UNFELT)
        noise = _IncrementNoise(sensor.t_start, sensor.t_end, white, larger, float(unseen[k]))
        parts.append(noise.whitening(steps))
    return SensorRows(
        sensor.name,
        sensor.kind,
        given,
        instants,
        by,
        np.zeros((3 * count, statics)),
        own,
        precision,
        names,
        sensor.angles.T.ravel(),
        _block_diagonal(parts),
        axis,
    )


def _reference_turns(sensor: AttitudeSensor, reference: Trajectory) -> Array:
    """(N, 3) rad; how the reference attitude turns over each interval, body axes."""
    low, high = reference.span
    start = reference.at(np.clip(sensor.t_start, low, high)).world_from_body
    end = reference.at(np.clip(sensor.t_end, low, high)).world_from_body
    return np.asarray((start.inv() * end).as_rotvec())


def _cross(vectors: Array) -> Array:
    """Matrices (N, 3, 3) of ``m -> m x v``."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, z, -y], 1), np.stack([-z, zero, x], 1), np.stack([y, -x, zero], 1)], axis=1
    )


@dataclass(frozen=True, eq=False)
class _IncrementNoise:
    """Errors of one axis of a gyro: white, and what the camera did that the body did not."""

    t_start: Array
    t_end: Array
    white: Array
    unfelt: Spectrum | None
    unseen: float

    def whitening(self, memory: int) -> csr_array:
        """Lower triangular rows that make each error independent of the `memory` before it (Vecchia)."""
        count = len(self.t_end)
        memory = min(memory, count - 1)
        rows = np.arange(count)[:, None] + np.arange(-memory, 1)
        real = rows >= 0
        at = np.maximum(rows, 0)
        covariance = self._covariance(at)
        # before the first reading stand independent ones that nothing is learned from
        both = real[:, :, None] & real[:, None, :]
        covariance = np.where(both, covariance, 0.0) + np.eye(memory + 1) * (~real)[:, None, :]
        past = covariance[:, :-1, :-1]
        across = covariance[:, :-1, -1]
        gain = np.linalg.solve(past, across[..., None])[..., 0] if memory else np.zeros((count, 0))
        left = np.sqrt(covariance[:, -1, -1] - (gain * across).sum(axis=1))
        row = np.concatenate([-gain, np.ones((count, 1))], axis=1) / left[:, None]
        keep = real & (row != 0.0)
        lines = np.broadcast_to(np.arange(count)[:, None], at.shape)
        return csr_array((row[keep], (lines[keep], at[keep])), shape=(count, count))

    def _covariance(self, at: NDArray[np.intp]) -> Array:
        """(N, M, M) covariance of the errors of readings `at` (N, M) with one another."""
        t = np.stack([self.t_start[at], self.t_end[at]])
        total = np.zeros((*at.shape, at.shape[1]))
        for i, one in ((-1.0, t[0]), (1.0, t[1])):
            for j, other in ((-1.0, t[0]), (1.0, t[1])):
                apart = np.abs(one[:, :, None] - other[:, None, :])
                part = self.unseen**2 * (apart < 1e-9)
                if self.unfelt is not None:
                    part = part + self.unfelt.autocovariance(apart.ravel()).reshape(apart.shape)
                total += i * j * part
        return np.asarray(total + np.eye(at.shape[1]) * self.white[at][:, None, :])


def _block_diagonal(parts: Sequence[csr_array]) -> csr_array:
    from scipy.sparse import block_diag as sparse_block_diag

    return csr_array(sparse_block_diag(parts, format="csr"))


def control_rows(
    points: ControlSightings,
    cameras: Sequence[MovingCamera],
    parameters: Sequence[StaticParameter],
    grid: TimeGrid,
    nodes: Array,
    statics: Array,
) -> SensorRows | None:
    """Where control points were seen against where the cameras see them; None if none is in view.

    Parameters
    ----------
    points : ControlSightings
    cameras : sequence of cameras
        Carrying the motion `nodes` (count, 3) of `grid` and `statics` (Q,).
    parameters : sequence of StaticParameter
        The static parameters that `statics` holds.
    """
    blocks = [
        _control_of_image(points, k, cameras, parameters, grid, nodes, statics)
        for k in np.unique(points.image)
    ]
    t, by, by_static, value, whiten = (np.concatenate(part) for part in zip(*blocks, strict=True))
    if len(t) == 0:
        return None
    instants = np.repeat(t, 2, axis=0)
    shares = np.array([0.0, 1.0] if points.lines is None else [0.5, 0.5])
    both = by.reshape(-1, 1, 3) * shares[:, None]
    return SensorRows(
        "control points",
        "control points",
        len(points.sigma),
        instants,
        both,
        by_static.reshape(len(instants), -1),
        np.zeros((len(instants), 0)),
        np.zeros((0, 0)),
        (),
        value.ravel(),
        _block_diagonal([csr_array(w) for w in whiten]),
        np.zeros(len(instants), dtype=np.intp),
    )


def _control_of_image(
    points: ControlSightings,
    image: int,
    cameras: Sequence[MovingCamera],
    parameters: Sequence[StaticParameter],
    grid: TimeGrid,
    nodes: Array,
    statics: Array,
) -> tuple[Array, Array, Array, Array, Array]:
    """Times (M, 2), sensitivities (M, 2, 3), (M, 2, Q), values (M, 2), whitening (M, 2, 2) of one image.

    The mean of the motion over the lines of a window is that of two instants in it, exact for cubics.
    """
    chosen = points.image == image
    camera, ground, seen = cameras[image], points.position[chosen], points.pixels[chosen]

    by = np.empty((len(ground), 2, 3))
    by_ground = np.empty((len(ground), 2, 3))
    for axis in range(3):
        unit = np.eye(3)[axis]
        turn, shift = ANGLE_STEP * unit, GROUND_STEP * unit
        ahead, back = turned(camera, turn).project(ground), turned(camera, -turn).project(ground)
        by[..., axis] = (ahead - back) / (2.0 * ANGLE_STEP)
        by_ground[..., axis] = (camera.project(ground + shift) - camera.project(ground - shift)) / (
            2.0 * GROUND_STEP
        )
    by_static = np.zeros((len(ground), 2, len(parameters)))
    for k, parameter in enumerate(parameters):
        if image in parameter.images:
            sides = [parameter.apply(cameras, s * parameter.step)[image].project(ground) for s in (1, -1)]
            by_static[..., k] = (sides[0] - sides[1]) / (2.0 * parameter.step)
    t = _window_instants(camera, seen, None if points.lines is None else points.lines[chosen])
    value = seen - camera.project(ground)
    moved = 0.5 * (grid.interpolate(nodes, t[:, 0]) + grid.interpolate(nodes, t[:, 1]))
    value += np.einsum("nij,nj->ni", by, moved) + by_static @ statics
    # what leaves the image within a step of a derivative is as if it were not in it
    every = np.concatenate([part.reshape(len(ground), -1) for part in (by, by_static, by_ground)], axis=1)
    known = np.asarray(np.isfinite(every).all(axis=1))
    by_ground = np.where(known[:, None, None], by_ground, 0.0)
    covariance = points.sigma[chosen, None, None] ** 2 * np.einsum("nij,nkj->nik", by_ground, by_ground)
    whiten = np.linalg.inv(
        np.linalg.cholesky(covariance + points.pixel_sigma(chosen)[:, :, None] ** 2 * np.eye(2))
    )
    last = grid.start + grid.step * (grid.count - 1)
    good = known & np.isfinite(value).all(axis=1) & ((t >= grid.start) & (t <= last)).all(axis=1)
    # windows end with the image, so that their instants do not tell a place beyond it
    good &= (seen[:, 0] >= -1.0) & (seen[:, 0] <= camera.shape[0])
    return t[good], by[good], by_static[good], value[good], whiten[good]


def _window_instants(camera: MovingCamera, seen: Array, lines: Array | None) -> Array:
    """(N, 2) s; instants whose mean is that of a cubic over so many lines about each pixel (N, 2)."""
    t = exposure_times(camera, seen)
    if lines is None:
        return np.stack([t, t], axis=1)
    away = np.stack([np.sqrt((lines**2 - 1.0) / 12.0), np.zeros(len(lines))], axis=1)
    ends = np.array([0.0, camera.shape[0] - 1.0])
    inside = [np.stack([np.clip(p[:, 0], *ends), p[:, 1]], axis=1) for p in (seen - away, seen + away)]
    return np.stack([exposure_times(camera, p) for p in inside], axis=1)


# ---------------------------------------------------------------------------- their equations


@dataclass(frozen=True, eq=False)
class Ties:
    """Rows of all sensors on a grid, ready to be joined to the images'.

    Attributes
    ----------
    rows : tuple of SensorRows
    equations : NormalEquations
        Of the motion and, in the border, the statics and then all sensors' own constants.
    own_precision : (S, S)
        Prior of the latter.
    tied : (3,) bool
        Axes whose constant is known from outside the images.
    """

    rows: tuple[SensorRows, ...]
    equations: NormalEquations
    own_precision: Array
    tied: NDArray[np.bool_]


def tie(rows: Sequence[SensorRows], grid: TimeGrid, block: int) -> Ties:
    """Sum the information of all sensors.

    Parameters
    ----------
    rows : sequence of SensorRows
        At least one.
    grid : TimeGrid
    block : int
        Unknowns per node (3 angles, or 5 with relief).
    """
    statics = rows[0].by_static.shape[1]
    own = block_diag(*[r.own_precision for r in rows])
    before = np.cumsum([0] + [r.own.shape[1] for r in rows])
    n, q = block * grid.count, statics + len(own)
    total = csr_array((n, n))
    border, corner = np.zeros((n, q)), np.zeros((q, q))
    rhs, rhs_static, chi2 = np.zeros(n), np.zeros(q), 0.0
    for r, first in zip(rows, before, strict=False):
        motion, side, value = _whitened(r, grid, block)
        beside = np.zeros((len(value), q))
        beside[:, :statics] = side[:, :statics]
        beside[:, statics + first : statics + first + r.own.shape[1]] = side[:, statics:]
        total = total + motion.T @ motion
        border += motion.T @ beside
        corner += beside.T @ beside
        rhs += motion.T @ value
        rhs_static += beside.T @ value
        chi2 += float(value @ value)
    count = sum(len(r.value) for r in rows)
    ab = StoredBand.of(_lower_band(total))
    equations = NormalEquations(grid, block, ab, border, corner, rhs, rhs_static, chi2, count)
    return Ties(tuple(rows), equations, own, _tied(rows))


def add_ties(images: NormalEquations, ties: Ties) -> NormalEquations:
    """The information of images and sensors together."""
    more = ties.equations
    ab = images.ab.plus(more.ab)
    # statics, which both have; then what only the images have; then the sensors' constants
    own, q = len(ties.own_precision), len(images.rhs_static)
    place = np.concatenate([np.arange(len(more.rhs_static) - own), np.arange(q, q + own)])
    border, corner, rhs_static = (
        np.zeros((len(images.rhs), q + own)),
        np.zeros((q + own,) * 2),
        np.zeros(q + own),
    )
    border[:, :q], corner[:q, :q], rhs_static[:q] = images.border, images.corner, images.rhs_static
    border[:, place] += more.border
    corner[np.ix_(place, place)] += more.corner
    rhs_static[place] += more.rhs_static
    return NormalEquations(
        images.grid,
        images.block,
        ab,
        border,
        corner,
        images.rhs + more.rhs,
        rhs_static,
        images.chi2 + more.chi2,
        images.rows + more.rows,
    )


def reweighted(
    rows: SensorRows, grid: TimeGrid, nodes: Array, statics: Array, own: Array, *, believed: bool = False
) -> SensorRows:
    """The rows with their sigma and weights from what an estimate leaves of them.

    Parameters
    ----------
    nodes : (count, 3), statics : (Q,), own : (S,)
        Estimated motion, static parameters and constants of this sensor.
    believed : bool
        The sigmas are as given: an estimate that one wrong reading has drawn aside leaves much of the right
        ones, too, and would have all of them mistrusted.

    Notes
    -----
    Sigmas only grow: an estimate that follows its readings leaves less of them than their sigma. The size is
    that of the middle of the residuals, which outliers do not move.
    """
    plain = replace(rows, scale=np.ones(len(rows.value)), weight=np.ones(len(rows.value)))
    motion, side, value = _whitened(plain, grid, nodes.shape[1])
    left = value - motion @ nodes.ravel() - side @ np.concatenate([statics, own])
    scale = np.ones(len(left))
    for axis in range(3):
        mine = rows.axis == axis
        if mine.sum() >= ENOUGH and not believed:
            size = robust_sigma(left[mine]) ** 2
            # the squared median of n Gaussian numbers scatters by 2.33 / sqrt(n): twice that is no sign
            scale[mine] = size if size > 1.0 + 2.0 * 2.33 / np.sqrt(mine.sum()) else 1.0
    weight = np.minimum(1.0, (CUT * np.sqrt(scale) / np.maximum(np.abs(left), 1e-12)) ** 2)
    return replace(rows, scale=scale, weight=weight)


def uses(ties: Ties, own: Array, own_sigma: Array) -> tuple[SensorUse, ...]:
    """What every sensor gave, with the estimates (S,) of their own constants and their sigmas (S,)."""
    out, first = [], 0
    for r in ties.rows:
        per = 2 if r.kind == "control points" else 3
        axes = (0,) if r.kind == "control points" else (0, 1, 2)
        named = [k for k, name in enumerate(r.own_names) if name]
        constants = {r.own_names[k]: (float(own[first + k]), float(own_sigma[first + k])) for k in named}
        factors = tuple(float(np.sqrt(r.scale[r.axis == a].max(initial=1.0))) for a in axes)
        out.append(
            SensorUse(
                r.name,
                r.kind,
                r.given,
                len(r.value) // per,
                int((r.weight < 0.5).sum()),
                factors,
                constants,
            )
        )
        first += r.own.shape[1]
    return tuple(out)


def own_parts(ties: Ties, own: Array) -> list[Array]:
    """The constants (S,) of all sensors, sensor by sensor."""
    return np.split(own, np.cumsum([r.own.shape[1] for r in ties.rows])[:-1])


def unfelt_tones(spectra: Sequence[Spectrum]) -> list[Spectrum | None]:
    """Errors that the tones of each axis' spectrum are to attitude sensors, which may feel them or not."""
    tones = [tuple(c for c in s.components if isinstance(c, Tone)) for s in spectra]
    return [Spectrum(parts) if parts else None for parts in tones]


def _whitened(rows: SensorRows, grid: TimeGrid, block: int) -> tuple[csr_array, Array, Array]:
    """Whitened rows: by the unknowns of the grid, by statics and own constants, and their values."""
    count = len(rows.value)
    places, lines, values = [], [], []
    for k in range(2):
        first, w = grid.weights(rows.instants[:, k])
        for axis in range(3):
            share = rows.by[:, k, axis]
            used = np.flatnonzero(share)
            for tap in range(w.shape[1]):
                places.append((first[used] + tap) * block + axis)
                lines.append(used)
                values.append(share[used] * w[used, tap])
    design = csr_array(
        (np.concatenate(values), (np.concatenate(lines), np.concatenate(places))),
        shape=(count, block * grid.count),
    )
    whiten = csr_array(diags_array(np.sqrt(rows.weight / rows.scale))) @ rows.whiten
    side = np.concatenate([rows.by_static, rows.own], axis=1)
    return csr_array(whiten @ design), np.asarray(whiten @ side), np.asarray(whiten @ rows.value)


def _lower_band(matrix: csr_array) -> Array:
    """Lower band storage of a sparse symmetric matrix."""
    entries = matrix.tocoo()
    below = entries.row >= entries.col
    depth = entries.row[below] - entries.col[below]
    ab = np.zeros((int(depth.max(initial=0)) + 1, matrix.shape[0]))
    ab[depth, entries.col[below]] = entries.data[below]
    return ab


def _tied(rows: Sequence[SensorRows]) -> NDArray[np.bool_]:
    """Axes whose constant the sensors know."""
    information = np.eye(3)  # a radian is no knowledge
    for r in rows:
        if r.kind == "gyro":
            continue
        turn = r.by.sum(axis=1)
        whitened = r.whiten @ turn
        information += whitened.T @ whitened
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    return np.asarray(sigma < TIED)
