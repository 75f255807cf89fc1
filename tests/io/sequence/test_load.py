"""SEQUENCE.toml: what is understood, frames that cannot be used, and one clear error for every fault."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.formats_text import FORMATS
from tests.io.sequence_files import NORTH, SHAPE, flight, npy, picture

from sightline.errors import FormatError, GeometryError, SightlineError
from sightline.execution import threads_limited
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.io.config import json_schema, schema_of
from sightline.io.formats.xmp import gimbal_attitude, parse_xmp
from sightline.io.sequence.describe import describe_sequence
from sightline.io.sequence.frame_files import opened
from sightline.io.sequence.load import _focal_length, load_sequence, read_sequence
from sightline.io.sequence.poses import track_attitude
from sightline.io.sequence.positions import place_of


def test_everything_is_understood(tmp_path):
    made = flight()
    made.toml = made.toml.replace("[surface]", "readout_time = 0.02\n[subset]\noverlap = 0.7\n[surface]")
    path = made.write(tmp_path)
    assert schema_of(path) == "sequence"
    sequence = read_sequence(path)
    problem = sequence.problem
    assert sequence.name == "north" and problem.epoch == "2026-01-01T00:00:00Z"
    assert problem.frames == tuple("012345") and len(problem) == 6 and problem.usable.all()
    np.testing.assert_array_equal(problem.t, 0.5 * np.arange(6))
    np.testing.assert_array_equal(problem.images.position[:, 1], 5.0 * np.arange(6))
    # the optical axis of the nominal mount is the body's z
    np.testing.assert_allclose(
        problem.images.world_from_body.apply([0, 0, 1.0]), [[0, 0, -1.0]] * 6, atol=1e-15
    )
    np.testing.assert_allclose(
        problem.images.world_from_body.apply([1.0, 0, 0]), [[0, 1.0, 0]] * 6, atol=1e-15
    )
    np.testing.assert_array_equal(problem.known.position, [[1.0, 1.5, 2.0]] * 6)
    np.testing.assert_array_equal(problem.known.attitude, [[0.01, 0.02, 0.03]] * 6)
    assert (problem.known.position_bias, problem.known.attitude_bias) == (2.0, 0.01)
    assert problem.detector.principal_point_px == (11.5, 15.5) and problem.radii is None
    assert (problem.readout_time, problem.overlap, problem.height_sigma) == (0.02, 0.7, 1.0)
    assert problem.warnings == () and problem.control is None
    assert set(sequence.input_hashes()) == {
        "sequence.toml", "frames.csv", "positions.csv", "attitudes.csv", "frames",
    }  # fmt: skip


@pytest.mark.parametrize("epoch", ["2026-01-01T00:00:00Z", None])
def test_times_may_be_utc_instants(tmp_path, epoch):
    made = flight()
    if epoch is None:
        made.toml = made.toml.replace('epoch = "2026-01-01T00:00:00Z"\n', "")
    for name in ("frames", "positions", "attitudes"):
        for k, row in enumerate(getattr(made, name)):
            row[1] = f"2026-01-01T00:00:{10 + k // 2:02d}.{5 * (k % 2)}Z"
    if epoch is not None:  # tables need not be alike
        for k, row in enumerate(made.positions):
            row[1] = 10.0 + 0.5 * k
    problem = load_sequence(made.write(tmp_path))
    start = 0.0 if epoch is None else 10.0
    np.testing.assert_allclose(problem.t, start + 0.5 * np.arange(6), atol=1e-9)
    assert problem.epoch == (epoch or "2026-01-01T00:00:10.0Z")
    assert np.isfinite(problem.known.position).all() and np.isfinite(problem.known.attitude).all()


def sbet_of(path, step=0.005):
    """A flight along north over 47 N, 11 E, yawing by .1 rad/s; 200 records a second from t = -1 on."""
    start = 4 * 86400.0 + 18.0  # of the GPS week, leap seconds since 1980 among them
    rows = []
    for t in np.arange(-1.0, 5.0, step):
        lat = np.radians(47.0) + 60.0 * t / 6.37e6
        rows.append([start + t, lat, np.radians(11.0), 100.0, 60.0, 0, 0, 0.01, 0.02, 0.1 * t, *[0.0] * 7])
    path.write_bytes(np.array(rows, dtype="<f8").tobytes())


def test_event_marks_and_a_trajectory_of_many_records_give_times_and_poses(tmp_path):
    made = flight()
    made.toml = re.sub(r"(?m)^(positions|attitudes) = .*$", "", made.toml).replace(
        '[world]\nframe = "local"', '[world]\nframe = "earth-fixed"'
    )
    made.toml = 'events = "marks.csv"\npositions = "sbet.out"\nattitudes = "sbet.out"\n' + made.toml
    path = made.write(tmp_path)
    sbet_of(tmp_path / "sbet.out")
    marks = [0.013 + 0.5 * k for k in range(6)]
    table = tmp_path / "marks.csv"
    table.write_text("t\n" + "".join(f"{t}\n" for t in marks))
    problem = load_sequence(path)
    np.testing.assert_allclose(problem.t, marks, atol=1e-12)
    lon, lat, height = to_geodetic(problem.images.position, WGS84).T
    # what is linear between records 5 ms apart: 4e-7 m of the Earth's curvature
    np.testing.assert_allclose(lat, np.radians(47.0) + 60.0 * np.array(marks) / 6.37e6, atol=1e-12)
    np.testing.assert_allclose(height, 100.0, atol=1e-5)
    level = local_axes(lon, lat)
    forward = (level.inv() * problem.images.world_from_body).apply([1.0, 0, 0])
    np.testing.assert_allclose(np.arctan2(forward[:, 0], forward[:, 1]), 0.1 * np.array(marks), atol=1e-9)
    assert any("SBET" in words for words in problem.warnings)
    for rows, words in (
        ("t\n" + "1.0\n2.0\n", "2 event marks for 6 frames"),
        ("t\n" + "".join(f"{9.0 + t}\n" for t in marks), "exposed outside of it"),
        ("frame,t\n0,0.1\n1,0.2\n", "has no row, and 4 frames in all"),
        ("t\n" + "".join(f"{t + 3.0 * (t > 2.2)}\n" for t in marks), r"its time in frames\.csv"),
    ):
        table.write_text(rows)
        with pytest.raises(FormatError, match=words):
            load_sequence(path)
    table.write_text("frame,t\n" + "".join(f"{5 - k},{marks[5 - k]}\n" for k in range(6)))
    np.testing.assert_allclose(load_sequence(path).t, marks, atol=1e-12)


def test_event_marks_beside_the_times_of_a_table_are_named(tmp_path):
    made = flight()
    made.toml = 'events = "marks.csv"\n' + made.toml
    path = made.write(tmp_path)
    (tmp_path / "marks.csv").write_text("t\n" + "".join(f"{9 + 0.5 * k}\n" for k in range(6)))
    with pytest.raises(FormatError, match=r"in marks\.csv it is 9; they must agree"):
        load_sequence(path)


def test_frames_are_read_when_they_are_asked_for(tmp_path):
    problem = load_sequence(flight().write(tmp_path))
    expected = np.random.default_rng(3).integers(0, 4000, SHAPE).astype(np.float32)
    source = problem.sources[3]
    assert source.shape == SHAPE
    np.testing.assert_array_equal(source.read((2, 9), (4, 20)), expected[2:9, 4:20])
    assert source.mask((2, 9), (4, 20)) is None
    source.path.write_bytes(npy(np.full(SHAPE, 5.0)))
    os.utime(source.path, ns=(0, 0))
    assert (source.read((0, 2), (0, 2)) == 5.0).all()  # written anew, read anew


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts open files as Linux shows them")
def test_many_frames_keep_few_files_open_where_few_may_be(tmp_path, monkeypatch):
    import rasterio

    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (240, 240))

    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "height": 24, "width": 32}
    image = np.random.default_rng(0).integers(0, 255, SHAPE).astype(np.uint8)
    for k in range(100):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # no georeference
            target = rasterio.open(tmp_path / f"{k}.tif", "w", **profile)
        with target:
            target.write(image, 1)
    before = len(os.listdir("/proc/self/fd"))
    with threads_limited(2):
        for k in range(100):
            opened(tmp_path / f"{k}.tif", 1).read((0, 4), (0, 4))
    # two threads may hold every file twice: half of 240, less what else is open
    assert len(os.listdir("/proc/self/fd")) - before <= 60


def test_frames_without_a_row_are_interpolated_with_an_infinite_sigma(tmp_path):
    made = flight()
    made.positions = [made.positions[0], made.positions[4]]
    made.attitudes[2:4] = []
    made.attitudes[2][2:6] = (Rotation.from_quat(NORTH) * Rotation.from_rotvec([0, 0, 0.3])).as_quat()
    problem = load_sequence(made.write(tmp_path))
    np.testing.assert_allclose(
        problem.images.position[:, 1], 5.0 * np.arange(6)
    )  # frame 5 beyond the last row
    assert np.isinf(problem.known.position[[1, 2, 3, 5]]).all()
    assert np.isfinite(problem.known.position[[0, 4]]).all()
    turns = (Rotation.from_quat(NORTH).inv() * problem.images.world_from_body).as_rotvec()[:, 2]
    np.testing.assert_allclose(turns, [0, 0, 0.1, 0.2, 0.3, 0], atol=1e-12)
    assert np.isinf(problem.known.attitude[2:4]).all()
    assert any("4 of 6 frames have no position" in words for words in problem.warnings)
    assert any("2 of 6 frames have no attitude" in words for words in problem.warnings)


def test_without_attitudes_the_camera_looks_down_along_the_track(tmp_path):
    made = flight(20)
    rng = np.random.default_rng(1)
    for row in made.positions:
        row[2] += rng.normal(0.0, 1.0)
        row[3] += rng.normal(0.0, 1.5)
    made.toml = made.toml.replace('attitudes = "attitudes.csv"\n', "")
    problem = load_sequence(made.write(tmp_path))
    forward = problem.images.world_from_body.apply([1.0, 0, 0])
    heading = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    # noise of 1 m across over the 20 m or more that are taken: 1.4 / 20 rad = 4 degrees, three times that
    assert np.abs(heading).max() < 12.0
    assert np.isinf(problem.known.attitude).all()
    assert "nose along the track" in problem.warnings[0]


def test_a_camera_that_stands_still_points_north():
    still = track_attitude(np.arange(3.0), np.zeros((3, 3)), np.ones((3, 3)), None)
    np.testing.assert_allclose(still.apply([1.0, 0, 0]), [[0, 1.0, 0]] * 3, atol=1e-12)


def test_the_nose_is_along_each_line_up_to_its_ends():
    # two lines of 20 frames, north and back, 2 m between frames, 60 m apart; 10 sigmas are 5 steps of half
    t = np.concatenate([np.arange(20.0), 300.0 + np.arange(20.0)])
    north = 2.0 * np.concatenate([np.arange(20), np.arange(19, -1, -1)])
    places = np.column_stack([np.repeat([0.0, 60.0], 20), north, np.full(40, 100.0)])
    forward = track_attitude(t, places, np.ones((40, 3)), None).apply([1.0, 0, 0])
    np.testing.assert_allclose(forward, np.repeat([[0, 1.0, 0], [0, -1.0, 0]], 20, axis=0), atol=1e-12)


def test_the_nose_of_short_lines_is_not_along_the_way_between_them():
    # two lines of 45 m flown to and fro, 30 m apart, places to 5 m: less than ten sigmas long
    along = np.linspace(0.0, 45.0, 10)
    places = np.column_stack([np.repeat([0.0, 30.0], 10), np.r_[along, along[::-1]], np.full(20, 80.0)])
    places += np.random.default_rng(1).normal(0.0, 5.0, places.shape)
    t = np.r_[np.arange(10.0), 60.0 + np.arange(10.0)]
    forward = track_attitude(t, places, np.full((20, 3), 5.0), None).apply([1.0, 0, 0])
    ahead = forward[:, 1] * np.repeat([1.0, -1.0], 10)
    # ends of a line are nine sigmas apart: .16 rad, of its inner frames somewhat more
    assert np.median(ahead) > np.cos(0.3) and ahead.min() > 0.0


def test_the_nose_of_bursts_that_noise_hides_and_of_single_frames_is_along_the_flight():
    # three frames in .2 s at 10 m/s every 5 s, known to 1 m; then one frame in 40 s between two lines
    rng = np.random.default_rng(0)
    t = (5.0 * np.arange(20)[:, None] + 0.1 * np.arange(3)).ravel()
    places = np.column_stack([0.0 * t, 10.0 * t, 0.0 * t]) + rng.standard_normal((60, 3))
    forward = track_attitude(t, places, np.ones((60, 3)), None).apply([1.0, 0, 0])
    assert np.median(forward[:, 1]) > 0.99
    t = np.concatenate([np.arange(20.0), [60.0], 100.0 + np.arange(20.0)])
    places = np.column_stack([5.0 * t, 0.0 * t, 0.0 * t])
    forward = track_attitude(t, places, np.full((41, 3), 0.1), None).apply([1.0, 0, 0])
    np.testing.assert_allclose(forward, [[1.0, 0, 0]] * 41, atol=1e-12)


def test_without_any_poses_control_points_are_said_to_tell_the_place(tmp_path):
    made = flight()
    made.toml = made.toml.replace('positions = "positions.csv"\nattitudes = "attitudes.csv"\n', "")
    files('control_points = "c.csv"', c_csv=CONTROL + "1,2,0,1,0,4,5\n5,7,0,1,0,8,9\n")(made)
    problem = load_sequence(made.write(tmp_path))
    assert np.isinf(problem.known.position).all() and np.isinf(problem.known.attitude).all()
    said = describe_sequence(read_sequence(tmp_path / "sequence.toml"))
    assert said["observable"][0].endswith("by control points")
    assert not any("a frame covers" in words for words in said["understood"])
    assert any("positions of three frames or more" in words for words in said["missing"])


def test_axes_of_the_world_give_the_same_geometry(tmp_path):
    origin = [11.0, 48.0, 500.0]
    made = flight()
    made.toml = made.toml.replace('frame = "local"', f'frame = "local"\norigin = {origin}').replace(
        "height = 0.0", "height = 500.0"
    )
    local = load_sequence(made.write(tmp_path / "local"))
    lon, lat = np.radians(origin[:2])
    level, place = local_axes(lon, lat), from_geodetic([[lon, lat, 500.0]])[0]
    np.testing.assert_allclose(
        local.images.position, place + level.apply([[0, 5.0 * k, 100] for k in range(6)])
    )
    assert local.radii is not None
    # sigmas stay along east, north, up of the origin
    np.testing.assert_allclose(local.known.position, np.tile([1.0, 1.5, 2.0], (6, 1)))
    np.testing.assert_allclose(local.known.axes, np.tile(level.as_matrix(), (6, 1, 1)))

    fixed = flight()
    fixed.toml = fixed.toml.replace('"local"', '"earth-fixed"').replace("height = 0.0", "height = 500.0")
    for k in range(6):
        fixed.positions[k][2:5] = list(local.images.position[k])
        fixed.attitudes[k][2:6] = list(local.images.world_from_body[k].as_quat())
    other = load_sequence(fixed.write(tmp_path / "fixed"))
    np.testing.assert_allclose(other.images.position, local.images.position)
    assert (other.images.world_from_body.inv() * local.images.world_from_body).magnitude().max() < 1e-12


def by_geo(made):
    """The flight's positions by a geo.txt, sigmas 1.5 and 3 m, in place of its table."""
    made.toml = made.toml.replace('positions = "positions.csv"', 'geo = "geo.txt"')
    made.toml = made.toml.replace('frame = "local"', 'frame = "lonlat"')
    rows = [f"f{k}.npy 11.0 {48.0 + k * 5.0 / 111200:.9f} 100 0 0 0 1.5 3" for k in range(6)]
    made.extra["geo.txt"] = "EPSG:4326\n" + "\n".join(rows) + "\n"


