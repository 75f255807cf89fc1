"""Every export read back by a reader that shares no code with its writer."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from rasterio.transform import RPCTransformer
from scipy.spatial.transform import Rotation
from tests import csm_reference as reference
from tests.io.results.exported import COLUMNS, EPOCH, LINES, moved, orbit_strip

from sightline.applications.export import line_states, rates
from sightline.errors import InputError, SightlineError
from sightline.geometry.earth import to_geodetic
from sightline.geometry.pointing import FixedMount
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.csm_files import nearest_plane
from sightline.io.formats.ephemeris_time import earth_from_j2000, et_of_utc
from sightline.io.formats.images import open_image
from sightline.io.formats.isd import read_line_scan_model
from sightline.io.results.exports import _words, write_export


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    return orbit_strip(tmp_path_factory.mktemp("strip"))


def pixels_of(camera, count=120):
    rng = np.random.default_rng(9)
    (lines, columns), last = camera.shape, np.array(camera.shape) - 1.0
    inside = np.column_stack([rng.integers(0, lines, count), rng.integers(0, columns, count)])
    return np.vstack([[[0, 0]], [last], [[0, last[1]]], [[last[0], 0]], inside]).astype(float)


def worst_ray(camera, radius, at) -> float:
    """px between the rays of a camera and those of a reference."""
    pixels = pixels_of(camera)
    rays, worst = camera.rays(pixels), 0.0
    for n, (line, column) in enumerate(pixels):
        origin, direction = at(line + 0.5, column + 0.5)
        pixel = camera.detector.pixel_step * (np.linalg.norm(origin) - radius)
        worst = max(
            worst,
            np.linalg.norm(rays.origins[n] - origin) / pixel,
            np.linalg.norm(rays.directions[n] - direction) / camera.detector.pixel_step,
        )
    return worst


def turned(camera, angle):
    """The same camera with camera axes turned about z by `angle` (degrees)."""
    turn = Rotation.from_euler("z", angle, degrees=True)
    directions = turn.inv().apply(camera.detector.directions.copy())
    mount = FixedMount(camera.pointing.body_from_camera * turn)
    return replace(camera, detector=replace(camera.detector, directions=directions), pointing=mount)


@pytest.mark.parametrize("angle", [0.0, 100.0, -90.0])
@pytest.mark.parametrize("to", ["csm", "isd"])
def test_a_csm_file_looks_where_the_recovered_camera_does(strip, tmp_path, to, angle):
    """Whichever way the detector line runs in the axes of its camera."""
    cameras = {name: turned(camera, angle) for name, camera in strip.cameras.items()}
    summary = write_export(to, tmp_path, replace(strip, cameras=cameras))
    for band in summary["bands"]:
        held = reference.load(tmp_path / band["file"])
        ray = reference.state_ray if to == "csm" else reference.isd_ray
        worst = worst_ray(strip.cameras[band["name"]], 6378137.0, lambda l, s: ray(held, l, s))  # noqa: B023, E741
        print(f"{to} {band['name']}: {worst:.1e} px")
        assert worst < 1e-3
        assert band["lens_px"] < 1e-4


def test_a_state_begins_with_the_name_of_its_model_and_holds_a_quaternion_per_line(strip, tmp_path):
    write_export("csm", tmp_path, strip)
    name, _, text = (tmp_path / "PAN.json").read_text().partition("\n")
    state = json.loads(text)
    assert name == state["m_modelName"] == "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
    # four lines more at either end, so that its polynomials of eight nodes lie about every line
    assert state["m_numQuaternions"] == 4 * (LINES + 8) == len(state["m_quaternions"])
    assert state["m_dtQuat"] == pytest.approx(1e-4, rel=1e-9)
    # 2026-03-04 05:06:07.25 UTC is 826,000,000 s and something past J2000: TT - UTC is 69.184 s
    since = np.datetime64("2026-03-04T05:06:07.250") - np.datetime64("2000-01-01T12:00:00")
    et = since / np.timedelta64(1, "s") + 69.184
    assert state["m_centerEphemerisTime"] - (LINES - 1) / 2 * 1e-4 == pytest.approx(et, abs=2e-3)


@pytest.mark.parametrize(
    "name",
    ["ctx_isd.json", "lrolroc_isd.json", "kaguyatc_isis_isd.json", "kaguyami_isis_isd.json"],
)
def test_models_of_other_bodies_go_out_as_they_came_in(real_data, tmp_path, name):
    """Detector lines with radial and other distortions, moved by what was found."""
    isd = reference.load(real_data("linescan_isds") / name)
    for band in ("PAN", "XS"):
        rng = np.random.default_rng(1)
        np.save(tmp_path / f"{band}.npy", rng.random((isd["image_lines"], isd["image_samples"]), np.float32))
    path = real_data("linescan_isds") / name
    (tmp_path / "acquisition.toml").write_text(
        f"[platform]\nkind = 'camera-model'\nmodel = '{path}'\n[[band]]\nname = 'PAN'\nimage = 'PAN.npy'\n"
        "[[band]]\nname = 'XS'\nimage = 'XS.npy'\nlook_ahead = 1e-3\n"
    )
    strip = moved(load_acquisition(tmp_path / "acquisition.toml"), 1e-6)
    (tmp_path / "out").mkdir()
    for to, ray in (("csm", reference.state_ray), ("isd", reference.isd_ray)):
        for band in write_export(to, tmp_path / "out", strip)["bands"]:
            held = reference.load(tmp_path / "out" / band["file"])
            camera = strip.cameras[band["name"]]
            worst = worst_ray(camera, 1e3 * isd["radii"]["semimajor"], lambda l, s: ray(held, l, s))  # noqa: B023, E741
            print(f"{to} {name} {band['name']}: {worst:.1e} px, lens {band['lens_px']:.1e} px")
            assert worst < 1e-3
            assert held.get("m_centerEphemerisTime", isd["center_ephemeris_time"]) == pytest.approx(
                isd["center_ephemeris_time"], abs=1e-5
            )


def test_a_lens_that_throws_the_line_across_its_axis_is_met_too(real_data):
    """As the radial coefficients of one public model do: the axis lies beside the image."""
    model = read_line_scan_model(real_data("linescan_isds") / "mgsmocwa_isd.json")
    assert nearest_plane(model.camera.detector)[1] < 1e-6


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """The same strip with a third of the motion: what an RPC may leave."""
    return orbit_strip(tmp_path_factory.mktemp("calm"), amplitude=6e-7)


def test_an_rpc_is_what_gdal_makes_of_it(calm, tmp_path):
    strip = calm
    summary = write_export("rpc", tmp_path, strip)
    for band in summary["bands"]:
        camera = strip.cameras[band["name"]]
        pixels = pixels_of(camera)
        told = np.array(band["max_px"])
        with rasterio.open(tmp_path / f"{band['name']}.tif") as tagged:
            assert (tagged.read(1) == strip.acquisition.images[0].read((0, LINES), (0, COLUMNS))).all() or (
                band["name"] == "XS"
            )
            models = [tagged.rpcs, rpc_of_text(tmp_path / f"{band['name']}_RPC.TXT")]
        models.append(rpc_of_rpb(tmp_path / f"{band['name']}.RPB"))
        for model in models:
            with RPCTransformer(model) as transformer:
                for height in (-300.0, 120.0, 500.0):
                    surface = strip.acquisition.surface.raised(height - 120.0)
                    lon, lat, h = to_geodetic(camera.locate(pixels, surface)).T
                    rows, cols = transformer.rowcol(np.degrees(lon), np.degrees(lat), zs=h, op=lambda x: x)
                    apart = np.abs(np.column_stack([rows, cols]) - 0.5 - pixels).max(axis=0)
                    # pixels between those of the check may lie a little further off its curve
                    assert (apart < 1.05 * told + 1e-3).all(), (apart, told)


def test_the_image_of_an_rpc_keeps_type_nodata_mask_and_description(calm, tmp_path):
    """Whole numbers that float32 would round, and pixels that hold nothing."""
    pixels = np.random.default_rng(3).integers(2**24, 2**31 - 1, (LINES, COLUMNS), np.int32)
    pixels[:40, :30] = -9
    bad = np.zeros((LINES, COLUMNS), np.uint8)
    bad[700:720] = 1
    profile = {"driver": "GTiff", "width": COLUMNS, "height": LINES, "count": 2, "dtype": "int32"}
    with rasterio.open(tmp_path / "in.tif", "w", nodata=-9, **profile) as raster:
        raster.write(pixels, 2)
        raster.set_band_description(2, "panchromatic")
    np.save(tmp_path / "bad.npy", bad)
    image = open_image(tmp_path / "in.tif", 2, tmp_path / "bad.npy")
    pan, xs = calm.acquisition.bands
    acquired = replace(calm.acquisition, bands=(replace(pan, image=image), xs))
    (tmp_path / "out").mkdir()
    alone = {"PAN": calm.cameras["PAN"]}
    write_export("rpc", tmp_path / "out", replace(calm, acquisition=acquired, cameras=alone))
    with rasterio.open(tmp_path / "out" / "PAN.tif") as tagged:
        assert (tagged.dtypes, tagged.nodata, tagged.descriptions) == (("int32",), -9, ("panchromatic",))
        assert (tagged.read(1) == pixels).all()
        assert ((tagged.read_masks(1) == 0) == ((pixels == -9) | (bad == 1))).all()
    assert sorted(path.suffix for path in (tmp_path / "out").glob("PAN*")) == [".RPB", ".TXT", ".tif"]


def rpc_of_text(path):
    """A reader of ``_RPC.TXT`` of our own: keyword: value unit."""
    items = dict(line.split(": ", 1) for line in path.read_text().splitlines())
    lists = {
        key: [float(items[f"{key}_{k}"]) for k in range(1, 21)]
        for key in ("LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF")
    }
    numbers = {
        key: float(value.split()[0]) for key, value in items.items() if key.endswith(("_OFF", "_SCALE"))
    }
    return rasterio.rpc.RPC(**{key.lower(): value for key, value in (numbers | lists).items()})


def rpc_of_rpb(path):
    """The same of an RPB."""
    text = path.read_text()
    names = {"line": "line", "samp": "samp", "lat": "lat", "long": "long", "height": "height"}
    found = {}
    for name, key in names.items():
        for word, end in (("Offset", "off"), ("Scale", "scale")):
            found[f"{key}_{end}"] = float(text.split(f"{name}{word} = ")[1].split(";")[0])
    for name in ("lineNum", "lineDen", "sampNum", "sampDen"):
        inside = text.split(f"{name}Coef = (")[1].split(")")[0]
        found[f"{name[:4]}_{name[4:].lower()}_coeff"] = [float(cell) for cell in inside.split(",")]
    return rasterio.rpc.RPC(**found)


def test_gdal_finds_an_rpc_beside_the_image(calm, tmp_path):
    """``_RPC.TXT`` and ``.RPB`` each alone, beside an image without tags."""
    write_export("rpc", tmp_path, calm)
    with rasterio.open(tmp_path / "PAN.tif") as tagged:
        whole = tagged.rpcs.to_dict()
        profile = tagged.profile
    for name in ("PAN_RPC.TXT", "PAN.RPB"):
        place = tmp_path / name.replace(".", "_")
        place.mkdir()
        with rasterio.open(place / "PAN.tif", "w", **profile):
            pass
        (place / name).write_text((tmp_path / name).read_text())
        with rasterio.open(place / "PAN.tif") as found:
            for key, value in found.rpcs.to_dict().items():
                if not key.startswith("err"):
                    np.testing.assert_allclose(value, whole[key], rtol=1e-9, atol=1e-10)


def test_motion_that_no_rpc_carries_is_told_and_refused(tmp_path):
    with pytest.raises(
        InputError, match=r"the motion of 'PAN' leaves .* which no RPC carries; 1 px are allowed"
    ):
        write_export("rpc", tmp_path, orbit_strip(tmp_path, amplitude=6e-6))


def test_shifts_are_what_the_motion_moved_each_pixel_by(strip, tmp_path):
    summary = write_export("shifts", tmp_path, strip)
    for band in summary["bands"]:
        camera = strip.cameras[band["name"]]
        with rasterio.open(tmp_path / band["file"]) as raster:
            found = raster.read()
        assert found.shape == (2, LINES, COLUMNS)
        pixels = pixels_of(camera)[4:]
        pixels = pixels[(pixels[:, 0] > 20) & (pixels[:, 0] < LINES - 20)]
        # by hand: pitch moves a pixel along the lines, roll along the columns, a pixel an ifov; columns
        # increase to the left of flight, where positive roll looks
        t = camera.times(pixels[:, 0])
        roll, pitch, yaw = camera.trajectory.motion.at(t).T
        line, column = pixels.T.astype(int)
        side = (pixels[:, 1] - (COLUMNS - 1) / 2.0) * 1e-6
        ahead = 1e-4 if band["name"] == "PAN" else 0.0
        # a line advances by less than a pixel is high: in lines an angle counts that much more
        still = strip.acquisition.cameras[0]
        place = still.locate([[700.0, 200.0], [701.0, 200.0], [700.0, 201.0]], strip.acquisition.surface)
        high = np.linalg.norm(place[2] - place[0]) / np.linalg.norm(place[1] - place[0])
        # what is left, of a round Earth and looks of 1e-4, is of the order of 1e-3 of these
        np.testing.assert_allclose(found[0, line, column], high * (pitch - yaw * side) / 1e-6, atol=0.02)
        np.testing.assert_allclose(found[1, line, column], (roll + yaw * ahead) / 1e-6, atol=0.02)


def test_quaternions_and_places_are_written_in_full(strip, tmp_path):
    write_export("quaternions", tmp_path, strip)
    with (tmp_path / "quaternions.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(strip.t)
    found = np.array([[float(row[key]) for key in ("qx", "qy", "qz", "qw")] for row in rows])
    np.testing.assert_array_equal(found, strip.quat_xyzw)
    np.testing.assert_array_equal([float(row["x"]) for row in rows], strip.position[:, 0])
    assert {"sigma_roll", "sigma_pitch", "sigma_yaw"} <= set(rows[0])


KERNELS = ("mroLSK.tls", "mroSCLK.tsc")


@pytest.fixture
def clock(real_data):
    return tuple(real_data("hirise_jitter_psp008469") / name for name in KERNELS)


def worst_of_kernel(spice, band, camera, body, et, axes) -> float:
    """px between where a frame of a kernel looks and where the camera does, at whole lines."""
    worst, pixels = 0.0, pixels_of(camera, 60)
    looks = camera.detector.directions_at(pixels[:, 1])
    rays = camera.rays(pixels)
    for n, t in enumerate(camera.times(pixels[:, 0])):
        ticks = spice.sce2c(-74, et + t)
        matrix, _, _ = spice.ckgpav(band["id"], ticks, 0.0, axes)[:3]
        fixed = body(et + t) @ matrix.T @ looks[n]
        worst = max(worst, np.linalg.norm(fixed - rays.directions[n]) / camera.detector.pixel_step)
    return worst


def test_a_c_kernel_of_another_body_is_read_by_spice(real_data, clock, tmp_path):
    spice = pytest.importorskip("spiceypy")
    path = real_data("linescan_isds") / "ctx_isd.json"
    isd = reference.load(path)
    for band in ("PAN", "XS"):
        np.save(tmp_path / f"{band}.npy", np.random.default_rng(1).random((400, 5056), np.float32))
    (tmp_path / "acquisition.toml").write_text(
        f"[platform]\nkind = 'camera-model'\nmodel = '{path}'\n[[band]]\nname = 'PAN'\nimage = 'PAN.npy'\n"
        "[[band]]\nname = 'XS'\nimage = 'XS.npy'\nlook_ahead = 1e-3\n"
    )
    strip = moved(load_acquisition(tmp_path / "acquisition.toml"), 1e-6)
    (tmp_path / "out").mkdir()
    summary = write_export("ck", tmp_path / "out", strip, clock)
    # t = 0 is the middle of the first line
    et = isd["center_ephemeris_time"] + reference.line_time(isd["line_scan_rate"], 0.5)
    for band in summary["bands"]:
        loaded = [*map(str, clock), *(str(tmp_path / "out" / name) for name in band["files"])]
        spice.furnsh(loaded)
        try:
            camera = strip.cameras[band["name"]]
            body = lambda at: reference.slerped(isd["body_rotation"], at)  # noqa: E731
            worst = worst_of_kernel(spice, band, camera, body, et, "J2000")
            # the frame kernel gives the same under its name, with the rate of the spacecraft
            turn = spice.sxform("J2000", band["frame"], et + 0.3)
            rate = spice.xf2rav(turn)[1]
        finally:
            spice.unload(loaded)
        print(f"ck {band['name']}: {worst:.1e} px")
        # instants and ticks are resolved to 6e-8 s, motion turns by 1e-4 rad/s: 1e-11 rad of 2e-5
        assert worst < 1e-3
        assert np.linalg.norm(rate) == pytest.approx(
            np.linalg.norm(isd["instrument_pointing"]["angular_velocities"][0]), rel=0.3
        )


def test_a_c_kernel_of_the_earth_is_fixed_to_it(strip, clock, tmp_path):
    spice = pytest.importorskip("spiceypy")
    summary = write_export("ck", tmp_path, strip, clock)
    for band in summary["bands"]:
        loaded = [*map(str, clock), *(str(tmp_path / name) for name in band["files"])]
        spice.furnsh(loaded)
        try:
            et = spice.str2et(EPOCH.removesuffix("Z"))
            worst = worst_of_kernel(
                spice, band, strip.cameras[band["name"]], lambda at: np.eye(3), et, "ITRF93"
            )
        finally:
            spice.unload(loaded)
        print(f"ck {band['name']}: {worst:.1e} px")
        assert worst < 1e-3


def test_a_c_kernel_needs_the_clock_of_one_spacecraft(strip, clock, tmp_path):
    pytest.importorskip("spiceypy")
    for kernels, said in ((), "(none) hold 0"), (clock[:1], "(mroLSK.tls) hold 0"):
        with pytest.raises(InputError, match="needs the clock of one spacecraft") as caught:
            write_export("ck", tmp_path, strip, kernels)
        assert said in str(caught.value)
    (tmp_path / "a.tls").write_text("no kernel")
    with pytest.raises(SightlineError, match="cannot be loaded as a SPICE kernel"):
        write_export("ck", tmp_path, strip, (*clock, tmp_path / "a.tls"))


def test_the_jitter_table_is_as_that_of_isis(strip, real_data, tmp_path):
    write_export("isis", tmp_path, strip)
    for name, camera in strip.cameras.items():
        table = np.loadtxt(tmp_path / f"{name}_jitter.txt", comments="#")
        assert (
            table.shape[1]
            == np.loadtxt(real_data("hirise_jitter_psp008469") / "mroJitter.txt", comments="#").shape[1]
        )
        t = table[:, 2] - table[0, 2]
        np.testing.assert_allclose(np.diff(t), 1e-4, atol=3e-7)  # instants are resolved to 1.2e-7 s
        assert len(table) >= LINES - 8
        # in the middle of the field roll moves samples, pitch lines, as of the raster of shifts
        motion = camera.trajectory.motion.at(camera.times(np.arange(100.0, 200.0)))
        np.testing.assert_allclose(
            table[100 - LINES + len(table) :, 0][:100][5:95].std(), motion[5:95, 0].std() / 1e-6, rtol=0.1
        )


def test_the_jitter_table_corrects_pointing_as_appjit_applies_it(strip, tmp_path):
    """By ``appjit``'s own steps: [line]_2 [sample]_1 of minus the offsets turns the axes of the instrument.

    Of these x points forward, and samples run against y.
    """
    write_export("isis", tmp_path, strip)
    camera = strip.cameras["PAN"]
    table = np.loadtxt(tmp_path / "PAN_jitter.txt", comments="#")
    lines, middle = np.arange(float(LINES)), (camera.columns - 1) // 2
    still = camera.with_trajectory(camera.trajectory.with_motion(None))

    def looks(one, column):
        return one.rays(np.column_stack([lines, np.full(LINES, column)])).directions[LINES - len(table) :]

    z, beside = looks(still, middle), looks(still, middle + 1)
    y = -(beside - z) / np.linalg.norm(beside - z, axis=1, keepdims=True)
    x = np.cross(y, z)
    pixel = np.linalg.norm(beside - z, axis=1).mean()
    about_1, about_2 = -pixel * table[:, 0], -pixel * table[:, 1]
    # the third row of [b]_2 [a]_1 is where the corrected instrument looks, in the given axes
    corrected = (
        np.sin(about_2)[:, None] * x
        - (np.sin(about_1) * np.cos(about_2))[:, None] * y
        + (np.cos(about_1) * np.cos(about_2))[:, None] * z
    )
    true = looks(camera, middle)
    before, after = (np.linalg.norm(one - true, axis=1).std() for one in (z, corrected))
    assert after < 0.1 * before, (after / pixel, before / pixel)


def test_an_attitude_message_is_read_by_another_package(strip, tmp_path):
    models = pytest.importorskip("ccsds_ndm.models.ndmxml2")
    io = pytest.importorskip("ccsds_ndm.ndm_io")
    assert models
    write_export("aem", tmp_path, strip)
    message = io.NdmIo().from_path(tmp_path / "attitude.aem")
    segment = message.body.segment[0]
    states = segment.data.attitude_state
    assert segment.metadata.start_time.startswith(EPOCH[:10])
    found = [
        [float(getattr(one.quaternion_state.quaternion, key)) for key in ("q1", "q2", "q3", "qc")]
        for one in states
    ]
    np.testing.assert_allclose(found, strip.quat_xyzw, atol=1e-15)


def test_an_orbit_message_is_read_by_another_package(strip, tmp_path):
    io = pytest.importorskip("ccsds_ndm.ndm_io")
    write_export("oem", tmp_path, strip)
    rows = io.NdmIo().from_path(tmp_path / "orbit.oem").body.segment[0].data.state_vector
    found = np.array([[float(getattr(row, key).value) for key in ("x", "y", "z")] for row in rows])
    np.testing.assert_allclose(1e3 * found, strip.position, atol=1e-8)
    speed = np.array([[float(getattr(row, f"{key}_dot").value) for key in "xyz"] for row in rows])
    # differences over 0.1 ms of positions known to 1e-9 m
    np.testing.assert_allclose(1e3 * speed[:-1], np.diff(strip.position, axis=0) / 1e-4, atol=1e-3)


@pytest.mark.parametrize(
    ("to", "lacking", "said"),
    [("csm", "acquisition", "holds a camera, which the result does not: add --acquisition FILE"),
     ("aem", "epoch", r"add \[acquisition\] epoch"),
     ("csm", "epoch", r"needs the instant of t = 0: add \[acquisition\] epoch"),
     ("aem", "frame", "they are of another body"),
     ("frames", None, "`to` is 'frames'; allowed are csm, isd, aem, oem, rpc, quaternions, shifts, ck")],
)  # fmt: skip
def test_what_is_lacking_is_named(strip, tmp_path, to, lacking, said):
    from dataclasses import replace

    with pytest.raises(InputError, match=said):
        write_export(to, tmp_path, strip if lacking is None else replace(strip, **{lacking: None}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("to", "frame", "first", "second"),
    [
        ("csm", "LOCAL_ENU", "needs axes that are fixed to a body; these are local", "needs the instant of"),
        ("isd", "ITRF", "--acquisition FILE.*, with axes that are fixed to a body", "needs the instant of"),
        ("isis", "LOCAL_ENU", "--acquisition FILE", "needs the instant of t = 0: add .*, unless its sensor"),
        ("stac", "LOCAL_ENU", "needs axes that are fixed to a body; these are", "gives times in UTC: add"),
    ],
)
def test_all_that_a_form_lacks_is_said_at_once(strip, tmp_path, to, frame, first, second):
    from dataclasses import replace

    bare = replace(strip, acquisition=None, cameras={}, epoch=None, frame=frame)
    with pytest.raises(InputError, match=f"^--to {to} .*{first}.*; it also {second}"):
        write_export(to, tmp_path, bare)


def test_the_axes_of_a_result_without_epoch_and_acquisition_are_not_called_those_of_another_body(
    strip, tmp_path
):
    from dataclasses import replace

    bare = replace(strip, acquisition=None, cameras={}, epoch=None, frame=None)
    with pytest.raises(InputError, match=r"^--to aem gives times in UTC: [^;]*; as it is, this result gives"):
        write_export("aem", tmp_path, bare)


def test_a_kernel_is_refused_where_it_has_no_use(strip, tmp_path):
    with pytest.raises(InputError, match="--kernel is for --to ck and isis; leave it out with --to csm"):
        write_export("csm", tmp_path, strip, (tmp_path / "a.tls",))


def test_names_of_frames_are_short_and_no_two_alike():
    # names of the kernel pool have 32 letters: FRAME_SIGHTLINE_ and 16
    stems = ["PAN-1", "PAN_1", "panchromatic-left-ccd-1", "panchromatic-left-ccd-2"]
    found = list(_words({stem: stem for stem in stems}).values())
    assert found[:2] == ["PAN_1", "PAN_1_1"] and len(set(found)) == 4
    assert max(map(len, found)) <= 16
    with pytest.raises(InputError, match="10 bands"):
        _words({str(k): str(k) for k in range(10)})


def test_rates_at_the_ends_are_as_good_as_within():
    t = np.array([0.0, 0.4, 1.1, 1.5])
    np.testing.assert_allclose(rates(t[:, None] ** 2, t), 2.0 * t[:, None], atol=1e-12)
    np.testing.assert_allclose(rates(np.array([[1.0], [3.0]]), np.array([0.0, 0.5])), [[4.0], [4.0]])
    assert (rates(np.ones((1, 3)), np.zeros(1)) == 0.0).all()


def test_line_times_with_one_short_step_are_refused(strip):
    camera = next(iter(strip.cameras.values()))
    times = camera.times(np.arange(camera.lines, dtype=float))
    times[5:] += 1e-6 - (times[5] - times[4])
    with pytest.raises(InputError, match="mend the line times"):
        line_states(replace(camera, line_times=times))


def test_the_earth_of_an_isd_stands_as_on_its_day():
    # leap seconds of the day: 34 s in 2010; UT1 = UTC within .9 s turns the Earth by 6.6e-5 rad at most
    erfa = pytest.importorskip("erfa")
    utc = erfa.dtf2d("UTC", 2010, 6, 1, 12, 0, 0.0)
    tt = erfa.taitt(*erfa.utctai(*utc))
    known = erfa.c2t06a(*tt, *utc, 0.0, 0.0)
    found = earth_from_j2000(np.array([et_of_utc("2010-06-01T12:00:00Z")])).as_matrix()[0]
    # TDB taken for TT: 1.7 ms, 1.2e-7 rad
    np.testing.assert_allclose(found, known, atol=1.3e-7)
