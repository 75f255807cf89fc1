"""PHRDIMAP: the model against the rational functions that the file itself gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import maker_files as maker
from sightline.errors import FormatError
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.pleiades import pleiades_orbit
from sightline.io.formats.products.recognise import read_product
from sightline.io.formats.products.tree import read_xml

FILE = "PHRDIMAP_P1BP--2017030824934340CP.XML"


@pytest.fixture(scope="module")
def pleiades(real_data):
    """The file, what is read of it, its elements."""
    path = real_data("vendor_models") / FILE
    return path, read_product(path), read_xml(path, "metadata")


def rational(data, name, coordinates, scales, out):
    """A function of the file at coordinates (N, 3) in its own order and counts."""

    def of(key):
        return tuple(
            data.number(f"Geoposition/Rational_Sensor_Model/Global_RFM/RFM_Validity/{key}/{c}") for c in "AB"
        )

    l, p, h = (  # noqa: E741
        (x - of(key)[1]) / of(key)[0] for x, key in zip(np.asarray(coordinates).T, scales, strict=True)
    )
    terms = [1 + 0 * l, l, p, h, l * p, l * h, p * h, l**2, p**2, h**2, l * p * h, l**3, l * p**2, l * h**2,
             l**2 * p, p**3, p * h**2, l**2 * h, p**2 * h, h**3]  # fmt: skip
    c = data.numbers(f"Geoposition/Rational_Sensor_Model/Global_RFM/{name}", 40)
    return (c[:20] @ terms) / (c[20:] @ terms) * of(out)[0] + of(out)[1]


@pytest.fixture(scope="module")
def lattice(pleiades):
    """Pixels, and the places (degrees, m) that the model sees there at five heights."""
    camera = pleiades[1].model.camera
    lines, columns = np.meshgrid(np.linspace(0, 49825, 9), np.linspace(0, 39950, 9))
    pixels = np.stack([lines.ravel(), columns.ravel()], axis=1)
    seen = [maker.geodetic(camera.locate(pixels, Ellipsoid(height=h))) for h in (160, 180, 200, 220, 240)]
    return np.tile(pixels, (5, 1)), np.vstack(seen)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_model_meets_the_makers_inverse_functions(pleiades, lattice):
    data, (pixels, places) = pleiades[2], lattice
    for name, out, k in (("F_ROW", "Row", 0), ("F_COL", "Col", 1)):
        found = rational(data, f"Inverse_Model/{name}", places, ("Lon", "Lat", "Alt"), out) - 1.0
        assert rms(found - pixels[:, k]) < 0.01
        assert rms(found - pixels[:, k] - 0.5) > 0.4  # half a line or column


def test_the_model_meets_the_makers_direct_functions(pleiades, lattice):
    data, (pixels, places) = pleiades[2], lattice
    asked = np.column_stack([pixels[:, 1] + 1.0, pixels[:, 0] + 1.0, places[:, 2]])
    lon = rational(data, "Direct_Model/F_LON", asked, ("Col", "Row", "Alt"), "Lon")
    lat = rational(data, "Direct_Model/F_LAT", asked, ("Col", "Row", "Alt"), "Lat")
    east = np.radians(lon - places[:, 0]) * 6.38e6 * np.cos(np.radians(lat))
    # .0031 m of the sheet, plus what MODEL_PRECISION leaves open
    assert np.hypot(rms(east), rms(np.radians(lat - places[:, 1]) * 6.36e6)) < 0.004


def test_the_rational_functions_are_handed_on_as_they_are(pleiades, lattice):
    pixels, places = lattice
    assert np.sqrt(np.mean((pleiades[1].rpc.project(places) - pixels) ** 2, axis=0)).max() < 0.01


def test_velocities_are_relative_to_the_stars(pleiades):
    data = pleiades[2]
    start = "2017-03-08T06:55:34.340029Z"
    orbit = pleiades_orbit(data, start)
    slope = CubicSpline(orbit.t, orbit.position).derivative()(orbit.t)[3:-3]
    # natural ends die off by a factor of 4 a row
    assert np.abs(slope - orbit.velocity[3:-3]).max() < 0.1
    few = type(orbit)(orbit.t[2:7:2], orbit.position[2:7:2], orbit.velocity[2:7:2])
    t = np.array([orbit.t[3], orbit.t[5]])
    # every second row, so that velocities take part: degree 5 over 60 s
    assert np.linalg.norm(few.positions(t) - orbit.position[[3, 5]], axis=1).max() < 0.1
    wrong = type(few)(few.t, few.position, few.velocity + np.cross([0.0, 0.0, maker.EARTH], few.position))
    assert np.linalg.norm(wrong.positions(t) - orbit.position[[3, 5]], axis=1).min() > 700.0


def test_velocities_of_the_other_kind_are_refused(tmp_path, monkeypatch):
    maker_orbit = maker.orbit
    monkeypatch.setattr(maker, "orbit", lambda t: (*maker_orbit(t)[:2], maker_orbit(t)[1]))
    with pytest.raises(
        FormatError, match=r"differ from the slope of the positions by .* inertial velocities"
    ):
        read_product(maker.pleiades(tmp_path))


def test_a_written_product_sees_what_it_was_made_from(tmp_path):
    product = read_product(maker.pleiades(tmp_path))
    pixels = np.array([[0.0, 0.0], [69.0, 59.0], [35.0, 10.0]])
    place, *_ = maker.orbit(pixels[:, 0] * 0.0735e-3)
    view = np.stack(
        [8e-5 + 0 * pixels[:, 1], 0.01422 - 7.11e-7 * pixels[:, 1], 1.0 + 0 * pixels[:, 1]], axis=1
    )
    looks = np.einsum("nij,nj->ni", maker.attitude(pixels[:, 0] * 0.0735e-3), view)
    seen = product.model.camera.locate(pixels, Ellipsoid(height=180.0))
    # a cubic through .1 s of .004 rad at 1.3 rad/s leaves 1e-9 rad
    assert np.linalg.norm(seen - maker.ground(place, looks, 180.0), axis=1).max() < 0.01
    assert "virtual line" in product.model.one_grid.reason


def test_few_positions_are_helped_by_velocities(tmp_path):
    few = read_product(maker.pleiades(tmp_path, points=4)).model.camera
    many = read_product(maker.pleiades(tmp_path, name="MANY.XML")).model.camera
    apart = few.trajectory.at([0.0]).position - many.trajectory.at([0.0]).position
    assert np.linalg.norm(apart) < 0.01


REFUSED = {
    "no model": ([("Sensor_Model_Characteristics", "Other")], "Sensor_Model_Characteristics is missing"),
    "a unit": ([('unit="m/s"', 'unit="kn"')], "is in 'kn'; units that are read: m/s, km/s"),
    "positions in another unit": ([('unit="m"', 'unit="km"')], r"holds a place 7\.07e\+09 m from"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_named(tmp_path, case):
    changes, words = REFUSED[case]
    path = maker.pleiades(tmp_path, changes=changes)
    with pytest.raises(FormatError, match=words):
        read_product(path)
