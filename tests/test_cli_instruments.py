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
        "--set",
        "off_nadir=0.05",
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
    arguments = ["--case", "frames", "--frames", "2", "--set", "interval=4", "--out", str(folder)]
    assert run(["simulate", "line-of-sight", *arguments]) == 0
    assert {"acquisition.toml", "frame-000.tif", "frame-001.tif"} <= {p.name for p in folder.iterdir()}
    assert "time = 4.0" in (folder / "acquisition.toml").read_text()


@pytest.mark.parametrize("key", ["off_nadir=0.05", "gyro=true", "dem=false", "motion=none"])
def test_what_photographs_do_not_have_is_refused(tmp_path, capsys, key):
    command = ["simulate", "line-of-sight", "--case", "frames", "--out", str(tmp_path / "scene")]
    assert run([*command, "--set", key]) == 2
    said = f"unknown key '{key.partition('=')[0]}'; it belongs to `simulate line-of-sight`, case "
    assert said in capsys.readouterr().err


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
        (["--case", "spin-leo", "--set", "off_nadir=1.4"], "looks past the Earth"),
        (
            ["--case", "nominal", "--set", "off_nadir=.1"],
            "'off_nadir'; it belongs to `simulate line-of-sight`",
        ),
        (["--case", "multi-line", "--set", "motion=wobble"], "motion = 'wobble' is not known; allowed: 'nom"),
        (["--case", "nominal", "--frames", "3"], "--frames is not for case 'nominal'; it belongs to"),
        (
            ["--case", "spin-leo", "--off-nadir", "3"],
            "--off-nadir is a key of the scene: --set off_nadir=VALUE (rad",
        ),
        (["--case", "nominal", "--no-dem"], "--no-dem is a key of the scene: --set dem=VALUE"),
        (["--case", "nominal", "--lins", "3"], "No such option: --lins"),
    ],
)
def test_what_an_instrument_does_not_have_is_refused(tmp_path, capsys, arguments, words):
    assert run([*COMMAND, *arguments, "--out", str(tmp_path / "scene")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "scene").exists()
