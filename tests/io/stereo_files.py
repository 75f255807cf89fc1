"""Two spacecraft that look at one point, in closed form, as the files of a STEREO.toml.

A sphere that stands still, one circular orbit, S2's axes. Nothing of the package is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

RADIUS, ALTITUDE, MU = 6_371_000.0, 420e3, 3.986004418e14
FOCAL_PX, SHAPE = 30_558.0, (600, 700)  # 6.75 arcsec a pixel
ARCSEC = np.pi / 648_000.0
#: body_from_camera: lines forward, columns left.
MOUNT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TRUTH = 36.0 * ARCSEC * np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
TOML = """
cameras = "cameras.csv"
matches = "matches.csv"

[stereo]
name = "<b>two</b> spacecraft"
epoch = "2026-01-01T00:00:00Z"

[camera]
shape = [600, 700]
focal_length_px = 30558.0

[noise]
sigma_px = 0.1
sigma_position = 1.0
sigma_attitude = 1e-6

[surface]
radii = [6371000.0, 6371000.0]
"""
CAMERAS = "camera,shot,t,x,y,z,qx,qy,qz,qw".split(",")
MATCHES = "shot,point,line_1,column_1,line_2,column_2".split(",")


@dataclass
class Scene:
    """Rows of the files, to be spoilt and written."""

    toml: str
    cameras: list[list[object]]
    matches: list[list[object]]
    observations: list[list[object]]
    points: np.ndarray
    aim: np.ndarray
    extra: dict[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """All files; gives the TOML file."""
        folder.mkdir(parents=True, exist_ok=True)
        table(folder / "cameras.csv", CAMERAS, self.cameras)
        table(folder / "matches.csv", MATCHES, self.matches)
        table(folder / "observations.csv", "camera,shot,point,line,column".split(","), self.observations)
        rows = [[k + 1, *angles] for k, angles in enumerate(TRUTH)]
        table(folder / "orientation-truth.csv", ["camera", "roll", "pitch", "yaw"], rows)
        for name, text in self.extra.items():
            (folder / name).write_text(text)
        (folder / "stereo.toml").write_text(self.toml)
        return folder / "stereo.toml"


def table(path, header, rows):
    lines = [",".join(header), *(",".join(word(v) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def word(value):
    return format(value, ".17g") if isinstance(value, float) else str(value)


def scene(shots=8, points=30, window=40.0, separation=70.0, *, seed=1, truth=TRUTH, relief=400.0) -> Scene:
    """Planned poses with 1 m and 1e-6 rad of noise, pixels with 0.1 px."""
    rng = np.random.default_rng(seed)
    rate = np.sqrt(MU / (RADIUS + ALTITUDE) ** 3)
    t = (np.arange(shots) - (shots - 1) / 2.0) * window / shots
    aim = RADIUS * np.array([np.cos(0.01), 0.0, np.sin(0.01)])
    east = rng.uniform(-3500.0, 3500.0, (points, 2))
    up = aim / RADIUS
    side, along = np.array([-up[2], 0.0, up[0]]), np.array([0.0, 1.0, 0.0])
    flat = aim + east[:, :1] * side + east[:, 1:] * along
    places = (
        flat / np.linalg.norm(flat, axis=1)[:, None] * (RADIUS + rng.normal(0.0, relief, points))[:, None]
    )
    true = []
    for lag in (separation / 2.0, -separation / 2.0):  # camera 1 leads
        phase = rate * (t + lag)
        true.append((RADIUS + ALTITUDE) * np.stack([np.cos(phase), np.sin(phase), np.zeros(shots)], axis=1))
    seen = [p + rng.normal(0.0, 1.0, p.shape) for p in true]
    planned = axes(true[0], true[1], aim)
    cameras, pixels = [], []
    for k in range(2):
        attitude = Rotation.from_matrix(planned[k])
        actual = (
            attitude * Rotation.from_rotvec(truth[k]) * Rotation.from_rotvec(rng.normal(0, 1e-6, (shots, 3)))
        )
        quaternion = attitude.as_quat()
        for n in range(shots):
            cameras.append([k + 1, n, float(t[n]), *map(float, seen[k][n]), *map(float, quaternion[n])])
        q = np.einsum(
            "sij,snj->sni", np.swapaxes(actual.as_matrix() @ MOUNT, 1, 2), places - true[k][:, None]
        )
        column = (SHAPE[1] - 1) / 2 + FOCAL_PX * q[..., 0] / q[..., 2]
        line = (SHAPE[0] - 1) / 2 + FOCAL_PX * q[..., 1] / q[..., 2]
        pixels.append(np.stack([line, column], axis=-1) + rng.normal(0, 0.1, (shots, points, 2)))
    matches = [
        [n, p, *map(float, pixels[0][n, p]), *map(float, pixels[1][n, p])]
        for n in range(shots)
        for p in range(points)
    ]
    observations = [
        [k + 1, n, p, *map(float, pixels[k][n, p])]
        for k in range(2)
        for n in range(shots)
        for p in range(points)
    ]
    return Scene(TOML, cameras, matches, observations, places, aim)


def axes(first, second, aim):
    """world_from_body of both cameras (K, 3, 3): S2's axes."""
    n = [(p - aim) / np.linalg.norm(p - aim, axis=1)[:, None] for p in (first, second)]
    y = np.cross(n[0], n[1])
    y /= np.linalg.norm(y, axis=1)[:, None]
    return [np.stack([np.cross(y, -v), y, -v], axis=-1) for v in n]
