"""Images, star tracker and gyro in one estimate, beside the bound and a prototype.

Prints, for each combination, the error of the whole angle ("absolute") and of the angle less its mean
("relative"), px: a prototype's figure, the bound (dense covariances written out here, which share no code
with the package), the stated sigma, and the rms against a truth drawn from those dense covariances. Tones of
the prototype were damped cosines, those of the truth are oscillators that noise drives, whose lines have
smaller tails: where images see them the prototype's figure is taken times the ratio of the bounds. Every
case meets the same motions and the same errors of its matches: what sensors add to images shows in their
rms, too.

    python validation/fusion.py [--trials 40]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from sightline.estimation.banded_blocks import StoredBand
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.series import DifferenceSeries, Grid, series_equations
from sightline.estimation.split import split
from sightline.geometry.trajectory import Trajectory
from sightline.motion.sensors import AttitudeSensor
from sightline.motion.strip.fusion import SensorRows, attitude_rows, tie, unfelt_tones
from sightline.motion.strip.joint import JointPrior, angles_at, directions_at, solve_joint
from sightline.motion.strip.normal_equations import NormalEquations, TimeGrid, no_information

Array = NDArray[np.float64]

PX = 5e-6  # rad; the package works in rad, the table is in px
STEP, COUNT = 1e-3, 2000
EVERY, LAGS = 5, (172, 22, 7, 15)  # ms
BANDWIDTH = 0.8  # Hz
CORNER = 1.0 / (2.0 * np.pi * 30.0)  # s
TONES = ((0.30, 47.0), (0.15, 83.0), (0.08, 121.0))
ARC_SECOND = 1.0 / (5e-6 * 206264.806)  # px of 5 urad
GYRO_UNIT = np.deg2rad(1.0) / 60.0 / 5e-6  # px per root second of one degree per root hour
T = np.arange(COUNT) * STEP
SPECTRUM = Spectrum(
    (Matern(2.0, 1.0, "5/2"), Matern(0.1, CORNER, "3/2"), *(Tone(s, f, BANDWIDTH) for s, f in TONES))
).scaled(PX)


@dataclass(frozen=True)
class Case:
    """What is given: sigma of a star tracker (px), of a gyro (px per root second), of matches (px), lags."""

    name: str
    tracker: float | None
    gyro: float | None
    images: float | None
    lags: tuple[int, ...]
    prototype: tuple[float | None, float]


def _cases() -> list[Case]:
    one, three = ARC_SECOND, 3.0 * ARC_SECOND
    fine, coarse = 1e-3 * GYRO_UNIT, 1e-2 * GYRO_UNIT
    return [
        Case('ST 1"', one, None, None, LAGS, (0.561, 0.508)),
        Case('ST 3"', three, None, None, LAGS, (1.067, 0.799)),
        Case('ST 1" + gyro 1e-3', one, fine, None, LAGS, (0.423, 0.351)),
        Case('ST 1" + gyro 1e-2', one, coarse, None, LAGS, (0.481, 0.420)),
        Case("images .03", None, None, 0.03, LAGS, (None, 0.0287)),
        Case('ST 1" + images .03', one, None, 0.03, LAGS, (0.237, 0.0287)),
        Case('ST 3" + images .03', three, None, 0.03, LAGS, (0.706, 0.0287)),
        Case('ST 1" + gyro 1e-3 + images .03', one, fine, 0.03, LAGS, (0.237, 0.0284)),
        Case('ST 1" + gyro 1e-3 + images .1', one, fine, 0.1, LAGS, (0.241, 0.0531)),
        Case('ST 1" + images .1', one, None, 0.1, LAGS, (0.243, 0.0573)),
        Case("22.2 ms pair .03", None, None, 0.03, (22,), (None, 0.153)),
        Case("22.2 ms pair .1", None, None, 0.1, (22,), (None, 0.245)),
        Case('ST 1" + gyro 1e-3 + 22.2 ms pair .03', one, fine, 0.03, (22,), (0.267, 0.126)),
        Case('ST 1" + gyro 1e-3 + 22.2 ms pair .1', one, fine, 0.1, (22,), (0.283, 0.157)),
    ]


# ---------------------------------------------------------------------------- truth and bound, by hand


def dense_covariances() -> tuple[Array, Array, Array]:
    """Covariances (n, n) of what the body does, of the instrument beside it, and that of the prototype."""
    lag = np.arange(COUNT) * STEP
    a, b = np.sqrt(5.0) * lag, np.sqrt(3.0) * lag / CORNER
    body = 4.0 * (1.0 + a + a * a / 3.0) * np.exp(-a) + 0.01 * (1.0 + b) * np.exp(-b)
    instrument, cosines = np.zeros(COUNT), np.zeros(COUNT)
    for sigma, frequency in TONES:
        left, turn = sigma**2 * np.exp(-np.pi * BANDWIDTH * lag), 2.0 * np.pi * frequency * lag
        cosines += left * np.cos(turn)
        # a body that has mass keeps its speed, too
        instrument += left * (np.cos(turn) + BANDWIDTH / (2.0 * frequency) * np.sin(turn))
    return toeplitz(body), toeplitz(instrument), toeplitz(cosines)


FIXES = np.minimum(np.round(np.arange(17) * 0.125 / STEP).astype(int), COUNT - 1)
EDGES = np.arange(0, COUNT, 10)


def design(case: Case) -> tuple[Array, Array, Array]:
    """Rows (m, n) on the camera's motion, the same on the body's, and their variances (m,)."""
    camera, body, variance = [], [], []

    def add(count: int, where: list[tuple[Array, float]], sees_camera: bool, value: float) -> None:
        rows = np.zeros((count, COUNT))
        for at, factor in where:
            rows[np.arange(count), at] += factor
        (camera if sees_camera else body).append(rows)
        (body if sees_camera else camera).append(np.zeros((count, COUNT)))
        variance.append(np.full(count, value))

    if case.tracker is not None:
        add(len(FIXES), [(FIXES, 1.0)], False, case.tracker**2)
    if case.gyro is not None:
        add(len(EDGES) - 1, [(EDGES[1:], 1.0), (EDGES[:-1], -1.0)], False, case.gyro**2 * 10 * STEP)
    if case.images is not None:
        for lag in case.lags:
            at = np.arange(0, COUNT - lag, EVERY)
            add(len(at), [(at + lag, 1.0), (at, -1.0)], True, case.images**2)
    return np.concatenate(camera), np.concatenate(body), np.concatenate(variance)


def bound(case: Case, body: Array, instrument: Array) -> tuple[float, float]:
    """Posterior rms of the camera's motion (body + instrument): whole, and less its mean."""
    by_camera, by_body, variance = design(case)
    # both parts are seen by images, the body alone by sensors
    cross = (by_camera + by_body) @ body + by_camera @ instrument
    seen = (by_camera + by_body) @ body @ (by_camera + by_body).T + by_camera @ instrument @ by_camera.T
    seen[np.diag_indices_from(seen)] += variance
    left = body + instrument - cross.T @ np.linalg.solve(seen, cross)
    whole = float(np.sqrt(np.trace(left) / COUNT))
    centred = left - left.mean(axis=0) - left.mean(axis=1)[:, None] + left.mean()
    return whole, float(np.sqrt(np.trace(centred) / COUNT))


