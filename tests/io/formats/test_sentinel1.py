"""Attitudes of Sentinel-1: quaternions and rates in unlike axes, against one another and the orbit."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.io.acquisition.ephemeris import read_attitude, read_orbit
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.sentinel1 import is_sentinel1, read_sentinel1_attitude, read_sentinel1_orbit

EPOCH = "2022-04-14T10:22:12Z"
FILE = "s1a-iw1-slc-hh-20220414t102211-20220414t102236-042768-051aa4-001.{}.csv"


def table(path, change=lambda row: row, rows=30):
    """A body that turns about an axis of its own, as the files write it: rates in other axes."""
    rate = np.array([-1e-3, 2e-4, 5e-4])  # about x, y, z of the quaternions
    start = Rotation.from_rotvec([0.3, -1.2, 0.7])
    with path.open("w") as stream:
        stream.write("time_utc,frame,q0,q1,q2,q3,wx,wy,wz,roll_deg\n")
        for k in range(rows):
            q = (start * Rotation.from_rotvec(rate * k)).as_quat()
            row = [f"2022-04-14T10:22:{11 + k:02d}.0", "GM2000", *q, -rate[1], -rate[0], -rate[2], 1.0]
            stream.write(",".join(map(str, change(row))) + "\n")
    return path


def test_rates_are_those_of_the_quaternions_in_real_files(real_data):
    files = sorted(real_data("sentinel1_attitude").glob("*.attitude.csv"))
    assert len(files) >= 3
    for path in files:
        given = read_sentinel1_attitude(path, EPOCH)
        # measured of five files: 1.5e-6 rms, 5e-6 at most, where a plain reading is 5e-4 off
        assert np.abs(given.apart).max() < 6e-6 and not given.doubt
        with path.open() as stream:
            w = np.array([[float(row[f"w{axis}"]) for axis in "xyz"] for row in csv.DictReader(stream)])
        np.testing.assert_array_equal(given.rates, w)


def test_the_body_flies_along_its_x_and_looks_30_degrees_to_the_right(real_data):
    folder = real_data("sentinel1_attitude")
    given = read_sentinel1_attitude(folder / FILE.format("attitude"), EPOCH)
    t, place, speed = read_sentinel1_orbit(folder / FILE.format("orbit"), EPOCH)
    # the axes of 2000 turn about z against the Earth-fixed ones, but for some arc minutes of precession:
    # angles between vectors of one instant need the turn alone, here of sidereal time of 2022-04-14 10:22:12
    days = 8138.9321  # UT1 days from 2000-01-01 12:00
    gmst = np.radians((280.46061837 + 360.98564736629 * days) % 360.0)
    middle = int(np.argmin(np.abs(given.t)))
    at = np.array([np.polyval(np.polyfit(t, column, 6), given.t[middle]) for column in place.T])
    v = np.array([np.polyval(np.polyfit(t, column, 6), given.t[middle]) for column in speed.T])
    v = v + np.cross([0, 0, 7.292115e-5], at)
    turn = Rotation.from_euler("z", gmst + 7.292115e-5 * given.t[middle])
    ahead, down = (turn.apply(u / np.linalg.norm(u)) for u in (v, -at))
    body = given.inertial_from_body[middle].inv()
    # yaw steering of up to 4 degrees, and the earth's shape of .2
    assert np.degrees(np.arccos(body.apply(ahead)[0])) < 5.0
    x, y, z = body.apply(down)
    assert abs(np.degrees(np.arctan2(-y, z)) - 30.0) < 1.0 and abs(x) < 0.01


def test_rates_in_other_axes_are_doubted(tmp_path):
    plain = read_sentinel1_attitude(table(tmp_path / "a.csv"), EPOCH)
    assert is_sentinel1(tmp_path / "a.csv")
    assert np.abs(plain.apart).max() < 1e-12 and not plain.doubt
    np.testing.assert_allclose(plain.t, np.arange(30) - 1.0)
    swapped = table(tmp_path / "b.csv", lambda row: [*row[:6], row[7], row[6], *row[8:]])
    assert "contradict each other by 0.001" in read_sentinel1_attitude(swapped, EPOCH).doubt
    given = read_attitude(swapped, EPOCH)
    assert given.axes == "EME2000" and "the quaternions are used" in given.doubt


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda row: [row[0], "TEME", *row[2:]], "is in axes 'TEME'; read are GM2000"),
        (lambda row: [*row[:2], 2.0, *row[3:]], "quaternion of length"),
        (lambda row: ["2022-04-14T10:22:11.0", *row[1:]], "duplicate times"),
        (lambda row: ["yesterday", *row[1:]], "row 1: 'yesterday' is not a UTC instant"),
    ],
)
def test_what_is_wrong_is_named(change, said, tmp_path):
    with pytest.raises(FormatError, match=said):
        read_sentinel1_attitude(table(tmp_path / "a.csv", change), EPOCH)
    with pytest.raises(FormatError, match="holds one attitude"):
        read_sentinel1_attitude(table(tmp_path / "a.csv", rows=1), EPOCH)
    with pytest.raises(FormatError, match="epoch"):
        read_orbit(table(tmp_path / "b.csv"), None)


def strip_along(folder, tmp_path):
    """An ACQUISITION.toml of two bands along the tables of a pass."""
    rng = np.random.default_rng(3)
    bands = ""
    for name, ahead in (("A", 0.0), ("B", 2e-3)):
        np.save(tmp_path / f"{name}.npy", rng.integers(50, 200, (400, 200)).astype(np.uint8))
        bands += f'[[band]]\nname = "{name}"\nimage = "{name}.npy"\nlook_ahead = {ahead}\n'
        bands += f"first_line_time = {-ahead * 1000 / 7.5}\n"
    (tmp_path / "a.toml").write_text(
        f'[acquisition]\nepoch = "{EPOCH}"\n[platform]\nkind = "ephemeris"\n'
        f'positions = "{folder / FILE.format("orbit")}"\nattitudes = "{folder / FILE.format("attitude")}"\n'
        f"[instrument]\nifov = 1e-5\nline_period = 1.2e-3\n{bands}[surface]\nheight = 0\nheight_sigma = 10\n"
    )
    return tmp_path / "a.toml"


def test_rates_are_a_gyro_beside_the_quaternions(real_data, tmp_path):
    pytest.importorskip("erfa")
    folder = real_data("sentinel1_attitude")
    path = strip_along(folder, tmp_path)
    without = path.read_text()
    table = folder / FILE.format("attitude")
    path.write_text(f'{without}[[attitude_sensor]]\nkind = "gyro"\ntable = "{table}"\n')
    acquisition = load_acquisition(path)
    (gyro,) = acquisition.sensors
    assert len(gyro.t_start) >= 3
    # what rates and quaternions leave of each other: 5e-6 rad/s at most in real files, 1.5e-6 as a rule; a
    # plain reading of the rates is 5e-4 off
    assert np.abs(gyro.angles).max() < 6e-6
    # increments of 1 s whose errors are no less than that
    assert 5e-7 < gyro.sigma[0] < 5e-6
    assert "Allan deviation" in next(line for line in acquisition.sources if "as a gyro" in line)
    # where a row is missing the random walk goes on for twice as long; rows are microseconds off 1 s
    rows = table.read_text().splitlines(keepends=True)
    first = 1 + int(np.argmin(np.abs(read_sentinel1_attitude(table, EPOCH).t - gyro.t_end[0])))
    fewer = tmp_path / "fewer.csv"
    fewer.write_text("".join(rows[:first] + rows[first + 1 :]))
    path.write_text(f'{without}[[attitude_sensor]]\nkind = "gyro"\ntable = "{fewer}"\n')
    sigma = load_acquisition(path).sensors[0].sigma
    assert sigma[0] == pytest.approx(np.sqrt(2.0) * sigma[1], rel=1e-4)
    path.write_text(f'{without}[[attitude_sensor]]\nkind = "star-tracker"\ntable = "{table}"\n')
    with pytest.raises(FormatError, match='read as kind = "gyro" beside Earth-fixed attitudes'):
        load_acquisition(path)


def test_rates_that_contradict_the_quaternions_are_no_gyro(real_data, tmp_path):
    pytest.importorskip("erfa")
    folder = real_data("sentinel1_attitude")
    path = strip_along(folder, tmp_path)
    rows = [line.split(",") for line in (folder / FILE.format("attitude")).read_text().splitlines()]
    path.write_text(f'{path.read_text()}[[attitude_sensor]]\nkind = "gyro"\ntable = "gyro.csv"\n')
    # quaternions that stand still: what both leave of each other is even, and an Allan deviation hides it
    still = [rows[0], *([*row[:2], *rows[1][2:6], *row[6:]] for row in rows[1:])]
    # further than any rate, and further than a float's square
    wild, none = ([rows[0], *([*row[:6], rate, *row[7:]] for row in rows[1:])] for rate in ("1e29", "1e300"))
    wrong = (
        (still, "contradict each other by 0.00"), (wild, "by 1e"), (none, "no quantity is as large"),
        (rows[:3], "three or more"),
    )  # fmt: skip
    for given, said in wrong:
        (tmp_path / "gyro.csv").write_text("".join(",".join(row) + "\n" for row in given))
        with pytest.raises(FormatError, match=said):
            load_acquisition(path)


def test_a_platform_takes_both_tables(real_data, tmp_path, capsys):
    pytest.importorskip("erfa")
    run(["check", str(strip_along(real_data("sentinel1_attitude"), tmp_path))])
    said = capsys.readouterr().out
    assert "brought to the axes of its rates" in said and "agree to 1." in said
    assert "right" in said
