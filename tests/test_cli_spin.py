"""Frames of a spinning camera through the commands: check, recover, and the registered picture."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.motion.spinning import SpinningCamera, Texture

from sightline.cli.main import run
from sightline.cli.register import register_into
from sightline.errors import FormatError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.names import toml_string
from sightline.io.results.registered_frames import read_recovered_spin

FOCAL, LINES, COLUMNS, EXPOSURES, INTERVAL, TURN = 500.0, 64, 160, 4, 0.4, -0.08
AXIS_LINES = {"blue": 80.0, "green": 8.0, "red": -64.0}

HEAD = f"""
[acquisition]
name = "turning"

[platform]
kind = "spin"
attitude = [0.0, 0.0, 0.0, 1.0]
attitude_sigma = 0.0
axis = [1.0, 0.0, 0.0]
axis_sigma = 0.005
rate = {TURN / INTERVAL}
rate_sigma = 1e-3

[surface]
kind = "infinity"
parallax_sigma = 1e-5

[camera]
body_from_camera = [0.0, 0.0, 0.0, 1.0]
focal_length_px = {FOCAL}
focal_length_sigma_px = 0.5
principal_point_px = [0.0, 79.5]
common_line_sigma_px = 5.0

[matching]
window = [24, 40]
passes = 1
"""


def write_acquisition(folder, strips=tuple(AXIS_LINES), image="{}.npy"):
    """A rendered acquisition on disk, whose strips and images have the names given."""
    truth = SpinningCamera(
        FOCAL,
        79.5,
        tuple(AXIS_LINES.values()),
        np.array([1.0, 1e-3, 0.0]),
        TURN + 3e-4,
        np.zeros((EXPOSURES, 3)),
        np.eye(3),
    )
    sky, rng = Texture(11, FOCAL, 100), np.random.default_rng(12)
    line, column = np.meshgrid(np.arange(LINES), np.arange(COLUMNS), indexing="ij")
    text = HEAD
    for k, (name, axis_line) in enumerate(zip(strips, AXIS_LINES.values(), strict=True)):
        text += f"\n[[camera.strip]]\nname = {toml_string(name)}\nfirst_line = {k * LINES}\nlines = {LINES}\n"
        text += f"axis_line = {axis_line}\naxis_line_sigma_px = 0.05\n"
    for exposure in range(EXPOSURES):
        pixels = np.concatenate([sky(truth.directions(exposure, strip, line, column)) for strip in range(3)])
        pixels += 0.02 * rng.normal(size=(3 * LINES, COLUMNS))
        # brightness of all directions is positive
        np.save(folder / image.format(exposure), (100.0 + 20.0 * pixels).astype(np.float32))
        text += f"\n[[frame]]\nimage = {toml_string(image.format(exposure))}\ntime = {INTERVAL * exposure}\n"
    toml = folder / "acquisition.toml"
    toml.write_text(text, encoding="utf-8")
    return toml


@pytest.fixture(scope="module")
def recovered(tmp_path_factory):
    """A rendered acquisition on disk and what `recover` wrote for it."""
    folder = tmp_path_factory.mktemp("spin")
    toml, out = write_acquisition(folder), folder / "result"
    assert run(["recover", str(toml), "--out", str(out)]) == 0
    return toml, out


def test_check_understands_it(recovered, capsys):
    assert run(["check", str(recovered[0])]) == 0
    said = capsys.readouterr().out
    assert "4 exposures of 3 strips on a spinning platform" in said
    assert "red - green, 1 exposure later (0.4 s)" in said


def test_recover_writes_motion_and_spin(recovered):
    _, out = recovered
    rows = (out / "motion.csv").read_text().splitlines()
    assert rows[0].startswith("t,roll,pitch,yaw,sigma_roll") and len(rows) == 1 + EXPOSURES
    summary = json.loads((out / "summary.json").read_text())
    spin = summary["spin"]
    sigma = np.sqrt(sum(part**2 for part in spin["rate_sigma"].values()))
    assert abs(spin["rate"] - (TURN + 3e-4) / INTERVAL) < 4.0 * sigma
    assert spin["rank"] <= spin["unknown_constants"] and spin["weakest_direction"]
    assert {(s["hub"], s["partner"], s["lag"]) for s in spin["strips"]} >= {("red", "green", 1)}
    assert len(spin["exposures"]) == EXPOSURES
    page = (out / "report.html").read_text()
    assert "Spin" in page and "weakest direction" in page


def test_the_registered_picture_shows_one_sky_in_all_strips(recovered, tmp_path):
    import rasterio

    toml, out = recovered
    made = register_into(tmp_path, toml, out, lambda stage: None)
    with rasterio.open(tmp_path / "picture.tif") as raster:
        pixels = raster.read()
        assert raster.descriptions == tuple(AXIS_LINES)
    assert pixels.shape == (3, made["lines"], made["columns"])
    both = np.isfinite(pixels).all(axis=0)
    # contrast 20, noise 0.4; a tenth of a pixel of waves of 5 px would leave 2
    for strip in (0, 2):
        assert np.std((pixels[strip] - pixels[1])[both]) < 1.0
    with rasterio.open(tmp_path / "picture.png") as raster:
        colours = raster.read()
    assert colours.shape == pixels.shape and np.ptp(colours[:, both]) > 50
    assert json.loads((tmp_path / "summary.json").read_text())["strips"] == list(AXIS_LINES)


def test_the_results_are_opened_and_written_again(recovered, tmp_path):
    import sightline

    made = tmp_path / "picture"
    assert run(["register", str(recovered[0]), "--motion", str(recovered[1]), "--out", str(made)]) == 0
    for number, (folder, kind) in enumerate(((recovered[1], "SpinAttitude"), (made, "Mosaic"))):
        opened = sightline.open_result(folder)
        assert type(opened).__name__ == kind and len(repr(opened)) < 400
        again = opened.write(tmp_path / str(number))
        files = sorted(path.name for path in folder.iterdir())
        assert sorted(path.name for path in again.iterdir()) == files
        assert all((again / name).read_bytes() == (folder / name).read_bytes() for name in files)
    with pytest.raises(AttributeError, match="`estimate` of this SpinAttitude is not there"):
        sightline.open_result(recovered[1]).estimate  # noqa: B018


def test_a_result_of_something_else_is_refused(recovered, tmp_path):
    acquisition = load_acquisition(recovered[0])
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(FormatError, match="no result of a spinning camera; recover the acquisition first"):
        read_recovered_spin(tmp_path, acquisition)
    summary = json.loads((recovered[1] / "summary.json").read_text())
    for change, said in (
        ({"images": ["other"]}, "its images are not those"),
        ({"statics": []}, "does not belong to this acquisition"),
        ({"spin": {**summary["spin"], "exposures": []}}, "0 exposures for the 4"),
    ):
        (tmp_path / "summary.json").write_text(json.dumps(summary | change))
        with pytest.raises(FormatError, match=said):
            read_recovered_spin(tmp_path, acquisition)


def test_windows_that_do_not_match_are_an_answer_with_status_one(recovered, tmp_path, capsys):
    toml, _ = recovered
    rng = np.random.default_rng(0)
    for k in range(EXPOSURES):
        np.save(tmp_path / f"{k}.npy", rng.normal(100.0, 10.0, (3 * LINES, COLUMNS)).astype(np.float32))
    other = tmp_path / "acquisition.toml"
    other.write_text(toml.read_text(encoding="utf-8"), encoding="utf-8")
    assert run(["recover", str(other), "--out", str(tmp_path / "out")]) == 1
    assert "the strips do not match" in capsys.readouterr().err
    assert not (tmp_path / "out" / "motion.csv").exists()