def test_geo_txt_gives_positions_and_angle_tables_attitudes(tmp_path):
    made = flight()
    by_geo(made)
    made.toml = made.toml.replace("attitudes.csv", "opk.csv")
    # the nominal camera has its lines forward: its columns run west of a nose to the north, kappa 180
    made.extra["opk.csv"] = "frame,omega,phi,kappa\n" + "".join(f"{k},0,0,180\n" for k in range(6))
    problem = load_sequence(made.write(tmp_path))
    up = problem.images.position / np.linalg.norm(problem.images.position, axis=1)[:, None]
    heights, sigma = problem.warnings
    assert "geo.txt: 6 heights are taken as they are" in heights and "6 attitudes have no sigma" in sigma
    assert (problem.known.position_bias, problem.known.attitude_bias) == (2.0, 0.01)
    level = local_axes(np.radians(11.0), np.radians(48.0))
    body = level.inv() * problem.images.world_from_body
    # 25 m north turn the level axes by 4e-6 rad
    assert (body.inv() * Rotation.from_quat(NORTH)).magnitude().max() < 1e-5
    assert (np.einsum("ni,ni->n", up, problem.images.world_from_body.apply([0, 0, 1.0])) < -0.99).all()
    np.testing.assert_allclose((problem.known.position**2).sum(axis=1), 2 * 1.5**2 + 9.0)
    yaw = "frame,yaw,pitch,roll,sigma_roll,sigma_pitch,sigma_yaw\n"
    (tmp_path / "opk.csv").write_text(yaw + "".join(f"{k},0,0,0,0.1,0.1,0.2\n" for k in range(6)))
    again = load_sequence(tmp_path / "sequence.toml")
    assert (again.images.world_from_body.inv() * problem.images.world_from_body).magnitude().max() < 1e-12
    np.testing.assert_array_equal(again.known.attitude[0], [0.1, 0.1, 0.2])


