"""USGS CSM line-scan models of real images: CTX, LRO NAC, and a NAC with a slew."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from tests.io.conftest import noise, write_tif

from sightline.errors import FormatError
from sightline.geometry.surface import Ellipsoid
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.isd import read_line_scan_model

FILES = ("ctx_isd.json", "lrolroc_isd.json", "toughLroNacLineScan.json")


@pytest.fixture
def isds(real_data):
    return real_data("linescan_isds")


def pixels_of(camera) -> np.ndarray:
    lines, columns = camera.shape
    grid = np.meshgrid(np.linspace(0, lines - 1, 9), np.linspace(0, columns - 1, 11), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 2)


def ray_by_hand(data: dict, line: float, sample: float):
    """Body-fixed origin and direction of an image pixel, straight from the file: no code shared.

    The nearest table rows are used, so the line must be one whose time is in the tables.
    """
    t = (
        data["center_ephemeris_time"]
        + data["line_scan_rate"][0][1]
        + data["line_scan_rate"][0][2] * (line + 0.5)
    )

    def fixed(table, at):
        first = Rotation.from_quat([q[1:] + q[:1] for q in table["quaternions"]])
        turn = Slerp(table["ephemeris_times"], first)([at])[0].as_matrix()
        constant = np.array(table.get("constant_rotation", np.eye(3).ravel())).reshape(3, 3)
        return constant @ turn

    place = data["instrument_position"]
    origin = np.array([np.interp(t, place["ephemeris_times"], p) for p in np.transpose(place["positions"])])
    pitch = 1.0 / abs(data["focal2pixel_samples"][2])
    x = (0.0 - data["detector_center"]["line"]) * pitch * np.sign(data["focal2pixel_lines"][1])
    detector_sample = (sample + 0.5) * data["detector_sample_summing"] + data["starting_detector_sample"]
    y = (detector_sample - data["detector_center"]["sample"]) * pitch
    distortion = data["optical_distortion"]
    if "radial" in distortion:
        k = distortion["radial"]["coefficients"]
        r2 = x * x + y * y
        shrink = 1 - (k[0] + k[1] * r2 + k[2] * r2 * r2)
        x, y = x * shrink, y * shrink
    else:
        y = y / (1 + distortion["lrolrocnac"]["coefficients"][0] * y * y)
    look = np.array([x, y, data["focal_length_model"]["focal_length"]])
    body = fixed(data["body_rotation"], t)
    direction = body @ fixed(data["instrument_pointing"], t).T @ look
    return 1e3 * body @ origin, direction / np.linalg.norm(direction)


@pytest.mark.parametrize("name", FILES)
def test_locate_and_project_close_over_the_whole_image(isds, name):
    model = read_line_scan_model(isds / name)
    surface = Ellipsoid(*model.radii)
    pixels = pixels_of(model.camera)
    ground = model.camera.locate(pixels, surface)
    assert np.isfinite(ground).all()
    np.testing.assert_allclose(model.camera.project(ground), pixels, atol=1e-6)


@pytest.mark.parametrize("name", FILES)
def test_rays_are_those_that_the_file_gives_by_hand(isds, name):
    data = json.loads((isds / name).read_text())
    camera = read_line_scan_model(isds / name).camera
    for line, sample in ((0, 0), (camera.lines // 2, camera.columns - 1), (camera.lines - 1, 100)):
        rays = camera.rays([[line, sample]])
        origin, direction = ray_by_hand(data, line, sample)
        # positions by hand are linear between the rows: at 3 m/s^2 and rows 2 ms apart (CTX, NAC) the chord
        # is micrometres off, at rows 0.56 s apart (slew) 3 * 0.56^2 / 8 = 0.12 m. Attitude: slerp against a
        # cubic, at 1e-3 rad/s^2 and 55 ms 4e-7 rad, otherwise nanoradians
        slow = name.startswith("tough")
        assert np.linalg.norm(rays.origins[0] - origin) < (0.3 if slow else 1e-3)
        assert np.linalg.norm(rays.directions[0] - direction) < (2e-6 if slow else 1e-8)


def test_the_boresight_of_ctx_points_at_mars_and_the_pole_is_the_pole(isds):
    model = read_line_scan_model(isds / "ctx_isd.json")
    camera = model.camera
    middle = np.array([[200.0, 2542.96099 - 0.5]])
    ground = camera.locate(middle, Ellipsoid(*model.radii))[0]
    # nadir pointing: the ground under the boresight lies under the spacecraft, within a degree at 251 km
    below = camera.rays(middle).origins[0]
    below = below * (np.linalg.norm(ground) / np.linalg.norm(below))
    assert np.linalg.norm(ground - below) < 4000.0
    # 352.9 mm lens, 7 um pixels
    assert camera.detector.pixel_step == pytest.approx(0.007 / 352.9271664, rel=0.02)
    assert np.linalg.norm(below) == pytest.approx(np.linalg.norm(ground))


@pytest.mark.parametrize("name", FILES)
def test_body_axes_fly_forward_and_look_down(isds, name):
    camera = read_line_scan_model(isds / name).camera
    t = camera.times([camera.lines / 2])
    pose, later = camera.trajectory.at(t), camera.trajectory.at(t + 0.01)
    velocity = pose.world_from_body.inv().apply((later.position - pose.position) / 0.01)[0]
    assert velocity[0] > 0.99 * np.linalg.norm(velocity)
    down = pose.world_from_body.inv().apply(-pose.position)[0]
    assert down[2] > 0.99 * np.linalg.norm(down)


def test_times_are_those_of_the_centre_of_each_line(isds):
    model = read_line_scan_model(isds / "ctx_isd.json")
    assert model.reference_et == pytest.approx(297088762.24158406 + 0.5 * 0.001877, abs=2e-7)
    np.testing.assert_allclose(model.camera.times([0.0, 100.0]), [0.0, 0.1877], atol=1e-9)


def test_a_rate_table_of_several_rows_makes_uneven_lines(isds, tmp_path):
    data = json.loads((isds / "ctx_isd.json").read_text())
    period = data["line_scan_rate"][0][2]
    data["line_scan_rate"] = [[0.5, -0.3754, period], [200.5, -0.3754 + 200 * period, period / 2]]
    (tmp_path / "m.json").write_text(json.dumps(data))
    times = read_line_scan_model(tmp_path / "m.json").camera.times(np.arange(400.0))
    steps = np.diff(times)
    np.testing.assert_allclose(steps[:199], period, rtol=1e-4)
    np.testing.assert_allclose(steps[200:], period / 2, rtol=1e-4)


def test_a_model_state_gives_the_same_rays_as_its_isd(isds, tmp_path):
    """The state is made here by hand: everything turned into body-fixed axes on an even grid."""
    data = json.loads((isds / "ctx_isd.json").read_text())
    model = read_line_scan_model(isds / "ctx_isd.json")
    centre = data["center_ephemeris_time"]
    t = np.array(data["instrument_pointing"]["ephemeris_times"])
    body = data["body_rotation"]
    turn = Slerp(body["ephemeris_times"], Rotation.from_quat([q[1:] + q[:1] for q in body["quaternions"]]))(t)
    pointing = data["instrument_pointing"]
    sensor = Rotation.from_matrix(np.reshape(pointing["constant_rotation"], (3, 3))) * Rotation.from_quat(
        [q[1:] + q[:1] for q in pointing["quaternions"]]
    )
    position = 1e3 * turn.apply(data["instrument_position"]["positions"])
    state = {
        "m_modelName": data["name_model"], "m_nLines": 400, "m_nSamples": 5056,
        "m_centerEphemerisTime": centre, "m_majorAxis": 3396190.0, "m_minorAxis": 3376200.0,
        "m_intTimeLines": [0.5], "m_intTimeStartTimes": [data["line_scan_rate"][0][1]],
        "m_intTimes": [data["line_scan_rate"][0][2]],
        "m_focalLength": data["focal_length_model"]["focal_length"],
        "m_iTransL": data["focal2pixel_lines"], "m_iTransS": data["focal2pixel_samples"],
        "m_detectorLineOrigin": data["detector_center"]["line"],
        "m_detectorSampleOrigin": data["detector_center"]["sample"],
        "m_startingDetectorLine": 0.0, "m_startingDetectorSample": 0.0, "m_detectorSampleSumming": 1.0,
        "m_distortionType": 0, "m_opticalDistCoeffs": data["optical_distortion"]["radial"]["coefficients"],
        "m_positions": position.ravel().tolist(),
        "m_velocities": np.gradient(position, t - centre, axis=0).ravel().tolist(),
        "m_t0Ephem": t[0] - centre, "m_dtEphem": (t[-1] - t[0]) / 400,
        "m_quaternions": (turn * sensor.inv()).as_quat().ravel().tolist(),
        "m_t0Quat": t[0] - centre, "m_dtQuat": (t[-1] - t[0]) / 400,
    }  # fmt: skip
    (tmp_path / "state.json").write_text(data["name_model"] + "\n" + json.dumps(state))
    again = read_line_scan_model(tmp_path / "state.json")
    pixels = pixels_of(model.camera)
    ground = model.camera.locate(pixels, Ellipsoid(*model.radii))
    # the ends of numpy's gradient are first-order: 0.75 s * 3 m/s^2 / 400 there, so a few mm at most
    np.testing.assert_allclose(again.camera.locate(pixels, Ellipsoid(*again.radii)), ground, atol=0.02)


def spoiled(isds, tmp_path, change) -> str:
    data = json.loads((isds / "ctx_isd.json").read_text())
    change(data)
    (tmp_path / "m.json").write_text(json.dumps(data))
    with pytest.raises(FormatError) as caught:
        read_line_scan_model(tmp_path / "m.json")
    return str(caught.value)


def test_a_distortion_that_is_not_read_is_refused_by_name(isds, tmp_path):
    def change(data):
        data["optical_distortion"] = {"legendre": {"x_coefficients": [0.0], "y_coefficients": [0.0]}}

    said = spoiled(isds, tmp_path, change)
    assert "optical_distortion 'legendre' is not read: the file holds neither the half widths" in said
    assert (
        "; radial, transverse, kaguyalism, dawnfc, lrolrocnac, cahvor, radtan, themisir or none are" in said
    )


def test_another_sensor_model_is_refused_by_name(isds, tmp_path):
    said = spoiled(isds, tmp_path, lambda data: data.update(name_model="USGS_ASTRO_FRAME_SENSOR_MODEL"))
    assert (
        "is of model 'USGS_ASTRO_FRAME_SENSOR_MODEL'; USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL is read here"
        in said
    )


def test_a_missing_key_of_the_model_is_named(isds, tmp_path):
    assert "the key 'instrument_pointing' is missing" in spoiled(
        isds, tmp_path, lambda data: data.pop("instrument_pointing")
    )


def with_one_more(table, key):
    return lambda data: data[table][key].append(data[table][key][-1])


WRONG = {
    "a time too many": (with_one_more("body_rotation", "ephemeris_times"), "body_rotation.ephemeris_times"),
    "a place too many": (with_one_more("instrument_position", "positions"), "instrument_position.positions"),
    "rows of other lengths": (
        lambda data: data["instrument_pointing"]["quaternions"][3].pop(),
        "instrument_pointing.quaternions",
    ),
    "a word": (
        lambda data: data["instrument_position"]["velocities"][2].__setitem__(1, "fast"),
        "instrument_position.velocities",
    ),
    "no number": (lambda data: data.update(center_ephemeris_time=float("nan")), "center_ephemeris_time"),
    "too large": (lambda data: data.update(image_lines=10**400), "image_lines"),
    "half a line": (lambda data: data.update(image_lines=400.5), "image_lines"),
    "no lines": (lambda data: data.update(image_lines=0), "image_lines"),
    "a list": (lambda data: data.update(image_samples=[5056]), "image_samples"),
    "no table": (lambda data: data.update(radii=3396.0), "radii.semimajor"),
    "another unit": (lambda data: data["radii"].update(unit="miles"), "radii.unit"),
    "no rates": (lambda data: data.update(line_scan_rate=[]), "line_scan_rate"),
    "turned times": (
        lambda data: data["instrument_position"]["ephemeris_times"].reverse(),
        "instrument_position.ephemeris_times",
    ),
    "no turn": (
        lambda data: data["instrument_pointing"]["quaternions"].__setitem__(0, [0.0, 0.0, 0.0, 0.0]),
        "instrument_pointing.quaternions",
    ),
    "no focal length": (
        lambda data: data["focal_length_model"].update(focal_length=0.0),
        "focal_length_model.focal_length",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_key_that_is_not_as_it_should_be_is_named(isds, tmp_path, case):
    change, key = WRONG[case]
    assert f"m.json: the key '{key}' " in spoiled(isds, tmp_path, change)


def test_text_that_is_not_json_is_refused(tmp_path):
    (tmp_path / "m.json").write_text("{ not json")
    with pytest.raises(FormatError, match=r"m\.json: not valid JSON"):
        read_line_scan_model(tmp_path / "m.json")


def test_an_acquisition_may_take_its_cameras_from_a_model(isds, folder):
    for seed, name in enumerate(("PAN", "XS")):
        write_tif(folder.path / f"{name}.tif", noise(seed, (400, 5056)))
    folder.text = f"""