# ---------------------------------------------------------------------------- the package

GRID = TimeGrid(0.0, STEP, COUNT)
STILL = Trajectory.level_flight(680e3, 6800.0, -1.0, 4.0)


def image_equations(case: Case, motion: Array, rng: np.random.Generator) -> NormalEquations:
    """Differences of the three columns of `motion` (n, 3) as equations of three angles."""
    if case.images is None:
        return no_information(GRID, 0)
    parts = []
    size = PX * case.images
    noise = [size * rng.normal(size=(len(np.arange(0, COUNT - lag, EVERY)), 3)) for lag in case.lags]
    for axis in range(3):
        series = []
        for lag, errors in zip(case.lags, noise, strict=True):
            at = np.arange(0, COUNT - lag, EVERY)
            values = motion[at + lag, axis] - motion[at, axis] + errors[:, axis]
            ones = np.ones(len(at))
            series.append(DifferenceSeries(T[at], lag * STEP * ones, values, (PX * case.images) ** 2 * ones))
        parts.append(series_equations(series, Grid(0.0, STEP, COUNT)))
    depth = len(parts[0].band)
    ab, rhs = np.zeros((3 * depth - 2, 3 * COUNT)), np.zeros(3 * COUNT)
    for axis, part in enumerate(parts):
        ab[::3, axis::3] = part.band
        rhs[axis::3] = part.rhs
    return NormalEquations(
        GRID,
        3,
        StoredBand.of(ab),
        np.zeros((3 * COUNT, 0)),
        np.zeros((0, 0)),
        rhs,
        np.zeros(0),
        0.0,
        len(rhs),
    )


