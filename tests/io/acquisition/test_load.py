from __future__ import annotations

import hashlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.conftest import COLUMNS, LINES, noise, write_tif

from sightline.errors import FormatError, GeometryError, InputError, SpanError
from sightline.io.acquisition.describe import describe_acquisition
from sightline.io.acquisition.ground import sampling_doubts
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import tables

# one pixel on the ground: ifov * altitude = 5e-6 * 700 km = 3.5 m = 7 km/s * 0.5 ms, the step between lines
GSD = 3.5


def message(folder, kind=FormatError) -> str:
    with pytest.raises(kind) as caught:
        load_acquisition(folder.write())
    return str(caught.value)


def level_attitude(count: int) -> np.ndarray:
    """Flying north over a flat Earth: body x to north, y to east, z down; quaternions x, y, z, w."""
    matrix = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
    return np.tile(Rotation.from_matrix(matrix).as_quat(), (count, 1))


def local_ephemeris(folder, t, quat_xyzw=None):
    """Replace the platform by tables that hold the same level flight."""
    tables.write_positions(folder.path / "p.csv", t, np.column_stack([0 * t, 7000.0 * t, 700e3 + 0 * t]))
    tables.write_attitudes(
        folder.path / "a.csv", t, level_attitude(len(t)) if quat_xyzw is None else quat_xyzw
    )
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "p.csv"\nattitudes = "a.csv"',
    )
    return folder.add('[world]\nframe = "local"\n')


def test_the_pixels_of_a_level_flight_lie_where_geometry_puts_them(folder):
    acquisition = load_acquisition(folder.write())
    assert acquisition.names == ("PAN", "XS") and acquisition.world == "local"
    assert acquisition.ifov == pytest.approx(5e-6, rel=1e-9)
    assert acquisition.half_field_px == (COLUMNS - 1) / 2
    pan, xs = acquisition.cameras
    # line 100 is exposed 0.05 s after t = 0, 350 m to the north; columns increase to the left (west)
    ground = pan.locate([[100.0, 69.5]], acquisition.surface)
    np.testing.assert_allclose(ground, [[-10 * GSD, 350.0, 0.0]], atol=1e-6)
    # XS looks tan(2e-4) * 700 km = 140 m further: it sees the same point 40 lines earlier
    np.testing.assert_allclose(xs.project(ground), [[60.0, 69.5]], atol=1e-5)


def test_offsets_and_rotations_move_a_band_as_the_contract_says(folder):
    folder.add("offset_px = [3.0, -2.0]\nrotation = 1e-2\n")
    acquisition = load_acquisition(folder.write())
    there = acquisition.cameras[1].locate([[0.0, 59.5], [0.0, 79.5]], acquisition.surface)
    # 3 px further forward; "toward larger columns" is to the left: -2 px moves right (east)
    np.testing.assert_allclose(there[0], [2.0 * GSD, 140.0 + 3.0 * GSD, 0.0], atol=1e-5)
    # rotation positive: further forward at larger columns, 20 * sin(0.01) px
    assert there[1, 1] - there[0, 1] == pytest.approx(20 * np.sin(1e-2) * GSD, abs=1e-5)


def test_what_is_not_said_about_an_offset_is_not_taken_as_exact(folder):
    pan, xs = load_acquisition(folder.write()).bands
    assert (pan.offset_sigma_px, pan.rotation_sigma) == (0.0, 0.0)
    assert (xs.offset_sigma_px, xs.rotation_sigma) == (1.0, 3e-4)


