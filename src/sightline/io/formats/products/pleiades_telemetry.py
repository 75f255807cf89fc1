"""Telemetry in PHRDIMAP files: counters of four gyros, and quaternions of the filter that used them.

Labels are TAI. Counters are signed 32-bit numbers that wrap; nothing in the file gives their scale or axes
(``motion/gyros.py`` fits them). Quaternions are the output of a filter over the same gyros: a reference, and
no sensor beside them. What star trackers measured is not in the file.

Not here: the camera (``pleiades.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, reads
from sightline.geometry.interpolation import interpolate
from sightline.io.formats.products.makers import record_times, rotations, some, words
from sightline.io.formats.products.pleiades import START, WHAT, pleiades_attitude
from sightline.io.formats.products.tree import Part, read_xml

Array = NDArray[np.float64]

_ATTITUDES = "Data_Strip/Satellite_Attitudes"
_HEADS = ("FOG1", "FOG2", "FOG3", "FOG4")
#: Where a counter of 32 bits begins again.
_WRAP = 2**32
#: s within which labels are one; they are multiples of 31.25 ms.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class PleiadesTelemetry:
    """What a file holds of gyros and attitudes; times in s from the first line of the product.

    Attributes
    ----------
    t : (N,)
        Of the gyros.
    counts : (N, 4)
        Unwrapped, from 0 on.
    t_attitude : (M,)
    stars_from_body, onboard : Rotation
        M attitudes, of the filter on ground and of that on board.
    t_earth : (K,)
    earth_from_body : Rotation
        K attitudes, Earth-fixed, along which the camera sees the ground. Those beyond `t_attitude` are
        continued by the maker, and .3 urad off.
    modelled : callable
        earth_from_body of times (s) by the model of the product: polynomials through these.
    """

    t: Array
    counts: Array
    t_attitude: Array
    stars_from_body: Rotation
    onboard: Rotation
    t_earth: Array
    earth_from_body: Rotation
    modelled: Callable[[Array], Rotation]


@reads(WHAT)
def read_pleiades_telemetry(
    path: Path, *, angle: str = "ANGLE_RAW", clock: str = "labels"
) -> PleiadesTelemetry | None:
    """Gyros and attitudes of a PHRDIMAP file; None where it holds none.

    Parameters
    ----------
    path : Path
    angle : {"ANGLE_RAW", "ANGLE_FILT"}
        Which angles: filtered ones are 10 to 20 ms late.
    clock : {"labels", "counters"}
        Times of the readings: their labels, which the maker used, or FOG_DATE_COUNTER of each gyro.
    """
    data = read_xml(path, WHAT)
    if not data.has(f"{_ATTITUDES}/Raw_Attitudes/FOG1_Auxiliary_Data_List"):
        return None
    start = data.text(START)
    ahead = data.number("Data_Strip/Sensor_Configuration/Time_Stamp/TAI_UTC")
    t, counts = _gyros(data, start, ahead, angle, clock)
    t_attitude, stars_from_body = _attitudes(
        data, "Accurate_Attitudes/Quaternion_List/Quaternion", "TAI_TIME", start
    )
    at_onboard, onboard = _attitudes(data, "Raw_Attitudes/Quaternion_List/Quaternion", "TAI_TIME", start)
    ground, board = _shared([t_attitude, at_onboard])
    if len(ground) < 2:
        raise FormatError(f"{path}: attitudes on board and on ground share {len(ground)} labels")
    t_earth, earth_from_body = _attitudes(
        data, "Corrected_Attitudes/WGS84_Attitudes_List/WGS84_Attitudes", "UTC_TIME", start
    )
    return PleiadesTelemetry(
        t,
        counts,
        t_attitude[ground] - ahead,
        stars_from_body[ground],
        onboard[board],
        t_earth,
        earth_from_body,
        pleiades_attitude(data, start),
    )


def _attitudes(data: Part, name: str, label: str, start: str) -> tuple[Array, Rotation]:
    """Labels (s) and rotations of a list of quaternions."""
    rows = some(data, f"{_ATTITUDES}/{name}", 2)
    values = np.array([row.numbers("Q_VALUES", 4) for row in rows])
    return record_times(rows, label, start), rotations(data, f"{_ATTITUDES}/{name}", values)


def _gyros(data: Part, start: str, ahead: float, angle: str, clock: str) -> tuple[Array, Array]:
    """Times (N,) and counts (N, 4) of all heads at the labels that they share."""
    times, counts = [], []
    for head in _HEADS:
        rows = some(data, f"{_ATTITUDES}/Raw_Attitudes/{head}_Auxiliary_Data_List/FOG_Inertial_Data", 4)
        lost = next((row for row in rows if words(row, "STATUS", "NOMINAL") != "NOMINAL"), None)
        if lost is not None:
            raise lost.refused("STATUS", "is not NOMINAL: a record of gyros without holes is read")
        t = record_times(rows, "TAI_TIME", start) - ahead
        read = _unwrapped(rows, angle)
        times.append(t)
        counts.append(
            read if clock == "labels" else _at_labels(t, _unwrapped(rows, "FOG_DATE_COUNTER"), read)
        )
    shared = _shared(times)
    t = times[0][shared[0]]
    if len(t) < 4 or np.ptp(np.diff(t)) > 0.1 * float(np.diff(t).min()):
        raise FormatError(
            f"{data.path}: gyros share {len(t)} labels, at uneven steps; a record of all heads without holes "
            "is read"
        )
    return t, np.column_stack([read[rows] for read, rows in zip(counts, shared, strict=True)])


def _shared(times: Sequence[Array]) -> list[NDArray[np.intp]]:
    """Rows of each list whose labels (s) all lists hold."""
    keys = [np.rint(t / _SAME).astype(np.int64) for t in times]
    common = reduce(np.intersect1d, keys)
    return [np.searchsorted(key, common) for key in keys]


def _unwrapped(rows: list[Part], name: str) -> Array:
    """A counter of 32 bits that goes on where it begins again, from 0."""
    values = np.array([row.count(name, -(_WRAP // 2), _WRAP) for row in rows], dtype=np.int64)
    steps = (np.diff(values) + _WRAP // 2) % _WRAP - _WRAP // 2
    return np.concatenate([[0.0], np.cumsum(steps)])


def _at_labels(t: Array, ticks: Array, read: Array) -> Array:
    """Readings at their labels, by a counter that says when they were taken; its own rate by all of them."""
    begin, rate = np.polynomial.polynomial.polyfit(t, ticks, 1)
    if not rate > 0.0:
        raise FormatError("FOG_DATE_COUNTER does not go on with the labels; read the gyros by their labels")
    return interpolate((ticks - begin) / rate, read[:, None], t)[:, 0]
