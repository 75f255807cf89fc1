"""Formats of other programs: each by round trip, and against a reading that shares no code with it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, InputError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.angle_tables import (
    OPK,
    YPR,
    AngleTable,
    body_of_ypr,
    camera_of_opk,
    opk_of_camera,
    read_angles,
    write_angles,
    ypr_of_body,
)
from sightline.io.formats.colmap import read_colmap_model, write_colmap_model
from sightline.io.formats.envi import read_envi_wavelengths
from sightline.io.formats.footprints import ground_outlines, rings_of, write_footprints
from sightline.io.formats.odm import read_gcp_list, read_geo, write_geo
from sightline.io.formats.opensfm import read_opensfm, write_opensfm
from sightline.io.formats.reconstruction import Reconstruction

SHAPE = (48, 64)
LENSES = {
    "pinhole": (),
    "opencv": (-0.05, 0.01, 1e-3, -2e-3),
    "full": (-0.05, 0.01, 1e-3, -2e-3, 5e-3),
}
#: Nadir camera whose columns run east and lines south.
DOWN = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def made(distortion=(), seed=3, images=5, points=40):
    """Nadir cameras above scattered points, which are projected without the package's cameras."""
    rng = np.random.default_rng(seed)
    detector = AreaDetector("c", SHAPE, 80.0, (22.7, 33.1), distortion)
    position = np.column_stack([np.arange(images) * 3.0, rng.normal(0.0, 0.5, images), np.full(images, 50.0)])
    attitude = DOWN * Rotation.from_rotvec(rng.normal(0.0, 0.05, (images, 3)))
    places = np.column_stack(
        [rng.uniform(-10.0, 20.0, points), rng.uniform(-8.0, 8.0, points), rng.normal(size=points)]
    )
    image, point, pixels = [], [], []
    for k in range(images):
        q = attitude[k].inv().apply(places - position[k])
        seen = brown(q[:, :2] / q[:, 2:], distortion) * 80.0 + np.array([33.1, 22.7])
        for n in np.flatnonzero((seen > 0).all(axis=1) & (seen < [63, 47]).all(axis=1)):
            image.append(k)
            point.append(n)
            pixels.append(seen[n, ::-1])
    assert len(image) > 2 * images
    names = tuple(f"frame-{k}.tif" for k in range(images))
    residual = rng.uniform(0.1, 0.3, points)
    return Reconstruction(
        names, (detector,), np.zeros(images, int), position, attitude, places, residual,
        np.array(image), np.array(point), np.array(pixels),
    )  # fmt: skip


def brown(xy, distortion):
    """D. C. Brown's distortion, written down anew."""
    k1, k2, p1, p2, k3 = (*distortion, *[0.0] * (5 - len(distortion)))
    x, y = xy.T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def same(a, b, *, sightings=True, tolerance=1e-12):
    assert a.names == b.names
    np.testing.assert_allclose(a.position, b.position, rtol=0, atol=1e-9)
    assert (a.world_from_camera.inv() * b.world_from_camera).magnitude().max() < tolerance
    np.testing.assert_allclose(a.points, b.points, rtol=0, atol=1e-9)
    one, two = a.detectors[0], b.detectors[0]
    assert one.shape == two.shape
    assert one.focal_length_px == pytest.approx(two.focal_length_px, abs=1e-10)
    np.testing.assert_allclose(one.principal_point_px, two.principal_point_px, atol=1e-10)
    np.testing.assert_allclose(one.coefficients, two.coefficients, atol=1e-15)
    if sightings:
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.point, b.point)
        np.testing.assert_allclose(a.pixels, b.pixels, rtol=0, atol=1e-10)
        np.testing.assert_allclose(a.residual_px, b.residual_px, rtol=1e-8)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("binary", [False, True])
