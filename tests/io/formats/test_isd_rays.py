"""Every public line-scan model against `tests/csm_reference.py`, which shares no code with the reader."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests import csm_reference as reference

from sightline.errors import FormatError
from sightline.io.formats.focal_plane import DISTORTIONS
from sightline.io.formats.isd import read_line_scan_model

#: Files of ALE and usgscsm, and why those are refused that are.
REFUSED = {
    "apolloPanImage_isd.json": r"'line_scan_rate' gives -0\.00158932 s from line to line in row 1",
    "ctx_isis_isd.json": r"'image_samples' is 1: the image is one column",
}
READ = (
    "chandrayaan2_tmc2_isd", "crism_isd", "ctx_isd", "kaguyami_isis_isd", "kaguyatc_isis_isd", "lrolroc_isd",
    "mgsmocwa_isd", "nhleisa_isd", "themisir_isd", "toughLroNacLineScan",
)  # fmt: skip


@pytest.fixture
def isds(real_data):
    return real_data("linescan_isds")


def apart(model, at, pixels) -> float:
    """px by which the rays of a camera miss those of the reference, at the height that it flies at."""
    camera, radius = model.camera, model.radii[0]
    rays, worst = camera.rays(pixels), 0.0
    for n, (line, column) in enumerate(pixels):
        origin, direction = at(line + 0.5, column + 0.5)
        pixel = camera.detector.pixel_step * max(np.linalg.norm(origin) - radius, 1.0)
        worst = max(
            worst,
            np.linalg.norm(rays.origins[n] - origin) / pixel,
            np.linalg.norm(rays.directions[n] - direction) / camera.detector.pixel_step,
        )
    return worst


def some_pixels(camera, count=60) -> np.ndarray:
    rng = np.random.default_rng(1)
    (lines, columns), last = camera.shape, np.array(camera.shape) - 1.0
    inside = np.column_stack([rng.integers(0, lines, count), rng.integers(0, columns, count)])
    return np.vstack([[[0, 0]], [last], [[0, last[1]]], [[last[0], 0]], inside]).astype(float)


def test_every_file_is_read_or_refused_by_name(isds):
    for path in isds.glob("*.json"):
        if path.name in REFUSED:
            with pytest.raises(FormatError, match=REFUSED[path.name]):
                read_line_scan_model(path)
        else:
            assert path.stem in READ
            read_line_scan_model(path)


@pytest.mark.parametrize("name", READ)
def test_rays_are_those_of_the_reference_to_a_thousandth_of_a_pixel(isds, name):
    path = isds / f"{name}.json"
    model, isd = read_line_scan_model(path), reference.load(path)
    worst = apart(model, lambda line, sample: reference.isd_ray(isd, line, sample), some_pixels(model.camera))
    print(f"{name}: {worst:.1e} px")
    # instants near 3e8 s are known to 6e-8 s: 2e-4 m on an orbit, 6e-11 rad of a turn of 1e-3 rad/s
    assert worst < 1e-3


@pytest.mark.parametrize(
    ("order", "platform"), [(1, None), (5, None), (9, None), (9, 0), (12, 1), (401, None)]
)
def test_states_are_interpolated_as_the_reference_does(isds, tmp_path, order, platform):
    """A state of a few nodes, of more than its polynomial takes, and of one for each line."""
    isd = reference.load(isds / "ctx_isd.json")
    count = max(order, 2)
    centre = isd["center_ephemeris_time"]
    first, last = (isd["body_rotation"]["ephemeris_times"][k] - centre for k in (0, -1))
    t = np.linspace(first, last, count)
    origins, turns, before = [], [], None
    for at in t:
        body = reference.slerped(isd["body_rotation"], centre + at)
        origins.append(1e3 * body @ reference.hermite(isd["instrument_position"], centre + at))
        turn = body @ reference.slerped(isd["instrument_pointing"], centre + at).T
        q = Rotation.from_matrix(turn).as_quat()
        before = q if before is None or q @ before > 0 else -q
        turns.append(before)
    step = (t[-1] - t[0]) / (count - 1)
    state = {
        "m_modelName": isd["name_model"], "m_nLines": 400, "m_nSamples": 5056, "m_zDirection": 1.0,
        "m_centerEphemerisTime": centre, "m_majorAxis": 3396190.0, "m_minorAxis": 3376200.0,
        "m_intTimeLines": [0.5], "m_intTimeStartTimes": [isd["line_scan_rate"][0][1]],
        "m_intTimes": [isd["line_scan_rate"][0][2]],
        "m_focalLength": isd["focal_length_model"]["focal_length"],
        "m_iTransL": isd["focal2pixel_lines"], "m_iTransS": isd["focal2pixel_samples"],
        "m_detectorLineOrigin": isd["detector_center"]["line"],
        "m_detectorSampleOrigin": isd["detector_center"]["sample"],
        "m_startingDetectorLine": 0.0, "m_startingDetectorSample": 0.0, "m_detectorSampleSumming": 1.0,
        "m_distortionType": 0, "m_opticalDistCoeffs": isd["optical_distortion"]["radial"]["coefficients"],
        "m_positions": np.ravel(origins).tolist(), "m_quaternions": np.ravel(turns).tolist(),
        "m_t0Ephem": t[0], "m_dtEphem": step, "m_t0Quat": t[0], "m_dtQuat": step,
    }  # fmt: skip
    if platform is not None:
        state["m_platformFlag"] = platform
    # an adjusted state of ASP begins with a line of the model's name
    (tmp_path / "run-a.adjusted_state.json").write_text(isd["name_model"] + "\n" + json.dumps(state))
    model = read_line_scan_model(tmp_path / "run-a.adjusted_state.json")
    at = lambda line, sample: reference.state_ray(state, line, sample)  # noqa: E731
    assert apart(model, at, some_pixels(model.camera)) < 1e-3


def changed(isds, tmp_path, change, name="ctx_isd.json"):
    isd = reference.load(isds / name)
    change(isd)
    (tmp_path / "m.json").write_text(json.dumps(isd))
    return isd, lambda: read_line_scan_model(tmp_path / "m.json")


def cut(isd, begin, end):
    table = isd["instrument_pointing"]
    for key in ("ephemeris_times", "quaternions", "angular_velocities"):
        table[key] = table[key][begin:end]


def test_pointing_that_begins_a_little_after_the_first_line_is_continued_and_said(isds, tmp_path):
    _isd, read = changed(isds, tmp_path, lambda isd: cut(isd, 2, None))
    model = read()
    # nodes lie at the edges of lines: two steps less begin 1.5 lines after the middle of line 0
    assert model.doubts == (
        "m.json: instrument_pointing begins 0.002816 s after the first line (1.5 steps): continued evenly",
    )
    ends = [[line, column] for line in (0.0, 1.0, 2.0, 3.0) for column in (0.0, 5055.0)]
    whole = json.loads((isds / "ctx_isd.json").read_text())
    at = lambda line, sample: reference.isd_ray(whole, line, sample)  # noqa: E731
    # rates of CTX change by some 1e-5 rad/s in 2 ms: 3e-8 rad or 0.002 px
    assert apart(model, at, np.array(ends)) < 0.02


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [(4, None, r"instrument_pointing' begins 0\.006\d* s after the first line, 3\.5 of its steps"),
     (0, -4, r"instrument_pointing' ends 0\.006\d* s before the last line, 3\.5 of its steps"),
     (7, 8, r"instrument_pointing' has one instant, and another is asked for")],
)  # fmt: skip
def test_pointing_that_leaves_more_than_two_steps_open_is_refused(isds, tmp_path, begin, end, said):
    _, read = changed(isds, tmp_path, lambda isd: cut(isd, begin, end))
    with pytest.raises(FormatError, match=said):
        read()


def test_rotations_may_be_constant_alone(isds, tmp_path):
    """A body that does not turn, given by its constant rotation alone, stands as it does at every instant."""

    def change(isd):
        body = isd["body_rotation"]
        turn = reference.slerped(body, body["ephemeris_times"][0])
        isd["body_rotation"] = {"constant_rotation": turn.ravel().tolist(), "reference_frame": 1}

    isd, read = changed(isds, tmp_path, change)
    model = read()
    table = isd["body_rotation"]
    isd["body_rotation"] = table | {
        "ephemeris_times": [0.0, 1.0], "quaternions": [[1.0, 0.0, 0.0, 0.0]] * 2
    }  # fmt: skip
    at = lambda line, sample: reference.isd_ray(isd, line, sample)  # noqa: E731
    assert apart(model, at, some_pixels(model.camera, 10)) < 1e-3


def test_a_table_of_line_rates_holds_from_each_row_to_the_next(isds, tmp_path):
    """As of HRSC: line from which a row holds, its time from the centre, s from line to line."""
    period = 0.001877
    rates = [[0.5, -0.3754, period], [200.5, -0.3754 + 200 * period, period / 2],
             [300.5, -0.3754 + 250 * period, 1.5 * period]]  # fmt: skip

    isd, read = changed(isds, tmp_path, lambda isd: isd.update(line_scan_rate=rates))
    model = read()
    lines = np.array([0.0, 199.0, 200.0, 299.0, 300.0, 399.0])
    t = [reference.line_time(rates, line + 0.5) for line in lines]
    np.testing.assert_allclose(
        model.camera.times(lines) - model.camera.times(lines)[0], np.array(t) - t[0], atol=1e-12
    )
    at = lambda line, sample: reference.isd_ray(isd, line, sample)  # noqa: E731
    assert apart(model, at, some_pixels(model.camera)) < 1e-3


@pytest.mark.parametrize(
    "rates", [[[200.5, 0.0, 0.001], [0.5, -0.3754, 0.001877]], [[0.5, -0.3, 0.001], [100.5, -0.3, 0.001]]]
)
def test_line_rates_out_of_order_are_refused(isds, tmp_path, rates):
    _, read = changed(isds, tmp_path, lambda isd: isd.update(line_scan_rate=rates))
    with pytest.raises(FormatError, match="'line_scan_rate' gives"):
        read()


def test_velocities_that_are_no_velocities_are_not_used(isds, tmp_path):
    """Zeros, as of Apollo's panoramic camera: positions lie on the polynomial through them."""
    _isd, read = changed(
        isds, tmp_path, lambda isd: isd["instrument_position"].update(velocities=[[0.0, 0.0, 0.0]] * 401)
    )
    whole = json.loads((isds / "ctx_isd.json").read_text())
    at = lambda line, sample: reference.isd_ray(whole, line, sample)  # noqa: E731
    model = read()
    assert apart(model, at, some_pixels(model.camera)) < 1e-3


