"""What a table says of frames: rows matched to frames by name, in the order of their times, at any time.

Not here: which tables there are (``positions.py``, ``attitudes.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84
from sightline.io.formats.tables import sigma_columns
from sightline.io.quantities import Within
from sightline.io.sequence.frames import FrameList, refuse_repeated
from sightline.io.sequence.schema import SequenceFile

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

#: s by which the t of a table of poses may differ from that of the frame.
SAME_TIME = 1e-3


@dataclass(frozen=True, eq=False)
class GivenRows:
    """Values of a table at their times, before they are carried to the frames.

    Attributes
    ----------
    frame : (n,) int
        Which frame each row is of; -1: of none.
    t : (n,)
        s.
    values : (n, k)
    sigma : (n, 3)
    axes : (n, 3, 3) or None
        Axes of computation from those the sigmas are along; None: the same.
    common : bool
        Whether errors are mostly those of all rows alike, as a receiver's, a gimbal's, another program's are.
    """

    frame: Index
    t: Array
    values: Array
    sigma: Array
    axes: Array | None = None
    common: bool = False


def is_local(file: SequenceFile) -> bool:
    """Whether the world is flat: x east, y north, z up, no place on the Earth."""
    return file.world.frame == "local" and file.world.origin is None


def radii_of(file: SequenceFile) -> tuple[float, float] | None:
    """Of the ellipsoid whose normals are the verticals; None where the world is flat."""
    return None if is_local(file) else (file.surface.radii or WGS84)


def along(t: Array, given: GivenRows) -> Array:
    """Values (M, k) at times `t`: linear between rows, straight on beyond the ends."""
    if len(given.t) == 1:
        return np.tile(given.values, (len(t), 1))
    k = np.clip(np.searchsorted(given.t, t, side="right"), 1, len(given.t) - 1)
    part = ((t - given.t[k - 1]) / (given.t[k] - given.t[k - 1]))[:, None]
    return np.asarray((1.0 - part) * given.values[k - 1] + part * given.values[k])


def slerp_along(t: Array, given: GivenRows) -> Rotation:
    """Attitudes at times `t` of quaternions: the shortest turn between rows, the nearest beyond the ends."""
    attitude = Rotation.from_quat(given.values)
    if len(given.t) == 1:
        return Rotation.concatenate([attitude] * len(t))
    return Slerp(given.t, attitude)(np.clip(t, given.t[0], given.t[-1]))


def matched(path: Path, frames: FrameList, names: tuple[str, ...], t: Array | None) -> tuple[Index, Array]:
    """Frame of each row and its time; FormatError where no row is of a frame, or times differ."""
    refuse_repeated(path, names)
    number = {name: k for k, name in enumerate(frames.names)}
    number |= {path.name: k for k, path in enumerate(frames.files) if path.name not in number}
    # as the exports write names with spaces
    number |= {
        "_".join(name.split()): k for name, k in number.items() if "_".join(name.split()) not in number
    }
    frame = np.array([number.get(name, -1) for name in names], dtype=np.intp)
    if (frame < 0).all():
        raise FormatError(
            f"{path}: no row is of a frame: the first is of {names[0]!r}, the frames are called "
            f"{frames.names[0]!r}, ...; names must agree"
        )
    own = np.where(frame >= 0, frames.t[frame], np.nan)
    if t is None:
        return frame, own
    far = np.flatnonzero(np.abs(t - own) > SAME_TIME)
    if len(far):
        k = int(far[0])
        raise FormatError(
            f"{path}: frame {names[k]!r} has t = {t[k]:.9g}, in "
            f"{(frames.marks or frames.path).name} it is {own[k]:.9g}; they must agree"
        )
    return frame, np.where(np.isfinite(own), own, t)


def in_time(
    frame: Index,
    t: Array,
    values: Array,
    sigma: Array,
    kept: Bools,
    axes: Array | None = None,
    *,
    common: bool = False,
) -> GivenRows | None:
    """Kept rows in the order of their times; None where there are none."""
    rows = np.flatnonzero(kept & np.isfinite(t))
    rows = rows[np.argsort(t[rows], kind="stable")]
    rows = rows[np.append(True, np.diff(t[rows]) > 0.0)] if len(rows) else rows
    if not len(rows):
        return None
    axes = None if axes is None else axes[rows]
    return GivenRows(frame[rows], t[rows], values[rows], sigma[rows], axes, common)


def sigmas_of(
    path: Path,
    table: dict[str, list[str] | Array],
    names: list[str],
    count: int,
    default: float,
    bounds: Within,
) -> Array:
    """Sigmas (n, 3) of a table, within the bounds of their kind; `default` where it has none."""
    if not names:
        return np.full((count, 3), default)
    return sigma_columns(path, table, names, bounds, unknown=True)
