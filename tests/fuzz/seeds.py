"""Small valid inputs of every kind that the package reads: what the fuzzer begins from.

Each function below makes one folder. Nothing outside the repository is read.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import shutil
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from tests import maker_files, sentinel2_files
from tests.io.sequence_files import NORTH, Flight, flight, npy
from tests.io.stereo_files import scene
from tests.product_files import WorldViewScene

Maker = Callable[[Path], None]
SEEDS: dict[str, Maker] = {}

#: Bytes of the largest file of a seed: every case is written anew, thousands of times.
MOST_BYTES = 64_000


def seed(make: Maker) -> Maker:
    """Register a maker under its name."""
    SEEDS[make.__name__.replace("_", "-")] = make
    return make


def build(root: Path) -> None:
    """All seeds as folders of `root`."""
    for name, make in SEEDS.items():
        folder = root / name
        folder.mkdir(parents=True)
        make(folder)
        for path in folder.rglob("*"):
            assert not path.is_file() or path.stat().st_size <= MOST_BYTES, f"{path} is too large for a seed"


def run(*words: object) -> None:
    """A command that must end well."""
    from sightline.cli.main import run as command

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = command([str(word) for word in words])
    assert status == 0, f"{' '.join(map(str, words))}: {said.getvalue()}"


def noise(number: int, shape: tuple[int, int], most: int = 900) -> np.ndarray:
    return np.random.default_rng(number).integers(100, most, shape).astype(np.uint16)


def write_tif(path: Path, array: np.ndarray, tags: dict | None = None, **profile) -> None:
    import rasterio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no georeference
        given = {
            "driver": "GTiff",
            "count": 1,
            "height": array.shape[-2],
            "width": array.shape[-1],
            **profile,
        }
        with rasterio.open(path, "w", dtype=array.dtype, **given) as target:
            target.write(array if array.ndim == 3 else array[None])
            target.update_tags(**(tags or {}))


def local_dem(path: Path, *, west: float, north: float, step: float, shape: tuple[int, int]) -> None:
    from rasterio.transform import Affine

    heights = np.random.default_rng(5).normal(0.0, 3.0, shape).astype(np.float32)
    write_tif(path, heights, transform=Affine(step, 0.0, west, 0.0, -step, north), nodata=-9999.0)


def table(path: Path, header: str, rows) -> None:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")


# Acquisitions ---------------------------------------------------------------------------------------------

LINES, COLUMNS, PERIOD, IFOV, ALTITUDE, SPEED = 120, 40, 5e-4, 5e-6, 700e3, 7000.0
#: Windows that so small a strip holds enough of.
WINDOWS = "first_window = [4, 12]\nwindow = [4, 12]"
BANDS = """
[instrument]
ifov = 5e-6
columns = 40
line_period = 5e-4

[[band]]
name = "PAN"
image = "PAN.tif"
offset_sigma_px = 0.0
rotation_sigma = 0.0

[[band]]
name = "XS"
image = "XS.npy"
look_ahead = 5e-5
offset_px = [0.25, -0.5]
"""


def bands(folder: Path) -> None:
    write_tif(folder / "PAN.tif", noise(0, (LINES, COLUMNS)))
    (folder / "XS.npy").write_bytes(npy(noise(1, (LINES, COLUMNS))))


@seed
def shifts(folder: Path) -> None:
    """Shifts of six windows."""
    columns = "line,column,d_line,d_column,sigma_line,sigma_column,correlation,score"
    rows = [[4.5 + 10 * k, 49.5, 0.1 * k, -0.2, 0.01, 0.02, 0.1, 0.9] for k in range(6)]
    table(folder / "matches.csv", columns, rows)


@seed
def level(folder: Path) -> None:
    """Level flight with everything that can stand beside the images."""
    bands(folder)
    (folder / "flat.npy").write_bytes(npy(noise(3, (240, 240), 255).astype(np.uint8)))
    t = PERIOD * np.arange(LINES)
    write_tif(folder / "mask.tif", (noise(2, (LINES, COLUMNS)) > 850).astype(np.uint8))
    local_dem(folder / "dem.tif", west=-200.0, north=500.0, step=20.0, shape=(40, 20))
    table(folder / "times.csv", "line,t", enumerate(t))
    look = IFOV * (np.arange(COLUMNS) - 19.5)
    table(folder / "directions.csv", "column,x,y,z", [(k, x, 0.0, 1.0) for k, x in enumerate(look)])
    table(folder / "quality.csv", "column,mtf_x,mtf_y,snr", [(k, 0.2, 0.1, 50 + k) for k in range(COLUMNS)])
    table(folder / "stages.csv", "column,stages", [(k, 8 if k < 20 else 16) for k in range(COLUMNS)])
    table(folder / "stars.csv", "t,roll,pitch,yaw,sigma", [(k, 1e-6, 2e-6, 0.0, 1e-5) for k in t[::16]])
    table(
        folder / "gyro.csv",
        "t_start,t_end,roll,pitch,yaw,sigma",
        [(a, a + 16 * PERIOD, 1e-7, 0.0, 0.0, 1e-7) for a in t[::16]],
    )
    table(
        folder / "control.csv",
        "x,y,z,sigma,image,line,column",
        [(10.0, 100.0, 0.0, 1.0, "PAN", 28.0, 22.0), (-10.0, 50.0, 1.0, 1.0, "XS", 4.0, 16.0)],
    )
    table(folder / "features.csv", "image,line,column", [("PAN", 20, 20), ("PAN", 30, 10)])
    table(
        folder / "psd.csv", "f,roll,pitch,yaw", [(f, 1e-12 / f, 1e-12 / f, 1e-12) for f in (1.0, 10.0, 900.0)]
    )
    text = BANDS.replace(
        'image = "PAN.tif"', 'image = "PAN.tif"\nmask = "mask.tif"\nline_times = "times.csv"'
    )
    more = 'quality = "quality.csv"\nstages = "stages.csv"\ntime_reference = "centre"'
    text = text.replace("look_ahead = 5e-5", f"look_ahead = 5e-5\n{more}", 1)
    text = text.replace("ifov = 5e-6", 'directions = "directions.csv"', 1)
    (folder / "acquisition.toml").write_text(
        f"""
[acquisition]
name = "strip"
epoch = "2026-01-01T00:00:00Z"
control_points = "control.csv"

[platform]
kind = "level-flight"
altitude = {ALTITUDE}
ground_speed = {SPEED}
{text}
[surface]
dem = "dem.tif"
height_sigma = 3.0

[[attitude_sensor]]
kind = "star-tracker"
table = "stars.csv"
alignment_sigma = 1e-4
bias_sigma = 1e-5
correlation_time = 10.0

[[attitude_sensor]]
kind = "gyro"
table = "gyro.csv"

[[control_point]]
x = 0.0
y = 80.0
z = 0.0
sigma = 2.0
image = "PAN"
line = 22.0
column = 19.5

[known_motion]
psd = "psd.csv"

