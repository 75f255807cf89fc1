"""WorldView and QuickBird, level 1B: scenes that the tests write, and real metadata against its own maker."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.product_files import WorldViewScene, attitude, orbit

from sightline.errors import FormatError
from sightline.geometry.apparent import APPARENT, bent_camera
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.recognise import read_product
from sightline.io.init.agreement import mark_residuals, rpc_residuals

WGS84 = 6378137.0, 6356752.314245179
#: QuickBird's camera as published in 2003.
QUICKBIRD_GEO = """
BEGIN_GROUP = PRINCIPAL_DISTANCE
PD = 8836.202;
END_GROUP = PRINCIPAL_DISTANCE
BEGIN_GROUP = OPTICAL_DISTORTION
polyOrder = 0;
aList = (0.0);
bList = (0.0);
END_GROUP = OPTICAL_DISTORTION
BEGIN_GROUP = PERSPECTIVE_CENTER
CX = 0.0;
CY = 0.0;
CZ = 0.0;
END_GROUP = PERSPECTIVE_CENTER
BEGIN_GROUP = CAMERA_ATTITUDE
qcs1 = -0.0037369299279122;
qcs2 = -0.0046602381421084;
qcs3 = 0.0017171366422757;
qcs4 = 0.9999806843019142;
END_GROUP = CAMERA_ATTITUDE
BEGIN_GROUP = DETECTOR_MOUNTING
BEGIN_GROUP = BAND_P
BEGIN_GROUP = DETECTOR_ARRAY_1
detArrayId = 1;
detOriginX = 9.54684;
detOriginY = 164.02773;
detRotAngle = 0.0;
detPitch = 0.01191396;
END_GROUP = DETECTOR_ARRAY_1
END_GROUP = BAND_P
END_GROUP = DETECTOR_MOUNTING
END;
"""


@pytest.fixture(scope="module")
def files(real_data):
    return real_data("vendor_models")


@pytest.fixture(scope="module")
def products(files):
    return {name: read_product(files / f"{name}.xml") for name in ("dg_example1", "wv_test1")}


@pytest.fixture(scope="module")
def quickbird(files, tmp_path_factory):
    folder = tmp_path_factory.mktemp("quickbird")
    for ending in ("IMD", "ATT", "EPH"):
        (found,) = files.glob(f"06JAN*.{ending}")
        (folder / found.name).write_bytes(found.read_bytes())
    (folder / f"{found.stem}.GEO").write_text(QUICKBIRD_GEO)
    return read_product(folder)


def geodetic(points):
    """Longitude, latitude (degrees), height (m) by Bowring's formula, iterated."""
    x, y, z = points.T
    a, b = WGS84
    e2, p = 1.0 - (b / a) ** 2, np.hypot(points[:, 0], points[:, 1])
    lat = np.arctan2(z, p * (1.0 - e2))
    for _ in range(6):
        n = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
        height = p * np.cos(lat) + z * np.sin(lat) - a * a / n
        lat = np.arctan2(z + e2 * n * np.sin(lat), p)
    return np.degrees(np.arctan2(y, x)), np.degrees(lat), height


def rpc_of_text(path):
    """Ground to (line, sample) after RPC00B, from the text of the XML: no code shared with the reader."""
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<RPB>") :]

    def values(tag):
        return [float(word) for word in re.search(rf"<{tag}>([^<]*)</{tag}>", text)[1].split()]

    names = ("LINE", "SAMP", "LAT", "LONG", "HEIGHT")
    offset = {n: values(f"{n}OFFSET")[0] for n in names}
    scale = {n: values(f"{n}SCALE")[0] for n in names}
    c = {n: np.array(values(n)) for n in ("LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF")}

    def at(points):
        lon, lat, height = geodetic(points)
        L = (lon - offset["LONG"]) / scale["LONG"]
        P = (lat - offset["LAT"]) / scale["LAT"]
        H = (height - offset["HEIGHT"]) / scale["HEIGHT"]
        one = np.ones_like(L)
        m = np.array([
            one, L, P, H, L * P, L * H, P * H, L**2, P**2, H**2, P * L * H, L**3, L * P**2, L * H**2,
            L**2 * P, P**3, P * H**2, L**2 * H, P**2 * H, H**3,
        ])  # fmt: skip
        line, sample = ((c[f"{n}NUMCOEF"] @ m) / (c[f"{n}DENCOEF"] @ m) for n in ("LINE", "SAMP"))
        return np.column_stack(
            [line * scale["LINE"] + offset["LINE"], sample * scale["SAMP"] + offset["SAMP"]]
        )

    heights = offset["HEIGHT"] + scale["HEIGHT"] * np.linspace(-1.0, 1.0, 5)
    return at, heights