@pytest.mark.parametrize(
    ("pieces", "columns"), [("", ()), ("pieces = [50, 90]", (50, 90)), ("pieces = 4", (30, 60, 90))], ids=str
)
def test_a_band_in_pieces_says_where_they_begin_or_how_many_there_are(folder, pieces, columns):
    folder.add(f'shape = "pieces"\nshape_sigma_px = 0.2\n{pieces}\n')
    pan, xs = load_acquisition(folder.write()).bands
    assert (pan.shape, pan.shape_sigma_px, pan.pieces) == (None, 0.5, ())
    assert (xs.shape, xs.shape_sigma_px, xs.pieces) == ("pieces", 0.2, columns)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("pieces = 3", 'pieces = 3 says where CCDs begin; shape is not given; write shape = "pieces"'),
        ('shape = "pieces"\npieces = [90, 50]', "pieces = [90, 50] must rise"),
        ('shape = "pieces"\npieces = []', "pieces = [] is not allowed"),
        (
            'shape = "pieces"\npieces = [50, 120]',
            "[[band]] XS: pieces = [50, 120] does not fit the 120 columns",
        ),
        ('shape = "pieces"\npieces = 100', "pieces = 100 does not fit the 120 columns"),
        ('shape = "bent"', "line"),
        ("shape_sigma_px = -1.0", "shape_sigma_px"),
    ],
    ids=["unasked", "falling", "none", "beyond", "many", "word", "sigma"],
)
def test_a_shape_that_cannot_be_is_refused(folder, keys, words):
    said = message(folder.add(keys + "\n"))
    assert words in said and "acquisition.toml" in said


def test_every_input_file_is_hashed(folder):
    acquisition = load_acquisition(folder.write())
    hashes = acquisition.input_hashes()
    assert set(hashes) == {"acquisition.toml", "PAN.tif", "XS.tif"}
    assert hashes["XS.tif"] == hashlib.sha256((folder.path / "XS.tif").read_bytes()).hexdigest()


def test_a_band_may_have_its_own_pixel_and_period(folder):
    write_tif(folder.path / "XS.tif", noise(9, (50, 30)))
    folder.add("columns = 30\nifov = 2e-5\nline_period = 2e-3\n")
    acquisition = load_acquisition(folder.write())
    xs = acquisition.cameras[1]
    assert xs.shape == (50, 30) and xs.detector.line_period == 2e-3
    ends = xs.locate([[0.0, 0.0], [0.0, 29.0]], acquisition.surface)
    assert ends[0, 0] - ends[1, 0] == pytest.approx(29 * 2e-5 * 700e3, rel=1e-9)


def test_line_times_may_come_from_a_table(folder):
    t = np.cumsum(np.linspace(4e-4, 6e-4, LINES))
    tables.write_columns(folder.path / "times.csv", {"line": np.arange(LINES), "t": t})
    acquisition = load_acquisition(folder.add('line_times = "times.csv"\n').write())
    np.testing.assert_allclose(acquisition.cameras[1].times(np.arange(LINES)), t, atol=1e-12)


def test_directions_may_come_from_a_table(folder):
    tangent = 5e-6 * (np.arange(COLUMNS) - 59.5)
    columns = {"column": np.arange(COLUMNS), "x": tangent, "y": 0 * tangent, "z": 1 + 0 * tangent}
    tables.write_columns(folder.path / "d.csv", columns, {"x": "%.17g"})
    acquisition = load_acquisition(folder.add('directions = "d.csv"\n').write())
    there = acquisition.cameras[1].locate([[0.0, 69.5]], acquisition.surface)
    np.testing.assert_allclose(there, [[-10 * GSD, 140.0, 0.0]], atol=1e-4)


def test_tables_of_a_level_flight_give_the_same_cameras(folder):
    pixels = np.array([[0.0, 0.0], [50.0, 30.0], [199.0, 119.0]])
    plain = load_acquisition(folder.write())
    tabled = load_acquisition(local_ephemeris(folder, np.linspace(-0.1, 0.3, 9)).write())
    for a, b in zip(plain.cameras, tabled.cameras, strict=True):
        np.testing.assert_allclose(
            b.locate(pixels, tabled.surface), a.locate(pixels, plain.surface), atol=1e-6
        )


