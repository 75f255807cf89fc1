"""Omega-phi-kappa and yaw-pitch-roll tables ↔ attitudes.

Degrees, against level axes (east, north, up) at the origin of the table, or at each place where it has none.

``omega,phi,kappa``: of the image, whose axes are x to larger columns, y to smaller lines, z towards the
viewer; east_north_up_from_image = Rx(omega) Ry(phi) Rz(kappa), each about the axis as already turned.
``yaw,pitch,roll``: of the body (x forward, y right, z down) against north, east, down: yaw clockwise from
north, then pitch (nose up), then roll (right wing down).

Columns may stand in any order: ``frame,x,y,z,omega,phi,kappa`` or ``frame,x,y,z,yaw,pitch,roll``; x, y, z in
m east, north, up of the origin that a first line ``# origin = longitude,latitude,height`` gives (none: of a
local world). Angles of the camera and of the body differ by the mount.

Not here: attitudes as quaternions (``io/results/poses.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import read_text
from sightline.errors import FormatError, reads
from sightline.io.formats.tables import header_of, read_columns, write_columns
from sightline.writing import whole_text

Array = NDArray[np.float64]

OPK, YPR = ("omega", "phi", "kappa"), ("yaw", "pitch", "roll")
#: Image axes (x columns, y up, z to the viewer) to camera axes (x columns, y lines, z forward), and north,
#: east, down to east, north, up: both are their own inverse.
_IMAGE_FROM_CAMERA = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
ENU_FROM_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

_ORIGIN = re.compile(r"#\s*origin\s*=\s*([^,\s]+)\s*,\s*([^,\s]+)\s*,\s*([^,\s]+)\s*")


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Places and attitudes of frames as such a table has them.

    Attributes
    ----------
    names : tuple of str
    position : (M, 3)
        m, east, north, up.
    angles : (M, 3)
        Degrees.
    kind : tuple of str
        `OPK` or `YPR`.
    origin : (3,) or None
        Longitude, latitude (degrees), height (m) of the axes.
    """

    names: tuple[str, ...]
    position: Array
    angles: Array
    kind: tuple[str, str, str]
    origin: tuple[float, float, float] | None = None

    def camera(self, body_from_camera: Rotation) -> Rotation:
        """east_north_up_from_camera of all frames."""
        if self.kind == OPK:
            return camera_of_opk(self.angles)
        return body_of_ypr(self.angles) * body_from_camera


def camera_of_opk(degrees: Array) -> Rotation:
    """east_north_up_from_camera of omega, phi, kappa (M, 3), degrees."""
    return Rotation.from_euler("XYZ", degrees, degrees=True) * _IMAGE_FROM_CAMERA


def opk_of_camera(east_north_up_from_camera: Rotation) -> Array:
    """Omega, phi, kappa (M, 3), degrees: the inverse of `camera_of_opk`."""
    return np.asarray((east_north_up_from_camera * _IMAGE_FROM_CAMERA).as_euler("XYZ", degrees=True))


def body_of_ypr(degrees: Array) -> Rotation:
    """east_north_up_from_body of yaw, pitch, roll (M, 3), degrees."""
    return ENU_FROM_NED * Rotation.from_euler("ZYX", degrees, degrees=True)


def ypr_of_body(east_north_up_from_body: Rotation) -> Array:
    """Yaw, pitch, roll (M, 3), degrees: the inverse of `body_of_ypr`."""
    return np.asarray((ENU_FROM_NED * east_north_up_from_body).as_euler("ZYX", degrees=True))


def kind_of_angles(path: Path) -> tuple[str, str, str] | None:
    """`OPK` or `YPR` by the header of a table; None where it has neither."""
    header = header_of(path)
    return next((kind for kind in (OPK, YPR) if set(kind) <= set(header)), None)


@reads("a table of angles")
def read_angles(path: Path) -> AngleTable:
    """An omega-phi-kappa or yaw-pitch-roll table; FormatError names file, row and column."""
    kind = kind_of_angles(path)
    if kind is None:
        raise FormatError(
            f"{path}: the header is {','.join(header_of(path))!r}; omega,phi,kappa or yaw,pitch,roll "
            "are expected"
        )
    table = read_columns(path, ("frame", "x", "y", "z", *kind), text=("frame",))

    def matrix(names: Sequence[str]) -> Array:
        return np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])

    return AngleTable(
        tuple(str(name) for name in table["frame"]), matrix("xyz"), matrix(kind), kind, origin_of_angles(path)
    )


@reads("a table of angles")
def origin_of_angles(path: Path) -> tuple[float, float, float] | None:
    """Longitude, latitude (degrees), height (m) of the comment at the top; None where there is none."""
    first, _, _ = read_text(path, "a CSV table").partition("\n")
    match = _ORIGIN.fullmatch(first.strip())
    if match is None:
        return None
    try:
        longitude, latitude, height = (float(word) for word in match.groups())
    except ValueError:
        raise FormatError(f"{path}: line 1: {match[0]!r}: longitude, latitude, height are expected") from None
    return longitude, latitude, height


def write_angles(path: Path, table: AngleTable) -> None:
    """The same as a file, with full precision."""
    columns = ("frame", "x", "y", "z", *table.kind)
    values = [np.array(table.names, dtype=str), *table.position.T, *table.angles.T]
    write_columns(path, dict(zip(columns, values, strict=True)), dict.fromkeys(columns[1:], "%.17g"))
    if table.origin is not None:
        text = path.read_text(encoding="utf-8")
        top = "# origin = " + ",".join(f"{value:.12g}" for value in table.origin)
        whole_text(path, f"{top}\n{text}")
