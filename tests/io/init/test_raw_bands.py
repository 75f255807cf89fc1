"""Raw bands of Pleiades: lags by a product's metadata, or by the preset."""

from __future__ import annotations

import contextlib
import io
import tomllib

import numpy as np
import pytest

import maker_files as maker
from sightline.cli.main import run
from sightline.geometry.surface import Ellipsoid
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.products.recognise import read_product


def said_by(*words):
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = run([str(word) for word in words])
    return status, said.getvalue()


@pytest.fixture
def images(tmp_path):
    """A panchromatic band and two colours of a quarter of its pixels and lines."""
    rng = np.random.default_rng(8)
    for name, shape in {"PA": (640, 480), "B0": (160, 120), "B2": (160, 120)}.items():
        np.save(tmp_path / f"raw_{name}.npy", rng.integers(100, 3000, shape).astype(np.uint16))
    return tmp_path


def test_lags_of_a_real_product_are_the_published_ones(real_data):
    product = read_product(real_data("vendor_models") / "PHRDIMAP_P1BP--2017030824934340CP.XML")
    lags = {name: 1e3 * lag for name, lag in product.raw.lags.items()}
    assert list(lags) == ["PA", "B1", "B0", "B3", "B2"]
    np.testing.assert_allclose(list(lags.values()), [0.0, 152.5, 159.1, 165.7, 172.3], atol=0.05)


@pytest.mark.parametrize("by", ["product", "preset"])
def test_raw_bands_are_an_acquisition(images, by):
    given = ["--preset", "pleiades"]
    if by == "product":
        given = [maker.pleiades(images)]
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    status, said = said_by("init", *given, *bands, "--out", images / "acq")
    assert status == 0, said
    file = tomllib.loads((images / "acq" / "acquisition.toml").read_text())
    colour, last = file["band"][1:]
    assert last["first_line_time"] == pytest.approx(0.1723, abs=1e-6)
    # looks back by the way of the lag: .1591 s 6770 m/s / 694 km; the written product's own orbit is near it
    assert colour["look_ahead"] == pytest.approx(-0.1591 * 6770 / 694e3, rel=1e-3 if by == "preset" else 0.5)
    assert colour["ifov"] == pytest.approx(4 * file["instrument"]["ifov"], rel=1e-6)
    assert colour["line_period"] == pytest.approx(4 * file["instrument"]["line_period"])
    assert "sign of the lags" not in said
    assert ("PHRDIMAP_P1.XML (Band_TS_List)" in said) == (by == "product")
    acquired = load_acquisition(images / "acq" / "acquisition.toml")
    assert [band.image.shape for band in acquired.bands] == [(640, 480), (160, 120), (160, 120)]


def test_raw_bands_fly_along_the_orbit_of_the_product(images):
    path = maker.pleiades(images)
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 0, said
    acquired = load_acquisition(images / "acq" / "acquisition.toml")
    panchromatic, *colours = acquired.cameras
    product = read_product(path)
    model, ground = product.model.camera, Ellipsoid(height=product.height or 0.0)
    # the middle of line 0 is where the product's lies; to the millionth of a pixel of .7 m
    middle = panchromatic.locate(np.array([[0.0, 239.5]]), acquired.surface)
    expected = model.locate(np.array([[0.0, 0.5 * (model.columns - 1)]]), ground)
    # the chord of the line's ends against its middle: looks are a polynomial of the second degree at most
    assert np.linalg.norm(middle - expected) < 1.0
    for camera in colours:
        # columns 239.5 of the fine pixels are 59.5 of those four times as wide
        np.testing.assert_allclose(camera.project(middle), [[0.0, 59.5]], atol=1e-3)
    # longer bands than the metadata know the attitude of
    np.save(images / "long_PA.npy", np.zeros((100_000, 4), np.uint16))
    np.save(images / "long_B0.npy", np.zeros((25_000, 1), np.uint16))
    status, said = said_by(
        "init", path, images / "long_PA.npy", images / "long_B0.npy", "--out", images / "b"
    )
    assert status == 2 and "or bands cut to its lines" in said


def test_a_product_that_tells_no_lags_does_not_serve_raw_bands(images):
    status, said = said_by("init", maker.dimap2(images), images / "raw_B0.npy", "--out", images / "acq")
    assert status == 2
    assert "tells no lags of bands in sensor geometry" in said


@pytest.mark.parametrize("period", ["0", "-0.1034", "1e-300"])
def test_a_line_period_that_is_none_is_said_of_the_product(images, period):
    path = maker.pleiades(images)
    text = path.read_text()
    start = text.index(">", text.index("<PA_LINE_PERIOD")) + 1
    path.write_text(text[:start] + period + text[text.index("</PA_LINE_PERIOD") :])
    bands = [images / "raw_PA.npy", images / "raw_B0.npy"]
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 2 and "/PA_LINE_PERIOD" in said and path.name in said


def test_fields_that_do_not_agree_are_refused(images):
    np.save(images / "narrow_B3.npy", np.zeros((160, 100), np.uint16))
    bands = [images / "raw_PA.npy", images / "narrow_B3.npy"]
    status, said = said_by("init", "--preset", "pleiades", *bands, "--out", images / "acq")
    assert status == 2
    assert "has 100 columns" in said
    assert "480 (of 4 and 1 fine pixels each)" in said