[matching]
{WINDOWS}
step = 4
passes = 2
pairs = [["PAN", "XS"]]
search_px = [4, 4]
select = "listed"
features = "features.csv"
weighting = "covariance"
"""
    )


def orbit(folder: Path, axes: str) -> None:
    """Positions and attitudes over the equator, flying north; `axes` "csv" or "ccsds"."""
    t = np.linspace(-2.0, 2.0, 9)
    radius, rate = 6378137.0 + ALTITUDE, 7.5e3 / (6378137.0 + ALTITUDE)
    place = radius * np.stack([np.cos(rate * t), 0 * t, np.sin(rate * t)], axis=1)
    speed = radius * rate * np.stack([-np.sin(rate * t), 0 * t, np.cos(rate * t)], axis=1)
    down = -place / radius
    ahead = speed / np.linalg.norm(speed, axis=1)[:, None]
    turn = Rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down], axis=-1)).as_quat()
    if axes == "csv":
        table(folder / "positions.csv", "t,x,y,z", np.column_stack([t, place]))
        table(folder / "attitudes.csv", "t,qx,qy,qz,qw", np.column_stack([t, turn]))
        return
    from sightline.io.formats.ccsds import write_aem

    instants = [f"2026-01-01T00:00:{s:06.3f}" for s in 10.0 + t]
    rows = [
        " ".join([at, *map(str, p / 1e3), *map(str, v / 1e3)])
        for at, p, v in zip(instants, place, speed, strict=True)
    ]
    head = f"""CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2026-01-01T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = EXAMPLE
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME = ITRF
TIME_SYSTEM = UTC
START_TIME = {instants[0]}
STOP_TIME = {instants[-1]}
META_STOP
"""
    (folder / "orbit.oem").write_text(head + "\n".join(rows) + "\n")
    write_aem(folder / "attitude.aem", t, turn, "2026-01-01T00:00:10Z")


@seed
def orbit_csv(folder: Path) -> None:
    bands(folder)
    orbit(folder, "csv")
    from rasterio.transform import Affine

    heights = np.random.default_rng(5).normal(100.0, 3.0, (30, 30)).astype(np.float32)
    place = {"transform": Affine(0.001, 0, -0.015, 0, -0.001, 0.02), "crs": "EPSG:4326"}
    write_tif(folder / "dem.tif", heights, **place)
    write_tif(folder / "geoid.tif", np.full((30, 30), 20.0, np.float32), **place)
    (folder / "acquisition.toml").write_text(
        f"""
[acquisition]
epoch = "2026-01-01T00:00:10Z"
[platform]
kind = "ephemeris"
positions = "positions.csv"
attitudes = "attitudes.csv"
{BANDS}
[surface]
dem = "dem.tif"
datum = "geoid"
geoid = "geoid.tif"
[matching]
{WINDOWS}
"""
    )


@seed
def orbit_ccsds(folder: Path) -> None:
    bands(folder)
    orbit(folder, "ccsds")
    (folder / "acquisition.toml").write_text(
        f"""
[acquisition]
epoch = "2026-01-01T00:00:10Z"
[platform]
kind = "ephemeris"
positions = "orbit.oem"
attitudes = "attitude.aem"
{BANDS}
[surface]
height = 100.0
radii = [6378137.0, 6356752.3]
[matching]
{WINDOWS}
"""
    )


#: Elements of a low orbit, in both forms.
TWO_LINES = """1 99999U 26001A   26001.00000000  .00000000  00000-0  10000-4 0  9998
2 99999  97.5000  10.0000 0010000  90.0000 270.0000 15.00000000    15
"""
MEAN_ELEMENTS = """CCSDS_OMM_VERS = 2.0
CREATION_DATE = 2026-01-01T00:00:00
ORIGINATOR = TEST
OBJECT_NAME = EXAMPLE
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME = TEME
TIME_SYSTEM = UTC
MEAN_ELEMENT_THEORY = SGP4
EPOCH = 2026-01-01T00:00:00
MEAN_MOTION = 15.0
ECCENTRICITY = 0.001
INCLINATION = 97.5
RA_OF_ASC_NODE = 10.0
ARG_OF_PERICENTER = 90.0
MEAN_ANOMALY = 270.0
BSTAR = 0.00001
"""


@seed
def orbit_stars(folder: Path) -> None:
    """The same in axes of the stars, of two rows of an old table: an OEM in gzip and XML, one attitude."""
    from sightline.geometry.earth_orientation import fixed_axes
    from sightline.io.formats.ccsds import read_oem, write_oem
    from sightline.io.formats.ccsds_attitude import read_aem
    from sightline.io.formats.earth_orientation import read_earth_orientation

    orbit_ccsds(folder)
    rows = [
        f"2026   1   {day}   0  {61040 + day}.00 0.1 0.3 0.1 0 0 0 0 0.001 0.03 0.03 0.002 0 0 0 0 0"
        for day in (1, 2)
    ]
    (folder / "earth.c04").write_text("# made for a test\n" + "\n".join(rows) + "\n")
    epoch = "2026-01-01T00:00:10Z"
    given, turned = read_oem(folder / "orbit.oem", epoch), read_aem(folder / "attitude.aem", epoch)
    axes = fixed_axes("EME2000", given.t, (61041, 47.0), read_earth_orientation(folder / "earth.c04"))
    place = np.einsum("nji,nj->ni", axes.turn, given.position)
    speed = np.einsum("nji,nj->ni", axes.turn, given.velocity - np.einsum("nij,nj->ni", axes.change, place))
    middle = Rotation.from_matrix(axes.turn[4]).inv() * Rotation.from_quat(turned.quat_xyzw[4])
    write_oem(folder / "plain.oem", given.t, place, speed, epoch, frame="EME2000")
    text = (folder / "plain.oem").read_text()
    (folder / "plain.oem").unlink()
    (folder / "orbit.oem").write_bytes(gzip.compress(text.encode(), mtime=0))
    (folder / "attitude.aem").unlink()
    numbers = "\n".join(
        f"{key} = {v}" for key, v in zip(("Q1", "Q2", "Q3", "QC"), middle.as_quat(), strict=True)
    )
    (folder / "attitude.apm").write_text(
        "CCSDS_APM_VERS = 2.0\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\nMETA_START\n"
        "OBJECT_NAME = EXAMPLE\nOBJECT_ID = 2026-001A\nCENTER_NAME = EARTH\nTIME_SYSTEM = UTC\nMETA_STOP\n"
        f"EPOCH = {epoch[:-1]}\nQUAT_START\nREF_FRAME_A = EME2000\nREF_FRAME_B = "
        f"SC_BODY_1\n{numbers}\nQUAT_STOP\n"
    )
    states = "".join(
        "<stateVector>" + "".join(f"<{key}>{value}</{key}>" for key, value in zip(
            ("EPOCH", "X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"), line.split(), strict=True
        )) + "</stateVector>\n"
        for line in text.splitlines() if line.startswith("2026-")
    )  # fmt: skip
    meta = "".join(
        f"<{key}>{value}</{key}>"
        for key, value in (
            line.split(" = ") for line in text[text.index("OBJECT") :].splitlines() if " = " in line
        )
    )
    (folder / "orbit.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<oem id="CCSDS_OEM_VERS" '
        'version="2.0">\n<header><CREATION_DATE>'
        "2026-01-01T00:00:00</CREATION_DATE><ORIGINATOR>TEST</ORIGINATOR></header>\n<body><segment><metadata>"
        f"{meta}</metadata>\n<data>{states}</data></segment></body></oem>\n"
    )
    (folder / "orbit.tle").write_text(TWO_LINES)
    rows = [(345618.0 + 0.5 * k, 0.8, 0.2 + 1e-6 * k, 3e3, *[0.0] * 13) for k in range(9)]
    (folder / "sbet.out").write_bytes(np.array(rows, dtype="<f8").tobytes())
    (folder / "elements.omm").write_text(MEAN_ELEMENTS)
    toml = (folder / "acquisition.toml").read_text().replace("attitude.aem", "attitude.apm")
    named = 'earth_orientation = "earth.c04"\n'
    (folder / "acquisition.toml").write_text(toml.replace("attitudes = ", named + "attitudes = ", 1))


@seed
def sensor_model(folder: Path) -> None:
    """A line-scan ISD of a circular orbit over the north of a turning body, and its model state."""
    lines, samples, period = LINES, COLUMNS, 2e-3
    centre, radius, rate = 297088762.6, 3396.19 + 300.0, 3.4 / 3696.0
    t = centre + np.linspace(-1.0, 1.0, 9)
    angle = rate * (t - centre)
    place = radius * np.stack([np.cos(angle), 0 * t, np.sin(angle)], axis=1)
    speed = radius * rate * np.stack([-np.sin(angle), 0 * t, np.cos(angle)], axis=1)
    down = -place / radius
    ahead = speed / np.linalg.norm(speed, axis=1)[:, None]
    # sensor: x towards flight, y across, z down
    inertial_from_sensor = Rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down], axis=-1))
    pointing = inertial_from_sensor.inv().as_quat(scalar_first=True)
    isd = {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "image_lines": lines,
        "image_samples": samples,
        "line_scan_rate": [[0.5, -0.5 * lines * period, period]],
        "center_ephemeris_time": centre,
        "radii": {"semimajor": 3396.19, "semiminor": 3376.2, "unit": "km"},
        "body_rotation": {
            "ephemeris_times": [t[0], t[-1]],
            "quaternions": [[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 7e-5]],
            "reference_frame": 1,
        },
        "instrument_pointing": {
            "ephemeris_times": t.tolist(),
            "quaternions": pointing.tolist(),
            "reference_frame": 1,
            "constant_rotation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        },
        "instrument_position": {
            "ephemeris_times": t.tolist(),
            "positions": place.tolist(),
            "velocities": speed.tolist(),
            "reference_frame": 1,
            "unit": "km",
        },
        "optical_distortion": {"radial": {"coefficients": [0.0, 1e-9, 0.0]}},
        "focal_length_model": {"focal_length": 350.0},
        "focal2pixel_lines": [0.0, 142.857, 0.0],
        "focal2pixel_samples": [0.0, 0.0, 142.857],
        "detector_center": {"line": 0.0, "sample": samples / 2},
        "starting_detector_line": 0,
        "starting_detector_sample": 0,
        "detector_sample_summing": 1,
    }
    (folder / "isd.json").write_text(json.dumps(isd))
    frame = isd | {"name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL", "detector_line_summing": 1}
    frame["focal2pixel_samples"] = [0.0, 0.0, -142.857]  # lines along x: samples against y, or it is mirrored
    (folder / "frame.json").write_text(json.dumps(frame))
    (folder / "clock.tsc").write_text("KPL/SCLK\n\\begindata\nSCLK_DATA_TYPE_74 = ( 1 )\n\\begintext\n")
    state = {
        "m_modelName": isd["name_model"],
        "m_nLines": lines,
        "m_nSamples": samples,
        "m_intTimeLines": [0.5],
        "m_intTimeStartTimes": [-0.5 * lines * period],
        "m_intTimes": [period],
        "m_centerEphemerisTime": centre,
        "m_majorAxis": 3396190.0,
        "m_minorAxis": 3376200.0,
        "m_positions": (1e3 * place).ravel().tolist(),
        "m_velocities": (1e3 * speed).ravel().tolist(),
        "m_t0Ephem": -1.0,
        "m_dtEphem": 0.25,
        "m_quaternions": inertial_from_sensor.as_quat().ravel().tolist(),
        "m_t0Quat": -1.0,
        "m_dtQuat": 0.25,
        "m_distortionType": 0,
        "m_opticalDistCoeffs": [0.0, 0.0, 0.0],
        "m_focalLength": 350.0,
        "m_iTransL": isd["focal2pixel_lines"],
        "m_iTransS": isd["focal2pixel_samples"],
        "m_detectorLineOrigin": 10.0,
        "m_detectorSampleOrigin": samples / 2 - 35.0,  # as far as the body turns between centre and epoch
        "m_startingDetectorLine": 0.0,
        "m_startingDetectorSample": 0.0,
        "m_detectorSampleSumming": 1.0,
        "m_currentParameterValue": [0.0] * 16,
    }
    (folder / "state.json").write_text(f"{isd['name_model']}\n{json.dumps(state)}")
    bands(folder)
    (folder / "acquisition.toml").write_text(
        f"""
