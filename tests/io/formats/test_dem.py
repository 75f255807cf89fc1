from __future__ import annotations

import numpy as np
import pytest
from tests.io.conftest import write_tif

from sightline.errors import FormatError, GeometryError
from sightline.geometry.earth import from_geodetic
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import tables
from sightline.io.formats.dem import Bounds, read_dem

LONLAT = dict(crs="EPSG:4326", transform=(0.01, 0.0, 5.0, 0.0, -0.01, 45.0))


def grid(value: float = 100.0, shape=(60, 80)) -> np.ndarray:
    return np.full(shape, value, dtype=np.float32)


def georeferenced(path, array, *, transform, crs=None, **profile):
    from rasterio.transform import Affine

    return write_tif(path, array, transform=Affine(*transform), crs=crs, **profile)


def height_at(dem, lon: float, lat: float) -> float:
    return float(dem.height_at(from_geodetic([[np.radians(lon), np.radians(lat), 0.0]]))[0])


def test_heights_of_an_srtm_tile_are_those_of_its_bytes(real_data):
    path = real_data("srtm_n44e005") / "N44E005.hgt"
    raw = np.fromfile(path, dtype=">i2").reshape(1201, 1201)
    dem = read_dem(path, datum="ellipsoid")
    # node (row, column) of a tile lies at 45 - row / 1200 degrees north, 5 + column / 1200 degrees east
    for row, column in ((600, 600), (37, 1100), (1000, 13)):
        assert raw[row, column] > -1000
        assert height_at(dem, 5 + column / 1200, 45 - row / 1200) == pytest.approx(
            float(raw[row, column]), abs=1e-3
        )
    voids = raw == -32768
    np.testing.assert_array_equal(np.isnan(dem.heights), voids)
    assert dem.height_range[1] == raw.max() == 2757


def test_a_number_lifts_heights_above_the_geoid(tmp_path):
    path = georeferenced(tmp_path / "d.tif", grid(), **LONLAT)
    assert height_at(read_dem(path, datum="ellipsoid"), 5.3, 44.7) == pytest.approx(100.0)
    assert height_at(read_dem(path, datum="geoid", geoid=48.5), 5.3, 44.7) == pytest.approx(148.5)


def test_a_raster_of_the_geoid_is_interpolated_onto_the_dem(tmp_path):
    path = georeferenced(tmp_path / "d.tif", grid(), **LONLAT)
    # geoid height 10 * (longitude - 5) m on a coarse grid of its own
    longitude = 4.5 + 0.25 * (np.arange(12) + 0.5)
    geoid = np.tile(10 * (longitude - 5), (12, 1)).astype(np.float32)
    georeferenced(tmp_path / "g.tif", geoid, crs="EPSG:4326", transform=(0.25, 0, 4.5, 0, -0.25, 46.0))
    dem = read_dem(path, datum="geoid", geoid=tmp_path / "g.tif")
    assert height_at(dem, 5.4, 44.7) == pytest.approx(104.0, abs=0.01)


def test_a_geoid_that_ends_inside_the_dem_is_refused(tmp_path):
    path = georeferenced(tmp_path / "d.tif", grid(), **LONLAT)
    georeferenced(
        tmp_path / "g.tif", grid(5.0, (12, 2)), crs="EPSG:4326", transform=(0.25, 0, 4.9, 0, -0.25, 46.0)
    )
    with pytest.raises(FormatError, match=r"g\.tif: does not cover .* % of d\.tif"):
        read_dem(path, datum="geoid", geoid=tmp_path / "g.tif")


def test_heights_that_say_they_count_from_a_geoid_are_not_taken_as_ellipsoidal(tmp_path):
    options = {**LONLAT, "crs": "EPSG:4326+5773"}
    path = georeferenced(tmp_path / "d.tif", grid(), **options)
    with pytest.raises(
        FormatError, match=r"d\.tif: its heights count from 'EGM96 height'; say what to do: datum"
    ):
        read_dem(path)
    assert height_at(read_dem(path, datum="geoid", geoid=50.0), 5.3, 44.7) == pytest.approx(150.0)


def test_a_projected_dem_lies_where_the_projection_puts_it(tmp_path):
    from pyproj import Transformer

    array = np.add.outer(np.zeros(60), np.arange(80.0)).astype(np.float32)
    path = georeferenced(
        tmp_path / "d.tif", array, crs="EPSG:32631", transform=(30, 0, 690e3, 0, -30, 4.95e6)
    )
    dem = read_dem(path, datum="ellipsoid")
    x, y = 690e3 + 30 * 40.5, 4.95e6 - 30 * 20.5
    lon, lat = Transformer.from_crs(32631, 4326, always_xy=True).transform(x, y)
    assert height_at(dem, lon, lat) == pytest.approx(40.0, abs=1e-3)