def test_places_of_geo_txt_are_off_by_the_same_unless_given(tmp_path):
    made = flight()
    by_geo(made)
    keys = 'attitudes = "attitudes.csv"\nposition_bias_sigma = 2.0\nattitude_bias_sigma = 0.01\n'
    made.toml = made.toml.replace(keys, "")
    known = load_sequence(made.write(tmp_path)).known
    assert (known.position_bias, known.attitude_bias) == (3.0, 0.0)
    # a table says for itself what its errors share
    plain = flight()
    plain.toml = plain.toml.replace("position_bias_sigma = 2.0\nattitude_bias_sigma = 0.01\n", "")
    known = load_sequence(plain.write(tmp_path / "plain")).known
    assert (known.position_bias, known.attitude_bias) == (0.0, 0.0)


@pytest.mark.parametrize("angles", ["yaw,pitch,roll", "omega,phi,kappa"])
def test_angles_are_against_the_axes_at_the_origin_of_their_table(tmp_path, angles):
    made = flight()
    made.toml = made.toml.replace('frame = "local"', 'frame = "local"\norigin = [20.0, 70.0, 0.0]')
    for k in range(6):
        made.positions[k][2:4] = [1000.0 * k, 0.0]
    level = load_sequence(made.write(tmp_path / "quaternions")).images.world_from_body
    made.toml = made.toml.replace("attitudes.csv", "angles.csv")
    # nose to the north of the origin, level there; the columns of the nominal camera run west of that nose
    rows = "".join(f"{k},0,0,{0 if angles[0] == 'y' else 180}\n" for k in range(6))
    made.extra["angles.csv"] = f"# origin = 20,70,0\nframe,{angles}\n{rows}"
    read = load_sequence(made.write(tmp_path / "origin")).images.world_from_body
    assert (read.inv() * level).magnitude().max() < 1e-9
    made.extra["angles.csv"] = f"frame,{angles}\n{rows}"
    read = load_sequence(made.write(tmp_path / "places")).images.world_from_body
    # meridians converge: 5 km east at latitude 70 on a sphere of 6390 km (normal radius there 6397 km)
    yaw = (level.inv() * read).as_rotvec()[5, 2]
    assert abs(yaw) == pytest.approx(5000.0 / 6390e3 * np.tan(np.radians(70.0)), rel=0.01)


