"""Cameras: pixels to rays, to points of a surface, and back. Pushbroom and frame.

`rays` is the geometry; `locate` is ``surface.intersect(rays)``; `project` undoes `locate`. Poses are
evaluated by ``Trajectory.at`` once per image line and kept in a table; compiled loops interpolate it.

Not here: what the rays meet (``surface.py``), the direction of each pixel in the camera (``instrument.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError, SpanError
from sightline.execution import slices
from sightline.geometry.camera_kernels import find_lines, line_rays, seen_tangents
from sightline.geometry.checks import (
    Array,
    ReadOnlyArrays,
    as_pixels,
    as_points,
    as_times,
    as_vector,
    finite,
    frozen,
    read_only,
)
from sightline.geometry.instrument import FRAME_MARGIN_PX, AreaDetector, LineDetector
from sightline.geometry.interpolation import interpolate
from sightline.geometry.pointing import Pointing
from sightline.geometry.pose_table import PoseTable, camera_poses
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import TIME_SLACK, Trajectory
from sightline.writing import let_go, scratch_array

#: How far beyond the ends of a detector line a point still gets a column (px).
COLUMN_MARGIN_PX = 50.0
#: Lines beyond the image that the table of poses covers, where the trajectory allows: they make rays of
#: windows that reach over the edge possible, and the cubic central there.
_MARGIN_LINES = 16
#: Lines whose planes are found at a time.
_AT_ONCE = 16384
#: Rays may reach this far (lines) beyond the trajectory, and images beyond the centres of their first and
#: last line: half a pixel, and rounding.
_EDGE = 0.5 + 1e-6

#: TDI stages that a pixel may have.
MOST_STAGES = 1024
#: Which of a pixel's TDI stages the time of its line is of: where their middle lies from it, in halves of the
#: time from the first to the last.
TIME_REFERENCES = {"centre": 0.0, "first-stage": 1.0, "last-stage": -1.0}


@dataclass(frozen=True, eq=False)
class Rays:
    """Half-lines along which pixels look.

    Attributes
    ----------
    t : (N,)
        s, when each pixel was exposed.
    origins : (N, 3)
        m, world axes.
    directions : (N, 3)
        Unit, world axes.
    """

    t: Array
    origins: Array
    directions: Array


class Camera(Protocol):
    """Image geometry. Everything downstream sees only these three methods."""

    def rays(self, pixels: Array) -> Rays:
        """Half-lines along which `pixels` (N, 2), (line, column), look."""
        ...

    def locate(self, pixels: Array, surface: Surface) -> Array:
        """Points (N, 3) of `surface` seen by `pixels` (N, 2); NaN row where a ray misses."""
        ...

    def project(self, points: Array) -> Array:
        """Pixels (N, 2) that see `points` (N, 3); NaN row where a point is not in the image."""
        ...


@dataclass(frozen=True, eq=False)
class PushbroomCamera(ReadOnlyArrays):
    """One image made by one line detector while the platform moves.

    Attributes
    ----------
    detector : LineDetector
        Where each column looks, and the line period.
    trajectory : Trajectory
        Position and attitude; must cover the exposures of the lines that are used.
    pointing : Pointing
        How camera axes sit in the body.
    first_line_time : float
        s from the epoch, centre of the exposure of line 0.
    lines : int
        Lines of the image.
    line_times : (lines,) or None
        s; exposure of each line where they are not evenly spaced. Then `first_line_time` is its first.
    lever_arm : (3,)
        From the point whose positions are given to the entrance pupil, m, body axes.
    stages : (1 or lines, columns) int or None
        TDI stages that pixels are summed of, of every line or of each; given as one number or one per column
        too. None: one each.
    time_reference : str
        One of TIME_REFERENCES: which of a pixel's stages looks as `detector` says, at the time of its line.

    Notes
    -----
    A pixel of N stages shows the ground as it was seen in N line periods, each stage one line period and one
    pixel after the one before: it looks where the stages do on average. Position and nominal direction are
    those of their middle, the attitude is its mean: of each stage about where it looks, so that a turn about
    the line of sight that grows from stage to stage moves the columns too.

    Line i is exposed at t = first_line_time + line_period * i. Poses are exact at whole lines and follow the
    cubic through the four nearest lines between them.
    """

    detector: LineDetector
    trajectory: Trajectory
    pointing: Pointing
    first_line_time: float
    lines: int
    line_times: Array | None = None
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stages: NDArray[np.int16] | int | None = None
    time_reference: str = "centre"

    def __post_init__(self) -> None:
        """Check and freeze."""
        if int(self.lines) != self.lines or self.lines < 1:
            raise InputError(f"`lines` must be a whole number of 1 or more, got {self.lines}")
        finite(self.first_line_time, "first_line_time", "s")
        as_vector(self.lever_arm, "lever_arm")
        if self.line_times is not None:
            times = frozen(as_times(self.line_times, "line_times", increasing=True))
            if len(times) != self.lines:
                raise InputError(
                    f"`line_times` must have one time per line, ({self.lines},), got {times.shape}"
                )
            object.__setattr__(self, "line_times", times)
            object.__setattr__(self, "first_line_time", float(times[0]))
        if self.time_reference not in TIME_REFERENCES:
            raise InputError(
                f"`time_reference` is {self.time_reference!r}; allowed are {', '.join(TIME_REFERENCES)}"
            )
        if self.stages is not None:
            given = np.asarray(self.stages)
            shapes = ((), (self.columns,), (1, self.columns), (self.lines, self.columns))
            if given.shape not in shapes or not ((given >= 1) & (given <= MOST_STAGES)).all():
                raise InputError(
                    f"`stages` must be whole numbers from 1 to {MOST_STAGES}: one for all, one per column "
                    f"({self.columns},), or one per pixel ({self.lines}, {self.columns}); got shape "
                    f"{given.shape}"
                )
            if given.ndim < 2:
                given = np.broadcast_to(given, (1, self.columns))
            counts = np.array(given, dtype=np.int16)
            counts.setflags(write=False)
            object.__setattr__(self, "stages", counts if (counts > 1).any() else None)

    @property
    def columns(self) -> int:
        """Columns of the image."""
        return self.detector.columns

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns) of the image."""
        return self.lines, self.columns

    def times(self, lines: ArrayLike) -> Array:
        """Exposure (s from the epoch) of `lines` (N,), fractions allowed; outside at the end spacing."""
        places = np.atleast_1d(np.asarray(lines, dtype=np.float64))
        if self.line_times is None or self.lines < 2:
            return self.first_line_time + self.detector.line_period * places
        inside = interpolate(
            read_only(np.arange(float(self.lines))), self.line_times[:, np.newaxis], read_only(places)
        )[:, 0]
        ends = np.clip(places, 0.0, self.lines - 1.0)
        slope = np.where(places < 0, self.line_times[1] - self.line_times[0], 0.0)
        slope = np.where(places > ends, self.line_times[-1] - self.line_times[-2], slope)
        end = np.where(places < 0, self.line_times[0], self.line_times[-1])
        return np.where(slope > 0, end + slope * (places - ends), inside)

    def stages_of(self, pixels: Array) -> Array:
        """TDI stages (N,) of `pixels` (N, 2), fractions allowed, those of the nearest; 1 without TDI."""
        if self.stages is None:
            return np.ones(len(pixels))
        table = np.asarray(self.stages)
        line, column = np.rint(np.clip(np.nan_to_num(pixels), 0.0, np.array(table.shape) - 1.0)).T
        return np.asarray(table[line.astype(np.intp), column.astype(np.intp)], dtype=np.float64)

    def delays(self, pixels: Array) -> Array:
        """(N,) s from the time of a line to the middle of the stages of its `pixels` (N, 2)."""
        return _delay(self.stages_of(pixels), self.time_reference) * self.detector.line_period

    def integration(self, pixels: Array) -> Array:
        """(N,) s over which TDI averages the motion at `pixels` (N, 2); 0 without TDI.

        That of the boxcar that spreads as the middles of the stages do: each is an instant, as lines are.
        """
        return np.sqrt(self.stages_of(pixels) ** 2 - 1.0) * self.detector.line_period

    @cached_property
    def rough_columns(self) -> Array:
        """Columns beside which the line of sight steps: where CCDs meet, or stages change."""
        own = self.detector.rough_columns
        if self.stages is None:
            return own
        steps = np.flatnonzero((np.diff(np.asarray(self.stages), axis=1) != 0).any(axis=0))
        return frozen(np.union1d(own, np.union1d(steps, steps + 1)))

    @cached_property
    def stage_times(self) -> tuple[float, ...]:
        """s from the begin of a pixel's first stage to the end of its last, of all that occur; rising."""
        if self.stages is None:
            return ()
        return tuple(float(count) * self.detector.line_period for count in np.unique(self.stages))

    @cached_property
    def reach(self) -> tuple[float, float]:
        """s by which the stages of a line reach beyond its time, before and after it; 0 without TDI."""
        if self.stages is None:
            return 0.0, 0.0
        counts = np.unique(self.stages).astype(np.float64)
        middle, half = _delay(counts, self.time_reference), 0.5 * counts
        before, after = float(np.max(half - middle)), float(np.max(half + middle))
        return before * self.detector.line_period, after * self.detector.line_period

    @cached_property
    def middles(self) -> tuple[float, float]:
        """s from the time of a line to the middle of the stages of its pixels: the least and the most."""
        counts = np.ones(1) if self.stages is None else np.unique(self.stages).astype(np.float64)
        late = _delay(counts, self.time_reference) * self.detector.line_period
        return float(late.min()), float(late.max())

    @cached_property
    def _parts(self) -> tuple[tuple[float, PushbroomCamera], ...]:
        """Where pixels differ, or the time is not that of the middle: a camera for each number of stages."""
        if self.stages is None:
            return ()
        counts = np.unique(self.stages)
        if len(counts) == 1 and self.time_reference == "centre":
            return ()
        return tuple((float(count), self._part(float(count), self.detector)) for count in counts)

    def _part(self, count: float, detector: LineDetector) -> PushbroomCamera:
        """The camera whose every pixel has `count` stages, at the time of their middle."""
        periods = _delay(np.array(count), self.time_reference)
        late = float(periods) * detector.line_period
        return replace(
            self,
            detector=detector.adjusted(-float(periods)) if periods else detector,
            first_line_time=self.first_line_time + late,
            line_times=None if self.line_times is None else self.line_times + late,
            stages=int(count),
            time_reference="centre",
        )

    @cached_property
    def _stage_times(self) -> Array | None:
        """s from the middle of the stages to each; None without TDI, or where pixels differ (`_parts`)."""
        if self.stages is None or self._parts:
            return None
        count = int(np.asarray(self.stages)[0, 0])
        return read_only((np.arange(count) - (count - 1) / 2.0) * self.detector.line_period)

    @property
    def known_span(self) -> tuple[float, float]:
        """First and last time (s) at which trajectory and pointing are both known."""
        (begin, end), (first, last) = self.trajectory.span, self.pointing.span
        return max(begin, first), min(end, last)

    @cached_property
    def _table(self) -> PoseTable:
        """Poses at the whole lines that the trajectory covers, a few lines more than the image if it can."""
        places = np.arange(-_MARGIN_LINES, self.lines + _MARGIN_LINES)
        t = self.times(places)
        begin, end = self.known_span
        covered = np.flatnonzero((t >= begin - TIME_SLACK) & (t <= end + TIME_SLACK))
        if len(covered) == 0:
            raise SpanError(
                f"no line of the image is exposed inside the trajectory: lines 0 to {self.lines - 1} at "
                f"t = [{t[_MARGIN_LINES]:.6f}, {t[-_MARGIN_LINES - 1]:.6f}] s, trajectory span "
                f"[{begin:.6f}, {end:.6f}] s; check the epoch, `first_line_time` and `line_period` (s)"
            )
        first = int(places[covered[0]])
        lever_arm = as_vector(self.lever_arm, "lever_arm")
        return PoseTable.of(
            first,
            read_only(t[covered]),
            self.trajectory,
            self.pointing,
            lever_arm,
            self._stage_times,
            self.detector.pixel_step / self.detector.line_period,
        )

    @cached_property
    def _planes(self) -> Array:
        """(R, 4) the plane in which the detector line looks from each pose of the table, for `find_lines`."""
        detector, rows = self.detector, self._table.rows
        if not detector.is_straight:
            return read_only(np.empty((0, 4)))
        planes = scratch_array((len(rows), 4))
        (x, y), height = detector.axis, detector.curve[0, 1]
        for some in slices(len(rows), _AT_ONCE):
            planes[some, :3] = rows[some, :9].reshape(-1, 3, 3) @ np.array([-y, x, -height])
            planes[some, 3] = np.einsum("ni,ni->n", planes[some, :3], rows[some, 9:])
            let_go()
        return read_only(planes)

    def camera_tangents(self, points: ArrayLike, lines: ArrayLike) -> Array:
        """Where points would appear in the focal plane if it were exposed at given lines.

        Parameters
        ----------
        points : (N, 3)
            m, world axes.
        lines : (N,)
            When, as fractional lines of this image.

        Returns
        -------
        (N, 2)
            x/z and y/z in camera axes; NaN behind the camera.

        Raises
        ------
        SpanError
            A line falls outside the trajectory.
        """
        given = as_points(points)
        places = read_only(np.broadcast_to(np.asarray(lines, dtype=np.float64), (len(given),)))
        table = self._table
        self._check_lines(places)
        out = np.empty((len(given), 2))
        seen_tangents(given, places, table.rows, float(table.first), table.origin, out)
        return out

    @property
    def known_lines(self) -> tuple[float, float]:
        """First and last line (fractions) that have rays: half a line more than the trajectory covers."""
        if self._parts:
            known = [part.known_lines for _, part in self._parts]
            return max(low for low, _ in known), min(high for _, high in known)
        return self._table.first - _EDGE, self._table.last + _EDGE

    def rays(self, pixels: ArrayLike) -> Rays:
        """Half-lines along which pixels look.

        Parameters
        ----------
        pixels : (N, 2)
            (line, column), integers are pixel centres, fractions allowed. A little beyond the image too.

        Returns
        -------
        Rays
            NaN rows where a pixel is NaN.

        Raises
        ------
        SpanError
            A line is exposed outside the trajectory.
        """
        given = as_pixels(pixels)
        origins, directions = self._half_lines(given)
        t = np.full(len(given), np.nan)
        known = np.isfinite(given[:, 0])
        t[known] = self.times(given[known, 0])
        if self.stages is not None:
            t[known] += self.delays(given[known])
        return Rays(t, origins, directions)

    def _half_lines(self, pixels: Array) -> tuple[Array, Array]:
        """Origins and directions (N, 3) of checked `pixels`."""
        if self._parts:
            own = self.stages_of(pixels)
            origins, directions = np.empty((len(pixels), 3)), np.empty((len(pixels), 3))
            for count, part in self._parts:
                here = own == count
                origins[here], directions[here] = part._half_lines(pixels[here])
            return origins, directions
        table = self._table
        self._check_lines(pixels[:, 0])
        origins, directions = np.empty((len(pixels), 3)), np.empty((len(pixels), 3))
        line_rays(
            read_only(pixels),
            table.rows,
            float(table.first),
            table.origin,
            self.detector.tangents,
            origins,
            directions,
        )
        return origins, directions

    def _check_lines(self, lines: Array) -> None:
        """Raise SpanError when one of `lines` (N,) has no pose."""
        if len(lines) == 0:
            return
        low, high = self.known_lines
        least, most = float(np.fmin.reduce(lines)), float(np.fmax.reduce(lines))
        if not (least < low or most > high):
            return
        line = least if least < low else most
        t = float(self.times(line)[0])
        begin, end = self.known_span
        if begin <= t <= end:
            raise SpanError(
                f"line {line:.6g} lies outside the image of {self.lines} lines and the {_MARGIN_LINES} lines "
                f"around it that have rays; allowed are lines [{low:g}, {high:g}]; check (line, column) order"
            )
        side = "from" if t < begin else "up to"
        raise SpanError(
            f"line {line:.6g} is exposed at t = {t:.6f} s, outside the trajectory span "
            f"[{begin:.6f}, {end:.6f}] s; supply position, attitude and motion {side} {t:.6f} s "
            "or crop the image"
        )

    def locate(self, pixels: ArrayLike, surface: Surface) -> Array:
        """Ground points seen by pixels.

        Parameters
        ----------
        pixels : (N, 2)
            (line, column), integers are pixel centres, fractions allowed.
        surface : Surface
            What the rays meet.

        Returns
        -------
        (N, 3)
            m, world axes; a row is NaN where the ray misses the surface.

        Raises
        ------
        SpanError
            A line falls outside the trajectory.

        Notes
        -----
        S1, "modelo de localización", Loc(M(i, j)) = P.

        Examples
        --------
        The pixel under the boresight lands at the nadir:

        >>> from sightline.geometry.pointing import FixedMount
        >>> from sightline.geometry.surface import Plane
        >>> detector = LineDetector.from_ifov("PAN", 101, 1e-6, 1e-4)
        >>> flight = Trajectory.level_flight(700e3, 7e3, -1.0, 1.0)
        >>> camera = PushbroomCamera(detector, flight, FixedMount(), 0.0, 1000)
        >>> bool(abs(camera.locate([[0, 50]], Plane())).max() < 1e-6)
        True
        """
        origins, directions = self._half_lines(as_pixels(pixels))
        return surface.intersect(read_only(origins), read_only(directions))

    def project(self, points: ArrayLike, *, line_margin: float = 0.0) -> Array:
        """Pixels that see points.

        Parameters
        ----------
        points : (N, 3)
            m, world axes; NaN rows stay NaN.
        line_margin : float
            Also accept lines this far beyond the image, as far as the trajectory is known (at most 16).

        Returns
        -------
        (N, 2)
            (line, column), px; NaN where no line in [-0.5, lines - 0.5] sees the point. Columns may run 50 px
            beyond the detector, on its prolongation: compare with `shape` where that matters.

        Notes
        -----
        S1, Loc^-1. The line is where the point crosses the detector line in the tangent plane of the camera,
        to 1e-9 lines; then the column follows. A point that a rough motion shows more than once gets one of
        its pixels.
        """
        given = as_points(points)
        if self._parts:
            return self._project_parts(given, line_margin)
        pixels = np.empty((len(given), 2))
        table, detector = self._table, self.detector
        known = self.known_lines
        low = max(-_EDGE - line_margin, known[0])
        high = min(self.lines - 1 + _EDGE + line_margin, known[1])
        if not low < high:
            pixels[:] = np.nan
            return pixels
        find_lines(
            given,
            table.rows,
            float(table.first),
            table.origin,
            detector.axis,
            detector.curve,
            detector.is_straight,
            (low, high),
            (-COLUMN_MARGIN_PX, self.columns - 1 + COLUMN_MARGIN_PX),
            self._planes,
            pixels,
        )
        return pixels

    def _project_parts(self, points: Array, line_margin: float) -> Array:
        """Pixels (N, 2): of those that the numbers of stages give, the one whose pixel has as many.

        Where stages change, motion may show a point twice or not at all: one of the places about there.
        """
        out, least = np.full((len(points), 2), np.nan), np.full(len(points), np.inf)
        for count, part in self._parts:
            pixels = part.project(points, line_margin=line_margin)
            apart = np.where(np.isnan(pixels[:, 0]), np.inf, np.abs(self.stages_of(pixels) - count))
            better = apart < least
            out[better], least[better] = pixels[better], apart[better]
        return out

    def forget(self) -> None:
        """Give back the poses of all lines that are kept for speed; they are found again when needed."""
        for kept in ("_table", "_planes", "_parts"):
            self.__dict__.pop(kept, None)

    def with_trajectory(self, trajectory: Trajectory) -> PushbroomCamera:
        """The same camera carried along another trajectory."""
        return replace(self, trajectory=trajectory)

    def with_detector(self, detector: LineDetector) -> PushbroomCamera:
        """The same image with another detector (its poses are kept where the line times stay)."""
        other = replace(self, detector=detector)
        if "_table" in self.__dict__ and detector.line_period == self.detector.line_period:
            other.__dict__["_table"] = self._table
        if "_parts" in self.__dict__ and detector.line_period == self.detector.line_period:
            moved = ((count, self._part(count, detector).detector, part) for count, part in self._parts)
            other.__dict__["_parts"] = tuple((count, part.with_detector(d)) for count, d, part in moved)
        return other


