"""A flight straight north over flat ground, in closed form, as the files of a SEQUENCE.toml.

Nothing of the package is used. Frame k is at (0, 5 k, 100) m at t = 0.5 k s, nose north, camera down.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SHAPE = (24, 32)
#: world_from_body of a nose to the north, z down: x to north, y to east.
NORTH = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
TOML = """
frames = "frames.csv"
positions = "positions.csv"
attitudes = "attitudes.csv"
position_bias_sigma = 2.0
attitude_bias_sigma = 0.01

[sequence]
name = "north"
epoch = "2026-01-01T00:00:00Z"

[world]
frame = "local"

[camera]
shape = [24, 32]
focal_length_px = 40.0

[surface]
height = 0.0
height_sigma = 1.0
"""
FRAMES = "frame,t,image"
POSITIONS = "frame,t,x,y,z,sigma_x,sigma_y,sigma_z"
ATTITUDES = "frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw"


@dataclass
class Flight:
    """Rows of the files, to be spoilt and written."""

    toml: str
    frames: list[list[object]]
    positions: list[list[object]]
    attitudes: list[list[object]]
    images: dict[str, bytes]
    headers: dict[str, str] = field(
        default_factory=lambda: {"frames": FRAMES, "positions": POSITIONS, "attitudes": ATTITUDES}
    )
    extra: dict[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """All files; gives the TOML file."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("frames", "positions", "attitudes"):
            rows = [self.headers[name], *(",".join(map(str, row)) for row in getattr(self, name))]
            (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
        for name, content in self.images.items():
            (folder / name).write_bytes(content)
        for name, content in self.extra.items():
            (folder / name).write_text(content)
        toml = folder / "sequence.toml"
        toml.write_text(self.toml)
        return toml


def npy(array: np.ndarray) -> bytes:
    """The bytes of a .npy file."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def picture(seed: int, shape: tuple[int, int] = SHAPE) -> bytes:
    """Noise as an image."""
    return npy(np.random.default_rng(seed).integers(0, 4000, shape).astype(np.uint16))


def flight(count: int = 6, shape: tuple[int, int] = SHAPE) -> Flight:
    """Files without a fault."""
    size = f"shape = [{shape[0]}, {shape[1]}]"
    t = [0.5 * k for k in range(count)]
    return Flight(
        TOML.replace("shape = [24, 32]", size),
        [[k, t[k], f"f{k}.npy"] for k in range(count)],
        [[k, t[k], 0.0, 5.0 * k, 100.0, 1.0, 1.5, 2.0] for k in range(count)],
        [[k, t[k], *NORTH, 0.01, 0.02, 0.03] for k in range(count)],
        {f"f{k}.npy": picture(k, shape) for k in range(count)},
    )
