"""Kinds of ground measured from real bands, where the data are found."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.simulate.sequence import sequence_case
from sightline.simulate.sequence_spectra import ground_spectra, measured_spectra, real_bands


def block_means(bands, side=8):
    count, rows, columns = bands.shape
    rows, columns = rows // side * side, columns // side * side
    cut = bands[:, :rows, :columns].reshape(count, rows // side, side, columns // side, side)
    return cut.mean(axis=(2, 4)).reshape(count, -1)


def test_real_bands_are_laid_on_one_another(real_data):
    folder = real_data("rededge_capture").parent
    _, bands = real_bands("rededge", folder)
    blue, green = (band - band.mean() for band in block_means(bands[:2], 4))
    # the same ground: without the shift of (7, 10) px the plants' rows are half a row apart
    assert np.corrcoef(blue, green)[0, 1] > 0.85


def test_kinds_of_real_ground_change_order_between_red_and_infrared(real_data):
    spectra = measured_spectra("rededge", real_data("rededge_capture").parent)
    red, infrared = spectra.at(np.array([668.0, 840.0]))
    assert (np.argsort(red) != np.argsort(infrared)).any()
    # plants: less than half as bright in red as in infrared, over the mean ground
    assert (red / infrared).min() < 0.6 and (red / infrared).max() > 1.3
    assert spectra.share.sum() == pytest.approx(1.0) and spectra.share.min() > 0.05


def test_bands_of_a_drawn_ground_are_as_alike_as_the_real_ones(real_data, monkeypatch):
    folder = real_data("rededge_capture").parent
    monkeypatch.setenv("SIGHTLINE_DATA", str(folder))
    wavelength_nm, bands = real_bands("rededge", folder)
    real = np.corrcoef(block_means(bands))
    scenario = sequence_case("small", 5, spectra="rededge", frames=400)
    rng, seen = np.random.default_rng(0), scenario.seen
    x, y = rng.uniform(seen.west, seen.east, 20000), rng.uniform(seen.south, seen.north, 20000)
    drawn = np.corrcoef(scenario.band_signal(x, y, wavelength_nm).T)
    # four kinds stand for all grounds, and a handful of patches for the scene: alike to a fifth
    assert np.abs(drawn - real).max() < 0.25


def test_the_texture_of_a_real_scene_may_lie_on_the_ground(real_data, monkeypatch):
    monkeypatch.setenv("SIGHTLINE_DATA", str(real_data("landsat7_everest").parent))
    scenario = sequence_case("small", 0, texture="landsat", frames=2)
    _, bands = real_bands("landsat")
    light, seen, gsd = bands.mean(axis=0), scenario.seen, scenario.options.gsd
    i, j = np.meshgrid(np.arange(40, 200, 5), np.arange(30, 210, 5), indexing="ij")
    nm = np.linspace(460.0, 840.0, 20)
    shown = scenario.band_signal(seen.west + gsd * j, seen.south + gsd * i, nm).mean(axis=-1)
    # brightness over wavelengths is the mean over other weights than the four bands'
    assert np.corrcoef(shown.ravel(), light[i, j].ravel())[0, 1] > 0.97


def test_landsat_has_four_kinds_too(real_data):
    spectra = measured_spectra("landsat", real_data("landsat7_everest").parent)
    assert spectra.brightness.shape == (4, 4) and spectra.wavelength_nm.tolist() == [485, 560, 660, 835]


def test_real_spectra_are_read_where_they_are_asked_for_by_name_and_nowhere_else(monkeypatch, tmp_path):
    assert ground_spectra("law").name == "law"
    with pytest.raises(FormatError, match="no folder of real data is given; set SIGHTLINE_DATA"):
        ground_spectra("rededge")
    monkeypatch.setenv("SIGHTLINE_DATA", str(tmp_path))
    with pytest.raises(FormatError, match=r"real data not found: .*rededge_capture"):
        ground_spectra("rededge")


def test_an_unknown_real_scene_is_refused():
    with pytest.raises(InputError, match="allowed are rededge, landsat"):
        real_bands("moon")
