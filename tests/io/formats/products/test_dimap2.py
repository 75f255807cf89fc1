"""DIMAP 2 SENSOR: the model against the vertices that the file itself gives."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import maker_files as maker
from sightline.errors import FormatError
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.makers import Orbit
from sightline.io.formats.products.recognise import read_product

SPOT6 = ("spot6_pan_meta.xml", "spot6_multi_meta.xml")


@pytest.fixture(scope="module")
def spot_6(real_data):
    """The two products of one scene by their files' names."""
    return {name: read_product(real_data("vendor_models") / name) for name in SPOT6}


def left(product, height):
    """m between marks of a product, at a height, and where the model sees them."""
    marks = product.marks
    seen = product.model.camera.locate(
        np.array([[mark.line, mark.column] for mark in marks]), Ellipsoid(height=height)
    )
    given = maker.geodetic(seen)
    metres = np.radians([[mark.longitude, mark.latitude] for mark in marks]) - np.radians(given[:, :2])
    return np.hypot(metres[:, 0] * np.cos(np.radians(given[:, 1])), metres[:, 1]) * 6.38e6


@pytest.mark.parametrize("name", SPOT6)
def test_the_model_of_spot_6_meets_its_vertices(spot_6, name):
    product = spot_6[name]
    # fitted to the five vertices alone; the file tells no height
    assert abs(product.height - 201.5) < 0.01
    assert left(product, product.height).max() < 0.03
    assert left(product, product.height + 10.0).max() > 0.5
    assert not product.model.lacks  # with aberration the vertices would be 1.6 to 14 m off


def test_half_a_line_is_seen_in_the_vertices(spot_6):
    product = spot_6[SPOT6[0]]
    pixels = np.array([[mark.line + 0.5, mark.column] for mark in product.marks])
    seen = product.model.camera.locate(pixels, Ellipsoid(height=product.height))
    again = product.model.camera.locate(pixels - [0.5, 0.0], Ellipsoid(height=product.height))
    # half a line of 229 us at 6.7 km/s; ten times what the vertices leave
    assert np.linalg.norm(seen - again, axis=1).min() > 0.5


def centres(fine, wide, pixels, offset, height=201.5):
    """m between pixels of the wide grid and those of the fine one that are said to be theirs."""
    ground = Ellipsoid(height=height)
    seen = fine.model.camera.locate(4.0 * pixels + offset, ground)
    return np.linalg.norm(wide.model.camera.locate(pixels, ground) - seen, axis=1)


def test_pixels_of_the_bands_have_their_centres_on_4_k_plus_2(spot_6):
    fine, wide = spot_6.values()
    pixels = np.array([[0.0, 0.0], [100.0, 9000.0], [7042.0, 9431.0], [3000.0, 20.0]])
    assert centres(fine, wide, pixels, 2.0).max() < 0.01
    assert centres(fine, wide, pixels, 1.5).min() > 1.0  # half a pixel of 1.5 m both ways


def test_a_written_product_meets_its_vertices_and_its_other_band(tmp_path):
    wide = read_product(maker.dimap2(tmp_path))
    fine = read_product(maker.dimap2(tmp_path, step=1, rows=241, columns=201, name="DIM_P.XML"))
    for product in (wide, fine):
        assert abs(product.height - 201.5) < 0.05
        # labels round to a microsecond: 7 mm; rows to 1e-12 degrees
        assert left(product, product.height).max() < 0.02
    pixels = np.array([[0.0, 0.0], [20.0, 30.0], [59.0, 49.0]])
    assert centres(fine, wide, pixels, 2.0).max() < 0.02
    assert centres(fine, wide, pixels, 1.5).min() > 0.9
    assert [band.name for band in wide.bands] == ["B2", "B1", "B0", "B3"]
    assert wide.bands[2].image == "IMG_R1C1.TIF"
    assert wide.bands[2].image_band == 3


def test_bands_of_a_scene_share_one_grid_and_say_what_would_do(tmp_path):
    wide = read_product(maker.dimap2(tmp_path)).model.one_grid
    fine = read_product(
        maker.dimap2(tmp_path, step=1, rows=241, columns=201, name="DIM_P.XML")
    ).model.one_grid
    assert wide.of == fine.of
    assert "L1A" in wide.reason


