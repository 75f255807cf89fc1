"""``[platform] kind = "spin"`` and ``[pointing]`` → how a body or a mirror turns.

Not here: tables of attitudes (``platform.py``), what the turns do to rays (``geometry/``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, SpanError
from sightline.geometry.earth import EARTH_RATE
from sightline.geometry.pointing import FixedMount, Pointing, ScanMirror
from sightline.geometry.spin import Spin
from sightline.io.acquisition.acquired import InputFolder, attitude_to_world, world_kind
from sightline.io.acquisition.schema import AcquisitionFile, CameraSection, ScanMirrorPointing, SpinPlatform
from sightline.io.formats import tables

Array = NDArray[np.float64]

#: rad; angles of a mirror beyond half a turn look like degrees.
LARGEST_ANGLE = 3.2


def spin_of(config: AcquisitionFile) -> Spin | None:
    """The spin of ``[platform]``, None for its other kinds.

    Parameters
    ----------
    config : AcquisitionFile

    Returns
    -------
    Spin or None
        In the axes of computation.

    Raises
    ------
    FormatError
        If flat axes are said to turn.
    """
    platform = config.platform
    if not isinstance(platform, SpinPlatform):
        return None
    local = world_kind(config) == "local"
    if local and platform.world_rate:
        raise FormatError(
            f"[platform] world_rate = {platform.world_rate:.6g}: local axes without an origin lie on a flat "
            'ground that does not turn; remove it, or give [world] origin or frame = "earth-fixed"'
        )
    still = local or config.surface.radii is not None or config.surface.kind == "infinity"
    return Spin(
        attitude_to_world(unit_rotation(platform.attitude), config),
        np.array(platform.axis),
        platform.rate,
        (0.0 if still else EARTH_RATE) if platform.world_rate is None else platform.world_rate,
        platform.axis_sigma,
        platform.rate_sigma,
    )


def unit_rotation(quaternion: tuple[float, float, float, float]) -> Rotation:
    """The rotation of a quaternion [x, y, z, w] of a TOML file, whose length is 1 but for rounding."""
    array = np.array(quaternion)
    return Rotation.from_quat(array / float(np.linalg.norm(array)))


def mount_of(camera: CameraSection) -> FixedMount:
    """``[camera]`` mount or body_from_camera."""
    if camera.body_from_camera is None:
        return FixedMount()
    return FixedMount(unit_rotation(camera.body_from_camera))


def pointing_of(config: AcquisitionFile, files: InputFolder, span: tuple[float, float]) -> Pointing:
    """How the camera looks out of the body: its mount, and the scan mirror of ``[pointing]``.

    Parameters
    ----------
    config : AcquisitionFile
    files : InputFolder
        Finds the table of the mirror's angles.
    span : (first, last)
        s; exposure of the first and last line (or frame) of all images.

    Raises
    ------
    SpanError
        If the table does not reach over `span`.
    """
    mount, pointing = mount_of(config.camera), config.pointing
    if not isinstance(pointing, ScanMirrorPointing):
        return mount
    path = files(pointing.angles)
    t, angle = tables.read_mirror_angles(path)
    must_cover(path, "mirror angles", t, span)
    largest = float(np.abs(angle).max())
    if largest > LARGEST_ANGLE:
        raise FormatError(
            f"{path}: the mirror angles of [pointing] reach {largest:g}; allowed are -{LARGEST_ANGLE} to "
            f"{LARGEST_ANGLE} rad; give radians, not degrees"
        )
    return ScanMirror(mount.body_from_camera, np.array(pointing.axis), np.array(pointing.normal), t, angle)


def must_cover(path: object, what: str, t: Array, span: tuple[float, float]) -> None:
    """SpanError unless the times `t` of a table reach from the first line to the last."""
    if t[0] <= span[0] and t[-1] >= span[1]:
        return
    raise SpanError(
        f"{path}: the {what} cover [{t[0]:.6f}, {t[-1]:.6f}] s, the images are exposed in "
        f"[{span[0]:.6f}, {span[1]:.6f}] s; supply {what} over that span, or check the epoch, "
        "first_line_time, and line_period (s, from line to line)"
    )
