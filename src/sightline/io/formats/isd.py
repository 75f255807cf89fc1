"""USGS CSM line-scan sensor models → PushbroomCamera: image support data (ISD) and model states.

An ISD holds positions and attitudes in J2000 and the rotation of the body; a model state holds
them in body-fixed axes already. Both describe the focal plane by an affine map to detector
pixels and a distortion.

Read: distortion "radial" (three coefficients), "lrolrocnac" (one), or none. Others are refused.
Not here: frame cameras and writing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.access import read_json
from sightline.errors import FormatError, reads
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.trajectory import Trajectory

Array = NDArray[np.float64]

#: The sensor model whose files are read.
MODEL_NAME = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
#: Names of the distortions in ISDs, with their number of coefficients.
DISTORTIONS = {"radial": 3, "lrolrocnac": 1}
#: Numbers of the distortions in model states (others are refused).
STATE_DISTORTIONS = {0: "radial", 4: "lrolrocnac"}
#: Lines and samples beyond which a file is damaged: no line scanner makes such images.
_MOST_LINES, _MOST_SAMPLES = 10_000_000, 1_000_000
#: m in the units of ISDs.
_UNITS = {"km": 1e3, "m": 1.0}
#: Lists of a model state that hold rows one after the other, and the length of these.
_FLAT = (("m_positions", 3), ("m_velocities", 3), ("m_quaternions", 4))
#: Stands for no default.
_NEEDED = object()


@dataclass(frozen=True, eq=False)
class LineScanModel:
    """A line-scan sensor model in our terms.

    Attributes
    ----------
    camera : PushbroomCamera
        World axes are body-fixed, t = 0 at `reference_et`.
    radii : (float, float)
        m; equatorial and polar radius of the body.
    reference_et : float
        s past J2000 (TDB), the instant t = 0.
    """

    camera: PushbroomCamera
    radii: tuple[float, float]
    reference_et: float


@dataclass(frozen=True, eq=False)
class _FocalPlane:
    """Where detector pixels lie behind the lens (mm), after CSM."""

    focal_length: float
    pixel_from_x: tuple[Array, Array]
    centre: tuple[float, float]
    starting: tuple[float, float]
    sample_summing: float
    distortion: str
    coefficients: Array

    def directions(self, samples: int) -> Array:
        """(samples, 3) looking directions of image columns 0, 1, ... in sensor axes, z = 1.

        CSM counts the centre of the first image pixel as 0.5; the detector line of a line scanner is the
        starting one, and its origin and affine lead to the focal plane.
        """
        sample = (np.arange(samples) + 0.5) * self.sample_summing + self.starting[1] - self.centre[1]
        line = np.full(samples, self.starting[0] - self.centre[0])
        by_line, by_sample = self.pixel_from_x
        matrix = np.array([by_line[1:], by_sample[1:]])
        x, y = np.linalg.solve(matrix, np.stack([line - by_line[0], sample - by_sample[0]]))
        x, y = self._undistorted(x, y)
        return np.column_stack([x / self.focal_length, y / self.focal_length, np.ones(samples)])

    def _undistorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Focal-plane coordinates (mm) without the lens' distortion."""
        k = self.coefficients
        if self.distortion == "radial":
            r2 = x**2 + y**2
            shrink = 1.0 - (k[0] + r2 * (k[1] + r2 * k[2]))
            return x * shrink, y * shrink
        if self.distortion == "lrolrocnac":
            return x, y / (1.0 + k[0] * y**2)
        return x, y


@dataclass(frozen=True, eq=False)
class _Motion:
    """Positions and attitudes in body-fixed axes; times in s past J2000."""

    t_position: Array
    position: Array
    velocity: Array
    t_attitude: Array
    world_from_sensor: Rotation


@reads("a line-scan sensor model")
def read_line_scan_model(path: Path, reference_et: float | None = None) -> LineScanModel:
    """A USGS CSM line-scan ISD or model state.

    Parameters
    ----------
    path : Path
        JSON; a model state may be preceded by a line with the model's name.
    reference_et : float, optional
        s past J2000 that become t = 0; the start of the image if not given.

    Returns
    -------
    LineScanModel

    Raises
    ------
    FormatError
        Names the file and the key; says which distortions are read.

    Notes
    -----
    Body axes are chosen by what the sensor does: z along its boresight, x across its row of pixels to
    the side it flies. Columns may then increase to the left or to the right.
    """
    data = _Keys(path, _load(path))
    if any(key.startswith("m_") for key in data.values):
        return _assemble(
            _state_motion(data, path), _state_plane(data, path), _state_timing(data), reference_et
        )
    return _assemble(_isd_motion(data, path), _isd_plane(data, path), _isd_timing(data), reference_et)