def off_rpc(product, path, keys=APPARENT, *, lines=0.0, height_of_air=None):
    """rms px between the model and the maker's RPC over 9 x 9 pixels and 5 heights."""
    at, heights = rpc_of_text(path)
    camera = product.model.camera
    grid = np.meshgrid(*(np.linspace(0.0, n - 1.0, 9) for n in camera.shape), indexing="ij")
    pixels, apart = np.stack(grid, axis=-1).reshape(-1, 2), []
    if lines:
        camera = replace(camera, first_line_time=camera.first_line_time + lines * camera.detector.line_period)
    for height in heights:
        bent = bent_camera(camera, height if height_of_air is None else height_of_air, keys)
        points = bent.locate(pixels, Ellipsoid(*WGS84, height))
        apart.append(at(points) - pixels)
    return float(np.sqrt((np.concatenate(apart) ** 2).sum(axis=1).mean()))


class TestRealMetadata:
    # measured on these files; half a line, and refraction, are well above
    @pytest.mark.parametrize(("name", "most"), [("wv_test1", 0.2), ("dg_example1", 0.3)])
    def test_the_model_agrees_with_its_makers_rational_polynomials(self, name, most, products, files):
        assert off_rpc(products[name], files / f"{name}.xml") <= most

    @pytest.mark.parametrize(("name", "most"), [("wv_test1", 0.2), ("dg_example1", 0.3)])
    def test_it_does_not_without_refraction_aberration_or_with_half_a_line(self, name, most, products, files):
        product, path = products[name], files / f"{name}.xml"
        assert off_rpc(product, path, ("aberration", "light_time")) > 4.0 * most
        assert off_rpc(product, path, ()) > 50.0 * most
        for lines in (0.5, -0.5):
            assert off_rpc(product, path, lines=lines) > 1.5 * most
        # inertial velocity in place of v + w x (S - P): aberration without light time
        assert off_rpc(product, path, ("aberration", "refraction")) > 2.0 * most

    def test_air_counts_from_the_height_of_each_ground_point(self, products, files):
        """The air of one height 500 m off is .16 px; below sea level in place of 3.2 km .4 px and more."""
        product, path = products["wv_test1"], files / "wv_test1.xml"
        assert off_rpc(product, path, height_of_air=0.0) > 0.25

    def test_the_tables_of_init_say_the_same(self, products, files):
        for name, product in products.items():
            ours = np.sqrt((rpc_residuals(product) ** 2).sum(axis=1).mean())
            assert ours == pytest.approx(off_rpc(product, files / f"{name}.xml"), abs=2e-3)

    def test_corners_are_where_the_maker_has_them(self, products, quickbird):
        # files give 1e-8 degrees (1 mm) and .01 m of height
        assert mark_residuals(products["wv_test1"]).max() <= 0.05
        assert mark_residuals(quickbird).max() <= 0.05

    def test_corners_without_heights_are_met_by_a_height_of_their_own(self, products):
        product = products["wv_test1"]
        level = replace(product, marks=tuple(replace(mark, height=None) for mark in product.marks))
        assert mark_residuals(level).max() <= 0.05

    def test_padded_sizes_and_invented_years_are_read(self, products):
        product = products["wv_test1"]
        assert product.model.camera.shape == (21756, 35180) and product.model.padded == (22528, 35840)
        assert any("padded to 22528 x 35840" in said for said in product.assumed)
        assert products["dg_example1"].epoch.startswith("1959-11-25T17:39:48.740958")

    def test_errors_of_attitudes_are_those_of_the_maker(self, products, quickbird):
        assert quickbird.attitude_sigma == pytest.approx(24.2e-6, rel=0.01)
        assert 5e-6 < products["dg_example1"].attitude_sigma < 29e-6
        assert 5e-6 < products["wv_test1"].attitude_sigma < 29e-6

    def test_quickbird_without_its_geo_asks_for_it_by_name(self, files):
        (imd,) = files.glob("06JAN*.IMD")
        with pytest.raises(FormatError, match=f"{imd.stem}.GEO is missing"):
            read_product(imd)

    def test_records_far_from_the_image_change_nothing(self, files, tmp_path):
        """They jump by some urad beyond; 40 records stand beside the image on either side."""
        text = (files / "wv_test1.xml").read_text(encoding="utf-8")
        rows = re.findall(r"<ATTLIST>([^<]*)</ATTLIST>", text)
        spoilt = text
        for row in (rows[100], rows[1000]):
            words = row.split()
            spoilt = spoilt.replace(row, " ".join([words[0], "0.5 0.5 0.5 0.5", *words[5:]]))
        (tmp_path / "spoilt.xml").write_text(spoilt)
        pixels = [[0.0, 0.0], [21755.0, 35179.0]]
        given, other = (
            read_product(path).model.camera.rays(pixels)
            for path in (files / "wv_test1.xml", tmp_path / "spoilt.xml")
        )
        np.testing.assert_array_equal(given.directions, other.directions)