def test_local_tables_with_an_origin_are_turned_into_earth_fixed_axes(folder):
    local_ephemeris(folder, np.linspace(-0.1, 0.3, 9)).add("origin = [0.0, 0.0, 0.0]\n")
    acquisition = load_acquisition(folder.write())
    assert acquisition.world == "earth-fixed"
    # at longitude and latitude 0: up is x, east is y, north is z
    ground = acquisition.cameras[0].locate([[100.0, 69.5]], acquisition.surface)
    np.testing.assert_allclose(ground[0, 1:], [-35.0, 350.0], atol=0.01)
    assert ground[0, 0] == pytest.approx(6378137.0, abs=0.02)


def test_geodetic_positions_with_attitudes_along_the_track_look_down(folder):
    t = np.linspace(-1.0, 2.0, 7)
    geodetic = np.column_stack([10.0 + 0.02 * t, 45.0 + 0.05 * t, 700e3 + 0 * t])
    tables.write_positions(folder.path / "p.csv", t, geodetic)
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "p.csv"',
    ).add('[world]\nframe = "lonlat"\n')
    acquisition = load_acquisition(folder.write())
    from pyproj import Transformer

    seen = acquisition.cameras[0].locate([[0.0, 59.5]], acquisition.surface)[0]
    lon, lat, height = Transformer.from_crs(4978, 4979, always_xy=True).transform(*seen)
    np.testing.assert_allclose([lon, lat], [10.0, 45.0], atol=1e-7)
    assert height == pytest.approx(0.0, abs=1e-3)
    # nose to the north-east (east 0.02 * cos 45, north 0.05): later lines lie there
    later = acquisition.cameras[0].locate([[100.0, 59.5]], acquisition.surface)[0]
    lon2, lat2, _ = Transformer.from_crs(4978, 4979, always_xy=True).transform(*later)
    assert lat2 - lat == pytest.approx(0.05 * 0.05, rel=2e-3) and lon2 > lon


def test_a_star_tracker_and_a_gyro_are_read(folder):
    (folder.path / "st.csv").write_text("t,roll,pitch,yaw,sigma\n0,1e-5,0,0,2e-6\n1,0,2e-5,0,2e-6\n")
    (folder.path / "gy.csv").write_text("t_start,t_end,roll,pitch,yaw,sigma\n0,0.1,1e-7,0,0,1e-8\n")
    folder.add('[[attitude_sensor]]\nkind = "star-tracker"\ntable = "st.csv"\nalignment_sigma = 1e-4\n')
    folder.add('[[attitude_sensor]]\nkind = "gyro"\ntable = "gy.csv"\nbias_sigma = 1e-8\n')
    star, gyro = load_acquisition(folder.write()).sensors
    assert (star.kind, star.alignment_sigma, gyro.bias_sigma) == ("star-tracker", 1e-4, 1e-8)
    np.testing.assert_array_equal(star.t_start, star.t_end)
    np.testing.assert_array_equal(gyro.t_end - gyro.t_start, [0.1])


def test_control_points_come_from_the_file_and_from_a_table(folder):
    (folder.path / "cp.csv").write_text("x,y,z,sigma,image,line,column\n1,2,3,0.5,XS,10,20\n")
    folder.replace('name = "strip"', 'name = "strip"\ncontrol_points = "cp.csv"')
    folder.add(
        '[[control_point]]\nx = 5.0\ny = 6.0\nz = 0.0\nsigma = 1.0\nimage = "PAN"\nline = 3.0\ncolumn = 4.0\n'
    )
    points = load_acquisition(folder.write()).control_points
    np.testing.assert_array_equal(points.position, [[5, 6, 0], [1, 2, 3]])
    np.testing.assert_array_equal(points.image, [0, 1])
    np.testing.assert_array_equal(points.pixels, [[3, 4], [10, 20]])
    assert points.sigma_px == 0.1
    folder.replace('name = "strip"', 'name = "strip"\ncontrol_sigma_px = 0.5')
    assert load_acquisition(folder.write()).control_points.sigma_px == 0.5