def test_colmap_round_trip(tmp_path, lens, binary):
    model = made(LENSES[lens])
    write_colmap_model(tmp_path / "m", model, binary=binary)
    suffix = "bin" if binary else "txt"
    assert sorted(p.name for p in (tmp_path / "m").iterdir()) == [
        f"{name}.{suffix}" for name in ("cameras", "images", "points3D")
    ]
    same(model, read_colmap_model(tmp_path / "m"))


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_itself_reads_what_is_written_and_projects_points_where_they_were_seen(tmp_path, binary):
    pycolmap = pytest.importorskip("pycolmap")
    model = made(LENSES["opencv"])
    write_colmap_model(tmp_path, model, binary=binary)
    read = pycolmap.Reconstruction(str(tmp_path))
    assert read.num_images() == 5 and read.num_points3D() == len(model.points)
    for number, image in read.images.items():
        np.testing.assert_allclose(image.projection_center(), model.position[number - 1], atol=1e-9)
        for sight in image.points2D:
            seen = image.project_point(read.points3D[sight.point3D_id].xyz)
            # the projection above is exact, COLMAP's corner of the first pixel is 0: no pixel is half off
            np.testing.assert_allclose(seen, sight.xy, atol=1e-6)
    assert sum(len(p.track.elements) for p in read.points3D.values()) == len(model.image)


@pytest.mark.parametrize("binary", [False, True])
def test_what_colmap_writes_is_read(tmp_path, binary):
    pycolmap = pytest.importorskip("pycolmap")
    model = made(LENSES["opencv"])
    (tmp_path / "ours").mkdir()
    (tmp_path / "theirs").mkdir()
    write_colmap_model(tmp_path / "ours", model)
    read = pycolmap.Reconstruction(str(tmp_path / "ours"))
    (read.write_binary if binary else read.write_text)(str(tmp_path / "theirs"))
    # COLMAP's text has 17 digits, of quaternions too
    same(model, read_colmap_model(tmp_path / "theirs"), tolerance=1e-9)


def test_opensfm_round_trip(tmp_path):
    model = made(LENSES["full"])
    write_opensfm(tmp_path / "r.json", model, (11.0, 48.0, 500.0))
    read, reference = read_opensfm(tmp_path / "r.json")
    same(model, read, sightings=False)
    assert reference == (11.0, 48.0, 500.0)


def test_opensfm_numbers_project_points_where_they_were_seen(tmp_path):
    model = made(LENSES["opencv"])
    write_opensfm(tmp_path / "r.json", model)
    content = json.loads((tmp_path / "r.json").read_text())[0]
    camera = content["cameras"]["camera 1"]
    for image, point, pixel in zip(model.image, model.point, model.pixels, strict=True):
        shot = content["shots"][model.names[image]]
        q = Rotation.from_rotvec(shot["rotation"]).apply(np.array(model.points[point])) + shot["translation"]
        x, y = brown(q[None, :2] / q[2], [camera[k] for k in ("k1", "k2", "p1", "p2", "k3")])[0]
        part = np.array([camera["focal_x"] * x + camera["c_x"], camera["focal_y"] * y + camera["c_y"]])
        # denormalised as OpenSfM does: the larger side is 1, the centre of the first pixel 0
        column, line = part * 64 - 0.5 + np.array([64, 48]) / 2.0
        np.testing.assert_allclose([line, column], pixel, atol=1e-9)


def test_opensfm_perspective_camera_of_another_program(tmp_path):
    content = {
        "cameras": {
            "v2": {"projection_type": "perspective", "width": 4000, "height": 3000, "focal": 0.9, "k1": -0.1}
        },
        "shots": {"a.jpg": {"rotation": [0.0, 0.0, 0.0], "translation": [1.0, 2.0, 3.0], "camera": "v2"}},
    }
    (tmp_path / "r.json").write_text(json.dumps([content]))
    read, reference = read_opensfm(tmp_path / "r.json")
    assert reference is None
    assert read.detectors[0].focal_length_px == pytest.approx(3600.0)
    assert read.detectors[0].principal_point_px == (1499.5, 1999.5)
    np.testing.assert_allclose(read.position, [[-1.0, -2.0, -3.0]])