class TestWrittenScenes:
    @pytest.mark.parametrize("form", ["xml", "text"])
    def test_rays_are_those_of_the_scene(self, form, tmp_path):
        scene = WorldViewScene()
        product = read_product(getattr(scene, form)(tmp_path))
        for line, column in ((0.0, 0.0), (319.0, 199.0), (100.0, 57.0)):
            rays = product.model.camera.rays([[line, column]])
            origin, look = scene.ray(line, column)
            np.testing.assert_allclose(rays.origins[0], origin, atol=1e-5)
            np.testing.assert_allclose(rays.directions[0], look / np.linalg.norm(look), atol=1e-10)
        assert product.attitude_sigma == pytest.approx(20e-6)
        assert product.model.doubts == () and product.bands[0].image == "scene.TIF"

    def test_a_list_of_one_time_goes_by_the_line_rate(self, tmp_path):
        scene = WorldViewScene(tlc=[(500.0, 0.5)])
        product = read_product(scene.xml(tmp_path))
        np.testing.assert_allclose(product.model.camera.times([0.0, 100.0]), [0.0, 0.1], atol=1e-12)
        assert product.epoch == "2013-05-08T00:03:30.500000000Z"

    def test_a_list_that_ends_early_goes_on_with_its_slope(self, tmp_path):
        product = read_product(WorldViewScene(tlc=[(10.0, 0.01), (150.0, 0.15)]).xml(tmp_path))
        np.testing.assert_allclose(product.model.camera.times([0.0, 319.0]), [0.0, 0.319], atol=1e-9)

    @pytest.mark.parametrize("year", ["1721", "1959", "2750"])
    def test_no_date_is_refused(self, year, tmp_path):
        scene = WorldViewScene(start=f"{year}-05-08T00:03:30.500000")
        read_product(scene.xml(tmp_path))

    def test_windows_paths_name_the_file(self, tmp_path):
        product = read_product(WorldViewScene(image="C:\\data\\order 7\\scene.NTF").xml(tmp_path))
        assert product.bands[0].image == "scene.NTF"

    def test_a_jump_is_never_interpolated_across(self, tmp_path):
        """Records after .1 s stand 5 urad off: lines just before and after keep to their own side."""
        scene = WorldViewScene()
        plain = read_product(scene.xml(tmp_path)).model.camera
        t, *_, quaternions = scene.records()
        late = t > 0.1001
        turned = Rotation.from_quat(quaternions[late]) * Rotation.from_rotvec([0.0, 5e-6, 0.0])
        quaternions[late] = turned.as_quat()
        rows = [
            (*row[:1], *q, *row[5:])
            for row, q in zip(scene.parts()["ATT"]["ATTLIST"], quaternions, strict=True)
        ]
        product = read_product(replace(scene, more={"ATT/ATTLIST": rows}).xml(tmp_path))
        assert "jumps at 0.12 s after TLCTIME, within the image" in product.model.doubts[0]
        lines = np.array([90.0, 104.0, 116.0, 140.0])
        pixels = np.column_stack([lines, np.full(4, 100.0)])
        apart = np.linalg.norm(
            product.model.camera.rays(pixels).directions - plain.rays(pixels).directions, axis=1
        )
        np.testing.assert_allclose(apart, [0.0, 0.0, 5e-6, 5e-6], atol=1e-8)

    def test_records_that_end_a_little_early_are_continued_and_named(self, tmp_path):
        scene = WorldViewScene()
        content = scene.parts()["ATT"]["ATTLIST"]
        last = sum(row[0] * 0.02 - 1.02 < 0.30 for row in content)
        more = {"ATT/ATTLIST": content[:last], "ATT/NUMPOINTS": last}
        product = read_product(replace(scene, more=more).xml(tmp_path))
        assert "before the last line" in product.model.doubts[0]
        _, look = scene.ray(319.0, 100.0)
        direction = product.model.camera.rays([[319.0, 100.0]]).directions[0]
        np.testing.assert_allclose(direction, look / np.linalg.norm(look), atol=1e-9)