def test_a_control_point_in_an_unknown_image_is_refused(folder):
    folder.add(
        '[[control_point]]\nx = 5.0\ny = 6.0\nz = 0.0\nsigma = 1.0\nimage = "NIR"\nline = 3\ncolumn = 4'
    )
    assert "names the image 'NIR'; images are: PAN, XS" in message(folder)


# ------------------------------------------------------------------------------------------------ bad input


def test_a_missing_image_names_the_file(folder):
    (folder.path / "XS.tif").unlink()
    assert f"acquisition.toml: [[band]] 2 image: {folder.path / 'XS.tif'}: no such file" in message(folder)


def test_an_image_is_that_of_one_band(folder):
    said = message(folder.replace("XS.tif", "./PAN.tif"))
    assert "band[1].image and band[2].image are the same, './PAN.tif'" in said and "image_band" in said
    with pytest.raises(FormatError, match="band 2 is asked for"):
        load_acquisition(folder.replace('"./PAN.tif"', '"./PAN.tif"\nimage_band = 2').write())


def test_a_band_of_an_npy_file_that_has_one_is_refused(folder):
    np.save(folder.path / "PAN.npy", np.random.default_rng(1).normal(100.0, 9.0, (200, 120)))
    said = message(folder.replace('"PAN.tif"', '"PAN.npy"\nimage_band = 17'))
    assert "PAN.npy: image_band = 17 is given, and a .npy file holds one band" in said
    load_acquisition(folder.replace("image_band = 17", "image_band = 1").write())


def test_a_model_without_its_kind_of_platform_is_refused(folder):
    said = message(folder.replace('"PAN.tif"', '"PAN.tif"\nmodel = "nofile"'))
    assert (
        "[[band]] number 1 (PAN): model = 'nofile' is given, and [platform] kind = \"level-flight\"" in said
    )


def test_a_level_flight_is_above_its_ground(folder):
    said = message(folder.add("[surface]\nheight = 700e3\n"))
    assert "surface.height = 700000 m is not below platform.altitude = 700000 m" in said


def test_columns_that_disagree_with_the_image_are_named(folder):
    said = message(folder.replace("columns = 120", "columns = 1000"))
    assert "[[band]] number 1 (PAN): PAN.tif has 120 columns (200 lines), columns = 1000" in said


def test_the_error_of_an_image_of_few_lines_says_that_its_axes_may_be_swapped(folder):
    write_tif(folder.path / "PAN.tif", noise(0, (20, 200)))
    assert "PAN.tif: has 20 lines and 200 columns" in (said := message(folder)) and "swapped" in said


def test_a_constant_band_is_refused_on_loading(folder):
    write_tif(folder.path / "XS.tif", np.full((LINES, COLUMNS), 5, np.uint16))
    assert "XS.tif: the image is constant" in message(folder)


def test_a_missing_ifov_and_line_period_are_named(folder):
    assert "(PAN): ifov is missing" in message(folder.replace("ifov = 5e-6\n", ""))
    folder.replace("columns = 120", "columns = 120\nifov = 5e-6").replace("line_period = 5e-4\n", "")
    assert "(PAN): line_period is missing" in message(folder)


def test_attitudes_that_do_not_reach_over_the_strip_give_both_spans(folder):
    t = np.linspace(-0.1, 0.05, 9)
    said = message(local_ephemeris(folder, t), SpanError)
    assert "p.csv: the positions cover [-0.100000, 0.050000] s, the images are exposed in" in said
    assert "[0.000000, 0.099500] s" in said


