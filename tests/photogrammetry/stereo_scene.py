"""S2's imaging in closed form, from its text and numpy alone: the truth of the tests of orientation.

World axes are S2's local ones at the aim point: x south, y east, z zenith. Angles `w` are S2's: camera 1 and
camera 2, about x, y, z of S2's camera axes. It imports nothing of what it tests but the types that carry it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, sight_frames

RADIUS, MU, SPIN = 6_371_000.0, 3.986004418e14, 7.2921159e-5
ARCSEC = np.pi / 648_000.0
#: True S2 angles of the prototype's fixed cases, rad: (roll, pitch, yaw) of camera 1, then of camera 2.
TRUTH = 36.0 * ARCSEC * np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])


@dataclass(frozen=True)
class Plan:
    """Where and how the two cameras look. Case A of the prototype by default."""

    separation: float = 70.0  # s between the spacecraft
    window: float = 64.0  # s
    shots: int = 64
    offset: float = 0.0  # s of the middle of the window from the passage over the aim point
    cross: float = 0.0  # m of the aim point beside the track
    latitude: float = 55.0  # deg
    inclination: float = 97.4  # deg
    altitude: float = 500_000.0  # m
    field: float = 1.5  # deg
    width: int = 700  # px

    @property
    def pixel(self) -> float:
        """Tangent of one pixel."""
        return 2.0 * np.tan(np.radians(self.field) / 2.0) / self.width


@dataclass(frozen=True)
class Noise:
    """1-sigmas: px, m, rad; `aimed`: the attitudes in hand are rebuilt from the noisy positions."""

    image: float = 0.1
    position: float = 7.5
    attitude: float = 1.8 * ARCSEC
    aimed: bool = False


QUIET = Noise(0.0, 0.0, 0.0)


def orbit(plan: Plan) -> np.ndarray:
    """Positions (2, K, 3) in the local axes; the first camera leads."""
    radius = RADIUS + plan.altitude
    rate = np.sqrt(MU / radius**3)
    inclination = np.radians(plan.inclination)

    def place(t: np.ndarray, node: float) -> np.ndarray:
        a = rate * (t - node)
        latitude = np.arcsin(np.sin(inclination) * np.sin(a))
        longitude = np.arctan2(np.cos(inclination) * np.sin(a), np.cos(a)) - SPIN * t
        return np.stack(
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], -1
        )

    middle = np.arcsin(np.sin(np.radians(plan.latitude)) / np.sin(inclination)) / rate
    t = middle + plan.offset + (np.arange(plan.shots) - (plan.shots - 1) / 2) * plan.window / plan.shots
    under = place(np.array([middle]), 0.0)[0]
    ahead = place(np.array([middle + 1e-3]), 0.0)[0]
    across = np.cross(under, ahead - under)
    angle = plan.cross / RADIUS
    aim = np.cos(angle) * under + np.sin(angle) * across / np.linalg.norm(across)
    phi, lam = np.arcsin(aim[2]), np.arctan2(aim[1], aim[0])
    local = np.array(
        [
            [np.sin(phi) * np.cos(lam), np.sin(phi) * np.sin(lam), -np.cos(phi)],
            [-np.sin(lam), np.cos(lam), 0.0],
            [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)],
        ]
    )
    nodes = (-plan.separation / 2.0, plan.separation / 2.0)
    return np.stack([(radius * place(t, node) - RADIUS * aim) @ local.T for node in nodes])


def axes(d: np.ndarray) -> np.ndarray:
    """R (2, K, 3, 3) of S2 with its misprints mended: rows x, y, z of the camera axes that look at 0."""
    n = d / np.linalg.norm(d, axis=-1, keepdims=True)
    y = np.cross(n[0], n[1])
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.stack([np.cross(y, -n[j]), y, -n[j]], axis=-2) for j in range(2)])


def s2_rotation(w: np.ndarray) -> np.ndarray:
    """Q = A_z A_y A_x (..., 3, 3) of angles (..., 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.moveaxis(np.cos(w), -1, 0), np.moveaxis(np.sin(w), -1, 0)
    one, nil = np.ones_like(cx), np.zeros_like(cx)

    def matrix(*rows: tuple[np.ndarray, ...]) -> np.ndarray:
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    about_x = matrix((one, nil, nil), (nil, cx, -sx), (nil, sx, cx))
    about_y = matrix((cy, nil, sy), (nil, one, nil), (-sy, nil, cy))
    about_z = matrix((cz, -sz, nil), (sz, cz, nil), (nil, nil, one))
    return about_z @ about_y @ about_x


def ground(rng: np.random.Generator, count: int, size: float, relief: float, kind: str) -> np.ndarray:
    """Points (count, 3): heights over a range `relief`, white or smooth (8 waves of 4 to 12 km)."""
    xy = rng.uniform(-size / 2.0, size / 2.0, (count, 2))
    if kind == "white":
        z = rng.uniform(-relief / 2.0, relief / 2.0, count)
    else:
        waves = 2.0 * np.pi / rng.uniform(4000.0, 12_000.0, 8)
        way = rng.uniform(0.0, 2.0 * np.pi, 8)
        phase = rng.uniform(0.0, 2.0 * np.pi, 8)
        height = rng.uniform(0.5, 1.0, 8)
        along = xy @ np.stack([np.cos(way), np.sin(way)])
        z = np.sin(along * waves + phase) @ height
        spread = np.ptp(z) if relief else 1.0
        z = (z - (z.max() + z.min()) / 2.0) * (relief / spread)
    return np.column_stack([xy, z])


@dataclass(frozen=True)
class Shooting:
    """What was measured: tangents (2, K, N, 2) in S2's camera axes, positions and axes in hand."""

    plan: Plan
    m: np.ndarray
    d: np.ndarray
    r: np.ndarray
    truth: np.ndarray  # (2, 3) S2 angles, rad

    def sightings(self, sigma_px: float = 0.1, keep: np.ndarray | None = None) -> Sightings:
        """The same for the package: pixels of nominal cameras, body axes as the package has them."""
        plan = self.plan
        k, n = self.m.shape[1:3]
        middle = (plan.width - 1) / 2.0
        f = 1.0 / plan.pixel
        # lines run forward (S2's u), columns to the left (against S2's v)
        pixels = np.stack([middle + f * self.m[..., 0], middle - f * self.m[..., 1]], axis=-1)
        image = np.broadcast_to(np.arange(2 * k).reshape(2, k, 1), (2, k, n))
        point = np.broadcast_to(np.arange(n), (2, k, n))
        tracks = Tracks(image.ravel(), point.ravel(), pixels.reshape(-1, 2), sigma_px)
        detector = AreaDetector("frame", (plan.width, plan.width), f, (middle, middle))
        shot = np.tile(np.arange(k), 2)
        images = Images(
            np.repeat([0, 1], k), shot, shot * plan.window / k, self.d.reshape(-1, 3),
            Rotation.from_matrix(np.swapaxes(self.r, -1, -2).reshape(-1, 3, 3)),
        )  # fmt: skip
        rows = tracks if keep is None else tracks[keep]
        return sight_frames(images, [detector, detector], [NADIR_MOUNT, NADIR_MOUNT], rows)

    def swapped(self) -> Shooting:
        """The same with the cameras numbered the other way; the axes in hand stay as they are."""
        return replace(self, m=self.m[::-1], d=self.d[::-1], r=self.r[::-1], truth=self.truth[::-1])


def shoot(
    plan: Plan, noise: Noise, points: np.ndarray, rng: np.random.Generator, truth: np.ndarray = TRUTH
) -> Shooting:
    """Measure points (N, 3), or (K, N, 3) where each shot has its own: S2's eq. (3)."""
    d = orbit(plan)
    r = axes(d)
    q = s2_rotation(truth[:, None] + noise.attitude * rng.standard_normal((2, plan.shots, 3)))
    seen = np.einsum(
        "jkab,jkbc,jknc->jkna",
        q,
        r,
        np.broadcast_to(points, (2, plan.shots, *points.shape[-2:])) - d[:, :, None],
    )
    m = seen[..., :2] / seen[..., 2:]
    m = m + noise.image * plan.pixel * rng.standard_normal(m.shape)
    in_hand = d + noise.position * rng.standard_normal(d.shape)
    return Shooting(plan, m, in_hand, axes(in_hand) if noise.aimed else r, truth)


def our_angles(truth: np.ndarray) -> np.ndarray:
    """S2's angles (2, 3) as rotation vectors on the body side, where body axes are S2's: Q = exp(-[a]x)."""
    return -Rotation.from_matrix(s2_rotation(truth)).as_rotvec()