@pytest.mark.parametrize("seed", range(3))
def test_angles_there_and_back(seed):
    rng = np.random.default_rng(seed)
    attitude = Rotation.from_rotvec(rng.normal(0.0, 0.3, (20, 3)))
    camera = DOWN * attitude
    assert (camera_of_opk(opk_of_camera(camera)).inv() * camera).magnitude().max() < 1e-12
    body = Rotation.from_euler("z", rng.uniform(0, 360, (20, 1)), degrees=True) * camera
    assert (body_of_ypr(ypr_of_body(body)).inv() * body).magnitude().max() < 1e-12


def test_signs_of_omega_phi_kappa_and_yaw_pitch_roll():
    # straight down, columns east, lines south: all zero
    assert (camera_of_opk(np.zeros((1, 3))) * Rotation.identity()).as_matrix() == pytest.approx(
        DOWN.as_matrix()[None]
    )
    # matrix of the textbooks: east_north_up_from_image = Rx(omega) Ry(phi) Rz(kappa)
    o, p, k = np.radians([3.0, -5.0, 70.0])
    rx = np.array([[1, 0, 0], [0, np.cos(o), -np.sin(o)], [0, np.sin(o), np.cos(o)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(k), -np.sin(k), 0], [np.sin(k), np.cos(k), 0], [0, 0, 1]])
    found = camera_of_opk(np.array([[3.0, -5.0, 70.0]])).as_matrix()[0]
    np.testing.assert_allclose(found, rx @ ry @ rz @ np.diag([1, -1, -1]), atol=1e-15)
    # nose to the east, then up: body x climbs, y (right wing) to the south
    body = body_of_ypr(np.array([[90.0, 10.0, 0.0]])).as_matrix()[0]
    np.testing.assert_allclose(body[:, 0], [np.cos(np.radians(10)), 0, np.sin(np.radians(10))], atol=1e-15)
    np.testing.assert_allclose(body[:, 1], [0, -1, 0], atol=1e-15)
    # right wing down
    body = body_of_ypr(np.array([[0.0, 0.0, 10.0]])).as_matrix()[0]
    assert body[2, 1] < 0 < body[0, 1]


@pytest.mark.parametrize("kind", [OPK, YPR])
@pytest.mark.parametrize("origin", [None, (11.25, 48.5, 500.0)])
def test_angle_tables_round_trip(tmp_path, kind, origin):
    rng = np.random.default_rng(1)
    table = AngleTable(("a b", "c"), rng.normal(size=(2, 3)), rng.uniform(-80, 80, (2, 3)), kind, origin)
    write_angles(tmp_path / "t.csv", table)
    read = read_angles(tmp_path / "t.csv")
    assert read.names == table.names and read.kind == kind and read.origin == origin
    np.testing.assert_array_equal(read.position, table.position)
    np.testing.assert_array_equal(read.angles, table.angles)


def test_geo_round_trip_and_other_coordinate_systems(tmp_path):
    place = np.array([[11.25, 48.5, 500.25], [-91.99, 46.84, 198.3]])
    write_geo(tmp_path / "geo.txt", ["a.tif", "b.tif"], place, np.array([[1.5, 3.0], [0.02, 0.05]]))
    read = read_geo(tmp_path / "geo.txt")
    assert read.names == ("a.tif", "b.tif") and not read.angles
    np.testing.assert_allclose(read.lonlat, place, rtol=0, atol=1e-9)
    np.testing.assert_allclose(read.sigma, [[1.5, 3.0], [0.02, 0.05]])
    # the central meridian of zone 32 is 9 degrees east, where easting is 500 km whatever the latitude
    for crs in ("WGS84 UTM 32N", "EPSG:32632", "+proj=utm +zone=32 +datum=WGS84"):
        (tmp_path / "utm.txt").write_text(f"{crs}\n# a comment\nx.jpg 500000 0 12.5\ny.jpg 500000 0\n")
        utm = read_geo(tmp_path / "utm.txt")
        np.testing.assert_allclose(utm.lonlat[0], [9.0, 0.0, 12.5], atol=1e-9)
        assert np.isnan(utm.lonlat[1, 2]) and np.isnan(utm.sigma).all()


