"""Gyros and attitudes of a product as tables beside ACQUISITION.toml, and what they rest on.

Not here: reading them (``io/formats/products/``), fitting gyros (``motion/gyros.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, InputError
from sightline.geometry.trajectory import Trajectory
from sightline.io.formats.products.makers import TURNING
from sightline.io.formats.products.pleiades_telemetry import PleiadesTelemetry, read_pleiades_telemetry
from sightline.io.formats.products.product import Product
from sightline.io.formats.products.recognise import product_kind
from sightline.io.formats.tables import ATTITUDES, GYRO, write_columns
from sightline.motion.gyros import GyroFit, GyroNoise, departures, fit_gyros

Array = NDArray[np.float64]

_GYRO, _ATTITUDES = "gyro.csv", "attitudes.csv"


@dataclass(frozen=True)
class FirstSensors:
    """What is known of the attitude beside images.

    Attributes
    ----------
    text : str
        ``[[attitude_sensor]]`` of ACQUISITION.toml.
    tables : mapping
        Names of files to their columns.
    assumed, unknown : tuple of str
        As of `FirstAcquisition`.
    """

    text: str
    tables: Mapping[str, Mapping[str, ArrayLike]]
    assumed: tuple[str, ...]
    unknown: tuple[str, ...]

    def write(self, folder: Path) -> None:
        """All tables into a folder."""
        for name, columns in self.tables.items():
            write_columns(folder / name, columns, dict.fromkeys(columns, "%.17g"))


def first_sensors(product: Product, flown: Trajectory | None = None) -> FirstSensors | None:
    """Sensors of a product whose metadata hold telemetry; None of others.

    Angles of gyros are turned into increments about the body axes of the product's model, less those of its
    reference attitude, or of that of `flown` where another one is the platform's.
    """
    if product_kind(product.path) != "pleiades":
        return None
    try:
        read = read_pleiades_telemetry(product.path)
    except FormatError as error:
        return _unused(str(error))
    if read is None:
        return None
    trajectory = product.model.camera.trajectory if flown is None else flown
    later = product.model.camera.first_line_time
    begin, end = trajectory.span
    t = read.t + later
    used = (t >= begin) & (t <= end)
    held = (read.t_earth >= read.t_attitude[0] - 1e-6) & (read.t_earth <= read.t_attitude[-1] + 1e-6)
    if used.sum() < 2:
        return _unused("fewer than two of their readings lie within the image")
    axes = body_turn(product, read.modelled)
    t_known = read.t_earth[held] + later
    known = Rotation.from_rotvec(np.outer(t_known, TURNING)) * read.earth_from_body[held] * axes
    try:
        fit = fit_gyros(t, read.counts, t_known, known)
    except InputError as error:
        return _unused(str(error))
    noise, drift = fit.noise(t, read.counts), _drift(read)
    turned = fit.body(t, read.counts)[used]
    angles = departures(t[used], turned, trajectory.at(t[used]).world_from_body, TURNING)
    sigma = float(noise.sigma.max())
    rows = [t[used][:-1], t[used][1:], *angles.T, np.full(len(angles), sigma)]
    quaternions = read.earth_from_body.as_quat()
    return FirstSensors(
        _text(drift),
        {
            _GYRO: dict(zip(GYRO, rows, strict=True)),
            _ATTITUDES: dict(zip(ATTITUDES, (read.t_earth + later, *quaternions.T), strict=True)),
        },
        (*_fitted(fit), _noise(noise), _reference()),
        (
            f"drift of the gyros: {np.ptp(t):.3g} s are too short for its stability; bias_sigma is how far "
            f"attitudes on board and on ground drift apart, {drift:.2g} rad/s",
            "what star trackers measured: the file holds the filter's quaternions alone",
        ),
    )


def body_turn(product: Product, attitude: Callable[[Array], Rotation]) -> Rotation:
    """file_from_body: the turn about z to the body axes that are chosen for the product's model.

    `attitude`: of the file's own axes at times (s) from line 0 of the product.
    """
    camera = product.model.camera
    inside = np.array([0.5 * sum(camera.trajectory.span)])
    return attitude(inside - camera.first_line_time).inv() * camera.trajectory.at(inside).world_from_body


def _unused(why: str) -> FirstSensors:
    return FirstSensors("", {}, (), (f"what the gyros of the file show: {why}; they are not used",))


def _drift(read: PleiadesTelemetry) -> float:
    """rad/s: how fast the two filters drift apart, of the axis where it is most."""
    apart = (read.stars_from_body.inv() * read.onboard).as_rotvec()
    return float(np.abs(np.polynomial.polynomial.polyfit(read.t_attitude, apart, 1)[1]).max())


def _text(drift: float) -> str:
    return "\n".join(
        [
            "[[attitude_sensor]]   # gyros: increments of the departure from the attitude of [platform]",
            'name = "gyros"',
            'kind = "gyro"',
            f'table = "{_GYRO}"',
            f"bias_sigma = {drift:.3g}   # rad/s: how far the attitudes on board and on ground drift apart",
        ]
    )


def _fitted(fit: GyroFit) -> tuple[str, ...]:
    """Scale and axes in words."""
    angles = np.degrees(np.arccos(np.clip(fit.axes @ fit.axes.T, -1.0, 1.0)))[
        np.triu_indices(len(fit.axes), 1)
    ]
    scale = ", ".join(f"{value:.3g}" for value in fit.scale)
    return (
        f"scale and axes of the {len(fit.scale)} gyros, which the file does not hold, are fitted to its "
        f"quaternions: {scale} rad a count, axes {angles.min():.1f} to {angles.max():.1f} degrees apart; "
        f"increments then agree to {1e6 * fit.residual.std():.2g} urad, best {1e3 * fit.lag:.1f} ms later "
        "than their labels",
    )


def _noise(noise: GyroNoise) -> str:
    said = ", ".join(f"{d:.2g} at {t:.3g} s" for t, d in zip(noise.tau, noise.deviation, strict=True))
    return (
        f"noise of the gyros by the Allan deviation of their parity, rad/s: {said}; sigma of an increment, "
        f"{noise.sigma.max():.2g} rad, is that of a random walk that is nowhere below it"
    )


def _reference() -> str:
    return (
        f"quaternions ({_ATTITUDES}, Earth-fixed) are the output of a filter over the same gyros: a "
        "reference, and no sensor beside them"
    )
