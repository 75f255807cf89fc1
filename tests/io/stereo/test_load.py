"""A STEREO.toml: what is understood of it, and every way to get it wrong."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.stereo_files import ARCSEC, RADIUS, SHAPE, TRUTH, scene, table

from sightline.errors import EstimationError, FormatError, GeometryError, SightlineError
from sightline.io.stereo.describe import describe_stereo
from sightline.io.stereo.load import load_stereo, read_stereo


def test_matches_become_tracks_of_two_cameras(tmp_path):
    made = scene(shots=3, points=10)
    problem = load_stereo(made.write(tmp_path))
    assert problem.cameras == ("1", "2") and len(problem.images) == 6
    assert problem.shot_names.tolist() == [0, 1, 2] and problem.point_names.tolist() == list(range(10))
    assert len(problem.tracks) == 2 * 30 and problem.radii == (RADIUS, RADIUS)
    # the second row of matches: point 1 of shot 0, first in camera 1, later in camera 2
    assert problem.tracks.pixels[1].tolist() == made.matches[1][2:4]
    assert problem.tracks.pixels[31].tolist() == made.matches[1][4:6]
    assert problem.images.camera[problem.tracks.image[31]] == 1
    assert problem.detectors[0].principal_point_px == (299.5, 349.5)
    assert problem.noise.aim_point is None and problem.heights is None and problem.control is None
    assert problem.warnings == ()


def test_observations_say_the_same_as_matches(tmp_path):
    made = scene(shots=3, points=10)
    a = load_stereo(made.write(tmp_path / "a"))
    made.toml = made.toml.replace("matches", "observations")
    b = load_stereo(made.write(tmp_path / "b"))
    for name in ("image", "point", "pixels", "sigma_px"):
        assert np.array_equal(getattr(a.tracks, name), getattr(b.tracks, name))


def test_columns_in_any_order_and_a_sigma_for_each_row(tmp_path):
    made = scene(shots=3, points=10)
    path = made.write(tmp_path)
    rows = [[0.2 + 0.01 * k, *row[::-1]] for k, row in enumerate(made.matches)]
    header = ["sigma_px", "column_2", "line_2", "column_1", "line_1", "point", "shot"]
    table(tmp_path / "matches.csv", header, rows)
    path.write_text(made.toml.replace("sigma_px = 0.1\n", ""))
    tracks = load_stereo(path).tracks
    assert tracks.pixels[1].tolist() == made.matches[1][2:4]
    assert tracks.sigma_px[[0, 1, 30]] == pytest.approx([0.2, 0.21, 0.2])


def test_names_in_words_shots_and_points_of_any_number(tmp_path):
    made = scene(shots=3, points=10)
    for row in made.cameras:
        row[0], row[1] = {1: "fore", 2: "aft"}[row[0]], 100 + 7 * row[1]
    for row in made.matches:
        row[0], row[1] = 100 + 7 * row[0], 1000 - row[1]
    problem = load_stereo(made.write(tmp_path))
    assert problem.cameras == ("fore", "aft")  # as first met: line_1 is of "fore"
    assert problem.tracks.pixels[1].tolist() == made.matches[1][2:4]
    assert problem.images.camera[problem.tracks.image[1]] == 0
    assert problem.images.position[0].tolist() == made.cameras[0][3:6]
    said = " ".join(describe_stereo(read_stereo(tmp_path / "stereo.toml"))["understood"])
    assert "line_1, column_1 of matches are of camera fore, line_2, column_2 of camera aft" in said
    assert "1e-06 rad (0.206 arcsec)" in said
    assert problem.shot_names.tolist() == [100, 107, 114]
    assert problem.point_names.tolist() == list(range(991, 1001))


def test_numbered_cameras_are_sorted_by_number(tmp_path):
    made = scene(shots=3, points=10)
    for row in made.cameras:
        row[0] = {1: 10, 2: 9}[row[0]]
    assert load_stereo(made.write(tmp_path)).cameras == ("9", "10")
    for row in made.cameras:
        row[0] = {10: "1.0", 9: "0.5"}[row[0]]  # no whole numbers: names
    assert load_stereo(made.write(tmp_path)).cameras == ("1.0", "0.5")


def test_points_may_be_unequal_from_shot_to_shot(tmp_path):
    made = scene(shots=4, points=12)
    made.matches = [row for row in made.matches if row[1] % 4 != row[0]]
    problem = load_stereo(made.write(tmp_path))
    assert len(problem.tracks) == 2 * len(made.matches) and len(problem.point_names) == 12


def test_a_point_seen_once_is_left_out_and_reported(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = made.toml.replace("matches", "observations")
    made.observations.append([1, 0, 99, 300.0, 300.0])
    problem = load_stereo(made.write(tmp_path))
    assert 99 not in problem.point_names and "1 point seen in one image only" in problem.warnings[0]


def test_every_camera_may_have_a_lens_of_its_own(tmp_path):
    made = scene(shots=3, points=10)
    head, tail = made.toml.split("[camera]")[0], "[noise]" + made.toml.split("[noise]")[1]
    lens = "shape = [600, 700]\nfocal_length_px = 30558.0\n"
    one = f'[[camera]]\nname = "2"\n{lens}focal_length_sigma_px = 30.558\n'
    two = f"[[camera]]\nname = 1\n{lens}body_from_camera = [0, 0, -0.70710678, 0.70710678]\n"
    made.toml = head + one + two + tail
    problem = load_stereo(made.write(tmp_path))
    assert problem.focal_sigma == pytest.approx((0.0, 1e-3))
    assert problem.mounts[0].as_matrix() == pytest.approx(problem.mounts[1].as_matrix(), abs=1e-6)
    made.toml = made.toml.replace("focal_length_sigma_px = 30.558", 'focal_length = "estimate"')
    assert load_stereo(made.write(tmp_path)).focal_sigma == (0.0, np.inf)


def test_the_aim_point_is_where_boresights_come_nearest(tmp_path):
    made = scene(shots=4, points=10)
    made.toml = made.toml.replace("[noise]", '[noise]\nattitude_knowledge = "from-position"')
    problem = load_stereo(made.write(tmp_path))
    # planned boresights leave positions that are wrong by 1 m
    assert np.linalg.norm(problem.noise.aim_point - made.aim) < 5.0
    given = ", ".join(f"{v:.3f}" for v in made.aim)
    made.toml = made.toml.replace("[noise]", f"[noise]\naim_point = [{given}]")
    problem = load_stereo(made.write(tmp_path))
    assert problem.noise.aim_point == pytest.approx(made.aim, abs=1e-3)


def test_control_points_by_number_by_pixel_and_by_image(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = 'control_points = "control.csv"\n' + made.toml
    place = [f"{v:.4f}" for v in made.points[4]]
    made.extra["control.csv"] = f"x,y,z,sigma,point\n{','.join(place)},2.0,4\n"
    control = load_stereo(made.write(tmp_path)).control
    assert control.point.tolist() == [4] and control.sigma.tolist() == [2.0]
    assert control.position[0] == pytest.approx(made.points[4], abs=1e-3)
    pixel = f"{made.matches[4][2]},{made.matches[4][3]}"
    for header, image in (("camera,shot", "1,0"), ("image", "1/0")):
        made.extra["control.csv"] = (
            f"x,y,z,sigma,{header},line,column\n{','.join(place)},2.0,{image},{pixel}\n"
        )
        problem = load_stereo(made.write(tmp_path))
        assert len(problem.point_names) == 11 and problem.point_names[10] < 0
        assert problem.control.point.tolist() == [10] and problem.tracks.point[-1] == 10
        assert problem.images.camera[problem.tracks.image[-1]] == 0
        assert problem.tracks.pixels[-1].tolist() == made.matches[4][2:4]


def test_heights_of_a_surface_are_a_prior_where_their_sigma_is_given(tmp_path):
    made = scene(shots=3, points=10)
    made.toml += "height = 100.0\nheight_sigma = 50.0\n"
    heights = load_stereo(made.write(tmp_path)).heights
    assert heights.sigma == 50.0 and heights.radii == (RADIUS, RADIUS)
    made.toml = made.toml.replace("height_sigma = 50.0\n", "")
    assert load_stereo(made.write(tmp_path)).heights is None


def test_a_dem_with_its_sigma(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    made = scene(shots=3, points=10)
    made.toml = 'dem = "dem.tif"\ndem_sigma = 10.0\n' + made.toml
    path = made.write(tmp_path)
    lat, lon = (
        np.degrees(np.arctan2(made.aim[2], made.aim[0])),
        np.degrees(np.arctan2(made.aim[1], made.aim[0])),
    )

    def write(west):
        transform = rasterio.Affine(0.01, 0.0, west, 0.0, -0.01, lat + 0.1)
        with rasterio.open(
            tmp_path / "dem.tif", "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
            crs="EPSG:4326", transform=transform,
        ) as raster:  # fmt: skip
            raster.write(np.full((1, 20, 20), 7.0, dtype=np.float32))

    write(lon - 0.1)
    heights = load_stereo(path).heights
    assert heights.sigma == 10.0 and heights.surface.height_range == (7.0, 7.0)
    write(lon + 3.0)
    with pytest.raises(GeometryError, match="DEM does not cover the points: 100 %"):
        load_stereo(path)


def test_local_axes_about_an_origin_give_the_same_geometry(tmp_path):
    made = scene(shots=3, points=10)
    fixed = load_stereo(made.write(tmp_path / "fixed"))
    # east, north, up about longitude 0, latitude 0 of the sphere
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    for row in made.cameras:
        row[3:6] = [float(v) for v in turn @ (np.array(row[3:6]) - [RADIUS, 0.0, 0.0])]
        row[6:10] = [float(v) for v in (Rotation.from_matrix(turn) * Rotation.from_quat(row[6:10])).as_quat()]
    made.toml += '[world]\nframe = "local"\norigin = [0.0, 0.0, 0.0]\n'
    local = load_stereo(made.write(tmp_path / "local"))
    assert local.images.position == pytest.approx(fixed.images.position, abs=1e-6)
    turned = fixed.images.world_from_body.inv() * local.images.world_from_body
    assert turned.magnitude().max() < 1e-12
    made.toml = made.toml.replace("origin = [0.0, 0.0, 0.0]\n", "")
    assert load_stereo(made.write(tmp_path / "flat")).radii is None


def test_a_hundred_thousand_matches_load_in_a_second(tmp_path):
    made = scene(shots=1024, points=50, window=60.0)
    path = made.write(tmp_path)
    begun = time.process_time()
    problem = load_stereo(path)
    assert len(problem.tracks) == 2 * 1024 * 50
    # no test of speed: reading row by row in Python takes some ten times as long
    assert time.process_time() - begun < 5.0


# --- what a user may get wrong: each spoils a good scene; the message says what to do -----------------------


def spoilt(tmp_path, spoil, **size):
    made = scene(**{"shots": 4, "points": 12} | size)
    spoil(made)
    path = made.write(tmp_path)
    for name, text in made.extra.items():
        (tmp_path / name).write_text(text)
    return path


def toml(old, new):
    def spoil(made):
        assert old in made.toml
        made.toml = made.toml.replace(old, new)

    return spoil


def camera_cell(row, column, value):
    def spoil(made):
        made.cameras[row][column] = value

    return spoil


def match_cell(row, column, value):
    def spoil(made):
        made.matches[row][column] = value

    return spoil


def swap_lines_and_columns(made):
    for row in made.matches:
        row[2], row[3], row[4], row[5] = row[3], row[2], row[5], row[4]
    made.matches[0][2] = 690.0


def same_place(made):
    for k in range(4):
        made.cameras[4 + k][3:] = made.cameras[k][3:]


def reversed_shots(made):
    made.cameras = made.cameras[::-1]


def renumbered(made):
    for row in made.cameras:
        row[1] = {0: 0, 1: 2, 2: 1, 3: 3}[row[1]]


def looks_away(made):
    for row in made.cameras[4:]:
        turned = Rotation.from_quat(row[6:10]) * Rotation.from_euler("x", 60, degrees=True)
        row[6:10] = [float(v) for v in turned.as_quat()]


def away_from_the_aim(made):
    looks_away(made)
    made.toml = made.toml.replace("[noise]", '[noise]\nattitude_knowledge = "from-position"')


def few(made):
    made.matches = made.matches[:5]


def on_a_line(made):
    # of pixels: each row of matches moved onto a slanted line of its frame
    rng = np.random.default_rng(4)
    for row in made.matches:
        for k in (2, 4):
            row[k] = 300.0 + 0.3 * (row[k + 1] - 350.0) + float(rng.normal(0.0, 0.1))


def without(column):
    def spoil(made):
        path = "matches.csv" if column in ("line_2", "point") else "cameras.csv"
        rows, header = (
            (made.matches, "shot,point,line_1,column_1,line_2,column_2".split(","))
            if path == "matches.csv"
            else (made.cameras, "camera,shot,t,x,y,z,qx,qy,qz,qw".split(","))
        )
        k = header.index(column)
        lines = [",".join(header[:k] + header[k + 1 :])]
        lines += [",".join(str(v) for v in row[:k] + row[k + 1 :]) for row in rows]
        made.extra[path] = "\n".join(lines)

    return spoil


def observed(made):
    made.toml = made.toml.replace("matches", "observations")


def below_the_ground(made):
    made.toml += '[world]\nframe = "local"\norigin = [0.0, 0.0, 0.0]\n'
    for row in made.cameras:
        row[3:6] = [0.0, 0.0, -420e3]  # z down


def unknown_camera(made):
    observed(made)
    made.observations[3][0] = "7"


def seen_twice(made):
    observed(made)
    made.observations.append(made.observations[5])


def no_image(made):
    observed(made)
    made.observations[3][1] = 17


def three(made):
    for k in range(4):
        row = list(made.cameras[k])
        row[0], row[4] = 3, row[4] + 50e3
        made.cameras.append(row)


def control(text, key='control_points = "control.csv"\n'):
    def spoil(made):
        made.toml = key + made.toml
        made.extra["control.csv"] = text

    return spoil


BAD = {
    # the file
    "misspelt key": (toml("sigma_position", "sigma_positon"), FormatError, "did you mean sigma_position"),
    "no points": (
        toml('matches = "matches.csv"\n', ""),
        FormatError,
        "nothing brings points: give matches = FILE",
    ),
    "two sources": (
        toml('matches = "', 'observations = "o.csv"\nmatches = "'),
        FormatError,
        "matches and observations are given",
    ),
    "no cameras": (toml('cameras = "cameras.csv"\n', ""), FormatError, "key 'cameras' is missing"),
    "no camera": (
        toml("[camera]\nshape = [600, 700]\nfocal_length_px = 30558.0\n", ""),
        FormatError,
        r"\[camera\] is missing",
    ),
    "no shape": (toml("shape = [600, 700]\n", ""), FormatError, "'camera.shape' is missing"),
    "no noise": (toml("sigma_attitude = 1e-6\n", ""), FormatError, "'noise.sigma_attitude' is missing"),
    "no sigma of points": (
        toml("sigma_px = 0.1\n", ""),
        FormatError,
        "no column sigma_px and .noise. no sigma_px",
    ),
    "sigma_px 0": (toml("sigma_px = 0.1", "sigma_px = 0"), FormatError, "sigma_px = 0 is not allowed"),
    "negative sigma": (
        toml("sigma_position = 1.0", "sigma_position = -1"),
        FormatError,
        "noise.sigma_position = -1",
    ),
    "sigma nan": (
        toml("sigma_attitude = 1e-6", "sigma_attitude = nan"),
        FormatError,
        "noise.sigma_attitude = nan",
    ),
    "sigma in arcseconds": (
        toml("sigma_attitude = 1e-6", "sigma_attitude = 1.8"),
        FormatError,
        "sigma_attitude: 1.8 rad is 103 degrees .* 1.8 arcsec would be 8.7e-06",
    ),
    "one number for the shape": (
        toml("[600, 700]", "700"),
        FormatError,
        r"camera.shape: 700 is not allowed: two whole numbers .lines, columns. are",
    ),
    "half a line": (toml("[600, 700]", "[600.5, 700]"), FormatError, "two whole numbers .lines, columns."),
    "no table of noise": (
        toml("[noise]\nsigma_px = 0.1\nsigma_position = 1.0\nsigma_attitude = 1e-6\n", ""),
        FormatError,
        "'noise' is missing; add it: it holds sigma_position, sigma_attitude; if wanted also sigma_px",
    ),
    "two keys missing": (
        toml("sigma_position = 1.0\nsigma_attitude = 1e-6\n", ""),
        FormatError,
        r"'noise.sigma_position' is missing; add it \(also missing: noise.sigma_attitude\)",
    ),
    "one key missing, one wrong": (
        toml("sigma_px = 0.1\nsigma_position = 1.0\n", "sigma_px = -1\n"),
        FormatError,
        r"noise.sigma_px = -1 is not allowed.*\(also missing: noise.sigma_position\)",
    ),
    "Earth-fixed in a flat world": (
        toml("[surface]", '[world]\nframe = "local"\n[surface]'),
        FormatError,
        "no origin .* are they Earth-fixed",
    ),
    "below the ground": (
        below_the_ground,
        FormatError,
        r"are they in km, or Earth-fixed, not east, north and up about \[world\] origin",
    ),
    "knowledge": (
        toml("[noise]", '[noise]\nattitude_knowledge = "star-tracker"'),
        FormatError,
        "'star-tracker' is not known; allowed: 'independent' or 'from-position'",
    ),
    "aim without its model": (
        toml("[noise]", "[noise]\naim_point = [1, 2, 3]"),
        FormatError,
        "aim_point belongs to",
    ),
    "mount twice": (
        toml("[camera]", '[camera]\nmount = "nominal"\nbody_from_camera = [0, 0, 0, 1]'),
        FormatError,
        "mount and body_from_camera are both given",
    ),
    "mount no rotation": (
        toml("[camera]", "[camera]\nbody_from_camera = [1, 1, 0, 1]"),
        FormatError,
        "has length 1.73",
    ),
    "focal length twice": (
        toml("[camera]", '[camera]\nfocal_length = "estimate"\nfocal_length_sigma_px = 3.0'),
        FormatError,
        "takes no focal_length_sigma_px",
    ),
    "name of one camera": (toml("[camera]", '[camera]\nname = "1"'), FormatError, "camera.name belongs to"),
    "lens of nobody": (
        toml("[camera]", '[[camera]]\nname = "7"'),
        FormatError,
        "name = '7' is no camera of the table",
    ),
    "lens of one only": (
        toml("[camera]", '[[camera]]\nname = "1"'),
        FormatError,
        "no ..camera.. is called '2'",
    ),
    "dem without sigma": (
        toml("[stereo]", 'dem = "d.tif"\n[stereo]'),
        FormatError,
        "dem is given without dem_sigma",
    ),
    "sigma without dem": (
        toml("[stereo]", "dem_sigma = 3.0\n[stereo]"),
        FormatError,
        "dem_sigma is given without",
    ),
    "exact ground": (
        toml("[surface]", "[surface]\nheight_sigma = 0.0"),
        FormatError,
        "height_sigma = 0 is not allowed",
    ),
    "stars": (toml("[surface]", '[surface]\nkind = "infinity"'), FormatError, "surface.kind is for stars"),
    "epoch": (toml("2026-01-01T00:00:00Z", "yesterday"), FormatError, "not a UTC instant"),
    # files
    "no table": (toml('"matches.csv"', '"marches.csv"'), FormatError, "marches.csv: no such file"),
    "no dem": (
        toml("[stereo]", 'dem = "d.tif"\ndem_sigma = 3.0\n[stereo]'),
        FormatError,
        "d.tif",
    ),
    "columns of cameras": (without("qw"), FormatError, "column 'qw' is missing"),
    "columns of matches": (without("line_2"), FormatError, "column 'line_2' is missing"),
    # cameras.csv
    "nan pose": (camera_cell(2, 3, float("nan")), FormatError, "line 4, column 'x' is nan"),
    "quaternion": (camera_cell(1, 9, 2.0), FormatError, "row 2 holds a quaternion of length"),
    "half a shot": (camera_cell(1, 1, 0.5), FormatError, "row 2: shot = 0.5; shots are whole numbers"),
    "shot twice": (camera_cell(1, 1, 0), FormatError, "rows 1 and 2 are both shot 0 of camera 1"),
    "times of a shot": (camera_cell(3, 2, 100.0), FormatError, "images of shot 3 are .* s apart"),
    "rows not in order": (reversed_shots, FormatError, "unordered shots of camera 1"),
    "time twice": (camera_cell(1, 2, -15.0), FormatError, "duplicate shots of camera 1"),
    "numbers not in order": (renumbered, FormatError, "unordered shots: shot 1 is at t = 5"),
    "one place": (same_place, FormatError, "no baseline: cameras 1 and 2 are apart by 0 m"),
    "three cameras": (three, FormatError, "matches are between two cameras, the table of cameras has 3"),
    # points
    "nan pixel": (match_cell(2, 3, float("nan")), FormatError, "line 4, column 'column_1' is nan"),
    "word": (match_cell(2, 3, "left"), FormatError, "line 4, column 'column_1': 'left' is not a number"),
    "point twice": (match_cell(1, 1, 0), FormatError, "rows 1 and 2 are both point 0 of shot 0"),
    "half a point": (match_cell(1, 1, 0.5), FormatError, "point = 0.5; points are whole numbers"),
    "shot without image": (match_cell(7, 0, 9), FormatError, "line 9 is of shot 9 of camera 1"),
    "line and column exchanged": (swap_lines_and_columns, FormatError, "are line and column exchanged"),
    "beside the frame": (
        match_cell(0, 2, 5000.0),
        FormatError,
        "line 5000, .* outside its frame of 600 lines x 700",
    ),
    "unknown camera": (unknown_camera, FormatError, "line 5 names the camera '7'.* it has: 1, 2"),
    "seen twice": (seen_twice, FormatError, "are both point 5 in the same image"),
    "image unknown": (no_image, FormatError, "line 5 is of shot 17 of camera 1"),
    # geometry
    "too few": (few, EstimationError, "too few points: 5 points in 10 sightings give 5 equations"),
    "on a line": (on_a_line, EstimationError, "all points lie on one line"),
    "looks away": (looks_away, GeometryError, "looks away from where the others look"),
    "aims elsewhere": (away_from_the_aim, GeometryError, "degrees past the common aim point"),
    # control points
    "control: no pixel": (
        control("x,y,z,sigma\n1,2,3,4\n"),
        FormatError,
        "give point .of the table of points.",
    ),
    "control: sigma": (
        control("x,y,z,sigma,point\n6.4e6,2,3,0,1\n"),
        FormatError,
        "sigma = 0; a 1-sigma error",
    ),
    "control: above": (
        control("x,y,z,sigma,point\n6.4e7,2,3,1,4\n"),
        FormatError,
        "control point 4 at .* m behind a camera that sees it",
    ),
    "control: unknown": (control("x,y,z,sigma,point\n6.4e6,2,3,1,77\n"), FormatError, "row 1 names point 77"),
    "control: twice": (control("x,y,z,sigma,point\n1,2,3,1,7\n1,2,3,1,7\n"), FormatError, "are both point 7"),
    "control: image": (
        control("x,y,z,sigma,image,line,column\n1,2,3,1,left,4,5\n"),
        FormatError,
        "camera/shot",
    ),
    "control: camera": (
        control("x,y,z,sigma,camera,shot,line,column\n1,2,3,1,7,0,4,5\n"),
        FormatError,
        "names the camera '7'",
    ),
    "control: beside": (
        control("x,y,z,sigma,image,line,column\n6.4e6,2,3,1,1/0,4,5000\n"),
        FormatError,
        "outside its frame",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_reported(tmp_path, case):
    spoil, kind, words = BAD[case]
    with pytest.raises(kind, match=words) as raised:
        load_stereo(spoilt(tmp_path, spoil))
    assert isinstance(raised.value, SightlineError)
    assert str(tmp_path) in str(raised.value)  # the file is named


def test_dem_and_surface_together_are_refused(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = 'dem = "d.tif"\ndem_sigma = 3.0\n' + made.toml + "height = 3.0\n"
    with pytest.raises(FormatError, match=r"dem and .surface. height are both given"):
        load_stereo(made.write(tmp_path))


@pytest.mark.parametrize("radii", ["", "[surface]\nradii = [6371000.0, 6371000.0]\n"])
@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "km"), (0.93, "km"), (1e3, "mm")])
def test_positions_inside_a_body_or_far_from_it_are_refused(tmp_path, radii, factor, unit):
    made = scene(shots=3, points=10)
    made.toml = made.toml.replace("[surface]\nradii = [6371000.0, 6371000.0]\n", radii)
    load_stereo(made.write(tmp_path))
    for row in made.cameras:
        row[3:6] = [v * factor for v in row[3:6]]  # km, 53 km below the ground, mm
    with pytest.raises(
        FormatError, match=f"cameras.csv: a position lies .* centre.* in {unit}, or in other axes"
    ):
        load_stereo(made.write(tmp_path))


def test_radii_of_a_body_in_km_are_refused(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = made.toml.replace("[6371000.0, 6371000.0]", "[6371.0, 6371.0]")
    with pytest.raises(GeometryError, match=r"points 6\.37\S* m from the centre .*radii 6371 m.*in metres"):
        load_stereo(made.write(tmp_path))


def test_a_focal_length_in_mm_is_suspected(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = made.toml.replace("focal_length_px = 30558.0", "focal_length_px = 150.0")
    # 2 atan(300 / 150), 2 atan(350 / 150), of both cameras
    said = [words for words in load_stereo(made.write(tmp_path)).warnings if "given in mm" in words]
    assert len(said) == 1 and "127 x 134 degrees" in said[0]


@pytest.mark.parametrize("exchange", [False, True])
def test_longitude_and_latitude_exchanged_are_suspected_by_where_cameras_look(tmp_path, exchange):
    made = scene(shots=3, points=10)
    turn = Rotation.from_euler("z", 60.0, degrees=True) * Rotation.from_euler("y", -20.0, degrees=True)
    made.toml = made.toml.replace("[noise]", '[world]\nframe = "lonlat"\n\n[noise]')
    for row in made.cameras:
        x, y, z = turn.apply(row[3:6])
        place = [np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))]
        height = np.sqrt(x * x + y * y + z * z) - RADIUS
        row[3:6] = [*(place[::-1] if exchange else place), height]
        row[6:10] = (turn * Rotation.from_quat(row[6:10])).as_quat().tolist()
    path = made.write(tmp_path)
    if not exchange:
        assert len(load_stereo(path).images) == 6
        return
    with pytest.raises(GeometryError, match=r"latitude of their positions exchanged"):
        load_stereo(path)


def test_exact_positions_and_attitudes_may_be_given(tmp_path):
    made = scene(shots=3, points=10)
    made.toml = made.toml.replace("sigma_position = 1.0", "sigma_position = 0")
    made.toml = made.toml.replace("sigma_attitude = 1e-6", "sigma_attitude = 0")
    noise = load_stereo(made.write(tmp_path)).noise
    assert noise.position == 0.0 and noise.attitude == 0.0


def test_lines_are_counted_as_an_editor_does(tmp_path):
    made = scene(shots=3, points=10)
    path = made.write(tmp_path)
    made.matches[7][0] = 9
    rows = [",".join(str(v) for v in row) for row in made.matches]
    text = "# a comment\n\nshot,point,line_1,column_1,line_2,column_2\n" + "\n".join(rows)
    (tmp_path / "matches.csv").write_text(text)
    with pytest.raises(FormatError, match=r"matches.csv: line 11 is of shot 9"):
        load_stereo(path)


def test_attitude_errors_of_degrees_are_warned_of(tmp_path):
    truth = TRUTH / (36.0 * ARCSEC) * np.radians(0.3)
    made = scene(shots=3, points=10, truth=truth, relief=0.0)
    kept = [row for row in made.matches if all(-0.5 <= row[k] <= SHAPE[k % 2] for k in (2, 3, 4, 5))]
    made.matches = kept
    problem = load_stereo(made.write(tmp_path))
    assert "errors so large are at the end of what is linear" in problem.warnings[-1]


def test_pictures_are_opened_and_checked_against_the_camera(tmp_path):
    made = scene(shots=2, points=10)
    made.toml = made.toml.replace('matches = "matches.csv"', 'images = "images.csv"')
    path = made.write(tmp_path)
    rng = np.random.default_rng(1)
    rows = []
    for camera in (1, 2):
        for shot in (0, 1):
            name = f"{camera}-{shot}.npy"
            np.save(tmp_path / name, rng.normal(100.0, 10.0, SHAPE).astype(np.float32))
            rows.append([camera, shot, name])
    table(tmp_path / "images.csv", ["camera", "shot", "image"], rows)
    stereo = read_stereo(path)
    assert stereo.pictures.image.tolist() == [0, 1, 2, 3] and len(stereo.problem.tracks) == 0
    assert {p.name for p in stereo.inputs} >= {"stereo.toml", "cameras.csv", "images.csv", "1-0.npy"}
    np.save(tmp_path / "1-0.npy", np.ones((700, 600), dtype=np.float32))
    with pytest.raises(FormatError, match="lines and columns exchanged"):
        read_stereo(path)
