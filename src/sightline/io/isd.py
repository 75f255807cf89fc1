"""USGS CSM line-scan sensor models → PushbroomCamera: image support data (ISD) and model states.

An ISD holds positions and attitudes in J2000 and the rotation of the body; a model state holds
them in body-fixed axes already. Both describe the focal plane by an affine map to detector
pixels and a distortion.

Read: distortion "radial" (three coefficients), "lrolrocnac" (one), or none. Others are refused.
Not here: frame cameras and writing.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError
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
    data = _load(path)
    try:
        if any(key.startswith("m_") for key in data):
            return _assemble(
                _state_motion(data, path), _state_plane(data, path), _state_timing(data), reference_et
            )
        return _assemble(_isd_motion(data, path), _isd_plane(data, path), _isd_timing(data), reference_et)
    except (KeyError, IndexError, TypeError) as error:
        raise FormatError(
            f"{path}: the key {error} is missing or not of the expected form; "
            f"a line-scan ISD or model state of {MODEL_NAME} is expected"
        ) from None


def _load(path: Path) -> dict[str, Any]:
    """The JSON of the file, checked to be of our model."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file; check the name in the TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(
            f"{path}: cannot be read as text ({error}); a JSON sensor model is expected"
        ) from None
    start = text.find("{")
    try:
        data = json.loads(text[max(start, 0) :])
    except json.JSONDecodeError as error:
        raise FormatError(f"{path}: not valid JSON ({error}); an ISD or model state is expected") from None
    name = data.get("name_model", data.get("m_modelName")) if isinstance(data, dict) else None
    if name != MODEL_NAME:
        raise FormatError(f"{path}: is of model {name!r}; {MODEL_NAME} is read")
    return dict(data)


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


def _isd_timing(data: dict[str, Any]) -> _Timing:
    """Timing of an ISD."""
    radii = data["radii"]
    unit = _metres(radii.get("unit", "km"))
    return _Timing(
        int(data["image_lines"]),
        int(data["image_samples"]),
        np.array(data["line_scan_rate"], dtype=np.float64),
        float(data["center_ephemeris_time"]),
        (radii["semimajor"] * unit, radii["semiminor"] * unit),
    )


def _state_timing(data: dict[str, Any]) -> _Timing:
    """Timing of a model state."""
    rates = np.column_stack([data["m_intTimeLines"], data["m_intTimeStartTimes"], data["m_intTimes"]])
    return _Timing(
        int(data["m_nLines"]),
        int(data["m_nSamples"]),
        np.asarray(rates, dtype=np.float64),
        float(data["m_centerEphemerisTime"]),
        (float(data["m_majorAxis"]), float(data["m_minorAxis"])),
    )


def _metres(unit: str) -> float:
    """Metres in a unit of length."""
    return 1e3 if unit.lower() == "km" else 1.0


def _isd_plane(data: dict[str, Any], path: Path) -> _FocalPlane:
    """Focal plane of an ISD."""
    distortion = data.get("optical_distortion") or {}
    name = next(iter(distortion), "none")
    if name != "none" and name not in DISTORTIONS:
        raise FormatError(
            f"{path}: optical_distortion {name!r} is not read; {', '.join(DISTORTIONS)} or none are"
        )
    coefficients = np.atleast_1d(
        np.asarray(distortion[name]["coefficients"] if name != "none" else [], dtype=float)
    )
    _check_coefficients(path, name, coefficients)
    return _FocalPlane(
        float(data["focal_length_model"]["focal_length"]),
        (
            np.array(data["focal2pixel_lines"], dtype=float),
            np.array(data["focal2pixel_samples"], dtype=float),
        ),
        (float(data["detector_center"]["line"]), float(data["detector_center"]["sample"])),
        (float(data["starting_detector_line"]), float(data["starting_detector_sample"])),
        float(data["detector_sample_summing"]),
        name,
        coefficients,
    )