def test_gcp_list_gives_line_and_column(tmp_path):
    (tmp_path / "gcp_list.txt").write_text(
        "EPSG:4326\n11.0 48.0 500 30.25 10.5 a.tif corner\n11.0 48.0 500 31 12 b.tif corner\n11.1 "
        "48.0 510 1 2 a.tif\n"
    )
    read = read_gcp_list(tmp_path / "gcp_list.txt")
    np.testing.assert_allclose(read.pixels, [[10.5, 30.25], [12, 31], [2, 1]])
    assert read.images == ("a.tif", "b.tif", "a.tif") and read.names == ("corner", "corner", "11.1 48.0 510")


def test_envi_wavelengths_in_both_units(tmp_path):
    path = tmp_path / "cube.hdr"
    path.write_text("ENVI\nsamples = 4\nwavelength units = Nanometers\nwavelength = {\n 450.5, 500,\n 550}\n")
    np.testing.assert_allclose(read_envi_wavelengths(path), [450.5, 500.0, 550.0])
    for unit in ("Micrometers", "Micrometer", "micron", "um", "\u00b5m", "\u03bcm"):
        path.write_text(f"ENVI\nwavelength = {{0.45, 0.5}}\nwavelength units = {unit}\n")
        np.testing.assert_allclose(read_envi_wavelengths(path), [450.0, 500.0])
    for unit in ("Nanometer", "nm", "{ Nanometres }", "Unknown"):
        path.write_text(f"ENVI\nwavelength units = {unit}\nwavelength = {{450, 500}}\n")
        np.testing.assert_allclose(read_envi_wavelengths(path), [450.0, 500.0])


def test_footprints_are_the_ground_under_the_corners(tmp_path):
    lon, lat, height, f = np.radians(11.0), np.radians(48.0), 1000.0, 80.0
    level = local_axes(lon, lat)
    position = from_geodetic([[lon, lat, height]])
    detector = AreaDetector("c", SHAPE, f, (23.5, 31.5))
    edge = ground_outlines(
        detector, Rotation.identity(), position, level * Rotation.concatenate([DOWN]), Ellipsoid()
    )
    assert edge.shape == (1, 16, 3)
    ground = level.inv().apply(edge[0] - from_geodetic([[lon, lat, 0.0]])[0])
    # half a frame is 32 columns and 24 lines of f = 80 px; the Earth falls by (0.5 km)^2 / 2 R = 2 cm, seen
    # at a tangent of 0.5
    np.testing.assert_allclose(np.abs(ground[::4, :2]), np.tile([[400.0, 300.0]], (4, 1)), atol=0.02)
    assert write_footprints(tmp_path / "f.geojson", ["a"], edge, WGS84, {"source": ["solved"]}) == 1
    feature = json.loads((tmp_path / "f.geojson").read_text())["features"][0]
    assert feature["properties"] == {"frame": "a", "source": "solved"}
    ring = np.array(feature["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all() and len(ring) == 17
    assert ((ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1]).sum()) > 0  # counterclockwise
    np.testing.assert_allclose(ring[:-1].mean(axis=0), [11.0, 48.0], atol=1e-5)


def areas(rings):
    """Signed, square degrees."""
    closed = [np.array(ring) for ring in rings]
    return [0.5 * (r[:-1, 0] * r[1:, 1] - r[1:, 0] * r[:-1, 1]).sum() for r in closed]


@pytest.mark.parametrize("turned", [1, -1])
@pytest.mark.parametrize("east", [0.3, 0.5, 0.7])
def test_an_outline_across_180_degrees_is_cut_there(turned, east):
    # a square degree, `east` of it west of 180 degrees, written as longitudes are: -180 to 180
    x = 180.0 - east + np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0])
    y = np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5]) + 10.0
    outline = np.column_stack([np.where(x > 180.0, x - 360.0, x), y])[::turned]
    rings = rings_of(outline)
    assert len(rings) == 2
    sizes = {np.sign(np.mean(ring, axis=0)[0]): area for ring, area in zip(rings, areas(rings), strict=True)}
    assert sizes[1.0] == pytest.approx(east, abs=1e-7) and sizes[-1.0] == pytest.approx(1 - east, abs=1e-7)
    for ring in rings:
        assert ring[0] == ring[-1] and np.abs(np.array(ring)[:, 0]).max() == 180.0
        assert np.ptp(np.array(ring)[:, 0]) < 1.0  # no edge round the world


