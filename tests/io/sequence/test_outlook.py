"""What ``check`` says of a flight before it is solved: gaps, overlap, maps, what is missing.

The flight is straight and level in closed form: a frame of 24 x 32 px at f = 40 px from 100 m covers
60 m x 80 m, steps are 5 m in 0.5 s.
"""

from __future__ import annotations

import re

import pytest
from tests.io.sequence_files import flight

from sightline.errors import InputError
from sightline.io.results.cube_summary import check_cube
from sightline.io.sequence import outlook as describe_outlook
from sightline.io.sequence.describe import describe_sequence
from sightline.io.sequence.load import read_sequence


def described(made, folder):
    said = describe_sequence(read_sequence(made.write(folder)))
    return {title: "\n".join(said[title]) for title in ("understood", "missing", "observable")}


def without(made, rows):
    for name in ("frames", "positions", "attitudes"):
        table = getattr(made, name)
        setattr(made, name, [row for k, row in enumerate(table) if k not in rows])
    return made


def test_a_plain_flight(tmp_path):
    said = described(flight(40), tmp_path)
    assert "every 0.5 s" in said["understood"] and "missing" not in said["understood"]
    # 1 - 5 m / 60 m
    assert "share about 92%" in said["observable"]
    # 39 x 5 m + 60 m by 80 m, pixels of 2.5 m: 102 rows x 32 columns, rounded outwards
    size = re.search(r"of (\d+) rows x (\d+) columns of 2.5 m", said["observable"])
    rows, columns = map(int, size.groups())
    assert abs(rows - 102) <= 1 and abs(columns - 32) <= 2
    assert "those of the points that are found" in said["observable"]


def test_gaps_and_the_overlap_that_they_leave(tmp_path):
    said = described(without(flight(40), {10, 11, 12, 30}), tmp_path)
    assert "2 gaps in time, in which about 4 frames are missing" in said["understood"]
    assert "between 9 and 13 (2 s), 29 and 31 (1 s)" in said["understood"]
    # 1 - 20 m / 60 m
    assert "share about 92%" in said["observable"] and "at least 67%, between 9 and 13" in said["observable"]


def test_stretches_and_what_they_share(tmp_path):
    made = flight(40)
    for name in ("frames", "positions", "attitudes"):
        for row in getattr(made, name)[20:]:
            row[1] += 60.0
    for row, first in zip(made.positions[20:], made.positions[:20], strict=True):
        row[2], row[3] = 30.0, first[3]
    said = described(made, tmp_path / "near")
    assert "in 2 stretches between pauses: 0 to 19 (20), 20 to 39 (20)" in said["understood"]
    assert "100% of the frames see ground that another stretch sees too" in said["observable"]
    for row in made.positions[20:]:
        row[2] = 500.0
    assert "0% of the frames see ground" in described(made, tmp_path / "far")["observable"]


def test_a_camera_across_the_flight_is_counted_by_its_columns(tmp_path):
    made = flight(40)
    # columns forward: body from camera turned by a quarter about the line of sight
    made.toml = made.toml.replace("[surface]", "body_from_camera = [0.0, 0.0, 0.0, 1.0]\n[surface]")
    # 1 - 5 m / 80 m
    assert "share about 94%" in described(made, tmp_path)["observable"]


def test_heights_that_are_not_given(tmp_path):
    made = flight(12)
    made.toml = made.toml[: made.toml.index("[surface]")]
    said = described(made, tmp_path)
    assert "gives no height of the ground: 0 m in z is where the solution starts" in said["understood"]
    assert "height_sigma" in said["missing"]


def test_programs_that_are_not_installed_are_named(tmp_path, monkeypatch):
    made = flight(12)
    made.toml = made.toml.replace('attitudes = "attitudes.csv"\n', "") + '[cube]\nformats = ["tif", "zarr"]\n'
    monkeypatch.setattr(describe_outlook, "find_spec", lambda name: None)
    said = described(made, tmp_path)
    assert "pycolmap, which is needed as no attitudes are given" in said["missing"]
    assert "zarr, for [cube] formats" in said["missing"]


def test_maps_that_the_camera_cannot_give_are_refused_before_any_work(tmp_path):
    made = flight(12)
    made.toml = made.toml.replace("[surface]", "wavelength_nm = { from = 450, to = 900 }\n[surface]")
    made.toml += "[cube]\nbands = [300.0]\n"
    with pytest.raises(
        InputError, match=r"sequence.toml: \[cube\] bands must be wavelengths from 450 to 900 nm"
    ):
        check_cube(read_sequence(made.write(tmp_path)))


def test_no_maps_and_maps_of_unknown_size(tmp_path):
    made = flight(12)
    made.toml += "[cube]\nmake = false\n"
    assert "no maps" in described(made, tmp_path / "a")["observable"]
    made = flight(12)
    made.toml = 'control_points = "c.csv"\n' + made.toml.replace('positions = "positions.csv"\n', "")
    made.extra["c.csv"] = "x,y,z,sigma,image,line,column\n10,0,0,1,0,11.5,11.5\n0,10,0,1,0,15.5,15.5\n"
    assert "size is known once control points" in described(made, tmp_path / "b")["observable"]
