"""Star trackers, gyros and control points as rows of the estimate of frames (S1, claim 12).

A reading between two frames is that of the line between their attitudes, but for what the body did besides: a
Brownian bridge, whose size the readings themselves tell against the frames. A control point that several
frames see brings the error of its position into all of them.

Not here: the readings of one sensor and its constants (``motion/strip/fusion.py``), the solution
(``solve.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from sightline.estimation.robust import robust_sigma
from sightline.geometry.camera import FrameCamera
from sightline.geometry.trajectory import Trajectory
from sightline.motion.measure.predict import ANGLE_STEP, StaticParameter, turned
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.strip.fusion import CUT, GROUND_STEP, SensorRows, SensorUse, attitude_rows

Array = NDArray[np.float64]

#: Sizes of the bridge that are tried, in parts of what the frames' own steps ask for; taken is their average,
#: each by its likelihood. The most likely alone would claim too much where few readings tell.
BRIDGES = (0.0, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
#: Readings of a star tracker that are taken at most, those nearest to frames: their covariance is dense.
MOST_READINGS = 500
#: Readings of one sensor and axis from which its sigma is checked against their scatter.
ENOUGH = 12


@dataclass(frozen=True, eq=False)
class _Readings:
    """One sensor's rows about the frames: values (N,), by the angles (N, 3n), errors of all kinds.

    `bridge` (N, N) is the covariance of what lies between frames for a body that wanders by 1 rad^2/s, `size`
    (3,) how much it does about each axis. `scale` (N,) enlarges the variances, `weight` (N,) is robust.
    `used` counts rows of the table.
    """

    rows: SensorRows
    design: Array
    bridge: Array
    white: Array
    size: Array
    scale: Array
    weight: Array
    used: int = 0

    def errors(self) -> Array:
        """(N, N) covariance of the readings' errors, constants of the sensor included."""
        own = self.rows.own @ np.linalg.solve(self.rows.own_precision, self.rows.own.T)
        return own + self.independent()

    def independent(self) -> Array:
        """(N, N) the same without the constants."""
        axis = self.rows.axis
        size = np.sqrt(self.size[axis])
        alike = axis[:, None] == axis
        return np.where(alike, self.bridge * np.outer(size, size), 0.0) + np.diag(
            self.white * self.scale / self.weight
        )