def test_an_outline_up_to_180_degrees_stays_whole():
    outline = np.array([[179.0, 0.0], [180.0, 0.0], [180.0, 1.0], [179.0, 1.0]])
    assert [pytest.approx(1.0)] == areas(rings_of(outline)) == areas(rings_of(-outline))
    assert areas(rings_of(outline * [-1.0, 1.0])) == [pytest.approx(1.0)]


@pytest.mark.parametrize("pole", [90.0, -90.0])
def test_an_outline_round_a_pole_reaches_to_it(pole):
    longitude = np.array([100.0, 170.0, -120.0, -50.0, 20.0])
    rings = rings_of(np.column_stack([longitude, np.full(5, np.sign(pole) * 89.0)]))
    assert sum(areas(rings)) == pytest.approx(360.0)
    points = np.concatenate([np.array(ring) for ring in rings])
    assert np.abs(points[:, 0]).max() == 180.0 and pole in points[:, 1]


def test_a_frame_across_180_degrees_is_a_multipolygon(tmp_path):
    lon, lat = np.pi, np.radians(-17.0)
    detector = AreaDetector("c", SHAPE, 80.0, (23.5, 31.5))
    attitude = local_axes(lon, lat) * Rotation.concatenate([DOWN])
    edge = ground_outlines(
        detector, Rotation.identity(), from_geodetic([[lon, lat, 1000.0]]), attitude, Ellipsoid()
    )
    write_footprints(tmp_path / "f.geojson", ["a"], edge)
    geometry = json.loads((tmp_path / "f.geojson").read_text())["features"][0]["geometry"]
    assert geometry["type"] == "MultiPolygon" and len(geometry["coordinates"]) == 2
    east, west = sorted(areas([part[0] for part in geometry["coordinates"]]))
    # half of 800 m x 600 m each
    assert east == pytest.approx(west, rel=1e-3)
    size = 111.3e3 * np.cos(lat) * 110.7e3  # m^2 of a square degree at latitude 17
    assert east * size == pytest.approx(240e3, rel=0.01)


def test_a_frame_that_looks_past_the_ground_has_no_footprint(tmp_path):
    position = from_geodetic([[0.0, 0.0, 1000.0]])
    detector = AreaDetector("c", SHAPE, 80.0, (23.5, 31.5))
    edge = ground_outlines(
        detector, Rotation.identity(), position, Rotation.from_quat([[0, 0, 0, 1.0]]), Ellipsoid()
    )
    assert write_footprints(tmp_path / "f.geojson", ["a"], edge) == 0
    with pytest.raises(InputError, match="longitude and latitude"):
        write_footprints(tmp_path / "f.geojson", ["a"], edge, None)


