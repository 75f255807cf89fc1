"""S2's geometry and its bound worked out by hand: own orbits, S2's axes and angles, dense matrices.

Shares nothing with the package: positions from spherical trigonometry, S2's Q = A_z A_y A_x, derivatives by
complex steps, the information of all poses as one dense matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ARCSEC = np.pi / 648000.0
RADIUS, MU, TURN = 6371000.0, 3.986004418e14, 7.2921159e-5


@dataclass(frozen=True)
class Case:
    """Parameters of one set-up; that of S2's table 6 unless given otherwise."""

    altitude: float = 500e3
    inclination: float = 97.4  # degrees
    latitude: float = 55.0  # degrees
    separation: float = 70.0  # s
    window: float = 64.0  # s
    shots: int = 64
    offset: float = 0.0  # s
    cross_track: float = 0.0  # m
    fov: float = 1.5  # degrees
    columns: int = 700
    points: int = 300
    scene: float = 11e3  # m, side
    relief: float = 400.0  # m, highest less lowest
    sigma_px: float = 0.1
    sigma_position: float = 7.5  # m
    sigma_attitude: float = 1.8 * ARCSEC
    seed: int = 0

    @property
    def pixel(self):
        """Tangent of one pixel."""
        return 2.0 * np.tan(np.radians(self.fov) / 2.0) / self.columns


def track(case, t, passage):
    """Geocentric positions (K, 3), Earth-fixed, of a spacecraft that passes the node at `passage` (s)."""
    r = RADIUS + case.altitude
    i = np.radians(case.inclination)
    theta = np.sqrt(MU / r**3) * (np.asarray(t) - passage)
    phi = np.arcsin(np.sin(i) * np.sin(theta))
    lam = np.arctan2(np.cos(i) * np.sin(theta), np.cos(theta)) - TURN * np.asarray(t)
    return r * np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=1)


def positions(case):
    """Times (K,) and positions (2, K, 3) m in topocentric axes of the aim point: south, east, zenith."""
    r = RADIUS + case.altitude
    theta = np.arcsin(np.sin(np.radians(case.latitude)) / np.sin(np.radians(case.inclination)))
    centre = theta / np.sqrt(MU / r**3)
    k = np.arange(case.shots)
    t = centre + case.offset + (k - (case.shots - 1) / 2.0) * case.window / case.shots
    before, here, after = track(case, [centre - 0.5, centre, centre + 0.5], 0.0)
    p = here / r
    v = after - before
    side = np.cross(p, v / np.linalg.norm(v))
    side /= np.linalg.norm(side)
    angle = case.cross_track / RADIUS
    x0, y0, z0 = np.cos(angle) * p + np.sin(angle) * side
    phi, lam = np.arcsin(z0), np.arctan2(y0, x0)
    axes = np.array(
        [
            [np.sin(phi) * np.cos(lam), np.sin(phi) * np.sin(lam), -np.cos(phi)],
            [-np.sin(lam), np.cos(lam), 0.0],
            [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)],
        ]
    )
    aim = RADIUS * np.array([x0, y0, z0])
    passage = (-case.separation / 2.0, case.separation / 2.0)
    return t, np.stack([(track(case, t, tau) - aim) @ axes.T for tau in passage])


