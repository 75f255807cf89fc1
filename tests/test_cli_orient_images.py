"""``sightline orient`` on pictures: the package finds the points itself."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest

from consistency import assert_possible
from sightline.cli.main import run
from sightline.simulate.stereo import stereo_case
from sightline.simulate.stereo_files import write_stereo
from sightline.simulate.stereo_images import Sensor, write_stereo_images


@pytest.fixture(scope="module")
def pass_(tmp_path_factory):
    """Rendered frames of a short pass of two cameras that converge at some 20 degrees."""
    folder = tmp_path_factory.mktemp("pictures")
    scenario = stereo_case(
        "A_paper_T6_K64", 2, separation=20.0, shots=3, window=16.0, columns=200, fov=0.0087, relief="none",
        points=20, scene_size=3e3, ground_size=40e3,
    )  # fmt: skip
    write_stereo(scenario, folder)
    ground = scenario.surface, scenario.pair.aim_point, scenario.pair.world_from_local
    write_stereo_images(
        folder,
        scenario.cameras,
        scenario.true_images,
        scenario.detectors,
        scenario.mounts,
        ground,
        Sensor(),
        2,
    )
    text = (folder / "stereo.toml").read_text().replace('matches = "matches.csv"', 'images = "images.csv"')
    (folder / "stereo.toml").write_text(text)
    return folder


def test_points_are_found_and_the_angles_are_those_put_in(pass_, capsys):
    out = pass_ / "out"
    assert run(["orient", str(pass_ / "stereo.toml"), "--out", str(out), "--json"]) == 0, (
        capsys.readouterr().err
    )
    summary = json.loads(capsys.readouterr().out)
    assert summary["matches"]["kind"] == "sightings" and summary["matches"]["kept"] > 200
    assert run(["score", str(out), str(pass_ / "orientation-truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    assert_possible(score["nees"], 6)
    images = (out / "colmap" / "images.txt").read_text()
    assert "camera-1-shot-000.tif" in images


def test_pictures_without_common_texture_are_reported_in_the_words_of_the_file(pass_, tmp_path, capsys):
    rng = np.random.default_rng(8)
    for name in ("stereo.toml", "cameras.csv", "images.csv"):
        shutil.copy(pass_ / name, tmp_path / name)
    with (pass_ / "images.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    text = (tmp_path / "images.csv").read_text()
    for number, row in enumerate(rows):
        text = text.replace(row["image"], f"{number}.npy")
        np.save(tmp_path / f"{number}.npy", rng.normal(100.0, 10.0, (200, 200)).astype(np.float32))
    (tmp_path / "images.csv").write_text(text)
    assert run(["orient", str(tmp_path / "stereo.toml"), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "no point was found in two of 6 pictures" in said and "enlarge height_sigma" in said
    assert "height_range" not in said and "pointing_error" not in said


def test_check_describes_a_pass_whose_pictures_are_not_there(pass_, tmp_path, capsys):
    for name in ("stereo.toml", "cameras.csv", "images.csv"):
        shutil.copy(pass_ / name, tmp_path / name)
    assert run(["check", str(tmp_path / "stereo.toml")]) == 1
    said = capsys.readouterr()
    assert "2 cameras" in said.out and "converge at" in said.out
    assert said.err.count("no such file") == 1 and "(and 5 more images)" in said.err
    # who needs the pictures still refuses
    assert run(["orient", str(tmp_path / "stereo.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "no such file" in capsys.readouterr().err and not (tmp_path / "out").exists()