def test_a_distortion_that_takes_pixels_across_the_axis_is_doubted(isds):
    (doubt,) = read_line_scan_model(isds / "mgsmocwa_isd.json").doubts
    assert doubt.startswith("the radial distortion takes a pixel 7.38 mm from the axis across it, to 143 mm")


def put_on(name, k, focal, u, v):
    """Undistorted to distorted, by the formula of each model that is given in this direction."""
    if name == "dawnfc":
        return u * (1 + k[0] * (u * u + v * v)), v * (1 + k[0] * (u * u + v * v))
    if name == "themisir":
        return u * k[2], v + k[0] * v + k[1] * v * v
    if name == "transverse":
        f = np.array([u**0, u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3])
        return k[:10] @ f, k[10:] @ f
    x, y = u / focal, v / focal  # radtan, as OpenCV
    r2 = x * x + y * y
    radial = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
    return (
        focal * (x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)),
        focal * (y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y),
    )


TRANSVERSE = np.array([0.01, 1.001, 2e-4, 1e-5, 3e-5, 2e-5, 1e-7, 2e-7, 1e-7, 3e-7,
                       -0.02, 1e-4, 0.999, 2e-5, 1e-5, 4e-5, 2e-7, 1e-7, 3e-7, 1e-6])  # fmt: skip


