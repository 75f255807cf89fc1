"""What ``check`` doubts: focal lengths in mm, angles in degrees, missing sigmas, metres as degrees."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.sequence_files import NORTH, flight

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.io.formats.exif import Exif
from sightline.io.formats.odm import read_geo
from sightline.io.sequence.describe import describe_sequence
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.load import read_sequence
from sightline.io.sequence.positions import given_positions
from sightline.io.sequence.schema import SequenceFile


def understood(made, folder):
    said = describe_sequence(read_sequence(made.write(folder)))
    return "\n".join(said["understood"] + said["missing"])


def test_the_field_of_view_shows_a_focal_length_in_mm(tmp_path):
    made = flight()
    said = understood(made, tmp_path / "px")
    # 2 atan(12 / 40) and 2 atan(16 / 40)
    assert "field of view of 33.4 degrees along x 43.6 across" in said and "mm" not in said
    made.toml = made.toml.replace("focal_length_px = 40.0", "focal_length_px = 8.0")
    # 2 atan(12 / 8), 2 atan(16 / 8)
    path = made.write(tmp_path / "mm")
    assert any(
        words.startswith("suspicious: the field of view")
        for words in describe_sequence(read_sequence(path))["missing"]
    )
    warned = [w for w in read_sequence(path).problem.warnings if "field of view" in w]
    assert len(warned) == 1 and "113 x 127 degrees" in warned[0] and "given in mm" in warned[0]


def test_constant_errors_of_angles_in_degrees_are_asked_about(tmp_path):
    made = flight()
    assert "degrees meant" not in understood(made, tmp_path / "rad")
    made.toml = made.toml.replace("attitude_bias_sigma = 0.01", "attitude_bias_sigma = 1.0")
    said = understood(made, tmp_path / "degrees")
    assert "1 rad is 57.3 degrees: were degrees meant? 1 degrees are 0.0175 rad" in said


def test_what_is_doubted_of_units_the_run_says_too(tmp_path):
    made = flight()
    made.toml = made.toml.replace("attitude_bias_sigma = 0.01", "attitude_bias_sigma = 1.0")
    for rows in (made.frames, made.positions, made.attitudes):  # ms for s
        for row in rows:
            row[1] = 1e3 * row[1]
    warned = read_sequence(made.write(tmp_path)).problem.warnings
    assert any("were degrees meant" in words for words in warned)
    # 5 m in 500 s
    assert any("flies at 0.01 m/s by the tables: are times in seconds" in words for words in warned)


@pytest.mark.parametrize("command", ["check", "georeference"])
@pytest.mark.parametrize(
    ("old", "new", "status", "words"),
    [
        # a frame sees 60 m at 100 m, frames are 5 m apart
        ("focal_length_px = 40.0", "focal_length_px = 40e3", 1, "no ground in common .*share 0%"),
        ("height_sigma = 1.0", "height_sigma = 1.0\n[cube]\ngsd = 900.0", 2, r"\[cube\] gsd = 900 m"),
    ],
)
def test_check_refuses_what_the_run_refuses(tmp_path, capsys, command, old, new, status, words):
    made = flight(shape=(128, 160))
    made.toml = made.toml.replace(old, new)
    path = made.write(tmp_path / "given")
    given = [command, str(path)] + (["--out", str(tmp_path / "out")] if command == "georeference" else [])
    assert run(given) == status
    said = capsys.readouterr().err
    assert re.search(words, said) and str(path) in said


@pytest.mark.parametrize("away", ["all", "some"])
def test_positions_of_exchanged_longitude_and_latitude_are_suspected(tmp_path, away):
    made = flight()
    made.toml = made.toml.replace('frame = "local"', 'frame = "lonlat"').replace("height_sigma = 1.0", "")
    lon, lat = np.radians(80.0), np.radians(-60.0)
    down = local_axes(lon, lat) * Rotation.from_quat(NORTH)
    for row in made.positions:
        row[2:5] = [-60.0 + row[3] / 111e3, 80.0, 3000.0]  # exchanged
    for row in made.attitudes:
        row[2:6] = down.as_quat().tolist()
    if away == "some":  # two cameras happen to look down where they are said to be
        there = local_axes(np.radians(-60.0), np.radians(80.0)) * Rotation.from_quat(NORTH)
        for row in made.attitudes[:2]:
            row[2:6] = there.as_quat().tolist()
        warned = read_sequence(made.write(tmp_path)).problem.warnings
        assert any("4 attitudes look away" in words for words in warned)
        assert any(" 0 degrees with longitude and latitude of their" in words for words in warned)
        return
    with pytest.raises(FormatError, match=r"away from the ground, in every frame.* 0 degrees with longitude"):
        read_sequence(made.write(tmp_path))


def test_metres_given_as_degrees_are_refused(tmp_path):
    made = flight()
    made.toml = made.toml.replace('frame = "local"', 'frame = "lonlat"')
    for row in made.positions:
        row[2] = 500.0
    with pytest.raises(FormatError, match=r'longitudes .x. reach 500,.*give frame = "local"'):
        read_sequence(made.write(tmp_path))


def test_metres_in_a_geo_txt_of_degrees_are_refused(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:4326\na.jpg 8.0 47.0 500\nb.jpg 12.0 112.5 500\n")
    with pytest.raises(FormatError, match=r"12, 112\.5 is no place in the coordinate system of line 1"):
        read_geo(path)
    path.write_text("EPSG:4326\na.jpg 8.0 47.0 500\nb.jpg 12.0 47.5 500\n")
    assert read_geo(path).lonlat[1] == pytest.approx([12.0, 47.5, 500.0])


@pytest.mark.parametrize(
    ("key", "said"),
    [
        (
            "focal_length_mm = 8.0",
            "unknown key 'camera.focal_length_mm'; give focal_length_px = 8 mm / pixel",
        ),
        (
            "focal_length = 8.0",
            "camera.focal_length = 8.0 is not allowed: give focal_length_px = 8 mm / pixel",
        ),
        ("", "'camera.focal_length_px' is missing.*focal_length = \"estimate\""),
    ],
)
def test_the_error_of_a_focal_length_in_mm_says_what_to_give(tmp_path, key, said):
    made = flight()
    made.toml = made.toml.replace("focal_length_px = 40.0", key)
    with pytest.raises(FormatError, match=said):
        read_sequence(made.write(tmp_path))


def test_a_table_without_sigmas_says_what_is_assumed(tmp_path):
    made = flight()
    made.headers["positions"] = "frame,t,x,y,z"
    made.positions = [row[:5] for row in made.positions]
    assert "6 positions have no sigma: 5 m per axis is assumed; set position_sigma" in understood(
        made, tmp_path / "none"
    )
    made.toml = "position_sigma = 3.0\n" + made.toml
    assert "assumed" not in understood(made, tmp_path / "given")


def photographs(speed: float, stamp: str) -> FrameList:
    """Ten photographs northwards at one a second, their places exact."""
    t = np.arange(10.0)
    begin = datetime.fromisoformat("2026-01-01T00:00:00")
    exif = tuple(
        Exif((begin + timedelta(seconds=k)).isoformat() + stamp, 8.0, 47.0 + speed * k / 111e3, 500.0)
        for k in t
    )
    names = tuple(f"{k:.0f}" for k in t)
    return FrameList(Path("photos"), names, t, (Path("x"),) * 10, None, exif, (None,) * 10)


@pytest.mark.parametrize(
    ("speed", "stamp", "doubted"), [(60.0, "Z", True), (60.0, ".25Z", False), (10.0, "Z", False)]
)
def test_whole_seconds_of_a_fast_camera(speed, stamp, doubted):
    file = SequenceFile.model_validate({"frames": "photos", "world": {"frame": "lonlat"}})
    warnings: list[str] = []
    rows = given_positions(file, None, photographs(speed, stamp), None, warnings)
    # a degree of latitude is 111 km to 1 %
    moved = np.linalg.norm(rows.values[-1] - rows.values[0])
    assert moved == pytest.approx(9.0 * speed, rel=0.01)
    start = from_geodetic([[np.radians(8.0), np.radians(47.0), 500.0]], WGS84)[0]
    assert np.linalg.norm(rows.values[0] - start) < 1e-6
    assert any("10 positions have no sigma: 5 m per axis is assumed" in words for words in warnings)
    # 0.3 s at 60 m/s are 18 m
    said = [words for words in warnings if "whole seconds" in words]
    assert bool(said) == doubted and (not doubted or "leaves 18 m along the flight" in said[0])


@pytest.mark.parametrize(
    ("frame", "row", "said", "doubted"),
    [
        ("local", lambda k: [0.0, 5.0 * k, 100.0], "x 0, y 0, z 100 m, flies north", ""),
        # 1e-4 degrees a step, 5 of them: of latitude
        ("local", lambda k: [2.35, 48.85 + 1e-4 * k, 100.0], "flies north", "span 0.0005 m.*degrees.*lonlat"),
        ("local", lambda k: [0.0, 0.005 * k, 100.0], "flies north", "span 0.025 m.*in km"),
        ("lonlat", lambda k: [-2.35 - 1e-4 * k, -48.85, 100.0], "2.35 W 48.85 S, 100 m, flies west", ""),
    ],
)
def test_check_says_where_the_flight_is_and_doubts_degrees_taken_for_metres(
    tmp_path, frame, row, said, doubted
):
    made = flight()
    made.toml = made.toml.replace('"local"', f'"{frame}"')
    for k, given in enumerate(made.positions):
        given[2:5] = row(k)
    if frame == "lonlat":  # attitudes in Earth-fixed axes are not of interest
        made.toml = made.toml.replace('attitudes = "attitudes.csv"\n', "")
        made.toml = made.toml.replace("attitude_bias_sigma = 0.01\n", "")
    path = made.write(tmp_path)
    description = describe_sequence(read_sequence(path))
    assert any(said in words for words in description["understood"])
    doubts = [words for words in description["missing"] if words.startswith("suspicious: positions span")]
    assert bool(doubts) == bool(doubted)
    if doubted:
        assert re.search(doubted, doubts[0])
        assert any(re.search(doubted, words) for words in read_sequence(path).problem.warnings)


def test_sigmas_that_differ_are_each_said(tmp_path):
    said = understood(flight(), tmp_path)
    assert "positions of 6 frames, sigma x 1, y 1.5, z 2 m" in said
    assert "attitudes of 6 frames, sigma roll 0.01, pitch 0.02, yaw 0.03 rad (roll 0.573" in said


@pytest.mark.parametrize(("pitch", "refused"), [(0.0, False), (-60.0, False), (-90.0, True)])
def test_pitch_of_a_gimbal_is_asked_about(tmp_path, pitch, refused):
    made = flight()
    made.headers["attitudes"] = "frame,t,yaw,pitch,roll"
    made.attitudes = [[k, 0.5 * k, 0.0, pitch, 0.0] for k in range(6)]
    path = made.write(tmp_path)
    if refused:
        with pytest.raises(FormatError, match=r"pitch, -90 degrees.*of the body.*gimbal"):
            read_sequence(path)
        return
    warned = read_sequence(path).problem.warnings
    assert any("gimbal" in words for words in warned) == (pitch < 0.0)
    # no column of the table tells a sigma
    assert any("6 attitudes have no sigma: 0.035 rad (2.01 degrees)" in words for words in warned)


def test_the_error_of_a_date_in_another_form_names_both_that_are_read(tmp_path):
    made = flight()
    for row in made.frames:
        row[1] = "31/12/2026 12:00:00"
    with pytest.raises(FormatError, match=r"neither seconds from the epoch.*as 2026-01-31T12:00:00Z"):
        read_sequence(made.write(tmp_path))