@dataclass(frozen=True, eq=False)
class FrameTies:
    """What is known of the frames besides their images.

    Attributes
    ----------
    times : (n,)
        s; of the frames.
    readings : tuple
        Of attitude sensors, during the frames.
    control : ControlSightings or None
    control_weight : (M,)
        Robust weights of its sightings.
    """

    times: Array
    readings: tuple[_Readings, ...]
    control: ControlSightings | None = None
    control_weight: Array = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(
        cls,
        cameras: Sequence[FrameCamera],
        sensors: Sequence[AttitudeSensor],
        control: ControlSightings | None,
    ) -> FrameTies | None:
        """Rows of what was given; None where nothing falls into the frames."""
        t = np.array([camera.t for camera in cameras])
        found = [_readings(sensor, t, cameras[0].trajectory) for sensor in sensors]
        readings = tuple(one for one in found if one is not None)
        if not readings and control is None:
            return None
        weight = np.ones(0 if control is None else len(control.sigma))
        return cls(t, readings, control, weight)

    def attitude(self, size: int, x: Array) -> tuple[Array, Array]:
        """Information (P, P) and right side (P,) of the attitude sensors at `x` (P,)."""
        information, rhs = np.zeros((size, size)), np.zeros(size)
        n = 3 * len(self.times)
        for one in self.readings:
            factor = cho_factor(one.errors(), lower=True)
            weighed = cho_solve(factor, one.design)
            information[:n, :n] += one.design.T @ weighed
            rhs[:n] += weighed.T @ (one.rows.value - one.design @ x[:n])
        return information, rhs

    def sightings(
        self, cameras: Sequence[FrameCamera], statics: Sequence[StaticParameter], lens: Array
    ) -> tuple[Array, Array, Array]:
        """Residuals (2M,) px of control points, by all unknowns (2M, P), their covariance (2M, 2M).

        Parameters
        ----------
        cameras : sequence of FrameCamera
            With all unknowns in them.
        statics : sequence of StaticParameter
        lens : (M, 2, F)
            Shift of each sighting with the unknowns of the lens field.
        """
        assert self.control is not None
        points, n = self.control, 3 * len(cameras)
        count, q = len(points.sigma), len(statics)
        value, by_ground = np.full((count, 2), np.nan), np.zeros((count, 2, 3))
        design = np.zeros((count, 2, n + q + lens.shape[2]))
        design[..., n + q :] = lens
        for image in np.unique(points.image):
            mine = np.flatnonzero(points.image == image)
            ground, camera = points.position[mine], cameras[image]
            value[mine] = points.pixels[mine] - camera.project(ground)
            for axis in range(3):
                turn, shift = ANGLE_STEP * np.eye(3)[axis], GROUND_STEP * np.eye(3)[axis]
                sides = turned(camera, turn).project(ground) - turned(camera, -turn).project(ground)
                design[mine, :, 3 * image + axis] = sides / (2.0 * ANGLE_STEP)
                sides = camera.project(ground + shift) - camera.project(ground - shift)
                by_ground[mine, :, axis] = sides / (2.0 * GROUND_STEP)
            for k, parameter in enumerate(statics):
                if image in parameter.images:
                    ends = [
                        parameter.apply(cameras, s * parameter.step)[image].project(ground) for s in (1, -1)
                    ]
                    design[mine, :, n + k] = (ends[0] - ends[1]) / (2.0 * parameter.step)
        good = np.isfinite(value).all(axis=1) & np.isfinite(design).all(axis=(1, 2))
        good &= np.isfinite(by_ground).all(axis=(1, 2))
        keep = np.flatnonzero(good)
        flat = by_ground[keep].reshape(-1, 3) * np.repeat(points.sigma[keep], 2)[:, None]
        same = np.repeat(_same_points(points.position[keep]), 2)
        covariance = np.where(same[:, None] == same, flat @ flat.T, 0.0)
        covariance += np.diag((points.pixel_sigma(keep) ** 2 / self.control_weight[keep, None]).ravel())
        return value[keep].ravel(), design[keep].reshape(2 * len(keep), -1), covariance

    def equations(
        self, cameras: Sequence[FrameCamera], statics: Sequence[StaticParameter], lens: Array, x: Array
    ) -> tuple[Array, Array]:
        """Information (P, P) and right side (P,) of all that is known, about `x` (P,) and its `cameras`."""
        information, rhs = self.attitude(len(x), x)
        if self.control is not None:
            value, design, covariance = self.sightings(cameras, statics, lens)
            if len(value):
                weighed = cho_solve(cho_factor(covariance, lower=True), design)
                information += design.T @ weighed
                rhs += weighed.T @ value
        return information, rhs

    def learned(self, x: Array, covariance: Array) -> FrameTies:
        """The same with sizes of the bridges, sigmas and weights as the frames' own attitudes show them.

        Parameters
        ----------
        x : (P,)
            Unknowns, and
        covariance : (P, P)
            theirs, by the images alone.
        """
        n = 3 * len(self.times)
        angles, known = x[:n].reshape(-1, 3), covariance[:n, :n]
        walk = (np.diff(angles, axis=0) ** 2 / np.diff(self.times)[:, None]).mean(axis=0)
        return replace(self, readings=tuple(_learned(one, x[:n], known, walk) for one in self.readings))

    def weighed(
        self, cameras: Sequence[FrameCamera], statics: Sequence[StaticParameter], lens: Array
    ) -> FrameTies:
        """The same with weights of the control points from what these cameras leave of them."""
        if self.control is None:
            return self
        plain = replace(self, control_weight=np.ones_like(self.control_weight))
        points = self.control
        weight = np.ones_like(self.control_weight)
        for image in np.unique(points.image):
            mine = np.flatnonzero(points.image == image)
            left = points.pixels[mine] - cameras[image].project(points.position[mine])
            weight[mine] = np.linalg.norm(left, axis=1)
        _, _, covariance = plain.sightings(cameras, statics, lens)
        usual = np.sqrt(np.diag(covariance).max(initial=0.0))
        size = max(robust_sigma(weight[np.isfinite(weight)]) if len(weight) >= ENOUGH else 0.0, usual)
        return replace(self, control_weight=np.minimum(1.0, (CUT * size / np.maximum(weight, 1e-9)) ** 2))

    def uses(self, x: Array, covariance: Array) -> tuple[SensorUse, ...]:
        """What every sensor gave, at the estimate `x` (P,) with its `covariance` (P, P)."""
        n, out = 3 * len(self.times), []
        for one in self.readings:
            rows = one.rows
            left = rows.value - one.design @ x[:n]
            solved = np.linalg.solve(one.independent(), rows.own)
            own_covariance = np.linalg.inv(rows.own_precision + rows.own.T @ solved)
            gain = own_covariance @ solved.T
            own = gain @ left
            spread = gain @ one.design
            sigma = np.sqrt(np.diag(own_covariance + spread @ covariance[:n, :n] @ spread.T))
            constants = {
                name: (float(own[k]), float(sigma[k])) for k, name in enumerate(rows.own_names) if name
            }
            factors = tuple(float(np.sqrt(one.scale[rows.axis == a].max(initial=1.0))) for a in range(3))
            lost = int((one.weight < 0.5).sum())
            out.append(SensorUse(rows.name, rows.kind, rows.given, one.used, lost, factors, constants))
        if self.control is not None:
            count = len(self.control.sigma)
            lost = 2 * int((self.control_weight < 0.5).sum())
            out.append(SensorUse("control points", "control points", count, count, lost, (1.0,), {}))
        return tuple(out)


