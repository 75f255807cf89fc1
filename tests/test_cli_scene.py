"""``sightline simulate --scene``: the file beside a scene makes it again; ``check`` reads it."""

from __future__ import annotations

import filecmp
import json
import tomllib

import pytest

from sightline.cli.main import run
from sightline.io.scene.recipe import read_recipe
from sightline.io.scene.schema import KINDS

#: Of each family a small scene, with keys of many kinds.
SCENES = {
    "strip": "line-of-sight --case clouds --lines 420 --columns 200 --set gyro=true --set star_tracker=true "
    "--set blank=[[50,20]] --set snr=40",
    "orbit": "line-of-sight --case mirror-leo --lines 128 --columns 224 --set off_nadir=.2",
    "photographs": "line-of-sight --case frames --frames 2 --lines 240 --columns 250 --set interval=4 "
    "--set relief_rms=40 --set focal_length_px=900",
    "pass": "stereo --shots 3 --points 12 --set dem_sigma=2 --set control_points=2 --set signs=random",
    "flight": "frames --case small --frames 4 --lines 122 --columns 136 --set missing=1 --set truth_bands=2",
}


@pytest.mark.parametrize("family", SCENES)
def test_the_file_beside_a_scene_makes_it_again(tmp_path, family, capsys):
    kind, *words = SCENES[family].split()
    first, second = tmp_path / "first", tmp_path / "second"
    assert run(["simulate", kind, *words, "--seed", "7", "--out", str(first), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == kind and said["seed"] == 7 and "scene.toml" in said["files"]
    scene = first / "scene.toml"
    assert tomllib.loads(scene.read_text())["seed"] == 7
    assert run(["simulate", kind, "--scene", str(scene), "--out", str(second)]) == 0
    files = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(second) for path in second.rglob("*") if path.is_file())
    assert filecmp.cmpfiles(first, second, files, shallow=False) == (files, [], [])
    capsys.readouterr()
    assert run(["check", str(scene)]) == 0
    assert f"a scene for `sightline simulate {kind} --scene`" in capsys.readouterr().out


def test_what_a_scene_cannot_be_made_of_names_its_file(tmp_path, capsys):
    scene = tmp_path / "mine.toml"
    scene.write_text("window = 2000.0\n")
    assert run(["simulate", "stereo", "--scene", str(scene), "--out", str(tmp_path / "out")]) == 1
    assert f"{scene}: camera" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_scene_that_no_machine_can_make_is_refused_before_it_is_begun(tmp_path, capsys):
    wide = ["--set", "altitude=1e8", "--set", "ifov=.01"]
    assert run(["simulate", "line-of-sight", "--set", "relief=spectrum", *wide, "--out", str(tmp_path)]) == 2
    assert "TB of memory" in capsys.readouterr().err
    walk = ["--case", "frames", "--set", "step_sigma=.05", "--frames", "9999", "--set", "focal_length_px=1e6"]
    uneven = ["--set", "relief_rms=9", "--set", "altitude=1e7"]
    assert run(["simulate", "line-of-sight", *walk, *uneven, "--out", str(tmp_path)]) == 2
    assert "TB of memory" in capsys.readouterr().err
    near = ["--case", "small", "--set", "focal_length_px=1e7"]  # metres of swing are millions of pixels
    assert run(["simulate", "frames", *near, "--out", str(tmp_path)]) == 2
    assert "TB of memory" in capsys.readouterr().err


def test_a_scene_given_to_another_command_is_pointed_back(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text('kind = "frames"\ncase = "small"\nframes = 4\n')
    assert run(["georeference", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "looks like a file for `sightline simulate` (SCENE.toml" in capsys.readouterr().err


def test_tdi_out_of_step_with_the_ground_is_said(tmp_path, capsys):
    size = ["--lines", "420", "--columns", "150", "--set", "stages=32"]
    command = ["simulate", "line-of-sight", *size, "--out", str(tmp_path), "--overwrite"]
    assert run(command) == 0
    assert "out of step" not in capsys.readouterr().err
    assert run([*command, "--set", "line_period=4.8e-4"]) == 0
    # 3.264 m over pixels of 3.4 m: the ground moves .96 px in a line
    assert "out of step with the ground by 1.24 px over its 32 stages" in capsys.readouterr().err
    assert run([*command, "--set", "line_period=4.8e-4", "--set", "ifov=4.8e-6"]) == 0
    assert "out of step" not in capsys.readouterr().err


def test_a_scene_onto_the_folder_of_what_it_is_made_of_is_refused(tmp_path, capsys):
    size = ["--lines", "420", "--columns", "150"]
    command = ["simulate", "line-of-sight", "--out", str(tmp_path), "--overwrite"]
    table = "column,stages\n" + "".join(f"{k},16\n" for k in range(150))
    (tmp_path / "truth.csv").write_text(table)
    assert run([*command, *size, "--set", f"stages={tmp_path / 'truth.csv'}"]) == 2
    assert "was read for the result and would be replaced" in capsys.readouterr().err
    assert (tmp_path / "truth.csv").read_text() == table
    scene = tmp_path / "scene.toml"
    scene.write_text('kind = "line-of-sight"\nlines = 420\ncolumns = 150  # as ours\n')
    assert run([*command, "--scene", str(scene)]) == 2
    assert "scene.toml: was read for the result and would be replaced" in capsys.readouterr().err
    assert "as ours" in scene.read_text()


@pytest.mark.parametrize("kind", KINDS)
def test_help_names_keys_that_the_scenes_have(kind, capsys):
    assert run(["simulate", kind, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    example = text.split("Any key of SCENE.toml, such as ")[1].split("; may")[0]
    for setting in example.split(" or "):
        read_recipe(kind, None, [setting])
