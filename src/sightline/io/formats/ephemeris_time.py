"""Ephemeris time (ET: s of TDB past J2000) of instants in UTC, and how the Earth stands then.

Not here: times and axes of messages (``ccsds.py``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.earth_orientation import orbit_package, tai_less_utc
from sightline.io.formats.instants import parse_utc, tai_offset

Array = NDArray[np.float64]

#: TT - TAI, s.
_TT_TAI = 32.184
#: Julian date of J2000, s in a day, and J2000 as modified Julian day.
_J2000, _DAY = 2451545.0, 86400.0
_MJD_OF_J2000 = 51544.5


def et_of_utc(epoch: str) -> float:
    """s of TDB past J2000 of an instant in UTC.

    TDB - TT is its term of a year (1.7 ms), as SPICE takes it; the rest stays below 50 us.
    """
    whole, fraction = parse_utc(epoch, "epoch")
    begin = whole.replace(year=2000, month=1, day=1, hour=12, minute=0, second=0)
    tt = (whole - begin).total_seconds() + fraction + tai_offset(whole) + _TT_TAI
    mean = 6.239996 + 1.99096871e-7 * tt
    return tt + 1.657e-3 * math.sin(mean + 1.671e-2 * math.sin(mean))


def earth_from_j2000(et: Array) -> Rotation:
    """Earth-fixed axes from J2000 (GCRS) at instants (N,), s of TDB past J2000.

    IAU 2006/2000A with UT1 = UTC and without polar motion: 0.9 s of UT1 are 420 m on the ground, and cancel
    where positions and attitudes are turned to J2000 and back by the same rotation.
    """
    tt = np.asarray(et, dtype=np.float64) / _DAY
    leaps = tai_less_utc(tt + _MJD_OF_J2000, "an ISD in J2000")
    day = tt - (_TT_TAI + leaps) / _DAY
    matrices = orbit_package("erfa", "an ISD in J2000").c2t06a(_J2000, tt, _J2000, day, 0.0, 0.0)
    return Rotation.from_matrix(np.asarray(matrices))
