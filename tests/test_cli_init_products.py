"""`sightline init PRODUCT`, and what follows from the file that it writes without a key edited by hand."""

from __future__ import annotations

import json
import re
import shutil
import tomllib

import numpy as np
import pytest
import rasterio
from tests import csm_reference as reference
from tests.product_files import WorldViewScene

from sightline.cli.main import run
from sightline.io.acquisition.load import load_acquisition


def noise(path, shape, seed):
    np.save(path, np.random.default_rng(seed).integers(100, 900, shape).astype(np.uint16))


def written(out):
    return tomllib.loads((out / "acquisition.toml").read_text())


pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture
def strip(tmp_path):
    """Two products of one strip in folders of their own; the second has two bands, 20 ms after the first."""
    for name in ("pan", "multi"):
        (tmp_path / name).mkdir()
    pan = WorldViewScene(image="D:\\order\\PAN.npy")
    # the array looks 20 px back: it sees the ground 20 lines later
    multi = WorldViewScene(origin=(-1.2, 8.0), image="XS.TIF", band="Multi", bands=("B", "R"))
    pan.xml(tmp_path / "pan", "A_P001.XML")
    multi.text(tmp_path / "multi", "A_M001")
    noise(tmp_path / "pan" / "pan.npy", (320, 200), 1)
    bands = np.random.default_rng(2).integers(100, 900, (2, 320, 200)).astype(np.uint16)
    path, size = tmp_path / "multi" / "xs.tif", {"count": 2, "height": 320, "width": 200}
    with rasterio.open(path, "w", driver="GTiff", dtype="uint16", **size) as target:
        target.write(bands)
    return tmp_path