def _same_points(position: Array) -> NDArray[np.intp]:
    """(M,) number of each sighting's point: sightings of one position are of one point."""
    _, number = np.unique(position, axis=0, return_inverse=True)
    return np.asarray(number).ravel()


def _readings(sensor: AttitudeSensor, t: Array, reference: Trajectory) -> _Readings | None:
    """Rows of a sensor about frames at `t` (n,); None if it has none during them."""
    if len(sensor.sigma) == 0:
        return None
    chosen = _joined(sensor, t) if sensor.kind == "gyro" else _nearest(sensor, t)
    rows = attitude_rows(chosen, (t[0], t[-1]), 0, (None,) * 3, np.zeros(3), reference, 0.0)
    if rows is None:
        return None
    used = int(((sensor.t_start >= t[0]) & (sensor.t_end <= t[-1])).sum())
    return replace(_about(replace(rows, given=len(sensor.sigma)), t), used=used)


def _joined(sensor: AttitudeSensor, t: Array) -> AttitudeSensor:
    """Increments of a gyro that lie between the same two frames, as one: nothing else asks for the parts."""
    order = np.argsort(sensor.t_start, kind="stable")
    begin, end = sensor.t_start[order], sensor.t_end[order]
    gap = np.searchsorted(t, begin, side="right")
    inside = end <= np.append(t, np.inf)[gap]
    same = np.zeros(len(order), dtype=bool)
    same[1:] = inside[1:] & inside[:-1] & (gap[1:] == gap[:-1])
    same[1:] &= np.abs(begin[1:] - end[:-1]) <= 1e-6 * (end - begin)[1:]
    first = np.flatnonzero(~same)
    return replace(
        sensor,
        t_start=begin[first],
        t_end=end[np.append(first[1:], len(order)) - 1],
        angles=np.add.reduceat(sensor.angles[order], first, axis=0),
        sigma=np.sqrt(np.add.reduceat(sensor.sigma[order] ** 2, first)),
    )


def _nearest(sensor: AttitudeSensor, t: Array) -> AttitudeSensor:
    """The readings of a star tracker nearest to frames, where there are very many."""
    if len(sensor.sigma) <= MOST_READINGS:
        return sensor
    at = np.clip(np.searchsorted(t, sensor.t_end), 1, len(t) - 1)
    apart = np.minimum(np.abs(sensor.t_end - t[at - 1]), np.abs(sensor.t_end - t[at]))
    keep = np.sort(np.argsort(apart, kind="stable")[:MOST_READINGS])
    parts = {key: getattr(sensor, key)[keep] for key in ("t_start", "t_end", "angles", "sigma")}
    return replace(sensor, **parts)


