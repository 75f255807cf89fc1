"""What catalogues and hyperspectral users get: STAC, GeoParquet, IGM and GLT."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from tests.io.results.exported import orbit_strip

from sightline.errors import InputError
from sightline.io.formats.footprints import feature_of
from sightline.io.results.catalog import bounds_of, hull_of, write_geoparquet
from sightline.io.results.exports import OF_PLACE, write_export


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    return orbit_strip(tmp_path_factory.mktemp("strip"), amplitude=6e-7)


def ground(strip, name, pixels):
    """Longitude, latitude (degrees) by pyproj of what pixels see."""
    from pyproj import Transformer

    seen = strip.cameras[name].locate(pixels, strip.acquisition.surface)
    lonlat = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    return np.stack(lonlat.transform(*seen.T)[:2], axis=1)


def test_a_strip_as_an_item_of_stac(strip, tmp_path):
    pystac = pytest.importorskip("pystac")
    (tmp_path / "result" / "bands").mkdir(parents=True)
    out = tmp_path / "catalogue"
    out.mkdir()
    files = ("motion.csv", "report.html", "cube.zarr/zarr.json", "cube.zarr/cube/c/0/0/0", "bands/0.tif")
    write_export("stac", out, replace(strip, folder=tmp_path / "result", files=files))
    item = pystac.Item.from_file(str(out / "stac.json"))
    assert item.ext.has("proj") and item.ext.proj.code is None
    core = item.to_dict()
    core["stac_extensions"] = []  # their schemas are on a network
    pystac.Item.from_dict(core).validate()
    assert sorted(item.assets) == ["bands/0.tif", "cube.zarr", "motion.csv", "report.html"]
    assert item.assets["bands/0.tif"].href == "../result/bands/0.tif"
    # 2026-03-04 05:06:07.25 is t = 0
    since = item.common_metadata.start_datetime.replace(tzinfo=None) - item.datetime.replace(tzinfo=None)
    assert since.total_seconds() == pytest.approx(-0.5 * np.ptp(strip.t), abs=2e-6)
    name = next(iter(strip.cameras))
    lines, columns = strip.cameras[name].shape
    middle = ground(strip, name, [[lines / 2, columns / 2]])[0]
    west, south, east, north = item.bbox
    assert west < middle[0] < east and south < middle[1] < north
    corners = ground(strip, name, [[0, 0], [0, columns - 1], [lines - 1, 0], [lines - 1, columns - 1]])
    # the outline holds the corners, and goes no farther than the other bands do: a tenth of the strip
    size = np.ptp(corners, axis=0)
    assert (corners.min(axis=0) >= [west, south]).all() and (corners.max(axis=0) <= [east, north]).all()
    assert east - west < 1.5 * size[0] + 1e-3 and north - south < 1.5 * size[1] + 1e-3


def test_the_map_of_a_cube_is_in_its_item(strip, tmp_path):
    pystac = pytest.importorskip("pystac")
    wkt = rasterio.crs.CRS.from_epsg(32632).to_wkt()
    cube = {"crs": wkt, "shape": [190, 206], "extent": [500000.0, 0.0, 500100.0, 5300000.0], "gsd": 0.5}
    ring = feature_of(np.array([[9.0, 47.0], [9.001, 47.0], [9.001, 47.001], [9.0, 47.001]]), {"t": 0.0})
    flight = replace(strip, flight=True, footprints=(ring,), cube=cube)
    write_export("stac", tmp_path, flight)
    projection = pystac.Item.from_file(str(tmp_path / "stac.json")).ext.proj
    assert projection.code == "EPSG:32632" and projection.shape == [190, 206]
    assert projection.transform == [0.5, 0.0, 500000.0, 0.0, -0.5, 5300000.0]


def test_what_has_no_epoch_or_lies_on_another_body_is_no_item(strip, tmp_path):
    # of what another command made, its file and command are not those of a recovery
    for only, said in (((), r"add \[acquisition\] epoch"), (OF_PLACE, "add the epoch")):
        with pytest.raises(InputError, match=said):
            write_export("stac", tmp_path, replace(strip, epoch=None, only=only))
    flat = replace(strip, flight=True, footprints=())
    with pytest.raises(InputError, match="needs a place on the Earth"):
        write_export("geoparquet", tmp_path, flat)


def test_footprints_as_geoparquet(strip, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    write_export("geoparquet", tmp_path, strip)
    table = parquet.read_table(tmp_path / "footprints.parquet")
    assert table["name"].to_pylist() == list(strip.cameras)
    about = json.loads(table.schema.metadata[b"geo"])
    assert about["version"] == "1.1.0" and "crs" not in about["columns"]["geometry"]  # longitude, latitude
    content = table["geometry"][0].as_py()
    order, kind, rings, count = struct.unpack_from("<BIII", content)
    assert (order, kind, rings) == (1, 3, 1) and len(content) == 13 + 16 * count
    ring = np.frombuffer(content, "<f8", offset=13).reshape(-1, 2)
    assert np.array_equal(ring[0], ring[-1])
    x, y = ring[:-1].T - ring[:-1].mean(axis=0)[:, None]
    assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0.0  # counterclockwise
    name = next(iter(strip.cameras))
    corner = ground(strip, name, [[-0.5, -0.5]])
    assert np.abs(ring - corner).max(axis=1).min() < 1e-8
    assert str(table["datetime_first"][0].as_py())[:10] == "2026-03-04"


def test_footprints_across_180_degrees_stay_small(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    across = feature_of(np.array([[179.9, 1.0], [-179.9, 1.0], [-179.9, 2.0], [179.9, 2.0]]), {"frame": "a"})
    beside = feature_of(np.array([[179.7, 1.0], [179.8, 1.0], [179.8, 2.0], [179.7, 2.0]]), {"frame": "b"})
    hull = hull_of([across, beside])
    assert hull["type"] == "MultiPolygon" and bounds_of(hull) == [179.7, 1.0, -179.9, 2.0]
    mars = (3396190.0, 3376200.0)
    write_geoparquet(tmp_path / "f.parquet", [across, beside], mars, None)
    table = parquet.read_table(tmp_path / "f.parquet")
    about = json.loads(table.schema.metadata[b"geo"])["columns"]["geometry"]
    assert about["geometry_types"] == ["MultiPolygon", "Polygon"] and about["crs"]["type"] == "GeographicCRS"
    assert struct.unpack_from("<BII", table["geometry"][0].as_py()) == (1, 6, 2)


def test_each_place_of_the_glt_shows_the_pixel_that_the_igm_puts_there(strip, tmp_path):
    summary = write_export("igm", tmp_path, strip)
    name = next(iter(strip.cameras))
    band = summary["bands"][0]
    with rasterio.open(tmp_path / f"{name}_igm.dat") as source:
        igm = source.read()
    with rasterio.open(tmp_path / f"{name}_glt.dat") as source:
        glt, transform, crs = source.read(), source.transform, source.crs
    assert igm.shape == (3, *strip.cameras[name].shape) and crs.to_string() == band["crs"]
    from pyproj import Transformer

    pixels = np.array([[10.0, 7.0], [30.0, 40.0]])
    lonlat = ground(strip, name, pixels)
    expected = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(*lonlat.T)
    rows, columns = pixels.astype(int).T
    np.testing.assert_allclose(igm[:2, rows, columns], expected, atol=1e-3)
    row, column = np.nonzero(glt[0])
    sample, line = np.abs(glt[:, row, column])
    x, y = rasterio.transform.xy(transform, row, column)
    off = np.hypot(igm[0, line - 1, sample - 1] - x, igm[1, line - 1, sample - 1] - y)
    own = glt[0, row, column] > 0
    # half the diagonal of a pixel; that of the neighbour of a hole is up to 1.5 pixels more away
    assert off[own].max() <= 0.7072 * transform.a and off.max() <= 2.3 * transform.a
    assert ((glt[0] > 0) == (glt[1] > 0)).all()
    # every pixel that is nearest somewhere is seen, and the map has few holes inside
    lines, width = strip.cameras[name].shape
    area = lines * width * np.abs(np.linalg.det(_steps(igm))) / transform.a**2
    assert (glt[0] != 0).sum() >= 0.97 * area


def _steps(igm):
    """Steps (2, 2) m of a line and of a column, in the middle."""
    row, column = igm.shape[1] // 2, igm.shape[2] // 2
    here = igm[:2, row, column]
    return np.stack([igm[:2, row + 1, column] - here, igm[:2, row, column + 1] - here])


def test_registered_bands_cover_what_the_band_does_whose_grid_they_have(strip, tmp_path):
    from sightline import register_bands
    from sightline.geometry.trajectory import Motion

    acquired = strip.acquisition
    still = Motion(strip.t, np.zeros((len(strip.t), 3)))
    result = register_bands(acquired.bands, acquired.surface, still, onto="XS")
    result.export("stac", tmp_path / "stac")
    item = json.loads((tmp_path / "stac" / "stac.json").read_text())
    assert item["id"] == "over_the_sea"
    lines, columns = acquired.bands[1].camera.shape
    corners = [[-0.5, -0.5], [-0.5, columns - 0.5], [lines - 0.5, -0.5], [lines - 0.5, columns - 0.5]]
    seen = acquired.bands[1].camera.locate(corners, acquired.surface)
    from pyproj import Transformer

    lonlat = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*seen.T)
    west, south, east, north = item["bbox"]
    # degrees; 1e-9 are written
    assert [west, east] == pytest.approx([lonlat[0].min(), lonlat[0].max()], abs=2e-9)
    assert [south, north] == pytest.approx([lonlat[1].min(), lonlat[1].max()], abs=2e-9)
    with pytest.raises(InputError, match="of this result there are stac and geoparquet"):
        result.export("csm", tmp_path / "csm")