def test_models_of_one_strip_share_their_time(tmp_path):
    fine = read_product(maker.dimap2(tmp_path, step=1, name="DIM_P.XML")).model
    wide = read_product(maker.dimap2(tmp_path), fine.reference).model
    assert fine.camera.first_line_time == 0.0
    assert wide.camera.first_line_time == pytest.approx(458e-6, abs=1e-12)


REFUSED = {
    "another level": ([(">SENSOR<", ">ORTHO<")], "level ORTHO; of level SENSOR"),
    "a unit that is not known": ([('unit="microsecond"', 'unit="fortnight"')], "is in 'fortnight'; units"),
    "no line period": (
        [('unit="microsecond">916', 'unit="microsecond">-916')],
        "is -0.000916 s; line scanners take",
    ),
    "velocities of km/s": ([("<VELOCITY_XYZ>", "<VELOCITY_XYZ>1e-9 ")], "holds 4 numbers, not 3"),
    "a bias": ([("<YAW>0.0", "<YAW>0.1")], "YAW is not 0"),
    "fewer looks than columns": ([("<LAST_COL>50", "<LAST_COL>40")], "is 40 of 50 columns"),
    "no attitudes": (
        [("Quaternion_List", "Other_List")],
        "Quaternion is there 0 times, 2 or more are needed",
    ),
    "a padded count of rows": ([("<NROWS>60", "<NROWS>2048")], "ends .* before the last line"),
    "an entity": (
        [("<Dimap_Document>", '<!DOCTYPE x [<!ENTITY a "b">]><Dimap_Document>')],
        "declares entities",
    ),
    "no number": ([("<XLOS_0>-", "<XLOS_0>x")], "is 'x0.04"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_named(tmp_path, case):
    changes, words = REFUSED[case]
    path = maker.dimap2(tmp_path, changes=changes)
    with pytest.raises(FormatError, match=words):
        read_product(path)


def test_attitudes_by_polynomials_as_pleiades_has_them(tmp_path):
    """Also its velocities (relative to the stars), ms, one look for all bands and vertices with heights."""
    path = maker.dimap2(tmp_path, polynomials=True)
    product = read_product(path)
    marks = product.marks
    np.testing.assert_allclose([mark.height for mark in marks], 201.5 + 10.0 * np.arange(5))
    assert product.height == pytest.approx(221.5) and "the mean of the vertices" in product.assumed[0]
    assert "relative to the stars" in product.assumed[1]
    for mark in marks:
        # labels of the start round to a microsecond: 7 mm
        assert left(replace(product, marks=(mark,)), mark.height).max() < 0.02
    assert [band.name for band in product.bands] == ["band 1", "band 2", "band 3", "band 4"]
    late = maker.dimap2(tmp_path, polynomials=True, changes=[("<SCALE>0.3", "<SCALE>0.0003")])
    with pytest.raises(FormatError, match=r"quaternion of length .* at an end of the image"):
        read_product(late)


def test_positions_some_ms_apart_are_continued_evenly():
    """Labels rounded to a microsecond, .7 steps of 4 ms before the first row: 8 mm of noise stay that."""
    t = 0.0028 + np.arange(330) * 4.3625e-3
    place, speed, _ = maker.orbit(t)
    early = Orbit(np.round(t, 6), place, speed).positions(np.array([0.0]))
    assert np.linalg.norm(early - maker.orbit(0.0)[0]) < 0.02


def parts(*files, tiles=False):
    """Files of two parts of an image, as Pleiades Neo has them; each of two tiles if wanted."""
    one = '<Data_File tile_R="1" tile_C="{0}"><DATA_FILE_PATH href="IMG_{1}_R1C{0}.TIF"/></Data_File>'
    numbers = (1, 2) if tiles else (1,)
    joined = "</Data_Files><Data_Files>"
    listed = ["".join(one.format(number, file) for number in numbers) for file in files]
    size = '<Tile_Set><Regular_Tiling><NTILES_SIZE nrows="64" ncols="32"/></Regular_Tiling></Tile_Set>'
    return [
        ('<Data_File><DATA_FILE_PATH href="IMG_R1C1.TIF"/></Data_File>', joined.join(listed)),
        ("<NBANDS>", f"{size}<NBANDS>"),
    ]  # fmt: skip


def test_parts_of_an_image_hold_the_bands_that_their_names_spell(tmp_path):
    bands = ("DB", "B", "G", "R", "RE", "NIR")
    path = maker.dimap2(tmp_path, bands=bands, changes=parts("RGB", "NED"))
    found = [(band.name, band.image, band.image_band) for band in read_product(path).bands]
    assert found == [
        *((name, "IMG_RGB_R1C1.TIF", k) for k, name in enumerate(("R", "G", "B"), 1)),
        *((name, "IMG_NED_R1C1.TIF", k) for k, name in enumerate(("NIR", "RE", "DB"), 1)),
    ]
    product = read_product(maker.dimap2(tmp_path, bands=bands, changes=parts("RGB", "NED", tiles=True)))
    assert [band.name for band in product.bands] == ["R", "G", "B", "NIR", "RE", "DB"]
    assert [tile.bands for tile in product.pixels.tiles] == [(0, 3), (0, 3), (3, 3), (3, 3)]
    twice = parts("RGB", "NED", tiles=True)
    twice[0] = (twice[0][0], twice[0][1].replace('tile_C="2"', 'tile_C="1"'))
    with pytest.raises(FormatError, match="lists 4 tiles, 2 of them unlike"):
        read_product(maker.dimap2(tmp_path, bands=bands, changes=twice))


def test_other_files_of_a_product_lie_in_its_folder(tmp_path):
    """Its RPC and its lineage, and the folder of its image within that of its volume."""
    inner = tmp_path / "IMG_SPOT7_MS_001_A"
    inner.mkdir()
    maker.dimap2(inner, name="DIM_SPOT7.XML")
    head = '<Dimap_Document><Metadata_Identification><METADATA_FORMAT version="2.0">DIMAP</METADATA_FORMAT>{}'
    for place, kind in (
        (inner / "RPC_SPOT7.XML", "<METADATA_SUBPROFILE>RPC</METADATA_SUBPROFILE>"),
        (tmp_path / "VOL_SPOT7.XML", "<METADATA_PROFILE>S7_VOLUME</METADATA_PROFILE>"),
    ):
        place.write_text(head.format(kind) + "</Metadata_Identification></Dimap_Document>")
    assert read_product(inner).path.name == read_product(tmp_path).path.name == "DIM_SPOT7.XML"
    with pytest.raises(FormatError, match="not the one that holds its model: give DIM_"):
        read_product(inner / "RPC_SPOT7.XML")
    with pytest.raises(FormatError, match="not the one that holds its model: give DIM_"):
        read_product(tmp_path / "VOL_SPOT7.XML")


def test_a_file_that_was_cut_short_is_no_xml(tmp_path):
    path = maker.dimap2(tmp_path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(FormatError, match="is no complete XML"):
        read_product(path)


def test_velocities_in_other_units_are_refused(tmp_path):
    path = maker.dimap2(tmp_path)
    text = re.sub(
        r"(?<=<VELOCITY_XYZ>)[^<]+",
        lambda found: maker.row([1e-3 * float(word) for word in found[0].split()]),
        path.read_text(),
    )
    path.write_text(text)
    with pytest.raises(
        FormatError, match=r"differ from the slope of the positions by .* velocities relative"
    ):
        read_product(path)


def test_a_year_before_satellites_does_not_refuse_an_earth_fixed_file(tmp_path):
    product = read_product(maker.dimap2(tmp_path, changes=[("2012-12-07", "1959-12-07")]))
    assert product.epoch.startswith("1959-12-07T10:20:28.0801")
    assert left(product, product.height).max() < 0.02


def test_records_that_end_a_little_early_are_continued_and_that_is_said(tmp_path):
    # three steps of 32 ms fewer: 58 ms, 1.8 steps, remain open; four fewer leave 2.8
    rows = 265
    product = read_product(maker.dimap2(tmp_path, rows=rows))
    assert any("attitude ends" in line and "continued evenly" in line for line in product.model.doubts)
    with pytest.raises(FormatError, match=r"attitude ends .*; 2 steps are continued"):
        read_product(maker.dimap2(tmp_path, rows=rows + 60))


def test_vertices_beyond_the_image_are_not_used(tmp_path):
    product = read_product(maker.dimap2(tmp_path, changes=[("<ROW>60<", "<ROW>600<")]))
    assert len(product.marks) == 3
    assert any("2 places of the file lie" in line for line in product.unknown)
