"""How the Earth is turned: axes of orbits and attitudes against the Earth-fixed ones (ITRF), by pyerfa.

IAU 2006/2000A precession and nutation, polar motion, UT1 and offsets of the celestial pole from a table of
the IERS; after the IERS Conventions (2010), chapter 5. Tides within a day (2 cm) are left out.

Not here: reading that table (``io/formats/earth_orientation.py``), even rotation (``earth.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sightline.errors import InputError
from sightline.geometry.checks import Array, as_times
from sightline.geometry.earth import EARTH_RATE

#: Axes that are known, with the names by which files call them (in capitals, without marks between words).
AXES: dict[str, tuple[str, ...]] = {
    "ITRF": ("ITRF", "ITRS", "EARTHFIXED", "FIXEDEARTH", "ECEF", "WGS84"),
    "TIRS": ("TIRS", "TDR", "EFG", "GTOD", "GRC", "PEF"),
    "CIRS": ("CIRS",),
    "GCRF": ("GCRF", "GCRS", "ICRF", "ICRS"),
    "EME2000": ("EME2000", "J2000", "FK5"),
    "MOD": ("MOD", "MODEARTH"),
    "TOD": ("TOD", "TODEARTH"),
    "TEME": ("TEME", "TEMEOFDATE"),
}
#: TT less TAI, s; s of a day; Julian date of modified Julian day 0.
_TT_LESS_TAI, _DAY, _MJD_0, _LEAPS_SINCE = 32.184, 86400.0, 2400000.5, 41317.0
#: s between which precession and nutation are taken as straight: wrong by 1e-12 rad.
_STEP = 600.0
#: s before and after an instant between which the axes' turn is taken as even: wrong by 1e-14 of it.
_HALF_SECOND = 0.5
#: Days after the last of a table, and rms error of UT1 (s) continued with its last year's slope, and of the
#: pole (rad per axis) kept: measured on the IERS C04 series from 1973 to 2026.
_DAYS_AFTER = (10.0, 30.0, 100.0, 365.0, 1000.0, 3000.0)
_UT1_AFTER = (0.0045, 0.0123, 0.034, 0.084, 0.33, 1.7)
_POLE_AFTER = tuple(np.radians(np.array([0.018, 0.054, 0.16, 0.16, 0.19, 0.19]) / 3600.0).tolist())
#: Before a table UT1 is UTC, which leap seconds keep within 0.9 s of it, and the pole lies in its usual
#: circle.
_UT1_BEFORE, _POLE_BEFORE = 0.5, float(np.radians(0.2 / 3600.0))
_YEAR = 365.0


def tai_less_utc(mjd: ArrayLike, what: str) -> Array:
    """TAI - UTC (s) on modified Julian days, by pyerfa; before 1972 it is 10 s, as everywhere.

    `what` needs it, for the message where pyerfa is missing.
    """
    erfa = orbit_package("erfa", what)
    return np.asarray(erfa.dat(*erfa.jd2cal(_MJD_0, np.maximum(mjd, _LEAPS_SINCE))))


def orbit_package(module: str, why: str) -> Any:
    """A module of the packages of the extra ``orbit``; InputError that names it where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{why} needs the extra `orbit`, of which {module.split('.')[0]} is not installed; run `pip "
            "install "
            "pyerfa astropy-iers-data sgp4 ccsds-ndm`"
        ) from None


@dataclass(frozen=True, eq=False)
class EarthOrientation:
    """A table of Earth orientation.

    Attributes
    ----------
    mjd : (N,)
        Modified Julian days (UTC), rising; two or more.
    pole : (N, 2)
        rad; polar motion x, y.
    ut1_less_tai : (N,)
        s.
    cip : (N, 2)
        rad; offsets dX, dY of the celestial pole from IAU 2006/2000A.
    sigma_pole, sigma_ut1 : (N,)
        rad, s.
    source : str
        For messages.
    """

    mjd: Array
    pole: Array
    ut1_less_tai: Array
    cip: Array
    sigma_pole: Array
    sigma_ut1: Array
    source: str

    def covers(self, mjd: float) -> bool:
        """Whether the table reaches over a day."""
        return bool(self.mjd[0] <= mjd <= self.mjd[-1])

    def ut1_less_tai_at(self, mjd: ArrayLike) -> Array:
        """UT1 - TAI (s): linear; after the table it goes on as in its last year, before it UT1 is UTC."""
        day = np.asarray(mjd, dtype=np.float64)
        inside = np.interp(day, self.mjd, self.ut1_less_tai)
        first = max(int(np.searchsorted(self.mjd, self.mjd[-1] - _YEAR)) - 1, 0)
        slope = (self.ut1_less_tai[-1] - self.ut1_less_tai[first]) / (self.mjd[-1] - self.mjd[first])
        after = inside + slope * np.maximum(day - self.mjd[-1], 0.0)
        before = day < self.mjd[0]
        if not before.any():
            return np.asarray(after)
        return np.where(before, -tai_less_utc(day, "Earth orientation of a day before its table"), after)

    def pole_at(self, mjd: Array) -> tuple[Array, Array]:
        """Polar motion x, y (rad): linear, kept beyond the table."""
        return np.interp(mjd, self.mjd, self.pole[:, 0]), np.interp(mjd, self.mjd, self.pole[:, 1])

    def cip_at(self, mjd: Array) -> tuple[Array, Array]:
        """Offsets dX, dY (rad) of the celestial pole: linear, kept beyond the table."""
        return np.interp(mjd, self.mjd, self.cip[:, 0]), np.interp(mjd, self.mjd, self.cip[:, 1])

    def sigma_at(self, mjd: float) -> tuple[float, float]:
        """What is not known on a day: UT1 (s), the pole (rad about each of x and y)."""
        if mjd < self.mjd[0]:
            return _UT1_BEFORE, _POLE_BEFORE
        ut1 = float(np.interp(mjd, self.mjd, self.sigma_ut1))
        pole = float(np.interp(mjd, self.mjd, self.sigma_pole))
        days = mjd - self.mjd[-1]
        if days <= 0.0:
            return ut1, pole
        shares = np.log([days, *_DAYS_AFTER])
        later = [
            float(np.exp(np.interp(shares[0], shares[1:], np.log(errors))) * min(days / _DAYS_AFTER[0], 1.0))
            for errors in (_UT1_AFTER, _POLE_AFTER)
        ]
        return float(np.hypot(ut1, later[0])), float(np.hypot(pole, later[1]))

    def angle_sigma_at(self, mjd: float) -> float:
        """rad; the largest of the sigmas about an axis with which Earth-fixed axes are turned on a day."""
        ut1, pole = self.sigma_at(mjd)
        return max(EARTH_RATE * ut1, pole)


