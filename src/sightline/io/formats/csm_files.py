"""A pushbroom camera → a USGS CSM model state or ISD of a line scanner.

The sensor's axes are those of the camera: x towards increasing columns, y towards increasing lines, z to the
scene. What bends the detector line becomes the distortion of CSM that comes nearest: radial about a centre of
its own (cahvor), transverse, or that of Kaguya's cameras (kaguyalism).

Not here: reading them (``isd.py``, ``focal_plane.py``).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation

from sightline.applications.export import LineStates
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.io.formats.csm_keys import LINE_SCANNER
from sightline.io.formats.focal_plane import DISTORTIONS, CsmFocalPlane
from sightline.io.formats.line_scan import one_side
from sightline.io.names import json_printable

Array = NDArray[np.float64]

#: mm; of a detector pixel: only its ratio to the focal length is known, and matters.
PITCH = 0.01
#: px up to which a straight and even line stands for a detector, before distortions are tried.
_STRAIGHT = 1e-5
#: px to which a distortion meets a line well enough to look no further.
_MET = 1e-4
#: px that the search for a radial lens may leave, before it starts from a steep one.
_STEEP = 1e-3
#: Pixels from which the search for a corner in a distortion starts.
_ORIGINS = 65
#: Distances from the line, in its lengths, from which the search for that point starts; times that the tilt
#: of the line is found anew; evaluations of each search.
_ASIDES, _TILTS, _STEPS = (-0.1, 0.1), 3, 60
#: Parameters by which a state can be adjusted.
_PARAMETERS = 16
#: m; heights that are allowed, of Earth's lowest and highest land.
_ELEVATIONS = (-11000.0, 9000.0)


@dataclass(frozen=True)
class CsmNames:
    """What a file says of whom it is of.

    Attributes
    ----------
    image, sensor, platform : str
    """

    image: str
    sensor: str
    platform: str


@dataclass(frozen=True, eq=False)
class CsmTiming:
    """When lines are exposed, for CSM.

    Attributes
    ----------
    centre_et : float
        s past J2000 (TDB); middle of the image.
    rows : list of (float, float, float)
        Line from which it holds (0.5 is the begin of the first), time of that from the centre (s), s from
        line to line.
    """

    centre_et: float
    rows: list[tuple[float, float, float]]


def csm_timing(camera: PushbroomCamera, et: float) -> CsmTiming:
    """Times of a camera's lines; `et` is t = 0 in s past J2000 (TDB)."""
    t, period = camera.times([0.0, camera.lines - 1.0]), camera.detector.line_period
    centre = 0.5 * float(t[0] + t[1])
    if camera.line_times is None:
        return CsmTiming(et + centre, [(0.5, float(t[0]) - 0.5 * period - centre, period)])
    times = np.asarray(camera.line_times)
    steps = np.append(np.diff(times), period if len(times) == 1 else times[-1] - times[-2])
    rows = zip(np.arange(len(times)) + 0.5, times - 0.5 * steps - centre, steps, strict=True)
    return CsmTiming(et + centre, [(float(a), float(b), float(c)) for a, b, c in rows])


def nearest_plane(detector: LineDetector) -> tuple[CsmFocalPlane, float]:
    """The focal plane of CSM nearest to a detector line, and px by which they differ at most."""
    x, y = detector.tangents.T
    sample = np.arange(detector.columns) + 0.5
    slope, start = np.polyfit(sample, x, 1)
    tilt, level = np.polyfit(x, y, 1)
    focal = PITCH / slope  # slopes are positive: x grows with columns, or the camera would be mirrored
    even = CsmFocalPlane(
        float(abs(focal)),
        np.array([0.0, -tilt / PITCH, 1.0 / PITCH]),
        np.array([0.0, float(np.sign(focal)) / PITCH, 0.0]),
        (float(-level * abs(focal) / PITCH), float(-start / slope)),
        (0.0, 0.0),
        distortion="radial",
        coefficients=np.zeros(3),
    )
    found = [(even, _apart(even, detector))]
    for plane in _curved(even, detector) if found[0][1] > _STRAIGHT else ():
        found.append((plane, _apart(plane, detector)))
        if found[-1][1] < _MET:
            break
    return min(found, key=lambda pair: pair[1])