def test_control_points_of_each_form(tmp_path):
    table = "x,y,z,sigma,image,line,column\n1,2,3,0.1,0,4,5\n1,2,3,0.1,f1.npy,6,7\n8,9,1,0.2,1,3,2\n"
    made = flight()
    made.toml = 'control_points = "c.csv"\ncontrol_sigma_px = 0.5\n' + made.toml
    made.extra["c.csv"] = table
    problem = load_sequence(made.write(tmp_path / "table"))
    np.testing.assert_array_equal(problem.control.position, [[1, 2, 3], [8, 9, 1]])
    np.testing.assert_array_equal(problem.control.sigma, [0.1, 0.2])
    np.testing.assert_array_equal(problem.control_tracks.image, [0, 1, 1])
    np.testing.assert_array_equal(problem.control_tracks.point, [0, 0, 1])
    np.testing.assert_array_equal(problem.control_tracks.pixels, [[4, 5], [6, 7], [3, 2]])
    assert (problem.control_tracks.sigma_px == 0.5).all()
    one = flight()
    one.toml += "[[control_point]]\nx = 1.0\ny = 2.0\nz = 3.0\nsigma = 0.1\n"
    one.toml += 'image = "0"\nline = 4\ncolumn = 5\n'
    assert len(load_sequence(one.write(tmp_path / "one")).control.point) == 1
    gcp = flight()
    gcp.toml = 'gcp_list = "gcp_list.txt"\n' + gcp.toml.replace(
        'frame = "local"', 'frame = "local"\norigin = [11.0, 48.0, 0.0]'
    )
    gcp.extra["gcp_list.txt"] = "EPSG:4326\n11.0 48.0 7.5 5 4 f0.npy a\n"
    problem = load_sequence(gcp.write(tmp_path / "gcp"))
    expected = from_geodetic([[np.radians(11.0), np.radians(48.0), 7.5]])
    np.testing.assert_allclose(problem.control.position, expected)
    np.testing.assert_array_equal(problem.control_tracks.pixels, [[4, 5]])


def test_filters_per_line_mosaic_and_channels(tmp_path):
    made = flight()
    made.toml = made.toml.replace("[surface]", 'wavelength_nm = "cube.hdr"\n[surface]')
    made.extra["cube.hdr"] = "ENVI\nwavelength = {" + ",".join(str(400 + k) for k in range(24)) + "}\n"
    np.testing.assert_array_equal(
        load_sequence(made.write(tmp_path / "a")).detector.wavelength_nm, 400.0 + np.arange(24)
    )
    made = flight()
    made.toml = made.toml.replace("[surface]", "mosaic_nm = [[450.0, 550.0], [650.0, 750.0]]\n[surface]")
    np.testing.assert_array_equal(
        load_sequence(made.write(tmp_path / "b")).mosaic_nm, [[450, 550], [650, 750]]
    )


@pytest.mark.parametrize(("first", "last", "step"), [(450.0, 565.0, 5.0), (565.0, 450.0, -5.0)])
def test_wavelengths_from_one_to_another(tmp_path, first, last, step):
    made = flight()
    made.toml = made.toml.replace(
        "[surface]", f"wavelength_nm = {{ from = {first}, to = {last} }}\n[surface]"
    )
    found = load_sequence(made.write(tmp_path)).detector.wavelength_nm
    np.testing.assert_allclose(found, [first + step * line for line in range(24)], rtol=1e-12)


def test_a_header_in_micrometres_that_does_not_say_so_is_reported(tmp_path):
    made = flight()
    made.toml = made.toml.replace("[surface]", 'wavelength_nm = "cube.hdr"\n[surface]')
    made.extra["cube.hdr"] = "ENVI\nwavelength = {" + ",".join(["0.45"] * 24) + "}\n"
    with pytest.raises(FormatError, match=r"cube\.hdr: .*0\.45 nm .*`wavelength units = Micrometers`"):
        load_sequence(made.write(tmp_path))


def test_frames_that_cannot_be_used_are_kept_with_the_reason(tmp_path):
    made = flight()
    made.images["f1.npy"] = picture(1)[:200]
    made.images["f2.npy"] = picture(2, (24, 30))
    made.images["f3.npy"] = npy(np.full(SHAPE, 7, dtype=np.uint16))
    del made.images["f4.npy"]
    problem = load_sequence(made.write(tmp_path))
    assert len(problem) == 6
    np.testing.assert_array_equal(problem.usable, [True, False, False, False, False, True])
    assert "cannot be read" in problem.excluded[1]
    assert problem.excluded[2] == "24 lines x 30 columns in place of 24 x 32"
    assert "constant" in problem.excluded[3] and "no such file" in problem.excluded[4]
    assert any("4 of 6 frames cannot be used" in words for words in problem.warnings)
    words = describe_sequence(read_sequence(tmp_path / "sequence.toml"))
    assert words["usable"] == 2 and any("frame 2: 24 lines" in line for line in words["missing"])


