"""S2's model of synchronous imaging in numpy alone: orbit, axes, projection as its equations have them.

Axes are topocentric at the aim point: x south, y east, z zenith. Camera axes are S2's own: z to the scene
and, where the camera numbered 1 leads, x about forward and y to the right; its angles w turn nominal axes
into actual ones.
Nothing here is taken from the package: it is what the package is compared with.
"""

from __future__ import annotations

import numpy as np

RADIUS = 6371000.0
GM = 3.986004418e14
EARTH_RATE = 7.2921159e-5
ARCSEC = np.pi / 180.0 / 3600.0
SUN_SYNCHRONOUS, LATITUDE = np.radians(97.4), np.radians(55.0)


def shot_times(inclination, latitude, altitude, window, shots, offset=0.0):
    period = 2.0 * np.pi * np.sqrt((RADIUS + altitude) ** 3 / GM)
    middle = np.arcsin(np.sin(latitude) / np.sin(inclination)) * period / (2.0 * np.pi)
    return middle + offset + (np.arange(shots) - (shots - 1) / 2.0) * window / shots, middle, period


def track(t, tau, inclination, period):
    """Unit geocentric vectors (K, 3) of a spacecraft that passed its node at longitude 0, time `tau`."""
    theta = 2.0 * np.pi * (t - tau) / period
    phi = np.arcsin(np.sin(inclination) * np.sin(theta))
    longitude = np.arctan2(np.cos(inclination) * np.sin(theta), np.cos(theta)) - EARTH_RATE * t
    return np.stack([np.cos(phi) * np.cos(longitude), np.cos(phi) * np.sin(longitude), np.sin(phi)], axis=-1)


def level_rows(up):
    """Rows south, east, zenith at the place whose unit geocentric vector is `up`."""
    phi, lam = np.arcsin(up[2]), np.arctan2(up[1], up[0])
    return np.array(
        [
            [np.sin(phi) * np.cos(lam), np.sin(phi) * np.sin(lam), -np.cos(phi)],
            [-np.sin(lam), np.cos(lam), 0.0],
            [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)],
        ]
    )


def camera_places(
    separation=70.0,
    window=64.0,
    shots=64,
    offset=0.0,
    cross_track=0.0,
    inclination=SUN_SYNCHRONOUS,
    latitude=LATITUDE,
    altitude=500e3,
):
    """Camera centres (2, K, 3) m about the aim point, camera 1 leading; the local rows and the aim point."""
    t, middle, period = shot_times(inclination, latitude, altitude, window, shots, offset)
    here, later = (track(np.array([middle + s]), 0.0, inclination, period)[0] for s in (0.0, 1e-3))
    # velocity in axes that do not turn with the Earth
    later = np.array(
        [
            later[0] * np.cos(EARTH_RATE * 1e-3) - later[1] * np.sin(EARTH_RATE * 1e-3),
            later[0] * np.sin(EARTH_RATE * 1e-3) + later[1] * np.cos(EARTH_RATE * 1e-3),
            later[2],
        ]
    )
    aside = np.cross(here, later - here)
    aside /= np.linalg.norm(aside)
    aim = np.cos(cross_track / RADIUS) * here + np.sin(cross_track / RADIUS) * aside
    rows = level_rows(aim)
    places = [
        (track(t, tau, inclination, period) * (RADIUS + altitude) - RADIUS * aim) @ rows.T
        for tau in (-separation / 2.0, separation / 2.0)
    ]
    return np.stack(places), rows, RADIUS * aim


def camera_axes(first, second):
    """S2's R_1k, R_2k (K, 3, 3): v_camera = R v_local, with e_z = -n (S2's errata)."""
    n1 = first / np.linalg.norm(first, axis=-1, keepdims=True)
    n2 = second / np.linalg.norm(second, axis=-1, keepdims=True)
    y = np.cross(n1, n2)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return tuple(np.stack([np.cross(y, -n), y, -n], axis=-2) for n in (n1, n2))


def error_matrix(w):
    """Q = A_z A_y A_x of angles (..., 3) roll, pitch, yaw, with A ~ I + [w]x for small ones."""
    w = np.asarray(w)
    cx, cy, cz = np.moveaxis(np.cos(w), -1, 0)
    sx, sy, sz = np.moveaxis(np.sin(w), -1, 0)
    zero, one = np.zeros_like(cx), np.ones_like(cx)

    def matrix(*rows):
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    about_x = matrix((one, zero, zero), (zero, cx, -sx), (zero, sx, cx))
    about_y = matrix((cy, zero, sy), (zero, one, zero), (-sy, zero, cy))
    about_z = matrix((cz, -sz, zero), (sz, cz, zero), (zero, zero, one))
    return about_z @ about_y @ about_x


def project(w, axes, place, points):
    """S2's equation (3): tangents (x, y) of `points` (..., 3) seen from `place` with errors `w`."""
    q = np.einsum("...ij,...j->...i", error_matrix(w) @ axes, points - place)
    return q[..., :2] / q[..., 2:]


def pixels(tangents, focal_px, principal):
    """(line, column) of S2's tangents: lines run forward, columns to the left (y is to the right)."""
    x, y = tangents[..., 0], tangents[..., 1]
    return np.stack([principal[0] + focal_px * x, principal[1] - focal_px * y], axis=-1)