@pytest.mark.parametrize(("reference", "late"), [("first-stage", 3.75e-3), ("last-stage", -3.75e-3)])
def test_stages_beyond_the_attitudes_are_refused_before_anything_runs(folder, reference, late):
    """16 stages of 0.5 ms: their middle is 7.5 line periods after the first, 7.5 before the last."""
    folder.add(f'stages = 16\ntime_reference = "{reference}"\n')
    local_ephemeris(folder, np.linspace(0.0, 0.0995, 9))
    said = message(folder, SpanError)
    begin, end = min(0.0, late), max(0.0995, 0.0995 + late)
    assert "(XS)" in said or "XS: time_reference" in said
    assert f"are needed in [{begin:.6f}, {end:.6f}] s and cover [0.000000, 0.099500] s" in said
    # over that span every pixel of every line has its ray
    t = np.linspace(begin, end, 9)
    tables.write_positions(folder.path / "p.csv", t, np.column_stack([0 * t, 7000.0 * t, 700e3 + 0 * t]))
    tables.write_attitudes(folder.path / "a.csv", t, level_attitude(9))
    camera = load_acquisition(folder.write()).cameras[1]
    rays = camera.rays([[0.0, 5.0], [LINES - 1.0, 5.0]])
    assert rays.t == pytest.approx([late, 0.0995 + late])


def test_stages_timed_by_their_middle_need_no_more_than_the_lines(folder):
    folder.add("stages = 16\n")
    local_ephemeris(folder, np.linspace(0.0, 0.0995, 9))
    rays = load_acquisition(folder.write()).cameras[1].rays([[0.0, 5.0], [LINES - 1.0, 5.0]])
    assert rays.t == pytest.approx([0.0, 0.0995])


def test_an_attitude_table_that_ends_early_is_named(folder):
    local_ephemeris(folder, np.linspace(-0.1, 0.3, 9))
    tables.write_attitudes(folder.path / "a.csv", np.linspace(0.25, 0.3, 4), level_attitude(4))
    said = message(folder, SpanError)
    assert "a.csv: the attitudes cover [0.250000, 0.300000] s" in said
    assert "continued by two of their steps at most (0.0166667 s)" in said


def test_attitudes_that_look_up_are_refused_with_a_hint(folder):
    up = np.tile([0.0, 0.0, 0.0, 1.0], (9, 1))
    said = message(local_ephemeris(folder, np.linspace(-0.1, 0.3, 9), up), GeometryError)
    assert "100 % of PAN looks past the ground" in said and "scalar last" in said


def test_positions_in_kilometres_are_recognised(folder):
    local_ephemeris(folder, np.linspace(-0.1, 0.3, 9)).replace('frame = "local"', 'frame = "earth-fixed"')
    said = message(folder)
    assert "p.csv: a position lies 700" in said and "are they in km, or in other axes" in said


def test_longitude_and_latitude_that_are_swapped_are_recognised(folder):
    t = np.linspace(-1.0, 2.0, 7)
    tables.write_positions(folder.path / "p.csv", t, np.column_stack([45.0 + t, 110.0 + t, 7e5 + 0 * t]))
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "p.csv"',
    ).add('[world]\nframe = "lonlat"\n')
    assert "latitudes (y) reach 112 degrees" in (said := message(folder)) and "swapped" in said


def test_bands_that_share_no_ground_are_refused(folder):
    said = message(folder.replace("look_ahead = 2e-4", "look_ahead = 2e-2"), GeometryError)
    assert "PAN shares no ground with any other image; check first_line_time, look_ahead" in said


def test_bands_that_see_all_at_the_same_time_are_refused(folder):
    said = message(folder.replace("look_ahead = 2e-4", "look_ahead = 0.0"), GeometryError)
    assert "same ground at the same time (lag 0), so motion cannot be seen" in said


def test_tdi_stages_make_no_lag(folder):
    """They spread over time what a band sees, and would pass for the way out of a lag of 0."""
    folder.replace("look_ahead = 2e-4", "look_ahead = 0.0").add("stages = 16\n")
    said = message(folder, InputError)
    assert "(lag 0), XS (16) over TDI stages: stages make no lag" in said and "check look_ahead" in said


def test_units_that_cannot_belong_together_are_refused(folder):
    said = message(folder.replace("altitude = 700e3", "altitude = 700.0"), InputError)
    assert "lines are 3.5 m apart on the ground and pixels 0.0035 m wide" in said