BAD = {
    "geo: no such system": ("g.txt", "UTM of somewhere\na 1 2 3\n", read_geo, "no coordinate system"),
    "geo: empty": ("g.txt", "", read_geo, "empty"),
    "geo: no rows": ("g.txt", "EPSG:4326\n", read_geo, "no rows"),
    "geo: short": ("g.txt", "EPSG:4326\na 1\n", read_geo, "line 2 has 2 values"),
    "geo: word": ("g.txt", "EPSG:4326\na 1 north 3\n", read_geo, "'north' is not a number"),
    "geo: nan": ("g.txt", "EPSG:4326\na nan 1 3\n", read_geo, "line 2 has no place"),
    "geo: twice": ("g.txt", "EPSG:4326\na 1 2 3\na 1 2 3\n", read_geo, "two rows"),
    "gcp: short": ("g.txt", "EPSG:4326\n1 2 3 4 5\n", read_gcp_list, "line 2 has 5 values"),
    "gcp: inf": ("g.txt", "EPSG:4326\n1 2 inf 4 5 a\n", read_gcp_list, "finite numbers"),
    "envi: another file": ("h.hdr", "hello\n", read_envi_wavelengths, "no ENVI header"),
    "envi: none": ("h.hdr", "ENVI\nbands = 3\n", read_envi_wavelengths, "no wavelength"),
    "envi: unit": (
"h.hdr", "ENVI\nwavelength = {1}\nwavelength units = GHz\n", read_envi_wavelengths, "'GHz'"),
    "envi: word": ("h.hdr", "ENVI\nwavelength = {red}\n", read_envi_wavelengths, "numbers are expected"),
    "envi: negative": ("h.hdr", "ENVI\nwavelength = {-1}\n", read_envi_wavelengths, "not positive"),
    "angles: header": ("a.csv", "frame,x,y,z\n1,2,3,4\n", read_angles, "omega,phi,kappa or yaw,pitch,roll"),
    "angles: origin": (
        "a.csv", "# origin = 1,x,3\nframe,x,y,z,yaw,pitch,roll\n1,2,3,4,5,6,7\n", read_angles, "longitude",
    ),
    "opensfm: no json": ("r.json", "{", read_opensfm, "not valid JSON"),
    "opensfm: empty": ("r.json", "[]", read_opensfm, "no reconstruction"),
    "opensfm: fisheye": (
        "r.json",
        '[{"cameras": {"c": {"projection_type": "fisheye", "width": 4, "height": 3, "focal": 1}},'
        ' "shots": {"a": {"rotation": [0,0,0], "translation": [0,0,0], "camera": "c"}}}]',
        read_opensfm,
        "'fisheye', which is not understood",
    ),
    "opensfm: key": ("r.json", '[{"cameras": {"c": {}}, "shots": {"a": {}}}]', read_opensfm, "'rotation'"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_reported(tmp_path, case):
    name, content, read, words = BAD[case]
    (tmp_path / name).write_text(content)
    with pytest.raises(FormatError, match=words) as raised:
        read(tmp_path / name)
    assert str(tmp_path / name) in str(raised.value)


def cameras(line):
    return {"cameras.txt": line, "images.txt": "1 1 0 0 0 0 0 0 1 a\n\n", "points3D.txt": ""}


BAD_MODELS = {
    "none": ({}, "no COLMAP model"),
    "model": (cameras("1 OPENCV_FISHEYE 64 48 80 80 32 24 0 0 0 0\n"), "OPENCV_FISHEYE is not understood"),
    "parameters": (cameras("1 PINHOLE 64 48 80 80 32\n"), "takes 4 parameters"),
    "pixels": (cameras("1 PINHOLE 64 48 80 90 32 24\n"), "not square"),
    "rational": (cameras("1 FULL_OPENCV 64 48 80 80 32 24 0 0 0 0 0 0.1 0 0\n"), "k4, k5, k6"),
    "camera": (cameras("2 PINHOLE 64 48 80 80 32 24\n"), "is of camera 1"),
    "words": (cameras("1 PINHOLE wide 48 80 80 32 24\n"), "not a COLMAP text file"),
    "no image": (cameras("1 PINHOLE 64 48 80 80 32 24\n") | {"images.txt": "# none\n"}, "no image"),
    "cut short": ({"cameras.bin": b"\3\0", "images.bin": b"", "points3D.bin": b""}, "cut short"),
}


@pytest.mark.parametrize("case", BAD_MODELS)
def test_bad_colmap_models_are_reported(tmp_path, case):
    files, words = BAD_MODELS[case]
    for name, content in files.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(FormatError, match=words):
        read_colmap_model(tmp_path)


def test_names_with_spaces_are_refused_where_the_format_cannot_hold_them(tmp_path):
    model = made()
    spaced = Reconstruction(
        ("a b", *model.names[1:]), model.detectors, model.camera, model.position, model.world_from_camera
    )
    with pytest.raises(InputError, match="space"):
        write_colmap_model(tmp_path, spaced)
    with pytest.raises(FormatError, match="space"):
        write_geo(tmp_path / "geo.txt", ["a b"], np.zeros((1, 3)))
