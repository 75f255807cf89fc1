"""Registered bands as files: types, masks, layout, place on the ground."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from sightline.io.formats.images import open_image
from sightline.io.results.registered import MapGrid, as_type, write_registered
from sightline.io.results.registration import _clipped

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
SHAPE = (700, 560)


@pytest.fixture
def images():
    rng = np.random.default_rng(0)
    both = [rng.uniform(100.0, 4000.0, SHAPE).astype(np.float32) for _ in range(2)]
    both[1][:30, :40] = np.nan
    return both


def blocks(images, height=256):
    for first in range(0, SHAPE[0], height):
        yield first, [image[first : first + height] for image in images]


def written(tmp_path, images, dtypes, stack=False, tags=None):
    names = [["a", "b"]] if stack else [["a"], ["b"]]
    paths = [tmp_path / f"{k}.tif" for k in range(len(names))]
    share, _ = write_registered(
        paths, names, blocks(images), MapGrid(SHAPE, tags or {}), [np.dtype(d) for d in dtypes]
    )
    return paths, share


def test_integers_are_rounded_and_their_gaps_masked(tmp_path, images):
    paths, share = written(tmp_path, images, ["uint16", "uint16"])
    source = open_image(paths[1])
    gap = np.isnan(images[1])
    window = (0, SHAPE[0]), (0, SHAPE[1])
    np.testing.assert_array_equal(source.mask(*window), gap)
    np.testing.assert_array_equal(source.read(*window)[~gap], np.rint(images[1][~gap]))
    assert share == pytest.approx([1.0, 1.0 - gap.mean()])
    assert open_image(paths[0]).mask(*window) is None


def test_values_beyond_the_range_of_a_type_are_counted(tmp_path, images):
    paths, names = [tmp_path / "a.tif", tmp_path / "b.tif"], [["a"], ["b"]]
    types = [np.dtype("uint8"), np.dtype("float32")]
    valid, clipped = write_registered(paths, names, blocks(images), MapGrid(SHAPE, {}), types)
    # values are even from 100 to 4000
    assert clipped == pytest.approx([(images[0] > 255.5).mean(), 0.0]) and clipped[0] > 0.9
    assert valid[0] == 1.0
    (said,) = _clipped([{"name": "a", "type": "uint8"}, {"name": "b", "type": "float32"}], clipped)
    assert said.startswith("96 % of a is beyond the range of uint8") and "--type" in said


def test_floats_keep_their_values_and_gaps_are_nan(tmp_path, images):
    paths, _ = written(tmp_path, images, ["float32", "float32"])
    with rasterio.open(paths[1]) as file:
        np.testing.assert_array_equal(file.read(1), images[1])
        assert np.isnan(file.nodata)
        assert file.descriptions == ("b",)


def test_files_are_cloud_optimised(tmp_path, images):
    paths, _ = written(tmp_path, images, ["uint16", "float32"])
    for path in paths:
        with rasterio.open(path) as file:
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert file.block_shapes == [(512, 512)]
            assert file.overviews(1) == [2]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["0.tif", "1.tif"]


def test_one_file_of_all_is_masked_where_any_band_has_no_value(tmp_path, images):
    paths, share = written(tmp_path, images, ["uint16"], stack=True)
    with rasterio.open(paths[0]) as file:
        assert file.descriptions == ("a", "b")
        np.testing.assert_array_equal(file.dataset_mask() == 0, np.isnan(images[1]))
    assert len(share) == 2


def test_the_place_on_the_ground_of_the_reference_is_kept(tmp_path, images):
    tags = {"crs": rasterio.CRS.from_epsg(32633), "transform": Affine(10.0, 0.0, 5e5, 0.0, -10.0, 5e6)}
    paths, _ = written(tmp_path, images, ["uint16", "uint16"], tags=tags)
    with rasterio.open(paths[0]) as file:
        assert file.crs == tags["crs"] and file.transform == tags["transform"]


def test_values_beyond_the_type_stay_at_its_ends():
    got = as_type(np.array([-3.0, 0.4, 254.6, 300.0, np.nan], np.float32), np.dtype("uint8"))
    assert got.tolist() == [0, 0, 255, 255, 0]


def test_a_failed_block_leaves_no_file(tmp_path, images):
    def broken():
        yield from list(blocks(images))[:1]
        raise RuntimeError("disk")

    with pytest.raises(RuntimeError):
        write_registered(
            [tmp_path / "a.tif"], [["a", "b"]], broken(), MapGrid(SHAPE, {}), [np.dtype("uint16")]
        )
    assert list(tmp_path.iterdir()) == []
