"""Files of a cube: each format gives back every pixel at its place; what [cube] may say."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import pytest
import rasterio

from cube_flights import flight, true_poses
from sightline.errors import InputError
from sightline.io.formats.envi import read_envi_wavelengths
from sightline.io.formats.json_text import json_text
from sightline.io.results.cube_files import CubeFolder
from sightline.io.results.cube_summary import cube_plan, cube_summary, write_cube
from sightline.io.sequence.load import read_sequence
from sightline.io.sequence.schema import CubeSection
from sightline.products.cube_bands import BandLayout, frame_bands, line_bands
from sightline.products.cube_grid import CubeGrid, MapSystem
from sightline.simulate.sequence_files import write_sequence

SHAPE = (70, 90)


def cube(layout: BandLayout) -> np.ndarray:
    values = np.random.default_rng(0).normal(100.0, 5.0, (len(layout), *SHAPE)).astype(np.float32)
    values[:, :7, :] = np.nan
    values[0, 20, 30] = np.nan
    return values


def written(folder, formats, *, crs=None, layout=None, one_file=False):
    layout = line_bands(np.repeat([500.0, 600.0, 725.5], 4)) if layout is None else layout
    grid = CubeGrid(MapSystem(crs), 600000.0, 5200000.0, 0.5, SHAPE)
    store, values = CubeFolder(folder, formats, one_file=one_file), cube(layout)
    store.begin(grid, layout)
    for row, column in ((0, 0), (0, 50), (40, 0), (40, 50)):
        store.write(row, column, values[:, row : row + 40, column : column + 50])
    # what is written is read back in windows before the files are made
    part = store.source(1).read((5, 30), (10, 80))
    assert np.array_equal(part, values[1, 5:30, 10:80], equal_nan=True)
    assert store.source(1).mask((0, 30), (0, 10))[:7].all() and store.source(1).mask((8, 9), (0, 9)) is None
    return grid, layout, values, store.finish()


def test_one_tiff_for_each_band_in_a_map_projection(tmp_path):
    _, _, values, files = written(tmp_path, ["tif"], crs="EPSG:32632")
    assert files == ("bands/0-500.0nm.tif", "bands/1-600.0nm.tif", "bands/2-725.5nm.tif")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bands"]
    for band, name in enumerate(files):
        with rasterio.open(tmp_path / name) as source:
            assert np.array_equal(source.read(1), values[band], equal_nan=True)
            assert source.crs.to_epsg() == 32632 and np.isnan(source.nodata)
            assert tuple(source.transform)[2:6:3] == (600000.0, 5200000.0) and source.res == (0.5, 0.5)
            assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert float(source.tags(1)["wavelength_nm"]) == [500.0, 600.0, 725.5][band]


def test_one_tiff_of_all_bands_in_local_metres(tmp_path):
    _, layout, values, files = written(tmp_path, ["tif"], one_file=True)
    assert files == ("cube.tif",)
    with rasterio.open(tmp_path / "cube.tif") as source:
        assert np.array_equal(source.read(), values, equal_nan=True)
        assert source.crs is None and source.descriptions == layout.names


@pytest.mark.parametrize(
    "crs", [None, "EPSG:32719", "EPSG:5041", "+proj=tmerc +lat_0=3 +lon_0=9 +a=3396190 +b=3376200"]
)
def test_envi_tells_place_and_wavelengths(tmp_path, crs):
    _, layout, values, files = written(tmp_path, ["envi"], crs=crs)
    assert files == ("cube.dat", "cube.hdr")
    assert read_envi_wavelengths(tmp_path / "cube.hdr") == pytest.approx(layout.wavelength_nm)
    with rasterio.open(tmp_path / "cube.dat") as source:
        assert np.array_equal(source.read(), values, equal_nan=True)
        assert np.isnan(source.nodata)
        assert tuple(source.transform)[2:6:3] == (600000.0, 5200000.0)
        if crs is not None and crs.startswith("EPSG"):
            assert source.crs == rasterio.crs.CRS.from_user_input(crs)


def test_zarr_tells_place_and_wavelengths(tmp_path):
    zarr = pytest.importorskip("zarr")
    grid, layout, values, files = written(tmp_path, ["zarr"], crs="EPSG:32632")
    assert files == ("cube.zarr",)
    group = zarr.open_group(tmp_path / "cube.zarr", mode="r")
    assert np.array_equal(group["cube"][:], values, equal_nan=True)
    assert group["cube"].metadata.dimension_names == ("band", "y", "x")
    assert group["wavelength"][:] == pytest.approx(layout.wavelength_nm)
    assert (group["x"][0], group["y"][0]) == (600000.25, 5199999.75)
    assert "UTM zone 32N" in group.attrs["crs_wkt"] and group.attrs["transform"] == list(grid.transform)


@pytest.mark.parametrize(("form", "engine"), [("zarr", "zarr"), ("netcdf", "netcdf4")])
@pytest.mark.parametrize("crs", [None, "EPSG:32632", "+proj=tmerc +lat_0=3 +lon_0=9 +a=3396190 +b=3376200"])
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # never shown: rioxarray about affine
@pytest.mark.filterwarnings("error")
def test_xarray_and_rioxarray_know_where_a_cube_lies(tmp_path, form, engine, crs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # their imports are not what is tested
        xarray = pytest.importorskip("xarray")
        rioxarray = pytest.importorskip("rioxarray")
    grid, _, values, (name,) = written(tmp_path, [form], crs=crs)
    options = {"consolidated": True} if form == "zarr" else {}
    with xarray.open_dataset(tmp_path / name, engine=engine, **options) as opened:
        cube = opened["cube"]
        assert cube.dims == ("band", "y", "x") and cube.dtype == np.float32
        assert np.array_equal(cube.values, values, equal_nan=True)
        assert set(opened.data_vars) == {"cube"}
        assert cube.wavelength.values == pytest.approx([500.0, 600.0, 725.5])
        assert cube.wavelength.attrs["units"] == "nm"
        assert cube.wavelength.attrs["standard_name"] == "radiation_wavelength"
        assert (cube.x.values[0], cube.y.values[0]) == (600000.25, 5199999.75)
        named = [cube[axis].attrs.get("standard_name") for axis in "xy"]
        assert named == ([None] * 2 if crs is None else [f"projection_{axis}_coordinate" for axis in "xy"])
        assert cube.rio.transform() == rasterio.Affine(*grid.transform)
        assert (cube.rio.crs is None) if crs is None else (cube.rio.crs == rasterio.crs.CRS.from_string(crs))
        # the nearest band of a wavelength, in one line
        assert np.array_equal(
            cube.swap_dims(band="wavelength").sel(wavelength=610.0, method="nearest"),
            values[1],
            equal_nan=True,
        )
    assert rioxarray.__name__  # it gave xarray its `rio`


def test_the_same_cube_is_the_same_netcdf(tmp_path):
    pytest.importorskip("netCDF4")
    files = []
    for name in "ab":
        (tmp_path / name).mkdir()
        written(tmp_path / name, ["netcdf"], crs="EPSG:32632")
        files.append((tmp_path / name / "cube.nc").read_bytes())
    assert files[0] == files[1]


def test_what_cannot_be_written_is_reported_before_work_starts(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="must be among tif, zarr, netcdf, envi"):
        CubeFolder(tmp_path, ["hdf4"])
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(InputError, match="which is not installed; run `pip install zarr`"):
        CubeFolder(tmp_path, ["zarr"])
    grid = CubeGrid(MapSystem(), 0.0, 0.0, 1e-3, (10**8, 10**8))
    with pytest.raises(InputError, match="GB are free"):
        CubeFolder(tmp_path).begin(grid, frame_bands((20, 20)))
    assert not list(tmp_path.iterdir())


def test_a_section_becomes_a_plan():
    assert cube_plan(CubeSection()).bands is None
    plan = cube_plan(CubeSection(gsd=0.2, bands=[500.0, 600.0], surface="given", fill_nm=4.0, flatten=False))
    assert (plan.gsd, plan.bands, plan.surface, plan.fill_nm) == (0.2, (500.0, 600.0), "given", 4.0)
    assert not plan.flatten and plan.picture_nm is None
    assert cube_plan(CubeSection(picture_nm=[850.0, 650.0, 550.0])).picture_nm == (850.0, 650.0, 550.0)


def test_the_cube_of_a_sequence_file(tmp_path):
    scenario = flight(frames=12)
    write_sequence(scenario, tmp_path, dem=True, truth_bands=0)
    toml = tmp_path / "sequence.toml"
    toml.write_text(toml.read_text() + '\n[cube]\nbands = [500.0, 700.0]\nformats = ["tif", "envi"]\n')
    sequence, out = read_sequence(toml), tmp_path / "out"
    out.mkdir()
    summary, files = write_cube(out, sequence, true_poses(scenario))
    assert files == ("bands/0-500.0nm.tif", "bands/1-700.0nm.tif", "cube.dat", "cube.hdr")
    assert all((out / name).is_file() for name in files)
    assert sorted(p.name for p in out.iterdir()) == ["bands", "cube.dat", "cube.hdr"]
    said = cube_summary(summary, files)
    assert [band["wavelength_nm"] for band in said["bands"]] == [500.0, 700.0]
    assert said["crs"] is None and "the surface given" in said["surface"]
    assert '"pairs"' in json_text(said)
    # an error leaves nothing behind
    (out / "cube.dat").unlink()
    toml.write_text(toml.read_text().replace("700.0]", "1700.0]"))
    with pytest.raises(InputError, match="must be wavelengths from"):
        write_cube(out, read_sequence(toml), true_poses(scenario))
    assert sorted(p.name for p in out.iterdir()) == ["bands", "cube.hdr"]
