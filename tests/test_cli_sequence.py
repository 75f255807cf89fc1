"""SEQUENCE.toml on the command line: what is simulated is understood, and said."""

import json

import numpy as np
import pytest

from sightline.cli.main import run
from sightline.io.results.poses import read_pose_truth
from sightline.io.sequence.load import read_sequence

CASES = {
    "lvf": "122 wavelengths",
    "mosaic": "a mosaic",
    "rgb": "in the bands of each image",
    "two-lines": "rolling",
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_simulated_is_understood(tmp_path, capsys, case):
    out = tmp_path / "flight"
    lines, columns = ("488", "496") if case == "mosaic" else ("122", "136")  # the least that can be followed
    size = ["--frames", "12", "--lines", lines, "--columns", columns, "--set", "overlap=0.9"]
    bad = ["--set", "missing=4", "--set", "unreadable=7", "--set", "truth_bands=0"]
    assert run(["simulate", "frames", "--case", case, *size, *bad, "--out", str(out)]) == 0
    capsys.readouterr()
    assert run(["check", str(out / "sequence.toml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["usable"] == said["frames"] - 1
    assert any(line.startswith("frame 7: the pixels cannot be read") for line in said["missing"])
    assert any(CASES[case] in line for line in said["understood"])
    problem = read_sequence(out / "sequence.toml").problem
    truth = read_pose_truth(out / "poses-truth.csv")
    assert truth.frames == problem.frames
    # rough tables: sigma 1 m and a bias of 2 m per axis, .5 degrees and 1 degree; of 3 axes, 5 sigma each
    off = problem.images.position - truth.position
    assert np.abs(off).max() < 5.0 * np.hypot(problem.known.position, problem.known.position_bias).max()
    turn = (truth.world_from_body.inv() * problem.images.world_from_body).magnitude()
    assert turn.max() < 5.0 * np.hypot(problem.known.attitude, problem.known.attitude_bias).max()


def test_check_is_read_by_people_too(tmp_path, capsys):
    out = tmp_path / "flight"
    size = ["--frames", "6", "--lines", "128", "--columns", "144", "--set", "truth_bands=0"]
    assert run(["simulate", "frames", *size, "--out", str(out)]) == 0
    capsys.readouterr()
    assert run(["check", str(out / "sequence.toml")]) == 0
    said = capsys.readouterr().out
    assert "understood:" in said and "6 frames of 128 lines x 144 columns" in said and "observable:" in said
    (out / "frames.csv").write_text("frame,t,image\n0,nan,frames/frame-00000.tif\n")
    assert run(["check", str(out / "sequence.toml")]) == 2
    assert "column 't' is nan" in capsys.readouterr().err


def test_the_schema_is_printed(capsys):
    assert run(["schema", "sequence"]) == 0
    assert "wavelength_nm" in capsys.readouterr().out