[matching]
{WINDOWS}
[platform]
kind = "camera-model"
[[band]]
name = "PAN"
image = "PAN.tif"
model = "isd.json"
[[band]]
name = "XS"
image = "XS.npy"
model = "state.json"
"""
    )


@seed
def products(folder: Path) -> None:
    """Two scenes of one strip as XML, and one as text."""
    size = {"rows": LINES, "columns": COLUMNS, "pitch": 0.05, "before": 0.2}
    sentinel2_files.write_granule(folder)
    WorldViewScene(**size, image="PAN.tif").xml(folder, "PAN.XML")
    WorldViewScene(**size, origin=(4.4, 8.0), image="XS.npy").text(folder, "XS")
    bands(folder)
    (folder / "acquisition.toml").write_text(
        f"""
[matching]
{WINDOWS}
[platform]
kind = "camera-model"
[[band]]
name = "PAN"
image = "PAN.tif"
model = "PAN.XML"
[[band]]
name = "XS"
image = "XS.npy"
model = "XS.IMD"
"""
    )


@seed
def maker_products(folder: Path) -> None:
    """Scenes as SPOT 6, SPOT 5 and Pleiades describe them."""
    maker_files.dimap2(folder, rows=40, columns=30)
    maker_files.dimap1(folder, rows=60, columns=30)
    maker_files.pleiades(folder, rows=40, columns=30, seconds=1.0)


@seed
def product_variants(folder: Path) -> None:
    """Parts of an image in tiles, attitudes by polynomials, tiles of a WorldView, and raw bands."""
    one = '<Data_File tile_R="1" tile_C="{0}"><DATA_FILE_PATH href="IMG_{1}_R1C{0}.TIF"/></Data_File>'
    parts = "</Data_Files><Data_Files>".join(
        "".join(one.format(number, part) for number in (1, 2)) for part in ("RGB", "NED")
    )
    size = '<Tile_Set><Regular_Tiling><NTILES_SIZE nrows="64" ncols="32"/></Regular_Tiling></Tile_Set>'
    changes = [
        ('<Data_File><DATA_FILE_PATH href="IMG_R1C1.TIF"/></Data_File>', parts),
        ("<NBANDS>", f"{size}<NBANDS>"),
    ]
    bands = ("DB", "B", "G", "R", "RE", "NIR")
    maker_files.dimap2(
        folder, rows=40, columns=40, bands=bands, changes=changes, polynomials=True, name="DIM_PNEO3.XML"
    )
    tiles = "".join(
        f"<TILE><FILENAME>R1C{k + 1}.TIF</FILENAME><ULROWOFFSET>0</ULROWOFFSET><ULCOLOFFSET>{32 * k}"
        f"</ULCOLOFFSET><LRROWOFFSET>{LINES - 1}</LRROWOFFSET>"
        f"<LRCOLOFFSET>{min(32 * k + 31, COLUMNS - 1)}</LRCOLOFFSET></TILE>"
        for k in range(-(-COLUMNS // 32))
    )
    WorldViewScene(rows=LINES, columns=COLUMNS, pitch=0.05, before=0.2).xml(folder, "TILES.XML")
    text = (folder / "TILES.XML").read_text()
    begin, end = text.index("<TIL>"), text.index("</TIL>")
    count = f"<NUMTILES>{-(-COLUMNS // 32)}</NUMTILES>"
    (folder / "TILES.XML").write_text(f"{text[:begin]}<TIL>{count}{tiles}{text[end:]}")
    maker_files.pleiades(folder, rows=40, columns=30, seconds=1.0)
    for name, shape in {"PA": (40, 32), "B0": (10, 8)}.items():
        np.save(folder / f"raw_{name}.npy", noise(7, shape))


@seed
def mirror(folder: Path) -> None:
    run(
        "simulate",
        "line-of-sight",
        "--case",
        "mirror-leo",
        "--lines",
        127,
        "--columns",
        224,
        "--out",
        folder,
        "--overwrite",
    )


@seed
def spin(folder: Path) -> None:
    run(
        "simulate",
        "line-of-sight",
        "--case",
        "spin-leo",
        "--lines",
        127,
        "--columns",
        224,
        "--out",
        folder,
        "--overwrite",
    )


@seed
def turning_frames(folder: Path) -> None:
    """Frames with filter strips on a spinning body, far from what it sees, and what was recovered of it."""
    frames = ""
    for k in range(3):
        (folder / f"e{k}.npy").write_bytes(npy(noise(k, (48, 60))))
        (folder / f"m{k}.npy").write_bytes(npy((noise(k + 9, (48, 60)) > 890).astype(np.uint8)))
        frames += f'[[frame]]\nname = "{k}"\nimage = "e{k}.npy"\nmask = "m{k}.npy"\ntime = {0.5 * k}\n'
    (folder / "acquisition.toml").write_text(
        f"""
