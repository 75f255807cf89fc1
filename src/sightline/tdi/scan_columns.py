"""Columns of a push-broom camera as TDI sees them: how the scene moves past each, and what turns do to it.

The camera brings orbit, Earth rotation, steering law, distortion and reference attitude; whatever it reads
becomes velocity, slip and levers here.

Not here: how the scene moves over a detector (``geometry/scan.py``), a recovered motion (``motion_mtf.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.scan import scan_velocity
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band
from sightline.motion.statics import recovered_cameras
from sightline.tdi.setting import ScanColumns

Array = NDArray[np.float64]

#: Lines of the strip at which velocity, slip and levers are taken.
LINES = 9


@dataclass(frozen=True, eq=False)
class ColumnGeometry:
    """How the scene moves past columns on average over a strip, and how turns of the body move it.

    Attributes
    ----------
    column : (C,)
        Number in the detector line.
    velocity, slip : (C,)
        Pixels per line period along the column; rad from the column, positive towards increasing columns.
    velocity_scatter, slip_scatter : (C,)
        Standard deviations of the two over the lines of the strip.
    position_px : (C, 2)
        Across (towards increasing columns) and along (towards increasing lines) from the optical axis, px.
    focal_length_px : float
        px; inverse of the mean step between columns.
    levers : (C, 2, 3)
        px per rad: where roll, pitch and yaw of the body move the image, across and along the column.
    twist : (3,)
        Turn about the optical axis that roll, pitch and yaw are; it turns the path of the scene.
    line_period : float
        s

    Notes
    -----
    With the nominal mount and small angles the levers are (-F, 0, Y) across and (0, F, X) along, the twist is
    (0, 0, 1): a steady yaw turns the path by as much towards smaller columns.
    """

    column: Array
    velocity: Array
    slip: Array
    velocity_scatter: Array
    slip_scatter: Array
    position_px: Array
    focal_length_px: float
    levers: Array
    twist: Array
    line_period: float

    def columns(self, static_mtf: ArrayLike, covariance: Array | None = None) -> ScanColumns:
        """The columns as the choice takes them.

        Parameters
        ----------
        static_mtf : (C, 2) or (2,)
            MTF of what stands still, across and along.
        covariance : (C, 2, 2), optional
            Of velocity and slip.
        """
        mtf = np.broadcast_to(np.asarray(static_mtf, dtype=np.float64), (len(self.column), 2))
        return ScanColumns(self.column, self.velocity, self.slip, mtf, covariance)

    def attitude_covariance(self, attitude_sigma: ArrayLike, rate_sigma: ArrayLike) -> Array:
        """Covariance (C, 2, 2) of velocity and slip by what is not known of attitude and rates.

        Parameters
        ----------
        attitude_sigma : (3,)
            rad; of roll, pitch, yaw as they stand through the strip.
        rate_sigma : (3,)
            rad/s
        """
        standing, rates = (np.asarray(v, dtype=np.float64) for v in (attitude_sigma, rate_sigma))
        for name, value in (("attitude_sigma", standing), ("rate_sigma", rates)):
            if value.shape != (3,) or not (np.isfinite(value) & (value >= 0.0)).all():
                raise InputError(
                    f"`{name}` is {value.tolist()}; roll, pitch and yaw, finite and 0 or more, are needed"
                )
        slope = np.tan(self.slip)
        per_line = self.line_period * self.levers  # px per line period, by rates
        by_rate = np.empty_like(per_line)
        by_rate[:, 0] = per_line[:, 1]
        lean = np.cos(self.slip) ** 2 / self.velocity
        by_rate[:, 1] = lean[:, None] * (per_line[:, 0] - slope[:, None] * per_line[:, 1])
        # a turn about the optical axis leaves the speed, and turns the path
        by_turn = np.zeros_like(per_line)
        by_turn[:, 0] = (self.velocity * slope)[:, None] * self.twist
        by_turn[:, 1] = -self.twist
        return np.asarray(
            np.einsum("cik,k,cjk->cij", by_rate, rates**2, by_rate)
            + np.einsum("cik,k,cjk->cij", by_turn, standing**2, by_turn)
        )


def column_geometry(
    camera: PushbroomCamera, surface: Surface, columns: ArrayLike | None = None, *, lines: int = LINES
) -> ColumnGeometry:
    """How the scene moves past the columns of a camera, on average over its strip.

    Parameters
    ----------
    camera : PushbroomCamera
        With its reference trajectory; a motion in it counts too, as one of its lines.
    surface : Surface
        What the rays meet.
    columns : (C,), optional
        All of the detector by default.
    lines : int
        Evenly spread over the strip.

    Raises
    ------
    InputError
        Columns that the detector does not have.
    GeometryError
        A column that does not meet the surface at some of the lines.
    """
    wanted = np.arange(camera.columns) if columns is None else columns
    chosen: Array = np.atleast_1d(np.asarray(wanted, dtype=np.float64))
    if len(chosen) == 0 or not ((chosen >= 0) & (chosen <= camera.columns - 1)).all():
        raise InputError(
            f"`columns` are {chosen.tolist()}; columns of this detector are 0 to {camera.columns - 1}"
        )
    low, high = camera.known_lines
    places = np.linspace(max(1.0, low + 1.0), min(camera.lines - 2.0, high - 1.0), lines)
    speed, lean = np.empty((2, lines, len(chosen)))
    for k, line in enumerate(places):
        seen = scan_velocity(camera, np.column_stack([np.full(len(chosen), line), chosen]), surface)
        speed[k], lean[k] = seen.velocity, seen.slip
    if not np.isfinite(speed).all():
        column = int(chosen[np.flatnonzero(~np.isfinite(speed).all(axis=0))[0]])
        raise GeometryError(
            f"column {column} does not meet the surface at some lines of the strip; check the platform's "
            "height and attitude and the extent of the DEM, or leave the column out"
        )
    along = speed * np.cos(lean)
    levers, twist = image_levers(camera, chosen, camera.times(places))
    return ColumnGeometry(
        chosen,
        along.mean(axis=0),
        lean.mean(axis=0),
        along.std(axis=0),
        lean.std(axis=0),
        _turned_to_row(camera, _tangents(camera, chosen))
        * np.array([1.0, -1.0])
        / camera.detector.pixel_step,
        1.0 / camera.detector.pixel_step,
        levers,
        twist,
        camera.detector.line_period,
    )


def _tangents(camera: PushbroomCamera, columns: Array) -> Array:
    """(C, 2) x/z and y/z of columns in camera axes."""
    directions = camera.detector.directions_at(columns)
    return np.asarray(directions[:, :2] / directions[:, 2:])


def _turned_to_row(camera: PushbroomCamera, moves: Array) -> Array:
    """Tangents (..., 2) in camera axes, as across (to larger columns) and along (to smaller lines)."""
    ex, ey = camera.detector.axis
    x, y = moves[..., 0], moves[..., 1]
    return np.stack([ex * x + ey * y, ey * x - ex * y], axis=-1)


def image_levers(camera: PushbroomCamera, columns: Array, t: Array) -> tuple[Array, Array]:
    """Where turns of the body move the image of a camera, and how they turn it.

    Parameters
    ----------
    camera : PushbroomCamera
    columns : (C,)
    t : (T,)
        s; instants over which a mirror's turns are averaged.

    Returns
    -------
    levers : (C, 2, 3)
        px/rad: across and along the column, by roll, pitch, yaw.
    twist : (3,)
        Turn about the optical axis by each.
    """
    # columns of camera_from_body: where the body's axes point in the camera (a mirror turns them with time)
    axes = np.stack(
        [camera.pointing.to_camera(np.tile(axis, (len(t), 1)), t).mean(axis=0) for axis in np.eye(3)]
    )
    # a mirror turns the image over: a turn of the body, an axial vector, then changes its sign
    handed = np.sign(np.linalg.det(axes))
    x, y = _tangents(camera, columns).T
    levers = np.empty((len(columns), 2, 3))
    for k, (wx, wy, wz) in enumerate(handed * axes):
        # a point that stands still moves by -w x d when the camera turns by w; seen in the plane z = 1
        dx, dy, dz = wz * y - wy, wx - wz * x, wy * x - wx * y
        moved = np.stack([dx - x * dz, dy - y * dz], axis=-1)
        levers[:, :, k] = _turned_to_row(camera, moved) / camera.detector.pixel_step
    return levers, handed * axes[:, 2]


def band_camera(
    bands: Sequence[Band], name: str, statics: Mapping[str, float] | None = None
) -> PushbroomCamera:
    """Camera of a band without a motion, its offset and rotation as recovered where they are given.

    Parameters
    ----------
    bands : sequence of Band
        Of an acquisition.
    name : str
    statics : mapping, optional
        Name of a static parameter to its value.

    Raises
    ------
    InputError
        No band of that name; images that are not made line by line.
    """
    if not bands:
        raise InputError("the acquisition has frames, no bands: TDI needs a push-broom detector, a [[band]]")
    names = [band.name for band in bands]
    if name not in names:
        raise InputError(f"no band is called {name!r}: the bands are {', '.join(names)}; name one of them")
    band = bands[names.index(name)]
    still = Motion.zero(*band.camera.trajectory.span)
    return recovered_cameras([band], still, statics or {})[0]


def strip_span(camera: PushbroomCamera) -> tuple[float, float]:
    """s; when the first and the last line of a band are exposed."""
    first, last = camera.times([0.0, camera.lines - 1.0])
    return float(min(first, last)), float(max(first, last))