_WRONG = {
    "isd/GEO is missing": {"GEO": None},
    "isd/ATT is missing": {"ATT": None},
    "PRINCIPAL_DISTANCE/PD is 0, not above 0": {"GEO/PRINCIPAL_DISTANCE/PD": 0.0},
    "holds a distortion": {"GEO/OPTICAL_DISTORTION/ALIST": [(0.0, 1e-3)]},
    "no camera's pixel; both are in mm": {"GEO/PRINCIPAL_DISTANCE/PD": 8.0},
    r"holds \d+ records, not the NUMPOINTS 900: is the file cut short": {"EPH/NUMPOINTS": 900},
    "AVGLINERATE is 1, TLCLIST has 1000 lines a second": {"IMD/IMAGE/AVGLINERATE": 1.0},
    "holds 2 entries, not the NUMTLC 3: is it cut short": {"IMD/IMAGE/NUMTLC": 3},
    "TLCTIME: '8 May' is not a UTC instant": {"IMD/IMAGE/TLCTIME": "8 May"},
    "NUMROWS is 'many', no number": {"IMD/NUMROWS": "many", "TIL": None},
    "is a map-projected product": {"IMD/MAP_PROJECTED_PRODUCT": {"MAPPROJNAME": "UTM"}},
    "begins .* steps of 0.02 s": {"ATT/STARTTIME": "2013-05-08T00:03:31.000000Z"},
}


@pytest.mark.parametrize("said", _WRONG)
def test_what_is_wrong_is_named(said, tmp_path):
    with pytest.raises(FormatError, match=said):
        read_product(WorldViewScene(more=_WRONG[said]).xml(tmp_path))


def test_units_and_covariances_that_cannot_be_are_named(tmp_path):
    scene = WorldViewScene()
    content = scene.parts()
    places = [(row[0], *np.array(row[1:4]) / 1e3, *row[4:]) for row in content["EPH"]["EPHEMLIST"]]
    with pytest.raises(FormatError, match="m, Earth-fixed, are expected"):
        read_product(replace(scene, more={"EPH/EPHEMLIST": places}).xml(tmp_path))
    negative = [(*row[:5], *(-np.array(row[5:]))) for row in content["ATT"]["ATTLIST"]]
    with pytest.raises(FormatError, match="a covariance that is not positive about the body's axes"):
        read_product(replace(scene, more={"ATT/ATTLIST": negative}).xml(tmp_path))
    quaternions = [(row[0], *np.degrees(row[1:5]), *row[5:]) for row in content["ATT"]["ATTLIST"]]
    with pytest.raises(FormatError, match=r"a quaternion of length 57\.29"):
        read_product(replace(scene, more={"ATT/ATTLIST": quaternions}).xml(tmp_path))


def test_inertial_velocities_are_not_used_and_named(tmp_path):
    scene = WorldViewScene()
    rows = []
    for row in scene.parts()["EPH"]["EPHEMLIST"]:
        place = np.array(row[1:4])
        rows.append((*row[:4], *(np.array(row[4:7]) + np.cross([0, 0, 7.292115e-5], place)), *row[7:]))
    plain, product = (
        read_product(each.xml(tmp_path)) for each in (scene, replace(scene, more={"EPH/EPHEMLIST": rows}))
    )
    assert "m/s off the rates of its places; they are not used" in product.model.doubts[0]
    pixels = [[10.0, 10.0]]
    np.testing.assert_array_equal(
        plain.model.camera.rays(pixels).origins, product.model.camera.rays(pixels).origins
    )
    np.testing.assert_allclose(orbit(0.01)[0], product.model.camera.rays(pixels).origins, atol=1e-4)


