"""The folder of a simulated flight: readable by anyone, silent about the truth."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from sightline.cli import options
from sightline.cli.main import run
from sightline.simulate.sequence import sequence_case
from sightline.simulate.sequence_files import sequence_toml, write_sequence
from sightline.simulate.sequence_options import CASE_OPTIONS

pytestmark = pytest.mark.filterwarnings(
    f"ignore::{NotGeoreferencedWarning.__module__}.NotGeoreferencedWarning"
)
OPTIONS = {
    "frames": 8,
    "shape": (64, 80),
    "spectra": "law",
    "missing": (2, 5),
    "unreadable": (6,),
    "water": ((3, 3),),
}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    scenario = sequence_case("two-lines", 1, **OPTIONS)
    write_sequence(scenario, folder, truth_bands=3, dem=True)
    return scenario, folder, tomllib.loads((folder / "sequence.toml").read_text())


def table(path):
    header, *rows = path.read_text().splitlines()
    return header, np.array([[float(v) for v in row.split(",")] for row in rows])


def test_the_sequence_file_names_files_that_are_there(flight):
    _, folder, content = flight
    for key in ("frames", "positions", "attitudes"):
        assert (folder / content[key]).is_file()
    assert content["position_bias_sigma"] == 2.0
    assert content["attitude_bias_sigma"] == pytest.approx(np.radians(1.0))
    assert content["world"] == {"frame": "local"} and content["subset"] == {"overlap": 0.8}
    assert (folder / content["surface"]["dem"]).is_file()
    assert content["camera"]["shape"] == [64, 80] and content["camera"]["readout_time"] == 0.02
    assert len(content["camera"]["wavelength_nm"]) == 64


def test_frames_that_were_not_delivered_are_named_nowhere(flight):
    scenario, folder, _ = flight
    rows = [row.split(",") for row in (folder / "frames.csv").read_text().splitlines()]
    assert rows[0] == ["frame", "t", "image"]
    assert [int(row[0]) for row in rows[1:]] == [0, 1, 3, 4, *range(6, 16)] == list(scenario.frames)
    assert {p.name for p in (folder / "frames").iterdir()} == {row[2].split("/")[1] for row in rows[1:]}
    for name in ("positions.csv", "attitudes.csv", "poses-truth.csv"):
        assert table(folder / name)[1][:, 0].tolist() == list(scenario.frames)


def test_images_read_back_as_rendered(flight):
    scenario, folder, _ = flight
    with rasterio.open(folder / "frames" / "frame-00004.tif") as source:
        assert source.dtypes == ("uint16",)
        np.testing.assert_array_equal(source.read(), scenario.image(4))


def test_an_unreadable_frame_cannot_be_read(flight):
    _, folder, _ = flight
    with pytest.raises(RasterioError), rasterio.open(folder / "frames" / "frame-00006.tif") as source:
        source.read()


def test_tables_read_back_to_the_last_digit(flight):
    scenario, folder, _ = flight
    frames = list(scenario.frames)
    header, positions = table(folder / "positions.csv")
    assert header == "frame,t,x,y,z,sigma_x,sigma_y,sigma_z"
    np.testing.assert_array_equal(positions[:, 2:5], scenario.given_positions[frames])
    assert (positions[:, 5:] == 1.0).all()
    header, _ = table(folder / "attitudes.csv")
    assert header == "frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw"
    header, truth = table(folder / "poses-truth.csv")
    assert header == "frame,t,x,y,z,qx,qy,qz,qw"
    t, position, attitude = scenario.poses
    np.testing.assert_array_equal(truth[:, 1:5], np.column_stack([t, position])[frames])
    same = np.abs((truth[:, 5:] * attitude[frames].as_quat()).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    header, lines = table(folder / "truth-lines.csv")
    assert header == "frame,line,t,x,y,z,qx,qy,qz,qw" and len(lines) == 3 * len(frames)
    np.testing.assert_array_equal(lines[::3, 3:6], truth[:, 2:5])
    np.testing.assert_allclose(lines[2::3, 2] - lines[::3, 2], 0.02)


def test_the_sequence_file_holds_no_truth(flight):
    scenario, folder, _ = flight
    text = (folder / "sequence.toml").read_text()
    assert "truth" not in text and all(repr(float(v)) not in text for v in scenario.biases[0])


def test_true_bands_are_georeferenced_and_read_back(flight):
    scenario, folder, content = flight
    with rasterio.open(folder / "truth-bands.tif") as source:
        bands, transform = source.read(), source.transform
        wavelengths = [float(source.tags(k)["wavelength_nm"]) for k in (1, 2, 3)]
    every = content["camera"]["wavelength_nm"]
    assert wavelengths[0] == every[0] and wavelengths[2] == every[-1] and wavelengths[1] in every
    x, y = transform @ (40.5, 30.5)
    true = scenario.band_signal(np.array(x), np.array(y), np.array(wavelengths))
    # wavelengths are written to a picometre
    np.testing.assert_allclose(bands[:, 30, 40], true, rtol=1e-4)


def test_png_holds_the_same_numbers(tmp_path):
    scenario = sequence_case("rgb", 1, frames=2, shape=(32, 40), spectra="law", position_sigma=0.0)
    written = write_sequence(scenario, tmp_path, image_format="png", truth_bands=0)
    with rasterio.open(tmp_path / "frames" / "frame-00001.png") as source:
        np.testing.assert_array_equal(source.read(), scenario.image(1))
    assert "truth-bands.tif" not in written and "positions.csv" not in written
    content = tomllib.loads((tmp_path / "sequence.toml").read_text())
    assert "positions" not in content and content["camera"]["channel_nm"] == [620.0, 540.0, 460.0]
    heights = scenario.ground.relief.heights
    assert content["surface"]["height_sigma"] == pytest.approx(heights.std(), abs=1e-3)


def test_flat_ground_is_said_to_be_known():
    content = tomllib.loads(sequence_toml(sequence_case("small", 0, frames=2, spectra="law", relief=0.0)))
    # 0 is read as a height that is not known
    assert 0.0 < content["surface"]["height_sigma"] < 1.0


@pytest.mark.parametrize(("kind", "key"), [("mosaic", "mosaic_nm"), ("pan", None), ("lvf", "wavelength_nm")])
def test_the_kind_of_filter_is_given_by_one_key(kind, key):
    content = tomllib.loads(sequence_toml(sequence_case("small", 0, frames=2, filter=kind, spectra="law")))
    assert {name for name in content["camera"] if name.endswith("_nm")} == ({key} if key else set())
    if kind == "mosaic":
        assert np.shape(content["camera"]["mosaic_nm"]) == (4, 4)


COMMAND = [
    "simulate",
    "frames",
    "--case",
    "small",
    "--frames",
    "3",
    "--lines",
    "122",
    "--columns",
    "136",
    "--set",
    "spectra=law",
]


def test_the_help_names_every_case():
    assert tuple(CASE_OPTIONS) == options.SEQUENCE_CASES


def test_options_reach_the_camera_in_si_units(tmp_path):
    folder = tmp_path / "scene"
    keys = ("distortion=-0.1,0.02", "principal_point_px=[15, 20]", "jitter=1e-3", "truth_bands=0")
    assert run([*COMMAND, *(word for key in keys for word in ("--set", key)), "--out", str(folder)]) == 0
    camera = tomllib.loads((folder / "sequence.toml").read_text())["camera"]
    assert camera["distortion"] == [-0.1, 0.02] and camera["principal_point_px"] == [15.0, 20.0]
    scene = json.loads((folder / "truth-scene.json").read_text())
    assert scene["options"]["jitter"] == 1e-3


def test_the_command_writes_the_folder_and_replaces_it(tmp_path, capsys):
    folder = tmp_path / "scene"
    given = ["--set", "missing=1", "--set", "attitude_sigma=8e-4"]
    assert run([*COMMAND, *given, "--out", str(folder), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert {"sequence.toml", "frames", "poses-truth.csv", "truth-bands.tif"} <= set(said["files"])
    assert table(folder / "attitudes.csv")[1][0, -1] == 8e-4
    assert run([*COMMAND, "--out", str(folder)]) == 2
    assert run([*COMMAND, "--out", str(folder), "--overwrite"]) == 0
    assert len(list((folder / "frames").iterdir())) == 3
    assert "rendered in" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--case", "kite"], "unknown case: got 'kite'; allowed are lvf"),
        (["--set", "missing=1-x"], "--set: missing: '1-x' is not allowed: frames are, as 3 or \"20-40\""),
        (["--set", "distortion=a"], "--set: distortion[1] = 'a' is not allowed: -100 to 100 are"),
        (["--set", "water=2-1"], "water: '2-1' is not allowed"),
        (["--set", "unreadable=9"], "`unreadable` names frame 9"),
        (["--set", "image_format=bmp"], "image_format = 'bmp' is not known; allowed: 'tif' or 'png'"),
        (["--set", "overlap=2"], "overlap = 2 is not allowed: 0 to 0.999 are"),
        (["--set", "filter=prism"], "filter = 'prism' is not known; allowed: 'lvf'"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(tmp_path, capsys, arguments, words):
    assert run([*COMMAND, *arguments, "--out", str(tmp_path / "scene")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "scene").exists()