def axes_of(name: str) -> str | None:
    """The key of `AXES` by which a file's axes are known; None for others.

    Realisations count as what they realise: ITRF97 and ITRF-2014 as ITRF, ICRF3 as GCRF, WGS84 as ITRF.
    """
    plain = "".join(letter for letter in name.upper() if letter.isalnum())
    for key, names in AXES.items():
        if plain in names or plain.rstrip("0123456789") in {n for n in names if not n[-1].isdigit()}:
            return key
    return None


@dataclass(frozen=True)
class FixedAxes:
    """Earth-fixed axes against others, at given instants.

    Attributes
    ----------
    turn : (N, 3, 3)
        Earth-fixed components of a vector from its components along the other axes.
    change : (N, 3, 3)
        Its change, per s.
    """

    turn: Array
    change: Array

    def positions(self, position: Array) -> Array:
        """Positions (N, 3), Earth-fixed."""
        return np.asarray(np.einsum("nij,nj->ni", self.turn, position))

    def velocities(self, position: Array, velocity: Array) -> Array:
        """Velocities (N, 3) relative to the turning Earth, of positions and velocities in the other axes."""
        still = np.einsum("nij,nj->ni", self.turn, velocity)
        return np.asarray(still + np.einsum("nij,nj->ni", self.change, position))


def fixed_axes(axes: str, t: ArrayLike, tai: tuple[int, float], orientation: EarthOrientation) -> FixedAxes:
    """Earth-fixed axes (ITRF) against others.

    Parameters
    ----------
    axes : str
        A key of `AXES`.
    t : (N,)
        s from the epoch.
    tai : (day, second)
        The epoch: modified Julian day and s of it, TAI.
    orientation : EarthOrientation

    Returns
    -------
    FixedAxes

    Notes
    -----
    Precession, nutation and the equation of the origins are evaluated every 600 s and taken as straight
    between (1e-12 rad); the Earth's turn and the pole at every instant.
    """
    times = as_times(t)
    before, turn, after = (
        _turn(axes, times + shift, tai, orientation) for shift in (-_HALF_SECOND, 0.0, _HALF_SECOND)
    )
    return FixedAxes(turn, (after - before) / (2.0 * _HALF_SECOND))


def _turn(axes: str, t: Array, tai: tuple[int, float], orientation: EarthOrientation) -> Array:
    """(N, 3, 3) to Earth-fixed components from those along other axes."""
    if axes == "ITRF":
        return np.tile(np.eye(3), (len(t), 1, 1))
    erfa = orbit_package("erfa", f"bringing {axes} to Earth-fixed axes")
    start = _MJD_0 + tai[0]
    tt, mjd = (tai[1] + _TT_LESS_TAI + t) / _DAY, tai[0] + (tai[1] + t) / _DAY
    ut1 = (tai[1] + t + orientation.ut1_less_tai_at(mjd)) / _DAY
    pole = erfa.pom00(*orientation.pole_at(mjd), erfa.sp00(start, tt))
    if axes == "TIRS":
        return np.asarray(pole)
    if axes == "TEME":
        return np.asarray(pole @ _about_z(erfa.gmst82(start, ut1)))
    angle = erfa.era00(start, ut1)
    if axes == "TOD":
        return np.asarray(pole @ _about_z(angle - _coarse(lambda day: erfa.eo06a(start, day), tt)))
    turned = pole @ _about_z(angle)
    if axes == "CIRS":
        return np.asarray(turned)
    x, y, s = (_coarse(lambda day, k=k: erfa.xys06a(start, day)[k], tt) for k in range(3))
    dx, dy = orientation.cip_at(mjd)
    turned = turned @ erfa.c2ixys(x + dx, y + dy, s)
    if axes == "EME2000":
        turned = turned @ erfa.bp06(_MJD_0, 51544.5)[0].T
    if axes == "MOD":
        turned = turned @ np.swapaxes(erfa.pmat06(start, tt), -1, -2)
    return np.asarray(turned)


def _coarse(function: Any, day: Array) -> Array:
    """A function of days that is nearly straight over 600 s, between such steps."""
    first, last = float(day.min()), float(day.max())
    nodes = np.linspace(first, last, int(np.ceil((last - first) * _DAY / _STEP)) + 1)
    return np.interp(day, nodes, np.atleast_1d(function(nodes)))


def _about_z(angle: Array) -> Array:
    """(N, 3, 3) to components along axes turned by angles (N,) about z."""
    sine, cosine, out = np.sin(angle), np.cos(angle), np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = cosine
    out[:, 0, 1], out[:, 1, 0], out[:, 2, 2] = sine, -sine, 1.0
    return out