def along_samples(camera: PushbroomCamera, states: LineStates) -> tuple[LineDetector, LineStates]:
    """The detector line of a camera with x along it, and its states in these axes.

    A line that runs along y more than along x has its sensor axes turned by a quarter about z: CSM then holds
    it as any other.
    """
    detector = camera.detector
    run = np.abs(detector.tangents[-1] - detector.tangents[0])
    if run[1] <= run[0]:
        return detector, states
    x, y, z = detector.directions.T
    quarter = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi])
    turned = replace(detector, directions=np.column_stack([y, -x, z]))
    return turned, replace(states, world_from_camera=states.world_from_camera * quarter)


def _curved(even: CsmFocalPlane, detector: LineDetector) -> Iterator[CsmFocalPlane]:
    """Focal planes with the distortions that may stand for a line that is not even."""
    yield _cahvor(even, detector)
    yield _transverse(even, detector)
    yield _kaguyalism(even, detector)


def _apart(plane: CsmFocalPlane, detector: LineDetector) -> float:
    """px by which a focal plane and a detector differ at most."""
    looks = plane.row(detector.columns)[:, :2] - detector.tangents
    return float(np.hypot(*looks.T).max() / detector.pixel_step)


def _changed(even: CsmFocalPlane, **changes: Any) -> CsmFocalPlane:
    return CsmFocalPlane(**{**vars(even), **changes})


