"""Ellipsoids of revolution: geodetic to Earth-centred coordinates and back, local level axes, rotation.

World axes of spacecraft are Earth-centred, Earth-fixed, WGS 84 (x to latitude 0, longitude 0; z to the
north pole). Longitudes and latitudes are radians, heights metres above the ellipsoid. Other bodies give
their radii.

Not here: heights above the geoid (handled where a DEM is read, ``io/``), polar motion and precession.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sightline.compiled import njit
from sightline.errors import InputError
from sightline.geometry.checks import Array, as_points, as_times, positive, read_only, same_length

#: Semi-axes of WGS 84: equatorial, polar (m).
WGS84: tuple[float, float] = (6378137.0, 6356752.314245179)
#: Rotation of the Earth relative to the stars (rad/s), WGS 84.
EARTH_RATE = 7.292115e-5


def check_radii(radii: tuple[float, float]) -> tuple[float, float]:
    """Equatorial and polar semi-axes as floats. Raises InputError unless they are like those of a planet."""
    a, b = positive(radii[0], "radii[0]", "m"), positive(radii[1], "radii[1]", "m")
    if not 0.5 < b / a < 2.0:
        raise InputError(
            f"`radii` must be (equatorial, polar) semi-axes in m of a body near a sphere, got {radii}"
        )
    return a, b


@njit(cache=True, nogil=True, error_model="numpy")
def normal_of(rho: float, z: float, a: float, b: float) -> tuple[float, float, float]:
    """Cosine and sine of the latitude, and height (m), of a point `rho` from the axis and `z` up it.

    B. R. Bowring (1976): fixed-point iteration in the reduced latitude, for semi-axes a (equator), b (pole);
    three rounds reach rounding error from 10 km below the surface to beyond geostationary height.
    """
    e2 = (a * a - b * b) / (a * a)
    e2b = (a * a - b * b) / (b * b)
    # (sine, cosine) of the reduced latitude, up to a common factor
    sine, cosine = a * z, b * rho
    top, bottom = z, rho
    for _ in range(3):
        norm = np.sqrt(sine * sine + cosine * cosine)
        if norm == 0.0:
            return 1.0, 0.0, -a
        s, c = sine / norm, cosine / norm
        top, bottom = z + e2b * b * s * s * s, rho - e2 * a * c * c * c
        sine, cosine = b * top, a * bottom
    norm = np.sqrt(top * top + bottom * bottom)
    s, c = top / norm, bottom / norm
    # distance along the normal: exact at the poles and at the equator alike (Bowring 1985)
    return c, s, rho * c + z * s - a * np.sqrt(1.0 - e2 * s * s)


@njit(cache=True, nogil=True, error_model="numpy")
def geodetic_of(x: float, y: float, z: float, a: float, b: float) -> tuple[float, float, float]:
    """Longitude, latitude (rad), height (m) of one point, for semi-axes a (equator), b (pole)."""
    c, s, height = normal_of(np.sqrt(x * x + y * y), z, a, b)
    return np.arctan2(y, x), np.arctan2(s, c), height


@njit(cache=True, nogil=True, error_model="numpy")
def _to_geodetic(points: Array, a: float, b: float, out: Array) -> None:
    """`geodetic_of` for each row of `points`, into `out`."""
    for n in range(len(points)):
        out[n, 0], out[n, 1], out[n, 2] = geodetic_of(points[n, 0], points[n, 1], points[n, 2], a, b)


def to_geodetic(points: ArrayLike, radii: tuple[float, float] = WGS84) -> Array:
    """Longitude, latitude (rad) and height (m) of Earth-centred points.

    Parameters
    ----------
    points : (N, 3)
        m; NaN rows stay NaN.
    radii : (equatorial, polar)
        Semi-axes of the ellipsoid, m; WGS 84 unless given.

    Returns
    -------
    (N, 3)
        Longitude in (-pi, pi], latitude, height above the ellipsoid.

    Examples
    --------
    >>> to_geodetic([[6378137.0 + 100.0, 0.0, 0.0]]).tolist()
    [[0.0, 0.0, 100.0]]
    """
    given = as_points(points)
    a, b = check_radii(radii)
    out = np.empty_like(given)
    _to_geodetic(given, a, b, out)
    return out


def from_geodetic(geodetic: ArrayLike, radii: tuple[float, float] = WGS84) -> Array:
    """Inverse of `to_geodetic`: Earth-centred points (N, 3) m of longitude, latitude (rad), height (m)."""
    longitude, latitude, height = as_points(geodetic, "geodetic").T
    a, b = check_radii(radii)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    e2 = (a * a - b * b) / (a * a)
    normal = a / np.sqrt(1.0 - e2 * sine**2)
    rho = (normal + height) * cosine
    return np.stack(
        [rho * np.cos(longitude), rho * np.sin(longitude), (normal * (1.0 - e2) + height) * sine], axis=1
    )


def local_axes(longitude: ArrayLike, latitude: ArrayLike) -> Rotation:
    """Level axes at places on the ellipsoid.

    Parameters
    ----------
    longitude, latitude : scalar or (N,)
        rad.

    Returns
    -------
    Rotation
        world_from_local: local x east, y north, z up; world Earth-centred.
    """
    lon, lat = np.broadcast_arrays(
        np.asarray(longitude, dtype=np.float64), np.asarray(latitude, dtype=np.float64)
    )
    zero = np.zeros_like(lon)
    east = np.stack([-np.sin(lon), np.cos(lon), zero], axis=-1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    return Rotation.from_matrix(np.stack([east, north, up], axis=-1))


def fixed_from_inertial(
    t: ArrayLike, position: ArrayLike, velocity: ArrayLike, *, rate: float = EARTH_RATE, angle: float = 0.0
) -> tuple[Array, Array]:
    """Body-fixed positions and velocities of inertial ones, for a body that turns evenly about z.

    Parameters
    ----------
    t : (N,)
        s from the epoch.
    position, velocity : (N, 3)
        m, m/s, inertial axes whose z is the axis of rotation.
    rate : float
        rad/s.
    angle : float
        rad; rotation of the body-fixed x axis from the inertial one at t = 0 (sidereal angle).

    Returns
    -------
    position, velocity : (N, 3)
        m and m/s, relative to the turning axes.
    """
    times, position, velocity = as_times(t), as_points(position, "position"), as_points(velocity, "velocity")
    same_length(times, "t", position, "position")
    same_length(times, "t", velocity, "velocity")
    turned = Rotation.from_rotvec(-(angle + rate * times)[:, np.newaxis] * np.array([0.0, 0.0, 1.0]))
    relative = velocity - np.cross([0.0, 0.0, rate], position)
    # scipy's `apply` refuses read-only arrays
    return read_only(turned.apply(position.copy())), read_only(turned.apply(relative))
