"""``sightline simulate line-of-sight`` of the instruments over a real orbit, and what it refuses."""

from __future__ import annotations

import json

import pytest

from sightline.cli import options
from sightline.cli.main import run
from sightline.simulate.instruments import INSTRUMENT_CASES
from sightline.simulate.strip_options import CASES

COMMAND = ["simulate", "line-of-sight", "--lines", "64", "--columns", "48"]


def test_the_help_names_every_case():
    assert options.ORBIT_CASES == INSTRUMENT_CASES and options.STRIP_CASES == CASES


def test_an_unknown_case_is_answered_with_every_case(tmp_path, capsys):
    assert run([*COMMAND, "--case", "foo", "--out", str(tmp_path / "scene")]) == 2
    said = capsys.readouterr().err
    assert all(case in said for case in (*CASES, *INSTRUMENT_CASES))


def test_the_demo_says_which_cases_are_not_its_own(tmp_path, capsys):
    assert run(["demo", "--case", "spin-leo", "--out", str(tmp_path / "demo")]) == 2
    assert "simulate line-of-sight --case spin-leo" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


def test_an_instrument_is_rendered_and_checked(tmp_path, capsys):
    folder = tmp_path / "scene"
    arguments = [
        "--case",
        "spin-geo",
        "--off-nadir",
        "3",
        "--lines",
        "240",
        "--columns",
        "200",
        "--out",
        str(folder),
    ]
    assert run([*COMMAND, *arguments]) == 0
    assert {"acquisition.toml", "positions.csv", "PAN.tif", "truth.csv"} <= {p.name for p in folder.iterdir()}
    capsys.readouterr()
    assert run(["check", str(folder / "acquisition.toml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["pairs"][0]["lag"] == pytest.approx(97 * 28e-6 / 0.10472, rel=1e-2)


def test_photographs_of_a_matrix_instrument_are_rendered(tmp_path):
    folder = tmp_path / "scene"
    arguments = ["--case", "frames", "--count", "2", "--interval", "4", "--out", str(folder)]
    assert run(["simulate", "line-of-sight", *arguments]) == 0
    assert {"acquisition.toml", "frame-000.tif", "frame-001.tif"} <= {p.name for p in folder.iterdir()}
    assert "time = 4.0" in (folder / "acquisition.toml").read_text()


@pytest.mark.parametrize("arguments", [["--off-nadir", "3"], ["--gyro"], ["--no-dem"], ["--motion", "none"]])
def test_what_photographs_do_not_have_is_refused(tmp_path, capsys, arguments):
    command = ["simulate", "line-of-sight", "--case", "frames", "--out", str(tmp_path / "scene")]
    assert run([*command, *arguments]) == 2
    assert f"{arguments[0]} is not for case 'frames'" in capsys.readouterr().err


def test_check_finds_the_few_columns_that_staggered_detectors_share(tmp_path, capsys):
    folder = tmp_path / "scene"
    arguments = ["--case", "staggered", "--lines", "520", "--out", str(folder)]
    assert run(["simulate", "line-of-sight", *arguments]) == 0
    capsys.readouterr()
    assert run(["check", str(folder / "acquisition.toml")]) == 0
    said = capsys.readouterr().out
    assert "see no common ground" not in said and "CCD1 - CCD2: lag" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--case", "spin-leo", "--off-nadir", "80"], "looks past the Earth"),
        (["--case", "nominal", "--off-nadir", "5"], "--off-nadir is not for case 'nominal'"),
        (["--case", "mirror-leo", "--no-dem"], "--no-dem is not for case 'mirror-leo'"),
        (["--case", "staggered", "--gyro"], "--gyro is not for case 'staggered'"),
        (["--case", "multi-line", "--motion", "wobble"], "unknown motion: got 'wobble'"),
        (["--case", "nominal", "--count", "3"], "--count is not for case 'nominal'; it is for: frames"),
        (["--case", "spin-leo", "--estimate-camera"], "--estimate-camera is not for case 'spin-leo'"),
        (["--case", "frames"], "--lines is not for case 'frames'"),
    ],
)
def test_what_an_instrument_does_not_have_is_refused(tmp_path, capsys, arguments, words):
    assert run([*COMMAND, *arguments, "--out", str(tmp_path / "scene")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "scene").exists()