def _cahvor(even: CsmFocalPlane, detector: LineDetector) -> CsmFocalPlane:
    """Radial distortion about a centre of its own: all that shifts and scales of a radial line lead to."""
    wanted = detector.tangents * even.focal_length
    reach = float(np.abs(wanted).max())
    scale = np.array([1.0, 1.0, 1e-3, 1e-3 / reach**2, 1e-3 / reach**4, PITCH, PITCH, 1e-3 / PITCH])

    def plane(values: Array) -> CsmFocalPlane:
        shift = values * scale
        centre = even.centre[0] + shift[0], even.centre[1] + shift[1]
        lines = even.lines_from_x + np.array([0.0, shift[7], 0.0])
        return _changed(even, lines_from_x=lines, centre=centre, distortion="cahvor", coefficients=shift[2:7])

    def missing(values: Array) -> Array:
        looks = plane(values).row(detector.columns)[:, :2] * even.focal_length
        return np.asarray((looks - wanted).ravel() / PITCH)

    def fit(start: Array) -> CsmFocalPlane:
        return plane(least_squares(missing, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x)

    near = fit(np.zeros(8))
    if _apart(near, detector) <= _STEEP:
        return near
    # a lens that bends the line by much of its length: from where the line is odd about the axis
    samples = np.arange(detector.columns) + np.float64(0.5)

    def odd_about(origin: float) -> tuple[Array, float]:
        x, y = _changed(even, centre=(even.centre[0], origin)).mm(np.zeros(len(samples)), samples)
        r2 = x * x + y * y
        terms = np.column_stack([x, x * r2, x * r2**2])
        sizes = np.abs(terms).max(axis=0)
        found, *_ = np.linalg.lstsq(terms / sizes, wanted[:, 0], rcond=None)
        return found / sizes, float((((terms / sizes) @ found - wanted[:, 0]) ** 2).sum())

    def aside(origin: float, keep: Array) -> float:
        """Detector lines from the axis to the line: its tangents along y are as much, times what x keeps."""
        x, _ = _changed(even, centre=(even.centre[0], origin)).mm(np.zeros(len(samples)), samples)
        kept = np.stack([np.ones(len(x)), x**2, x**4], axis=1) @ keep
        return float((kept @ wanted[:, 1]) / (kept @ kept)) / PITCH

    # the axis may lie beside the image
    coarse = np.linspace(-1.0, 2.0, 3 * _ORIGINS) * detector.columns
    best = int(np.argmin([odd_about(origin)[1] for origin in coarse]))
    bounds = coarse[max(best - 1, 0)], coarse[min(best + 1, 3 * _ORIGINS - 1)]
    origin = float(minimize_scalar(lambda at: odd_about(at)[1], bounds=bounds, method="bounded").x)
    keep = odd_about(origin)[0]
    at = -aside(origin, keep) - even.centre[0], origin - even.centre[1]
    lens = np.array([1.0, 0.0, 0.0]) - keep
    far = fit(np.concatenate([at, lens, [0.0, 0.0, -even.lines_from_x[1]]]) / scale)
    return min(near, far, key=lambda one: _apart(one, detector))


def _kaguyalism(even: CsmFocalPlane, detector: LineDetector) -> CsmFocalPlane:
    """Cubics in the distance from a point that is searched for: a line through it has a corner there.

    With x along the line from where it is nearest to the point: tangents are linear in 1, x, and r, r^2, r^3,
    r = |(x, aside + tilt x)|.
    """
    samples: Array = np.arange(detector.columns) + np.float64(0.5)
    side = float(np.sign(even.samples_from_x[1]))

    def fitted(origin: float, aside: float, tilt: float) -> tuple[Array, Array]:
        x = PITCH * (samples - origin) * side
        terms = np.column_stack([x, np.hypot(x, aside + tilt * x)[:, None] ** np.arange(4)])
        sizes = np.abs(terms).max(axis=0)
        found = np.linalg.lstsq(terms / sizes, detector.tangents, rcond=None)[0]
        left = (terms / sizes) @ found - detector.tangents
        return found / sizes[:, None], np.asarray(left.ravel() / detector.pixel_step)

    def left_at(origin: float) -> float:
        return float((fitted(origin, 0.0, 0.0)[1] ** 2).sum())

    coarse = np.linspace(0.0, detector.columns, _ORIGINS)
    best = int(np.argmin([left_at(origin) for origin in coarse]))
    near = coarse[max(best - 1, 0)], coarse[min(best + 1, _ORIGINS - 1)]
    origin = float(minimize_scalar(left_at, bounds=near, method="bounded", options={"xatol": 1e-9}).x)
    tilt = _tilt(fitted(origin, 0.0, 0.0)[0])
    # a line that passes the point at some distance has a bend in the place of a corner
    starts = [np.array([origin, part * PITCH * detector.columns]) for part in (0.0, *_ASIDES)]

    def missing(values: Array, turn: float) -> Array:
        return fitted(float(values[0]), PITCH * float(values[1]), turn)[1]

    def refined(start: Array) -> tuple[float, Array, float]:
        at, turn = start, tilt
        for _ in range(_TILTS):
            passed = least_squares(
                missing, np.array([at[0], at[1] / PITCH]), args=(turn,),
                xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac", max_nfev=_STEPS,
            )  # fmt: skip
            at = np.array([passed.x[0], PITCH * passed.x[1]])
            turn = _tilt(fitted(at[0], at[1], turn)[0])
        return float(np.abs(fitted(at[0], at[1], turn)[1]).max()), at, turn

    corner = float(np.abs(fitted(origin, 0.0, tilt)[1]).max()), np.array([origin, 0.0]), tilt
    tried = [corner]
    for start in starts:
        if min(tried, key=lambda one: one[0])[0] <= _STRAIGHT:
            break
        tried.append(refined(start))
    _, (origin, aside), tilt = min(tried, key=lambda one: one[0])
    found = fitted(origin, aside, tilt)[0]
    focal = 1.0 / float(found[0, 0])
    # the tangent along y of `aside + tilt x` is in the constant and in x; the lens takes the rest
    return _changed(
        even, focal_length=focal, lines_from_x=np.array([0.0, -tilt / PITCH, 1.0 / PITCH]),
        centre=(-aside / PITCH, origin), distortion="kaguyalism",
        coefficients=np.concatenate(
            [[0.0], focal * found[1:, 0], [0.0], focal * found[1:, 1] - [aside, 0.0, 0.0, 0.0]]
        ),
    )  # fmt: skip


def _tilt(found: Array) -> float:
    """Of a line whose tangents (x, y) change by `found[0]` along it."""
    return float(found[0, 1] / found[0, 0])


def _transverse(even: CsmFocalPlane, detector: LineDetector) -> CsmFocalPlane:
    """Cubics in x that lead from the directions to even detector pixels on a straight line."""
    u, v = (detector.tangents * even.focal_length).T
    samples = np.arange(detector.columns) + 0.5
    even_x = PITCH * (samples - even.centre[1]) * np.sign(even.samples_from_x[1])
    reach = float(np.abs(u).max())
    powers = (u / reach)[:, None] ** np.arange(4)
    by_x, by_y = (
        np.linalg.lstsq(powers, values, rcond=None)[0] / reach ** np.arange(4) for values in (even_x, v)
    )
    coefficients = np.zeros((2, 10))
    coefficients[0, [0, 1, 3, 6]] = by_x
    coefficients[1, [0, 1, 3, 6]] = -by_y
    coefficients[1, 2] = 1.0
    return _changed(
        even,
        lines_from_x=np.array([0.0, 0.0, 1.0 / PITCH]),
        centre=(0.0, even.centre[1]),
        distortion="transverse",
        coefficients=coefficients.ravel(),
    )


def state_text(
    camera: PushbroomCamera,
    states: LineStates,
    timing: CsmTiming,
    plane: CsmFocalPlane,
    radii: tuple[float, float],
    names: CsmNames,
    reference: tuple[Array, float],
) -> str:
    """A model state of usgscsm: the model's name, then JSON; a position and a quaternion for every line.

    Parameters
    ----------
    camera : PushbroomCamera
    states : LineStates
        Evenly spaced.
    timing : CsmTiming
    plane : CsmFocalPlane
    radii : (float, float)
        m; of the body, equatorial and polar.
    names : CsmNames
    reference : ((3,), float)
        The ground under the middle of the image, m, and what a pixel covers there, m.
    """
    middle = 0.5 * float(camera.times([0.0])[0] + camera.times([camera.lines - 1.0])[0])
    t, step = states.t - middle, float(states.t[-1] - states.t[0]) / max(len(states.t) - 1, 1)
    quaternions = one_side(states.world_from_camera.as_quat())
    ground, gsd = reference
    start = float(timing.centre_et + timing.rows[0][1])
    values = {
        "m_modelName": LINE_SCANNER,
        "m_imageIdentifier": names.image,
        "m_sensorName": names.sensor,
        "m_platformIdentifier": names.platform,
        "m_sensorIdentifier": names.sensor,
        "m_nLines": camera.lines,
        "m_nSamples": camera.columns,
        "m_platformFlag": 1,
        "m_intTimeLines": [row[0] for row in timing.rows],
        "m_intTimeStartTimes": [row[1] for row in timing.rows],
        "m_intTimes": [row[2] for row in timing.rows],
        "m_startingEphemerisTime": start,
        "m_centerEphemerisTime": timing.centre_et,
        "m_detectorSampleSumming": plane.sample_summing,
        "m_detectorLineSumming": plane.line_summing,
        "m_startingDetectorSample": plane.starting[1],
        "m_startingDetectorLine": plane.starting[0],
        "m_ikCode": 0,
        "m_focalLength": plane.focal_length,
        "m_zDirection": plane.z_direction,
        "m_distortionType": DISTORTIONS[plane.distortion].number,
        "m_opticalDistCoeffs": plane.coefficients.tolist(),
        "m_iTransS": plane.samples_from_x.tolist(),
        "m_iTransL": plane.lines_from_x.tolist(),
        "m_detectorSampleOrigin": plane.centre[1],
        "m_detectorLineOrigin": plane.centre[0],
        "m_majorAxis": radii[0],
        "m_minorAxis": radii[1],
        "m_minElevation": _ELEVATIONS[0],
        "m_maxElevation": _ELEVATIONS[1],
        "m_dtEphem": step,
        "m_t0Ephem": float(t[0]),
        "m_dtQuat": step,
        "m_t0Quat": float(t[0]),
        "m_numPositions": 3 * len(t),
        "m_numQuaternions": 4 * len(t),
        "m_positions": states.position.ravel().tolist(),
        "m_velocities": states.velocity.ravel().tolist(),
        "m_quaternions": quaternions.ravel().tolist(),
        "m_currentParameterValue": [0.0] * _PARAMETERS,
        "m_parameterType": ["REAL"] * _PARAMETERS,
        "m_referencePointXyz": ground.tolist(),
        "m_gsd": gsd,
        "m_flyingHeight": float(np.linalg.norm(states.position[len(t) // 2] - ground)),
        "m_halfSwath": 0.5 * gsd * camera.columns,
        "m_halfTime": max(0.5 * float(states.t[-1] - states.t[0]), step),
        "m_covariance": np.eye(_PARAMETERS).ravel().tolist(),
        "m_sunPosition": [],
        "m_sunVelocity": [],
        "m_logFile": "",
    }
    return f"{LINE_SCANNER}\n{_json(values)}"


def isd_text(
    camera: PushbroomCamera,
    states: LineStates,
    timing: CsmTiming,
    plane: CsmFocalPlane,
    radii: tuple[float, float],
    names: CsmNames,
    body: tuple[Array, Rotation],
) -> str:
    """An ISD as ALE writes it: positions and attitudes in J2000, and the rotation of the body.

    Parameters
    ----------
    body : (K,), Rotation
        Instants (s from the epoch) and body-fixed from J2000 at each, two or more that cover all lines.
    """
    middle = 0.5 * float(camera.times([0.0])[0] + camera.times([camera.lines - 1.0])[0])
    inertial = inertial_states(states, body)
    et, body_et = (timing.centre_et + times - middle for times in (states.t, body[0]))
    (name, coefficients) = plane.distortion, plane.coefficients
    sizes = np.cumsum([size for _, size in DISTORTIONS[name].keys])[:-1]
    distortion = dict(
        zip([key for key, _ in DISTORTIONS[name].keys], np.split(coefficients, sizes), strict=True)
    )
    values = {
        "isis_camera_version": 1,
        "image_lines": camera.lines,
        "image_samples": camera.columns,
        "name_platform": names.platform,
        "name_sensor": names.sensor,
        "image_identifier": names.image,
        "reference_height": {"maxheight": _ELEVATIONS[1], "minheight": _ELEVATIONS[0], "unit": "m"},
        "name_model": LINE_SCANNER,
        "interpolation_method": "lagrange",
        "line_scan_rate": [list(row) for row in timing.rows],
        "starting_ephemeris_time": timing.centre_et + timing.rows[0][1],
        "center_ephemeris_time": timing.centre_et,
        "radii": {"semimajor": radii[0] / 1e3, "semiminor": radii[1] / 1e3, "unit": "km"},
        "body_rotation": {
            "time_dependent_frames": [],
            "ck_table_start_time": float(body_et[0]),
            "ck_table_end_time": float(body_et[-1]),
            "ck_table_original_size": len(body_et),
            "ephemeris_times": body_et.tolist(),
            "quaternions": one_side(body[1].as_quat(scalar_first=True)).tolist(),
            "reference_frame": 1,
        },
        "instrument_pointing": {
            "time_dependent_frames": [],
            "ck_table_start_time": float(et[0]),
            "ck_table_end_time": float(et[-1]),
            "ck_table_original_size": len(et),
            "ephemeris_times": et.tolist(),
            "quaternions": one_side(inertial.world_from_camera.inv().as_quat(scalar_first=True)).tolist(),
            "reference_frame": 1,
            "constant_frames": [],
            "constant_rotation": np.eye(3).ravel().tolist(),
        },
        "instrument_position": {
            "spk_table_start_time": float(et[0]),
            "spk_table_end_time": float(et[-1]),
            "spk_table_original_size": len(et),
            "ephemeris_times": et.tolist(),
            "positions": (inertial.position / 1e3).tolist(),
            "velocities": (inertial.velocity / 1e3).tolist(),
            "reference_frame": 1,
            "unit": "km",
        },
        "sun_position": {
            "ephemeris_times": [timing.centre_et],
            "positions": [[0.0, 0.0, 0.0]],
            "velocities": [[0.0, 0.0, 0.0]],
            "reference_frame": 1,
            "unit": "km",
        },
        "naif_keywords": {},
        "detector_sample_summing": plane.sample_summing,
        "detector_line_summing": plane.line_summing,
        "focal_length_model": {"focal_length": plane.focal_length},
        "detector_center": {"line": plane.centre[0], "sample": plane.centre[1]},
        "starting_detector_line": plane.starting[0],
        "starting_detector_sample": plane.starting[1],
        "focal2pixel_lines": plane.lines_from_x.tolist(),
        "focal2pixel_samples": plane.samples_from_x.tolist(),
        "optical_distortion": {name: {key: part.tolist() for key, part in distortion.items()}},
    }
    return _json(values)


def inertial_states(states: LineStates, body: tuple[Array, Rotation]) -> LineStates:
    """States turned from body-fixed axes into J2000; the body turns evenly between its instants."""
    t, turns = body
    before = np.clip(np.searchsorted(t, states.t, side="right") - 1, 0, len(t) - 2)
    rates = (turns[:-1].inv() * turns[1:]).as_rotvec() / np.diff(t)[:, None]
    there = turns[before] * Rotation.from_rotvec((states.t - t[before])[:, None] * rates[before])
    position = there.inv().apply(states.position)
    # fixed(t + dt) = fixed(t) exp(rate dt): a point at rest on the body moves by -rate x in J2000
    velocity = there.inv().apply(states.velocity) - np.cross(rates[before], position)
    return LineStates(states.t, position, velocity, there.inv() * states.world_from_camera)


def _json(values: dict[str, Any]) -> str:
    """JSON, an entry a line: lists of a number per line of the image stay on one."""
    entries = (f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in values.items())
    return json_printable("{\n" + ",\n".join(entries) + "\n}\n")