def test_a_table_of_line_times_of_another_length_is_refused(folder):
    tables.write_columns(folder.path / "times.csv", {"line": np.arange(5), "t": np.arange(5.0)})
    assert "times.csv: has 5 lines, XS.tif has 200" in message(folder.add('line_times = "times.csv"\n'))


def test_a_mount_that_is_not_a_rotation_is_refused(folder):
    said = message(folder.add("[camera]\nbody_from_camera = [1.0, 1.0, 0.0, 0.0]\n"))
    assert "has length 1.41421; a unit quaternion [x, y, z, w], scalar last, is expected" in said


@pytest.mark.parametrize(("ifov", "width"), [("5e-8", 0.035), ("5e-4", 350.0)])
def test_an_ifov_that_is_not_that_of_these_lines_is_wrong_input_and_named(folder, ifov, width):
    said = message(folder.replace("ifov = 5e-6", f"ifov = {ifov}"), InputError)
    assert f"pixels {width:.4g} m wide" in said and "check ifov (a tangent" in said


@pytest.mark.parametrize(("ifov", "width"), [("5e-7", 0.35), ("5e-5", 35.0)])
def test_an_ifov_ten_times_too_small_or_large_is_doubted_aloud(folder, ifov, width):
    acquisition = load_acquisition(folder.replace("ifov = 5e-6", f"ifov = {ifov}").write())
    (said,) = sampling_doubts(acquisition.surface, acquisition.cameras, acquisition.names)
    assert said.startswith(f"all bands: lines are 3.5 m apart on the ground and pixels {width:.4g} m wide")
    assert f"suspicious: {said}" in describe_acquisition(acquisition)["missing"]


