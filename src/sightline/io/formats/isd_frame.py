"""USGS CSM frame sensor models (ISD) → a FrameCamera's detector, and where it was when it exposed.

Not here: the focal plane and its distortion (``focal_plane.py``), line scanners (``isd.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, InputError, reads
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.io.formats.csm_keys import FRAME, read_keys
from sightline.io.formats.focal_plane import CsmFocalPlane, isd_plane
from sightline.io.formats.isd import body_fixed, isd_radii

Array = NDArray[np.float64]

#: Lines or samples beyond which a file is damaged: no area detector has as many.
_MOST = 100_000
#: Pixels on a side of the grid on which the lens is compared.
_GRID = 15
#: px; what the lens of an AreaDetector may differ by from that of the file.
LENS_PX = 0.01


@dataclass(frozen=True, eq=False)
class IsdFrame:
    """A frame sensor model in our terms.

    Attributes
    ----------
    detector : AreaDetector
        Focal length, principal point and distortion that come nearest to the lens of the file.
    lens_px : float
        By how much they differ from it at most, px.
    position : (3,)
        m, body-fixed.
    world_from_body : Rotation
        One; world axes are body-fixed, the camera sits in its body as nominal.
    radii : (float, float)
        m; equatorial and polar radius of the body.
    et : float
        s past J2000 (TDB); the middle of the exposure.
    """

    detector: AreaDetector
    lens_px: float
    position: Array
    world_from_body: Rotation
    radii: tuple[float, float]
    et: float


@reads("a frame sensor model")
def read_frame_model(path: Path) -> IsdFrame:
    """A USGS CSM frame ISD, as ALE writes it.

    Parameters
    ----------
    path : Path
        JSON.

    Returns
    -------
    IsdFrame

    Raises
    ------
    FormatError
        Names the file and the key; the image is mirrored; its lens is none that we have.
    """
    data = read_keys(path, FRAME)
    if data.is_state:
        raise FormatError(f"{path}: is a model state; of frames ISDs are read: give that of the image")
    et = data.number("center_ephemeris_time")
    shape = data.count("image_lines", 2, _MOST), data.count("image_samples", 2, _MOST)
    position, world_from_sensor = body_fixed(data, et)
    detector, camera_from_sensor, lens_px = _detector(isd_plane(data), shape)
    world_from_body = world_from_sensor * camera_from_sensor.inv() * NADIR_MOUNT.inv()
    return IsdFrame(detector, lens_px, position, world_from_body, isd_radii(data), et)


def _detector(plane: CsmFocalPlane, shape: tuple[int, int]) -> tuple[AreaDetector, Rotation, float]:
    """The detector nearest to a focal plane, how its axes lie in the sensor's, and px that are left."""
    grid = np.meshgrid(*(np.linspace(0.0, size - 1.0, _GRID) for size in shape), indexing="ij")
    pixels = np.stack(grid, axis=-1).reshape(-1, 2)
    line, sample = (pixels + 0.5).T
    looks = plane.directions(
        line * plane.line_summing + plane.starting[0], sample * plane.sample_summing + plane.starting[1]
    )
    start = _affine_start(pixels, looks[:, :2])

    def lens(values: Array) -> tuple[AreaDetector, Rotation]:
        focal, at_line, at_column, angle = values[:4] * start
        detector = AreaDetector("model", shape, focal, (at_line, at_column), tuple(values[4:]))
        return detector, Rotation.from_rotvec([0.0, 0.0, angle])

    def missing(values: Array) -> Array:
        detector, turn = lens(values)
        return np.nan_to_num(detector.pixels(turn.apply(looks)) - pixels, nan=1e6).ravel()

    scale = np.concatenate([np.ones(4), np.ones(5)])
    found = least_squares(
        missing, np.concatenate([np.ones(4), np.zeros(5)]), x_scale=scale, xtol=1e-15, ftol=1e-15
    )
    left = float(np.abs(found.fun).max())
    if not left <= LENS_PX:
        raise InputError(
            f"its lens is none of focal length, principal point and distortion k1, k2, p1, p2, k3: these "
            f"leave {left:.3g} px, {LENS_PX:g} px are allowed; are its pixels square?"
        )
    return *lens(found.x), left


def _affine_start(pixels: Array, tangents: Array) -> Array:
    """Focal length (px), principal point (line, column) and angle from camera to sensor axes, roughly."""
    terms = np.column_stack([tangents, np.ones(len(tangents))])
    (a, b), (c, d), (line, column) = np.linalg.lstsq(terms, pixels, rcond=None)[0]
    # columns = focal (cos x - sin y), lines = focal (sin x + cos y) for axes turned by the angle
    if b * c - a * d <= 0.0:
        raise InputError("the image is mirrored: its lines and samples turn the other way than the scene")
    return np.array([np.sqrt(b * c - a * d), line, column, np.arctan2(a, b) or 1e-300])