@pytest.mark.parametrize(
    ("name", "k"),
    [("dawnfc", np.array([8.4e-6])), ("themisir", np.array([0.00447623, 0.00107556, 0.996005])),
     ("transverse", TRANSVERSE), ("radtan", np.array([-0.12, 0.05, 1e-3, -5e-4, 0.01]))],
)  # fmt: skip
def test_a_distortion_that_is_put_on_is_taken_off_again(name, k):
    u, v = np.linspace(-20.0, 20.0, 41), np.linspace(3.0, -5.0, 41)
    x, y = put_on(name, k, 150.0, u, v)
    again = DISTORTIONS[name].undistorted(x, y, k, 150.0)
    np.testing.assert_allclose(again, (u, v), atol=1e-10)


def test_cahvor_is_radial_about_its_own_centre():
    k = np.array([1e-3, -2e-5, 1e-8])
    x, y = np.linspace(-20.0, 20.0, 41), np.full(41, 0.7)
    u, v = DISTORTIONS["cahvor"].undistorted(x, y, np.array([*k, 1.5, -0.4]), 150.0)
    for n in range(41):
        assert (u[n] - 1.5, v[n] + 0.4) == pytest.approx(
            reference.undistorted("radial", {"coefficients": k}, x[n] - 1.5, y[n] + 0.4)
        )


def test_a_distortion_without_an_inverse_is_refused(isds, tmp_path):
    table = {"transverse": {"x": [0.0] * 10, "y": [0.0] * 10}}
    _, read = changed(isds, tmp_path, lambda isd: isd.update(optical_distortion=table))
    with pytest.raises(FormatError, match=r"m\.json: the distortion has no inverse over the whole image"):
        read()


def test_a_focal_plane_without_extent_is_refused(isds, tmp_path):
    _, read = changed(isds, tmp_path, lambda isd: isd.update(focal2pixel_samples=[0.0, 142.857, 0.0]))
    with pytest.raises(FormatError, match="leave pixels no place of their own in the focal plane"):
        read()
