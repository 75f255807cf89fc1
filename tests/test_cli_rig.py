"""Rigs through the commands: a simulated one end to end, real captures by their tags."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio

from sightline.cli.main import app, run
from sightline.io.formats.tables import read_columns

SMALL = (
    "--set", "cameras=3", "--set", "shape=[160, 200]", "--set", "focal_length_px=220", "--set", "bits=8",
    "--set", "truth_bands=0", "--set", "rig_missing=[[2, 1]]", "--set", "rig_overexposed=[[3, 2]]",
)  # fmt: skip
OFFSETS = ("roll", "pitch", "yaw", "x", "y", "z")


@pytest.fixture(scope="module")
def located(tmp_path_factory):
    """A flight of three cameras: its folder, its result, what was printed."""
    from typer.testing import CliRunner

    folder = tmp_path_factory.mktemp("rig")
    invoke = CliRunner().invoke
    flight, result = folder / "flight", folder / "located"
    made = invoke(
        app,
        ["simulate", "frames", "--case", "rig", "--frames", "6", "--seed", "4", *SMALL, "--out", str(flight)],
    )
    assert made.exit_code == 0, made.output
    found = invoke(app, ["georeference", str(flight / "sequence.toml"), "--out", str(result)])
    assert found.exit_code == 0, found.output
    return flight, result, found.output


def test_offsets_of_a_rig_lie_within_their_sigmas(located):
    flight, result, _ = located
    truth = read_columns(flight / "rig-truth.csv", ("camera", *OFFSETS), text=("camera",))
    found = read_columns(
        result / "rig.csv", ("camera", *OFFSETS, *(f"sigma_{name}" for name in OFFSETS)), text=("camera",)
    )
    assert found["camera"] == truth["camera"]
    size = np.array([
        (np.asarray(found[name]) - np.asarray(truth[name]))[1:] / np.asarray(found[f"sigma_{name}"])[1:]
        for name in OFFSETS
    ])  # fmt: skip
    # twelve numbers, correlated: the largest of twelve normal ones is 3.5 in one of 180 flights
    assert np.abs(size).max() < 3.5
    # a degree beforehand; two windows of 0.1 px in a focal length of 220 px are 1e-3
    assert np.asarray(found["sigma_roll"])[1:].max() < 1e-3


def test_captures_without_one_band_are_used_for_the_others(located):
    flight, result, _ = located
    summary = json.loads((result / "summary.json").read_text())
    images = {camera["camera"]: camera["images"] for camera in summary["rig"]}
    assert images == {"band 1": 6, "band 2": 5, "band 3": 5}
    assert summary["frames"] == 6 and sum(summary["sources"].values()) == 6
    assert not (flight / "frames" / "capture-00002-2.tif").exists()


def test_an_image_that_cannot_be_used_is_warned_of(located):
    _, result, printed = located
    # 6 captures of 3 cameras; one image is not listed, one of those listed is saturated
    said = "1 of 17 images of the rig cannot be used; the first, "
    (warning,) = [w for w in json.loads((result / "summary.json").read_text())["warnings"] if said in w]
    assert "capture-00003-3.tif (camera band 3): " in warning and "is constant" in warning
    assert f"warning: {warning}" in printed


def edited(flight, folder, change):
    """A copy of a flight, its TOML changed."""
    copied = Path(shutil.copytree(flight, folder / "flight"))
    toml = copied / "sequence.toml"
    toml.write_text(change(toml.read_text()))
    return toml


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_check_names_the_first_image_of_a_rig_that_cannot_be_used_and_why(located, tmp_path, capsys):
    toml = edited(located[0], tmp_path, lambda text: text)
    frames = toml.parent / "frames"
    (frames / "capture-00004-2.tif").write_text("no raster")
    (frames / "capture-00002-1.tif").unlink()
    profile = {"driver": "GTiff", "height": 100, "width": 120, "count": 1, "dtype": "uint8"}
    for name, reason in (("2-1", "no such file"), ("1-3", "(100, 120) px in place of (160, 200)")):
        if name == "1-3":
            with rasterio.open(frames / "capture-00001-3.tif", "w", **profile) as target:
                target.write(np.random.default_rng(1).integers(1, 200, (1, 100, 120), dtype=np.uint8))
        assert run(["check", str(toml)]) == 0
        shown = " ".join("".join(capsys.readouterr()).split())
        count = 3 if name == "2-1" else 4
        assert f"{count} of 17 images of the rig cannot be used" in shown
        assert f"capture-0000{name}.tif" in shown and reason in shown


SHAPE = "shape = [160, 200]"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda text: SHAPE.join(text.split(SHAPE)[:2]) + "shape = [80, 100]" + text.split(SHAPE)[2]
            + SHAPE + text.split(SHAPE)[3],
            ("camera[2].shape = [80, 100]", "'band 2'", "capture-00000-2.tif, is 160 x 200"),
        ),
        (
            lambda text: text.replace(
                "[subset]", '[[camera]]\nname = "band 6"\nfocal_length_px = 220.0\n\n[subset]'
            ),
            ("camera 'band 6' is in no row of frames.csv",),
        ),
        (
            lambda text: text.replace('frames = "frames.csv"', 'frames = "other.csv"'),
            ("no image of camera 'band 3' can be used", "gone-3.tif: no such file"),
        ),
        (
            lambda text: "distortion = [1e9, 1e9]".join(text.rsplit("distortion = []", 1)),
            ("camera[3].distortion = [1000000000.0, 1000000000.0] stretches the frame", "k1, k2"),
        ),
        (
            lambda text: text.replace("distortion = []", "distortion = [-5.0]", 1),
            ("camera[1].distortion = [-5.0] folds the field of view within the frame",),
        ),
    ],
)  # fmt: skip
def test_a_camera_of_a_rig_that_its_images_contradict_is_refused_at_once(
    located, tmp_path, capsys, change, said
):
    toml = edited(located[0], tmp_path, change)
    rows = (toml.parent / "frames.csv").read_text()
    (toml.parent / "other.csv").write_text(re.sub(r"frames/capture-\d+-3", "gone-3", rows))
    assert run(["georeference", str(toml), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert all(words in error for words in said), error
    assert "progress" not in error and not (tmp_path / "out").exists()


def test_a_wrong_offset_that_is_given_as_exact_is_named(located, tmp_path, capsys):
    # the cameras are turned by up to 1.5 degrees, none is what the file gives
    toml = edited(
        located[0],
        tmp_path,
        lambda text: re.sub(
            r"(band 3.*?orientation_offset_sigma = )[\d.]+", r"\g<1>0.0", text, flags=re.DOTALL
        ),
    )
    assert run(["georeference", str(toml), "--poses-only", "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert "orientation_offset_sigma = 0" in error and "[[camera]] band 3" in error


def test_bands_of_all_cameras_lie_on_one_map(located):
    _, result, printed = located
    summary = json.loads((result / "summary.json").read_text())
    assert [band["wavelength_nm"] for band in summary["cube"]["bands"]] == [475.0, 657.5, 840.0]
    shapes = {rasterio.open(path).shape for path in (result / "bands").iterdir()}
    assert len(shapes) == 1
    # cameras a degree apart would lie 4 px off; 0.1 px is what bands of a rig have to fit to
    rms = [pair["rms_px"] for pair in summary["cube"]["pairs"] if pair["rms_px"] is not None]
    assert rms and min(rms) < 0.1
    assert "camera band 2: turned by" in printed


def test_a_real_capture_is_understood_by_its_tags(real_data, tmp_path):
    from sightline.io.sequence.load import load_sequence

    toml = tmp_path / "one.toml"
    toml.write_text(
        f'frames = "{real_data("rededge_capture")}"\n[surface]\nheight = 105.0\nheight_sigma = 10.0\n'
    )
    problem = load_sequence(toml)
    assert len(problem) == 1
    assert [camera.name for camera in problem.rig] == ["Blue", "Green", "Red", "NIR", "Red edge"]
    assert [camera.wavelength_nm for camera in problem.rig] == [475.0, 560.0, 668.0, 840.0, 717.0]
    assert 1440.0 < problem.rig[4].detector.focal_length_px < 1442.0


def test_cameras_that_fire_one_after_the_other_are_refused_by_name(real_data, tmp_path):
    from sightline.errors import FormatError
    from sightline.io.sequence.load import load_sequence

    toml = tmp_path / "two.toml"
    cameras = "".join(
        f'[[camera]]\nname = "{name}"\nimages = "{name}/IMG_*.jpg"\n' for name in ("nRGB", "NDRE")
    )
    toml.write_text(f'frames = "{real_data("sentera_d4k_rig")}"\n{cameras}[surface]\nheight = 20.0\n')
    with pytest.raises(FormatError, match="nRGB and NDRE do not expose together"):
        load_sequence(toml)


def test_colmap_reads_the_rig_and_its_captures(located):
    pycolmap = pytest.importorskip("pycolmap")
    _, result, _ = located
    model = pycolmap.Reconstruction(str(result / "colmap"))
    rigs = list(model.rigs.values())
    assert len(rigs) == 1 and len(model.frames) == 6
    # one image is missing, one saturated
    assert len(model.images) == 16
    found = read_columns(result / "rig.csv", OFFSETS)
    turns = np.column_stack([np.asarray(found[name]) for name in OFFSETS[:3]])
    poses = {k.id: np.asarray(p.rotation.quat) for k, p in rigs[0].non_ref_sensors.items()}
    for camera in (2, 3):
        # a rotation by the angle of rig.csv, whatever the axes
        angle = 2.0 * np.arccos(min(abs(poses[camera][3]), 1.0))
        assert abs(angle - np.linalg.norm(turns[camera - 1])) < 1e-6
    errors = [point.error for point in model.points3D.values()]
    assert np.median(errors) < 0.2  # px, as the residuals are


def test_offsets_of_a_model_are_where_those_of_the_cameras_begin(located, tmp_path):
    from sightline.io.sequence.load import load_sequence

    flight, result, _ = located
    text = (flight / "sequence.toml").read_text().replace('"frames.csv"', f'"{flight / "frames.csv"}"')
    kept = [
        line
        for line in text.splitlines()
        if not line.startswith(("positions", "attitudes", "position_bias", "attitude_bias", "orientation_"))
    ]
    table = (flight / "frames.csv").read_text().replace(",frames/", f",{flight / 'frames'}/")
    (tmp_path / "frames.csv").write_text(table)
    toml = "\n".join(kept).replace(str(flight / "frames.csv"), str(tmp_path / "frames.csv"))
    found = read_columns(result / "rig.csv", OFFSETS)
    turns = np.column_stack([np.asarray(found[name]) for name in OFFSETS[:3]])
    for model in (result / "colmap", result / "reconstruction.json"):
        (tmp_path / "again.toml").write_text(f'poses = "{model}"\n{toml}')
        problem = load_sequence(tmp_path / "again.toml")
        for camera in (1, 2):
            given = problem.rig[camera].orientation.as_rotvec()
            np.testing.assert_allclose(given, turns[camera], atol=1e-7)
            assert problem.rig[camera].prior == "given by the model"
