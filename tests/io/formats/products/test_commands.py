"""`init` of products that makers have registered, and what the commands make of it."""

from __future__ import annotations

import contextlib
import io
import re

import numpy as np
import pytest
import rasterio

import maker_files as maker
from sightline import load_acquisition
from sightline.cli.main import run as sightline

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def run(*words):
    """Status, and all that was printed."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = sightline([str(word) for word in words])
    return status, said.getvalue()


@pytest.fixture(scope="module")
def registered(tmp_path_factory):
    """Acquisition of a product of four registered bands with its image."""
    folder = tmp_path_factory.mktemp("product")
    maker.dimap2(folder)
    pixels = np.random.default_rng(4).integers(100, 4000, (4, 60, 50)).astype(np.uint16)
    with rasterio.open(
        folder / "IMG_R1C1.TIF", "w", driver="GTiff", height=60, width=50, count=4, dtype="uint16"
    ) as image:
        image.write(pixels)
    status, said = run("init", folder / "DIM_SPOT6.XML", "--out", folder / "acq")
    assert status == 0, said
    return folder / "acq" / "acquisition.toml", said


def test_init_says_what_it_rests_on(registered):
    path, said = registered
    text = path.read_text()
    assert 'model = "../DIM_SPOT6.XML"' in text
    assert "aberration = false" in text
    assert "height = 201.5" in text
    assert "image_band = 4" in text
    assert "model against the 5 corners" in said
    assert "residual parallax" in said
    assert "hold no motion" in said
    assert "sightline check" in said.splitlines()[-1]


def test_check_describes_it_and_ends_with_1(registered):
    status, said = run("check", registered[0])
    assert status == 1
    assert "60 lines x 50 columns" in said
    assert "bands in sensor geometry would do (levels L0, L1A, L1B)" in said


def test_recover_refuses_it_and_says_what_would_do(registered, tmp_path):
    status, said = run("recover", registered[0], "--out", tmp_path / "out")
    assert status == 1
    assert "levels L0, L1A, L1B" in said
    assert not (tmp_path / "out").exists()


def test_two_products_of_one_band_are_refused(tmp_path):
    one = maker.dimap2(tmp_path)
    status, said = run("init", one, maker.dimap2(tmp_path, name="DIM_2.XML"), "--out", tmp_path / "acq")
    assert status == 2
    assert "both hold the band B0" in said
    assert not (tmp_path / "acq").exists()


def test_a_model_that_its_own_corners_contradict_is_said_and_one_beside_the_earth_refused(tmp_path):
    far = maker.dimap2(tmp_path, changes=[("<XLOS_0>-0.0", "<XLOS_0>-0.1")])
    status, said = run("init", far, "--out", tmp_path / "acq")
    assert status == 0
    assert re.search(r"its model is .* px \(.* m\) off its own corners: units, a sign", said)
    turned = maker.dimap2(tmp_path, name="DIM_2.XML", changes=[("<XLOS_0>-0.0", "<XLOS_0>-90.")])
    status, said = run("init", turned, "--out", tmp_path / "acq2")
    assert status == 2
    assert "does not look at the Earth" in said
    assert not (tmp_path / "acq2").exists()


def test_a_product_in_a_zip_is_refused(tmp_path):
    (tmp_path / "product.zip").write_bytes(b"PK\x03\x04" + bytes(200))
    status, said = run("init", tmp_path / "product.zip", "--out", tmp_path / "acq")
    assert status == 2
    assert "unpack it" in said


def tiled(folder):
    """A product of two tiles, of 32 columns and of the rest; its pixels."""
    tile = '<Data_File tile_R="1" tile_C="{0}"><DATA_FILE_PATH href="IMG_R1C{0}.TIF"/></Data_File>'
    size = '<Tile_Set><Regular_Tiling><NTILES_SIZE nrows="64" ncols="32"/></Regular_Tiling></Tile_Set>'
    changes = [
        ('<Data_File><DATA_FILE_PATH href="IMG_R1C1.TIF"/></Data_File>', tile.format(1) + tile.format(2)),
        ("<NBANDS>", f"{size}<NBANDS>"),
    ]
    path = maker.dimap2(folder, changes=changes)
    pixels = np.random.default_rng(5).integers(100, 4000, (4, 60, 50)).astype(np.uint16)
    for number, part in enumerate((pixels[..., :32], pixels[..., 32:]), 1):
        size = {"height": 60, "width": part.shape[2], "count": 4}
        with rasterio.open(
            folder / f"IMG_R1C{number}.TIF", "w", driver="GTiff", dtype="uint16", **size
        ) as tile:
            tile.write(part)
    return path, pixels


def test_tiles_of_an_image_are_laid_side_by_side(tmp_path):
    path, pixels = tiled(tmp_path)
    status, said = run("init", path, "--out", tmp_path / "acq")
    assert status == 0, said
    with rasterio.open(tmp_path / "acq" / "DIM_SPOT6.vrt") as image:
        np.testing.assert_array_equal(image.read(), pixels)
    acquired = load_acquisition(tmp_path / "acq" / "acquisition.toml")
    np.testing.assert_array_equal(acquired.bands[2].image.read((0, 60), (0, 50)), pixels[2])


def test_a_tile_that_is_not_there_is_named_and_check_describes_the_rest(tmp_path):
    path, _ = tiled(tmp_path)
    (tmp_path / "IMG_R1C2.TIF").unlink()
    status, said = run("init", path, "--out", tmp_path / "acq")
    assert status == 0
    assert "IMG_R1C2.TIF: no such file beside DIM_SPOT6.XML; put it there, and run `sightline init`" in said
    status, said = run("check", tmp_path / "acq" / "acquisition.toml")
    assert status == 1
    assert "60 lines x 50 columns" in said


def test_bare_numbers_of_an_image_are_read(tmp_path):
    encoding = (
        "<Raster_Encoding><NBITS>16</NBITS><BYTEORDER>M</BYTEORDER><SKIPBYTES>7</SKIPBYTES></Raster_Encoding>"
    )
    changes = [
        ("<Data_Access>", encoding + "<Data_Access><DATA_FILE_FORMAT>RAW</DATA_FILE_FORMAT>"),
        ("IMAGERY.TIF", "IMAGERY.BIL"),
    ]
    path = maker.dimap1(tmp_path, changes=changes)
    pixels = np.random.default_rng(6).integers(0, 60000, (80, 60)).astype(">u2")
    (tmp_path / "imagery.bil").write_bytes(bytes(7) + pixels.tobytes())
    status, said = run("init", path, "--out", tmp_path / "acq")
    assert status == 0, said
    with rasterio.open(tmp_path / "acq" / "METADATA.vrt") as image:
        np.testing.assert_array_equal(image.read(1), pixels)
    assert run("check", tmp_path / "acq" / "acquisition.toml")[0] == 1  # one band


def test_bands_of_spot_5_with_looks_of_their_own_tell_motion(tmp_path):
    path = maker.dimap1(tmp_path, rows=400, columns=300, ahead=(0.0, 2e-4))
    pixels = np.random.default_rng(7).integers(10, 250, (2, 400, 300)).astype(np.uint8)
    size = {"height": 400, "width": 300, "count": 2}
    with rasterio.open(tmp_path / "IMAGERY.TIF", "w", driver="GTiff", dtype="uint8", **size) as image:
        image.write(pixels)
    status, said = run("init", path, "--out", tmp_path / "acq")
    assert status == 0, said
    assert "sightline recover" in said.splitlines()[-1]
    status, said = run("check", tmp_path / "acq" / "acquisition.toml")
    assert status == 0, said
    # .2 mrad from 697 km, over ground that passes by at 6.7 km/s: 21 ms, about three lines
    lag = float(re.search(r"band 1 - band 2: lag (-?[\d.]+) ms", said)[1])
    assert abs(lag) == pytest.approx(21.0, abs=1.0)