def _delay(stages: Array, reference: str) -> Array:
    """Line periods from the time of a line to the middle of its stages."""
    return np.asarray(TIME_REFERENCES[reference] * (stages - 1.0) / 2.0)


@dataclass(frozen=True, eq=False)
class FrameCamera(ReadOnlyArrays):
    """One exposure of an area detector, all at once or line by line (rolling shutter).

    Attributes
    ----------
    detector : AreaDetector
        Size and lens.
    trajectory : Trajectory
        Position and attitude; one instant is enough without rolling shutter.
    pointing : Pointing
        How camera axes sit in the body.
    t : float
        s from the epoch, centre of the exposure; with a rolling shutter that of line 0.
    readout_time : float
        s from the exposure of line 0 to that of the last line; negative when read upwards.
    lever_arm : (3,)
        From the point whose positions are given to the entrance pupil, m, body axes.
    """

    detector: AreaDetector
    trajectory: Trajectory
    pointing: Pointing
    t: float
    readout_time: float = 0.0
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check."""
        finite(self.t, "t", "s")
        finite(self.readout_time, "readout_time", "s")
        as_vector(self.lever_arm, "lever_arm")

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns) of the image."""
        return self.detector.shape

    def times(self, lines: ArrayLike) -> Array:
        """Exposure (s from the epoch) of `lines` (N,), fractions allowed."""
        places = np.atleast_1d(np.asarray(lines, dtype=np.float64))
        return self.t + self.readout_time / max(self.shape[0] - 1, 1) * places

    @cached_property
    def _poses(self) -> tuple[Array, Array, Array]:
        """Lines (K,), world_from_camera (K, 9), positions (K, 3); K = 1 without rolling shutter."""
        lines = np.arange(float(self.shape[0])) if self.readout_time != 0.0 else np.zeros(1)
        t = self.times(lines)
        lever_arm = as_vector(self.lever_arm, "lever_arm")
        world_from_camera, position = camera_poses(t, self.trajectory, self.pointing, lever_arm)
        return read_only(lines), frozen(world_from_camera.reshape(-1, 9)), frozen(position)

    def _at(self, lines: Array) -> tuple[Array, Array]:
        """world_from_camera (N, 3, 3) and positions (N, 3) when `lines` (N,) are exposed."""
        nodes, matrices, positions = self._poses
        if len(nodes) == 1:
            return matrices.reshape(1, 3, 3), positions
        clipped = read_only(np.clip(np.nan_to_num(lines), nodes[0], nodes[-1]))
        return interpolate(nodes, matrices, clipped).reshape(-1, 3, 3), interpolate(nodes, positions, clipped)

    def rays(self, pixels: ArrayLike) -> Rays:
        """Half-lines along which `pixels` (N, 2), (line, column), look; NaN rows for NaN pixels."""
        given = as_pixels(pixels)
        world_from_camera, positions = self._at(given[:, 0])
        directions = np.einsum(
            "nij,nj->ni",
            np.broadcast_to(world_from_camera, (len(given), 3, 3)),
            self.detector.directions(given),
        )
        directions /= np.sqrt((directions**2).sum(axis=1, keepdims=True))
        origins = np.broadcast_to(positions, directions.shape).copy()
        origins[np.isnan(given).any(axis=1)] = np.nan
        return Rays(self.times(given[:, 0]), origins, directions)

    def locate(self, pixels: ArrayLike, surface: Surface) -> Array:
        """Points (N, 3) of `surface`, m, world axes, seen by `pixels` (N, 2); NaN row where a ray misses."""
        rays = self.rays(pixels)
        return surface.intersect(read_only(rays.origins), read_only(rays.directions))

    def project(self, points: ArrayLike) -> Array:
        """Pixels that see points.

        Parameters
        ----------
        points : (N, 3)
            m, world axes; NaN rows stay NaN.

        Returns
        -------
        (N, 2)
            (line, column), px; NaN behind the camera and more than 50 px outside the frame.
        """
        given = as_points(points)
        line = np.full(len(given), 0.5 * (self.shape[0] - 1))
        pixels = self._seen(given, line)
        if self.readout_time != 0.0:
            pixels = self._settle(given, line, pixels)
        limits = np.array(self.shape) - 1 + FRAME_MARGIN_PX
        with np.errstate(invalid="ignore"):
            outside = ~((pixels >= -FRAME_MARGIN_PX) & (pixels <= limits)).all(axis=1)
        pixels[outside] = np.nan
        return pixels

    def _seen(self, points: Array, lines: Array) -> Array:
        """Pixels of `points` with the pose that holds when `lines` (N,) are exposed."""
        world_from_camera, positions = self._at(lines)
        matrices = np.broadcast_to(world_from_camera, (len(points), 3, 3))
        return self.detector.pixels(np.einsum("nij,ni->nj", matrices, points - positions))

    def _settle(self, points: Array, line: Array, pixels: Array) -> Array:
        """Rolling shutter: the line that sees a point by the pose of that same line, by secant steps."""
        miss = pixels[:, 0] - line
        slope = np.full(len(line), -1.0)
        for _ in range(50):
            following = np.clip(line - miss / slope, -FRAME_MARGIN_PX, self.shape[0] - 1 + FRAME_MARGIN_PX)
            following = np.where(np.isfinite(following), following, line)
            pixels = self._seen(points, following)
            step, miss_now = following - line, pixels[:, 0] - following
            with np.errstate(divide="ignore", invalid="ignore"):
                measured = (miss_now - miss) / step
            slope = np.where((np.abs(step) > 1e-5) & (measured < -0.1) & (measured > -10.0), measured, slope)
            line, miss = following, miss_now
            if not (np.abs(step) > 1e-10).any():
                break
        pixels[~(np.abs(miss) < 1e-7)] = np.nan
        return pixels

    def with_trajectory(self, trajectory: Trajectory) -> FrameCamera:
        """The same camera carried along another trajectory."""
        return replace(self, trajectory=trajectory)

    def with_detector(self, detector: AreaDetector) -> FrameCamera:
        """The same exposure with another detector or lens."""
        return replace(self, detector=detector)
