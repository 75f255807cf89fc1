"""The hardware: which way each pixel of a detector looks, in camera axes. No time, no pose.

Camera axes: x towards increasing columns, y towards increasing lines, z along the optical axis to the scene.

Not here: when a line is exposed and from where (``camera.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sightline.errors import InputError
from sightline.geometry.camera_kernels import curve_at, distort, undistort
from sightline.geometry.checks import (
    Array,
    ReadOnlyArrays,
    as_pixels,
    as_points,
    as_vector,
    finite,
    frozen,
    positive,
    read_only,
)
from sightline.geometry.pointing import FixedMount, Pointing

#: px; second difference of a row's directions from which it is rough: what a bend of 10 px over 100 columns
#: stays below, and CCDs that meet with an error of some hundredths of a pixel exceed.
STEP_PX = 0.01


@dataclass(frozen=True, eq=False)
class LineDetector(ReadOnlyArrays):
    """One row of a pushbroom focal plane: the direction each column looks.

    Attributes
    ----------
    name : str
        Of the detector or band.
    directions : (columns, 3)
        Unit vectors, camera axes, all in front of the camera (z > 0) and going one way along the line.
    line_period : float
        s between successive image lines.

    Examples
    --------
    >>> detector = LineDetector.from_ifov("PAN", columns=3, ifov=1e-6, line_period=1e-4)
    >>> detector.directions_at([1.0]).tolist()
    [[0.0, 0.0, 1.0]]
    """

    name: str
    directions: Array
    line_period: float

    def __post_init__(self) -> None:
        """Check, normalise and freeze."""
        positive(self.line_period, "line_period", "s")
        array = as_points(self.directions, "directions")
        norm = np.sqrt((array**2).sum(axis=1, keepdims=True))
        if len(array) < 2 or not (np.abs(norm - 1.0) < 1e-3).all() or not (array[:, 2] > 0).all():
            raise InputError(
                f"`directions` of detector {self.name!r} must be two or more unit vectors in camera axes "
                "with z > 0 (z looks to the scene); check the axes and the length of each row"
            )
        object.__setattr__(self, "directions", frozen(array / norm))
        if not (np.diff(self.curve[:, 0]) > 0).all():
            column = int(np.flatnonzero(np.diff(self.curve[:, 0]) <= 0)[0])
            raise InputError(
                f"`directions` of detector {self.name!r} must go one way along the line: they turn back "
                f"after column {column}; smooth the table or split the detector"
            )

    @classmethod
    def from_ifov(
        cls,
        name: str,
        columns: int,
        ifov: float,
        line_period: float,
        look_ahead: float = 0.0,
        offset_px: tuple[float, float] = (0.0, 0.0),
        rotation: float = 0.0,
    ) -> LineDetector:
        """A straight row of equal pixels, with the boresight at column (columns - 1) / 2.

        Parameters
        ----------
        name : str
            Of the detector or band.
        columns : int
            Number of pixels.
        ifov : float
            Pixel pitch / focal length (a tangent).
        line_period : float
            s.
        look_ahead : float
            Along-track viewing angle, rad, forward positive in the nominal mount.
        offset_px : (line, column)
            The row looks this many pixels further (toward larger lines, toward larger columns).
        rotation : float
            rad; positive looks further forward at larger columns.
        """
        if int(columns) != columns or columns < 2:
            raise InputError(f"`columns` must be a whole number of 2 or more, got {columns}")
        across = np.arange(int(columns)) - (int(columns) - 1) / 2.0
        ifov = positive(ifov, "ifov", "rad")
        line_px, column_px = as_vector(offset_px, "offset_px", 2)
        rotation = finite(rotation, "rotation", "rad")
        if not abs(look_ahead) < np.pi / 2:
            raise InputError(f"`look_ahead` must lie within 90 degrees (radians expected), got {look_ahead}")
        x = ifov * (across * np.cos(rotation) + column_px)
        y = np.tan(look_ahead) + ifov * (across * np.sin(rotation) + line_px)
        return cls(name, _unit(x, y), line_period)

    @property
    def columns(self) -> int:
        """Number of pixels of the row."""
        return len(self.directions)

    @cached_property
    def tangents(self) -> Array:
        """(columns, 2): x/z and y/z of each direction."""
        return frozen(self.directions[:, :2] / self.directions[:, 2:])

    @cached_property
    def pixel_step(self) -> float:
        """Mean step between neighbouring columns, as a tangent: the IFOV of a regular row."""
        ends = self.tangents[-1] - self.tangents[0]
        return float(np.hypot(ends[0], ends[1]) / (self.columns - 1))

    @cached_property
    def axis(self) -> Array:
        """(2,) unit vector, tangent plane: from the first column to the last."""
        ends = self.tangents[-1] - self.tangents[0]
        length = float(np.hypot(ends[0], ends[1]))
        return frozen(ends / length if length > 0 else np.array([1.0, 0.0]))

    @cached_property
    def curve(self) -> Array:
        """(columns, 2): tangents along `axis` and across it (towards increasing lines)."""
        (ex, ey), tangents = self.axis, self.tangents
        return frozen(tangents @ np.array([[ex, -ey], [ey, ex]]))

    @cached_property
    def is_straight(self) -> bool:
        """Whether the row is straight and regular to 1e-9 px, so that columns follow without iteration."""
        regular = np.linspace(self.curve[0, 0], self.curve[-1, 0], self.columns)
        worst = max(
            np.abs(self.curve[:, 0] - regular).max(), np.abs(self.curve[:, 1] - self.curve[0, 1]).max()
        )
        return bool(worst < 1e-9 * self.pixel_step)

    @cached_property
    def rough_columns(self) -> Array:
        """Columns that depart from the run of their neighbours by `STEP_PX`, as where two CCDs meet."""
        bends = np.abs(np.diff(self.curve, 2, axis=0)).max(axis=1, initial=0.0)
        return frozen(1.0 + np.flatnonzero(bends > STEP_PX * self.pixel_step))

    def directions_at(self, columns: ArrayLike) -> Array:
        """Unit directions (N, 3), camera axes, at fractional `columns` (N,).

        Cubic in the tangents between pixels (exact for a regular row), straight on beyond the ends.
        """
        t = np.empty((np.size(columns), 2))
        curve_at(self.tangents, read_only(np.atleast_1d(columns)), t)
        return _unit(t[:, 0], t[:, 1])

    def adjusted(
        self,
        line_px: float | Array = 0.0,
        column_px: float | Array = 0.0,
        rotation: float = 0.0,
        scale: float = 0.0,
    ) -> LineDetector:
        """The same row shifted, turned and stretched about its own centre.

        Parameters
        ----------
        line_px, column_px : float or (columns,)
            Shift in units of `pixel_step`: the row, or each of its pixels, looks that much further toward
            larger lines, columns.
        rotation : float
            rad; positive looks further toward larger lines at larger columns.
        scale : float
            Relative change of its length: 1e-3 makes a row of 1000 pixels see one pixel more.

        Returns
        -------
        LineDetector
            A new detector; ``from_ifov(...).adjusted(a, b, r)`` equals ``from_ifov(..., offset_px=(a, b),
            rotation=r)``.
        """
        middle = self.tangents[[(self.columns - 1) // 2, self.columns // 2]].mean(axis=0)
        sine, cosine = np.sin(rotation), np.cos(rotation)
        x, y = (1.0 + scale) * (self.tangents - middle).T
        step = self.pixel_step
        return replace(
            self,
            directions=_unit(
                middle[0] + cosine * x - sine * y + step * column_px,
                middle[1] + sine * x + cosine * y + step * line_px,
            ),
        )


def _unit(x: Array, y: Array) -> Array:
    """Unit vectors (N, 3) of tangents x, y."""
    scale = 1.0 / np.sqrt(1.0 + x * x + y * y)
    return np.stack([x * scale, y * scale, scale], axis=1)


@dataclass(frozen=True, eq=False)
class AreaDetector(ReadOnlyArrays):
    """A 2-D detector behind a lens: pinhole and Brown-Conrady distortion.

    Attributes
    ----------
    name : str
        Of the detector.
    shape : (lines, columns)
        Size, px.
    focal_length_px : float
        px.
    principal_point_px : (line, column)
        Where the optical axis meets the detector, px.
    distortion : tuple of up to 5 floats
        k1, k2, p1, p2, k3 in normalised coordinates (tangents), the order of OpenCV.
    wavelength_nm : (lines,) or None
        Of each line, for a sensor whose lines carry different filters.

    Notes
    -----
    With tangents x, y and r^2 = x^2 + y^2 (D. C. Brown, 1966):
    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y' = y (...) + p1 (r^2 + 2 y^2)
    + 2 p2 x y; column = c0 + f x', line = l0 + f y'.
    """

    name: str
    shape: tuple[int, int]
    focal_length_px: float
    principal_point_px: tuple[float, float]
    distortion: tuple[float, ...] = ()
    wavelength_nm: Array | None = None

    def __post_init__(self) -> None:
        """Check and freeze."""
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise InputError(f"`shape` must be (lines, columns), both positive, got {self.shape}")
        positive(self.focal_length_px, "focal_length_px", "px")
        as_vector(self.principal_point_px, "principal_point_px", 2)
        if len(self.distortion) > 5 or not np.isfinite(self.distortion).all():
            raise InputError(
                f"`distortion` must be at most 5 numbers k1, k2, p1, p2, k3, got {self.distortion}"
            )
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        if self.wavelength_nm is not None:
            wavelength = frozen(self.wavelength_nm)
            if wavelength.shape != (self.shape[0],):
                raise InputError(
                    f"`wavelength_nm` must have one value per line, shape ({self.shape[0]},): "
                    f"got {wavelength.shape}"
                )
            object.__setattr__(self, "wavelength_nm", wavelength)

    @cached_property
    def coefficients(self) -> Array:
        """The five distortion coefficients, zeros where not given."""
        return frozen(self.distortion + (0.0,) * (5 - len(self.distortion)))

    @cached_property
    def reach(self) -> float:
        """Largest tangent radius for which distortion is a one-to-one map that the frame can use.

        Beyond the radius where a distorted radius stops to grow, a far point would fold back into the frame.
        """
        line, column = self.principal_point_px
        corner = np.hypot(
            max(line, self.shape[0] - 1 - line) + FRAME_MARGIN_PX,
            max(column, self.shape[1] - 1 - column) + FRAME_MARGIN_PX,
        )
        k1, k2, _, _, k3 = self.coefficients
        radius = np.linspace(0.0, 4.0 * corner / self.focal_length_px, 4001)
        square = radius**2
        slope = 1.0 + square * (3 * k1 + square * (5 * k2 + square * 7 * k3))
        folds = np.flatnonzero(slope <= 0)
        return float(radius[folds[0]] if len(folds) else radius[-1])

    def directions(self, pixels: ArrayLike) -> Array:
        """Unit directions (N, 3), camera axes, of `pixels` (N, 2); NaN where the lens brings no light."""
        given = as_pixels(pixels)
        tangents = np.empty((len(given), 2))
        tangents[:, 0] = (given[:, 1] - self.principal_point_px[1]) / self.focal_length_px
        tangents[:, 1] = (given[:, 0] - self.principal_point_px[0]) / self.focal_length_px
        if self.distortion:
            undistort(tangents, self.coefficients, 1e-11 / self.focal_length_px, self.reach)
        return _unit(tangents[:, 0], tangents[:, 1])

    def pixels(self, directions: ArrayLike) -> Array:
        """Pixels (N, 2) that see `directions` (N, 3) of any length, camera axes; NaN behind the camera.

        The result is not clipped to the frame.
        """
        given = as_points(directions, "directions")
        with np.errstate(divide="ignore", invalid="ignore"):
            tangents = np.ascontiguousarray(given[:, :2] / given[:, 2:])
        tangents[~(given[:, 2] > 0)] = np.nan
        if self.distortion:
            distort(tangents, self.coefficients, self.reach)
        out = np.empty_like(tangents)
        out[:, 0] = self.principal_point_px[0] + self.focal_length_px * tangents[:, 1]
        out[:, 1] = self.principal_point_px[1] + self.focal_length_px * tangents[:, 0]
        return out


#: How far beyond the frame a point still gets a pixel (px).
FRAME_MARGIN_PX = 50.0


@dataclass(frozen=True, eq=False)
class Instrument:
    """Detectors behind one optical system on one platform.

    Attributes
    ----------
    name : str
        Of the instrument.
    detectors : tuple of LineDetector or AreaDetector
        With different names.
    pointing : Pointing
        How camera axes sit in the body.
    lever_arm : (3,)
        From the point whose positions are given to the entrance pupil, m, body axes.
    """

    name: str
    detectors: tuple[LineDetector | AreaDetector, ...]
    pointing: Pointing = field(default_factory=FixedMount)
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse two detectors of one name."""
        names = [detector.name for detector in self.detectors]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InputError(f"detectors of instrument {self.name!r} need different names: {repeated} repeat")
        as_vector(self.lever_arm, "lever_arm")

    def __getitem__(self, name: str) -> LineDetector | AreaDetector:
        """The detector called `name`. Raises InputError listing the names there are."""
        for detector in self.detectors:
            if detector.name == name:
                return detector
        names = ", ".join(detector.name for detector in self.detectors)
        raise InputError(f"instrument {self.name!r} has no detector {name!r}; it has: {names}")