def test_bands_of_two_products_are_one_acquisition(strip, capsys):
    out = strip / "acq"
    assert run(["init", str(strip / "pan"), str(strip / "multi" / "A_M001.IMD"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "next: sightline recover" in said and "aberration" in said
    file = written(out)
    assert [band["name"] for band in file["band"]] == ["P", "B", "R"]
    assert [band["model"] for band in file["band"]] == ["../pan/A_P001.XML", *["../multi/A_M001.IMD"] * 2]
    assert [band["image"] for band in file["band"]] == ["../pan/pan.npy", *["../multi/xs.tif"] * 2]
    assert file["platform"]["aberration"] and file["platform"]["attitude_sigma"] == 2e-5
    assert run(["check", str(out / "acquisition.toml")]) == 0
    said = capsys.readouterr().out
    # 20 px of 6.7 m at 6.9 km/s
    assert "aberration is applied: 2" in said and re.search(r"P - B: lag (19|20)\.?\d* ms", said)
    assert load_acquisition(out / "acquisition.toml").epoch == "2013-05-08T00:03:30.500000000Z"


def test_bands_of_one_product_cannot_tell_motion(strip, capsys):
    out = strip / "acq"
    assert run(["init", str(strip / "multi"), "--out", str(out)]) == 0
    assert "all bands of A_M001.IMD have one table of line times" in capsys.readouterr().out
    toml = str(out / "acquisition.toml")
    assert run(["check", toml]) == 1
    shown = capsys.readouterr()
    assert "understood:" in shown.out and "`recover` would refuse it: all bands of A_M001.IMD" in shown.err
    assert run(["recover", toml, "--out", str(strip / "result")]) == 1
    shown = capsys.readouterr()
    assert "give with it the panchromatic" in shown.err and not (strip / "result").exists()


def test_bands_of_one_product_are_registered_by_their_cameras(strip, capsys):
    path = strip / "multi" / "xs.tif"
    with rasterio.open(path, "r+") as file:
        file.write(file.read(1), 2)
    out = strip / "acq"
    assert run(["init", str(strip / "multi"), "--out", str(out)]) == 0
    toml = str(out / "acquisition.toml")
    assert run(["register", toml, "--out", str(strip / "laid"), "--json"]) == 0
    summary = json.loads((strip / "laid" / "summary.json").read_text())
    assert [band["placed_by"] for band in summary["bands"]] == ["cameras", "cameras"]
    assert max(summary["pairs"][0]["after"]["rms_px"]) < 0.02  # the same image twice
    assert "by their cameras as given" in (strip / "laid" / "report.html").read_text()
    capsys.readouterr()


def test_images_that_are_not_there_are_named(strip, capsys):
    (strip / "pan" / "pan.npy").unlink()
    out = strip / "acq"
    assert run(["init", str(strip / "pan"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "PAN.npy: no such file beside A_P001.XML" in said and "next: sightline check" in said
    assert run(["check", str(out / "acquisition.toml")]) == 1
    assert "320 lines x 200 columns" in capsys.readouterr().out


def test_images_of_padded_files_are_taken(tmp_path, capsys):
    scene = WorldViewScene(
        rows=1024, columns=1024, image="scene.npy", before=0.5,
        more={"TIL/TILESIZEY": 1000, "TIL/TILESIZEX": 990},
    )  # fmt: skip
    scene.xml(tmp_path)
    noise(tmp_path / "scene.npy", (1024, 1024), 3)
    assert run(["init", str(tmp_path), "--out", str(tmp_path / "acq")]) == 0
    assert "1000 x 990 px, in a file padded to 1024 x 1024 px" in capsys.readouterr().out
    camera = load_acquisition(tmp_path / "acq" / "acquisition.toml").bands[0].camera
    assert camera.shape == (1024, 1024)
    np.testing.assert_allclose(camera.times([1023.0]), [1.023], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"start": "2013-05-08T00:05:30.500000"},
            "were exposed 120 s after one another: they are two",
        ),
        ({"start": "2013-05-08T00:03:31.000000"}, "both hold the band P: parts of one strip, or two looks"),
    ],
)
def test_products_that_are_no_bands_of_one_strip_are_refused(strip, change, said, capsys):
    (strip / "other").mkdir()
    WorldViewScene(**change).xml(strip / "other", "B_P001.XML")
    words = ["init", str(strip / "pan"), str(strip / "other"), "--out", str(strip / "acq")]
    assert run(words) == 2
    shown = capsys.readouterr().err
    assert said in shown and len(shown.splitlines()) == 1 and not (strip / "acq").exists()


def test_a_product_is_given_once(strip, capsys):
    words = ["init", str(strip / "pan"), str(strip / "pan" / "A_P001.XML"), "--out", str(strip / "acq")]
    assert run(words) == 2
    assert "are one product; give it once" in capsys.readouterr().err


def test_corrections_that_the_model_does_not_need_are_doubted(strip, capsys):
    out = strip / "acq"
    assert run(["init", str(strip / "pan"), "--out", str(out)]) == 0
    toml = out / "acquisition.toml"
    toml.write_text(toml.read_text().replace("aberration = true", "aberration = false"))
    assert run(["check", str(toml)]) == 1
    assert "aberration = false, which its model needs" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["dg_example1.xml", "wv_test1.xml"])
def test_real_products_are_described_without_a_key_edited(name, real_data, tmp_path, capsys):
    shutil.copy(real_data("vendor_models") / name, tmp_path)
    assert run(["init", str(tmp_path / name), "--out", str(tmp_path / "acq")]) == 0
    said = capsys.readouterr().out
    assert "model against the maker's RPC: 0." in said
    # there are no pixels, and one band
    assert run(["check", str(tmp_path / "acq" / "acquisition.toml")]) == 1
    shown = capsys.readouterr()
    assert "aberration is applied: 2" in shown.out and "refraction is applied" in shown.out
    assert len(shown.err.splitlines()) == 1


def test_cameras_of_a_product_are_exported_without_a_result(strip, capsys):
    """With what light does: rays of the state, evaluated after the documentation of usgscsm."""
    out = strip / "acq"
    assert run(["init", str(strip / "pan"), "--out", str(out)]) == 0
    toml = str(out / "acquisition.toml")
    camera = load_acquisition(toml).bands[0].camera
    assert run(["export", toml, "--to", "csm", "--out", str(strip / "csm")]) == 0
    state = reference.load(strip / "csm" / "P.json")
    for line, column in ((0.0, 0.0), (150.0, 100.0), (319.0, 199.0)):
        origin, look = reference.state_ray(state, line + 0.5, column + 0.5)
        rays = camera.rays([[line, column]])
        # .001 px of 10 urad
        np.testing.assert_allclose(look, rays.directions[0], atol=1e-8)
        np.testing.assert_allclose(origin, rays.origins[0], atol=1e-3)
    assert run(["export", toml, "--to", "rpc", "--out", str(strip / "rpc")]) == 0
    assert json.loads((strip / "rpc" / "export.json").read_text())["bands"][0]["rms_px"][0] < 0.01
    capsys.readouterr()
    assert run(["export", toml, "--to", "shifts", "--out", str(strip / "none")]) == 2
    assert "give the folder that `recover` wrote" in capsys.readouterr().err


def test_a_raw_image_of_junocam_is_an_acquisition(real_data, tmp_path, capsys):
    folder = real_data("junocam_spin_scan")
    image = next(folder.glob("*36C00061*.png"))
    assert run(["init", str(image), "--out", str(tmp_path / "acq")]) == 0
    said = capsys.readouterr().out
    assert "give its metadata and those of another image of the same orbit" in said
    file = written(tmp_path / "acq")
    assert file["surface"]["kind"] == "infinity" and len(file["frame"]) == 12
    assert (tmp_path / "acq" / file["frame"][0]["mask"]).is_file()
    metadata = sorted(map(str, folder.glob("*.json")))
    assert run(["init", str(image), *metadata, "--out", str(tmp_path / "acq2")]) == 2
    assert "that of the image and of one other of the same orbit are needed" in capsys.readouterr().err
    assert run(["init", *metadata, "--out", str(tmp_path / "acq2")]) == 2
    assert "0 raw images of JunoCam are given" in capsys.readouterr().err