def _state_plane(data: dict[str, Any], path: Path) -> _FocalPlane:
    """Focal plane of a model state."""
    number = int(data["m_distortionType"])
    coefficients = np.atleast_1d(np.asarray(data["m_opticalDistCoeffs"], dtype=float))
    if number not in STATE_DISTORTIONS:
        raise FormatError(
            f"{path}: m_distortionType {number} is not read; "
            f"{', '.join(f'{n} ({name})' for n, name in STATE_DISTORTIONS.items())} are"
        )
    _check_coefficients(path, STATE_DISTORTIONS[number], coefficients)
    if np.any(np.asarray(data.get("m_currentParameterValue", 0.0)) != 0.0):
        raise FormatError(
            f"{path}: m_currentParameterValue holds adjustments, which are not read; apply them first"
        )
    return _FocalPlane(
        float(data["m_focalLength"]),
        (np.array(data["m_iTransL"], dtype=float), np.array(data["m_iTransS"], dtype=float)),
        (float(data["m_detectorLineOrigin"]), float(data["m_detectorSampleOrigin"])),
        (float(data["m_startingDetectorLine"]), float(data["m_startingDetectorSample"])),
        float(data["m_detectorSampleSumming"]),
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


def _scalar_first(table: dict[str, Any]) -> Rotation:
    """Rotations of an ISD's table: scalar-first quaternions, then the constant rotation."""
    turning = Rotation.from_quat(np.array(table["quaternions"], dtype=float), scalar_first=True)
    if "constant_rotation" not in table:
        return turning
    return Rotation.from_matrix(np.array(table["constant_rotation"], dtype=float).reshape(3, 3)) * turning


def _isd_motion(data: dict[str, Any], path: Path) -> _Motion:
    """Positions and attitudes of an ISD, turned from J2000 into body-fixed axes.

    ``body_rotation`` is body-fixed from J2000, ``instrument_pointing`` sensor from J2000; the body turns
    evenly (slerp) between the instants given for it.
    """
    body, pointing, place = data["body_rotation"], data["instrument_pointing"], data["instrument_position"]
    for name, table in (
        ("body_rotation", body),
        ("instrument_pointing", pointing),
        ("instrument_position", place),
    ):
        if table.get("reference_frame", 1) != 1:
            raise FormatError(
                f"{path}: {name} has reference_frame {table['reference_frame']}; 1 (J2000) is read"
            )
    t_body = np.array(body["ephemeris_times"], dtype=float)
    fixed = _scalar_first(body)
    if len(t_body) == 1:
        raise FormatError(f"{path}: body_rotation has one instant; two or more are needed")
    turning = Slerp(t_body - t_body[0], fixed)
    t_place = np.array(place["ephemeris_times"], dtype=float)
    t_pointing = np.array(pointing["ephemeris_times"], dtype=float)
    unit = _metres(place.get("unit", "km"))
    inertial = unit * np.array(place["positions"], dtype=float)
    inertial_rate = unit * np.array(place["velocities"], dtype=float)
    there = turning(np.clip(t_place - t_body[0], 0.0, t_body[-1] - t_body[0]))
    steps = (fixed[:-1].inv() * fixed[1:]).as_rotvec() / np.diff(t_body)[:, None]
    spin = steps[np.clip(np.searchsorted(t_body, t_place, side="right") - 1, 0, len(steps) - 1)]
    # fixed(t + dt) = fixed(t) * exp(spin dt): a point at rest in J2000 drifts by spin x in body axes
    velocity = there.apply(inertial_rate + np.cross(spin, inertial))
    then = turning(np.clip(t_pointing - t_body[0], 0.0, t_body[-1] - t_body[0]))
    return _Motion(t_place, there.apply(inertial), velocity, t_pointing, then * _scalar_first(pointing).inv())


def _state_motion(data: dict[str, Any], path: Path) -> _Motion:
    """Positions and attitudes of a model state: evenly spaced, body-fixed, quaternions scalar last."""
    position = np.array(data["m_positions"], dtype=float).reshape(-1, 3)
    velocity = np.array(data["m_velocities"], dtype=float).reshape(-1, 3)
    quaternions = np.array(data["m_quaternions"], dtype=float).reshape(-1, 4)
    centre = float(data["m_centerEphemerisTime"])
    t_position = _evenly(centre + float(data["m_t0Ephem"]), float(data["m_dtEphem"]), len(position))
    t_attitude = _evenly(centre + float(data["m_t0Quat"]), float(data["m_dtQuat"]), len(quaternions))
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