[platform]
kind = "spin"
attitude = [0.0, 0.0, 0.0, 1.0]
attitude_sigma = 0.0
axis = [1.0, 0.0, 0.0]
axis_sigma = 1e-3
rate = 0.02
rate_sigma = 1e-5
[surface]
kind = "infinity"
parallax_sigma = 1e-6
[camera]
body_from_camera = [0.0, 0.0, 0.0, 1.0]
focal_length_px = 600.0
focal_length_sigma_px = 1.0
principal_point_px = [0.0, 30.0]
principal_point_sigma_px = 1.0
distortion = [-0.1, 0.01]
distortion_sigma = 1e-3
common_line_sigma_px = 1.0
[[camera.strip]]
name = "red"
first_line = 0
lines = 24
axis_line = 10.0
axis_line_sigma_px = 1.0
scale_sigma = 1e-4
[[camera.strip]]
name = "blue"
first_line = 24
lines = 24
axis_line = -8.0
scale_sigma = 1e-4
{frames}"""
    )
    from sightline.io.acquisition.load import load_acquisition
    from sightline.motion.spin.solve import SpinUnknowns, layers_of, spin_statics

    read = load_acquisition(folder / "acquisition.toml")
    assert read.spin is not None and read.attitude_sigma is not None
    statics = spin_statics(read.frames, read.surface, read.lens, read.chip, read.parallax_sigma)
    layers = layers_of(read.surface, read.chip)
    names = SpinUnknowns(read.frames, read.spin, read.attitude_sigma, statics, np.ones(3), layers).names
    still = {"departure": {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}}
    summary = {
        "images": list(read.names),
        "inputs": read.input_hashes(),
        "statics": [{"name": name, "value": 0.0} for name in names],
        "spin": {"exposures": [still] * 3},
    }
    (folder / "result").mkdir()
    (folder / "result" / "summary.json").write_text(json.dumps(summary))


@seed
def frames(folder: Path) -> None:
    """Frames of a matrix instrument, with what is not known of its lens."""
    text = ""
    for k in range(3):
        write_tif(folder / f"f{k}.tif", noise(k, (3, 40, 60)), count=3)
        band = 1 if k else '"luminance"'
        text += f'[[frame]]\nimage = "f{k}.tif"\nimage_band = {band}\ntime = {0.5 * k}\n'
    (folder / "acquisition.toml").write_text(
        f"""
[acquisition]
epoch = "2026-01-01T00:00:00Z"
[platform]
kind = "level-flight"
altitude = 420e3
ground_speed = 7200.0
[camera]
shape = [40, 60]
focal_length_px = 2000.0
focal_length_sigma_px = 10.0
principal_point_px = "estimate"
distortion = [-0.05]
distortion_sigma = 0.01
readout_time = 0.01
{text}
[surface]
height = 0.0
height_sigma = 10.0
"""
    )


# Photographs ----------------------------------------------------------------------------------------------


def exif_of(entries: dict[int, object], place: dict[int, object], photo: dict[int, object]) -> bytes:
    """A TIFF structure, big-endian, of IFD0 with GPS and EXIF directories behind it."""

    def field(tag: int, value: object) -> tuple[int, int, int, bytes]:
        if isinstance(value, str):
            data = value.encode() + b"\0"
            return tag, 2, len(data), data
        if isinstance(value, bytes):
            return tag, 1, len(value), value
        if isinstance(value, int):
            return tag, 3, 1, struct.pack(">H", value)
        pairs = [round(1_000_000 * part) for part in value]  # type: ignore[attr-defined]
        return tag, 5, len(pairs), b"".join(struct.pack(">II", part, 1_000_000) for part in pairs)

    def directory(fields: list[tuple[int, int, int, bytes]], at: int) -> bytes:
        head, behind = struct.pack(">H", len(fields)), b""
        start = at + 2 + 12 * len(fields) + 4
        for tag, kind, count, data in sorted(fields):
            if len(data) <= 4:
                held = data.ljust(4, b"\0")
            else:
                held = struct.pack(">I", start + len(behind))
                behind += data + b"\0" * (len(data) % 2)
            head += struct.pack(">HHI", tag, kind, count) + held
        return head + b"\0\0\0\0" + behind

    own = [field(tag, value) for tag, value in entries.items()]
    two = [(0x8769, 4, 1, b"\0\0\0\0"), (0x8825, 4, 1, b"\0\0\0\0")]
    first = len(directory([*own, *two], 8))
    more = directory([field(tag, value) for tag, value in photo.items()], 8 + first)
    two = [
        (0x8769, 4, 1, struct.pack(">I", 8 + first)),
        (0x8825, 4, 1, struct.pack(">I", 8 + first + len(more))),
    ]
    gps = directory([field(tag, value) for tag, value in place.items()], 8 + first + len(more))
    return b"MM\0*\0\0\0\x08" + directory([*own, *two], 8) + more + gps


XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 xmlns:Camera="http://pix4d.com/camera/1.0/"
 drone-dji:GimbalYawDegree="+12.50" drone-dji:GimbalPitchDegree="-89.90" drone-dji:GimbalRollDegree="+0.00"
 drone-dji:GpsLatitude="46.840000" drone-dji:GpsLongitude="-91.990000" drone-dji:RtkStdLon="0.012"
 drone-dji:RtkStdLat="0.013" drone-dji:RtkStdHgt="0.030">
<Camera:CentralWavelength>668</Camera:CentralWavelength><Camera:RigCameraIndex>0</Camera:RigCameraIndex>
<Camera:PerspectiveFocalLength>205.9</Camera:PerspectiveFocalLength>
<Camera:PerspectiveFocalLengthUnits>px</Camera:PerspectiveFocalLengthUnits>
<Camera:PrincipalPoint>2.4,1.8</Camera:PrincipalPoint>
<Camera:PerspectiveDistortion>-0.1,0.01,0.0,0.001,-0.001</Camera:PerspectiveDistortion>
</rdf:Description></rdf:RDF></x:xmpmeta>"""