def test_no_gps_fix_and_the_wrong_hemisphere_are_left_out_and_reported(tmp_path):
    made = flight(8)
    made.toml = made.toml.replace('"local"', '"lonlat"').replace('attitudes = "attitudes.csv"\n', "")
    for k, row in enumerate(made.positions):
        row[2:5] = [-91.99, 46.84 + 5e-5 * k, 100.0]
    made.positions[2][2:4] = [0.0, 0.0]
    made.positions[5][2] = 91.99
    problem = load_sequence(made.write(tmp_path))
    assert np.isinf(problem.known.position[[2, 5]]).all()
    assert np.isfinite(np.delete(problem.known.position, [2, 5], axis=0)).all()
    steps = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert any("1 positions are 0, 0" in words and "frame 2" in words for words in problem.warnings)
    assert any("wrong hemisphere" in words and "frame 5" in words for words in problem.warnings)


def test_attitudes_that_look_at_the_sky_are_left_out(tmp_path):
    made = flight()
    made.attitudes[3][2:6] = [0.0, 0.0, 0.0, 1.0]
    problem = load_sequence(made.write(tmp_path))
    assert np.isinf(problem.known.attitude[3]).all()
    assert any("1 attitudes look away from the ground (first: 3)" in words for words in problem.warnings)


def test_two_flights_in_one_file_are_reported(tmp_path):
    made = flight(8)
    for name in ("frames", "positions", "attitudes"):
        for row in getattr(made, name)[4:]:
            row[1] += 7200.0
    problem = load_sequence(made.write(tmp_path))
    assert "between frames 3 and 4: are these 2 flights?" in problem.warnings[0]


def written(folder, toml):
    path = folder / "photographs.toml"
    path.write_text(toml)
    return path


def test_photographs_of_a_gimbal(tmp_path, real_data):
    folder = real_data("drone_brighton_lines12")
    toml = f'frames = "{folder}"\n[camera]\nbody_from_camera = [0.0, 0.0, 0.70710678, 0.70710678]\n'
    problem = load_sequence(written(tmp_path, toml + "[surface]\nheight = 158.0\n"))
    assert len(problem) == 12 and problem.usable.all() and problem.epoch == "2016-06-23T16:31:59Z"
    # image tops point along the flight, so that the body's yaw is the gimbal's: 45 degrees on the first line
    level = local_axes(np.radians(-91.9945), np.radians(46.8426))
    forward = (level.inv() * problem.images.world_from_body).apply([1.0, 0, 0])
    assert np.degrees(np.arctan2(forward[0, 0], forward[0, 1])) == pytest.approx(45.0, abs=0.01)
    assert (forward[:6] @ forward[7:].T < -0.9).all()  # the second line is flown back
    # 198.31 m above 158 m
    ground = problem.surface.intersect(
        problem.images.position, problem.images.world_from_body.apply([0, 0, 1.0])
    )
    assert np.linalg.norm(ground - problem.images.position, axis=1)[0] == pytest.approx(40.3, abs=0.1)
    assert problem.focal_length_sigma_px == 0.0 and "EXIF" in problem.warnings[0]


def test_the_file_for_photographs_of_a_drone_that_the_formats_show(tmp_path, real_data):
    folder = real_data("drone_brighton_lines12")
    toml = re.search(r"### Photographs of a drone.*?```toml\n(.*?)```", FORMATS, re.DOTALL)[1]
    problem = load_sequence(written(tmp_path, toml.replace('"photographs"', f'"{folder}"')))
    assert len(problem) == 12 and problem.usable.all() and problem.height_sigma == 5.0
    # RelativeAltitude of XMP says 39.8 to 40.1 m
    height = to_geodetic(problem.images.position, WGS84)[:, 2] - problem.surface.height
    assert height.min() > 39.7 and height.max() < 40.2


def test_photographs_without_heights_ask_for_the_altitude(tmp_path, real_data):
    folder = real_data("iss_astropi_a")
    camera = "[camera]\nfocal_length_px = 925.0\n"
    with pytest.raises(FormatError, match="10 positions have no height; give altitude"):
        load_sequence(written(tmp_path, f'frames = "{folder}"\n{camera}'))
    problem = load_sequence(written(tmp_path, f'frames = "{folder}"\naltitude = 420e3\n{camera}'))
    np.testing.assert_allclose(np.diff(problem.t), 6.0, atol=1.01)
    speed = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1) / np.diff(problem.t)
    assert np.median(speed) == pytest.approx(7350.0, rel=0.05)  # 7.66 km/s in orbit less the Earth's turn


def test_a_lens_of_one_camera_beside_a_folder_of_a_rig_is_refused_with_advice(tmp_path, real_data):
    folder = real_data("rededge_capture")
    text = f'frames = "{folder}"\n[camera]\nfocal_length_px = 1450.0\n'
    with pytest.raises(FormatError, match=r"focal_length_px of one: write a \[\[camera\]\] for each"):
        load_sequence(written(tmp_path, text))


