"""`sightline export` and `result.export`: what is written, said and refused."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest
import rasterio

import sightline
from sightline.cli.export import FORMS
from sightline.cli.main import run


def words(recovery, tmp_path, to, *more):
    return ["export", str(recovery.folder), "--to", to, "--out", str(tmp_path / "out"), *more]


def toml_of(recovery):
    return ["--acquisition", str(recovery.scene / "acquisition.toml")]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_attitude_and_sigma_come_from_the_folder_alone(recovery, tmp_path, capsys):
    assert run([*words(recovery, tmp_path, "quaternions"), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert names(tmp_path / "out") == ["export.json", "quaternions.csv"]
    assert summary["files"] == ["quaternions.csv"] and summary["to"] == "quaternions"
    with (
        (tmp_path / "out" / "quaternions.csv").open() as one,
        (recovery.folder / "attitude.csv").open() as two,
    ):
        mine, theirs = list(csv.DictReader(one)), list(csv.DictReader(two))
    assert [row["t"] for row in mine] == [row["t"] for row in theirs]
    assert float(mine[7]["qy"]) == pytest.approx(float(theirs[7]["qy"]), abs=1e-12)
    assert "x" not in mine[0] and float(mine[7]["sigma_roll"]) > 0.0
    # what no image shows is in the attitude, and no other program reads hidden.csv
    assert all(row["sigma_absolute_pitch"] == "inf" for row in mine)
    assert "a constant of roll, pitch and yaw, a drift of" in summary["warnings"][0]


def test_shifts_need_the_acquisition_and_say_how_much_the_motion_moved(recovery, tmp_path, capsys):
    assert run(words(recovery, tmp_path, "shifts")) == 2
    assert (
        "--to shifts holds a camera, which the result does not: add --acquisition FILE"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "out").exists()
    assert run(words(recovery, tmp_path, "shifts", *toml_of(recovery))) == 0
    said = capsys.readouterr().out
    assert "PAN" in said and "px in lines" in said
    with rasterio.open(tmp_path / "out" / "PAN_shifts.tif") as raster:
        moved = raster.read()
    # pitch moves lines by itself, roll columns; yaw, on average over the columns, neither
    lines = recovery.result.lines
    found = recovery.result.motion.angles[(lines >= 0) & (lines < moved.shape[1])] / recovery.result.ifov
    for axis, shift in ((1, moved[0]), (0, moved[1])):
        rows = shift.mean(axis=1)
        # lines and pixels of the ground are as large within a percent; the columns' middle lies off the axis
        assert np.abs(rows - rows.mean() - found[:, axis] + found[:, axis].mean()).max() < 0.02


@pytest.mark.parametrize("to", ["csm", "isd", "rpc"])
def test_a_flat_world_has_no_body_to_be_fixed_to(recovery, tmp_path, to, capsys):
    # the folder's own message names its axes: the acquisition is not asked for first
    for more in ([], toml_of(recovery)):
        assert run(words(recovery, tmp_path, to, *more)) == 2
        assert f"--to {to} needs axes that are fixed to a body" in (said := capsys.readouterr().err)
    assert f"--to {to} needs axes that are fixed to a body; these are local" in said
    assert said.endswith("as it is, this result gives --to aem, oem, quaternions, shifts, isis\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("to", "more", "said"),
    [
        (
            "obj",
            [],
            "--to is 'obj'; allowed are csm, isd, aem, oem, rpc, quaternions, shifts, ck, isis",
        ),
        ("quaternions", ["--kernel", "naif.tls"], "--kernel is for --to ck and isis"),
        ("quaternions", ["--acquisition", "none.toml"], "none.toml: no such file"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_written(recovery, tmp_path, to, more, said, capsys):
    assert run(words(recovery, tmp_path, to, *more)) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_is_kept(recovery, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    assert run(words(recovery, tmp_path, "quaternions")) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run([*words(recovery, tmp_path, "quaternions"), "--overwrite"]) == 0
    assert names(tmp_path / "out") == ["export.json", "mine.txt", "quaternions.csv"]


def test_a_result_of_another_kind_says_what_is_exported(recovery, tmp_path, capsys):
    folder = tmp_path / "scored"
    folder.mkdir()
    summary = {"result": "LayoutChoice", "version": "0"}
    (folder / "summary.json").write_text(json.dumps(summary))
    assert run(["export", str(folder), "--to", "aem", "--out", str(tmp_path / "out")]) == 2
    assert "sightline: error" in capsys.readouterr().err


def test_python_writes_what_the_command_writes(recovery, tmp_path):
    assert run(words(recovery, tmp_path, "shifts", *toml_of(recovery))) == 0
    place = recovery.result.export("shifts", tmp_path / "made")
    opened = sightline.open_result(recovery.folder)
    opened.export("shifts", tmp_path / "opened", acquisition=recovery.scene / "acquisition.toml")
    for other in (place, tmp_path / "opened"):
        for name in names(tmp_path / "out"):
            if name.endswith(".tif"):
                with rasterio.open(tmp_path / "out" / name) as one, rasterio.open(other / name) as two:
                    # motion.csv holds nine digits of angles of some px
                    np.testing.assert_allclose(one.read(), two.read(), atol=1e-4)
    with pytest.raises(sightline.InputError, match="give acquisition=FILE"):
        opened.export("shifts", tmp_path / "none")


def test_files_of_a_result_are_never_replaced(recovery, tmp_path, capsys):
    copy = tmp_path / "out"
    shutil.copytree(recovery.folder, copy)
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    assert run([*words(recovery, tmp_path, "quaternions"), "--overwrite"]) == 2
    assert "holds a result" in capsys.readouterr().err
    with pytest.raises(sightline.InputError, match="holds a result"):
        sightline.open_result(copy).export("quaternions", copy, overwrite=True)
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before


def test_an_earlier_export_goes_whole(recovery, tmp_path):
    assert run(words(recovery, tmp_path, "shifts", *toml_of(recovery))) == 0
    (tmp_path / "out" / "mine.txt").write_text("mine")
    assert run([*words(recovery, tmp_path, "quaternions"), "--overwrite"]) == 0
    assert names(tmp_path / "out") == ["export.json", "mine.txt", "quaternions.csv"]


def test_the_forms_that_are_named_in_place_of_one_are_those_that_can_be_written(recovery, tmp_path, capsys):
    assert run(words(recovery, tmp_path, "shifts")) == 2
    (given,) = [line for line in capsys.readouterr().err.splitlines() if "as it is" in line]
    named = given.partition("gives --to ")[2].split(", ")
    others = [to for to in FORMS if to not in named and to != "ck"]
    for to in named:
        assert run(["export", str(recovery.folder), "--to", to, "--out", str(tmp_path / to)]) == 0
    for to in others:
        assert run(["export", str(recovery.folder), "--to", to, "--out", str(tmp_path / to)]) == 2