def degrees(value: float) -> list[float]:
    minutes = 60.0 * (value % 1.0)
    return [value // 1.0, minutes // 1.0, 60.0 * (minutes % 1.0)]


#: Lines and columns of frames: few that can be followed, of a mosaic twice as many.
FRAME, MOSAIC = (122, 162), (244, 250)


def seen(shape: tuple[int, int] = FRAME) -> Flight:
    """Six frames of `shape` that see what those of `flight` see."""
    made, scale = flight(6), shape[0] / 24
    made.toml = made.toml.replace("[24, 32]", str(list(shape))).replace("40.0", f"{40.0 * scale:.6g}")
    for k in range(6):
        made.images[f"f{k}.npy"] = npy(noise(k, shape, 255).astype(np.uint8))
    return made


def photograph(path: Path, second: int, latitude: float, xmp: str = XMP) -> None:
    """A JPEG with EXIF and XMP."""
    write_tif(path, noise(second, FRAME, 255).astype(np.uint8), driver="JPEG")
    exif = exif_of(
        {0x010F: "Maker", 0x0110: "Model", 0x0112: 1},
        {
            0x0001: "N", 0x0002: degrees(latitude), 0x0003: "W", 0x0004: degrees(91.99), 0x0005: b"\0",
            0x0006: [140.0],
        },
        {
            0x9003: f"2026:05:01 10:00:{second:02d}", 0x9291: "25", 0x920A: [8.0], 0xA405: 28,
            0xA20E: [200.0], 0xA210: 4,
        },
    )  # fmt: skip
    jpeg = path.read_bytes()
    parts = (b"Exif\0\0" + exif, b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode())
    segments = b"".join(b"\xff\xe1" + struct.pack(">H", len(part) + 2) + part for part in parts)
    path.write_bytes(jpeg[:2] + segments + jpeg[2:])


@seed
def photographs(folder: Path) -> None:
    """A folder of photographs as frames, and the same as an acquisition."""
    (folder / "photos").mkdir()
    for k in range(5):
        photograph(folder / "photos" / f"p{k}.jpg", k, 46.84 + 5e-5 * k)
    (folder / "sequence.toml").write_text(
        """
frames = "photos"
position_sigma = 3.0
position_bias_sigma = 3.0
attitude_sigma = 0.035

[camera]
body_from_camera = [0.0, 0.0, 0.70710678, 0.70710678]

[surface]
height = 0.0
height_sigma = 5.0
"""
    )
    frames = "".join(
        f'[[frame]]\nimage = "photos/p{k}.jpg"\ntime = "exif"\ntime_sigma = 0.29\n' for k in range(3)
    )
    table(
        folder / "positions.csv",
        "t,x,y,z",
        [(k, -91.99, 46.84 + 5e-5 * k, 140.0) for k in range(-2, 8)],
    )
    (folder / "acquisition.toml").write_text(
        f"""
[acquisition]
epoch = "2026-05-01T10:00:00Z"
[platform]
kind = "ephemeris"
positions = "positions.csv"
[world]
frame = "lonlat"
[camera]
focal_length_px = 203.0
focal_length_sigma_px = 2.0
{frames}"""
    )


# Sequences ------------------------------------------------------------------------------------------------


@seed
def flown(folder: Path) -> None:
    """Frames, positions and attitudes as tables, control points, wavelengths of an ENVI header, maps."""
    made = seen()
    made.toml = made.toml.replace(
        'frames = "frames.csv"', 'frames = "frames.csv"\ncontrol_points = "control.csv"'
    )
    made.toml = made.toml.replace("[camera]", '[camera]\nwavelength_nm = "filter.hdr"\nreadout_time = 0.01')
    made.toml += '\n[subset]\noverlap = 0.8\n\n[cube]\ngsd = 5.0\nbands = 3\nformats = ["tif", "envi"]\n'
    made.extra["control.csv"] = (
        "x,y,z,sigma,image,line,column\n0,5,0,0.1,0,50.3,80.5\n0,5,0,0.1,1,60.5,80.5\n"
        "10,20,0,0.1,4,60.5,60.2\n"
    )
    waves = ", ".join(str(450 + 3 * k) for k in range(FRAME[0]))
    made.extra["filter.hdr"] = (
        f"ENVI\nbands = {FRAME[0]}\nwavelength units = Nanometers\nwavelength = {{{waves}}}\n"
    )
    made.write(folder)


@seed
def rig(folder: Path) -> None:
    """Two cameras that are exposed together, by a table of their images."""
    made = seen()
    one = made.toml.index("[camera]")
    rest = made.toml.index("\n[", one + 1) + 1 if "\n[" in made.toml[one + 1 :] else len(made.toml)
    lens = made.toml[one + len("[camera]") : rest].rstrip()
    made.toml = (
        made.toml[:one]
        + made.toml[rest:]
        + "".join(
            f'\n[[camera]]\nname = "{name}"\nwavelength_nm = {nm}{lens}\n{offset}'
            for name, nm, offset in (
                ("green", 560.0, ""),
                (
                    "NIR",
                    840.0,
                    "orientation_offset = [0.002, 0.0, 0.0]\nposition_offset = [0.0, 0.04, 0.0]\n",
                ),
            )
        )
    )
    made.extra["frames.csv"] = "capture,camera,t,image\n" + "".join(
        f"{k},{name},{0.5 * k},f{k}.npy\n" for k in range(6) for name in ("green", "NIR")
    )
    made.write(folder)


@seed
def flown_lonlat(folder: Path) -> None:
    """Places by geo.txt and control points by gcp_list.txt, times as UTC, a DEM of the ground."""
    from rasterio.transform import Affine

    made = seen(MOSAIC)
    names = [f"f{k}.npy" for k in range(6)]
    latitude = [50.0 + 4.5e-5 * k for k in range(6)]
    geo = [f"{name} 20.0 {lat} 150.0" for name, lat in zip(names, latitude, strict=True)]
    made.extra["geo.txt"] = "\n".join(["EPSG:4326", *geo]) + "\n"
    made.extra["gcp_list.txt"] = (
        "EPSG:4326\n20.0 50.00005 50.0 124.5 121.5 f1.npy a\n20.0001 50.0001 50.0 124.5 121.5 f2.npy b\n"
    )
    made.toml = f"""
frames = "frames.csv"
geo = "geo.txt"
gcp_list = "gcp_list.txt"
[sequence]
epoch = "2026-01-01T00:00:00Z"
[world]
frame = "lonlat"
[camera]
shape = {list(MOSAIC)}
focal_length_px = 406.7
mosaic_nm = [[450, 550], [650, 750]]
[surface]
dem = "dem.tif"
height_sigma = 2.0
"""
    for k, row in enumerate(made.frames):
        row[1] = f"2026-01-01T00:00:{0.5 * k:06.3f}Z"
    made.write(folder)
    heights = np.random.default_rng(5).normal(50.0, 1.0, (30, 30)).astype(np.float32)
    write_tif(
        folder / "dem.tif", heights, transform=Affine(1e-4, 0, 19.9985, 0, -1e-4, 50.0015), crs="EPSG:4326"
    )


@seed
def modelled(folder: Path) -> None:
    """One flight by models of other programs: COLMAP text and binary, OpenSfM, OPK and YPR tables."""
    from sightline.geometry.instrument import AreaDetector
    from sightline.io.formats.colmap import write_colmap_model
    from sightline.io.formats.opensfm import write_opensfm
    from sightline.io.formats.reconstruction import Reconstruction

    made = seen()
    names = tuple(f"f{k}.npy" for k in range(6))
    position = np.array([[0.0, 5.0 * k, 100.0] for k in range(6)])
    camera = Rotation.from_matrix([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    detector = AreaDetector("camera", FRAME, 203.0, (60.5, 80.5))
    points = np.array([[x, y, 0.0] for x in (-5.0, 0.0, 5.0) for y in (0.0, 10.0, 20.0)])
    model = Reconstruction(
        names,
        (detector,),
        np.zeros(6, dtype=int),
        position,
        Rotation.concatenate([camera] * 6),
        points,
        np.full(9, 0.5),
    )
    place = (20.0, 50.0, 50.0)
    for name, binary in (("text", False), ("binary", True)):
        write_colmap_model(folder / name, model, binary=binary)
        (folder / name / "origin.csv").write_text("longitude,latitude,height\n20.0,50.0,50.0\n")
    write_opensfm(folder / "reconstruction.json", model, place)
    for name, header, angles in (("opk", "omega,phi,kappa", "0,0,180"), ("ypr", "yaw,pitch,roll", "0,0,0")):
        rows = [f"{k},{x},{y},{z},{angles}" for k, (x, y, z) in zip(names, position, strict=True)]
        (folder / f"{name}.csv").write_text(
            "\n".join(["# origin = 20.0,50.0,50.0", f"frame,x,y,z,{header}", *rows]) + "\n"
        )
    rest = f"""
position_sigma = 0.5
attitude_sigma = 0.002
[world]
frame = "lonlat"
[camera]
shape = {list(FRAME)}
focal_length_px = 203.0
[surface]
height = 50.0
"""
    made.write(folder)
    for name, poses in (
        ("text", "text"),
        ("binary", "binary"),
        ("opensfm", "reconstruction.json"),
        ("opk", "opk.csv"),
    ):
        (folder / f"{name}.toml").write_text(f'frames = "frames.csv"\nposes = "{poses}"{rest}')
    (folder / "sequence.toml").unlink()


@seed
def georeferenced(folder: Path) -> None:
    """What `georeference` leaves, and its truth."""
    from sightline.io.results.poses import (
        FocalLength,
        FramePoseTable,
        PoseCovariance,
        write_pose_covariance,
        write_poses,
    )

    count = 6
    turn = np.tile(NORTH, (count, 1))
    position = np.array([[0.0, 5.0 * k, 100.0] for k in range(count)])
    names, t = tuple(map(str, range(count))), 0.5 * np.arange(count)
    sigma = np.tile([0.5] * 3 + [5e-4] * 3, (count, 1))
    made = folder / "result"
    made.mkdir()
    source = ("solved", "estimated", "estimated", "estimated", "interpolated", "solved")
    write_poses(made / "poses.csv", FramePoseTable(names, t, position, turn, sigma, source))
    square = np.tile(np.diag([0.25] * 3 + [0.25e-6] * 3), (count, 1, 1))
    focal = FocalLength(40.5, 0.01 * np.ones(7))
    follow, pairs = 0.5 * square[1:], np.zeros((count, 6, count, 6))
    for k, own in enumerate(square):
        pairs[k, :, k] = own
    covariance = PoseCovariance(names, square, np.zeros(6), np.eye(6), focal, follow, pairs, 1e-3)
    write_pose_covariance(made / "covariance.npz", covariance)
    table(folder / "truth-focal.csv", "camera,focal_length_px", [("camera", 40.0)])
    used = [
        (k, 0.5 * int(k), word, 3, 3, 0.1, 1.0, 0, 1, 0.8, 0.1, "")
        for k, word in zip(names, source, strict=True)
    ]
    heads = "frame,t,source,windows,sightings,residual_px,sharpness,stretch,subset,overlap,parallax,reason"
    table(made / "frames_used.csv", heads, used)
    summary = {"name": "x", "sources": {"solved": 2}, "inputs": {}, "world": {"frame": "local"}}
    summary |= {"result": "SequencePoses", "stages": {"all poses": 1.0}, "taken_over": {}, "warnings": []}
    (made / "summary.json").write_text(json.dumps(summary))
    rows = [(k, a, *(p + 0.3), *NORTH) for k, a, p in zip(names, t, position, strict=True)]
    table(folder / "poses-truth.csv", "frame,t,x,y,z,qx,qy,qz,qw", rows)


# Stereo ---------------------------------------------------------------------------------------------------


@seed
def pair(folder: Path) -> None:
    """Two spacecraft, points that both saw, control points; the same as observations; a result."""
    from sightline.io.results.stereo import write_covariance, write_orientation

    made = scene(shots=4, points=10)
    made.toml = made.toml.replace(
        'matches = "matches.csv"', 'matches = "matches.csv"\ncontrol_points = "control.csv"'
    )
    point = made.points[3]
    made.extra["control.csv"] = "x,y,z,sigma,point\n{},{},{},10.0,3\n".format(*point)
    made.write(folder)
    text = made.toml.replace('matches = "matches.csv"', 'observations = "observations.csv"')
    (folder / "observations.toml").write_text(
        text.replace("[surface]", "[surface]\nheight = 0.0\nheight_sigma = 500.0")
    )
    (folder / "result").mkdir()
    write_orientation(
        folder / "result" / "orientation.csv", ("1", "2"), np.zeros((2, 3)), np.full((2, 3), 1e-5)
    )
    write_covariance(folder / "result" / "covariance.csv", ("1", "2"), 1e-10 * np.eye(6))


@seed
def plan(folder: Path) -> None:
    (folder / "stereo.toml").write_text(
        """
[camera]
shape = [700, 700]
focal_length_px = 30558.0
[noise]
sigma_px = 0.1
sigma_position = 7.5
sigma_attitude = 8.7e-6
[plan]
separation = 60.0
window = 60.0
shots = 4
points = 10
altitude = 500e3
inclination_deg = 97.4
latitude_deg = 10.0
"""
    )


@seed
def pictures(folder: Path) -> None:
    """Frames of two cameras in which points are to be found."""
    made = scene(shots=2, points=4)
    made.toml = made.toml.replace('matches = "matches.csv"', 'images = "images.csv"').replace(
        "shape = [600, 700]", "shape = [60, 70]"
    )
    made.toml += "height = 0.0\n"
    rows = []
    for k in (1, 2):
        for n in range(2):
            (folder / f"c{k}s{n}.npy").write_bytes(npy(noise(10 * k + n, (60, 70))))
            rows.append(f"{k},{n},c{k}s{n}.npy,mask.npy")
    (folder / "mask.npy").write_bytes(npy(np.zeros((60, 70), np.uint8)))
    made.extra["images.csv"] = "\n".join(["camera,shot,image,mask", *rows]) + "\n"
    made.write(folder)


@seed
def scene_files(folder: Path) -> None:
    """What simulated scenes are made of."""
    (folder / "pass.toml").write_text(
        'kind = "stereo"\nseed = 3\nshots = 2\npoints = 12\nsigma_px = 0.2\nfov = 0.03\n'
        'relief = "smooth"\ntrack_shots = [1, 2]\ncontrol_points = 2\n'
    )
    (folder / "flight.toml").write_text(
        'kind = "frames"\ncase = "small"\nframes = 4\nshape = [122, 136]\ndistortion = [-0.1]\n'
        'missing = ["1-1"]\nwater = [[2, 3]]\njitter = 1e-3\nfilter = "pan"\ntruth_bands = 0\n'
    )
    (folder / "strip.toml").write_text(
        'case = "clouds"\nlines = 520\ncolumns = 200\nnames = ["A", "B"]\nlags = [0.0, 0.15]\n'
        "gains = [1, 1]\ngammas = [1, 0.9]\ncloud_banks = [[100, 50]]\nblank = []\nsnr = 60\ngyro = true\n"
    )
    (folder / "orbit.toml").write_text(
        'case = "mirror-leo"\nlines = 240\ncolumns = 224\noff_nadir = 0.2\npairs = [["A", "B"]]\n'
        '[[detectors]]\nname = "A"\nbehind = 0.0\n[[detectors]]\nname = "B"\nbehind = 20.0\ngain = 0.9\n'
    )
    (folder / "frames.toml").write_text(
        'case = "frames"\nframes = 2\ninterval = 4\nshape = [240, 256]\nfocal_length_px = 900.0\n'
        "relief_rms = 20.0\nestimate_camera = true\n"
    )


@seed
def simulated_pair(folder: Path) -> None:
    """With a DEM."""
    keys = ("unpaired=true", "relief=smooth", "dem_sigma=5", "control_points=3")
    given = ["--shots", "4", "--points", "12", *(word for key in keys for word in ("--set", key))]
    run("simulate", "stereo", *given, "--out", folder, "--overwrite")
    import rasterio

    with rasterio.open(folder / "dem.tif") as dem:  # coarser: a case writes all of it
        profile, heights = dem.profile, dem.read(1)[::8, ::8]
        place = dem.transform @ dem.transform.scale(8.0)
    keep = {key: profile[key] for key in ("crs", "nodata") if profile.get(key) is not None}
    write_tif(folder / "dem.tif", heights, transform=place, **keep)


@seed
def strips(folder: Path) -> None:
    """Push-broom images in place of the frames of a camera."""
    for name, look in (("fore", 0.0), ("aft", -0.2)):
        (folder / name).mkdir()
        bands(folder / name)
        late = -ALTITUDE * np.tan(look) / SPEED
        text = BANDS.replace("look_ahead = 5e-5", f"look_ahead = {look + 5e-5}\nfirst_line_time = {late}")
        text = text.replace(
            'image = "PAN.tif"', f'image = "PAN.tif"\nlook_ahead = {look}\nfirst_line_time = {late}'
        )
        (folder / name / "acquisition.toml").write_text(
            f'[platform]\nkind = "level-flight"\naltitude = {ALTITUDE}\nground_speed = {SPEED}\n{text}'
        )
    places = np.random.default_rng(0).uniform((15.0, 2.0), (60.0, 38.0), (12, 2))
    rows = [(name, k, *place) for k, place in enumerate(places) for name in ("fore", "aft")]
    table(folder / "observations.csv", "camera,point,line,column", rows)
    (folder / "stereo.toml").write_text(
        """
observations = "observations.csv"
[noise]
sigma_px = 0.3
sigma_position = 1.0
sigma_attitude = 1e-6
[surface]
height = 0.0
height_sigma = 5.0
[[strip]]
name = "fore"
acquisition = "fore/acquisition.toml"
[[strip]]
name = "aft"
acquisition = "aft/acquisition.toml"
band = "PAN"
"""
    )


# TDI and layouts ------------------------------------------------------------------------------------------

TDI = """
name = "columns"
[grid]
stages = { from = 3, to = 24 }
integration_ratio = [0.4, 0.8, 1.0]
[head]
stages = 2
integration_ratio = 0.5
[noise]
gain = 9e-6
read = 12.0
[columns]
table = "columns.csv"
[signals]
from = 10
to = 1000
count = 4
[mtf]
frequencies = [0.5, 0.5]
aperture_x = 0.9
diffusion_sigma_px = 0.2
optics_mtf = 0.35
[choice]
snr_min = 1.0
full_well_line = 20000
full_well_sum = 400000
"""


@seed
def tdi(folder: Path) -> None:
    rows = [(0, 1.0, -0.03), (1, 1.0, 0.0), (7, 0.999, 0.03)]
    table(folder / "columns.csv", "column,scan_velocity,slip", rows)
    table(
        folder / "noise.csv", "column,dark,output,gain", [(0, 3.0, 5.0, 1e-5), (1, 0, 5, 1e-5), (7, 4, 6, 0)]
    )
    of_columns = TDI.replace("gain = 9e-6", 'table = "noise.csv"')
    (folder / "tdi.toml").write_text(of_columns)
    from sightline.imaging.tdi_transfer import Exposure
    from sightline.io.results.tdi_table import write_table
    from sightline.io.results.tdi_tags import write_tags
    from sightline.tdi.table import TdiTable
    from sightline.tdi.tagging import TdiTags

    cells = (
        np.array([0, 900, 2000, 0, 1500], dtype=np.uint16),
        np.array([3, 10, 511, 7, 600], dtype=np.uint16),
    )
    (folder / "result").mkdir()
    write_table(
        folder / "result",
        TdiTable(
            np.array([10, 14, 31]),
            np.array([0, 3, 5]),
            *cells,
            np.array([0.2, 0.5, 1.0]),
            (2.0, 6000.0),
            0.004,
            0,
        ),
    )
    rng, shape = np.random.default_rng(0), (20, 4)
    slow = np.repeat(rng.random((2, 4)), 10, axis=0)
    tags = TdiTags(
        first_column=np.arange(4) * 7, columns=31, ratios=np.arange(1, 11) / 10.0,
        exposure=Exposure(2, 0.25, "start"), signal_ratio=0.5, stages=rng.integers(3, 129, shape),
        ratio_index=(slow * 10).astype(int), saturated=slow > 0.9, table=np.full(shape, 2**32 - 1),
        velocity=1.0 + 1e-3 * slow, slip=slow, signal=rng.lognormal(5.0, 1.0, shape), mtf_across=slow,
        mtf_along=slow**2, snr=20.0 * slow,
    )  # fmt: skip
    write_tags(folder / "tags.bin", [tags], len(tags))
    (folder / "signals.npy").write_bytes(npy(noise(0, (20, 8))))


@seed
def recovered(folder: Path) -> None:
    """A strip, what `recover` would leave of it, its truth, and TDI columns by both."""
    from sightline.io.acquisition.load import load_acquisition
    from sightline.io.formats.tables import MotionTable, write_attitudes, write_motion, write_spectrum
    from sightline.io.results.hidden import write_hidden
    from sightline.io.results.relief import write_relief
    from sightline.motion.strip.relief import RowRelief

    bands(folder)
    (folder / "acquisition.toml").write_text(
        f'[platform]\nkind = "level-flight"\naltitude = {ALTITUDE}\nground_speed = {SPEED}\n{BANDS}'
        f"[matching]\n{WINDOWS}\n"
    )
    (folder / "tdi.toml").write_text(
        TDI.replace('table = "columns.csv"', 'acquisition = "acquisition.toml"\nband = "PAN"')
    )
    made, t = folder / "result", PERIOD * np.arange(LINES)
    made.mkdir()
    angles = 1e-6 * np.stack([np.sin(300.0 * t), np.cos(200.0 * t), 3.0 * np.sin(100.0 * t)], axis=1)
    sigma = np.full((LINES, 3), 1e-7)
    write_motion(made / "motion.csv", MotionTable(t, angles, sigma, 10.0 * sigma, np.ones(LINES, dtype=bool)))
    write_attitudes(made / "attitude.csv", t, Rotation.from_rotvec(angles).as_quat())
    rows = np.stack([np.sin(t), np.cos(t)], axis=1)
    write_relief(made / "relief.csv", RowRelief(0, t, rows, np.ones_like(rows)))
    drift = np.zeros((LINES, 3, 2))
    drift[:, 0, 0], drift[:, 1, 1] = 1.0, t - t.mean()
    f = np.linspace(1.0, 1000.0, 20)
    density = np.tile(1e-14 / f[:, None] ** 2, (1, 3))
    write_spectrum(made / "spectrum.csv", f, density, 0.01 * density, np.ones((20, 3)))
    grid = np.linspace(-0.01, LINES * PERIOD + 0.01, 40)
    np.savez_compressed(made / "covariance.npz", t=grid, angles=np.zeros((40, 3)), band=np.ones((4, 120)))
    summary = {
        "inputs": load_acquisition(folder / "acquisition.toml").input_hashes(),
        "statics": [
            {"name": "XS offset along", "unit": "px", "value": 1e-7, "sigma": 1e-8, "prior_sigma": 1.0}
        ],
        "hidden_directions": write_hidden(made, t, drift, ["constant roll", "drift pitch"])
        | {"covariance": [[1e-12, 0.0], [0.0, 1e-10]]},
        "ifov": IFOV,
        "half_field_px": COLUMNS / 2,
        "half_field": IFOV * COLUMNS / 2,
        "scale": {"roll": IFOV, "pitch": IFOV, "yaw": 2.0 / COLUMNS},
        "result": "LineOfSight",
        "method": {"name": "joint"},
        "images": ["PAN", "XS"],
        "sensors": [],
        "changes": [0.1],
        "warnings": ["short"],
    }
    (made / "summary.json").write_text(json.dumps(summary))
    table(folder / "truth.csv", "t,roll,pitch,yaw", np.column_stack([t, angles + 1e-7]))


@seed
def instrument(folder: Path) -> None:
    (folder / "instrument.toml").write_text(
        """
name = "three lines"
focal_length_px = 2e5
line_period = 1e-3
match_sigma_px = 0.03
detectors = 3
span_px = 40
step_px = 2
min_spacing_px = 2.0
duration = 0.5
[[prior]]
kind = "matern"
sigma_px = 2.0
timescale = 1.0
order = "5/2"
[[prior]]
kind = "tone"
sigma_px = 0.3
frequency = 47.0
[[layout]]
name = "ours"
positions_px = [0, 20, 30]
"""
    )


@seed
def results(folder: Path) -> None:
    """Folders of results by every command whose result has no other seed, in their least form."""
    import rasterio

    from sightline.evaluation.score import AXES
    from sightline.io.results.stereo import write_covariance, write_orientation

    tdi(folder)
    (folder / "result").rename(folder / "choice")
    (folder / "tags.bin").unlink()

    def summary(place: str, **content: object) -> Path:
        (folder / place).mkdir(exist_ok=True)
        (folder / place / "summary.json").write_text(json.dumps({"version": "0", "warnings": [], **content}))
        return folder / place

    spread = {"min": 3.0, "mean": 5.0, "max": 9.0}
    made = summary(
        "choice", result="TdiResult", columns=2, signals=1, stages=spread, integration_ratio=spread,
        table={"bytes": 100, "certified_loss": 0.001},
    )  # fmt: skip
    rows = [(k, 900, 5, 0.5, 0.4, 0.4, 20.0, 3.0, "none") for k in range(2)]
    heads = "column,signal,stages,integration_ratio,mtf_x,mtf_y,snr,merit,limit"
    table(made / "choice.csv", heads, rows)
    made = summary(
        "angles", result="StereoOrientation", method="ml-track", matches={"unchecked": 0.1}, cost=2.0,
        degrees_of_freedom=3, iterations=4, solve_seconds=0.1, bias_removed=None,
        drift={name: {f"{s}{axis}": 1e-9 for s in ("", "sigma_") for axis in AXES} for name in ("1", "2")},
    )  # fmt: skip
    write_orientation(made / "orientation.csv", ("1", "2"), np.zeros((2, 3)), np.full((2, 3), 1e-5))
    write_covariance(made / "covariance.csv", ("1", "2"), 1e-10 * np.eye(6))
    table(made / "points.csv", "point,x,y,z", [(1, 0.0, 1.0, 2.0), (2, 3.0, 1.0, 2.0)])
    made = summary(
        "detector", result="DetectorNoise", noise={"gain": 1e-4, "read": 3.0}, unit="DN", stages=4,
        electrons_per_dn=None, signals=[3.0, 900.0], full_well_sum=None,
    )  # fmt: skip
    table(made / "columns.csv", "column,gain,offset,flags", [(k, 1.0, 3.0, k % 2) for k in range(4)])
    layout = {"positions_s": [0.0, 0.1], "worst_images": 0.5, "worst_frequency": 47.0}
    spans = {"span_s": [0.1], "worst_information": [3.0], "harmonic_sigma_px": [0.1]}
    made = summary(
        "places", result="LayoutChoice", passband=[40.0, 150.0], duration=1.0, highest_frequency=200.0,
        tried=3.0, exhaustive=True, by_span=spans, ranked=[layout],
    )  # fmt: skip
    table(made / "layouts.csv", "rank,name,positions_px", [(1, "best", "0 20"), (2, "ours", "0 30")])
    axis = {
        "unit": "px",
        **dict.fromkeys("rms max sigma nees effective_samples nees_low nees_high".split(), 1.0),
    }
    axis["coverage_95"] = 0.95
    summary(
        "score", result="Score", lines=9, hidden_directions_removed=["constant roll"], left_out=[],
        absolute={"roll": axis}, **dict.fromkeys(AXES, axis),
    )  # fmt: skip
    fit = {"rms_px": [0.1, 0.2], "noise_px": [0.1, None], "windows": 9, "kept": 8}
    made = summary(
        "bands", result="Registration", onto="PAN", files=["PAN.tif", "XS.tif"],
        bands=[{"name": "PAN"}, {"name": "XS"}],
        pairs=[{"images": ["PAN", "XS"], "before": fit, "after": fit}],
    )  # fmt: skip
    for place in (
        made / "PAN.tif",
        made / "XS.tif",
        summary("sky", result="Mosaic", strips=["a"]) / "picture.tif",
    ):
        form = {"width": 9, "height": 8, "count": 1, "dtype": "float32"}
        form["transform"] = rasterio.Affine(2.0, 0.0, 5.0, 0.0, 2.0, 5.0)
        with rasterio.open(place, "w", driver="GTiff", **form) as raster:
            raster.write(np.ones((1, 8, 9), np.float32))
    band = dict.fromkeys("wavelength_nm coverage passed beyond map_share seams seam_jump".split(), 0.5)
    summary(
        "cube", result="CubeSummary", bands=[{"name": "b", **band}], shape=[3, 4], gsd=0.5, frames_used=2,
        surface="given", area=3.0, unread=[], seconds={},
    )  # fmt: skip


# Raw products of instruments ------------------------------------------------------------------------------


@seed
def hirise(folder: Path) -> None:
    lines, columns, stages, binning = 7, 10, 8, 2
    calibration = 20 + 20 // binning + stages // binning
    nodes = [(0, 99), *((100 + 10 * k, 109 + 10 * k) for k in range(200))]
    nodes += [(-9998, -9998)] * (254 - len(nodes)) + [(9000, 16383), (-9998, -9998)]
    keys = {
        "DATA_SET_ID": '"MRO-M-HIRISE-2-EDR-V1.0"',
        "PRODUCT_ID": '"PSP_000000_0000_RED0_0"',
        "INSTRUMENT_ID": '"HIRISE"',
        "MRO:BINNING": binning,
        "MRO:TDI": stages,
        "MRO:LINE_EXPOSURE_DURATION": "167.5000 <MICROSECONDS>",
        "MRO:SCAN_EXPOSURE_DURATION": "83.7500 <MICROSECONDS>",
        "OBSERVATION_ID": '"PSP_000000_0000"',
        "MRO:CPMM_NUMBER": 5,
        "MRO:CHANNEL_NUMBER": 0,
        "START_TIME": "2007-01-01T00:00:00.000",
        "SPACECRAFT_CLOCK_START_COUNT": '"850000000:12345"',
        "MRO:LOOKUP_CONVERSION_TABLE": f"({', '.join(map(str, nodes))})".replace("), ", "),\n     "),
        "^CALIBRATION_IMAGE": "8193 <BYTES>",
        "^IMAGE": f"{8193 + calibration * (columns + 34)} <BYTES>",
    }
    text = "PDS_VERSION_ID = PDS3\r\n" + "".join(f"{key} = {value}\r\n" for key, value in keys.items())
    for name, count in (("CALIBRATION_IMAGE", calibration), ("IMAGE", lines)):
        text += (
            f"OBJECT = {name}\r\n    LINES = {count}\r\n    LINE_SAMPLES = {columns}\r\n"
            f"    SAMPLE_BITS = 8\r\n    LINE_PREFIX_BYTES = 18\r\n"
            f"    LINE_SUFFIX_BYTES = 16\r\nEND_OBJECT = {name}\r\n"
        )
    rows = np.arange((calibration + lines) * (columns + 34)).reshape(-1, columns + 34) % 200 + 1
    rows[:, :6] = [255, 0, 232, 0, 0, 0]
    (folder / "raw.IMG").write_bytes(
        (text + "END\r\n").encode().ljust(8192) + rows.astype(np.uint8).tobytes()
    )


@seed
def juno(folder: Path) -> None:
    for number, hour, place in (
        (30, "13:25:44.834", (118043.7, 41.7, 287.7)),
        (32, "13:44:55.688", (85911.5, 51.6, 301.6)),
    ):
        metadata = {
            "INSTRUMENT_ID": "JNC",
            "PRODUCT_ID": f"JNCE_{number}",
            "START_TIME": f"2022-08-17T{hour}",
            "INTERFRAME_DELAY": "0.373 <s>",
            "SPACECRAFT_ALTITUDE": f"{place[0]} <km>",
            "SUB_SPACECRAFT_LATITUDE": str(place[1]),
            "SUB_SPACECRAFT_LONGITUDE": str(place[2]),
        }
        (folder / f"JNCE_{number}.json").write_text(json.dumps(metadata))
    sky = np.zeros((384, 1648), np.uint8)
    sky[:, 300:900] = 60 + (np.arange(600) % 7).astype(np.uint8)
    write_tif(folder / "JNCE_30.png", sky, driver="PNG")


@seed
def sentinel1(folder: Path) -> None:
    """Attitudes about axes of 2000 and an Earth-fixed orbit, a second apart."""
    rows = ["time_utc,frame,q0,q1,q2,q3,wx,wy,wz"]
    track = ["time_utc,frame,x,y,z,vx,vy,vz"]
    for k in range(12):
        instant, turn = f"2026-01-01T00:00:{k:02d}.000000", Rotation.from_euler("y", -1.06e-3 * k)
        q = ",".join(f"{value:.12f}" for value in turn.as_quat())
        rows.append(f"{instant},GM2000,{q},1.06e-3,0.0,0.0")
        angle = 1.06e-3 * k
        place = 7.07e6 * np.array([np.cos(angle), 0.0, np.sin(angle)])
        speed = 7.5e3 * np.array([-np.sin(angle), 0.0, np.cos(angle)])
        track.append(",".join([instant, "Earth Fixed", *(f"{value:.4f}" for value in (*place, *speed))]))
    (folder / "attitude.csv").write_text("\n".join(rows) + "\n")
    (folder / "orbit.csv").write_text("\n".join(track) + "\n")


# Sums that a reader checks, made right again after a change -------------------------------------------------


def with_crc(content: bytes) -> bytes:
    """The same with the CRC-32 of its content in its last four bytes."""
    return content[:-4] + struct.pack("<I", zlib.crc32(content[:-4]))


def again(name: str, image: bytes) -> bytes:
    """A changed image of a TDI table, or file of tags, as the file `name`, whose check sums are right."""
    from sightline.io.results.tdi_table import intel_hex, segments

    image = with_crc(image)
    if name.endswith(".hex"):
        return intel_hex(image).encode()
    if name.endswith("segments.bin"):
        return segments(image)
    if name.endswith(".c"):
        data = " ".join(f"0x{byte:02x}," for byte in image)
        return f"const uint8_t sightline_tdi_image[SIGHTLINE_TDI_SIZE] = {{\n{data}\n}};\n".encode()
    return image


def copied(root: Path, name: str, to: Path) -> Path:
    """A copy of one seed."""
    return Path(shutil.copytree(root / name, to))