def test_of_a_large_dem_only_the_part_needed_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr("sightline.io.formats.dem.WHOLE_CELLS", 100)
    array = np.add.outer(np.arange(60.0), np.zeros(80)).astype(np.float32)
    path = georeferenced(tmp_path / "d.tif", array, **LONLAT)
    dem = read_dem(path, datum="ellipsoid", bounds=Bounds(5.30, 44.70, 5.31, 44.71))
    assert dem.heights.shape[0] < 40 and dem.heights.shape[1] < 40
    assert height_at(dem, 5.305, 45 - 0.01 * 29.5) == pytest.approx(29.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (dict(transform=LONLAT["transform"]), "has no geographic or projected coordinate system"),
        (dict(crs="EPSG:4326", transform=(1, 0, 0, 0, 1, 0)), "has no georeferencing"),
    ],
)
def test_a_dem_without_a_place_on_earth_is_refused(tmp_path, options, words):
    path = georeferenced(tmp_path / "d.tif", grid(), **options)
    with pytest.raises(FormatError, match=words):
        read_dem(path, datum="ellipsoid")


def test_a_dem_in_feet_is_refused(tmp_path):
    import rasterio

    path = georeferenced(tmp_path / "d.tif", grid(), **LONLAT)
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("ft",)
    with pytest.raises(FormatError, match="heights are in 'ft'; metres are expected"):
        read_dem(path, datum="ellipsoid")


def test_a_dem_of_nothing_but_voids_is_refused(tmp_path):
    path = georeferenced(tmp_path / "d.tif", grid(-32768.0), **LONLAT)
    with pytest.raises(FormatError, match="no height between"):
        read_dem(path, datum="ellipsoid")


# ------------------------------------------------------------------------------- a DEM under an acquisition


def with_dem(folder, size: float):
    """A local DEM of a 60 m plateau, `size` metres to each side of the origin."""
    georeferenced(folder.path / "dem.tif", grid(60.0), transform=(size / 40, 0, -size, 0, -size / 30, size))
    return folder.add('[surface]\ndem = "dem.tif"\n')


def test_a_local_dem_lies_under_a_level_flight(folder):
    acquisition = load_acquisition(with_dem(folder, 3000.0).write())
    ground = acquisition.cameras[0].locate([[100.0, 59.5]], acquisition.surface)
    np.testing.assert_allclose(ground, [[0.0, 350.0, 60.0]], atol=1e-6)


def test_a_dem_that_does_not_cover_the_strip_names_share_and_extents(folder):
    with pytest.raises(GeometryError) as caught:
        load_acquisition(with_dem(folder, 300.0).write())
    said = str(caught.value)
    # of 0 .. 697 m (PAN) and 140 .. 836 m (XS) in nine steps each, those beyond 300 m less half a cell
    assert "the DEM does not cover the strip: 6" in said and "% of it lies outside" in said
    assert "the strip spans x -208 to 208 m, y 0 to 836 m" in said
    assert "the DEM x -300 to 300 m, y -300 to 300 m" in said


def test_a_georeferenced_dem_under_a_level_flight_is_refused(folder):
    georeferenced(folder.path / "dem.tif", grid(), **LONLAT)
    with pytest.raises(FormatError, match="has the coordinate system EPSG:4326, but the world is local"):
        load_acquisition(folder.add('[surface]\ndem = "dem.tif"\n').write())


def test_a_geographic_dem_that_lies_elsewhere_names_both_places(folder):
    t = np.linspace(-1.0, 2.0, 7)
    tables.write_positions(
        folder.path / "p.csv", t, np.column_stack([10.0 + 0 * t, 45.0 + 0.05 * t, 7e5 + 0 * t])
    )
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "p.csv"',
    ).add('[world]\nframe = "lonlat"\n[surface]\ndem = "dem.tif"\ndatum = "geoid"\ngeoid = 47.0\n')
    georeferenced(folder.path / "dem.tif", grid(), **LONLAT)
    with pytest.raises(GeometryError) as caught:
        load_acquisition(folder.write())
    said = str(caught.value)
    assert "100 % of it lies outside" in said
    assert "the strip spans longitude 9.99" in said and "the DEM longitude 5.0000 to 5.8000" in said


def test_heights_of_a_damaged_file_are_no_voids(tmp_path):
    heights = np.random.default_rng(0).normal(300.0, 50.0, (40, 40))
    shifted = np.roll(np.frombuffer(heights.astype("<f8").tobytes(), np.uint8), 3).view("<f8").reshape(40, 40)
    path = georeferenced(tmp_path / "d.tif", shifted, **LONLAT)
    with pytest.raises(
        FormatError, match=r"d\.tif: \d+ cells hold \d+ values from .* too many to mark voids"
    ):
        read_dem(path)


def test_a_raster_larger_than_memory_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("sightline.io.formats.dem.MOST_CELLS", 1000)
    path = georeferenced(tmp_path / "d.tif", grid(shape=(40, 40)), **LONLAT)
    with pytest.raises(FormatError, match=r"d\.tif: 1,600 cells of it would be read, 1,000 at most"):
        read_dem(path)
