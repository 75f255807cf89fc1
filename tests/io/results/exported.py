"""A strip from orbit and a motion that nobody estimated: what exports are tested with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from tests.io.conftest import write_tif

from sightline.geometry.rotations import to_quat_xyzw
from sightline.geometry.trajectory import Motion
from sightline.io.acquisition.load import load_acquisition
from sightline.io.results.exports import Exported
from sightline.motion.statics import recovered_cameras

#: Of the strip: lines, columns, s between lines, angle of a pixel. GSD 0.7 m.
LINES, COLUMNS, PERIOD, IFOV = 1500, 400, 1e-4, 1e-6
EPOCH = "2026-03-04T05:06:07.25Z"

ORBIT = f"""
[acquisition]
name = "over the sea"
epoch = "{EPOCH}"
[platform]
kind = "ephemeris"
positions = "orbit.csv"
[instrument]
ifov = {IFOV}
columns = {COLUMNS}
line_period = {PERIOD}
[[band]]
name = "PAN"
image = "PAN.tif"
look_ahead = 1e-4
rotation = 2e-4
[[band]]
name = "XS"
image = "XS.tif"
first_line_time = 0.01
[surface]
height = 120.0
"""


def orbit_strip(folder: Path, *, amplitude: float = 2e-6, extra: str = "") -> Exported:
    """Two bands over (about) 10 E, 45 N from 700 km, nodding at 47 Hz and rolling at 31 Hz (rad)."""
    t = np.arange(-1.0, 1.26, 0.05)
    angle = np.radians(45.0) + 1.06e-3 * t
    place = 7068e3 * np.stack([np.cos(angle), 0 * t, np.sin(angle)], axis=1)
    place = Rotation.from_euler("z", (np.radians(10.0) - 7.29e-5 * t)[:, None]).apply(place)
    rows = "".join(
        f"{a!r},{x!r},{y!r},{z!r}\n" for a, (x, y, z) in zip(t.tolist(), place.tolist(), strict=True)
    )
    (folder / "orbit.csv").write_text("t,x,y,z\n" + rows)
    rng = np.random.default_rng(5)
    for name in ("PAN", "XS"):
        write_tif(folder / f"{name}.tif", rng.integers(1, 4000, (LINES, COLUMNS)).astype(np.uint16))
    (folder / "acquisition.toml").write_text(ORBIT + extra)
    return moved(load_acquisition(folder / "acquisition.toml"), amplitude)


def moved(acquisition, amplitude: float) -> Exported:
    """What would be exported of an acquisition if this motion had been found in it."""
    band = acquisition.bands[0].camera
    period = band.detector.line_period
    t = band.first_line_time + period * np.arange(-400.0, band.lines + 400.0)
    t = t[(t >= band.trajectory.span[0]) & (t <= band.trajectory.span[1])]
    rate = 47.0 * 1e-4 / period
    angles = amplitude * np.stack(
        [
            np.sin(2 * np.pi * 0.66 * rate * t),
            np.cos(2 * np.pi * rate * t),
            5.0 * np.sin(2 * np.pi * 0.1 * rate * t),
        ],
        axis=1,
    )
    motion = Motion(t, angles)
    found = {"XS along": 0.3, "XS across": -0.7}
    cameras = recovered_cameras(acquisition.bands, motion, found)
    lines = t[400:-400] if len(t) > 800 else t
    reference = acquisition.cameras[0].trajectory.at(lines)
    attitude = reference.world_from_body * Rotation.from_rotvec(motion.at(lines))
    return Exported(
        acquisition.name, lines, to_quat_xyzw(attitude), np.full((len(lines), 3), 1e-8), acquisition.epoch,
        "ITRF", reference.position, acquisition, dict(zip(acquisition.names, cameras, strict=True)),
    )  # fmt: skip