def _load(path: Path) -> dict[str, Any]:
    """The JSON of the file, checked to be of our model."""
    data = read_json(path, "an ISD or model state", advice="check the name in the TOML file", before="{")
    name = data.get("name_model", data.get("m_modelName")) if isinstance(data, dict) else None
    if name != MODEL_NAME:
        raise FormatError(f"{path}: is of model {name!r}; {MODEL_NAME} is read")
    return dict(data)


@dataclass(frozen=True, eq=False)
class _Keys:
    """The values of the file, by names of keys with a dot between a table and its key."""

    path: Path
    values: dict[str, Any]

    def refused(self, key: str, why: str) -> FormatError:
        """The error of a key that is not as it should be."""
        return FormatError(
            f"{self.path}: the key {key!r} {why}; a line-scan ISD or model state of {MODEL_NAME} is expected"
        )

    def value(self, key: str, default: Any = _NEEDED) -> Any:
        """What a key holds."""
        inner: Any = self.values
        names = key.split(".")
        for depth, name in enumerate(names, 1):
            if not isinstance(inner, dict) or name not in inner:
                if default is _NEEDED:
                    raise self.refused(".".join(names[:depth]), "is missing")
                return default
            inner = inner[name]
        return inner

    def array(self, key: str, *shape: int) -> Array:
        """Finite numbers of a shape; -1 stands for any length of 1 or more."""
        try:
            array = np.array(self.value(key), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise self.refused(key, "does not hold numbers, as many in every row") from None
        if not np.isfinite(array).all():
            raise self.refused(key, "holds what is no finite number")
        fits = len(array.shape) == len(shape) and all(
            size == want or (want < 0 and size > 0) for size, want in zip(array.shape, shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if want < 0 else str(want) for want in shape) or "one number"
            raise self.refused(key, f"is of shape {list(array.shape)}, not {wanted}")
        return array

    def number(self, key: str) -> float:
        """A finite number."""
        return float(self.array(key))

    def positive(self, key: str) -> float:
        """A number above 0."""
        number = self.number(key)
        if number <= 0.0:
            raise self.refused(key, f"is {number:g}, not above 0")
        return number

    def count(self, key: str, least: int, most: int) -> int:
        """A whole number."""
        number = self.number(key)
        if number != round(number) or not least <= number <= most:
            raise self.refused(key, f"is {number:g}, no whole number from {least} to {most:,}")
        return int(number)

    def times(self, key: str) -> Array:
        """Instants (n,) s that increase."""
        t = self.array(key, -1)
        if (np.diff(t) <= 0.0).any():
            raise self.refused(key, "does not increase")
        return t

    def rows(self, table: str, key: str, width: int, times: Array) -> Array:
        """Rows of a table, one for each of its instants."""
        rows = self.array(f"{table}.{key}", -1, width)
        if len(rows) != len(times):
            raise self.refused(
                f"{table}.{key}", f"has {len(rows)} rows, {table}.ephemeris_times {len(times)}"
            )
        return rows


@dataclass(frozen=True, eq=False)
class _Timing:
    """Size of the image and when its lines are exposed; radii of the body."""

    lines: int
    samples: int
    rates: Array
    centre_et: float
    radii: tuple[float, float]

    def line_times(self) -> Array:
        """(lines,) s past J2000; centre of exposure.

        Rows of the rate table: first line (0.5 is the first), start relative to the centre time, period.
        """
        line = np.arange(self.lines) + 0.5
        row = np.clip(np.searchsorted(self.rates[:, 0], line, side="right") - 1, 0, None)
        first, start, period = self.rates[row].T
        return np.asarray(self.centre_et + start + period * (line - first + 0.5))


def _isd_timing(data: _Keys) -> _Timing:
    """Timing of an ISD."""
    unit = _metres(data, "radii.unit")
    return _Timing(
        data.count("image_lines", 2, _MOST_LINES),
        data.count("image_samples", 2, _MOST_SAMPLES),
        data.array("line_scan_rate", -1, 3),
        data.number("center_ephemeris_time"),
        (data.positive("radii.semimajor") * unit, data.positive("radii.semiminor") * unit),
    )


def _state_timing(data: _Keys) -> _Timing:
    """Timing of a model state."""
    lines = data.array("m_intTimeLines", -1)
    rates = [data.array(key, len(lines)) for key in ("m_intTimeStartTimes", "m_intTimes")]
    return _Timing(
        data.count("m_nLines", 2, _MOST_LINES),
        data.count("m_nSamples", 2, _MOST_SAMPLES),
        np.column_stack([lines, *rates]),
        data.number("m_centerEphemerisTime"),
        (data.positive("m_majorAxis"), data.positive("m_minorAxis")),
    )


def _metres(data: _Keys, key: str) -> float:
    """Metres in the unit of length that a key names."""
    unit = data.value(key, "km")
    if not isinstance(unit, str) or unit.lower() not in _UNITS:
        raise data.refused(key, f"is {str(unit)[:40]!r}, none of {', '.join(_UNITS)}")
    return _UNITS[unit.lower()]


def _isd_plane(data: _Keys, path: Path) -> _FocalPlane:
    """Focal plane of an ISD."""
    distortion = data.value("optical_distortion", None) or {}
    if not isinstance(distortion, dict):
        raise data.refused("optical_distortion", "is no table")
    name = next(iter(distortion), "none")
    if name != "none" and name not in DISTORTIONS:
        raise FormatError(
            f"{path}: optical_distortion {name!r} is not read; {', '.join(DISTORTIONS)} or none are"
        )
    coefficients = np.empty(0)
    if name != "none":
        coefficients = _coefficients(data, f"optical_distortion.{name}.coefficients")
    _check_coefficients(path, name, coefficients)
    return _FocalPlane(
        data.positive("focal_length_model.focal_length"),
        (data.array("focal2pixel_lines", 3), data.array("focal2pixel_samples", 3)),
        (data.number("detector_center.line"), data.number("detector_center.sample")),
        (data.number("starting_detector_line"), data.number("starting_detector_sample")),
        data.positive("detector_sample_summing"),
        name,
        coefficients,
    )


def _coefficients(data: _Keys, key: str) -> Array:
    """A number or a list of them, which may be empty."""
    given = data.value(key)
    if isinstance(given, list):
        return data.array(key, len(given))
    return np.atleast_1d(data.array(key))


def _state_plane(data: _Keys, path: Path) -> _FocalPlane:
    """Focal plane of a model state."""
    number = data.count("m_distortionType", 0, 1000)
    if number not in STATE_DISTORTIONS:
        raise FormatError(
            f"{path}: m_distortionType {number} is not read; "
            f"{', '.join(f'{n} ({name})' for n, name in STATE_DISTORTIONS.items())} are"
        )
    coefficients = _coefficients(data, "m_opticalDistCoeffs")
    _check_coefficients(path, STATE_DISTORTIONS[number], coefficients)
    adjusted = data.value("m_currentParameterValue", None) is not None
    if adjusted and _coefficients(data, "m_currentParameterValue").any():
        raise FormatError(
            f"{path}: m_currentParameterValue holds adjustments, which are not read; apply them first"
        )
    return _FocalPlane(
        data.positive("m_focalLength"),
        (data.array("m_iTransL", 3), data.array("m_iTransS", 3)),
        (data.number("m_detectorLineOrigin"), data.number("m_detectorSampleOrigin")),
        (data.number("m_startingDetectorLine"), data.number("m_startingDetectorSample")),
        data.positive("m_detectorSampleSumming"),
        STATE_DISTORTIONS[number],
        coefficients,
    )


def _check_coefficients(path: Path, name: str, coefficients: Array) -> None:
    """A distortion must have its number of coefficients."""
    if len(coefficients) != DISTORTIONS.get(name, 0):
        raise FormatError(
            f"{path}: distortion {name!r} has {len(coefficients)} coefficients; {DISTORTIONS.get(name, 0)} "
            f"are expected"
        )


def _scalar_first(data: _Keys, name: str, times: Array) -> Rotation:
    """Rotations of an ISD's table: scalar-first quaternions, then the constant rotation."""
    quaternions = data.rows(name, "quaternions", 4, times)
    if (np.linalg.norm(quaternions, axis=1) == 0.0).any():
        raise data.refused(f"{name}.quaternions", "holds one of length 0")
    turning = Rotation.from_quat(quaternions, scalar_first=True)
    if data.value(f"{name}.constant_rotation", None) is None:
        return turning
    constant = data.array(f"{name}.constant_rotation", 9).reshape(3, 3)
    return Rotation.from_matrix(constant) * turning


def _isd_motion(data: _Keys, path: Path) -> _Motion:
    """Positions and attitudes of an ISD, turned from J2000 into body-fixed axes.

    ``body_rotation`` is body-fixed from J2000, ``instrument_pointing`` sensor from J2000; the body turns
    evenly (slerp) between the instants given for it.
    """
    for name in ("body_rotation", "instrument_pointing", "instrument_position"):
        frame = data.value(f"{name}.reference_frame", 1)
        if frame != 1:
            raise FormatError(f"{path}: {name} has reference_frame {frame!r:.40}; 1 (J2000) is read")
    t_body, t_pointing, t_place = (
        data.times(f"{name}.ephemeris_times")
        for name in ("body_rotation", "instrument_pointing", "instrument_position")
    )
    if len(t_body) == 1:
        raise FormatError(f"{path}: body_rotation has one instant; two or more are needed")
    fixed = _scalar_first(data, "body_rotation", t_body)
    turning = Slerp(t_body - t_body[0], fixed)
    unit = _metres(data, "instrument_position.unit")
    inertial = unit * data.rows("instrument_position", "positions", 3, t_place)
    inertial_rate = unit * data.rows("instrument_position", "velocities", 3, t_place)
    there = turning(np.clip(t_place - t_body[0], 0.0, t_body[-1] - t_body[0]))
    steps = (fixed[:-1].inv() * fixed[1:]).as_rotvec() / np.diff(t_body)[:, None]
    spin = steps[np.clip(np.searchsorted(t_body, t_place, side="right") - 1, 0, len(steps) - 1)]
    # fixed(t + dt) = fixed(t) * exp(spin dt): a point at rest in J2000 drifts by spin x in body axes
    velocity = there.apply(inertial_rate + np.cross(spin, inertial))
    then = turning(np.clip(t_pointing - t_body[0], 0.0, t_body[-1] - t_body[0]))
    sensor = _scalar_first(data, "instrument_pointing", t_pointing)
    return _Motion(t_place, there.apply(inertial), velocity, t_pointing, then * sensor.inv())


def _state_motion(data: _Keys, path: Path) -> _Motion:
    """Positions and attitudes of a model state: evenly spaced, body-fixed, quaternions scalar last."""
    flat = [(key, size, data.array(key, -1)) for key, size in _FLAT]
    for key, size, values in flat:
        if len(values) % size:
            raise data.refused(key, f"holds {len(values)} numbers, no rows of {size}")
    position, velocity, quaternions = (values.reshape(-1, size) for _, size, values in flat)
    if (np.linalg.norm(quaternions, axis=1) == 0.0).any():
        raise data.refused("m_quaternions", "holds one of length 0")
    centre = data.number("m_centerEphemerisTime")
    t_position = _evenly(centre + data.number("m_t0Ephem"), data.positive("m_dtEphem"), len(position))
    t_attitude = _evenly(centre + data.number("m_t0Quat"), data.positive("m_dtQuat"), len(quaternions))
    if len(position) != len(velocity):
        raise FormatError(
            f"{path}: {len(position)} positions and {len(velocity)} velocities; one of each is expected"
        )
    return _Motion(t_position, position, velocity, t_attitude, Rotation.from_quat(quaternions))


def _evenly(start: float, step: float, count: int) -> Array:
    """`count` instants `step` apart."""
    return np.asarray(start + step * np.arange(count), dtype=np.float64)


def _assemble(
    motion: _Motion, plane: _FocalPlane, timing: _Timing, reference_et: float | None
) -> LineScanModel:
    """The camera: body axes chosen, directions turned into camera axes, times counted from the reference."""
    line_times = timing.line_times()
    reference = float(line_times[0]) if reference_et is None else reference_et
    sensor_directions = plane.directions(timing.samples)
    body_from_sensor = _body_axes(sensor_directions, motion)
    camera_from_sensor = NADIR_MOUNT.inv() * body_from_sensor
    directions = camera_from_sensor.apply(sensor_directions)
    t = line_times - reference
    period = float((t[-1] - t[0]) / (len(t) - 1))
    even = len(timing.rates) == 1
    trajectory = Trajectory(
        motion.t_position - reference,
        motion.position,
        motion.t_attitude - reference,
        motion.world_from_sensor * body_from_sensor.inv(),
        velocity=motion.velocity,
    )
    camera = PushbroomCamera(
        LineDetector("model", directions / np.linalg.norm(directions, axis=1)[:, None], period),
        trajectory,
        FixedMount(),
        float(t[0]),
        timing.lines,
        line_times=None if even else t,
    )
    return LineScanModel(camera, timing.radii, reference)


def _body_axes(directions: Array, motion: _Motion) -> Rotation:
    """body_from_sensor: z kept, x across the row of pixels on the side the sensor flies to."""
    row = directions[-1, :2] - directions[0, :2]
    across = np.array([-row[1], row[0], 0.0]) / np.linalg.norm(row)
    middle = len(motion.t_attitude) // 2
    near = int(np.argmin(np.abs(motion.t_position - motion.t_attitude[middle])))
    flight = motion.world_from_sensor[middle].inv().apply(motion.velocity[near])
    forward = across if flight @ across > 0.0 else -across
    down = np.array([0.0, 0.0, 1.0])
    return Rotation.from_matrix(np.array([forward, np.cross(down, forward), down]))