def scene(case):
    """Points (N, 3) m in topocentric axes, heights from eight waves of 4 to 12 km."""
    rng = np.random.default_rng(case.seed)
    ground = rng.uniform(-case.scene / 2.0, case.scene / 2.0, (case.points, 2))
    length, course = rng.uniform(4e3, 12e3, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
    phase = rng.uniform(0.0, 2.0 * np.pi, 8)
    along = ground @ np.stack([np.cos(course), np.sin(course)])
    height = np.sin(2.0 * np.pi * along / length + phase).sum(axis=1)
    low, high = height.min(), height.max()
    return np.column_stack([ground, case.relief * ((height - low) / max(high - low, 1e-12) - 0.5)])


def axes_of(d):
    """S2's R (2, K, 3, 3), rows x, y, z in topocentric axes, of cameras at `d` (2, K, 3)."""
    n = d / np.linalg.norm(d, axis=-1, keepdims=True)
    y = np.cross(n[0], n[1])
    y = np.broadcast_to(y / np.linalg.norm(y, axis=-1, keepdims=True), n.shape)
    return np.stack([np.cross(y, -n), y, -n], axis=-2)


def turn(w):
    """S2's Q = A_z A_y A_x (..., 3, 3) of angles (..., 3); complex angles allowed."""
    zero, one = np.zeros_like(w[..., 0]), np.ones_like(w[..., 0])
    c, s = np.cos(w), np.sin(w)

    def matrix(*rows):
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    x = matrix((one, zero, zero), (zero, c[..., 0], -s[..., 0]), (zero, s[..., 0], c[..., 0]))
    y = matrix((c[..., 1], zero, s[..., 1]), (zero, one, zero), (-s[..., 1], zero, c[..., 1]))
    z = matrix((c[..., 2], -s[..., 2], zero), (s[..., 2], c[..., 2], zero), (zero, zero, one))
    return z @ y @ x


def project(w, d, axes, points):
    """Tangents (2, K, N, 2) of `points` (..., N, 3) seen from `d` with angles `w` (2, K, 3)."""
    q = np.einsum("jkab,jknb->jkna", turn(w) @ axes, points - d[:, :, None])
    return q[..., :2] / q[..., 2:]


def sensitivities(case, truth):
    """Changes of whitened pixels with angles and places (2, K, N, 2, 6), and with points (2, K, N, 2, 3)."""
    _, d = positions(case)
    axes, points = axes_of(d), scene(case)
    w = np.broadcast_to(np.asarray(truth)[:, None], d.shape).astype(complex)
    step = 1e-20j
    by = []
    for name, scale in (("w", 1.0), ("d", 1e6), ("m", 1e6)):
        for axis in range(3):
            e = step * np.eye(3)[axis]
            out = project(
                w + (e if name == "w" else 0), d + (e * scale if name == "d" else 0), axes,
                points + (e * scale if name == "m" else 0),
            )  # fmt: skip
            by.append(out.imag / 1e-20 / scale)
    by = np.stack(by, axis=-1) / (case.pixel * case.sigma_px)
    return by[..., :6], by[..., 6:]


def bound(case, truth, **given):
    """Covariance (6, 6) rad^2 of S2's angles; none is lower."""
    return np.linalg.inv(information(case, truth, **given))


def information(case, truth, *, pairs=False, dem=None, control=0, control_sigma=1.0):
    """Fisher's information (6, 6) rad^-2 on S2's angles. `dem` m: heights known to that, each alone.

    `control` points are known to `control_sigma` m. With `pairs` each shot sees points of its own.
    """
    h, g = sensitivities(case, truth)
    shots, count = case.shots, case.points
    extra = np.zeros((count, 3, 3))
    if dem is not None:
        extra[:, 2, 2] += 1.0 / dem**2
    extra[:control] += np.eye(3) / control_sigma**2
    size = 6 * shots
    s = np.zeros((2, shots, 6, 2, shots, 6))
    own = np.einsum("jknia,jknib->jkab", h, h)
    for j in range(2):
        for k in range(shots):
            s[j, k, :, j, k] += own[j, k]
    cross = np.einsum("jknia,jknib->njkab", h, g)
    per = np.einsum("jknia,jknib->jknab", g, g).sum(axis=0)
    if pairs:
        for k in range(shots):
            v = np.linalg.inv(per[k] + extra)
            s[:, k, :, :, k] -= np.einsum("njab,nbc,nidc->jaid", cross[:, :, k], v, cross[:, :, k])
    else:
        v = np.linalg.cholesky(np.linalg.inv(per.sum(axis=0) + extra))
        flat = np.einsum("njkab,nbc->jkanc", cross, v).reshape(2 * size, -1)
        s -= (flat @ flat.T).reshape(s.shape)
    prior = np.concatenate([np.full(3, case.sigma_attitude), np.full(3, case.sigma_position)])
    scale = np.broadcast_to(prior, (2, shots, 6)).ravel()
    whitened = scale[:, None] * s.reshape(2 * size, 2 * size) * scale
    a = np.zeros((2, shots, 6, 6))
    for j in range(2):
        for axis in range(3):
            a[j, :, axis, 3 * j + axis] = 1.0 / case.sigma_attitude
    a = a.reshape(2 * size, 6)
    return a.T @ (a - np.linalg.solve(np.eye(2 * size) + whitened, a))


#: The angles of prototype section 6, S2's w.
TRUTH = 36.0 * ARCSEC * np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
