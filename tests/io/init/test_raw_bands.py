"""Raw bands of Pleiades: lags by a product's metadata, or by the preset."""

from __future__ import annotations

import contextlib
import io
import tomllib
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


def seconds(text, start):
    """Between two instants of one minute."""
    return float(text.rstrip("Z").split(":")[-1]) - float(start.rstrip("Z").split(":")[-1])


class Scene:
    """A real product by the facts of its format, read without the package: where and when row 1 lies."""

    def __init__(self, path):
        root = ElementTree.parse(path).getroot()
        model = root.find("Geometric_Data/Sensor_Model_Characteristics")
        self.start = model.findtext("UTC_Sensor_Model_Range/START")
        self.begun = {
            band.findtext("BAND_ID"): seconds(band.findtext("Array_TS_List/Array_TS/ORIGIN_TIME"), self.start)
            for band in root.iter("Band_TS")
        }
        points = model.findall("Sensor_Ephemeris/Point_List/Point")
        minute = int(self.start[14:16])
        self.t = np.array([
            60.0 * (int((at := point.findtext("UTC_TIME"))[14:16]) - minute) + seconds(at, self.start)
            for point in points
        ])  # fmt: skip
        self.places = np.array([point.findtext("LOCATION_VALUES").split() for point in points], float)
        turn = model.find("Sensor_Attitudes")
        hour, minute, second = (float(part) for part in self.start[11:-1].split(":"))
        of_day = 3600.0 * hour + 60.0 * minute + second
        self.begin, self.scale = of_day - float(turn.findtext("OFFSET")), float(turn.findtext("SCALE"))
        self.q = [
            np.array(turn.findtext(f"Polynomial_Models/Q{k}/COEFFICIENTS").split(), float)
            for k in (1, 2, 3, 0)
        ]
        psi = [
            np.array(
                model.findtext(
                    f"Sensor_Viewing_Model/Viewing_Directions/Psi{axis}_Model/COEFFICIENTS"
                ).split(),
                float,
            )
            for axis in "XY"
        ]
        middle = (int(root.findtext("Raster_Dimensions/NCOLS")) - 1) / 2.0
        across, along = (np.polynomial.polynomial.polyval(middle, one) for one in psi)
        self.middle = np.array([along, -across, 1.0])
        self.height = float(root.findtext("Geoposition/Rational_Sensor_Model/Global_RFM/RFM_Validity/Alt/B"))

    def look(self, t):
        """Of the middle of the line that is exposed at an instant."""
        x = (self.begin + t) / self.scale
        q = [np.polynomial.polynomial.polyval(x, one) for one in self.q]
        return Rotation.from_quat(q).apply(self.middle)

    def place(self, t):
        """Lagrange's polynomial through the eight points about an instant."""
        k = np.argsort(np.abs(self.t - t))[:8]
        weights = [np.prod([(t - self.t[j]) / (self.t[i] - self.t[j]) for j in k if j != i]) for i in k]
        return np.array(weights) @ self.places[k]

    def ground(self, t=0.0):
        """What the middle of the product's line sees at the height of its rational functions."""
        axes = np.array([6378137.0, 6378137.0, 6356752.3142]) + self.height
        look, place = self.look(t), self.place(t)
        u, o = look / axes, place / axes
        a, b, c = u @ u, u @ o, o @ o - 1.0
        return place - (b + np.sqrt(b * b - a * c)) / a * look


def test_bands_of_a_real_product_see_its_first_row_when_the_file_says(real_data, images):
    path = real_data("vendor_models") / "PHRDIMAP_P1BP--2017030824934340CP.XML"
    shapes = {name: (160, 120) for name in ("B0", "B1", "B2", "B3")}
    rng = np.random.default_rng(9)
    for name, shape in shapes.items():
        np.save(images / f"raw_{name}.npy", rng.integers(100, 3000, shape).astype(np.uint16))
    names = ("PA", *shapes)
    bands = [images / f"raw_{name}.npy" for name in names]
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 0, said
    assert "off those published" in said
    scene = Scene(path)
    file = tomllib.loads((images / "acq" / "acquisition.toml").read_text())
    begun = {band["name"]: band["first_line_time"] for band in file["band"]}
    # 15.8 ms before the model's first line, written to .1 us
    assert scene.begun["PA"] == pytest.approx(-0.0158155, abs=1e-7)
    assert begun == pytest.approx(scene.begun, abs=1e-6)
    # angle by which the line's middle moves over the ground: the satellite turns, scanning across its flight
    ground, here = scene.ground(), scene.place(0.0)
    speed = (scene.ground(0.1) - scene.ground(-0.1)) / 0.2
    to = (ground - here) / np.linalg.norm(ground - here)
    sweep = np.linalg.norm(speed - (speed @ to) * to) / np.linalg.norm(ground - here)
    acquired = load_acquisition(images / "acq" / "acquisition.toml")
    for band, camera in zip(file["band"], acquired.cameras, strict=True):
        wide = 1 if band["name"] == "PA" else 4
        # the attitude list is 1.3 urad (1-sigma) off the polynomial that is the model: four of these, and
        # the chord of the line's ends beside its middle; 15.8 ms are 150 pixels
        middle = (camera.shape[1] - 1) / 2.0
        np.testing.assert_allclose(camera.project(ground[None]), [[0.0, middle]], atol=5.0 / wide + 0.5)
        # the sweep changes by some hundredths over a lag
        assert -band["look_ahead"] == pytest.approx(sweep * begun[band["name"]], rel=0.05)


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
    long = np.arange(100_000 * 32).reshape(-1, 32).astype(np.uint16)
    np.save(images / "long_PA.npy", long)
    np.save(images / "long_B0.npy", long[::4, ::4])
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


