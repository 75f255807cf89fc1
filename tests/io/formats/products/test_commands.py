"""`init` of products that makers have registered, and what the commands make of it."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import rasterio

import maker_files as maker
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


def test_a_product_in_a_zip_is_refused(tmp_path):
    (tmp_path / "product.zip").write_bytes(b"PK\x03\x04" + bytes(200))
    status, said = run("init", tmp_path / "product.zip", "--out", tmp_path / "acq")
    assert status == 2
    assert "unpack it" in said