def sensor_rows(case: Case, body: Array, rng: np.random.Generator) -> list[SensorRows]:
    """Rows of the sensors' tables."""
    sensors = []
    if case.tracker is not None:
        angles = body[FIXES] + PX * case.tracker * rng.normal(size=(len(FIXES), 3))
        sigma = np.full(len(FIXES), PX * case.tracker)
        sensors.append(
            AttitudeSensor("tracker", "star-tracker", T[FIXES], T[FIXES], angles, sigma, 0.0, 0.0, 0.0)
        )
    if case.gyro is not None:
        sigma = np.full(len(EDGES) - 1, PX * case.gyro * np.sqrt(10 * STEP))
        angles = np.diff(body[EDGES], axis=0) + sigma[:, None] * rng.normal(size=(len(sigma), 3))
        sensors.append(
            AttitudeSensor("gyro", "gyro", T[EDGES[:-1]], T[EDGES[1:]], angles, sigma, 0.0, 0.0, 0.0)
        )
    unfelt, exact = unfelt_tones([SPECTRUM] * 3), np.zeros(3)
    rows = [attitude_rows(s, (0.0, T[-1]), 0, unfelt, exact, STILL, 2.0 * 0.172) for s in sensors]
    return [r for r in rows if r is not None]


def run(
    case: Case, roots: tuple[Array, Array], trials: int
) -> tuple[float, float, float, float, float, float]:
    """rms and stated sigma, absolute and relative, and NEES of both, over the trials (three axes each)."""
    process = SPECTRUM.autoregressive(STEP, 60, COUNT)
    width = (max(case.lags) if case.images is not None else 0) + 8
    drift = split(SPECTRUM, STEP, 60, COUNT, width=width)
    apart = None if drift is None else (drift, drift, drift)
    prior = JointPrior((process, process, process), np.zeros(0), apart=apart)
    absolute, relative, whole, part = [], [], [], []
    for number in range(-(-trials // 3)):
        of_motion, of_sensors, of_images = (np.random.default_rng([6, number, k]) for k in range(3))
        body = PX * roots[0] @ of_motion.normal(size=(COUNT, 3))
        motion = body + PX * roots[1] @ of_motion.normal(size=(COUNT, 3))
        rows = sensor_rows(case, body, of_sensors)
        ties = tie(rows, GRID, 3) if rows else None
        found = solve_joint(image_equations(case, motion, of_images), prior, ties)
        error = angles_at(found, T) - motion
        constant = directions_at(GRID, found.hidden_directions(), T)
        covariance = found.relative_covariance(T, constant, np.ones(3))
        absolute.append(error)
        relative.append(error - error.mean(axis=0))
        whole.append(found.absolute_sigma(T))
        part.append(np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]]))
    e, r, s, p = (np.array(x) / PX for x in (absolute, relative, whole, part))
    return (
        float(np.sqrt(np.mean(e**2))),
        float(np.sqrt(np.mean(s**2))),
        float(np.mean((e / s) ** 2)),
        float(np.sqrt(np.mean(r**2))),
        float(np.sqrt(np.mean(p**2))),
        float(np.mean((r / p) ** 2)),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--trials", type=int, default=40, help="simulated axes per case")
    parser.add_argument("--cases", nargs="+", help="some of them, by name")
    given = parser.parse_args()
    trials = given.trials
    body, instrument, damped_cosines = dense_covariances()
    roots = tuple(np.linalg.cholesky(c + 1e-9 * np.eye(COUNT)) for c in (body, instrument))
    columns = "| bound | stated | rms | NEES "
    print(f"| case | absolute: prototype {columns}| relative: prototype {columns}|")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    cases = [case for case in _cases() if not given.cases or case.name in given.cases]
    for case in cases:
        best = bound(case, body, instrument)
        rms_a, sigma_a, nees_a, rms_r, sigma_r, nees_r = run(case, (roots[0], roots[1]), trials)
        prototype, part = case.prototype
        if case.images is not None:
            part *= best[1] / bound(case, body, damped_cosines)[1]
        tied = case.tracker is not None
        first = f"{best[0]:.3f} | {sigma_a:.3f} | {rms_a:.3f} | {nees_a:.2f}" if tied else "- | - | - | -"
        print(
            f"| {case.name} | {'-' if prototype is None else prototype} | {first} "
            f"| {part:.4f} | {best[1]:.4f} | {sigma_r:.4f} | {rms_r:.4f} | {nees_r:.2f} |",
            flush=True,
        )
        if prototype is not None:
            gates.check(f"{case.name}: absolute sigma over the prototype's", sigma_a / prototype, 0.9, 1.1)
        gates.check(f"{case.name}: relative sigma over the prototype's", sigma_r / part, 0.9, 1.1)
        gates.check(f"{case.name}: stated sigma over the bound", sigma_r / best[1], 0.98, 1.15)
        if case.images is not None:
            # sensors alone rest on 17 fixes: theirs scatters too much to show anything
            gates.check(f"{case.name}: NEES, relative", nees_r, 0.8, 1.25)


if __name__ == "__main__":
    gates.run(main, __file__)
