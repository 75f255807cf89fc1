"""Orbits and attitudes of Sentinel-1 as annotations list them, in CSV: their axes made those of one body.

Quaternions stand scalar last, from a body to the axes of 2000 (GM2000); their body flies along its -y. The
rates beside them are about other axes: x ahead, y right, z 30 degrees to the right of down (the antenna).
Axes x, y, z of the rates are -y, -x, -z of the quaternions: so the rates are those of the quaternions (1.5e-6
rad/s rms; 5e-4 as they stand), and the orbit agrees. That they need turning: ESA, EOCFI-NOTE-052, 2014.

Not here: messages of CCSDS (``ccsds_attitude.py``), tables in our own columns (``tables.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import check_file
from sightline.errors import FormatError, foreign_errors, reads
from sightline.estimation.allan import allan_deviation, random_walk
from sightline.io.formats.instants import seconds_from_epoch
from sightline.io.formats.tables import check_quaternions, check_times, read_columns

Array = NDArray[np.float64]

_ATTITUDE = ("time_utc", "frame", "q0", "q1", "q2", "q3", "wx", "wy", "wz")
_ORBIT = ("time_utc", "frame", "x", "y", "z", "vx", "vy", "vz")
#: Axes by their names in the files.
_INERTIAL, _FIXED = ("GM2000", "Mean of 2000", "J2000", "EME2000"), ("Earth Fixed", "ITRF")
#: Axes of the rates from those of the quaternions.
_RATES_FROM_BODY = Rotation.from_matrix([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: rad/s by which rates may differ from the slope of the quaternions, one by one: 5e-6 in real files.
_AGREE = 3e-5


@dataclass(frozen=True, eq=False)
class Sentinel1Attitude:
    """Attitudes and rates about the same body axes: x ahead, y right, z along the antenna's look.

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    inertial_from_body : Rotation
        N rotations to the axes of 2000 (EME2000).
    rates : (N, 3)
        rad/s of the body against the stars, about its axes.
    apart : (N - 1, 3)
        rad/s; mean of two rates less the turn from quaternion to quaternion.
    """

    t: Array
    inertial_from_body: Rotation
    rates: Array
    apart: Array

    @property
    def turned(self) -> Array:
        """(N, 3) rad; integral of the rates, which change evenly from one to the next."""
        steps = 0.5 * (self.rates[:-1] + self.rates[1:]) * np.diff(self.t)[:, None]
        return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def noise(self) -> tuple[float, str]:
        """Sigma (rad) of what the rates say of a turn from row to row, and in words how it was found.

        By the Allan deviation of what rates and quaternions leave of each other, worst axis: of a random walk
        that is nowhere below it. Both are of one filter: what they share does not show.
        """
        step = float(np.median(np.diff(self.t)))
        left = np.concatenate([np.zeros((1, 3)), np.cumsum(self.apart * np.diff(self.t)[:, None], axis=0)])
        found = [allan_deviation(axis, step) for axis in left.T]
        walk = max(random_walk(tau, deviation) for tau, deviation in found)
        tau, deviation = found[0][0], np.max([d for _, d in found], axis=0)
        said = ", ".join(f"{d:.2g} at {t:.3g} s" for t, d in zip(tau, deviation, strict=True))
        sigma = walk * step**0.5
        return sigma, (
            "rates of Sentinel-1 as a gyro, about -y, -x, -z of the body of its quaternions, as these say; "
            f"Allan deviation of what both leave of each other, rad/s: {said}; sigma of an "
            f"increment {sigma:.2g} rad"
        )

    @property
    def contradicted(self) -> str:
        """By how much rates and quaternions contradict each other, where they do; else empty."""
        if np.abs(self.apart).max() <= _AGREE:
            return ""
        return (
            f"its rates and its quaternions contradict each other by {np.abs(self.apart).max():.2g} rad/s "
            "(5e-6 in real files): one of both is in other axes, or of other times"
        )

    @property
    def doubt(self) -> str:
        """What is said of that where attitudes are read; else empty."""
        return f"{self.contradicted}; the quaternions are used" if self.contradicted else ""


def is_sentinel1(path: Path) -> bool:
    """Whether a file begins as such a table does; FormatError for what is no regular file."""
    check_file(path)
    with foreign_errors(path, "cannot be read", "check its permissions"), path.open("rb") as stream:
        return stream.read(64).lstrip(b"\xef\xbb\xbf").startswith(b"time_utc,frame,")


@reads("a table of Sentinel-1")
def read_sentinel1_attitude(path: Path, epoch: str) -> Sentinel1Attitude:
    """Attitudes and rates.

    Parameters
    ----------
    path : Path
        CSV ``time_utc,frame,q0,q1,q2,q3,wx,wy,wz``; further columns are not read.
    epoch : str
        UTC of t = 0.

    Raises
    ------
    FormatError
        If it is in axes that are not read, has no quaternions, or a single row.
    """
    t, values = _table(path, epoch, _ATTITUDE, _INERTIAL)
    if len(t) < 2:
        raise FormatError(f"{path}: holds one attitude; two or more are needed, before and after the images")
    body = Rotation.from_quat(check_quaternions(path, values[:, :4]))
    attitude, rates = body * _RATES_FROM_BODY.inv(), values[:, 4:]
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / np.diff(t)[:, None]
    return Sentinel1Attitude(t, attitude, rates, 0.5 * (rates[:-1] + rates[1:]) - turned)


@reads("a table of Sentinel-1")
def read_sentinel1_orbit(path: Path, epoch: str) -> tuple[Array, Array, Array]:
    """Times (N,) s, positions (N, 3) m and velocities (N, 3) m/s, Earth-fixed; arguments as above."""
    t, values = _table(path, epoch, _ORBIT, _FIXED)
    return t, values[:, :3], values[:, 3:]


def _table(path: Path, epoch: str, names: tuple[str, ...], frames: tuple[str, ...]) -> tuple[Array, Array]:
    """Times (s) and numbers of a table whose rows are all in axes that are read."""
    table = read_columns(path, names, text=names[:2])
    given = {str(frame).strip() for frame in table["frame"]}
    if not given <= set(frames):
        other = sorted(given - set(frames))[0]
        raise FormatError(f"{path}: is in axes {other[:40]!r}; read are {', '.join(frames)}")
    instants = enumerate(map(str, table["time_utc"]), 1)
    t = np.array([seconds_from_epoch(text, epoch, f"{path}: row {number}") for number, text in instants])
    check_times(path, t)
    return t, np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names[2:]])