@pytest.mark.parametrize(
    ("own", "keys"),
    [
        ("line_period = 1e-3", "ifov"),
        ("ifov = 1e-5", "line_period"),
        ("", "line_period and ifov"),
        ("ifov = 1e-5\nline_period = 1e-3", ""),
    ],
)
def test_keys_that_a_band_of_larger_pixels_lacks_are_asked_for(folder, own, keys):
    write_tif(folder.path / "XS.tif", noise(3, (LINES // 2, COLUMNS // 2)))
    folder.add(f"columns = {COLUMNS // 2}\n{own}\n")
    said = load_acquisition(folder.write()).doubts
    words = f"XS: 2 times fewer lines and columns than PAN, and the same {keys}: if pixels are larger there, "
    whole = words + "a [[band]] takes its own line_period, and ifov or directions"
    assert said == ((whole,) if keys else ())


def test_images_of_one_name_are_looked_at_one_by_one(folder):
    """Frames are called by their files, which may have one name in several folders."""
    acquisition = load_acquisition(folder.replace("ifov = 5e-6", "ifov = 5e-5").write())
    camera = acquisition.cameras[0]
    (said,) = sampling_doubts(acquisition.surface, [camera, camera, camera], ["image", "image", "other"])
    assert said.startswith("all bands: lines are 3.5 m apart")


def test_where_no_ground_is_shared_it_may_be_for_want_of_these_keys(folder):
    write_tif(folder.path / "XS.tif", noise(3, (LINES // 4, COLUMNS // 4)))
    folder.replace("look_ahead = 2e-4", f"look_ahead = 1.2e-3\ncolumns = {COLUMNS // 4}")
    said = message(folder, GeometryError)
    assert "shares no ground with any other image" in said and "XS: 4 times fewer lines" in said


def test_lines_and_pixels_of_about_one_size_are_not_doubted(folder):
    acquisition = load_acquisition(folder.write())
    assert sampling_doubts(acquisition.surface, acquisition.cameras, acquisition.names) == ()
    said = describe_acquisition(acquisition)["understood"]
    assert "on the ground lines are 3.5 m apart and pixels 3.5 m wide" in said


def test_a_field_that_reaches_past_the_ground_on_both_sides_is_wrong_input_and_not_the_attitudes(folder):
    # 120 columns of 0.05 reach 3 to either side, 71 degrees; from 700 km the ground ends at 64
    t = np.linspace(-1.0, 2.0, 7)
    geodetic = np.column_stack([10.0 + 0.0 * t, 45.0 + 0.06 * t, 700e3 + 0.0 * t])
    tables.write_positions(folder.path / "p.csv", t, geodetic)
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "p.csv"',
    ).add('[world]\nframe = "lonlat"\n')
    assert load_acquisition(folder.write()).platform == "ephemeris"
    said = message(folder.replace("ifov = 5e-6", "ifov = 0.05"), InputError)
    assert "sees the ground in its middle and past it on all sides: 120 columns reach over 143" in said
    assert "check ifov" in said and "attitudes" not in said


def vrt_of(name: str) -> str:
    return (
        '<VRTDataset rasterXSize="120" rasterYSize="200"><VRTRasterBand dataType="UInt16" band="1">'
        f'<SimpleSource><SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


def test_images_refer_to_what_lies_beside_them_or_where_files_allow_says(folder):
    elsewhere = folder.path.parent / f"{folder.path.name}-elsewhere"
    elsewhere.mkdir()
    (folder.path / "PAN.tif").rename(elsewhere / "a.tif")
    (folder.path / "PAN.tif").write_text(vrt_of(f"../{elsewhere.name}/a.tif"))
    said = message(folder)
    assert "acquisition.toml: [[band]] 1 image: " in said and "outside the folders" in said
    assert f'[files] allow = ["{elsewhere}"]' in said
    folder.add(f'[files]\nallow = ["../{elsewhere.name}"]\n')
    image = load_acquisition(folder.write()).bands[0].image
    assert image.read((0, 4), (0, 4)).min() >= 100.0


def test_a_folder_that_files_allow_names_must_be_there(folder):
    folder.add('[files]\nallow = ["none"]\n')
    assert f"acquisition.toml: [files] allow: {folder.path / 'none'}: no such folder" in message(folder)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        (
            'image = "XS.tif"',
            'image = "http://127.0.0.1:9/XS.tif"',
            "[[band]] 2 image: http://127.0.0.1:9/XS.tif is an",
        ),
        ('image = "XS.tif"', 'image = "."', "[[band]] 2 image: "),
        ('image = "XS.tif"', 'image = "XS.tif"\nmask = "none.tif"', "[[band]] 2 mask: "),
        ("line_period = 5e-4", 'line_period = 5e-4\ndirections = "none.csv"', "[instrument] directions: "),
    ],
)
def test_what_cannot_be_opened_is_named_with_its_key(folder, old, new, key):
    folder.replace(old, new)
    assert f"acquisition.toml: {key}" in message(folder)


def test_what_is_wrong_in_a_file_is_named_with_its_key(folder):
    (folder.path / "d.csv").write_text("column,x,y,z\n0,0,0,1\n")
    folder.replace("ifov = 5e-6", 'directions = "d.csv"')
    assert f"acquisition.toml: [instrument] directions: {folder.path / 'd.csv'}: has 1 columns" in message(
        folder
    )


def test_values_that_no_computation_takes_are_one_error_that_names_the_file(folder, monkeypatch):
    def fails(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr("sightline.io.acquisition.load.build_surface", fails)
    assert "acquisition.toml: what it says, and the files that it names, cannot be computed with" in message(
        folder
    )


def test_features_outside_their_images_are_named(folder):
    rows = ["PAN,-0.5,3", f"XS,{LINES - 0.6},3", f"PAN,5,{COLUMNS}", "PAN,3,-1"]
    (folder.path / "f.csv").write_text("\n".join(["image,line,column", *rows]) + "\n")
    folder.add('[matching]\nselect = "listed"\nfeatures = "f.csv"\n')
    (said,) = load_acquisition(folder.write()).doubts
    assert said.endswith(
        "2 of 4 features lie outside their images and choose no window, the first in row 3: "
        f"line 5, column {COLUMNS} of PAN, which has {LINES} x {COLUMNS}"
    )