def changed(path, band, **values):
    """Elements of one band's first array in a written product."""
    text = path.read_text()
    at = text.index(f"<BAND_ID>{band}</BAND_ID>", text.index("<Band_TS_List>"))
    head, rest = text[:at], text[at:]
    for name, value in values.items():
        begin = rest.index(f"<{name}>") + len(name) + 2
        rest = rest[:begin] + str(value) + rest[rest.index("<", begin) :]
    path.write_text(head + rest)
    return path


def stamped(lag):
    return maker.stamp(lag, 7) + "Z"


def test_origins_of_other_lines_than_the_first_are_counted_back(images):
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    times = []
    for number, lines in enumerate((0, 640)):
        path = maker.pleiades(images, name=f"PHRDIMAP_{number}.XML")
        # the same moments, told of a line 640 x .1034 ms later
        changed(path, "B2", ORIGIN_TIME=stamped(0.1723 + 0.1034e-3 * lines), ORIGIN_FULL_RES_LINE=1 + lines)
        changed(path, "PA", ORIGIN_TIME=stamped(-0.01 + 0.1034e-3 * lines), ORIGIN_FULL_RES_LINE=1 + lines)
        status, said = said_by("init", path, *bands, "--out", images / f"{number}")
        assert status == 0, said
        file = tomllib.loads((images / f"{number}" / "acquisition.toml").read_text())
        times.append([band["first_line_time"] for band in file["band"]])
    np.testing.assert_allclose(times, [[-0.01, 0.1591, 0.1723]] * 2, atol=3e-7)


@pytest.mark.parametrize(
    ("band", "lag", "said"),
    [
        ("B0", 0.0, "PA and B0 see the ground 0 ms after one another, less than a line (0.414 ms)"),
        ("B2", 0.1591, "B0 and B2 see the ground 0 ms after one another"),
        ("B2", 1.723, "B2 sees the ground 1723 ms after the first band; published are 172.3 ms"),
        ("B2", 0.01723, "B2 sees the ground 17.23 ms after the first band"),
        ("B2", -0.1723, "bands see the ground on both sides of the first one (B0 159.1 ms, B2 -172.3 ms)"),
    ],
)
def test_lags_that_cannot_be_are_refused(images, band, lag, said):
    path = changed(maker.pleiades(images), band, ORIGIN_TIME=stamped(lag))
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    status, words = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 2 and said in words
    assert not (images / "acq").exists()


def test_times_that_are_not_those_of_the_product_are_refused(images):
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    path = maker.pleiades(images)
    whole = path.read_text()
    path.write_text(
        whole.replace("<Band_TS_List>", "<ORIGIN_REFERENTIAL>SEGMENT</ORIGIN_REFERENTIAL><Band_TS_List>")
    )
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 2 and "ORIGIN_REFERENTIAL is SEGMENT" in said
    path.write_text(whole)
    for band, lag in maker.LAGS.items():
        changed(path, band, ORIGIN_TIME=stamped(lag + 20.0))
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 2 and "20 s after the model's first line" in said
    path.write_text(whole.replace("<BAND_ID>B2</BAND_ID>", "<BAND_ID>B0</BAND_ID>"))
    status, said = said_by("init", path, *bands[:2], "--out", images / "acq")
    assert status == 2 and "its Band_TS_List holds B0 twice" in said
    path.write_text(whole)
    begin = whole.index("<Array_TS>", whole.index("<BAND_ID>B0</BAND_ID>", whole.index("<Band_TS_List>")))
    array = whole[begin : whole.index("</Array_TS>", begin) + len("</Array_TS>")]
    other = array.replace(stamped(maker.LAGS["B0"]), stamped(maker.LAGS["B0"] + 0.007))
    path.write_text(whole[:begin] + other + whole[begin:])
    status, said = said_by("init", path, *bands, "--out", images / "acq")
    assert status == 2 and "its arrays see row 1 at unlike times: B0 (7 ms)" in said


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.arange(120.0)[None], "has 1 lines x 120 columns; 8 or more of each"),
        (np.full((160, 120), np.nan, np.float32), "holds no pixel that is a number"),
        (np.zeros((160, 120), np.uint16), "holds 0 in every pixel"),
    ],
)
@pytest.mark.parametrize("by", ["product", "preset"])
def test_bands_that_hold_nothing_are_refused(images, pixels, said, by):
    np.save(images / "raw_B2.npy", pixels)
    given = [maker.pleiades(images)] if by == "product" else ["--preset", "pleiades"]
    bands = [images / f"raw_{name}.npy" for name in ("PA", "B0", "B2")]
    status, words = said_by("init", *given, *bands, "--out", images / "acq")
    assert status == 2 and said in words and "raw_B2.npy" in words