def test_bands_with_detector_lines_of_their_own_have_cameras_of_their_own(tmp_path):
    """The second looks 20 px ahead: it is no band of one virtual line, and holds motion against the first."""
    scene = WorldViewScene(bands=("B", "R"))
    array = scene.parts()["GEO"]["DETECTOR_MOUNTING"]["BAND_B"]["DETECTOR_ARRAY"]
    ahead = {"DETECTOR_ARRAY": {**array, "DETORIGINX": array["DETORIGINX"] + 20 * scene.pitch}}
    path = replace(scene, more={"GEO/DETECTOR_MOUNTING/BAND_R": ahead}).xml(tmp_path)
    first, second = (read_product(path, band=number).model for number in (1, 2))
    assert first.one_grid is None and second.one_grid is None
    origin = np.array(
        [scene.origin[0] + 20 * scene.pitch, scene.origin[1] - 57 * scene.pitch, scene.distance]
    )
    look = attitude(0.1)[0].apply(origin)
    for model, expected in ((first, scene.ray(100.0, 57.0)[1]), (second, look)):
        direction = model.camera.rays([[100.0, 57.0]]).directions[0]
        np.testing.assert_allclose(direction, expected / np.linalg.norm(expected), atol=1e-10)
    other = replace(scene, more={"GEO/DETECTOR_MOUNTING/BAND_MS2": ahead}).xml(tmp_path, "other.XML")
    assert read_product(other, band=2).model.one_grid is None
    unnamed = {"GEO/DETECTOR_MOUNTING": {"BAND_MS1": {"DETECTOR_ARRAY": array}, "BAND_MS2": ahead}}
    with pytest.raises(
        FormatError, match=r"2 unlike detector arrays .of MS1, MS2, the image's bands are B, R"
    ):
        read_product(replace(scene, more=unnamed).xml(tmp_path, "unnamed.XML"))


def test_tiles_of_one_image_are_told(tmp_path):
    tiles = "".join(
        f"<TILE><FILENAME>R1C{k + 1}.TIF</FILENAME><ULROWOFFSET>0</ULROWOFFSET><ULCOLOFFSET>{128 * k}"
        "</ULCOLOFFSET><LRROWOFFSET>319</LRROWOFFSET>"
        f"<LRCOLOFFSET>{min(128 * k + 127, 199)}</LRCOLOFFSET></TILE>"
        for k in range(2)
    )
    path = WorldViewScene().xml(tmp_path)
    text = path.read_text().replace('encoding="UTF-8"', 'encoding="UTF-16"')
    begin, end = text.index("<TIL>"), text.index("</TIL>")
    path.write_text(f"{text[:begin]}<TIL><NUMTILES>2</NUMTILES>{tiles}{text[end:]}", encoding="utf-16")
    pixels = read_product(path).pixels
    assert [(tile.image, tile.column, tile.columns) for tile in pixels.tiles] == [
        ("R1C1.TIF", 0, 128),
        ("R1C2.TIF", 128, 72),
    ]


class TestFiles:
    def test_truncated_xml_and_entities_are_refused(self, tmp_path):
        path = WorldViewScene().xml(tmp_path)
        text = path.read_text()
        path.write_text(text[: len(text) // 2])
        with pytest.raises(FormatError, match=r"no complete XML .*cut short"):
            read_product(path)
        path.write_text(text.replace("<isd>", '<!DOCTYPE isd [<!ENTITY a "b">]><isd>', 1))
        with pytest.raises(FormatError, match="declares entities"):
            read_product(path)

    def test_truncated_text_is_refused(self, tmp_path):
        path = WorldViewScene().text(tmp_path)
        att = tmp_path / "scene.ATT"
        att.write_text(att.read_text()[:-200])
        with pytest.raises(FormatError, match="cut short"):
            read_product(path)

    @pytest.mark.parametrize(("begin", "kind"), [(b"PK\x03\x04", "zip"), (b"\x1f\x8b", "gzip")])
    def test_packed_products_are_to_be_unpacked(self, begin, kind, tmp_path):
        (tmp_path / "scene.zip").write_bytes(begin + b"<isd>")
        with pytest.raises(FormatError, match=rf"is packed \({kind}\); unpack it"):
            read_product(tmp_path / "scene.zip")

    def test_a_folder_holds_one_product(self, tmp_path):
        with pytest.raises(FormatError, match="one product is expected, it holds none"):
            read_product(tmp_path)
        WorldViewScene().xml(tmp_path, "scene.XML")
        WorldViewScene().text(tmp_path, "scene")
        assert read_product(tmp_path).path.name == "scene.XML"
        WorldViewScene().xml(tmp_path, "other.XML")
        with pytest.raises(FormatError, match=r"it holds other.XML, scene.XML; name the file itself"):
            read_product(tmp_path)