def _about(rows: SensorRows, t: Array) -> _Readings:
    """A sensor's rows by the angles of frames at `t` (n,)."""
    count = len(rows.value)
    design = np.zeros((count, 3 * len(t)))
    line = np.arange(count)
    for k in range(2):
        at = np.clip(np.searchsorted(t, rows.instants[:, k], side="right"), 1, len(t) - 1)
        share = (rows.instants[:, k] - t[at - 1]) / (t[at] - t[at - 1])
        for axis in range(3):
            design[line, 3 * (at - 1) + axis] += rows.by[:, k, axis] * (1.0 - share)
            design[line, 3 * at + axis] += rows.by[:, k, axis] * share
    sign = np.take_along_axis(rows.by, rows.axis[:, None, None], axis=2)[..., 0]
    bridge = np.zeros((count, count))
    for i in range(2):
        for j in range(2):
            part = _bridge(rows.instants[:, i], rows.instants[:, j], t)
            bridge += np.outer(sign[:, i], sign[:, j]) * part
    white = 1.0 / rows.whiten.diagonal() ** 2
    ones = np.ones(count)
    return _Readings(rows, design, bridge, white, np.zeros(3), ones, ones)


def _bridge(one: Array, other: Array, t: Array) -> Array:
    """(N, M) covariance of a Brownian motion of 1 rad^2/s at instants, its values at `t` taken off."""
    gap = [np.clip(np.searchsorted(t, at, side="right"), 1, len(t) - 1) for at in (one, other)]
    low, high = t[gap[0] - 1][:, None], t[gap[0]][:, None]
    early, late = np.minimum(one[:, None], other), np.maximum(one[:, None], other)
    inside = (early - low) * (high - late) / (high - low)
    return np.where(gap[0][:, None] == gap[1], np.maximum(inside, 0.0), 0.0)


def _learned(one: _Readings, x: Array, known: Array, walk: Array) -> _Readings:
    """Size of the bridge by the likelihood of the readings; sigma and weights by what they leave."""
    left = one.rows.value - one.design @ x
    size, scale, weight = one.size.copy(), np.ones(len(left)), np.ones(len(left))
    for axis in range(3):
        mine = np.flatnonzero(one.rows.axis == axis)
        if len(mine) < 2:
            continue
        own = one.rows.own[mine]
        design = one.design[mine]
        fixed = own @ np.linalg.solve(one.rows.own_precision, own.T) + design @ known @ design.T
        bridge = walk[axis] * one.bridge[np.ix_(mine, mine)]
        fits = np.array(
            [_likelihood(left[mine], fixed + np.diag(one.white[mine]) + part * bridge) for part in BRIDGES]
        )
        likely = np.exp(fits - fits.max())
        size[axis] = (likely @ BRIDGES) / likely.sum() * walk[axis]
        free = fixed + np.diag(one.white[mine]) + size[axis] / max(walk[axis], 1e-300) * bridge
        inverse = np.linalg.inv(free)
        normal = (inverse @ left[mine]) / np.sqrt(np.diag(inverse))
        if len(mine) >= ENOUGH:
            spread = robust_sigma(normal) ** 2
            # the squared median of n Gaussian numbers scatters by 2.33 / sqrt(n): twice that is no sign
            scale[mine] = spread if spread > 1.0 + 2.0 * 2.33 / np.sqrt(len(mine)) else 1.0
        weight[mine] = np.minimum(1.0, (CUT * np.sqrt(scale[mine]) / np.maximum(np.abs(normal), 1e-12)) ** 2)
    return replace(one, size=size, scale=scale, weight=weight)


def _likelihood(values: Array, covariance: Array) -> float:
    """Log likelihood of Gaussian values, but for a constant."""
    factor = cho_factor(covariance, lower=True)
    return float(-0.5 * values @ cho_solve(factor, values) - np.log(np.diag(factor[0])).sum())
