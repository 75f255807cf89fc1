"""Gyros of a product as a table of increments: what they must show, and what they must not invent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import maker_files as maker
from sightline.io.formats.products.pleiades_telemetry import read_pleiades_telemetry
from sightline.io.formats.products.recognise import read_product
from sightline.io.formats.tables import read_attitudes, read_gyro
from sightline.io.init.telemetry import first_sensors


@pytest.fixture(scope="module")
def pleiades(real_data, tmp_path_factory):
    """The product, its sensors, and the gyros' table as it is read back."""
    product = read_product(real_data("vendor_models") / "PHRDIMAP_P1BP--2017030824934340CP.XML")
    folder, sensors = tmp_path_factory.mktemp("tables"), first_sensors(product)
    sensors.write(folder)
    return product, sensors, read_gyro(folder / "gyro.csv"), folder


def test_increments_add_up_to_the_motion_of_the_quaternions(pleiades):
    product, _, (start, end, angles, _), folder = pleiades
    t, quaternions = read_attitudes(folder / "attitudes.csv")
    read = read_pleiades_telemetry(product.path)
    np.testing.assert_allclose(t, read.t_earth)
    inside = (t > start[0]) & (t < end[-1])
    reference = product.model.camera.trajectory.at(t[inside]).world_from_body
    body = type(reference).from_quat(quaternions[inside])
    half = np.diag([-1.0, -1.0, 1.0])  # body axes of the model: columns go to +y, it flies to -x of the file
    motion = (reference.inv() * body * type(reference).from_matrix(half)).as_rotvec()
    gyros = CubicSpline(np.append(start, end[-1]), np.vstack([np.zeros(3), angles.cumsum(axis=0)]))(t[inside])
    apart = motion - gyros
    line = np.polynomial.polynomial.polyfit(t[inside], apart, 1)
    left = apart - np.polynomial.polynomial.polyval(t[inside], line).T
    # 1.4 urad of motion; what is left is the rounding of the quaternions to 1e-8
    assert motion.std(axis=0).max() > 0.5e-6
    assert left.std(axis=0).max() < 0.012e-6
    assert np.abs(line[1]).max() < 0.01e-6  # rad/s


def test_no_jitter_is_invented(pleiades):
    angles = pleiades[2][2].cumsum(axis=0)
    place = np.linspace(-1.0, 1.0, len(angles))
    slow = np.polynomial.chebyshev.chebval(place, np.polynomial.chebyshev.chebfit(place, angles, 8)).T
    window = np.hanning(len(angles))[:, None]
    power = 2 * np.abs(np.fft.rfft((angles - slow) * window, axis=0)) ** 2 / len(angles) / (window**2).sum()
    above = np.sqrt(power[np.fft.rfftfreq(len(angles), 1 / 32) > 4.0].sum(axis=0))
    # the body moves .02 to .04 urad there, .06 px: nothing for images to find
    assert above.max() < 0.05e-6


def test_what_is_stated_of_the_gyros(pleiades):
    _, sensors, (start, end, _, sigma), _ = pleiades
    np.testing.assert_allclose(end - start, 1 / 32, atol=1e-9)
    assert np.ptp(sigma) == 0.0
    assert (
        2.5e-8 < sigma[0] < 4.5e-8
    )  # 6.2e-7 rad/s at .125 s: 2.2e-7 sqrt(1/32), three quarters of the variance
    said = " ".join(sensors.assumed)
    assert "are fitted to its quaternions" in said
    assert "no sensor beside them" in said
    assert any("too short for its stability" in line for line in sensors.unknown)
    assert sensors.text.count("[[attitude_sensor]]") == 1  # the gyros: quaternions are no second sensor
    assert "star-tracker" not in sensors.text


def test_gyros_of_a_written_product_show_what_its_model_lacks(tmp_path):
    product = read_product(maker.pleiades(tmp_path, rows=20_000))
    sensors = first_sensors(product)
    table = {key: np.asarray(value) for key, value in sensors.tables["gyro.csv"].items()}
    t = np.append(table["t_start"], table["t_end"][-1])
    model = product.model.camera.trajectory.at(t).world_from_body
    truth = type(model).from_matrix(maker.attitude(t))
    lacks = (model.inv() * truth).as_rotvec()
    found = np.stack([table[name] for name in ("roll", "pitch", "yaw")], axis=1)
    # 2e-8 rad of each of four heads at both ends, and a fit over seconds
    np.testing.assert_allclose(found, np.diff(lacks, axis=0), atol=1.5e-7)
    assert table["sigma"][0] == pytest.approx(3**0.5 * 2e-8 * 0.75**0.5, rel=0.3)


def test_gyros_that_cannot_be_used_are_named(tmp_path):
    # 70 lines of .07 ms: one reading at most
    sensors = first_sensors(read_product(maker.pleiades(tmp_path)))
    assert sensors.text == "" and not sensors.tables
    assert "fewer than two of their readings lie within the image" in sensors.unknown[0]


def test_a_damaged_record_leaves_the_product_and_is_named(tmp_path):
    changes = [("<STATUS>NOMINAL</STATUS></FOG", "<STATUS>LOST</STATUS></FOG")]
    sensors = first_sensors(read_product(maker.pleiades(tmp_path, rows=20_000, changes=changes)))
    assert not sensors.tables
    assert "STATUS is not NOMINAL" in sensors.unknown[0]


def test_heads_are_read_where_all_of_them_were(tmp_path):
    whole = read_pleiades_telemetry(maker.pleiades(tmp_path))
    text = (tmp_path / "PHRDIMAP_P1.XML").read_text()
    head = text.index("<FOG2_Auxiliary_Data_List>") + len("<FOG2_Auxiliary_Data_List>")
    row = text[head : text.index("</FOG_Inertial_Data>", head) + len("</FOG_Inertial_Data>")]
    (tmp_path / "CUT.XML").write_text(text.replace(row, "", 1))
    part = read_pleiades_telemetry(tmp_path / "CUT.XML")
    np.testing.assert_array_equal(part.t, whole.t[1:])
    np.testing.assert_array_equal(np.diff(part.counts, axis=0), np.diff(whole.counts, axis=0)[1:])


def test_others_have_no_sensors(tmp_path):
    assert first_sensors(read_product(maker.dimap2(tmp_path))) is None
    path = maker.pleiades(tmp_path, changes=[("FOG1_Auxiliary_Data_List", "None")])
    assert first_sensors(read_product(path)) is None
