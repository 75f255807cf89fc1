"""Files of a simulated pass: what is given reads back to the same numbers, the truth lies beside it."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from sightline.cli import options as cli_options
from sightline.cli.main import run
from sightline.geometry.units import ARCSEC
from sightline.io.formats.dem import read_dem
from sightline.simulate.stereo import stereo_case
from sightline.simulate.stereo_files import write_stereo
from sightline.simulate.stereo_options import CASE_OPTIONS

SMALL = {"shots": 3, "points": 12}
CASE = "A_paper_T6_K64"


def read(path):
    """Columns of a CSV by name, as numbers."""
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    return {name: np.array([float(row[k]) for row in rows[1:]]) for k, name in enumerate(rows[0])}


def test_matches_and_poses_read_back_to_the_same_numbers(tmp_path):
    scenario = stereo_case(CASE, 1, **SMALL, match_share=0.8, mismatch_share=0.2)
    written = write_stereo(scenario, tmp_path)
    assert sorted(written) == sorted(path.name for path in tmp_path.iterdir())
    cameras = read(tmp_path / "cameras.csv")
    assert list(cameras) == "camera,shot,t,x,y,z,qx,qy,qz,qw".split(",")
    np.testing.assert_array_equal(cameras["camera"], scenario.images.camera + 1)
    np.testing.assert_array_equal(np.stack([cameras[k] for k in "xyz"], axis=1), scenario.images.position)
    given = np.stack([cameras[k] for k in ("qx", "qy", "qz", "qw")], axis=1)
    np.testing.assert_array_equal(given, scenario.images.world_from_body.as_quat())
    true = read(tmp_path / "truth-cameras.csv")
    np.testing.assert_array_equal(true["x"], scenario.true_images.position[:, 0])

    matches = read(tmp_path / "matches.csv")
    assert list(matches) == "shot,point,line_1,column_1,line_2,column_2".split(",")
    image, tracks = scenario.images, scenario.tracks
    assert 2 * len(matches["shot"]) == len(tracks)
    for camera in (0, 1):
        own = image.camera[tracks.image] == camera
        place = {
            (shot, point): pixel
            for shot, point, pixel in zip(
                image.shot[tracks.image[own]], tracks.point[own], tracks.pixels[own].tolist(), strict=True
            )
        }
        lines, columns = (matches[f"{word}_{camera + 1}"] for word in ("line", "column"))
        for shot, point, line, column in zip(matches["shot"], matches["point"], lines, columns, strict=True):
            assert place[int(shot), int(point)] == [line, column]

    wrong = read(tmp_path / "truth-mismatches.csv")
    assert len(wrong["shot"]) == scenario.mismatched.sum() > 0
    np.testing.assert_array_equal(
        np.stack([wrong["line"], wrong["column"]], axis=1), scenario.displacement[scenario.mismatched]
    )
    np.testing.assert_array_equal(wrong["point"], tracks.point[scenario.mismatched])
    np.testing.assert_array_equal(wrong["camera"], image.camera[tracks.image[scenario.mismatched]] + 1)
    truth = read(tmp_path / "orientation-truth.csv")
    np.testing.assert_array_equal(np.stack([truth[k] for k in ("roll", "pitch", "yaw")], 1), scenario.angles)
    points = read(tmp_path / "truth-points.csv")
    np.testing.assert_array_equal(np.stack([points[k] for k in "xyz"], axis=1), scenario.points)


def test_the_toml_tells_what_is_known_and_no_truth(tmp_path):
    write_stereo(stereo_case(CASE, 1, **SMALL), tmp_path)
    content = tomllib.loads((tmp_path / "stereo.toml").read_text(encoding="utf-8"))
    assert content["cameras"] == "cameras.csv" and content["matches"] == "matches.csv"
    assert "dem" not in content and "control_points" not in content
    assert content["camera"] == {
        "shape": [700, 700],
        "focal_length_px": 350.0 / np.tan(np.radians(0.75)),
        "principal_point_px": [349.5, 349.5],
        "mount": "nominal",
    }
    assert content["noise"] == {
        "sigma_px": 0.1,
        "sigma_position": 7.5,
        "sigma_attitude": 1.8 * ARCSEC,
        "attitude_knowledge": "independent",
    }
    assert content["surface"] == {"radii": [6371000.0, 6371000.0]}


@pytest.mark.parametrize("earth", ["sphere", "wgs84"])
def test_the_dem_is_the_ground(tmp_path, earth):
    scenario = stereo_case(CASE, 1, **SMALL, dem_sigma=10.0, earth=earth)
    write_stereo(scenario, tmp_path, control_points=4, control_sigma=2.0)
    content = tomllib.loads((tmp_path / "stereo.toml").read_text(encoding="utf-8"))
    assert content["dem"] == "dem.tif" and content["dem_sigma"] == 10.0
    assert ("surface" in content) == (earth == "sphere")
    dem = read_dem(tmp_path / "dem.tif", radii=scenario.pair.radii if earth == "sphere" else None)
    np.testing.assert_allclose(
        dem.height_at(scenario.points), scenario.surface.height_at(scenario.points), atol=1e-6
    )
    control = read(tmp_path / "control_points.csv")
    assert (
        list(control) == ["x", "y", "z", "sigma", "point"]
        and content["control_points"] == "control_points.csv"
    )
    near = scenario.points[control["point"].astype(int)]
    off = np.stack([control[k] for k in "xyz"], axis=1) - near
    # twelve draws of 2 m
    assert 0.0 < np.abs(off).max() < 9.0 and (control["sigma"] == 2.0).all()


def test_flat_ground_is_given_as_a_height(tmp_path):
    write_stereo(stereo_case(CASE, 1, **SMALL, relief="none", dem_sigma=3.0), tmp_path)
    content = tomllib.loads((tmp_path / "stereo.toml").read_text(encoding="utf-8"))
    assert content["surface"] == {"radii": [6371000.0, 6371000.0], "height": 0.0, "height_sigma": 3.0}


def test_three_cameras_and_lone_sightings_are_listed_one_by_one(tmp_path):
    scenario = stereo_case("A_three_cameras", 1, **SMALL, match_share=0.6)
    write_stereo(scenario, tmp_path)
    content = tomllib.loads((tmp_path / "stereo.toml").read_text(encoding="utf-8"))
    assert content["observations"] == "observations.csv" and "matches" not in content
    seen = read(tmp_path / "observations.csv")
    assert list(seen) == "camera,shot,point,line,column".split(",")
    np.testing.assert_array_equal(seen["camera"], scenario.images.camera[scenario.tracks.image] + 1)
    np.testing.assert_array_equal(seen["shot"], scenario.images.shot[scenario.tracks.image])
    np.testing.assert_array_equal(np.stack([seen["line"], seen["column"]], 1), scenario.tracks.pixels)


def test_drift_focal_length_and_aim_point_are_written_where_they_matter(tmp_path):
    scenario = stereo_case(
        "A_drift", 1, **SMALL, focal_error=1e-3, attitude_knowledge="from-position", relief="white"
    )
    written = write_stereo(scenario, tmp_path)
    rates = read(written["truth-rates.csv"])
    np.testing.assert_array_equal(np.stack([rates[k] for k in ("roll", "pitch", "yaw")], 1), scenario.rates)
    assert (
        read(written["truth-focal.csv"])["focal_length_px"] == scenario.detectors[0].focal_length_px
    ).all()
    content = tomllib.loads(written["stereo.toml"].read_text(encoding="utf-8"))
    assert content["camera"]["focal_length"] == "estimate"
    assert content["camera"]["focal_length_px"] * 1.001 == pytest.approx(
        scenario.detectors[0].focal_length_px
    )
    assert content["noise"]["aim_point"] == scenario.pair.aim_point.tolist()


def test_the_command_writes_what_its_options_say(tmp_path, capsys):
    keys = {"sigma_attitude": 0.5 * ARCSEC, "fov": np.radians(2.0), "latitude": np.radians(40.0)}
    keys |= {"error": 20.0 * ARCSEC, "track_shots": "2,3"}
    words = "--shots 3 --points 12 " + " ".join(f"--set {key}={value}" for key, value in keys.items())
    out = tmp_path / "pass"
    assert run(["simulate", "stereo", "--seed", "5", *words.split(), "--out", str(out), "--json"]) == 0
    content = tomllib.loads((out / "stereo.toml").read_text(encoding="utf-8"))
    assert content["noise"]["sigma_attitude"] == pytest.approx(0.5 * ARCSEC)
    assert content["camera"]["focal_length_px"] == pytest.approx(350.0 / np.tan(np.radians(1.0)))
    truth = read(out / "orientation-truth.csv")
    np.testing.assert_allclose(np.abs(truth["roll"]), 20.0 * ARCSEC, rtol=1e-3)
    points = read(out / "truth-points.csv")
    latitude = np.degrees(np.arctan2(points["z"], np.hypot(points["x"], points["y"])))
    np.testing.assert_allclose(latitude, 40.0, atol=0.06)  # 5.5 km is 0.05 degrees
    assert '"stereo.toml"' in capsys.readouterr().out
    same = stereo_case(
        CASE, 5, shots=3, points=12, sigma_attitude=0.5 * ARCSEC, fov=np.radians(2.0),
        latitude=np.radians(40.0), error=20.0 * ARCSEC, track_shots=(2, 3),
    )  # fmt: skip
    np.testing.assert_array_equal(
        read(out / "matches.csv")["line_1"], same.tracks.pixels[: len(same.tracks) // 2, 0]
    )


def test_the_cases_in_the_help_are_the_cases():
    assert tuple(CASE_OPTIONS) == cli_options.STEREO_CASES


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--case Z", "unknown case: got 'Z'"),
        ("--set separation=0", "no baseline"),
        ("--set mismatch_share=2", "mismatch_share = 2 is not allowed: 0 to 0.9"),
        ("--set relief=dem --set dem_file=nowhere.tif", "nowhere.tif"),
        ("--set control_points=1000", "control points"),
        ("--set window=2000", "below the horizon"),
    ],
)
def test_a_wrong_option_gives_one_error_and_writes_nothing(tmp_path, capsys, words, message):
    status = run(["simulate", "stereo", *words.split(), "--out", str(tmp_path / "pass")])
    error = capsys.readouterr().err
    assert status in (1, 2) and message in error and "Traceback" not in error
    assert not (tmp_path / "pass").exists()


def test_frames_are_written_in_place_of_points(tmp_path):
    out = tmp_path / "pass"
    words = f"--set images=true --shots 1 --columns 128 --set fov={np.radians(0.1)} --set relief=none"
    assert run(["simulate", "stereo", *words.split(), "--out", str(out)]) == 0
    content = tomllib.loads((out / "stereo.toml").read_text(encoding="utf-8"))
    assert (
        content["images"] == "images.csv" and "matches" not in content and "sigma_px" not in content["noise"]
    )
    assert not (out / "matches.csv").exists() and not (out / "truth-points.csv").exists()
    assert len(list(out.glob("camera-*.tif"))) == 2
    both = ["--set", "images=true", "--set", "control_points=3"]
    assert run(["simulate", "stereo", *both, "--out", str(tmp_path / "b")]) == 2
