"""``sightline tie`` on a strip of one detector and on frames whose cameras are far off.

The images are waves seen by rays written out here: nothing of the package has rendered them.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio

import sightline
from sightline.cli.main import run
from sightline.io.results.schema import check_summary
from sightline.io.sequence.load import read_sequence

HEIGHT, IFOV, SPEED = 2000.0, 5e-4, 100.0  # a pixel is 1 m
LINES, COLUMNS = 420, 260
ANGLES = np.array([24.0, -31.0, 4.0]) * IFOV * np.array([1.0, 1.0, 2.0 / COLUMNS])  # px; of yaw at the edge
NOISE = 0.02


def waves(x, y, seed=3):
    """A texture over east and north (m): waves of 4 m and more, each as strong as it is long."""
    rng = np.random.default_rng(seed)
    out = np.zeros(np.broadcast(x, y).shape)
    for _ in range(160):
        length, angle, phase = 4.0 * 2.0 ** rng.uniform(0.0, 4.0), *rng.uniform(0.0, 2 * np.pi, 2)
        out += length / 64.0 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase)
    return out


def meets(forward, left, along, angles):
    """East and north (m) on the plane z = 0 of tangents forward and left, `along` m on a flight north."""
    roll, pitch, yaw = angles
    # body axes: forward, right, down; a small rotation is d + angles x d
    d = np.array([forward, -left, np.ones_like(forward)])
    turned = d + np.array([pitch * d[2] - yaw * d[1], yaw * d[0] - roll * d[2], roll * d[1] - pitch * d[0]])
    return HEIGHT * turned[1] / turned[2], along + HEIGHT * turned[0] / turned[2]


def ground_of(line, column, angles=ANGLES):
    """Where a pixel of the strip looks."""
    left = (column - 0.5 * (COLUMNS - 1)) * IFOV
    return meets(np.zeros_like(left), left, line * 1.0, angles)


def frame_ground(line, column, along, angles=ANGLES):
    """Where a pixel of a frame of 200 x 240 looks."""
    return meets((line - 99.5) * IFOV, (column - 119.5) * IFOV, along, angles)


def noisy(pixels, seed):
    return (1000.0 * (5.0 + pixels + NOISE * np.random.default_rng(seed).normal(size=pixels.shape))).astype(
        "f4"
    )


def write_map(path, west, north, gsd, shape, pixels, seed=None):
    y, x = np.meshgrid(
        north - gsd * (np.arange(shape[0]) + 0.5), west + gsd * (np.arange(shape[1]) + 0.5), indexing="ij"
    )
    values = pixels(x, y)
    with rasterio.open(
        path, "w", driver="GTiff", height=shape[0], width=shape[1], count=1, dtype="float32",
        transform=rasterio.Affine(gsd, 0.0, west, 0.0, -gsd, north),
    ) as target:  # fmt: skip
        target.write(values if seed is None else noisy(values, seed), 1)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """One band, three frames, an orthoimage, another place's, and a DEM, all local."""
    folder = tmp_path_factory.mktemp("tied scene")
    line, column = np.meshgrid(np.arange(float(LINES)), np.arange(float(COLUMNS)), indexing="ij")
    np.save(folder / "PAN.npy", noisy(waves(*ground_of(line, column)), 1))
    write_map(folder / "ortho.tif", -220.0, 560.0, 1.25, (560, 352), waves, 2)
    write_map(folder / "other.tif", -220.0, 560.0, 1.25, (560, 352), lambda x, y: waves(x, y, 77), 2)
    write_map(folder / "dem.tif", -600.0, 1000.0, 50.0, (36, 24), lambda x, y: np.zeros(x.shape, "f4"))
    (folder / "strip.toml").write_text(f"""
[acquisition]
name = "one detector"
control_sigma_px = 3.0              # what it was

[platform]
kind = "level-flight"
altitude = {HEIGHT}
ground_speed = {SPEED}

[instrument]
ifov = {IFOV}
columns = {COLUMNS}
line_period = 0.01

[[band]]
name = "PAN"
image = "PAN.npy"
""")
    (folder / "frames").mkdir()
    line, column = np.meshgrid(np.arange(200.0), np.arange(240.0), indexing="ij")
    rows = {"positions": ["frame,t,x,y,z,sigma_x,sigma_y,sigma_z"], "frames": ["frame,t,image"],
            "attitudes": ["frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw"]}  # fmt: skip
    half = np.sqrt(0.5)
    for k in range(3):
        pixels = noisy(waves(*frame_ground(line, column, 100.0 + 80.0 * k)), 10 + k)
        np.save(folder / "frames" / f"f{k}.npy", pixels)
        rows["frames"].append(f"f{k},{k},frames/f{k}.npy")
        rows["positions"].append(f"f{k},{k},0,{100.0 + 80.0 * k},{HEIGHT},1,1,1")
        # forward is north, right is east, down is down
        rows["attitudes"].append(f"f{k},{k},{half},{half},0,0,0.05,0.05,0.05")
    for name, table in rows.items():
        (folder / f"{name}.csv").write_text("\n".join(table) + "\n")
    (folder / "flight.toml").write_text(f"""frames = "frames.csv"
positions = "positions.csv"
attitudes = "attitudes.csv"

[world]
frame = "local"

[camera]
shape = [200, 240]
focal_length_px = {1.0 / IFOV}

[surface]
height = 0.0
height_sigma = 1.0
""")
    return folder