[platform]
kind = "camera-model"
model = '{isds / "ctx_isd.json"}'
[[band]]
name = "PAN"
image = "PAN.tif"
[[band]]
name = "XS"
image = "XS.tif"
look_ahead = 1e-3
"""
    acquisition = load_acquisition(folder.write())
    assert acquisition.surface.a == 3396190.0 and acquisition.world == "earth-fixed"
    ground = acquisition.cameras[0].locate([[300.0, 2500.0]], acquisition.surface)
    moved = 300.0 - acquisition.cameras[1].project(ground)[0, 0]
    # 1e-3 rad over the 3627.9 - 3376.8 km between spacecraft and ground, in lines of 6.05 m
    assert moved == pytest.approx(1e-3 * 251.1e3 / 6.05, rel=0.01)
    folder.text = folder.text.replace("look_ahead = 1e-3", "ifov = 1e-5")
    with pytest.raises(FormatError, match=r"number 2 \(XS\): ifov is given, but the model file brings it"):
        load_acquisition(folder.write())
    write_tif(folder.path / "XS.tif", noise(1, (300, 5056)))
    folder.text = folder.text.replace("ifov = 1e-5", "")
    with pytest.raises(
        FormatError, match=r"XS\.tif has 300 lines x 5056 columns.*400 x 5056; they must agree"
    ):
        load_acquisition(folder.write())
