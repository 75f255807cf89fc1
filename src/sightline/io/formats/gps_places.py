"""Longitudes and latitudes that cannot be: no fix of a receiver, a lost reference W or S.

A value is taken for mirrored only where the others stay clear of the equator or meridian that it is mirrored
about, and where mirroring brings it to its neighbours in time: a flight across Greenwich, the equator or
180 degrees has no such values.

Not here: where longitudes and latitudes come from (``io/sequence/poses.py``, ``odm.py``, ``exif.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Degrees within which longitude and latitude are no place but a receiver without a fix.
_NO_FIX = 1e-6
#: Degrees that a mirrored value is off by at least: less is a jump of a receiver.
_LEAST_OFF = 0.05
#: Times the spread of the others that their middle is away from what values are mirrored about.
_CLEAR = 2.0
#: Quantile of the distances from their middle that is the spread: a wild value or two do not count.
_SPREAD = 0.9
#: Degrees between two tables of one flight beyond which they cannot both be right, and share of that distance
#: that exchanged coordinates leave.
_FAR_APART, _TOGETHER = 0.5, 0.1
#: Share of its distance from its neighbours in time that a mirrored value is left with, once turned back.
_BACK = 0.2


def wrapped_degrees(degrees: Array) -> Array:
    """Differences of longitudes from -180 up to 180 degrees."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def places(t: Array, lonlat: Array, names: Sequence[str], table: str, warnings: list[str]) -> Bools:
    """Rows whose longitude and latitude are a place.

    Parameters
    ----------
    t : (n,)
        s; NaN of rows of no frame.
    lonlat : (n, 2 or more)
        Longitude, latitude (degrees), NaN where not given.
    names : sequence of str
        Of the frames, n.
    table : str
        Where they are from, for the messages.
    warnings : list of str
        What is left out is added to it.

    Returns
    -------
    (n,) bool
    """
    lonlat = lonlat[:, :2]
    none = (np.abs(lonlat) < _NO_FIX).all(axis=1)
    if none.any():
        warnings.append(
            f"{table}: {int(none.sum())} positions are 0, 0 (no GPS fix; the first of frame "
            f"{names[int(np.argmax(none))]}): left out"
        )
    good: Bools = np.asarray(~none & np.isfinite(lonlat).all(axis=1))
    if not good.any():
        return good
    wrong = np.zeros_like(good)
    rows = np.flatnonzero(good)
    for axis in (0, 1):
        wrong[rows] |= mirrored(t[rows], lonlat[rows, axis])
    if wrong.any():
        k = int(np.argmax(wrong))
        middle = [_middle(lonlat[good & ~wrong, axis]) for axis in (0, 1)]
        warnings.append(
            f"{table}: {int(wrong.sum())} positions are in the wrong hemisphere (frame {names[k]} at "
            f"longitude {lonlat[k, 0]:.5g}, latitude {lonlat[k, 1]:.5g}, the others at {middle[0]:.5g}, "
            f"{middle[1]:.5g}): left out; is a reference W or S missing?"
        )
    return good & ~wrong


def exchanged(place: Array, other: Array) -> bool:
    """Whether two places are far apart as they are, and together once longitude and latitude are exchanged.

    Parameters
    ----------
    place, other : (2,)
        Longitude, latitude (degrees).
    """
    if abs(float(wrapped_degrees(place[:1])[0])) > 90.0:
        return False  # no latitude
    as_given, turned = _apart(place, other), _apart(place[::-1], other)
    return as_given > _FAR_APART and turned < _TOGETHER * as_given


def _apart(place: Array, other: Array) -> float:
    """Degrees on a sphere between two places (longitude, latitude; degrees)."""
    (lon, lat), (lon2, lat2) = np.radians(place), np.radians(other)
    half = np.sin(0.5 * (lat2 - lat)) ** 2 + np.cos(lat) * np.cos(lat2) * np.sin(0.5 * (lon2 - lon)) ** 2
    return float(np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))))


def _middle(degrees: Array) -> float:
    """Median of angles that may lie about 180 degrees."""
    turns = np.exp(1j * np.radians(degrees)).sum()
    mean = float(np.degrees(np.angle(turns)))
    return float(wrapped_degrees(np.array(mean + np.median(wrapped_degrees(degrees - mean)))))


def mirrored(t: Array, degrees: Array) -> Bools:
    """Which longitudes, or latitudes, have the sign of the other hemisphere.

    Parameters
    ----------
    t : (n,)
        s; NaN where not known.
    degrees : (n,)
        Finite.

    Returns
    -------
    (n,) bool
    """
    middle = _middle(degrees)
    off = wrapped_degrees(degrees - middle)
    other = (degrees * middle < 0.0) & (np.abs(off) > _LEAST_OFF)
    nothing = np.zeros_like(other)
    if not other.any() or other.all():
        return nothing
    clear = min(abs(middle), 180.0 - abs(middle))
    if clear <= _CLEAR * float(np.quantile(np.abs(off[~other]), _SPREAD)):
        return nothing
    expected = np.full_like(degrees, middle)
    timed, rest = np.isfinite(t), ~other & np.isfinite(t)
    if rest.any():
        order = np.flatnonzero(rest)[np.argsort(t[rest], kind="stable")]
        expected[timed] = middle + np.interp(t[timed], t[order], off[order])
    away, back = np.abs(wrapped_degrees(degrees - expected)), np.abs(wrapped_degrees(-degrees - expected))
    return np.asarray(other & (away > _LEAST_OFF) & (back < _BACK * away))
