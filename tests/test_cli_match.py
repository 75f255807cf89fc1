"""``sightline match``: its files to the letter, its raster on the map, its exit statuses."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import rasterio
from tests.matching.fourier_textures import shifted_pair

from sightline.cli.main import run
from sightline.io.results.schema import check_summary

HEADER = "line,column,d_line,d_column,sigma_line,sigma_column,correlation,score"


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    a, b = shifted_pair((200, 400), (0.3, -0.7), snr=100, seed=11)
    np.save(folder / "a.npy", a)
    np.save(folder / "b.npy", b)
    profile = {"driver": "GTiff", "height": 200, "width": 400, "count": 2, "dtype": "float32"}
    place = rasterio.Affine(2.0, 0.0, 5000.0, 0.0, -2.0, 9000.0)
    with rasterio.open(folder / "ab.tif", "w", **profile, crs="EPSG:32633", transform=place) as target:
        target.write(np.stack([a, b]))
    return folder


def test_a_pair_gives_the_files_of_the_contract(pair, tmp_path):
    out = tmp_path / "out"
    assert run(["match", str(pair / "a.npy"), str(pair / "b.npy"), "--out", str(out)]) == 0
    names = {"matches.csv", "rows.csv", "columns.csv", "shifts.tif", "summary.json", "report.html"}
    assert {path.name for path in out.iterdir()} == names
    assert (out / "matches.csv").read_text().splitlines()[0] == HEADER
    table = np.loadtxt(out / "matches.csv", delimiter=",", skiprows=1)
    assert np.abs(np.median(table[:, 2:4], axis=0) - [0.3, -0.7]).max() < 0.005
    summary = json.loads((out / "summary.json").read_text())
    check_summary((out / "summary.json").read_text())
    assert summary["windows"]["kept"] == len(table) and summary["geometry"] == "pixels"
    with rasterio.open(out / "shifts.tif") as shifts:
        assert shifts.descriptions == ("d_line", "d_column", "sigma_line", "sigma_column", "correlation")
        assert np.isnan(shifts.nodata) and shifts.crs is None
        values = shifts.read()
    # a pixel of the raster is a window
    row = ((table[:, 0] - summary["first"][0]) / 10).round().astype(int)
    column = ((table[:, 1] - summary["first"][1]) / 100).round().astype(int)
    np.testing.assert_allclose(values[:, row, column].T, table[:, 2:7], rtol=1e-5)
    assert np.isfinite(values[0]).sum() == len(table)


def test_the_raster_of_shifts_lies_where_the_first_image_does(pair, tmp_path):
    words = ["match", str(pair / "ab.tif"), str(pair / "ab.tif"), "--band", "1", "--band", "2"]
    assert run([*words, "--window", "20", "40", "--step", "10", "20", "--out", str(tmp_path / "out")]) == 0
    with rasterio.open(tmp_path / "out" / "shifts.tif") as shifts:
        assert shifts.crs.to_epsg() == 32633 and shifts.res == (40.0, 20.0)
        x, y = shifts.xy(0, 0)
    # corners of pixels count from 0, their centres from 0.5
    line, column = json.loads((tmp_path / "out" / "summary.json").read_text())["first"]
    assert (x, y) == pytest.approx((5000.0 + 2.0 * (column + 0.5), 9000.0 - 2.0 * (line + 0.5)))


def test_bands_of_one_file_are_compared_in_pairs(pair, tmp_path):
    out = tmp_path / "out"
    assert run(["match", str(pair / "ab.tif"), "--bands", "first", "--out", str(out)]) == 0
    assert (out / "matches_1_2.csv").read_text().startswith(HEADER) and (out / "shifts_1_2.tif").is_file()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["pairs"][0]["median_px"] == pytest.approx([0.3, -0.7], abs=0.005)
    check_summary((out / "summary.json").read_text())


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["a.npy"], 2, "one raster is given"),
        (["a.npy", "--bands", "all"], 2, "two are needed at least"),
        (["a.npy", "b.npy", "--bands", "all"], 2, "leave the second, or --bands, out"),
        (["ab.tif", "a.npy"], 2, "--geometry pixels"),
        (["ab.tif", "b.npy", "--band", "3"], 2, "the file has 2"),
        (["a.npy", "flat.npy"], 2, "the image is constant"),
        (["a.npy", "b.npy", "--mask", "full.npy"], 2, "no usable pixel"),
        (["a.npy", "noise.npy"], 1, "do not show the same"),
        (["a.npy", "missing.tif"], 2, "no such file"),
        (["ab.tif", "--bands", "all", "--band", "5"], 2, "--band 5 does not exist; the file has 2"),
        (["a.npy", "b.npy", "--window", "0", "0"], 2, "1 px or more each, are allowed (--window)"),
        (["a.npy", "b.npy", "--step", "-1", "4"], 2, "1 px or more each, are allowed (--step)"),
        (["a.npy", "b.npy", "--search", "-1"], 2, "0 to 400 px, the longest side of the images, are allowed"),
        (["a.npy", "b.npy", "--step", "1000000", "1000000"], 2, "take a smaller step (--step)"),
        (["a.npy", "large.npy"], 2, "most of its values are too large"),
        (["a.npy", "huge.npy"], 2, "too large for float32"),
    ],
)
def test_what_cannot_be_matched_leaves_nothing_and_says_why(pair, tmp_path, capsys, words, status, said):
    np.save(pair / "flat.npy", np.ones((200, 400), np.float32))
    np.save(pair / "full.npy", np.ones((200, 400), np.uint8))
    np.save(pair / "noise.npy", np.random.default_rng(2).normal(size=(200, 400)))
    large = np.random.default_rng(2).uniform(0.5, 1.0, (200, 400))
    np.save(pair / "large.npy", (1e38 * large).astype(np.float32))
    np.save(pair / "huge.npy", 1e200 * large)
    given = [str(pair / word) if "." in word else word for word in words]
    assert run(["match", *given, "--out", str(tmp_path / "out")]) == status
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error and not (tmp_path / "out").exists()


def test_reasons_add_up_to_the_windows_tried(tmp_path, capsys):
    # windows that the shift moves out of the second image are not tried; the rest are too small to be
    # found
    a, b = shifted_pair((160, 200), (20.0, 0.4), snr=4, seed=5)
    np.save(tmp_path / "a.npy", a)
    np.save(tmp_path / "b.npy", b)
    given = [str(tmp_path / name) for name in ("a.npy", "b.npy")]
    words = ["match", *given, "--window", "1", "1", "--step", "9", "9"]
    assert run([*words, "--out", str(tmp_path / "out")]) == 1
    said = re.search(r"(\d+) of (\d+) windows were kept \(([^)]*)\)", capsys.readouterr().err)
    assert said is not None
    reasons = [int(part.split()[0]) for part in said[3].split(", ")]
    assert int(said[1]) + sum(reasons) == int(said[2])
