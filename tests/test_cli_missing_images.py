"""`check` describes the geometry of images that are not there, and ends with 1; nothing else takes them."""

from __future__ import annotations

import json
import re
import shutil

import pytest

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.io.acquisition.load import load_acquisition


@pytest.fixture
def strip(recovery, tmp_path):
    return shutil.copytree(recovery.scene, tmp_path / "scene")


def test_one_that_is_missing_is_as_large_as_the_others(strip, capsys):
    assert run(["check", str(strip / "acquisition.toml")]) == 0
    whole = capsys.readouterr().out
    (strip / "B1.tif").unlink()
    assert run(["check", str(strip / "acquisition.toml")]) == 1
    said = capsys.readouterr()
    lost = f"[[band]] 2 image: {strip / 'B1.tif'}: no such file"
    words = f"{lost}; its geometry is described as that of 640 lines x 320 columns"
    assert words in said.err and said.err.startswith("sightline: error: ")
    assert words in said.out
    # pairs, lags and blind frequencies are those of the images that were there
    observable = [line for line in whole.splitlines() if " lag " in line]
    assert observable and all(line in said.out.splitlines() for line in observable)


def test_all_that_are_missing_are_described_by_the_keys(strip, capsys):
    for path in strip.glob("*.tif"):
        path.unlink()
    assert run(["check", str(strip / "acquisition.toml"), "--json"]) == 1
    said = capsys.readouterr()
    described = json.loads(said.out)
    assert "(and 3 more images)" in said.err
    assert [pair["lag"] for pair in described["pairs"]][:1] == [pytest.approx(0.15, rel=1e-3)]
    assert "PAN: 1000 lines x 320 columns" in " ".join(described["understood"])


@pytest.mark.parametrize(
    ("look", "also"),
    [
        # 630 of 640 lines ahead leave fewer than the 20 windows of 10 lines that are needed; 700 leave none
        (630, "as described, the images have too little ground in common"),
        (700, "shares no ground with any other image"),
    ],
)
def test_one_that_is_missing_is_said_before_what_follows_from_its_description(strip, capsys, look, also):
    toml = strip / "acquisition.toml"
    head, first, second = toml.read_text().split("[[band]]")[:3]
    assert 'image = "B1.tif"' in second
    second = re.sub(r"look_ahead = .*", f"look_ahead = {look * 5e-6}", second)
    toml.write_text("[[band]]".join([head, first, second]))
    (strip / "B1.tif").unlink()
    assert run(["check", str(toml)]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"sightline: error: {toml}: [[band]] 2 image: {strip / 'B1.tif'}: no such file")
    assert also in said and said.count(str(toml)) == 1


def test_a_recovery_does_not_begin_without_them(strip, tmp_path, capsys):
    (strip / "B1.tif").unlink()
    assert run(["recover", str(strip / "acquisition.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "B1.tif: no such file" in capsys.readouterr().err
    with pytest.raises(FormatError, match="no such file"):
        load_acquisition(strip / "acquisition.toml")
    absent = load_acquisition(strip / "acquisition.toml", describe=True)
    assert len(absent.absent) == 1
    with pytest.raises(FormatError, match=r"B1\.tif: no such file"):
        absent.images[1].read((0, 1), (0, 1))


def test_an_image_of_unknown_width_is_asked_for(strip, capsys):
    for path in strip.glob("*.tif"):
        path.unlink()
    toml = strip / "acquisition.toml"
    lines = [line for line in toml.read_text().splitlines() if not line.startswith("columns")]
    toml.write_text("\n".join(lines))
    assert run(["check", str(toml)]) == 2
    assert "no such file" in capsys.readouterr().err
