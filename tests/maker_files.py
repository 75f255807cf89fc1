"""Small products as makers write them (DIMAP 2, DIMAP 1, PHRDIMAP), with rays by formulas of their own.

A satellite on a circular orbit over a turning Earth, its z to the ground, x along its flight. Everything is
Earth-fixed, m and s from the first line.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

RADIUS, RATE, EARTH = 7.07e6, 1.06e-3, 7.292115e-5
A, E2 = 6378137.0, 6.69437999014e-3
START = datetime(2012, 12, 7, 10, 20, 28, 79667)
#: s by which bands see the ground after the panchromatic one.
LAGS = {"PA": 0.0, "B1": 0.1525, "B0": 0.1591, "B3": 0.1657, "B2": 0.1723}
#: Of the gyros of PHRDIMAP: rad per count, and their axes.
COUNT = 5e-9
AXES = np.array(
    [
        [8**0.5 / 3, 0, -1 / 3],
        [-(2**0.5) / 3, -((2 / 3) ** 0.5), -1 / 3],
        [-(2**0.5) / 3, (2 / 3) ** 0.5, -1 / 3],
        [0, 0, 1],
    ]
)


def turned(angle):
    """Earth-fixed from inertial axes, (N, 3, 3)."""
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    return np.stack([np.stack([c, s, o], -1), np.stack([-s, c, o], -1), np.stack([o, o, o + 1], -1)], -2)


def orbit(t):
    """Position, velocity relative to the Earth, and to the stars but on Earth-fixed axes: (N, 3) each."""
    t = np.atleast_1d(np.asarray(t, dtype=float))
    u, i = 0.7 + RATE * t, np.radians(98.0)
    along = np.stack([np.cos(u), np.sin(u) * np.cos(i), np.sin(u) * np.sin(i)], -1)
    ahead = np.stack([-np.sin(u), np.cos(u) * np.cos(i), np.cos(u) * np.sin(i)], -1)
    fixed = turned(EARTH * t)
    place, stars = (np.einsum("nij,nj->ni", fixed, v) for v in (RADIUS * along, RADIUS * RATE * ahead))
    return place, stars - np.cross([0.0, 0.0, EARTH], place), stars


def attitude(t, roll=0.1, rate=0.004):
    """earth_from_body (N, 3, 3): z down and tilted, turning about its x and a little about z."""
    place, speed, _ = orbit(t)
    z = -place / np.linalg.norm(place, axis=1)[:, None]
    y = np.cross(z, speed)
    y /= np.linalg.norm(y, axis=1)[:, None]
    level = np.stack([np.cross(y, z), y, z], -1)
    t = np.atleast_1d(t)
    a, b, o = roll + rate * np.sin(1.3 * t), 0.02 * np.sin(0.9 * t + 1.0), np.zeros_like(t)
    rx = np.stack(
        [
            np.stack([o + 1, o, o], -1),
            np.stack([o, np.cos(a), -np.sin(a)], -1),
            np.stack([o, np.sin(a), np.cos(a)], -1),
        ],
        -2,
    )
    rz = np.stack(
        [
            np.stack([np.cos(b), -np.sin(b), o], -1),
            np.stack([np.sin(b), np.cos(b), o], -1),
            np.stack([o, o, o + 1], -1),
        ],
        -2,
    )
    return level @ rx @ rz


def quaternion(matrices):
    """(N, 4), scalar first, of matrices; neighbours on one side."""
    out = []
    for m in matrices:
        k = np.array([
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [0, m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [0, 0, m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2]],
            [0, 0, 0, m[2, 2] - m[0, 0] - m[1, 1]],
        ])  # fmt: skip
        q = np.linalg.eigh(k, UPLO="U")[1][:, -1]
        out.append(q if not out or q @ out[-1] > 0 else -q)
    return np.array(out)


def geodetic(point):
    """Longitude, latitude (degrees), height (m) of points (N, 3)."""
    x, y, z = np.asarray(point).T
    rho, latitude = np.hypot(x, y), np.arctan2(z, np.hypot(x, y))
    for _ in range(20):
        n = A / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + E2 * n * np.sin(latitude), rho)
    n = A / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    height = rho * np.cos(latitude) + z * np.sin(latitude) - A * np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    return np.stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), height], -1)


def ground(origin, direction, height):
    """Where rays (N, 3) meet a height above the ellipsoid, by secants in the distance."""
    unit = direction / np.linalg.norm(direction, axis=1)[:, None]
    near = np.full(len(origin), RADIUS - A)
    far = near + 1e4
    for _ in range(30):
        a, b = (geodetic(origin + d[:, None] * unit)[:, 2] - height for d in (near, far))
        step = np.where(np.abs(b - a) > 1e-9, b * (far - near) / np.where(b == a, 1.0, b - a), 0.0)
        near, far = far, far - step
    return origin + far[:, None] * unit


def stamp(t, digits=6):
    """UTC label of a time."""
    whole = START + timedelta(seconds=float(np.floor(t)))
    fraction = START.microsecond * 1e-6 + (t - np.floor(t))
    whole = whole.replace(microsecond=0) + timedelta(seconds=int(fraction))
    return f"{whole:%Y-%m-%dT%H:%M:%S}." + f"{fraction % 1.0:.{digits}f}"[2:]


def tag(name, *inner, **attributes):
    """An element."""
    given = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f"<{name}{given}>" + "".join(str(part) for part in inner) + f"</{name}>"


def row(vector):
    """Numbers with blanks between, every digit of them."""
    return " ".join(f"{value:.17g}" for value in np.atleast_1d(vector))


def dimap2(
    folder: Path,
    *,
    rows=60,
    columns=50,
    step=4,
    height=201.5,
    name="DIM_SPOT6.XML",
    bands=(),
    changes=(),
    polynomials=False,
):
    """A SENSOR product at `step` quarters of the pixel of its panchromatic band; its file.

    With `polynomials` it is as Pleiades has it: attitudes by polynomials, velocities relative to the stars,
    the period in ms, one look of the instrument, and vertices that tell their height.
    """
    period, look = 229e-6 * step, 2.2e-6 * step
    # pixel k of the wide grid has its centre on pixel 4 k + 2 of the fine one
    begin, first = (2 * 229e-6, -0.042 + 2 * 2.2e-6) if step > 1 else (0.0, -0.042)
    t_orbit, t_turn = -0.06 + 0.128 * np.arange(-3, 7), 0.0005 + 0.032 * np.arange(-2, 8)
    place, speed, stars = orbit(t_orbit)
    q = quaternion(attitude(t_turn))
    of_day = (START - START.replace(hour=0, minute=0, second=0, microsecond=0)).total_seconds() + 0.1
    cubics = np.polynomial.polynomial.polyfit((t_turn - 0.1) / 0.3, q, 3)
    speed = stars if polynomials else speed

    def turned_at(t):
        if not polynomials:
            return _slerped(t, t_turn, q)
        return np.array([_matrix(np.polynomial.polynomial.polyval((at - 0.1) / 0.3, cubics)) for at in t])

    points = [
        tag("Point", tag("LOCATION_XYZ", row(p)), tag("VELOCITY_XYZ", row(v)), tag("TIME", stamp(t, 9) + "Z"))
        for t, p, v in zip(t_orbit, place, speed, strict=True)
    ]
    turns = [
        tag(
            "Quaternion",
            *(tag(f"Q{k}", row(v)) for k, v in enumerate(values)),
            tag("TIME", stamp(t, 9) + "Z"),
        )
        for t, values in zip(t_turn, q, strict=True)
    ]
    corners = [(0, 0), (0, columns - 1), (rows - 1, columns - 1), (rows - 1, 0), (rows // 2, columns // 2)]
    ends = []
    for number, (line, column) in enumerate(corners):
        t = np.array([begin + line * period])
        x = first + look * column
        above = height + (10.0 * number if polynomials else 0.0)
        u = np.einsum("nij,j->ni", turned_at(t), np.array([0.0, -x, 1.0]))
        lon, lat, _ = geodetic(ground(orbit(t)[0], u, above))[0]
        ends.append(
            tag(
                "Center" if number == 4 else "Vertex",
                tag("LON", f"{lon:.12f}"), tag("LAT", f"{lat:.12f}"),
                *([tag("H", row(above))] if polynomials else []),
                tag("COL", column + 1), tag("ROW", line + 1),
            )
        )  # fmt: skip
    bands = bands or (("P",) if step == 1 else ("B2", "B1", "B0", "B3"))
    look_of = (
        tag("Swath_Range", tag("FIRST_COL", 1), tag("LAST_COL", columns)),
        tag(
            "Polynomial_Look_Angles", tag("XLOS_0", row(first)), tag("XLOS_1", row(look)),
            tag("YLOS_0", 0.0), *([] if polynomials else [tag("YLOS_1", 0)]),
        ),
    )  # fmt: skip
    looks = [tag("Band_Calibration", tag("BAND_ID", band), *look_of) for band in bands]
    calibrated = look_of if polynomials else (tag("Band_Calibration_List", *looks),)
    attitudes = tag("Quaternion_List", *turns)
    if polynomials:
        attitudes = tag(
            "Polynomial_Quaternions", tag("OFFSET", row(of_day)), tag("SCALE", 0.3),
            *(tag(f"Q{k}", tag("DEGREE", 3), tag("COEFFICIENTS", row(c))) for k, c in enumerate(cubics.T)),
        )  # fmt: skip
    lined = (period * 1e3, "ms") if polynomials else (period * 1e6, "microsecond")
    text = tag(
        "Dimap_Document",
        tag(
            "Metadata_Identification", tag("METADATA_FORMAT", "DIMAP", version="2.0"),
            tag("METADATA_PROFILE", "S6_SENSOR"),
        ),
        tag("Dataset_Identification", tag("DATASET_NAME", "SEN_SPOT6_20121207")),
        tag("Dataset_Content", tag("Dataset_Extent", *ends)),
        tag("Processing_Information", tag("Product_Settings", tag("PROCESSING_LEVEL", "SENSOR"))),
        tag(
            "Raster_Data",
            tag("Data_Access", tag("Data_Files", tag("Data_File", '<DATA_FILE_PATH href="IMG_R1C1.TIF"/>'))),
            tag("Raster_Dimensions", tag("NROWS", rows), tag("NCOLS", columns), tag("NBANDS", len(bands))),
        ),
        tag("Geometric_Data", tag(
            "Refined_Model",
            tag(
                "Time",
                tag(
                    "Time_Range", tag("START", stamp(begin) + "Z"),
                    tag("END", stamp(begin + (rows - 1) * period) + "Z"),
                ),
                tag("Time_Stamp", tag("LINE_PERIOD", row(lined[0]), unit=lined[1])),
            ),
            tag("Ephemeris", tag("Point_List", *points)),
            tag("Attitudes", attitudes),
            tag("Geometric_Calibration", tag(
                "Instrument_Calibration", *calibrated,
                tag("Instrument_Biases", tag("YAW", 0.0), tag("PITCH", 0.0), tag("ROLL", 0.0)),
            )),
        )),
    )  # fmt: skip
    return written(folder / name, text, changes)


def dimap1(folder: Path, *, rows=80, columns=60, name="METADATA.DIM", ahead=(0.0,), changes=()):
    """A SPOT 5 scene of level 1A; attitudes begin after the first line and end before the last.

    One band for each of `ahead`, rad by which it looks further ahead.
    """
    period, centre = 7.52e-3, rows / 2
    middle = (centre - 1) * period

    def line_time(r):
        return (r - 1) * period

    t_orbit = -90.0 + 30.0 * np.arange(8)
    t_turn = 0.0162 + 0.125 * np.arange(1 + int(((rows - 1) * period - 0.0162 - 0.1) / 0.125))
    slope = np.array([[3e-5, -2e-5, 1e-5]])

    def angles(t):
        return np.array([[1.2e-3, -9.5e-4, -2e-5]]) + slope * np.atleast_1d(t)[:, None]

    def psi_x(d):
        return 0.02 - 1e-9 * d

    def psi_y(d):
        return -0.071 + 2e-5 * d

    def sees(t, detector):
        y, p, r = angles(t).T
        place, speed, _ = orbit(t)
        up = place / np.linalg.norm(place, axis=1)[:, None]
        side = np.cross(speed, up)
        side /= np.linalg.norm(side, axis=1)[:, None]
        cy, sy, cp, sp, cr, sr = np.cos(y), np.sin(y), np.cos(p), np.sin(p), np.cos(r), np.sin(r)
        m = np.array([
            [cr * cy, -cr * sy, -sr],
            [cp * sy + sp * sr * cy, cp * cy - sp * sr * sy, sp * cr],
            [-sp * sy + cp * sr * cy, -sp * cy - cp * sr * sy, cp * cr],
        ])  # fmt: skip
        u = np.array([-np.tan(psi_y(detector)), np.tan(psi_x(detector)), -1.0])
        return place, np.einsum("nij,jkn,k->ni", np.stack([side, np.cross(up, side), up], -1), m, u)

    ties = []
    for line, column in [(1, 1), (1, columns), (rows, columns), (rows, 1)]:
        place, u = sees(np.array([line_time(line)]), column)
        lon, lat, _ = geodetic(ground(place, u, 0.0))[0]
        ties.append(
            tag(
                "Tie_Point", tag("TIE_POINT_CRS_X", f"{lon:.9f}"), tag("TIE_POINT_CRS_Y", f"{lat:.9f}"),
                tag("TIE_POINT_CRS_Z", 0.0), tag("TIE_POINT_DATA_X", column), tag("TIE_POINT_DATA_Y", line),
            )
        )  # fmt: skip

    def vector(name, v):
        return tag(name, *(tag(axis, row(value)) for axis, value in zip("XYZ", v, strict=True)))

    def point(name, t, p, v, *more):
        return tag(name, vector("Location", p), vector("Velocity", v), tag("TIME", stamp(t)), *more)

    place, speed, _ = orbit(t_orbit)
    t_doris = np.array([-20.0, -10.0, 0.0, 10.0])
    doris_place, doris_speed, _ = orbit(t_doris)
    turns = [
        tag(
            "Angles",
            tag("TIME", stamp(t)),
            *(tag(k, row(v)) for k, v in zip(("YAW", "PITCH", "ROLL"), a, strict=True)),
            tag("OUT_OF_RANGE", "N"),
        )
        for t, a in zip(t_turn, angles(t_turn), strict=True)
    ]
    looks = [
        tag("Instrument_Look_Angles", tag("BAND_INDEX", band), tag("Look_Angles_List", *(
            tag(
                "Look_Angles", tag("DETECTOR_ID", d), tag("PSI_X", row(psi_x(d) + further)),
                tag("PSI_Y", row(psi_y(d))),
            )
            for d in range(1, columns + 1)
        )))
        for band, further in enumerate(ahead, 1)
    ]  # fmt: skip
    text = tag(
        "Dimap_Document",
        tag("Metadata_Id", tag("METADATA_FORMAT", "DIMAP", version="1.1")),
        tag("Dataset_Id", tag("DATASET_NAME", "SEGMENT S5")),
        tag("Geoposition", tag("Geoposition_Points", *ties)),
        tag("Dataset_Sources", tag("Source_Information", tag("Scene_Source", tag("MISSION_INDEX", 5)))),
        tag("Raster_Dimensions", tag("NCOLS", columns), tag("NROWS", rows), tag("NBANDS", len(ahead))),
        tag("Data_Access", tag("Data_File", "<DATA_FILE_PATH href='C:\\\\data\\\\IMAGERY.TIF'/>")),
        tag("Data_Processing", tag("PROCESSING_LEVEL", "1A")),
        tag("Image_Interpretation", tag("Spectral_Band_Info", tag("BAND_DESCRIPTION", "PAN"))),
        tag(
            "Data_Strip",
            tag("Satellite_Time", tag("TAI_TUC", 33)),
            tag(
                "Ephemeris",
                tag("Points", *(
                    point("Point", t, p, v) for t, p, v in zip(t_orbit, place, speed, strict=True)
                )),
                tag("Doris_Points", *(
                    point("Doris_Point", t + 33.0, 1e2 * p, 1e3 * v)
                    for t, p, v in zip(t_doris, doris_place, doris_speed, strict=True)
                )),
            ),
            tag("Satellite_Attitudes", tag("Corrected_Attitudes", tag("Corrected_Attitude", *turns))),
            tag(
                "Sensor_Configuration",
                tag(
                    "Time_Stamp", tag("LINE_PERIOD", row(period)), tag("SCENE_CENTER_TIME", stamp(middle, 9)),
                    tag("SCENE_CENTER_LINE", centre), tag("SCENE_CENTER_COL", columns // 2),
                ),
                tag("Instrument_Look_Angles_List", *looks),
            ),
            tag("Data_Strip_Coordinates", tag("FIRST_PIXEL_RAW", 1)),
        ),
    )  # fmt: skip
    return written(folder / name, text, changes)


def pleiades(
    folder: Path, *, rows=70, columns=60, seconds=4.0, name="PHRDIMAP_P1.XML", points=10, changes=()
):
    """A PHRDIMAP product with four gyros and the quaternions of a filter; of no image that is longer."""
    period = 0.0735e-3
    t_orbit = -75.0 - 30.0 * (points - 10) / 2 + 30.0 * np.arange(points) - 60.0
    place, _, stars = orbit(t_orbit)
    of_day = (START - START.replace(hour=0, minute=0, second=0, microsecond=0)).total_seconds()
    x = np.linspace(-1.0, 1.0, 41)
    scale = max(0.05, 0.52 * rows * period)
    t_model = x * scale + rows * period / 2
    q = np.polynomial.polynomial.polyfit(x, quaternion(attitude(t_model)), 3).T
    t_turn = -0.2 + 0.125 * np.arange(int(seconds / 0.125))

    def inertial(t):
        return np.swapaxes(turned(EARTH * t), 1, 2) @ attitude(t)

    t_gyro = np.round((-0.4 + np.arange(int((seconds + 0.8) * 32)) / 32), 6)

    def tai(t):
        return stamp(t + 37.0, 9)

    model = tag(
        "Sensor_Model_Characteristics",
        tag("UTC_Sensor_Model_Range", tag("START", stamp(0.0) + "Z")),
        tag("Sensor_Ephemeris", tag("Point_List", *(
            tag(
                "Point", tag("LOCATION_VALUES", row(p), unit="m"), tag("VELOCITY_VALUES", row(v), unit="m/s"),
                tag("UTC_TIME", stamp(t) + "Z"),
            )
            for t, p, v in zip(t_orbit, place, stars, strict=True)
        ))),
        tag(
            "Sensor_Attitudes",
            tag("Polynomial_Models", *(
                tag(f"Q{k}", tag("DEGREE", 3), tag("COEFFICIENTS", row(c))) for k, c in enumerate(q)
            )),
            tag("OFFSET", row(of_day + rows * period / 2)), tag("SCALE", row(scale)),
        ),
        tag("SENSOR_LINE_PERIOD", row(period * 1e3)),
        tag(
            "Sensor_Viewing_Model",
            tag("Position_In_Retina", tag("FIRST_COL", 1), tag("LAST_COL", columns + 1)),
            tag(
                "Viewing_Directions",
                tag("PsiX_Model", tag("DEGREE", 1), tag("COEFFICIENTS", "-0.01422 7.11e-07")),
                tag("PsiY_Model", tag("DEGREE", 0), tag("COEFFICIENTS", "8e-05")),
            ),
        ),
    )  # fmt: skip
    body = counts(t_gyro)
    heads = [
        tag(f"FOG{g + 1}_Auxiliary_Data_List", *(
            tag(
                "FOG_Inertial_Data", tag("TAI_TIME", tai(t)),
                tag("ANGLE_FILT", value), tag("ANGLE_RAW", value),
                tag("FOG_DATE_COUNTER", int(4e9 + 13.93e6 * (t + 0.4)) % 2**32), tag("STATUS", "NOMINAL"),
            )
            for t, value in zip(t_gyro, body[:, g], strict=True)
        ))
        for g in range(4)
    ]  # fmt: skip
    rounded = np.round(quaternion(inertial(t_turn)), 8)
    text = tag(
        "PHR_Dimap_Document",
        tag("Dataset_Identification", tag("DATASET_NAME", "DS_PHR1B")),
        tag("Product_Characteristics", tag("PROCESSING_LEVEL", "SENSOR"), tag(
            "Product_Image_Characteristics",
            tag("Data_Access", tag("Data_File", tag("DATA_FILE_PATH", "IMG_R1C1.JP2"))),
        )),
        tag("Raster_Dimensions", tag("NROWS", rows), tag("NCOLS", columns), tag("NBANDS", 1)),
        tag("Image_Interpretation", tag("Spectral_Band_Info", tag("BAND_ID", "PA"))),
        tag(
            "Data_Strip",
            tag("Sensor_Configuration", tag(
                "Time_Stamp", tag("PA_LINE_PERIOD", 0.1034, unit="ms"),
                tag("Band_TS_List", *(
                    tag("Band_TS", tag("BAND_ID", band), tag("Array_TS_List", tag(
                        "Array_TS", tag("ORIGIN_TIME", stamp(lag, 7) + "Z"), tag("ORIGIN_FULL_RES_LINE", 1)
                    )))
                    for band, lag in LAGS.items()
                )),
                tag("TAI_UTC", 37, unit="s"),
            )),
            tag(
                "Satellite_Attitudes",
                tag("Corrected_Attitudes", tag("WGS84_Attitudes_List", *(
                    tag("WGS84_Attitudes", tag("UTC_TIME", stamp(t, 9) + "Z"), tag("Q_VALUES", row(values)))
                    for t, values in zip(t_turn, quaternion(attitude(t_turn)), strict=True)
                ))),
                tag("Accurate_Attitudes", tag("Quaternion_List", *(
                    tag("Quaternion", tag("TAI_TIME", tai(t)), tag("Q_VALUES", row(values)))
                    for t, values in zip(t_turn, rounded, strict=True)
                ))),
                tag("Raw_Attitudes", tag("Quaternion_List", *(
                    tag("Quaternion", tag("TAI_TIME", tai(t)), tag("Q_VALUES", row(values)))
                    for t, values in zip(t_turn, quaternion(inertial(t_turn)), strict=True)
                )), *heads),
            ),
        ),
        tag("Geometric_Data", model),
    )  # fmt: skip
    return written(folder / name, text, changes)


def counts(t, seed=1, noise=2e-8):
    """Counters (N, 4) of gyros that wrap, by the body's rates integrated in steps of a millisecond."""
    fine = np.arange(t[0], t[-1] + 1.5e-3, 1e-3)
    m = np.swapaxes(turned(EARTH * fine), 1, 2) @ attitude(fine)
    step = np.swapaxes(m[:-1], 1, 2) @ m[1:]
    turn = 0.5 * np.stack(
        [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], -1
    )
    angle = np.vstack([np.zeros(3), np.cumsum(turn, axis=0)])
    read = np.stack([np.interp(t, fine, axis) for axis in (angle @ AXES.T).T], -1)
    read = read + noise * np.random.default_rng(seed).standard_normal(read.shape)
    first = np.array([2**31 - 40_000, -(2**31) + 50_000, 12, -7])
    return (np.round(read / COUNT).astype(np.int64) + first + 2**31) % 2**32 - 2**31


def _slerped(t, nodes, q):
    """Matrices between quaternions along the great circle."""
    k = np.clip(np.searchsorted(nodes, t) - 1, 0, len(nodes) - 2)
    share = (t - nodes[k]) / (nodes[k + 1] - nodes[k])
    angle = np.arccos(np.sum(q[k] * q[k + 1], axis=1))
    mixed = (np.sin((1 - share) * angle) / np.sin(angle))[:, None] * q[k] + (
        np.sin(share * angle) / np.sin(angle)
    )[:, None] * q[k + 1]
    return np.array([_matrix(one) for one in mixed])


def _matrix(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def written(path: Path, text: str, changes=()) -> Path:
    """The file with words changed, each exactly as often as it stands there, once or more."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text('<?xml version="1.0" encoding="ISO-8859-1"?>\n' + text, encoding="latin-1")
    return path