def test_the_gimbal_at_zero_looks_at_the_northern_horizon():
    np.testing.assert_allclose(gimbal_attitude(np.zeros(3)).apply([0, 0, 1.0]), [1.0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(gimbal_attitude(np.zeros(3)).apply([1.0, 0, 0]), [0, 1.0, 0], atol=1e-15)
    down = gimbal_attitude(np.array([45.0, -90.0, 0.0]))
    np.testing.assert_allclose(down.apply([0, 0, 1.0]), [0, 0, 1.0], atol=1e-12)
    np.testing.assert_allclose(down.apply([0, -1.0, 0]), [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-12)


XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {}/></rdf:RDF></x:xmpmeta>"""


def test_xmp_of_rtk_fixes_and_signs():
    sigma = 'drone-dji:RtkStdLon="0.012" drone-dji:RtkStdLat="0.013" drone-dji:RtkStdHgt="0.03"'
    tags = parse_xmp(XMP.format(sigma + ' drone-dji:GpsLatitude="46.8" drone-dji:GpsLongtitude="-91.9"'))
    np.testing.assert_array_equal(tags.position_sigma, [0.012, 0.013, 0.03])
    assert tags.longitude_deg == -91.9 and tags.gimbal_deg is None
    nothing = parse_xmp(XMP.format(sigma.replace("0.012", "nan")))
    assert nothing.position_sigma is None
    assert parse_xmp("nothing of ours") is None
    for damaged in ("<x:xmpmeta", "<x:xmpmeta <</x:xmpmeta>"):
        with pytest.raises(FormatError, match=r"^p: its XMP cannot be read"):
            parse_xmp(damaged, place="p")
    from sightline.io.formats.exif import Exif

    place, turned = place_of(Exif("2026-01-01T00:00:00Z", 91.9, 46.8, None), tags)
    assert turned and place[:2] == (-91.9, 46.8) and np.isnan(place[2])


def toml(old, new):
    def spoil(made):
        assert old in made.toml
        made.toml = made.toml.replace(old, new)

    return spoil


def top(text):
    def spoil(made):
        made.toml = text + "\n" + made.toml

    return spoil


def camera(text):
    return toml("[surface]", text + "\n[surface]")


def cell(table, row, column, value):
    def spoil(made):
        getattr(made, table)[row][column] = value

    return spoil


def header(table, text):
    def spoil(made):
        made.headers[table] = text

    return spoil


def files(text, **extra):
    def spoil(made):
        made.toml = text + "\n" + made.toml
        made.extra |= {name.replace("_", "."): content for name, content in extra.items()}

    return spoil


def away(made):
    for row in made.attitudes:
        row[2:6] = [0.0, 0.0, 0.0, 1.0]


def utc_positions(made):
    made.toml = made.toml.replace('epoch = "2026-01-01T00:00:00Z"\n', "")
    for k, row in enumerate(made.positions):
        row[1] = f"2026-01-01T00:00:0{k}Z"


def rename(made):
    for row in made.positions:
        row[0] = f"image {row[0]}"


def no_positions_on_the_earth(made):
    made.toml = made.toml.replace('positions = "positions.csv"\n', "").replace('"local"', '"earth-fixed"')


def a_single_position(made):
    made.positions = made.positions[:1]
    made.toml = made.toml.replace("height_sigma = 1.0\n", "")


def transposed(made):
    for k in range(6):
        made.images[f"f{k}.npy"] = picture(k, SHAPE[::-1])


def gone(made):
    made.images.clear()


CONTROL = "x,y,z,sigma,image,line,column\n"
BAD = {
    "size of pixels of the cube": (toml("[surface]", "[cube]\ngsd = 0.0\n[surface]"), "cube.gsd = 0.0"),
    "bands of the cube": (toml("[surface]", "[cube]\nbands = [500.0, 500.0]\n[surface]"), "each once"),
    "no bands of the cube": (toml("[surface]", "[cube]\nbands = 0\n[surface]"), "cube.bands"),
    "ground of the cube": (toml("[surface]", '[cube]\nsurface = "dem"\n[surface]'), "cube.surface"),
    "formats of the cube": (toml("[surface]", '[cube]\nformats = ["nc"]\n[surface]'), "cube.formats"),
    "no format of the cube": (toml("[surface]", "[cube]\nformats = []\n[surface]"), "one or more of"),
    "two colours of the pictures": (
        toml("[surface]", "[cube]\npicture_nm = [650.0, 550.0]\n[surface]"), "three wavelengths"
    ),
    "unknown key of the cube": (toml("[surface]", "[cube]\nband = 3\n[surface]"), "cube.band"),
    "no frames": (toml('frames = "frames.csv"\n', ""), "'frames' is missing"),
    "unknown key": (top("framez = 3"), "framez"),
    "unknown key of a table": (camera("focal = 3.0"), "camera.focal"),
    "no table": (toml("frames.csv", "nope.csv"), "no such file"),
    "focal length": (toml("focal_length_px = 40.0\n", ""), "camera.focal_length_px' is missing"),
    "focal length of zero": (toml("= 40.0", "= 0.0"), "camera.focal_length_px = 0.0"),
    "shape": (toml("[24, 32]", "[24]"), "camera.shape"),
    "mount": (camera('mount = "sideways"'), "'sideways' is not known"),
    "mount twice": (camera('mount = "nominal"\nbody_from_camera = [0.0,0.0,0.0,1.0]'), "both given"),
    "quaternion": (camera("body_from_camera = [1.0, 1.0, 0.0, 0.0]"), "has length 1.41421"),
    "principal point": (camera("principal_point_px = [nan, 3.0]"), "camera.principal_point_px"),
    "distortion": (camera("distortion = [1.0,1.0,1.0,1.0,1.0,1.0]"), "camera.distortion"),
    "sigma and estimate": (camera('focal_length = "estimate"\nfocal_length_sigma_px = 2.0'), "keep "
    "one of them"),
    "wavelengths": (camera("wavelength_nm = [450.0, 500.0]"), "2 values, shape 24 lines"),
    "no wavelengths": (camera("wavelength_nm = []"), "wavelength_nm"),
    "wavelengths in um": (camera("wavelength_nm = [0.45, 0.5]"), r"\[1\]: 0.45 nm .*is 450 meant"),
    "range in um": (camera("wavelength_nm = { from = 0.45, to = 0.9 }"), r"from: 0.45 nm .*is 450 meant"),
    "half a range": (camera("wavelength_nm = { from = 450 }"), r"'camera.wavelength_nm.to' is missing"),
    "range misspelled": (camera("wavelength_nm = { form = 450, to = 900 }"), r"did you mean from"),
    "NaN wavelength": (camera("wavelength_nm = [nan]"), r"wavelength_nm\[1\] = nan is not allowed"),
    "negative range": (camera("wavelength_nm = { from = -450, to = 900 }"), r"from = -450 is not allowed"),
    "a single wavelength": (camera("wavelength_nm = 550"), "550 is not allowed: a list .* from = 450"),
    "negative wavelength": (camera("channel_nm = [-450.0]"), "channel_nm"),
    "no channels": (camera("channel_nm = []"), "channel_nm is empty"),
    "channels": (camera("channel_nm = [450.0, 550.0]"), "1 bands in place of the 2"),
    "two filters": (camera("channel_nm = [450.0]\nmosaic_nm = [[450.0]]"), "mosaic_nm and channel_nm "
    "are given"),
    "mosaic": (camera("mosaic_nm = [[450.0, 500.0], [550.0]]"), "rows of equal length"),
    "large mosaic": (camera(f"mosaic_nm = {[[500.0] * 40]}"), "1 rows x 40 columns, a frame 24 x 32"),
    "no header": (camera('wavelength_nm = "no.hdr"'), "no.hdr: no such file"),
    "negative readout": (camera("readout_time = -0.1"), "camera.readout_time"),
    "readout in ms": (camera("readout_time = 20.0"), "longer than the 0.5 s from frame to frame"),
    "overlap": (camera("[subset]\noverlap = 80.0"), "subset.overlap = 80.0"),
    "bias": (toml("position_bias_sigma = 2.0", "position_bias_sigma = -2.0"), "position_bias_sigma = -2.0"),
    "attitude bias": (toml("attitude_bias_sigma = 0.01", "attitude_bias_sigma = inf"), "attitude_bias_sigma"),
    "default sigma": (top("position_sigma = 0.0"), "position_sigma = 0.0"),
    "default angle": (top("attitude_sigma = -1.0"), "attitude_sigma = -1.0"),
    "altitude": (top('altitude = "high"'), "altitude = 'high'"),
    "gcp sigma": (top("gcp_sigma = 0.0"), "gcp_sigma = 0.0"),
    "control sigma": (top("control_sigma_px = 0.0"), "control_sigma_px = 0.0"),
    "world": (toml('"local"', '"moon"'), "'moon' is not known"),
    "epoch": (toml("2026-01-01T00:00:00Z", "yesterday"), "sequence.epoch: 'yesterday' is not a UTC instant"),
    "stars": (toml("[surface]", '[surface]\nkind = "infinity"'), "surface.kind is for stars"),
    "height sigma": (toml("height_sigma = 1.0", "height_sigma = -1.0"), "surface.height_sigma = -1.0"),
    "no dem": (toml("height = 0.0", 'dem = "no.tif"'), "no.tif"),
    "geo and positions": (top('geo = "geo.txt"'), "positions and geo are both given"),
    "two control tables": (top('gcp_list = "a"\ncontrol_points = "b"'), "control_points and gcp_list "
    "are given"),
    "gcp in a flat world": (top('gcp_list = "a"'), "hold map coordinates"),
    "columns of frames": (header("frames", "frame,t,file"), "column 'image' is missing"),
    "no image": (cell("frames", 2, 2, ""), "row 3 names no image"),
    "image twice": (cell("frames", 2, 2, "./f1.npy"), "rows 2 and 3 name the same image, './f1.npy'"),
    "frame twice": (cell("frames", 2, 0, 1), "frame '1' has 2 rows"),
    "no name": (cell("frames", 2, 0, ""), "row 3 has no frame"),
    "time twice": (cell("frames", 2, 1, 0.5), "duplicate times"),
    "times unordered": (cell("frames", 2, 1, 0.1), "unordered times"),
    "time in part utc": (cell("frames", 0, 1, "2026-01-01T00:00:00Z"), "line 3: t = '0.5' is no UTC instant"),
    "time utc of nowhere": (cell("frames", 0, 1, "2026-01-41T00:00:00Z"), "UTC instant"),
    "positions: utc": (utc_positions, "UTC, those of the frames seconds .*add .sequence. epoch"),
    "time nan": (cell("frames", 2, 1, "nan"), "column 't' is nan"),
    "positions: columns": (header("positions", "frame,t,x,y,h,a,b,c"), "column 'z' is missing"),
    "positions: nan": (cell("positions", 2, 2, "nan"), "column 'x' is nan"),
    "positions: covariance nan": (cell("positions", 2, 6, "nan"), "column 'sigma_y' is nan"),
    "positions: sigma": (cell("positions", 2, 6, 0.0), "sigma_y = 0; a 1-sigma error must be positive"),
    "positions: sigma of no size": (cell("positions", 2, 6, 1e-300), "sigma_y = 1e-300 is not allowed: 1e-7"),
    "attitudes: sigma of no end": (cell("attitudes", 2, 8, 1e300), "sigma_yaw = 1e.300 .* are these degrees"),
    "positions: one sigma": (header("positions", "frame,t,x,y,z,sigma_x,b,c"), "sigma_x alone"),
    "positions: time": (cell("positions", 2, 1, 77.0), "frame '2' has t = 77, in frames.csv it is 1"),
    "positions: names": (rename, "no row is of a frame: the first is of 'image 0'"),
    "positions: none": (toml('positions = "positions.csv"\n', ""), "no frame .* no control points"),
    "positions: none on the Earth": (no_positions_on_the_earth, "no frame has a position"),
    "positions: a single one": (a_single_position, "a single frame has a position"),
    "positions: axes": (toml('"local"', '"earth-fixed"'), "from the Earth's centre"),
    "positions: below ground": (toml("height = 0.0", "height = 400.0"), "no frame looks at the ground"),
    "attitudes: length": (cell("attitudes", 2, 5, 3.0), "quaternion of length"),
    "attitudes: sigma": (cell("attitudes", 2, 8, -1.0), "sigma_yaw = -1"),
    "attitudes: columns": (header("attitudes", "frame,t,qw,q1,q2,q3,a,b,c"), "column 'qx' is missing"),
    "attitudes: away": (away, "180 degrees from straight down"),
    "control: sigma": (files('control_points = "c.csv"', c_csv=CONTROL + "1,2,3,0,0,4,5\n"), "sigma"),
    "control: image": (
        files('control_points = "c.csv"', c_csv=CONTROL + "1,2,3,1,x,4,5\n"), "'x', which is no frame",
    ),
    "control: beside": (
        files('control_points = "c.csv"', c_csv=CONTROL + "1,2,3,1,0,4,500\n"), "outside its frame",
    ),
    "control: twice": (
        files('control_points = "c.csv"', c_csv=CONTROL + "1,2,3,1,0,4,5\n1,2,3,1,0,4,6\n"),
        "twice|two|both",
    ),
    "images: transposed": (transposed, "are lines and columns exchanged"),
    "images: none": (gone, "none of 6 frames can be used: 6 of them: no such file"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_reported(tmp_path, case):
    spoil, words = BAD[case]
    made = flight()
    spoil(made)
    with pytest.raises(SightlineError, match=words) as raised:
        load_sequence(made.write(tmp_path))
    assert isinstance(raised.value, FormatError | GeometryError)
    assert str(tmp_path) in str(raised.value)  # the file is named


def test_without_positions_a_flight_begins_where_control_points_are_seen_from(tmp_path):
    made = flight()
    toml('positions = "positions.csv"\n', "")(made)
    toml("position_bias_sigma = 2.0\n", "")(made)
    # 10 m east and 10 m north of frame 0, which is at (0, 0, 100) m: 40 px x 10 / 100 from the middle; lines
    # run forward, that is north, columns to the left. Frame 2 is 10 m further north. A third is seen once
    seen = "10,0,0,1,0,11.5,11.5\n0,10,0,1,0,15.5,15.5\n10,0,0,1,2,7.5,11.5\n0,10,0,1,2,11.5,15.5\n"
    files('control_points = "c.csv"', c_csv=CONTROL + seen + "0,20,0,1,4,11.5,15.5\n")(made)
    problem = load_sequence(made.write(tmp_path))
    np.testing.assert_allclose(problem.images.position, [[0.0, 5.0, 100.0]] * 6, atol=1e-9)
    assert np.isinf(problem.known.position).all()
    assert any("control points alone" in words for words in problem.warnings)


def test_every_key_has_a_description_and_a_test_or_a_default():
    schema = json_schema("sequence")
    for name in ("SequenceFile", "SequenceCamera", "SubsetSection"):
        table = schema if name == "SequenceFile" else schema["$defs"][name]
        for key, entry in table["properties"].items():
            assert "description" in entry or "$ref" in str(entry), f"{name}.{key}"


def test_a_focal_length_of_exif_is_where_estimate_begins_as_well_as_it_is_known():
    # 36 mm of film on the diagonal's scale: 43.27 mm are 500 px across a 3-4-5 frame
    exif = SimpleNamespace(focal_35mm=43.2666)
    frames = SimpleNamespace(xmp=(None,), exif=(None, exif))
    for given, expected in (("estimate", 50.0), (None, 0.0)):
        camera = SimpleNamespace(focal_length=given, focal_length_sigma_px=0.0, focal_length_px=None)
        focal, sigma, words = _focal_length(camera, None, frames, (300, 400))
        assert focal == pytest.approx(500.0, rel=1e-4) and sigma == pytest.approx(expected, rel=1e-4)
        assert "10 %" in words[0]


def coloured(folder: Path, counts, colours=None):
    """The flight with TIFFs of so many bands, each its own pixels."""
    import rasterio

    made = flight()
    path = made.write(folder)
    for k, count in enumerate(counts):
        name = f"f{k}.tif"
        pixels = np.random.default_rng(k).integers(1, 200, (count, *SHAPE)).astype(np.uint8)
        with rasterio.open(
            folder / name, "w", driver="GTiff", width=SHAPE[1], height=SHAPE[0], count=count, dtype="uint8"
        ) as image:
            image.write(pixels)
            if colours is not None:
                image.colorinterp = colours
        made.frames[k][2] = name
    made.write(folder)
    return path, pixels


def test_photographs_of_three_bands_are_red_green_and_blue_unless_said_otherwise(tmp_path):
    path, last = coloured(tmp_path / "a", (3,) * 6)
    problem = load_sequence(path)
    assert problem.channel_nm == (650.0, 550.0, 470.0)
    window = (0, SHAPE[0]), (0, SHAPE[1])
    for k in range(3):
        np.testing.assert_array_equal(problem.channels[5][k].read(*window), last[k])
    # matching has their mean
    np.testing.assert_allclose(problem.sources[5].read(*window), last.mean(axis=0), rtol=1e-6)
    path.write_text(path.read_text().replace("[camera]", "[camera]\nchannel_nm = [1.0e3, 560.0, 660.0]"))
    assert load_sequence(path).channel_nm == (1e3, 560.0, 660.0)


def test_alpha_is_no_colour_and_bands_without_a_name_are_counted(tmp_path):
    from rasterio.enums import ColorInterp as Colour

    path, _ = coloured(tmp_path / "a", (4,) * 6, (Colour.red, Colour.green, Colour.blue, Colour.alpha))
    assert load_sequence(path).channel_nm == (650.0, 550.0, 470.0)
    path, _ = coloured(tmp_path / "b", (5,) * 6)
    problem = load_sequence(path)
    assert np.isnan(problem.channel_nm).all() and len(problem.channels[0]) == 5
    said = str(describe_sequence(read_sequence(path)))
    assert "5 bands in each image (channel_nm names them)" in said
    # unlike images, and those of one band and alpha, are one grey map
    for name, counts in (("c", (3, 3, 3, 3, 3, 1)), ("d", (2,) * 6)):
        path, _ = coloured(tmp_path / name, counts)
        assert load_sequence(path).channel_nm == ()


def test_positions_may_be_those_of_an_antenna(tmp_path):
    """Nose north: body x is north, y east, z down; the antenna is 0.2 m ahead, 0.1 right, 1.5 above."""
    made = flight()
    made.toml = made.toml.replace("[camera]", "[camera]\nlever_arm = [0.2, 0.1, -1.5]")
    problem = load_sequence(made.write(tmp_path))
    expected = [[-0.1, 5.0 * k - 0.2, 98.5] for k in range(6)]
    np.testing.assert_allclose(problem.images.position, expected, atol=1e-12)
    swing = 0.03 * np.sqrt(0.2**2 + 0.1**2 + 1.5**2)
    np.testing.assert_allclose(problem.known.position, [np.hypot([1.0, 1.5, 2.0], swing)] * 6)
    bare = made.toml.replace('attitudes = "attitudes.csv"\n', "")
    (tmp_path / "sequence.toml").write_text(bare)
    with pytest.raises(FormatError, match="lever_arm needs attitudes, and there are none"):
        load_sequence(tmp_path / "sequence.toml")