def tie(scene, toml, out, *more, reference="ortho.tif"):
    return run(
        ["tie", str(scene / toml), "--reference", str(scene / reference), "--dem", str(scene / "dem.tif"),
         "--out", str(out), *more]
    )  # fmt: skip


def misses(folder, ground):
    """Errors of control points east and north (m), their sigma, and the table."""
    rows = np.genfromtxt(
        folder / "control_points.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    x, y = ground(rows)
    toml = next(folder.glob("*.toml")).read_text()
    sigma_px = float(toml.split("control_sigma_px = ")[1].split()[0])
    return np.stack([rows["x"] - x, rows["y"] - y], axis=1), np.hypot(rows["sigma"], sigma_px * 1.0), rows


def test_a_strip_of_one_detector_gets_control_points_with_true_sigma(scene, tmp_path):
    out = tmp_path / "out"
    assert tie(scene, "strip.toml", out) == 0
    error, sigma, rows = misses(out, lambda r: ground_of(r["line"], r["column"]))
    assert list(rows.dtype.names)[:7] == ["x", "y", "z", "sigma", "image", "line", "column"]
    own = np.stack([rows["sigma_column"], rows["sigma_line"]], axis=1)  # a pixel is 1 m
    assert 0.4 < (error**2 / own**2).mean() < 1.7 and set(rows["lines"]) == {4.0}
    # 2 x 40 numbers and more, 1 +- 0.16, four times that; cubics of the map and the kernel keep to it
    assert len(rows) >= 40 and 0.4 < (error**2 / sigma[:, None] ** 2).mean() < 1.7
    assert (rows["z"] == 0.0).all() and set(rows["image"]) == {"PAN"}
    summary = json.loads((out / "summary.json").read_text())
    check_summary((out / "summary.json").read_text())
    # +pitch looks further ahead: the same ground comes earlier; +roll looks left: columns too
    assert summary["images"][0]["offset_px"] == pytest.approx([31.0, -24.0], abs=3.0)


def test_a_strip_of_one_detector_is_recovered_from_them(scene, tmp_path, capsys):
    assert run(["recover", str(scene / "strip.toml"), "--out", str(tmp_path / "r")]) == 2
    assert "add a [[band]]" in capsys.readouterr().err
    tied, found = tmp_path / "tied", tmp_path / "found"
    assert tie(scene, "strip.toml", tied, "--points", "60") == 0
    toml = tied / "acquisition.toml"
    exact = toml.read_text().replace(
        'name = "PAN"', 'name = "PAN"\noffset_sigma_px = 0.0\nrotation_sigma = 0'
    )
    toml.write_text(exact)
    assert run(["check", str(toml)]) == 0
    assert "what control points show alone" in capsys.readouterr().out
    assert run(["recover", str(toml), "--out", str(found)]) == 0
    check_summary((found / "summary.json").read_text())
    rows = np.genfromtxt(found / "motion.csv", delimiter=",", names=True)
    for axis, angle in zip(("roll", "pitch", "yaw"), ANGLES, strict=True):
        z = (rows[axis] - angle) / rows[f"sigma_absolute_{axis}"]
        # a constant motion: one number per axis, and the first order of rays as they are written out above
        assert np.isfinite(z).all() and np.abs(z).mean() < 4.0
    # known far better than a pixel: 60 matches of some hundredths
    assert np.abs(rows["pitch"] - ANGLES[1]).max() < 0.05 * IFOV
    opened = sightline.open_result(found)
    assert opened.image_names == ("PAN",) and not opened.differences
    assert run(["register", str(toml), "--motion", str(found), "--out", str(tmp_path / "g")]) == 0
    with rasterio.open(tmp_path / "g" / "PAN.tif") as written:
        np.testing.assert_array_equal(written.read(1), np.load(scene / "PAN.npy"))
    export = ["export", str(found), "--acquisition", str(toml)]
    assert run([*export, "--to", "shifts", "--out", str(tmp_path / "shifts")]) == 0


def test_the_file_beside_them_is_the_acquisition_with_its_control_points(scene, tmp_path):
    out = tmp_path / "elsewhere" / "out"
    assert tie(scene, "strip.toml", out, "--points", "12", "--reference-sigma", "2") == 0
    acquired = sightline.load_acquisition(out / "acquisition.toml")
    points = acquired.control_points
    assert acquired.name == "one detector" and len(points.sigma) <= 12
    assert points.sigma.min() >= 2.0 and points.sigma_px < 0.1
    assert "# control_sigma_px = 3.0" in (out / "acquisition.toml").read_text()
    # a copy can be tied again: names of files still lead to them
    assert tie(scene, "strip.toml", tmp_path / "again") == 0


def test_frames_of_a_flight_are_tied_one_by_one(scene, tmp_path):
    out = tmp_path / "out"
    assert tie(scene, "flight.toml", out) == 0

    def truth(rows):
        along = 100.0 + 80.0 * np.array([int(str(name)[1:]) for name in rows["image"]])
        return frame_ground(rows["line"], rows["column"], along)

    error, sigma, rows = misses(out, truth)
    assert set(rows["image"]) == {"f0", "f1", "f2"}
    # 2 x 60 numbers, 1 +- 0.13, four times that
    assert len(rows) >= 60 and 0.45 < (error**2 / sigma[:, None] ** 2).mean() < 1.6
    problem = read_sequence(out / "sequence.toml").problem
    assert len(problem.control.point) == len(rows) and len(problem.frames) == 3
    opened = sightline.open_result(out)
    assert isinstance(opened, sightline.ReferenceTie) and len(opened.to_dict()["images"]) == 3
    opened.write(tmp_path / "copy")


def test_images_of_several_cameras_are_tied_and_oriented_by_it(scene, tmp_path):
    """Two of the frames as cameras of one shot: `orient` finds the attitudes that they were made with."""
    half, rows = np.sqrt(0.5), ["camera,shot,t,x,y,z,qx,qy,qz,qw"]
    rows += [f"{k + 1},1,0,0,{100.0 + 80.0 * k},{HEIGHT},{half},{half},0,0" for k in range(2)]
    (scene / "cameras.csv").write_text("\n".join(rows) + "\n")
    (scene / "pictures.csv").write_text("camera,shot,image\n1,1,frames/f0.npy\n2,1,frames/f1.npy\n")
    (scene / "stereo.toml").write_text(f"""cameras = "cameras.csv"
images = "pictures.csv"

[world]
frame = "local"

[camera]
shape = [200, 240]
focal_length_px = {1.0 / IFOV}

[noise]
sigma_px = 0.1
sigma_position = 0.1
sigma_attitude = 0.05
attitude_knowledge = "independent"

[surface]
height = 0.0
""")
    tied, found = tmp_path / "tied", tmp_path / "found"
    assert tie(scene, "stereo.toml", tied) == 0
    table = (tied / "control_points.csv").read_text()
    assert "1/1" in table and "2/1" in table and ",sigma_px" in table
    assert run(["orient", str(tied / "stereo.toml"), "--out", str(found)]) == 0
    rows = np.genfromtxt(found / "orientation.csv", delimiter=",", names=True)
    for axis, angle in zip(("roll", "pitch", "yaw"), ANGLES, strict=True):
        off = (rows[axis] - angle) / rows[f"sigma_{axis}"]
        assert np.isfinite(off).all() and (np.abs(off) < 5.0).all(), (axis, off)


@pytest.mark.parametrize(
    ("reference", "more", "status", "said"),
    [
        ("other.tif", (), 1, "do not show the same"),
        ("ortho.tif", ("--image", "XS"), 2, "no image has this name"),
        ("PAN.npy", (), 2, "no georeferencing"),
        ("ortho.tif", ("--geoid", "none.tif"), 2, "none.tif"),
        ("ortho.tif", ("--geoid", "nan"), 2, "the geoid is given as nan"),
        ("ortho.tif", ("--reference-sigma", "1e300"), 2, "the sigma of the reference is 1e+300 m"),
        ("ortho.tif", ("--points", "9" * 25), 2, "control points of an image"),
        ("ortho.tif", ("--search", "0"), 2, "give more than 0 px"),
    ],
)
def test_what_cannot_be_tied_is_refused(scene, tmp_path, capsys, reference, more, status, said):
    assert tie(scene, "strip.toml", tmp_path / "out", *more, reference=reference) == status
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error and not (tmp_path / "out").exists()


def test_a_reference_of_another_place_is_refused(scene, tmp_path, capsys):
    write_map(scene / "far.tif", 9000.0, 9000.0, 1.25, (100, 100), waves, 4)
    assert tie(scene, "strip.toml", tmp_path / "out", reference="far.tif") == 1
    assert "cover 0 %" in capsys.readouterr().err


def test_frames_that_show_another_place_are_refused(scene, tmp_path, capsys):
    """Turned cameras are tried then, of frames too, which are exposed at one instant."""
    assert tie(scene, "flight.toml", tmp_path / "out", reference="other.tif") == 1
    assert "do not show the same" in capsys.readouterr().err
